"""What JSON does not know, as what it knows."""

from __future__ import annotations

import os
from typing import Any


def plain(value: Any) -> Any:
    """Numbers and arrays of numpy, paths."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    raise TypeError(f"a scene cannot hold a {type(value).__name__}: {value!r}")
