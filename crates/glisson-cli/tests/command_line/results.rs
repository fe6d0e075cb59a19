//! `glisson results`, and what `glisson task run --person` stores: also where the database is locked, refuses, or is used twice at
//! once, and where the server is stopped or killed.

use super::export::pages_are_built;
use super::tasks::{TASK, text_of};
use super::{command, files, glisson, refuses};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};
use tungstenite::WebSocket;
use tungstenite::stream::MaybeTlsStream;

const DATABASE: &str = "glisson-results.sqlite";
const HEADLESS: [&str; 6] = ["task", "run", "own.toml", "--headless", "--out", "made"];

/// A folder with a task whose demonstration passes.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("own.toml"), TASK).unwrap();
    folder
}

fn run(folder: &Path, more: &[&str]) -> (Option<i32>, String, String) {
    let output = glisson(folder, &[&HEADLESS[..], more].concat());
    (output.status.code(), text_of(&output.stdout), text_of(&output.stderr))
}

/// What `glisson results` prints.
fn results(folder: &Path, arguments: &[&str]) -> String {
    let output = glisson(folder, &[&["results"], arguments].concat());
    assert!(output.status.success(), "{arguments:?}: {}", text_of(&output.stderr));
    text_of(&output.stdout)
}

/// The only file in `made` whose name ends so.
fn made(folder: &Path, ending: &str) -> String {
    let names = files(&folder.join("made"));
    let mut found = names.iter().filter(|name| name.ends_with(ending));
    let name = found.next().unwrap_or_else(|| panic!("no file {ending} in {names:?}"));
    assert!(found.next().is_none(), "several files {ending} in {names:?}");
    format!("made/{name}")
}

#[test]
fn a_persons_results_are_stored_compared_exported_and_forgotten() {
    let folder = folder();
    let at = folder.path();
    for person in ["Ada", "Ben", "Cleo", "Dan", "Me", "Me"] {
        let (code, _, error) = run(at, &["--person", person]);
        assert_eq!(code, Some(0), "{error}");
        assert!(error.contains(&format!("of {person} in {DATABASE}")), "{error}");
    }
    // Each run has files of its own, which do not name who it was.
    let names = files(&at.join("made"));
    assert_eq!(names.len(), 6 * 3, "{names:?}");
    assert!(!names.iter().any(|name| name.contains("Ada")));
    let list = results(at, &["list", "--person", "Me"]);
    assert_eq!(list.lines().count(), 1 + 2, "{list}");
    assert!(list.contains("Me") && list.contains("own") && list.contains("passed"), "{list}");

    assert!(results(at, &["group", "list"]).contains("there is no group"));
    let said = results(at, &["group", "add", "experts", "Ada", "Ben", "Cleo", "Dan"]);
    assert_eq!(said, "experts: Ada, Ben, Cleo, Dan\n");
    assert!(results(at, &["people"]).contains("Ada: 1 results, in experts"));
    // All did the same: the demonstration.
    let shown = results(at, &["show", "6", "--group", "experts"]);
    assert!(shown.contains("experts: 4 people other than Me have passed this task\n"), "{shown}");
    let time = shown.lines().find(|line| line.starts_with("  Time: ")).unwrap();
    assert!(time.contains("quartiles") && time.ends_with(": as the group"), "{time}");
    let few = results(at, &["show", "1", "--group", "experts"]);
    assert!(few.contains("3 people other than Ada have passed this task; quartiles need 4"), "{few}");

    let of = ["curve", "--person", "Me", "--task", "own", "--metric"];
    let curve =
        results(at, &[&of[..], &["peak_force", "--group", "experts", "--out", "new/curve.svg"]].concat());
    assert!(curve.contains("Greatest force (probe): 2 attempts, 2 of them done"), "{curve}");
    let svg = std::fs::read_to_string(at.join("new/curve.svg")).unwrap();
    assert!(svg.contains("third quartile") && svg.contains("greatest force [N]"));
    refuses(
        at,
        &[&["results"], &of[..], &["peak_fource"]].concat(),
        &["peak_fource", "did you mean \"peak_force\"?"],
    );

    results(at, &["export", "--csv", "all.csv"]);
    let csv = std::fs::read_to_string(at.join("all.csv")).unwrap();
    assert!(
        csv.starts_with("result,person,task,title,scene_hash,")
            && csv.contains("\r\n6,Me,own,Press <here> & there,")
    );
    results(at, &["export", "--json", "me.json", "--person", "Me"]);
    let said = results(at, &["import", "me.json", "--database", "other.sqlite"]);
    assert!(said.contains("Me at own stored as result 1") && said.contains("stored as result 2"), "{said}");
    let again = results(at, &["import", "me.json", "--database", "other.sqlite"]);
    assert!(again.contains("is there already, as result 1"), "{again}");
    assert_eq!(results(at, &["list", "--database", "other.sqlite"]).lines().count(), 1 + 2);

    refuses(at, &["results", "forget", "Ben"], &["Ben with 1 results would be removed; add --yes"]);
    let said = results(at, &["forget", "Ben", "--yes"]);
    assert!(said.contains("removed Ben with 1 results") && said.contains(".jsonl"), "{said}");
    refuses(at, &["results", "delete", "5"], &["add --yes"]);
    results(at, &["delete", "5", "--yes"]);
    let left = results(at, &["list"]);
    assert!(left.lines().count() == 1 + 4 && !left.contains("Ben"), "{left}");
    assert_eq!(results(at, &["group", "list"]), "experts: Ada, Cleo, Dan\n");
}

#[test]
fn a_report_has_the_group_the_curves_and_links_into_the_replay() {
    let folder = folder();
    let at = folder.path();
    // A touch that lasts, so that the threshold is exceeded: a moment to look at.
    let text = TASK
        .replace("touch = {}", "hold = \"50 ms\"\ntouch = {}")
        .replace("[[task.stage]]", "force_threshold = \"1 mN\"\n[[task.stage]]");
    std::fs::write(at.join("own.toml"), text).unwrap();
    for person in ["Ada", "Ben", "Cleo", "Dan", "Me"] {
        assert_eq!(run(at, &["--person", person]).0, Some(0));
        if person != "Me" {
            results(at, &["group", "add", "experts", person]);
        }
    }
    std::fs::remove_dir_all(at.join("made")).unwrap();
    let replay: &[&str] = if pages_are_built() { &["--replay"] } else { &[] };
    let (code, out, error) = run(at, &[&["--person", "Me", "--group", "experts"], replay].concat());
    assert_eq!(code, Some(0), "{error}");
    let report = match replay {
        [] => made(at, ".html"),
        _ => made(at, "_replay.html").replace("_replay.html", ".html"),
    };
    let html = std::fs::read_to_string(at.join(&report)).unwrap();
    for expected in [
        "Me, result 6",
        "Beside the group \"experts\": 4 people",
        "<rect ",
        "as the group",
        "Learning curves",
        "third quartile",
    ] {
        assert!(html.contains(expected), "no {expected} in the report");
    }
    if !replay.is_empty() {
        let page = made(at, "_replay.html");
        assert!(out.contains(&page), "{out}");
        let name = page.strip_prefix("made/").unwrap();
        let (_, link) =
            html.split_once(&format!("<a href=\"{name}#t=")).expect("a moment leads to the replay");
        let time_s: f64 = link.split_once('"').unwrap().0.parse().unwrap();
        let json: serde_json::Value = serde_json::from_str(
            &std::fs::read_to_string(at.join(report.replace(".html", ".json"))).unwrap(),
        )
        .unwrap();
        let number = |value: &serde_json::Value| value.as_f64().unwrap();
        let at_s = number(&json["result"]["began_s"]) + number(&json["result"]["moments"][0]["from_s"]);
        assert!((time_s - at_s).abs() < 0.01, "{time_s} is not {at_s}");
    }
}

#[test]
fn without_a_person_nothing_is_stored_and_the_file_can_be_imported_later() {
    let folder = folder();
    let at = folder.path();
    assert_eq!(run(at, &[]).0, Some(0));
    assert_eq!(files(at), ["made", "own.toml"]);
    refuses(at, &["results", "list"], &[DATABASE, "no database of results yet", "--person NAME"]);
    refuses(at, &["results", "import", "made/own.json"], &["made/own.json", "no person", "--person NAME"]);
    refuses(
        at,
        &["results", "import", "made/own.jsonl", "--person", "Ada"],
        &["made/own.jsonl", "it is no result"],
    );
    let said = results(at, &["import", "made/own.json", "--person", "Ada"]);
    assert_eq!(said, "made/own.json: Ada at own stored as result 1\n");
    assert!(results(at, &["list"]).contains("Ada"));
    // The variable names another database, and the command line goes before it.
    let people = |more: &[&str]| {
        let output = command(at, &[&["results", "people"], more].concat())
            .env("GLISSON_RESULTS", "else.sqlite")
            .output();
        text_of(&output.unwrap().stderr)
    };
    assert!(people(&[]).contains("else.sqlite: there is no database of results yet"));
    assert_eq!(people(&["--database", DATABASE]), "");
    // What was stored at once is not stored again.
    std::fs::remove_dir_all(at.join("made")).unwrap();
    assert_eq!(run(at, &["--person", "Ben"]).0, Some(0));
    let said = results(at, &["import", &made(at, ".json")]);
    assert!(said.ends_with("Ben at own is there already, as result 2\n"), "{said}");
}

#[test]
fn what_is_wrong_is_known_before_the_work() {
    let folder = folder();
    let at = folder.path();
    let with = |more: &[&'static str]| [&HEADLESS[..], more].concat();
    refuses(at, &with(&["--person", " "]), &["--person", "name is empty"]);
    refuses(at, &with(&["--person", "=1"]), &["begins with '='"]);
    refuses(
        at,
        &with(&["--person", "Ada", "--database", "gone/r.sqlite"]),
        &["gone/r.sqlite", "make its folder"],
    );
    refuses(
        at,
        &with(&["--person", "Ada", "--database", "own.toml"]),
        &["own.toml", "no database of results"],
    );
    assert_eq!(glisson(at, &with(&["--group", "experts"])).status.code(), Some(2), "a group needs a person");
    assert!(!at.join("made").exists());
    assert_eq!(run(at, &["--person", "Ada"]).0, Some(0));
    refuses(at, &with(&["--person", "Ada", "--group", "experts"]), &["no group \"experts\""]);
    let newer = rusqlite::Connection::open(at.join(DATABASE)).unwrap();
    newer.pragma_update(None, "user_version", 7).unwrap();
    refuses(at, &["results", "list"], &[DATABASE, "version 7", "newer program"]);
    refuses(at, &with(&["--person", "Ada"]), &["version 7"]);
}

#[test]
fn a_result_that_cannot_be_stored_is_in_a_file_that_can_be_imported() {
    let folder = folder();
    let at = folder.path();
    assert_eq!(run(at, &["--person", "Ada"]).0, Some(0));
    let database = rusqlite::Connection::open(at.join(DATABASE)).unwrap();
    let refusing =
        "CREATE TRIGGER refusing BEFORE INSERT ON result BEGIN SELECT RAISE (ABORT, 'no more'); END";
    database.execute_batch(refusing).unwrap();
    let (code, _, error) = run(at, &["--person", "Ben"]);
    assert_eq!(code, Some(1), "{error}");
    let file = made(at, "_not_stored.json");
    assert!(error.contains("the result is not stored") && error.contains("no more"), "{error}");
    assert!(error.contains(&format!("glisson results import {file}")), "{error}");
    assert!(!results(at, &["people"]).contains("Ben"));
    database.execute_batch("DROP TRIGGER refusing").unwrap();
    assert!(results(at, &["import", &file]).contains("Ben at own stored as result 2"));
}

#[test]
fn a_locked_database_is_named() {
    let folder = folder();
    let at = folder.path();
    assert_eq!(run(at, &["--person", "Ada"]).0, Some(0));
    let other = rusqlite::Connection::open(at.join(DATABASE)).unwrap();
    other.execute_batch("BEGIN EXCLUSIVE").unwrap();
    let output = glisson(at, &["results", "list"]);
    let error = text_of(&output.stderr);
    assert_eq!(output.status.code(), Some(1));
    assert!(error.contains(DATABASE) && error.contains("another program has the database locked"), "{error}");
    drop(other);
    assert!(results(at, &["list"]).contains("Ada"));
}

#[test]
fn two_programs_store_into_one_database_at_once() {
    let folder = folder();
    let at = folder.path();
    let start = |person| {
        command(at, &[&HEADLESS[..], &["--person", person]].concat())
            .stderr(Stdio::piped())
            .stdout(Stdio::null())
            .spawn()
            .unwrap()
    };
    let running: Vec<Child> = ["Ada", "Ben", "Ada", "Ben"].into_iter().map(start).collect();
    for child in running {
        let output = child.wait_with_output().unwrap();
        assert!(output.status.success(), "{}", text_of(&output.stderr));
    }
    assert_eq!(results(at, &["people"]), "Ada: 2 results\nBen: 2 results\n");
}

/// A task in the browser that its demonstration does, without a browser.
struct Served {
    child: Child,
    /// Open as long as the program writes to it.
    _told: BufReader<ChildStdout>,
    /// Who looks: the demonstration waits for somebody.
    _viewer: WebSocket<MaybeTlsStream<TcpStream>>,
    address: String,
}

impl Served {
    fn start(folder: &Path, more: &[&str]) -> Self {
        let arguments =
            ["task", "run", "own.toml", "--out", "made", "--demonstrate", "--port", "0", "--no-open"];
        let mut child = command(folder, &[&arguments[..], more].concat())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut told = BufReader::new(child.stdout.take().unwrap());
        // The database says who is new in it first.
        let address = told.by_ref().lines().map_while(Result::ok).find_map(|line| {
            let rest = line.split("http://").nth(1)?;
            Some(rest.split('/').next()?.to_owned())
        });
        let address = address.expect("an address");
        let (viewer, _) = tungstenite::connect(format!("ws://{address}/ws")).unwrap();
        Self { child, _told: told, _viewer: viewer, address }
    }

    fn get(&self, path: &str) -> String {
        let mut stream = TcpStream::connect(&self.address).unwrap();
        let request = format!("GET {path} HTTP/1.1\r\nHost: {}\r\nConnection: close\r\n\r\n", self.address);
        stream.write_all(request.as_bytes()).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer
    }

    /// Asks until the answer has `expected`.
    fn wait_for(&self, path: &str, expected: &str) -> String {
        for _ in 0..600 {
            let answer = self.get(path);
            if answer.contains(expected) {
                return answer;
            }
            std::thread::sleep(std::time::Duration::from_millis(50));
        }
        panic!("{path} never has {expected}: {}", self.get(path));
    }

    fn signal(mut self, name: &str) -> Option<i32> {
        let id = self.child.id().to_string();
        assert!(Command::new("kill").args([name, &id]).status().unwrap().success());
        self.child.wait().unwrap().code()
    }
}

#[test]
fn a_task_in_the_browser_is_stored_once_when_it_ends_and_the_report_compares() {
    let folder = folder();
    let at = folder.path();
    for person in ["Ada", "Ben", "Cleo", "Dan"] {
        assert_eq!(run(at, &["--person", person]).0, Some(0));
        results(at, &["group", "add", "experts", person]);
    }
    let served = Served::start(at, &["--person", "Me", "--group", "experts"]);
    let report = served.wait_for("/report", "<h1>");
    for expected in ["Passed", "Me, result 5", "Beside the group \"experts\": 4 people", "<rect "] {
        assert!(report.contains(expected), "no {expected} in {report}");
    }
    assert!(served.get("/report").contains("Me, result 5"));
    assert_eq!(served.signal("-TERM"), Some(0));
    let list = results(at, &["list", "--person", "Me"]);
    assert!(list.lines().count() == 2 && list.contains("passed"), "{list}");
}

#[test]
fn a_server_that_is_stopped_keeps_what_was_begun_and_one_that_is_killed_harms_nothing() {
    let folder = folder();
    let at = folder.path();
    // It ends nowhere.
    let far = TASK.replace("touch = {}", "reach = { point = [0, 0, \"9 cm\"], within = \"1 mm\" }");
    std::fs::write(at.join("own.toml"), far).unwrap();
    let served = Served::start(at, &["--person", "Ada"]);
    served.wait_for("/api/snapshot", "\"time_s\":4.");
    assert_eq!(served.signal("-TERM"), Some(0));
    let list = results(at, &["list"]);
    assert!(list.lines().count() == 2 && list.contains("broken off"), "{list}");

    let served = Served::start(at, &["--person", "Ada"]);
    served.wait_for("/api/snapshot", "\"time_s\":4.");
    assert_eq!(served.signal("-KILL"), None);
    assert_eq!(results(at, &["list"]), list);
    // What was recorded until then is there.
    let cut_off = made(at, ".partial");
    assert!(std::fs::metadata(at.join(cut_off)).unwrap().len() > 1000);
    let served = Served::start(at, &["--person", "Ada"]);
    served.wait_for("/api/snapshot", "\"time_s\":4.");
    assert_eq!(served.signal("-TERM"), Some(0));
    assert_eq!(results(at, &["list"]).lines().count(), 3);
}
