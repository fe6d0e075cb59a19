"""What `glisson cohort` starts: the cohort is on the standard input, as JSON."""

from __future__ import annotations

import json
import os
import sys

from glisson.cohorts.local import Engine, LocalEngine
from glisson.cohorts.running import cohort


def main() -> int:
    study = json.load(sys.stdin.buffer)
    ray, workers, address = (study.pop(name) for name in ("ray", "workers", "address"))
    try:
        engine: Engine
        if ray:
            from glisson.ray import RayEngine

            engine = RayEngine(address)
        else:
            engine = LocalEngine(workers)
        path = cohort(study.pop("scenes"), engine=engine, **study)
        print(_summary(path))
    except KeyboardInterrupt:
        print("\nstopped: what is done is kept", file=sys.stderr, flush=True)
        # Jobs that are being done are not waited for.
        os._exit(130)
    except (ArithmeticError, ImportError, OSError, RuntimeError, TypeError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def _summary(path: object) -> str:
    """A line for each scene: how many, how many passed, how many have an error."""
    import pyarrow.parquet  # type: ignore[import-not-found,import-untyped,unused-ignore]

    lines: dict[str, list[int]] = {}
    for row in pyarrow.parquet.read_table(path).to_pylist():
        counts = lines.setdefault(row["scene"], [0, 0, 0])
        for which, counted in enumerate((True, row.get("is_passed"), row["error"] is not None)):
            counts[which] += bool(counted)
    width = max(map(len, lines))
    return "\n".join(f"{name:<{width}}  {n} done, {passed} passed, {errors} with an error" for name, (n, passed, errors) in lines.items())


if __name__ == "__main__":
    sys.exit(main())
