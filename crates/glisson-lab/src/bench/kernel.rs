//! Cases of the fast kernel: forces of St Venant-Kirchhoff and of linear elasticity, and the explicit step.

use std::hint::black_box;

use glam::DVec3;
use glisson::model::kernel::{
    ExplicitStep, FastKernel, KernelExtras, KernelLaw, KernelParams, KernelPath, Quarantine,
};
use glisson::model::tensor_mass::TensorMass;

use super::body::StandardBody;
use super::{Case, Prepared, Settings, Work};
use glisson_runtime::workers::shared_workers;

/// Operations for a tetrahedron: differences of displacements 9, gradient 45, stress, forces 45, their sum 6,
/// adding up 12; a fused multiply-add counts as two.
const STVK_FLOPS: usize = 117 + 108;
const LINEAR_FLOPS: usize = 117 + 18;
/// Sums over parts and central differences, for a node.
const STEP_FLOPS: usize = 3 * 5;
/// Share of the largest stable step of the undeformed body.
const STEP_SHARE: f64 = 0.5;

pub(super) const CASES: &[Case] = &[
    Case {
        name: "stvk_force",
        about: "St Venant-Kirchhoff forces of all nodes by the fast kernel, in its own order of nodes",
        per: "step",
        sizes: &[6_300, 100_000],
        parallel: true,
        prepare: |settings| force(settings, KernelLaw::StVenantKirchhoff, KernelPath::fastest()),
    },
    Case {
        name: "stvk_force_avx2",
        about: "the same on the AVX2 path",
        per: "step",
        sizes: &[6_300, 100_000],
        parallel: true,
        prepare: |settings| force(settings, KernelLaw::StVenantKirchhoff, path("avx2")),
    },
    Case {
        name: "stvk_force_scalar",
        about: "the same formula, layout and compiler flags, one tetrahedron at a time",
        per: "step",
        sizes: &[6_300, 100_000],
        parallel: true,
        prepare: |settings| force(settings, KernelLaw::StVenantKirchhoff, path("scalar")),
    },
    Case {
        name: "stvk_force_portable",
        about: "the same compiled for every processor of the kind: the result of last resort, with the same bits",
        per: "step",
        sizes: &[6_300],
        parallel: true,
        prepare: |settings| force(settings, KernelLaw::StVenantKirchhoff, path("portable")),
    },
    Case {
        name: "tensor_mass_linear_force",
        about: "linear elastic forces of all nodes by the fast kernel, in its own order of nodes",
        per: "step",
        sizes: &[2_000, 6_300, 20_000, 100_000],
        parallel: true,
        prepare: |settings| force(settings, KernelLaw::Linear, KernelPath::fastest()),
    },
    Case {
        name: "explicit_step",
        about: "St Venant-Kirchhoff forces and central differences by the fast kernel",
        per: "step",
        sizes: &[6_300, 100_000],
        parallel: true,
        prepare: |settings| {
            explicit_step(settings, StepKind { quarantine: Quarantine::Inverted, has_rest_stress: false })
        },
    },
    Case {
        name: "explicit_step_unguarded",
        about: "the same without the watch over inverted tetrahedra",
        per: "step",
        sizes: &[6_300],
        parallel: true,
        prepare: |settings| {
            explicit_step(settings, StepKind { quarantine: Quarantine::Off, has_rest_stress: false })
        },
    },
    Case {
        name: "explicit_step_rest_stress",
        about: "explicit_step of a body with stress in its rest shape",
        per: "step",
        sizes: &[6_300],
        parallel: true,
        prepare: |settings| {
            explicit_step(settings, StepKind { quarantine: Quarantine::Inverted, has_rest_stress: true })
        },
    },
    Case {
        name: "neo_hooke_log_force",
        about: "forces of the neo-Hookean law with ln J by the fast kernel",
        per: "step",
        sizes: &[6_300],
        parallel: true,
        prepare: |settings| force(settings, KernelLaw::NeoHookeLog, KernelPath::fastest()),
    },
    Case {
        name: "stable_neo_hooke_force",
        about: "forces of the stable neo-Hookean law by the fast kernel",
        per: "step",
        sizes: &[6_300],
        parallel: true,
        prepare: |settings| force(settings, KernelLaw::StableNeoHooke, KernelPath::fastest()),
    },
];

/// The path of this name, or what runs everywhere.
fn path(name: &str) -> KernelPath {
    KernelPath::named(name).or(KernelPath::named("portable")).expect("the portable path is always there")
}

/// Displacements [m] that bend the standard body.
pub(super) fn bent_m(body: &StandardBody) -> Vec<DVec3> {
    let bent = |p: &DVec3| DVec3::new(0.0, 0.2 * (p.x / 0.15) * (p.z / 0.06 + 1.0) * 0.01, 0.02 * p.x);
    body.mesh.positions_m.iter().map(bent).collect()
}

fn kernel_of(
    body: &StandardBody,
    law: KernelLaw,
    path: KernelPath,
    extras: &KernelExtras<'_>,
) -> anyhow::Result<FastKernel> {
    let params = KernelParams { mesh: &body.mesh, law, materials: &[body.material], path };
    let mut kernel = FastKernel::with_extras(&params, extras)?;
    kernel.set_displacements(&bent_m(body));
    for &node in &body.fixed_nodes {
        kernel.set_displacement(node, DVec3::ZERO);
        kernel.hold(node, true);
    }
    Ok(kernel)
}

/// Counted for two laws.
fn work(kernel: &FastKernel, law: KernelLaw) -> Option<Work> {
    let flops = match law {
        KernelLaw::Linear => LINEAR_FLOPS,
        KernelLaw::StVenantKirchhoff => STVK_FLOPS,
        _ => return None,
    };
    let bytes = kernel.working_set_bytes() as f64;
    Some(Work { flops: (flops * kernel.n_tets()) as f64, bytes, working_set_bytes: bytes })
}

fn force(settings: Settings, law: KernelLaw, path: KernelPath) -> anyhow::Result<Prepared> {
    let body = StandardBody::shared(settings.size)?;
    let mut kernel = kernel_of(&body, law, path, &KernelExtras::default())?;
    let workers = shared_workers(settings.threads)?;
    Ok(Prepared {
        size: kernel.n_tets(),
        isa: path.name(),
        precision: "f64",
        work: work(&kernel, law),
        note: format!("{} nodes in {} parts", kernel.n_nodes(), kernel.n_parts()),
        run: Box::new(move || {
            kernel.compute_forces(&*workers);
            black_box(&kernel);
        }),
    })
}

/// Which steps: with the watch over inverted tetrahedra, and with stress at rest.
#[derive(Clone, Copy)]
struct StepKind {
    quarantine: Quarantine,
    has_rest_stress: bool,
}

fn explicit_step(settings: Settings, kind: StepKind) -> anyhow::Result<Prepared> {
    let body = StandardBody::shared(settings.size)?;
    let (law, path) = (KernelLaw::StVenantKirchhoff, KernelPath::fastest());
    let rest_stress_pa =
        if kind.has_rest_stress { vec![[1.0; 6]; body.mesh.tetrahedra.len()] } else { Vec::new() };
    let extras = KernelExtras { rest_stress_pa: &rest_stress_pa, ..KernelExtras::default() };
    let mut kernel = kernel_of(&body, law, path, &extras)?;
    kernel.set_quarantine(kind.quarantine);
    let workers = shared_workers(settings.threads)?;
    let stable = TensorMass::stable_step(&body.mesh, &body.material)?;
    let step_s = STEP_SHARE * stable.step_s;
    // Without damping it moves for ever: no number becomes subnormal, which would be slow.
    let step = ExplicitStep { step_s, damping_per_s: 0.0 };
    let mut work = work(&kernel, law);
    if let Some(work) = &mut work {
        work.flops += (STEP_FLOPS * kernel.n_nodes()) as f64;
    }
    Ok(Prepared {
        size: kernel.n_tets(),
        isa: path.name(),
        precision: "f64",
        work,
        note: format!("{} nodes, step {:.2} ms", kernel.n_nodes(), 1e3 * step_s),
        run: Box::new(move || {
            kernel.step(&*workers, step);
            black_box(&kernel);
        }),
    })
}
