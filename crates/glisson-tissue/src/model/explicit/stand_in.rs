//! Tetrahedra that are inside out, in models whose own forces do not bring them back: St Venant-Kirchhoff tissue and springs
//! rest in their mirror image, others have no force there. They follow the stable neo-Hookean law with the stiffness at rest
//! (Smith, De Goes and Kim 2018, doi 10.1145/3180491), which does.

use super::{LiveTets, Quarantine};
use crate::material::{Material, StableNeoHooke};
use crate::model::bounded_vec::BoundedVec;
use crate::solve::P1Gradients;
use glisson_mesh::math::{DMat3, DVec3, is_inverted, outer, tetrahedron_volume_m3};
use glisson_mesh::mesh::NodeId;

/// Forces [N] that balance the deformation of a tetrahedron whose corners are at `corners_m`, by the stand-in's law.
pub(in crate::model) fn stand_in_forces_n(
    law: &StableNeoHooke,
    gradients: &P1Gradients,
    corners_m: [DVec3; 4],
) -> [DVec3; 4] {
    let P1Gradients { alpha_per_m, volume_m3 } = *gradients;
    let f = (1..4).fold(DMat3::ZERO, |f, k| f + outer(corners_m[k] - corners_m[0], alpha_per_m[k]));
    let stress_pa = law.first_piola_pa(&f);
    alpha_per_m.map(|alpha| stress_pa * alpha * volume_m3)
}

/// The tetrahedra that are inside out in the part of a step under way.
#[derive(Clone, Debug)]
pub(in crate::model) struct StandIns {
    law: StableNeoHooke,
    inverted: BoundedVec<([NodeId; 4], P1Gradients)>,
}

impl StandIns {
    pub(in crate::model) fn new(law: StableNeoHooke, n_tets: usize) -> Self {
        Self { law, inverted: BoundedVec::with_capacity(n_tets) }
    }

    pub(in crate::model) fn make_room(&mut self, n_tets: usize) {
        self.inverted.make_room(n_tets);
    }

    pub(in crate::model) fn clear(&mut self) {
        self.inverted.clear();
    }

    /// Finds them; `tell` hears the number of each.
    pub(in crate::model) fn find(
        &mut self,
        tets: &LiveTets,
        positions_m: &[DVec3],
        rest_m: &[DVec3],
        mut tell: impl FnMut(usize),
    ) -> Quarantine {
        self.inverted.clear();
        let mut quarantine = Quarantine::default();
        for (t, nodes) in tets.iter() {
            if is_inverted(tetrahedron_volume_m3(nodes.map(|n| positions_m[n.index()]))) {
                let gradients = P1Gradients::new(nodes.map(|n| rest_m[n.index()]));
                self.inverted.try_push((*nodes, gradients));
                quarantine.add(t);
                tell(t);
            }
        }
        quarantine
    }

    /// Adds the force [N] that they exert on each node.
    pub(in crate::model) fn add_forces(&self, positions_m: &[DVec3], force_n: &mut [DVec3]) {
        for (nodes, gradients) in self.inverted.iter() {
            let balance_n = stand_in_forces_n(&self.law, gradients, nodes.map(|n| positions_m[n.index()]));
            for (node, f) in nodes.iter().zip(balance_n) {
                force_n[node.index()] -= f;
            }
        }
    }
}
