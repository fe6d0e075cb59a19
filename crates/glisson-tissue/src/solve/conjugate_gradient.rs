//! Conjugate gradients preconditioned by an incomplete Cholesky factor: the pre-computation of the papers (seed `001` s. 4.1;
//! seed `003` s. 2.1), kept as a baseline for the sparse factor.
//!
//! The factor has the pattern of the lower triangle of K and no more (Meijerink and van der Vorst 1977, doi
//! 10.1090/S0025-5718-1977-0438681-4). It need not exist for elasticity; then a share of the diagonal is added until
//! it does (Manteuffel 1980, doi 10.1090/S0025-5718-1980-0559197-0).

use super::{FreeSystem, SolveError};

/// Share of the diagonal that is added first when the factor does not exist; doubled as often as needed.
const FIRST_SHIFT: f64 = 1e-3;
/// With this share the diagonal of any stiffness dominates its row, which has some hundred entries.
const MOST_SHIFT: f64 = 1e3;
/// A pivot below this share of its diagonal entry counts as none: its inverse would spoil the preconditioner.
const LEAST_PIVOT: f64 = 1e-6;

/// L of K ~ L L^T by rows, on the pattern of K's lower triangle.
#[derive(Clone, Debug)]
pub struct IncompleteCholesky<'a> {
    system: &'a FreeSystem,
    value: Vec<f64>,
    shift: f64,
}

/// Vectors that a solution needs.
#[derive(Clone, Debug)]
pub struct CgScratch {
    residual: Vec<f64>,
    preconditioned: Vec<f64>,
    direction: Vec<f64>,
    image: Vec<f64>,
}

/// Report on a solution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CgReport {
    /// Iterations done.
    pub n_iterations: usize,
    /// Length of the residual over that of the right-hand side.
    pub relative_residual: f64,
    /// Whether the wanted residual was reached.
    pub converged: bool,
}

impl<'a> IncompleteCholesky<'a> {
    /// Computes an incomplete factor of the free part of K.
    ///
    /// # Errors
    /// [`SolveError::Singular`] when no shift helps: a diagonal entry is not positive.
    pub fn new(system: &'a FreeSystem) -> Result<Self, SolveError> {
        let mut shift = 0.0;
        loop {
            if let Some(value) = factor(system, shift) {
                return Ok(Self { system, value, shift });
            }
            if shift > MOST_SHIFT {
                return Err(SolveError::Singular);
            }
            shift = if shift == 0.0 { FIRST_SHIFT } else { 2.0 * shift };
        }
    }

    /// Share of the diagonal that was added to it.
    pub fn shift(&self) -> f64 {
        self.shift
    }

    /// Scratch for [`IncompleteCholesky::solve_into`].
    pub fn scratch(&self) -> CgScratch {
        let zeros = || vec![0.0; self.system.n_free()];
        CgScratch { residual: zeros(), preconditioned: zeros(), direction: zeros(), image: zeros() }
    }

    /// Solves K x = `right` from x = 0, until the residual's length is at most `tolerance` times that of the
    /// right-hand side. `is_enough` hears of the solution after each iteration and may stop earlier.
    ///
    /// # Panics
    /// When the lengths do not fit.
    pub fn solve_into(
        &self,
        right: &[f64],
        solution: &mut [f64],
        tolerance: f64,
        max_iterations: usize,
        scratch: &mut CgScratch,
        mut is_enough: impl FnMut(&[f64]) -> bool,
    ) -> CgReport {
        let CgScratch { residual, preconditioned, direction, image } = scratch;
        solution.fill(0.0);
        residual.copy_from_slice(right);
        let size = dot(right, right).sqrt();
        let mut report = CgReport {
            n_iterations: 0,
            relative_residual: f64::from(u8::from(size > 0.0)),
            converged: size == 0.0,
        };
        let mut before = 0.0;
        while !report.converged && report.n_iterations < max_iterations {
            self.precondition(residual, preconditioned);
            let descent = dot(residual, preconditioned);
            let kept = if report.n_iterations == 0 { 0.0 } else { descent / before };
            before = descent;
            for (d, z) in direction.iter_mut().zip(preconditioned.iter()) {
                *d = z + kept * *d;
            }
            multiply(self.system, direction, image);
            let length = descent / dot(direction, image);
            for i in 0..solution.len() {
                solution[i] += length * direction[i];
                residual[i] -= length * image[i];
            }
            report.n_iterations += 1;
            report.relative_residual = dot(residual, residual).sqrt() / size;
            report.converged = report.relative_residual <= tolerance || is_enough(solution);
        }
        report
    }

    /// z = (L L^T)^-1 r.
    fn precondition(&self, r: &[f64], z: &mut [f64]) {
        let (start, column, _) = self.system.upper_columns();
        z.copy_from_slice(r);
        for i in 0..z.len() {
            let (first, last) = (start[i] as usize, start[i + 1] as usize - 1);
            let known: f64 = (first..last).map(|e| self.value[e] * z[column[e] as usize]).sum();
            z[i] = (z[i] - known) / self.value[last];
        }
        for i in (0..z.len()).rev() {
            let (first, last) = (start[i] as usize, start[i + 1] as usize - 1);
            z[i] /= self.value[last];
            let solved = z[i];
            for e in first..last {
                z[column[e] as usize] -= self.value[e] * solved;
            }
        }
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// y = K x.
fn multiply(system: &FreeSystem, x: &[f64], y: &mut [f64]) {
    let (start, row, value) = system.upper_columns();
    y.fill(0.0);
    for j in 0..x.len() {
        let (first, last) = (start[j] as usize, start[j + 1] as usize - 1);
        let mut sum = value[last] * x[j];
        for e in first..last {
            let i = row[e] as usize;
            sum += value[e] * x[i];
            y[i] += value[e] * x[j];
        }
        y[j] += sum;
    }
}

/// Rows of L for K + shift diag K, or `None` when a pivot is not positive. A column of K's upper triangle is a row of
/// its lower one.
fn factor(system: &FreeSystem, shift: f64) -> Option<Vec<f64>> {
    let (start, column, k) = system.upper_columns();
    let mut l = k.to_vec();
    for i in 0..system.n_free() {
        let (first, last) = (start[i] as usize, start[i + 1] as usize - 1);
        let mut pivot = k[last] * (1.0 + shift);
        for e in first..last {
            let j = column[e] as usize;
            // The part of the rows i and j that both have, left of column j.
            let (mut a, mut b, b_last) = (first, start[j] as usize, start[j + 1] as usize - 1);
            let mut sum = l[e];
            while a < e && b < b_last {
                match column[a].cmp(&column[b]) {
                    std::cmp::Ordering::Less => a += 1,
                    std::cmp::Ordering::Greater => b += 1,
                    std::cmp::Ordering::Equal => {
                        sum -= l[a] * l[b];
                        (a, b) = (a + 1, b + 1);
                    }
                }
            }
            l[e] = sum / l[b_last];
            pivot -= l[e] * l[e];
        }
        if pivot.is_nan() || pivot <= LEAST_PIVOT * k[last] {
            return None;
        }
        l[last] = pivot.sqrt();
    }
    Some(l)
}
