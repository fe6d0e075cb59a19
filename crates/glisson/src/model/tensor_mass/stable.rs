//! The largest stable step of central differences.
//!
//! The scheme is stable for h <= 2/omega_max with omega_max^2 the largest eigenvalue of M^-1 K; damping in
//! proportion to mass leaves the bound as it is (the roots of
//! (1 + d h/2) z^2 - (2 - omega^2 h^2) z + (1 - d h/2) = 0 stay in the unit circle for omega h <= 2).
//! K and the lumped M are sums over tetrahedra, so the largest Rayleigh quotient of the whole, a quotient of
//! sums, is at most the largest quotient of a single tetrahedron with its own mass rho V/4 a corner (the
//! element eigenvalue theorem of Irons and Treharne, 1971, 3rd Conference on Matrix Methods in Structural
//! Mechanics). Each is bounded from above by [`TetStiffness::largest_eigenvalue_bound_n_per_m`], at most 2.8 %
//! too high, 1.4 % in the step. Fixing nodes or removing tetrahedra never raises the bound, so it holds before
//! and after cuts. The price: corners share their mass with neighbours of lower frequency, so the true limit
//! is higher (about twice on a mesh of even quality).

#[cfg(doc)]
use crate::solve::TetStiffness;

use crate::material::LinearElastic;
use crate::mesh::{TetId, TetMesh};
use crate::solve::{P1Gradients, SolveError};

/// Kept below the exact bound, where a mode at omega h = 2 would grow by rounding.
const MARGIN: f64 = 0.999;

/// The largest stable step, and what limits it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StableStep {
    /// Largest step [s].
    pub step_s: f64,
    /// The tetrahedron of highest frequency.
    pub tet: TetId,
}

impl StableStep {
    /// Bound for a mesh of one material.
    ///
    /// # Errors
    /// [`SolveError`] for an empty mesh or a flat or inverted tetrahedron.
    pub(super) fn of(mesh: &TetMesh, material: &LinearElastic) -> Result<Self, SolveError> {
        let mut highest = (0.0, TetId(0));
        for t in 0..mesh.tetrahedra.len() {
            let tet = TetId::from_index(t);
            let gradients = P1Gradients::of_tet(mesh, tet)?;
            let stiffness = gradients.stiffness(material.lambda_pa(), material.mu_pa());
            let corner_mass_kg = material.density_kg_per_m3() * gradients.volume_m3 / 4.0;
            let omega_squared = stiffness.largest_eigenvalue_bound_n_per_m() / corner_mass_kg;
            if omega_squared > highest.0 {
                highest = (omega_squared, tet);
            }
        }
        if highest.0 > 0.0 {
            Ok(Self { step_s: MARGIN * 2.0 / highest.0.sqrt(), tet: highest.1 })
        } else {
            Err(SolveError::EmptyMesh)
        }
    }
}
