//! Where a part of an instrument meets the surface: its contact points.
//!
//! Points are every vertex of the surface within a margin of the part, and of every edge and triangle near it the place that is
//! nearest where that lies inside. Places whose triangles all face away from the part do not count: the other side of thin
//! tissue, or of a fold. A place within an edge or a triangle that bore a force moves with the part to the place that is nearest
//! now; where that is further off it stays one beside it: what it held back would come out again else, and the two would take
//! turns. Places that stayed while the part slides on would be behind it, and push it along.
//!
//! Parts push along the shortest way, but for tissue whose displacements are linear in the forces: that is pushed along the normal
//! which it has at rest, as in the theory that it follows. Pushed along the normals of its present shape, the sides of a crater go
//! outwards without a limit, and a ball falls through at a depth of 1.1 radii (`validate touch_reference`).

use crate::contact::shapes::Capsule;
use crate::contact::tool_contact::ToolContact;
use crate::math::DVec3;
use crate::mesh::{NodeId, TriangleId};
use crate::world::organ::Organ;

/// Triangles near a part that are looked at, at most: a choice, far more than a tip meets.
const MOST_NEAR: usize = 512;
/// Points of a part that are looked at, at most.
const MOST_FOUND: usize = 7 * MOST_NEAR;
/// Points are looked for this share of the part's radius beyond the way that it may go in the step: tissue moves too. A choice.
pub(super) const AROUND: f64 = 0.1;
/// Below this weight a place of a triangle lies on the edge across.
const ON_EDGE: f64 = 1e-6;

/// What of the surface a point is, for telling it again in the next step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Feature {
    Vertex(NodeId),
    /// Between two nodes, ascending.
    Edge(NodeId, NodeId),
    Triangle(TriangleId),
}

impl Feature {
    /// The same as numbers, different for each.
    pub(super) fn numbers(self) -> [f64; 3] {
        match self {
            Self::Vertex(a) => [0.0, f64::from(a.0), 0.0],
            Self::Edge(a, b) => [1.0, f64::from(a.0), f64::from(b.0)],
            Self::Triangle(t) => [2.0, f64::from(t.0), 0.0],
        }
    }
}

/// A place of the surface near a part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ContactPoint {
    pub(super) feature: Feature,
    /// A triangle that has the place and faces the part, its nodes and their weights there.
    pub(super) triangle: TriangleId,
    pub(super) nodes: [NodeId; 3],
    pub(super) weights: [f64; 3],
    /// Share of the part's axis that is nearest.
    pub(super) along: f64,
    /// Unit vector along which the part pushes.
    pub(super) inward: DVec3,
    /// Unit normal of the surface at the place, out of the organ: at rest where it is pushed along that, else now.
    pub(super) outward: DVec3,
    /// From the axis to the part's surface where it touches the place [m].
    pub(super) arm_m: DVec3,
    /// Distance from the part's surface along the push [m]; negative inside.
    pub(super) gap_m: f64,
    /// Whether it bore a force in the last step.
    pub(super) is_kept: bool,
}

/// Weights that differ by less are of one place: a choice.
const SAME_PLACE: f64 = 0.1;

impl ContactPoint {
    fn key(&self) -> (Feature, bool) {
        (self.feature, self.is_kept)
    }

    /// Whether another point of its feature is at the same place.
    pub(super) fn is_at(&self, other: &Self) -> bool {
        let weight = |point: &Self, node: NodeId| {
            let at = point.nodes.iter().position(|n| *n == node);
            at.map_or(0.0, |v| point.weights[v])
        };
        let differs = |&node: &NodeId| (weight(self, node) - weight(other, node)).abs() > SAME_PLACE;
        !self.nodes.iter().any(differs)
    }

    /// The same place as a part has it now; none where it is further off than the margin, or faces away. What bore a force is
    /// still on the side that it was, also where the axis went through it.
    fn seen_from(mut self, look: &Look<'_>) -> Option<Self> {
        let Look { organ, part, margin_m, is_linear } = *look;
        let corners_m = self.nodes.map(|n| organ.positions_m()[n.index()]);
        let face = (corners_m[1] - corners_m[0]).cross(corners_m[2] - corners_m[0]);
        let place_m: DVec3 = (0..3).map(|v| corners_m[v] * self.weights[v]).sum();
        self.along = along_axis(part, place_m);
        let way_m = place_m - part.axis_point_m(self.along);
        let straight = way_m.normalize_or_zero();
        let has_passed = self.is_kept && straight.dot(self.inward) <= 0.0;
        if is_linear {
            self.outward = normal_of(organ, &organ.mesh().positions_m, (self.nodes, self.weights));
            self.inward = -self.outward;
            let depth_m = way_m.dot(self.inward);
            let beside_m = way_m - self.inward * depth_m;
            let height_m2 = part.radius_m * part.radius_m - beside_m.length_squared();
            if height_m2 <= 0.0 {
                return None;
            }
            self.arm_m = beside_m + self.inward * height_m2.sqrt();
            self.gap_m = depth_m - height_m2.sqrt();
        } else if has_passed {
            self.inward = if straight == DVec3::ZERO { self.inward } else { -straight };
            self.arm_m = self.inward * part.radius_m;
            self.gap_m = -way_m.length() - part.radius_m;
        } else {
            self.inward = straight;
            self.arm_m = straight * part.radius_m;
            self.gap_m = way_m.length() - part.radius_m;
        }
        let faces = self.is_kept || straight.dot(face) < 0.0 && self.inward.dot(face) < 0.0;
        let is_near = (-MOST_DEEP * part.radius_m..=margin_m).contains(&self.gap_m);
        if !is_near || !faces {
            return None;
        }
        if !is_linear {
            self.outward = normal_of(organ, organ.positions_m(), (self.nodes, self.weights));
        }
        Some(self)
    }
}

/// Tissue that is so many radii deep in a part went another way: a choice.
const MOST_DEEP: f64 = 2.0;

/// A part among an organ's tissue.
#[derive(Clone, Copy)]
pub(super) struct Look<'a> {
    pub(super) organ: &'a Organ,
    pub(super) part: &'a Capsule,
    /// Distance up to which places count [m].
    pub(super) margin_m: f64,
    /// Whether the tissue's displacements are linear in the forces.
    pub(super) is_linear: bool,
}

/// Unit normal out of the organ at a place of its surface in a shape, between those of the nodes.
fn normal_of(organ: &Organ, shape_m: &[DVec3], (nodes, weights): ([NodeId; 3], [f64; 3])) -> DVec3 {
    let of_node = |node: NodeId| {
        let faces = organ.skin().around(node).map(|nodes| {
            let [a, b, c] = nodes.map(|node| shape_m[node.index()]);
            (b - a).cross(c - a)
        });
        faces.sum::<DVec3>().normalize_or_zero()
    };
    let on = (0..3).filter(|&v| weights[v] > 0.0);
    on.map(|v| of_node(nodes[v]) * weights[v]).sum::<DVec3>().normalize_or_zero()
}

/// Room for the points of a part.
#[derive(Debug)]
pub(super) struct PointSearch {
    near: Vec<ToolContact>,
    found: Vec<ContactPoint>,
}

impl PointSearch {
    pub(super) fn new() -> Self {
        Self { near: Vec::with_capacity(MOST_NEAR), found: Vec::with_capacity(MOST_FOUND) }
    }

    /// Without room, in the place of one that is in use.
    pub(super) fn none() -> Self {
        Self { near: Vec::new(), found: Vec::new() }
    }

    /// Finds the points within the margin of a part, the deepest first; those that bore a force in the last step, `kept`, are among
    /// them. Allocates nothing.
    pub(super) fn find(&mut self, look: &Look<'_>, kept: &(impl Iterator<Item = ContactPoint> + Clone)) {
        let organ = look.organ;
        self.near.clear();
        self.found.clear();
        organ.skin().near_into(look.part, look.margin_m, &mut self.near);
        for point in kept.clone() {
            let slot = organ.skin().slot_of(point.triangle);
            let is_there = slot.is_some_and(|slot| organ.skin().place_in_slot(slot).1 == point.nodes);
            if is_there && self.found.len() < MOST_NEAR {
                let point = self.moved_to_nearest(point, slot);
                self.found.extend(point.seen_from(look));
            }
        }
        for near in &self.near {
            let place = organ.skin().place_of(*near);
            let mut add = |feature: Feature, weights: [f64; 3]| {
                let point = ContactPoint {
                    feature,
                    triangle: place.triangle,
                    nodes: place.nodes,
                    weights,
                    along: 0.0,
                    inward: DVec3::ZERO,
                    outward: DVec3::ZERO,
                    arm_m: DVec3::ZERO,
                    gap_m: 0.0,
                    is_kept: false,
                };
                let is_known = |known: ContactPoint| known.feature == feature && known.is_at(&point);
                if !kept.clone().any(is_known) {
                    self.found.extend(point.seen_from(look));
                }
            };
            for v in 0..3 {
                let mut weights = [0.0; 3];
                weights[v] = 1.0;
                add(Feature::Vertex(place.nodes[v]), weights);
            }
            let weights = on_edges(near.weights);
            if let Some(feature) = inside(place.triangle, place.nodes, weights) {
                add(feature, weights);
            }
        }
        // Each but once, with the lowest of its triangles.
        self.found.sort_unstable_by_key(|point| (point.feature, !point.is_kept, point.triangle));
        self.found.dedup_by_key(|point| (point.feature, point.is_kept));
        self.found.sort_unstable_by(|a, b| a.gap_m.total_cmp(&b.gap_m).then_with(|| a.key().cmp(&b.key())));
    }

    /// A place within an edge or a triangle, where that of it is which is nearest now; the same if that is further off.
    fn moved_to_nearest(&self, point: ContactPoint, slot: Option<u32>) -> ContactPoint {
        let near = self.near.iter().find(|near| Some(near.triangle) == slot);
        let Some(near) = near else { return point };
        let weights = on_edges(near.weights);
        let moved = ContactPoint { weights, ..point };
        let is_same = inside(point.triangle, point.nodes, weights) == Some(point.feature);
        if is_same && moved.is_at(&point) { moved } else { point }
    }

    /// What was found last.
    pub(super) fn found(&self) -> &[ContactPoint] {
        &self.found
    }
}

/// Weights without what is as good as nothing.
fn on_edges(weights: [f64; 3]) -> [f64; 3] {
    weights.map(|w| if w > ON_EDGE { w } else { 0.0 })
}

/// What a place with these weights lies inside of: an edge or the triangle; none at a vertex.
fn inside(triangle: TriangleId, nodes: [NodeId; 3], weights: [f64; 3]) -> Option<Feature> {
    let mut on = (0..3).filter(|&v| weights[v] > 0.0).map(|v| nodes[v]);
    match (on.next(), on.next(), on.next()) {
        (Some(a), Some(b), None) => Some(Feature::Edge(a.min(b), a.max(b))),
        (Some(_), Some(_), Some(_)) => Some(Feature::Triangle(triangle)),
        _ => None,
    }
}

/// Share of a part's axis that is nearest to a place.
pub(super) fn along_axis(part: &Capsule, place_m: DVec3) -> f64 {
    let axis_m = part.to_m - part.from_m;
    let along = (place_m - part.from_m).dot(axis_m) / axis_m.length_squared();
    if along.is_finite() { along.clamp(0.0, 1.0) } else { 0.0 }
}
