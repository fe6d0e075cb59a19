//! Ligaments: springs that pull when taut and exert no force when slack.
//!
//! With d the unit vector from node to anchor, l the distance and l0 the slack length, a taut one has the energy
//! k/2 (l - l0)^2 and the tangent k [ d d^T + (1 - l0/l) (Id - d d^T) ], without negative eigenvalue. Energy and
//! force are continuous where it goes slack and the energy is convex, so Newton's method with its line search
//! crosses that point.

use super::Attachment;
use glisson_mesh::math::{DMat3, DVec3, outer};

#[derive(Clone, Debug)]
pub(super) struct Ligaments {
    pub(super) list: Vec<Attachment>,
    /// Tangent [N/m] of each at the last [`Ligaments::pull_into`].
    tangent: Vec<DMat3>,
}

impl Ligaments {
    pub(super) fn new(list: Vec<Attachment>) -> Self {
        Self { tangent: vec![DMat3::ZERO; list.len()], list }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// Overwrites the forces [N] on the attached nodes and keeps the tangents there; returns the energy [J].
    pub(super) fn pull_into(
        &mut self,
        rest_m: &[DVec3],
        displacement_m: &[DVec3],
        force_n: &mut [DVec3],
    ) -> f64 {
        for ligament in &self.list {
            force_n[ligament.node.index()] = DVec3::ZERO;
        }
        let mut energy_j = 0.0;
        for (ligament, tangent) in self.list.iter().zip(&mut self.tangent) {
            let n = ligament.node.index();
            let position_m = rest_m[n] + displacement_m[n];
            force_n[n] += ligament.force_n(position_m);
            *tangent = tangent_n_per_m(ligament, position_m);
            let longer_m = (ligament.anchor_m.distance(position_m) - ligament.slack_length_m).max(0.0);
            energy_j += 0.5 * ligament.stiffness_n_per_m * longer_m * longer_m;
        }
        energy_j
    }

    /// Adds the tangents of the last evaluation times a direction.
    pub(super) fn add_product(&self, direction_m: &[DVec3], force_n: &mut [DVec3]) {
        for (ligament, tangent) in self.list.iter().zip(&self.tangent) {
            let n = ligament.node.index();
            force_n[n] += *tangent * direction_m[n];
        }
    }

    /// Adds the tangents at these displacements to the nodes' own tensors.
    pub(super) fn add_to_vertices(&self, rest_m: &[DVec3], displacement_m: &[DVec3], vertex: &mut [DMat3]) {
        for ligament in &self.list {
            let n = ligament.node.index();
            vertex[n] += tangent_n_per_m(ligament, rest_m[n] + displacement_m[n]);
        }
    }
}

fn tangent_n_per_m(ligament: &Attachment, position_m: DVec3) -> DMat3 {
    let span_m = ligament.anchor_m - position_m;
    let length_m = span_m.length();
    if length_m <= ligament.slack_length_m || length_m == 0.0 {
        return DMat3::ZERO;
    }
    let along = outer(span_m, span_m) * (1.0 / (length_m * length_m));
    let across = 1.0 - ligament.slack_length_m / length_m;
    (along * (1.0 - across) + DMat3::IDENTITY * across) * ligament.stiffness_n_per_m
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson_mesh::mesh::NodeId;

    #[test]
    fn force_and_tangent_are_derivatives_taut_and_slack() {
        for (slack_length_m, taut) in [(0.02, true), (0.2, false), (0.0, true)] {
            let ligament = Attachment {
                node: NodeId(0),
                anchor_m: DVec3::new(0.05, -0.02, 0.1),
                slack_length_m,
                stiffness_n_per_m: 120.0,
            };
            let mut ligaments = Ligaments::new(vec![ligament]);
            let rest_m = [DVec3::new(0.01, 0.0, 0.02)];
            let u = [DVec3::new(0.003, 0.002, -0.001)];
            let at = |ligaments: &mut Ligaments, u: DVec3| {
                let mut force_n = [DVec3::splat(7.0)];
                let energy_j = ligaments.pull_into(&rest_m, &[u], &mut force_n);
                (energy_j, force_n[0])
            };
            let step_m = 1e-6;
            for axis in DVec3::AXES {
                let above = at(&mut ligaments, u[0] + axis * step_m);
                let below = at(&mut ligaments, u[0] - axis * step_m);
                let (energy_j, force_n) = at(&mut ligaments, u[0]);
                assert_eq!(energy_j > 0.0, taut);
                let slope_n = (above.0 - below.0) / (2.0 * step_m);
                assert!((slope_n + force_n.dot(axis)).abs() < 1e-6, "{slope_n} {force_n}");
                let slope = (below.1 - above.1) / (2.0 * step_m);
                let mut product = [DVec3::ZERO];
                ligaments.add_product(&[axis], &mut product);
                assert!((product[0] - slope).length() < 1e-5, "{} {slope}", product[0]);
            }
        }
    }
}
