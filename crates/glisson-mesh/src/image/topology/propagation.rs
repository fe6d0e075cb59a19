//! The cropped voxel set, its distances and pieces, and the front that flips simple voxels in order.

use std::collections::VecDeque;

use super::TopologyError;
use crate::image::VoxelGrid;

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
        let (mut low, mut high) = ([usize::MAX; 3], [0; 3]);
        for k in 0..grid.dims[2] {
            for j in 0..grid.dims[1] {
                let start = grid.index([0, j, k]);
                let row = &mask[start..start + grid.dims[0]];
                let Some(first) = row.iter().position(|&m| m) else { continue };
                let last = row.iter().rposition(|&m| m).expect("a row with a first voxel has a last");
                for (axis, (a, b)) in [(first, last), (j, j), (k, k)].into_iter().enumerate() {
                    low[axis] = low[axis].min(a);
                    high[axis] = high[axis].max(b);
                }
            }
        }
        if low[0] == usize::MAX {
            return Err(TopologyError::Empty);
        }
        let dims = [0, 1, 2].map(|a| high[a] - low[a] + 3);
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

    fn index(&self, [i, j, k]: [usize; 3]) -> usize {
        i + self.dims[0] * (j + self.dims[1] * k)
    }

    fn strides(&self) -> [usize; 3] {
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

    fn for_each_block(&self, mut see: impl FnMut(u8)) {
        for k in 0..self.dims[2] - 1 {
            for j in 0..self.dims[1] - 1 {
                for i in 0..self.dims[0] - 1 {
                    see(self.block(self.index([i, j, k])));
                }
            }
        }
    }

    /// Corners - edges + faces - voxels of the closed solid.
    pub(super) fn euler_characteristic(&self) -> i64 {
        let contribution = euler_contributions();
        let mut sum = 0;
        self.for_each_block(|bits| sum += contribution[usize::from(bits)]);
        sum
    }

    /// Clears the voxel at `index`; answers how that changes the Euler characteristic.
    pub(super) fn clear_and_count_euler(&mut self, index: usize) -> i64 {
        let contribution = euler_contributions();
        let s = self.strides();
        let around = |crop: &Self| -> i64 {
            let lows = (0..8).map(|c| index - (c & 1) * s[0] - ((c >> 1) & 1) * s[1] - (c >> 2) * s[2]);
            lows.map(|low| contribution[usize::from(crop.block(low))]).sum()
        };
        let before = around(self);
        self.cells[index] = 0;
        around(self) - before
    }

    /// Whether all blocks are well-composed.
    pub(super) fn is_well_composed(&self) -> bool {
        let table = well_composed_blocks();
        let mut all = true;
        self.for_each_block(|bits| all &= table[usize::from(bits)]);
        all
    }

    /// Clears all pieces (26-connected) but the largest, the first of equals; answers how many.
    pub(super) fn keep_largest_piece(&mut self) -> usize {
        let (labels, sizes) = components(self, 1, true);
        let largest = (0..sizes.len()).max_by_key(|&p| (sizes[p], usize::MAX - p));
        if let Some(largest) = largest.filter(|_| sizes.len() > 1) {
            for (cell, &label) in self.cells.iter_mut().zip(&labels) {
                *cell = u8::from(label as usize == largest + 1);
            }
        }
        sizes.len().saturating_sub(1)
    }

    /// Fills background pieces (6-connected) that do not reach the border; answers how many.
    pub(super) fn fill_cavities(&mut self) -> usize {
        let (labels, sizes) = components(self, 0, false);
        // The border layer comes first in scanning order, so label 1 is the outside.
        for (cell, &label) in self.cells.iter_mut().zip(&labels) {
            if label > 1 {
                *cell = 1;
            }
        }
        sizes.len().saturating_sub(1)
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

/// Labels (1, 2, ... in scanning order; 0 elsewhere) of the pieces of cells equal to `of`, and their sizes.
/// Pieces join by faces, or also by edges and corners.
pub(super) fn components(crop: &Crop, of: u8, by_corners: bool) -> (Vec<u32>, Vec<usize>) {
    let all = crop.neighbour_offsets();
    let offsets = if by_corners { &all[..] } else { &all[..6] };
    let mut labels = vec![0u32; crop.cells.len()];
    let mut sizes = Vec::new();
    let mut stack = Vec::new();
    for start in 0..crop.cells.len() {
        if crop.cells[start] != of || labels[start] != 0 {
            continue;
        }
        let label = u32::try_from(sizes.len() + 1).expect("fewer pieces than voxels");
        labels[start] = label;
        stack.push(start);
        let mut size = 0;
        while let Some(index) = stack.pop() {
            size += 1;
            for &offset in offsets {
                // The border layer has neighbours outside the array, or wrapped onto its other side, which
                // is border too: wrapping joins only background that is joined anyway.
                let Some(next) = index.checked_add_signed(offset).filter(|&n| n < labels.len()) else {
                    continue;
                };
                if crop.cells[next] == of && labels[next] == 0 {
                    labels[next] = label;
                    stack.push(next);
                }
            }
        }
        sizes.push(size);
    }
    (labels, sizes)
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
    let open = |set: &Crop, index: usize| candidates[index] == 1 && set.cells[index] != after;
    let mut queue = BucketQueue::new(priority);
    // 1: in the queue; 2: tested and refused, tried again when a neighbour changes.
    let mut state = vec![0u8; set.cells.len()];
    for k in 1..set.dims[2] - 1 {
        for j in 1..set.dims[1] - 1 {
            for i in 1..set.dims[0] - 1 {
                let index = set.index([i, j, k]);
                let on_front =
                    || offsets[..6].iter().any(|&o| set.cells[index.wrapping_add_signed(o)] == after);
                if open(set, index) && on_front() {
                    state[index] = 1;
                    queue.push(index);
                }
            }
        }
    }
    while let Some(index) = queue.pop() {
        let around = neighbourhood(&set.cells, index, strides);
        if !can_flip(around, after, &table) {
            state[index] = 2;
            continue;
        }
        set.cells[index] = after;
        for (n, &offset) in offsets.iter().enumerate() {
            let next = index.wrapping_add_signed(offset);
            if open(set, next) && (state[next] == 2 || (n < 6 && state[next] == 0)) {
                state[next] = 1;
                queue.push(next);
            }
        }
    }
}

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

/// The voxels around `index`, without itself.
fn neighbourhood(cells: &[u8], index: usize, strides: [usize; 3]) -> u32 {
    let mut bits = 0;
    let mut shift = 0;
    let low = index - strides[0] - strides[1] - strides[2];
    for k in 0..3 {
        for j in 0..3 {
            let row = &cells[low + j * strides[1] + k * strides[2]..][..3];
            bits |= (u32::from(row[0]) | u32::from(row[1]) << 1 | u32::from(row[2]) << 2) << shift;
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
fn euler_contributions() -> [i64; 256] {
    std::array::from_fn(|bits| {
        let any = |cells: u8| i64::from(bits as u8 & cells != 0);
        any(0b1111_1111) - any(0b1010_1010) - any(0b1100_1100) - any(0b1111_0000)
            + any(0b1000_1000)
            + any(0b1010_0000)
            + any(0b1100_0000)
            - any(0b1000_0000)
    })
}
