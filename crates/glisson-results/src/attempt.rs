//! What is kept of an attempt at a task.

use crate::name::{NameError, checked_name};
use crate::utc::is_utc_text;
use glisson::training::metrics::Better;
use glisson::training::task::Outcome;
use serde::{Deserialize, Serialize};

/// Who tried which task, and when.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Attempt {
    /// Name or pseudonym; none for an attempt of nobody, as that of a demonstration, which is not stored.
    #[serde(default)]
    pub person: Option<String>,
    /// Name of the task: that of `glisson task list`, or of the scene's file without its ending.
    pub task: String,
    /// [`scene_hash`] of the scene's text: results of a changed task are not compared with those from before.
    pub scene_hash: String,
    /// When it ended, as [`crate::utc::utc_text`] writes it.
    pub finished_at: String,
    /// Seed of a task that is made at random.
    #[serde(default)]
    pub seed: Option<u32>,
    /// Level of a task that has several.
    #[serde(default)]
    pub level: Option<String>,
    /// The recorded session's file.
    #[serde(default)]
    pub session: Option<String>,
}

/// The hash by which scenes are told apart: BLAKE3 of the text, in hexadecimal digits. Files that a scene names are not in it.
pub fn scene_hash(text: &str) -> String {
    blake3::hash(text.as_bytes()).to_hex().to_string()
}

/// A metric as it is kept. Reads what `glisson::training::task::TaskResult` writes; what else it has there is not looked at.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct KeptMetric {
    /// Its name.
    pub name: String,
    /// Its name for people.
    pub title: String,
    /// The instrument; none for one of the whole task.
    pub tool: Option<String>,
    /// Its value; none where it was no finite number.
    pub value: Option<f64>,
    /// SI unit; empty for a plain number.
    pub unit: String,
    /// Which way is better.
    pub better: Better,
}

/// What is read of a result, to find and compare it; the whole of it is kept as text.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct AttemptResult {
    /// What the task is called.
    pub title: String,
    /// How it ended; none where it broke off.
    pub outcome: Option<Outcome>,
    /// Whether all stages were done within the safety gate.
    pub is_passed: bool,
    /// All metrics.
    pub metrics: Vec<KeptMetric>,
}

impl AttemptResult {
    /// The metric of that name, of the whole task or of an instrument.
    pub fn metric(&self, name: &str, tool: Option<&str>) -> Option<&KeptMetric> {
        self.metrics.iter().find(|metric| metric.name == name && metric.tool.as_deref() == tool)
    }

    /// For people.
    pub fn outcome_text(&self) -> &'static str {
        match self.outcome {
            Some(Outcome::Done) if self.is_passed => "passed",
            Some(Outcome::Done) => "done, beyond the safety gate",
            Some(Outcome::TimeOver) => "its time was over",
            None => "broken off",
        }
    }
}

/// An attempt with its result: what is stored, and what a file of a result holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Kept {
    /// Who tried which task, and when.
    pub attempt: Attempt,
    /// The whole result.
    pub result: serde_json::Value,
}

/// Why an attempt cannot be kept.
#[derive(Debug, thiserror::Error)]
pub enum KeptError {
    /// Nobody did it.
    #[error("it has no person; give one with --person NAME")]
    NoPerson,
    /// The person's name is none.
    #[error(transparent)]
    Person(#[from] NameError),
    /// A field has not its form.
    #[error("`attempt.{field}` is \"{found}\"; allowed: {allowed}")]
    Field {
        /// Which.
        field: &'static str,
        /// What it is.
        found: String,
        /// What it may be.
        allowed: &'static str,
    },
    /// The result cannot be read.
    #[error("its `result` is not that of a task: {0}")]
    Result(serde_json::Error),
}

impl Kept {
    /// The person and what is read of the result, checked.
    ///
    /// # Errors
    /// [`KeptError`] names the field.
    pub fn checked(&self) -> Result<(String, AttemptResult), KeptError> {
        let Attempt { person, task, scene_hash, finished_at, .. } = &self.attempt;
        let person = checked_name(person.as_deref().ok_or(KeptError::NoPerson)?)?;
        let wrong = |field, found: &str, allowed| {
            let found = found.chars().take(100).collect();
            Err(KeptError::Field { field, found, allowed })
        };
        if task.is_empty() || task.chars().count() > 200 || task.chars().any(char::is_control) {
            return wrong("task", task, "1 to 200 printed letters");
        }
        if scene_hash.len() != 64 || !scene_hash.bytes().all(|c| matches!(c, b'0'..=b'9' | b'a'..=b'f')) {
            return wrong("scene_hash", scene_hash, "64 digits 0 to 9 and a to f");
        }
        if !is_utc_text(finished_at) {
            return wrong("finished_at", finished_at, "a time such as 2026-03-09T14:05:07.250Z");
        }
        let texts = [("level", &self.attempt.level), ("session", &self.attempt.session)];
        for (field, text) in texts.into_iter().filter_map(|(field, text)| Some((field, text.as_ref()?))) {
            if text.chars().count() > 4096 || text.chars().any(char::is_control) {
                return wrong(field, text, "at most 4096 printed letters");
            }
        }
        let result = AttemptResult::deserialize(&self.result).map_err(KeptError::Result)?;
        Ok((person, result))
    }
}
