//! NIfTI-1, `.nii` and `.nii.gz`.
//!
//! The file's world is RAS in its own length unit; inside it is LPS in metres, so x and y change sign
//! and lengths are scaled. Where the voxels are comes from the sform if its code is positive, else from
//! the qform; a file with neither says nothing about left and right and is refused.
//! Voxel sizes (`pixdim`) are always checked, and must agree with the sform.
//! Names and colours of labels travel inside the file, as JSON in a comment extension (ecode 6):
//! `{"label_names": {"1": "liver"}, "label_colours": {"1": [0.7, 0.3, 0.2]}}`. The label tables that TotalSegmentator
//! and Connectome Workbench write are read too.
//!
//! Source of the layout: R. W. Cox et al., A (sort of) new image data format standard: NIfTI-1, 2004,
//! <https://nifti.nimh.nih.gov/nifti-1>.

mod header;
mod labels;
mod write;

use std::path::Path;

use self::header::{Header, N_HEADER_BYTES, parse_header};
use super::error::ImageError;
use super::format::ImageFormat;
use super::packed::read_measured;
use super::stored::{StoredData, StoredImage};
use crate::binary::ByteOrder;

/// The format's row of the table.
pub(super) const FORMAT: ImageFormat = ImageFormat {
    name: "NIfTI-1",
    extensions: &["nii", "nii.gz"],
    begins: |bytes| bytes.len() >= N_HEADER_BYTES && matches!(&bytes[344..348], b"n+1\0" | b"ni1\0"),
    read,
    write: Some(write::write),
};

fn read(file: &Path) -> Result<StoredImage, ImageError> {
    let measure = |bytes: &[u8]| {
        let header = parse_header(file, bytes)?;
        let n_bytes = header.n_file_bytes();
        Ok((header, n_bytes))
    };
    let mismatch = |header: &Header, expected, found| ImageError::SizeMismatch {
        file: file.to_path_buf(),
        expected,
        found,
        dims: header.grid.dims,
        n_bytes_a_voxel: header.voxel_type.n_bytes(),
        data_start: header.data_start,
    };
    let (header, bytes) = read_measured(file, N_HEADER_BYTES, measure, mismatch)?;
    let is_big_endian = header.order == ByteOrder::Big;
    let labels = labels::labels_in(&bytes[N_HEADER_BYTES..header.data_start], is_big_endian);
    let data = StoredData {
        slope: header.slope,
        intercept: header.intercept,
        ..StoredData::plain(header.voxel_type, header.order, bytes, header.data_start)
    };
    let mut image = StoredImage::new(file, FORMAT.name, header.grid, data);
    labels.name_labels_of(&mut image);
    Ok(image)
}
