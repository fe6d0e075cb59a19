//! A ligating loop: a loop of thread before the end of a tube, which is put over a stump and drawn tight.

use super::ToolInput;
use super::pose::ToolFrame;
use crate::math::DVec3;
use std::f64::consts::PI;

/// Sizes of a ligating loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LigatingLoop {
    /// Diameter of the open loop [m].
    pub diameter_m: f64,
    /// Diameter of its thread [m].
    pub thread_m: f64,
    /// Greatest pull on its thread [N].
    pub greatest_pull_n: f64,
}

/// An open loop: a circle that goes through the instrument's tip, in the plane in which other instruments' jaws open.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ring {
    /// Its middle [m].
    pub middle_m: DVec3,
    /// Radius [m].
    pub radius_m: f64,
    /// From the middle to the tip.
    pub to_tip: DVec3,
    /// Across, in its plane.
    pub across: DVec3,
    /// Of its plane.
    pub normal: DVec3,
}

impl LigatingLoop {
    /// Length of the thread around, open by this (0 drawn tight, 1 wide open) [m].
    pub fn length_m(&self, opening: f64) -> f64 {
        PI * self.diameter_m * opening.clamp(0.0, 1.0)
    }

    /// The loop before an instrument in this pose.
    pub fn ring(&self, pose: &ToolInput) -> Ring {
        let frame = ToolFrame::of(pose).world_from_tool;
        let radius_m = 0.5 * self.length_m(pose.jaw_opening) / PI;
        Ring {
            middle_m: pose.tip_in_world_m - frame.z_axis * radius_m,
            radius_m,
            to_tip: frame.z_axis,
            across: frame.x_axis,
            normal: frame.y_axis,
        }
    }
}

impl Ring {
    /// A place in its plane, from its middle: towards the tip, and across [m].
    pub fn in_plane_m(&self, point_m: DVec3) -> [f64; 2] {
        let from_middle_m = point_m - self.middle_m;
        [from_middle_m.dot(self.to_tip), from_middle_m.dot(self.across)]
    }

    /// The place on it at a share of the way around, from the tip [m].
    pub fn point_m(&self, share: f64) -> DVec3 {
        let (sine, cosine) = libm::sincos(2.0 * PI * share);
        self.middle_m + (self.to_tip * cosine + self.across * sine) * self.radius_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_open_loop_is_a_circle_through_the_tip() {
        let of = LigatingLoop { diameter_m: 0.03, thread_m: 3e-4, greatest_pull_n: 2.0 };
        let tip_m = DVec3::new(0.1, 0.2, 0.3);
        let pose = ToolInput { jaw_opening: 0.5, roll_rad: 0.7, ..ToolInput::at(tip_m, DVec3::Y) };
        let ring = of.ring(&pose);
        assert!(ring.point_m(0.0).distance(tip_m) < 1e-15 && (ring.radius_m - 7.5e-3).abs() < 1e-15);
        let n = 1000;
        let around = |i: usize| ring.point_m(i as f64 / n as f64);
        let length_m: f64 = (0..n).map(|i| around(i).distance(around(i + 1))).sum();
        assert!((length_m / of.length_m(0.5) - 1.0).abs() < 1e-5);
        for i in 0..n {
            let [x_m, y_m] = ring.in_plane_m(around(i));
            assert!((x_m.hypot(y_m) - ring.radius_m).abs() < 1e-15);
            assert!((around(i) - ring.middle_m).dot(ring.normal).abs() < 1e-15);
        }
        // Before the tip, away from the handle.
        assert!((tip_m - ring.middle_m).dot(DVec3::Y) > 0.0);
    }
}
