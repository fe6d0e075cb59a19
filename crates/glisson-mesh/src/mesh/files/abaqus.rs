//! Abaqus input (`.inp`): nodes and elements, flat or in one part with one instance that is not moved; sets, materials,
//! steps and all other keywords are passed over with their data.
//!
//! Source: Abaqus Analysis User's Guide, "Input syntax rules", `*NODE`, `*ELEMENT`, `*PART`, `*INSTANCE` and the index of
//! element types (Dassault Systèmes). A keyword line starts with one asterisk, a comment with two; words are separated
//! by commas, in upper or lower case; a line that ends with a comma goes on in the next one. Node numbers are any;
//! nodes of the assembly itself are reference points and belong to no element of a part.

use super::cells::{CellKind, Frame, RawMesh, refused_volume};
use super::format::{MeshFormat, file};
use super::numbered::NumberedNodes;
use crate::math::DVec3;
use crate::scan::{FormatError, Place, parse_length_m, quoted};
use crate::units::LengthUnit;

/// The format's row of the table.
pub(super) const FORMAT: MeshFormat = MeshFormat {
    name: "Abaqus",
    extensions: &["inp"],
    n_files: 1,
    read: |files, unit| read(file(files, 0), unit),
    write: None,
};

/// Beginnings of the names of solid elements, whose number of nodes follows.
const SOLIDS: [&str; 8] = ["C3D", "AC3D", "DC3D", "DCC3D", "EC3D", "FC3D", "EMC3D", "Q3D"];

/// Beginnings of the names of all other elements; the first that fits counts.
const OTHERS: [(&str, CellKind); 40] = [
    ("COH", CellKind::Volume("cohesive element")),
    ("CIN", CellKind::Volume("infinite element")),
    ("CCL", CellKind::Volume("cylindrical element")),
    ("CSS", CellKind::Volume("solid shell")),
    ("SC", CellKind::Volume("continuum shell")),
    ("GK", CellKind::Volume("gasket element")),
    ("PC3D", CellKind::Flat("vertex")),
    ("PD3D", CellKind::Flat("vertex")),
    ("SPRING", CellKind::Flat("spring")),
    ("DASHPOT", CellKind::Flat("dashpot")),
    ("MASS", CellKind::Flat("mass")),
    ("ROTARYI", CellKind::Flat("mass")),
    ("HEATCAP", CellKind::Flat("mass")),
    ("CONN", CellKind::Flat("connector")),
    ("JOINT", CellKind::Flat("connector")),
    ("DCOUP", CellKind::Flat("connector")),
    ("GAP", CellKind::Flat("connector")),
    ("SFM", CellKind::Flat("surface element")),
    ("F2D", CellKind::Flat("surface element")),
    ("F3D", CellKind::Flat("surface element")),
    ("SAX", CellKind::Flat("shell")),
    ("STRI", CellKind::Flat("shell")),
    ("S3", CellKind::Flat("shell")),
    ("S4", CellKind::Flat("shell")),
    ("S8", CellKind::Flat("shell")),
    ("S9", CellKind::Flat("shell")),
    ("DS", CellKind::Flat("shell")),
    ("M3D", CellKind::Flat("membrane")),
    ("R2D", CellKind::Flat("rigid element")),
    ("R3D", CellKind::Flat("rigid element")),
    ("RB", CellKind::Flat("rigid element")),
    ("T2D", CellKind::Flat("truss")),
    ("T3D", CellKind::Flat("truss")),
    ("B2", CellKind::Flat("beam")),
    ("B3", CellKind::Flat("beam")),
    ("PIPE", CellKind::Flat("beam")),
    ("ELBOW", CellKind::Flat("beam")),
    ("FRAME", CellKind::Flat("beam")),
    ("CP", CellKind::Flat("plane element")),
    ("CAX", CellKind::Flat("plane element")),
];

/// Keywords that make or move nodes and elements beyond those that stand in the file.
const GENERATORS: [&str; 7] = ["NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY", "SYSTEM"];

/// Where between the keywords of a model a line stands.
#[derive(Clone, Copy, PartialEq)]
enum Scope {
    Model,
    Part,
    Assembly,
    Instance,
}

/// What the data lines are.
#[derive(Clone, Copy)]
enum Block {
    /// Before the first keyword.
    None,
    PassedOver,
    Nodes,
    Elements(CellKind),
    /// Translation and rotation of an instance.
    Instance,
}

struct AbaqusReader {
    unit: LengthUnit,
    raw: RawMesh,
    nodes: NumberedNodes,
    /// Number of each tetrahedron and those of its nodes.
    tetrahedra: Vec<(i64, [i64; 4])>,
    scope: Scope,
    block: Block,
    n_parts: usize,
    n_instances: usize,
    /// Line from 1.
    line: usize,
    /// A keyword line that goes on.
    keyword: String,
    /// Numbers of a tetrahedron whose line goes on.
    numbers: Vec<i64>,
    /// A line of another element goes on.
    in_element: bool,
    digits: String,
}

/// The mesh in the bytes of a file.
fn read(bytes: &[u8], unit: LengthUnit) -> Result<RawMesh, FormatError> {
    let mut reader = AbaqusReader {
        unit,
        raw: RawMesh { frame: Frame::named_in(bytes), ..RawMesh::default() },
        nodes: NumberedNodes::default(),
        tetrahedra: Vec::new(),
        scope: Scope::Model,
        block: Block::None,
        n_parts: 0,
        n_instances: 0,
        line: 0,
        keyword: String::new(),
        numbers: Vec::new(),
        in_element: false,
        digits: String::new(),
    };
    for line in bytes.split(|&byte| byte == b'\n').map(<[u8]>::trim_ascii) {
        reader.line += 1;
        if !line.is_empty() && !line.starts_with(b"**") {
            reader.read_line(line)?;
        }
    }
    reader.end_block("the end of the file")?;
    reader.into_raw()
}

impl AbaqusReader {
    fn error(&self, found: impl Into<String>, expected: impl Into<String>) -> FormatError {
        FormatError { place: Place::Line(self.line), found: found.into(), expected: expected.into() }
    }

    fn read_line(&mut self, line: &[u8]) -> Result<(), FormatError> {
        let goes_on = !self.keyword.is_empty();
        if line.starts_with(b"*") || goes_on {
            self.end_block("a keyword")?;
            self.keyword.push_str(&String::from_utf8_lossy(line).to_uppercase());
            if line.ends_with(b",") {
                return Ok(());
            }
            let keyword = std::mem::take(&mut self.keyword);
            return self.begin(&keyword);
        }
        match self.block {
            Block::None => Err(self.error(quoted(line), "a keyword such as *NODE")),
            Block::PassedOver => Ok(()),
            Block::Nodes => self.read_node(line),
            Block::Elements(kind) => self.read_element(line, kind),
            Block::Instance => self.check_unmoved(line),
        }
    }

    /// Nothing may be half read where the data lines of a keyword end.
    fn end_block(&mut self, found: &str) -> Result<(), FormatError> {
        self.in_element = false;
        if self.numbers.is_empty() {
            return Ok(());
        }
        let n = self.numbers.len();
        Err(self.error(format!("{found} after {n} numbers"), "the number of an element and four nodes"))
    }

    /// Begins what a keyword line, in capital letters, announces.
    fn begin(&mut self, keyword: &str) -> Result<(), FormatError> {
        let mut words = keyword.split(',').map(str::trim);
        let name = words.next().unwrap_or("").trim_start_matches('*').trim();
        let parameters: Vec<(&str, &str)> =
            words.map(|word| word.split_once('=').unwrap_or((word, ""))).collect();
        let parameter =
            |name: &str| parameters.iter().find(|(key, _)| key.trim() == name).map(|(_, value)| value.trim());
        if matches!(name, "NODE" | "ELEMENT" | "INCLUDE")
            && let Some(other) = parameter("INPUT")
        {
            let found = format!("the file {} named by INPUT", quoted(other.as_bytes()));
            return Err(self.error(found, "nodes and elements themselves in one file"));
        }
        if GENERATORS.contains(&name) {
            let found = format!("*{name}");
            return Err(self.error(found, "every node and element in *NODE and *ELEMENT, in global axes"));
        }
        self.block = match name {
            "NODE" => match parameter("SYSTEM") {
                // Reference points.
                _ if self.scope == Scope::Assembly => Block::PassedOver,
                None | Some("R") => Block::Nodes,
                Some(system) => {
                    let found = format!("SYSTEM={system}");
                    return Err(self.error(found, "rectangular coordinates"));
                }
            },
            "ELEMENT" => Block::Elements(self.element_kind(parameter("TYPE").unwrap_or(""))?),
            "PART" | "INSTANCE" => {
                let count = if name == "PART" { &mut self.n_parts } else { &mut self.n_instances };
                *count += 1;
                if *count > 1 {
                    let found = format!("a second *{name}");
                    return Err(self.error(found, "one part alone: save each part in a file of its own"));
                }
                self.scope = if name == "PART" { Scope::Part } else { Scope::Instance };
                if name == "PART" { Block::PassedOver } else { Block::Instance }
            }
            _ => {
                self.scope = match name {
                    "ASSEMBLY" | "END INSTANCE" => Scope::Assembly,
                    "END PART" | "END ASSEMBLY" => Scope::Model,
                    _ => self.scope,
                };
                Block::PassedOver
            }
        };
        Ok(())
    }

    fn element_kind(&self, name: &str) -> Result<CellKind, FormatError> {
        let kind = match SOLIDS.iter().find_map(|start| name.strip_prefix(start)) {
            Some(rest) => solid_kind(rest),
            None => OTHERS.iter().find(|(start, _)| name.starts_with(start)).map(|(_, kind)| *kind),
        };
        match kind {
            Some(CellKind::Tetrahedron) if self.scope == Scope::Assembly => {
                Err(self.error("tetrahedra of the assembly", "tetrahedra in its part alone"))
            }
            Some(kind) => Ok(kind),
            None => {
                let found = format!("unknown element type {}", quoted(name.as_bytes()));
                Err(self.error(found, "tetrahedra (TYPE=C3D4)"))
            }
        }
    }

    fn integer(&self, word: &[u8], expected: &str) -> Result<i64, FormatError> {
        std::str::from_utf8(word)
            .ok()
            .and_then(|text| text.parse().ok())
            .ok_or_else(|| self.error(quoted(word), expected))
    }

    /// Number and coordinates; one left out is zero. Direction cosines may follow.
    fn read_node(&mut self, line: &[u8]) -> Result<(), FormatError> {
        let mut words = line.split(|&byte| byte == b',').map(<[u8]>::trim_ascii);
        let number = self.integer(words.next().unwrap_or_default(), "a node number")?;
        let mut position_m = DVec3::ZERO;
        for (axis, word) in words.take(3).enumerate().filter(|(_, word)| !word.is_empty()) {
            position_m[axis] = self.length_m(word)?;
        }
        self.nodes.push(number);
        self.raw.positions_m.push(position_m);
        Ok(())
    }

    /// A length [m], whose exponent may be Fortran's `D`.
    fn length_m(&mut self, word: &[u8]) -> Result<f64, FormatError> {
        let plain: Vec<u8> = word.iter().map(|&b| if matches!(b, b'd' | b'D') { b'e' } else { b }).collect();
        parse_length_m(&plain, self.unit, &mut self.digits)
            .ok_or_else(|| self.error(quoted(word), "a coordinate (a finite number)"))
    }

    fn read_element(&mut self, line: &[u8], kind: CellKind) -> Result<(), FormatError> {
        let goes_on = line.ends_with(b",");
        let mut words =
            line.strip_suffix(b",").unwrap_or(line).split(|&byte| byte == b',').map(<[u8]>::trim_ascii);
        match kind {
            CellKind::Flat(name) => {
                self.raw.skip(name, usize::from(!self.in_element));
                self.in_element = goes_on;
                Ok(())
            }
            CellKind::Volume(name) => {
                let number = String::from_utf8_lossy(words.next().unwrap_or_default()).into_owned();
                Err(refused_volume(format!("line {}, element {number}", self.line), name))
            }
            CellKind::Tetrahedron => {
                let expected = "the number of an element and four nodes";
                for word in words {
                    let number = self.integer(word, expected)?;
                    self.numbers.push(number);
                }
                match self.numbers[..] {
                    [number, a, b, c, d] => self.tetrahedra.push((number, [a, b, c, d])),
                    _ if goes_on && self.numbers.len() < 5 => return Ok(()),
                    _ => return Err(self.error(format!("{} numbers", self.numbers.len()), expected)),
                }
                self.numbers.clear();
                Ok(())
            }
        }
    }

    fn check_unmoved(&mut self, line: &[u8]) -> Result<(), FormatError> {
        for word in line.split(|&byte| byte == b',').map(<[u8]>::trim_ascii).filter(|word| !word.is_empty()) {
            if self.length_m(word)? != 0.0 {
                let expected =
                    "an instance at the place of its part: move the nodes themselves, or mesh the assembly";
                return Err(self.error(format!("an instance moved by {}", quoted(line)), expected));
            }
        }
        Ok(())
    }

    fn into_raw(mut self) -> Result<RawMesh, FormatError> {
        if let Some(number) = self.nodes.sort() {
            let found = format!("node {number} twice");
            return Err(FormatError::named("*NODE", found, "a number of its own for each"));
        }
        let n_nodes = self.raw.positions_m.len();
        for (number, nodes) in self.tetrahedra {
            let name = || format!("element {number}");
            let places = self.nodes.places(nodes, name, "*NODE")?;
            self.raw.add_tetrahedron(places, 0, n_nodes, name)?;
        }
        Ok(self.raw)
    }
}

/// The kind of a solid element by what follows the beginning of its name: a number of nodes, and letters.
fn solid_kind(rest: &str) -> Option<CellKind> {
    let n_digits = rest.bytes().take_while(u8::is_ascii_digit).count();
    Some(match &rest[..n_digits] {
        "4" => CellKind::Tetrahedron,
        "5" => CellKind::Volume("pyramid"),
        "6" => CellKind::Volume("wedge"),
        "8" => CellKind::Volume("hexahedron"),
        "10" => CellKind::Volume("quadratic tetrahedron"),
        "13" => CellKind::Volume("quadratic pyramid"),
        "15" | "18" => CellKind::Volume("quadratic wedge"),
        "20" | "21" | "27" => CellKind::Volume("quadratic hexahedron"),
        _ => return None,
    })
}
