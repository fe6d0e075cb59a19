//! One level a region, by which all volumes become the wanted ones.
//!
//! Smoothing shrinks what is thin and faces cut off what is round. Raising the level `l_a` of region a by `delta` moves its
//! border with b outwards by `delta / |grad(phi_a - phi_b)|`, so that for small changes
//!
//! `sum over b of s_ab (delta_a - delta_b) = wanted volume of a - its volume`, with
//! `s_ab = integral over the interface ab of 1 / |grad(phi_a - phi_b)|`,
//!
//! a weighted graph Laplacian over the regions with the outside held at 0. The slope is taken as that of a flat border, so that
//! this is a quasi-Newton method; where the guard of [`super::fit`] holds nodes back, later steps make up for it elsewhere.

use super::complex::Complex;
use super::field::ShareField;
use super::interface_faces::InterfaceFace;

/// No level is farther from 0: it moves a flat border by a sixth of a cell.
pub(super) const LARGEST_LEVEL: f64 = 0.5;

/// Largest change in a step.
const LARGEST_CHANGE: f64 = 0.1;

/// Levels of all regions; that of the outside is 0.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Levels {
    of_regions: Vec<f64>,
}

impl Levels {
    /// Levels to begin with, one a region, 0 first.
    pub(super) fn new(of_regions: Vec<f64>) -> Self {
        Self { of_regions }
    }

    /// Level of region `a` over that of region `b`.
    pub(super) fn difference(&self, a: usize, b: usize) -> f64 {
        self.of_regions[a] - self.of_regions[b]
    }

    /// One a region, 0 first.
    pub(super) fn of_regions(&self) -> &[f64] {
        &self.of_regions
    }

    /// Changes the levels so that the regions' volumes come to `wanted_m3` (from region 1 on).
    pub(super) fn correct(
        &mut self,
        complex: &Complex,
        faces: &[InterfaceFace],
        field: &ShareField<'_>,
        wanted_m3: &[f64],
    ) {
        let n = wanted_m3.len();
        let volumes_m3 = complex.volumes_m3(n);
        let mut matrix = vec![0.0; n * n];
        for (pair, area_m2) in areas_m2(complex, faces, field, n) {
            let gain_m3 = area_m2 / field.least_flat_slope();
            let [a, b] = pair;
            for (row, column) in [(a, b), (b, a)] {
                if row > 0 {
                    matrix[(row - 1) * n + row - 1] += gain_m3;
                    if column > 0 {
                        matrix[(row - 1) * n + column - 1] -= gain_m3;
                    }
                }
            }
        }
        let defect_m3: Vec<f64> = (0..n).map(|r| wanted_m3[r] - volumes_m3[r + 1]).collect();
        for (level, change) in self.of_regions[1..].iter_mut().zip(solved(matrix, defect_m3)) {
            let change = if change.is_finite() { change.clamp(-LARGEST_CHANGE, LARGEST_CHANGE) } else { 0.0 };
            *level = (*level + change).clamp(-LARGEST_LEVEL, LARGEST_LEVEL);
        }
    }
}

/// Area of each interface [m2], by its regions in ascending order; where borders are steeper because cells are smaller, less of it.
fn areas_m2(
    complex: &Complex,
    faces: &[InterfaceFace],
    field: &ShareField<'_>,
    n_regions: usize,
) -> Vec<([usize; 2], f64)> {
    let n = n_regions + 1;
    let mut area_m2 = vec![0.0; n * n];
    for face in faces {
        let [a, b, c] = face.corners_m(complex);
        let less = field.least_flat_slope() / field.flat_slope_at((a + b + c) / 3.0);
        area_m2[usize::from(face.regions[0]) * n + usize::from(face.regions[1])] +=
            less * face.area_m2(complex);
    }
    let pairs = (0..n * n).map(|at| ([at / n, at % n], area_m2[at]));
    pairs.filter(|&(_, area_m2)| area_m2 > 0.0).collect()
}

/// Solution of `matrix x = right` for a symmetric positive definite matrix, by elimination.
fn solved(mut matrix: Vec<f64>, mut right: Vec<f64>) -> Vec<f64> {
    let n = right.len();
    for pivot in 0..n {
        for row in pivot + 1..n {
            let factor = matrix[row * n + pivot] / matrix[pivot * n + pivot];
            if factor != 0.0 {
                for column in pivot..n {
                    matrix[row * n + column] -= factor * matrix[pivot * n + column];
                }
                right[row] -= factor * right[pivot];
            }
        }
    }
    for row in (0..n).rev() {
        let known: f64 = (row + 1..n).map(|column| matrix[row * n + column] * right[column]).sum();
        right[row] = (right[row] - known) / matrix[row * n + row];
    }
    right
}
