//! An instrument of a recorded session as a device: its handle goes where the instrument went; forces are not felt.

use super::kind::{DeviceChoice, DeviceKind, OpenRequest, after_colon};
use crate::open_device::OpenDevice;
use crate::replay::read_session;
use anyhow::{Context, anyhow, ensure};
use glisson::haptics::{DeviceFault, DeviceLimits, DeviceState, ForceCommand, HapticDevice};
use glisson::math::DVec3;
use glisson::record::session::{Session, SessionEvent};
use glisson::scene::Scene;
use glisson::tool::ToolInput;
use glisson::tool::pose::ToolFrame;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The kind's row of the table.
pub(super) const KIND: DeviceKind = DeviceKind {
    name: "replay",
    pattern: "replay:FILE[:TOOL]",
    about: "an instrument of a recorded session (TOOL from 0; default 0)",
    parse: |rest| {
        let rest =
            after_colon(rest).filter(|rest| !rest.is_empty()).ok_or("replay needs a session: replay:FILE")?;
        let (file, tool) = match rest.rsplit_once(':') {
            Some((file, tool)) if tool.parse::<usize>().is_ok() => (file, tool.parse().unwrap_or(0)),
            _ => (rest, 0),
        };
        Ok(Arc::new(ReplayChoice { session: file.into(), tool }))
    },
    examine: None,
};

/// An instrument of a session.
#[derive(Debug)]
struct ReplayChoice {
    session: PathBuf,
    /// Number of the instrument, from 0.
    tool: usize,
}

impl DeviceChoice for ReplayChoice {
    fn text(&self) -> String {
        format!("replay of {}", self.session.display())
    }

    fn open(&self, request: &OpenRequest<'_>) -> anyhow::Result<OpenDevice> {
        let device = ReplayedDevice::open(&self.session, self.tool, request.rate_hz)?;
        Ok(OpenDevice::new(Box::new(device), &self.text()))
    }
}

/// Its button 0 is the trigger.
pub(super) struct ReplayedDevice {
    /// When the instrument went where [s], ascending; at least one.
    motion: Vec<(f64, ToolInput)>,
    rate_hz: f64,
    n_ticks: u64,
    /// Last place that was reached.
    at: usize,
}

impl ReplayedDevice {
    /// Instrument `tool` of the session in a file, read `rate_hz` times a second.
    pub(super) fn open(path: &Path, tool: usize, rate_hz: f64) -> anyhow::Result<Self> {
        let session = read_session(path)?;
        Self::of(&session, tool, rate_hz).with_context(|| path.display().to_string())
    }

    fn of(session: &Session, tool: usize, rate_hz: f64) -> anyhow::Result<Self> {
        let scene =
            Scene::parse_recorded(&session.header).map_err(|e| anyhow!("the session's scene: {e}"))?;
        let dt_s = scene.world.time_step_s;
        let n_tools = scene.world.tools.len();
        ensure!(tool < n_tools, "there is no instrument {tool}: the session has {n_tools}, numbered from 0");
        let motion: Vec<(f64, ToolInput)> = session
            .events
            .iter()
            .filter_map(|event| match event {
                SessionEvent::Input { step, tools, .. } => {
                    tools.get(tool).map(|input| (*step as f64 * dt_s, *input))
                }
                _ => None,
            })
            .collect();
        ensure!(!motion.is_empty(), "nobody moved instrument {tool} in the session");
        Ok(Self { motion, rate_hz, n_ticks: 0, at: 0 })
    }
}

impl HapticDevice for ReplayedDevice {
    fn limits(&self) -> DeviceLimits {
        // What nobody feels needs no limits; these let the tool follow the handle closely.
        DeviceLimits {
            force_n: 50.0,
            torque_n_m: 0.0,
            force_rate_n_per_s: 1e4,
            stiffness_n_per_m: 1e5,
            damping_n_s_per_m: 100.0,
            resolution_m: 0.0,
            rate_hz: self.rate_hz,
            ..DeviceLimits::NONE
        }
    }

    fn read(&mut self) -> Result<DeviceState, DeviceFault> {
        let time_s = self.n_ticks as f64 / self.rate_hz;
        self.n_ticks += 1;
        while self.motion.get(self.at + 1).is_some_and(|(start_s, _)| *start_s <= time_s) {
            self.at += 1;
        }
        let (_, input) = self.motion[self.at];
        let frame = ToolFrame::of(&input);
        Ok(DeviceState {
            position_m: input.tip_in_world_m,
            velocity_m_per_s: DVec3::ZERO,
            orientation: Some(glam::DQuat::from_mat3(&frame.world_from_tool)),
            jaw_opening: input.jaw_opening,
            buttons: u32::from(input.is_triggered()),
        })
    }

    fn write(&mut self, _command: &ForceCommand) -> Result<(), DeviceFault> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::record::session::SessionHeader;

    const SCENE: &str = "glisson_scene = 1\n[simulation]\ntime_step = \"2 ms\"\n[organ]\nmesh = \"body.tet\"\n\
        young_modulus = \"5 kPa\"\npoisson_ratio = 0.45\ndensity = \"1000 kg/m3\"\nmodel = \"tensor_mass\"\n\
        [[organ.fixed]]\nfurthest = { direction = [0, 0, -1], fraction = 0.6 }\n\
        [tool]\ntip_radius = \"5 mm\"\nhome_tip = [\"40 mm\", \"40 mm\", \"90 mm\"]\nhome_shaft = [0, 0, 1]\n";

    #[test]
    fn the_handle_goes_where_the_instrument_went_in_the_scenes_time() {
        let at = |x: f64| ToolInput { trigger: x, ..ToolInput::at(DVec3::X * x, DVec3::Y) };
        let input = |step, x| SessionEvent::Input {
            step,
            tools: vec![at(x)],
            n_substeps: 1,
            placed: Vec::new(),
            detected: Vec::new(),
        };
        let mut session = Session {
            header: SessionHeader::new(SCENE.into(), String::new()),
            events: vec![input(0, 0.0), SessionEvent::Reset { step: 3 }, input(5, 1.0)],
            cut_off: false,
        };
        let mut device = ReplayedDevice::of(&session, 0, 1_000.0).unwrap();
        let states: Vec<DeviceState> = (0..100).map(|_| device.read().unwrap()).collect();
        let x = |tick: usize| states[tick].position_m.x;
        // Step 5 of 2 ms begins at tick 10 of 1 ms.
        assert_eq!([0, 9, 10, 99].map(x), [0.0, 0.0, 1.0, 1.0]);
        assert_eq!((states[0].buttons, states[99].buttons), (0, 1));
        assert!((states[0].orientation.unwrap() * DVec3::Z).abs_diff_eq(DVec3::Y, 1e-12));
        let error = ReplayedDevice::of(&session, 1, 1_000.0).err().unwrap().to_string();
        assert!(error.contains("the session has 1"), "{error}");
        session.events.clear();
        assert!(ReplayedDevice::of(&session, 0, 1_000.0).is_err());
    }
}
