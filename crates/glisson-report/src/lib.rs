//! The report of a task as one HTML page: what was done, what it was measured by, what went wrong and when, and plots. Also without a
//! server, in the page that simulates.
//!
//! ```text
//! numbers -> plot -> SVG
//! TaskRecord, TaskResult (glisson::training), Comparison (glisson_results) -> task_report -> HTML
//! ```

pub mod plot;
mod words;
mod comparison;

pub use comparison::curve_plot;

use crate::plot::{LinePlot, Series, SeriesStyle};
use comparison::{cells, group_text, write_curves};
use glisson::training::metrics::{Better, Validity};
use glisson::training::moments::Moment;
use glisson::training::task::{
    EventNews, GateLine, GestureTime, MetricLine, Outcome, StageResult, TaskRecord, TaskResult,
};
use glisson::training::trace::Trace;
use glisson::units::for_people;
use glisson_results::Comparison;
use std::fmt::Write as _;
use words::{escaped, number};

const STYLE: &str = "body{font:16px/1.45 system-ui,sans-serif;color:#22282f;background:#fff;max-width:60rem;margin:2rem auto;padding:0 1rem}\
    h1{font-size:1.6rem;margin-bottom:.2rem}h2{font-size:1.15rem;margin-top:2rem}table{border-collapse:collapse;width:100%}\
    th,td{text-align:left;padding:.3rem .6rem;border-bottom:1px solid #dfe3e8;vertical-align:top}td.n{text-align:right;white-space:nowrap;\
    font-variant-numeric:tabular-nums}.good{color:#00694d;font-weight:600}.bad{color:#a33c00;font-weight:600}.small{color:#59636e;font-size:.88rem}\
    svg{max-width:100%;height:auto}td.box{white-space:nowrap}td.box svg{max-width:none}";

const PLOT_SIZE: [u32; 2] = [880, 260];
/// Points of a plot's line at most: more are not seen.
const MOST_POINTS: usize = 2000;

/// What stands around an assessment in its report.
#[derive(Clone, Copy, Debug, Default)]
pub struct ReportContext<'a> {
    /// Link to the simulation's page.
    pub back: Option<&'a str>,
    /// Link to the session's replay (docs/replay.md), at whose times moments are looked at.
    pub replay: Option<&'a str>,
    /// The result beside others.
    pub comparison: Option<&'a Comparison>,
    /// What the reader should know of how the result was stored.
    pub note: Option<&'a str>,
}

/// The report of what was written down and its assessment.
pub fn task_report(record: &TaskRecord, result: &TaskResult, context: &ReportContext<'_>) -> String {
    let mut html = String::new();
    // Writing to a string does not fail.
    let _ = write_report(&mut html, record, result, context);
    html
}

fn write_report(
    html: &mut String,
    record: &TaskRecord,
    result: &TaskResult,
    &ReportContext { back, replay, comparison, note }: &ReportContext<'_>,
) -> std::fmt::Result {
    let title = escaped(&result.title);
    write!(
        html,
        "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">\
         <title>{title}: report</title><style>{STYLE}</style></head><body><main><h1>{title}</h1>"
    )?;
    let (class, how) = match result.outcome {
        Some(Outcome::Done) if result.is_passed => {
            ("good", "Passed: all stages done, within the safety gate.")
        }
        Some(Outcome::Done) => ("bad", "Not passed: all stages done, but beyond the safety gate."),
        Some(Outcome::TimeOver) => ("bad", "Not passed: the time was over."),
        None => ("bad", "Not finished."),
    };
    write!(html, "<p class=\"{class}\">{how}</p>")?;
    if let Some(level) = &result.level {
        write!(html, "<p>Level: {}.</p>", escaped(level))?;
    }
    if let Some(back) = back {
        write!(html, "<p><a href=\"{}\">Back to the simulation</a></p>", escaped(back))?;
    }
    if let Some(Comparison { id, person, .. }) = comparison {
        write!(html, "<p class=\"small\">{}, result {id}</p>", escaped(person))?;
    }
    if let Some(note) = note {
        write!(html, "<p class=\"bad\">{}</p>", escaped(note))?;
    }
    if let Some(replay) = replay {
        write!(html, "<p><a href=\"{}\">Replay of the session</a></p>", escaped(replay))?;
    }
    write_stages(html, result)?;
    write_gate(html, &result.gate)?;
    // A recording counts from the session's beginning, a task from the first motion of an instrument.
    let began_s = result.began_s.unwrap_or(0.0);
    let link = replay.map(|replay| move |from_s: f64| format!("{replay}#t={:.2}", began_s + from_s));
    write_events(html, &result.events)?;
    write_moments(html, record, &result.moments, link.as_ref().map(|link| link as &dyn Fn(f64) -> String))?;
    write_metrics(html, &result.metrics, comparison)?;
    if let Some(comparison) = comparison {
        write_curves(html, &comparison.curves)?;
    }
    write_plots(html, record)?;
    write_gestures(html, &result.gestures)?;
    html.push_str("</main></body></html>\n");
    Ok(())
}

fn write_stages(html: &mut String, result: &TaskResult) -> std::fmt::Result {
    write!(
        html,
        "<h2>Stages</h2><p>{} of {} done.</p><table><tr><th>stage<th>from [s]<th>to [s]<th>time [s]",
        result.stages.len(),
        result.n_stages
    )?;
    for StageResult { title, began_s, ended_s } in &result.stages {
        let title = escaped(title);
        write!(
            html,
            "<tr><td>{title}<td class=\"n\">{began_s:.2}<td class=\"n\">{ended_s:.2}<td class=\"n\">{:.2}",
            ended_s - began_s
        )?;
    }
    html.push_str("</table>");
    Ok(())
}

fn write_gate(html: &mut String, gate: &[GateLine]) -> std::fmt::Result {
    if gate.is_empty() {
        return Ok(());
    }
    html.push_str("<h2>Safety gate</h2><p class=\"small\">What must not happen, whatever else was good.</p><table><tr><th>what<th>found<th>allowed<th>");
    for line in gate {
        let ((found, _), (allowed, unit)) =
            (for_people(line.found, line.unit), for_people(line.allowed, line.unit));
        let (class, word) = if line.is_kept { ("good", "kept") } else { ("bad", "broken") };
        let (found, allowed) = (number(found), number(allowed));
        write!(
            html,
            "<tr><td>{}<td class=\"n\">{found} {unit}<td class=\"n\">{allowed} {unit}<td class=\"{class}\">{word}",
            line.title
        )?;
    }
    html.push_str("</table>");
    Ok(())
}

/// Events that came, and those that could have.
fn write_events(html: &mut String, events: &[EventNews]) -> std::fmt::Result {
    if events.is_empty() {
        return Ok(());
    }
    html.push_str("<h2>Events</h2><table><tr><th>what<th>at [s]");
    for EventNews { title, came_s } in events {
        let came = came_s.map_or_else(|| "did not come".to_owned(), |came_s| format!("{came_s:.2}"));
        write!(html, "<tr><td>{}<td class=\"n\">{came}", escaped(title))?;
    }
    html.push_str("</table>");
    Ok(())
}

/// `link` answers where in the replay a time is.
fn write_moments(
    html: &mut String,
    record: &TaskRecord,
    moments: &[Moment],
    link: Option<&dyn Fn(f64) -> String>,
) -> std::fmt::Result {
    html.push_str("<h2>What went wrong, and when</h2>");
    if moments.is_empty() {
        html.push_str("<p>Nothing that is looked for.</p>");
        return Ok(());
    }
    let where_to_look =
        if link.is_some() { "each leads to the replay" } else { "they are where to look in the replay" };
    write!(html, "<p class=\"small\">Times are from the beginning of the task; {where_to_look}.</p>")?;
    html.push_str("<table><tr><th>at [s]<th>for [s]<th>what<th>more");
    for Moment { fault, from_s, to_s, tool, detail } in moments {
        let named =
            tool.map(|tool| record.trace().tools[tool].name.as_str()).filter(|name| !detail.contains(name));
        let more = named.map_or_else(|| detail.clone(), |name| format!("{name} {detail}"));
        let (what, more) = (fault.title(), escaped(&more));
        let at = match link {
            Some(link) => format!("<a href=\"{}\">{from_s:.2}</a>", escaped(&link(*from_s))),
            None => format!("{from_s:.2}"),
        };
        write!(html, "<tr><td class=\"n\">{at}<td class=\"n\">{:.2}<td>{what}<td>{more}", to_s - from_s)?;
    }
    html.push_str("</table>");
    Ok(())
}

fn write_metrics(
    html: &mut String,
    metrics: &[MetricLine],
    comparison: Option<&Comparison>,
) -> std::fmt::Result {
    html.push_str(
        "<h2>Metrics</h2><p class=\"small\">Each by itself: there is no sum in which one could hide another.</p>",
    );
    html.push_str(&comparison.and_then(group_text).unwrap_or_default());
    // A group that is too small fills no column.
    let has_quartiles = |all: &&Comparison| all.metrics.iter().any(|metric| metric.quartiles.is_some());
    let group = comparison.filter(has_quartiles);
    let headings = if group.is_some() { "<th>group: quartiles<th>beside it" } else { "" };
    write!(
        html,
        "<table><tr><th>metric<th>instrument<th>value<th>better{headings}<th>how, from where, and whether it tells skill"
    )?;
    for line in metrics {
        let (value, unit) = for_people(line.value, line.unit);
        let better = match line.better {
            Better::Less => "less",
            Better::More => "more",
            Better::Neither => "",
        };
        let validity = match line.validity {
            Validity::AllTasks => "told experience apart in all tasks of the source",
            Validity::SomeTasks => "told experience apart in some tasks of the source",
            Validity::Defined => "defined there; not known here whether it tells skill",
            Validity::None => "not known whether it tells skill",
        };
        let tool = escaped(line.tool.as_deref().unwrap_or_default());
        let (title, formula, source) = (line.title, escaped(line.formula), escaped(line.source));
        let beside = group.map(|all| cells(all.metric(line.name, line.tool.as_deref())));
        write!(
            html,
            "<tr><td>{title}<td>{tool}<td class=\"n\">{} {unit}<td>{better}{}<td class=\"small\">{formula}. {source}: {validity}.",
            number(value),
            beside.unwrap_or_default()
        )?;
    }
    html.push_str("</table>");
    Ok(())
}

fn write_gestures(html: &mut String, gestures: &[GestureTime]) -> std::fmt::Result {
    html.push_str("<h2>Gestures</h2><table><tr><th>instrument<th>gesture<th>times<th>in all [s]");
    for GestureTime { tool, gesture, count, time_s } in gestures {
        let tool = escaped(tool);
        write!(html, "<tr><td>{tool}<td>{gesture}<td class=\"n\">{count}<td class=\"n\">{time_s:.1}")?;
    }
    html.push_str("</table>");
    Ok(())
}

fn write_plots(html: &mut String, record: &TaskRecord) -> std::fmt::Result {
    let trace = record.trace();
    let force = trace.tools.iter().map(|tool| line(trace, &tool.name, &tool.peak_force_n));
    let limit = Series {
        name: "threshold".into(),
        points: [0.0, trace.duration_s()].map(|time_s| [time_s, record.threshold_n()]).to_vec(),
        style: SeriesStyle::Dashed,
    };
    let mut plots = vec![plot("Force on the instruments", "force [N]", force.chain([limit]).collect())];
    let speed = trace.tools.iter().map(|tool| {
        let tips_m = tool.tips_m();
        let speeds = tips_m.windows(2).map(|pair| 1e3 * pair[0].distance(pair[1]) / trace.period_s);
        line(trace, &tool.name, &speeds.collect::<Vec<_>>())
    });
    plots.push(plot("Speed of the tips", "speed [mm/s]", speed.collect()));
    if trace.blood_lost_m3.last().is_some_and(|lost_m3| *lost_m3 > 0.0) {
        let lost_ml: Vec<f64> = trace.blood_lost_m3.iter().map(|lost_m3| 1e6 * lost_m3).collect();
        plots.push(plot("Blood lost", "blood [ml]", vec![line(trace, "", &lost_ml)]));
    }
    html.push_str("<h2>Plots</h2>");
    for plot in plots {
        // A plot without a point is none.
        if let Ok(svg) = plot.to_svg() {
            write!(html, "<figure role=\"img\" aria-label=\"{}\">{svg}</figure>", plot.title)?;
        }
    }
    Ok(())
}

fn plot(title: &str, y_label: &str, series: Vec<Series>) -> LinePlot {
    let (x_label, y_label) = ("time [s]".to_string(), y_label.to_string());
    LinePlot { title: title.into(), x_label, y_label, series, size: PLOT_SIZE }
}

/// Values at the samples of a trace: the greatest of every few, where there are many.
fn line(trace: &Trace, name: &str, values: &[f64]) -> Series {
    let few = values.len().div_ceil(MOST_POINTS).max(1);
    let point = |(nth, values): (usize, &[f64])| {
        [trace.time_s(nth * few), values.iter().copied().fold(f64::NEG_INFINITY, f64::max)]
    };
    let points = values.chunks(few).enumerate().map(point).collect();
    Series { name: name.into(), points, style: SeriesStyle::Line }
}
