//! What a step that did not converge may not do: gain energy.
//!
//! A minimum of the incremental potential P loses energy, whatever the step. A step that stops before it starts somewhere, and P
//! can be large there: P of the shape before the step is the energy then, so no end with a larger one is accepted. The
//! velocities follow from the places, and (v + dv)^2 may still be larger than what dv cost: then all are made smaller until
//! the energy is that before the step and what outer forces did.

use super::ImplicitEuler;
use super::newton::{Balance, ImplicitStatus, StepFactors};

/// The energy of motion that the velocities may have [J].
#[derive(Clone, Copy, Debug)]
pub(super) struct MotionLimit {
    most_j: f64,
}

impl ImplicitEuler {
    /// After a step that did not converge: goes on from the shape before the step if that has a smaller potential than `end`, and
    /// tells how much motion the energy allows. Steps in which tools hold nodes have no limit: the tools do work.
    pub(super) fn keep_to_energy(&mut self, factors: StepFactors, end: Balance) -> Option<MotionLimit> {
        let is_at_end =
            matches!(self.step_report.status, ImplicitStatus::Converged | ImplicitStatus::Unusable);
        if is_at_end || !self.held.is_empty() {
            return None;
        }
        self.scratch.end_m.copy_from_slice(&self.displacement_m);
        self.displacement_m.copy_from_slice(&self.scratch.start_m);
        let found =
            self.elements.evaluate(self.workers.as_ref(), &self.displacement_m, &mut self.scratch.force_n);
        let start = self.balance(factors, found.energy_j);
        let end = if end.potential_j <= start.potential_j {
            self.displacement_m.copy_from_slice(&self.scratch.end_m);
            let found = self.elements.evaluate(
                self.workers.as_ref(),
                &self.displacement_m,
                &mut self.scratch.force_n,
            );
            self.balance(factors, found.energy_j)
        } else {
            self.minimise(factors, found.energy_j)
        };
        let most_j = self.kinetic_energy_j() + start.stored_j + end.work_j - end.stored_j;
        Some(MotionLimit { most_j: most_j.max(0.0) })
    }

    /// Makes velocities smaller until they have no more energy than that.
    pub(super) fn limit_motion(&mut self, limit: MotionLimit) {
        let motion_j = self.kinetic_energy_j();
        if motion_j > limit.most_j {
            let share = (limit.most_j / motion_j).sqrt();
            self.velocities_m_per_s.iter_mut().for_each(|v| *v *= share);
            self.energy_was_limited = true;
        }
    }
}
