//! Eigenvalues of small symmetric matrices and the rotation-variant singular values of a 3x3 matrix, both by
//! Jacobi rotations (Golub and Van Loan, Matrix Computations, 4th edition 2013, s. 8.5 and 8.6.3): accurate to
//! rounding, no special cases for equal values, same bits everywhere.

use glisson_mesh::math::{DMat3, DVec3};

/// Sweeps after which the rotations stop in any case: convergence is quadratic, matrices of size 9 take about 7.
const MOST_SWEEPS: usize = 30;

/// Cosine and sine of the rotation that diagonalizes [[a, b], [b, d]], the smaller of the two angles.
fn rotation(a: f64, b: f64, d: f64) -> (f64, f64) {
    let tau = (d - a) / (2.0 * b);
    let t = if tau >= 0.0 { 1.0 } else { -1.0 } / (tau.abs() + (1.0 + tau * tau).sqrt());
    let c = 1.0 / (1.0 + t * t).sqrt();
    (c, t * c)
}

/// Eigenvalues and unit eigenvectors (`vectors[k]` belongs to `values[k]`) of a symmetric matrix, in no
/// particular order.
pub fn eigen_symmetric<const N: usize>(matrix: &[[f64; N]; N]) -> ([f64; N], [[f64; N]; N]) {
    let mut a = *matrix;
    let mut vectors = [[0.0; N]; N];
    for k in 0..N {
        vectors[k][k] = 1.0;
    }
    let scale: f64 = a.iter().flatten().map(|x| x.abs()).fold(0.0, f64::max);
    for _ in 0..MOST_SWEEPS {
        let mut done = true;
        for p in 0..N {
            for q in p + 1..N {
                if a[p][q].abs() <= f64::EPSILON * 1e-3 * scale {
                    continue;
                }
                done = false;
                let (c, s) = rotation(a[p][p], a[p][q], a[q][q]);
                for k in 0..N {
                    let (x, y) = (a[k][p], a[k][q]);
                    (a[k][p], a[k][q]) = (c * x - s * y, s * x + c * y);
                }
                for k in 0..N {
                    let (x, y) = (a[p][k], a[q][k]);
                    (a[p][k], a[q][k]) = (c * x - s * y, s * x + c * y);
                    let (x, y) = (vectors[p][k], vectors[q][k]);
                    (vectors[p][k], vectors[q][k]) = (c * x - s * y, s * x + c * y);
                }
            }
        }
        if done {
            break;
        }
    }
    (std::array::from_fn(|k| a[k][k]), vectors)
}

/// F = U diag(stretches) V^T with rotations U and V.
pub(crate) struct SignedSingularValues {
    pub(crate) u: DMat3,
    /// Principal stretches; the one of least magnitude carries the sign of det F.
    pub(crate) stretches: [f64; 3],
    pub(crate) v: DMat3,
}

/// The decomposition with rotations on both sides (Irving, Teran and Fedkiw 2004,
/// doi 10.1145/1028523.1028541), by one-sided Jacobi: columns of F V are made orthogonal.
pub(crate) fn signed_singular_values(f: &DMat3) -> SignedSingularValues {
    let mut a = [f.x_axis, f.y_axis, f.z_axis];
    let mut v = DVec3::AXES;
    for _ in 0..MOST_SWEEPS {
        let mut done = true;
        for [p, q] in [[0, 1], [0, 2], [1, 2]] {
            let (pp, pq, qq) = (a[p].dot(a[p]), a[p].dot(a[q]), a[q].dot(a[q]));
            // Not `<=` negated: NaN must stop.
            if pq.abs() > f64::EPSILON * (pp * qq).sqrt() {
                done = false;
                let (c, s) = rotation(pp, pq, qq);
                (a[p], a[q]) = (c * a[p] - s * a[q], s * a[p] + c * a[q]);
                (v[p], v[q]) = (c * v[p] - s * v[q], s * v[p] + c * v[q]);
            }
        }
        if done {
            break;
        }
    }
    let length = a.map(DVec3::length);
    let by_length = |x: &usize, y: &usize| length[*x].total_cmp(&length[*y]);
    let most = (0..3).max_by(by_length).expect("three columns");
    let least = (0..3).filter(|&k| k != most).min_by(by_length).expect("two columns");
    let middle = 3 - most - least;
    let mut u = [DVec3::ZERO; 3];
    u[most] = if length[most] > 0.0 { a[most] / length[most] } else { DVec3::AXES[most] };
    // Of a matrix of rank one the second direction is free.
    let second = a[middle] - u[most] * u[most].dot(a[middle]);
    u[middle] = second.try_normalize().unwrap_or_else(|| u[most].any_orthonormal_vector());
    u[least] = u[(least + 1) % 3].cross(u[(least + 2) % 3]);
    let mut stretches = length;
    stretches[least] = u[least].dot(a[least]);
    SignedSingularValues {
        u: DMat3::from_cols(u[0], u[1], u[2]),
        stretches,
        v: DMat3::from_cols(v[0], v[1], v[2]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson_mesh::math::SeededRandom;

    #[test]
    fn a_symmetric_matrix_is_rebuilt_from_its_eigenvalues() {
        let mut random = SeededRandom::new(1);
        for round in 0..50 {
            let mut matrix = [[0.0; 9]; 9];
            for i in 0..9 {
                for j in 0..=i {
                    matrix[i][j] = if round == 0 { 0.0 } else { random.normal() };
                    matrix[j][i] = matrix[i][j];
                }
            }
            let (values, vectors) = eigen_symmetric(&matrix);
            for i in 0..9 {
                for j in 0..9 {
                    let rebuilt: f64 = (0..9).map(|k| values[k] * vectors[k][i] * vectors[k][j]).sum();
                    assert!((rebuilt - matrix[i][j]).abs() < 1e-13, "{i} {j}");
                    let unit: f64 = (0..9).map(|k| vectors[i][k] * vectors[j][k]).sum();
                    assert!((unit - f64::from(u8::from(i == j))).abs() < 1e-13);
                }
            }
        }
    }

    #[test]
    fn singular_values_rebuild_any_matrix_with_two_rotations() {
        let mut random = SeededRandom::new(2);
        let mut cases = vec![
            DMat3::IDENTITY,
            DMat3::ZERO,
            DMat3::from_diagonal(DVec3::new(2.0, 2.0, -2.0)),
            DMat3::from_diagonal(DVec3::new(0.0, 3.0, 0.0)),
            DMat3::from_diagonal(DVec3::new(1e-9, 1.0, 1e9)),
            glisson_mesh::math::outer(DVec3::new(1.0, 2.0, 3.0), DVec3::new(-1.0, 0.5, 2.0)),
        ];
        for _ in 0..100 {
            cases.push(DMat3::from_cols_array(&std::array::from_fn(|_| random.normal())));
        }
        for f in cases {
            let SignedSingularValues { u, stretches, v } = signed_singular_values(&f);
            let scale = stretches.iter().fold(0.0, |m: f64, s| m.max(s.abs())).max(1e-300);
            let rebuilt = u * DMat3::from_diagonal(DVec3::from_array(stretches)) * v.transpose();
            assert!(rebuilt.abs_diff_eq(f, 1e-14 * scale), "{f} {rebuilt}");
            for q in [u, v] {
                assert!((q * q.transpose()).abs_diff_eq(DMat3::IDENTITY, 1e-14), "{f}");
                assert!((q.determinant() - 1.0).abs() < 1e-14, "{f}");
            }
        }
    }
}
