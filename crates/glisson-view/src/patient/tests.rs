//! The page's requests over a real socket, from files to a simulation that is refused or comes.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::Path;
use std::time::Duration;

use glisson::image::files::write_label_map;
use glisson::image::{LabelMap, VoxelGrid};
use glisson::math::{DMat3, DVec3};
use glisson_runtime::{OpenScene, Simulation};
use serde_json::{Value, json};

use super::{PatientPage, serve};
use crate::server::access::Access;

/// Status and body of the answer to a request.
fn ask(address: SocketAddr, method: &str, path: &str, kind: &str, body: &[u8]) -> (u16, Vec<u8>) {
    let mut stream = TcpStream::connect(address).unwrap();
    let head = format!(
        "{method} {path} HTTP/1.1\r\nHost: {address}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
        body.len()
    );
    stream.write_all(&[head.as_bytes(), body].concat()).unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    let end = answer.windows(4).position(|w| w == b"\r\n\r\n").unwrap();
    let status = std::str::from_utf8(&answer[9..12]).unwrap().parse().unwrap();
    (status, answer[end + 4..].to_vec())
}

fn post(address: SocketAddr, step: &str, choice: &Value) -> u16 {
    let path = format!("/api/patient/{step}");
    ask(address, "POST", &path, "application/json", choice.to_string().as_bytes()).0
}

fn state(address: SocketAddr) -> Value {
    let (status, body) = ask(address, "GET", "/api/patient/state", "", b"");
    assert_eq!(status, 200);
    serde_json::from_slice(&body).unwrap()
}

/// A step that is done, and what became of it.
fn done(address: SocketAddr, step: &str, choice: &Value) -> Value {
    assert_eq!(post(address, step, choice), 202, "{step}");
    loop {
        let state = state(address);
        if state["job"].is_null() {
            return state;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// Sends a file as a new image; answers its number.
fn send(address: SocketAddr, name: &str, bytes: &[u8]) -> u64 {
    let (status, body) = ask(address, "POST", "/api/patient/files", "", b"");
    assert_eq!(status, 200);
    let upload = serde_json::from_slice::<Value>(&body).unwrap()["upload"].as_u64().unwrap();
    let path = format!("/api/patient/files/{upload}/{name}");
    assert_eq!(ask(address, "PUT", &path, "application/octet-stream", bytes).0, 204);
    upload
}

/// Folders of files that came and were not deleted.
fn n_incoming(out: &Path) -> usize {
    let entries = std::fs::read_dir(out).into_iter().flatten().flatten();
    let incoming = entries.filter(|entry| entry.file_name().to_string_lossy().starts_with("incoming"));
    incoming.map(|entry| std::fs::read_dir(entry.path()).unwrap().count()).sum()
}

/// A ball of label 5 in the middle.
fn ball(folder: &Path) -> Vec<u8> {
    let n = 40;
    let grid = VoxelGrid {
        dims: [n; 3],
        spacing_m: DVec3::splat(2e-3),
        origin_m: DVec3::ZERO,
        axes: DMat3::IDENTITY,
    };
    let middle = DVec3::splat(0.5 * (n - 1) as f64);
    let is_inside = |index: usize| grid.voxel(index).map(|i| i as f64);
    let labels = (0..grid.n_voxels())
        .map(|index| if DVec3::from(is_inside(index)).distance(middle) < 14.0 { 5 } else { 0 })
        .collect();
    let map = LabelMap { grid, labels, names: vec![(5, "liver".into())], colours: Vec::new() };
    let file = folder.join("ball.nii.gz");
    write_label_map(&file, &map).unwrap();
    std::fs::read(file).unwrap()
}

#[test]
fn files_become_a_simulation_step_by_step() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = ball(folder.path());
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    listener.set_nonblocking(true).unwrap();
    let address = listener.local_addr().unwrap();
    let out = folder.path().join("patient");
    let open = |scene: &Path| Simulation::open(OpenScene::read(scene)?, None);
    let page = PatientPage { folder: out.clone(), image: None, open: Box::new(open) };
    let access = Access::for_address(address.ip(), None).unwrap();
    let server = std::thread::spawn(move || serve(listener, access, page, std::future::pending()));

    // Nothing came, then something that is no image: each says so, and nothing of it stays.
    let words = |state: &Value| state["error"].as_str().unwrap_or_default().to_owned();
    assert!(words(&done(address, "open", &json!({}))).contains("no image"));
    assert!(words(&done(address, "open", &json!({"upload": 77}))).contains("no file came"));
    let upload = send(address, "Jane_Doe.nii.gz", b"no image");
    let refused = words(&done(address, "open", &json!({"upload": upload})));
    assert!(refused.contains("the image") && !refused.contains("Doe"), "{refused}");
    assert_eq!(n_incoming(&out), 0);
    for (step, choice, words) in [
        ("organ", json!({}), "no image"),
        ("mesh", json!({"tetrahedra": 1000}), "no organ"),
        ("start", json!({}), "no tetrahedra"),
    ] {
        assert!(done(address, step, &choice)["error"].as_str().unwrap().contains(words), "{step}");
    }
    assert_eq!(post(address, "organ", &json!({"inside": []})), 422);

    let late = send(address, "late.nii.gz", b"of an earlier image");
    let upload = send(address, "ball.nii.gz", &bytes);
    let path = format!("/api/patient/files/{late}/more");
    assert_eq!(ask(address, "PUT", &path, "application/octet-stream", b"x").0, 507);
    let opened = done(address, "open", &json!({"upload": upload}));
    assert_eq!(opened["error"], Value::Null);
    assert_eq!(opened["image"]["labels"], json!([{"label": 5, "name": "liver"}]));
    let (status, png) = ask(address, "GET", "/api/patient/slice/axial/40/40/40/2/5", "", b"");
    assert!(status == 200 && png.starts_with(b"\x89PNG"), "{status}");
    assert_eq!(ask(address, "GET", "/api/patient/slice/oblique/40/40/40/2/5", "", b"").0, 400);
    assert!(
        done(address, "organ", &json!({"label": "spleen"}))["error"].as_str().unwrap().contains("spleen")
    );
    let found = done(address, "organ", &json!({"label": "5"}));
    let volume_ml = found["organ"]["volume_ml"].as_f64().unwrap();
    assert!((volume_ml / 91.95 - 1.0).abs() < 0.01, "{volume_ml}");
    assert!(done(address, "mesh", &json!({"tetrahedra": 3}))["error"].as_str().unwrap().contains("allowed"));
    let filled = done(address, "mesh", &json!({"tetrahedra": 1500}));
    assert!(filled["mesh"]["dihedral_deg"][0].as_f64().unwrap() > 10.0, "{filled}");
    let (status, png) = ask(address, "GET", "/api/patient/picture.png", "", b"");
    assert!(status == 200 && png.starts_with(b"\x89PNG"), "{status}");
    let refused = done(address, "start", &json!({"model": "magic"}));
    assert!(refused["error"].as_str().unwrap().contains("implicit"), "{refused}");
    let started = done(address, "start", &json!({"held": "below"}));
    assert_eq!((started["error"].clone(), started["started"].clone()), (Value::Null, Value::Bool(true)));
    let simulation = server.join().unwrap().unwrap().expect("it was started");
    assert_eq!(simulation.world().tools().len(), 1);
    let mut left: Vec<_> = std::fs::read_dir(&out).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    left.sort();
    assert_eq!(left, ["organ.vtu", "scene.toml"]);
    // Nobody's scene is overwritten.
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let open = |scene: &Path| Simulation::open(OpenScene::read(scene)?, None);
    let page = PatientPage { folder: out, image: None, open: Box::new(open) };
    let access = Access::for_address(address.ip(), None).unwrap();
    let error = serve(listener, access, page, std::future::ready(())).map(|_| ()).unwrap_err().to_string();
    assert!(error.contains("organ.vtu") && error.contains("--out"), "{error}");
}
