//! The world's contract with real models: a step allocates nothing, and the same inputs make the same bits at any
//! number of threads.

use crate::model_meshes::{block, held};
use glisson::material::LinearElastic;
use glisson::math::DVec3;
use glisson::mesh::TetMesh;
use glisson::model::kind::ModelKind;
use glisson::model::nonlinear_tensor_mass::{
    NonlinearElasticity, NonlinearTensorMass, NonlinearTensorMassParams,
};
use glisson::model::precomputed::{Precomputed, PrecomputedParams, StoredNodes};
use glisson::model::tensor_mass::{TensorMass, TensorMassParams};
use glisson::model::{DeformableModel, DynamicBody, Rayleigh};
use glisson::record::hash::StateHash;
use glisson::tool::{Tool, ToolInput};
use glisson::world::spec::{FixedRegion, WorldSpec, nodes_in};
use glisson::world::{StepInput, World};

const TIME_STEP_S: f64 = 5e-4;
const SIZE_M: f64 = 0.1;

fn model(mesh: &TetMesh, fixed: &[FixedRegion], kind: ModelKind) -> Box<dyn DeformableModel> {
    let material = LinearElastic::from_young_poisson(5e3, 0.45, 1000.0).unwrap();
    let fixed_nodes = &nodes_in(fixed, &mesh.positions_m);
    let material = &material;
    match kind {
        ModelKind::Precomputed => {
            let stored = StoredNodes::Surface;
            let params = PrecomputedParams { mesh, material, fixed_nodes, stored, progress: None };
            Box::new(Precomputed::build(&params).unwrap())
        }
        ModelKind::TensorMass => {
            let params = TensorMassParams {
                body: DynamicBody {
                    fixed: &held(fixed_nodes),
                    damping: Rayleigh::of_mass(30.0),
                    time_step_s: TIME_STEP_S,
                    ..DynamicBody::new(mesh, material.density_kg_per_m3())
                },
                material,
            };
            Box::new(TensorMass::build(&params).unwrap())
        }
        ModelKind::StVenantKirchhoff => {
            let elasticity =
                NonlinearElasticity { material, fibres: &[], volume_penalty_pa: 0.0, largest_stretch: 1.3 };
            let params = NonlinearTensorMassParams {
                body: DynamicBody {
                    fixed: &held(fixed_nodes),
                    damping: Rayleigh::of_mass(30.0),
                    time_step_s: TIME_STEP_S,
                    ..DynamicBody::new(mesh, material.density_kg_per_m3())
                },
                elasticity,
            };
            Box::new(NonlinearTensorMass::build(&params).unwrap())
        }
    }
}

/// A block on a table, a ball above it.
fn world(kind: ModelKind) -> World {
    let mesh = block([5, 5, 5], DVec3::splat(SIZE_M));
    let fixed = vec![FixedRegion::Furthest { direction: -DVec3::Z, fraction: 1.0 / 6.0 }];
    let home = ToolInput { tip_in_world_m: DVec3::splat(2.0 * SIZE_M), shaft_in_world: DVec3::Z };
    let tool =
        Tool { name: "ball".into(), tip_radius_m: 8e-3, shaft_radius_m: 1e-3, shaft_length_m: 0.2, home };
    let model = model(&mesh, &fixed, kind);
    let spec = WorldSpec { name: "block".into(), time_step_s: TIME_STEP_S, fixed, tool };
    World::new(spec, mesh, model, kind).unwrap()
}

/// The ball bounces on the block, each time elsewhere.
fn input(step: u64) -> StepInput {
    let t = step as f64 * 5e-3;
    let x_m = SIZE_M * (0.5 + 0.3 * libm::sin(0.37 * t));
    let z_m = SIZE_M + 8e-3 + 8e-3 * libm::cos(t);
    let tool = ToolInput { tip_in_world_m: DVec3::new(x_m, 0.45 * SIZE_M, z_m), shaft_in_world: DVec3::Z };
    StepInput { tool, n_substeps: 1 + u32::from(step.is_multiple_of(7)), placed: step.is_multiple_of(400) }
}

fn run(kind: ModelKind, steps: u64) -> (StateHash, u64) {
    let mut world = world(kind);
    let touching = (0..steps).filter(|&step| world.step(&input(step)).in_contact).count() as u64;
    (world.state_hash(), touching)
}

#[test]
fn a_step_allocates_nothing() {
    for kind in ModelKind::ALL {
        let mut world = world(kind);
        let mut snapshot = world.snapshot();
        world.step(&input(0));
        let mut contacts = 0;
        let count = allocation_counter::measure(|| {
            for step in 1..1000 {
                contacts += u32::from(world.step(&input(step)).in_contact);
                world.snapshot_into(&mut snapshot);
            }
        });
        assert!(contacts > 100, "{kind}: {contacts} steps in contact");
        assert_eq!(count.count_total, 0, "{kind}");
    }
}

#[test]
fn the_same_inputs_make_the_same_bits_at_any_number_of_threads() {
    for kind in ModelKind::ALL {
        let expected = run(kind, 2000);
        assert!(expected.1 > 200 && expected.1 < 1900, "{kind}: {} steps in contact", expected.1);
        for threads in [1, 2, 4] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            assert_eq!(pool.install(|| run(kind, 2000)), expected, "{kind} with {threads} threads");
        }
    }
}
