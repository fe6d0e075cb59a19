//! Exchange of tetrahedra for others in the same place.

use super::parents::ParentsByVolume;
use super::plan::Plan;
use super::{CavityNode, EditError, EditableMesh, NewNode};
use crate::math::is_inverted;
use crate::mesh::{NodeId, TetId};

/// How much the volume may differ, as a share of it: rounding, not a gap.
const VOLUME_TOLERANCE: f64 = 1e-9;

/// How much the sum of weights may differ from 1.
const WEIGHT_TOLERANCE: f64 = 1e-9;

/// Tetrahedra that make room for others in the same place. Unlike in a retetrahedralisation the parents are
/// given, triangles of the surface may be divided, and triangles within may open (their nodes come twice).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Replacement {
    /// The tetrahedra that make room; live, each once.
    pub tets: Vec<TetId>,
    /// Nodes that come in.
    pub new_nodes: Vec<NewNode>,
    /// The tetrahedra that take the place.
    pub new_tets: Vec<NewTet>,
}

/// A tetrahedron that comes in.
#[derive(Clone, Debug, PartialEq)]
pub struct NewTet {
    /// Its corners; the volume at rest is positive.
    pub corners: [CavityNode; 4],
    /// Tetrahedra of [`Replacement::tets`] in whose place it is, with their shares of its volume (sum 1);
    /// worked out from the shapes if empty.
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
    /// Corners and parents of what comes in; without parents they are worked out.
    pub(super) new_tets: Vec<CornersAndParents<'a>>,
    /// Whether all outer triangles stay; else those of the surface may be divided and inner ones may open.
    pub(super) keeps_outer_triangles: bool,
}

impl<'a> From<&'a Replacement> for Exchange<'a> {
    fn from(Replacement { tets, new_nodes, new_tets }: &'a Replacement) -> Self {
        let new_tets = new_tets.iter().map(|tet| (tet.corners, tet.parents.as_slice())).collect();
        Self { tets, new_nodes, new_tets, keeps_outer_triangles: false }
    }
}

impl EditableMesh {
    pub(super) fn plan_exchange(
        &mut self,
        Exchange { tets, new_nodes, new_tets, keeps_outer_triangles }: &Exchange<'_>,
        plan: &mut Plan,
    ) -> Result<(), EditError> {
        self.topology.check_removable(tets)?;
        plan.doomed.extend_from_slice(tets);
        plan.doomed.sort_unstable();
        let corners_of = self.named_corners(new_nodes, new_tets)?;
        self.plan_new_nodes(new_nodes, &corners_of, plan)?;
        if *keeps_outer_triangles {
            self.check_outer_sides(plan, &corners_of)?;
        } else {
            self.check_borders(plan, &corners_of)?;
        }
        self.check_filled(plan, &corners_of)?;
        let is_any_unknown = new_tets.iter().any(|(_, parents)| parents.is_empty());
        let mut by_volume = is_any_unknown.then(|| ParentsByVolume::new(self, &plan.doomed));
        for (place, (nodes, (_, parents))) in corners_of.into_iter().zip(new_tets).enumerate() {
            if let (true, Some(by_volume)) = (parents.is_empty(), &mut by_volume) {
                let corners_m = nodes.map(|n| plan.position_m(&self.mesh, n));
                plan.add_tet(nodes, by_volume.of(corners_m));
                continue;
            }
            let sum: f64 = parents.iter().map(|p| p.1).sum();
            let are_parents_there = parents.iter().all(|p| plan.doomed.binary_search(&p.0).is_ok());
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
            let sum: f64 = node.parents.iter().map(|p| p.1).sum();
            let is_sum_right = (sum - 1.0).abs() <= WEIGHT_TOLERANCE;
            let are_parents_there = node.parents.iter().all(|p| self.is_there(p.0));
            if !(node.position_m.is_finite() && is_used[place] && is_sum_right && are_parents_there) {
                return Err(EditError::BadNewNode { place, sum });
            }
            plan.add_node(node.position_m, &node.parents);
        }
        Ok(())
    }

    /// Refuses new tetrahedra that are flat or inside out, or that fill another volume than the old ones.
    fn check_filled(&self, plan: &Plan, new: &[[NodeId; 4]]) -> Result<(), EditError> {
        let mut new_m3 = 0.0;
        for &nodes in new {
            let volume_m3 = plan.volume_m3(&self.mesh, nodes);
            if is_inverted(volume_m3) {
                return Err(EditError::FlatTet { nodes, volume_m3 });
            }
            new_m3 += volume_m3;
        }
        let old_m3: f64 = plan.doomed.iter().map(|&tet| self.mesh.tet_volume_m3(tet)).sum();
        let is_filled = (new_m3 - old_m3).abs() <= VOLUME_TOLERANCE * old_m3;
        if is_filled { Ok(()) } else { Err(EditError::VolumeDiffers { old_m3, new_m3 }) }
    }
}
