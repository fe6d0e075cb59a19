//! VTK legacy polydata, text or binary (big-endian), versions 1 to 5.1: points, polygons and triangle strips.
//! Vertices, lines and attributes are passed over.

use std::io::{self, Write};

use super::cursor::{Cursor, quote};
use super::{RawSurface, SurfaceFileError, Written};
use crate::binary::{ByteOrder, NumberType};
use crate::math::DVec3;

fn number_type(name: &str) -> Option<NumberType> {
    Some(match name.to_ascii_lowercase().as_str() {
        "char" | "signed_char" => NumberType::I8,
        "unsigned_char" => NumberType::U8,
        "short" => NumberType::I16,
        "unsigned_short" => NumberType::U16,
        "int" | "vtkidtype" => NumberType::I32,
        "unsigned_int" => NumberType::U32,
        "long" | "vtktypeint64" => NumberType::I64,
        "unsigned_long" | "vtktypeuint64" => NumberType::U64,
        "float" => NumberType::F32,
        "double" => NumberType::F64,
        _ => return None,
    })
}

#[derive(Clone, Copy)]
enum Number {
    Integer(i64),
    Real(f64),
}

impl Number {
    /// From big-endian bytes.
    fn of_bytes(bytes: &[u8], kind: NumberType) -> Self {
        // Above i64::MAX there is no such count or index: what it is as an i64 is below 0 and refused.
        let signed = if kind == NumberType::U64 { NumberType::I64 } else { kind };
        match signed.integer(bytes, ByteOrder::Big) {
            Some(integer) => Self::Integer(integer),
            None => Self::Real(kind.float(bytes, ByteOrder::Big)),
        }
    }

    fn real(self) -> f64 {
        match self {
            Self::Integer(i) => i as f64,
            Self::Real(x) => x,
        }
    }
}

struct Reader<'a> {
    cursor: Cursor<'a>,
    binary: bool,
}

pub(super) fn parse(mut cursor: Cursor<'_>) -> Result<RawSurface, SurfaceFileError> {
    let first = cursor.text_line("'# vtk DataFile Version'")?;
    if !first.to_ascii_lowercase().starts_with("# vtk datafile version") {
        return Err(cursor.error("'# vtk DataFile Version'", quote(first.as_bytes())));
    }
    let title = cursor.next_line().unwrap_or_default();
    let space = cursor.space(title)?.unwrap_or_default();
    let encoding = cursor.text_line("ASCII or BINARY")?;
    let binary = match encoding.trim().to_ascii_uppercase().as_str() {
        "ASCII" => false,
        "BINARY" => true,
        _ => return Err(cursor.error("ASCII or BINARY", quote(encoding.as_bytes()))),
    };
    let mut reader = Reader { cursor, binary };
    reader.expect("DATASET")?;
    let dataset = reader.cursor.token("POLYDATA")?;
    if !dataset.eq_ignore_ascii_case("POLYDATA") {
        return Err(reader.cursor.error("DATASET POLYDATA (a surface)", quote(dataset.as_bytes())));
    }
    let mut raw = RawSurface { space, ..Default::default() };
    while let Some(section) = reader.cursor.next_token()? {
        match section.to_ascii_uppercase().as_str() {
            "POINTS" => reader.points(&mut raw)?,
            "POLYGONS" => reader.cells(|cursor, corners| {
                let n_vertices = raw.positions.len();
                raw.add_polygon(cursor, corners, n_vertices)
            })?,
            "TRIANGLE_STRIPS" => reader.cells(|cursor, corners| {
                let n_vertices = raw.positions.len();
                for (n, three) in corners.windows(3).enumerate() {
                    let [a, b, c] = [three[0], three[1], three[2]];
                    let triangle = if n % 2 == 0 { [a, b, c] } else { [b, a, c] };
                    raw.add_polygon(cursor, &triangle, n_vertices)?;
                }
                Ok(())
            })?,
            "VERTICES" | "LINES" => reader.cells(|_, _| Ok(()))?,
            "METADATA" => reader.skip_metadata(),
            "FIELD" => reader.skip_fields()?,
            "POINT_DATA" | "CELL_DATA" => break,
            _ => {
                let expected =
                    "POINTS, POLYGONS, TRIANGLE_STRIPS, VERTICES, LINES, FIELD, METADATA or *_DATA";
                return Err(reader.cursor.error(expected, quote(section.as_bytes())));
            }
        }
    }
    Ok(raw)
}

impl Reader<'_> {
    fn expect(&mut self, word: &str) -> Result<(), SurfaceFileError> {
        let found = self.cursor.token(word)?;
        if found.eq_ignore_ascii_case(word) {
            return Ok(());
        }
        Err(self.cursor.error(word, quote(found.as_bytes())))
    }

    fn scalar(&mut self) -> Result<NumberType, SurfaceFileError> {
        let name = self.cursor.token("a number type")?;
        number_type(name).ok_or_else(|| {
            self.cursor.error("a number type (float, double, int, vtktypeint64, ...)", quote(name.as_bytes()))
        })
    }

    /// `count` numbers; in binary files the line must end before them.
    fn numbers(
        &mut self,
        count: u64,
        scalar: NumberType,
        what: &str,
    ) -> Result<Vec<Number>, SurfaceFileError> {
        if self.binary {
            self.cursor.skip_line_end();
            let count = self.cursor.check_count(count, scalar.n_bytes(), what)?;
            let bytes = self.cursor.take(count * scalar.n_bytes(), what)?;
            return Ok(bytes.chunks_exact(scalar.n_bytes()).map(|b| Number::of_bytes(b, scalar)).collect());
        }
        let count = self.cursor.check_text_count(count, what)?;
        let is_real = !scalar.is_integer();
        (0..count)
            .map(|_| match is_real {
                true => self.cursor.number(what).map(Number::Real),
                false => self.cursor.number(what).map(Number::Integer),
            })
            .collect()
    }

    fn integers(&mut self, count: u64, scalar: NumberType, what: &str) -> Result<Vec<i64>, SurfaceFileError> {
        let numbers = self.numbers(count, scalar, what)?;
        numbers
            .into_iter()
            .map(|n| match n {
                Number::Integer(i) => Ok(i),
                Number::Real(x) => Err(self.cursor.error("integers", x.to_string())),
            })
            .collect()
    }

    fn points(&mut self, raw: &mut RawSurface) -> Result<(), SurfaceFileError> {
        if !raw.positions.is_empty() {
            return Err(self.cursor.error("one POINTS section", "a second one"));
        }
        let count: u64 = self.cursor.number("a number of points")?;
        let scalar = self.scalar()?;
        let numbers = self.numbers(count.saturating_mul(3), scalar, "coordinates")?;
        for p in numbers.chunks_exact(3) {
            let p = DVec3::new(p[0].real(), p[1].real(), p[2].real());
            raw.positions.push(self.cursor.finite(p)?);
        }
        Ok(())
    }

    /// Reads cells in the layout of version 1 to 4 (length, corners, length, ...) or 5 (offsets, corners) and
    /// hands each to `see`.
    fn cells(
        &mut self,
        mut see: impl FnMut(&Cursor<'_>, &[i64]) -> Result<(), SurfaceFileError>,
    ) -> Result<(), SurfaceFileError> {
        let count: u64 = self.cursor.number("a number of cells")?;
        let size: u64 = self.cursor.number("a number of integers")?;
        let rest = self.cursor.rest().trim_ascii_start();
        if rest.len() >= 7 && rest[..7].eq_ignore_ascii_case(b"OFFSETS") {
            self.expect("OFFSETS")?;
            let scalar = self.scalar()?;
            let offsets = self.integers(count, scalar, "offsets")?;
            self.expect("CONNECTIVITY")?;
            let scalar = self.scalar()?;
            let corners = self.integers(size, scalar, "corners")?;
            for pair in offsets.windows(2) {
                let range = usize::try_from(pair[0]).ok().zip(usize::try_from(pair[1]).ok());
                let Some(cell) = range.and_then(|(first, end)| corners.get(first..end)) else {
                    let expected = format!("ascending offsets up to {size}");
                    return Err(self.cursor.error(expected, format!("{} and {}", pair[0], pair[1])));
                };
                see(&self.cursor, cell)?;
            }
            return Ok(());
        }
        let list = self.integers(size, NumberType::I32, "corners and their numbers")?;
        let mut rest = list.as_slice();
        for _ in 0..count {
            let cell = rest.split_first().and_then(|(&n, tail)| {
                let n = usize::try_from(n).ok().filter(|&n| n <= tail.len())?;
                Some(tail.split_at(n))
            });
            let Some((corners, tail)) = cell else {
                let expected = format!("{count} cells in {size} integers");
                return Err(self.cursor.error(expected, "a cell that runs beyond them"));
            };
            see(&self.cursor, corners)?;
            rest = tail;
        }
        if rest.is_empty() {
            return Ok(());
        }
        let found = format!("{} integers left over", rest.len());
        Err(self.cursor.error(format!("{count} cells in {size} integers"), found))
    }

    /// Skips to the empty line that ends metadata.
    fn skip_metadata(&mut self) {
        self.cursor.next_line();
        while self.cursor.next_line().is_some_and(|line| !line.trim_ascii().is_empty()) {}
    }

    fn skip_fields(&mut self) -> Result<(), SurfaceFileError> {
        self.cursor.token("a field's name")?;
        let n_arrays: u64 = self.cursor.number("a number of arrays")?;
        for _ in 0..n_arrays {
            self.cursor.token("an array's name")?;
            let width: u64 = self.cursor.number("a number of components")?;
            let count: u64 = self.cursor.number("a number of tuples")?;
            let scalar = self.scalar()?;
            self.numbers(width.saturating_mul(count), scalar, "field values")?;
        }
        Ok(())
    }
}

pub(super) fn write(out: &mut impl Write, surface: &Written<'_>, binary: bool) -> io::Result<()> {
    let encoding = if binary { "BINARY" } else { "ASCII" };
    let too_many = |_| io::Error::new(io::ErrorKind::InvalidInput, "VTK legacy files count by 31 bits");
    i32::try_from(surface.positions_mm.len()).map_err(too_many)?;
    i32::try_from(4 * surface.triangles.len()).map_err(too_many)?;
    writeln!(out, "# vtk DataFile Version 3.0\nglisson surface SPACE={} UNIT=mm", surface.space.name())?;
    writeln!(out, "{encoding}\nDATASET POLYDATA\nPOINTS {} double", surface.positions_mm.len())?;
    for p in &surface.positions_mm {
        if binary {
            p.to_array().iter().try_for_each(|x| out.write_all(&x.to_be_bytes()))?;
        } else {
            writeln!(out, "{} {} {}", p.x, p.y, p.z)?;
        }
    }
    let n = surface.triangles.len();
    writeln!(out, "{}POLYGONS {n} {}", if binary { "\n" } else { "" }, 4 * n)?;
    for triangle in surface.triangles {
        let [a, b, c] = triangle;
        if binary {
            out.write_all(&3u32.to_be_bytes())?;
            triangle.iter().try_for_each(|v| out.write_all(&v.to_be_bytes()))?;
        } else {
            writeln!(out, "3 {a} {b} {c}")?;
        }
    }
    if binary { writeln!(out) } else { Ok(()) }
}
