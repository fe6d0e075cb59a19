//! Solutions with faer's supernodal factor L L^T, with faer's products and triangular solutions and its bits.
//!
//! faer's own loop moves numbers between rows and supernodes through views of any layout, which takes half of the time of a
//! block of columns. Here columns are slices.

use faer::dyn_stack::MemStack;
use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::sparse::linalg::cholesky::simplicial::SimplicialLltRef;
use faer::sparse::linalg::cholesky::supernodal::SupernodalLltRef;
use faer::sparse::linalg::cholesky::{SymbolicCholesky, SymbolicCholeskyRaw};
use faer::{Accum, Conj, MatMut, Par};

/// Scratch memory of solutions for one thread.
#[derive(Clone)]
pub struct FactorScratch {
    /// The right-hand sides in elimination order.
    ordered: Vec<f64>,
    /// The rows below a supernode.
    below: Vec<f64>,
    n_columns: usize,
}

impl FactorScratch {
    /// For up to `n_columns` right-hand sides at once.
    pub(super) fn new(symbolic: &SymbolicCholesky<u32>, n_columns: usize) -> Self {
        let most = match symbolic.raw() {
            SymbolicCholeskyRaw::Simplicial(_) => 0,
            SymbolicCholeskyRaw::Supernodal(nodes) => {
                let n_below = |s: usize| nodes.supernode(s).pattern().len();
                (0..nodes.n_supernodes()).map(n_below).max().unwrap_or(0)
            }
        };
        let ordered = vec![0.0; symbolic.nrows() * n_columns];
        Self { ordered, below: vec![0.0; most * n_columns], n_columns }
    }
}

/// Replaces `n_columns` right-hand sides, one after the other in `columns`, by their solutions. Allocates nothing.
///
/// # Panics
/// When the length of `columns` or the scratch does not fit.
pub(super) fn solve_in_place(
    (symbolic, values): (&SymbolicCholesky<u32>, &[f64]),
    columns: &mut [f64],
    n_columns: usize,
    scratch: &mut FactorScratch,
) {
    let n = symbolic.nrows();
    assert!(n_columns <= scratch.n_columns, "scratch made for fewer columns");
    assert_eq!(columns.len(), n * n_columns, "columns of {n} rows");
    if n == 0 {
        return;
    }
    let order = symbolic.perm().map(|order| order.arrays());
    let ordered = &mut scratch.ordered[..columns.len()];
    for (to, from) in ordered.chunks_exact_mut(n).zip(columns.chunks_exact(n)) {
        match order {
            Some((forward, _)) => to.iter_mut().zip(forward).for_each(|(x, i)| *x = from[*i as usize]),
            None => to.copy_from_slice(from),
        }
    }
    match symbolic.raw() {
        SymbolicCholeskyRaw::Supernodal(nodes) => {
            let factor = SupernodalLltRef::new(nodes, values);
            forward_in_place(&factor, (ordered, n), &mut scratch.below, |_| true);
            backward_in_place(&factor, (ordered, n), &mut scratch.below, |_| true);
        }
        // Of a matrix without products, as a diagonal one.
        SymbolicCholeskyRaw::Simplicial(columns) => {
            let right = MatMut::from_column_major_slice_mut(&mut *ordered, n, n_columns);
            let factor = SimplicialLltRef::new(columns, values);
            factor.solve_in_place_with_conj(Conj::No, right, Par::Seq, MemStack::new(&mut []));
        }
    }
    for (to, from) in columns.chunks_exact_mut(n).zip(ordered.chunks_exact(n)) {
        match order {
            Some((_, inverse)) => to.iter_mut().zip(inverse).for_each(|(x, i)| *x = from[*i as usize]),
            None => to.copy_from_slice(from),
        }
    }
}

/// As [`solve_in_place`] for one right-hand side in elimination order that is zero outside the supernodes of the first list; right in
/// those of the second, with the same bits. Both lists hold the paths to the root of the elimination tree. Allocates nothing.
///
/// # Panics
/// When a length does not fit, or the factor is not supernodal.
pub(super) fn solve_on_paths(
    (symbolic, values): (&SymbolicCholesky<u32>, &[f64]),
    ordered: &mut [f64],
    [given, asked]: [&[bool]; 2],
    scratch: &mut FactorScratch,
) {
    let SymbolicCholeskyRaw::Supernodal(nodes) = symbolic.raw() else {
        unreachable!("asked of supernodal factors alone");
    };
    if !ordered.is_empty() {
        let (n, factor) = (ordered.len(), SupernodalLltRef::new(nodes, values));
        forward_in_place(&factor, (ordered, n), &mut scratch.below, |s| given[s]);
        backward_in_place(&factor, (ordered, n), &mut scratch.below, |s| asked[s]);
    }
}

/// Replaces a right-hand side in elimination order by L^-1 of it. Allocates nothing.
///
/// # Panics
/// When the scratch does not fit, or the factor is not supernodal.
pub(super) fn solve_lower_in_place(
    (symbolic, values): (&SymbolicCholesky<u32>, &[f64]),
    ordered: &mut [f64],
    scratch: &mut FactorScratch,
) {
    let SymbolicCholeskyRaw::Supernodal(nodes) = symbolic.raw() else {
        unreachable!("asked of supernodal factors alone");
    };
    if !ordered.is_empty() {
        let n = ordered.len();
        forward_in_place(&SupernodalLltRef::new(nodes, values), (ordered, n), &mut scratch.below, |_| true);
    }
}

/// L y = b, in columns of `n` rows; y is zero in supernodes that do not count.
fn forward_in_place(
    factor: &SupernodalLltRef<'_, u32, f64>,
    (x, n): (&mut [f64], usize),
    below: &mut [f64],
    counts: impl Fn(usize) -> bool,
) {
    let k = x.len() / n;
    for s in (0..factor.symbolic().n_supernodes()).filter(|s| counts(*s)) {
        let node = factor.supernode(s);
        let (pattern, n_rows) = (node.pattern(), node.pattern().len());
        let (diagonal, lower) = node.val().split_at_row(node.val().ncols());
        let all = MatMut::from_column_major_slice_mut(&mut *x, n, k);
        let mut own = all.subrows_mut(node.start(), diagonal.ncols());
        solve_lower_triangular_in_place(diagonal, own.as_mut(), Par::Seq);
        if n_rows == 0 {
            continue;
        }
        let below = &mut below[..n_rows * k];
        let products = MatMut::from_column_major_slice_mut(&mut *below, n_rows, k);
        matmul(products, Accum::Replace, lower, own.as_ref(), 1.0, Par::Seq);
        for (x, below) in x.chunks_exact_mut(n).zip(below.chunks_exact(n_rows)) {
            pattern.iter().zip(below).for_each(|(i, product)| x[*i as usize] -= product);
        }
    }
}

/// L^T x = y, in columns of `n` rows, for the supernodes that count, whose ancestors do, too.
fn backward_in_place(
    factor: &SupernodalLltRef<'_, u32, f64>,
    (x, n): (&mut [f64], usize),
    below: &mut [f64],
    counts: impl Fn(usize) -> bool,
) {
    let k = x.len() / n;
    for s in (0..factor.symbolic().n_supernodes()).rev().filter(|s| counts(*s)) {
        let node = factor.supernode(s);
        let (pattern, n_rows) = (node.pattern(), node.pattern().len());
        let (diagonal, lower) = node.val().split_at_row(node.val().ncols());
        let below = &mut below[..n_rows * k];
        if n_rows > 0 {
            for (x, below) in x.chunks_exact(n).zip(below.chunks_exact_mut(n_rows)) {
                pattern.iter().zip(below).for_each(|(i, gathered)| *gathered = x[*i as usize]);
            }
        }
        let gathered = MatMut::from_column_major_slice_mut(&mut *below, n_rows, k);
        let all = MatMut::from_column_major_slice_mut(&mut *x, n, k);
        let mut own = all.subrows_mut(node.start(), diagonal.ncols());
        matmul(own.as_mut(), Accum::Add, lower.transpose(), gathered.as_ref(), -1.0, Par::Seq);
        solve_upper_triangular_in_place(diagonal.transpose(), own.as_mut(), Par::Seq);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use faer::Side;
    use faer::dyn_stack::MemBuffer;
    use faer::linalg::cholesky::llt::factor::LltRegularization;
    use faer::sparse::linalg::SupernodalThreshold;
    use faer::sparse::linalg::cholesky::{
        CholeskySymbolicParams, LltRef, SymmetricOrdering, factorize_symbolic_cholesky,
    };
    use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
    use glisson_mesh::math::SeededRandom;

    /// The upper triangle of the Laplacian of a cube of `side`^3 points, and a bit: column starts, rows, values.
    fn laplacian(side: usize) -> (Vec<u32>, Vec<u32>, Vec<f64>) {
        let (mut start, mut row, mut value) = (vec![0], Vec::new(), Vec::new());
        for c in 0..side * side * side {
            for (step, place) in [(side * side, c / side / side), (side, c / side % side), (1, c % side)] {
                if place > 0 {
                    row.push((c - step) as u32);
                    value.push(-1.0);
                }
            }
            row.push(c as u32);
            value.push(6.5);
            start.push(row.len() as u32);
        }
        (start, row, value)
    }

    #[test]
    fn solutions_have_faers_bits_for_any_number_of_columns() {
        let (start, row, value) = laplacian(9);
        let n = start.len() - 1;
        let pattern = SymbolicSparseColMatRef::new_checked(n, n, &start, None, &row);
        let params = CholeskySymbolicParams {
            supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
            ..Default::default()
        };
        for order in [SymmetricOrdering::Amd, SymmetricOrdering::Identity] {
            let symbolic = factorize_symbolic_cholesky(pattern, Side::Upper, order, params).unwrap();
            let mut values = vec![0.0; symbolic.len_val()];
            let request = symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default());
            let mut memory = MemBuffer::new(request);
            let matrix = SparseColMatRef::new(pattern, &value[..]);
            let (regularization, stack) = (LltRegularization::default(), MemStack::new(&mut memory));
            symbolic
                .factorize_numeric_llt(
                    &mut values,
                    matrix,
                    Side::Upper,
                    regularization,
                    Par::Seq,
                    stack,
                    Default::default(),
                )
                .unwrap();
            let mut scratch = FactorScratch::new(&symbolic, 48);
            for n_columns in [1, 3, 8, 48] {
                let mut random = SeededRandom::new(n_columns as u64);
                let mut ours: Vec<f64> = (0..n * n_columns).map(|_| random.normal()).collect();
                let mut theirs = ours.clone();
                solve_in_place((&symbolic, &values), &mut ours, n_columns, &mut scratch);
                let request = symbolic.solve_in_place_scratch::<f64>(n_columns, Par::Seq);
                let mut memory = MemBuffer::new(request);
                LltRef::new(&symbolic, &values).solve_in_place_with_conj(
                    Conj::No,
                    MatMut::from_column_major_slice_mut(&mut theirs, n, n_columns),
                    Par::Seq,
                    MemStack::new(&mut memory),
                );
                assert_eq!(ours, theirs, "{n_columns} columns");
            }
        }
    }
}
