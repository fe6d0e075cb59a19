//! Threads for models, which take tasks from the last to the first.

use std::sync::Arc;

use glisson_tissue::workers::{Sequential, SharedWorkers, Task, Workers};
use rayon::prelude::*;

struct Team(rayon::ThreadPool);

impl Workers for Team {
    fn run(&self, n_tasks: usize, task: &Task<'_>) {
        self.0.install(|| (0..n_tasks).into_par_iter().rev().with_max_len(1).for_each(task));
    }
}

/// So many threads.
pub(crate) fn team(n_threads: usize) -> SharedWorkers {
    if n_threads == 1 {
        return Arc::new(Sequential);
    }
    Arc::new(Team(rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().unwrap()))
}
