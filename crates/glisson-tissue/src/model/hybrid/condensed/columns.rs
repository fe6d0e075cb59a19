//! Dense matrices by columns, and the products that a step makes with them.
//!
//! Memory bandwidth limits a step. A matrix is read once, and eight columns are added in one sweep, so that the sums
//! are read and written an eighth as often. Every sum has a fixed order, so the bits do not depend on the number of
//! threads. A processor without fused multiply-add rounds the tiles' products once more.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt;
use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use fearless_simd::{Level, Simd, dispatch, f64x8, prelude::*};
use glisson_mesh::math::DMat3;
use rayon::prelude::*;
use std::sync::Arc;

use crate::model::precomputed::Precision;

/// Columns added in one sweep.
const SWEEP: usize = 8;

/// Columns of a product that one task computes. The partition does not depend on the number of threads.
const PRODUCT_COLUMNS: usize = 96;

/// The entries of a matrix in column-major order. Copies share them until one is written to.
#[derive(Clone, Debug, PartialEq)]
enum Numbers {
    F64(Arc<Vec<f64>>),
    F32(Arc<Vec<f32>>),
}

/// A dense matrix.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Columns {
    n_rows: usize,
    n_columns: usize,
    numbers: Numbers,
}

impl Columns {
    /// A matrix in f64.
    pub(super) fn of(n_rows: usize, n_columns: usize, numbers: Vec<f64>) -> Self {
        assert_eq!(numbers.len(), n_rows * n_columns, "{n_rows} x {n_columns}");
        Self { n_rows, n_columns, numbers: Numbers::F64(Arc::new(numbers)) }
    }

    /// A matrix of zeros in f64.
    pub(super) fn zeros(n_rows: usize, n_columns: usize) -> Self {
        Self::of(n_rows, n_columns, vec![0.0; n_rows * n_columns])
    }

    /// The same matrix with its entries stored in this precision.
    pub(super) fn kept_in(self, precision: Precision) -> Self {
        match (precision, self.numbers) {
            (Precision::F32, Numbers::F64(numbers)) => {
                let narrow = numbers.iter().map(|&x| x as f32).collect();
                Self { numbers: Numbers::F32(Arc::new(narrow)), ..self }
            }
            (_, numbers) => Self { numbers, ..self },
        }
    }

    pub(super) fn n_rows(&self) -> usize {
        self.n_rows
    }

    pub(super) fn n_columns(&self) -> usize {
        self.n_columns
    }

    /// Bytes of the numbers.
    pub(super) fn bytes(&self) -> usize {
        match &self.numbers {
            Numbers::F64(numbers) => size_of_val(&numbers[..]),
            Numbers::F32(numbers) => size_of_val(&numbers[..]),
        }
    }

    pub(super) fn entry(&self, row: usize, column: usize) -> f64 {
        let at = self.n_rows * column + row;
        match &self.numbers {
            Numbers::F64(numbers) => numbers[at],
            Numbers::F32(numbers) => f64::from(numbers[at]),
        }
    }

    /// All numbers of a matrix in f64.
    ///
    /// # Panics
    /// When it is kept in f32.
    pub(super) fn numbers(&self) -> &[f64] {
        match &self.numbers {
            Numbers::F64(numbers) => numbers,
            Numbers::F32(_) => panic!("a matrix in f64"),
        }
    }

    /// A column of a matrix in f64.
    pub(super) fn column(&self, column: usize) -> &[f64] {
        &self.numbers()[self.n_rows * column..self.n_rows * (column + 1)]
    }

    fn numbers_mut(&mut self) -> &mut [f64] {
        match &mut self.numbers {
            Numbers::F64(numbers) => Arc::make_mut(numbers).as_mut_slice(),
            Numbers::F32(_) => panic!("a matrix in f64"),
        }
    }

    /// A column of a matrix in f64.
    pub(super) fn column_mut(&mut self, column: usize) -> &mut [f64] {
        let n = self.n_rows;
        &mut self.numbers_mut()[n * column..n * (column + 1)]
    }

    /// Adds a 3 x 3 block to a matrix in f64, at row block `p` and column block `q`.
    pub(super) fn add_block(&mut self, p: usize, q: usize, block: DMat3) {
        for axis in 0..3 {
            let column = &mut self.column_mut(3 * q + axis)[3 * p..3 * p + 3];
            column.iter_mut().zip(block.col(axis).to_array()).for_each(|(to, x)| *to += x);
        }
    }

    /// Makes a square matrix in f64 symmetric: replaces each pair of entries across the diagonal by its mean. They
    /// differ by rounding.
    pub(super) fn symmetrize(&mut self) {
        for j in 0..self.n_columns {
            for i in 0..j {
                let mean = 0.5 * (self.entry(i, j) + self.entry(j, i));
                self.column_mut(j)[i] = mean;
                self.column_mut(i)[j] = mean;
            }
        }
    }

    /// Adds the weighted columns to `sums`; uses the first rows when there are fewer sums than rows.
    pub(super) fn add_weighted(&self, weighted: impl Iterator<Item = (usize, f64)>, sums: &mut [f64]) {
        assert!(sums.len() <= self.n_rows, "no more sums than rows");
        let level = Level::new();
        let (mut picks, mut factors, mut n) = ([0; SWEEP], [0.0; SWEEP], 0);
        for (column, factor) in weighted {
            (picks[n], factors[n]) = (column, factor);
            n += 1;
            if n == SWEEP {
                self.sweep(level, picks, factors, sums);
                n = 0;
            }
        }
        if n > 0 {
            for i in n..SWEEP {
                (picks[i], factors[i]) = (picks[0], 0.0);
            }
            self.sweep(level, picks, factors, sums);
        }
    }

    /// Adds the matrix times `x` to `sums`; uses the first rows when there are fewer sums than rows.
    pub(super) fn add_times(&self, x: &[f64], sums: &mut [f64]) {
        assert_eq!(x.len(), self.n_columns, "one factor a column");
        self.add_weighted(x.iter().copied().enumerate(), sums);
    }

    fn sweep(&self, level: Level, picks: [usize; SWEEP], factors: [f64; SWEEP], sums: &mut [f64]) {
        let n = sums.len();
        let start = picks.map(|column| self.n_rows * column);
        match &self.numbers {
            Numbers::F64(numbers) => {
                let columns = start.map(|at| &numbers[at..at + n]);
                dispatch!(level, simd => add_columns(simd, columns, factors, sums));
            }
            Numbers::F32(numbers) => {
                let columns = start.map(|at| &numbers[at..at + n]);
                dispatch!(level, simd => add_narrow_columns(simd, columns, factors, sums));
            }
        }
    }

    /// Adds `left` times `right` (in f64) to the matrix, on the threads of the pool.
    pub(super) fn add_product(&mut self, left: &Columns, right: &Columns) {
        assert_eq!(left.n_columns, right.n_rows, "inner sizes");
        assert_eq!((self.n_rows, self.n_columns), (left.n_rows, right.n_columns), "outer sizes");
        if self.n_rows == 0 || self.n_columns == 0 || left.n_columns == 0 {
            return;
        }
        let wide;
        let left = match &left.numbers {
            Numbers::F64(numbers) => MatRef::from_column_major_slice(numbers, left.n_rows, left.n_columns),
            Numbers::F32(numbers) => {
                wide = numbers.iter().map(|&x| f64::from(x)).collect::<Vec<f64>>();
                MatRef::from_column_major_slice(&wide, left.n_rows, left.n_columns)
            }
        };
        let n_rows = self.n_rows;
        let right_of = |task: usize, n: usize| {
            let from = right.n_rows * PRODUCT_COLUMNS * task;
            MatRef::from_column_major_slice(&right.numbers()[from..from + right.n_rows * n], right.n_rows, n)
        };
        match &mut self.numbers {
            Numbers::F64(numbers) => {
                Arc::make_mut(numbers).par_chunks_mut(n_rows * PRODUCT_COLUMNS).enumerate().for_each(
                    |(task, out)| {
                        let n = out.len() / n_rows;
                        let out = MatMut::from_column_major_slice_mut(out, n_rows, n);
                        matmul(out, Accum::Add, left, right_of(task, n), 1.0, Par::Seq);
                    },
                );
            }
            Numbers::F32(numbers) => {
                Arc::make_mut(numbers).par_chunks_mut(n_rows * PRODUCT_COLUMNS).enumerate().for_each(
                    |(task, narrow)| {
                        let n = narrow.len() / n_rows;
                        let mut sums: Vec<f64> = narrow.iter().map(|&x| f64::from(x)).collect();
                        let out = MatMut::from_column_major_slice_mut(&mut sums, n_rows, n);
                        matmul(out, Accum::Add, left, right_of(task, n), 1.0, Par::Seq);
                        for (narrow, sum) in narrow.iter_mut().zip(&sums) {
                            *narrow = *sum as f32;
                        }
                    },
                );
            }
        }
    }

    /// The inverse of a symmetric matrix in f64, or `None` when it is not positive definite.
    pub(super) fn inverse(&self) -> Option<Self> {
        let n = self.n_rows;
        assert_eq!(n, self.n_columns, "a square matrix");
        if n == 0 {
            return Some(self.clone());
        }
        let mut factor = self.numbers().to_vec();
        let request = llt::factor::cholesky_in_place_scratch::<f64>(n, Par::Seq, Default::default())
            .or(llt::inverse::inverse_scratch::<f64>(n, Par::Seq));
        let mut memory = MemBuffer::new(request);
        let matrix = MatMut::from_column_major_slice_mut(&mut factor, n, n);
        let stack = MemStack::new(&mut memory);
        llt::factor::cholesky_in_place(matrix, Default::default(), Par::Seq, stack, Default::default())
            .ok()?;
        let mut inverse = Self::zeros(n, n);
        let out = MatMut::from_column_major_slice_mut(inverse.numbers_mut(), n, n);
        let factor = MatRef::from_column_major_slice(&factor, n, n);
        llt::inverse::inverse(out, factor, Par::Seq, MemStack::new(&mut memory));
        // The lower triangle holds the numbers.
        for j in 0..n {
            for i in j + 1..n {
                let x = inverse.entry(i, j);
                inverse.column_mut(i)[j] = x;
            }
        }
        inverse.numbers().iter().all(|x| x.is_finite()).then_some(inverse)
    }

    /// The transpose of these rows.
    pub(super) fn transpose_of_rows(&self, rows: std::ops::Range<usize>) -> Self {
        let mut transposed = Self::zeros(self.n_columns, rows.len());
        for (to, row) in rows.enumerate() {
            for column in 0..self.n_columns {
                transposed.numbers_mut()[self.n_columns * to + column] = self.entry(row, column);
            }
        }
        transposed
    }
}

#[inline(always)]
fn add_columns<S: Simd>(_: S, c: [&[f64]; SWEEP], f: [f64; SWEEP], sums: &mut [f64]) {
    let n = sums.len();
    let c = c.map(|column| &column[..n]);
    for i in 0..n {
        let low = (c[0][i] * f[0] + c[1][i] * f[1]) + (c[2][i] * f[2] + c[3][i] * f[3]);
        let high = (c[4][i] * f[4] + c[5][i] * f[5]) + (c[6][i] * f[6] + c[7][i] * f[7]);
        sums[i] += low + high;
    }
}

#[inline(always)]
fn add_narrow_columns<S: Simd>(_: S, c: [&[f32]; SWEEP], f: [f64; SWEEP], sums: &mut [f64]) {
    let n = sums.len();
    let c = c.map(|column| &column[..n]);
    for i in 0..n {
        let x = |k: usize| f64::from(c[k][i]) * f[k];
        sums[i] += ((x(0) + x(1)) + (x(2) + x(3))) + ((x(4) + x(5)) + (x(6) + x(7)));
    }
}

/// Rows and columns of a tile.
const TILE: usize = 8;

/// LaneBlock columns of eight numbers.
type Tile<T> = [[T; TILE]; TILE];

/// Tiles in one of the precisions.
#[derive(Clone, Debug, PartialEq)]
enum Tiles {
    F64(Vec<Tile<f64>>),
    F32(Vec<Tile<f32>>),
}

/// The lower triangle of a symmetric matrix, in tiles of eight by eight, down each block of columns. It takes half the
/// memory, so that a frontier of some hundred nodes stays in the second-level cache from step to step.
///
/// The tiles on the diagonal hold the large entries and are always f64. The others may be stored in f32, because memory
/// bandwidth limits the product; the arithmetic is in f64. The relative error of an entry is at most 6e-8 and the
/// same in every step. The matrix stays symmetric, so that it adds no energy.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct SymmetricTiles {
    n: usize,
    diagonal: Vec<Tile<f64>>,
    below: Tiles,
}

impl SymmetricTiles {
    /// The tiles of a symmetric matrix in f64; `precision` is that of those below the diagonal.
    pub(super) fn of(matrix: &Columns, precision: Precision) -> Self {
        let n = matrix.n_rows();
        let n_blocks = n.div_ceil(TILE);
        let entry = |i: usize, j: usize| if i < n && j < n { matrix.entry(i, j) } else { 0.0 };
        let tile = |i: usize, j: usize| -> Tile<f64> {
            let column = |k: usize| std::array::from_fn(|l| entry(TILE * i + l, TILE * j + k));
            std::array::from_fn(column)
        };
        let below = (0..n_blocks).flat_map(|j| (j + 1..n_blocks).map(move |i| (i, j)));
        let below = match precision {
            Precision::F64 => Tiles::F64(below.map(|(i, j)| tile(i, j)).collect()),
            Precision::F32 => {
                let narrow = |(i, j)| tile(i, j).map(|column| column.map(|x| x as f32));
                Tiles::F32(below.map(narrow).collect())
            }
        };
        Self { n, diagonal: (0..n_blocks).map(|j| tile(j, j)).collect(), below }
    }

    /// Length of a vector padded to whole tiles.
    pub(super) fn padded_len(&self) -> usize {
        TILE * self.n.div_ceil(TILE)
    }

    /// Adds the matrix times `x` to `sums`; both are padded to whole tiles.
    pub(super) fn add_times(&self, x: &[f64], sums: &mut [f64]) {
        assert_eq!((x.len(), sums.len()), (self.padded_len(), self.padded_len()), "whole blocks");
        let (x, sums) = (x.as_chunks().0, sums.as_chunks_mut().0);
        let (level, diagonal) = (Level::new(), &self.diagonal[..]);
        match &self.below {
            Tiles::F64(below) => dispatch!(level, simd => add_tiles(simd, diagonal, below, x, sums)),
            Tiles::F32(below) => dispatch!(level, simd => add_tiles(simd, diagonal, below, x, sums)),
        }
    }
}

#[inline(always)]
fn widened<S: Simd, T: Copy + Into<f64>>(simd: S, column: &[T; TILE]) -> f64x8<S> {
    f64x8::from_slice(simd, &column.map(Into::into))
}

#[inline(always)]
fn add_tiles<S: Simd, T: Copy + Into<f64>>(
    simd: S,
    diagonal: &[Tile<f64>],
    below: &[Tile<T>],
    x: &[[f64; TILE]],
    sums: &mut [[f64; TILE]],
) {
    let mut rest = below;
    for j in 0..x.len() {
        let (panel, later) = rest.split_at(x.len() - j - 1);
        rest = later;
        let factors: [f64x8<S>; TILE] = std::array::from_fn(|k| f64x8::splat(simd, x[j][k]));
        // The tile on the diagonal is complete; each other one also acts transposed.
        let mut sum = f64x8::from_slice(simd, &sums[j]);
        for k in 0..TILE {
            sum = f64x8::from_slice(simd, &diagonal[j][k]).mul_add(factors[k], sum);
        }
        sum.store_slice(&mut sums[j]);
        let mut mirrored = [f64x8::splat(simd, 0.0); TILE];
        for (i, tile) in (j + 1..).zip(panel) {
            let of_rows = f64x8::from_slice(simd, &x[i]);
            let (mut even, mut odd) = (f64x8::from_slice(simd, &sums[i]), f64x8::splat(simd, 0.0));
            for k in (0..TILE).step_by(2) {
                let (a, b) = (widened(simd, &tile[k]), widened(simd, &tile[k + 1]));
                even = a.mul_add(factors[k], even);
                odd = b.mul_add(factors[k + 1], odd);
                mirrored[k] = a.mul_add(of_rows, mirrored[k]);
                mirrored[k + 1] = b.mul_add(of_rows, mirrored[k + 1]);
            }
            (even + odd).store_slice(&mut sums[i]);
        }
        for k in 0..TILE {
            let mut m = [0.0; TILE];
            mirrored[k].store_slice(&mut m);
            sums[j][k] += ((m[0] + m[4]) + (m[1] + m[5])) + ((m[2] + m[6]) + (m[3] + m[7]));
        }
    }
}

/// Dot product by eight partial sums.
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (a_blocks, a_rest) = a.as_chunks::<8>();
    let (b_blocks, b_rest) = b[..a.len()].as_chunks::<8>();
    let mut sums = [0.0; 8];
    for (a, b) in a_blocks.iter().zip(b_blocks) {
        for i in 0..8 {
            sums[i] += a[i] * b[i];
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    ((sums[0] + sums[4]) + (sums[1] + sums[5])) + ((sums[2] + sums[6]) + (sums[3] + sums[7])) + rest
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson_mesh::math::SeededRandom;

    fn random(n_rows: usize, n_columns: usize, seed: u64) -> Columns {
        let mut random = SeededRandom::new(seed);
        Columns::of(n_rows, n_columns, (0..n_rows * n_columns).map(|_| random.normal()).collect())
    }

    #[test]
    fn sweeps_and_products_are_those_of_the_definition() {
        for (n_rows, n_columns) in [(1, 1), (13, 7), (40, 8), (33, 19), (5, 200)] {
            let matrix = random(n_rows, n_columns, 1);
            let x = random(n_columns, 1, 2);
            let by_definition =
                |i: usize| -> f64 { (0..n_columns).map(|j| matrix.entry(i, j) * x.entry(j, 0)).sum() };
            for (precision, tolerance) in [(Precision::F64, 1e-12), (Precision::F32, 1e-5)] {
                let kept = matrix.clone().kept_in(precision);
                let mut sums = vec![1.0; n_rows];
                kept.add_times(x.numbers(), &mut sums);
                let mut product = Columns::of(n_rows, 1, vec![1.0; n_rows]).kept_in(precision);
                product.add_product(&kept, &x);
                for i in 0..n_rows {
                    assert!((sums[i] - 1.0 - by_definition(i)).abs() < tolerance);
                    assert!((product.entry(i, 0) - 1.0 - by_definition(i)).abs() < tolerance);
                }
            }
            assert!(
                (dot(matrix.column(0), matrix.column(0))
                    - matrix.column(0).iter().map(|x| x * x).sum::<f64>())
                .abs()
                    < 1e-12
            );
        }
    }

    #[test]
    fn tiles_of_a_symmetric_matrix_give_its_product() {
        for n in [3, 8, 27] {
            let half = random(n, n, 7);
            let mut symmetric = half.clone();
            symmetric.add_product(&half.transpose_of_rows(0..n), &half);
            for j in 0..n {
                for i in 0..j {
                    let x = symmetric.entry(i, j);
                    symmetric.column_mut(i)[j] = x;
                }
            }
            for (precision, tolerance) in [(Precision::F64, 1e-11), (Precision::F32, 1e-5)] {
                let tiles = SymmetricTiles::of(&symmetric, precision);
                let mut x = vec![0.0; tiles.padded_len()];
                x[..n].copy_from_slice(random(n, 1, 8).numbers());
                let (mut sums, mut expected) = (vec![2.0; x.len()], vec![2.0; n]);
                tiles.add_times(&x, &mut sums);
                symmetric.add_times(&x[..n], &mut expected);
                for (a, b) in sums.iter().zip(&expected) {
                    assert!((a - b).abs() < tolerance, "{a} {b}");
                }
            }
        }
    }

    #[test]
    fn an_inverse_is_one_and_an_indefinite_matrix_has_none() {
        let half = random(30, 30, 3);
        let mut square = Columns::zeros(30, 30);
        for i in 0..30 {
            square.column_mut(i)[i] = 1.0;
        }
        square.add_product(&half, &half.transpose_of_rows(0..30));
        let inverse = square.inverse().unwrap();
        let mut one = Columns::zeros(30, 30);
        one.add_product(&square, &inverse);
        for i in 0..30 {
            for j in 0..30 {
                assert!((one.entry(i, j) - f64::from(u8::from(i == j))).abs() < 1e-10);
                assert_eq!(inverse.entry(i, j), inverse.entry(j, i));
            }
        }
        square.column_mut(4)[4] = -1.0;
        assert!(square.inverse().is_none());
    }
}
