//! TetGen's pair of text files: `.node` (number, x, y, z, attributes, marker) and `.ele` (number, nodes,
//! attributes), numbered from 0 or 1; `#` starts a comment.
//!
//! Source: H. Si, TetGen manual, "File formats" (wias-berlin.de/software/tetgen).

use super::cells::{Frame, RawMesh};
use super::format::{MeshFormat, file};
use crate::math::DVec3;
use crate::scan::{FormatError, Place, Scanner, quoted};
use crate::units::LengthUnit;

/// The format's row of the table.
pub(super) const FORMAT: MeshFormat = MeshFormat {
    name: "TetGen",
    extensions: &["node", "ele"],
    n_files: 2,
    read: |files, unit| read(file(files, 0), file(files, 1), unit),
    write: None,
};

/// The mesh in the bytes of the two files.
fn read(node: &[u8], ele: &[u8], unit: LengthUnit) -> Result<RawMesh, FormatError> {
    let mut raw = RawMesh { frame: Frame::named_in(node), ..RawMesh::default() };
    let first = read_nodes(node, unit, &mut raw).map_err(|e| in_file(e, ".node"))?;
    read_tetrahedra(ele, first, &mut raw).map_err(|e| in_file(e, ".ele"))?;
    Ok(raw)
}

fn in_file(mut error: FormatError, name: &str) -> FormatError {
    error.place = Place::Named(format!("{name} file, {}", error.place));
    error
}

/// Reads the number of the next line and checks that numbers count up from the first.
fn check_number(scanner: &mut Scanner<'_>, at: usize, first: &mut i64) -> Result<(), FormatError> {
    let number = scanner.integer("a number from 0 or 1 up")?;
    if at == 0 && (number == 0 || number == 1) {
        *first = number;
    }
    let expected = *first + at as i64;
    if number != expected {
        return Err(
            scanner.error(format!("number {number}"), format!("number {expected}, counting from 0 or 1"))
        );
    }
    Ok(())
}

/// Returns the number of the first node.
fn read_nodes(bytes: &[u8], unit: LengthUnit, raw: &mut RawMesh) -> Result<i64, FormatError> {
    let mut scanner = Scanner::with_comments(bytes);
    let n = scanner.count("nodes", 8)?;
    let dimension = scanner.integer("the dimension")?;
    if dimension != 3 {
        return Err(scanner.error(format!("dimension {dimension}"), "3"));
    }
    let n_attributes = scanner.count("attributes", 1)?;
    let n_markers = scanner.count("markers", 1)?;
    let mut first = 0;
    for at in 0..n {
        check_number(&mut scanner, at, &mut first)?;
        let mut next = || scanner.length_m(unit, "a coordinate");
        raw.positions_m.push(DVec3::new(next()?, next()?, next()?));
        for _ in 0..n_attributes + n_markers {
            scanner.number("an attribute or marker")?;
        }
    }
    end(&mut scanner, "nodes")?;
    Ok(first)
}

fn read_tetrahedra(bytes: &[u8], first_node: i64, raw: &mut RawMesh) -> Result<(), FormatError> {
    let mut scanner = Scanner::with_comments(bytes);
    let n = scanner.count("tetrahedra", 10)?;
    let n_corners = scanner.integer("the number of nodes of a tetrahedron")?;
    if n_corners != 4 {
        let found = format!("tetrahedra of {n_corners} nodes");
        return Err(scanner.error(found, "4 nodes (run TetGen without -o2)"));
    }
    let n_attributes = scanner.count("attributes", 1)?;
    let n_nodes = raw.positions_m.len();
    let mut first = first_node;
    for at in 0..n {
        check_number(&mut scanner, at, &mut first)?;
        let mut next = || scanner.integer("a node");
        let nodes = [next()?, next()?, next()?, next()?];
        raw.add_tetrahedron(nodes, first_node, n_nodes, || format!("tetrahedron {}", first + at as i64))?;
        for _ in 0..n_attributes {
            scanner.number("an attribute")?;
        }
    }
    end(&mut scanner, "tetrahedra")
}

fn end(scanner: &mut Scanner<'_>, what: &str) -> Result<(), FormatError> {
    match scanner.word() {
        None => Ok(()),
        Some(word) => {
            Err(scanner.error(quoted(word), format!("the end of the file after the {what} announced")))
        }
    }
}
