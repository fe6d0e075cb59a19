//! What a piece that was cut loose from another body needs: steps of a given length whatever its tetrahedra are like, and
//! a start in motion.

use super::ExplicitKernel;
use crate::material::{LinearElastic, StableNeoHooke, largest_tangent_eigenvalue_pa};
use crate::solve::P1Gradients;
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::{NodeId, TetId};

/// As in the proven steps: theta h^2 stays a little below 4.
const SQUARED_LIMIT: f64 = 3.99;

impl ExplicitKernel {
    /// Makes steps of `step_s` [s] stable, now and after any cuts: tetrahedra whose own squared frequency theta is too high
    /// for it become heavier by theta over the one allowed; their weight stays. For a body of stable Neo-Hookean tissue
    /// without ligaments, of `material` everywhere, strained up to `largest_stretch`. Answers how many nodes are heavier.
    pub(in crate::model) fn lengthen_step(
        &mut self,
        material: &LinearElastic,
        density_kg_per_m3: f64,
        largest_stretch: f64,
        step_s: f64,
    ) -> u32 {
        let (lambda_pa, mu_pa) = (material.lambda_pa(), material.mu_pa());
        let wave_pa = (lambda_pa + 2.0 * mu_pa).max(mu_pa);
        let tangent_pa = largest_tangent_eigenvalue_pa(&StableNeoHooke::from(material), largest_stretch);
        let stiffening = (tangent_pa / wave_pa).max(1.0);
        let allowed = SQUARED_LIMIT / (step_s * step_s + 2.0 * self.damping.stiffness_s * step_s);
        let mut added_kg = vec![0.0; self.rest.positions_m.len()];
        for (t, nodes) in self.rest.tetrahedra.iter().enumerate() {
            let gradients = P1Gradients::in_mesh(&self.rest, TetId::from_index(t));
            let corner_kg = 0.25 * density_kg_per_m3 * gradients.volume_m3;
            let at_rest = gradients.stiffness(lambda_pa, mu_pa);
            let theta = stiffening * at_rest.squared_frequency_bound_per_s2([corner_kg; 4]);
            if theta > allowed {
                nodes.iter().for_each(|n| added_kg[n.index()] += corner_kg * (theta / allowed - 1.0));
            }
        }
        let mut n_heavier = 0;
        for (n, &added_kg) in added_kg.iter().enumerate().filter(|(_, kg)| **kg > 0.0) {
            self.kernel.set_added_mass(NodeId::from_index(n), added_kg);
            n_heavier += 1;
        }
        self.time_step_s = step_s;
        self.stability.step.step_s = step_s;
        self.stability.assured_s = step_s;
        n_heavier
    }

    /// Starts the nodes with these velocities [m/s]; those that are fixed stay.
    pub(in crate::model) fn start_with(&mut self, velocity_m_per_s: impl Fn(NodeId) -> DVec3) {
        for n in 0..self.rest.positions_m.len() {
            let node = NodeId::from_index(n);
            let velocity = velocity_m_per_s(node);
            if self.takes_load(node) && velocity.is_finite() {
                let free = self.supports[n].map(|is_fixed| if is_fixed { 0.0 } else { 1.0 });
                self.kernel.set_increment(node, velocity * DVec3::from_array(free) * self.time_step_s);
            }
        }
        self.kernel.set_last_step_s(Some(self.time_step_s));
        self.publish();
    }
}
