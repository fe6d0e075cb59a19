//! Who looks at contact points: they are gathered only while somebody does.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// How many look.
#[derive(Debug, Default)]
pub struct ContactWatchers(AtomicUsize);

impl ContactWatchers {
    /// Somebody looks, until what is answered is dropped.
    pub fn enter(self: &Arc<Self>) -> ContactWatcher {
        self.0.fetch_add(1, Ordering::Relaxed);
        ContactWatcher(Arc::clone(self))
    }

    /// Whether anybody looks.
    pub fn are_there(&self) -> bool {
        self.0.load(Ordering::Relaxed) > 0
    }
}

/// Somebody who looks.
#[derive(Debug)]
pub struct ContactWatcher(Arc<ContactWatchers>);

impl Drop for ContactWatcher {
    fn drop(&mut self) {
        self.0.0.fetch_sub(1, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as_long_as_one_looks_somebody_does() {
        let all = Arc::<ContactWatchers>::default();
        assert!(!all.are_there());
        let (one, other) = (all.enter(), all.enter());
        drop(one);
        assert!(all.are_there());
        drop(other);
        assert!(!all.are_there());
    }
}
