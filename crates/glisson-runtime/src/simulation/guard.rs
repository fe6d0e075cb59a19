//! The border behind which nothing of the simulation may fail: a panic in it is told as an error with the number of the
//! step, the session is kept, and the program goes on.

use super::Simulation;
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Why a simulation cannot go on: a fault of the program, not of its user.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("step {step}: the simulation broke: {reason}; {kept}. Please report this with the session")]
pub struct Broken {
    /// Steps made before.
    pub step: u64,
    /// What went wrong.
    pub reason: String,
    /// What became of the session.
    kept: String,
}

impl Simulation {
    /// Does something with the world. After a panic, or non-finite numbers, nothing more is done with it.
    ///
    /// # Errors
    /// [`Broken`], the first time and from then on; and the errors of `act`.
    pub(super) fn guarded<T>(
        &mut self,
        act: impl FnOnce(&mut Self) -> anyhow::Result<T>,
    ) -> anyhow::Result<T> {
        if let Some(broken) = &self.broken {
            return Err(broken.clone().into());
        }
        match catch_unwind(AssertUnwindSafe(|| act(self))) {
            Ok(done) => done,
            Err(panic) => Err(self.break_off(panic_text(panic.as_ref())).into()),
        }
    }

    /// Ends the simulation and keeps its session.
    pub(crate) fn break_off(&mut self, reason: String) -> Broken {
        let kept = match self.recorder.take().map(|recorder| recorder.finish()) {
            None => "no session was recorded".to_owned(),
            Some(Ok(())) => "the session up to here is kept".to_owned(),
            Some(Err(error)) => format!("{error:#}"),
        };
        let broken = Broken { step: self.world.steps_made(), reason, kept };
        self.tell(broken.to_string());
        self.broken = Some(broken.clone());
        broken
    }

    /// Why it cannot go on, if it cannot.
    pub fn broken(&self) -> Option<&Broken> {
        self.broken.as_ref()
    }
}

/// What a panic said.
pub fn panic_text(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("a panic without words").to_owned()
}

/// Panics at the step that the environment orders: how tests see what comes of a fault of the program.
#[cfg(debug_assertions)]
pub(super) fn break_if_ordered(step: u64) {
    let ordered = std::env::var("GLISSON_BREAK_AT_STEP").ok().and_then(|text| text.parse().ok());
    assert!(ordered != Some(step), "a fault was ordered for this step");
}
