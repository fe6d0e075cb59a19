//! Slices as bytes without a header: a byte a pixel, or three of red, green and blue.

use std::path::Path;

use super::super::error::ImageError;
use super::super::packed::load;
use super::picture::{Colours, Picture, Shape, refuse};

/// What has to be said of slices without a header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RawSlices {
    /// Columns and rows of each.
    pub size: [usize; 2],
    /// Whether all red stands first, then all green and all blue, instead of the three of a pixel together.
    pub in_planes: bool,
}

/// What the number of bytes of a file says of its picture.
pub(super) fn shape(file: &Path, raw: &RawSlices) -> Result<Shape, ImageError> {
    let metadata =
        std::fs::metadata(file).map_err(|source| ImageError::Io { file: file.to_path_buf(), source })?;
    let found = metadata.len();
    let [columns, rows] = raw.size;
    let grey = Shape { size: raw.size, colours: Colours::Grey, n_bits: 8, n_samples: 1 };
    grey.check(file, u64::MAX, 1)?;
    let n_pixels = columns as u64 * rows as u64;
    match found {
        found if found == n_pixels => Ok(grey),
        found if found == 3 * n_pixels => Ok(Shape { colours: Colours::Three, n_samples: 3, ..grey }),
        _ => {
            let allowed = 3 * n_pixels;
            let reason = format!(
                "{found} bytes, allowed for slices of {columns} x {rows} pixels: {allowed} (24-bit colour) or {n_pixels} \
                 (8-bit grey); correct `--size`"
            );
            Err(refuse(file, reason))
        }
    }
}

/// The picture in a file.
pub(super) fn read(file: &Path, raw: &RawSlices) -> Result<Picture, ImageError> {
    let shape = shape(file, raw)?;
    let bytes = load(file)?;
    if bytes.len() as u64 != shape.n_bytes() {
        return Err(refuse(file, "its length changed while it was read"));
    }
    let n = shape.n_pixels();
    let is_in_planes = raw.in_planes && shape.colours == Colours::Three;
    let samples = if is_in_planes {
        (0..n).flat_map(|pixel| [0, 1, 2].map(|colour| u16::from(bytes[colour * n + pixel]))).collect()
    } else {
        bytes.into_iter().map(u16::from).collect()
    };
    Ok(Picture { shape, samples })
}
