//! What the five axes have to exert so that the hand feels a force on the instrument.
//!
//! Two mappings. [`Mapping::Thesis`]: equations (5.1) and (5.6), (5.7) of seed `000`. The moment about O is divided among
//! couples about e_X, e_Y (fixed) and e_r: C_r e_r + C_X e_X + C_Y e_Y = M_O. [`Mapping::VirtualWork`]: the torque of each
//! motor is the power of the force per unit of the motor's rate, tau_i = M_O . w_i, with the angular velocities w_i that
//! the bail, the ring and the gear give the instrument ([`super::kinematics::MotionAxes`]).
//!
//! They agree upright and differ when the instrument is tilted, because (5.6) supposes that bail and ring pass pure couples
//! about fixed axes. A slot and a pair of screws cannot: they leave the instrument's own axis free, so only the
//! self-rotation motor exerts a moment about e_r. A point force on the axis has no such moment, yet (5.6) commands
//! C_r = M_Z / cos theta, and corrects pitch and roll by what that couple would add: by 1 / cos^2 b in pitch when only the
//! roll b is not zero. [`felt`] tells what an ideal mechanism passes to the hand.

use super::kinematics::TrocarJoints;
use crate::math::{DMat3, DVec3};

/// A force at a point of the instrument, from the tissue.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ContactForce {
    /// Where it acts [m], from O.
    pub point_m: DVec3,
    /// Force [N].
    pub force_n: DVec3,
    /// Couple that is passed there beside it [N m]: zero for a point contact.
    pub torque_n_m: DVec3,
}

/// Force and moment about O.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wrench {
    /// Resultant force [N].
    pub force_n: DVec3,
    /// Moment about O [N m].
    pub moment_n_m: DVec3,
}

impl Wrench {
    /// The sum of contacts: (5.1) for each, then added (seed `000`, s. 5.4.4).
    pub fn of(contacts: &[ContactForce]) -> Self {
        contacts.iter().fold(Self::default(), |sum, contact| Self {
            force_n: sum.force_n + contact.force_n,
            moment_n_m: sum.moment_n_m + contact.point_m.cross(contact.force_n) + contact.torque_n_m,
        })
    }
}

/// Effort at each axis, on the instrument.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AxisEfforts {
    /// About e_X [N m].
    pub pitch_n_m: f64,
    /// About e_Y [N m].
    pub roll_n_m: f64,
    /// Along e_r [N].
    pub translation_n: f64,
    /// About e_r [N m].
    pub self_rotation_n_m: f64,
    /// Force that opens the handle's jaws [N].
    pub jaw_n: f64,
}

impl AxisEfforts {
    /// In the order of [`super::Axis`].
    pub fn to_array(self) -> [f64; 5] {
        [self.pitch_n_m, self.roll_n_m, self.translation_n, self.self_rotation_n_m, self.jaw_n]
    }

    /// From the order of [`super::Axis`].
    pub fn from_array(efforts: [f64; 5]) -> Self {
        let [pitch_n_m, roll_n_m, translation_n, self_rotation_n_m, jaw_n] = efforts;
        Self { pitch_n_m, roll_n_m, translation_n, self_rotation_n_m, jaw_n }
    }
}

/// How a wrench becomes efforts of the axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mapping {
    /// Equations (5.6) and (5.7) as published.
    #[default]
    Thesis,
    /// By virtual work: exact on a mechanism without friction.
    VirtualWork,
}

/// Least cosine of the tilt that (5.6) divides by: 85 degrees. No profile reaches it (75.6 degrees at most).
pub const LEAST_COS_TILT: f64 = 0.087_155_742_747_658_17;

/// A moment as couples about e_X, e_Y and e_r.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MomentShares {
    /// C_X [N m].
    pub about_x_n_m: f64,
    /// C_Y [N m].
    pub about_y_n_m: f64,
    /// C_r [N m].
    pub about_instrument_n_m: f64,
}

impl MomentShares {
    /// (5.6) for an instrument along `direction` (unit vector, z > 0).
    ///
    /// cos phi tan theta = e_r.x / e_r.z, sin phi tan theta = e_r.y / e_r.z, so no angle is needed and the upright
    /// instrument, which has no azimuth, is a place like others. Beyond 85 degrees of tilt the cosine stays at
    /// [`LEAST_COS_TILT`]: the shares stay finite and no longer add up to the moment.
    pub fn of(moment_n_m: DVec3, direction: DVec3) -> Self {
        let cos_tilt = direction.z.max(LEAST_COS_TILT);
        let about_instrument_n_m = moment_n_m.z / cos_tilt;
        Self {
            about_x_n_m: moment_n_m.x - about_instrument_n_m * direction.x,
            about_y_n_m: moment_n_m.y - about_instrument_n_m * direction.y,
            about_instrument_n_m,
        }
    }

    /// The moment that the three couples make together [N m].
    pub fn sum_n_m(&self, direction: DVec3) -> DVec3 {
        direction * self.about_instrument_n_m + DVec3::X * self.about_x_n_m + DVec3::Y * self.about_y_n_m
    }
}

/// Efforts that render `wrench` on an instrument at `joints`; `jaw_n` goes to the jaws as it is.
pub fn efforts(mapping: Mapping, joints: &TrocarJoints, wrench: &Wrench, jaw_n: f64) -> AxisEfforts {
    let axes = joints.motion_axes();
    // (5.7): the sheath takes the rest of the force.
    let translation_n = wrench.force_n.dot(axes.instrument);
    match mapping {
        Mapping::Thesis => {
            let shares = MomentShares::of(wrench.moment_n_m, axes.instrument);
            AxisEfforts {
                pitch_n_m: shares.about_x_n_m,
                roll_n_m: shares.about_y_n_m,
                translation_n,
                self_rotation_n_m: shares.about_instrument_n_m,
                jaw_n,
            }
        }
        Mapping::VirtualWork => AxisEfforts {
            pitch_n_m: wrench.moment_n_m.dot(axes.pitch),
            roll_n_m: wrench.moment_n_m.dot(axes.roll),
            translation_n,
            self_rotation_n_m: wrench.moment_n_m.dot(axes.instrument),
            jaw_n,
        },
    }
}

/// What an ideal mechanism passes to the instrument when its axes exert `efforts`: the axial force, and the moment M
/// about O with M . w_i = tau_i for every motor. Its inverse is [`efforts`] by virtual work, up to the part of the force
/// across the instrument, which the sheath carries: it is told as the force at the tip that has this moment.
pub fn felt(joints: &TrocarJoints, efforts: &AxisEfforts) -> Wrench {
    let axes = joints.motion_axes();
    let rows = DMat3::from_cols(axes.pitch, axes.roll, axes.instrument).transpose();
    let torques_n_m = DVec3::new(efforts.pitch_n_m, efforts.roll_n_m, efforts.self_rotation_n_m);
    let moment_n_m = rows.inverse() * torques_n_m;
    let lever_m = joints.insertion_m;
    let across_n = if lever_m.abs() < super::kinematics::NO_DIRECTION_M {
        DVec3::ZERO
    } else {
        moment_n_m.cross(axes.instrument) / lever_m
    };
    Wrench { force_n: axes.instrument * efforts.translation_n + across_n, moment_n_m }
}
