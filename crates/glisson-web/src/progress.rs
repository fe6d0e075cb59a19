//! How far long work is, told to the Worker while it goes on: until it is done, the Worker can hear nothing.

use glisson::progress::watched;
use std::ops::ControlFlow;

#[cfg(target_arch = "wasm32")]
mod page {
    #[allow(unsafe_code, reason = "the Worker gives it")]
    #[link(wasm_import_module = "page")]
    // SAFETY: it takes a number and touches nothing of the program's.
    unsafe extern "C" {
        /// A share of the work, 0 to 1, is done.
        pub(super) safe fn glisson_progress(share: f64);
    }
}

/// Tells the Worker how far `work` is.
pub(super) fn told<T>(work: impl FnOnce() -> anyhow::Result<T>) -> anyhow::Result<T> {
    let tell = |share: f64| {
        #[cfg(target_arch = "wasm32")]
        page::glisson_progress(share);
        let _ = share;
        ControlFlow::Continue(())
    };
    // Nobody breaks it off but by ending the Worker.
    watched(tell, work)?
}
