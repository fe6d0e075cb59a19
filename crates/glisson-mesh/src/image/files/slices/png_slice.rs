//! Slices as PNG: grey or in colour, 8 or 16 bits a number; fewer bits and palettes become 8.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use png::{BitDepth, ColorType, Decoder, Limits, Reader, Transformations};

use super::super::error::ImageError;
use super::picture::{Colours, Picture, Shape, refuse};

/// A deflate stream grows by at most this factor.
const MAX_RATIO: u64 = 1032;
/// Bytes that the decoder may take beside the pixels, for rows and notes.
const MAX_DECODER_BYTES: usize = 1 << 26;

fn open(file: &Path) -> Result<(Reader<BufReader<File>>, Shape), ImageError> {
    let io_error = |source| ImageError::Io { file: file.to_path_buf(), source };
    let damaged = |error: &dyn std::fmt::Display| refuse(file, format!("damaged or no PNG: {error}"));
    let opened = File::open(file).map_err(io_error)?;
    let n_file_bytes = opened.metadata().map_err(io_error)?.len();
    let mut decoder = Decoder::new_with_limits(BufReader::new(opened), Limits { bytes: MAX_DECODER_BYTES });
    decoder.set_transformations(Transformations::EXPAND);
    let reader = decoder.read_info().map_err(|error| damaged(&error))?;
    let (colours, depth) = reader.output_color_type();
    let (colours, n_samples) = match colours {
        ColorType::Grayscale => (Colours::Grey, 1),
        ColorType::GrayscaleAlpha => (Colours::Grey, 2),
        ColorType::Rgb => (Colours::Three, 3),
        ColorType::Rgba => (Colours::Three, 4),
        ColorType::Indexed => return Err(refuse(file, "a PNG whose palette is missing; copy it again")),
    };
    let n_bits = if depth == BitDepth::Sixteen { 16 } else { 8 };
    let info = reader.info();
    let shape = Shape { size: [info.width as usize, info.height as usize], colours, n_bits, n_samples };
    // Pixels of a bit become a byte.
    let growth = if (info.bit_depth as u64) < 8 || info.color_type == ColorType::Indexed {
        32
    } else if info.trns.is_some() {
        // A number of opacity beside each other.
        2
    } else {
        1
    };
    shape.check(file, n_file_bytes, MAX_RATIO * growth)?;
    Ok((reader, shape))
}

/// What a file says of its picture.
pub(super) fn shape(file: &Path) -> Result<Shape, ImageError> {
    open(file).map(|(_, shape)| shape)
}

/// The picture in a file.
pub(super) fn read(file: &Path) -> Result<Picture, ImageError> {
    let (mut reader, shape) = open(file)?;
    let damaged =
        |error: &dyn std::fmt::Display| refuse(file, format!("damaged PNG: {error}; copy it again"));
    let n_bytes = reader.output_buffer_size().filter(|&n| n as u64 == shape.n_bytes());
    let n_bytes = n_bytes.ok_or_else(|| damaged(&"another number of bytes than its header says"))?;
    let mut bytes = vec![0; n_bytes];
    reader.next_frame(&mut bytes).map_err(|error| damaged(&error))?;
    let samples = match shape.n_bits {
        16 => bytes.chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]])).collect(),
        _ => bytes.into_iter().map(u16::from).collect(),
    };
    Ok(Picture { shape, samples })
}
