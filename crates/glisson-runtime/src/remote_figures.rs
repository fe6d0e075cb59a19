//! The figures of a haptic loop that runs on the other machine.

use crate::haptic_loop::HapticReport;
use std::sync::{Arc, Mutex};

/// The last report that came; empty until one did, and again when the link is cut.
#[derive(Clone, Default)]
pub struct RemoteFigures(Arc<Mutex<Option<HapticReport>>>);

impl RemoteFigures {
    /// The latest report.
    pub fn report(&self) -> Option<HapticReport> {
        self.0.lock().ok().and_then(|report| report.clone())
    }

    /// Takes a report over; none when the link was cut.
    pub fn put(&self, report: Option<HapticReport>) {
        // The lock is held for a copy only.
        if let Ok(mut kept) = self.0.lock() {
            *kept = report;
        }
    }
}
