//! The compliance tensors in the order in which a response reads them.
//!
//! Rows (stored nodes) go in blocks of eight, the width of a vector of `f64`. A loaded node has its blocks one after
//! the other, a block nine groups of eight numbers: group 3 d + a holds the displacements along axis a for the unit
//! force along axis d. A response reads a loaded node's numbers from first to last; the tensor of a pair of nodes
//! lies within nine neighbouring cache lines. Rows that fill the last block up are zero.
//!
//! Displacements of the rows have the same layout: blocks of eight rows, all x, all y, all z.

use glisson_mesh::math::{DMat3, DVec3};

/// Rows in a block.
pub(super) const LANES: usize = 8;

/// Numbers of a block: nine components of its rows.
pub(super) const BLOCK_NUMBERS: usize = 9 * LANES;

/// Precision of a stored compliance.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Precision {
    /// LaneBlock bytes per number.
    #[default]
    F64,
    /// Four bytes per number: half the memory, relative errors of 6e-8. Sums are still `f64`.
    F32,
}

impl Precision {
    /// Bytes of a number.
    pub fn bytes(self) -> usize {
        match self {
            Self::F64 => 8,
            Self::F32 => 4,
        }
    }
}

/// The numbers themselves.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Numbers {
    F64(Vec<f64>),
    F32(Vec<f32>),
}

/// Tensors T^lm [m/N] of all stored nodes l and loaded nodes m.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Table {
    pub(super) n_rows: usize,
    pub(super) numbers: Numbers,
}

/// Place of a component of a row in one loaded node's numbers.
pub(super) fn place(row: usize, force_axis: usize, axis: usize) -> usize {
    row / LANES * BLOCK_NUMBERS + (3 * force_axis + axis) * LANES + row % LANES
}

/// Place of a component in the displacements of the rows.
pub(super) fn place_of_displacement(row: usize, axis: usize) -> usize {
    (row / LANES * 3 + axis) * LANES + row % LANES
}

/// Numbers that the displacements of `n_rows` rows take.
pub(super) fn n_displacements(n_rows: usize) -> usize {
    3 * LANES * n_rows.div_ceil(LANES)
}

impl Table {
    /// Numbers of one loaded node.
    pub(super) fn stride(n_rows: usize) -> usize {
        BLOCK_NUMBERS * n_rows.div_ceil(LANES)
    }

    /// Bytes that a table takes.
    pub(super) fn bytes(precision: Precision, n_rows: usize, n_loaded: usize) -> u128 {
        precision.bytes() as u128 * Self::stride(n_rows) as u128 * n_loaded as u128
    }

    /// A table of zeros, or `None` when memory is short.
    pub(super) fn zeros(precision: Precision, n_rows: usize, n_loaded: usize) -> Option<Self> {
        fn zeros<T: Copy>(n: usize, zero: T) -> Option<Vec<T>> {
            let mut numbers = Vec::new();
            numbers.try_reserve_exact(n).ok()?;
            numbers.resize(n, zero);
            Some(numbers)
        }
        let n = usize::try_from(Self::bytes(precision, n_rows, n_loaded)).ok()? / precision.bytes();
        let numbers = match precision {
            Precision::F64 => Numbers::F64(zeros(n, 0.0)?),
            Precision::F32 => Numbers::F32(zeros(n, 0.0)?),
        };
        Some(Self { n_rows, numbers })
    }

    pub(super) fn precision(&self) -> Precision {
        match self.numbers {
            Numbers::F64(_) => Precision::F64,
            Numbers::F32(_) => Precision::F32,
        }
    }

    /// Tensor of a stored and a loaded node.
    pub(super) fn tensor(&self, row: usize, loaded: usize) -> DMat3 {
        let first = loaded * Self::stride(self.n_rows);
        let entry = |d: usize, a: usize| {
            let at = first + place(row, d, a);
            match &self.numbers {
                Numbers::F64(numbers) => numbers[at],
                Numbers::F32(numbers) => f64::from(numbers[at]),
            }
        };
        let column = |d: usize| DVec3::new(entry(d, 0), entry(d, 1), entry(d, 2));
        DMat3::from_cols(column(0), column(1), column(2))
    }
}

/// The three columns of one load at a row, as the columns of a matrix.
pub(super) fn tensor_of_columns(columns: &[f64], row: usize) -> DMat3 {
    let column = |d: usize| DVec3::from_array([0, 1, 2].map(|a| columns[place(row, d, a)]));
    DMat3::from_cols(column(0), column(1), column(2))
}

/// Writes one column of unknowns in blocks: the response to the unit force along `force_axis`.
pub(super) fn write_column<T>(
    numbers: &mut [T],
    force_axis: usize,
    of_row: impl Iterator<Item = [f64; 3]>,
    narrow: impl Fn(f64) -> T,
) {
    for (row, u_m) in of_row.enumerate() {
        for (axis, u) in u_m.into_iter().enumerate() {
            numbers[place(row, force_axis, axis)] = narrow(u);
        }
    }
}
