//! From a mask or a surface to a fitted simplex mesh and its dual triangulation.
//!
//! 1. The start is the dual of the mask's decimated surface net: it has the right topology and lies within a
//!    voxel of the border, with the voxels' stairs on it.
//! 2. Internal forces of curvature continuity against the external force of the smoothed mask's border flatten
//!    the stairs and keep the place.
//! 3. Cells are cut and joined by curvature and distance to the data, the mesh deforms again, and so on; the
//!    last rounds deform only.
//! 4. The dual triangulation is moved to follow the simplex surface, gets the volume of the voxels and is
//!    checked: closed, outward, without self-intersection.

use std::ops::ControlFlow;

use rayon::prelude::*;

use super::adapt::{AdaptParams, AdaptReport, adapt};
use super::dual::following_dual;
use super::error::SimplexError;
use super::evolve::{Deformation, DeformationLaw};
use super::external::{Attraction, MaskBorder, SurfaceBorder};
use super::geometry::{mean_curvatures_per_m, vertex_normals};
use super::internal::{Smoothness, Spacing};
use super::measure::{
    DistanceSummary, density_correlation, middle_range, surface_distances,
    triangulation_mean_curvatures_per_m,
};
use super::mesh::SimplexMesh;
use super::neighbourhood::Neighbourhoods;
use super::untangle::{crossing_vertices, return_from_crossings, smooth_crossings_away, surroundings};
use crate::image::VoxelGrid;
use crate::math::Aabb;
use crate::surface::TriMesh;
use crate::surface::check::check_closed;
use crate::surface::decimate::decimate;
use crate::surface::extract::{SurfaceParams, surface_and_solid};
use crate::surface::intersect::self_intersections;
use crate::surface::smooth::offset_to_volume;

/// How a simplex mesh is fitted.
#[derive(Clone, Debug, PartialEq)]
pub struct SimplexFitParams {
    /// Triangles of the dual triangulation, rounded to an even number; none: a sixth of those of the surface
    /// net, which are as many as those of marching cubes.
    pub target_triangles: Option<usize>,
    /// Reach of curvature continuity in edges; see [`Smoothness::Curvature`].
    pub rigidity: usize,
    /// Weight of the internal force, 0 to 0.5.
    pub internal: f64,
    /// Weight of the external force, 0 to 1.
    pub external: f64,
    /// Damping, 0 to 1.
    pub damping: f64,
    /// Standard deviation of the Gaussian on the mask, in largest spacings.
    pub mask_smoothing_spacings: f64,
    /// Largest ratio of the densities of cells in curved and flat places, at least 1.
    pub contrast: f64,
    /// Strength of the pull along the surface to where it is curved, 0 to 0.3.
    pub gathering: f64,
    /// Times that cells are cut and joined.
    pub n_adaptations: usize,
    /// Deformation steps after the start and after each adaptation.
    pub n_steps: usize,
    /// Close a mask that touches the end of the image by a flat cap instead of refusing it.
    pub cap_at_border: bool,
    /// Largest share of the mask's voxels that the repair of its topology may change.
    pub largest_repair: f64,
}

impl Default for SimplexFitParams {
    fn default() -> Self {
        Self {
            target_triangles: None,
            rigidity: 4,
            internal: 0.4,
            external: 0.1,
            damping: 0.65,
            mask_smoothing_spacings: 0.7,
            contrast: 6.0,
            gathering: 0.1,
            n_adaptations: 3,
            n_steps: 20,
            cap_at_border: false,
            largest_repair: 0.05,
        }
    }
}

/// Where a fit is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimplexFitProgress {
    /// What is being done.
    pub stage: &'static str,
    /// Share of the whole that is done, 0 to 1.
    pub share: f64,
    /// Mean distance to the data along the normals [m], after the first deformation step.
    pub mean_offset_m: Option<f64>,
}

/// What came out, in figures.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct SimplexFitReport {
    /// Triangles of the surface with the voxels' stairs.
    pub n_triangles_extracted: usize,
    /// Triangles of the dual: vertices of the simplex mesh.
    pub n_triangles: usize,
    /// Vertices of the dual: cells of the simplex mesh.
    pub n_cells: usize,
    /// From the dual to the surface it was fitted to.
    pub to_data: DistanceSummary,
    /// From the surface it was fitted to to the dual.
    pub from_data: DistanceSummary,
    /// Middle 90 % of the mean curvatures of the surface it was fitted to [1/m].
    pub data_curvatures_per_m: [f64; 2],
    /// Middle 90 % of the mean curvatures of the dual [1/m].
    pub curvatures_per_m: [f64; 2],
    /// Spearman's rank correlation between the density of cells and their absolute mean curvature.
    pub density_correlation: f64,
    /// Volume of the voxels, or that of the surface it was fitted to [m3].
    pub data_volume_m3: f64,
    /// Volume of the dual [m3].
    pub volume_m3: f64,
    /// Distance by which the dual was moved along its normals to meet the volume [m].
    pub volume_offset_m: f64,
    /// Simplex vertices that had no data within reach at the end.
    pub n_without_data: usize,
    /// Vertices moved back or smoothed because dual triangles crossed.
    pub n_untangled: usize,
    /// What all adaptations did together.
    pub adapted: AdaptReport,
}

/// A fitted mesh.
#[derive(Clone, Debug, PartialEq)]
pub struct SimplexFit {
    /// The simplex mesh.
    pub simplex: SimplexMesh,
    /// Its dual: closed, outward oriented, without self-intersection. Triangle `v` belongs to simplex vertex
    /// `v`, vertex `c` to cell `c`.
    pub mesh: TriMesh,
    /// Figures.
    pub report: SimplexFitReport,
}

/// Share of the triangles of marching cubes that is taken by default.
const DEFAULT_SHARE: f64 = 1.0 / 6.0;
/// How far external forces look, in largest spacings.
const REACH_SPACINGS: f64 = 4.0;
/// How far the voxels' border is from the organ's, in largest spacings: half of a step.
const DATA_UNCERTAINTY_SPACINGS: f64 = 0.5;
/// Largest offset that restores the volume, in largest spacings.
const LARGEST_VOLUME_OFFSET_SPACINGS: f64 = 0.3;

/// A simplex mesh fitted to the voxels of `mask` (`grid.n_voxels()` values, i fastest), in the patient frame.
/// Pieces, cavities and tunnels are repaired first, as by [`surface_of_mask`](crate::surface::extract::surface_of_mask). `progress` is told of each step
/// and may stop the fit.
///
/// # Errors
/// [`SimplexError`]: what [`surface_of_mask`](crate::surface::extract::surface_of_mask) and [`decimate`] refuse, parameters out of range, crossings that
/// cannot be taken away, [`SimplexError::Stopped`].
pub fn fit_simplex(
    grid: &VoxelGrid,
    mask: &[bool],
    params: &SimplexFitParams,
    progress: &mut dyn FnMut(SimplexFitProgress) -> ControlFlow<()>,
) -> Result<SimplexFit, SimplexError> {
    check_parameters(params)?;
    tell(progress, "extraction", 0.0, None)?;
    let stairs = SurfaceParams {
        target_triangles: None,
        smoothing_wavelength_m: Some(0.0),
        cap_at_border: params.cap_at_border,
        largest_repair: params.largest_repair,
    };
    let (border, extracted, solid) = surface_and_solid(grid, mask, &stairs)?;
    let spacing_m = grid.spacing_m.max_element();
    let smoothing_m = params.mask_smoothing_spacings * spacing_m;
    let mask_border = MaskBorder::new(grid, &solid, smoothing_m, REACH_SPACINGS * spacing_m)?;
    let attraction = Attraction::Mask(&mask_border);
    Fit { data: &border, attraction, spacing_m, data_volume_m3: extracted.voxel_volume_m3, params }
        .run(progress)
}

/// A simplex mesh fitted to a closed surface: its smooth version with fewer triangles. `resolution_m` is the size
/// of what is noise on it, such as the voxels it came from.
///
/// # Errors
/// [`SimplexError`]: a surface that [`check_closed`] refuses, and as [`fit_simplex`].
pub fn fit_simplex_to_surface(
    surface: &TriMesh,
    resolution_m: f64,
    params: &SimplexFitParams,
    progress: &mut dyn FnMut(SimplexFitProgress) -> ControlFlow<()>,
) -> Result<SimplexFit, SimplexError> {
    check_parameters(params)?;
    if !(resolution_m > 0.0 && resolution_m.is_finite()) {
        let allowed = "positive and finite";
        return Err(SimplexError::Parameter { name: "resolution [m]", found: resolution_m, allowed });
    }
    let topology = check_closed(surface)?;
    let border = SurfaceBorder::new(surface.clone(), REACH_SPACINGS * resolution_m);
    let attraction = Attraction::Surface(&border);
    let data_volume_m3 = topology.volume_m3;
    Fit { data: surface, attraction, spacing_m: resolution_m, data_volume_m3, params }.run(progress)
}

fn check_parameters(params: &SimplexFitParams) -> Result<(), SimplexError> {
    let ranges = [
        ("weight of the internal force", params.internal, 0.0, 0.5, "0 to 0.5"),
        ("weight of the external force", params.external, 0.0, 1.0, "0 to 1"),
        ("damping", params.damping, 0.0, 1.0, "0 to 1"),
        ("smoothing of the mask [spacings]", params.mask_smoothing_spacings, 0.0, 10.0, "0 to 10"),
        ("contrast of densities", params.contrast, 1.0, 100.0, "1 to 100"),
        ("pull towards curvature", params.gathering, 0.0, 0.3, "0 to 0.3"),
        ("rigidity [edges]", params.rigidity as f64, 0.0, 50.0, "0 to 50"),
        (
            "wanted number of triangles",
            params.target_triangles.unwrap_or(8) as f64,
            8.0,
            1e8,
            "8 to 100 million",
        ),
    ];
    for (name, found, low, high, allowed) in ranges {
        if !(low..=high).contains(&found) {
            return Err(SimplexError::Parameter { name, found, allowed });
        }
    }
    Ok(())
}

fn tell(
    progress: &mut dyn FnMut(SimplexFitProgress) -> ControlFlow<()>,
    stage: &'static str,
    share: f64,
    mean_offset_m: Option<f64>,
) -> Result<(), SimplexError> {
    match progress(SimplexFitProgress { stage, share, mean_offset_m }) {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(SimplexError::Stopped { stage }),
    }
}

/// Attempts at an adaptation without crossings.
const MOST_ADAPT_ATTEMPTS: usize = 3;
/// Rings around crossings whose cells the next attempt leaves as they were.
const KEPT_RINGS: usize = 2;

/// Share of the work before deformation, and after it.
const SHARE_BEFORE: f64 = 0.3;
const SHARE_AFTER: f64 = 0.1;

struct Fit<'a> {
    /// What the result is measured against.
    data: &'a TriMesh,
    attraction: Attraction<'a>,
    spacing_m: f64,
    data_volume_m3: f64,
    params: &'a SimplexFitParams,
}

/// What the rounds did.
#[derive(Default)]
struct Done {
    adapted: AdaptReport,
    n_without_data: usize,
    n_untangled: usize,
    /// The dual has no crossings.
    is_clear: bool,
}

impl Fit<'_> {
    fn run(
        &self,
        progress: &mut dyn FnMut(SimplexFitProgress) -> ControlFlow<()>,
    ) -> Result<SimplexFit, SimplexError> {
        let extracted = self.data.triangles.len();
        let wanted = self.params.target_triangles.unwrap_or((DEFAULT_SHARE * extracted as f64) as usize);
        let target = (wanted / 2 * 2).clamp(8.min(extracted), extracted);
        tell(progress, "decimation", 0.5 * SHARE_BEFORE, None)?;
        let mut simplex = SimplexMesh::from_triangles(&decimate(self.data, target)?)?;
        let mut done = Done { is_clear: crossing_vertices(&simplex).is_empty(), ..Done::default() };
        let n_rounds = self.params.n_adaptations + 1;
        for round in 0..n_rounds {
            if round > 0 {
                simplex = self.adapt(simplex, target / 2 + 2, &mut done);
            }
            let law = self.law(round > 0);
            let before_m = simplex.positions_m().to_vec();
            let mut deformation = Deformation::at_rest(&simplex, &law);
            for step in 0..self.params.n_steps {
                let moved = deformation.step(&mut simplex, &law, Some(&self.attraction));
                done.n_without_data = moved.n_without_data;
                let steps_done = (round * self.params.n_steps + step + 1) as f64;
                let share = steps_done / (n_rounds * self.params.n_steps) as f64;
                let share = SHARE_BEFORE + (1.0 - SHARE_BEFORE - SHARE_AFTER) * share;
                tell(progress, "deformation", share, Some(moved.mean_offset_m))?;
            }
            if done.is_clear {
                let (n, is_clear) = return_from_crossings(&mut simplex, &before_m);
                done.n_untangled += n;
                done.is_clear = is_clear;
            } else {
                done.is_clear = crossing_vertices(&simplex).is_empty();
            }
        }
        tell(progress, "dual", 1.0 - SHARE_AFTER, None)?;
        self.finish(simplex, &done)
    }

    fn law(&self, gathering: bool) -> DeformationLaw {
        DeformationLaw {
            damping: self.params.damping,
            internal: self.params.internal,
            external: self.params.external,
            data_uncertainty_m: DATA_UNCERTAINTY_SPACINGS * self.spacing_m,
            smoothness: Smoothness::Curvature { rigidity: self.params.rigidity },
            spacing: if gathering && self.params.gathering > 0.0 {
                Spacing::TowardsCurvature { gain: self.params.gathering }
            } else {
                Spacing::Even
            },
            largest_move_m: 0.5 * self.spacing_m,
        }
    }

    /// Cuts and joins cells; where that makes triangles cross, another attempt leaves them as they were, and
    /// after too many of these all stay.
    fn adapt(&self, simplex: SimplexMesh, target_cells: usize, done: &mut Done) -> SimplexMesh {
        let curvatures = smooth_curvatures(&simplex, self.params.rigidity);
        let normals = vertex_normals(&simplex);
        let places = simplex.positions_m().par_iter().zip(&normals);
        let offsets_m: Vec<f64> =
            places.map(|(&p, &n)| self.attraction.offset_m(p, n).unwrap_or(self.spacing_m)).collect();
        let adapt_params =
            AdaptParams { target_cells, contrast: self.params.contrast, tolerance_m: self.spacing_m };
        let mut kept = Vec::new();
        for _ in 0..MOST_ADAPT_ATTEMPTS {
            let (next, report) = adapt(simplex.clone(), &curvatures, &offsets_m, &kept, &adapt_params);
            let crossing = if done.is_clear { crossing_vertices(&next) } else { Vec::new() };
            if crossing.is_empty() {
                done.adapted.n_split += report.n_split;
                done.adapted.n_merged += report.n_merged;
                done.adapted.n_swapped += report.n_swapped;
                return next;
            }
            let around = surroundings(&next, &crossing, KEPT_RINGS);
            let box_of = |&v: &u32| {
                let corners = next.cells()[v as usize].into_iter().flat_map(|c| next.contour(c));
                corners.fold(Aabb::EMPTY, |b, w| b.including(next.positions_m()[w as usize]))
            };
            let boxes: Vec<Aabb> = around.iter().map(box_of).collect();
            let n = simplex.n_vertices() as u32;
            let is_near = |v: &u32| boxes.iter().any(|b| b.contains(simplex.positions_m()[*v as usize]));
            kept.extend((0..n).filter(is_near));
        }
        simplex
    }

    fn finish(&self, simplex: SimplexMesh, done: &Done) -> Result<SimplexFit, SimplexError> {
        let mut mesh = following_dual(&simplex);
        let n_smoothed = if done.is_clear { 0 } else { smooth_crossings_away(&mut mesh)? };
        let volume_offset_m = self.restore_volume(&mut mesh);
        let topology = check_closed(&mesh)?;
        simplex.check()?;
        let curvatures = smooth_curvatures(&simplex, self.params.rigidity);
        let report = SimplexFitReport {
            n_triangles_extracted: self.data.triangles.len(),
            n_triangles: mesh.triangles.len(),
            n_cells: simplex.n_cells(),
            to_data: surface_distances(&mesh, self.data),
            from_data: surface_distances(self.data, &mesh),
            data_curvatures_per_m: middle_range(&triangulation_mean_curvatures_per_m(self.data)),
            curvatures_per_m: middle_range(&triangulation_mean_curvatures_per_m(&mesh)),
            density_correlation: density_correlation(&simplex, &curvatures),
            data_volume_m3: self.data_volume_m3,
            volume_m3: topology.volume_m3,
            volume_offset_m,
            n_without_data: done.n_without_data,
            n_untangled: done.n_untangled + n_smoothed,
            adapted: done.adapted,
        };
        Ok(SimplexFit { simplex, mesh, report })
    }

    /// Moves the dual along its normals to the data's volume, unless that takes a large move or makes sheets
    /// cross. Answers the distance [m].
    fn restore_volume(&self, mesh: &mut TriMesh) -> f64 {
        let mut moved = mesh.clone();
        let most_m = LARGEST_VOLUME_OFFSET_SPACINGS * self.spacing_m;
        match offset_to_volume(&mut moved, self.data_volume_m3) {
            Ok(offset_m) if offset_m.abs() <= most_m && self_intersections(&moved, 1).is_empty() => {
                *mesh = moved;
                offset_m
            }
            _ => 0.0,
        }
    }
}

/// Mean curvatures averaged over the rigidity [1/m].
fn smooth_curvatures(simplex: &SimplexMesh, rigidity: usize) -> Vec<f64> {
    Neighbourhoods::within(simplex, rigidity.max(2)).means(&mean_curvatures_per_m(simplex))
}
