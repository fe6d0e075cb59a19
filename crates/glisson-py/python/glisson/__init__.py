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

import importlib
import json
import os
from collections.abc import Mapping
from typing import Any

from glisson._glisson import (
    MAX_TOOLS,
    POSE_LENGTH,
    Image,
    Labels,
    Mesh,
    MeshError,
    Saved,
    Scene,
    SceneError,
    Series,
    SimulationError,
    Solution,
    Surface,
    World,
    Worlds,
    __version__,
    check,
    mesh,
    replay_session,
    run_program,
    segment,
    solve,
    surface_of,
    task_names,
    validate,
    validation_groups,
)
from glisson._plain import plain

__all__ = [
    "MAX_TOOLS",
    "POSE_LENGTH",
    "Image",
    "Labels",
    "Mesh",
    "MeshError",
    "Saved",
    "Scene",
    "SceneError",
    "Series",
    "SimulationError",
    "Solution",
    "Surface",
    "World",
    "Worlds",
    "__version__",
    "check",
    "mesh",
    "replay_session",
    "run_program",
    "scene_from_dict",
    "segment",
    "solve",
    "surface_of",
    "task_names",
    "validate",
    "validation_groups",
    "vary",
]


#: Modules that come when they are asked for: what they need is not needed otherwise.
_MODULES = ("cohorts", "envs", "interchange", "kinematics", "notebook", "viewer")


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return importlib.import_module(f"glisson.{name}")
    raise AttributeError(f"module 'glisson' has no attribute {name!r}")


def scene_from_dict(scene: Mapping[str, Any], folder: str | os.PathLike[str] = ".") -> Scene:
    """A scene from a dictionary of the same keys and values as a scene file.

    Files that it names are relative to ``folder``. Raises SceneError where the scene cannot be read, TypeError where a value is nothing
    that a scene file can hold.
    """
    return Scene._from_json(json.dumps(scene, default=plain, allow_nan=False), folder)


def vary(scene: Scene, values: Mapping[str, Any] | None = None, *, patient: int | None = None) -> Scene:
    """A scene with other values, or of another synthetic patient.

    ``values``: keys are paths into the scene file, with dots between the names of tables and the numbers of what is in lists, counted from
    0: ``{"organ.damping": "5 1/s", "tool.0.tip_radius": "4 mm"}``. The last name of a path may be one that the file has not yet.
    ``patient``: the seed of the synthetic patient of the scene's organs, also one that the scene's task does not offer.

    Raises SceneError where a path leads to nothing, or the scene that comes of it cannot be read.
    """
    return scene._varied(json.dumps(list((values or {}).items()), default=plain, allow_nan=False), patient)
