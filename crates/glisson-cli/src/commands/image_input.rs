//! Images as commands read them: a file or a folder, and what a user should know about it.

use std::path::Path;

use glisson::image::files::{ImageError, StoredImage, format_of_name, read_image};

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
