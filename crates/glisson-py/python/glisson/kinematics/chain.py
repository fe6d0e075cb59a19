"""The way from a robot's base to its tip."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from glisson.kinematics.arguments import frame_of, numbers_of, tool_axes
from glisson.kinematics.errors import KinematicsError, shown
from glisson.kinematics.geometry import SHORTEST, Floats, axes_without_roll, translation, turn_about
from glisson.kinematics.inverse import Found, Target, closest, starts
from glisson.kinematics.mjcf import Mjcf
from glisson.kinematics.robot import Joint, Robot
from glisson.kinematics.urdf import Urdf
from glisson.kinematics.xml import read_xml


class Chain:
    """The way from the base of a robot to its tip: what its joints do to an instrument.

    ``file``, ``base`` and ``tip`` are what it was read from, and its ends.
    ``joints`` are the names of the joints that can be chosen, from base to tip; the one that opens the jaws, if there is one, is the last.
    ``units`` are "rad" or "m" for each, ``limits`` (n, 2) where it may be, infinite where nothing holds it. Joints that follow others
    (URDF: mimic; MJCF: an equality of joints) are not among them. Where the leader of one is beside the chain, it is in the place of the
    first one that follows it. The limits of followers do not count.

    A chain is made by :meth:`load`, does not change, and can be pickled.
    """

    def __init__(
        self, robot: Robot, tip: str | None, base: str | None, jaw: str | None, jaw_range: Sequence[float] | None, tip_from_tool: Floats
    ) -> None:
        tip_node, base_node = robot.tip(tip), robot.base(base)
        self.file = robot.file
        self.tip, self.base = robot.shown(tip_node), robot.shown(base_node)
        jaw_joint = None if jaw is None else robot.joint(jaw)
        parts = [part for node in robot.way(base_node, tip_node) for part in robot.parts(node)]
        led = {part.name: robot.leader(part) for part in parts if isinstance(part, Joint)}
        joints = {leader.name: leader for leader, _, _ in led.values() if leader is not None}
        self._jaw_range = None
        if jaw_joint is not None:
            self._jaw_range = _jaw_range(jaw_joint, robot, jaw_range)
            joints.pop(jaw_joint.name, None)
            joints[jaw_joint.name] = jaw_joint
        if not joints:
            raise KinematicsError(
                f"{robot.file}: no joint between {self.base} and {self.tip} moves; give the link, body or site at the tool's tip as tip="
            )
        self.joints = tuple(joints)
        self.units = tuple("rad" if joint.is_turn else "m" for joint in joints.values())
        self._limits = np.array([[joint.lower, joint.upper] for joint in joints.values()])
        self._tip_from_tool = tip_from_tool
        self._moves: list[_Move] = []
        self._after = np.eye(4)
        for part in parts:
            if not isinstance(part, Joint):
                self._after = self._after @ part
                continue
            leader, multiplier, offset = led[part.name]
            # What is held goes with any joint, by 0.
            index = 0 if leader is None else self.joints.index(leader.name)
            before = self._after @ translation(part.anchor)
            self._moves.append(_Move(before, part.is_turn, part.axis, index, multiplier, offset - part.reference))
            self._after = translation(-part.anchor)

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        *,
        tip: str | None = None,
        base: str | None = None,
        jaw: str | None = None,
        jaw_range: Sequence[float] | None = None,
        shaft_axis: Sequence[float] = (0.0, 0.0, -1.0),
        roll_axis: Sequence[float] | None = None,
    ) -> Chain:
        """Reads a URDF (``<robot>``) or an MJCF file (``<mujoco>``).

        ``tip``: the link, body or site at the tool's tip, not needed where the robot has one end only (sites are ends, too); of a site
        and a body of one name the site is taken. ``base``: the link or body whose frame things are told in, the root if not given.
        ``jaw``: the joint that opens the jaws, on the chain or beside it. ``jaw_range``: where it is with jaws closed and wide open [rad,
        m], its lower and its upper limit if not given.
        ``shaft_axis``: the direction from the tip towards the handle in the axes of the tip, -z if not given: the z axis of most tools
        points out of the tip. ``roll_axis``: the direction in which the jaws open, there too: x if not given, y where the shaft is along
        x. Where it is not square to the shaft, its part that is counts.

        Raises KinematicsError. Types of joints that are read are revolute, continuous, prismatic and fixed (URDF), hinge and slide (MJCF);
        others may be beside the chain.
        """
        axes = tool_axes(shaft_axis, roll_axis)
        return cls(_read_robot(os.fspath(path)), tip, base, jaw, jaw_range, axes)

    def __repr__(self) -> str:
        return f"Chain({self.file!r}, {self.base!r} to {self.tip!r}, joints={list(self.joints)})"

    @property
    def limits(self) -> Floats:
        """Where each joint may be, (n, 2) [rad, m]."""
        return self._limits.copy()

    def frame(self, q: ArrayLike) -> Floats:
        """The frame of the tip in that of the base, (..., 4, 4) [m], of joints (..., n)."""
        return self._walk(self._joints_of(q))[0]

    def pose(self, q: ArrayLike, *, base: ArrayLike | None = None, trigger: ArrayLike = 0.0, near: ArrayLike | None = None) -> Floats:
        """The pose of the instrument, (..., 9), of joints (..., n): tip (3, m), shaft towards the handle (3), roll (rad), jaws, trigger.

        ``base`` (4, 4): places the robot in the patient's frame. ``trigger``: 0 to 1, for each or for all.
        ``near`` (..., 9): poses from which it goes on. Roll has as many whole turns as brings it closest to theirs: ``world.step`` leads
        roll straight there, and would turn an instrument the long way round from 3.1 to -3.1 rad. Without it roll is within half a turn.
        Jaws are 0 without a joint that opens them, and stay within 0 and 1 where it is beyond its range.

        Roll is as ``crates/glisson/src/tool/pose.rs`` has it: without roll, the axes of an instrument are those of one whose shaft points
        to the patient's front (-y; its jaws open along x), brought there by the shortest turn. Roll turns on about the shaft. They jump
        where a shaft points to the back (+y).
        """
        q = self._joints_of(q)
        shape = q.shape[:-1]
        patient_from_tip = frame_of(base, "base") @ self._walk(q)[0]
        tool = patient_from_tip[..., :3, :3] @ self._tip_from_tool
        pose = np.zeros((*shape, 9))
        pose[..., :3] = patient_from_tip[..., :3, 3]
        pose[..., 3:6] = tool[..., 2] / np.linalg.norm(tool[..., 2], axis=-1, keepdims=True)
        across = np.einsum("...ji,...j->...i", axes_without_roll(pose[..., 3:6]), tool[..., 0])
        pose[..., 6] = np.arctan2(across[..., 1], across[..., 0])
        if near is not None:
            before = numbers_of(near, "near")
            if before.shape not in ((9,), (*shape, 9)):
                raise KinematicsError(f"near has the shape {before.shape}; poses {(*shape, 9)} are expected, or one of them (9,)")
            pose[..., 6] += 2.0 * math.pi * np.round((before[..., 6] - pose[..., 6]) / (2.0 * math.pi))
        if self._jaw_range is not None:
            closed, wide = self._jaw_range
            pose[..., 7] = np.clip((q[..., -1] - closed) / (wide - closed), 0.0, 1.0)
        pressed = numbers_of(trigger, "trigger")
        if pressed.shape not in ((), shape) or np.any((pressed < 0.0) | (pressed > 1.0)):
            raise KinematicsError(f"trigger is {shown(trigger)}; a number from 0 to 1 is allowed, or an array {shape} of them")
        pose[..., 8] = pressed
        return pose

    def jacobian(self, q: ArrayLike) -> Floats:
        """How fast the tip moves and turns per speed of each joint, (..., 6, n): rows are the velocity [m/s] and the angular velocity
        [rad/s], in the axes of the base."""
        return self._frame_and_jacobian(self._joints_of(q))[1]

    def solve(
        self,
        target_pose: ArrayLike,
        q0: ArrayLike,
        *,
        base: ArrayLike | None = None,
        roll: bool = False,
        tolerance_m: float = 1e-7,
        tolerance_rad: float = 1e-7,
        max_iterations: int = 200,
        n_starts: int = 16,
    ) -> Floats:
        """Joints (n,) within their limits that bring tip and shaft to a pose (9,), and its roll, too, where ``roll`` is true.

        The joint of the jaws, if there is one, is where it opens them as wide as the pose says. ``base``: as in :meth:`pose`.
        From ``q0`` it goes downhill, which ends in the closest solution if ``q0`` is near one. Where that leads nowhere it starts again
        from ``n_starts - 1`` other places, spread evenly and always the same: the robot is then in another posture. With ``n_starts=1`` it
        goes from ``q0`` or not at all.

        Raises KinematicsError where the pose is not reached, with what is missing in mm and degrees.

        Method: damped least squares, as ``glisson.kinematics.inverse`` has it.
        """
        start, pose = self._joints_of(q0), numbers_of(target_pose, "target_pose")
        if start.shape != (len(self.joints),) or pose.shape != (9,):
            raise KinematicsError(
                f"q0 has the shape {start.shape}, target_pose {pose.shape}; ({len(self.joints)},) and (9,) are expected: one at a time"
            )
        shaft_length = float(np.linalg.norm(pose[3:6]))
        if shaft_length < SHORTEST:
            raise KinematicsError("the shaft of target_pose (its numbers 3 to 5) has no direction; a vector from tip to handle is expected")
        limits, chosen = self.limits, self.joints
        if self._jaw_range is not None:
            closed, wide = self._jaw_range
            limits[-1] = closed + float(np.clip(pose[7], 0.0, 1.0)) * (wide - closed)
            chosen = chosen[:-1]
        patient_from_base = frame_of(base, "base")
        if n_starts < 1:
            raise KinematicsError(f"n_starts is {n_starts}; at least 1 is needed")
        turn = patient_from_base[:3, :3]
        target = Target(
            tip_m=turn.T @ (pose[:3] - patient_from_base[:3, 3]),
            tool=turn.T @ axes_without_roll(pose[3:6] / shaft_length) @ turn_about(np.array([0.0, 0.0, 1.0]), pose[6]),
            has_roll=roll,
        )

        def look(q: Floats) -> Found:
            frame, jacobian = self._frame_and_jacobian(q)
            return target.missing(q, frame[:3, 3], frame[:3, :3] @ self._tip_from_tool, jacobian)

        tolerances = tolerance_m, tolerance_rad
        found = closest(look, starts(start, self.units, limits, n_starts), limits, tolerances, max_iterations)
        if found.is_within(*tolerances):
            return found.q
        at_limit = [name for name, x, ends in zip(chosen, found.q, limits, strict=False) if x in ends]
        raise KinematicsError(
            f"{self.file}: {self.tip!r} does not reach the pose: the closest that it comes is {1e3 * found.missing_m:.4g} mm and "
            f"{math.degrees(found.missing_rad):.4g} degrees away"
            + (f", with {', '.join(at_limit)} at a limit" if at_limit else "")
            + "; move the robot's base, give another q0, or ask for a pose within its reach"
        )

    def _joints_of(self, q: ArrayLike) -> Floats:
        numbers = numbers_of(q, "q")
        if numbers.shape[-1:] != (len(self.joints),):
            raise KinematicsError(
                f"q has the shape {numbers.shape}; (..., {len(self.joints)}) is expected: one number for each of {', '.join(self.joints)}"
            )
        return numbers

    def _walk(self, q: Floats) -> tuple[Floats, Floats, Floats]:
        """The frame of the tip (..., 4, 4), and the axes and the places (moves, ..., 3) of the joints on the way, in the frame of the
        base."""
        shape = q.shape[:-1]
        turn: Floats = np.broadcast_to(np.eye(3), (*shape, 3, 3))
        place_m: Floats = np.zeros((*shape, 3))
        axes, places_m = np.zeros((2, len(self._moves), *shape, 3))
        for k, move in enumerate(self._moves):
            place_m = place_m + turn @ move.before[:3, 3]
            turn = turn @ move.before[:3, :3]
            axes[k], places_m[k] = turn @ move.axis, place_m
            by = move.multiplier * q[..., move.index] + move.offset
            if move.is_turn:
                turn = turn @ turn_about(move.axis, by)
            else:
                place_m = place_m + axes[k] * by[..., None]
        frame = np.zeros((*shape, 4, 4))
        frame[..., :3, :3] = turn @ self._after[:3, :3]
        frame[..., :3, 3] = place_m + turn @ self._after[:3, 3]
        frame[..., 3, 3] = 1.0
        return frame, axes, places_m

    def _frame_and_jacobian(self, q: Floats) -> tuple[Floats, Floats]:
        frame, axes, places_m = self._walk(q)
        across = np.cross(axes, frame[..., :3, 3] - places_m)
        jacobian = np.zeros((*q.shape[:-1], 6, q.shape[-1]))
        for k, move in enumerate(self._moves):
            jacobian[..., :3, move.index] += move.multiplier * (across[k] if move.is_turn else axes[k])
            if move.is_turn:
                jacobian[..., 3:, move.index] += move.multiplier * axes[k]
        return frame, jacobian


@dataclass(frozen=True, eq=False)
class _Move:
    """What a joint does: after ``before`` (4, 4) comes a turn about ``axis`` or a way along it, by ``multiplier * q[index] + offset``."""

    before: Floats
    is_turn: bool
    axis: Floats
    index: int
    multiplier: float
    offset: float


def _read_robot(path: str) -> Robot:
    root = read_xml(Path(path))
    if root.tag == "robot":
        return Urdf(root)
    if root.tag == "mujoco":
        return Mjcf(root)
    raise KinematicsError(
        f"{root.file}: line {root.line}: the file is <{root.tag[:40]}>; <robot> (URDF) and <mujoco> (MJCF) are allowed: convert it to one"
    )


def _jaw_range(jaw: Joint, robot: Robot, given: Sequence[float] | None) -> tuple[float, float]:
    """Where a joint, which must be free, is with jaws closed and wide open."""
    leader, _, _ = robot.leader(jaw)
    if leader is None or leader.name != jaw.name:
        other = "is held in one place" if leader is None else f"follows {leader.name!r}: give that one"
        raise jaw.element.wrong(f"it is to open the jaws (jaw=), and {other}, or another joint that moves")
    if given is None:
        if not -math.inf < jaw.lower < jaw.upper < math.inf:
            raise jaw.element.wrong(
                f"it is to open the jaws (jaw=), and its limits are {jaw.lower:g} and {jaw.upper:g}; a finite range is needed: give it in "
                "the file, or as jaw_range=(closed, open)"
            )
        return jaw.lower, jaw.upper
    numbers = numbers_of(given, "jaw_range")
    if numbers.shape != (2,) or numbers[0] == numbers[1]:
        raise KinematicsError(f"jaw_range is {shown(given)}; two different numbers are expected: where jaws are closed, and open")
    return float(numbers[0]), float(numbers[1])
