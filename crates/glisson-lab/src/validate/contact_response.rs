//! Local responses to contact: what a step of the thesis' cubes costs, and what each response leaves of a lasting contact.

use super::{Experiment, Outcome};
use crate::bench::colliding::{Moving, N_FRAMES, rocking_cubes};
use crate::bench::contact::collision;
use crate::bench::response::{
    CUBES_STEP_S, CubeMesh, GEOMETRIC, IMPULSE, PENALTY, PressedCubes, contact_and_response,
};
use crate::bench::{Settings, thread_cpu_ns};
use glisson::contact::broad_phase::BroadPhaseKind;
use glisson::contact::response::bodies::ResponseKind;
use glisson::contact::self_collision::{PairSearch, PairSearchParams};
use glisson::material::LinearElastic;
use glisson::mesh::box_mesh::cube_of_five;
use glisson::model::explicit_kernel::{ExplicitKernel, ExplicitKernelParams};
use glisson::model::kernel::KernelLaw;
use glisson::model::{DeformableModel, DynamicBody};
use std::fmt::Write as _;
use std::hint::black_box;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Instant;

const CUBES: &str = "seed 000 s. 4.2.2: below 1, 2.5 and 6 ms, display included, on its machine";
const RATES: &str = "seed 000 s. 4.3.3, fig. 4.6";
const BUCKETS: &str = "seed 001: 500 Hz without, 300 Hz with the update of the buckets, on its machine";
const OWN: &str = "requirement";

const KINDS: [(&str, ResponseKind); 3] =
    [("penalty", PENALTY), ("geometric", GEOMETRIC), ("impulse", IMPULSE)];
/// What the thesis says of the steps a second of each (s. 4.3.3).
const THESIS_RATES: [&str; 3] =
    ["20 % more than the others", "a little more than impulse", "above 1000 for one cut cube"];

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let mut outcome = Outcome::default();
    cost_of_cubes(&mut outcome)?;
    rates(&mut outcome)?;
    beside(&mut outcome)?;
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
        "### What a step costs\n\nCubes of 360 tetrahedra and 288 triangles (the thesis: 353 and 288), and finer ones of 625 and 300, their far sides \
         pressed towards each other, self-collision included. Processor time of one thread. The thesis' figures hold its display; ours is the \
         frame that is made for the viewer, which draws elsewhere.\n\n\
         | cubes | tetrahedra each | thesis, with display [ms] | ours, detection, response and deformation [ms] | frame for the viewer [ms] |\n\
         |---|---|---|---|---|\n",
    );
    for (cube, n_tets) in [(CubeMesh::Thesis, 360), (CubeMesh::Regular, 625)] {
        for (n, thesis_ms) in [(1, 1.0), (2, 2.5), (4, 6.0)] {
            let mut cubes = PressedCubes::new(n, cube, GEOMETRIC)?;
            (0..400).for_each(|_| cubes.step(CUBES_STEP_S));
            let step_ms = median_ms(41, || cubes.step(CUBES_STEP_S));
            let frame_ms = median_ms(41, || {
                black_box(cubes.frame());
            });
            writeln!(notes, "| {n} | {n_tets} | < {thesis_ms} | {step_ms:.3} | {frame_ms:.4} |")?;
            let name = format!("{n} cubes of {n_tets} tetrahedra: a step and a frame for the viewer [ms]");
            let ours_ms = step_ms + frame_ms;
            outcome.experiments.push(Experiment::at_most(&name, CUBES, ours_ms, thesis_ms).of_times());
        }
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
        "\n### The three responses\n\nTwo cubes of 368 tetrahedra, 592 triangles (the thesis: 596). A step is detection, response and deformation.\n\n\
         | response | thesis | steps a second |\n|---|---|---|\n",
    );
    let mut rates_hz = Vec::new();
    for ((name, kind), thesis) in KINDS.into_iter().zip(THESIS_RATES) {
        let mut cubes = PressedCubes::new(2, CubeMesh::ThesisPair, kind)?;
        (0..400).for_each(|_| cubes.step(CUBES_STEP_S));
        let rate_hz = 1e3 / median_ms(61, || cubes.step(CUBES_STEP_S));
        writeln!(notes, "| {name} | {thesis} | {rate_hz:.0} |")?;
        rates_hz.push(rate_hz);
    }
    let name = "592 triangles: steps a second by impulse, at least 1000";
    outcome.experiments.push(Experiment::within(name, RATES, rates_hz[2], [1e3, 1e9]).of_times());
    let name = "592 triangles: steps by penalty over those by geometric alteration";
    let ratio = rates_hz[0] / rates_hz[1];
    outcome.experiments.push(Experiment::within(name, "seed 000: 20 % more", ratio, [1.0, 1.6]).of_times());
    outcome.notes += &notes;
    Ok(())
}

/// Steps of four cubes that are watched with detection in their thread and beside it.
const N_WATCHED: usize = 4_000;

/// What detection finds of four rocking cubes, step by step or by a thread of its own.
struct Detection {
    search: PairSearch,
    found: Vec<[u32; 2]>,
}

impl Detection {
    fn of(surface: &Moving) -> Self {
        let pair_capacity = 64 * surface.triangles.len();
        let params = PairSearchParams {
            kind: BroadPhaseKind::Hierarchy,
            self_collision: true,
            margin_m: 0.0,
            pair_capacity,
        };
        let search = PairSearch::new(&params, &surface.frames_m[0], &surface.triangles, &surface.body_of);
        Self { search, found: Vec::with_capacity(pair_capacity) }
    }

    fn pairs(&mut self, positions_m: &[glisson::math::DVec3]) -> &[[u32; 2]] {
        self.search.update(positions_m);
        self.search.meeting_into(&mut self.found);
        &self.found
    }
}

/// Four rocking cubes, whose motion is given, so that the true pairs of every step are known; the mechanics' work is that of
/// four explicit models.
struct Watched {
    surface: Moving,
    /// Detection in the thread of the mechanics.
    in_thread: Detection,
    true_pairs: Vec<Vec<[u32; 2]>>,
    models: Vec<ExplicitKernel>,
}

/// What a thread that watches beside the mechanics came to.
struct Beside {
    /// Steps a second of the mechanics.
    steps_hz: f64,
    /// Detections a second.
    found_hz: f64,
    /// How much older than the step their pairs are [steps].
    mean_lag: f64,
    missed_percent: f64,
}

impl Watched {
    fn new() -> anyhow::Result<Self> {
        let surface = rocking_cubes(4);
        let mut in_thread = Detection::of(&surface);
        let true_pairs = surface.frames_m.iter().map(|f| in_thread.pairs(f).to_vec()).collect();
        let material = LinearElastic::from_young_poisson(20e3, 0.3, 1000.0)?;
        let mesh = cube_of_five(5, 0.05);
        let body = DynamicBody { time_step_s: 1e-4, ..DynamicBody::new(&mesh, 1000.0) };
        let materials = [material];
        let params = ExplicitKernelParams::new(body, KernelLaw::StVenantKirchhoff, &materials);
        let models = (0..4).map(|_| ExplicitKernel::build(&params)).collect::<Result<_, _>>()?;
        Ok(Self { surface, in_thread, true_pairs, models })
    }

    /// Steps a second with detection in the thread of the mechanics.
    fn in_thread_hz(&mut self) -> f64 {
        let start = Instant::now();
        for step in 0..N_WATCHED {
            self.models.iter_mut().for_each(|model| model.step(1e-4));
            self.in_thread.pairs(&self.surface.frames_m[step % N_FRAMES]);
        }
        N_WATCHED as f64 / start.elapsed().as_secs_f64()
    }

    /// Detection in a thread of its own.
    fn beside(&mut self) -> Beside {
        let (step_now, is_over) = (AtomicUsize::new(0), AtomicBool::new(false));
        let Self { surface, true_pairs, models, .. } = self;
        let (surface, true_pairs) = (&*surface, &*true_pairs);
        let mut detection = Detection::of(surface);
        let watch = || {
            let (mut lags, mut n_missed, mut n_true) = (Vec::new(), 0, 0);
            while !is_over.load(Ordering::Acquire) {
                let of = step_now.load(Ordering::Acquire);
                let found = detection.pairs(&surface.frames_m[of % N_FRAMES]);
                let now = step_now.load(Ordering::Acquire);
                let wanted = &true_pairs[now % N_FRAMES];
                n_missed += wanted.iter().filter(|pair| found.binary_search(pair).is_err()).count();
                n_true += wanted.len();
                lags.push(now - of);
            }
            (lags, n_missed, n_true)
        };
        let (steps_hz, (lags, n_missed, n_true)) = std::thread::scope(|scope| {
            let watcher = scope.spawn(watch);
            let start = Instant::now();
            for step in 0..4 * N_WATCHED {
                models.iter_mut().for_each(|model| model.step(1e-4));
                step_now.store(step, Ordering::Release);
            }
            let steps_hz = 4.0 * N_WATCHED as f64 / start.elapsed().as_secs_f64();
            is_over.store(true, Ordering::Release);
            (steps_hz, watcher.join().expect("the watcher does not panic"))
        });
        Beside {
            steps_hz,
            found_hz: steps_hz * lags.len() as f64 / (4 * N_WATCHED) as f64,
            mean_lag: lags.iter().sum::<usize>() as f64 / lags.len().max(1) as f64,
            missed_percent: 100.0 * n_missed as f64 / n_true.max(1) as f64,
        }
    }
}

/// Detection in the thread of the mechanics against a thread of its own.
fn beside(outcome: &mut Outcome) -> anyhow::Result<()> {
    let mut watched = Watched::new()?;
    let together_hz = watched.in_thread_hz();
    let Beside { steps_hz, found_hz, mean_lag, missed_percent } = watched.beside();
    writeln!(
        outcome.notes,
        "\n### Detection in the mechanics' thread or beside it\n\nFour rocking cubes, 1200 triangles, the mechanics of four cubes of 625 \
         tetrahedra; wall time. The thesis (s. 4.2.2) had a thread of its own first, whose pairs lag behind, and kept one thread.\n\n\
         | | steps a second | detections a second | pairs are older by [steps] | true pairs that are missing [%] |\n|---|---|---|---|---|\n\
         | one thread | {together_hz:.0} | {together_hz:.0} | 0 | 0 |\n\
         | two threads | {steps_hz:.0} | {found_hz:.0} | {mean_lag:.1} | {missed_percent:.1} |"
    )?;
    outcome.experiments.extend([
        Experiment::within(
            "detection beside the mechanics: steps a second over those of one thread",
            "seed 000 s. 4.2.2: two threads or one",
            steps_hz / together_hz,
            [1.0, 1e3],
        )
        .of_times(),
        Experiment::within(
            "detection beside the mechanics: age of its pairs [steps]",
            "seed 000 s. 4.2.2: detection lags behind",
            mean_lag,
            [0.5, 1e6],
        )
        .of_times(),
    ]);
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
    let mut cubes = PressedCubes::new(2, CubeMesh::Regular, kind)?;
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
