//! What detection adds to the messages (`docs/network.md`): touches with the hands, nodes near the instruments with the
//! tissues, the surface after a cut in pieces, and the haptic loop's figures.

use super::wire::{MOST, MessageError, Reader, put};
use glisson::haptics::{EnergyControl, ForceEstimate};
use glisson::mesh::{NodeId, TriangleId};
use glisson::tool::external_detection::{ExternalDetection, ExternalTouch, N_TOUCHING_PARTS, TouchingPoint};
use glisson_runtime::elsewhere::{MOST_NODES, NodePlace};
use glisson_runtime::force_choices::ForceChoices;
use glisson_runtime::haptic_loop::{HapticReport, HapticSettings};
use glisson_runtime::histogram::Percentiles;
use glisson_runtime::realtime::Scheduling;

/// Triangles or nodes of a piece: with 16 bytes each it fits into one packet of Ethernet.
pub(crate) const PIECE_ITEMS: usize = 64;
/// Triangles and nodes of a surface that is handed over, at most: a choice, far above what is simulated in real time.
const MOST_ITEMS: u32 = 1 << 20;
/// Octaves of a histogram of nanoseconds, at most.
const MOST_OCTAVES: usize = 64;

const TOUCH_BYTES: usize = 1 + 4 + 3 * 8 + 3 * 8 + 1 + 3 * 8 + 8;
/// Bytes of what was detected for an instrument, at most.
pub(super) const DETECTED_BYTES: usize = 1 + 4 + 1 + N_TOUCHING_PARTS * TOUCH_BYTES;
const PERCENTILES_BYTES: usize = 5 * 8;
/// Bytes of the figures, at most.
pub(super) const FIGURES_BYTES: usize =
    1 + 2 * 8 + 4 * 8 + 4 * PERCENTILES_BYTES + 8 + 3 + 1 + MOST_OCTAVES * 16;
pub(super) const HELD_BYTES: usize = 8 + 8 + 4 + 8;
pub(super) const NAME_BYTES: usize = 4 + 8 + 4 + 4;
/// Bytes of the nodes near an instrument, at most.
pub(super) const NODES_BYTES: usize = 1 + MOST_NODES * 16;
/// Bytes of a piece, at most.
pub(super) const PIECE_BYTES: usize = NAME_BYTES + 4 + PIECE_ITEMS * 16;

/// Which surface: what its triangles are, and how many pieces it takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct SurfaceName {
    /// Version in the simulation.
    pub(crate) version: u32,
    /// First 8 bytes of BLAKE3 of its triangles; 0: it is being cut and not known yet.
    pub(crate) hash: u64,
    pub(crate) n_triangles: u32,
    pub(crate) n_nodes: u32,
}

impl SurfaceName {
    /// Pieces of triangles, which come first.
    pub(crate) fn n_triangle_pieces(&self) -> u32 {
        self.n_triangles.div_ceil(PIECE_ITEMS as u32)
    }

    /// All pieces.
    pub(crate) fn n_pieces(&self) -> u32 {
        self.n_triangle_pieces() + self.n_nodes.div_ceil(PIECE_ITEMS as u32)
    }

    /// Whether it can be handed over.
    pub(crate) fn is_known(&self) -> bool {
        self.hash != 0
            && (1..=MOST_ITEMS).contains(&self.n_triangles)
            && (1..=MOST_ITEMS).contains(&self.n_nodes)
    }
}

/// What the haptics machine has of the surface: an acknowledgement with each message.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct HeldSurface {
    /// Hash of the one that it holds whole; 0: none.
    pub(crate) held: u64,
    /// Hash of the one whose pieces it collects; 0: none.
    pub(crate) collects: u64,
    /// The first piece that it has not ...
    pub(crate) first_missing: u32,
    /// ... and a bit for each of the 64 from there on: whether it has it.
    pub(crate) has: u64,
}

/// A part of a surface.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SurfacePiece {
    pub(crate) surface: SurfaceName,
    /// Which piece, from 0: those of triangles come first.
    pub(crate) index: u32,
    pub(crate) items: PieceItems,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum PieceItems {
    /// Triangles and their nodes, counter-clockwise from outside.
    Triangles(Vec<(TriangleId, [NodeId; 3])>),
    Nodes(Vec<NodePlace>),
}

pub(super) fn put_detected(bytes: &mut Vec<u8>, detected: Option<&ExternalDetection>) {
    let Some(detected) = detected else { return bytes.push(0) };
    bytes.push(1);
    bytes.extend(detected.surface_version.to_le_bytes());
    bytes.push(detected.touches.iter().flatten().count() as u8);
    for (part, touch) in detected.touches.iter().enumerate() {
        let Some(ExternalTouch { triangle, weights, normal, at, gap_m }) = touch else { continue };
        bytes.push(part as u8);
        bytes.extend(triangle.0.to_le_bytes());
        put(bytes, weights);
        put(bytes, &normal.to_array());
        let (kind, point) = match at {
            TouchingPoint::OnAxis(along) => (0, [*along, 0.0, 0.0]),
            TouchingPoint::Fixed(in_tool_m) => (1, in_tool_m.to_array()),
        };
        bytes.push(kind);
        put(bytes, &point);
        put(bytes, &[*gap_m]);
    }
}

pub(super) fn put_held(bytes: &mut Vec<u8>, held: &HeldSurface) {
    bytes.extend(held.held.to_le_bytes());
    bytes.extend(held.collects.to_le_bytes());
    bytes.extend(held.first_missing.to_le_bytes());
    bytes.extend(held.has.to_le_bytes());
}

pub(super) fn put_name(bytes: &mut Vec<u8>, name: &SurfaceName) {
    bytes.extend(name.version.to_le_bytes());
    bytes.extend(name.hash.to_le_bytes());
    bytes.extend(name.n_triangles.to_le_bytes());
    bytes.extend(name.n_nodes.to_le_bytes());
}

fn put_node(bytes: &mut Vec<u8>, place: &NodePlace) {
    bytes.extend(place.node.to_le_bytes());
    bytes.extend(place.position_m.iter().flat_map(|x| x.to_le_bytes()));
}

pub(super) fn put_nodes(bytes: &mut Vec<u8>, nodes: &[NodePlace]) {
    let nodes = &nodes[..nodes.len().min(MOST_NODES)];
    bytes.push(nodes.len() as u8);
    nodes.iter().for_each(|place| put_node(bytes, place));
}

pub(super) fn put_piece(bytes: &mut Vec<u8>, piece: &SurfacePiece) {
    put_name(bytes, &piece.surface);
    bytes.extend(piece.index.to_le_bytes());
    match &piece.items {
        PieceItems::Triangles(triangles) => {
            for (triangle, nodes) in triangles {
                bytes.extend(triangle.0.to_le_bytes());
                bytes.extend(nodes.iter().flat_map(|node| node.0.to_le_bytes()));
            }
        }
        PieceItems::Nodes(nodes) => nodes.iter().for_each(|place| put_node(bytes, place)),
    }
}

pub(super) fn put_figures(bytes: &mut Vec<u8>, figures: Option<&HapticReport>) {
    let Some(report) = figures else { return bytes.push(0) };
    bytes.push(1);
    put(bytes, &[report.rate_hz, report.settings.rate_hz]);
    for count in [report.n_deadlines, report.n_missed, report.n_saturated, report.n_stale] {
        bytes.extend(count.to_le_bytes());
    }
    for p in [&report.jitter, &report.motion_to_force, &report.model_age, &report.work] {
        for number in [p.n, p.p50_ns, p.p99_ns, p.p999_ns, p.greatest_ns] {
            bytes.extend(number.to_le_bytes());
        }
    }
    put(bytes, &[report.least_energy_j]);
    let forces = report.settings.forces;
    let estimate = ForceEstimate::ALL.iter().position(|e| *e == forces.estimate).unwrap_or(0);
    let is_real_time = report.scheduling.as_ref().is_some_and(|s| s.is_real_time);
    bytes.extend([estimate as u8, u8::from(forces.is_controlled()), u8::from(is_real_time)]);
    let octaves = &report.jitter_octaves[..report.jitter_octaves.len().min(MOST_OCTAVES)];
    bytes.push(octaves.len() as u8);
    for (end_ns, n) in octaves {
        bytes.extend(end_ns.to_le_bytes());
        bytes.extend(n.to_le_bytes());
    }
}

/// A number in its range, or why not. None everywhere here: the bytes ended too early.
type Read<T> = Option<Result<T, MessageError>>;

impl Reader<'_> {
    fn u32(&mut self) -> Option<u32> {
        self.take().map(u32::from_le_bytes)
    }

    fn f32(&mut self) -> Option<f32> {
        self.take().map(f32::from_le_bytes)
    }

    pub(super) fn detected(&mut self) -> Read<Option<ExternalDetection>> {
        let wrong = |what: &'static str| Some(Err(MessageError::Number(what)));
        match self.take()? {
            [0] => return Some(Ok(None)),
            [1] => {}
            _ => return wrong("whether anything was looked for"),
        }
        let mut detected = ExternalDetection { surface_version: self.u32()?, ..ExternalDetection::default() };
        let [n_touches] = self.take()?;
        if usize::from(n_touches) > N_TOUCHING_PARTS {
            return wrong("the number of touches");
        }
        let mut last = None;
        for _ in 0..n_touches {
            let [part] = self.take()?;
            let triangle = TriangleId(self.u32()?);
            let weights = self.vector()?.to_array();
            let normal = self.vector()?;
            let [kind] = self.take()?;
            let point = self.vector()?;
            let at = if kind == 0 { TouchingPoint::OnAxis(point.x) } else { TouchingPoint::Fixed(point) };
            let touch = ExternalTouch { triangle, weights, normal, at, gap_m: self.f64()? };
            // On an axis only the share counts: what else is said is nothing.
            let is_one = match kind {
                0 => point.y.to_bits() == 0 && point.z.to_bits() == 0,
                1 => point.abs().max_element() <= MOST,
                _ => false,
            };
            let ascends = last.is_none_or(|last| last < part);
            if usize::from(part) >= N_TOUCHING_PARTS || !ascends || !is_one || !touch.is_plausible() {
                return wrong("a touch");
            }
            detected.touches[usize::from(part)] = Some(touch);
            last = Some(part);
        }
        Some(Ok(Some(detected)))
    }

    pub(super) fn held(&mut self) -> Option<HeldSurface> {
        Some(HeldSurface {
            held: self.u64()?,
            collects: self.u64()?,
            first_missing: self.u32()?,
            has: self.u64()?,
        })
    }

    pub(super) fn name(&mut self) -> Option<SurfaceName> {
        let (version, hash) = (self.u32()?, self.u64()?);
        Some(SurfaceName { version, hash, n_triangles: self.u32()?, n_nodes: self.u32()? })
    }

    fn node(&mut self) -> Read<NodePlace> {
        let place = NodePlace { node: self.u32()?, position_m: [self.f32()?, self.f32()?, self.f32()?] };
        let is_place = place.position_m.iter().all(|x| f64::from(x.abs()) <= MOST);
        Some(if is_place { Ok(place) } else { Err(MessageError::Number("the place of a node")) })
    }

    pub(super) fn nodes(&mut self) -> Read<Vec<NodePlace>> {
        let [n] = self.take()?;
        if usize::from(n) > MOST_NODES {
            return Some(Err(MessageError::Number("the number of nodes")));
        }
        (0..n).map(|_| self.node()).collect()
    }

    pub(super) fn piece(&mut self) -> Read<SurfacePiece> {
        let (surface, index) = (self.name()?, self.u32()?);
        if !surface.is_known() || index >= surface.n_pieces() {
            return Some(Err(MessageError::Number("the piece of a surface")));
        }
        // How many are left for the last piece of its kind.
        let left = |n: u32, piece: u32| (n - piece * PIECE_ITEMS as u32).min(PIECE_ITEMS as u32);
        let n_first = surface.n_triangle_pieces();
        let items = if index < n_first {
            let triangles = (0..left(surface.n_triangles, index)).map(|_| {
                let (triangle, [a, b, c]) = (self.u32()?, [self.u32()?, self.u32()?, self.u32()?]);
                Some((TriangleId(triangle), [NodeId(a), NodeId(b), NodeId(c)]))
            });
            Ok(PieceItems::Triangles(triangles.collect::<Option<_>>()?))
        } else {
            let nodes = (0..left(surface.n_nodes, index - n_first)).map(|_| self.node());
            nodes.collect::<Option<Result<_, _>>>()?.map(PieceItems::Nodes)
        };
        Some(items.map(|items| SurfacePiece { surface, index, items }))
    }

    fn percentiles(&mut self) -> Option<Percentiles> {
        Some(Percentiles {
            n: self.u64()?,
            p50_ns: self.u64()?,
            p99_ns: self.u64()?,
            p999_ns: self.u64()?,
            greatest_ns: self.u64()?,
        })
    }

    pub(super) fn figures(&mut self) -> Read<Option<Box<HapticReport>>> {
        let wrong = Some(Err(MessageError::Number("a figure of the haptic loop")));
        match self.take()? {
            [0] => return Some(Ok(None)),
            [1] => {}
            _ => return wrong,
        }
        let (rate_hz, set_hz) = (self.f64()?, self.f64()?);
        let (n_deadlines, n_missed, n_saturated, n_stale) =
            (self.u64()?, self.u64()?, self.u64()?, self.u64()?);
        let (jitter, motion_to_force) = (self.percentiles()?, self.percentiles()?);
        let (model_age, work) = (self.percentiles()?, self.percentiles()?);
        let least_energy_j = self.f64()?;
        let [estimate, is_controlled, is_real_time, n_octaves] = self.take()?;
        let is_number = |x: f64| x.abs() <= MOST;
        let Some(&estimate) = ForceEstimate::ALL.get(usize::from(estimate)) else { return wrong };
        if ![rate_hz, set_hz, least_energy_j].into_iter().all(is_number)
            || set_hz <= 0.0
            || is_controlled > 1
            || is_real_time > 1
            || usize::from(n_octaves) > MOST_OCTAVES
        {
            return wrong;
        }
        let octaves = (0..n_octaves).map(|_| Some((self.u64()?, self.u64()?)));
        let jitter_octaves = octaves.collect::<Option<_>>()?;
        let control = if is_controlled == 1 { EnergyControl::Tank } else { EnergyControl::ObserveOnly };
        let forces = ForceChoices { estimate, control, ..ForceChoices::default() };
        let text = "as the other machine has it".to_owned();
        Some(Ok(Some(Box::new(HapticReport {
            rate_hz,
            n_deadlines,
            n_missed,
            n_saturated,
            n_stale,
            jitter,
            jitter_octaves,
            motion_to_force,
            model_age,
            work,
            least_energy_j,
            scheduling: Some(Scheduling { is_real_time: is_real_time == 1, core: None, text }),
            settings: HapticSettings { rate_hz: set_hz, forces, ..HapticSettings::default() },
        }))))
    }
}
