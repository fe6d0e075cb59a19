//! Displacements of all stored nodes for some forces: the part of a step that reads whole columns.
//!
//! u_l = sum_m T^lm f_m (seed `003`, eq. 2.8 and 2.13). A call reads the three columns of each loaded node once, from
//! first to last, several loaded nodes side by side for each block of rows, so that the displacements are loaded and
//! stored once a group. Memory sets the pace: 72 numbers are read for 72 fused operations. A row's
//! sum goes over the loads in their order and in each over the axes, in fused operations: the bits are the same
//! on every path and for every grouping.

use super::table::{BLOCK_NUMBERS, LANES, Numbers, Table};
use crate::model::kernel::{KernelPath, LaneBlock, LaneBlockWork};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::NodeId;

/// A force [N] on a loadable node, given by its place among them.
pub(super) type Load = (u32, DVec3);

/// Numbers of a block of displacements.
const BLOCK_ROWS_NUMBERS: usize = 3 * LANES;

/// A number of a table.
trait Kept: Copy {
    fn load<V: LaneBlock>(path: V, numbers: &[Self; LANES]) -> V;
}

impl Kept for f64 {
    #[inline(always)]
    fn load<V: LaneBlock>(path: V, numbers: &[Self; LANES]) -> V {
        path.load(numbers)
    }
}

impl Kept for f32 {
    #[inline(always)]
    fn load<V: LaneBlock>(path: V, numbers: &[Self; LANES]) -> V {
        path.load_narrow(numbers)
    }
}

/// Adds the response to `loads` to the displacements [m] of the rows; overwrites them if `from_zero`.
pub(super) fn respond_into(
    path: KernelPath,
    table: &Table,
    loads: &[Load],
    from_zero: bool,
    displacement_m: &mut [f64],
) {
    // A table that grew has more blocks of rows than there are displacements.
    let n_blocks = Table::stride(table.n_rows) / BLOCK_NUMBERS;
    match &table.numbers {
        Numbers::F64(numbers) => {
            path.run_by_eight(Respond { numbers, n_blocks, loads, from_zero, displacement_m });
        }
        Numbers::F32(numbers) => {
            path.run_by_eight(Respond { numbers, n_blocks, loads, from_zero, displacement_m });
        }
    }
}

/// Overwrites displacements [m] in blocks with three columns in blocks times their factors.
pub(super) fn set_to_columns(path: KernelPath, columns: &[f64], factors: DVec3, displacement_m: &mut [f64]) {
    let loads = [(0, factors)];
    let n_blocks = columns.len() / BLOCK_NUMBERS;
    path.run_by_eight(Respond { numbers: columns, n_blocks, loads: &loads, from_zero: true, displacement_m });
}

struct Respond<'a, T> {
    /// The blocks of all loadable nodes, one after the other.
    numbers: &'a [T],
    /// Numbers of each loadable node.
    n_blocks: usize,
    loads: &'a [Load],
    from_zero: bool,
    displacement_m: &'a mut [f64],
}

impl<T: Kept> LaneBlockWork for Respond<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run<V: LaneBlock>(self, zero: V) {
        let Self { numbers, n_blocks: n, loads, mut from_zero, displacement_m } = self;
        let rows = displacement_m.as_chunks_mut::<BLOCK_ROWS_NUMBERS>().0;
        let blocks = numbers.as_chunks::<BLOCK_NUMBERS>().0;
        let of = |load: &Load| (&blocks[n * load.0 as usize..][..n], load.1.to_array());
        let (fours, rest) = loads.as_chunks::<4>();
        for four in fours {
            add_group(zero, four.each_ref().map(of), from_zero, rows);
            from_zero = false;
        }
        match rest {
            [a, b, c] => add_group(zero, [of(a), of(b), of(c)], from_zero, rows),
            [a, b] => add_group(zero, [of(a), of(b)], from_zero, rows),
            [a] => add_group(zero, [of(a)], from_zero, rows),
            _ if from_zero => rows.as_flattened_mut().fill(0.0),
            _ => {}
        }
    }
}

/// Adds the response to the forces on `G` loaded nodes, each with its blocks.
#[inline(always)]
fn add_group<V: LaneBlock, T: Kept, const G: usize>(
    zero: V,
    loaded: [(&[[T; BLOCK_NUMBERS]], [f64; 3]); G],
    from_zero: bool,
    rows: &mut [[f64; BLOCK_ROWS_NUMBERS]],
) {
    let forces = loaded.map(|(_, force)| force.map(|f| zero.constant(f)));
    let columns = loaded.map(|(blocks, _)| &blocks[..rows.len()]);
    for (b, row) in rows.iter_mut().enumerate() {
        let [x, y, z] = row.as_chunks_mut::<LANES>().0 else { unreachable!("a block has three components") };
        let mut u = if from_zero { [zero; 3] } else { [zero.load(x), zero.load(y), zero.load(z)] };
        for g in 0..G {
            let groups = columns[g][b].as_chunks::<LANES>().0;
            for d in 0..3 {
                for (a, u) in u.iter_mut().enumerate() {
                    *u = T::load(zero, &groups[3 * d + a]).fused(forces[g][d], *u);
                }
            }
        }
        u[0].store(x);
        u[1].store(y);
        u[2].store(z);
    }
}

/// Overwrites the positions [m] of the rows' nodes.
pub(super) fn place_rows(
    rows: &[NodeId],
    rest_m: &[DVec3],
    displacement_m: &[f64],
    positions_m: &mut [DVec3],
) {
    let blocks = displacement_m.as_chunks::<BLOCK_ROWS_NUMBERS>().0;
    for (nodes, u) in rows.chunks(LANES).zip(blocks) {
        for (lane, node) in nodes.iter().enumerate() {
            let u_m = DVec3::new(u[lane], u[LANES + lane], u[2 * LANES + lane]);
            positions_m[node.index()] = rest_m[node.index()] + u_m;
        }
    }
}
