//! Inside and outside of triangles that are not closed, on a grid: where the winding number is above one half.
//!
//! Nodes near the triangles are all asked. Away from them the winding number is harmonic, hence smooth: a
//! block of cells without triangles whose corners agree clearly is filled, others are divided.

use rayon::prelude::*;

use super::report::RepairError;
use crate::surface::error::Place;
use crate::surface::signed_distance::SignedDistance;
use crate::surface::winding::WindingTree;

/// Edge of the largest blocks [cells], a power of two.
const LARGEST_BLOCK: usize = 16;
/// Corners agree clearly when all are this far from one half, on the same side.
const CLEARLY: f64 = 0.2;
/// Above one half by less is rounding: a sheet's winding number is one half on the sheet itself.
const ROUNDING: f64 = 1e-9;
/// A triangle within a cell is no farther from one of the cell's nodes [cells]: sqrt(3) / 2, rounded up.
const CELL_REACH: f64 = 0.87;

/// Inside and outside at the nodes of a grid.
pub(super) struct Field {
    /// Distances [m] without sign, infinite beyond the band.
    pub(super) band: SignedDistance,
    /// Winding number of each node; within a filled block one value that stands for all.
    pub(super) winding: Vec<f64>,
    /// Whether each node is inside; none at the grid's border is.
    pub(super) inside: Vec<bool>,
    /// Nodes inside, before anything is mended.
    pub(super) n_inside: usize,
}

impl Field {
    /// Asks `tree` at the nodes of `band`, which holds the distances to the same triangles.
    ///
    /// # Errors
    /// [`RepairError::NoInside`].
    pub(super) fn of(tree: &WindingTree<'_>, band: SignedDistance) -> Result<Self, RepairError> {
        let winding = winding_numbers(tree, &band);
        let [nx, ny, nz] = band.dims();
        let is_border = |at: usize| {
            let [i, j, k] = band.node(at);
            i == 0 || j == 0 || k == 0 || i + 1 == nx || j + 1 == ny || k + 1 == nz
        };
        let inside: Vec<bool> =
            (0..winding.len()).map(|at| winding[at] > 0.5 + ROUNDING && !is_border(at)).collect();
        let n_inside = inside.iter().filter(|&&i| i).count();
        if n_inside == 0 {
            let most = (0..winding.len()).max_by(|&a, &b| winding[a].total_cmp(&winding[b]));
            let at = most.expect("a grid has nodes");
            return Err(RepairError::NoInside {
                largest: winding[at],
                place: Place(band.node_position_m(band.node(at))),
                spacing_mm: 1e3 * band.spacing_m(),
            });
        }
        Ok(Self { band, winding, inside, n_inside })
    }
}

/// A block of cells by its smallest node.
type Block = [usize; 3];

fn winding_numbers(tree: &WindingTree<'_>, band: &SignedDistance) -> Vec<f64> {
    let dims = band.dims();
    let index = |[i, j, k]: [usize; 3]| i + dims[0] * (j + dims[1] * k);
    let mut winding = vec![f64::NAN; dims.iter().product()];
    let mut filled: Vec<(Block, usize, f64)> = Vec::new();
    let starts = |axis: usize| (0..dims[axis] - 1).step_by(LARGEST_BLOCK);
    let mut blocks: Vec<Block> =
        starts(2).flat_map(|k| starts(1).flat_map(move |j| starts(0).map(move |i| [i, j, k]))).collect();
    let mut size = LARGEST_BLOCK;
    loop {
        let corners = |block: Block| {
            std::array::from_fn::<usize, 8, _>(|c| {
                index([0, 1, 2].map(|axis| (block[axis] + (c >> axis & 1) * size).min(dims[axis] - 1)))
            })
        };
        let mut wanted: Vec<usize> =
            blocks.iter().flat_map(|&b| corners(b)).filter(|&node| winding[node].is_nan()).collect();
        wanted.sort_unstable();
        wanted.dedup();
        let answers: Vec<f64> =
            wanted.par_iter().map(|&at| tree.winding_number(band.node_position_m(band.node(at)))).collect();
        for (&node, &answer) in wanted.iter().zip(&answers) {
            winding[node] = answer;
        }
        if size == 1 {
            break;
        }
        let mut divided = Vec::new();
        for &block in &blocks {
            let values = corners(block).map(|node| winding[node]);
            let agree = values.iter().all(|w| w - 0.5 > CLEARLY) || values.iter().all(|w| 0.5 - w > CLEARLY);
            if agree && !holds_triangles(band, block, size) {
                filled.push((block, size, values.iter().sum::<f64>() / 8.0));
                continue;
            }
            let half = size / 2;
            let parts = (0..8).map(|c| [0, 1, 2].map(|axis| block[axis] + (c >> axis & 1) * half));
            divided.extend(parts.filter(|part| (0..3).all(|axis| part[axis] + 1 < dims[axis])));
        }
        blocks = divided;
        size /= 2;
    }
    for (block, size, value) in filled {
        for_each_node(dims, block, size, |row| {
            for node in row {
                if winding[node].is_nan() {
                    winding[node] = value;
                }
            }
        });
    }
    winding
}

/// Calls `see` with each row of the nodes of a block, its border included.
fn for_each_node(
    dims: [usize; 3],
    block: Block,
    size: usize,
    mut see: impl FnMut(std::ops::RangeInclusive<usize>),
) {
    let last = [0, 1, 2].map(|axis| (block[axis] + size).min(dims[axis] - 1));
    for k in block[2]..=last[2] {
        for j in block[1]..=last[1] {
            let row = dims[0] * (j + dims[1] * k);
            see(row + block[0]..=row + last[0]);
        }
    }
}

fn holds_triangles(band: &SignedDistance, block: Block, size: usize) -> bool {
    let reach_m = CELL_REACH * band.spacing_m();
    let mut found = false;
    for_each_node(band.dims(), block, size, |row| {
        found = found || band.values_m()[row].iter().any(|&d| d <= reach_m);
    });
    found
}
