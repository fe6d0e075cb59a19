//! What each node of the cut mesh bears of the copies that carry it.
//!
//! Contact takes the nodes of a lumped model one by one. Nodes that a copy carries have no mass of their own, and answer to each
//! other's forces: C = W M^-1 W^T. With any masses m_i of the cut mesh's nodes for which sum_i w_iv m_i <= M_v at every node v of the
//! copies, f C f <= sum_i f_i^2/m_i for all forces f (Cauchy and Schwarz at each v): these masses answer no less than the nodes do, so
//! that impulses found with them stop less, and never more, than there is to stop. Here m_i is in proportion to the volume around
//! the node, as much as that allows.

use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::embedding::{Embedding, Tie};
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};

/// Weights that cancel leave this much of themselves.
const NOTHING: f64 = 1e-9;

/// Places on the body are told by nodes of two triangles at most, each carried by four others.
const MOST_CARRIERS: usize = 24;

/// Volumes around nodes.
#[derive(Clone, Debug, Default)]
pub(super) struct Bearing {
    /// Of each node of the cut mesh [m3]; zero of a dead one.
    of_nodes_m3: Vec<f64>,
    /// What each node of the copies carries of them [m3].
    carried_m3: Vec<f64>,
}

impl Bearing {
    /// Of a cut mesh after an edit.
    pub(super) fn of_mesh(&mut self, mesh: &TetMesh, change: &TopologyChange, embedding: &Embedding) {
        if self.of_nodes_m3.is_empty() {
            // The first edit: all of the mesh before it.
            self.of_nodes_m3.resize(change.nodes.n_before, 0.0);
            for tet in (0..change.tets.n_before).map(TetId::from_index) {
                self.add(mesh.tetrahedra[tet.index()], 0.25 * mesh.tet_volume_m3(tet));
            }
        }
        self.of_nodes_m3.resize(change.nodes.n_after, 0.0);
        for &tet in change.tets.removed.iter().filter(|tet| tet.index() < change.tets.n_before) {
            self.add(mesh.tetrahedra[tet.index()], -0.25 * mesh.tet_volume_m3(tet));
        }
        let is_gone = |tet: &TetId| change.tets.removed.binary_search(tet).is_ok();
        for &tet in change.tets.added.ids().iter().filter(|tet| !is_gone(tet)) {
            self.add(mesh.tetrahedra[tet.index()], 0.25 * mesh.tet_volume_m3(tet));
        }
        for &node in &change.nodes.removed {
            self.of_nodes_m3[node.index()] = 0.0;
        }
        self.sum_carried(embedding);
    }

    fn add(&mut self, nodes: [NodeId; 4], corner_m3: f64) {
        nodes.iter().for_each(|node| self.of_nodes_m3[node.index()] += corner_m3);
    }

    /// Volume around each node of the cut mesh [m3].
    pub(super) fn of_nodes_m3(&self) -> &[f64] {
        &self.of_nodes_m3
    }

    /// Back to [`Bearing::of_nodes_m3`] of before.
    pub(super) fn put_back(&mut self, of_nodes_m3: &[f64], embedding: &Embedding) {
        self.of_nodes_m3.clear();
        self.of_nodes_m3.extend_from_slice(of_nodes_m3);
        self.sum_carried(embedding);
    }

    fn sum_carried(&mut self, embedding: &Embedding) {
        self.carried_m3.clear();
        self.carried_m3.resize(embedding.copies().positions_m.len(), 0.0);
        for (tie, volume_m3) in embedding.ties().iter().zip(&self.of_nodes_m3) {
            for (node, weight) in tie.iter() {
                self.carried_m3[node.index()] += weight * volume_m3;
            }
        }
    }

    /// How a node of the cut mesh answers; `answer`: how one of the copies does.
    pub(super) fn answer(&self, node: NodeId, tie: &Tie, answer: impl Fn(NodeId) -> DVec3) -> DVec3 {
        let own_m3 = self.of_nodes_m3.get(node.index()).copied().unwrap_or(0.0);
        if own_m3 <= 0.0 {
            return DVec3::ZERO;
        }
        let of_carrier = |of: NodeId| answer(of) * (self.carried_m3[of.index()] / own_m3);
        match tie.single() {
            Some(of) if self.carried_m3[of.index()] == own_m3 => answer(of),
            _ => tie.iter().map(|(of, _)| of_carrier(of)).fold(DVec3::ZERO, DVec3::max),
        }
    }
}

/// Whether places given as nodes of the cut mesh with weights are carried by different nodes, or in another way.
pub(super) fn can_part(sides: &mut dyn Iterator<Item = (NodeId, f64)>, ties: &[Tie]) -> bool {
    let mut sums = [(NodeId(0), 0.0); MOST_CARRIERS];
    let mut n = 0;
    for (node, weight) in sides {
        let Some(tie) = ties.get(node.index()) else { return true };
        for (of, share) in tie.iter() {
            let at = sums[..n].iter().position(|(known, _)| *known == of).unwrap_or(n);
            if at == MOST_CARRIERS {
                return true;
            }
            if at == n {
                sums[at] = (of, 0.0);
                n += 1;
            }
            sums[at].1 += weight * share;
        }
    }
    sums[..n].iter().any(|(_, sum)| sum.abs() > NOTHING)
}
