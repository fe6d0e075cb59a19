//! The stress with which a body carries its weight in the shape in which it was imaged.
//!
//! An image shows the organ under load. Let S0 be the stress of the linear static solution under the rest gravity, the
//! supports and the ligaments. Without the displacements of that solution, S0 balances the weight in the imaged shape:
//!
//! sum over tetrahedra of V S0 alpha_j = m_j g + ligaments, at every component that is not held.
//!
//! A body of several tissues gets the S0 of a body of one, which balances its weight as well.
//! Adding S0 to the second Piola-Kirchhoff stress of any law adds just these forces at F = Id, so that the shape is at rest
//! under every law. S0 is one of many such stresses, because a body can be in self-equilibrated tension; an image does not
//! tell which one it is.

use super::{
    Attachment, BoundaryConditions, FixedNode, FreeSystem, LOCAL_EDGES, MeshEdges, P1Gradients, RestStress,
    SolveError, StiffnessTensors, add_gravity_forces, stress_tensor_pa,
};
use crate::material::LinearElastic;
use glisson_mesh::math::{DMat3, DVec3, outer};
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};

/// The first round solves; the others correct the stress by its unbalanced nodal forces, which removes the rounding of the
/// factorization.
const ROUNDS: usize = 4;

/// Stress of each tetrahedron [Pa] that balances the weight of the rest shape, with a density of `material`, and the
/// pull that `attachments` have in it.
///
/// # Errors
/// [`SolveError`]: an unusable mesh, supports or ligaments at nodes that do not exist, a gravity that is not finite,
/// a piece that the supports leave floating. Ligaments do not count as supports: what they pull with in the rest
/// shape is given.
pub fn equilibrating_stress(
    mesh: &TetMesh,
    material: &LinearElastic,
    fixed: &[FixedNode],
    attachments: &[Attachment],
    gravity_m_per_s2: DVec3,
) -> Result<Vec<RestStress>, SolveError> {
    let n_nodes = mesh.positions_m.len();
    let mut load_n = vec![DVec3::ZERO; n_nodes];
    add_gravity_forces(mesh, material, gravity_m_per_s2, &mut load_n);
    for attachment in attachments {
        let node = attachment.node;
        let position_m =
            mesh.positions_m.get(node.index()).ok_or(SolveError::ConditionOutOfRange { node, n_nodes })?;
        load_n[node.index()] += attachment.force_n(*position_m);
    }
    stress_under_loads(mesh, material, fixed, &load_n)
}

/// Stress of each tetrahedron [Pa] that balances these loads [N], one for each node, in the rest shape.
///
/// # Errors
/// [`SolveError`]: an unusable mesh, supports at nodes that do not exist, a load that is not finite, a piece that the supports
/// leave floating.
pub fn stress_under_loads(
    mesh: &TetMesh,
    material: &LinearElastic,
    fixed: &[FixedNode],
    load_n: &[DVec3],
) -> Result<Vec<RestStress>, SolveError> {
    let edges = MeshEdges::of_mesh(mesh)?;
    let tensors = StiffnessTensors::assemble(mesh, &edges, material)?;
    let conditions = conditions_of(fixed);
    conditions.check(mesh, &edges)?;
    let n_nodes = mesh.positions_m.len();
    if let Some(n) = load_n.iter().position(|f| !f.is_finite()) {
        return Err(SolveError::NonFiniteCondition { node: NodeId::from_index(n) });
    }

    let system = FreeSystem::new(&edges, &tensors, &conditions)?;
    let factor = system.factorize()?;
    let mut scratch = factor.scratch(1);
    let mut free = vec![0.0; system.n_free()];
    let mut stress_pa = vec![[0.0; 6]; mesh.tetrahedra.len()];
    let mut stress_forces_n = vec![DVec3::ZERO; n_nodes];
    for _ in 0..ROUNDS {
        stress_forces_into(mesh, &stress_pa, &mut stress_forces_n);
        let unbalanced_n: Vec<DVec3> =
            load_n.iter().zip(&stress_forces_n).map(|(load, carried)| *load - *carried).collect();
        system.gather_into(&unbalanced_n, &mut free);
        factor.solve_in_place(&mut free, 1, &mut scratch);
        let mut displacement_m = vec![DVec3::ZERO; n_nodes];
        system.add_scattered(&free, &mut displacement_m);
        add_stress(mesh, material, &displacement_m, &mut stress_pa);
    }
    Ok(stress_pa)
}

fn conditions_of(fixed: &[FixedNode]) -> BoundaryConditions {
    let mut conditions = BoundaryConditions::new();
    for support in fixed {
        for axis in (0..3).filter(|&axis| support.axes[axis]) {
            conditions.impose(support.node, axis, 0.0);
        }
    }
    conditions
}

/// Whether the rest shape with this stress is stable under a law that is rotation invariant: whether K plus the stiffness of
/// the stress, V (alpha_j . S0 alpha_k) Id, is positive definite. Tissue that is too soft for its weight buckles under
/// compressive stress. Ligaments are not counted: they can only stabilize. `materials`: one, or one for each tetrahedron.
///
/// # Errors
/// [`SolveError`]: an unusable mesh, supports at nodes that do not exist, floating pieces, too little memory.
pub fn is_stable_under(
    mesh: &TetMesh,
    materials: &[LinearElastic],
    fixed: &[FixedNode],
    stress_pa: &[RestStress],
) -> Result<bool, SolveError> {
    let edges = MeshEdges::of_mesh(mesh)?;
    let tensors = StiffnessTensors::assemble_with(mesh, &edges, |tet, gradients| {
        let material = &materials[if materials.len() == 1 { 0 } else { tet.index() }];
        let mut stiffness = gradients.stiffness(material.lambda_pa(), material.mu_pa());
        stiffness.add_multiples(gradients.stress_stiffness_n_per_m(stress_pa[tet.index()]));
        stiffness
    })?;
    let conditions = conditions_of(fixed);
    conditions.check(mesh, &edges)?;
    match FreeSystem::new(&edges, &tensors, &conditions)?.factorize() {
        Ok(_) => Ok(true),
        Err(SolveError::Singular) => Ok(false),
        Err(error) => Err(error),
    }
}

/// Overwrites `force_n` with V S0 alpha_j summed on the nodes: the forces [N] that balance stresses in the rest shape.
///
/// # Panics
/// When there is not one stress per tetrahedron.
pub fn stress_forces_into(mesh: &TetMesh, stress_pa: &[RestStress], force_n: &mut [DVec3]) {
    assert_eq!(stress_pa.len(), mesh.tetrahedra.len(), "one stress a tetrahedron");
    force_n.fill(DVec3::ZERO);
    for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
        let gradients = P1Gradients::in_mesh(mesh, TetId::from_index(t));
        for (node, f) in nodes.iter().zip(gradients.stress_forces_n(stress_pa[t])) {
            force_n[node.index()] += f;
        }
    }
}

impl P1Gradients {
    /// V S0 alpha_j of each corner: the forces [N] that balance a stress in the rest shape.
    pub fn stress_forces_n(&self, stress_pa: RestStress) -> [DVec3; 4] {
        let stress = stress_tensor_pa(stress_pa);
        self.alpha_per_m.map(|alpha| stress * alpha * self.volume_m3)
    }

    /// V alpha_j . S0 alpha_k [N/m] of the corners and of [`LOCAL_EDGES`]: with F S0 for the first Piola-Kirchhoff
    /// stress, the forces of a stress at rest change by these numbers times the displacements.
    pub fn stress_stiffness_n_per_m(&self, stress_pa: RestStress) -> ([f64; 4], [f64; 6]) {
        let alpha = self.alpha_per_m;
        let force = self.stress_forces_n(stress_pa);
        (std::array::from_fn(|j| alpha[j].dot(force[j])), LOCAL_EDGES.map(|[j, k]| alpha[j].dot(force[k])))
    }
}

/// Adds Hooke's stress lambda tr(e) Id + 2 mu e of a displacement.
fn add_stress(
    mesh: &TetMesh,
    material: &LinearElastic,
    displacement_m: &[DVec3],
    stress_pa: &mut [RestStress],
) {
    let (lambda_pa, mu_pa) = (material.lambda_pa(), material.mu_pa());
    for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
        let gradients = P1Gradients::in_mesh(mesh, TetId::from_index(t));
        let of_corner = |j: usize| outer(displacement_m[nodes[j].index()], gradients.alpha_per_m[j]);
        let g = (0..4).map(of_corner).fold(DMat3::ZERO, |sum, m| sum + m);
        let pressure_pa = lambda_pa * (g.col(0).x + g.col(1).y + g.col(2).z);
        let two_mu_pa = 2.0 * mu_pa;
        let shear_pa = |r: usize, c: usize| mu_pa * (g.col(c)[r] + g.col(r)[c]);
        let added = [
            pressure_pa + two_mu_pa * g.col(0).x,
            pressure_pa + two_mu_pa * g.col(1).y,
            pressure_pa + two_mu_pa * g.col(2).z,
            shear_pa(0, 1),
            shear_pa(0, 2),
            shear_pa(1, 2),
        ];
        stress_pa[t].iter_mut().zip(added).for_each(|(s, added)| *s += added);
    }
}
