//! The instruments that the page in control holds as devices ([`glisson_runtime::devices::viewer`]): what it says about them goes to the
//! haptic loop, and what a hand would feel comes back.

use glisson_runtime::control::Steers;
use glisson_runtime::live::Command;
use glisson_runtime::page_hand::PageHand;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// Periods of the haptic loop that the simulation waits after a reset, until the loop has seen that the instruments are home.
/// A choice: it sees it with its next tick, which may be late.
const HOMING_PERIODS: f64 = 5.0;

/// How long the simulation waits after a reset when a page holds instruments in a loop of so many ticks a second.
pub fn homing(rate_hz: f64) -> Duration {
    Duration::from_secs_f64(HOMING_PERIODS / rate_hz)
}

/// One for each instrument that a page holds. The loop is at the other ends: it never waits for these locks.
pub struct Hands {
    held: Vec<(usize, Mutex<PageHand>)>,
    /// Told about instrument 0, which it does not hold.
    beside: Option<Mutex<PageHand>>,
}

/// What a hand would feel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FeltBy {
    /// Number of the instrument.
    pub(crate) tool: usize,
    pub(crate) felt: glisson_runtime::page_hand::Felt,
}

impl Hands {
    /// Those of instruments, by their numbers; `beside`: one that is told the same as instrument 0's, for tests.
    pub fn new(held: Vec<(usize, PageHand)>, beside: Option<PageHand>) -> Self {
        let held = held.into_iter().map(|(tool, hand)| (tool, Mutex::new(hand))).collect();
        Self { held, beside: beside.map(Mutex::new) }
    }

    /// Whether no page holds an instrument as a device.
    pub fn is_empty(&self) -> bool {
        self.held.is_empty() && self.beside.is_none()
    }

    fn each(&self, mut what: impl FnMut(usize, &mut PageHand)) {
        let beside = self.beside.iter().map(|hand| (0, hand));
        for (tool, hand) in self.held.iter().map(|(tool, hand)| (*tool, hand)).chain(beside) {
            // What a hand holds is whole also after a panic.
            what(tool, &mut hand.lock().unwrap_or_else(PoisonError::into_inner));
        }
    }

    /// Whether a command of the one in control is for a hand alone; then it has it.
    pub fn take(&self, command: &Command) -> bool {
        let mut is_taken = false;
        self.each(|tool, hand| match command {
            Command::Tool { tool: meant, pose } if *meant == tool => {
                hand.aim(*pose);
                is_taken = self.beside.is_none();
            }
            Command::Reset => hand.go_home(),
            _ => {}
        });
        is_taken
    }

    /// Who steers now: a hand is one of a page, or of nobody.
    pub fn are_of(&self, steers: &Steers) {
        self.each(|tool, hand| {
            hand.set_controlled(steers.holder(tool).is_some_and(|viewer| viewer.has_page));
        });
    }

    /// What they feel now.
    pub(crate) fn felt(&self) -> Vec<FeltBy> {
        let mut all = Vec::with_capacity(self.held.len());
        self.each(|tool, hand| all.push(FeltBy { tool, felt: hand.felt() }));
        all
    }
}
