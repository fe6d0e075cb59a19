//! Grids and damaged files that tests of images share.

use glisson_mesh::image::VoxelGrid;
use glisson_mesh::math::{DMat3, DVec3};
use proptest::sample::Index;

pub(super) fn plain_grid(dims: [usize; 3], spacing_mm: [f64; 3]) -> VoxelGrid {
    VoxelGrid {
        dims,
        spacing_m: DVec3::from_array(spacing_mm) * 1e-3,
        origin_m: DVec3::new(0.01, -0.02, 0.03),
        axes: DMat3::IDENTITY,
    }
}

/// Rotated, and left-handed when asked.
pub(super) fn oblique_grid(left_handed: bool) -> VoxelGrid {
    let rotation = DMat3::from_quat(glam::DQuat::from_xyzw(0.1, -0.3, 0.2, 0.9).normalize());
    let flip = DMat3::from_diagonal(DVec3::new(1.0, 1.0, if left_handed { -1.0 } else { 1.0 }));
    VoxelGrid { axes: rotation * flip, ..plain_grid([5, 4, 3], [0.703125, 1.5, 2.5]) }
}

pub(super) fn assert_same_place(a: &VoxelGrid, b: &VoxelGrid) {
    assert_eq!(a.dims, b.dims);
    for index in 0..a.n_voxels() {
        let voxel = DVec3::from_array(a.voxel(index).map(|v| v as f64));
        let distance_m = a.position_m(voxel).distance(b.position_m(voxel));
        assert!(distance_m < 1e-8, "voxel {voxel} is {distance_m} m away");
    }
}

/// The bytes of a file with some of the first `reach` changed, and what stands behind a place cut off.
pub(super) fn damaged(
    good: &[u8],
    changes: Vec<(Index, u8)>,
    reach: usize,
    cut_at: Option<Index>,
) -> Vec<u8> {
    let mut bytes = good.to_vec();
    for (place, value) in changes {
        let n = bytes.len().min(reach);
        bytes[place.index(n)] = value;
    }
    if let Some(kept) = cut_at {
        bytes.truncate(kept.index(bytes.len() + 1));
    }
    bytes
}
