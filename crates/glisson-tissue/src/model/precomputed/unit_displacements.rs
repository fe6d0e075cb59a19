//! The other form of the pre-computation (seed `001` s. 4): unit displacements with force tensors.
//!
//! A unit displacement is imposed along each axis on one loadable node k, the other loadable nodes free: T^u_nk are
//! the displacements of the nodes n, T^f_k [N/m] the forces that it takes at k. Several nodes influence one another:
//! with M the tensors T^u of the touched nodes among themselves (identities on its diagonal), the displacements to
//! superpose are M^-1 u* (eq. 8), displacements and forces follow (eq. 9 and 10).
//!
//! From the compliance, T^u_nk = T_nk T_kk^-1 and T^f_k = T_kk^-1; back, T_kk = (T^f_k)^-1 and T_nk = T^u_nk T_kk.
//! So the two forms hold the same; the compliance is kept in files, because its system is symmetric and M is not.

use super::Precomputed;
use crate::material::LinearElastic;
use crate::model::ImposedDisplacement;
use crate::solve::{BoundaryConditions, SolveError, StaticProblem, solve_dense_in_place, solve_static};
use glisson_mesh::math::{DMat3, DVec3};
use glisson_mesh::mesh::{NodeId, TetMesh};

/// The response to unit displacements of one node.
#[derive(Clone, Debug, PartialEq)]
pub struct UnitDisplacement {
    /// The node k that is displaced.
    pub node: NodeId,
    /// T^f_k [N/m]: a column is the force on it for a unit displacement along an axis.
    pub force_n_per_m: DMat3,
    /// T^u_nk of each stored node n; the identity at k.
    pub displacement: Vec<DMat3>,
}

/// The responses to unit displacements of several nodes, ascending.
#[derive(Clone, Debug, PartialEq)]
pub struct UnitDisplacements {
    stored: Vec<NodeId>,
    by_node: Vec<UnitDisplacement>,
}

impl Precomputed {
    /// The response to unit displacements of a loadable node, by its compliance; `None` for other nodes.
    pub fn unit_displacement(&self, node: NodeId) -> Option<UnitDisplacement> {
        let loaded = self.loadable_index(node)? as usize;
        let table = &self.compliance.table;
        let force_n_per_m = table.tensor(loaded, loaded).inverse();
        let displacement =
            (0..self.compliance.rows.len()).map(|row| table.tensor(row, loaded) * force_n_per_m).collect();
        Some(UnitDisplacement { node, force_n_per_m, displacement })
    }
}

impl UnitDisplacement {
    /// Compliances T_nk [m/N] of the stored nodes for a force on this one.
    pub fn compliance_m_per_n(&self) -> impl Iterator<Item = DMat3> + '_ {
        let own = self.force_n_per_m.inverse();
        self.displacement.iter().map(move |t| *t * own)
    }
}

impl UnitDisplacements {
    /// Of some loadable nodes of a model, by its compliance; others are left out.
    pub fn of(model: &Precomputed, nodes: &[NodeId]) -> Self {
        let mut by_node: Vec<UnitDisplacement> =
            nodes.iter().filter_map(|&node| model.unit_displacement(node)).collect();
        by_node.sort_by_key(|unit| unit.node);
        by_node.dedup_by_key(|unit| unit.node);
        Self { stored: model.stored_nodes().to_vec(), by_node }
    }

    /// Directly: for each of `nodes` a static problem in which it is displaced, its own factor included.
    ///
    /// # Errors
    /// [`SolveError`] for a mesh or support without solution.
    pub fn compute(
        mesh: &TetMesh,
        material: &LinearElastic,
        fixed_nodes: &[NodeId],
        nodes: &[NodeId],
        stored: &[NodeId],
    ) -> Result<Self, SolveError> {
        let nodal_force_n = &vec![DVec3::ZERO; mesh.positions_m.len()][..];
        // A body that only the displaced node would hold is refused.
        let unloaded = BoundaryConditions::fixed(fixed_nodes);
        solve_static(&StaticProblem { mesh, material, conditions: &unloaded, nodal_force_n })?;
        let mut by_node = Vec::with_capacity(nodes.len());
        for &node in nodes {
            let mut unit = UnitDisplacement {
                node,
                force_n_per_m: DMat3::ZERO,
                displacement: vec![DMat3::ZERO; stored.len()],
            };
            for axis in 0..3 {
                let mut conditions = unloaded.clone();
                conditions.impose_node(node, DVec3::AXES[axis]);
                let conditions = &conditions;
                let solution = solve_static(&StaticProblem { mesh, material, conditions, nodal_force_n })?;
                *unit.force_n_per_m.col_mut(axis) = solution.reaction_n[node.index()];
                for (tensor, n) in unit.displacement.iter_mut().zip(stored) {
                    *tensor.col_mut(axis) = solution.displacement_m[n.index()];
                }
            }
            by_node.push(unit);
        }
        by_node.sort_by_key(|unit| unit.node);
        by_node.dedup_by_key(|unit| unit.node);
        Ok(Self { stored: stored.to_vec(), by_node })
    }

    /// The nodes that can be displaced, each with its response.
    pub fn nodes(&self) -> &[UnitDisplacement] {
        &self.by_node
    }

    /// Nodes whose displacements are stored.
    pub fn stored_nodes(&self) -> &[NodeId] {
        &self.stored
    }

    /// Displacements [m] of the stored nodes and forces [N] on the displaced ones, in their order, when several nodes
    /// are displaced at once (eq. 8 to 10). `None` for a node without response, a repeated one, or one not stored.
    pub fn respond(&self, imposed: &[ImposedDisplacement]) -> Option<(Vec<DVec3>, Vec<DVec3>)> {
        let units: Vec<&UnitDisplacement> = imposed
            .iter()
            .map(|i| {
                let place = self.by_node.binary_search_by_key(&i.node, |unit| unit.node).ok()?;
                Some(&self.by_node[place])
            })
            .collect::<Option<_>>()?;
        let rows: Vec<usize> =
            imposed.iter().map(|i| self.stored.iter().position(|n| *n == i.node)).collect::<Option<_>>()?;
        let n = 3 * units.len();
        let mut influence = vec![0.0; n * n];
        for (j, unit) in units.iter().enumerate() {
            for axis in 0..3 {
                for (i, &row) in rows.iter().enumerate() {
                    let column = unit.displacement[row].col(axis).to_array();
                    let first = n * (3 * j + axis) + 3 * i;
                    influence[first..first + 3].copy_from_slice(&column);
                }
            }
        }
        let mut superposed: Vec<f64> = imposed.iter().flat_map(|i| i.displacement_m.to_array()).collect();
        solve_dense_in_place(n, &mut influence, &mut superposed, 1e-13).ok()?;
        let mut displacement_m = vec![DVec3::ZERO; self.stored.len()];
        let mut force_n = Vec::with_capacity(units.len());
        for (unit, u) in units.iter().zip(superposed.chunks_exact(3).map(DVec3::from_slice)) {
            for (sum, tensor) in displacement_m.iter_mut().zip(&unit.displacement) {
                *sum += *tensor * u;
            }
            force_n.push(unit.force_n_per_m * u);
        }
        Some((displacement_m, force_n))
    }
}
