//! Writing glTF 2.0, as one binary file or as JSON with the data inside: one node, one mesh, positions of 32 bits.

use std::io::{self, Write};

use serde_json::{Value, json};

use super::gltf::{BINARY_CHUNK, F32, JSON_CHUNK, MAGIC, TRIANGLES, U32, VERSION, gltf_from_lps};
use super::{Space, Written};
use crate::base64::encode;

/// What a buffer view holds, in OpenGL's numbers.
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

fn refused(why: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, why)
}

/// The description of a file but for its buffer, and the data of the buffer.
fn content(surface: &Written<'_>) -> io::Result<(Value, Vec<u8>)> {
    let positions: Vec<[f32; 3]> = surface
        .positions_m
        .iter()
        .map(|&p| gltf_from_lps(surface.space.turned(p)).to_array().map(|x| x as f32))
        .collect();
    if positions.is_empty() || surface.triangles.is_empty() {
        return Err(refused("glTF holds no empty surface"));
    }
    if !positions.as_flattened().iter().all(|x| x.is_finite()) {
        return Err(refused("glTF holds finite positions of 32 bits alone"));
    }
    if u32::try_from(positions.len()).is_err() {
        return Err(refused("glTF counts vertices by 32 bits"));
    }
    let bound = |choose: fn(f32, f32) -> f32| {
        positions[1..]
            .iter()
            .fold(positions[0], |bound, p| [0, 1, 2].map(|axis| choose(bound[axis], p[axis])))
    };
    let axes = match surface.space {
        Space::Lps => "x left, y superior, z anterior",
        Space::Ras => "x right, y superior, z posterior",
    };
    let mut data: Vec<u8> = positions.as_flattened().iter().flat_map(|x| x.to_le_bytes()).collect();
    let n_bytes = data.len();
    data.extend(surface.triangles.as_flattened().iter().flat_map(|corner| corner.to_le_bytes()));
    let n_corners = surface.triangles.as_flattened().len();
    let document = json!({
        "asset": {
            "version": "2.0",
            "generator": "glisson",
            "extras": { "frame": surface.space.name(), "axes": axes, "unit": "m" },
        },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0, "name": "surface" }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1, "mode": TRIANGLES }] }],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": F32,
                "count": positions.len(),
                "type": "VEC3",
                "min": bound(f32::min),
                "max": bound(f32::max),
            },
            { "bufferView": 1, "componentType": U32, "count": n_corners, "type": "SCALAR" },
        ],
        "bufferViews": [
            { "buffer": 0, "byteOffset": 0, "byteLength": n_bytes, "target": ARRAY_BUFFER },
            { "buffer": 0, "byteOffset": n_bytes, "byteLength": data.len() - n_bytes, "target": ELEMENT_ARRAY_BUFFER },
        ],
    });
    Ok((document, data))
}

pub(super) fn write_json(out: &mut impl Write, surface: &Written<'_>) -> io::Result<()> {
    let (mut document, data) = content(surface)?;
    let uri = format!("data:application/octet-stream;base64,{}", encode(&data));
    document["buffers"] = json!([{ "byteLength": data.len(), "uri": uri }]);
    serde_json::to_writer_pretty(&mut *out, &document)?;
    writeln!(out)
}

pub(super) fn write_binary(out: &mut impl Write, surface: &Written<'_>) -> io::Result<()> {
    let (mut document, data) = content(surface)?;
    document["buffers"] = json!([{ "byteLength": data.len() }]);
    // The data are of four-byte numbers; the text is filled up to four bytes with blanks.
    let mut text = serde_json::to_vec(&document)?;
    text.resize(text.len().next_multiple_of(4), b' ');
    let count = |n: usize| u32::try_from(n).map_err(|_| refused("a .glb file holds at most 4 GB"));
    let total = count(12 + 8 + text.len() + 8 + data.len())?;
    for word in [MAGIC, VERSION, total, count(text.len())?, JSON_CHUNK] {
        out.write_all(&word.to_le_bytes())?;
    }
    out.write_all(&text)?;
    for word in [count(data.len())?, BINARY_CHUNK] {
        out.write_all(&word.to_le_bytes())?;
    }
    out.write_all(&data)
}
