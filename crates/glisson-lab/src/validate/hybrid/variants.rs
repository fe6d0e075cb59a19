//! Jacobi against Gauss-Seidel, method A against B, and partial exchange.

use super::{Case, EDGE_M, FORMULAS, Load, SEED, STEP_S, ZONE_CELLS};
use crate::validate::{Experiment, Outcome};
use glisson::mesh::NodeId;
use glisson::mesh::zones::Zones;
use glisson::model::DeformableModel;
use glisson::model::hybrid::exchange::{ExchangeAmount, Method, SweepOrder};

/// What zones pass on in a sweep.
const AMOUNTS: [(&str, ExchangeAmount); 5] = [
    ("all", ExchangeAmount::All),
    ("every second node in turn", ExchangeAmount::InTurn { n_sets: 2 }),
    ("every fourth node in turn", ExchangeAmount::InTurn { n_sets: 4 }),
    ("changes from 0.2 of the largest", ExchangeAmount::Largest { share: 0.2 }),
    ("changes from 0.6 of the largest", ExchangeAmount::Largest { share: 0.6 }),
];

/// Error of two zones after 200 sweeps at once over that after 100 in turn.
fn at_once_over_in_turn(case: &Case) -> anyhow::Result<f64> {
    let two = case.zones(ZONE_CELLS[0])?;
    let in_turn = case.errors(&mut case.precomputed(&two, |_| ())?, 100);
    let at_once = case.errors(&mut case.precomputed(&two, |p| p.order = SweepOrder::Jacobi)?, 200);
    Ok(at_once[199] / in_turn[99])
}

/// Largest difference of methods A and B on the surface after 50 sweeps [m].
fn between_methods_m(case: &Case, zones: &Zones) -> anyhow::Result<f64> {
    let mut of_a = case.precomputed(zones, |p| p.method = Method::Surface)?;
    let mut of_b = case.precomputed(zones, |_| ())?;
    for _ in 0..50 {
        of_a.step(STEP_S);
        of_b.step(STEP_S);
    }
    let surface = glisson::solve::boundary_nodes(&case.mesh);
    let between = |n: &NodeId| of_a.displacements_m()[n.index()].distance(of_b.displacements_m()[n.index()]);
    Ok(surface.iter().map(between).fold(0.0, f64::max))
}

/// What it takes until the mean error is 1e-3 of the edge: a line of the table.
fn amount_line(case: &Case, zones: &Zones, name: &str, amount: ExchangeAmount) -> anyhow::Result<String> {
    let mut model = case.precomputed(zones, |p| p.amount = amount)?;
    let (mut sweeps, mut products, mut reached) = (0_u32, 0, None);
    while reached.is_none() && sweeps < 4_000 {
        model.step(STEP_S);
        sweeps += 1;
        products += model.count().products();
        if case.error(model.displacements_m()) < 1e-3 {
            reached = Some((sweeps, products));
        }
    }
    let (reached_sweeps, reached_products) = reached.unwrap_or_default();
    let per_sweep = products / u64::from(sweeps);
    Ok(format!("| {name} | {per_sweep} | {reached_sweeps} | {reached_products} |\n"))
}

pub(super) fn experiments(outcome: &mut Outcome) -> anyhow::Result<String> {
    let case = Case::bar(Load::Force)?;
    let five = case.zones(ZONE_CELLS[3])?;
    outcome.experiments.extend([
        Experiment::within(
            "bar, two zones: error of 200 sweeps at once (Jacobi) over that of 100 in turn",
            SEED,
            at_once_over_in_turn(&case)?,
            [0.5, 2.0],
        ),
        Experiment::at_most(
            "bar, five zones: methods A and B after 50 sweeps, largest difference on the surface over the edge",
            FORMULAS,
            between_methods_m(&case, &five)? / EDGE_M,
            1e-10,
        ),
    ]);
    let mut notes = String::from(
        "What zones pass on in a sweep, five zones, force; one sweep's products and products until the mean error is \
         1e-3 of the edge:\n\n| passed on | products a sweep | sweeps | products |\n|---|---|---|---|\n",
    );
    let moved = Case::bar(Load::Displacement)?;
    let mut farthest = 0.0_f64;
    for (name, amount) in AMOUNTS {
        notes += &amount_line(&case, &five, name, amount)?;
        let mut model = moved.precomputed(&five, |p| (p.amount, p.sweeps_per_step) = (amount, 2_000))?;
        model.step(STEP_S);
        farthest = farthest.max(moved.error(model.displacements_m()));
    }
    outcome.experiments.push(Experiment::at_most(
        "bar, five zones, displacement: equilibrium whatever is passed on in a sweep, largest mean error over edge",
        "Checoury 2002 (seed 003), conclusion",
        farthest,
        1e-9,
    ));
    Ok(notes)
}
