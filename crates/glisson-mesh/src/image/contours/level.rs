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

use super::error::ContourError;
use super::params::ContourParams;
use crate::image::{Volume, VoxelGrid, filter};
use crate::math::DVec3;

/// CT number below which nothing is soft tissue and above which it is bone or metal [HU].
const SOFT_TISSUE_HU: [f64; 2] = [-30.0, 300.0];
/// Where the CT number of fat is looked for [HU] (Hounsfield scale: -50 to -150).
const FAT_HU: [f32; 2] = [-150.0, -50.0];
/// Where the image shows no fat [HU].
const USUAL_FAT_HU: f64 = -100.0;
/// How often the level is measured again among the voxels near the last one.
const N_REFINEMENTS: usize = 4;
/// A normal distribution's standard deviation over its median absolute deviation.
const MAD_TO_DEVIATION: f64 = 1.4826;

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
    ) -> Result<Self, ContourError> {
        let grid = &ct.grid;
        // At least the seed's own voxel, however coarse the image.
        let radius_m = params.statistics_radius_m.max(0.5 * grid.spacing_m.length() * (1.0 + 1e-9));
        let around = in_ball(grid, seed_m, radius_m);
        let mut level: Vec<f32> = around.iter().map(|&v| smooth[v]).collect();
        let level_hu = median(&mut level).filter(|_| is_inside(grid, seed_m)).ok_or_else(|| {
            let bounds = grid.bounds_m();
            ContourError::SeedOutside {
                seed_mm: to_mm(seed_m),
                min_mm: to_mm(bounds.min_m),
                max_mm: to_mm(bounds.max_m),
            }
        })?;
        if !(SOFT_TISSUE_HU[0]..=SOFT_TISSUE_HU[1]).contains(&level_hu) {
            return Err(ContourError::SeedNotSoftTissue { seed_mm: to_mm(seed_m), found_hu: level_hu });
        }
        // A vessel beside the seed would draw the level: of a larger ball only what is near the last level counts.
        let mut level_hu = level_hu;
        let wide = in_ball(grid, seed_m, 2.0 * radius_m);
        for _ in 0..N_REFINEMENTS {
            let is_near = |v: &f32| f64::from((v - level_hu as f32).abs()) <= params.band_limits_hu[1];
            level = wide.iter().map(|&v| smooth[v]).filter(is_near).collect();
            level_hu = median(&mut level).unwrap_or(level_hu);
        }
        let mut spread: Vec<f32> = level.iter().map(|v| (v - level_hu as f32).abs()).collect();
        let deviation_hu = MAD_TO_DEVIATION * median(&mut spread).unwrap_or(0.0);
        let mut residual: Vec<f32> = around.iter().map(|&v| (ct.values[v] - smooth[v]).abs()).collect();
        // What the smoothing keeps of the noise is missing in the residual.
        let gain = filter::gaussian_noise_gain(grid, params.denoise_m);
        let noise_hu = MAD_TO_DEVIATION * median(&mut residual).unwrap_or(0.0) / gain.residual;
        let half_width =
            (params.band_width * deviation_hu).clamp(params.band_limits_hu[0], params.band_limits_hu[1]);
        Ok(Self {
            level_hu,
            noise_hu,
            band_hu: [level_hu - half_width, level_hu + half_width],
            fat_hu: fat_level(smooth),
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
        value > 0.5 * (self.level_hu + self.fat_hu) && value < SOFT_TISSUE_HU[1]
    }

    /// The window that is stretched: from fat to as far above the level.
    pub fn window_hu(&self) -> [f64; 2] {
        [self.fat_hu, 2.0 * self.level_hu - self.fat_hu]
    }

    /// CT numbers to contrast: -1 at the lower end of the window and below, 0 at the level, 1 at the upper end.
    pub fn enhanced(&self, values_hu: &[f32]) -> Vec<f32> {
        let (level, per_hu) = (self.level_hu as f32, (1.0 / (self.level_hu - self.fat_hu)) as f32);
        values_hu.par_iter().map(|v| ((v - level) * per_hu).clamp(-1.0, 1.0)).collect()
    }
}

pub(super) fn to_mm(point_m: DVec3) -> [f64; 3] {
    (point_m * 1e3).to_array().map(|x| (x * 10.0).round() / 10.0)
}

/// Whether a point is on the image.
pub(super) fn is_inside(grid: &VoxelGrid, point_m: DVec3) -> bool {
    let voxel = grid.voxel_at(point_m);
    (0..3).all(|a| voxel[a] >= -0.5 && voxel[a] < grid.dims[a] as f64 - 0.5)
}

/// The middle value (the higher of two); `None` of none. Reorders the values.
pub(super) fn median(values: &mut [f32]) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    let middle = values.len() / 2;
    Some(f64::from(*values.select_nth_unstable_by(middle, f32::total_cmp).1))
}

/// Voxels whose centre is at most `radius_m` from `center_m`.
fn in_ball(grid: &VoxelGrid, center_m: DVec3, radius_m: f64) -> Vec<usize> {
    let center = grid.voxel_at(center_m);
    let range = |axis: usize| {
        let reach = radius_m / grid.spacing_m[axis];
        // Saturating casts keep the range inside the image.
        (center[axis] - reach).ceil() as usize
            ..grid.dims[axis].min((center[axis] + reach).floor() as usize + 1)
    };
    let mut found = Vec::new();
    for k in range(2) {
        for j in range(1) {
            for i in range(0) {
                let offset = (DVec3::new(i as f64, j as f64, k as f64) - center) * grid.spacing_m;
                if offset.length_squared() <= radius_m * radius_m {
                    found.push(grid.index([i, j, k]));
                }
            }
        }
    }
    found
}

/// The most frequent level in the range of fat.
fn fat_level(smooth: &[f32]) -> f64 {
    const BIN_HU: f32 = 5.0;
    let mut counts = [0usize; ((FAT_HU[1] - FAT_HU[0]) / BIN_HU) as usize];
    for value in smooth.iter().filter(|v| (FAT_HU[0]..FAT_HU[1]).contains(v)) {
        counts[(((value - FAT_HU[0]) / BIN_HU) as usize).min(counts.len() - 1)] += 1;
    }
    let best = (0..counts.len()).fold(0, |best, bin| if counts[bin] > counts[best] { bin } else { best });
    match counts[best] {
        0 => USUAL_FAT_HU,
        _ => f64::from(FAT_HU[0] + (best as f32 + 0.5) * BIN_HU),
    }
}
