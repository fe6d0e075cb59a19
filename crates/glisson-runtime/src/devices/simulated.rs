//! The simulated device with a hand that pushes by itself, by its name.

use super::kind::{DeviceChoice, DeviceKind, OpenRequest, nothing_after};
use crate::open_device::OpenDevice;
use glam::DQuat;
use glisson::haptics::{HandPath, HandSettings, SimulatedDevice, SimulatedDeviceSettings};
use glisson::math::DVec3;
use std::sync::Arc;

/// The kind's row of the table.
pub(super) const KIND: DeviceKind = DeviceKind {
    name: "simulated",
    pattern: "simulated",
    about: "a simulated device with a hand that pushes up and down by itself",
    parse: |rest| nothing_after("simulated", rest).map(|()| Arc::new(Simulated) as Arc<dyn DeviceChoice>),
    examine: None,
};

#[derive(Debug)]
struct Simulated;

impl DeviceChoice for Simulated {
    fn text(&self) -> String {
        "simulated device".into()
    }

    fn open(&self, request: &OpenRequest<'_>) -> anyhow::Result<OpenDevice> {
        let device = Box::new(pushing_device(request.rate_hz, 1));
        Ok(OpenDevice {
            // It pushes along the instrument.
            world_from_device: DQuat::from_rotation_arc(DVec3::Z, request.home.shaft_in_world.normalize()),
            has_clutch: false,
            ..OpenDevice::new(device, "simulated")
        })
    }
}

/// How deep the simulated hand pushes beyond where it starts [m], and how often [Hz].
pub(super) const PUSH_M: f64 = 0.010;
pub(super) const PUSHES_HZ: f64 = 1.0;

/// A simulated device whose hand pushes along its -z, and the seed of its noise.
fn pushing_device(rate_hz: f64, seed: u64) -> SimulatedDevice {
    let half_m = DVec3::Z * (PUSH_M / 2.0);
    let path = HandPath::Swing { center_m: -half_m, amplitude_m: -half_m, frequency_hz: PUSHES_HZ };
    let settings = SimulatedDeviceSettings { rate_hz, ..SimulatedDeviceSettings::default() };
    SimulatedDevice::new(&settings, &HandSettings::default(), path, seed)
}
