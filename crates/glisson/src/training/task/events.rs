//! Events of a task: when they come, and what they do as long as they last.

use crate::math::DVec3;
use crate::scene::{EffectSource, EventSource, EventTime, share_of_jerk};
use crate::tool::{MAX_TOOLS, ToolInput};
use serde::Serialize;

/// What events do to a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Effects {
    /// Instruments that do not work.
    pub fails: [bool; MAX_TOOLS],
    /// Acceleration of all tissue beside gravity [m/s2].
    pub acceleration_m_per_s2: DVec3,
}

impl Effects {
    /// What becomes of what a hand does with an instrument: one that fails does not close and does not work.
    #[must_use]
    pub fn on(&self, tool: usize, input: ToolInput) -> ToolInput {
        if self.fails[tool] { ToolInput { jaw_opening: 1.0, trigger: 0.0, ..input } } else { input }
    }
}

/// An event, for who teaches and for the report.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EventNews {
    /// What it is called.
    pub title: String,
    /// When it came [s after the task's beginning]; none before.
    pub came_s: Option<f64>,
}

/// The events of a task that is done.
#[derive(Clone, Debug)]
pub(super) struct Events {
    sources: Vec<EventSource>,
    came_s: Vec<Option<f64>>,
    /// Places of vessels that tear now, at rest [m].
    tears_m: Vec<DVec3>,
}

impl Events {
    pub(super) fn new(sources: &[EventSource]) -> Self {
        let n = sources.len();
        Self { sources: sources.to_vec(), came_s: vec![None; n], tears_m: Vec::with_capacity(n) }
    }

    /// Lets those come whose time is there.
    pub(super) fn advance(&mut self, now_s: f64, stage: usize, stage_began_s: f64) {
        for number in 0..self.sources.len() {
            let is_due = match self.sources[number].time {
                EventTime::At { time_s } => now_s >= time_s,
                EventTime::InStage { stage: of, after_s } => stage == of && now_s >= stage_began_s + after_s,
                EventTime::Never => false,
            };
            if is_due {
                self.come(number, now_s);
            }
        }
    }

    /// Lets one come, if it has not come yet; answers whether it did.
    pub(super) fn come(&mut self, number: usize, now_s: f64) -> bool {
        let Some(came_s) = self.came_s.get_mut(number).filter(|came_s| came_s.is_none()) else {
            return false;
        };
        *came_s = Some(now_s);
        if let EffectSource::Bleed { near_m } = self.sources[number].effect {
            self.tears_m.push(near_m);
        }
        true
    }

    /// Those that last now, with the time since they came [s].
    fn ongoing(&self, now_s: f64) -> impl Iterator<Item = (&EffectSource, f64)> {
        let came = self.sources.iter().zip(&self.came_s);
        came.filter_map(move |(source, came_s)| {
            let since_s = now_s - (*came_s)?;
            (since_s < source.effect.lasts_s()).then_some((&source.effect, since_s))
        })
    }

    pub(super) fn effects(&self, now_s: f64) -> Effects {
        let mut effects = Effects::default();
        for (effect, since_s) in self.ongoing(now_s) {
            match *effect {
                EffectSource::Fail { tool, .. } => effects.fails[tool] = true,
                EffectSource::Jerk { acceleration_m_per_s2, for_s } => {
                    effects.acceleration_m_per_s2 += acceleration_m_per_s2 * share_of_jerk(since_s, for_s);
                }
                EffectSource::Bleed { .. } | EffectSource::LightOut { .. } => {}
            }
        }
        effects
    }

    pub(super) fn is_dark(&self, now_s: f64) -> bool {
        self.ongoing(now_s).any(|(effect, _)| matches!(effect, EffectSource::LightOut { .. }))
    }

    /// A vessel that tears now, told once.
    pub(super) fn take_tear(&mut self) -> Option<DVec3> {
        self.tears_m.pop()
    }

    pub(super) fn news(&self) -> Vec<EventNews> {
        let news = self.sources.iter().zip(&self.came_s);
        news.map(|(source, came_s)| EventNews { title: source.title.clone(), came_s: *came_s }).collect()
    }
}
