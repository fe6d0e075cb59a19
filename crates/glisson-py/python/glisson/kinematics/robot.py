"""What robots of both formats are: a tree of nodes with joints between them."""

from __future__ import annotations

import abc
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from glisson.kinematics.errors import KinematicsError, listed, unknown
from glisson.kinematics.geometry import Floats
from glisson.kinematics.xml import MAX_NUMBER, Element


@dataclass(frozen=True, eq=False)
class Joint:
    """A turn about ``axis`` through ``anchor`` [m], or a way along it, of as much as the joint is beyond ``reference``."""

    name: str
    is_turn: bool
    axis: Floats
    lower: float
    upper: float
    element: Element
    anchor: Floats = field(default_factory=lambda: np.zeros(3))
    reference: float = 0.0


@dataclass(frozen=True, eq=False)
class Node:
    """A link, a body or a site, and the element that says where it is on its parent."""

    what: str
    name: str | None
    parent: int | None
    element: Element
    #: MJCF: the class of what is in it, frames around it.
    childclass: str = "main"
    frames: tuple[Element, ...] = ()


#: How a joint follows another: who leads it (nobody: it is held in one place), the multiplier and the offset.
Follows: TypeAlias = tuple[str | None, float, float]


class Robot(abc.ABC):
    """A tree of links or bodies, the root first. Numbers of what is not on a chain are not looked at."""

    def __init__(self, root: Element, what: str) -> None:
        self.file, self.what = root.file, what
        self.nodes: list[Node] = []
        self.joint_elements: dict[str, Element] = {}

    @abc.abstractmethod
    def parts(self, node: int) -> list[Floats | Joint]:
        """What is between the parent of a node and itself: frames (4, 4) and joints."""

    @abc.abstractmethod
    def read_joint(self, element: Element) -> Joint: ...

    @abc.abstractmethod
    def follows(self, joint: Joint) -> Follows | None: ...

    def joint(self, name: str) -> Joint:
        if name not in self.joint_elements:
            raise KinematicsError(f"{self.file}: {unknown('joint', name, self.joint_elements)}")
        return self.read_joint(self.joint_elements[name])

    def leader(self, joint: Joint) -> tuple[Joint | None, float, float]:
        """Who leads a joint in the end (itself, if it is free; nobody, if it is held), and by what multiplier and offset."""
        multiplier, offset = 1.0, 0.0
        passed = [joint.name]
        while (follows := self.follows(joint)) is not None:
            name, by, shift = follows
            multiplier, offset = multiplier * by, offset + multiplier * shift
            if max(abs(multiplier), abs(offset)) > MAX_NUMBER:
                raise joint.element.wrong(f"a joint follows by {multiplier:g} times, {offset:g} more; at most {MAX_NUMBER:g} is allowed")
            if name is None:
                return None, 0.0, offset
            if name in passed:
                raise joint.element.wrong(f"joints follow each other in a ring: {', '.join([*passed, name])}; let one of them be free")
            if name not in self.joint_elements:
                raise joint.element.wrong(f"it follows another: {unknown('joint', name, self.joint_elements)}")
            passed.append(name)
            joint = self.joint(name)
        return joint, multiplier, offset

    def shown(self, node: int) -> str:
        found = self.nodes[node]
        return found.name if found.name is not None else f"a {found.what} without a name in line {found.element.line}"

    def tip(self, name: str | None) -> int:
        if name is not None:
            return self._find(name, ("site", "link", "body"))
        parents = {node.parent for node in self.nodes}
        ends = [k for k in range(len(self.nodes)) if k not in parents]
        if len(ends) != 1:
            names = listed([self.shown(k) for k in ends])
            raise KinematicsError(f"{self.file}: the robot has {len(ends)} ends: {names}; say which one is the tool's tip, with tip=")
        return ends[0]

    def base(self, name: str | None) -> int:
        return 0 if name is None else self._find(name, ("link", "body"))

    def _find(self, name: str, kinds: Sequence[str]) -> int:
        """The node of a name; of several, the one whose kind is first."""
        for kind in kinds:
            for k, node in enumerate(self.nodes):
                if (node.what, node.name) == (kind, name):
                    return k
        known = [node.name for node in self.nodes if node.name is not None and node.what in kinds]
        raise KinematicsError(f"{self.file}: {unknown(self.what, name, known)}")

    def way(self, base: int, tip: int) -> list[int]:
        """The nodes behind the base, up to the tip."""
        way: list[int] = []
        node: int | None = tip
        while node != base:
            if node is None:
                passed = listed([self.shown(k) for k in reversed(way)])
                raise KinematicsError(
                    f"{self.file}: {self.shown(tip)!r} is not on {self.shown(base)!r}; as base= one of these is allowed: {passed}"
                )
            way.append(node)
            node = self.nodes[node].parent
        return way[::-1]


def limits(lower: float, upper: float) -> tuple[float, float]:
    """Limits of a joint; far ones are none."""
    return lower if lower > -MAX_NUMBER else -math.inf, upper if upper < MAX_NUMBER else math.inf
