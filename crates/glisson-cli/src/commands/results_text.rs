//! Results as text.

use glisson::training::metrics::Better;
use glisson::units::for_people;
use glisson_results::comparison::{MetricComparison, NamedCurve};
use glisson_results::statistics::{FEWEST_FOR_QUARTILES, Standing};
use glisson_results::store::StoredResult;
use glisson_results::{Attempt, Comparison};
use std::fmt::Write as _;

/// The level and the patient of an attempt.
fn variant_text(attempt: &Attempt) -> String {
    let patient = attempt.seed.map(|seed| format!("patient {seed}"));
    let parts: Vec<String> = attempt.level.clone().into_iter().chain(patient).collect();
    parts.join(", ")
}

/// A line for each result.
pub(super) fn list_text(results: &[StoredResult]) -> String {
    if results.is_empty() {
        return "no results\n".into();
    }
    let row = |stored: &StoredResult| {
        let time = stored.duration_s.map(|time_s| format!("{time_s:.1} s")).unwrap_or_default();
        let attempt = &stored.kept.attempt;
        // Seconds are enough for people.
        let when = format!("{}Z", attempt.finished_at.get(..19).unwrap_or(&attempt.finished_at));
        [
            stored.id.to_string(),
            when,
            stored.person.clone(),
            attempt.task.clone(),
            variant_text(attempt),
            time,
            stored.result.outcome_text().into(),
        ]
    };
    let headings = ["number", "when", "who", "task", "of", "time", "how"].map(str::to_owned);
    let rows: Vec<[String; 7]> = std::iter::once(headings).chain(results.iter().map(row)).collect();
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..7).map(width).collect();
    let line = |row: &[String; 7]| {
        let cells = row.iter().zip(&widths).map(|(cell, width)| format!("{cell:width$}"));
        format!("{}\n", cells.collect::<Vec<_>>().join("  ").trim_end())
    };
    rows.iter().map(line).collect()
}

/// All metrics of a result, and where they lie among a group.
pub(super) fn comparison_text(stored: &StoredResult, comparison: &Comparison) -> String {
    let mut text = String::new();
    // Writing to a string does not fail.
    let _ = write_comparison(&mut text, stored, comparison);
    text
}

fn write_comparison(text: &mut String, stored: &StoredResult, comparison: &Comparison) -> std::fmt::Result {
    let attempt = &stored.kept.attempt;
    writeln!(text, "result {}   {} at {} ({})", stored.id, stored.person, attempt.task, stored.result.title)?;
    writeln!(text, "when       {}", attempt.finished_at)?;
    writeln!(text, "how        {}", stored.result.outcome_text())?;
    if let Some(session) = &attempt.session {
        writeln!(text, "session    {session}")?;
    }
    if let Some(reference) = &comparison.reference {
        let (group, n) = (&reference.group, reference.n_people);
        write!(text, "group      {group}: {n} people other than {} have passed this task", stored.person)?;
        let few = n < FEWEST_FOR_QUARTILES;
        writeln!(
            text,
            "{}",
            if few { format!("; quartiles need {FEWEST_FOR_QUARTILES}") } else { String::new() }
        )?;
    }
    for metric in &comparison.metrics {
        let MetricComparison { of, title, value, unit, quartiles, standing, better, .. } = metric;
        let name = of.tool.as_ref().map_or_else(|| title.clone(), |tool| format!("{title} ({tool})"));
        let shown = |value: f64| format!("{:.3}", for_people(value, unit).0);
        let value = value.map_or_else(|| "no number".into(), shown);
        write!(text, "  {name}: {value} {}", for_people(0.0, unit).1)?;
        if let Some(quartiles) = quartiles {
            let [first, median, third] = [quartiles.first, quartiles.median, quartiles.third].map(shown);
            write!(text, "   quartiles {first} | {median} | {third}")?;
        }
        let better = match better {
            Better::Less => "less is better",
            Better::More => "more is better",
            Better::Neither => "it describes",
        };
        match standing {
            Some(Standing::As) => writeln!(text, ": as the group")?,
            Some(standing) => writeln!(text, ": {} ({better})", standing.text())?,
            None => writeln!(text)?,
        }
    }
    Ok(())
}

/// A learning curve as lines.
pub(super) fn curve_text(named: &NamedCurve) -> String {
    let NamedCurve { of, title, unit, curve } = named;
    let shown = |value: f64| {
        let (value, unit) = for_people(value, unit);
        format!("{value:.3} {unit}").trim_end().to_owned()
    };
    let name = of.tool.as_ref().map_or_else(|| title.clone(), |tool| format!("{title} ({tool})"));
    let mut text = format!("{name}: {} attempts, {} of them done\n", curve.n_attempts, curve.points.len());
    if let Some(band) = curve.band {
        let [first, median, third] = [band.first, band.median, band.third].map(shown);
        text += &format!("  quartiles of the group: {first} | {median} | {third}\n");
    }
    for (attempt, value) in &curve.points {
        text += &format!("  {attempt:4}  {}\n", shown(*value));
    }
    text
}
