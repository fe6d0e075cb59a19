//! Compressed bytes, whose number is known before any memory is taken for them.

use std::io::{self, Read};
use std::path::Path;

use flate2::read::{MultiGzDecoder, ZlibDecoder};

use super::error::ImageError;

/// A deflate stream grows by at most this factor (258 bytes from 2 bits).
const MAX_DEFLATE_RATIO: u64 = 1032;
/// The first bytes of a gzip stream.
const GZIP_MAGIC: [u8; 2] = [0x1f, 0x8b];

/// How bytes are compressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Packing {
    /// gzip (RFC 1952), one or more members.
    Gzip,
    /// zlib (RFC 1950).
    Zlib,
}

/// All bytes of a file, as they are.
///
/// # Errors
/// A refusal of the file system.
pub(super) fn load(file: &Path) -> Result<Vec<u8>, ImageError> {
    std::fs::read(file).map_err(|source| ImageError::Io { file: file.to_path_buf(), source })
}

/// All bytes of a file, decompressed if they are gzip: exactly as many as `measure` says. It is handed the first
/// `n_first` bytes, or fewer of a shorter file, and answers with what it read there and the size of the whole.
///
/// # Errors
/// Those of `measure`; the number of bytes found, handed to `mismatch`; a damaged stream; a refusal of the file system.
pub(super) fn read_measured<H>(
    file: &Path,
    n_first: usize,
    measure: impl FnOnce(&[u8]) -> Result<(H, u64), ImageError>,
    mismatch: impl FnOnce(&H, u64, u64) -> ImageError,
) -> Result<(H, Vec<u8>), ImageError> {
    let stored = load(file)?;
    if !stored.starts_with(&GZIP_MAGIC) {
        let (header, expected) = measure(&stored[..stored.len().min(n_first)])?;
        return match stored.len() as u64 == expected {
            true => Ok((header, stored)),
            false => Err(mismatch(&header, expected, stored.len() as u64)),
        };
    }
    let mut decoder = MultiGzDecoder::new(stored.as_slice());
    let mut bytes = Vec::new();
    let result = (&mut decoder).take(n_first as u64).read_to_end(&mut bytes);
    result.map_err(|source| damaged(file, bytes.len() as u64, None, source))?;
    let (header, expected) = measure(&bytes)?;
    match fill(file, &mut decoder, &mut bytes, expected, stored.len())? {
        found if found == expected => Ok((header, bytes)),
        found => Err(mismatch(&header, expected, found)),
    }
}

/// The `expected` bytes in a compressed stream.
///
/// # Errors
/// The number of bytes found, handed to `mismatch`; a damaged stream.
pub(super) fn unpack(
    file: &Path,
    packing: Packing,
    stored: &[u8],
    expected: u64,
    mismatch: impl FnOnce(u64) -> ImageError,
) -> Result<Vec<u8>, ImageError> {
    let mut bytes = Vec::new();
    let found = match packing {
        Packing::Gzip => fill(file, &mut MultiGzDecoder::new(stored), &mut bytes, expected, stored.len())?,
        Packing::Zlib => fill(file, &mut ZlibDecoder::new(stored), &mut bytes, expected, stored.len())?,
    };
    if found == expected { Ok(bytes) } else { Err(mismatch(found)) }
}

/// Fills `bytes` up to `expected` of them; answers with how many the stream has in all.
fn fill(
    file: &Path,
    decoder: &mut impl Read,
    bytes: &mut Vec<u8>,
    expected: u64,
    n_stored: usize,
) -> Result<u64, ImageError> {
    let is_possible = expected <= (n_stored as u64).saturating_mul(MAX_DEFLATE_RATIO);
    if is_possible {
        // `take` and a growing vector: memory follows the bytes that really come out.
        let result = decoder.take(expected.saturating_sub(bytes.len() as u64)).read_to_end(bytes);
        result.map_err(|source| damaged(file, bytes.len() as u64, Some(expected), source))?;
    }
    // To the end of the stream, keeping nothing: for its checksum, and to count what is too much.
    let mut surplus = CountingSink(0);
    let result = io::copy(decoder, &mut surplus);
    let found = bytes.len() as u64 + surplus.0;
    result.map_err(|source| damaged(file, found, Some(expected), source))?;
    // A promise that the stream cannot keep is never met, whatever came out of it.
    Ok(if is_possible { found } else { found.min(expected - 1) })
}

fn damaged(file: &Path, n_bytes: u64, n_expected: Option<u64>, source: io::Error) -> ImageError {
    ImageError::Gzip { file: file.to_path_buf(), n_bytes, n_expected, source }
}

/// Counts the bytes written to it.
struct CountingSink(u64);

impl io::Write for CountingSink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0 += bytes.len() as u64;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
