"""Where results of a cohort are kept."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

from glisson.cohorts.jobs import Job, Value


class Store:
    """A folder: ``results.jsonl`` has a line for each result as soon as it is there, ``results.parquet`` a table of all.

    One process at a time writes there; a second one is told so. A last line that was cut off is taken back. Of two lines of one job the
    later one counts.
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = Path(folder)
        self.folder.mkdir(parents=True, exist_ok=True)
        self._lines: BinaryIO = open(self.folder / "results.jsonl", "ab+")
        try:
            _lock(self._lines, self.folder)
            self._rows = self._read()
        except BaseException:
            self._lines.close()
            raise

    def _read(self) -> dict[str, dict[str, Value]]:
        rows: dict[str, dict[str, Value]] = {}
        self._lines.seek(0)
        whole = 0
        for number, line in enumerate(self._lines, start=1):
            if not line.endswith(b"\n"):
                break
            try:
                kept = json.loads(line)
                rows[kept["key"]] = kept["row"]
            except (ValueError, KeyError, TypeError):
                raise ValueError(
                    f"{self._lines.name}: line {number} is no result of a cohort: {line[:60]!r}; take it out, or give another folder"
                ) from None
            whole += len(line)
        self._lines.truncate(whole)
        return rows

    def __contains__(self, key: str) -> bool:
        """Whether there is a result. What went wrong is none: a file may be there by now, or a machine more."""
        return key in self._rows and self._rows[key].get("error") is None

    def add(self, key: str, row: Mapping[str, Value]) -> None:
        """Keeps a result: it is on the disk when this comes back."""
        line = json.dumps({"key": key, "row": row})
        self._lines.write(line.encode() + b"\n")
        self._lines.flush()
        os.fsync(self._lines.fileno())
        # As it is when it is read again.
        self._rows[key] = json.loads(line)["row"]

    def rows(self, jobs: Sequence[Job], run_name: str) -> list[dict[str, Any]]:
        """The results of jobs that are there, in their order, each with what its job is."""
        kept = ((job, self._rows.get(job.key(run_name))) for job in jobs)
        return [{**job.columns, **row} for job, row in kept if row is not None]

    def write_table(self, rows: Sequence[Mapping[str, Any]]) -> Path:
        """Writes a table of rows; columns are in the order in which they come first."""
        import pyarrow  # type: ignore[import-not-found,import-untyped,unused-ignore]
        import pyarrow.parquet  # type: ignore[import-not-found,import-untyped,unused-ignore]

        names = list(dict.fromkeys(name for row in rows for name in row))
        columns = {name: _column([row.get(name) for row in rows]) for name in names}
        path = self.folder / "results.parquet"
        part = path.with_suffix(".parquet.part")
        pyarrow.parquet.write_table(pyarrow.table(columns), part)
        os.replace(part, path)
        return path

    def close(self) -> None:
        """Others may write there then."""
        self._lines.close()

    def __enter__(self) -> Store:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


def _column(values: Sequence[Value]) -> list[Value]:
    """Values of one type: whole numbers among others are numbers, and where texts are among numbers all are texts. So are whole numbers
    of more than 64 bits."""
    kinds = {type(value) for value in values if value is not None}
    if kinds == {int, float}:
        return [None if value is None else float(value) for value in values]
    is_large = any(isinstance(value, int) and not -(2**63) <= value < 2**63 for value in values)
    if len(kinds) > 1 or is_large:
        return [None if value is None else str(value) for value in values]
    return list(values)


def _lock(file: BinaryIO, folder: Path) -> None:
    try:
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise RuntimeError(f"{folder}: another process writes results there; wait for it, or give another folder") from None
    except (ImportError, OSError) as error:
        print(f"cohort: {folder} cannot be locked ({error}): start no second process there", file=sys.stderr)
