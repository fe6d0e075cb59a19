//! What two machines tell each other (`docs/network.md`): the machine with the devices sends where the instruments are
//! and what they touch, the machine that simulates sends what the tissue does to them and where it is near them. After a
//! cut it sends the new surface, in pieces. Nothing else crosses.
//!
//! Every message but a piece says everything anew, so one that is lost is made good by the next; pieces are said again until
//! they are acknowledged. Little endian; a head of [`HEAD_BYTES`], the content, a tag over both.

use super::contact_messages::{
    DETECTED_BYTES, FIGURES_BYTES, HELD_BYTES, HeldSurface, NAME_BYTES, NODES_BYTES, PIECE_BYTES,
    SurfaceName, SurfacePiece, put_detected, put_figures, put_held, put_name, put_nodes, put_piece,
};
use super::seal::{Seal, TAG_BYTES};
use super::wire::{MOST, MessageError, Reader, VERSION, put};
use glisson::haptics::{AxesModel, HapticModel, Touch, TouchedPart};
use glisson::math::{DMat3, DVec3};
use glisson::tool::external_detection::ExternalDetection;
use glisson::tool::{MAX_TOOLS, ToolInput};
use glisson_runtime::elsewhere::NodePlace;
use glisson_runtime::haptic_loop::HapticReport;

const MAGIC: [u8; 4] = *b"GLNK";
/// Bytes of a head.
pub(crate) const HEAD_BYTES: usize = 72;
const MOTION_BYTES: usize = 9 * 8 + 1 + DETECTED_BYTES;
const PART_BYTES: usize = 1 + 2 * 24 + 2 * 72 + 8;
const AXES_BYTES: usize = 6 * 8;
const MODEL_BYTES: usize =
    8 + 8 + 1 + 2 * 8 + 6 * 24 + 72 + 3 * 8 + AXES_BYTES + 1 + HapticModel::MOST_PARTS * PART_BYTES;
/// Bytes of the longest message.
pub(crate) const MOST_BYTES: usize =
    HEAD_BYTES + NAME_BYTES + MAX_TOOLS * (MODEL_BYTES + NODES_BYTES) + TAG_BYTES;
const _: () = assert!(
    MAX_TOOLS * MOTION_BYTES + HELD_BYTES + FIGURES_BYTES < MOST_BYTES - HEAD_BYTES - TAG_BYTES
        && PIECE_BYTES < MODEL_BYTES + NODES_BYTES,
    "the longest message is one of models"
);

/// How far the length of a shaft may be from 1: rounding, and no more.
const SHAFT_TOLERANCE: f64 = 1e-6;

/// Which scene the sender runs: BLAKE3 of its text and mesh.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct SceneHash(pub [u8; 32]);

impl SceneHash {
    /// What each head carries of it.
    pub(crate) fn short(&self) -> u64 {
        u64::from_le_bytes(self.0[..8].try_into().expect("32 bytes hold 8"))
    }
}

impl std::fmt::Debug for SceneHash {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:016x}", self.short().swap_bytes())
    }
}

/// The head of a message.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Head {
    /// Short form of the scene's hash.
    pub(crate) scene: u64,
    /// Grows with each start of the sender: a sender that starts again is told from one that is late.
    pub(crate) session: u64,
    /// Counts the messages of a session, from 1.
    pub(crate) sequence: u64,
    /// When it was sent, on the sender's clock [ns].
    pub(crate) sent_ns: u64,
    /// Session of the receiver whose message the sender heard last; 0: none.
    pub(crate) heard_session: u64,
    /// That message's sequence ...
    pub(crate) heard_sequence: u64,
    /// ... and `sent_ns`, on the receiver's own clock.
    pub(crate) heard_sent_ns: u64,
    /// How long ago the sender heard it [ns].
    pub(crate) heard_ago_ns: u64,
}

/// Where a device has its instrument.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Hand {
    pub(crate) pose: ToolInput,
    /// Whether a device holds it; otherwise it stays where it was.
    pub(crate) is_held: bool,
    /// What was found on the way there; none where nothing was looked for.
    pub(crate) detected: Option<ExternalDetection>,
}

/// What the tissue does to an instrument, how old that was when it was sent, and where the tissue is.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Tissue {
    pub(crate) model: HapticModel,
    pub(crate) age_ns: u64,
    /// Near the instrument, and some of the rest in turn.
    pub(crate) nodes: Vec<NodePlace>,
}

/// The content of a message.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Content {
    /// From the machine with the devices: every instrument, in the scene's order.
    Hands {
        hands: Vec<Hand>,
        held: HeldSurface,
        /// Of the haptic loop, now and then.
        figures: Option<Box<HapticReport>>,
    },
    /// From the machine that simulates: every instrument, in the scene's order.
    Tissues { tissues: Vec<Tissue>, surface: SurfaceName },
    /// From the machine that simulates: a part of its surface.
    Piece(SurfacePiece),
}

const KIND_HANDS: u8 = 1;
const KIND_TISSUES: u8 = 2;
const KIND_PIECE: u8 = 3;

/// Writes the message into `bytes`, which is emptied first.
pub(crate) fn encode_into(head: &Head, content: &Content, seal: &Seal, bytes: &mut Vec<u8>) {
    bytes.clear();
    let (kind, n_tools) = match content {
        Content::Hands { hands, .. } => (KIND_HANDS, hands.len()),
        Content::Tissues { tissues, .. } => (KIND_TISSUES, tissues.len()),
        // Of no instrument.
        Content::Piece(_) => (KIND_PIECE, 1),
    };
    bytes.extend(MAGIC);
    bytes.extend(VERSION.to_le_bytes());
    bytes.extend([kind, n_tools as u8]);
    for number in [
        head.scene,
        head.session,
        head.sequence,
        head.sent_ns,
        head.heard_session,
        head.heard_sequence,
        head.heard_sent_ns,
        head.heard_ago_ns,
    ] {
        bytes.extend(number.to_le_bytes());
    }
    debug_assert_eq!(bytes.len(), HEAD_BYTES);
    match content {
        Content::Hands { hands, held, figures } => {
            hands.iter().for_each(|hand| put_hand(bytes, hand));
            put_held(bytes, held);
            put_figures(bytes, figures.as_deref());
        }
        Content::Tissues { tissues, surface } => {
            put_name(bytes, surface);
            tissues.iter().for_each(|tissue| put_tissue(bytes, tissue));
        }
        Content::Piece(piece) => put_piece(bytes, piece),
    }
    let tag = seal.tag(bytes);
    bytes.extend(tag);
}

/// Reads a message.
///
/// # Errors
/// [`MessageError`]; never a panic, whatever the bytes are.
pub(crate) fn decode(bytes: &[u8], seal: &Seal) -> Result<(Head, Content), MessageError> {
    if !(HEAD_BYTES + TAG_BYTES..=MOST_BYTES).contains(&bytes.len()) {
        return Err(MessageError::Length(bytes.len()));
    }
    let (sealed, tag) = bytes.split_at(bytes.len() - TAG_BYTES);
    let mut reader = Reader(sealed);
    if reader.take::<4>() != Some(MAGIC) {
        return Err(MessageError::Magic);
    }
    // Before the tag, which another version may make otherwise.
    let version = reader.take().map_or(0, u16::from_le_bytes);
    if version != VERSION {
        return Err(MessageError::Version(version));
    }
    if seal.tag(sealed) != tag {
        return Err(MessageError::Tag);
    }
    let length = MessageError::Length(bytes.len());
    read(&mut reader).ok_or(length.clone())?.and_then(|message| {
        // Nothing may follow.
        if reader.0.is_empty() { Ok(message) } else { Err(length) }
    })
}

/// None: the bytes ended too early.
fn read(reader: &mut Reader<'_>) -> Option<Result<(Head, Content), MessageError>> {
    let [kind, n_tools] = reader.take()?;
    if !(1..=MAX_TOOLS).contains(&usize::from(n_tools)) {
        return Some(Err(MessageError::Tools(n_tools)));
    }
    let head = Head {
        scene: reader.u64()?,
        session: reader.u64()?,
        sequence: reader.u64()?,
        sent_ns: reader.u64()?,
        heard_session: reader.u64()?,
        heard_sequence: reader.u64()?,
        heard_sent_ns: reader.u64()?,
        heard_ago_ns: reader.u64()?,
    };
    let content = match kind {
        KIND_HANDS => {
            let hands: Result<_, _> = (0..n_tools).map(|_| reader.hand()).collect::<Option<_>>()?;
            match hands {
                Ok(hands) => {
                    let held = reader.held()?;
                    reader.figures()?.map(|figures| Content::Hands { hands, held, figures })
                }
                Err(error) => Err(error),
            }
        }
        KIND_TISSUES => {
            let surface = reader.name()?;
            let tissues: Result<_, _> = (0..n_tools).map(|_| reader.tissue()).collect::<Option<_>>()?;
            tissues.map(|tissues| Content::Tissues { tissues, surface })
        }
        KIND_PIECE => reader.piece()?.map(Content::Piece),
        other => Err(MessageError::Kind(other)),
    };
    Some(content.map(|content| (head, content)))
}

fn put_hand(bytes: &mut Vec<u8>, hand: &Hand) {
    let ToolInput { tip_in_world_m, shaft_in_world, roll_rad, jaw_opening, trigger } = hand.pose;
    put(bytes, &tip_in_world_m.to_array());
    put(bytes, &shaft_in_world.to_array());
    put(bytes, &[roll_rad, jaw_opening, trigger]);
    bytes.push(u8::from(hand.is_held));
    put_detected(bytes, hand.detected.as_ref());
}

fn put_tissue(bytes: &mut Vec<u8>, tissue: &Tissue) {
    let model = &tissue.model;
    bytes.extend(tissue.age_ns.to_le_bytes());
    bytes.extend(model.step.to_le_bytes());
    bytes.push(touch_code(model.touch));
    put(bytes, &[model.time_s, model.period_s]);
    for vector in [
        model.tip_m,
        model.tip_velocity_m_per_s,
        model.force_n,
        model.surface_m,
        model.normal,
        model.surface_velocity_m_per_s,
    ] {
        put(bytes, &vector.to_array());
    }
    put(bytes, &model.stiffness_n_per_m.to_cols_array());
    put(bytes, &[model.gap_m, model.friction_coefficient, model.hold_n]);
    let AxesModel { twist_n_m, roll_rad, twist_stiffness_n_m_per_rad, jaw_j, jaw_opening, jaw_stiffness_j } =
        model.axes;
    put(bytes, &[twist_n_m, roll_rad, twist_stiffness_n_m_per_rad, jaw_j, jaw_opening, jaw_stiffness_j]);
    let parts = &model.parts[..(model.n_parts as usize).min(HapticModel::MOST_PARTS)];
    bytes.push(parts.len() as u8);
    for part in parts {
        bytes.push(touch_code(part.touch));
        put(bytes, &part.force_n.to_array());
        put(bytes, &part.stiffness_n_per_m.to_cols_array());
        put(bytes, &part.normal.to_array());
        put(bytes, &[part.friction_coefficient]);
        put(bytes, &part.lever.to_cols_array());
    }
    put_nodes(bytes, &tissue.nodes);
}

fn touch_code(touch: Touch) -> u8 {
    match touch {
        Touch::Free => 0,
        Touch::Contact => 1,
        Touch::Grasp => 2,
    }
}

fn touch_of(code: u8) -> Result<Touch, MessageError> {
    [Touch::Free, Touch::Contact, Touch::Grasp]
        .get(usize::from(code))
        .copied()
        .ok_or(MessageError::Number("the kind of touch"))
}

impl Reader<'_> {
    fn matrix(&mut self) -> Option<DMat3> {
        Some(DMat3::from_cols(self.vector()?, self.vector()?, self.vector()?))
    }

    fn axes(&mut self) -> Option<AxesModel> {
        Some(AxesModel {
            twist_n_m: self.f64()?,
            roll_rad: self.f64()?,
            twist_stiffness_n_m_per_rad: self.f64()?,
            jaw_j: self.f64()?,
            jaw_opening: self.f64()?,
            jaw_stiffness_j: self.f64()?,
        })
    }

    fn hand(&mut self) -> Option<Result<Hand, MessageError>> {
        let (tip_in_world_m, shaft_in_world) = (self.vector()?, self.vector()?);
        let (roll_rad, jaw_opening, trigger) = (self.f64()?, self.f64()?, self.f64()?);
        let pose = ToolInput { tip_in_world_m, shaft_in_world, roll_rad, jaw_opening, trigger };
        let [is_held] = self.take()?;
        let detected = match self.detected()? {
            Ok(detected) => detected,
            Err(error) => return Some(Err(error)),
        };
        let is_share = |x: f64| (0.0..=1.0).contains(&x);
        Some(match is_held {
            _ if !pose.is_finite() || !is_plausible(tip_in_world_m) || roll_rad.abs() > MOST => {
                Err(MessageError::Number("the place of an instrument"))
            }
            _ if (shaft_in_world.length() - 1.0).abs() > SHAFT_TOLERANCE => {
                Err(MessageError::Number("the length of a shaft's direction"))
            }
            _ if !is_share(jaw_opening) || !is_share(trigger) => {
                Err(MessageError::Number("the opening of jaws or the trigger"))
            }
            0 | 1 => Ok(Hand { pose, is_held: is_held == 1, detected }),
            _ => Err(MessageError::Number("whether an instrument is held")),
        })
    }

    fn tissue(&mut self) -> Option<Result<Tissue, MessageError>> {
        let (age_ns, step) = (self.u64()?, self.u64()?);
        let [touch] = self.take()?;
        let mut model = HapticModel {
            step,
            time_s: self.f64()?,
            period_s: self.f64()?,
            tip_m: self.vector()?,
            tip_velocity_m_per_s: self.vector()?,
            force_n: self.vector()?,
            surface_m: self.vector()?,
            normal: self.vector()?,
            surface_velocity_m_per_s: self.vector()?,
            stiffness_n_per_m: self.matrix()?,
            gap_m: self.f64()?,
            friction_coefficient: self.f64()?,
            hold_n: self.f64()?,
            axes: self.axes()?,
            ..HapticModel::default()
        };
        let [n_parts] = self.take()?;
        if usize::from(n_parts) > HapticModel::MOST_PARTS {
            return Some(Err(MessageError::Number("the number of parts that touch")));
        }
        model.n_parts = u32::from(n_parts);
        let mut codes = [touch; HapticModel::MOST_PARTS];
        for (part, code) in model.parts.iter_mut().zip(&mut codes).take(usize::from(n_parts)) {
            [*code] = self.take()?;
            *part = TouchedPart {
                touch: Touch::Free,
                force_n: self.vector()?,
                stiffness_n_per_m: self.matrix()?,
                normal: self.vector()?,
                friction_coefficient: self.f64()?,
                lever: self.matrix()?,
            };
        }
        let nodes = match self.nodes()? {
            Ok(nodes) => nodes,
            Err(error) => return Some(Err(error)),
        };
        let model = touch_of(touch).and_then(|touch| {
            model.touch = touch;
            for (part, code) in model.parts.iter_mut().zip(codes).take(usize::from(n_parts)) {
                part.touch = touch_of(code)?;
            }
            checked(model)
        });
        Some(model.map(|model| Tissue { model, age_ns, nodes }))
    }
}

/// Whether every component is a number that an operation can have [m, m/s, N, s].
fn is_plausible(vector: DVec3) -> bool {
    vector.abs().max_element() <= MOST && !vector.is_nan()
}

/// A force that is not a number, or that would become none, must not reach a hand.
fn checked(model: HapticModel) -> Result<HapticModel, MessageError> {
    let is_plausible_matrix =
        |m: DMat3| [m.x_axis, m.y_axis, m.z_axis].iter().all(|column| is_plausible(*column / MOST));
    let vectors = [
        model.tip_m,
        model.tip_velocity_m_per_s,
        model.force_n,
        model.surface_m,
        model.normal,
        model.surface_velocity_m_per_s,
        DVec3::new(model.time_s / MOST, model.period_s, model.gap_m),
        DVec3::new(model.axes.twist_n_m, model.axes.roll_rad, model.axes.twist_stiffness_n_m_per_rad),
        DVec3::new(model.axes.jaw_j, model.axes.jaw_opening, model.axes.jaw_stiffness_j),
    ];
    let parts = &model.parts[..model.n_parts as usize];
    let are_plausible = vectors.iter().all(|v| is_plausible(*v))
        && is_plausible_matrix(model.stiffness_n_per_m)
        && parts.iter().all(|part| {
            is_plausible(part.force_n)
                && is_plausible_matrix(part.stiffness_n_per_m)
                && is_plausible(part.normal)
                && part.friction_coefficient >= 0.0
                && is_plausible_matrix(part.lever)
        });
    // What sticks has an infinite coefficient, what holds without a limit an infinite force.
    if are_plausible && model.friction_coefficient >= 0.0 && model.hold_n >= 0.0 {
        Ok(model)
    } else {
        Err(MessageError::Number("a model of the tissue"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contact_messages::{PIECE_ITEMS, PieceItems};
    use glisson::mesh::{NodeId, TriangleId};
    use glisson::tool::external_detection::{ExternalTouch, TouchingPoint};
    use glisson_runtime::elsewhere::MOST_NODES;
    use glisson_runtime::haptic_loop::Meters;
    use glisson_runtime::realtime::Scheduling;

    /// A small generator of the tests' own (xorshift): the same bytes each time.
    pub(super) struct Random(pub(super) u64);

    impl Random {
        pub(super) fn next(&mut self) -> u64 {
            self.0 ^= self.0 << 13;
            self.0 ^= self.0 >> 7;
            self.0 ^= self.0 << 17;
            self.0
        }

        fn number(&mut self) -> f64 {
            (self.next() >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
        }

        fn vector(&mut self) -> DVec3 {
            DVec3::new(self.number(), self.number(), self.number())
        }

        fn matrix(&mut self) -> DMat3 {
            DMat3::from_cols(self.vector(), self.vector(), self.vector())
        }

        fn hand(&mut self) -> Hand {
            let pose = ToolInput {
                roll_rad: self.number(),
                jaw_opening: self.number().abs(),
                trigger: self.number().abs(),
                ..ToolInput::at(self.vector(), self.vector().normalize())
            };
            let touch = ExternalTouch {
                triangle: TriangleId(self.next() as u32),
                weights: [0.5, 0.25, 0.25],
                normal: self.vector().normalize(),
                at: TouchingPoint::OnAxis(self.number().abs()),
                gap_m: self.number(),
            };
            let on_mesh = ExternalTouch { at: TouchingPoint::Fixed(self.vector()), ..touch };
            let touches = [touch, on_mesh, touch].map(|touch| self.next().is_multiple_of(2).then_some(touch));
            let detected = ExternalDetection { surface_version: self.next() as u32, touches };
            let detected = self.next().is_multiple_of(2).then_some(detected);
            Hand { pose, is_held: self.next().is_multiple_of(2), detected }
        }

        fn tissue(&mut self) -> Tissue {
            let n_parts = (self.next() % 5) as u32;
            let mut model = HapticModel {
                step: self.next(),
                time_s: self.number(),
                period_s: self.number(),
                touch: touch_of((self.next() % 3) as u8).unwrap(),
                tip_m: self.vector(),
                tip_velocity_m_per_s: self.vector(),
                force_n: self.vector(),
                stiffness_n_per_m: self.matrix(),
                surface_m: self.vector(),
                normal: self.vector(),
                gap_m: self.number(),
                surface_velocity_m_per_s: self.vector(),
                friction_coefficient: if n_parts == 1 { f64::INFINITY } else { self.number().abs() },
                hold_n: if n_parts == 2 { f64::INFINITY } else { self.number().abs() },
                n_parts,
                axes: AxesModel {
                    twist_n_m: self.number(),
                    roll_rad: self.number(),
                    twist_stiffness_n_m_per_rad: self.number(),
                    jaw_j: self.number(),
                    jaw_opening: self.number(),
                    jaw_stiffness_j: self.number(),
                },
                ..HapticModel::default()
            };
            for part in &mut model.parts[..n_parts as usize] {
                let touch = touch_of((self.next() % 3) as u8).unwrap();
                let (force_n, stiffness_n_per_m, normal) = (self.vector(), self.matrix(), self.vector());
                let friction_coefficient = self.number().abs();
                let lever = self.matrix();
                *part =
                    TouchedPart { touch, force_n, stiffness_n_per_m, normal, friction_coefficient, lever };
            }
            let n_nodes = self.next() as usize % (MOST_NODES + 1);
            Tissue { model, age_ns: self.next(), nodes: (0..n_nodes).map(|_| self.node()).collect() }
        }

        fn node(&mut self) -> NodePlace {
            NodePlace::of(NodeId(self.next() as u32), self.vector())
        }

        fn name(&mut self) -> SurfaceName {
            let n_triangles = 1 + self.next() as u32 % 1_000;
            let (version, hash) = (self.next() as u32, self.next().max(1));
            SurfaceName { version, hash, n_triangles, n_nodes: 1 + self.next() as u32 % 1_000 }
        }

        fn piece(&mut self) -> SurfacePiece {
            let surface = self.name();
            let index = self.next() as u32 % surface.n_pieces();
            let n_first = surface.n_triangle_pieces();
            let left = |n: u32, piece: u32| (n as usize - piece as usize * PIECE_ITEMS).min(PIECE_ITEMS);
            let items = if index < n_first {
                let mut id = || self.next() as u32;
                let n = left(surface.n_triangles, index);
                let triangle = |_| (TriangleId(id()), [NodeId(id()), NodeId(id()), NodeId(id())]);
                PieceItems::Triangles((0..n).map(triangle).collect())
            } else {
                let n = left(surface.n_nodes, index - n_first);
                PieceItems::Nodes((0..n).map(|_| self.node()).collect())
            };
            SurfacePiece { surface, index, items }
        }

        fn held(&mut self) -> HeldSurface {
            let (held, collects) = (self.next(), self.next());
            HeldSurface { held, collects, first_missing: self.next() as u32, has: self.next() }
        }

        pub(super) fn message(&mut self) -> (Head, Content) {
            let head = Head {
                scene: self.next(),
                session: self.next(),
                sequence: self.next(),
                sent_ns: self.next(),
                heard_session: self.next(),
                heard_sequence: self.next(),
                heard_sent_ns: self.next(),
                heard_ago_ns: self.next(),
            };
            let n_tools = 1 + self.next() % MAX_TOOLS as u64;
            let content = match self.next() % 4 {
                0 => Content::Hands {
                    hands: (0..n_tools).map(|_| self.hand()).collect(),
                    held: self.held(),
                    figures: self.next().is_multiple_of(2).then(|| Box::new(figures(self.next()))),
                },
                1 => Content::Piece(self.piece()),
                _ => {
                    let tissues = (0..n_tools).map(|_| self.tissue()).collect();
                    Content::Tissues { tissues, surface: self.name() }
                }
            };
            (head, content)
        }
    }

    /// What a loop that ran would say.
    fn figures(n: u64) -> HapticReport {
        let meters = Meters::default();
        let mut report = meters.report();
        (report.rate_hz, report.n_deadlines, report.n_missed) = (999.5, n, n % 7);
        report.jitter_octaves = (0..n % 65).map(|i| (1 << i.min(40), n ^ i)).collect();
        report.jitter.p99_ns = n;
        let text = "as the other machine has it".to_owned();
        report.scheduling = Some(Scheduling { is_real_time: n.is_multiple_of(2), core: None, text });
        report
    }

    fn key() -> Seal {
        Seal::Key(Box::new([7; 32]))
    }

    #[test]
    fn a_message_comes_back_bit_by_bit() {
        let mut random = Random(0x9E37_79B9_7F4A_7C15);
        let mut bytes = Vec::with_capacity(MOST_BYTES);
        for round in 0..500 {
            let seal = if round % 2 == 0 { Seal::Check } else { key() };
            let (head, content) = random.message();
            encode_into(&head, &content, &seal, &mut bytes);
            assert_eq!(decode(&bytes, &seal), Ok((head, content)), "round {round}");
        }
        let mut tissue = random.tissue();
        tissue.model.n_parts = HapticModel::MOST_PARTS as u32;
        tissue.nodes.resize(MOST_NODES, NodePlace::default());
        let surface = random.name();
        let longest = Content::Tissues { tissues: vec![tissue; MAX_TOOLS], surface };
        encode_into(&Head::default(), &longest, &key(), &mut bytes);
        assert_eq!(decode(&bytes, &key()), Ok((Head::default(), longest)));
        assert_eq!((bytes.len(), bytes.capacity()), (MOST_BYTES, MOST_BYTES));
    }

    #[test]
    fn a_head_and_a_hand_have_the_documented_layout() {
        let head = Head {
            scene: 1,
            session: 2,
            sequence: 3,
            sent_ns: 4,
            heard_session: 5,
            heard_sequence: 6,
            heard_sent_ns: 7,
            heard_ago_ns: 8,
        };
        let pose = ToolInput {
            roll_rad: 0.5,
            jaw_opening: 0.25,
            trigger: 1.0,
            ..ToolInput::at(DVec3::new(1.0, 2.0, 3.0), DVec3::Y)
        };
        let mut bytes = Vec::new();
        let held = HeldSurface { held: 9, collects: 10, first_missing: 11, has: 12 };
        let content =
            Content::Hands { hands: vec![Hand { pose, is_held: true, detected: None }], held, figures: None };
        encode_into(&head, &content, &Seal::Check, &mut bytes);
        assert_eq!(bytes.len(), 72 + 74 + 28 + 1 + 16);
        assert_eq!(&bytes[..8], b"GLNK\x02\0\x01\x01");
        let word = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
        assert_eq!([8, 16, 24, 32, 40, 48, 56, 64].map(word), [1, 2, 3, 4, 5, 6, 7, 8]);
        let numbers: Vec<f64> = (0..9).map(|i| f64::from_bits(word(72 + 8 * i))).collect();
        assert_eq!(numbers, [1.0, 2.0, 3.0, 0.0, 1.0, 0.0, 0.5, 0.25, 1.0]);
        assert_eq!((bytes[144], bytes[145]), (1, 0));
        assert_eq!([146, 154, 166].map(word), [9, 10, 12]);
        assert_eq!(word(175), super::super::crc64::crc64(&bytes[..175]));
        assert_eq!(word(183), 0);
    }

    #[test]
    fn whatever_the_bytes_are_nothing_breaks_and_no_damage_passes() {
        let mut random = Random(1);
        let mut bytes = Vec::new();
        for round in 0..20_000 {
            let seal = if round % 2 == 0 { Seal::Check } else { key() };
            let (head, content) = random.message();
            encode_into(&head, &content, &seal, &mut bytes);
            let at = random.next() as usize % bytes.len();
            match random.next() % 3 {
                // A flipped bit, a cut end: both are seen.
                0 => bytes[at] ^= 1 << (random.next() % 8),
                1 => bytes.truncate(at),
                // Anything, with a good tag: must only not break anything.
                _ => {
                    let sealed = bytes.len() - TAG_BYTES;
                    let first = random.next() as usize % sealed;
                    bytes[first..sealed].iter_mut().take(40).for_each(|byte| *byte = random.next() as u8);
                    let tag = seal.tag(&bytes[..sealed]);
                    bytes[sealed..].copy_from_slice(&tag);
                    if let Ok((_, Content::Tissues { tissues, .. })) = decode(&bytes, &seal) {
                        for tissue in tissues {
                            let force_n = tissue.model.force_at(DVec3::ZERO, 0.1);
                            assert!(!force_n.is_nan(), "{tissue:?}");
                        }
                    }
                    continue;
                }
            }
            assert!(decode(&bytes, &seal).is_err(), "round {round}");
        }
    }

    #[test]
    fn another_version_another_key_and_strangers_are_told_apart() {
        let (head, content) = Random(3).message();
        let mut bytes = Vec::new();
        encode_into(&head, &content, &key(), &mut bytes);
        let other = Seal::Key(Box::new([8; 32]));
        assert_eq!(decode(&bytes, &other), Err(MessageError::Tag));
        assert_eq!(decode(&bytes, &Seal::Check), Err(MessageError::Tag));
        // The one before: it had no touches.
        bytes[4] = 1;
        assert_eq!(decode(&bytes, &key()), Err(MessageError::Version(1)));
        assert_eq!(decode(&[b'x'; 300], &key()), Err(MessageError::Magic));
        assert_eq!(decode(b"GLNK", &key()), Err(MessageError::Length(4)));
        let message = MessageError::Version(1).to_string();
        assert!(message.contains("same release"), "{message}");
    }
}
