//! Time of a step of rapier3d's soft body (FEM solver, neo-Hookean cells) on a mesh and load of Glisson's benchmarks.
//!
//! `peer-rapier FILE STEP_S SECONDS`. The file has a line `n_nodes n_tets n_held n_loaded n_round young_pa poisson_ratio
//! density_kg_per_m3 load_step_s`, then the nodes [m], tetrahedra, held nodes, loaded nodes, and for each of the `n_round` load
//! steps of a round the force on each loaded node along z [N]. Answers `median_ms p99_ms n_steps deepest_mm`, of CPU time.

use cpu_time::ThreadTime;
use rapier3d::prelude::*;
use std::time::Instant;

/// Of the steps before the timed ones.
const WARM_UP_SHARE: f64 = 0.3;

/// Lengths are in tenths of a metre: with the metre as unit, a body of 20,000 tetrahedra of this size falls apart in single precision.
const UNITS_PER_M: f64 = 10.0;

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, file, step_s, seconds] = &arguments[..] else { panic!("peer-rapier FILE STEP_S SECONDS") };
    let [step_s, seconds] = [step_s, seconds].map(|word| word.parse::<f64>().expect("a number"));
    let text = std::fs::read_to_string(file).expect("the body's file");
    let mut numbers = text.split_ascii_whitespace().map(|word| word.parse::<f64>().expect("a number"));
    let mut next = || numbers.next().expect("the file goes on");
    let [n_nodes, n_tets, n_held, n_loaded, n_round] = std::array::from_fn(|_| next() as usize);
    let [young_pa, poisson_ratio, density_kg_per_m3, load_step_s] = std::array::from_fn(|_| next());
    let mut length = || (UNITS_PER_M * next()) as Real;
    let mut vector = || Vector::new(length(), length(), length());
    let positions: Vec<Vector> = (0..n_nodes).map(|_| vector()).collect();
    let tets: Vec<[u32; 4]> = (0..n_tets).map(|_| std::array::from_fn(|_| next() as u32)).collect();
    let held: Vec<u32> = (0..n_held).map(|_| next() as u32).collect();
    let loaded: Vec<usize> = (0..n_loaded).map(|_| next() as usize).collect();
    let round: Vec<Vec<f64>> = (0..n_round).map(|_| (0..n_loaded).map(|_| next()).collect()).collect();

    let mut masses = vec![0.0; n_nodes];
    for tet in &tets {
        let [a, b, c, d] = tet.map(|n| positions[n as usize]);
        let volume_m3 = f64::from((b - a).cross(c - a).dot(d - a).abs()) / 6.0 / UNITS_PER_M.powi(3);
        tet.iter().for_each(|&n| masses[n as usize] += (density_kg_per_m3 * volume_m3 / 4.0) as Real);
    }
    let builder = SoftBodyBuilder::new(positions.clone())
        .cells(tets)
        .masses(masses)
        .cell_model(SoftBodyCellModel::NeoHookean)
        .material(SoftBodyMaterial {
            young_modulus: (young_pa / UNITS_PER_M) as Real,
            poisson_ratio: poisson_ratio as Real,
            elastic_damping_ratio: 0.0,
            ..Default::default()
        })
        .solver(SoftBodySolver::Fem)
        .pinned_particles(held)
        .no_surface_collider()
        .can_sleep(false);
    let mut world = PhysicsWorld::new();
    world.gravity = Vector::ZERO;
    world.integration_parameters.dt = step_s as Real;
    world.integration_parameters.num_solver_iterations = 1;
    world.integration_parameters.soft_bodies.max_extra_substeps = 0;
    let handle = world.insert_soft_body(builder);

    let (start, mut times_ms) = (Instant::now(), Vec::new());
    let mut deepest: Real = 0.0;
    let mut n_steps = 0;
    while start.elapsed().as_secs_f64() < (1.0 + WARM_UP_SHARE) * seconds || times_ms.len() < 20 {
        let body = &mut world.soft_bodies[handle];
        body.reset_forces(false);
        let turn = (f64::from(n_steps) * step_s / load_step_s) as usize % n_round;
        for (&n, &force_n) in loaded.iter().zip(&round[turn]) {
            body.add_particle_force(n, Vector::new(0.0, 0.0, (UNITS_PER_M * force_n) as Real), true);
        }
        let before = ThreadTime::now();
        world.step();
        let time_ms = 1e3 * before.elapsed().as_secs_f64();
        if start.elapsed().as_secs_f64() > WARM_UP_SHARE * seconds {
            times_ms.push(time_ms);
        }
        for (now, at_rest) in world.soft_bodies[handle].particle_positions().zip(&positions) {
            deepest = deepest.max((now - *at_rest).length());
        }
        n_steps += 1;
    }
    times_ms.sort_by(f64::total_cmp);
    let at = |share: f64| times_ms[((times_ms.len() - 1) as f64 * share) as usize];
    println!("{} {} {} {}", at(0.5), at(0.99), times_ms.len(), 1e3 * f64::from(deepest) / UNITS_PER_M);
}
