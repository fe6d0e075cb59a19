//! Sample files of every mesh format: the same two tetrahedra in each.

use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::faults::ImportPolicy;
use glisson_mesh::mesh::files::{GmshVersion, MeshFileError, format_of_extension, mesh_from_bytes};
use glisson_mesh::mesh::{NodeId, TetMesh};

/// Corners of a 10 mm cube, without three: two tetrahedra with a common face.
pub(crate) const POINTS_MM: [[f64; 3]; 5] =
    [[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 10.0], [10.0, 10.0, 10.0]];
pub(crate) const TETS: [[u32; 4]; 2] = [[0, 1, 2, 3], [1, 2, 3, 4]];

pub(crate) fn two_tets() -> TetMesh {
    TetMesh {
        positions_m: POINTS_MM.iter().map(|p| DVec3::from_array(*p) / 1000.0).collect(),
        tetrahedra: TETS.iter().map(|t| t.map(NodeId)).collect(),
        ..TetMesh::default()
    }
}

pub(crate) fn points_text() -> String {
    POINTS_MM.iter().map(|[x, y, z]| format!("{x} {y} {z}\n")).collect()
}

/// What a sample is; the bytes are kept beside it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Kind {
    Vtk,
    Vtu,
    Gmsh,
    Plain,
    /// `.node`, then a zero byte, then `.ele`.
    TetGen,
    Febio,
    Abaqus,
}

pub(crate) fn read_as(kind: Kind, bytes: &[u8], policy: &ImportPolicy) -> Result<TetMesh, MeshFileError> {
    let extension = match kind {
        Kind::Vtk => "vtk",
        Kind::Vtu => "vtu",
        Kind::Gmsh => "msh",
        Kind::Plain => "tet",
        Kind::TetGen => "node",
        Kind::Febio => "feb",
        Kind::Abaqus => "inp",
    };
    let format = format_of_extension(extension).unwrap();
    let at = bytes.iter().position(|&b| b == 0).unwrap_or(bytes.len());
    let pair = [&bytes[..at], bytes.get(at + 1..).unwrap_or_default()];
    let files: &[&[u8]] = if kind == Kind::TetGen { &pair } else { &[bytes] };
    mesh_from_bytes(format, files, policy, "sample").map(|(mesh, _)| mesh)
}

pub(crate) fn base64(bytes: &[u8]) -> String {
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

pub(crate) fn zlib(bytes: &[u8]) -> Vec<u8> {
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

pub(crate) fn vtk_ascii() -> String {
    format!(
        "# vtk DataFile Version 3.0\ntwo\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 5 float\n{}CELLS 4 16\n\
         4 0 1 2 3\n1 0\n3 0 1 2\n4 1 2 3 4\nCELL_TYPES 4\n10\n1\n5\n10\nPOINT_DATA 5\nSCALARS a int\n",
        points_text()
    )
}

pub(crate) fn vtk_5_ascii() -> String {
    format!(
        "# vtk DataFile Version 5.1\r\ntwo\r\nASCII\r\nDATASET UNSTRUCTURED_GRID\r\nFIELD FieldData 1\r\n\
         TIME 1 1 double\r\n0.5\r\nPOINTS 5 double\r\n{}\r\nMETADATA\r\nINFORMATION 1\r\n\
         NAME L2_NORM_RANGE LOCATION vtkDataArray\r\nDATA 2 0 17\r\n\r\nCELLS 3 8\r\n\
         OFFSETS vtktypeint64\r\n0 4 8\r\nCONNECTIVITY vtktypeint64\r\n0 1 2 3 1 2 3 4\r\n\
         CELL_TYPES 2\r\n10\r\n10\r\n",
        points_text()
    )
}

pub(crate) fn vtk_binary(is_new: bool) -> Vec<u8> {
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
pub(crate) enum VtuStyle {
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

pub(crate) const VTU_STYLES: [VtuStyle; 9] = [
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
pub(crate) struct VtuArrays {
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

    pub(crate) fn points(&mut self, points: &[[f64; 3]]) -> String {
        let text = points.iter().map(|[x, y, z]| format!("{x} {y} {z}\n")).collect();
        let data = points.as_flattened().iter().flat_map(|x| self.bytes8(x.to_bits())).collect();
        self.array("type=\"Float64\" NumberOfComponents=\"3\"", text, data)
    }

    pub(crate) fn integers(&mut self, name: &str, list: &[u32]) -> String {
        let text = list.iter().map(|x| format!("{x} ")).collect::<String>().trim().to_owned();
        let data = list.iter().flat_map(|&x| self.bytes8(u64::from(x))).collect();
        self.array(&format!("type=\"Int64\" Name=\"{name}\""), text, data)
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

pub(crate) fn vtu(style: VtuStyle) -> Vec<u8> {
    vtk_xml(style, "UnstructuredGrid", |arrays| {
        let points = arrays.points(&POINTS_MM);
        let connectivity = arrays.integers("connectivity", &[0, 1, 2, 3, 0, 1, 2, 1, 2, 3, 4]);
        let offsets = arrays.integers("offsets", &[4, 7, 11]);
        let types = arrays.array("type=\"UInt8\" Name=\"types\"", "10 5 10".into(), vec![10, 5, 10]);
        format!(
            "<Piece NumberOfPoints=\"5\" NumberOfCells=\"3\">\n<Points>{points}</Points>\n\
             <Cells>{connectivity}{offsets}{types}</Cells>\n</Piece>\n"
        )
    })
}

/// A VTK XML file of a `kind` of data set with the pieces that `pieces` gives.
pub(crate) fn vtk_xml(style: VtuStyle, kind: &str, pieces: impl FnOnce(&mut VtuArrays) -> String) -> Vec<u8> {
    use VtuStyle::*;
    let mut arrays = VtuArrays { style, appended: Vec::new() };
    let pieces = pieces(&mut arrays);
    let order = if arrays.is_big_endian() { "BigEndian\" header_type=\"UInt64" } else { "LittleEndian" };
    let compressor = if arrays.is_zipped() { " compressor=\"vtkZLibDataCompressor\"" } else { "" };
    let appended = arrays.appended;
    let mut out = format!(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"{kind}\" version=\"0.1\" byte_order=\"{order}\"{compressor}>\n\
         <{kind}>\n{pieces}</{kind}>\n"
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

pub(crate) fn gmsh_2() -> String {
    let nodes: String = (0..5)
        .map(|n| format!("{} {} {} {}\n", 10 * n + 7, POINTS_MM[n][0], POINTS_MM[n][1], POINTS_MM[n][2]))
        .collect();
    format!(
        "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n1\n3 1 \"liver\"\n$EndPhysicalNames\n\
         $Nodes\n5\n{nodes}$EndNodes\n$Elements\n4\n1 15 2 0 1 7\n2 2 2 0 1 7 17 27\n\
         3 4 2 0 1 7 17 27 37\n4 4 2 0 1 17 27 37 47\n$EndElements\n"
    )
}

pub(crate) fn gmsh_1() -> String {
    let nodes: String = (0..5)
        .map(|n| format!("{} {} {} {}\n", 10 * n + 7, POINTS_MM[n][0], POINTS_MM[n][1], POINTS_MM[n][2]))
        .collect();
    format!(
        "$NOD\n5\n{nodes}$ENDNOD\n$NOE\nanything\n$ENDNOE\n$ELM\n4\n1 15 0 1 1 7\n2 2 0 1 3 7 17 27\n\
         3 4 0 1 4 7 17 27 37\n4 4 0 1 4 17 27 37 47\n$ENDELM\n"
    )
}

pub(crate) fn gmsh_4() -> String {
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

pub(crate) fn gmsh_binary(version: GmshVersion) -> Vec<u8> {
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

pub(crate) fn tetgen(first: u32) -> String {
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

pub(crate) fn plain(first: u32) -> String {
    let tets: String = TETS.iter().flatten().map(|n| format!("{} ", n + first)).collect();
    format!("5 2\n{}{tets}\n", points_text())
}

/// Points numbered 7, 17, 27, ...
fn febio_nodes(from: usize, to: usize) -> String {
    (from..to)
        .map(|n| {
            let [x, y, z] = POINTS_MM[n];
            format!("<node id=\"{}\"> {x:e}, {y},\n{z} </node>\n", 10 * n + 7)
        })
        .collect()
}

/// Version 1.2: elements are named by their tags.
pub(crate) fn febio_1() -> String {
    format!(
        "<?xml version=\"1.0\" encoding=\"ISO-8859-1\"?>\n<febio_spec version=\"1.2\">\n<Material/>\n<Geometry>\n\
         <Nodes>{}</Nodes>\n<Elements>\n<tri3 id=\"1\" mat=\"1\">7,17,27</tri3>\n\
         <tet4 id=\"2\" mat=\"1\">7, 17, 27, 37</tet4>\n<tet4 id=\"3\" mat=\"1\">17,27,37,47</tet4>\n\
         </Elements>\n<ElementData/>\n</Geometry>\n</febio_spec>\n",
        febio_nodes(0, 5)
    )
}

/// Version 4: several blocks.
pub(crate) fn febio_4() -> String {
    format!(
        "<?xml version=\"1.0\"?>\n<febio_spec version=\"4.0\">\n<Module type=\"solid\"/>\n<Mesh>\n\
         <Nodes name=\"a\">{}</Nodes>\n<Nodes name=\"b\">{}</Nodes>\n\
         <Elements type=\"tet4\" name=\"liver\">\n<elem id=\"1\">7,17,27,37</elem>\n</Elements>\n\
         <Elements type=\"quad4\" name=\"skin\">\n<elem id=\"2\">7,17,27,37</elem>\n</Elements>\n\
         <Elements type=\"TET4G1\" name=\"tumour\"><!-- one point -->\n<elem id=\"3\">17,27,37,47</elem>\n</Elements>\n\
         <NodeSet name=\"fixed\">7,17</NodeSet>\n</Mesh>\n</febio_spec>\n",
        febio_nodes(0, 3),
        febio_nodes(3, 5)
    )
}

fn abaqus_nodes(from: usize, to: usize) -> String {
    (from..to)
        .map(|n| {
            let [x, y, z] = POINTS_MM[n];
            format!("{}, {x:.1}, {y:E},{z:.2}\n", 10 * n + 7)
        })
        .collect()
}

/// Without parts, in lower case, with comments, a continued keyword and continued data.
pub(crate) fn abaqus_flat() -> String {
    format!(
        "*heading\ntwo tetrahedra\n** nodes\n*node, nset=all\n{}** between\n*NODE OUTPUT\nU\n*Node\n{}\
         *element, type=c3d4h,\n elset=liver\n1, 7, 17,\n 27, 37\n\n*Element, type=S3R\n2, 7,\n17, 27\n\
         *ELEMENT, TYPE=DC3D4\n3,17,27,37,47\n*nset, nset=fixed\n7, 17\n*step\n*static\n*end step\n",
        abaqus_nodes(0, 2),
        abaqus_nodes(2, 5).replace(",0.00", ",").replace("E1", "D1")
    )
}

/// As Abaqus/CAE writes it: a part, an assembly with its instance and a reference point.
pub(crate) fn abaqus_part() -> String {
    format!(
        "*Heading\r\n*Part, name=Liver\r\n*Node\r\n{}*Element, type=C3D4\r\n1, 7, 17, 27, 37\r\n2, 17, 27, 37, 47\r\n\
         *Solid Section, elset=all, material=soft\r\n,\r\n*End Part\r\n*Assembly, name=Assembly\r\n\
         *Instance, name=Liver-1, part=Liver\r\n0., 0., 0.\r\n*End Instance\r\n*Node\r\n7, 1., 2., 3.\r\n\
         *Element, type=MASS\r\n1, 7\r\n*End Assembly\r\n*Material, name=soft\r\n*Elastic\r\n1000., 0.45\r\n",
        abaqus_nodes(0, 5)
    )
}

pub(crate) fn samples() -> Vec<(Kind, Vec<u8>)> {
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
        (Kind::Febio, febio_1().into_bytes()),
        (Kind::Febio, febio_4().into_bytes()),
        (Kind::Abaqus, abaqus_flat().into_bytes()),
        (Kind::Abaqus, abaqus_part().into_bytes()),
        (Kind::Plain, plain(0).into_bytes()),
        (Kind::Plain, plain(1).into_bytes()),
    ];
    all.extend(VTU_STYLES.map(|style| (Kind::Vtu, vtu(style))));
    all
}
