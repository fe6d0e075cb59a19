//! The server on real sockets: who gets in, who controls, what is too much.

use super::*;
use glisson::math::DVec3;
use glisson::tool::Tool;
use glisson_protocol::positions::{STEP_M, take_key, take_places};
use glisson_protocol::quantized::numbers::Taker;
use glisson_runtime::OpenScene;
use glisson_runtime::devices::open_standing;
use glisson_runtime::haptic_loop::join;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};
use tungstenite::client::IntoClientRequest;
use tungstenite::http::HeaderValue;
use tungstenite::{Message, WebSocket};

const MESH: &str = "4 1\n0 0 0\n60 0 0\n0 60 0\n0 0 60\n0 1 2 3\n";
const SCENE: &str = "glisson_scene = 1\n[organ]\nmesh = \"body.tet\"\nyoung_modulus = \"5 kPa\"\n\
    poisson_ratio = 0.45\ndensity = \"1000 kg/m3\"\nmodel = \"tensor_mass\"\ndamping = \"30 1/s\"\n\
    [[organ.fixed]]\nfurthest = { direction = [0, 0, -1], fraction = 0.75 }\n\
    [tool]\ntip_radius = \"5 mm\"\nhome_tip = [\"40 mm\", \"40 mm\", \"90 mm\"]\nhome_shaft = [0, 0, 1]\n";

struct Server {
    address: SocketAddr,
    stop: Option<tokio::sync::oneshot::Sender<()>>,
    thread: Option<std::thread::JoinHandle<anyhow::Result<Served>>>,
    has_loop: bool,
}

impl Server {
    fn start(token: Option<&str>) -> Self {
        Self::start_with(token, 1_000.0, |_| Vec::new())
    }

    /// With devices, which get the instruments, in a loop of so many ticks a second.
    fn start_with(
        token: Option<&str>,
        rate_hz: f64,
        held: impl FnOnce(&[Tool]) -> Vec<(HeldTool, ToolLink)>,
    ) -> Self {
        Self::start_so(token, rate_hz, false, held)
    }

    /// The same, where the page in control may end it.
    fn start_so(
        token: Option<&str>,
        rate_hz: f64,
        may_leave: bool,
        held: impl FnOnce(&[Tool]) -> Vec<(HeldTool, ToolLink)>,
    ) -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("body.tet"), MESH).unwrap();
        std::fs::write(folder.path().join("scene.toml"), SCENE).unwrap();
        let source = OpenScene::read(&folder.path().join("scene.toml")).unwrap();
        let simulation = Simulation::open(source, None).unwrap();
        let listener = bind("127.0.0.1", 0).unwrap();
        let address = listener.local_addr().unwrap();
        // As if it listened elsewhere, when there is a token.
        let access = Access::for_address(address.ip(), token.map(str::to_owned)).unwrap();
        let (stop, stopped) = tokio::sync::oneshot::channel();
        let held = held(simulation.world().tools());
        let has_loop = !held.is_empty();
        let thread = std::thread::spawn(move || {
            let haptics = HapticSettings { rate_hz, ..HapticSettings::default() };
            let service = Service { held, haptics, may_leave, ..Service::to(access) };
            serve(simulation, listener, service, async { drop(stopped.await) })
        });
        Self { address, stop: Some(stop), thread: Some(thread), has_loop }
    }

    fn request(&self, path: &str, headers: &[(&'static str, &str)]) -> Result<Viewer, u16> {
        let mut request = format!("ws://{}{path}", self.address).into_client_request().unwrap();
        for (name, value) in headers {
            request.headers_mut().insert(*name, HeaderValue::from_str(value).unwrap());
        }
        let stream = TcpStream::connect(self.address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
        match tungstenite::client(request, stream) {
            Ok((socket, _)) => Ok(Viewer(socket)),
            Err(tungstenite::HandshakeError::Failure(tungstenite::Error::Http(response))) => {
                Err(response.status().as_u16())
            }
            Err(error) => panic!("{error}"),
        }
    }

    fn connect(&self) -> Viewer {
        self.request("/ws", &[]).unwrap()
    }

    fn http(&self, head: &str) -> String {
        let mut stream = TcpStream::connect(self.address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
        write!(stream, "{head}\r\nConnection: close\r\n\r\n").unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        String::from_utf8_lossy(&answer).into_owned()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.stop.take().map(|stop| stop.send(()));
        // One that was left ended before.
        let Some(thread) = self.thread.take() else { return };
        let served = thread.join().unwrap().unwrap();
        assert_eq!(served.haptics.is_some(), self.has_loop);
    }
}

struct Viewer(WebSocket<TcpStream>);

impl Viewer {
    fn say(&mut self, text: &str) {
        self.0.send(Message::text(text)).unwrap();
    }

    /// The next text message of this type.
    fn hear(&mut self, kind: &str) -> serde_json::Value {
        loop {
            if let Message::Text(text) = self.0.read().unwrap() {
                let value: serde_json::Value = serde_json::from_str(&text).unwrap();
                if value["type"] == kind {
                    return value;
                }
            }
        }
    }

    /// The next SNAPSHOT frame.
    fn snapshot(&mut self) -> Vec<u8> {
        loop {
            if let Message::Binary(frame) = self.0.read().unwrap()
                && frame[4] == 2
            {
                return frame.to_vec();
            }
        }
    }

    /// The next SNAPSHOT frame; `key` becomes the last KEY frame that came.
    fn snapshot_with_key(&mut self, key: &mut Vec<u8>) -> Vec<u8> {
        loop {
            match self.0.read().unwrap() {
                Message::Binary(frame) if frame[4] == 2 => return frame.to_vec(),
                Message::Binary(frame) if frame[4] == 3 => *key = frame.to_vec(),
                _ => {}
            }
        }
    }

    fn role(&mut self) -> String {
        self.hear("role")["role"].as_str().unwrap().to_owned()
    }

    /// What the server says when it ends the connection.
    fn end(&mut self) -> String {
        // Who cannot answer a ping any more may still read: after an error for each frame that was under way.
        let mut n_unanswered = 0;
        loop {
            match self.0.read() {
                Ok(Message::Close(frame)) => return frame.map_or(String::new(), |f| f.reason.to_string()),
                Ok(_) => {}
                Err(tungstenite::Error::Io(error))
                    if error.kind() == std::io::ErrorKind::BrokenPipe && n_unanswered < 100 =>
                {
                    n_unanswered += 1;
                }
                Err(error) => return error.to_string(),
            }
        }
    }
}

#[test]
fn a_taken_port_is_named() {
    let taken = bind("127.0.0.1", 0).unwrap();
    let port = taken.local_addr().unwrap().port();
    let message = bind("127.0.0.1", port).unwrap_err().to_string();
    assert!(message.contains(&format!("port {port}")) && message.contains("in use"), "{message}");
}

#[test]
fn one_viewer_controls_and_the_next_one_follows_when_it_leaves() {
    let server = Server::start(None);
    let mut first = server.connect();
    assert!(first.hear("hello")["protocol"].is_number());
    assert_eq!(first.role(), "controller");
    let mut second = server.connect();
    assert_eq!(second.role(), "viewer");
    second.say(r#"{"type":"pause","paused":true}"#);
    assert!(second.hear("error")["message"].as_str().unwrap().contains("another viewer has control"));
    first.say(r#"{"type":"release_control"}"#);
    assert_eq!(first.role(), "viewer");
    assert_eq!(second.hear("role")["control_is_taken"], false);
    // Who does something first has it.
    second.say(r#"{"type":"pause","paused":true}"#);
    assert_eq!(second.role(), "controller");
    drop(second);
    while first.hear("role")["control_is_taken"] == true {}
    let timing = first.hear("timing");
    assert!(timing["simulation"]["real_time_factor"].is_number() && timing["haptics"].is_null(), "{timing}");
    assert_eq!(timing["haptics_at"], "nowhere");
}

/// Number of contact points in a snapshot that was sent; none where it has no such part.
fn contact_points_in(frame: &[u8]) -> Option<u32> {
    let word = |at: usize| u32::from_le_bytes(frame[at..at + 4].try_into().unwrap());
    let [flags, n_tools, n_blood] = [48, 52, 60].map(word);
    assert_eq!(flags & 64, 64, "positions are coded");
    let first = 64 + 152 * n_tools as usize;
    let at = first + 8 + word(first + 4).next_multiple_of(4) as usize + 16 * n_blood as usize;
    if flags & 8 == 0 {
        assert_eq!(frame.len(), at);
        return None;
    }
    let n = word(at + 40);
    assert_eq!(frame.len(), at + 44 + 40 * n as usize);
    Some(n)
}

/// Positions [m] of a snapshot that was sent, by the last key that was; and its step.
fn positions_in(frame: &[u8], key: &[u8]) -> (u64, Vec<DVec3>) {
    let word = |bytes: &[u8], at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
    let first = 64 + 152 * word(frame, 52) as usize;
    assert_eq!(word(key, 4), 3);
    assert_eq!([word(frame, first), word(frame, 8)], [word(key, 16), word(key, 8)], "number and topology");
    let step_m = f64::from_le_bytes(key[24..32].try_into().unwrap());
    let mut from = Taker(&key[32..]);
    let places = take_key(&mut from, word(key, 20) as usize).unwrap();
    assert!(from.0.is_empty());
    let mut from = Taker(&frame[first + 8..][..word(frame, first + 4) as usize]);
    let places = take_places(&mut from, &places).unwrap();
    assert!(from.0.is_empty());
    let step = u64::from_le_bytes(frame[16..24].try_into().unwrap());
    (step, places.into_iter().map(|place| DVec3::from_array(place.map(|x| f64::from(x) * step_m))).collect())
}

#[test]
fn viewers_that_miss_frames_see_what_the_others_see() {
    let server = Server::start(None);
    let mut viewers: Vec<Viewer> = (0..4).map(|_| server.connect()).collect();
    viewers[0].say(r#"{"type":"gravity","m_per_s2":[0,0,-40]}"#);
    let mut keys = vec![Vec::new(); viewers.len()];
    let mut steps = vec![0; viewers.len()];
    let mut seen = std::collections::HashMap::new();
    let mut n_compared = 0;
    let mut n_read = vec![0; viewers.len()];
    // The first one takes all that comes; each of the others answers less often, and gets less.
    for round in 0..240 {
        for (i, viewer) in viewers.iter_mut().enumerate() {
            if round % (5 * i + 1) > 0 {
                continue;
            }
            let frame = viewer.snapshot_with_key(&mut keys[i]);
            let (step, positions_m) = positions_in(&frame, &keys[i]);
            assert!(step >= steps[i], "viewer {i}: step {step} after {}", steps[i]);
            n_read[i] += u32::from(step > steps[i]);
            steps[i] = step;
            let before = seen.entry(step).or_insert_with(|| positions_m.clone());
            assert_eq!(*before, positions_m, "viewer {i}, step {step}");
            n_compared += 1;
        }
    }
    assert_eq!(n_compared, 240 + 40 + 22 + 15);
    // Paused, all see the same state, which is the simulation's.
    viewers[0].say(r#"{"type":"pause","paused":true}"#);
    let lasts = viewers.iter_mut().zip(&mut keys).map(|(viewer, key)| {
        loop {
            let frame = viewer.snapshot_with_key(key);
            if frame[48] & 2 != 0 {
                return positions_in(&frame, key);
            }
        }
    });
    let lasts: Vec<_> = lasts.collect();
    let answer = server.http("GET /api/snapshot HTTP/1.1\r\nHost: localhost");
    let state: serde_json::Value = serde_json::from_str(&answer[answer.find('{').unwrap()..]).unwrap();
    let exact_m: Vec<DVec3> = serde_json::from_value::<Vec<[f64; 3]>>(state["positions_m"].clone())
        .unwrap()
        .into_iter()
        .map(DVec3::from_array)
        .collect();
    for (step, positions_m) in lasts {
        assert_eq!(step, state["step"].as_u64().unwrap());
        let off = positions_m.iter().zip(&exact_m).map(|(a, b)| (*a - *b).abs().max_element());
        assert!(off.fold(0.0, f64::max) <= 0.5 * STEP_M * (1.0 + 1e-9));
    }
}

#[test]
fn who_looks_inside_gets_the_positions_of_all_and_its_own_part_after_them() {
    let server = Server::start(None);
    let [mut looker, mut other] = [server.connect(), server.connect()];
    looker.say(r#"{"type":"pause","paused":true}"#);
    looker.say(r#"{"type":"inside","field":"strain"}"#);
    let next = |viewer: &mut Viewer, key: &mut Vec<u8>, flags: u8| {
        loop {
            let frame = viewer.snapshot_with_key(key);
            if frame[48] == flags {
                break (positions_in(&frame, key), frame);
            }
        }
    };
    let [mut key, mut key_of_other] = [Vec::new(), Vec::new()];
    let (seen, with) = next(&mut looker, &mut key, 2 | 32 | 64);
    let (seen_by_other, _) = next(&mut other, &mut key_of_other, 2 | 64);
    assert_eq!(seen, seen_by_other);
    let word = |at: usize| u32::from_le_bytes(with[at..at + 4].try_into().unwrap());
    let first = 64 + 152 * word(52) as usize;
    let at = first + 8 + word(first + 4).next_multiple_of(4) as usize + 16 * word(60) as usize;
    let n = word(56);
    assert_eq!([0, 4, 8].map(|i| word(at + i)), [1, n, 0], "strain at all vertices, no section");
    assert_eq!(with.len(), at + 24 + 4 * n as usize);
    // Who looks no longer gets what all get.
    looker.say(r#"{"type":"inside"}"#);
    assert_eq!(next(&mut looker, &mut key, 2 | 64).0, seen);
}

#[test]
fn who_answers_no_ping_gets_a_frame_and_no_flood_and_the_others_all() {
    let server = Server::start(None);
    let mut deaf = server.connect();
    let mut key = Vec::new();
    deaf.snapshot_with_key(&mut key);
    let mut other = server.connect();
    // About two seconds of frames, while the first one takes nothing and answers nothing.
    let mut last = 0;
    for _ in 0..120 {
        last = positions_in(&other.snapshot_with_key(&mut key), &key).0;
    }
    let mut steps = Vec::new();
    let mut own_key = Vec::new();
    // What was under way to it; what it answers by reading makes it current again.
    loop {
        let frame = deaf.snapshot_with_key(&mut own_key);
        let step = u64::from_le_bytes(frame[16..24].try_into().unwrap());
        steps.push(step);
        if step > last {
            break;
        }
    }
    assert!(steps.len() < 60, "{} frames were kept for who took none", steps.len());
}

#[test]
fn contact_points_are_sent_to_who_asks_also_in_a_pause_and_to_nobody_else() {
    let server = Server::start(None);
    let (mut first, mut second) = (server.connect(), server.connect());
    assert_eq!(contact_points_in(&first.snapshot()), None);
    // It comes down on the middle of the slanted face.
    for z_mm in [27, 21, 17] {
        first.say(&format!(
            r#"{{"type":"tool","tip_m":[0.02,0.02,{}],"shaft":[0,0,1]}}"#,
            f64::from(z_mm) * 1e-3
        ));
        std::thread::sleep(Duration::from_millis(50));
    }
    // Who only watches may ask.
    second.say(r#"{"type":"contacts","shown":true}"#);
    while contact_points_in(&second.snapshot()).is_none_or(|n| n == 0) {}
    for _ in 0..20 {
        assert_eq!(contact_points_in(&first.snapshot()), None);
    }
    second.say(r#"{"type":"contacts","shown":false}"#);
    while contact_points_in(&second.snapshot()).is_some() {}
    first.say(r#"{"type":"pause","paused":true}"#);
    while first.snapshot()[48] & 2 == 0 {}
    first.say(r#"{"type":"contacts","shown":true}"#);
    while contact_points_in(&first.snapshot()).is_none_or(|n| n == 0) {}
    // Gathered for the first one; the second one gets them at once as well.
    second.say(r#"{"type":"contacts","shown":true}"#);
    while contact_points_in(&second.snapshot()).is_none_or(|n| n == 0) {}
    first.say(r#"{"type":"contacts","shown":false}"#);
    while contact_points_in(&first.snapshot()).is_some() {}
}

#[test]
fn pages_of_other_sites_and_rebound_names_get_no_socket() {
    let server = Server::start(None);
    assert_eq!(server.request("/ws", &[("origin", "http://elsewhere.example")]).err(), Some(403));
    assert_eq!(server.request("/ws", &[("host", "evil.example")]).err(), Some(403));
    let own = format!("http://{}", server.address);
    assert!(server.request("/ws", &[("origin", &own)]).is_ok());
    let answer = server.http("GET /api/scene HTTP/1.1\r\nHost: evil.example");
    assert!(answer.starts_with("HTTP/1.1 403") && answer.contains("localhost"), "{answer}");
}

#[test]
fn with_a_token_nothing_is_told_without_it_and_a_page_gets_a_cookie() {
    const TOKEN: &str = "a-token-of-some-length";
    let server = Server::start(Some(TOKEN));
    for path in ["/", "/api/scene", "/api/snapshot", "/nothing"] {
        let answer = server.http(&format!("GET {path} HTTP/1.1\r\nHost: localhost"));
        assert!(answer.starts_with("HTTP/1.1 401") && !answer.contains(TOKEN), "{path}: {answer}");
    }
    assert_eq!(server.request("/ws", &[]).err(), Some(401));
    assert_eq!(server.request("/ws?token=another-token-of-some", &[]).err(), Some(401));
    assert!(server.request(&format!("/ws?token={TOKEN}"), &[]).is_ok());
    assert!(server.request("/ws", &[("authorization", &format!("Bearer {TOKEN}"))]).is_ok());
    let page = server.http(&format!("GET /?token={TOKEN} HTTP/1.1\r\nHost: localhost"));
    let cookie = page.lines().find_map(|line| line.strip_prefix("set-cookie: ")).unwrap();
    assert!(page.starts_with("HTTP/1.1 303") && cookie.contains("HttpOnly; SameSite=Strict"), "{page}");
    let cookie = cookie.split(';').next().unwrap();
    assert!(server.request("/ws", &[("cookie", cookie)]).is_ok());
}

#[test]
fn too_long_too_many_and_binary_messages_end_the_connection() {
    let server = Server::start(None);
    let mut viewer = server.connect();
    viewer.say(&"x".repeat(socket::LONGEST_MESSAGE_BYTES + 1));
    viewer.end();
    let mut viewer = server.connect();
    viewer.0.send(Message::binary(vec![1, 2, 3])).unwrap();
    assert_eq!(viewer.end(), "viewers send text");
    let mut viewer = server.connect();
    for _ in 0..5_000 {
        if viewer.0.send(Message::text(r#"{"type":"undo"}"#)).is_err() {
            break;
        }
    }
    let end = viewer.end();
    assert!(
        end.contains("too many messages") || end.contains("reset") || end.contains("Broken pipe"),
        "{end}"
    );
    // The others are served as before, and control is free again.
    assert_eq!(server.connect().role(), "controller");
}

#[test]
fn frames_that_break_the_protocol_end_the_connection_with_a_reason() {
    let server = Server::start(None);
    // A client masks its frames: four zeros are a mask.
    let long = [&[0x81, 0xff, 0x40][..], &[0; 7], &[0; 4]].concat();
    for (what, bytes, reason) in [
        ("binary", &[0x82, 0x81, 0, 0, 0, 0, 7][..], "viewers send text"),
        ("a reserved kind", &[0x83, 0x80, 0, 0, 0, 0], "broken"),
        ("reserved bits", &[0xf1, 0x80, 0, 0, 0, 0], "broken"),
        ("without a mask", &[0x81, 0x01, b'x'], "broken"),
        ("a ping in parts", &[0x09, 0x80, 0, 0, 0, 0], "broken"),
        ("a part of nothing", &[0x80, 0x80, 0, 0, 0, 0], "broken"),
        ("a text that is none", &[0x81, 0x81, 0, 0, 0, 0, 0xff], "broken"),
        ("of 4 EiB", &long, "too long"),
    ] {
        let mut viewer = server.connect();
        viewer.0.get_mut().write_all(bytes).unwrap();
        let end = viewer.end();
        assert!(end.contains(reason), "{what}: {end}");
    }
    let mut state = 7_u32;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    };
    let mut n_refused = 0;
    for round in 0..150 {
        let mut viewer = server.connect();
        // Heads that could be right, with masks and contents by chance.
        let kind = [0x81, 0x01, 0x82, 0x88, 0x89, 0x8a, 0x80][usize::from(random() % 7)];
        let n_bytes = random() % 100;
        let head = if random() % 4 == 0 { random() } else { kind };
        let frame = [&[head, 0x80 | n_bytes][..], &[0; 40].map(|_: u8| random())].concat();
        viewer.0.get_mut().write_all(&frame).unwrap();
        viewer.0.get_mut().shutdown(std::net::Shutdown::Write).unwrap();
        let end = viewer.end();
        n_refused += usize::from(end.contains("broken") || end.contains("viewers send text"));
        // Not one that is left hanging until the test's patience is over.
        assert!(!end.contains("unavailable") && !end.contains("timed out"), "{round}: {frame:?}: {end}");
    }
    assert!(n_refused > 50, "{n_refused}");
    assert_eq!(server.connect().role(), "controller");
}

#[test]
fn there_are_places_for_so_many_viewers() {
    let server = Server::start(None);
    let viewers: Vec<Viewer> =
        (0..glisson_runtime::control::MOST_VIEWERS).map(|_| server.connect()).collect();
    assert_eq!(server.request("/ws", &[]).err(), Some(503));
    drop(viewers);
}

#[test]
fn bytes_that_are_no_protocol_at_all_do_not_stop_the_server() {
    let server = Server::start(None);
    let mut state = 1_u32;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    };
    for round in 0..30 {
        let mut stream = TcpStream::connect(server.address).unwrap();
        stream.set_read_timeout(Some(Duration::from_millis(50))).unwrap();
        if round % 2 == 0 {
            write!(
                stream,
                "GET /ws HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
                 Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
            )
            .unwrap();
        }
        let bytes: Vec<u8> = (0..200).map(|_| random()).collect();
        // The server may have closed already.
        let _ = stream.write_all(&bytes);
        let _ = stream.read(&mut [0; 1_000]);
    }
    assert_eq!(server.connect().hear("hello")["type"], "hello");
}

#[test]
fn a_reset_waits_for_a_slow_haptic_loop_to_see_the_hand_at_home() {
    const RATE_HZ: f64 = 100.0;
    let server = Server::start_with(None, RATE_HZ, |tools| {
        let home = tools[0].home;
        let device = open_standing(&"viewer".parse().unwrap(), &home, None, None, RATE_HZ).unwrap();
        vec![join(device, 0, home)]
    });
    let mut viewer = server.connect();
    assert_eq!(viewer.role(), "controller");
    let begin = Instant::now();
    viewer.say(r#"{"type":"reset"}"#);
    // What comes after it is answered after it.
    viewer.say(r#"{"type":"nonsense"}"#);
    viewer.hear("error");
    // Five ticks of 10 ms.
    assert!(begin.elapsed() >= Duration::from_millis(50), "{:?}", begin.elapsed());
}

#[test]
fn connections_beyond_so_many_are_told_and_the_viewers_stay() {
    let server = Server::start(None);
    let mut viewer = server.connect();
    let mut idle: Vec<TcpStream> =
        (1..limits::MOST_CONNECTIONS).map(|_| TcpStream::connect(server.address).unwrap()).collect();
    let question = "GET /api/scene HTTP/1.1\r\nHost: localhost";
    let answer = server.http(question);
    assert!(answer.starts_with("HTTP/1.1 503") && answer.contains("connections are taken"), "{answer}");
    viewer.hear("timing");
    // Who leaves makes room.
    idle.truncate(limits::MOST_CONNECTIONS / 2);
    let begin = Instant::now();
    while !server.http(question).starts_with("HTTP/1.1 200") {
        assert!(begin.elapsed() < Duration::from_secs(10));
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[test]
fn the_api_answers_so_often_and_then_says_that_it_was_too_often() {
    let server = Server::start(None);
    let mut stream = TcpStream::connect(server.address).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    let mut reader = stream.try_clone().unwrap();
    let asking = std::thread::spawn(move || {
        let question = "GET /api/scene HTTP/1.1\r\nHost: localhost\r\n\r\n".repeat(2_000);
        // It ends when the server is gone.
        let _ = stream.write_all(question.as_bytes());
        stream
    });
    let (mut said, mut bytes) = (String::new(), [0; 1 << 16]);
    while !said.contains("429 Too Many Requests") || !said.contains("too often") {
        let n = reader.read(&mut bytes).unwrap();
        assert!(n > 0, "{} answers", said.matches("HTTP/1.1 200").count());
        said.push_str(&String::from_utf8_lossy(&bytes[..n]));
    }
    assert!(said.matches("HTTP/1.1 200").count() >= 500 && said.contains("retry-after: 1"));
    // The page is not the API, and after a while neither is too much.
    assert!(server.http("GET / HTTP/1.1\r\nHost: localhost").starts_with("HTTP/1.1 200"));
    reader.shutdown(std::net::Shutdown::Both).unwrap();
    drop(asking.join());
    let begin = Instant::now();
    while !server.http("GET /api/snapshot HTTP/1.1\r\nHost: localhost").starts_with("HTTP/1.1 200") {
        assert!(begin.elapsed() < Duration::from_secs(10));
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[test]
fn only_the_page_in_control_ends_the_simulation_and_only_where_a_page_comes_after_it() {
    let server = Server::start(None);
    let mut viewer = server.connect();
    assert_eq!(viewer.hear("hello")["can_leave"], false);
    viewer.say(r#"{"type":"leave"}"#);
    assert!(viewer.hear("error")["message"].as_str().unwrap().contains("Ctrl-C"));
    drop(server);

    let mut server = Server::start_so(None, 1_000.0, true, |_| Vec::new());
    let (mut first, mut second) = (server.connect(), server.connect());
    assert_eq!(first.hear("hello")["can_leave"], true);
    assert_eq!(first.role(), "controller");
    assert_eq!(second.role(), "viewer");
    second.say(r#"{"type":"leave"}"#);
    assert!(second.hear("error")["message"].as_str().unwrap().contains("another viewer has control"));
    first.hear("timing");
    first.say(r#"{"type":"leave"}"#);
    first.end();
    let served = server.thread.take().unwrap().join().unwrap().unwrap();
    assert!(served.was_left && served.ended.steps > 0);
}

#[test]
fn an_instrument_that_is_offered_is_moved_by_who_takes_it_and_the_rest_by_who_controls() {
    let server = Server::start(None);
    let (mut first, mut second) = (server.connect(), server.connect());
    assert_eq!(second.role(), "viewer");
    second.say(r#"{"type":"hold","tool":0,"held":true}"#);
    assert!(second.hear("error")["message"].as_str().unwrap().contains("not offered"));
    first.say(r#"{"type":"offer","tool":0,"offered":true}"#);
    while second.hear("role")["instruments"][0] != "offered" {}
    second.say(r#"{"type":"hold","tool":0,"held":true}"#);
    assert_eq!(second.hear("role")["instruments"][0], "this");
    while first.hear("role")["instruments"][0] != "another" {}
    let pose = r#"{"type":"tool","tool":0,"tip_m":[0.04,0.04,0.12],"shaft":[0,0,1]}"#;
    first.say(pose);
    assert!(first.hear("error")["message"].as_str().unwrap().contains("another viewer"));
    second.say(pose);
    let tip_z_m = |frame: &[u8]| f64::from_le_bytes(frame[80..88].try_into().unwrap());
    while (tip_z_m(&first.snapshot()) - 0.12).abs() > 1e-3 {}
    second.say(r#"{"type":"pause","paused":true}"#);
    assert!(second.hear("error")["message"].as_str().unwrap().contains("another viewer"));
    first.say(r#"{"type":"offer","tool":0,"offered":false}"#);
    while second.hear("role")["instruments"][0] != "controller" {}
}

#[test]
fn a_number_that_is_turned_is_told_to_all_and_a_wrong_one_is_refused() {
    let server = Server::start(None);
    let (mut first, mut second) = (server.connect(), server.connect());
    let told = second.hear("parameters");
    let of = |told: &serde_json::Value, name: &str| {
        told["parameters"].as_array().unwrap().iter().find(|one| one["name"] == name).unwrap().clone()
    };
    assert_eq!(
        (&of(&told, "young_modulus")["value"], &of(&told, "young_modulus")["unit"]),
        (&5e3.into(), &"Pa".into())
    );
    first.say(r#"{"type":"turn","parameter":"young_modulus","value":4000}"#);
    assert_eq!(of(&second.hear("parameters"), "young_modulus")["coming"], 4e3);
    let now = second.hear("parameters");
    assert_eq!(
        (&of(&now, "young_modulus")["value"], &of(&now, "young_modulus")["of_scene"]),
        (&4e3.into(), &5e3.into())
    );
    assert!(now["material"].as_str().unwrap().contains("E 4 kPa"), "{now}");
    first.say(r#"{"type":"turn","parameter":"hand_greatest_force","value":1e9}"#);
    assert!(second.hear("error")["message"].as_str().unwrap().contains("allowed: 0.01 to 1000 N"));
}
