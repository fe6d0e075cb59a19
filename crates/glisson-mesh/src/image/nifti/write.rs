//! Writing NIfTI-1.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

use flate2::Compression;
use flate2::write::GzEncoder;

use super::header::{N_BYTES_BEFORE_EXTENSIONS, VoxelType};
use super::{COMMENT_EXTENSION, ImageError, NAMES_KEY};
use crate::files::write_atomically;
use crate::image::{LabelMap, Volume, VoxelGrid};
use crate::math::{DMat3, DVec3};

/// Comment extension that holds `names`, padded to a multiple of 16 bytes; nothing for no names.
fn names_extension(names: &[(u16, String)]) -> Vec<u8> {
    if names.is_empty() {
        return Vec::new();
    }
    let names: BTreeMap<u16, &str> = names.iter().map(|(label, name)| (*label, name.as_str())).collect();
    let comment = BTreeMap::from([(NAMES_KEY, names)]);
    let json = serde_json::to_vec(&comment).expect("maps of numbers and text always serialize");
    let size = (8 + json.len()).next_multiple_of(16);
    let mut bytes = Vec::with_capacity(size);
    bytes.extend((size as i32).to_le_bytes());
    bytes.extend(COMMENT_EXTENSION.to_le_bytes());
    bytes.extend(json);
    bytes.resize(size, 0);
    bytes
}

/// Header and extension bytes of a file with this grid and voxel type.
fn header_bytes(grid: &VoxelGrid, voxel_type: VoxelType, extension: &[u8]) -> Vec<u8> {
    let mut bytes = vec![0; N_BYTES_BEFORE_EXTENSIONS];
    let mut put = |byte: usize, value: &[u8]| bytes[byte..byte + value.len()].copy_from_slice(value);
    put(0, &348i32.to_le_bytes());
    for (axis, n) in [3, grid.dims[0], grid.dims[1], grid.dims[2], 1, 1, 1, 1].into_iter().enumerate() {
        put(40 + 2 * axis, &(n as i16).to_le_bytes());
    }
    put(70, &(voxel_type as i16).to_le_bytes());
    put(72, &(8 * voxel_type.n_bytes() as i16).to_le_bytes());
    let ras_from_lps = DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0));
    let axes = ras_from_lps * grid.axes;
    let handedness = if axes.determinant() < 0.0 { -1.0 } else { 1.0 };
    let (spacing_mm, offset_mm) = (grid.spacing_m * 1e3, ras_from_lps * grid.origin_m * 1e3);
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

fn write_file(path: &Path, grid: &VoxelGrid, header: &[u8], data: &[u8]) -> Result<(), ImageError> {
    let unwritable = |reason: String| Err(ImageError::Unwritable { file: path.to_path_buf(), reason });
    if let Some(axis) = (0..3).find(|&a| !(1..=32767).contains(&grid.dims[a])) {
        return unwritable(format!("{} voxels along axis {axis}, 1 to 32767 allowed", grid.dims[axis]));
    }
    if !(grid.spacing_m.is_finite() && grid.spacing_m.min_element() > 0.0 && grid.origin_m.is_finite()) {
        return unwritable(format!("voxel size {} m, above 0 allowed", grid.spacing_m));
    }
    let name = path.file_name().map(|n| n.to_string_lossy().to_lowercase()).unwrap_or_default();
    let write = |out: &mut dyn Write| out.write_all(header).and_then(|()| out.write_all(data));
    let result = if name.ends_with(".nii.gz") {
        write_atomically(path, |out| {
            // Noise does not compress: the fast level costs little size and saves seconds.
            let mut encoder = GzEncoder::new(out, Compression::fast());
            write(&mut encoder)?;
            encoder.finish().map(|_| ())
        })
    } else if name.ends_with(".nii") {
        write_atomically(path, |out| write(out))
    } else {
        return unwritable("the name must end in .nii or .nii.gz".into());
    };
    result.map_err(|source| ImageError::Io { file: path.to_path_buf(), source })
}

/// Writes a volume as NIfTI-1: 16-bit integers when every value is one (as CT numbers are), else 32-bit
/// floats. Gzipped when the name ends in `.nii.gz`.
///
/// # Errors
/// A name that ends otherwise, dimensions NIfTI-1 cannot hold, or a refusal of the file system.
pub fn write_volume(path: &Path, volume: &Volume<f32>) -> Result<(), ImageError> {
    assert_eq!(volume.values.len(), volume.grid.n_voxels(), "one value a voxel");
    let whole = volume.values.iter().all(|&v| f32::from(v as i16) == v);
    let (voxel_type, data): (_, Vec<u8>) = if whole {
        (VoxelType::I16, volume.values.iter().flat_map(|&v| (v as i16).to_le_bytes()).collect())
    } else {
        (VoxelType::F32, volume.values.iter().flat_map(|v| v.to_le_bytes()).collect())
    };
    write_file(path, &volume.grid, &header_bytes(&volume.grid, voxel_type, &[]), &data)
}

/// Writes a label map as NIfTI-1 with 16-bit unsigned labels, names included.
/// Gzipped when the name ends in `.nii.gz`.
///
/// # Errors
/// As [`write_volume`].
pub fn write_label_map(path: &Path, map: &LabelMap) -> Result<(), ImageError> {
    assert_eq!(map.labels.len(), map.grid.n_voxels(), "one label a voxel");
    let data: Vec<u8> = map.labels.iter().flat_map(|label| label.to_le_bytes()).collect();
    let header = header_bytes(&map.grid, VoxelType::U16, &names_extension(&map.names));
    write_file(path, &map.grid, &header, &data)
}
