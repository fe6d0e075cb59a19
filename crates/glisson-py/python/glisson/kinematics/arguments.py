"""Numbers that callers give: read, or refused."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from glisson.kinematics.errors import KinematicsError, shown
from glisson.kinematics.geometry import SHORTEST, Floats

#: How far the rows of a rotation may be off a right angle or the length 1: a matrix written with seven digits is one.
ROTATION_TOLERANCE = 1e-6


def numbers_of(value: ArrayLike, name: str) -> Floats:
    try:
        numbers = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise KinematicsError(f"{name} is {shown(value)}; numbers are expected") from None
    if not np.isfinite(numbers).all():
        raise KinematicsError(f"{name} has a number that is not finite: {shown(value)}")
    return numbers


def direction_of(value: ArrayLike, name: str) -> Floats:
    numbers = numbers_of(value, name)
    length = float(np.linalg.norm(numbers))
    if numbers.shape != (3,) or not SHORTEST < length < math.inf:
        raise KinematicsError(f"{name} is {shown(value)}; three numbers are expected that are not all 0")
    return numbers / length


def frame_of(matrix: ArrayLike | None, name: str) -> Floats:
    """A frame (4, 4); without one, that in which everything stays."""
    if matrix is None:
        return np.eye(4)
    frame = numbers_of(matrix, name)
    what = ""
    if frame.shape != (4, 4):
        what = f"has the shape {frame.shape}"
    elif frame[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
        what = f"has the last row {frame[3].tolist()}"
    elif np.abs(frame[:3, :3].T @ frame[:3, :3] - np.eye(3)).max() > ROTATION_TOLERANCE:
        what = "stretches or shears"
    elif np.linalg.det(frame[:3, :3]) < 0.0:
        what = "mirrors"
    if what:
        raise KinematicsError(f"{name} {what}; a (4, 4) is expected that turns and moves: a rotation, a place [m], the last row 0 0 0 1")
    return frame


def tool_axes(shaft_axis: Sequence[float], roll_axis: Sequence[float] | None) -> Floats:
    """The tool's axes in those of the tip, as columns: x the way its jaws open, y along their hinge, z towards the handle."""
    z = direction_of(shaft_axis, "shaft_axis")
    if roll_axis is None:
        roll_axis = (0.0, 1.0, 0.0) if abs(z[0]) > 1.0 - SHORTEST else (1.0, 0.0, 0.0)
    x = direction_of(roll_axis, "roll_axis")
    x = x - z * (x @ z)
    length = np.linalg.norm(x)
    if length < SHORTEST:
        raise KinematicsError(f"roll_axis is {shown(roll_axis)}, along the shaft {shown(shaft_axis)}; give one that is square to it")
    x = x / length
    return np.column_stack([x, np.cross(z, x), z])
