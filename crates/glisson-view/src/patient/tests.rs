//! The page's requests over a real socket, from files to a simulation that is refused or comes.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::Path;
use std::thread::JoinHandle;
use std::time::Duration;

use glisson::image::files::{write_label_map, write_volume};
use glisson::image::{LabelMap, Volume, VoxelGrid};
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

/// A page on a socket of its own, writing to `out`.
fn page(out: &Path) -> (SocketAddr, JoinHandle<anyhow::Result<Option<Simulation>>>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    listener.set_nonblocking(true).unwrap();
    let address = listener.local_addr().unwrap();
    let open = |scene: &Path| Simulation::open(OpenScene::read(scene)?, None);
    let page = PatientPage { folder: out.to_path_buf(), image: None, open: Box::new(open), may_leave: true };
    let access = Access::for_address(address.ip(), None).unwrap();
    (address, std::thread::spawn(move || serve(listener, access, page, std::future::pending())))
}

fn error_of(state: &Value) -> &str {
    state["error"].as_str().unwrap_or_default()
}

#[test]
fn files_become_a_simulation_step_by_step() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = ball(folder.path());
    let out = folder.path().join("patient");
    let (address, server) = page(&out);

    // Nothing came, then something that is no image: each says so, and nothing of it stays.
    assert!(error_of(&done(address, "open", &json!({}))).contains("no image"));
    assert!(error_of(&done(address, "open", &json!({"upload": 77}))).contains("no file came"));
    let upload = send(address, "Jane_Doe.nii.gz", b"no image");
    let refused = done(address, "open", &json!({"upload": upload}));
    let refused = error_of(&refused);
    assert!(refused.contains("the image") && !refused.contains("Doe"), "{refused}");
    assert_eq!(n_incoming(&out), 0);
    for (step, choice, words) in [
        ("organ", json!({"name": "liver"}), "no image"),
        ("mesh", json!({"tetrahedra": 1000}), "no organ"),
        ("start", json!({}), "no tetrahedra"),
    ] {
        assert!(error_of(&done(address, step, &choice)).contains(words), "{step}");
    }
    assert_eq!(post(address, "organ", &json!({"inside": []})), 422);

    let late = send(address, "late.nii.gz", b"of an earlier image");
    let upload = send(address, "ball.nii.gz", &bytes);
    let path = format!("/api/patient/files/{late}/more");
    assert_eq!(ask(address, "PUT", &path, "application/octet-stream", b"x").0, 507);
    let opened = done(address, "open", &json!({"upload": upload}));
    assert_eq!(opened["error"], Value::Null);
    assert_eq!(opened["image"]["labels"], json!([{"label": 5, "name": "liver"}]));
    let (status, png) = ask(address, "GET", "/api/patient/pictures/slice/axial/40/40/40/2/5", "", b"");
    assert!(status == 200 && png.starts_with(b"\x89PNG"), "{status}");
    assert_eq!(ask(address, "GET", "/api/patient/pictures/slice/oblique/40/40/40/2/5", "", b"").0, 400);
    for (choice, words) in [
        (json!({"name": "liver", "label": "spleen"}), "spleen"),
        (json!({"name": " ", "label": "5"}), "name"),
        (json!({"name": "liver"}), "labels"),
    ] {
        assert!(error_of(&done(address, "organ", &choice)).contains(words), "{choice}");
    }
    let found = done(address, "organ", &json!({"name": "liver", "label": "5"}));
    let volume_ml = found["organs"][0]["volume_ml"].as_f64().unwrap();
    assert!((volume_ml / 91.95 - 1.0).abs() < 0.01, "{volume_ml}");
    assert!(error_of(&done(address, "mesh", &json!({"tetrahedra": 3}))).contains("allowed"));
    let filled = done(address, "mesh", &json!({"tetrahedra": 1500}));
    assert!(filled["mesh"]["dihedral_deg"][0].as_f64().unwrap() > 10.0, "{filled}");
    let n_of_quality: u64 =
        filled["mesh"]["n_of_quality"].as_array().unwrap().iter().map(|n| n.as_u64().unwrap()).sum();
    assert_eq!(Some(n_of_quality), filled["mesh"]["tetrahedra"].as_u64());
    let pictures = [
        "20/16/none/0/organ",
        "20/16/coronal/0.5/organ",
        "200/-95/axial/0.5/quality",
        "0/0/sagittal/1/quality",
    ];
    let pictures = pictures.map(|view| {
        let (status, png) = ask(address, "GET", &format!("/api/patient/pictures/mesh/{view}"), "", b"");
        assert!(status == 200 && png.starts_with(b"\x89PNG"), "{view}: {status}");
        png
    });
    assert!(pictures[0] != pictures[1] && pictures[2] != pictures[3]);
    assert_eq!(ask(address, "GET", "/api/patient/pictures/mesh/NaN/0/none/0/organ", "", b"").0, 400);
    let refused = done(address, "start", &json!({"model": "magic"}));
    assert!(error_of(&refused).contains("implicit"), "{refused}");
    let started = done(address, "start", &json!({"held": "below"}));
    assert_eq!((started["error"].clone(), started["started"].clone()), (Value::Null, Value::Bool(true)));
    let simulation = server.join().unwrap().unwrap().expect("it was started");
    assert_eq!(simulation.world().tools().len(), 1);
    let mut left: Vec<_> = std::fs::read_dir(&out).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    left.sort();
    assert_eq!(left, ["organ.vtu", "scene.toml"]);
    // Nobody's scene is overwritten.
    let (_, server) = page(&out);
    let error = server.join().unwrap().map(|_| ()).unwrap_err().to_string();
    assert!(error.contains("organ.vtu") && error.contains("--out"), "{error}");
}

/// A liver of 100 HU with a tumour of 40 HU in it, in fat.
fn scan(folder: &Path) -> Vec<u8> {
    let n = 48;
    let grid = VoxelGrid {
        dims: [n; 3],
        spacing_m: DVec3::splat(2e-3),
        origin_m: DVec3::ZERO,
        axes: DMat3::IDENTITY,
    };
    let value = |index: usize| {
        let at = DVec3::from(grid.voxel(index).map(|i| i as f64));
        // Some unevenness, so that the numbers are no labels.
        let noise = (index * 7919 % 13) as f32 - 6.5;
        let level = match () {
            () if at.distance(DVec3::new(24.0, 20.0, 24.0)) < 5.0 => 40.0,
            () if at.distance(DVec3::splat(24.0)) < 17.0 => 100.0,
            () => -90.0,
        };
        level + noise
    };
    let values = (0..grid.n_voxels()).map(value).collect();
    let file = folder.join("scan.nii.gz");
    write_volume(&file, &Volume { grid, values }).unwrap();
    std::fs::read(file).unwrap()
}

#[test]
fn outlines_count_in_their_slices_and_organs_in_each_other_are_parts_of_a_body() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = scan(folder.path());
    let out = folder.path().join("patient");
    let (address, server) = page(&out);
    let upload = send(address, "scan.nii.gz", &bytes);
    let opened = done(address, "open", &json!({"upload": upload}));
    assert_eq!((error_of(&opened), &opened["image"]["plane_of_slices"]), ("", &json!("axial")));
    assert!(error_of(&done(address, "values", &json!({}))).contains("guess"));

    // Slices 23 to 25 are said to be smaller than they are.
    let outlines: Vec<Value> = [46.0, 48.0, 50.0]
        .map(|z| json!({"through_mm": [40, 40, z], "points_mm": [[38, 38, z], [58, 38, z], [58, 58, z], [38, 58, z]]}))
        .to_vec();
    let by_contours = |outlines: &[Value]| json!({"name": "liver", "method": "contours", "inside_mm": [[48, 70, 48]], "outlines": outlines});
    let volume_of = |state: &Value, organ: usize| state["organs"][organ]["volume_ml"].as_f64().unwrap();
    let found = done(address, "organ", &by_contours(&[]));
    assert_eq!(error_of(&found), "");
    let corrected = done(address, "organ", &by_contours(&outlines));
    let less_ml = volume_of(&found, 0) - volume_of(&corrected, 0);
    // Three discs of radius 34 mm but for squares of 20 mm, 2 mm thick.
    assert!((less_ml / 19.4 - 1.0).abs() < 0.1, "{less_ml}");
    assert_eq!(corrected["organs"].as_array().unwrap().len(), 1);
    let (status, body) = ask(address, "GET", "/api/patient/outlines/liver", "", b"");
    let drawn = serde_json::from_slice::<Value>(&body).unwrap();
    let in_slice =
        |z: f64| drawn.as_array().unwrap().iter().filter(move |o| o["through_mm"][2] == json!(z)).count();
    assert_eq!((status, in_slice(48.0)), (200, 1));
    assert_eq!(ask(address, "GET", "/api/patient/outlines/spleen", "", b"").0, 404);
    let oblique =
        json!({"through_mm": [40, 40, 40], "points_mm": [[38, 38, 40], [58, 38, 60], [58, 58, 80]]});
    assert!(error_of(&done(address, "organ", &by_contours(&[oblique]))).contains("oblique"));

    let found = done(address, "organ", &json!({"name": "liver", "inside_mm": [[48, 70, 48]]}));
    let whole_ml = volume_of(&found, 0);
    assert!((whole_ml / 164.6 - 1.0).abs() < 0.05, "{whole_ml}");
    let tumour = json!({"name": "tumour", "inside_mm": [[48, 40, 48]]});
    assert_eq!(done(address, "organ", &tumour)["organs"].as_array().unwrap().len(), 2);
    let filled = done(address, "mesh", &json!({"tetrahedra": 4000}));
    assert_eq!((error_of(&filled), &filled["mesh"]["bodies"]), ("", &json!(1)));
    let of_mesh = |organ: usize| filled["mesh"]["organs"][organ]["volume_ml"].as_f64().unwrap();
    assert!(((of_mesh(0) + of_mesh(1)) / whole_ml - 1.0).abs() < 0.02, "{filled}");
    let started = done(address, "start", &json!({"tissues": ["liver", "gall_bladder"]}));
    assert_eq!(error_of(&started), "");
    server.join().unwrap().unwrap().expect("it was started");
    let scene = std::fs::read_to_string(out.join("scene.toml")).unwrap();
    assert!(scene.contains("[[organ.part]]") && scene.contains("gall_bladder"), "{scene}");
}

#[test]
fn a_step_is_cancelled_and_leaves_what_was() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = ball(folder.path());
    let out = folder.path().join("patient");
    let (address, _) = page(&out);
    let upload = send(address, "ball.nii.gz", &bytes);
    done(address, "open", &json!({"upload": upload}));
    done(address, "organ", &json!({"name": "liver", "label": "5"}));
    let before = done(address, "mesh", &json!({"tetrahedra": 1000}));
    assert_eq!(post(address, "mesh", &json!({"tetrahedra": 200_000})), 202);
    assert_eq!(post(address, "organ", &json!({"name": "liver"})), 409);
    assert_eq!(post(address, "cancel", &json!({})), 202);
    let after = loop {
        let state = state(address);
        if state["job"].is_null() {
            break state;
        }
        std::thread::sleep(Duration::from_millis(5));
    };
    assert_eq!(
        (error_of(&after), &after["mesh"], &after["version"]),
        ("", &before["mesh"], &before["version"])
    );
    // The next one is done as if nothing had been.
    assert_eq!(error_of(&done(address, "mesh", &json!({"tetrahedra": 800}))), "");
}

#[test]
fn the_page_is_left_only_where_another_comes_after_it() {
    let folder = tempfile::tempdir().unwrap();
    let (address, server) = page(&folder.path().join("out"));
    assert_eq!(state(address)["can_leave"], true);
    assert_eq!(post(address, "leave", &json!({})), 202);
    assert!(server.join().unwrap().unwrap().is_none());

    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    listener.set_nonblocking(true).unwrap();
    let address = listener.local_addr().unwrap();
    let open = |scene: &Path| Simulation::open(OpenScene::read(scene)?, None);
    let folder = folder.path().join("alone");
    let alone = PatientPage { folder, image: None, open: Box::new(open), may_leave: false };
    let access = Access::for_address(address.ip(), None).unwrap();
    let _alone = std::thread::spawn(move || serve(listener, access, alone, std::future::pending()));
    assert_eq!(state(address)["can_leave"], false);
    assert_eq!(post(address, "leave", &json!({})), 404);
}
