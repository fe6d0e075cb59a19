//! `[simulation]`: time step and gravity.

use super::reader::{SceneError, Section};
use crate::math::DVec3;
use crate::model::DEFAULT_MOST_PARTS;
use crate::units::Dimension;

/// What the table says.
pub(super) struct Simulation {
    pub(super) time_step_s: f64,
    pub(super) gravity_m_per_s2: DVec3,
    pub(super) most_parts: u32,
}

impl Default for Simulation {
    /// One step a millisecond, the rate of force feedback; weightless.
    fn default() -> Self {
        Self { time_step_s: 1e-3, gravity_m_per_s2: DVec3::ZERO, most_parts: DEFAULT_MOST_PARTS }
    }
}

/// A step that would be divided further is made by a wrong scene.
const MOST_PARTS_ALLOWED: f64 = 1000.0;

/// Time steps that a scene may have [s]: a shorter one is below what any device or tissue asks for, a longer one no motion of
/// a hand survives. A choice.
const TIME_STEPS_S: std::ops::RangeInclusive<f64> = 1e-6..=1.0;

pub(super) fn read_simulation(section: Option<Section<'_>>) -> Result<Simulation, SceneError> {
    let mut simulation = Simulation::default();
    let Some(mut section) = section else { return Ok(simulation) };
    if let Some((time_step_s, at)) = section.quantity("time_step", Dimension::Time)? {
        if !TIME_STEPS_S.contains(&time_step_s) {
            return Err(section.wrong_value(at, "time_step", format!("{time_step_s} s"), "1 us to 1 s"));
        }
        simulation.time_step_s = time_step_s;
    }
    if let Some(gravity_m_per_s2) = section.vector("gravity", Dimension::Acceleration)? {
        simulation.gravity_m_per_s2 = gravity_m_per_s2;
    }
    if let Some((parts, at)) = section.number("most_parts")? {
        if parts.fract() != 0.0 || !(1.0..=MOST_PARTS_ALLOWED).contains(&parts) {
            let allowed = "a whole number from 1 to 1000";
            return Err(section.wrong_value(at, "most_parts", parts.to_string(), allowed));
        }
        simulation.most_parts = parts as u32;
    }
    section.finish()?;
    Ok(simulation)
}
