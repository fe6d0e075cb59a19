//! Corrections of a step by contact.

use super::ExplicitKernel;
use crate::model::{Correction, NodalForce};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::NodeId;

impl ExplicitKernel {
    pub(super) fn answer_of_node(&self, node: NodeId, dt_s: f64) -> DVec3 {
        let inertia_kg = self.kernel.inertia_kg(node);
        if !self.takes_load(node) || inertia_kg <= 0.0 || self.held.iter().any(|held| held.node == node) {
            return DVec3::ZERO;
        }
        let free = self.supports[node.index()].map(|is_fixed| f64::from(u8::from(!is_fixed)));
        DVec3::from_array(free) * (dt_s * dt_s / inertia_kg)
    }

    /// An increment is that of the last part of the step, its velocity that of the whole.
    pub(super) fn correct_nodes(&mut self, forces: &[NodalForce], dt_s: f64, correction: Correction) {
        let last_s = self.kernel.last_step_s().unwrap_or(dt_s);
        let per_step = 1.0 / self.kernel.last_step_s().unwrap_or(self.time_step_s);
        for force in forces {
            let node = force.node;
            let move_m = self.answer_of_node(node, dt_s) * force.force_n;
            if move_m == DVec3::ZERO || !move_m.is_finite() {
                continue;
            }
            let n = node.index();
            let displacement_m = self.kernel.displacement_m(node) + move_m;
            self.kernel.set_displacement(node, displacement_m);
            self.displacements_m[n] = displacement_m;
            self.positions_m[n] = self.rest.positions_m[n] + displacement_m;
            if correction == Correction::Places {
                continue;
            }
            let increment_m = self.kernel.increment_m(node) + move_m * (last_s / dt_s);
            self.kernel.set_increment(node, increment_m);
            // As states are shown everywhere else, so that an undone edit finds the same bits.
            let velocity_m_per_s = increment_m * per_step;
            let before_m_per_s = std::mem::replace(&mut self.velocities_m_per_s[n], velocity_m_per_s);
            let gained = velocity_m_per_s.length_squared() - before_m_per_s.length_squared();
            self.report.kinetic_energy_j += 0.5 * self.kernel.inertia_kg(node) * gained;
        }
    }
}
