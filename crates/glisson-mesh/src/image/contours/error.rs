//! Why no organ was found by contours.

use crate::image::topology::TopologyError;

/// Why no organ was found by contours.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ContourError {
    /// A seed is not in the image.
    #[error(
        "seed {seed_mm:?} mm is outside the image, which covers {min_mm:?} to {max_mm:?} mm (LPS: +x left, +y posterior, +z superior)"
    )]
    SeedOutside {
        /// The seed [mm].
        seed_mm: [f64; 3],
        /// Smallest corner of the image [mm].
        min_mm: [f64; 3],
        /// Largest corner of the image [mm].
        max_mm: [f64; 3],
    },
    /// The first seed lies in air, fat or bone.
    #[error(
        "at the seed {seed_mm:?} mm the image is {found_hu:.0} HU, soft tissue is -30 to 300 HU; set the seed inside the organ"
    )]
    SeedNotSoftTissue {
        /// The seed [mm].
        seed_mm: [f64; 3],
        /// Level around it [HU].
        found_hu: f64,
    },
    /// No automatic seed.
    #[error("{reason}")]
    NoSeed {
        /// What was looked for.
        reason: String,
    },
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
