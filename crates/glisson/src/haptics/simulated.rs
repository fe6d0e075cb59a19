//! A device with a hand on it, simulated: for tests, for experiments and for a simulator without a device.
//!
//! Two masses on springs and dampers. The arm pulls the hand along a path that it wants to go; the grip holds the handle; the
//! handle has mass, viscous and Coulomb friction, and the actuator's force:
//!
//! `M x_h'' = K_a (p - x_h) + B_a (p' - x_h') - K_g (x_h - x) - B_g (x_h' - x')`
//! `m x'' = K_g (x_h - x) + B_g (x_h' - x') - b x' - f sign x' + F`
//!
//! Everything is passive but the path, so that what goes wrong with a force that is held over a tick comes from that force. The
//! positions that the device tells are late, noisy and rounded; the force comes late. Random numbers are seeded, and time goes on
//! by one period with every [`HapticDevice::write`]: the same commands give the same run.
//!
//! The numbers of the handle are those of a small stylus device as its users know them (3.3 N, 0.055 mm, 1 kHz); mass, friction
//! and what it renders are choices of that size. The hand is a choice too: K. J. Kuchenbecker, J. G. Park and G. Niemeyer
//! (Characterizing the human wrist for improved haptic interaction, IMECE 2003) and M. J. Fu and M. C. Cavusoglu
//! (Human-arm-and-hand-dynamic model with variability analyses for a stylus-based haptic interface, IEEE Transactions on
//! Systems, Man, and Cybernetics B, 2012) find a mass of a hand that a grip couples more or less stiffly; here it is held
//! between two such grips.

use super::coupling::renderable_stiffness_n_per_m;
use super::device::{DeviceFault, DeviceLimits, DeviceState, ForceCommand, HapticDevice};
use super::limits::within_limits;
use crate::math::{DVec3, SeededRandom};
use glam::DQuat;

/// Longest delay of positions, and of forces, in ticks.
pub const MOST_LATENCY_TICKS: usize = 32;

/// Steps of the masses in a period.
const SUBSTEPS: u32 = 16;

/// Cut-off of the velocity that the device tells [Hz]: a choice, as drivers filter differences of positions.
const VELOCITY_CUTOFF_HZ: f64 = 100.0;

/// The device's mechanics and electronics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulatedDeviceSettings {
    /// Mass that moves with the handle [kg].
    pub mass_kg: f64,
    /// Viscous friction [N s/m].
    pub damping_n_s_per_m: f64,
    /// Coulomb friction [N].
    pub friction_n: f64,
    /// Largest force [N].
    pub force_n: f64,
    /// Largest change of force [N/s].
    pub force_rate_n_per_s: f64,
    /// Step of the positions that it tells [m]; 0 for none.
    pub resolution_m: f64,
    /// Standard deviation of their noise [m].
    pub noise_m: f64,
    /// Delay of the positions in ticks.
    pub position_latency_ticks: usize,
    /// Delay of the force in ticks.
    pub force_latency_ticks: usize,
    /// Ticks a second.
    pub rate_hz: f64,
}

impl Default for SimulatedDeviceSettings {
    fn default() -> Self {
        Self {
            mass_kg: 0.05,
            damping_n_s_per_m: 0.6,
            friction_n: 0.05,
            force_n: 3.3,
            force_rate_n_per_s: 2000.0,
            resolution_m: 5.5e-5,
            noise_m: 0.0,
            position_latency_ticks: 0,
            force_latency_ticks: 0,
            rate_hz: 1000.0,
        }
    }
}

impl SimulatedDeviceSettings {
    /// Without friction, rounding, noise and delay.
    pub fn ideal() -> Self {
        Self { friction_n: 0.0, resolution_m: 0.0, ..Self::default() }
    }

    /// What such a device says that it can do: it renders what its viscous friction allows.
    pub fn limits(&self) -> DeviceLimits {
        let period_s = 1.0 / self.rate_hz;
        DeviceLimits {
            force_n: self.force_n,
            torque_n_m: 0.0,
            force_rate_n_per_s: self.force_rate_n_per_s,
            stiffness_n_per_m: renderable_stiffness_n_per_m(self.damping_n_s_per_m, 0.0, period_s),
            damping_n_s_per_m: self.damping_n_s_per_m,
            resolution_m: self.resolution_m + 6.0 * self.noise_m,
            rate_hz: self.rate_hz,
            loop_delay_ticks: self.position_latency_ticks + self.force_latency_ticks,
            ..DeviceLimits::NONE
        }
    }
}

/// The hand and its arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandSettings {
    /// Mass of the hand [kg].
    pub mass_kg: f64,
    /// Of the grip on the handle [N/m].
    pub grip_stiffness_n_per_m: f64,
    /// [N s/m]
    pub grip_damping_n_s_per_m: f64,
    /// Of the arm that follows the path [N/m].
    pub arm_stiffness_n_per_m: f64,
    /// [N s/m]
    pub arm_damping_n_s_per_m: f64,
}

/// A hand that holds the handle as one holds an instrument.
impl Default for HandSettings {
    fn default() -> Self {
        Self {
            mass_kg: 0.15,
            grip_stiffness_n_per_m: 800.0,
            grip_damping_n_s_per_m: 4.0,
            arm_stiffness_n_per_m: 300.0,
            arm_damping_n_s_per_m: 4.0,
        }
    }
}

impl HandSettings {
    /// Two fingers on the handle that hardly damp: the worst case for stability.
    pub fn loose() -> Self {
        Self {
            mass_kg: 0.05,
            grip_stiffness_n_per_m: 300.0,
            grip_damping_n_s_per_m: 0.8,
            arm_stiffness_n_per_m: 150.0,
            arm_damping_n_s_per_m: 0.8,
        }
    }
}

/// Where the hand wants to go.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum HandPath {
    /// Stays there [m].
    Rest(DVec3),
    /// From one place to the next on a straight line, smoothly: of all ways the one with the least jerk (T. Flash and N. Hogan,
    /// The coordination of arm movements, Journal of Neuroscience 5(7), 1985).
    Reach {
        /// From [m].
        from_m: DVec3,
        /// To [m].
        to_m: DVec3,
        /// When it begins [s].
        start_s: f64,
        /// How long it takes [s].
        duration_s: f64,
    },
    /// `center - amplitude cos(2 pi f t)`: begins at rest.
    Swing {
        /// Middle [m].
        center_m: DVec3,
        /// To either side [m].
        amplitude_m: DVec3,
        /// [Hz]
        frequency_hz: f64,
    },
}

impl HandPath {
    /// Place [m] and velocity [m/s] after `time_s` [s].
    pub fn at(&self, time_s: f64) -> (DVec3, DVec3) {
        match *self {
            Self::Rest(place_m) => (place_m, DVec3::ZERO),
            Self::Reach { from_m, to_m, start_s, duration_s } => {
                let u =
                    if duration_s > 0.0 { ((time_s - start_s) / duration_s).clamp(0.0, 1.0) } else { 1.0 };
                let share = u * u * u * (10.0 - 15.0 * u + 6.0 * u * u);
                let speed =
                    if duration_s > 0.0 { 30.0 * u * u * (1.0 - u) * (1.0 - u) / duration_s } else { 0.0 };
                (from_m + (to_m - from_m) * share, (to_m - from_m) * speed)
            }
            Self::Swing { center_m, amplitude_m, frequency_hz } => {
                let omega = std::f64::consts::TAU * frequency_hz;
                let (sine, cosine) = libm::sincos(omega * time_s);
                (center_m - amplitude_m * cosine, amplitude_m * (omega * sine))
            }
        }
    }
}

/// What comes out as late as it came in before.
#[derive(Clone, Copy, Debug, PartialEq)]
struct DelayLine {
    values: [DVec3; MOST_LATENCY_TICKS + 1],
    ticks: usize,
}

impl DelayLine {
    fn new(ticks: usize, value: DVec3) -> Self {
        Self { values: [value; MOST_LATENCY_TICKS + 1], ticks: ticks.min(MOST_LATENCY_TICKS) }
    }

    fn pass(&mut self, value: DVec3) -> DVec3 {
        self.values[self.ticks] = value;
        let out = self.values[0];
        self.values.copy_within(1..=self.ticks, 0);
        out
    }
}

/// The device with a hand on it.
#[derive(Clone, Debug)]
pub struct SimulatedDevice {
    settings: SimulatedDeviceSettings,
    hand: HandSettings,
    path: HandPath,
    random: SeededRandom,
    time_s: f64,
    handle_m: DVec3,
    handle_m_per_s: DVec3,
    hand_m: DVec3,
    hand_m_per_s: DVec3,
    positions: DelayLine,
    forces: DelayLine,
    told: DeviceState,
    port_energy_j: f64,
    actuator_n: DVec3,
}

impl SimulatedDevice {
    /// A device at rest where the path begins.
    pub fn new(settings: &SimulatedDeviceSettings, hand: &HandSettings, path: HandPath, seed: u64) -> Self {
        let (place_m, _) = path.at(0.0);
        let told = DeviceState {
            position_m: place_m,
            velocity_m_per_s: DVec3::ZERO,
            orientation: None,
            jaw_opening: 0.0,
            buttons: 0,
        };
        let mut device = Self {
            settings: *settings,
            hand: *hand,
            path,
            random: SeededRandom::new(seed),
            time_s: 0.0,
            handle_m: place_m,
            handle_m_per_s: DVec3::ZERO,
            hand_m: place_m,
            hand_m_per_s: DVec3::ZERO,
            positions: DelayLine::new(settings.position_latency_ticks, place_m),
            forces: DelayLine::new(settings.force_latency_ticks, DVec3::ZERO),
            told,
            port_energy_j: 0.0,
            actuator_n: DVec3::ZERO,
        };
        device.told.position_m = device.rounded(place_m);
        device
    }

    /// Another way to go, from now on: its time goes on with the device's.
    pub fn set_path(&mut self, path: HandPath) {
        self.path = path;
    }

    /// Turns the handle, whose orientation it tells from now on.
    pub fn set_orientation(&mut self, orientation: DQuat) {
        self.told.orientation = Some(orientation.normalize());
    }

    /// Presses buttons and moves the jaws.
    pub fn set_buttons(&mut self, buttons: u32, jaw_opening: f64) {
        (self.told.buttons, self.told.jaw_opening) = (buttons, jaw_opening.clamp(0.0, 1.0));
    }

    /// Time [s] since the start: one period for every command.
    pub fn time_s(&self) -> f64 {
        self.time_s
    }

    /// Where the handle is in truth [m].
    pub fn handle_m(&self) -> DVec3 {
        self.handle_m
    }

    /// How fast it goes in truth [m/s].
    pub fn handle_m_per_s(&self) -> DVec3 {
        self.handle_m_per_s
    }

    /// Where the hand wants to be [m].
    pub fn wanted_m(&self) -> DVec3 {
        self.path.at(self.time_s).0
    }

    /// Force that the actuator exerts [N].
    pub fn actuator_n(&self) -> DVec3 {
        self.actuator_n
    }

    /// What the handle in truth gave to the actuator since the start, less what it got [J].
    pub fn port_energy_j(&self) -> f64 {
        self.port_energy_j
    }

    fn rounded(&mut self, place_m: DVec3) -> DVec3 {
        let noise_m = self.settings.noise_m;
        let noise = if noise_m > 0.0 {
            DVec3::new(self.random.normal(), self.random.normal(), self.random.normal()) * noise_m
        } else {
            DVec3::ZERO
        };
        let step_m = self.settings.resolution_m;
        let noisy_m = place_m + noise;
        if step_m > 0.0 { (noisy_m / step_m).round() * step_m } else { noisy_m }
    }

    /// Moves the masses by one step under the actuator's force (semi-implicit Euler; Coulomb friction stops, never reverses).
    fn substep(&mut self, force_n: DVec3, dt_s: f64) {
        let (settings, hand) = (&self.settings, &self.hand);
        self.time_s += dt_s;
        let (wanted_m, wanted_m_per_s) = self.path.at(self.time_s);
        let grip_n = (self.hand_m - self.handle_m) * hand.grip_stiffness_n_per_m
            + (self.hand_m_per_s - self.handle_m_per_s) * hand.grip_damping_n_s_per_m;
        let arm_n = (wanted_m - self.hand_m) * hand.arm_stiffness_n_per_m
            + (wanted_m_per_s - self.hand_m_per_s) * hand.arm_damping_n_s_per_m;
        self.hand_m_per_s += (arm_n - grip_n) * (dt_s / hand.mass_kg);
        let pulled_n = grip_n - self.handle_m_per_s * settings.damping_n_s_per_m + force_n;
        let pushed = self.handle_m_per_s + pulled_n * (dt_s / settings.mass_kg);
        let stopped = settings.friction_n * dt_s / settings.mass_kg;
        let speed = pushed.length();
        self.handle_m_per_s = if speed > stopped { pushed * (1.0 - stopped / speed) } else { DVec3::ZERO };
        self.hand_m += self.hand_m_per_s * dt_s;
        self.handle_m += self.handle_m_per_s * dt_s;
    }

    /// Goes on for one period under `command`.
    fn advance(&mut self, command: &ForceCommand) {
        let limits = self.settings.limits();
        let asked_n = within_limits(command, &limits).force_n;
        let force_n = self.forces.pass(asked_n);
        self.actuator_n = force_n;
        let period_s = 1.0 / self.settings.rate_hz;
        let from_m = self.handle_m;
        for _ in 0..SUBSTEPS {
            self.substep(force_n, period_s / f64::from(SUBSTEPS));
        }
        self.port_energy_j -= force_n.dot(self.handle_m - from_m);
        let rounded_m = self.rounded(self.handle_m);
        let position_m = self.positions.pass(rounded_m);
        let difference = (position_m - self.told.position_m) / period_s;
        let weight = 1.0 - libm::exp(-std::f64::consts::TAU * VELOCITY_CUTOFF_HZ * period_s);
        self.told.velocity_m_per_s += (difference - self.told.velocity_m_per_s) * weight;
        self.told.position_m = position_m;
    }
}

impl HapticDevice for SimulatedDevice {
    fn limits(&self) -> DeviceLimits {
        self.settings.limits()
    }

    fn read(&mut self) -> Result<DeviceState, DeviceFault> {
        Ok(self.told)
    }

    fn write(&mut self, command: &ForceCommand) -> Result<(), DeviceFault> {
        self.advance(command);
        Ok(())
    }
}
