"""Time of a step of Newton's soft body (neo-Hooke) on a mesh and load of Glisson's benchmarks, on a core.

newton_soft_body.py SOLVER FILE STEP_S SECONDS [SUBSTEPS [ITERATIONS]]. The solver is `semi_implicit` or `vbd`; the
file is that of `rapier/src/main.rs`. Answers `median_ms p99_ms n_steps deepest_mm edge_mm n_substeps is_sound` in its
last line: processor time of a step, how far the loaded nodes are moved along the load in the mean over all steps,
and 1 where all is finite and no tetrahedron is turned inside out at the end.

`semi_implicit` is what is compared: with the fewest substeps that are stable it is the fastest of Newton's solvers on
flaps of 480, 2,040 and 6,630 tetrahedra, and right. Tried, in steps of 2 ms, where in balance the edge is pulled by
1.32, 1.33 and 1.33 mm:
- SolverSemiImplicit, which is explicit: 3, 5 and 7 substeps, 1.33, 1.34 and 1.34 mm; one fewer bursts, as
  `fewest_substeps` says. Lifted by 28 mm all three last, by 55 to 65 mm 5 and 7 burst and 6 and 8 do not.
- SolverVBD lasts with any number of iterations, but one takes as long as all those substeps or longer (0.18, 0.9 and
  2.5 ms, on a busy machine), and few give way: with 1 the edge is pulled by 3.1, 7.4 and 18 mm, with 10, its default, by
  1.35, 1.56 and 2.5 mm; for 3 % too much at most it takes 10, 20 and 40. In steps of 10 ms 10 give 5.9, 11.5 and 35 mm.
- SolverXPBD: about 7 mm where it lasts (from 4 substeps of 10 iterations with 480, from between 4 and 10 with 6,630),
  and no iterations change that: its constraints have no stiffness against shear at rest.

One core: Warp's CPU device runs a kernel on the thread that launches it; the process has that thread alone (BLAS is told
to have one), and the time is that of all threads.
"""

import os
import pathlib
import sys
import time

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import newton
import numpy as np
import warp as wp

WARM_UP_SHARE = 0.3
VBD_ITERATIONS = 10


class Body:
    """A body of the file, and what pulls it."""

    def __init__(self, file):
        with open(file, encoding="ascii") as text:
            numbers = iter(np.array(text.read().split(), dtype=float))
        n_nodes, n_tets, n_held, n_loaded, n_round = (int(next(numbers)) for _ in range(5))
        young_pa, poisson_ratio, density_kg_per_m3, self.load_step_s = (next(numbers) for _ in range(4))

        def take(count):
            return np.fromiter((next(numbers) for _ in range(count)), dtype=float, count=count)

        self.positions_m = take(3 * n_nodes).reshape(-1, 3)
        self.tets = take(4 * n_tets).astype(int).reshape(-1, 4)
        self.held = take(n_held).astype(int)
        self.loaded = take(n_loaded).astype(int)
        self.round_n = take(n_round * n_loaded).reshape(n_round, n_loaded)
        self.mu_pa = young_pa / (2.0 * (1.0 + poisson_ratio))
        self.lambda_pa = young_pa * poisson_ratio / ((1.0 + poisson_ratio) * (1.0 - 2.0 * poisson_ratio))
        self.volumes_m3 = volumes_m3(self.positions_m, self.tets)
        self.node_kg = self.summed(np.repeat(density_kg_per_m3 * self.volumes_m3[:, None] / 4.0, 4, axis=1))

    def summed(self, of_corners):
        """What the corners of the tetrahedra give their nodes."""
        return np.bincount(self.tets.ravel(), weights=of_corners.ravel(), minlength=len(self.positions_m))

    def fewest_substeps(self, step_s):
        """The fewest with which symplectic Euler is stable at rest: shorter than 2 by the highest angular frequency."""
        edges_m = self.positions_m[self.tets[:, 1:]] - self.positions_m[self.tets[:, :1]]
        of_three = np.linalg.inv(edges_m).transpose(0, 2, 1)
        gradients_per_m = np.concatenate([-of_three.sum(axis=1, keepdims=True), of_three], axis=1)
        mode = np.random.default_rng(1).normal(size=self.positions_m.shape)
        squared_per_s2 = 0.0
        for _ in range(100):
            mode[self.held] = 0.0
            mode /= np.linalg.norm(mode)
            gradient = np.einsum("tci,tcj->tij", mode[self.tets], gradients_per_m)
            stress_pa = self.mu_pa * (gradient + gradient.transpose(0, 2, 1))
            stress_pa += self.lambda_pa * np.trace(gradient, axis1=1, axis2=2)[:, None, None] * np.eye(3)
            forces = np.einsum("tij,tcj,t->tci", stress_pa, gradients_per_m, self.volumes_m3)
            mode = np.stack([self.summed(forces[..., axis]) / self.node_kg for axis in range(3)], axis=1)
            mode[self.held] = 0.0
            squared_per_s2 = np.linalg.norm(mode)
        return int(np.ceil(step_s * np.sqrt(squared_per_s2) / 2.0))


def volumes_m3(positions_m, tets):
    corners_m = positions_m[tets]
    return np.linalg.det(corners_m[:, 1:] - corners_m[:, :1]) / 6.0


def model_of(body, solver):
    mu_pa, lambda_pa = body.mu_pa, body.lambda_pa
    if solver == "semi_implicit":
        # Parameters of the law of Smith et al. (2018) with its logarithm, which agree with E and nu at small strain;
        # SolverVBD takes those of Lame and does so itself.
        mu_pa, lambda_pa = 4.0 / 3.0 * mu_pa, lambda_pa + 5.0 / 6.0 * mu_pa
    node_kg = body.node_kg.copy()
    # What has no mass stays.
    node_kg[body.held] = 0.0
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    at_rest = [(0.0, 0.0, 0.0)] * len(node_kg)
    builder.add_particles([tuple(position_m) for position_m in body.positions_m.tolist()], at_rest, node_kg.tolist())
    for tet in body.tets.tolist():
        builder.add_tetrahedron(*tet, k_mu=mu_pa, k_lambda=lambda_pa, k_damp=0.0)
    builder.color()
    model = builder.finalize("cpu")
    # No contact between particles.
    model.particle_grid = None
    return model


def recorded_steps(model, solver, forces_n, step_s, n_substeps):
    """Two states, which are exchanged after each substep, and a step from each as a graph: no time of Python's is in it."""
    states, control = [model.state(), model.state()], model.control()

    def step(now):
        for _ in range(n_substeps):
            wp.copy(states[now].particle_f, forces_n)
            solver.step(states[now], states[1 - now], control, None, step_s / n_substeps)
            now = 1 - now

    # Compiles the kernels.
    step(0)
    graphs = []
    for now in (0, 1):
        with wp.ScopedCapture(device="cpu") as capture:
            step(now)
        graphs.append(capture.graph)
    for state in states:
        state.particle_q.assign(model.particle_q)
        state.particle_qd.zero_()
    return states, graphs


def main():
    name, file = sys.argv[1:3]
    step_s, seconds = (float(word) for word in sys.argv[3:5])
    asked = [int(word) for word in sys.argv[5:7]]
    body = Body(file)
    n_substeps = asked[0] if asked else body.fewest_substeps(step_s) if name == "semi_implicit" else 1
    wp.config.log_level = wp.LOG_WARNING
    # Compiled kernels are kept beside the packages.
    wp.config.kernel_cache_dir = str(pathlib.Path(newton.__file__).parents[1] / "kernels")
    model = model_of(body, name)
    if name == "semi_implicit":
        solver = newton.solvers.SolverSemiImplicit(model)
    else:
        solver = newton.solvers.SolverVBD(model, iterations=asked[1] if len(asked) > 1 else VBD_ITERATIONS)
    forces_n = wp.zeros(model.particle_count, dtype=wp.vec3, device="cpu")
    states, graphs = recorded_steps(model, solver, forces_n, step_s, n_substeps)
    at_rest_m = model.particle_q.numpy().copy()
    times_ms = []
    deepest_m, edges_m = 0.0, 0.0
    start = time.monotonic()
    n_steps, now = 0, 0
    while time.monotonic() - start < (1.0 + WARM_UP_SHARE) * seconds or len(times_ms) < 20:
        forces_n.numpy()[body.loaded, 2] = body.round_n[int(n_steps * step_s / body.load_step_s) % len(body.round_n)]
        before_ns = time.process_time_ns()
        wp.capture_launch(graphs[now])
        time_ms = (time.process_time_ns() - before_ns) / 1e6
        now = (now + n_substeps) % 2
        if time.monotonic() - start > WARM_UP_SHARE * seconds:
            times_ms.append(time_ms)
        moved_m = states[now].particle_q.numpy() - at_rest_m
        deepest_m = max(deepest_m, np.linalg.norm(moved_m, axis=1).max())
        edges_m += moved_m[body.loaded, 2].mean()
        n_steps += 1
    positions_m = states[now].particle_q.numpy()
    is_sound = np.isfinite(positions_m).all() and (volumes_m3(positions_m, body.tets) > 0.0).all()
    median_ms, p99_ms = np.quantile(times_ms, [0.5, 0.99])
    print(median_ms, p99_ms, len(times_ms), 1e3 * deepest_m, 1e3 * edges_m / n_steps, n_substeps, int(is_sound))


if __name__ == "__main__":
    main()
