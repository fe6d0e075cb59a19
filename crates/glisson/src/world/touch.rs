//! A contact that is held: from the first touch until the tool has come back out and would pull.
//!
//! The tissue sticks to the tip while the contact lasts: the touched point follows the tool exactly
//! (Cotin, Delingette and Ayache 1998, RR-3511, s. 5; the device measures position, so the model is driven by
//! displacements). Sliding with friction is not modelled here.

use super::organ::Organ;
use crate::contact::sphere::Touch;
use crate::contact::spread::motion_weights;
use crate::math::DVec3;
use crate::mesh::NodeId;
use crate::model::ImposedDisplacement;

/// Pull at which a contact lets go [N]: ten times below what a hand feels as a change
/// of weight in the fingers, far above rounding.
const RELEASE_PULL_N: f64 = 1e-3;

/// One touched triangle and how its vertices follow the tool.
#[derive(Clone, Debug, PartialEq)]
pub struct HeldContact {
    nodes: [NodeId; 3],
    weights: [f64; 3],
    motion_weights: [f64; 3],
    /// Displacements of the three nodes at the touch [m].
    displacements_at_touch_m: [DVec3; 3],
    /// The tip's centre for which the imposed motion is zero [m].
    neutral_tip_m: DVec3,
    normal: DVec3,
}

impl HeldContact {
    /// The contact that begins with `touch`, or `None` on tissue that is held fixed.
    pub fn begin(touch: &Touch, organ: &Organ, positions_m: &[DVec3]) -> Option<Self> {
        let nodes = organ.surface_triangle(touch.triangle);
        let motion_weights = motion_weights(touch.weights, nodes.map(|n| organ.is_fixed(n)))?;
        let rest_m = &organ.mesh().positions_m;
        Some(Self {
            nodes,
            weights: touch.weights,
            motion_weights,
            displacements_at_touch_m: nodes.map(|n| positions_m[n.index()] - rest_m[n.index()]),
            // An overlap at the touch is pushed out along the normal.
            neutral_tip_m: touch.center_m - touch.normal * touch.gap_m,
            normal: touch.normal,
        })
    }

    /// Everything that its next steps depend on.
    pub(super) fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        let vectors = self.displacements_at_touch_m.into_iter().chain([self.neutral_tip_m, self.normal]);
        let nodes = self.nodes.map(|node| f64::from(node.0));
        nodes
            .into_iter()
            .chain(self.weights)
            .chain(self.motion_weights)
            .chain(vectors.flat_map(|v| v.to_array()))
    }

    /// Appends what the tool at `tip_m` imposes, ascending by node. Fixed nodes are left to their support.
    pub fn add_constraints(&self, tip_m: DVec3, constraints: &mut Vec<ImposedDisplacement>) {
        let motion_m = tip_m - self.neutral_tip_m;
        let first = constraints.len();
        for v in 0..3 {
            if self.motion_weights[v] > 0.0 {
                let displacement_m = self.displacements_at_touch_m[v] + motion_m * self.motion_weights[v];
                constraints.push(ImposedDisplacement { node: self.nodes[v], displacement_m });
            }
        }
        constraints[first..].sort_unstable_by_key(|c| c.node);
    }

    /// Whether the contact ends: the tip is at least as far out as where it touched, and would have to pull.
    /// Deeper in it holds even if a sideways motion makes the normal force a pull, because tissue that sticks
    /// and then jumps back would be felt as a blow.
    pub fn lets_go(&self, tip_m: DVec3, force_on_organ_n: DVec3) -> bool {
        let is_out = (tip_m - self.neutral_tip_m).dot(self.normal) >= 0.0;
        is_out && force_on_organ_n.dot(self.normal) > RELEASE_PULL_N
    }

    /// The touched point [m].
    pub fn point_m(&self, positions_m: &[DVec3]) -> DVec3 {
        (0..3).map(|v| positions_m[self.nodes[v].index()] * self.weights[v]).sum()
    }

    /// Unit normal at the touch, out of the organ.
    pub fn normal(&self) -> DVec3 {
        self.normal
    }

    /// Nodes of the touched triangle.
    pub fn nodes(&self) -> [NodeId; 3] {
        self.nodes
    }

    /// Barycentric weights of the touched point.
    pub fn weights(&self) -> [f64; 3] {
        self.weights
    }
}
