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

/// Corners of a 10 mm cube, without three: two tetrahedra with a common face.
const POINTS_MM: [[f64; 3]; 5] =
    [[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 10.0], [10.0, 10.0, 10.0]];
const TETS: [[u32; 4]; 2] = [[0, 1, 2, 3], [1, 2, 3, 4]];

fn two_tets() -> TetMesh {
    TetMesh {
        positions_m: POINTS_MM.iter().map(|p| DVec3::from_array(*p) / 1000.0).collect(),
        tetrahedra: TETS.iter().map(|t| t.map(NodeId)).collect(),
        ..TetMesh::default()
    }
}

fn points_text() -> String {
    POINTS_MM.iter().map(|[x, y, z]| format!("{x} {y} {z}\n")).collect()
}

/// What a sample is; the bytes are kept beside it.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Vtk,
    Vtu,
    Gmsh,
    Plain,
    /// `.node`, then a zero byte, then `.ele`.
    TetGen,
}

fn read_as(kind: Kind, bytes: &[u8], policy: &ImportPolicy) -> Result<TetMesh, MeshFileError> {
    let extension = match kind {
        Kind::Vtk => "vtk",
        Kind::Vtu => "vtu",
        Kind::Gmsh => "msh",
        Kind::Plain => "tet",
        Kind::TetGen => "node",
    };
    let format = format_of_extension(extension).unwrap();
    let at = bytes.iter().position(|&b| b == 0).unwrap_or(bytes.len());
    let pair = [&bytes[..at], bytes.get(at + 1..).unwrap_or_default()];
    let files: &[&[u8]] = if kind == Kind::TetGen { &pair } else { &[bytes] };
    mesh_from_bytes(format, files, policy, "sample").map(|(mesh, _)| mesh)
}

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
    assert_eq!(FORMATS.len(), 5, "a new format has its flavours in `samples`");
}

fn vtk_format() -> &'static MeshFormat {
    format_of_extension("vtk").unwrap()
}

fn error_of(kind: Kind, text: &str) -> String {
    read_as(kind, text.as_bytes(), &ImportPolicy::default()).unwrap_err().to_string()
}

fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::new();
    for group in bytes.chunks(3) {
        let bits = group.iter().fold(0u32, |b, &x| b << 8 | u32::from(x)) << (8 * (3 - group.len()));
        for i in 0..4 {
            text.push(if i <= group.len() {
                DIGITS[(bits >> (18 - 6 * i) & 63) as usize].into()
            } else {
                '='
            });
        }
    }
    text
}

fn zlib(bytes: &[u8]) -> Vec<u8> {
    // Stored blocks: no compressor needed.
    let mut out = vec![0x78, 0x01, 1];
    out.extend((bytes.len() as u16).to_le_bytes());
    out.extend((!(bytes.len() as u16)).to_le_bytes());
    out.extend(bytes);
    let (mut a, mut b) = (1u32, 0u32);
    for &byte in bytes {
        a = (a + u32::from(byte)) % 65521;
        b = (b + a) % 65521;
    }
    out.extend((b << 16 | a).to_be_bytes());
    out
}

fn vtk_ascii() -> String {
    format!(
        "# vtk DataFile Version 3.0\ntwo\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 5 float\n{}CELLS 4 16\n\
         4 0 1 2 3\n1 0\n3 0 1 2\n4 1 2 3 4\nCELL_TYPES 4\n10\n1\n5\n10\nPOINT_DATA 5\nSCALARS a int\n",
        points_text()
    )
}

fn vtk_5_ascii() -> String {
    format!(
        "# vtk DataFile Version 5.1\r\ntwo\r\nASCII\r\nDATASET UNSTRUCTURED_GRID\r\nFIELD FieldData 1\r\n\
         TIME 1 1 double\r\n0.5\r\nPOINTS 5 double\r\n{}\r\nMETADATA\r\nINFORMATION 1\r\n\
         NAME L2_NORM_RANGE LOCATION vtkDataArray\r\nDATA 2 0 17\r\n\r\nCELLS 3 8\r\n\
         OFFSETS vtktypeint64\r\n0 4 8\r\nCONNECTIVITY vtktypeint64\r\n0 1 2 3 1 2 3 4\r\n\
         CELL_TYPES 2\r\n10\r\n10\r\n",
        points_text()
    )
}

fn vtk_binary(is_new: bool) -> Vec<u8> {
    let mut out = Vec::new();
    let version = if is_new { "5.1" } else { "2.0" };
    let kind = if is_new { "double" } else { "float" };
    out.extend(
        format!(
            "# vtk DataFile Version {version}\ntwo\nBINARY\nDATASET UNSTRUCTURED_GRID\nPOINTS 5 {kind}\n"
        )
        .bytes(),
    );
    for x in POINTS_MM.as_flattened() {
        if is_new { out.extend(x.to_be_bytes()) } else { out.extend((*x as f32).to_be_bytes()) }
    }
    if is_new {
        out.extend(b"\nMETADATA\nINFORMATION 0\n\nCELLS 3 8\nOFFSETS vtktypeint64\n");
        out.extend([0i64, 4, 8].iter().flat_map(|x| x.to_be_bytes()));
        out.extend(b"\nCONNECTIVITY vtktypeint64\n");
        out.extend(TETS.as_flattened().iter().flat_map(|&x| i64::from(x).to_be_bytes()));
    } else {
        out.extend(b"\nCELLS 2 10\n");
        for tet in TETS {
            out.extend(4i32.to_be_bytes());
            out.extend(tet.iter().flat_map(|x| x.to_be_bytes()));
        }
    }
    out.extend(b"\nCELL_TYPES 2\n");
    out.extend([10i32; 2].iter().flat_map(|x| x.to_be_bytes()));
    out.extend(b"\n");
    out
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum VtuStyle {
    Ascii,
    /// Header and data in one base64 string.
    Inline,
    /// Header and data in a string each.
    InlineSplit,
    InlineZlib,
    AppendedRaw,
    AppendedBase64,
    AppendedRawZlib,
    AppendedBase64Zlib,
    BigEndian64,
}

const VTU_STYLES: [VtuStyle; 9] = [
    VtuStyle::Ascii,
    VtuStyle::Inline,
    VtuStyle::InlineSplit,
    VtuStyle::InlineZlib,
    VtuStyle::AppendedRaw,
    VtuStyle::AppendedBase64,
    VtuStyle::AppendedRawZlib,
    VtuStyle::AppendedBase64Zlib,
    VtuStyle::BigEndian64,
];

/// The data arrays of a file of one style, and what is appended at its end.
struct VtuArrays {
    style: VtuStyle,
    appended: Vec<u8>,
}

impl VtuArrays {
    fn is_big_endian(&self) -> bool {
        self.style == VtuStyle::BigEndian64
    }

    fn is_zipped(&self) -> bool {
        use VtuStyle::*;
        matches!(self.style, InlineZlib | AppendedRawZlib | AppendedBase64Zlib)
    }

    fn bytes8(&self, x: u64) -> [u8; 8] {
        if self.is_big_endian() { x.to_be_bytes() } else { x.to_le_bytes() }
    }

    fn ints(&self, list: &[u32]) -> Vec<u8> {
        list.iter().flat_map(|&x| self.bytes8(u64::from(x))).collect()
    }

    fn header_and_payload(&self, data: Vec<u8>) -> (Vec<u8>, Vec<u8>) {
        let word = |x: usize| {
            if self.is_big_endian() {
                (x as u64).to_be_bytes().to_vec()
            } else {
                (x as u32).to_le_bytes().to_vec()
            }
        };
        if !self.is_zipped() {
            return (word(data.len()), data);
        }
        // Compressed in two blocks, the second one shorter.
        let half = data.len() / 2 + 1;
        let blocks: Vec<Vec<u8>> = data.chunks(half).map(zlib).collect();
        let sizes = [blocks.len(), half, data.len() % half].into_iter().chain(blocks.iter().map(Vec::len));
        (sizes.flat_map(word).collect::<Vec<u8>>(), blocks.concat())
    }

    /// The element of an array that is `text` in ASCII and `data` in binary.
    fn array(&mut self, attributes: &str, text: String, data: Vec<u8>) -> String {
        use VtuStyle::*;
        let (header, payload) = self.header_and_payload(data);
        let (format, content) = match self.style {
            Ascii => ("format=\"ascii\"".into(), text),
            Inline | BigEndian64 => ("format=\"binary\"".into(), base64(&[header, payload].concat())),
            InlineSplit | InlineZlib => {
                ("format=\"binary\"".into(), format!("\n  {}{}\n", base64(&header), base64(&payload)))
            }
            AppendedRaw | AppendedRawZlib | AppendedBase64 | AppendedBase64Zlib => {
                let offset = self.appended.len();
                match self.style {
                    AppendedBase64 => self.appended.extend(base64(&[header, payload].concat()).bytes()),
                    AppendedBase64Zlib => {
                        self.appended.extend(format!("{}{}", base64(&header), base64(&payload)).bytes());
                    }
                    _ => self.appended.extend([header, payload].concat()),
                }
                (format!("format=\"appended\" offset=\"{offset}\""), String::new())
            }
        };
        format!("<DataArray {attributes} {format}>{content}</DataArray>\n")
    }
}

fn vtu(style: VtuStyle) -> Vec<u8> {
    use VtuStyle::*;
    let mut arrays = VtuArrays { style, appended: Vec::new() };
    let floats: Vec<u8> = POINTS_MM.as_flattened().iter().flat_map(|x| arrays.bytes8(x.to_bits())).collect();
    let points = arrays.array("type=\"Float64\" NumberOfComponents=\"3\"", points_text(), floats);
    let corners = arrays.ints(&[0, 1, 2, 3, 0, 1, 2, 1, 2, 3, 4]);
    let connectivity =
        arrays.array("type=\"Int64\" Name=\"connectivity\"", "0 1 2 3 0 1 2 1 2 3 4".into(), corners);
    let ends = arrays.ints(&[4, 7, 11]);
    let offsets = arrays.array("type=\"Int64\" Name=\"offsets\"", "4 7 11".into(), ends);
    let types = arrays.array("type=\"UInt8\" Name=\"types\"", "10 5 10".into(), vec![10, 5, 10]);
    let order = if arrays.is_big_endian() { "BigEndian\" header_type=\"UInt64" } else { "LittleEndian" };
    let compressor = if arrays.is_zipped() { " compressor=\"vtkZLibDataCompressor\"" } else { "" };
    let appended = arrays.appended;
    let mut out = format!(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\" version=\"0.1\" byte_order=\"{order}\"{compressor}>\n\
         <UnstructuredGrid>\n<Piece NumberOfPoints=\"5\" NumberOfCells=\"3\">\n<Points>{points}</Points>\n\
         <Cells>{connectivity}{offsets}{types}</Cells>\n</Piece>\n</UnstructuredGrid>\n"
    )
    .into_bytes();
    if !appended.is_empty() {
        let encoding = if matches!(style, AppendedRaw | AppendedRawZlib) { "raw" } else { "base64" };
        out.extend(format!("<AppendedData encoding=\"{encoding}\">\n  _").bytes());
        out.extend(appended);
        out.extend(b"\n</AppendedData>\n");
    }
    out.extend(b"</VTKFile>\n");
    out
}

fn gmsh_2() -> String {
    let nodes: String = (0..5)
        .map(|n| format!("{} {} {} {}\n", 10 * n + 7, POINTS_MM[n][0], POINTS_MM[n][1], POINTS_MM[n][2]))
        .collect();
    format!(
        "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n1\n3 1 \"liver\"\n$EndPhysicalNames\n\
         $Nodes\n5\n{nodes}$EndNodes\n$Elements\n4\n1 15 2 0 1 7\n2 2 2 0 1 7 17 27\n\
         3 4 2 0 1 7 17 27 37\n4 4 2 0 1 17 27 37 47\n$EndElements\n"
    )
}

fn gmsh_1() -> String {
    let nodes: String = (0..5)
        .map(|n| format!("{} {} {} {}\n", 10 * n + 7, POINTS_MM[n][0], POINTS_MM[n][1], POINTS_MM[n][2]))
        .collect();
    format!(
        "$NOD\n5\n{nodes}$ENDNOD\n$NOE\nanything\n$ENDNOE\n$ELM\n4\n1 15 0 1 1 7\n2 2 0 1 3 7 17 27\n\
         3 4 0 1 4 7 17 27 37\n4 4 0 1 4 17 27 37 47\n$ENDELM\n"
    )
}

fn gmsh_4() -> String {
    let at = |n: usize| format!("{} {} {}\n", POINTS_MM[n][0], POINTS_MM[n][1], POINTS_MM[n][2]);
    format!(
        "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Entities\n0 0 0 1\n1 0 0 0 1 1 1 0 0\n$EndEntities\n\
         $Nodes\n2 5 1 9\n2 1 1 2\n9\n2\n{} 0.5 0.5\n{} 0.25 1\n3 1 0 3\n4\n1\n5\n{}{}{}$EndNodes\n\
         $Elements\n2 3 1 3\n2 1 2 1\n1 9 2 4\n3 1 4 2\n2 9 2 4 1\n3 2 4 1 5\n$EndElements\n",
        at(0).trim(),
        at(1).trim(),
        at(2),
        at(3),
        at(4)
    )
}

fn gmsh_binary(version: GmshVersion) -> Vec<u8> {
    let int = |x: i32| x.to_le_bytes();
    let size = |x: u64| x.to_le_bytes();
    let mut out = Vec::new();
    let is_2 = version == GmshVersion::V2_2;
    out.extend(format!("$MeshFormat\n{} 1 8\n", if is_2 { "2.2" } else { "4.1" }).bytes());
    out.extend(int(1));
    out.extend(b"\n$EndMeshFormat\n$Nodes\n");
    if is_2 {
        out.extend(b"5\n");
    } else {
        out.extend([1u64, 5, 1, 5].into_iter().flat_map(size));
        out.extend([3, 1, 0].into_iter().flat_map(int));
        out.extend([5u64, 1, 2, 3, 4, 5].into_iter().flat_map(size));
    }
    for (n, p) in POINTS_MM.iter().enumerate() {
        if is_2 {
            out.extend(int(n as i32 + 1));
        }
        out.extend(p.iter().flat_map(|x| x.to_le_bytes()));
    }
    out.extend(b"\n$EndNodes\n$Elements\n");
    if is_2 {
        out.extend(b"3\n");
        out.extend([2, 1, 2, 1, 0, 0, 1, 2, 3].into_iter().flat_map(int));
        out.extend([4, 2, 1].into_iter().flat_map(int));
    } else {
        out.extend([1u64, 2, 1, 2].into_iter().flat_map(size));
        out.extend([3, 1, 4].into_iter().flat_map(int));
        out.extend(size(2));
    }
    for (t, tet) in TETS.iter().enumerate() {
        if is_2 {
            out.extend([t as i32 + 2, 0].into_iter().flat_map(int));
            out.extend(tet.iter().flat_map(|&n| int(n as i32 + 1)));
        } else {
            out.extend(size(t as u64 + 1));
            out.extend(tet.iter().flat_map(|&n| size(u64::from(n) + 1)));
        }
    }
    out.extend(b"\n$EndElements\n");
    out
}

fn tetgen(first: u32) -> String {
    let node: String = (0..5)
        .map(|n| {
            format!(
                "  {}  {} {} {}  0.5 1 # remark\n",
                n as u32 + first,
                POINTS_MM[n][0],
                POINTS_MM[n][1],
                POINTS_MM[n][2]
            )
        })
        .collect();
    let ele: String = TETS
        .iter()
        .enumerate()
        .map(|(t, n)| {
            let [a, b, c, d] = n.map(|n| n + first);
            format!("{} {a} {b} {c} {d} 3\n", t as u32 + first)
        })
        .collect();
    format!("# nodes\n5 3 1 1\n{node}\0 2 4 1\n{ele}# end\n")
}

fn plain(first: u32) -> String {
    let tets: String = TETS.iter().flatten().map(|n| format!("{} ", n + first)).collect();
    format!("5 2\n{}{tets}\n", points_text())
}

fn samples() -> Vec<(Kind, Vec<u8>)> {
    let mut all = vec![
        (Kind::Vtk, vtk_ascii().into_bytes()),
        (Kind::Vtk, vtk_5_ascii().into_bytes()),
        (Kind::Vtk, vtk_binary(false)),
        (Kind::Vtk, vtk_binary(true)),
        (Kind::Gmsh, gmsh_1().into_bytes()),
        (Kind::Gmsh, gmsh_2().into_bytes()),
        (Kind::Gmsh, gmsh_4().into_bytes()),
        (Kind::Gmsh, gmsh_binary(GmshVersion::V2_2)),
        (Kind::Gmsh, gmsh_binary(GmshVersion::V4_1)),
        (Kind::TetGen, tetgen(0).into_bytes()),
        (Kind::TetGen, tetgen(1).into_bytes()),
        (Kind::Plain, plain(0).into_bytes()),
        (Kind::Plain, plain(1).into_bytes()),
    ];
    all.extend(VTU_STYLES.map(|style| (Kind::Vtu, vtu(style))));
    all
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
    for (kind, text, expected) in mistakes_of_lists() {
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
