//! From one published model to the next without a jump.
//!
//! When another model comes, what it says at the tip now differs from what the hand just felt: by the error of the old model,
//! or because the tissue gave way, was cut, or let go. The difference is kept as an offset and taken away along a straight
//! line, over [`SPREAD_S`] and no faster than [`MOST_RATE_N_PER_S`]; all of it in the end. When models come faster than that,
//! each begins a line of its own for what is left: the difference then fades by 1/e in the same time.
//!
//! So in a tick of dt the force changes by at most `MOST_RATE_N_PER_S` dt beside what stiffness and motion explain. The first
//! model after a start or [`Handover::restart`] is met in the same way, from zero.
//!
//! A local model is felt with what a slide along the tissue changes ([`super::slide`]).

use super::extrapolation::ForceEstimate;
use super::slide::Slide;
use super::spread::{MOST_RATE_N_PER_S, SPREAD_S};
use super::tissue::HapticModel;
use crate::math::DVec3;

/// The force that a hand feels, from the models that the simulation publishes.
#[derive(Clone, Debug, PartialEq)]
pub struct Handover {
    estimate: ForceEstimate,
    before: HapticModel,
    latest: HapticModel,
    slide: Slide,
    has_model: bool,
    /// Age of the latest model at the last tick [s], and where the tip was [m].
    age_s: f64,
    tip_m: DVec3,
    /// Force of the last tick [N].
    force_n: DVec3,
    /// What is felt beside the latest model [N], and how fast it goes away [N/s].
    offset_n: DVec3,
    rate_n_per_s: f64,
}

impl Default for Handover {
    fn default() -> Self {
        Self::new(ForceEstimate::default())
    }
}

impl Handover {
    /// Begins at zero force.
    pub fn new(estimate: ForceEstimate) -> Self {
        Self {
            estimate,
            before: HapticModel::default(),
            latest: HapticModel::default(),
            slide: Slide::default(),
            has_model: false,
            age_s: 0.0,
            tip_m: DVec3::ZERO,
            force_n: DVec3::ZERO,
            offset_n: DVec3::ZERO,
            rate_n_per_s: 0.0,
        }
    }

    /// How it gets from models to forces.
    pub fn estimate(&self) -> ForceEstimate {
        self.estimate
    }

    /// Another way from models to forces from the next tick on; the difference is spread.
    pub fn set_estimate(&mut self, estimate: ForceEstimate) {
        if estimate != self.estimate {
            self.estimate = estimate;
            if self.has_model {
                self.meet();
            }
        }
    }

    /// The device was away: begins at zero force again.
    pub fn restart(&mut self) {
        *self = Self::new(self.estimate);
    }

    /// What of the force is not the latest model's [N].
    pub fn offset_n(&self) -> DVec3 {
        self.offset_n
    }

    /// Force [N] of the tissue on the tip at `tip_m` [m], for a tick of `dt_s` [s], `age_s` [s] after `latest` was made. To be
    /// asked for at every tick, with the newest model there is. A model that is not finite counts as no tissue.
    pub fn force(&mut self, latest: &HapticModel, tip_m: DVec3, age_s: f64, dt_s: f64) -> DVec3 {
        self.force_in(latest, tip_m, age_s, dt_s, dt_s)
    }

    /// The same where the difference fades as in `ramp_dt_s` [s]: less than `dt_s` after a late tick, whose change is felt at
    /// once.
    pub fn force_in(
        &mut self,
        latest: &HapticModel,
        tip_m: DVec3,
        age_s: f64,
        dt_s: f64,
        ramp_dt_s: f64,
    ) -> DVec3 {
        if !(tip_m.is_finite() && age_s.is_finite() && dt_s > 0.0) {
            return self.force_n;
        }
        let mut is_new = false;
        if !self.has_model || *latest != self.latest {
            let usable = if latest.is_finite() {
                *latest
            } else {
                HapticModel { step: latest.step, ..HapticModel::default() }
            };
            // A model that is not finite equals nothing, not even itself.
            is_new = !self.has_model || usable != self.latest;
            if is_new {
                self.before = if self.has_model { self.latest } else { usable };
                self.latest = usable;
                self.slide = self.slide.next(&self.before, &self.latest);
            }
        }
        if !self.has_model {
            self.tip_m = tip_m;
            self.has_model = true;
        }
        if is_new {
            // Where the tip was at the last tick the force is what it was; the new model's age then was less by a tick.
            self.age_s = (age_s - dt_s).max(0.0);
            self.meet();
        }
        self.offset_n = self.offset_n.move_towards(DVec3::ZERO, self.rate_n_per_s * ramp_dt_s);
        (self.tip_m, self.age_s) = (tip_m, age_s);
        self.force_n = self.estimated_n() + self.offset_n;
        self.force_n
    }

    fn estimated_n(&self) -> DVec3 {
        let force_n = self.estimate.force_at(&self.before, &self.latest, self.tip_m, self.age_s);
        match self.estimate {
            ForceEstimate::LocalModel => self.slide.force_at(&self.latest, force_n, self.tip_m),
            _ => force_n,
        }
    }

    /// Keeps the last tick's force.
    fn meet(&mut self) {
        self.offset_n = self.force_n - self.estimated_n();
        self.rate_n_per_s = (self.offset_n.length() / SPREAD_S).min(MOST_RATE_N_PER_S);
    }
}
