//! A picture of a slice: what its file says of it, and its numbers.

use std::fmt;
use std::path::Path;

use super::super::error::ImageError;

/// Most columns or rows of a slice.
pub(super) const MAX_SIDE: u32 = 65_535;

/// What the pixels of a picture are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Colours {
    Grey,
    /// Red, green and blue.
    Three,
}

/// What a picture's file says of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Shape {
    /// Columns and rows.
    pub(super) size: [usize; 2],
    pub(super) colours: Colours,
    /// Bits of a number: 8 or 16.
    pub(super) n_bits: usize,
    /// Numbers of a pixel in the file, with those of its opacity.
    pub(super) n_samples: usize,
}

impl fmt::Display for Shape {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let colours = match self.colours {
            Colours::Grey => "grey",
            Colours::Three => "in colour",
        };
        let opacity = if self.n_samples.is_multiple_of(2) { ", with opacity" } else { "" };
        write!(f, "{} x {} pixels, {colours}, {} bits{opacity}", self.size[0], self.size[1], self.n_bits)
    }
}

impl Shape {
    pub(super) fn n_pixels(&self) -> usize {
        self.size[0] * self.size[1]
    }

    /// Bytes of the numbers, which fit into 64 bits for sides up to [`MAX_SIDE`].
    pub(super) fn n_bytes(&self) -> u64 {
        self.n_pixels() as u64 * (self.n_samples * self.n_bits / 8) as u64
    }

    /// Refuses sides that are too long, and more pixels than a file of `n_file_bytes` can hold if each of its bytes
    /// becomes at most `max_ratio`.
    ///
    /// # Errors
    /// With the size and what would be right.
    pub(super) fn check(&self, file: &Path, n_file_bytes: u64, max_ratio: u64) -> Result<(), ImageError> {
        let [columns, rows] = self.size;
        if [columns, rows].iter().any(|&n| n == 0 || n > MAX_SIDE as usize) {
            return Err(refuse(
                file,
                format!("{columns} x {rows} pixels, 1 to {MAX_SIDE} allowed along each side"),
            ));
        }
        let n_bytes = self.n_bytes();
        if n_bytes > n_file_bytes.saturating_mul(max_ratio) {
            return Err(refuse(
                file,
                format!(
                    "it promises {columns} x {rows} pixels ({n_bytes} bytes), which cannot be in {n_file_bytes} bytes; the \
                     file is cut or damaged, copy it again"
                ),
            ));
        }
        Ok(())
    }
}

/// A picture, or a folder of them, that cannot be read, and why.
pub(super) fn refuse(place: &Path, reason: impl Into<String>) -> ImageError {
    ImageError::Series { folder: place.to_path_buf(), reason: reason.into() }
}

/// The numbers of a picture, those of a pixel together, row by row; and what it is.
#[derive(Clone, Debug)]
pub(super) struct Picture {
    pub(super) shape: Shape,
    pub(super) samples: Vec<u16>,
}
