"""Cohorts: the same done with many patients, scenes and parameters, on all cores or on a cluster.

::

    from glisson.cohorts import cohort

    results = cohort(
        ["palpation", "metastasectomy"],
        patients=range(1, 201),
        values={"organ.damping": ["2 1/s", "20 1/s"]},
        out="study",
    )                                                    # study/results.parquet

Each job is one scene with one patient and one choice of values; each gives one row. What a row says is what ``run`` answers, a function from
a scene to a dictionary; without one it is :func:`demonstrate`. A cohort that was cut off goes on where it was when it is called again: every
result is written as soon as it is there, and none is made twice. The same jobs give the same file, on one core, on many, on a cluster
(:mod:`glisson.ray`).
"""

from glisson.cohorts.jobs import Job, Run, demonstrate, jobs_of
from glisson.cohorts.local import Engine, LocalEngine
from glisson.cohorts.running import cohort
from glisson.cohorts.store import Store

__all__ = ["Engine", "Job", "LocalEngine", "Run", "Store", "cohort", "demonstrate", "jobs_of"]
