//! Surface files: STL, OBJ, PLY and VTK legacy polydata, ASCII and binary.
//!
//! Files hold millimetres. The frame is LPS, or RAS where a header comment says `SPACE=RAS` (the convention
//! of 3D Slicer since 4.11); we write `SPACE=LPS`. Inside are metres, LPS. Polygons with more than three
//! corners become fans from their first corner. STL repeats each vertex in each triangle: vertices with
//! exactly the same coordinates become one, and nothing else does (tolerance zero).
//!
//! The readers are our own: the formats are small, and errors have to name their place. `tobj`'s errors carry
//! no line, `stl_io` drops the header with the frame and reduces ASCII numbers to `f32`, and PLY and VTK share
//! one reader of counts, which are checked against the bytes really there before anything is allocated.

mod cursor;
mod obj;
mod ply;
mod stl;
mod vtk;

use std::fmt;
use std::fs::File;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};

use super::TriMesh;
use super::check::{SurfaceTopology, check_closed, orient_outward};
use super::error::SurfaceError;
use crate::files::write_atomically;
use crate::math::{Aabb, DVec3};

use self::cursor::Cursor;

/// How a surface is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SurfaceFormat {
    /// STL, text.
    StlAscii,
    /// STL, binary: coordinates lose half their digits (`f32`).
    StlBinary,
    /// Wavefront OBJ.
    Obj,
    /// PLY, text.
    PlyAscii,
    /// PLY, binary, little-endian.
    PlyLittleEndian,
    /// PLY, binary, big-endian.
    PlyBigEndian,
    /// VTK legacy polydata, text.
    VtkAscii,
    /// VTK legacy polydata, binary.
    VtkBinary,
}

/// The families of formats, told by extension.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// `.stl`.
    Stl,
    /// `.obj`.
    Obj,
    /// `.ply`.
    Ply,
    /// `.vtk`.
    Vtk,
}

/// A way to write surfaces, and how its files are read.
struct FormatRow {
    format: SurfaceFormat,
    kind: FileKind,
    extension: &'static str,
    parse: fn(Cursor<'_>) -> Result<RawSurface, SurfaceFileError>,
    write: fn(&mut BufWriter<File>, &Written<'_>) -> io::Result<()>,
}

/// Every format. Of those of one extension the first is what [`write_surface`] writes: the compact one.
const FORMATS: &[FormatRow] = &[
    FormatRow {
        format: SurfaceFormat::StlBinary,
        kind: FileKind::Stl,
        extension: "stl",
        parse: |cursor| stl::parse(cursor),
        write: |out, surface| stl::write_binary(out, surface),
    },
    FormatRow {
        format: SurfaceFormat::StlAscii,
        kind: FileKind::Stl,
        extension: "stl",
        parse: |cursor| stl::parse(cursor),
        write: |out, surface| stl::write_ascii(out, surface),
    },
    FormatRow {
        format: SurfaceFormat::Obj,
        kind: FileKind::Obj,
        extension: "obj",
        parse: |cursor| obj::parse(cursor),
        write: |out, surface| obj::write(out, surface),
    },
    FormatRow {
        format: SurfaceFormat::PlyLittleEndian,
        kind: FileKind::Ply,
        extension: "ply",
        parse: |cursor| ply::parse(cursor),
        write: |out, surface| ply::write(out, surface, ply::Encoding::LittleEndian),
    },
    FormatRow {
        format: SurfaceFormat::PlyBigEndian,
        kind: FileKind::Ply,
        extension: "ply",
        parse: |cursor| ply::parse(cursor),
        write: |out, surface| ply::write(out, surface, ply::Encoding::BigEndian),
    },
    FormatRow {
        format: SurfaceFormat::PlyAscii,
        kind: FileKind::Ply,
        extension: "ply",
        parse: |cursor| ply::parse(cursor),
        write: |out, surface| ply::write(out, surface, ply::Encoding::Ascii),
    },
    FormatRow {
        format: SurfaceFormat::VtkBinary,
        kind: FileKind::Vtk,
        extension: "vtk",
        parse: |cursor| vtk::parse(cursor),
        write: |out, surface| vtk::write(out, surface, true),
    },
    FormatRow {
        format: SurfaceFormat::VtkAscii,
        kind: FileKind::Vtk,
        extension: "vtk",
        parse: |cursor| vtk::parse(cursor),
        write: |out, surface| vtk::write(out, surface, false),
    },
];

/// The extensions of surface files, without their dots, in the order of the table.
pub fn surface_extensions() -> Vec<&'static str> {
    let mut extensions: Vec<&'static str> = FORMATS.iter().map(|row| row.extension).collect();
    extensions.dedup();
    extensions
}

/// The first row of the extension of a path, in upper or lower case.
fn row_of_path(path: &Path) -> Result<&'static FormatRow, SurfaceFileError> {
    let found = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    FORMATS
        .iter()
        .find(|row| row.extension == found)
        .ok_or_else(|| SurfaceFileError::UnknownExtension { path: path.to_owned(), found })
}

impl FileKind {
    /// The kind that a path's extension names, in upper or lower case.
    ///
    /// # Errors
    /// [`SurfaceFileError::UnknownExtension`].
    pub fn of_path(path: &Path) -> Result<Self, SurfaceFileError> {
        Ok(row_of_path(path)?.kind)
    }
}

/// The frame of a file's coordinates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Space {
    /// +x left, +y posterior, +z superior.
    #[default]
    Lps,
    /// +x right, +y anterior, +z superior.
    Ras,
}

impl Space {
    fn name(self) -> &'static str {
        match self {
            Self::Lps => "LPS",
            Self::Ras => "RAS",
        }
    }

    /// From this frame to LPS, or back: half a turn about z.
    fn turned(self, p: DVec3) -> DVec3 {
        match self {
            Self::Lps => p,
            Self::Ras => DVec3::new(-p.x, -p.y, p.z),
        }
    }
}

/// Where in a file something is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FilePlace {
    /// Line, from 1.
    Line(usize),
    /// Byte, from 0.
    Byte(usize),
}

impl fmt::Display for FilePlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Line(line) => write!(f, "line {line}"),
            Self::Byte(byte) => write!(f, "byte {byte}"),
        }
    }
}

/// Why a surface file could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum SurfaceFileError {
    /// The file system refused to give the file.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// Which file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The file system refused to take the file.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// Which file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A file name that says nothing about the format.
    #[error("{}: extension '{found}' is no surface format; allowed: .{}", path.display(), surface_extensions().join(", ."))]
    UnknownExtension {
        /// Which file.
        path: PathBuf,
        /// Its extension.
        found: String,
    },
    /// Something else than the format asks for.
    #[error("{}, {place}: expected {expected}, found {found}", path.display())]
    Syntax {
        /// Which file.
        path: PathBuf,
        /// Where.
        place: FilePlace,
        /// What may be there.
        expected: String,
        /// What is there.
        found: String,
    },
    /// A count in the file asks for more than the file holds.
    #[error("{}, {place}: {what} need at least {needed} bytes, {found} are left: the file is cut off or the count is wrong", path.display())]
    Truncated {
        /// Which file.
        path: PathBuf,
        /// Where.
        place: FilePlace,
        /// What is being read.
        what: String,
        /// Bytes needed.
        needed: u128,
        /// Bytes left.
        found: usize,
    },
    /// The file is well-formed, its surface is not.
    #[error("{}: {source}", path.display())]
    Surface {
        /// Which file.
        path: PathBuf,
        /// What is wrong with it.
        source: SurfaceError,
    },
}

/// The triangles of a file [m, LPS], by its extension, as they are: nothing is checked beyond the format and
/// the indices.
///
/// # Errors
/// [`SurfaceFileError`].
pub fn read_surface(path: &Path) -> Result<TriMesh, SurfaceFileError> {
    let kind = FileKind::of_path(path)?;
    let bytes =
        std::fs::read(path).map_err(|source| SurfaceFileError::Read { path: path.to_owned(), source })?;
    parse_surface(path, &bytes, kind)
}

/// The triangles [m, LPS] in a file's bytes; `path` is only named in errors.
///
/// # Errors
/// [`SurfaceFileError`].
pub fn parse_surface(path: &Path, bytes: &[u8], kind: FileKind) -> Result<TriMesh, SurfaceFileError> {
    let cursor = Cursor::new(path, bytes);
    let row = FORMATS.iter().find(|row| row.kind == kind).expect("every kind has a row");
    let raw = (row.parse)(cursor)?;
    if raw.triangles.is_empty() {
        let path = path.to_owned();
        return Err(SurfaceFileError::Surface { path, source: SurfaceError::Empty });
    }
    let positions_m = raw.positions_mm.iter().map(|&p| 1e-3 * raw.space.turned(p)).collect();
    Ok(TriMesh { positions_m, triangles: raw.triangles })
}

/// A closed surface that came from a file.
#[derive(Clone, Debug, PartialEq)]
pub struct ImportedSurface {
    /// Closed and outward oriented.
    pub mesh: TriMesh,
    /// Its counts and measures.
    pub topology: SurfaceTopology,
    /// What was changed on the way in, and what looks suspicious.
    pub notes: Vec<String>,
}

/// Smallest sensible extent of an organ [m]; below, the file is probably not in millimetres.
const SMALLEST_EXTENT_M: f64 = 2e-3;
/// Largest sensible extent [m].
const LARGEST_EXTENT_M: f64 = 2.0;

/// Reads a closed surface: turns over pieces that are inside out, drops vertices without triangles, says so in
/// the notes, and checks the rest with [`check_closed`].
///
/// # Errors
/// [`SurfaceFileError`].
pub fn import_closed_surface(path: &Path) -> Result<ImportedSurface, SurfaceFileError> {
    let mut mesh = read_surface(path)?;
    let surface = |source| SurfaceFileError::Surface { path: path.to_owned(), source };
    let mut notes = Vec::new();
    let turned = orient_outward(&mut mesh).map_err(surface)?;
    if turned > 0 {
        notes.push(format!("{turned} closed piece(s) were inside out; their triangles were turned over"));
    }
    let dropped = drop_unused_vertices(&mut mesh);
    if dropped > 0 {
        notes.push(format!("{dropped} vertices without triangles were dropped"));
    }
    let extent_m = Aabb::of_points(&mesh.positions_m).size_m().max_element();
    if !(SMALLEST_EXTENT_M..=LARGEST_EXTENT_M).contains(&extent_m) {
        notes.push(format!("the surface is {} mm long; files must be in millimetres", 1e3 * extent_m));
    }
    let topology = check_closed(&mesh).map_err(surface)?;
    Ok(ImportedSurface { mesh, topology, notes })
}

fn drop_unused_vertices(mesh: &mut TriMesh) -> usize {
    let mut number = vec![u32::MAX; mesh.positions_m.len()];
    for &v in mesh.triangles.iter().flatten() {
        number[v as usize] = 0;
    }
    let mut kept = Vec::new();
    for (number, &position) in number.iter_mut().zip(&mesh.positions_m) {
        if *number == 0 {
            *number = kept.len() as u32;
            kept.push(position);
        }
    }
    for triangle in &mut mesh.triangles {
        *triangle = triangle.map(|v| number[v as usize]);
    }
    let dropped = mesh.positions_m.len() - kept.len();
    mesh.positions_m = kept;
    dropped
}

/// Writes `mesh` in millimetres, LPS, in the format of the path's extension (binary where there is a choice).
///
/// # Errors
/// [`SurfaceFileError`]; then no file is left.
pub fn write_surface(path: &Path, mesh: &TriMesh) -> Result<(), SurfaceFileError> {
    write_surface_as(path, mesh, row_of_path(path)?.format, Space::Lps)
}

/// Writes `mesh` in millimetres in the given format and frame, whatever the path's extension is.
///
/// # Errors
/// [`SurfaceFileError`]; then no file is left.
pub fn write_surface_as(
    path: &Path,
    mesh: &TriMesh,
    format: SurfaceFormat,
    space: Space,
) -> Result<(), SurfaceFileError> {
    let written = Written {
        positions_mm: mesh.positions_m.iter().map(|&p| space.turned(1e3 * p)).collect(),
        triangles: &mesh.triangles,
        space,
    };
    let vertex_out_of_range = || {
        let n_vertices = mesh.positions_m.len();
        let triangles = mesh.triangles.iter().enumerate();
        let mut all = triangles.flat_map(|(t, corners)| corners.iter().map(move |&v| (t, v)));
        let (triangle, vertex) = all.find(|&(_, v)| v as usize >= n_vertices)?;
        Some(SurfaceError::NoSuchVertex { triangle, vertex, n_vertices })
    };
    if let Some(source) = vertex_out_of_range() {
        return Err(SurfaceFileError::Surface { path: path.to_owned(), source });
    }
    let row = FORMATS.iter().find(|row| row.format == format).expect("every format has a row");
    let result = write_atomically(path, |out| (row.write)(out, &written));
    result.map_err(|source| SurfaceFileError::Write { path: path.to_owned(), source })
}

/// What the writers see.
struct Written<'a> {
    positions_mm: Vec<DVec3>,
    triangles: &'a [[u32; 3]],
    space: Space,
}

/// What the readers give.
#[derive(Default)]
struct RawSurface {
    positions_mm: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    space: Space,
}

impl RawSurface {
    /// Adds a polygon as a fan, its corners being numbers of `n_vertices` vertices from 0.
    fn add_polygon(
        &mut self,
        cursor: &Cursor<'_>,
        corners: &[i64],
        n_vertices: usize,
    ) -> Result<(), SurfaceFileError> {
        if corners.len() < 3 {
            return Err(cursor.error("a polygon of at least 3 corners", format!("{} corners", corners.len())));
        }
        let n_vertices = n_vertices.min(u32::MAX as usize);
        if let Some(wrong) = corners.iter().find(|&&c| usize::try_from(c).map_or(true, |c| c >= n_vertices)) {
            let expected = format!("vertex numbers below {n_vertices}, counted from 0");
            return Err(cursor.error(expected, wrong.to_string()));
        }
        for pair in corners[1..].windows(2) {
            self.triangles.push([corners[0], pair[0], pair[1]].map(|c| c as u32));
        }
        Ok(())
    }
}
