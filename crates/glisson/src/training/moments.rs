//! The moments of a session that a reviewer wants to see: each with its time, so that it is a place in the replay.

use super::gestures::slips;
use super::trace::Trace;
use serde::Serialize;

/// What went wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Fault {
    /// The force between an instrument and tissue was above the threshold.
    ForceAboveThreshold,
    /// Tissue slipped out of closed jaws.
    Slip,
    /// Two instruments pressed on each other.
    Clash,
    /// More blood comes than at the sample before.
    Bleeding,
    /// The task's goal was tried in the wrong way or place.
    Mistake,
}

impl Fault {
    /// What it is called.
    pub fn title(self) -> &'static str {
        match self {
            Self::ForceAboveThreshold => "force above the threshold",
            Self::Slip => "tissue slipped out of the jaws",
            Self::Clash => "instruments pressed on each other",
            Self::Bleeding => "it began to bleed more",
            Self::Mistake => "mistake",
        }
    }
}

/// A moment.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Moment {
    /// What.
    pub fault: Fault,
    /// When it began [s].
    pub from_s: f64,
    /// When it ended [s].
    pub to_s: f64,
    /// The instrument, if it was one.
    pub tool: Option<usize>,
    /// More about it: the greatest force, what was marked.
    pub detail: String,
}

/// Two stretches of the same fault that are nearer than this are one [s]: a choice.
const SAME_WITHIN_S: f64 = 0.2;
/// Bleeding that grows by more than this is a vessel that was opened [m3/s]: 0.1 ml/min, a choice.
const MORE_BLEEDING_M3_PER_S: f64 = 1e-7 / 60.0;

/// All moments of a trace that need no task, by time.
pub fn moments(trace: &Trace, threshold_n: f64) -> Vec<Moment> {
    let mut found = Vec::new();
    for (place, tool) in trace.tools.iter().enumerate() {
        let is_above = |at: usize| tool.peak_force_n[at] > threshold_n;
        for (from, to) in stretches(trace, is_above) {
            let peak_n = tool.peak_force_n[from..to].iter().copied().fold(0.0, f64::max);
            let detail = format!("{}: up to {peak_n:.2} N, threshold {threshold_n:.2} N", tool.name);
            found.push(moment(trace, Fault::ForceAboveThreshold, (from, to), Some(place), detail));
        }
        for at in slips(trace, tool) {
            found.push(moment(trace, Fault::Slip, (at, at + 1), Some(place), tool.name.clone()));
        }
    }
    for (from, to) in stretches(trace, |at| trace.n_clashing[at] > 0) {
        found.push(moment(trace, Fault::Clash, (from, to), None, String::new()));
    }
    let grows = |at: usize| {
        at > 0 && trace.bleeding_m3_per_s[at] - trace.bleeding_m3_per_s[at - 1] > MORE_BLEEDING_M3_PER_S
    };
    for (from, to) in stretches(trace, grows) {
        let ml_per_min = 60e6 * trace.bleeding_m3_per_s[to - 1];
        found.push(moment(
            trace,
            Fault::Bleeding,
            (from, to),
            None,
            format!("{ml_per_min:.1} ml/min in all"),
        ));
    }
    found.sort_by(|a, b| a.from_s.total_cmp(&b.from_s));
    found
}

fn moment(
    trace: &Trace,
    fault: Fault,
    (from, to): (usize, usize),
    tool: Option<usize>,
    detail: String,
) -> Moment {
    Moment { fault, from_s: trace.time_s(from), to_s: trace.time_s(to), tool, detail }
}

/// First sample and the one behind the last of each stretch where `is` holds; those that are near each other are one.
fn stretches(trace: &Trace, is: impl Fn(usize) -> bool) -> Vec<(usize, usize)> {
    let near = (SAME_WITHIN_S / trace.period_s).round() as usize;
    let mut found: Vec<(usize, usize)> = Vec::new();
    for at in (0..trace.n_samples()).filter(|&at| is(at)) {
        match found.last_mut() {
            Some((_, to)) if at - *to < near => *to = at + 1,
            _ => found.push((at, at + 1)),
        }
    }
    found
}
