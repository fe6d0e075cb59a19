//! From the device's frame to the world and back.
//!
//! `tip in world = origin + s R (p - p_0) + R q t`, force at the handle `c R^T F`, torque there `(c/s) R^T ((R q t) x F)`: with
//! the handle at p in orientation q, the tip at t in the handle's frame, and F the force on the tip. So the powers at the handle
//! and at the tip differ by the factor c/s alone.

use super::device::{DeviceState, ForceCommand};
use crate::math::{DMat3, DVec3};
use crate::tool::ToolInput;
use crate::tool::pose::ToolFrame;
use glam::DQuat;

/// How a device's motion becomes an instrument's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeviceMapping {
    /// R: from the device's axes to the world's.
    pub world_from_device: DQuat,
    /// s: metres of the instrument for a metre of the handle; positive.
    pub motion_scale: f64,
    /// c: newtons on the hand for a newton on the instrument; positive.
    pub force_scale: f64,
    /// Where the handle is in the device's frame [m] when the tip ...
    pub device_origin_m: DVec3,
    /// ... is there in the world [m], the instrument having no length.
    pub world_origin_m: DVec3,
    /// R q: from the handle's axes to the world's, as long as the device does not tell its orientation.
    pub world_from_handle: DQuat,
    /// t: the tip in the handle's frame [m].
    pub tip_in_handle_m: DVec3,
    /// Button that holds the instrument while the handle is moved aside, counted from 0.
    pub clutch_button: Option<u32>,
    /// Button that is the instrument's trigger, counted from 0.
    pub trigger_button: Option<u32>,
}

/// Same axes, same size, no length, buttons 0 and 1 for trigger and clutch.
impl Default for DeviceMapping {
    fn default() -> Self {
        Self {
            world_from_device: DQuat::IDENTITY,
            motion_scale: 1.0,
            force_scale: 1.0,
            device_origin_m: DVec3::ZERO,
            world_origin_m: DVec3::ZERO,
            world_from_handle: DQuat::IDENTITY,
            tip_in_handle_m: DVec3::ZERO,
            clutch_button: Some(1),
            trigger_button: Some(0),
        }
    }
}

/// Axes of patients (+x left, +y posterior, +z superior) from a device's in front of a user who looks at a supine patient from
/// the feet, his head away: the device's +x to the user's right is the patient's left, its +y up is anterior, its +z to the
/// user is inferior. Devices of the OpenHaptics kind have these axes.
pub fn patient_from_desk() -> DQuat {
    DQuat::from_mat3(&DMat3::from_cols(DVec3::X, DVec3::NEG_Y, DVec3::NEG_Z))
}

/// Where the handle is in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Handle {
    /// The tip that it holds [m].
    pub tip_m: DVec3,
    /// From the handle to that tip [m].
    pub arm_m: DVec3,
    /// From the handle's axes to the world's.
    pub orientation: DQuat,
    /// Whether it is moved aside.
    pub is_clutched: bool,
}

/// A mapping in use: the clutch moves its origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MappedDevice {
    mapping: DeviceMapping,
    was_clutched: bool,
    held_m: DVec3,
}

fn is_pressed(buttons: u32, button: Option<u32>) -> bool {
    button.is_some_and(|b| b < u32::BITS && buttons >> b & 1 == 1)
}

impl MappedDevice {
    /// Begins with that mapping. A scale that is not positive counts as 1.
    pub fn new(mapping: &DeviceMapping) -> Self {
        let positive = |scale: f64| if scale > 0.0 && scale.is_finite() { scale } else { 1.0 };
        let mapping = DeviceMapping {
            world_from_device: mapping.world_from_device.normalize(),
            world_from_handle: mapping.world_from_handle.normalize(),
            motion_scale: positive(mapping.motion_scale),
            force_scale: positive(mapping.force_scale),
            ..*mapping
        };
        Self { mapping, was_clutched: false, held_m: DVec3::ZERO }
    }

    /// The mapping now.
    pub fn mapping(&self) -> &DeviceMapping {
        &self.mapping
    }

    /// Stiffness at the tip [N/m] of one at the handle [N/m]; also for damping.
    pub fn gain_in_world(&self, gain_at_handle: f64) -> f64 {
        gain_at_handle / (self.mapping.force_scale * self.mapping.motion_scale)
    }

    /// Energy at the handle [J] of one at the tip [J].
    pub fn energy_at_handle_j(&self, energy_at_tip_j: f64) -> f64 {
        energy_at_tip_j * self.mapping.force_scale / self.mapping.motion_scale
    }

    /// Where the handle is. While it is clutched its place is held; when let go it goes on from there.
    pub fn to_world(&mut self, device: &DeviceState) -> Handle {
        let m = &mut self.mapping;
        let moved_m = m.world_from_device * (device.position_m - m.device_origin_m) * m.motion_scale;
        let is_clutched = is_pressed(device.buttons, m.clutch_button);
        if is_clutched && !self.was_clutched {
            self.held_m = m.world_origin_m + moved_m;
        }
        if is_clutched {
            m.world_origin_m = self.held_m - moved_m;
        }
        self.was_clutched = is_clutched;
        let orientation = device.orientation.map_or(m.world_from_handle, |q| m.world_from_device * q);
        let arm_m = orientation * m.tip_in_handle_m;
        Handle { tip_m: m.world_origin_m + moved_m + arm_m, arm_m, orientation, is_clutched }
    }

    /// From the handle's axes to the device's, of those to the world's.
    pub(super) fn to_device_axes(self, world_from_handle: DQuat) -> DQuat {
        self.mapping.world_from_device.inverse() * world_from_handle
    }

    /// Force and torque at the handle, in the device's frame, of a force on the tip in the world [N].
    pub fn to_device(&self, force_n: DVec3, arm_m: DVec3) -> ForceCommand {
        let m = &self.mapping;
        let device_from_world = m.world_from_device.inverse();
        ForceCommand {
            force_n: device_from_world * force_n * m.force_scale,
            torque_n_m: device_from_world * arm_m.cross(force_n) * (m.force_scale / m.motion_scale),
            jaw_force_n: 0.0,
        }
    }

    /// The instrument with its tip at `tip_m` [m] and the handle's orientation, jaws and trigger.
    pub fn tool(&self, tip_m: DVec3, handle: &Handle, device: &DeviceState) -> ToolInput {
        let mut tool = ToolInput::at(tip_m, (handle.orientation * DVec3::Z).normalize());
        let without_roll = ToolFrame::of(&tool).world_from_tool.transpose() * (handle.orientation * DVec3::X);
        tool.roll_rad = libm::atan2(without_roll.y, without_roll.x);
        tool.jaw_opening = device.jaw_opening.clamp(0.0, 1.0);
        tool.trigger = if is_pressed(device.buttons, self.mapping.trigger_button) { 1.0 } else { 0.0 };
        tool
    }
}

/// The turn from one orientation to the next as a vector along its axis [rad], at most half a turn.
pub fn turn_rad(from: DQuat, to: DQuat) -> DVec3 {
    let turn = to * from.inverse();
    let turn = if turn.w < 0.0 { -turn } else { turn };
    let sine = turn.xyz().length();
    // Small turns: twice the vector part, to third order.
    if sine < 1e-6 { turn.xyz() * 2.0 } else { turn.xyz() * (2.0 * libm::atan2(sine, turn.w) / sine) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::SeededRandom;

    fn state(position_m: DVec3, orientation: DQuat, buttons: u32) -> DeviceState {
        let orientation = Some(orientation);
        DeviceState { position_m, velocity_m_per_s: DVec3::ZERO, orientation, jaw_opening: 0.3, buttons }
    }

    fn any_turn(random: &mut SeededRandom) -> DQuat {
        DQuat::from_xyzw(random.normal(), random.normal(), random.normal(), random.normal()).normalize()
    }

    /// Work at the handle is c/s times work at the tip, force and torque together.
    #[test]
    fn power_at_the_handle_is_that_at_the_tip() {
        let mut random = SeededRandom::new(3);
        for _ in 0..50 {
            let vector = |random: &mut SeededRandom| {
                DVec3::new(
                    random.uniform_in(-1.0, 1.0),
                    random.uniform_in(-1.0, 1.0),
                    random.uniform_in(-1.0, 1.0),
                )
            };
            let mapping = DeviceMapping {
                world_from_device: any_turn(&mut random),
                motion_scale: random.uniform_in(0.2, 3.0),
                force_scale: random.uniform_in(0.2, 3.0),
                tip_in_handle_m: vector(&mut random) * 0.1,
                world_origin_m: vector(&mut random),
                ..DeviceMapping::default()
            };
            let mut mapped = MappedDevice::new(&mapping);
            let (p_m, q) = (vector(&mut random), any_turn(&mut random));
            let (dp_m, turn) = (vector(&mut random) * 1e-6, vector(&mut random) * 1e-6);
            let before = mapped.to_world(&state(p_m, q, 0));
            let after = mapped.to_world(&state(p_m + dp_m, DQuat::from_scaled_axis(turn) * q, 0));
            let force_n = vector(&mut random);
            let command = mapped.to_device(force_n, before.arm_m);
            let at_handle_j = command.force_n.dot(dp_m) + command.torque_n_m.dot(turn);
            let at_tip_j = mapped.energy_at_handle_j(force_n.dot(after.tip_m - before.tip_m));
            assert!((at_handle_j - at_tip_j).abs() < 1e-11, "{at_handle_j} {at_tip_j}");
        }
    }

    #[test]
    fn the_clutch_holds_the_tip_and_goes_on_from_there() {
        let mapping = DeviceMapping { motion_scale: 2.0, clutch_button: Some(1), ..DeviceMapping::default() };
        let mut mapped = MappedDevice::new(&mapping);
        let mut at = |x_m: f64, buttons: u32| {
            let handle = mapped.to_world(&state(DVec3::X * x_m, DQuat::IDENTITY, buttons));
            (handle.tip_m.x, handle.is_clutched)
        };
        assert_eq!(at(0.5, 0), (1.0, false));
        assert_eq!(at(0.5, 2), (1.0, true));
        assert_eq!(at(0.125, 2), (1.0, true));
        assert_eq!(at(0.125, 0), (1.0, false));
        assert_eq!(at(0.25, 0), (1.25, false));
    }

    #[test]
    fn the_tool_has_the_frame_of_the_handle() {
        let mut random = SeededRandom::new(9);
        let mut mapped = MappedDevice::new(&DeviceMapping {
            world_from_device: patient_from_desk(),
            ..DeviceMapping::default()
        });
        for _ in 0..50 {
            let device = state(DVec3::ZERO, any_turn(&mut random), 1);
            let handle = mapped.to_world(&device);
            let tool = mapped.tool(DVec3::ONE, &handle, &device);
            let frame = ToolFrame::of(&tool).world_from_tool;
            let wanted = DMat3::from_quat(handle.orientation);
            assert!((0..3).all(|i| (frame.col(i) - wanted.col(i)).length() < 1e-9));
            assert!(tool.trigger == 1.0 && tool.jaw_opening == 0.3 && tool.tip_in_world_m == DVec3::ONE);
        }
    }

    #[test]
    fn turns_are_vectors_along_their_axis() {
        let mut random = SeededRandom::new(1);
        for size in [1e-9, 1e-3, 1.0, 3.1] {
            let axis = DVec3::new(random.normal(), random.normal(), random.normal()).normalize();
            let from = any_turn(&mut random);
            let found = turn_rad(from, DQuat::from_axis_angle(axis, size) * from);
            assert!((found - axis * size).length() < 1e-9 * size.max(1e-3), "{size}: {found}");
        }
    }
}
