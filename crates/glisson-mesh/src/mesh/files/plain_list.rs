//! The plain list of the active-trocar thesis (its fig. 2.3, as Forge3 writes it): number of vertices,
//! number of tetrahedra, positions, four vertices of each tetrahedron; words separated by blanks.
//!
//! The thesis does not say whether vertices count from 0 or 1. A list that names a vertex of the number of
//! vertices itself must count from 1; any other is read as counting from 0.

use super::cells::{Frame, RawMesh};
use super::format::{MeshFormat, file};
use crate::math::DVec3;
use crate::scan::{FormatError, Scanner, quoted};
use crate::units::LengthUnit;

/// The format's row of the table.
pub(super) const FORMAT: MeshFormat = MeshFormat {
    name: "plain list",
    extensions: &["tet", "txt"],
    n_files: 1,
    read: |files, unit| read(file(files, 0), unit),
    write: None,
};

/// The mesh in the bytes of a list.
fn read(bytes: &[u8], unit: LengthUnit) -> Result<RawMesh, FormatError> {
    let mut scanner = Scanner::with_comments(bytes);
    let mut raw = RawMesh { frame: Frame::named_in(bytes), ..RawMesh::default() };
    let n_nodes = scanner.count("vertices", 6)?;
    let n_tets = scanner.count("tetrahedra", 8)?;
    for _ in 0..n_nodes {
        let mut next = || scanner.length_m(unit, "a coordinate");
        raw.positions_m.push(DVec3::new(next()?, next()?, next()?));
    }
    let mut corners = Vec::with_capacity(n_tets);
    for _ in 0..n_tets {
        let mut next = || scanner.integer("a vertex");
        corners.push([next()?, next()?, next()?, next()?]);
    }
    if let Some(word) = scanner.word() {
        let expected = format!("the end of the list after {n_nodes} vertices and {n_tets} tetrahedra");
        return Err(scanner.error(quoted(word), expected));
    }
    let first = i64::from(corners.as_flattened().contains(&(n_nodes as i64)));
    for (t, nodes) in corners.into_iter().enumerate() {
        raw.add_tetrahedron(nodes, first, n_nodes, || format!("tetrahedron {}", t + 1))?;
    }
    Ok(raw)
}
