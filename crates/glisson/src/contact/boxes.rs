//! Boxes around triangles, and what is asked about them.
//!
//! Boxes are kept in `f32`, rounded outwards by at least half a unit in the last place: the search for pairs is
//! bound by memory and by comparisons, and four `f32` are compared at once. A box so rounded holds its triangle
//! always, so nothing can be missed; it is at most 0.25 micrometres per metre of distance from the origin too large.

use crate::math::DVec3;
use glam::{Vec3, Vec4};

/// Larger numbers are no coordinates in metres: a box with one is treated as broken.
const LARGEST_COORDINATE_M: f32 = 1e30;

/// One unit in the last place of an `f32`, relative.
const ROUNDING: f32 = f32::EPSILON;

/// An axis-aligned box [m] in `f32`, rounded outwards.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RoundedBox {
    /// Smallest corner [m]; the fourth number is minus infinity.
    low_m: Vec4,
    /// Largest corner [m]; the fourth number is infinity.
    high_m: Vec4,
}

impl RoundedBox {
    /// The box that overlaps nothing: of a broken triangle, or of no point.
    pub const NOTHING: Self = Self { low_m: Vec4::INFINITY, high_m: Vec4::NEG_INFINITY };

    /// The box around the points between `low_m` and `high_m`, grown by `margin_m`; [`RoundedBox::NOTHING`]
    /// when a number is not finite.
    pub fn new(low_m: DVec3, high_m: DVec3, margin_m: f64) -> Self {
        Self::open(low_m, high_m, margin_m).checked()
    }

    /// Like `new`, but a number that is not finite makes the box reach to infinity.
    #[inline]
    fn open(low_m: DVec3, high_m: DVec3, margin_m: f64) -> Self {
        let low = outwards((low_m - margin_m).as_vec3().extend(f32::NEG_INFINITY), -1.0);
        let high = outwards((high_m + margin_m).as_vec3().extend(f32::INFINITY), 1.0);
        let is_fine = low.cmple(high).all();
        if is_fine {
            Self { low_m: low, high_m: high }
        } else {
            Self { low_m: Vec4::NEG_INFINITY, high_m: Vec4::INFINITY }
        }
    }

    /// This box, or [`RoundedBox::NOTHING`] if it is too large to be one.
    #[inline]
    fn checked(self) -> Self {
        const LARGEST_M: Vec4 =
            Vec4::new(LARGEST_COORDINATE_M, LARGEST_COORDINATE_M, LARGEST_COORDINATE_M, f32::INFINITY);
        let is_fine = (self.low_m.cmpge(-LARGEST_M) & self.high_m.cmple(LARGEST_M)).all();
        if is_fine { self } else { Self::NOTHING }
    }

    /// The box around a triangle, grown by `margin_m`.
    pub fn of_triangle(corners_m: [DVec3; 3], margin_m: f64) -> Self {
        Self::of_moving_triangle(corners_m, corners_m, margin_m)
    }

    /// The box around a triangle that moves on straight lines from `start_m` to `end_m`, grown by `margin_m`.
    pub fn of_moving_triangle(start_m: [DVec3; 3], end_m: [DVec3; 3], margin_m: f64) -> Self {
        Self::around([0, 1, 2].map(|v| Self::of_moving_vertex(start_m[v], end_m[v], margin_m)))
    }

    /// The box around a vertex that moves from `start_m` to `end_m`, to be put together by [`RoundedBox::around`]: it
    /// reaches to infinity for a vertex that is broken.
    #[inline]
    pub fn of_moving_vertex(start_m: DVec3, end_m: DVec3, margin_m: f64) -> Self {
        // `min` and `max` may drop a NaN; the sum keeps it.
        let broken = 0.0 * (start_m + end_m);
        Self::open(start_m.min(end_m) + broken, start_m.max(end_m) + broken, margin_m)
    }

    /// The box around a triangle whose corners have these boxes; [`RoundedBox::NOTHING`] if one is broken.
    #[inline]
    pub fn around([a, b, c]: [Self; 3]) -> Self {
        a.joined(&b).joined(&c).checked()
    }

    /// Whether the boxes have a point in common; touching counts.
    #[inline]
    pub fn overlaps(&self, other: &Self) -> bool {
        (self.low_m.cmple(other.high_m) & other.low_m.cmple(self.high_m)).all()
    }

    /// Smallest box that holds both.
    #[inline]
    pub fn joined(&self, other: &Self) -> Self {
        Self { low_m: self.low_m.min(other.low_m), high_m: self.high_m.max(other.high_m) }
    }

    /// Whether it is [`RoundedBox::NOTHING`].
    #[inline]
    pub fn is_nothing(&self) -> bool {
        self.low_m.x > self.high_m.x
    }

    /// Smallest corner [m].
    #[inline]
    pub fn low_m(&self) -> Vec3 {
        self.low_m.truncate()
    }

    /// Largest corner [m].
    #[inline]
    pub fn high_m(&self) -> Vec3 {
        self.high_m.truncate()
    }

    /// Smallest corner [m], and minus infinity.
    #[inline]
    pub(super) fn low4_m(self) -> Vec4 {
        self.low_m
    }

    /// Largest corner [m], and infinity; of nothing all numbers are the opposite.
    #[inline]
    pub(super) fn high4_m(self) -> Vec4 {
        self.high_m
    }

    /// Centre [m].
    #[inline]
    pub(super) fn center_m(&self) -> Vec3 {
        0.5 * (self.low_m + self.high_m).truncate()
    }

    /// Edge lengths [m].
    #[inline]
    pub(super) fn size_m(&self) -> Vec3 {
        (self.high_m - self.low_m).truncate()
    }
}

/// Writes the boxes of vertices that move from `start_m` to `end_m`, grown by `margin_m`.
pub(super) fn fill_vertex_boxes(start_m: &[DVec3], end_m: &[DVec3], margin_m: f64, boxes: &mut [RoundedBox]) {
    for (bounds, (start, end)) in boxes.iter_mut().zip(start_m.iter().zip(end_m)) {
        *bounds = RoundedBox::of_moving_vertex(*start, *end, margin_m);
    }
}

/// `x` moved by at least half a unit in the last place towards `direction`, more than the conversion from `f64`
/// was off.
fn outwards(x: Vec4, direction: f32) -> Vec4 {
    x + direction * (x.abs() * ROUNDING + f32::MIN_POSITIVE)
}

/// All points within a distance of a segment: where a capsule can be during a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThickSegment {
    /// One end [m].
    pub from_m: DVec3,
    /// The other end [m].
    pub to_m: DVec3,
    /// Distance [m].
    pub radius_m: f64,
}

impl ThickSegment {
    /// A box that holds it.
    pub fn bounds(&self) -> RoundedBox {
        RoundedBox::new(self.from_m.min(self.to_m), self.from_m.max(self.to_m), self.radius_m)
    }

    /// Whether it can have a point in common with `bounds`: never false when it has, sometimes true when it has
    /// not (near the edges of the box). Separating axes of a segment and a box grown by the radius
    /// (Ericson, Real-Time Collision Detection, 2005, s. 5.3.3).
    #[inline]
    pub fn may_touch(&self, bounds: &RoundedBox) -> bool {
        self.may_touch_between(bounds.low_m(), bounds.high_m())
    }

    /// [`ThickSegment::may_touch`] for the box between two corners.
    #[inline]
    pub(super) fn may_touch_between(&self, low_m: Vec3, high_m: Vec3) -> bool {
        let half = 0.5 * (high_m - low_m).as_dvec3();
        let center = low_m.as_dvec3() + half;
        let direction = 0.5 * (self.to_m - self.from_m);
        let middle = 0.5 * (self.from_m + self.to_m) - center;
        let reach = direction.abs();
        // A millionth more than the box: far above the rounding of these few operations.
        let grown = (half + self.radius_m) * (1.0 + 1e-6) + 1e-6 * reach;
        if !middle.abs().cmple(grown + reach).all() {
            return false;
        }
        let across = |i: usize, j: usize| {
            (middle[i] * direction[j] - middle[j] * direction[i]).abs()
                <= grown[i] * reach[j] + grown[j] * reach[i]
        };
        across(1, 2) && across(2, 0) && across(0, 1)
    }
}

/// Vertices that an `f32` counts exactly.
const MOST_VERTICES: u32 = 1 << 24;

/// Which pairs of triangles count: not of one triangle with itself, not of attached ones (a common vertex), and of
/// one body only if wanted.
#[derive(Clone, Debug)]
pub struct PairRules {
    /// Vertex indices, counted over all bodies.
    vertices: Vec<[u32; 3]>,
    /// The same as exact `f32`, which compare four at a time; the fourth is no number and equals nothing.
    vertices_f32: Vec<Vec4>,
    body_of: Vec<u32>,
    self_collision: bool,
}

impl PairRules {
    /// For `triangles`, whose vertices are counted over all bodies, of the bodies `body_of`.
    ///
    /// # Panics
    /// When the two lists differ in length, or an index is 2^24 or more.
    pub fn new(triangles: &[[u32; 3]], body_of: &[u32], self_collision: bool) -> Self {
        assert_eq!(triangles.len(), body_of.len(), "one body for each triangle");
        assert!(triangles.iter().flatten().all(|&v| v < MOST_VERTICES), "at most 2^24 vertices");
        let as_f32 = |t: &[u32; 3]| Vec4::new(t[0] as f32, t[1] as f32, t[2] as f32, f32::NAN);
        let vertices_f32 = triangles.iter().map(as_f32).collect();
        Self { vertices: triangles.to_vec(), vertices_f32, body_of: body_of.to_vec(), self_collision }
    }

    /// The rules of other things in place of triangles: each counts as the triangle here that stands for it.
    pub(super) fn of_triangles(&self, stand_for: impl Iterator<Item = u32>) -> Self {
        let (vertices, body_of): (Vec<_>, Vec<_>) =
            stand_for.map(|t| (self.vertices(t), self.body_of(t))).unzip();
        Self::new(&vertices, &body_of, self.self_collision)
    }

    /// Number of triangles.
    pub fn n_triangles(&self) -> usize {
        self.vertices.len()
    }

    /// Vertices of all triangles.
    pub(super) fn triangles(&self) -> &[[u32; 3]] {
        &self.vertices
    }

    /// Vertices of triangle `t`.
    #[inline]
    pub fn vertices(&self, t: u32) -> [u32; 3] {
        self.vertices[t as usize]
    }

    /// The body of triangle `t`.
    pub fn body_of(&self, t: u32) -> u32 {
        self.body_of[t as usize]
    }

    /// Vertices of triangle `t` in the form that [`PairRules::attached`] compares.
    #[inline]
    pub(super) fn vertices_f32(&self, t: u32) -> Vec4 {
        self.vertices_f32[t as usize]
    }

    /// Whether two triangles have a vertex in common.
    #[inline]
    pub(super) fn attached(one: Vec4, other: Vec4) -> bool {
        let same = Vec4::splat(one.x).cmpeq(other)
            | Vec4::splat(one.y).cmpeq(other)
            | Vec4::splat(one.z).cmpeq(other);
        same.any()
    }

    /// Whether the pair may count as far as the bodies go.
    #[inline]
    pub(super) fn bodies_allow(&self, s: u32, t: u32) -> bool {
        self.bodies_allow_with(s, self, t)
    }

    /// The same for `t` of other rules.
    #[inline]
    pub(super) fn bodies_allow_with(&self, s: u32, others: &Self, t: u32) -> bool {
        self.self_collision || self.body_of[s as usize] != others.body_of[t as usize]
    }

    /// Whether the pair counts.
    #[inline]
    pub fn allows(&self, s: u32, t: u32) -> bool {
        let attached = Self::attached(self.vertices_f32(s), self.vertices_f32(t));
        s != t && !attached && self.bodies_allow(s, t)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::SeededRandom;

    #[test]
    fn a_rounded_box_holds_its_triangle_and_is_hardly_larger() {
        let mut random = SeededRandom::new(1);
        for i in 0..1000 {
            let scale = libm::exp2(f64::from(i % 40) - 30.0);
            let mut point = || DVec3::new(random.normal(), random.normal(), random.normal()) * scale;
            let corners = [point(), point(), point()];
            let found = RoundedBox::of_triangle(corners, 0.0);
            for corner in corners {
                assert!(corner.cmpgt(found.low_m().as_dvec3()).all());
                assert!(corner.cmplt(found.high_m().as_dvec3()).all());
            }
            let exact = corners.iter().fold(DVec3::NEG_INFINITY, |a, c| a.max(*c));
            let extent = exact.abs().max_element();
            assert!((found.high_m().as_dvec3() - exact).max_element() <= 2.5e-7 * extent + 1e-37);
        }
    }

    #[test]
    fn a_broken_triangle_overlaps_nothing() {
        for bad in [f64::NAN, f64::INFINITY, 1e200] {
            for corner in 0..3 {
                let mut corners = [DVec3::ZERO, DVec3::X, DVec3::Y];
                corners[corner].y = bad;
                let broken = RoundedBox::of_triangle(corners, 1e-3);
                assert!(broken.is_nothing() && !broken.overlaps(&broken));
                let good = [DVec3::ZERO, DVec3::X, DVec3::Y];
                assert!(RoundedBox::of_moving_triangle(good, corners, 0.0).is_nothing());
                assert!(RoundedBox::of_moving_triangle(corners, good, 0.0).is_nothing());
            }
        }
    }

    #[test]
    fn a_thick_segment_that_touches_a_box_is_never_told_to_miss_it() {
        let mut random = SeededRandom::new(5);
        let (mut touching, mut told) = (0, 0);
        for _ in 0..20_000 {
            let mut point = |scale: f64| {
                DVec3::new(random.uniform() - 0.5, random.uniform() - 0.5, random.uniform() - 0.5) * scale
            };
            let (low, size) = (point(1.0), point(0.6).abs());
            let segment = ThickSegment { from_m: point(3.0), to_m: point(3.0), radius_m: 0.1 };
            let bounds = RoundedBox::new(low, low + size, 0.0);
            let touches = (0..=200).any(|i| {
                let p = segment.from_m.lerp(segment.to_m, f64::from(i) / 200.0);
                p.distance(p.clamp(low, low + size)) <= segment.radius_m
            });
            let may = segment.may_touch(&bounds);
            assert!(may || !touches);
            touching += usize::from(touches);
            told += usize::from(may);
        }
        assert!(touching > 500 && told < 2 * touching, "{touching} touch, {told} may");
    }
}
