//! From the counts of incremental encoders (seed `000`, s. 5.4.2) to motions and their rates.
//!
//! Such an encoder counts from wherever it was switched on. Each axis has a mark at which the board notes the count; until
//! the instrument has passed it, the motion is not known ([`SensorFault::NotHomed`]). The marks stand where the motion is
//! 0: bail and ring upright, the tip in O (passed by every insertion), the self-rotation's zero, jaws closed.

use super::kinematics::{Axis, JointRates, N_AXES, TrocarJoints};
use super::profiles::TrocarProfile;

/// What the encoders say at a tick, in the order of [`Axis`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EncoderSample {
    /// Steps since they were switched on.
    pub counts: [i32; N_AXES],
    /// The count at the mark when it was last passed ...
    pub mark_counts: [i32; N_AXES],
    /// ... if it was passed.
    pub is_marked: [bool; N_AXES],
}

/// Some marks have not been passed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the marks of {} have not been passed", Names(.0))]
pub struct NotHomed(pub [bool; N_AXES]);

struct Names<'a>(&'a [bool; N_AXES]);

impl std::fmt::Display for Names<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut first = true;
        for axis in Axis::ALL.into_iter().filter(|axis| self.0[*axis as usize]) {
            write!(f, "{}{}", if first { "" } else { ", " }, axis.name())?;
            first = false;
        }
        Ok(())
    }
}

/// Why there are no motions.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SensorFault {
    /// The motions of some axes are not known yet.
    #[error(transparent)]
    NotHomed(#[from] NotHomed),
    /// The mechanism cannot be there: counts were lost or the board has another profile.
    #[error("{} is at {found}, beyond {} to {}: encoders or profile are wrong", .axis.name(), .range[0], .range[1])]
    OutOfRange {
        /// Which motion.
        axis: Axis,
        /// Where it would be, in its SI unit.
        found: f64,
        /// Where it can be.
        range: [f64; 2],
    },
}

/// Motions and their rates.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JointReading {
    /// Where they are.
    pub joints: TrocarJoints,
    /// How fast they change.
    pub rates: JointRates,
}

/// Beyond its range by more than this share of it a motion is not believed: encoders and stops have play.
const PLAY: f64 = 0.02;

/// The motions of one active trocar, tick by tick.
#[derive(Clone, Debug)]
pub struct JointReader {
    profile: TrocarProfile,
    /// Counts at the marks, as they were first passed.
    references: [Option<i32>; N_AXES],
    velocities: [VelocityEstimate; N_AXES],
}

impl JointReader {
    /// A reader that knows no mark yet.
    pub fn new(profile: TrocarProfile) -> Self {
        Self { profile, references: [None; N_AXES], velocities: [VelocityEstimate::default(); N_AXES] }
    }

    /// Forgets everything: the board was switched off, or the instrument is gone.
    pub fn forget(&mut self) {
        *self = Self::new(self.profile);
    }

    /// Forgets how fast the motions were: there is a gap before the next sample.
    pub fn forget_rates(&mut self) {
        self.velocities = [VelocityEstimate::default(); N_AXES];
    }

    /// The motions at this tick, `period_s` [s] after the last one.
    ///
    /// # Errors
    /// [`SensorFault`] when the counts do not tell where the mechanism is.
    pub fn read(&mut self, sample: &EncoderSample, period_s: f64) -> Result<JointReading, SensorFault> {
        let mut missing = [false; N_AXES];
        let (mut values, mut rates) = ([0.0; N_AXES], [0.0; N_AXES]);
        for i in 0..N_AXES {
            if !sample.is_marked[i] {
                self.references[i] = None;
                self.velocities[i] = VelocityEstimate::default();
                missing[i] = true;
                continue;
            }
            // The first passage counts: a turn later the same mark has another count and stands for the same place.
            let reference = *self.references[i].get_or_insert(sample.mark_counts[i]);
            let steps = f64::from(sample.counts[i]) - f64::from(reference);
            values[i] = steps * self.profile.resolution[i];
            rates[i] = self.velocities[i].push(steps, period_s) * self.profile.resolution[i];
        }
        if missing.contains(&true) {
            return Err(NotHomed(missing).into());
        }
        for (axis, range) in Axis::ALL.into_iter().zip(self.profile.ranges()) {
            let found = values[axis as usize];
            let play = PLAY * (range[1] - range[0]);
            // The tip comes from outside: what is behind O is known, and no place to render anything.
            let low = if axis == Axis::Insertion { -range[1] } else { range[0] - play };
            if !(low..=range[1] + play).contains(&found) {
                return Err(SensorFault::OutOfRange { axis, found, range });
            }
        }
        Ok(JointReading { joints: TrocarJoints::from_array(values), rates })
    }
}

/// Counts of an encoder at `value`, `zero_steps` [steps] being its count (not whole) at 0.
pub fn counts_at(value: f64, resolution: f64, zero_steps: f64) -> i32 {
    (value / resolution + zero_steps).floor() as i32
}

/// Samples of the longest window of a velocity.
const WINDOW: usize = 32;

/// Velocity of a counted motion: the slope over the longest window, up to 32 samples, whose straight line from end to end
/// misses no sample by more than one step. Long at rest, short when the motion changes (Janabi-Sharifi, Hayward and Chen,
/// Discrete-Time Adaptive Windowing for Velocity Estimation, IEEE Transactions on Control Systems Technology 8(6), 2000).
#[derive(Clone, Copy, Debug)]
pub struct VelocityEstimate {
    /// The last samples [steps] in a ring.
    steps: [f64; WINDOW],
    n: usize,
    next: usize,
}

impl Default for VelocityEstimate {
    fn default() -> Self {
        Self { steps: [0.0; WINDOW], n: 0, next: 0 }
    }
}

impl VelocityEstimate {
    /// Takes a sample [steps], `period_s` after the last one; the velocity [steps/s].
    pub fn push(&mut self, steps: f64, period_s: f64) -> f64 {
        self.steps[self.next] = steps;
        self.next = (self.next + 1) % WINDOW;
        self.n = (self.n + 1).min(WINDOW);
        let back = |i: usize| self.steps[(self.next + WINDOW - 1 - i) % WINDOW];
        let mut slope = 0.0;
        for length in 1..self.n {
            let candidate = (steps - back(length)) / length as f64;
            let fits = (1..length).all(|i| (back(i) - (steps - candidate * i as f64)).abs() <= 1.0);
            if !fits {
                break;
            }
            slope = candidate;
        }
        slope / period_s
    }
}
