//! What a fault of the program does: the session is kept, what happened is told with its step, and the exit code is 3.
//! Faults are ordered by an environment variable, which debug builds alone know.
#![cfg(debug_assertions)]

use super::{files, small_scene};
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

fn breaking_at_step_30(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_glisson"));
    command.args(arguments).current_dir(folder).env("GLISSON_BREAK_AT_STEP", "30");
    command
}

/// The session that was kept has so many different inputs, and no end.
fn has_kept_its_session(folder: &Path, n_inputs: usize) {
    assert!(files(folder).contains(&"s.jsonl".to_owned()), "{:?}", files(folder));
    let session = std::fs::read_to_string(folder.join("s.jsonl")).unwrap();
    assert_eq!(session.lines().filter(|line| line.contains("\"input\"")).count(), n_inputs);
    assert!(!session.contains("\"end\""));
}

#[test]
fn a_run_that_breaks_tells_its_step_keeps_its_session_and_ends_with_code_3() {
    let folder = tempfile::tempdir().unwrap();
    small_scene(folder.path());
    let arguments = ["run", "scene.toml", "--record", "s.jsonl", "--csv", "f.csv"];
    let output = breaking_at_step_30(folder.path(), &arguments).output().unwrap();
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(3), "{message}");
    assert!(message.contains("step 30: the simulation broke"), "{message}");
    assert!(message.contains("the session up to here is kept"), "{message}");
    has_kept_its_session(folder.path(), 30);
    let rows = std::fs::read_to_string(folder.path().join("f.csv")).unwrap();
    assert_eq!(rows.lines().count(), 31);
}

#[test]
fn a_served_simulation_that_breaks_leaves_the_page_up_and_tells_it() {
    let folder = tempfile::tempdir().unwrap();
    small_scene(folder.path());
    let arguments = ["serve", "scene.toml", "--port", "0", "--no-open", "--record", "s.jsonl"];
    let mut serve = breaking_at_step_30(folder.path(), &arguments).stdout(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(serve.stdout.take().unwrap()).lines().map(Result::unwrap);
    let page = lines.by_ref().find(|line| line.contains("http://")).unwrap();
    let host = page.split("http://").nth(1).unwrap().split('/').next().unwrap().to_owned();
    // Long after the thirtieth step there still is a page, and it says what happened.
    std::thread::sleep(std::time::Duration::from_millis(500));
    let watched = super::glisson(folder.path(), &["watch", &format!("ws://{host}/ws"), "--seconds", "1"]);
    let told =
        [watched.stdout, watched.stderr].map(|text| String::from_utf8_lossy(&text).into_owned()).concat();
    assert!(watched.status.success() && told.contains("step 30: the simulation broke"), "{told}");
    // Nobody moved the instrument.
    has_kept_its_session(folder.path(), 1);
    super::devices::interrupt(&serve);
    let rest: Vec<String> = lines.collect();
    assert_eq!(serve.wait().unwrap().code(), Some(3), "{rest:?}");
}
