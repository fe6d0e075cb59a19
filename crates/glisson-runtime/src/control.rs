//! One viewer controls, all may watch. Who teaches takes control over, and gives it back. Who controls may offer instruments to the
//! others, of whom each may take one into the hand: so two people at two machines operate together.

use crate::live::Command;
use glisson::tool::MAX_TOOLS;
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

/// Who has an instrument in the hand.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Holder {
    /// Who controls.
    #[default]
    Controller,
    /// Who controls, until another viewer takes it.
    Offered,
    /// This viewer, who took it.
    Taken(Viewer),
}

/// Who steers what.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Steers {
    /// Who controls the simulation, and the instruments that nobody else has.
    pub controller: Option<Viewer>,
    /// Who has each instrument.
    pub holders: [Holder; MAX_TOOLS],
}

impl Steers {
    /// Who has an instrument in the hand.
    pub fn holder(&self, tool: usize) -> Option<Viewer> {
        match self.holders.get(tool) {
            Some(Holder::Taken(viewer)) => Some(*viewer),
            _ => self.controller,
        }
    }
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
    steers: watch::Sender<Steers>,
}

impl Default for Control {
    fn default() -> Self {
        Self { seats: Mutex::default(), steers: watch::Sender::new(Steers::default()) }
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

    /// Frees the viewer's place and what it has: control, which it gives back, and instruments.
    pub fn leave(&self, viewer: Viewer) {
        self.seats().present.retain(|present| *present != viewer);
        self.give_back(viewer);
        (0..MAX_TOOLS).for_each(|tool| self.lay_down(viewer, tool));
    }

    /// Takes control over, whoever has it.
    pub fn take_over(&self, viewer: Viewer) {
        let before = self.steers.borrow().controller;
        if before != Some(viewer) {
            self.seats().taken_from = before;
            self.steers.send_modify(|steers| steers.controller = Some(viewer));
        }
    }

    /// Gives control to the one from whom it was taken over; to whoever does something next, if that one is gone or there is none.
    pub fn give_back(&self, viewer: Viewer) {
        if self.steers.borrow().controller != Some(viewer) {
            return;
        }
        let before = {
            let mut seats = self.seats();
            let before = seats.taken_from.take();
            before.filter(|before| seats.present.contains(before))
        };
        self.steers.send_modify(|steers| steers.controller = before);
    }

    /// Whether this viewer controls; takes control when nobody has it.
    pub fn may_control(&self, viewer: Viewer) -> bool {
        let take = |steers: &mut Steers| {
            let is_free = steers.controller.is_none();
            if is_free {
                steers.controller = Some(viewer);
            }
            is_free
        };
        self.steers.send_if_modified(take) || self.steers.borrow().controller == Some(viewer)
    }

    /// Whether this viewer may give a command: of an instrument that somebody took, who took it, else who controls. Takes control
    /// where nobody has it.
    pub fn may_command(&self, viewer: Viewer, command: &Command) -> bool {
        match command {
            Command::Tool { tool, .. }
            | Command::Cut { tool }
            | Command::Clip { tool }
            | Command::Refine { tool }
                if let Some(Holder::Taken(holder)) = self.steers.borrow().holders.get(*tool) =>
            {
                *holder == viewer
            }
            _ => self.may_control(viewer),
        }
    }

    /// The one who controls offers an instrument to the others, or has it again, whoever took it. Answers whether it may.
    pub fn offer(&self, viewer: Viewer, tool: usize, is_offered: bool) -> bool {
        let offer = |steers: &mut Steers| {
            let may = steers.controller == Some(viewer);
            if let (true, Some(holder)) = (may, steers.holders.get_mut(tool)) {
                *holder = if is_offered { Holder::Offered } else { Holder::Controller };
            }
            may
        };
        self.steers.send_if_modified(offer)
    }

    /// Takes an instrument that is offered. Answers whether it was.
    pub fn take(&self, viewer: Viewer, tool: usize) -> bool {
        let take = |steers: &mut Steers| {
            let offered = steers.holders.get_mut(tool).filter(|holder| **holder == Holder::Offered);
            offered.map(|holder| *holder = Holder::Taken(viewer)).is_some()
        };
        self.steers.send_if_modified(take)
    }

    /// Gives an instrument back that this viewer took: then it is offered again.
    pub fn lay_down(&self, viewer: Viewer, tool: usize) {
        let give = |steers: &mut Steers| {
            let taken = steers.holders.get_mut(tool).filter(|holder| **holder == Holder::Taken(viewer));
            taken.map(|holder| *holder = Holder::Offered).is_some()
        };
        self.steers.send_if_modified(give);
    }

    /// Gives control away; the next viewer who does something has it.
    pub fn release(&self, viewer: Viewer) {
        self.steers.send_if_modified(|steers| {
            let is_own = steers.controller == Some(viewer);
            if is_own {
                steers.controller = None;
            }
            is_own
        });
    }

    /// Whether somebody else controls.
    pub(crate) fn is_with_another(&self, viewer: Viewer) -> bool {
        self.steers.borrow().controller.is_some_and(|controller| controller != viewer)
    }

    /// Tells who steers what whenever that changes.
    pub fn watch(&self) -> watch::Receiver<Steers> {
        self.steers.subscribe()
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
        assert_eq!(changes.borrow_and_update().controller, None);
        assert!(control.may_control(other) && !control.may_control(one));
        control.leave(other);
        assert!(control.may_control(one));
        assert_eq!(changes.borrow().controller, Some(one));
    }

    #[test]
    fn an_offered_instrument_is_its_takers_alone_until_it_is_given_or_called_back() {
        let control = Control::default();
        let [one, other, third] = [(); 3].map(|()| control.enter().unwrap());
        let cut = |tool| Command::Cut { tool };
        assert!(!control.take(other, 1), "not offered");
        assert!(!control.offer(other, 1, true), "who watches offers nothing");
        assert!(control.offer(one, 1, true));
        assert!(control.may_command(one, &cut(1)), "until it is taken");
        assert!(control.take(other, 1) && !control.take(third, 1));
        assert!(control.may_command(other, &cut(1)) && !control.may_command(one, &cut(1)));
        assert!(!control.may_command(other, &cut(0)) && !control.may_command(other, &Command::Reset));
        assert!(control.may_command(one, &Command::Reset));
        assert_eq!(control.watch().borrow().holder(1), Some(other));
        // Who controls goes; the other keeps the instrument, and may also control then.
        control.leave(one);
        assert_eq!(control.watch().borrow().holder(1), Some(other));
        assert!(control.may_command(third, &Command::Undo) && !control.may_command(third, &cut(1)));
        control.leave(other);
        assert!(control.may_command(third, &cut(1)) && control.take(third, 1));
        assert!(control.offer(third, 1, false), "called back");
        assert_eq!(control.watch().borrow().holders, [Holder::Controller; MAX_TOOLS]);
        assert!(!control.take(third, MAX_TOOLS), "no such instrument");
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
        assert_eq!(control.watch().borrow().controller, None);
    }

    #[test]
    fn who_takes_control_over_leaves_an_instrument_with_who_took_it_and_may_call_it_back() {
        let control = Control::default();
        let [learner, second, teacher] = [(); 3].map(|()| control.enter().unwrap());
        assert!(control.offer(learner, 1, true) && control.take(second, 1));
        control.take_over(teacher);
        let cut = |tool| Command::Cut { tool };
        assert!(control.may_command(second, &cut(1)) && control.may_command(teacher, &cut(0)));
        assert!(!control.may_command(teacher, &cut(1)) && !control.may_command(learner, &cut(0)));
        assert!(control.offer(teacher, 1, false), "called back");
        assert!(control.may_command(teacher, &cut(1)) && !control.may_command(second, &cut(1)));
        control.give_back(teacher);
        assert!(control.may_command(learner, &cut(1)));
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
