//! What the organ looks like around the seed, and the contrast that shows it against its neighbours.
//!
//! - Level: median of the denoised image in a ball around the seed. Noise: 1.4826 times the median absolute
//!   difference of raw and denoised image there. Band: the level +- a few deviations of the denoised image, which hold noise
//!   and texture of the organ.
//! - Contrast: the window from the level of fat to as far above the organ's level is stretched to -1 to 1,
//!   linearly, and cut off at both ends. Air, lung, bone and metal lose their hold on the edges near
//!   them. The stretching is linear because equalising the histogram moves the steepest place of a blurred
//!   border towards the rarer tissue (Gonzalez and Woods, Digital Image Processing, 4th ed. 2018).

use rayon::prelude::*;

use super::params::ContourParams;
use crate::image::Volume;
use crate::image::segment::SegmentError;
use crate::image::segment::statistics::{
    SOFT_TISSUE_HU, at_least_a_voxel, check_soft_tissue, deviation_of, fat_level, median, noise,
    voxels_at_seed,
};
use crate::math::DVec3;

/// How often the level is measured again among the voxels near the last one.
const N_REFINEMENTS: usize = 4;

/// What the organ looks like [HU].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrganLevel {
    /// Median of the denoised image.
    pub level_hu: f64,
    /// Standard deviation of the noise of the raw image.
    pub noise_hu: f64,
    /// The band: smallest and largest CT number.
    pub band_hu: [f64; 2],
    /// Level of fat in the image.
    pub fat_hu: f64,
}

impl OrganLevel {
    /// Level around a seed, which must be in soft tissue. `smooth` is the denoised image.
    ///
    /// # Errors
    /// A seed outside the image or not in soft tissue.
    pub(super) fn around(
        ct: &Volume<f32>,
        smooth: &[f32],
        seed_m: DVec3,
        params: &ContourParams,
    ) -> Result<Self, SegmentError> {
        let grid = &ct.grid;
        let radius_m = at_least_a_voxel(grid, params.statistics_radius_m);
        let around = voxels_at_seed(grid, seed_m, radius_m)?;
        let mut level: Vec<f32> = around.iter().map(|&v| smooth[v]).collect();
        let mut level_hu = median(&mut level).expect("a ball has a voxel");
        check_soft_tissue(level_hu, seed_m)?;
        // A vessel beside the seed would draw the level: of a larger ball only what is near the last level counts.
        let wide = voxels_at_seed(grid, seed_m, 2.0 * radius_m)?;
        for _ in 0..N_REFINEMENTS {
            let is_near = |v: &f32| f64::from((v - level_hu as f32).abs()) <= params.band_limits_hu[1];
            level = wide.iter().map(|&v| smooth[v]).filter(is_near).collect();
            level_hu = median(&mut level).unwrap_or(level_hu);
        }
        let deviation_hu = deviation_of(level.iter().map(|v| (v - level_hu as f32).abs()).collect());
        let half_width =
            (params.band_width * deviation_hu).clamp(params.band_limits_hu[0], params.band_limits_hu[1]);
        Ok(Self {
            level_hu,
            noise_hu: noise(ct, smooth, around.into_iter(), params.denoise_m),
            band_hu: [level_hu - half_width, level_hu + half_width],
            fat_hu: f64::from(fat_level(smooth)),
        })
    }

    /// Half width of the band.
    pub(super) fn half_width_hu(&self) -> f64 {
        0.5 * (self.band_hu[1] - self.band_hu[0])
    }

    /// Whether a CT number is in the band.
    pub(super) fn holds(&self, value_hu: f32) -> bool {
        (self.band_hu[0]..=self.band_hu[1]).contains(&f64::from(value_hu))
    }

    /// Whether a CT number is soft tissue rather than fat or bone: above halfway between the organ and fat.
    pub(super) fn is_soft(&self, value_hu: f32) -> bool {
        let value = f64::from(value_hu);
        value > 0.5 * (self.level_hu + self.fat_hu) && value_hu < SOFT_TISSUE_HU[1]
    }

    /// CT numbers to contrast: -1 at the level of fat and below, 0 at the organ's level, 1 as far above it.
    pub fn enhanced(&self, values_hu: &[f32]) -> Vec<f32> {
        let (level, per_hu) = (self.level_hu as f32, (1.0 / (self.level_hu - self.fat_hu)) as f32);
        values_hu.par_iter().map(|v| ((v - level) * per_hu).clamp(-1.0, 1.0)).collect()
    }
}
