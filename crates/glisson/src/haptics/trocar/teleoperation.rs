//! Two active trocars as leader and follower: the leader's pose drives the second one, its forces come back (seed `000`,
//! s. 5.5).
//!
//! The seed names the use and gives no law. This one is the plain bilateral coupling of positions: a spring and a damper
//! from each motion of the leader to the same motion of the follower. With scales of 1 the two efforts are opposite, so
//! the coupling stores and wastes energy and makes none, however stiff what the follower touches. Scaled motion keeps the
//! power: rates times s on one side, efforts times s on the other.

use super::kinematics::{JointRates, N_AXES, TrocarJoints};
use super::motors::{AxisLimits, Limited, Saturation};
use super::profiles::TrocarProfile;
use super::statics::AxisEfforts;

/// Spring and damper of one motion, in its SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spring {
    /// [N/m] or [N m/rad].
    pub stiffness: f64,
    /// [N s/m] or [N m s/rad].
    pub damping: f64,
}

/// One end of the coupling at a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct End {
    /// Where its motions are.
    pub joints: TrocarJoints,
    /// How fast they change.
    pub rates: JointRates,
}

/// What both devices are told.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Exchange {
    /// Efforts of the leader's motors: what the hand feels.
    pub leader: AxisEfforts,
    /// Efforts of the follower's motors: what moves the remote instrument.
    pub follower: AxisEfforts,
    /// Where the follower is told to go.
    pub target: TrocarJoints,
}

/// The coupling of a leader to a follower.
#[derive(Clone, Debug, PartialEq)]
pub struct Teleoperation {
    springs: [Spring; N_AXES],
    /// Motion of the follower for one of the leader: tilts, insertion, self-rotation; the jaws are never scaled.
    scale: f64,
    limits: AxisLimits,
    /// Where both were when they were coupled.
    origin: [TrocarJoints; 2],
    jaw_travel_m: f64,
    follower: TrocarProfile,
}

/// Springs with which two devices of 1 kHz with little friction of their own are stable: choices, tested.
const SPRINGS: [Spring; N_AXES] = [
    Spring { stiffness: 60.0, damping: 0.6 },
    Spring { stiffness: 60.0, damping: 0.6 },
    Spring { stiffness: 1500.0, damping: 15.0 },
    Spring { stiffness: 1.0, damping: 4e-3 },
    Spring { stiffness: 500.0, damping: 3.0 },
];

impl Teleoperation {
    /// Couples them where they are, `scale` [1] times the leader's motion: nothing jumps but the follower's jaws, which
    /// close or open to the leader's.
    pub fn couple(follower: TrocarProfile, ends: [&TrocarJoints; 2], scale: f64) -> Self {
        Self {
            springs: SPRINGS,
            scale,
            limits: follower.limits,
            origin: ends.map(|joints| *joints),
            jaw_travel_m: follower.jaw_travel_m,
            follower,
        }
    }

    /// With other springs, in the order of [`super::Axis`].
    #[must_use]
    pub fn with_springs(self, springs: [Spring; N_AXES]) -> Self {
        Self { springs, ..self }
    }

    /// The springs, in the order of [`super::Axis`].
    pub fn springs(&self) -> &[Spring; N_AXES] {
        &self.springs
    }

    /// One tick. The follower's target stays within its range, and the leader feels the stop.
    pub fn tick(&self, leader: &End, follower: &End) -> Exchange {
        let [from, to] = self.origin.map(TrocarJoints::to_array);
        let at = leader.joints.to_array();
        // The jaws follow as they are: scissors that close half-way are of no use.
        let scale = |i: usize| if i == N_AXES - 1 { 1.0 } else { self.scale };
        let unit = |i: usize| if i == N_AXES - 1 { self.jaw_travel_m } else { 1.0 };
        let wanted: [f64; N_AXES] = std::array::from_fn(|i| {
            let start = if i == N_AXES - 1 { 0.0 } else { to[i] };
            let moved = if i == N_AXES - 1 { at[i] } else { at[i] - from[i] };
            start + scale(i) * moved
        });
        // What the follower cannot reach is not rendered as its stop but as the spring to where it is: the same force.
        let target = TrocarJoints::from_array(wanted);
        let now = follower.joints.to_array();
        let pull: [f64; N_AXES] = std::array::from_fn(|i| {
            let spring = &self.springs[i];
            let gap = (wanted[i] - now[i]) * unit(i);
            let rate = (scale(i) * leader.rates[i] - follower.rates[i]) * unit(i);
            spring.stiffness * gap + spring.damping * rate
        });
        // The motors of both ends saturate alike: limited once, so that the efforts stay opposite.
        let wanted_efforts = AxisEfforts::from_array(pull);
        let Limited { efforts, .. } = self.limits.limit(&wanted_efforts, Saturation::EachMotor);
        let back = efforts.to_array();
        Exchange {
            leader: AxisEfforts::from_array(std::array::from_fn(|i| -scale(i) * back[i])),
            follower: efforts,
            target: self.follower.within(&target),
        }
    }
}
