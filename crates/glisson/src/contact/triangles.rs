//! The narrow phase: do two triangles meet, and where are triangles, segments and each other closest?
//!
//! Whether triangles meet is decided exactly: a separating axis found in floating point counts only when it
//! separates by more than the rounding bound; what remains goes to the signs of determinants (Guigue and Devillers
//! 2003, "Fast and robust triangle-triangle overlap test using orientation predicates", J. Graphics Tools 8(1)),
//! computed by `robust`. Triangles without area are treated as the segments that they are.
//!
//! Distances are minima over feasible pairs of points: rounding can make them too large (by less than 1e-8 of the
//! triangles' size), never too small.

use crate::math::{DVec3, closest_point_barycentric};
use crate::surface::intersect::{disjoint_triangles_meet, segment_meets_triangle, segments_meet, side, turn};

/// Corners and normal (of any length) of a triangle, for many tests.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PreparedTriangle {
    /// Corners [m].
    pub corners_m: [DVec3; 3],
    /// Twice the area, along the normal [m2].
    pub normal_m2: DVec3,
}

impl PreparedTriangle {
    /// For these corners.
    #[inline]
    pub fn new(corners_m: [DVec3; 3]) -> Self {
        let [a, b, c] = corners_m;
        Self { corners_m, normal_m2: (b - a).cross(c - a) }
    }
}

/// Whether two triangles have a point in common; touching counts, and the answer is exact for the given
/// coordinates. False when a coordinate is not finite.
pub fn triangles_meet(p: [DVec3; 3], q: [DVec3; 3]) -> bool {
    prepared_triangles_meet(&PreparedTriangle::new(p), &PreparedTriangle::new(q))
}

/// [`triangles_meet`] for prepared triangles.
#[inline]
pub fn prepared_triangles_meet(p: &PreparedTriangle, q: &PreparedTriangle) -> bool {
    let origin = p.corners_m[0];
    let a = p.corners_m.map(|x| x - origin);
    let b = q.corners_m.map(|x| x - origin);
    let extent = [a[1], a[2], b[0], b[1], b[2]].iter().fold(DVec3::ZERO, |e, x| e.max(x.abs()));
    if separates(p.normal_m2, &a, &b, extent) || separates(q.normal_m2, &a, &b, extent) {
        return false;
    }
    for (normal, corners) in [(p.normal_m2, &a), (q.normal_m2, &b)] {
        for e in 0..3 {
            let axis = normal.cross(corners[(e + 1) % 3] - corners[e]);
            if separates(axis, &a, &b, extent) {
                return false;
            }
        }
    }
    meet_exactly(p, q)
}

/// Whether `axis` certainly separates the triangles. Any axis is right, however it was rounded; a product with a
/// difference of coordinates is off by at most 4 u |axis| . extent, u = 2^-53, the difference of two by twice that. The
/// bound is four times as large.
#[inline]
fn separates(axis: DVec3, a: &[DVec3; 3], b: &[DVec3; 3], extent: DVec3) -> bool {
    let (a, b) = (a.map(|x| axis.dot(x)), b.map(|x| axis.dot(x)));
    let bound = 16.0 * f64::EPSILON * axis.abs().dot(extent) + f64::MIN_POSITIVE;
    let low = |x: [f64; 3]| x[0].min(x[1]).min(x[2]);
    let high = |x: [f64; 3]| x[0].max(x[1]).max(x[2]);
    low(b) > high(a) + bound || low(a) > high(b) + bound
}

#[cold]
fn meet_exactly(p: &PreparedTriangle, q: &PreparedTriangle) -> bool {
    let finite = |t: &PreparedTriangle| t.corners_m.iter().all(|x| x.is_finite());
    if !finite(p) || !finite(q) {
        return false;
    }
    let (a, b) = (p.corners_m, q.corners_m);
    match (is_flat(p), is_flat(q)) {
        (false, false) => disjoint_triangles_meet(a, b),
        (true, false) => edges(a).iter().any(|&[u, v]| segment_meets_triangle(u, v, b)),
        (false, true) => edges(b).iter().any(|&[u, v]| segment_meets_triangle(u, v, a)),
        (true, true) => {
            edges(a).iter().any(|&first| edges(b).iter().any(|&second| segments_meet_in_space(first, second)))
        }
    }
}

fn edges([a, b, c]: [DVec3; 3]) -> [[DVec3; 2]; 3] {
    [[a, b], [b, c], [c, a]]
}

/// Whether the corners lie on one line exactly.
fn is_flat(t: &PreparedTriangle) -> bool {
    let [a, b, c] = t.corners_m;
    (0..3).all(|axis| turn(axis, a, b, c) == 0)
}

/// Two closed segments meet when they lie in one plane and meet as seen along every axis: along one of them the plane
/// is seen faithfully.
fn segments_meet_in_space([u, v]: [DVec3; 2], [a, b]: [DVec3; 2]) -> bool {
    side(u, v, a, b) == 0 && (0..3).all(|axis| segments_meet(axis, [u, v], [a, b]))
}

/// Closest points of two bodies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Closest {
    /// Point of the first body [m].
    pub first_m: DVec3,
    /// Point of the second body [m].
    pub second_m: DVec3,
    /// Their distance [m].
    pub distance_m: f64,
}

impl Closest {
    fn new(first_m: DVec3, second_m: DVec3) -> Self {
        Self { first_m, second_m, distance_m: first_m.distance(second_m) }
    }

    fn keep_closer(&mut self, other: Self) {
        if other.distance_m < self.distance_m {
            *self = other;
        }
    }

    fn swapped(self) -> Self {
        Self { first_m: self.second_m, second_m: self.first_m, distance_m: self.distance_m }
    }
}

/// Squared sine below which a triangle is a sliver whose closest point is sought on its edges: above it the
/// barycentric weights are good to 1e-6.
const SLIVER: f64 = 1e-20;

/// Barycentric weights of the point of a triangle that is closest to `point_m`; slivers and triangles without area
/// included.
pub fn closest_weights(point_m: DVec3, corners_m: [DVec3; 3]) -> [f64; 3] {
    let [a, b, c] = corners_m;
    let (ab, ac) = (b - a, c - a);
    if ab.cross(ac).length_squared() > SLIVER * ab.length_squared() * ac.length_squared() {
        return closest_point_barycentric(point_m, corners_m);
    }
    let mut best = ([1.0, 0.0, 0.0], f64::INFINITY);
    for e in 0..3 {
        let (from, to) = (corners_m[e], corners_m[(e + 1) % 3]);
        let t = closest_share(point_m, from, to);
        let distance = from.lerp(to, t).distance_squared(point_m);
        if distance < best.1 {
            let mut weights = [0.0; 3];
            weights[e] = 1.0 - t;
            weights[(e + 1) % 3] += t;
            best = (weights, distance);
        }
    }
    best.0
}

/// Point at barycentric `weights`.
#[inline]
pub fn at_weights(corners_m: [DVec3; 3], weights: [f64; 3]) -> DVec3 {
    corners_m[0] * weights[0] + corners_m[1] * weights[1] + corners_m[2] * weights[2]
}

fn point_and_triangle(point_m: DVec3, triangle_m: [DVec3; 3]) -> Closest {
    Closest::new(point_m, at_weights(triangle_m, closest_weights(point_m, triangle_m)))
}

/// Share of the way from `from` to `to` at which the segment is closest to `point`.
fn closest_share(point: DVec3, from: DVec3, to: DVec3) -> f64 {
    let along = to - from;
    let length_squared = along.length_squared();
    if length_squared > 0.0 { ((point - from).dot(along) / length_squared).clamp(0.0, 1.0) } else { 0.0 }
}

/// Closest points of two segments, points included (Ericson, Real-Time Collision Detection, 2005, s. 5.1.9), with one
/// more projection each way for nearly parallel ones.
pub fn closest_on_segments([p, q]: [DVec3; 2], [u, v]: [DVec3; 2]) -> Closest {
    let (d, e, r) = (q - p, v - u, p - u);
    let (dd, ee, de) = (d.length_squared(), e.length_squared(), d.dot(e));
    let determinant = dd * ee - de * de;
    let s =
        if determinant > 0.0 { ((de * e.dot(r) - d.dot(r) * ee) / determinant).clamp(0.0, 1.0) } else { 0.0 };
    let t = closest_share(p + d * s, u, v);
    let second = u + e * t;
    let s = closest_share(second, p, q);
    let first = p + d * s;
    let t = closest_share(first, u, v);
    Closest::new(first, u + e * t)
}

/// The point of segment (u, v) in the plane of the triangle, if it crosses that plane.
fn crossing([u, v]: [DVec3; 2], [a, b, c]: [DVec3; 3]) -> Option<DVec3> {
    let normal = (b - a).cross(c - a);
    let (at_u, at_v) = (normal.dot(u - a), normal.dot(v - a));
    (at_u * at_v < 0.0).then(|| u + (v - u) * (at_u / (at_u - at_v)))
}

/// Closest points of a segment (first) and a triangle (second).
pub fn closest_on_segment_and_triangle(segment_m: [DVec3; 2], triangle_m: [DVec3; 3]) -> Closest {
    let mut best = point_and_triangle(segment_m[0], triangle_m);
    if segment_m[0] == segment_m[1] {
        return best;
    }
    best.keep_closer(point_and_triangle(segment_m[1], triangle_m));
    if let Some(point_m) = crossing(segment_m, triangle_m) {
        best.keep_closer(point_and_triangle(point_m, triangle_m));
    }
    for edge in edges(triangle_m) {
        best.keep_closer(closest_on_segments(segment_m, edge));
    }
    best
}

/// Closest points of two triangles.
pub fn closest_on_triangles(first_m: [DVec3; 3], second_m: [DVec3; 3]) -> Closest {
    let mut best = point_and_triangle(first_m[0], second_m);
    for corner in &first_m[1..] {
        best.keep_closer(point_and_triangle(*corner, second_m));
    }
    for corner in second_m {
        best.keep_closer(point_and_triangle(corner, first_m).swapped());
    }
    for edge in edges(first_m) {
        for other in edges(second_m) {
            best.keep_closer(closest_on_segments(edge, other));
        }
        if let Some(point_m) = crossing(edge, second_m) {
            best.keep_closer(point_and_triangle(point_m, second_m));
        }
    }
    for edge in edges(second_m) {
        if let Some(point_m) = crossing(edge, first_m) {
            best.keep_closer(point_and_triangle(point_m, first_m).swapped());
        }
    }
    best
}
