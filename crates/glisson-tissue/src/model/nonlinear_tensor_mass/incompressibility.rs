//! The signed penalty of volume changes (seed `004`, s. 3.2; `002`, s. 4 lost the sign).
//!
//! On each corner p of a tetrahedron acts gamma sign(V - V_0) ((V - V_0)/V_0)^2 N_p, with N_p along the outward
//! normal of the opposite face: a tetrahedron that swelled is pulled together. The reports leave the length of
//! N_p open. Here it is the face's present area, so that gamma is a pressure [Pa]: then the four forces sum to
//! zero, without moment, and derive from the energy gamma V_0 |theta|^3, theta = V/V_0 - 1, because
//! N_p = -3 dV/du_p. With unit normals a penalized tetrahedron would push itself through space.
//!
//! Volume changes enter squared, so the linear part of the force stays as it is.

use super::forces::Entities;
use crate::model::explicit::{LiveTets, Padded, unpadded};
use crate::solve::P1Gradients;
use glisson_mesh::math::{DVec3, tetrahedron_volume_m3};
use glisson_mesh::mesh::NodeId;

/// A body's tetrahedra with the volumes that they keep to.
pub(super) struct VolumePenalty<'a> {
    pub(super) gamma_pa: f64,
    pub(super) rest_m: &'a [DVec3],
    pub(super) gradients: &'a [P1Gradients],
    pub(super) tets: &'a LiveTets,
}

impl VolumePenalty<'_> {
    /// Adds the forces that balance the penalty: the opposites of those that act on the corners.
    pub(super) fn add_forces(&self, entities: &Entities<'_>, u: &[Padded], force: &mut [Padded]) {
        for (t, nodes) in self.live(entities) {
            let here_m = self.corners_m(nodes, u);
            let share = self.tets.share(t);
            let theta = tetrahedron_volume_m3(here_m) * share / self.gradients[t].volume_m3 - 1.0;
            let [a, b, c, d] = here_m;
            let half_pressure_pa = 0.5 * self.gamma_pa * theta * theta.abs() * share;
            // Twice the inward area vectors opposite to b, c and d; all four sum to zero.
            let on_b = (c - a).cross(d - a) * half_pressure_pa;
            let on_c = (d - a).cross(b - a) * half_pressure_pa;
            let on_d = (b - a).cross(c - a) * half_pressure_pa;
            for (node, f) in nodes.iter().zip([-(on_b + on_c + on_d), on_b, on_c, on_d]) {
                let at = &mut force[node.index()];
                at[0] += f.x;
                at[1] += f.y;
                at[2] += f.z;
            }
        }
    }

    /// gamma V_0 |theta|^3, summed [J].
    pub(super) fn energy_j(&self, entities: &Entities<'_>, u: &[Padded]) -> f64 {
        let of_tet = |(t, nodes): (usize, &[NodeId; 4])| {
            let rest_m3 = self.gradients[t].volume_m3;
            let here_m3 = tetrahedron_volume_m3(self.corners_m(nodes, u)) * self.tets.share(t);
            let theta = (here_m3 / rest_m3 - 1.0).abs();
            self.gamma_pa * rest_m3 * theta * theta * theta
        };
        self.live(entities).map(of_tet).sum()
    }

    fn live<'b>(&'b self, entities: &Entities<'b>) -> impl Iterator<Item = (usize, &'b [NodeId; 4])> {
        entities.tet_nodes.iter().enumerate().filter(|(t, _)| self.tets.is_live[*t])
    }

    fn corners_m(&self, nodes: &[NodeId; 4], u: &[Padded]) -> [DVec3; 4] {
        nodes.map(|n| self.rest_m[n.index()] + unpadded(&u[n.index()]))
    }
}
