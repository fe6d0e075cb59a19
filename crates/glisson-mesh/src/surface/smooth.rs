//! Smoothing that takes out short waves, keeps long ones, and keeps the volume.
//!
//! The positions x solve (1 + (tau L)^2) x = x0, L being the graph Laplacian with the weight 1 / length^2 of
//! each edge [1/m2] and tau = (wavelength / 2 pi)^2: a wave of that length keeps half of its amplitude, one of
//! twice the length 94 %, one of half the length 6 %. It is the implicit fairing of M. Desbrun, M. Meyer,
//! P. Schröder and A. Barr ("Implicit fairing of irregular meshes using diffusion and curvature flow", 1999,
//! doi 10.1145/311535.311576) with the squared Laplacian; G. Taubin's explicit filter ("A signal processing
//! approach to fair surface design", 1995, doi 10.1145/218380.218473) has the same aim but needs thousands of
//! passes for the steps of thick slices, which are many edges long.
//!
//! Nothing is solved: x = f(tau L) x0 with f(s) = 1 / (1 + s^2), by f's Chebyshev series on [0, S], S at least
//! tau times the largest eigenvalue of L (D. Hammond, P. Vandergheynst and R. Gribonval, "Wavelets on graphs
//! via spectral graph theory", 2011, doi 10.1016/j.acha.2010.04.005). It is known in closed form: f is the
//! real part of 1 / (1 + i s), with s = S (1 + z) / 2 that of (2 i / S) / (a - z), a = -1 + 2 i / S, and the
//! generating function of the polynomials T_k gives 1 / (a - z) = (1 + 2 sum_k rho^-k T_k(z)) / (a^2 - 1)^(1/2)
//! with rho = a + (a^2 - 1)^(1/2), |rho| > 1. About 14 (S / 2)^(1/2) terms are right to six digits, each for
//! one product with L and no scalar product; conjugate gradients take as many steps of two products and more.
//! Rows are computed in parallel, each by one thread in a fixed order: the same bits at any number of threads.

use std::ops::Range;

use rayon::prelude::*;

use super::TriMesh;
use super::error::SurfaceError;
use super::normals::{NormalWeight, area_m2, vertex_normals};
use crate::math::{Aabb, DVec3};

/// Bound of what the terms left out of the series add up to, as a share of the distance of the vertices from
/// the middle of the mesh: 0.1 um for a liver.
const SERIES_TOLERANCE: f64 = 1e-6;
/// Rounds of tightening the bound of the largest eigenvalue; more gain nothing visible.
const BOUND_ROUNDS: usize = 6;
/// Rows that one thread takes at a time.
const ROWS_PER_TASK: usize = 2048;
/// Volume is met to this share by [`offset_to_volume`].
const VOLUME_TOLERANCE: f64 = 1e-9;
/// Newton steps of [`offset_to_volume`]; it converges in three or four.
const MOST_OFFSETS: usize = 20;

/// `mesh` with the waves shorter than about `wavelength_m` taken out and its volume restored by moving all
/// vertices along their normals. The triangles stay.
///
/// # Errors
/// [`SurfaceError::Parameter`] for a wavelength that is not positive and finite, or a surface so flat that
/// its volume cannot be restored.
pub fn smooth_surface(mesh: &TriMesh, wavelength_m: f64) -> Result<TriMesh, SurfaceError> {
    if !(wavelength_m > 0.0 && wavelength_m.is_finite()) {
        let allowed = "positive and finite";
        return Err(SurfaceError::Parameter {
            name: "smoothing wavelength [m]",
            found: wavelength_m,
            allowed,
        });
    }
    let graph = EdgeGraph::of_mesh(mesh);
    let mut smooth = TriMesh {
        positions_m: graph.low_pass(&mesh.positions_m, wavelength_m),
        triangles: mesh.triangles.clone(),
    };
    offset_to_volume(&mut smooth, mesh.volume_m3())?;
    Ok(smooth)
}

/// Moves all vertices by one distance along their area-weighted normals so that the volume becomes
/// `volume_m3`; answers the distance [m], positive outward.
///
/// # Errors
/// [`SurfaceError::Parameter`] when no offset gives that volume; then `mesh` is untouched.
pub fn offset_to_volume(mesh: &mut TriMesh, volume_m3: f64) -> Result<f64, SurfaceError> {
    let unreachable =
        SurfaceError::Parameter { name: "volume [m3]", found: volume_m3, allowed: "near the surface's own" };
    if !(volume_m3 > 0.0 && volume_m3.is_finite()) {
        return Err(unreachable);
    }
    let mut moved = mesh.clone();
    let mut offset_m = 0.0;
    for _ in 0..MOST_OFFSETS {
        let missing_m3 = volume_m3 - moved.volume_m3();
        if missing_m3.abs() <= VOLUME_TOLERANCE * volume_m3 {
            *mesh = moved;
            return Ok(offset_m);
        }
        let step_m = missing_m3 / area_m2(&moved);
        if !step_m.is_finite() {
            break;
        }
        let normals = vertex_normals(&moved, NormalWeight::Area);
        for (position, normal) in moved.positions_m.iter_mut().zip(normals) {
            *position += step_m * normal;
        }
        offset_m += step_m;
    }
    Err(unreachable)
}

/// The edges of a mesh as rows: neighbours of each vertex, ascending, with their weights.
pub(super) struct EdgeGraph {
    start: Vec<u32>,
    neighbour: Vec<u32>,
    /// 1 / length^2 [1/m2].
    weight: Vec<f64>,
    /// Sum of the weights of a row [1/m2].
    diagonal: Vec<f64>,
}

impl EdgeGraph {
    /// The graph of `mesh`, its weights from the present lengths; edges shorter than a tenth of the median
    /// count as that long, so that slivers do not stiffen the system.
    pub(super) fn of_mesh(mesh: &TriMesh) -> Self {
        let (start, neighbour) = rows_of_neighbours(mesh);
        let row = |v: usize| start[v] as usize..start[v + 1] as usize;
        let at = |v: u32| mesh.positions_m[v as usize];
        let n_vertices = mesh.positions_m.len();
        let ends = (0..n_vertices).flat_map(|v| neighbour[row(v)].iter().map(move |&n| (v as u32, n)));
        let mut weight: Vec<f64> = ends.map(|(v, n)| (at(n) - at(v)).length()).collect();
        let mut lengths_m = weight.clone();
        let middle = lengths_m.len() / 2;
        let shortest_m = match lengths_m.get(middle) {
            Some(_) => 0.1 * *lengths_m.select_nth_unstable_by(middle, f64::total_cmp).1,
            None => 0.0,
        };
        for length_or_weight in &mut weight {
            *length_or_weight = length_or_weight.max(shortest_m).powi(-2);
        }
        let diagonal = (0..n_vertices).map(|v| weight[row(v)].iter().sum()).collect();
        Self { start, neighbour, weight, diagonal }
    }

    /// Vertices next to `vertex`, ascending.
    pub(super) fn neighbours(&self, vertex: usize) -> &[u32] {
        &self.neighbour[self.range(vertex)]
    }

    /// Where the neighbours of `vertex` stand.
    fn range(&self, vertex: usize) -> Range<usize> {
        self.start[vertex] as usize..self.start[vertex + 1] as usize
    }

    /// Neighbours of `vertex` and the weights of their edges.
    fn row(&self, vertex: usize) -> impl Iterator<Item = (usize, f64)> {
        let row = self.range(vertex);
        self.neighbour[row.clone()].iter().zip(&self.weight[row]).map(|(&n, &w)| (n as usize, w))
    }

    /// An upper bound of the Laplacian's eigenvalues [1/m2]: those of D - W are at most those of the
    /// non-negative D + W, and these at most max_v ((D + W) p)_v / p_v for any positive p (L. Collatz,
    /// "Einschließungssatz für die charakteristischen Zahlen von Matrizen", Mathematische Zeitschrift 48, 1942).
    /// For p = 1 it is Gershgorin's, twice the largest diagonal entry; powers of D + W tighten it.
    fn largest_eigenvalue_bound(&self) -> f64 {
        let mut p = vec![1.0; self.diagonal.len()];
        let mut best = f64::INFINITY;
        for _ in 0..BOUND_ROUNDS {
            let rows = p.par_iter().enumerate().with_min_len(ROWS_PER_TASK);
            let mut next: Vec<f64> = rows
                .map(|(v, &own)| self.diagonal[v] * own + self.row(v).map(|(n, w)| w * p[n]).sum::<f64>())
                .collect();
            let ratios = next.iter().zip(&p).map(|(sum, own)| sum / own);
            best = ratios.fold(0.0, f64::max).min(best);
            let most = next.iter().copied().fold(0.0, f64::max);
            // Vertices without edges must stay above zero.
            next.iter_mut().for_each(|x| *x = *x / most + 1e-3);
            p = next;
        }
        best
    }

    /// The low-pass filter of the module's head. Vertices without edges stay. The work grows with the
    /// wavelength over the shortest edges.
    pub(super) fn low_pass(&self, positions_m: &[DVec3], wavelength_m: f64) -> Vec<DVec3> {
        let tau_m2 = (wavelength_m / std::f64::consts::TAU).powi(2);
        let largest = tau_m2 * self.largest_eigenvalue_bound();
        if !(largest > 0.0 && largest.is_finite()) {
            return positions_m.to_vec();
        }
        let coefficients = low_pass_series(largest);
        let (&first, higher) = coefficients.split_first().expect("a series has a first term");
        // 2 z(tau L) = (4 tau / S) L - 2, its entries.
        let scale = 4.0 * tau_m2 / largest;
        let own: Vec<f64> = self.diagonal.iter().map(|d| scale * d - 2.0).collect();
        let weight: Vec<f64> = self.weight.iter().map(|w| scale * w).collect();
        let doubled_z = |x: &[DVec3], v: usize| {
            let row = self.range(v);
            let terms = self.neighbour[row.clone()].iter().zip(&weight[row]);
            terms.fold(own[v] * x[v], |sum, (&n, &w)| sum - w * x[n as usize])
        };
        let middle_m = Aabb::of_points(positions_m).center_m();
        let given: Vec<DVec3> = positions_m.iter().map(|&p| p - middle_m).collect();
        // Clenshaw: b_k = c_k x0 + 2 z b_(k+1) - b_(k+2), and the sum is c_0 x0 + z b_1 - b_2.
        let mut one_above = vec![DVec3::ZERO; given.len()];
        let mut two_above = one_above.clone();
        for &c in higher.iter().rev() {
            let rows = two_above.par_iter_mut().enumerate().with_min_len(ROWS_PER_TASK);
            rows.for_each(|(v, b)| *b = c * given[v] + doubled_z(&one_above, v) - *b);
            std::mem::swap(&mut one_above, &mut two_above);
        }
        let rows = two_above.par_iter_mut().enumerate().with_min_len(ROWS_PER_TASK);
        rows.for_each(|(v, b)| {
            let filtered = middle_m + first * given[v] + 0.5 * doubled_z(&one_above, v) - *b;
            *b = if self.diagonal[v] > 0.0 { filtered } else { positions_m[v] };
        });
        two_above
    }
}

/// For each vertex of `mesh` its neighbours, ascending: where each row starts, and the rows.
fn rows_of_neighbours(mesh: &TriMesh) -> (Vec<u32>, Vec<u32>) {
    let n_vertices = mesh.positions_m.len();
    // Each triangle names both others at each of its corners; most neighbours come twice.
    let mut start = vec![0u32; n_vertices + 1];
    for &v in mesh.triangles.iter().flatten() {
        start[v as usize + 1] += 2;
    }
    for v in 0..n_vertices {
        start[v + 1] += start[v];
    }
    let mut named = vec![0u32; 6 * mesh.triangles.len()];
    let mut next = start.clone();
    for &[a, b, c] in &mesh.triangles {
        for (v, others) in [(a, [b, c]), (b, [c, a]), (c, [a, b])] {
            let at = next[v as usize] as usize;
            named[at..at + 2].copy_from_slice(&others);
            next[v as usize] += 2;
        }
    }
    let mut n_kept = 0;
    for v in 0..n_vertices {
        let row = start[v] as usize..start[v + 1] as usize;
        named[row.clone()].sort_unstable();
        start[v] = n_kept as u32;
        for at in row.clone() {
            if at == row.start || named[at] != named[n_kept - 1] {
                named[n_kept] = named[at];
                n_kept += 1;
            }
        }
    }
    start[n_vertices] = n_kept as u32;
    named.truncate(n_kept);
    (start, named)
}

/// Chebyshev coefficients of 1 / (1 + s^2) on [0, `largest`], as many as [`SERIES_TOLERANCE`] needs. The
/// formula is in the module's head.
fn low_pass_series(largest: f64) -> Vec<f64> {
    type Complex = [f64; 2];
    let times = |[a, b]: Complex, [c, d]: Complex| [a * c - b * d, a * d + b * c];
    let squared = |[a, b]: Complex| a * a + b * b;
    let inverse = |x: Complex| [x[0] / squared(x), -x[1] / squared(x)];
    let h = 2.0 / largest;
    // a^2 - 1 = -h^2 - 2 i h; of its root's parts the imaginary one has no cancellation.
    let imaginary = -((h * h * (h * h + 4.0)).sqrt() + h * h).sqrt() / std::f64::consts::SQRT_2;
    let root = [-h / imaginary, imaginary];
    let candidates =
        [([-1.0 + root[0], h + root[1]], root), ([-1.0 - root[0], h - root[1]], [-root[0], -root[1]])];
    // Their product is one; the root goes with the one outside the unit circle.
    let (rho, root) = if squared(candidates[0].0) > 1.0 { candidates[0] } else { candidates[1] };
    let ratio = inverse(rho);
    let shrink = squared(ratio).sqrt();
    let mut term = times([0.0, h], inverse(root));
    let mut coefficients = vec![term[0]];
    // The terms left out are at most a geometric series.
    while 2.0 * squared(term).sqrt() * shrink / (1.0 - shrink) > SERIES_TOLERANCE {
        term = times(term, ratio);
        coefficients.push(2.0 * term[0]);
    }
    coefficients
}
