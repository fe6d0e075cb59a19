//! Finding an organ by deformable contours, slice by slice.
//!
//! This is the way of Cotin, Delingette and Ayache (1998, "Real-time Elastic Deformations of Soft Tissues for
//! Surgery Simulation", INRIA RR-3511, s. 2.1) from slices to a binary volume:
//! 1. [`level`]: what the organ looks like around the seed; the contrast is enhanced to show it.
//! 2. [`canny`] or [`deriche`]: the gradient; [`edges`]: it is thinned to edges, of which the strong ones stay.
//! 3. `snake`: closed contours are driven to the edges by elastic, edge and balloon forces.
//! 4. `follow`: each slice starts from the contours of the one before; contours drawn by hand replace those found.
//! 5. The contours are drawn as binary slices and stacked; closing brings back vessels and lesions that
//!    reach the surface, a small opening and closing smooth it between slices, cavities are filled, the
//!    largest piece stays and is made one ball.
//!
//! Slices are the planes of constant k, axial in the usual orientation of a CT.
//! Slices and rows are processed in parallel where they do not depend on each other; the bits do not depend
//! on the number of threads.

pub mod params;
pub mod error;
pub mod plane;
pub mod polygon;
pub mod raster;
pub mod level;
pub mod edges;
pub mod canny;
pub mod deriche;
mod snake;
mod follow;
mod stack;

pub use self::error::ContourError;
pub use self::params::{ContourParams, EdgeMethod};
pub use self::polygon::SliceContour;

use self::follow::{Follower, SlicePolygons};
use self::level::OrganLevel;
use self::plane::Plane;
use self::snake::stiffness_kernel;
use self::stack::stacked;
use super::segment::error::to_mm;
use super::segment::guess_seed;
use super::segment::statistics::check_on_image;
use super::topology::TopologyRepair;
use super::{Volume, VoxelGrid, filter};
use crate::math::{DVec2, DVec3};
use crate::progress::{part, tell};

/// An organ found by contours.
#[derive(Clone, Debug, PartialEq)]
pub struct ContourSegmentation {
    /// For each voxel whether it belongs to the organ.
    pub mask: Vec<bool>,
    /// The contours that were found or given, by slice. The mask is smoother between slices than they are.
    pub contours: Vec<SliceContour>,
    /// The seeds that were used [m], LPS.
    pub seeds_m: Vec<DVec3>,
    /// What the organ looks like around the first seed.
    pub level: OrganLevel,
    /// How it went.
    pub report: ContourReport,
}

/// How a segmentation by contours went.
#[derive(Clone, Debug, PartialEq)]
pub struct ContourReport {
    /// Lower and higher threshold of the edges [1/m, contrast as of [`OrganLevel::enhanced`]].
    pub edge_thresholds_per_m: [f64; 2],
    /// Edges in all slices.
    pub n_edges: usize,
    /// Slices that hold a contour.
    pub n_slices: usize,
    /// Steps of the contours in all slices.
    pub n_steps: usize,
    /// Slices whose contours ran out of steps: look at them, and correct them by hand.
    pub slices_not_at_rest: Vec<usize>,
    /// What the last step changed to make the organ one ball.
    pub repair: TopologyRepair,
}

/// The organ around the seeds (for the automatic seed: the liver), from contours in slices of constant k.
///
/// # Errors
/// A seed outside the image or not in soft tissue; no seed found; a correction that is no contour; nothing
/// found around the seeds.
pub fn segment_by_contours(
    ct: &Volume<f32>,
    params: &ContourParams,
) -> Result<ContourSegmentation, ContourError> {
    let grid = &ct.grid;
    let plane = Plane::of(grid);
    let given = checked_corrections(grid, &params.corrections)?;
    tell(0.0);
    let smooth = filter::gaussian(grid, &ct.values, params.denoise_m);
    let seeds_m = match params.seeds_m.as_slice() {
        [] => vec![guess_seed(grid, &smooth)?],
        seeds_m => seeds_m.to_vec(),
    };
    let seeds = seeds_m.iter().map(|&s| seed_in_slice(grid, s)).collect::<Result<Vec<_>, _>>()?;
    let level = OrganLevel::around(ct, &smooth, seeds_m[0], params)?;

    tell(0.1);
    let enhanced = level.enhanced(&smooth);
    let gradient = match params.edges {
        EdgeMethod::Canny { sigma_m } => canny::gaussian_gradient(grid, &enhanced, sigma_m),
        EdgeMethod::Deriche { decay_length_m } => {
            deriche::recursive_gradient(grid, &enhanced, decay_length_m)
        }
    };
    let is_tissue: Vec<bool> = smooth.iter().map(|&v| level.holds(v)).collect();
    let noise_per_m = gradient.noise(&is_tissue).unwrap_or(0.0);
    let edge_thresholds_per_m = params.edge_thresholds.map(|t| t * noise_per_m);
    tell(0.2);
    let edges = edges::edges(grid, &gradient, edge_thresholds_per_m);

    let kernel = stiffness_kernel(params.elasticity, params.bending);
    let follower = Follower { plane, smooth: &smooth, edges: &edges, level: &level, kernel: &kernel, params };
    let slices = part(0.3, 0.9, || follower.follow(&seeds, &given));
    tell(0.9);
    let contours: Vec<SliceContour> = slices
        .iter()
        .enumerate()
        .flat_map(|(slice, found)| {
            found.polygons.iter().map(move |p| SliceContour { slice, points_m: p.clone() })
        })
        .collect();
    let is_given: Vec<bool> = (0..grid.dims[2]).map(|k| given.iter().any(|(slice, _)| *slice == k)).collect();
    let drawn: Vec<bool> = slices.iter().flat_map(|found| found.mask.iter().copied()).collect();
    let Some((mask, repair)) = stacked(grid, &drawn, &is_given, |v| level.is_soft(smooth[v]), params)? else {
        return Err(ContourError::NothingFound {
            seed_mm: to_mm(seeds_m[0]),
            low_hu: level.band_hu[0],
            high_hu: level.band_hu[1],
            least_area_mm2: params.least_area_m2 * 1e6,
        });
    };
    let report = ContourReport {
        edge_thresholds_per_m,
        n_edges: edges.iter().map(|e| e.edges.len()).sum(),
        n_slices: slices.iter().filter(|found| !found.polygons.is_empty()).count(),
        n_steps: slices.iter().map(|found| found.n_steps).sum(),
        slices_not_at_rest: (0..slices.len())
            .filter(|&k| !slices[k].polygons.is_empty() && !slices[k].at_rest)
            .collect(),
        repair,
    };
    Ok(ContourSegmentation { mask, contours, seeds_m, level, report })
}

/// Slice of a seed, and its place on it.
fn seed_in_slice(grid: &VoxelGrid, seed_m: DVec3) -> Result<(usize, DVec2), ContourError> {
    check_on_image(grid, seed_m)?;
    let voxel = grid.voxel_at(seed_m);
    let slice = (voxel.z.round().max(0.0) as usize).min(grid.dims[2] - 1);
    Ok((slice, voxel.truncate() * grid.spacing_m.truncate()))
}

/// The corrections, together for each slice.
fn checked_corrections(
    grid: &VoxelGrid,
    corrections: &[SliceContour],
) -> Result<Vec<SlicePolygons>, ContourError> {
    let mut slices: Vec<SlicePolygons> = Vec::new();
    for SliceContour { slice, points_m } in corrections {
        let slice = *slice;
        if slice >= grid.dims[2] {
            return Err(ContourError::CorrectionOutside { slice, last: grid.dims[2].saturating_sub(1) });
        }
        let n_points = points_m.len();
        let n_finite = points_m.iter().filter(|p| p.is_finite()).count();
        if n_finite < n_points || (1..3).contains(&n_points) {
            return Err(ContourError::CorrectionNotAContour { slice, n_points, n_finite });
        }
        let place = slices.iter().position(|(s, _)| *s == slice).unwrap_or_else(|| {
            slices.push((slice, Vec::new()));
            slices.len() - 1
        });
        if n_points > 0 {
            slices[place].1.push(points_m.clone());
        }
    }
    Ok(slices)
}
