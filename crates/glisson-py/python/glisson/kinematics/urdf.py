"""URDF."""

from __future__ import annotations

import math

import numpy as np

from glisson.kinematics.errors import listed, shown, unknown
from glisson.kinematics.geometry import Floats, translation, turn_about, turn_of_quaternion
from glisson.kinematics.robot import Follows, Joint, Node, Robot, limits
from glisson.kinematics.xml import Element, by_name


class Urdf(Robot):
    """A joint lies in the origin of its child, ``origin`` is rpy about fixed axes: first roll about x, then pitch, then yaw."""

    def __init__(self, root: Element) -> None:
        super().__init__(root, "link")
        for element in root.children:
            if element.tag.startswith("xacro:"):
                raise element.wrong("the file is a xacro, not yet a URDF; make one of it: xacro FILE > robot.urdf")
        links = by_name(root.all("link"))
        self.joint_elements = by_name(root.all("joint"))
        if not links:
            raise root.wrong("it has no link; links and joints are expected")
        above: dict[str, Element] = {}
        below: dict[str, list[Element]] = {}
        for joint in self.joint_elements.values():
            for end in ("parent", "child"):
                if (link := _end(joint, end)) not in links:
                    raise joint.wrong(f"its {end}: {unknown('link', link, links)}")
            child = _end(joint, "child")
            if child in above:
                other = above[child].name()
                raise joint.wrong(f"its child {child!r} has a parent already, by joint {other!r}; a link has one: take a joint out")
            above[child] = joint
            below.setdefault(_end(joint, "parent"), []).append(joint)
        roots = [name for name in links if name not in above]
        if len(roots) > 1:
            raise root.wrong(f"it has {len(roots)} links without a parent: {listed(roots)}; one is expected: join the others to it")
        # From the root to the ends; what is not come to is in a ring.
        todo: list[tuple[str, int | None, Element]] = [(name, None, links[name]) for name in roots]
        while todo:
            name, parent, element = todo.pop()
            self.nodes.append(Node("link", name, parent, element))
            todo += [(_end(joint, "child"), len(self.nodes) - 1, joint) for joint in below.get(name, ())]
        ring = set(links) - {node.name for node in self.nodes}
        if ring:
            raise root.wrong(f"links carry each other in a ring: {listed(sorted(ring))}; a robot is a tree: take a joint out")

    def parts(self, node: int) -> list[Floats | Joint]:
        element = self.nodes[node].element
        origin = element.first_or_empty("origin")
        frame = translation(origin.numbers("xyz"))
        if "quat_xyzw" in origin.attributes:
            if "rpy" in origin.attributes:
                raise element.wrong("its origin has rpy and quat_xyzw; give one of them")
            xyzw = origin.unit("quat_xyzw", origin.numbers("quat_xyzw", (0.0, 0.0, 0.0, 1.0)))
            frame[:3, :3] = turn_of_quaternion(np.roll(xyzw, 1))
        else:
            x, y, z = np.eye(3)
            roll, pitch, yaw = origin.numbers("rpy")
            frame[:3, :3] = turn_about(z, yaw) @ turn_about(y, pitch) @ turn_about(x, roll)
        if element.attributes.get("type") == "fixed":
            return [frame]
        return [frame, self.read_joint(element)]

    def read_joint(self, element: Element) -> Joint:
        kind = element.attributes.get("type", "")
        if kind not in ("revolute", "continuous", "prismatic"):
            raise element.wrong(
                f"its type is {shown(kind)}; revolute, continuous, prismatic and (on the way to the tip) fixed are allowed: split it into "
                "several joints, or give a base= behind it"
            )
        lower, upper = -math.inf, math.inf
        if kind != "continuous":
            limit = element.first("limit")
            if limit is None:
                raise element.wrong(f"it is {kind} and has no limit; give <limit lower= upper=>, or make it continuous")
            lower, upper = (limit.number(end, 0.0, greatest=math.inf) for end in ("lower", "upper"))
            if lower > upper:
                raise element.wrong(f"its limits are {lower:g} to {upper:g}; lower must not be above upper: swap them")
            lower, upper = limits(lower, upper)
        axis = element.first_or_empty("axis")
        direction = axis.unit("xyz", axis.numbers("xyz", (1.0, 0.0, 0.0)))
        return Joint(element.name(), kind != "prismatic", direction, lower, upper, element)

    def follows(self, joint: Joint) -> Follows | None:
        mimic = joint.element.first("mimic")
        if mimic is None:
            return None
        if "joint" not in mimic.attributes:
            raise joint.element.wrong('its mimic names no joint; give it: <mimic joint="..."/>')
        return mimic.attributes["joint"], mimic.number("multiplier", 1.0), mimic.number("offset", 0.0)


def _end(joint: Element, end: str) -> str:
    """The link that is the parent or the child of a joint."""
    link = joint.first_or_empty(end).attributes.get("link")
    if link is None:
        raise joint.wrong(f'it has no {end}; give it: <{end} link="..."/>')
    return link
