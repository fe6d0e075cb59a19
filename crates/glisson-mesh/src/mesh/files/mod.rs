//! Tetrahedral mesh files.
//!
//! | format | extension | read | written |
//! |---|---|---|---|
//! | VTK legacy | `.vtk` | ASCII and binary, 2.0 to 5.1 | ASCII 3.0 |
//! | VTK XML | `.vtu` | ASCII, base64, appended raw or base64, zlib | positions ASCII, the rest base64 + zlib |
//! | Gmsh | `.msh` | 2.x and 4.1, ASCII and binary; 1 | ASCII 2.2 (and 4.1) |
//! | TetGen | `.node` + `.ele` | numbered from 0 or 1 | |
//! | FEBio | `.feb` | 1.x to 4.0 (`Geometry` or `Mesh`) | |
//! | Abaqus | `.inp` | flat, or one part with one instance that is not moved | |
//! | plain list | `.tet`, `.txt` | words separated by blanks, see `plain_list` | |
//!
//! The length unit is that of [`ImportPolicy::unit`], since formats do not say it: millimetres unless told otherwise, and
//! millimetres are written. Axes are LPS unless a title or comment says `SPACE=RAS`; `SPACE=LPS` is written.
//! Written positions are decimals of the metres with the point moved, and text is read in the same way, so
//! that writing and reading gives the same bits. Binary files of others in millimetres are divided by 1000
//! after reading, which rounds once (relative 1.2e-16).
//!
//! Labels of tetrahedra (which organ each belongs to) are read from the cell field [`LABEL_FIELD`] of `.vtu` files.
//!
//! Counts in a header are checked against the bytes that are there before anything is allocated.

mod abaqus;
mod cells;
mod febio;
mod format;
mod gmsh;
mod numbered;
mod plain_list;
mod tetgen;
mod vtk_legacy;
mod vtu;
mod vtu_write;

pub use crate::scan::{FormatError, Place};
pub use format::MeshFormat;
pub use vtu::LABEL_FIELD;
pub use vtu_write::{FieldPlace, FieldValues, VtuField};

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use self::cells::{Frame, RawMesh};
use crate::files::write_atomically;
use crate::math::DVec3;
use crate::mesh::TetMesh;
use crate::mesh::faults::{ImportPolicy, ImportReport, MeshError};

/// Why a mesh file was not read or written.
#[derive(Debug, thiserror::Error)]
pub enum MeshFileError {
    /// The name does not tell the format.
    #[error("{}: found the extension `{found}`, expected one of {allowed}", path.display())]
    UnknownExtension {
        /// The file.
        path: PathBuf,
        /// Its extension.
        found: String,
        /// Those that can be read, or written.
        allowed: String,
    },
    /// The file system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What it answered.
        source: io::Error,
    },
    /// The content is not what the format says.
    #[error("{source_name}, {error}")]
    Format {
        /// The file.
        source_name: String,
        /// What is wrong, and where.
        error: FormatError,
    },
    /// The content is a mesh that cannot be used.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// A field to write does not fit the mesh.
    #[error("field `{name}` has {found} values, the mesh needs {expected}")]
    FieldLength {
        /// The field.
        name: String,
        /// Its number of values.
        found: usize,
        /// Number of nodes or tetrahedra.
        expected: usize,
    },
}

/// Every format, in the order of messages: one line a format, whose description is in its own file (docs/extending.md).
pub const FORMATS: &[MeshFormat] = &[
    vtk_legacy::FORMAT,
    vtu::FORMAT,
    gmsh::FORMAT,
    tetgen::FORMAT,
    febio::FORMAT,
    abaqus::FORMAT,
    plain_list::FORMAT,
];

/// The format that an extension names, in lower case and without its dot.
pub fn format_of_extension(extension: &str) -> Option<&'static MeshFormat> {
    FORMATS.iter().find(|format| format.extensions.contains(&extension))
}

/// The extensions of all formats that `is_meant` picks, without their dots, in the order of the table.
pub fn extensions_of(is_meant: impl Fn(&MeshFormat) -> bool) -> Vec<&'static str> {
    let meant = FORMATS.iter().filter(|format| is_meant(format));
    meant.flat_map(|format| format.extensions.iter().copied()).collect()
}

fn unknown_extension(path: &Path, is_meant: impl Fn(&MeshFormat) -> bool) -> MeshFileError {
    let allowed = format!(".{}", extensions_of(is_meant).join(", ."));
    MeshFileError::UnknownExtension { path: path.to_owned(), found: lower_extension(path), allowed }
}

/// A mesh from the bytes of its files, in the order of the format's extensions; `source_name` names them in errors.
///
/// # Errors
/// [`MeshFileError`] as for [`read_mesh_with`].
pub fn mesh_from_bytes(
    format: &MeshFormat,
    files: &[&[u8]],
    policy: &ImportPolicy,
    source_name: &str,
) -> Result<(TetMesh, ImportReport), MeshFileError> {
    let raw = (format.read)(files, policy.unit);
    let mut raw =
        raw.map_err(|error| MeshFileError::Format { source_name: source_name.to_owned(), error })?;
    if raw.frame == Frame::Ras {
        // A half turn about z: the winding stays.
        for p in &mut raw.positions_m {
            *p = DVec3::new(-p.x, -p.y, p.z);
        }
    }
    let RawMesh { positions_m, tetrahedra, label_of, skipped, .. } = raw;
    let has_labels = label_of.len() == tetrahedra.len();
    let mut mesh = TetMesh { positions_m, tetrahedra, ..TetMesh::default() };
    let mut report = ImportReport::import(&mut mesh, policy, source_name)?;
    report.skipped_cells = skipped.into_iter().collect();
    report.label_of = if has_labels { label_of } else { Vec::new() };
    Ok((mesh, report))
}

/// The mesh in a file in millimetres, and what was found and done; the format is told by the extension.
///
/// # Errors
/// [`MeshFileError`] as for [`read_mesh_with`]; faults of the mesh are reported, not refused.
pub fn read_mesh(path: &Path) -> Result<(TetMesh, ImportReport), MeshFileError> {
    read_mesh_with(path, &ImportPolicy::default())
}

/// All files of the mesh that this one belongs to, as TetGen's are two: what [`read_mesh`] reads.
pub fn files_of_mesh(path: &Path) -> Vec<PathBuf> {
    match format_of_extension(&lower_extension(path)) {
        Some(format) if format.n_files > 1 => {
            format.extensions.iter().map(|e| path.with_extension(e)).collect()
        }
        _ => vec![path.to_owned()],
    }
}

/// [`read_mesh`] with a length unit and a way to treat faults.
///
/// # Errors
/// [`MeshFileError`]: an unknown extension, a file that cannot be opened, content that is not what the
/// format says, volume cells other than 4-node tetrahedra, no tetrahedron at all, and any fault of the mesh
/// if the policy refuses faults.
pub fn read_mesh_with(path: &Path, policy: &ImportPolicy) -> Result<(TetMesh, ImportReport), MeshFileError> {
    let load =
        |path: &Path| fs::read(path).map_err(|source| MeshFileError::Io { path: path.to_owned(), source });
    let format =
        format_of_extension(&lower_extension(path)).ok_or_else(|| unknown_extension(path, |_| true))?;
    if format.n_files == 1 {
        return mesh_from_bytes(format, &[&load(path)?], policy, &path.display().to_string());
    }
    let files: Vec<Vec<u8>> = files_of_mesh(path).iter().map(|path| load(path)).collect::<Result<_, _>>()?;
    let files: Vec<&[u8]> = files.iter().map(Vec::as_slice).collect();
    let all = format!("{{{}}}", format.extensions.join(","));
    mesh_from_bytes(format, &files, policy, &path.with_extension(all).display().to_string())
}

fn lower_extension(path: &Path) -> String {
    path.extension().map_or_else(String::new, |e| e.to_string_lossy().to_ascii_lowercase())
}

/// Gmsh's file versions that can be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GmshVersion {
    /// 2.2: what most programs read.
    V2_2,
    /// 4.1: Gmsh's own since 2019.
    V4_1,
}

/// Writes `mesh` in millimetres; the extension tells the format: `.vtk`, `.vtu`, or `.msh` (Gmsh 2.2).
/// The mesh must be compact: every tetrahedron is written.
///
/// # Errors
/// [`MeshFileError`]: another extension, or the file cannot be written; then the old one is untouched.
pub fn write_mesh(path: &Path, mesh: &TetMesh) -> Result<(), MeshFileError> {
    let write = format_of_extension(&lower_extension(path)).and_then(|format| format.write);
    let write = write.ok_or_else(|| unknown_extension(path, MeshFormat::is_written))?;
    written(path, write_atomically(path, |out| write(mesh, out)))
}

/// Writes `mesh` as a VTK XML file with values on its nodes and tetrahedra.
///
/// # Errors
/// [`MeshFileError`] if a field does not have one value a node or tetrahedron, or the file cannot be
/// written; then the old one is untouched.
pub fn write_vtu_with(path: &Path, mesh: &TetMesh, fields: &[VtuField<'_>]) -> Result<(), MeshFileError> {
    vtu_write::check_fields(mesh, fields)?;
    written(path, write_atomically(path, |out| vtu_write::write(mesh, fields, out)))
}

/// Writes `mesh` as an ASCII Gmsh file.
///
/// # Errors
/// [`MeshFileError`] if the file cannot be written; then the old one is untouched.
pub fn write_gmsh(path: &Path, mesh: &TetMesh, version: GmshVersion) -> Result<(), MeshFileError> {
    written(path, write_atomically(path, |out| gmsh::write(mesh, version, out)))
}

fn written(path: &Path, result: io::Result<()>) -> Result<(), MeshFileError> {
    result.map_err(|source| MeshFileError::Io { path: path.to_owned(), source })
}
