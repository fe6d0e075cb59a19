"""XML as both formats need it: elements that know their line, and read their attributes or say what is wrong with them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

import numpy as np

from glisson.kinematics.errors import KinematicsError, shown
from glisson.kinematics.geometry import SHORTEST, Floats

#: How deep elements of a file may lie in each other, and how large a file may be: no robot comes near.
MAX_DEPTH = 256
MAX_BYTES = 64 * 2**20
#: Places [m], angles and factors beyond this are slips of the pen; a limit beyond it is none (exporters write 1e16 for "no limit").
MAX_NUMBER = 1e6

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


@dataclass(eq=False)
class Element:
    tag: str
    attributes: dict[str, str]
    file: str
    line: int
    children: list[Element] = field(default_factory=list)

    def all(self, tag: str) -> list[Element]:
        return [child for child in self.children if child.tag == tag]

    def first(self, tag: str) -> Element | None:
        return next(iter(self.all(tag)), None)

    def first_or_empty(self, tag: str) -> Element:
        return self.first(tag) or Element(tag, {}, self.file, self.line)

    def wrong(self, what: str) -> KinematicsError:
        name = self.attributes.get("name")
        of = f" {shown(name)}" if name else ""
        return KinematicsError(f"{self.file}: line {self.line}: {self.tag}{of}: {what}")

    def name(self) -> str:
        name = self.attributes.get("name")
        if not name:
            raise self.wrong("it has no name; give it one")
        return name

    def one_of(self, attribute: str, default: str, allowed: Sequence[str]) -> str:
        value = self.attributes.get(attribute, default)
        if value not in allowed:
            raise self.wrong(f"{attribute} is {shown(value)}; {', '.join(allowed)} are allowed")
        return value

    def numbers(
        self, attribute: str, default: Sequence[float] = (0.0, 0.0, 0.0), *, least: int = 0, greatest: float = MAX_NUMBER
    ) -> Floats:
        """As many numbers as ``default`` has, or from ``least`` to as many."""
        text = self.attributes.get(attribute)
        if text is None:
            return np.array(default, dtype=np.float64)
        words, n = text.split(), len(default)
        some = f"{least} to {n} numbers are" if least else ("a number is" if n == 1 else f"{n} numbers are")
        if not (least or n) <= len(words) <= n:
            raise self.wrong(f"{attribute} is {shown(text)}; {some} expected")
        for word in words:
            if not _NUMBER.fullmatch(word) or math.isinf(float(word)) or abs(float(word)) > greatest:
                at_most = "" if math.isinf(greatest) else f" of at most {greatest:g}"
                raise self.wrong(f"{attribute} has {shown(word)}; {some} expected, finite ones{at_most}")
        return np.array([float(word) for word in words])

    def number(self, attribute: str, default: float, *, greatest: float = MAX_NUMBER) -> float:
        return float(self.numbers(attribute, (default,), greatest=greatest)[0])

    def unit(self, attribute: str, numbers: Floats) -> Floats:
        """Numbers of an attribute as a vector of length 1."""
        length = float(np.linalg.norm(numbers))
        if length < SHORTEST:
            found = shown(self.attributes.get(attribute, ""))
            raise self.wrong(f"{attribute} is {found}, which has no direction; give one that is not 0")
        return numbers / length


def by_name(elements: Iterable[Element]) -> dict[str, Element]:
    found: dict[str, Element] = {}
    for element in elements:
        other = found.setdefault(element.name(), element)
        if other is not element:
            raise element.wrong(f"another one in line {other.line} has the same name; give each its own")
    return found


def read_xml(path: Path, told_by: Element | None = None) -> Element:
    """The root element of a file, which ``told_by`` names. Document types are refused: what they declare (entities) can grow without
    end."""
    file = str(path)
    wrong: Callable[[str], KinematicsError] = KinematicsError if told_by is None else told_by.wrong
    text: bytes | None = None
    try:
        if path.is_file():
            with open(path, "rb") as opened:
                text = opened.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        raise wrong(f"{file}: it cannot be read: {error}") from None
    if text is None:
        raise wrong(f"{file}: there is no such file; a URDF or an MJCF file is expected")
    if len(text) > MAX_BYTES:
        raise wrong(
            f"{file}: it is larger than {MAX_BYTES // 2**20} MiB; a description of a robot is expected, meshes are files of their own"
        )

    parser = expat.ParserCreate()
    around = Element("", {}, file, 0)
    open_elements = [around]

    def wrong_here(what: str) -> KinematicsError:
        return KinematicsError(f"{file}: line {parser.CurrentLineNumber}: {what}")

    def start(tag: str, attributes: dict[str, str]) -> None:
        if len(open_elements) > MAX_DEPTH:
            raise wrong_here(f"elements lie more than {MAX_DEPTH} deep in each other; a robot of fewer parts is expected")
        element = Element(tag, attributes, file, parser.CurrentLineNumber)
        open_elements[-1].children.append(element)
        open_elements.append(element)

    def declares(*_: object) -> None:
        raise wrong_here("it declares a document type, which is not read; take <!DOCTYPE ...> out, with the <!ENTITY ...> in it")

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: open_elements.pop()
    parser.StartDoctypeDeclHandler = declares
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise KinematicsError(f"{file}: line {error.lineno}: it is no XML: {expat.ErrorString(error.code)}; mend it there") from None
    except KinematicsError:
        raise
    except (ValueError, LookupError) as error:
        raise wrong_here(f"its encoding cannot be read ({error}); write it in UTF-8") from None
    return around.children[0]
