//! Parts of a volume, coarser copies of it, and values between voxels.

use rayon::prelude::*;

use super::{Volume, VoxelGrid};
use crate::math::DVec3;

/// A box of voxels: the first one, and how many along i, j, k.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VoxelBox {
    /// The voxel with the smallest indices.
    pub first: [usize; 3],
    /// Number of voxels along i, j, k.
    pub dims: [usize; 3],
}

impl VoxelBox {
    /// All of a grid.
    pub fn whole(grid: &VoxelGrid) -> Self {
        Self { first: [0; 3], dims: grid.dims }
    }

    /// The voxels around a ball, at least one layer more than it reaches and as far as the grid goes. The ball's centre
    /// lies on the grid.
    pub fn around_ball(grid: &VoxelGrid, center_m: DVec3, radius_m: f64) -> Self {
        let center = grid.voxel_at(center_m);
        let reach = [0, 1, 2].map(|a| radius_m / grid.spacing_m[a] + 1.0);
        let first = [0, 1, 2].map(|a| (center[a] - reach[a]).max(0.0) as usize);
        let end = [0, 1, 2].map(|a| grid.dims[a].min((center[a] + reach[a]).ceil() as usize + 1));
        Self { first, dims: [0, 1, 2].map(|a| end[a] - first[a]) }
    }

    /// The smallest box around the voxels of `mask`, grown by `margin_m` [m] as far as the grid goes; `None`
    /// for an empty mask.
    pub fn around(grid: &VoxelGrid, mask: &[bool], margin_m: f64) -> Option<Self> {
        let (mut low, mut high) = ([usize::MAX; 3], [0; 3]);
        for (row, line) in mask.chunks(grid.dims[0].max(1)).enumerate() {
            let Some(begin) = line.iter().position(|&m| m) else { continue };
            let end = line.iter().rposition(|&m| m).unwrap_or(begin);
            for (axis, (from, to)) in [
                (begin, end),
                (row % grid.dims[1], row % grid.dims[1]),
                (row / grid.dims[1], row / grid.dims[1]),
            ]
            .into_iter()
            .enumerate()
            {
                low[axis] = low[axis].min(from);
                high[axis] = high[axis].max(to);
            }
        }
        if low[0] == usize::MAX {
            return None;
        }
        let margin = [0, 1, 2].map(|a| (margin_m / grid.spacing_m[a]).ceil() as usize);
        let first = [0, 1, 2].map(|a| low[a].saturating_sub(margin[a]));
        let dims = [0, 1, 2].map(|a| (high[a] + 1 + margin[a]).min(grid.dims[a]) - first[a]);
        Some(Self { first, dims })
    }

    /// The grid of the box alone.
    pub fn grid(&self, of: &VoxelGrid) -> VoxelGrid {
        let origin_m = of.position_m(DVec3::from_array(self.first.map(|v| v as f64)));
        VoxelGrid { dims: self.dims, origin_m, ..of.clone() }
    }

    /// The values inside the box.
    pub fn cut<T: Copy>(&self, grid: &VoxelGrid, values: &[T]) -> Vec<T> {
        let mut inside = Vec::with_capacity(self.dims.iter().product());
        self.for_each_row(grid, |start| inside.extend_from_slice(&values[start..][..self.dims[0]]));
        inside
    }

    /// Writes values of the box into those of the whole grid.
    pub fn paste<T: Copy>(&self, grid: &VoxelGrid, inside: &[T], values: &mut [T]) {
        let mut rows = inside.chunks(self.dims[0].max(1));
        self.for_each_row(grid, |start| {
            if let Some(row) = rows.next() {
                values[start..][..row.len()].copy_from_slice(row);
            }
        });
    }

    /// Place in the whole grid of a voxel of the box, given by its place in the box.
    pub fn index_in(&self, grid: &VoxelGrid, index: usize) -> usize {
        let [n_i, n_j, _] = self.dims;
        let (row, i) = (index / n_i, index % n_i);
        grid.index([self.first[0] + i, self.first[1] + row % n_j, self.first[2] + row / n_j])
    }

    /// Calls `visit` with the place of the first voxel of each row of the box.
    fn for_each_row(&self, grid: &VoxelGrid, mut visit: impl FnMut(usize)) {
        for k in 0..self.dims[2] {
            for j in 0..self.dims[1] {
                visit(grid.index([self.first[0], self.first[1] + j, self.first[2] + k]));
            }
        }
    }
}

/// How many voxels along each axis make up about `voxel_m` [m], at least one.
pub fn steps_for(grid: &VoxelGrid, voxel_m: f64) -> [usize; 3] {
    [0, 1, 2].map(|a| ((voxel_m / grid.spacing_m[a]).round() as usize).max(1))
}

/// The image in coarser voxels, each the mean of a block of `step` voxels; blocks at the far sides may be
/// smaller, and their mean stands where that of a whole block would.
pub fn block_means(image: &Volume<f32>, step: [usize; 3]) -> Volume<f32> {
    let fine = &image.grid;
    let dims = [0, 1, 2].map(|a| fine.dims[a].div_ceil(step[a]));
    let middle = DVec3::from_array(step.map(|s| 0.5 * (s as f64 - 1.0)));
    let grid = VoxelGrid {
        dims,
        spacing_m: fine.spacing_m * DVec3::from_array(step.map(|s| s as f64)),
        origin_m: fine.position_m(middle),
        axes: fine.axes,
    };
    let mut values = vec![0.0f32; grid.n_voxels()];
    values.par_chunks_mut(dims[0].max(1)).enumerate().for_each(|(row, means)| {
        let (j, k) = (row % dims[1], row / dims[1]);
        let block = |at: usize, axis: usize| at * step[axis]..((at + 1) * step[axis]).min(fine.dims[axis]);
        let n_rows = block(j, 1).len() * block(k, 2).len();
        for fine_k in block(k, 2) {
            for fine_j in block(j, 1) {
                let line = &image.values[fine.index([0, fine_j, fine_k])..][..fine.dims[0]];
                for (mean, part) in means.iter_mut().zip(line.chunks(step[0])) {
                    *mean += part.iter().sum::<f32>() / (part.len() * n_rows) as f32;
                }
            }
        }
    });
    Volume { grid, values }
}

impl Volume<f32> {
    /// Value at a point [m], LPS: linear between voxel centres, that of the border outside.
    pub fn value_at(&self, point_m: DVec3) -> f64 {
        let grid = &self.grid;
        let voxel = grid.voxel_at(point_m);
        let (mut low, mut high, mut share) = ([0; 3], [0; 3], [0.0; 3]);
        for axis in 0..3 {
            let last = grid.dims[axis].saturating_sub(1);
            let place = voxel[axis].clamp(0.0, last as f64);
            low[axis] = (place as usize).min(last);
            high[axis] = (low[axis] + 1).min(last);
            share[axis] = place - low[axis] as f64;
        }
        let between = |a: f64, b: f64, share: f64| a + share * (b - a);
        let along_i = |j: usize, k: usize| {
            let row = grid.index([0, j, k]);
            let at = |i: usize| f64::from(self.values[row + i]);
            between(at(low[0]), at(high[0]), share[0])
        };
        let along_j = |k: usize| between(along_i(low[1], k), along_i(high[1], k), share[1]);
        between(along_j(low[2]), along_j(high[2]), share[2])
    }
}
