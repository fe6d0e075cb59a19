//! One viewer controls, all may watch. Who teaches takes control over, and gives it back.

use std::sync::{Mutex, MutexGuard, PoisonError};
use tokio::sync::watch;

/// Viewers at the same time.
pub const MOST_VIEWERS: usize = 64;
/// Who may be in control.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Viewer {
    /// That of nobody else.
    pub number: u64,
    /// Whether it is a connection of a page, or of a program like one.
    pub has_page: bool,
}

#[derive(Debug, Default)]
struct Seats {
    present: Vec<Viewer>,
    last_number: u64,
    /// From whom control was taken over.
    taken_from: Option<Viewer>,
}

/// Who controls.
#[derive(Debug)]
pub struct Control {
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
    pub fn enter(&self) -> Option<Viewer> {
        let viewer = self.sit_down(true)?;
        self.may_control(viewer);
        Some(viewer)
    }

    /// A place for what is no viewer, which does not control yet; none when all are taken.
    pub(crate) fn enter_without_page(&self) -> Option<Viewer> {
        self.sit_down(false)
    }

    fn sit_down(&self, has_page: bool) -> Option<Viewer> {
        let mut seats = self.seats();
        if seats.present.len() == MOST_VIEWERS {
            return None;
        }
        seats.last_number += 1;
        let viewer = Viewer { number: seats.last_number, has_page };
        seats.present.push(viewer);
        Some(viewer)
    }

    /// Frees the viewer's place and, if it controls, gives control back.
    pub fn leave(&self, viewer: Viewer) {
        self.seats().present.retain(|present| *present != viewer);
        self.give_back(viewer);
    }

    /// Takes control over, whoever has it.
    pub fn take_over(&self, viewer: Viewer) {
        let before = *self.controller.borrow();
        if before != Some(viewer) {
            self.seats().taken_from = before;
            self.controller.send_replace(Some(viewer));
        }
    }

    /// Gives control to the one from whom it was taken over; to whoever does something next, if that one is gone or there is none.
    pub fn give_back(&self, viewer: Viewer) {
        if *self.controller.borrow() != Some(viewer) {
            return;
        }
        let before = {
            let mut seats = self.seats();
            let before = seats.taken_from.take();
            before.filter(|before| seats.present.contains(before))
        };
        self.controller.send_replace(before);
    }

    /// Whether this viewer controls; takes control when nobody has it.
    pub fn may_control(&self, viewer: Viewer) -> bool {
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
    pub fn release(&self, viewer: Viewer) {
        self.controller.send_if_modified(|controller| {
            let is_own = *controller == Some(viewer);
            if is_own {
                *controller = None;
            }
            is_own
        });
    }

    /// Whether somebody else controls.
    pub(crate) fn is_with_another(&self, viewer: Viewer) -> bool {
        self.controller.borrow().is_some_and(|controller| controller != viewer)
    }

    /// Tells who controls whenever that changes.
    pub fn watch(&self) -> watch::Receiver<Option<Viewer>> {
        self.controller.subscribe()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
    fn control_that_was_taken_over_goes_back_to_whom_it_was_taken_from() {
        let control = Control::default();
        let [learner, teacher, other] = [(); 3].map(|()| control.enter().unwrap());
        control.take_over(teacher);
        assert!(!control.may_control(learner) && control.may_control(teacher));
        // Again changes nothing of whose it was; nobody else can give it away.
        control.take_over(teacher);
        control.give_back(other);
        control.give_back(teacher);
        assert!(control.may_control(learner) && !control.may_control(teacher));
        // Also when who took it is gone.
        control.take_over(teacher);
        control.leave(teacher);
        assert!(control.may_control(learner));
        // Where the learner is gone, whoever does something has it.
        control.take_over(other);
        control.leave(learner);
        control.give_back(other);
        assert_eq!(*control.watch().borrow(), None);
    }

    #[test]
    fn there_are_so_many_places_and_no_more() {
        let control = Control::default();
        let viewers: Vec<Viewer> = (0..MOST_VIEWERS).map(|_| control.enter().unwrap()).collect();
        assert_eq!(control.enter(), None);
        control.leave(viewers[3]);
        assert!(control.enter().is_some());
    }
}
