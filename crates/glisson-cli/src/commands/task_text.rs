//! The result of a task as text.

use glisson::training::moments::Moment;
use glisson::training::task::{GateLine, MetricLine, Outcome, TaskResult};
use glisson::units::for_people;
use std::fmt::Write as _;

/// The result as lines for a terminal.
pub(super) fn task_text(result: &TaskResult) -> String {
    let mut text = String::new();
    // Writing to a string does not fail.
    let _ = write_result(&mut text, result);
    text
}

fn write_result(text: &mut String, result: &TaskResult) -> std::fmt::Result {
    let how = match result.outcome {
        Some(Outcome::Done) if result.is_passed => "done, passed",
        Some(Outcome::Done) => "done, beyond the safety gate",
        Some(Outcome::TimeOver) => "its time was over",
        None => "not done",
    };
    writeln!(
        text,
        "task             {}: {how}; {} of {} stages",
        result.title,
        result.stages.len(),
        result.n_stages
    )?;
    for stage in &result.stages {
        writeln!(text, "  stage          {} ({:.1} s)", stage.title, stage.ended_s - stage.began_s)?;
    }
    for GateLine { title, found, allowed, unit, is_kept } in &result.gate {
        let ((found, _), (allowed, unit)) = (for_people(*found, unit), for_people(*allowed, unit));
        let sign = if *is_kept { "kept" } else { "BROKEN" };
        writeln!(text, "  gate           {title} {found:.3} {unit}, allowed {allowed:.3}: {sign}")?;
    }
    for MetricLine { title, tool, value, unit, .. } in &result.metrics {
        let (value, unit) = for_people(*value, unit);
        let of = tool.as_ref().map(|tool| format!(" ({tool})")).unwrap_or_default();
        writeln!(text, "  {title}{of}: {value:.3} {unit}")?;
    }
    for Moment { fault, from_s, detail, .. } in &result.moments {
        writeln!(text, "  at {from_s:7.2} s   {}: {detail}", fault.title())?;
    }
    Ok(())
}
