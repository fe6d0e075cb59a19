//! Why no organ was found.

use crate::image::topology::TopologyError;
use crate::math::DVec3;

/// Why no organ was found.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SegmentError {
    /// The seed is not in the image.
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
    /// The seed lies in air, fat or bone.
    #[error(
        "at the seed {seed_mm:?} mm the image is {found_hu:.0} HU, soft tissue is -30 to 300 HU; set the seed inside the organ"
    )]
    SeedNotSoftTissue {
        /// The seed [mm].
        seed_mm: [f64; 3],
        /// Level around it [HU].
        found_hu: f64,
    },
    /// No candidate for an automatic seed.
    #[error(
        "no seed found: no parenchyma (40 to 200 HU) more than {depth_mm} mm thick on the patient's right; give the seed, and check that the image is a CT in Hounsfield units"
    )]
    NoSeed {
        /// Least half thickness asked for [mm].
        depth_mm: f64,
    },
    /// The region around the seed vanished.
    #[error(
        "nothing left around the seed {seed_mm:?} mm in the band {low_hu:.0} to {high_hu:.0} HU; set the seed deeper inside the organ"
    )]
    NothingFound {
        /// The seed [mm].
        seed_mm: [f64; 3],
        /// Band [HU].
        low_hu: f64,
        /// Band [HU].
        high_hu: f64,
    },
    /// A point inside the organ and one outside it are in one place.
    #[error(
        "seed {inside_mm:?} mm inside the organ and seed {outside_mm:?} mm outside it are closer than {least_mm} mm; move one of them"
    )]
    SeedsTooClose {
        /// The seed inside [mm].
        inside_mm: [f64; 3],
        /// The seed outside [mm].
        outside_mm: [f64; 3],
        /// Least distance [mm].
        least_mm: f64,
    },
    /// Tunnels could not be repaired.
    #[error(transparent)]
    Topology(#[from] TopologyError),
}

pub(in crate::image) fn to_mm(point_m: DVec3) -> [f64; 3] {
    (point_m * 1e3).to_array().map(|x| (x * 10.0).round() / 10.0)
}
