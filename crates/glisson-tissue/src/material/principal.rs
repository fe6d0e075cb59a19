//! Isotropic laws in principal stretches.
//!
//! With F = U diag(s) V^T (rotations U and V) an isotropic W is a function of the stretches s, and
//! P = U diag(dW/ds_i) V^T. In the frames of U and V the tangent d2W/dF2 falls apart (Smith, de Goes and
//! Kim 2019, doi 10.1145/3241041): the 3x3 matrix d2W/ds_i ds_j for the diagonal entries of U^T dF V, and for
//! each pair (i, j) the two numbers (W_i - W_j)/(s_i - s_j) (symmetric off-diagonal change) and
//! (W_i + W_j)/(s_i + s_j) (antisymmetric: a rotation). Each law writes those quotients without the
//! division, so that equal stretches are no special case.

use super::eigen::{SignedSingularValues, eigen_symmetric, signed_singular_values};
use super::law::{Tangent, add_square};
use glisson_mesh::math::{DMat3, DVec3, outer};

/// The pairs of [`PrincipalDerivatives`]: pair k is the two stretches other than k.
pub(crate) const PAIRS: [[usize; 2]; 3] = [[1, 2], [2, 0], [0, 1]];

/// Derivatives of W(s_0, s_1, s_2) [Pa].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PrincipalDerivatives {
    /// W_i = dW/ds_i.
    pub first: [f64; 3],
    /// W_ij.
    pub second: [[f64; 3]; 3],
    /// (W_i - W_j)/(s_i - s_j) of the pair of stretches other than k.
    pub symmetric: [f64; 3],
    /// (W_i + W_j)/(s_i + s_j) of the pair of stretches other than k.
    pub antisymmetric: [f64; 3],
}

impl PrincipalDerivatives {
    /// Outside the valid range.
    pub(super) const INVALID: Self = Self {
        first: [f64::NAN; 3],
        second: [[f64::NAN; 3]; 3],
        symmetric: [f64::NAN; 3],
        antisymmetric: [f64::NAN; 3],
    };
}

/// P = U diag(W_i) V^T of a law given by its principal derivatives.
pub(super) fn first_piola_pa(f: &DMat3, law: impl Fn([f64; 3]) -> PrincipalDerivatives) -> DMat3 {
    let SignedSingularValues { u, stretches, v } = signed_singular_values(f);
    u * DMat3::from_diagonal(DVec3::from_array(law(stretches).first)) * v.transpose()
}

/// dP of a law given by its principal derivatives.
pub(super) fn first_piola_differential_pa(
    f: &DMat3,
    df: &DMat3,
    law: impl Fn([f64; 3]) -> PrincipalDerivatives,
) -> DMat3 {
    let SignedSingularValues { u, stretches, v } = signed_singular_values(f);
    let d = law(stretches);
    let turned = u.transpose() * *df * v;
    let diagonal = [turned.x_axis.x, turned.y_axis.y, turned.z_axis.z];
    let mut dp = DMat3::ZERO;
    for i in 0..3 {
        dp.col_mut(i)[i] = (0..3).map(|j| d.second[i][j] * diagonal[j]).sum();
    }
    for (k, [i, j]) in PAIRS.into_iter().enumerate() {
        let (ij, ji) = (turned.col(j)[i], turned.col(i)[j]);
        let symmetric = d.symmetric[k] * 0.5 * (ij + ji);
        let antisymmetric = d.antisymmetric[k] * 0.5 * (ij - ji);
        dp.col_mut(j)[i] = symmetric + antisymmetric;
        dp.col_mut(i)[j] = symmetric - antisymmetric;
    }
    u * dp * v.transpose()
}

/// The tangent of a law given by its principal derivatives, as a whole.
pub(super) fn tangent_pa(f: &DMat3, law: impl Fn([f64; 3]) -> PrincipalDerivatives) -> Tangent {
    let SignedSingularValues { u, stretches, v } = signed_singular_values(f);
    let d = law(stretches);
    let diagonal: [[f64; 9]; 3] = std::array::from_fn(|i| outer(u.col(i), v.col(i)).to_cols_array());
    let mut tangent = off_diagonal(&u, &v, &d);
    for i in 0..3 {
        // Rows of this stretch: what it answers to each of the three.
        let answer: [f64; 9] =
            std::array::from_fn(|entry| (0..3).map(|j| d.second[i][j] * diagonal[j][entry]).sum());
        for row in 0..9 {
            for column in 0..9 {
                tangent[row][column] += diagonal[i][row] * answer[column];
            }
        }
    }
    tangent
}

/// The tangent without its negative eigenvalues, of a law given by its principal derivatives.
pub(super) fn projected_tangent_pa(f: &DMat3, law: impl Fn([f64; 3]) -> PrincipalDerivatives) -> Tangent {
    let SignedSingularValues { u, stretches, v } = signed_singular_values(f);
    let mut d = law(stretches);
    let finite = d.second.iter().flatten().chain(&d.symmetric).chain(&d.antisymmetric).all(|x| x.is_finite());
    if !finite {
        return [[f64::NAN; 9]; 9];
    }
    d.symmetric = d.symmetric.map(|x| x.max(0.0));
    d.antisymmetric = d.antisymmetric.map(|x| x.max(0.0));
    let mut tangent = off_diagonal(&u, &v, &d);
    let (values, vectors) = eigen_symmetric(&d.second);
    let diagonal: [DMat3; 3] = std::array::from_fn(|i| outer(u.col(i), v.col(i)));
    for (value, weights) in values.into_iter().zip(vectors) {
        if value > 0.0 {
            let matrix = diagonal[0] * weights[0] + diagonal[1] * weights[1] + diagonal[2] * weights[2];
            add_square(&mut tangent, value, &matrix.to_cols_array());
        }
    }
    tangent
}

/// The part of the tangent that answers changes off the diagonal of U^T dF V.
fn off_diagonal(u: &DMat3, v: &DMat3, d: &PrincipalDerivatives) -> Tangent {
    let mut tangent = [[0.0; 9]; 9];
    for (k, [i, j]) in PAIRS.into_iter().enumerate() {
        let (ij, ji) = (outer(u.col(i), v.col(j)), outer(u.col(j), v.col(i)));
        add_square(&mut tangent, 0.5 * d.symmetric[k], &(ij + ji).to_cols_array());
        add_square(&mut tangent, 0.5 * d.antisymmetric[k], &(ij - ji).to_cols_array());
    }
    tangent
}
