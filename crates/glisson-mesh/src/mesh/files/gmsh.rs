//! Gmsh files (`.msh`), versions 2.x and 4.1, ASCII and binary, and version 1, which is text.
//!
//! Source: Gmsh reference manual, chapter "Gmsh file formats" (gmsh.info), with its section on the legacy
//! version 1: no `$MeshFormat`, but `$NOD ... $ENDNOD` and `$ELM ... $ENDELM`. Node numbers are any; sections
//! other than nodes and elements are passed over.

use std::io::{self, Write};

use super::GmshVersion;
use super::cells::{CellKind, Frame, RawMesh, gmsh_element_kind, refused_volume};
use super::format::{MeshFormat, file};
use super::numbered::NumberedNodes;
use crate::binary::{ByteOrder, NumberType};
use crate::math::DVec3;
use crate::mesh::TetMesh;
use crate::scan::{FormatError, Scanner, millimetres, quoted};
use crate::units::LengthUnit;

struct GmshReader<'a> {
    scanner: Scanner<'a>,
    /// Byte order of a binary file.
    binary: Option<ByteOrder>,
    unit: LengthUnit,
    raw: RawMesh,
    nodes: NumberedNodes,
    /// What the list of nodes is called.
    node_section: &'static str,
}

/// The format's row of the table.
pub(super) const FORMAT: MeshFormat = MeshFormat {
    name: "Gmsh",
    extensions: &["msh"],
    n_files: 1,
    read: |files, unit| read(file(files, 0), unit),
    write: Some(|mesh, out| write(mesh, GmshVersion::V2_2, out)),
};

/// The mesh in the bytes of a file.
fn read(bytes: &[u8], unit: LengthUnit) -> Result<RawMesh, FormatError> {
    let mut reader = GmshReader {
        scanner: Scanner::new(bytes),
        binary: None,
        unit,
        raw: RawMesh::default(),
        nodes: NumberedNodes::default(),
        node_section: "$Nodes",
    };
    let mut version = None;
    let (mut has_nodes, mut has_elements) = (false, false);
    while let Some(section) = reader.scanner.word() {
        match (section, version) {
            (b"$MeshFormat", None) => {
                version = Some(reader.read_format()?);
                reader.end_section(section)?;
            }
            (b"$Comments", _) => {
                let before = reader.scanner.rest();
                reader.end_section(section)?;
                let length = before.len() - reader.scanner.remaining();
                reader.raw.frame = Frame::named_in(&before[..length]);
            }
            (b"$Nodes", Some(version)) if !has_nodes => {
                match version {
                    GmshVersion::V2_2 => reader.read_nodes_2()?,
                    GmshVersion::V4_1 => reader.read_nodes_4()?,
                }
                reader.index_nodes()?;
                reader.end_section(section)?;
                has_nodes = true;
            }
            (b"$Elements", Some(version)) if has_nodes && !has_elements => {
                match version {
                    GmshVersion::V2_2 => reader.read_elements_2()?,
                    GmshVersion::V4_1 => reader.read_elements_4()?,
                }
                reader.end_section(section)?;
                has_elements = true;
            }
            (b"$NOD", None) if !has_nodes => {
                // Nodes are written as in version 2.
                reader.node_section = "$NOD";
                reader.read_nodes_2()?;
                reader.index_nodes()?;
                reader.end_section(section)?;
                has_nodes = true;
            }
            (b"$ELM", None) if has_nodes && !has_elements => {
                reader.read_elements_1()?;
                reader.end_section(section)?;
                has_elements = true;
            }
            (b"$Nodes" | b"$Elements" | b"$MeshFormat" | b"$NOD" | b"$ELM", _) => {
                let expected =
                    "$MeshFormat, $Nodes and $Elements once each, in this order (version 1: $NOD and $ELM)";
                return Err(reader.scanner.error(quoted(section), expected));
            }
            _ if section.starts_with(b"$") => reader.end_section(section)?,
            _ => return Err(reader.scanner.error(quoted(section), "a section such as $Nodes")),
        }
    }
    if !has_elements {
        return Err(reader.scanner.error(
            "the end of the file",
            "$MeshFormat, $Nodes and $Elements before it (version 1: $NOD and $ELM)",
        ));
    }
    Ok(reader.raw)
}

impl GmshReader<'_> {
    fn read_format(&mut self) -> Result<GmshVersion, FormatError> {
        let text = self.scanner.expect_text("a version")?;
        let version = match text.as_ref() {
            "2" | "2.0" | "2.1" | "2.2" => GmshVersion::V2_2,
            "4.1" => GmshVersion::V4_1,
            _ => {
                return Err(self.scanner.error(format!("version {}", quoted(text.as_bytes())), "2.2 or 4.1"));
            }
        };
        let is_binary = match self.scanner.integer("0 (ASCII) or 1 (binary)")? {
            0 => false,
            1 => true,
            other => return Err(self.scanner.error(format!("file type {other}"), "0 (ASCII) or 1 (binary)")),
        };
        let size = self.scanner.integer("the size of a number")?;
        if size != 8 {
            return Err(self.scanner.error(format!("numbers of {size} bytes"), "8"));
        }
        if is_binary {
            self.scanner.line();
            self.binary = match self.scanner.take(4, "the number one, for the byte order")? {
                [1, 0, 0, 0] => Some(ByteOrder::Little),
                [0, 0, 0, 1] => Some(ByteOrder::Big),
                other => {
                    let found = format!("the bytes {other:?}");
                    return Err(self.scanner.byte_error(found, "the number one in four bytes"));
                }
            };
        }
        Ok(version)
    }

    /// Passes over what is left of a section.
    fn end_section(&mut self, name: &[u8]) -> Result<(), FormatError> {
        // Version 1 has capital letters alone.
        let is_capital = !name.iter().any(u8::is_ascii_lowercase);
        let mut end = if is_capital { b"$END".to_vec() } else { b"$End".to_vec() };
        end.extend_from_slice(&name[1..]);
        if self.scanner.skip_past(&end) {
            return Ok(());
        }
        Err(self.scanner.error("the end of the file", quoted(&end)))
    }

    /// Binary data start behind the end of the line.
    fn end_of_line(&mut self) {
        if self.binary.is_some() {
            self.scanner.line();
        }
    }

    fn binary_integer(&mut self, kind: NumberType, order: ByteOrder, what: &str) -> Result<i64, FormatError> {
        let bytes = self.scanner.take(kind.n_bytes(), what)?;
        kind.integer(bytes, order)
            .ok_or_else(|| self.scanner.byte_error("a number above 2^63", format!("{what} in range")))
    }

    /// A number of four bytes.
    fn int(&mut self, what: &str) -> Result<i64, FormatError> {
        match self.binary {
            Some(order) => self.binary_integer(NumberType::I32, order, what),
            None => self.scanner.integer(what),
        }
    }

    /// A number of eight bytes.
    fn size(&mut self, what: &str) -> Result<i64, FormatError> {
        match self.binary {
            Some(order) => self.binary_integer(NumberType::U64, order, what),
            None => self.scanner.integer(what),
        }
    }

    /// A count of things, each of at least so many bytes as text and as binary data.
    fn size_count(&mut self, what: &str, as_text: usize, as_binary: usize) -> Result<usize, FormatError> {
        let found = self.size(&format!("the number of {what}"))?;
        self.scanner.check_count(found, what, if self.binary.is_some() { as_binary } else { as_text })
    }

    fn coordinate(&mut self) -> Result<f64, FormatError> {
        let Some(order) = self.binary else { return self.scanner.length_m(self.unit, "a coordinate") };
        let bytes = self.scanner.take(8, "a coordinate")?;
        let value = self.unit.to_metres(NumberType::F64.float(bytes, order));
        if value.is_finite() {
            Ok(value)
        } else {
            Err(self.scanner.byte_error(format!("the coordinate {value}"), "a finite number"))
        }
    }

    fn position(&mut self) -> Result<DVec3, FormatError> {
        Ok(DVec3::new(self.coordinate()?, self.coordinate()?, self.coordinate()?))
    }

    fn add_node(&mut self, number: i64, position_m: DVec3) {
        self.nodes.push(number);
        self.raw.positions_m.push(position_m);
    }

    fn read_nodes_2(&mut self) -> Result<(), FormatError> {
        let n = self.scanner.count("nodes", if self.binary.is_some() { 28 } else { 8 })?;
        self.end_of_line();
        for _ in 0..n {
            let number = self.int("a node number")?;
            let position_m = self.position()?;
            self.add_node(number, position_m);
        }
        Ok(())
    }

    fn read_nodes_4(&mut self) -> Result<(), FormatError> {
        self.end_of_line();
        let n_blocks = self.size_count("node blocks", 8, 20)?;
        let n_nodes = self.size_count("nodes", 8, 32)?;
        self.size("the lowest node number")?;
        self.size("the highest node number")?;
        for _ in 0..n_blocks {
            let dimension = self.int("the dimension of an entity")?;
            self.int("the number of an entity")?;
            let is_parametric = self.int("0 or 1 (parametric)")? != 0;
            let n = self.size_count("nodes of a block", 8, 32)?;
            let numbers: Vec<i64> = (0..n).map(|_| self.size("a node number")).collect::<Result<_, _>>()?;
            for number in numbers {
                let position_m = self.position()?;
                self.add_node(number, position_m);
                if is_parametric {
                    for _ in 0..dimension.clamp(0, 3) {
                        self.coordinate()?;
                    }
                }
            }
        }
        if self.nodes.len() != n_nodes {
            let found = format!("{} nodes in the blocks", self.nodes.len());
            return Err(self.scanner.error(found, format!("{n_nodes} as announced")));
        }
        Ok(())
    }

    fn index_nodes(&mut self) -> Result<(), FormatError> {
        match self.nodes.sort() {
            Some(number) => {
                Err(self.scanner.error(format!("node number {number} twice"), "a number of its own for each"))
            }
            None => Ok(()),
        }
    }

    /// Reads the nodes of element `number`; keeps it if it is a tetrahedron.
    fn read_element(&mut self, number: i64, kind: (CellKind, usize)) -> Result<(), FormatError> {
        self.element_nodes(number, kind, Self::int)
    }

    fn element_nodes(
        &mut self,
        number: i64,
        (kind, n_nodes): (CellKind, usize),
        node: impl Fn(&mut Self, &str) -> Result<i64, FormatError>,
    ) -> Result<(), FormatError> {
        match kind {
            CellKind::Volume(name) => Err(refused_volume(format!("element {number}"), name)),
            CellKind::Flat(name) => {
                for _ in 0..n_nodes {
                    node(self, "a node of an element")?;
                }
                self.raw.skip(name, 1);
                Ok(())
            }
            CellKind::Tetrahedron => {
                let mut numbers = [0; 4];
                for number in &mut numbers {
                    *number = node(self, "a node of a tetrahedron")?;
                }
                let element = || format!("element {number}");
                let places = self.nodes.places(numbers, element, self.node_section)?;
                let n_nodes = self.raw.positions_m.len();
                self.raw.add_tetrahedron(places, 0, n_nodes, element)
            }
        }
    }

    fn element_kind(&self, element_type: i64) -> Result<(CellKind, usize), FormatError> {
        gmsh_element_kind(element_type).ok_or_else(|| {
            self.scanner.error(format!("unknown Gmsh element type {element_type}"), "tetrahedra (type 4)")
        })
    }

    /// Number, type, two regions, number of nodes, nodes.
    fn read_elements_1(&mut self) -> Result<(), FormatError> {
        let n = self.scanner.count("elements", 10)?;
        for _ in 0..n {
            let number = self.scanner.integer("an element number")?;
            let kind = self.scanner.integer("an element type")?;
            let kind = self.element_kind(kind)?;
            self.scanner.integer("a physical region")?;
            self.scanner.integer("an elementary region")?;
            let n_nodes = self.scanner.integer("the number of nodes of an element")?;
            self.read_element(number, kind)?;
            if n_nodes != kind.1 as i64 {
                let found = format!("{n_nodes} nodes");
                return Err(FormatError::named(
                    format!("element {number}"),
                    found,
                    format!("{}, as its type has", kind.1),
                ));
            }
        }
        Ok(())
    }

    fn read_elements_2(&mut self) -> Result<(), FormatError> {
        let n = self.scanner.count("elements", 8)?;
        self.end_of_line();
        let mut n_read = 0;
        while n_read < n {
            if self.binary.is_some() {
                let kind = self.int("an element type")?;
                let kind = self.element_kind(kind)?;
                let n_follow = self.int("a number of elements")?;
                let n_follow = self.scanner.check_count(n_follow, "elements", 4)?;
                let n_tags = self.int("a number of tags")?;
                let n_tags = self.scanner.check_count(n_tags, "tags", 4)?;
                for _ in 0..n_follow {
                    let number = self.int("an element number")?;
                    for _ in 0..n_tags {
                        self.int("a tag")?;
                    }
                    self.read_element(number, kind)?;
                }
                n_read += n_follow;
            } else {
                let number = self.int("an element number")?;
                let kind = self.int("an element type")?;
                let kind = self.element_kind(kind)?;
                let n_tags = self.scanner.count("tags", 2)?;
                for _ in 0..n_tags {
                    self.int("a tag")?;
                }
                self.read_element(number, kind)?;
                n_read += 1;
            }
        }
        Ok(())
    }

    fn read_elements_4(&mut self) -> Result<(), FormatError> {
        self.end_of_line();
        let n_blocks = self.size_count("element blocks", 8, 20)?;
        let n_elements = self.size_count("elements", 4, 16)?;
        self.size("the lowest element number")?;
        self.size("the highest element number")?;
        let mut n_read = 0;
        for _ in 0..n_blocks {
            self.int("the dimension of an entity")?;
            self.int("the number of an entity")?;
            let kind = self.int("an element type")?;
            let kind = self.element_kind(kind)?;
            let n = self.size_count("elements of a block", 4, 16)?;
            for _ in 0..n {
                let number = self.size("an element number")?;
                self.element_nodes(number, kind, Self::size)?;
            }
            n_read += n;
        }
        if n_read != n_elements {
            let found = format!("{n_read} elements in the blocks");
            return Err(self.scanner.error(found, format!("{n_elements} as announced")));
        }
        Ok(())
    }
}

/// Writes `mesh` as ASCII in millimetres: reading it gives the same bits.
pub(super) fn write(mesh: &TetMesh, version: GmshVersion, out: &mut impl Write) -> io::Result<()> {
    let (n_nodes, n_tets) = (mesh.positions_m.len(), mesh.tetrahedra.len());
    let number = match version {
        GmshVersion::V2_2 => "2.2",
        GmshVersion::V4_1 => "4.1",
    };
    writeln!(out, "$MeshFormat\n{number} 0 8\n$EndMeshFormat")?;
    writeln!(out, "$Comments\nGlisson tetrahedral mesh; millimetres; SPACE=LPS\n$EndComments")?;
    writeln!(out, "$Nodes")?;
    if version == GmshVersion::V4_1 {
        writeln!(out, "1 {n_nodes} 1 {n_nodes}\n3 1 0 {n_nodes}")?;
        for n in 1..=n_nodes {
            writeln!(out, "{n}")?;
        }
    } else {
        writeln!(out, "{n_nodes}")?;
    }
    for (n, p) in mesh.positions_m.iter().enumerate() {
        if version == GmshVersion::V2_2 {
            write!(out, "{} ", n + 1)?;
        }
        writeln!(out, "{} {} {}", millimetres(p.x), millimetres(p.y), millimetres(p.z))?;
    }
    writeln!(out, "$EndNodes\n$Elements")?;
    match version {
        GmshVersion::V2_2 => writeln!(out, "{n_tets}")?,
        GmshVersion::V4_1 => writeln!(out, "1 {n_tets} 1 {n_tets}\n3 1 4 {n_tets}")?,
    }
    for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
        let [a, b, c, d] = nodes.map(|n| n.0 + 1);
        match version {
            GmshVersion::V2_2 => writeln!(out, "{} 4 2 0 1 {a} {b} {c} {d}", t + 1)?,
            GmshVersion::V4_1 => writeln!(out, "{} {a} {b} {c} {d}", t + 1)?,
        }
    }
    writeln!(out, "$EndElements")
}
