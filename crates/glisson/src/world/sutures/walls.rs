//! Where a thread lies on tissue: planes that its nodes stay outside of.

use super::Suture;
use crate::contact::shapes::Capsule;
use crate::math::DVec3;
use crate::mesh::NodeId;
use crate::world::organ::Organ;

/// Tissue that is further from a node is not looked at [m], beside what the node moves: a choice, deeper than any step sinks it.
const REACH_M: f64 = 3e-3;
/// A node that is nearer to tissue than this [m] is answered by the model's own compliance: a choice.
const NEAR_M: f64 = 3e-4;
/// Triangles whose distance differs by no more than this are equally near [m].
const SAME_M: f64 = 1e-9;

/// Tissue beside a node of a thread.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wall {
    pub(super) node: usize,
    pub(super) nodes: [NodeId; 3],
    pub(super) weights: [f64; 3],
    /// Outward.
    pub(super) normal: DVec3,
    /// Whether it may be touched in the step.
    pub(super) is_near: bool,
}

impl Suture {
    /// Finds the tissue beside all nodes that are not in it, into the scratch.
    pub(super) fn find_walls(&mut self, organ: &Organ, dt_s: f64) {
        self.scratch.walls.clear();
        let radius_m = self.rod.radius_m();
        for node in 0..self.rod.n_nodes() {
            let along_m = self.rod.spacing_m() * node as f64;
            // Beside a hole the hole holds it: a wall would push it out of what it is drawn into.
            let is_at_hole = self.holes_m().any(|hole_m| (hole_m - along_m).abs() < self.rod.spacing_m());
            if is_at_hole || self.is_in_tissue(along_m) {
                self.lies_n[node] = DVec3::ZERO;
                continue;
            }
            let at_m = self.rod.positions_m[node];
            let way_m = 2.0 * self.rod.velocities_m_per_s[node].length() * dt_s;
            let near = &mut self.scratch.near;
            organ.skin().nearest_into(&Capsule::ball(at_m, radius_m), REACH_M + way_m, near);
            let Some(first) = near.first().map(|contact| organ.skin().place_of(*contact)) else {
                self.lies_n[node] = DVec3::ZERO;
                continue;
            };
            let place_m = |nodes: [NodeId; 3], weights: [f64; 3]| -> DVec3 {
                (0..3).map(|v| organ.positions_m()[nodes[v].index()] * weights[v]).sum()
            };
            let nearest_m = place_m(first.nodes, first.found.weights).distance(at_m);
            // Of triangles that meet at the nearest place, the one that faces the node most tells the side.
            let mut best: Option<(f64, Wall)> = None;
            for place in near.iter().map(|contact| organ.skin().place_of(*contact)) {
                let point_m = place_m(place.nodes, place.found.weights);
                let off_m = at_m - point_m;
                if off_m.length() > nearest_m + SAME_M {
                    continue;
                }
                let face = organ.face_normal(place.nodes);
                let facing = off_m.normalize_or(face).dot(face);
                if best.as_ref().is_some_and(|(most, _)| facing.abs() <= most.abs()) {
                    continue;
                }
                let normal = if facing < 0.0 { -off_m.normalize_or(-face) } else { off_m.normalize_or(face) };
                let gap_m = off_m.dot(normal) - radius_m;
                let is_near = gap_m < NEAR_M + way_m || self.lies_n[node] != DVec3::ZERO;
                let wall = Wall { node, nodes: place.nodes, weights: place.found.weights, normal, is_near };
                best = Some((facing, wall));
            }
            if let Some((_, wall)) = best {
                self.scratch.walls.try_push(wall);
            }
        }
    }
}
