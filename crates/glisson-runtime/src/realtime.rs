//! What makes a thread punctual: its clock, absolute deadlines, the scheduler's real-time class, a core of its own.
//!
//! A core is a thread's own only if the program's other threads stay away from it: [`CoreKept::keep`] takes it from the thread
//! that starts them, before it does. What other programs do there is up to whoever runs the machine.

#[cfg(target_os = "linux")]
use rustix::time::{ClockId, Timespec};
use std::hint::spin_loop;

/// The scheduler wakes a thread late by some tens of microseconds: the last part of a wait is spent looking at the clock.
const SPIN_NS: u64 = 60_000;
/// Real-time priority of the haptic loop, of 1 to 99: above threads that merely left the default class, below the kernel's
/// own at 50 and more.
const PRIORITY: u8 = 40;
/// Of the threads that carry forces between machines: they give way to the haptic loop.
const LINK_PRIORITY: u8 = 30;

/// Nanoseconds on a clock that never jumps.
#[cfg(not(target_family = "wasm"))]
pub fn now_ns() -> u64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    // A monotonic clock counts from the machine's start.
    time.tv_sec.unsigned_abs() * 1_000_000_000 + time.tv_nsec.unsigned_abs()
}

/// Nanoseconds on a clock that never jumps.
#[cfg(target_family = "wasm")]
pub fn now_ns() -> u64 {
    static FIRST_ASKED: std::sync::OnceLock<std::time::Instant> = std::sync::OnceLock::new();
    FIRST_ASKED.get_or_init(std::time::Instant::now).elapsed().as_nanos() as u64
}

/// Waits until that moment of [`now_ns`]; answers at once when it has passed.
pub fn wait_until(deadline_ns: u64) {
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
pub struct Scheduling {
    /// Whether the thread is in the real-time class.
    pub is_real_time: bool,
    /// The core that it stays on.
    pub core: Option<usize>,
    /// One sentence.
    pub text: String,
}

/// Where a punctual thread stays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum OwnCore {
    /// On the last core that it may use.
    #[default]
    Last,
    /// On this one, if it may use it.
    Asked(usize),
    /// On this one, from which the program's other threads were kept away: [`CoreKept`].
    Kept(usize),
}

/// Puts the calling thread into the real-time class, and on one core, where the system allows it.
pub fn make_punctual(core: OwnCore) -> Scheduling {
    let policy = enter_real_time_class();
    let pinned = pin(core);
    let policy_text = match &policy {
        Ok(()) => format!("SCHED_FIFO {PRIORITY}"),
        Err(reason) => format!(
            "no real-time scheduling ({reason}; allow it with `ulimit -r {PRIORITY}` or CAP_SYS_NICE)"
        ),
    };
    let core_text = match &pinned {
        Ok(number) if core == OwnCore::Kept(*number) => {
            format!("on core {number}, which the program's other threads do not use")
        }
        Ok(number) => format!("on core {number}"),
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
pub fn make_prompt() -> bool {
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

/// A core that a punctual thread will have for itself. The calling thread, and threads and programs that it starts from now on,
/// do not use it; until this is dropped.
pub struct CoreKept {
    core: OwnCore,
    #[cfg(target_os = "linux")]
    before: Option<rustix::thread::CpuSet>,
}

impl CoreKept {
    /// Keeps the core that is `asked` for, or else the last one that the calling thread may use. With one core alone, and where
    /// the system does not allow it, nothing changes.
    pub fn keep(asked: Option<usize>) -> Self {
        keep(asked)
    }

    /// For the thread that it is kept for.
    pub fn core(&self) -> OwnCore {
        self.core
    }
}

#[cfg(target_os = "linux")]
fn keep(asked: Option<usize>) -> CoreKept {
    use rustix::thread::{sched_getaffinity, sched_setaffinity};
    let otherwise = CoreKept { core: asked.map_or(OwnCore::Last, OwnCore::Asked), before: None };
    let Ok(before) = sched_getaffinity(None) else { return otherwise };
    // A number beyond all cores is refused by `pin`, which says so.
    let Ok(core) = number_of(otherwise.core, &before) else { return otherwise };
    let mut others = before;
    others.unset(core);
    if others.count() == 0 || sched_setaffinity(None, &others).is_err() {
        return otherwise;
    }
    CoreKept { core: OwnCore::Kept(core), before: Some(before) }
}

#[cfg(not(target_os = "linux"))]
fn keep(asked: Option<usize>) -> CoreKept {
    CoreKept { core: asked.map_or(OwnCore::Last, OwnCore::Asked) }
}

#[cfg(target_os = "linux")]
impl Drop for CoreKept {
    fn drop(&mut self) {
        if let Some(before) = &self.before {
            // What was allowed is allowed; if not any more, the thread has fewer cores.
            let _ = rustix::thread::sched_setaffinity(None, before);
        }
    }
}

/// Of a thread that may use `allowed`.
#[cfg(target_os = "linux")]
fn number_of(core: OwnCore, allowed: &rustix::thread::CpuSet) -> Result<usize, String> {
    use rustix::thread::CpuSet;
    let is_allowed = |core: usize| core < CpuSet::MAX_CPU && allowed.is_set(core);
    match core {
        OwnCore::Last => (0..CpuSet::MAX_CPU).rev().find(|&core| is_allowed(core)),
        OwnCore::Asked(core) => is_allowed(core).then_some(core),
        OwnCore::Kept(core) => return Ok(core),
    }
    .ok_or_else(|| match core {
        OwnCore::Asked(core) => format!("core {core} is not one that the program may use"),
        OwnCore::Last | OwnCore::Kept(_) => "no core is allowed".into(),
    })
}

#[cfg(target_os = "linux")]
fn pin(core: OwnCore) -> Result<usize, String> {
    use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
    let allowed = sched_getaffinity(None).map_err(|e| e.to_string())?;
    let number = number_of(core, &allowed)?;
    if allowed.count() < 2 && core != OwnCore::Kept(number) {
        return Err("there is only one".into());
    }
    let mut own = CpuSet::new();
    own.set(number);
    sched_setaffinity(None, &own).map_err(|e| e.to_string())?;
    Ok(number)
}

#[cfg(not(target_os = "linux"))]
fn pin(_core: OwnCore) -> Result<usize, String> {
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
        let scheduling = std::thread::spawn(|| make_punctual(OwnCore::Asked(100_000))).join().unwrap();
        assert!(
            scheduling.core.is_none() && scheduling.text.contains("core 100000 is not one"),
            "{scheduling:?}"
        );
        assert_eq!(scheduling.is_real_time, !scheduling.text.contains("CAP_SYS_NICE"), "{scheduling:?}");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_kept_core_is_for_one_thread_alone_until_it_is_given_back() {
        use rustix::thread::sched_getaffinity;
        // In its own thread, whose cores the others of this process do not inherit.
        let on_a_thread = || {
            let before = sched_getaffinity(None).unwrap();
            let kept = CoreKept::keep(None);
            let of_another = std::thread::spawn(|| sched_getaffinity(None).unwrap()).join().unwrap();
            let of_a_program =
                std::process::Command::new("cat").arg("/proc/self/status").output().expect("cat").stdout;
            let own_core = kept.core();
            let (text, own) =
                std::thread::spawn(move || (make_punctual(own_core).text, sched_getaffinity(None).unwrap()))
                    .join()
                    .unwrap();
            if before.count() < 2 {
                assert_eq!((own_core, of_another), (OwnCore::Last, before));
                assert!(text.contains("there is only one"), "{text}");
                return;
            }
            let OwnCore::Kept(core) = own_core else { panic!("{own_core:?}") };
            assert!(before.is_set(core) && !of_another.is_set(core), "{of_another:?}");
            assert_eq!((of_another.count(), own.count()), (before.count() - 1, 1));
            assert!(own.is_set(core), "{own:?}");
            assert!(text.contains(&format!("core {core}, which the program's other threads")), "{text}");
            assert!(!crate::workers::allowed_cores().contains(&core));
            let status = String::from_utf8(of_a_program).unwrap();
            let (_, list) = status.split_once("Cpus_allowed_list:").expect("Linux tells");
            let last = list.trim_start().lines().next().unwrap().rsplit([',', '-']).next().unwrap();
            assert_ne!(last.parse(), Ok(core), "{last}");
            drop(kept);
            assert_eq!(sched_getaffinity(None).unwrap(), before);
            // What may not be used is not kept, and is refused when it is asked for.
            assert_eq!(CoreKept::keep(Some(100_000)).core(), OwnCore::Asked(100_000));
            let kept = CoreKept::keep(Some(core));
            assert_eq!(kept.core(), OwnCore::Kept(core));
        };
        std::thread::spawn(on_a_thread).join().unwrap();
    }
}
