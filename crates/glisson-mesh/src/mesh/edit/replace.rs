//! Exchange of tetrahedra for others in the same place.

use super::parents::ParentsByVolume;
use super::plan::{Move, Plan};
use super::{CavityNode, EditError, EditableMesh, NewNode, NodeWeights};
use crate::math::{DVec3, is_inverted};
use crate::mesh::{NodeId, TetId};

/// How much the volume may differ, as a share of it: rounding, not a gap.
const VOLUME_TOLERANCE: f64 = 1e-9;

/// How much the sum of weights may differ from 1.
const WEIGHT_TOLERANCE: f64 = 1e-9;

/// A parent's weight is no larger: beyond it a place is no mean any more, and sums lose their digits. A choice; places just
/// outside of a flat tetrahedron have weights of a few units.
const MOST_WEIGHT: f64 = 1e3;

/// Tetrahedra that make room for others in the same place. Unlike in a retetrahedralisation the parents are
/// given, nodes may move, triangles of the surface may be divided, and triangles within may open (their nodes come
/// twice). The live tetrahedra at a node that moves are reshaped where they do not make room: these together fill the
/// place that they filled before.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Replacement {
    /// The tetrahedra that make room; live, each once.
    pub tets: Vec<TetId>,
    /// Nodes that come in.
    pub new_nodes: Vec<NewNode>,
    /// Nodes that move at rest; each once.
    pub moved_nodes: Vec<MovedNode>,
    /// The tetrahedra that take the place.
    pub new_tets: Vec<NewTet>,
}

/// A node that moves within the tissue.
#[derive(Clone, Debug, PartialEq)]
pub struct MovedNode {
    /// The node.
    pub node: NodeId,
    /// Where to at rest [m].
    pub position_m: DVec3,
    /// Nodes with weights of sum 1 whose places before the edit give its new one, at rest as in the deformed tissue.
    pub parents: NodeWeights,
}

/// A tetrahedron that comes in.
#[derive(Clone, Debug, PartialEq)]
pub struct NewTet {
    /// Its corners; the volume at rest is positive.
    pub corners: [CavityNode; 4],
    /// Tetrahedra of [`Replacement::tets`], or reshaped ones, whose data it takes, with weights of sum 1; if empty, those in
    /// whose place it is, with their shares of its volume.
    pub parents: Vec<(TetId, f64)>,
}

/// A tetrahedron that comes in, and the shares of those that make room for it.
type CornersAndParents<'a> = ([CavityNode; 4], &'a [(TetId, f64)]);

/// What [`MeshEdit::Retetrahedralise`](super::MeshEdit) and [`MeshEdit::Replace`](super::MeshEdit) have in common.
pub(super) struct Exchange<'a> {
    /// The tetrahedra that make room.
    pub(super) tets: &'a [TetId],
    /// Nodes that come in.
    pub(super) new_nodes: &'a [NewNode],
    /// Nodes that move.
    pub(super) moved_nodes: &'a [MovedNode],
    /// Corners and parents of what comes in; without parents they are worked out.
    pub(super) new_tets: Vec<CornersAndParents<'a>>,
    /// Whether all outer triangles stay; else those of the surface may be divided and inner ones may open.
    pub(super) keeps_outer_triangles: bool,
}

impl<'a> From<&'a Replacement> for Exchange<'a> {
    fn from(Replacement { tets, new_nodes, moved_nodes, new_tets }: &'a Replacement) -> Self {
        let new_tets = new_tets.iter().map(|tet| (tet.corners, tet.parents.as_slice())).collect();
        Self { tets, new_nodes, moved_nodes, new_tets, keeps_outer_triangles: false }
    }
}

impl EditableMesh {
    pub(super) fn plan_exchange(
        &mut self,
        Exchange { tets, new_nodes, moved_nodes, new_tets, keeps_outer_triangles }: &Exchange<'_>,
        plan: &mut Plan,
    ) -> Result<(), EditError> {
        self.topology.check_removable(tets)?;
        plan.doomed.extend_from_slice(tets);
        plan.doomed.sort_unstable();
        let corners_of = self.named_corners(new_nodes, new_tets)?;
        self.plan_new_nodes(new_nodes, &corners_of, plan)?;
        let reshaped = self.plan_moves(moved_nodes, &corners_of, plan)?;
        if *keeps_outer_triangles {
            self.check_outer_sides(plan, &corners_of)?;
        } else {
            self.check_borders(plan, &corners_of)?;
        }
        self.check_filled(plan, &corners_of, &reshaped)?;
        let body: &Self = self;
        let mut room = reshaped;
        room.extend_from_slice(&plan.doomed);
        room.sort_unstable();
        let is_any_unknown = new_tets.iter().any(|(_, parents)| parents.is_empty());
        let mut by_volume = is_any_unknown.then(|| ParentsByVolume::new(body, &room));
        for (place, (nodes, (_, parents))) in corners_of.into_iter().zip(new_tets).enumerate() {
            if let (true, Some(by_volume)) = (parents.is_empty(), &mut by_volume) {
                let corners_m = nodes.map(|n| plan.position_m(&body.mesh, n));
                plan.add_tet(nodes, by_volume.of(corners_m));
                continue;
            }
            let sum: f64 = parents.iter().map(|p| p.1).sum();
            let are_parents_there = parents.iter().all(|p| room.binary_search(&p.0).is_ok());
            let is_sum_right = (sum - 1.0).abs() <= WEIGHT_TOLERANCE;
            if !(are_parents_there && is_sum_right) {
                return Err(EditError::BadParents { place, sum });
            }
            plan.add_tet(nodes, parents);
        }
        Ok(())
    }

    /// Whether a node is there and has a tetrahedron.
    fn is_there(&self, node: NodeId) -> bool {
        node.index() < self.topology.n_nodes() && self.topology.is_live_node(node)
    }

    /// The sum of the weights of some nodes, and whether these can be parents.
    fn check_parents(&self, parents: &[(NodeId, f64)]) -> (f64, bool) {
        let sum: f64 = parents.iter().map(|p| p.1).sum();
        let is_sum_right = (sum - 1.0).abs() <= WEIGHT_TOLERANCE;
        let is_parent = |(node, weight): &(NodeId, f64)| self.is_there(*node) && weight.abs() <= MOST_WEIGHT;
        (sum, is_sum_right && parents.iter().all(is_parent))
    }

    /// The new tetrahedra with the ids that their corners will have.
    fn named_corners(
        &self,
        new_nodes: &[NewNode],
        new_tets: &[CornersAndParents<'_>],
    ) -> Result<Vec<[NodeId; 4]>, EditError> {
        let mut corners_of = Vec::with_capacity(new_tets.len());
        for (place, (corners, _)) in new_tets.iter().enumerate() {
            let bad = EditError::BadCorners { place, n_new: new_nodes.len() };
            let mut nodes = [NodeId(0); 4];
            for at in 0..4 {
                nodes[at] = match corners[at] {
                    CavityNode::Old(node) if self.is_there(node) => node,
                    CavityNode::New(new) if (new as usize) < new_nodes.len() => {
                        NodeId::from_index(self.topology.n_nodes() + new as usize)
                    }
                    _ => return Err(bad),
                };
                if nodes[..at].contains(&nodes[at]) {
                    return Err(bad);
                }
            }
            corners_of.push(nodes);
        }
        Ok(corners_of)
    }

    fn plan_new_nodes(
        &self,
        new_nodes: &[NewNode],
        corners_of: &[[NodeId; 4]],
        plan: &mut Plan,
    ) -> Result<(), EditError> {
        let mut is_used = vec![false; new_nodes.len()];
        for node in corners_of.iter().flatten() {
            if let Some(new) = node.index().checked_sub(self.topology.n_nodes()) {
                is_used[new] = true;
            }
        }
        for (place, node) in new_nodes.iter().enumerate() {
            let (sum, are_parents) = self.check_parents(&node.parents);
            if !(node.position_m.is_finite() && is_used[place] && are_parents) {
                return Err(EditError::BadNewNode { place, sum });
            }
            plan.add_node(node.position_m, &node.parents);
        }
        Ok(())
    }

    /// Plans moves, and tells which tetrahedra they reshape, ascending.
    fn plan_moves(
        &self,
        moved_nodes: &[MovedNode],
        corners_of: &[[NodeId; 4]],
        plan: &mut Plan,
    ) -> Result<Vec<TetId>, EditError> {
        let mut reshaped = Vec::new();
        for MovedNode { node, position_m, parents } in moved_nodes {
            let (sum, are_parents) = self.check_parents(parents);
            let bad = EditError::BadMove { node: *node, sum };
            if !(self.is_there(*node) && position_m.is_finite() && are_parents) {
                return Err(bad);
            }
            let n_before = reshaped.len();
            let stays = |tet: &&TetId| plan.doomed.binary_search(tet).is_err();
            reshaped.extend(self.topology.node_tets(*node).iter().filter(stays));
            if reshaped.len() == n_before && !corners_of.iter().flatten().any(|corner| corner == node) {
                return Err(bad);
            }
            let (position_m, parents) = (*position_m, parents.clone());
            plan.moved.push(Move { node: *node, position_m, parents, is_blend: true });
        }
        plan.moved.sort_unstable_by_key(|moved| moved.node);
        if let Some(pair) = plan.moved.windows(2).find(|pair| pair[0].node == pair[1].node) {
            return Err(EditError::BadMove { node: pair[0].node, sum: 1.0 });
        }
        reshaped.sort_unstable();
        reshaped.dedup();
        Ok(reshaped)
    }

    /// Refuses tetrahedra that would be flat or inside out, and new and reshaped ones that fill another volume than they and
    /// the old ones did.
    fn check_filled(&self, plan: &Plan, new: &[[NodeId; 4]], reshaped: &[TetId]) -> Result<(), EditError> {
        let mut new_m3 = 0.0;
        let reshaped_corners = reshaped.iter().map(|&tet| self.topology.tet_nodes(tet));
        for nodes in new.iter().copied().chain(reshaped_corners) {
            let volume_m3 = plan.volume_m3(&self.mesh, nodes);
            if is_inverted(volume_m3) {
                return Err(EditError::FlatTet { nodes, volume_m3 });
            }
            new_m3 += volume_m3;
        }
        let old = plan.doomed.iter().chain(reshaped);
        let old_m3: f64 = old.map(|&tet| self.mesh.tet_volume_m3(tet)).sum();
        let is_filled = (new_m3 - old_m3).abs() <= VOLUME_TOLERANCE * old_m3;
        if is_filled { Ok(()) } else { Err(EditError::VolumeDiffers { old_m3, new_m3 }) }
    }
}
