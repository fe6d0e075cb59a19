//! The compliance of pairs of loadable nodes, with the nine entries of each pair adjacent in memory.
//!
//! A copy of a part of the table, for the small system of the contacts: a tensor lies in nine cache lines of the table,
//! here in two at most. Made for tables up to a size; larger ones are read directly.

use std::sync::Arc;

use super::table::{Numbers, Table};
use glisson_mesh::math::DMat3;

/// Largest copy [bytes]: 1,300 nodes in `f64`. Chosen to stay near the size of large caches.
const MOST_BYTES: usize = 64 << 20;

/// A copy, shared by copies of a model.
#[derive(Clone, Debug)]
pub(super) enum Pairs {
    /// No copy: the table is too large, or has changed since.
    None,
    /// In `f64`: the tensors of row >= column, row after row; the others are their transposes.
    Half(Arc<[[f64; 9]]>),
    /// In `f32`, which is symmetric only up to rounding: all tensors.
    All(usize, Arc<[[f32; 9]]>),
}

impl Pairs {
    pub(super) fn of_table(table: &Table, n_loadable: usize) -> Self {
        let n = n_loadable;
        let columns = |i: usize, j: usize| table.tensor(i, j).to_cols_array();
        match &table.numbers {
            Numbers::F64(_) if 36 * n * (n + 1) <= MOST_BYTES => {
                Self::Half((0..n).flat_map(|i| (0..=i).map(move |j| columns(i, j))).collect())
            }
            Numbers::F32(_) if 36 * n * n <= MOST_BYTES => {
                let narrow = move |i, j| columns(i, j).map(|x| x as f32);
                Self::All(n, (0..n).flat_map(|i| (0..n).map(move |j| narrow(i, j))).collect())
            }
            _ => Self::None,
        }
    }

    /// Reads from every pair of a node from the `first`-th on with a node before it, to bring them into the cache. Pairs lie
    /// far apart; the work on them would wait for the memory at each one.
    pub(super) fn fetch(&self, nodes: &[u32], first: usize) {
        let mut sum = 0.0;
        for (i, &a) in nodes.iter().enumerate().skip(first) {
            for &b in &nodes[..=i] {
                let (row, column) = (a.max(b) as usize, a.min(b) as usize);
                match self {
                    // A tensor can lie across two cache lines.
                    Self::Half(tensors) => {
                        let tensor = &tensors[row * (row + 1) / 2 + column];
                        sum += tensor[0] + tensor[8];
                    }
                    Self::All(n, tensors) => {
                        sum += f64::from(tensors[n * row + column][0] + tensors[n * column + row][0]);
                    }
                    Self::None => return,
                }
            }
        }
        std::hint::black_box(sum);
    }

    /// Displacement of loadable node `of` for a force on `by`. In `f64` that of the half of the table below the diagonal,
    /// so that T^ij is exactly the transpose of T^ji.
    #[inline]
    pub(super) fn tensor(&self, table: &Table, of: u32, by: u32) -> DMat3 {
        let (i, j) = (of as usize, by as usize);
        let (row, column) = (i.max(j), i.min(j));
        let tensor = match (self, &table.numbers) {
            (Self::Half(tensors), _) => DMat3::from_cols_array(&tensors[row * (row + 1) / 2 + column]),
            (Self::None, Numbers::F64(_)) => table.tensor(row, column),
            (Self::All(n, tensors), _) => {
                return DMat3::from_cols_array(&tensors[n * i + j].map(f64::from));
            }
            (Self::None, Numbers::F32(_)) => return table.tensor(i, j),
        };
        if i < j { tensor.transpose() } else { tensor }
    }
}

#[cfg(test)]
mod tests {
    use super::super::table::{Precision, write_column};
    use super::*;

    /// A table of 11 nodes, symmetric but for a little.
    fn table(precision: Precision) -> Table {
        let n = 11;
        let mut table = Table::zeros(precision, n, n).expect("it is small");
        let stride = Table::stride(n);
        let number = |row: usize, a: usize, column: usize, d: usize| {
            let (i, j) = (3 * row + a, 3 * column + d);
            (100 * i.max(j) + i.min(j)) as f64 + if i < j { 0.125 } else { 0.0 }
        };
        for column in 0..n {
            for d in 0..3 {
                let of_row = (0..n).map(|row| [0, 1, 2].map(|a| number(row, a, column, d)));
                let range = stride * column..stride * (column + 1);
                match &mut table.numbers {
                    Numbers::F64(numbers) => write_column(&mut numbers[range], d, of_row, |x| x),
                    Numbers::F32(numbers) => write_column(&mut numbers[range], d, of_row, |x| x as f32),
                }
            }
        }
        table
    }

    #[test]
    fn pairs_are_those_of_the_table_and_of_its_lower_half() {
        for precision in [Precision::F64, Precision::F32] {
            let table = table(precision);
            let pairs = Pairs::of_table(&table, 11);
            for (i, j) in (0..11).flat_map(|i| (0..11).map(move |j| (i, j))) {
                let found = pairs.tensor(&table, i, j);
                assert_eq!(found, Pairs::None.tensor(&table, i, j));
                let lower = table.tensor(i.max(j) as usize, i.min(j) as usize);
                let expected = match precision {
                    Precision::F64 if i < j => lower.transpose(),
                    Precision::F64 => lower,
                    Precision::F32 => table.tensor(i as usize, j as usize),
                };
                assert_eq!(found, expected, "{i} {j}");
            }
        }
    }
}
