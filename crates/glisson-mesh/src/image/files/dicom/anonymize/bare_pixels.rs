//! The pixels of a copy: coded as in the original, with nothing beside them.
//!
//! What can stand beside pixels: bits of a word that the pixel does not use (overlays of old files lie there), bytes
//! behind the last pixel, and in compressed streams the comments of the program that made them (JPEG's `COM` and `APPn`,
//! JPEG 2000's `COM`) and bytes behind the end. All of them become zeros; the pixels' own values and the lengths stay.
//! Bits that are not used are not looked for in compressed words.
//!
//! Source of the markers: ISO/IEC 10918-1, B.1; ISO/IEC 14495-1, C.1; ISO/IEC 15444-1, A.2 to A.4.

use std::path::Path;

use dicom_core::value::{PixelFragmentSequence, Value};
use dicom_core::{DataElement, PrimitiveValue};
use dicom_dictionary_std::tags;
use dicom_object::DefaultDicomObject;
use dicom_object::mem::InMemElement;

use super::super::super::error::ImageError;
use super::super::frames::{integer, wrong};
use super::super::pixels::PixelKind;

/// The beginning of a JPEG or JPEG-LS stream, and of a JPEG 2000 codestream.
const JPEG: [u8; 2] = [0xff, 0xd8];
const JPEG_2000: [u8; 4] = [0xff, 0x4f, 0xff, 0x51];
/// Most bytes of pixels that are not compressed: what the length of an element can say.
const MAX_BYTES: u64 = u32::MAX as u64 - 1;

/// The element with the pixels of a file.
///
/// # Errors
/// No pixels, or fewer than the header promises.
pub(super) fn of(file: &Path, object: &DefaultDicomObject) -> Result<InMemElement, ImageError> {
    let missing = || wrong(file, object, tags::PIXEL_DATA, "PixelData", "the pixels of the image");
    let element = object.get(tags::PIXEL_DATA).ok_or_else(missing)?;
    let value = match element.value() {
        Value::Primitive(words) => Value::Primitive(bare_words(file, object, words)?),
        Value::PixelSequence(sequence) => {
            let mut fragments = sequence.fragments().to_vec();
            // A stream may go on through several fragments.
            let begins = |fragment: &Vec<u8>| fragment.starts_with(&JPEG) || fragment.starts_with(&JPEG_2000);
            for stream in fragments.chunk_by_mut(|_, next| !begins(next)) {
                let mut whole = stream.concat();
                clear_beside(&mut whole);
                let mut rest = whole.as_slice();
                for fragment in stream {
                    let (own, others) = rest.split_at(fragment.len());
                    fragment.copy_from_slice(own);
                    rest = others;
                }
            }
            let offsets = sequence.offset_table().to_vec();
            Value::PixelSequence(PixelFragmentSequence::new(offsets, fragments))
        }
        Value::Sequence(_) => return Err(missing()),
    };
    Ok(DataElement::new(tags::PIXEL_DATA, element.vr(), value))
}

/// Words without what is in their unused bits and behind the last of them.
fn bare_words(
    file: &Path,
    object: &DefaultDicomObject,
    words: &PrimitiveValue,
) -> Result<PrimitiveValue, ImageError> {
    let kind = PixelKind::of(file, object)?;
    let number = |tag, name, most: u64| match object.get(tag) {
        None => Ok(1),
        Some(_) => {
            let found = integer(object, tag).and_then(|n| u64::try_from(n).ok());
            let found = found.filter(|n| (1..=most).contains(n));
            found.ok_or_else(|| wrong(file, object, tag, name, format!("1 to {most}")))
        }
    };
    let dims = [number(tags::COLUMNS, "Columns", 65_535)?, number(tags::ROWS, "Rows", 65_535)?];
    let n_samples = number(tags::SAMPLES_PER_PIXEL, "SamplesPerPixel", 4)?;
    let n_frames = number(tags::NUMBER_OF_FRAMES, "NumberOfFrames", 100_000)?;
    let is_subsampled = object
        .get(tags::PHOTOMETRIC_INTERPRETATION)
        .and_then(|element| element.to_str().ok())
        .is_some_and(|name| name.contains("_42"));
    if is_subsampled {
        let allowed = "colours of every pixel, where pixels are not compressed";
        let (tag, name) = (tags::PHOTOMETRIC_INTERPRETATION, "PhotometricInterpretation");
        return Err(wrong(file, object, tag, name, allowed));
    }
    // 16 + 16 + 2 + 17 + 6 bits.
    let n_bits = dims[0] * dims[1] * n_samples * n_frames * u64::from(kind.n_bits_allocated);
    let expected = n_bits.div_ceil(8);
    let found = words.calculate_byte_len() as u64;
    if expected > found || expected > MAX_BYTES {
        return Err(ImageError::SizeMismatch {
            file: file.to_path_buf(),
            expected,
            found,
            dims: [dims[0], dims[1], n_frames].map(|n| n as usize),
            n_bytes_a_voxel: (n_samples as usize * kind.n_bits_allocated as usize).div_ceil(8),
            data_start: 0,
        });
    }
    let n_bytes = expected.next_multiple_of(2) as usize;
    let n_used = expected as usize;
    Ok(match words {
        PrimitiveValue::U8(bytes) => {
            let mut bytes = bytes[..n_bytes.min(bytes.len())].to_vec();
            bytes[n_used..].fill(0);
            match kind.n_bits_allocated {
                8 => bytes[..n_used].iter_mut().for_each(|byte| *byte = kind.bare(u32::from(*byte)) as u8),
                16 => {
                    for pair in bytes[..n_used].chunks_exact_mut(2) {
                        let word = kind.bare(u32::from(u16::from_ne_bytes([pair[0], pair[1]])));
                        pair.copy_from_slice(&(word as u16).to_ne_bytes());
                    }
                }
                1 if !n_bits.is_multiple_of(8) => bytes[n_used - 1] &= (1 << (n_bits % 8)) - 1,
                _ => {}
            }
            PrimitiveValue::U8(bytes.into())
        }
        PrimitiveValue::U16(words) => {
            let mut words = words[..(n_bytes / 2).min(words.len())].to_vec();
            match kind.n_bits_allocated {
                16 => words.iter_mut().for_each(|word| *word = kind.bare(u32::from(*word)) as u16),
                // Two pixels a word, or sixteen; the second half of the last word may be nobody's.
                8 if !n_used.is_multiple_of(2) => words[n_bytes / 2 - 1] &= 0xff,
                _ => {}
            }
            PrimitiveValue::U16(words.into())
        }
        PrimitiveValue::U32(words) => {
            PrimitiveValue::U32(words[..(n_used / 4).min(words.len())].to_vec().into())
        }
        _ => {
            return Err(wrong(file, object, tags::PIXEL_DATA, "PixelData", "words of pixels (OB, OW or OL)"));
        }
    })
}

/// Fills what is beside the image in a compressed stream with zeros; streams of other codings stay as they are.
fn clear_beside(stream: &mut [u8]) {
    if stream.starts_with(&JPEG_2000) {
        clear_beside_jpeg_2000(stream);
    } else if stream.starts_with(&JPEG) {
        clear_beside_jpeg(stream);
    }
}

/// The big-endian number of two bytes at a place.
fn half(stream: &[u8], at: usize) -> Option<usize> {
    let bytes = stream.get(at..at + 2)?;
    Some(usize::from(u16::from_be_bytes([bytes[0], bytes[1]])))
}

fn clear(stream: &mut [u8], from: usize, to: usize) {
    let to = to.min(stream.len());
    if let Some(part) = stream.get_mut(from..to) {
        part.fill(0);
    }
}

fn clear_beside_jpeg(stream: &mut [u8]) {
    let mut at = JPEG.len();
    // From marker to marker. Behind 0xff in coded data stand less than 0x80 (stuffing) or restart markers.
    while at + 1 < stream.len() {
        let marker = stream[at + 1];
        if stream[at] != 0xff || marker < 0x80 || marker == 0xff || (0xd0..=0xd7).contains(&marker) {
            at += 1;
            continue;
        }
        if marker == 0xd9 {
            let end = stream.len();
            return clear(stream, at + 2, end);
        }
        let Some(length) = half(stream, at + 2) else { return };
        let (start, end) = (at + 4, at + 2 + length.max(2));
        let payload = &stream[start.min(stream.len())..end.min(stream.len()).max(start.min(stream.len()))];
        // What decoders need of what programs say: the kind of colours, without what may stand behind it.
        let n_kept = match marker {
            0xe0 if payload.starts_with(b"JFIF\0") => Some(14),
            0xe8 if payload.starts_with(b"mrfx") => Some(5),
            0xee if payload.starts_with(b"Adobe") => Some(12),
            0xe0..=0xef | 0xfe => Some(0),
            _ => None,
        };
        if let Some(n_kept) = n_kept {
            clear(stream, start + n_kept, end);
        }
        at = end;
    }
}

fn clear_beside_jpeg_2000(stream: &mut [u8]) {
    let (mut at, mut end_of_tile) = (2, None);
    while at + 1 < stream.len() {
        match half(stream, at) {
            // End of the codestream.
            Some(0xffd9) => {
                let end = stream.len();
                return clear(stream, at + 2, end);
            }
            // Start of data: to the end of its part of a tile.
            Some(0xff93) => match end_of_tile.take() {
                Some(end) if end > at => at = end,
                _ => return,
            },
            Some(marker) => {
                let Some(length) = half(stream, at + 2) else { return };
                if marker == 0xff90 {
                    let length = [half(stream, at + 6), half(stream, at + 8)];
                    end_of_tile = match length {
                        [Some(high), Some(low)] if high + low > 0 => Some(at + (high << 16 | low)),
                        _ => None,
                    };
                }
                if marker == 0xff64 {
                    // Behind the number that says whether it is text.
                    clear(stream, at + 6, at + 2 + length);
                }
                at += 2 + length.max(2);
            }
            None => return,
        }
    }
}
