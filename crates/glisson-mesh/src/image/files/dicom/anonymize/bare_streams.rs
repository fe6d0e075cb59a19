//! Compressed pixels without what stands beside them.
//!
//! JPEG and JPEG-LS: the comments of the program that made a stream (`COM`, `APPn`), segments that the standards reserve,
//! and bytes behind the end. JPEG 2000: `COM`, segments that are not the standard's, and bytes behind the end. All of
//! them become zeros. RLE: bytes behind the last pixel of a segment become 0x80, which codes nothing. Lengths stay.
//!
//! A stream that does not begin, go on and end as its coding says is refused: containers (JP2) have boxes for texts, and
//! what stands in what cannot be understood nobody knows.
//!
//! Source of the markers: ISO/IEC 10918-1, B.1; ISO/IEC 14495-1, C.1; ISO/IEC 15444-1, A.2 to A.4; of RLE: DICOM PS3.5
//! 2024, annex G.

use super::super::pixels::Coding;

/// The beginning of a JPEG or JPEG-LS stream, and of a JPEG 2000 codestream.
const JPEG: &[u8] = &[0xff, 0xd8];
const JPEG_2000: &[u8] = &[0xff, 0x4f, 0xff, 0x51];
/// Bytes of the header of an RLE frame: the number of segments and fifteen places.
const RLE_HEADER: usize = 64;
/// The code of RLE that stands for nothing.
const RLE_NOTHING: u8 = 0x80;

/// Why a stream is refused, without what was found in it.
type Refusal = &'static str;

const DAMAGED: Refusal = "damaged, or goes on behind its end";

/// Clears what is beside the image in the fragments of a coding.
///
/// # Errors
/// Fragments that are not of the coding.
pub(super) fn clear_fragments(
    fragments: &mut [Vec<u8>],
    coding: Coding,
    n_pixels: usize,
) -> Result<(), Refusal> {
    type Clear = fn(&mut [u8]) -> Option<usize>;
    let (magic, clear): (&[u8], Clear) = match coding {
        Coding::Plain => return Err("in fragments"),
        Coding::Rle => {
            let all = fragments.iter_mut().try_for_each(|fragment| clear_rle(fragment, n_pixels));
            return all.ok_or(DAMAGED);
        }
        Coding::Jpeg | Coding::JpegLs => (JPEG, clear_jpeg),
        Coding::Jpeg2000 => (JPEG_2000, clear_jpeg_2000),
    };
    // A stream may go on through several fragments.
    for stream in fragments.chunk_by_mut(|_, next| !next.starts_with(magic)) {
        let mut whole = stream.concat();
        if !whole.starts_with(magic) {
            return Err("a stream that does not begin as its transfer syntax says (a container?)");
        }
        let end = clear(&mut whole).ok_or(DAMAGED)?;
        let mut at = 0;
        for fragment in stream {
            // A whole fragment behind the end may be another frame.
            if at >= end && fragment.iter().any(|&byte| byte != 0) {
                return Err(DAMAGED);
            }
            let n = fragment.len();
            fragment.copy_from_slice(&whole[at..at + n]);
            at += n;
        }
    }
    Ok(())
}

/// The big-endian number of two bytes at a place.
fn half(stream: &[u8], at: usize) -> Option<usize> {
    let bytes = stream.get(at..at.checked_add(2)?)?;
    Some(usize::from(u16::from_be_bytes([bytes[0], bytes[1]])))
}

/// Clears a JPEG or JPEG-LS stream; its end, or none where it is damaged.
fn clear_jpeg(stream: &mut [u8]) -> Option<usize> {
    let mut at = JPEG.len();
    let mut is_in_scan = false;
    loop {
        let (first, marker) = (*stream.get(at)?, *stream.get(at + 1)?);
        // Behind 0xff in coded data stand less than 0x80 (stuffing) or restart markers.
        let is_coded = first != 0xff || marker < 0x80 || (0xd0..=0xd7).contains(&marker);
        if is_in_scan && is_coded || first == 0xff && marker == 0xff {
            at += 1;
            continue;
        }
        if is_coded {
            return None;
        }
        if marker == 0xd9 {
            stream[at + 2..].fill(0);
            return Some(at + 2);
        }
        let (start, end) = (at + 4, at + 2 + half(stream, at + 2).filter(|&length| length >= 2)?);
        let payload = stream.get_mut(start..end)?;
        // What decoders need of what programs say: the kind of colours, without what may stand behind it.
        let n_kept = match marker {
            0xe0 if payload.starts_with(b"JFIF\0") => 14,
            0xe8 if payload.starts_with(b"mrfx") => 5,
            0xee if payload.starts_with(b"Adobe") => 12,
            // Frames, tables, scans, and those of JPEG-LS.
            0xc0..=0xc7 | 0xc9..=0xcf | 0xda..=0xdf | 0xf7 | 0xf8 => payload.len(),
            _ => 0,
        };
        payload[n_kept.min(end - start)..].fill(0);
        is_in_scan = marker == 0xda;
        at = end;
    }
}

/// Clears a JPEG 2000 codestream; its end, or none where it is damaged.
fn clear_jpeg_2000(stream: &mut [u8]) -> Option<usize> {
    let (mut at, mut end_of_tile) = (2, None);
    loop {
        match half(stream, at)? {
            // End of the codestream.
            0xffd9 => {
                stream[at + 2..].fill(0);
                return Some(at + 2);
            }
            // Start of data: to the end of its part of a tile, or, where that is not said, of the codestream.
            0xff93 => {
                at = match end_of_tile.take()? {
                    0 => end_of_data(stream, at + 2)?,
                    end => Some(end).filter(|&end| end > at + 1)?,
                };
            }
            marker => {
                let start = at;
                let end = at + 2 + half(stream, at + 2).filter(|&length| length >= 2)?;
                let payload = stream.get_mut(at + 4..end)?;
                match marker {
                    0xff50..=0xff63 | 0xff70..=0xff7a => {}
                    // Behind the number that says whether it is text.
                    0xff64 => payload[2.min(end - at - 4)..].fill(0),
                    0xff90 => {
                        let length = half(payload, 2)? << 16 | half(payload, 4)?;
                        end_of_tile = Some(if length == 0 { 0 } else { start + length });
                    }
                    0xff00..=0xff3f | 0xff91 | 0xff92 => return None,
                    0xff00.. => payload.fill(0),
                    _ => return None,
                }
                at = end;
            }
        }
    }
}

/// Where the end of the codestream follows coded data from a place on. In them 0xff is followed by more than 0x8f in the
/// markers of packets alone.
fn end_of_data(stream: &[u8], mut at: usize) -> Option<usize> {
    loop {
        match half(stream, at)? {
            0xffd9 => return Some(at),
            // The start of a packet, with its number.
            0xff91 => at += 6,
            _ => at += 1,
        }
    }
}

/// Clears an RLE frame; none where it is damaged.
fn clear_rle(frame: &mut [u8], n_pixels: usize) -> Option<()> {
    let places: Vec<usize> = frame
        .get(..RLE_HEADER)?
        .chunks_exact(4)
        .map(|four| u32::from_le_bytes([four[0], four[1], four[2], four[3]]) as usize)
        .collect();
    let n_segments = places[0];
    let mut starts = places.get(1..)?.get(..n_segments).filter(|starts| !starts.is_empty())?.to_vec();
    frame[4 * (1 + n_segments)..RLE_HEADER].fill(0);
    if starts[0] != RLE_HEADER {
        return None;
    }
    starts.push(frame.len());
    for ends in starts.windows(2) {
        let segment = frame.get_mut(ends[0]..ends[1])?;
        let (mut at, mut n_done) = (0, 0);
        while n_done < n_pixels {
            let code = *segment.get(at)?;
            let n = usize::from(code);
            let (n_bytes, n_coded) = match code {
                RLE_NOTHING => (1, 0),
                0..RLE_NOTHING => (n + 2, n + 1),
                _ => (2, 257 - n),
            };
            at += n_bytes;
            n_done += n_coded;
        }
        segment.get_mut(at..)?.fill(RLE_NOTHING);
    }
    Some(())
}
