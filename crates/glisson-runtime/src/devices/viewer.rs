//! Mouse, keyboard and gamepad of the viewer's page as a device: its handle is where the page has the instrument, and what it
//! should push with goes back to the page, which shows it and shakes the gamepad.
//!
//! The page speaks some 60 times a second, the loop reads a thousand times. In between the handle goes to where it was last
//! said to be as the simulation's own instruments do ([`approach`]), and stays there. Its frame is the world's.

use super::kind::{DeviceChoice, DeviceKind, OpenRequest, nothing_after};
use crate::live::{JUMP_M, approach};
use crate::open_device::OpenDevice;
use crate::page_hand::{Felt, GREATEST_FORCE_N, PageDeviceEnd, PageHand};
use crate::realtime::now_ns;
use glisson::haptics::trocar::Placement;
use glisson::haptics::{DeviceFault, DeviceLimits, DeviceState, ForceCommand, HapticDevice};
use glisson::math::{DMat3, DVec3};
use glisson::tool::ToolInput;
use glisson::tool::pose::ToolFrame;
use std::sync::Arc;

/// The kind's row of the table.
pub(super) const KIND: DeviceKind = DeviceKind {
    name: "viewer",
    pattern: "viewer",
    about: "mouse, keyboard and gamepad of the page; its force is shown there, and shakes the gamepad",
    parse: |rest| nothing_after("viewer", rest).map(|()| Arc::new(Viewer) as Arc<dyn DeviceChoice>),
    examine: None,
};

#[derive(Debug)]
struct Viewer;

impl DeviceChoice for Viewer {
    fn text(&self) -> String {
        "viewer".into()
    }

    fn open(&self, request: &OpenRequest<'_>) -> anyhow::Result<OpenDevice> {
        let (device, page) = open(request.home, request.rate_hz);
        // Its places are the world's own.
        let stands = Some(Placement { pivot_in_world_m: DVec3::ZERO, world_from_device: DMat3::IDENTITY });
        Ok(OpenDevice { stands, page: Some(page), ..OpenDevice::new(Box::new(device), "viewer") })
    }
}

/// Nobody holds a mouse so that it could push: nothing vibrates, and the instrument can stay close to the handle, as that of a
/// replay does.
const STIFFNESS_N_PER_M: f64 = 1e5;
const DAMPING_N_S_PER_M: f64 = 100.0;
const FORCE_RATE_N_PER_S: f64 = 1e4;
/// A loop that stood still for longer [s] goes on as if it had been so long.
const LONGEST_TICK_S: f64 = 0.1;

/// The loop's end.
pub(super) struct ViewerDevice {
    page: PageDeviceEnd,
    pose: ToolInput,
    /// When it was read last [ns]; 0 before that.
    read_ns: u64,
    rate_hz: f64,
    is_held: bool,
}

/// Both ends of a device for an instrument whose home is `home`; a loop reads it `rate_hz` times a second.
pub(super) fn open(home: &ToolInput, rate_hz: f64) -> (ViewerDevice, PageHand) {
    let (page, hand) = PageHand::joined(home);
    (ViewerDevice { page, pose: *home, read_ns: 0, rate_hz, is_held: false }, hand)
}

impl ViewerDevice {
    /// Where the handle is `dt_s` [s] after the last look.
    fn read_after(&mut self, dt_s: f64) -> Result<DeviceState, DeviceFault> {
        let aim = self.page.aims.get();
        self.is_held = aim.is_controlled;
        let before_m = self.pose.tip_in_world_m;
        let is_far = before_m.distance(aim.pose.tip_in_world_m) > JUMP_M;
        let is_put = aim.is_at_once || is_far;
        self.pose = if is_put { aim.pose } else { approach(self.pose, aim.pose, dt_s) };
        if !aim.is_controlled {
            return Err(DeviceFault::Lost("no page has control".into()));
        }
        let moved_m = self.pose.tip_in_world_m - before_m;
        let velocity_m_per_s = if is_put || dt_s <= 0.0 { DVec3::ZERO } else { moved_m / dt_s };
        Ok(DeviceState {
            position_m: self.pose.tip_in_world_m,
            velocity_m_per_s,
            orientation: Some(glam::DQuat::from_mat3(&ToolFrame::of(&self.pose).world_from_tool)),
            jaw_opening: self.pose.jaw_opening,
            buttons: u32::from(self.pose.is_triggered()),
        })
    }
}

impl HapticDevice for ViewerDevice {
    fn limits(&self) -> DeviceLimits {
        DeviceLimits {
            force_n: GREATEST_FORCE_N,
            torque_n_m: 0.0,
            force_rate_n_per_s: FORCE_RATE_N_PER_S,
            stiffness_n_per_m: STIFFNESS_N_PER_M,
            damping_n_s_per_m: DAMPING_N_S_PER_M,
            resolution_m: 0.0,
            rate_hz: self.rate_hz,
            // A page only shows forces: no hand closes a loop over them.
            ..DeviceLimits::default()
        }
    }

    fn read(&mut self) -> Result<DeviceState, DeviceFault> {
        let read_ns = now_ns();
        let passed_s = if self.read_ns == 0 { 0.0 } else { (read_ns - self.read_ns) as f64 * 1e-9 };
        self.read_ns = read_ns;
        self.read_after(passed_s.min(LONGEST_TICK_S))
    }

    fn write(&mut self, command: &ForceCommand) -> Result<(), DeviceFault> {
        self.page.felt.publish(Felt { force_n: command.force_n, is_held: self.is_held });
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT_S: f64 = 1e-3;

    fn home() -> ToolInput {
        ToolInput::at(DVec3::new(0.01, 0.02, 0.03), DVec3::Z)
    }

    fn at(x_m: f64) -> ToolInput {
        ToolInput { tip_in_world_m: home().tip_in_world_m + DVec3::X * x_m, ..home() }
    }

    fn opened() -> (ViewerDevice, PageHand) {
        let (device, mut hand) = open(&home(), 1_000.0);
        hand.set_controlled(true);
        (device, hand)
    }

    #[test]
    fn between_two_words_of_the_page_the_handle_goes_on_and_stays_there() {
        let (mut device, mut hand) = opened();
        assert_eq!(device.read_after(0.0).unwrap().position_m, home().tip_in_world_m);
        hand.aim(ToolInput { jaw_opening: 1.0, trigger: 1.0, roll_rad: 0.4, ..at(0.01) });
        let mut last = device.read_after(DT_S).unwrap();
        for _ in 0..300 {
            let state = device.read_after(DT_S).unwrap();
            let moved_m = state.position_m - last.position_m;
            assert!((state.velocity_m_per_s - moved_m / DT_S).length() < 1e-9);
            assert!(state.velocity_m_per_s.length() <= 1.0 + 1e-9);
            last = state;
        }
        assert!(last.position_m.distance(at(0.01).tip_in_world_m) < 1e-6, "{last:?}");
        assert!(last.buttons == 1 && last.jaw_opening > 0.999 && last.velocity_m_per_s.length() < 1e-4);
        let orientation = last.orientation.expect("a page tells it");
        let turned = orientation.to_axis_angle().1 - device_turn(&home());
        assert!(turned.abs() > 1e-3 && (orientation * DVec3::Z).distance(DVec3::Z) < 1e-9);
    }

    fn device_turn(pose: &ToolInput) -> f64 {
        glam::DQuat::from_mat3(&ToolFrame::of(pose).world_from_tool).to_axis_angle().1
    }

    #[test]
    fn what_is_far_or_put_is_there_at_once_and_is_no_motion() {
        let (mut device, mut hand) = opened();
        device.read_after(DT_S).unwrap();
        hand.aim(at(0.05));
        let state = device.read_after(DT_S).unwrap();
        assert_eq!((state.position_m, state.velocity_m_per_s), (at(0.05).tip_in_world_m, DVec3::ZERO));
        hand.aim(at(0.045));
        assert!(device.read_after(DT_S).unwrap().position_m.x > at(0.045).tip_in_world_m.x);
        hand.aim(at(0.01));
        device.read_after(DT_S).unwrap();
        // Also near, after a reset.
        hand.go_home();
        assert_eq!(device.read_after(DT_S).unwrap().position_m, home().tip_in_world_m);
        // And from there it moves as before.
        hand.aim(at(0.02));
        assert!(device.read_after(DT_S).unwrap().position_m.x < at(0.01).tip_in_world_m.x);
    }

    #[test]
    fn without_a_page_in_control_it_is_lost_and_comes_back_where_it_was() {
        let (mut device, mut hand) = open(&home(), 1_000.0);
        assert!(matches!(device.read(), Err(DeviceFault::Lost(_))));
        hand.set_controlled(true);
        assert!(device.read().is_ok());
        hand.aim(at(0.05));
        device.read().unwrap();
        hand.set_controlled(false);
        assert!(matches!(device.read(), Err(DeviceFault::Lost(_))));
        device.write(&ForceCommand::default()).unwrap();
        assert_eq!(hand.felt(), Felt { force_n: DVec3::ZERO, is_held: false });
        hand.set_controlled(true);
        assert_eq!(device.read().unwrap().position_m, at(0.05).tip_in_world_m);
        let force_n = DVec3::new(1.0, 2.0, 3.0);
        device.write(&ForceCommand { force_n, ..ForceCommand::default() }).unwrap();
        assert_eq!(hand.felt(), Felt { force_n, is_held: true });
    }

    #[test]
    fn reading_and_writing_allocate_nothing() {
        let (mut device, mut hand) = opened();
        let counted = allocation_counter::measure(|| {
            for i in 0..50 {
                hand.aim(at(1e-3 * f64::from(i)));
                hand.set_controlled(i < 40);
                let _ = device.read();
                let _ = device.write(&ForceCommand::default());
            }
        });
        assert_eq!(counted.count_total, 0);
    }
}
