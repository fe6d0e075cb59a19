//! Where active trocars stand in the world, up to four beside each other (seed `000`, s. 5.3.3, 5.4.5).

use super::kinematics::{TrocarJoints, TrocarPose};
use super::profiles::TrocarProfile;
use super::statics::ContactForce;
use crate::math::{DMat3, DVec3, segment_distance};
use crate::tool::ToolInput;
use crate::tool::pose::ToolFrame;
use glam::DQuat;

/// Active trocars at most: "up to four" can be brought together.
pub const MOST_TROCARS: usize = 4;

/// From the frame of a device to the world. Lengths and forces keep their size: the instrument is real.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Where O is [m].
    pub pivot_in_world_m: DVec3,
    /// Turns e_X, e_Y, e_Z into the world.
    pub world_from_device: DMat3,
}

impl Placement {
    /// A trocar at `pivot_in_world_m` whose instrument at rest points along `inward` (unit vector, into the body). Its
    /// axes e_X and e_Y are those of a tool's frame there ([`ToolFrame`]), so that e_X, -e_Y, -e_Z are the tool's.
    pub fn facing(pivot_in_world_m: DVec3, inward: DVec3) -> Self {
        let tool = ToolFrame::of(&ToolInput::at(pivot_in_world_m, -inward)).world_from_tool;
        Self { pivot_in_world_m, world_from_device: tool * HALF_TURN }
    }

    /// A point of the device's frame in the world [m].
    pub fn to_world_m(&self, in_device_m: DVec3) -> DVec3 {
        self.world_from_device * in_device_m + self.pivot_in_world_m
    }

    /// A point of the world in the device's frame [m].
    pub fn to_device_m(&self, in_world_m: DVec3) -> DVec3 {
        self.world_from_device.transpose() * (in_world_m - self.pivot_in_world_m)
    }

    /// A force at a point of the world, in the device's frame.
    pub fn contact(&self, point_in_world_m: DVec3, force_in_world_n: DVec3) -> ContactForce {
        ContactForce {
            point_m: self.to_device_m(point_in_world_m),
            force_n: self.world_from_device.transpose() * force_in_world_n,
            torque_n_m: DVec3::ZERO,
        }
    }

    /// The tool of a simulation that has the motions `joints`.
    pub fn tool_input(&self, joints: &TrocarJoints) -> ToolInput {
        let pose = joints.pose();
        let world_from_tool = self.world_from_device * pose.device_from_instrument * HALF_TURN;
        let straight = ToolInput::at(self.to_world_m(pose.tip_m), world_from_tool.z_axis);
        let frame = ToolFrame::of(&straight).world_from_tool;
        let x = world_from_tool.x_axis;
        ToolInput {
            roll_rad: libm::atan2(x.dot(frame.y_axis), x.dot(frame.x_axis)),
            jaw_opening: joints.jaw_opening,
            ..straight
        }
    }

    /// The motions of a simulation's tool that goes through this trocar; none when it points out of the body.
    pub fn joints(&self, tool: &ToolInput) -> Option<TrocarJoints> {
        let world_from_tool = ToolFrame::of(tool).world_from_tool;
        let device_from_instrument = self.world_from_device.transpose() * world_from_tool * HALF_TURN;
        let pose = TrocarPose { tip_m: self.to_device_m(tool.tip_in_world_m), device_from_instrument };
        Some(TrocarJoints { jaw_opening: tool.jaw_opening, ..pose.joints()? })
    }
}

/// Instrument axes (z to the tip) and tool axes (z to the handle): x stays. Its own inverse.
const HALF_TURN: DMat3 = DMat3::from_cols(DVec3::X, DVec3::NEG_Y, DVec3::NEG_Z);

/// From a handle's frame (z towards the hand) to the device's.
pub fn handle_orientation(pose: &TrocarPose) -> DQuat {
    DQuat::from_mat3(&(pose.device_from_instrument * HALF_TURN))
}

/// Several active trocars on one plane.
#[derive(Clone, Debug, PartialEq)]
pub struct Arrangement {
    profile: TrocarProfile,
    placements: Vec<Placement>,
}

/// Why trocars cannot stand so.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum ArrangementError {
    /// None, or more than four.
    #[error("{0} active trocars; 1 to 4 can stand together")]
    Count(usize),
    /// Their cradles overlap.
    #[error(
        "active trocars {} and {} are {:.1} mm apart; their cradles need {:.1} mm: move one away",
        .pair[0] + 1, .pair[1] + 1, .found_m * 1e3, .least_m * 1e3
    )]
    TooNear {
        /// Which two, from 0.
        pair: [usize; 2],
        /// Between their centres [m].
        found_m: f64,
        /// Diameter of the cradle [m].
        least_m: f64,
    },
}

/// Centres that stand nearer than the cradle by rounding alone are not refused [m].
const ROUNDING_M: f64 = 1e-9;

impl Arrangement {
    /// Trocars of one profile at these places.
    ///
    /// # Errors
    /// [`ArrangementError`] when there are too many or two stand too near.
    pub fn new(profile: TrocarProfile, placements: Vec<Placement>) -> Result<Self, ArrangementError> {
        if !(1..=MOST_TROCARS).contains(&placements.len()) {
            return Err(ArrangementError::Count(placements.len()));
        }
        for (i, a) in placements.iter().enumerate() {
            for (j, b) in placements.iter().enumerate().skip(i + 1) {
                let found_m = a.pivot_in_world_m.distance(b.pivot_in_world_m);
                if found_m < profile.cradle_diameter_m - ROUNDING_M {
                    return Err(ArrangementError::TooNear {
                        pair: [i, j],
                        found_m,
                        least_m: profile.cradle_diameter_m,
                    });
                }
            }
        }
        Ok(Self { profile, placements })
    }

    /// `n` trocars beside each other, as near as the cradles let them: in pairs, the first at `first`, the others along
    /// its e_X and e_Y.
    ///
    /// # Errors
    /// [`ArrangementError::Count`] when `n` is not 1 to 4.
    pub fn adjacent(profile: TrocarProfile, first: Placement, n: usize) -> Result<Self, ArrangementError> {
        let apart_m = profile.cradle_diameter_m;
        let at = |i: usize| {
            let offset_m = DVec3::new((i % 2) as f64, (i / 2) as f64, 0.0) * apart_m;
            Placement { pivot_in_world_m: first.to_world_m(offset_m), ..first }
        };
        Self::new(profile, (0..n).map(at).collect())
    }

    /// Where they are.
    pub fn placements(&self) -> &[Placement] {
        &self.placements
    }

    /// Least distance between the axes of two instruments, each from O to its tip and `outside_m` [m] beyond O on the
    /// hand's side. Below the sum of their radii they touch.
    pub fn clearance_m(&self, pair: [usize; 2], joints: [&TrocarJoints; 2], outside_m: f64) -> f64 {
        let ends = [0, 1].map(|i| {
            let (placement, direction) = (&self.placements[pair[i]], joints[i].direction());
            [-outside_m, joints[i].insertion_m].map(|along_m| placement.to_world_m(direction * along_m))
        });
        segment_distance(ends[0], ends[1])
    }

    /// What all of them are.
    pub fn profile(&self) -> &TrocarProfile {
        &self.profile
    }
}
