"""Time of a step of MuJoCo's flex (St Venant-Kirchhoff) on a mesh and load of Glisson's benchmarks.

mujoco_flex.py INTEGRATOR FILE STEP_S SECONDS. The file is that of `rapier/src/main.rs`. Answers
`median_ms p99_ms n_steps deepest_mm`, of CPU time.
"""

import sys
import time

import mujoco
import numpy as np

WARM_UP_SHARE = 0.3


def model_of(file, step_s, integrator):
    """The model, the loaded nodes, their forces in each load step of a round [N], and the length of one [s]."""
    with open(file, encoding="ascii") as text:
        numbers = iter(np.array(text.read().split(), dtype=float))
    n_nodes, n_tets, n_held, n_loaded, n_round = (int(next(numbers)) for _ in range(5))
    young_pa, poisson_ratio, density_kg_per_m3, load_step_s = (next(numbers) for _ in range(4))

    def take(count):
        return np.fromiter((next(numbers) for _ in range(count)), dtype=float, count=count)

    positions_m = take(3 * n_nodes).reshape(-1, 3)
    tets = take(4 * n_tets).astype(int).reshape(-1, 4)
    held = take(n_held).astype(int)
    loaded = take(n_loaded).astype(int)
    round_n = take(n_round * n_loaded).reshape(n_round, n_loaded)
    corners_m = positions_m[tets]
    edges_m = corners_m[:, 1:] - corners_m[:, :1]
    corner_kg = density_kg_per_m3 * abs(np.linalg.det(edges_m)) / 24.0
    node_kg = np.bincount(tets.ravel(), weights=np.repeat(corner_kg, 4), minlength=n_nodes)

    def words(values):
        return " ".join(str(value) for value in values.ravel())

    xml = f"""
<mujoco>
  <option timestep="{step_s}" gravity="0 0 0" integrator="{integrator}"/>
  <worldbody>
    <flexcomp name="body" type="direct" dim="3" dof="full" mass="{node_kg.sum()}" radius="0.0001"
              point="{words(positions_m)}" element="{words(tets)}">
      <contact selfcollide="none" contype="0" conaffinity="0"/>
      <elasticity young="{young_pa}" poisson="{poisson_ratio}" damping="0"/>
      <pin id="{words(held)}"/>
    </flexcomp>
  </worldbody>
</mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    # The compiler shares the mass out evenly.
    is_free = np.ones(n_nodes, dtype=bool)
    is_free[held] = False
    model.body_mass[model.flex_vertbodyid[is_free]] = node_kg[is_free]
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model, loaded, round_n, load_step_s


def main():
    integrator, file = sys.argv[1:3]
    step_s, seconds = (float(word) for word in sys.argv[3:5])
    model, loaded, round_n, load_step_s = model_of(file, step_s, integrator)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    at_rest_m = data.flexvert_xpos.copy()
    bodies = model.flex_vertbodyid[loaded]
    times_ms = []
    deepest_m = 0.0
    start = time.monotonic()
    n_steps = 0
    while time.monotonic() - start < (1.0 + WARM_UP_SHARE) * seconds or len(times_ms) < 20:
        data.xfrc_applied[bodies, 2] = round_n[int(n_steps * step_s / load_step_s) % len(round_n)]
        before_ns = time.thread_time_ns()
        mujoco.mj_step(model, data)
        time_ms = (time.thread_time_ns() - before_ns) / 1e6
        if time.monotonic() - start > WARM_UP_SHARE * seconds:
            times_ms.append(time_ms)
        deepest_m = max(deepest_m, np.linalg.norm(data.flexvert_xpos - at_rest_m, axis=1).max())
        n_steps += 1
    median_ms, p99_ms = np.quantile(times_ms, [0.5, 0.99])
    print(median_ms, p99_ms, len(times_ms), 1e3 * deepest_m)


if __name__ == "__main__":
    main()
