//! What a suture is made from.

use crate::math::DVec3;
use crate::suture::RodMaterial;

/// Threads of a world at most.
pub const MOST_SUTURES: usize = 4;

/// A thread, with a needle at its first end or without.
#[derive(Clone, Debug, PartialEq)]
pub struct SutureSpec {
    /// What the user calls it.
    pub name: String,
    /// Where it lies at the start, a path of straight pieces from its first end [m]. Where that runs in tissue at rest, the thread
    /// passes through it.
    pub path_m: Vec<DVec3>,
    /// Radius of the thread [m].
    pub radius_m: f64,
    /// Wanted length of its segments [m].
    pub spacing_m: f64,
    /// What it is made of.
    pub thread: RodMaterial,
    /// The needle at its first end.
    pub needle: Option<Needle>,
    /// Coulomb's coefficient between thread and tissue.
    pub friction_coefficient: f64,
    /// Clips on it at the start: places along it from the first end, one of a strand or two of strands that it holds together [m].
    pub clips_m: Vec<[f64; 2]>,
}

/// A straight needle, as the first piece of the thread.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Needle {
    /// Length [m].
    pub length_m: f64,
    /// What it is made of.
    pub material: RodMaterial,
    /// Force on its tip at which it goes into tissue [N].
    pub puncture_force_n: f64,
}

/// Why a suture cannot be laid.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SutureError {
    /// Too many segments.
    #[error("a thread of {n_segments} segments; allowed: 2 to {most}; make \"segment\" longer")]
    Segments {
        /// How many.
        n_segments: usize,
        /// Most.
        most: usize,
    },
    /// It lies in itself.
    #[error(
        "the path comes within {least_mm:.2} mm of itself at {at_mm:?} mm along it; a thread of this size needs more than {needed_mm:.2} mm"
    )]
    MeetsItself {
        /// Distance [mm].
        least_mm: f64,
        /// Where [mm].
        at_mm: [f64; 2],
        /// Least [mm].
        needed_mm: f64,
    },
    /// Too many places in tissue.
    #[error(
        "the path runs through {length_mm:.0} mm of tissue, with {n} places that hold it, every 4 mm and two a stitch; allowed: {most}"
    )]
    TooLongInTissue {
        /// How much [mm].
        length_mm: f64,
        /// Places.
        n: usize,
        /// Most of them.
        most: usize,
    },
    /// Too many clips.
    #[error("{n} clips on a thread; allowed: {most}")]
    Clips {
        /// How many.
        n: usize,
        /// Most.
        most: usize,
    },
    /// A clip beyond the thread.
    #[error("a clip at {at_mm:.1} mm of a thread of {length_mm:.1} mm")]
    Clip {
        /// Where [mm].
        at_mm: f64,
        /// Length of the thread [mm].
        length_mm: f64,
    },
}
