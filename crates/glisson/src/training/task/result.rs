//! What came of a task: its metrics, the moments that went wrong, and whether it is safe.

use super::cut_line::CutQuality;
use super::events::EventNews;
use super::excision::Excised;
use crate::scene::{GateSource, TaskSource};
use crate::training::gestures::{gestures, slips};
use crate::training::metrics::{Better, GRIP_OF_PORCINE_LIVER_N, Measured, MetricValue, Validity, measure};
use crate::training::moments::{Moment, moments};
use crate::training::trace::Trace;
use serde::{Deserialize, Serialize};

/// How a task ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// All stages were done.
    Done,
    /// Its time was over.
    TimeOver,
}

/// A stage that was done.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StageResult {
    /// What was to be done.
    pub title: String,
    /// When it began [s after the task's beginning].
    pub began_s: f64,
    /// When it was done [s].
    pub ended_s: f64,
}

/// A metric of a task.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MetricLine {
    /// Its name.
    pub name: &'static str,
    /// Its name for people.
    pub title: &'static str,
    /// The instrument; none for one of the whole task.
    pub tool: Option<String>,
    /// Its value.
    pub value: f64,
    /// SI unit; empty for a plain number.
    pub unit: &'static str,
    /// Which way is better.
    pub better: Better,
    /// How it is computed.
    pub formula: &'static str,
    /// Where it comes from.
    pub source: &'static str,
    /// What is known of its validity.
    pub validity: Validity,
}

/// A line of the safety gate.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GateLine {
    /// What must not be more, or less where it says so.
    pub title: &'static str,
    /// What was found.
    pub found: f64,
    /// What is allowed.
    pub allowed: f64,
    /// SI unit; empty for a number.
    pub unit: &'static str,
    /// Whether it was kept.
    pub is_kept: bool,
}

/// Time that an instrument spent with a gesture.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GestureTime {
    /// The instrument.
    pub tool: String,
    /// The gesture.
    pub gesture: &'static str,
    /// How often.
    pub count: usize,
    /// How long in all [s].
    pub time_s: f64,
}

/// What came of a task.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TaskResult {
    /// What the task is called.
    pub title: String,
    /// The level that it was done at; none if it has no levels.
    pub level: Option<String>,
    /// How it ended; none while it goes on, or where it broke off.
    pub outcome: Option<Outcome>,
    /// Simulated time at which it began [s]; none before an instrument has moved. All other times count from then on.
    pub began_s: Option<f64>,
    /// Whether all stages were done within the gate.
    pub is_passed: bool,
    /// Stages in all.
    pub n_stages: usize,
    /// Those that were done.
    pub stages: Vec<StageResult>,
    /// The safety gate.
    pub gate: Vec<GateLine>,
    /// All metrics.
    pub metrics: Vec<MetricLine>,
    /// Events that can come, and when they did.
    pub events: Vec<EventNews>,
    /// What went wrong, by time.
    pub moments: Vec<Moment>,
    /// What the instruments did.
    pub gestures: Vec<GestureTime>,
}

/// What was written down of a task, for its assessment.
#[derive(Clone, Debug, PartialEq)]
pub struct TaskRecord {
    pub(super) source: TaskSource,
    pub(super) trace: Trace,
    pub(super) outcome: Option<Outcome>,
    pub(super) began_s: Option<f64>,
    pub(super) stages: Vec<StageResult>,
    pub(super) mistakes: Vec<Moment>,
    pub(super) events: Vec<EventNews>,
    pub(super) qualities: Vec<CutQuality>,
    pub(super) excised: Option<Excised>,
}

impl TaskRecord {
    /// Instruments, forces and blood at regular times.
    pub fn trace(&self) -> &Trace {
        &self.trace
    }

    /// Simulated time at which the task began [s]; none before an instrument has moved.
    pub fn began_s(&self) -> Option<f64> {
        self.began_s
    }

    /// Force between an instrument and tissue above which it is noted [N].
    pub fn threshold_n(&self) -> f64 {
        self.source.force_threshold_n.unwrap_or(GRIP_OF_PORCINE_LIVER_N)
    }

    /// The assessment. Takes some milliseconds a minute: not for every step.
    pub fn result(&self) -> TaskResult {
        let Self { source: task, trace, outcome, began_s, stages, mistakes, events, qualities, excised } =
            self;
        let threshold_n = self.threshold_n();
        let mut all = moments(trace, threshold_n);
        all.extend(mistakes.iter().cloned());
        all.sort_by(|a, b| a.from_s.total_cmp(&b.from_s));
        let values = measure(&Measured::new(trace, threshold_n));
        let mut metrics: Vec<MetricLine> = values.iter().map(|value| line(trace, value)).collect();
        let tried = ("", "goals that were tried in the wrong way or place");
        metrics.push(own_line("mistakes", "Mistakes", mistakes.len() as f64, tried));
        metrics.extend(cut_lines(qualities));
        metrics.extend(excised.iter().flat_map(excision_lines));
        // What was not measured is no margin.
        let margin_m = excised.and_then(|excised| excised.margins_m).map_or(0.0, |[least_m, _]| least_m);
        let mut gate = gate_lines(&task.gate, trace, mistakes.len());
        gate.extend(task.gate.least_margin_m.map(|least_m| GateLine {
            title: "margin, at least",
            found: margin_m,
            allowed: least_m,
            unit: "m",
            is_kept: margin_m >= least_m,
        }));
        TaskResult {
            title: task.title.clone(),
            level: task.level.clone(),
            outcome: *outcome,
            began_s: *began_s,
            is_passed: *outcome == Some(Outcome::Done) && gate.iter().all(|line| line.is_kept),
            n_stages: task.stages.len(),
            stages: stages.clone(),
            gate,
            metrics,
            events: events.clone(),
            moments: all,
            gestures: gesture_times(trace),
        }
    }
}

impl TaskResult {
    /// The value of a metric, of the whole task or of an instrument.
    pub fn metric(&self, name: &str, tool: Option<&str>) -> Option<f64> {
        let found = self.metrics.iter().find(|line| line.name == name && line.tool.as_deref() == tool);
        found.map(|line| line.value)
    }
}

fn line(trace: &Trace, value: &MetricValue) -> MetricLine {
    let metric = value.metric;
    MetricLine {
        name: metric.name,
        title: metric.title,
        tool: value.tool.map(|tool| trace.tools[tool].name.clone()),
        value: value.value,
        unit: metric.unit,
        better: metric.better,
        formula: metric.formula,
        source: metric.source,
        validity: metric.validity,
    }
}

/// A metric of tasks alone, the smaller the better.
fn own_line(
    name: &'static str,
    title: &'static str,
    value: f64,
    (unit, formula): (&'static str, &'static str),
) -> MetricLine {
    let (better, validity) = (Better::Less, Validity::None);
    MetricLine { name, title, tool: None, value, unit, better, formula, source: "ours", validity }
}

/// Of all lines that were to be cut: the least share, the mean and the greatest error.
fn cut_lines(qualities: &[CutQuality]) -> Vec<MetricLine> {
    let share = qualities.iter().map(|quality| quality.share).reduce(f64::min);
    let errors_m: Vec<[f64; 2]> = qualities.iter().filter_map(|quality| quality.errors_m).collect();
    let mean_m = errors_m.iter().map(|errors_m| errors_m[0]).sum::<f64>() / errors_m.len() as f64;
    let greatest_m = errors_m.iter().map(|errors_m| errors_m[1]).reduce(f64::max);
    let along =
        "length of the line beside which a cut runs, near enough, over its length; the least of all lines";
    let mean = "mean distance of the cut's edge from its line, in the surface at rest; what is further away than four times what is \
                allowed is another cut";
    let mut lines = Vec::new();
    if let Some(share) = share {
        let line = own_line("cut_share", "Share of the line that is cut", share, ("", along));
        lines.push(MetricLine { better: Better::More, ..line });
    }
    // What is not cut has no error.
    if let Some(greatest_m) = greatest_m {
        lines.push(own_line("cut_error_mean", "Mean cut error", mean_m, ("m", mean)));
        let greatest = "greatest distance of the cut's edge from its line, as the mean";
        lines.push(own_line("cut_error_greatest", "Greatest cut error", greatest_m, ("m", greatest)));
    }
    lines
}

/// Of what was cut out.
fn excision_lines(excised: &Excised) -> Vec<MetricLine> {
    let specimen = "volume at rest of the pieces that hold what was to be cut out";
    let mut lines =
        vec![own_line("specimen_volume", "Volume cut out", excised.specimen_m3, ("m3", specimen))];
    if let Some([least_m, mean_m]) = excised.margins_m {
        let least = "least distance of the specimen's cut faces from the ball that was to be cut out, at rest; negative: cut into";
        let mean = "mean of that distance over the area of the faces, at their middles";
        for (name, title, value, formula) in
            [("margin_least", "Least margin", least_m, least), ("margin_mean", "Mean margin", mean_m, mean)]
        {
            let line = own_line(name, title, value, ("m", formula));
            lines.push(MetricLine { better: Better::More, ..line });
        }
    }
    lines
}

fn gate_lines(gate: &GateSource, trace: &Trace, n_mistakes: usize) -> Vec<GateLine> {
    let peaks_n = trace.tools.iter().flat_map(|tool| tool.peak_force_n.iter().copied());
    let last = |values: &[f64]| values.last().copied().unwrap_or(0.0);
    let n_slips: usize = trace.tools.iter().map(|tool| slips(trace, tool).len()).sum();
    let count = |n: Option<u32>| n.map(f64::from);
    [
        ("greatest force", "N", gate.peak_force_n, peaks_n.fold(0.0, f64::max)),
        ("blood lost", "m3", gate.blood_m3, last(&trace.blood_lost_m3)),
        ("tissue taken out", "m3", gate.removed_m3, last(&trace.removed_m3)),
        ("mistakes", "", count(gate.n_mistakes), n_mistakes as f64),
        ("slips", "", count(gate.n_slips), n_slips as f64),
    ]
    .into_iter()
    .filter_map(|(title, unit, allowed, found)| {
        let allowed = allowed?;
        Some(GateLine { title, found, allowed, unit, is_kept: found <= allowed })
    })
    .collect()
}

fn gesture_times(trace: &Trace) -> Vec<GestureTime> {
    let mut times: Vec<GestureTime> = Vec::new();
    for tool in &trace.tools {
        for gesture in gestures(trace, tool) {
            let (name, time_s) = (gesture.kind.name(), (gesture.to - gesture.from) as f64 * trace.period_s);
            match times.iter_mut().find(|time| time.tool == tool.name && time.gesture == name) {
                Some(time) => (time.count, time.time_s) = (time.count + 1, time.time_s + time_s),
                None => times.push(GestureTime { tool: tool.name.clone(), gesture: name, count: 1, time_s }),
            }
        }
    }
    times
}
