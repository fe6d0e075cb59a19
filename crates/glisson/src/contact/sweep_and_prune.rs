//! Sweep and prune: the ends of all boxes, sorted along each axis, and the set of pairs that overlap now.
//!
//! Seed 000, s. 4.2.2. From one step to the next the ends hardly change places, so that insertion sort is fast; every
//! exchange of a lower end with an upper end begins or ends the overlap of two boxes along that axis. The expected cost
//! is n plus the number of exchanges. When there are very many (the surface was replaced, or jumped), everything is
//! sorted anew.

use super::boxes::{PairRules, RoundedBox, ThickSegment};

/// Exchanges along an axis, for each end, above which sorting anew is cheaper.
const MOST_EXCHANGES_AN_END: usize = 64;

/// One end of a box as a number that sorts by place, then lower ends before upper ones (boxes that touch overlap),
/// then by box: the order is unique.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct End(u64);

const UPPER: u64 = 1 << 31;

impl End {
    fn new(place_m: f32, id: u32, upper: bool) -> Self {
        // IEEE numbers sort as integers once negative ones are turned over; adding zero drops a minus zero.
        let bits = (place_m + 0.0).to_bits();
        let sortable = if bits >> 31 == 0 { bits | 1 << 31 } else { !bits };
        Self(u64::from(sortable) << 32 | if upper { UPPER } else { 0 } | u64::from(id))
    }

    fn id(self) -> u32 {
        (self.0 & (UPPER - 1)) as u32
    }

    fn is_upper(self) -> bool {
        self.0 & UPPER != 0
    }

    fn moved(self, boxes: &[RoundedBox], axis: usize) -> Self {
        let bounds = &boxes[self.id() as usize];
        let place_m = if self.is_upper() { bounds.high_m()[axis] } else { bounds.low_m()[axis] };
        Self::new(place_m, self.id(), self.is_upper())
    }
}

/// Sorted boxes and, if wanted, their overlapping pairs. Updating and asking never allocate.
#[derive(Clone, Debug)]
pub struct SweepAndPrune {
    /// The longest axis first. Without pairs it is the only one, and holds lower ends alone.
    axes: Vec<(usize, Vec<End>)>,
    /// Boxes of the last update.
    boxes: Vec<RoundedBox>,
    pairs: Option<PairSet>,
    /// Boxes that the sweep is inside of.
    open: Vec<u32>,
    /// Length of the longest box along the first axis [m].
    longest_m: f32,
    n_exchanges: u64,
    n_sortings: u64,
}

impl SweepAndPrune {
    /// Sorts `boxes` to answer queries alone.
    pub fn for_queries(boxes: &[RoundedBox]) -> Self {
        let axis = longest_axis(boxes);
        let ends = (0..boxes.len() as u32).map(|id| End(u64::from(id))).collect();
        let mut sweep = Self {
            axes: vec![(axis, ends)],
            boxes: boxes.to_vec(),
            pairs: None,
            open: Vec::new(),
            longest_m: 0.0,
            n_exchanges: 0,
            n_sortings: 0,
        };
        sweep.sort_anew(boxes, None);
        sweep
    }

    /// Sorts `boxes` and keeps the pairs that `rules` allow, `pair_capacity` of them at most.
    pub fn for_pairs(boxes: &[RoundedBox], rules: &PairRules, pair_capacity: usize) -> Self {
        let first = longest_axis(boxes);
        let n = boxes.len() as u32;
        let ends: Vec<End> = (0..n).flat_map(|id| [id.into(), u64::from(id) | UPPER]).map(End).collect();
        let mut sweep = Self {
            axes: (0..3).map(|a| ((first + a) % 3, ends.clone())).collect(),
            boxes: boxes.to_vec(),
            pairs: Some(PairSet::new(pair_capacity)),
            open: Vec::with_capacity(boxes.len()),
            longest_m: 0.0,
            n_exchanges: 0,
            n_sortings: 0,
        };
        sweep.sort_anew(boxes, Some(rules));
        sweep
    }

    /// Exchanges of neighbouring ends since the start.
    pub fn n_exchanges(&self) -> u64 {
        self.n_exchanges
    }

    /// How often everything was sorted anew, at the start included.
    pub fn n_sortings(&self) -> u64 {
        self.n_sortings
    }

    /// Pairs that found no room now; 0 when all were kept. Then it needs a larger capacity.
    pub fn n_dropped(&self) -> u64 {
        self.pairs.as_ref().map_or(0, |pairs| pairs.n_dropped)
    }

    /// Follows the boxes; as many as at the start, with the same rules.
    pub fn update(&mut self, boxes: &[RoundedBox], rules: &PairRules) {
        // A set that had to drop a pair is no longer what the exchanges are about.
        if self.n_dropped() > 0 || !self.exchange(boxes, rules) {
            self.sort_anew(boxes, Some(rules));
        }
        self.boxes.copy_from_slice(boxes);
        self.measure(boxes);
    }

    fn measure(&mut self, boxes: &[RoundedBox]) {
        let axis = self.axes[0].0;
        // Minus infinity for a broken box: no length.
        self.longest_m = boxes.iter().fold(0.0_f32, |l, b| l.max(b.high_m()[axis] - b.low_m()[axis]));
    }

    /// Insertion sort along each axis. Answers false when it gave up.
    fn exchange(&mut self, boxes: &[RoundedBox], rules: &PairRules) -> bool {
        let old = &self.boxes;
        for (axis, ends) in &mut self.axes {
            for end in ends.iter_mut() {
                *end = end.moved(boxes, *axis);
            }
            let mut left = MOST_EXCHANGES_AN_END * ends.len();
            for i in 1..ends.len() {
                let end = ends[i];
                let mut place = i;
                while place > 0 && ends[place - 1] > end {
                    let passed = ends[place - 1];
                    ends[place] = passed;
                    place -= 1;
                    if passed.is_upper() != end.is_upper()
                        && let Some(pairs) = &mut self.pairs
                    {
                        let (a, b) = (end.id(), passed.id());
                        let [box_a, box_b] = [&boxes[a as usize], &boxes[b as usize]];
                        if passed.is_upper() {
                            if box_a.overlaps(box_b) && rules.allows(a, b) {
                                pairs.insert(a, b);
                            }
                        } else if old[a as usize].overlaps(&old[b as usize]) && !box_a.overlaps(box_b) {
                            pairs.remove(a, b);
                        }
                    }
                }
                ends[place] = end;
                self.n_exchanges += (i - place) as u64;
                left = left.saturating_sub(i - place);
                if left == 0 {
                    return false;
                }
            }
        }
        true
    }

    /// Sorts from any order, and finds the pairs by one sweep along the first axis.
    fn sort_anew(&mut self, boxes: &[RoundedBox], rules: Option<&PairRules>) {
        self.n_sortings += 1;
        for (axis, ends) in &mut self.axes {
            for end in ends.iter_mut() {
                *end = end.moved(boxes, *axis);
            }
            ends.sort_unstable();
        }
        if let (Some(pairs), Some(rules)) = (&mut self.pairs, rules) {
            pairs.clear();
            self.open.clear();
            for end in &self.axes[0].1 {
                let id = end.id();
                let bounds = &boxes[id as usize];
                if bounds.is_nothing() {
                    continue;
                }
                if end.is_upper() {
                    if let Some(place) = self.open.iter().position(|&o| o == id) {
                        self.open.swap_remove(place);
                    }
                    continue;
                }
                for &other in &self.open {
                    if bounds.overlaps(&boxes[other as usize]) && rules.allows(id, other) {
                        pairs.insert(id, other);
                    }
                }
                self.open.push(id);
            }
        }
        self.measure(boxes);
    }

    /// Calls `visit` once for each overlapping pair, the lower index first; for none without pairs.
    pub fn for_each_pair(&self, mut visit: impl FnMut(u32, u32)) {
        if let Some(pairs) = &self.pairs {
            pairs.list.iter().for_each(|&[a, b]| visit(a, b));
        }
    }

    /// Calls `visit` once for each box that `query` may touch.
    pub fn for_each_near(&self, query: &ThickSegment, mut visit: impl FnMut(u32)) {
        let (axis, ends) = &self.axes[0];
        let bounds = query.bounds();
        // Rounding of the difference: one unit in the last place of its terms.
        let lowest_m = bounds.low_m()[*axis] - self.longest_m;
        let lowest_m = lowest_m - 2.0 * f32::EPSILON * (lowest_m.abs() + self.longest_m);
        let lowest = End::new(lowest_m, 0, false);
        let highest = End::new(bounds.high_m()[*axis], 0, true);
        let first = ends.partition_point(|end| *end < lowest);
        for end in ends[first..].iter().take_while(|end| **end < highest) {
            let bounds = &self.boxes[end.id() as usize];
            if !end.is_upper() && query.may_touch(bounds) {
                visit(end.id());
            }
        }
    }
}

fn longest_axis(boxes: &[RoundedBox]) -> usize {
    let all = boxes.iter().fold(RoundedBox::NOTHING, |all, one| all.joined(one));
    let size = all.size_m();
    (1..3).fold(0, |best, axis| if size[axis] > size[best] { axis } else { best })
}

/// A set of pairs with a fixed capacity: a list, and a hash table of places in it (open addressing, Knuth, The Art
/// of Computer Programming 3, s. 6.4, algorithms L and R).
#[derive(Clone, Debug)]
struct PairSet {
    list: Vec<[u32; 2]>,
    capacity: usize,
    table: Vec<u32>,
    n_dropped: u64,
}

const EMPTY: u32 = u32::MAX;

impl PairSet {
    fn new(capacity: usize) -> Self {
        let capacity = capacity.max(16);
        Self {
            list: Vec::with_capacity(capacity),
            capacity,
            table: vec![EMPTY; (2 * capacity).next_power_of_two()],
            n_dropped: 0,
        }
    }

    fn clear(&mut self) {
        self.list.clear();
        self.table.fill(EMPTY);
        self.n_dropped = 0;
    }

    fn home(&self, [a, b]: [u32; 2]) -> usize {
        // Multiplication by the golden ratio; the upper bits are well mixed.
        let key = (u64::from(a) << 32 | u64::from(b)).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        (key >> (64 - self.table.len().trailing_zeros())) as usize
    }

    /// Slot of the pair, or the empty slot where it belongs.
    fn slot(&self, pair: [u32; 2]) -> usize {
        let mut slot = self.home(pair);
        while self.table[slot] != EMPTY && self.list[self.table[slot] as usize] != pair {
            slot = (slot + 1) & (self.table.len() - 1);
        }
        slot
    }

    fn insert(&mut self, a: u32, b: u32) {
        let pair = [a.min(b), a.max(b)];
        let slot = self.slot(pair);
        if self.table[slot] != EMPTY {
            return;
        }
        if self.list.len() == self.capacity {
            self.n_dropped += 1;
            return;
        }
        self.table[slot] = self.list.len() as u32;
        self.list.push(pair);
    }

    fn remove(&mut self, a: u32, b: u32) {
        let mut hole = self.slot([a.min(b), a.max(b)]);
        let place = self.table[hole];
        if place == EMPTY {
            return;
        }
        // The last pair of the list takes the place.
        let last = (self.list.len() - 1) as u32;
        if place != last {
            let slot = self.slot(self.list[last as usize]);
            self.table[slot] = place;
        }
        self.list.swap_remove(place as usize);
        // Entries behind the hole move up if they may.
        let mask = self.table.len() - 1;
        self.table[hole] = EMPTY;
        let mut next = hole;
        loop {
            next = (next + 1) & mask;
            if self.table[next] == EMPTY {
                return;
            }
            let home = self.home(self.list[self.table[next] as usize]);
            if next.wrapping_sub(home) & mask >= next.wrapping_sub(hole) & mask {
                self.table[hole] = self.table[next];
                self.table[next] = EMPTY;
                hole = next;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::SeededRandom;
    use std::collections::BTreeSet;

    #[test]
    fn the_pair_set_holds_what_a_set_of_the_standard_library_holds() {
        let mut random = SeededRandom::new(9);
        let (mut found, mut expected) = (PairSet::new(300), BTreeSet::new());
        for _ in 0..20_000 {
            let pair = [0, 0].map(|_| (random.uniform() * 24.0) as u32);
            if random.uniform() < 0.5 {
                found.insert(pair[0], pair[1]);
                expected.insert([pair[0].min(pair[1]), pair[0].max(pair[1])]);
            } else {
                found.remove(pair[0], pair[1]);
                expected.remove(&[pair[0].min(pair[1]), pair[0].max(pair[1])]);
            }
            assert_eq!(found.list.len(), expected.len());
        }
        assert_eq!(found.list.iter().copied().collect::<BTreeSet<_>>(), expected);
        assert!(expected.len() > 50 && found.n_dropped == 0);
    }

    #[test]
    fn ends_sort_like_their_places_and_lower_ends_first() {
        let places = [-1e30_f32, -2.0, -1e-20, 0.0, 1e-20, 1.0, 1.000_000_1, 3e29];
        for pair in places.windows(2) {
            assert!(End::new(pair[0], 5, true) < End::new(pair[1], 2, false));
        }
        assert!(End::new(1.0, 9, false) < End::new(1.0, 3, true));
        assert!(End::new(-0.0, 3, false) < End::new(0.0, 3, true));
        assert!(End::new(0.0, 3, false) < End::new(-0.0, 3, true));
    }
}
