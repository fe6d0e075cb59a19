//! A trocar's board, the whole haptic law at 1 kHz, and a simulation that steps fifty times a second.

use super::closed_loop::{Station, TICK_S, fault};
use crate::validate::Experiment;
use glam::{DQuat, DVec3};
use glisson::haptics::trocar::TrocarJoints;
use glisson::haptics::{DeviceMapping, HapticDevice, HapticLaw, HapticModel, LawSettings};
use glisson::tool::ToolInput;

/// How long the hand presses in [s].
pub(super) const PRESS_S: f64 = 0.5;
pub(super) const TICKS_PER_STEP: u32 = 20;

/// The law of a loop at 1 kHz for a device that stands there.
fn law_of(station: &Station) -> HapticLaw {
    let mapping = DeviceMapping {
        world_from_device: DQuat::from_mat3(&station.placement.world_from_device),
        device_origin_m: DVec3::ZERO,
        world_origin_m: station.placement.pivot_in_world_m,
        clutch_button: None,
        trigger_button: None,
        ..DeviceMapping::default()
    };
    let settings = LawSettings { mapping, period_s: TICK_S, ..LawSettings::default() };
    HapticLaw::new(&settings, &station.device.limits())
}

/// A loop of board, law and a simulation that steps fifty times a second.
pub(super) struct Loop {
    pub(super) station: Station,
    law: HapticLaw,
    /// What the simulation published last.
    pub(super) model: HapticModel,
    least_energy_j: f64,
}

impl Loop {
    pub(super) fn new(station: Station) -> Self {
        let law = law_of(&station);
        Self { station, law, model: HapticModel::default(), least_energy_j: f64::INFINITY }
    }

    /// Tick `k`, with the hand there; every twentieth ends with a step, for which `simulate` takes the tool and publishes.
    pub(super) fn tick(
        &mut self,
        k: u32,
        target: TrocarJoints,
        simulate: &mut dyn FnMut(&ToolInput) -> HapticModel,
    ) -> anyhow::Result<()> {
        self.station.hand(target);
        let state = self.station.device.read().map_err(fault)?;
        let age_s = f64::from(k % TICKS_PER_STEP) * TICK_S;
        let tick = self.law.tick(&state, &self.model, age_s, TICK_S);
        self.station.device.write(&tick.command).map_err(fault)?;
        if (k + 1).is_multiple_of(TICKS_PER_STEP) {
            self.model = simulate(&tick.tool);
        }
        self.least_energy_j = self.least_energy_j.min(tick.report.observed_energy_j);
        Ok(())
    }

    pub(super) fn bound_row(&self, what: &str) -> Experiment {
        let below_j = (self.law.energy_bound_j() - self.least_energy_j).max(0.0);
        Experiment::at_most(
            &format!("{what}: how far the observed energy goes below its bound [J]"),
            "haptics::HapticLaw",
            below_j,
            0.0,
        )
    }
}
