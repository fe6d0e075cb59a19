//! What makes a thread punctual: its clock, absolute deadlines, the scheduler's real-time class, a core of its own.

use rustix::time::{ClockId, Timespec, clock_gettime};
use std::hint::spin_loop;

/// The scheduler wakes a thread late by some tens of microseconds: the last part of a wait is spent looking at the clock.
const SPIN_NS: u64 = 60_000;
/// Real-time priority of the haptic loop, of 1 to 99: above threads that merely left the default class, below the kernel's
/// own at 50 and more.
const PRIORITY: u8 = 40;
/// Of the threads that carry forces between machines: they give way to the haptic loop.
const LINK_PRIORITY: u8 = 30;

/// Nanoseconds on a clock that never jumps.
pub(crate) fn now_ns() -> u64 {
    let time = clock_gettime(ClockId::Monotonic);
    // A monotonic clock counts from the machine's start.
    time.tv_sec.unsigned_abs() * 1_000_000_000 + time.tv_nsec.unsigned_abs()
}

/// Waits until that moment of [`now_ns`]; answers at once when it has passed.
pub(crate) fn wait_until(deadline_ns: u64) {
    sleep_until(deadline_ns.saturating_sub(SPIN_NS));
    while now_ns() < deadline_ns {
        spin_loop();
    }
}

#[cfg(target_os = "linux")]
fn sleep_until(deadline_ns: u64) {
    let moment = Timespec {
        tv_sec: (deadline_ns / 1_000_000_000) as i64,
        tv_nsec: (deadline_ns % 1_000_000_000) as i64,
    };
    // A signal ends the sleep early: then it goes on.
    while now_ns() < deadline_ns {
        if rustix::thread::clock_nanosleep_absolute(ClockId::Monotonic, &moment).is_ok() {
            return;
        }
    }
}

#[cfg(not(target_os = "linux"))]
fn sleep_until(deadline_ns: u64) {
    std::thread::sleep(std::time::Duration::from_nanos(deadline_ns.saturating_sub(now_ns())));
}

/// How a thread is scheduled, in words for the user where it is not as wished.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Scheduling {
    /// Whether the thread is in the real-time class.
    pub(crate) is_real_time: bool,
    /// The core that it stays on.
    pub(crate) core: Option<usize>,
    /// One sentence.
    pub(crate) text: String,
}

/// Puts the calling thread into the real-time class, and on one core, where the system allows it. `core`: which one; the
/// last that the process may use for none.
pub(crate) fn make_punctual(core: Option<usize>) -> Scheduling {
    let policy = enter_real_time_class();
    let pinned = pin(core);
    let policy_text = match &policy {
        Ok(()) => format!("SCHED_FIFO {PRIORITY}"),
        Err(reason) => format!(
            "no real-time scheduling ({reason}; allow it with `ulimit -r {PRIORITY}` or CAP_SYS_NICE)"
        ),
    };
    let core_text = match &pinned {
        Ok(core) => format!("on core {core}"),
        Err(reason) => format!("on any core ({reason})"),
    };
    let text = format!("{policy_text}, {core_text}");
    Scheduling { is_real_time: policy.is_ok(), core: pinned.ok(), text }
}

/// Puts the calling thread into the real-time class, or says why it cannot.
pub(crate) fn enter_real_time_class() -> Result<(), String> {
    enter_class(PRIORITY)
}

/// Wakes the calling thread, which serves a link, before all that are not in the real-time class, where the system allows
/// it; answers whether it does.
pub(crate) fn make_prompt() -> bool {
    enter_class(LINK_PRIORITY).is_ok()
}

#[cfg(target_os = "linux")]
fn enter_class(priority: u8) -> Result<(), String> {
    use thread_priority::unix::{
        RealtimeThreadSchedulePolicy, ThreadSchedulePolicy, set_thread_priority_and_policy, thread_native_id,
    };
    use thread_priority::{ThreadPriority, ThreadPriorityValue};
    // Timers of other classes may come 50 us late to save power.
    let _ = rustix::thread::set_current_timer_slack(std::num::NonZeroU64::new(1));
    let priority = ThreadPriorityValue::try_from(priority).map_err(|e| e.to_string())?;
    set_thread_priority_and_policy(
        thread_native_id(),
        ThreadPriority::Crossplatform(priority),
        ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo),
    )
    .map_err(|e| match e {
        thread_priority::Error::OS(code) => std::io::Error::from_raw_os_error(code).to_string(),
        other => format!("{other:?}"),
    })
}

#[cfg(not(target_os = "linux"))]
fn enter_class(_priority: u8) -> Result<(), String> {
    Err("this system's class is not known to the program".into())
}

#[cfg(target_os = "linux")]
fn pin(core: Option<usize>) -> Result<usize, String> {
    use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
    let allowed = sched_getaffinity(None).map_err(|e| e.to_string())?;
    let last = (0..CpuSet::MAX_CPU).rev().find(|&core| allowed.is_set(core));
    let core = core.or(last).ok_or("no core is allowed")?;
    if core >= CpuSet::MAX_CPU || !allowed.is_set(core) {
        return Err(format!("core {core} is not one that the program may use"));
    }
    if allowed.count() < 2 {
        return Err("there is only one".into());
    }
    let mut own = CpuSet::new();
    own.set(core);
    sched_setaffinity(None, &own).map_err(|e| e.to_string())?;
    Ok(core)
}

#[cfg(not(target_os = "linux"))]
fn pin(_core: Option<usize>) -> Result<usize, String> {
    Err("this system does not pin threads".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wait_ends_after_its_moment() {
        for wait_ns in [0, 20_000, 300_000] {
            let deadline_ns = now_ns() + wait_ns;
            wait_until(deadline_ns);
            assert!(now_ns() >= deadline_ns);
        }
        let past_ns = now_ns() - 1_000;
        wait_until(past_ns);
    }

    #[test]
    fn what_the_system_does_not_allow_is_said() {
        // In its own thread: it stays as it is put.
        let scheduling = std::thread::spawn(|| make_punctual(Some(100_000))).join().unwrap();
        assert!(
            scheduling.core.is_none() && scheduling.text.contains("core 100000 is not one"),
            "{scheduling:?}"
        );
        assert_eq!(scheduling.is_real_time, !scheduling.text.contains("CAP_SYS_NICE"), "{scheduling:?}");
    }
}
