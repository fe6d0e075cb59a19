//! INRIMAGE-4, `.inr` and `.inr.gz`, read only.
//!
//! The format has no axes: it does not say which side is left. Voxels are read as they lie, i to +x, j to +y, k to +z
//! in LPS, and a note says so. Sizes (`VX`, `VY`, `VZ`) are millimetres; `TX`, `TY`, `TZ`, where a file has them, are
//! the place of the first voxel.
//!
//! Source of the layout: G. Malandain, the INRIMAGE file format, as used by INRIA's tools and CGAL's `CGAL_ImageIO`.

use std::path::Path;

use super::error::{HeaderPlace, ImageError};
use super::format::ImageFormat;
use super::packed::read_measured;
use super::placement::right_angled;
use super::stored::{StoredData, StoredImage};
use super::text_header::{Field, TextHeader, line_at};
use crate::binary::{ByteOrder, NumberType};
use crate::image::VoxelGrid;
use crate::math::DVec3;

/// The format's row of the table.
pub(super) const FORMAT: ImageFormat = ImageFormat {
    name: "INRIMAGE-4",
    extensions: &["inr", "inr.gz"],
    begins: |bytes| bytes.starts_with(MAGIC),
    read,
    write: None,
};

const MAGIC: &[u8] = b"#INRIMAGE-4#{";
/// What ends a header.
const END: &[u8] = b"##}\n";
/// A header is filled up with line ends to a multiple of this.
const N_BLOCK_BYTES: usize = 256;
/// A header has at most so many bytes.
const MAX_HEADER_BYTES: usize = 64 * N_BLOCK_BYTES;

/// Processors and their byte order.
const PROCESSORS: &[(&str, ByteOrder)] = &[
    ("decm", ByteOrder::Little),
    ("alpha", ByteOrder::Little),
    ("pc", ByteOrder::Little),
    ("sun", ByteOrder::Big),
    ("sgi", ByteOrder::Big),
];

/// What a header says, checked.
#[derive(Debug)]
struct Header {
    grid: VoxelGrid,
    kind: NumberType,
    order: ByteOrder,
    n_bytes: usize,
    /// Numbers are stored divided by this.
    scale: f64,
}

fn parse_header(file: &Path, bytes: &[u8]) -> Result<Header, ImageError> {
    let whole = |found: String, allowed: &str| ImageError::Header {
        file: file.to_path_buf(),
        field: "(header)".into(),
        place: HeaderPlace::Byte(0),
        found,
        allowed: allowed.into(),
    };
    if !bytes.starts_with(MAGIC) {
        let found = bytes[..bytes.len().min(13)].escape_ascii().to_string();
        return Err(whole(format!("\"{found}\""), "#INRIMAGE-4#{: this is not an INRIMAGE file"));
    }
    let end = bytes.windows(END.len()).position(|window| window == END);
    let Some(end) = end else {
        return Err(whole("without an end".into(), "##} within the first 16384 bytes"));
    };
    let n_bytes = (end + END.len()).next_multiple_of(N_BLOCK_BYTES);
    let mut header = TextHeader::new(file);
    let (mut at, mut number) = (0, 0);
    while let Some((line, next)) = line_at(&bytes[..end], at) {
        (at, number) = (next, number + 1);
        let text = String::from_utf8_lossy(line);
        if number == 1 || text.trim().is_empty() || text.starts_with('#') {
            continue;
        }
        let Some((key, value)) = text.split_once('=') else {
            let field = Field { key: "(line)".into(), value: text.into_owned(), line: number };
            return Err(header.wrong(&field, "\"KEY=value\""));
        };
        header.add(key, value, number);
    }
    let mut dims = [0; 3];
    for (dim, key) in dims.iter_mut().zip(["XDIM", "YDIM", "ZDIM"]) {
        *dim = header.whole(header.required(key)?, 1, 1 << 16)? as usize;
    }
    if let Some(values) = header.get("VDIM") {
        header.whole(values, 1, 1)?;
    }
    let number = |key: &str, default: f64| match header.get(key) {
        Some(field) => header.numbers::<1>(field).map(|[number]| number),
        None => Ok(default),
    };
    let spacing_mm = DVec3::new(number("VX", 1.0)?, number("VY", 1.0)?, number("VZ", 1.0)?);
    let origin_mm = DVec3::new(number("TX", 0.0)?, number("TY", 0.0)?, number("TZ", 0.0)?);
    let steps = [DVec3::X, DVec3::Y, DVec3::Z];
    let grid = right_angled(file, dims, steps, spacing_mm * 1e-3, origin_mm * 1e-3)?;
    let order = header.chosen(header.required("CPU")?, PROCESSORS)?;
    Ok(Header { grid, kind: number_type(&header)?, order, n_bytes, scale: scale(&header)? })
}

fn number_type(header: &TextHeader) -> Result<NumberType, ImageError> {
    let type_field = header.required("TYPE")?;
    let size_field = header.required("PIXSIZE")?;
    let words = [("float", None), ("unsigned fixed", Some(false)), ("signed fixed", Some(true))];
    let is_signed = header.chosen(type_field, &words)?;
    let n_bits =
        header.chosen(size_field, &[("8 bits", 8), ("16 bits", 16), ("32 bits", 32), ("64 bits", 64)])?;
    Ok(match (is_signed, n_bits) {
        (Some(false), 8) => NumberType::U8,
        (Some(true), 8) => NumberType::I8,
        (Some(false), 16) => NumberType::U16,
        (Some(true), 16) => NumberType::I16,
        (Some(false), 32) => NumberType::U32,
        (Some(true), 32) => NumberType::I32,
        (None, 32) => NumberType::F32,
        (None, 64) => NumberType::F64,
        _ => return Err(header.wrong(size_field, "8, 16 or 32 bits for fixed, 32 or 64 bits for float")),
    })
}

/// `SCALE=2**-3`: what stored numbers are to be multiplied with. Files with 0 mean none.
fn scale(header: &TextHeader) -> Result<f64, ImageError> {
    let Some(field) = header.get("SCALE") else { return Ok(1.0) };
    let exponent = field.value.strip_prefix("2**").and_then(|text| text.trim().parse::<i32>().ok());
    match exponent.filter(|exponent| (-64..=64).contains(exponent)) {
        Some(exponent) => Ok(libm::exp2(f64::from(exponent))),
        None => Err(header.wrong(field, "2** and a whole number from -64 to 64")),
    }
}

fn read(file: &Path) -> Result<StoredImage, ImageError> {
    let measure = |bytes: &[u8]| {
        let header = parse_header(file, bytes)?;
        // Sixteen bits a dimension and eight bytes a number cannot overflow.
        let n_bytes = header.n_bytes as u64 + header.grid.n_voxels() as u64 * header.kind.n_bytes() as u64;
        Ok((header, n_bytes))
    };
    let mismatch = |header: &Header, expected, found| ImageError::SizeMismatch {
        file: file.to_path_buf(),
        expected,
        found,
        dims: header.grid.dims,
        n_bytes_a_voxel: header.kind.n_bytes(),
        data_start: header.n_bytes,
    };
    let (header, bytes) = read_measured(file, MAX_HEADER_BYTES, measure, mismatch)?;
    let plain = StoredData::plain(header.kind, header.order, bytes, header.n_bytes);
    let data = StoredData { slope: header.scale, ..plain };
    let mut image = StoredImage::new(file, FORMAT.name, header.grid, data);
    image.notes.push(
        "INRIMAGE does not say which side is left; read with i to the left, j to the back and k to the head (LPS)"
            .into(),
    );
    Ok(image)
}
