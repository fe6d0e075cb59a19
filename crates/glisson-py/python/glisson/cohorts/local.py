"""Doing jobs on the cores of this machine."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from typing import Protocol

from glisson.cohorts.jobs import Job, Run, Value, build, do


class Engine(Protocol):
    """What does jobs, in any order, and answers each with its row as soon as it is there."""

    def results(self, jobs: Sequence[Job], run: Run) -> Iterator[tuple[Job, dict[str, Value]]]: ...


class LocalEngine:
    """Threads of this process: worlds are stepped without Python's lock. ``workers``: how many; all cores without it."""

    def __init__(self, workers: int | None = None) -> None:
        if workers is not None and workers < 1:
            raise ValueError(f"workers is {workers}; give 1 or more")
        self._workers = workers or os.cpu_count() or 1

    def results(self, jobs: Sequence[Job], run: Run) -> Iterator[tuple[Job, dict[str, Value]]]:
        waiting = iter(jobs)
        pool = ThreadPoolExecutor(self._workers)
        doing: dict[Future[dict[str, Value]], Job] = {}
        try:
            while True:
                # As many as there are threads: what is not begun yet needs not be called off at the end.
                while len(doing) < self._workers and (job := next(waiting, None)) is not None:
                    doing[pool.submit(do, job, run, build())] = job
                if not doing:
                    return
                done, _ = wait(doing, return_when=FIRST_COMPLETED)
                # What went wrong comes last, so that nothing that is done is lost.
                for future in sorted(done, key=lambda future: future.exception() is not None):
                    if future.exception() is not None:
                        others = [other for other in doing if other is not future]
                        wait(others)
                        yield from ((doing[other], other.result()) for other in others if other.exception() is None)
                    yield doing.pop(future), future.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
