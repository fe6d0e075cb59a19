//! A liver on its bed at 1 g: at rest from the first step, for a minute, in real time; the same bits at any number of threads
//! and after a restore in mid-contact.

use super::{Experiment, Outcome};
use crate::bed::write_liver_on_bed;
use crate::scratch::ScratchFolder;
use anyhow::Context;
use glisson::math::DVec3;
use glisson::scene::{Scene, build_world};
use glisson::world::{StepInput, World};
use glisson_runtime::workers::shared_workers;
use std::fmt::Write as _;
use std::path::Path;
use std::time::Instant;

const OWN: &str = "requirement";
const N_TETS: usize = 6_300;
const SECONDS: f64 = 60.0;
/// After so long the drift counts [s].
const SETTLED_S: f64 = 5.0;
const MOST_DEEP_M: f64 = 0.5e-3;
const MOST_DRIFT_M_PER_MINUTE: f64 = 0.1e-3;

fn open(scene: &Path, n_threads: usize) -> anyhow::Result<World> {
    let text = std::fs::read_to_string(scene)?;
    let folder = scene.parent().context("a scene lies in a folder")?;
    let workers = shared_workers(n_threads)?;
    Ok(build_world(&Scene::parse(&text)?, folder, workers)?.0)
}

fn step(world: &mut World, n: usize) -> f64 {
    let input = StepInput::of(&[world.tools()[0].home]);
    (0..n).map(|_| world.step(&input).self_contact.penetration_m).fold(0.0, f64::max)
}

fn middle_m(world: &World) -> DVec3 {
    let liver = world.spec().bodies[0].nodes.clone();
    let n = liver.len() as f64;
    liver.map(|node| world.state().positions_m[node as usize]).sum::<DVec3>() / n
}

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let mut outcome = Outcome::default();
    let folder = ScratchFolder::new()?;
    let scene = write_liver_on_bed(folder.path(), N_TETS)?;
    let mut world = open(&scene, 1)?;
    let dt_s = world.spec().time_step_s;
    let per_second = (1.0 / dt_s).round() as usize;
    let rest_m = world.state().positions_m.to_vec();
    let start_m = middle_m(&world);
    let farthest_m = |world: &World| {
        world.state().positions_m.iter().zip(&rest_m).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
    };
    let mut notes = String::from(
        "\n### A liver on its bed\n\n6,300 tetrahedra, implicit, stable neo-Hooke, steps of 10 ms, nothing fixed; bed, kidney, spine and \
         stomach rigid. Way of the middle since the start, of the node that went furthest, and deepest overlap before the response.\n\n\
         | after [s] | middle [mm] | furthest node [mm] | deepest [mm] | contacts | real-time factor |\n|---|---|---|---|---|---|\n",
    );
    let (mut deepest_m, mut settled_m, mut slowest) = (0.0_f64, start_m, f64::INFINITY);
    let mut at_s = 0.0;
    for until_s in [0.1, 1.0, SETTLED_S, 20.0, 40.0, SECONDS] {
        let n = ((until_s - at_s) * per_second as f64).round() as usize;
        let begun = Instant::now();
        let deep_m = step(&mut world, n);
        let factor = (until_s - at_s) / begun.elapsed().as_secs_f64();
        at_s = until_s;
        deepest_m = deepest_m.max(deep_m);
        if until_s == SETTLED_S {
            settled_m = middle_m(&world);
        }
        slowest = slowest.min(factor);
        writeln!(
            notes,
            "| {until_s} | {:.4} | {:.3} | {:.4} | {} | {factor:.2} |",
            1e3 * middle_m(&world).distance(start_m),
            1e3 * farthest_m(&world),
            1e3 * deep_m,
            world.report().self_contact.n_contacts
        )?;
    }
    outcome.notes += &notes;
    let drift_m = middle_m(&world).distance(settled_m) * 60.0 / (SECONDS - SETTLED_S);
    let mut push = |experiment| outcome.experiments.push(experiment);
    push(Experiment::at_most("deepest overlap in a minute [m]", OWN, deepest_m, MOST_DEEP_M));
    push(Experiment::at_most("drift in a minute [m]", OWN, drift_m, MOST_DRIFT_M_PER_MINUTE));
    push(Experiment::within("real-time factor, one core", OWN, slowest, [1.0, 1e3]).of_times());

    let mut hashes = Vec::new();
    for n_threads in [1, 2, 4] {
        let mut world = open(&scene, n_threads)?;
        step(&mut world, per_second / 2);
        let saved = world.save();
        step(&mut world, 7);
        world.restore(&saved);
        step(&mut world, per_second / 2);
        hashes.push(world.state_hash());
    }
    let mut whole = open(&scene, 1)?;
    step(&mut whole, 2 * (per_second / 2));
    let n_other = hashes.iter().filter(|hash| **hash != whole.state_hash()).count();
    push(Experiment::at_most("runs with other bits (1, 2, 4 threads, restored)", OWN, n_other as f64, 0.0));
    Ok(outcome)
}
