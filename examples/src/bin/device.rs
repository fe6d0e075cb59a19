//! A force-feedback device of one's own: it implements [`HapticDevice`], and the loop of the runtime ticks with it.
//!
//! A haptic paddle, the device of one axis that students build (A. M. Okamura, C. Richard and M. R. Cutkosky, Feeling is
//! believing: using a force-feedback joystick to teach dynamic systems, Journal of Engineering Education 91(3), 2002): a motor
//! turns the handle through a capstan, an encoder counts. Here the motor, the handle and the hand are simulated: with position
//! x, effective mass m, damping b of the hand and its arm, force F of the hand and f of the motor,
//!
//! `m dv/dt = F + f - b v`, `dx/dt = v`, by semi-implicit Euler, once a tick.
//!
//! The tissue is a spring that holds the instrument. The loop gives it to the hand through its virtual coupling
//! ([`glisson::haptics::coupling`]), two springs in a row: at rest the handle is at `x = F (1/K + 1/K_c)`, and the motor
//! pushes back with the hand's force.
#![allow(clippy::print_stdout, reason = "an example shows its figures on standard output")]

use glisson::haptics::{
    CouplingGains, DeviceFault, DeviceLimits, DeviceState, ForceCommand, GainShares, HapticDevice,
    HapticModel, Touch,
};
use glisson::math::{DMat3, DVec3};
use glisson::tool::ToolInput;
use glisson_runtime::haptic_loop::{HapticLoop, HapticSettings, PublishedModel, join};
use glisson_runtime::open_device::OpenDevice;
use glisson_runtime::realtime::now_ns;
use std::error::Error;
use std::sync::{Arc, Mutex};
use std::time::Duration;

const RATE_HZ: f64 = 1_000.0;
/// Of the handle with motor and hand [kg]: a choice.
const MASS_KG: f64 = 0.1;
/// Of hand and arm [N s/m]: a choice that lets the handle come to rest in about a second.
const DAMPING_N_S_PER_M: f64 = 12.0;
/// A step of the encoder at the handle [m]: a choice.
const ENCODER_STEP_M: f64 = 20e-6;
/// Of the tissue [N/m], and how hard the hand pushes [N].
const TISSUE_N_PER_M: f64 = 200.0;
const HAND_N: f64 = 1.0;

/// What the device shows outside of the loop: where its handle is and what its motor does.
#[derive(Clone, Copy, Default)]
struct Seen {
    position_m: f64,
    motor_n: f64,
    n_ticks: u64,
}

/// The paddle in a hand that pushes steadily.
#[derive(Default)]
struct Paddle {
    position_m: f64,
    velocity_m_per_s: f64,
    motor_n: f64,
    n_ticks: u64,
    seen: Arc<Mutex<Seen>>,
}

/// What a device can do decides how the loop drives it: a stiffness or a rate that is not true makes it shake.
fn limits() -> DeviceLimits {
    DeviceLimits {
        force_n: 7.0,
        force_rate_n_per_s: 1e4,
        stiffness_n_per_m: 2_000.0,
        damping_n_s_per_m: 10.0,
        resolution_m: ENCODER_STEP_M,
        rate_hz: RATE_HZ,
        ..DeviceLimits::NONE
    }
}

impl HapticDevice for Paddle {
    fn limits(&self) -> DeviceLimits {
        limits()
    }

    /// Called once a tick. A driver reads its line here and must not wait; one that hears nothing answers
    /// [`DeviceFault::Lost`].
    fn read(&mut self) -> Result<DeviceState, DeviceFault> {
        let dt_s = 1.0 / RATE_HZ;
        let acceleration = (HAND_N + self.motor_n - DAMPING_N_S_PER_M * self.velocity_m_per_s) / MASS_KG;
        self.velocity_m_per_s += acceleration * dt_s;
        self.position_m += self.velocity_m_per_s * dt_s;
        self.n_ticks += 1;
        // A real driver has no lock in a tick; here it is never waited for.
        if let Ok(mut seen) = self.seen.try_lock() {
            *seen = Seen { position_m: self.position_m, motor_n: self.motor_n, n_ticks: self.n_ticks };
        }
        let counted_m = (self.position_m / ENCODER_STEP_M).round() * ENCODER_STEP_M;
        Ok(DeviceState {
            position_m: DVec3::X * counted_m,
            velocity_m_per_s: DVec3::X * self.velocity_m_per_s,
            orientation: None,
            jaw_opening: 0.0,
            buttons: 0,
        })
    }

    /// Called once a tick, after the read. The motor has one axis and its greatest force.
    fn write(&mut self, command: &ForceCommand) -> Result<(), DeviceFault> {
        let most_n = self.limits().force_n;
        self.motor_n = command.force_n.x.clamp(-most_n, most_n);
        // Of the last write, after which nobody reads any more, too.
        if let Ok(mut seen) = self.seen.lock() {
            seen.motor_n = self.motor_n;
        }
        Ok(())
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let paddle = Paddle::default();
    let seen = Arc::clone(&paddle.seen);
    let home = ToolInput::at(DVec3::ZERO, DVec3::Z);
    let (held, mut link) = join(OpenDevice::new(Box::new(paddle), "paddle"), 0, home);
    let settings = HapticSettings { rate_hz: RATE_HZ, ..HapticSettings::default() };
    let haptics = HapticLoop::start(vec![held], settings, Arc::default())?;

    // What `World::haptic_model` gives after each step of a simulation; this tissue is simple enough to be written down.
    let tissue = HapticModel {
        touch: Touch::Grasp,
        tip_m: home.tip_in_world_m,
        stiffness_n_per_m: DMat3::from_diagonal(DVec3::splat(TISSUE_N_PER_M)),
        hold_n: f64::INFINITY,
        ..HapticModel::default()
    };
    // Two seconds of ticks, however busy the machine is; a loop that stands still ends the program.
    for _ in 0..3_000 {
        link.models.publish(PublishedModel { model: tissue, made_ns: now_ns() });
        std::thread::sleep(Duration::from_millis(10));
        if seen.lock().is_ok_and(|seen| seen.n_ticks >= 2_000) {
            break;
        }
    }
    let at_rest = *seen.lock().map_err(|_| "the haptic loop broke")?;
    let tool_m = link.motions.get().pose.tip_in_world_m.x;
    let report = haptics.meters().report();
    // The loop takes its force back before it ends.
    drop(haptics);
    let after = *seen.lock().map_err(|_| "the haptic loop broke")?;

    let coupling_n_per_m = CouplingGains::within(&limits(), &GainShares::default()).stiffness_n_per_m;
    let expected_m = HAND_N * (1.0 / TISSUE_N_PER_M + 1.0 / coupling_n_per_m);
    println!("ticks counted: {}, at {:.0} Hz", report.n_deadlines, report.rate_hz);
    println!("motor {:.3} N, hand {HAND_N:.3} N", at_rest.motor_n);
    println!("handle {:.3} mm, two springs in a row {:.3} mm", at_rest.position_m * 1e3, expected_m * 1e3);
    println!("instrument {:.3} mm, tissue alone {:.3} mm", tool_m * 1e3, HAND_N / TISSUE_N_PER_M * 1e3);
    println!("motor after the loop: {:.3} N", after.motor_n.abs());
    Ok(())
}
