//! The hybrid model by exact condensation against the direct solution and against tensor-mass alone, in processor time.

use glisson::math::DVec3;
use glisson::model::hybrid::condensed::{CondensedHybrid, CondensedParams, StoredNodes, Updated};
use glisson::model::tensor_mass::{TensorMass, TensorMassParams};
use glisson::model::{Constraints, DeformableModel, DynamicBody, NodalForce};
use glisson::solve::{BoundaryConditions, StaticProblem, solve_static};

use super::{Experiment, Figure, Outcome};
use crate::bench::hybrid::ZonedBody;
use crate::bench::thread_cpu_ns;
use crate::plot::{LinePlot, Series, SeriesStyle};

const SEED_003: &str = "Checoury 2002, s. 5.2 and fig. 5.9";
const OWN: &str = "requirement";

/// Tetrahedra of the liver-like body: about 4,900 nodes.
const N_TETS: usize = 25_000;

/// The error that counts as arrived.
const ARRIVED: f64 = 1e-3;

/// The factor asked for.
const SOONER: f64 = 10.0;

/// Dampings tried [1/s]; each side gets the one with which it arrives first.
const DAMPINGS_PER_S: [f64; 9] = [4.0, 8.0, 12.0, 18.0, 27.0, 40.0, 60.0, 100.0, 200.0];

/// Steps between two looks at the error.
const STEPS_PER_LOOK: usize = 10;

/// Simulated time after which a run is given up [s].
const LONGEST_S: f64 = 1.5;

/// Error after so much processor time.
#[derive(Clone, Default)]
struct Run {
    damping_per_s: f64,
    /// Processor time [s] and error.
    points: Vec<[f64; 2]>,
    /// Steps a second of processor time.
    steps_per_s: f64,
}

impl Run {
    /// When the error comes below [`ARRIVED`] for good [s].
    fn arrival_s(&self) -> f64 {
        let late = self.points.iter().rposition(|p| p[1] > ARRIVED);
        let next = late.map_or(0, |i| i + 1);
        self.points.get(next).map_or(f64::INFINITY, |p| p[0])
    }
}

struct Case {
    body: ZonedBody,
    constraints: Constraints,
    direct_m: Vec<DVec3>,
}

impl Case {
    /// Twenty neighbouring nodes of a zone's surface pressed with 1 N altogether.
    fn new(body: ZonedBody, zone: usize) -> anyhow::Result<Self> {
        let force_n = DVec3::new(0.01, 0.0, -0.05);
        let nodes = body.patch(zone, 0.5, 20);
        let forces: Vec<NodalForce> = nodes.into_iter().map(|node| NodalForce { node, force_n }).collect();
        let mut conditions = BoundaryConditions::new();
        body.fixed.iter().for_each(|f| conditions.fix_node(f.node));
        let mut nodal_force_n = vec![DVec3::ZERO; body.mesh.positions_m.len()];
        forces.iter().for_each(|f| nodal_force_n[f.node.index()] = f.force_n);
        let problem = StaticProblem {
            mesh: &body.mesh,
            material: &body.material,
            conditions: &conditions,
            nodal_force_n: &nodal_force_n,
        };
        let direct_m = solve_static(&problem)?.displacement_m;
        Ok(Self { constraints: Constraints { displacements: Vec::new(), forces }, direct_m, body })
    }

    /// Largest distance from the direct solution, every node included, over its largest displacement.
    fn error(&self, model: &dyn DeformableModel) -> f64 {
        let scale = self.direct_m.iter().map(|u| u.length()).fold(0.0, f64::max);
        let rest = &self.body.mesh.positions_m;
        let nodes = model.state().positions_m.iter().zip(rest).zip(&self.direct_m);
        nodes.map(|((p, r), u)| (*p - *r).distance(*u)).fold(0.0, f64::max) / scale
    }

    fn tensor_mass(&self, damping_per_s: f64, step_s: f64, most_s: f64) -> anyhow::Result<Run> {
        let body = DynamicBody { ..self.body.dynamic_body(damping_per_s, step_s) };
        let mut model = TensorMass::build(&TensorMassParams { body, material: &self.body.material })?;
        model.apply(&self.constraints);
        let mut run = Run { damping_per_s, ..Run::default() };
        let (mut spent_s, mut n_steps) = (0.0, 0);
        while (n_steps as f64) * step_s < LONGEST_S && spent_s < most_s {
            spent_s += timed_s(|| (0..STEPS_PER_LOOK).for_each(|_| model.step(step_s)));
            n_steps += STEPS_PER_LOOK;
            run.points.push([spent_s, self.error(&model)]);
            if has_settled(&run) {
                break;
            }
        }
        run.steps_per_s = n_steps as f64 / spent_s;
        Ok(run)
    }

    /// A run's time is that of its steps, the last of which brings every node up to date.
    fn hybrid(&self, model: &mut CondensedHybrid, damping_per_s: f64, step_s: f64) -> Run {
        model.take_over(&self.body.mesh.positions_m);
        model.apply(&self.constraints);
        let mut run = Run { damping_per_s, ..Run::default() };
        let (mut spent_s, mut n_steps) = (0.0, 0);
        while (n_steps as f64) * step_s < LONGEST_S {
            model.set_updated(Updated::LoadedZones);
            let n = STEPS_PER_LOOK - 1;
            let steps_s = timed_s(|| (0..n).for_each(|_| model.step(step_s)));
            model.set_updated(Updated::All);
            let last_s = timed_s(|| model.step(step_s));
            run.points.push([spent_s + steps_s + last_s, self.error(model)]);
            spent_s += steps_s * STEPS_PER_LOOK as f64 / n as f64;
            n_steps += STEPS_PER_LOOK;
            if has_settled(&run) {
                break;
            }
        }
        run.steps_per_s = n_steps as f64 / spent_s;
        run
    }

    fn build(&self, damping_per_s: f64, step_s: f64) -> anyhow::Result<CondensedHybrid> {
        let body = self.body.dynamic_body(damping_per_s, step_s);
        Ok(CondensedHybrid::build(&CondensedParams {
            stored: StoredNodes::Surface,
            ..CondensedParams::new(body, &self.body.material, &self.body.zones, &self.body.laws)
        })?)
    }
}

/// Far below the error asked for, for some looks.
fn has_settled(run: &Run) -> bool {
    run.points.len() > 5 && run.points[run.points.len() - 5..].iter().all(|p| p[1] < 0.1 * ARRIVED)
}

/// Processor time of a piece of work on this thread [s]; nothing in it uses another one.
fn timed_s(work: impl FnOnce()) -> f64 {
    let before = thread_cpu_ns();
    work();
    (thread_cpu_ns() - before) as f64 * 1e-9
}

fn first(runs: Vec<Run>) -> anyhow::Result<Run> {
    let first = runs.into_iter().min_by(|a, b| a.arrival_s().total_cmp(&b.arrival_s()));
    first.ok_or_else(|| anyhow::anyhow!("no run"))
}

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let [two, cut] = ZonedBody::both(N_TETS)?;
    let n_nodes = two.mesh.positions_m.len();
    let (two, cut) = (Case::new(two, 1)?, Case::new(cut, 1)?);

    let tensor_mass = |case: &Case| -> anyhow::Result<Run> {
        let step_s = TensorMass::stable_step(&case.body.mesh, &case.body.material)?.step_s;
        let (mut runs, mut most_s) = (Vec::new(), f64::INFINITY);
        for damping_per_s in DAMPINGS_PER_S {
            let run = case.tensor_mass(damping_per_s, step_s, most_s)?;
            most_s = most_s.min(3.0 * run.arrival_s());
            runs.push(run);
        }
        first(runs)
    };

    // (i): one step is the solution.
    let mut model = two.build(0.0, 1e-3)?;
    model.apply(&two.constraints);
    model.step(1e-3);
    model.take_over(&two.body.mesh.positions_m);
    let precomputed_s = timed_s(|| {
        model.apply(&two.constraints);
        model.step(1e-3);
    });
    let precomputed_error = two.error(&model);
    drop(model);
    let alone = tensor_mass(&two)?;

    // (ii): the zone comes to rest, the rest with it.
    let mut runs = Vec::new();
    let mut model = cut.build(0.0, 1.0)?;
    let zone_step_s = model.stable_step_s().unwrap_or(1e-3);
    for damping_per_s in DAMPINGS_PER_S {
        model.set_damping(damping_per_s);
        runs.push(cut.hybrid(&mut model, damping_per_s, zone_step_s));
    }
    let around_cut = first(runs)?;
    let size = model.size();
    drop(model);
    let alone_cut = tensor_mass(&cut)?;

    let factors = [alone.arrival_s() / precomputed_s, alone_cut.arrival_s() / around_cut.arrival_s()];
    let rest_error = around_cut.points.iter().map(|p| p[1]).fold(f64::INFINITY, f64::min);
    let experiments = vec![
        Experiment::at_most(
            "two pre-computed zones against the direct solution, every node, relative",
            OWN,
            precomputed_error,
            1e-10,
        ),
        Experiment::at_most(
            "dynamic zone around a cut, at rest, against the direct solution, every node, relative",
            OWN,
            rest_error,
            0.1 * ARRIVED,
        ),
        Experiment::within(
            "error 1e-3 sooner than tensor-mass alone, processor time: two pre-computed zones",
            SEED_003,
            factors[0],
            [SOONER, f64::INFINITY],
        ),
        Experiment::within(
            "error 1e-3 sooner than tensor-mass alone, processor time: dynamic zone around a cut",
            SEED_003,
            factors[1],
            [SOONER, f64::INFINITY],
        ),
    ];
    let line = |name: &str, points: &[[f64; 2]], style| Series {
        name: name.into(),
        points: points.iter().filter(|p| p[1] > 0.0).map(|p| [1e3 * p[0], p[1].log10()]).collect(),
        style,
    };
    let plot = LinePlot {
        title: "Error against processor time".into(),
        x_label: "processor time of all threads [ms]".into(),
        y_label: "log10 of the largest error, relative".into(),
        series: vec![
            line("tensor-mass alone, uncut", &alone.points, SeriesStyle::Line),
            line("tensor-mass alone, cut", &alone_cut.points, SeriesStyle::Line),
            line("dynamic zone of 5 %", &around_cut.points, SeriesStyle::Line),
            line("two pre-computed zones", &[[precomputed_s, precomputed_error]], SeriesStyle::Points),
        ],
        size: [760, 460],
    };
    let row = |name: &str, run: &Run| {
        format!(
            "| {name} | {:.0} | {:.0} | {:.2} |\n",
            run.damping_per_s,
            run.steps_per_s,
            1e3 * run.arrival_s()
        )
    };
    let notes = format!(
        "Body of {n_nodes} nodes like a liver, 20 surface nodes pressed; each side with the damping of {DAMPINGS_PER_S:?} \
         1/s with which it arrives first, at its largest stable step. The dynamic zone has {} nodes, {} of them on the \
         frontier.\n\n| model | damping [1/s] | steps a second | error 1e-3 after [ms] |\n|---|---|---|---|\n{}{}{}\
         | two pre-computed zones | - | {:.0} | {:.2} |\n\nSooner than tensor-mass alone by {:.0} (two pre-computed \
         zones) and {:.1} (dynamic zone). Seed `003` reports a hybrid no faster than tensor-mass a refresh.\n",
        size.n_dynamic_nodes,
        size.n_dynamic_frontier_nodes,
        row("tensor-mass alone, uncut", &alone),
        row("tensor-mass alone, cut", &alone_cut),
        row("dynamic zone of 5 % around the cut", &around_cut),
        1.0 / precomputed_s,
        1e3 * precomputed_s,
        factors[0],
        factors[1],
    );
    let caption =
        "Largest error of all nodes against the direct solution, over processor time: the pre-computed \
                   zones are there at once, the dynamic zone moves little mass."
            .into();
    let figures = vec![Figure { file: "hybrid_condensed_error.svg", caption, plot }];
    Ok(Outcome { experiments, figures, notes })
}
