"""Glisson: real-time soft-tissue surgery simulation.

A scene (a file, a text, a dictionary, a task of the program) says what there is; a world is one of it in time; worlds are many, stepped on
threads. Arrays are SI, in the patient frame LPS (x to the patient's left, y to the back, z to the head)::

    import glisson

    scene = glisson.Scene.task("grasp_and_lift")
    with glisson.World(scene) as world:
        poses = world.poses.copy()          # (instruments, 9): tip, shaft, roll, jaws, trigger
        poses[0, 2] += 0.02                 # the first one 20 mm towards the head
        world.step(50, poses)               # straight there, in 50 steps
        print(world.time_s, world.forces_n[0], world.hash())
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any

from glisson._glisson import (
    MAX_TOOLS,
    POSE_LENGTH,
    Saved,
    Scene,
    SceneError,
    SimulationError,
    World,
    Worlds,
    __version__,
    task_names,
)

__all__ = [
    "MAX_TOOLS",
    "POSE_LENGTH",
    "Saved",
    "Scene",
    "SceneError",
    "SimulationError",
    "World",
    "Worlds",
    "__version__",
    "scene_from_dict",
    "task_names",
]


def _plain(value: Any) -> Any:
    """What JSON does not know: numbers and arrays of numpy, paths."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    raise TypeError(f"a scene cannot hold a {type(value).__name__}: {value!r}")


def scene_from_dict(scene: Mapping[str, Any], folder: str | os.PathLike[str] = ".") -> Scene:
    """A scene from a dictionary of the same keys and values as a scene file.

    Files that it names are relative to ``folder``. Raises SceneError where the scene cannot be read, TypeError where a value is nothing
    that a scene file can hold.
    """
    return Scene._from_json(json.dumps(scene, default=_plain, allow_nan=False), folder)
