//! Bars of work that takes a while.

use std::ops::ControlFlow;
use std::time::Duration;

use glisson::progress::watched;
use indicatif::{ProgressBar, ProgressStyle};

/// Does `work` under a bar that shows the share it tells.
pub(crate) fn with_bar<T>(message: &'static str, work: impl FnOnce() -> T) -> T {
    let bar = ProgressBar::new(100).with_message(message);
    if let Ok(style) = ProgressStyle::with_template("{spinner} {msg:12} {wide_bar} {percent} %") {
        bar.set_style(style);
    }
    bar.enable_steady_tick(Duration::from_millis(200));
    let shown = bar.clone();
    let listener = move |share: f64| {
        shown.set_position((100.0 * share) as u64);
        ControlFlow::Continue(())
    };
    let done = watched(listener, work).expect("a bar cancels nothing");
    bar.finish_and_clear();
    done
}
