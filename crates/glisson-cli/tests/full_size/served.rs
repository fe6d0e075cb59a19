//! The resection in the viewer: the same script as without a window, to the same bits.

use super::glisson;
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use tungstenite::Message;

/// A run of some 20 s of simulated time on a busy machine.
const LONGEST: Duration = Duration::from_secs(3600);
/// The grasper's place in a snapshot (docs/protocol.md), and how many bytes each tool has.
const FIRST_TOOL: usize = 64;
const TOOL_BYTES: usize = 152;
/// Of these, where the number of held nodes stands.
const HELD: usize = 124;
/// The kind of a snapshot; others are surfaces, 1, and keys of coded positions.
const SNAPSHOT: u32 = 2;
/// The flag of coded positions.
const CODED: usize = 64;

/// What a viewer saw until the script was over.
#[derive(Debug, Default)]
struct Seen {
    /// Most nodes that the grasper held.
    n_held: u32,
    /// Most triangles in cuts.
    n_cut: u32,
    /// Clips set.
    n_clips: f32,
    /// What was told at the end.
    end: String,
}

fn u32_at(frame: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(frame[at..at + 4].try_into().unwrap())
}

impl Seen {
    fn look(&mut self, frame: &[u8]) {
        if u32_at(frame, 4) == 1 {
            let [n_vertices, n_triangles] = [16, 20].map(|at| u32_at(frame, at) as usize);
            let first = 24 + 16 * n_vertices + 12 * n_triangles;
            let bits = &frame[first..first + 4 * n_triangles.div_ceil(32)];
            self.n_cut = self.n_cut.max(bits.iter().map(|byte| byte.count_ones()).sum());
            return;
        }
        if u32_at(frame, 4) != SNAPSHOT {
            return;
        }
        self.n_held = self.n_held.max(u32_at(frame, FIRST_TOOL + HELD));
        let [flags, n_tools, n_vertices, n_blood] = [48, 52, 56, 60].map(|at| u32_at(frame, at) as usize);
        if n_blood > 0 {
            let positions = FIRST_TOOL + TOOL_BYTES * n_tools;
            let n_bytes = if flags & CODED != 0 {
                8 + (u32_at(frame, positions + 4) as usize).next_multiple_of(4)
            } else {
                12 * n_vertices
            };
            let sum = positions + n_bytes;
            self.n_clips = self.n_clips.max(f32::from_bits(u32_at(frame, sum + 8)));
        }
    }
}

fn watch(host: &str) -> Seen {
    let stream = TcpStream::connect(host).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    let (mut socket, _) = tungstenite::client(format!("ws://{host}/ws"), stream).unwrap();
    let (start, mut seen) = (Instant::now(), Seen::default());
    while seen.end.is_empty() {
        assert!(start.elapsed() < LONGEST, "the script goes on: {seen:?}");
        match socket.read().unwrap() {
            Message::Binary(frame) => seen.look(&frame),
            Message::Text(text) => {
                let told: Value = serde_json::from_str(&text).unwrap();
                let message = told["message"].as_str().unwrap_or_default();
                if message.starts_with("the script is over") {
                    assert_eq!(told["type"], "news");
                    seen.end = message.to_owned();
                }
            }
            _ => {}
        }
    }
    seen
}

/// Serves the resection to its end; `headless` is the report of the run without a window.
pub(super) fn makes_the_same_resection(out: &Path, headless: &Value) {
    let mut demo = Command::new(env!("CARGO_BIN_EXE_glisson"))
        .args(["demo", "--task", "resection", "--no-open", "--port", "0", "--out"])
        .arg(out)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(demo.stdout.take().unwrap()).lines().map(Result::unwrap);
    let page = lines.by_ref().find(|line| line.contains("http://")).unwrap();
    let host = page.split("http://").nth(1).unwrap().split('/').next().unwrap().to_owned();
    let seen = watch(&host);
    let stopped = Command::new("kill").args(["-INT", &demo.id().to_string()]).status().unwrap();
    let rest: Vec<String> = lines.collect();
    assert!(stopped.success() && demo.wait().unwrap().success(), "{rest:?}");

    assert!(seen.n_held > 0 && seen.n_cut > 100, "{seen:?}");
    assert_eq!(seen.n_clips as usize, headless["clips"].as_array().unwrap().len(), "{seen:?}");
    assert!(seen.end.contains("is free, 100.0 % of the tumour"), "{seen:?}");
    // At the script's end the same state as without a window, and the recording goes on to its own end.
    assert!(seen.end.contains(headless["state_hash"].as_str().unwrap()), "{seen:?}");
    let session = out.join("resection.jsonl");
    let replayed = glisson(&["replay", session.to_str().unwrap()]);
    let stopped_at = rest.iter().find_map(|line| line.strip_prefix("stopped; state hash ")).unwrap();
    assert!(replayed.contains("same bits") && replayed.contains(stopped_at), "{replayed}\n{stopped_at}");
}
