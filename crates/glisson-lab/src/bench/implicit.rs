//! Case of the implicit model: one step of 10 ms under a load that wanders over the body.

use std::hint::black_box;

use anyhow::ensure;
use fearless_simd::Level;
use glam::DVec3;
use glisson::material::{LinearElastic, PronySeries, PronyTerm, StableNeoHooke};
use glisson::mesh::NodeId;
use glisson::mesh::topology::Topology;
use glisson::model::implicit::{
    ImplicitEuler, ImplicitLaw, ImplicitParams, ImplicitStatus, Preconditioner, VolumeResistance,
};
use glisson::model::{Constraints, DeformableModel, DynamicBody, FixedNode, NodalForce};

use glisson_runtime::workers::shared_workers;

use super::body::StandardBody;
use super::{Case, Prepared, Settings, isa_name};

pub(super) const CASES: &[Case] = &[
    Case {
        name: "implicit_step",
        about: "one implicit Euler step of 10 ms, ln J neo-Hooke, nu 0.45, a load of 1 N wandering over the top",
        per: "step",
        sizes: &[2_000, 6_300, 20_000, 50_000, 100_000],
        parallel: true,
        prepare: nu_045,
    },
    Case {
        name: "implicit_step_factor",
        about: "the same preconditioned with a sparse factor at any size",
        per: "step",
        sizes: &[6_300, 20_000],
        parallel: true,
        prepare: by_factor,
    },
    Case {
        name: "implicit_step_two_grid",
        about: "the same preconditioned with two grids at any size",
        per: "step",
        sizes: &[2_000, 6_300, 20_000],
        parallel: true,
        prepare: by_two_grid,
    },
    Case {
        name: "implicit_step_nu_049",
        about: "the same with Poisson's ratio 0.49",
        per: "step",
        sizes: &[6_300],
        parallel: true,
        prepare: nu_049,
    },
    Case {
        name: "implicit_step_averaged",
        about: "the same with Poisson's ratio 0.49 and node-averaged pressure",
        per: "step",
        sizes: &[6_300],
        parallel: true,
        prepare: averaged,
    },
    Case {
        name: "implicit_step_stable",
        about: "as implicit_step with the stable neo-Hookean law",
        per: "step",
        sizes: &[6_300],
        parallel: true,
        prepare: stable,
    },
    Case {
        name: "implicit_step_general",
        about: "the same through the path for any law",
        per: "step",
        sizes: &[6_300],
        parallel: true,
        prepare: general,
    },
    Case {
        name: "implicit_step_viscous",
        about: "as implicit_step with one relaxing term",
        per: "step",
        sizes: &[6_300],
        parallel: true,
        prepare: viscous,
    },
];

/// Of every case here [s].
pub(super) const STEP_S: f64 = 0.01;
const LOAD_N: f64 = 1.0;
/// The load goes round once in this time, on an ellipse of half the body's half axes.
const ROUND_S: f64 = 4.0;
/// Steps of a round, and those beyond it before the timed ones.
const N_ROUND: usize = (ROUND_S / STEP_S) as usize;
const N_BEYOND: usize = 50;
/// Radius over which it is spread.
const SPOT_M: f64 = 0.03;

fn nu_045(settings: Settings) -> anyhow::Result<Prepared> {
    let law = ImplicitLaw::neo_hooke(&with_poisson_ratio(settings, 0.45)?);
    prepare(settings, &law, &Variant::default())
}

fn by_factor(settings: Settings) -> anyhow::Result<Prepared> {
    let law = ImplicitLaw::neo_hooke(&with_poisson_ratio(settings, 0.45)?);
    prepare(settings, &law, &Variant { preconditioner: Preconditioner::Factor, ..Variant::default() })
}

fn by_two_grid(settings: Settings) -> anyhow::Result<Prepared> {
    let law = ImplicitLaw::neo_hooke(&with_poisson_ratio(settings, 0.45)?);
    prepare(settings, &law, &Variant { preconditioner: Preconditioner::TwoGrid, ..Variant::default() })
}

fn nu_049(settings: Settings) -> anyhow::Result<Prepared> {
    let law = ImplicitLaw::neo_hooke(&with_poisson_ratio(settings, 0.49)?);
    prepare(settings, &law, &Variant::default())
}

fn averaged(settings: Settings) -> anyhow::Result<Prepared> {
    let law = ImplicitLaw::neo_hooke(&with_poisson_ratio(settings, 0.49)?);
    prepare(settings, &law, &Variant { volume: VolumeResistance::NodeAveraged, ..Variant::default() })
}

fn stable(settings: Settings) -> anyhow::Result<Prepared> {
    let law = ImplicitLaw::from(StableNeoHooke::from(&with_poisson_ratio(settings, 0.45)?));
    prepare(settings, &law, &Variant::default())
}

fn general(settings: Settings) -> anyhow::Result<Prepared> {
    let law = ImplicitLaw::shared(StableNeoHooke::from(&with_poisson_ratio(settings, 0.45)?));
    prepare(settings, &law, &Variant::default())
}

fn viscous(settings: Settings) -> anyhow::Result<Prepared> {
    let law = ImplicitLaw::neo_hooke(&with_poisson_ratio(settings, 0.45)?);
    // Any term costs the same: not those of a tissue.
    let relaxation = Some(PronySeries::new(&[PronyTerm { share: 0.5, time_s: 1.0 }])?);
    prepare(settings, &law, &Variant { relaxation, ..Variant::default() })
}

fn with_poisson_ratio(settings: Settings, poisson_ratio: f64) -> anyhow::Result<LinearElastic> {
    let body = StandardBody::shared(settings.size)?;
    let (young_pa, density) = (body.material.young_modulus_pa(), body.material.density_kg_per_m3());
    Ok(LinearElastic::from_young_poisson(young_pa, poisson_ratio, density)?)
}

/// The load at each step of one round.
pub(super) fn round_of_loads(body: &StandardBody) -> anyhow::Result<Vec<Constraints>> {
    let topology = Topology::build(&body.mesh)?;
    let top: Vec<NodeId> =
        topology.surface_nodes().filter(|n| body.mesh.positions_m[n.index()].z > 0.0).collect();
    let load = |step: usize| spot_load(body, &top, std::f64::consts::TAU * step as f64 / N_ROUND as f64);
    Ok((0..N_ROUND).map(load).collect())
}

/// The load at one place of its way round, spread over the nodes near it.
fn spot_load(body: &StandardBody, top: &[NodeId], angle: f64) -> Constraints {
    let centre = DVec3::new(0.075 * angle.cos(), 0.05 * angle.sin(), 0.0);
    let weights: Vec<(NodeId, f64)> = top
        .iter()
        .map(|&n| {
            let away = (body.mesh.positions_m[n.index()] - centre).truncate().length() / SPOT_M;
            (n, (1.0 - away * away).max(0.0))
        })
        .filter(|(_, w)| *w > 0.0)
        .collect();
    let sum: f64 = weights.iter().map(|(_, w)| w).sum();
    let force = |(node, w): &(NodeId, f64)| NodalForce {
        node: *node,
        force_n: DVec3::new(0.0, 0.0, -LOAD_N * w / sum),
    };
    Constraints { displacements: Vec::new(), forces: weights.iter().map(force).collect() }
}

/// Runs one round of the load and a little more, so that a timed step costs nothing but the step; says what the steps needed.
fn warm_up(model: &mut ImplicitEuler, loads: &[Constraints]) -> anyhow::Result<String> {
    let (mut worst, mut newton, mut cg, mut factors) = (0.0_f64, 0, 0, 0);
    for load in loads.iter().cycle().take(N_ROUND + N_BEYOND) {
        model.apply(load);
        model.step(STEP_S);
        let report = model.step_report();
        ensure!(report.status == ImplicitStatus::Converged, "a step ended with {report:?}");
        worst = worst.max(report.residual_share);
        newton += report.newton_iterations;
        cg += report.cg_iterations;
        factors += report.n_factors;
    }
    let deepest_m = model.displacements_m().iter().map(|u| u.length()).fold(0.0, f64::max);
    let per_step = |n: u32| f64::from(n) / (N_ROUND + N_BEYOND) as f64;
    Ok(format!(
        "{:.1} Newton, {:.1} CG iterations, {:.4} factors a step; residual at most {worst:.1e}; \
         displacement {:.1} mm",
        per_step(newton),
        per_step(cg),
        per_step(factors),
        1e3 * deepest_m
    ))
}

/// How the body differs from that of `implicit_step`.
#[derive(Default)]
struct Variant {
    volume: VolumeResistance,
    relaxation: Option<PronySeries>,
    preconditioner: Preconditioner,
}

fn prepare(settings: Settings, law: &ImplicitLaw, variant: &Variant) -> anyhow::Result<Prepared> {
    let body = StandardBody::shared(settings.size)?;
    let fixed: Vec<FixedNode> = body.fixed_nodes.iter().map(|&n| FixedNode::all_axes(n)).collect();
    let dynamic = DynamicBody {
        fixed: &fixed,
        time_step_s: STEP_S,
        ..DynamicBody::new(&body.mesh, body.material.density_kg_per_m3())
    };
    let Variant { volume, preconditioner, .. } = *variant;
    let relaxation = variant.relaxation.as_ref();
    let params = ImplicitParams { volume, relaxation, preconditioner, ..ImplicitParams::new(dynamic, law) };
    let mut model = ImplicitEuler::build(&params)?;
    model.set_workers(shared_workers(settings.threads)?);
    let loads = round_of_loads(&body)?;
    let needed = warm_up(&mut model, &loads)?;
    let mut turn = N_BEYOND;
    Ok(Prepared {
        size: body.mesh.tetrahedra.len(),
        isa: isa_name(Level::new()),
        precision: "f64",
        work: None,
        note: format!("{} nodes; {needed}", body.mesh.positions_m.len()),
        run: Box::new(move || {
            model.apply(&loads[turn]);
            model.step(STEP_S);
            turn = (turn + 1) % loads.len();
            black_box(model.state().positions_m);
        }),
    })
}
