//! First contact of moving bodies within a step, which cannot be missed.
//!
//! Conservative advancement (Mirtich 1996, "Impulse-based dynamic simulation of rigid body systems", PhD thesis,
//! University of California, Berkeley) with the bound along the present direction. At time t the closest points of
//! two convex bodies are d apart, along the unit vector n from the second to the first. Their points move on straight
//! lines, x + t v and y + t w, so for every later time t' and every pair of points
//! n . (x - y)(t') >= d - (t' - t) m, with m = max over corners of n . w - min over corners of n . v.
//! The distance is at least as large: before t + (d - r) / m nothing comes closer than r, and if m <= 0, nothing ever.
//!
//! What is promised: if the bodies come within `reach` (radius plus the error of the path) of each other at any time of
//! the step, a contact is returned, and not later than that time. The contact that is returned may be early by at most
//! [`CONTACT_TOLERANCE_M`] of distance; `gap_m` tells. Rounding moves distances of bodies of a metre by less than
//! 1e-8 m, which is far within the tolerance.

use super::shapes::CapsuleMotion;
use super::triangles::{
    Closest, closest_on_segment_and_triangle, closest_on_segments, closest_on_triangles, closest_weights,
};
use crate::math::DVec3;

/// Distance at which bodies count as touching [m]: far above rounding, far below any tissue's geometry.
pub const CONTACT_TOLERANCE_M: f64 = 1e-6;

/// Advances at most. After them the bodies are taken to touch where they then are: early, never too late. None of the
/// 20,000 motions of `validate detection` needs so many.
const MOST_ADVANCES: usize = 200;

/// When and where two bodies touch first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FirstContact {
    /// Share of the step, 0 to 1; 0 when they overlapped at its start.
    pub time: f64,
    /// Closest points at that time [m]: of the first body (of a capsule: of its axis) and of the second.
    pub points_m: [DVec3; 2],
    /// Unit vector from the second body to the first; zero when they have a point in common.
    pub normal: DVec3,
    /// Distance of the bodies [m], capsules with their radius: zero up to the tolerance after a clean approach, negative
    /// when they overlapped at the start.
    pub gap_m: f64,
}

/// First time up to `latest` at which the closest points are no more than `reach_m` apart.
fn first_contact(
    closest_at: impl Fn(f64) -> Closest,
    moves_m: &[DVec3],
    other_moves_m: &[DVec3],
    reach_m: f64,
    latest: f64,
) -> Option<FirstContact> {
    let mut time = 0.0;
    for advances in 0.. {
        let closest = closest_at(time);
        let gap_m = closest.distance_m - reach_m;
        let apart = closest.first_m - closest.second_m;
        let normal = apart.normalize_or_zero();
        // Not finite: nothing can be said, and nothing is touched.
        if !gap_m.is_finite() {
            return None;
        }
        if gap_m <= CONTACT_TOLERANCE_M || advances == MOST_ADVANCES {
            return Some(FirstContact { time, points_m: [closest.first_m, closest.second_m], normal, gap_m });
        }
        let fastest = other_moves_m.iter().fold(f64::NEG_INFINITY, |m, w| m.max(normal.dot(*w)));
        let slowest = moves_m.iter().fold(f64::INFINITY, |m, v| m.min(normal.dot(*v)));
        let approach_m = fastest - slowest;
        // Half of the tolerance is kept, so that every advance is worth something.
        let free_m = gap_m - 0.5 * CONTACT_TOLERANCE_M;
        let left_m = approach_m * (latest - time);
        // Also when the approach is no number.
        let meets = left_m >= free_m;
        if !meets {
            return None;
        }
        time += free_m / approach_m;
    }
    None
}

/// First contact, up to the time `latest`, of a moving capsule (first) and a triangle (second) whose corners move on
/// straight lines from `start_m` to `end_m`.
pub fn capsule_and_triangle(
    capsule: &CapsuleMotion,
    start_m: [DVec3; 3],
    end_m: [DVec3; 3],
    latest: f64,
) -> Option<FirstContact> {
    let closest_at = |time: f64| {
        let now = capsule.at(time);
        closest_on_segment_and_triangle([now.from_m, now.to_m], corners_at(start_m, end_m, time))
    };
    let moves = [0, 1, 2].map(|v| end_m[v] - start_m[v]);
    let reach_m = capsule.radius_m + capsule.path_error_m;
    first_contact(closest_at, &capsule.moves_m(), &moves, reach_m, latest)
}

/// First contact, up to the time `latest`, of two moving capsules; the points are on their axes. The gap counts the errors of their
/// paths as if the capsules were thicker by them.
pub fn two_capsules(first: &CapsuleMotion, second: &CapsuleMotion, latest: f64) -> Option<FirstContact> {
    let axis_at = |motion: &CapsuleMotion, time: f64| {
        let now = motion.at(time);
        [now.from_m, now.to_m]
    };
    let closest_at = |time: f64| closest_on_segments(axis_at(first, time), axis_at(second, time));
    let path_error_m = first.path_error_m + second.path_error_m;
    let reach_m = first.radius_m + second.radius_m + path_error_m;
    first_contact(closest_at, &first.moves_m(), &second.moves_m(), reach_m, latest)
}

/// First contact, up to the time `latest`, of two triangles whose corners move on straight lines, grown together by
/// `reach_m` (a margin, errors of paths). Corners are given at the start and at the end.
pub fn two_triangles(
    first_m: [[DVec3; 3]; 2],
    second_m: [[DVec3; 3]; 2],
    reach_m: f64,
    latest: f64,
) -> Option<FirstContact> {
    let moves = |[start, end]: [[DVec3; 3]; 2]| [0, 1, 2].map(|v| end[v] - start[v]);
    let at = |[start, end]: [[DVec3; 3]; 2], time: f64| corners_at(start, end, time);
    let closest_at = |time: f64| closest_on_triangles(at(first_m, time), at(second_m, time));
    first_contact(closest_at, &moves(first_m), &moves(second_m), reach_m, latest)
}

/// Corners at a time of the step.
pub fn corners_at(start_m: [DVec3; 3], end_m: [DVec3; 3], time: f64) -> [DVec3; 3] {
    [0, 1, 2].map(|v| start_m[v].lerp(end_m[v], time))
}

/// Barycentric weights of a touched point in its triangle at the time of the contact.
pub fn weights_at(contact: &FirstContact, start_m: [DVec3; 3], end_m: [DVec3; 3]) -> [f64; 3] {
    let corners = corners_at(start_m, end_m, contact.time);
    closest_weights(contact.points_m[1], corners)
}
