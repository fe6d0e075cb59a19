//! What two machines tell each other (`docs/network.md`): the machine with the devices sends where the instruments are,
//! the machine that simulates sends what the tissue does to them. Nothing else crosses.
//!
//! Every message says everything anew, so one that is lost is made good by the next, and a newcomer is current after
//! one message. Little endian; a head of [`HEAD_BYTES`], the content, a tag over both.

use super::seal::{Seal, TAG_BYTES};
use glisson::haptics::{HapticModel, Touch};
use glisson::math::{DMat3, DVec3};
use glisson::tool::{MAX_TOOLS, ToolInput};

/// Version of the messages; another one is refused.
pub(crate) const VERSION: u16 = 1;
const MAGIC: [u8; 4] = *b"GLNK";
/// Bytes of a head.
pub(crate) const HEAD_BYTES: usize = 72;
const MOTION_BYTES: usize = 9 * 8 + 1;
const MODEL_BYTES: usize = 8 + 1 + 3 * 8 + 6 * 24 + 72 + 2 * 8;
/// Bytes of the longest message.
pub(crate) const MOST_BYTES: usize = HEAD_BYTES + MAX_TOOLS * (MODEL_BYTES + 8) + TAG_BYTES;

/// How far the length of a shaft may be from 1: rounding, and no more.
const SHAFT_TOLERANCE: f64 = 1e-6;

/// Which scene the sender runs: BLAKE3 of its text and mesh.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) struct SceneHash(pub(crate) [u8; 32]);

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
}

/// What the tissue does to an instrument, and how old that was when it was sent.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Tissue {
    pub(crate) model: HapticModel,
    pub(crate) age_ns: u64,
}

/// The content of a message.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Content {
    /// From the machine with the devices: every instrument, in the scene's order.
    Hands(Vec<Hand>),
    /// From the machine that simulates: every instrument, in the scene's order.
    Tissues(Vec<Tissue>),
}

/// Why bytes are not a message for us.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum MessageError {
    #[error("{0} bytes are too few or too many for a message")]
    Length(usize),
    #[error("it does not begin like a message of Glisson")]
    Magic,
    #[error("it is of version {0}, this program speaks version {VERSION}: use the same release on both machines")]
    Version(u16),
    #[error("its tag is wrong: damaged on the way, or the two machines do not have the same --link-key")]
    Tag,
    #[error("content {0} is unknown")]
    Kind(u8),
    #[error("{0} instruments: a scene has 1 to {MAX_TOOLS}")]
    Tools(u8),
    #[error("{0} is out of its range or not a number")]
    Number(&'static str),
}

const KIND_HANDS: u8 = 1;
const KIND_TISSUES: u8 = 2;

/// Writes the message into `bytes`, which is emptied first.
pub(crate) fn encode_into(head: &Head, content: &Content, seal: &Seal, bytes: &mut Vec<u8>) {
    bytes.clear();
    let (kind, n_tools) = match content {
        Content::Hands(hands) => (KIND_HANDS, hands.len()),
        Content::Tissues(tissues) => (KIND_TISSUES, tissues.len()),
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
        Content::Hands(hands) => hands.iter().for_each(|hand| put_hand(bytes, hand)),
        Content::Tissues(tissues) => tissues.iter().for_each(|tissue| put_tissue(bytes, tissue)),
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
        KIND_HANDS => (0..n_tools).map(|_| reader.hand()).collect::<Option<Result<_, _>>>()?.map(Content::Hands),
        KIND_TISSUES => {
            (0..n_tools).map(|_| reader.tissue()).collect::<Option<Result<_, _>>>()?.map(Content::Tissues)
        }
        other => Err(MessageError::Kind(other)),
    };
    Some(content.map(|content| (head, content)))
}

fn put(bytes: &mut Vec<u8>, numbers: &[f64]) {
    bytes.extend(numbers.iter().flat_map(|x| x.to_le_bytes()));
}

fn put_hand(bytes: &mut Vec<u8>, hand: &Hand) {
    let ToolInput { tip_in_world_m, shaft_in_world, roll_rad, jaw_opening, trigger } = hand.pose;
    put(bytes, &tip_in_world_m.to_array());
    put(bytes, &shaft_in_world.to_array());
    put(bytes, &[roll_rad, jaw_opening, trigger]);
    bytes.push(u8::from(hand.is_held));
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
    put(bytes, &[model.gap_m, model.friction_coefficient]);
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

/// Takes from the front; None where too little is left.
struct Reader<'a>(&'a [u8]);

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (taken, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(*taken)
    }

    fn u64(&mut self) -> Option<u64> {
        self.take().map(u64::from_le_bytes)
    }

    fn f64(&mut self) -> Option<f64> {
        self.take().map(f64::from_le_bytes)
    }

    fn vector(&mut self) -> Option<DVec3> {
        Some(DVec3::new(self.f64()?, self.f64()?, self.f64()?))
    }

    fn matrix(&mut self) -> Option<DMat3> {
        Some(DMat3::from_cols(self.vector()?, self.vector()?, self.vector()?))
    }

    fn hand(&mut self) -> Option<Result<Hand, MessageError>> {
        let (tip_in_world_m, shaft_in_world) = (self.vector()?, self.vector()?);
        let (roll_rad, jaw_opening, trigger) = (self.f64()?, self.f64()?, self.f64()?);
        let pose = ToolInput { tip_in_world_m, shaft_in_world, roll_rad, jaw_opening, trigger };
        let [is_held] = self.take()?;
        let is_share = |x: f64| (0.0..=1.0).contains(&x);
        Some(match is_held {
            _ if !pose.is_finite() => Err(MessageError::Number("the place of an instrument")),
            _ if (shaft_in_world.length() - 1.0).abs() > SHAFT_TOLERANCE => {
                Err(MessageError::Number("the length of a shaft's direction"))
            }
            _ if !is_share(jaw_opening) || !is_share(trigger) => {
                Err(MessageError::Number("the opening of jaws or the trigger"))
            }
            0 | 1 => Ok(Hand { pose, is_held: is_held == 1 }),
            _ => Err(MessageError::Number("whether an instrument is held")),
        })
    }

    fn tissue(&mut self) -> Option<Result<Tissue, MessageError>> {
        let (age_ns, step) = (self.u64()?, self.u64()?);
        let [touch] = self.take()?;
        let model = HapticModel {
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
            ..HapticModel::default()
        };
        Some(touch_of(touch).and_then(|touch| checked(HapticModel { touch, ..model })).map(|model| Tissue { model, age_ns }))
    }
}

/// A force that is not a number must not reach a hand.
fn checked(model: HapticModel) -> Result<HapticModel, MessageError> {
    let vectors = [
        model.tip_m,
        model.tip_velocity_m_per_s,
        model.force_n,
        model.surface_m,
        model.normal,
        model.surface_velocity_m_per_s,
    ];
    let are_finite = vectors.iter().all(|v| v.is_finite())
        && model.stiffness_n_per_m.is_finite()
        && [model.time_s, model.period_s, model.gap_m].iter().all(|x| x.is_finite());
    // What sticks has an infinite coefficient.
    if are_finite && model.friction_coefficient >= 0.0 {
        Ok(model)
    } else {
        Err(MessageError::Number("a model of the tissue"))
    }
}
