//! Why no organ was found by contours.

use crate::image::segment::SegmentError;
use crate::image::topology::TopologyError;

/// Why no organ was found by contours.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ContourError {
    /// A seed outside the image, the first one not in soft tissue, or no automatic seed.
    #[error(transparent)]
    Seed(#[from] SegmentError),
    /// A correction names a slice that the image does not have.
    #[error("a correction is for slice {slice}, the image has slices 0 to {last}")]
    CorrectionOutside {
        /// The slice of the correction.
        slice: usize,
        /// The last slice of the image.
        last: usize,
    },
    /// A correction has one or two points, or one that is no number.
    #[error(
        "the correction of slice {slice} has {n_points} points, {n_finite} of them finite; a contour has at least 3, all finite (0 points: the organ is not in the slice)"
    )]
    CorrectionNotAContour {
        /// The slice of the correction.
        slice: usize,
        /// Its points.
        n_points: usize,
        /// How many of them are finite.
        n_finite: usize,
    },
    /// No contour held around the seeds.
    #[error(
        "no contour of at least {least_area_mm2:.0} mm2 in the band {low_hu:.0} to {high_hu:.0} HU around the seed {seed_mm:?} mm; set the seed deeper inside the organ"
    )]
    NothingFound {
        /// The first seed [mm].
        seed_mm: [f64; 3],
        /// Band [HU].
        low_hu: f64,
        /// Band [HU].
        high_hu: f64,
        /// Least area of a contour [mm2].
        least_area_mm2: f64,
    },
    /// Tunnels could not be repaired.
    #[error(transparent)]
    Topology(#[from] TopologyError),
}
