//! Smoothing that takes out short waves, keeps long ones, and keeps the volume.
//!
//! The positions x solve (1 + (tau L)^2) x = x0, L being the graph Laplacian with the weight 1 / length^2 of
//! each edge [1/m2] and tau = (wavelength / 2 pi)^2: a wave of that length keeps half of its amplitude, one of
//! twice the length 94 %, one of half the length 6 %. It is the implicit fairing of M. Desbrun, M. Meyer,
//! P. Schröder and A. Barr ("Implicit fairing of irregular meshes using diffusion and curvature flow", 1999,
//! doi 10.1145/311535.311576) with the squared Laplacian; G. Taubin's explicit filter ("A signal processing
//! approach to fair surface design", 1995, doi 10.1145/218380.218473) has the same aim but needs thousands of
//! passes for the steps of thick slices, which are many edges long. Solved by conjugate gradients, Jacobi
//! preconditioned, in index order: the same bits every time.

use super::TriMesh;
use super::error::SurfaceError;
use super::normals::{NormalWeight, area_m2, vertex_normals};
use crate::math::DVec3;

/// Root mean square residual at which the solution is taken [m]; the error is no larger.
const SOLVER_TOLERANCE_M: f64 = 5e-6;
/// Far above the few hundred that the longest sensible wavelengths take.
const MOST_ITERATIONS: usize = 2000;
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
        let mut pairs: Vec<[u32; 2]> = mesh
            .triangles
            .iter()
            .flat_map(|&[a, b, c]| [[a, b], [b, a], [b, c], [c, b], [c, a], [a, c]])
            .collect();
        pairs.sort_unstable();
        pairs.dedup();
        let at = |v: u32| mesh.positions_m[v as usize];
        let mut lengths_m: Vec<f64> = pairs.iter().map(|&[a, b]| (at(b) - at(a)).length()).collect();
        let mut start = vec![0u32; mesh.positions_m.len() + 1];
        for &[a, _] in &pairs {
            start[a as usize + 1] += 1;
        }
        for v in 0..mesh.positions_m.len() {
            start[v + 1] += start[v];
        }
        let unsorted = lengths_m.clone();
        let middle = lengths_m.len() / 2;
        let shortest_m = match lengths_m.get(middle) {
            Some(_) => 0.1 * *lengths_m.select_nth_unstable_by(middle, f64::total_cmp).1,
            None => 0.0,
        };
        let weight: Vec<f64> = unsorted.iter().map(|&l| l.max(shortest_m).powi(-2)).collect();
        let rows = start.windows(2).map(|w| w[0] as usize..w[1] as usize);
        let diagonal = rows.map(|row| weight[row].iter().sum()).collect();
        Self { start, neighbour: pairs.iter().map(|p| p[1]).collect(), weight, diagonal }
    }

    /// Vertices next to `vertex`, ascending.
    pub(super) fn neighbours(&self, vertex: usize) -> &[u32] {
        &self.neighbour[self.start[vertex] as usize..self.start[vertex + 1] as usize]
    }

    fn laplacian_into(&self, x: &[DVec3], scale: f64, out: &mut [DVec3]) {
        for (v, out) in out.iter_mut().enumerate() {
            let row = self.start[v] as usize..self.start[v + 1] as usize;
            let mut sum = self.diagonal[v] * x[v];
            for (&n, &w) in self.neighbour[row.clone()].iter().zip(&self.weight[row]) {
                sum -= w * x[n as usize];
            }
            *out = scale * sum;
        }
    }

    /// The low-pass filter of the module's head. Vertices without edges stay.
    pub(super) fn low_pass(&self, positions_m: &[DVec3], wavelength_m: f64) -> Vec<DVec3> {
        let n = positions_m.len();
        let tau_m2 = (wavelength_m / std::f64::consts::TAU).powi(2);
        let inverse_diagonal: Vec<f64> = (0..n)
            .map(|v| {
                let row = self.start[v] as usize..self.start[v + 1] as usize;
                let squares: f64 = self.weight[row].iter().map(|w| w * w).sum();
                1.0 / (1.0 + tau_m2 * tau_m2 * (self.diagonal[v].powi(2) + squares))
            })
            .collect();
        let mut half = vec![DVec3::ZERO; n];
        let mut apply = |x: &[DVec3], out: &mut [DVec3]| {
            self.laplacian_into(x, tau_m2, &mut half);
            self.laplacian_into(&half, tau_m2, out);
            for (out, &x) in out.iter_mut().zip(x) {
                *out += x;
            }
        };
        let dot = |a: &[DVec3], b: &[DVec3]| a.iter().zip(b).fold(DVec3::ZERO, |s, (&a, &b)| s + a * b);
        // x = x0 + d with A d = x0 - A x0: the three coordinates at once, each with its own step lengths.
        let mut product = vec![DVec3::ZERO; n];
        apply(positions_m, &mut product);
        let mut residual: Vec<DVec3> = positions_m.iter().zip(&product).map(|(&b, &p)| b - p).collect();
        let precondition =
            |r: &[DVec3]| -> Vec<DVec3> { r.iter().zip(&inverse_diagonal).map(|(&r, &d)| d * r).collect() };
        let mut solution = positions_m.to_vec();
        let mut scaled = precondition(&residual);
        let mut direction = scaled.clone();
        let mut rho = dot(&residual, &scaled);
        let ratio = |a: DVec3, b: DVec3| DVec3::select(b.cmpgt(DVec3::ZERO), a / b, DVec3::ZERO);
        for _ in 0..MOST_ITERATIONS {
            if dot(&residual, &residual).max_element() <= n as f64 * SOLVER_TOLERANCE_M.powi(2) {
                break;
            }
            apply(&direction, &mut product);
            let alpha = ratio(rho, dot(&direction, &product));
            for v in 0..n {
                solution[v] += alpha * direction[v];
                residual[v] -= alpha * product[v];
            }
            scaled = precondition(&residual);
            let next_rho = dot(&residual, &scaled);
            let beta = ratio(next_rho, rho);
            for v in 0..n {
                direction[v] = scaled[v] + beta * direction[v];
            }
            rho = next_rho;
        }
        solution
    }
}
