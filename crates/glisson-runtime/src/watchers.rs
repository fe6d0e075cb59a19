//! Who looks at what is not gathered unless somebody does: contact points, the inside of bodies.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// How many look.
#[derive(Debug, Default)]
pub struct Watchers(AtomicUsize);

impl Watchers {
    /// Somebody looks, until what is answered is dropped.
    pub fn enter(self: &Arc<Self>) -> Watcher {
        self.0.fetch_add(1, Ordering::Relaxed);
        Watcher(Arc::clone(self))
    }

    /// Whether anybody looks.
    pub fn are_there(&self) -> bool {
        self.0.load(Ordering::Relaxed) > 0
    }
}

/// Somebody who looks.
#[derive(Debug)]
pub struct Watcher(Arc<Watchers>);

impl Drop for Watcher {
    fn drop(&mut self) {
        self.0.0.fetch_sub(1, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as_long_as_one_looks_somebody_does() {
        let all = Arc::<Watchers>::default();
        assert!(!all.are_there());
        let (one, other) = (all.enter(), all.enter());
        drop(one);
        assert!(all.are_there());
        drop(other);
        assert!(!all.are_there());
    }
}
