//! The two active trocars: the one that was built and the one that was asked for (seed `000`, s. 5.3.3, 5.4.2, 5.4.5).

use super::kinematics::{N_AXES, TrocarJoints};
use super::motors::{AxisLimits, Transmission};
use crate::haptics::device::DeviceLimits;

/// What an active trocar is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrocarProfile {
    /// What the user calls it.
    pub name: &'static str,
    /// Across the cradle, and so the least distance between two of them [m].
    pub cradle_diameter_m: f64,
    /// Greatest pitch and roll to either side [rad].
    pub tilt_limit_rad: f64,
    /// Greatest insertion [m].
    pub insertion_limit_m: f64,
    /// Steps of the encoders, in the order of [`super::Axis`]: [rad, rad, m, rad, share of the jaws' travel].
    pub resolution: [f64; N_AXES],
    /// Greatest efforts.
    pub limits: AxisLimits,
    /// Between motors and axes.
    pub transmission: Transmission,
    /// Way of the handle's jaws from closed to wide open [m].
    pub jaw_travel_m: f64,
    /// Ticks a second.
    pub rate_hz: f64,
    /// Friction along the instrument that is left [N] ...
    pub friction_n: f64,
    /// ... and damping [N s/m].
    pub damping_n_s_per_m: f64,
}

/// Radius of the rollers: a choice (the seed has r_gallet without a value); fits a heart within a ball of 80 mm.
const ROLLER_RADIUS_M: f64 = 5e-3;
/// Reduction k of the self-rotation: a choice (without a value in the seed).
const GEAR_RATIO: f64 = 4.0;
/// Middle of the seed's 0.95 to 0.98.
const GEAR_EFFICIENCY: f64 = 0.965;
/// Seed `000`, s. 5.4.4.
const ROLLER_EFFICIENCY: f64 = 0.7;
/// Jaws: lever, travel, force and steps are choices; the seed asks for the motion and its force without figures.
const JAW_LEVER_M: f64 = 0.01;
const JAW_TRAVEL_M: f64 = 0.02;
const JAW_FORCE_N: f64 = 10.0;
const JAW_RESOLUTION: f64 = 1e-3;
/// The seed calls what is left small and gives no figure: choices.
const FRICTION_N: f64 = 0.2;
const DAMPING_N_S_PER_M: f64 = 1.0;
/// Time from rest to the greatest force: a choice, 10 ticks of the built one.
const FORCE_RISE_S: f64 = 0.01;

const TRANSMISSION: Transmission = Transmission {
    roller_radius_m: ROLLER_RADIUS_M,
    roller_efficiency: ROLLER_EFFICIENCY,
    gear_ratio: GEAR_RATIO,
    gear_efficiency: GEAR_EFFICIENCY,
    jaw_lever_m: JAW_LEVER_M,
};

/// Seed `000`, s. 5.4.5; the jaws are a choice. The efforts asked for have no figures, so both profiles share these.
const LIMITS: AxisLimits =
    AxisLimits { tilt_n_m: 6.0, translation_n: 5.0, self_rotation_n_m: 0.2, jaw_n: JAW_FORCE_N };

impl TrocarProfile {
    /// All names, the default first.
    pub const NAMES: [&'static str; 2] = ["built", "specified"];

    /// The prototype (s. 5.4.5).
    pub fn built() -> Self {
        let degrees = f64::to_radians;
        Self {
            name: Self::NAMES[0],
            cradle_diameter_m: 0.1,
            tilt_limit_rad: degrees(45.0),
            insertion_limit_m: 0.3,
            resolution: [degrees(0.01), degrees(0.01), 1e-4, degrees(0.05), JAW_RESOLUTION],
            limits: LIMITS,
            transmission: TRANSMISSION,
            jaw_travel_m: JAW_TRAVEL_M,
            rate_hz: 1000.0,
            friction_n: FRICTION_N,
            damping_n_s_per_m: DAMPING_N_S_PER_M,
        }
    }

    /// What was asked for (s. 5.3.3, 5.4.2).
    pub fn specified() -> Self {
        let degrees = f64::to_radians;
        Self {
            name: Self::NAMES[1],
            tilt_limit_rad: degrees(70.0),
            insertion_limit_m: 0.4,
            resolution: [degrees(0.05), degrees(0.05), 5e-5, degrees(0.05), JAW_RESOLUTION],
            rate_hz: 1500.0,
            ..Self::built()
        }
    }

    /// The profile of a name.
    pub fn of_name(name: &str) -> Option<Self> {
        [Self::built(), Self::specified()].into_iter().find(|profile| profile.name == name)
    }

    /// Least and greatest value of each motion, in the order of [`super::Axis`]; self-rotation has none (0 to 360 degrees
    /// again and again).
    pub fn ranges(&self) -> [[f64; 2]; N_AXES] {
        let tilt = [-self.tilt_limit_rad, self.tilt_limit_rad];
        let endless = [f64::NEG_INFINITY, f64::INFINITY];
        [tilt, tilt, [0.0, self.insertion_limit_m], endless, [0.0, 1.0]]
    }

    /// `joints` within what the mechanism can do.
    pub fn within(&self, joints: &TrocarJoints) -> TrocarJoints {
        let (values, ranges) = (joints.to_array(), self.ranges());
        TrocarJoints::from_array(std::array::from_fn(|i| values[i].clamp(ranges[i][0], ranges[i][1])))
    }

    /// Whether the mechanism can be there, up to one step of its encoders.
    pub fn holds(&self, joints: &TrocarJoints) -> bool {
        let (values, ranges) = (joints.to_array(), self.ranges());
        (0..N_AXES).all(|i| {
            let margin = self.resolution[i];
            (ranges[i][0] - margin..=ranges[i][1] + margin).contains(&values[i])
        })
    }

    /// Longest step of the tip that the encoders do not see, at insertion `insertion_m` and both tilts zero [m].
    pub fn tip_resolution_m(&self, insertion_m: f64) -> f64 {
        let [pitch, roll, insertion, ..] = self.resolution;
        ((pitch * pitch + roll * roll) * insertion_m * insertion_m + insertion * insertion).sqrt()
    }

    /// For the haptic law. The force is that along the instrument, the weakest direction: a force within it at the tip
    /// saturates no motor by virtual work, because 5 N at 0.4 m is 2 N m. The stiffness is the largest that a sampled
    /// wall can have without giving energy, the lesser of 2 b / T (damping b, period T) and 2 f / D (friction f, step of
    /// position D) (Abbott and Okamura, Effects of Position Quantization and Sampling Rate on Virtual-Wall Passivity,
    /// IEEE Transactions on Robotics 21(5), 2005).
    pub fn device_limits(&self) -> DeviceLimits {
        let resolution_m = self.resolution[2];
        let by_damping = 2.0 * self.damping_n_s_per_m * self.rate_hz;
        DeviceLimits {
            force_n: self.limits.translation_n,
            torque_n_m: self.limits.self_rotation_n_m,
            jaw_force_n: self.limits.jaw_n,
            jaw_travel_m: self.jaw_travel_m,
            force_rate_n_per_s: self.limits.translation_n / FORCE_RISE_S,
            stiffness_n_per_m: by_damping.min(2.0 * self.friction_n / resolution_m),
            damping_n_s_per_m: self.damping_n_s_per_m,
            resolution_m,
            rate_hz: self.rate_hz,
            ..DeviceLimits::NONE
        }
    }
}
