//! glTF 2.0 (`.glb`, and `.gltf` with its data inside): the triangles of the scene's nodes; normals, materials and all
//! else are passed over.
//!
//! Source: glTF 2.0 Specification (Khronos Group, ISO/IEC 12113:2022). Lengths are metres, +Y is up and +Z forward. A
//! point (x, y, z) in LPS is (x, z, -y) there: a quarter turn about x, after which a standing patient has the head up, looks
//! along +Z and has the left hand at +X. `asset.extras.frame` says `LPS` of it, or `RAS` if the axes that were turned are
//! those; a file without it is read as LPS. A node's transform applies to its children too; one that mirrors turns its
//! triangles over, as the standard asks for.

use std::borrow::Cow;

use serde_json::Value;

use super::cursor::{Cursor, is_usable};
use super::weld::Welded;
use super::{RawSurface, Space, SurfaceFileError};
use crate::base64::Base64Reader;
use crate::binary::{ByteOrder, NumberType};
use crate::math::{DMat3, DQuat, DVec3};
use crate::scan::{FormatError, Place, quoted};
use crate::units::LengthUnit;

/// `glTF` in a word.
pub(super) const MAGIC: u32 = 0x4654_6C67;
pub(super) const VERSION: u32 = 2;
/// `JSON` in a word.
pub(super) const JSON_CHUNK: u32 = 0x4E4F_534A;
/// `BIN` and a zero byte in a word.
pub(super) const BINARY_CHUNK: u32 = 0x004E_4942;
/// Mode of a primitive.
pub(super) const TRIANGLES: u64 = 4;
/// Component types, in OpenGL's numbers.
pub(super) const F32: u64 = 5126;
pub(super) const U32: u64 = 5125;
const U16: u64 = 5123;
const U8: u64 = 5121;

/// Extensions that a file may require since they say nothing about the shape; the beginnings of their names.
const HARMLESS_EXTENSIONS: [&str; 4] =
    ["KHR_materials_", "KHR_texture_", "KHR_lights_punctual", "EXT_texture_"];

/// Most vertices and corners that are read for each byte of the file: nodes may show the same mesh again and again. A file
/// that shows each once has less than one.
const MOST_READ_A_BYTE: usize = 32;

/// A point of the patient in the axes of glTF.
pub(super) fn gltf_from_lps(p: DVec3) -> DVec3 {
    DVec3::new(p.x, p.z, -p.y)
}

fn lps_from_gltf(p: DVec3) -> DVec3 {
    DVec3::new(p.x, -p.z, p.y)
}

pub(super) fn parse(cursor: &Cursor<'_>) -> Result<RawSurface, SurfaceFileError> {
    read(cursor.all()).map_err(|error| cursor.content_error(error))
}

fn read(bytes: &[u8]) -> Result<RawSurface, FormatError> {
    let (json, chunk) = if bytes.starts_with(b"glTF") { chunks(bytes)? } else { (bytes, None) };
    let json: Value = serde_json::from_slice(json).map_err(|error| FormatError {
        place: Place::Line(error.line()),
        found: error.to_string(),
        expected: "a JSON document, or a binary file that begins with `glTF`".into(),
    })?;
    let space = checked_asset(&json)?;
    let file = GltfFile { json: &json, buffers: buffers(&json, chunk)? };
    let mut reader = GltfReader {
        file: &file,
        welded: Welded::default(),
        triangles: Vec::new(),
        n_read: 0,
        most_read: bytes.len().saturating_mul(MOST_READ_A_BYTE),
    };
    reader.read_scene()?;
    Ok(RawSurface {
        positions: reader.welded.positions,
        triangles: reader.triangles,
        space,
        unit: Some(LengthUnit::Metre),
    })
}

/// The JSON of a binary file, and its data if there are any.
fn chunks(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), FormatError> {
    let at = |place: usize, found: String, expected: &str| FormatError {
        place: Place::Byte(place),
        found,
        expected: expected.into(),
    };
    let word = |place: usize| {
        let bytes = bytes.get(place..place + 4).ok_or_else(|| {
            at(place, "the end of the file".into(), "a header and a chunk of JSON: the file is cut off")
        })?;
        Ok(u32::from_le_bytes(bytes.try_into().expect("four bytes")))
    };
    let (version, total) = (word(4)?, word(8)?);
    if version != VERSION {
        return Err(at(4, format!("version {version}"), "2: export as glTF 2.0"));
    }
    if total as usize != bytes.len() {
        let expected = format!("{total}, as the header says: the file is cut off or has more behind it");
        return Err(at(8, format!("{} bytes", bytes.len()), &expected));
    }
    let chunk = |place: usize, kind: u32, expected: &str| {
        let (length, found) = (word(place)?, word(place + 4)?);
        if found != kind {
            return Err(at(place + 4, format!("a chunk of type {found:#x}"), expected));
        }
        let content = bytes[place + 8..].get(..length as usize);
        content.ok_or_else(|| {
            let found = format!("{} bytes left", bytes.len() - place - 8);
            at(place, found, &format!("the {length} bytes of the chunk"))
        })
    };
    let json = chunk(12, JSON_CHUNK, "the JSON chunk")?;
    let next = 20 + json.len();
    let data = if next < bytes.len() { Some(chunk(next, BINARY_CHUNK, "the BIN chunk")?) } else { None };
    Ok((json, data))
}

/// The frame of a file whose version and extensions are understood.
fn checked_asset(json: &Value) -> Result<Space, FormatError> {
    let asset = &json["asset"];
    let version = asset["version"].as_str().unwrap_or("");
    if !version.starts_with("2.") {
        let found = format!("version {}", quoted(version.as_bytes()));
        return Err(FormatError::named("asset", found, "2.0: export as glTF 2.0"));
    }
    for name in list(json, "extensionsRequired").iter().filter_map(Value::as_str) {
        if !HARMLESS_EXTENSIONS.iter().any(|start| name.starts_with(start)) {
            let found = quoted(name.as_bytes());
            let expected = "a file that does without: export without compression or quantization";
            return Err(FormatError::named("extensionsRequired", found, expected));
        }
    }
    match &asset["extras"]["frame"] {
        Value::Null => Ok(Space::Lps),
        Value::String(name) if name == "LPS" => Ok(Space::Lps),
        Value::String(name) if name == "RAS" => Ok(Space::Ras),
        other => {
            Err(FormatError::named("asset.extras.frame", quoted(other.to_string().as_bytes()), "LPS or RAS"))
        }
    }
}

/// The data of every buffer.
fn buffers<'a>(json: &'a Value, chunk: Option<&'a [u8]>) -> Result<Vec<Cow<'a, [u8]>>, FormatError> {
    let mut buffers = Vec::new();
    for (b, buffer) in list(json, "buffers").iter().enumerate() {
        let place = format!("buffers[{b}]");
        let length = needed(buffer, "byteLength", &place)?;
        let data = match (buffer["uri"].as_str(), chunk) {
            (None, Some(chunk)) if b == 0 => chunk.get(..length).map(Cow::Borrowed).ok_or_else(|| {
                let found = format!("{length} bytes");
                FormatError::named(&place, found, format!("at most the {} of the BIN chunk", chunk.len()))
            })?,
            (None, _) => {
                return Err(FormatError::named(
                    place,
                    "no data",
                    "a uri with the data, or the BIN chunk of a .glb",
                ));
            }
            (Some(uri), _) => embedded(uri, length, &place)?.into(),
        };
        buffers.push(data);
    }
    Ok(buffers)
}

/// The data in a `data:` address.
fn embedded(uri: &str, length: usize, place: &str) -> Result<Vec<u8>, FormatError> {
    let Some(content) = uri.strip_prefix("data:") else {
        let found = format!("the file {}", quoted(uri.as_bytes()));
        let expected = "the data in the same file: export as .glb, or as .gltf with embedded buffers";
        return Err(FormatError::named(place, found, expected));
    };
    let encoded = content.split_once(',').filter(|(head, _)| head.ends_with(";base64"));
    let data = encoded.and_then(|(_, text)| Base64Reader::new(text.as_bytes()).read(length));
    data.ok_or_else(|| {
        FormatError::named(
            place,
            quoted(uri.as_bytes()),
            format!("`data:...;base64,` and {length} bytes in base64"),
        )
    })
}

/// The entries of a list; none if there is no list.
fn list<'v>(object: &'v Value, key: &str) -> &'v [Value] {
    object[key].as_array().map_or(&[], Vec::as_slice)
}

/// A whole number from 0, if the key is there.
fn optional(object: &Value, key: &str, place: &str) -> Result<Option<usize>, FormatError> {
    match &object[key] {
        Value::Null => Ok(None),
        value => value.as_u64().and_then(|n| usize::try_from(n).ok()).map(Some).ok_or_else(|| {
            let found = quoted(value.to_string().as_bytes());
            FormatError::named(format!("{place}.{key}"), found, "a whole number from 0")
        }),
    }
}

fn needed(object: &Value, key: &str, place: &str) -> Result<usize, FormatError> {
    optional(object, key, place)?
        .ok_or_else(|| FormatError::named(place, format!("no {key}"), "a whole number from 0"))
}

/// So many numbers, if the key is there.
fn numbers<const N: usize>(object: &Value, key: &str, place: &str) -> Result<Option<[f64; N]>, FormatError> {
    let value = &object[key];
    if value.is_null() {
        return Ok(None);
    }
    let numbers: Option<Vec<f64>> =
        value.as_array().and_then(|list| list.iter().map(Value::as_f64).collect());
    numbers.and_then(|list| list.try_into().ok()).map(Some).ok_or_else(|| {
        let found = quoted(value.to_string().as_bytes());
        FormatError::named(format!("{place}.{key}"), found, format!("{N} numbers"))
    })
}

/// Where a node's points are: `linear * p + shift_m`.
#[derive(Clone, Copy)]
struct Affine {
    linear: DMat3,
    shift_m: DVec3,
}

impl Affine {
    /// The transform of a node with respect to its parent.
    fn of_node(node: &Value, place: &str) -> Result<Self, FormatError> {
        if let Some(m) = numbers::<16>(node, "matrix", place)? {
            if [m[3], m[7], m[11], m[15]] != [0.0, 0.0, 0.0, 1.0] {
                let found = format!("the last row {} {} {} {}", m[3], m[7], m[11], m[15]);
                return Err(FormatError::named(format!("{place}.matrix"), found, "0 0 0 1"));
            }
            let column = |n: usize| DVec3::from_slice(&m[4 * n..]);
            let linear = DMat3::from_cols(column(0), column(1), column(2));
            return Ok(Self { linear, shift_m: column(3) });
        }
        let shift_m = numbers(node, "translation", place)?.map_or(DVec3::ZERO, DVec3::from_array);
        let rotation = numbers(node, "rotation", place)?.map_or(DQuat::IDENTITY, DQuat::from_array);
        let scale = numbers(node, "scale", place)?.map_or(DVec3::ONE, DVec3::from_array);
        let length = rotation.length();
        // A unit quaternion by the standard; what exporters round is far nearer than this.
        if !(0.9..=1.1).contains(&length) {
            let found = format!("a quaternion of length {length}");
            return Err(FormatError::named(format!("{place}.rotation"), found, "length 1"));
        }
        let linear = DMat3::from_quat(rotation.normalize()) * DMat3::from_diagonal(scale);
        Ok(Self { linear, shift_m })
    }

    /// The transform of what is in `inner` of what is in this.
    fn after(self, inner: Self) -> Self {
        Self { linear: self.linear * inner.linear, shift_m: self.apply(inner.shift_m) }
    }

    fn apply(self, p: DVec3) -> DVec3 {
        self.linear * p + self.shift_m
    }
}

/// The values of an accessor: little-endian numbers of one kind.
struct Values<'b> {
    data: &'b [u8],
    /// Bytes from one value to the next.
    stride: usize,
    count: usize,
    kind: NumberType,
}

impl Values<'_> {
    /// Component `component` of value `n`.
    fn component(&self, n: usize, component: usize) -> &[u8] {
        let start = n * self.stride + component * self.kind.n_bytes();
        &self.data[start..start + self.kind.n_bytes()]
    }

    fn point(&self, n: usize) -> DVec3 {
        DVec3::from_array([0, 1, 2].map(|axis| self.kind.float(self.component(n, axis), ByteOrder::Little)))
    }

    fn index(&self, n: usize) -> usize {
        let index = self.kind.integer(self.component(n, 0), ByteOrder::Little);
        index.expect("indices have at most 32 bits") as usize
    }
}

/// The description of a file, and its data.
struct GltfFile<'a> {
    json: &'a Value,
    buffers: Vec<Cow<'a, [u8]>>,
}

impl<'a> GltfFile<'a> {
    /// The entry `number` of one of the file's lists.
    fn entry(&self, key: &str, number: usize) -> Result<&'a Value, FormatError> {
        let entries = list(self.json, key);
        entries.get(number).ok_or_else(|| {
            FormatError::named(
                key,
                format!("no entry {number}"),
                format!("one of the {} in the file", entries.len()),
            )
        })
    }

    /// The nodes of the scene that is shown, or, without scenes, those that are no node's children.
    fn roots(&self) -> Result<Vec<usize>, FormatError> {
        if list(self.json, "scenes").is_empty() {
            let nodes = list(self.json, "nodes");
            let mut is_child = vec![false; nodes.len()];
            for (n, node) in nodes.iter().enumerate() {
                for child in node_numbers(node, "children", &format!("nodes[{n}]"))? {
                    if let Some(is_child) = is_child.get_mut(child) {
                        *is_child = true;
                    }
                }
            }
            return Ok((0..nodes.len()).filter(|&n| !is_child[n]).collect());
        }
        let scene = optional(self.json, "scene", "the file")?.unwrap_or(0);
        node_numbers(self.entry("scenes", scene)?, "nodes", &format!("scenes[{scene}]"))
    }

    /// The values of accessor `number`, which are of a shape and of one of a few component types.
    fn values(
        &self,
        number: usize,
        shape: &str,
        kinds: &[(u64, NumberType)],
    ) -> Result<Values<'_>, FormatError> {
        let place = format!("accessors[{number}]");
        let accessor = self.entry("accessors", number)?;
        let wrong = |found: String, expected: &str| Err(FormatError::named(&place, found, expected));
        let found = accessor["type"].as_str().unwrap_or("no type");
        if found != shape {
            return wrong(quoted(found.as_bytes()), shape);
        }
        let component_type = needed(accessor, "componentType", &place)? as u64;
        let Some(&(_, kind)) = kinds.iter().find(|(number, _)| *number == component_type) else {
            let allowed: Vec<String> =
                kinds.iter().map(|(number, kind)| format!("{number} ({kind:?})")).collect();
            return wrong(format!("componentType {component_type}"), &allowed.join(", "));
        };
        if !accessor["sparse"].is_null() {
            return wrong(
                "sparse values".into(),
                "all values one behind the other: export without sparse accessors",
            );
        }
        let count = needed(accessor, "count", &place)?;
        let view_number = needed(accessor, "bufferView", &place)?;
        let view = self.entry("bufferViews", view_number)?;
        let view_place = format!("bufferViews[{view_number}]");
        let buffer_number = needed(view, "buffer", &view_place)?;
        let start = optional(view, "byteOffset", &view_place)?.unwrap_or(0);
        let length = needed(view, "byteLength", &view_place)?;
        let buffer = self.buffers.get(buffer_number).map_or(&[][..], |buffer| buffer);
        let Some(data) = start.checked_add(length).and_then(|end| buffer.get(start..end)) else {
            let found = format!("{length} bytes from byte {start} of buffers[{buffer_number}]");
            return Err(FormatError::named(
                view_place,
                found,
                format!("a part of its {} bytes", buffer.len()),
            ));
        };
        let size = kind.n_bytes() * if shape == "VEC3" { 3 } else { 1 };
        let stride = optional(view, "byteStride", &view_place)?.unwrap_or(size);
        if stride < size {
            return wrong(format!("byteStride {stride}"), &format!("at least {size}, the size of a value"));
        }
        let start = optional(accessor, "byteOffset", &place)?.unwrap_or(0);
        let span = match count {
            0 => Some(0),
            _ => (count - 1).checked_mul(stride).and_then(|before| before.checked_add(size)),
        };
        let end = span.and_then(|span| start.checked_add(span));
        match end.and_then(|end| data.get(start..end)) {
            Some(data) => Ok(Values { data, stride, count, kind }),
            None => wrong(
                format!("{count} values of {size} bytes, {stride} apart, from byte {start}"),
                &format!("a part of the {length} bytes of {view_place}"),
            ),
        }
    }
}

struct GltfReader<'a> {
    file: &'a GltfFile<'a>,
    welded: Welded,
    triangles: Vec<[u32; 3]>,
    /// Vertices and corners so far.
    n_read: usize,
    most_read: usize,
}

impl GltfReader<'_> {
    fn read_scene(&mut self) -> Result<(), FormatError> {
        let identity = Affine { linear: DMat3::IDENTITY, shift_m: DVec3::ZERO };
        let mut open: Vec<(usize, Affine)> =
            self.file.roots()?.into_iter().rev().map(|n| (n, identity)).collect();
        let mut is_seen = vec![false; list(self.file.json, "nodes").len()];
        while let Some((number, parent)) = open.pop() {
            let place = format!("nodes[{number}]");
            let node = self.file.entry("nodes", number)?;
            if std::mem::replace(&mut is_seen[number], true) {
                return Err(FormatError::named(place, "the node twice in the scene", "a tree of nodes"));
            }
            let here = parent.after(Affine::of_node(node, &place)?);
            if let Some(mesh) = optional(node, "mesh", &place)? {
                if !node["skin"].is_null() {
                    let expected = "a shape that stands still: export with the pose applied";
                    return Err(FormatError::named(place, "a mesh that a skin bends", expected));
                }
                for (p, primitive) in list(self.file.entry("meshes", mesh)?, "primitives").iter().enumerate()
                {
                    self.read_primitive(primitive, here, &format!("meshes[{mesh}].primitives[{p}]"))?;
                }
            }
            let children = node_numbers(node, "children", &place)?;
            open.extend(children.into_iter().rev().map(|child| (child, here)));
        }
        Ok(())
    }

    fn read_primitive(&mut self, primitive: &Value, here: Affine, place: &str) -> Result<(), FormatError> {
        match optional(primitive, "mode", place)?.map_or(TRIANGLES, |mode| mode as u64) {
            TRIANGLES => {}
            // Points and lines.
            0..=3 => return Ok(()),
            mode => {
                let found = format!("mode {mode}");
                return Err(FormatError::named(place, found, "triangles (mode 4) and no strips or fans"));
            }
        }
        let positions = needed(&primitive["attributes"], "POSITION", &format!("{place}.attributes"))?;
        let positions = self.file.values(positions, "VEC3", &[(F32, NumberType::F32)])?;
        let indices = match optional(primitive, "indices", place)? {
            Some(indices) => {
                let kinds = [(U32, NumberType::U32), (U16, NumberType::U16), (U8, NumberType::U8)];
                Some(self.file.values(indices, "SCALAR", &kinds)?)
            }
            None => None,
        };
        let n_corners = indices.as_ref().map_or(positions.count, |indices| indices.count);
        if n_corners % 3 != 0 {
            return Err(FormatError::named(place, format!("{n_corners} corners"), "three for each triangle"));
        }
        let n_read = self.n_read.saturating_add(positions.count).saturating_add(n_corners);
        if n_read > self.most_read {
            let found = format!("{n_read} vertices and corners so far");
            return Err(FormatError::named(
                place,
                found,
                format!("at most {}: show each mesh once", self.most_read),
            ));
        }
        let mut vertices = Vec::with_capacity(positions.count);
        for n in 0..positions.count {
            let p = lps_from_gltf(here.apply(positions.point(n)));
            if !is_usable(p) {
                let found = format!("vertex {n} at ({}, {}, {})", p.x, p.y, p.z);
                return Err(FormatError::named(place, found, "coordinates within 1e9"));
            }
            vertices.push(self.welded.add(p));
        }
        let is_mirror = here.linear.determinant() < 0.0;
        for t in 0..n_corners / 3 {
            let mut triangle = [0; 3];
            for (c, corner) in triangle.iter_mut().enumerate() {
                let vertex = indices.as_ref().map_or(3 * t + c, |indices| indices.index(3 * t + c));
                *corner = *vertices.get(vertex).ok_or_else(|| {
                    let expected = format!("vertex numbers below {}, counted from 0", vertices.len());
                    FormatError::named(format!("{place}, triangle {t}"), vertex.to_string(), expected)
                })?;
            }
            if is_mirror {
                triangle.swap(1, 2);
            }
            self.triangles.push(triangle);
        }
        self.n_read = n_read;
        Ok(())
    }
}

/// The numbers of nodes in a list.
fn node_numbers(object: &Value, key: &str, place: &str) -> Result<Vec<usize>, FormatError> {
    list(object, key)
        .iter()
        .map(|value| {
            value.as_u64().and_then(|n| usize::try_from(n).ok()).ok_or_else(|| {
                let found = quoted(value.to_string().as_bytes());
                FormatError::named(format!("{place}.{key}"), found, "numbers of nodes")
            })
        })
        .collect()
}
