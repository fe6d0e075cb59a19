//! What a stage of a task wants: a table of goals, one row each.

use super::super::bodies::read_body_named;
use super::super::reader::{SceneError, Section, Value};
use super::TaskScene;
use super::line::{LineSource, read_ends, read_line};
use super::tool_name::read_tool;
use crate::math::DVec3;
use crate::tool::Tool;
use crate::units::Dimension;
use crate::world::loops::MOST_TIED;

/// What a stage wants. Places are those at rest, and go with the tissue.
#[derive(Clone, Debug, PartialEq)]
pub enum GoalSource {
    /// The tip of an instrument is at a place in space.
    Reach {
        /// Which instrument.
        tool: usize,
        /// Where [m].
        point_m: DVec3,
        /// How near [m].
        within_m: f64,
    },
    /// The tip of an instrument touches the tissue.
    Touch {
        /// Which instrument.
        tool: usize,
        /// Where and how near [m]; anywhere when absent.
        near_m: Option<(DVec3, f64)>,
    },
    /// The trigger is pressed where the tip touches the right place; elsewhere it is a mistake.
    Mark {
        /// Which instrument.
        tool: usize,
        /// Where [m].
        near_m: DVec3,
        /// How near [m].
        within_m: f64,
    },
    /// Jaws hold tissue.
    Grasp {
        /// Which instrument.
        tool: usize,
        /// Where and how near [m]; anywhere when absent.
        near_m: Option<(DVec3, f64)>,
    },
    /// Jaws hold tissue, and a place of it has moved.
    Lift {
        /// Which instrument.
        tool: usize,
        /// The place [m].
        point_m: DVec3,
        /// How far [m].
        by_m: f64,
        /// Which way; any when absent.
        direction: Option<DVec3>,
    },
    /// The tissue is cut along a line.
    Cut {
        /// The line.
        line: LineSource,
        /// How far the cut may be from the line [m].
        within_m: f64,
        /// Which share of the line.
        share: f64,
    },
    /// Two places do not hang together any more.
    Part {
        /// One [m].
        from_m: DVec3,
        /// The other [m].
        to_m: DVec3,
    },
    /// No strand of an attachment holds two bodies together any more.
    Detach {
        /// The bodies, by their numbers.
        bodies: [usize; 2],
    },
    /// A ball of tissue, such as a tumour, is cut loose from the rest of its organ.
    Excise {
        /// Its middle [m].
        center_m: DVec3,
        /// Its radius [m].
        radius_m: f64,
    },
    /// An endoscope sees a place near the middle of its picture.
    See {
        /// Which instrument.
        tool: usize,
        /// The place [m].
        point_m: DVec3,
        /// How far from the middle of the picture at most [rad].
        within_rad: f64,
        /// How far away at most [m]; any distance that is lit when absent.
        nearer_than_m: Option<f64>,
    },
    /// Clips are set.
    Clip {
        /// How many.
        n_clips: u32,
        /// Where on a vessel at rest, and how near [m]; anywhere when absent.
        near_m: Option<(DVec3, f64)>,
    },
    /// Ligating loops are tied off.
    Ligate {
        /// How many.
        n_loops: u32,
        /// Where at rest, the middle of what each is around, and how near [m]; anywhere when absent.
        near_m: Option<(DVec3, f64)>,
    },
    /// It bleeds no more than this.
    Bleed {
        /// Blood that comes out [m3/s].
        below_m3_per_s: f64,
    },
}

impl GoalSource {
    /// Whether it has no meaning without vessels.
    pub fn is_about_vessels(&self) -> bool {
        matches!(self, Self::Clip { .. } | Self::Bleed { .. })
    }
}

/// A kind of goal: one row of [`GOALS`].
struct GoalRow {
    /// Its key in a stage.
    key: &'static str,
    read: fn(&mut Section<'_>, &TaskScene<'_>) -> Result<GoalSource, SceneError>,
}

/// The goal of a stage: the table of the one key of [`GOALS`] that is there.
pub(super) fn read_goal(stage: &mut Section<'_>, scene: &TaskScene<'_>) -> Result<GoalSource, SceneError> {
    let mut goal = None;
    for row in GOALS {
        let Some(mut table) = stage.section(row.key)? else { continue };
        if goal.is_some() {
            return Err(table.wrong_table(row.key, "a second goal".into(), "one goal a stage".into()));
        }
        goal = Some((row.read)(&mut table, scene)?);
        table.finish()?;
    }
    let keys: Vec<&'static str> = GOALS.iter().map(|row| row.key).collect();
    goal.ok_or_else(|| stage.missing_one_of(&keys, GOAL_EXAMPLE))
}

/// All kinds of goals, in the order of docs/tasks.md.
const GOALS: &[GoalRow] = &[
    GoalRow { key: "reach", read: read_reach },
    GoalRow { key: "touch", read: read_touch },
    GoalRow { key: "mark", read: read_mark },
    GoalRow { key: "grasp", read: read_grasp },
    GoalRow { key: "lift", read: read_lift },
    GoalRow { key: "cut", read: read_cut },
    GoalRow { key: "part", read: read_part },
    GoalRow { key: "detach", read: read_detach },
    GoalRow { key: "excise", read: read_excise },
    GoalRow { key: "see", read: read_see },
    GoalRow { key: "clip", read: read_clip },
    GoalRow { key: "ligate", read: read_ligate },
    GoalRow { key: "bleed", read: read_bleed },
];

const GOAL_EXAMPLE: &str = "touch = { tool = \"probe\" }; exactly one of reach, touch, mark, grasp, lift, cut, part, detach, excise, see, clip, ligate, bleed";
const POINT: &str = "point = [\"0 mm\", \"-50 mm\", \"0 mm\"]";
const WITHIN: &str = "within = \"5 mm\"";

/// Clips are counted up to this.
const MOST_CLIPS: u64 = 1000;
/// Share of a line that has to be cut where a stage says nothing: a choice.
const SHARE_OF_LINE: f64 = 0.9;
/// A place is near the middle of an endoscope's picture within this, where a stage says nothing [rad]: 10 degrees, a choice.
const NEAR_MIDDLE_RAD: f64 = std::f64::consts::PI / 18.0;
/// `near` and `within`, both or neither.
fn read_near(table: &mut Section<'_>) -> Result<Option<(DVec3, f64)>, SceneError> {
    let near_m = table.point("near")?;
    let within_m = table.positive("within", Dimension::Length)?;
    match (near_m, within_m) {
        (Some(near_m), Some(within_m)) => Ok(Some((near_m, within_m))),
        (None, None) => Ok(None),
        (Some(_), None) => Err(table.missing("within", WITHIN)),
        (None, Some(_)) => Err(table.missing("near", "near = [\"0 mm\", \"-50 mm\", \"0 mm\"]")),
    }
}

fn read_reach(table: &mut Section<'_>, scene: &TaskScene<'_>) -> Result<GoalSource, SceneError> {
    let tool = read_tool(table, scene.tools)?;
    let point_m = table.required_point("point", POINT)?;
    Ok(GoalSource::Reach { tool, point_m, within_m: table.required_length("within", WITHIN)? })
}

fn read_touch(table: &mut Section<'_>, scene: &TaskScene<'_>) -> Result<GoalSource, SceneError> {
    Ok(GoalSource::Touch { tool: read_tool(table, scene.tools)?, near_m: read_near(table)? })
}

fn read_mark(table: &mut Section<'_>, scene: &TaskScene<'_>) -> Result<GoalSource, SceneError> {
    let tool = read_tool(table, scene.tools)?;
    let near_m = table.required_point("near", "near = [\"0 mm\", \"-50 mm\", \"0 mm\"]")?;
    Ok(GoalSource::Mark { tool, near_m, within_m: table.required_length("within", WITHIN)? })
}

/// An instrument whose jaws hold tissue.
fn read_holding_tool(
    table: &mut Section<'_>,
    scene: &TaskScene<'_>,
    goal: &'static str,
) -> Result<usize, SceneError> {
    let tool = read_tool(table, scene.tools)?;
    if scene.tools[tool].kind.holds() {
        return Ok(tool);
    }
    let found = format!("with the {}", scene.tools[tool].kind.name());
    Err(table.wrong_table(goal, found, "an instrument whose jaws hold tissue, such as a grasper".into()))
}

fn read_grasp(table: &mut Section<'_>, scene: &TaskScene<'_>) -> Result<GoalSource, SceneError> {
    Ok(GoalSource::Grasp { tool: read_holding_tool(table, scene, "grasp")?, near_m: read_near(table)? })
}

fn read_lift(table: &mut Section<'_>, scene: &TaskScene<'_>) -> Result<GoalSource, SceneError> {
    let tool = read_holding_tool(table, scene, "lift")?;
    let point_m = table.required_point("point", POINT)?;
    let by_m = table.required_length("by", "by = \"20 mm\"")?;
    Ok(GoalSource::Lift { tool, point_m, by_m, direction: table.direction("direction")? })
}

/// Whether there is an instrument that divides tissue.
fn check_cuts(table: &Section<'_>, scene: &TaskScene<'_>, goal: &'static str) -> Result<(), SceneError> {
    let cuts = |tool: &Tool| tool.kind.edge_cuts().is_some() || tool.kind.burning().is_some();
    if scene.tools.iter().any(|tool| cuts(tool) || tool.kind.parting_jaws().is_some()) {
        return Ok(());
    }
    let allowed = "a scalpel, scissors, a hook or a cautery among the instruments".into();
    Err(table.wrong_table(goal, "without an instrument that cuts".into(), allowed))
}

fn read_cut(table: &mut Section<'_>, scene: &TaskScene<'_>) -> Result<GoalSource, SceneError> {
    check_cuts(table, scene, "cut")?;
    let line = read_line(table)?;
    let within_m = table.required_length("within", WITHIN)?;
    let share = match table.number("share")? {
        None => SHARE_OF_LINE,
        Some((share, _)) if share > 0.0 && share <= 1.0 => share,
        Some((share, at)) => return Err(wrong_share(table, share, at)),
    };
    Ok(GoalSource::Cut { line, within_m, share })
}

fn wrong_share(table: &Section<'_>, share: f64, at: Value<'_>) -> SceneError {
    table.wrong_value(at, "share", share.to_string(), "more than 0, at most 1")
}

fn read_part(table: &mut Section<'_>, scene: &TaskScene<'_>) -> Result<GoalSource, SceneError> {
    check_cuts(table, scene, "part")?;
    let (from_m, to_m) = read_ends(table)?;
    Ok(GoalSource::Part { from_m, to_m })
}

fn read_detach(table: &mut Section<'_>, scene: &TaskScene<'_>) -> Result<GoalSource, SceneError> {
    let mut body = |key_with_example| read_body_named(table, key_with_example, scene.bodies);
    let bodies = [body(("body", "body = \"gall bladder\""))?, body(("from", "from = \"liver\""))?];
    Ok(GoalSource::Detach { bodies })
}

fn read_excise(table: &mut Section<'_>, scene: &TaskScene<'_>) -> Result<GoalSource, SceneError> {
    check_cuts(table, scene, "excise")?;
    let center_m = table.required_point("center", "center = [\"0 mm\", \"-30 mm\", \"0 mm\"]")?;
    Ok(GoalSource::Excise { center_m, radius_m: table.required_length("radius", "radius = \"12 mm\"")? })
}

fn read_see(table: &mut Section<'_>, scene: &TaskScene<'_>) -> Result<GoalSource, SceneError> {
    let tool = read_tool(table, scene.tools)?;
    if scene.tools[tool].kind.optics().is_none() {
        let found = format!("with the {}", scene.tools[tool].kind.name());
        return Err(table.wrong_table("see", found, "an instrument of the kind endoscope".into()));
    }
    let point_m = table.required_point("point", POINT)?;
    let within_rad = table.positive("within", Dimension::Angle)?.unwrap_or(NEAR_MIDDLE_RAD);
    let nearer_than_m = table.positive("nearer_than", Dimension::Length)?;
    Ok(GoalSource::See { tool, point_m, within_rad, nearer_than_m })
}

fn read_ligate(table: &mut Section<'_>, scene: &TaskScene<'_>) -> Result<GoalSource, SceneError> {
    if scene.tools.iter().all(|tool| tool.kind.ligating_loop().is_none()) {
        let allowed = "an instrument of the kind loop among the instruments".into();
        return Err(table.wrong_table("ligate", "without a ligating loop".into(), allowed));
    }
    let n_loops = table.whole_number("count", 1..=MOST_TIED as u64)?.map_or(1, |n| n as u32);
    Ok(GoalSource::Ligate { n_loops, near_m: read_near(table)? })
}

fn read_clip(table: &mut Section<'_>, _: &TaskScene<'_>) -> Result<GoalSource, SceneError> {
    let n_clips = table.whole_number("count", 1..=MOST_CLIPS)?.map_or(1, |n| n as u32);
    Ok(GoalSource::Clip { n_clips, near_m: read_near(table)? })
}

fn read_bleed(table: &mut Section<'_>, _: &TaskScene<'_>) -> Result<GoalSource, SceneError> {
    let below = table.positive("below", Dimension::VolumeFlow)?;
    let below_m3_per_s = below.ok_or_else(|| table.missing("below", "below = \"1 ml/min\""))?;
    Ok(GoalSource::Bleed { below_m3_per_s })
}
