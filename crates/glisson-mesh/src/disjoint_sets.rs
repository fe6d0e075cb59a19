//! Sets that grow together.

/// Disjoint sets with path halving. A root is the smallest member of its set, so that roots do not depend on the order of
/// joins.
pub(crate) struct DisjointSets {
    parent: Vec<u32>,
    n_sets: usize,
}

impl DisjointSets {
    /// `n` sets of one member each.
    ///
    /// # Panics
    /// Above 2^32 members, which no mesh that fits in memory has.
    pub(crate) fn new(n: usize) -> Self {
        Self { parent: (0..u32::try_from(n).expect("fewer than 2^32 members")).collect(), n_sets: n }
    }

    /// How many sets there are.
    pub(crate) fn n_sets(&self) -> usize {
        self.n_sets
    }

    /// The smallest member of the set of `at`.
    pub(crate) fn root(&mut self, mut at: usize) -> usize {
        while self.parent[at] as usize != at {
            self.parent[at] = self.parent[self.parent[at] as usize];
            at = self.parent[at] as usize;
        }
        at
    }

    /// Makes one set of those of `a` and `b`.
    pub(crate) fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        if a != b {
            self.parent[a.max(b)] = a.min(b) as u32;
            self.n_sets -= 1;
        }
    }
}
