//! The tangent stiffness of one tetrahedron of an isotropic law without its negative eigenvalues.
//!
//! For an isotropic energy psi(s1, s2, s3) of the singular values of F = U S V^T the differential of the stress
//! has nine eigenmatrices (Smith, De Goes and Kim 2019, doi 10.1145/3241041): three stretches, mixed by the
//! Hessian of psi, and for each pair (i, j) a twist with (psi_i + psi_j)/(s_i + s_j) and a flip with
//! (psi_i - psi_j)/(s_i - s_j). Negative ones are set to zero; the result is symmetric positive semi-definite.
//!
//! In the ln J neo-Hookean law, with c = mu - lambda ln J,
//!
//! psi_ii = mu + (c + lambda)/s_i^2, psi_ij = lambda/(s_i s_j), twist mu - c/(s_i s_j), flip mu + c/(s_i s_j).

use crate::solve::{LOCAL_EDGES, TetStiffness};
use glisson_mesh::math::{DMat3, DVec3};

/// The pairs of singular values, in the order of [`Modes::twist_pa`] and [`Modes::flip_pa`].
pub(super) const PAIRS: [[usize; 2]; 3] = [[0, 1], [0, 2], [1, 2]];

/// The tangent of an isotropic law in the frames of F = U S V^T.
pub(super) struct Modes {
    pub(super) u: DMat3,
    pub(super) v: DMat3,
    /// The Hessian of psi in the singular values [Pa].
    pub(super) hessian_pa: DMat3,
    /// Eigenvalues [Pa] of the twists, and of the flips.
    pub(super) twist_pa: [f64; 3],
    pub(super) flip_pa: [f64; 3],
}

impl Modes {
    /// Stiffness without negative eigenvalues for gradients alpha_1..alpha_3 and the rest volume.
    pub(super) fn projected_stiffness(&self, alpha_per_m: [DVec3; 3], volume_m3: f64) -> TetStiffness {
        let u = self.u;
        let stretch = without_negative_eigenvalues(self.hessian_pa);
        let inner = self.v.transpose();
        let first = -(alpha_per_m[0] + alpha_per_m[1] + alpha_per_m[2]);
        let a = [first, alpha_per_m[0], alpha_per_m[1], alpha_per_m[2]].map(|x| inner * x);
        let mut sums = [0.0; 3];
        let mut differences = [0.0; 3];
        for k in 0..3 {
            let (twist, flip) = (self.twist_pa[k].max(0.0), self.flip_pa[k].max(0.0));
            sums[k] = 0.5 * (twist + flip);
            differences[k] = 0.5 * (flip - twist);
        }
        let block = |j: usize, k: usize| {
            let (x, y) = (a[j], a[k]);
            let mut local = [[0.0; 3]; 3];
            for r in 0..3 {
                for q in 0..3 {
                    local[q][r] = x[r] * stretch.col(q)[r] * y[q];
                }
            }
            for (m, [p, q]) in PAIRS.into_iter().enumerate() {
                local[p][p] += sums[m] * x[q] * y[q];
                local[q][q] += sums[m] * x[p] * y[p];
                local[q][p] += differences[m] * x[q] * y[p];
                local[p][q] += differences[m] * x[p] * y[q];
            }
            u * DMat3::from_cols_array_2d(&local) * u.transpose() * volume_m3
        };
        TetStiffness {
            vertex: [block(0, 0), block(1, 1), block(2, 2), block(3, 3)],
            edge: LOCAL_EDGES.map(|[j, k]| block(j, k)),
        }
    }
}

/// Projected stiffness of the ln J neo-Hookean law for the deformation gradient `f`, gradients alpha_1..alpha_3 and the
/// rest volume. J must be positive.
pub(super) fn projected_stiffness(
    f: DMat3,
    alpha_per_m: [DVec3; 3],
    volume_m3: f64,
    [lambda_pa, mu_pa]: [f64; 2],
) -> TetStiffness {
    let (squares, v) = symmetric_eigen(f.transpose() * f);
    let s = [0, 1, 2].map(|i| squares[i].max(1e-30).sqrt());
    let fv = f * v;
    let u = DMat3::from_cols(fv.col(0) / s[0], fv.col(1) / s[1], fv.col(2) / s[2]);
    let c = mu_pa - lambda_pa * libm::log(s[0] * s[1] * s[2]);
    let hessian = DMat3::from_cols_array_2d(&[0, 1, 2].map(|i| {
        [0, 1, 2].map(|j| lambda_pa / (s[i] * s[j]) + if i == j { mu_pa + c / (s[i] * s[i]) } else { 0.0 })
    }));
    let shares = PAIRS.map(|[i, j]| c / (s[i] * s[j]));
    let modes = Modes {
        u,
        v,
        hessian_pa: hessian,
        twist_pa: shares.map(|share| mu_pa - share),
        flip_pa: shares.map(|share| mu_pa + share),
    };
    modes.projected_stiffness(alpha_per_m, volume_m3)
}

/// The nearest symmetric matrix without negative eigenvalues.
pub(super) fn without_negative_eigenvalues(matrix: DMat3) -> DMat3 {
    let (values, vectors) = symmetric_eigen(matrix);
    let clamped = DMat3::from_diagonal(DVec3::from_array(values.map(|x| x.max(0.0))));
    vectors * clamped * vectors.transpose()
}

/// Eigenvalues and eigenvectors (columns, right-handed) of a symmetric matrix by cyclic Jacobi rotations.
fn symmetric_eigen(matrix: DMat3) -> ([f64; 3], DMat3) {
    let mut a = matrix.to_cols_array_2d();
    let mut v = DMat3::IDENTITY.to_cols_array_2d();
    for _ in 0..MOST_SWEEPS {
        let off = a[0][1] * a[0][1] + a[0][2] * a[0][2] + a[1][2] * a[1][2];
        let diagonal = a[0][0] * a[0][0] + a[1][1] * a[1][1] + a[2][2] * a[2][2];
        if off <= 1e-30 * diagonal {
            break;
        }
        for [p, q] in [[0, 1], [0, 2], [1, 2]] {
            if a[p][q] == 0.0 {
                continue;
            }
            let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
            let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
            let cos = 1.0 / (t * t + 1.0).sqrt();
            let sin = t * cos;
            for k in 0..3 {
                let (x, y) = (a[k][p], a[k][q]);
                a[k][p] = cos * x - sin * y;
                a[k][q] = sin * x + cos * y;
            }
            for k in 0..3 {
                let (x, y) = (a[p][k], a[q][k]);
                a[p][k] = cos * x - sin * y;
                a[q][k] = sin * x + cos * y;
            }
            for k in 0..3 {
                let (x, y) = (v[p][k], v[q][k]);
                v[p][k] = cos * x - sin * y;
                v[q][k] = sin * x + cos * y;
            }
        }
    }
    ([a[0][0], a[1][1], a[2][2]], DMat3::from_cols_array_2d(&v))
}

/// Cyclic Jacobi converges quadratically: five sweeps suffice for a 3x3 matrix.
const MOST_SWEEPS: usize = 8;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::P1Gradients;
    use glisson_mesh::math::{SeededRandom, outer, tetrahedron_volume_m3};

    fn random_vector(random: &mut SeededRandom, scale: f64) -> DVec3 {
        DVec3::new(random.normal(), random.normal(), random.normal()) * scale
    }

    /// In slight tension all eigenvalues are positive: the projection changes nothing and must be the differential.
    #[test]
    fn in_slight_tension_it_is_the_differential_of_the_stress() {
        let mut random = SeededRandom::new(3);
        let [lambda, mu] = [9000.0, 1000.0];
        let corners = [DVec3::ZERO, DVec3::X, DVec3::new(0.1, 1.0, 0.2), DVec3::new(0.3, 0.1, 0.9)];
        assert!(tetrahedron_volume_m3(corners) > 0.0);
        let g = P1Gradients::new(corners);
        let rotation = DMat3::from_rotation_y(0.7);
        let f = rotation * DMat3::from_diagonal(DVec3::new(1.05, 1.02, 1.06)) * DMat3::from_rotation_x(0.4);
        let alpha = [1, 2, 3].map(|k| g.alpha_per_m[k]);
        let k = projected_stiffness(f, alpha, g.volume_m3, [lambda, mu]);
        let stress = |f: DMat3| {
            let q = f.inverse().transpose();
            f * mu - q * (mu - lambda * libm::log(f.determinant()))
        };
        for _ in 0..20 {
            let d: [DVec3; 4] = std::array::from_fn(|_| random_vector(&mut random, 1.0));
            let df: DMat3 = (0..4).map(|j| outer(d[j], g.alpha_per_m[j])).fold(DMat3::ZERO, |sum, m| sum + m);
            let step = 1e-6;
            let dp = (stress(f + df * step) - stress(f - df * step)) * (0.5 / step);
            for j in 0..4 {
                let expected = dp * g.alpha_per_m[j] * g.volume_m3;
                let mut found = k.vertex[j] * d[j];
                for (e, [a, b]) in LOCAL_EDGES.into_iter().enumerate() {
                    if a == j {
                        found += k.edge[e] * d[b];
                    } else if b == j {
                        found += k.edge[e].transpose() * d[a];
                    }
                }
                assert!((found - expected).length() <= 1e-5 * expected.length(), "{found} {expected}");
            }
        }
    }

    #[test]
    fn in_compression_no_direction_has_negative_curvature() {
        let mut random = SeededRandom::new(4);
        let g = P1Gradients::new([DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z]);
        for _ in 0..50 {
            let mut f = DMat3::from_cols(
                random_vector(&mut random, 0.5),
                random_vector(&mut random, 0.5),
                random_vector(&mut random, 0.5),
            );
            if f.determinant() < 0.0 {
                f.x_axis = -f.x_axis;
            }
            let alpha = [1, 2, 3].map(|k| g.alpha_per_m[k]);
            let k = projected_stiffness(f, alpha, g.volume_m3, [9000.0, 1000.0]);
            let largest = k.vertex.iter().map(|m| m.col(0).length()).fold(0.0, f64::max);
            for _ in 0..50 {
                let d: [DVec3; 4] = std::array::from_fn(|_| random_vector(&mut random, 1.0));
                let mut curvature = (0..4).map(|j| d[j].dot(k.vertex[j] * d[j])).sum::<f64>();
                for (e, [a, b]) in LOCAL_EDGES.into_iter().enumerate() {
                    curvature += 2.0 * d[a].dot(k.edge[e] * d[b]);
                }
                assert!(curvature >= -1e-9 * largest, "{curvature} of {largest}");
            }
        }
    }
}
