//! The small dense system of the imposed displacements: Cholesky in memory that was set aside.

/// A symmetric positive definite system of up to a fixed size: lower triangle by columns.
#[derive(Clone, Debug)]
pub(super) struct SmallCholesky {
    n: usize,
    entry: Vec<f64>,
    right: Vec<f64>,
}

/// A pivot below this share of its diagonal entry is a row that repeats others: its unknown is set to zero.
const LEAST_PIVOT: f64 = 1e-13;

impl SmallCholesky {
    /// Room for `n` rows.
    pub(super) fn with_room_for(n: usize) -> Self {
        Self { n: 0, entry: vec![0.0; n * n], right: vec![0.0; n] }
    }

    /// Begins a system of `n` rows, whose columns and right-hand side are then written.
    pub(super) fn start(&mut self, n: usize) {
        assert!(n <= self.right.len(), "room was made for {} rows", self.right.len());
        self.n = n;
    }

    /// Column `j`; the rows from `j` on count.
    pub(super) fn column_mut(&mut self, j: usize) -> &mut [f64] {
        &mut self.entry[self.n * j..self.n * (j + 1)]
    }

    /// The right-hand side, and after [`SmallCholesky::solve`] the solution.
    pub(super) fn right_mut(&mut self) -> &mut [f64] {
        &mut self.right[..self.n]
    }

    /// Solves in place.
    pub(super) fn solve(&mut self) {
        let n = self.n;
        let right = &mut self.right[..n];
        for k in 0..n {
            let (done, later) = self.entry[..n * n].split_at_mut(n * (k + 1));
            let column = &mut done[n * k..];
            let diagonal = column[k];
            // Remember the diagonal entry of before the elimination in the unused upper triangle.
            let original = if k == 0 { diagonal } else { column[0] };
            let inverse = if diagonal > LEAST_PIVOT * original { 1.0 / diagonal.sqrt() } else { 0.0 };
            column[k] = inverse;
            for x in &mut column[k + 1..] {
                *x *= inverse;
            }
            let column = &done[n * k..];
            for j in k + 1..n {
                let factor = column[j];
                let target = &mut later[n * (j - k - 1)..n * (j - k)];
                if k == 0 {
                    target[0] = target[j];
                }
                for (t, c) in target[j..].iter_mut().zip(&column[j..]) {
                    *t -= factor * c;
                }
            }
            right[k] *= inverse;
            let solved = right[k];
            for (r, c) in right[k + 1..].iter_mut().zip(&column[k + 1..]) {
                *r -= solved * c;
            }
        }
        for k in (0..n).rev() {
            let column = &self.entry[n * k..n * (k + 1)];
            let mut sum = right[k];
            for i in k + 1..n {
                sum -= column[i] * right[i];
            }
            right[k] = sum * column[k];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::SeededRandom;

    #[test]
    fn random_systems_are_solved() {
        let mut random = SeededRandom::new(5);
        let mut system = SmallCholesky::with_room_for(30);
        for n in [1, 2, 3, 7, 30] {
            let a: Vec<f64> = (0..n * n).map(|_| random.normal()).collect();
            let product = |i: usize, j: usize| -> f64 {
                let dot: f64 = (0..n).map(|k| a[i * n + k] * a[j * n + k]).sum();
                dot + f64::from(u8::from(i == j))
            };
            let x: Vec<f64> = (0..n).map(|_| random.normal()).collect();
            system.start(n);
            for j in 0..n {
                for i in j..n {
                    system.column_mut(j)[i] = product(i, j);
                }
                system.right_mut()[j] = (0..n).map(|i| product(i, j) * x[i]).sum();
            }
            system.solve();
            for (found, x) in system.right_mut().iter().zip(&x) {
                assert!((found - x).abs() < 1e-10, "{found} {x}");
            }
        }
    }

    #[test]
    fn a_repeated_row_gets_nothing() {
        let mut system = SmallCholesky::with_room_for(3);
        system.start(3);
        for (j, column) in [[4.0, 4.0, 1.0], [0.0, 4.0, 1.0], [0.0, 0.0, 3.0]].into_iter().enumerate() {
            system.column_mut(j).copy_from_slice(&column);
        }
        system.right_mut().copy_from_slice(&[5.0, 5.0, 4.0]);
        system.solve();
        assert_eq!(system.right_mut()[1], 0.0);
        assert!((system.right_mut()[0] - 1.0).abs() < 1e-14);
        assert!((system.right_mut()[2] - 1.0).abs() < 1e-14);
    }
}
