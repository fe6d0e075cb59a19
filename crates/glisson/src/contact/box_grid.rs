//! Buckets over boxes of similar size, sorted anew in every step.
//!
//! After the buckets of Cotin, Delingette and Ayache 1998 (RR-3511, s. 5), with boxes in place of nodes. A box is
//! filed under the bucket of its centre, and a bucket is at least as wide as the widest box: boxes that overlap
//! are in the same bucket or in adjacent ones. A few boxes that are far wider than the others are kept in a list of
//! their own, so that they do not widen the buckets, and are compared with everything.

use super::boxes::{PairRules, RoundedBox, ThickSegment};
use crate::math::fused;
use glam::Vec3;

/// A box wider than this many times the mean counts as large.
const LARGE: f32 = 4.0;

/// Buckets for each box at most: bounds memory and the time to clear them.
const BUCKETS_A_BOX: usize = 4;

/// A bucket is wider than the widest box by this share of it and of the largest coordinate: far above the rounding
/// of a bucket's index.
const SLACK: f32 = 0.01;
const SLACK_OF_COORDINATE: f32 = 1e-6;

/// Boxes sorted into equal cubes by their centres. Updating and asking never allocate.
#[derive(Clone, Debug)]
pub struct BoxGrid {
    low_m: Vec3,
    bucket_m: f32,
    dims: [usize; 3],
    /// Where each bucket's boxes start in `sorted`; one more than there are buckets.
    starts: Vec<u32>,
    sorted: Vec<u32>,
    sorted_boxes: Vec<RoundedBox>,
    bucket_of: Vec<u32>,
    /// Boxes that are compared with everything, ascending.
    large: Vec<u32>,
}

/// Marks a box that is in no bucket.
const NO_BUCKET: u32 = u32::MAX;

impl BoxGrid {
    /// A grid over `boxes`.
    pub fn new(boxes: &[RoundedBox]) -> Self {
        let n = boxes.len();
        let mut grid = Self {
            low_m: Vec3::ZERO,
            bucket_m: 1.0,
            dims: [1; 3],
            starts: vec![0; BUCKETS_A_BOX * n + 65],
            sorted: Vec::with_capacity(n),
            sorted_boxes: Vec::with_capacity(n),
            bucket_of: vec![0; n],
            large: Vec::with_capacity(n),
        };
        grid.update(boxes);
        grid
    }

    /// Sorts the boxes anew; as many as at the start.
    pub fn update(&mut self, boxes: &[RoundedBox]) {
        self.choose_buckets(boxes);
        let [nx, ny, nz] = self.dims;
        let n_buckets = nx * ny * nz;
        self.starts[..=n_buckets].fill(0);
        let scale = 1.0 / self.bucket_m;
        let last = Vec3::new((nx - 1) as f32, (ny - 1) as f32, (nz - 1) as f32);
        for (b, bounds) in boxes.iter().enumerate() {
            if self.bucket_of[b] == NO_BUCKET {
                continue;
            }
            let cell = ((bounds.center_m() - self.low_m) * scale).clamp(Vec3::ZERO, last);
            let bucket = cell.x as usize + nx * (cell.y as usize + ny * cell.z as usize);
            self.bucket_of[b] = bucket as u32;
            self.starts[bucket + 1] += 1;
        }
        for b in 1..=n_buckets {
            self.starts[b] += self.starts[b - 1];
        }
        let n_sorted = self.starts[n_buckets] as usize;
        self.sorted.resize(n_sorted, 0);
        self.sorted_boxes.resize(n_sorted, RoundedBox::NOTHING);
        // Filled from the back, so that boxes ascend within a bucket.
        for b in (0..boxes.len()).rev() {
            let bucket = self.bucket_of[b];
            if bucket == NO_BUCKET {
                continue;
            }
            let end = &mut self.starts[bucket as usize + 1];
            *end -= 1;
            self.sorted[*end as usize] = b as u32;
            self.sorted_boxes[*end as usize] = boxes[b];
        }
        // Each entry now holds the start of the bucket before it: shift back by one.
        self.starts.copy_within(1..=n_buckets, 0);
        self.starts[n_buckets] = n_sorted as u32;
    }

    /// Sets the buckets' place and size, and sorts out large and broken boxes.
    fn choose_buckets(&mut self, boxes: &[RoundedBox]) {
        let (mut total, mut n_fine) = (0.0_f32, 0_u32);
        let (mut widest, mut low, mut high) = (0.0_f32, Vec3::INFINITY, Vec3::NEG_INFINITY);
        self.large.clear();
        for (bounds, bucket) in boxes.iter().zip(&mut self.bucket_of) {
            *bucket = NO_BUCKET;
            if !bounds.is_nothing() {
                let width = bounds.size_m().max_element();
                (total, n_fine) = (total + width, n_fine + 1);
                widest = widest.max(width);
                low = low.min(bounds.center_m());
                high = high.max(bounds.center_m());
                *bucket = 0;
            }
        }
        let largest = LARGE * total / n_fine.max(1) as f32;
        if widest > largest {
            (widest, low, high) = (0.0, Vec3::INFINITY, Vec3::NEG_INFINITY);
            for (b, bounds) in boxes.iter().enumerate() {
                let width = bounds.size_m().max_element();
                if bounds.is_nothing() {
                    continue;
                }
                if width > largest {
                    self.large.push(b as u32);
                    self.bucket_of[b] = NO_BUCKET;
                    continue;
                }
                widest = widest.max(width);
                low = low.min(bounds.center_m());
                high = high.max(bounds.center_m());
            }
        }
        if low.x > high.x {
            (low, high) = (Vec3::ZERO, Vec3::ZERO);
        }
        self.low_m = low;
        let size = high - low;
        let coordinate = low.abs().max(high.abs()).max_element();
        let slack_m = SLACK * widest + SLACK_OF_COORDINATE * coordinate;
        self.bucket_m = (widest + slack_m).max(size.max_element() * 1e-3).max(f32::MIN_POSITIVE);
        loop {
            self.dims = (size / self.bucket_m).to_array().map(|d| d as usize + 1);
            if self.dims.iter().product::<usize>() < self.starts.len() {
                break;
            }
            self.bucket_m *= 1.25;
        }
    }

    /// The boxes of buckets `first` to `last` of one row, as a range of `sorted`.
    fn row(&self, first: usize, last: usize, j: usize, k: usize) -> std::ops::Range<usize> {
        let start = self.dims[0] * (j + self.dims[1] * k);
        self.starts[start + first] as usize..self.starts[start + last + 1] as usize
    }

    /// Calls `visit` once for each pair of overlapping boxes that `rules` allow, the lower index first.
    pub fn for_each_pair(&self, boxes: &[RoundedBox], rules: &PairRules, mut visit: impl FnMut(u32, u32)) {
        let visit = &mut visit;
        let [nx, ny, nz] = self.dims;
        for k in 0..nz {
            for j in 0..ny {
                for i in 0..nx {
                    let own = self.row(i, i, j, k);
                    if own.is_empty() {
                        continue;
                    }
                    let (before, after) = (i.saturating_sub(1), (i + 1).min(nx - 1));
                    // Half of the adjacent buckets: the other half finds the pair from its side.
                    let mut rows = [0..0, 0..0, 0..0, 0..0];
                    if j + 1 < ny {
                        rows[0] = self.row(before, after, j + 1, k);
                    }
                    if k + 1 < nz {
                        for (row, side) in rows[1..].iter_mut().zip([-1_isize, 0, 1]) {
                            if let Some(side) = j.checked_add_signed(side).filter(|&side| side < ny) {
                                *row = self.row(before, after, side, k + 1);
                            }
                        }
                    }
                    let end = self.row(i, after, j, k).end;
                    for place in own {
                        let found = (self.sorted[place], &self.sorted_boxes[place]);
                        self.compare(found, place + 1..end, rules, visit);
                        for row in &rows {
                            self.compare(found, row.clone(), rules, visit);
                        }
                    }
                }
            }
        }
        for (n, &l) in self.large.iter().enumerate() {
            let bounds = &boxes[l as usize];
            self.compare((l, bounds), 0..self.sorted.len(), rules, visit);
            for &m in &self.large[n + 1..] {
                if bounds.overlaps(&boxes[m as usize]) && rules.allows(l, m) {
                    visit(l, m);
                }
            }
        }
    }

    #[inline]
    fn compare(
        &self,
        (b, bounds): (u32, &RoundedBox),
        places: std::ops::Range<usize>,
        rules: &PairRules,
        visit: &mut impl FnMut(u32, u32),
    ) {
        let others = self.sorted_boxes[places.clone()].iter().zip(&self.sorted[places]);
        for (other_bounds, &other) in others {
            if bounds.overlaps(other_bounds) && rules.allows(b, other) {
                visit(b.min(other), b.max(other));
            }
        }
    }

    /// Calls `visit` once for each box that `query` may touch.
    pub fn for_each_near(&self, boxes: &[RoundedBox], query: &ThickSegment, mut visit: impl FnMut(u32)) {
        let half_m = 0.5 * f64::from(self.bucket_m);
        let reach_m = query.radius_m + half_m;
        let slab = |piece: [f64; 2], axis: usize| {
            let ends = piece.map(|t| fused(query.from_m[axis], 1.0 - t, query.to_m[axis] * t));
            let place = |x: f64| (x - f64::from(self.low_m[axis])) / f64::from(self.bucket_m);
            let low = place(ends[0].min(ends[1]) - reach_m).floor().max(0.0);
            let high = place(ends[0].max(ends[1]) + reach_m).floor();
            // A cast of NaN or of a negative number gives 0, and an empty range then.
            if high >= low { low as usize..(high as usize).saturating_add(1) } else { 0..0 }
        };
        // The piece of `piece` whose distance from slab `index` is small enough.
        let clip = |piece: [f64; 2], axis: usize, index: usize| {
            let (from, move_m) = (query.from_m[axis], query.to_m[axis] - query.from_m[axis]);
            let low = f64::from(self.low_m[axis]) + f64::from(self.bucket_m) * index as f64 - reach_m;
            let high = low + f64::from(self.bucket_m) + 2.0 * reach_m;
            if move_m.abs() < half_m {
                return piece;
            }
            let (a, b) = ((low - from) / move_m, (high - from) / move_m);
            [piece[0].max(a.min(b)), piece[1].min(a.max(b))]
        };
        let [nx, ny, nz] = self.dims;
        for k in slab([0.0, 1.0], 2).start..slab([0.0, 1.0], 2).end.min(nz) {
            let in_layer = clip([0.0, 1.0], 2, k);
            if in_layer[0] > in_layer[1] {
                continue;
            }
            let rows = slab(in_layer, 1);
            for j in rows.start..rows.end.min(ny) {
                let in_row = clip(in_layer, 1, j);
                let cells = slab(in_row, 0);
                let end = cells.end.min(nx);
                if in_row[0] > in_row[1] || cells.start >= end {
                    continue;
                }
                for place in self.row(cells.start, end - 1, j, k) {
                    if query.may_touch(&self.sorted_boxes[place]) {
                        visit(self.sorted[place]);
                    }
                }
            }
        }
        for &l in &self.large {
            if query.may_touch(&boxes[l as usize]) {
                visit(l);
            }
        }
    }
}
