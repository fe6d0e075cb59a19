//! The dual surface of a solid set of nodes, its vertices on the old surface where that passes.
//!
//! Surface nets (S. Gibson, "Constrained elastic surface nets", 1998, doi 10.1007/BFb0056277): one vertex in
//! each cell that has nodes on both sides, a quadrilateral around each grid line that leaves the solid. A
//! vertex goes from the mean of its cell's crossings to where the planes of the old triangles at the crossings
//! meet, which keeps edges and corners sharp (T. Ju, F. Losasso, S. Schaefer and J. Warren, "Dual contouring
//! of Hermite data", 2002, doi 10.1145/566654.566586), then to the closest point of the old surface, within
//! its cell. Of a well-composed set this is a manifold; with all vertices in the middles of their cells
//! nothing crosses.

use rayon::prelude::*;

use super::field::Field;
use super::solid::Solid;
use crate::math::{DMat3, DVec3, closest_point_barycentric, outer};
use crate::surface::TriMesh;
use crate::surface::check::{Side, SurfaceTopology, check_closed, has_no_area};
use crate::surface::error::SurfaceError;
use crate::surface::extract::untangle;
use crate::surface::smooth::EdgeGraph;
use crate::surface::winding::WindingTree;

/// How far a vertex may be from the middle of its cell along each axis [cells]: not on the cell's border, so
/// that no two coincide.
const CELL_SHARE: f64 = 0.48;
/// A grid line is taken to cross the old surface when its ends' distances sum to no more than this
/// [spacings]: 1 for a plane across, more for a slanted or bent one that touches the line only near by.
const CROSSING_SPACINGS: f64 = 1.05;
/// Across the old surface the winding number jumps by one; less than this is taken for the slope of a hole's
/// film.
const SMALLEST_JUMP: f64 = 0.6;
/// A vertex goes to a point of the old surface no farther than this [spacings]: the diagonal of a cell.
const PROJECTION_SPACINGS: f64 = 1.74;
/// Weight of staying at the mean against the planes: directions in which they hardly differ do not count.
const STAY: f64 = 0.01;
/// Closer to a rim than this [spacings] is on the old surface, not over a hole: cracks are no holes.
const RIM_SPACINGS: f64 = 0.1;

/// Share of its way to the middle of its cell that a corner of a triangle without area goes, and how often.
const WIDENING: f64 = 0.3;
const MOST_WIDENINGS: usize = 12;

/// The new surface.
pub(super) struct Net {
    pub(super) mesh: TriMesh,
    /// Whether each vertex belongs to the old surface and not to what closes a hole.
    pub(super) is_on_old: Vec<bool>,
    /// Vertices held back so that nothing crosses.
    pub(super) n_held_back: usize,
    pub(super) topology: SurfaceTopology,
}

/// The old surface with the rims of its holes.
pub(super) struct Old<'a> {
    pub(super) mesh: &'a TriMesh,
    pub(super) tree: WindingTree<'a>,
    /// Whether the side from each corner of each triangle belongs to this triangle only.
    open_sides: Vec<[bool; 3]>,
    /// Whether each vertex is at the end of such a side.
    open_vertices: Vec<bool>,
}

impl<'a> Old<'a> {
    /// Prepares `mesh`, whose sides are `sides`.
    pub(super) fn of(mesh: &'a TriMesh, sides: &[Side]) -> Self {
        let mut open_sides = vec![[false; 3]; mesh.triangles.len()];
        let mut open_vertices = vec![false; mesh.positions_m.len()];
        for edge in sides.chunk_by(|a, b| (a.low, a.high) == (b.low, b.high)) {
            let [side] = edge else { continue };
            let triangle = mesh.triangles[side.triangle as usize];
            for c in 0..3 {
                let ends = [triangle[c], triangle[(c + 1) % 3]];
                open_sides[side.triangle as usize][c] |=
                    ends.contains(&side.low) && ends.contains(&side.high);
            }
            open_vertices[side.low as usize] = true;
            open_vertices[side.high as usize] = true;
        }
        Self { mesh, tree: WindingTree::of_triangles(mesh), open_sides, open_vertices }
    }

    /// The point near `mean_m` with the least squared distances from the planes of the triangles closest to
    /// `points_m`.
    fn where_planes_meet(
        &self,
        points_m: impl Iterator<Item = DVec3>,
        mean_m: DVec3,
        spacing_m: f64,
    ) -> DVec3 {
        let (mut matrix, mut pull, mut n) = (DMat3::ZERO, DVec3::ZERO, 0.0);
        for point_m in points_m {
            let Some((t, at_m, _)) = self.tree.closest(point_m, spacing_m) else { continue };
            let [a, b, c] = self.mesh.corners_m(t as usize);
            let normal = (b - a).cross(c - a).normalize_or_zero();
            matrix += outer(normal, normal);
            pull += normal.dot(at_m - mean_m) * normal;
            n += 1.0;
        }
        if n == 0.0 {
            return mean_m;
        }
        mean_m + (matrix + DMat3::from_diagonal(DVec3::splat(STAY * n))).inverse() * pull
    }

    /// The point of the surface closest to `point_m`, unless it is too far or `point_m` is over a hole.
    fn below(&self, point_m: DVec3, spacing_m: f64) -> Option<DVec3> {
        let (t, at_m, distance_m) = self.tree.closest(point_m, PROJECTION_SPACINGS * spacing_m)?;
        let t = t as usize;
        let weights = closest_point_barycentric(point_m, self.mesh.corners_m(t));
        let is_at_rim = (0..3).any(|c| {
            let [own, next, last] = [0, 1, 2].map(|d| weights[(c + d) % 3]);
            let is_at_corner = next == 0.0 && last == 0.0;
            let is_at_side = last == 0.0 && own > 0.0 && next > 0.0;
            (is_at_corner && self.open_vertices[self.mesh.triangles[t][c] as usize])
                || (is_at_side && self.open_sides[t][c])
        });
        (!is_at_rim || distance_m <= RIM_SPACINGS * spacing_m).then_some(at_m)
    }
}

/// Where the vertex of a cell may be.
struct Site {
    middle_m: DVec3,
    /// Mean of the crossings.
    mean_m: DVec3,
    /// On the old surface closest to the mean, as far as the cell reaches.
    projected_m: DVec3,
    /// The same at the edge or corner of the old surface within the cell.
    placed_m: DVec3,
    is_on_old: bool,
}

/// The closed surface of `solid`, outward oriented.
///
/// # Errors
/// [`SurfaceError`] if even the plain net is not closed, which a well-composed solid rules out.
pub(super) fn surface_of(field: &Field, solid: &Solid, old: &Old<'_>) -> Result<Net, SurfaceError> {
    let cells: Vec<usize> = solid.cells().filter(|&low| !matches!(solid.pattern(low), 0 | 255)).collect();
    let sites: Vec<Site> = cells.par_iter().map(|&low| site(field, solid, old, low)).collect();
    let of = |place: fn(&Site) -> DVec3| -> Vec<DVec3> { sites.iter().map(place).collect() };
    let (placed_m, middles_m, means_m) = (of(|s| s.placed_m), of(|s| s.middle_m), of(|s| s.mean_m));
    let triangles = triangles(solid, &cells, &placed_m);
    let is_on_old: Vec<bool> = sites.iter().map(|s| s.is_on_old).collect();
    let mut mesh = TriMesh { positions_m: placed_m, triangles };
    let graph = EdgeGraph::of_mesh(&mesh);
    // What crosses goes back to the means, where little does; the middles, where nothing does, are a cell's
    // half away from the old surface.
    if let Some((n_held_back, topology)) = closed(&mut mesh, &means_m, &middles_m, &graph) {
        return Ok(Net { mesh, is_on_old, n_held_back, topology });
    }
    let n_held_back = mesh.positions_m.len();
    for start_m in [of(|s| s.projected_m), means_m] {
        mesh.positions_m = start_m;
        if let Some((_, topology)) = closed(&mut mesh, &middles_m, &middles_m, &graph) {
            return Ok(Net { mesh, is_on_old, n_held_back, topology });
        }
    }
    mesh.positions_m = middles_m;
    let topology = check_closed(&mesh)?;
    Ok(Net { mesh, is_on_old, n_held_back, topology })
}

/// Moves vertices of `mesh` towards `middles_m` where triangles have no area, towards `safe_m` where they
/// cross; answers how many and what the closed surface is.
fn closed(
    mesh: &mut TriMesh,
    safe_m: &[DVec3],
    middles_m: &[DVec3],
    graph: &EdgeGraph,
) -> Option<(usize, SurfaceTopology)> {
    let mut n_widened = 0;
    for _ in 0..MOST_WIDENINGS {
        let flat: Vec<usize> =
            (0..mesh.triangles.len()).filter(|&t| has_no_area(mesh.corners_m(t))).collect();
        n_widened += 3 * flat.len();
        for &v in flat.iter().flat_map(|&t| &mesh.triangles[t]).collect::<Vec<_>>() {
            let v = v as usize;
            mesh.positions_m[v] = mesh.positions_m[v].lerp(middles_m[v], WIDENING);
        }
        if !flat.is_empty() {
            continue;
        }
        let n_untangled = untangle(mesh, safe_m, graph).ok()?;
        match check_closed(mesh) {
            Ok(topology) => return Some((n_widened + n_untangled, topology)),
            Err(SurfaceError::Degenerate { .. }) => {}
            Err(_) => return None,
        }
    }
    None
}

fn site(field: &Field, solid: &Solid, old: &Old<'_>, low: usize) -> Site {
    let [nx, ny, _] = solid.dims;
    let spacing_m = field.band.spacing_m();
    let low_m = field.band.node_position_m([low % nx, low / nx % ny, low / (nx * ny)]);
    let middle_m = low_m + 0.5 * spacing_m;
    let nodes = solid.cell_nodes(low);
    let distance_m = field.band.values_m();
    let mut crossings: Vec<(DVec3, bool)> = Vec::with_capacity(12);
    for (c, d) in (0..8usize).flat_map(|c| [1, 2, 4].map(|bit| (c, c | bit))).filter(|(c, d)| c != d) {
        if solid.inside[nodes[c]] == solid.inside[nodes[d]] {
            continue;
        }
        let (a, b) = (nodes[c], nodes[d]);
        let is_crossed = distance_m[a] + distance_m[b] <= CROSSING_SPACINGS * spacing_m
            && (field.winding[a] - field.winding[b]).abs() >= SMALLEST_JUMP;
        let along = if is_crossed {
            distance_m[a] / (distance_m[a] + distance_m[b])
        } else {
            (field.winding[a] - 0.5) / (field.winding[a] - field.winding[b])
        };
        // Nodes that mending added are on the wrong side of both measures.
        let along = if along.is_finite() { along.clamp(0.0, 1.0) } else { 0.5 };
        let corner = |c: usize| DVec3::new((c & 1) as f64, (c >> 1 & 1) as f64, (c >> 2) as f64);
        crossings.push((low_m + spacing_m * corner(c).lerp(corner(d), along), is_crossed));
    }
    let most_m = DVec3::splat(CELL_SHARE * spacing_m);
    let in_cell = |p: DVec3| p.clamp(middle_m - most_m, middle_m + most_m);
    let mean_m = in_cell(crossings.iter().map(|c| c.0).sum::<DVec3>() / crossings.len() as f64);
    let crossed_m = crossings.iter().filter(|c| c.1).map(|c| c.0);
    let sharp_m = old.where_planes_meet(crossed_m, mean_m, spacing_m);
    let is_far = (sharp_m - middle_m).abs().cmpgt(most_m).any();
    let below_m = old.below(if is_far { mean_m } else { sharp_m }, spacing_m);
    let placed_m = below_m.map_or(mean_m, in_cell);
    let projected_m = old.below(mean_m, spacing_m).map_or(mean_m, in_cell);
    Site { middle_m, mean_m, projected_m, placed_m, is_on_old: below_m.is_some() }
}

/// Two triangles for each grid line between a node inside and one outside, divided along the shorter
/// diagonal.
fn triangles(solid: &Solid, cells: &[usize], positions_m: &[DVec3]) -> Vec<[u32; 3]> {
    let mut vertex_of = vec![u32::MAX; solid.inside.len()];
    for (v, &low) in cells.iter().enumerate() {
        vertex_of[low] = u32::try_from(v).expect("fewer than 2^32 cells are cut");
    }
    let strides = [1, solid.dims[0], solid.dims[0] * solid.dims[1]];
    let mut list = Vec::with_capacity(2 * cells.len());
    for at in (0..solid.inside.len()).filter(|&at| solid.inside[at]) {
        for axis in 0..3 {
            let (u, v) = (strides[(axis + 1) % 3], strides[(axis + 2) % 3]);
            for (other, low) in [(at + strides[axis], at), (at - strides[axis], at - strides[axis])] {
                if solid.inside[other] {
                    continue;
                }
                // Counter-clockwise seen against the axis.
                let mut quad = [low - u - v, low - v, low, low - u].map(|cell| vertex_of[cell]);
                if other < at {
                    quad.reverse();
                }
                let [a, b, c, d] = quad;
                let length =
                    |a: u32, b: u32| positions_m[a as usize].distance_squared(positions_m[b as usize]);
                list.extend(if length(a, c) <= length(b, d) {
                    [[a, b, c], [a, c, d]]
                } else {
                    [[a, b, d], [b, c, d]]
                });
            }
        }
    }
    list
}
