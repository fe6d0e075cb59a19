//! Positions as whole numbers of a step.

use glisson::math::DVec3;

/// A place in whole steps.
pub type Place = [i32; 3];

/// The nearest place; none for what is no number or too far away.
pub fn place_of(point_m: DVec3, step_m: f64) -> Option<Place> {
    let steps = (point_m / step_m).round();
    // Differences of two, and of such differences, are still numbers of 32 bits.
    const FURTHEST: f64 = (1 << 28) as f64;
    (steps.is_finite() && steps.abs().max_element() < FURTHEST).then(|| steps.to_array().map(|x| x as i32))
}
