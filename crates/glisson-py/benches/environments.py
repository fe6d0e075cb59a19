"""Environment steps a second: each environment at about 500, 2,000 and 6,300 tetrahedra, with random actions and in demonstrations.

`cargo xtask bench-python`. With --mujoco SCRIPT (xtask/peers/mujoco_flex.py) MuJoCo's flex is measured on the same meshes, pulled at its
free edge, in steps of 2 ms: so many control steps of 50 ms it would make. With --newton SCRIPT (xtask/peers/newton_soft_body.py)
Newton's soft body is measured in the same way.
"""

from __future__ import annotations

import argparse
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import time
from typing import Any

import numpy as np

from memory import measure

import glisson
import glisson.envs
from glisson.envs import make, make_vec

SIZES = (500, 2000, 6300)
#: Environments of a batch at each size.
N_ENVS = (32, 16, 8)
#: Lengths of edges that are tried for a size [m].
EDGES_M = np.geomspace(0.0012, 0.012, 60)
PICTURES = (128, 128)
#: `tissue = "liver"`: crates/glisson-tissue/src/material/tissues.rs.
YOUNG_PA, POISSON = 4100.0, 0.45
#: On the free edge of the other simulators' flaps, along them [N].
PULL_N = 0.05


def n_tetrahedra(scene: glisson.Scene) -> int:
    with glisson.World(scene) as world:
        return len(world.tetrahedra)


def options_for(name: str, size: int) -> tuple[dict[str, Any], int]:
    """Options of an environment whose mesh has about so many tetrahedra, and how many it has."""
    if name == "LiverResection":
        options: dict[str, Any] = {"tetrahedra": size}
        return options, n_tetrahedra(make(name, **options).task.scenes()[0])
    found: list[tuple[float, float, int]] = []
    low, high = 0, len(EDGES_M) - 1
    while low <= high:
        middle = (low + high) // 2
        n = n_tetrahedra(glisson.envs.TASKS[name](edge_m=float(EDGES_M[middle])).scenes()[0])
        found.append((abs(np.log(n / size)), float(EDGES_M[middle]), n))
        # A shorter edge makes more.
        low, high = (low, middle - 1) if n < size else (middle + 1, high)
    _, edge_m, n = min(found)
    return {"edge_m": edge_m}, n


class Timed:
    """Worlds whose steps are timed: what is left of a step of environments is Python's."""

    def __init__(self, worlds: glisson.Worlds) -> None:
        self._worlds, self.spent_s = worlds, 0.0

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._worlds, name)
        if name not in ("step", "restart", "place"):
            return found

        def timed(*arguments: Any) -> Any:
            began_s = time.perf_counter()
            try:
                return found(*arguments)
            finally:
                self.spent_s += time.perf_counter() - began_s

        return timed


def rate(name: str, n_envs: int, threads: int, seconds: float, is_demonstration: bool, options: dict[str, Any]) -> tuple[float, float]:
    """Environment steps a second, and the share of the time that is not spent in steps of worlds."""
    envs = make_vec(name, n_envs, threads=threads, **options)
    timed = Timed(envs.batch.worlds)
    envs.batch._worlds = timed  # type: ignore[assignment]
    random = np.random.default_rng(1)
    envs.reset(seed=1)

    def action() -> Any:
        return envs.scripted_actions() if is_demonstration else random.uniform(-1, 1, envs.action_space.shape).astype(np.float32)

    for _ in range(3):
        envs.step(action())
    n, timed.spent_s, began_s = 0, 0.0, time.perf_counter()
    while (took_s := time.perf_counter() - began_s) < seconds:
        envs.step(action())
        n += 1
    return n * n_envs / took_s, 1.0 - timed.spent_s / took_s


def pictures(threads: int, seconds: float) -> float:
    """Environment steps a second of TissueRetraction that observes pictures."""
    envs = make_vec("TissueRetraction", 16, threads=threads, observe=("state", "rgb"), observe_options={"picture_size": PICTURES})
    envs.reset(seed=1)
    stay = np.zeros(envs.action_space.shape, np.float32)
    n, began_s = 0, time.perf_counter()
    while (took_s := time.perf_counter() - began_s) < seconds:
        envs.step(stay)
        n += 1
    return n * 16 / took_s


def held_and_loaded(positions_m: Any) -> tuple[Any, Any]:
    """Nodes of a flap that are fixed, and those of its free edge."""
    z_m = positions_m[:, 2]
    return np.flatnonzero(z_m < z_m.min() + 1e-4), np.flatnonzero(z_m > z_m.max() - 1e-4)


def peer(script: str, how: str, scene: glisson.Scene, seconds: float) -> list[float]:
    """What a script of xtask/peers answers of the mesh of a scene, in steps of 2 ms; the first is the time of one [ms]."""
    with glisson.World(scene) as world:
        positions_m, tetrahedra = world.rest_positions_m, world.tetrahedra
    held, loaded = held_and_loaded(positions_m)
    head = [len(positions_m), len(tetrahedra), len(held), len(loaded), 1, YOUNG_PA, POISSON, 1060.0, 0.01]
    parts = [head, positions_m.ravel(), tetrahedra.ravel(), held, loaded, np.full(len(loaded), PULL_N / len(loaded))]
    with tempfile.TemporaryDirectory() as folder:
        file = pathlib.Path(folder) / "body.txt"
        file.write_text(" ".join(" ".join(str(number) for number in part) for part in parts))
        command = [sys.executable, script, how, str(file), "0.002", str(seconds)]
        # It leaves a log where it runs.
        answer = subprocess.run(command, capture_output=True, text=True, check=True, cwd=folder)
    return [float(word) for word in answer.stdout.splitlines()[-1].split()]


def control_steps(step_ms: float) -> float:
    """Control steps of 50 ms a second, where one of 2 ms takes so long."""
    return 1e3 / (25.0 * step_ms)


def pulled_mm(scene: glisson.Scene) -> float:
    """How far the free edge of a flap is pulled in balance, after Glisson's static solver."""
    with glisson.World(scene) as world:
        positions_m, tetrahedra = world.rest_positions_m, world.tetrahedra
    held, loaded = held_and_loaded(positions_m)
    prescribed_m, forces_n = np.full(positions_m.shape, np.nan), np.zeros(positions_m.shape)
    prescribed_m[held], forces_n[loaded, 2] = 0.0, PULL_N / len(loaded)
    mesh = glisson.Mesh(positions_m, tetrahedra)
    solution = glisson.solve(mesh, YOUNG_PA, POISSON, prescribed_m, forces_n, law="stable_neo_hooke")
    return 1e3 * float(solution.displacement_m[loaded, 2].mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=3.0, help="for each figure")
    parser.add_argument("--json", type=pathlib.Path, help="writes the figures there, too")
    parser.add_argument("--only", nargs="*", default=[name for name in glisson.envs.TASKS if name != "TaskFile"])
    parser.add_argument("--sizes", nargs="*", type=int, default=list(SIZES))
    parser.add_argument("--mujoco", metavar="SCRIPT")
    parser.add_argument("--newton", metavar="SCRIPT")
    parser.add_argument("--memory", nargs="*", metavar="NAME", help="instead: memory over 10,000 resets of these, with a plot")
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("out/bench-python"), help="folder for the plots")
    chosen = parser.parse_args()
    if chosen.memory is not None:
        names = chosen.memory or ["TissueRetraction", "Palpation", "PrecisionCutting"]
        for name in names:
            if len(names) == 1:
                measure(name, 10_000, chosen.out)
            else:  # What one leaves behind does not count for the next.
                subprocess.run([sys.executable, __file__, "--memory", name, "--out", str(chosen.out)], check=True)
        return
    cores = os.cpu_count() or 1
    rows: list[dict[str, Any]] = []
    print(f"{cores} cores; environment steps a second, each of 50 ms simulated time")
    print("| environment | tetrahedra | random | one core | demonstration | one core | Python's share |\n|---|---|---|---|---|---|---|")
    for name in chosen.only:
        for size, n_envs in zip(SIZES, N_ENVS):
            if size not in chosen.sizes:
                continue
            options, n = options_for(name, size)
            row: dict[str, Any] = {"environment": name, "tetrahedra": n, "environments": n_envs}
            for what, is_demonstration in (("random", False), ("demonstration", True)):
                row[what], row[f"{what}_python_share"] = rate(name, n_envs, cores, chosen.seconds, is_demonstration, options)
                row[f"{what}_one_core"], _ = rate(name, n_envs, 1, chosen.seconds, is_demonstration, options)
            rows.append(row)
            print(
                f"| `{name}` | {n} | {row['random']:.0f} | {row['random_one_core']:.0f} | {row['demonstration']:.0f} "
                f"| {row['demonstration_one_core']:.0f} | {100 * row['random_python_share']:.0f} %, {100 * row['demonstration_python_share']:.0f} % |",
                flush=True,
            )
    result: dict[str, Any] = {"glisson": glisson.__version__, "cores": cores, "rows": rows}
    result["pictures_128"] = pictures(cores, chosen.seconds)
    print(f"TissueRetraction that observes pictures of 128 x 128: {result['pictures_128']:.0f} a second")
    if chosen.mujoco:
        result["mujoco"] = []
        for size in chosen.sizes:
            options, n = options_for("TissueRetraction", size)
            scene = make("TissueRetraction", **options).task.scenes()[0]
            of_core = control_steps(peer(chosen.mujoco, "discrete", scene, chosen.seconds)[0])
            result["mujoco"].append({"tetrahedra": n, "steps_per_core": of_core})
            print(f"MuJoCo's flex of {n} tetrahedra, steps of 2 ms: {of_core:.1f} such steps a second and core", flush=True)
    if chosen.newton:
        result["newton"] = []
        for size in chosen.sizes:
            options, n = options_for("TissueRetraction", size)
            scene = make("TissueRetraction", **options).task.scenes()[0]
            step_ms, _, _, _, edge_mm, n_substeps, is_sound = peer(chosen.newton, "semi_implicit", scene, chosen.seconds)
            row = {"tetrahedra": n, "steps_per_core": control_steps(step_ms), "solver": "SolverSemiImplicit", "substeps": int(n_substeps)}
            row |= {"is_sound": bool(is_sound), "edge_mm": edge_mm, "balance_mm": pulled_mm(scene)}
            result["newton"].append(row)
            print(
                f"Newton's soft body of {n} tetrahedra, steps of 2 ms: {row['steps_per_core']:.1f} such steps a second and core "
                f"({row['solver']}, explicit: {row['substeps']} substeps without iterations; {'finite' if is_sound else 'NOT FINITE'}, "
                f"edge pulled by {edge_mm:.2f} mm in the mean, in balance {row['balance_mm']:.2f} mm)",
                flush=True,
            )
    if chosen.json:
        chosen.json.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
