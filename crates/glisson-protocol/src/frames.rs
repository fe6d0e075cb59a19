//! The binary frames of the viewer's protocol (`docs/protocol.md`), little endian.

use crate::inside::InsideView;
use crate::positions::{CodedPositions, STEP_M};
use glisson::math::DVec3;
use glisson::record::snapshot::{ClipSnapshot, ContactPoints, DisplayTopology, Snapshot, ThreadSnapshot};
pub use glisson_runtime::pace::Pace;

const MAGIC: u32 = u32::from_le_bytes(*b"GLSN");
const KIND_TOPOLOGY: u32 = 1;
const KIND_SNAPSHOT: u32 = 2;
const KIND_KEY: u32 = 3;
const FLAG_CONTACT: u32 = 1;
const FLAG_PAUSED: u32 = 2;
const FLAG_GRASPS: u32 = 4;
const FLAG_CONTACT_POINTS: u32 = 8;
const FLAG_THREADS: u32 = 16;
const FLAG_INSIDE: u32 = 32;
const FLAG_CODED: u32 = 64;
const FLAG_STRANDS: u32 = 128;
const FLAG_CLIPS: u32 = 256;
const FLAG_ODD_RESETS: u32 = 512;
/// Where a SNAPSHOT frame says how many vertices it has.
pub const N_VERTICES_AT: usize = 56;

/// Where the positions of a SNAPSHOT frame begin.
pub fn first_position(n_tools: usize) -> usize {
    64 + 152 * n_tools
}

struct FrameWriter(Vec<u8>);

impl FrameWriter {
    fn new(kind: u32, topology_version: u32) -> Self {
        let mut frame = Self(Vec::new());
        // The surface of all bodies is one, with number 0.
        frame.u32s(&[MAGIC, kind, topology_version, 0]);
        frame
    }

    fn u32s(&mut self, numbers: &[u32]) {
        self.0.extend(numbers.iter().flat_map(|x| x.to_le_bytes()));
    }

    fn f64s(&mut self, numbers: &[f64]) {
        self.0.extend(numbers.iter().flat_map(|x| x.to_le_bytes()));
    }

    /// In single precision: a display needs no more.
    fn positions(&mut self, positions_m: &[DVec3]) {
        self.0.extend(positions_m.iter().flat_map(|p| p.as_vec3().to_array()).flat_map(f32::to_le_bytes));
    }

    fn threads(&mut self, threads: &[ThreadSnapshot]) {
        self.u32s(&[threads.len() as u32]);
        for thread in threads {
            self.u32s(&[thread.nodes_m.len() as u32, thread.n_needle_nodes, thread.clips_m.len() as u32]);
            self.0.extend((thread.radius_m as f32).to_le_bytes());
            self.positions(&thread.nodes_m);
            self.positions(&thread.clips_m);
        }
    }

    fn clips(&mut self, clips: &[ClipSnapshot]) {
        self.u32s(&[clips.len() as u32]);
        for clip in clips {
            self.positions(&[clip.position_m, clip.along, clip.legs]);
            self.0.extend((clip.radius_m as f32).to_le_bytes());
        }
    }

    fn inside(&mut self, inside: &InsideView) {
        self.u32s(&[inside.field, inside.at_vertices.len() as u32, inside.section.len() as u32]);
        self.0.extend(inside.energies_j.iter().flat_map(|x| (*x as f32).to_le_bytes()));
        self.0.extend(inside.at_vertices.iter().flat_map(|x| x.to_le_bytes()));
        for (place_m, value) in &inside.section {
            self.positions(&[*place_m]);
            self.0.extend((*value as f32).to_le_bytes());
        }
    }

    fn contact_points(&mut self, contacts: &ContactPoints) {
        self.0.reserve(8 * contacts.sums.len() + 4 + 40 * contacts.points.len());
        for sum in &contacts.sums {
            self.u32s(&[sum.n]);
            self.0.extend((sum.force_n as f32).to_le_bytes());
        }
        self.u32s(&[contacts.points.len() as u32]);
        for point in &contacts.points {
            self.0.extend([point.kind as u8, point.touched, point.by, 0]);
            self.positions(&[point.place_m, point.normal, point.force_n]);
        }
    }
}

/// A TOPOLOGY frame.
pub fn topology_frame(topology: &DisplayTopology) -> Vec<u8> {
    let mut frame = FrameWriter::new(KIND_TOPOLOGY, topology.version);
    frame.u32s(&[topology.nodes.len() as u32, topology.triangles.len() as u32]);
    topology.nodes.iter().for_each(|n| frame.u32s(&[n.0]));
    frame.positions(&topology.rest_positions_m);
    frame.u32s(topology.triangles.as_flattened());
    let words = topology.is_cut.chunks(32).map(|bits| {
        bits.iter().enumerate().fold(0_u32, |word, (bit, &is_cut)| word | u32::from(is_cut) << bit)
    });
    words.for_each(|word| frame.u32s(&[word]));
    frame.0.extend_from_slice(&topology.body_of);
    frame.0.resize(frame.0.len().next_multiple_of(4), 0);
    frame.0
}

/// A KEY frame: `places` as [`PositionCoder`](super::positions::PositionCoder) writes them.
pub(crate) fn key_frame(topology_version: u32, number: u32, snapshot: &Snapshot, places: &[u8]) -> Vec<u8> {
    let mut frame = FrameWriter::new(KIND_KEY, topology_version);
    frame.u32s(&[number, snapshot.positions_m.len() as u32]);
    frame.f64s(&[STEP_M]);
    frame.0.extend(places);
    frame.0
}

/// A SNAPSHOT frame with whole positions, for those who look at contact points, or at the inside, with these.
pub fn snapshot_frame(
    snapshot: &Snapshot,
    pace: &Pace,
    contacts: Option<&ContactPoints>,
    inside: Option<&InsideView>,
) -> Vec<u8> {
    frame_with(snapshot, pace, (contacts, inside), None)
}

/// The same with positions that are differences from a key.
pub(crate) fn coded_snapshot_frame(
    snapshot: &Snapshot,
    pace: &Pace,
    contacts: Option<&ContactPoints>,
    inside: Option<&InsideView>,
    positions: &CodedPositions,
) -> Vec<u8> {
    frame_with(snapshot, pace, (contacts, inside), Some(positions))
}

fn frame_with(
    snapshot: &Snapshot,
    pace: &Pace,
    (contacts, inside): (Option<&ContactPoints>, Option<&InsideView>),
    coded: Option<&CodedPositions>,
) -> Vec<u8> {
    let mut frame = FrameWriter::new(KIND_SNAPSHOT, snapshot.topology_version);
    frame.0.extend_from_slice(&snapshot.step.to_le_bytes());
    frame.f64s(&[snapshot.time_s, pace.rate_hz, pace.real_time_factor]);
    let paused = if pace.paused { FLAG_PAUSED } else { 0 };
    let with_contacts = if contacts.is_some() { FLAG_CONTACT_POINTS } else { 0 };
    let with_threads = if snapshot.threads.is_empty() { 0 } else { FLAG_THREADS };
    let with_clips = if snapshot.bleeding.clips.is_empty() { 0 } else { FLAG_CLIPS };
    let with_inside = if inside.is_some() { FLAG_INSIDE } else { 0 };
    let with_code = if coded.is_some() { FLAG_CODED } else { 0 };
    let with_strands = if snapshot.strands_m.is_empty() { 0 } else { FLAG_STRANDS };
    let bleeding = &snapshot.bleeding;
    let n_blood = if bleeding.has_vessels { 1 + bleeding.ends.len() as u32 } else { 0 };
    let (n_tools, n_vertices) = (snapshot.tools.len() as u32, snapshot.positions_m.len() as u32);
    let optional = with_contacts | with_threads | with_clips | with_inside | with_strands;
    let of_resets = if snapshot.n_resets % 2 == 1 { FLAG_ODD_RESETS } else { 0 };
    let flags = paused | of_resets | with_code | optional;
    frame.u32s(&[flags, n_tools, n_vertices, n_blood]);
    for tool in &snapshot.tools {
        let pose = &tool.pose;
        frame.f64s(&pose.tip_in_world_m.to_array());
        frame.f64s(&pose.shaft_in_world.to_array());
        frame.f64s(&[pose.roll_rad, pose.jaw_opening, pose.trigger]);
        frame.f64s(&tool.force_n.to_array());
        let first = tool.contacts.iter().flatten().next();
        frame.f64s(&first.map_or(DVec3::ZERO, |c| c.point_m).to_array());
        let contact = if first.is_some() { FLAG_CONTACT } else { 0 };
        let grasps = if tool.n_held_nodes > 0 { FLAG_GRASPS } else { 0 };
        frame.u32s(&[contact | grasps, tool.n_held_nodes]);
        frame.f64s(&tool.shown_further_out_m.to_array());
    }
    match coded {
        Some(coded) => {
            frame.u32s(&[coded.key.number, coded.bytes.len() as u32]);
            frame.0.extend(&coded.bytes);
            frame.0.resize(frame.0.len().next_multiple_of(4), 0);
        }
        None => frame.positions(&snapshot.positions_m),
    }
    if bleeding.has_vessels {
        let sum = [bleeding.lost_m3, bleeding.rate_m3_per_s, f64::from(bleeding.n_clips), 0.0];
        let ends = bleeding.ends.iter().map(|end| {
            let [x, y, z] = end.position_m.to_array();
            [x, y, z, end.rate_m3_per_s]
        });
        for record in std::iter::once(sum).chain(ends) {
            frame.0.extend(record.into_iter().flat_map(|x| (x as f32).to_le_bytes()));
        }
    }
    if let Some(contacts) = contacts {
        frame.contact_points(contacts);
    }
    if !snapshot.threads.is_empty() {
        frame.threads(&snapshot.threads);
    }
    if !bleeding.clips.is_empty() {
        frame.clips(&bleeding.clips);
    }
    if let Some(inside) = inside {
        frame.inside(inside);
    }
    if !snapshot.strands_m.is_empty() {
        frame.u32s(&[snapshot.strands_m.len() as u32]);
        frame.positions(snapshot.strands_m.as_flattened());
    }
    frame.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::mesh::NodeId;
    use glisson::record::snapshot::{
        BleedingEnd, BleedingSnapshot, ContactKind, ContactPoint, ContactReport, ToolSnapshot,
    };
    use glisson::tool::ToolInput;

    const PACE: Pace = Pace { rate_hz: 1000.0, real_time_factor: 1.0, paused: true, slow_motion: None };
    /// Bytes of the frame of [`snapshot`] as long as nothing bleeds.
    const WITHOUT_BLOOD: usize = 64 + 2 * 152 + 9 * 4;

    /// Two instruments, one of which touches and holds.
    fn snapshot() -> Snapshot {
        let contact = ContactReport {
            point_m: DVec3::new(7.0, 8.0, 9.0),
            normal: DVec3::Z,
            nodes: [NodeId(0); 3],
            weights: [1.0, 0.0, 0.0],
        };
        let tool = ToolSnapshot {
            pose: ToolInput {
                roll_rad: 0.5,
                jaw_opening: 0.25,
                trigger: 1.0,
                ..ToolInput::at(DVec3::X, DVec3::Y)
            },
            shown_further_out_m: DVec3::new(0.5, 0.25, 0.125),
            force_n: DVec3::new(1.0, 2.0, 3.0),
            contacts: [None, Some(contact), None],
            n_held_nodes: 6,
        };
        Snapshot {
            step: 5,
            time_s: 0.25,
            topology_version: 3,
            positions_m: vec![DVec3::ONE; 3],
            tools: vec![tool, ToolSnapshot { contacts: [None; 3], n_held_nodes: 0, ..tool }],
            bleeding: BleedingSnapshot::default(),
            threads: Vec::new(),
            strands_m: Vec::new(),
            n_resets: 0,
        }
    }

    #[test]
    fn topology_frames_have_the_documented_layout() {
        let topology = DisplayTopology {
            version: 3,
            nodes: vec![NodeId(7), NodeId(9), NodeId(11)],
            rest_positions_m: vec![DVec3::X, DVec3::Y, DVec3::Z],
            triangles: vec![[0, 1, 2]],
            is_cut: vec![true],
            body_of: vec![0, 0, 2],
        };
        let frame = topology_frame(&topology);
        assert_eq!(&frame[..4], b"GLSN");
        let word = |at: usize| u32::from_le_bytes(frame[at..at + 4].try_into().unwrap());
        assert_eq!([4, 8, 12, 16, 20, 24, 28, 32].map(word), [1, 3, 0, 3, 1, 7, 9, 11]);
        assert_eq!(frame.len(), 24 + 3 * 4 + 9 * 4 + 3 * 4 + 4 + 4);
        assert_eq!(word(frame.len() - 8), 1);
        // A byte for each vertex, filled up to whole words.
        assert_eq!(frame[frame.len() - 4..], [0, 0, 2, 0]);
        // Bit by bit from the first triangle, 32 to a word.
        let n = 70;
        let is_cut: Vec<bool> = (0..n).map(|i| i % 3 == 0).collect();
        let many = topology_frame(&DisplayTopology { triangles: vec![[0, 1, 2]; n], is_cut, ..topology });
        let first = 24 + 3 * 4 + 9 * 4 + n * 3 * 4;
        assert_eq!(many.len(), first + 3 * 4 + 4);
        for i in 0..n {
            assert_eq!(many[first + i / 8] >> (i % 8) & 1 == 1, i % 3 == 0, "{i}");
        }
    }

    #[test]
    fn snapshot_frames_have_the_documented_layout() {
        let frame = snapshot_frame(&snapshot(), &PACE, None, None);
        let double = |at: usize| f64::from_le_bytes(frame[at..at + 8].try_into().unwrap());
        assert_eq!(frame[16], 5);
        let word = |at: usize| u32::from_le_bytes(frame[at..at + 4].try_into().unwrap());
        assert_eq!([24, 32, 40].map(double), [0.25, 1000.0, 1.0]);
        assert_eq!([48, 52, 56, 60].map(word), [2, 2, 3, 0]);
        let first = [64, 96, 112, 120, 128, 136, 152, 160, 176].map(double);
        assert_eq!(first, [1.0, 1.0, 0.5, 0.25, 1.0, 1.0, 3.0, 7.0, 9.0]);
        assert_eq!([184, 188].map(word), [5, 6]);
        assert_eq!([192, 200, 208].map(double), [0.5, 0.25, 0.125]);
        assert_eq!([216 + 120, 216 + 124].map(word), [0, 0]);
        assert_eq!(frame.len(), WITHOUT_BLOOD);
    }

    #[test]
    fn a_flag_changes_with_each_reset() {
        for (n_resets, expected) in [(0, 0), (1, 512), (2, 0), (7, 512)] {
            let frame = snapshot_frame(&Snapshot { n_resets, ..snapshot() }, &PACE, None, None);
            assert_eq!(u32::from_le_bytes(frame[48..52].try_into().unwrap()) & 512, expected, "{n_resets}");
        }
    }

    #[test]
    fn strands_follow_a_snapshot_as_documented() {
        let strands_m = vec![[DVec3::X, DVec3::Y], [DVec3::Z, DVec3::ONE]];
        let frame = snapshot_frame(&Snapshot { strands_m, ..snapshot() }, &PACE, None, None);
        let word = |at: usize| u32::from_le_bytes(frame[at..at + 4].try_into().unwrap());
        let number = |at: usize| f32::from_le_bytes(frame[at..at + 4].try_into().unwrap());
        assert_eq!(frame.len(), WITHOUT_BLOOD + 4 + 4 * 12);
        assert_eq!((word(48) & FLAG_STRANDS, word(WITHOUT_BLOOD)), (FLAG_STRANDS, 2));
        let first = WITHOUT_BLOOD + 4;
        assert_eq!([first, first + 16, first + 32, first + 36].map(number), [1.0, 1.0, 1.0, 1.0]);
    }

    #[test]
    fn threads_follow_a_snapshot_as_documented() {
        let thread = ThreadSnapshot {
            radius_m: 0.5,
            nodes_m: vec![DVec3::X, DVec3::Y, DVec3::Z],
            n_needle_nodes: 2,
            clips_m: vec![DVec3::ONE],
        };
        let frame = snapshot_frame(&Snapshot { threads: vec![thread], ..snapshot() }, &PACE, None, None);
        let without = snapshot_frame(&snapshot(), &PACE, None, None);
        let word = |at: usize| u32::from_le_bytes(frame[at..at + 4].try_into().unwrap());
        assert_eq!((frame.len(), without.len()), (WITHOUT_BLOOD + 4 + 16 + 12 * 4, WITHOUT_BLOOD));
        assert_eq!([0, 4, 8, 12].map(|at| word(WITHOUT_BLOOD + at)), [1, 3, 2, 1]);
        assert_eq!(word(48), u32::from_le_bytes(without[48..52].try_into().unwrap()) | 16);
        let number = |at: usize| f32::from_bits(word(WITHOUT_BLOOD + at));
        assert_eq!([16, 20, 56, 60].map(number), [0.5, 1.0, 1.0, 1.0]);
    }

    #[test]
    fn bleeding_follows_a_snapshot_as_documented() {
        let end = BleedingEnd { position_m: DVec3::new(1.0, 2.0, 3.0), rate_m3_per_s: 0.5 };
        let ends = vec![end; 2];
        let (lost_m3, rate_m3_per_s) = (0.25, 1.0);
        let bleeding = BleedingSnapshot {
            has_vessels: true,
            lost_m3,
            rate_m3_per_s,
            n_clips: 3,
            ends,
            clips: Vec::new(),
        };
        let frame = snapshot_frame(&Snapshot { bleeding, ..snapshot() }, &PACE, None, None);
        assert_eq!(frame[60], 3, "a sum and two ends");
        assert_eq!(frame.len(), WITHOUT_BLOOD + 3 * 16);
        let single = |at: usize| f32::from_le_bytes(frame[at..at + 4].try_into().unwrap());
        let tail: Vec<f32> = (0..8).map(|i| single(WITHOUT_BLOOD + 4 * i)).collect();
        assert_eq!(tail, [0.25, 1.0, 3.0, 0.0, 1.0, 2.0, 3.0, 0.5]);
    }

    #[test]
    fn clips_follow_a_snapshot_as_documented() {
        let clip = ClipSnapshot { position_m: DVec3::ONE, along: DVec3::X, legs: DVec3::Z, radius_m: 0.5 };
        let bleeding = BleedingSnapshot { n_clips: 3, clips: vec![clip; 2], ..BleedingSnapshot::default() };
        let frame = snapshot_frame(&Snapshot { bleeding, ..snapshot() }, &PACE, None, None);
        let word = |at: usize| u32::from_le_bytes(frame[at..at + 4].try_into().unwrap());
        assert_eq!((frame.len(), word(WITHOUT_BLOOD)), (WITHOUT_BLOOD + 4 + 2 * 40, 2));
        assert_eq!(word(48), FLAG_PAUSED | 256);
        let numbers: Vec<f32> = (0..10).map(|i| f32::from_bits(word(WITHOUT_BLOOD + 44 + 4 * i))).collect();
        assert_eq!(numbers, [1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.5]);
    }

    #[test]
    fn contact_points_are_the_last_part_as_documented_and_change_nothing_before_them() {
        let mut contacts = ContactPoints::default();
        let point = |kind: ContactKind, size_n: f64| ContactPoint {
            kind,
            touched: 2,
            by: 1,
            place_m: DVec3::new(0.5, 0.25, 0.125),
            normal: DVec3::Y,
            force_n: DVec3::new(0.0, size_n, 0.0),
        };
        contacts.add(point(ContactKind::ToolRigid, 4.0));
        contacts.add(point(ContactKind::Itself, 2.0));
        contacts.add(point(ContactKind::Itself, 1.0));
        contacts.keep_greatest(1, 1);
        contacts.add(point(ContactKind::Tools, 8.0));
        let ends = vec![BleedingEnd { position_m: DVec3::ONE, rate_m3_per_s: 0.5 }];
        let bleeding = BleedingSnapshot { has_vessels: true, ends, ..BleedingSnapshot::default() };
        let snapshot = Snapshot { bleeding, ..snapshot() };
        let without = snapshot_frame(&snapshot, &PACE, None, None);
        let with = snapshot_frame(&snapshot, &PACE, Some(&contacts), None);
        let n = without.len();
        assert_eq!(with.len(), n + 5 * 8 + 4 + 3 * 40);
        assert_eq!((without[48], with[48]), (2, 2 + 8));
        assert!(with[..48] == without[..48] && with[49..n] == without[49..]);
        let word = |at: usize| u32::from_le_bytes(with[n + at..n + at + 4].try_into().unwrap());
        let single = |at: usize| f32::from_bits(word(at));
        assert_eq!([0, 8, 16, 24, 32, 40].map(word), [0, 1, 0, 2, 1, 3]);
        assert_eq!([4, 12, 20, 28, 36].map(single), [0.0, 4.0, 0.0, 3.0, 8.0]);
        assert_eq!(with[n + 44..n + 48], [1, 2, 1, 0]);
        assert_eq!(with[n + 84..n + 88], [3, 2, 1, 0]);
        assert_eq!(with[n + 124..n + 128], [4, 2, 1, 0]);
        let numbers: Vec<f32> = (0..9).map(|i| single(88 + 4 * i)).collect();
        assert_eq!(numbers, [0.5, 0.25, 0.125, 0.0, 1.0, 0.0, 0.0, 2.0, 0.0]);
    }

    #[test]
    fn what_is_looked_at_inside_comes_last_with_its_numbers() {
        let mut snapshot = snapshot();
        snapshot.threads.clear();
        let section = vec![(DVec3::new(1.0, 2.0, 3.0), 4.0); 3];
        let view = InsideView {
            field: 2,
            energies_j: [0.5, 0.25, 0.125],
            at_vertices: vec![7.0, 8.0, 9.0],
            section,
        };
        let frame = snapshot_frame(&snapshot, &PACE, None, Some(&view));
        let word = |at: usize| u32::from_le_bytes(frame[at..at + 4].try_into().unwrap());
        let float = |at: usize| f32::from_le_bytes(frame[at..at + 4].try_into().unwrap());
        assert_eq!(word(48), FLAG_PAUSED | FLAG_INSIDE);
        let first = WITHOUT_BLOOD;
        assert_eq!([0, 4, 8].map(|at| word(first + at)), [2, 3, 3]);
        assert_eq!(
            [12, 16, 20, 24, 32, 36, 48].map(|at| float(first + at)),
            [0.5, 0.25, 0.125, 7.0, 9.0, 1.0, 4.0]
        );
        assert_eq!(frame.len(), first + 24 + 12 + 3 * 16);
    }
}
