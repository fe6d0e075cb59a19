//! The parts of an instrument that touch tissue, and how they move in a step.

use crate::contact::shapes::{Capsule, CapsuleMotion, RigidPose};
use crate::math::DVec3;
use crate::tool::external_detection::TouchingPoint;
use crate::tool::pose::ToolFrame;
use crate::tool::trocar::trocar_pose;
use crate::tool::{Tool, ToolInput, ToolShape};

/// Which part of an instrument touches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ToolPart {
    /// The ball at the tip, the mesh in its place, or the first jaw.
    Tip,
    /// The second jaw.
    SecondJaw,
    /// The shaft.
    Shaft,
}

impl ToolPart {
    /// All of them, in the order in which they are asked.
    pub const ALL: [Self; 3] = [Self::Tip, Self::SecondJaw, Self::Shaft];

    /// Radius with which it touches [m]; none for a mesh, which touches with its own points.
    pub(super) fn radius_m(self, tool: &Tool) -> f64 {
        match self {
            Self::Tip if mesh_of(tool).is_some() => 0.0,
            Self::Tip | Self::SecondJaw => tool.tip_radius_m,
            Self::Shaft => tool.shaft_radius_m,
        }
    }

    /// Place in a list of all parts.
    pub fn index(self) -> usize {
        self as usize
    }
}

/// The shaft begins so many radii of the tip behind its centre: what lies before belongs to the tip.
const SHAFT_BEGINS: f64 = 2.0;

/// A part as a capsule; `None` for a part that the tool does not have.
pub(super) fn capsule(tool: &Tool, part: ToolPart, pose: &ToolInput) -> Option<Capsule> {
    let behind_m = |distance_m: f64| pose.tip_in_world_m + pose.shaft_in_world * distance_m;
    let jaw = |side: usize| {
        let jaws = tool.kind.jaws()?;
        let frame = ToolFrame::of(pose);
        Some(Capsule {
            from_m: frame.to_world_m(jaws.ends_in_tool_m(pose.jaw_opening)[side]),
            to_m: frame.to_world_m(jaws.hinge_in_tool_m()),
            radius_m: tool.tip_radius_m,
        })
    };
    match part {
        ToolPart::Tip => Some(match tool.kind.blade() {
            // An edge touches along its length.
            Some(blade) => Capsule {
                from_m: pose.tip_in_world_m,
                to_m: behind_m(blade.length_m),
                radius_m: tool.tip_radius_m,
            },
            None => jaw(0).unwrap_or(Capsule::ball(pose.tip_in_world_m, tool.tip_radius_m)),
        }),
        ToolPart::SecondJaw => jaw(1),
        ToolPart::Shaft => shaft_from(tool, pose, effector_m(tool).max(SHAFT_BEGINS * tool.tip_radius_m)),
    }
}

/// A part as other instruments meet it: the shaft goes on to the jaws, the blade or the middle of the tip, so that nothing slips
/// in between; a mesh at the tip is the ball there.
pub(super) fn capsule_for_tools(tool: &Tool, part: ToolPart, pose: &ToolInput) -> Option<Capsule> {
    match part {
        ToolPart::Shaft => shaft_from(tool, pose, effector_m(tool)),
        ToolPart::Tip | ToolPart::SecondJaw => capsule(tool, part, pose),
    }
}

/// Length of jaws or blade [m].
fn effector_m(tool: &Tool) -> f64 {
    match tool.kind.blade() {
        Some(blade) => blade.length_m,
        None => tool.kind.jaws().map_or(0.0, |jaws| jaws.length_m),
    }
}

/// The shaft from so far behind the tip; none where it is not so long.
fn shaft_from(tool: &Tool, pose: &ToolInput, first_m: f64) -> Option<Capsule> {
    let behind_m = |distance_m: f64| pose.tip_in_world_m + pose.shaft_in_world * distance_m;
    (first_m < tool.shaft_length_m).then(|| Capsule {
        from_m: behind_m(first_m),
        to_m: behind_m(tool.shaft_length_m),
        radius_m: tool.shaft_radius_m,
    })
}

/// How a part moves from one pose to the next. Its ends move on curves where the tool turns; the motion says how far
/// these are from straight lines.
pub(super) fn motion(
    tool: &Tool,
    part: ToolPart,
    before: &ToolInput,
    now: &ToolInput,
) -> Option<CapsuleMotion> {
    let capsules = [capsule(tool, part, before)?, capsule(tool, part, now)?];
    Some(motion_between(tool, part, capsules, [before, now]))
}

/// How a part moves as other instruments meet it.
pub(super) fn motion_for_tools(
    tool: &Tool,
    part: ToolPart,
    [before, now]: [&ToolInput; 2],
) -> Option<CapsuleMotion> {
    let capsules = [capsule_for_tools(tool, part, before)?, capsule_for_tools(tool, part, now)?];
    Some(motion_between(tool, part, capsules, [before, now]))
}

fn motion_between(
    tool: &Tool,
    part: ToolPart,
    [start, end]: [Capsule; 2],
    [before, now]: [&ToolInput; 2],
) -> CapsuleMotion {
    if let (ToolPart::Shaft, Some(pivot_m)) = (part, tool.trocar_m) {
        let length_m = start.from_m.distance(start.to_m);
        let behind_m = start.from_m.distance(before.tip_in_world_m);
        let pose = |input: &ToolInput| {
            let pose = trocar_pose(input, pivot_m);
            crate::contact::shapes::TrocarPose { insertion_m: pose.insertion_m - behind_m, ..pose }
        };
        let (start, end) = (pose(before), pose(now));
        return CapsuleMotion::through_trocar(pivot_m, &start, &end, length_m, tool.shaft_radius_m);
    }
    let straight = CapsuleMotion::straight(&start, &end);
    // About the tip, whose centre moves on a straight line; the jaws turn about their hinge as well.
    let lever_m =
        start.from_m.distance(before.tip_in_world_m).max(start.to_m.distance(before.tip_in_world_m));
    let jaws_rad = tool.kind.jaws().map_or(0.0, |jaws| {
        0.5 * (jaws.opening_rad(now.jaw_opening) - jaws.opening_rad(before.jaw_opening)).abs()
    });
    let bend_m =
        if part == ToolPart::Shaft || lever_m == 0.0 { 0.0 } else { lever_m * jaws_rad * jaws_rad / 8.0 };
    let turn_m = rigid_pose(before).path_error_m(&rigid_pose(now), lever_m);
    CapsuleMotion { path_error_m: bend_m + turn_m, ..straight }
}

/// The frame of a tool as a rigid pose.
pub(super) fn rigid_pose(pose: &ToolInput) -> RigidPose {
    let frame = ToolFrame::of(pose);
    RigidPose { rotation: frame.world_from_tool, origin_m: frame.tip_in_world_m }
}

/// A point of a tool that tissue follows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum ToolPoint {
    /// On the axis of a capsule: the share from its first end. The tool turns in place there.
    OnAxis(ToolPart, f64),
    /// Fixed to the tool [m, in its frame].
    Fixed(DVec3),
}

impl ToolPoint {
    /// What of a part a search found touching.
    pub(super) fn of(part: ToolPart, found: TouchingPoint) -> Self {
        match found {
            TouchingPoint::OnAxis(along) => Self::OnAxis(part, along),
            TouchingPoint::Fixed(in_tool_m) => Self::Fixed(in_tool_m),
        }
    }

    /// Where it is [m].
    pub(super) fn in_world_m(self, tool: &Tool, pose: &ToolInput) -> DVec3 {
        match self {
            Self::OnAxis(part, along) => {
                capsule(tool, part, pose).map_or(pose.tip_in_world_m, |c| c.axis_point_m(along))
            }
            Self::Fixed(in_tool_m) => ToolFrame::of(pose).to_world_m(in_tool_m),
        }
    }

    /// Everything that its next steps depend on.
    pub(super) fn numbers(self) -> [f64; 4] {
        match self {
            Self::OnAxis(part, along) => [part.index() as f64, along, 0.0, 0.0],
            Self::Fixed(p) => [-1.0, p.x, p.y, p.z],
        }
    }
}

/// Whether the tip is a mesh.
pub(super) fn mesh_of(tool: &Tool) -> Option<&crate::contact::shapes::MeshShape> {
    match &tool.shape {
        ToolShape::Mesh(shape) => Some(shape),
        ToolShape::Capsules => None,
    }
}
