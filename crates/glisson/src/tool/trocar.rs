//! A shaft in a trocar, as its sweep is described.

use super::ToolInput;
use crate::contact::shapes::TrocarPose;
use crate::math::DVec3;

/// Direction and depth of a pose that goes through `pivot_m`, for the sweep of its shaft.
pub fn trocar_pose(pose: &ToolInput, pivot_m: DVec3) -> TrocarPose {
    TrocarPose {
        direction: -pose.shaft_in_world,
        insertion_m: (pivot_m - pose.tip_in_world_m).dot(pose.shaft_in_world),
    }
}
