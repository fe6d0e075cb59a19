//! Where edits have changed the mesh since a factor was made.
//!
//! With A the matrix of the mesh as it is, A_0 = L L^T that of the mesh for which the factor was made, R its nodes among those
//! that there are now, and D the 3x3 blocks of A at the nodes that edits have changed, conjugate gradients go on with
//!
//! P = R^T A_0^-1 R + D^-1,
//!
//! which is symmetric and positive definite: an additive Schwarz method (M. Dryja and O. B. Widlund 1990, Some domain
//! decomposition algorithms for elliptic problems, in Iterative Methods for Large Linear Systems, Academic Press, 273-291) whose
//! parts are the body as it was and the single nodes that have changed. Corrections of contacts count on P too, in the dozen
//! steps until a new factor is there.

use super::elements::Elements;
use super::lagged_state::{LaggedState, NodeTerms};
use glisson_mesh::math::{DMat3, DVec3};
use glisson_mesh::mesh::NodeId;

/// The nodes that edits have changed, ascending.
#[derive(Clone, Default)]
pub(super) struct Late {
    nodes: Vec<u32>,
    /// D^-1 of each of them [m/N].
    inverse: Vec<DMat3>,
    /// One per node up to the last of them.
    is_late: Vec<bool>,
}

impl Late {
    /// Counts a node in from the next update on.
    pub(super) fn add(&mut self, node: NodeId) {
        if self.is_late.len() <= node.index() {
            self.is_late.resize(node.index() + 1, false);
        }
        self.is_late[node.index()] = true;
    }

    pub(super) fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    fn has(&self, node: NodeId) -> bool {
        self.is_late.get(node.index()).is_some_and(|&is_late| is_late)
    }

    /// Computes the blocks at a state of the elements as they are.
    pub(super) fn update(&mut self, elements: &Elements, terms: NodeTerms<'_>, now: &LaggedState) {
        self.nodes.clear();
        self.nodes.extend((0_u32..).zip(&self.is_late).filter(|(_, is_late)| **is_late).map(|(n, _)| n));
        let mut vertex = vec![DMat3::ZERO; now.displacement_m.len()];
        let factors = now.factors();
        for t in 0..elements.tets().len() {
            if elements.tetrahedron(t).0.iter().any(|node| self.has(*node)) {
                let (nodes, stiffness) = now.stiffness(elements, t, factors);
                for (node, block) in nodes.iter().zip(stiffness.vertex) {
                    vertex[node.index()] += block;
                }
            }
        }
        terms.add_to(&mut vertex, now);
        self.inverse.clear();
        self.inverse.extend(self.nodes.iter().map(|&n| {
            let inverse = vertex[n as usize].inverse();
            // A node without tetrahedra does not move.
            if inverse.is_finite() { inverse } else { DMat3::ZERO }
        }));
    }

    /// Adds D^-1 times `right`.
    pub(super) fn add_answers(&self, right: &[DVec3], solution: &mut [DVec3]) {
        for (&n, inverse) in self.nodes.iter().zip(&self.inverse) {
            solution[n as usize] += *inverse * right[n as usize];
        }
    }

    /// All of it as numbers.
    pub(super) fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        self.nodes
            .iter()
            .zip(&self.inverse)
            .flat_map(|(&n, inverse)| std::iter::once(f64::from(n)).chain(inverse.to_cols_array()))
    }
}
