//! Branching vessel trees that fill a given region.
//!
//! The points to be supplied are halved along their widest direction again and again; each half gets a
//! branch towards its centroid. Radii follow Murray's law, r^3 = r_1^3 + r_2^3 (Murray 1926,
//! doi 10.1073/pnas.12.3.207), with the flow shared in proportion to the points supplied.

use super::shapes::Tube;
use crate::math::{Aabb, DVec3};

/// How a tree branches.
pub(super) struct Branching {
    /// Radius below which no further branch grows [m].
    pub(super) min_radius_m: f64,
    /// How far a branch goes of the way from its start to the centroid of what it supplies.
    pub(super) reach: f64,
}

/// Tubes of a tree that starts at `root_m` with `radius_m` and supplies `points_m`.
pub(super) fn grow_tree(
    root_m: DVec3,
    radius_m: f64,
    points_m: &mut [DVec3],
    branching: &Branching,
) -> Vec<Tube> {
    let mut tubes = Vec::new();
    grow(root_m, radius_m, points_m, branching, &mut tubes);
    tubes
}

fn grow(from_m: DVec3, radius_m: f64, points_m: &mut [DVec3], branching: &Branching, tubes: &mut Vec<Tube>) {
    if points_m.len() < 4 {
        return;
    }
    let size = Aabb::of_points(points_m).size_m();
    let axis = (0..3).fold(0, |best, a| if size[a] > size[best] { a } else { best });
    points_m.sort_by(|p, q| p[axis].total_cmp(&q[axis]));
    let n_all = points_m.len();
    let (low, high) = points_m.split_at_mut(n_all / 2);
    for half in [low, high] {
        let branch_radius_m = radius_m * libm::cbrt(half.len() as f64 / n_all as f64);
        if branch_radius_m < branching.min_radius_m {
            continue;
        }
        let centroid = half.iter().copied().sum::<DVec3>() / half.len() as f64;
        let to_m = from_m + branching.reach * (centroid - from_m);
        tubes.push(Tube {
            ends_m: [from_m, to_m],
            radii_m: [radius_m.min(1.3 * branch_radius_m), branch_radius_m],
        });
        grow(to_m, branch_radius_m, half, branching, tubes);
    }
}
