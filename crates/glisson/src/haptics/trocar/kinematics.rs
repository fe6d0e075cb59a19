//! From the five motions of the active trocar to the pose of its instrument and back.
//!
//! The ring turns about e_Y by the roll b. The shell turns in the ring, about two screws that lie across, by an inner
//! angle c that nobody measures. The bail turns about e_X by the pitch a; its slot leaves the instrument free in its own
//! plane, so tan c = tan a cos b. Hence e_r = (tan b, -tan a, 1) / sqrt(1 + tan^2 a + tan^2 b): pitch and roll are
//! decoupled, each sensor tells one slope. The seed gives no such equation (s. 5.4.1 describes the parts); this one is
//! reconstructed from the description.
//!
//! Singular places: the tilt theta reaches 90 degrees only when a or b does, outside every [`super::TrocarProfile`]. The
//! azimuth phi is undefined upright; nothing here divides by sin theta. A tip in O has no direction: what is asked for it
//! keeps the direction it had.

use crate::math::{DMat3, DVec3};

/// The motions, in the order of arrays and of the board's channels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// The bail about e_X [rad].
    Pitch,
    /// The ring about e_Y [rad].
    Roll,
    /// The instrument along itself [m].
    Insertion,
    /// The instrument about itself [rad].
    SelfRotation,
    /// The handle's jaws: 0 closed, 1 wide open.
    Jaw,
}

/// How many motions there are.
pub const N_AXES: usize = 5;

impl Axis {
    /// All of them in order.
    pub const ALL: [Self; N_AXES] = [Self::Pitch, Self::Roll, Self::Insertion, Self::SelfRotation, Self::Jaw];

    /// For messages.
    pub fn name(self) -> &'static str {
        ["pitch", "roll", "insertion", "self-rotation", "jaw"][self as usize]
    }
}

/// Where the five motions are.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TrocarJoints {
    /// Turn of the bail about e_X [rad].
    pub pitch_rad: f64,
    /// Turn of the ring about e_Y [rad].
    pub roll_rad: f64,
    /// From O to the tip [m]; negative while the tip has not reached O.
    pub insertion_m: f64,
    /// Turn of the instrument about e_r, in the shell [rad].
    pub self_rotation_rad: f64,
    /// How far the handle's jaws are open: 0 closed, 1 wide open.
    pub jaw_opening: f64,
}

/// How fast the motions change, in the order of [`Axis`]: [rad/s, rad/s, m/s, rad/s, 1/s].
pub type JointRates = [f64; N_AXES];

/// Where the instrument is, in the device's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrocarPose {
    /// Its tip [m].
    pub tip_m: DVec3,
    /// Turns the instrument's axes into the device's: z is e_r, x and y turn with it.
    pub device_from_instrument: DMat3,
}

/// What the instrument does when one motion changes: its angular velocity per unit of rate, and the velocity of its body
/// along itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionAxes {
    /// Angular velocity per pitch rate.
    pub pitch: DVec3,
    /// Angular velocity per roll rate.
    pub roll: DVec3,
    /// e_r: direction of insertion, and angular velocity per rate of self-rotation.
    pub instrument: DVec3,
}

/// Tangents, sines and cosines of a pair of tilts.
struct Tilts {
    tan_pitch: f64,
    sin_roll: f64,
    cos_roll: f64,
    /// Of the inner angle c.
    sin_inner: f64,
    cos_inner: f64,
}

impl Tilts {
    fn of(joints: &TrocarJoints) -> Self {
        let tan_pitch = libm::tan(joints.pitch_rad);
        let (sin_roll, cos_roll) = libm::sincos(joints.roll_rad);
        let tan_inner = tan_pitch * cos_roll;
        let cos_inner = 1.0 / (1.0 + tan_inner * tan_inner).sqrt();
        Self { tan_pitch, sin_roll, cos_roll, sin_inner: tan_inner * cos_inner, cos_inner }
    }

    /// e_r.
    fn direction(&self) -> DVec3 {
        DVec3::new(self.sin_roll * self.cos_inner, -self.sin_inner, self.cos_roll * self.cos_inner)
    }

    /// The axis of the screws in the ring.
    fn screws(&self) -> DVec3 {
        DVec3::new(self.cos_roll, 0.0, -self.sin_roll)
    }
}

impl TrocarJoints {
    /// In the order of [`Axis`].
    pub fn to_array(self) -> [f64; N_AXES] {
        [self.pitch_rad, self.roll_rad, self.insertion_m, self.self_rotation_rad, self.jaw_opening]
    }

    /// From the order of [`Axis`].
    pub fn from_array(joints: [f64; N_AXES]) -> Self {
        let [pitch_rad, roll_rad, insertion_m, self_rotation_rad, jaw_opening] = joints;
        Self { pitch_rad, roll_rad, insertion_m, self_rotation_rad, jaw_opening }
    }

    /// e_r: unit vector from O to the tip. The tilts lie between -90 and 90 degrees.
    pub fn direction(&self) -> DVec3 {
        Tilts::of(self).direction()
    }

    /// Tilt theta from e_Z and azimuth phi about it [rad]: the seed's spherical angles. Upright phi is 0.
    pub fn spherical_rad(&self) -> [f64; 2] {
        let (x, y) = (libm::tan(self.roll_rad), -libm::tan(self.pitch_rad));
        [libm::atan((x * x + y * y).sqrt()), libm::atan2(y, x)]
    }

    /// Tip and axes of the instrument.
    pub fn pose(&self) -> TrocarPose {
        let tilts = Tilts::of(self);
        let direction = tilts.direction();
        let shell = DMat3::from_cols(tilts.screws(), direction.cross(tilts.screws()), direction);
        let (sine, cosine) = libm::sincos(self.self_rotation_rad);
        let turn = DMat3::from_cols(DVec3::new(cosine, sine, 0.0), DVec3::new(-sine, cosine, 0.0), DVec3::Z);
        TrocarPose { tip_m: direction * self.insertion_m, device_from_instrument: shell * turn }
    }

    /// What each motion does to the instrument.
    pub fn motion_axes(&self) -> MotionAxes {
        let tilts = Tilts::of(self);
        // c = atan(tan a cos b), differentiated.
        let cos2_inner = tilts.cos_inner * tilts.cos_inner;
        let by_pitch = tilts.cos_roll * (1.0 + tilts.tan_pitch * tilts.tan_pitch) * cos2_inner;
        let by_roll = -tilts.tan_pitch * tilts.sin_roll * cos2_inner;
        MotionAxes {
            pitch: tilts.screws() * by_pitch,
            roll: DVec3::Y + tilts.screws() * by_roll,
            instrument: tilts.direction(),
        }
    }

    /// Velocity of the tip [m/s] and angular velocity of the instrument [rad/s] at the rates `rates`.
    pub fn velocity(&self, rates: &JointRates) -> [DVec3; 2] {
        let axes = self.motion_axes();
        let [pitch, roll, insertion, self_rotation, _] = *rates;
        let angular = axes.pitch * pitch + axes.roll * roll + axes.instrument * self_rotation;
        let tip_m = axes.instrument * self.insertion_m;
        [angular.cross(tip_m) + axes.instrument * insertion, angular]
    }

    /// The motions that put the tip at `tip_m`, self-rotation and jaws as they are in `self`. A tip nearer to O than
    /// [`NO_DIRECTION_M`] keeps the tilts of `self`; one that is not in front of the device (z <= 0) cannot be reached.
    pub fn reaching(&self, tip_m: DVec3) -> Option<Self> {
        let insertion_m = tip_m.length();
        if insertion_m < NO_DIRECTION_M {
            return Some(Self { insertion_m: tip_m.dot(self.direction()), ..*self });
        }
        let in_front = tip_m.z > 0.0 && insertion_m.is_finite();
        in_front.then(|| Self {
            pitch_rad: libm::atan2(-tip_m.y, tip_m.z),
            roll_rad: libm::atan2(tip_m.x, tip_m.z),
            insertion_m,
            ..*self
        })
    }
}

/// A tip nearer to O than this has no direction [m]: a thousandth of the finest resolution of insertion.
pub const NO_DIRECTION_M: f64 = 5e-8;

impl TrocarPose {
    /// The motions of this pose, jaws closed; none when the instrument does not point into the body.
    pub fn joints(&self) -> Option<TrocarJoints> {
        let direction = self.device_from_instrument.z_axis;
        if direction.z <= 0.0 {
            return None;
        }
        let upright = TrocarJoints {
            pitch_rad: libm::atan2(-direction.y, direction.z),
            roll_rad: libm::atan2(direction.x, direction.z),
            insertion_m: self.tip_m.dot(direction),
            ..TrocarJoints::default()
        };
        let shell = upright.pose().device_from_instrument;
        let x = self.device_from_instrument.x_axis;
        Some(TrocarJoints {
            self_rotation_rad: libm::atan2(x.dot(shell.y_axis), x.dot(shell.x_axis)),
            ..upright
        })
    }
}
