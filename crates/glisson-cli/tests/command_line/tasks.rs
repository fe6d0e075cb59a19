//! `glisson task`: the tasks that come with the program, one of one's own, and what is none.

use super::{files, glisson, refuses};
use std::path::Path;

/// A block that a probe presses, without any file.
pub(super) const TASK: &str = r#"glisson_scene = 1
[task]
title = "Press <here> & there"
[[task.stage]]
title = "Touch the block"
touch = {}
[simulation]
time_step = "5 ms"
[organ]
box = { min = ["-5 cm", "0 cm", "-5 cm"], max = ["5 cm", "4 cm", "5 cm"] }
edge = "15 mm"
tissue = "liver"
model = "precomputed"
[[organ.fixed]]
furthest = { direction = [0, 1, 0], fraction = 0.2 }
[tool]
name = "probe"
tip_radius = "5 mm"
home_tip = [0, "-20 mm", 0]
home_shaft = [0, -1, 0]
[[tool.path]]
time = "0.5 s"
tip = [0, "-2 mm", 0]
"#;

pub(super) fn text_of(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn run(folder: &Path, more: &[&str]) -> (Option<i32>, String, String) {
    let output =
        glisson(folder, &[&["task", "run", "own.toml", "--headless", "--out", "made"], more].concat());
    (output.status.code(), text_of(&output.stdout), text_of(&output.stderr))
}

#[test]
fn the_tasks_of_the_program_are_listed_and_can_be_done() {
    let folder = tempfile::tempdir().unwrap();
    let list = glisson(folder.path(), &["task", "list", "--json"]);
    let tasks: Vec<serde_json::Value> = serde_json::from_slice(&list.stdout).unwrap();
    assert!(tasks.len() >= 6);
    let shown = text_of(&glisson(folder.path(), &["task", "list"]).stdout);
    for task in &tasks {
        let name = task["name"].as_str().unwrap();
        assert!(shown.contains(name) && shown.contains(task["title"].as_str().unwrap()), "{name}: {shown}");
        let check = glisson(folder.path(), &["task", "check", name]);
        assert!(check.status.success(), "{name}: {}", text_of(&check.stderr));
        assert!(text_of(&check.stdout).contains("it can be done"), "{name}");
    }
    assert!(files(folder.path()).is_empty());
}

#[test]
fn an_own_task_is_done_by_its_demonstration_and_assessed_again_in_the_replay() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("own.toml"), TASK).unwrap();
    let (code, out, error) = run(folder.path(), &[]);
    assert_eq!(code, Some(0), "{error}");
    assert!(out.contains("Press <here> & there: done, passed; 1 of 1 stages"), "{out}");
    let made = folder.path().join("made");
    assert_eq!(files(&made), ["own.html", "own.json", "own.jsonl"]);
    let report = std::fs::read_to_string(made.join("own.html")).unwrap();
    assert!(report.contains("<h1>Press &lt;here&gt; &amp; there</h1>") && !report.contains("<here>"));
    let numbers: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(made.join("own.json")).unwrap()).unwrap();
    let (_, json, _) = run(folder.path(), &["--json"]);
    let again: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(again["result"], numbers["result"]);

    // The session tells the same lines.
    let replay = text_of(&glisson(folder.path(), &["replay", "made/own.jsonl"]).stdout);
    let metrics = |text: &str| -> Vec<String> {
        text.lines().filter(|line| line.starts_with("  ")).map(str::to_owned).collect()
    };
    assert!(replay.contains("same bits") && metrics(&out).len() > 10);
    assert_eq!(metrics(&replay), metrics(&out));
}

#[test]
fn a_task_that_is_not_passed_has_exit_code_1_and_a_report() {
    let folder = tempfile::tempdir().unwrap();
    let own = folder.path().join("own.toml");
    for (before, after, expected) in [
        (
            "touch = {}",
            "reach = { point = [0, 0, \"9 cm\"], within = \"1 mm\" }",
            "ended before the task was done",
        ),
        ("[[task.stage]]", "time_limit = \"0.2 s\"\n[[task.stage]]", "not done within its time"),
        ("[[task.stage]]", "[task.gate]\npeak_force = \"1 mN\"\n[[task.stage]]", "beyond its safety gate"),
    ] {
        // A touch alone is done before there is much of a force.
        let text = TASK.replace(before, after).replace("touch = {}", "hold = \"50 ms\"\ntouch = {}");
        std::fs::write(&own, text).unwrap();
        let (code, out, error) = run(folder.path(), &[]);
        assert_eq!(code, Some(1), "{after}: {out}");
        assert!(error.contains(expected), "{after}: {error}");
        assert!(folder.path().join("made/own.html").exists());
        std::fs::remove_dir_all(folder.path().join("made")).unwrap();
    }
}

#[test]
fn what_is_no_task_is_refused_and_nothing_is_made() {
    let folder = tempfile::tempdir().unwrap();
    let own = folder.path().join("own.toml");
    let headless = ["task", "run", "own.toml", "--headless", "--out", "made"];
    refuses(
        folder.path(),
        &["task", "check", "palpatoin"],
        &["\"palpatoin\"", "did you mean \"palpation\"?", "cut_off"],
    );
    refuses(folder.path(), &headless, &["no task and no file \"own.toml\""]);
    let without = TASK.replace(
        "[task]\ntitle = \"Press <here> & there\"\n[[task.stage]]\ntitle = \"Touch the block\"\ntouch = {}\n",
        "",
    );
    for (text, expected) in [
        (without.as_str(), &["own.toml", "has no [task]", "docs/tasks.md"][..]),
        (&TASK.replace("touch = {}", "tuoch = {}"), &["own.toml", "line 6", "did you mean \"touch\"?"]),
        (
            &TASK.replace("touch = {}", "touch = { near = [0, \"-2 cm\", 0], within = \"1 mm\" }"),
            &["own.toml", "stage 1", "no tissue at (0.0, -20.0, 0.0) mm"],
        ),
        (&TASK.replace("touch = {}", "clip = {}"), &["own.toml", "about vessels"]),
        (&TASK.replace("touch = {}", "grasp = {}"), &["own.toml", "such as a grasper"]),
        (
            &TASK.replace("touch = {}", "part = { from = [0, 0, 0], to = [0, 0, \"1 cm\"] }"),
            &["own.toml", "an instrument that cuts"],
        ),
        (
            &TASK.replace("[[tool.path]]\ntime = \"0.5 s\"\ntip = [0, \"-2 mm\", 0]\n", ""),
            &["own.toml", "no demonstration", "[[tool.path]]"],
        ),
    ] {
        std::fs::write(&own, text).unwrap();
        refuses(folder.path(), &headless, expected);
    }
}
