//! What is kept of a body for the time after an edit.

use super::attached::{Attached, Memory};
use glisson::math::DVec3;

/// What a check needs from before an edit.
pub(super) struct Before {
    pub(super) volume_m3: f64,
    pub(super) rest_m: Vec<DVec3>,
    /// Of a model that shows it.
    pub(super) memory: Option<Memory>,
    pub(super) attached: Attached,
    pub(super) mass_kg: f64,
}

/// How the volume may change.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Volume {
    /// Less by this [m3].
    Removed(f64),
    Kept,
    /// Less by what so many tetrahedra without descendants had; so many changes before took none.
    Taken {
        n_tets: usize,
        n_changes_before: usize,
    },
}

/// The last edit that stands, for taking it back later.
pub(super) struct LastEdit {
    pub(super) before: Before,
    /// Edits of the world that it is.
    pub(super) n_edits: usize,
}
