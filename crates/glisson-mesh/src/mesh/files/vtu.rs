//! Reading VTK XML unstructured grids (`.vtu`).
//!
//! Source: VTK file formats, "XML file formats" (docs.vtk.org). The data arrays are in [`crate::vtk_xml`].

use roxmltree::Node;

use super::cells::{CellKind, Frame, RawMesh, VtkCells, vtk_cell_kind};
use super::format::{MeshFormat, file};
use super::vtu_write;
use crate::scan::{FormatError, Place};
use crate::units::LengthUnit;
use crate::vtk_xml::{VtkArrays, VtkXml, count_attribute};

/// The cell field with the label of each tetrahedron: what `glisson mesh-organs` writes.
pub const LABEL_FIELD: &str = "label";

/// The format's row of the table.
pub(super) const FORMAT: MeshFormat = MeshFormat {
    name: "VTK XML",
    extensions: &["vtu"],
    n_files: 1,
    read: |files, unit| read(file(files, 0), unit),
    write: Some(|mesh, out| vtu_write::write(mesh, &[], out)),
};

/// The mesh in the bytes of a file.
fn read(bytes: &[u8], unit: LengthUnit) -> Result<RawMesh, FormatError> {
    let file = VtkXml::new(bytes)?;
    let document = file.document()?;
    let (pieces, arrays) = file.pieces(&document, "UnstructuredGrid", unit)?;
    let mut raw = RawMesh { frame: Frame::named_in(file.head()), ..RawMesh::default() };
    for (p, piece) in pieces.into_iter().enumerate() {
        read_piece(&arrays, piece, &format!("piece {p}"), &mut raw)?;
    }
    Ok(raw)
}

fn read_piece(
    arrays: &VtkArrays<'_>,
    piece: Node<'_, '_>,
    place: &str,
    raw: &mut RawMesh,
) -> Result<(), FormatError> {
    let n_points = count_attribute(piece, "NumberOfPoints", place)?;
    let n_cells = count_attribute(piece, "NumberOfCells", place)?;
    if n_points == 0 && n_cells == 0 {
        return Ok(());
    }
    raw.positions_m.extend(arrays.points(piece, place)?);
    let integers = |name: &str| arrays.cell_array(piece, "Cells", name, place);
    let types = integers("types")?;
    if types.len() != n_cells {
        let found = format!("{} cell types", types.len());
        return Err(FormatError::named(place, found, format!("NumberOfCells = {n_cells}")));
    }
    let list = VtkCells { ends: integers("offsets")?, connectivity: integers("connectivity")?, types };
    raw.add_vtk_cells(&list, n_points).map_err(|mut error| {
        error.place = Place::Named(format!("{place}, {}", error.place));
        error
    })?;
    // A field that is no label of each cell is not needed to read the mesh.
    let labels = arrays.cell_field(piece, LABEL_FIELD, place).ok().flatten();
    let Some(labels) = labels.filter(|labels| labels.len() == n_cells) else { return Ok(()) };
    let is_tetrahedron = |cell: &&i64| vtk_cell_kind(**cell) == Some(CellKind::Tetrahedron);
    let of_tetrahedra = labels.iter().zip(&list.types).filter(|(_, cell)| is_tetrahedron(cell));
    raw.label_of.extend(of_tetrahedra.map(|(label, _)| label));
    Ok(())
}
