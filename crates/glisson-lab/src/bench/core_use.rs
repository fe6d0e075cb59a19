//! What else a core did while a thread of this process ran on it: whether a machine was free to be punctual.
//!
//! Linux counts the ticks of each core (`/proc/stat`) and of each thread (`/proc/self/task/N/stat`), both in the same unit: what a
//! core did beside a thread that is pinned to it is their difference.

/// A core with more than this share of its time taken by others is not free, nor one from which the machine's host took more
/// than that: choices. Others cost a thread of the real-time class tens of microseconds, a host milliseconds.
const MOST_OTHERS: f64 = 0.1;
const MOST_STOLEN: f64 = 1e-3;

/// Ticks of a core, or sums of them over several spans of time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct CoreUse {
    /// All of them.
    total: f64,
    /// Those in which it worked for somebody else than the thread.
    others: f64,
    /// Those in which the host of a virtual machine gave it to another one.
    stolen: f64,
}

/// Counters at a moment: of the core, and of the thread.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Moment {
    core: Counted,
    thread: f64,
}

/// The ticks of one core.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Counted {
    total: f64,
    idle: f64,
    stolen: f64,
}

impl Moment {
    /// The counters of a core and of this process' thread of that name now; none where the system does not tell.
    pub(super) fn now(core: usize, thread: &str) -> Option<Self> {
        let core = core_ticks(&std::fs::read_to_string("/proc/stat").ok()?, core)?;
        let mut own = None;
        for entry in std::fs::read_dir("/proc/self/task").ok()?.flatten() {
            // A thread may end while one looks.
            let stat = std::fs::read_to_string(entry.path().join("stat")).unwrap_or_default();
            own = own.or(thread_ticks(&stat, thread));
        }
        Some(Self { core, thread: own? })
    }
}

impl CoreUse {
    /// From one moment to another.
    pub(super) fn between(from: &Moment, to: &Moment) -> Self {
        let of = |value: fn(&Counted) -> f64| value(&to.core) - value(&from.core);
        let (total, stolen) = (of(|c| c.total), of(|c| c.stolen));
        let busy = total - of(|c| c.idle) - stolen;
        // Both are rounded to ticks.
        Self { total, stolen, others: (busy - (to.thread - from.thread)).max(0.0) }
    }

    /// Both together.
    pub(super) fn and(self, other: Self) -> Self {
        Self {
            total: self.total + other.total,
            others: self.others + other.others,
            stolen: self.stolen + other.stolen,
        }
    }

    /// Share of the time that others had.
    pub(super) fn others_share(&self) -> f64 {
        self.others / self.total
    }

    /// Share of the time that the host took.
    pub(super) fn stolen_share(&self) -> f64 {
        self.stolen / self.total
    }

    /// Whether a punctual thread could be punctual on it; not where nothing was counted.
    pub(super) fn was_free(&self) -> bool {
        self.others_share() <= MOST_OTHERS && self.stolen_share() <= MOST_STOLEN
    }
}

/// The line `cpuN` of `/proc/stat`: user, nice, system, idle, iowait, irq, softirq, steal; the guests' that follow are counted in
/// the first two.
fn core_ticks(stat: &str, core: usize) -> Option<Counted> {
    let name = format!("cpu{core}");
    let line = stat.lines().find(|line| line.split_whitespace().next() == Some(name.as_str()))?;
    let ticks: Vec<f64> = line.split_whitespace().skip(1).take(8).flat_map(str::parse).collect();
    let &[_, _, _, idle, waits, _, _, stolen] = ticks.as_slice() else { return None };
    Some(Counted { total: ticks.iter().sum(), idle: idle + waits, stolen })
}

/// Ticks of a thread from its `stat`, if it has that name: `utime` and `stime`, the 12th and 13th field behind the name, which
/// may itself hold blanks and brackets.
fn thread_ticks(stat: &str, name: &str) -> Option<f64> {
    let (before, after) = stat.rsplit_once(')')?;
    let (_, found) = before.split_once('(')?;
    let ticks: Vec<f64> = after.split_whitespace().skip(11).take(2).flat_map(str::parse).collect();
    (found == name && ticks.len() == 2).then(|| ticks.iter().sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    const STAT: &str =
        "cpu  7 7 7 7 7 7 7 7 7 7\ncpu1 100 20 30 800 10 0 5 3 0 0\ncpu10 1 2 3 4 5 6 7 8 9 9\nintr 5 0\n";

    #[test]
    fn ticks_are_read_from_the_systems_lines() {
        assert_eq!(core_ticks(STAT, 1), Some(Counted { total: 968.0, idle: 810.0, stolen: 3.0 }));
        assert_eq!(core_ticks(STAT, 10).map(|c| c.stolen), Some(8.0));
        assert_eq!(core_ticks(STAT, 2), None);
        let stat = "17 (a (b) c) S 1 2 3 4 -1 5 6 7 8 9 40 2 0 0 20 0 1 0";
        assert_eq!(thread_ticks(stat, "a (b) c"), Some(42.0));
        assert_eq!(thread_ticks(stat, "b"), None);
        assert_eq!(thread_ticks("", "b"), None);
    }

    #[test]
    fn a_core_is_free_when_others_and_the_host_leave_it() {
        let at = |total: f64, idle: f64, stolen: f64, thread: f64| Moment {
            core: Counted { total, idle, stolen },
            thread,
        };
        let from = at(1000.0, 500.0, 1.0, 10.0);
        let used = CoreUse::between(&from, &at(2000.0, 1400.0, 2.0, 60.0));
        assert_eq!(used, CoreUse { total: 1000.0, others: 49.0, stolen: 1.0 });
        assert!(used.was_free());
        assert!(!CoreUse::between(&from, &at(2000.0, 1300.0, 2.0, 60.0)).was_free(), "others");
        assert!(!CoreUse::between(&from, &at(2000.0, 1400.0, 4.0, 60.0)).was_free(), "the host");
        assert!(!CoreUse::default().was_free(), "nothing was counted");
        assert_eq!(used.and(used).others_share(), used.others_share());
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn this_system_tells_of_a_working_thread() {
        let work = || {
            let begun = Moment::now(0, "worker").expect("Linux counts");
            // So much processor time of its own, however long that takes.
            let until_ns = crate::bench::thread_cpu_ns() + 30_000_000;
            while crate::bench::thread_cpu_ns() < until_ns {
                std::hint::spin_loop();
            }
            (begun, Moment::now(0, "worker").expect("Linux counts"))
        };
        let worker = std::thread::Builder::new().name("worker".into()).spawn(work).expect("a thread");
        let (begun, ended) = worker.join().expect("it does not panic");
        assert!(ended.thread - begun.thread >= 1.0, "{begun:?} {ended:?}");
        assert_eq!(Moment::now(0, "nobody"), None);
    }
}
