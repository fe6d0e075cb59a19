//! Cases of the fast kernel: forces of St Venant-Kirchhoff and of linear elasticity, and the explicit step.

use std::hint::black_box;

use anyhow::Context;
use glam::DVec3;
use glisson::model::kernel::{
    ExplicitStep, FastKernel, KernelLaw, KernelParams, KernelPath, Sequential, Workers,
};
use glisson::model::tensor_mass::TensorMass;

use super::body::StandardBody;
use super::{Case, Prepared, Settings, Work};
use crate::workers::WorkerTeam;

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
        prepare: explicit_step,
    },
];

/// The path of this name, or what runs everywhere.
fn path(name: &str) -> KernelPath {
    KernelPath::named(name).or(KernelPath::named("portable")).expect("the portable path is always there")
}

fn workers(settings: Settings) -> anyhow::Result<Box<dyn Workers + Send>> {
    Ok(match settings.threads {
        1 => Box::new(Sequential),
        n => Box::new(WorkerTeam::new(n).context("starting the worker threads")?),
    })
}

fn kernel_of(body: &StandardBody, law: KernelLaw, path: KernelPath) -> anyhow::Result<FastKernel> {
    let params = KernelParams { mesh: &body.mesh, law, materials: &[body.material], path };
    let mut kernel = FastKernel::new(&params)?;
    let bent_m: Vec<DVec3> = body
        .mesh
        .positions_m
        .iter()
        .map(|&p| DVec3::new(0.0, 0.2 * (p.x / 0.15) * (p.z / 0.06 + 1.0) * 0.01, 0.02 * p.x))
        .collect();
    kernel.set_displacements(&bent_m);
    for &node in &body.fixed_nodes {
        kernel.set_displacement(node, DVec3::ZERO);
        kernel.hold(node, true);
    }
    Ok(kernel)
}

fn work(kernel: &FastKernel, law: KernelLaw) -> Work {
    let flops = match law {
        KernelLaw::Linear => LINEAR_FLOPS,
        KernelLaw::StVenantKirchhoff => STVK_FLOPS,
    };
    let bytes = kernel.working_set_bytes() as f64;
    Work { flops: (flops * kernel.n_tets()) as f64, bytes, working_set_bytes: bytes }
}

fn force(settings: Settings, law: KernelLaw, path: KernelPath) -> anyhow::Result<Prepared> {
    let body = StandardBody::shared(settings.size)?;
    let mut kernel = kernel_of(&body, law, path)?;
    let workers = workers(settings)?;
    Ok(Prepared {
        size: kernel.n_tets(),
        isa: path.name(),
        precision: "f64",
        work: Some(work(&kernel, law)),
        note: format!("{} nodes in {} parts", kernel.n_nodes(), kernel.n_parts()),
        run: Box::new(move || {
            kernel.compute_forces(&*workers);
            black_box(&kernel);
        }),
    })
}

fn explicit_step(settings: Settings) -> anyhow::Result<Prepared> {
    let body = StandardBody::shared(settings.size)?;
    let (law, path) = (KernelLaw::StVenantKirchhoff, KernelPath::fastest());
    let mut kernel = kernel_of(&body, law, path)?;
    let workers = workers(settings)?;
    let stable = TensorMass::stable_step(&body.mesh, &body.material)?;
    let step_s = STEP_SHARE * stable.step_s;
    // Without damping it moves for ever: no number becomes subnormal, which would be slow.
    let step = ExplicitStep { step_s, damping_per_s: 0.0 };
    let mut work = work(&kernel, law);
    work.flops += (STEP_FLOPS * kernel.n_nodes()) as f64;
    Ok(Prepared {
        size: kernel.n_tets(),
        isa: path.name(),
        precision: "f64",
        work: Some(work),
        note: format!("{} nodes, step {:.2} ms", kernel.n_nodes(), 1e3 * step_s),
        run: Box::new(move || {
            kernel.step(&*workers, step);
            black_box(&kernel);
        }),
    })
}
