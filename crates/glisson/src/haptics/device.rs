//! What a force-feedback device is to the haptic loop.

use crate::math::DVec3;
use glam::DQuat;
use std::borrow::Cow;

/// What a device said at a tick, in its own frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeviceState {
    /// Where its handle is [m].
    pub position_m: DVec3,
    /// How fast it moves [m/s].
    pub velocity_m_per_s: DVec3,
    /// From the handle's frame to the device's; none where the device does not tell it. The handle's +z points from the
    /// instrument's tip towards the hand.
    pub orientation: Option<DQuat>,
    /// How far the handle's jaws are open: 0 closed, 1 wide open.
    pub jaw_opening: f64,
    /// Buttons, bit by bit from the first one.
    pub buttons: u32,
}

/// What the haptic loop asks of a device, in the device's frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ForceCommand {
    /// Force on the hand [N].
    pub force_n: DVec3,
    /// Torque on the hand [N m].
    pub torque_n_m: DVec3,
    /// Force that opens the handle's jaws [N].
    pub jaw_force_n: f64,
}

/// What a device can do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeviceLimits {
    /// Largest force [N].
    pub force_n: f64,
    /// Largest torque [N m]; 0 without.
    pub torque_n_m: f64,
    /// Largest force at the handle's jaws [N]; 0 without.
    pub jaw_force_n: f64,
    /// Way of the handle's jaws, where that force acts, from closed to wide open [m].
    pub jaw_travel_m: f64,
    /// Largest change of force [N/s].
    pub force_rate_n_per_s: f64,
    /// Largest stiffness that it renders stably at its rate [N/m].
    pub stiffness_n_per_m: f64,
    /// Largest damping that it renders stably [N s/m].
    pub damping_n_s_per_m: f64,
    /// Smallest step of position that it sees [m].
    pub resolution_m: f64,
    /// Ticks a second.
    pub rate_hz: f64,
    /// Ticks at that rate from a command to the first position that it acted on, beyond the usual one: what threads, lines and
    /// makers' libraries add. The energy bound counts them ([`super::passivity`]).
    pub loop_delay_ticks: usize,
}

impl DeviceLimits {
    /// A device that exerts nothing, answers at once and is driven a thousand times a second: to begin a list of limits with.
    pub const NONE: Self = Self {
        force_n: 0.0,
        torque_n_m: 0.0,
        jaw_force_n: 0.0,
        jaw_travel_m: 0.0,
        force_rate_n_per_s: 0.0,
        stiffness_n_per_m: 0.0,
        damping_n_s_per_m: 0.0,
        resolution_m: 0.0,
        rate_hz: 1_000.0,
        loop_delay_ticks: 0,
    };
}

impl Default for DeviceLimits {
    fn default() -> Self {
        Self::NONE
    }
}

/// Why a device did not answer. A fixed text costs no allocation in a tick.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum DeviceFault {
    /// It may come back: nothing new since the last tick, or the line is down.
    Lost(Cow<'static, str>),
    /// It will not.
    Failed(Cow<'static, str>),
}

/// An instrument that was put into a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InsertedInstrument {
    /// What it is, for people.
    pub name: &'static str,
    /// Which one of them.
    pub serial: u16,
}

/// A device with a handle that is read and pushes back. Neither call may wait for longer than a small share of a tick.
pub trait HapticDevice: Send {
    /// What it can do.
    fn limits(&self) -> DeviceLimits;

    /// The instrument in it; none now, or a device whose handle is all that there is.
    fn inserted(&self) -> Option<InsertedInstrument> {
        None
    }

    /// Where its handle is.
    ///
    /// # Errors
    /// [`DeviceFault`] when it does not say.
    fn read(&mut self) -> Result<DeviceState, DeviceFault>;

    /// Makes it push.
    ///
    /// # Errors
    /// [`DeviceFault`] when the command cannot be given; the device then goes to zero by itself or through its driver.
    fn write(&mut self, command: &ForceCommand) -> Result<(), DeviceFault>;
}
