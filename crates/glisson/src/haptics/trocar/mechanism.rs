//! A mechanism and a hand to test drivers and laws with: each motion has its inertia, its friction and a hand that pulls
//! it to where it wants to be. Deterministic; time is what it is told.
//!
//! Neither seed nor maker gives inertia or friction (s. 5.4.4 calls both small); all numbers are choices.

use super::kinematics::{JointRates, N_AXES, TrocarJoints};
use super::profiles::TrocarProfile;
use super::statics::AxisEfforts;

/// Numbers of one motion, in its SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionParameters {
    /// Mass [kg] or moment of inertia [kg m2]; of the jaws the mass at the handle.
    pub inertia: f64,
    /// Damping [N s/m] or [N m s/rad].
    pub damping: f64,
    /// Coulomb friction [N] or [N m].
    pub friction: f64,
    /// Stiffness of the hand [N/m] or [N m/rad].
    pub hand_stiffness: f64,
    /// Damping of the hand [N s/m] or [N m s/rad].
    pub hand_damping: f64,
}

/// The mechanism of an active trocar in a hand.
#[derive(Clone, Debug, PartialEq)]
pub struct Mechanism {
    /// What it is.
    pub profile: TrocarProfile,
    /// Each motion, in the order of [`super::Axis`].
    pub motions: [MotionParameters; N_AXES],
    /// Where the motions are.
    pub joints: TrocarJoints,
    /// How fast they change.
    pub rates: JointRates,
    /// Where the hand wants them; nowhere when it has let go.
    pub hand_target: Option<TrocarJoints>,
}

/// Longest internal step [s]: a hundredth of the shortest period below (2 pi sqrt(m/k) of the self-rotation is 28 ms).
const LONGEST_STEP_S: f64 = 1e-4;
/// Below this rate friction is viscous [rad/s or m/s], so that a motion at rest stays there.
const STICTION_RATE: f64 = 1e-3;

impl Mechanism {
    /// An instrument of 0.15 kg with a heart of little mass, in a hand of 400 N/m at 0.25 m above O: choices.
    pub fn new(profile: TrocarProfile, joints: TrocarJoints) -> Self {
        let tilt = MotionParameters {
            inertia: 5e-3,
            damping: 0.02,
            friction: 0.0,
            hand_stiffness: 25.0,
            hand_damping: 0.5,
        };
        let translation = MotionParameters {
            inertia: 0.15,
            damping: profile.damping_n_s_per_m,
            friction: 0.0,
            hand_stiffness: 400.0,
            hand_damping: 10.0,
        };
        let self_rotation = MotionParameters {
            inertia: 2e-5,
            damping: 2e-4,
            friction: 0.0,
            hand_stiffness: 1.0,
            hand_damping: 5e-3,
        };
        let jaw = MotionParameters {
            inertia: 0.02,
            damping: 0.5,
            friction: 0.0,
            hand_stiffness: 500.0,
            hand_damping: 3.0,
        };
        let joints = profile.within(&joints);
        Self {
            profile,
            motions: [tilt, tilt, translation, self_rotation, jaw],
            joints,
            rates: [0.0; N_AXES],
            hand_target: Some(joints),
        }
    }

    /// Lengths [m] or angles [rad] of one unit of each motion: of the jaws the handle's travel.
    fn units(&self) -> [f64; N_AXES] {
        [1.0, 1.0, 1.0, 1.0, self.profile.jaw_travel_m]
    }

    /// What the hand exerts on each motion [N or N m].
    pub fn hand_efforts(&self) -> [f64; N_AXES] {
        let Some(target) = self.hand_target else { return [0.0; N_AXES] };
        let (target, at, units) = (target.to_array(), self.joints.to_array(), self.units());
        std::array::from_fn(|i| {
            let motion = &self.motions[i];
            (motion.hand_stiffness * (target[i] - at[i]) - motion.hand_damping * self.rates[i]) * units[i]
        })
    }

    /// Moves on by `time_s` [s] under the efforts of the motors; semi-implicit Euler in equal parts. At the ends of its
    /// range a motion stops.
    pub fn advance(&mut self, motors: &AxisEfforts, time_s: f64) {
        let n_steps = (time_s / LONGEST_STEP_S).ceil().max(1.0);
        let step_s = time_s / n_steps;
        let (motors, units, ranges) = (motors.to_array(), self.units(), self.profile.ranges());
        for _ in 0..n_steps as usize {
            let hand = self.hand_efforts();
            let mut values = self.joints.to_array();
            for i in 0..N_AXES {
                let motion = &self.motions[i];
                let rate = self.rates[i] * units[i];
                let friction = motion.friction * (rate / STICTION_RATE).clamp(-1.0, 1.0);
                let effort = motors[i] + hand[i] - motion.damping * rate - friction;
                let rate = (rate + effort / motion.inertia * step_s) / units[i];
                let value = values[i] + rate * step_s;
                values[i] = value.clamp(ranges[i][0], ranges[i][1]);
                self.rates[i] = if values[i].to_bits() == value.to_bits() { rate } else { 0.0 };
            }
            self.joints = TrocarJoints::from_array(values);
        }
    }

    /// Kinetic energy [J].
    pub fn kinetic_energy_j(&self) -> f64 {
        let units = self.units();
        let energy = |i: usize| 0.5 * self.motions[i].inertia * (self.rates[i] * units[i]).powi(2);
        (0..N_AXES).map(energy).sum()
    }
}
