//! The server over a real socket, and bytes of every kind.

use super::client::{Client, Described, View};
use super::frame::{FrameReader, HEADER_BYTES, message};
use super::*;
use glisson::math::DVec3;
use glisson::mesh::NodeId;
use glisson::model::kind::ModelKind;
use glisson::record::snapshot::{DisplayTopology, Snapshot, ToolSnapshot};
use glisson::tool::ToolInput;
use glisson_runtime::pace::Pace;
use glisson_runtime::published::{Lateness, Published};
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime};
use tokio::sync::watch;

pub(crate) fn published(step: u64) -> Arc<Published> {
    let tool = ToolSnapshot {
        pose: ToolInput::at(DVec3::new(0.01, 0.02, 0.03), DVec3::Z),
        shown_further_out_m: DVec3::ZERO,
        force_n: DVec3::ZERO,
        contacts: [None; 3],
        n_held_nodes: 0,
    };
    let corners = vec![DVec3::ZERO, DVec3::X, DVec3::Y];
    Arc::new(Published {
        snapshot: Snapshot {
            step,
            time_s: 0.0,
            topology_version: 0,
            positions_m: corners.clone(),
            bleeding: Default::default(),
            threads: Vec::new(),
            strands_m: Vec::new(),
            n_resets: 0,
            tools: vec![tool],
        },
        contact_points: None,
        inside: None,
        inside_watchers: Arc::default(),
        versions_from: 0,
        parameters: Arc::default(),
        contact_watchers: Arc::default(),
        topology: Arc::new(DisplayTopology {
            body_of: Vec::new(),
            version: 0,
            nodes: vec![NodeId(0), NodeId(1), NodeId(2)],
            rest_positions_m: corners,
            triangles: vec![[0, 1, 2]],
            is_cut: vec![false],
        }),
        pace: Pace::default(),
        state_hash: serde_json::from_str(&format!("\"{}\"", "0".repeat(64))).unwrap(),
        model: ModelKind::Explicit,
        effort: Default::default(),
        notices: Vec::new(),
        n_notices: 0,
        task: None,
        task_record: None,
        task_before: None,
        is_broken: false,
        lateness: Lateness::default(),
        meters: Arc::default(),
    })
}

fn start() -> (JoinHandle<()>, SocketAddr, watch::Sender<Arc<Published>>) {
    let (sender, receiver) = watch::channel(published(1));
    let listener = bind("127.0.0.1:0".parse().unwrap()).unwrap();
    let address = listener.local_addr().unwrap();
    let described =
        Described { axes: Axes::Ras, tool_names: vec!["grasper".into()], organ_name: "liver".into() };
    (spawn(listener, described, receiver).unwrap(), address, sender)
}

fn connect(address: SocketAddr) -> TcpStream {
    let stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    stream
}

/// Type and body of the next message.
fn read(stream: &mut TcpStream) -> Option<(String, Vec<u8>)> {
    let mut header = [0; HEADER_BYTES];
    stream.read_exact(&mut header).ok()?;
    let mut body = vec![0; u64::from_be_bytes(header[42..50].try_into().unwrap()) as usize];
    stream.read_exact(&mut body).ok()?;
    Some((String::from_utf8_lossy(&header[2..14]).trim_end_matches('\0').to_owned(), body))
}

#[test]
fn a_client_is_greeted_gets_poses_and_surface_and_hears_the_end() {
    let (server, address, published) = start();
    let mut stream = connect(address);
    let kinds: Vec<String> = (0..3).map(|_| read(&mut stream).unwrap().0).collect();
    assert_eq!(kinds, ["STATUS", "TRANSFORM", "POLYDATA"]);
    published.send_replace(self::published(2));
    assert_eq!(read(&mut stream).unwrap().0, "TRANSFORM");
    assert_eq!(read(&mut stream).unwrap().0, "POLYDATA");
    stream.write_all(&message("GET_STATUS", "", 0, b"")).unwrap();
    assert!(String::from_utf8_lossy(&read(&mut stream).unwrap().1).contains("mm, RAS"));
    drop(published);
    let (kind, body) = read(&mut stream).unwrap();
    assert!(kind == "STATUS" && body[1] == 19, "{body:?}");
    assert!(read(&mut stream).is_none());
    server.join().unwrap();
}

#[test]
fn wrong_frames_end_the_connection_with_a_reason_and_nobody_else_is_disturbed() {
    let (server, address, published) = start();
    let mut good = connect(address);
    let mut damaged = message("TRANSFORM", "a", 0, &[0; 48]);
    damaged[70] ^= 1;
    let too_long = [&message("IMAGE", "a", 0, b"")[..42], &u64::MAX.to_be_bytes(), &[0; 8]].concat();
    for (bytes, code, reason) in [
        (
            &b"GET / HTTP/1.1\r\nHost: localhost\r\nUser-Agent: a browser here\r\n\r\n"[..],
            12,
            "header version",
        ),
        (&damaged, 9, "CRC"),
        (&too_long, 8, "at most"),
    ] {
        let mut stream = connect(address);
        stream.write_all(bytes).unwrap();
        let mut last = (String::new(), Vec::new());
        while let Some(message) = read(&mut stream) {
            last = message;
        }
        let text = String::from_utf8_lossy(&last.1).into_owned();
        assert!(last.0 == "STATUS" && last.1[1] == code && text.contains(reason), "{} {text}", last.0);
    }
    // One client too many is told so.
    let mut crowd: Vec<TcpStream> = (0..7).map(|_| connect(address)).collect();
    for stream in &mut crowd {
        read(stream).unwrap();
    }
    let (_, body) = read(&mut connect(address)).unwrap();
    assert_eq!(body[1], 6, "{}", String::from_utf8_lossy(&body));
    assert_eq!(read(&mut good).unwrap().0, "STATUS");
    drop(published);
    drop(crowd);
    server.join().unwrap();
}

/// One to four messages of random kinds, some of them with a wrong byte.
fn some_frames(next: &mut impl FnMut() -> u64) -> Vec<u8> {
    let kinds = [
        "GET_TRANS",
        "GET_POLYDATA",
        "GET_STATUS",
        "GET_CAPABIL",
        "STT_TRANS",
        "STT_POLYDATA",
        "STP_TRANS",
        "STP_POLYDATA",
        "STATUS",
        "GET_\u{fc}",
        "STT_IMAGE",
        "",
    ];
    let mut bytes = Vec::new();
    for _ in 0..1 + next() % 4 {
        let body: Vec<u8> = (0..next() % 40).map(|_| next() as u8).collect();
        let device = ["", "grasper", "device"][next() as usize % 3];
        let mut frame = message(kinds[next() as usize % kinds.len()], device, next(), &body);
        if next().is_multiple_of(3) {
            let at = next() as usize % frame.len();
            frame[at] = next() as u8;
        }
        frame[1] = 1 + (next() % 2) as u8;
        bytes.extend(frame);
    }
    bytes
}

#[test]
fn any_bytes_are_frames_or_an_error_and_never_a_panic() {
    let mut random = 77_u64;
    let mut next = || {
        random ^= random << 13;
        random ^= random >> 7;
        random ^= random << 17;
        random
    };
    let described = || Described {
        axes: Axes::Ras,
        tool_names: vec!["grasper".into(), "hook".into()],
        organ_name: "liver".into(),
    };
    let (wall, mut now) = (SystemTime::now(), Instant::now());
    let mut view = View::of(&published(1));
    let (mut n_frames, mut n_errors, mut n_answers) = (0, 0, 0);
    for step in 0..3_000 {
        let bytes = some_frames(&mut next);
        let mut reader = FrameReader::default();
        let mut client = Client::new(described());
        view.step = step;
        for piece in bytes.chunks(1 + next() as usize % 90) {
            reader.push(piece);
            loop {
                match reader.next() {
                    Ok(Some(frame)) => {
                        n_frames += 1;
                        now += Duration::from_millis(next() % 50);
                        let answer = client.hear(&frame, &view, now, wall).unwrap();
                        n_answers += n_whole_frames(&answer);
                        // What it asked for comes in whole frames, too.
                        n_whole_frames(&client.due(&view, now, wall));
                    }
                    Ok(None) => break,
                    Err(error) => {
                        n_errors += 1;
                        assert!(!error.to_string().is_empty());
                        reader = FrameReader::default();
                    }
                }
            }
        }
    }
    assert!(n_frames > 1_000 && n_errors > 500, "{n_frames} frames, {n_errors} errors");
    assert!(n_answers > 1_000, "{n_answers} answers");
}

/// How many frames these bytes are; nothing is left over.
fn n_whole_frames(bytes: &[u8]) -> usize {
    let mut reader = FrameReader::default();
    reader.push(bytes);
    let (mut n_frames, mut n_bytes) = (0, 0);
    while let Some(frame) = reader.next().unwrap() {
        n_frames += 1;
        n_bytes += HEADER_BYTES + frame.body.len();
    }
    assert_eq!(n_bytes, bytes.len());
    n_frames
}
