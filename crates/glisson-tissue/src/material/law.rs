//! A hyperelastic law: three functions of the deformation gradient F = dx/dX.
//!
//! W(F) is the energy stored per rest volume [J/m3], P = dW/dF the first Piola-Kirchhoff stress [Pa], and
//! dP = (d2W/dF2) : dF its differential. A rotation invariant law has W(QF) = W(F).
//! Matrices as vectors of nine: entry (row r, column c) is number 3 c + r, glam's order.
//!
//! Outside its valid range (an inverted F of a law with ln J) a law gives an infinite energy and a stress that
//! is not finite; solvers treat both as "step too long".

use super::eigen::eigen_symmetric;
use glisson_mesh::math::{DMat3, DVec3, rotation_about};
use std::f64::consts::FRAC_PI_4;

/// d2W/dF2 [Pa]: row 3 c + r is the change of P's entry (r, c), columns are F's entries; symmetric.
pub type Tangent = [[f64; 9]; 9];

/// A hyperelastic law with its parameters; a fibre direction is one of them. A body whose parameters vary has
/// one law value per tetrahedron.
pub trait Material: Sync {
    /// W(F) [J/m3]: zero at rest, infinite outside the valid range.
    fn energy_density_j_per_m3(&self, f: &DMat3) -> f64;

    /// P = dW/dF [Pa].
    fn first_piola_pa(&self, f: &DMat3) -> DMat3;

    /// dP = (d2W/dF2) : dF [Pa], linear in `df`.
    fn first_piola_differential_pa(&self, f: &DMat3, df: &DMat3) -> DMat3;

    /// d2W/dF2 [Pa] as a matrix: the differential of each of the nine unit changes.
    fn tangent_pa(&self, f: &DMat3) -> Tangent {
        std::array::from_fn(|entry| {
            let mut df = DMat3::ZERO;
            df.col_mut(entry / 3)[entry % 3] = 1.0;
            // Symmetric: the change by entry k is row k as well as column k.
            self.first_piola_differential_pa(f, &df).to_cols_array()
        })
    }

    /// The symmetric positive semi-definite matrix [Pa] nearest to [`Material::tangent_pa`] (Frobenius norm). With it,
    /// Newton's method always has a descent direction (Teran, Sifakis, Irving and Fedkiw 2005,
    /// doi 10.1145/1073368.1073394). Isotropic laws have it in closed form, see [`super::principal`].
    fn projected_tangent_pa(&self, f: &DMat3) -> Tangent {
        projected(&self.tangent_pa(f))
    }

    /// Lame's lambda and mu [Pa] nearest to the stiffness at rest: means over the axes.
    fn lame_at_rest_pa(&self) -> [f64; 2] {
        let tangent = self.tangent_pa(&DMat3::IDENTITY);
        let lambda_pa = (tangent[0][4] + tangent[0][8] + tangent[4][8]) / 3.0;
        let mu_pa = (tangent[1][1] + tangent[2][2] + tangent[5][5]) / 3.0;
        [lambda_pa, mu_pa]
    }

    /// Whether the stress brings tissue that was turned inside out back to its shape. A law in which it has no number there, or
    /// rests in its mirror image, does not: models let another law bring it back.
    fn returns_from_inversion(&self) -> bool {
        false
    }
}

/// A borrowed law is a law: use `&[&dyn Material]` for mixed laws.
impl<M: Material + ?Sized> Material for &M {
    fn energy_density_j_per_m3(&self, f: &DMat3) -> f64 {
        (**self).energy_density_j_per_m3(f)
    }

    fn first_piola_pa(&self, f: &DMat3) -> DMat3 {
        (**self).first_piola_pa(f)
    }

    fn first_piola_differential_pa(&self, f: &DMat3, df: &DMat3) -> DMat3 {
        (**self).first_piola_differential_pa(f, df)
    }

    fn tangent_pa(&self, f: &DMat3) -> Tangent {
        (**self).tangent_pa(f)
    }

    fn lame_at_rest_pa(&self) -> [f64; 2] {
        (**self).lame_at_rest_pa()
    }

    fn returns_from_inversion(&self) -> bool {
        (**self).returns_from_inversion()
    }

    fn projected_tangent_pa(&self, f: &DMat3) -> Tangent {
        (**self).projected_tangent_pa(f)
    }
}

/// The nearest symmetric matrix without negative eigenvalues; a matrix that is not finite is returned as it is.
pub fn projected(tangent: &Tangent) -> Tangent {
    if !tangent.iter().flatten().all(|x| x.is_finite()) {
        return *tangent;
    }
    let (values, vectors) = eigen_symmetric(tangent);
    let mut result = [[0.0; 9]; 9];
    for (value, vector) in values.iter().zip(&vectors) {
        if *value > 0.0 {
            add_square(&mut result, *value, vector);
        }
    }
    result
}

/// Principal stretches at which [`largest_tangent_eigenvalue_pa`] looks, from the smallest to the largest.
const STRETCHES_SEEN: i32 = 5;

/// The largest eigenvalue of d2W/dF2 [Pa] for principal stretches within [1/s, s], on a grid of stretches along the axes and
/// along three other frames, so that some lie along fibres. A lower estimate, exact for laws whose stiffest state is at the
/// ends of the range.
pub fn largest_tangent_eigenvalue_pa(law: &dyn Material, largest_stretch: f64) -> f64 {
    let stretch =
        |i: i32| libm::pow(largest_stretch, 2.0 * f64::from(i) / f64::from(STRETCHES_SEEN - 1) - 1.0);
    let frames = [
        DMat3::IDENTITY,
        DMat3::from_quat(rotation_about(DVec3::X, FRAC_PI_4)),
        DMat3::from_quat(rotation_about(DVec3::Y, FRAC_PI_4)),
        DMat3::from_quat(rotation_about(DVec3::Z, FRAC_PI_4)),
    ];
    let mut largest_pa = 0.0_f64;
    for frame in frames {
        for (i, j, k) in (0..STRETCHES_SEEN.pow(3)).map(|n| {
            let n_seen = STRETCHES_SEEN;
            (n % n_seen, n / n_seen % n_seen, n / (n_seen * n_seen))
        }) {
            let stretches = glisson_mesh::math::DVec3::new(stretch(i), stretch(j), stretch(k));
            let f = frame * DMat3::from_diagonal(stretches) * frame.transpose();
            let (values, _) = eigen_symmetric(&law.tangent_pa(&f));
            largest_pa = values.into_iter().filter(|value| value.is_finite()).fold(largest_pa, f64::max);
        }
    }
    largest_pa
}

/// Adds value v v^T.
pub(super) fn add_square(tangent: &mut Tangent, value: f64, vector: &[f64; 9]) {
    for i in 0..9 {
        let factor = value * vector[i];
        for j in 0..9 {
            tangent[i][j] += factor * vector[j];
        }
    }
}

/// a : b, the sum of products of entries.
pub(crate) fn contraction(a: &DMat3, b: &DMat3) -> f64 {
    a.x_axis.dot(b.x_axis) + a.y_axis.dot(b.y_axis) + a.z_axis.dot(b.z_axis)
}

/// dJ/dF: the cofactor matrix J F^-T, defined for any F.
pub(crate) fn cofactor(f: &DMat3) -> DMat3 {
    DMat3::from_cols(f.y_axis.cross(f.z_axis), f.z_axis.cross(f.x_axis), f.x_axis.cross(f.y_axis))
}

/// Change of the cofactor matrix: linear in both arguments.
pub(crate) fn cofactor_differential(f: &DMat3, df: &DMat3) -> DMat3 {
    DMat3::from_cols(
        df.y_axis.cross(f.z_axis) + f.y_axis.cross(df.z_axis),
        df.z_axis.cross(f.x_axis) + f.z_axis.cross(df.x_axis),
        df.x_axis.cross(f.y_axis) + f.x_axis.cross(df.y_axis),
    )
}
