//! VTK XML polydata (`.vtp`): points, polygons and triangle strips. Vertices, lines and attributes are passed over.
//!
//! Source: VTK file formats, "XML file formats" (docs.vtk.org). The data arrays are in [`crate::vtk_xml`].

use std::fmt;
use std::io::{self, Write};

use roxmltree::Node;

use super::cursor::{Cursor, is_usable};
use super::{RawSurface, SurfaceFileError, Written};
use crate::scan::FormatError;
use crate::units::LengthUnit;
use crate::vtk_xml::{VtkArrays, VtkXml, count_attribute, write_array};

pub(super) fn parse(cursor: &Cursor<'_>) -> Result<RawSurface, SurfaceFileError> {
    let file = VtkXml::new(cursor.all()).map_err(|error| cursor.content_error(error))?;
    let space = cursor.space(file.head())?.unwrap_or_default();
    let mut raw = RawSurface { space, ..RawSurface::default() };
    read(&file, &mut raw).map_err(|error| cursor.content_error(error))?;
    Ok(raw)
}

fn read(file: &VtkXml<'_>, raw: &mut RawSurface) -> Result<(), FormatError> {
    let document = file.document()?;
    // The numbers as they are: their unit counts later, as for all surfaces.
    let (pieces, arrays) = file.pieces(&document, "PolyData", LengthUnit::Metre)?;
    for (p, piece) in pieces.into_iter().enumerate() {
        let place = format!("piece {p}");
        if count_attribute(piece, "NumberOfPoints", &place)? > 0 {
            read_piece(&arrays, piece, &place, raw)?;
        }
    }
    Ok(())
}

fn read_piece(
    arrays: &VtkArrays<'_>,
    piece: Node<'_, '_>,
    place: &str,
    raw: &mut RawSurface,
) -> Result<(), FormatError> {
    let first = raw.positions.len();
    raw.positions.extend(arrays.points(piece, place)?);
    if let Some(n) = raw.positions[first..].iter().position(|&p| !is_usable(p)) {
        let found = raw.positions[first + n].to_string();
        return Err(FormatError::named(format!("{place}, point {n}"), found, "coordinates within 1e9"));
    }
    for (tag, attribute) in [("Polys", "NumberOfPolys"), ("Strips", "NumberOfStrips")] {
        if piece.attribute(attribute).is_none() || count_attribute(piece, attribute, place)? == 0 {
            continue;
        }
        let n_cells = count_attribute(piece, attribute, place)?;
        let corners = arrays.cell_array(piece, tag, "connectivity", place)?;
        let ends = arrays.cell_array(piece, tag, "offsets", place)?;
        if ends.len() != n_cells {
            let found = format!("{} offsets in {tag}", ends.len());
            return Err(FormatError::named(place, found, format!("{attribute} = {n_cells}")));
        }
        let mut start = 0;
        for (c, end) in ends.into_iter().enumerate() {
            let name = || format!("{place}, cell {c} of {tag}");
            let cell =
                usize::try_from(end).ok().and_then(|end| corners.get(start..end)).ok_or_else(|| {
                    let expected = format!("an ascending range within its {} entries", corners.len());
                    FormatError::named(
                        name(),
                        format!("corners {start} to {end} of the connectivity"),
                        expected,
                    )
                })?;
            start += cell.len();
            let vertices = first..raw.positions.len();
            let mut add = |corners: &[i64]| {
                let added = raw.add_fan(corners, vertices.clone());
                added.map_err(|wrong| FormatError::named(name(), wrong.found, wrong.expected))
            };
            if tag == "Polys" {
                add(cell)?;
                continue;
            }
            for (n, three) in cell.windows(3).enumerate() {
                let [a, b, c] = [three[0], three[1], three[2]];
                add(&if n % 2 == 0 { [a, b, c] } else { [b, a, c] })?;
            }
        }
    }
    Ok(())
}

pub(super) fn write(out: &mut impl Write, surface: &Written<'_>, is_text: bool) -> io::Result<()> {
    let (n_points, n_triangles) = (surface.positions_mm.len(), surface.triangles.len());
    writeln!(out, "<?xml version=\"1.0\"?>")?;
    writeln!(out, "<!-- glisson surface SPACE={} UNIT=mm -->", surface.space.name())?;
    writeln!(
        out,
        "<VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\" \
         compressor=\"vtkZLibDataCompressor\">\n<PolyData>"
    )?;
    writeln!(
        out,
        "<Piece NumberOfPoints=\"{n_points}\" NumberOfVerts=\"0\" NumberOfLines=\"0\" NumberOfStrips=\"0\" \
         NumberOfPolys=\"{n_triangles}\">"
    )?;
    let mut arrays = ArrayWriter { out, is_text };
    writeln!(arrays.out, "<Points>")?;
    let attributes = "type=\"Float64\" Name=\"Points\" NumberOfComponents=\"3\"";
    arrays.rows(attributes, surface.positions_mm.iter().map(|p| p.to_array()), f64::to_le_bytes)?;
    writeln!(arrays.out, "</Points>\n<Polys>")?;
    let corners = surface.triangles.iter().map(|triangle| triangle.map(i64::from));
    arrays.rows("type=\"Int64\" Name=\"connectivity\"", corners, i64::to_le_bytes)?;
    let ends = (1..=n_triangles as i64).map(|t| [3 * t]);
    arrays.rows("type=\"Int64\" Name=\"offsets\"", ends, i64::to_le_bytes)?;
    writeln!(arrays.out, "</Polys>\n</Piece>\n</PolyData>\n</VTKFile>")
}

/// Writes data arrays as text or compressed.
struct ArrayWriter<'a, W: Write> {
    out: &'a mut W,
    is_text: bool,
}

impl<W: Write> ArrayWriter<'_, W> {
    fn rows<T: fmt::Display + Copy, const N: usize>(
        &mut self,
        attributes: &str,
        rows: impl Iterator<Item = [T; N]>,
        bytes_of: fn(T) -> [u8; 8],
    ) -> io::Result<()> {
        if !self.is_text {
            let bytes: Vec<u8> = rows.flatten().flat_map(bytes_of).collect();
            return write_array(self.out, attributes, &bytes);
        }
        writeln!(self.out, "<DataArray {attributes} format=\"ascii\">")?;
        for row in rows {
            writeln!(self.out, "{}", row.map(|number| number.to_string()).join(" "))?;
        }
        writeln!(self.out, "</DataArray>")
    }
}
