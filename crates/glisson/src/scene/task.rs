//! `[task]`: what somebody who trains has to do in a scene, and within which limits.

use super::reader::{SceneError, Section, Value};
use crate::math::DVec3;
use crate::text::did_you_mean;
use crate::tool::Tool;
use crate::units::Dimension;

/// A task as a scene says it.
#[derive(Clone, Debug, PartialEq)]
pub struct TaskSource {
    /// What it is called.
    pub title: String,
    /// What it is about, for who chooses one.
    pub about: String,
    /// Whether it begins with the endoscope's picture.
    pub begins_in_theatre: bool,
    /// What has to be done, in this order; one at least.
    pub stages: Vec<StageSource>,
    /// The task has failed when it takes longer [s].
    pub time_limit_s: f64,
    /// Force between an instrument and tissue above which it is noted [N]; that of `training::metrics` when absent.
    pub force_threshold_n: Option<f64>,
    /// What must not happen, whatever else was good.
    pub gate: GateSource,
}

/// A safety gate: who goes beyond one of these does not pass.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GateSource {
    /// Greatest force on an instrument [N].
    pub peak_force_n: Option<f64>,
    /// Blood lost [m3].
    pub blood_m3: Option<f64>,
    /// Tissue taken out [m3].
    pub removed_m3: Option<f64>,
    /// Mistakes.
    pub n_mistakes: Option<u32>,
    /// Times that tissue slipped out of the jaws.
    pub n_slips: Option<u32>,
}

/// A part of a task.
#[derive(Clone, Debug, PartialEq)]
pub struct StageSource {
    /// What has to be done, in words.
    pub title: String,
    /// Help for who takes long.
    pub hint: Option<String>,
    /// When the hint is shown, from the stage's beginning [s].
    pub hint_after_s: f64,
    /// For how long the goal has to hold [s].
    pub hold_s: f64,
    /// What has to be reached.
    pub goal: GoalSource,
}

/// What a stage wants. Places are those at rest, and go with the tissue.
#[derive(Clone, Copy, Debug, PartialEq)]
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
        /// Where the line begins [m].
        from_m: DVec3,
        /// Where it ends [m].
        to_m: DVec3,
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
    read: fn(&mut Section<'_>, &[Tool]) -> Result<GoalSource, SceneError>,
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
    GoalRow { key: "see", read: read_see },
    GoalRow { key: "clip", read: read_clip },
    GoalRow { key: "bleed", read: read_bleed },
];

const GOAL_EXAMPLE: &str = "touch = { tool = \"probe\" }; exactly one of reach, touch, mark, grasp, lift, cut, part, see, clip, bleed";
const POINT: &str = "point = [\"0 mm\", \"-50 mm\", \"0 mm\"]";
const WITHIN: &str = "within = \"5 mm\"";

/// A hint that says no time is shown after this [s]: a choice.
const HINT_AFTER_S: f64 = 30.0;
/// Share of a line that has to be cut where a stage says nothing: a choice.
const SHARE_OF_LINE: f64 = 0.9;
/// A place is near the middle of an endoscope's picture within this, where a stage says nothing [rad]: 10 degrees, a choice.
const NEAR_MIDDLE_RAD: f64 = std::f64::consts::PI / 18.0;
/// Time limit of a task that gives none [s]: nobody trains longer without a break, and what is written down grows. A choice.
const LONGEST_S: f64 = 3600.0;
/// Stages of a task at most: a choice.
const MOST_STAGES: usize = 50;
/// Clips, mistakes and slips are counted up to this.
const MOST: u64 = 1000;

/// The task of a scene with these instruments.
pub(super) fn read_task(mut section: Section<'_>, tools: &[Tool]) -> Result<TaskSource, SceneError> {
    let title = section.string("title")?.ok_or_else(|| section.missing("title", "title = \"Palpation\""))?.0;
    let about = section.string("about")?.map(|about| about.0).unwrap_or_default();
    let begins_in_theatre = read_view(&mut section, tools)?;
    let time_limit_s = section.positive("time_limit", Dimension::Time)?.unwrap_or(LONGEST_S);
    let force_threshold_n = section.positive("force_threshold", Dimension::Force)?;
    let sections = section.sections("stage")?;
    if sections.is_empty() {
        return Err(section.missing("stage", "[[task.stage]] with title and a goal"));
    }
    if sections.len() > MOST_STAGES {
        let found = format!("{} stages", sections.len());
        return Err(section.wrong_table("stage", found, format!("at most {MOST_STAGES}")));
    }
    let stages = sections.into_iter().map(|stage| read_stage(stage, tools)).collect::<Result<_, _>>()?;
    let gate = section.section("gate")?.map(read_gate).transpose()?.unwrap_or_default();
    section.finish()?;
    Ok(TaskSource { title, about, begins_in_theatre, stages, time_limit_s, force_threshold_n, gate })
}

/// `view`: whether the task begins with the endoscope's picture.
fn read_view(section: &mut Section<'_>, tools: &[Tool]) -> Result<bool, SceneError> {
    let Some((view, at)) = section.string("view")? else { return Ok(false) };
    let has_endoscope = tools.iter().any(|tool| tool.kind.optics().is_some());
    match (view.as_str(), has_endoscope) {
        ("laboratory", _) => Ok(false),
        ("theatre", true) => Ok(true),
        _ => {
            let allowed = "laboratory, or with an endoscope among the instruments theatre";
            Err(section.wrong_value(at, "view", format!("\"{view}\""), allowed))
        }
    }
}

fn read_gate(mut section: Section<'_>) -> Result<GateSource, SceneError> {
    let count = |n: Option<u64>| n.map(|n| n as u32);
    let gate = GateSource {
        peak_force_n: section.positive("peak_force", Dimension::Force)?,
        blood_m3: section.positive("blood", Dimension::Volume)?,
        removed_m3: section.positive("removed", Dimension::Volume)?,
        n_mistakes: count(section.whole_number("mistakes", 0..=MOST)?),
        n_slips: count(section.whole_number("slips", 0..=MOST)?),
    };
    section.finish()?;
    Ok(gate)
}

fn read_stage(mut section: Section<'_>, tools: &[Tool]) -> Result<StageSource, SceneError> {
    let title =
        section.string("title")?.ok_or_else(|| section.missing("title", "title = \"Touch the liver\""))?;
    let hint = section.string("hint")?.map(|hint| hint.0);
    let hint_after_s = section.positive("hint_after", Dimension::Time)?.unwrap_or(HINT_AFTER_S);
    let hold_s = section.positive("hold", Dimension::Time)?.unwrap_or(0.0);
    let mut goal = None;
    for row in GOALS {
        let Some(mut table) = section.section(row.key)? else { continue };
        if goal.is_some() {
            return Err(table.wrong_table(row.key, "a second goal".into(), "one goal a stage".into()));
        }
        goal = Some((row.read)(&mut table, tools)?);
        table.finish()?;
    }
    let keys: Vec<&'static str> = GOALS.iter().map(|row| row.key).collect();
    let goal = goal.ok_or_else(|| section.missing_one_of(&keys, GOAL_EXAMPLE))?;
    section.finish()?;
    Ok(StageSource { title: title.0, hint, hint_after_s, hold_s, goal })
}

/// The instrument of a goal, by its name; the only one when there is one.
fn read_tool(table: &mut Section<'_>, tools: &[Tool]) -> Result<usize, SceneError> {
    match table.string("tool")? {
        None if tools.len() == 1 => Ok(0),
        None => Err(table.missing("tool", "tool = \"grasper\", the name of an instrument")),
        Some((name, at)) => tools.iter().position(|tool| tool.name == name).ok_or_else(|| {
            let names: Vec<&str> = tools.iter().map(|tool| tool.name.as_str()).collect();
            let allowed = format!("{}{}", names.join(", "), did_you_mean(&name, &names));
            table.wrong_value(at, "tool", format!("\"{name}\""), &allowed)
        }),
    }
}

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

fn read_reach(table: &mut Section<'_>, tools: &[Tool]) -> Result<GoalSource, SceneError> {
    let tool = read_tool(table, tools)?;
    let point_m = table.required_point("point", POINT)?;
    Ok(GoalSource::Reach { tool, point_m, within_m: table.required_length("within", WITHIN)? })
}

fn read_touch(table: &mut Section<'_>, tools: &[Tool]) -> Result<GoalSource, SceneError> {
    Ok(GoalSource::Touch { tool: read_tool(table, tools)?, near_m: read_near(table)? })
}

fn read_mark(table: &mut Section<'_>, tools: &[Tool]) -> Result<GoalSource, SceneError> {
    let tool = read_tool(table, tools)?;
    let near_m = table.required_point("near", "near = [\"0 mm\", \"-50 mm\", \"0 mm\"]")?;
    Ok(GoalSource::Mark { tool, near_m, within_m: table.required_length("within", WITHIN)? })
}

/// An instrument whose jaws hold tissue.
fn read_holding_tool(
    table: &mut Section<'_>,
    tools: &[Tool],
    goal: &'static str,
) -> Result<usize, SceneError> {
    let tool = read_tool(table, tools)?;
    if tools[tool].kind.holds() {
        return Ok(tool);
    }
    let found = format!("with the {}", tools[tool].kind.name());
    Err(table.wrong_table(goal, found, "an instrument whose jaws hold tissue, such as a grasper".into()))
}

fn read_grasp(table: &mut Section<'_>, tools: &[Tool]) -> Result<GoalSource, SceneError> {
    Ok(GoalSource::Grasp { tool: read_holding_tool(table, tools, "grasp")?, near_m: read_near(table)? })
}

fn read_lift(table: &mut Section<'_>, tools: &[Tool]) -> Result<GoalSource, SceneError> {
    let tool = read_holding_tool(table, tools, "lift")?;
    let point_m = table.required_point("point", POINT)?;
    let by_m = table.required_length("by", "by = \"20 mm\"")?;
    Ok(GoalSource::Lift { tool, point_m, by_m, direction: table.direction("direction")? })
}

/// Whether there is an instrument that divides tissue.
fn check_cuts(table: &Section<'_>, tools: &[Tool], goal: &'static str) -> Result<(), SceneError> {
    let cuts = |tool: &Tool| tool.kind.edge_cuts().is_some() || tool.kind.burning().is_some();
    if tools.iter().any(|tool| cuts(tool) || tool.kind.parting_jaws().is_some()) {
        return Ok(());
    }
    let allowed = "a scalpel, scissors, a hook or a cautery among the instruments".into();
    Err(table.wrong_table(goal, "without an instrument that cuts".into(), allowed))
}

fn read_cut(table: &mut Section<'_>, tools: &[Tool]) -> Result<GoalSource, SceneError> {
    check_cuts(table, tools, "cut")?;
    let (from_m, to_m) = read_ends(table)?;
    let within_m = table.required_length("within", WITHIN)?;
    let share = match table.number("share")? {
        None => SHARE_OF_LINE,
        Some((share, _)) if share > 0.0 && share <= 1.0 => share,
        Some((share, at)) => return Err(wrong_share(table, share, at)),
    };
    Ok(GoalSource::Cut { from_m, to_m, within_m, share })
}

fn wrong_share(table: &Section<'_>, share: f64, at: Value<'_>) -> SceneError {
    table.wrong_value(at, "share", share.to_string(), "more than 0, at most 1")
}

fn read_part(table: &mut Section<'_>, tools: &[Tool]) -> Result<GoalSource, SceneError> {
    check_cuts(table, tools, "part")?;
    let (from_m, to_m) = read_ends(table)?;
    Ok(GoalSource::Part { from_m, to_m })
}

fn read_ends(table: &mut Section<'_>) -> Result<(DVec3, DVec3), SceneError> {
    let from_m = table.required_point("from", "from = [\"0 mm\", \"-50 mm\", \"0 mm\"]")?;
    let to_m = table.required_point("to", "to = [\"30 mm\", \"-50 mm\", \"0 mm\"]")?;
    if from_m == to_m {
        return Err(table.wrong_table("to", "where the line begins".into(), "another place".into()));
    }
    Ok((from_m, to_m))
}

fn read_see(table: &mut Section<'_>, tools: &[Tool]) -> Result<GoalSource, SceneError> {
    let tool = read_tool(table, tools)?;
    if tools[tool].kind.optics().is_none() {
        let found = format!("with the {}", tools[tool].kind.name());
        return Err(table.wrong_table("see", found, "an instrument of the kind endoscope".into()));
    }
    let point_m = table.required_point("point", POINT)?;
    let within_rad = table.positive("within", Dimension::Angle)?.unwrap_or(NEAR_MIDDLE_RAD);
    let nearer_than_m = table.positive("nearer_than", Dimension::Length)?;
    Ok(GoalSource::See { tool, point_m, within_rad, nearer_than_m })
}

fn read_clip(table: &mut Section<'_>, _: &[Tool]) -> Result<GoalSource, SceneError> {
    let n_clips = table.whole_number("count", 1..=MOST)?;
    Ok(GoalSource::Clip { n_clips: n_clips.map_or(1, |n| n as u32) })
}

fn read_bleed(table: &mut Section<'_>, _: &[Tool]) -> Result<GoalSource, SceneError> {
    let below = table.positive("below", Dimension::VolumeFlow)?;
    let below_m3_per_s = below.ok_or_else(|| table.missing("below", "below = \"1 ml/min\""))?;
    Ok(GoalSource::Bleed { below_m3_per_s })
}

#[cfg(test)]
mod tests {
    use super::super::spec::Scene;
    use super::*;

    const SCENE: &str = "glisson_scene = 1\n[organ]\nball = { center = [0, 0, 0], radius = \"4 cm\" }\n\
        tissue = \"liver\"\nmodel = \"implicit\"\n[[tool]]\nname = \"probe\"\nhome_tip = [0, \"-9 cm\", 0]\n\
        home_shaft = [0, -1, 0]\ntip_radius = \"3 mm\"\n[[tool]]\nname = \"left\"\nkind = \"grasper\"\n\
        home_tip = [\"5 cm\", \"-9 cm\", 0]\nhome_shaft = [0, -1, 0]\ntip_radius = \"2 mm\"\n\
        [[tool]]\nname = \"blade\"\nkind = \"scalpel\"\nhome_tip = [\"-5 cm\", \"-9 cm\", 0]\nhome_shaft = [0, -1, 0]\ntip_radius = \"1 mm\"\n";

    fn task(text: &str) -> Result<TaskSource, SceneError> {
        Scene::parse(&format!("{SCENE}{text}")).map(|scene| scene.task.unwrap())
    }

    #[test]
    fn a_task_is_read_with_stages_limits_and_gate() {
        let read = task(
            "[task]\ntitle = \"T\"\nabout = \"A\"\ntime_limit = \"2 min\"\nforce_threshold = \"1 N\"\n\
             [task.gate]\npeak_force = \"5 N\"\nblood = \"20 ml\"\nremoved = \"1 ml\"\nmistakes = 1\nslips = 0\n\
             [[task.stage]]\ntitle = \"a\"\nhint = \"h\"\nhint_after = \"10 s\"\nmark = { tool = \"probe\", near = [0, \"-4 cm\", 0], within = \"8 mm\" }\n\
             [[task.stage]]\ntitle = \"b\"\nhold = \"2 s\"\nlift = { tool = \"left\", point = [0, \"-4 cm\", 0], by = \"1 cm\", direction = [0, -2, 0] }\n\
             [[task.stage]]\ntitle = \"c\"\nbleed = { below = \"6 ml/min\" }\n",
        )
        .unwrap();
        assert_eq!((read.title.as_str(), read.time_limit_s, read.force_threshold_n), ("T", 120.0, Some(1.0)));
        assert_eq!(
            (read.gate.peak_force_n, read.gate.n_mistakes, read.gate.n_slips),
            (Some(5.0), Some(1), Some(0))
        );
        assert!((read.gate.blood_m3.unwrap() - 2e-5).abs() < 1e-18);
        let place_m = DVec3::new(0.0, -0.04, 0.0);
        assert_eq!(read.stages[0].goal, GoalSource::Mark { tool: 0, near_m: place_m, within_m: 8e-3 });
        assert_eq!((read.stages[0].hint_after_s, read.stages[1].hold_s), (10.0, 2.0));
        let direction = Some(DVec3::NEG_Y);
        assert_eq!(
            read.stages[1].goal,
            GoalSource::Lift { tool: 1, point_m: place_m, by_m: 0.01, direction }
        );
        assert!(
            matches!(read.stages[2].goal, GoalSource::Bleed { below_m3_per_s } if (below_m3_per_s - 1e-7).abs() < 1e-18)
        );
    }

    #[test]
    fn what_is_no_task_is_refused() {
        for (text, expected) in [
            ("[task]\n", "[task] lacks \"title\""),
            ("[task]\ntitle = \"T\"\n", "[task] lacks \"stage\""),
            ("[task]\ntitle = \"T\"\nview = \"theatre\"\n", "with an endoscope among the instruments"),
            ("[task]\ntitle = \"T\"\n[[task.stage]]\ntitle = \"a\"\n", "exactly one of reach"),
            ("[task]\ntitle = \"T\"\n[[task.stage]]\ntitle = \"a\"\ntuoch = {}\n", "did you mean \"touch\"?"),
            ("[task]\ntitle = \"T\"\n[[task.stage]]\ntitle = \"a\"\ntouch = {}\n", "lacks \"tool\""),
            (
                "[task]\ntitle = \"T\"\n[[task.stage]]\ntitle = \"a\"\ntouch = { tool = \"lefd\" }\n",
                "did you mean \"left\"?",
            ),
            (
                "[task]\ntitle = \"T\"\n[[task.stage]]\ntitle = \"a\"\ntouch = { tool = \"left\", within = \"1 mm\" }\n",
                "lacks \"near\"",
            ),
            (
                "[task]\ntitle = \"T\"\n[[task.stage]]\ntitle = \"a\"\nclip = {}\nbleed = { below = \"1 ml/min\" }\n",
                "one goal a stage",
            ),
            (
                "[task]\ntitle = \"T\"\n[[task.stage]]\ntitle = \"a\"\ncut = { from = [0, 0, 0], to = [0, 0, 0], within = \"1 mm\" }\n",
                "another place",
            ),
            (
                "[task]\ntitle = \"T\"\n[[task.stage]]\ntitle = \"a\"\ncut = { from = [0, 0, 0], to = [0, 0, \"1 cm\"], within = \"1 mm\", share = 2 }\n",
                "at most 1",
            ),
        ] {
            let error = task(text).unwrap_err().to_string();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }
}
