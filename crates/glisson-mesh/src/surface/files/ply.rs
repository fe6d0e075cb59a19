//! PLY: elements with typed properties, described by a text header; text or binary of either byte order.

use std::io::{self, Write};

use super::cursor::{Cursor, quote};
use super::{RawSurface, SurfaceFileError, Written};
use crate::binary::{ByteOrder, NumberType};
use crate::math::DVec3;

/// How the numbers are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    Ascii,
    LittleEndian,
    BigEndian,
}

fn number_type(name: &str) -> Option<NumberType> {
    Some(match name {
        "char" | "int8" => NumberType::I8,
        "uchar" | "uint8" => NumberType::U8,
        "short" | "int16" => NumberType::I16,
        "ushort" | "uint16" => NumberType::U16,
        "int" | "int32" => NumberType::I32,
        "uint" | "uint32" => NumberType::U32,
        "float" | "float32" => NumberType::F32,
        "double" | "float64" => NumberType::F64,
        _ => return None,
    })
}

struct Property<'a> {
    name: &'a str,
    /// Type of the length, if it is a list.
    length: Option<NumberType>,
    scalar: NumberType,
}

struct Element<'a> {
    name: &'a str,
    count: u64,
    properties: Vec<Property<'a>>,
}

impl Element<'_> {
    /// Least bytes that one takes.
    fn least_bytes(&self, encoding: Encoding) -> usize {
        let sizes = self.properties.iter().map(|p| p.length.unwrap_or(p.scalar).n_bytes());
        match encoding {
            Encoding::Ascii => self.properties.len(),
            _ => sizes.sum(),
        }
    }
}

struct Header<'a> {
    encoding: Encoding,
    space: Option<super::Space>,
    elements: Vec<Element<'a>>,
}

pub(super) fn parse(mut cursor: Cursor<'_>) -> Result<RawSurface, SurfaceFileError> {
    let header = parse_header(&mut cursor)?;
    let count_of = |name: &str| header.elements.iter().find(|e| e.name == name).map_or(0, |e| e.count);
    let n_vertices = usize::try_from(count_of("vertex")).unwrap_or(usize::MAX);
    let mut raw = RawSurface { space: header.space.unwrap_or_default(), ..Default::default() };
    let mut list = Vec::new();
    for element in header.elements.iter().filter(|e| !e.properties.is_empty()) {
        let what = format!("elements '{}'", element.name);
        let count = cursor.check_count(element.count, element.least_bytes(header.encoding), &what)?;
        let axes = ["x", "y", "z"].map(|axis| element.properties.iter().position(|p| p.name == axis));
        for _ in 0..count {
            let mut p = DVec3::ZERO;
            for (n, property) in element.properties.iter().enumerate() {
                let Some(length) = property.length else {
                    let value = read(&mut cursor, header.encoding, property.scalar)?;
                    if let Some(axis) = axes.iter().position(|&a| a == Some(n)) {
                        p[axis] = value;
                    }
                    continue;
                };
                let length = read(&mut cursor, header.encoding, length)?;
                if length < 0.0 {
                    return Err(cursor.error("a list's length from 0", length.to_string()));
                }
                let bytes_each =
                    if header.encoding == Encoding::Ascii { 1 } else { property.scalar.n_bytes() };
                let length = cursor.check_count(length as u64, bytes_each, "list entries")?;
                list.clear();
                for _ in 0..length {
                    list.push(read(&mut cursor, header.encoding, property.scalar)? as i64);
                }
                if element.name == "face" && is_corner_list(property) {
                    raw.add_polygon(&cursor, &list, n_vertices)?;
                }
            }
            if element.name == "vertex" {
                raw.positions.push(cursor.finite(p)?);
            }
        }
    }
    Ok(raw)
}

fn is_corner_list(property: &Property<'_>) -> bool {
    property.length.is_some() && ["vertex_indices", "vertex_index"].contains(&property.name)
}

fn parse_header<'a>(cursor: &mut Cursor<'a>) -> Result<Header<'a>, SurfaceFileError> {
    let first = cursor.text_line("'ply'")?;
    if first.trim() != "ply" {
        return Err(cursor.error("'ply'", quote(first.as_bytes())));
    }
    let mut encoding = None;
    let mut space = None;
    let mut elements: Vec<Element<'a>> = Vec::new();
    loop {
        let line = cursor.text_line("a header line or 'end_header'")?;
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        let unexpected = |expected: &str| Err(cursor.error(expected, quote(line.as_bytes())));
        match words.as_slice() {
            [] => {}
            ["end_header"] => break,
            ["comment" | "obj_info", ..] => space = space.or(cursor.space(line.as_bytes())?),
            ["format", name, "1.0"] => {
                encoding = match *name {
                    "ascii" => Some(Encoding::Ascii),
                    "binary_little_endian" => Some(Encoding::LittleEndian),
                    "binary_big_endian" => Some(Encoding::BigEndian),
                    _ => return unexpected("format ascii, binary_little_endian or binary_big_endian"),
                };
            }
            ["element", name, count] => {
                if elements.iter().any(|e| e.name == *name) {
                    return unexpected("each element once");
                }
                let count = cursor.parse(count, "a number of elements")?;
                elements.push(Element { name, count, properties: Vec::new() });
            }
            ["property", rest @ ..] => {
                let Some(element) = elements.last_mut() else { return unexpected("an element first") };
                let Some(property) = property_of(rest) else {
                    return unexpected("'property TYPE NAME' or 'property list INTEGER_TYPE TYPE NAME'");
                };
                element.properties.push(property);
            }
            _ => return unexpected("format, element, property, comment or end_header"),
        }
    }
    let Some(encoding) = encoding else { return Err(cursor.error("a 'format' line in the header", "none")) };
    let header = Header { encoding, space, elements };
    check_elements(cursor, &header)?;
    Ok(header)
}

/// What the words after `property` describe, if they describe one.
fn property_of<'a>(words: &[&'a str]) -> Option<Property<'a>> {
    match *words {
        ["list", length, scalar, name] => number_type(length)
            .filter(|l| l.is_integer())
            .zip(number_type(scalar))
            .map(|(length, scalar)| Property { name, length: Some(length), scalar }),
        [scalar, name] => number_type(scalar).map(|scalar| Property { name, length: None, scalar }),
        _ => None,
    }
}

/// Checks that the header promises places and faces.
fn check_elements(cursor: &Cursor<'_>, header: &Header<'_>) -> Result<(), SurfaceFileError> {
    let has = |element: &str, test: &dyn Fn(&Property<'_>) -> bool| {
        header.elements.iter().any(|e| e.name == element && e.properties.iter().any(test))
    };
    for axis in ["x", "y", "z"] {
        if !has("vertex", &|p| p.name == axis && p.length.is_none()) {
            return Err(cursor.error(format!("an element 'vertex' with a property '{axis}'"), "none"));
        }
    }
    if !has("face", &|p| is_corner_list(p) && p.scalar.is_integer()) {
        let expected =
            "an element 'face' with an integer list 'vertex_indices' (a cloud of points is no surface)";
        return Err(cursor.error(expected, "none"));
    }
    Ok(())
}

fn read(cursor: &mut Cursor<'_>, encoding: Encoding, scalar: NumberType) -> Result<f64, SurfaceFileError> {
    if encoding == Encoding::Ascii {
        if scalar.is_integer() {
            return cursor.number::<i64>("an integer").map(|i| i as f64);
        }
        return cursor.number("a number");
    }
    let order = if encoding == Encoding::BigEndian { ByteOrder::Big } else { ByteOrder::Little };
    Ok(scalar.float(cursor.take(scalar.n_bytes(), "bytes of a number")?, order))
}

pub(super) fn write(out: &mut impl Write, surface: &Written<'_>, encoding: Encoding) -> io::Result<()> {
    let name = match encoding {
        Encoding::Ascii => "ascii",
        Encoding::LittleEndian => "binary_little_endian",
        Encoding::BigEndian => "binary_big_endian",
    };
    writeln!(out, "ply\nformat {name} 1.0\ncomment glisson surface SPACE={} UNIT=mm", surface.space.name())?;
    writeln!(out, "element vertex {}", surface.positions_mm.len())?;
    writeln!(out, "property double x\nproperty double y\nproperty double z")?;
    writeln!(out, "element face {}", surface.triangles.len())?;
    writeln!(out, "property list uchar uint vertex_indices\nend_header")?;
    for p in &surface.positions_mm {
        match encoding {
            Encoding::Ascii => writeln!(out, "{} {} {}", p.x, p.y, p.z)?,
            Encoding::LittleEndian => {
                p.to_array().iter().try_for_each(|x| out.write_all(&x.to_le_bytes()))?;
            }
            Encoding::BigEndian => p.to_array().iter().try_for_each(|x| out.write_all(&x.to_be_bytes()))?,
        }
    }
    for triangle in surface.triangles {
        let [a, b, c] = triangle;
        match encoding {
            Encoding::Ascii => writeln!(out, "3 {a} {b} {c}")?,
            Encoding::LittleEndian => {
                out.write_all(&[3])?;
                triangle.iter().try_for_each(|v| out.write_all(&v.to_le_bytes()))?;
            }
            Encoding::BigEndian => {
                out.write_all(&[3])?;
                triangle.iter().try_for_each(|v| out.write_all(&v.to_be_bytes()))?;
            }
        }
    }
    Ok(())
}
