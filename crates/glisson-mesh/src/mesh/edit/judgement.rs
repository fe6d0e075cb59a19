//! Whether an edit that opens faces may have cut a piece in two, judged on the spot.
//!
//! Around the edit stands a patch: all tetrahedra at the nodes of those that went and came. Whatever hung
//! together through the tetrahedra that went still does if the patch does. If not, the rest of the body may
//! hold it together, which only a count tells.

use super::plan::Plan;
use super::{EditableMesh, TopologyChange};
use crate::disjoint_sets::DisjointSets;
use crate::mesh::{NodeId, TetId};

/// A set of ids in ascending order, as bits: the places of all of them in it are found without a search.
struct Ranks {
    words: Vec<u64>,
    /// How many members are in earlier words.
    before: Vec<u32>,
    n_members: usize,
}

impl Ranks {
    /// The ids, all below `n_ids`; repeated ones count once.
    fn of(n_ids: usize, ids: impl Iterator<Item = usize>) -> Self {
        let mut words = vec![0_u64; n_ids.div_ceil(64)];
        for id in ids {
            words[id / 64] |= 1 << (id % 64);
        }
        let mut n_members = 0;
        let mut before = Vec::with_capacity(words.len());
        for word in &words {
            before.push(n_members);
            n_members += word.count_ones();
        }
        Self { words, before, n_members: n_members as usize }
    }

    /// Place of a member.
    fn rank(&self, id: usize) -> Option<usize> {
        let (word, bit) = (self.words[id / 64], 1_u64 << (id % 64));
        let below = (word & (bit - 1)).count_ones();
        (word & bit != 0).then(|| (self.before[id / 64] + below) as usize)
    }

    fn members(&self) -> impl Iterator<Item = usize> + '_ {
        self.words.iter().enumerate().flat_map(|(at, &word)| {
            let mut rest = word;
            std::iter::from_fn(move || {
                let bit = (rest != 0).then(|| rest.trailing_zeros() as usize)?;
                rest &= rest - 1;
                Some(64 * at + bit)
            })
        })
    }
}

impl EditableMesh {
    /// Whether tetrahedra form one piece through their faces, as most patches do.
    fn hang_together(&self, tets: &Ranks) -> bool {
        let (mut left, mut n_left) = (tets.words.clone(), tets.n_members);
        let mut to_visit: Vec<usize> = Vec::with_capacity(n_left);
        let mut reach = |tet: usize, to_visit: &mut Vec<usize>| {
            let (word, bit) = (&mut left[tet / 64], 1 << (tet % 64));
            if *word & bit != 0 {
                *word &= !bit;
                n_left -= 1;
                to_visit.push(tet);
            }
        };
        tets.members().take(1).for_each(|first| reach(first, &mut to_visit));
        while let Some(tet) = to_visit.pop() {
            for next in
                self.topology.tet_neighbours(TetId::from_index(tet)).into_iter().filter_map(|n| n.get())
            {
                reach(next.index(), &mut to_visit);
            }
        }
        n_left == 0
    }

    /// Marks in `change` which notion of a piece may have more of them than before `plan`, which was carried out.
    /// `opened`: whether faces may have been.
    pub(super) fn judge_pieces(&self, plan: &Plan, opened: bool, change: &mut TopologyChange) {
        let topology = &self.topology;
        let old = plan.doomed.iter().map(|&tet| topology.tet_nodes(tet));
        let corners = old.chain(plan.fresh.iter().copied()).flatten().map(NodeId::index);
        let nodes = Ranks::of(topology.n_nodes(), corners);
        let stars = nodes.members().flat_map(|n| topology.node_tets(NodeId::from_index(n)));
        let patch = Ranks::of(topology.n_tets(), stars.map(|t| t.index()));
        if self.hang_together(&patch) {
            return;
        }
        let mut pieces = DisjointSets::new(patch.n_members);
        let members = || patch.members().map(TetId::from_index).enumerate();
        for (at, tet) in members() {
            for next in topology.tet_neighbours(tet).into_iter().filter_map(|n| n.get()) {
                if let Some(next) = patch.rank(next.index()).filter(|&next| next < at) {
                    pieces.join(at, next);
                }
            }
        }
        change.pieces.through_faces.may_have_split |= opened && pieces.n_sets() > 1;
        if pieces.n_sets() == 1 {
            return;
        }
        for (at, tet) in members() {
            for node in topology.tet_nodes(tet) {
                let first = topology.node_tets(node)[0];
                if let Some(first) = patch.rank(first.index()).filter(|&first| first < at) {
                    pieces.join(at, first);
                }
            }
        }
        change.pieces.through_nodes.may_have_split |= pieces.n_sets() > 1;
    }
}
