//! Whether an edit that opens faces may have cut a piece in two, judged on the spot.
//!
//! Around the edit stands a patch: all tetrahedra at the nodes of those that went and came. Whatever hung
//! together through the tetrahedra that went still does if the patch does. If not, the rest of the body may
//! hold it together, which only a count tells.

use super::plan::Plan;
use super::{EditableMesh, TopologyChange};
use crate::mesh::{NodeId, TetId};

/// Sets that grow together.
struct Unions {
    parent: Vec<u32>,
    count: usize,
}

impl Unions {
    fn new(n: usize) -> Self {
        Self { parent: (0..).take(n).collect(), count: n }
    }

    fn root(&mut self, mut at: usize) -> usize {
        while self.parent[at] as usize != at {
            self.parent[at] = self.parent[self.parent[at] as usize];
            at = self.parent[at] as usize;
        }
        at
    }

    fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        if a != b {
            self.parent[a.max(b)] = a.min(b) as u32;
            self.count -= 1;
        }
    }
}

fn unique<T: Ord>(mut items: Vec<T>) -> Vec<T> {
    items.sort_unstable();
    items.dedup();
    items
}

impl EditableMesh {
    /// Marks in `change` which notion of a piece may have more of them than before `plan`, which was carried out.
    /// `opened`: whether faces may have been.
    pub(super) fn judge_pieces(&self, plan: &Plan, opened: bool, change: &mut TopologyChange) {
        let topology = &self.topology;
        let old = plan.doomed.iter().map(|&tet| topology.tet_nodes(tet));
        let nodes = unique(old.chain(plan.fresh.iter().copied()).flatten().collect::<Vec<NodeId>>());
        let stars = nodes.iter().flat_map(|&n| topology.node_tets(n).iter().copied());
        let patch = unique(stars.collect::<Vec<TetId>>());
        let mut pieces = Unions::new(patch.len());
        for (at, &tet) in patch.iter().enumerate() {
            for next in topology.tet_neighbours(tet).into_iter().filter_map(|n| n.get()) {
                if let Ok(next) = patch[..at].binary_search(&next) {
                    pieces.join(at, next);
                }
            }
        }
        change.pieces.through_faces.may_have_split |= opened && pieces.count > 1;
        if pieces.count == 1 {
            return;
        }
        for (at, &tet) in patch.iter().enumerate() {
            for node in topology.tet_nodes(tet) {
                let first = topology.node_tets(node)[0];
                if let Ok(first) = patch[..at].binary_search(&first) {
                    pieces.join(at, first);
                }
            }
        }
        change.pieces.through_nodes.may_have_split |= pieces.count > 1;
    }
}
