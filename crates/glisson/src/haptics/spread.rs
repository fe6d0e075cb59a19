//! How fast what the hand feels may change when another model comes.

/// Time [s] over which a change is spread at least: a requirement.
pub const SPREAD_S: f64 = 0.02;
/// Fastest change of force [N/s] that no motion explains: 0.04 N in a millisecond. The requirement is 0.05; the rest is left
/// to motion of the surface and rounding.
pub const MOST_RATE_N_PER_S: f64 = 40.0;
