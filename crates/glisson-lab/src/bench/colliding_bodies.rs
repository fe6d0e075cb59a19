//! Cubes in contact: a whole step by constraints with friction, models included.

use anyhow::Context;
use glam::DVec3;
use glisson::contact::bodies::{BodyParams, CollidingBodies, ContactParams, Obstacle};
use glisson::material::LinearElastic;
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::topology::{Topology, surface_of};
use glisson::model::explicit_kernel::{ExplicitKernel, ExplicitKernelParams};
use glisson::model::kernel::KernelLaw;
use glisson::model::{DeformableModel, DynamicBody, Rayleigh};

use super::{Case, Prepared, Settings, isa_name};

pub(super) const CASES: &[Case] = &[
    Case {
        name: "cubes_constraint",
        about: "cubes of 320 tetrahedra in a heap: their steps, detection, friction by constraints",
        per: "step",
        sizes: &[1, 2, 4],
        parallel: false,
        prepare: |settings| cubes(settings, true),
    },
    Case {
        name: "cubes_constraint_alone",
        about: "the steps of the same cubes without contact: to be taken off",
        per: "step",
        sizes: &[1, 2, 4],
        parallel: false,
        prepare: |settings| cubes(settings, false),
    },
];

/// Cells along an edge: 320 tetrahedra, where the cubes of seed 000 (s. 2.3.4) have 353.
const CELLS: usize = 4;
/// Edge of a cube [m] (seed 000, s. 2.3.4).
const SIDE_M: f64 = 0.05;
const DENSITY_KG_PER_M3: f64 = 1000.0;
const YOUNG_MODULUS_PA: f64 = 20e3;
const POISSON_RATIO: f64 = 0.45;
const FRICTION: f64 = 0.4;
const GAP_M: f64 = 1.01e-4;
/// Time in which the heap comes to rest [s].
const SETTLE_S: f64 = 0.5;

/// Two cubes side by side on a support, two more across them, turned a little so that edges cross.
fn cubes(settings: Settings, in_contact: bool) -> anyhow::Result<Prepared> {
    let materials = [LinearElastic::from_young_poisson(YOUNG_MODULUS_PA, POISSON_RATIO, DENSITY_KG_PER_M3)?];
    let mut bodies = Vec::new();
    let mut step_s = f64::INFINITY;
    let n_cubes = settings.size.clamp(1, 4);
    let mut n_tets = 0;
    for k in 0..n_cubes {
        let mut mesh = box_of_five([CELLS; 3], DVec3::splat(SIDE_M));
        let (beside, above) = ((k % 2) as f64, (k / 2) as f64);
        let shift =
            DVec3::new(beside * (SIDE_M + GAP_M) + above * 4e-3, above * 6e-3, above * (SIDE_M + GAP_M));
        mesh.positions_m.iter_mut().for_each(|p| *p += shift + DVec3::Z * GAP_M);
        n_tets += mesh.tetrahedra.len();
        let body = DynamicBody {
            damping: Rayleigh { mass_per_s: 20.0, stiffness_s: 1e-4 },
            gravity_m_per_s2: DVec3::Z * -9.81,
            ..DynamicBody::new(&mesh, DENSITY_KG_PER_M3)
        };
        let params = ExplicitKernelParams::new(body, KernelLaw::NeoHookeLog, &materials);
        let longest_s = 0.9 * ExplicitKernel::stable_step(&params)?.step_s;
        step_s = step_s.min(longest_s);
        let body = DynamicBody { time_step_s: longest_s, ..params.body };
        let model = ExplicitKernel::build(&ExplicitKernelParams { body, ..params })?;
        let (surface, nodes) = surface_of(&Topology::build(&mesh)?, &mesh);
        bodies.push(BodyParams { model: Box::new(model), surface, nodes, friction: FRICTION });
    }
    let support = vec![Obstacle::half_space(DVec3::ZERO, DVec3::Z, FRICTION)];
    let mut world = CollidingBodies::new(bodies, support, &ContactParams::default())
        .context("the cubes of the benchmark")?;
    for _ in 0..(SETTLE_S / step_s) as usize {
        world.step(step_s);
    }
    let report = world.report();
    let mut alone: Vec<Box<dyn DeformableModel>> = (0..n_cubes).map(|k| world.model(k).duplicate()).collect();
    Ok(Prepared {
        size: n_cubes,
        isa: isa_name(fearless_simd::Level::new()),
        precision: "f64",
        work: None,
        note: format!(
            "cubes, {n_tets} tetrahedra; {} contacts, {} pressed, {} sweeps, penetration {:.3} mm",
            report.n_contacts,
            report.n_pressed,
            report.n_sweeps,
            report.penetration_m * 1e3
        ),
        run: Box::new(move || {
            if in_contact {
                world.step(step_s);
            } else {
                alone.iter_mut().for_each(|model| model.step(step_s));
            }
        }),
    })
}
