"""Directions, turns and frames. A turn is a rotation matrix (..., 3, 3), a frame a matrix (..., 4, 4) of a turn and a place [m]."""

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats: TypeAlias = NDArray[np.float64]

#: Shorter vectors have no direction, and vectors that are parallel to within this sine span no plane.
SHORTEST = 1e-9


def translation(place_m: Floats) -> Floats:
    frame = np.eye(4)
    frame[:3, 3] = place_m
    return frame


def cross_matrix(v: Floats) -> Floats:
    """Matrices (..., 3, 3) of cross products with vectors (..., 3)."""
    cross = np.zeros((*v.shape, 3))
    cross[..., 2, 1], cross[..., 0, 2], cross[..., 1, 0] = v[..., 0], v[..., 1], v[..., 2]
    return cross - np.swapaxes(cross, -1, -2)


def turn_about(axis: Floats, angle_rad: ArrayLike) -> Floats:
    """Turns (..., 3, 3) by angles (...) about a unit vector (Rodrigues' formula)."""
    angle_rad = np.asarray(angle_rad, dtype=np.float64)[..., None, None]
    cross = cross_matrix(axis)
    turn: Floats = np.eye(3) + np.sin(angle_rad) * cross + (1.0 - np.cos(angle_rad)) * (cross @ cross)
    return turn


def turn_of_quaternion(wxyz: Floats) -> Floats:
    """The turn of a unit quaternion."""
    cross = cross_matrix(wxyz[1:])
    turn: Floats = np.eye(3) + 2.0 * (wxyz[0] * cross + cross @ cross)
    return turn


def axes_without_roll(shaft: Floats) -> Floats:
    """Axes (..., 3, 3), as columns, of tools without roll with shafts (..., 3): ``ToolFrame::of`` in crates/glisson/src/tool/pose.rs."""
    front = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    cosine = shaft @ front[:, 2]
    has_no_shortest = cosine < -1.0 + 1e-12
    cross = cross_matrix(np.cross(front[:, 2], shaft))
    share = 1.0 / (1.0 + np.where(has_no_shortest, 0.0, cosine))
    turn = np.eye(3) + cross + cross @ cross * share[..., None, None]
    # Half a turn about the patient's long axis.
    axes: Floats = np.where(has_no_shortest[..., None, None], np.diag([-1.0, -1.0, 1.0]), turn) @ front
    return axes


def shortest_turn_rad(start: Floats, end: Floats) -> Floats:
    """The rotation vector that brings a unit vector to another; of opposite ones, one of many."""
    across: Floats = cross_matrix(start) @ end
    sine, cosine = float(np.linalg.norm(across)), float(start @ end)
    if sine < SHORTEST:
        if cosine > 0.0:
            return across
        across = cross_matrix(start) @ np.eye(3)[np.argmin(np.abs(start))]
    return across * (math.atan2(sine, cosine) / float(np.linalg.norm(across)))


def rotation_vector_rad(turn: Floats) -> Floats:
    """The rotation vector of a turn, of length pi at most: ``rotation_vector_rad`` in crates/glisson/src/tool/pose.rs."""
    skew = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    sine, cosine = float(np.linalg.norm(skew)), float(np.trace(turn)) - 1.0
    if sine > SHORTEST:
        return skew / sine * math.atan2(sine, cosine)
    if cosine > 0.0:
        return 0.5 * skew
    # Half a turn: the axis is what it leaves as it is.
    both = turn + np.eye(3)
    lengths = np.linalg.norm(both, axis=0)
    axis: Floats = both[:, np.argmax(lengths)] / lengths.max()
    return axis * math.atan2(sine, cosine)
