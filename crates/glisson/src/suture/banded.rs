//! Symmetric positive definite matrices whose rows reach no further than two nodes of a thread: Cholesky's factor in place.

use crate::math::{DMat3, DVec3};

/// Entries of a row left of the diagonal: the two nodes before, and the rest of a node's own axes.
const HALF: usize = 8;

/// The lower half of a banded matrix, row by row: entry (i, j) stands at `[i][HALF + j - i]`. After [`Banded::factor`], its factor.
#[derive(Clone, Debug, Default)]
pub(super) struct Banded {
    rows: Vec<[f64; HALF + 1]>,
}

impl Banded {
    pub(super) fn with_room_for(n_nodes: usize) -> Self {
        Self { rows: vec![[0.0; HALF + 1]; 3 * n_nodes] }
    }

    pub(super) fn clear(&mut self) {
        self.rows.fill([0.0; HALF + 1]);
    }

    /// Adds a tensor between two nodes, and its transpose on the other side; they are at most two apart.
    pub(super) fn add(&mut self, of: usize, by: usize, tensor: DMat3) {
        let (of, by, tensor) = if of >= by { (of, by, tensor) } else { (by, of, tensor.transpose()) };
        for a in 0..3 {
            for b in 0..3 {
                let (i, j) = (3 * of + a, 3 * by + b);
                if j <= i {
                    self.rows[i][HALF + j - i] += tensor.col(b)[a];
                }
            }
        }
    }

    /// Replaces the matrix by its factor. Pivots that rounding made too small are raised: the solution is then shorter.
    pub(super) fn factor(&mut self) {
        for i in 0..self.rows.len() {
            let first = i.saturating_sub(HALF);
            for j in first..=i {
                let from = first.max(j.saturating_sub(HALF));
                let mut sum = self.rows[i][HALF + j - i];
                let before = self.rows[i];
                for k in from..j {
                    sum -= before[HALF + k - i] * self.rows[j][HALF + k - j];
                }
                self.rows[i][HALF + j - i] = if j < i {
                    sum / self.rows[j][HALF]
                } else {
                    let least = f64::EPSILON * before[HALF].abs();
                    sum.max(least).max(f64::MIN_POSITIVE).sqrt()
                };
            }
        }
    }

    /// Overwrites `x` with the solution, after [`Banded::factor`].
    pub(super) fn solve(&self, x: &mut [DVec3]) {
        let at = |i: usize| (i / 3, i % 3);
        let n = self.rows.len();
        for i in 0..n {
            let (node, axis) = at(i);
            let mut sum = x[node][axis];
            for k in i.saturating_sub(HALF)..i {
                let (other, of) = at(k);
                sum -= self.rows[i][HALF + k - i] * x[other][of];
            }
            x[node][axis] = sum / self.rows[i][HALF];
        }
        for i in (0..n).rev() {
            let (node, axis) = at(i);
            let value = x[node][axis] / self.rows[i][HALF];
            x[node][axis] = value;
            for k in i.saturating_sub(HALF)..i {
                let (other, of) = at(k);
                x[other][of] -= self.rows[i][HALF + k - i] * value;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::SeededRandom;

    #[test]
    fn the_factor_solves_what_was_added() {
        let mut random = SeededRandom::new(5);
        let n = 12;
        let mut matrix = Banded::with_room_for(n);
        let mut dense = vec![vec![0.0; 3 * n]; 3 * n];
        for of in 0..n {
            for by in of.saturating_sub(2)..=of {
                let mut tensor = DMat3::from_cols_array(&[0.0; 9].map(|_: f64| random.uniform_in(-1.0, 1.0)));
                if of == by {
                    tensor = tensor + tensor.transpose() + DMat3::from_diagonal(DVec3::splat(20.0));
                }
                matrix.add(by, of, tensor.transpose());
                for a in 0..3 {
                    for b in 0..3 {
                        dense[3 * of + a][3 * by + b] = tensor.col(b)[a];
                        dense[3 * by + b][3 * of + a] = tensor.col(b)[a];
                    }
                }
            }
        }
        let right: Vec<DVec3> =
            (0..n).map(|_| DVec3::from_array([0; 3].map(|_| random.uniform_in(-1.0, 1.0)))).collect();
        let mut x = right.clone();
        matrix.factor();
        matrix.solve(&mut x);
        for i in 0..3 * n {
            let row: f64 = (0..3 * n).map(|j| dense[i][j] * x[j / 3][j % 3]).sum();
            assert!((row - right[i / 3][i % 3]).abs() < 1e-12, "{i}");
        }
    }
}
