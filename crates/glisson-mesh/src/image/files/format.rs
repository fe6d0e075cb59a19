//! What a format of images is to those who read and write files. Each format's file has its own; the table
//! [`super::FORMATS`] lists them.

use std::path::Path;

use super::error::ImageError;
use super::stored::StoredImage;
use super::written::WrittenImage;

/// Writes an image into a file.
pub(super) type WriteImage = fn(&Path, &WrittenImage<'_>) -> Result<(), ImageError>;

/// A format of images: a row of the table [`super::FORMATS`].
#[derive(Clone, Copy, Debug)]
pub struct ImageFormat {
    /// What people call it.
    pub name: &'static str,
    /// Ends of the file names that tell it, lower-case, without the dot.
    pub extensions: &'static [&'static str],
    /// Whether a file that begins with these bytes (up to 1024, decompressed) is of this format.
    pub(super) begins: fn(&[u8]) -> bool,
    /// Reads the image in a file.
    pub(super) read: fn(&Path) -> Result<StoredImage, ImageError>,
    /// Writes an image; none for a format that is only read.
    pub(super) write: Option<WriteImage>,
}

impl ImageFormat {
    /// Whether an image can be written in it.
    pub fn is_written(&self) -> bool {
        self.write.is_some()
    }
}
