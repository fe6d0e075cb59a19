//! Slices as TIFF: grey or in colour, 8 or 16 bits a number, one picture a file; plain, PackBits, LZW or deflate.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use tiff::ColorType;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::Tag;

use super::super::error::ImageError;
use super::picture::{Colours, Picture, Shape, refuse};

/// An LZW code of twelve bits stands for at most some 3,800 bytes.
const MAX_RATIO: u64 = 2600;
/// Bytes that the decoder may take for an entry of the file's directory.
const MAX_ENTRY_BYTES: usize = 1 << 22;

fn open(file: &Path) -> Result<(Decoder<BufReader<File>>, Shape), ImageError> {
    let io_error = |source| ImageError::Io { file: file.to_path_buf(), source };
    let damaged = |error: tiff::TiffError| refuse(file, format!("damaged or no TIFF that is read: {error}"));
    let opened = File::open(file).map_err(io_error)?;
    let n_file_bytes = opened.metadata().map_err(io_error)?.len();
    let mut limits = Limits::default();
    limits.ifd_value_size = MAX_ENTRY_BYTES;
    let decoder = Decoder::new(BufReader::new(opened)).map_err(damaged)?;
    let mut decoder = decoder.with_limits(limits.clone());
    if decoder.more_images() {
        return Err(refuse(
            file,
            "several pictures in one TIFF, one allowed: write each slice into a file of its own",
        ));
    }
    let colours = decoder.colortype().map_err(damaged)?;
    let (colours, n_samples, n_bits) = match colours {
        ColorType::Gray(n_bits @ (8 | 16)) => (Colours::Grey, 1, n_bits),
        ColorType::GrayA(n_bits @ (8 | 16)) => (Colours::Grey, 2, n_bits),
        ColorType::RGB(n_bits @ (8 | 16)) => (Colours::Three, 3, n_bits),
        ColorType::RGBA(n_bits @ (8 | 16)) => (Colours::Three, 4, n_bits),
        other => {
            let reason = format!(
                "a TIFF of {other:?}, allowed: grey or RGB with 8 or 16 bits a number; convert the slices"
            );
            return Err(refuse(file, reason));
        }
    };
    let is_planar = decoder.find_tag_unsigned::<u16>(Tag::PlanarConfiguration).map_err(damaged)? == Some(2);
    if is_planar && n_samples > 1 {
        let reason = "a TIFF that holds its colours one after the other (PlanarConfiguration 2), allowed: those of a pixel \
                      together (1); convert the slices";
        return Err(refuse(file, reason));
    }
    let turn = decoder.find_tag_unsigned::<u16>(Tag::Orientation).map_err(damaged)?.unwrap_or(1);
    if turn != 1 {
        let reason = format!(
            "a TIFF that is to be turned or mirrored to be looked at (Orientation {turn}), allowed: none, or 1 (its first \
             row above, its first column left); turn the pixels themselves, e.g. with mogrify -auto-orient"
        );
        return Err(refuse(file, reason));
    }
    let (columns, rows) = decoder.dimensions().map_err(damaged)?;
    let size = [columns as usize, rows as usize];
    let shape = Shape { size, colours, n_bits: usize::from(n_bits), n_samples };
    shape.check(file, n_file_bytes, MAX_RATIO)?;
    // What was checked may be taken.
    let n_bytes = usize::try_from(shape.n_bytes()).unwrap_or(usize::MAX);
    limits.decoding_buffer_size = n_bytes;
    limits.intermediate_buffer_size = n_bytes.saturating_mul(2).max(1 << 20);
    Ok((decoder.with_limits(limits), shape))
}

/// What a file says of its picture.
pub(super) fn shape(file: &Path) -> Result<Shape, ImageError> {
    open(file).map(|(_, shape)| shape)
}

/// The picture in a file.
pub(super) fn read(file: &Path) -> Result<Picture, ImageError> {
    let (mut decoder, shape) = open(file)?;
    let result = decoder.read_image();
    let result = result.map_err(|error| refuse(file, format!("damaged TIFF: {error}; copy it again")))?;
    let samples = match result {
        DecodingResult::U8(bytes) => bytes.into_iter().map(u16::from).collect(),
        DecodingResult::U16(words) => words,
        _ => {
            return Err(refuse(
                file,
                "a TIFF of signed numbers or floats, allowed: unsigned; convert the slices",
            ));
        }
    };
    let expected = shape.n_pixels() * shape.n_samples;
    if samples.len() != expected {
        let reason = format!("damaged TIFF: {} numbers, {expected} expected; copy it again", samples.len());
        return Err(refuse(file, reason));
    }
    Ok(Picture { shape, samples })
}
