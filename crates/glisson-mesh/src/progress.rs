//! How far long work is, and how it is cancelled.
//!
//! Who waits for work watches it with [`watched`]; the work says how much of it is done with [`tell`], and lets its parts speak for a
//! stretch of it with [`part`]. Work that nobody watches speaks to nobody. The watch belongs to the thread that began the work;
//! [`Teller`] takes it to others.
//!
//! A listener that breaks off ends the work by unwinding it: no function on the way needs an error for it, nothing is left half
//! made but what the work wrote into what it was given.

use std::any::Any;
use std::cell::RefCell;
use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;

type Listener = Arc<dyn Fn(f64) -> ControlFlow<()> + Send + Sync>;

thread_local! {
    static WATCH: RefCell<Option<Watch>> = const { RefCell::new(None) };
}

/// Who listens, and which stretch of all the work is being done.
#[derive(Clone)]
struct Watch {
    listener: Listener,
    from: f64,
    to: f64,
}

/// The work was broken off by who watched it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("cancelled")]
pub struct Cancelled;

/// Puts the watch of before back, also when the work unwinds.
struct Before(Option<Watch>);

impl Drop for Before {
    fn drop(&mut self) {
        let before = self.0.take();
        WATCH.with(|watch| *watch.borrow_mut() = before);
    }
}

fn with_watch<T>(watch: Option<Watch>, work: impl FnOnce() -> T) -> T {
    let _before = Before(WATCH.with(|kept| kept.replace(watch)));
    work()
}

/// Does `work`; `listener` hears the share of it that is done, 0 to 1, and breaks it off by its answer.
///
/// # Errors
/// [`Cancelled`] when the listener broke off before the work was done.
///
/// # Example
/// ```
/// use glisson_mesh::progress::{Cancelled, tell, watched};
/// use std::ops::ControlFlow;
///
/// let half_done = || {
///     tell(0.5);
///     7
/// };
/// assert_eq!(watched(|_| ControlFlow::Continue(()), half_done), Ok(7));
/// assert_eq!(watched(|_| ControlFlow::Break(()), half_done), Err(Cancelled));
/// ```
pub fn watched<T>(
    listener: impl Fn(f64) -> ControlFlow<()> + Send + Sync + 'static,
    work: impl FnOnce() -> T,
) -> Result<T, Cancelled> {
    let watch = Watch { listener: Arc::new(listener), from: 0.0, to: 1.0 };
    catch_unwind(AssertUnwindSafe(|| with_watch(Some(watch), work))).map_err(
        |payload: Box<dyn Any + Send>| {
            if payload.is::<Cancelled>() { Cancelled } else { resume_unwind(payload) }
        },
    )
}

/// Says that a share of the work, 0 to 1, is done. Does not come back where the work is cancelled.
pub fn tell(share: f64) {
    Teller::here().tell(share);
}

/// Does a part of the work: what it tells, 0 to 1, is for the work the stretch `from` to `to`.
pub fn part<T>(from: f64, to: f64, work: impl FnOnce() -> T) -> T {
    tell(from);
    let inner = Teller::here().0.map(|watch| Watch {
        from: watch.at(from),
        to: watch.at(to),
        listener: watch.listener,
    });
    with_watch(inner, work)
}

/// Tells the share of work from any thread.
#[derive(Clone)]
pub struct Teller(Option<Watch>);

impl Teller {
    /// For the work that this thread is in.
    pub fn here() -> Self {
        Self(WATCH.with(|watch| watch.borrow().clone()))
    }

    /// As [`tell`].
    pub fn tell(&self, share: f64) {
        let Some(watch) = &self.0 else { return };
        if (watch.listener)(watch.at(share)).is_break() {
            resume_unwind(Box::new(Cancelled));
        }
    }
}

impl Watch {
    fn at(&self, share: f64) -> f64 {
        self.from + share.clamp(0.0, 1.0) * (self.to - self.from)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayon::prelude::*;
    use std::sync::Mutex;

    #[test]
    fn parts_tell_their_stretch_and_nothing_speaks_after_it() {
        let told = Arc::new(Mutex::new(Vec::new()));
        let hears = Arc::clone(&told);
        let listener = move |share| {
            hears.lock().unwrap().push(share);
            ControlFlow::Continue(())
        };
        let work = || {
            part(0.0, 0.5, || {
                tell(0.5);
                part(0.5, 1.0, || tell(0.5));
            });
            tell(0.75);
        };
        assert_eq!(watched(listener, work), Ok(()));
        assert_eq!(*told.lock().unwrap(), [0.0, 0.25, 0.25, 0.375, 0.75]);
        tell(1.0);
        assert_eq!(told.lock().unwrap().len(), 5);
    }

    #[test]
    fn work_is_cancelled_on_any_thread_and_other_panics_pass() {
        let at_half =
            |share: f64| if share < 0.5 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) };
        let work = || {
            let teller = Teller::here();
            (0..100).into_par_iter().for_each(|n| teller.tell(0.01 * f64::from(n)));
        };
        assert_eq!(watched(at_half, work), Err(Cancelled));
        // The watch is gone with the work, also where that failed.
        let outer = catch_unwind(|| watched(|_| ControlFlow::Continue(()), || panic!("a fault")));
        assert_eq!(outer.unwrap_err().downcast_ref::<&str>(), Some(&"a fault"));
        assert!(Teller::here().0.is_none());
    }
}
