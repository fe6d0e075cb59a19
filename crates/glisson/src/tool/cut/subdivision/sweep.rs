//! What a blade sweeps over from one place to the next: one or two flat convex polygons.

use crate::math::DVec3;
use robust::{Coord3D, orient3d};

/// Corners that the clipping of a polygon of four corners by up to four planes can have.
const MAX_CORNERS: usize = 12;

/// Two corners closer than this share of the polygon's size are one.
const SAME_CORNER: f64 = 1e-6;

/// Out of plane by less than this share of its size, a swept quadrilateral is cut as a flat one.
const FLAT: f64 = 0.01;

/// Ends that move apart by less than this share of their way move alike.
const LEAST_TURN: f64 = 1e-3;

/// Distances from the plane in plain floating point are good to this share of the coordinates, also where the
/// polygon is thin ([`SAME_CORNER`]).
const PLAIN_ROUNDING: f64 = 1e-9;

/// What a side of a polygon is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Side {
    /// Along the blade where it was.
    Start,
    /// Along the blade where it is.
    Front,
    /// The way of one of its ends, or the middle of a sweep that is not flat.
    Way,
}

/// A flat convex polygon that the blade swept.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sweep {
    corners_m: [DVec3; 4],
    n_corners: usize,
    /// Three corners that span the plane: its exact definition.
    plane_m: [DVec3; 3],
    doubled_area_m2: f64,
    pub(super) normal: DVec3,
    /// Unit vectors in the plane, each at a right angle to the line from its corner to the next, inwards.
    inward: [DVec3; 4],
    sides: [Side; 4],
}

fn coord(p: DVec3) -> Coord3D<f64> {
    Coord3D { x: p.x, y: p.y, z: p.z }
}

impl Sweep {
    /// From corners in order, each with the side to the next one. `None` without area.
    fn polygon(corners: &[(DVec3, Side)]) -> Option<Self> {
        let size_m = corners.iter().map(|c| c.0.distance(corners[0].0)).fold(0.0, f64::max);
        let mut kept = [(DVec3::ZERO, Side::Way); 4];
        let mut n = 0;
        for (i, &(p, side)) in corners.iter().enumerate() {
            if p.distance(corners[(i + 1) % corners.len()].0) > SAME_CORNER * size_m {
                kept[n] = (p, side);
                n += 1;
            }
        }
        if n < 3 {
            return None;
        }
        let triples = [[0, 1, 2], [1, 2, 3], [2, 3, 0], [3, 0, 1]];
        let doubled = |[a, b, c]: [usize; 3]| (kept[b].0 - kept[a].0).cross(kept[c].0 - kept[a].0);
        let best = *triples[..if n == 3 { 1 } else { 4 }]
            .iter()
            .max_by(|a, b| doubled(**a).length().total_cmp(&doubled(**b).length()))?;
        let cross = doubled(best);
        let doubled_area_m2 = cross.length();
        if doubled_area_m2.is_nan() || doubled_area_m2 <= SAME_CORNER * size_m * size_m {
            return None;
        }
        let normal = cross / doubled_area_m2;
        let corners_m = kept.map(|c| c.0);
        let mut inward = [DVec3::ZERO; 4];
        for k in 0..n {
            inward[k] = normal.cross(corners_m[(k + 1) % n] - corners_m[k]).normalize_or_zero();
        }
        Some(Self {
            corners_m,
            n_corners: n,
            plane_m: best.map(|i| corners_m[i]),
            doubled_area_m2,
            normal,
            inward,
            sides: kept.map(|c| c.1),
        })
    }

    /// What the blade swept from `from_m` to `to_m` (tip, heel), in one or two polygons.
    pub(super) fn of_blade([a0, b0]: [DVec3; 2], [a1, b1]: [DVec3; 2]) -> [Option<Self>; 2] {
        use Side::{Front, Start, Way};
        let (da, db) = (a1 - a0, b1 - b0);
        // Ends that went to opposite sides: the sweep crosses itself where the blade stood still.
        let blade = (b0 - a0).normalize_or_zero();
        let turn = (da - db) - blade * (da - db).dot(blade);
        let (fa, fb) = (da.dot(turn), db.dot(turn));
        let is_turned = turn.length() > LEAST_TURN * da.length().max(db.length());
        if is_turned && fa > 0.0 && fb < 0.0 && fa.min(-fb) > LEAST_TURN * (fa - fb) {
            let s = fa / (fa - fb);
            let pivot = 0.5 * (a0.lerp(b0, s) + a1.lerp(b1, s));
            return [
                Self::polygon(&[(a0, Start), (pivot, Front), (a1, Way)]),
                Self::polygon(&[(b0, Way), (b1, Front), (pivot, Start)]),
            ];
        }
        let corners = [a0, b0, b1, a1];
        let cross = (b1 - a0).cross(a1 - b0);
        let normal = cross.normalize_or_zero();
        let center = 0.25 * (a0 + b0 + b1 + a1);
        let size_m = corners.iter().map(|c| c.distance(center)).fold(0.0, f64::max);
        let off_plane_m = (a0 - center).dot(normal).abs();
        let turns_in = |k: usize| {
            let (p, q, r) = (corners[(k + 3) % 4], corners[k], corners[(k + 1) % 4]);
            (q - p).cross(r - q).dot(normal) >= -1e-9 * size_m * size_m
        };
        if off_plane_m <= FLAT * size_m && (0..4).all(turns_in) {
            // Into the plane half way between the two diagonals.
            let [a0, b0, b1, a1] = corners.map(|c| c - normal * (c - center).dot(normal));
            let whole = Self::polygon(&[(a0, Start), (b0, Way), (b1, Front), (a1, Way)]);
            if whole.is_some() {
                return [whole, None];
            }
        }
        [
            Self::polygon(&[(a0, Start), (b0, Way), (b1, Way)]),
            Self::polygon(&[(a0, Way), (b1, Front), (a1, Way)]),
        ]
    }

    /// Signed distance [m] from the plane; its sign is exact.
    pub(super) fn distance_m(&self, p: DVec3) -> f64 {
        let [a, b, c] = self.plane_m;
        // Shewchuk's sign: positive below the plane.
        -orient3d(coord(a), coord(b), coord(c), coord(p)) / self.doubled_area_m2
    }

    pub(super) fn n_lines(&self) -> usize {
        self.n_corners
    }

    /// What line `k` is.
    pub(super) fn side(&self, k: usize) -> Side {
        self.sides[k]
    }

    /// Signed distance [m] from line `k`, positive on the polygon's side.
    pub(super) fn inside_m(&self, k: usize, p: DVec3) -> f64 {
        self.inward[k].dot(p - self.corners_m[k])
    }

    /// The point of line `k` next to a point of the plane.
    pub(super) fn onto_line_m(&self, k: usize, p: DVec3) -> DVec3 {
        p - self.inward[k] * self.inside_m(k, p)
    }

    /// Signed distance [m] of a point from line `k`, and by how much that grows along a vector.
    pub(super) fn towards_line(&self, k: usize, p: DVec3, way: DVec3) -> (f64, f64) {
        (self.inside_m(k, p), self.inward[k].dot(way))
    }

    /// How far along line `k` [m], and how long the line is [m].
    pub(super) fn along_m(&self, k: usize, p: DVec3) -> (f64, f64) {
        let next = self.corners_m[(k + 1) % self.n_corners];
        let length_m = next.distance(self.corners_m[k]);
        ((p - self.corners_m[k]).dot(next - self.corners_m[k]) / length_m, length_m)
    }

    /// Smallest and largest corner [m].
    pub(super) fn bounds_m(&self) -> [DVec3; 2] {
        let corners = &self.corners_m[..self.n_corners];
        corners.iter().fold([DVec3::INFINITY, DVec3::NEG_INFINITY], |[l, h], &c| [l.min(c), h.max(c)])
    }

    /// For each point, beyond which sides of the polygon's bounds and of its plane it is, a bit each. What has all
    /// of its points beyond one of them is apart from the polygon; `flat_m`: near the plane, and not beyond it.
    pub(super) fn outside_into(&self, points_m: &[DVec3], flat_m: f64, outside: &mut Vec<u8>) {
        let [low_m, high_m] = self.bounds_m();
        let origin_m = self.plane_m[0];
        // Rounding is far below; what is near goes to the exact predicate.
        let apart_m = flat_m + PLAIN_ROUNDING * (origin_m.length() + (high_m - low_m).length());
        outside.clear();
        outside.extend(points_m.iter().map(|&p| {
            let distance_m = self.normal.dot(p - origin_m);
            let mut bits = u8::from(distance_m > apart_m) | (u8::from(distance_m < -apart_m) << 1);
            for axis in 0..3 {
                bits |= u8::from(p[axis] < low_m[axis] - apart_m) << (2 + 2 * axis);
                bits |= u8::from(p[axis] > high_m[axis] + apart_m) << (3 + 2 * axis);
            }
            bits
        }));
    }

    /// Area [m2] of the polygon inside a tetrahedron of positive volume.
    pub(super) fn area_in_tet_m2(&self, tet_m: [DVec3; 4]) -> f64 {
        let mut shape = Polygon::new(&self.corners_m[..self.n_corners]);
        for [a, b, c] in crate::mesh::quality::FACES {
            let outward = (tet_m[b] - tet_m[a]).cross(tet_m[c] - tet_m[a]);
            shape.clip(|p| outward.dot(tet_m[a] - p));
            if shape.n < 3 {
                return 0.0;
            }
        }
        shape.area_m2(self.normal)
    }

    /// Area [m2] of a triangle, seen along the normal, and of its part inside the polygon.
    pub(super) fn triangle_areas_m2(&self, triangle_m: [DVec3; 3]) -> [f64; 2] {
        let mut shape = Polygon::new(&triangle_m);
        let whole = shape.area_m2(self.normal);
        for k in 0..self.n_corners {
            shape.clip(|p| self.inside_m(k, p));
            if shape.n < 3 {
                return [whole, 0.0];
            }
        }
        [whole, shape.area_m2(self.normal)]
    }

    /// Areas [m2] of the parts of a triangle, seen along the normal, inside the polygon, and inside or behind its start.
    pub(super) fn parts_m2(&self, triangle_m: [DVec3; 3]) -> [f64; 2] {
        let mut shape = Polygon::new(&triangle_m);
        for k in (0..self.n_corners).filter(|&k| self.sides[k] != Side::Start) {
            shape.clip(|p| self.inside_m(k, p));
            if shape.n < 3 {
                return [0.0; 2];
            }
        }
        let with_behind_m2 = shape.area_m2(self.normal);
        for k in (0..self.n_corners).filter(|&k| self.sides[k] == Side::Start) {
            shape.clip(|p| self.inside_m(k, p));
            if shape.n < 3 {
                return [0.0, with_behind_m2];
            }
        }
        [shape.area_m2(self.normal), with_behind_m2]
    }
}

/// A polygon while it is being clipped.
struct Polygon {
    corners_m: [DVec3; MAX_CORNERS],
    n: usize,
}

impl Polygon {
    fn new(corners_m: &[DVec3]) -> Self {
        let mut shape = Self { corners_m: [DVec3::ZERO; MAX_CORNERS], n: corners_m.len() };
        shape.corners_m[..corners_m.len()].copy_from_slice(corners_m);
        shape
    }

    /// Keeps where `inside` is not negative (Sutherland and Hodgman 1974, doi 10.1145/360767.360802).
    fn clip(&mut self, inside: impl Fn(DVec3) -> f64) {
        let mut out = [DVec3::ZERO; MAX_CORNERS];
        let mut n = 0;
        let mut push = |p: DVec3| {
            if n < MAX_CORNERS {
                out[n] = p;
                n += 1;
            }
        };
        for i in 0..self.n {
            let (p, q) = (self.corners_m[i], self.corners_m[(i + 1) % self.n]);
            let (dp, dq) = (inside(p), inside(q));
            if dp >= 0.0 {
                push(p);
            }
            if (dp >= 0.0) != (dq >= 0.0) {
                push(p.lerp(q, dp / (dp - dq)));
            }
        }
        self.corners_m = out;
        self.n = n;
    }

    fn area_m2(&self, normal: DVec3) -> f64 {
        let mut doubled = DVec3::ZERO;
        for i in 1..self.n.max(2) - 1 {
            let origin = self.corners_m[0];
            doubled += (self.corners_m[i] - origin).cross(self.corners_m[i + 1] - origin);
        }
        0.5 * doubled.dot(normal).abs()
    }
}
