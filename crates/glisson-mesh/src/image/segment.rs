//! Finding an organ in a CT volume: denoise, intensity band around a seed, connected region, opening and
//! closing, holes filled, one piece.
//!
//! 1. The image is smoothed by a Gaussian: white noise falls below the contrast to the neighbours, and at
//!    a flat border between two tissues the level halfway between them stays where it was.
//! 2. The organ's level is the median of the smoothed image around the seed, its noise comes from the median
//!    absolute difference of raw and smoothed image there. The band is level +- 1.25 noise: wide against what the smoothing
//!    leaves of the noise, narrow against the contrast between neighbouring soft tissues.
//! 3. The band is eroded by a ball: organs that only a thin bridge or the partial-volume rim of another
//!    organ connects fall apart. Level, noise and band are measured again in the piece at the seed, twice,
//!    so that a vessel beside the seed does not matter; then the piece is grown back, within the band.
//! 4. Closing fills vessels and lesions that reach the surface, as far as they are soft tissue; cavities are
//!    filled.
//! 5. Against fat the band ends too deep inside, for it leaves out the whole slope of the border. What is
//!    nearer to the organ's level than to fat is added, up to a small depth, unless another thick piece
//!    of soft tissue is closer.
//! 6. A small opening and closing smooth the surface; cavities are filled; the largest piece stays; tunnels
//!    and contacts by an edge only are repaired, so that the organ is one ball.
//!
//! The steps are standard (Gonzalez and Woods, Digital Image Processing, 4th ed. 2018, chapters 9 and 10);
//! the statistics are taken from the image, the lengths below hold for abdominal organs.

use super::filter::{self, Connectivity};
use super::topology::{TopologyError, TopologyRepair, repair_to_ball};
use super::{Volume, VoxelGrid};
use crate::math::DVec3;

/// CT number below which nothing is soft tissue and above which it is bone or metal [HU].
const SOFT_TISSUE_HU: [f32; 2] = [-30.0, 300.0];
/// Where the CT number of fat is looked for [HU] (Hounsfield scale: -50 to -150).
const FAT_HU: [f32; 2] = [-150.0, -50.0];
/// CT numbers a contrast-enhanced parenchyma can have, for the automatic seed [HU].
const PARENCHYMA_HU: [f32; 2] = [40.0, 200.0];
/// How often level and noise are measured again in the piece that the last ones found.
const N_REFINEMENTS: usize = 2;
/// A normal distribution's standard deviation over its median absolute deviation.
const MAD_TO_DEVIATION: f64 = 1.4826;

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
    /// Tunnels could not be repaired.
    #[error(transparent)]
    Topology(#[from] TopologyError),
}

fn to_mm(point_m: DVec3) -> [f64; 3] {
    (point_m * 1e3).to_array().map(|x| (x * 10.0).round() / 10.0)
}

/// The organ around a seed (for the automatic seed: the liver).
///
/// # Errors
/// A seed outside the image or not in soft tissue; no seed found; nothing left at the seed.
pub fn segment(ct: &Volume<f32>, params: &SegmentParams) -> Result<Segmentation, SegmentError> {
    let grid = &ct.grid;
    let smooth = filter::gaussian(grid, &ct.values, params.denoise_m);
    let seed_m = match params.seed_m {
        Some(seed_m) => seed_m,
        None => guess_seed(grid, &smooth)?,
    };
    let mut statistics = statistics_at_seed(ct, &smooth, seed_m, params)?;
    let mut band = Vec::new();
    let mut core = Vec::new();
    for round in 0..=N_REFINEMENTS {
        let band_hu = statistics.band_hu(params);
        let nothing_found =
            || SegmentError::NothingFound { seed_mm: to_mm(seed_m), low_hu: band_hu[0], high_hu: band_hu[1] };
        band = in_band(&smooth, band_hu);
        let cut = filter::erode(grid, &band, params.cut_radius_m);
        core = piece_near(grid, &cut, seed_m, params.statistics_radius_m).ok_or_else(nothing_found)?;
        if round < N_REFINEMENTS {
            statistics = Statistics::of(ct, &smooth, (0..core.len()).filter(|&i| core[i]), params);
        }
    }
    let mut region = filter::dilate(grid, &core, params.cut_radius_m);
    retain(&mut region, |index| band[index]);

    let fat_hu = fat_level(&smooth);
    let border_hu = 0.5 * (statistics.level_hu as f32 + fat_hu);
    let not_fat: Vec<bool> = smooth.iter().map(|&v| v > border_hu && v < SOFT_TISSUE_HU[1]).collect();
    let closed = filter::close(grid, &region, params.close_radius_m);
    for (index, inside) in region.iter_mut().enumerate() {
        *inside |= closed[index] && not_fat[index];
    }
    filter::fill_cavities(grid, &mut region);
    grow_into_slope(grid, &mut region, &not_fat, params);

    let opened = filter::open(grid, &region, params.smooth_radius_m);
    let mut smoothed = filter::close(grid, &opened, params.smooth_radius_m);
    retain(&mut smoothed, |index| not_fat[index] || region[index]);
    let mut mask = filter::largest_piece(grid, &smoothed, Connectivity::Faces);
    let repair = repair_to_ball(grid, &mut mask)?;
    let Statistics { level_hu, noise_hu } = statistics;
    Ok(Segmentation { mask, seed_m, level_hu, noise_hu, band_hu: statistics.band_hu(params), repair })
}

/// The plain method to compare with: raw CT numbers in the band, of these the largest connected piece.
pub fn bare_band(ct: &Volume<f32>, band_hu: [f64; 2]) -> Vec<bool> {
    filter::largest_piece(&ct.grid, &in_band(&ct.values, band_hu), Connectivity::Faces)
}

fn in_band(values: &[f32], band_hu: [f64; 2]) -> Vec<bool> {
    values.iter().map(|&v| (band_hu[0]..=band_hu[1]).contains(&f64::from(v))).collect()
}

fn retain(mask: &mut [bool], keep: impl Fn(usize) -> bool) {
    for (index, inside) in mask.iter_mut().enumerate() {
        *inside &= keep(index);
    }
}

/// Adds to `region` the voxels of `not_fat` within the slope's depth, unless a thick piece of other soft
/// tissue is nearer. The slopes around other organs are thin and so do not count as such.
fn grow_into_slope(grid: &VoxelGrid, region: &mut [bool], not_fat: &[bool], params: &SegmentParams) {
    let other: Vec<bool> = region.iter().zip(not_fat).map(|(&inside, &soft)| soft && !inside).collect();
    let other = filter::open(grid, &other, params.slope_depth_m);
    let to_other = filter::distance_squared_m2(grid, &other);
    let to_region = filter::distance_squared_m2(grid, region);
    let depth2 = (params.slope_depth_m * params.slope_depth_m) as f32;
    for (index, inside) in region.iter_mut().enumerate() {
        *inside |= not_fat[index] && to_region[index] <= depth2 && to_region[index] < to_other[index];
    }
}

/// Calls `visit` with every voxel whose centre is at most `radius_m` from `center_m`.
fn for_each_in_ball(grid: &VoxelGrid, center_m: DVec3, radius_m: f64, mut visit: impl FnMut(usize)) {
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

fn median(values: &mut [f32]) -> f64 {
    let middle = values.len() / 2;
    f64::from(*values.select_nth_unstable_by(middle, f32::total_cmp).1)
}

/// What the image is like in a region [HU].
#[derive(Clone, Copy, Debug)]
struct Statistics {
    /// Median of the smoothed image.
    level_hu: f64,
    /// Standard deviation of the noise of the raw image.
    noise_hu: f64,
}

impl Statistics {
    /// Of the voxels `indices`, of which there must be one.
    fn of(
        ct: &Volume<f32>,
        smooth: &[f32],
        indices: impl Iterator<Item = usize>,
        params: &SegmentParams,
    ) -> Self {
        let (mut level, mut residual): (Vec<f32>, Vec<f32>) =
            indices.map(|index| (smooth[index], (ct.values[index] - smooth[index]).abs())).unzip();
        // What the smoothing keeps of the noise is missing in the residual.
        let gain = filter::gaussian_noise_gain(&ct.grid, params.denoise_m);
        let noise_hu = MAD_TO_DEVIATION * median(&mut residual) / gain.residual;
        Self { level_hu: median(&mut level), noise_hu }
    }

    fn band_hu(self, params: &SegmentParams) -> [f64; 2] {
        let [least, most] = params.band_limits_hu;
        let half_width = (params.band_width * self.noise_hu).clamp(least, most);
        [self.level_hu - half_width, self.level_hu + half_width]
    }
}

/// Statistics around the seed, which must be in soft tissue.
fn statistics_at_seed(
    ct: &Volume<f32>,
    smooth: &[f32],
    seed_m: DVec3,
    params: &SegmentParams,
) -> Result<Statistics, SegmentError> {
    let grid = &ct.grid;
    let voxel = grid.voxel_at(seed_m);
    let inside = (0..3).all(|a| voxel[a] >= -0.5 && voxel[a] < grid.dims[a] as f64 - 0.5);
    if !inside {
        let bounds = grid.bounds_m();
        return Err(SegmentError::SeedOutside {
            seed_mm: to_mm(seed_m),
            min_mm: to_mm(bounds.min_m),
            max_mm: to_mm(bounds.max_m),
        });
    }
    let mut around = Vec::new();
    // At least the seed's own voxel, however coarse the image.
    let radius_m = params.statistics_radius_m.max(0.5 * grid.spacing_m.length() * (1.0 + 1e-9));
    for_each_in_ball(grid, seed_m, radius_m, |index| around.push(index));
    let statistics = Statistics::of(ct, smooth, around.into_iter(), params);
    let level_hu = statistics.level_hu;
    if !(f64::from(SOFT_TISSUE_HU[0])..=f64::from(SOFT_TISSUE_HU[1])).contains(&level_hu) {
        return Err(SegmentError::SeedNotSoftTissue { seed_mm: to_mm(seed_m), found_hu: level_hu });
    }
    Ok(statistics)
}

/// The most frequent level in a range, in bins of `bin_hu`; `None` when no value lies in it.
fn most_frequent(values: impl Iterator<Item = f32>, range_hu: [f32; 2], bin_hu: f32) -> Option<f32> {
    let n_bins = ((range_hu[1] - range_hu[0]) / bin_hu) as usize;
    let mut counts = vec![0usize; n_bins];
    for value in values.filter(|v| (range_hu[0]..range_hu[1]).contains(v)) {
        counts[(((value - range_hu[0]) / bin_hu) as usize).min(n_bins - 1)] += 1;
    }
    let best = (0..n_bins).fold(0, |best, bin| if counts[bin] > counts[best] { bin } else { best });
    (counts[best] > 0).then(|| range_hu[0] + (best as f32 + 0.5) * bin_hu)
}

/// Level of fat in the image; -100 HU where it shows none.
fn fat_level(smooth: &[f32]) -> f32 {
    most_frequent(smooth.iter().copied(), FAT_HU, 5.0).unwrap_or(-100.0)
}

/// The piece of `mask` that the voxel nearest to `seed_m` belongs to, if one lies within `reach_m`.
fn piece_near(grid: &VoxelGrid, mask: &[bool], seed_m: DVec3, reach_m: f64) -> Option<Vec<bool>> {
    let mut nearest: Option<(f64, usize)> = None;
    for_each_in_ball(grid, seed_m, reach_m.max(grid.spacing_m.length()), |index| {
        let voxel = grid.voxel(index).map(|v| v as f64);
        let distance = grid.position_m(DVec3::from_array(voxel)).distance_squared(seed_m);
        if mask[index] && nearest.is_none_or(|(d, _)| distance < d) {
            nearest = Some((distance, index));
        }
    });
    let found = filter::components(grid, mask, Connectivity::Faces);
    let number = found.piece[nearest?.1];
    Some(found.piece.iter().map(|&p| p == number).collect())
}

/// A point deep inside the liver [m]: on the patient's right, at the level that is most frequent deep inside
/// parenchyma there, the one farthest from everything that is no parenchyma.
///
/// `smooth` are CT numbers [HU] with little noise.
///
/// # Errors
/// [`SegmentError::NoSeed`] when no parenchyma is thick enough.
pub fn guess_seed(grid: &VoxelGrid, smooth: &[f32]) -> Result<DVec3, SegmentError> {
    const COARSE_M: f64 = 4.5e-3;
    const LEAST_DEPTH_M: f64 = 15e-3;
    let no_seed = || SegmentError::NoSeed { depth_mm: LEAST_DEPTH_M * 1e3 };
    let step = [0, 1, 2].map(|a| ((COARSE_M / grid.spacing_m[a]).round() as usize).max(1));
    let coarse = VoxelGrid {
        dims: [0, 1, 2].map(|a| grid.dims[a].div_ceil(step[a])),
        spacing_m: grid.spacing_m * DVec3::from_array(step.map(|s| s as f64)),
        ..grid.clone()
    };
    let at = |index: usize| {
        let [i, j, k] = coarse.voxel(index);
        smooth[grid.index([i * step[0], j * step[1], k * step[2]])]
    };
    let position_m =
        |index: usize| coarse.position_m(DVec3::from_array(coarse.voxel(index).map(|v| v as f64)));
    let body: Vec<usize> = (0..coarse.n_voxels()).filter(|&i| at(i) > FAT_HU[0]).collect();
    let center_x_m = body.iter().map(|&i| position_m(i).x).sum::<f64>() / body.len().max(1) as f64;
    let elsewhere: Vec<bool> = (0..coarse.n_voxels())
        .map(|i| !(PARENCHYMA_HU[0]..=PARENCHYMA_HU[1]).contains(&at(i)) || position_m(i).x > center_x_m)
        .collect();
    let depth2 = filter::distance_squared_m2(&coarse, &elsewhere);
    let least2 = (LEAST_DEPTH_M * LEAST_DEPTH_M) as f32;
    let deep: Vec<usize> =
        (0..depth2.len()).filter(|&i| depth2[i] >= least2 && depth2[i].is_finite()).collect();
    let level = most_frequent(deep.iter().map(|&i| at(i)), PARENCHYMA_HU, 4.0).ok_or_else(no_seed)?;
    let typical = deep.into_iter().filter(|&i| (at(i) - level).abs() <= 6.0);
    let best = typical.fold(None, |best: Option<usize>, i| match best {
        Some(b) if depth2[b] >= depth2[i] => Some(b),
        _ => Some(i),
    });
    best.map(position_m).ok_or_else(no_seed)
}
