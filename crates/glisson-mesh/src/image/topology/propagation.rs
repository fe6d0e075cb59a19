//! The cropped voxel set, its distances and pieces, and the front that flips simple voxels in order.

use std::collections::VecDeque;

use rayon::prelude::*;

use super::TopologyError;
use crate::disjoint_sets::DisjointSets;
use crate::image::VoxelGrid;
use crate::image::resample::VoxelBox;

/// Most voxels of a crop: places are kept as `u32`.
const MOST_VOXELS: usize = u32::MAX as usize / 2;
/// Length of the smallest spacing in chamfer units.
const UNITS_PER_SMALLEST_SPACING: f64 = 10.0;
/// Spacings beyond this multiple of the smallest count as this multiple, to bound the number of buckets.
const LARGEST_SPACING_RATIO: f64 = 50.0;
/// Distances from here on share one bucket.
const LAST_BUCKET: u32 = 1 << 16;

/// The mask's bounding box and one layer of background around it.
#[derive(Clone, Debug)]
pub(super) struct Crop {
    /// Dimensions with the layer.
    dims: [usize; 3],
    /// Voxel of the grid at (1, 1, 1).
    low: [usize; 3],
    /// Spacing [mm].
    spacing_mm: [f64; 3],
    /// 0 or 1, i fastest.
    pub(super) cells: Vec<u8>,
}

impl Crop {
    /// Crops a mask to its bounding box.
    pub(super) fn of_mask(grid: &VoxelGrid, mask: &[bool]) -> Result<Self, TopologyError> {
        let needed = grid.dims.iter().try_fold(1usize, |n, &d| n.checked_mul(d));
        if needed != Some(mask.len()) {
            let needed = needed.unwrap_or(usize::MAX);
            return Err(TopologyError::WrongLength { found: mask.len(), needed, dims: grid.dims });
        }
        let spacing_mm = grid.spacing_m.to_array().map(|s| 1e3 * s);
        for axis in 0..3 {
            let found_m = grid.spacing_m[axis];
            if !(found_m > 0.0 && found_m.is_finite()) {
                return Err(TopologyError::WrongSpacing { axis, found_m });
            }
        }
        let part = VoxelBox::around(grid, mask, 0.0).ok_or(TopologyError::Empty)?;
        let (low, dims) = (part.first, part.dims.map(|n| n + 2));
        let n = dims.iter().try_fold(1usize, |n, &d| n.checked_mul(d));
        let n =
            n.filter(|&n| n <= MOST_VOXELS).ok_or(TopologyError::TooLarge { dims, limit: MOST_VOXELS })?;
        let mut crop = Self { dims, low, spacing_mm, cells: vec![0; n] };
        for k in 1..dims[2] - 1 {
            for j in 1..dims[1] - 1 {
                let from = grid.index([low[0], low[1] + j - 1, low[2] + k - 1]);
                let to = crop.index([1, j, k]);
                for i in 0..dims[0] - 2 {
                    crop.cells[to + i] = u8::from(mask[from + i]);
                }
            }
        }
        Ok(crop)
    }

    /// Writes the crop over its mask and clears the rest; answers the numbers of voxels added and removed.
    pub(super) fn write_to(&self, grid: &VoxelGrid, mask: &mut [bool]) -> (usize, usize) {
        let (mut added, mut removed) = (0, 0);
        for k in 1..self.dims[2] - 1 {
            for j in 1..self.dims[1] - 1 {
                let to = grid.index([self.low[0], self.low[1] + j - 1, self.low[2] + k - 1]);
                let from = self.index([1, j, k]);
                for i in 0..self.dims[0] - 2 {
                    let after = self.cells[from + i] == 1;
                    added += usize::from(after && !mask[to + i]);
                    removed += usize::from(!after && mask[to + i]);
                    mask[to + i] = after;
                }
            }
        }
        (added, removed)
    }

    pub(super) fn index(&self, [i, j, k]: [usize; 3]) -> usize {
        i + self.dims[0] * (j + self.dims[1] * k)
    }

    /// Steps between neighbours along i, j, k.
    pub(super) fn strides(&self) -> [usize; 3] {
        [1, self.dims[0], self.dims[0] * self.dims[1]]
    }

    /// Offsets of the 26 neighbours, the 6 face neighbours first.
    fn neighbour_offsets(&self) -> [isize; 26] {
        let s = self.strides().map(|s| isize::try_from(s).expect("strides are below the voxel limit"));
        let mut offsets = [-s[2], -s[1], -s[0], s[0], s[1], s[2]].to_vec();
        for dz in -1isize..=1 {
            for dy in -1isize..=1 {
                for dx in -1isize..=1 {
                    if dx.abs() + dy.abs() + dz.abs() > 1 {
                        offsets.push(dx * s[0] + dy * s[1] + dz * s[2]);
                    }
                }
            }
        }
        offsets.try_into().expect("a voxel has 26 neighbours")
    }

    /// Dimensions without the border layer.
    pub(super) fn inner_dims(&self) -> [usize; 3] {
        self.dims.map(|d| d - 2)
    }

    /// Number of voxels set.
    pub(super) fn count(&self) -> usize {
        self.cells.iter().map(|&c| usize::from(c)).sum()
    }

    /// The same box without any voxel.
    pub(super) fn emptied(&self) -> Self {
        Self { cells: vec![0; self.cells.len()], ..*self }
    }

    /// The same box with every voxel but the border layer.
    pub(super) fn filled_box(&self) -> Self {
        let mut filled = self.emptied();
        for k in 1..self.dims[2] - 1 {
            for j in 1..self.dims[1] - 1 {
                let start = self.index([1, j, k]);
                filled.cells[start..start + self.dims[0] - 2].fill(1);
            }
        }
        filled
    }

    /// The bits of the 2 x 2 x 2 block whose smallest voxel is at `index`.
    fn block(&self, index: usize) -> u8 {
        let s = self.strides();
        (0..8).fold(0, |bits, c| {
            let at = index + (c & 1) * s[0] + ((c >> 1) & 1) * s[1] + (c >> 2) * s[2];
            bits | (self.cells[at] << c)
        })
    }

    /// How many blocks have each pattern (bit x + 2 y + 4 z).
    fn count_blocks(&self) -> [u32; 256] {
        let row = |j: usize, k: usize| &self.cells[self.index([0, j, k])..][..self.dims[0]];
        let slab = |k: usize| {
            let mut counts = [0; 256];
            for j in 0..self.dims[1] - 1 {
                let rows = [row(j, k), row(j + 1, k), row(j, k + 1), row(j + 1, k + 1)];
                // Four voxels of one i: every second bit.
                let column = |i: usize| rows[0][i] | rows[1][i] << 2 | rows[2][i] << 4 | rows[3][i] << 6;
                let mut low = column(0);
                for i in 1..self.dims[0] {
                    let high = column(i);
                    counts[usize::from(low | high << 1)] += 1;
                    low = high;
                }
            }
            counts
        };
        let sum = |a: [u32; 256], b: [u32; 256]| std::array::from_fn(|pattern| a[pattern] + b[pattern]);
        (0..self.dims[2] - 1).into_par_iter().map(slab).reduce(|| [0; 256], sum)
    }

    /// Corners - edges + faces - voxels of the closed solid.
    pub(super) fn euler_characteristic(&self) -> i64 {
        let counts = self.count_blocks();
        euler_contributions().iter().zip(counts).map(|(each, count)| each * i64::from(count)).sum()
    }

    /// Clears the voxel at `index`; answers how that changes the Euler characteristic.
    pub(super) fn clear_and_count_euler(&mut self, index: usize, contributions: &[i64; 256]) -> i64 {
        let s = self.strides();
        let around = |crop: &Self| -> i64 {
            let lows = (0..8).map(|c| index - (c & 1) * s[0] - ((c >> 1) & 1) * s[1] - (c >> 2) * s[2]);
            lows.map(|low| contributions[usize::from(crop.block(low))]).sum()
        };
        let before = around(self);
        self.cells[index] = 0;
        around(self) - before
    }

    /// Whether all blocks are well-composed.
    pub(super) fn is_well_composed(&self) -> bool {
        let counts = self.count_blocks();
        well_composed_blocks().into_iter().zip(counts).all(|(is_well, count)| is_well || count == 0)
    }

    /// Clears all pieces (26-connected) but the largest, the first of equals; answers how many.
    pub(super) fn keep_largest_piece(&mut self) -> usize {
        let pieces = Pieces::of(self, 1, true);
        let largest = (0..pieces.sizes.len()).max_by_key(|&p| (pieces.sizes[p], usize::MAX - p));
        for run in pieces.runs.iter().filter(|run| Some(run.piece as usize) != largest) {
            self.cells[run.places()].fill(0);
        }
        pieces.sizes.len().saturating_sub(1)
    }

    /// Fills background pieces (6-connected) that do not reach the border; answers how many.
    pub(super) fn fill_cavities(&mut self) -> usize {
        let pieces = Pieces::of(self, 0, false);
        // The border layer comes first in scanning order, so piece 0 is the outside.
        for run in pieces.runs.iter().filter(|run| run.piece > 0) {
            self.cells[run.places()].fill(1);
        }
        pieces.sizes.len().saturating_sub(1)
    }

    /// The voxels from `low` to `high`, both included, as a crop whose border layer holds what stands there.
    pub(super) fn part(&self, [low, high]: [[usize; 3]; 2]) -> Self {
        let dims = [0, 1, 2].map(|a| high[a] + 1 - low[a]);
        let corner = [0, 1, 2].map(|a| self.low[a] + low[a]);
        let mut part = Self { dims, low: corner, spacing_mm: self.spacing_mm, cells: Vec::new() };
        part.cells.reserve(dims.iter().product());
        for k in low[2]..=high[2] {
            for j in low[1]..=high[1] {
                let start = self.index([low[0], j, k]);
                part.cells.extend_from_slice(&self.cells[start..start + dims[0]]);
            }
        }
        part
    }

    /// Writes back a [`Crop::part`] whose first voxel is `low`.
    pub(super) fn set_part(&mut self, low: [usize; 3], part: &Self) {
        for (row, cells) in part.cells.chunks_exact(part.dims[0]).enumerate() {
            let [j, k] = [row % part.dims[1], row / part.dims[1]];
            let start = self.index([low[0], low[1] + j, low[2] + k]);
            self.cells[start..start + cells.len()].copy_from_slice(cells);
        }
    }

    /// First and last voxel of the box around `places`, grown by `units` of chamfer length and a layer, within
    /// the crop.
    pub(super) fn box_around(&self, places: impl Iterator<Item = usize>, units: u32) -> [[usize; 3]; 2] {
        let (mut low, mut high) = (self.dims, [0; 3]);
        for place in places {
            let (row, i) = (place / self.dims[0], place % self.dims[0]);
            for (axis, at) in [i, row % self.dims[1], row / self.dims[1]].into_iter().enumerate() {
                low[axis] = low[axis].min(at);
                high[axis] = high[axis].max(at);
            }
        }
        let margin = self.steps().map(|step| (f64::from(units) / step).ceil() as usize + 2);
        let low = [0, 1, 2].map(|a| low[a].saturating_sub(margin[a]));
        [low, [0, 1, 2].map(|a| (high[a] + margin[a]).min(self.dims[a] - 1))]
    }

    /// Weights of steps along i, j, k in chamfer units.
    fn steps(&self) -> [f64; 3] {
        let smallest = self.spacing_mm.into_iter().fold(f64::INFINITY, f64::min);
        self.spacing_mm.map(|s| UNITS_PER_SMALLEST_SPACING * (s / smallest).min(LARGEST_SPACING_RATIO))
    }

    /// A length in chamfer units.
    pub(super) fn chamfer_units(&self, length_mm: f64) -> u32 {
        let smallest = self.spacing_mm.into_iter().fold(f64::INFINITY, f64::min);
        (UNITS_PER_SMALLEST_SPACING * length_mm / smallest).min(1e9) as u32
    }

    /// Morphological closing by a ball: what a ball of that radius outside the set cannot reach. Within
    /// the box only, whose border counts as reachable.
    pub(super) fn closing(&self, radius_mm: f64) -> Self {
        let radius = self.chamfer_units(radius_mm);
        let to_set = chamfer_distances(self, |cell| cell == 1);
        let mut dilated = self.filled_box();
        for (cell, &distance) in dilated.cells.iter_mut().zip(&to_set) {
            *cell &= u8::from(distance <= radius);
        }
        let to_complement = chamfer_distances(&dilated, |cell| cell == 0);
        let mut closed = self.clone();
        for (cell, &distance) in closed.cells.iter_mut().zip(&to_complement) {
            *cell |= u8::from(distance > radius);
        }
        closed
    }
}

/// Neighbouring cells of one row.
#[derive(Clone, Copy, Debug)]
pub(super) struct Run {
    start: u32,
    end: u32,
    /// The piece it belongs to, in scanning order from 0.
    pub(super) piece: u32,
}

impl Run {
    /// Its places in the crop.
    pub(super) fn places(&self) -> std::ops::Range<usize> {
        self.start as usize..self.end as usize
    }
}

/// The connected pieces of a crop's cells of one value.
#[derive(Debug)]
pub(super) struct Pieces {
    /// All cells of that value, in scanning order.
    pub(super) runs: Vec<Run>,
    /// Cells of each piece.
    pub(super) sizes: Vec<usize>,
}

impl Pieces {
    /// The pieces of cells equal to `of`, which join by faces, or also by edges and corners.
    pub(super) fn of(crop: &Crop, of: u8, by_corners: bool) -> Self {
        let [n_i, n_j, n_k] = crop.dims;
        let mut runs: Vec<Run> = Vec::new();
        // Runs of row r: first_run[r] to first_run[r + 1].
        let mut first_run = Vec::with_capacity(n_j * n_k + 1);
        for (row, cells) in crop.cells.chunks_exact(n_i).enumerate() {
            first_run.push(runs.len());
            let mut at = 0;
            while let Some(from) = cells[at..].iter().position(|&c| c == of) {
                let start = at + from;
                at = cells[start..].iter().position(|&c| c != of).map_or(n_i, |n| start + n);
                let place =
                    |i: usize| u32::try_from(row * n_i + i).expect("places are below the voxel limit");
                runs.push(Run { start: place(start), end: place(at), piece: 0 });
            }
        }
        first_run.push(runs.len());
        let mut sets = DisjointSets::new(runs.len());
        let reach = u32::from(by_corners);
        for (row, (j, k)) in (0..n_k).flat_map(|k| (0..n_j).map(move |j| (j, k))).enumerate() {
            let mut join = |earlier: usize| {
                // Both rows from left to right, in step; places are compared in this row's numbers.
                let shift = ((row - earlier) * n_i) as u32;
                let (mut a, mut b) = (first_run[earlier], first_run[row]);
                while a < first_run[earlier + 1] && b < first_run[row + 1] {
                    let (above, own) = (runs[a], runs[b]);
                    if above.start + shift < own.end + reach && own.start < above.end + shift + reach {
                        sets.join(a, b);
                    }
                    if above.end + shift < own.end {
                        a += 1;
                    } else {
                        b += 1;
                    }
                }
            };
            if j > 0 {
                join(row - 1);
            }
            if k > 0 {
                join(row - n_j);
                if by_corners && j > 0 {
                    join(row - n_j - 1);
                }
                if by_corners && j + 1 < n_j {
                    join(row - n_j + 1);
                }
            }
        }
        let mut sizes: Vec<usize> = Vec::new();
        for at in 0..runs.len() {
            let root = sets.root(at);
            // Roots are the smallest member, so a root is numbered before its members.
            if root == at {
                runs[at].piece = u32::try_from(sizes.len()).expect("fewer pieces than voxels");
                sizes.push(0);
            }
            runs[at].piece = runs[root].piece;
            sizes[runs[at].piece as usize] += runs[at].places().len();
        }
        Self { runs, sizes }
    }
}

/// Distance of each cell to the nearest cell that `is_target` (0 there), in chamfer units: paths over the 26
/// neighbours, each step as long as it is in space (G. Borgefors, "Distance transformations in digital
/// images", 1986, doi 10.1016/S0734-189X(86)80047-0).
pub(super) fn chamfer_distances(crop: &Crop, is_target: impl Fn(u8) -> bool) -> Vec<u32> {
    const FAR: u32 = u32::MAX / 2;
    let steps = crop.steps();
    let strides = crop.strides();
    // Neighbours that come before a voxel in scanning order: di, dj, dk and the length.
    let mut before = Vec::new();
    for dk in -1i32..=0 {
        for dj in -1i32..=1 {
            for di in -1i32..=1 {
                if (dk, dj, di) < (0, 0, 0) {
                    let length = [di, dj, dk].into_iter().zip(steps).map(|(d, s)| f64::from(d * d) * s * s);
                    let offset = i64::from(di) * strides[0] as i64
                        + i64::from(dj) * strides[1] as i64
                        + i64::from(dk) * strides[2] as i64;
                    let back = usize::try_from(-offset).expect("earlier in scanning order");
                    before.push((back, length.sum::<f64>().sqrt().round() as u32));
                }
            }
        }
    }
    let mut distance: Vec<u32> = crop.cells.iter().map(|&c| if is_target(c) { 0 } else { FAR }).collect();
    // The border layer keeps what it has: it is background, never measured.
    for k in 1..crop.dims[2] - 1 {
        for j in 1..crop.dims[1] - 1 {
            for i in 1..crop.dims[0] - 1 {
                let at = crop.index([i, j, k]);
                let best = before.iter().map(|&(back, length)| distance[at - back] + length).min();
                distance[at] = distance[at].min(best.unwrap_or(FAR)).min(FAR);
            }
        }
    }
    for k in (1..crop.dims[2] - 1).rev() {
        for j in (1..crop.dims[1] - 1).rev() {
            for i in (1..crop.dims[0] - 1).rev() {
                let at = crop.index([i, j, k]);
                let best = before.iter().map(|&(back, length)| distance[at + back] + length).min();
                distance[at] = distance[at].min(best.unwrap_or(FAR)).min(FAR);
            }
        }
    }
    distance
}

/// What [`propagate`] does to the set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Direction {
    /// Adds candidates.
    Grow,
    /// Takes candidates away.
    Shrink,
}

/// Flips the voxels of `set` that are `candidates` (1), those of highest `priority` first, each only while it
/// is simple and leaves its eight blocks well-composed, until none is left. `set` must be well-composed; its
/// pieces, cavities and tunnels stay as they are.
pub(super) fn propagate(set: &mut Crop, candidates: &[u8], priority: &[u32], direction: Direction) {
    let after = match direction {
        Direction::Grow => 1,
        Direction::Shrink => 0,
    };
    let offsets = set.neighbour_offsets();
    let strides = set.strides();
    let table = well_composed_blocks();
    let mut queue = BucketQueue::new(priority);
    // One byte a voxel, so that a look at a neighbour is one access.
    let mut state: Vec<u8> = set
        .cells
        .iter()
        .zip(candidates)
        .map(|(&cell, &candidate)| if candidate == 1 && cell != after { cell | OPEN } else { cell })
        .collect();
    for k in 1..set.dims[2] - 1 {
        for j in 1..set.dims[1] - 1 {
            let start = set.index([1, j, k]);
            for index in start..start + set.dims[0] - 2 {
                let on_front =
                    || offsets[..6].iter().any(|&o| state[index.wrapping_add_signed(o)] & SET == after);
                if state[index] & OPEN != 0 && on_front() {
                    state[index] |= WAITING;
                    queue.push(index);
                }
            }
        }
    }
    while let Some(index) = queue.pop() {
        state[index] &= !WAITING;
        let around = neighbourhood(&state, index, strides);
        if !can_flip(around, after, &table) {
            state[index] |= REFUSED;
            continue;
        }
        state[index] = after;
        set.cells[index] = after;
        for (n, &offset) in offsets.iter().enumerate() {
            let next = index.wrapping_add_signed(offset);
            let found = state[next];
            let is_due = found & (OPEN | WAITING) == OPEN && (n < 6 || found & REFUSED != 0);
            if is_due {
                state[next] = found & !REFUSED | WAITING;
                queue.push(next);
            }
        }
    }
}

/// What [`propagate`] knows of a voxel: its cell,
const SET: u8 = 1;
/// that it is a candidate not yet flipped,
const OPEN: u8 = 2;
/// that it is in the queue,
const WAITING: u8 = 4;
/// that it was tested and refused, to be tried again when a neighbour changes.
const REFUSED: u8 = 8;

/// Places ordered by priority, highest first, equals first in first out.
struct BucketQueue<'a> {
    priority: &'a [u32],
    buckets: Vec<VecDeque<u32>>,
    /// No bucket above this one holds anything.
    top: usize,
}

impl<'a> BucketQueue<'a> {
    fn new(priority: &'a [u32]) -> Self {
        let highest = priority.iter().copied().filter(|&p| p < LAST_BUCKET).max().unwrap_or(0);
        Self { priority, buckets: vec![VecDeque::new(); highest as usize + 2], top: 0 }
    }

    fn push(&mut self, index: usize) {
        let bucket = (self.priority[index] as usize).min(self.buckets.len() - 1);
        self.buckets[bucket].push_back(u32::try_from(index).expect("places are below the voxel limit"));
        self.top = self.top.max(bucket);
    }

    fn pop(&mut self) -> Option<usize> {
        loop {
            if let Some(index) = self.buckets[self.top].pop_front() {
                return Some(index as usize);
            }
            self.top = self.top.checked_sub(1)?;
        }
    }
}

/// Bits of a 3 x 3 x 3 neighbourhood: bit x + 3 y + 9 z; the voxel itself is bit 13.
const ALL: u32 = (1 << 27) - 1;
const CENTRE: u32 = 1 << 13;
const FACES: u32 = 1 << 4 | 1 << 10 | 1 << 12 | 1 << 14 | 1 << 16 | 1 << 22;
const CORNERS: u32 = 1 << 0 | 1 << 2 | 1 << 6 | 1 << 8 | 1 << 18 | 1 << 20 | 1 << 24 | 1 << 26;
/// x = 0 and x = 2 columns, y = 0 and y = 2 rows.
const X0: u32 = 0o111_111_111;
const X2: u32 = X0 << 2;
const Y0: u32 = 0o007_007_007;
const Y2: u32 = Y0 << 6;

/// The voxels around `index` that are [`SET`], without itself.
fn neighbourhood(state: &[u8], index: usize, strides: [usize; 3]) -> u32 {
    let mut bits = 0;
    let mut shift = 0;
    let low = index - strides[0] - strides[1] - strides[2];
    for k in 0..3 {
        for j in 0..3 {
            let row = &state[low + j * strides[1] + k * strides[2]..][..3];
            let [a, b, c] = [row[0], row[1], row[2]].map(|cell| u32::from(cell & SET));
            bits |= (a | b << 1 | c << 2) << shift;
            shift += 3;
        }
    }
    bits & !CENTRE
}

fn can_flip(around: u32, after: u8, table: &[bool; 256]) -> bool {
    if around & FACES == 0 || around & FACES == FACES {
        return false;
    }
    let flipped = if after == 1 { around | CENTRE } else { around };
    let blocks = [0, 1, 3, 4, 9, 10, 12, 13];
    blocks.into_iter().all(|low| {
        let b = flipped >> low;
        let bits = b & 3 | (b >> 3 & 3) << 2 | (b >> 9 & 3) << 4 | (b >> 12 & 3) << 6;
        table[bits as usize]
    }) && is_simple(around)
}

/// Bertrand's and Malandain's test for a six-connected set and a 26-connected background.
fn is_simple(around: u32) -> bool {
    let set = around & !CORNERS;
    let faces = around & FACES;
    let mut reached = faces & faces.wrapping_neg();
    loop {
        let x = (reached & !X2) << 1 | (reached & !X0) >> 1;
        let y = (reached & !Y2) << 3 | (reached & !Y0) >> 3;
        let next = (reached | x | y | reached << 9 | reached >> 9) & set;
        if next == reached {
            break;
        }
        reached = next;
    }
    if reached == 0 || faces & !reached != 0 {
        return false;
    }
    let background = !around & ALL & !CENTRE;
    let mut reached = background & background.wrapping_neg();
    loop {
        let x = reached | (reached & !X2) << 1 | (reached & !X0) >> 1;
        let y = x | (x & !Y2) << 3 | (x & !Y0) >> 3;
        let next = (y | y << 9 | y >> 9) & background;
        if next == reached {
            break;
        }
        reached = next;
    }
    reached != 0 && reached == background
}

/// For each pattern of a 2 x 2 x 2 block (bit x + 2 y + 4 z): whether its voxels, and its empty places, are
/// each joined by faces.
pub(crate) fn well_composed_blocks() -> [bool; 256] {
    let joined = |bits: u8| {
        let mut reached = bits & bits.wrapping_neg();
        loop {
            let mut next = reached;
            for c in 0..8u8 {
                if reached >> c & 1 == 1 {
                    next |= 1 << (c ^ 1) | 1 << (c ^ 2) | 1 << (c ^ 4);
                }
            }
            next &= bits;
            if next == reached {
                return reached == bits;
            }
            reached = next;
        }
    };
    std::array::from_fn(|bits| joined(bits as u8) && joined(!(bits as u8)))
}

/// What each pattern of a block adds to the Euler characteristic: a block owns its middle corner and the
/// three edges, the three faces and the voxel on its upper side.
pub(super) fn euler_contributions() -> [i64; 256] {
    std::array::from_fn(|bits| {
        let any = |cells: u8| i64::from(bits as u8 & cells != 0);
        any(0b1111_1111) - any(0b1010_1010) - any(0b1100_1100) - any(0b1111_0000)
            + any(0b1000_1000)
            + any(0b1010_0000)
            + any(0b1100_0000)
            - any(0b1000_0000)
    })
}
