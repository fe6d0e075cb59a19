//! A folder of masks, one organ a file, as TotalSegmentator writes them: `liver.nii.gz`, `spleen.nii.gz` and so on
//! become one label map, whose labels are named after the files and numbered in the order of their names.

use std::path::{Path, PathBuf};

use super::error::ImageError;
use super::stored::{StoredData, StoredImage};
use crate::binary::{ByteOrder, NumberType};
use crate::image::VoxelGrid;

/// Largest distance of the same voxel in two masks, in voxel sizes.
const MAX_SHIFT: f64 = 0.01;

/// Files right in a folder that `is_image` says hold an image, in the order of their names.
pub(super) fn files_in(folder: &Path, is_image: impl Fn(&Path) -> bool) -> Result<Vec<PathBuf>, ImageError> {
    let io_error = |source| ImageError::Io { file: folder.to_path_buf(), source };
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(io_error)? {
        let path = entry.map_err(io_error)?.path();
        if path.is_file() && is_image(&path) {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}

/// What an organ is called after its file.
fn organ_name(file: &Path) -> String {
    let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
    name.split('.').next().unwrap_or_default().to_owned()
}

/// Whether an image has one number beside 0, or none, and names no labels.
fn is_mask(image: &StoredImage) -> bool {
    let mut inside = None;
    let same = image.data.for_each(|_, value| match inside {
        _ if value == 0.0 => Ok(()),
        None => {
            inside = Some(value);
            Ok(())
        }
        Some(other) if other == value => Ok(()),
        Some(_) => Err(()),
    });
    image.names.is_empty() && same.is_ok()
}

fn same_place(a: &VoxelGrid, b: &VoxelGrid) -> bool {
    a.dims == b.dims && a.corner_distance_m(b) <= MAX_SHIFT * a.spacing_m.min_element()
}

/// The label map of the masks in `files`, each read by `read`: zeros, and one other number inside. Where two organs lie
/// on each other the later one is taken, and a note says in how many voxels. A single file that is no mask is that image.
///
/// # Errors
/// A file that cannot be read, or among several one that is no mask; files that are not on one grid; more files than
/// there are labels.
pub(super) fn read(
    folder: &Path,
    files: &[PathBuf],
    read: impl Fn(&Path) -> Result<StoredImage, ImageError>,
) -> Result<StoredImage, ImageError> {
    let refuse = |reason: String| Err(ImageError::Series { folder: folder.to_path_buf(), reason });
    let [first, others @ ..] = files else { return refuse("no images in it".into()) };
    let first_image = read(first)?;
    if others.is_empty() && !is_mask(&first_image) {
        return Ok(first_image);
    }
    if files.len() > usize::from(u16::MAX) {
        return refuse(format!("{} masks, at most 65535 allowed", files.len()));
    }
    let grid = first_image.grid.clone();
    let mut labels = vec![0u16; grid.n_voxels()];
    let (mut names, mut n_shared) = (Vec::new(), 0usize);
    let mut current = Some(first_image);
    for (n, file) in files.iter().enumerate() {
        let image = current.take().map_or_else(|| read(file), Ok)?;
        if !same_place(&image.grid, &grid) {
            let (name, first) = (organ_name(file), organ_name(first));
            return refuse(format!(
                "`{name}` has {:?} voxels at another place than `{first}` with {:?}; the masks of a folder must be on \
                 one grid (or name one file)",
                image.grid.dims, grid.dims
            ));
        }
        if !is_mask(&image) {
            return refuse(format!(
                "`{}` holds several numbers beside 0, a mask one: name one file, or keep masks in a folder of their own",
                organ_name(file)
            ));
        }
        let label = n as u16 + 1;
        image.data.for_each(|index, value| {
            if value != 0.0 {
                n_shared += usize::from(labels[index] != 0);
                labels[index] = label;
            }
            Ok::<(), ImageError>(())
        })?;
        names.push((label, organ_name(file)));
    }
    let bytes = labels.iter().flat_map(|label| label.to_le_bytes()).collect();
    let data = StoredData::plain(NumberType::U16, ByteOrder::Little, bytes, 0);
    let mut image = StoredImage::new(folder, "masks", grid, data);
    image.names = names;
    image.notes.push(format!("{} masks, one organ a file", files.len()));
    if n_shared > 0 {
        image.notes.push(format!(
            "masks overlap in {n_shared} voxels; the organ whose name comes later was taken there"
        ));
    }
    Ok(image)
}
