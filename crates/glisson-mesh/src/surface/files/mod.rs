//! Surface files.
//!
//! | format | extension | read | written |
//! |---|---|---|---|
//! | STL | `.stl` | ASCII and binary | binary (and ASCII) |
//! | Wavefront OBJ | `.obj` | polygons | triangles |
//! | PLY | `.ply` | ASCII and binary of either byte order | binary, little-endian (and the others) |
//! | VTK legacy polydata | `.vtk` | ASCII and binary, 1 to 5.1 | binary (and ASCII) |
//! | VTK XML polydata | `.vtp` | ASCII, base64, appended raw or base64, zlib | base64 + zlib (and ASCII) |
//! | glTF 2.0 | `.glb`, `.gltf` | triangles of the scene, buffers inside the file | one mesh, positions of 32 bits |
//!
//! glTF is in metres by its standard, with +Y up and +Z forward: a point (x, y, z) in LPS is (x, z, -y) there, so that
//! up is superior and forward anterior. Its node transforms are applied, `asset.extras.frame` says `LPS` or `RAS`, and
//! positions are rounded to 32 bits. The others do not say their unit: it is asked for ([`read_surface_with`]),
//! millimetres unless told otherwise, and millimetres are written. The frame is LPS, or RAS where a header comment says
//! `SPACE=RAS` (the convention of 3D Slicer since 4.11); we write `SPACE=LPS`.
//!
//! Inside are metres, LPS. Polygons with more than three corners become fans from their first corner. STL repeats each
//! vertex in each triangle, glTF each one whose normal or texture differs between triangles: of these, vertices with
//! exactly the same coordinates become one, and nothing else does (tolerance zero).
//!
//! The readers are our own: the formats are small, and errors have to name their place. `tobj`'s errors carry
//! no line, `stl_io` drops the header with the frame and reduces ASCII numbers to `f32`, and PLY and VTK share
//! one reader of counts, which are checked against the bytes really there before anything is allocated.

mod cursor;
mod gltf;
mod gltf_write;
mod obj;
mod ply;
mod stl;
mod vtk;
mod vtp;
mod weld;

use std::fmt;
use std::fs::File;
use std::io::{self, BufWriter};
use std::ops::Range;
use std::path::{Path, PathBuf};

use super::TriMesh;
use super::check::{SurfaceTopology, check_closed, orient_outward};
use super::error::SurfaceError;
use crate::files::write_atomically;
use crate::math::{Aabb, DVec3};
use crate::units::{LengthUnit, likely_unit};

pub use crate::scan::{FormatError, Place};

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
    /// VTK XML polydata, text.
    VtpAscii,
    /// VTK XML polydata, compressed.
    VtpCompressed,
    /// glTF 2.0 in one binary file: coordinates lose half their digits (`f32`).
    GltfBinary,
    /// glTF 2.0 as JSON with its data inside: coordinates lose half their digits (`f32`).
    GltfJson,
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
    /// `.vtp`.
    Vtp,
    /// `.glb` and `.gltf`.
    Gltf,
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
    FormatRow {
        format: SurfaceFormat::VtpCompressed,
        kind: FileKind::Vtp,
        extension: "vtp",
        parse: |cursor| vtp::parse(&cursor),
        write: |out, surface| vtp::write(out, surface, false),
    },
    FormatRow {
        format: SurfaceFormat::VtpAscii,
        kind: FileKind::Vtp,
        extension: "vtp",
        parse: |cursor| vtp::parse(&cursor),
        write: |out, surface| vtp::write(out, surface, true),
    },
    FormatRow {
        format: SurfaceFormat::GltfBinary,
        kind: FileKind::Gltf,
        extension: "glb",
        parse: |cursor| gltf::parse(&cursor),
        write: |out, surface| gltf_write::write_binary(out, surface),
    },
    FormatRow {
        format: SurfaceFormat::GltfJson,
        kind: FileKind::Gltf,
        extension: "gltf",
        parse: |cursor| gltf::parse(&cursor),
        write: |out, surface| gltf_write::write_json(out, surface),
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
    /// Something in the file, which has a name, is not what the format asks for.
    #[error("{}, {error}", path.display())]
    Content {
        /// Which file.
        path: PathBuf,
        /// What is wrong, and where.
        error: FormatError,
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

/// The triangles of a file [m, LPS], in millimetres if its format names no unit; the rest as for [`read_surface_with`].
///
/// # Errors
/// [`SurfaceFileError`].
pub fn read_surface(path: &Path) -> Result<TriMesh, SurfaceFileError> {
    read_surface_with(path, LengthUnit::default())
}

/// The triangles of a file [m, LPS], by its extension, as they are: nothing is checked beyond the format and the
/// indices. The numbers of formats that name no unit are in `unit`; glTF is in metres whatever it is.
///
/// # Errors
/// [`SurfaceFileError`].
pub fn read_surface_with(path: &Path, unit: LengthUnit) -> Result<TriMesh, SurfaceFileError> {
    Ok(read_in_unit(path, unit)?.0)
}

/// [`parse_surface_with`] for millimetres.
///
/// # Errors
/// [`SurfaceFileError`].
pub fn parse_surface(path: &Path, bytes: &[u8], kind: FileKind) -> Result<TriMesh, SurfaceFileError> {
    parse_surface_with(path, bytes, kind, LengthUnit::default())
}

/// The triangles [m, LPS] in a file's bytes, as [`read_surface_with`] reads them; `path` is only named in errors.
///
/// # Errors
/// [`SurfaceFileError`].
pub fn parse_surface_with(
    path: &Path,
    bytes: &[u8],
    kind: FileKind,
    unit: LengthUnit,
) -> Result<TriMesh, SurfaceFileError> {
    Ok(parse_in_unit(path, bytes, kind, unit)?.0)
}

/// The triangles of a file, and the unit that its numbers are in.
fn read_in_unit(path: &Path, unit: LengthUnit) -> Result<(TriMesh, LengthUnit), SurfaceFileError> {
    let kind = FileKind::of_path(path)?;
    let bytes =
        std::fs::read(path).map_err(|source| SurfaceFileError::Read { path: path.to_owned(), source })?;
    parse_in_unit(path, &bytes, kind, unit)
}

fn parse_in_unit(
    path: &Path,
    bytes: &[u8],
    kind: FileKind,
    unit: LengthUnit,
) -> Result<(TriMesh, LengthUnit), SurfaceFileError> {
    let cursor = Cursor::new(path, bytes);
    let row = FORMATS.iter().find(|row| row.kind == kind).expect("every kind has a row");
    let raw = (row.parse)(cursor)?;
    if raw.triangles.is_empty() {
        let path = path.to_owned();
        return Err(SurfaceFileError::Surface { path, source: SurfaceError::Empty });
    }
    let unit = raw.unit.unwrap_or(unit);
    let positions_m = raw.positions.iter().map(|&p| unit.size_m() * raw.space.turned(p)).collect();
    Ok((TriMesh { positions_m, triangles: raw.triangles }, unit))
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

/// Smallest sensible extent of an organ [m]; below, the file is probably in another unit.
const SMALLEST_EXTENT_M: f64 = 2e-3;
/// Largest sensible extent [m].
const LARGEST_EXTENT_M: f64 = 2.0;

/// [`import_closed_surface_with`] for millimetres.
///
/// # Errors
/// [`SurfaceFileError`].
pub fn import_closed_surface(path: &Path) -> Result<ImportedSurface, SurfaceFileError> {
    import_closed_surface_with(path, LengthUnit::default())
}

/// Reads a closed surface ([`read_surface_with`]): turns over pieces that are inside out, drops vertices without
/// triangles, says so in the notes, and checks the rest with [`check_closed`].
///
/// # Errors
/// [`SurfaceFileError`].
pub fn import_closed_surface_with(
    path: &Path,
    unit: LengthUnit,
) -> Result<ImportedSurface, SurfaceFileError> {
    let (mut mesh, unit) = read_in_unit(path, unit)?;
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
    let topology = check_closed(&mesh).map_err(surface)?;
    let extent_m = Aabb::of_points(&mesh.positions_m).size_m().max_element();
    if !(SMALLEST_EXTENT_M..=LARGEST_EXTENT_M).contains(&extent_m) {
        notes.push(note_on_size(extent_m, topology.volume_m3, unit));
    }
    Ok(ImportedSurface { mesh, topology, notes })
}

/// What to say of a surface that is so long and holds so much, and was read in `unit`.
fn note_on_size(extent_m: f64, volume_m3: f64, unit: LengthUnit) -> String {
    let likely =
        likely_unit(volume_m3, unit).map_or_else(String::new, |likely| format!(", probably {likely}"));
    format!(
        "the surface is {} mm long, read in {unit}: the file may be in another unit{likely}",
        1e3 * extent_m
    )
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

/// Writes `mesh` in millimetres (glTF: metres), LPS, in the format of the path's extension (binary where there is a choice).
///
/// # Errors
/// [`SurfaceFileError`]; then no file is left.
pub fn write_surface(path: &Path, mesh: &TriMesh) -> Result<(), SurfaceFileError> {
    write_surface_as(path, mesh, row_of_path(path)?.format, Space::Lps)
}

/// Writes `mesh` in millimetres (glTF: metres) in the given format and frame, whatever the path's extension is.
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
        positions_m: &mesh.positions_m,
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
    /// LPS.
    positions_m: &'a [DVec3],
    /// In `space`.
    positions_mm: Vec<DVec3>,
    triangles: &'a [[u32; 3]],
    space: Space,
}

/// What the readers give.
#[derive(Default)]
struct RawSurface {
    /// Vertices, in the file's unit and `space`.
    positions: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    space: Space,
    /// The unit, if the format says it.
    unit: Option<LengthUnit>,
}

/// Why a polygon cannot be added.
struct WrongPolygon {
    found: String,
    expected: String,
}

impl RawSurface {
    /// Adds a polygon as a fan, its corners being numbers, from 0, of the vertices of a range.
    fn add_fan(&mut self, corners: &[i64], vertices: Range<usize>) -> Result<(), WrongPolygon> {
        if corners.len() < 3 {
            let found = format!("{} corners", corners.len());
            return Err(WrongPolygon { found, expected: "a polygon of at least 3 corners".into() });
        }
        let n_vertices = vertices.end.min(u32::MAX as usize).saturating_sub(vertices.start);
        if let Some(wrong) = corners.iter().find(|&&c| usize::try_from(c).map_or(true, |c| c >= n_vertices)) {
            let expected = format!("vertex numbers below {n_vertices}, counted from 0");
            return Err(WrongPolygon { found: wrong.to_string(), expected });
        }
        for pair in corners[1..].windows(2) {
            self.triangles.push([corners[0], pair[0], pair[1]].map(|c| (vertices.start + c as usize) as u32));
        }
        Ok(())
    }

    /// Adds a polygon as a fan, its corners being numbers of `n_vertices` vertices from 0.
    fn add_polygon(
        &mut self,
        cursor: &Cursor<'_>,
        corners: &[i64],
        n_vertices: usize,
    ) -> Result<(), SurfaceFileError> {
        self.add_fan(corners, 0..n_vertices).map_err(|wrong| cursor.error(wrong.expected, wrong.found))
    }
}
