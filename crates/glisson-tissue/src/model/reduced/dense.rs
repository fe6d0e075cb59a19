//! Small dense matrices by columns, without allocation.

/// Replaces the lower triangle of a symmetric matrix of `n` rows by its Cholesky factor, with the inverse of each pivot on
/// the diagonal. A pivot at or below `least_share` of its diagonal entry gets the inverse 0, which sets its unknown to
/// zero. Returns whether all pivots were larger.
pub(super) fn cholesky(entry: &mut [f64], n: usize, least_share: f64) -> bool {
    let mut is_definite = true;
    for k in 0..n {
        let original = entry[k * n + k];
        // The column so far stands in the rows' order: subtract the earlier columns' parts.
        for j in 0..k {
            let factor = entry[j * n + k];
            let (before, now) = entry.split_at_mut(k * n);
            let (source, target) = (&before[j * n + k..(j + 1) * n], &mut now[k..n]);
            target.iter_mut().zip(source).for_each(|(t, s)| *t -= factor * s);
        }
        let pivot = entry[k * n + k];
        let is_large = pivot > least_share * original && pivot > 0.0;
        is_definite &= is_large;
        let inverse = if is_large { 1.0 / pivot.sqrt() } else { 0.0 };
        entry[k * n + k..(k + 1) * n].iter_mut().for_each(|x| *x *= inverse);
        entry[k * n + k] = inverse;
    }
    is_definite
}

/// Multiplies `right` by L^-1, in place.
pub(super) fn solve_lower(factor: &[f64], n: usize, right: &mut [f64]) {
    for k in 0..n {
        right[k] *= factor[k * n + k];
        let solved = right[k];
        let column = &factor[k * n + k + 1..(k + 1) * n];
        right[k + 1..n].iter_mut().zip(column).for_each(|(r, l)| *r -= solved * l);
    }
}

/// Multiplies `right` by L^-T, in place.
pub(super) fn solve_upper(factor: &[f64], n: usize, right: &mut [f64]) {
    for k in (0..n).rev() {
        let column = &factor[k * n + k + 1..(k + 1) * n];
        let known = dot(column, &right[k + 1..n]);
        right[k] = (right[k] - known) * factor[k * n + k];
    }
}

/// Dot product, by eight partial sums in fixed order.
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    const LANES: usize = 8;
    let mut sum = [0.0; LANES];
    let (a_blocks, b_blocks) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let rest: f64 = a_blocks.remainder().iter().zip(b_blocks.remainder()).map(|(a, b)| a * b).sum();
    for (a, b) in a_blocks.zip(b_blocks) {
        for lane in 0..LANES {
            sum[lane] += a[lane] * b[lane];
        }
    }
    ((sum[0] + sum[4]) + (sum[1] + sum[5])) + ((sum[2] + sum[6]) + (sum[3] + sum[7])) + rest
}

/// Eigenvalues in ascending order and unit eigenvectors (columns) of a symmetric matrix of `n` rows, by Jacobi rotations
/// (Golub and Van Loan, Matrix Computations, 4th edition 2013, s. 8.5).
pub(super) fn eigen_symmetric(mut a: Vec<f64>, n: usize) -> (Vec<f64>, Vec<f64>) {
    const MOST_SWEEPS: usize = 30;
    let mut vectors = vec![0.0; n * n];
    (0..n).for_each(|k| vectors[k * n + k] = 1.0);
    let scale = a.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
    for _ in 0..MOST_SWEEPS {
        let mut is_done = true;
        for p in 0..n {
            for q in p + 1..n {
                let off = a[q * n + p];
                if off.abs() <= f64::EPSILON * 1e-2 * scale {
                    continue;
                }
                is_done = false;
                let tau = (a[q * n + q] - a[p * n + p]) / (2.0 * off);
                let t = if tau >= 0.0 { 1.0 } else { -1.0 } / (tau.abs() + (1.0 + tau * tau).sqrt());
                let c = 1.0 / (1.0 + t * t).sqrt();
                let s = t * c;
                for k in 0..n {
                    let (x, y) = (a[p * n + k], a[q * n + k]);
                    (a[p * n + k], a[q * n + k]) = (c * x - s * y, s * x + c * y);
                    let (x, y) = (vectors[p * n + k], vectors[q * n + k]);
                    (vectors[p * n + k], vectors[q * n + k]) = (c * x - s * y, s * x + c * y);
                }
                for k in 0..n {
                    let (x, y) = (a[k * n + p], a[k * n + q]);
                    (a[k * n + p], a[k * n + q]) = (c * x - s * y, s * x + c * y);
                }
            }
        }
        if is_done {
            break;
        }
    }
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|&i, &j| a[i * n + i].total_cmp(&a[j * n + j]));
    let values = order.iter().map(|&i| a[i * n + i]).collect();
    let sorted = order.iter().flat_map(|&i| vectors[i * n..(i + 1) * n].to_vec()).collect();
    (values, sorted)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson_mesh::math::SeededRandom;

    fn symmetric(random: &mut SeededRandom, n: usize) -> Vec<f64> {
        let b: Vec<f64> = (0..n * n).map(|_| random.normal()).collect();
        let entry = |i: usize, j: usize| (0..n).map(|k| b[i * n + k] * b[j * n + k]).sum::<f64>();
        (0..n * n).map(|at| entry(at / n, at % n)).collect()
    }

    #[test]
    fn factors_solve_and_repeated_rows_are_dropped() {
        let mut random = SeededRandom::new(3);
        for n in [1, 2, 9, 30] {
            let a = symmetric(&mut random, n);
            let x: Vec<f64> = (0..n).map(|_| random.normal()).collect();
            let mut right: Vec<f64> = (0..n).map(|i| dot(&a[i * n..(i + 1) * n], &x)).collect();
            let mut factor = a;
            assert!(cholesky(&mut factor, n, 1e-13));
            solve_lower(&factor, n, &mut right);
            solve_upper(&factor, n, &mut right);
            assert!(right.iter().zip(&x).all(|(r, x)| (r - x).abs() < 1e-7), "{n}");
        }
        let mut twice = vec![4.0, 4.0, 4.0, 4.0];
        assert!(!cholesky(&mut twice, 2, 1e-13));
        let mut right = vec![8.0, 8.0];
        solve_lower(&twice, 2, &mut right);
        solve_upper(&twice, 2, &mut right);
        assert_eq!(right, [2.0, 0.0]);
    }

    #[test]
    fn eigenvectors_diagonalize() {
        let mut random = SeededRandom::new(7);
        let n = 17;
        let a = symmetric(&mut random, n);
        let (values, vectors) = eigen_symmetric(a.clone(), n);
        assert!(values.windows(2).all(|w| w[0] <= w[1]));
        for (k, value) in values.iter().enumerate() {
            let v = &vectors[k * n..(k + 1) * n];
            for i in 0..n {
                assert!((dot(&a[i * n..(i + 1) * n], v) - value * v[i]).abs() < 1e-12 * values[n - 1]);
            }
            for j in 0..=k {
                let expected = f64::from(u8::from(j == k));
                assert!((dot(v, &vectors[j * n..(j + 1) * n]) - expected).abs() < 1e-13);
            }
        }
    }
}
