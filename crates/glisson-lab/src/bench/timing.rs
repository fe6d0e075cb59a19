//! Times of a closure: processor time of the thread, or wall time where several threads work.

use std::cell::Cell;
use std::time::Instant;

use rustix::time::{ClockId, clock_gettime};

/// A timed sample is at least this long, so that reading the clock (about 0.3 microseconds) does not show:
/// shorter closures are called several times a sample.
const LEAST_SAMPLE_NS: f64 = 30_000.0;
/// Samples at least, unless a single one takes longer than the whole budget ...
const LEAST_SAMPLES: usize = 5;
/// ... and at most.
const MOST_SAMPLES: usize = 20_000;

/// Processor time that this thread has used [ns].
pub(crate) fn thread_cpu_ns() -> u64 {
    nanoseconds(ClockId::ThreadCPUTime)
}

/// Processor time that all threads of this process have used [ns].
fn process_cpu_ns() -> u64 {
    nanoseconds(ClockId::ProcessCPUTime)
}

fn nanoseconds(clock: ClockId) -> u64 {
    let time = clock_gettime(clock);
    let part = |value: i64| u64::try_from(value).expect("processor time does not run backwards");
    part(time.tv_sec) * 1_000_000_000 + part(time.tv_nsec)
}

thread_local! {
    /// What [`untimed`] has taken so far, by processor time and by the wall [ns].
    static UNTIMED_NS: Cell<[u64; 2]> = const { Cell::new([0; 2]) };
}

/// Does something within a timed closure, on the thread that times it, whose time does not count: putting
/// things back for the next call.
pub(crate) fn untimed<T>(work: impl FnOnce() -> T) -> T {
    let (wall, cpu_ns) = (Instant::now(), thread_cpu_ns());
    let done = work();
    let [cpu, passed] = UNTIMED_NS.get();
    let wall_ns = u64::try_from(wall.elapsed().as_nanos()).expect("no bench runs 500 years");
    UNTIMED_NS.set([cpu + thread_cpu_ns() - cpu_ns, passed + wall_ns]);
    done
}

/// Which time counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Clock {
    /// Processor time of the calling thread: what the work costs, whoever else runs.
    ThreadCpu,
    /// Time that passes: for work on several threads.
    Wall,
}

/// Times of one closure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Times {
    /// Median time of a call [ns].
    pub(crate) median_ns: f64,
    /// Time that 99 of 100 samples stay below [ns].
    pub(crate) p99_ns: f64,
    /// Processor time of all threads, a call [ns].
    pub(crate) cpu_ns: f64,
    /// Number of samples; each is the mean of `calls_per_sample` calls.
    pub(crate) samples: usize,
    /// Calls in one sample.
    pub(crate) calls_per_sample: usize,
}

/// Calls `run` for about `seconds` and says how long a call takes. The first call warms up and does not
/// count, unless it alone takes longer than the whole time.
pub(crate) fn time_of(run: &mut dyn FnMut(), clock: Clock, seconds: f64) -> Times {
    let wall = Instant::now();
    let untimed_before = UNTIMED_NS.get()[1];
    let untimed_wall_ns = || UNTIMED_NS.get()[1] - untimed_before;
    let now = || match clock {
        Clock::ThreadCpu => thread_cpu_ns() - UNTIMED_NS.get()[0],
        Clock::Wall => {
            u64::try_from(wall.elapsed().as_nanos()).expect("no bench runs 500 years") - untimed_wall_ns()
        }
    };
    let cpu_start = process_cpu_ns();
    let before = now();
    run();
    let first_ns = (now() - before) as f64;
    if first_ns > seconds * 1e9 {
        let cpu_ns = (process_cpu_ns() - cpu_start) as f64;
        return Times { median_ns: first_ns, p99_ns: first_ns, cpu_ns, samples: 1, calls_per_sample: 1 };
    }
    let before = now();
    run();
    let second_ns = ((now() - before) as f64).max(1.0);
    let calls_per_sample = (LEAST_SAMPLE_NS / second_ns).ceil().max(1.0) as usize;
    let mut samples = Vec::new();
    let cpu_start = process_cpu_ns();
    loop {
        let before = now();
        for _ in 0..calls_per_sample {
            run();
        }
        samples.push((now() - before) as f64 / calls_per_sample as f64);
        let enough = samples.len() >= LEAST_SAMPLES && wall.elapsed().as_secs_f64() >= seconds;
        if enough || samples.len() >= MOST_SAMPLES {
            break;
        }
    }
    let cpu_ns = (process_cpu_ns() - cpu_start) as f64 / (samples.len() * calls_per_sample) as f64;
    samples.sort_by(f64::total_cmp);
    Times {
        median_ns: quantile(&samples, 0.5),
        p99_ns: quantile(&samples, 0.99),
        cpu_ns,
        samples: samples.len(),
        calls_per_sample,
    }
}

/// Smallest of the ascending `samples` that a share `q` of them does not exceed.
pub(crate) fn quantile(samples: &[f64], q: f64) -> f64 {
    let place = (q * samples.len() as f64).ceil() as usize;
    samples[place.clamp(1, samples.len()) - 1]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_of_a_hundred_samples() {
        let samples: Vec<f64> = (1..=100).map(f64::from).collect();
        assert_eq!((quantile(&samples, 0.5), quantile(&samples, 0.99)), (50.0, 99.0));
        assert_eq!((quantile(&[7.0], 0.5), quantile(&[7.0], 0.99)), (7.0, 7.0));
    }

    #[test]
    fn a_short_closure_is_called_several_times_a_sample() {
        let mut calls = 0usize;
        let times = time_of(&mut || calls += 1, Clock::ThreadCpu, 1e-3);
        // How often depends on what reading the clock costs here.
        assert!(times.calls_per_sample > 1 && times.samples >= LEAST_SAMPLES);
        assert_eq!(calls, 2 + times.samples * times.calls_per_sample);
        assert!(times.median_ns <= times.p99_ns);
    }

    #[test]
    fn what_is_untimed_does_not_count() {
        let busy = |ns: u64| {
            let start = thread_cpu_ns();
            while thread_cpu_ns() - start < ns {}
        };
        let mut work = || {
            busy(20_000);
            untimed(|| busy(400_000));
        };
        let times = time_of(&mut work, Clock::ThreadCpu, 2e-2);
        assert!((20_000.0..200_000.0).contains(&times.median_ns), "{times:?}");
    }

    #[test]
    fn a_closure_longer_than_the_budget_is_timed_once() {
        let mut calls = 0usize;
        let mut work = || {
            calls += 1;
            let start = thread_cpu_ns();
            while thread_cpu_ns() - start < 2_000_000 {}
        };
        let times = time_of(&mut work, Clock::ThreadCpu, 1e-3);
        assert_eq!((calls, times.samples), (1, 1));
        assert!(times.median_ns >= 2e6);
    }
}
