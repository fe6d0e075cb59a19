//! Writing NIfTI-1.

use std::io::Write;
use std::path::Path;

use flate2::Compression;
use flate2::write::GzEncoder;

use super::super::error::ImageError;
use super::super::label_table::LabelTable;
use super::super::placement::TURN_ABOUT_Z;
use super::super::written::WrittenImage;
use super::header::{N_BYTES_BEFORE_EXTENSIONS, code_of};
use super::labels::COMMENT_EXTENSION;
use crate::binary::NumberType;
use crate::files::write_atomically;
use crate::image::VoxelGrid;
use crate::math::DMat3;

/// Comment extension that holds the labels' names and colours, padded to a multiple of 16 bytes; nothing for none.
fn labels_extension(table: &LabelTable) -> Vec<u8> {
    if table.is_empty() {
        return Vec::new();
    }
    let json = table.to_json();
    let size = (8 + json.len()).next_multiple_of(16);
    let mut bytes = Vec::with_capacity(size);
    bytes.extend((size as i32).to_le_bytes());
    bytes.extend(COMMENT_EXTENSION.to_le_bytes());
    bytes.extend(json.as_bytes());
    bytes.resize(size, 0);
    bytes
}

/// Header and extension bytes of a file with this grid and voxel type.
fn header_bytes(grid: &VoxelGrid, voxel_type: NumberType, extension: &[u8]) -> Vec<u8> {
    let mut bytes = vec![0; N_BYTES_BEFORE_EXTENSIONS];
    let mut put = |byte: usize, value: &[u8]| bytes[byte..byte + value.len()].copy_from_slice(value);
    put(0, &348i32.to_le_bytes());
    for (axis, n) in [3, grid.dims[0], grid.dims[1], grid.dims[2], 1, 1, 1, 1].into_iter().enumerate() {
        put(40 + 2 * axis, &(n as i16).to_le_bytes());
    }
    put(70, &code_of(voxel_type).to_le_bytes());
    put(72, &(8 * voxel_type.n_bytes() as i16).to_le_bytes());
    let axes = TURN_ABOUT_Z * grid.axes;
    let handedness = if axes.determinant() < 0.0 { -1.0 } else { 1.0 };
    let (spacing_mm, offset_mm) = (grid.spacing_m * 1e3, TURN_ABOUT_Z * grid.origin_m * 1e3);
    for (axis, size) in [handedness, spacing_mm.x, spacing_mm.y, spacing_mm.z].into_iter().enumerate() {
        put(76 + 4 * axis, &(size as f32).to_le_bytes());
    }
    put(108, &((N_BYTES_BEFORE_EXTENSIONS + extension.len()) as f32).to_le_bytes());
    put(112, &1f32.to_le_bytes());
    put(123, &[2]);
    // Code 1: the scanner's frame, for both forms.
    put(252, &1i16.to_le_bytes());
    put(254, &1i16.to_le_bytes());
    let rotation = DMat3::from_cols(axes.x_axis, axes.y_axis, axes.z_axis * handedness);
    let q = glam::DQuat::from_mat3(&rotation).normalize();
    let q = if q.w < 0.0 { -q } else { q };
    for (place, value) in [q.x, q.y, q.z, offset_mm.x, offset_mm.y, offset_mm.z].into_iter().enumerate() {
        put(256 + 4 * place, &(value as f32).to_le_bytes());
    }
    let matrix = axes * DMat3::from_diagonal(spacing_mm);
    for row in 0..3 {
        let values = [matrix.x_axis[row], matrix.y_axis[row], matrix.z_axis[row], offset_mm[row]];
        for (column, value) in values.into_iter().enumerate() {
            put(280 + 16 * row + 4 * column, &(value as f32).to_le_bytes());
        }
    }
    put(344, b"n+1\0");
    if !extension.is_empty() {
        put(348, &[1]);
        bytes.extend(extension);
    }
    bytes
}

/// Writes an image as NIfTI-1, its labels' names and colours included. Gzipped when the name ends in `.nii.gz`.
pub(super) fn write(path: &Path, image: &WrittenImage<'_>) -> Result<(), ImageError> {
    let unwritable = |reason: String| Err(ImageError::Unwritable { file: path.to_path_buf(), reason });
    let grid = image.grid;
    if let Some(axis) = (0..3).find(|&a| !(1..=32767).contains(&grid.dims[a])) {
        return unwritable(format!("{} voxels along axis {axis}, 1 to 32767 allowed", grid.dims[axis]));
    }
    let extension = labels_extension(&LabelTable::of(image.names, image.colours));
    let header = header_bytes(grid, image.kind, &extension);
    let write = |out: &mut dyn Write| out.write_all(&header).and_then(|()| out.write_all(&image.bytes));
    let name = path.file_name().map(|n| n.to_string_lossy().to_lowercase()).unwrap_or_default();
    let result = if name.ends_with(".gz") {
        write_atomically(path, |out| {
            // Noise does not compress: the fast level costs little size and saves seconds.
            let mut encoder = GzEncoder::new(out, Compression::fast());
            write(&mut encoder)?;
            encoder.finish().map(|_| ())
        })
    } else {
        write_atomically(path, |out| write(out))
    };
    result.map_err(|source| ImageError::Io { file: path.to_path_buf(), source })
}
