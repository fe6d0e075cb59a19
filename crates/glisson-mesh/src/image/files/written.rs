//! An image as it is handed to a format to be written.

use std::path::Path;

use super::error::ImageError;
use crate::binary::NumberType;
use crate::image::{LabelMap, Volume, VoxelGrid};

/// Numbers to write, little-endian, i fastest, and all that is said of them.
#[derive(Debug)]
pub(super) struct WrittenImage<'a> {
    pub(super) grid: &'a VoxelGrid,
    pub(super) kind: NumberType,
    pub(super) bytes: Vec<u8>,
    pub(super) names: &'a [(u16, String)],
    pub(super) colours: &'a [(u16, [f32; 3])],
    /// Whether the numbers are labels.
    pub(super) is_label_map: bool,
}

impl<'a> WrittenImage<'a> {
    /// A volume: 16-bit integers when every value is one (as CT numbers are), else 32-bit floats.
    ///
    /// # Panics
    /// Another number of values than voxels.
    pub(super) fn of_volume(volume: &'a Volume<f32>) -> Self {
        assert_eq!(volume.values.len(), volume.grid.n_voxels(), "one value a voxel");
        let whole = volume.values.iter().all(|&v| f32::from(v as i16) == v);
        let (kind, bytes) = if whole {
            (NumberType::I16, volume.values.iter().flat_map(|&v| (v as i16).to_le_bytes()).collect())
        } else {
            (NumberType::F32, volume.values.iter().flat_map(|v| v.to_le_bytes()).collect())
        };
        Self { grid: &volume.grid, kind, bytes, names: &[], colours: &[], is_label_map: false }
    }

    /// A label map: 16-bit unsigned integers.
    ///
    /// # Panics
    /// Another number of labels than voxels.
    pub(super) fn of_label_map(map: &'a LabelMap) -> Self {
        assert_eq!(map.labels.len(), map.grid.n_voxels(), "one label a voxel");
        let bytes = map.labels.iter().flat_map(|label| label.to_le_bytes()).collect();
        let (names, colours) = (&map.names, &map.colours);
        Self { grid: &map.grid, kind: NumberType::U16, bytes, names, colours, is_label_map: true }
    }

    /// Refuses what no format can say.
    pub(super) fn check(&self, path: &Path) -> Result<(), ImageError> {
        let unwritable = |reason: String| Err(ImageError::Unwritable { file: path.to_path_buf(), reason });
        let grid = self.grid;
        if let Some(axis) = (0..3).find(|&a| grid.dims[a] == 0) {
            return unwritable(format!("no voxels along axis {axis}"));
        }
        if !(grid.spacing_m.is_finite() && grid.spacing_m.min_element() > 0.0 && grid.origin_m.is_finite()) {
            return unwritable(format!("voxel size {} m, above 0 allowed", grid.spacing_m));
        }
        Ok(())
    }
}
