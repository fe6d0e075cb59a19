//! Where the liver is, when nobody says so.

use super::error::SegmentError;
use super::statistics::{FAT_HU, most_frequent};
use crate::image::VoxelGrid;
use crate::image::filter;
use crate::image::resample::steps_for;
use crate::math::DVec3;

/// CT numbers a contrast-enhanced parenchyma can have, for the automatic seed [HU].
const PARENCHYMA_HU: [f32; 2] = [40.0, 200.0];

/// How far typical parenchyma may be from its most frequent level [HU].
const TYPICAL_HU: f32 = 15.0;

/// A point deep inside the liver [m]: on the patient's right, at the level that is most frequent deep inside
/// parenchyma there, the one farthest from everything that has another level.
///
/// `smooth` are CT numbers [HU] with little noise.
///
/// # Errors
/// [`SegmentError::NoSeed`] when no parenchyma is thick enough.
pub fn guess_seed(grid: &VoxelGrid, smooth: &[f32]) -> Result<DVec3, SegmentError> {
    const COARSE_M: f64 = 4.5e-3;
    const LEAST_DEPTH_M: f64 = 15e-3;
    let no_seed = || SegmentError::NoSeed { depth_mm: LEAST_DEPTH_M * 1e3 };
    let step = steps_for(grid, COARSE_M);
    let coarse = VoxelGrid {
        dims: [0, 1, 2].map(|a| grid.dims[a].div_ceil(step[a])),
        spacing_m: grid.spacing_m * DVec3::from_array(step.map(|s| s as f64)),
        ..grid.clone()
    };
    let at = |index: usize| {
        let [i, j, k] = coarse.voxel(index);
        smooth[grid.index([i * step[0], j * step[1], k * step[2]])]
    };
    let body: Vec<usize> = (0..coarse.n_voxels()).filter(|&i| at(i) > FAT_HU[0]).collect();
    let center_x_m = body.iter().map(|&i| coarse.center_m(i).x).sum::<f64>() / body.len().max(1) as f64;
    let elsewhere: Vec<bool> = (0..coarse.n_voxels())
        .map(|i| !(PARENCHYMA_HU[0]..=PARENCHYMA_HU[1]).contains(&at(i)) || coarse.center_m(i).x > center_x_m)
        .collect();
    let depth2 = filter::distance_squared_m2(&coarse, &elsewhere);
    let least2 = (LEAST_DEPTH_M * LEAST_DEPTH_M) as f32;
    let deep: Vec<usize> =
        (0..depth2.len()).filter(|&i| depth2[i] >= least2 && depth2[i].is_finite()).collect();
    let level = most_frequent(deep.iter().map(|&i| at(i)), PARENCHYMA_HU, 4.0).ok_or_else(no_seed)?;
    // Vessels and lesions are no typical parenchyma: the seed keeps away from them too.
    let atypical: Vec<bool> =
        (0..coarse.n_voxels()).map(|i| elsewhere[i] || (at(i) - level).abs() > TYPICAL_HU).collect();
    let depth2 = filter::distance_squared_m2(&coarse, &atypical);
    let best = deep.into_iter().filter(|&i| !atypical[i]).fold(None, |best: Option<usize>, i| match best {
        Some(b) if depth2[b] >= depth2[i] => Some(b),
        _ => Some(i),
    });
    best.map(|index| coarse.center_m(index)).ok_or_else(no_seed)
}
