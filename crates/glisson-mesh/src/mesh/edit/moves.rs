//! Moving a node of the rest shape.

use super::plan::{Move, Plan};
use super::{EditError, EditableMesh, NodeWeights};
use crate::math::{DVec3, is_inverted, tetrahedron_volume_m3};
use crate::mesh::{NodeId, TetId};

impl EditableMesh {
    /// Refuses a node that is not there or has no tetrahedron.
    pub(super) fn check_node(&self, node: NodeId) -> Result<(), EditError> {
        let n_nodes = self.topology.n_nodes();
        if node.index() >= n_nodes || !self.topology.is_live_node(node) {
            return Err(EditError::NoSuchNode { node, n_nodes });
        }
        Ok(())
    }

    pub(super) fn plan_move(
        &self,
        node: NodeId,
        position_m: DVec3,
        plan: &mut Plan,
    ) -> Result<(), EditError> {
        self.check_node(node)?;
        if !position_m.is_finite() {
            return Err(EditError::NotFinite { node, position_m });
        }
        for &tet in self.topology.node_tets(node) {
            let mut corners_m = self.mesh.corners_m(tet);
            corners_m[self.topology.local_node(tet, node)] = position_m;
            let volume_m3 = tetrahedron_volume_m3(corners_m);
            if is_inverted(volume_m3) {
                return Err(EditError::WouldInvert { node, tet, volume_m3 });
            }
        }
        let mut parents = NodeWeights::new();
        self.locate(position_m, self.topology.node_tets(node), &mut parents);
        plan.moved.push(Move { node, position_m, parents, is_blend: false });
        Ok(())
    }

    /// Weights over the corners of that of `tets` which holds the point, or comes nearest to it, that give the
    /// point from the places of the corners.
    pub(super) fn locate(&self, point_m: DVec3, tets: &[TetId], weights: &mut NodeWeights) {
        let mut best = f64::NEG_INFINITY;
        for &tet in tets {
            let corners_m = self.mesh.corners_m(tet);
            let whole_m3 = tetrahedron_volume_m3(corners_m);
            let mut shares = [0.0; 4];
            for (at, share) in shares.iter_mut().enumerate() {
                let mut part_m = corners_m;
                part_m[at] = point_m;
                *share = tetrahedron_volume_m3(part_m) / whole_m3;
            }
            let smallest = shares.into_iter().fold(f64::INFINITY, f64::min);
            if smallest > best {
                best = smallest;
                weights.clear();
                weights.extend(self.topology.tet_nodes(tet).into_iter().zip(shares));
            }
        }
    }
}
