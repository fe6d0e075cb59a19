//! A recorded session as one HTML file.

use super::{files, glisson, refuses, small_scene};
use std::path::Path;

fn recorded(folder: &Path) -> String {
    small_scene(folder);
    let run = glisson(folder, &["run", "scene.toml", "--record", "s.jsonl"]);
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    std::fs::read_to_string(folder.join("s.jsonl")).unwrap()
}

/// The pages that are put into the program.
pub(super) fn pages_are_built() -> bool {
    let is_built = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../web/dist/replay.html").exists();
    if !is_built {
        eprintln!("SKIPPED: web/dist is not built (cd web && npm run build)");
    }
    is_built
}

#[test]
fn a_session_is_exported_twice_to_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    recorded(folder.path());
    if !pages_are_built() {
        return;
    }
    let export = |name: &str, more: &[&str]| {
        let arguments = [&["export", "s.jsonl", "--html", name], more].concat();
        let output = glisson(folder.path(), &arguments);
        let text = [output.stdout, output.stderr].map(|t| String::from_utf8_lossy(&t).into_owned()).concat();
        assert!(output.status.success(), "{text}");
        (std::fs::read(folder.path().join(name)).unwrap(), text)
    };
    let (first, said) = export("new/a.html", &["--check"]);
    // A tenth of a second: the first step, two periods, and the last step.
    for expected in [
        "same bits as the recording",
        "frames           4 (30 a second",
        "4 vertices at most",
        "4 frames read back",
        "largest error    0.0",
    ] {
        assert!(said.contains(expected), "no \"{expected}\" in: {said}");
    }
    assert!(export("b.html", &[]).0 == first);
    let (finer, said) = export("c.html", &["--rate", "60", "--precision-mm", "0.001"]);
    assert!(finer != first && said.contains("frames           7 (60 a second"), "{said}");
    let left = ["b.html", "body.tet", "c.html", "new", "s.jsonl", "scene.toml"];
    assert_eq!(files(folder.path()), left);
    // Nothing that a browser would ask a network for.
    let page = String::from_utf8(first).unwrap();
    assert!(!page.contains("src=\"") && !page.contains("<link rel=\"stylesheet\""));
}

#[test]
fn what_cannot_be_exported_is_refused_in_words() {
    let folder = tempfile::tempdir().unwrap();
    let session = recorded(folder.path());
    if !pages_are_built() {
        return;
    }
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    let refused = |session: &str, html: &str, expected: &[&str]| {
        refuses(folder.path(), &["export", session, "--html", html], expected);
    };
    refused("gone.jsonl", "a.html", &["gone.jsonl", "cannot read the session"]);
    refused("s.jsonl", "a.txt", &["a.txt", "`txt`", "allowed: .html"]);
    refused("s.jsonl", "body.tet/a.html", &["body.tet"]);
    write("text.jsonl", "a text\n");
    refused("text.jsonl", "a.html", &["text.jsonl", "line 1"]);
    // One changed input makes another state.
    let last_input = session.lines().rfind(|l| l.contains("\"input\"")).unwrap();
    let changed = last_input.replacen("\"tip_in_world_m\":[0.00", "\"tip_in_world_m\":[0.01", 1);
    write("other.jsonl", &session.replace(last_input, &changed));
    refused("other.jsonl", "a.html", &["nothing is exported", "differs from the recording"]);
    // Another organ than the recorded one.
    let before = std::fs::read_to_string(folder.path().join("body.tet")).unwrap();
    write("body.tet", &before.replace("0 0 60", "0 0 61"));
    refused("s.jsonl", "a.html", &["the mesh is not the one of the recording", "--folder"]);
    for (option, wrong) in
        [("--rate", "0"), ("--rate", "61"), ("--precision-mm", "0"), ("--precision-mm", "2")]
    {
        let output = glisson(folder.path(), &["export", "s.jsonl", "--html", "a.html", option, wrong]);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{option} {wrong}: {said}");
        assert!(said.contains(wrong) && said.contains("not in"), "{option} {wrong}: {said}");
    }
}
