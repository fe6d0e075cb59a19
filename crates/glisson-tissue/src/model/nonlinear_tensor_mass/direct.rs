//! The same physics straight from its definition, tetrahedron by tetrahedron: the oracle of the tensor-mass
//! numbers, sharing none of their formulas.
//!
//! F = Id + sum_j u_j alpha_j^T, E = (F^T F - Id)/2, S = dW/dE, P = F S; the force that balances the deformation
//! at corner j is V P alpha_j. The penalty of the volume (see [`super::incompressibility`]) is
//! gamma theta |theta| times the inward area vector of the opposite face, theta = V/V_0 - 1.

use crate::model::tet_law::TetLaw;
use crate::solve::P1Gradients;
use glisson_mesh::math::{DMat3, DVec3, outer, tetrahedron_volume_m3};
use glisson_mesh::mesh::{TetId, TetMesh};

/// A body of St Venant-Kirchhoff tetrahedra.
#[derive(Clone, Copy, Debug)]
pub struct DirectBody<'a> {
    /// The body at rest; its tetrahedra have volume.
    pub mesh: &'a TetMesh,
    /// The law of each tetrahedron.
    pub laws: &'a [TetLaw],
    /// gamma of the volume penalty [Pa].
    pub gamma_pa: f64,
}

impl DirectBody<'_> {
    /// Overwrites `force_n` with the forces [N] that balance displacements.
    pub fn forces_into(&self, displacement_m: &[DVec3], force_n: &mut [DVec3]) {
        force_n.fill(DVec3::ZERO);
        for (t, nodes) in self.mesh.tetrahedra.iter().enumerate() {
            let (gradients, gradient) = self.deformation(t, displacement_m);
            let strain = (gradient.transpose() * gradient - DMat3::IDENTITY) * 0.5;
            let piola = gradient * self.laws[t].stress_pa(strain);
            let here_m = nodes.map(|n| self.mesh.positions_m[n.index()] + displacement_m[n.index()]);
            let share = self.mesh.share(TetId::from_index(t));
            let theta = tetrahedron_volume_m3(here_m) * share / gradients.volume_m3 - 1.0;
            let pressure_pa = self.gamma_pa * theta * theta.abs() * share;
            for (corner, node) in nodes.iter().enumerate() {
                // The outward face's normals in a positive tetrahedron, each seen from its own corner.
                let [a, b, c] = glisson_mesh::mesh::topology::TET_TRIANGLES[corner].map(|i| here_m[i]);
                let outward_area_m2 = (b - a).cross(c - a) * 0.5;
                force_n[node.index()] += piola * gradients.alpha_per_m[corner] * gradients.volume_m3
                    - outward_area_m2 * pressure_pa;
            }
        }
    }

    /// Elastic energy [J] with the penalty's gamma V_0 |theta|^3.
    pub fn energy_j(&self, displacement_m: &[DVec3]) -> f64 {
        let mut energy_j = 0.0;
        for t in 0..self.mesh.tetrahedra.len() {
            let (gradients, gradient) = self.deformation(t, displacement_m);
            let strain = (gradient.transpose() * gradient - DMat3::IDENTITY) * 0.5;
            let theta = (gradient.determinant() - 1.0).abs();
            let density =
                self.laws[t].energy_density_j_per_m3(strain) + self.gamma_pa * theta * theta * theta;
            energy_j += gradients.volume_m3 * density;
        }
        energy_j
    }

    fn deformation(&self, t: usize, displacement_m: &[DVec3]) -> (P1Gradients, DMat3) {
        let gradients = P1Gradients::in_mesh(self.mesh, TetId::from_index(t));
        let nodes = self.mesh.tetrahedra[t];
        let gradient = nodes
            .iter()
            .zip(gradients.alpha_per_m)
            .fold(DMat3::IDENTITY, |f, (n, alpha)| f + outer(displacement_m[n.index()], alpha));
        (gradients, gradient)
    }
}
