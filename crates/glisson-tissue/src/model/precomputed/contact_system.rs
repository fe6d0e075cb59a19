//! The small dense system of the imposed displacements, kept factored while the contacts change.
//!
//! A point of the surface is held along q of its directions d_r, at displacement U. With the weights w_k of its nodes
//! and a reaction x_s along each held direction of each point, the rows are
//!
//! sum over points j, directions s: d_r . (sum_kl w_k w_l T^kl) d_s x_s = d_r . (U - displacement without reactions).
//!
//! (Seed `003` eq. 2.12 for whole nodes; seed `001` s. 5 spreads a contact over the corners of a triangle.) The system is
//! symmetric and positive definite, except for rows that repeat others: their pivots vanish, and their reactions are set
//! to zero.
//!
//! The rows up to the first point that differs from the last call keep their factor; later rows are bordered to it. A new
//! point at the end costs O(n^2); a point removed from the middle costs the rows behind it. Compliances between points
//! that were there before are not read again. Each entry of the factor is computed by the same operations in the same
//! order, whether it is bordered or factored anew (left-looking, products in the order of the columns): **the bits depend
//! on the list of points alone, not on its history**, so none of this is part of a model's state.
//!
//! A table in `f32` is symmetric only up to rounding. The factor is that of its symmetric part; iterative refinement with
//! the table's own entries then meets the targets as closely as with `f64`.

use super::pairs::Pairs;
use super::table::{Numbers, Table};
use crate::model::bounded_vec::BoundedVec;
use crate::model::kernel::{KernelPath, LaneBlock, LaneBlockWork};
use glisson_mesh::math::{DMat3, DVec3, fused};

/// Points at most.
pub(super) const MOST_POINTS: usize = 64;
/// Rows at most.
const MOST_ROWS: usize = 3 * MOST_POINTS;
/// Groups of eight rows in a column.
const COLUMN_GROUPS: usize = MOST_ROWS / 8;
/// Columns that are factored together.
const PANEL: usize = 4;

/// A pivot below this share of its diagonal entry marks a row that repeats others: its unknown is zero. A choice: rounding
/// leaves 1e-14 in `f64`, and points 1e-4 of a triangle apart leave about 1e-8 to 1e-9.
const LEAST_PIVOT: f64 = 1e-10;

/// Refinement stops when the largest residual is this share of the largest target. At most so many refinements: with
/// `f64` against rounding, with `f32` against the table's asymmetry of 6e-8.
const ENOUGH: f64 = 1e-13;
const REFINEMENTS_F64: usize = 1;
const REFINEMENTS_F32: usize = 3;

/// A held point: loadable nodes with their weights, and the directions along which it is held.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ContactPoint {
    pub(super) loaded: [u32; 3],
    pub(super) weights: [f64; 3],
    pub(super) n_nodes: usize,
    pub(super) directions: [DVec3; 3],
    pub(super) n_directions: usize,
}

impl ContactPoint {
    /// A node held along all axes.
    pub(super) fn node(loaded: u32) -> Self {
        Self {
            loaded: [loaded; 3],
            weights: [1.0, 0.0, 0.0],
            n_nodes: 1,
            directions: DVec3::AXES,
            n_directions: 3,
        }
    }

    /// Its nodes with their weights.
    pub(super) fn nodes(&self) -> impl Iterator<Item = (u32, f64)> + '_ {
        self.loaded.iter().copied().zip(self.weights).take(self.n_nodes)
    }

    fn is_whole_node(&self) -> bool {
        self.n_nodes == 1
            && self.n_directions == 3
            && self.weights[0] == 1.0
            && self.directions == DVec3::AXES
    }
}

/// Report on the last solution.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ContactReport {
    /// Rows of the system: held directions of all points.
    pub n_rows: usize,
    /// Rows that repeat others (a node twice, more points on a triangle than it has degrees of freedom). They exert no
    /// force; where they do not contradict the others, their targets are met all the same.
    pub n_repeated: usize,
    /// Largest distance of a point from its target along a held direction [m]: rounding, unless targets contradict each
    /// other.
    pub largest_miss_m: f64,
    /// Rows that kept their factor from the step before.
    pub n_kept: usize,
}

/// The system of the points.
#[derive(Clone, Debug)]
pub(super) struct ContactSystem {
    points: BoundedVec<ContactPoint>,
    n_rows: usize,
    /// Column by column: displacement along the row's direction for a unit reaction of the column.
    actual: Vec<[f64; 8]>,
    /// Scratch for points that change places.
    spare: Vec<[f64; 8]>,
    /// Lower triangle L of the symmetric part, column by column; zero above the diagonal in its groups of eight and below
    /// the last row.
    factor: Vec<[f64; 8]>,
    /// 1/L_jj; zero for a row that repeats others.
    inverse: Vec<f64>,
    right: Vec<[f64; 8]>,
    solution: Vec<[f64; 8]>,
    work: Vec<[f64; 8]>,
    report: ContactReport,
}

/// The points that take the place of those before.
struct Update<'a> {
    wanted: &'a [ContactPoint],
    /// Points at the start that stay, and their rows.
    n_kept: usize,
    kept_rows: usize,
    /// Whether the table is symmetric to the bit.
    is_symmetric: bool,
}

impl Update<'_> {
    /// Brings the tensors of the points that do not stay into the cache.
    fn fetch(&self, pairs: &Pairs) {
        let mut nodes = [0; 3 * MOST_POINTS];
        let (mut n_nodes, mut n_old) = (0, 0);
        for (i, point) in self.wanted.iter().enumerate() {
            for (node, _) in point.nodes() {
                nodes[n_nodes] = node;
                n_nodes += 1;
            }
            if i < self.n_kept {
                n_old = n_nodes;
            }
        }
        pairs.fetch(&nodes[..n_nodes], n_old);
    }
}

/// Former place of a point that is new.
const NEW: (usize, usize) = (usize::MAX, 0);

/// Entries of the matrix between two points: first row and column, numbers of rows and columns.
struct Block {
    first: [usize; 2],
    size: [usize; 2],
}

impl Block {
    /// Copies the entries, and those across the diagonal, from their former place.
    #[inline]
    fn copy_from(&self, was: [usize; 2], from: &[f64], to: &mut [f64]) {
        let [row, column] = self.first;
        for s in 0..self.size[1] {
            for r in 0..self.size[0] {
                let (new, old) = ((row + r, column + s), (was[0] + r, was[1] + s));
                to[entry(new.0, new.1)] = from[entry(old.0, old.1)];
                to[entry(new.1, new.0)] = from[entry(old.1, old.0)];
            }
        }
    }

    /// Writes the entries, and those across the diagonal.
    #[inline]
    fn write(&self, block: &DMat3, back: &DMat3, to: &mut [f64]) {
        let [row, column] = self.first;
        for s in 0..self.size[1] {
            for r in 0..self.size[0] {
                to[entry(column + s, row + r)] = back.col(r)[s];
                to[entry(row + r, column + s)] = block.col(s)[r];
            }
        }
    }

    /// Mirrors the lower triangle of a point's block with itself to the upper one.
    #[inline]
    fn mirror_lower(&self, block: &DMat3, to: &mut [f64]) {
        let [row, column] = self.first;
        for (r, s) in [(1, 0), (2, 0), (2, 1)] {
            if r < self.size[0] {
                to[entry(column + s, row + r)] = block.col(s)[r];
            }
        }
    }
}

impl ContactSystem {
    pub(super) fn new() -> Self {
        let matrix = || vec![[0.0; 8]; COLUMN_GROUPS * MOST_ROWS];
        let column = || vec![[0.0; 8]; COLUMN_GROUPS];
        Self {
            points: BoundedVec::with_capacity(MOST_POINTS),
            n_rows: 0,
            actual: matrix(),
            spare: matrix(),
            factor: matrix(),
            inverse: vec![0.0; MOST_ROWS],
            right: column(),
            solution: column(),
            work: column(),
            report: ContactReport::default(),
        }
    }

    /// Forgets all compliances: the table has changed.
    pub(super) fn forget(&mut self) {
        self.points.clear();
        self.n_rows = 0;
        self.report = ContactReport::default();
    }

    pub(super) fn report(&self) -> ContactReport {
        self.report
    }

    /// The right-hand side of these rows, to be written before [`ContactSystem::solve`].
    pub(super) fn right_mut(&mut self) -> &mut [f64] {
        &mut self.right.as_flattened_mut()[..self.n_rows]
    }

    /// Reactions [N] along the held directions.
    pub(super) fn solution(&self) -> &[f64] {
        &self.solution.as_flattened()[..self.n_rows]
    }

    /// Changes the points: reads the new compliances, and factors from the first point that differs.
    pub(super) fn update(&mut self, path: KernelPath, table: &Table, pairs: &Pairs, wanted: &[ContactPoint]) {
        let is_same = |(a, b): &(&ContactPoint, &ContactPoint)| a == b;
        let n_kept = self.points.iter().zip(wanted).take_while(is_same).count();
        let rows_of = |points: &[ContactPoint]| points.iter().map(|p| p.n_directions).sum::<usize>();
        let kept_rows = rows_of(&wanted[..n_kept]);
        self.report.n_kept = kept_rows;
        if n_kept == wanted.len() && n_kept == self.points.len() {
            return;
        }
        let is_symmetric = matches!(table.numbers, Numbers::F64(_));
        self.read_rows((table, pairs), &Update { wanted, n_kept, kept_rows, is_symmetric });
        self.points.clear();
        for point in wanted {
            self.points.try_push(*point);
        }
        self.n_rows = rows_of(wanted);
        self.fill_factor(kept_rows, is_symmetric);
        path.run_by_eight(Factor {
            n: self.n_rows,
            first_row: kept_rows,
            actual: &self.actual,
            factor: &mut self.factor,
            inverse: &mut self.inverse,
        });
    }

    /// Reads the compliances between the points that do not keep their place and all others.
    fn read_rows(&mut self, tensors: (&Table, &Pairs), update: &Update<'_>) {
        let Update { wanted, n_kept, kept_rows, is_symmetric } = *update;
        let was = self.places_before(update);
        if was[n_kept..].iter().any(|was| was.0 != NEW.0) {
            self.set_aside(kept_rows);
        }
        update.fetch(tensors.1);
        let (actual, spare) = (self.actual.as_flattened_mut(), self.spare.as_flattened());
        let mut first = kept_rows;
        for (i, a) in wanted.iter().enumerate().skip(n_kept) {
            let mut column = 0;
            for (j, b) in wanted[..=i].iter().enumerate() {
                let to = Block { first: [first, column], size: [a.n_directions, b.n_directions] };
                let (was_a, was_b) = (was[i], was[j]);
                // Not of two points that changed their order: the two halves of the table differ by rounding.
                if was_a.0 != NEW.0 && (i == j || was_b.0 < was_a.0) {
                    to.copy_from([was_a.1, was_b.1], spare, actual);
                } else {
                    let block = compliance(tensors, a, b);
                    let back = if is_symmetric { block.transpose() } else { compliance(tensors, b, a) };
                    to.write(&block, &back, actual);
                    if is_symmetric && i == j {
                        to.mirror_lower(&block, actual);
                    }
                }
                column += b.n_directions;
            }
            first += a.n_directions;
        }
    }

    /// Where each wanted point was before: its place among the points and its first row, [`NEW`] for a new one.
    fn places_before(&self, update: &Update<'_>) -> [(usize, usize); MOST_POINTS] {
        let Update { wanted, n_kept, kept_rows, .. } = *update;
        let mut was = [NEW; MOST_POINTS];
        for (point, was) in wanted[n_kept..].iter().zip(&mut was[n_kept..]) {
            let mut row = kept_rows;
            for (i, old) in self.points.iter().enumerate().skip(n_kept) {
                if old == point {
                    *was = (i, row);
                    break;
                }
                row += old.n_directions;
            }
        }
        let mut row = 0;
        for (i, (point, was)) in wanted[..n_kept].iter().zip(&mut was).enumerate() {
            *was = (i, row);
            row += point.n_directions;
        }
        was
    }

    /// Moves the matrix to `spare`, to be copied back in its new order, except for the rows that are kept.
    fn set_aside(&mut self, kept_rows: usize) {
        std::mem::swap(&mut self.actual, &mut self.spare);
        for j in 0..kept_rows {
            let column = COLUMN_GROUPS * j..COLUMN_GROUPS * j + kept_rows.div_ceil(8);
            self.actual[column.clone()].copy_from_slice(&self.spare[column]);
        }
    }

    /// Writes the matrix to be factored, from the group of eight of `first_row` on.
    fn fill_factor(&mut self, first_row: usize, is_symmetric: bool) {
        let n = self.n_rows;
        let (n_groups, kept_groups) = (n.div_ceil(8), first_row / 8);
        for j in 0..n {
            let first_group = kept_groups.max(j / 8);
            let column = COLUMN_GROUPS * j + first_group..COLUMN_GROUPS * j + n_groups;
            self.factor[column.clone()].copy_from_slice(&self.actual[column]);
        }
        let factor = self.factor.as_flattened_mut();
        let actual = self.actual.as_flattened();
        for j in 0..n {
            if !is_symmetric {
                for i in (8 * kept_groups).max(j)..n {
                    factor[entry(i, j)] = 0.5 * (actual[entry(i, j)] + actual[entry(j, i)]);
                }
            }
            factor[entry(n, j)..entry(8 * n_groups, j)].fill(0.0);
        }
    }

    /// Solves for the reactions.
    pub(super) fn solve(&mut self, path: KernelPath, table: &Table) {
        let n = self.n_rows;
        let n_groups = n.div_ceil(8);
        self.right.as_flattened_mut()[n..8 * n_groups].fill(0.0);
        let refinements = match table.numbers {
            Numbers::F64(_) => REFINEMENTS_F64,
            Numbers::F32(_) => REFINEMENTS_F32,
        };
        self.report.largest_miss_m = path.run_by_eight(Solve {
            n,
            actual: &self.actual,
            factor: &self.factor,
            inverse: &self.inverse,
            right: &self.right[..n_groups],
            solution: &mut self.solution[..n_groups],
            work: &mut self.work[..n_groups],
            refinements,
        });
        self.report.n_rows = n;
        self.report.n_repeated = self.inverse[..n].iter().filter(|x| **x == 0.0).count();
    }
}

/// Place of an entry of a matrix by columns.
#[inline(always)]
fn entry(row: usize, column: usize) -> usize {
    MOST_ROWS * column + row
}

/// Displacements of `a` along its directions (rows) for unit reactions at `b` along its own (columns).
fn compliance((table, pairs): (&Table, &Pairs), a: &ContactPoint, b: &ContactPoint) -> DMat3 {
    let mut between = DMat3::ZERO;
    if a.is_whole_node() && b.is_whole_node() {
        return pairs.tensor(table, a.loaded[0], b.loaded[0]);
    }
    for (of, w) in a.nodes() {
        for (by, v) in b.nodes() {
            between += pairs.tensor(table, of, by) * (w * v);
        }
    }
    let mut block = DMat3::ZERO;
    for (s, along) in b.directions.iter().take(b.n_directions).enumerate() {
        let u = between * *along;
        for (r, direction) in a.directions.iter().take(a.n_directions).enumerate() {
            block.col_mut(s)[r] = direction.dot(u);
        }
    }
    block
}

/// Cholesky from `first_row` on: rows before it are factored already.
struct Factor<'a> {
    n: usize,
    first_row: usize,
    actual: &'a [[f64; 8]],
    factor: &'a mut [[f64; 8]],
    inverse: &'a mut [f64],
}

impl LaneBlockWork for Factor<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: LaneBlock>(self, zero: V) {
        let Self { n, first_row, actual, factor, inverse } = self;
        let (n_groups, kept_groups) = (n.div_ceil(8), first_row / 8);
        let minus_one = zero.constant(-1.0);
        for j0 in (0..n).step_by(PANEL) {
            let width = PANEL.min(n - j0);
            for group in kept_groups.max(j0 / 8)..n_groups {
                let mut sums = [zero; PANEL];
                for (t, sum) in sums.iter_mut().enumerate().take(width) {
                    *sum = zero.load(&factor[COLUMN_GROUPS * (j0 + t) + group]);
                }
                for k in 0..j0 {
                    let column = &factor[COLUMN_GROUPS * k..COLUMN_GROUPS * (k + 1)];
                    let minus = zero.load(&column[group]).times(minus_one);
                    let of_panel = &column[j0 / 8][j0 % 8..][..PANEL];
                    for (t, sum) in sums.iter_mut().enumerate() {
                        *sum = minus.fused(zero.constant(of_panel[t]), *sum);
                    }
                }
                let holds_diagonal = group == j0 / 8;
                for t in 0..width {
                    let (j, lane) = (j0 + t, j0 % 8 + t);
                    let mut rows = [0.0; 8];
                    if holds_diagonal {
                        sums[t].store(&mut rows);
                        let whole = actual.as_flattened()[entry(j, j)];
                        let pivot = rows[lane];
                        inverse[j] = if pivot > LEAST_PIVOT * whole { 1.0 / pivot.sqrt() } else { 0.0 };
                    }
                    sums[t].times(zero.constant(inverse[j])).store(&mut rows);
                    if holds_diagonal {
                        rows[..lane].fill(0.0);
                    }
                    factor[COLUMN_GROUPS * j + group] = rows;
                    let column = zero.load(&rows);
                    for s in t + 1..width {
                        let l = factor[COLUMN_GROUPS * j + j0 / 8][j0 % 8 + s];
                        sums[s] = column.fused(zero.constant(-l), sums[s]);
                    }
                }
            }
        }
    }
}

/// Solves with the factor and refines with the matrix itself; returns the largest residual.
struct Solve<'a> {
    n: usize,
    actual: &'a [[f64; 8]],
    factor: &'a [[f64; 8]],
    inverse: &'a [f64],
    right: &'a [[f64; 8]],
    solution: &'a mut [[f64; 8]],
    work: &'a mut [[f64; 8]],
    refinements: usize,
}

impl LaneBlockWork for Solve<'_> {
    type Output = f64;

    #[inline(always)]
    fn run<V: LaneBlock>(self, zero: V) -> f64 {
        let Self { n, actual, factor, inverse, right, solution, work, refinements } = self;
        solution.as_flattened_mut().fill(0.0);
        work.copy_from_slice(right);
        let largest = |of: &[[f64; 8]]| of.as_flattened().iter().fold(0.0, |m, x| f64::max(m, x.abs()));
        let mut miss = 0.0;
        let enough = ENOUGH * largest(right);
        for _ in 0..=refinements {
            solve_factored(zero, n, factor, inverse, work);
            for (x, change) in solution.as_flattened_mut().iter_mut().zip(work.as_flattened()) {
                *x += change;
            }
            work.copy_from_slice(right);
            for j in 0..n {
                let x = zero.constant(-solution[j / 8][j % 8]);
                for (left, column) in work.iter_mut().zip(&actual[COLUMN_GROUPS * j..]) {
                    zero.load(column).fused(x, zero.load(left)).store(left);
                }
            }
            work.as_flattened_mut()[n..].fill(0.0);
            miss = largest(work);
            if miss <= enough {
                break;
            }
        }
        miss
    }
}

/// Solves with the factor in place, four unknowns at a time, so that their sums are independent.
#[inline(always)]
fn solve_factored<V: LaneBlock>(
    zero: V,
    n: usize,
    factor: &[[f64; 8]],
    inverse: &[f64],
    right: &mut [[f64; 8]],
) {
    let n_groups = right.len();
    let column = |j: usize| &factor[COLUMN_GROUPS * j..][..n_groups];
    for j0 in (0..n).step_by(PANEL) {
        let (width, own) = (PANEL.min(n - j0), j0 / 8);
        let mut solved = [0.0; PANEL];
        for t in 0..width {
            solved[t] = right[own][j0 % 8 + t] * inverse[j0 + t];
            let minus = zero.constant(-solved[t]);
            zero.load(&column(j0 + t)[own]).fused(minus, zero.load(&right[own])).store(&mut right[own]);
        }
        right[own][j0 % 8..][..width].copy_from_slice(&solved[..width]);
        let minus = solved.map(|x| zero.constant(-x));
        for g in own + 1..n_groups {
            let mut rows = zero.load(&right[g]);
            for t in 0..width {
                rows = zero.load(&column(j0 + t)[g]).fused(minus[t], rows);
            }
            rows.store(&mut right[g]);
        }
    }
    let last = n.saturating_sub(1) / PANEL * PANEL;
    for j0 in (0..n).step_by(PANEL).map(|j| last - j) {
        let (width, own) = (PANEL.min(n - j0), j0 / 8);
        let mut sums = [zero; PANEL];
        for g in own + 1..n_groups {
            let x = zero.load(&right[g]);
            for t in 0..width {
                sums[t] = zero.load(&column(j0 + t)[g]).fused(x, sums[t]);
            }
        }
        let sums = sums.map(LaneBlock::sum);
        for t in (0..width).rev() {
            let (of_column, lane) = (&column(j0 + t)[own], j0 % 8 + t);
            let mut left = right[own][lane] - sums[t];
            for i in lane + 1..8 {
                left = fused(-of_column[i], right[own][i], left);
            }
            right[own][lane] = left * inverse[j0 + t];
        }
    }
}
