//! VTK legacy files (`.vtk`), ASCII and binary, versions 2.0 to 5.1.
//!
//! Source: VTK file formats, "Simple legacy formats" (docs.vtk.org). Binary data are big-endian. Up to 4.2 a
//! cell is its number of nodes and the nodes; from 5.0 on cells are two arrays, offsets and connectivity.
//! Data on points and cells are passed over.

use std::io::{self, Write};

use super::cells::{Frame, RawMesh, VtkCells};
use super::format::{MeshFormat, file};
use crate::binary::{ByteOrder, NumberType};
use crate::math::DVec3;
use crate::mesh::TetMesh;
use crate::scan::{FormatError, Place, Scanner, millimetres, quoted};
use crate::units::LengthUnit;

struct LegacyReader<'a> {
    scanner: Scanner<'a>,
    is_binary: bool,
    is_old: bool,
    unit: LengthUnit,
}

fn number_type(name: &str) -> Option<NumberType> {
    Some(match name.to_ascii_lowercase().as_str() {
        "char" => NumberType::I8,
        "unsigned_char" => NumberType::U8,
        "short" => NumberType::I16,
        "unsigned_short" => NumberType::U16,
        "int" | "vtktypeint32" => NumberType::I32,
        "unsigned_int" => NumberType::U32,
        "long" | "vtktypeint64" => NumberType::I64,
        "unsigned_long" | "vtktypeuint64" => NumberType::U64,
        "vtkidtype" => NumberType::I32,
        "float" => NumberType::F32,
        "double" => NumberType::F64,
        _ => return None,
    })
}

/// The format's row of the table.
pub(super) const FORMAT: MeshFormat = MeshFormat {
    name: "VTK legacy",
    extensions: &["vtk"],
    n_files: 1,
    read: |files, unit| read(file(files, 0), unit),
    write: Some(write),
};

/// The mesh in the bytes of a legacy file.
fn read(bytes: &[u8], unit: LengthUnit) -> Result<RawMesh, FormatError> {
    let mut scanner = Scanner::new(bytes);
    let first = scanner.line().unwrap_or_default();
    let version = std::str::from_utf8(first)
        .ok()
        .and_then(|line| line.trim().strip_prefix("# vtk DataFile Version"))
        .and_then(|version| {
            let (major, minor) = version.trim().split_once('.')?;
            Some((major.parse::<u32>().ok()?, minor.parse::<u32>().ok()?))
        });
    let Some(version) = version.filter(|v| ((2, 0)..=(5, 1)).contains(v)) else {
        return Err(FormatError {
            place: Place::Line(1),
            found: quoted(first),
            expected: "`# vtk DataFile Version` 2.0 to 5.1".into(),
        });
    };
    let frame = Frame::named_in(scanner.line().unwrap_or_default());
    let is_binary = match scanner.expect_word("ASCII or BINARY")? {
        b"ASCII" => false,
        b"BINARY" => true,
        other => return Err(scanner.error(quoted(other), "ASCII or BINARY")),
    };
    let mut reader = LegacyReader { scanner, is_binary, is_old: version < (5, 0), unit };
    reader.read_dataset(frame)
}

impl LegacyReader<'_> {
    fn read_dataset(&mut self, frame: Frame) -> Result<RawMesh, FormatError> {
        let mut raw = RawMesh { frame, ..RawMesh::default() };
        let mut cells = VtkCells::default();
        let (mut has_points, mut has_cells) = (false, false);
        while let Some(word) = self.scanner.word() {
            match word {
                b"DATASET" => {
                    let kind = self.scanner.expect_word("UNSTRUCTURED_GRID")?;
                    if kind != b"UNSTRUCTURED_GRID" {
                        let expected = "UNSTRUCTURED_GRID (a surface is read by `glisson mesh`)";
                        return Err(self.scanner.error(format!("dataset {}", quoted(kind)), expected));
                    }
                }
                b"POINTS" if !has_points => {
                    raw.positions_m = self.read_points()?;
                    has_points = true;
                }
                b"CELLS" if !has_cells => {
                    self.read_cells(&mut cells)?;
                    has_cells = true;
                }
                b"CELL_TYPES" if has_cells && cells.types.is_empty() => {
                    let bytes_each = if self.is_binary { 4 } else { 2 };
                    let n = self.scanner.count("cell types", bytes_each)?;
                    self.end_of_header();
                    cells.types = self.integers(n, NumberType::I32, "cell types")?;
                }
                b"FIELD" => self.skip_field()?,
                b"METADATA" => self.skip_metadata(),
                b"POINT_DATA" | b"CELL_DATA" => break,
                other => {
                    let expected = "one each of DATASET, POINTS, CELLS, CELL_TYPES, in this order";
                    return Err(self.scanner.error(quoted(other), expected));
                }
            }
        }
        if !has_points || !has_cells {
            return Err(self.scanner.error("the end of the mesh", "POINTS, CELLS and CELL_TYPES before it"));
        }
        let n_points = raw.positions_m.len();
        raw.add_vtk_cells(&cells, n_points)?;
        Ok(raw)
    }

    /// Binary data start behind the end of the header's line.
    fn end_of_header(&mut self) {
        if self.is_binary {
            self.scanner.line();
        }
    }

    fn type_word(&mut self) -> Result<NumberType, FormatError> {
        let name = self.scanner.expect_text("a number type")?;
        number_type(&name).ok_or_else(|| {
            self.scanner.error(quoted(name.as_bytes()), "a VTK number type such as float, double or int")
        })
    }

    fn read_points(&mut self) -> Result<Vec<DVec3>, FormatError> {
        let found = self.scanner.integer("the number of points")?;
        let kind = self.type_word()?;
        self.end_of_header();
        let bytes_each = if self.is_binary { 3 * kind.n_bytes() } else { 6 };
        let n = self.scanner.check_count(found, "points", bytes_each)?;
        if !self.is_binary {
            let unit = self.unit;
            let mut next = || self.scanner.length_m(unit, "a coordinate");
            return (0..n).map(|_| Ok(DVec3::new(next()?, next()?, next()?))).collect();
        }
        let data = self.scanner.take(n * bytes_each, "point coordinates")?;
        crate::binary::positions_from_bytes(data, kind, ByteOrder::Big, self.unit)
    }

    fn integers(&mut self, n: usize, kind: NumberType, what: &str) -> Result<Vec<i64>, FormatError> {
        if !self.is_binary {
            return (0..n).map(|_| self.scanner.integer(what)).collect();
        }
        let data = self.scanner.take(n * kind.n_bytes(), what)?;
        crate::binary::integers_from_bytes(data, kind, ByteOrder::Big, what)
    }

    fn read_cells(&mut self, cells: &mut VtkCells) -> Result<(), FormatError> {
        let least = if self.is_binary { 4 } else { 2 };
        let first = self.scanner.count("cells", least)?;
        let second = self.scanner.count("cell entries", least)?;
        if self.is_old {
            self.end_of_header();
            let entries = self.integers(second, NumberType::I32, "cell entries")?;
            return split_cells(&entries, first, cells);
        }
        // `first` counts the offsets, one more than there are cells.
        let offsets = self.read_cell_array(first, "OFFSETS")?;
        cells.connectivity = self.read_cell_array(second, "CONNECTIVITY")?;
        match offsets.split_first() {
            None => Ok(()),
            Some((0, ends)) => {
                cells.ends = ends.to_vec();
                Ok(())
            }
            Some((start, _)) => {
                Err(FormatError::named("OFFSETS", format!("{start} as the first offset"), "0"))
            }
        }
    }

    fn read_cell_array(&mut self, n: usize, name: &str) -> Result<Vec<i64>, FormatError> {
        let word = self.scanner.expect_word(name)?;
        if word != name.as_bytes() {
            return Err(self.scanner.error(quoted(word), name));
        }
        let kind = self.type_word()?;
        self.end_of_header();
        self.integers(n, kind, name)
    }

    fn skip_field(&mut self) -> Result<(), FormatError> {
        self.scanner.expect_word("the name of the field")?;
        let n_arrays = self.scanner.count("arrays", 2)?;
        for _ in 0..n_arrays {
            let mut name = self.scanner.expect_word("the name of an array")?;
            if name == b"METADATA" {
                self.skip_metadata();
                name = self.scanner.expect_word("the name of an array")?;
            }
            let n_components = self.scanner.count("components", 1)?;
            let n_tuples = self.scanner.count("tuples", 1)?;
            let n = n_components.saturating_mul(n_tuples);
            let type_name = self.scanner.expect_text("a number type")?;
            self.end_of_header();
            match number_type(&type_name) {
                Some(kind) if self.is_binary => {
                    let n_bytes = n.saturating_mul(kind.n_bytes());
                    self.scanner.take(n_bytes, &format!("field {}", quoted(name)))?;
                }
                Some(_) => {
                    for _ in 0..n {
                        self.scanner.expect_word("a value of the field")?;
                    }
                }
                None => {
                    let expected = "an array of numbers: write the mesh without text fields";
                    return Err(self
                        .scanner
                        .error(format!("a field of {}", quoted(type_name.as_bytes())), expected));
                }
            }
        }
        Ok(())
    }

    /// Passes over a METADATA block, which ends with an empty line.
    fn skip_metadata(&mut self) {
        self.scanner.line();
        while self.scanner.line().is_some_and(|line| !line.trim_ascii().is_empty()) {}
    }
}

/// Splits `n, node, node, ...` lists.
fn split_cells(entries: &[i64], n_cells: usize, cells: &mut VtkCells) -> Result<(), FormatError> {
    let mut rest = entries;
    for c in 0..n_cells {
        let nodes = rest.split_first().and_then(|(&n, behind)| {
            let n = usize::try_from(n).ok()?;
            Some((behind.get(..n)?, behind.get(n..)?))
        });
        let Some((nodes, behind)) = nodes else {
            let found = format!("{} entries left, beginning with {:?}", rest.len(), rest.first());
            return Err(FormatError::named(
                format!("cell {c}"),
                found,
                "its number of nodes and that many nodes",
            ));
        };
        cells.connectivity.extend_from_slice(nodes);
        cells.ends.push(cells.connectivity.len() as i64);
        rest = behind;
    }
    Ok(())
}

/// Writes `mesh` as ASCII, version 3.0, in millimetres: reading it gives the same bits.
fn write(mesh: &TetMesh, out: &mut impl Write) -> io::Result<()> {
    writeln!(out, "# vtk DataFile Version 3.0")?;
    writeln!(out, "Glisson tetrahedral mesh; millimetres; SPACE=LPS")?;
    writeln!(out, "ASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS {} double", mesh.positions_m.len())?;
    for p in &mesh.positions_m {
        writeln!(out, "{} {} {}", millimetres(p.x), millimetres(p.y), millimetres(p.z))?;
    }
    let n = mesh.tetrahedra.len();
    writeln!(out, "CELLS {n} {}", 5 * n)?;
    for [a, b, c, d] in &mesh.tetrahedra {
        writeln!(out, "4 {a} {b} {c} {d}")?;
    }
    writeln!(out, "CELL_TYPES {n}")?;
    for _ in 0..n {
        writeln!(out, "10")?;
    }
    Ok(())
}
