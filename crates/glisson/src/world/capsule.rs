//! Which triangles of the surface are still the organ's own skin, its capsule, and which lie in cuts.
//!
//! An edit that divides or refines skin makes new triangles within old ones; one that opens the organ uncovers others. A new
//! triangle is skin when its middle lies in a triangle of skin that the same edit took away, at rest, and both face about
//! the same way. Faces of a cut leave the skin at an angle, so that the bounds are wide: they are choices.

use super::skin::SurfaceChange;
use crate::math::DVec3;
use crate::mesh::edit::EditableMesh;
use crate::mesh::{NodeId, TriangleId};

/// Cosine of the largest angle between skin and what is left of it: edges that are swapped and nodes that are moved on a
/// curved surface turn it a little.
const LEAST_COSINE: f64 = 0.9;
/// How far off the plane the middle may be, as a share of the old triangle's longest edge ...
const GREATEST_HEIGHT: f64 = 0.1;
/// ... and how far beside the triangle, as a barycentric weight.
const LEAST_WEIGHT: f64 = -0.05;

/// Triangles in cuts. At the start there are none.
#[derive(Clone, Debug, Default)]
pub(super) struct Capsule {
    /// By triangle; those beyond the end are skin. Of triangles inside it means nothing, and an edit that is taken back
    /// finds those that it took away as they were: their numbers are used by nobody else before that.
    is_cut: Vec<bool>,
}

/// A triangle of skin that an edit took away, at rest.
struct OldSkin {
    corners_m: [DVec3; 3],
    normal: DVec3,
    greatest_height_m: f64,
}

impl OldSkin {
    fn new(corners_m: [DVec3; 3]) -> Self {
        let [a, b, c] = corners_m;
        let normal = (b - a).cross(c - a).normalize_or_zero();
        let longest_m = a.distance(b).max(b.distance(c)).max(c.distance(a));
        Self { corners_m, normal, greatest_height_m: GREATEST_HEIGHT * longest_m }
    }

    /// Whether a triangle with that middle [m] and unit normal lies in it.
    fn has(&self, middle_m: DVec3, normal: DVec3) -> bool {
        let [a, b, c] = self.corners_m;
        let from_a = middle_m - a;
        let height_m = from_a.dot(self.normal);
        if height_m.abs() > self.greatest_height_m || normal.dot(self.normal) < LEAST_COSINE {
            return false;
        }
        let twice_area_m2 = (b - a).cross(c - a).dot(self.normal);
        let weight_b = from_a.cross(c - a).dot(self.normal) / twice_area_m2;
        let weight_c = (b - a).cross(from_a).dot(self.normal) / twice_area_m2;
        weight_b.min(weight_c).min(1.0 - weight_b - weight_c) >= LEAST_WEIGHT
    }
}

impl Capsule {
    /// Whether a triangle of the surface lies in a cut.
    pub(super) fn is_cut(&self, triangle: TriangleId) -> bool {
        self.is_cut.get(triangle.index()).copied().unwrap_or(false)
    }

    /// Follows an edit; `nodes_before` are those of a triangle of the surface before it. An edit that is taken back needs
    /// nothing: the triangles that come back are as they were.
    pub(super) fn follow(
        &mut self,
        body: &EditableMesh,
        change: &SurfaceChange<'_>,
        nodes_before: impl Fn(TriangleId) -> Option<[NodeId; 3]>,
    ) {
        let rest_m = &body.mesh().positions_m;
        let corners_m = |nodes: [NodeId; 3]| nodes.map(|n| rest_m[n.index()]);
        let skin = change.removed.iter().filter(|triangle| !self.is_cut(**triangle));
        let old: Vec<OldSkin> =
            skin.filter_map(|&triangle| nodes_before(triangle)).map(|n| OldSkin::new(corners_m(n))).collect();
        let n_triangles = body.topology().n_triangles();
        if !change.added.is_empty() && self.is_cut.len() < n_triangles {
            self.is_cut.resize(n_triangles, false);
        }
        for &triangle in change.added {
            let [a, b, c] = corners_m(body.topology().outward_nodes(triangle));
            let (middle_m, normal) = ((a + b + c) / 3.0, (b - a).cross(c - a).normalize_or_zero());
            self.is_cut[triangle.index()] = !old.iter().any(|skin| skin.has(middle_m, normal));
        }
    }
}
