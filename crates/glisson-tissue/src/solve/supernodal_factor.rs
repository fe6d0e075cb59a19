//! The supernodal factor L L^T of new values, unit by unit, with the bits of faer's whole factorization.
//!
//! Left-looking: for each supernode in the order of elimination, the columns of A, minus what earlier supernodes contribute,
//!
//! L_s = A_s - sum over d of L_d,below L_d,inside^T,
//!
//! then its triangle is factored, and the rows below are solved with it (E. G. Ng and B. W. Peyton 1993, Block sparse Cholesky
//! algorithms on advanced uniprocessor computers, doi 10.1137/0914063). A unit is one contribution, or the end of a supernode; the
//! last supernode's end is the largest, 0.3 to 1.5 ms for 300 to 700 columns.
//! Products, triangles and triangular solutions are faer's. Its loop cannot stop midway, permutes A anew each time, and
//! searches where rows lie; here a plan, made once for a pattern, tells both. Products are computed apart and then
//! subtracted, which are the same roundings as subtracting in the kernel: a kernel adds up to [`MOST_TERMS`] terms before it
//! subtracts.

use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::linalg::cholesky::llt::factor::{LltRegularization, cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::matmul::matmul;
use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::sparse::linalg::cholesky::supernodal::SymbolicSupernodalCholesky;
use faer::{Accum, MatMut, MatRef, Par};

use super::SolveError;

/// Aligned enough for every vector instruction.
const CACHE_LINE_BYTES: usize = 64;

/// Scratch of the same size; its contents do not matter.
pub(super) fn same_size(memory: &MemBuffer) -> MemBuffer {
    MemBuffer::new(StackReq::new_aligned::<u8>(memory.len(), CACHE_LINE_BYTES))
}

/// Terms that the kernel of faer's products (private-gemm-x86 0.1.22) adds up before it adds them to the result.
const MOST_TERMS: usize = 512;
/// Up to so many columns, a product computes its upper triangle too, which costs less than a second product.
const WHOLE_COLUMNS: usize = 48;

// Work of the parts of a unit [ps], fitted to times of single units of cubes with 4,000 and 5,000 rows on one core of a server
// (AMD EPYC with AVX-512). They decide where slices end, and enter no number.
/// To find rows and to start the kernels.
const UNIT_WORK_PS: u64 = 600_000;
/// For each entry that is subtracted, and each term of its product.
const ENTRY_WORK_PS: u64 = 1_000;
const TERM_WORK_PS: u64 = 8;
/// For each entry below a triangle, and each term of the triangle and of what is below.
const BELOW_WORK_PS: u64 = 2_100;
const TRIANGLE_TERM_WORK_PS: u64 = 27;

/// A contribution of an earlier supernode.
#[derive(Clone, Copy)]
struct Contribution {
    from: u32,
    /// Its first row below its triangle that lies among the columns of the supernode, and the number of such rows.
    first: u32,
    n_inside: u32,
}

/// What each supernode is made from, for one pattern.
pub(super) struct FactorPlan {
    /// Entries of A and where they stand in the factor, supernode by supernode.
    entry_start: Vec<u32>,
    entries: Vec<[u32; 2]>,
    contribution_start: Vec<u32>,
    contributions: Vec<Contribution>,
    /// Most rows of a contribution, and most entries of its product.
    most_rows: usize,
    most_entries: usize,
    most_columns: usize,
    /// Work of all units [ns].
    work_ns: u64,
}

/// Scratch of the loop.
pub(super) struct LoopScratch {
    /// Row in the supernode of each row of the matrix; only those of the present supernode count.
    local_row: Vec<u32>,
    /// Rows of a contribution in the supernode.
    rows: Vec<u32>,
    product: Vec<f64>,
    memory: MemBuffer,
}

impl Clone for LoopScratch {
    /// Scratch of the same size; its contents do not matter.
    fn clone(&self) -> Self {
        Self {
            local_row: self.local_row.clone(),
            rows: self.rows.clone(),
            product: self.product.clone(),
            memory: same_size(&self.memory),
        }
    }
}

/// A supernode's columns and rows.
#[derive(Clone, Copy)]
struct Extent<'a> {
    start: usize,
    n_columns: usize,
    below: &'a [u32],
    /// Where its values start and end.
    values: [usize; 2],
}

impl<'a> Extent<'a> {
    fn of(symbolic: &'a SymbolicSupernodalCholesky<u32>, s: usize) -> Self {
        let start = symbolic.supernode_begin()[s] as usize;
        Self {
            start,
            n_columns: symbolic.supernode_end()[s] as usize - start,
            below: symbolic.supernode(s).pattern(),
            values: [s, s + 1].map(|s| symbolic.col_ptr_for_val()[s] as usize),
        }
    }

    fn end(&self) -> usize {
        self.start + self.n_columns
    }

    fn n_rows(&self) -> usize {
        self.n_columns + self.below.len()
    }

    /// Work of its last unit [ns].
    fn work_ns(&self) -> u64 {
        let (columns, below) = (self.n_columns as u64, self.below.len() as u64);
        let n_terms = columns * columns * (columns + 3 * below) / 6;
        (UNIT_WORK_PS + columns * below * BELOW_WORK_PS + n_terms * TRIANGLE_TERM_WORK_PS) / 1_000
    }
}

impl Contribution {
    fn work_ns(&self, from: &Extent<'_>) -> u64 {
        let n_rows = (from.below.len() - self.first as usize) as u64;
        let n_entries = n_rows * u64::from(self.n_inside);
        (UNIT_WORK_PS + n_entries * (ENTRY_WORK_PS + from.n_columns as u64 * TERM_WORK_PS)) / 1_000
    }
}

impl FactorPlan {
    /// For the upper triangle with these column starts and rows; `place_of_row` is the place in the order of elimination.
    pub(super) fn new(
        symbolic: &SymbolicSupernodalCholesky<u32>,
        (column_start, row): (&[u32], &[u32]),
        place_of_row: &[u32],
    ) -> Self {
        let n_supernodes = symbolic.n_supernodes();
        let mut supernode_of = vec![0u32; symbolic.nrows()];
        for s in 0..n_supernodes {
            let extent = Extent::of(symbolic, s);
            supernode_of[extent.start..extent.end()].fill(s as u32);
        }
        let entries = entries(symbolic, (column_start, row), place_of_row);
        let entry_start = (0..=n_supernodes)
            .map(|s| entries.partition_point(|e| e[1] < symbolic.col_ptr_for_val()[s]) as u32)
            .collect();
        let mut plan = Self {
            entry_start,
            entries,
            contribution_start: Vec::new(),
            contributions: Vec::new(),
            most_rows: 0,
            most_entries: 0,
            most_columns: 0,
            work_ns: 0,
        };
        plan.add_contributions(symbolic, &supernode_of);
        plan
    }

    fn add_contributions(&mut self, symbolic: &SymbolicSupernodalCholesky<u32>, supernode_of: &[u32]) {
        let n_supernodes = symbolic.n_supernodes();
        let mut of_supernode: Vec<Vec<Contribution>> = vec![Vec::new(); n_supernodes];
        for d in 0..n_supernodes {
            let from = Extent::of(symbolic, d);
            self.most_columns = self.most_columns.max(from.n_columns);
            self.work_ns += from.work_ns();
            let mut first = 0;
            for rows in from.below.chunk_by(|a, b| supernode_of[*a as usize] == supernode_of[*b as usize]) {
                let contribution =
                    Contribution { from: d as u32, first: first as u32, n_inside: rows.len() as u32 };
                let n_rows = from.below.len() - first;
                self.most_rows = self.most_rows.max(n_rows);
                self.most_entries = self.most_entries.max(n_rows * rows.len());
                self.work_ns += contribution.work_ns(&from);
                of_supernode[supernode_of[rows[0] as usize] as usize].push(contribution);
                first += rows.len();
            }
        }
        self.contribution_start.push(0);
        for list in of_supernode {
            self.contributions.extend(list);
            self.contribution_start.push(self.contributions.len() as u32);
        }
    }

    pub(super) fn scratch(&self, n_rows: usize) -> LoopScratch {
        let request = cholesky_in_place_scratch::<f64>(self.most_columns, Par::Seq, faer::Spec::default());
        LoopScratch {
            local_row: vec![0; n_rows],
            rows: vec![0; self.most_rows],
            product: vec![0.0; self.most_entries],
            memory: MemBuffer::new(request),
        }
    }

    /// Work of a whole factor [ns].
    pub(super) fn work_ns(&self) -> u64 {
        self.work_ns
    }

    /// Number of units: every contribution, and the end of every supernode.
    pub(super) fn n_units(&self) -> usize {
        self.contributions.len() + self.contribution_start.len() - 1
    }

    /// The supernode that a unit belongs to.
    fn supernode_of_unit(&self, unit: usize) -> usize {
        let (mut low, mut high) = (0, self.contribution_start.len() - 1);
        while high - low > 1 {
            let middle = (low + high) / 2;
            if self.contribution_start[middle] as usize + middle <= unit {
                low = middle;
            } else {
                high = middle;
            }
        }
        low
    }
}

/// Every entry of A with its place in the factor, in the order of places.
fn entries(
    symbolic: &SymbolicSupernodalCholesky<u32>,
    (column_start, row): (&[u32], &[u32]),
    place_of_row: &[u32],
) -> Vec<[u32; 2]> {
    // By column of the factor, then each of these short lists by place.
    let ends_of = |at: u32, c: usize| {
        let [i, j] = [row[at as usize] as usize, c].map(|r| place_of_row[r]);
        (i.max(j), i.min(j))
    };
    let mut start = vec![0u32; symbolic.nrows() + 1];
    for (c, range) in column_start.windows(2).enumerate() {
        (range[0]..range[1]).for_each(|at| start[ends_of(at, c).1 as usize + 1] += 1);
    }
    for j in 0..symbolic.nrows() {
        start[j + 1] += start[j];
    }
    let mut next = start.clone();
    let mut entries = vec![[0; 2]; row.len()];
    for (c, range) in column_start.windows(2).enumerate() {
        for at in range[0]..range[1] {
            let (i, j) = ends_of(at, c);
            let of_column = &mut next[j as usize];
            entries[*of_column as usize] = [at, i];
            *of_column += 1;
        }
    }
    let mut local_row = vec![0u32; symbolic.nrows()];
    for s in 0..symbolic.n_supernodes() {
        let extent = Extent::of(symbolic, s);
        let rows = (extent.start as u32..extent.end() as u32).chain(extent.below.iter().copied());
        rows.enumerate().for_each(|(local, row)| local_row[row as usize] = local as u32);
        for j in extent.start..extent.end() {
            let column = &mut entries[start[j] as usize..start[j + 1] as usize];
            let first = extent.values[0] + (j - extent.start) * extent.n_rows();
            for [_, place] in column.iter_mut() {
                *place = first as u32 + local_row[*place as usize];
            }
            column.sort_unstable_by_key(|entry| entry[1]);
        }
    }
    entries
}

/// Goes on with a factor of the values `a` in `factor`, from `unit` on, until the work of the next unit would exceed what is
/// left of `work_ns`; at least one unit. Returns the next unit. Allocates nothing.
///
/// # Errors
/// [`SolveError::Singular`] when a pivot is not positive.
pub(super) fn advance(
    (symbolic, plan): (&SymbolicSupernodalCholesky<u32>, &FactorPlan),
    a: &[f64],
    factor: &mut [f64],
    mut unit: usize,
    work_ns: &mut u64,
    scratch: &mut LoopScratch,
) -> Result<usize, SolveError> {
    let n_supernodes = symbolic.n_supernodes();
    let first_unit = unit;
    let mut s = if n_supernodes > 0 { plan.supernode_of_unit(unit) } else { 0 };
    while s < n_supernodes {
        let extent = Extent::of(symbolic, s);
        let contributions =
            &plan.contributions[plan.contribution_start[s] as usize..plan.contribution_start[s + 1] as usize];
        let done = unit - (plan.contribution_start[s] as usize + s);
        let (earlier, own) = factor.split_at_mut(extent.values[0]);
        let own = &mut own[..extent.values[1] - extent.values[0]];
        for (i, row) in extent.below.iter().enumerate() {
            scratch.local_row[*row as usize] = (extent.n_columns + i) as u32;
        }
        if done == 0 {
            own.fill(0.0);
            let entries = plan.entry_start[s] as usize..plan.entry_start[s + 1] as usize;
            for &[source, place] in &plan.entries[entries] {
                own[place as usize - extent.values[0]] += a[source as usize];
            }
        }
        let mut affords = |cost_ns: u64, unit: usize| {
            let affords = cost_ns <= *work_ns || unit == first_unit;
            *work_ns = work_ns.saturating_sub(cost_ns);
            affords
        };
        for contribution in &contributions[done.min(contributions.len())..] {
            let from = Extent::of(symbolic, contribution.from as usize);
            if !affords(contribution.work_ns(&from), unit) {
                return Ok(unit);
            }
            let values = &earlier[from.values[0]..from.values[1]];
            subtract(contribution, (&from, values), (&extent, own), scratch);
            unit += 1;
        }
        if !affords(extent.work_ns(), unit) {
            return Ok(unit);
        }
        finish(&extent, own, scratch)?;
        unit += 1;
        s += 1;
    }
    Ok(unit)
}

/// Subtracts what an earlier supernode contributes.
fn subtract(
    contribution: &Contribution,
    (from, values): (&Extent<'_>, &[f64]),
    (to, own): (&Extent<'_>, &mut [f64]),
    scratch: &mut LoopScratch,
) {
    let (first, n_inside) = (contribution.first as usize, contribution.n_inside as usize);
    let pattern = &from.below[first..];
    let n_rows = pattern.len();
    let rows = &mut scratch.rows[..n_rows];
    for (i, (local, row)) in rows.iter_mut().zip(pattern).enumerate() {
        *local = if i < n_inside { *row - to.start as u32 } else { scratch.local_row[*row as usize] };
    }
    let product = &mut scratch.product[..n_rows * n_inside];
    let all = MatRef::from_column_major_slice(values, from.n_rows(), from.n_columns);
    let lower = all.subrows(from.n_columns + first, n_rows);
    let mut term = 0;
    while term < from.n_columns {
        let n_terms = MOST_TERMS.min(from.n_columns - term);
        let lower = lower.subcols(term, n_terms);
        multiply(lower, n_inside, product);
        let is_run = rows[n_rows - 1] as usize - rows[0] as usize + 1 == n_rows;
        for (j, product) in product.chunks_exact(n_rows).enumerate() {
            let column = &mut own[rows[j] as usize * to.n_rows()..][..to.n_rows()];
            if is_run {
                let place = rows[j] as usize;
                let column = &mut column[place..place + n_rows - j];
                column.iter_mut().zip(&product[j..]).for_each(|(l, x)| *l -= x);
            } else {
                for (row, x) in rows[j..].iter().zip(&product[j..]) {
                    column[*row as usize] -= x;
                }
            }
        }
        term += n_terms;
    }
}

/// Overwrites the lower part of `product` with `lower` times the transpose of its first `n_inside` rows.
fn multiply(lower: MatRef<'_, f64>, n_inside: usize, product: &mut [f64]) {
    let n_rows = lower.nrows();
    let right = lower.subrows(0, n_inside).transpose();
    let mut product = MatMut::from_column_major_slice_mut(product, n_rows, n_inside);
    if n_inside <= WHOLE_COLUMNS {
        matmul(product, Accum::Replace, lower, right, 1.0, Par::Seq);
        return;
    }
    let (top, bottom) = product.as_mut().split_at_row_mut(n_inside);
    let (inside, below) = lower.split_at_row(n_inside);
    triangular::matmul(
        top,
        BlockStructure::TriangularLower,
        Accum::Replace,
        inside,
        BlockStructure::Rectangular,
        right,
        BlockStructure::Rectangular,
        1.0,
        Par::Seq,
    );
    if below.nrows() > 0 {
        matmul(bottom, Accum::Replace, below, right, 1.0, Par::Seq);
    }
}

/// Factors the triangle of a supernode and solves for the rows below.
fn finish(extent: &Extent<'_>, own: &mut [f64], scratch: &mut LoopScratch) -> Result<(), SolveError> {
    let own = MatMut::from_column_major_slice_mut(own, extent.n_rows(), extent.n_columns);
    let (mut triangle, below) = own.split_at_row_mut(extent.n_columns);
    cholesky_in_place(
        triangle.as_mut(),
        LltRegularization::default(),
        Par::Seq,
        MemStack::new(&mut scratch.memory),
        faer::Spec::default(),
    )
    .map_err(|_| SolveError::Singular)?;
    if below.nrows() > 0 {
        solve_lower_triangular_in_place(triangle.as_ref(), below.transpose_mut(), Par::Seq);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use faer::Side;
    use faer::sparse::linalg::SupernodalThreshold;
    use faer::sparse::linalg::cholesky::{
        CholeskySymbolicParams, SymbolicCholesky, SymbolicCholeskyRaw, SymmetricOrdering,
        factorize_symbolic_cholesky,
    };
    use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
    use glisson_mesh::math::SeededRandom;

    /// An upper triangle by columns.
    struct Upper {
        start: Vec<u32>,
        row: Vec<u32>,
        value: Vec<f64>,
    }

    /// Random entries where `couples` says so of a row and a later column, on a diagonal that makes it positive definite.
    fn random_matrix(n: usize, seed: u64, couples: impl Fn(usize, usize) -> bool) -> Upper {
        let mut random = SeededRandom::new(seed);
        let mut upper = Upper { start: vec![0], row: Vec::new(), value: Vec::new() };
        for c in 0..n {
            for r in (0..c).filter(|r| couples(*r, c)) {
                upper.row.push(r as u32);
                upper.value.push(random.normal());
            }
            upper.row.push(c as u32);
            upper.value.push(100.0);
            upper.start.push(upper.row.len() as u32);
        }
        upper
    }

    /// Three components at each point of a cube, coupled along the edges of tetrahedra.
    fn of_cube(side: usize, seed: u64) -> Upper {
        let at = |i: usize| [i / 3 % side, i / 3 / side % side, i / 3 / side / side];
        random_matrix(3 * side * side * side, seed, |r, c| {
            let (a, b) = (at(r), at(c));
            (0..3).all(|k| b[k] == a[k] || b[k] == a[k] + 1)
        })
    }

    /// Two blocks of `size` and what couples them: supernodes of more columns than a kernel adds up at once.
    fn of_two_blocks(size: usize, n_common: usize) -> Upper {
        random_matrix(2 * size + n_common, 5, |r, c| c >= 2 * size || (r < size) == (c < size))
    }

    fn symbolic_of(upper: &Upper, order: SymmetricOrdering<'_, u32>) -> SymbolicCholesky<u32> {
        let params = CholeskySymbolicParams {
            supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
            ..Default::default()
        };
        factorize_symbolic_cholesky(pattern_of(upper), Side::Upper, order, params).unwrap()
    }

    fn pattern_of(upper: &Upper) -> SymbolicSparseColMatRef<'_, u32> {
        let n = upper.start.len() - 1;
        SymbolicSparseColMatRef::new_checked(n, n, &upper.start, None, &upper.row)
    }

    fn factor_by_faer(upper: &Upper, symbolic: &SymbolicCholesky<u32>) -> Vec<f64> {
        let mut values = vec![0.0; symbolic.len_val()];
        let request = symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default());
        let mut memory = MemBuffer::new(request);
        let (regularization, stack) = (LltRegularization::default(), MemStack::new(&mut memory));
        symbolic
            .factorize_numeric_llt(
                &mut values,
                SparseColMatRef::new(pattern_of(upper), &upper.value[..]),
                Side::Upper,
                regularization,
                Par::Seq,
                stack,
                Default::default(),
            )
            .unwrap();
        values
    }

    /// Whether faer's products run in the kernels that [`MOST_TERMS`] was read from.
    fn has_known_kernels() -> bool {
        #[cfg(target_arch = "x86_64")]
        let known = std::is_x86_feature_detected!("avx2") && std::is_x86_feature_detected!("fma");
        #[cfg(not(target_arch = "x86_64"))]
        let known = false;
        known
    }

    /// Factors in slices of `slice_ns`, in values that held something else; returns them and the number of slices.
    fn factor_in_slices(
        upper: &Upper,
        (nodes, plan): (&SymbolicSupernodalCholesky<u32>, &FactorPlan),
        slice_ns: u64,
    ) -> (Vec<f64>, usize) {
        let mut scratch = plan.scratch(nodes.nrows());
        let mut values = vec![f64::NAN; nodes.len_val()];
        let (mut unit, mut n_slices) = (0, 0);
        while unit < plan.n_units() {
            let mut left_ns = slice_ns;
            unit =
                advance((nodes, plan), &upper.value, &mut values, unit, &mut left_ns, &mut scratch).unwrap();
            n_slices += 1;
        }
        (values, n_slices)
    }

    #[test]
    fn a_factor_has_faers_bits_whatever_its_slices() {
        let laplacian = random_matrix(900, 3, |r, c| c - r == 30 || (c - r == 1 && c % 30 > 0));
        let matrices = [of_cube(2, 1), of_cube(5, 2), of_cube(8, 3), laplacian, of_two_blocks(600, 20)];
        for (m, upper) in matrices.iter().enumerate() {
            for order in [SymmetricOrdering::Amd, SymmetricOrdering::Identity] {
                let symbolic = symbolic_of(upper, order);
                let SymbolicCholeskyRaw::Supernodal(nodes) = symbolic.raw() else {
                    unreachable!("forced to be supernodal");
                };
                let identity: Vec<u32> = (0..symbolic.nrows() as u32).collect();
                let place_of_row = symbolic.perm().map_or(&identity[..], |order| order.arrays().1);
                let plan = FactorPlan::new(nodes, (&upper.start, &upper.row), place_of_row);
                let (at_once, n_slices) = factor_in_slices(upper, (nodes, &plan), u64::MAX);
                assert_eq!(n_slices, 1);
                if has_known_kernels() {
                    assert_eq!(at_once, factor_by_faer(upper, &symbolic), "matrix {m}, {order:?}");
                }
                for slice_ns in [0, plan.work_ns() / 10, plan.work_ns() / 3] {
                    let (in_slices, n_slices) = factor_in_slices(upper, (nodes, &plan), slice_ns);
                    assert_eq!(in_slices, at_once, "matrix {m}, {order:?}, slices of {slice_ns} ns");
                    assert!(slice_ns > 0 || n_slices == plan.n_units());
                }
            }
        }
    }

    #[test]
    fn slices_are_about_equal() {
        let upper = of_cube(9, 4);
        let symbolic = symbolic_of(&upper, SymmetricOrdering::Amd);
        let SymbolicCholeskyRaw::Supernodal(nodes) = symbolic.raw() else {
            unreachable!("forced to be supernodal");
        };
        let plan = FactorPlan::new(nodes, (&upper.start, &upper.row), symbolic.perm().unwrap().arrays().1);
        let (_, n_slices) = factor_in_slices(&upper, (nodes, &plan), plan.work_ns() / 6);
        assert!((6..=8).contains(&n_slices), "{n_slices} slices");
    }

    #[test]
    fn a_pivot_that_is_not_positive_is_an_error() {
        let mut upper = of_cube(4, 6);
        *upper.value.last_mut().unwrap() = -1.0;
        let symbolic = symbolic_of(&upper, SymmetricOrdering::Amd);
        let SymbolicCholeskyRaw::Supernodal(nodes) = symbolic.raw() else {
            unreachable!("forced to be supernodal");
        };
        let plan = FactorPlan::new(nodes, (&upper.start, &upper.row), symbolic.perm().unwrap().arrays().1);
        let mut scratch = plan.scratch(nodes.nrows());
        let mut values = vec![0.0; nodes.len_val()];
        let made = advance((nodes, &plan), &upper.value, &mut values, 0, &mut { u64::MAX }, &mut scratch);
        assert_eq!(made, Err(SolveError::Singular));
    }
}
