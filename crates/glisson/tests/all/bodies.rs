//! Worlds of a block that tools work on.

use glisson::material::LinearElastic;
use glisson::math::DVec3;
use glisson::mesh::TetMesh;
use glisson::model::Rayleigh;
use glisson::model::kind::ModelKind;
use glisson::scene::{OrganBody, build_model};
use glisson::workers::{Sequential, SharedWorkers, Task, Workers};
use glisson::world::World;
use glisson::world::spec::{Region, Support, WorldSpec, fixed_nodes};
use std::sync::Arc;

/// The lowest sixth of a body.
pub(crate) const TABLE: Region = Region::Furthest { direction: DVec3::NEG_Z, fraction: 1.0 / 6.0 };

/// The world of an explicit body of soft tissue that stands on a table.
pub(crate) fn on_a_table(mesh: TetMesh, spec: WorldSpec) -> World {
    held_at(TABLE, mesh, spec, ModelKind::Explicit, 0.4, Rayleigh::of_mass(60.0))
}

/// Tasks in the opposite order, each on a thread of its own.
pub(crate) struct Backwards;

impl Workers for Backwards {
    fn run(&self, n_tasks: usize, task: &Task<'_>) {
        std::thread::scope(|scope| {
            for i in (0..n_tasks).rev() {
                scope.spawn(move || task(i));
            }
        });
    }
}

/// The world of a body of soft tissue, 5 kPa, that is held in one region.
pub(crate) fn held_at(
    region: Region,
    mesh: TetMesh,
    spec: WorldSpec,
    kind: ModelKind,
    poisson_ratio: f64,
    damping: Rayleigh,
) -> World {
    held_by(Arc::new(Sequential), region, mesh, spec, kind, poisson_ratio, damping)
}

/// The same, stepped by these workers.
pub(crate) fn held_by(
    workers: SharedWorkers,
    region: Region,
    mesh: TetMesh,
    mut spec: WorldSpec,
    kind: ModelKind,
    poisson_ratio: f64,
    damping: Rayleigh,
) -> World {
    spec.supports = vec![Support::all_axes(region)];
    let material = LinearElastic::from_young_poisson(5e3, poisson_ratio, 1000.0).unwrap();
    let mut body = OrganBody::new(mesh, material, spec.time_step_s);
    body.fixed = fixed_nodes(&spec.supports, &body.mesh.positions_m);
    body.damping = damping;
    body.workers = workers;
    let model = build_model(&body, kind).unwrap();
    World::new(spec, body.mesh, model, kind).unwrap()
}
