//! The 348 bytes at the beginning of a NIfTI-1 file.

use std::path::Path;

use super::super::error::{HeaderPlace, ImageError};
use super::super::placement::{TURN_ABOUT_Z, right_angled};
use crate::binary::{ByteOrder, NumberType};
use crate::image::VoxelGrid;
use crate::math::{DMat3, DVec3};

/// Bytes of a NIfTI-1 header.
pub(super) const N_HEADER_BYTES: usize = 348;
/// First byte after the header and the four bytes that say whether extensions follow.
pub(super) const N_BYTES_BEFORE_EXTENSIONS: usize = 352;
/// Largest relative difference of the voxel sizes in sform and pixdim.
const MAX_SPACING_DIFFERENCE: f64 = 0.01;

/// Number types of voxels, with their NIfTI codes.
const VOXEL_TYPES: [(i16, NumberType); 10] = [
    (2, NumberType::U8),
    (4, NumberType::I16),
    (8, NumberType::I32),
    (16, NumberType::F32),
    (64, NumberType::F64),
    (256, NumberType::I8),
    (512, NumberType::U16),
    (768, NumberType::U32),
    (1024, NumberType::I64),
    (1280, NumberType::U64),
];

/// The code of a number type.
pub(super) fn code_of(voxel_type: NumberType) -> i16 {
    VOXEL_TYPES.iter().find(|(_, kind)| *kind == voxel_type).expect("every number type has its code").0
}

/// What the header says, checked.
#[derive(Debug)]
pub(super) struct Header {
    pub(super) order: ByteOrder,
    pub(super) grid: VoxelGrid,
    pub(super) voxel_type: NumberType,
    /// First byte of the voxels.
    pub(super) data_start: usize,
    /// Value = stored number * slope + intercept.
    pub(super) slope: f64,
    pub(super) intercept: f64,
}

impl Header {
    /// Bytes of the whole file. Three dimensions of 15 bits and 8 bytes a voxel cannot overflow.
    pub(super) fn n_file_bytes(&self) -> u64 {
        let n_voxels: u64 = self.grid.dims.iter().map(|&n| n as u64).product();
        self.data_start as u64 + n_voxels * self.voxel_type.n_bytes() as u64
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
            field: field.into(),
            place: HeaderPlace::Byte(byte),
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

    fn voxel_type(&self) -> Result<NumberType, ImageError> {
        let code = self.i16(70);
        let voxel_type = VOXEL_TYPES.iter().find(|(c, _)| *c == code).map(|(_, kind)| *kind);
        let voxel_type = voxel_type.ok_or_else(|| {
            let allowed = "2 uint8, 4 int16, 8 int32, 16 float32, 64 float64, 256 int8, 512 uint16, 768 uint32, 1024 int64, 1280 uint64";
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
        Err(ImageError::NoOrientation {
            file: self.file.to_path_buf(),
            found: "sform_code and qform_code are both 0".into(),
            remedy: "export it again with its orientation, or set one (e.g. with nibabel: img.set_sform(affine, code=1))",
        })
    }

    fn grid(&self, dims: [usize; 3]) -> Result<VoxelGrid, ImageError> {
        let (unit_m, pixdim) = (self.metres_a_unit()?, self.pixdim()?);
        let (matrix, offset) = self.affine(pixdim)?;
        let columns = [matrix.x_axis, matrix.y_axis, matrix.z_axis];
        for axis in 0..3 {
            let length = columns[axis].length();
            if (length / pixdim[axis] - 1.0).abs() > MAX_SPACING_DIFFERENCE {
                let allowed = format!("{length} +- 1 % as in the sform; correct one of the two");
                let name = ["pixdim[1]", "pixdim[2]", "pixdim[3]"][axis];
                return Err(self.wrong(name, 80 + 4 * axis, pixdim[axis], allowed));
            }
        }
        let steps = columns.map(|column| TURN_ABOUT_Z * column);
        right_angled(self.file, dims, steps, pixdim * unit_m, TURN_ABOUT_Z * offset * unit_m)
    }
}

/// The header at the beginning of `bytes`, every field checked.
pub(super) fn parse_header(file: &Path, bytes: &[u8]) -> Result<Header, ImageError> {
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
        order: if raw.big_endian { ByteOrder::Big } else { ByteOrder::Little },
        grid: raw.grid(dims)?,
        voxel_type,
        data_start: data_start as usize,
        slope,
        intercept,
    })
}
