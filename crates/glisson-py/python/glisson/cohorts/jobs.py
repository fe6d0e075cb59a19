"""What is to be done in a cohort, and one of its jobs done."""

from __future__ import annotations

import difflib
import functools
import hashlib
import inspect
import itertools
import json
import operator
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Union

from glisson import Scene, SceneError, SimulationError, World, _glisson, task_names, vary
from glisson._plain import plain

#: A value in a column of results.
Value = Union[str, int, float, bool, None]
#: From a scene to a row of results.
Run = Callable[[Scene], Mapping[str, Value]]
#: A task of the program, a scene file, a scene.
SceneLike = Union[str, "os.PathLike[str]", Scene]

#: Columns that say which job a row is of.
COLUMNS = ("job", "scene", "patient")


@dataclass(frozen=True)
class Job:
    """One scene with one patient and one choice of values."""

    number: int
    scene_name: str
    scene: Scene
    patient: int | None
    values: tuple[tuple[str, Any], ...]

    @property
    def columns(self) -> dict[str, Any]:
        """What a row says of it before its results."""
        chosen = {path: _column_value(value) for path, value in self.values}
        return {"job": self.number, "scene": self.scene_name, "patient": self.patient, **chosen}

    def key(self, run_name: str) -> str:
        """What its result depends on, as a hash: a result of the same key is taken from what is there. What is in files that the scene
        names does not count."""
        parts = [build(), run_name, self.scene_name, self.scene.text, os.fspath(self.scene.folder), self.patient, self.values]
        return hashlib.blake2b(json.dumps(parts, default=plain).encode(), digest_size=16).hexdigest()


@functools.cache
def build() -> str:
    """Which Glisson this is: a hash of its program."""
    with open(str(_glisson.__file__), "rb") as module:
        return hashlib.blake2b(module.read(), digest_size=16).hexdigest()


def jobs_of(
    scenes: Sequence[SceneLike] | Mapping[str, SceneLike],
    patients: Iterable[int] | None = None,
    values: Mapping[str, Sequence[Any]] | None = None,
) -> list[Job]:
    """Every scene with every patient and every choice of values, in this order; paths of values are sorted.

    ``patients`` are seeds of synthetic patients; without them scenes keep their own. ``values`` are those of :func:`glisson.vary`: several
    for each path. Raises SceneError where a scene cannot be read, ValueError and TypeError where jobs cannot be or would be the same.
    """
    named = _named(scenes)
    seeds = [None] if patients is None else [_seed(patient) for patient in patients]
    values = dict(sorted((values or {}).items()))
    for path, several in values.items():
        if path in (*COLUMNS, "error"):
            raise ValueError(f'"{path}" is a column of its own: as a path of values it cannot be told from that')
        if isinstance(several, (str, bytes)) or not isinstance(several, Sequence):
            raise TypeError(f'values["{path}"] is {several!r}; give a list of values, also of one')
        for value in several:
            _check_value(path, value)
    choices = [tuple(zip(values, choice)) for choice in itertools.product(*values.values())]
    all_of = itertools.product(named, seeds, choices)
    jobs = [Job(number, name, named[name], seed, choice) for number, (name, seed, choice) in enumerate(all_of)]
    if not jobs:
        raise ValueError("there is nothing to do: give a scene, a patient and a value of each path at least")
    seen: dict[str, Job] = {}
    for job in jobs:
        same = seen.setdefault(job.key(""), job)
        if same is not job:
            raise ValueError(f"jobs {same.number} and {job.number} are the same: {job.columns}")
    return jobs


def _named(scenes: Sequence[SceneLike] | Mapping[str, SceneLike]) -> dict[str, Scene]:
    if isinstance(scenes, (str, os.PathLike, Scene)):
        scenes = [scenes]
    if isinstance(scenes, Mapping):
        return {name: _scene(scene) for name, scene in scenes.items()}
    named: dict[str, Scene] = {}
    for like in scenes:
        name = like.name if isinstance(like, Scene) else Path(like).stem
        if name in named:
            raise ValueError(f'two scenes are called "{name}": give a dictionary of names to scenes')
        named[name] = _scene(like)
    return named


def _seed(patient: Any) -> int:
    try:
        seed = operator.index(patient)
    except TypeError:
        raise TypeError(f"a patient is {patient!r}; give whole numbers, the seeds of synthetic patients") from None
    if not 0 <= seed < 2**32:
        raise ValueError(f"a patient is {seed}; give seeds from 0 to {2**32 - 1}")
    return seed


def _check_value(path: str, value: Any) -> None:
    try:
        told = json.dumps(value, default=plain, allow_nan=False)
    except (TypeError, ValueError):
        told = "null"
    if told == "null":
        raise ValueError(f'a value of values["{path}"] is {value!r}; give what a scene file can hold: numbers, texts, lists, tables')


def _scene(like: SceneLike) -> Scene:
    if isinstance(like, Scene):
        # Its files are found from wherever it is taken up.
        return like._in_folder(os.path.abspath(like.folder))
    if isinstance(like, str) and like in task_names():
        return Scene.task(like)
    if not os.path.exists(like):
        close = difflib.get_close_matches(Path(like).name, task_names(), n=1)
        meant = f'; did you mean "{close[0]}"?' if close else ""
        raise SceneError(f'there is no task and no file "{os.fspath(like)}"{meant}; tasks: {", ".join(task_names())}')
    # On another machine of a cluster the folder is to be found by the same path.
    return Scene.load(os.path.abspath(like))


def _column_value(value: Any) -> Value:
    """As it stands in a column: numbers and texts are themselves, all else is JSON."""
    value = plain(value) if hasattr(value, "tolist") else value
    return value if isinstance(value, (str, int, float, bool)) else json.dumps(value, default=plain)


def do(job: Job, run: Run, asked_by: str) -> dict[str, Value]:
    """Does a job for a process that has the Glisson ``asked_by``: its results, or what went wrong as ``error``.

    Only what a scene or a simulation says counts as a result. What else goes wrong is the fault of ``run``, and is raised.
    """
    if build() != asked_by:
        raise RuntimeError("a worker has another Glisson than the process that asks it: install the same one on all machines")
    try:
        scene = vary(job.scene, dict(job.values), patient=job.patient)
        results = dict(run(scene))
    except (SceneError, SimulationError) as error:
        return {"error": str(error)}
    taken = {"error", *job.columns} & results.keys()
    if taken:
        raise ValueError(f"{name_of(run)} answers columns that a cohort has itself: {', '.join(sorted(taken))}")
    if not all(isinstance(name, str) for name in results):
        raise TypeError(f"{name_of(run)} answers columns {list(results)}; name them with texts")
    return {"error": None, **{name: None if value is None else _column_value(value) for name, value in results.items()}}


def name_of(run: Run) -> str:
    """What a function is called."""
    return f"{getattr(run, '__module__', '')}.{getattr(run, '__qualname__', type(run).__qualname__)}"


def known_name(run: Run, version: str) -> str:
    """By which name and version results of a function are known. What has no name that is its own needs a version."""
    name = name_of(run)
    if not version and (not inspect.isfunction(run) or "<" in name):
        raise ValueError(f'{name} may be several functions: give version="1", and another one where it does something else')
    return f"{name} {version}".strip()


def demonstrate(scene: Scene) -> dict[str, Value]:
    """Follows the demonstration of a scene to its end: the outcome and all metrics of its task, what was damaged, the hash of the end.

    A metric is a column: its name, its instrument, its unit, as ``path_length_probe_m``; a table of all is in docs/tasks.md.
    """
    with World(scene) as world:
        world.demonstrate()
        row: dict[str, Value] = {"simulated_s": world.time_s, "steps": world.steps, "hash": world.hash()}
        row |= {"blood_lost_m3": world.blood_lost_m3, "removed_volume_m3": world.removed_volume_m3}
        row["tetrahedra"] = len(world.tetrahedra)
        result = world.result
    if result is not None:
        row |= {"outcome": result["outcome"], "is_passed": result["is_passed"]}
        for metric in result["metrics"]:
            parts = (metric["name"], metric["tool"], metric["unit"].replace("/", "_per_"))
            name = "_".join(part.replace(" ", "_") for part in parts if part)
            # Instruments may have the same name.
            same = sum(other == name or other.startswith(f"{name}_again_") for other in row)
            row[f"{name}_again_{same}" if same else name] = metric["value"]
    return row
