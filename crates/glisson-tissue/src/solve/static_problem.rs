//! Static equilibrium K u = f with prescribed displacements (seed `003`, eq. 2.2 and 2.3).
//!
//! The prescribed components are taken out of the system (K_ff u_f = f_f - K_fc u_c), so that the matrix stays
//! symmetric positive definite; the reactions follow from the rows taken out: r_c = (K u - f)_c. One step of
//! iterative refinement with the tensors themselves removes most of the factorization's rounding.

use super::{BoundaryConditions, FreeSystem, MeshEdges, SolveError, StiffnessTensors};
use crate::material::LinearElastic;
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};
use glisson_mesh::progress::tell;

/// A linear static case.
#[derive(Clone, Copy, Debug)]
pub struct StaticProblem<'a> {
    /// The body at rest.
    pub mesh: &'a TetMesh,
    /// Its material.
    pub material: &'a LinearElastic,
    /// What is held where.
    pub conditions: &'a BoundaryConditions,
    /// Force on each node [N]; length of the mesh's nodes.
    pub nodal_force_n: &'a [DVec3],
}

/// Its equilibrium.
#[derive(Clone, Debug, PartialEq)]
pub struct StaticSolution {
    /// Displacement of each node [m].
    pub displacement_m: Vec<DVec3>,
    /// Force [N] that the support exerts at each prescribed component; zero elsewhere.
    pub reaction_n: Vec<DVec3>,
}

/// Adds the weight rho V/4 g of every tetrahedron to its nodes: exact for linear tetrahedra.
pub fn add_gravity_forces(
    mesh: &TetMesh,
    material: &LinearElastic,
    gravity_m_per_s2: DVec3,
    force_n: &mut [DVec3],
) {
    for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
        let mass_kg = material.density_kg_per_m3() * mesh.tet_volume_m3(TetId::from_index(t));
        for node in nodes {
            force_n[node.index()] += gravity_m_per_s2 * (mass_kg / 4.0);
        }
    }
}

/// Displacements and reactions of a linear static case.
///
/// # Errors
/// [`SolveError`]: an unusable mesh, conditions on missing nodes, a piece that floats, a singular matrix.
///
/// # Panics
/// When there is not one force per node.
pub fn solve_static(problem: &StaticProblem<'_>) -> Result<StaticSolution, SolveError> {
    let edges = MeshEdges::of_mesh(problem.mesh)?;
    let tensors = StiffnessTensors::assemble(problem.mesh, &edges, problem.material)?;
    solve_assembled(problem, &edges, &tensors)
}

/// [`solve_static`] with given stiffness tensors, on edges that connect the same pieces.
pub(super) fn solve_assembled(
    problem: &StaticProblem<'_>,
    edges: &MeshEdges,
    tensors: &StiffnessTensors,
) -> Result<StaticSolution, SolveError> {
    let StaticProblem { mesh, conditions, nodal_force_n, .. } = *problem;
    assert_eq!(nodal_force_n.len(), mesh.positions_m.len(), "one force a node");
    conditions.check(mesh, edges)?;
    if let Some(n) = nodal_force_n.iter().position(|f| !f.is_finite()) {
        return Err(SolveError::NonFiniteCondition { node: NodeId::from_index(n) });
    }
    let system = FreeSystem::new(edges, tensors, conditions)?;
    tell(0.2);
    let factor = system.factorize()?;
    tell(0.9);

    let mut displacement_m = vec![DVec3::ZERO; mesh.positions_m.len()];
    for (node, axis, value) in conditions.iter() {
        displacement_m[node.index()][axis] = value;
    }
    let mut balance_n = vec![DVec3::ZERO; mesh.positions_m.len()];
    let mut free = vec![0.0; system.n_free()];
    let mut scratch = factor.scratch(1);
    // The first round solves, the second refines.
    for _ in 0..2 {
        tensors.force_into(edges, &displacement_m, &mut balance_n);
        for (b, f) in balance_n.iter_mut().zip(nodal_force_n) {
            *b = *f - *b;
        }
        system.gather_into(&balance_n, &mut free);
        factor.solve_in_place(&mut free, 1, &mut scratch);
        system.add_scattered(&free, &mut displacement_m);
    }
    tensors.force_into(edges, &displacement_m, &mut balance_n);
    let mut reaction_n = vec![DVec3::ZERO; mesh.positions_m.len()];
    for (node, axis, _) in conditions.iter() {
        reaction_n[node.index()][axis] = balance_n[node.index()][axis] - nodal_force_n[node.index()][axis];
    }
    Ok(StaticSolution { displacement_m, reaction_n })
}
