//! The lengths that the elements of a file claim, checked against its size before anything is read for them: the
//! library takes memory for what an element says, which in a damaged file may be gigabytes.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;

use dicom_dictionary_std::uids;

use super::super::error::ImageError;
use crate::binary::ByteOrder;

/// Explicit VR, big endian: retired, but on discs.
pub(super) const EXPLICIT_VR_BIG_ENDIAN: &str = "1.2.840.10008.1.2.2";
/// The length of what ends by a delimiter.
const UNDEFINED: u32 = u32::MAX;
/// Bytes before the first element: the preamble and `DICM`.
const N_PREAMBLE_BYTES: u64 = 132;
/// Explicit value representations whose length has two bytes (DICOM PS3.5, 7.1.2). All others, also those that nobody
/// knows, have one of four bytes behind two unused ones; so the library reads them.
const SHORT: [&[u8; 2]; 21] = [
    b"AE", b"AS", b"AT", b"CS", b"DA", b"DS", b"DT", b"FD", b"FL", b"IS", b"LO", b"LT", b"PN", b"SH", b"SL",
    b"SS", b"ST", b"TM", b"UI", b"UL", b"US",
];

/// The tag of an item, little-endian.
const ITEM: [u8; 4] = [0xfe, 0xff, 0x00, 0xe0];

/// How elements are written (DICOM PS3.5, 7.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Encoding {
    is_explicit: bool,
    order: ByteOrder,
}

/// A walk along the headers of elements.
struct Walk {
    reader: BufReader<File>,
    at: u64,
    n_bytes: u64,
}

impl Walk {
    fn take<const N: usize>(&mut self) -> io::Result<[u8; N]> {
        let mut bytes = [0; N];
        self.reader.read_exact(&mut bytes)?;
        self.at += N as u64;
        Ok(bytes)
    }

    fn skip(&mut self, n: u64) -> io::Result<()> {
        self.reader.seek_relative(n as i64)?;
        self.at += n;
        Ok(())
    }
}

fn u16_of(bytes: [u8; 2], order: ByteOrder) -> u16 {
    if order == ByteOrder::Big { u16::from_be_bytes(bytes) } else { u16::from_le_bytes(bytes) }
}

fn u32_of(bytes: [u8; 4], order: ByteOrder) -> u32 {
    if order == ByteOrder::Big { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) }
}

/// Refuses a file in which an element claims more bytes than are left. What is not understood here is left to the
/// library.
///
/// # Errors
/// The element, its place, and the two numbers of bytes; a refusal of the file system.
pub(super) fn check_lengths(file: &Path) -> Result<(), ImageError> {
    match claims_too_much(file) {
        Ok(None) => Ok(()),
        Ok(Some(claim)) => Err(ImageError::Series {
            folder: file.to_path_buf(),
            reason: format!("{claim}; the file is cut or damaged, copy it again"),
        }),
        // The file ends within a header.
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Ok(()),
        Err(source) => Err(ImageError::Io { file: file.to_path_buf(), source }),
    }
}

/// The first element that claims too much, as text.
fn claims_too_much(file: &Path) -> io::Result<Option<String>> {
    let open = File::open(file)?;
    let n_bytes = open.metadata()?.len();
    let mut walk = Walk { reader: BufReader::new(open), at: 0, n_bytes };
    if walk.n_bytes < N_PREAMBLE_BYTES {
        return Ok(None);
    }
    walk.skip(N_PREAMBLE_BYTES)?;
    // The file's own header is explicit and little-endian, whatever follows.
    let mut encoding = Encoding { is_explicit: true, order: ByteOrder::Little };
    let mut following = Some(encoding);
    let (mut is_in_header, mut is_in_pixels) = (true, false);
    // Sequences of undefined length inside one of unknown kind, that one included, and how what is around it is written.
    let (mut inside_unknown, mut around_unknown) = (0u32, encoding);
    while walk.at < walk.n_bytes {
        let start = walk.at;
        let raw: [u8; 4] = walk.take()?;
        if is_in_header && raw[..2] != [2, 0] {
            is_in_header = false;
            let Some(next) = following else { return Ok(None) };
            encoding = next;
        }
        let half = |at: usize| u16_of([raw[at], raw[at + 1]], encoding.order);
        let tag = (half(0), half(2));
        let is_item = tag.0 == 0xfffe;
        let mut kind = *b"  ";
        let length = if is_item || !encoding.is_explicit {
            u32_of(walk.take()?, encoding.order)
        } else {
            kind = walk.take()?;
            if SHORT.contains(&&kind) {
                u32::from(u16_of(walk.take()?, encoding.order))
            } else {
                walk.skip(2)?;
                u32_of(walk.take()?, encoding.order)
            }
        };
        if length == UNDEFINED {
            is_in_pixels |= tag == (0x7fe0, 0x0010);
            // Inside a sequence of unknown kind all is implicit and little-endian (PS3.5, 6.2.2).
            if inside_unknown > 0 && !is_item {
                inside_unknown += 1;
            } else if &kind == b"UN" {
                inside_unknown = 1;
                around_unknown = encoding;
                encoding = Encoding { is_explicit: false, order: ByteOrder::Little };
            }
            continue;
        }
        let n_left = walk.n_bytes - walk.at;
        if u64::from(length) > n_left {
            let (group, element) = tag;
            return Ok(Some(format!(
                "element ({group:04X},{element:04X}) at byte {start} claims {length} bytes, {n_left} are left"
            )));
        }
        if tag == (0xfffe, 0xe0dd) {
            is_in_pixels = false;
            if inside_unknown == 1 {
                encoding = around_unknown;
            }
            inside_unknown = inside_unknown.saturating_sub(1);
        }
        // Sequences and their items are walked through, other values passed over. Implicit elements do not say whether
        // they are sequences: those that begin with an item are.
        let begins_with_item = !encoding.is_explicit && walk.reader.fill_buf()?.starts_with(&ITEM);
        let is_entered = &kind == b"SQ" || begins_with_item || (is_item && !is_in_pixels);
        if tag == (0x0002, 0x0010) && length <= 64 {
            let mut uid = vec![0; length as usize];
            walk.reader.read_exact(&mut uid)?;
            walk.at += u64::from(length);
            following = encoding_of(String::from_utf8_lossy(&uid).trim_end_matches(['\0', ' ']));
        } else if !is_entered {
            walk.skip(u64::from(length))?;
        }
    }
    Ok(None)
}

/// How elements are written in a transfer syntax; none where they are compressed.
fn encoding_of(uid: &str) -> Option<Encoding> {
    match uid {
        uids::DEFLATED_EXPLICIT_VR_LITTLE_ENDIAN => None,
        uids::IMPLICIT_VR_LITTLE_ENDIAN => Some(Encoding { is_explicit: false, order: ByteOrder::Little }),
        EXPLICIT_VR_BIG_ENDIAN => Some(Encoding { is_explicit: true, order: ByteOrder::Big }),
        _ => Some(Encoding { is_explicit: true, order: ByteOrder::Little }),
    }
}
