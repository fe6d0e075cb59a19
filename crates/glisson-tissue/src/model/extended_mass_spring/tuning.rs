//! Damping that brings a body to rest soonest (seed `003` s. 3.4: damping tuned so that it limits oscillation).

use crate::material::LinearElastic;
use crate::model::explicit::Inertia;
use crate::model::rheology::lumped_masses_kg;
use crate::solve::{BoundaryConditions, FreeSystem, MeshEdges, SolveError, StiffnessTensors};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::{NodeId, TetMesh};

/// Inverse iteration gains at least the ratio of the two lowest squared frequencies each time; damping needs two
/// digits.
const ITERATIONS: usize = 40;

/// Damping over inertia [1/s] for [`crate::model::Rayleigh::mass_per_s`] that is critical for the slowest mode at
/// rest, twice its circular frequency: no other damping brings that mode to rest sooner, and every other mode
/// oscillates with the same decay.
///
/// # Errors
/// [`SolveError`] for an unusable mesh, and when the supports leave the body free to move as a whole: then the
/// slowest mode has frequency zero.
pub fn tuned_damping_per_s(
    mesh: &TetMesh,
    material: &LinearElastic,
    fixed_nodes: &[NodeId],
    inertia: Inertia,
) -> Result<f64, SolveError> {
    let edges = MeshEdges::of_mesh(mesh)?;
    let tensors = StiffnessTensors::assemble(mesh, &edges, material)?;
    let system = FreeSystem::new(&edges, &tensors, &BoundaryConditions::fixed(fixed_nodes))?;
    let factor = system.factorize()?;
    let mut inertia_kg = lumped_masses_kg(mesh, material.density_kg_per_m3());
    if inertia == Inertia::Unit {
        let n_live = inertia_kg.iter().filter(|m| **m > 0.0).count().max(1);
        let mean_kg = inertia_kg.iter().sum::<f64>() / n_live as f64;
        inertia_kg.iter_mut().filter(|m| **m > 0.0).for_each(|m| *m = mean_kg);
    }
    let mut scratch = factor.scratch(1);
    let mut free = vec![0.0; system.n_free()];
    // Different in every component and place, so that no symmetry hides the slowest mode.
    let mut x: Vec<DVec3> = mesh.positions_m.iter().map(|p| DVec3::new(1.0, 0.7, 0.4) + *p).collect();
    let mut squared_frequency = 0.0;
    for _ in 0..ITERATIONS {
        let weighted: Vec<DVec3> = x.iter().zip(&inertia_kg).map(|(x, m)| *x * *m).collect();
        system.gather_into(&weighted, &mut free);
        factor.solve_in_place(&mut free, 1, &mut scratch);
        let mut y = vec![DVec3::ZERO; x.len()];
        system.add_scattered(&free, &mut y);
        let work: f64 = y.iter().zip(&weighted).map(|(y, w)| y.dot(*w)).sum();
        let size: f64 = y.iter().zip(&inertia_kg).map(|(y, m)| m * y.length_squared()).sum();
        squared_frequency = work / size;
        let scale = 1.0 / size.sqrt();
        x = y.into_iter().map(|y| y * scale).collect();
    }
    Ok(2.0 * squared_frequency.sqrt())
}
