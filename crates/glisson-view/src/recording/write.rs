//! Makes a recording, frame by frame.

use super::surface::Surface;
use super::{ENOUGH_IN_BLOCK, FRAMES_OF_BLOCK, MAGIC, VERSION};
use flate2::Compression;
use flate2::write::ZlibEncoder;
use glisson::math::DVec3;
use glisson::record::note::Note;
use glisson::record::snapshot::{ContactPoint, ContactPoints, DisplayTopology, Snapshot};
use glisson::training::task::TaskResult;
use glisson_protocol::frames::{self, Pace};
use glisson_protocol::messages;
use glisson_protocol::quantized::numbers::{put, put_signed};
use glisson_protocol::quantized::places::{Place, place_of};
use glisson_runtime::Simulation;
use serde_json::{Value, json};
use std::io::Write as _;

/// How a recording is made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecordingSettings {
    /// Frames a second of simulated time.
    pub rate_hz: f64,
    /// Positions are whole numbers of it [m]; each coordinate is off by half of it at most.
    pub step_m: f64,
}

/// Why a frame cannot be recorded.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "step {step}: a place or a force is no number, or too far away to be recorded in steps of {step_m} m"
)]
pub struct NotRecordable {
    /// The step of the simulation.
    pub step: u64,
    /// See [`RecordingSettings::step_m`].
    pub step_m: f64,
}

/// What somebody wanted to be kept, and when that was.
#[derive(Clone, Debug, PartialEq)]
pub struct TimedNote {
    /// When it was written down [s].
    pub time_s: f64,
    /// What.
    pub note: Note,
}

/// What is known of a session at its end.
#[derive(Clone, Copy, Debug, Default)]
pub struct About<'a> {
    /// What it is called where another one is beside it.
    pub name: Option<&'a str>,
    /// The result of its task.
    pub task: Option<&'a TaskResult>,
    /// What who watched it kept.
    pub notes: &'a [TimedNote],
}

/// A finished recording, and what it is like.
pub struct Recording {
    /// All of it.
    pub bytes: Vec<u8>,
    /// Frames.
    pub n_frames: usize,
    /// Times that the displayed surface changed.
    pub n_changes: usize,
    /// Vertices of the largest surface.
    pub most_vertices: usize,
    /// By how much a coordinate is off at most [m].
    pub largest_error_m: f64,
    /// From the first frame to the last [s].
    pub duration_s: f64,
}

struct Block {
    first_frame: usize,
    n_bytes: usize,
    n_raw_bytes: usize,
}

/// What the next frame is a difference from.
struct Last {
    surface: Surface,
    places: Vec<Place>,
    head: Vec<u8>,
    tail: Vec<u8>,
}

/// A recording that grows.
pub struct RecordingWriter {
    settings: RecordingSettings,
    last: Option<Last>,
    /// The block with the newest whole surface, and that.
    whole: (usize, Surface),
    raw: Vec<u8>,
    n_in_block: usize,
    blocks: Vec<Block>,
    packed: Vec<u8>,
    hellos: Vec<Value>,
    times_s: Vec<f64>,
    /// Size of the force on each instrument [N], frame by frame.
    forces_n: Vec<Vec<f64>>,
    n_changes: usize,
    most_vertices: usize,
    largest_error_m: f64,
}

fn pack(bytes: &[u8]) -> Vec<u8> {
    let mut packer = ZlibEncoder::new(Vec::new(), Compression::new(7));
    packer.write_all(bytes).and_then(|()| packer.finish()).expect("memory can be written to")
}

/// `bytes` and those of before at the same places, bit by bit: what stayed is zero.
fn put_changed(out: &mut Vec<u8>, bytes: &[u8], before: &[u8]) {
    out.extend(bytes.iter().zip(before.iter().chain(std::iter::repeat(&0))).map(|(x, y)| x ^ y));
}

/// Contact points that a recording keeps: those with the greatest forces. Choices: as many as can be told apart in a picture.
const MOST_OF_TOOLS: usize = 16;
const MOST_OF_BODIES: usize = 32;

/// The contact points that are kept, with numbers that are shorter to write: places to 1/8,192 of themselves (0.01 mm a
/// decimetre away), normals and forces to 1/512.
fn shortened(all: &ContactPoints) -> ContactPoints {
    let short = |v: DVec3, bits: u32| {
        let cut = |x: f64| f64::from(f32::from_bits((x as f32).to_bits() & (u32::MAX << bits)));
        DVec3::from_array(v.to_array().map(cut))
    };
    let is_of_tool = |point: &&ContactPoint| point.kind.is_of_tool();
    let of_tools = all.points.iter().filter(is_of_tool).take(MOST_OF_TOOLS);
    let others = all.points.iter().filter(|point| !is_of_tool(point)).take(MOST_OF_BODIES);
    let points = of_tools.chain(others).map(|point| ContactPoint {
        place_m: short(point.place_m, 10),
        normal: short(point.normal, 14),
        force_n: short(point.force_n, 14),
        ..*point
    });
    ContactPoints { points: points.collect(), sums: all.sums }
}

/// To a ten-thousandth, which is shorter to write.
fn rounded(x: f64) -> f64 {
    (1e4 * x).round() / 1e4
}

impl RecordingWriter {
    /// An empty one.
    pub fn new(settings: RecordingSettings) -> Self {
        Self {
            settings,
            last: None,
            whole: (0, Surface::default()),
            raw: Vec::new(),
            n_in_block: 0,
            blocks: Vec::new(),
            packed: Vec::new(),
            hellos: Vec::new(),
            times_s: Vec::new(),
            forces_n: Vec::new(),
            n_changes: 0,
            most_vertices: 0,
            largest_error_m: 0.0,
        }
    }

    /// Says of the next frame what the scene is, as a display is greeted; once before the first frame, again when it is another.
    pub fn greet(&mut self, simulation: &Simulation) {
        self.greet_with(&messages::hello(simulation));
    }

    pub(super) fn greet_with(&mut self, hello: &Value) {
        self.hellos.push(json!({ "first_frame": self.times_s.len(), "hello": hello }));
    }

    /// Adds a frame with where surfaces bear forces; `topology` is asked for when it is not that of the frame before.
    ///
    /// # Errors
    /// When a node or an instrument is nowhere.
    pub fn add(
        &mut self,
        snapshot: &Snapshot,
        contacts: &ContactPoints,
        topology: impl FnOnce() -> DisplayTopology,
    ) -> Result<(), NotRecordable> {
        let step_m = self.settings.step_m;
        let error = NotRecordable { step: snapshot.step, step_m };
        if !snapshot.tools.iter().all(|tool| tool.pose.is_finite() && tool.force_n.is_finite()) {
            return Err(error);
        }
        let mut places = Vec::with_capacity(snapshot.positions_m.len());
        for &p in &snapshot.positions_m {
            let place = place_of(p, step_m).ok_or(error)?;
            for (x, whole) in p.to_array().into_iter().zip(place) {
                self.largest_error_m = self.largest_error_m.max((x - f64::from(whole) * step_m).abs());
            }
            places.push(place);
        }
        let last = self.last.take();
        let kept = last.as_ref().is_some_and(|last| last.surface.version == snapshot.topology_version);
        let changed = if kept { None } else { Some(Surface::of(&topology(), step_m).ok_or(error)?) };
        self.n_changes += usize::from(last.is_some() && changed.is_some());
        if self.n_in_block == FRAMES_OF_BLOCK || self.raw.len() > ENOUGH_IN_BLOCK {
            self.end_block();
        }
        let (surface, expected, head, tail) = match last {
            Some(last) if self.n_in_block > 0 => {
                self.raw.push(u8::from(changed.is_some()));
                let (surface, expected) = match changed {
                    None => (last.surface, last.places),
                    Some(surface) => {
                        surface.put_after(&last.surface, &mut self.raw);
                        let expected = surface.expected(&last.surface, &last.places);
                        (surface, expected)
                    }
                };
                (surface, expected, last.head, last.tail)
            }
            last => {
                let surface = changed.or(last.map(|last| last.surface)).unwrap_or_default();
                self.begin_block(&surface);
                let rest = surface.rest();
                (surface, rest, Vec::new(), Vec::new())
            }
        };
        let contacts = shortened(contacts);
        self.last = Some(self.put_frame((snapshot, &contacts), surface, places, &expected, (&head, &tail)));
        self.times_s.push(rounded(snapshot.time_s));
        self.forces_n.push(snapshot.tools.iter().map(|tool| rounded(tool.force_n.length())).collect());
        Ok(())
    }

    /// All of a frame but whether its surface is another.
    fn put_frame(
        &mut self,
        (snapshot, contacts): (&Snapshot, &ContactPoints),
        surface: Surface,
        places: Vec<Place>,
        expected: &[Place],
        (head, tail): (&[u8], &[u8]),
    ) -> Last {
        let pace = Pace::default();
        let mut whole = frames::snapshot_frame(snapshot, &pace, Some(contacts), None);
        let first = frames::first_position(snapshot.tools.len());
        let new_tail = whole.split_off(first + 12 * places.len());
        whole.truncate(first);
        let raw = &mut self.raw;
        put(raw, whole.len() as u32);
        put_changed(raw, &whole, head);
        for axis in 0..3 {
            places.iter().zip(expected).for_each(|(now, then)| put_signed(raw, now[axis] - then[axis]));
        }
        put(raw, new_tail.len() as u32);
        put_changed(raw, &new_tail, tail);
        self.n_in_block += 1;
        self.most_vertices = self.most_vertices.max(places.len());
        Last { surface, places, head: whole, tail: new_tail }
    }

    /// A block begins with its surface, or with the number of the block that begins with the same.
    fn begin_block(&mut self, surface: &Surface) {
        let block = self.blocks.len();
        self.blocks.push(Block { first_frame: self.times_s.len(), n_bytes: 0, n_raw_bytes: 0 });
        if block == 0 || self.whole.1.version != surface.version {
            self.whole = (block, surface.clone());
        }
        put(&mut self.raw, self.whole.0 as u32);
        if self.whole.0 == block {
            surface.put_after(&Surface::default(), &mut self.raw);
        }
    }

    fn end_block(&mut self) {
        let Some(block) = self.blocks.last_mut() else { return };
        let packed = pack(&self.raw);
        (block.n_bytes, block.n_raw_bytes) = (packed.len(), self.raw.len());
        self.packed.extend(packed);
        self.raw.clear();
        self.n_in_block = 0;
    }

    /// Frames so far.
    pub fn n_frames(&self) -> usize {
        self.times_s.len()
    }

    /// The recording of a session.
    pub fn finish(mut self, about: &About) -> Recording {
        self.end_block();
        let block = |block: &Block| json!([block.first_frame, block.n_bytes, block.n_raw_bytes]);
        let head = json!({
            "rate_hz": self.settings.rate_hz,
            "step_m": self.settings.step_m,
            "hellos": self.hellos,
            "time_s": self.times_s,
            "force_n": self.forces_n,
            "blocks": self.blocks.iter().map(block).collect::<Vec<_>>(),
            "name": about.name,
            "task": about.task.map(task_json),
            "notes": about.notes.iter().map(note_json).collect::<Vec<_>>(),
        });
        let head = pack(head.to_string().as_bytes());
        let mut bytes = MAGIC.to_vec();
        [VERSION, head.len() as u32].iter().for_each(|x| bytes.extend(x.to_le_bytes()));
        bytes.extend(head);
        bytes.extend(self.packed);
        let ends = self.times_s.first().zip(self.times_s.last());
        Recording {
            bytes,
            n_frames: self.times_s.len(),
            n_changes: self.n_changes,
            most_vertices: self.most_vertices,
            largest_error_m: self.largest_error_m,
            duration_s: ends.map_or(0.0, |(first, last)| last - first),
        }
    }
}

fn note_json(TimedNote { time_s, note }: &TimedNote) -> Value {
    match note {
        Note::Bookmark { time_s, text } => {
            json!({ "kind": "bookmark", "time_s": rounded(*time_s), "text": text })
        }
        Note::Drawing { points_m } => {
            let points_m: Vec<_> = points_m.iter().map(|point_m| point_m.to_array()).collect();
            json!({ "kind": "drawing", "time_s": rounded(*time_s), "points_m": points_m })
        }
        Note::Erased {} => json!({ "kind": "erased", "time_s": rounded(*time_s) }),
    }
}

/// The result of a task, and the titles of what went wrong.
fn task_json(result: &TaskResult) -> Value {
    let titles: Vec<&str> = result.moments.iter().map(|moment| moment.fault.title()).collect();
    json!({ "result": result, "titles": titles })
}

/// A recording whose blocks were unpacked, changed and packed again.
#[cfg(test)]
pub(super) fn with_each_block_changed(recording: &[u8], change: impl Fn(&mut Vec<u8>)) -> Vec<u8> {
    use std::io::Read as _;
    let unpack = |bytes: &[u8]| {
        let mut raw = Vec::new();
        flate2::read::ZlibDecoder::new(bytes).read_to_end(&mut raw).expect("it was packed here");
        raw
    };
    let n_head = u32::from_le_bytes([recording[8], recording[9], recording[10], recording[11]]) as usize;
    let mut head: Value =
        serde_json::from_slice(&unpack(&recording[12..12 + n_head])).expect("it was written here");
    let (mut at, mut packed) = (12 + n_head, Vec::new());
    for block in head["blocks"].as_array_mut().expect("they are a list") {
        let n = block[1].as_u64().expect("it is a number") as usize;
        let mut raw = unpack(&recording[at..at + n]);
        at += n;
        change(&mut raw);
        let changed = pack(&raw);
        block[1] = json!(changed.len());
        packed.extend(changed);
    }
    let head = pack(head.to_string().as_bytes());
    [&recording[..8], &(head.len() as u32).to_le_bytes(), &head, &packed].concat()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::record::snapshot::ContactKind;

    #[test]
    fn the_greatest_contacts_are_kept_nearly_as_they_were() {
        let mut all = ContactPoints::default();
        for i in 0..40 {
            for kind in [ContactKind::ToolOrgan, ContactKind::Bodies] {
                let place_m = DVec3::new(0.1, -0.0731, 0.2) * (1.0 - 0.01 * f64::from(i));
                let force_n = DVec3::new(0.3, -0.01, 2.0) / f64::from(i + 1);
                all.add(ContactPoint {
                    kind,
                    touched: 1,
                    by: 0,
                    place_m,
                    normal: place_m.normalize(),
                    force_n,
                });
            }
        }
        all.points.sort_by_key(|point| !point.kind.is_of_tool());
        let kept = shortened(&all);
        assert_eq!((kept.sums, kept.points.len()), (all.sums, MOST_OF_TOOLS + MOST_OF_BODIES));
        assert_eq!(kept.points[MOST_OF_TOOLS].kind, ContactKind::Bodies);
        for (kept, point) in kept.points.iter().zip(&all.points[..MOST_OF_TOOLS]) {
            assert!(kept.place_m.distance(point.place_m) < 5e-5);
            assert!(kept.force_n.distance(point.force_n) < 4e-3 * point.force_n.length());
            assert!(kept.normal.distance(point.normal) < 4e-3);
        }
    }
}
