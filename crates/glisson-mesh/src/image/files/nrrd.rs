//! NRRD, `.nrrd`, `.nhdr` and 3D Slicer's segmentations, `.seg.nrrd`.
//!
//! The frame is the header's `space` (LPS, RAS or LAS); a file without one does not say which side is left and is
//! refused. Lengths are millimetres unless `space units` says otherwise. Names, colours and numbers of segments are
//! read from `Segment0_Name` and its like; a segmentation of several layers becomes one label map, in which a later
//! layer lies over an earlier one. Data are read as raw, gzip, text or hexadecimal numbers, in the file or beside it
//! in one `data file`, and written as gzip in the file.
//!
//! Source of the layout: G. Kindlmann, Definition of NRRD File Format, <https://teem.sourceforge.net/nrrd/format.html>;
//! for segmentations: 3D Slicer, documentation of the segmentations module, file format.

mod segments;
mod write;

use std::path::Path;

use self::segments::{merged, segments_of};
use super::error::{HeaderPlace, ImageError};
use super::format::ImageFormat;
use super::packed::{Packing, load, unpack};
use super::placement::right_angled;
use super::stored::{StoredData, StoredImage};
use super::text_header::{Field, MAX_HEADER_BYTES, TextHeader, beside, line_at, numbers_in_text};
use crate::binary::{ByteOrder, NumberType};
use crate::math::DVec3;

/// The format's row of the table.
pub(super) const FORMAT: ImageFormat = ImageFormat {
    name: "NRRD",
    extensions: &["nrrd", "nhdr", "seg.nrrd"],
    begins: |bytes| bytes.starts_with(b"NRRD000"),
    read,
    write: Some(write::write),
};

/// The names of number types.
const TYPES: &[(&str, NumberType)] = &[
    ("short", NumberType::I16),
    ("unsigned short", NumberType::U16),
    ("unsigned char", NumberType::U8),
    ("signed char", NumberType::I8),
    ("int", NumberType::I32),
    ("unsigned int", NumberType::U32),
    ("float", NumberType::F32),
    ("double", NumberType::F64),
    ("int8", NumberType::I8),
    ("int8_t", NumberType::I8),
    ("uchar", NumberType::U8),
    ("uint8", NumberType::U8),
    ("uint8_t", NumberType::U8),
    ("short int", NumberType::I16),
    ("signed short", NumberType::I16),
    ("signed short int", NumberType::I16),
    ("int16", NumberType::I16),
    ("int16_t", NumberType::I16),
    ("ushort", NumberType::U16),
    ("unsigned short int", NumberType::U16),
    ("uint16", NumberType::U16),
    ("uint16_t", NumberType::U16),
    ("signed int", NumberType::I32),
    ("int32", NumberType::I32),
    ("int32_t", NumberType::I32),
    ("uint", NumberType::U32),
    ("uint32", NumberType::U32),
    ("uint32_t", NumberType::U32),
    ("longlong", NumberType::I64),
    ("long long", NumberType::I64),
    ("long long int", NumberType::I64),
    ("signed long long", NumberType::I64),
    ("signed long long int", NumberType::I64),
    ("int64", NumberType::I64),
    ("int64_t", NumberType::I64),
    ("ulonglong", NumberType::U64),
    ("unsigned long long", NumberType::U64),
    ("unsigned long long int", NumberType::U64),
    ("uint64", NumberType::U64),
    ("uint64_t", NumberType::U64),
];

/// What turns a space's axes to LPS.
const SPACES: &[(&str, DVec3)] = &[
    ("left-posterior-superior", DVec3::new(1.0, 1.0, 1.0)),
    ("right-anterior-superior", DVec3::new(-1.0, -1.0, 1.0)),
    ("left-anterior-superior", DVec3::new(1.0, -1.0, 1.0)),
    ("LPS", DVec3::new(1.0, 1.0, 1.0)),
    ("RAS", DVec3::new(-1.0, -1.0, 1.0)),
    ("LAS", DVec3::new(1.0, -1.0, 1.0)),
];

/// Units of length [m].
const UNITS: &[(&str, f64)] = &[("mm", 1e-3), ("cm", 1e-2), ("m", 1.0), ("um", 1e-6)];

/// How numbers are encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Encoding {
    Raw,
    Gzip,
    Text,
    Hex,
}

const ENCODINGS: &[(&str, Encoding)] = &[
    ("raw", Encoding::Raw),
    ("gzip", Encoding::Gzip),
    ("gz", Encoding::Gzip),
    ("text", Encoding::Text),
    ("txt", Encoding::Text),
    ("ascii", Encoding::Text),
    ("hex", Encoding::Hex),
];

/// The header of a file and where its data begin.
fn parse_header(file: &Path, bytes: &[u8]) -> Result<(TextHeader, usize), ImageError> {
    let mut header = TextHeader::new(file);
    let mut at = 0;
    let mut number = 0;
    while let Some((line, next)) = line_at(&bytes[..bytes.len().min(MAX_HEADER_BYTES)], at) {
        (at, number) = (next, number + 1);
        if line.is_empty() {
            break;
        }
        if number == 1 || line[0] == b'#' {
            continue;
        }
        let text = String::from_utf8_lossy(line);
        // A field is `key: value`, a remark of a program `key:=value`.
        let Some((key, value)) = text.split_once(':') else {
            let field = Field { key: "(line)".into(), value: text.into_owned(), line: number };
            return Err(header.wrong(&field, "\"field: value\", \"key:=value\" or \"# comment\""));
        };
        match value.strip_prefix('=') {
            Some(value) => header.add(key, &unescaped(value), number),
            None => header.add(key, value, number),
        }
    }
    Ok((header, at))
}

/// A value of a `key:=value` line, where a backslash and the end of a line are written with a backslash.
fn unescaped(value: &str) -> String {
    let mut plain = String::new();
    let mut characters = value.chars();
    while let Some(c) = characters.next() {
        match c {
            '\\' => plain.extend(characters.next().map(|c| if c == 'n' { '\n' } else { c })),
            _ => plain.push(c),
        }
    }
    plain
}

/// A vector `(x,y,z)`; none for `none`.
fn vector(text: &str) -> Option<Option<DVec3>> {
    if text.eq_ignore_ascii_case("none") {
        return Some(None);
    }
    let inside = text.strip_prefix('(')?.strip_suffix(')')?;
    let numbers: Option<Vec<f64>> = inside.split(',').map(|number| number.trim().parse().ok()).collect();
    let vector = DVec3::from_array(numbers?.try_into().ok()?);
    vector.is_finite().then_some(Some(vector))
}

/// The vectors of a field, which may have blanks inside their brackets.
fn vectors(header: &TextHeader, field: &Field, n: usize) -> Result<Vec<Option<DVec3>>, ImageError> {
    let mut words: Vec<String> = Vec::new();
    let mut is_open = false;
    for c in field.value.chars() {
        match c {
            _ if c.is_whitespace() && !is_open => words.push(String::new()),
            _ if c.is_whitespace() => {}
            _ => {
                is_open = (is_open || c == '(') && c != ')';
                match words.last_mut() {
                    Some(word) => word.push(c),
                    None => words.push(c.into()),
                }
            }
        }
    }
    let found: Option<Vec<Option<DVec3>>> =
        words.iter().filter(|word| !word.is_empty()).map(|word| vector(word)).collect();
    let found = found.filter(|list| list.len() == n);
    found.ok_or_else(|| {
        header.wrong(field, format!("{n} vectors such as (0.7,0,0), or none for a list of layers"))
    })
}

/// Where the voxels are, and how many layers there are: one unless it is a segmentation.
fn placement(header: &TextHeader) -> Result<(crate::image::VoxelGrid, usize), ImageError> {
    let n_dims = header.whole(header.required("dimension")?, 3, 4)? as usize;
    let sizes_field = header.required("sizes")?;
    let sizes = header.sizes(sizes_field, n_dims)?;
    let n_layers = if n_dims == 4 { sizes[0] } else { 1 };
    if let (4, Some(kinds)) = (n_dims, header.get("kinds")) {
        let first = kinds.value.split_whitespace().next().unwrap_or_default();
        if !first.eq_ignore_ascii_case("list") {
            let allowed =
                "list first of four (layers of a segmentation): one number a voxel, one volume a file";
            return Err(header.wrong(kinds, allowed));
        }
    }
    let dims = [sizes[n_dims - 3], sizes[n_dims - 2], sizes[n_dims - 1]];
    let no_orientation = |found: &str| ImageError::NoOrientation {
        file: header.file.clone(),
        found: found.into(),
        remedy: "write it again with `space` and `space directions` (3D Slicer and SimpleITK do)",
    };
    let Some(space) = header.get("space") else { return Err(no_orientation("the header has no `space`")) };
    let turn = header.chosen(space, SPACES)?;
    let Some(directions) = header.get("space directions") else {
        return Err(no_orientation("the header has no `space directions`"));
    };
    let mut steps = vectors(header, directions, n_dims)?;
    if n_dims == 4 && steps.remove(0).is_some() {
        return Err(header.wrong(directions, "none for the first of four axes (layers of a segmentation)"));
    }
    let unit_m = match header.get("space units") {
        None => 1e-3,
        Some(units) => {
            let mut words = units.value.split_whitespace().map(|word| word.trim_matches('"'));
            let first = words.next().unwrap_or_default().to_owned();
            let field = Field { value: first.clone(), ..units.clone() };
            if words.any(|word| word != first) {
                return Err(header.wrong(units, "the same unit for the three axes"));
            }
            header.chosen(&field, UNITS)?
        }
    };
    let mut columns = [DVec3::ZERO; 3];
    for (column, step) in columns.iter_mut().zip(&steps) {
        let step = step.filter(|step| step.length() > 0.0);
        *column =
            step.ok_or_else(|| header.wrong(directions, "a vector that is not zero for each axis"))? * turn;
    }
    let origin = match header.get("space origin") {
        Some(field) => vectors(header, field, 1)?[0].unwrap_or_default(),
        None => DVec3::ZERO,
    };
    let spacing_m = DVec3::from_array(columns.map(|column| column.length() * unit_m));
    Ok((right_angled(&header.file, dims, columns, spacing_m, origin * turn * unit_m)?, n_layers))
}

/// Where numbers are and what they are.
struct DataPlan {
    kind: NumberType,
    order: ByteOrder,
    encoding: Encoding,
    line_skip: usize,
    /// From the end for none.
    byte_skip: Option<usize>,
    n_numbers: usize,
    dims: [usize; 3],
}

impl DataPlan {
    fn new(header: &TextHeader, n_numbers: usize, dims: [usize; 3]) -> Result<Self, ImageError> {
        let kind = header.chosen(header.required("type")?, TYPES)?;
        let encoding_field = header.required("encoding")?;
        let encoding = header.chosen(encoding_field, ENCODINGS)?;
        let is_binary = matches!(encoding, Encoding::Raw | Encoding::Gzip | Encoding::Hex);
        let order = match header.get("endian") {
            Some(field) => header.chosen(field, &[("little", ByteOrder::Little), ("big", ByteOrder::Big)])?,
            None if is_binary && kind.n_bytes() > 1 => return Err(header.missing("endian")),
            None => ByteOrder::Little,
        };
        let skip = |keys: &[&str], least| match header.first_of(keys) {
            Some(field) => header.whole(field, least, i64::from(u32::MAX)),
            None => Ok(0),
        };
        let byte_skip = skip(&["byte skip", "byteskip"], -1)?;
        if byte_skip < 0 && encoding != Encoding::Raw {
            return Err(header.wrong(encoding_field, "raw where `byte skip` is -1"));
        }
        Ok(Self {
            kind,
            order,
            encoding,
            line_skip: skip(&["line skip", "lineskip"], 0)? as usize,
            byte_skip: usize::try_from(byte_skip).ok(),
            n_numbers,
            dims,
        })
    }

    /// The numbers in `bytes`, which begin at `start`.
    fn numbers(&self, file: &Path, bytes: &[u8], start: usize) -> Result<StoredData, ImageError> {
        let mut start = start;
        for _ in 0..self.line_skip {
            match line_at(bytes, start) {
                Some((_, next)) => start = next,
                None => break,
            }
        }
        let expected = (self.n_numbers * self.kind.n_bytes()) as u64;
        let mismatch = |found: u64| ImageError::SizeMismatch {
            file: file.to_path_buf(),
            expected,
            found,
            dims: self.dims,
            n_bytes_a_voxel: self.kind.n_bytes(),
            data_start: start,
        };
        let stored = match (self.encoding, self.byte_skip) {
            (Encoding::Raw, None) => {
                let n_there = bytes.len() - start;
                let first = n_there.checked_sub(expected as usize).ok_or_else(|| mismatch(n_there as u64))?;
                &bytes[start + first..]
            }
            (Encoding::Raw | Encoding::Hex | Encoding::Text, Some(skip)) => {
                bytes.get(start + skip..).unwrap_or_default()
            }
            // Bytes are skipped after decompression.
            _ => &bytes[start..],
        };
        let unpacked = match self.encoding {
            Encoding::Raw => match stored.len() as u64 {
                found if found == expected => stored.to_vec(),
                found => return Err(mismatch(found)),
            },
            Encoding::Gzip => {
                let n_skipped = self.byte_skip.unwrap_or_default();
                let mut bytes = unpack(file, Packing::Gzip, stored, expected + n_skipped as u64, mismatch)?;
                bytes.drain(..n_skipped);
                bytes
            }
            Encoding::Hex => {
                hexadecimal(stored, expected as usize).ok_or_else(|| mismatch(stored.len() as u64 / 2))?
            }
            Encoding::Text => {
                let wrong = |found, allowed| ImageError::Header {
                    file: file.to_path_buf(),
                    field: "(data)".into(),
                    place: HeaderPlace::Byte(start),
                    found,
                    allowed,
                };
                let (kind, order, numbers) = numbers_in_text(stored, self.n_numbers, wrong)?;
                return Ok(StoredData::plain(kind, order, numbers, 0));
            }
        };
        Ok(StoredData::plain(self.kind, self.order, unpacked, 0))
    }
}

/// The bytes that pairs of hexadecimal digits stand for, blanks passed over; none for another number of bytes.
fn hexadecimal(text: &[u8], n_bytes: usize) -> Option<Vec<u8>> {
    let digits: Option<Vec<u8>> = text
        .iter()
        .filter(|b| !b.is_ascii_whitespace())
        .map(|&b| char::from(b).to_digit(16).map(|digit| digit as u8))
        .collect();
    let digits = digits.filter(|digits| digits.len() % 2 == 0 && digits.len() / 2 == n_bytes)?;
    Some(digits.chunks_exact(2).map(|pair| pair[0] << 4 | pair[1]).collect())
}

fn read(file: &Path) -> Result<StoredImage, ImageError> {
    let bytes = load(file)?;
    if !(FORMAT.begins)(&bytes) {
        let found = bytes[..bytes.len().min(8)].escape_ascii().to_string();
        return Err(ImageError::Header {
            file: file.to_path_buf(),
            field: "magic".into(),
            place: HeaderPlace::Byte(0),
            found,
            allowed: "NRRD0001 to NRRD0005: this is not an NRRD file".into(),
        });
    }
    let (header, start) = parse_header(file, &bytes)?;
    let (grid, n_layers) = placement(&header)?;
    let n_numbers = grid.n_voxels() * n_layers;
    let plan = DataPlan::new(&header, n_numbers, grid.dims)?;
    let data = match header.first_of(&["data file", "datafile"]) {
        None => plan.numbers(file, &bytes, start)?,
        Some(field) if field.value.starts_with("LIST") || field.value.contains('%') => {
            return Err(header.wrong(field, "one file: join the slices (e.g. with 3D Slicer or SimpleITK)"));
        }
        Some(field) => {
            let path = beside(&header, field)?;
            plan.numbers(&path, &load(&path)?, 0)?
        }
    };
    let is_layered = n_layers > 1;
    let mut segments = segments_of(&header, is_layered)?;
    let mut image = StoredImage::new(file, FORMAT.name, grid, data);
    if is_layered || segments.iter().any(|segment| segment.layer > 0) {
        let merged = merged(&header, &image.data, n_layers, segments)?;
        image.data = merged.data;
        segments = merged.segments;
        if merged.n_hidden > 0 {
            let n = merged.n_hidden;
            image.notes.push(format!("segments overlap in {n} voxels; the later layer was taken there"));
        }
        if merged.n_unknown > 0 {
            image.notes.push(format!("{} numbers that no segment has were left out", merged.n_unknown));
        }
    }
    image.names = segments.iter().map(|segment| (segment.label, segment.name.clone())).collect();
    image.names.sort();
    image.colours = segments.iter().filter_map(|s| s.colour.map(|colour| (s.label, colour))).collect();
    image.colours.sort_by_key(|(label, _)| *label);
    Ok(image)
}
