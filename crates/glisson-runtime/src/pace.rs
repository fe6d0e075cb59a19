//! How the simulation and what it publishes for displays keep their time, against their budgets.

use crate::effort::Load;
use crate::histogram::{Histogram, Percentiles};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Time between two published states: a little under a display's frame.
pub(crate) const FRAME: Duration = Duration::from_millis(16);

/// How the simulation keeps up with the clock; measured outside the library.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pace {
    /// Steps a second of wall time.
    pub rate_hz: f64,
    /// Simulated time over wall time.
    pub real_time_factor: f64,
    /// Whether the simulation stands still because somebody asked for it.
    pub paused: bool,
    /// Simulated time over wall time that was asked for; none for real time.
    pub slow_motion: Option<f64>,
}

/// Measures pace over about half a second.
pub(crate) struct PaceMeter {
    since: Instant,
    steps: u64,
    busy: Duration,
    /// As it was measured last.
    pub(crate) pace: Pace,
}

impl PaceMeter {
    pub(crate) fn new(now: Instant) -> Self {
        Self { since: now, steps: 0, busy: Duration::ZERO, pace: Pace::default() }
    }

    /// Steps that took so long; answers how the last half second went when it is over.
    pub(crate) fn count(&mut self, steps: u64, busy: Duration, dt_s: f64) -> Option<Load> {
        self.steps += steps;
        self.busy += busy;
        let elapsed_s = self.since.elapsed().as_secs_f64();
        if elapsed_s < 0.5 {
            return None;
        }
        self.pace.rate_hz = self.steps as f64 / elapsed_s;
        self.pace.real_time_factor = self.pace.rate_hz * dt_s;
        let busy_share = self.busy.as_secs_f64() / elapsed_s;
        self.restart();
        Some(Load { real_time_factor: self.pace.real_time_factor, busy_share })
    }

    pub(crate) fn restart(&mut self) {
        self.since = Instant::now();
        self.steps = 0;
        self.busy = Duration::ZERO;
    }
}

/// What the simulation's thread counts; any thread may look.
#[derive(Debug, Default)]
pub struct StepMeters {
    step: Histogram,
    frame: Histogram,
    budget_ns: AtomicU64,
    n_over: AtomicU64,
}

/// How it did so far.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepTimes {
    /// Time that a step takes, with what the devices are told of it.
    pub(crate) step: Percentiles,
    /// What it may take in real time: the scene's time step [ns].
    pub(crate) budget_ns: u64,
    /// Steps that took longer.
    pub(crate) n_over: u64,
    /// From one state published for displays to the next, while time passes.
    pub(crate) frame: Percentiles,
}

fn ns(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

impl StepMeters {
    /// For steps of which each may take `budget`.
    pub(crate) fn within(budget: Duration) -> Self {
        Self { budget_ns: AtomicU64::new(ns(budget)), ..Self::default() }
    }

    /// What each step may take from now on.
    pub(crate) fn set_budget(&self, budget: Duration) {
        self.budget_ns.store(ns(budget), Ordering::Relaxed);
    }

    /// A step took so long. One thread counts.
    pub(crate) fn count_step(&self, time: Duration) {
        let time_ns = ns(time);
        self.step.record(time_ns);
        if time_ns > self.budget_ns.load(Ordering::Relaxed) {
            self.n_over.store(self.n_over.load(Ordering::Relaxed) + 1, Ordering::Relaxed);
        }
    }

    /// Displays got a state so long after the one before. One thread counts.
    pub(crate) fn count_frame(&self, interval: Duration) {
        self.frame.record(ns(interval));
    }

    /// How it did so far.
    pub fn times(&self) -> StepTimes {
        StepTimes {
            step: self.step.percentiles(),
            budget_ns: self.budget_ns.load(Ordering::Relaxed),
            n_over: self.n_over.load(Ordering::Relaxed),
            frame: self.frame.percentiles(),
        }
    }
}

impl StepTimes {
    /// Two lines for people.
    pub fn to_text(self) -> String {
        let Self { step, budget_ns, n_over, frame } = self;
        let us = |ns: u64| format!("{:.0}", ns as f64 * 1e-3);
        let ms = |ns: u64| format!("{:.1}", ns as f64 * 1e-6);
        let over_percent = 100.0 * n_over as f64 / step.n.max(1) as f64;
        format!(
            "simulation       a step {} us (99 %: {}, 99.9 %: {}) of {} us; {n_over} of {} took longer ({over_percent:.2} %)\n  \
             to displays     every {} ms (99 %: {}, 99.9 %: {}); wanted: {} ms",
            us(step.p50_ns),
            us(step.p99_ns),
            us(step.p999_ns),
            us(budget_ns),
            step.n,
            ms(frame.p50_ns),
            ms(frame.p99_ns),
            ms(frame.p999_ns),
            ms(ns(FRAME)),
        )
    }

    /// The fields that `glisson bench haptics` and the viewer's `timing` message have of it.
    pub fn to_json(self) -> serde_json::Value {
        serde_json::json!({
            "steps": self.step.n,
            "step_us": self.step.to_json(1e3),
            "step_budget_us": self.budget_ns as f64 * 1e-3,
            "steps_over_budget": self.n_over,
            "frame_ms": self.frame.to_json(1e6),
            "frame_budget_ms": ns(FRAME) as f64 * 1e-6,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_beyond_their_budget_are_counted_and_told() {
        let meters = StepMeters::within(Duration::from_millis(1));
        for micros in [200, 400, 999, 1_000, 1_001, 3_000] {
            meters.count_step(Duration::from_micros(micros));
        }
        meters.count_frame(Duration::from_millis(17));
        let times = meters.times();
        assert_eq!((times.n_over, times.step.n, times.budget_ns), (2, 6, 1_000_000));
        assert_eq!((times.step.greatest_ns, times.frame.greatest_ns), (3_000_000, 17_000_000));
        let json = times.to_json();
        assert_eq!((&json["steps_over_budget"], &json["step_us"]["max"]), (&2.into(), &3_000.0.into()));
        assert_eq!((&json["frame_ms"]["max"], &json["frame_budget_ms"]), (&17.0.into(), &16.0.into()));
        let text = times.to_text();
        assert!(
            text.contains("of 1000 us; 2 of 6 took longer (33.33 %)") && text.contains("every 17.0 ms"),
            "{text}"
        );
        // Before the first step.
        assert!(StepTimes::default().to_text().contains("0 of 0 took longer (0.00 %)"));
    }
}
