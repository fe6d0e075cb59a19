//! The page's requests over a real socket: what is listed starts, and nothing else.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::Mutex;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use glisson::progress::tell;
use glisson_runtime::{OpenScene, Simulation};
use serde_json::{Value, json};

use super::{Choice, Chosen, StartPage, serve};
use crate::server::access::Access;
use crate::server::bind;

const SCENE: &str = "glisson_scene = 1\nname = \"a block\"\n[organ]\nbox = { min = [0, 0, 0], max = [\"1 cm\", \"1 cm\", \"1 cm\"] }\n\
    edge = \"5 mm\"\ntissue = \"liver\"\nmodel = \"precomputed\"\n[[organ.fixed]]\nfurthest = { direction = [0, 1, 0], fraction = 0.2 }\n\
    [tool]\ntip_radius = \"5 mm\"\nhome_tip = [0, 0, \"9 cm\"]\nhome_shaft = [0, 0, 1]\n";
const TOKEN: &str = "a-token-of-some-length";

/// The page of a folder; what is chosen is told, and made when the test says so.
struct Page {
    address: SocketAddr,
    folder: tempfile::TempDir,
    chosen: Receiver<Choice>,
    make: Sender<bool>,
    stop: Option<tokio::sync::oneshot::Sender<()>>,
    server: JoinHandle<anyhow::Result<Option<Chosen>>>,
}

impl Page {
    fn start(token: Option<&str>) -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("scenes")).unwrap();
        for file in ["scenes/block.toml", "outside.toml"] {
            std::fs::write(folder.path().join(file), SCENE).unwrap();
        }
        let listener = bind("127.0.0.1", 0).unwrap();
        let address = listener.local_addr().unwrap();
        let access = Access::for_address(address.ip(), token.map(str::to_owned)).unwrap();
        let (told, chosen) = channel();
        let (make, made) = channel::<bool>();
        let made = Mutex::new(made);
        let block = folder.path().join("scenes/block.toml");
        let open = move |choice: &Choice| {
            tell(0.5);
            told.send(choice.clone())?;
            loop {
                tell(0.5);
                match made.lock().unwrap().recv_timeout(Duration::from_millis(10)) {
                    Ok(true) => return Simulation::open(OpenScene::read(&block)?, None),
                    Ok(false) => anyhow::bail!("the organ is too small"),
                    Err(_) => {}
                }
            }
        };
        let page = StartPage {
            folders: vec![folder.path().join("scenes")],
            sessions: Some(folder.path().join("sessions")),
            open: Box::new(open),
            error: Some("before".into()),
        };
        let (stop, stopped) = tokio::sync::oneshot::channel();
        let server = std::thread::spawn(move || serve(listener, access, page, async { drop(stopped.await) }));
        Self { address, folder, chosen, make, stop: Some(stop), server }
    }

    fn ask(&self, method: &str, path: &str, more: &str, body: &str) -> (u16, String) {
        let mut stream = TcpStream::connect(self.address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        let host = self.address;
        write!(
            stream,
            "{method} {path} HTTP/1.1\r\nHost: {host}\r\n{more}Content-Length: {}\r\nConnection: close\r\n\r\n{body}",
            body.len()
        )
        .unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        let answer = String::from_utf8_lossy(&answer).into_owned();
        let (head, body) = answer.split_once("\r\n\r\n").unwrap();
        (head[9..12].parse().unwrap(), body.to_owned())
    }

    fn post(&self, what: &str, choice: &Value) -> (u16, String) {
        let kind = "Content-Type: application/json\r\n";
        self.ask("POST", &format!("/api/start/{what}"), kind, &choice.to_string())
    }

    fn get(&self, path: &str) -> Value {
        let (status, body) = self.ask("GET", path, "", "");
        assert_eq!(status, 200, "{path}: {body}");
        serde_json::from_str(&body).unwrap()
    }

    /// The state when nothing is being made any more.
    fn at_rest(&self) -> Value {
        loop {
            let state = self.get("/api/page");
            if state["job"].is_null() {
                return state;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    fn file(&self, name: &str) -> String {
        self.folder.path().join("scenes").join(name).to_str().unwrap().to_owned()
    }
}

#[test]
fn what_is_listed_is_started_and_a_second_page_sees_that_it_is() {
    let page = Page::start(None);
    assert_eq!(
        page.get("/api/page"),
        json!({"page": "start", "job": null, "error": "before", "is_ready": false})
    );
    let offers = page.get("/api/start");
    assert_eq!(offers["tasks"].as_array().unwrap().len(), glisson_runtime::tasks::TASKS.len());
    assert_eq!(offers["scenes"].as_array().unwrap().len(), 1);
    assert_eq!(offers["scenes"][0]["file"], page.file("block.toml"));
    assert_eq!(offers["scenes"][0]["name"], "a block");
    let asked = json!({"name": "palpation", "demonstrate": true, "patient": 4, "level": "hard"});
    assert_eq!(page.post("task", &asked).0, 202);
    let variant = glisson::scene::Choice { patient: Some(4), level: Some("hard".into()) };
    assert_eq!(page.chosen.recv().unwrap(), Choice::Task { name: "palpation", demonstrate: true, variant });
    let job = page.get("/api/page");
    assert_eq!(job["job"]["share"], 0.5);
    assert_eq!(job["error"], Value::Null);
    let what = job["job"]["what"].as_str().unwrap();
    for (step, choice) in [("scene", json!({"file": page.file("block.toml")})), ("patient", json!({}))] {
        let (status, words) = page.post(step, &choice);
        assert_eq!(status, 409);
        assert!(words.contains(what) && words.contains("wait, or cancel"), "{words}");
    }
    page.make.send(true).unwrap();
    let Some(Chosen::Simulation(simulation)) = page.server.join().unwrap().unwrap() else { panic!("none") };
    assert_eq!(simulation.world().spec().name, "a block");
}

#[test]
fn what_is_not_in_the_folders_is_not_started() {
    let page = Page::start(None);
    let inside = page.folder.path().join("scenes");
    let inside = inside.to_str().unwrap();
    for file in [
        format!("{inside}/../outside.toml"),
        page.folder.path().join("outside.toml").to_str().unwrap().to_owned(),
        format!("{inside}/./block.toml"),
        format!("{inside}//block.toml"),
        "block.toml".into(),
        "../scenes/block.toml".into(),
        "/etc/passwd".into(),
        String::new(),
    ] {
        let (status, words) = page.post("scene", &json!({ "file": file }));
        assert_eq!(status, 404, "{file}");
        assert!(words.contains("no scene"), "{words}");
    }
    for name in ["palpation.toml", "../tasks/palpation", "", "Palpation"] {
        assert_eq!(page.post("task", &json!({ "name": name })).0, 404, "{name}");
    }
    // What is no choice at all, and what another site's form could send.
    assert_eq!(page.post("task", &json!({"name": "palpation", "file": "x"})).0, 422);
    assert_eq!(page.post("patient", &json!({"x": 1})).0, 422);
    let form = "Content-Type: application/x-www-form-urlencoded\r\n";
    assert_eq!(page.ask("POST", "/api/start/task", form, "name=palpation").0, 415);
    assert_eq!(page.ask("POST", "/api/start/patient", "", "").0, 415);
    let foreign = "Content-Type: application/json\r\nOrigin: http://elsewhere.example\r\n";
    assert_eq!(page.ask("POST", "/api/start/task", foreign, "{\"name\":\"palpation\"}").0, 403);
    assert!(page.chosen.try_recv().is_err());
    assert!(page.get("/api/page")["job"].is_null());
    // And what is in it still is.
    assert_eq!(page.post("scene", &json!({"file": page.file("block.toml")})).0, 202);
    assert_eq!(page.chosen.recv().unwrap(), Choice::Scene { path: page.file("block.toml").into() });
}

#[test]
fn only_who_knows_the_token_lists_and_starts() {
    let page = Page::start(Some(TOKEN));
    for (method, path) in [
        ("GET", "/"),
        ("GET", "/api/page"),
        ("GET", "/api/start"),
        ("POST", "/api/start/task"),
        ("POST", "/api/start/patient"),
    ] {
        let (status, words) =
            page.ask(method, path, "Content-Type: application/json\r\n", "{\"name\":\"palpation\"}");
        assert_eq!(status, 401, "{path}");
        assert!(!words.contains(TOKEN) && !words.contains("block"), "{words}");
    }
    let known = format!("Content-Type: application/json\r\nCookie: glisson_token={TOKEN}\r\n");
    assert_eq!(page.ask("POST", "/api/start/task", &known, "{\"name\":\"palpation\"}").0, 202);
}

#[test]
fn what_goes_wrong_is_told_and_what_is_cancelled_makes_room() {
    let page = Page::start(None);
    let choice = json!({"file": page.file("block.toml")});
    assert_eq!(page.post("scene", &choice).0, 202);
    page.make.send(false).unwrap();
    let error = page.at_rest()["error"].as_str().unwrap().to_owned();
    assert!(error.contains("block.toml: the organ is too small"), "{error}");
    assert_eq!(page.post("scene", &choice).0, 202);
    assert_eq!(page.post("cancel", &json!({})).0, 202);
    assert_eq!(page.at_rest(), json!({"page": "start", "job": null, "error": null, "is_ready": false}));
    assert_eq!(page.post("patient", &json!({})).0, 202);
    assert!(matches!(page.server.join().unwrap().unwrap(), Some(Chosen::Patient)));
}

#[test]
fn it_stops_while_something_is_being_made_and_while_somebody_says_nothing() {
    let mut page = Page::start(None);
    let mut slow = TcpStream::connect(page.address).unwrap();
    write!(slow, "GET /api/page HTTP/1.1\r\n").unwrap();
    assert_eq!(page.post("task", &json!({"name": "palpation"})).0, 202);
    page.chosen.recv().unwrap();
    page.stop.take().unwrap().send(()).unwrap();
    assert!(page.server.join().unwrap().unwrap().is_none());
}

#[test]
fn somebody_who_says_nothing_does_not_keep_what_was_started() {
    let page = Page::start(None);
    let mut slow = TcpStream::connect(page.address).unwrap();
    write!(slow, "GET /api/page HTTP/1.1\r\n").unwrap();
    assert_eq!(page.post("patient", &json!({})).0, 202);
    let begin = std::time::Instant::now();
    while !page.server.is_finished() {
        assert!(begin.elapsed() < Duration::from_secs(15));
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[cfg(unix)]
#[test]
fn a_link_in_a_folder_starts_nothing_outside_it() {
    let page = Page::start(None);
    let link = page.folder.path().join("scenes/link.toml");
    std::os::unix::fs::symlink(page.folder.path().join("outside.toml"), &link).unwrap();
    assert_eq!(page.post("scene", &json!({"file": page.file("link.toml")})).0, 404);
}
