//! Results as text: CSV with a row for each metric (RFC 4180), and JSON that can be imported again.

use crate::attempt::{AttemptResult, Kept};
use crate::groups::Group;
use crate::store::StoredResult;
use glisson::training::task::Outcome;
use serde_json::json;

/// Version of the JSON file.
pub const JSON_VERSION: u32 = 1;

const COLUMNS: [&str; 16] = [
    "result",
    "person",
    "task",
    "title",
    "scene_hash",
    "finished_at",
    "seed",
    "level",
    "is_passed",
    "outcome",
    "duration_s",
    "session",
    "metric",
    "tool",
    "value",
    "unit",
];

/// A row for each metric of each result, below a row of the columns' names; lines end with CR LF. A result without metrics has
/// one row, whose last four fields are empty.
pub fn csv(results: &[StoredResult]) -> String {
    let mut text = row(&COLUMNS.map(str::to_owned));
    for StoredResult { id, person, kept, result, duration_s } in results {
        let attempt = &kept.attempt;
        let AttemptResult { title, outcome, is_passed, metrics } = result;
        let number = |value: Option<u32>| value.map(|value| value.to_string()).unwrap_or_default();
        let outcome = match outcome {
            Some(Outcome::Done) => "done",
            Some(Outcome::TimeOver) => "time_over",
            None => "",
        };
        let of_result = [
            id.to_string(),
            person.clone(),
            attempt.task.clone(),
            title.clone(),
            attempt.scene_hash.clone(),
            attempt.finished_at.clone(),
            number(attempt.seed),
            attempt.level.clone().unwrap_or_default(),
            u8::from(*is_passed).to_string(),
            outcome.to_owned(),
            duration_s.map(|duration_s| duration_s.to_string()).unwrap_or_default(),
            attempt.session.clone().unwrap_or_default(),
        ];
        for metric in metrics {
            let value = metric.value.map(|value| value.to_string()).unwrap_or_default();
            let tool = metric.tool.clone().unwrap_or_default();
            let of_metric = [metric.name.clone(), tool, value, metric.unit.clone()];
            text += &row(&[&of_result[..], &of_metric].concat());
        }
        if metrics.is_empty() {
            text += &row(&[&of_result[..], &[(); 4].map(|()| String::new())].concat());
        }
    }
    text
}

/// A line: fields with commas, quotes or line ends stand in quotes, and quotes in them are doubled.
fn row(fields: &[String]) -> String {
    let quoted = |field: &String| {
        // A spreadsheet would take it for a formula. Numbers begin with a digit or a minus and a digit.
        let is_formula = field.starts_with(['=', '@', '+', '\t'])
            || (field.starts_with('-') && field.parse::<f64>().is_err());
        let field = if is_formula { &format!("'{field}") } else { field };
        if field.contains([',', '"', '\r', '\n']) {
            format!("\"{}\"", field.replace('"', "\"\""))
        } else {
            field.clone()
        }
    };
    fields.iter().map(quoted).collect::<Vec<_>>().join(",") + "\r\n"
}

/// All of the results and groups.
pub fn json(results: &[StoredResult], groups: &[Group]) -> serde_json::Value {
    let results: Vec<serde_json::Value> = results
        .iter()
        .map(
            |stored| json!({ "id": stored.id, "attempt": stored.kept.attempt, "result": stored.kept.result }),
        )
        .collect();
    let groups: Vec<serde_json::Value> =
        groups.iter().map(|group| json!({ "name": group.name, "people": group.people })).collect();
    json!({ "glisson_results": JSON_VERSION, "results": results, "groups": groups })
}

/// Why a file has no results.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// It is no JSON, or has not the fields.
    #[error("it is no result: {0}")]
    NoResult(#[from] serde_json::Error),
    /// A result that does not tell whose it is.
    #[error(
        "it has a `result` and no `attempt`, which tells whose and when; run the task again with this program"
    )]
    NoAttempt,
    /// A later program's.
    #[error("found version {found} of exported results; allowed: {JSON_VERSION}")]
    Newer {
        /// Its version.
        found: u64,
    },
}

/// The results in the text of a file: one of a task, or all of [`json`]. Groups are not read.
///
/// # Errors
/// [`ReadError`] where it is neither.
pub fn read(text: &str) -> Result<Vec<Kept>, ReadError> {
    let value: serde_json::Value = serde_json::from_str(text)?;
    if let Some(version) = value.get("glisson_results") {
        let found = version.as_u64().unwrap_or(0);
        if found != u64::from(JSON_VERSION) {
            return Err(ReadError::Newer { found });
        }
        return Ok(serde_json::from_value(value["results"].clone())?);
    }
    if value.get("result").is_some() && value.get("attempt").is_none() {
        return Err(ReadError::NoAttempt);
    }
    Ok(vec![serde_json::from_value(value)?])
}
