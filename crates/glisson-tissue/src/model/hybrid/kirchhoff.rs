//! St Venant-Kirchhoff tetrahedra of dynamic zones, evaluated directly from the definition.
//!
//! F = Id + sum_j u_j alpha_j^T, E = (F^T F - Id)/2, P = F S(E); the force that balances the deformation at corner j is
//! V P alpha_j ([`TetLaw`], seeds `002` and `004`). For the few tetrahedra of a zone this takes fewer operations than
//! the accumulated tensors of [`crate::model::nonlinear_tensor_mass`]; the physics is the same.
//!
//! A stress at rest S0 makes P = F (S + S0). Its constant part V S0 alpha_j is kept elsewhere, as in the linear zones.

use crate::material::squeeze_guard_pa;
use crate::model::tet_law::TetLaw;
use crate::solve::{P1Gradients, RestStress, stress_tensor_pa};
use glisson_mesh::math::{DMat3, DVec3, is_inverted, outer};

/// A tetrahedron at rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct KirchhoffTet {
    gradients: P1Gradients,
    rest_stress_pa: DMat3,
}

impl KirchhoffTet {
    pub(super) fn new(gradients: P1Gradients, rest_stress_pa: Option<&RestStress>) -> Self {
        let rest_stress_pa = rest_stress_pa.map_or(DMat3::ZERO, |stress| stress_tensor_pa(*stress));
        Self { gradients, rest_stress_pa }
    }

    /// Forces [N] that balance the corners' displacements [m], without the constant forces of the stress at rest, and
    /// whether the tetrahedron is inverted. A squeezed one is guarded ([`squeeze_guard_pa`]), because St Venant-Kirchhoff tissue is also at
    /// rest in its mirror image.
    pub(super) fn forces_n(&self, law: &TetLaw, u_m: [DVec3; 4]) -> ([DVec3; 4], bool) {
        let P1Gradients { alpha_per_m, volume_m3 } = self.gradients;
        let f = (0..4).fold(DMat3::IDENTITY, |f, k| f + outer(u_m[k], alpha_per_m[k]));
        let strain = (f.transpose() * f - DMat3::IDENTITY) * 0.5;
        let own_pa = f * law.stress_pa(strain) + (f - DMat3::IDENTITY) * self.rest_stress_pa;
        let guard_pa = squeeze_guard_pa(&f, law.lambda_pa, law.mu_pa);
        let piola_pa = guard_pa.map_or(own_pa, |guard_pa| own_pa + guard_pa);
        (alpha_per_m.map(|alpha| piola_pa * alpha * volume_m3), is_inverted(f.determinant()))
    }

    /// Forces [N] of linear elasticity minus those of [`KirchhoffTet::forces_n`], without a stress at rest. A linear
    /// system with this load has the forces of the non-linear tetrahedron.
    pub(super) fn linear_surplus_n(&self, law: &TetLaw, u_m: [DVec3; 4]) -> ([DVec3; 4], bool) {
        let P1Gradients { alpha_per_m, volume_m3 } = self.gradients;
        let gradient = (0..4).fold(DMat3::ZERO, |g, k| g + outer(u_m[k], alpha_per_m[k]));
        let stress_pa = law.stress_pa((gradient + gradient.transpose()) * 0.5);
        let (mut surplus_n, is_inverted) = self.forces_n(law, u_m);
        for (f, alpha) in surplus_n.iter_mut().zip(alpha_per_m) {
            *f = stress_pa * alpha * volume_m3 - *f;
        }
        (surplus_n, is_inverted)
    }
}
