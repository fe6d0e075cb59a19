//! A contact that is held: from the first touch until the tool has come back out and would pull.
//!
//! The touched point of the tissue follows the tool exactly (Cotin, Delingette and Ayache 1998, RR-3511, s. 5; the device
//! measures position, so the model is driven by displacements). Sticky tissue stays at the tool while the contact lasts;
//! other tissue slides on it where the pull along the surface is more than Coulomb's friction bears ([`super::slide`]).

use super::detection::FROM_INSIDE;
use super::organ::Organ;
use super::parts::ToolPoint;
use super::skin::SurfacePlace;
use crate::contact::spread::motion_weights;
use crate::math::DVec3;
use crate::mesh::{NodeId, TriangleId};

/// Pull at which a contact lets go [N]: ten times below what a hand feels as a change
/// of weight in the fingers, far above rounding.
const RELEASE_PULL_N: f64 = 1e-3;

/// Tissue that a tool overlaps when it begins to touch is pushed out no faster than this [m/s]: a choice, a hand's calm
/// motion.
const PUSH_OUT_M_PER_S: f64 = 0.2;

/// One touched triangle, the force on it and where the tool presses it.
#[derive(Clone, Debug, PartialEq)]
pub struct HeldContact {
    pub(super) triangle: TriangleId,
    pub(super) nodes: [NodeId; 3],
    pub(super) weights: [f64; 3],
    /// What of the tool touches.
    pub(super) at: ToolPoint,
    /// From the tool's point to where it wants the touched point [m].
    pub(super) offset_m: DVec3,
    pub(super) normal: DVec3,
    /// How far the tissue still has to be pushed out of the tool [m].
    pub(super) overlap_m: f64,
    /// Forces on the nodes in the last step [N]; none on those that it did not hold.
    pub(super) forces_n: [DVec3; 3],
    /// Displacement from rest of the touched point at the touch [m].
    touch_displacement_m: DVec3,
    /// How much further it was displaced after the last step [m].
    pressed_m: DVec3,
    /// How far the tool slid in this step [m].
    pub(super) slip_m: f64,
    /// Whether it began in this step.
    is_new: bool,
}

impl HeldContact {
    /// The contact that begins at `place` with the tool's point `at`, which is `point_m` from the touched triangle's plane
    /// by `radius_m` when it just touches; or none from inside, and on tissue that is held fixed unless that stops the tool.
    pub(super) fn begin(
        place: &SurfacePlace,
        at: ToolPoint,
        (point_m, radius_m): (DVec3, f64),
        (organ, fixed_stops): (&Organ, bool),
    ) -> ContactBegin {
        let positions_m = organ.positions_m();
        let nodes = place.nodes;
        let corners_m = nodes.map(|n| positions_m[n.index()]);
        let face = (corners_m[1] - corners_m[0]).cross(corners_m[2] - corners_m[0]).normalize_or_zero();
        let contact = &place.found.contact;
        let normal = contact.normal;
        let weights = place.found.weights;
        if normal.dot(face) < FROM_INSIDE {
            return ContactBegin::FromInside;
        }
        let yields = motion_weights(weights, nodes.map(|n| organ.is_fixed(n))).is_some();
        if !yields && !fixed_stops {
            return ContactBegin::OnFixedTissue;
        }
        let touched_m: DVec3 = (0..3).map(|v| corners_m[v] * weights[v]).sum();
        let overlap_m = (-contact.gap_m).max(0.0);
        // As it is where they overlap: that is taken out bit by bit.
        let offset_m = if overlap_m > 0.0 { touched_m - point_m } else { normal * -radius_m };
        ContactBegin::Touches(
            Self {
                triangle: place.triangle,
                nodes,
                weights,
                at,
                offset_m,
                normal,
                overlap_m,
                forces_n: [DVec3::ZERO; 3],
                touch_displacement_m: displacement_m(organ, nodes, weights),
                pressed_m: DVec3::ZERO,
                slip_m: 0.0,
                is_new: true,
            },
            contact.time,
        )
    }

    /// The tool's point is elsewhere than it was taken to be when the contact began: tissue that it overlaps still is where it was.
    pub(super) fn anchor_overlap(&mut self, point_m: DVec3, organ: &Organ) {
        if self.overlap_m > 0.0 {
            self.offset_m = self.point_m(organ.positions_m()) - point_m;
        }
    }

    /// Whether it began in this step.
    pub(super) fn is_new(&self) -> bool {
        self.is_new
    }

    /// Force on the organ in the last step [N].
    pub(super) fn force_on_organ_n(&self) -> DVec3 {
        self.forces_n.into_iter().sum()
    }

    /// Everything that its next steps depend on.
    pub(super) fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        let vectors = self.forces_n.into_iter();
        let vectors = vectors.chain([self.offset_m, self.normal, self.touch_displacement_m, self.pressed_m]);
        let nodes = self.nodes.map(|node| f64::from(node.0));
        nodes
            .into_iter()
            .chain(self.weights)
            .chain(vectors.flat_map(|v| v.to_array()))
            .chain(self.at.numbers())
            .chain([f64::from(self.triangle.0), self.overlap_m])
    }

    /// Where the tool presses now, with what force; the tissue was touched elsewhere.
    pub(super) fn sit_on(&mut self, seat: &Seat) {
        (self.triangle, self.nodes, self.weights) = (seat.triangle, seat.nodes, seat.weights);
        (self.at, self.normal, self.overlap_m) = (seat.at, seat.normal, 0.0);
        self.forces_n = seat.weights.map(|weight| seat.force_n * weight);
    }

    /// A step of pushing the tissue out of the tool.
    pub(super) fn push_out(&mut self, dt_s: f64) {
        let out_m = self.overlap_m.min(PUSH_OUT_M_PER_S * dt_s);
        self.overlap_m -= out_m;
        self.offset_m -= self.normal * out_m;
    }

    /// After a step in which the tool exerted these forces on the nodes [N].
    pub(super) fn feel(&mut self, organ: &Organ, forces_n: [DVec3; 3]) {
        self.forces_n = forces_n;
        self.is_new = false;
        self.pressed_m = displacement_m(organ, self.nodes, self.weights) - self.touch_displacement_m;
    }

    /// How far the tool pressed the tissue in, along the normal [m].
    pub(super) fn depth_m(&self) -> f64 {
        (-self.pressed_m.dot(self.normal)).max(0.0)
    }

    /// Whether the contact ends: it would have to pull. Sticky tissue does, until the tool is as far out as where it touched.
    pub(super) fn lets_go(&self, force_on_organ_n: DVec3, is_sticky: bool) -> bool {
        let is_out = !is_sticky || self.pressed_m.dot(self.normal) >= 0.0;
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

/// The point that stands for all at which a part touches.
pub(super) struct Seat {
    pub(super) triangle: TriangleId,
    pub(super) nodes: [NodeId; 3],
    pub(super) weights: [f64; 3],
    pub(super) at: ToolPoint,
    /// Unit vector out of the organ.
    pub(super) normal: DVec3,
    /// Force of the part on the organ [N].
    pub(super) force_n: DVec3,
}

/// Displacement from rest of a place of the surface [m].
fn displacement_m(organ: &Organ, nodes: [NodeId; 3], weights: [f64; 3]) -> DVec3 {
    let (rest_m, now_m) = (&organ.mesh().positions_m, organ.positions_m());
    (0..3).map(|v| (now_m[nodes[v].index()] - rest_m[nodes[v].index()]) * weights[v]).sum()
}

/// What became of a touch.
#[allow(clippy::large_enum_variant, reason = "a box would allocate in a step")]
pub(super) enum ContactBegin {
    /// A contact, and the share of the tool's way in the step when it began.
    Touches(HeldContact, f64),
    /// Tissue that cannot give way.
    OnFixedTissue,
    /// The tool comes out of the organ: nothing holds it back.
    FromInside,
}
