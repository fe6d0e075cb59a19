//! Counts and frequencies beside the report's tables 5.1 and 5.2.

use super::{Case, FORMULAS, Load, STEP_S, ZONE_CELLS, liver_ends, liver_of_nodes, timed_s};
use crate::validate::{Experiment, Outcome};
use glisson::math::DVec3;
use glisson::mesh::zones::Zones;
use glisson::model::hybrid::exchange::{HybridExchange, Method, ZoneLaw, ZoneSize};
use glisson::model::{Constraints, DeformableModel};

/// Report: mesh, frequencies [Hz] of tensor-mass, A and B, and their products.
const REPORT: [(&str, [f64; 3], [u64; 3]); 7] = [
    ("bar, 2 zones", [37.0, 37.0, 37.2], [1_651, 2_060, 2_066]),
    ("bar, 3 zones", [37.0, 36.4, 36.4], [1_651, 3_060, 2_720]),
    ("bar, 4 zones", [37.0, 36.0, 36.2], [1_651, 3_810, 3_174]),
    ("bar, 5 zones", [37.0, 36.0, 36.1], [1_651, 4_460, 3_428]),
    ("liver 500, 2 zones", [33.6, 27.2, 26.0], [5_393, 29_610, 33_820]),
    ("liver 500, 3 zones", [33.6, 25.8, 27.0], [5_393, 64_349, 52_768]),
    ("liver 500, 4 zones", [33.6, 19.0, 27.5], [5_393, 93_370, 65_886]),
];

/// Products of a sweep without outer force, and sweeps a second of processor time.
fn refresh(case: &Case, model: &mut HybridExchange, dt_s: f64) -> (u64, f64) {
    let lifted_m: Vec<DVec3> = case.mesh.positions_m.iter().map(|p| *p + DVec3::Z * (0.1 * p.x)).collect();
    model.apply(&Constraints::default());
    model.take_over(&lifted_m);
    model.step(dt_s);
    let products = model.count().products();
    model.apply(&case.load);
    let mut times_s: Vec<f64> = (0..7).map(|_| timed_s(|| (0..10).for_each(|_| model.step(dt_s)))).collect();
    times_s.sort_unstable_by(f64::total_cmp);
    (products, 10.0 / times_s[3])
}

/// What was counted and timed of one row: tensor-mass, A and B.
struct Counted {
    sizes: Vec<ZoneSize>,
    products: [u64; 3],
    rates_hz: [f64; 3],
    /// Largest difference of products and stored tensors from the formulas.
    off_formula: f64,
}

impl Counted {
    fn of(case: &Case, zones: &Zones) -> anyhow::Result<Self> {
        let mut all_dynamic = case.model(zones, &vec![ZoneLaw::TensorMass; zones.n_zones()], |_| ())?;
        let mut models =
            [case.precomputed(zones, |p| p.method = Method::Surface)?, case.precomputed(zones, |_| ())?];
        let sizes: Vec<ZoneSize> = models[1].zone_sizes().map(|(_, size)| size).collect();
        let stable_s = 0.9 * all_dynamic.stable_step_s();
        let of_dynamic = refresh(case, &mut all_dynamic, stable_s);
        let [of_a, of_b] = models.each_mut().map(|model| refresh(case, model, STEP_S));
        let sum = |of: fn(ZoneSize) -> u64| sizes.iter().map(|s| of(*s)).sum::<u64>();
        let leaving = models.each_ref().map(|model| model.n_leaving_edges() as u64);
        let counted = [
            (of_a.0, sum(ZoneSize::surface_products) + leaving[0]),
            (of_b.0, sum(ZoneSize::all_nodes_products) + leaving[1]),
            (models[0].n_tensors() as u64, sum(ZoneSize::surface_tensors)),
            (models[1].n_tensors() as u64, sum(ZoneSize::all_nodes_tensors)),
        ];
        let off = counted.map(|(found, expected)| (found as f64 - expected as f64).abs());
        Ok(Self {
            sizes,
            products: [of_dynamic.0, of_a.0, of_b.0],
            rates_hz: [of_dynamic.1, of_a.1, of_b.1],
            off_formula: off.into_iter().fold(0.0, f64::max),
        })
    }

    fn table_line(
        &self,
        case: &Case,
        (name, report_hz, report_products): (&str, [f64; 3], [u64; 3]),
    ) -> String {
        let numbers = |n: [u64; 3]| n.map(|n| n.to_string()).join(", ");
        let hz = |n: [f64; 3]| n.map(|n| format!("{n:.0}")).join(", ");
        let zone = |s: &ZoneSize| format!("({}, {}, {})", s.n_nodes, s.n_frontier, s.n_surface);
        format!(
            "| {name} ({} nodes) | {} | {} | {} | {} | {} |\n",
            case.mesh.positions_m.len(),
            self.sizes.iter().map(zone).collect::<Vec<String>>().join(" "),
            numbers(self.products),
            numbers(report_products),
            hz(self.rates_hz),
            hz(report_hz),
        )
    }
}

pub(super) fn experiments(outcome: &mut Outcome) -> anyhow::Result<String> {
    let bar = Case::bar(Load::Force)?;
    let mesh = liver_of_nodes(469)?;
    let (fixed, node, edge_m) = liver_ends(&mesh)?;
    let organ = Case::new(mesh, fixed, node, Load::Force, edge_m)?;
    let mut notes = String::from(
        "Tables 5.1 and 5.2: zones (N, F, S without fixed nodes), products of 3 x 3 tensors a sweep without outer \
         force, and refreshes (sweeps, or steps of tensor-mass) a second of processor time, ours and the report's (PC \
         of 1 GHz, display included).\n\n| mesh | our zones | products: tensor-mass, A, B | report | refreshes a second: \
         tensor-mass, A, B | report |\n|---|---|---|---|---|---|\n",
    );
    let mut off_formula = 0.0_f64;
    for (row, report) in REPORT.into_iter().enumerate() {
        let (case, zones) = if row < 4 {
            (&bar, bar.zones(ZONE_CELLS[row])?)
        } else {
            (&organ, Zones::by_graph(&organ.mesh, row - 2)?)
        };
        let counted = Counted::of(case, &zones)?;
        off_formula = off_formula.max(counted.off_formula);
        notes += &counted.table_line(case, report);
    }
    outcome.experiments.push(Experiment::at_most(
        "bar and liver, 2 to 5 zones: counted products and stored tensors of methods A and B against the formulas",
        FORMULAS,
        off_formula,
        0.0,
    ));
    notes += "\nThe report's liver of 4,919 nodes is in the benchmarks `hybrid_exchange_surface` and \
              `hybrid_exchange_all_nodes` (report: 974,752 and 1,744,851 products, 1.2 and 0.6 Hz; tensor-mass \
              62,274, 7.6 Hz).\n";
    Ok(notes)
}
