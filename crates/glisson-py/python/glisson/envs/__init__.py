"""Environments for learning, with the API of Gymnasium (https://gymnasium.farama.org).

One world::

    env = glisson.envs.make("TissueRetraction")            # a gymnasium.Env

Many, stepped on all cores::

    envs = glisson.envs.make_vec("TissueRetraction", 64)   # a gymnasium.vector.VectorEnv

Both are also registered: ``gymnasium.make("glisson/TissueRetraction-v0")``. What a task observes, and what it is rewarded by, is in its
``observation_names`` and ``reward_weights``. The same seeds give the same episodes at any number of threads.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium

from glisson.envs.grasp_lift_touch import GraspLiftTouch
from glisson.envs.ligating_loop import LigatingLoop
from glisson.envs.liver_resection import LiverResection
from glisson.envs.observations import KINDS as OBSERVATIONS
from glisson.envs.observations import Observation
from glisson.envs.palpation import Palpation
from glisson.envs.precision_cutting import PrecisionCutting
from glisson.envs.single import TissueEnv
from glisson.envs.task import EpisodeTask
from glisson.envs.task_file import TaskFile
from glisson.envs.tissue_dissection import TissueDissection
from glisson.envs.tissue_manipulation import TissueManipulation
from glisson.envs.tissue_retraction import TissueRetraction
from glisson.envs.vector import TissueVectorEnv

TASKS: dict[str, type[EpisodeTask]] = {
    task.__name__: task
    for task in (
        TissueRetraction,
        TissueManipulation,
        GraspLiftTouch,
        Palpation,
        PrecisionCutting,
        TissueDissection,
        LigatingLoop,
        LiverResection,
        TaskFile,
    )
}

__all__ = [
    "OBSERVATIONS",
    "TASKS",
    "EpisodeTask",
    "GraspLiftTouch",
    "LigatingLoop",
    "LiverResection",
    "Observation",
    "Palpation",
    "PrecisionCutting",
    "TaskFile",
    "TissueDissection",
    "TissueEnv",
    "TissueManipulation",
    "TissueRetraction",
    "TissueVectorEnv",
    "make",
    "make_parallel",
    "make_vec",
]


def _task(name: str, options: dict[str, Any]) -> EpisodeTask:
    try:
        kind = TASKS[name]
    except KeyError:
        raise ValueError(f'there is no environment "{name}"; there are: {", ".join(TASKS)}') from None
    return kind(**options)


def make(
    name: str,
    *,
    render_mode: str | None = None,
    observe: Sequence[str] = ("state",),
    observe_options: Mapping[str, Any] | None = None,
    **options: Any,
) -> TissueEnv:
    """An environment of one world; ``options`` are those of its task.

    ``observe``: names of :data:`OBSERVATIONS`; ``("state",)`` alone is an array, all else a dictionary of arrays. ``observe_options``:
    those of :class:`Observation` (``picture_size``, ``view``, ``n_points``).
    """
    observation = Observation(observe, **(observe_options or {}))
    return TissueEnv(_task(name, options), render_mode=render_mode, observation=observation)


def make_vec(
    name: str,
    num_envs: int,
    *,
    threads: int | None = None,
    autoreset_mode: gymnasium.vector.AutoresetMode = gymnasium.vector.AutoresetMode.NEXT_STEP,
    render_mode: str | None = None,
    observe: Sequence[str] = ("state",),
    observe_options: Mapping[str, Any] | None = None,
    **options: Any,
) -> TissueVectorEnv:
    """So many environments, stepped on ``threads`` threads (all cores, if not given); ``observe`` as in :func:`make`."""
    observation = Observation(observe, **(observe_options or {}))
    task = _task(name, options)
    return TissueVectorEnv(
        task, num_envs, threads=threads, autoreset_mode=autoreset_mode, render_mode=render_mode, observation=observation
    )


def make_parallel(name: str, **options: Any) -> Any:
    """The same as :func:`make` for several agents, one for each hand: a ``pettingzoo.ParallelEnv``. It needs PettingZoo."""
    from glisson.envs.pettingzoo import TissueParallelEnv

    return TissueParallelEnv(make(name, **options))


for _name in TASKS:
    gymnasium.register(
        id=f"glisson/{_name}-v0",
        entry_point="glisson.envs:make",
        vector_entry_point="glisson.envs:make_vec",
        kwargs={"name": _name},
    )
