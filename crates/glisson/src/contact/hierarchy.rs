//! A tree of boxes, refitted in every step and built anew when it has become bad.
//!
//! Built once from the top: the boxes are halved at the median of their centres along the longest axis. Refitting
//! keeps the tree and makes every box hold its children again (van den Bergen 1997, "Efficient collision
//! detection of complex deformable models using AABB trees", J. Graphics Tools 2(4)). When the boxes of the tree have
//! together grown to twice the surface, relative to the boxes in the leaves, the tree is built anew in the same
//! memory.

use super::boxes::{PairRules, RoundedBox, ThickSegment};

/// Boxes of a leaf at most.
const LEAF_SIZE: usize = 4;

/// How much worse than after its building a tree may become.
const WORST_GROWTH: f32 = 2.0;

/// Pairs of nodes that wait at most: a descent adds three for each of twice the levels, and a tree over 2^32 boxes
/// that are halved has 31 levels.
const MOST_WAITING: usize = 256;

#[derive(Clone, Copy, Debug)]
struct Node {
    bounds: RoundedBox,
    /// First of its boxes in `order`.
    first: u32,
    /// Number of its boxes.
    count: u32,
    /// The right child; the left one is the next node. 0 for a leaf.
    right: u32,
}

impl Node {
    fn is_leaf(&self) -> bool {
        self.right == 0
    }

    fn places(&self) -> std::ops::Range<usize> {
        self.first as usize..(self.first + self.count) as usize
    }
}

/// The tree. Updating and asking never allocate.
#[derive(Clone, Debug)]
pub struct Hierarchy {
    nodes: Vec<Node>,
    order: Vec<u32>,
    ordered_boxes: Vec<RoundedBox>,
    growth_at_building: f32,
    n_buildings: u64,
}

impl Hierarchy {
    /// A tree over `boxes`.
    pub fn new(boxes: &[RoundedBox]) -> Self {
        let n = boxes.len();
        let mut tree = Self {
            nodes: Vec::with_capacity(2 * n),
            order: (0..n as u32).collect(),
            ordered_boxes: vec![RoundedBox::NOTHING; n],
            growth_at_building: 0.0,
            n_buildings: 0,
        };
        tree.build(boxes);
        tree
    }

    /// How often it was built, at the start included.
    pub fn n_buildings(&self) -> u64 {
        self.n_buildings
    }

    fn build(&mut self, boxes: &[RoundedBox]) {
        self.nodes.clear();
        if !boxes.is_empty() {
            self.split(boxes, 0, boxes.len());
        }
        self.growth_at_building = self.refit(boxes);
        self.n_buildings += 1;
    }

    fn split(&mut self, boxes: &[RoundedBox], first: usize, count: usize) {
        let id = self.nodes.len();
        let bounds = RoundedBox::NOTHING;
        self.nodes.push(Node { bounds, first: first as u32, count: count as u32, right: 0 });
        if count <= LEAF_SIZE {
            return;
        }
        let order = &mut self.order[first..first + count];
        let (mut low, mut high) = (glam::Vec3::INFINITY, glam::Vec3::NEG_INFINITY);
        for &b in order.iter() {
            let bounds = &boxes[b as usize];
            if !bounds.is_nothing() {
                low = low.min(bounds.center_m());
                high = high.max(bounds.center_m());
            }
        }
        let size = high - low;
        let axis = if size.x >= size.y && size.x >= size.z {
            0
        } else if size.y >= size.z {
            1
        } else {
            2
        };
        let middle = count / 2;
        // A broken box has no centre: its NaN sorts behind everything, always in the same place.
        order.select_nth_unstable_by(middle, |&s, &t| {
            let center = |b: u32| boxes[b as usize].center_m()[axis];
            center(s).total_cmp(&center(t)).then(s.cmp(&t))
        });
        self.split(boxes, first, middle);
        self.nodes[id].right = self.nodes.len() as u32;
        self.split(boxes, first + middle, count - middle);
    }

    /// Makes every node hold its children; answers how much larger the nodes are than the boxes.
    fn refit(&mut self, boxes: &[RoundedBox]) -> f32 {
        for (place, &b) in self.ordered_boxes.iter_mut().zip(&self.order) {
            *place = boxes[b as usize];
        }
        let (mut of_nodes, mut of_leaves) = (0.0_f32, 0.0_f32);
        for id in (0..self.nodes.len()).rev() {
            let node = self.nodes[id];
            let bounds = if node.is_leaf() {
                let own = &self.ordered_boxes[node.places()];
                own.iter().fold(RoundedBox::NOTHING, |all, one| all.joined(one))
            } else {
                self.nodes[id + 1].bounds.joined(&self.nodes[node.right as usize].bounds)
            };
            self.nodes[id].bounds = bounds;
            let size = bounds.size_m();
            let surface = size.x * size.y + size.y * size.z + size.z * size.x;
            if surface.is_finite() {
                of_nodes += surface;
            }
        }
        for bounds in &self.ordered_boxes {
            let size = bounds.size_m();
            let surface = size.x * size.y + size.y * size.z + size.z * size.x;
            if surface.is_finite() {
                of_leaves += surface;
            }
        }
        of_nodes / of_leaves.max(f32::MIN_POSITIVE)
    }

    /// Follows the boxes; as many as at the start.
    pub fn update(&mut self, boxes: &[RoundedBox]) {
        let growth = self.refit(boxes);
        if growth > WORST_GROWTH * self.growth_at_building {
            self.build(boxes);
        }
    }

    /// Calls `visit` once for each pair of overlapping boxes that `rules` allow, the lower index first.
    pub fn for_each_pair(&self, rules: &PairRules, mut visit: impl FnMut(u32, u32)) {
        let visit = &mut visit;
        if self.nodes.is_empty() {
            return;
        }
        let mut waiting = [(0u32, 0u32); MOST_WAITING];
        let mut n = 1;
        while n > 0 {
            n -= 1;
            let (a, b) = waiting[n];
            let (node_a, node_b) = (&self.nodes[a as usize], &self.nodes[b as usize]);
            if a == b {
                if node_a.is_leaf() {
                    for s in node_a.places() {
                        self.compare(s, s + 1..node_a.places().end, rules, visit);
                    }
                } else {
                    waiting[n..n + 3].copy_from_slice(&[
                        (a + 1, node_a.right),
                        (node_a.right, node_a.right),
                        (a + 1, a + 1),
                    ]);
                    n += 3;
                }
                continue;
            }
            if !node_a.bounds.overlaps(&node_b.bounds) {
                continue;
            }
            if node_a.is_leaf() && node_b.is_leaf() {
                for s in node_a.places() {
                    if node_b.bounds.overlaps(&self.ordered_boxes[s]) {
                        self.compare(s, node_b.places(), rules, visit);
                    }
                }
            } else if node_b.is_leaf() || (!node_a.is_leaf() && node_a.count >= node_b.count) {
                waiting[n..n + 2].copy_from_slice(&[(node_a.right, b), (a + 1, b)]);
                n += 2;
            } else {
                waiting[n..n + 2].copy_from_slice(&[(a, node_b.right), (a, b + 1)]);
                n += 2;
            }
        }
    }

    #[inline]
    fn compare(
        &self,
        place: usize,
        others: std::ops::Range<usize>,
        rules: &PairRules,
        visit: &mut impl FnMut(u32, u32),
    ) {
        let (b, bounds) = (self.order[place], &self.ordered_boxes[place]);
        for other_place in others {
            if bounds.overlaps(&self.ordered_boxes[other_place]) {
                let other = self.order[other_place];
                if rules.allows(b, other) {
                    visit(b.min(other), b.max(other));
                }
            }
        }
    }

    /// Calls `visit` once for each box that `query` may touch.
    pub fn for_each_near(&self, query: &ThickSegment, mut visit: impl FnMut(u32)) {
        let bounds = query.bounds();
        let mut waiting = [0u32; MOST_WAITING];
        let mut n = usize::from(!self.nodes.is_empty());
        while n > 0 {
            n -= 1;
            let id = waiting[n];
            let node = &self.nodes[id as usize];
            if !bounds.overlaps(&node.bounds) || !query.may_touch(&node.bounds) {
                continue;
            }
            if node.is_leaf() {
                for place in node.places() {
                    if query.may_touch(&self.ordered_boxes[place]) {
                        visit(self.order[place]);
                    }
                }
            } else {
                waiting[n] = node.right;
                waiting[n + 1] = id + 1;
                n += 2;
            }
        }
    }
}
