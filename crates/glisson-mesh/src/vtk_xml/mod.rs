//! Data arrays of VTK XML files, as grids (`.vtu`) and polydata (`.vtp`) have them.
//!
//! Source: VTK file formats, "XML file formats" (docs.vtk.org). A data array is text, base64 inside the
//! element, or a stretch of the appended data, which are base64 or raw bytes; raw bytes make the file no
//! XML, so that they are cut off before parsing. Binary data begin with their number of bytes, or, when
//! compressed, with the number of blocks, the size of a block, of the last one if it is shorter, and the
//! compressed sizes.

mod write;

pub(crate) use write::write_array;

use std::io::Read;

use roxmltree::{Document, Node};

use crate::base64::Base64Reader;
use crate::binary::{ByteOrder, NumberType, integers_from_bytes, positions_from_bytes};
use crate::math::DVec3;
use crate::scan::{FormatError, Place, Scanner, find, parse_xml, quoted};
use crate::units::LengthUnit;

/// Most bytes that deflate makes of one.
const DEFLATE_LIMIT: usize = 1032;

#[derive(Clone, Copy)]
struct Appended<'a> {
    is_raw: bool,
    data: &'a [u8],
}

/// Binary data of one array, and what may follow.
enum Source<'a> {
    Raw(&'a [u8]),
    Base64(Base64Reader<'a>),
}

impl Source<'_> {
    fn most_left(&self) -> usize {
        match self {
            Self::Raw(bytes) => bytes.len(),
            Self::Base64(reader) => reader.most_left(),
        }
    }

    fn read(&mut self, n: usize) -> Option<Vec<u8>> {
        match self {
            Self::Raw(bytes) => {
                let (taken, rest) = bytes.split_at_checked(n)?;
                *bytes = rest;
                Some(taken.to_vec())
            }
            Self::Base64(reader) => reader.read(n),
        }
    }
}

/// The XML of a file, and the data appended to it.
pub(crate) struct VtkXml<'a> {
    xml: String,
    appended: Option<Appended<'a>>,
}

/// How all data arrays of a file are written.
pub(crate) struct VtkArrays<'a> {
    order: ByteOrder,
    header: NumberType,
    is_compressed: bool,
    appended: Option<Appended<'a>>,
    unit: LengthUnit,
}

impl<'a> VtkXml<'a> {
    /// Splits the bytes of a file.
    pub(crate) fn new(bytes: &'a [u8]) -> Result<Self, FormatError> {
        let (xml, appended) = split_appended(bytes)?;
        Ok(Self { xml, appended })
    }

    /// The XML as a document.
    pub(crate) fn document(&self) -> Result<Document<'_>, FormatError> {
        parse_xml(&self.xml)
    }

    /// What stands before the first piece, with the comments there.
    pub(crate) fn head(&self) -> &[u8] {
        let xml = self.xml.as_bytes();
        &xml[..find(xml, b"<Piece", 0).unwrap_or(0)]
    }

    /// The pieces of a file whose data set is of `kind`, and the key to their arrays, whose positions are in `unit`.
    pub(crate) fn pieces<'d>(
        &self,
        document: &'d Document<'_>,
        kind: &str,
        unit: LengthUnit,
    ) -> Result<(Vec<Node<'d, 'd>>, VtkArrays<'a>), FormatError> {
        let root = document.root_element();
        if !root.has_tag_name("VTKFile") || root.attribute("type") != Some(kind) {
            let found = root.attribute("type").unwrap_or("no type");
            return Err(FormatError::named(
                "the root element",
                format!("`{}` of {found}", root.tag_name().name()),
                format!("`VTKFile` of type {kind}"),
            ));
        }
        let arrays = VtkArrays {
            order: choice(
                root,
                "byte_order",
                "LittleEndian",
                &[("LittleEndian", ByteOrder::Little), ("BigEndian", ByteOrder::Big)],
            )?,
            header: choice(
                root,
                "header_type",
                "UInt32",
                &[("UInt32", NumberType::U32), ("UInt64", NumberType::U64)],
            )?,
            is_compressed: choice(root, "compressor", "", &[("", false), ("vtkZLibDataCompressor", true)])?,
            appended: self.appended,
            unit,
        };
        let grid = child(root, kind, "the file")?;
        Ok((grid.children().filter(|n| n.has_tag_name("Piece")).collect(), arrays))
    }
}

/// The XML of the file and the data behind `<AppendedData ...>_`.
fn split_appended(bytes: &[u8]) -> Result<(String, Option<Appended<'_>>), FormatError> {
    let text = |bytes: &[u8]| {
        String::from_utf8(bytes.to_vec()).map_err(|error| FormatError {
            place: Place::Byte(error.utf8_error().valid_up_to()),
            found: "bytes that are no UTF-8".into(),
            expected: "XML text".into(),
        })
    };
    let Some(start) = find(bytes, b"<AppendedData", 0) else { return Ok((text(bytes)?, None)) };
    let incomplete = || FormatError {
        place: Place::Byte(start),
        found: "an AppendedData element without data".into(),
        expected: "`<AppendedData encoding=\"raw\">_` or with base64, and the data".into(),
    };
    let end_of_tag = find(bytes, b">", start).ok_or_else(incomplete)?;
    let underscore = find(bytes, b"_", end_of_tag).ok_or_else(incomplete)?;
    let tag = &bytes[start..end_of_tag];
    let is_raw = find(tag, b"raw", 0).is_some();
    if !is_raw && find(tag, b"base64", 0).is_none() {
        return Err(FormatError { found: quoted(tag), ..incomplete() });
    }
    let mut data = &bytes[underscore + 1..];
    if !is_raw {
        data = &data[..data.iter().position(|&b| b == b'<').unwrap_or(data.len())];
    }
    let mut xml = text(&bytes[..start])?;
    xml.push_str("</VTKFile>");
    Ok((xml, Some(Appended { is_raw, data })))
}

/// One of a few values of an attribute.
fn choice<T: Copy>(
    node: Node<'_, '_>,
    attribute: &str,
    default: &str,
    allowed: &[(&str, T)],
) -> Result<T, FormatError> {
    let found = node.attribute(attribute).unwrap_or(default);
    allowed.iter().find(|(name, _)| *name == found).map(|(_, value)| *value).ok_or_else(|| {
        let names: Vec<&str> = allowed.iter().map(|(name, _)| *name).filter(|n| !n.is_empty()).collect();
        FormatError::named(
            format!("attribute {attribute}"),
            quoted(found.as_bytes()),
            format!("{}: write the file so", names.join(" or ")),
        )
    })
}

fn child<'a, 'x>(parent: Node<'a, 'x>, tag: &str, place: &str) -> Result<Node<'a, 'x>, FormatError> {
    parent
        .children()
        .find(|n| n.has_tag_name(tag))
        .ok_or_else(|| FormatError::named(place, format!("no element {tag}"), "one"))
}

fn named_array<'a, 'x>(parent: Node<'a, 'x>, name: &str) -> Option<Node<'a, 'x>> {
    parent.children().find(|n| n.has_tag_name("DataArray") && n.attribute("Name") == Some(name))
}

/// A count in an attribute of an element.
pub(crate) fn count_attribute(node: Node<'_, '_>, name: &str, place: &str) -> Result<usize, FormatError> {
    let found = node.attribute(name).unwrap_or("");
    found.trim().parse().map_err(|_| {
        FormatError::named(format!("{place}, attribute {name}"), quoted(found.as_bytes()), "a count")
    })
}

fn number_type(name: &str) -> Option<NumberType> {
    Some(match name {
        "Int8" => NumberType::I8,
        "UInt8" => NumberType::U8,
        "Int16" => NumberType::I16,
        "UInt16" => NumberType::U16,
        "Int32" => NumberType::I32,
        "UInt32" => NumberType::U32,
        "Int64" => NumberType::I64,
        "UInt64" => NumberType::U64,
        "Float32" => NumberType::F32,
        "Float64" => NumberType::F64,
        _ => return None,
    })
}

impl VtkArrays<'_> {
    /// The positions [m] of the points of a piece, as many as it announces.
    pub(crate) fn points(&self, piece: Node<'_, '_>, place: &str) -> Result<Vec<DVec3>, FormatError> {
        let n_points = count_attribute(piece, "NumberOfPoints", place)?;
        let points = child(child(piece, "Points", place)?, "DataArray", place)?;
        let positions_m = self.positions(points, &format!("{place}, Points"))?;
        if positions_m.len() != n_points {
            let found = format!("{} points", positions_m.len());
            return Err(FormatError::named(place, found, format!("NumberOfPoints = {n_points}")));
        }
        Ok(positions_m)
    }

    /// The integers of the array `name` of the cells below the element `tag` of a piece.
    pub(crate) fn cell_array(
        &self,
        piece: Node<'_, '_>,
        tag: &str,
        name: &str,
        place: &str,
    ) -> Result<Vec<i64>, FormatError> {
        let array = named_array(child(piece, tag, place)?, name)
            .ok_or_else(|| FormatError::named(place, format!("no array {name} in {tag}"), "one"))?;
        self.integers(array, &format!("{place}, array {name}"))
    }

    /// The whole numbers that a piece has on its cells under `name`; none where it has no such field of whole numbers.
    pub(crate) fn cell_field(
        &self,
        piece: Node<'_, '_>,
        name: &str,
        place: &str,
    ) -> Result<Option<Vec<i64>>, FormatError> {
        let fields = piece.children().find(|n| n.has_tag_name("CellData"));
        let array = fields.and_then(|fields| named_array(fields, name));
        let is_whole =
            |array: &Node<'_, '_>| array.attribute("type").is_some_and(|name| name.contains("Int"));
        array
            .filter(is_whole)
            .map(|array| self.integers(array, &format!("{place}, field {name}")))
            .transpose()
    }

    fn positions(&self, array: Node<'_, '_>, place: &str) -> Result<Vec<DVec3>, FormatError> {
        if array.attribute("NumberOfComponents") != Some("3") {
            let found = format!("{:?} components", array.attribute("NumberOfComponents").unwrap_or("1"));
            return Err(FormatError::named(place, found, "3 components"));
        }
        if is_text(array) {
            let mut scanner = Scanner::new(array.text().unwrap_or("").as_bytes());
            let mut positions_m = Vec::new();
            while scanner.peek().is_some() {
                let mut next = || {
                    scanner.length_m(self.unit, "a coordinate").map_err(|mut e| {
                        e.place = Place::Named(format!("{place}, {} of the array", e.place));
                        e
                    })
                };
                positions_m.push(DVec3::new(next()?, next()?, next()?));
            }
            return Ok(positions_m);
        }
        let (data, kind) = self.binary(array, place)?;
        if data.len() % (3 * kind.n_bytes()) != 0 {
            let found = format!("{} bytes", data.len());
            return Err(FormatError::named(place, found, "three coordinates a point"));
        }
        positions_from_bytes(&data, kind, self.order, self.unit)
    }

    fn integers(&self, array: Node<'_, '_>, place: &str) -> Result<Vec<i64>, FormatError> {
        if is_text(array) {
            let mut scanner = Scanner::new(array.text().unwrap_or("").as_bytes());
            let mut values = Vec::new();
            while scanner.peek().is_some() {
                values.push(scanner.integer("an integer").map_err(|mut e| {
                    e.place = Place::Named(format!("{place}, {} of the array", e.place));
                    e
                })?);
            }
            return Ok(values);
        }
        let (data, kind) = self.binary(array, place)?;
        integers_from_bytes(&data, kind, self.order, place)
    }

    /// The bytes of a binary array and the type of its numbers.
    fn binary(&self, array: Node<'_, '_>, place: &str) -> Result<(Vec<u8>, NumberType), FormatError> {
        let type_name = array.attribute("type").unwrap_or("");
        let kind = number_type(type_name).ok_or_else(|| {
            FormatError::named(
                place,
                format!("type {}", quoted(type_name.as_bytes())),
                "Int8 to UInt64, Float32 or Float64",
            )
        })?;
        let source = match array.attribute("format") {
            Some("binary") => Source::Base64(Base64Reader::new(array.text().unwrap_or("").as_bytes())),
            Some("appended") => {
                let offset = count_attribute(array, "offset", place)?;
                let start = |a: Appended<'_>| offset.min(a.data.len());
                match self.appended {
                    Some(a) if a.is_raw => Source::Raw(&a.data[start(a)..]),
                    Some(a) => Source::Base64(Base64Reader::new(&a.data[start(a)..])),
                    None => {
                        return Err(FormatError::named(place, "no AppendedData", "the data of the array"));
                    }
                }
            }
            other => {
                let found = format!("format {}", quoted(other.unwrap_or("").as_bytes()));
                return Err(FormatError::named(place, found, "ascii, binary or appended"));
            }
        };
        let data = if self.is_compressed { self.inflated(source) } else { self.plain(source) };
        data.map(|data| (data, kind)).map_err(|(found, expected)| FormatError::named(place, found, expected))
    }

    fn header_words(&self, source: &mut Source<'_>, n: usize) -> Result<Vec<usize>, (String, String)> {
        let size = self.header.n_bytes();
        n.checked_mul(size)
            .and_then(|n_bytes| source.read(n_bytes))
            .and_then(|bytes| {
                bytes
                    .chunks_exact(size)
                    .map(|word| self.header.integer(word, self.order).and_then(|w| usize::try_from(w).ok()))
                    .collect()
            })
            .ok_or_else(|| {
                ("data that end or break off".into(), format!("a header of {n} words of {size} bytes"))
            })
    }

    fn plain(&self, mut source: Source<'_>) -> Result<Vec<u8>, (String, String)> {
        let n_bytes = self.header_words(&mut source, 1)?[0];
        let left = source.most_left();
        source.read(n_bytes).ok_or_else(|| {
            (
                format!("{left} bytes at most, or no base64"),
                format!("the {n_bytes} bytes that the header announces"),
            )
        })
    }

    fn inflated(&self, mut source: Source<'_>) -> Result<Vec<u8>, (String, String)> {
        let [n_blocks, size, last_size] = self.header_words(&mut source, 3)?[..] else {
            return Err(("a short header".into(), "three words".into()));
        };
        let compressed_sizes = self.header_words(&mut source, n_blocks)?;
        let mut data = Vec::new();
        for (b, compressed_size) in compressed_sizes.into_iter().enumerate() {
            let wanted = if b + 1 == n_blocks && last_size > 0 { last_size } else { size };
            let fault =
                |found: String| (format!("block {b}: {found}"), format!("{wanted} bytes in zlib's format"));
            let block = source
                .read(compressed_size)
                .ok_or_else(|| fault(format!("less than its {compressed_size} compressed bytes")))?;
            if wanted > block.len().saturating_mul(DEFLATE_LIMIT) {
                return Err(fault(format!("{} bytes, too few for the size announced", block.len())));
            }
            let before = data.len();
            flate2::read::ZlibDecoder::new(&block[..])
                .take(wanted as u64 + 1)
                .read_to_end(&mut data)
                .map_err(|error| fault(error.to_string()))?;
            if data.len() - before != wanted {
                return Err(fault(format!("{} bytes or more", data.len() - before)));
            }
        }
        Ok(data)
    }
}

/// Whether an array is text; text is also what an array without a word on it is.
fn is_text(array: Node<'_, '_>) -> bool {
    matches!(array.attribute("format"), None | Some("ascii"))
}
