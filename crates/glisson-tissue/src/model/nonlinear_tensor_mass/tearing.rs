//! Tearing: which tetrahedra are stretched beyond what the tissue bears.
//!
//! The principal stretches are the square roots of the eigenvalues of F^T F (those of the strain E are
//! (stretch^2 - 1)/2). The largest exceeds s exactly when s^2 Id - F^T F is not positive semi-definite, which the
//! leading minors tell without computing an eigenvalue.

use super::NonlinearTensorMass;
use crate::model::explicit::unpadded;
use glisson_mesh::math::{DMat3, DVec3, outer};
use glisson_mesh::mesh::TetId;

impl NonlinearTensorMass {
    /// Overwrites `torn` with the live tetrahedra that are stretched beyond `largest_stretch` (1 at rest) in some
    /// direction, ascending; those whose shape is no number are among them. A threshold e on the largest
    /// principal strain of E is the stretch sqrt(1 + 2 e). Allocates nothing if `torn` has room.
    pub fn tetrahedra_torn_into(&self, largest_stretch: f64, torn: &mut Vec<TetId>) {
        torn.clear();
        let body = &self.body;
        let u = self.motion.displacements();
        for (t, nodes) in body.tets.iter() {
            let gradient = nodes
                .iter()
                .zip(body.gradients[t].alpha_per_m)
                .fold(DMat3::IDENTITY, |f, (n, alpha)| f + outer(unpadded(&u[n.index()]), alpha));
            if stretched_beyond(gradient, largest_stretch) {
                torn.push(TetId::from_index(t));
            }
        }
    }
}

/// Whether a principal stretch of `gradient` reaches `stretch`, or is no number.
fn stretched_beyond(gradient: DMat3, stretch: f64) -> bool {
    let m = DMat3::from_diagonal(DVec3::splat(stretch * stretch)) - gradient.transpose() * gradient;
    let minor = m.col(0).x * m.col(1).y - m.col(1).x * m.col(0).y;
    !(m.col(0).x > 0.0 && minor > 0.0 && m.determinant() > 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson_mesh::math::SeededRandom;

    #[test]
    fn the_largest_stretch_decides() {
        let mut random = SeededRandom::new(5);
        for _ in 0..200 {
            let mut rotation = || {
                let axis = DVec3::new(random.normal(), random.normal(), random.normal()).normalize();
                DMat3::from_axis_angle(axis, random.uniform_in(0.0, 6.0))
            };
            let (left, right) = (rotation(), rotation());
            let stretches = DVec3::from_array(std::array::from_fn(|_| random.uniform_in(0.2, 2.0)));
            let gradient = left * DMat3::from_diagonal(stretches) * right;
            assert!(stretched_beyond(gradient, 0.999 * stretches.max_element()));
            assert!(!stretched_beyond(gradient, 1.001 * stretches.max_element()));
        }
        assert!(stretched_beyond(DMat3::IDENTITY * f64::NAN, 1.5));
    }
}
