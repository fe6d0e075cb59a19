//! Signed distance of a closed triangle surface on a regular grid: negative inside.
//!
//! - Sign: along every grid line parallel to x the surface's crossings are summed with their orientation;
//!   a node is inside where the sum, the winding number, is positive. The crossing test of a projected
//!   triangle is the half-open winding rule over exact orientation signs (Shewchuk 1997,
//!   doi 10.1007/PL00009321), the same decision for both triangles of an edge, so a closed surface never
//!   leaks, however its triangles fall on the grid lines.
//! - Near field: exact distance to the closest triangle within [`BAND_CELLS`] cells of the surface.
//! - Far field: the eikonal equation |grad d| = 1 by fast sweeping (Zhao, A fast sweeping method for Eikonal
//!   equations, 2005, doi 10.1090/S0025-5718-04-01678-3): first order, right to about one cell.

use super::TriMesh;
use crate::math::{Aabb, DVec3, closest_point_barycentric};
use robust::{Coord, orient2d};

/// Half-width [cells] of the band in which distances are exact: above sqrt(3), so that all eight corners of
/// a cell that the surface crosses are in it.
pub const BAND_CELLS: f64 = 1.8;

/// Largest number of grid nodes that is accepted: 0.5 GB.
const MAX_NODES: usize = 64_000_000;

/// Rounds of the eight sweeping directions. Two follow every characteristic that turns once.
const SWEEP_ROUNDS: usize = 2;

/// Why a signed distance cannot be computed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SignedDistanceError {
    /// No triangles.
    #[error("the surface has no triangles: there is no distance to it")]
    Empty,
    /// A triangle names a vertex that does not exist.
    #[error(
        "triangle {triangle} names vertex {vertex}, but there are {n_vertices} (0 to {n_vertices} - 1 are allowed)"
    )]
    UnknownVertex {
        /// Which triangle.
        triangle: usize,
        /// The vertex it names.
        vertex: u32,
        /// How many there are.
        n_vertices: usize,
    },
    /// A coordinate is not a finite number.
    #[error("vertex {vertex} is at {position_m} m: finite coordinates are needed")]
    NotFinite {
        /// Which vertex.
        vertex: usize,
        /// Where it is.
        position_m: DVec3,
    },
    /// The spacing is not a positive number.
    #[error("grid spacing is {found_m} m: a positive finite number is needed")]
    Spacing {
        /// What was asked for.
        found_m: f64,
    },
    /// The grid would not fit.
    #[error(
        "a grid of {spacing_m} m over a surface of {size_m} m has more than {MAX_NODES} nodes: take a larger spacing"
    )]
    TooFine {
        /// What was asked for [m].
        spacing_m: f64,
        /// Edge lengths of the surface's box [m].
        size_m: DVec3,
    },
}

/// Values of the signed distance at the nodes of a regular grid, x fastest; trilinear between them.
#[derive(Clone, Debug, PartialEq)]
pub struct SignedDistance {
    dims: [usize; 3],
    spacing_m: f64,
    origin_m: DVec3,
    values_m: Vec<f64>,
}

impl SignedDistance {
    /// Signed distance [m] of a closed `surface`, outward oriented, on a grid of `spacing_m` that reaches
    /// `margin_m` beyond the surface's box on every side.
    ///
    /// A surface that is not closed gives signs without meaning, never a panic: check it before.
    ///
    /// # Errors
    /// [`SignedDistanceError`] for a surface without triangles or with wrong numbers, or too fine a grid.
    pub fn of_surface(surface: &TriMesh, spacing_m: f64, margin_m: f64) -> Result<Self, SignedDistanceError> {
        let mut field = Self::unsigned_band(surface, spacing_m, margin_m)?;
        field.sweep();
        field.set_signs(surface);
        Ok(field)
    }

    /// Distances [m] without sign, exact within [`BAND_CELLS`] cells of `surface`, infinite elsewhere.
    ///
    /// # Errors
    /// As [`SignedDistance::of_surface`].
    pub(super) fn unsigned_band(
        surface: &TriMesh,
        spacing_m: f64,
        margin_m: f64,
    ) -> Result<Self, SignedDistanceError> {
        check_input(surface, spacing_m)?;
        let bounds_m = Aabb::of_points(&surface.positions_m).grown(margin_m.max(2.0 * spacing_m));
        let size = bounds_m.size_m() / spacing_m;
        let too_fine = SignedDistanceError::TooFine {
            spacing_m,
            size_m: Aabb::of_points(&surface.positions_m).size_m(),
        };
        let limit = MAX_NODES as f64;
        // Checked as floating-point numbers first: a grid far too fine must not overflow the integers.
        if (size.x + 2.0) * (size.y + 2.0) * (size.z + 2.0) > limit {
            return Err(too_fine);
        }
        let dims = [size.x, size.y, size.z].map(|s| s.ceil() as usize + 1);
        let n_nodes = dims.iter().product();
        let mut field =
            Self { dims, spacing_m, origin_m: bounds_m.min_m, values_m: vec![f64::INFINITY; n_nodes] };
        field.measure_band(surface);
        Ok(field)
    }

    /// Number of nodes along x, y, z.
    pub fn dims(&self) -> [usize; 3] {
        self.dims
    }

    /// Distance between neighbouring nodes [m].
    pub fn spacing_m(&self) -> f64 {
        self.spacing_m
    }

    /// Signed distances [m] at the nodes, x fastest.
    pub fn values_m(&self) -> &[f64] {
        &self.values_m
    }

    /// Node (i, j, k) of a place in the values.
    pub(crate) fn node(&self, at: usize) -> [usize; 3] {
        let [nx, ny, _] = self.dims();
        [at % nx, at / nx % ny, at / (nx * ny)]
    }

    /// Position [m] of node (i, j, k).
    pub fn node_position_m(&self, [i, j, k]: [usize; 3]) -> DVec3 {
        self.origin_m + self.spacing_m * DVec3::new(i as f64, j as f64, k as f64)
    }

    /// Box of the grid [m].
    pub fn bounds_m(&self) -> Aabb {
        let last = self.dims.map(|n| n - 1);
        Aabb { min_m: self.origin_m, max_m: self.node_position_m(last) }
    }

    /// Signed distance [m] at `point_m`, trilinear between the nodes. Outside the grid: the value at the
    /// closest point of the grid's border plus the distance to that point.
    pub fn sample_m(&self, point_m: DVec3) -> f64 {
        let bounds_m = self.bounds_m();
        let clamped_m = point_m.clamp(bounds_m.min_m, bounds_m.max_m);
        let at = (clamped_m - self.origin_m) / self.spacing_m;
        let cell = |x: f64, n: usize| (x as usize).min(n - 2);
        let [i, j, k] = [cell(at.x, self.dims[0]), cell(at.y, self.dims[1]), cell(at.z, self.dims[2])];
        let (u, v, w) = (at.x - i as f64, at.y - j as f64, at.z - k as f64);
        let (row, slab) = (self.dims[0], self.dims[0] * self.dims[1]);
        let base = i + row * j + slab * k;
        let line = |at: usize| self.values_m[at] + u * (self.values_m[at + 1] - self.values_m[at]);
        let plane = |at: usize| {
            let low = line(at);
            low + v * (line(at + row) - low)
        };
        let low = plane(base);
        low + w * (plane(base + slab) - low) + clamped_m.distance(point_m)
    }

    /// First and last grid index along `axis` within the interval [low, high]: the half-open range.
    fn index_range(&self, axis: usize, low_m: f64, high_m: f64) -> (usize, usize) {
        let first = ((low_m - self.origin_m[axis]) / self.spacing_m).ceil().max(0.0) as usize;
        let last = ((high_m - self.origin_m[axis]) / self.spacing_m).floor().max(-1.0) + 1.0;
        (first, (last as usize).min(self.dims[axis]))
    }

    /// Exact unsigned distances within the band.
    fn measure_band(&mut self, surface: &TriMesh) {
        let band_m = BAND_CELLS * self.spacing_m;
        for t in 0..surface.triangles.len() {
            let corners_m = surface.corners_m(t);
            let [a, b, c] = corners_m;
            let bounds_m = Aabb::of_points(&corners_m).grown(band_m);
            let normal = (b - a).cross(c - a);
            let reach = band_m * normal.length();
            let [x, y, z] =
                [0, 1, 2].map(|axis| self.index_range(axis, bounds_m.min_m[axis], bounds_m.max_m[axis]));
            for k in z.0..z.1 {
                for j in y.0..y.1 {
                    let row = self.dims[0] * (j + self.dims[1] * k);
                    for i in x.0..x.1 {
                        let node_m = self.node_position_m([i, j, k]);
                        // The plane is no farther than the triangle; a degenerate one has reach 0 = 0.
                        if (node_m - a).dot(normal).abs() > reach {
                            continue;
                        }
                        let [wa, wb, wc] = closest_point_barycentric(node_m, corners_m);
                        let distance_m = node_m.distance(wa * a + wb * b + wc * c);
                        let value_m = &mut self.values_m[row + i];
                        if distance_m <= band_m && distance_m < *value_m {
                            *value_m = distance_m;
                        }
                    }
                }
            }
        }
    }

    /// Continues the band's unsigned distances over the grid.
    fn sweep(&mut self) {
        let [nx, ny, nz] = self.dims;
        let fixed: Vec<bool> = self.values_m.iter().map(|v| v.is_finite()).collect();
        let ordered = |n: usize, down: bool, at: usize| if down { n - 1 - at } else { at };
        for direction in 0..8 * SWEEP_ROUNDS {
            let down = [direction & 1 != 0, direction & 2 != 0, direction & 4 != 0];
            for kk in 0..nz {
                let k = ordered(nz, down[2], kk);
                for jj in 0..ny {
                    let j = ordered(ny, down[1], jj);
                    for ii in 0..nx {
                        let i = ordered(nx, down[0], ii);
                        let node = i + nx * (j + ny * k);
                        if !fixed[node] {
                            let smaller = |at: usize, n: usize, stride: usize| {
                                let below = if at > 0 { self.values_m[node - stride] } else { f64::INFINITY };
                                let above =
                                    if at + 1 < n { self.values_m[node + stride] } else { f64::INFINITY };
                                below.min(above)
                            };
                            let neighbours = [smaller(i, nx, 1), smaller(j, ny, nx), smaller(k, nz, nx * ny)];
                            let value_m = eikonal_update(neighbours, self.spacing_m);
                            if value_m < self.values_m[node] {
                                self.values_m[node] = value_m;
                            }
                        }
                    }
                }
            }
        }
    }

    /// Gives the nodes of positive winding number a negative distance.
    fn set_signs(&mut self, surface: &TriMesh) {
        let mut crossings: Vec<(usize, f64, i32)> = Vec::new();
        for t in 0..surface.triangles.len() {
            let corners_m = surface.corners_m(t);
            let bounds_m = Aabb::of_points(&corners_m);
            // Half a cell more than the box: which lines at its border cross is for the exact test alone.
            let near_m = bounds_m.grown(0.5 * self.spacing_m);
            let [y, z] = [1, 2].map(|axis| self.index_range(axis, near_m.min_m[axis], near_m.max_m[axis]));
            for k in z.0..z.1 {
                for j in y.0..y.1 {
                    let line_m = self.node_position_m([0, j, k]);
                    let winding = projected_winding(line_m, corners_m);
                    if winding != 0 {
                        let x_m = crossing_x_m(line_m, corners_m, bounds_m);
                        crossings.push((j + self.dims[1] * k, x_m, winding));
                    }
                }
            }
        }
        crossings.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2)));
        for line in crossings.chunk_by(|a, b| a.0 == b.0) {
            let row = self.dims[0] * line[0].0;
            // Outside the surface the orientations sum to zero; the outward normal's x is the crossing's
            // sign, so entering along +x counts -1.
            let (mut next, mut winding) = (0, 0);
            for i in 0..self.dims[0] {
                let x_m = self.origin_m.x + self.spacing_m * i as f64;
                while next < line.len() && line[next].1 < x_m {
                    winding -= line[next].2;
                    next += 1;
                }
                if winding > 0 {
                    self.values_m[row + i] = -self.values_m[row + i];
                }
            }
        }
    }
}

fn check_input(surface: &TriMesh, spacing_m: f64) -> Result<(), SignedDistanceError> {
    if surface.triangles.is_empty() {
        return Err(SignedDistanceError::Empty);
    }
    if !(spacing_m > 0.0 && spacing_m.is_finite()) {
        return Err(SignedDistanceError::Spacing { found_m: spacing_m });
    }
    if let Some(vertex) = surface.positions_m.iter().position(|p| !p.is_finite()) {
        return Err(SignedDistanceError::NotFinite { vertex, position_m: surface.positions_m[vertex] });
    }
    let n_vertices = surface.positions_m.len();
    for (triangle, corners) in surface.triangles.iter().enumerate() {
        if let Some(&vertex) = corners.iter().find(|&&v| v as usize >= n_vertices) {
            return Err(SignedDistanceError::UnknownVertex { triangle, vertex, n_vertices });
        }
    }
    Ok(())
}

/// Solution d [m] of |grad d| = 1 at a node, upwind of its closer neighbours along x, y, z.
fn eikonal_update(mut neighbours_m: [f64; 3], spacing_m: f64) -> f64 {
    let [a, b, c] = &mut neighbours_m;
    if a > b {
        std::mem::swap(a, b);
    }
    if b > c {
        std::mem::swap(b, c);
    }
    if a > b {
        std::mem::swap(a, b);
    }
    let [a, b, c] = neighbours_m;
    let one = a + spacing_m;
    if one <= b {
        return one;
    }
    let two = 0.5 * (a + b + (2.0 * spacing_m * spacing_m - (a - b) * (a - b)).max(0.0).sqrt());
    if two <= c {
        return two;
    }
    let sum = a + b + c;
    let squares = a * a + b * b + c * c;
    (sum + (sum * sum - 3.0 * (squares - spacing_m * spacing_m)).max(0.0).sqrt()) / 3.0
}

/// Winding number about `point` of a triangle seen along x: +1 when its normal's x is positive.
fn projected_winding(point: DVec3, corners: [DVec3; 3]) -> i32 {
    let mut winding = 0;
    for e in 0..3 {
        let (a, b) = (corners[e], corners[(e + 1) % 3]);
        let upward = a.z <= point.z && point.z < b.z;
        let downward = b.z <= point.z && point.z < a.z;
        if upward || downward {
            // The same two end points in the same order for both triangles of the edge: one decision.
            let (low, high) = if upward { (a, b) } else { (b, a) };
            let flat = |p: DVec3| Coord { x: p.y, y: p.z };
            if orient2d(flat(low), flat(high), flat(point)) > 0.0 {
                winding += if upward { 1 } else { -1 };
            }
        }
    }
    winding
}

/// Where the line through `line_m` along x meets the triangle's plane, kept within the triangle's box.
fn crossing_x_m(line_m: DVec3, [a, b, c]: [DVec3; 3], bounds_m: Aabb) -> f64 {
    let normal = (b - a).cross(c - a);
    let x_m = a.x - ((line_m.y - a.y) * normal.y + (line_m.z - a.z) * normal.z) / normal.x;
    if x_m.is_finite() { x_m.clamp(bounds_m.min_m.x, bounds_m.max_m.x) } else { bounds_m.center_m().x }
}
