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

use std::collections::BTreeMap;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::read::MultiGzDecoder;
use flate2::write::GzEncoder;

use super::{LabelMap, Volume, VoxelGrid};
use crate::files::write_atomically;
use crate::math::{DMat3, DVec3};

/// Bytes of a NIfTI-1 header.
const N_HEADER_BYTES: usize = 348;
/// First byte after the header and the four bytes that say whether extensions follow.
const N_BYTES_BEFORE_EXTENSIONS: usize = 352;
/// A deflate stream grows by at most this factor (258 bytes from 2 bits).
const MAX_DEFLATE_RATIO: u64 = 1032;
/// Largest cosine between two voxel axes that still counts as a right angle: 0.15 mm over 300 mm.
const MAX_SHEAR: f64 = 5e-4;
/// Largest relative difference of the voxel sizes in sform and pixdim.
const MAX_SPACING_DIFFERENCE: f64 = 0.01;
/// Extension code of a plain-text comment.
const COMMENT_EXTENSION: i32 = 6;
/// Key under which the label names stand in the comment's JSON.
const NAMES_KEY: &str = "label_names";

/// Why an image file could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// The file system refused.
    #[error("{}: {source}", .file.display())]
    Io {
        /// The image file.
        file: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The gzip stream ends early or is damaged.
    #[error(
        "{}: damaged or truncated gzip stream: {source} after {n_bytes} decompressed bytes{}; copy the file again",
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

/// Number type of the voxels in a file, with its NIfTI code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum VoxelType {
    U8 = 2,
    I16 = 4,
    I32 = 8,
    F32 = 16,
    F64 = 64,
    I8 = 256,
    U16 = 512,
    U32 = 768,
}

impl VoxelType {
    const ALL: [Self; 8] =
        [Self::U8, Self::I16, Self::I32, Self::F32, Self::F64, Self::I8, Self::U16, Self::U32];

    fn n_bytes(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::F32 | Self::U32 => 4,
            Self::F64 => 8,
        }
    }
}

/// What the header says, checked.
#[derive(Debug)]
struct Header {
    big_endian: bool,
    grid: VoxelGrid,
    voxel_type: VoxelType,
    data_start: usize,
    slope: f64,
    intercept: f64,
}

impl Header {
    fn n_data_bytes(&self) -> Option<u64> {
        let n = self.grid.dims.iter().try_fold(1u64, |n, &d| n.checked_mul(d as u64))?;
        n.checked_mul(self.voxel_type.n_bytes() as u64)
    }
}

/// The header's bytes with their byte order.
struct RawHeader<'a> {
    file: &'a Path,
    bytes: &'a [u8],
    big_endian: bool,
}

impl RawHeader<'_> {
    fn array<const N: usize>(&self, byte: usize) -> [u8; N] {
        let mut a: [u8; N] = self.bytes[byte..byte + N].try_into().expect("the slice has N bytes");
        if self.big_endian {
            a.reverse();
        }
        a
    }

    fn i16(&self, byte: usize) -> i16 {
        i16::from_le_bytes(self.array(byte))
    }

    fn f32(&self, byte: usize) -> f64 {
        f64::from(f32::from_le_bytes(self.array(byte)))
    }

    fn vector(&self, byte: usize) -> DVec3 {
        DVec3::new(self.f32(byte), self.f32(byte + 4), self.f32(byte + 8))
    }

    fn wrong(
        &self,
        field: &'static str,
        byte: usize,
        found: impl std::fmt::Display,
        allowed: impl Into<String>,
    ) -> ImageError {
        ImageError::Header {
            file: self.file.to_path_buf(),
            field,
            byte,
            found: found.to_string(),
            allowed: allowed.into(),
        }
    }

    fn dims(&self) -> Result<[usize; 3], ImageError> {
        let n_dims = self.i16(40);
        if !(3..=7).contains(&n_dims) {
            return Err(self.wrong("dim[0]", 40, n_dims, "3 to 7 (a volume has three dimensions)"));
        }
        let mut dims = [0; 3];
        for axis in 0..n_dims as usize {
            let byte = 42 + 2 * axis;
            let found = self.i16(byte);
            if axis < 3 {
                if found < 1 {
                    return Err(self.wrong(["dim[1]", "dim[2]", "dim[3]"][axis], byte, found, "1 to 32767"));
                }
                dims[axis] = found as usize;
            } else if found > 1 {
                let names = ["dim[4]", "dim[5]", "dim[6]", "dim[7]"];
                return Err(self.wrong(names[axis - 3], byte, found, "1: one volume a file; split a series"));
            }
        }
        Ok(dims)
    }

    fn voxel_type(&self) -> Result<VoxelType, ImageError> {
        let code = self.i16(70);
        let voxel_type = VoxelType::ALL.into_iter().find(|t| *t as i16 == code).ok_or_else(|| {
            let allowed =
                "2 uint8, 4 int16, 8 int32, 16 float32, 64 float64, 256 int8, 512 uint16, 768 uint32";
            self.wrong("datatype", 70, code, allowed)
        })?;
        let n_bits = 8 * voxel_type.n_bytes();
        if self.i16(72) as usize != n_bits {
            return Err(self.wrong("bitpix", 72, self.i16(72), format!("{n_bits} for datatype {code}")));
        }
        Ok(voxel_type)
    }

    fn metres_a_unit(&self) -> Result<f64, ImageError> {
        match self.bytes[123] & 7 {
            1 => Ok(1.0),
            // Unknown is read as the millimetres that nearly every program means.
            0 | 2 => Ok(1e-3),
            3 => Ok(1e-6),
            code => Err(self.wrong("xyzt_units", 123, code, "length unit 1 m, 2 mm, 3 micrometre or 0")),
        }
    }

    /// Voxel sizes in the file's unit.
    fn pixdim(&self) -> Result<DVec3, ImageError> {
        for axis in 0..3 {
            let byte = 80 + 4 * axis;
            let found = self.f32(byte);
            if !(found.is_finite() && found > 0.0) {
                let name = ["pixdim[1]", "pixdim[2]", "pixdim[3]"][axis];
                return Err(self.wrong(name, byte, found, "a finite voxel size above 0"));
            }
        }
        Ok(self.vector(80))
    }

    /// Columns of the voxel-to-RAS matrix and its offset, in the file's unit.
    fn affine(&self, spacing: DVec3) -> Result<(DMat3, DVec3), ImageError> {
        if self.i16(254) > 0 {
            let rows = DMat3::from_cols(self.vector(280), self.vector(296), self.vector(312));
            let offset = DVec3::new(self.f32(292), self.f32(308), self.f32(324));
            if !(rows.is_finite() && offset.is_finite()) {
                return Err(self.wrong("srow_x, srow_y, srow_z", 280, "not finite", "finite numbers"));
            }
            return Ok((rows.transpose(), offset));
        }
        if self.i16(252) > 0 {
            let (q, offset) = (self.vector(256), self.vector(268));
            if !(q.is_finite() && offset.is_finite()) {
                return Err(self.wrong("quatern_b to qoffset_z", 256, "not finite", "finite numbers"));
            }
            let squared = q.length_squared();
            if squared > 1.0 + 1e-4 {
                return Err(self.wrong("quatern_b, c, d", 256, q, "a length of at most 1"));
            }
            let w = (1.0 - squared).max(0.0).sqrt();
            let rotation = DMat3::from_quat(glam::DQuat::from_xyzw(q.x, q.y, q.z, w).normalize());
            let handedness = if self.f32(76) < 0.0 { -1.0 } else { 1.0 };
            let scale = DMat3::from_diagonal(spacing * DVec3::new(1.0, 1.0, handedness));
            return Ok((rotation * scale, offset));
        }
        Err(ImageError::NoOrientation { file: self.file.to_path_buf() })
    }

    fn grid(&self, dims: [usize; 3]) -> Result<VoxelGrid, ImageError> {
        let (unit_m, pixdim) = (self.metres_a_unit()?, self.pixdim()?);
        let (matrix, offset) = self.affine(pixdim)?;
        let columns = [matrix.x_axis, matrix.y_axis, matrix.z_axis];
        let mut axes = [DVec3::ZERO; 3];
        for axis in 0..3 {
            let length = columns[axis].length();
            if (length / pixdim[axis] - 1.0).abs() > MAX_SPACING_DIFFERENCE {
                let allowed = format!("{length} +- 1 % as in the sform; correct one of the two");
                let name = ["pixdim[1]", "pixdim[2]", "pixdim[3]"][axis];
                return Err(self.wrong(name, 80 + 4 * axis, pixdim[axis], allowed));
            }
            axes[axis] = columns[axis] / length;
        }
        for [a, b] in [[0, 1], [0, 2], [1, 2]] {
            let cosine = axes[a].dot(axes[b]);
            if cosine.abs() > MAX_SHEAR {
                let angle_deg = libm::acos(cosine.clamp(-1.0, 1.0)).to_degrees();
                return Err(ImageError::Sheared { file: self.file.to_path_buf(), axes: [a, b], angle_deg });
            }
        }
        // What is left of the shear is rounding: make the axes exactly orthonormal.
        let x = axes[0];
        let y = (axes[1] - x * x.dot(axes[1])).normalize();
        let z = x.cross(y);
        let z = if z.dot(axes[2]) < 0.0 { -z } else { z };
        let lps_from_ras = DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0));
        Ok(VoxelGrid {
            dims,
            spacing_m: pixdim * unit_m,
            origin_m: lps_from_ras * offset * unit_m,
            axes: lps_from_ras * DMat3::from_cols(x, y, z),
        })
    }
}

fn parse_header(file: &Path, bytes: &[u8]) -> Result<Header, ImageError> {
    let mut raw = RawHeader { file, bytes, big_endian: false };
    if bytes.len() < N_HEADER_BYTES {
        let allowed = format!("at least {N_HEADER_BYTES} bytes: not a NIfTI-1 file");
        return Err(raw.wrong("(whole header)", 0, format!("{} bytes long", bytes.len()), allowed));
    }
    let size = i32::from_le_bytes(raw.array(0));
    match (size, size.swap_bytes()) {
        (348, _) => {}
        (_, 348) => raw.big_endian = true,
        (540, _) | (_, 540) => {
            return Err(raw.wrong("sizeof_hdr", 0, "540 (NIfTI-2)", "348: convert the file to NIfTI-1"));
        }
        _ => return Err(raw.wrong("sizeof_hdr", 0, size, "348: this is not a NIfTI-1 file")),
    }
    match &bytes[344..348] {
        b"n+1\0" => {}
        b"ni1\0" => {
            return Err(raw.wrong("magic", 344, "ni1 (.hdr and .img pair)", "n+1: convert to one .nii file"));
        }
        found => {
            return Err(raw.wrong("magic", 344, found.escape_ascii(), "n+1: this is not a NIfTI-1 file"));
        }
    }
    let dims = raw.dims()?;
    let voxel_type = raw.voxel_type()?;
    let data_start = raw.f32(108);
    let n_before = N_BYTES_BEFORE_EXTENSIONS as f64;
    if !(data_start >= n_before && data_start < f64::from(1 << 24) && data_start.fract() == 0.0) {
        return Err(raw.wrong("vox_offset", 108, data_start, "a whole number from 352 to 16777215"));
    }
    let (mut slope, mut intercept) = (raw.f32(112), raw.f32(116));
    // The standard: slope 0 is no scaling. Some programs write NaN for the same.
    if slope == 0.0 || slope.is_nan() {
        (slope, intercept) = (1.0, 0.0);
    }
    if !(slope.is_finite() && intercept.is_finite()) {
        let found = format!("{slope}, {intercept}");
        return Err(raw.wrong("scl_slope, scl_inter", 112, found, "finite numbers"));
    }
    Ok(Header {
        big_endian: raw.big_endian,
        grid: raw.grid(dims)?,
        voxel_type,
        data_start: data_start as usize,
        slope,
        intercept,
    })
}

/// The checked header and all bytes of the file, decompressed: exactly as many as the header promises.
fn read_bytes(file: &Path) -> Result<(Header, Vec<u8>), ImageError> {
    let io_error = |source| ImageError::Io { file: file.to_path_buf(), source };
    let stored = std::fs::read(file).map_err(io_error)?;
    if !stored.starts_with(&[0x1f, 0x8b]) {
        let header = parse_header(file, &stored)?;
        let expected = expected_bytes(file, &header, stored.len() as u64)?;
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
    let expected = expected_bytes(file, &header, (stored.len() as u64).saturating_mul(MAX_DEFLATE_RATIO))?;
    // `take` and a growing vector: memory follows the bytes that really come out.
    let result = (&mut decoder).take(expected - bytes.len() as u64).read_to_end(&mut bytes);
    result.map_err(damaged(bytes.len(), Some(expected)))?;
    // To the end of the stream, for its checksum and for bytes that should not be there.
    let surplus = io::copy(&mut decoder, &mut io::sink()).map_err(damaged(bytes.len(), Some(expected)))?;
    let found = bytes.len() as u64 + surplus;
    match found == expected {
        true => Ok((header, bytes)),
        false => Err(size_mismatch(file, &header, expected, found)),
    }
}

/// Bytes the header promises; an error when that is more than `n_possible`.
fn expected_bytes(file: &Path, header: &Header, n_possible: u64) -> Result<u64, ImageError> {
    let expected = header.n_data_bytes().and_then(|n| n.checked_add(header.data_start as u64));
    match expected {
        Some(n) if n <= n_possible => Ok(n),
        _ => Err(size_mismatch(file, header, expected.unwrap_or(u64::MAX), n_possible)),
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

/// Comment extension that holds `names`, padded to a multiple of 16 bytes; nothing for no names.
fn names_extension(names: &[(u16, String)]) -> Vec<u8> {
    if names.is_empty() {
        return Vec::new();
    }
    let names: BTreeMap<u16, &str> = names.iter().map(|(label, name)| (*label, name.as_str())).collect();
    let comment = BTreeMap::from([(NAMES_KEY, names)]);
    let json = serde_json::to_vec(&comment).expect("maps of numbers and text always serialize");
    let size = (8 + json.len()).next_multiple_of(16);
    let mut bytes = Vec::with_capacity(size);
    bytes.extend((size as i32).to_le_bytes());
    bytes.extend(COMMENT_EXTENSION.to_le_bytes());
    bytes.extend(json);
    bytes.resize(size, 0);
    bytes
}

/// Header and extension bytes of a file with this grid and voxel type.
fn header_bytes(grid: &VoxelGrid, voxel_type: VoxelType, extension: &[u8]) -> Vec<u8> {
    let mut bytes = vec![0; N_BYTES_BEFORE_EXTENSIONS];
    let mut put = |byte: usize, value: &[u8]| bytes[byte..byte + value.len()].copy_from_slice(value);
    put(0, &348i32.to_le_bytes());
    for (axis, n) in [3, grid.dims[0], grid.dims[1], grid.dims[2], 1, 1, 1, 1].into_iter().enumerate() {
        put(40 + 2 * axis, &(n as i16).to_le_bytes());
    }
    put(70, &(voxel_type as i16).to_le_bytes());
    put(72, &(8 * voxel_type.n_bytes() as i16).to_le_bytes());
    let ras_from_lps = DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0));
    let axes = ras_from_lps * grid.axes;
    let handedness = if axes.determinant() < 0.0 { -1.0 } else { 1.0 };
    let (spacing_mm, offset_mm) = (grid.spacing_m * 1e3, ras_from_lps * grid.origin_m * 1e3);
    for (axis, size) in [handedness, spacing_mm.x, spacing_mm.y, spacing_mm.z].into_iter().enumerate() {
        put(76 + 4 * axis, &(size as f32).to_le_bytes());
    }
    put(108, &((N_BYTES_BEFORE_EXTENSIONS + extension.len()) as f32).to_le_bytes());
    put(112, &1f32.to_le_bytes());
    put(123, &[2]);
    // Code 1: the scanner's frame, for both forms.
    put(252, &1i16.to_le_bytes());
    put(254, &1i16.to_le_bytes());
    let rotation = DMat3::from_cols(axes.x_axis, axes.y_axis, axes.z_axis * handedness);
    let q = glam::DQuat::from_mat3(&rotation).normalize();
    let q = if q.w < 0.0 { -q } else { q };
    for (place, value) in [q.x, q.y, q.z, offset_mm.x, offset_mm.y, offset_mm.z].into_iter().enumerate() {
        put(256 + 4 * place, &(value as f32).to_le_bytes());
    }
    let matrix = axes * DMat3::from_diagonal(spacing_mm);
    for row in 0..3 {
        let values = [matrix.x_axis[row], matrix.y_axis[row], matrix.z_axis[row], offset_mm[row]];
        for (column, value) in values.into_iter().enumerate() {
            put(280 + 16 * row + 4 * column, &(value as f32).to_le_bytes());
        }
    }
    put(344, b"n+1\0");
    if !extension.is_empty() {
        put(348, &[1]);
        bytes.extend(extension);
    }
    bytes
}

fn write_file(path: &Path, grid: &VoxelGrid, header: &[u8], data: &[u8]) -> Result<(), ImageError> {
    let unwritable = |reason: String| Err(ImageError::Unwritable { file: path.to_path_buf(), reason });
    if let Some(axis) = (0..3).find(|&a| !(1..=32767).contains(&grid.dims[a])) {
        return unwritable(format!("{} voxels along axis {axis}, 1 to 32767 allowed", grid.dims[axis]));
    }
    if !(grid.spacing_m.is_finite() && grid.spacing_m.min_element() > 0.0 && grid.origin_m.is_finite()) {
        return unwritable(format!("voxel size {} m, above 0 allowed", grid.spacing_m));
    }
    let name = path.file_name().map(|n| n.to_string_lossy().to_lowercase()).unwrap_or_default();
    let write = |out: &mut dyn Write| out.write_all(header).and_then(|()| out.write_all(data));
    let result = if name.ends_with(".nii.gz") {
        write_atomically(path, |out| {
            // Noise does not compress: the fast level costs little size and saves seconds.
            let mut encoder = GzEncoder::new(out, Compression::fast());
            write(&mut encoder)?;
            encoder.finish().map(|_| ())
        })
    } else if name.ends_with(".nii") {
        write_atomically(path, |out| write(out))
    } else {
        return unwritable("the name must end in .nii or .nii.gz".into());
    };
    result.map_err(|source| ImageError::Io { file: path.to_path_buf(), source })
}

/// Writes a volume as NIfTI-1: 16-bit integers when every value is one (as CT numbers are), else 32-bit
/// floats. Gzipped when the name ends in `.nii.gz`.
///
/// # Errors
/// A name that ends otherwise, dimensions NIfTI-1 cannot hold, or a refusal of the file system.
pub fn write_volume(path: &Path, volume: &Volume<f32>) -> Result<(), ImageError> {
    assert_eq!(volume.values.len(), volume.grid.n_voxels(), "one value a voxel");
    let whole = volume.values.iter().all(|&v| f32::from(v as i16) == v);
    let (voxel_type, data): (_, Vec<u8>) = if whole {
        (VoxelType::I16, volume.values.iter().flat_map(|&v| (v as i16).to_le_bytes()).collect())
    } else {
        (VoxelType::F32, volume.values.iter().flat_map(|v| v.to_le_bytes()).collect())
    };
    write_file(path, &volume.grid, &header_bytes(&volume.grid, voxel_type, &[]), &data)
}

/// Writes a label map as NIfTI-1 with 16-bit unsigned labels, names included.
/// Gzipped when the name ends in `.nii.gz`.
///
/// # Errors
/// As [`write_volume`].
pub fn write_label_map(path: &Path, map: &LabelMap) -> Result<(), ImageError> {
    assert_eq!(map.labels.len(), map.grid.n_voxels(), "one label a voxel");
    let data: Vec<u8> = map.labels.iter().flat_map(|label| label.to_le_bytes()).collect();
    let header = header_bytes(&map.grid, VoxelType::U16, &names_extension(&map.names));
    write_file(path, &map.grid, &header, &data)
}
