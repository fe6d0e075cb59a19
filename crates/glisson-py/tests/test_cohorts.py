"""Cohorts: the same with many patients and parameters."""

import functools
import json

import numpy as np
import pytest
from conftest import BLOCK, pressed

import glisson

parquet = pytest.importorskip("pyarrow.parquet")

from glisson.cohorts import LocalEngine, Store, cohort, demonstrate, jobs_of  # noqa: E402

VALUES = {"organ.damping": ["20 1/s", "40 1/s"], "tool.0.tip_radius": ["3 mm", "4 mm"]}


def press(scene):
    """Presses the block: the force then."""
    with glisson.World(scene) as world:
        world.step(20, pressed(world))
        return {"force_n": float((world.forces_n[0] ** 2).sum() ** 0.5), "hash": world.hash()}


def table(path):
    return parquet.read_table(path).to_pylist()


def block():
    return {"block": glisson.scene_from_dict(BLOCK)}


def test_every_choice_is_done_once_and_on_many_threads_the_same(tmp_path):
    paths = [
        cohort(block(), values=VALUES, run=press, out=tmp_path / str(n), engine=LocalEngine(n), progress=False) for n in (1, 3)
    ]
    assert paths[0].read_bytes() == paths[1].read_bytes()
    rows = table(paths[0])
    assert [(row["job"], row["organ.damping"], row["tool.0.tip_radius"]) for row in rows] == [
        (0, "20 1/s", "3 mm"),
        (1, "20 1/s", "4 mm"),
        (2, "40 1/s", "3 mm"),
        (3, "40 1/s", "4 mm"),
    ]
    assert len({row["hash"] for row in rows}) == 4
    assert all(row["error"] is None and row["force_n"] > 0.0 for row in rows)


class Stopping:
    """Is stopped at its third job the first time."""

    def __init__(self):
        self.calls = 0

    def __call__(self, scene):
        self.calls += 1
        if self.calls == 3:
            raise KeyboardInterrupt
        return press(scene)


def test_what_was_cut_off_goes_on_and_makes_nothing_twice(tmp_path, capsys):
    run = Stopping()
    options = {"values": VALUES, "run": run, "version": "1", "out": tmp_path, "engine": LocalEngine(1)}
    with pytest.raises(KeyboardInterrupt):
        cohort(block(), **options)
    kept = tmp_path / "results.jsonl"
    assert len(kept.read_text().splitlines()) == 2
    # As a machine that fails leaves it: in the middle of a line.
    with open(kept, "a", encoding="utf-8") as lines:
        lines.write('{"key": "0123')
    rows = table(cohort(block(), **options))
    assert run.calls == 3 + 2
    assert len(rows) == 4
    told = capsys.readouterr().err
    assert "4 jobs, 2 of them are there" in told and "4 of 4, 0 with an error" in told
    # It grows: what is there stays.
    more = {**VALUES, "organ.damping": ["20 1/s", "40 1/s", "60 1/s"]}
    assert len(table(cohort(block(), **{**options, "values": more}))) == 6
    assert run.calls == 3 + 2 + 2
    # And is all made anew where it does something else.
    cohort(block(), **{**options, "version": "2"})
    assert run.calls == 3 + 2 + 2 + 4


def test_what_a_scene_refuses_is_a_result_and_what_is_wrong_in_a_function_is_not(tmp_path):
    rows = table(cohort(block(), values={"organ.damping": ["20 1/s", "-1 1/s"]}, run=press, out=tmp_path / "a", progress=False))
    assert rows[0]["error"] is None and "damping" in rows[1]["error"]
    (row,) = table(cohort(block(), patients=[7], run=press, out=tmp_path / "b", progress=False))
    assert "0 synthetic organs" in row["error"] and row["patient"] == 7
    options = {"out": tmp_path / "c", "progress": False}
    with pytest.raises(ZeroDivisionError):
        cohort(block(), run=lambda scene: {"a": 1 / 0}, version="1", **options)
    with pytest.raises(ValueError, match="job"):
        cohort(block(), run=lambda scene: {"job": 1}, version="2", **options)
    with pytest.raises(ValueError, match="may be several functions"):
        cohort(block(), run=functools.partial(press), **options)


def test_a_fault_in_one_job_loses_none_beside_it(tmp_path):
    def run(scene):
        if "40 1/s" in scene.text and 'tip_radius = "3 mm"' in scene.text:
            raise ZeroDivisionError
        return press(scene)

    with pytest.raises(ZeroDivisionError):
        cohort(block(), values=VALUES, run=run, version="1", out=tmp_path, engine=LocalEngine(4), progress=False)
    assert len((tmp_path / "results.jsonl").read_text().splitlines()) == 3


def test_what_went_wrong_is_tried_again_and_numbers_stay_what_they_are(tmp_path):
    mended = tmp_path / "mended"

    def run(scene):
        if not mended.exists():
            raise glisson.SimulationError("not yet")
        return {"nan": -float("nan"), "large": 2**63, "small": 1e-300, "count": 3, "text": "\u00b5", "nothing": None, "numpy": np.float64(0.1)}

    options = {"run": run, "version": "1", "out": tmp_path, "progress": False}
    (row,) = table(cohort(block(), **options))
    assert row["error"] == "not yet"
    mended.touch()
    path = cohort(block(), **options)
    (row,), first = table(path), path.read_bytes()
    assert row["error"] is None and row["nan"] != row["nan"] and row["large"] == str(2**63)
    assert (row["small"], row["count"], row["text"], row["nothing"], row["numpy"]) == (1e-300, 3, "\u00b5", None, 0.1)
    assert cohort(block(), **options).read_bytes() == first


def test_two_writers_and_foreign_files_are_told(tmp_path):
    with Store(tmp_path), pytest.raises(RuntimeError, match="another process"):
        Store(tmp_path)
    kept = tmp_path / "results.jsonl"
    # As an editor leaves it.
    kept.write_bytes(b'{"key": "1", "row": {"error": null}}\r\n{"key": "2", "row": {"error": null}}\r\n')
    with Store(tmp_path) as store:
        assert "1" in store and "2" in store
    assert len(kept.read_bytes().splitlines()) == 2
    kept.write_text("something else\n")
    with pytest.raises(ValueError, match="line 1"):
        Store(tmp_path)
    assert kept.read_text() == "something else\n"


def test_jobs_say_what_is_wrong_with_them():
    with pytest.raises(glisson.SceneError, match='did you mean "palpation"'):
        jobs_of(["palpatio"])
    with pytest.raises(TypeError, match="list of values"):
        jobs_of(["palpation"], values={"organ.damping": "5 1/s"})
    with pytest.raises(ValueError, match="the same"):
        jobs_of(["palpation"], patients=[1, 2, 1])
    with pytest.raises(TypeError, match="1.5"):
        jobs_of(["palpation"], patients=[1.5])
    with pytest.raises(ValueError, match="-1"):
        jobs_of(["palpation"], patients=[-1])
    with pytest.raises(ValueError, match="nan"):
        jobs_of(["palpation"], values={"organ.damping": [float("nan")]})
    with pytest.raises(ValueError, match="nothing to do"):
        jobs_of(["palpation"], patients=[])
    with pytest.raises(glisson.SceneError, match='did you mean "organ"'):
        glisson.vary(glisson.Scene.task("palpation"), {"orgen.damping": "5 1/s"})
    with pytest.raises(glisson.SceneError, match="list of"):
        glisson.vary(glisson.Scene.task("palpation"), {"tool.9.tip_radius": "5 mm"})


def test_patients_are_any_and_demonstrations_are_those_of_the_program(tmp_path, capfd):
    path = cohort(["palpation", "grasp_and_lift"], out=tmp_path / "cohort", progress=False)
    for row in table(path):
        out = tmp_path / row["scene"]
        assert glisson.run_program(["task", "run", row["scene"], "--headless", "--json", "--out", str(out)]) == 0
        told = json.loads(capfd.readouterr().out)
        assert (row["hash"], row["steps"], row["is_passed"]) == (told["state_hash"], told["steps"], True)
        time_s = next(metric["value"] for metric in told["result"]["metrics"] if metric["name"] == "time")
        assert row["time_s"] == time_s
    other = glisson.vary(glisson.Scene.task("palpation"), patient=12345)
    assert "seed = 12345" in other.text
    assert demonstrate(other)["hash"] != table(path)[0]["hash"]
