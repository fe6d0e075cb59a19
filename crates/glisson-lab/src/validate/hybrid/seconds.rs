//! Error against processor seconds (report's fig. 5.9).

use super::{Case, Load, SEED, STEP_S, ZONE_CELLS, figure, timed_s};
use crate::bodies::{displacements, linear_equilibrium, linear_model, slow_frequency_per_s};
use crate::validate::{Experiment, Outcome};
use glisson::math::DVec3;
use glisson::model::DeformableModel;
use glisson::solve::BoundaryConditions;
use glisson_report::plot::{Series, SeriesStyle};

/// The error that counts as reached, in edges.
const TARGET: f64 = 1e-2;

/// Processor time [s] and error.
type Curve = Vec<[f64; 2]>;

/// Error after each of `n` pieces of work on a model.
fn watched<M>(model: &mut M, n: usize, work: impl Fn(&mut M), error: impl Fn(&M) -> f64) -> Curve {
    let mut cpu_s = 0.0;
    (0..n)
        .map(|_| {
            cpu_s += timed_s(|| work(model));
            [cpu_s, error(model)]
        })
        .collect()
}

fn of_five_zones(case: &Case) -> anyhow::Result<Curve> {
    let mut hybrid = case.precomputed(&case.zones(ZONE_CELLS[3])?, |_| ())?;
    Ok(watched(&mut hybrid, 400, |m| m.step(STEP_S), |m| case.error(m.displacements_m())))
}

/// Tensor-mass with the damping that is fastest.
struct OfTensorMass {
    damping_per_s: f64,
    step_s: f64,
    curve: Curve,
}

fn of_tensor_mass(case: &Case) -> anyhow::Result<OfTensorMass> {
    // The slowest motion with the moved node held: by Rayleigh's quotient of the deformation under a body force.
    let mut conditions = BoundaryConditions::fixed(&case.fixed);
    case.load.displacements.iter().for_each(|i| conditions.fix_node(i.node));
    let push_n = vec![DVec3::Z; case.mesh.positions_m.len()];
    let bent_m = linear_equilibrium(&case.mesh, &case.material, &conditions, &push_n)?;
    let damping_per_s = 2.0 * slow_frequency_per_s(&case.mesh, &push_n, &bent_m);
    let mut model = linear_model(&case.mesh, &case.material, &case.fixed, damping_per_s)?;
    model.apply(&case.load);
    let step_s = model.time_step_s();
    let curve = watched(
        &mut model,
        600,
        |m| (0..4).for_each(|_| m.step(step_s)),
        |m| case.error(&displacements(&case.mesh, m)),
    );
    Ok(OfTensorMass { damping_per_s, step_s, curve })
}

/// When the error comes below the target for good: no later error is above [s].
fn reached_s(curve: &[[f64; 2]]) -> f64 {
    let last = curve.iter().rposition(|[_, e]| *e > TARGET).map_or(0, |i| i + 1);
    curve.get(last).map_or(f64::INFINITY, |p| p[0])
}

pub(super) fn experiments(outcome: &mut Outcome) -> anyhow::Result<String> {
    let case = Case::bar(Load::Displacement)?;
    let of_hybrid = of_five_zones(&case)?;
    let OfTensorMass { damping_per_s, step_s, curve: of_tensor_mass } = of_tensor_mass(&case)?;
    let times_s = [reached_s(&of_hybrid), reached_s(&of_tensor_mass)];
    let sooner = Experiment::within(
        "bar, displacement: processor time of tensor-mass over that of five zones, until the mean error stays below \
         0.01 edges",
        SEED,
        times_s[1] / times_s[0],
        [1.0, f64::INFINITY],
    );
    outcome.experiments.push(sooner.of_times());
    let curve = |name: &str, points: &[[f64; 2]]| Series {
        name: name.into(),
        points: points.iter().map(|[t, e]| [1e3 * t, e.max(1e-16).log10()]).collect(),
        style: SeriesStyle::Line,
    };
    outcome.figures.push(figure(
        "hybrid_seconds.svg",
        "Bar under an imposed displacement: error against processor time, one thread.".into(),
        "Five pre-computed zones and tensor-mass",
        "processor time [ms]",
        vec![curve("hybrid, 5 zones", &of_hybrid), curve("tensor-mass", &of_tensor_mass)],
    ));
    Ok(format!(
        "Error against time: tensor-mass of {} nodes with the damping that is fastest ({damping_per_s:.0}/s, steps of \
         {:.2} ms) needs {:.2} ms of processor time to stay below 0.01 edges, the hybrid of five zones {:.2} ms.",
        case.mesh.positions_m.len(),
        1e3 * step_s,
        1e3 * times_s[1],
        1e3 * times_s[0],
    ))
}
