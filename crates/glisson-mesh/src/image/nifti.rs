//! NIfTI-1 volumes and label maps, `.nii` and `.nii.gz`.
//!
//! The file's world is RAS in its own length unit; inside it is LPS in metres, so x and y change sign
//! and lengths are scaled. Where the voxels are comes from the sform if its code is positive, else from
//! the qform; a file with neither says nothing about left and right and is refused.
//! Voxel sizes (`pixdim`) are always checked, and must agree with the sform.
//! Names of labels travel inside the file, as JSON in a comment extension (ecode 6):
//! `{"label_names": {"1": "liver"}}`.
//!
//! Source of the layout: R. W. Cox et al., A (sort of) new image data format standard: NIfTI-1, 2004,
//! <https://nifti.nimh.nih.gov/nifti-1>.

mod header;
mod write;

use std::collections::BTreeMap;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use flate2::read::MultiGzDecoder;

use self::header::{Header, N_HEADER_BYTES, VoxelType, parse_header};
pub use self::write::{write_label_map, write_volume};
use super::{LabelMap, Volume};

/// A deflate stream grows by at most this factor (258 bytes from 2 bits).
const MAX_DEFLATE_RATIO: u64 = 1032;
/// Extension code of a plain-text comment.
const COMMENT_EXTENSION: i32 = 6;
/// Key under which the label names stand in the comment's JSON.
const NAMES_KEY: &str = "label_names";

/// Why an image file could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// The file system refused.
    #[error("{}: cannot be read or written", .file.display())]
    Io {
        /// The image file.
        file: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The gzip stream ends early or is damaged.
    #[error(
        "{}: damaged or truncated gzip stream after {n_bytes} decompressed bytes{}; copy the file again",
        .file.display(), .n_expected.map_or(String::new(), |n| format!(" of {n}"))
    )]
    Gzip {
        /// The image file.
        file: PathBuf,
        /// Bytes that came out before the damage.
        n_bytes: u64,
        /// Bytes the header promised, once it is known.
        n_expected: Option<u64>,
        /// What the decompressor said.
        source: io::Error,
    },
    /// A header field holds a value that is not allowed or not supported.
    #[error("{}: header field {field} (byte {byte}) is {found}, allowed: {allowed}", .file.display())]
    Header {
        /// The image file.
        file: PathBuf,
        /// Name of the field in the NIfTI-1 layout.
        field: &'static str,
        /// Where the field starts in the header.
        byte: usize,
        /// The value found.
        found: String,
        /// What would be right, or what to do.
        allowed: String,
    },
    /// The header promises another number of bytes than the file has.
    #[error(
        "{}: {found} bytes found, {expected} expected from the header (dimensions {dims:?}, {n_bytes_a_voxel} bytes a voxel, data from byte {data_start}); the header's dimensions are wrong or the file is cut",
        .file.display()
    )]
    SizeMismatch {
        /// The image file.
        file: PathBuf,
        /// Bytes the header promises.
        expected: u64,
        /// Bytes the file has, decompressed.
        found: u64,
        /// Dimensions in the header.
        dims: [usize; 3],
        /// Bytes a voxel takes.
        n_bytes_a_voxel: usize,
        /// Where the voxels start.
        data_start: usize,
    },
    /// Neither sform nor qform: left and right are unknown.
    #[error(
        "{}: sform_code and qform_code are both 0, so the file does not say which side is left; export it again with its orientation, or set one (e.g. with nibabel: img.set_sform(affine, code=1))",
        .file.display()
    )]
    NoOrientation {
        /// The image file.
        file: PathBuf,
    },
    /// The voxel axes are not at right angles.
    #[error(
        "{}: sform axes {axes:?} meet at {angle_deg:.3} degrees, 90 allowed (a tilted gantry?); resample the image to right-angled voxels",
        .file.display()
    )]
    Sheared {
        /// The image file.
        file: PathBuf,
        /// The two axes (0 is i).
        axes: [usize; 2],
        /// Their angle.
        angle_deg: f64,
    },
    /// A voxel of a label map is not a whole number from 0 to 65535.
    #[error("{}: voxel {voxel:?} is {found}, labels are whole numbers from 0 to 65535: not a label map", .file.display())]
    NotALabel {
        /// The image file.
        file: PathBuf,
        /// Voxel (i, j, k).
        voxel: [usize; 3],
        /// The value found.
        found: f64,
    },
    /// The image cannot be written as NIfTI-1.
    #[error("{}: cannot write: {reason}", .file.display())]
    Unwritable {
        /// The file that was to be written.
        file: PathBuf,
        /// What is wrong and what is allowed.
        reason: String,
    },
}

/// The checked header and all bytes of the file, decompressed: exactly as many as the header promises.
fn read_bytes(file: &Path) -> Result<(Header, Vec<u8>), ImageError> {
    let io_error = |source| ImageError::Io { file: file.to_path_buf(), source };
    let stored = std::fs::read(file).map_err(io_error)?;
    if !stored.starts_with(&[0x1f, 0x8b]) {
        let header = parse_header(file, &stored)?;
        let expected = header.n_file_bytes();
        return match stored.len() as u64 == expected {
            true => Ok((header, stored)),
            false => Err(size_mismatch(file, &header, expected, stored.len() as u64)),
        };
    }
    let mut decoder = MultiGzDecoder::new(stored.as_slice());
    let mut bytes = Vec::new();
    let damaged = |n_bytes: usize, n_expected| {
        move |source| ImageError::Gzip {
            file: file.to_path_buf(),
            n_bytes: n_bytes as u64,
            n_expected,
            source,
        }
    };
    let result = (&mut decoder).take(N_HEADER_BYTES as u64).read_to_end(&mut bytes);
    result.map_err(damaged(bytes.len(), None))?;
    let header = parse_header(file, &bytes)?;
    let expected = header.n_file_bytes();
    let possible = expected <= (stored.len() as u64).saturating_mul(MAX_DEFLATE_RATIO);
    if possible {
        // `take` and a growing vector: memory follows the bytes that really come out.
        let result = (&mut decoder).take(expected - bytes.len() as u64).read_to_end(&mut bytes);
        result.map_err(damaged(bytes.len(), Some(expected)))?;
    }
    // To the end of the stream, keeping nothing: for its checksum, and to count what is too much.
    let mut surplus = CountingSink(0);
    let result = io::copy(&mut decoder, &mut surplus);
    let found = bytes.len() as u64 + surplus.0;
    result.map_err(damaged(found as usize, Some(expected)))?;
    match possible && found == expected {
        true => Ok((header, bytes)),
        false => Err(size_mismatch(file, &header, expected, found)),
    }
}

/// Counts the bytes written to it.
struct CountingSink(u64);

impl io::Write for CountingSink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0 += bytes.len() as u64;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

fn size_mismatch(file: &Path, header: &Header, expected: u64, found: u64) -> ImageError {
    ImageError::SizeMismatch {
        file: file.to_path_buf(),
        expected,
        found,
        dims: header.grid.dims,
        n_bytes_a_voxel: header.voxel_type.n_bytes(),
        data_start: header.data_start,
    }
}

/// Calls `visit` with each voxel's scaled value, in file order.
fn for_each_value<E>(
    header: &Header,
    data: &[u8],
    mut visit: impl FnMut(usize, f64) -> Result<(), E>,
) -> Result<(), E> {
    macro_rules! decode {
        ($number:ty) => {
            for (index, bytes) in data.chunks_exact(size_of::<$number>()).enumerate() {
                let bytes = bytes.try_into().expect("chunks have the number's size");
                let stored = match header.big_endian {
                    true => <$number>::from_be_bytes(bytes),
                    false => <$number>::from_le_bytes(bytes),
                };
                visit(index, f64::from(stored) * header.slope + header.intercept)?;
            }
        };
    }
    match header.voxel_type {
        VoxelType::U8 => decode!(u8),
        VoxelType::I8 => decode!(i8),
        VoxelType::I16 => decode!(i16),
        VoxelType::U16 => decode!(u16),
        VoxelType::I32 => decode!(i32),
        VoxelType::U32 => decode!(u32),
        VoxelType::F32 => decode!(f32),
        VoxelType::F64 => decode!(f64),
    }
    Ok(())
}

/// Volume in a NIfTI-1 file, its values scaled by the header's slope and intercept.
///
/// # Errors
/// Damaged or truncated gzip, a header field out of range or not supported, another number of bytes than
/// the header promises, no orientation, or voxel axes that are not at right angles.
pub fn read_volume(path: &Path) -> Result<Volume<f32>, ImageError> {
    let (header, bytes) = read_bytes(path)?;
    let mut values = Vec::with_capacity(header.grid.n_voxels());
    for_each_value(&header, &bytes[header.data_start..], |_, value| {
        values.push(value as f32);
        Ok::<(), ImageError>(())
    })?;
    Ok(Volume { grid: header.grid, values })
}

/// Label map in a NIfTI-1 file, with the names its comment extension gives.
///
/// # Errors
/// As [`read_volume`], and a voxel that is not a whole number from 0 to 65535.
pub fn read_label_map(path: &Path) -> Result<LabelMap, ImageError> {
    let (header, bytes) = read_bytes(path)?;
    let mut labels = Vec::with_capacity(header.grid.n_voxels());
    for_each_value(&header, &bytes[header.data_start..], |index, value| {
        if !(0.0..=65535.0).contains(&value) || value.fract() != 0.0 {
            let voxel = header.grid.voxel(index);
            return Err(ImageError::NotALabel { file: path.to_path_buf(), voxel, found: value });
        }
        labels.push(value as u16);
        Ok(())
    })?;
    let names = label_names(&bytes[N_HEADER_BYTES..header.data_start], header.big_endian);
    Ok(LabelMap { grid: header.grid, labels, names })
}

/// Names in the first comment extension that has them. Comments of other programs are passed over.
fn label_names(extensions: &[u8], big_endian: bool) -> Vec<(u16, String)> {
    let i32_at = |byte: usize| -> Option<i32> {
        let bytes = extensions.get(byte..byte + 4)?.try_into().ok()?;
        Some(if big_endian { i32::from_be_bytes(bytes) } else { i32::from_le_bytes(bytes) })
    };
    if extensions.first().is_none_or(|&flag| flag == 0) {
        return Vec::new();
    }
    let mut at = 4;
    while let (Some(size), Some(code)) = (i32_at(at), i32_at(at + 4)) {
        let Some(content) = usize::try_from(size).ok().and_then(|n| extensions.get(at + 8..at + n)) else {
            break;
        };
        if code == COMMENT_EXTENSION {
            let end = content.iter().rposition(|&b| b != 0).map_or(0, |last| last + 1);
            let found = serde_json::from_slice::<BTreeMap<String, BTreeMap<u16, String>>>(&content[..end]);
            if let Some(names) = found.ok().and_then(|mut comment| comment.remove(NAMES_KEY)) {
                return names.into_iter().collect();
            }
        }
        at += size as usize;
    }
    Vec::new()
}
