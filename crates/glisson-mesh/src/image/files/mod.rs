//! Image files: volumes and label maps in the patient frame.
//!
//! | format | extensions | read | written |
//! |---|---|---|---|
//! | NIfTI-1 | `.nii`, `.nii.gz` | every number type, both byte orders | 16-bit integers or 32-bit floats |
//! | NRRD | `.nrrd`, `.nhdr`, `.seg.nrrd` | raw, gzip, text, hex; attached or detached; layers of segments | gzip, attached |
//! | MetaImage | `.mha`, `.mhd` | raw, zlib, text; attached or detached | zlib, attached |
//! | INRIMAGE-4 | `.inr`, `.inr.gz` | every number type | |
//! | DICOM (feature `dicom`) | a folder, `.dcm` or any name | slices, frames, segmentations | |
//! | masks | a folder of files of the formats above | one organ a file, named after it | |
//! | pictures ([`read_slices`]) | a folder of `.png`, `.tif`, `.tiff`, `.raw` or `.rgb` | one slice a file, with distances that are given | |
//!
//! Inside are LPS and metres, whatever the file has; a file that does not say which side is left is refused where its
//! format could say so. Names and colours of labels are read and written by every format that is written. Sizes in a
//! header are checked against the bytes that are there before memory is taken.

#[cfg(feature = "dicom")]
mod dicom;
mod error;
mod format;
mod inrimage;
mod label_table;
mod masks;
mod metaimage;
mod nifti;
mod nrrd;
mod packed;
mod placement;
mod slices;
mod stored;
mod text_header;
mod written;

#[cfg(feature = "dicom")]
pub use dicom::{AnonymousCopy, SeriesChoice, SeriesSummary, anonymize, series_in};
pub use error::{HeaderPlace, ImageError};
pub use format::ImageFormat;
pub use slices::{RawSlices, SliceChannel, SliceOptions, read_slices};
pub use stored::StoredImage;

use std::io::Read;
use std::path::Path;

use flate2::read::MultiGzDecoder;

use self::written::WrittenImage;
use super::{LabelMap, Volume};

/// Every format, in the order of messages: one line a format, whose description is in its own file (docs/extending.md).
pub const FORMATS: &[ImageFormat] = &[
    nifti::FORMAT,
    nrrd::FORMAT,
    metaimage::FORMAT,
    inrimage::FORMAT,
    #[cfg(feature = "dicom")]
    dicom::FORMAT,
];

/// What people call the format whose files are slices, so that a folder of them is one image.
const DICOM_NAME: &str = "DICOM";

/// The extensions of all formats that `is_meant` picks, without their dots, in the order of the table.
pub fn image_extensions(is_meant: impl Fn(&ImageFormat) -> bool) -> Vec<&'static str> {
    let meant = FORMATS.iter().filter(|format| is_meant(format));
    meant.flat_map(|format| format.extensions.iter().copied()).collect()
}

/// The format that the end of a file's name tells, in upper or lower case.
pub fn format_of_name(path: &Path) -> Option<&'static ImageFormat> {
    let name = path.file_name()?.to_string_lossy().to_lowercase();
    let has = |extension: &&str| name.strip_suffix(extension).is_some_and(|start| start.ends_with('.'));
    FORMATS.iter().find(|format| format.extensions.iter().any(&has))
}

/// The format of a file: told by the end of its name, else by its first bytes.
pub fn format_of_file(path: &Path) -> Option<&'static ImageFormat> {
    format_of_name(path).or_else(|| {
        let first = first_bytes(path).ok()?;
        FORMATS.iter().find(|format| (format.begins)(&first))
    })
}

/// The image in a file, or in the files of a folder: a DICOM series, or masks of organs ([`masks`]). The format of a
/// file is told by the end of its name, else by its first bytes.
///
/// # Errors
/// [`ImageError`]: no format that is known, a file that cannot be read, a header field out of range or not supported,
/// damaged or truncated data, another number of bytes than the header promises, no orientation, voxel axes that are
/// not at right angles, voxels smaller than a micrometre or larger than 100 mm.
pub fn read_image(path: &Path) -> Result<StoredImage, ImageError> {
    if path.is_dir() {
        return read_folder(path);
    }
    if let Some(format) = format_of_name(path) {
        return (format.read)(path);
    }
    let first = first_bytes(path).map_err(|source| ImageError::Io { file: path.to_path_buf(), source })?;
    if let Some(format) = FORMATS.iter().find(|format| (format.begins)(&first)) {
        return (format.read)(path);
    }
    Err(ImageError::UnknownFormat {
        file: path.to_path_buf(),
        found: format!("it begins with \"{}\"", first[..first.len().min(16)].escape_ascii()),
        allowed: format!("allowed: .{}", image_extensions(|_| true).join(", .")),
    })
}

/// Masks, where the files right in the folder are images of another format than DICOM; else DICOM.
fn read_folder(folder: &Path) -> Result<StoredImage, ImageError> {
    let masks =
        masks::files_in(folder, |path| format_of_name(path).is_some_and(|format| format.name != DICOM_NAME))?;
    if !masks.is_empty() {
        #[cfg(feature = "dicom")]
        if dicom::is_in(folder) {
            return Err(ImageError::Series {
                folder: folder.to_path_buf(),
                reason: format!(
                    "it holds DICOM and {} other image(s); name the file, or the series with `--series N`",
                    masks.len()
                ),
            });
        }
        return masks::read(folder, &masks, read_image);
    }
    #[cfg(feature = "dicom")]
    return match slices::without_spacing(folder).filter(|_| !dicom::is_below(folder)) {
        Some(error) => Err(error),
        None => dicom::read(folder, &SeriesChoice::Only),
    };
    #[cfg(not(feature = "dicom"))]
    Err(slices::without_spacing(folder).unwrap_or(ImageError::UnknownFormat {
        file: folder.to_path_buf(),
        found: "a folder without images".into(),
        allowed: "DICOM folders are read by a program that is built with the feature `dicom`".into(),
    }))
}

/// The DICOM series of a folder that is meant.
///
/// # Errors
/// As [`read_image`], and a choice that is not there.
#[cfg(feature = "dicom")]
pub fn read_series(folder: &Path, choice: &SeriesChoice) -> Result<StoredImage, ImageError> {
    dicom::read(folder, choice)
}

/// The first bytes of a file, decompressed.
fn first_bytes(path: &Path) -> std::io::Result<Vec<u8>> {
    const N_BYTES: u64 = 1024;
    let mut bytes = Vec::new();
    std::fs::File::open(path)?.take(N_BYTES).read_to_end(&mut bytes)?;
    let mut unpacked = Vec::new();
    // Only the beginning of the stream is there, so its end is always missing: what came out counts.
    let _ = MultiGzDecoder::new(bytes.as_slice()).take(N_BYTES).read_to_end(&mut unpacked);
    Ok(if unpacked.is_empty() { bytes } else { unpacked })
}

/// The volume in a file, its values scaled as the file says.
///
/// # Errors
/// As [`read_image`].
pub fn read_volume(path: &Path) -> Result<Volume<f32>, ImageError> {
    Ok(read_image(path)?.volume())
}

/// The label map in a file, with the names and colours that the file gives its labels.
///
/// # Errors
/// As [`read_image`], and a voxel that is not a whole number from 0 to 65535.
pub fn read_label_map(path: &Path) -> Result<LabelMap, ImageError> {
    read_image(path)?.label_map()
}

/// Writes a volume: 16-bit integers when every value is one (as CT numbers are), else 32-bit floats. The end of the
/// name tells the format; `.nii.gz`, `.nrrd` and `.mha` are compressed.
///
/// # Errors
/// [`ImageError`]: a name that ends otherwise, a grid that the format cannot hold, or a refusal of the file system; then
/// a file that was there is untouched.
pub fn write_volume(path: &Path, volume: &Volume<f32>) -> Result<(), ImageError> {
    write(path, &WrittenImage::of_volume(volume))
}

/// Writes a label map with 16-bit unsigned labels, names and colours included. The end of the name tells the format.
///
/// # Errors
/// As [`write_volume`].
pub fn write_label_map(path: &Path, map: &LabelMap) -> Result<(), ImageError> {
    write(path, &WrittenImage::of_label_map(map))
}

fn write(path: &Path, image: &WrittenImage<'_>) -> Result<(), ImageError> {
    image.check(path)?;
    let Some(write) = format_of_name(path).and_then(|format| format.write) else {
        let allowed = image_extensions(ImageFormat::is_written).join(", .");
        let reason = format!("the name must end in one of .{allowed}");
        return Err(ImageError::Unwritable { file: path.to_path_buf(), reason });
    };
    write(path, image)
}
