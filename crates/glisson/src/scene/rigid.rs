//! `[[rigid]]`: a body that does not deform, its shape and its motion.

use super::organ::required_point;
use super::reader::{SceneError, Section};
use crate::math::{DQuat, DVec3};
use crate::model::rigid::{PathPose, RigidMotion};
use crate::units::Dimension;
use std::path::PathBuf;

/// The shape of a rigid body at rest.
#[derive(Clone, Debug, PartialEq)]
pub enum RigidShape {
    /// A closed surface or a tetrahedral mesh, relative to the scene's folder.
    File(PathBuf),
    /// A box along the axes.
    Box {
        /// Smallest corner [m].
        min_m: DVec3,
        /// Largest corner [m].
        max_m: DVec3,
    },
    /// A ball.
    Ball {
        /// Centre [m].
        center_m: DVec3,
        /// Radius [m].
        radius_m: f64,
    },
    /// A cylinder between the centres of its ends.
    Cylinder {
        /// Centre of an end [m].
        from_m: DVec3,
        /// Centre of the other [m].
        to_m: DVec3,
        /// Radius [m].
        radius_m: f64,
    },
    /// A square plate.
    Slab {
        /// Middle of its upper face [m].
        point_m: DVec3,
        /// Unit normal of that face.
        normal: DVec3,
        /// Edge of the face [m].
        size_m: f64,
        /// Thickness below it [m].
        thickness_m: f64,
    },
}

/// A rigid body as its table says.
#[derive(Clone, Debug, PartialEq)]
pub struct RigidSource {
    /// Its shape.
    pub shape: RigidShape,
    /// Edge of its triangles [m], where it is not given as a tetrahedral mesh; by its size when absent.
    pub edge_m: Option<f64>,
    /// Its motion.
    pub motion: RigidMotion,
}

const SHAPES: &str = "exactly one of mesh = \"FILE\", box = { min, max }, ball = { center, radius }, \
     cylinder = { from, to, radius }, slab = { point, normal, size, thickness }";

/// The rest of the table, without name and colour.
pub(super) fn read_rigid(mut section: Section<'_>) -> Result<RigidSource, SceneError> {
    let shape = read_shape(&mut section)?;
    let edge_m = section.positive("edge", Dimension::Length)?;
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
    Ok(RigidSource { shape, edge_m, motion })
}

fn read_shape(section: &mut Section<'_>) -> Result<RigidShape, SceneError> {
    let mesh = section.string("mesh")?;
    let bounds = section.section("box")?;
    let ball = section.section("ball")?;
    let cylinder = section.section("cylinder")?;
    let slab = section.section("slab")?;
    match (mesh, bounds, ball, cylinder, slab) {
        (Some((file, _)), None, None, None, None) => Ok(RigidShape::File(file.into())),
        (None, Some(mut table), None, None, None) => {
            let min_m = required_point(&mut table, "min", "min = [\"-5 mm\", \"-5 mm\", \"0 mm\"]")?;
            let max_m = required_point(&mut table, "max", "max = [\"5 mm\", \"5 mm\", \"9 mm\"]")?;
            if min_m.cmpge(max_m).any() {
                let found = format!("{min_m} to {max_m} m");
                return Err(table.wrong_table("box", found, "min below max along every axis".into()));
            }
            table.finish()?;
            Ok(RigidShape::Box { min_m, max_m })
        }
        (None, None, Some(mut table), None, None) => {
            let center_m = required_point(&mut table, "center", "center = [\"0 mm\", \"0 mm\", \"9 mm\"]")?;
            let radius_m = required_length(&mut table, "radius", "radius = \"20 mm\"")?;
            table.finish()?;
            Ok(RigidShape::Ball { center_m, radius_m })
        }
        (None, None, None, Some(mut table), None) => {
            let from_m = required_point(&mut table, "from", "from = [\"0 mm\", \"0 mm\", \"0 mm\"]")?;
            let to_m = required_point(&mut table, "to", "to = [\"0 mm\", \"0 mm\", \"90 mm\"]")?;
            let radius_m = required_length(&mut table, "radius", "radius = \"20 mm\"")?;
            if from_m == to_m {
                return Err(table.wrong_table(
                    "cylinder",
                    "without length".into(),
                    "from and to apart".into(),
                ));
            }
            table.finish()?;
            Ok(RigidShape::Cylinder { from_m, to_m, radius_m })
        }
        (None, None, None, None, Some(mut table)) => {
            let point_m = required_point(&mut table, "point", "point = [\"0 mm\", \"0 mm\", \"0 mm\"]")?;
            let normal =
                table.direction("normal")?.ok_or_else(|| table.missing("normal", "normal = [0, -1, 0]"))?;
            let size_m = required_length(&mut table, "size", "size = \"300 mm\"")?;
            let thickness_m = required_length(&mut table, "thickness", "thickness = \"20 mm\"")?;
            table.finish()?;
            Ok(RigidShape::Slab { point_m, normal, size_m, thickness_m })
        }
        _ => Err(section.missing("mesh, box, ball, cylinder or slab", SHAPES)),
    }
}

fn required_length(
    section: &mut Section<'_>,
    key: &'static str,
    example: &'static str,
) -> Result<f64, SceneError> {
    section.positive(key, Dimension::Length)?.ok_or_else(|| section.missing(key, example))
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
            (Some(axis), Some((angle_rad, _))) => DQuat::from_axis_angle(axis, angle_rad),
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
    let amplitude_m = required_length(&mut section, "amplitude", "amplitude = \"10 mm\"")?;
    let period_s = section
        .positive("period", Dimension::Time)?
        .ok_or_else(|| section.missing("period", "period = \"4 s\""))?;
    let sharpness = match section.number("sharpness")? {
        None => 1,
        Some((n, _)) if n.fract() == 0.0 && (1.0..=MOST_SHARP).contains(&n) => n as u32,
        Some((n, at)) => {
            return Err(section.wrong_value(at, "sharpness", n.to_string(), "a whole number from 1 to 10"));
        }
    };
    section.finish()?;
    Ok(RigidMotion::Breathing { direction, amplitude_m, period_s, sharpness })
}

const MOST_SHARP: f64 = 10.0;
