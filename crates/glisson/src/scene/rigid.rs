//! `[[rigid]]`: a body that does not deform, its shape and its motion.

use super::reader::{SceneError, Section};
use super::shape::{ShapeSource, read_shape};
use crate::math::{DQuat, DVec3, rotation_about};
use crate::model::rigid::{PathPose, RigidMotion};
use crate::units::Dimension;

/// A rigid body as its table says.
#[derive(Clone, Debug, PartialEq)]
pub struct RigidSource {
    /// Its shape.
    pub source: ShapeSource,
    /// Its motion.
    pub motion: RigidMotion,
}

/// The rest of the table, without name and colour.
pub(super) fn read_rigid(mut section: Section<'_>) -> Result<RigidSource, SceneError> {
    let source = read_shape(&mut section)?;
    let breathing = section.section("breathing")?;
    let pivot_m = section.point("pivot")?;
    let poses = read_path(&mut section)?;
    let motion = match (breathing, poses.is_empty()) {
        (None, true) => RigidMotion::Fixed,
        (None, false) => RigidMotion::Path { pivot_m: pivot_m.unwrap_or(DVec3::ZERO), poses },
        (Some(breathing), true) => read_breathing(breathing)?,
        (Some(breathing), false) => {
            let found = "beside [[rigid.path]]".to_string();
            return Err(breathing.wrong_table("breathing", found, "breathing or a path".into()));
        }
    };
    section.finish()?;
    Ok(RigidSource { source, motion })
}

fn read_path(section: &mut Section<'_>) -> Result<Vec<PathPose>, SceneError> {
    let mut poses: Vec<PathPose> = Vec::new();
    for mut pose in section.sections("path")? {
        let (time_s, at) =
            pose.quantity("time", Dimension::Time)?.ok_or_else(|| pose.missing("time", "time = \"1 s\""))?;
        if time_s <= poses.last().map_or(0.0, |before| before.time_s) {
            let allowed = "later than the point before it, and than 0 s";
            return Err(pose.wrong_value(at, "time", format!("{time_s} s"), allowed));
        }
        let displacement_m = pose.point("displacement")?.unwrap_or(DVec3::ZERO);
        let axis = pose.direction("axis")?;
        let angle = pose.quantity("angle", Dimension::Angle)?;
        let rotation = match (axis, angle) {
            (None, None) => DQuat::IDENTITY,
            (Some(axis), Some((angle_rad, _))) => rotation_about(axis, angle_rad),
            (Some(_), None) => return Err(pose.missing("angle", "angle = \"30 deg\"")),
            (None, Some(_)) => return Err(pose.missing("axis", "axis = [0, 0, 1]")),
        };
        pose.finish()?;
        poses.push(PathPose { time_s, displacement_m, rotation });
    }
    Ok(poses)
}

fn read_breathing(mut section: Section<'_>) -> Result<RigidMotion, SceneError> {
    let direction = section
        .direction("direction")?
        .ok_or_else(|| section.missing("direction", "direction = [0, 0, -1]"))?;
    let amplitude_m = section.required_length("amplitude", "amplitude = \"10 mm\"")?;
    let period_s = section
        .positive("period", Dimension::Time)?
        .ok_or_else(|| section.missing("period", "period = \"4 s\""))?;
    let sharpness = section.whole_number("sharpness", 1..=MOST_SHARP)?.map_or(1, |n| n as u32);
    section.finish()?;
    Ok(RigidMotion::Breathing { direction, amplitude_m, period_s, sharpness })
}

/// A choice.
const MOST_SHARP: u64 = 10;
