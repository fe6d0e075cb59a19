"""A cohort from its beginning, or from where it was cut off, to its end."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from glisson.cohorts.jobs import Run, SceneLike, demonstrate, jobs_of, known_name
from glisson.cohorts.local import Engine, LocalEngine
from glisson.cohorts.store import Store


def cohort(
    scenes: Sequence[SceneLike] | Mapping[str, SceneLike],
    *,
    out: str | os.PathLike[str],
    patients: Iterable[int] | None = None,
    values: Mapping[str, Sequence[Any]] | None = None,
    run: Run = demonstrate,
    version: str = "",
    engine: Engine | None = None,
    progress: bool = True,
) -> Path:
    """Does every scene with every patient and every choice of values (:func:`jobs_of`), and answers the table of results, a Parquet file.

    ``out`` is a folder; results that it has are not made again, and a cohort may grow: further patients are done beside those that are
    there. ``run`` is known by its name: change ``version`` where it does something else than before. ``engine`` does the jobs: the cores of
    this machine, or :class:`glisson.ray.RayEngine`. ``progress`` is told on the standard error.

    What a scene or a simulation refuses does not end a cohort: its row has the words in ``error``, and it is tried again at the next call. It needs pyarrow (``pip install glisson[cohorts]``).
    """
    try:
        import pyarrow.parquet  # type: ignore[import-not-found,import-untyped,unused-ignore]  # noqa: F401
    except ImportError:
        raise ImportError("tables of results need pyarrow: pip install 'glisson[cohorts]', or pip install pyarrow") from None
    jobs = jobs_of(scenes, patients, values)
    run_name = known_name(run, version)
    with Store(out) as store:
        left = [job for job in jobs if job.key(run_name) not in store]
        teller = _Teller(len(jobs), len(left), store.folder) if progress else None
        for job, row in (engine or LocalEngine()).results(left, run):
            store.add(job.key(run_name), row)
            if teller:
                teller.tell(row.get("error"))
        rows = store.rows(jobs, run_name)
        path = store.write_table(rows)
        if teller:
            teller.end(path)
    return path


class _Teller:
    """Tells how far a cohort is: in one line of a terminal, else every half minute."""

    def __init__(self, n: int, n_left: int, folder: Path) -> None:
        self._n, self._done, self._before = n, n - n_left, n - n_left
        self._errors = 0
        self._begun_s = self._told_s = time.monotonic()
        self._is_terminal = sys.stderr.isatty()
        there = f", {self._before} of them are there" if self._before else ""
        print(f"cohort: {n} jobs{there}; results go to {folder}", file=sys.stderr)

    def tell(self, error: Any) -> None:
        self._done += 1
        self._errors += error is not None
        now_s = time.monotonic()
        if not self._is_terminal and now_s - self._told_s < 30.0 and self._done < self._n:
            return
        self._told_s = now_s
        each_s = (now_s - self._begun_s) / (self._done - self._before)
        left_s = each_s * (self._n - self._done)
        line = f"cohort: {self._done} of {self._n}, {self._errors} with an error, {left_s:.0f} s left"
        print(f"\r{line:<70}" if self._is_terminal else line, end="" if self._is_terminal else "\n", file=sys.stderr, flush=True)

    def end(self, path: Path) -> None:
        print(f"{chr(10) if self._is_terminal else ''}cohort: written {path}", file=sys.stderr)
