//! Entries of the inverse of the factored matrix between a few nodes, kept from step to step.
//!
//! With P A P^T = L L^T and w_i = L^-1 P e_i for the three components of node i,
//!
//! (A^-1)_ij = w_i . w_j, and e_i . A^-1 b = w_i . (L^-1 P b).
//!
//! w_i is zero but for the columns on the path from its own in the elimination tree to the root (J. W. H. Liu 1990, The role
//! of elimination trees in sparse factorization, doi 10.1137/0611010): less than a tenth of solutions with L and L^T. Paths
//! that have met have the same rest.
//!
//! What is kept is valid for one factor. A number does not depend on when it was computed, nor with which others, nor on the
//! path of the kernel: what is kept here is no part of the state, and steps have the same bits whatever it holds.

use crate::model::LocalModel;
use crate::model::kernel::{KernelPath, LaneBlock, LaneBlockWork};
use crate::solve::{Factorization, FreeSystem, Supernode};
use glisson_mesh::math::{DMat3, fused};
use glisson_mesh::mesh::NodeId;
use std::sync::Arc;

/// Nodes that are kept: those of the largest patch and some that may be touched again soon. A choice.
const N_KEPT: usize = LocalModel::MOST_NODES + 32;
const NONE: u32 = u32::MAX;
const N_LANES: usize = 8;

/// Three components of eight rows.
type Chunk = [[f64; N_LANES]; 3];
const ZEROS: Chunk = [[0.0; N_LANES]; 3];

/// The elimination tree of the supernodes, and where rows lie on a path: from the root down, each supernode's in whole chunks,
/// so that a path begins with the same chunks as every other that comes to the same supernode.
struct Paths {
    parent: Vec<u32>,
    /// First chunk of each supernode on the paths through it.
    first_chunk: Vec<u32>,
    /// Supernode of each row, and its place on paths: chunk times eight plus lane.
    supernode: Vec<u32>,
    place: Vec<u32>,
    /// Chunks of the longest path.
    most_chunks: usize,
}

impl Paths {
    fn of(factor: &Factorization) -> Self {
        let (n, n_rows) = (factor.n_supernodes(), factor.n_rows());
        let mut paths = Self {
            parent: vec![NONE; n],
            first_chunk: vec![0; n],
            supernode: vec![0; n_rows],
            place: vec![0; n_rows],
            most_chunks: 0,
        };
        for s in 0..n {
            let Supernode { start, size, .. } = factor.supernode(s);
            paths.supernode[start..start + size].fill(s as u32);
        }
        // Parents come after their children.
        for s in (0..n).rev() {
            let Supernode { start, size, rows_below, .. } = factor.supernode(s);
            let mut first = 0;
            if let Some(row) = rows_below.first() {
                let parent = paths.supernode[*row as usize];
                paths.parent[s] = parent;
                first = paths.end_chunk(factor, parent as usize);
            }
            paths.first_chunk[s] = first as u32;
            for k in 0..size {
                paths.place[start + k] = (first * N_LANES + k) as u32;
            }
            paths.most_chunks = paths.most_chunks.max(first + size.div_ceil(N_LANES));
        }
        paths
    }

    /// Chunks of a path down to a supernode, its own included.
    fn end_chunk(&self, factor: &Factorization, s: usize) -> usize {
        self.first_chunk[s] as usize + factor.supernode(s).size.div_ceil(N_LANES)
    }

    /// Chunks that the paths from two supernodes have in common.
    fn common_chunks(&self, factor: &Factorization, mut a: u32, mut b: u32) -> usize {
        while a != b {
            // The later one may be above the other; no supernode is later than none.
            let lower = if a < b { &mut a } else { &mut b };
            *lower = self.parent[*lower as usize];
        }
        if a == NONE { 0 } else { self.end_chunk(factor, a as usize) }
    }
}

/// What is kept of one node.
#[derive(Clone, Copy)]
struct Kept {
    node: u32,
    /// The lowest supernode of its path.
    bottom: u32,
    /// Patches asked for before the last one with it.
    last_use: u64,
}

const EMPTY: Kept = Kept { node: NONE, bottom: NONE, last_use: 0 };

/// Inverse entries of nodes that were asked for. A copy has the same room, and nothing in it.
pub(super) struct PatchInverse {
    paths: Arc<Paths>,
    kept: Vec<Kept>,
    /// Place in `kept` of each node.
    slot_of: Vec<u32>,
    /// w of each place, path by path.
    columns: Vec<Chunk>,
    /// Entries between places, see [`pair_of`], and whether they are known.
    pairs: Vec<([f64; 9], bool)>,
    n_patches: u64,
}

impl PatchInverse {
    pub(super) fn new(factor: &Factorization, n_nodes: usize) -> Self {
        Self::empty(Arc::new(Paths::of(factor)), n_nodes)
    }

    fn empty(paths: Arc<Paths>, n_nodes: usize) -> Self {
        let n_kept = N_KEPT.min(n_nodes);
        Self {
            columns: vec![ZEROS; n_kept * paths.most_chunks],
            paths,
            kept: vec![EMPTY; n_kept],
            slot_of: vec![NONE; n_nodes],
            pairs: vec![([0.0; 9], false); n_kept * (n_kept + 1) / 2],
            n_patches: 0,
        }
    }

    /// Forgets everything: the factor has changed.
    pub(super) fn forget(&mut self) {
        for kept in &mut self.kept {
            if kept.node != NONE {
                self.slot_of[kept.node as usize] = NONE;
                *kept = EMPTY;
            }
        }
    }

    /// Counts the path of a node to the root in, supernode by supernode.
    pub(super) fn add_path(
        &self,
        node: NodeId,
        (system, factor): (&FreeSystem, &Factorization),
        counts: &mut [bool],
    ) {
        for axis in 0..3 {
            let Some(row) = system.row_of(node, axis) else { continue };
            let mut s = self.paths.supernode[factor.place_of_row(row)];
            while s != NONE && !std::mem::replace(&mut counts[s as usize], true) {
                s = self.paths.parent[s as usize];
            }
        }
    }

    /// Makes sure of the columns of all nodes of a patch, which has no more than [`LocalModel::MOST_NODES`].
    pub(super) fn hold(&mut self, nodes: &[NodeId], with: &Factored<'_>) {
        self.n_patches += 1;
        for node in nodes {
            if let Some(kept) = self.kept.get_mut(self.slot_of[node.index()] as usize) {
                kept.last_use = self.n_patches;
            }
        }
        for &node in nodes {
            if self.slot_of[node.index()] == NONE {
                let oldest = (0..self.kept.len()).min_by_key(|slot| self.kept[*slot].last_use);
                let Some(slot) = oldest else { return };
                self.replace(slot, node, with);
            }
        }
    }

    /// Puts a node in the place of another.
    fn replace(&mut self, slot: usize, node: NodeId, with: &Factored<'_>) {
        let before = self.kept[slot].node;
        if before != NONE {
            self.slot_of[before as usize] = NONE;
        }
        for other in 0..self.kept.len() {
            self.pairs[pair_of(slot, other)].1 = false;
        }
        let n_chunks = self.paths.most_chunks;
        let column = &mut self.columns[slot * n_chunks..][..n_chunks];
        let rows = [0, 1, 2].map(|axis| with.system.row_of(node, axis));
        let rows = rows.map(|row| row.map(|row| with.factor.place_of_row(row)));
        let bottom = rows.iter().flatten().min().map_or(NONE, |row| self.paths.supernode[*row]);
        let work = PathSolution { paths: &self.paths, factor: with.factor, rows, bottom, column };
        with.path.run_by_eight(work);
        self.kept[slot] = Kept { node: node.0, bottom, last_use: self.n_patches };
        self.slot_of[node.index()] = slot as u32;
    }

    /// (A^-1)_ij of two nodes of the last patch.
    pub(super) fn tensor(&mut self, of: NodeId, by: NodeId, with: &Factored<'_>) -> DMat3 {
        let [i, j] = [of, by].map(|node| self.slot_of[node.index()] as usize);
        let [low, high] = [i.min(j), i.max(j)];
        let pair = pair_of(low, high);
        if !self.pairs[pair].1 {
            let n_chunks = self.paths.most_chunks;
            let [a, b] = [low, high].map(|slot| self.kept[slot].bottom);
            let common = self.paths.common_chunks(with.factor, a, b);
            let [a, b] = [low, high].map(|slot| &self.columns[slot * n_chunks..][..common]);
            self.pairs[pair] = (with.path.run_by_eight(Contraction { a, b }), true);
        }
        let tensor = DMat3::from_cols_array(&self.pairs[pair].0);
        // Columns are those of the lower place.
        if j == low { tensor } else { tensor.transpose() }
    }

    /// w_i . y for a node of the last patch, with y = L^-1 P b.
    pub(super) fn product(&self, of: NodeId, y: &[f64], with: &Factored<'_>) -> [f64; 3] {
        let slot = self.slot_of[of.index()] as usize;
        let n_chunks = self.paths.most_chunks;
        let column = &self.columns[slot * n_chunks..][..n_chunks];
        let (paths, factor, bottom) = (&*self.paths, with.factor, self.kept[slot].bottom);
        with.path.run_by_eight(Product { paths, factor, bottom, column, y })
    }
}

impl Clone for PatchInverse {
    fn clone(&self) -> Self {
        Self::empty(Arc::clone(&self.paths), self.slot_of.len())
    }
}

/// The place of a pair in a triangle of pairs.
fn pair_of(a: usize, b: usize) -> usize {
    let (low, high) = (a.min(b), a.max(b));
    high * (high + 1) / 2 + low
}

/// The factor and what belongs to it.
pub(super) struct Factored<'a> {
    pub(super) factor: &'a Factorization,
    pub(super) system: &'a FreeSystem,
    pub(super) path: KernelPath,
}

/// Overwrites `column` with w of a node with these rows, in the order of elimination.
struct PathSolution<'a> {
    paths: &'a Paths,
    factor: &'a Factorization,
    rows: [Option<usize>; 3],
    bottom: u32,
    column: &'a mut [Chunk],
}

impl LaneBlockWork for PathSolution<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: LaneBlock>(self, zero: V) {
        let Self { paths, factor, rows, bottom, column } = self;
        column.fill(ZEROS);
        for (axis, row) in rows.into_iter().enumerate() {
            if let Some(row) = row {
                let place = paths.place[row] as usize;
                column[place / N_LANES][axis][place % N_LANES] = 1.0;
            }
        }
        let mut s = bottom;
        while s != NONE {
            let supernode = factor.supernode(s as usize);
            let n_before = paths.first_chunk[s as usize] as usize;
            let (above, own) = column.split_at_mut(n_before);
            let own = &mut own[..supernode.size.div_ceil(N_LANES)];
            solve_triangle(zero, &supernode, own);
            let place_of = |row: u32| paths.place[row as usize] as usize;
            subtract_below(zero, &supernode, own, above, place_of);
            s = paths.parent[s as usize];
        }
    }
}

/// Eight numbers from a place on; zeros beyond the end.
#[inline(always)]
fn eight_at<V: LaneBlock>(zero: V, values: &[f64], at: usize) -> V {
    match values.get(at..at + N_LANES) {
        Some(eight) => zero.load(eight.try_into().expect("eight of them")),
        None => {
            let mut eight = [0.0; N_LANES];
            let left = values.get(at..).unwrap_or_default();
            eight[..left.len()].copy_from_slice(left);
            zero.load(&eight)
        }
    }
}

/// x of one row, in every lane.
#[inline(always)]
fn row_of<V: LaneBlock>(zero: V, own: &[Chunk], c: usize) -> [V; 3] {
    let chunk = &own[c / N_LANES];
    [0, 1, 2].map(|a| zero.constant(chunk[a][c % N_LANES]))
}

/// Solves with the triangle of a supernode, eight rows after the other.
#[inline(always)]
fn solve_triangle<V: LaneBlock>(zero: V, supernode: &Supernode<'_>, own: &mut [Chunk]) {
    let Supernode { size, rows_below, values, .. } = *supernode;
    let n_rows = size + rows_below.len();
    for k in 0..own.len() {
        let first = N_LANES * k;
        let n = N_LANES.min(size - first);
        let mut sums = [zero; 3];
        for c in 0..first {
            // Lanes beyond the triangle hold what does not count.
            let l = eight_at(zero, values, c * n_rows + first);
            let x = row_of(zero, own, c);
            (0..3).for_each(|a| sums[a] = l.fused(x[a], sums[a]));
        }
        let mut of_others = ZEROS;
        (0..3).for_each(|a| sums[a].store(&mut of_others[a]));
        for a in 0..3 {
            let x = &mut own[k][a];
            for i in 0..n {
                x[i] -= of_others[a][i];
            }
            for i in 0..n {
                let column = &values[(first + i) * n_rows + first..][..n];
                x[i] /= column[i];
                for below in i + 1..n {
                    x[below] = fused(-column[below], x[i], x[below]);
                }
            }
        }
    }
}

/// Takes what a supernode's rows contribute from the rows below it, sixteen at a time.
#[inline(always)]
fn subtract_below<V: LaneBlock>(
    zero: V,
    supernode: &Supernode<'_>,
    own: &[Chunk],
    above: &mut [Chunk],
    place_of: impl Fn(u32) -> usize,
) {
    let Supernode { size, rows_below, values, .. } = *supernode;
    let n_rows = size + rows_below.len();
    for (k, rows) in rows_below.chunks(2 * N_LANES).enumerate() {
        let mut sums = [[zero; 3]; 2];
        for c in 0..size {
            let at = c * n_rows + size + 2 * N_LANES * k;
            // Lanes beyond the rows hold what does not count, and so does the second half of a single one.
            let l = [eight_at(zero, values, at), eight_at(zero, values, at + N_LANES)];
            let x = row_of(zero, own, c);
            for (sums, l) in sums.iter_mut().zip(l) {
                (0..3).for_each(|a| sums[a] = l.fused(x[a], sums[a]));
            }
        }
        for (rows, sums) in rows.chunks(N_LANES).zip(sums) {
            let mut change = ZEROS;
            (0..3).for_each(|a| sums[a].store(&mut change[a]));
            for (lane, row) in rows.iter().enumerate() {
                let place = place_of(*row);
                let chunk = &mut above[place / N_LANES];
                (0..3).for_each(|a| chunk[a][place % N_LANES] -= change[a][lane]);
            }
        }
    }
}

/// A column times y, which holds all rows in the order of elimination.
struct Product<'a> {
    paths: &'a Paths,
    factor: &'a Factorization,
    bottom: u32,
    column: &'a [Chunk],
    y: &'a [f64],
}

impl LaneBlockWork for Product<'_> {
    type Output = [f64; 3];

    #[inline(always)]
    fn run<V: LaneBlock>(self, zero: V) -> [f64; 3] {
        let Self { paths, factor, bottom, column, y } = self;
        let mut sums = [zero; 3];
        let mut s = bottom;
        while s != NONE {
            let Supernode { start, size, .. } = factor.supernode(s as usize);
            let own = &column[paths.first_chunk[s as usize] as usize..][..size.div_ceil(N_LANES)];
            for (k, chunk) in own.iter().enumerate() {
                // Lanes beyond the supernode are zero in the column.
                let y = eight_at(zero, y, start + N_LANES * k);
                (0..3).for_each(|a| sums[a] = y.fused(zero.load(&chunk[a]), sums[a]));
            }
            s = paths.parent[s as usize];
        }
        sums.map(LaneBlock::sum)
    }
}

/// Contraction of two columns over their chunks: entry 3 a + b for component a of the first and b of the second.
struct Contraction<'a> {
    a: &'a [Chunk],
    b: &'a [Chunk],
}

impl LaneBlockWork for Contraction<'_> {
    type Output = [f64; 9];

    #[inline(always)]
    fn run<V: LaneBlock>(self, zero: V) -> [f64; 9] {
        let mut sums = [zero; 9];
        for (a, b) in self.a.iter().zip(self.b) {
            let [a, b] = [a, b].map(|chunk| [0, 1, 2].map(|axis| zero.load(&chunk[axis])));
            for (i, a) in a.into_iter().enumerate() {
                for (j, b) in b.iter().enumerate() {
                    sums[3 * i + j] = a.fused(*b, sums[3 * i + j]);
                }
            }
        }
        sums.map(LaneBlock::sum)
    }
}
