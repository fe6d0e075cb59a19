//! What an image is like around a point: level and noise, the level of fat.

use super::error::{SegmentError, to_mm};
use super::params::SegmentParams;
use crate::image::filter::{self, Connectivity};
use crate::image::{Volume, VoxelGrid};
use crate::math::DVec3;

/// CT number below which nothing is soft tissue and above which it is bone or metal [HU].
pub(in crate::image) const SOFT_TISSUE_HU: [f32; 2] = [-30.0, 300.0];
/// Where the CT number of fat is looked for [HU] (Hounsfield scale: -50 to -150).
pub(super) const FAT_HU: [f32; 2] = [-150.0, -50.0];
/// A normal distribution's standard deviation over its median absolute deviation.
const MAD_TO_DEVIATION: f64 = 1.4826;

/// Calls `visit` with every voxel whose centre is at most `radius_m` from `center_m`.
pub(super) fn for_each_in_ball(
    grid: &VoxelGrid,
    center_m: DVec3,
    radius_m: f64,
    mut visit: impl FnMut(usize),
) {
    let center = grid.voxel_at(center_m);
    let range = |axis: usize| {
        let reach = radius_m / grid.spacing_m[axis];
        // Saturating casts keep the range inside the image.
        (center[axis] - reach).ceil() as usize
            ..grid.dims[axis].min((center[axis] + reach).floor() as usize + 1)
    };
    for k in range(2) {
        for j in range(1) {
            for i in range(0) {
                let offset = (DVec3::new(i as f64, j as f64, k as f64) - center) * grid.spacing_m;
                if offset.length_squared() <= radius_m * radius_m {
                    visit(grid.index([i, j, k]));
                }
            }
        }
    }
}

/// The middle value (the higher of two); `None` of none. Reorders the values.
pub(in crate::image) fn median(values: &mut [f32]) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    let middle = values.len() / 2;
    Some(f64::from(*values.select_nth_unstable_by(middle, f32::total_cmp).1))
}

/// The standard deviation that a median absolute deviation of these values stands for; 0 of none.
pub(in crate::image) fn deviation_of(mut absolute_deviations: Vec<f32>) -> f64 {
    MAD_TO_DEVIATION * median(&mut absolute_deviations).unwrap_or(0.0)
}

/// Standard deviation of the noise of the raw image among the voxels `indices`; `smooth` is the image after a Gaussian of
/// `denoise_m`.
pub(in crate::image) fn noise(
    ct: &Volume<f32>,
    smooth: &[f32],
    indices: impl Iterator<Item = usize>,
    denoise_m: f64,
) -> f64 {
    let residual = indices.map(|index| (ct.values[index] - smooth[index]).abs()).collect();
    // What the smoothing keeps of the noise is missing in the residual.
    deviation_of(residual) / filter::gaussian_noise_gain(&ct.grid, denoise_m).residual
}

/// What the image is like in a region [HU].
#[derive(Clone, Copy, Debug)]
pub(super) struct Statistics {
    /// Median of the smoothed image.
    pub(super) level_hu: f64,
    /// Standard deviation of the noise of the raw image.
    pub(super) noise_hu: f64,
}

impl Statistics {
    /// Of the voxels `indices`, of which there must be one.
    pub(super) fn of(ct: &Volume<f32>, smooth: &[f32], indices: &[usize], params: &SegmentParams) -> Self {
        let mut level: Vec<f32> = indices.iter().map(|&index| smooth[index]).collect();
        let level_hu = median(&mut level).expect("a region has a voxel");
        Self { level_hu, noise_hu: noise(ct, smooth, indices.iter().copied(), params.denoise_m) }
    }

    pub(super) fn band_hu(self, params: &SegmentParams) -> [f64; 2] {
        let [least, most] = params.band_limits_hu;
        let half_width = (params.band_width * self.noise_hu).clamp(least, most);
        [self.level_hu - half_width, self.level_hu + half_width]
    }
}

/// Statistics around the seed, which must be in soft tissue.
pub(super) fn statistics_at_seed(
    ct: &Volume<f32>,
    smooth: &[f32],
    seed_m: DVec3,
    params: &SegmentParams,
) -> Result<Statistics, SegmentError> {
    let around = voxels_at_seed(&ct.grid, seed_m, params.statistics_radius_m)?;
    let statistics = Statistics::of(ct, smooth, &around, params);
    check_soft_tissue(statistics.level_hu, seed_m)?;
    Ok(statistics)
}

/// Refuses a seed that is not on the image.
pub(in crate::image) fn check_on_image(grid: &VoxelGrid, seed_m: DVec3) -> Result<(), SegmentError> {
    let voxel = grid.voxel_at(seed_m);
    if (0..3).all(|a| voxel[a] >= -0.5 && voxel[a] < grid.dims[a] as f64 - 0.5) {
        return Ok(());
    }
    let bounds = grid.bounds_m();
    Err(SegmentError::SeedOutside {
        seed_mm: to_mm(seed_m),
        min_mm: to_mm(bounds.min_m),
        max_mm: to_mm(bounds.max_m),
    })
}

/// A radius [m] with which a ball around any point on the image holds a voxel's centre, however coarse the image.
pub(in crate::image) fn at_least_a_voxel(grid: &VoxelGrid, radius_m: f64) -> f64 {
    radius_m.max(0.5 * grid.spacing_m.length() * (1.0 + 1e-9))
}

/// The voxels of a ball around a seed, of which there is one at least.
pub(in crate::image) fn voxels_at_seed(
    grid: &VoxelGrid,
    seed_m: DVec3,
    radius_m: f64,
) -> Result<Vec<usize>, SegmentError> {
    check_on_image(grid, seed_m)?;
    let mut around = Vec::new();
    for_each_in_ball(grid, seed_m, at_least_a_voxel(grid, radius_m), |index| around.push(index));
    Ok(around)
}

/// Refuses a seed around which the level is not that of soft tissue.
pub(in crate::image) fn check_soft_tissue(level_hu: f64, seed_m: DVec3) -> Result<(), SegmentError> {
    if (f64::from(SOFT_TISSUE_HU[0])..=f64::from(SOFT_TISSUE_HU[1])).contains(&level_hu) {
        return Ok(());
    }
    Err(SegmentError::SeedNotSoftTissue { seed_mm: to_mm(seed_m), found_hu: level_hu })
}

/// The most frequent level in a range, in bins of `bin_hu`; `None` when no value lies in it.
pub(super) fn most_frequent(
    values: impl Iterator<Item = f32>,
    range_hu: [f32; 2],
    bin_hu: f32,
) -> Option<f32> {
    let n_bins = ((range_hu[1] - range_hu[0]) / bin_hu) as usize;
    let mut counts = vec![0usize; n_bins];
    for value in values.filter(|v| (range_hu[0]..range_hu[1]).contains(v)) {
        counts[(((value - range_hu[0]) / bin_hu) as usize).min(n_bins - 1)] += 1;
    }
    let best = (0..n_bins).fold(0, |best, bin| if counts[bin] > counts[best] { bin } else { best });
    (counts[best] > 0).then(|| range_hu[0] + (best as f32 + 0.5) * bin_hu)
}

/// Level of fat in the image; -100 HU where it shows none.
pub(in crate::image) fn fat_level(smooth: &[f32]) -> f32 {
    most_frequent(smooth.iter().copied(), FAT_HU, 5.0).unwrap_or(-100.0)
}

/// The piece of `mask` that the voxel nearest to `seed_m` belongs to, if one lies within `reach_m`.
pub(super) fn piece_near(grid: &VoxelGrid, mask: &[bool], seed_m: DVec3, reach_m: f64) -> Option<Vec<bool>> {
    let mut nearest: Option<(f64, usize)> = None;
    for_each_in_ball(grid, seed_m, reach_m.max(grid.spacing_m.length()), |index| {
        let distance = grid.center_m(index).distance_squared(seed_m);
        if mask[index] && nearest.is_none_or(|(d, _)| distance < d) {
            nearest = Some((distance, index));
        }
    });
    let found = filter::components(grid, mask, Connectivity::Faces);
    let number = found.piece[nearest?.1];
    Some(found.piece.iter().map(|&p| p == number).collect())
}
