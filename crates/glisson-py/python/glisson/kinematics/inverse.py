"""Inverse kinematics: joints that bring a tool where it is wanted.

Method: damped least squares, (J^T J + d diag(J^T J)) dq = J^T r, J (6, n) the Jacobian and r (6,) what is missing, in lengths of
``LENGTH_M`` and rad; d falls after a step that comes closer, and rises otherwise (Y. Nakamura, H. Hanafusa, "Inverse kinematic solutions
with singularity robustness for robot manipulator control", 1986, doi 10.1115/1.3143764; D. Marquardt, 1963, doi 10.1137/0111030). A joint
at a limit that would go on beyond it is left out of a step. Where roll is free, J and r are without their parts about the shaft.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from glisson.kinematics.geometry import Floats, rotation_vector_rad, shortest_turn_rad

#: A turn by one radian weighs as much as this way [m]: about the reach of an instrument's wrist.
LENGTH_M = 0.1
#: Damping of steps: the least is above rounding, so that a joint without effect stays; beyond the greatest no step helps.
FIRST_DAMPING, LEAST_DAMPING, GREATEST_DAMPING = 1e-3, 1e-12, 1e12
#: How far from where it was first a joint without limits is started again, by its unit.
WITHOUT_LIMITS = {"rad": math.pi, "m": 0.2}


@dataclass(frozen=True, eq=False)
class Found:
    """Joints, and what is missing with them: as a length and an angle, and as six numbers with their (negative) derivative."""

    q: Floats
    missing_m: float
    missing_rad: float
    missing: Floats
    jacobian: Floats

    @property
    def cost(self) -> float:
        return float(self.missing @ self.missing)

    def is_within(self, tolerance_m: float, tolerance_rad: float) -> bool:
        return self.missing_m <= tolerance_m and self.missing_rad <= tolerance_rad


@dataclass(frozen=True, eq=False)
class Target:
    """Where the tip is to be, and the axes of the tool there (columns; the shaft is the third), in the frame of the base."""

    tip_m: Floats
    tool: Floats
    has_roll: bool

    def missing(self, q: Floats, tip_m: Floats, tool: Floats, jacobian: Floats) -> Found:
        """What is missing with joints that bring the tip and the axes where they are given. The Jacobian is changed."""
        way_m = self.tip_m - tip_m
        if self.has_roll:
            turn_rad = rotation_vector_rad(self.tool @ tool.T)
        else:
            shaft = tool[:, 2]
            turn_rad = shortest_turn_rad(shaft, self.tool[:, 2])
            jacobian[3:] -= np.outer(shaft, shaft @ jacobian[3:])
        jacobian[:3] /= LENGTH_M
        missing = np.concatenate([way_m / LENGTH_M, turn_rad])
        return Found(q, float(np.linalg.norm(way_m)), float(np.linalg.norm(turn_rad)), missing, jacobian)


def starts(q0: Floats, units: Sequence[str], limits: Floats, n: int) -> Iterator[Floats]:
    """``q0``, the middle, and places in between: a sequence of Kronecker in n dimensions, the powers of the root of x^(n+1) = x + 1."""
    around = np.array([WITHOUT_LIMITS[unit] for unit in units])
    lower = np.where(np.isfinite(limits[:, 0]), limits[:, 0], np.minimum(q0, limits[:, 1]) - around)
    upper = np.where(np.isfinite(limits[:, 1]), limits[:, 1], np.maximum(q0, limits[:, 0]) + around)
    root = 2.0
    for _ in range(64):
        root = (1.0 + root) ** (1.0 / (len(q0) + 1))
    steps = root ** -np.arange(1.0, len(q0) + 1.0)
    for k in range(n):
        yield q0 if k == 0 else lower + (upper - lower) * ((0.5 + (k - 1) * steps) % 1.0)


def closest(
    look: Callable[[Floats], Found], places: Iterable[Floats], limits: Floats, tolerances: tuple[float, float], max_iterations: int
) -> Found:
    """Goes downhill from one place after the other, until one way ends within the tolerances [m, rad]; else the best of all ends."""
    ends = []
    for q in places:
        ends.append(_descend(look, q, limits, tolerances, max_iterations))
        if ends[-1].is_within(*tolerances):
            return ends[-1]
    return min(ends, key=lambda end: end.cost)


def _descend(look: Callable[[Floats], Found], q: Floats, limits: Floats, tolerances: tuple[float, float], max_iterations: int) -> Found:
    lower, upper = limits[:, 0], limits[:, 1]
    damping = FIRST_DAMPING
    now = look(np.clip(q, lower, upper))
    for _ in range(max_iterations):
        if now.is_within(*tolerances) or damping > GREATEST_DAMPING:
            break
        downhill = now.jacobian.T @ now.missing
        free = ~(((now.q <= lower) & (downhill <= 0.0)) | ((now.q >= upper) & (downhill >= 0.0)))
        square = now.jacobian[:, free].T @ now.jacobian[:, free]
        stiffness = np.diag(square)
        greatest = stiffness.max(initial=0.0)
        if greatest == 0.0:
            break
        step = np.zeros_like(now.q)
        step[free] = np.linalg.solve(square + np.diag(damping * stiffness + LEAST_DAMPING * greatest), downhill[free])
        then = look(np.clip(now.q + step, lower, upper))
        if then.cost < now.cost:
            now, damping = then, max(0.1 * damping, LEAST_DAMPING)
        else:
            damping *= 10.0
    return now
