//! `[task]`: what somebody who trains has to do in a scene, and within which limits.

mod tool_name;
mod line;
mod goal;
mod event;
mod gate;
mod level;

pub(crate) use event::share_of_jerk;
pub use event::{EffectSource, EventSource, EventTime};
pub use gate::GateSource;
pub use goal::GoalSource;
pub use line::LineSource;

use super::bodies::SceneBody;
use super::reader::{SceneError, Section};
use crate::tool::Tool;
use crate::units::Dimension;
use gate::read_gate;
use level::{Levels, read_patients};

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
    /// What happens to who does it, at its level.
    pub events: Vec<EventSource>,
    /// The level that it is done at; none if it has no levels.
    pub level: Option<String>,
    /// All levels.
    pub levels: Vec<String>,
    /// Synthetic patients that may be chosen.
    pub patients: Vec<u32>,
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

/// A hint that says no time is shown after this [s]: a choice.
const HINT_AFTER_S: f64 = 30.0;
/// Time limit of a task that gives none [s]: nobody trains longer without a break, and what is written down grows. A choice.
const LONGEST_S: f64 = 3600.0;
/// Stages, and events, of a task at most: a choice.
const MOST_STAGES: usize = 50;

/// The scene of a task.
pub(in crate::scene) struct TaskScene<'a> {
    /// Its instruments.
    pub(in crate::scene) tools: &'a [Tool],
    /// Its bodies; none for one organ alone.
    pub(in crate::scene) bodies: &'a [SceneBody],
    /// Whether its organ is of a patient whose seed is written there.
    pub(in crate::scene) has_seed: bool,
}

/// The task of a scene.
pub(super) fn read_task(mut section: Section<'_>, scene: &TaskScene<'_>) -> Result<TaskSource, SceneError> {
    let tools = scene.tools;
    let title = section.string("title")?.ok_or_else(|| section.missing("title", "title = \"Palpation\""))?.0;
    let about = section.string("about")?.map(|about| about.0).unwrap_or_default();
    let begins_in_theatre = read_view(&mut section, tools)?;
    let mut time_limit_s = section.positive("time_limit", Dimension::Time)?.unwrap_or(LONGEST_S);
    let force_threshold_n = section.positive("force_threshold", Dimension::Force)?;
    let sections = section.sections("stage")?;
    if sections.is_empty() {
        return Err(section.missing("stage", "[[task.stage]] with title and a goal"));
    }
    if sections.len() > MOST_STAGES {
        let found = format!("{} stages", sections.len());
        return Err(section.wrong_table("stage", found, format!("at most {MOST_STAGES}")));
    }
    let mut stages: Vec<StageSource> =
        sections.into_iter().map(|stage| read_stage(stage, scene)).collect::<Result<_, _>>()?;
    let mut gate = section.section("gate")?.map(read_gate).transpose()?.unwrap_or_default();
    let seed = section.whole_number("seed", 0..=u64::from(u32::MAX))?.unwrap_or(0);
    let events = section.sections("event")?;
    if events.len() > MOST_STAGES {
        let found = format!("{} events", events.len());
        return Err(section.wrong_table("event", found, format!("at most {MOST_STAGES}")));
    }
    let events = event::read_events(events, tools, stages.len(), seed)?;
    let levels = Levels::read(&mut section)?;
    let events = levels.events(&section, events)?;
    if let Some(level) = levels.chosen {
        time_limit_s = level.time_limit_s.unwrap_or(time_limit_s);
        gate = level.gate.unwrap_or(gate);
        for stage in &mut stages {
            stage.hint_after_s = level.hint_after_s.unwrap_or(stage.hint_after_s);
            stage.hint = stage.hint.take().filter(|_| level.has_hints);
        }
    }
    let excises = stages.iter().any(|stage| matches!(stage.goal, GoalSource::Excise { .. }));
    if gate.least_margin_m.is_some() && !excises {
        let allowed = "beside a stage with excise = { center, radius }".into();
        return Err(section.wrong_table("margin", "without anything to excise".into(), allowed));
    }
    let patients = read_patients(&mut section)?;
    if !patients.is_empty() && !scene.has_seed {
        let allowed = "beside phantom = { organ, seed = ... }, whose seed they take the place of".into();
        return Err(section.wrong_table("patients", "without a seed in phantom".into(), allowed));
    }
    section.finish()?;
    let (level, levels) = (levels.name, levels.names);
    Ok(TaskSource {
        title,
        about,
        begins_in_theatre,
        stages,
        time_limit_s,
        force_threshold_n,
        gate,
        events,
        level,
        levels,
        patients,
    })
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

fn read_stage(mut section: Section<'_>, scene: &TaskScene<'_>) -> Result<StageSource, SceneError> {
    let title =
        section.string("title")?.ok_or_else(|| section.missing("title", "title = \"Touch the liver\""))?;
    let hint = section.string("hint")?.map(|hint| hint.0);
    let hint_after_s = section.positive("hint_after", Dimension::Time)?.unwrap_or(HINT_AFTER_S);
    let hold_s = section.positive("hold", Dimension::Time)?.unwrap_or(0.0);
    let goal = goal::read_goal(&mut section, scene)?;
    section.finish()?;
    Ok(StageSource { title: title.0, hint, hint_after_s, hold_s, goal })
}

#[cfg(test)]
mod tests {
    use super::super::spec::Scene;
    use super::*;
    use crate::math::DVec3;

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
    fn lines_are_straight_through_points_or_circles() {
        let line = |cut: &str| {
            let stage = format!("[[task.stage]]\ntitle = \"a\"\ncut = {{ {cut}, within = \"1 mm\" }}\n");
            let goal = task(&format!("[task]\ntitle = \"T\"\n{stage}")).unwrap().stages[0].goal.clone();
            let GoalSource::Cut { line, .. } = goal else { panic!("{goal:?}") };
            (line.points_m, line.is_closed)
        };
        let ends = vec![DVec3::ZERO, DVec3::new(0.0, 0.0, 0.01)];
        assert_eq!(line("from = [0, 0, 0], to = [0, 0, \"1 cm\"]"), (ends.clone(), false));
        assert_eq!(line("points = [[0, 0, 0], [0, 0, \"1 cm\"]]"), (ends, false));
        let (points_m, is_closed) =
            line("circle = { center = [0, 0, \"5 mm\"], radius = \"2 cm\", normal = [0, 0, 3] }");
        assert!(is_closed && points_m.len() == 72);
        let center_m = DVec3::new(0.0, 0.0, 5e-3);
        assert!(points_m.iter().all(|point_m| (point_m.distance(center_m) - 0.02).abs() < 1e-15));
        assert!(points_m.iter().all(|point_m| (point_m.z - 5e-3).abs() < 1e-15));
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
            (
                "[task]\ntitle = \"T\"\n[[task.stage]]\ntitle = \"a\"\ncut = { points = [[0, 0, 0], [0, 0, \"1 cm\"]], closed = true, within = \"1 mm\" }\n",
                "3 to 1000 points",
            ),
            (
                "[task]\ntitle = \"T\"\n[[task.stage]]\ntitle = \"a\"\ncut = { circle = { center = [0, 0, 0], radius = \"1 cm\" }, within = \"1 mm\" }\n",
                "lacks \"normal\"",
            ),
            (
                "[task]\ntitle = \"T\"\n[[task.stage]]\ntitle = \"a\"\nexcise = { center = [0, 0, 0] }\n",
                "lacks \"radius\"",
            ),
        ] {
            let error = task(text).unwrap_err().to_string();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }
}
