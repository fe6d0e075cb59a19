//! Writing VTK XML unstructured grids (`.vtu`), with values on nodes and tetrahedra.

use std::io::{self, Write};

use super::MeshFileError;
use crate::math::DVec3;
use crate::mesh::TetMesh;
use crate::scan::millimetres;
use crate::text::escaped_xml;
use crate::vtk_xml::write_array;

/// What a field of values lies on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FieldPlace {
    /// One value a node.
    Nodes,
    /// One value a tetrahedron.
    Tets,
}

/// The values of a field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FieldValues<'a> {
    /// One number each.
    Scalars(&'a [f64]),
    /// One vector each.
    Vectors(&'a [DVec3]),
    /// One whole number each.
    Integers(&'a [i32]),
}

/// A field of values to write beside the mesh, as it is: in its own unit, which the name should say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VtuField<'a> {
    /// Name.
    pub name: &'a str,
    /// What it lies on.
    pub place: FieldPlace,
    /// The values.
    pub values: FieldValues<'a>,
}

impl FieldValues<'_> {
    fn len(&self) -> usize {
        match self {
            Self::Scalars(v) => v.len(),
            Self::Vectors(v) => v.len(),
            Self::Integers(v) => v.len(),
        }
    }
}

pub(super) fn check_fields(mesh: &TetMesh, fields: &[VtuField<'_>]) -> Result<(), MeshFileError> {
    for field in fields {
        let expected = match field.place {
            FieldPlace::Nodes => mesh.positions_m.len(),
            FieldPlace::Tets => mesh.tetrahedra.len(),
        };
        let found = field.values.len();
        if found != expected {
            return Err(MeshFileError::FieldLength { name: field.name.to_owned(), found, expected });
        }
    }
    Ok(())
}

fn write_fields(out: &mut impl Write, fields: &[VtuField<'_>], place: FieldPlace) -> io::Result<()> {
    for field in fields.iter().filter(|f| f.place == place) {
        let name = escaped_xml(field.name);
        match field.values {
            FieldValues::Scalars(v) => {
                let bytes: Vec<u8> = v.iter().flat_map(|x| x.to_le_bytes()).collect();
                write_array(out, &format!("type=\"Float64\" Name=\"{name}\""), &bytes)?;
            }
            FieldValues::Vectors(v) => {
                let bytes: Vec<u8> = v.iter().flat_map(DVec3::to_array).flat_map(f64::to_le_bytes).collect();
                let attributes = format!("type=\"Float64\" Name=\"{name}\" NumberOfComponents=\"3\"");
                write_array(out, &attributes, &bytes)?;
            }
            FieldValues::Integers(v) => {
                let bytes: Vec<u8> = v.iter().flat_map(|x| x.to_le_bytes()).collect();
                write_array(out, &format!("type=\"Int32\" Name=\"{name}\""), &bytes)?;
            }
        }
    }
    Ok(())
}

/// Writes `mesh` in millimetres. Positions are text, so that reading them gives the same bits.
pub(super) fn write(mesh: &TetMesh, fields: &[VtuField<'_>], out: &mut impl Write) -> io::Result<()> {
    let n_tets = mesh.tetrahedra.len();
    writeln!(out, "<?xml version=\"1.0\"?>")?;
    writeln!(out, "<!-- Glisson tetrahedral mesh; millimetres; SPACE=LPS -->")?;
    writeln!(
        out,
        "<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\"LittleEndian\" \
         header_type=\"UInt64\" compressor=\"vtkZLibDataCompressor\">"
    )?;
    writeln!(out, "<UnstructuredGrid>")?;
    let n_points = mesh.positions_m.len();
    writeln!(out, "<Piece NumberOfPoints=\"{n_points}\" NumberOfCells=\"{n_tets}\">")?;
    writeln!(out, "<PointData>")?;
    write_fields(out, fields, FieldPlace::Nodes)?;
    writeln!(out, "</PointData>\n<CellData>")?;
    write_fields(out, fields, FieldPlace::Tets)?;
    writeln!(out, "</CellData>\n<Points>")?;
    writeln!(out, "<DataArray type=\"Float64\" Name=\"Points\" NumberOfComponents=\"3\" format=\"ascii\">")?;
    for p in &mesh.positions_m {
        writeln!(out, "{} {} {}", millimetres(p.x), millimetres(p.y), millimetres(p.z))?;
    }
    writeln!(out, "</DataArray>\n</Points>\n<Cells>")?;
    let connectivity: Vec<u8> =
        mesh.tetrahedra.iter().flatten().flat_map(|n| i64::from(n.0).to_le_bytes()).collect();
    write_array(out, "type=\"Int64\" Name=\"connectivity\"", &connectivity)?;
    let offsets: Vec<u8> = (1..=n_tets as i64).flat_map(|t| (4 * t).to_le_bytes()).collect();
    write_array(out, "type=\"Int64\" Name=\"offsets\"", &offsets)?;
    write_array(out, "type=\"UInt8\" Name=\"types\"", &vec![10; n_tets])?;
    writeln!(out, "</Cells>\n</Piece>\n</UnstructuredGrid>\n</VTKFile>")
}
