//! How an organ is looked for, and what is found.

use crate::image::topology::TopologyRepair;
use crate::math::DVec3;

/// How a segmentation is made. Lengths in metres.
#[derive(Clone, Debug, PartialEq)]
pub struct SegmentParams {
    /// A point inside the organ [m], LPS; `None` takes [`guess_seed`].
    pub seed_m: Option<DVec3>,
    /// Standard deviation of the Gaussian that denoises.
    pub denoise_m: f64,
    /// Radius around the seed in which level and noise are measured.
    pub statistics_radius_m: f64,
    /// Half width of the band in noise deviations.
    pub band_width: f64,
    /// Smallest and largest half width of the band [HU]: the first keeps a noiseless image segmentable, the
    /// second keeps the band on one tissue in a very noisy one.
    pub band_limits_hu: [f64; 2],
    /// Radius of the ball that cuts bridges to other organs.
    pub cut_radius_m: f64,
    /// Radius of the ball that closes vessels and lesions.
    pub close_radius_m: f64,
    /// How far the region grows into the slope towards fat.
    pub slope_depth_m: f64,
    /// Radius of the last opening and closing.
    pub smooth_radius_m: f64,
}

impl Default for SegmentParams {
    fn default() -> Self {
        Self {
            seed_m: None,
            denoise_m: 1.5e-3,
            statistics_radius_m: 6e-3,
            band_width: 1.25,
            band_limits_hu: [12.0, 40.0],
            cut_radius_m: 3e-3,
            close_radius_m: 8e-3,
            slope_depth_m: 3.5e-3,
            smooth_radius_m: 3e-3,
        }
    }
}

/// An organ found in an image.
#[derive(Clone, Debug, PartialEq)]
pub struct Segmentation {
    /// For each voxel whether it belongs to the organ.
    pub mask: Vec<bool>,
    /// The seed that was used [m], LPS.
    pub seed_m: DVec3,
    /// Level of the organ around the seed [HU].
    pub level_hu: f64,
    /// Standard deviation of the noise around the seed [HU].
    pub noise_hu: f64,
    /// The band: smallest and largest CT number [HU].
    pub band_hu: [f64; 2],
    /// What the last step changed to make the organ one ball.
    pub repair: TopologyRepair,
}
