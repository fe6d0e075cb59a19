//! Three structures behind one contract: which triangles can touch, found without looking at every pair.
//!
//! All three answer the same questions about the same boxes with the same set of answers, but for boxes that a query
//! misses by a millionth of their size; they differ in cost and in the order of the answers, which is the same for the
//! same history, on every machine and at any thread count.

use super::box_grid::BoxGrid;
use super::boxes::{PairRules, RoundedBox, ThickSegment};
use super::hierarchy::Hierarchy;
use super::sweep_and_prune::SweepAndPrune;

/// Which structure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BroadPhaseKind {
    /// Buckets, sorted anew in every step: [`BoxGrid`].
    Buckets,
    /// Sweep and prune with insertion sort: [`SweepAndPrune`].
    SweepAndPrune,
    /// A refitted tree of boxes: [`Hierarchy`].
    Hierarchy,
}

impl BroadPhaseKind {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Buckets, Self::SweepAndPrune, Self::Hierarchy];
}

/// What it is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wanted {
    /// Triangles near a given place: a tool against a surface.
    Queries,
    /// Pairs of triangles as well; room for that many where pairs are kept.
    Pairs {
        /// Pairs that overlap at one time at most.
        capacity: usize,
    },
}

/// One of the structures, over a fixed number of boxes. Updating and asking never allocate.
#[derive(Clone, Debug)]
pub enum BroadPhase {
    /// Buckets.
    Buckets(BoxGrid),
    /// Sweep and prune.
    SweepAndPrune(SweepAndPrune),
    /// Hierarchy.
    Hierarchy(Hierarchy),
}

impl BroadPhase {
    /// A structure of `kind` over `boxes`.
    pub fn new(kind: BroadPhaseKind, boxes: &[RoundedBox], rules: &PairRules, wanted: Wanted) -> Self {
        match (kind, wanted) {
            (BroadPhaseKind::Buckets, _) => Self::Buckets(BoxGrid::new(boxes)),
            (BroadPhaseKind::Hierarchy, Wanted::Queries) => {
                Self::Hierarchy(Hierarchy::for_queries(boxes, rules))
            }
            (BroadPhaseKind::Hierarchy, Wanted::Pairs { .. }) => {
                Self::Hierarchy(Hierarchy::for_pairs(boxes, rules))
            }
            (BroadPhaseKind::SweepAndPrune, Wanted::Queries) => {
                Self::SweepAndPrune(SweepAndPrune::for_queries(boxes))
            }
            (BroadPhaseKind::SweepAndPrune, Wanted::Pairs { capacity }) => {
                Self::SweepAndPrune(SweepAndPrune::for_pairs(boxes, rules, capacity))
            }
        }
    }

    /// Which structure it is.
    pub fn kind(&self) -> BroadPhaseKind {
        match self {
            Self::Buckets(_) => BroadPhaseKind::Buckets,
            Self::SweepAndPrune(_) => BroadPhaseKind::SweepAndPrune,
            Self::Hierarchy(_) => BroadPhaseKind::Hierarchy,
        }
    }

    /// Follows the boxes after the surface deformed; as many as at the start, with the same rules.
    pub fn update(&mut self, boxes: &[RoundedBox], rules: &PairRules) {
        match self {
            Self::Buckets(grid) => grid.update(boxes),
            Self::SweepAndPrune(sweep) => sweep.update(boxes, rules),
            Self::Hierarchy(tree) => tree.update(boxes, rules),
        }
    }

    /// Calls `visit` once for each box that `query` may touch ([`ThickSegment::may_touch`]). `boxes` are those of the
    /// last update.
    pub fn for_each_near(&self, boxes: &[RoundedBox], query: &ThickSegment, visit: impl FnMut(u32)) {
        match self {
            Self::Buckets(grid) => grid.for_each_near(boxes, query, visit),
            Self::SweepAndPrune(sweep) => sweep.for_each_near(query, visit),
            Self::Hierarchy(tree) => tree.for_each_near(boxes, query, visit),
        }
    }

    /// Calls `visit` once for each pair of overlapping boxes that `rules` allow, the lower index first. `boxes` and
    /// `rules` are those of the last update. Sweep and prune has them only if it was made for pairs.
    pub fn for_each_pair(&self, boxes: &[RoundedBox], rules: &PairRules, visit: impl FnMut(u32, u32)) {
        match self {
            Self::Buckets(grid) => grid.for_each_pair(boxes, rules, visit),
            Self::SweepAndPrune(sweep) => sweep.for_each_pair(visit),
            Self::Hierarchy(tree) => tree.for_each_pair(rules, visit),
        }
    }

    /// Pairs that found no room since the last update; above 0 the answer of `for_each_pair` lacks them, and the
    /// structure has to be made anew with more room.
    pub fn n_dropped(&self) -> u64 {
        match self {
            Self::SweepAndPrune(sweep) => sweep.n_dropped(),
            Self::Buckets(_) | Self::Hierarchy(_) => 0,
        }
    }
}
