//! The pixels of a copy: coded as in the original, with nothing beside them.
//!
//! What can stand beside pixels that are not compressed: bits of a word that the pixel does not use (overlays of old
//! files lie there) and bytes behind the last pixel. They become zeros; the pixels' own values and the lengths stay.
//! Compressed streams are looked at in [`bare_streams`](super::bare_streams); the unused bits of their words are not.

use std::path::Path;

use dicom_core::value::{PixelFragmentSequence, Value};
use dicom_core::{DataElement, PrimitiveValue, VR};
use dicom_dictionary_std::tags;
use dicom_object::DefaultDicomObject;
use dicom_object::mem::InMemElement;

use super::super::super::error::ImageError;
use super::super::frames::{integer, wrong};
use super::super::pixels::{Coding, PixelKind, has_turned_halves, syntax_of};
use super::bare_streams::clear_fragments;
use super::kept::refuse;

/// Most bytes of pixels that are not compressed: what the length of an element can say.
const MAX_BYTES: u64 = u32::MAX as u64 - 1;

/// The element with the pixels of a file of a coding, and how many of its pixels had something in bits that are not used.
///
/// # Errors
/// No pixels, fewer than the header promises, or data that are not of the coding.
pub(super) fn of(
    file: &Path,
    object: &DefaultDicomObject,
    coding: Coding,
) -> Result<(InMemElement, usize), ImageError> {
    let refuse = |found: &str, allowed: &str| refuse(file, tags::PIXEL_DATA, found, allowed);
    let missing = || refuse("missing", "the pixels of the image");
    let element = object.get(tags::PIXEL_DATA).ok_or_else(missing)?;
    let (value, n_changed) = match (element.value(), coding) {
        (Value::Primitive(words), Coding::Plain) => {
            let (words, n_changed) = bare_words(file, object, words, element.vr())?;
            (Value::Primitive(words), n_changed)
        }
        (Value::PixelSequence(sequence), Coding::Rle | Coding::Jpeg | Coding::JpegLs | Coding::Jpeg2000) => {
            let mut fragments = sequence.fragments().to_vec();
            clear_fragments(&mut fragments, coding, n_pixels_of(object)).map_err(|found| {
                refuse(
                    found,
                    "a stream as its transfer syntax says: what stands beside others is not known; write the file without \
                     compression (e.g. with gdcmconv --raw)",
                )
            })?;
            let offsets = sequence.offset_table().to_vec();
            (Value::PixelSequence(PixelFragmentSequence::new(offsets, fragments)), 0)
        }
        (Value::PixelSequence(_), Coding::Plain) => {
            return Err(refuse("in fragments", "words, as the transfer syntax says"));
        }
        (Value::Primitive(_), _) => {
            return Err(refuse("not in fragments", "a compressed stream, as the transfer syntax says"));
        }
        (Value::Sequence(_), _) => return Err(missing()),
    };
    Ok((DataElement::new(tags::PIXEL_DATA, element.vr(), value), n_changed))
}

/// Pixels of a frame; none where its size is not said.
fn n_pixels_of(object: &DefaultDicomObject) -> usize {
    let size = |tag| integer(object, tag).map_or(0, |n| n.clamp(0, 65_535) as usize);
    size(tags::COLUMNS) * size(tags::ROWS)
}

/// Words without what is in their unused bits and behind the last of them, and in how many pixels something was there.
fn bare_words(
    file: &Path,
    object: &DefaultDicomObject,
    words: &PrimitiveValue,
    vr: VR,
) -> Result<(PrimitiveValue, usize), ImageError> {
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
    let n_word_bytes = match words {
        PrimitiveValue::U8(_) => 1,
        PrimitiveValue::U16(_) => 2,
        PrimitiveValue::U32(_) => 4,
        _ => return Err(refuse(file, tags::PIXEL_DATA, "of another kind", "words of pixels (OB, OW or OL)")),
    };
    // What is longer than the pixels and whole words is cut, and what then stands behind the pixels cleared.
    let n_used = expected as usize;
    let mut bytes = words.to_bytes().into_owned();
    bytes.resize(n_used.next_multiple_of(n_word_bytes.max(2)), 0);
    bytes[n_used..].fill(0);
    let is_turned = has_turned_halves(syntax_of(object), kind, vr);
    let rotate = |pixels: &mut [u8]| {
        if is_turned {
            pixels.chunks_exact_mut(4).for_each(|number| number.rotate_left(2));
        }
    };
    let pixels = &mut bytes[..n_used];
    rotate(pixels);
    let n_changed = clear_unused_bits(pixels, kind, n_bits);
    rotate(pixels);
    let bare = match n_word_bytes {
        1 => PrimitiveValue::U8(bytes.into()),
        2 => {
            let words = bytes.chunks_exact(2).map(|pair| u16::from_ne_bytes([pair[0], pair[1]]));
            PrimitiveValue::U16(words.collect())
        }
        _ => {
            let words =
                bytes.chunks_exact(4).map(|four| u32::from_ne_bytes([four[0], four[1], four[2], four[3]]));
            PrimitiveValue::U32(words.collect())
        }
    };
    Ok((bare, n_changed))
}

/// Clears the bits that pixels do not use; says in how many of them something was there that is no sign.
fn clear_unused_bits(pixels: &mut [u8], kind: PixelKind, n_bits: u64) -> usize {
    let mut n_changed = 0;
    let mut bare = |word: u32, mask: u32| {
        let bare = kind.bare(word) & mask;
        n_changed += usize::from(bare != word);
        bare
    };
    match kind.n_bits_allocated {
        // The bits behind the last pixel are nobody's.
        1 => {
            if let Some(last) = pixels.last_mut().filter(|_| !n_bits.is_multiple_of(8)) {
                *last &= (1 << (n_bits % 8)) - 1;
            }
        }
        8 => pixels.iter_mut().for_each(|byte| *byte = bare(u32::from(*byte), 0xff) as u8),
        16 => {
            for pair in pixels.chunks_exact_mut(2) {
                let word = bare(u32::from(u16::from_ne_bytes([pair[0], pair[1]])), 0xffff);
                pair.copy_from_slice(&(word as u16).to_ne_bytes());
            }
        }
        _ => {
            for four in pixels.chunks_exact_mut(4) {
                let word = bare(u32::from_ne_bytes([four[0], four[1], four[2], four[3]]), u32::MAX);
                four.copy_from_slice(&word.to_ne_bytes());
            }
        }
    }
    n_changed
}
