//! `[[task.event]]`: what happens to who does a task, and when.

use super::super::reader::{SceneError, Section};
use super::tool_name::read_tool;
use crate::math::{DVec3, SeededRandom};
use crate::tool::Tool;
use crate::units::Dimension;
use std::f64::consts::TAU;

/// An event of a task.
#[derive(Clone, Debug, PartialEq)]
pub struct EventSource {
    /// What it is called, for who teaches and in the report.
    pub title: String,
    /// When it comes by itself.
    pub time: EventTime,
    /// What it does.
    pub effect: EffectSource,
}

/// When an event comes by itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum EventTime {
    /// So long after the task's beginning [s].
    At {
        /// When [s].
        time_s: f64,
    },
    /// So long after a stage's beginning.
    InStage {
        /// Which stage, from 0.
        stage: usize,
        /// How long after its beginning [s].
        after_s: f64,
    },
    /// Only when somebody who watches says so.
    Never,
}

/// What an event does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum EffectSource {
    /// The vessel that is nearest to a place at rest tears there.
    Bleed {
        /// The place [m].
        near_m: DVec3,
    },
    /// The endoscope's lamp is out for a while.
    LightOut {
        /// How long [s].
        for_s: f64,
    },
    /// An instrument does not close and does not work: its jaws are open and its trigger is dead.
    Fail {
        /// Which one.
        tool: usize,
        /// How long [s].
        for_s: f64,
    },
    /// All tissue jerks, as when a patient coughs: half a sine of an acceleration beside gravity.
    Jerk {
        /// Its greatest value [m/s2].
        acceleration_m_per_s2: DVec3,
        /// How long [s].
        for_s: f64,
    },
}

impl EffectSource {
    /// How long it lasts [s]; 0 of what happens at once.
    pub fn lasts_s(&self) -> f64 {
        match *self {
            Self::Bleed { .. } => 0.0,
            Self::LightOut { for_s } | Self::Fail { for_s, .. } | Self::Jerk { for_s, .. } => for_s,
        }
    }
}

/// The half sine of a jerk, so long after its beginning: 0 to 1.
pub(crate) fn share_of_jerk(after_s: f64, for_s: f64) -> f64 {
    libm::sin(0.5 * TAU * (after_s / for_s).clamp(0.0, 1.0))
}

/// Effects of an event, of which it has one.
const EFFECTS: [&str; 4] = ["bleed", "light_out", "fail", "jerk"];
const EFFECT_EXAMPLE: &str = "light_out = { for = \"5 s\" }; exactly one of bleed, light_out, fail, jerk";
const FOR: &str = "for = \"5 s\"";

/// The events of a task with these instruments and so many stages, each with the levels that it comes at, or none for all; `seed`
/// draws times at random.
pub(super) fn read_events(
    sections: Vec<Section<'_>>,
    tools: &[Tool],
    n_stages: usize,
    seed: u64,
) -> Result<Vec<(EventSource, Vec<String>)>, SceneError> {
    let numbered = sections.into_iter().zip(0_u64..);
    numbered.map(|(section, number)| read_event(section, tools, n_stages, (seed, number))).collect()
}

fn read_event(
    mut section: Section<'_>,
    tools: &[Tool],
    n_stages: usize,
    seed: (u64, u64),
) -> Result<(EventSource, Vec<String>), SceneError> {
    let title =
        section.string("title")?.ok_or_else(|| section.missing("title", "title = \"The light fails\""))?.0;
    let time = read_time(&mut section, n_stages, seed)?;
    let effect = read_effect(&mut section, tools)?;
    let levels = section.strings("levels")?.map(|levels| levels.0).unwrap_or_default();
    section.finish()?;
    Ok((EventSource { title, time, effect }, levels))
}

/// `at`, `between`, or `stage` with `after`.
fn read_time(
    section: &mut Section<'_>,
    n_stages: usize,
    (seed, number): (u64, u64),
) -> Result<EventTime, SceneError> {
    let at_s = section.positive("at", Dimension::Time)?;
    let between = section.section("between")?;
    let stage = section.whole_number("stage", 1..=n_stages as u64)?;
    let after_s = section.positive("after", Dimension::Time)?;
    let one_time = "one of at, between and stage (with after), or none".to_string();
    match (at_s, between, stage, after_s) {
        (Some(time_s), None, None, None) => Ok(EventTime::At { time_s }),
        (None, Some(mut between), None, None) => {
            let mut end = |key, example| {
                between.positive(key, Dimension::Time)?.ok_or_else(|| between.missing(key, example))
            };
            let (from_s, to_s) = (end("from", "from = \"10 s\"")?, end("to", "to = \"40 s\"")?);
            if to_s <= from_s {
                return Err(between.wrong_table("to", format!("{to_s} s"), format!("later than {from_s} s")));
            }
            between.finish()?;
            // A sequence of its own: what one event draws does not depend on the others.
            let mut random = SeededRandom::new(seed ^ (number + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15));
            Ok(EventTime::At { time_s: random.uniform_in(from_s, to_s) })
        }
        (None, None, Some(stage), after_s) => {
            Ok(EventTime::InStage { stage: stage as usize - 1, after_s: after_s.unwrap_or(0.0) })
        }
        (None, None, None, None) => Ok(EventTime::Never),
        (None, None, None, Some(_)) => Err(section.missing("stage", "stage = 1")),
        _ => Err(section.wrong_table("at", "more than one time".into(), one_time)),
    }
}

fn read_effect(section: &mut Section<'_>, tools: &[Tool]) -> Result<EffectSource, SceneError> {
    let mut effect = None;
    for key in EFFECTS {
        let Some(mut table) = section.section(key)? else { continue };
        if effect.is_some() {
            return Err(table.wrong_table(key, "a second effect".into(), "one effect an event".into()));
        }
        let for_s = |table: &mut Section<'_>| {
            table.positive("for", Dimension::Time)?.ok_or_else(|| table.missing("for", FOR))
        };
        effect = Some(match key {
            "bleed" => {
                let near = "near = [\"0 mm\", \"-50 mm\", \"0 mm\"]";
                EffectSource::Bleed { near_m: table.required_point("near", near)? }
            }
            "light_out" => EffectSource::LightOut { for_s: for_s(&mut table)? },
            "fail" => EffectSource::Fail { tool: read_tool(&mut table, tools)?, for_s: for_s(&mut table)? },
            _ => {
                let example = "acceleration = [0, 0, \"-3 m/s2\"]";
                let acceleration = table.vector("acceleration", Dimension::Acceleration)?;
                let acceleration_m_per_s2 =
                    acceleration.ok_or_else(|| table.missing("acceleration", example))?;
                EffectSource::Jerk { acceleration_m_per_s2, for_s: for_s(&mut table)? }
            }
        });
        table.finish()?;
    }
    effect.ok_or_else(|| section.missing_one_of(&EFFECTS, EFFECT_EXAMPLE))
}

#[cfg(test)]
mod tests {
    use super::super::super::spec::Scene;
    use super::*;

    const SCENE: &str = "glisson_scene = 1\n[organ]\nball = { center = [0, 0, 0], radius = \"4 cm\" }\n\
        tissue = \"liver\"\nmodel = \"implicit\"\n[tool]\nname = \"probe\"\nhome_tip = [0, \"-9 cm\", 0]\n\
        home_shaft = [0, -1, 0]\ntip_radius = \"3 mm\"\n";

    fn events(seed: u64, text: &str) -> Result<Vec<EventSource>, SceneError> {
        let task = format!(
            "[task]\ntitle = \"T\"\nseed = {seed}\n[[task.stage]]\ntitle = \"a\"\ntouch = {{}}\n{text}"
        );
        Scene::parse(&format!("{SCENE}{task}")).map(|scene| scene.task.unwrap().events)
    }

    #[test]
    fn events_come_by_time_by_stage_at_random_or_by_hand() {
        let text = "[[task.event]]\ntitle = \"a\"\nat = \"5 s\"\nlight_out = { for = \"2 s\" }\n\
            [[task.event]]\ntitle = \"b\"\nstage = 1\nafter = \"3 s\"\nfail = { for = \"1 s\" }\n\
            [[task.event]]\ntitle = \"c\"\nbetween = { from = \"10 s\", to = \"20 s\" }\njerk = { acceleration = [0, 0, \"-3 m/s2\"], for = \"0.3 s\" }\n\
            [[task.event]]\ntitle = \"d\"\nlight_out = { for = \"2 s\" }\n";
        let read = events(1, text).unwrap();
        assert_eq!(read[0].time, EventTime::At { time_s: 5.0 });
        assert_eq!(read[0].effect, EffectSource::LightOut { for_s: 2.0 });
        assert_eq!(read[1].time, EventTime::InStage { stage: 0, after_s: 3.0 });
        assert_eq!(read[1].effect, EffectSource::Fail { tool: 0, for_s: 1.0 });
        let time_of = |seed| match events(seed, text).unwrap()[2].time {
            EventTime::At { time_s } => time_s,
            other => panic!("{other:?}"),
        };
        assert_eq!(time_of(1), time_of(1));
        let times: Vec<f64> = (1..20).map(time_of).collect();
        assert!(times.iter().all(|time_s| (10.0..20.0).contains(time_s)), "{times:?}");
        assert!(times.iter().any(|time_s| (*time_s - times[0]).abs() > 3.0), "{times:?}");
        assert_eq!(read[3].time, EventTime::Never);
    }

    #[test]
    fn what_is_no_event_is_refused() {
        for (text, expected) in [
            ("[[task.event]]\n", "lacks \"title\""),
            ("[[task.event]]\ntitle = \"a\"\n", "exactly one of bleed"),
            (
                "[[task.event]]\ntitle = \"a\"\nat = \"1 s\"\nstage = 1\nlight_out = { for = \"1 s\" }\n",
                "one of at, between and stage",
            ),
            (
                "[[task.event]]\ntitle = \"a\"\nstage = 2\nlight_out = { for = \"1 s\" }\n",
                "a whole number from 1 to 1",
            ),
            ("[[task.event]]\ntitle = \"a\"\nlight_out = {}\n", "lacks \"for\""),
            (
                "[[task.event]]\ntitle = \"a\"\nbetween = { from = \"5 s\", to = \"4 s\" }\nlight_out = { for = \"1 s\" }\n",
                "later than 5 s",
            ),
        ] {
            let error = events(1, text).unwrap_err().to_string();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }
}
