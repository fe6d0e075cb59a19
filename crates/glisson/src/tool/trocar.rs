//! A trocar's four degrees of freedom: what a device at a trocar measures, and the pose that it stands for.
//!
//! Pitch and yaw turn the shaft about the pivot, insertion slides it, roll turns it about itself: the four motions of the
//! thesis' active trocar (seed `000`, s. 5.2).

use super::ToolInput;
use super::pose::ToolFrame;
use crate::contact::shapes::TrocarPose;
use crate::math::DVec3;

/// Motion of an instrument in its trocar.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TrocarInput {
    /// Turn of the shaft about the x axis of the trocar [rad].
    pub pitch_rad: f64,
    /// Turn of the pitched shaft about the y axis of the trocar [rad].
    pub yaw_rad: f64,
    /// Depth of the tip below the pivot [m]; negative outside.
    pub insertion_m: f64,
    /// Turn about the shaft [rad].
    pub roll_rad: f64,
}

/// A hole in the abdominal wall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trocar {
    /// The point that the shaft goes through [m].
    pub pivot_m: DVec3,
    /// Unit vector from the pivot outwards: the shaft of an instrument without pitch and yaw. Its axes x and y are those
    /// of a tool's frame there.
    pub outward: DVec3,
}

impl Trocar {
    /// The pose of an instrument in this trocar, its jaws closed.
    pub fn pose(&self, input: &TrocarInput) -> ToolInput {
        let axes = ToolFrame::of(&ToolInput::at(self.pivot_m, self.outward)).world_from_tool;
        let (sin_pitch, cos_pitch) = libm::sincos(input.pitch_rad);
        let (sin_yaw, cos_yaw) = libm::sincos(input.yaw_rad);
        // z turned about x by the pitch, then about y by the yaw.
        let shaft = axes * DVec3::new(cos_pitch * sin_yaw, -sin_pitch, cos_pitch * cos_yaw);
        let tip_in_world_m = self.pivot_m - shaft * input.insertion_m;
        ToolInput { roll_rad: input.roll_rad, ..ToolInput::at(tip_in_world_m, shaft) }
    }

    /// The motion that a pose in this trocar stands for; the shaft of `pose` goes through the pivot.
    pub fn input(&self, pose: &ToolInput) -> TrocarInput {
        let axes = ToolFrame::of(&ToolInput::at(self.pivot_m, self.outward)).world_from_tool;
        let shaft = axes.transpose() * pose.shaft_in_world;
        TrocarInput {
            pitch_rad: libm::asin((-shaft.y).clamp(-1.0, 1.0)),
            yaw_rad: libm::atan2(shaft.x, shaft.z),
            insertion_m: (self.pivot_m - pose.tip_in_world_m).dot(pose.shaft_in_world),
            roll_rad: pose.roll_rad,
        }
    }
}

/// Direction and depth of a pose that goes through `pivot_m`, for the sweep of its shaft.
pub fn trocar_pose(pose: &ToolInput, pivot_m: DVec3) -> TrocarPose {
    TrocarPose {
        direction: -pose.shaft_in_world,
        insertion_m: (pivot_m - pose.tip_in_world_m).dot(pose.shaft_in_world),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_goes_through_the_pivot_and_gives_its_motion_back() {
        let trocar =
            Trocar { pivot_m: DVec3::new(0.1, -0.2, 0.05), outward: DVec3::new(0.2, -0.9, 0.1).normalize() };
        for (pitch_rad, yaw_rad) in [(0.0, 0.0), (0.6, -0.4), (-0.7, 0.7), (0.1, 1.2)] {
            let input = TrocarInput { pitch_rad, yaw_rad, insertion_m: 0.15, roll_rad: 0.3 };
            let pose = trocar.pose(&input);
            assert!((pose.shaft_in_world.length() - 1.0).abs() < 1e-12);
            assert!(pose.tip_in_world_m.distance(trocar.pivot_m) - 0.15 < 1e-12);
            let held = pose.through(Some(trocar.pivot_m));
            assert!(held.shaft_in_world.distance(pose.shaft_in_world) < 1e-12);
            let back = trocar.input(&pose);
            let off = [
                back.pitch_rad - pitch_rad,
                back.yaw_rad - yaw_rad,
                back.insertion_m - 0.15,
                back.roll_rad - 0.3,
            ];
            assert!(off.iter().all(|x| x.abs() < 1e-12), "{off:?}");
        }
        let straight = trocar.pose(&TrocarInput { insertion_m: 0.1, ..TrocarInput::default() });
        assert!(straight.shaft_in_world.distance(trocar.outward) < 1e-12);
        assert!(trocar_pose(&straight, trocar.pivot_m).insertion_m - 0.1 < 1e-12);
    }
}
