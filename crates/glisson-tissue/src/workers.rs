//! Threads: the library starts none, the caller provides them.

use std::slice::ChunksMut;
use std::sync::{Arc, Mutex, PoisonError};

/// Work in numbered tasks that may run in any order and at the same time.
pub type Task<'a> = dyn Fn(usize) + Sync + 'a;

/// A runner of tasks.
pub trait Workers: Sync {
    /// Calls `task` once with each of `0..n_tasks`; returns when all are done. A task does not run others on the same workers.
    fn run(&self, n_tasks: usize, task: &Task<'_>);
}

/// Threads that several models may share.
pub type SharedWorkers = Arc<dyn Workers + Send>;

/// The calling thread alone.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sequential;

impl Workers for Sequential {
    fn run(&self, n_tasks: usize, task: &Task<'_>) {
        for i in 0..n_tasks {
            task(i);
        }
    }
}

/// Stretches of a list: enough for some threads that are not equally fast, at a small price each.
const MOST_STRETCHES: usize = 16;

/// Lists of one length, which are divided at the same places.
pub(crate) trait Lists: Send + Sized {
    /// Their length.
    fn n_items(&self) -> usize;
    /// The first `n` of each, and the rest.
    fn divided(self, n: usize) -> (Self, Self);
}

impl<T: Send> Lists for &mut [T] {
    fn n_items(&self) -> usize {
        self.len()
    }

    fn divided(self, n: usize) -> (Self, Self) {
        self.split_at_mut(n)
    }
}

impl<A: Lists, B: Lists> Lists for (A, B) {
    fn n_items(&self) -> usize {
        self.0.n_items()
    }

    fn divided(self, n: usize) -> (Self, Self) {
        let ((a, a_rest), (b, b_rest)) = (self.0.divided(n), self.1.divided(n));
        ((a, b), (a_rest, b_rest))
    }
}

/// A list that is divided between chunks of `n`, of which the last may be shorter.
pub(crate) struct Chunks<'a, T> {
    list: &'a mut [T],
    n: usize,
}

impl<'a, T> Chunks<'a, T> {
    pub(crate) fn of(list: &'a mut [T], n: usize) -> Self {
        Self { list, n }
    }
}

impl<T: Send> Lists for Chunks<'_, T> {
    fn n_items(&self) -> usize {
        self.list.len().div_ceil(self.n)
    }

    fn divided(self, n: usize) -> (Self, Self) {
        let (own, rest) = self.list.split_at_mut(self.list.len().min(n * self.n));
        (Self { list: own, n: self.n }, Self { list: rest, n: self.n })
    }
}

impl<'a, T> IntoIterator for Chunks<'a, T> {
    type Item = &'a mut [T];
    type IntoIter = ChunksMut<'a, T>;

    fn into_iter(self) -> ChunksMut<'a, T> {
        self.list.chunks_mut(self.n)
    }
}

/// Calls `work` with each stretch of these lists and the place of its first item, at the same time where there are threads. The
/// stretches, but for the last, have `least` items or more, and follow from the lists' length alone. Nothing is allocated (on
/// Linux and Windows, whose locks are plain numbers).
pub(crate) fn in_stretches<L: Lists>(
    workers: &dyn Workers,
    least: usize,
    lists: L,
    work: impl Fn(usize, L) + Sync,
) {
    let n_items = lists.n_items();
    let n = n_items.div_ceil(MOST_STRETCHES).max(least);
    let mut rest = Some(lists);
    let stretches: [Mutex<Option<L>>; MOST_STRETCHES] = std::array::from_fn(|_| {
        let lists = rest.take();
        Mutex::new(lists.map(|lists| {
            let n_left = lists.n_items();
            let (own, others) = lists.divided(n.min(n_left));
            rest = (n_left > n).then_some(others);
            own
        }))
    });
    workers.run(n_items.div_ceil(n), &|i| {
        let own = stretches[i].lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(own) = own {
            work(n * i, own);
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_item_is_in_one_stretch() {
        for n_items in [0, 1, 7, 8, 9, 127, 128, 129, 1_000, 12_345] {
            let (mut a, mut b) = (vec![0_usize; n_items], vec![0_u8; n_items]);
            in_stretches(&Sequential, 8, (&mut a[..], &mut b[..]), |first, (a, b)| {
                assert_eq!(a.len(), b.len());
                assert!(a.len() >= 8 || first + a.len() == n_items, "{} from {first} of {n_items}", a.len());
                a.iter_mut().enumerate().for_each(|(i, a)| *a += first + i);
                b.iter_mut().for_each(|b| *b += 1);
            });
            assert!(a.iter().enumerate().all(|(i, a)| i == *a) && b.iter().all(|b| *b == 1));
        }
    }
}
