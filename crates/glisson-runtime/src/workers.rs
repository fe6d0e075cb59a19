//! A small team of threads for work that is repeated many times a second.
//!
//! Each thread stays on one core, waits for the next round in a short spin, then parks. A round of a few
//! microseconds' tasks is too short for a pool that wakes its threads through a queue (rayon gains nothing below
//! some 100 microseconds).

use anyhow::Context;
use std::hint::spin_loop;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{JoinHandle, Thread, yield_now};
use std::time::{Duration, Instant};

use glisson::workers::{Sequential, SharedWorkers, Task, Workers};

/// How long a thread spins before it parks: a little longer than the pause between two rounds of a step.
const SPIN: Duration = Duration::from_micros(50);
/// Looks at the clock once in so many turns of a spin.
const SPINS_PER_LOOK: u32 = 64;
/// The lower half of a ticket: the next task. The upper half is the round.
const ROUND: u64 = 1 << 32;

/// The work of a round. It is the caller's: the pointer is good until all of the round's tasks are done.
#[derive(Clone, Copy)]
struct Work(*const Task<'static>);

#[allow(unsafe_code, reason = "tasks may be called from any thread")]
// SAFETY: a [`Task`] is `Sync`, and the pointer is followed only as [`Work::call`] says.
unsafe impl Send for Work {}

#[allow(unsafe_code, reason = "threads that outlive a round work for a caller who waits for its end")]
impl Work {
    fn of(task: &Task<'_>) -> Self {
        // SAFETY: the two types differ in their lifetime alone.
        Self(unsafe { std::mem::transmute::<*const Task<'_>, *const Task<'static>>(task) })
    }

    /// # Safety
    /// One of the tasks of its round must be the calling thread's and not be done: then the round's caller waits.
    unsafe fn call(self, i: usize) {
        // SAFETY: the caller of [`WorkerTeam::run`], who holds the task, waits.
        unsafe { (*self.0)(i) }
    }
}

/// A round's work.
struct Round {
    number: u64,
    n_tasks: usize,
    work: Option<Work>,
}

struct Shared {
    round: Mutex<Round>,
    /// Round and next task in one number, so that a late thread never takes a task of another round.
    ticket: AtomicU64,
    n_done: AtomicUsize,
    has_panicked: AtomicBool,
    is_closing: AtomicBool,
}

impl Shared {
    fn round(&self) -> MutexGuard<'_, Round> {
        self.round.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes tasks of this round until none is left.
    #[allow(unsafe_code, reason = "calls the work of a round that is not over")]
    fn work(&self, number: u64, n_tasks: usize, work: Work) {
        let mut ticket = self.ticket.load(Ordering::Acquire);
        while ticket / ROUND == number && ((ticket % ROUND) as usize) < n_tasks {
            match self.ticket.compare_exchange_weak(ticket, ticket + 1, Ordering::AcqRel, Ordering::Acquire) {
                Ok(_) => {
                    let i = (ticket % ROUND) as usize;
                    // SAFETY: task `i` of this round is this thread's now, and not counted as done before it is.
                    if let Err(panic) = catch_unwind(AssertUnwindSafe(|| unsafe { work.call(i) })) {
                        // Its end may panic too, which nothing would catch.
                        std::mem::forget(panic);
                        self.has_panicked.store(true, Ordering::Relaxed);
                    }
                    self.n_done.fetch_add(1, Ordering::Release);
                    ticket = self.ticket.load(Ordering::Acquire);
                }
                Err(now) => ticket = now,
            }
        }
    }

    /// A thread's life.
    fn serve(&self) {
        let mut served = 0;
        loop {
            let start = Instant::now();
            let mut turns = 0_u32;
            while self.ticket.load(Ordering::Acquire) / ROUND == served {
                if self.is_closing.load(Ordering::Acquire) {
                    return;
                }
                turns += 1;
                if turns.is_multiple_of(SPINS_PER_LOOK) && start.elapsed() > SPIN {
                    // A round or the end that came just now has left a token: then this returns at once.
                    std::thread::park();
                } else {
                    spin_loop();
                }
            }
            let (number, n_tasks, work) = {
                let round = self.round();
                (round.number, round.n_tasks, round.work)
            };
            served = number;
            if let Some(work) = work {
                self.work(number, n_tasks, work);
            }
        }
    }
}

/// The calling thread and others, each on a core of its own where the system allows.
pub struct WorkerTeam {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
    wake: Vec<Thread>,
    /// One round at a time.
    turn: Mutex<()>,
}

impl WorkerTeam {
    /// A team of `n_threads`, the calling one among them.
    ///
    /// # Errors
    /// When the system starts no thread.
    pub fn new(n_threads: usize) -> std::io::Result<Self> {
        let shared = Arc::new(Shared {
            round: Mutex::new(Round { number: 0, n_tasks: 0, work: None }),
            ticket: AtomicU64::new(0),
            n_done: AtomicUsize::new(0),
            has_panicked: AtomicBool::new(false),
            is_closing: AtomicBool::new(false),
        });
        let mut team = Self { shared, threads: Vec::new(), wake: Vec::new(), turn: Mutex::new(()) };
        let cores = allowed_cores();
        for i in 1..n_threads {
            let shared = Arc::clone(&team.shared);
            // From the last core down: the first ones have the system's own work.
            let core = (cores.len() >= n_threads).then(|| cores[cores.len() - i]);
            let thread = std::thread::Builder::new().name(format!("worker {i}")).spawn(move || {
                if let Some(core) = core {
                    stay_on(core);
                }
                shared.serve();
            })?;
            team.wake.push(thread.thread().clone());
            team.threads.push(thread);
        }
        Ok(team)
    }
}

/// A team of so many threads, or the calling thread alone.
///
/// # Errors
/// When the system starts no thread.
pub fn shared_workers(n_threads: usize) -> anyhow::Result<SharedWorkers> {
    Ok(match n_threads {
        0 | 1 => Arc::new(Sequential),
        n => Arc::new(WorkerTeam::new(n).context("starting the worker threads")?),
    })
}

impl Workers for WorkerTeam {
    fn run(&self, n_tasks: usize, task: &Task<'_>) {
        if n_tasks <= 1 || self.threads.is_empty() {
            (0..n_tasks).for_each(task);
            return;
        }
        let _turn = self.turn.lock().unwrap_or_else(PoisonError::into_inner);
        let work = Work::of(task);
        let number = {
            let mut round = self.shared.round();
            round.number = (round.number + 1) % ROUND;
            round.n_tasks = n_tasks;
            round.work = Some(work);
            self.shared.n_done.store(0, Ordering::Relaxed);
            self.shared.ticket.store(round.number * ROUND, Ordering::Release);
            round.number
        };
        for thread in &self.wake {
            thread.unpark();
        }
        self.shared.work(number, n_tasks, work);
        let mut turns = 0_u32;
        while self.shared.n_done.load(Ordering::Acquire) < n_tasks {
            turns += 1;
            // On a busy machine the thread that has the last task may wait for this core.
            if turns.is_multiple_of(1024) { yield_now() } else { spin_loop() }
        }
        assert!(!self.shared.has_panicked.swap(false, Ordering::Relaxed), "a task panicked");
    }
}

impl Drop for WorkerTeam {
    fn drop(&mut self) {
        self.shared.is_closing.store(true, Ordering::Release);
        for thread in &self.wake {
            thread.unpark();
        }
        for thread in self.threads.drain(..) {
            // A thread's tasks are caught one by one; it has nothing else to panic about.
            let _ = thread.join();
        }
    }
}

/// Cores that the calling thread may use, ascending.
#[cfg(target_os = "linux")]
pub fn allowed_cores() -> Vec<usize> {
    let Ok(set) = rustix::thread::sched_getaffinity(None) else { return Vec::new() };
    (0..rustix::thread::CpuSet::MAX_CPU).filter(|&core| set.is_set(core)).collect()
}

/// Keeps this thread on one core; without the right to, it goes where the system puts it.
#[cfg(target_os = "linux")]
fn stay_on(core: usize) {
    let mut set = rustix::thread::CpuSet::new();
    set.set(core);
    let _ = rustix::thread::sched_setaffinity(None, &set);
}

#[cfg(not(target_os = "linux"))]
pub(crate) fn allowed_cores() -> Vec<usize> {
    Vec::new()
}

#[cfg(not(target_os = "linux"))]
fn stay_on(_core: usize) {}

/// `act(0)` to `act(n - 1)`, on `n_threads` threads at most, the calling one among them; what comes out is in their order. For work of
/// milliseconds and more: threads are started for it.
pub fn side_by_side<T: Send>(n_threads: usize, n: usize, act: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let n_threads = n_threads.min(n);
    if n_threads < 2 {
        return (0..n).map(act).collect();
    }
    let next = AtomicUsize::new(0);
    let take_turns = || {
        let mut done = Vec::new();
        loop {
            let i = next.fetch_add(1, Ordering::Relaxed);
            if i >= n {
                return done;
            }
            done.push((i, act(i)));
        }
    };
    let mut done: Vec<(usize, T)> = std::thread::scope(|scope| {
        let others: Vec<_> = (1..n_threads).map(|_| scope.spawn(take_turns)).collect();
        let mut done = take_turns();
        for other in others {
            done.extend(other.join().unwrap_or_else(|panic| resume_unwind(panic)));
        }
        done
    });
    done.sort_by_key(|(i, _)| *i);
    done.into_iter().map(|(_, what)| what).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_done_side_by_side_comes_out_in_order() {
        for n_threads in [0, 1, 2, 5] {
            assert_eq!(side_by_side(n_threads, 40, |i| i * i), (0..40).map(|i| i * i).collect::<Vec<_>>());
            assert!(side_by_side(n_threads, 0, |i| i).is_empty());
            let broken = catch_unwind(|| side_by_side(n_threads, 9, |i| assert!(i != 4, "the fourth")));
            assert!(broken.is_err(), "{n_threads}");
        }
    }

    #[test]
    fn every_task_runs_once_in_every_round_spinning_or_parked() {
        for n_threads in [1, 2, 4] {
            let team = WorkerTeam::new(n_threads).unwrap();
            let counts: Vec<AtomicUsize> = (0..37).map(|_| AtomicUsize::new(0)).collect();
            let task = |i: usize| {
                counts[i].fetch_add(1, Ordering::Relaxed);
            };
            for round in 1..=600 {
                team.run(37, &task);
                assert!(counts.iter().all(|c| c.load(Ordering::Relaxed) == round), "round {round}");
                if round % 200 == 0 {
                    std::thread::sleep(2 * SPIN);
                }
            }
            team.run(0, &task);
        }
    }

    #[test]
    fn a_panic_in_a_task_reaches_the_caller_and_the_team_lives_on() {
        let team = WorkerTeam::new(2).unwrap();
        let caught = catch_unwind(AssertUnwindSafe(|| team.run(8, &|i| assert!(i != 5))));
        assert!(caught.is_err());
        team.run(8, &|_| {});
    }
}
