//! Exchange of tetrahedra for others whose descent is known.

use super::overlap::shared_volume_m3;
use super::plan::Plan;
use super::retetrahedralise::{VOLUME_TOLERANCE, WEIGHT_TOLERANCE, differs, outer_sides, side};
use super::{CavityNode, EditError, EditableMesh, NewNode};
use crate::math::{Aabb, is_inverted};
use crate::mesh::{NodeId, TetId};

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

impl EditableMesh {
    pub(super) fn plan_replace(
        &mut self,
        Replacement { tets, new_nodes, new_tets }: &Replacement,
        plan: &mut Plan,
    ) -> Result<(), EditError> {
        self.topology.check_removable(tets)?;
        plan.doomed.extend_from_slice(tets);
        plan.doomed.sort_unstable();
        let n_nodes = self.topology.n_nodes();
        let mut is_used = vec![false; new_nodes.len()];
        let mut corners_of = Vec::with_capacity(new_tets.len());
        for (place, tet) in new_tets.iter().enumerate() {
            let bad = EditError::BadCorners { place, n_new: new_nodes.len() };
            let mut nodes = [NodeId(0); 4];
            for at in 0..4 {
                nodes[at] = match tet.corners[at] {
                    CavityNode::Old(node) if node.index() < n_nodes && self.topology.is_live_node(node) => {
                        node
                    }
                    CavityNode::New(new) if (new as usize) < new_nodes.len() => {
                        is_used[new as usize] = true;
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
        for (place, node) in new_nodes.iter().enumerate() {
            let sum: f64 = node.parents.iter().map(|p| p.1).sum();
            let there = |n: NodeId| n.index() < n_nodes && self.topology.is_live_node(n);
            let is_sum_right = (sum - 1.0).abs() <= WEIGHT_TOLERANCE;
            let are_parents_there = node.parents.iter().all(|p| there(p.0));
            if !(node.position_m.is_finite() && is_used[place] && is_sum_right && are_parents_there) {
                return Err(EditError::BadNewNode { place, sum });
            }
            plan.add_node(node.position_m, &node.parents);
        }
        self.check_borders(plan, &corners_of)?;
        let mut new_m3 = 0.0;
        for &nodes in &corners_of {
            let volume_m3 = plan.volume_m3(&self.mesh, nodes);
            if is_inverted(volume_m3) {
                return Err(EditError::FlatTet { nodes, volume_m3 });
            }
            new_m3 += volume_m3;
        }
        let old_m3: f64 = plan.doomed.iter().map(|&tet| self.mesh.tet_volume_m3(tet)).sum();
        let is_filled = (new_m3 - old_m3).abs() <= VOLUME_TOLERANCE * old_m3;
        if !is_filled {
            return Err(EditError::VolumeDiffers { old_m3, new_m3 });
        }
        let bounds: Vec<Aabb> =
            plan.doomed.iter().map(|&tet| Aabb::of_points(&self.mesh.corners_m(tet))).collect();
        for (place, (nodes, tet)) in corners_of.into_iter().zip(new_tets).enumerate() {
            if tet.parents.is_empty() {
                let parents = self.parents_by_volume(plan, &bounds, nodes);
                plan.add_tet(nodes, &parents);
                continue;
            }
            let sum: f64 = tet.parents.iter().map(|p| p.1).sum();
            let are_parents_there = tet.parents.iter().all(|p| plan.doomed.binary_search(&p.0).is_ok());
            let is_sum_right = (sum - 1.0).abs() <= WEIGHT_TOLERANCE;
            if !(are_parents_there && is_sum_right) {
                return Err(EditError::BadParents { place, sum });
            }
            plan.add_tet(nodes, &tet.parents);
        }
        Ok(())
    }

    fn parents_by_volume(&self, plan: &Plan, bounds: &[Aabb], nodes: [NodeId; 4]) -> Vec<(TetId, f64)> {
        let corners_m = nodes.map(|n| plan.position_m(&self.mesh, n));
        let own = Aabb::of_points(&corners_m);
        let is_near = |b: &Aabb| b.min_m.cmple(own.max_m).all() && b.max_m.cmpge(own.min_m).all();
        let mut parents: Vec<(TetId, f64)> = plan
            .doomed
            .iter()
            .zip(bounds)
            .filter(|(_, b)| is_near(b))
            .map(|(&tet, _)| (tet, shared_volume_m3(corners_m, self.mesh.corners_m(tet))))
            .filter(|parent| parent.1 > 0.0)
            .collect();
        let sum: f64 = parents.iter().map(|p| p.1).sum();
        if sum > 0.0 {
            parents.iter_mut().for_each(|p| p.1 /= sum);
            return parents;
        }
        // Too thin to share a volume with anything in floating point: all alike.
        let share = 1.0 / plan.doomed.len() as f64;
        plan.doomed.iter().map(|&tet| (tet, share)).collect()
    }

    /// Refuses tetrahedra that leave a triangle towards a neighbour that stays without its other side, or that
    /// meet others in a triangle from the same side.
    fn check_borders(&self, plan: &Plan, new: &[[NodeId; 4]]) -> Result<(), EditError> {
        let outer = outer_sides(new.iter().copied()).map_err(differs)?;
        let stays = |tet: TetId| plan.doomed.binary_search(&tet).is_err();
        let mut n_borders = 0;
        for &tet in &plan.doomed {
            for (face, neighbour) in self.topology.tet_neighbours(tet).into_iter().enumerate() {
                if neighbour.get().is_some_and(stays) {
                    let border = side(self.topology.tet_nodes(tet), face);
                    n_borders += 1;
                    if outer.binary_search(&border).is_err() {
                        return Err(differs(border));
                    }
                }
            }
        }
        // No other triangle may meet a tetrahedron that stays.
        let n_nodes = self.topology.n_nodes();
        let mut n_meetings = 0;
        for &(nodes, odd) in &outer {
            if nodes[2].index() >= n_nodes {
                continue;
            }
            let Some(triangle) = self.topology.triangle_between(nodes) else { continue };
            if self.topology.triangle_tets(triangle).into_iter().filter_map(|t| t.get()).any(stays) {
                n_meetings += 1;
                if n_meetings > n_borders {
                    return Err(differs((nodes, odd)));
                }
            }
        }
        Ok(())
    }
}
