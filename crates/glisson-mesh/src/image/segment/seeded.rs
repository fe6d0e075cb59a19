//! Finding an organ by points inside and outside it, ending with a geodesic active contour.
//!
//! 1. The image is brought to voxels of about 1.5 mm and denoised.
//! 2. The first point inside gives the organ's level and its core, as in [`super::segment`]. Each further point adds
//!    what is like the tissue at it and lies within reach: a lobe of its own, a part that the contrast agent or
//!    beam hardening made lighter or darker.
//! 3. Points outside take their cores out; what hangs together with both is parted (`parting`).
//! 4. The core is grown back, vessels and cavities are filled, the slope towards fat is added.
//! 5. Within a few millimetres of that border a geodesic active contour finds the surface of least area that is
//!    drawn to edges (`geodesic`); everything deeper and farther stays as it is.
//! 6. The surface is brought back to the image's own voxels between those of the contour; cavities are
//!    filled, the largest piece stays, and it is made one ball.

use super::error::{SegmentError, to_mm};
use super::geodesic::{Contour, areas};
use super::guess::guess_seed;
use super::params::{SegmentParams, Segmentation};
use super::parting::{SeedVoxels, belongs_outside};
use super::statistics::for_each_in_ball;
use super::steps::{Core, Denoised, core_at, fill_vessels, grow_into_slope, not_fat, retain};
use crate::image::filter::{self, Connectivity};
use crate::image::resample::{VoxelBox, block_means, steps_for};
use crate::image::topology::{TopologyRepair, repair_to_ball};
use crate::image::{Volume, VoxelGrid};
use crate::math::DVec3;
use crate::progress::{part, tell};
use rayon::prelude::*;

/// Points that tell an organ from what is around it [m], LPS.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Seeds {
    /// Points inside the organ; the first in its main part. Without any, [`guess_seed`] finds the liver.
    pub inside_m: Vec<DVec3>,
    /// Points in tissue that must not be taken.
    pub outside_m: Vec<DVec3>,
}

/// What makes an edge: a difference between neighbouring voxels in deviations of the noise, and its limits [HU].
const EDGE_NOISES: f64 = 3.0;
const EDGE_LIMITS_HU: [f64; 2] = [20.0, 80.0];

/// How [`segment_with_seeds`] works. Lengths in metres.
#[derive(Clone, Debug, PartialEq)]
pub struct SeededParams {
    /// How the region is grown; its seed is not used.
    pub region: SegmentParams,
    /// Side of the voxels that are worked on, about.
    pub voxel_m: f64,
    /// How far further points inside, and those outside, have an effect.
    pub reach_m: f64,
    /// Radius of the ball around each point that is on the point's side whatever the image shows.
    pub seed_radius_m: f64,
    /// How far the contour may move from the region's border.
    pub free_depth_m: f64,
    /// The smallest radius of a ball that the contour keeps where the image shows no edge: 3 over the cost of a
    /// unit of volume.
    pub smooth_radius_m: f64,
    /// Steps of the contour.
    pub n_steps: usize,
}

impl Default for SeededParams {
    fn default() -> Self {
        Self {
            // The band is at least as wide as parenchyma varies within an image of little noise.
            region: SegmentParams { band_limits_hu: [16.0, 40.0], ..SegmentParams::default() },
            voxel_m: 1.5e-3,
            reach_m: 40e-3,
            seed_radius_m: 5e-3,
            free_depth_m: 4e-3,
            smooth_radius_m: 50e-3,
            n_steps: 100,
        }
    }
}

/// The organ that points inside and outside tell (without points: the liver).
///
/// # Errors
/// A point outside the image, a point inside the organ that is not in soft tissue, points of both kinds in one
/// place; no seed found; nothing left at a point.
pub fn segment_with_seeds(
    ct: &Volume<f32>,
    seeds: &Seeds,
    params: &SeededParams,
) -> Result<Segmentation, SegmentError> {
    tell(0.0);
    let coarse = block_means(ct, steps_for(&ct.grid, params.voxel_m));
    let image = Denoised::of(&coarse, &params.region);
    let mut inside_m = seeds.inside_m.clone();
    if inside_m.is_empty() {
        inside_m.push(guess_seed(&coarse.grid, &image.smooth)?);
    }
    tell(0.1);
    check_apart(&inside_m, &seeds.outside_m, params)?;
    let Core { mut band, mut core, statistics } = core_at(&image, inside_m[0], None, &params.region)?;
    for &seed_m in &inside_m[1..] {
        let more = core_at(&image, seed_m, Some(params.reach_m), &params.region)?;
        add(&mut band, &more.band);
        add(&mut core, &more.core);
    }
    let mut barred = vec![false; core.len()];
    for &seed_m in &seeds.outside_m {
        match core_at(&image, seed_m, Some(params.reach_m), &params.region) {
            Ok(other) => add(&mut barred, &other.core),
            // Fat, air and bone are not in the band in any case.
            Err(SegmentError::SeedNotSoftTissue { .. } | SegmentError::NothingFound { .. }) => {}
            Err(error) => return Err(error),
        }
    }
    tell(0.3);
    let edge_hu = (EDGE_NOISES * statistics.noise_hu).clamp(EDGE_LIMITS_HU[0], EDGE_LIMITS_HU[1]) as f32;
    if !seeds.outside_m.is_empty() {
        let voxels = SeedVoxels {
            inside: voxels_around(&coarse.grid, &inside_m, params.seed_radius_m),
            outside: voxels_around(&coarse.grid, &seeds.outside_m, params.seed_radius_m),
        };
        add(&mut barred, &core);
        barred = belongs_outside(&coarse.grid, &barred, &image.smooth, &voxels, edge_hu);
        retain(&mut core, |index| !barred[index]);
        core = pieces_with(&coarse.grid, &core, &voxels.inside);
    }
    tell(0.4);
    let found = Found { band, core, barred, level_hu: statistics.level_hu };
    let rough = found.contour(&image, &inside_m, &seeds.outside_m, edge_hu, params);
    tell(0.9);
    let (mask, repair) = in_own_voxels(&ct.grid, &rough)?;
    Ok(Segmentation {
        mask,
        seed_m: inside_m[0],
        level_hu: statistics.level_hu,
        noise_hu: statistics.noise_hu,
        band_hu: statistics.band_hu(&params.region),
        repair,
    })
}

/// Points of both kinds must not share a ball.
fn check_apart(inside_m: &[DVec3], outside_m: &[DVec3], params: &SeededParams) -> Result<(), SegmentError> {
    for &inside in inside_m {
        for &outside in outside_m {
            if inside.distance(outside) < 2.0 * params.seed_radius_m {
                return Err(SegmentError::SeedsTooClose {
                    inside_mm: to_mm(inside),
                    outside_mm: to_mm(outside),
                    least_mm: 2e3 * params.seed_radius_m,
                });
            }
        }
    }
    Ok(())
}

fn add(mask: &mut [bool], more: &[bool]) {
    mask.iter_mut().zip(more).for_each(|(inside, more)| *inside |= more);
}

fn voxels_around(grid: &VoxelGrid, points_m: &[DVec3], radius_m: f64) -> Vec<usize> {
    let mut voxels = Vec::new();
    let radius_m = radius_m.max(0.5 * grid.spacing_m.length());
    for &point_m in points_m {
        for_each_in_ball(grid, point_m, radius_m, |index| voxels.push(index));
    }
    voxels
}

/// The pieces of `mask` that hold one of `voxels`.
fn pieces_with(grid: &VoxelGrid, mask: &[bool], voxels: &[usize]) -> Vec<bool> {
    let found = filter::components(grid, mask, Connectivity::Faces);
    let mut keep = vec![false; found.sizes.len() + 1];
    for &index in voxels {
        keep[found.piece[index] as usize] = true;
    }
    keep[0] = false;
    found.piece.iter().map(|&piece| keep[piece as usize]).collect()
}

/// What the seeds found.
struct Found {
    band: Vec<bool>,
    core: Vec<bool>,
    /// What belongs to the seeds outside.
    barred: Vec<bool>,
    level_hu: f64,
}

impl Found {
    /// Steps 4 and 5: shares of voxels inside the organ, in the part of the image around the core.
    fn contour(
        &self,
        image: &Denoised,
        inside_m: &[DVec3],
        outside_m: &[DVec3],
        edge_hu: f32,
        params: &SeededParams,
    ) -> Volume<f32> {
        let whole = &image.ct.grid;
        let region = &params.region;
        let margin_m = 2.0 * region.close_radius_m + params.free_depth_m;
        let near = VoxelBox::around(whole, &self.core, margin_m).unwrap_or_else(|| VoxelBox::whole(whole));
        let grid = near.grid(whole);
        let core = near.cut(whole, &self.core);
        let band = near.cut(whole, &self.band);
        let values = near.cut(whole, &image.ct.values);
        let not_fat = near.cut(whole, &not_fat(&image.smooth, self.level_hu));
        let to_barred = filter::distance_squared_m2(&grid, &near.cut(whole, &self.barred));
        let to_core = filter::distance_squared_m2(&grid, &core);
        let cut2 = (region.cut_radius_m * region.cut_radius_m * (1.0 + 1e-5)) as f32;
        let allowed: Vec<bool> = (0..core.len()).map(|i| not_fat[i] && to_barred[i] > cut2).collect();
        let mut grown: Vec<bool> =
            (0..core.len()).map(|i| band[i] && to_core[i] <= cut2 && to_core[i] <= to_barred[i]).collect();
        fill_vessels(&grid, &mut grown, &allowed, region.close_radius_m);
        let mut with_slope = grown.clone();
        grow_into_slope(&grid, &mut with_slope, &not_fat, region);

        let depth2 = filter::distance_squared_m2(&grid, &with_slope.iter().map(|&m| !m).collect::<Vec<_>>());
        let height2 = filter::distance_squared_m2(&grid, &with_slope);
        let free2 = (params.free_depth_m * params.free_depth_m) as f32;
        let per_mm = (3e-3 / params.smooth_radius_m) as f32;
        // Far beyond what any area can outweigh.
        let (surely_inside, surely_outside) = (-1e6, 1e6);
        let mut cost: Vec<f32> = (0..core.len())
            .map(|i| match () {
                () if depth2[i] > free2 => surely_inside,
                () if height2[i] > free2 => surely_outside,
                () if grown[i] => -per_mm,
                () if with_slope[i] => -0.5 * per_mm,
                () if not_fat[i] => 0.5 * per_mm,
                () => per_mm,
            })
            .collect();
        for (points_m, cost_there) in [(inside_m, surely_inside), (outside_m, surely_outside)] {
            for index in voxels_around(&grid, points_m, params.seed_radius_m) {
                cost[index] = cost_there;
            }
        }
        let area = areas(&grid, &values, edge_hu);
        let mut inside: Vec<f32> = with_slope.iter().map(|&m| f32::from(u8::from(m))).collect();
        part(0.5, 0.9, || Contour { grid: &grid, area, cost }.relax(&mut inside, params.n_steps));
        Volume { grid, values: inside }
    }
}

/// Step 6.
fn in_own_voxels(own: &VoxelGrid, shares: &Volume<f32>) -> Result<(Vec<bool>, TopologyRepair), SegmentError> {
    let low = own.voxel_at(shares.grid.position_m(DVec3::ZERO));
    let last = DVec3::from_array(shares.grid.dims.map(|n| n as f64 - 1.0));
    let high = own.voxel_at(shares.grid.position_m(last));
    // The outermost voxels of the part are outside the organ unless the image ends there.
    let step = shares.grid.spacing_m / own.spacing_m;
    let first = [0, 1, 2].map(|a| (low[a] - 0.5 * step[a]).max(0.0) as usize);
    let dims = [0, 1, 2]
        .map(|a| ((high[a] + 0.5 * step[a]).ceil() as usize + 1).min(own.dims[a]).saturating_sub(first[a]));
    let part = VoxelBox { first, dims };
    let grid = part.grid(own);
    let inside: Vec<bool> = (0..grid.n_voxels())
        .into_par_iter()
        .map(|index| shares.value_at(grid.center_m(index)) > 0.5)
        .collect();
    let mut organ = filter::largest_piece(&grid, &inside, Connectivity::Faces);
    filter::fill_cavities(&grid, &mut organ);
    let repair = repair_to_ball(&grid, &mut organ)?;
    let mut mask = vec![false; own.n_voxels()];
    part.paste(own, &organ, &mut mask);
    Ok((mask, repair))
}
