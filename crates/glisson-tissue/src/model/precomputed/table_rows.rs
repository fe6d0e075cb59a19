//! Changes of a compliance table after cuts: rows and loaded nodes are added and removed, low-rank updates are added.
//!
//! The layout stays that of `table`; a table that grows has spare rows, which are zero.

use fearless_simd::{Level, dispatch};

use super::table::{BLOCK_NUMBERS, LANES, Numbers, Table, place};
use glisson_mesh::math::DMat3;

/// Columns of a change that are added in one pass over the table: those of one tetrahedron.
pub(super) const RANK: usize = 6;

/// Displacements of a block of rows.
const BLOCK_ROWS: usize = 3 * LANES;

/// Blocks of rows in a tile; its columns stay in the first-level cache while all loaded nodes are updated.
const TILE_BLOCKS: usize = 16;

/// A stored number.
trait Number: Copy {
    fn wide(self) -> f64;
    fn narrow(x: f64) -> Self;
}

impl Number for f64 {
    #[inline(always)]
    fn wide(self) -> f64 {
        self
    }
    #[inline(always)]
    fn narrow(x: f64) -> Self {
        x
    }
}

impl Number for f32 {
    #[inline(always)]
    fn wide(self) -> f64 {
        f64::from(self)
    }
    #[inline(always)]
    fn narrow(x: f64) -> Self {
        x as f32
    }
}

macro_rules! with_numbers {
    ($numbers:expr, $name:ident => $body:expr) => {
        match $numbers {
            Numbers::F64($name) => $body,
            Numbers::F32($name) => $body,
        }
    };
}

/// Columns over the rows of a table, in its blocks, with their factors for each loaded node.
pub(super) struct LowRankChange {
    /// [`RANK`] times the displacements of a block, block after block.
    pub(super) blocks: Vec<f64>,
    /// For each loaded node: factor of each column and force axis.
    pub(super) factors: Vec<[[f64; 3]; RANK]>,
}

impl LowRankChange {
    /// The blocks of up to [`RANK`] columns over `n_rows` rows; each column is given by its value at (row, axis).
    pub(super) fn blocks_of(n_rows: usize, columns: &[impl Fn(usize, usize) -> f64]) -> Vec<f64> {
        let n_blocks = n_rows.div_ceil(LANES);
        let mut blocks = vec![0.0; RANK * BLOCK_ROWS * n_blocks];
        for (r, column) in columns.iter().enumerate() {
            for row in 0..n_rows {
                let block = RANK * BLOCK_ROWS * (row / LANES) + BLOCK_ROWS * r;
                for axis in 0..3 {
                    blocks[block + axis * LANES + row % LANES] = column(row, axis);
                }
            }
        }
        blocks
    }
}

impl Table {
    /// Number of rows for which there is room.
    pub(super) fn room(&self) -> usize {
        self.n_rows.div_ceil(LANES) * LANES
    }

    /// The same table with room for so many rows and loaded nodes.
    pub(super) fn with_room(&self, n_rows: usize, n_loaded: usize) -> Self {
        let (old, new) = (Self::stride(self.n_rows), Self::stride(n_rows));
        fn copy<T: Number>(numbers: &[T], old: usize, new: usize, n_loaded: usize) -> Vec<T> {
            let mut copy = Vec::with_capacity(new * n_loaded);
            for node in numbers.chunks_exact(old) {
                copy.extend_from_slice(node);
                copy.resize(copy.len() + new - old, T::narrow(0.0));
            }
            copy
        }
        let numbers = match &self.numbers {
            Numbers::F64(numbers) => Numbers::F64(copy(numbers, old, new, n_loaded)),
            Numbers::F32(numbers) => Numbers::F32(copy(numbers, old, new, n_loaded)),
        };
        Self { n_rows, numbers }
    }

    /// Writes the tensor of a stored and a loaded node.
    pub(super) fn set_tensor(&mut self, row: usize, loaded: usize, tensor: &DMat3) {
        let first = loaded * Self::stride(self.n_rows);
        fn set<T: Number>(numbers: &mut [T], row: usize, tensor: &DMat3) {
            for d in 0..3 {
                for axis in 0..3 {
                    numbers[place(row, d, axis)] = T::narrow(tensor.col(d)[axis]);
                }
            }
        }
        with_numbers!(&mut self.numbers, numbers => set(&mut numbers[first..], row, tensor));
    }

    /// Adds a loaded node whose columns are zero.
    pub(super) fn push_loaded(&mut self) {
        let stride = Self::stride(self.n_rows);
        fn push<T: Number>(numbers: &mut Vec<T>, stride: usize) {
            numbers.resize(numbers.len() + stride, T::narrow(0.0));
        }
        with_numbers!(&mut self.numbers, numbers => push(numbers, stride));
    }

    /// Removes the last loaded node.
    pub(super) fn pop_loaded(&mut self) {
        let stride = Self::stride(self.n_rows);
        with_numbers!(&mut self.numbers, numbers => numbers.truncate(numbers.len() - stride));
    }

    /// Exchanges two loaded nodes.
    pub(super) fn swap_loaded(&mut self, a: usize, b: usize) {
        let stride = Self::stride(self.n_rows);
        let (a, b) = (a.min(b), a.max(b));
        fn swap<T: Number>(numbers: &mut [T], a: usize, b: usize, stride: usize) {
            let (front, back) = numbers.split_at_mut(stride * b);
            front[stride * a..stride * (a + 1)].swap_with_slice(&mut back[..stride]);
        }
        if a != b {
            with_numbers!(&mut self.numbers, numbers => swap(numbers, a, b, stride));
        }
    }

    /// Exchanges two rows of every loaded node.
    pub(super) fn swap_rows(&mut self, a: usize, b: usize) {
        let stride = Self::stride(self.n_rows);
        with_numbers!(&mut self.numbers, numbers => {
            for node in numbers.chunks_exact_mut(stride) {
                swap_rows_of(node, a, b);
            }
        });
    }

    /// Makes a row zero for every loaded node.
    pub(super) fn clear_row(&mut self, row: usize) {
        let stride = Self::stride(self.n_rows);
        fn clear<T: Number>(node: &mut [T], row: usize) {
            for component in 0..9 {
                node[place(row, component / 3, component % 3)] = T::narrow(0.0);
            }
        }
        with_numbers!(&mut self.numbers, numbers => {
            for node in numbers.chunks_exact_mut(stride) {
                clear(node, row);
            }
        });
    }

    /// Adds sum_r w_r (x) factor_r to every loaded node.
    pub(super) fn add_low_rank(&mut self, change: &LowRankChange) {
        let stride = Self::stride(self.n_rows);
        let level = Level::new();
        with_numbers!(&mut self.numbers, numbers => {
            dispatch!(level, _simd => add_tiles(numbers, stride, change));
        });
    }

    /// Adds the columns of a loaded node's force axis, times `factor`, to the columns of `axis` of a response in the
    /// layout of a loaded node.
    pub(super) fn add_column_to(&self, loaded: usize, axis: usize, factor: f64, response: &mut [f64]) {
        let stride = Self::stride(self.n_rows);
        let range = stride * loaded..stride * (loaded + 1);
        fn add<T: Number>(numbers: &[T], axis: usize, factor: f64, response: &mut [f64]) {
            let own = BLOCK_ROWS * axis..BLOCK_ROWS * (axis + 1);
            for (block, sum) in
                numbers.chunks_exact(BLOCK_NUMBERS).zip(response.chunks_exact_mut(BLOCK_NUMBERS))
            {
                for (x, s) in block[own.clone()].iter().zip(&mut sum[own.clone()]) {
                    *s += factor * x.wide();
                }
            }
        }
        with_numbers!(&self.numbers, numbers => add(&numbers[range], axis, factor, response));
    }
}

/// Exchanges two rows of a loaded node.
pub(super) fn swap_rows_of<T>(node: &mut [T], a: usize, b: usize) {
    for component in 0..9 {
        let (d, axis) = (component / 3, component % 3);
        node.swap(place(a, d, axis), place(b, d, axis));
    }
}

/// Adds the same change to a response in the layout of a loaded node; `factors` are those of its three columns.
pub(super) fn add_low_rank_to(response: &mut [f64], blocks: &[f64], factors: &[[f64; 3]; RANK]) {
    add_to_node(response, blocks, factors);
}

#[inline(always)]
fn add_tiles<T: Number>(numbers: &mut [T], stride: usize, change: &LowRankChange) {
    for (tile, columns) in change.blocks.chunks(TILE_BLOCKS * RANK * BLOCK_ROWS).enumerate() {
        let first = tile * TILE_BLOCKS * BLOCK_NUMBERS;
        let n = columns.len() / (RANK * BLOCK_ROWS) * BLOCK_NUMBERS;
        for (node, factors) in numbers.chunks_exact_mut(stride).zip(&change.factors) {
            add_to_node(&mut node[first..first + n], columns, factors);
        }
    }
}

#[inline(always)]
fn add_to_node<T: Number>(node: &mut [T], columns: &[f64], factors: &[[f64; 3]; RANK]) {
    let blocks = node.as_chunks_mut::<BLOCK_NUMBERS>().0;
    for (block, w) in blocks.iter_mut().zip(columns.as_chunks::<{ RANK * BLOCK_ROWS }>().0) {
        for d in 0..3 {
            let mut sum = [0.0; BLOCK_ROWS];
            for r in 0..RANK {
                for i in 0..BLOCK_ROWS {
                    sum[i] += factors[r][d] * w[BLOCK_ROWS * r + i];
                }
            }
            for i in 0..BLOCK_ROWS {
                let x = &mut block[BLOCK_ROWS * d + i];
                *x = T::narrow(x.wide() + sum[i]);
            }
        }
    }
}
