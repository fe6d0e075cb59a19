//! Volume that two tetrahedra share: one is clipped by the faces of the other.

use crate::math::{DVec3, tetrahedron_volume_m3};

/// A half-space: `normal . x >= offset`.
type HalfSpace = (DVec3, f64);

fn half_spaces([a, b, c, d]: [DVec3; 4]) -> [HalfSpace; 4] {
    [[b, c, d, a], [a, c, d, b], [a, b, d, c], [a, b, c, d]].map(|[p, q, r, opposite]| {
        let normal = (q - p).cross(r - p);
        let normal = if normal.dot(opposite - p) < 0.0 { -normal } else { normal };
        (normal, normal.dot(p))
    })
}

/// Volume [m3] of what `a_m` and `b_m` have in common, whatever the order of their corners.
pub(super) fn shared_volume_m3(a_m: [DVec3; 4], b_m: [DVec3; 4]) -> f64 {
    let half_spaces = half_spaces(b_m);
    if half_spaces.iter().any(|(normal, offset)| a_m.iter().all(|p| normal.dot(*p) <= *offset)) {
        return 0.0;
    }
    clipped_volume_m3(a_m, &half_spaces)
}

/// Volume [m3] of the part of a tetrahedron inside all half-spaces: each cuts it into at most three.
fn clipped_volume_m3(corners_m: [DVec3; 4], half_spaces: &[HalfSpace]) -> f64 {
    let Some((&(normal, offset), rest)) = half_spaces.split_first() else {
        return tetrahedron_volume_m3(corners_m).abs();
    };
    let heights = corners_m.map(|p| normal.dot(p) - offset);
    let mut order = [0, 1, 2, 3];
    order.sort_by(|&i, &j| heights[j].total_cmp(&heights[i]));
    let [a, b, c, d] = order.map(|i| corners_m[i]);
    let n_inside = heights.iter().filter(|h| **h > 0.0).count();
    let cut = |i: usize, j: usize| {
        let (inside, outside) = (order[i], order[j]);
        let share = heights[inside] / (heights[inside] - heights[outside]);
        corners_m[inside].lerp(corners_m[outside], share)
    };
    match n_inside {
        0 => 0.0,
        1 => clipped_volume_m3([a, cut(0, 1), cut(0, 2), cut(0, 3)], rest),
        2 => prism_volume_m3([a, cut(0, 2), cut(0, 3)], [b, cut(1, 2), cut(1, 3)], rest),
        3 => prism_volume_m3([a, b, c], [cut(0, 3), cut(1, 3), cut(2, 3)], rest),
        _ => clipped_volume_m3([a, b, c, d], rest),
    }
}

/// Volume [m3] of the part of a prism with corners `low`, `high` (matching) inside all half-spaces.
fn prism_volume_m3(low: [DVec3; 3], high: [DVec3; 3], half_spaces: &[HalfSpace]) -> f64 {
    [
        [low[0], low[1], low[2], high[2]],
        [low[0], low[1], high[1], high[2]],
        [low[0], high[0], high[1], high[2]],
    ]
    .into_iter()
    .map(|part| clipped_volume_m3(part, half_spaces))
    .sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::SeededRandom;

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
