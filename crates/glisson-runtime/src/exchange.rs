//! Hands the latest value from one thread to another. Neither side ever waits: three slots, of which each side owns one
//! and the third holds the newest value (triple buffer).

use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::{Arc, Mutex, OnceLock};
use std::thread::Thread;

/// The slot in the middle holds a value that the reader has not seen.
const IS_NEW: u8 = 4;
const SLOT: u8 = 3;

struct Shared<T> {
    /// A slot belongs to whom `middle` says, so `try_lock` succeeds at once: the mutexes are cells whose owner is checked.
    /// Nobody ever waits for one.
    slots: [Mutex<T>; 3],
    middle: AtomicU8,
    /// Who sleeps until something is published.
    sleeper: OnceLock<Thread>,
}

/// The side that gives.
pub struct Publisher<T> {
    shared: Arc<Shared<T>>,
    own: u8,
}

/// The side that takes.
pub struct Latest<T> {
    shared: Arc<Shared<T>>,
    own: u8,
}

/// Both sides; until something is published the latest value is `first`.
pub fn exchange<T: Clone>(first: T) -> (Publisher<T>, Latest<T>) {
    let slots = [Mutex::new(first.clone()), Mutex::new(first.clone()), Mutex::new(first)];
    let shared = Arc::new(Shared { slots, middle: AtomicU8::new(1), sleeper: OnceLock::new() });
    (Publisher { shared: Arc::clone(&shared), own: 0 }, Latest { shared, own: 2 })
}

impl<T> Publisher<T> {
    /// Makes `value` the latest one.
    pub fn publish(&mut self, value: T) {
        if let Ok(mut slot) = self.shared.slots[usize::from(self.own)].try_lock() {
            *slot = value;
        } else {
            debug_assert!(false, "the writer's slot is in use");
            return;
        }
        self.own = self.shared.middle.swap(self.own | IS_NEW, Ordering::AcqRel) & SLOT;
        if let Some(sleeper) = self.shared.sleeper.get() {
            sleeper.unpark();
        }
    }
}

impl<T> Latest<T> {
    /// From now on `thread` is unparked when something is published; the first one that is named stays.
    pub fn wakes(&self, thread: Thread) {
        let _ = self.shared.sleeper.set(thread);
    }
}

impl<T: Clone> Latest<T> {
    /// The latest value.
    pub fn get(&mut self) -> T {
        self.take_new();
        // The slot is this side's own: the lock is free, and a writer that panicked was never in it.
        match self.shared.slots[usize::from(self.own)].try_lock() {
            Ok(slot) => slot.clone(),
            Err(_) => unreachable!("the reader's slot is in use"),
        }
    }

    /// The latest value if it was not seen before.
    pub fn get_new(&mut self) -> Option<T> {
        self.take_new().then(|| self.get())
    }

    fn take_new(&mut self) -> bool {
        let is_new = self.shared.middle.load(Ordering::Relaxed) & IS_NEW != 0;
        if is_new {
            self.own = self.shared.middle.swap(self.own, Ordering::AcqRel) & SLOT;
        }
        is_new
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;

    #[test]
    fn the_latest_value_is_taken_once_as_new_and_kept() {
        let (mut publisher, mut latest) = exchange(0);
        assert_eq!((latest.get_new(), latest.get()), (None, 0));
        for value in 1..10 {
            publisher.publish(value);
        }
        assert_eq!((latest.get_new(), latest.get_new(), latest.get()), (Some(9), None, 9));
    }

    #[test]
    fn values_are_whole_and_in_order_while_both_sides_hurry() {
        // Both sides go on until enough was seen, not for a count: a machine may let one of them run long alone.
        const N_SEEN: u64 = 1_000;
        let (mut publisher, mut latest) = exchange([0_u64; 40]);
        let enough = Arc::new(AtomicBool::new(false));
        let writer = std::thread::spawn({
            let enough = Arc::clone(&enough);
            move || {
                let mut number = 0;
                while !enough.load(Ordering::Relaxed) {
                    number += 1;
                    publisher.publish([number; 40]);
                }
                number
            }
        });
        let (mut last, mut n_seen) = (0, 0);
        let mut look = || {
            let value = latest.get();
            assert!(value.iter().all(|&word| word == value[0]), "torn: {value:?}");
            assert!(value[0] >= last, "{} after {last}", value[0]);
            n_seen += u64::from(value[0] > last);
            last = value[0];
            n_seen
        };
        while look() < N_SEEN {}
        enough.store(true, Ordering::Relaxed);
        let newest = writer.join().unwrap();
        look();
        assert_eq!(last, newest, "the newest value comes through when the writer has ended");
    }
}
