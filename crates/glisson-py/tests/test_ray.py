"""Cohorts on a cluster of Ray, where it is there: workers and drivers that end."""

import os
import pathlib
import signal
import subprocess
import sys
import time

import pytest
from conftest import BLOCK, pressed

import glisson

parquet = pytest.importorskip("pyarrow.parquet")
ray = pytest.importorskip("ray")

import glisson.ray  # noqa: E402
from glisson.cohorts import LocalEngine, cohort  # noqa: E402

#: The last one is refused, in the same words wherever.
VALUES = {"organ.damping": [*(f"{damping} 1/s" for damping in range(20, 43)), "-1 1/s"]}


def scenes(folder):
    """The block as a file, so that words about it tell which."""
    path = folder / "block.toml"
    path.write_text(glisson.scene_from_dict(BLOCK).text, encoding="utf-8")
    return [path]


class Press:
    """Presses the block: the force then. With a mark to leave, one choice ends its worker once, and with one called "always" another does every time."""

    def __init__(self, mark=None):
        self.mark = mark

    def __call__(self, scene):
        if self.mark and "30 1/s" in scene.text and not os.path.exists(self.mark):
            open(self.mark, "w").close()
            os.kill(os.getpid(), signal.SIGKILL)
        # The last ones wait as long as there is what tells them to.
        while self.mark and any(f"{damping} 1/s" in scene.text for damping in range(36, 43)) and os.path.exists(f"{self.mark}.hold"):
            time.sleep(0.05)
        if self.mark and "31 1/s" in scene.text and self.mark.endswith("always"):
            os.kill(os.getpid(), signal.SIGKILL)
        with glisson.World(scene) as world:
            world.step(20, pressed(world))
            return {"force_n": float((world.forces_n[0] ** 2).sum() ** 0.5), "hash": world.hash()}


def drive(out, mark):
    """What a process does that may be ended."""
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, configure_logging=False)
    glisson.ray.cohort(scenes(pathlib.Path(out).parent), values=VALUES, run=Press(mark), version="1", out=out)


def rows_of(path):
    return parquet.read_table(path).to_pylist()


def start(out, mark):
    here = os.path.dirname(os.path.abspath(__file__))
    # Workers of the cluster find what this process finds.
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([here, *filter(None, sys.path)]), "RAY_ENABLE_UV_RUN_RUNTIME_ENV": "0"}
    words = [sys.executable, "-c", f"import test_ray; test_ray.drive({str(out)!r}, {str(mark)!r})"]
    return subprocess.Popen(words, env=environment, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, start_new_session=True)


def test_lost_workers_and_a_driver_that_is_started_again_change_nothing(tmp_path):
    serial = cohort(
        scenes(tmp_path),
        values=VALUES,
        run=Press(),
        version="1",
        out=tmp_path / "serial",
        engine=LocalEngine(1),
        progress=False,
    )
    out, hold = tmp_path / "ray", tmp_path / "mark.hold"
    hold.touch()
    first = start(out, tmp_path / "mark")
    kept = out / "results.jsonl"
    until_s = time.monotonic() + 120.0
    while time.monotonic() < until_s and (not kept.exists() or len(kept.read_text().splitlines()) < 14):
        assert first.poll() is None, first.stderr.read()
        time.sleep(0.05)
    os.killpg(first.pid, signal.SIGKILL)
    first.wait()
    hold.unlink()
    n_kept = len(kept.read_text().splitlines())
    assert 14 <= n_kept < 24, "the driver is stopped in the middle"
    assert (tmp_path / "mark").exists(), "a worker was lost"
    second = start(out, tmp_path / "mark")
    _, told = second.communicate(timeout=120.0)
    assert second.returncode == 0, told
    assert f"{n_kept} of them are there" in told
    assert (out / "results.parquet").read_bytes() == serial.read_bytes()
    (refused,) = [row for row in rows_of(serial) if row["error"]]
    assert "block.toml" in refused["error"]


def test_a_job_that_ends_every_worker_is_told(tmp_path):
    mark = tmp_path / "always"
    mark.touch()
    driver = start(tmp_path / "ray", mark)
    _, told = driver.communicate(timeout=120.0)
    assert driver.returncode == 0, told
    assert "24 of 24, 2 with an error" in told
    lost, _ = [row for row in rows_of(tmp_path / "ray" / "results.parquet") if row["error"]]
    assert lost["organ.damping"] == "31 1/s" and "its worker ended 3 times" in lost["error"]
