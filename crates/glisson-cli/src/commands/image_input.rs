//! Images and shapes as commands read them, and what a user should know about them.

use std::path::Path;

use glisson::image::files::{ImageError, SeriesChoice, StoredImage, format_of_file, read_image, read_series};
use glisson::surface::files::FileKind;
use glisson::units::{LengthUnit, likely_unit};

/// Whether a path is an image to `glisson mesh`, and no surface.
pub(crate) fn is_image(path: &Path) -> bool {
    path.is_dir() || (FileKind::of_path(path).is_err() && format_of_file(path).is_some())
}

/// The image in a file or folder; its notes go to standard error, so that they do not mix with JSON.
pub(crate) fn read_with_notes(path: &Path, series: Option<usize>) -> Result<StoredImage, ImageError> {
    let image = read(path, series)?;
    for note in &image.notes {
        eprintln!("note: {}: {note}", path.display());
    }
    Ok(image)
}

/// The image in a file or folder, or series number `series` of a DICOM folder.
pub(crate) fn read(path: &Path, series: Option<usize>) -> Result<StoredImage, ImageError> {
    match series {
        Some(number) => read_series(path, &SeriesChoice::Number(number)),
        None => read_image(path),
    }
}

/// Says so where an organ read in `unit` has a volume that no organ has.
pub(crate) fn warn_of_unit(path: &Path, volume_m3: f64, unit: LengthUnit) {
    // glTF is in metres, whatever is asked for.
    let is_gltf = matches!(FileKind::of_path(path), Ok(FileKind::Gltf));
    let unit = if is_gltf { LengthUnit::Metre } else { unit };
    let Some(likely) = likely_unit(volume_m3, unit) else { return };
    let remedy = if is_gltf { "scale it where it was made".to_owned() } else { format!("--unit {likely}") };
    eprintln!(
        "warning: {}: {:.3} ml read in {unit}, organs have 1 ml to 20 l; the file is probably in {likely} ({remedy})",
        path.display(),
        1e6 * volume_m3
    );
}
