//! Threads: the library starts none, the caller provides them.

use std::sync::Arc;

/// Work in numbered tasks that may run in any order and at the same time.
pub type Task = Arc<dyn Fn(usize) + Send + Sync>;

/// A runner of tasks.
pub trait Workers {
    /// Calls `task` once with each of `0..n_tasks`; returns when all are done.
    fn run(&self, n_tasks: usize, task: &Task);
}

/// The calling thread alone.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sequential;

impl Workers for Sequential {
    fn run(&self, n_tasks: usize, task: &Task) {
        for i in 0..n_tasks {
            task(i);
        }
    }
}
