//! glTF files: indices of every width, transforms, frames, exact error places, and bytes that no program wrote.

use std::path::Path;

use glisson_mesh::math::DVec3;
use glisson_mesh::surface::TriMesh;
use glisson_mesh::surface::files::{FileKind, SurfaceFileError, parse_surface, read_surface, write_surface};
use proptest::prelude::*;
use serde_json::{Value, json};

use crate::mesh_file_samples::base64;
use crate::surfaces::{cube, torus};

const CORNERS: [u32; 12] = [0, 2, 1, 0, 1, 3, 1, 2, 3, 0, 3, 2];

/// Corners of a tetrahedron [m, axes of glTF].
const POINTS: [[f32; 3]; 4] = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// The points, its corners in 8, 16 and 32 bits, each point of each corner with four bytes more.
fn data() -> Vec<u8> {
    let mut data: Vec<u8> = POINTS.as_flattened().iter().flat_map(|x| x.to_le_bytes()).collect();
    data.extend(CORNERS.map(|c| c as u8));
    data.extend(CORNERS.iter().flat_map(|&c| (c as u16).to_le_bytes()));
    data.extend(CORNERS.iter().flat_map(|c| c.to_le_bytes()));
    for corner in CORNERS {
        data.extend(POINTS[corner as usize].iter().flat_map(|x| x.to_le_bytes()));
        data.extend([0xff; 4]);
    }
    data
}

/// Node 0 moves its child 1 by (1, 2, 3); that one turns a quarter about z and doubles the mesh.
fn sample() -> Value {
    let half = 0.5f64.sqrt();
    let data = data();
    json!({
        "asset": { "version": "2.0" },
        "scene": 0,
        "scenes": [{ "nodes": [0] }, { "nodes": [2] }],
        "nodes": [
            { "children": [1], "translation": [1, 2, 3] },
            { "mesh": 0, "rotation": [0, 0, half, half], "scale": [2, 2, 2] },
            { "mesh": 1 },
        ],
        "meshes": [
            { "primitives": [{ "attributes": { "POSITION": 0, "NORMAL": 99 }, "indices": 3 }] },
            { "primitives": [
                { "attributes": { "POSITION": 4 }, "mode": 4 },
                { "attributes": { "POSITION": 0 }, "mode": 0 },
            ] },
        ],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3" },
            { "bufferView": 1, "byteOffset": 0, "componentType": 5121, "count": 12, "type": "SCALAR" },
            { "bufferView": 1, "byteOffset": 12, "componentType": 5123, "count": 12, "type": "SCALAR" },
            { "bufferView": 2, "componentType": 5125, "count": 12, "type": "SCALAR" },
            { "bufferView": 3, "componentType": 5126, "count": 12, "type": "VEC3" },
        ],
        "bufferViews": [
            { "buffer": 0, "byteLength": 48 },
            { "buffer": 0, "byteOffset": 48, "byteLength": 36 },
            { "buffer": 0, "byteOffset": 84, "byteLength": 48 },
            { "buffer": 0, "byteOffset": 132, "byteLength": 192, "byteStride": 16 },
        ],
        "buffers": [{
            "byteLength": data.len(),
            "uri": format!("data:application/gltf-buffer;base64,{}", base64(&data)),
        }],
    })
}

fn parse(bytes: impl AsRef<[u8]>) -> Result<TriMesh, SurfaceFileError> {
    parse_surface(Path::new("test"), bytes.as_ref(), FileKind::Gltf)
}

fn read(value: &Value) -> TriMesh {
    parse(value.to_string()).unwrap()
}

/// `sample()` with the entry at a JSON pointer set.
fn with(pointer: &str, value: Value) -> Value {
    let mut sample = sample();
    let (object, key) = pointer.rsplit_once('/').unwrap();
    let object = sample.pointer_mut(object).unwrap();
    match key.parse::<usize>() {
        Ok(index) if object.is_array() => object[index] = value,
        _ => object[key] = value,
    }
    sample
}

/// A binary file of chunks.
fn glb(chunks: &[(&[u8; 4], &[u8])]) -> Vec<u8> {
    let total = 12 + chunks.iter().map(|(_, content)| 8 + content.len()).sum::<usize>();
    let mut bytes = b"glTF\x02\0\0\0".to_vec();
    bytes.extend((total as u32).to_le_bytes());
    for (kind, content) in chunks {
        bytes.extend((content.len() as u32).to_le_bytes());
        bytes.extend(*kind);
        bytes.extend(*content);
    }
    bytes
}

fn binary_sample() -> Vec<u8> {
    let mut sample = sample();
    sample["buffers"][0].as_object_mut().unwrap().remove("uri");
    glb(&[(b"JSON", sample.to_string().as_bytes()), (b"BIN\0", &data())])
}

fn assert_near(found: DVec3, expected: [f64; 3]) {
    assert!(found.distance(DVec3::from_array(expected)) < 1e-12, "{found} {expected:?}");
}

/// The point (x, y, z) of glTF is (x, -z, y) in LPS, after the transforms of the node and its parent.
#[test]
fn nodes_are_moved_and_axes_turned() {
    let mesh = read(&sample());
    let expected = [[1.0, -3.0, 2.0], [1.0, -3.0, 4.0], [-1.0, -3.0, 2.0], [1.0, -5.0, 2.0]];
    for (p, expected) in mesh.positions_m.iter().zip(expected) {
        assert_near(*p, expected);
    }
    assert_eq!(mesh.triangles.as_flattened(), CORNERS);
    assert!((mesh.volume_m3() - 8.0 / 6.0).abs() < 1e-12);
    assert_eq!(parse(binary_sample()).unwrap(), mesh);

    let matrix = json!({ "mesh": 0, "matrix": [0, 2, 0, 0, -2, 0, 0, 0, 0, 0, 2, 0, 0, 0, 0, 1] });
    for (p, expected) in read(&with("/nodes/1", matrix)).positions_m.iter().zip(expected) {
        assert_near(*p, expected);
    }
    // A mirrored tetrahedron is turned over and so stays the right way round.
    let mirrored = read(&with("/nodes/1/scale", json!([-2, 2, 2])));
    assert!((mirrored.volume_m3() - 8.0 / 6.0).abs() < 1e-12);
    assert_eq!(mirrored.triangles[0], [0, 1, 2]);
    // Right and anterior, as the file says.
    let ras = read(&with("/asset/extras", json!({ "frame": "RAS" })));
    assert_near(ras.positions_m[3], [-1.0, 5.0, 2.0]);
}

#[test]
fn indices_of_every_width_and_none_give_the_same_triangles() {
    for indices in [1, 2, 3] {
        let mesh = read(&with("/meshes/0/primitives/0/indices", json!(indices)));
        assert_eq!(mesh.triangles.as_flattened(), CORNERS);
    }
    // Points four bytes apart, one for each corner: equal ones become one. The cloud of points beside it is passed over.
    let mesh = read(&with("/scene", json!(1)));
    assert_eq!(mesh.positions_m.len(), 4);
    assert!((mesh.volume_m3() - 1.0 / 6.0).abs() < 1e-12);
    // Without scenes all nodes that are no node's children are shown.
    let mut whole = sample();
    whole.as_object_mut().unwrap().remove("scenes");
    assert_eq!(read(&whole).triangles.len(), 8);
}

#[test]
fn files_are_written_as_the_standard_asks_for() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = TriMesh {
        positions_m: vec![
            DVec3::new(0.25, -0.5, 1.5),
            DVec3::new(0.0, 0.125, 0.0),
            DVec3::new(1.0, 0.0, 0.0),
        ],
        triangles: vec![[0, 1, 2]],
    };
    let (binary, text) = (folder.path().join("a.glb"), folder.path().join("a.GLTF"));
    write_surface(&binary, &mesh).unwrap();
    write_surface(&text, &mesh).unwrap();
    // These numbers have so few digits that nothing is lost.
    assert_eq!(read_surface(&binary).unwrap(), mesh);
    assert_eq!(read_surface(&text).unwrap(), mesh);
    let json: Value = serde_json::from_slice(&std::fs::read(&text).unwrap()).unwrap();
    assert_eq!(json["asset"]["extras"]["frame"], "LPS");
    assert_eq!(json["asset"]["extras"]["axes"], "x left, y superior, z anterior");
    assert_eq!(json["accessors"][0]["min"], json!([0.0, 0.0, -0.125]));
    assert_eq!(json["accessors"][0]["max"], json!([1.0, 1.5, 0.5]));
    assert_eq!(
        json["bufferViews"][1],
        json!({ "buffer": 0, "byteOffset": 36, "byteLength": 12, "target": 34963 })
    );
    let bytes = std::fs::read(&binary).unwrap();
    assert_eq!(bytes.len() % 4, 0);
    assert_eq!(bytes[8..12], (bytes.len() as u32).to_le_bytes());
    assert_eq!(bytes[bytes.len() - 12..], [0, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0]);

    let empty = write_surface(&binary, &TriMesh::default()).unwrap_err().to_string();
    assert!(empty.contains("no empty surface"), "{empty}");
    let infinite = TriMesh { positions_m: vec![DVec3::splat(1e300); 3], ..mesh };
    let message = write_surface(&binary, &infinite).unwrap_err().to_string();
    assert!(message.contains("finite positions of 32 bits"), "{message}");
    assert_eq!(std::fs::read(&binary).unwrap(), bytes, "the old file is untouched");
}

fn assert_tells(bytes: impl AsRef<[u8]>, expected: &str) {
    let message = parse(bytes).unwrap_err().to_string();
    assert!(message.contains(expected), "{message}\n  should contain: {expected}");
}

#[test]
fn mistakes_of_descriptions_are_named() {
    let long = json!([0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 2]);
    for (pointer, value, expected) in [
        ("/asset/version", json!("1.0"), "test, asset: found version `1.0`, expected 2.0"),
        (
            "/asset/extras",
            json!({ "frame": "XYZ" }),
            "asset.extras.frame: found `\\\"XYZ\\\"`, expected LPS or RAS",
        ),
        (
            "/extensionsRequired",
            json!(["KHR_draco_mesh_compression"]),
            "found `KHR_draco_mesh_compression`, expected a file that",
        ),
        (
            "/buffers/0/uri",
            json!("liver.bin"),
            "buffers[0]: found the file `liver.bin`, expected the data in the same file: export as .glb",
        ),
        (
            "/buffers/0/uri",
            json!("data:text/plain,abc"),
            "buffers[0]: found `data:text/plain,abc`, expected `data:...;base64,`",
        ),
        (
            "/buffers/0/uri",
            json!(null),
            "buffers[0]: found no data, expected a uri with the data, or the BIN chunk",
        ),
        ("/buffers/0/byteLength", json!(9999999999u64), "9999999999 bytes in base64"),
        (
            "/bufferViews/0/byteLength",
            json!(400),
            "bufferViews[0]: found 400 bytes from byte 0 of buffers[0], expected a part of its 324",
        ),
        ("/bufferViews/0/buffer", json!(7), "bufferViews[0]: found 48 bytes from byte 0 of buffers[7]"),
        (
            "/bufferViews/0/byteOffset",
            json!(u64::MAX),
            "bufferViews[0]: found 48 bytes from byte 18446744073709551615",
        ),
        ("/bufferViews/0/byteStride", json!(8), "accessors[0]: found byteStride 8, expected at least 12"),
        (
            "/accessors/0/count",
            json!(5),
            "accessors[0]: found 5 values of 12 bytes, 12 apart, from byte 0, expected a part of the 48",
        ),
        ("/accessors/0/count", json!(u64::MAX), "accessors[0]: found 18446744073709551615 values"),
        ("/accessors/0/count", json!(-1), "accessors[0].count: found `-1`, expected a whole number from 0"),
        ("/accessors/0/type", json!("VEC2"), "accessors[0]: found `VEC2`, expected VEC3"),
        (
            "/accessors/0/componentType",
            json!(5122),
            "accessors[0]: found componentType 5122, expected 5126 (F32)",
        ),
        ("/accessors/0/sparse", json!({}), "accessors[0]: found sparse values"),
        ("/accessors/0/bufferView", json!(null), "accessors[0]: found no bufferView"),
        (
            "/accessors/3/count",
            json!(11),
            "meshes[0].primitives[0]: found 11 corners, expected three for each triangle",
        ),
        (
            "/accessors/0/count",
            json!(3),
            "meshes[0].primitives[0], triangle 1: found 3, expected vertex numbers below 3",
        ),
        (
            "/meshes/0/primitives/0/mode",
            json!(5),
            "meshes[0].primitives[0]: found mode 5, expected triangles (mode 4)",
        ),
        (
            "/meshes/0/primitives/0/indices",
            json!(9),
            "accessors: found no entry 9, expected one of the 5 in the file",
        ),
        (
            "/meshes/0/primitives/0/attributes",
            json!({}),
            "meshes[0].primitives[0].attributes: found no POSITION",
        ),
        ("/nodes/1/mesh", json!(4), "meshes: found no entry 4, expected one of the 2 in the file"),
        ("/nodes/1/skin", json!(0), "nodes[1]: found a mesh that a skin bends"),
        ("/nodes/1/children", json!([0]), "nodes[0]: found the node twice in the scene, expected a tree"),
        (
            "/nodes/1/children",
            json!(["a"]),
            "nodes[1].children: found `\\\"a\\\"`, expected numbers of nodes",
        ),
        ("/nodes/1/scale", json!([1, 2]), "nodes[1].scale: found `[1,2]`, expected 3 numbers"),
        ("/nodes/1/scale", json!([1e300, 1, 1]), "meshes[0].primitives[0]: found vertex 1 at"),
        (
            "/nodes/1/rotation",
            json!([0, 0, 0, 0]),
            "nodes[1].rotation: found a quaternion of length 0, expected length 1",
        ),
        ("/nodes/1/matrix", long, "nodes[1].matrix: found the last row 0 0 0 2, expected 0 0 0 1"),
        ("/scenes/0/nodes", json!([8]), "nodes: found no entry 8"),
        ("/scene", json!(3), "scenes: found no entry 3"),
        ("/scenes/0/nodes", json!([]), "the surface has no triangle"),
    ] {
        assert_tells(with(pointer, value).to_string(), expected);
    }
    assert_tells("{\n\"asset\": }", "test, line 2: found expected value");
}

#[test]
fn mistakes_of_binary_files_are_named() {
    let whole = binary_sample();
    let json_length = u32::from_le_bytes(whole[12..16].try_into().unwrap()) as usize;
    let changed = |at: usize, value: u8| {
        let mut bytes = whole.clone();
        bytes[at] = value;
        bytes
    };
    let (n, less) = (whole.len(), whole.len() - 1);
    assert_tells(changed(4, 1), "test, byte 4: found version 1, expected 2: export as glTF 2.0");
    assert_tells(&whole[..less], &format!("byte 8: found {less} bytes, expected {n}, as the header says"));
    assert_tells(&whole[..10], "byte 8: found the end of the file");
    assert_tells(changed(16, b'X'), "byte 16: found a chunk of type 0x4e4f5358, expected the JSON chunk");
    assert_tells(changed(15, 0xff), "byte 12: found");
    let at = 20 + json_length + 4;
    assert_tells(
        changed(at, b'X'),
        &format!("byte {at}: found a chunk of type 0x4e4958, expected the BIN chunk"),
    );
    let mut sample = sample();
    sample["buffers"] = json!([{ "byteLength": 400 }]);
    let short = glb(&[(b"JSON", sample.to_string().as_bytes()), (b"BIN\0", &data())]);
    assert_tells(short, "buffers[0]: found 400 bytes, expected at most the 324 of the BIN chunk");
}

/// Each node shows the whole mesh: what is read is bounded all the same.
#[test]
fn meshes_that_are_shown_again_and_again_have_an_end() {
    let mut sample = sample();
    let n = 3000;
    let data = vec![0; 12 * n];
    sample["nodes"] = (0..1000).map(|_| json!({ "mesh": 0 })).collect();
    sample["scenes"] = json!([{ "nodes": (0..1000).collect::<Vec<_>>() }]);
    sample["meshes"] = json!([{ "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1 }] }]);
    sample["accessors"] = json!([
        { "bufferView": 0, "componentType": 5126, "count": n, "type": "VEC3" },
        { "bufferView": 0, "componentType": 5125, "count": 3, "type": "SCALAR" },
    ]);
    sample["bufferViews"] = json!([{ "buffer": 0, "byteLength": data.len() }]);
    sample["buffers"] = json!([{ "byteLength": data.len() }]);
    let bytes = glb(&[(b"JSON", sample.to_string().as_bytes()), (b"BIN\0", &data)]);
    assert_tells(bytes, ": show each mesh once");
}

#[test]
fn surfaces_survive_both_kinds_of_file() {
    let folder = tempfile::tempdir().unwrap();
    for mesh in [cube(), torus(0.03, 0.01, 17, 9)] {
        for name in ["a.glb", "a.gltf"] {
            let path = folder.path().join(name);
            write_surface(&path, &mesh).unwrap();
            let back = read_surface(&path).unwrap();
            assert_eq!(back.triangles, mesh.triangles);
            for (a, b) in back.positions_m.iter().zip(&mesh.positions_m) {
                // What 32 bits hold, exactly.
                assert_eq!(a.to_array(), b.to_array().map(|x| f64::from(x as f32)));
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn changed_descriptions_never_panic(
        is_binary in any::<bool>(),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<prop::sample::Index>(), 0u8..4), 1..6),
        cut in prop::option::of(any::<prop::sample::Index>()),
    ) {
        const BYTES: &[u8] = b"0123456789-.,:\"[]{}e ";
        let mut bytes = if is_binary { binary_sample() } else { sample().to_string().into_bytes() };
        for (at, value, action) in changes {
            let (at, value) = (at.index(bytes.len()), BYTES[value.index(BYTES.len())]);
            match action {
                0 => bytes.insert(at, value),
                1 => { bytes.remove(at); }
                2 => bytes[at] ^= value,
                _ => bytes[at] = value,
            }
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        if is_binary && bytes.len() >= 16 {
            // The lengths fit again, so that what is behind them is looked at.
            let total = bytes.len() as u32;
            bytes[8..12].copy_from_slice(&total.to_le_bytes());
        }
        if let Ok(mesh) = parse(&bytes) {
            let n = mesh.positions_m.len();
            prop_assert!(mesh.triangles.as_flattened().iter().all(|&v| (v as usize) < n));
            prop_assert!(mesh.positions_m.iter().all(|p| p.is_finite()));
        }
    }
}
