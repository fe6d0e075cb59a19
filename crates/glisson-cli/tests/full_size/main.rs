//! The whole path at full size, through the release program's own commands: synthetic patient and real CT.

mod bed;
mod haptics;
mod link;
mod organs;
mod served;
mod soak;
mod soak_edits;

use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Runs `glisson` and answers what it printed; fails the test when it fails.
fn glisson(arguments: &[&str]) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_glisson")).args(arguments).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    assert!(
        output.status.success(),
        "glisson {}\n{}{}",
        arguments.join(" "),
        text(&output.stdout),
        text(&output.stderr)
    );
    text(&output.stdout)
}

fn quality(mesh: &Path) -> Value {
    serde_json::from_str(&glisson(&["check", mesh.to_str().unwrap(), "--json"])).unwrap()
}

/// Counts, volume, angles and topology of a mesh against what was asked for.
fn check_mesh(mesh: &Path, tetrahedra: f64, volume_ml: f64, volume_tolerance: f64) {
    let quality = quality(mesh);
    let number = |key: &str| quality[key].as_f64().unwrap();
    assert!((number("tetrahedra") / tetrahedra - 1.0).abs() <= 0.05, "{quality}");
    assert!((number("volume_m3") * 1e6 / volume_ml - 1.0).abs() <= volume_tolerance, "{quality}");
    assert!(number("min_dihedral_deg") >= 10.0 && number("max_dihedral_deg") <= 165.0, "{quality}");
    assert_eq!(number("surface_euler_characteristic"), 2.0, "{quality}");
}

#[test]
fn the_claims_hold() {
    // Other tests run beside it: times say nothing here.
    let printed = glisson(&["validate", "--json", "--busy"]);
    let report: Value = serde_json::from_str(&printed).unwrap();
    let experiments = report["experiments"].as_array().unwrap();
    assert!(experiments.len() >= 15, "{printed}");
    let holds = |e: &Value| e["pass"] == true || e["compares_times"] == true;
    assert!(experiments.iter().all(holds), "{printed}");
}

#[test]
fn other_patients_are_segmented_and_meshed_too() {
    for seed in ["2", "3"] {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
        glisson(&["phantom", "--seed", seed, "--out", folder.path().to_str().unwrap()]);
        let printed = glisson(&[
            "segment",
            &at("ct.nii.gz"),
            "--truth",
            &at("labels.nii.gz"),
            "-o",
            &at("liver.nii.gz"),
            "--json",
        ]);
        let report: Value = serde_json::from_str(&printed).unwrap();
        assert!(report["dice"].as_f64().unwrap() >= 0.95, "seed {seed}: {printed}");
        assert!(report["bare_band_dice"].as_f64().unwrap() < 0.93, "seed {seed}: {printed}");
        let mesh = folder.path().join("liver.vtu");
        glisson(&[
            "mesh",
            &at("liver.nii.gz"),
            "--label",
            "liver",
            "--tetrahedra",
            "6300",
            "-o",
            mesh.to_str().unwrap(),
        ]);
        let volume_ml = report["volume_m3"].as_f64().unwrap() * 1e6;
        check_mesh(&mesh, 6300.0, volume_ml, 0.01);
    }
}

#[expect(clippy::print_stdout, reason = "a skipped test says so")]
/// The real CT's folder, or `None` with the reason printed: `cargo xtask test` fetches it, or fails if told to.
fn real_ct() -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data/ct");
    if folder.join("mask.nii.gz").exists() {
        return Some(folder);
    }
    println!("SKIPPED: no real CT in data/ct; `cargo xtask fetch-ct` fetches it");
    None
}

/// Fills the real liver with about so many tetrahedra.
fn mesh_real_liver(ct: &Path, tetrahedra: &str, out: &str) {
    let mask = ct.join("mask.nii.gz");
    glisson(&["mesh", mask.to_str().unwrap(), "--label", "5", "--tetrahedra", tetrahedra, "-o", out]);
}

#[test]
fn a_real_liver_keeps_its_volume_and_has_no_holes() {
    let Some(ct) = real_ct() else { return };
    let folder = tempfile::tempdir().unwrap();
    for tetrahedra in ["6300", "50000"] {
        let mesh = folder.path().join(format!("liver_{tetrahedra}.vtu"));
        mesh_real_liver(&ct, tetrahedra, mesh.to_str().unwrap());
        check_mesh(&mesh, tetrahedra.parse().unwrap(), 1023.0, 0.02);
    }
}

#[test]
fn a_real_liver_can_be_pushed() {
    let Some(ct) = real_ct() else { return };
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    mesh_real_liver(&ct, "6300", &at("liver.vtu"));
    let (min_mm, max_mm) = bounds_mm(&quality(Path::new(&at("liver.vtu"))));
    // From the front, through the middle of the box, to its centre.
    let middle = |axis: usize| 0.5 * (min_mm[axis] + max_mm[axis]);
    let tip = |y_mm: f64| format!("[\"{} mm\", \"{y_mm} mm\", \"{} mm\"]", middle(0), middle(2));
    let scene = format!(
        "glisson_scene = 1\n[organ]\nmesh = \"liver.vtu\"\ntissue = \"liver\"\nmodel = \"precomputed\"\n\
         [[organ.fixed]]\nfurthest = {{ direction = [0, 1, 0], fraction = 0.1 }}\n\
         [tool]\ntip_radius = \"6 mm\"\nhome_tip = {}\nhome_shaft = [0, -1, 0]\n\
         [[tool.path]]\ntime = \"1 s\"\ntip = {}\n",
        tip(min_mm[1] - 20.0),
        tip(middle(1)),
    );
    std::fs::write(at("scene.toml"), scene).unwrap();
    let printed = glisson(&["run", &at("scene.toml"), "--record", &at("session.jsonl"), "--json"]);
    let report: Value = serde_json::from_str(&printed).unwrap();
    assert!(report["contact_steps"].as_u64().unwrap() > 50, "{printed}");
    assert!(report["greatest_force_n"].as_f64().unwrap() > 0.1, "{printed}");
    let replayed = glisson(&["replay", &at("session.jsonl")]);
    assert!(replayed.contains("same bits") && replayed.contains(report["state_hash"].as_str().unwrap()));
}

#[test]
fn a_real_livers_compliance_is_that_of_direct_solutions() {
    let Some(ct) = real_ct() else { return };
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    let (mask, mesh) = (ct.join("mask.nii.gz"), at("liver.vtu"));
    glisson(&["mesh", mask.to_str().unwrap(), "--label", "5", "--tetrahedra", "6300", "-o", &mesh]);
    for (precision, difference, asymmetry) in [("f64", 1e-10, 1e-12), ("f32", 1e-5, 1e-6)] {
        let out = at(precision);
        let held = ["--tissue", "liver", "--fix-furthest", "0,1,0,0.1"];
        let rest = ["-o", &out, "--precision", precision, "--check", "50", "--json"];
        let printed = glisson(&[&["precompute", &mesh], &held[..], &rest[..]].concat());
        let report: Value = serde_json::from_str(&printed).unwrap();
        let number = |key: &str| report["check"][key].as_f64().unwrap();
        // Evenly chosen: about as many as asked for.
        assert!(number("nodes") >= 40.0, "{printed}");
        assert!(number("difference") <= difference && number("asymmetry") <= asymmetry, "{printed}");
    }
}

#[test]
fn a_tumour_is_resected_with_two_hands_and_the_replay_is_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_str().unwrap();
    // Fails by itself when the replay differs, the hook is stuck, or the piece is not free with the tumour in it.
    glisson(&["demo", "--task", "resection", "--headless", "--out", out]);
    let text = std::fs::read_to_string(folder.path().join("resection.json")).unwrap();
    let report: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(report["specimen_is_free"], true, "{text}");
    assert_eq!(report["tumour_in_specimen"], 1.0, "{text}");
    assert_eq!(report["state_hash"], report["replayed_state_hash"], "{text}");
    // Tissue bears no more: the hook's three parts, four times the force at which a crack runs before each (docs/scene.md).
    assert!(report["greatest_force_hook_n"].as_f64().unwrap() < 37.0, "{text}");
    assert!(report["greatest_force_grasper_n"].as_f64().unwrap() < 50.0, "{text}");
    // The tumour is out whole, with healthy tissue around it: less than is planned, because tetrahedra are burnt whole. Half a
    // voxel's diagonal is taken off.
    assert!(report["least_margin_m"].as_f64().unwrap() >= 2e-3, "{text}");
    // It is burnt out, not torn off.
    let share_torn =
        report["tetrahedra_torn"].as_f64().unwrap() / report["tetrahedra_removed"].as_f64().unwrap();
    assert!(share_torn < 0.02, "{text}");
    // What bled is closed: every clip took something off, and little is left.
    let number = |key: &str| report[key].as_f64().unwrap();
    assert!(number("blood_lost_ml") > 0.0, "{text}");
    let clips = report["clips"].as_array().unwrap();
    assert!(!clips.is_empty(), "{text}");
    for clip in clips {
        let [before, after] =
            ["before_ml_per_min", "after_ml_per_min"].map(|key| clip[key].as_f64().unwrap());
        assert!(after < before, "{clip}");
    }
    assert!(
        number("bleeding_at_the_end_ml_per_min") < 0.1 * number("greatest_bleeding_ml_per_min"),
        "{text}"
    );
    // Pictures of every part of it, each of its own.
    let pictures = ["1_before", "burning", "clipping", "beneath", "lifted"].map(|name| {
        let mut files = std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().path());
        let is_named = |file: &PathBuf| {
            let file_name = file.file_name().unwrap().to_string_lossy();
            file_name.starts_with("resection_") && file_name.ends_with(&format!("{name}.png"))
        };
        let file = files.find(is_named).unwrap_or_else(|| panic!("no picture \"{name}\""));
        std::fs::read(file).unwrap()
    });
    for (i, picture) in pictures.iter().enumerate() {
        assert!(picture.starts_with(b"\x89PNG") && !pictures[..i].contains(picture), "picture {i}");
    }
    let viewed = tempfile::tempdir().unwrap();
    served::makes_the_same_resection(viewed.path(), &report);
}

fn bounds_mm(quality: &Value) -> ([f64; 3], [f64; 3]) {
    let corner = |key: &str| {
        let list = quality[key].as_array().unwrap_or_else(|| panic!("no {key} in {quality}"));
        [0, 1, 2].map(|i| list[i].as_f64().unwrap() * 1e3)
    };
    (corner("bounds_min_m"), corner("bounds_max_m"))
}
