//! A tree of boxes, refitted in every step and built anew when it has become bad.
//!
//! Built once from the top: the boxes are parted at medians of their centres along the longest axis, so that four
//! consecutive ones, and then four groups of four, lie close together. Refitting keeps that order and makes every box
//! hold its four children again (after van den Bergen 1997, "Efficient collision detection of complex deformable models
//! using AABB trees", J. Graphics Tools 2(4), who has two children). Four children lie side by side in memory, one
//! coordinate of all four after the other, so that a box is compared with all four at once.
//!
//! When the boxes of the tree have together grown to twice the surface, relative to the boxes that they hold, the tree
//! is built anew in the same memory.

use super::boxes::{PairRules, RoundedBox, ThickSegment};
use glam::{Vec3, Vec4};

/// How much worse than after its building a tree may become: a choice.
const WORST_GROWTH: f32 = 2.0;

/// Groups of four whose attached pairs are kept as bits.
const PATCH: usize = 64;

/// Four boxes, one coordinate after the other.
#[derive(Clone, Copy, Debug)]
struct FourBoxes {
    low_m: [Vec4; 3],
    high_m: [Vec4; 3],
}

impl FourBoxes {
    const NOTHING: Self = Self { low_m: [Vec4::INFINITY; 3], high_m: [Vec4::NEG_INFINITY; 3] };

    #[inline]
    fn set(&mut self, lane: usize, bounds: &RoundedBox) {
        let (low, high) = (bounds.low_m(), bounds.high_m());
        for axis in 0..3 {
            self.low_m[axis][lane] = low[axis];
            self.high_m[axis][lane] = high[axis];
        }
    }

    /// Bits of the boxes here that overlap box `lane` of `other`.
    #[inline]
    fn overlapping(&self, other: &Self, lane: usize) -> u32 {
        let mut all = Vec4::splat(other.low_m[0][lane]).cmple(self.high_m[0]);
        all &= self.low_m[0].cmple(Vec4::splat(other.high_m[0][lane]));
        for axis in 1..3 {
            all &= Vec4::splat(other.low_m[axis][lane]).cmple(self.high_m[axis]);
            all &= self.low_m[axis].cmple(Vec4::splat(other.high_m[axis][lane]));
        }
        all.bitmask()
    }

    /// Bits 4 i + j of the boxes j here that overlap box i of `other`. All sixteen are compared before any is looked at:
    /// one loop over few bits costs one wrong guess of the processor, four loops cost four.
    #[inline]
    fn overlapping_four(&self, other: &Self) -> u32 {
        (0..4).fold(0, |bits, lane| bits | self.overlapping(other, lane) << (4 * lane))
    }

    /// The box around all four.
    #[inline]
    fn bounds(&self) -> (Vec3, Vec3) {
        let low = self.low_m.map(Vec4::min_element);
        let high = self.high_m.map(Vec4::max_element);
        (Vec3::from_array(low), Vec3::from_array(high))
    }

    /// Half the surface of the four together [m2].
    #[inline]
    fn surface_m2(&self) -> f32 {
        let [x, y, z] = [0, 1, 2].map(|axis| (self.high_m[axis] - self.low_m[axis]).max(Vec4::ZERO));
        (x * y + y * z + z * x).element_sum()
    }
}

/// The tree. Updating and asking never allocate.
#[derive(Clone, Debug)]
pub struct Hierarchy {
    /// The boxes from the largest to the smallest, so that four consecutive ones are children of one box.
    order: Vec<u32>,
    /// Vertices of their triangles in this order; of no triangle where there are no rules.
    vertices: Vec<Vec4>,
    /// For each patch of them, and pairs i, j of its groups, the bits of pairs that are not attached: most
    /// neighbours are, and this does not change while the surface deforms. Empty in a tree that is compared with others.
    free: Vec<[[u16; PATCH]; PATCH]>,
    /// Groups of four of all levels, the finest level (the boxes themselves) first.
    groups: Vec<FourBoxes>,
    /// Where each level starts in `groups`, the finest first, and the end.
    levels: Vec<usize>,
    growth_at_building: f32,
    n_buildings: u64,
}

impl Hierarchy {
    /// A tree over `boxes`, for pairs that `rules` allow; rules for no triangle serve for queries alone.
    pub fn new(boxes: &[RoundedBox], rules: &PairRules) -> Self {
        Self::with_patches(boxes, rules, boxes.len().div_ceil(4 * PATCH))
    }

    /// A tree over `boxes` for [`Hierarchy::for_each_pair_with`] alone.
    pub(super) fn for_others(boxes: &[RoundedBox], rules: &PairRules) -> Self {
        Self::with_patches(boxes, rules, 0)
    }

    fn with_patches(boxes: &[RoundedBox], rules: &PairRules, n_patches: usize) -> Self {
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
            free: vec![[[u16::MAX; PATCH]; PATCH]; n_patches],
            groups: vec![FourBoxes::NOTHING; end],
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
            for (free, near) in self.free.iter_mut().zip(self.vertices.chunks(4 * PATCH)) {
                *free = [[u16::MAX; PATCH]; PATCH];
                for (a, one) in near.iter().enumerate() {
                    for (b, other) in near[..=a].iter().enumerate() {
                        if PairRules::attached(*one, *other) {
                            free[a / 4][b / 4] &= !(1 << (4 * (a % 4) + b % 4));
                            free[b / 4][a / 4] &= !(1 << (4 * (b % 4) + a % 4));
                        }
                    }
                }
            }
        }
        self.growth_at_building = self.refit(boxes);
        self.n_buildings += 1;
    }

    /// Makes every box hold its children; answers how much larger the tree's boxes are than those that it holds.
    fn refit(&mut self, boxes: &[RoundedBox]) -> f32 {
        for (group, four) in self.groups.iter_mut().zip(self.order.chunks(4)) {
            for (lane, &b) in four.iter().enumerate() {
                group.set(lane, &boxes[b as usize]);
            }
        }
        let n_finest = self.levels[1];
        let (mut of_boxes, mut of_tree) = (0.0_f32, 0.0_f32);
        for level in 1..self.levels.len() - 1 {
            let first = self.levels[level - 1];
            let (finer, coarser) = self.groups.split_at_mut(self.levels[level]);
            for (place, group) in finer[first..].iter().enumerate() {
                let (low, high) = group.bounds();
                let parent = &mut coarser[place / 4];
                for axis in 0..3 {
                    parent.low_m[axis][place % 4] = low[axis];
                    parent.high_m[axis][place % 4] = high[axis];
                }
            }
        }
        for (place, group) in self.groups.iter().enumerate() {
            if place < n_finest {
                of_boxes += group.surface_m2();
            } else {
                of_tree += group.surface_m2();
            }
        }
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
    pub fn for_each_pair(&self, rules: &PairRules, mut visit: impl FnMut(u32, u32)) {
        if !self.order.is_empty() {
            let mut found = |a: usize, b: usize| {
                let is_free = a / (4 * PATCH) == b / (4 * PATCH)
                    || !PairRules::attached(self.vertices[a], self.vertices[b]);
                if is_free {
                    let (s, t) = (self.order[a], self.order[b]);
                    if rules.bodies_allow(s, t) {
                        visit(s.min(t), s.max(t));
                    }
                }
            };
            self.pairs_within(self.top(), 0, &mut found);
        }
    }

    /// Pairs among the boxes below one group.
    fn pairs_within(&self, level: usize, group: usize, found: &mut impl FnMut(usize, usize)) {
        let four = &self.groups[self.levels[level] + group];
        // Each pair once: bits above the diagonal.
        let mut pairs = four.overlapping_four(four) & 0b0000_1000_1100_1110;
        if level == 0 {
            pairs &= self.free_pairs(group, group);
        }
        while pairs != 0 {
            let pair = pairs.trailing_zeros() as usize;
            pairs &= pairs - 1;
            self.pairs_of_children(level, [4 * group + pair / 4, 4 * group + pair % 4], found);
        }
        if level > 0 {
            for child in self.children(level, group) {
                self.pairs_within(level - 1, child, found);
            }
        }
    }

    /// Pairs of two boxes that overlap: themselves on the finest level, else of the groups that they hold.
    #[inline(always)]
    fn pairs_of_children(&self, level: usize, [a, b]: [usize; 2], found: &mut impl FnMut(usize, usize)) {
        if level == 0 {
            found(a, b);
        } else {
            self.pairs_between(level - 1, [a, b], found);
        }
    }

    /// Bits of the pairs of two groups of the same patch that are not attached.
    #[inline]
    fn free_pairs(&self, a: usize, b: usize) -> u32 {
        u32::from(self.free[a / PATCH][a % PATCH][b % PATCH])
    }

    /// Pairs with one box below each of two groups.
    fn pairs_between(&self, level: usize, [a, b]: [usize; 2], found: &mut impl FnMut(usize, usize)) {
        let start = self.levels[level];
        let (four_a, four_b) = (&self.groups[start + a], &self.groups[start + b]);
        let mut pairs = four_b.overlapping_four(four_a);
        if level == 0 && a / PATCH == b / PATCH {
            pairs &= self.free_pairs(a, b);
        }
        while pairs != 0 {
            let pair = pairs.trailing_zeros() as usize;
            pairs &= pairs - 1;
            self.pairs_of_children(level, [4 * a + pair / 4, 4 * b + pair % 4], found);
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
            self.pairs_with(other, level_a, [a, b], found);
        }
    }

    /// Pairs with one box below a group here and one below a group of `other` on the same level.
    fn pairs_with(
        &self,
        other: &Self,
        level: usize,
        [a, b]: [usize; 2],
        found: &mut impl FnMut(usize, usize),
    ) {
        let four_a = &self.groups[self.levels[level] + a];
        let mut pairs = other.groups[other.levels[level] + b].overlapping_four(four_a);
        while pairs != 0 {
            let pair = pairs.trailing_zeros() as usize;
            pairs &= pairs - 1;
            let [a, b] = [4 * a + pair / 4, 4 * b + pair % 4];
            if level == 0 {
                found(a, b);
            } else {
                self.pairs_with(other, level - 1, [a, b], found);
            }
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
        let mut bounds = FourBoxes::NOTHING;
        bounds.set(0, &query.bounds());
        self.near(self.top(), 0, &bounds, boxes, query, &mut visit);
    }

    fn near(
        &self,
        level: usize,
        group: usize,
        bounds: &FourBoxes,
        boxes: &[RoundedBox],
        query: &ThickSegment,
        visit: &mut impl FnMut(u32),
    ) {
        let four = &self.groups[self.levels[level] + group];
        let mut lanes = four.overlapping(bounds, 0);
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
                let corner = |list: &[Vec4; 3]| Vec3::from_array(list.map(|x| x[lane]));
                if query.may_touch_between(corner(&four.low_m), corner(&four.high_m)) {
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
