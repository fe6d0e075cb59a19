//! The program is killed in mid-session, and goes on; the disk is full; two programs record the same.

use super::start::Program;
use super::{files, glisson, refuses, small_scene};
use serde_json::{Value, json};
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};
use tungstenite::Message;

/// A debug build on a busy machine.
const LONGEST: Duration = Duration::from_secs(120);

fn serve(folder: &Path, arguments: &[&str]) -> (Program, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_glisson"));
    Program::serving(command.args(["serve", "scene.toml"]).args(arguments).current_dir(folder))
}

/// What `glisson replay` says.
fn replayed(folder: &Path, session: &str) -> String {
    String::from_utf8(glisson(folder, &["replay", session]).stdout).unwrap()
}

fn snapshot(program: &Program) -> Value {
    serde_json::from_str(&program.ask("GET", "/api/snapshot", "").unwrap().1).unwrap()
}

fn time_s(program: &Program) -> f64 {
    snapshot(program)["time_s"].as_f64().unwrap()
}

/// Waits until so much simulated time has passed; answers how much [s].
fn simulated(program: &Program, wanted_s: f64) -> f64 {
    let begin = Instant::now();
    loop {
        let now_s = time_s(program);
        if now_s >= wanted_s {
            return now_s;
        }
        assert!(begin.elapsed() < LONGEST, "{now_s} of {wanted_s} s");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Lets time pass, as the page in control does.
fn unpause(program: &Program) {
    let (mut socket, _) = tungstenite::connect(format!("ws://{}/ws", program.address())).unwrap();
    while !matches!(socket.read().unwrap(), Message::Text(text) if text.contains("controller")) {}
    socket.send(Message::text(r#"{"type":"pause","paused":false}"#)).unwrap();
    while !matches!(socket.read().unwrap(), Message::Text(text) if text.contains("timing")) {}
}

#[test]
fn a_server_that_is_killed_loses_a_second_at_most_and_its_session_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    small_scene(folder);
    let (program, _) = serve(folder, &["--record", "s.jsonl"]);
    simulated(&program, 1.5);
    // Another one cannot write to the same file.
    refuses(
        folder,
        &["serve", "scene.toml", "--port", "0", "--no-open", "--record", "s.jsonl"],
        &["another program is recording"],
    );
    let seen_s = time_s(&program);
    program.kill();
    assert!(!folder.join("s.jsonl").exists());

    // The next one offers it, and leaves it beside.
    let (program, printed) = serve(folder, &["--record", "s.jsonl"]);
    assert!(printed.contains("was cut off") && printed.contains("--resume s.jsonl.partial"), "{printed}");
    program.kill();
    let kept = std::fs::read(folder.join("s-interrupted.jsonl")).unwrap();

    let (program, printed) = serve(folder, &["--record", "t.jsonl", "--resume", "s-interrupted.jsonl"]);
    assert!(printed.contains("it goes on from"), "{printed}");
    let resumed = snapshot(&program);
    assert_eq!(resumed["paused"], true);
    let resumed_s = resumed["time_s"].as_f64().unwrap();
    // No more simulated time than wall time is lost.
    assert!(seen_s - resumed_s < 1.0, "{resumed_s} s of {seen_s} s");
    unpause(&program);
    simulated(&program, resumed_s + 0.3);
    program.interrupt();
    let replayed = replayed(folder, "t.jsonl");
    assert!(replayed.contains("same bits as the recording"), "{replayed}");
    assert_eq!(std::fs::read(folder.join("s-interrupted.jsonl")).unwrap(), kept);

    std::fs::write(
        folder.join("other.toml"),
        std::fs::read_to_string(folder.join("scene.toml")).unwrap() + "# other\n",
    )
    .unwrap();
    refuses(
        folder,
        &[
            "serve",
            "other.toml",
            "--port",
            "0",
            "--no-open",
            "--record",
            "u.jsonl",
            "--resume",
            "s-interrupted.jsonl",
        ],
        &["a session of another scene"],
    );
}

#[test]
fn the_start_page_offers_what_was_cut_off_and_goes_on_with_it() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    small_scene(folder);
    let start = || {
        let mut command = Command::new(env!("CARGO_BIN_EXE_glisson"));
        Program::serving(command.arg("start").current_dir(folder)).0
    };
    let offers = |program: &Program| -> Value {
        serde_json::from_str(&program.ask("GET", "/api/start", "").unwrap().1).unwrap()
    };
    let program = start();
    program.when_at("start");
    assert_eq!(offers(&program)["sessions"], json!([]));
    let scene = offers(&program)["scenes"][0]["file"].clone();
    assert_eq!(program.begin("scene", &json!({ "file": scene })), 202);
    program.when_at("viewer");
    simulated(&program, 0.8);
    program.kill();

    let program = start();
    program.when_at("start");
    let sessions = offers(&program)["sessions"].clone();
    let session = sessions[0]["session"].as_str().unwrap().to_owned();
    assert!(session.ends_with(".jsonl") && sessions[0]["time_s"].as_f64().unwrap() > 0.0, "{sessions}");
    assert_eq!(program.begin("session", &json!({ "session": "../scene.jsonl" })), 404);
    assert_eq!(program.begin("session", &json!({ "session": session })), 202);
    program.when_at("viewer");
    let resumed = snapshot(&program);
    assert_eq!((&resumed["paused"], &resumed["time_s"]), (&json!(true), &sessions[0]["time_s"]));
    program.leave();
    program.when_at("start");
    // It is whole now, and the old one is beside it.
    assert_eq!(offers(&program)["sessions"], json!([]));
    let names = files(&folder.join("out/sessions"));
    assert_eq!(names.len(), 2, "{names:?}");
    program.interrupt();
}

#[test]
fn a_disk_that_is_full_ends_the_recording_and_not_the_simulation() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    small_scene(folder);
    // A file of 16 kB at most, and no signal that says so.
    let program = env!("CARGO_BIN_EXE_glisson");
    let limited =
        format!("trap '' XFSZ; ulimit -f 16; exec {program} serve scene.toml --record s.jsonl \"$@\"");
    let mut command = Command::new("bash");
    let (program, _) = Program::serving(command.args(["-c", &limited, "bash"]).current_dir(folder));
    let (mut socket, _) = tungstenite::connect(format!("ws://{}/ws", program.address())).unwrap();
    // A hand that trembles writes a line in each step.
    let begin = Instant::now();
    for n in 0_u32.. {
        assert!(begin.elapsed() < LONGEST);
        let x_m = 0.04 + 1e-3 * f64::from(n % 2);
        socket
            .send(Message::text(format!(r#"{{"type":"tool","tip_m":[{x_m},0.04,0.09],"shaft":[0,0,1]}}"#)))
            .unwrap();
        if let Message::Text(text) = socket.read().unwrap()
            && text.contains("not recorded any more")
        {
            assert!(text.contains("File too large") && text.contains("s.jsonl.partial"), "{text}");
            break;
        }
    }
    simulated(&program, time_s(&program) + 0.2);
    drop(socket);
    let (succeeded, printed) = program.interrupted();
    assert!(!succeeded, "{printed}");
    let replayed = replayed(folder, "s.jsonl.partial");
    assert!(replayed.contains("cut off"), "{replayed}");
}
