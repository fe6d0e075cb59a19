//! The numbers of frames, out of any transfer syntax that is known.

use std::path::Path;

use dicom_core::VR;
use dicom_dictionary_std::{tags, uids};
use dicom_object::DefaultDicomObject;
use dicom_pixeldata::PixelDecoder;
use dicom_transfer_syntax_registry::{TransferSyntaxIndex, TransferSyntaxRegistry};
use hayro_jpeg2000::{DecodeSettings, DecoderContext, Image};

use super::super::error::ImageError;
use super::frames::{integer, wrong};
use super::lengths::EXPLICIT_VR_BIG_ENDIAN;
use super::series::causes;
use crate::binary::NumberType;

/// How the numbers of a file's frames are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct PixelKind {
    pub(super) n_bits_allocated: u32,
    n_bits_stored: u32,
    high_bit: u32,
    is_signed: bool,
}

impl PixelKind {
    pub(super) fn of(file: &Path, object: &DefaultDicomObject) -> Result<Self, ImageError> {
        let number = |tag, name, least: i64, most: i64, default: Option<i64>| {
            let found = integer(object, tag).or(default).filter(|n| (least..=most).contains(n));
            found.ok_or_else(|| wrong(file, object, tag, name, format!("{least} to {most}")))
        };
        let n_bits_allocated = number(tags::BITS_ALLOCATED, "BitsAllocated", 1, 32, None)?;
        if ![1, 8, 16, 32].contains(&n_bits_allocated) {
            return Err(wrong(file, object, tags::BITS_ALLOCATED, "BitsAllocated", "1, 8, 16 or 32"));
        }
        let n_bits_stored =
            number(tags::BITS_STORED, "BitsStored", 1, n_bits_allocated, Some(n_bits_allocated))?;
        let high_bit = number(
            tags::HIGH_BIT,
            "HighBit",
            n_bits_stored - 1,
            n_bits_allocated - 1,
            Some(n_bits_stored - 1),
        )?;
        let representation = number(tags::PIXEL_REPRESENTATION, "PixelRepresentation", 0, 1, Some(0))?;
        Ok(Self {
            n_bits_allocated: n_bits_allocated as u32,
            n_bits_stored: n_bits_stored as u32,
            high_bit: high_bit as u32,
            is_signed: representation == 1,
        })
    }

    /// Numbers that hold every value.
    pub(super) fn number_type(self) -> NumberType {
        match (self.n_bits_allocated, self.is_signed) {
            (1 | 8, false) => NumberType::U8,
            (1 | 8, true) => NumberType::I8,
            (16, false) => NumberType::U16,
            (16, true) => NumberType::I16,
            (_, false) => NumberType::U32,
            (_, true) => NumberType::I32,
        }
    }

    /// A word with its value and nothing in the bits that are not used (sign bits go on above).
    pub(super) fn bare(self, word: u32) -> u32 {
        (self.value(word) << (self.high_bit + 1 - self.n_bits_stored)) as u32
    }

    /// The value in a word: its stored bits, with their sign.
    fn value(self, word: u32) -> i64 {
        let shifted = word >> (self.high_bit + 1 - self.n_bits_stored);
        let bits = i64::from(shifted) & ((1 << self.n_bits_stored) - 1);
        match self.is_signed && bits >> (self.n_bits_stored - 1) != 0 {
            true => bits - (1 << self.n_bits_stored),
            false => bits,
        }
    }
}

/// How the pixels of a transfer syntax become numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Coding {
    /// Words one after the other.
    Plain,
    /// Decoded by `dicom-pixeldata`, as JPEG is.
    Rle,
    /// Baseline and lossless.
    Jpeg,
    JpegLs,
    Jpeg2000,
}

const CODINGS: &[(&str, Coding)] = &[
    (uids::IMPLICIT_VR_LITTLE_ENDIAN, Coding::Plain),
    (uids::EXPLICIT_VR_LITTLE_ENDIAN, Coding::Plain),
    (EXPLICIT_VR_BIG_ENDIAN, Coding::Plain),
    (uids::DEFLATED_EXPLICIT_VR_LITTLE_ENDIAN, Coding::Plain),
    (uids::RLE_LOSSLESS, Coding::Rle),
    (uids::JPEG_BASELINE8_BIT, Coding::Jpeg),
    (uids::JPEG_LOSSLESS, Coding::Jpeg),
    (uids::JPEG_LOSSLESS_SV1, Coding::Jpeg),
    (uids::JPEGLS_LOSSLESS, Coding::JpegLs),
    (uids::JPEGLS_NEAR_LOSSLESS, Coding::JpegLs),
    (uids::JPEG2000_LOSSLESS, Coding::Jpeg2000),
    (uids::JPEG2000, Coding::Jpeg2000),
];

/// How the pixels of a transfer syntax become numbers.
///
/// # Errors
/// A transfer syntax that is not read, by its name.
pub(super) fn coding_of(file: &Path, uid: &str) -> Result<Coding, ImageError> {
    let coding = CODINGS.iter().find(|(known, _)| *known == uid).map(|(_, coding)| *coding);
    coding.ok_or_else(|| {
        let name = TransferSyntaxRegistry.get(uid).map_or("unknown", |syntax| syntax.name());
        let reason = format!(
            "its pixels are coded as {name} ({uid}), which is not read; convert the file to an uncompressed transfer \
             syntax (e.g. with gdcmconv --raw or dcmdjpeg)"
        );
        ImageError::Series { folder: file.to_path_buf(), reason }
    })
}

/// Whether words of two bytes were turned one by one, so that the high half of each number stands first.
pub(super) fn has_turned_halves(syntax: &str, kind: PixelKind, vr: VR) -> bool {
    syntax == EXPLICIT_VR_BIG_ENDIAN && kind.n_bits_allocated == 32 && vr == VR::OW
}

/// The pixels of a file, out of which frames are taken.
pub(super) struct Pixels<'a> {
    file: &'a Path,
    object: &'a DefaultDicomObject,
    kind: PixelKind,
    /// Columns and rows.
    dims: [usize; 2],
    coding: Coding,
    /// All words of a plain coding; empty for others.
    plain: Vec<u8>,
}

/// The identifier of a file's transfer syntax, without what fills it up.
pub(super) fn syntax_of(object: &DefaultDicomObject) -> &str {
    object.meta().transfer_syntax().trim_end_matches(['\0', ' '])
}

impl<'a> Pixels<'a> {
    /// Those of `n_frames` frames of `dims` columns and rows.
    ///
    /// # Errors
    /// A transfer syntax that is not known; fewer bytes than the frames need.
    pub(super) fn new(
        file: &'a Path,
        object: &'a DefaultDicomObject,
        dims: [usize; 2],
        n_frames: usize,
    ) -> Result<Self, ImageError> {
        let kind = PixelKind::of(file, object)?;
        let uid = syntax_of(object);
        let coding = coding_of(file, uid)?;
        let mut plain = Vec::new();
        if coding == Coding::Plain {
            let missing = || wrong(file, object, tags::PIXEL_DATA, "PixelData", "the pixels of the image");
            let element = object.get(tags::PIXEL_DATA).ok_or_else(missing)?;
            plain = element.to_bytes().map_err(|_| missing())?.into_owned();
            if has_turned_halves(uid, kind, element.vr()) {
                for number in plain.chunks_exact_mut(4) {
                    number.rotate_left(2);
                }
            }
            let n_bits = dims[0] as u64 * dims[1] as u64 * n_frames as u64 * u64::from(kind.n_bits_allocated);
            let (found, expected) = (plain.len() as u64, n_bits.div_ceil(8));
            // A last byte may fill up to an even number.
            if found < expected {
                return Err(ImageError::SizeMismatch {
                    file: file.to_path_buf(),
                    expected,
                    found,
                    dims: [dims[0], dims[1], n_frames],
                    n_bytes_a_voxel: kind.n_bits_allocated.div_ceil(8) as usize,
                    data_start: 0,
                });
            }
        }
        Ok(Self { file, object, kind, dims, coding, plain })
    }

    /// Numbers that hold every value of a frame.
    pub(super) fn number_type(&self) -> NumberType {
        self.kind.number_type()
    }

    /// The values of a frame, row by row.
    ///
    /// # Errors
    /// Compressed data that are damaged, or are another image than the header says.
    pub(super) fn of_frame(&self, index: usize) -> Result<Vec<i64>, ImageError> {
        let n = self.dims[0] * self.dims[1];
        let values = match self.coding {
            Coding::Plain if self.kind.n_bits_allocated == 1 => {
                let bit = |at: usize| i64::from(self.plain[at / 8] >> (at % 8) & 1);
                Ok((index * n..(index + 1) * n).map(bit).collect())
            }
            Coding::Plain => {
                let n_bytes = self.kind.n_bits_allocated as usize / 8 * n;
                Ok(self.of_words(&self.plain[index * n_bytes..(index + 1) * n_bytes]))
            }
            Coding::Rle | Coding::Jpeg => {
                let decoded = self.object.decode_pixel_data_frame(index as u32);
                decoded.map(|decoded| self.of_words(decoded.data())).map_err(|error| causes(&error))
            }
            Coding::JpegLs => self.stream_of(index).and_then(|stream| self.of_jpeg_ls(&stream)),
            Coding::Jpeg2000 => self.stream_of(index).and_then(|stream| self.of_jpeg_2000(&stream)),
        };
        let refuse = |reason: String| ImageError::Series {
            folder: self.file.to_path_buf(),
            reason: format!("frame {}: {reason}; copy or export the file again", index + 1),
        };
        match values {
            Ok(values) if values.len() == n => Ok(values),
            Ok(values) => {
                Err(refuse(format!("{} voxels decoded, {n} expected from Rows and Columns", values.len())))
            }
            Err(reason) => Err(refuse(format!("damaged pixels: {reason}"))),
        }
    }

    /// The values of words in the machine's byte order.
    fn of_words(&self, bytes: &[u8]) -> Vec<i64> {
        let words = bytes.chunks_exact((self.kind.n_bits_allocated / 8).max(1) as usize);
        let word = |bytes: &[u8]| match *bytes {
            [a] => u32::from(a),
            [a, b] => u32::from(u16::from_ne_bytes([a, b])),
            [a, b, c, d] => u32::from_ne_bytes([a, b, c, d]),
            _ => 0,
        };
        words.map(|bytes| self.kind.value(word(bytes))).collect()
    }

    /// The compressed stream of a frame, joined of its fragments (DICOM PS3.5, A.4).
    fn stream_of(&self, index: usize) -> Result<Vec<u8>, String> {
        let element = self.object.get(tags::PIXEL_DATA).ok_or("no PixelData")?;
        let fragments = element.fragments().ok_or("PixelData without fragments")?;
        let n_frames = integer(self.object, tags::NUMBER_OF_FRAMES).map_or(1, |n| n.max(1) as usize);
        let offsets = element.value().offset_table().unwrap_or_default();
        if n_frames == 1 {
            return Ok(fragments.concat());
        }
        if fragments.len() == n_frames {
            return fragments.get(index).cloned().ok_or_else(|| "no such frame".into());
        }
        let first = *offsets.get(index).ok_or("several fragments a frame and no offset table")?;
        let end = offsets.get(index + 1).copied().unwrap_or(u32::MAX);
        let (mut at, mut stream) = (0u64, Vec::new());
        for fragment in fragments {
            if (u64::from(first)..u64::from(end)).contains(&at) {
                stream.extend_from_slice(fragment);
            }
            // Each stands behind a tag and a length of four bytes.
            at += 8 + fragment.len() as u64;
        }
        Ok(stream)
    }

    fn of_jpeg_ls(&self, stream: &[u8]) -> Result<Vec<i64>, String> {
        let [n_columns, n_rows] = self.dims.map(|n| n as u32);
        let (words, found_columns, found_rows) =
            jpegls::decode(stream, n_columns, n_rows).map_err(|error| causes(&error))?;
        if [found_columns, found_rows] != [n_columns, n_rows] {
            return Err(format!(
                "an image of {found_columns} x {found_rows}, {n_columns} x {n_rows} expected"
            ));
        }
        Ok(words.into_iter().map(|word| self.kind.value(u32::from(word))).collect())
    }

    fn of_jpeg_2000(&self, stream: &[u8]) -> Result<Vec<i64>, String> {
        let settings = DecodeSettings { strict: true, ..DecodeSettings::default() };
        let image = Image::new(stream, &settings).map_err(|error| error.to_string())?;
        let [n_columns, n_rows] = self.dims.map(|n| n as u32);
        if [image.width(), image.height()] != [n_columns, n_rows] {
            let (w, h) = (image.width(), image.height());
            return Err(format!("an image of {w} x {h}, {n_columns} x {n_rows} expected"));
        }
        let mut context = DecoderContext::default();
        let decoded = image.decode(&mut context).map_err(|error| error.to_string())?;
        let [component] = decoded.components() else {
            return Err(format!("{} numbers a voxel, one expected", decoded.components().len()));
        };
        // The decoder adds half the range to signed numbers as to others. What the header says of the bits counts: files
        // whose codestream says otherwise of the sign are not rare.
        let half =
            if is_signed_jpeg_2000(stream) { 1i64 << (component.bit_depth().clamp(1, 32) - 1) } else { 0 };
        let words = component.samples().iter().map(|sample| (libm::rintf(*sample) as i64 - half) as u32);
        Ok(words.map(|word| self.kind.value(word)).collect())
    }
}

/// Whether the first component of a codestream has signed numbers: bit 7 of `Ssiz` in its `SIZ` segment
/// (ISO/IEC 15444-1, A.5.1).
fn is_signed_jpeg_2000(stream: &[u8]) -> bool {
    const START: [u8; 4] = [0xff, 0x4f, 0xff, 0x51];
    /// From the start of the codestream to the first `Ssiz`.
    const TO_SSIZ: usize = 42;
    let start = stream.windows(START.len()).position(|window| window == START);
    start.and_then(|start| stream.get(start + TO_SSIZ)).is_some_and(|ssiz| ssiz & 0x80 != 0)
}
