//! How punctual a machine lets a thread be at best: the haptic loop's waiting, class and core with nothing to do, while another
//! thread computes elsewhere. What is late here is late by the system's doing or its host's, who need not tell what they take.

use glisson_runtime::histogram::Histogram;
use glisson_runtime::realtime::{OwnCore, make_punctual, now_ns, wait_until};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Adds the time between two ticks less the period, without its sign, to `jitter` for `seconds`.
pub(super) fn measure(rate_hz: f64, core: OwnCore, seconds: f64, jitter: &Histogram) {
    let is_over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        // In the place of a simulation.
        scope.spawn(|| {
            while !is_over.load(Ordering::Relaxed) {
                std::hint::spin_loop();
            }
        });
        scope.spawn(|| {
            make_punctual(core);
            tick((1e9 / rate_hz) as u64, Duration::from_secs_f64(seconds), jitter);
            is_over.store(true, Ordering::Relaxed);
        });
    });
}

fn tick(period_ns: u64, length: Duration, jitter: &Histogram) {
    let mut last_ns = now_ns();
    let end_ns = last_ns + length.as_nanos() as u64;
    let mut deadline_ns = last_ns + period_ns;
    while deadline_ns <= end_ns {
        wait_until(deadline_ns);
        let begun_ns = now_ns();
        jitter.record((begun_ns - last_ns).abs_diff(period_ns));
        last_ns = begun_ns;
        // Periods that passed meanwhile are left out, as in the loop.
        deadline_ns += (1 + (begun_ns - deadline_ns) / period_ns) * period_ns;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_loop_ticks_once_a_period() {
        let jitter = Histogram::default();
        measure(1e3, OwnCore::Last, 0.2, &jitter);
        let found = jitter.percentiles();
        // Periods may be missed on a loaded machine; each tick's is counted.
        assert!((20..=200).contains(&found.n), "{found:?}");
        assert!(found.p50_ns <= found.p99_ns && found.p99_ns <= found.greatest_ns, "{found:?}");
    }
}
