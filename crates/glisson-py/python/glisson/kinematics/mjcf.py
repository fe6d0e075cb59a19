"""MJCF."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from glisson.kinematics.errors import shown, unknown
from glisson.kinematics.geometry import SHORTEST, Floats, translation, turn_about, turn_of_quaternion
from glisson.kinematics.robot import Follows, Joint, Node, Robot, limits
from glisson.kinematics.xml import Element, by_name, read_xml

#: How MJCF says how something is turned, and in how many numbers.
_ORIENTATIONS = {"quat": 4, "axisangle": 4, "euler": 3, "xyaxes": 6, "zaxis": 3}


class Mjcf(Robot):
    """Joints of a body move it one after the other, each in the axes that those before it leave it with."""

    def __init__(self, root: Element) -> None:
        super().__init__(root, "body or site")
        _include(root)
        self._read_compiler(root)
        self._read_defaults(root)
        self._read_bodies(root)
        self._read_equalities(root)

    def _read_compiler(self, root: Element) -> None:
        settings = root.first_or_empty("compiler")
        for compiler in root.all("compiler"):
            settings = replace(compiler, attributes={**settings.attributes, **compiler.attributes})
        #: What angles of the file are multiplied with.
        self.radians = 1.0 if settings.one_of("angle", "degree", ("degree", "radian")) == "radian" else math.pi / 180.0
        self.autolimits = settings.one_of("autolimits", "true", ("true", "false")) == "true"
        if settings.one_of("coordinate", "local", ("local", "global")) == "global":
            raise settings.wrong("coordinate is 'global'; 'local' is allowed: open the file in MuJoCo 2.3.3 and save it")
        self.eulerseq = settings.attributes.get("eulerseq", "xyz")
        if len(self.eulerseq) != 3 or not set(self.eulerseq) <= set("xyzXYZ"):
            raise settings.wrong(f"eulerseq is {shown(self.eulerseq)}; three letters of xyz (turning axes) or XYZ (at rest) are allowed")

    def _read_defaults(self, root: Element) -> None:
        """Attributes of each class, by tag, and the class that it goes on from."""
        self.defaults: dict[str, dict[str, dict[str, str]]] = {"main": {}}
        self.upper_class: dict[str, str] = {}
        todo: list[tuple[Element, str | None]] = [(element, None) for element in reversed(root.all("default"))]
        while todo:
            element, upper = todo.pop()
            name = element.attributes.get("class", "main" if upper is None else "")
            if upper is not None:
                if not name or name in self.defaults:
                    raise element.wrong(f"its class is {shown(name)}; each needs a name of its own")
                self.defaults[name], self.upper_class[name] = {}, upper
            elif name != "main":
                raise element.wrong(f"its class is {shown(name)}; the outermost one is 'main': put this one into it")
            for child in element.children:
                if child.tag == "default":
                    todo.append((child, name))
                else:
                    self.defaults[name].setdefault(child.tag, {}).update(child.attributes)

    def _read_bodies(self, root: Element) -> None:
        """Bodies and sites, and the names of the joints of each body with the frames around them."""
        self.nodes.append(Node("body", "world", None, root))
        self.joints_of: dict[int, list[tuple[str, tuple[Element, ...]]]] = {}
        joints: list[tuple[Element, int, tuple[Element, ...]]] = []
        todo: list[tuple[Element, int, str, tuple[Element, ...]]] = [(world, 0, "main", ()) for world in reversed(root.all("worldbody"))]
        while todo:
            element, node, childclass, frames = todo.pop()
            if element.tag in ("replicate", "attach"):
                raise element.wrong("it makes parts that are not read; open the file in MuJoCo and save it, which writes them out")
            if element.tag in ("body", "site"):
                self.nodes.append(Node(element.tag, element.attributes.get("name") or None, node, element, childclass, frames))
                node, frames = len(self.nodes) - 1, ()
            elif element.tag == "frame":
                frames = (*frames, element)
            elif element.tag in ("joint", "freejoint"):
                if node == 0:
                    raise element.wrong("it is in the world; a joint is a body's: put it into one")
                joints.append((self._whole(element, childclass, "joint"), node, frames))
            if element.tag in ("worldbody", "body", "frame"):
                childclass = self._class_of(element, "childclass", childclass)
                todo += [(child, node, childclass, frames) for child in reversed(element.children)]
        for what in ("body", "site"):
            names = by_name(node.element for node in self.nodes[1:] if node.what == what and node.name is not None)
            if what == "body" and "world" in names:
                raise names["world"].wrong("only the world has this name; give the body another")
        self.joint_elements = by_name(element for element, _, _ in joints if element.attributes.get("name"))
        for element, node, frames in joints:
            of_body = self.joints_of.setdefault(node, [])
            if not element.attributes.get("name"):
                # A joint without a name has that of its body, and how many joints the body has before it.
                name = f"{self.nodes[node].name or f'body{node}'}.{len(of_body)}"
                while name in self.joint_elements:
                    name += "_"
                element.attributes["name"] = name
                self.joint_elements[name] = element
            of_body.append((element.name(), frames))

    def _read_equalities(self, root: Element) -> None:
        """What leads each joint."""
        self.equalities: dict[str, list[Element]] = {}
        for section in root.all("equality"):
            for element in section.all("joint"):
                element = self._whole(element, "main", "equality")
                if element.one_of("active", "true", ("true", "false")) == "true":
                    self.equalities.setdefault(element.attributes.get("joint1", ""), []).append(element)

    def _class_of(self, element: Element, attribute: str, default: str) -> str:
        name = element.attributes.get(attribute, default)
        if name not in self.defaults:
            raise element.wrong(unknown("class", name, self.defaults))
        return name

    def _whole(self, element: Element, childclass: str, tag: str) -> Element:
        """The element with what its class says, and those above it."""
        name: str | None = self._class_of(element, "class", childclass)
        attributes = dict(element.attributes)
        while name is not None:
            upper = self.defaults[name].get(tag, {})
            if not attributes.keys().isdisjoint(_ORIENTATIONS):
                upper = {key: value for key, value in upper.items() if key not in _ORIENTATIONS}
            attributes = {**upper, **attributes}
            name = self.upper_class.get(name)
        return replace(element, attributes=attributes)

    def parts(self, node: int) -> list[Floats | Joint]:
        found = self.nodes[node]
        element = found.element if found.what == "body" else self._whole(found.element, found.childclass, "site")
        if found.what == "site" and "fromto" in element.attributes:
            raise element.wrong("it has fromto; a tip has pos and quat: give a site of its own")
        parts: list[Floats | Joint] = [self._frame([*found.frames, element])]
        for name, frames in self.joints_of.get(node, ()):
            joint = self.joint(name)
            frame = self._frame(frames)
            parts.append(replace(joint, axis=frame[:3, :3] @ joint.axis, anchor=frame[:3, 3] + frame[:3, :3] @ joint.anchor))
        return parts

    def _frame(self, elements: Iterable[Element]) -> Floats:
        """Where elements lie, each in the one before it."""
        frame = np.eye(4)
        for element in elements:
            own = translation(element.numbers("pos"))
            given = [key for key in _ORIENTATIONS if key in element.attributes]
            if len(given) > 1:
                raise element.wrong(f"it has {' and '.join(given)}; one of them is allowed")
            if given:
                own[:3, :3] = self._orientation(element, given[0])
            frame = frame @ own
        return frame

    def _orientation(self, element: Element, kind: str) -> Floats:
        numbers = element.numbers(kind, (0.0,) * _ORIENTATIONS[kind])
        if kind == "quat":
            return turn_of_quaternion(element.unit(kind, numbers))
        if kind == "axisangle":
            return turn_about(element.unit(kind, numbers[:3]), numbers[3] * self.radians)
        if kind == "xyaxes":
            x = element.unit(kind, numbers[:3])
            y = element.unit(kind, numbers[3:])
            y = element.unit(kind, y - x * (x @ y))
            return np.column_stack([x, y, np.cross(x, y)])
        if kind == "zaxis":
            # By the shortest turn, to -z about x.
            z = element.unit(kind, numbers)
            sine = math.hypot(z[0], z[1])
            axis = np.array([1.0, 0.0, 0.0]) if sine < SHORTEST else np.array([-z[1], z[0], 0.0]) / sine
            return turn_about(axis, math.atan2(sine, z[2]))
        turn: Floats = np.eye(3)
        for letter, angle in zip(self.eulerseq, numbers * self.radians, strict=True):
            by = turn_about(np.eye(3)["xyz".index(letter.lower())], angle)
            turn = turn @ by if letter.islower() else by @ turn
        return turn

    def read_joint(self, element: Element) -> Joint:
        kind = "free" if element.tag == "freejoint" else element.one_of("type", "hinge", ("hinge", "slide", "ball", "free"))
        if kind not in ("hinge", "slide"):
            raise element.wrong(
                f"its type is {kind!r}; hinge and slide are allowed: split it into several joints, or give the body that it moves as base="
            )
        unit = 1.0 if kind == "slide" else self.radians
        axis = element.unit("axis", element.numbers("axis", (0.0, 0.0, 1.0)))
        lower, upper = (unit * element.numbers("range", (0.0, 0.0), greatest=math.inf)).tolist()
        limited = element.one_of("limited", "auto", ("auto", "true", "false"))
        has_range = (lower, upper) != (0.0, 0.0)
        if limited == "auto" and has_range and not self.autolimits:
            raise element.wrong("it has a range, and autolimits is off; say whether it counts: limited=, true or false")
        if limited == "true" or (limited == "auto" and has_range):
            if lower >= upper:
                raise element.wrong(f"its range is {lower:g} to {upper:g} (rad or m); the first number must be below the second")
            lower, upper = limits(lower, upper)
        else:
            lower, upper = -math.inf, math.inf
        return Joint(
            element.name(), kind == "hinge", axis, lower, upper, element, element.numbers("pos"), unit * element.number("ref", 0.0)
        )

    def follows(self, joint: Joint) -> Follows | None:
        """An equality is q1 - ref1 = a0 + a1 (q2 - ref2) + ..., its numbers in rad and m whatever the compiler's angle is."""
        equalities = self.equalities.get(joint.name, [])
        if not equalities:
            return None
        if len(equalities) > 1:
            lines = ", ".join(str(element.line) for element in equalities)
            raise joint.element.wrong(f"the equalities in lines {lines} all lead it; one is allowed: take the others out")
        equality = equalities[0]
        polynomial = np.array([0.0, 1.0, 0.0, 0.0, 0.0])
        given = equality.numbers("polycoef", polynomial.tolist(), least=1)
        polynomial[: len(given)] = given
        leader = equality.attributes.get("joint2")
        if leader is None:
            return None, 0.0, joint.reference + polynomial[0]
        if polynomial[2:].any():
            raise joint.element.wrong(
                f"the equality in line {equality.line} leads it by the polynomial {polynomial.tolist()}; two numbers (a0 + a1 x) are "
                "allowed, the rest 0"
            )
        if leader not in self.joint_elements:
            raise joint.element.wrong(f"the equality in line {equality.line}: {unknown('joint', leader, self.joint_elements)}")
        offset = joint.reference + polynomial[0] - polynomial[1] * self.joint(leader).reference
        return leader, float(polynomial[1]), float(offset)


def _include(root: Element) -> None:
    """Puts what is in other files in the place of ``include``. A file is looked for beside the main one, else beside the one that names it;
    each may be included once."""
    folder = Path(root.file).parent
    seen = {os.path.realpath(root.file)}
    todo = [root]
    while todo:
        element = todo.pop()
        children: list[Element] = []
        waiting = element.children[::-1]
        while waiting:
            child = waiting.pop()
            if child.tag != "include":
                children.append(child)
                continue
            name = child.attributes.get("file", "")
            if not name:
                raise child.wrong("it names no file; give it: file=")
            path = folder / name
            if not os.path.exists(path):
                path = Path(child.file).parent / name
            if (real := os.path.realpath(path)) in seen:
                raise child.wrong(f"{shown(name)} is included already; a file may be included once")
            seen.add(real)
            waiting += read_xml(path, child).children[::-1]
        element.children = children
        todo += children
