//! Where a thread comes near to itself, and where a clip holds two of its places together.
//!
//! Two segments repel each other from a distance of two radii on, without limit towards one radius:
//!
//! b(d) = -k (d - D)^2 ln((d - r)/(D - r)),  D = 2 r
//!
//! (M. Li and others 2020, Incremental potential contact, doi 10.1145/3386569.3392425), and no step goes further than where any two
//! segments would be a tenth of what is left between them from that. So a thread never passes through itself.

use super::rod::{Rod, RodPlace};
use crate::contact::triangles::closest_on_segments;
use crate::math::DVec3;

/// k of the head of this file [N/m]: a choice, about what one newton presses two threads together by a few hundredths of a millimetre with.
const REPULSION_N_PER_M: f64 = 1e4;
/// Share of the distance that is left which a step may take: a choice.
const MAY_TAKE: f64 = 0.9;
/// Pairs of segments that are not neighbours along the thread and are looked at in a step, at most.
const MOST_PAIRS: usize = 512;

/// Room for the pairs of a thread of so many nodes: those of segments two and three apart are always looked at.
pub(super) fn room_for_pairs(n_nodes: usize) -> usize {
    2 * n_nodes + MOST_PAIRS
}

/// Two places of a thread that a clip holds together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bond {
    /// The places.
    pub at: [RodPlace; 2],
    /// Stiffness with which it holds them [N/m].
    pub stiffness_n_per_m: f64,
}

/// Two segments that may meet in a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pair(pub(super) [usize; 2]);

/// How two segments stand to each other.
pub(super) struct Nearness {
    pub(super) distance_m: f64,
    /// From the second to the first.
    pub(super) normal: DVec3,
    /// Share of the way of each segment.
    shares: [f64; 2],
    pub(super) at: [RodPlace; 2],
}

fn segment_m(positions_m: &[DVec3], segment: usize) -> [DVec3; 2] {
    [positions_m[segment], positions_m[segment + 1]]
}

fn share_of(point_m: DVec3, [from_m, to_m]: [DVec3; 2]) -> f64 {
    let along = to_m - from_m;
    if along.length_squared() > 0.0 { (point_m - from_m).dot(along) / along.length_squared() } else { 0.0 }
}

impl Pair {
    pub(super) fn nearness(self, positions_m: &[DVec3]) -> Nearness {
        let [first_m, second_m] = self.0.map(|segment| segment_m(positions_m, segment));
        let closest = closest_on_segments(first_m, second_m);
        let way_m = closest.first_m - closest.second_m;
        let share = |point_m, segment_m| share_of(point_m, segment_m).clamp(0.0, 1.0);
        let shares = [share(closest.first_m, first_m), share(closest.second_m, second_m)];
        let at = |i: usize| RodPlace::on_segment(positions_m.len(), self.0[i], shares[i]);
        Nearness { distance_m: way_m.length(), normal: way_m.normalize_or_zero(), shares, at: [at(0), at(1)] }
    }

    /// The share of a step that leaves the two apart by more than `least_m`.
    fn allowed(self, positions_m: &[DVec3], step_m: &[DVec3], least_m: f64) -> f64 {
        let left_m = self.nearness(positions_m).distance_m - least_m;
        let [first, second] = self.0.map(|segment| segment_m(step_m, segment));
        let fastest_m = first.iter().flat_map(|a| second.iter().map(move |b| (*a - *b).length()));
        let most_m = fastest_m.fold(0.0, f64::max);
        let may_m = MAY_TAKE * left_m.max(0.0);
        if most_m > may_m { may_m / most_m } else { 1.0 }
    }
}

/// Value, slope and curvature of the repulsion at a distance, for threads of a radius [J, N, N/m].
pub(super) fn repulsion(distance_m: f64, radius_m: f64) -> [f64; 3] {
    let (left, from) = (distance_m - radius_m, radius_m);
    if left >= from {
        return [0.0; 3];
    }
    if left <= 0.0 {
        return [f64::INFINITY, 0.0, 0.0];
    }
    let (gap, log) = (left - from, libm::log(left / from));
    let k = REPULSION_N_PER_M;
    let value = -k * gap * gap * log;
    let slope = -k * (2.0 * gap * log + gap * gap / left);
    let curvature = -k * (2.0 * log + 4.0 * gap / left - gap * gap / (left * left));
    [value, slope, curvature]
}

/// Finds the segments that may come within two radii of each other when no node moves by more than `most_m`.
pub(super) fn find_pairs(
    positions_m: &[DVec3],
    (radius_m, most_m): (f64, f64),
    bonds: &[Bond],
    found: &mut Vec<Pair>,
) {
    found.clear();
    let n = positions_m.len() - 1;
    let middle_m = |i: usize| (positions_m[i] + positions_m[i + 1]) * 0.5;
    let half_m = |i: usize| 0.5 * positions_m[i].distance(positions_m[i + 1]);
    for i in 0..n {
        let (at_m, reach_m) = (middle_m(i), half_m(i) + 2.0 * (radius_m + most_m));
        for j in i + 2..n {
            let away_m = reach_m + half_m(j);
            if at_m.distance_squared(middle_m(j)) > away_m * away_m || found.len() == found.capacity() {
                continue;
            }
            // What a clip holds together touches there.
            let is_held = |bond: &Bond| {
                bond.at[0].is_beside(i) && bond.at[1].is_beside(j)
                    || bond.at[1].is_beside(i) && bond.at[0].is_beside(j)
            };
            if !bonds.iter().any(is_held) {
                found.push(Pair([i, j]));
            }
        }
    }
}

/// Where a thread is nearest to itself, of segments that are not neighbours: how near, and the ways from its first end [m].
pub fn nearest_to_itself_m(rod: &Rod) -> Option<(f64, [f64; 2])> {
    let n = rod.n_nodes() - 1;
    let pairs = (0..n).flat_map(|i| (i + 2..n).map(move |j| Pair([i, j])));
    let near = pairs.map(|pair| (pair, pair.nearness(&rod.positions_m)));
    let (pair, nearest) = near.min_by(|a, b| a.1.distance_m.total_cmp(&b.1.distance_m))?;
    let along_m = [0, 1].map(|i| rod.spacing_m() * (pair.0[i] as f64 + nearest.shares[i]));
    Some((nearest.distance_m, along_m))
}

/// The share of a step that leaves all pairs apart.
pub(super) fn allowed_share(pairs: &[Pair], positions_m: &[DVec3], step_m: &[DVec3], radius_m: f64) -> f64 {
    pairs.iter().map(|pair| pair.allowed(positions_m, step_m, radius_m)).fold(1.0, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_repulsion_begins_without_a_jump_and_has_the_slopes_it_says() {
        let radius_m = 1e-4;
        assert_eq!(repulsion(2e-4, radius_m), [0.0; 3]);
        for share in [0.05, 0.3, 0.6, 0.95] {
            let at_m = radius_m * (1.0 + share);
            let step_m = 1e-9;
            let [_, slope, curvature] = repulsion(at_m, radius_m);
            let difference = |i: usize| {
                (repulsion(at_m + step_m, radius_m)[i] - repulsion(at_m - step_m, radius_m)[i])
                    / (2.0 * step_m)
            };
            assert!((difference(0) - slope).abs() < 1e-4 * slope.abs() && slope < 0.0, "{share}");
            assert!((difference(1) - curvature).abs() < 1e-4 * curvature && curvature > 0.0, "{share}");
        }
    }

    #[test]
    fn no_step_brings_segments_through_each_other() {
        let positions_m = [DVec3::ZERO, DVec3::X, DVec3::new(1.0, 1.0, 0.1), DVec3::new(0.5, -1.0, 0.1)];
        let step_m = [DVec3::ZERO, DVec3::ZERO, DVec3::NEG_Z, DVec3::NEG_Z];
        let pair = Pair([0, 2]);
        let share = allowed_share(&[pair], &positions_m, &step_m, 0.01);
        assert!(share > 0.05 && share < 0.09, "{share}");
        // Together they may go as far as they like.
        assert_eq!(allowed_share(&[pair], &positions_m, &[DVec3::NEG_Z; 4], 0.01), 1.0);
    }
}
