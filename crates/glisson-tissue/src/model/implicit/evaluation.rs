//! What the elements are evaluated with, and the result.

use fearless_simd::Level;

use super::lanes::Shape;
use crate::workers::Workers;

/// What laws compute with: the tetrahedra at rest, this step's share of the elastic stress, and threads.
#[derive(Clone, Copy)]
pub(super) struct On<'a> {
    pub(super) level: Level,
    pub(super) shape: &'a Shape,
    pub(super) factor: f64,
    pub(super) workers: &'a dyn Workers,
}

/// The result of one evaluation besides the forces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Evaluation {
    /// Energy [J]; meaningless unless `is_upright`.
    pub(super) energy_j: f64,
    /// Whether the law allows every F.
    pub(super) is_upright: bool,
    /// Whether a tetrahedron is inverted under a law that allows it.
    pub(super) has_inverted: bool,
}

impl Evaluation {
    /// Whether the law allows every F and the energy is finite.
    pub(super) fn is_usable(&self) -> bool {
        self.is_upright && self.energy_j.is_finite()
    }
}
