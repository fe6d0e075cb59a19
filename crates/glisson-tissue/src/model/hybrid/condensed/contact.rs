//! Nodes of pre-computed zones that tools hold: a small dense system, factored once per step.
//!
//! Let A be their compliance while the dynamic nodes are held, a their displacement without the tools, and H how they
//! follow the dynamic nodes. The tools' forces r solve A r = u* - a - H u_d, and the dynamic nodes feel H^T r. A tool
//! makes the stiffness that they feel larger, but not larger than that of the assembled frontier.

use glisson_mesh::math::{DMat3, DVec3};

/// A pivot below this share of its diagonal entry is a row that repeats others: its unknown is set to zero.
const LEAST_PIVOT: f64 = 1e-13;

/// A symmetric positive definite system of up to a fixed size, and its Cholesky factor.
#[derive(Clone, Debug)]
pub(super) struct ContactSystem {
    n: usize,
    /// Lower triangle by columns; after the factorization L with its diagonal inverted.
    entry: Vec<f64>,
    right: Vec<f64>,
}

impl ContactSystem {
    /// Room for `n` rows.
    pub(super) fn with_room_for(n: usize) -> Self {
        Self { n: 0, entry: vec![0.0; n * n], right: vec![0.0; n] }
    }

    /// Starts a system of `n` rows.
    pub(super) fn start(&mut self, n: usize) {
        self.n = n;
    }

    /// Sets the compliance between two held nodes; the first must not come before the second.
    pub(super) fn set(&mut self, i: usize, j: usize, tensor: DMat3) {
        for axis in 0..3 {
            let at = self.n * (3 * j + axis) + 3 * i;
            self.entry[at..at + 3].copy_from_slice(&tensor.col(axis).to_array());
        }
    }

    /// The right-hand side, and after [`ContactSystem::solve`] the solution.
    pub(super) fn right_mut(&mut self) -> &mut [f64] {
        &mut self.right[..self.n]
    }

    /// A node's part of the solution.
    pub(super) fn solution(&self, i: usize) -> DVec3 {
        DVec3::from_slice(&self.right[3 * i..3 * i + 3])
    }

    pub(super) fn factor(&mut self) {
        let n = self.n;
        for j in 0..n {
            let (done, rest) = self.entry.split_at_mut(n * j);
            let column = &mut rest[..n];
            let original = column[j];
            for k in 0..j {
                let factor = done[n * k + j];
                let earlier = &done[n * k + j..n * (k + 1)];
                for (x, l) in column[j..].iter_mut().zip(earlier) {
                    *x -= factor * l;
                }
            }
            let inverse = if column[j] > LEAST_PIVOT * original { 1.0 / column[j].sqrt() } else { 0.0 };
            column[j] = inverse;
            column[j + 1..].iter_mut().for_each(|x| *x *= inverse);
        }
    }

    pub(super) fn solve(&mut self) {
        let n = self.n;
        let right = &mut self.right[..n];
        for k in 0..n {
            let column = &self.entry[n * k..n * (k + 1)];
            right[k] *= column[k];
            let solved = right[k];
            for (r, l) in right[k + 1..].iter_mut().zip(&column[k + 1..]) {
                *r -= solved * l;
            }
        }
        for k in (0..n).rev() {
            let column = &self.entry[n * k..n * (k + 1)];
            let sum: f64 = column[k + 1..].iter().zip(&right[k + 1..]).map(|(l, x)| l * x).sum();
            right[k] = (right[k] - sum) * column[k];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson_mesh::math::SeededRandom;

    #[test]
    fn random_systems_are_solved_and_a_repeated_row_gets_nothing() {
        let mut random = SeededRandom::new(5);
        let n = 24;
        let half: Vec<f64> = (0..n * n).map(|_| random.normal()).collect();
        let product = |i: usize, j: usize| -> f64 {
            let same = f64::from(u8::from(i == j));
            same + (0..n).map(|k| half[i * n + k] * half[j * n + k]).sum::<f64>()
        };
        let x: Vec<f64> = (0..n).map(|_| random.normal()).collect();
        let mut system = ContactSystem::with_room_for(n);
        system.start(n);
        for j in 0..n / 3 {
            for i in j..n / 3 {
                let column = |d: usize| DVec3::from_array([0, 1, 2].map(|a| product(3 * i + a, 3 * j + d)));
                system.set(i, j, DMat3::from_cols(column(0), column(1), column(2)));
            }
        }
        system.factor();
        for i in 0..n {
            system.right_mut()[i] = (0..n).map(|j| product(i, j) * x[j]).sum();
        }
        system.solve();
        for (found, x) in system.right_mut().iter().zip(&x) {
            assert!((found - x).abs() < 1e-9, "{found} {x}");
        }

        system.start(6);
        for (i, j) in [(0, 0), (1, 0), (1, 1)] {
            system.set(i, j, DMat3::from_diagonal(DVec3::splat(4.0)));
        }
        system.factor();
        system.right_mut().fill(8.0);
        system.solve();
        assert_eq!([system.solution(0), system.solution(1)], [DVec3::splat(2.0), DVec3::ZERO]);
    }
}
