//! From the vectors of a header to a grid of right-angled voxels.

use std::path::Path;

use super::error::ImageError;
use crate::image::VoxelGrid;
use crate::math::{DMat3, DVec3};

/// Largest cosine between two voxel axes that still counts as a right angle: 0.15 mm over 300 mm.
pub(super) const MAX_SHEAR: f64 = 5e-4;
/// Voxel sizes that are allowed [m]: from a micrometre of a microscope to more than any scanner's slice.
const SPACING_M: [f64; 2] = [1e-6, 0.1];
/// How far a size may be outside that for rounding in a file's numbers, relative.
const ROUNDING: f64 = 1e-6;

/// From RAS to LPS and back: half a turn about z.
pub(super) const TURN_ABOUT_Z: DMat3 = DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0));

/// The grid of voxels whose steps along i, j, k are `steps` (any length but zero) and whose sizes are `spacing_m`.
///
/// # Errors
/// Axes that do not meet at right angles; voxels smaller than a micrometre or larger than 100 mm.
pub(super) fn right_angled(
    file: &Path,
    dims: [usize; 3],
    steps: [DVec3; 3],
    spacing_m: DVec3,
    origin_m: DVec3,
) -> Result<VoxelGrid, ImageError> {
    for axis in 0..3 {
        let [least, most] = SPACING_M;
        let size_m = spacing_m[axis];
        if !(least * (1.0 - ROUNDING)..=most * (1.0 + ROUNDING)).contains(&size_m) {
            let found_mm = 1e3 * size_m;
            return Err(ImageError::Spacing { file: file.to_path_buf(), axis, found_mm });
        }
    }
    let axes = steps.map(DVec3::normalize);
    for [a, b] in [[0, 1], [0, 2], [1, 2]] {
        let cosine = axes[a].dot(axes[b]);
        if cosine.is_nan() || cosine.abs() > MAX_SHEAR {
            let angle_deg = libm::acos(cosine.clamp(-1.0, 1.0)).to_degrees();
            return Err(ImageError::Sheared { file: file.to_path_buf(), axes: [a, b], angle_deg });
        }
    }
    // What is left of the shear is rounding: make the axes exactly orthonormal.
    let x = axes[0];
    let y = (axes[1] - x * x.dot(axes[1])).normalize();
    let z = x.cross(y);
    let z = if z.dot(axes[2]) < 0.0 { -z } else { z };
    Ok(VoxelGrid { dims, spacing_m, origin_m, axes: DMat3::from_cols(x, y, z) })
}
