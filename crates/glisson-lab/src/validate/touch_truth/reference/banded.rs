//! A symmetric positive definite matrix whose entries lie near the diagonal, and its Cholesky factor L L^T.

/// Products that are summed side by side, so that the compiler can use vector registers.
const LANES: usize = 8;

/// The matrix by rows, and after [`Banded::factorize`] its factor.
pub(super) struct Banded {
    n: usize,
    /// Entries of a row before the diagonal.
    width: usize,
    /// Row by row, the entry on the diagonal last.
    value: Vec<f64>,
}

/// The matrix is not positive definite.
#[derive(Debug)]
pub(super) struct NotPositive;

fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; LANES];
    let (left, right) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let rest: f64 = left.remainder().iter().zip(right.remainder()).map(|(x, y)| x * y).sum();
    for (x, y) in left.zip(right) {
        for lane in 0..LANES {
            sums[lane] += x[lane] * y[lane];
        }
    }
    rest + sums.iter().sum::<f64>()
}

impl Banded {
    pub(super) fn new(n: usize, width: usize) -> Self {
        Self { n, width, value: vec![0.0; n * (width + 1)] }
    }

    pub(super) fn clear(&mut self) {
        self.value.fill(0.0);
    }

    fn place(&self, row: usize, column: usize) -> usize {
        (self.width + 1) * row + self.width - (row - column)
    }

    /// Adds to an entry of the lower half: `column` is at most `row`.
    pub(super) fn add(&mut self, row: usize, column: usize, value: f64) {
        let at = self.place(row, column);
        self.value[at] += value;
    }

    /// Takes one unknown out: it stays at zero if its right-hand side is zero.
    pub(super) fn hold(&mut self, row: usize) {
        for column in row.saturating_sub(self.width)..row {
            let at = self.place(row, column);
            self.value[at] = 0.0;
        }
        for below in row + 1..(row + self.width + 1).min(self.n) {
            let at = self.place(below, row);
            self.value[at] = 0.0;
        }
        let at = self.place(row, row);
        self.value[at] = 1.0;
    }

    /// Factorizes in place.
    pub(super) fn factorize(&mut self) -> Result<(), NotPositive> {
        let width = self.width;
        for row in 0..self.n {
            let first = row.saturating_sub(width);
            let (above, own) = self.value.split_at_mut((width + 1) * row);
            // Where column `c` of this row lies in `own`, and row `c`'s own column `c` in `above`.
            let in_own = |column: usize| width - (row - column);
            for column in first..row {
                let start = first.max(column.saturating_sub(width));
                let row_above = &above[(width + 1) * column..(width + 1) * (column + 1)];
                let (a, b) = (in_own(start), width - (column - start));
                let n = column - start;
                let product = dot(&own[a..a + n], &row_above[b..b + n]);
                own[in_own(column)] = (own[in_own(column)] - product) / row_above[width];
            }
            let a = in_own(first);
            let rest = own[width] - dot(&own[a..width], &own[a..width]);
            if rest.is_nan() || rest <= 0.0 {
                return Err(NotPositive);
            }
            own[width] = rest.sqrt();
        }
        Ok(())
    }

    /// Replaces the right-hand side by the solution.
    pub(super) fn solve(&self, right: &mut [f64]) {
        for row in 0..self.n {
            let first = row.saturating_sub(self.width);
            let at = self.place(row, first);
            let n = row - first;
            let product = dot(&self.value[at..at + n], &right[first..row]);
            right[row] = (right[row] - product) / self.value[at + n];
        }
        for row in (0..self.n).rev() {
            let first = row.saturating_sub(self.width);
            let at = self.place(row, first);
            let n = row - first;
            right[row] /= self.value[at + n];
            let solved = right[row];
            for (x, l) in right[first..row].iter_mut().zip(&self.value[at..at + n]) {
                *x -= l * solved;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_banded_system_is_solved_and_an_indefinite_one_refused() {
        let (n, width) = (40, 11);
        let entry = |i: usize, j: usize| if i == j { 30.0 } else { 1.0 / (1.0 + i.abs_diff(j) as f64) };
        let mut matrix = Banded::new(n, width);
        for i in 0..n {
            for j in i.saturating_sub(width)..=i {
                matrix.add(i, j, entry(i, j));
            }
        }
        let expected: Vec<f64> = (0..n).map(|i| (i as f64).sin()).collect();
        let mut right: Vec<f64> = (0..n)
            .map(|i| {
                let near = |j: &usize| i.abs_diff(*j) <= width;
                (0..n).filter(near).map(|j| entry(i, j) * expected[j]).sum()
            })
            .collect();
        matrix.factorize().unwrap();
        matrix.solve(&mut right);
        assert!(right.iter().zip(&expected).all(|(x, y)| (x - y).abs() < 1e-13));
        let mut indefinite = Banded::new(2, 1);
        for (i, j, value) in [(0, 0, 1.0), (1, 0, 2.0), (1, 1, 1.0)] {
            indefinite.add(i, j, value);
        }
        assert!(indefinite.factorize().is_err());
    }
}
