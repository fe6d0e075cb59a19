//! Work of a page that goes on in the background: what it is called, how far it is, and that it was cancelled.

use serde_json::{Value, json};
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Instant;

/// Work that goes on.
pub(crate) struct Job {
    pub(crate) what: String,
    since: Instant,
    /// Bits of the share that is done.
    share: AtomicU64,
    is_cancelled: AtomicBool,
}

impl Job {
    /// Work that begins now.
    pub(crate) fn new(what: impl Into<String>) -> Self {
        Self {
            what: what.into(),
            since: Instant::now(),
            share: AtomicU64::new(0),
            is_cancelled: AtomicBool::new(false),
        }
    }

    /// What a page shows of it.
    pub(crate) fn state(&self) -> Value {
        json!({
            "what": self.what,
            "seconds": self.since.elapsed().as_secs_f64(),
            "share": f64::from_bits(self.share.load(Ordering::Relaxed)),
            "is_cancelled": self.is_cancelled(),
        })
    }

    /// It breaks off where it next tells how far it is.
    pub(crate) fn cancel(&self) {
        self.is_cancelled.store(true, Ordering::Relaxed);
    }

    pub(crate) fn is_cancelled(&self) -> bool {
        self.is_cancelled.load(Ordering::Relaxed)
    }

    /// Hears how far it is, and answers whether it goes on.
    pub(crate) fn hears(&self, share: f64) -> ControlFlow<()> {
        self.share.store(share.to_bits(), Ordering::Relaxed);
        if self.is_cancelled() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}
