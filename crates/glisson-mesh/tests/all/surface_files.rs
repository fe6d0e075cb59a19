//! Surface files: round trips, frames, exact error places, bytes cut off and changed.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use glisson_mesh::math::DVec3;
use glisson_mesh::surface::TriMesh;
use glisson_mesh::surface::error::SurfaceError;
use glisson_mesh::surface::files::{
    FileKind, FilePlace, Space, SurfaceFileError, SurfaceFormat, import_closed_surface, parse_surface,
    read_surface, write_surface, write_surface_as,
};
use proptest::prelude::*;

use crate::surfaces::{cube, torus};

const FORMATS: [(SurfaceFormat, FileKind, &str); 8] = [
    (SurfaceFormat::StlAscii, FileKind::Stl, "stl"),
    (SurfaceFormat::StlBinary, FileKind::Stl, "stl"),
    (SurfaceFormat::Obj, FileKind::Obj, "obj"),
    (SurfaceFormat::PlyAscii, FileKind::Ply, "ply"),
    (SurfaceFormat::PlyLittleEndian, FileKind::Ply, "ply"),
    (SurfaceFormat::PlyBigEndian, FileKind::Ply, "ply"),
    (SurfaceFormat::VtkAscii, FileKind::Vtk, "vtk"),
    (SurfaceFormat::VtkBinary, FileKind::Vtk, "vtk"),
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
            assert!(String::from_utf8_lossy(&bytes).contains(&format!("SPACE={space:?}").to_uppercase()));
            let read = read_surface(&path).unwrap();
            assert_eq!(read.positions_m.len(), mesh.positions_m.len(), "{path:?}");
            let tolerance_m = if FORMATS[n].0 == SurfaceFormat::StlBinary { 4e-9 } else { 1e-17 };
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
    assert!(notes.contains("inside out") && notes.contains("1 vertices") && notes.contains("millimetres"));
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
    assert_refused(FileKind::Obj, obj("v 1 2 nan"), line, &["1e9 mm", "NaN"]);
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

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    /// Readers answer anything with a surface or an error.
    #[test]
    fn changed_bytes_never_panic(
        format in 0..FORMATS.len(),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
        cut in prop::option::of(any::<prop::sample::Index>()),
        inserted in prop::option::of((any::<prop::sample::Index>(), "[0-9 \\-\n.ef]{1,12}")),
    ) {
        // Written once: each writing waits for the disk.
        static WRITTEN: OnceLock<Vec<Vec<u8>>> = OnceLock::new();
        let all = WRITTEN.get_or_init(|| {
            let folder = tempfile::tempdir().unwrap();
            (0..FORMATS.len()).map(|n| written(folder.path(), &cube(), n, Space::Lps).1).collect()
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
