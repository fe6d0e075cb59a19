//! Gaussian elimination for small dense systems, for reference solutions.

/// Replaces the columns of `right` (each of `n` rows, one after the other) by the solutions of A x = b, with rows
/// exchanged for the largest pivot. `matrix` is A by columns and is overwritten.
///
/// # Errors
/// The number of the first column that depends on those before it: its pivot is below `least_pivot` times the
/// largest entry of A.
///
/// # Panics
/// When the lengths do not fit.
pub fn solve_dense_in_place(
    n: usize,
    matrix: &mut [f64],
    right: &mut [f64],
    least_pivot: f64,
) -> Result<(), usize> {
    assert_eq!(matrix.len(), n * n, "a matrix of {n} rows");
    assert_eq!(right.len() % n.max(1), 0, "columns of {n} rows");
    let size = |x: &f64| x.abs();
    let largest = matrix.iter().map(size).fold(0.0, f64::max);
    for k in 0..n {
        let column = &matrix[n * k..n * (k + 1)];
        let pivot = (k..n).max_by(|&i, &j| column[i].abs().total_cmp(&column[j].abs())).unwrap_or(k);
        if column[pivot].is_nan() || column[pivot].abs() <= least_pivot * largest {
            return Err(k);
        }
        for column in matrix.chunks_exact_mut(n).chain(right.chunks_exact_mut(n)) {
            column.swap(k, pivot);
        }
        let (done, later) = matrix.split_at_mut(n * (k + 1));
        let column = &mut done[n * k..];
        let inverse = 1.0 / column[k];
        column[k + 1..].iter_mut().for_each(|x| *x *= inverse);
        for target in later.chunks_exact_mut(n).chain(right.chunks_exact_mut(n)) {
            let factor = target[k];
            if factor != 0.0 {
                for (t, c) in target[k + 1..].iter_mut().zip(&column[k + 1..]) {
                    *t -= factor * c;
                }
            }
        }
    }
    for x in right.chunks_exact_mut(n.max(1)) {
        for k in (0..n).rev() {
            let column = &matrix[n * k..n * (k + 1)];
            x[k] /= column[k];
            let solved = x[k];
            for (x, c) in x[..k].iter_mut().zip(column) {
                *x -= solved * c;
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson_mesh::math::SeededRandom;

    #[test]
    fn random_systems_are_solved_and_singular_ones_refused() {
        let mut random = SeededRandom::new(8);
        for n in [1, 2, 5, 40] {
            let mut a: Vec<f64> = (0..n * n).map(|_| random.normal()).collect();
            let x: Vec<f64> = (0..2 * n).map(|_| random.normal()).collect();
            let mut right = vec![0.0; 2 * n];
            for (b, x) in right.chunks_exact_mut(n).zip(x.chunks_exact(n)) {
                for i in 0..n {
                    b[i] = (0..n).map(|j| a[n * j + i] * x[j]).sum();
                }
            }
            solve_dense_in_place(n, &mut a.clone(), &mut right, 1e-14).unwrap();
            for (found, x) in right.iter().zip(&x) {
                assert!((found - x).abs() < 1e-10, "{found} {x}");
            }
            if n > 2 {
                // The third column as the sum of the first two.
                for i in 0..n {
                    a[2 * n + i] = a[i] + a[n + i];
                }
                assert_eq!(solve_dense_in_place(n, &mut a, &mut right, 1e-12), Err(2));
            }
        }
    }
}
