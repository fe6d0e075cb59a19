//! The box around a set of voxels: work on a small organ in a large image costs what the organ costs.

use crate::image::VoxelGrid;
use crate::math::DVec3;

/// A box of voxels cut out of a grid.
#[derive(Clone, Debug)]
pub(super) struct Crop {
    /// First voxel of the box.
    low: [usize; 3],
    /// Dimensions of the grid it is cut out of.
    full: [usize; 3],
    /// The grid of the box.
    pub(super) grid: VoxelGrid,
}

impl Crop {
    /// The box around `mask` with a margin; `None` for an empty mask.
    pub(super) fn around(grid: &VoxelGrid, mask: &[bool], margin_m: f64) -> Option<Self> {
        let (mut low, mut high) = ([usize::MAX; 3], [0; 3]);
        for (row, line) in mask.chunks(grid.dims[0].max(1)).enumerate() {
            let Some(first) = line.iter().position(|&m| m) else { continue };
            let last = line.iter().rposition(|&m| m).unwrap_or(first);
            let [j, k] = [row % grid.dims[1], row / grid.dims[1]];
            for (axis, [a, b]) in [[first, last], [j, j], [k, k]].into_iter().enumerate() {
                low[axis] = low[axis].min(a);
                high[axis] = high[axis].max(b + 1);
            }
        }
        if low[0] == usize::MAX {
            return None;
        }
        for axis in 0..3 {
            let margin = (margin_m / grid.spacing_m[axis]).ceil() as usize + 1;
            low[axis] = low[axis].saturating_sub(margin);
            high[axis] = (high[axis] + margin).min(grid.dims[axis]);
        }
        let cropped = VoxelGrid {
            dims: [0, 1, 2].map(|a| high[a] - low[a]),
            origin_m: grid.position_m(DVec3::from_array(low.map(|x| x as f64))),
            ..grid.clone()
        };
        Some(Self { low, full: grid.dims, grid: cropped })
    }

    /// Place in the full grid of the first voxel of a row of the box.
    fn row_start(&self, row: usize) -> usize {
        let [j, k] = [row % self.grid.dims[1] + self.low[1], row / self.grid.dims[1] + self.low[2]];
        self.low[0] + self.full[0] * (j + self.full[1] * k)
    }

    /// Place in the full grid of a place in the box.
    pub(super) fn full_index(&self, index: usize) -> usize {
        self.row_start(index / self.grid.dims[0]) + index % self.grid.dims[0]
    }

    /// First voxel of the box.
    pub(super) fn low(&self) -> [usize; 3] {
        self.low
    }

    /// The values in the box.
    pub(super) fn cut<T: Copy>(&self, values: &[T]) -> Vec<T> {
        let n_i = self.grid.dims[0];
        let n_rows = self.grid.dims[1] * self.grid.dims[2];
        (0..n_rows).flat_map(|row| values[self.row_start(row)..][..n_i].iter().copied()).collect()
    }

    /// A mask of the full grid that is `inside` in the box and false elsewhere.
    pub(super) fn paste(&self, inside: &[bool]) -> Vec<bool> {
        let mut mask = vec![false; self.full.iter().product()];
        for (row, line) in inside.chunks(self.grid.dims[0].max(1)).enumerate() {
            mask[self.row_start(row)..][..line.len()].copy_from_slice(line);
        }
        mask
    }
}
