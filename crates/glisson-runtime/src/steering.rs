//! A place at the controls for what is no viewer: CRTK's clients. The same rule holds for it: one controls, all may watch.

use crate::control::{Control, Viewer};
use crate::live::Command;
use crate::published::Published;
use std::sync::Arc;
use std::sync::mpsc::Sender;
use std::thread::JoinHandle;
use tokio::sync::watch;

/// Starts something that shows what is published, until the other end is gone; it may take a seat at the controls.
pub type Show = Box<dyn FnOnce(watch::Receiver<Arc<Published>>, &Steering) -> anyhow::Result<JoinHandle<()>>>;

/// The controls, for whoever takes a seat.
#[derive(Clone)]
pub struct Steering {
    control: Arc<Control>,
    commands: Sender<Command>,
}

/// A seat; left when dropped.
pub struct Seat {
    steering: Steering,
    viewer: Viewer,
}

impl Steering {
    /// The controls of a simulation that listens to `commands`.
    pub fn new(control: Arc<Control>, commands: Sender<Command>) -> Self {
        Self { control, commands }
    }

    /// With nobody else at the controls.
    pub fn alone(commands: Sender<Command>) -> Self {
        Self::new(Arc::default(), commands)
    }

    /// A seat that does not control yet; none when all are taken.
    pub fn sit_down(&self) -> Option<Seat> {
        // Who only sits there must not keep viewers from steering.
        let viewer = self.control.enter_without_page()?;
        Some(Seat { steering: self.clone(), viewer })
    }
}

impl Seat {
    /// Whether this seat controls; takes control when nobody has it.
    pub fn may_control(&self) -> bool {
        self.steering.control.may_control(self.viewer)
    }

    /// Whether somebody else controls.
    pub fn is_preempted(&self) -> bool {
        self.steering.control.is_with_another(self.viewer)
    }

    /// Gives control away.
    pub fn release(&self) {
        self.steering.control.release(self.viewer);
    }

    /// Sends a command; the caller has control.
    pub fn send(&self, command: Command) {
        // A simulation that ended is told by its closed channel.
        let _ = self.steering.commands.send(command);
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.steering.control.leave(self.viewer);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seat_controls_only_when_it_asks_and_no_viewer_does() {
        let control = Arc::new(Control::default());
        let steering = Steering::new(Arc::clone(&control), std::sync::mpsc::channel().0);
        let seat = steering.sit_down().unwrap();
        let viewer = control.enter().unwrap();
        assert!(control.may_control(viewer) && seat.is_preempted() && !seat.may_control());
        control.release(viewer);
        assert!(!seat.is_preempted() && seat.may_control() && !control.may_control(viewer));
        seat.release();
        assert!(control.may_control(viewer));
        control.leave(viewer);
        assert!(seat.may_control());
        drop(seat);
        let viewer = control.enter().unwrap();
        assert!(control.may_control(viewer));
    }
}
