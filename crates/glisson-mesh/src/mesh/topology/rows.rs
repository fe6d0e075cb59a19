//! Rows of ids of different lengths in one flat array, and sets of ids as bits.

use std::marker::PhantomData;

use crate::mesh::change::MeshEntity;

/// Row `i` holds the ids next to entity `i`, ascending, so that it depends on what is there and not on how it
/// came about. A row shrinks in place: a removal allocates nothing. A row that grows beyond its room moves to
/// the end of the flat array; the room it leaves is won back when too much of it has gathered.
#[derive(Clone, Debug, Default)]
pub(super) struct Rows<I> {
    starts: Vec<u32>,
    lengths: Vec<u32>,
    rooms: Vec<u32>,
    items: Vec<I>,
    n_unused: usize,
}

/// Room of a row that starts to grow.
const FIRST_ROOM: u32 = 8;

/// Unused items that are never worth gathering.
const UNUSED_TOLERATED: usize = 4096;

fn to_u32(n: usize) -> u32 {
    u32::try_from(n).expect("neighbours of an entity fit in 32-bit counts")
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
        Self { starts, rooms: lengths.clone(), lengths, items, n_unused: 0 }
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
        // What came last goes first when an edit is undone.
        let at = items.iter().rposition(|&i| i == item).expect("the row holds every live neighbour");
        // Rows are short: a loop is quicker than a call to move memory.
        for i in at + 1..length {
            items[i - 1] = items[i];
        }
        self.lengths[row] -= 1;
        length - 1
    }

    /// Puts `item`, which is not there, in its place in `row` and returns how many there are now.
    pub(super) fn insert(&mut self, row: usize, item: I) -> usize {
        let length = self.lengths[row] as usize;
        if self.lengths[row] == self.rooms[row] {
            self.make_room(row);
        }
        let start = self.starts[row] as usize;
        let items = &mut self.items[start..=start + length];
        let mut at = length;
        while at > 0 && items[at - 1] > item {
            items[at] = items[at - 1];
            at -= 1;
        }
        items[at] = item;
        self.lengths[row] += 1;
        length + 1
    }

    fn make_room(&mut self, row: usize) {
        if self.n_unused > self.items.len() / 2 + UNUSED_TOLERATED {
            self.gather();
        }
        let (start, room) = (self.starts[row] as usize, self.rooms[row]);
        let new_room = FIRST_ROOM.max(room + room / 2);
        if start + room as usize == self.items.len() {
            self.items.resize(start + new_room as usize, I::from_index(0));
        } else {
            let new_start = self.items.len();
            self.items.extend_from_within(start..start + room as usize);
            self.items.resize(new_start + new_room as usize, I::from_index(0));
            self.starts[row] = to_u32(new_start);
            self.n_unused += room as usize;
        }
        self.rooms[row] = new_room;
    }

    /// Moves the rows together.
    fn gather(&mut self) {
        let mut items = Vec::with_capacity(self.items.len() - self.n_unused);
        for row in 0..self.n_rows() {
            let start = self.starts[row] as usize;
            self.starts[row] = to_u32(items.len());
            items.extend_from_slice(&self.items[start..start + self.rooms[row] as usize]);
        }
        self.items = items;
        self.n_unused = 0;
    }

    /// Makes room for `n_rows` more rows and `n_items` more items.
    pub(super) fn reserve(&mut self, n_rows: usize, n_items: usize) {
        self.starts.reserve(n_rows);
        self.lengths.reserve(n_rows);
        self.rooms.reserve(n_rows);
        self.items.reserve(n_items);
    }

    /// Adds an empty row.
    pub(super) fn push_row(&mut self) {
        self.starts.push(to_u32(self.items.len()));
        self.lengths.push(0);
        self.rooms.push(0);
    }

    /// Drops the rows from `n_rows` on.
    pub(super) fn truncate(&mut self, n_rows: usize) {
        for row in (n_rows..self.n_rows()).rev() {
            let (start, room) = (self.starts[row] as usize, self.rooms[row] as usize);
            if start + room == self.items.len() {
                self.items.truncate(start);
            } else {
                self.n_unused += room;
            }
        }
        self.starts.truncate(n_rows);
        self.lengths.truncate(n_rows);
        self.rooms.truncate(n_rows);
    }
}

/// Equal when the rows are; where they lie does not count.
impl<I: MeshEntity> PartialEq for Rows<I> {
    fn eq(&self, other: &Self) -> bool {
        self.n_rows() == other.n_rows() && (0..self.n_rows()).all(|row| self.row(row) == other.row(row))
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

    /// Makes it able to hold the ids below `n_ids`. Members from there on are an error of the caller.
    pub(super) fn set_room(&mut self, n_ids: usize) {
        self.words.resize(n_ids.div_ceil(64), 0);
    }

    /// Makes room for `n_ids` more ids.
    pub(super) fn reserve(&mut self, n_ids: usize) {
        self.words.reserve(n_ids.div_ceil(64) + 1);
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
