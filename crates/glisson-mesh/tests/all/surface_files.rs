//! Surface files: round trips, frames, exact error places, bytes cut off and changed.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use glisson_mesh::math::DVec3;
use glisson_mesh::surface::TriMesh;
use glisson_mesh::surface::error::SurfaceError;
use glisson_mesh::surface::files::{
    FileKind, FilePlace, Space, SurfaceFileError, SurfaceFormat, import_closed_surface,
    import_closed_surface_with, parse_surface, parse_surface_with, read_surface, read_surface_with,
    write_surface, write_surface_as,
};
use glisson_mesh::units::{LengthUnit, likely_unit};
use proptest::prelude::*;

use crate::mesh_file_samples::{VTU_STYLES, VtuStyle, vtk_xml};
use crate::surfaces::{cube, torus};

pub(crate) const FORMATS: [(SurfaceFormat, FileKind, &str); 12] = [
    (SurfaceFormat::StlAscii, FileKind::Stl, "stl"),
    (SurfaceFormat::StlBinary, FileKind::Stl, "stl"),
    (SurfaceFormat::Obj, FileKind::Obj, "obj"),
    (SurfaceFormat::PlyAscii, FileKind::Ply, "ply"),
    (SurfaceFormat::PlyLittleEndian, FileKind::Ply, "ply"),
    (SurfaceFormat::PlyBigEndian, FileKind::Ply, "ply"),
    (SurfaceFormat::VtkAscii, FileKind::Vtk, "vtk"),
    (SurfaceFormat::VtkBinary, FileKind::Vtk, "vtk"),
    (SurfaceFormat::VtpAscii, FileKind::Vtp, "vtp"),
    (SurfaceFormat::VtpCompressed, FileKind::Vtp, "vtp"),
    (SurfaceFormat::GltfBinary, FileKind::Gltf, "glb"),
    (SurfaceFormat::GltfJson, FileKind::Gltf, "gltf"),
];

fn parse(kind: FileKind, bytes: impl AsRef<[u8]>) -> Result<TriMesh, SurfaceFileError> {
    parse_surface(Path::new("test"), bytes.as_ref(), kind)
}

fn written(folder: &Path, mesh: &TriMesh, n: usize, space: Space) -> (PathBuf, Vec<u8>) {
    let (format, _, extension) = FORMATS[n];
    let path = folder.join(format!("{n}-{space:?}.{extension}"));
    write_surface_as(&path, mesh, format, space).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    (path, bytes)
}

/// The triangles as corner positions: STL renumbers vertices.
fn corners(mesh: &TriMesh) -> Vec<[DVec3; 3]> {
    (0..mesh.triangles.len()).map(|t| mesh.corners_m(t)).collect()
}

#[test]
fn every_format_gives_back_what_was_written() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = torus(0.03, 0.01, 17, 9);
    for n in 0..FORMATS.len() {
        for space in [Space::Lps, Space::Ras] {
            let (path, bytes) = written(folder.path(), &mesh, n, space);
            let text = String::from_utf8_lossy(&bytes)
                .replace("\"frame\": \"", "SPACE=")
                .replace("\"frame\":\"", "SPACE=");
            assert!(text.contains(&format!("SPACE={space:?}").to_uppercase()), "{path:?}");
            let read = read_surface(&path).unwrap();
            assert_eq!(read.positions_m.len(), mesh.positions_m.len(), "{path:?}");
            let is_single = FORMATS[n].0 == SurfaceFormat::StlBinary || FORMATS[n].1 == FileKind::Gltf;
            let tolerance_m = if is_single { 4e-9 } else { 1e-17 };
            for (a, b) in corners(&read).iter().flatten().zip(corners(&mesh).iter().flatten()) {
                assert!((*a - *b).length() <= tolerance_m, "{path:?}: {a} {b}");
            }
            if FORMATS[n].1 != FileKind::Stl {
                assert_eq!(read.triangles, mesh.triangles);
            }
            let imported = import_closed_surface(&path).unwrap();
            assert_eq!(imported.topology.euler_characteristic, 0);
            assert_eq!(imported.notes, Vec::<String>::new());
        }
    }
    let path = folder.path().join("by-extension.PLY");
    write_surface(&path, &mesh).unwrap();
    assert_eq!(read_surface(&path).unwrap().triangles, mesh.triangles);
}

#[test]
fn writing_refuses_wrong_names_and_indices_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("surface.xyz");
    let unknown = write_surface(&path, &cube());
    assert!(matches!(unknown, Err(SurfaceFileError::UnknownExtension { ref found, .. }) if found == "xyz"));
    let mut mesh = cube();
    mesh.triangles[2][1] = 99;
    let wrong = write_surface(&folder.path().join("surface.stl"), &mesh).unwrap_err();
    let expected = SurfaceError::NoSuchVertex { triangle: 2, vertex: 99, n_vertices: 8 };
    assert!(matches!(wrong, SurfaceFileError::Surface { ref source, .. } if *source == expected), "{wrong}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    let missing = read_surface(&path.with_extension("stl"));
    assert!(matches!(missing, Err(SurfaceFileError::Read { .. })));
}

#[test]
fn import_turns_and_cleans_and_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("inside-out.obj");
    let mut mesh = cube();
    for triangle in &mut mesh.triangles {
        triangle.swap(0, 1);
    }
    mesh.positions_m.insert(0, DVec3::ZERO);
    mesh.triangles.iter_mut().flatten().for_each(|v| *v += 1);
    for p in &mut mesh.positions_m {
        *p *= 0.1;
    }
    write_surface(&path, &mesh).unwrap();
    let imported = import_closed_surface(&path).unwrap();
    assert!(imported.topology.volume_m3 > 0.0);
    assert_eq!(imported.mesh.positions_m.len(), 8);
    let notes = imported.notes.join("; ");
    assert!(notes.contains("inside out") && notes.contains("1 vertices"));
    let size = "mm long, read in mm: the file may be in another unit, probably m";
    assert!(notes.contains(size), "{notes}");
    mesh.triangles.pop();
    write_surface(&path, &mesh).unwrap();
    let open = import_closed_surface(&path).unwrap_err().to_string();
    assert!(open.contains("inside-out.obj") && open.contains("not closed"), "{open}");
}

const TETRAHEDRON: &str = "# SPACE=RAS\nv 0 0 0\nv 1 0 0 # right\nv 0 1 0 1.0\nvn 0 0 1\nv 0 0 1\n\
    f 1//1 3//1 2//1\nf 1/1 2/2 4/3\nf -3 -2 -1\nf 1 4 3\n";

#[test]
fn obj_numbers_may_be_negative_and_frames_are_honoured() {
    let mesh = parse(FileKind::Obj, TETRAHEDRON).unwrap();
    assert_eq!(mesh.triangles, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]);
    assert_eq!(mesh.positions_m[1], DVec3::new(-1e-3, 0.0, 0.0));
    assert_eq!(mesh.positions_m[3], DVec3::new(0.0, 0.0, 1e-3));
    assert!(mesh.volume_m3() > 0.0);
    let lps = parse(FileKind::Obj, TETRAHEDRON.replace("SPACE=RAS", "no frame")).unwrap();
    assert_eq!(lps.positions_m[1], DVec3::new(1e-3, 0.0, 0.0));
}

/// What `bytes` are refused for: the place, and words of the message.
#[track_caller]
fn assert_refused(kind: FileKind, bytes: impl AsRef<[u8]>, place: FilePlace, words: &[&str]) {
    let error = parse(kind, bytes).unwrap_err();
    let message = error.to_string();
    let found = match error {
        SurfaceFileError::Syntax { place, .. } | SurfaceFileError::Truncated { place, .. } => place,
        _ => panic!("{message}"),
    };
    assert_eq!(found, place, "{message}");
    for word in words {
        assert!(message.contains(word), "no '{word}' in: {message}");
    }
}

#[test]
fn errors_name_their_line() {
    let obj = |bad: &str| format!("{TETRAHEDRON}{bad}\n");
    let line = FilePlace::Line(11);
    assert_refused(FileKind::Obj, obj("f 1 2 5"), line, &["below 4", "found 4"]);
    assert_refused(FileKind::Obj, obj("f 1 2"), line, &["at least 3 corners", "2 corners"]);
    assert_refused(FileKind::Obj, obj("f 1 0 2"), line, &["from 1"]);
    assert_refused(FileKind::Obj, obj("v 1 2 x"), line, &["coordinate", "'x'"]);
    assert_refused(FileKind::Obj, obj("v 1 2 nan"), line, &["within 1e9", "NaN"]);
    assert_refused(FileKind::Obj, obj("bevel on"), line, &["OBJ statement", "'bevel'"]);
    assert_refused(FileKind::Obj, obj("# SPACE=XYZ"), line, &["SPACE=LPS or SPACE=RAS", "XYZ"]);

    let stl = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1\nendloop\n";
    assert_refused(FileKind::Stl, stl, FilePlace::Line(7), &["coordinate", "'endloop'"]);
    assert_refused(FileKind::Stl, "solid a\nfacet\n", FilePlace::Line(3), &["'normal'", "end of the file"]);

    let ply = |format: &str, rest: &str| format!("ply\nformat {format} 1.0\n{rest}");
    assert_refused(FileKind::Ply, "plt\n", FilePlace::Line(1), &["'ply'", "'plt'"]);
    assert_refused(FileKind::Ply, ply("utf8", ""), FilePlace::Line(2), &["binary_little_endian"]);
    assert_refused(FileKind::Ply, ply("ascii", "element vertex -3\n"), FilePlace::Line(3), &["'-3'"]);
    let header = "element vertex 9000000000\nproperty float x\nproperty float y\nproperty float z\n\
        element face 1\nproperty list uchar int vertex_index\nend_header\n";
    let huge = ply("binary_big_endian", header);
    assert_refused(
        FileKind::Ply,
        &huge,
        FilePlace::Line(9),
        &["9000000000", "108000000000 bytes", "0 are left"],
    );
    let small = huge.replace("9000000000", "1") + "0000000000000";
    assert_refused(FileKind::Ply, &small, FilePlace::Byte(small.len() - 1), &["48 list entries", "192"]);

    let vtk = |rest: &str| format!("# vtk DataFile Version 4.2\ntitle\nASCII\n{rest}");
    let grid = vtk("DATASET UNSTRUCTURED_GRID\n");
    assert_refused(FileKind::Vtk, grid, FilePlace::Line(4), &["POLYDATA", "'UNSTRUCTURED_GRID'"]);
    let points = "DATASET POLYDATA\nPOINTS 3 float\n0 0 0 1 0 0\n0 1 0\n";
    let outside = vtk(&format!("{points}POLYGONS 1 4\n3 0 1 3\n"));
    assert_refused(FileKind::Vtk, outside, FilePlace::Line(9), &["below 3", "found 3"]);
    let many = vtk("DATASET POLYDATA\nPOINTS 18446744073709551615 float\n0");
    assert_refused(FileKind::Vtk, many, FilePlace::Line(5), &["bytes", "cut off"]);
    let long = vtk(&format!("{points}POLYGONS 1 4\n4 0 1 2\n"));
    assert_refused(FileKind::Vtk, long, FilePlace::Line(9), &["1 cells in 4 integers"]);
}

#[test]
fn binary_stl_counts_are_checked_against_the_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let (_, mut bytes) = written(folder.path(), &cube(), 1, Space::Lps);
    bytes.pop();
    assert_refused(FileKind::Stl, &bytes, FilePlace::Byte(80), &["12 triangles", "600", "599"]);
    bytes.extend([0, 0, 0]);
    assert_refused(FileKind::Stl, &bytes, FilePlace::Byte(80), &["no bytes after 12 triangles", "2 more"]);
    assert_refused(FileKind::Stl, &bytes[..50], FilePlace::Byte(0), &["header"]);
    // A binary file whose header begins like text is told by its length.
    bytes.truncate(684);
    bytes[..5].copy_from_slice(b"solid");
    assert_eq!(parse(FileKind::Stl, &bytes).unwrap().triangles.len(), 12);
}

#[test]
fn vtk_layouts_strips_and_polygons_are_read() {
    let head = "# vtk DataFile Version 5.1\nvtk output SPACE=RAS\nASCII\nDATASET POLYDATA\n\
        FIELD FieldData 1\nTIME 1 1 double\n0.5\nPOINTS 4 float\n0 0 0 1 0 0 1 1 0 0 1 0\n\
        METADATA\nINFORMATION 0\n\n";
    let new = format!("{head}POLYGONS 2 4\nOFFSETS vtktypeint64\n0 4\nCONNECTIVITY vtktypeint64\n0 1 2 3\n");
    let old = format!("{head}VERTICES 1 2\n1 0\nPOLYGONS 1 5\n4 0 1 2 3\nPOINT_DATA 4\nanything\n");
    for text in [new, old] {
        let mesh = parse(FileKind::Vtk, text).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(mesh.positions_m[2], DVec3::new(-1e-3, -1e-3, 0.0));
    }
    let strip = format!("{head}TRIANGLE_STRIPS 1 5\n4 0 1 3 2\n");
    assert_eq!(parse(FileKind::Vtk, strip).unwrap().triangles, [[0, 1, 3], [3, 1, 2]]);
    let empty = parse(FileKind::Vtk, head);
    assert!(matches!(empty, Err(SurfaceFileError::Surface { source: SurfaceError::Empty, .. })));
}

#[test]
fn ply_skips_what_it_does_not_know() {
    let text = "ply\nformat ascii 1.0\nobj_info made by hand\ncomment SPACE=LPS\nelement vertex 3\n\
        property float x\nproperty uchar red\nproperty double y\nproperty float z\nelement empty 4000000000\n\
        element material 1\nproperty list uchar float factors\nelement face 1\nproperty int group\n\
        property list uchar uint vertex_index\nend_header\n0 255 0 0\n1 0 0 0\n0 9 1 0\n2 0.5 0.25\n7 3 0 1 2\n";
    let mesh = parse(FileKind::Ply, text).unwrap();
    assert_eq!(mesh.triangles, [[0, 1, 2]]);
    assert_eq!(mesh.positions_m[2], DVec3::new(0.0, 1e-3, 0.0));
}

#[test]
fn the_unit_is_asked_for_where_the_format_does_not_say_it() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = torus(0.03, 0.01, 17, 9);
    for n in 0..FORMATS.len() {
        let (path, bytes) = written(folder.path(), &mesh, n, Space::Lps);
        let in_mm = read_surface(&path).unwrap().volume_m3();
        assert!((in_mm / mesh.volume_m3() - 1.0).abs() < 1e-5);
        for unit in LengthUnit::ALL {
            let times = if FORMATS[n].1 == FileKind::Gltf { 1.0 } else { unit.size_m() / 1e-3 };
            let read = read_surface_with(&path, unit).unwrap();
            assert!((read.volume_m3() / in_mm / times.powi(3) - 1.0).abs() < 1e-12, "{path:?} {unit}");
            assert_eq!(read, parse_surface_with(&path, &bytes, FORMATS[n].1, unit).unwrap());
        }
    }
    let (path, _) = written(folder.path(), &mesh, 2, Space::Lps);
    let imported = import_closed_surface_with(&path, LengthUnit::Metre).unwrap();
    let notes = imported.notes.join("; ");
    assert!(notes.ends_with("mm long, read in m: the file may be in another unit, probably mm"), "{notes}");
    assert_eq!(likely_unit(imported.topology.volume_m3, LengthUnit::Metre), Some(LengthUnit::Millimetre));
}

/// A tetrahedron of 10 mm: two triangles as polygons, two as a strip, and a vertex without a triangle.
fn vtp(style: VtuStyle) -> Vec<u8> {
    const POINTS_MM: [[f64; 3]; 4] = [[0.0; 3], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 10.0]];
    vtk_xml(style, "PolyData", |arrays| {
        let alone = arrays.points(&[[1.0, 2.0, 3.0]]);
        let points = arrays.points(&POINTS_MM);
        let corners = arrays.integers("connectivity", &[0, 2, 1, 0, 1, 3]);
        let ends = arrays.integers("offsets", &[3, 6]);
        let strip = arrays.integers("connectivity", &[1, 2, 3, 0]);
        let strip_ends = arrays.integers("offsets", &[4]);
        format!(
            "<Piece NumberOfPoints=\"1\">\n<Points>{alone}</Points>\n</Piece>\n<Piece NumberOfPoints=\"0\"/>\n\
             <Piece NumberOfPoints=\"4\" NumberOfLines=\"0\" NumberOfPolys=\"2\" NumberOfStrips=\"1\">\n\
             <Points>{points}</Points>\n<Polys>{corners}{ends}</Polys>\n<Strips>{strip}{strip_ends}</Strips>\n</Piece>\n"
        )
    })
}

#[test]
fn vtp_of_every_encoding_gives_the_same_surface() {
    for style in VTU_STYLES {
        let mesh = parse(FileKind::Vtp, vtp(style)).unwrap_or_else(|error| panic!("{style:?}: {error}"));
        assert_eq!(mesh.triangles, [[1, 3, 2], [1, 2, 4], [2, 3, 4], [4, 3, 1]], "{style:?}");
        assert_eq!(mesh.positions_m[4], DVec3::new(0.0, 0.0, 0.01));
        assert!((mesh.volume_m3() - 1e-6 / 6.0).abs() < 1e-20);
    }
    let ras =
        String::from_utf8(vtp(VtuStyle::Ascii)).unwrap().replace("<VTKFile", "<!-- SPACE=RAS --><VTKFile");
    assert_eq!(parse(FileKind::Vtp, ras).unwrap().positions_m[2], DVec3::new(-0.01, 0.0, 0.0));
}

#[test]
fn vtp_mistakes_are_named() {
    let text = String::from_utf8(vtp(VtuStyle::Ascii)).unwrap();
    for (from, to, expected) in [
        (
            "PolyData",
            "ImageData",
            "test, the root element: found `VTKFile` of ImageData, expected `VTKFile` of type PolyData",
        ),
        ("0 2 1 0 1 3", "0 2 1 0 1 4", "piece 2, cell 1 of Polys: found 4, expected vertex numbers below 4"),
        ("0 2 1 0 1 3", "0 2 -1 0 1 3", "piece 2, cell 0 of Polys: found -1"),
        ("3 6", "2 6", "piece 2, cell 0 of Polys: found 2 corners, expected a polygon of at least 3 corners"),
        (
            "3 6",
            "3 7",
            "cell 1 of Polys: found corners 3 to 7 of the connectivity, expected an ascending range",
        ),
        ("3 6", "3", "piece 2: found 1 offsets in Polys, expected NumberOfPolys = 2"),
        ("1 2 3 0", "1 2 3 9", "piece 2, cell 0 of Strips: found 9"),
        (
            "NumberOfPoints=\"4\"",
            "NumberOfPoints=\"5\"",
            "piece 2: found 4 points, expected NumberOfPoints = 5",
        ),
        ("NumberOfPoints=\"4\"", "", "piece 2, attribute NumberOfPoints: found ``, expected a count"),
        (
            "10 0 0",
            "1e10 0 0",
            "piece 2, point 1: found [10000000000, 0, 0], expected coordinates within 1e9",
        ),
        ("10 0 0", "ten 0 0", "piece 2, Points, line 2 of the array: found `ten`"),
        ("Name=\"offsets\"", "Name=\"ends\"", "piece 2: found no array offsets in Polys"),
        ("</Piece>", "", "expected an XML document"),
        ("<PolyData>", "<!-- SPACE=XYZ --><PolyData>", "expected SPACE=LPS or SPACE=RAS, found 'SPACE=XYZ'"),
    ] {
        let changed = text.replace(from, to);
        assert_ne!(changed, text, "{from}");
        let message = parse(FileKind::Vtp, changed).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}\n  should contain: {expected}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    /// Readers answer anything with a surface or an error.
    #[test]
    fn changed_bytes_never_panic(
        format in 0..FORMATS.len() + VTU_STYLES.len(),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
        cut in prop::option::of(any::<prop::sample::Index>()),
        inserted in prop::option::of((any::<prop::sample::Index>(), "[0-9 \\-\n.ef]{1,12}")),
    ) {
        // Written once: each writing waits for the disk.
        static WRITTEN: OnceLock<Vec<Vec<u8>>> = OnceLock::new();
        let all = WRITTEN.get_or_init(|| {
            let folder = tempfile::tempdir().unwrap();
            let ours = (0..FORMATS.len()).map(|n| written(folder.path(), &cube(), n, Space::Lps).1);
            ours.chain(VTU_STYLES.map(vtp)).collect()
        });
        let mut bytes = all[format].clone();
        for (index, value) in changes {
            let at = index.index(bytes.len());
            bytes[at] = value;
        }
        if let Some((index, text)) = inserted {
            let at = index.index(bytes.len());
            bytes.splice(at..at, text.bytes());
        }
        if let Some(index) = cut {
            bytes.truncate(index.index(bytes.len()));
        }
        for (_, kind, _) in FORMATS {
            if let Ok(mesh) = parse(kind, &bytes) {
                let n = mesh.positions_m.len();
                prop_assert!(mesh.triangles.iter().flatten().all(|&v| (v as usize) < n));
                prop_assert!(mesh.positions_m.iter().all(|p| p.is_finite()));
                // The check must hold for whatever a reader lets through.
                let _ = glisson_mesh::surface::check::check_closed(&mesh);
            }
        }
    }
}
