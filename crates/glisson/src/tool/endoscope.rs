//! What an endoscope sees: its eye at the tip of the shaft, and what lies before it.
//!
//! The direction of view makes the view angle `a` with the way out of the tip. In the tool's frame ([`ToolFrame`]: z towards the
//! handle, y along the hinge), rolled by `r`:
//!
//! ```text
//! forward = turn(y, a) (-z)
//! up      = turn(y, a) y0      y0: where y would be without roll
//! ```
//!
//! Roll leads the direction of view around the shaft and the picture stays upright, as when a hand turns an oblique laparoscope and
//! holds its camera still. With a view angle of zero, roll changes nothing.
//!
//! View angles of laparoscopes are 0 to 90 degrees, usually 0 or 30. A field of view of 80 degrees at a view angle of 30: S. Zhang,
//! Q. Wang, X. Zhi, Y. Huang, "Optical Design of Rigid Endoscope with 30° Viewing Angle", Acta Optica Sinica 38(2), 0222002 (2018),
//! table 1.

use super::pose::ToolFrame;
use super::{Optics, ToolInput};
use crate::math::DVec3;

/// Where an endoscope looks from and to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Eye {
    /// Where it is [m].
    pub position_in_world_m: DVec3,
    /// Unit vector of the direction of view.
    pub forward_in_world: DVec3,
    /// Unit vector of the picture's upper side, at right angles to the direction of view.
    pub up_in_world: DVec3,
    /// Full angle of the cone that is seen [rad].
    pub field_of_view_rad: f64,
}

/// What is further away is too dark to count as seen [m]: a choice, more than from the navel to the diaphragm.
pub const SEEN_UP_TO_M: f64 = 0.3;

impl Eye {
    /// The eye of an endoscope that is held so.
    pub fn of(pose: &ToolInput, optics: &Optics) -> Self {
        let unrolled = ToolFrame::of(&ToolInput { roll_rad: 0.0, ..*pose }).world_from_tool;
        let (sine, cosine) = libm::sincos(optics.view_angle_rad);
        let (sine_of_roll, cosine_of_roll) = libm::sincos(pose.roll_rad);
        let across = unrolled.x_axis * cosine_of_roll + unrolled.y_axis * sine_of_roll;
        let hinge = unrolled.y_axis * cosine_of_roll - unrolled.x_axis * sine_of_roll;
        let along = unrolled.z_axis;
        Self {
            position_in_world_m: pose.tip_in_world_m,
            forward_in_world: -along * cosine - across * sine,
            up_in_world: hinge * cosine_of_roll + (across * cosine - along * sine) * sine_of_roll,
            field_of_view_rad: optics.field_of_view_rad,
        }
    }

    /// Angle between the direction of view and that to a point [m], 0 to pi [rad].
    pub fn off_middle_rad(&self, point_in_world_m: DVec3) -> f64 {
        let to_point_m = point_in_world_m - self.position_in_world_m;
        libm::atan2(to_point_m.cross(self.forward_in_world).length(), to_point_m.dot(self.forward_in_world))
    }

    /// Whether a point [m] lies in the cone that is seen, no further away than [`SEEN_UP_TO_M`]. Nothing hides it.
    pub fn sees(&self, point_in_world_m: DVec3) -> bool {
        let away_m = point_in_world_m.distance(self.position_in_world_m);
        away_m > 0.0
            && away_m <= SEEN_UP_TO_M
            && self.off_middle_rad(point_in_world_m) <= 0.5 * self.field_of_view_rad
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::SeededRandom;
    use std::f64::consts::PI;

    fn optics(view_angle_rad: f64) -> Optics {
        Optics { view_angle_rad, field_of_view_rad: 70.0_f64.to_radians() }
    }

    fn rolled(shaft: DVec3, roll_rad: f64) -> ToolInput {
        ToolInput { roll_rad, ..ToolInput::at(DVec3::new(0.01, -0.02, 0.03), shaft) }
    }

    fn unit(random: &mut SeededRandom) -> DVec3 {
        DVec3::new(random.normal(), random.normal(), random.normal()).normalize()
    }

    #[test]
    fn the_direction_of_view_makes_its_angle_with_the_shaft_for_any_roll() {
        let mut random = SeededRandom::new(3);
        for degrees in [0.0_f64, 30.0, 45.0, 90.0] {
            for _ in 0..200 {
                let shaft = unit(&mut random);
                let eye =
                    Eye::of(&rolled(shaft, random.uniform_in(-9.0, 9.0)), &optics(degrees.to_radians()));
                let angle = eye.forward_in_world.angle_between(-shaft).to_degrees();
                assert!((angle - degrees).abs() < 1e-5, "{degrees} {angle} {shaft}");
                let (forward, up) = (eye.forward_in_world, eye.up_in_world);
                assert!((forward.length() - 1.0).abs() < 1e-12 && (up.length() - 1.0).abs() < 1e-12);
                assert!(forward.dot(up).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn without_an_angle_it_looks_along_the_shaft_and_roll_changes_nothing() {
        let shaft = DVec3::new(0.2, -0.7, -0.4).normalize();
        let eye = Eye::of(&rolled(shaft, 0.0), &optics(0.0));
        assert!(eye.forward_in_world.distance(-shaft) < 1e-12);
        let other = Eye::of(&rolled(shaft, 1.3), &optics(0.0));
        assert!(other.up_in_world.distance(eye.up_in_world) < 1e-12);
    }

    #[test]
    fn without_roll_the_picture_is_upright() {
        // From the front the patient's head is up, from the feet the front.
        for (shaft, up) in [(DVec3::NEG_Y, DVec3::Z), (DVec3::NEG_Z, DVec3::NEG_Y)] {
            for view_angle_rad in [0.0, 0.5] {
                let eye = Eye::of(&rolled(shaft, 0.0), &optics(view_angle_rad));
                assert!(eye.up_in_world.distance(up) < 1e-12, "{shaft}");
            }
        }
    }

    #[test]
    fn half_a_turn_of_roll_looks_to_the_other_side() {
        let angle_rad = 30.0_f64.to_radians();
        let across = |roll_rad: f64| {
            Eye::of(&rolled(DVec3::NEG_Z, roll_rad), &optics(angle_rad)).forward_in_world
                - DVec3::Z * angle_rad.cos()
        };
        for roll_rad in [0.0, 0.7, 2.0] {
            assert!(across(roll_rad).distance(-across(roll_rad + PI)) < 1e-12);
            assert!((across(roll_rad).length() - angle_rad.sin()).abs() < 1e-12);
        }
        // A quarter of a turn from the feet: it looks down, to the patient's back.
        assert!(across(0.5 * PI).distance(DVec3::Y * angle_rad.sin()) < 1e-12);
    }

    #[test]
    fn a_small_motion_is_a_small_change_of_the_picture() {
        let mut random = SeededRandom::new(8);
        for _ in 0..500 {
            let (mut shaft, roll_rad) = (unit(&mut random), random.uniform_in(-4.0, 4.0));
            // But for a shaft to the back of the patient, as of any frame of a tool.
            shaft.y = -shaft.y.abs();
            let lens = optics(random.uniform_in(0.0, 0.5 * PI));
            let near = (shaft + unit(&mut random) * 1e-6).normalize();
            let (a, b) =
                (Eye::of(&rolled(shaft, roll_rad), &lens), Eye::of(&rolled(near, roll_rad + 1e-6), &lens));
            assert!(a.forward_in_world.distance(b.forward_in_world) < 1e-5);
            assert!(a.up_in_world.distance(b.up_in_world) < 1e-5);
        }
    }

    #[test]
    fn it_sees_what_is_in_its_cone() {
        let eye = Eye::of(&rolled(DVec3::NEG_Y, 0.4), &optics(0.5));
        let right = eye.forward_in_world.cross(eye.up_in_world);
        let at = |degrees: f64, distance_m: f64| {
            let (sine, cosine) = degrees.to_radians().sin_cos();
            eye.position_in_world_m + (eye.forward_in_world * cosine + right * sine) * distance_m
        };
        assert!(eye.sees(at(0.0, 0.1)) && eye.sees(at(34.9, 0.1)) && eye.sees(at(-34.9, 0.1)));
        assert!(!eye.sees(at(35.1, 0.1)) && !eye.sees(at(180.0, 0.1)));
        assert!(eye.sees(at(0.0, 0.299)) && !eye.sees(at(0.0, 0.301)));
        assert!(!eye.sees(eye.position_in_world_m));
    }

    /// Recorded numbers, with which the page's test compares its own (`web/test/endoscope.test.ts`).
    #[test]
    fn the_page_has_the_same_geometry() {
        let shaft = DVec3::new(0.3, -0.8, -0.5).normalize();
        let cases = [
            (
                0.0,
                0.0,
                [-0.3030457633656632, 0.8081220356417687, 0.5050762722761053],
                [0.08465204309921971, -0.5050762722761053, 0.8589132615013004],
            ),
            (
                0.5,
                0.0,
                [-0.7210226051745916, 0.5639059280352615, 0.4026617776173143],
                [0.08465204309921971, -0.5050762722761053, 0.8589132615013004],
            ),
            (
                0.5,
                0.9,
                [-0.5806176033364094, 0.8085612541461186, 0.09545625694285231],
                [-0.0920949438631945, -0.18171342720432218, 0.9790294948000772],
            ),
            (
                0.5,
                -2.4,
                [0.09703494951642755, 0.652767154132179, 0.7513183486768578],
                [0.1201835658523856, -0.7570417711566373, 0.6422177724285016],
            ),
            (
                1.2,
                3.6,
                [0.7184653262279049, 0.3378022812128164, 0.6080272969329974],
                [-0.04111395459587447, -0.8519985837804325, 0.5219272516104382],
            ),
        ];
        for (view_angle_rad, roll_rad, forward, up) in cases {
            let eye = Eye::of(&rolled(shaft, roll_rad), &optics(view_angle_rad));
            assert!(eye.forward_in_world.distance(DVec3::from_array(forward)) < 1e-14, "{eye:?}");
            assert!(eye.up_in_world.distance(DVec3::from_array(up)) < 1e-14, "{eye:?}");
        }
    }
}
