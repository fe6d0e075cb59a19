//! DICOM: a folder of slices, a file of one or many frames, and segmentations (DICOM-SEG); read only.
//!
//! The frame of DICOM is LPS and its lengths are millimetres, so positions carry over as they are. Slices are put in
//! order by their position along the normal of their plane, never by name or number. A folder with several series, a
//! series with a missing slice, slices of different size or direction and several volumes at one place are refused with
//! what was found; slices that are there twice with the same content are taken once, those of a tilted gantry put
//! upright.
//!
//! Transfer syntaxes: implicit and explicit, both byte orders, deflated; RLE; JPEG baseline and lossless; JPEG-LS;
//! JPEG 2000. Others (among them HTJ2K and 12-bit JPEG) are refused by name.
//! Nothing about the patient is read but the image.
//!
//! Source: DICOM PS3.3 2024 (C.7.6.2 image plane, C.7.6.16 functional groups, C.8.20 segmentation), PS3.5.

mod anonymize;
mod frames;
mod lengths;
mod pixels;
mod segmentation;
mod series;
mod tilt;
mod volume;

use std::path::Path;

use super::error::ImageError;
use super::format::ImageFormat;
use super::stored::StoredImage;

pub use anonymize::{AnonymousCopy, anonymize};
pub use series::{SeriesChoice, SeriesSummary};

/// The format's row of the table.
pub(super) const FORMAT: ImageFormat = ImageFormat {
    name: volume::NAME,
    extensions: &["dcm", "ima", "dicom"],
    begins: |bytes| bytes.get(128..132) == Some(b"DICM"),
    read: |file| read(file, &SeriesChoice::Only),
    write: None,
};

/// The image in a file, or in the files of a folder and the folders in it.
pub(super) fn read(path: &Path, choice: &SeriesChoice) -> Result<StoredImage, ImageError> {
    let series = series::chosen(path, choice)?;
    let is_segmentation = series.modality.as_deref() == Some("SEG");
    let mut image = if is_segmentation {
        segmentation::label_map(path, &series)?
    } else {
        volume::volume(path, &series)?
    };
    image.modality.clone_from(&series.modality);
    image.notes.extend(series.notes);
    Ok(image)
}

/// Whether one of the files right in a folder is DICOM.
pub(super) fn is_in(folder: &Path) -> bool {
    let Ok(entries) = std::fs::read_dir(folder) else { return false };
    entries.filter_map(Result::ok).any(|entry| series::is_dicom(&entry.path()))
}

/// Whether one of the files in a folder, or in the folders in it, is DICOM.
pub(super) fn is_below(folder: &Path) -> bool {
    series::files_below(folder).is_ok_and(|files| files.iter().any(|file| series::is_dicom(file)))
}

/// The image series in a folder and the folders in it, in the order of their numbers.
///
/// # Errors
/// [`ImageError`]: a folder that cannot be read, or without a DICOM image.
pub fn series_in(path: &Path) -> Result<Vec<SeriesSummary>, ImageError> {
    Ok(series::find(path)?.into_iter().map(|series| series.summary()).collect())
}
