//! Other tetrahedra in the place of some, within the same outer triangles.

use super::overlap::shared_volume_m3;
use super::plan::Plan;
use super::{CavityNode, EditError, EditableMesh, NewNode};
use crate::mesh::topology::TET_TRIANGLES;
use crate::mesh::{NodeId, TetId};

/// How much the volume may differ, as a share of it: rounding, not a gap.
pub(super) const VOLUME_TOLERANCE: f64 = 1e-9;

/// How much the sum of a new node's weights may differ from 1.
pub(super) const WEIGHT_TOLERANCE: f64 = 1e-9;

/// A triangle by ascending nodes, and whether its outward order is an odd permutation of them.
pub(super) type Side = ([NodeId; 3], bool);

pub(super) fn side(corners: [NodeId; 4], face: usize) -> Side {
    let (nodes, odd) = crate::mesh::topology::build::sorted_face(corners, face);
    (nodes.map(NodeId), odd)
}

/// The triangles of `tets` that belong to one of them alone, ascending; an error with one that belongs to more
/// than two, or to two on the same side of it.
pub(super) fn outer_sides(tets: impl Iterator<Item = [NodeId; 4]>) -> Result<Vec<Side>, Side> {
    let mut sides: Vec<Side> =
        tets.flat_map(|corners| (0..TET_TRIANGLES.len()).map(move |face| side(corners, face))).collect();
    sides.sort_unstable();
    let mut outer = Vec::new();
    for same in sides.chunk_by(|a, b| a.0 == b.0) {
        match same {
            [alone] => outer.push(*alone),
            [(_, false), (_, true)] => {}
            _ => return Err(same[0]),
        }
    }
    Ok(outer)
}

pub(super) fn differs((nodes, odd): Side) -> EditError {
    let [a, b, c] = nodes;
    EditError::OuterTriangleDiffers { nodes: if odd { [a, c, b] } else { nodes } }
}

impl EditableMesh {
    pub(super) fn plan_retetrahedralise(
        &mut self,
        tets: &[TetId],
        new_nodes: &[NewNode],
        new_tets: &[[CavityNode; 4]],
        plan: &mut Plan,
    ) -> Result<(), EditError> {
        self.topology.check_removable(tets)?;
        plan.doomed.extend_from_slice(tets);
        plan.doomed.sort_unstable();
        for (place, node) in new_nodes.iter().enumerate() {
            let sum: f64 = node.parents.iter().map(|p| p.1).sum();
            let there = |n: NodeId| n.index() < self.topology.n_nodes() && self.topology.is_live_node(n);
            let is_used = new_tets.iter().flatten().any(|c| *c == CavityNode::New(place as u32));
            let is_sum_right = (sum - 1.0).abs() <= WEIGHT_TOLERANCE;
            if !(node.position_m.is_finite()
                && is_used
                && is_sum_right
                && node.parents.iter().all(|p| there(p.0)))
            {
                return Err(EditError::BadNewNode { place, sum });
            }
            plan.add_node(node.position_m, &node.parents);
        }

        let mut old_nodes: Vec<NodeId> =
            plan.doomed.iter().flat_map(|&tet| self.topology.tet_nodes(tet)).collect();
        old_nodes.sort_unstable();
        old_nodes.dedup();
        let n_nodes = self.topology.n_nodes();
        let mut corners_of = Vec::with_capacity(new_tets.len());
        for (place, corners) in new_tets.iter().enumerate() {
            let bad = EditError::BadCorners { place, n_new: new_nodes.len() };
            let mut nodes = [NodeId(0); 4];
            for at in 0..4 {
                nodes[at] = match corners[at] {
                    CavityNode::Old(node) if old_nodes.binary_search(&node).is_ok() => node,
                    CavityNode::New(new) if (new as usize) < new_nodes.len() => {
                        NodeId::from_index(n_nodes + new as usize)
                    }
                    _ => return Err(bad),
                };
                if nodes[..at].contains(&nodes[at]) {
                    return Err(bad);
                }
            }
            corners_of.push(nodes);
        }
        self.check_outer_sides(plan, &corners_of)?;

        let corners_m = |nodes: [NodeId; 4]| nodes.map(|n| plan.position_m(&self.mesh, n));
        let mut parents_of: Vec<Vec<(TetId, f64)>> = Vec::with_capacity(corners_of.len());
        let mut new_m3 = 0.0;
        for &nodes in &corners_of {
            let volume_m3 = plan.volume_m3(&self.mesh, nodes);
            if crate::math::is_inverted(volume_m3) {
                return Err(EditError::FlatTet { nodes, volume_m3 });
            }
            new_m3 += volume_m3;
        }
        let old_m3: f64 = plan.doomed.iter().map(|&tet| self.mesh.tet_volume_m3(tet)).sum();
        let is_filled = (new_m3 - old_m3).abs() <= VOLUME_TOLERANCE * old_m3;
        if !is_filled {
            return Err(EditError::VolumeDiffers { old_m3, new_m3 });
        }
        for &nodes in &corners_of {
            let fresh_m = corners_m(nodes);
            let mut parents: Vec<(TetId, f64)> = plan
                .doomed
                .iter()
                .map(|&tet| (tet, shared_volume_m3(fresh_m, self.mesh.corners_m(tet))))
                .filter(|parent| parent.1 > 0.0)
                .collect();
            let sum: f64 = parents.iter().map(|p| p.1).sum();
            if sum > 0.0 {
                parents.iter_mut().for_each(|p| p.1 /= sum);
            } else {
                // Too thin to share a volume with anything in floating point: all alike.
                let share = 1.0 / plan.doomed.len() as f64;
                parents = plan.doomed.iter().map(|&tet| (tet, share)).collect();
            }
            parents_of.push(parents);
        }
        for (nodes, parents) in corners_of.into_iter().zip(&parents_of) {
            plan.add_tet(nodes, parents);
        }
        Ok(())
    }

    /// Refuses new tetrahedra whose outer triangles are not those of the old ones, or whose inner triangles
    /// are triangles of others.
    fn check_outer_sides(&self, plan: &Plan, new: &[[NodeId; 4]]) -> Result<(), EditError> {
        let old =
            outer_sides(plan.doomed.iter().map(|&tet| self.topology.tet_nodes(tet))).map_err(differs)?;
        let outer = outer_sides(new.iter().copied()).map_err(differs)?;
        if let Some(&other) = old
            .iter()
            .find(|s| outer.binary_search(s).is_err())
            .or_else(|| outer.iter().find(|s| old.binary_search(s).is_err()))
        {
            return Err(differs(other));
        }
        let n_nodes = self.topology.n_nodes();
        for &corners in new {
            for face in 0..4 {
                let (nodes, odd) = side(corners, face);
                if nodes[2].index() >= n_nodes || outer.binary_search(&(nodes, odd)).is_ok() {
                    continue;
                }
                let Some(triangle) = self.topology.triangle_between(nodes) else { continue };
                let of_others = |tet: TetId| plan.doomed.binary_search(&tet).is_err();
                if self.topology.triangle_tets(triangle).into_iter().filter_map(|t| t.get()).any(of_others) {
                    return Err(differs((nodes, odd)));
                }
            }
        }
        Ok(())
    }
}
