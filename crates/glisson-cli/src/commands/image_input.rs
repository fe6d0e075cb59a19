//! Images and shapes as commands read them, and what a user should know about them.

use std::path::Path;

use glisson::image::files::{ImageError, StoredImage, format_of_name, read_image};
use glisson::units::{LengthUnit, likely_unit};

/// Whether a path is an image to `glisson mesh`, and no surface.
pub(crate) fn is_image(path: &Path) -> bool {
    path.is_dir() || format_of_name(path).is_some()
}

/// The image in a file or folder; its notes go to standard error, so that they do not mix with JSON.
pub(crate) fn read_with_notes(path: &Path) -> Result<StoredImage, ImageError> {
    let image = read_image(path)?;
    for note in &image.notes {
        eprintln!("note: {}: {note}", path.display());
    }
    Ok(image)
}

/// Says so where an organ read in `unit` has a volume that no organ has.
pub(crate) fn warn_of_unit(path: &Path, volume_m3: f64, unit: LengthUnit) {
    let Some(likely) = likely_unit(volume_m3, unit) else { return };
    eprintln!(
        "warning: {}: {:.3} ml read in {unit}, organs have 1 ml to 20 l; the file is probably in {likely} (--unit {likely})",
        path.display(),
        1e6 * volume_m3
    );
}
