//! A recorded session as one HTML file, and as a film.

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
    // Two beside each other, which say what they are called.
    let (_, said) = export("both.html", &["--beside", "s.jsonl", "--check"]);
    assert!(
        said.matches("session          s.jsonl").count() == 2 && said.contains("8 frames read back"),
        "{said}"
    );
    let left = ["b.html", "body.tet", "both.html", "c.html", "new", "s.jsonl", "scene.toml"];
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
    let beside = ["export", "s.jsonl", "--html", "a.html", "--beside", "gone.jsonl"];
    refuses(folder.path(), &beside, &["gone.jsonl", "cannot read the session"]);
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

/// A program that does what an encoder does to its files, as a script for `sh`.
#[cfg(unix)]
fn encoder(folder: &Path, name: &str, script: &str) {
    use std::os::unix::fs::PermissionsExt as _;
    let path = folder.join(name);
    std::fs::write(&path, format!("#!/bin/sh\nfor last; do :; done\nout=${{last#file:}}\n{script}\n"))
        .unwrap();
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
}

/// The frames of a film whose encoder keeps pictures as they come.
#[cfg(unix)]
fn raw_frames(folder: &Path, name: &str, more: &[&str]) -> Vec<Vec<u8>> {
    let film = ["export", "s.jsonl", "--mp4", name, "--ffmpeg", "./keeps", "--size", "96x64"];
    let output = glisson(folder, &[&film, more].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let bytes = std::fs::read(folder.join(name)).unwrap();
    assert_eq!(bytes.len() % (3 * 96 * 64), 0, "{} bytes", bytes.len());
    bytes.chunks(3 * 96 * 64).map(<[u8]>::to_vec).collect()
}

#[cfg(unix)]
#[test]
fn a_film_has_the_frames_of_the_session() {
    let folder = tempfile::tempdir().unwrap();
    recorded(folder.path());
    encoder(folder.path(), "keeps", "cat > \"$out\"");
    let all = raw_frames(folder.path(), "new/a.mp4", &[]);
    // A tenth of a second, both ends of it.
    assert_eq!(all.len(), 4);
    let differences = |a: &[u8], b: &[u8]| a.iter().zip(b).filter(|(a, b)| a != b).count();
    assert!(differences(&all[0], &all[3]) > 300, "nothing moves");
    assert!(raw_frames(folder.path(), "b.mp4", &[]) == all, "the same session makes another film");
    // Every fourth picture is that of the film without slow motion.
    let slow = raw_frames(folder.path(), "c.mp4", &["--speed", "0.25"]);
    assert_eq!(slow.len(), 13);
    assert!((0..4).all(|i| slow[4 * i] == all[i]));
    let part = raw_frames(folder.path(), "d.mp4", &["--from", "0.03", "--to", "0.07"]);
    assert_eq!(part.len(), 2);
    assert_eq!(files(&folder.path().join("new")), ["a.mp4"]);
    assert_eq!(
        files(folder.path()),
        ["b.mp4", "body.tet", "c.mp4", "d.mp4", "keeps", "new", "s.jsonl", "scene.toml"]
    );
}

#[cfg(unix)]
#[test]
fn what_cannot_be_filmed_is_refused_in_words_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let session = recorded(folder.path());
    encoder(folder.path(), "keeps", "cat > \"$out\"");
    encoder(folder.path(), "fails", "echo begun > \"$out\"; echo 'no encoder of that name' >&2; exit 3");
    encoder(folder.path(), "fails_late", "cat > \"$out\"; echo 'the disk is full' >&2; exit 1");
    std::fs::write(folder.path().join("no_program"), "").unwrap();
    let refused = |mp4: &str, more: &[&str], expected: &[&str]| {
        let film = ["export", "s.jsonl", "--mp4", mp4, "--size", "96x64"];
        refuses(folder.path(), &[&film, more].concat(), expected);
    };
    refused(
        "a.mp4",
        &["--ffmpeg", "./gone"],
        &["./gone", "no such program", "apt-get install ffmpeg", "--ffmpeg"],
    );
    refused("a.mp4", &["--ffmpeg", "./no_program"], &["./no_program", "cannot be started"]);
    refused("a.mp4", &["--ffmpeg", "./fails"], &["./fails failed", "3", "no encoder of that name"]);
    refused("a.mp4", &["--ffmpeg", "./fails_late"], &["./fails_late failed", "the disk is full"]);
    let keeps = |more: &[&'static str]| [&["--ffmpeg", "./keeps"], more].concat();
    refused("a.avi", &keeps(&[]), &["a.avi", "`avi`", "allowed: .mp4"]);
    refused("body.tet/a.mp4", &keeps(&[]), &["body.tet"]);
    refused("a.mp4", &keeps(&["--view", "endoscope"]), &["no endoscope"]);
    refused("a.mp4", &keeps(&["--from", "3"]), &["the session ends at 0.1", "--from 3"]);
    refused("a.mp4", &keeps(&["--from", "3", "--to", "2"]), &["ends at 2 s, before it begins"]);
    // A folder in the place of the file.
    std::fs::create_dir(folder.path().join("b.mp4")).unwrap();
    refused("b.mp4", &keeps(&[]), &["b.mp4", "cannot write"]);
    // A film of before stays when there is no new one, also when that is found out at the end.
    std::fs::write(folder.path().join("old.mp4"), "before").unwrap();
    refused("old.mp4", &["--ffmpeg", "./fails_late"], &["the disk is full"]);
    let last_hash = session.lines().last().unwrap();
    let other = last_hash.replacen("\"state_hash\":\"", "\"state_hash\":\"00", 1).replacen("\"}", "", 1);
    let other = format!("{}\"}}", &other[..other.len() - 2]);
    std::fs::write(folder.path().join("s.jsonl"), session.replace(last_hash, &other)).unwrap();
    refused("old.mp4", &keeps(&[]), &["nothing is exported", "differs from the recording"]);
    assert_eq!(std::fs::read(folder.path().join("old.mp4")).unwrap(), b"before");
    for (options, said) in [
        (&["--size", "97x64"][..], "97x64"),
        (&["--size", "96"], "no size"),
        (&["--fps", "0"], "not in"),
        (&["--speed", "0"], "not in"),
        (&["--from", "-1"], "-1"),
        (&["--rate", "30"], "cannot be used with"),
        (&["--html", "a.html"], "cannot be used with"),
    ] {
        let output = glisson(folder.path(), &[&["export", "s.jsonl", "--mp4", "a.mp4"], options].concat());
        let words = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{options:?}: {words}");
        assert!(words.contains(said), "{options:?}: {words}");
    }
}

/// With the encoder that users have; `cargo xtask test` sees to it that it is there.
#[test]
fn ffmpeg_makes_a_film_that_can_be_read_back() {
    let folder = tempfile::tempdir().unwrap();
    recorded(folder.path());
    let ffmpeg = |arguments: &[&str]| {
        std::process::Command::new("ffmpeg").args(arguments).current_dir(folder.path()).output()
    };
    if ffmpeg(&["-version"]).is_err() {
        eprintln!("SKIPPED: there is no ffmpeg");
        return;
    }
    let export = |name: &str| {
        let film = ["export", "s.jsonl", "--mp4", name, "--size", "96x64", "--speed", "0.25"];
        let output = glisson(folder.path(), &film);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    };
    export("a: 1.mp4");
    let read = ffmpeg(&["-i", "file:a: 1.mp4", "-f", "rawvideo", "-pix_fmt", "rgb24", "raw"]).unwrap();
    let said = String::from_utf8_lossy(&read.stderr).into_owned();
    assert!(said.contains("h264") && said.contains("yuv420p") && said.contains("96x64"), "{said}");
    assert!(said.contains("bt709") && said.contains("30 fps"), "{said}");
    let raw = std::fs::read(folder.path().join("raw")).unwrap();
    assert_eq!(raw.len(), 13 * 3 * 96 * 64);
    #[cfg(unix)]
    {
        // Its colours are those that were drawn, but for what is lost.
        encoder(folder.path(), "keeps", "cat > \"$out\"");
        let drawn = raw_frames(folder.path(), "b.mp4", &["--speed", "0.25"]).concat();
        let off: u64 = raw.iter().zip(&drawn).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
        assert!(off < 4 * raw.len() as u64, "{} off on average", off as f64 / raw.len() as f64);
    }
    // The head comes first, so that it plays while it is fetched.
    let film = std::fs::read(folder.path().join("a: 1.mp4")).unwrap();
    let at = |name: &[u8]| film.windows(4).position(|bytes| bytes == name).unwrap();
    assert!(at(b"moov") < at(b"mdat"));
}
