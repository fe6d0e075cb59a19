//! The steps that ways of finding an organ share.

use super::error::{SegmentError, to_mm};
use super::params::SegmentParams;
use super::statistics::{SOFT_TISSUE_HU, Statistics, fat_level, piece_near, statistics_at_seed};
use crate::image::filter;
use crate::image::resample::VoxelBox;
use crate::image::{Volume, VoxelGrid};
use crate::math::DVec3;

/// How often level and noise are measured again in the piece that the last ones found.
const N_REFINEMENTS: usize = 2;

/// An image, and the same with little noise.
pub(super) struct Denoised<'a> {
    /// The image as it is [HU].
    pub(super) ct: &'a Volume<f32>,
    /// The image after a Gaussian [HU].
    pub(super) smooth: Vec<f32>,
}

impl<'a> Denoised<'a> {
    pub(super) fn of(ct: &'a Volume<f32>, params: &SegmentParams) -> Self {
        Self { ct, smooth: filter::gaussian(&ct.grid, &ct.values, params.denoise_m) }
    }
}

/// The thick part of what looks like the tissue at a seed and hangs together with it.
pub(super) struct Core {
    /// Voxels whose level is in the band.
    pub(super) band: Vec<bool>,
    /// Of these the piece at the seed that is left after erosion.
    pub(super) core: Vec<bool>,
    /// What the tissue is like.
    pub(super) statistics: Statistics,
}

/// The core around a seed; `reach_m` keeps it within a ball around the seed and to the tissue right there,
/// without it level, noise and band are measured again in what is found.
pub(super) fn core_at(
    image: &Denoised,
    seed_m: DVec3,
    reach_m: Option<f64>,
    params: &SegmentParams,
) -> Result<Core, SegmentError> {
    let whole = &image.ct.grid;
    let mut statistics = statistics_at_seed(image.ct, &image.smooth, seed_m, params)?;
    // All that the erosion sees of a band within reach.
    let part = match reach_m {
        Some(reach_m) => VoxelBox::around_ball(whole, seed_m, reach_m + 2.0 * params.cut_radius_m),
        None => VoxelBox::whole(whole),
    };
    let grid = &part.grid(whole);
    let smooth = &part.cut(whole, &image.smooth);
    let n_refinements = if reach_m.is_some() { 0 } else { N_REFINEMENTS };
    let mut round = 0;
    loop {
        let band_hu = statistics.band_hu(params);
        let mut band = in_band(smooth, band_hu);
        if let Some(reach_m) = reach_m {
            retain(&mut band, |index| grid.center_m(index).distance_squared(seed_m) < reach_m * reach_m);
        }
        let cut = filter::erode(grid, &band, params.cut_radius_m);
        let core = piece_near(grid, &cut, seed_m, params.statistics_radius_m).ok_or_else(|| {
            SegmentError::NothingFound { seed_mm: to_mm(seed_m), low_hu: band_hu[0], high_hu: band_hu[1] }
        })?;
        if round == n_refinements {
            let in_whole = |inside: &[bool]| {
                let mut mask = vec![false; whole.n_voxels()];
                part.paste(whole, inside, &mut mask);
                mask
            };
            return Ok(Core { band: in_whole(&band), core: in_whole(&core), statistics });
        }
        let inside: Vec<usize> =
            (0..core.len()).filter(|&i| core[i]).map(|i| part.index_in(whole, i)).collect();
        statistics = Statistics::of(image.ct, &image.smooth, &inside, params);
        round += 1;
    }
}

/// For each voxel whether its level is in the band.
pub(super) fn in_band(values: &[f32], band_hu: [f64; 2]) -> Vec<bool> {
    values.iter().map(|&v| (band_hu[0]..=band_hu[1]).contains(&f64::from(v))).collect()
}

/// Takes away from `mask` what is not to be kept.
pub(super) fn retain(mask: &mut [bool], keep: impl Fn(usize) -> bool) {
    for (index, inside) in mask.iter_mut().enumerate() {
        *inside &= keep(index);
    }
}

/// Voxels nearer to the organ's level than to fat, and no bone or metal.
pub(super) fn not_fat(smooth: &[f32], level_hu: f64) -> Vec<bool> {
    let border_hu = 0.5 * (level_hu as f32 + fat_level(smooth));
    smooth.iter().map(|&v| v > border_hu && v < SOFT_TISSUE_HU[1]).collect()
}

/// Adds vessels and lesions that reach the surface, as far as `allowed`, and cavities.
pub(in crate::image) fn fill_vessels(
    grid: &VoxelGrid,
    region: &mut [bool],
    allowed: &[bool],
    close_radius_m: f64,
) {
    let closed = filter::close(grid, region, close_radius_m);
    for (index, inside) in region.iter_mut().enumerate() {
        *inside |= closed[index] && allowed[index];
    }
    filter::fill_cavities(grid, region);
}

/// The region after opening and closing by a ball, without what is neither `allowed` nor in the region.
pub(in crate::image) fn smoothed(
    grid: &VoxelGrid,
    region: &[bool],
    allowed: &[bool],
    radius_m: f64,
) -> Vec<bool> {
    let opened = filter::open(grid, region, radius_m);
    let mut smoothed = filter::close(grid, &opened, radius_m);
    retain(&mut smoothed, |index| allowed[index] || region[index]);
    smoothed
}

/// Adds to `region` the voxels of `not_fat` within the slope's depth, unless a thick piece of other soft
/// tissue is nearer. The slopes around other organs are thin and so do not count as such.
pub(super) fn grow_into_slope(
    grid: &VoxelGrid,
    region: &mut [bool],
    not_fat: &[bool],
    params: &SegmentParams,
) {
    let other: Vec<bool> = region.iter().zip(not_fat).map(|(&inside, &soft)| soft && !inside).collect();
    let other = filter::open(grid, &other, params.slope_depth_m);
    let to_other = filter::distance_squared_m2(grid, &other);
    let to_region = filter::distance_squared_m2(grid, region);
    let depth2 = (params.slope_depth_m * params.slope_depth_m) as f32;
    for (index, inside) in region.iter_mut().enumerate() {
        *inside |= not_fat[index] && to_region[index] <= depth2 && to_region[index] < to_other[index];
    }
}
