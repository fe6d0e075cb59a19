//! Corrections of a step by contact, with the present factor.

use super::ImplicitEuler;
use crate::model::{Answered, Correction, NodalForce};
use glisson_mesh::math::DVec3;

/// Answers to forces are solved by two grids to this residual.
const ANSWER: f64 = 1e-4;

impl ImplicitEuler {
    /// Forces on nodes that do not move or are held have no effect. `Answered::AtForces`: right at the nodes of the forces.
    pub(super) fn answer(&mut self, forces: &[NodalForce], moves_m: &mut [DVec3], at: Answered) {
        moves_m.fill(DVec3::ZERO);
        let Some(lagged) = &mut self.lagged else { return };
        // The residual holds the supports' forces, which are read between steps.
        let right = &mut self.scratch.product_n;
        right.fill(DVec3::ZERO);
        let workers = self.workers.as_ref();
        for force in forces {
            let n = force.node.index();
            right[n] += force.force_n * self.mask[n];
        }
        let is_solved = at == Answered::AtForces && lagged.solve_at_into(forces, right, moves_m);
        // What ended early is not linear in the forces, which contact counts on.
        if !is_solved && !lagged.solve_into(workers, right, moves_m, ANSWER) {
            lagged.apply_into(workers, right, moves_m);
        }
        for (moved_m, mask) in moves_m.iter_mut().zip(&self.mask) {
            *moved_m *= *mask;
        }
    }

    pub(super) fn correct(&mut self, forces: &[NodalForce], dt_s: f64, correction: Correction) {
        let mut moves_m = std::mem::take(&mut self.scratch.before_m);
        self.answer(forces, &mut moves_m, Answered::Everywhere);
        if moves_m.iter().all(|m| m.is_finite()) {
            for (n, move_m) in moves_m.iter().enumerate() {
                self.displacement_m[n] += *move_m;
                if correction == Correction::Motion {
                    self.velocities_m_per_s[n] += *move_m / dt_s;
                }
            }
            // The law may have no energy in the corrected shape: the next step checks.
            self.is_suspect = true;
        }
        self.scratch.before_m = moves_m;
        self.publish();
        self.report.kinetic_energy_j = self.kinetic_energy_j();
    }
}
