"""What is told where something is wrong."""

import difflib
from collections.abc import Iterable, Sequence


class KinematicsError(ValueError):
    """A file that is no robot, a name that is not in it, numbers of a wrong shape, or a pose that is out of reach. It says where, what was
    found, what is allowed and what to do."""


def shown(value: object) -> str:
    """A value as it was given, cut off where it is long."""
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


def listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - 20} more" if len(names) > 20 else ""
    return (", ".join(names[:20]) or "none") + more


def unknown(what: str, name: str, known: Iterable[str]) -> str:
    """That there is no such thing, what was probably meant, and what there is."""
    names = list(known)
    close = difflib.get_close_matches(name, names, 1)
    meant = f", probably {close[0]!r} is meant" if close else ""
    return f"there is no {what} {shown(name)}{meant}; there are {listed(names)}"
