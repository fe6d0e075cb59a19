//! `[tool]`: the instrument and its scripted motion.

use super::organ::required_point;
use super::reader::{SceneError, Section};
use crate::tool::{Tool, ToolInput};
use crate::units::Dimension;

/// One point of a scripted tool motion; between points the tip moves in straight lines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathPoint {
    /// When the tool is there [s].
    pub time_s: f64,
    /// Where it is.
    pub tool: ToolInput,
}

/// A 5 mm laparoscopic instrument, the common small size of trocars.
const DEFAULT_SHAFT_RADIUS_M: f64 = 2.5e-3;
const DEFAULT_SHAFT_LENGTH_M: f64 = 0.3;

pub(super) fn read_tool(mut section: Section<'_>) -> Result<(Tool, Vec<PathPoint>), SceneError> {
    let name = section.string("name")?.map_or_else(|| "probe".to_string(), |n| n.0);
    let tip_radius_m = section
        .positive("tip_radius", Dimension::Length)?
        .ok_or_else(|| section.missing("tip_radius", "tip_radius = \"5 mm\""))?;
    let shaft_radius_m =
        section.positive("shaft_radius", Dimension::Length)?.unwrap_or(DEFAULT_SHAFT_RADIUS_M);
    let shaft_length_m =
        section.positive("shaft_length", Dimension::Length)?.unwrap_or(DEFAULT_SHAFT_LENGTH_M);
    let tip_in_world_m =
        required_point(&mut section, "home_tip", "home_tip = [\"0 mm\", \"-150 mm\", \"0 mm\"]")?;
    let shaft_in_world = section
        .direction("home_shaft")?
        .ok_or_else(|| section.missing("home_shaft", "home_shaft = [0, -1, 0.3]"))?;
    let home = ToolInput { tip_in_world_m, shaft_in_world };
    let mut path: Vec<PathPoint> = Vec::new();
    for mut point in section.sections("path")? {
        let (time_s, at) = point
            .quantity("time", Dimension::Time)?
            .ok_or_else(|| point.missing("time", "time = \"0.5 s\""))?;
        if time_s < path.last().map_or(0.0, |p| p.time_s) {
            return Err(point.wrong_value(
                at,
                "time",
                format!("{time_s} s"),
                "times that only go up, from 0",
            ));
        }
        let tip_in_world_m = required_point(&mut point, "tip", "tip = [\"0 mm\", \"-90 mm\", \"0 mm\"]")?;
        let before = path.last().map_or(home, |p| p.tool);
        let shaft_in_world = point.direction("shaft")?.unwrap_or(before.shaft_in_world);
        point.finish()?;
        path.push(PathPoint { time_s, tool: ToolInput { tip_in_world_m, shaft_in_world } });
    }
    section.finish()?;
    Ok((Tool { name, tip_radius_m, shaft_radius_m, shaft_length_m, home }, path))
}

/// Where a scripted tool is at `time_s`: at home before the first point, at the last point after it.
pub fn tool_on_path(home: ToolInput, path: &[PathPoint], time_s: f64) -> ToolInput {
    let mut before = PathPoint { time_s: 0.0, tool: home };
    for point in path {
        if time_s < point.time_s {
            let t = (time_s - before.time_s) / (point.time_s - before.time_s);
            let (a, b) = (before.tool, point.tool);
            return ToolInput {
                tip_in_world_m: a.tip_in_world_m.lerp(b.tip_in_world_m, t),
                shaft_in_world: a.shaft_in_world.lerp(b.shaft_in_world, t).normalize_or(b.shaft_in_world),
            };
        }
        before = *point;
    }
    before.tool
}
