"""Ray (https://www.ray.io) as what does jobs of cohorts on many machines, and environments for RLlib.

::

    import glisson.ray

    glisson.ray.cohort(["palpation"], patients=range(1, 1001), out="study")     # all cores that Ray has
    glisson.ray.register()                                                      # "glisson/Palpation" and the others, for RLlib

It needs Ray: ``pip install 'glisson[ray]'``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import ray  # type: ignore[import-not-found,import-untyped,unused-ignore]

from glisson.cohorts import Job, Run
from glisson.cohorts import cohort as _cohort
from glisson.cohorts.jobs import SceneLike, Value, build, do

#: How often a job is tried whose worker ends without an answer.
TRIES = 3


class RayEngine:
    """Tasks of Ray, one core each. It takes the cluster that this process is connected to, else the one at ``address``, else one on this
    machine. A job whose machine is lost is done again, and so is one whose worker ends; the third time that is its ``error``.
    """

    def __init__(self, address: str | None = None) -> None:
        if not ray.is_initialized():
            ray.init(address=address, include_dashboard=False, log_to_driver=False)

    def results(self, jobs: Sequence[Job], run: Run) -> Iterator[tuple[Job, dict[str, Value]]]:
        remote_do = ray.remote(do).options(num_cpus=1, max_retries=0)
        run_there = ray.put(run)
        waiting = iter(jobs)
        doing: dict[Any, tuple[Job, int]] = {}

        def begin(job: Job, tries: int) -> None:
            doing[remote_do.remote(job, run_there, build())] = (job, tries)

        try:
            while True:
                # Machines may come and go; a few wait, so that no core does.
                cores = ray.cluster_resources().get("CPU", 1)  # type: ignore[no-untyped-call,unused-ignore]
                most = 2 * max(1, int(cores))
                while len(doing) < most and (job := next(waiting, None)) is not None:
                    begin(job, 1)
                if not doing:
                    return
                done, _ = ray.wait(list(doing), num_returns=1, timeout=10.0)
                for reference in done:
                    job, tries = doing.pop(reference)
                    try:
                        yield job, ray.get(reference)
                    except (ray.exceptions.NodeDiedError, ray.exceptions.ObjectLostError):
                        begin(job, tries)
                    except (ray.exceptions.WorkerCrashedError, ray.exceptions.OutOfMemoryError) as error:
                        if tries < TRIES:
                            begin(job, tries + 1)
                        else:
                            yield job, {"error": f"its worker ended {tries} times: {type(error).__name__}"}
        finally:
            for reference in doing:
                ray.cancel(reference, force=True)


def cohort(scenes: Sequence[SceneLike] | Mapping[str, SceneLike], *, out: str, address: str | None = None, **options: Any) -> Path:
    """As :func:`glisson.cohorts.cohort`, its jobs done by a :class:`RayEngine`."""
    return _cohort(scenes, out=out, engine=RayEngine(address), **options)


def register() -> None:
    """Makes the environments known to RLlib, as ``glisson/NAME``; ``env_config`` has the options of :func:`glisson.envs.make`."""
    from ray.tune.registry import register_env  # type: ignore[import-not-found,import-untyped,unused-ignore]

    from glisson import envs

    for name in envs.TASKS:
        register_env(f"glisson/{name}", lambda config, name=name: envs.make(name, **config))
