//! From the efforts of the axes to the torques of their motors, within what these can exert.
//!
//! Equations (5.8) to (5.10) of seed `000`: rollers drive the square sheath by friction, a gear the self-rotation; bail
//! and ring are driven directly. The efficiencies are those of a motor that drives; the seed uses them whatever the
//! direction of the motion, and so do we.

use super::kinematics::N_AXES;
use super::statics::AxisEfforts;

/// Between motors and axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transmission {
    /// Radius of the rollers on the sheath [m].
    pub roller_radius_m: f64,
    /// Share of their force that reaches the instrument (0.7, s. 5.4.4).
    pub roller_efficiency: f64,
    /// Turns of the motor for one turn of the instrument about itself.
    pub gear_ratio: f64,
    /// Share of the torque that passes (0.95 to 0.98, s. 5.4.4).
    pub gear_efficiency: f64,
    /// Lever of the motor on the handle's jaws [m].
    pub jaw_lever_m: f64,
}

/// Torque of each motor [N m], in the order of [`super::Axis`].
pub type MotorTorques = [f64; N_AXES];

/// Greatest effort of each axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisLimits {
    /// Pitch and roll, each [N m].
    pub tilt_n_m: f64,
    /// Along the instrument [N].
    pub translation_n: f64,
    /// About the instrument [N m].
    pub self_rotation_n_m: f64,
    /// At the handle's jaws [N].
    pub jaw_n: f64,
}

/// What happens to efforts beyond the limits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Saturation {
    /// Each motor stops at its own limit, as amplifiers do: the direction of the force changes.
    #[default]
    EachMotor,
    /// The four motors of the instrument give way together: the force is smaller and points the same way.
    KeepDirection,
}

/// Efforts within the limits.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Limited {
    /// What the axes exert.
    pub efforts: AxisEfforts,
    /// Which axes are at their limit, in the order of [`super::Axis`].
    pub is_limited: [bool; N_AXES],
}

impl AxisLimits {
    /// In the order of [`super::Axis`].
    pub fn to_array(self) -> [f64; N_AXES] {
        [self.tilt_n_m, self.tilt_n_m, self.translation_n, self.self_rotation_n_m, self.jaw_n]
    }

    /// `wanted` within the limits. An effort that is not finite counts as 0: a motor that is told nonsense rests.
    pub fn limit(&self, wanted: &AxisEfforts, saturation: Saturation) -> Limited {
        let limits = self.to_array();
        let mut efforts = wanted.to_array().map(|effort| if effort.is_finite() { effort } else { 0.0 });
        let is_limited = std::array::from_fn(|i| efforts[i].abs() > limits[i]);
        if saturation == Saturation::KeepDirection {
            let of_instrument = 0..N_AXES - 1;
            let largest = of_instrument.clone().map(|i| efforts[i].abs() / limits[i]).fold(1.0, f64::max);
            for i in of_instrument {
                efforts[i] /= largest;
            }
        }
        for (effort, limit) in efforts.iter_mut().zip(limits) {
            *effort = effort.clamp(-limit, limit);
        }
        Limited { efforts: AxisEfforts::from_array(efforts), is_limited }
    }
}

impl Transmission {
    /// Efforts of the axes over the torques of their motors: [1, 1, 1/m, 1, 1/m].
    fn ratios(&self) -> [f64; N_AXES] {
        let translation = self.roller_efficiency / self.roller_radius_m;
        [1.0, 1.0, translation, self.gear_ratio * self.gear_efficiency, 1.0 / self.jaw_lever_m]
    }

    /// (5.8) to (5.10): what the motors have to exert for `efforts` at the axes.
    pub fn motor_torques_n_m(&self, efforts: &AxisEfforts) -> MotorTorques {
        let (efforts, ratios) = (efforts.to_array(), self.ratios());
        std::array::from_fn(|i| efforts[i] / ratios[i])
    }

    /// The efforts that motors with these torques exert at the axes.
    pub fn efforts(&self, motor_torques_n_m: &MotorTorques) -> AxisEfforts {
        let ratios = self.ratios();
        AxisEfforts::from_array(std::array::from_fn(|i| motor_torques_n_m[i] * ratios[i]))
    }

    /// Torques of the motors at the limits of the axes: the full scale of the analog outputs.
    pub fn full_scale_n_m(&self, limits: &AxisLimits) -> MotorTorques {
        self.motor_torques_n_m(&AxisEfforts::from_array(limits.to_array()))
    }
}

/// Full scale of an analog output: the largest whole number of 16 bits that has a negative.
pub const ANALOG_FULL_SCALE: i16 = i16::MAX;

/// Analog outputs for torques, nearest step; beyond the full scale the outermost one.
pub fn analog_outputs(torques_n_m: &MotorTorques, full_scale_n_m: &MotorTorques) -> [i16; N_AXES] {
    std::array::from_fn(|i| {
        let share = (torques_n_m[i] / full_scale_n_m[i]).clamp(-1.0, 1.0);
        // `as` makes 0 of what is not a number.
        (share * f64::from(ANALOG_FULL_SCALE)).round() as i16
    })
}

/// Torques that analog outputs stand for [N m].
pub fn torques_of_outputs(outputs: &[i16; N_AXES], full_scale_n_m: &MotorTorques) -> MotorTorques {
    std::array::from_fn(|i| f64::from(outputs[i]) / f64::from(ANALOG_FULL_SCALE) * full_scale_n_m[i])
}
