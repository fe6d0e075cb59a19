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
            let (point_m, normal) = surface_at(organ, first.nodes, first.found.weights);
            let gap_m = (at_m - point_m).dot(normal) - radius_m;
            let is_near = gap_m < NEAR_M + way_m || self.lies_n[node] != DVec3::ZERO;
            self.scratch.walls.try_push(Wall {
                node,
                nodes: first.nodes,
                weights: first.found.weights,
                normal,
                is_near,
            });
        }
    }
}

/// A place of a triangle of the surface [m], and the normal there, which does not jump between triangles.
pub(in crate::world) fn surface_at(organ: &Organ, nodes: [NodeId; 3], weights: [f64; 3]) -> (DVec3, DVec3) {
    let point_m = (0..3).map(|v| organ.positions_m()[nodes[v].index()] * weights[v]).sum();
    let normal: DVec3 = (0..3).map(|v| normal_at(organ, nodes[v]) * weights[v]).sum();
    (point_m, normal.normalize_or(organ.face_normal(nodes)))
}

/// Normal of the surface at a node: the mean of its triangles' by their areas, so that it does not jump between them.
fn normal_at(organ: &Organ, node: NodeId) -> DVec3 {
    let positions_m = organ.positions_m();
    let area = |nodes: [NodeId; 3]| {
        let [a, b, c] = nodes.map(|n| positions_m[n.index()]);
        (b - a).cross(c - a)
    };
    organ.skin().around(node).map(area).sum::<DVec3>().normalize_or_zero()
}
