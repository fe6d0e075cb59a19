//! FEBio models (`.feb`): nodes and elements of `Geometry` (versions 1 and 2) or `Mesh` (3 and 4); materials,
//! boundary conditions and steps are passed over.
//!
//! Source: FEBio User's Manual, chapter "Free Format Input", sections on `Geometry` and `Mesh` (febio.org). Version 1
//! names the type of an element by its tag, later ones by the attribute of `Elements`. Node numbers are any. The
//! unit system that version 4 may name is not looked at: the unit is the policy's.

use std::borrow::Cow;

use roxmltree::{Document, Node};

use super::cells::{CellKind, Frame, RawMesh, refused_volume};
use super::format::{MeshFormat, file};
use super::numbered::NumberedNodes;
use crate::math::DVec3;
use crate::scan::{FormatError, Place, find, parse_length_m, parse_xml, quoted};
use crate::units::LengthUnit;

/// The format's row of the table.
pub(super) const FORMAT: MeshFormat = MeshFormat {
    name: "FEBio",
    extensions: &["feb"],
    n_files: 1,
    read: |files, unit| read(file(files, 0), unit),
    write: None,
};

/// Versions of the format that have been in use.
const VERSIONS: [&str; 7] = ["1.0", "1.1", "1.2", "2.0", "2.5", "3.0", "4.0"];

/// Beginnings of the names of element types; integration rules may follow (`TET4G1`).
const ELEMENT_TYPES: [(&str, CellKind); 19] = [
    ("tet4", CellKind::Tetrahedron),
    ("ut4", CellKind::Tetrahedron),
    ("tet5", CellKind::Volume("5-node tetrahedron")),
    ("tet10", CellKind::Volume("quadratic tetrahedron")),
    ("tet15", CellKind::Volume("quadratic tetrahedron")),
    ("tet20", CellKind::Volume("cubic tetrahedron")),
    ("hex8", CellKind::Volume("hexahedron")),
    ("hex20", CellKind::Volume("quadratic hexahedron")),
    ("hex27", CellKind::Volume("quadratic hexahedron")),
    ("penta6", CellKind::Volume("wedge")),
    ("penta15", CellKind::Volume("quadratic wedge")),
    ("pyra5", CellKind::Volume("pyramid")),
    ("pyra13", CellKind::Volume("quadratic pyramid")),
    ("tri", CellKind::Flat("triangle")),
    ("quad", CellKind::Flat("quadrilateral")),
    ("q4", CellKind::Flat("quadrilateral")),
    ("truss", CellKind::Flat("line")),
    ("line", CellKind::Flat("line")),
    ("beam", CellKind::Flat("line")),
];

struct FebioReader<'a, 'x> {
    document: &'a Document<'x>,
    unit: LengthUnit,
    raw: RawMesh,
    nodes: NumberedNodes,
    digits: String,
}

/// The mesh in the bytes of a file.
fn read(bytes: &[u8], unit: LengthUnit) -> Result<RawMesh, FormatError> {
    let xml = decoded(bytes)?;
    let document = parse_xml(&xml)?;
    let root = document.root_element();
    if !root.has_tag_name("febio_spec") {
        let found = quoted(root.tag_name().name().as_bytes());
        return Err(FormatError::named("the root element", found, "`febio_spec`"));
    }
    let version = root.attribute("version").unwrap_or("");
    if !VERSIONS.contains(&version) {
        let found = quoted(version.as_bytes());
        return Err(FormatError::named("attribute version", found, VERSIONS.join(", ")));
    }
    let head = &xml.as_bytes()[..find(xml.as_bytes(), b"<Nodes", 0).unwrap_or(0)];
    let raw = RawMesh { frame: Frame::named_in(head), ..RawMesh::default() };
    let mut reader = FebioReader {
        document: &document,
        unit,
        raw,
        nodes: NumberedNodes::default(),
        digits: String::new(),
    };
    let sections =
        || root.children().filter(|node| node.has_tag_name("Geometry") || node.has_tag_name("Mesh"));
    if sections().next().is_none() {
        return Err(FormatError::named("the file", "no element Geometry or Mesh", "one with the nodes"));
    }
    for section in sections() {
        reader.read_nodes(section)?;
    }
    if let Some(number) = reader.nodes.sort() {
        return Err(FormatError::named(
            "Nodes",
            format!("node {number} twice"),
            "a number of its own for each",
        ));
    }
    for section in sections() {
        for block in section.children().filter(|node| node.has_tag_name("Elements")) {
            reader.read_elements(block)?;
        }
    }
    Ok(reader.raw)
}

/// The text of a file in UTF-8, or in ISO-8859-1 where its first line says so, as FEBio's own files do.
fn decoded(bytes: &[u8]) -> Result<Cow<'_, str>, FormatError> {
    let error = match std::str::from_utf8(bytes) {
        Ok(text) => return Ok(Cow::Borrowed(text)),
        Err(error) => error,
    };
    let declaration = &bytes[..find(bytes, b"?>", 0).unwrap_or(0)];
    if find(&declaration.to_ascii_uppercase(), b"ISO-8859-1", 0).is_some() {
        return Ok(bytes.iter().map(|&byte| char::from(byte)).collect::<String>().into());
    }
    Err(FormatError {
        place: Place::Byte(error.valid_up_to()),
        found: "bytes that are no UTF-8".into(),
        expected: "XML text in UTF-8, or in ISO-8859-1 where the first line says so".into(),
    })
}

impl FebioReader<'_, '_> {
    fn error(
        &self,
        node: Node<'_, '_>,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> FormatError {
        let line = self.document.text_pos_at(node.range().start).row as usize;
        FormatError { place: Place::Line(line), found: found.into(), expected: expected.into() }
    }

    fn number(&self, node: Node<'_, '_>) -> Result<i64, FormatError> {
        let found = node.attribute("id").unwrap_or("");
        found.trim().parse().map_err(|_| {
            self.error(node, format!("id {}", quoted(found.as_bytes())), "a whole number in attribute id")
        })
    }

    /// The words of a list with commas.
    fn words<'n, const N: usize>(
        &self,
        node: Node<'n, '_>,
        expected: &str,
    ) -> Result<[&'n str; N], FormatError> {
        let text = node.text().unwrap_or("");
        let words: Vec<&str> = text.split(',').map(str::trim).take(N + 1).collect();
        words.try_into().map_err(|_| self.error(node, quoted(text.trim().as_bytes()), expected))
    }

    fn read_nodes(&mut self, section: Node<'_, '_>) -> Result<(), FormatError> {
        if let Some(other) = section.attribute("from") {
            let found = format!("the file {} named by `from`", quoted(other.as_bytes()));
            return Err(self.error(section, found, "the nodes and elements themselves in one file"));
        }
        if let Some(part) = section.children().find(|n| n.has_tag_name("Part") || n.has_tag_name("Instance"))
        {
            let found = quoted(part.tag_name().name().as_bytes());
            return Err(self.error(part, found, "Nodes and Elements without parts and instances"));
        }
        let blocks = section.children().filter(|node| node.has_tag_name("Nodes"));
        for node in blocks.flat_map(|block| block.children()).filter(Node::is_element) {
            let number = self.number(node)?;
            let expected = "three finite coordinates, as in `1.5,0,-2`";
            let words: [&str; 3] = self.words(node, expected)?;
            let mut position_m = DVec3::ZERO;
            for (axis, word) in words.into_iter().enumerate() {
                position_m[axis] = parse_length_m(word.as_bytes(), self.unit, &mut self.digits)
                    .ok_or_else(|| self.error(node, quoted(word.as_bytes()), expected))?;
            }
            self.nodes.push(number);
            self.raw.positions_m.push(position_m);
        }
        Ok(())
    }

    fn read_elements(&mut self, block: Node<'_, '_>) -> Result<(), FormatError> {
        for element in block.children().filter(Node::is_element) {
            let name = block.attribute("type").unwrap_or(element.tag_name().name());
            let lower = name.to_ascii_lowercase();
            let kind = ELEMENT_TYPES.iter().find(|(start, _)| lower.starts_with(start));
            match kind.map(|(_, kind)| *kind) {
                Some(CellKind::Tetrahedron) => self.add_tetrahedron(element)?,
                Some(CellKind::Flat(name)) => self.raw.skip(name, 1),
                Some(CellKind::Volume(name)) => {
                    return Err(refused_volume(format!("element {}", self.number(element)?), name));
                }
                None => {
                    let found = format!("unknown element type {}", quoted(name.as_bytes()));
                    return Err(self.error(element, found, "tetrahedra (type tet4)"));
                }
            }
        }
        Ok(())
    }

    fn add_tetrahedron(&mut self, element: Node<'_, '_>) -> Result<(), FormatError> {
        let number = self.number(element)?;
        let expected = "the numbers of four nodes, as in `1,2,3,4`";
        let words: [&str; 4] = self.words(element, expected)?;
        let mut numbers = [0; 4];
        for (number, word) in numbers.iter_mut().zip(words) {
            *number = word.parse().map_err(|_| self.error(element, quoted(word.as_bytes()), expected))?;
        }
        let name = || format!("element {number}");
        let places = self.nodes.places(numbers, name, "Nodes")?;
        let n_nodes = self.raw.positions_m.len();
        self.raw.add_tetrahedron(places, 0, n_nodes, name)
    }
}
