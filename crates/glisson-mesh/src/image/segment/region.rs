//! By growing a region: denoise, intensity band around a seed, connected region, opening and closing, holes
//! filled, one piece.
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

use super::error::SegmentError;
use super::guess::guess_seed;
use super::params::{SegmentParams, Segmentation};
use super::statistics::Statistics;
use super::steps::{
    Core, Denoised, core_at, fill_vessels, grow_into_slope, in_band, not_fat, retain, smoothed,
};
use crate::image::Volume;
use crate::image::filter::{self, Connectivity};
use crate::image::topology::repair_to_ball;

/// The organ around a seed (for the automatic seed: the liver).
///
/// # Errors
/// A seed outside the image or not in soft tissue; no seed found; nothing left at the seed.
pub fn segment(ct: &Volume<f32>, params: &SegmentParams) -> Result<Segmentation, SegmentError> {
    let grid = &ct.grid;
    let image = Denoised::of(ct, params);
    let seed_m = match params.seed_m {
        Some(seed_m) => seed_m,
        None => guess_seed(grid, &image.smooth)?,
    };
    let Core { band, core, statistics } = core_at(&image, seed_m, None, params)?;
    let mut region = filter::dilate(grid, &core, params.cut_radius_m);
    retain(&mut region, |index| band[index]);
    let not_fat = not_fat(&image.smooth, statistics.level_hu);
    fill_vessels(grid, &mut region, &not_fat, params.close_radius_m);
    grow_into_slope(grid, &mut region, &not_fat, params);

    let smoothed = smoothed(grid, &region, &not_fat, params.smooth_radius_m);
    let mut mask = filter::largest_piece(grid, &smoothed, Connectivity::Faces);
    let repair = repair_to_ball(grid, &mut mask)?;
    let Statistics { level_hu, noise_hu } = statistics;
    Ok(Segmentation { mask, seed_m, level_hu, noise_hu, band_hu: statistics.band_hu(params), repair })
}

/// The plain method to compare with: raw CT numbers in the band, of these the largest connected piece.
pub fn bare_band(ct: &Volume<f32>, band_hu: [f64; 2]) -> Vec<bool> {
    filter::largest_piece(&ct.grid, &in_band(&ct.values, band_hu), Connectivity::Faces)
}
