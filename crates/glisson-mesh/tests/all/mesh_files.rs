//! Mesh files: every flavour that is read, round trips of what is written, faults by index, and bytes that
//! no program wrote.

use std::path::Path;

use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::faults::{
    FaultAction, ImportPolicy, LengthUnit, LooseNodes, MeshError, find_faults, fix_winding,
};
use glisson_mesh::mesh::files::{
    FORMATS, FieldPlace, FieldValues, GmshVersion, MeshFileError, MeshFormat, VtuField, extensions_of,
    format_of_extension, mesh_from_bytes, read_mesh, read_mesh_with, write_gmsh, write_mesh, write_vtu_with,
};
use glisson_mesh::mesh::topology::Topology;
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};
use proptest::prelude::*;

use crate::mesh_file_samples::{
    Kind, VtuStyle, abaqus_flat, abaqus_part, base64, febio_1, febio_4, gmsh_1, gmsh_2, plain, read_as,
    samples, tetgen, two_tets, vtk_5_ascii, vtk_ascii, vtu,
};

/// Every row has extensions of its own, is read from empty files without a panic, and is a kind of [`Kind`].
#[test]
fn the_table_of_formats_is_sound() {
    let all = extensions_of(|_| true);
    for format in FORMATS {
        assert!(!format.name.is_empty() && !format.extensions.is_empty(), "{}", format.name);
        assert!(format.n_files == 1 || format.n_files == format.extensions.len(), "{}", format.name);
        for extension in format.extensions {
            assert_eq!(all.iter().filter(|other| *other == extension).count(), 1, "{extension}");
        }
        assert!(mesh_from_bytes(format, &[], &ImportPolicy::default(), "x").is_err(), "{}", format.name);
    }
    assert_eq!(FORMATS.len(), 7, "a new format has its flavours in `samples`");
}

fn vtk_format() -> &'static MeshFormat {
    format_of_extension("vtk").unwrap()
}

fn error_of(kind: Kind, text: &str) -> String {
    read_as(kind, text.as_bytes(), &ImportPolicy::default()).unwrap_err().to_string()
}

#[test]
fn every_flavour_gives_the_same_mesh() {
    for (at, (kind, bytes)) in samples().into_iter().enumerate() {
        let mesh = read_as(kind, &bytes, &ImportPolicy::default())
            .unwrap_or_else(|e| panic!("sample {at} ({kind:?}): {e}"));
        assert_eq!(mesh, two_tets(), "sample {at} ({kind:?})");
    }
}

#[test]
fn skipped_cells_are_counted_and_the_unit_is_asked_for() {
    let text = vtk_ascii();
    let policy = ImportPolicy { unit: LengthUnit::Metre, ..ImportPolicy::default() };
    let (mesh, report) = mesh_from_bytes(vtk_format(), &[text.as_bytes()], &policy, "x").unwrap();
    assert_eq!(report.skipped_cells, [("triangle", 1), ("vertex", 1)]);
    assert_eq!(mesh.positions_m[4], DVec3::splat(10.0));
    let policy = ImportPolicy { unit: LengthUnit::Centimetre, ..ImportPolicy::default() };
    assert_eq!(read_as(Kind::Vtk, text.as_bytes(), &policy).unwrap().positions_m[4], DVec3::splat(0.1));
    // Text and binary alike.
    let policy = ImportPolicy { unit: LengthUnit::Inch, ..ImportPolicy::default() };
    for (kind, bytes) in samples() {
        let mesh = read_as(kind, &bytes, &policy).unwrap();
        assert_eq!(mesh.positions_m[4], DVec3::splat(0.254), "{kind:?}");
    }
}

#[test]
fn right_anterior_files_are_turned_to_left_posterior() {
    let turned = |mesh: TetMesh| {
        assert_eq!(mesh.positions_m[1], DVec3::new(-0.01, 0.0, 0.0));
        assert_eq!(mesh.positions_m[4], DVec3::new(-0.01, -0.01, 0.01));
        assert!((mesh.volume_m3() - two_tets().volume_m3()).abs() < 1e-20);
    };
    let read = |kind, text: &str| read_as(kind, text.as_bytes(), &ImportPolicy::default()).unwrap();
    turned(read(Kind::Vtk, &vtk_ascii().replace("\ntwo\n", "\n3D Slicer output. SPACE=RAS\n")));
    let xml = String::from_utf8(vtu(VtuStyle::Ascii)).unwrap();
    turned(read(Kind::Vtu, &xml.replace("<VTKFile", "<!-- SPACE=RAS --><VTKFile")));
    let comment = "$EndMeshFormat\n$Comments\nspace=ras\n$EndComments";
    turned(read(Kind::Gmsh, &gmsh_2().replace("$EndMeshFormat", comment)));
    turned(read(Kind::TetGen, &tetgen(1).replace("# nodes", "# SPACE=RAS")));
    turned(read(Kind::Febio, &febio_1().replace("<Material/>", "<!-- SPACE=RAS -->")));
    turned(read(Kind::Abaqus, &abaqus_flat().replace("two tetrahedra", "Space=RAS")));
    turned(read(Kind::Plain, &format!("# SPACE=RAS\n{}", plain(1))));
    assert_eq!(read(Kind::Vtk, &vtk_ascii().replace("\ntwo\n", "\nSPACE=LPS\n")), two_tets());
}

fn write_all(folder: &Path, mesh: &TetMesh) -> Vec<std::path::PathBuf> {
    let paths = ["a.vtk", "a.vtu", "a.msh", "b.msh"].map(|name| folder.join(name));
    for path in &paths[..3] {
        write_mesh(path, mesh).unwrap();
    }
    write_gmsh(&paths[3], mesh, GmshVersion::V4_1).unwrap();
    paths.to_vec()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 16, ..ProptestConfig::default() })]

    #[test]
    fn written_meshes_come_back_bit_for_bit(
        shift in prop::array::uniform3(-1e3f64..1e3),
        scale in -9i32..4,
        noise in prop::collection::vec(-0.2f64..0.2, 81),
    ) {
        let mut mesh = super::mesh_edits::grid([2; 3], |_| true);
        for (n, p) in mesh.positions_m.iter_mut().enumerate() {
            let noise = DVec3::from_slice(&noise[3 * n..]);
            *p = (*p + noise) * 10f64.powi(scale) + DVec3::from_array(shift) * 10f64.powi(scale);
        }
        fix_winding(&mut mesh);
        let folder = tempfile::tempdir().unwrap();
        for path in write_all(folder.path(), &mesh) {
            let (back, report) = read_mesh(&path).unwrap();
            prop_assert!(report.winding_fixed.is_empty());
            prop_assert_eq!(&back.tetrahedra, &mesh.tetrahedra);
            for (a, b) in back.positions_m.iter().zip(&mesh.positions_m) {
                prop_assert_eq!(a.to_array().map(f64::to_bits), b.to_array().map(f64::to_bits));
            }
        }
    }

    #[test]
    fn any_number_survives_the_file(bits in prop::collection::vec(any::<u64>(), 12)) {
        let coordinates: Vec<f64> = bits
            .iter()
            .map(|&b| f64::from_bits(b))
            .map(|x| if x.is_finite() && x.abs() < 1e300 { x } else { -0.0 })
            .collect();
        let mesh = TetMesh {
            positions_m: coordinates.chunks(3).map(DVec3::from_slice).collect(),
            tetrahedra: vec![[0, 1, 2, 3].map(NodeId)],
            ..TetMesh::default()
        };
        let folder = tempfile::tempdir().unwrap();
        for path in write_all(folder.path(), &mesh) {
            let (back, _) = read_mesh(&path).unwrap();
            for (a, b) in back.positions_m.iter().zip(&mesh.positions_m) {
                prop_assert_eq!(a.to_array().map(f64::to_bits), b.to_array().map(f64::to_bits));
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 3000, ..ProptestConfig::default() })]

    #[test]
    fn mutated_and_truncated_bytes_never_panic(
        sample in any::<prop::sample::Index>(),
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0u8..5), 0..6),
        cut in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let samples = samples();
        let (kind, mut bytes) = samples[sample.index(samples.len())].clone();
        for (at, value, action) in edits {
            let at = at.index(bytes.len());
            match action {
                0 => bytes[at] = value,
                1 => bytes[at] ^= 1 << (value % 8),
                2 => bytes.insert(at, b"0123456789-. \n$\"<>e"[usize::from(value) % 19]),
                3 => { bytes.remove(at); }
                _ => bytes[at] = b"0123456789-. \n$\"<>e"[usize::from(value) % 19],
            }
            prop_assume!(!bytes.is_empty());
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        if let Ok(mesh) = read_as(kind, &bytes, &ImportPolicy::default()) {
            let n = mesh.positions_m.len();
            prop_assert!(mesh.positions_m.iter().all(|p| p.is_finite()));
            prop_assert!(mesh.tetrahedra.iter().flatten().all(|node| node.index() < n));
            // Whatever was read and found faultless has a topology.
            if find_faults(&mesh).is_empty() {
                prop_assert!(Topology::build(&mesh).is_ok());
            }
        }
    }
}

#[test]
fn every_truncation_is_refused_or_whole() {
    for (kind, bytes) in samples() {
        for length in 0..bytes.len() {
            if let Ok(mesh) = read_as(kind, &bytes[..length], &ImportPolicy::default()) {
                if kind == Kind::Abaqus {
                    // The format has neither counts nor an end: a file cut behind an element is whole.
                    assert!(two_tets().tetrahedra.starts_with(&mesh.tetrahedra));
                    continue;
                }
                let tail = String::from_utf8_lossy(&bytes[length..]).into_owned();
                // Only what stands behind the mesh may be missing, or the end of its last number.
                assert!(tail.len() < 40, "{kind:?} cut before {tail:?}");
                assert_eq!(mesh.tetrahedra.len(), 2);
            }
        }
    }
}

#[test]
fn messages_name_place_found_and_expected() {
    for (text, expected) in vtk_mistakes() {
        assert_tells(Kind::Vtk, &text, expected);
    }
    for (kind, text, expected) in mistakes_of_lists().into_iter().chain(mistakes_of_models()) {
        assert_tells(kind, &text, expected);
    }
    for (text, expected) in vtu_mistakes() {
        assert_tells(Kind::Vtu, &text, expected);
    }
}

fn assert_tells(kind: Kind, text: &str, expected: &str) {
    let message = error_of(kind, text);
    assert!(message.contains(expected), "{message}\n  should contain: {expected}");
}

fn vtk_mistakes() -> Vec<(String, &'static str)> {
    vec![
        (
            vtk_ascii().replace("Version 3.0", "Version 6.0"),
            "sample, line 1: found `# vtk DataFile Version 6.0`, expected `# vtk DataFile Version` 2.0 to 5.1",
        ),
        (vtk_ascii().replace("UNSTRUCTURED_GRID", "POLYDATA"), "line 4: found dataset `POLYDATA`"),
        (vtk_ascii().replace("POINTS 5", "POINTS 99999999999"), "found 99999999999 points, expected 0 to"),
        (
            vtk_ascii().replace("\n10 10 10\n", "\n10 ten 10\n"),
            "line 10: found `ten`, expected a coordinate (a finite number)",
        ),
        (vtk_ascii().replace("\n10 10 10\n", "\n10 nan 10\n"), "found `nan`"),
        (vtk_ascii().replace("4 1 2 3 4", "4 1 2 3 5"), "cell 3: found node 5, expected a node from 0 to 4"),
        (vtk_ascii().replace("4 1 2 3 4", "4 1 2 3 -1"), "cell 3: found node -1"),
        (
            vtk_ascii().replace("10\n1\n5\n10", "10\n1\n5\n12"),
            "cell 3: found a hexahedron, expected 4-node tetrahedra",
        ),
        (vtk_ascii().replace("10\n1\n5\n10", "10\n1\n5\n24"), "found a quadratic tetrahedron"),
        (vtk_ascii().replace("10\n1\n5\n10", "10\n1\n5\n1"), "cell 3: found a vertex of 4 nodes"),
        (vtk_5_ascii().replace("0 4 8", "0 8 4"), "found a tetrahedron of 8 nodes"),
    ]
}

/// Of the formats that are lists of numbers.
fn mistakes_of_lists() -> Vec<(Kind, String, &'static str)> {
    vec![
        (Kind::Gmsh, gmsh_2().replace("2.2 0 8", "4.0 0 8"), "found version `4.0`, expected 2.2 or 4.1"),
        (
            Kind::Gmsh,
            gmsh_2().replace("27 37 47", "27 37 48"),
            "element 4: found node 48, expected one of the nodes under $Nodes",
        ),
        (Kind::Gmsh, gmsh_2().replace("\n17 10", "\n7 10"), "node number 7 twice"),
        (Kind::Gmsh, gmsh_2().replace("4 4 2 0 1 17", "4 5 2 0 1 17"), "element 4: found a hexahedron"),
        (
            Kind::Gmsh,
            gmsh_1().replace("4 7 17 27 37", "10 7 17 27 37"),
            "element 3: found 10 nodes, expected 4, as its type has",
        ),
        (
            Kind::Gmsh,
            gmsh_1().replace("27 37 47", "27 37 48"),
            "element 4: found node 48, expected one of the nodes under $NOD",
        ),
        (Kind::Gmsh, gmsh_1().replace("$ENDNOD", "$EndNOD"), "found the end of the file, expected `$ENDNOD`"),
        (
            Kind::Gmsh,
            gmsh_1().replace("$ELM", "$Elements"),
            "line 12: found `$Elements`, expected $MeshFormat, $Nodes and $Elements once each, in this order",
        ),
        (
            Kind::TetGen,
            tetgen(1).replace("\0 2 4 1", "\0 2 10 1"),
            ".ele file, line 1: found tetrahedra of 10 nodes",
        ),
        (
            Kind::TetGen,
            tetgen(1).replace("  3  0", "  4  0"),
            ".node file, line 5: found number 4, expected number 3",
        ),
        (Kind::Plain, plain(0).replace("5 2", "5 3"), "line 8: found the end of the file, expected a vertex"),
        (
            Kind::Plain,
            plain(0).replace("5 2", "5 1"),
            "found `1`, expected the end of the list after 5 vertices and 1 tetrahedra",
        ),
        (Kind::Plain, "0 0".into(), "sample: found no tetrahedron"),
    ]
}

/// Of the formats that hold whole models.
fn mistakes_of_models() -> Vec<(Kind, String, &'static str)> {
    let febio = |from: &str, to: &str, expected| (Kind::Febio, febio_4().replace(from, to), expected);
    let flat = |from: &str, to: &str, expected| (Kind::Abaqus, abaqus_flat().replace(from, to), expected);
    let part = |from: &str, to: &str, expected| (Kind::Abaqus, abaqus_part().replace(from, to), expected);
    vec![
        febio("febio_spec", "spec", "the root element: found `spec`, expected `febio_spec`"),
        febio(
            "\"4.0\"",
            "\"5.0\"",
            "attribute version: found `5.0`, expected 1.0, 1.1, 1.2, 2.0, 2.5, 3.0, 4.0",
        ),
        febio("Mesh>", "Net>", "the file: found no element Geometry or Mesh"),
        febio("<Mesh>", "<Mesh from=\"a.feb\">", "line 4: found the file `a.feb` named by `from`"),
        febio(
            "<Nodes name=\"b\"",
            "<Part/><Nodes name=\"b\"",
            "found `Part`, expected Nodes and Elements without",
        ),
        febio("id=\"17\"> 1e1", "id=\"17\"> ten", "line 7: found `ten`, expected three finite coordinates"),
        febio("id=\"17\"> 1e1,", "id=\"17\"> ", "line 7: found `0,\\n0`, expected three finite"),
        febio("<node id=\"17\"", "<node id=\"7\"", "Nodes: found node 7 twice"),
        febio("<node id=\"17\"", "<node", "line 7: found id ``, expected a whole number in attribute id"),
        febio("27,37,47", "27,37", "line 24: found `17,27,37`, expected the numbers of four nodes"),
        febio("27,37,47", "27,37,47,7", "line 24: found `17,27,37,47,7`, expected the numbers of four nodes"),
        febio(" type=\"quad4\"", "", "line 21: found unknown element type `elem`"),
        febio("27,37,47", "27,37,48", "element 3: found node 48, expected one of the nodes under Nodes"),
        febio("quad4", "hex8", "element 2: found a hexahedron, expected 4-node tetrahedra"),
        febio(
            "quad4",
            "ball9",
            "line 21: found unknown element type `ball9`, expected tetrahedra (type tet4)",
        ),
        febio("</Mesh>", "", "expected an XML document"),
        flat("*heading", "heading", "line 1: found `heading`, expected a keyword such as *NODE"),
        flat("7, 0.0,", "7, zero,", "line 5: found `zero`, expected a coordinate (a finite number)"),
        flat("\n17, 10.0", "\nx, 10.0", "line 6: found `x`, expected a node number"),
        flat("\n17, 10.0", "\n7, 10.0", "*NODE: found node 7 twice"),
        flat(
            "27, 37\n",
            "27\n",
            "line 17: found 4 numbers, expected the number of an element and four nodes",
        ),
        flat("27, 37\n", "27, 37, 47\n", "line 17: found 6 numbers"),
        flat(" 27, 37\n", "", "line 18: found a keyword after 3 numbers, expected the number of an element"),
        flat("37,47", "37,48", "element 3: found node 48, expected one of the nodes under *NODE"),
        flat(
            "DC3D4",
            "C3D10M",
            "line 23, element 3: found a quadratic tetrahedron, expected 4-node tetrahedra",
        ),
        flat("DC3D4", "SC8R", "element 3: found a continuum shell"),
        flat("DC3D4", "U1", "line 22: found unknown element type `U1`, expected tetrahedra (TYPE=C3D4)"),
        flat("*node, nset=all", "*NODE, Input = A.INP", "line 4: found the file `A.INP` named by INPUT"),
        flat("*static", "*Include, input=b.inp", "found the file `B.INP` named by INPUT"),
        flat(
            "*node, nset=all",
            "*node, system=c",
            "line 4: found SYSTEM=C, expected rectangular coordinates",
        ),
        flat("*nset, nset=fixed", "*nfill", "found *NFILL, expected every node and element in *NODE"),
        part("*Material", "*Part", "line 24: found a second *PART, expected one part alone"),
        part("*Material", "*Instance", "line 24: found a second *INSTANCE, expected one part alone"),
        part(
            "0., 0., 0.",
            "0., 1., 0.",
            "line 17: found an instance moved by `0., 1., 0.`, expected an instance at",
        ),
        part("type=MASS", "type=C3D4", "found tetrahedra of the assembly, expected tetrahedra in its part"),
    ]
}

#[test]
fn models_have_more_than_tetrahedra_and_latin_letters() {
    let skipped = |extension: &str, text: &[u8]| {
        let format = format_of_extension(extension).unwrap();
        let (mesh, report) = mesh_from_bytes(format, &[text], &ImportPolicy::default(), "x").unwrap();
        assert_eq!(mesh, two_tets());
        report.skipped_cells
    };
    assert_eq!(skipped("feb", febio_4().as_bytes()), [("quadrilateral", 1)]);
    assert_eq!(skipped("inp", abaqus_flat().as_bytes()), [("shell", 1)]);
    assert_eq!(skipped("inp", abaqus_part().as_bytes()), [("mass", 1)]);
    let latin: Vec<u8> =
        febio_1().replace("<Material/>", "<!-- J\u{fc}rg -->").chars().map(|c| c as u8).collect();
    assert_eq!(skipped("feb", &latin), [("triangle", 1)]);
    let utf: Vec<u8> = latin.iter().map(|&b| if b == b'8' { b'9' } else { b }).collect();
    let message = read_as(Kind::Febio, &utf, &ImportPolicy::default()).unwrap_err().to_string();
    assert!(message.contains("found bytes that are no UTF-8"), "{message}");
}

fn vtu_mistakes() -> Vec<(String, &'static str)> {
    let xml = String::from_utf8(vtu(VtuStyle::Ascii)).unwrap();
    vec![
        (xml.replace("10 5 10", "10 5 13"), "piece 0, cell 2: found a wedge"),
        (xml.replace("\"5\"", "\"6\""), "piece 0: found 5 points, expected NumberOfPoints = 6"),
        (xml.replace("UnstructuredGrid\"", "PolyData\""), "expected `VTKFile` of type UnstructuredGrid"),
        (
            xml.replace("LittleEndian\"", "LittleEndian\" compressor=\"vtkLZ4DataCompressor\""),
            "found `vtkLZ4DataCompressor`, expected vtkZLibDataCompressor",
        ),
        (xml.replace("</Piece>", "</Pice>"), "line "),
        (xml.replace("4 7 11", "4 x 11"), "piece 0, array offsets, line 1 of the array: found `x`"),
    ]
}

#[test]
fn compressed_size_that_no_data_can_have_is_refused_before_it_is_allocated() {
    let header: Vec<u8> = [1u32, u32::MAX, 0, 20].iter().flat_map(|x| x.to_le_bytes()).collect();
    let bomb = format!("{}{}", base64(&header), base64(&[0; 20]));
    let text = String::from_utf8(vtu(VtuStyle::InlineZlib)).unwrap();
    let start = text.find("format=\"binary\">").unwrap() + 16;
    let end = start + text[start..].find('<').unwrap();
    let message = error_of(Kind::Vtu, &format!("{}{bomb}{}", &text[..start], &text[end..]));
    assert!(message.contains("too few for the size announced"), "{message}");
}

#[test]
fn fields_are_written_beside_the_mesh() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("fields.vtu");
    let mesh = two_tets();
    let displacement = vec![DVec3::X; 5];
    let quality = [0.5, 0.25];
    let fields = [
        VtuField { name: "u <m>", place: FieldPlace::Nodes, values: FieldValues::Vectors(&displacement) },
        VtuField { name: "quality", place: FieldPlace::Tets, values: FieldValues::Scalars(&quality) },
        VtuField { name: "zone", place: FieldPlace::Tets, values: FieldValues::Integers(&[1, 2]) },
    ];
    write_vtu_with(&path, &mesh, &fields).unwrap();
    assert_eq!(read_mesh(&path).unwrap().0, mesh);
    let text = std::fs::read_to_string(&path).unwrap();
    assert!(text.contains("Name=\"u &lt;m>\" NumberOfComponents=\"3\"") && text.contains("Name=\"zone\""));
    let short = [VtuField { place: FieldPlace::Nodes, ..fields[1] }];
    let error = write_vtu_with(&path, &mesh, &short).unwrap_err();
    assert_eq!(error.to_string(), "field `quality` has 2 values, the mesh needs 5");
    assert_eq!(std::fs::read_to_string(&path).unwrap(), text, "the old file is untouched");
}

#[test]
fn files_are_told_by_their_extension() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let pair = tetgen(1);
    let (node, ele) = pair.split_once('\0').unwrap();
    std::fs::write(at("liver.1.node"), node).unwrap();
    let message = read_mesh(&at("liver.1.node")).unwrap_err().to_string();
    assert!(message.contains("liver.1.ele"), "{message}");
    std::fs::write(at("liver.1.ele"), ele).unwrap();
    for name in ["liver.1.node", "liver.1.ele"] {
        assert_eq!(read_mesh(&at(name)).unwrap().0, two_tets());
    }
    for name in ["liver.tet", "liver.TXT"] {
        std::fs::write(at(name), plain(1)).unwrap();
        assert_eq!(read_mesh(&at(name)).unwrap().0, two_tets());
    }
    let message = read_mesh(&at("liver.stl")).unwrap_err().to_string();
    assert!(message.contains("`stl`, expected one of .vtk, .vtu, .msh"), "{message}");
    let message = write_mesh(&at("liver.tet"), &two_tets()).unwrap_err().to_string();
    assert!(message.contains("expected one of .vtk, .vtu, .msh"), "{message}");
    assert!(matches!(read_mesh(&at("none.vtk")), Err(MeshFileError::Io { .. })));
}

#[test]
fn winding_is_fixed_and_said() {
    let text = vtk_ascii().replace("4 1 2 3 4", "4 2 1 3 4");
    let (mesh, report) =
        mesh_from_bytes(vtk_format(), &[text.as_bytes()], &ImportPolicy::default(), "x").unwrap();
    assert_eq!(report.winding_fixed, [TetId(1)]);
    let lines = [
        "1 cell(s) passed over: triangle",
        "1 cell(s) passed over: vertex",
        "1 tetrahedra were inside out: 1 (fixed)",
    ];
    assert_eq!(report.lines(), lines);
    assert!(report.faults.is_empty());
    assert!(mesh.tet_volume_m3(TetId(1)) > 0.0);
    Topology::build(&mesh).unwrap();
}

#[test]
fn faults_are_found_by_index() {
    let with_tets = |extra: &[[u32; 4]]| {
        let mut mesh = two_tets();
        mesh.tetrahedra.extend(extra.iter().map(|t| t.map(NodeId)));
        find_faults(&mesh)
    };
    assert!(find_faults(&two_tets()).is_empty());
    assert_eq!(with_tets(&[[0, 1, 2, 9]]).out_of_range[0].node, NodeId(9));
    assert_eq!(with_tets(&[[0, 1, 1, 2]]).repeated_nodes, [TetId(2)]);
    let repeated = with_tets(&[[3, 0, 1, 2], [0, 1, 2, 3]]);
    assert_eq!(repeated.repeated_tets, [(TetId(2), TetId(0)), (TetId(3), TetId(0))]);
    assert_eq!(repeated.inverted, [TetId(2)]);
    let crowded = with_tets(&[[1, 2, 3, 0], [0, 1, 2, 4]]);
    let crowded: Vec<_> =
        crowded.crowded_triangles.iter().map(|c| (c.nodes.map(|n| n.0), c.tets.clone())).collect();
    assert_eq!(crowded, [([0, 1, 2], [0, 2, 3].map(TetId).into()), ([1, 2, 3], [0, 1, 2].map(TetId).into())]);

    let mut mesh = two_tets();
    mesh.positions_m.push(DVec3::new(0.01, 0.0, -0.0));
    mesh.positions_m.push(DVec3::new(f64::NAN, 0.0, 0.0));
    let faults = find_faults(&mesh);
    assert_eq!(faults.duplicate_nodes, [(NodeId(5), NodeId(1))]);
    assert_eq!(faults.loose_nodes, [NodeId(5), NodeId(6)]);
    assert_eq!(faults.non_finite_nodes, [NodeId(6)]);

    let mut flat = two_tets();
    flat.positions_m[4] = (flat.positions_m[1] + flat.positions_m[2] + flat.positions_m[3]) / 3.0;
    for p in &mut flat.positions_m {
        *p += DVec3::splat(1.0 / 3.0);
    }
    assert_eq!(find_faults(&flat).flat, [TetId(1)]);
    // The second tetrahedron pushed through the common face: both on the same side, winding put right.
    let mut folded = two_tets();
    folded.positions_m[4] = DVec3::splat(0.001);
    assert_eq!(find_faults(&folded).inverted, [TetId(1)]);
    assert_eq!(find_faults(&folded).folded_triangles[0].tets, [TetId(0), TetId(1)]);
    assert_eq!(fix_winding(&mut folded), [TetId(1)]);
    assert_eq!(find_faults(&folded).folded_triangles[0].tets, [TetId(0), TetId(1)]);
    assert!(Topology::build(&folded).is_err());
}

#[test]
fn refusing_policy_names_faults_and_loose_nodes_can_go() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bad.vtk");
    let mut mesh = two_tets();
    mesh.positions_m.insert(0, DVec3::splat(0.5));
    for tet in &mut mesh.tetrahedra {
        *tet = tet.map(|n| NodeId(n.0 + 1));
    }
    write_mesh(&path, &mesh).unwrap();
    let (_, report) = read_mesh(&path).unwrap();
    assert_eq!(report.faults.loose_nodes, [NodeId(0)]);
    let strict = ImportPolicy { faults: FaultAction::Refuse, ..ImportPolicy::default() };
    let error = read_mesh_with(&path, &strict).unwrap_err();
    assert!(matches!(error, MeshFileError::Mesh(MeshError::Faulty { .. })));
    let message = error.to_string();
    assert!(message.contains("bad.vtk: 1 node(s) of no tetrahedron: 0 (drop them)"), "{message}");
    let dropping = ImportPolicy { loose_nodes: LooseNodes::Drop, ..strict };
    let (back, report) = read_mesh_with(&path, &dropping).unwrap();
    assert_eq!((back, report.n_loose_nodes_dropped), (two_tets(), 1));
}
