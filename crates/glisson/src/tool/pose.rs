//! The frame of an instrument: its tip, the direction of its shaft, the plane in which its jaws open.

use super::{Jaws, ToolInput};
use crate::math::{DMat3, DVec3, cross_matrix};

/// Where the axes of a tool point: x the way its jaws open, y along their hinge, z towards the handle.
///
/// Without roll the frame comes from that of a shaft that points to the front (-y of the patient) by the shortest turn:
/// it is continuous but for a shaft that points to the back of a patient who lies on it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolFrame {
    /// Turns tool axes into world axes.
    pub world_from_tool: DMat3,
    /// Centre of the tip [m].
    pub tip_in_world_m: DVec3,
}

/// Tool axes of a shaft that points to the front: x to the left, y to the head, z to the front.
const FRONT: DMat3 = DMat3::from_cols(DVec3::X, DVec3::Z, DVec3::NEG_Y);

impl ToolFrame {
    /// The frame of a pose.
    pub fn of(input: &ToolInput) -> Self {
        let (sine, cosine) = libm::sincos(input.roll_rad);
        let roll = DMat3::from_cols(DVec3::new(cosine, sine, 0.0), DVec3::new(-sine, cosine, 0.0), DVec3::Z);
        Self {
            world_from_tool: shortest_turn(FRONT.z_axis, input.shaft_in_world) * FRONT * roll,
            tip_in_world_m: input.tip_in_world_m,
        }
    }

    /// A point of the tool in the world [m].
    pub fn to_world_m(&self, in_tool_m: DVec3) -> DVec3 {
        self.world_from_tool * in_tool_m + self.tip_in_world_m
    }

    /// A point of the world in the tool's frame [m].
    pub fn to_tool_m(&self, in_world_m: DVec3) -> DVec3 {
        self.world_from_tool.transpose() * (in_world_m - self.tip_in_world_m)
    }
}

/// The turn by a rotation vector [rad] (Rodrigues' formula).
pub fn turn_by(rotation_rad: DVec3) -> DMat3 {
    let angle_rad = rotation_rad.length();
    let axis = rotation_rad.normalize_or_zero();
    let (sine, cosine) = libm::sincos(angle_rad);
    let cross = cross_matrix(axis);
    DMat3::IDENTITY + cross * sine + cross * cross * (1.0 - cosine)
}

/// The rotation vector of a turn [rad], of length pi at most.
pub fn rotation_vector_rad(turn: &DMat3) -> DVec3 {
    let trace = turn.x_axis.x + turn.y_axis.y + turn.z_axis.z;
    let skew = DVec3::new(
        turn.y_axis.z - turn.z_axis.y,
        turn.z_axis.x - turn.x_axis.z,
        turn.x_axis.y - turn.y_axis.x,
    );
    let angle_rad = libm::atan2(skew.length(), trace - 1.0);
    if skew.length() > HALF_TURN || trace > 1.0 {
        return skew.normalize_or_zero() * angle_rad;
    }
    // Half a turn: the axis is what it leaves as it is.
    let both = *turn + DMat3::IDENTITY;
    let axes = [both.x_axis, both.y_axis, both.z_axis];
    let longest = axes.into_iter().max_by(|a, b| a.length_squared().total_cmp(&b.length_squared()));
    longest.unwrap_or(DVec3::Z).normalize_or_zero() * angle_rad
}

/// Twice the sine of an angle below which a turn is none, or half of one.
const HALF_TURN: f64 = 1e-9;

impl ToolInput {
    /// The same with the instrument turned about its tip by a rotation vector [rad].
    #[must_use]
    pub fn turned(self, rotation_rad: DVec3) -> Self {
        let wanted = turn_by(rotation_rad) * ToolFrame::of(&self).world_from_tool;
        let shaft_in_world = wanted.z_axis.normalize_or(self.shaft_in_world);
        let without_roll = ToolFrame::of(&Self { shaft_in_world, roll_rad: 0.0, ..self }).world_from_tool;
        let across = without_roll.transpose() * wanted.x_axis;
        let roll_rad = libm::atan2(across.y, across.x);
        // As many whole turns as it had.
        let turns = libm::round((self.roll_rad - roll_rad) / TURN_RAD);
        Self { shaft_in_world, roll_rad: roll_rad + turns * TURN_RAD, ..self }
    }
}

/// A whole turn [rad].
const TURN_RAD: f64 = 2.0 * std::f64::consts::PI;

/// The shortest turn that brings the unit vector `from` to `to` (Rodrigues' formula without angles).
fn shortest_turn(from: DVec3, to: DVec3) -> DMat3 {
    let cosine = from.dot(to);
    // Opposite vectors have no shortest turn; half a turn about any perpendicular axis serves.
    if cosine < -1.0 + 1e-12 {
        let axis = from.any_orthonormal_vector();
        let outer = DMat3::from_cols(axis * axis.x, axis * axis.y, axis * axis.z);
        return outer * 2.0 - DMat3::IDENTITY;
    }
    let cross = cross_matrix(from.cross(to));
    DMat3::IDENTITY + cross + cross * cross * (1.0 / (1.0 + cosine))
}

impl Jaws {
    /// Angle between the jaws [rad].
    pub fn opening_rad(&self, jaw_opening: f64) -> f64 {
        self.greatest_opening_rad * jaw_opening.clamp(0.0, 1.0)
    }

    /// The hinge in the tool's frame [m].
    pub fn hinge_in_tool_m(&self) -> DVec3 {
        DVec3::Z * self.length_m
    }

    /// Ends of the two jaws in the tool's frame [m].
    pub fn ends_in_tool_m(&self, jaw_opening: f64) -> [DVec3; 2] {
        [0.0, 1.0].map(|share| self.between_ends_in_tool_m(jaw_opening, share))
    }

    /// Where the end of a jaw is in the tool's frame [m] on its way from the one (0) to the other (1).
    pub fn between_ends_in_tool_m(&self, jaw_opening: f64, share: f64) -> DVec3 {
        let (sine, cosine) = libm::sincos((0.5 - share) * self.opening_rad(jaw_opening));
        self.hinge_in_tool_m() + DVec3::new(sine, 0.0, -cosine) * self.length_m
    }

    /// Whether a point of the tool's frame lies between jaws that are open by `jaw_opening`, or no further from there
    /// than `margin_m`.
    pub fn are_around(&self, in_tool_m: DVec3, jaw_opening: f64, margin_m: f64) -> bool {
        let from_hinge_m = in_tool_m - self.hinge_in_tool_m();
        let (sine, cosine) = libm::sincos(0.5 * self.opening_rad(jaw_opening));
        let along_m = -from_hinge_m.z;
        let side_m = from_hinge_m.x.abs();
        let beyond_jaw_m = side_m * cosine - along_m * sine;
        let within_length =
            along_m >= -margin_m && (along_m * along_m + side_m * side_m).sqrt() <= self.length_m + margin_m;
        within_length && from_hinge_m.y.abs() <= 0.5 * self.width_m + margin_m && beyond_jaw_m <= margin_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::SeededRandom;

    fn is_turn(m: &DMat3) -> bool {
        let off = *m * m.transpose() - DMat3::IDENTITY;
        (0..3).all(|i| off.col(i).length() < 1e-12) && (m.determinant() - 1.0).abs() < 1e-12
    }

    #[test]
    fn a_frame_is_a_turn_whose_z_is_the_shaft() {
        let mut random = SeededRandom::new(5);
        let mut directions = vec![DVec3::NEG_Y, DVec3::Y, DVec3::X, DVec3::NEG_Z];
        directions.extend(
            (0..200).map(|_| DVec3::new(random.normal(), random.normal(), random.normal()).normalize()),
        );
        for shaft in directions {
            let roll_rad = random.uniform_in(-4.0, 4.0);
            let frame = ToolFrame::of(&ToolInput { roll_rad, ..ToolInput::at(DVec3::ONE, shaft) });
            assert!(is_turn(&frame.world_from_tool), "{shaft}");
            assert!(frame.world_from_tool.z_axis.distance(shaft) < 1e-7, "{shaft}");
            let p = DVec3::new(1.0, 2.0, 3.0);
            assert!(frame.to_world_m(frame.to_tool_m(p)).distance(p) < 1e-12);
        }
    }

    #[test]
    fn a_turned_pose_has_the_turned_frame_and_its_whole_turns_of_roll() {
        let mut random = SeededRandom::new(11);
        for _ in 0..500 {
            let mut unit = || DVec3::new(random.normal(), random.normal(), random.normal()).normalize();
            let (shaft, axis) = (unit(), unit());
            let roll_rad = random.uniform_in(-9.0, 9.0);
            let pose = ToolInput { roll_rad, ..ToolInput::at(DVec3::ONE, shaft) };
            let by_rad = axis * random.uniform_in(0.0, 3.1);
            let turned = pose.turned(by_rad);
            let (before, after) =
                (ToolFrame::of(&pose).world_from_tool, ToolFrame::of(&turned).world_from_tool);
            let off = after - turn_by(by_rad) * before;
            assert!((0..3).all(|i| off.col(i).length() < 1e-9), "{shaft} {by_rad}");
            assert!(rotation_vector_rad(&(after * before.transpose())).distance(by_rad) < 1e-6);
            assert!((turned.roll_rad - pose.roll_rad).abs() <= 3.2, "{} {}", pose.roll_rad, turned.roll_rad);
        }
        for axis in [DVec3::X, DVec3::Y, DVec3::Z, DVec3::new(1.0, 2.0, -2.0) / 3.0] {
            let half = rotation_vector_rad(&turn_by(axis * std::f64::consts::PI));
            assert!((half.length() - std::f64::consts::PI).abs() < 1e-9 && half.cross(axis).length() < 1e-6);
            for angle_rad in [0.0, 1e-12, 1e-8, 1e-3, 3.1] {
                let found = rotation_vector_rad(&turn_by(axis * angle_rad));
                assert!(found.distance(axis * angle_rad) < 1e-12 + 1e-9 * angle_rad, "{axis} {angle_rad}");
            }
        }
    }

    #[test]
    fn jaws_hold_what_is_between_them() {
        let jaws = Jaws { length_m: 0.02, width_m: 4e-3, greatest_opening_rad: 1.0, closing_force_n: 5.0 };
        let [left, right] = jaws.ends_in_tool_m(1.0);
        assert!((left.x + right.x).abs() < 1e-15 && left.x > 9e-3);
        let ends = jaws.ends_in_tool_m(0.0);
        assert!(ends.iter().all(|end| end.length() < 1e-15), "closed jaws end at the tip");
        let mid = |opening: f64, share: f64| jaws.ends_in_tool_m(opening)[0] * share;
        assert!(jaws.are_around(mid(1.0, 0.5), 1.0, 0.0));
        assert!(!jaws.are_around(mid(1.0, 0.5), 0.2, 0.0));
        assert!(!jaws.are_around(DVec3::new(0.0, 3e-3, 0.0), 1.0, 0.0));
        assert!(!jaws.are_around(DVec3::new(0.0, 0.0, -1e-3), 1.0, 0.0), "beyond the ends");
        assert!(!jaws.are_around(DVec3::new(0.0, 0.0, 0.021), 1.0, 0.0), "behind the hinge");
        assert!(jaws.are_around(DVec3::new(0.0, 0.0, -1e-3), 1.0, 2e-3));
    }
}
