//! Volume that two tetrahedra share: one is clipped by the faces of the other.

use crate::math::{Aabb, DVec3, tetrahedron_volume_m3};

/// Nearer to a face than this share of the tetrahedron's size is on it: neighbours share no slivers.
const ON_FACE: f64 = 1e-10;

/// A half-space: `normal . x >= offset`, with a unit normal.
type HalfSpace = (DVec3, f64);

/// The corners of a tetrahedron.
#[derive(Clone)]
pub(super) struct Corners {
    corners_m: [DVec3; 4],
    /// The same by axis: all four are compared with a plane at once.
    by_axis_m: [[f64; 4]; 3],
}

impl Corners {
    /// In any order.
    pub(super) fn new(corners_m: [DVec3; 4]) -> Self {
        Self { corners_m, by_axis_m: [0, 1, 2].map(|axis| corners_m.map(|p| p[axis])) }
    }

    /// Their mean [m].
    pub(super) fn center_m(&self) -> DVec3 {
        0.25 * self.corners_m.into_iter().sum::<DVec3>()
    }

    /// The volume between them [m3].
    pub(super) fn volume_m3(&self) -> f64 {
        tetrahedron_volume_m3(self.corners_m).abs()
    }

    /// The box around them.
    pub(super) fn bounds(&self) -> Aabb {
        Aabb::of_points(&self.corners_m)
    }
}

/// How a tetrahedron lies to another one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Relation {
    /// They share no volume.
    Apart,
    /// It is inside the other one.
    Within,
    /// Neither is certain.
    Unsure,
}

/// A tetrahedron, ready to be compared with many others.
pub(super) struct Tet {
    corners: Corners,
    inside: [HalfSpace; 4],
    on_face_m: f64,
}

impl Tet {
    /// With these corners.
    pub(super) fn new(corners: Corners) -> Self {
        let [a, b, c, d] = corners.corners_m;
        let (ab, ac, ad) = (b - a, c - a, d - a);
        let orientation = if ab.dot(ac.cross(ad)) < 0.0 { -1.0 } else { 1.0 };
        // The normals point inwards where the orientation is positive.
        let half_space = |normal: DVec3, p: DVec3| {
            let normal = (normal * orientation).normalize_or_zero();
            (normal, normal.dot(p))
        };
        let of_a = half_space((d - b).cross(c - b), b);
        let [of_b, of_c, of_d] =
            [ac.cross(ad), ad.cross(ab), ab.cross(ac)].map(|normal| half_space(normal, a));
        let on_face_m = ON_FACE * corners.bounds().size_m().length();
        Self { corners, inside: [of_a, of_b, of_c, of_d], on_face_m }
    }

    /// The face, named by the corner opposite, that a point is farthest beyond; `None` for a point inside.
    pub(super) fn face_towards(&self, point_m: DVec3) -> Option<usize> {
        let mut farthest = (-self.on_face_m, None);
        for (face, &(normal, offset)) in self.inside.iter().enumerate() {
            let height_m = normal.dot(point_m) - offset;
            if height_m < farthest.0 {
                farthest = (height_m, Some(face));
            }
        }
        farthest.1
    }

    /// How another one lies to this one, as far as the faces of this one tell.
    pub(super) fn relation(&self, Corners { by_axis_m: [x, y, z], .. }: &Corners) -> Relation {
        let mut is_within = true;
        for &(normal, offset) in &self.inside {
            let (mut n_out, mut n_beyond) = (0, 0);
            for v in 0..4 {
                let height_m = normal.x * x[v] + normal.y * y[v] + normal.z * z[v] - offset;
                n_out += u32::from(height_m <= self.on_face_m);
                n_beyond += u32::from(height_m < -self.on_face_m);
            }
            if n_out == 4 {
                return Relation::Apart;
            }
            is_within &= n_beyond == 0;
        }
        if is_within { Relation::Within } else { Relation::Unsure }
    }

    /// Volume [m3] that this one has in common with another.
    pub(super) fn shared_volume_m3(&self, other: &Self) -> f64 {
        let is_apart = other.relation(&self.corners) == Relation::Apart
            || self.relation(&other.corners) == Relation::Apart;
        if is_apart {
            return 0.0;
        }
        // A face that this one lies within cuts off nothing of its parts either.
        let (mut cutting, mut n) = ([(DVec3::ZERO, 0.0); 4], 0);
        for half_space in other.inside {
            let is_beyond = |p: &DVec3| half_space.0.dot(*p) - half_space.1 < -other.on_face_m;
            if self.corners.corners_m.iter().any(is_beyond) {
                cutting[n] = half_space;
                n += 1;
            }
        }
        clipped_volume_m3(self.corners.corners_m, &cutting[..n], other.on_face_m)
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
        let [a, b] = [a_m, b_m].map(|corners_m| Tet::new(Corners::new(corners_m)));
        let are_near = are_near(&a.corners.bounds(), &b.corners.bounds());
        let shared_m3 = a.shared_volume_m3(&b);
        assert!(are_near || shared_m3 == 0.0);
        shared_m3
    }

    #[test]
    fn a_part_is_within_the_whole_and_apart_from_the_other_parts() {
        let mut random = SeededRandom::new(4);
        for _ in 0..50 {
            let mut point = || DVec3::new(random.uniform(), random.uniform(), random.uniform());
            let whole = [point(), point(), point(), point()];
            let share = random.uniform();
            let middle = whole[0].lerp(whole[1], share);
            let parts = [[middle, whole[1], whole[2], whole[3]], [whole[0], middle, whole[2], whole[3]]];
            let relation =
                |of: [DVec3; 4], to: [DVec3; 4]| Tet::new(Corners::new(to)).relation(&Corners::new(of));
            for part in parts {
                assert_eq!(relation(part, whole), Relation::Within);
                assert_eq!(relation(whole, part), Relation::Unsure);
                // A corner that is moved out.
                let mut larger = part;
                larger[2] += whole[2] - 0.5 * (whole[0] + whole[3]);
                assert_ne!(relation(larger, whole), Relation::Within);
            }
            assert_eq!([relation(parts[0], parts[1]), relation(parts[1], parts[0])], [Relation::Apart; 2]);
        }
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
