//! Why an image file could not be read or written.

use std::fmt;
use std::io;
use std::path::PathBuf;

/// Where in a file's header something stands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum HeaderPlace {
    /// Byte, from 0.
    Byte(usize),
    /// Line, from 1.
    Line(usize),
    /// Element of a DICOM file.
    Tag {
        /// Group.
        group: u16,
        /// Element.
        element: u16,
    },
    /// The whole header: something is missing in it.
    Whole,
}

impl fmt::Display for HeaderPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Byte(byte) => write!(f, "byte {byte}"),
            Self::Line(line) => write!(f, "line {line}"),
            Self::Tag { group, element } => write!(f, "tag ({group:04X},{element:04X})"),
            Self::Whole => write!(f, "anywhere in it"),
        }
    }
}

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
    /// Neither the name nor the first bytes tell the format.
    #[error("{}: not an image that can be read ({found}); {allowed}", .file.display())]
    UnknownFormat {
        /// The image file.
        file: PathBuf,
        /// What it is called, or begins with.
        found: String,
        /// The formats.
        allowed: String,
    },
    /// The compressed stream ends early or is damaged.
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
    #[error("{}: header field {field} ({place}) is {found}, allowed: {allowed}", .file.display())]
    Header {
        /// The image file.
        file: PathBuf,
        /// Name of the field in the format.
        field: String,
        /// Where the field is in the header.
        place: HeaderPlace,
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
    /// Nothing says where left and right are.
    #[error("{}: {found}, so the file does not say which side is left; {remedy}", .file.display())]
    NoOrientation {
        /// The image file.
        file: PathBuf,
        /// What the file says instead.
        found: String,
        /// What to do.
        remedy: &'static str,
    },
    /// The voxel axes are not at right angles.
    #[error(
        "{}: voxel axes {axes:?} meet at {angle_deg:.3} degrees, 90 allowed (a tilted gantry?); resample the image to right-angled voxels",
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
    /// Voxels of a size that no image of a patient has.
    #[error(
        "{}: voxels of {found_mm} mm along axis {axis}, 0.001 to 100 mm allowed; correct the voxel size or the unit in the header",
        .file.display()
    )]
    Spacing {
        /// The image file.
        file: PathBuf,
        /// The axis (0 is i).
        axis: usize,
        /// The size found [mm].
        found_mm: f64,
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
    /// Files that should be one image and are not.
    #[error("{}: {reason}", .folder.display())]
    Series {
        /// The folder, or the file that names the others.
        folder: PathBuf,
        /// What was found, what is allowed, and what to do.
        reason: String,
    },
    /// The image cannot be written in this format.
    #[error("{}: cannot write: {reason}", .file.display())]
    Unwritable {
        /// The file that was to be written.
        file: PathBuf,
        /// What is wrong and what is allowed.
        reason: String,
    },
}
