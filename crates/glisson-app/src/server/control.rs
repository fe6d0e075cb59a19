//! One viewer controls, all may watch; and how much a viewer may send.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;
use tokio::sync::watch;

/// Viewers at the same time.
pub(super) const MOST_VIEWERS: usize = 32;
/// Messages a second that a viewer may send in the long run: four instruments at 144 Hz. Bursts may have as many more.
const MESSAGES_PER_S: f64 = 600.0;
/// Characters a second in the long run, and the most in a burst.
const BYTES_PER_S: f64 = 262_144.0;

/// Who may be in control.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Viewer {
    number: u64,
    /// Whether it is a connection of a page, or of a program like one.
    pub(super) has_page: bool,
}

#[derive(Debug, Default)]
struct Seats {
    n_viewers: usize,
    last_number: u64,
}

/// Who controls.
#[derive(Debug)]
pub(super) struct Control {
    seats: Mutex<Seats>,
    controller: watch::Sender<Option<Viewer>>,
}

impl Default for Control {
    fn default() -> Self {
        Self { seats: Mutex::default(), controller: watch::channel(None).0 }
    }
}

impl Control {
    fn seats(&self) -> MutexGuard<'_, Seats> {
        // Its numbers hold also after a panic.
        self.seats.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A new viewer, who controls if nobody does; none when all places are taken.
    pub(super) fn enter(&self) -> Option<Viewer> {
        let viewer = self.sit_down(true)?;
        self.may_control(viewer);
        Some(viewer)
    }

    /// A place for what is no viewer, which does not control yet; none when all are taken.
    pub(super) fn enter_without_page(&self) -> Option<Viewer> {
        self.sit_down(false)
    }

    fn sit_down(&self, has_page: bool) -> Option<Viewer> {
        let mut seats = self.seats();
        if seats.n_viewers == MOST_VIEWERS {
            return None;
        }
        seats.n_viewers += 1;
        seats.last_number += 1;
        Some(Viewer { number: seats.last_number, has_page })
    }

    /// Frees the viewer's place and, if it controls, control.
    pub(super) fn leave(&self, viewer: Viewer) {
        self.release(viewer);
        self.seats().n_viewers -= 1;
    }

    /// Whether this viewer controls; takes control when nobody has it.
    pub(super) fn may_control(&self, viewer: Viewer) -> bool {
        let take = |controller: &mut Option<Viewer>| {
            let is_free = controller.is_none();
            if is_free {
                *controller = Some(viewer);
            }
            is_free
        };
        self.controller.send_if_modified(take) || *self.controller.borrow() == Some(viewer)
    }

    /// Gives control away; the next viewer who does something has it.
    pub(super) fn release(&self, viewer: Viewer) {
        self.controller.send_if_modified(|controller| {
            let is_own = *controller == Some(viewer);
            if is_own {
                *controller = None;
            }
            is_own
        });
    }

    /// Whether somebody else controls.
    #[cfg_attr(not(feature = "net"), allow(dead_code, reason = "only CRTK's clients ask: a viewer is told"))]
    pub(super) fn is_with_another(&self, viewer: Viewer) -> bool {
        self.controller.borrow().is_some_and(|controller| controller != viewer)
    }

    pub(super) fn watch(&self) -> watch::Receiver<Option<Viewer>> {
        self.controller.subscribe()
    }
}

/// What a viewer may still send: fills up with time, at most to one second's worth.
#[derive(Clone, Copy, Debug)]
pub(super) struct Allowance {
    messages: f64,
    bytes: f64,
    since: Instant,
}

impl Allowance {
    pub(super) fn new(now: Instant) -> Self {
        Self { messages: MESSAGES_PER_S, bytes: BYTES_PER_S, since: now }
    }

    /// Whether a message of so many bytes may come now.
    pub(super) fn spend(&mut self, n_bytes: usize, now: Instant) -> bool {
        let passed_s = now.saturating_duration_since(self.since).as_secs_f64();
        self.since = now;
        self.messages = (self.messages + passed_s * MESSAGES_PER_S).min(MESSAGES_PER_S) - 1.0;
        self.bytes = (self.bytes + passed_s * BYTES_PER_S).min(BYTES_PER_S) - n_bytes as f64;
        self.messages >= 0.0 && self.bytes >= 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn one_controls_until_it_leaves_or_gives_control_away() {
        let control = Control::default();
        let mut changes = control.watch();
        let (one, other) = (control.enter().unwrap(), control.enter().unwrap());
        assert!(control.may_control(one) && !control.may_control(other));
        control.release(other);
        assert!(!control.may_control(other));
        control.release(one);
        assert_eq!(*changes.borrow_and_update(), None);
        assert!(control.may_control(other) && !control.may_control(one));
        control.leave(other);
        assert!(control.may_control(one));
        assert_eq!(*changes.borrow(), Some(one));
    }

    #[test]
    fn there_are_so_many_places_and_no_more() {
        let control = Control::default();
        let viewers: Vec<Viewer> = (0..MOST_VIEWERS).map(|_| control.enter().unwrap()).collect();
        assert_eq!(control.enter(), None);
        control.leave(viewers[3]);
        assert!(control.enter().is_some());
    }

    #[test]
    fn what_is_sent_is_bounded_in_the_long_run_and_in_bursts() {
        let start = Instant::now();
        let n_passed = |interval: Duration, n_bytes, n: u32| {
            let mut allowance = Allowance::new(start);
            (1..=n).filter(|&i| allowance.spend(n_bytes, start + interval * i)).count()
        };
        assert_eq!(n_passed(Duration::ZERO, 10, 10_000), 600);
        assert_eq!(n_passed(Duration::from_millis(2), 300, 10_000), 10_000);
        assert_eq!(n_passed(Duration::ZERO, 65_536, 100), 4);
    }
}
