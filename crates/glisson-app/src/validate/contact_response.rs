//! Local responses to contact: what a step of the thesis' cubes costs, and what each response leaves of a lasting contact.

use super::{Experiment, Outcome};
use crate::bench::contact::collision;
use crate::bench::response::{CUBES_STEP_S, GEOMETRIC, IMPULSE, PENALTY, PressedCubes, contact_and_response};
use crate::bench::{Settings, thread_cpu_ns};
use glisson::contact::response::bodies::ResponseKind;
use std::fmt::Write as _;

const CUBES: &str = "seed 000 s. 4.2.2: below 1, 2.5 and 6 ms, display included, on its machine";
const RATES: &str = "seed 000 s. 4.3.3, fig. 4.6";
const BUCKETS: &str = "seed 001: 500 Hz without, 300 Hz with the update of the buckets, on its machine";
const OWN: &str = "requirement";

const KINDS: [(&str, ResponseKind); 3] =
    [("penalty", PENALTY), ("geometric", GEOMETRIC), ("impulse", IMPULSE)];

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let mut outcome = Outcome::default();
    cost_of_cubes(&mut outcome)?;
    rates(&mut outcome)?;
    buckets(&mut outcome)?;
    lasting_contact(&mut outcome)?;
    Ok(outcome)
}

/// Median processor time of a call [ms] over `n` groups of ten.
fn median_ms(n: usize, mut call: impl FnMut()) -> f64 {
    let mut times: Vec<f64> = (0..n)
        .map(|_| {
            let start_ns = thread_cpu_ns();
            (0..10).for_each(|_| call());
            1e-7 * (thread_cpu_ns() - start_ns) as f64
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[n / 2]
}

fn cost_of_cubes(outcome: &mut Outcome) -> anyhow::Result<()> {
    let mut notes = String::from(
        "### What a step costs\n\nCubes of 625 tetrahedra and 300 triangles (the thesis: 353 and 288), their far sides \
         pressed towards each other, self-collision included. Processor time of one thread.\n\n\
         | cubes | thesis, with display [ms] | ours, detection, response and deformation [ms] |\n|---|---|---|\n",
    );
    for (n, thesis_ms) in [(1, 1.0), (2, 2.5), (4, 6.0)] {
        let mut cubes = PressedCubes::new(n, GEOMETRIC)?;
        (0..400).for_each(|_| cubes.step(CUBES_STEP_S));
        let ours_ms = median_ms(41, || cubes.step(CUBES_STEP_S));
        writeln!(notes, "| {n} | < {thesis_ms} | {ours_ms:.3} |")?;
        let name = format!("{n} cubes: a step [ms]");
        outcome.experiments.push(Experiment::at_most(&name, CUBES, ours_ms, thesis_ms).of_times());
    }
    let mut step = contact_and_response(4);
    let contact_ms = median_ms(41, || {
        step();
    });
    let name = "four cubes: detection and response [ms]";
    outcome.experiments.push(Experiment::at_most(name, OWN, contact_ms, 0.3).of_times());
    outcome.notes += &notes;
    Ok(())
}

fn rates(outcome: &mut Outcome) -> anyhow::Result<()> {
    let mut notes = String::from(
        "\n### The three responses\n\nTwo cubes, 600 triangles (the thesis: 596). A step is detection, response and deformation.\n\n\
         | response | steps a second |\n|---|---|\n",
    );
    let mut rates_hz = Vec::new();
    for (name, kind) in KINDS {
        let mut cubes = PressedCubes::new(2, kind)?;
        (0..400).for_each(|_| cubes.step(CUBES_STEP_S));
        let rate_hz = 1e3 / median_ms(61, || cubes.step(CUBES_STEP_S));
        writeln!(notes, "| {name} | {rate_hz:.0} |")?;
        rates_hz.push(rate_hz);
    }
    let name = "600 triangles: steps a second by impulse, at least 1000";
    outcome.experiments.push(Experiment::within(name, RATES, rates_hz[2], [1e3, 1e9]).of_times());
    let name = "600 triangles: steps by penalty over those by geometric alteration";
    let ratio = rates_hz[0] / rates_hz[1];
    outcome.experiments.push(Experiment::within(name, "seed 000: 20 % more", ratio, [1.0, 1.6]).of_times());
    outcome.notes += &notes;
    Ok(())
}

fn buckets(outcome: &mut Outcome) -> anyhow::Result<()> {
    // About 1500 nodes.
    let settings = Settings { size: 6_300, threads: 1 };
    for (name, moving, wanted_hz) in
        [("with the update of the buckets", true, 300.0), ("without", false, 500.0)]
    {
        let mut prepared = collision(settings, moving)?;
        let rate_hz = 1e3 / median_ms(41, || (prepared.run)());
        outcome.experiments.push(
            Experiment::within(
                &format!("collision of a ball with an organ of 6300 tetrahedra, {name}: times a second"),
                BUCKETS,
                rate_hz,
                [wanted_hz, 1e12],
            )
            .of_times(),
        );
    }
    Ok(())
}

/// Time for which cubes are watched [s].
const LASTING_S: f64 = 0.4;

/// Deepest place and most motion in the second half of it.
struct Rest {
    penetration_m: f64,
    kinetic_j: f64,
}

fn rest(kind: ResponseKind, step_s: f64) -> anyhow::Result<Rest> {
    let mut cubes = PressedCubes::new(2, kind)?;
    let n_steps = (LASTING_S / step_s).round() as usize;
    let mut rest = Rest { penetration_m: 0.0, kinetic_j: 0.0 };
    for step in 0..n_steps {
        cubes.step(step_s);
        if 2 * step >= n_steps {
            let kinetic_j: f64 = (0..2).map(|b| cubes.bodies.model(b).report().kinetic_energy_j).sum();
            rest.penetration_m = rest.penetration_m.max(cubes.bodies.report().penetration_m);
            rest.kinetic_j = rest.kinetic_j.max(kinetic_j);
        }
    }
    Ok(rest)
}

fn lasting_contact(outcome: &mut Outcome) -> anyhow::Result<()> {
    let mut notes = String::from(
        "\n### A lasting contact\n\nThe far sides of two cubes go 0.7 mm towards each other in 0.1 s, over a gap of 0.2 mm, and stay; the deepest place inside \
         the other cube and the largest kinetic energy from 0.2 to 0.4 s. The thesis: penalties leave gaps or overlaps, impulses need steps ten times \
         shorter, geometric alteration serves lasting contact.\n\n\
         | response | step [ms] | penetration [mm] | kinetic energy [uJ] |\n|---|---|---|---|\n",
    );
    let mut depths_m = Vec::new();
    for (name, kind) in KINDS {
        for step_s in [CUBES_STEP_S, 0.1 * CUBES_STEP_S] {
            let Rest { penetration_m, kinetic_j } = rest(kind, step_s)?;
            writeln!(
                notes,
                "| {name} | {} | {:.3} | {:.2} |",
                1e3 * step_s,
                1e3 * penetration_m,
                1e6 * kinetic_j
            )?;
            depths_m.push(penetration_m);
        }
    }
    outcome.experiments.push(Experiment::at_most(
        "lasting contact, geometric, 0.5 ms: penetration [m]",
        OWN,
        depths_m[2],
        5e-4,
    ));
    outcome.experiments.push(Experiment::at_most(
        "lasting contact, impulse: penetration with steps of 0.05 ms over that with 0.5 ms",
        "seed 000 s. 4.3.2: impulses need steps ten times shorter",
        depths_m[5] / depths_m[4],
        1.0,
    ));
    outcome.notes += &notes;
    Ok(())
}
