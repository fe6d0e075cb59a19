//! Faults that tests order, to show that a refused edit leaves every bit as it was.
//!
//! Every place of an edit that can fail asks [`check`] first. A test orders the k-th of them on its thread to fail
//! ([`order`]) and compares the state before and after. Without debug assertions (release builds) nothing is kept,
//! nothing fails, and the calls compile to nothing.

/// The failure that a test ordered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a test ordered a fault: {place}")]
pub struct OrderedFault {
    /// Which place failed.
    pub place: &'static str,
}

/// What is kept on each thread.
#[cfg(debug_assertions)]
mod kept {
    use std::cell::Cell;

    thread_local! {
        /// Places to pass before the one that fails; none: nothing fails.
        pub(super) static TO_PASS: Cell<Option<usize>> = const { Cell::new(None) };
        /// The place that failed last.
        pub(super) static FAILED: Cell<Option<&'static str>> = const { Cell::new(None) };
    }
}

/// Fails if a test ordered this place to fail.
///
/// # Errors
/// [`OrderedFault`] in debug builds after [`order`].
#[cfg(debug_assertions)]
pub fn check(place: &'static str) -> Result<(), OrderedFault> {
    match kept::TO_PASS.get() {
        None => Ok(()),
        Some(0) => {
            kept::TO_PASS.set(None);
            kept::FAILED.set(Some(place));
            Err(OrderedFault { place })
        }
        Some(n) => {
            kept::TO_PASS.set(Some(n - 1));
            Ok(())
        }
    }
}

/// Fails if a test ordered this place to fail.
///
/// # Errors
/// None in this build: it has no debug assertions.
#[cfg(not(debug_assertions))]
#[inline(always)]
pub fn check(_place: &'static str) -> Result<(), OrderedFault> {
    Ok(())
}

/// Runs `edit` with a fault at the place after the first `n_before`; answers with what it gave and the place that
/// failed, none if it passed fewer places.
#[cfg(debug_assertions)]
pub fn order<T>(n_before: usize, edit: impl FnOnce() -> T) -> (T, Option<&'static str>) {
    kept::FAILED.set(None);
    kept::TO_PASS.set(Some(n_before));
    let answer = edit();
    kept::TO_PASS.set(None);
    (answer, kept::FAILED.take())
}

#[cfg(all(test, debug_assertions))]
mod tests {
    use super::*;

    fn three_places() -> Result<u32, OrderedFault> {
        check("first")?;
        check("second")?;
        check("third")?;
        Ok(3)
    }

    #[test]
    fn each_place_fails_once_when_ordered_and_never_else() {
        assert_eq!(three_places(), Ok(3));
        for (n, place) in ["first", "second", "third"].into_iter().enumerate() {
            assert_eq!(order(n, three_places), (Err(OrderedFault { place }), Some(place)));
            assert_eq!(three_places(), Ok(3));
        }
        assert_eq!(order(3, three_places), (Ok(3), None));
    }
}
