//! Two processes with a link between them that is cut for two seconds.

use super::{glisson, small_scene};
use serde_json::Value;
use std::io::{BufRead, BufReader};
#[cfg(feature = "net")]
use std::io::{Read, Write};
use std::net::{SocketAddr, UdpSocket};
#[cfg(feature = "net")]
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

fn free_address() -> SocketAddr {
    UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap()
}

/// Passes datagrams on between the haptics machine, which sends to the proxy, and `simulation`, unless it is cut.
struct Proxy {
    address: SocketAddr,
    is_cut: Arc<AtomicBool>,
    ends: Arc<AtomicBool>,
}

impl Proxy {
    fn to(simulation: SocketAddr) -> Self {
        let front = UdpSocket::bind("127.0.0.1:0").unwrap();
        let back = UdpSocket::bind("127.0.0.1:0").unwrap();
        back.connect(simulation).unwrap();
        let address = front.local_addr().unwrap();
        let (is_cut, ends) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
        for socket in [&front, &back] {
            socket.set_read_timeout(Some(Duration::from_millis(100))).unwrap();
        }
        let client = Arc::new(std::sync::Mutex::new(None));
        let (front_out, back_out) = (front.try_clone().unwrap(), back.try_clone().unwrap());
        let (cut, end, whom) = (Arc::clone(&is_cut), Arc::clone(&ends), Arc::clone(&client));
        std::thread::spawn(move || {
            let mut bytes = [0; 1 << 14];
            while !end.load(Ordering::Relaxed) {
                let Ok((n, from)) = front.recv_from(&mut bytes) else { continue };
                *whom.lock().unwrap() = Some(from);
                if !cut.load(Ordering::Relaxed) {
                    // The simulation may not be there.
                    let _ = back_out.send(&bytes[..n]);
                }
            }
        });
        let (cut, end) = (Arc::clone(&is_cut), Arc::clone(&ends));
        std::thread::spawn(move || {
            let mut bytes = [0; 1 << 14];
            while !end.load(Ordering::Relaxed) {
                let Ok(n) = back.recv(&mut bytes) else { continue };
                if let (Some(to), false) = (*client.lock().unwrap(), cut.load(Ordering::Relaxed)) {
                    let _ = front_out.send_to(&bytes[..n], to);
                }
            }
        });
        Self { address, is_cut, ends }
    }
}

impl Drop for Proxy {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
    }
}

/// A process whose lines are read while it runs; it does not outlive the test.
struct Process {
    child: Child,
    lines: Receiver<String>,
    seen: Vec<String>,
}

impl Process {
    fn start(folder: &Path, arguments: &[&str]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_glisson"))
            .args(arguments)
            .current_dir(folder)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let (send, lines) = channel();
        let out = BufReader::new(child.stdout.take().unwrap());
        std::thread::spawn(move || {
            for line in out.lines().map_while(Result::ok) {
                if send.send(line).is_err() {
                    return;
                }
            }
        });
        Self { child, lines, seen: Vec::new() }
    }

    /// Waits for a line that contains `text`.
    fn says(&mut self, text: &str) -> String {
        let end = Instant::now() + Duration::from_secs(60);
        while Instant::now() < end {
            if let Ok(line) = self.lines.recv_timeout(Duration::from_millis(100)) {
                self.seen.push(line.clone());
                if line.contains(text) {
                    return line;
                }
            }
        }
        panic!("nobody says {text:?}: {:#?}", self.seen);
    }

    fn interrupt(&self) {
        self.signal("INT");
    }

    fn signal(&self, name: &str) {
        let kill = format!("kill -{name} {}", self.child.id());
        assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn a_session_of_two_processes_survives_a_cut_of_two_seconds_and_replays_to_the_same_bits() {
    let listens_at = free_address();
    let proxy = Proxy::to(listens_at);
    session(&format!("udp://{listens_at}"), &format!("udp://{}", proxy.address), &proxy.is_cut);
}

/// The same over zenoh, whose connection waits while it is cut.
#[cfg(feature = "net")]
#[test]
fn a_session_over_zenoh_survives_a_cut_of_two_seconds_and_replays_to_the_same_bits() {
    let listens_at = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let is_cut = Arc::new(AtomicBool::new(false));
    let proxy = tcp_proxy(listens_at, &is_cut);
    session(&format!("zenoh:tcp/{listens_at}"), &format!("zenoh:tcp/{proxy}"), &is_cut);
}

/// Passes bytes on to `to`; while it is cut they wait, as in a broken network. It ends with the test's process.
#[cfg(feature = "net")]
fn tcp_proxy(to: SocketAddr, is_cut: &Arc<AtomicBool>) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let is_cut = Arc::clone(is_cut);
    std::thread::spawn(move || {
        for front in listener.incoming().map_while(Result::ok) {
            // The simulation may not be there yet: who connected tries again.
            let Ok(back) = TcpStream::connect(to) else { continue };
            let (front_out, back_out) = (front.try_clone().unwrap(), back.try_clone().unwrap());
            for (from, to) in [(front, back_out), (back, front_out)] {
                let is_cut = Arc::clone(&is_cut);
                std::thread::spawn(move || pass_on(from, to, &is_cut));
            }
        }
    });
    address
}

#[cfg(feature = "net")]
fn pass_on(mut from: TcpStream, mut to: TcpStream, is_cut: &AtomicBool) {
    let _ = to.set_nodelay(true);
    let mut bytes = [0; 1 << 16];
    while let Ok(n) = from.read(&mut bytes) {
        while is_cut.load(Ordering::Relaxed) {
            std::thread::sleep(Duration::from_millis(5));
        }
        if n == 0 || to.write_all(&bytes[..n]).is_err() {
            break;
        }
    }
    let _ = to.shutdown(std::net::Shutdown::Both);
}

/// A haptics process and a simulating one, between which `is_cut` is set for two seconds.
fn session(to_simulation: &str, to_proxy: &str, is_cut: &AtomicBool) {
    let folder = tempfile::tempdir().unwrap();
    small_scene(folder.path());
    let mut haptics =
        Process::start(folder.path(), &["serve", "scene.toml", "--role", "haptics", "--link", to_proxy]);
    haptics.says("haptics run");
    let simulating = [
        &["serve", "scene.toml", "--role", "simulation", "--link", to_simulation][..],
        &["--port", "0", "--no-open", "--record", "s.jsonl"],
    ]
    .concat();
    let mut simulation = Process::start(folder.path(), &simulating);
    simulation.says("Glisson is at");
    haptics.says("the simulation is there");
    std::thread::sleep(Duration::from_millis(700));

    is_cut.store(true, Ordering::Relaxed);
    haptics.says("nothing comes from the simulation");
    std::thread::sleep(Duration::from_secs(2));
    is_cut.store(false, Ordering::Relaxed);
    haptics.says("the simulation is there");
    std::thread::sleep(Duration::from_millis(700));

    haptics.interrupt();
    let played = haptics.says("played: ");
    let played: Value = serde_json::from_str(played.split_once(": ").unwrap().1).unwrap();
    let number = |name: &str| played[name].as_f64().unwrap();
    assert!(number("greatest_force_n") > 0.01, "the tissue was touched: {played}");
    // The watchdog: with old models nothing pulls any more.
    // What one feels goes on without a jump: at the cut, while the force fades, and when models come again.
    assert!(number("greatest_unexplained_jump_n") <= 0.05, "{played}");
    assert!(number("n_stale") > 100.0 && number("greatest_stale_force_n") < 1e-3, "{played}");
    simulation.interrupt();
    let stopped = simulation.says("stopped; state hash ");
    let hash = stopped.rsplit(' ').next().unwrap();
    let link = simulation.says("link: ");
    assert!(link.contains("0 refused"), "{link}");

    // Nothing that moved the organ is missing from the recording.
    let replay = glisson(folder.path(), &["replay", "s.jsonl"]);
    let text = String::from_utf8_lossy(&replay.stdout).into_owned();
    assert!(replay.status.success() && text.contains("same bits") && text.contains(hash), "{text} {hash}");
    let session = std::fs::read_to_string(folder.path().join("s.jsonl")).unwrap();
    let steps: Vec<u64> = session
        .lines()
        .filter(|line| line.contains("\"input\""))
        .map(|line| serde_json::from_str::<Value>(line).unwrap()["step"].as_u64().unwrap())
        .collect();
    // Inputs are written when they change: during the cut the instrument stood still, before and after it moved.
    let longest = steps.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap();
    assert!(longest > 500 && steps.len() > 200, "longest stand {longest} steps, {} inputs", steps.len());
}

/// The real haptic loop with a device: its watchdog takes the force back, and gives it again along a ramp.
#[test]
fn a_device_across_a_link_that_is_cut_feels_nothing_meanwhile_and_the_tissue_again_after_it() {
    let folder = tempfile::tempdir().unwrap();
    small_scene(folder.path());
    let scene = std::fs::read_to_string(folder.path().join("scene.toml")).unwrap();
    let near = scene.replace("[\"10 mm\", \"10 mm\", \"150 mm\"]", "[\"2 mm\", \"2 mm\", \"67 mm\"]");
    let path_at = near.find("[[tool.path]]").unwrap();
    std::fs::write(folder.path().join("scene.toml"), &near[..path_at]).unwrap();
    let listens_at = free_address();
    let proxy = Proxy::to(listens_at);
    let (to_simulation, to_proxy) = (format!("udp://{listens_at}"), format!("udp://{}", proxy.address));
    let mut haptics = Process::start(
        folder.path(),
        &["serve", "scene.toml", "--role", "haptics", "--link", &to_proxy, "--device", "simulated"],
    );
    haptics.says("haptics run");
    let simulating =
        ["serve", "scene.toml", "--role", "simulation", "--link", &to_simulation, "--port", "0", "--no-open"];
    let mut simulation = Process::start(folder.path(), &simulating);
    simulation.says("Glisson is at");
    haptics.says("the simulation is there");
    std::thread::sleep(Duration::from_millis(2500));
    proxy.is_cut.store(true, Ordering::Relaxed);
    haptics.says("nothing comes from the simulation");
    std::thread::sleep(Duration::from_millis(1500));
    proxy.is_cut.store(false, Ordering::Relaxed);
    haptics.says("the simulation is there");
    std::thread::sleep(Duration::from_millis(2500));
    haptics.interrupt();
    let said = haptics.says("felt: ");
    let felt: Value = serde_json::from_str(said.split_once(": ").unwrap().1).unwrap();
    let number = |name: &str| felt[name].as_f64().unwrap();
    assert!(number("greatest_force_n") > 0.01, "the tissue was felt: {felt}");
    assert!(number("taken_back_ticks") > 100.0, "{felt}");
    assert!(number("greatest_force_taken_back_n") < 1e-3, "{felt}");
    assert!(number("greatest_force_given_again_n") > 0.01, "{felt}");
    // Down and up, a hundred ticks each: a ramp takes its ticks, however late they come.
    assert!(number("ramp_ticks") > 150.0, "{felt}");
    simulation.interrupt();
    assert!(simulation.says("link: ").contains("0 refused"));
}

/// The tip strikes the organ's top at 5 m/s, stays for a while, and goes back.
const STRIKES: [&str; 2] = [
    "time = \"0.1 s\"\ntip = [\"2 mm\", \"2 mm\", \"55 mm\"]\n",
    "time = \"0.5 s\"\ntip = [\"2 mm\", \"2 mm\", \"150 mm\"]\n\
     [[tool.path]]\ntime = \"0.519 s\"\ntip = [\"2 mm\", \"2 mm\", \"55 mm\"]\n\
     [[tool.path]]\ntime = \"0.6 s\"\ntip = [\"2 mm\", \"2 mm\", \"55 mm\"]\n",
];

/// The simulation's process stands still for 150 ms again and again.
#[test]
fn a_tip_at_5_m_per_s_is_felt_while_the_simulation_stands_still() {
    let folder = tempfile::tempdir().unwrap();
    small_scene(folder.path());
    let scene = std::fs::read_to_string(folder.path().join("scene.toml")).unwrap();
    assert!(scene.contains(STRIKES[0]));
    std::fs::write(folder.path().join("scene.toml"), scene.replace(STRIKES[0], STRIKES[1])).unwrap();
    let link = format!("udp://{}", free_address());
    let simulating = [
        &["serve", "scene.toml", "--role", "simulation", "--link", &link][..],
        &["--port", "0", "--no-open", "--record", "s.jsonl"],
    ];
    let mut simulation = Process::start(folder.path(), &simulating.concat());
    simulation.says("Glisson is at");
    let mut haptics =
        Process::start(folder.path(), &["serve", "scene.toml", "--role", "haptics", "--link", &link]);
    haptics.says("touches are looked for here, on 4 triangles");
    haptics.says("the simulation is there");
    for _ in 0..12 {
        simulation.signal("STOP");
        std::thread::sleep(Duration::from_millis(150));
        simulation.signal("CONT");
        std::thread::sleep(Duration::from_millis(230));
    }
    haptics.interrupt();
    let found = haptics.says("detection: ");
    let found: Value = serde_json::from_str(found.split_once(": ").unwrap().1).unwrap();
    let number = |name: &str| found[name].as_f64().unwrap();
    // A strike each 1.2 s, two of five of them into a stall.
    assert!(number("n_felt_first") >= 1.0 && number("greatest_force_alone_n") > 0.05, "{found}");
    assert!(number("longest_alone_ms") > 10.0, "{found}");
    simulation.interrupt();
    let stopped = simulation.says("stopped; state hash ");
    let hash = stopped.rsplit(' ').next().unwrap();
    // What was found is in the recording, and makes the same bits.
    let session = std::fs::read_to_string(folder.path().join("s.jsonl")).unwrap();
    let told = session.lines().filter(|line| line.contains("\"triangle\"")).count();
    assert!(told > 0, "no touch was told to the simulation");
    let replay = glisson(folder.path(), &["replay", "s.jsonl"]);
    let text = String::from_utf8_lossy(&replay.stdout).into_owned();
    assert!(replay.status.success() && text.contains("same bits") && text.contains(hash), "{text} {hash}");
}

#[test]
fn wrong_links_are_refused_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    small_scene(folder.path());
    std::fs::write(folder.path().join("short.key"), "secret").unwrap();
    let refuses = |arguments: &[&str], expected: &str| {
        let line = [&["serve", "scene.toml", "--port", "0", "--no-open"], arguments].concat();
        super::refuses(folder.path(), &line, &[expected]);
    };
    refuses(&["--role", "haptics", "--link", "udp://192.0.2.1:7000"], "--link-key");
    refuses(&["--role", "haptics", "--link", "zenoh:tcp/192.0.2.1:7000"], "--link-key");
    refuses(&["--igtl", "0.0.0.0:18944"], "--igtl-open");
    refuses(
        &["--role", "simulation", "--link", "udp://127.0.0.1:0", "--link-key", "short.key"],
        "at least 16 random",
    );
    refuses(
        &["--role", "simulation", "--link", "udp://127.0.0.1:0", "--device", "simulated"],
        "--role haptics",
    );
    for wrong in
        [&["--role", "simulation"][..], &["--link", "udp://a:1"], &["--role", "haptics", "--link", "tcp:a"]]
    {
        let line = [&["serve", "scene.toml"], wrong].concat();
        assert_eq!(glisson(folder.path(), &line).status.code(), Some(2), "{wrong:?}");
    }
}
