use super::error::RecordingError;
use super::page::{page_with, recordings_in};
use super::read::{Frame, RecordingReader};
use super::write::{About, Recording, RecordingSettings, RecordingWriter, TimedNote};
use glisson::base64;
use glisson::math::DVec3;
use glisson::mesh::NodeId;
use glisson::record::note::Note;
use glisson::record::snapshot::{
    BleedingEnd, BleedingSnapshot, ContactKind, ContactPoint, ContactPoints, ContactReport, DisplayTopology,
    Snapshot, ThreadSnapshot, ToolSnapshot,
};
use glisson::tool::ToolInput;
use glisson_protocol::frames::{Pace, first_position, snapshot_frame, topology_frame};
use proptest::prelude::*;
use serde_json::json;
use std::path::Path;

const SETTINGS: RecordingSettings = RecordingSettings { rate_hz: 30.0, step_m: 5e-5 };
/// More than a block.
const N_FRAMES: usize = 80;
/// The frames from which on another surface is shown.
const CHANGES: [usize; 2] = [40, 70];

/// A sheet of `side` by `side` nodes, 5 mm apart; the first change takes out a corner, the second brings it back with a new node.
fn sheet(side: u32, version: u32) -> DisplayTopology {
    let node = |row: u32, column: u32| row * side + column;
    let is_there = |n: u32| version != 1 || n != 0;
    let nodes: Vec<u32> =
        (0..side * side).filter(|n| is_there(*n)).chain((version == 2).then_some(side * side)).collect();
    let vertex = |n: u32| nodes.binary_search(&n).unwrap() as u32;
    let mut triangles = Vec::new();
    for (row, column) in (0..side - 1).flat_map(|row| (0..side - 1).map(move |column| (row, column))) {
        let [a, b, c, d] = [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(r, k)| node(row + r, column + k));
        let both = [[a, b, c], [b, d, c]].into_iter().filter(|t| t.iter().all(|n| is_there(*n)));
        triangles.extend(both.map(|t| t.map(vertex)));
    }
    if version == 2 {
        triangles.push([0, vertex(side * side), 1]);
    }
    let rest_m = |n: u32| {
        let (row, column) = (n / side, n % side);
        5e-3 * DVec3::new(f64::from(column), if n == side * side { 1.0 } else { 0.0 }, f64::from(row))
            - DVec3::splat(0.0123)
    };
    DisplayTopology {
        version,
        rest_positions_m: nodes.iter().map(|&n| rest_m(n)).collect(),
        is_cut: (0..triangles.len()).map(|i| version == 2 && i + 1 == triangles.len()).collect(),
        body_of: nodes.iter().map(|n| u8::from(*n > side)).collect(),
        nodes: nodes.into_iter().map(NodeId).collect(),
        triangles,
    }
}

fn version_of(frame: usize) -> u32 {
    CHANGES.iter().filter(|&&change| frame >= change).count() as u32
}

/// The sheet sinks where an instrument goes over it.
fn snapshot(side: u32, frame: usize) -> Snapshot {
    let topology = sheet(side, version_of(frame));
    let time_s = (frame + 1) as f64 / SETTINGS.rate_hz;
    let tip = DVec3::new(0.01 * time_s, -0.01, 0.004);
    let sunk = |p: &DVec3| *p + DVec3::Y * 0.008 * (-(*p - tip).length_squared() / 4e-4).exp();
    let contact =
        ContactReport { point_m: tip, normal: DVec3::NEG_Y, nodes: [NodeId(1); 3], weights: [1.0, 0.0, 0.0] };
    let tool = ToolSnapshot {
        pose: ToolInput { roll_rad: 0.1 * time_s, jaw_opening: 0.5, ..ToolInput::at(tip, DVec3::NEG_Y) },
        shown_further_out_m: DVec3::ZERO,
        force_n: DVec3::new(0.0, -time_s, 0.0),
        contacts: [Some(contact), None, None],
        n_held_nodes: frame as u32 % 2,
    };
    let end = BleedingEnd { position_m: tip, rate_m3_per_s: 1e-7 };
    let ends = if version_of(frame) > 0 { vec![end] } else { Vec::new() };
    let thread =
        ThreadSnapshot { radius_m: 2e-4, nodes_m: vec![tip; 3], n_needle_nodes: 1, clips_m: Vec::new() };
    Snapshot {
        step: 10 * (frame as u64 + 1),
        time_s,
        topology_version: version_of(frame),
        positions_m: topology.rest_positions_m.iter().map(sunk).collect(),
        tools: vec![tool; 2],
        bleeding: BleedingSnapshot {
            has_vessels: true,
            lost_m3: 1e-7 * time_s,
            rate_m3_per_s: 1e-7,
            n_clips: 0,
            ends,
            clips: Vec::new(),
        },
        threads: if version_of(frame) == 2 { vec![thread] } else { Vec::new() },
        strands_m: Vec::new(),
        n_resets: 0,
    }
}

/// One that is written without loss.
fn contacts(frame: usize) -> ContactPoints {
    let mut all = ContactPoints::default();
    all.add(ContactPoint {
        kind: ContactKind::ToolOrgan,
        touched: 0,
        by: 1,
        place_m: DVec3::new(0.015625, 0.0, 0.0078125),
        normal: DVec3::NEG_Y,
        force_n: DVec3::Y * if frame < 40 { 0.5 } else { 1.5 },
    });
    all
}

fn hello(side: u32) -> serde_json::Value {
    let topology = sheet(side, 0);
    let tool = |name: &str| {
        json!({
            "name": name, "kind": "probe", "tip_radius_m": 0.004, "shaft_radius_m": 0.0025, "shaft_length_m": 0.3, "jaws": null,
            "optics": null, "trocar_m": null, "home_tip_m": [0, -0.05, 0], "home_shaft": [0, -1, 0], "home_jaw": 0,
        })
    };
    json!({
        "type": "hello", "protocol": 12,
        "scene": {
            "name": "A sheet", "model": "implicit", "material": "liver", "time_step_s": 1.0 / 300.0,
            "gravity_m_per_s2": [0, 0, 0], "n_nodes": topology.nodes.len(), "n_tetrahedra": 0, "n_vessels": 1,
        },
        "bounds": { "min_m": [-0.0123, -0.0123, -0.0123], "max_m": [0.0377, 0.0, 0.0377] },
        "bodies": [], "tools": [tool("first"), tool("second")], "models": ["implicit"], "fixed_nodes": [1],
    })
}

fn recording(side: u32, n_frames: usize) -> Recording {
    let mut writer = RecordingWriter::new(SETTINGS);
    writer.greet_with(&hello(side));
    for frame in 0..n_frames {
        writer.add(&snapshot(side, frame), &contacts(frame), || sheet(side, version_of(frame))).unwrap();
    }
    let note = |time_s, note| TimedNote { time_s, note };
    let stroke = vec![DVec3::new(0.005, 0.0, 0.005), DVec3::new(0.015, 0.0, 0.005)];
    let notes = [
        note(0.9, Note::Bookmark { time_s: 0.5, text: "here".into() }),
        note(1.0, Note::Drawing { points_m: stroke }),
        note(2.0, Note::Erased {}),
    ];
    writer.finish(&About { notes: &notes, ..About::default() })
}

fn frames_of(bytes: &[u8]) -> Result<Vec<Frame>, RecordingError> {
    let mut frames = Vec::new();
    RecordingReader::new(bytes)?.each_frame(|frame| frames.push(frame))?;
    Ok(frames)
}

/// `found` is `expected` but for positions from byte `first` on, `n` numbers that are off by half a step at most.
fn check_close(found: &[u8], expected: &[u8], first: usize, n: usize) {
    assert_eq!(found.len(), expected.len());
    assert_eq!(found[..first], expected[..first]);
    assert_eq!(found[first + 4 * n..], expected[first + 4 * n..]);
    let number = |bytes: &[u8], i: usize| {
        f32::from_le_bytes(bytes[first + 4 * i..first + 4 * i + 4].try_into().unwrap())
    };
    for i in 0..n {
        // The last figures of a number of single precision below 1 m are worth 6e-8.
        let error_m = f64::from((number(found, i) - number(expected, i)).abs());
        assert!(error_m <= 0.5 * SETTINGS.step_m + 6e-8, "number {i} is off by {error_m} m");
    }
}

#[test]
fn what_is_read_is_what_was_shown_within_half_a_step() {
    let side = 9;
    let recording = recording(side, N_FRAMES);
    assert_eq!((recording.n_frames, recording.n_changes, recording.most_vertices), (N_FRAMES, 2, 82));
    assert!(recording.largest_error_m <= 0.5 * SETTINGS.step_m * (1.0 + 1e-9));
    assert!((recording.duration_s - (N_FRAMES - 1) as f64 / 30.0).abs() < 1e-3);
    let pace = Pace::default();
    let (mut frame, mut shown) = (0, None);
    for found in frames_of(&recording.bytes).unwrap() {
        match found {
            Frame::Topology(found) => {
                let topology = sheet(side, version_of(frame));
                let n = topology.nodes.len();
                check_close(&found, &topology_frame(&topology), 24 + 4 * n, 3 * n);
                shown = Some(topology.version);
            }
            Frame::Snapshot(found) => {
                assert_eq!(shown, Some(version_of(frame)));
                let snapshot = snapshot(side, frame);
                let n = 3 * snapshot.positions_m.len();
                check_close(
                    &found,
                    &snapshot_frame(&snapshot, &pace, Some(&contacts(frame)), None),
                    first_position(2),
                    n,
                );
                frame += 1;
            }
        }
    }
    assert_eq!(frame, N_FRAMES);
}

#[test]
fn a_changed_surface_costs_little_more_than_what_changed() {
    let [still, changed] = [CHANGES[0], CHANGES[0] + 1].map(|n| recording(40, n).bytes.len());
    assert!(changed < still + 3_000, "{still} bytes, with a change {changed}");
}

#[test]
fn seven_thousand_moving_vertices_take_less_than_ten_megabytes_a_minute() {
    let (side, n_frames) = (84, 40);
    let bytes = recording(side, n_frames).bytes.len();
    let a_minute_mb = bytes as f64 * 4.0 / 3.0 / 1e6 * 1800.0 / n_frames as f64;
    assert!(a_minute_mb < 10.0, "{a_minute_mb} MB");
}

#[test]
fn a_node_without_a_place_is_told_with_its_step() {
    let mut broken = snapshot(3, 0);
    for bad in [f64::NAN, f64::INFINITY, 1e6] {
        broken.positions_m[2].y = bad;
        let error = RecordingWriter::new(SETTINGS).add(&broken, &contacts(0), || sheet(3, 0)).unwrap_err();
        assert!(error.to_string().starts_with("step 10: "), "{error}");
    }
    let mut broken = snapshot(3, 0);
    broken.tools[1].force_n.x = f64::NAN;
    assert!(RecordingWriter::new(SETTINGS).add(&broken, &contacts(0), || sheet(3, 0)).is_err());
}

#[test]
fn what_is_no_recording_is_refused_with_a_reason() {
    let good = recording(4, 3).bytes;
    assert_eq!(frames_of(b"").unwrap_err(), RecordingError::NoRecording);
    assert_eq!(frames_of(b"GLSX1234").unwrap_err(), RecordingError::NoRecording);
    let newer = [&good[..4], &[2, 0, 0, 0], &good[8..]].concat();
    assert_eq!(frames_of(&newer).unwrap_err(), RecordingError::Version(2));
    for n in 4..good.len() {
        assert!(frames_of(&good[..n]).is_err(), "{n} of {} bytes", good.len());
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]
    #[test]
    fn mutated_recordings_are_read_or_refused(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
    ) {
        let mut bytes = recording(4, 3).bytes;
        for (at, byte) in changes {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        let _ = frames_of(&bytes);
    }

    /// Deflate's own sum finds nearly all of the above: here what is packed is mutated, and packed again.
    #[test]
    fn mutated_blocks_are_read_or_refused(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
    ) {
        let bytes = super::write::with_each_block_changed(&recording(4, 45).bytes, |raw| {
            for (at, byte) in &changes {
                let at = at.index(raw.len());
                raw[at] = *byte;
            }
        });
        let _ = frames_of(&bytes);
    }
}

/// The recording that the page's own tests read: `GLISSON_WRITE_FIXTURE=1 cargo test fixture` writes it anew.
#[test]
fn the_fixture_of_the_page_is_this_recording() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../web/test/recording.glsr.txt");
    let bytes = recording(9, N_FRAMES).bytes;
    if std::env::var_os("GLISSON_WRITE_FIXTURE").is_some() {
        std::fs::write(&path, base64::encode(&bytes) + "\n").unwrap();
    }
    let fixture = base64::decode(&std::fs::read_to_string(&path).unwrap()).unwrap();
    assert!(fixture.len() < 20_000);
    assert!(frames_of(&fixture).unwrap() == frames_of(&bytes).unwrap());
}

#[test]
fn a_page_has_the_recordings_that_were_put_into_it() {
    let (one, other) = (recording(3, 2).bytes, recording(4, 3).bytes);
    let Some(empty) = page_with(&[]) else {
        eprintln!("SKIPPED: web/dist is not built (cd web && npm run build)");
        return;
    };
    assert_eq!(recordings_in(&empty), Vec::<Vec<u8>>::new());
    assert_eq!(recordings_in(&page_with(&[&one]).unwrap()), std::slice::from_ref(&one));
    assert_eq!(recordings_in(&page_with(&[&one, &other]).unwrap()), [one, other]);
}
