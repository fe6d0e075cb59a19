//! Frames of OpenIGTLink: a header of 58 bytes (version, type, device, time, size and CRC-64 of the body), then the
//! body; all numbers big endian. Source: the protocol's documents `header.md` and `timestamp.md` in the repository
//! openigtlink/OpenIGTLink.

use crate::crc64::crc64;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Bytes of a header.
pub(crate) const HEADER_BYTES: usize = 58;
/// Largest body that is taken from a client: requests are short, and nothing else is used.
pub(crate) const MOST_BODY_BYTES: usize = 1 << 16;
/// Header versions that are understood: 1, and 2 whose bodies may begin with an extended header.
const VERSIONS: std::ops::RangeInclusive<u16> = 1..=2;
/// The version that is written: everybody reads it.
const WRITTEN_VERSION: u16 = 1;

/// Why a client's bytes are not OpenIGTLink.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(crate) enum FrameError {
    #[error("header version {0}: must be 1 or 2; is this an OpenIGTLink client?")]
    Version(u16),
    #[error("the {0} name in the header is not printable ASCII filled up with zeros")]
    Name(&'static str),
    #[error("a {kind} body of {n_bytes} bytes: at most {MOST_BODY_BYTES} are taken")]
    Size { kind: String, n_bytes: u64 },
    #[error("the CRC of a {kind} body is {found:016x}, its header says {said:016x}")]
    Crc { kind: String, found: u64, said: u64 },
}

/// A message from a client.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Frame {
    /// `GET_TRANS`, ...
    pub(crate) kind: String,
    pub(crate) device: String,
    /// Without the extended header and metadata of version 2.
    pub(crate) body: Vec<u8>,
}

/// Seconds since 1970 as OpenIGTLink counts them: 32 bits of seconds, 32 of their fraction.
pub(crate) fn timestamp(time: SystemTime) -> u64 {
    let since_1970 = time.duration_since(UNIX_EPOCH).unwrap_or_default();
    (since_1970.as_secs() << 32) | ((u64::from(since_1970.subsec_nanos()) << 32) / 1_000_000_000)
}

/// A span in the same format.
pub(crate) fn span(timestamp: u64) -> Duration {
    Duration::from_secs(timestamp >> 32)
        + Duration::from_nanos(((timestamp & 0xFFFF_FFFF) * 1_000_000_000) >> 32)
}

fn padded<const N: usize>(name: &str) -> [u8; N] {
    let mut field = [0; N];
    // A name that fills its field has no zero at its end; longer ones are cut.
    for (byte, character) in field.iter_mut().zip(name.chars()) {
        *byte = if character.is_ascii_graphic() { character as u8 } else { b'_' };
    }
    field
}

fn name(field: &[u8], which: &'static str) -> Result<String, FrameError> {
    let end = field.iter().position(|&byte| byte == 0).unwrap_or(field.len());
    let is_printable = field[..end].iter().all(|&byte| byte == b' ' || byte.is_ascii_graphic());
    match std::str::from_utf8(&field[..end]) {
        Ok(text) if is_printable => Ok(text.to_owned()),
        _ => Err(FrameError::Name(which)),
    }
}

/// A whole message: header and `body`. Types have at most 12 bytes, device names 20; longer ones are cut.
pub(crate) fn message(kind: &str, device: &str, timestamp: u64, body: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(HEADER_BYTES + body.len());
    bytes.extend(WRITTEN_VERSION.to_be_bytes());
    bytes.extend(padded::<12>(kind));
    bytes.extend(padded::<20>(device));
    bytes.extend(timestamp.to_be_bytes());
    bytes.extend((body.len() as u64).to_be_bytes());
    bytes.extend(crc64(body).to_be_bytes());
    bytes.extend(body);
    bytes
}

struct Header {
    version: u16,
    kind: String,
    device: String,
    n_body_bytes: usize,
    crc: u64,
}

fn number<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    bytes[at..at + N].try_into().expect("the caller gives a whole header")
}

/// `bytes` has [`HEADER_BYTES`] or more.
fn header(bytes: &[u8]) -> Result<Header, FrameError> {
    let version = u16::from_be_bytes(number(bytes, 0));
    if !VERSIONS.contains(&version) {
        return Err(FrameError::Version(version));
    }
    let kind = name(&bytes[2..14], "type")?;
    let device = name(&bytes[14..34], "device")?;
    let n_bytes = u64::from_be_bytes(number(bytes, 42));
    if n_bytes > MOST_BODY_BYTES as u64 {
        return Err(FrameError::Size { kind, n_bytes });
    }
    let crc = u64::from_be_bytes(number(bytes, 50));
    Ok(Header { version, kind, device, n_body_bytes: n_bytes as usize, crc })
}

/// What is left of a version 2 body without its extended header (its size, the sizes of the metadata, an id) and
/// without the metadata at the end. A client that says version 2 and sends a body without them is taken at its word
/// only where the sizes fit.
fn content(version: u16, body: &[u8]) -> &[u8] {
    const EXTENDED_HEADER_BYTES: usize = 12;
    if version < 2 || body.len() < EXTENDED_HEADER_BYTES {
        return body;
    }
    let n_extended = usize::from(u16::from_be_bytes(number(body, 0)));
    let n_index = usize::from(u16::from_be_bytes(number(body, 2)));
    let n_metadata = u32::from_be_bytes(number(body, 4)) as usize;
    let n_end = n_index.saturating_add(n_metadata);
    let fits = n_extended >= EXTENDED_HEADER_BYTES && n_extended.saturating_add(n_end) <= body.len();
    if fits { &body[n_extended..body.len() - n_end] } else { body }
}

/// Makes frames of bytes that come in pieces.
#[derive(Debug, Default)]
pub(crate) struct FrameReader {
    waiting: Vec<u8>,
}

impl FrameReader {
    /// Takes bytes; what is waiting stays below a header and the largest body when [`FrameReader::next`] is called
    /// until it has no more.
    pub(crate) fn push(&mut self, bytes: &[u8]) {
        self.waiting.extend_from_slice(bytes);
    }

    /// The next whole frame, if it is there.
    ///
    /// # Errors
    /// [`FrameError`]: what follows cannot be trusted, and the connection should end.
    pub(crate) fn next(&mut self) -> Result<Option<Frame>, FrameError> {
        if self.waiting.len() < HEADER_BYTES {
            return Ok(None);
        }
        let Header { version, kind, device, n_body_bytes, crc: said } = header(&self.waiting)?;
        let end = HEADER_BYTES + n_body_bytes;
        if self.waiting.len() < end {
            return Ok(None);
        }
        let body = &self.waiting[HEADER_BYTES..end];
        let found = crc64(body);
        // Some clients leave the CRC of an empty body as it was.
        if found != said && !body.is_empty() {
            return Err(FrameError::Crc { kind, found, said });
        }
        let frame = Frame { kind, device, body: content(version, body).to_vec() };
        self.waiting.drain(..end);
        Ok(Some(frame))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_has_the_documented_layout() {
        let time = UNIX_EPOCH + Duration::from_millis(2_500);
        let bytes = message("GET_TRANS", "tool", timestamp(time), b"xy");
        assert_eq!(bytes.len(), HEADER_BYTES + 2);
        assert_eq!(&bytes[..2], [0, 1]);
        assert_eq!(&bytes[2..14], b"GET_TRANS\0\0\0");
        assert_eq!(&bytes[14..34], b"tool\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0");
        assert_eq!(&bytes[34..42], [0, 0, 0, 2, 0x80, 0, 0, 0]);
        assert_eq!(&bytes[42..50], [0, 0, 0, 0, 0, 0, 0, 2]);
        assert_eq!(&bytes[50..58], crc64(b"xy").to_be_bytes());
        assert_eq!(span(timestamp(time)), Duration::from_millis(2_500));
        let long = message("LONGER_THAN_TWELVE", "a name of more than twenty bytes", 0, b"");
        assert_eq!(&long[2..14], b"LONGER_THAN_");
        assert_eq!(&long[14..34], b"a_name_of_more_than_");
    }

    #[test]
    fn frames_come_out_whole_however_they_are_cut() {
        let frames =
            [message("GET_STATUS", "", 0, b""), message("STT_POLYDATA", "organ", 0, &[1; 8])].concat();
        for piece in [1, 7, 58, 59, 200] {
            let mut reader = FrameReader::default();
            let mut found = Vec::new();
            for bytes in frames.chunks(piece) {
                reader.push(bytes);
                while let Some(frame) = reader.next().unwrap() {
                    found.push(frame);
                }
            }
            let kinds: Vec<_> = found.iter().map(|f| (f.kind.as_str(), f.body.len())).collect();
            assert_eq!(kinds, [("GET_STATUS", 0), ("STT_POLYDATA", 8)], "pieces of {piece}");
        }
    }

    #[test]
    fn what_is_no_frame_is_told() {
        let error = |bytes: &[u8]| {
            let mut reader = FrameReader::default();
            reader.push(bytes);
            reader.next().unwrap_err().to_string()
        };
        assert!(error(&[b'G'; 80]).contains("version 18247"), "{}", error(&[b'G'; 80]));
        let good = message("TRANSFORM", "tool", 0, &[3; 48]);
        let with = |at: usize, byte: u8| {
            let mut bytes = good.clone();
            bytes[at] = byte;
            bytes
        };
        assert!(error(&with(3, 7)).contains("type name"));
        assert!(error(&with(15, 0xFF)).contains("device name"));
        assert!(error(&with(44, 1)).contains("at most"));
        assert!(error(&with(60, 4)).contains("CRC"));
    }

    #[test]
    fn metadata_of_version_2_is_left_out() {
        // Extended header of 12 bytes, content of 4, an index of 2 bytes and 3 bytes of metadata.
        let body = [&[0, 12, 0, 2, 0, 0, 0, 3, 0, 0, 0, 9][..], b"good", &[0, 0], b"abc"].concat();
        let mut bytes = message("STRING", "a", 0, &body);
        bytes[1] = 2;
        let mut reader = FrameReader::default();
        reader.push(&bytes);
        assert_eq!(reader.next().unwrap().unwrap().body, b"good");
        // Sizes that do not fit.
        for length in [5, 245] {
            let mut wrong = body.clone();
            wrong[7] = length + 10;
            let mut bytes = message("STRING", "a", 0, &wrong);
            bytes[1] = 2;
            reader.push(&bytes);
            assert_eq!(reader.next().unwrap().unwrap().body, wrong);
        }
    }
}
