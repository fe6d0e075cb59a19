//! From a voxel mask to the closed, smooth, outward oriented surface of the same volume.
//!
//! 1. The mask becomes one well-composed ball ([`repair_to_ball`]).
//! 2. Naive surface nets (S. Gibson, "Constrained elastic surface nets", 1998, doi 10.1007/BFb0056277): one
//!    vertex in each cell of 2 x 2 x 2 voxel centres that the surface passes, a quadrilateral around each
//!    pair of neighbouring voxels it separates; a manifold, because the set is well-composed.
//! 3. A low-pass filter flattens the steps of the slices. As Gibson does, no vertex may leave the
//!    surroundings of its cell, so that the filter may be wide where the surface is flat without taking away
//!    thin parts; a second, narrower pass smooths what that bound leaves.
//! 4. The volume is restored along the normals, the triangles are thinned out to the wanted number.
//!
//! Where smoothing makes sheets cross, the vertices around go back towards the centres of their cells,
//! where they cannot.

use fast_surface_nets::ndshape::RuntimeShape;
use fast_surface_nets::{SurfaceNetsBuffer, surface_nets};

use super::TriMesh;
use super::check::check_closed;
use super::decimate::decimate;
use super::error::{Place, SurfaceError};
use super::intersect::{Crossings, self_intersections};
use super::smooth::{EdgeGraph, offset_to_volume};
use crate::image::VoxelGrid;
use crate::image::resample::VoxelBox;
use crate::image::topology::{TopologyRepair, repair_to_ball};
use crate::math::DVec3;
use crate::progress::tell;

/// How a mask becomes a surface.
#[derive(Clone, Debug, PartialEq)]
pub struct SurfaceParams {
    /// Number of triangles wanted; met within one. None: as many as the voxels give.
    pub target_triangles: Option<usize>,
    /// Waves shorter than this are smoothed away as far as the voxels leave it open [m]; 0: none. None:
    /// twelve times the largest spacing, within 12 and 20 mm, which flattens the steps where slices cut the
    /// surface at a slope of one in ten.
    pub smoothing_wavelength_m: Option<f64>,
    /// Close a label that touches the end of the image by a flat cap instead of refusing it.
    pub cap_at_border: bool,
    /// Largest share of the mask's voxels that the repair of its topology may change.
    pub largest_repair: f64,
}

impl Default for SurfaceParams {
    fn default() -> Self {
        Self {
            target_triangles: None,
            smoothing_wavelength_m: None,
            cap_at_border: false,
            largest_repair: 0.05,
        }
    }
}

/// What came out, and what was done for it.
#[derive(Clone, Debug, PartialEq)]
pub struct SurfaceReport {
    /// What the repair of the mask changed.
    pub repair: TopologyRepair,
    /// Volume of the repaired mask's voxels [m3].
    pub voxel_volume_m3: f64,
    /// Volume that the surface encloses [m3].
    pub surface_volume_m3: f64,
    /// Area of the surface [m2].
    pub area_m2: f64,
    /// Vertices of the surface.
    pub n_vertices: usize,
    /// Triangles before decimation.
    pub n_triangles_extracted: usize,
    /// Triangles of the surface.
    pub n_triangles: usize,
    /// Euler number of the surface: 2.
    pub euler_characteristic: i64,
    /// Mean distance by which smoothing moved a vertex [m].
    pub mean_smoothing_m: f64,
    /// Largest distance by which smoothing moved a vertex [m].
    pub max_smoothing_m: f64,
    /// Vertices moved back because smoothing had made sheets cross.
    pub n_untangled_vertices: usize,
    /// Share of the smoothing that was kept: 1, or less for a body too small for the wavelength.
    pub smoothing_share: f64,
}

/// Largest deviation of axes^T axes from one.
const LARGEST_SKEW: f64 = 1e-4;
/// Default wavelength in largest spacings, and its range [m].
const WAVELENGTH_SPACINGS: f64 = 12.0;
const WAVELENGTH_RANGE_M: [f64; 2] = [12e-3, 20e-3];
/// How far the filter may take a vertex from where the net has it, along each image axis, in geometric means
/// of that axis' spacing and the largest. Half a spacing is where the middle line of the steps lies; on
/// slopes the steps of thick slices are as deep across as along.
const LARGEST_MOVE_SPACINGS: f64 = 0.6;
/// The second pass's wavelength in largest spacings: it has no bound and must not move thin parts.
const SECOND_PASS_SPACINGS: f64 = 2.4;
/// Shares of the smoothing tried until the volume can be restored.
const SMOOTHING_SHARES: [f64; 4] = [1.0, 0.5, 0.25, 0.125];
/// Rounds of moving vertices back; by the last, whole neighbourhoods are in their cells.
const MOST_UNTANGLING_ROUNDS: usize = 12;

/// The surface of the voxels of `mask` (`grid.n_voxels()` values, i fastest) in the patient frame: closed,
/// outward oriented for left- and right-handed axes alike, one ball, of the repaired mask's volume.
///
/// # Errors
/// [`SurfaceError`]: an empty mask or one that touches the image's border, a repair or decimation beyond what
/// `params` allow, axes that are not orthonormal.
pub fn surface_of_mask(
    grid: &VoxelGrid,
    mask: &[bool],
    params: &SurfaceParams,
) -> Result<(TriMesh, SurfaceReport), SurfaceError> {
    surface_and_solid(grid, mask, params).map(|(surface, report, _)| (surface, report))
}

/// As [`surface_of_mask`], with the repaired mask.
pub(super) fn surface_and_solid(
    grid: &VoxelGrid,
    mask: &[bool],
    params: &SurfaceParams,
) -> Result<(TriMesh, SurfaceReport, Vec<bool>), SurfaceError> {
    check_parameters(grid, params)?;
    tell(0.0);
    let mut solid = mask.to_vec();
    let repair = repair_to_ball(grid, &mut solid)?;
    check_border(grid, mask, params)?;
    check_repair(&repair, params)?;
    let n_voxels = repair.voxels_before + repair.voxels_added - repair.voxels_removed;
    let voxel_volume_m3 = n_voxels as f64 * grid.voxel_volume_m3();

    tell(0.3);
    let net = extract(grid, &solid);
    tell(0.5);
    let n_triangles_extracted = net.triangles.len();
    let smoothed = smooth(grid, &net, params, voxel_volume_m3)?;
    let mut surface = grid_to_patient(grid, &smoothed.mesh_m);
    tell(0.9);
    if let Some(target) = params.target_triangles {
        surface = decimate(&surface, target)?;
        restore_volume(&mut surface, voxel_volume_m3)?;
    }
    let topology = check_closed(&surface)?;
    let report = SurfaceReport {
        repair,
        voxel_volume_m3,
        surface_volume_m3: topology.volume_m3,
        area_m2: topology.area_m2,
        n_vertices: topology.n_vertices,
        n_triangles_extracted,
        n_triangles: topology.n_triangles,
        euler_characteristic: topology.euler_characteristic,
        mean_smoothing_m: smoothed.mean_move_m,
        max_smoothing_m: smoothed.max_move_m,
        n_untangled_vertices: smoothed.n_untangled,
        smoothing_share: smoothed.smoothing_share,
    };
    Ok((surface, report, solid))
}

fn check_parameters(grid: &VoxelGrid, params: &SurfaceParams) -> Result<(), SurfaceError> {
    let wrong = |name, found, allowed| Err(SurfaceError::Parameter { name, found, allowed });
    if let Some(wavelength_m) = params.smoothing_wavelength_m
        && !(0.0..=1.0).contains(&wavelength_m)
    {
        return wrong("smoothing wavelength [m]", wavelength_m, "0 to 1");
    }
    if let Some(target) = params.target_triangles
        && target < 4
    {
        return wrong("wanted number of triangles", target as f64, "at least 4");
    }
    let off = grid.axes.transpose() * grid.axes - crate::math::DMat3::IDENTITY;
    let skew = off.to_cols_array().into_iter().fold(0.0, |m: f64, x| m.max(x.abs()));
    // Headers store single precision.
    if skew.is_nan() || skew > LARGEST_SKEW {
        return wrong("deviation of the image axes from orthonormal", skew, "at most 0.0001");
    }
    if !grid.origin_m.is_finite() {
        return wrong("image origin [m]", grid.origin_m.length(), "finite coordinates");
    }
    Ok(())
}

/// Looks at the mask as given: a repair never grows beyond its box.
fn check_border(grid: &VoxelGrid, mask: &[bool], params: &SurfaceParams) -> Result<(), SurfaceError> {
    if params.cap_at_border {
        return Ok(());
    }
    let mut n_voxels = [[0usize; 2]; 3];
    for index in (0..mask.len()).filter(|&v| mask[v]) {
        let voxel = grid.voxel(index);
        for axis in 0..3 {
            n_voxels[axis][0] += usize::from(voxel[axis] == 0);
            n_voxels[axis][1] += usize::from(voxel[axis] + 1 == grid.dims[axis]);
        }
    }
    for (axis, name) in ['i', 'j', 'k'].into_iter().enumerate() {
        for (end, side) in ["lower", "upper"].into_iter().enumerate() {
            let n_voxels = n_voxels[axis][end];
            if n_voxels > 0 {
                return Err(SurfaceError::TouchesBorder { axis: name, side, n_voxels });
            }
        }
    }
    Ok(())
}

fn check_repair(repair: &TopologyRepair, params: &SurfaceParams) -> Result<(), SurfaceError> {
    let voxels = repair.voxels_before;
    let changed = repair.voxels_added + repair.voxels_removed;
    let allowed = (params.largest_repair * voxels as f64) as usize;
    if changed > allowed {
        return Err(SurfaceError::RepairTooLarge { changed, voxels, allowed });
    }
    Ok(())
}

/// A net over the voxels, in fractional voxel coordinates.
struct Net {
    /// Where surface nets put the vertices.
    voxels: Vec<DVec3>,
    /// Centres of the vertices' cells.
    cells: Vec<DVec3>,
    /// Outward for right-handed axes.
    triangles: Vec<[u32; 3]>,
}

fn extract(grid: &VoxelGrid, solid: &[bool]) -> Net {
    let part = VoxelBox::around(grid, solid, 0.0).expect("repair refuses an empty mask");
    // Two layers outside on each side: surface nets make no faces in the last one.
    let dims = part.dims.map(|n| n + 4);
    let shape = RuntimeShape::<u32, 3>::new(dims.map(|d| u32::try_from(d).expect("repair bounds the box")));
    let mut field = vec![1f32; dims.iter().product()];
    for (row, voxels) in part.cut(grid, solid).chunks_exact(part.dims[0]).enumerate() {
        let (j, k) = (row % part.dims[1], row / part.dims[1]);
        let to = &mut field[2 + dims[0] * ((j + 2) + dims[1] * (k + 2))..];
        to.iter_mut().zip(voxels).filter(|(_, solid)| **solid).for_each(|(value, _)| *value = -1.0);
    }
    let mut buffer = SurfaceNetsBuffer::default();
    surface_nets(&field, &shape, [0; 3], dims.map(|d| d as u32 - 1), &mut buffer);
    let origin = DVec3::from_array(part.first.map(|v| v as f64)) - 2.0;
    let at = |p: [f32; 3]| origin + DVec3::from_array(p.map(f64::from));
    Net {
        voxels: buffer.positions.iter().map(|&p| at(p)).collect(),
        cells: buffer.surface_points.iter().map(|&p| at(p.map(|x| x as f32 + 0.5))).collect(),
        triangles: buffer.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
    }
}

struct Smoothed {
    /// Along the image axes [m], from voxel (0, 0, 0).
    mesh_m: TriMesh,
    mean_move_m: f64,
    max_move_m: f64,
    n_untangled: usize,
    smoothing_share: f64,
}

/// Restores the volume by an offset within [`LARGEST_MOVE_SPACINGS`]. A body that is all edges, smaller than
/// the filter's wavelength, loses too much for that: then half of the smoothing is undone, and again.
/// Answers the share of the smoothing that is left.
fn keep_volume(
    mesh: &mut TriMesh,
    given_m: &[DVec3],
    volume_m3: f64,
    grid: &VoxelGrid,
) -> Result<f64, SurfaceError> {
    let smooth_m = mesh.positions_m.clone();
    let most_m = LARGEST_MOVE_SPACINGS * grid.spacing_m.max_element();
    for share in SMOOTHING_SHARES {
        for (position, (&given, &smooth)) in mesh.positions_m.iter_mut().zip(given_m.iter().zip(&smooth_m)) {
            *position = given.lerp(smooth, share);
        }
        let mut moved = mesh.clone();
        if offset_to_volume(&mut moved, volume_m3).is_ok_and(|offset_m| offset_m.abs() <= most_m) {
            *mesh = moved;
            return Ok(share);
        }
    }
    mesh.positions_m.copy_from_slice(given_m);
    restore_volume(mesh, volume_m3)?;
    Ok(0.0)
}

fn smooth(
    grid: &VoxelGrid,
    net: &Net,
    params: &SurfaceParams,
    volume_m3: f64,
) -> Result<Smoothed, SurfaceError> {
    let given: Vec<DVec3> = net.voxels.iter().map(|&p| p * grid.spacing_m).collect();
    let cells: Vec<DVec3> = net.cells.iter().map(|&p| p * grid.spacing_m).collect();
    let mut mesh_m = TriMesh { positions_m: given.clone(), triangles: net.triangles.clone() };
    let default_m = WAVELENGTH_SPACINGS * grid.spacing_m.max_element();
    let wavelength_m = params
        .smoothing_wavelength_m
        .unwrap_or(default_m.clamp(WAVELENGTH_RANGE_M[0], WAVELENGTH_RANGE_M[1]));
    let graph = EdgeGraph::of_mesh(&mesh_m);
    if wavelength_m > 0.0 {
        let largest_m = grid.spacing_m.max_element();
        let most = LARGEST_MOVE_SPACINGS * (grid.spacing_m * largest_m).map(f64::sqrt);
        let wide = graph.low_pass(&given, wavelength_m);
        let bounded: Vec<DVec3> =
            wide.iter().zip(&given).map(|(&w, &g)| g + (w - g).clamp(-most, most)).collect();
        let second_m = wavelength_m.min(SECOND_PASS_SPACINGS * largest_m);
        mesh_m.positions_m = graph.low_pass(&bounded, second_m);
    }
    let smoothing_share = keep_volume(&mut mesh_m, &given, volume_m3, grid)?;
    let n_untangled = untangle(&mut mesh_m, &cells, &graph)?;
    if n_untangled > 0 {
        restore_volume(&mut mesh_m, volume_m3)?;
    }
    let moves = mesh_m.positions_m.iter().zip(&given).map(|(&p, &g)| (p - g).length());
    let (sum, max_move_m) = moves.fold((0.0, 0.0f64), |(sum, most), d| (sum + d, most.max(d)));
    Ok(Smoothed { mean_move_m: sum / given.len() as f64, max_move_m, n_untangled, smoothing_share, mesh_m })
}

/// Moves vertices of crossing triangles and their surroundings towards `safe_m` until none cross; answers how
/// many were moved.
pub(super) fn untangle(
    mesh: &mut TriMesh,
    safe_m: &[DVec3],
    graph: &EdgeGraph,
) -> Result<usize, SurfaceError> {
    let smooth_m = mesh.positions_m.clone();
    // 1: smooth, 0: safe.
    let mut share = vec![1.0f64; smooth_m.len()];
    let mut crossings = Crossings::of(mesh);
    for round in 0..=MOST_UNTANGLING_ROUNDS {
        let pairs = &crossings.pairs;
        let Some(first) = pairs.first() else { break };
        if round == MOST_UNTANGLING_ROUNDS {
            let place = Place(mesh.corners_m(first[0] as usize)[0]);
            return Err(SurfaceError::Tangled { stage: "smoothing", n: pairs.len(), place });
        }
        let mut ring: Vec<u32> = pairs.iter().flatten().flat_map(|&t| mesh.triangles[t as usize]).collect();
        let mut reached = vec![false; smooth_m.len()];
        let n_rings = 2 + round;
        for distance in 0..n_rings {
            ring.retain(|&v| !std::mem::replace(&mut reached[v as usize], true));
            // Halves the share of the innermost, less farther out; from the sixth round on all go home.
            let keep = if round > 5 { 0.0 } else { 0.5 + 0.5 * distance as f64 / n_rings as f64 };
            for &v in &ring {
                share[v as usize] *= keep;
            }
            ring = ring.iter().flat_map(|&v| graph.neighbours(v as usize)).copied().collect();
        }
        for v in (0..smooth_m.len()).filter(|&v| reached[v]) {
            mesh.positions_m[v] = safe_m[v].lerp(smooth_m[v], share[v]);
        }
        crossings.follow(mesh, &reached);
    }
    Ok(share.iter().filter(|&&s| s < 1.0).count())
}

/// Brings the volume to `volume_m3`: by an offset, or, where that makes sheets cross, by scaling about the
/// middle, which cannot.
fn restore_volume(mesh: &mut TriMesh, volume_m3: f64) -> Result<(), SurfaceError> {
    let mut moved = mesh.clone();
    if offset_to_volume(&mut moved, volume_m3).is_ok() && self_intersections(&moved, 1).is_empty() {
        *mesh = moved;
        return Ok(());
    }
    let centre_m = crate::math::Aabb::of_points(&mesh.positions_m).center_m();
    let factor = libm::cbrt(volume_m3 / mesh.volume_m3());
    if !(factor.is_finite() && factor > 0.0) {
        let allowed = "that of a surface with positive volume";
        return Err(SurfaceError::Parameter { name: "volume [m3]", found: volume_m3, allowed });
    }
    for position in &mut mesh.positions_m {
        *position = centre_m + factor * (*position - centre_m);
    }
    Ok(())
}

/// From image axes to the patient frame; left-handed axes mirror, so the triangles are turned over.
fn grid_to_patient(grid: &VoxelGrid, mesh_m: &TriMesh) -> TriMesh {
    let mut mesh = TriMesh {
        positions_m: mesh_m.positions_m.iter().map(|&p| grid.origin_m + grid.axes * p).collect(),
        triangles: mesh_m.triangles.clone(),
    };
    if grid.axes.determinant() < 0.0 {
        for triangle in &mut mesh.triangles {
            triangle.swap(1, 2);
        }
    }
    mesh
}
