//! MetaImage, `.mha` and `.mhd` with its data file.
//!
//! Positions are millimetres in LPS, as ITK reads and writes them: each row of `TransformMatrix` is the direction of
//! one voxel axis. A file without one is placed by `AnatomicalOrientation` (`RAI` is from right, anterior and
//! inferior: LPS); a file with neither does not say which side is left and is refused. Data are read as binary or
//! text, zlib or not; written as one compressed `.mha`, with the labels' names and colours as JSON in a field of its
//! own (`LabelTable`), which other programs pass over.
//!
//! Source of the layout: MetaIO's documentation, <https://itk.org/Wiki/ITK/MetaIO/Documentation>.

use std::io::Write;
use std::path::Path;

use flate2::Compression;
use flate2::write::ZlibEncoder;

use super::error::{HeaderPlace, ImageError};
use super::format::ImageFormat;
use super::label_table::LabelTable;
use super::packed::{Packing, load, unpack};
use super::placement::right_angled;
use super::stored::{StoredData, StoredImage};
use super::text_header::{Field, MAX_HEADER_BYTES, TextHeader, beside, line_at, numbers_in_text};
use super::written::WrittenImage;
use crate::binary::{ByteOrder, NumberType};
use crate::files::write_atomically;
use crate::image::VoxelGrid;
use crate::math::DVec3;

/// The format's row of the table.
pub(super) const FORMAT: ImageFormat = ImageFormat {
    name: "MetaImage",
    extensions: &["mha", "mhd"],
    begins: |bytes| bytes.starts_with(b"ObjectType") || bytes.starts_with(b"NDims"),
    read,
    write: Some(write),
};

/// The names of number types. MetaIO's LONG has four bytes on every system.
const TYPES: &[(&str, NumberType)] = &[
    ("MET_CHAR", NumberType::I8),
    ("MET_UCHAR", NumberType::U8),
    ("MET_SHORT", NumberType::I16),
    ("MET_USHORT", NumberType::U16),
    ("MET_INT", NumberType::I32),
    ("MET_UINT", NumberType::U32),
    ("MET_LONG", NumberType::I32),
    ("MET_ULONG", NumberType::U32),
    ("MET_LONG_LONG", NumberType::I64),
    ("MET_ULONG_LONG", NumberType::U64),
    ("MET_FLOAT", NumberType::F32),
    ("MET_DOUBLE", NumberType::F64),
];

const TRUTH: &[(&str, bool)] =
    &[("True", true), ("False", false), ("T", true), ("F", false), ("1", true), ("0", false)];

/// The field of the labels' names and colours.
const LABELS_KEY: &str = "LabelTable";

/// The header of a file, whose last field names the data, and where it ends.
fn parse_header(file: &Path, bytes: &[u8]) -> Result<(TextHeader, usize), ImageError> {
    let mut header = TextHeader::new(file);
    let (mut at, mut number) = (0, 0);
    while let Some((line, next)) = line_at(&bytes[..bytes.len().min(MAX_HEADER_BYTES)], at) {
        (at, number) = (next, number + 1);
        let text = String::from_utf8_lossy(line);
        if text.trim().is_empty() {
            continue;
        }
        let Some((key, value)) = text.split_once('=') else {
            let field = Field { key: "(line)".into(), value: text.into_owned(), line: number };
            return Err(header.wrong(&field, "\"Key = value\": this is not a MetaImage file"));
        };
        header.add(key, value, number);
        if key.trim() == "ElementDataFile" {
            return Ok((header, at));
        }
    }
    Err(header.missing("ElementDataFile"))
}

fn truth(header: &TextHeader, keys: &[&str]) -> Result<Option<bool>, ImageError> {
    header.first_of(keys).map(|field| header.chosen(field, TRUTH)).transpose()
}

fn grid_of(header: &TextHeader) -> Result<VoxelGrid, ImageError> {
    if let Some(kind) = header.get("ObjectType") {
        header.chosen(kind, &[("Image", ())])?;
    }
    let n_dims = header.required("NDims")?;
    header.whole(n_dims, 3, 3)?;
    let sizes_field = header.required("DimSize")?;
    let sizes = header.sizes(sizes_field, 3)?;
    if let Some(channels) = header.get("ElementNumberOfChannels") {
        header.whole(channels, 1, 1)?;
    }
    let unit_m = match header.get("DistanceUnits") {
        Some(field) => header.chosen(field, &[("mm", 1e-3), ("um", 1e-6), ("cm", 1e-2), ("?", 1e-3)])?,
        None => 1e-3,
    };
    let spacing = match header.first_of(&["ElementSpacing", "ElementSize"]) {
        Some(field) => {
            let spacing: [f64; 3] = header.numbers(field)?;
            if spacing.iter().any(|&size| size <= 0.0) {
                return Err(header.wrong(field, "voxel sizes above 0"));
            }
            DVec3::from_array(spacing)
        }
        None => return Err(header.missing("ElementSpacing")),
    };
    let origin = match header.first_of(&["Offset", "Position", "Origin"]) {
        Some(field) => DVec3::from_array(header.numbers(field)?),
        None => DVec3::ZERO,
    };
    let steps = match header.first_of(&["TransformMatrix", "Rotation", "Orientation"]) {
        Some(field) => {
            let m: [f64; 9] = header.numbers(field)?;
            let rows = [0, 3, 6].map(|at| DVec3::new(m[at], m[at + 1], m[at + 2]));
            if rows.iter().any(|row| row.length() == 0.0) {
                return Err(header.wrong(field, "three directions that are not zero"));
            }
            rows
        }
        None => by_anatomy(header)?,
    };
    right_angled(&header.file, [sizes[0], sizes[1], sizes[2]], steps, spacing * unit_m, origin * unit_m)
}

/// The directions of the voxel axes by the letters of the sides at which they begin.
fn by_anatomy(header: &TextHeader) -> Result<[DVec3; 3], ImageError> {
    let no_orientation = |found: &str| ImageError::NoOrientation {
        file: header.file.clone(),
        found: found.into(),
        remedy: "write it again with `TransformMatrix` (3D Slicer and SimpleITK do)",
    };
    let Some(field) = header.get("AnatomicalOrientation") else {
        return Err(no_orientation("the header has neither `TransformMatrix` nor `AnatomicalOrientation`"));
    };
    let from = |letter: char| match letter.to_ascii_uppercase() {
        'R' => Some(DVec3::X),
        'L' => Some(DVec3::NEG_X),
        'A' => Some(DVec3::Y),
        'P' => Some(DVec3::NEG_Y),
        'I' => Some(DVec3::Z),
        'S' => Some(DVec3::NEG_Z),
        _ => None,
    };
    if field.value.contains('?') {
        return Err(no_orientation("`AnatomicalOrientation` has question marks"));
    }
    let steps: Option<Vec<DVec3>> = field.value.chars().map(from).collect();
    let steps = steps.and_then(|steps| <[DVec3; 3]>::try_from(steps).ok());
    steps.ok_or_else(|| header.wrong(field, "three of the letters R, L, A, P, I, S"))
}

fn read(file: &Path) -> Result<StoredImage, ImageError> {
    let bytes = load(file)?;
    let (header, end) = parse_header(file, &bytes)?;
    let grid = grid_of(&header)?;
    let kind = header.chosen(header.required("ElementType")?, TYPES)?;
    let is_big = truth(&header, &["BinaryDataByteOrderMSB", "ElementByteOrderMSB"])?.unwrap_or(false);
    let order = if is_big { ByteOrder::Big } else { ByteOrder::Little };
    let is_packed = truth(&header, &["CompressedData"])?.unwrap_or(false);
    let is_binary = truth(&header, &["BinaryData"])?.unwrap_or(true);

    let data_field = header.required("ElementDataFile")?;
    let (data_file, bytes, mut start) = match data_field.value.as_str() {
        name if name.eq_ignore_ascii_case("LOCAL") => (file.to_path_buf(), bytes, end),
        "LIST" => {
            return Err(header.wrong(data_field, "LOCAL or one file: join the slices (e.g. with SimpleITK)"));
        }
        name if name.contains('%') => {
            return Err(header.wrong(data_field, "LOCAL or one file: join the slices (e.g. with SimpleITK)"));
        }
        _ => {
            let path = beside(&header, data_field)?;
            let bytes = load(&path)?;
            (path, bytes, 0)
        }
    };
    let expected = (grid.n_voxels() * kind.n_bytes()) as u64;
    if let Some(field) = header.get("HeaderSize") {
        start = match header.whole(field, -1, i64::from(u32::MAX))? {
            -1 => bytes.len().saturating_sub(expected as usize),
            n_skipped => (start + n_skipped as usize).min(bytes.len()),
        };
    }
    let mismatch = |found: u64| ImageError::SizeMismatch {
        file: data_file.clone(),
        expected,
        found,
        dims: grid.dims,
        n_bytes_a_voxel: kind.n_bytes(),
        data_start: start,
    };
    let mut data = if !is_binary {
        let wrong = |found, allowed| ImageError::Header {
            file: data_file.clone(),
            field: "(data)".into(),
            place: HeaderPlace::Byte(start),
            found,
            allowed,
        };
        let (kind, order, numbers) = numbers_in_text(&bytes[start..], grid.n_voxels(), wrong)?;
        StoredData::plain(kind, order, numbers, 0)
    } else if is_packed {
        let unpacked = unpack(&data_file, Packing::Zlib, &bytes[start..], expected, mismatch)?;
        StoredData::plain(kind, order, unpacked, 0)
    } else {
        match (bytes.len() - start) as u64 {
            found if found == expected => StoredData::plain(kind, order, bytes, start),
            found => return Err(mismatch(found)),
        }
    };
    if let Some(field) = header.get("ElementToIntensityFunctionSlope") {
        [data.slope] = header.numbers(field)?;
    }
    if let Some(field) = header.get("ElementToIntensityFunctionOffset") {
        [data.intercept] = header.numbers(field)?;
    }
    let mut image = StoredImage::new(file, FORMAT.name, grid, data);
    if let Some(table) = header.get(LABELS_KEY).and_then(|field| LabelTable::parse(field.value.as_bytes())) {
        table.name_labels_of(&mut image);
    }
    Ok(image)
}

/// Writes an image with its header and data in one file.
fn write(path: &Path, image: &WrittenImage<'_>) -> Result<(), ImageError> {
    let name = path.file_name().map(|n| n.to_string_lossy().to_lowercase()).unwrap_or_default();
    if name.ends_with(".mhd") {
        let reason = "a header and its data go into one file; name it .mha".into();
        return Err(ImageError::Unwritable { file: path.to_path_buf(), reason });
    }
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
    let io_error = |source| ImageError::Io { file: path.to_path_buf(), source };
    encoder.write_all(&image.bytes).map_err(io_error)?;
    let packed = encoder.finish().map_err(io_error)?;
    let grid = image.grid;
    let kind = match image.kind {
        NumberType::I16 => "MET_SHORT",
        NumberType::U16 => "MET_USHORT",
        _ => "MET_FLOAT",
    };
    let three = |v: DVec3| format!("{} {} {}", v.x, v.y, v.z);
    let [i, j, k] = grid.dims;
    let axes = [0, 1, 2].map(|axis| three(grid.axes.col(axis))).join(" ");
    let mut lines = vec![
        "ObjectType = Image".to_owned(),
        "NDims = 3".to_owned(),
        "BinaryData = True".to_owned(),
        "BinaryDataByteOrderMSB = False".to_owned(),
        "CompressedData = True".to_owned(),
        format!("CompressedDataSize = {}", packed.len()),
        format!("TransformMatrix = {axes}"),
        format!("Offset = {}", three(grid.origin_m * 1e3)),
        "CenterOfRotation = 0 0 0".to_owned(),
        format!("ElementSpacing = {}", three(grid.spacing_m * 1e3)),
        format!("DimSize = {i} {j} {k}"),
    ];
    let table = LabelTable::of(image.names, image.colours);
    if !table.is_empty() {
        lines.push(format!("{LABELS_KEY} = {}", table.to_json()));
    }
    lines.push(format!("ElementType = {kind}"));
    lines.push("ElementDataFile = LOCAL\n".to_owned());
    let result = write_atomically(path, |out| {
        out.write_all(lines.join("\n").as_bytes())?;
        out.write_all(&packed)
    });
    result.map_err(io_error)
}
