//! `glisson start`: a page of what there is, what is chosen at the same address, and the page again.

use super::{SCENE, files, refuses, small_scene};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};
use tungstenite::Message;

/// A debug build of the organs on a busy machine.
const LONGEST: Duration = Duration::from_secs(120);

/// The running program.
pub(super) struct Program {
    child: Child,
    output: BufReader<ChildStdout>,
    address: String,
}

impl Program {
    fn start(folder: &Path, arguments: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_glisson"));
        Self::serving(command.arg("start").args(arguments).current_dir(folder)).0
    }

    /// A command that serves, and what it printed before it said where.
    pub(super) fn serving(command: &mut Command) -> (Self, String) {
        let command = command.args(["--port", "0", "--no-open"]).stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let output = BufReader::new(child.stdout.take().unwrap());
        let mut program = Self { child, output, address: String::new() };
        let mut before = String::new();
        loop {
            let mut line = String::new();
            assert!(program.output.read_line(&mut line).unwrap() > 0, "it ended: {before}");
            if let Some(address) = line.split("http://").nth(1) {
                address.split('/').next().unwrap().clone_into(&mut program.address);
                return (program, before);
            }
            before += &line;
        }
    }

    /// As a crash ends it.
    pub(super) fn kill(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    /// Where it is served.
    pub(super) fn address(&self) -> &str {
        &self.address
    }

    /// Status and body; none while nobody answers, between two pages.
    pub(super) fn ask(&self, method: &str, path: &str, body: &str) -> Option<(u16, String)> {
        let mut stream = TcpStream::connect(&self.address).ok()?;
        stream.set_read_timeout(Some(Duration::from_secs(30))).ok()?;
        write!(
            stream,
            "{method} {path} HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: {}\r\n\
             Connection: close\r\n\r\n{body}",
            body.len()
        )
        .ok()?;
        let mut answer = String::new();
        stream.read_to_string(&mut answer).ok()?;
        let (head, body) = answer.split_once("\r\n\r\n")?;
        Some((head.get(9..12)?.parse().ok()?, body.to_owned()))
    }

    pub(super) fn begin(&self, what: &str, choice: &Value) -> u16 {
        self.ask("POST", &format!("/api/start/{what}"), &choice.to_string()).unwrap().0
    }

    /// What is served when it is `page`.
    pub(super) fn when_at(&self, page: &str) -> Value {
        let begin = Instant::now();
        loop {
            let answer = self.ask("GET", "/api/page", "").filter(|(status, _)| *status == 200);
            let state: Value = answer.map_or(Value::Null, |(_, body)| serde_json::from_str(&body).unwrap());
            if state["page"] == page && state["job"].is_null() && state["is_ready"] != true {
                return state;
            }
            assert!(begin.elapsed() < LONGEST, "{page}: {state}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Ends the simulation as the page in control does.
    pub(super) fn leave(&self) {
        let (mut socket, _) = tungstenite::connect(format!("ws://{}/ws", self.address)).unwrap();
        let mut next = || match socket.read().unwrap() {
            Message::Text(text) => serde_json::from_str::<Value>(&text).unwrap(),
            _ => Value::Null,
        };
        let mut hello = next();
        while hello["type"] != "hello" {
            hello = next();
        }
        assert_eq!(hello["can_leave"], true);
        while next()["role"] != "controller" {}
        // Some steps at least.
        while next()["type"] != "timing" {}
        socket.send(Message::text(r#"{"type":"leave"}"#)).unwrap();
    }

    /// Ctrl-C; answers what it still printed.
    pub(super) fn interrupt(self) -> String {
        let (succeeded, text) = self.interrupted();
        assert!(succeeded, "{text}");
        text
    }

    /// The same, and whether it says that all went well.
    pub(super) fn interrupted(mut self) -> (bool, String) {
        let pid = self.child.id().to_string();
        assert!(Command::new("kill").args(["-INT", &pid]).status().unwrap().success());
        let mut text = String::new();
        self.output.read_to_string(&mut text).unwrap();
        (self.child.wait().unwrap().success(), text)
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        // Where the test failed it still runs.
        let _ = self.child.kill();
    }
}

#[test]
fn what_is_chosen_is_served_and_recorded_and_then_the_page_comes_again() {
    let folder = tempfile::tempdir().unwrap();
    small_scene(folder.path());
    std::fs::write(folder.path().join("bad.toml"), SCENE.replace("poisson_ratio", "poisson_rato")).unwrap();
    std::fs::write(folder.path().join("gone.toml"), SCENE.replace("body.tet", "gone.tet")).unwrap();
    let program = Program::start(folder.path(), &[]);
    program.when_at("start");
    let (status, page) = program.ask("GET", "/", "").unwrap();
    assert_eq!(status, 200);
    assert!(page.contains("Glisson"), "{page}");
    let offers: Value = serde_json::from_str(&program.ask("GET", "/api/start", "").unwrap().1).unwrap();
    let names = |key: &str, name: &str| -> Vec<String> {
        offers[key].as_array().unwrap().iter().map(|line| line[name].as_str().unwrap().to_owned()).collect()
    };
    assert!(names("tasks", "name").contains(&"palpation".to_owned()));
    assert_eq!(names("scenes", "file"), ["bad.toml", "gone.toml", "scene.toml"]);
    assert!(offers["scenes"][0]["error"].as_str().unwrap().contains("did you mean \"poisson_ratio\""));

    // What cannot be made is told, and something else can be.
    assert_eq!(program.begin("scene", &json!({"file": "gone.toml"})), 202);
    let error = program.when_at("start")["error"].as_str().unwrap().to_owned();
    assert!(error.contains("gone.tet"), "{error}");
    assert_eq!(program.begin("scene", &json!({"file": "../scene.toml"})), 404);
    for n in [1, 2] {
        assert_eq!(program.begin("scene", &json!({"file": "scene.toml"})), 202);
        program.when_at("viewer");
        program.leave();
        assert!(program.when_at("start")["error"].is_null());
        assert_eq!(files(&folder.path().join("out/sessions")).len(), n);
    }
    assert_eq!(program.begin("task", &json!({"name": "palpation", "demonstrate": true})), 202);
    program.when_at("viewer");
    let text = program.interrupt();
    assert!(text.contains("glisson replay out/sessions/scene-2.jsonl --folder ."), "{text}");
    assert!(text.contains("left; state hash") && text.contains("stopped; state hash"), "{text}");

    let sessions = folder.path().join("out/sessions");
    assert_eq!(files(&sessions), ["palpation.jsonl", "scene-2.jsonl", "scene.jsonl"]);
    let replay = super::glisson(folder.path(), &["replay", "out/sessions/scene-2.jsonl", "--folder", "."]);
    let replay = String::from_utf8_lossy(&replay.stdout).into_owned();
    assert!(replay.contains("same bits"), "{replay}");
}

#[test]
fn the_page_for_a_new_patient_leads_back_and_ctrl_c_ends_all_of_them() {
    let folder = tempfile::tempdir().unwrap();
    let program = Program::start(folder.path(), &["--scenes", "."]);
    program.when_at("start");
    assert_eq!(program.begin("patient", &json!({})), 202);
    program.when_at("patient");
    assert_eq!(program.ask("POST", "/api/patient/leave", "{}").unwrap().0, 202);
    program.when_at("start");
    assert_eq!(program.begin("patient", &json!({})), 202);
    program.when_at("patient");
    program.interrupt();
    let program = Program::start(folder.path(), &[]);
    program.when_at("start");
    program.interrupt();
    refuses(folder.path(), &["start", "--scenes", "gone"], &["--scenes gone", "no such folder"]);
}
