//! Forces and displacements of the cut mesh's nodes, as those of the copies' nodes.

use crate::model::{Constraints, ImposedDisplacement, NodalForce};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::NodeId;
use glisson_mesh::mesh::embedding::Tie;

/// Rounds in which imposed displacements of nodes that copies carry together are met.
const ROUNDS: usize = 16;

/// Brings what a tie tells to `value` by the least change of its nodes' values.
pub(super) fn pull(tie: &Tie, value: DVec3, of_nodes: &mut [DVec3]) {
    let (mut missing, mut squares) = (value, 0.0);
    for (node, weight) in tie.iter() {
        missing -= of_nodes[node.index()] * weight;
        squares += weight * weight;
    }
    for (node, weight) in tie.iter() {
        of_nodes[node.index()] += missing * (weight / squares);
    }
}

/// What acts on the cut mesh.
#[derive(Clone, Debug, Default)]
pub(super) struct Carried {
    of_copies: Constraints,
    /// The displaced nodes' ties, in the order of the constraints of the cut mesh.
    held: Vec<Tie>,
    /// Force of the constraint on each of them [N].
    held_n: Vec<DVec3>,
    forces: Vec<NodalForce>,
    /// Of each node of the copies; zero between calls.
    sum_n: Vec<DVec3>,
    is_listed: Vec<bool>,
    /// The forces of the last [`Carried::take_over`], ascending by node of the cut mesh.
    applied: Vec<NodalForce>,
}

impl Carried {
    pub(super) fn make_room(&mut self, n_copied: usize, n_nodes: usize) {
        let more = |n: usize, len: usize| n.saturating_sub(len);
        self.held.reserve(more(n_nodes, self.held.len()));
        self.held_n.reserve(more(n_nodes, self.held_n.len()));
        self.applied.reserve(more(n_nodes, self.applied.len()));
        self.sum_n.resize(n_copied, DVec3::ZERO);
        self.is_listed.resize(n_copied, false);
        self.forces.reserve(more(n_copied, self.forces.len()));
        self.of_copies.forces.reserve(more(n_copied, self.of_copies.forces.len()));
        self.of_copies.displacements.reserve(more(n_copied, self.of_copies.displacements.len()));
    }

    /// Forgets what held the nodes.
    pub(super) fn release(&mut self) {
        self.held.clear();
        self.held_n.clear();
        self.applied.clear();
    }

    /// Forces on nodes of the cut mesh as forces on those of the copies, ascending by node.
    pub(super) fn gather(&mut self, forces: &[NodalForce], ties: &[Tie]) -> &[NodalForce] {
        let Self { sum_n, is_listed, forces: list, .. } = self;
        gather_into(forces, ties, sum_n, is_listed, list);
        list
    }

    /// Constraints on the copies for constraints on the cut mesh. `here_m`: the copies' displacements now.
    pub(super) fn take_over(
        &mut self,
        constraints: &Constraints,
        ties: &[Tie],
        here_m: impl Fn(NodeId) -> DVec3,
    ) -> &Constraints {
        let Self { of_copies, held, held_n, sum_n, is_listed, applied, .. } = self;
        applied.clear();
        applied.extend_from_slice(&constraints.forces);
        gather_into(&constraints.forces, ties, sum_n, is_listed, &mut of_copies.forces);
        held.clear();
        of_copies.displacements.clear();
        for imposed in &constraints.displacements {
            // The number of a node that there is not is one that the copies do not have either.
            let tie = ties.get(imposed.node.index()).copied().unwrap_or(Tie::to(NodeId(u32::MAX)));
            held.push(tie);
            for (node, _) in tie.iter() {
                let is_known =
                    is_listed.get_mut(node.index()).is_none_or(|known| std::mem::replace(known, true));
                if !is_known {
                    sum_n[node.index()] = here_m(node);
                }
            }
        }
        for _ in 0..ROUNDS {
            for (tie, imposed) in held.iter().zip(&constraints.displacements) {
                if tie.iter().all(|(node, _)| node.index() < sum_n.len()) {
                    pull(tie, imposed.displacement_m, sum_n);
                }
            }
        }
        for (n, is_listed) in is_listed.iter_mut().enumerate() {
            if std::mem::take(is_listed) {
                let displacement_m = std::mem::take(&mut sum_n[n]);
                of_copies
                    .displacements
                    .push(ImposedDisplacement { node: NodeId::from_index(n), displacement_m });
            }
        }
        held_n.clear();
        held_n.resize(held.len(), DVec3::ZERO);
        of_copies
    }

    /// Shares the forces on the copies' held nodes out among the cut mesh's.
    pub(super) fn read_forces(&mut self, of_copies_n: &[DVec3]) {
        self.held_n.fill(DVec3::ZERO);
        for (imposed, force_n) in self.of_copies.displacements.iter().zip(of_copies_n) {
            let weight_of =
                |tie: &Tie| tie.iter().filter(|(node, _)| *node == imposed.node).map(|(_, w)| w).sum::<f64>();
            let all: f64 = self.held.iter().map(weight_of).sum();
            for (tie, held_n) in self.held.iter().zip(&mut self.held_n) {
                *held_n += *force_n * (weight_of(tie) / all);
            }
        }
    }

    /// Force of the constraint on each displaced node of the cut mesh [N].
    pub(super) fn forces_n(&self) -> &[DVec3] {
        &self.held_n
    }

    /// The force that acts on a node of the cut mesh [N].
    pub(super) fn applied_n(&self, node: NodeId) -> DVec3 {
        let found = self.applied.binary_search_by_key(&node, |force| force.node);
        found.map_or(DVec3::ZERO, |at| self.applied[at].force_n)
    }
}

fn gather_into(
    forces: &[NodalForce],
    ties: &[Tie],
    sum_n: &mut [DVec3],
    is_listed: &mut [bool],
    list: &mut Vec<NodalForce>,
) {
    for force in forces {
        let Some(tie) = ties.get(force.node.index()) else { continue };
        for (node, weight) in tie.iter() {
            sum_n[node.index()] += force.force_n * weight;
            is_listed[node.index()] = true;
        }
    }
    list.clear();
    for (n, is_listed) in is_listed.iter_mut().enumerate() {
        if std::mem::take(is_listed) {
            list.push(NodalForce { node: NodeId::from_index(n), force_n: std::mem::take(&mut sum_n[n]) });
        }
    }
}
