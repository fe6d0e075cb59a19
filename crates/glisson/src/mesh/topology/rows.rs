//! Rows of ids of different lengths in one flat array, and sets of ids as bits.

use std::marker::PhantomData;

use crate::mesh::remap::MeshEntity;

/// Row `i` holds the ids next to entity `i`, ascending. A row only ever shrinks in place, so that a removal
/// allocates nothing, and keeps its order, so that it depends on what is left and not on how it came about.
#[derive(Clone, Debug, Default)]
pub(super) struct Rows<I> {
    starts: Vec<u32>,
    lengths: Vec<u32>,
    items: Vec<I>,
}

impl<I: MeshEntity> Rows<I> {
    /// Rows from `(row, item)` pairs; within a row the items keep the order of the pairs.
    pub(super) fn from_pairs(n_rows: usize, pairs: impl Iterator<Item = (usize, I)> + Clone) -> Self {
        let mut lengths = vec![0u32; n_rows];
        let mut n_items = 0;
        for (row, _) in pairs.clone() {
            lengths[row] += 1;
            n_items += 1;
        }
        let mut starts = Vec::with_capacity(n_rows);
        let mut next = 0u32;
        for &length in &lengths {
            starts.push(next);
            next += length;
        }
        let mut cursor = starts.clone();
        let mut items = vec![I::from_index(0); n_items];
        for (row, item) in pairs {
            items[cursor[row] as usize] = item;
            cursor[row] += 1;
        }
        Self { starts, lengths, items }
    }

    pub(super) fn row(&self, row: usize) -> &[I] {
        let start = self.starts[row] as usize;
        &self.items[start..start + self.lengths[row] as usize]
    }

    pub(super) fn n_rows(&self) -> usize {
        self.starts.len()
    }

    /// Takes `item` out of `row` and returns how many are left.
    pub(super) fn remove(&mut self, row: usize, item: I) -> usize {
        let start = self.starts[row] as usize;
        let length = self.lengths[row] as usize;
        let items = &mut self.items[start..start + length];
        let at = items.iter().position(|&i| i == item).expect("the row holds every live neighbour");
        items.copy_within(at + 1.., at);
        self.lengths[row] -= 1;
        length - 1
    }
}

/// A set of ids that lists its members in ascending order; changing it allocates nothing.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct IdSet<I> {
    words: Vec<u64>,
    n_members: usize,
    kind: PhantomData<I>,
}

impl<I: MeshEntity> IdSet<I> {
    /// The empty set that can hold the ids below `n_ids`.
    pub(super) fn with_room_for(n_ids: usize) -> Self {
        Self { words: vec![0; n_ids.div_ceil(64)], n_members: 0, kind: PhantomData }
    }

    pub(super) fn len(&self) -> usize {
        self.n_members
    }

    pub(super) fn contains(&self, id: I) -> bool {
        self.words[id.index() / 64] >> (id.index() % 64) & 1 == 1
    }

    pub(super) fn insert(&mut self, id: I) {
        if !self.contains(id) {
            self.words[id.index() / 64] |= 1 << (id.index() % 64);
            self.n_members += 1;
        }
    }

    pub(super) fn remove(&mut self, id: I) {
        if self.contains(id) {
            self.words[id.index() / 64] &= !(1 << (id.index() % 64));
            self.n_members -= 1;
        }
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = I> + Clone + '_ {
        self.words.iter().enumerate().flat_map(|(w, &word)| {
            let mut rest = word;
            std::iter::from_fn(move || {
                if rest == 0 {
                    return None;
                }
                let bit = rest.trailing_zeros() as usize;
                rest &= rest - 1;
                Some(I::from_index(64 * w + bit))
            })
        })
    }
}
