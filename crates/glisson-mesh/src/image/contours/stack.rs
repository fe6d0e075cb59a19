//! From binary slices to a binary volume that is smooth between slices too.

use super::params::ContourParams;
use crate::image::VoxelGrid;
use crate::image::filter::{self, Connectivity};
use crate::image::resample::VoxelBox;
use crate::image::segment::steps::{fill_vessels, smoothed};
use crate::image::topology::{TopologyError, TopologyRepair, repair_to_ball};

/// The stack of slices `drawn` after closing (which adds only what `is_soft`), opening and closing by a small
/// ball; its cavities are filled, its largest piece is taken and made one ball. Slices of `is_given` enter the
/// last three steps as they were drawn. `None` when nothing is left.
pub(super) fn stacked(
    grid: &VoxelGrid,
    drawn: &[bool],
    is_given: &[bool],
    is_soft: impl Fn(usize) -> bool,
    params: &ContourParams,
) -> Result<Option<(Vec<bool>, TopologyRepair)>, TopologyError> {
    let margin_m = 2.0 * params.close_radius_m.max(params.smooth_radius_m);
    let Some(part) = VoxelBox::around(grid, drawn, margin_m) else { return Ok(None) };
    let near = part.grid(grid);
    let drawn = part.cut(grid, drawn);
    let is_soft: Vec<bool> = (0..drawn.len()).map(|v| is_soft(part.index_in(grid, v))).collect();
    let mut mask = drawn.clone();
    fill_vessels(&near, &mut mask, &is_soft, params.close_radius_m);
    let mut mask = smoothed(&near, &mask, &is_soft, params.smooth_radius_m);
    let n_slice = near.dims[0] * near.dims[1];
    for k in (0..near.dims[2]).filter(|&k| is_given[k + part.first[2]]) {
        mask[k * n_slice..][..n_slice].copy_from_slice(&drawn[k * n_slice..][..n_slice]);
    }
    filter::fill_cavities(&near, &mut mask);
    let mut mask = filter::largest_piece(&near, &mask, Connectivity::Faces);
    if !mask.contains(&true) {
        return Ok(None);
    }
    let repair = repair_to_ball(&near, &mut mask)?;
    let mut whole = vec![false; grid.n_voxels()];
    part.paste(grid, &mask, &mut whole);
    Ok(Some((whole, repair)))
}
