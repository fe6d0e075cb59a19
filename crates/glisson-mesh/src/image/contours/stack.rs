//! From binary slices to a binary volume that is smooth between slices too.

use super::params::ContourParams;
use crate::image::VoxelGrid;
use crate::image::filter::{self, Connectivity};

/// The stack of slices `drawn` after closing (which adds only what `is_soft`), opening and closing by a small ball; its cavities
/// are filled and its largest piece is taken. Slices of `is_given` stay as they were drawn.
pub(super) fn stacked(
    grid: &VoxelGrid,
    drawn: &[bool],
    is_given: &[bool],
    is_soft: impl Fn(usize) -> bool,
    params: &ContourParams,
) -> Vec<bool> {
    let closed = filter::close(grid, drawn, params.close_radius_m);
    let mut mask: Vec<bool> = (0..drawn.len()).map(|v| drawn[v] || (closed[v] && is_soft(v))).collect();
    filter::fill_cavities(grid, &mut mask);
    let opened = filter::open(grid, &mask, params.smooth_radius_m);
    let smooth = filter::close(grid, &opened, params.smooth_radius_m);
    let mut mask: Vec<bool> = (0..mask.len()).map(|v| smooth[v] && (mask[v] || is_soft(v))).collect();
    let n_slice = grid.dims[0] * grid.dims[1];
    for k in (0..grid.dims[2]).filter(|&k| is_given[k]) {
        mask[k * n_slice..][..n_slice].copy_from_slice(&drawn[k * n_slice..][..n_slice]);
    }
    filter::fill_cavities(grid, &mut mask);
    filter::largest_piece(grid, &mask, Connectivity::Faces)
}
