//! The program as a careless user meets it: bad input gets exit code 1, a message that names file, place, found and
//! allowed value, and leaves no half-written file; a wrong command line gets exit code 2.

mod broken;
mod cut_off;
mod devices;
mod export;
mod images;
mod link;
mod precompute;
mod scenes;
mod start;
mod results;
mod tasks;

use std::path::Path;
use std::process::{Command, Output};

fn glisson(folder: &Path, arguments: &[&str]) -> Output {
    command(folder, arguments).output().unwrap()
}

/// Stores no results where the user of this machine has them.
fn command(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_glisson"));
    command.args(arguments).current_dir(folder).env_remove("GLISSON_RESULTS");
    command
}

fn files(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .unwrap()
        .map(|e| e.unwrap().file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

/// The command fails with code 1, says all of `expected`, and leaves the folder as it was.
fn refuses(folder: &Path, arguments: &[&str], expected: &[&str]) {
    let before = files(folder);
    let output = glisson(folder, arguments);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    let line = arguments.join(" ");
    for text in expected {
        assert!(
            text.len() < 12 || message.matches(text).count() <= 1,
            "glisson {line} says it twice: {message}"
        );
    }
    assert_eq!(output.status.code(), Some(1), "glisson {line}: {message}");
    assert!(message.starts_with("error: "), "glisson {line}: {message}");
    for text in expected {
        assert!(message.contains(text), "glisson {line}: no \"{text}\" in: {message}");
    }
    assert_eq!(files(folder), before, "glisson {line} left files behind");
}

/// A tetrahedron of 60 mm edges and its scene.
fn small_scene(folder: &Path) {
    let mesh = "4 1\n0 0 0\n60 0 0\n0 60 0\n0 0 60\n0 1 2 3\n";
    std::fs::write(folder.join("body.tet"), mesh).unwrap();
    std::fs::write(folder.join("scene.toml"), SCENE).unwrap();
}

const SCENE: &str = r#"glisson_scene = 1
[organ]
mesh = "body.tet"
young_modulus = "5 kPa"
poisson_ratio = 0.45
density = "1000 kg/m3"
model = "precomputed"
[[organ.fixed]]
furthest = { direction = [0, 0, -1], fraction = 0.75 }
[tool]
tip_radius = "5 mm"
home_tip = ["10 mm", "10 mm", "150 mm"]
home_shaft = [0, 0, 1]
[[tool.path]]
time = "0.1 s"
tip = ["2 mm", "2 mm", "55 mm"]
"#;

#[test]
fn help_and_wrong_command_lines() {
    let folder = tempfile::tempdir().unwrap();
    for verb in [
        "phantom",
        "segment",
        "mesh",
        "check",
        "precompute",
        "solve",
        "fit",
        "run",
        "serve",
        "watch",
        "task",
        "start",
        "results",
        "devices",
        "replay",
        "export",
        "bench",
        "validate",
        "demo",
    ] {
        let output = glisson(folder.path(), &[verb, "--help"]);
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(
            output.status.success() && text.contains("Usage") && text.contains("Example"),
            "{verb}: {text}"
        );
    }
    for wrong in [&[][..], &["fly"], &["mesh"], &["run", "scene.toml", "--steps", "many"]] {
        assert_eq!(glisson(folder.path(), wrong).status.code(), Some(2), "{wrong:?}");
    }
}

#[test]
fn a_scene_runs_records_and_replays() {
    let folder = tempfile::tempdir().unwrap();
    small_scene(folder.path());
    let run = glisson(folder.path(), &["run", "scene.toml", "--record", "s.jsonl", "--csv", "f.csv"]);
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    assert!(!files(folder.path()).iter().any(|name| name.ends_with(".partial")));
    let replay = glisson(folder.path(), &["replay", "s.jsonl"]);
    assert!(String::from_utf8_lossy(&replay.stdout).contains("same bits"));
    assert_eq!(std::fs::read_to_string(folder.path().join("f.csv")).unwrap().lines().count(), 101);

    // One changed input makes another state: the replay says so.
    let session = std::fs::read_to_string(folder.path().join("s.jsonl")).unwrap();
    let last_input = session.lines().rfind(|l| l.contains("\"input\"")).unwrap();
    let other = session
        .replace(last_input, &last_input.replacen("\"tip_in_world_m\":[0.00", "\"tip_in_world_m\":[0.01", 1));
    assert_ne!(other, session, "{last_input}");
    std::fs::write(folder.path().join("other.jsonl"), other).unwrap();
    refuses(folder.path(), &["replay", "other.jsonl"], &["differs from the recording"]);
}

#[test]
fn scenes_with_mistakes_are_refused_with_line_and_remedy() {
    let folder = tempfile::tempdir().unwrap();
    small_scene(folder.path());
    let with = |from: &str, to: &str, expected: &[&str]| {
        assert!(SCENE.contains(from));
        std::fs::write(folder.path().join("bad.toml"), SCENE.replacen(from, to, 1)).unwrap();
        refuses(folder.path(), &["run", "bad.toml", "--record", "s.jsonl"], expected);
    };
    with("poisson_ratio", "poisson_rato", &["bad.toml: line 5", "did you mean \"poisson_ratio\""]);
    with("5 kPa", "5 kpa", &["bad.toml: line 4", "\"kpa\" is not a unit of pressure", "kPa"]);
    with("0.45", "0.5", &["line 5", "0.5", "less than 0.5"]);
    with("body.tet", "gone.tet", &["gone.tet"]);
    with("fraction = 0.75", "fraction = 75", &["line 9", "between 0 and 1"]);
    with(
        "[[organ.fixed]]\nfurthest = { direction = [0, 0, -1], fraction = 0.75 }\n",
        "",
        &["float", "[[organ.fixed]]"],
    );
    // 60 mm of 5 kPa carry a wave in some 10 ms: a step of 1 s is far above the stable one.
    let explicit = SCENE.replace("precomputed", "tensor_mass") + "[simulation]\ntime_step = \"1 s\"\n";
    std::fs::write(folder.path().join("bad.toml"), explicit).unwrap();
    refuses(
        folder.path(),
        &["run", "bad.toml"],
        &["bad.toml", "[simulation]", "1000 ms", "at most", "above the stable one"],
    );
    refuses(folder.path(), &["run", "gone.toml"], &["gone.toml"]);
}

#[test]
fn a_port_in_use_is_named() {
    let folder = tempfile::tempdir().unwrap();
    small_scene(folder.path());
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    refuses(folder.path(), &["serve", "scene.toml", "--port", &port], &["port", &port, "in use", "--port"]);
}

#[test]
fn a_precomputed_file_of_another_body_or_with_a_flipped_bit_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    small_scene(folder.path());
    let made = glisson(folder.path(), &["precompute", "scene.toml", "-o", "body.precomputed"]);
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let scene = SCENE
        .replace("model = \"precomputed\"", "model = \"precomputed\"\nprecomputed = \"body.precomputed\"");
    std::fs::write(folder.path().join("scene.toml"), &scene).unwrap();
    assert!(glisson(folder.path(), &["run", "scene.toml"]).status.success());

    std::fs::write(folder.path().join("other.toml"), scene.replace("5 kPa", "6 kPa")).unwrap();
    refuses(folder.path(), &["run", "other.toml"], &["body.precomputed", "material", "6000"]);
    let file = folder.path().join("body.precomputed");
    let mut bytes = std::fs::read(&file).unwrap();
    let middle = bytes.len() / 2;
    bytes[8] = 3;
    std::fs::write(&file, &bytes).unwrap();
    refuses(
        folder.path(),
        &["run", "scene.toml"],
        &["body.precomputed", "format version 3", "pre-compute again"],
    );
    bytes[8] = 4;
    bytes[middle] ^= 1;
    std::fs::write(&file, &bytes).unwrap();
    refuses(folder.path(), &["run", "scene.toml"], &["body.precomputed", "checksum"]);
    std::fs::write(&file, &bytes[..middle]).unwrap();
    refuses(folder.path(), &["run", "scene.toml"], &["body.precomputed"]);
}

#[test]
fn a_measured_curve_is_fitted_or_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut text = "axial_displacement_mm,force_n,radial_displacement_mm\n".to_owned();
    for i in 0..=20 {
        let x = 0.2 * f64::from(i);
        text += &format!("{x},{},{}\n", 0.1 * x + 0.02 * x * x, 0.5 * x);
    }
    std::fs::write(folder.path().join("curve.csv"), &text).unwrap();
    let broken = text.replacen("0.2,", "0.2;", 1);
    std::fs::write(folder.path().join("broken.csv"), broken).unwrap();
    refuses(
        folder.path(),
        &["fit", "broken.csv", "--out", "o"],
        &["broken.csv:3", "2 fields", "names 3 columns"],
    );
    refuses(
        folder.path(),
        &["fit", "curve.csv", "--degree", "3", "--out", "o"],
        &["degree 3; allowed: 4 to 10"],
    );
    refuses(
        folder.path(),
        &[
            "fit",
            "curve.csv",
            "--height-mm",
            "0",
            "--radius-mm",
            "9",
            "--young-kpa",
            "3",
            "--poisson",
            "0.4",
            "--out",
            "o",
        ],
        &["--height-mm 0; allowed: a finite number above 0"],
    );
    let sample = ["--height-mm", "13", "--radius-mm", "15", "--young-kpa", "3", "--poisson", "0.4"];
    let arguments = [&["fit", "curve.csv", "--degree", "5", "--out", "fitted"], &sample[..]].concat();
    let output = glisson(folder.path(), &arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(String::from_utf8_lossy(&output.stdout).contains("r                1.00000000"));
    assert_eq!(files(&folder.path().join("fitted")), ["fit.json", "force.svg", "radial.svg"]);
    let json = std::fs::read_to_string(folder.path().join("fitted/fit.json")).unwrap();
    assert!(json.contains("\"over_linear_magnitude\"") && json.contains("\"degree\": 5"), "{json}");
}

#[test]
fn images_that_are_broken_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    // A valid NIfTI-1 header of a 4 x 4 x 4 map of 8-bit labels, all 1.
    let mut nifti = vec![0_u8; 352 + 64];
    nifti[0..4].copy_from_slice(&348_i32.to_le_bytes());
    for (place, value) in
        [(40, 3_i16), (42, 4), (44, 4), (46, 4), (48, 1), (50, 1), (70, 2), (72, 8), (254, 1)]
    {
        nifti[place..place + 2].copy_from_slice(&value.to_le_bytes());
    }
    for (place, value) in [(76, 1.0_f32), (80, 10.0), (84, 10.0), (88, 10.0), (108, 352.0), (112, 1.0)] {
        nifti[place..place + 4].copy_from_slice(&value.to_le_bytes());
    }
    for (place, value) in [(280, 10.0_f32), (300, 10.0), (320, 10.0)] {
        nifti[place..place + 4].copy_from_slice(&value.to_le_bytes());
    }
    nifti[123] = 2;
    nifti[344..348].copy_from_slice(b"n+1\0");
    nifti[352..].fill(1);
    let write = |name: &str, bytes: &[u8]| std::fs::write(path.join(name), bytes).unwrap();
    let changed = |place: usize, bytes: &[u8]| {
        let mut copy = nifti.clone();
        copy[place..place + bytes.len()].copy_from_slice(bytes);
        copy
    };
    let mesh = |name: &str, label: &str, expected: &[&str]| {
        refuses(path, &["mesh", name, "--label", label, "--tetrahedra", "2000", "-o", "out.vtu"], expected);
    };
    write("border.nii", &nifti);
    mesh("border.nii", "1", &["border.nii", "border"]);
    mesh("border.nii", "7", &["7", "1"]);
    mesh("border.nii", "liver", &["liver"]);
    write("spacing.nii", &changed(80, &f32::NAN.to_le_bytes()));
    mesh("spacing.nii", "1", &["spacing.nii", "NaN"]);
    write("dims.nii", &changed(42, &(-4_i16).to_le_bytes()));
    mesh("dims.nii", "1", &["dims.nii", "-4"]);
    write("short.nii", &nifti[..400]);
    mesh("short.nii", "1", &["short.nii"]);
    write("torn.nii.gz", &[0x1f, 0x8b, 8, 0, 0, 0, 0, 0, 0, 3, 0x63]);
    mesh("torn.nii.gz", "1", &["torn.nii.gz"]);
    mesh("gone.nii", "1", &["gone.nii"]);
}

#[test]
fn surfaces_and_meshes_that_are_broken_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let write = |name: &str, text: &str| std::fs::write(path.join(name), text).unwrap();
    // A tetrahedron's surface without its last triangle, and one that runs through itself.
    write("open.obj", "v 0 0 0\nv 50 0 0\nv 0 50 0\nv 0 0 50\nf 1 3 2\nf 1 2 4\nf 1 4 3\n");
    refuses(path, &["mesh", "open.obj", "-o", "out.vtu"], &["open.obj"]);
    write(
        "through.obj",
        "v 0 0 0\nv 50 0 0\nv 0 50 0\nv 0 0 50\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n\
         v 5 5 5\nv 55 5 5\nv 5 55 5\nv 5 5 55\nf 5 7 6\nf 5 6 8\nf 5 8 7\nf 6 7 8\n",
    );
    refuses(path, &["mesh", "through.obj", "-o", "out.vtu"], &["through.obj", "intersect"]);
    // Nodes 0 and 4 in one place, node 5 loose, a flat tetrahedron.
    write("faulty.tet", "7 2\n0 0 0\n60 0 0\n0 60 0\n0 0 60\n0 0 0\n9 9 9\n60 60 0\n0 1 2 3\n4 1 2 6\n");
    refuses(path, &["check", "faulty.tet"], &["faulty.tet"]);
    let report = glisson(path, &["check", "faulty.tet", "--json"]);
    let report =
        String::from_utf8_lossy(&report.stdout).into_owned() + &String::from_utf8_lossy(&report.stderr);
    assert!(report.contains('5') && report.contains("loose"), "{report}");
}
