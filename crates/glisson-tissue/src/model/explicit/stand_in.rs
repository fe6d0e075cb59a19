//! Tetrahedra that are inside out, in models whose own forces do not bring them back: springs rest in their mirror image, others have
//! no force there. They follow the stable neo-Hookean law with the stiffness at rest
//! (Smith, De Goes and Kim 2018, doi 10.1145/3180491), which does.
//!
//! The law with ln J has its own continuation: below a J0 of [`LEAST_J`] the part of its energy that depends on J goes on as its
//! Taylor polynomial of second degree, which is finite for any J and pushes a mirrored tetrahedron back. Energy and forces are
//! steady there, so that nothing is gained from one to the other, and the stiffness is bounded: a step stays stable where the
//! logarithm's would not.

use super::{LiveTets, Quarantine};
use crate::material::{
    GuardedStVenantKirchhoff, LinearElastic, Material, SQUEEZED_J, StableNeoHooke, cofactor,
    cofactor_differential, contraction,
};
use crate::model::bounded_vec::BoundedVec;
use crate::solve::P1Gradients;
use glisson_mesh::math::{DMat3, DVec3, is_inverted, outer, tetrahedron_volume_m3};
use glisson_mesh::mesh::NodeId;

/// Forces [N] that balance the deformation of a tetrahedron whose corners are at `corners_m`.
fn forces_n(
    gradients: &P1Gradients,
    corners_m: [DVec3; 4],
    first_piola_pa: impl Fn(&DMat3) -> DMat3,
) -> [DVec3; 4] {
    let P1Gradients { alpha_per_m, volume_m3 } = *gradients;
    let f = (1..4).fold(DMat3::ZERO, |f, k| f + outer(corners_m[k] - corners_m[0], alpha_per_m[k]));
    let stress_pa = first_piola_pa(&f);
    alpha_per_m.map(|alpha| stress_pa * alpha * volume_m3)
}

/// J below which the law with ln J is continued: its stiffness there is about ten times that of nearly incompressible tissue at
/// rest, beyond which the kernel's model does not trust a law either. A choice.
pub(in crate::model) const LEAST_J: f64 = 0.4;

/// The neo-Hookean law with ln J, continued below [`LEAST_J`]: W = mu/2 (I1 - 3) + U(J).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::model) struct ContinuedNeoHookeLog {
    mu_pa: f64,
    /// U, U' and U'' at J0.
    energy_pa: f64,
    slope_pa: f64,
    curvature_pa: f64,
}

impl From<&LinearElastic> for ContinuedNeoHookeLog {
    /// U = lambda/2 (ln J)^2 - mu ln J.
    fn from(material: &LinearElastic) -> Self {
        let (lambda_pa, mu_pa) = (material.lambda_pa(), material.mu_pa());
        let ln_j = libm::log(LEAST_J);
        Self {
            mu_pa,
            energy_pa: (0.5 * lambda_pa * ln_j - mu_pa) * ln_j,
            slope_pa: (lambda_pa * ln_j - mu_pa) / LEAST_J,
            curvature_pa: (lambda_pa * (1.0 - ln_j) + mu_pa) / (LEAST_J * LEAST_J),
        }
    }
}

impl ContinuedNeoHookeLog {
    /// U' [Pa] at a J below [`LEAST_J`].
    fn pressure_pa(&self, f: &DMat3) -> f64 {
        self.slope_pa + self.curvature_pa * (f.determinant() - LEAST_J)
    }
}

/// Below [`LEAST_J`].
impl Material for ContinuedNeoHookeLog {
    fn energy_density_j_per_m3(&self, f: &DMat3) -> f64 {
        let below = f.determinant() - LEAST_J;
        let of_volume_pa = self.energy_pa + (self.slope_pa + 0.5 * self.curvature_pa * below) * below;
        0.5 * self.mu_pa * (contraction(f, f) - 3.0) + of_volume_pa
    }

    fn first_piola_pa(&self, f: &DMat3) -> DMat3 {
        *f * self.mu_pa + cofactor(f) * self.pressure_pa(f)
    }

    fn first_piola_differential_pa(&self, f: &DMat3, df: &DMat3) -> DMat3 {
        let cofactor = cofactor(f);
        *df * self.mu_pa
            + cofactor * (self.curvature_pa * contraction(&cofactor, df))
            + cofactor_differential(f, df) * self.pressure_pa(f)
    }
}

/// What takes the place of a law.
#[derive(Clone, Copy, Debug)]
pub(in crate::model) enum StandIn {
    /// Another law, where a tetrahedron is inside out.
    Stable(StableNeoHooke),
    /// The law's own continuation, below [`LEAST_J`].
    Continued(ContinuedNeoHookeLog),
    /// The law with a guard against being squeezed flat, below [`SQUEEZED_J`].
    Guarded(GuardedStVenantKirchhoff),
}

impl StandIn {
    /// The law that it is.
    pub(in crate::model) fn law(&self) -> &dyn Material {
        match self {
            Self::Stable(law) => law,
            Self::Continued(law) => law,
            Self::Guarded(law) => law,
        }
    }

    /// Whether it stands in for a tetrahedron of these corners; `rest_m`: all nodes at rest.
    pub(in crate::model) fn takes(
        &self,
        nodes: [NodeId; 4],
        positions_m: &[DVec3],
        rest_m: &[DVec3],
    ) -> bool {
        let volume_m3 = |of: &[DVec3]| tetrahedron_volume_m3(nodes.map(|n| of[n.index()]));
        match self {
            Self::Stable(_) => is_inverted(volume_m3(positions_m)),
            Self::Continued(_) => volume_m3(positions_m) < LEAST_J * volume_m3(rest_m),
            Self::Guarded(_) => volume_m3(positions_m) < SQUEEZED_J * volume_m3(rest_m),
        }
    }
}

/// The tetrahedra that do not follow the model's law in the part of a step under way.
#[derive(Clone, Debug)]
pub(in crate::model) struct StandIns {
    law: StandIn,
    taken: BoundedVec<([NodeId; 4], P1Gradients)>,
}

impl StandIns {
    pub(in crate::model) fn new(law: StandIn, n_tets: usize) -> Self {
        Self { law, taken: BoundedVec::with_capacity(n_tets) }
    }

    pub(in crate::model) fn make_room(&mut self, n_tets: usize) {
        self.taken.make_room(n_tets);
    }

    pub(in crate::model) fn clear(&mut self) {
        self.taken.clear();
    }

    /// Finds them; `tell` hears the number of each.
    pub(in crate::model) fn find(
        &mut self,
        tets: &LiveTets,
        positions_m: &[DVec3],
        rest_m: &[DVec3],
        mut tell: impl FnMut(usize),
    ) -> Quarantine {
        self.taken.clear();
        let mut quarantine = Quarantine::default();
        for (t, nodes) in tets.iter() {
            if self.law.takes(*nodes, positions_m, rest_m) {
                let gradients = tets.gradients(t, rest_m);
                self.taken.try_push((*nodes, gradients));
                quarantine.add(t);
                tell(t);
            }
        }
        quarantine
    }

    /// What stands in for tetrahedra.
    pub(in crate::model) fn stand_in(&self) -> &StandIn {
        &self.law
    }

    /// Adds the force [N] that they exert on each node.
    pub(in crate::model) fn add_forces(&self, positions_m: &[DVec3], force_n: &mut [DVec3]) {
        for (nodes, gradients) in self.taken.iter() {
            let corners_m = nodes.map(|n| positions_m[n.index()]);
            let balance_n = forces_n(gradients, corners_m, |f| self.law.law().first_piola_pa(f));
            for (node, f) in nodes.iter().zip(balance_n) {
                force_n[node.index()] -= f;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::NeoHookeLog;

    #[test]
    fn the_continued_law_joins_the_logarithms_and_pushes_mirrored_tissue_back() {
        let material = LinearElastic::from_young_poisson(5e3, 0.45, 1060.0).unwrap();
        let (law, continued) = (NeoHookeLog::from(&material), ContinuedNeoHookeLog::from(&material));
        let squeezed = |j: f64| DMat3::from_diagonal(DVec3::new(1.1, 0.9, j / (1.1 * 0.9)));
        let f = squeezed(LEAST_J);
        assert!((law.first_piola_pa(&f) - continued.first_piola_pa(&f)).abs_diff_eq(DMat3::ZERO, 1e-8));
        // Its slope too: second-order contact.
        let h = 1e-6;
        let slope = |of: &dyn Fn(&DMat3) -> DMat3| {
            (of(&squeezed(LEAST_J + h)) - of(&squeezed(LEAST_J - h))) * (0.5 / h)
        };
        let (a, b) = (slope(&|f| law.first_piola_pa(f)), slope(&|f| continued.first_piola_pa(f)));
        assert!((a - b).abs_diff_eq(DMat3::ZERO, 1e-3 * a.z_axis.z), "{a} {b}");
        // Stress and tangent are the derivatives of the energy.
        let (f, df) =
            (squeezed(0.1), DMat3::from_cols_array(&[0.3, -0.1, 0.2, 0.4, -0.5, 0.1, -0.2, 0.3, 0.6]));
        let energy = |h: f64| continued.energy_density_j_per_m3(&(f + df * h));
        let work = contraction(&continued.first_piola_pa(&f), &df);
        assert!(((energy(h) - energy(-h)) * (0.5 / h) - work).abs() < 1e-5 * work.abs(), "{work}");
        let stress = |h: f64| continued.first_piola_pa(&(f + df * h));
        let change = (stress(h) - stress(-h)) * (0.5 / h);
        assert!((change - continued.first_piola_differential_pa(&f, &df)).abs_diff_eq(DMat3::ZERO, 1e-3));
        // Along the axis that is turned round the stress pulls the wall back, the more the further.
        let stress_pa = |j: f64| continued.first_piola_pa(&squeezed(j)).z_axis.z;
        assert!(stress_pa(-0.2) < stress_pa(0.0) && stress_pa(0.0) < stress_pa(0.2) && stress_pa(0.3) < 0.0);
    }
}
