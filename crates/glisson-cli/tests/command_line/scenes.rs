//! The scenes in `scenes/` run, whole numbers of steps, and what is in the book's page of scenes is there.

use super::{glisson, tasks::text_of};
use std::path::Path;

fn check(name: &str) {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let file = root.join("scenes").join(name);
    let folder = tempfile::tempdir().unwrap();
    let output = glisson(folder.path(), &["run", file.to_str().unwrap(), "--steps", "40", "--json"]);
    let (said, errors) = (text_of(&output.stdout), text_of(&output.stderr));
    assert!(output.status.success(), "{name}: {said}{errors}");
    let summary: serde_json::Value = serde_json::from_str(&said).unwrap();
    assert_eq!(summary["steps"], 40, "{name}: {said}");
    let page = std::fs::read_to_string(root.join("docs/book/src/scenes.md")).unwrap();
    assert!(page.contains(&format!("`scenes/{name}`")), "{name} is not in the book's page of scenes");
}

#[test]
fn two_organs() {
    check("two_organs.toml");
}

#[test]
fn tubes() {
    check("tubes.toml");
}

#[test]
fn hybrid_cutting() {
    check("hybrid_cutting.toml");
}

#[test]
fn active_trocar() {
    check("active_trocar.toml");
}

#[test]
fn gall_bladder() {
    check("gall_bladder.toml");
}

/// Force of samples that relax over that of the elastic one: the series of the scene, 7.25 s after the middle of the press.
#[test]
fn rheology() {
    check("rheology.toml");
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/rheology.toml");
    let folder = tempfile::tempdir().unwrap();
    let args = ["run", file.to_str().unwrap(), "--steps", "785", "--csv", "forces.csv"];
    let output = glisson(folder.path(), &args);
    assert!(output.status.success(), "{}", text_of(&output.stderr));
    let forces = std::fs::read_to_string(folder.path().join("forces.csv")).unwrap();
    let (names, last) = (forces.lines().next().unwrap(), forces.lines().last().unwrap());
    let force_n = |name: &str| -> f64 {
        let column = names.split(',').position(|column| column == name).unwrap();
        last.split(',').nth(column).unwrap().parse().unwrap()
    };
    let shares = ["force_y_n_2", "force_y_n_3"].map(|name| force_n(name) / force_n("force_y_n"));
    let second = 1.0 - 0.450;
    let third = second - 0.365 * (1.0 - (-7.25_f64 / 50.0).exp());
    for (found, wanted) in shares.into_iter().zip([second, third]) {
        assert!((found - wanted).abs() < 0.005, "{found} of the elastic force, {wanted} by the series");
    }
}

#[test]
fn no_scene_is_left_out() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes");
    let own = include_str!("scenes.rs");
    for entry in std::fs::read_dir(folder).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        assert!(own.contains(&format!("check(\"{name}\")")), "no test runs {name}");
    }
}
