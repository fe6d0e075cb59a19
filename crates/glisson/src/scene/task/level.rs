//! `[[task.level]]`: how hard a task is, and the patients that it may be done with.

use super::super::reader::{SceneError, Section};
use super::event::EventSource;
use super::gate::{GateSource, read_gate};
use crate::text::did_you_mean;
use crate::units::Dimension;

/// What a level changes.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Level {
    pub(super) time_limit_s: Option<f64>,
    pub(super) hint_after_s: Option<f64>,
    pub(super) has_hints: bool,
    pub(super) gate: Option<GateSource>,
}

/// The levels of a task, and the one that is chosen.
pub(super) struct Levels {
    pub(super) names: Vec<String>,
    pub(super) name: Option<String>,
    pub(super) chosen: Option<Level>,
}

/// Levels and patients of a task at most: a choice.
const MOST: usize = 50;

impl Levels {
    pub(super) fn read(task: &mut Section<'_>) -> Result<Self, SceneError> {
        let (mut names, mut all) = (Vec::new(), Vec::new());
        for section in task.sections("levels")? {
            let (name, level) = read_level(section)?;
            if names.contains(&name) || names.len() == MOST {
                let found = format!("\"{name}\" once more, or the {MOST}th level and more");
                return Err(task.wrong_table("levels", found, "a name of its own for each level".into()));
            }
            names.push(name);
            all.push(level);
        }
        let Some((name, at)) = task.string("level")? else {
            return match names.first() {
                None => Ok(Self { names, name: None, chosen: None }),
                Some(_) => {
                    Err(task.missing("level", "level = \"normal\", the name of one of [[task.levels]]"))
                }
            };
        };
        let Some(chosen) = names.iter().position(|known| *known == name) else {
            let known: Vec<&str> = names.iter().map(String::as_str).collect();
            let allowed = format!("{}{}", named(&names), did_you_mean(&name, &known));
            return Err(task.wrong_value(at, "level", format!("\"{name}\""), &allowed));
        };
        Ok(Self { names, name: Some(name), chosen: Some(all.swap_remove(chosen)) })
    }

    /// The events that come at the chosen level.
    pub(super) fn events(
        &self,
        task: &Section<'_>,
        events: Vec<(EventSource, Vec<String>)>,
    ) -> Result<Vec<EventSource>, SceneError> {
        let mut kept = Vec::new();
        for (event, levels) in events {
            if let Some(unknown) = levels.iter().find(|level| !self.names.contains(level)) {
                let found = format!("\"{unknown}\" of the event \"{}\"", event.title);
                return Err(task.wrong_table("levels", found, named(&self.names)));
            }
            if levels.is_empty() || self.name.as_ref().is_some_and(|name| levels.contains(name)) {
                kept.push(event);
            }
        }
        Ok(kept)
    }
}

fn named(levels: &[String]) -> String {
    if levels.is_empty() { "none: the task has no [[task.levels]]".into() } else { levels.join(", ") }
}

fn read_level(mut section: Section<'_>) -> Result<(String, Level), SceneError> {
    let name = section.string("name")?.ok_or_else(|| section.missing("name", "name = \"normal\""))?.0;
    let level = Level {
        time_limit_s: section.positive("time_limit", Dimension::Time)?,
        hint_after_s: section.positive("hint_after", Dimension::Time)?,
        has_hints: section.flag("hints")?.unwrap_or(true),
        gate: section.section("gate")?.map(read_gate).transpose()?,
    };
    section.finish()?;
    Ok((name, level))
}

/// `patients`: seeds of synthetic patients.
pub(super) fn read_patients(task: &mut Section<'_>) -> Result<Vec<u32>, SceneError> {
    let patients = task.whole_numbers("patients", 0..=u64::from(u32::MAX))?.unwrap_or_default();
    if patients.len() > MOST {
        let found = format!("{} patients", patients.len());
        return Err(task.wrong_table("patients", found, format!("at most {MOST}")));
    }
    Ok(patients.into_iter().map(|patient| patient as u32).collect())
}
