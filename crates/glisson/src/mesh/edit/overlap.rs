//! Volume that two tetrahedra share: one is clipped by the faces of the other.

use crate::math::{Aabb, DVec3, tetrahedron_volume_m3};

/// Nearer to a face than this share of the tetrahedron's size is on it: neighbours share no slivers.
const ON_FACE: f64 = 1e-10;

/// A half-space: `normal . x >= offset`, with a unit normal.
type HalfSpace = (DVec3, f64);

/// A tetrahedron, ready to be compared with many others.
pub(super) struct Tet {
    corners_m: [DVec3; 4],
    /// The same by axis: all four are compared with a plane at once.
    by_axis_m: [[f64; 4]; 3],
    inside: [HalfSpace; 4],
    on_face_m: f64,
}

impl Tet {
    /// Whatever the order of the corners; with its bounds.
    pub(super) fn new(corners_m: [DVec3; 4]) -> (Self, Aabb) {
        let [a, b, c, d] = corners_m;
        let inside = [[b, c, d, a], [a, c, d, b], [a, b, d, c], [a, b, c, d]].map(|[p, q, r, opposite]| {
            let normal = (q - p).cross(r - p).normalize_or_zero();
            let normal = if normal.dot(opposite - p) < 0.0 { -normal } else { normal };
            (normal, normal.dot(p))
        });
        let bounds = Aabb::of_points(&corners_m);
        let by_axis_m = [0, 1, 2].map(|axis| corners_m.map(|p| p[axis]));
        (Self { corners_m, by_axis_m, on_face_m: ON_FACE * bounds.size_m().length(), inside }, bounds)
    }

    fn is_beyond_a_face(&self, [x, y, z]: &[[f64; 4]; 3]) -> bool {
        for &(normal, offset) in &self.inside {
            let mut n_out = 0;
            for v in 0..4 {
                let height_m = normal.x * x[v] + normal.y * y[v] + normal.z * z[v] - offset;
                n_out += u32::from(height_m <= self.on_face_m);
            }
            if n_out == 4 {
                return true;
            }
        }
        false
    }

    /// Volume [m3] that this one has in common with another, whose bounds it meets.
    pub(super) fn shared_volume_m3(&self, other: &Self) -> f64 {
        if other.is_beyond_a_face(&self.by_axis_m) || self.is_beyond_a_face(&other.by_axis_m) {
            return 0.0;
        }
        clipped_volume_m3(self.corners_m, &other.inside, other.on_face_m)
    }
}

/// Whether two boxes have a point in common.
pub(super) fn are_near(a: &Aabb, b: &Aabb) -> bool {
    let [low, high] = [a.min_m.max(b.min_m), a.max_m.min(b.max_m)];
    (low.x <= high.x) & (low.y <= high.y) & (low.z <= high.z)
}

/// Volume [m3] of the part of a tetrahedron inside all half-spaces: each cuts it into at most three.
fn clipped_volume_m3(corners_m: [DVec3; 4], half_spaces: &[HalfSpace], on_face_m: f64) -> f64 {
    let Some((&(normal, offset), rest)) = half_spaces.split_first() else {
        return tetrahedron_volume_m3(corners_m).abs();
    };
    let heights = corners_m.map(|p| normal.dot(p) - offset);
    if heights.iter().all(|&h| h >= -on_face_m) {
        return clipped_volume_m3(corners_m, rest, on_face_m);
    }
    // Those inside first.
    let mut order = [0; 4];
    let mut n_inside = 0;
    for at in 0..4 {
        if heights[at] > on_face_m {
            order[n_inside] = at;
            n_inside += 1;
        }
    }
    let mut n = n_inside;
    for at in 0..4 {
        if heights[at] <= on_face_m {
            order[n] = at;
            n += 1;
        }
    }
    let [a, b, c, _] = order.map(|i| corners_m[i]);
    let cut = |i: usize, j: usize| {
        let (inside, outside) = (order[i], order[j]);
        let share = heights[inside] / (heights[inside] - heights[outside].min(0.0));
        corners_m[inside].lerp(corners_m[outside], share)
    };
    let prism = |low, high| prism_volume_m3(low, high, rest, on_face_m);
    match n_inside {
        0 => 0.0,
        1 => clipped_volume_m3([a, cut(0, 1), cut(0, 2), cut(0, 3)], rest, on_face_m),
        2 => prism([a, cut(0, 2), cut(0, 3)], [b, cut(1, 2), cut(1, 3)]),
        _ => prism([a, b, c], [cut(0, 3), cut(1, 3), cut(2, 3)]),
    }
}

/// Volume [m3] of the part of a prism with corners `low`, `high` (matching) inside all half-spaces.
fn prism_volume_m3(low: [DVec3; 3], high: [DVec3; 3], half_spaces: &[HalfSpace], on_face_m: f64) -> f64 {
    [
        [low[0], low[1], low[2], high[2]],
        [low[0], low[1], high[1], high[2]],
        [low[0], high[0], high[1], high[2]],
    ]
    .into_iter()
    .map(|part| clipped_volume_m3(part, half_spaces, on_face_m))
    .sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::SeededRandom;

    fn shared_volume_m3(a_m: [DVec3; 4], b_m: [DVec3; 4]) -> f64 {
        let [(a, a_bounds), (b, b_bounds)] = [a_m, b_m].map(Tet::new);
        if are_near(&a_bounds, &b_bounds) { a.shared_volume_m3(&b) } else { 0.0 }
    }

    #[test]
    fn shared_volumes_are_right() {
        let unit = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
        assert!((shared_volume_m3(unit, unit) - 1.0 / 6.0).abs() < 1e-15);
        let away = unit.map(|p| p + DVec3::X);
        assert_eq!(shared_volume_m3(unit, away), 0.0);
        // Shifted along x by 1/2: the common part is the tetrahedron of half the size.
        let shifted = unit.map(|p| p + 0.5 * DVec3::X);
        assert!((shared_volume_m3(unit, shifted) - 1.0 / 48.0).abs() < 1e-15);
        // The twelve parts of a tetrahedron around an inner point of another division add up.
        let mut random = SeededRandom::new(3);
        for _ in 0..20 {
            let mut point = || DVec3::new(random.uniform(), random.uniform(), random.uniform());
            let whole = [point(), point(), point(), point()];
            let other = [point(), point(), point(), point()];
            let inner = 0.1 * other[0] + 0.2 * other[1] + 0.3 * other[2] + 0.4 * other[3];
            let parts: f64 = (0..4)
                .map(|at| {
                    let mut part = other;
                    part[at] = inner;
                    shared_volume_m3(whole, part)
                })
                .sum();
            let expected = shared_volume_m3(other, whole);
            assert!((parts - expected).abs() < 1e-14, "{parts} {expected}");
        }
    }
}
