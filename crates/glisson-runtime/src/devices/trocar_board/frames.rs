//! Frames of the active trocar's board.
//!
//! `A5 5A | version | kind | trocar | n | sequence (2) | payload (n) | check (2)`, numbers least byte first; the check is
//! CRC-16 with the polynomial 0x1021 and the start 0xFFFF ("CCITT-FALSE") over everything between the two first bytes and
//! itself. With at most 64 bytes of payload it finds every three wrong bits. The protocol is our own: the seed's board is
//! not described.

use glisson::haptics::trocar::{EncoderSample, N_AXES};

/// Begin of every frame.
const SYNC: [u8; 2] = [0xA5, 0x5A];
/// What this file describes.
pub(crate) const VERSION: u8 = 1;
const HEADER_BYTES: usize = 8;
const CHECK_BYTES: usize = 2;
/// Longest payload.
pub(crate) const MOST_PAYLOAD_BYTES: usize = 64;
/// Longest frame.
pub(crate) const MOST_FRAME_BYTES: usize = HEADER_BYTES + MOST_PAYLOAD_BYTES + CHECK_BYTES;
/// Trocars on one line: numbers from 0.
pub(crate) const MOST_TROCARS: u8 = glisson::haptics::trocar::placement::MOST_TROCARS as u8;

/// What the analog outputs are to be.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Outputs {
    /// Share of the full scale of each motor, 32767 for all of it, in the order of the axes.
    pub(crate) levels: [i16; N_AXES],
    /// Whether the amplifiers are on.
    pub(crate) is_enabled: bool,
}

/// What the board says of itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Place of its profile in `TrocarProfile::NAMES`, from 1.
    pub(crate) profile: u8,
    pub(crate) firmware: u16,
    pub(crate) serial: u32,
    /// States a second.
    pub rate_hz: u16,
}

/// What the board sees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct State {
    /// The board's clock [microseconds], round and round.
    pub(crate) time_us: u32,
    /// Bits of [`flags`].
    pub(crate) flags: u16,
    pub(crate) encoders: EncoderSample,
    /// The instrument's tag; zeros without.
    pub(crate) tag: [u8; 4],
    pub(crate) buttons: u8,
}

/// Bits of [`State::flags`].
pub(crate) mod flags {
    /// An instrument is in the trocar.
    pub(crate) const PRESENT: u16 = 1;
    /// The amplifiers are on.
    pub(crate) const ENABLED: u16 = 2;
    /// The emergency stop is pressed: no motor runs.
    pub(crate) const STOPPED: u16 = 4;
    /// Motors or amplifiers are too hot: no motor runs.
    pub(crate) const HOT: u16 = 8;
    /// No outputs came for too long: no motor runs until some do.
    pub(crate) const TIMED_OUT: u16 = 16;
    /// All that have a meaning.
    pub(crate) const ALL: u16 = 31;
}

/// What a frame says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Message {
    /// To the board: say what you are.
    Greeting,
    /// To the board.
    Outputs(Outputs),
    /// To the board: all outputs to zero, amplifiers off.
    Stop,
    /// From the board.
    Identity(Identity),
    /// From the board.
    State(State),
    /// From the board: it could not read a frame, for the reason of this number ([`FrameError::code`]).
    Refusal(u8),
}

const GREETING: u8 = 0x01;
const OUTPUTS: u8 = 0x02;
const STOP: u8 = 0x03;
const IDENTITY: u8 = 0x81;
const STATE: u8 = 0x82;
const REFUSAL: u8 = 0x83;

/// A frame that was read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Frame {
    /// Which trocar, from 0.
    pub(crate) trocar: u8,
    /// Counts the sender's frames, round and round.
    pub(crate) sequence: u16,
    pub(crate) message: Message,
}

/// Why bytes are no frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameError {
    /// They begin with no frame.
    Noise { n_bytes: usize },
    /// Another protocol.
    Version { found: u8 },
    /// A payload that is too long.
    Length { found: u8 },
    /// Bytes were changed on the way.
    Check { found: u16, wanted: u16 },
    /// No such message.
    Kind { found: u8 },
    /// No such trocar.
    Trocar { found: u8 },
    /// A payload of another length than the message has.
    PayloadLength { kind: u8, found: usize, wanted: usize },
    /// A byte or bits without a meaning.
    Value { what: &'static str, found: u16, most: u16 },
}

impl FrameError {
    /// On the wire; 0 is none.
    pub(crate) fn code(self) -> u8 {
        match self {
            Self::Noise { .. } => 1,
            Self::Version { .. } => 2,
            Self::Length { .. } => 3,
            Self::Check { .. } => 4,
            Self::Kind { .. } => 5,
            Self::Trocar { .. } => 6,
            Self::PayloadLength { .. } => 7,
            Self::Value { .. } => 8,
        }
    }
}

impl std::fmt::Display for FrameError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match *self {
            Self::Noise { n_bytes } => write!(f, "{n_bytes} bytes before A5 5A, where a frame begins"),
            Self::Version { found } => write!(f, "protocol version {found}; this program speaks {VERSION}"),
            Self::Length { found } => {
                write!(f, "a payload of {found} bytes; {MOST_PAYLOAD_BYTES} at most")
            }
            Self::Check { found, wanted } => {
                write!(
                    f,
                    "check {found:#06x}, but the bytes have {wanted:#06x}: they were changed on the way"
                )
            }
            Self::Kind { found } => write!(f, "a message of kind {found:#04x}, which there is not"),
            Self::Trocar { found } => write!(f, "trocar {found}; 0 to {} on a line", MOST_TROCARS - 1),
            Self::PayloadLength { kind, found, wanted } => {
                write!(f, "a message of kind {kind:#04x} with {found} bytes; it has {wanted}")
            }
            Self::Value { what, found, most } => write!(f, "{what} {found}; 0 to {most}"),
        }
    }
}

/// CRC-16 with the polynomial 0x1021, start 0xFFFF, nothing reflected ("CCITT-FALSE"): 0x29B1 of "123456789".
fn check_of(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0xFFFF, |crc, byte| {
        (0..8).fold(crc ^ u16::from(*byte) << 8, |crc: u16, _| {
            if crc & 0x8000 == 0 { crc << 1 } else { (crc << 1) ^ 0x1021 }
        })
    })
}

/// A frame as bytes: `bytes[..n]`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FrameBytes {
    bytes: [u8; MOST_FRAME_BYTES],
    n: usize,
}

impl FrameBytes {
    pub(crate) fn as_slice(&self) -> &[u8] {
        &self.bytes[..self.n]
    }

    fn push(&mut self, bytes: &[u8]) {
        self.bytes[self.n..self.n + bytes.len()].copy_from_slice(bytes);
        self.n += bytes.len();
    }
}

impl Frame {
    pub(crate) fn to_bytes(self) -> FrameBytes {
        let mut out = FrameBytes { bytes: [0; MOST_FRAME_BYTES], n: 0 };
        out.push(&SYNC);
        out.push(&[VERSION, self.message.kind(), self.trocar, 0]);
        out.push(&self.sequence.to_le_bytes());
        match self.message {
            Message::Greeting | Message::Stop => {}
            Message::Outputs(outputs) => {
                outputs.levels.iter().for_each(|level| out.push(&level.to_le_bytes()));
                out.push(&[u8::from(outputs.is_enabled)]);
            }
            Message::Identity(identity) => {
                out.push(&[identity.profile]);
                out.push(&identity.firmware.to_le_bytes());
                out.push(&identity.serial.to_le_bytes());
                out.push(&identity.rate_hz.to_le_bytes());
            }
            Message::State(state) => {
                out.push(&state.time_us.to_le_bytes());
                out.push(&state.flags.to_le_bytes());
                let encoders = &state.encoders;
                for count in encoders.counts.iter().chain(&encoders.mark_counts) {
                    out.push(&count.to_le_bytes());
                }
                out.push(&[bits(encoders.is_marked)]);
                out.push(&state.tag);
                out.push(&[state.buttons]);
            }
            Message::Refusal(code) => out.push(&[code]),
        }
        out.bytes[5] = (out.n - HEADER_BYTES) as u8;
        let check = check_of(&out.bytes[SYNC.len()..out.n]);
        out.push(&check.to_le_bytes());
        out
    }
}

fn bits(flags: [bool; N_AXES]) -> u8 {
    flags.into_iter().rev().fold(0, |byte, flag| byte << 1 | u8::from(flag))
}

/// Reads a payload from its front; its length was checked.
struct Payload<'a>(&'a [u8]);

impl Payload<'_> {
    fn take<const N: usize>(&mut self) -> [u8; N] {
        let (front, rest) = self.0.split_at(N);
        self.0 = rest;
        std::array::from_fn(|i| front[i])
    }

    fn byte(&mut self) -> u8 {
        self.take::<1>()[0]
    }
}

impl Message {
    fn kind(&self) -> u8 {
        match self {
            Self::Greeting => GREETING,
            Self::Outputs(_) => OUTPUTS,
            Self::Stop => STOP,
            Self::Identity(_) => IDENTITY,
            Self::State(_) => STATE,
            Self::Refusal(_) => REFUSAL,
        }
    }

    fn parse(kind: u8, payload: &[u8]) -> Result<Self, FrameError> {
        let wanted = match kind {
            GREETING | STOP => 0,
            OUTPUTS => 2 * N_AXES + 1,
            IDENTITY => 9,
            STATE => 12 + 8 * N_AXES,
            REFUSAL => 1,
            _ => return Err(FrameError::Kind { found: kind }),
        };
        if payload.len() != wanted {
            return Err(FrameError::PayloadLength { kind, found: payload.len(), wanted });
        }
        let mut payload = Payload(payload);
        let within = |what: &'static str, found: u16, most: u16| {
            if found > most { Err(FrameError::Value { what, found, most }) } else { Ok(()) }
        };
        Ok(match kind {
            GREETING => Self::Greeting,
            STOP => Self::Stop,
            OUTPUTS => {
                let levels = std::array::from_fn(|_| i16::from_le_bytes(payload.take()));
                let enabled = payload.byte();
                within("\"amplifiers on\" is", enabled.into(), 1)?;
                Self::Outputs(Outputs { levels, is_enabled: enabled == 1 })
            }
            IDENTITY => Self::Identity(Identity {
                profile: payload.byte(),
                firmware: u16::from_le_bytes(payload.take()),
                serial: u32::from_le_bytes(payload.take()),
                rate_hz: u16::from_le_bytes(payload.take()),
            }),
            STATE => {
                let time_us = u32::from_le_bytes(payload.take());
                let flags = u16::from_le_bytes(payload.take());
                within("flags are", flags, flags::ALL)?;
                let counts = std::array::from_fn(|_| i32::from_le_bytes(payload.take()));
                let mark_counts = std::array::from_fn(|_| i32::from_le_bytes(payload.take()));
                let marked = payload.byte();
                within("marks are", marked.into(), (1 << N_AXES) - 1)?;
                let is_marked = std::array::from_fn(|i| marked >> i & 1 == 1);
                let encoders = EncoderSample { counts, mark_counts, is_marked };
                Self::State(State { time_us, flags, encoders, tag: payload.take(), buttons: payload.byte() })
            }
            _ => Self::Refusal(payload.byte()),
        })
    }
}

/// Room for what came in and is no whole frame yet.
const ROOM_BYTES: usize = 512;

/// Finds frames in a stream of bytes. After bytes that are no frame it looks for the next begin; it holds at most 512
/// bytes and never allocates.
#[derive(Clone, Debug)]
pub(crate) struct FrameDecoder {
    bytes: [u8; ROOM_BYTES],
    n: usize,
}

impl FrameDecoder {
    pub(crate) fn new() -> Self {
        Self { bytes: [0; ROOM_BYTES], n: 0 }
    }

    /// Takes as many of `bytes` as there is room for; how many. There is room for all of a call's bytes again once
    /// [`FrameDecoder::next_frame`] has answered none.
    pub(crate) fn push(&mut self, bytes: &[u8]) -> usize {
        let n = bytes.len().min(ROOM_BYTES - self.n);
        self.bytes[self.n..self.n + n].copy_from_slice(&bytes[..n]);
        self.n += n;
        n
    }

    /// The next frame, or why bytes were left out; none when more bytes are needed.
    pub(crate) fn next_frame(&mut self) -> Option<Result<Frame, FrameError>> {
        let start = self.begin();
        if start > 0 {
            self.drop_front(start);
            return Some(Err(FrameError::Noise { n_bytes: start }));
        }
        if self.n < HEADER_BYTES {
            return None;
        }
        let [_, _, version, kind, trocar, length, low, high] = std::array::from_fn(|i| self.bytes[i]);
        // What cannot be a header is left out at once, so that a wrong length never makes us wait for more bytes.
        let refused = if version != VERSION {
            Some(FrameError::Version { found: version })
        } else if usize::from(length) > MOST_PAYLOAD_BYTES {
            Some(FrameError::Length { found: length })
        } else {
            None
        };
        if let Some(error) = refused {
            self.drop_front(1);
            return Some(Err(error));
        }
        let end = HEADER_BYTES + usize::from(length);
        if self.n < end + CHECK_BYTES {
            return None;
        }
        let found = u16::from_le_bytes([self.bytes[end], self.bytes[end + 1]]);
        let wanted = check_of(&self.bytes[SYNC.len()..end]);
        if found != wanted {
            // A whole frame may begin within what looked like this one.
            self.drop_front(1);
            return Some(Err(FrameError::Check { found, wanted }));
        }
        let message = if trocar < MOST_TROCARS {
            Message::parse(kind, &self.bytes[HEADER_BYTES..end])
        } else {
            Err(FrameError::Trocar { found: trocar })
        };
        self.drop_front(end + CHECK_BYTES);
        let sequence = u16::from_le_bytes([low, high]);
        Some(message.map(|message| Frame { trocar, sequence, message }))
    }

    /// Bytes before the first place where a frame begins or may begin.
    fn begin(&self) -> usize {
        let held = &self.bytes[..self.n];
        let whole = held.windows(2).position(|pair| pair == SYNC);
        whole.unwrap_or(if held.last() == Some(&SYNC[0]) { self.n - 1 } else { self.n })
    }

    fn drop_front(&mut self, n: usize) {
        self.bytes.copy_within(n..self.n, 0);
        self.n -= n;
    }
}

#[cfg(test)]
#[path = "frame_tests.rs"]
mod tests;
