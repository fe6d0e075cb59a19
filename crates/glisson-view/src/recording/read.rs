//! Reads a recording: the same frames that a server would have sent.

use super::error::RecordingError;
use super::surface::Surface;
use super::{MAGIC, MOST_UNPACKED, VERSION};
use flate2::read::ZlibDecoder;
use glisson_protocol::frames;
use glisson_protocol::quantized::numbers::Taker;
use glisson_protocol::quantized::places::Place;
use serde::Deserialize;
use serde_json::Value;
use std::io::Read as _;

/// What stands before the blocks.
#[derive(Debug, Deserialize)]
struct Head {
    step_m: f64,
    hellos: Vec<Value>,
    time_s: Vec<f64>,
    /// First frame, bytes, bytes unpacked.
    blocks: Vec<[usize; 3]>,
    task: Option<Value>,
}

/// A recording that is read.
#[derive(Debug)]
pub struct RecordingReader<'a> {
    head: Head,
    blocks: Vec<&'a [u8]>,
}

/// A frame as a server sends it.
#[derive(Debug, PartialEq)]
pub enum Frame {
    /// A TOPOLOGY frame.
    Topology(Vec<u8>),
    /// A SNAPSHOT frame.
    Snapshot(Vec<u8>),
}

fn unpack(bytes: &[u8], most: usize) -> Result<Vec<u8>, RecordingError> {
    let mut unpacked = Vec::new();
    // One byte more tells that there is more than there should be.
    let read = ZlibDecoder::new(bytes).take(most as u64 + 1).read_to_end(&mut unpacked);
    read.map_err(|_| RecordingError::Broken("what was packed cannot be unpacked"))?;
    if unpacked.len() > most {
        return Err(RecordingError::Broken("a part is larger than it says"));
    }
    Ok(unpacked)
}

impl<'a> RecordingReader<'a> {
    /// Reads the head; frames are unpacked when they are asked for.
    ///
    /// # Errors
    /// When `bytes` are no whole recording.
    pub fn new(bytes: &'a [u8]) -> Result<Self, RecordingError> {
        let mut from = Taker(bytes);
        if from.bytes(4) != Ok(MAGIC) {
            return Err(RecordingError::NoRecording);
        }
        let mut word = || -> Result<u32, RecordingError> {
            let bytes = from.bytes(4)?;
            Ok(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
        };
        let (version, n) = (word()?, word()?);
        if version != VERSION {
            return Err(RecordingError::Version(version));
        }
        let head = unpack(from.bytes(n as usize)?, MOST_UNPACKED)?;
        let head: Head = serde_json::from_slice(&head)
            .map_err(|_| RecordingError::Broken("its head is not understood"))?;
        let blocks = head.blocks.iter().map(|[_, n, _]| from.bytes(*n)).collect::<Result<Vec<_>, _>>()?;
        let mut first = 0;
        for (i, [frame, _, n_raw]) in head.blocks.iter().enumerate() {
            let is_next = *frame >= first && (i > 0 || *frame == 0);
            if !is_next || *frame >= head.time_s.len() || *n_raw > MOST_UNPACKED {
                return Err(RecordingError::Broken("its list of blocks makes no sense"));
            }
            first = frame + 1;
        }
        Ok(Self { head, blocks })
    }

    /// Frames.
    pub fn n_frames(&self) -> usize {
        self.head.time_s.len()
    }

    /// What is said of the scene: each `{"first_frame", "hello"}`.
    pub fn hellos(&self) -> &[Value] {
        &self.head.hellos
    }

    /// The result of the task.
    pub fn task(&self) -> Option<&Value> {
        self.head.task.as_ref()
    }

    /// Tells all frames one after the other: topologies, where they change, and snapshots.
    ///
    /// # Errors
    /// When something is broken.
    pub fn each_frame(&self, mut tell: impl FnMut(Frame)) -> Result<(), RecordingError> {
        let step_m = self.head.step_m;
        let mut wholes: Vec<Option<Surface>> = Vec::new();
        for (number, bytes) in self.blocks.iter().enumerate() {
            let [first, _, n_raw] = self.head.blocks[number];
            let end = self.head.blocks.get(number + 1).map_or(self.n_frames(), |next| next[0]);
            let raw = unpack(bytes, n_raw)?;
            let mut from = Taker(&raw);
            let at = from.number()? as usize;
            wholes.push(if at == number {
                Some(Surface::take_after(&Surface::default(), &mut from)?)
            } else {
                None
            });
            let whole = wholes.get(at).and_then(Option::as_ref);
            let mut surface = whole.ok_or(RecordingError::Broken("a block has no surface"))?.clone();
            tell(Frame::Topology(frames::topology_frame(&surface.topology(step_m))));
            let mut places = surface.rest();
            let (mut head, mut tail) = (Vec::new(), Vec::new());
            for frame in first..end {
                if frame > first && from.byte()? == 1 {
                    let next = Surface::take_after(&surface, &mut from)?;
                    places = next.expected(&surface, &places);
                    surface = next;
                    tell(Frame::Topology(frames::topology_frame(&surface.topology(step_m))));
                }
                head = take_changed(&mut from, &head)?;
                take_places(&mut from, &mut places)?;
                tail = take_changed(&mut from, &tail)?;
                check_head(&head, surface.n_vertices())?;
                let mut whole = head.clone();
                let metres = places.as_flattened().iter().map(|&x| (f64::from(x) * step_m) as f32);
                whole.extend(metres.flat_map(f32::to_le_bytes));
                whole.extend(&tail);
                tell(Frame::Snapshot(whole));
            }
            if !from.0.is_empty() {
                return Err(RecordingError::Broken("a block goes on after its last frame"));
            }
        }
        Ok(())
    }
}

/// The head says how many vertices follow.
fn check_head(head: &[u8], n_vertices: usize) -> Result<(), RecordingError> {
    let says = head.get(frames::N_VERTICES_AT..frames::N_VERTICES_AT + 4);
    if says != Some(&(n_vertices as u32).to_le_bytes()[..]) {
        return Err(RecordingError::Broken("a frame has not the vertices of its surface"));
    }
    Ok(())
}

fn take_changed(from: &mut Taker, before: &[u8]) -> Result<Vec<u8>, RecordingError> {
    let n = from.number()? as usize;
    let bytes = from.bytes(n)?;
    Ok(bytes.iter().zip(before.iter().chain(std::iter::repeat(&0))).map(|(x, y)| x ^ y).collect())
}

fn take_places(from: &mut Taker, places: &mut [Place]) -> Result<(), RecordingError> {
    for axis in 0..3 {
        for place in &mut *places {
            place[axis] = place[axis].wrapping_add(from.signed()?);
        }
    }
    Ok(())
}
