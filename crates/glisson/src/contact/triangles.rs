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

/// Whether two triangles have a point in common; touching counts, and the answer is exact for the given
/// coordinates. False when a coordinate is not finite.
pub fn triangles_meet(p: [DVec3; 3], q: [DVec3; 3]) -> bool {
    let origin = p[0];
    let (a, b) = (p.map(|x| x - origin), q.map(|x| x - origin));
    let extent = a[1].abs().max(a[2].abs()).max(b[0].abs()).max(b[1].abs()).max(b[2].abs());
    let size = extent.max_element();
    let bound = ROUNDING_OF_DETERMINANTS * size * size * size;
    let normal_p = a[1].cross(a[2]);
    let q_above_p = b.map(|x| normal_p.dot(x));
    if on_one_side(q_above_p, bound) {
        return false;
    }
    let normal_q = (b[1] - b[0]).cross(b[2] - b[0]);
    let p_above_q = a.map(|x| normal_q.dot(x - b[0]));
    if on_one_side(p_above_q, bound) {
        return false;
    }
    let line = normal_p.cross(normal_q);
    let lines_are_sure =
        line.length_squared() > SURE * SURE * normal_p.length_squared() * normal_q.length_squared();
    if lines_are_sure
        && let Some(along_p) = piece_of_line(&a, p_above_q, line, bound)
        && let Some(along_q) = piece_of_line(&b, q_above_p, line, bound)
    {
        let common = along_p[1].min(along_q[1]) - along_p[0].max(along_q[0]);
        if common.abs() > UNSURE_SHARE * line.abs().dot(extent) {
            return common > 0.0;
        }
    }
    for (normal, corners) in [(normal_p, &a), (normal_q, &b)] {
        for e in 0..3 {
            let axis = normal.cross(corners[(e + 1) % 3] - corners[e]);
            if separates(axis, &a, &b, extent) {
                return false;
            }
        }
    }
    meet_exactly(p, q)
}

/// Bound of the rounding of `normal . x` for coordinates up to 1, relative to their cube: products of a normal (up to 8)
/// and a difference (up to 2), each rounded a few times, are off by less than 240 times 2^-52.
pub(super) const ROUNDING_OF_DETERMINANTS: f64 = 512.0 * f64::EPSILON;

/// Share of rounding up to which a quotient or a direction counts as sure.
pub(super) const SURE: f64 = 1e-6;

/// Share of the way along a line up to which two of its pieces may or may not overlap.
pub(super) const UNSURE_SHARE: f64 = 100.0 * SURE;

#[inline]
fn on_one_side([x, y, z]: [f64; 3], bound: f64) -> bool {
    x.min(y).min(z) > bound || x.max(y).max(z) < -bound
}

/// The piece of the line of both planes that lies in a triangle, as places along `line` (Moller 1997, "A fast
/// triangle-triangle intersection test", J. Graphics Tools 2(2)). `above` are its corners' distances from the other plane,
/// times any factor. `None` when rounding could be more than 1e-6 of it.
#[inline]
fn piece_of_line(corners: &[DVec3; 3], above: [f64; 3], line: DVec3, bound: f64) -> Option<[f64; 2]> {
    if above.iter().any(|d| d.abs() <= bound) {
        return None;
    }
    let is_above = above.map(|d| d > 0.0);
    let lone = if is_above[1] == is_above[2] {
        0
    } else if is_above[0] == is_above[2] {
        1
    } else {
        2
    };
    let place = |other: usize| {
        let height = above[lone] - above[other];
        let from = line.dot(corners[lone]);
        let to = line.dot(corners[other]);
        (height.abs() * SURE > bound).then(|| from + (to - from) * (above[lone] / height))
    };
    let (x, y) = (place((lone + 1) % 3)?, place((lone + 2) % 3)?);
    Some([x.min(y), x.max(y)])
}

/// Whether `axis` certainly separates the triangles. Any axis is right, however it was rounded; a product with a
/// difference of coordinates is off by at most 4 u |axis| . extent, u = 2^-53, the difference of two by twice that.
#[inline]
fn separates(axis: DVec3, a: &[DVec3; 3], b: &[DVec3; 3], extent: DVec3) -> bool {
    let (a, b) = (a.map(|x| axis.dot(x)), b.map(|x| axis.dot(x)));
    let bound = 16.0 * f64::EPSILON * axis.abs().dot(extent) + f64::MIN_POSITIVE;
    let low = |x: [f64; 3]| x[0].min(x[1]).min(x[2]);
    let high = |x: [f64; 3]| x[0].max(x[1]).max(x[2]);
    low(b) > high(a) + bound || low(a) > high(b) + bound
}

#[cold]
fn meet_exactly(a: [DVec3; 3], b: [DVec3; 3]) -> bool {
    let is_finite = |t: &[DVec3; 3]| t.iter().all(|x| x.is_finite());
    if !is_finite(&a) || !is_finite(&b) {
        return false;
    }
    match (is_flat(a), is_flat(b)) {
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
fn is_flat([a, b, c]: [DVec3; 3]) -> bool {
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
pub(super) const SLIVER: f64 = 1e-20;

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
