//! Solutions for many right-hand sides, in blocks on the threads of the rayon pool.

use rayon::prelude::*;

use super::Factorization;

/// Right-hand sides in one block: a multiple of the dense kernels' widths. The partition into blocks does not depend
/// on the number of threads, so neither do the bits.
const COLUMNS_IN_BLOCK: usize = 48;

/// Solves for `out.len() / out_per_group` groups of `columns_in_group` right-hand sides each. `fill(column, right)` writes a
/// right-hand side that is zero before. `take(group, solutions, out)` receives a group's solutions, one after the other,
/// and its part of `out`. Both are called from any thread, once for each column or group.
///
/// # Panics
/// When `out` is not a whole number of groups, or a group is empty or longer than 48 columns.
pub fn solve_columns_into<T: Send>(
    factor: &Factorization,
    columns_in_group: usize,
    out: &mut [T],
    out_per_group: usize,
    fill: impl Fn(usize, &mut [f64]) + Sync,
    take: impl Fn(usize, &[f64], &mut [T]) + Sync,
) {
    assert!((1..=COLUMNS_IN_BLOCK).contains(&columns_in_group), "groups of {columns_in_group} columns");
    assert_eq!(out.len() % out_per_group, 0, "whole groups");
    let n_rows = factor.n_rows();
    let groups_in_block = COLUMNS_IN_BLOCK / columns_in_group;
    let columns_in_block = groups_in_block * columns_in_group;
    out.par_chunks_mut(out_per_group * groups_in_block).enumerate().for_each_init(
        || (factor.scratch(columns_in_block), vec![0.0; n_rows * columns_in_block]),
        |(scratch, right), (block, out)| {
            let first = block * groups_in_block;
            let n_columns = out.len() / out_per_group * columns_in_group;
            let right = &mut right[..n_rows * n_columns];
            right.fill(0.0);
            for (column, right) in right.chunks_exact_mut(n_rows).enumerate() {
                fill(first * columns_in_group + column, right);
            }
            factor.solve_in_place(right, n_columns, scratch);
            let groups =
                right.chunks_exact(n_rows * columns_in_group).zip(out.chunks_exact_mut(out_per_group));
            for (group, (solutions, out)) in groups.enumerate() {
                take(first + group, solutions, out);
            }
        },
    );
}
