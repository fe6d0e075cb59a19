//! A tree of boxes, refitted in every step and built anew when it has become bad.
//!
//! Built once from the top: the boxes are parted at medians of their centres along the longest axis, so that four
//! consecutive ones, and then four groups of four, lie close together. Refitting keeps that order and makes every box
//! hold its four children again (after van den Bergen 1997, "Efficient collision detection of complex deformable models
//! using AABB trees", J. Graphics Tools 2(4), who has two children). Four children lie side by side in memory, so that two
//! groups are compared at once.
//!
//! Most groups that overlap do so because triangles in them share a vertex, which does not change while the surface
//! deforms. These pairs of groups are listed when the tree is built, with the pairs in them that are left to be looked
//! at: the search goes along the list, from place to near place in memory, and down from there only where groups
//! overlap that have nothing in common.
//!
//! When the boxes of the tree have together grown to twice the surface, relative to the boxes that they hold, the tree
//! is built anew in the same memory.

use super::boxes::{PairRules, RoundedBox, ThickSegment};
use super::four_boxes::{FourBoxes, Overlaps, Taken};
use fearless_simd::{Level, Simd, dispatch};
use glam::{Vec3, Vec4};

/// How much worse than after its building a tree may become: a choice.
const WORST_GROWTH: f32 = 2.0;

/// As many times the groups, on the finest level and on those above, may be listed before pairs of different groups find
/// no room and are looked for like any other: on a closed surface there are four or five a group, beside itself.
const LISTED_PER_GROUP: usize = 8;

/// Groups that wait for a search at most: fifteen more on each of sixteen levels.
const MOST_WAITING: usize = 256;

/// Two groups of one level, or one group twice, and the pairs of their boxes that are looked at.
#[derive(Clone, Copy, Debug)]
struct GroupPair {
    level: u16,
    wanted: Overlaps,
    groups: [u32; 2],
}

impl GroupPair {
    const NONE: Self = Self { level: 0, wanted: Overlaps::ALL, groups: [0; 2] };

    fn is_of_one_group(&self) -> bool {
        self.groups[0] == self.groups[1]
    }
}

/// A list that does not grow, nor shrink when it is copied.
#[derive(Clone, Debug)]
struct List {
    pairs: Vec<GroupPair>,
    n: usize,
}

impl List {
    /// For so many groups; none if the tree needs no list.
    fn new(n_groups: usize, is_wanted: bool) -> Self {
        let room = if is_wanted { (1 + LISTED_PER_GROUP) * n_groups } else { 0 };
        Self { pairs: vec![GroupPair::NONE; room], n: 0 }
    }

    fn listed(&self) -> &[GroupPair] {
        &self.pairs[..self.n]
    }

    /// Whether there was room: always for a group with itself, once for each.
    fn push(&mut self, pair: GroupPair) -> bool {
        let n_groups = self.pairs.len() / (1 + LISTED_PER_GROUP);
        let has_room = pair.is_of_one_group() || self.n < LISTED_PER_GROUP * n_groups;
        if has_room {
            self.pairs[self.n] = pair;
            self.n += 1;
        }
        has_room
    }
}

/// The tree. Updating and asking never allocate.
#[derive(Clone, Debug)]
pub struct Hierarchy {
    /// The boxes from the largest to the smallest, so that four consecutive ones are children of one box.
    order: Vec<u32>,
    /// Vertices of their triangles in this order; of no triangle where there are no rules.
    vertices: Vec<Vec4>,
    /// Groups of four of all levels, the finest level (the boxes themselves) first.
    groups: Vec<FourBoxes>,
    /// Where each level starts in `groups`, the finest first, and the end.
    levels: Vec<usize>,
    /// On the finest level: each group with itself, and those that have attached boxes, whose pairs are left out.
    listed: List,
    /// On the levels above: each group with itself, and those that hold listed groups, which are left out.
    listed_above: List,
    growth_at_building: f32,
    n_buildings: u64,
}

impl Hierarchy {
    /// A tree over `boxes`, for pairs that `rules` allow.
    pub fn for_pairs(boxes: &[RoundedBox], rules: &PairRules) -> Self {
        Self::with_list(boxes, rules, true)
    }

    /// A tree over `boxes` for [`Hierarchy::for_each_near`] and [`Hierarchy::for_each_pair_with`] alone.
    pub fn for_queries(boxes: &[RoundedBox], rules: &PairRules) -> Self {
        Self::with_list(boxes, rules, false)
    }

    fn with_list(boxes: &[RoundedBox], rules: &PairRules, has_list: bool) -> Self {
        let n = boxes.len();
        let mut levels = vec![0];
        let mut n_groups = n.div_ceil(4);
        let mut end = n_groups;
        levels.push(end);
        while n_groups > 1 {
            n_groups = n_groups.div_ceil(4);
            end += n_groups;
            levels.push(end);
        }
        let mut tree = Self {
            order: (0..n as u32).collect(),
            vertices: vec![Vec4::NAN; n],
            groups: vec![FourBoxes::NOTHING; end],
            listed: List::new(levels[1], has_list),
            listed_above: List::new(end - levels[1], has_list),
            levels,
            growth_at_building: 0.0,
            n_buildings: 0,
        };
        tree.build(boxes, rules);
        tree
    }

    /// How often it was built, at the start included.
    pub fn n_buildings(&self) -> u64 {
        self.n_buildings
    }

    fn build(&mut self, boxes: &[RoundedBox], rules: &PairRules) {
        let mut block = 1;
        while 4 * block < boxes.len() {
            block *= 4;
        }
        arrange(&mut self.order, boxes, block);
        if rules.n_triangles() == boxes.len() {
            for (place, &b) in self.vertices.iter_mut().zip(&self.order) {
                *place = rules.vertices_f32(b);
            }
        }
        self.growth_at_building = self.refit(boxes);
        self.n_buildings += 1;
        self.listed.n = 0;
        self.listed_above.n = 0;
        if !self.listed.pairs.is_empty() {
            self.list_within(Level::new(), self.top(), 0);
        }
    }

    /// Makes every box hold its children; answers how much larger the tree's boxes are than those that it holds.
    fn refit(&mut self, boxes: &[RoundedBox]) -> f32 {
        for (group, four) in self.groups.iter_mut().zip(self.order.chunks(4)) {
            *group = FourBoxes::of(if let &[a, b, c, d] = four {
                [a, b, c, d].map(|b| boxes[b as usize])
            } else {
                [0, 1, 2, 3].map(|i| four.get(i).map_or(RoundedBox::NOTHING, |b| boxes[*b as usize]))
            });
        }
        for level in 1..self.levels.len() - 1 {
            let first = self.levels[level - 1];
            let (finer, coarser) = self.groups.split_at_mut(self.levels[level]);
            for (group, four) in coarser.iter_mut().zip(finer[first..].chunks(4)) {
                *group = FourBoxes::around(if let [a, b, c, d] = four {
                    [a, b, c, d]
                } else {
                    [0, 1, 2, 3].map(|i| four.get(i).unwrap_or(&FourBoxes::NOTHING))
                });
            }
        }
        let (finest, above) = self.groups.split_at(self.levels[1]);
        let [of_boxes, of_tree] = [finest, above].map(|groups| {
            groups.iter().fold(Vec4::ZERO, |sum, group| sum + group.surfaces_m2()).element_sum()
        });
        of_tree / of_boxes.max(f32::MIN_POSITIVE)
    }

    /// Follows the boxes; as many as at the start, with the same rules.
    pub fn update(&mut self, boxes: &[RoundedBox], rules: &PairRules) {
        let growth = self.refit(boxes);
        if growth > WORST_GROWTH * self.growth_at_building {
            self.build(boxes, rules);
        }
    }

    fn top(&self) -> usize {
        self.levels.len() - 2
    }

    /// Calls `visit` once for each pair of overlapping boxes that `rules` allow, the lower index first.
    ///
    /// # Panics
    /// In a tree for queries.
    pub fn for_each_pair(&self, rules: &PairRules, mut visit: impl FnMut(u32, u32)) {
        assert!(self.order.is_empty() || self.listed.n > 0, "a tree for queries lists no pairs");
        let allowed = |a: usize, b: usize| {
            let (s, t) = (self.order[a], self.order[b]);
            if rules.bodies_allow(s, t) {
                visit(s.min(t), s.max(t));
            }
        };
        dispatch!(Level::new(), simd => self.pairs_within(simd, allowed));
    }

    #[inline(always)]
    fn pairs_within<S: Simd>(&self, simd: S, mut found: impl FnMut(usize, usize)) {
        for GroupPair { wanted, groups, .. } in self.listed.listed() {
            let [a, b] = [groups[0] as usize, groups[1] as usize];
            let mut pairs = self.groups[a].overlaps(simd, &self.groups[b]).and(*wanted);
            while let Some(Taken { i, j, .. }) = pairs.take() {
                found(4 * a + i as usize, 4 * b + j as usize);
            }
        }
        let mut waiting = [GroupPair::NONE; MOST_WAITING];
        for pair in self.listed_above.listed() {
            self.pairs_below(simd, self, *pair, &mut waiting, |a, b| {
                if !PairRules::attached(self.vertices[a], self.vertices[b]) {
                    found(a, b);
                }
            });
        }
    }

    /// Lists the pairs within a group, down to the finest level.
    fn list_within(&mut self, simd: Level, level: usize, group: usize) {
        let wanted = Overlaps::OF_ONE_GROUP;
        self.list(simd, GroupPair { level: level as u16, wanted, groups: [group as u32; 2] });
        if level > 0 {
            for child in self.children(level, group) {
                self.list_within(simd, level - 1, child);
            }
        }
    }

    /// Lists a group with itself, or two groups if boxes in them are attached and there is room, and the pairs of
    /// different groups below them; answers whether it was listed.
    fn list(&mut self, simd: Level, pair: GroupPair) -> bool {
        let n_before = [self.listed.n, self.listed_above.n];
        let mut looked_at = pair.wanted;
        if pair.level > 0 {
            let start = self.levels[usize::from(pair.level)];
            let [a, b] = pair.groups.map(|group| &self.groups[start + group as usize]);
            looked_at = dispatch!(simd, simd => a.overlaps(simd, b)).and(looked_at);
        }
        let mut wanted = pair.wanted;
        while let Some(taken) = looked_at.take() {
            let below = [4 * pair.groups[0] + taken.i, 4 * pair.groups[1] + taken.j];
            let is_left_out = if pair.level == 0 {
                // Whether they overlap now or later.
                let [a, b] = below.map(|b| self.vertices.get(b as usize).copied().unwrap_or(Vec4::NAN));
                PairRules::attached(a, b)
            } else {
                self.list(simd, GroupPair { level: pair.level - 1, wanted: Overlaps::ALL, groups: below })
            };
            if is_left_out {
                wanted = wanted.without(taken);
            }
        }
        if !pair.is_of_one_group() && wanted == pair.wanted {
            return false;
        }
        let list = if pair.level == 0 { &mut self.listed } else { &mut self.listed_above };
        let is_listed = list.push(GroupPair { wanted, ..pair });
        if !is_listed {
            // What is below it is found from above, and must not be found twice.
            [self.listed.n, self.listed_above.n] = n_before;
        }
        is_listed
    }

    /// Calls `found` for the pairs of overlapping boxes below a group here and one of `other` on the same level.
    #[inline(always)]
    fn pairs_below<S: Simd>(
        &self,
        simd: S,
        other: &Self,
        pair: GroupPair,
        waiting: &mut [GroupPair; MOST_WAITING],
        mut found: impl FnMut(usize, usize),
    ) {
        waiting[0] = pair;
        let mut n_waiting = 1;
        while n_waiting > 0 {
            n_waiting -= 1;
            let GroupPair { level, wanted, groups: [a, b] } = waiting[n_waiting];
            let (here, there) = (self.levels[usize::from(level)], other.levels[usize::from(level)]);
            let four = &self.groups[here + a as usize];
            let mut pairs = four.overlaps(simd, &other.groups[there + b as usize]).and(wanted);
            while let Some(Taken { i, j, .. }) = pairs.take() {
                let groups = [4 * a + i, 4 * b + j];
                if level == 0 {
                    found(groups[0] as usize, groups[1] as usize);
                } else {
                    waiting[n_waiting] = GroupPair { level: level - 1, wanted: Overlaps::ALL, groups };
                    n_waiting += 1;
                }
            }
        }
    }

    /// Calls `visit` once for each overlapping pair of a box here and one of `other` that is not attached; of one body only
    /// if `rules` want it.
    pub(super) fn for_each_pair_with(
        &self,
        rules: &PairRules,
        other: &Self,
        other_rules: &PairRules,
        mut visit: impl FnMut(u32, u32),
    ) {
        let mut found = |a: usize, b: usize| {
            if !PairRules::attached(self.vertices[a], other.vertices[b]) {
                let (s, t) = (self.order[a], other.order[b]);
                if rules.bodies_allow_with(s, other_rules, t) {
                    visit(s, t);
                }
            }
        };
        if !self.order.is_empty() && !other.order.is_empty() {
            self.pairs_down_with(other, [self.top(), other.top()], [0, 0], &mut found);
        }
    }

    /// Goes down in the higher tree to the level of the lower one.
    fn pairs_down_with(
        &self,
        other: &Self,
        [level_a, level_b]: [usize; 2],
        [a, b]: [usize; 2],
        found: &mut impl FnMut(usize, usize),
    ) {
        if level_a > level_b {
            for child in self.children(level_a, a) {
                self.pairs_down_with(other, [level_a - 1, level_b], [child, b], found);
            }
        } else if level_b > level_a {
            for child in other.children(level_b, b) {
                self.pairs_down_with(other, [level_a, level_b - 1], [a, child], found);
            }
        } else {
            let pair =
                GroupPair { level: level_a as u16, wanted: Overlaps::ALL, groups: [a as u32, b as u32] };
            let mut waiting = [GroupPair::NONE; MOST_WAITING];
            dispatch!(Level::new(), simd => self.pairs_below(simd, other, pair, &mut waiting, found));
        }
    }

    /// The groups that a group above the finest level holds.
    fn children(&self, level: usize, group: usize) -> std::ops::Range<usize> {
        let n = self.levels[level] - self.levels[level - 1];
        4 * group..(4 * group + 4).min(n)
    }

    /// Calls `visit` once for each box that `query` may touch. `boxes` are those of the last update.
    pub fn for_each_near(&self, boxes: &[RoundedBox], query: &ThickSegment, mut visit: impl FnMut(u32)) {
        if self.order.is_empty() {
            return;
        }
        let bounds = query.bounds();
        self.near(self.top(), 0, &bounds, boxes, query, &mut visit);
    }

    fn near(
        &self,
        level: usize,
        group: usize,
        bounds: &RoundedBox,
        boxes: &[RoundedBox],
        query: &ThickSegment,
        visit: &mut impl FnMut(u32),
    ) {
        let four = &self.groups[self.levels[level] + group];
        let mut lanes = four.overlapping(bounds);
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize;
            lanes &= lanes - 1;
            let child = 4 * group + lane;
            if level == 0 {
                let b = self.order[child];
                if query.may_touch(&boxes[b as usize]) {
                    visit(b);
                }
            } else {
                let [low_m, high_m] = four.corners_m(lane);
                if query.may_touch_between(low_m, high_m) {
                    self.near(level - 1, child, bounds, boxes, query, visit);
                }
            }
        }
    }
}

/// Sorts `order` so that every `block` of it (a power of four, the children of the top) and the quarters of every block
/// lie close together.
fn arrange(order: &mut [u32], boxes: &[RoundedBox], block: usize) {
    if order.len() <= 4 {
        return;
    }
    if order.len() <= block {
        return arrange(order, boxes, block / 4);
    }
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for &b in order.iter() {
        let bounds = &boxes[b as usize];
        if !bounds.is_nothing() {
            low = low.min(bounds.center_m());
            high = high.max(bounds.center_m());
        }
    }
    let size = high - low;
    let axis = (1..3).fold(0, |best, axis| if size[axis] > size[best] { axis } else { best });
    let cut = if order.len() > 2 * block { 2 * block } else { block };
    order.select_nth_unstable_by(cut, |&s, &t| {
        // A box of nothing has no centre, and goes to the end.
        let center = |b: u32| {
            let center = boxes[b as usize].center_m()[axis];
            if center.is_nan() { f32::INFINITY } else { center }
        };
        center(s).total_cmp(&center(t)).then(s.cmp(&t))
    });
    let (left, right) = order.split_at_mut(cut);
    arrange(left, boxes, block);
    arrange(right, boxes, block);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{DVec3, SeededRandom};

    fn pairs_of(tree: &Hierarchy, rules: &PairRules) -> Vec<[u32; 2]> {
        let mut found = Vec::new();
        tree.for_each_pair(rules, |s, t| found.push([s, t]));
        found.sort_unstable();
        found
    }

    fn by_brute_force(boxes: &[RoundedBox], rules: &PairRules) -> Vec<[u32; 2]> {
        let n = boxes.len() as u32;
        (0..n)
            .flat_map(|s| (s + 1..n).map(move |t| [s, t]))
            .filter(|&[s, t]| boxes[s as usize].overlaps(&boxes[t as usize]) && rules.allows(s, t))
            .collect()
    }

    /// Triangles around one vertex, and as many without a common one, near each other; from `broken` on without a box.
    fn fan(n: u32, seed: u64, broken: usize) -> (Vec<RoundedBox>, PairRules) {
        let mut random = SeededRandom::new(seed);
        let around = (0..n).map(|i| [0, 1 + i, 2 + i]);
        let alone = (0..n).map(|i| [n + 2 + 3 * i, n + 3 + 3 * i, n + 4 + 3 * i]);
        let triangles: Vec<[u32; 3]> = around.chain(alone).collect();
        let boxes = (0..triangles.len()).map(|t| {
            let mut point = || DVec3::new(random.uniform(), random.uniform(), random.uniform());
            let (low, size) = (point(), 0.3 * point());
            if t < broken { RoundedBox::new(low, low + size, 0.0) } else { RoundedBox::NOTHING }
        });
        let boxes = boxes.collect();
        (boxes, PairRules::new(&triangles, &vec![0; triangles.len()], true))
    }

    #[test]
    fn pairs_are_found_where_more_are_attached_than_can_be_listed() {
        let (boxes, rules) = fan(400, 1, usize::MAX);
        let tree = Hierarchy::for_pairs(&boxes, &rules);
        let room = tree.listed.pairs.len();
        assert!(tree.listed.n >= room * LISTED_PER_GROUP / (1 + LISTED_PER_GROUP), "the list is full");
        let expected = by_brute_force(&boxes, &rules);
        assert!(expected.len() > 1000, "{}", expected.len());
        assert_eq!(pairs_of(&tree, &rules), expected);
    }

    #[test]
    fn pairs_come_once_where_there_is_no_room_above_the_finest_level() {
        // Boxes at one place: every group overlaps all others, and one triangle in sixteen belongs to a fan.
        let triangle = |t: u32| {
            if t.is_multiple_of(16) {
                [0, 1 + t, 17 + t]
            } else {
                [3 * t, 3 * t + 1, 3 * t + 2].map(|v| v + 1000)
            }
        };
        let triangles: Vec<[u32; 3]> = (0..512).map(triangle).collect();
        let boxes = vec![RoundedBox::new(DVec3::ZERO, DVec3::ONE, 0.0); triangles.len()];
        let rules = PairRules::new(&triangles, &vec![0; triangles.len()], true);
        let tree = Hierarchy::for_pairs(&boxes, &rules);
        assert_eq!(pairs_of(&tree, &rules), by_brute_force(&boxes, &rules));
    }

    #[test]
    fn pairs_are_found_wherever_the_boxes_were_when_the_list_was_made() {
        for n in [1, 2, 3, 9, 40, 130] {
            for broken in [0, n as usize, usize::MAX] {
                let (boxes, rules) = fan(n, 2, broken);
                let mut tree = Hierarchy::for_pairs(&boxes, &rules);
                assert_eq!(pairs_of(&tree, &rules), by_brute_force(&boxes, &rules));
                for seed in 3..6 {
                    let (boxes, _) = fan(n, seed, usize::MAX);
                    let mut copy = tree.clone();
                    for tree in [&mut tree, &mut copy] {
                        tree.update(&boxes, &rules);
                        assert_eq!(pairs_of(tree, &rules), by_brute_force(&boxes, &rules), "{n} {broken}");
                    }
                }
            }
        }
    }
}
