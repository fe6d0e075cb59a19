//! A place in a file's bytes that moves by tokens, lines or bytes, and knows where it is for errors.

use std::path::Path;
use std::str::FromStr;

use super::{FilePlace, Space, SurfaceFileError};
use crate::math::DVec3;
use crate::scan::FormatError;

/// Longest piece of a file that an error repeats.
const LONGEST_QUOTE: usize = 40;

/// See the module.
pub(super) struct Cursor<'a> {
    path: &'a Path,
    bytes: &'a [u8],
    at: usize,
    /// Line of `at`, from 1; without meaning after binary data.
    line: usize,
    /// Binary data were read: places are bytes from there on.
    in_binary: bool,
    /// Start of what was read last, for errors.
    last: FilePlace,
}

impl<'a> Cursor<'a> {
    pub(super) fn new(path: &'a Path, bytes: &'a [u8]) -> Self {
        Self { path, bytes, at: 0, line: 1, in_binary: false, last: FilePlace::Line(1) }
    }

    /// All bytes of the file.
    pub(super) fn all(&self) -> &'a [u8] {
        self.bytes
    }

    /// The bytes not read yet.
    pub(super) fn rest(&self) -> &'a [u8] {
        &self.bytes[self.at..]
    }

    fn place(&self) -> FilePlace {
        if self.in_binary { FilePlace::Byte(self.at) } else { FilePlace::Line(self.line) }
    }

    /// An error at what was read last.
    pub(super) fn error(&self, expected: impl Into<String>, found: impl Into<String>) -> SurfaceFileError {
        SurfaceFileError::Syntax {
            path: self.path.to_owned(),
            place: self.last,
            expected: expected.into(),
            found: found.into(),
        }
    }

    /// An error about something in the file that has a name.
    pub(super) fn content_error(&self, error: FormatError) -> SurfaceFileError {
        SurfaceFileError::Content { path: self.path.to_owned(), error }
    }

    /// Checks that `count` things of at least `bytes_each` bytes can follow.
    pub(super) fn check_count(
        &self,
        count: u64,
        bytes_each: usize,
        what: &str,
    ) -> Result<usize, SurfaceFileError> {
        let needed = u128::from(count) * bytes_each.max(1) as u128;
        match usize::try_from(count) {
            Ok(count) if needed <= self.rest().len() as u128 => Ok(count),
            _ => Err(SurfaceFileError::Truncated {
                path: self.path.to_owned(),
                place: self.last,
                what: format!("{count} {what}"),
                needed,
                found: self.rest().len(),
            }),
        }
    }

    /// As [`Cursor::check_count`] for numbers in text: each but the last has a space behind it.
    pub(super) fn check_text_count(&self, count: u64, what: &str) -> Result<usize, SurfaceFileError> {
        self.check_count(count.saturating_mul(2).saturating_sub(1), 1, what)?;
        self.check_count(count, 1, what)
    }

    /// The next line without its end, or none at the end of the file.
    pub(super) fn next_line(&mut self) -> Option<&'a [u8]> {
        if self.at >= self.bytes.len() {
            return None;
        }
        self.last = self.place();
        let rest = self.rest();
        let length = rest.iter().position(|&b| b == b'\n').unwrap_or(rest.len());
        self.at = (self.at + length + 1).min(self.bytes.len());
        self.line += 1;
        let line = &rest[..length];
        Some(line.strip_suffix(b"\r").unwrap_or(line))
    }

    /// The next line as text, or an error that says `what` is missing.
    pub(super) fn text_line(&mut self, what: &str) -> Result<&'a str, SurfaceFileError> {
        self.last = self.place();
        let Some(line) = self.next_line() else { return Err(self.error(what, "the end of the file")) };
        std::str::from_utf8(line).map_err(|_| self.error(format!("{what} as text"), quote(line)))
    }

    /// The next word, or none at the end of the file.
    pub(super) fn next_token(&mut self) -> Result<Option<&'a str>, SurfaceFileError> {
        while let Some(&byte) = self.bytes.get(self.at) {
            if !byte.is_ascii_whitespace() {
                break;
            }
            self.line += usize::from(byte == b'\n');
            self.at += 1;
        }
        self.last = self.place();
        let rest = self.rest();
        let length = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
        self.at += length;
        if length == 0 {
            return Ok(None);
        }
        let token =
            std::str::from_utf8(&rest[..length]).map_err(|_| self.error("text", quote(&rest[..length])))?;
        Ok(Some(token))
    }

    /// The next word, or an error that says `what` is missing.
    pub(super) fn token(&mut self, what: &str) -> Result<&'a str, SurfaceFileError> {
        self.next_token()?.ok_or_else(|| self.error(what, "the end of the file"))
    }

    /// The next word as a number.
    pub(super) fn number<T: FromStr>(&mut self, what: &str) -> Result<T, SurfaceFileError> {
        let token = self.token(what)?;
        self.parse(token, what)
    }

    /// A word of the line read last as a number.
    pub(super) fn parse<T: FromStr>(&self, word: &str, what: &str) -> Result<T, SurfaceFileError> {
        word.parse().map_err(|_| self.error(what, quote(word.as_bytes())))
    }

    /// `count` bytes.
    pub(super) fn take(&mut self, count: usize, what: &str) -> Result<&'a [u8], SurfaceFileError> {
        self.in_binary = true;
        self.last = self.place();
        self.check_count(count as u64, 1, what)?;
        let taken = &self.rest()[..count];
        self.at += count;
        Ok(taken)
    }

    /// Takes the blanks and the end of line before binary data, if there are any.
    pub(super) fn skip_line_end(&mut self) {
        let rest = self.rest();
        let blanks = rest.iter().take_while(|&&b| b == b' ' || b == b'\t').count();
        let end = &rest[blanks..];
        let length = usize::from(end.starts_with(b"\n")) + 2 * usize::from(end.starts_with(b"\r\n"));
        if length > 0 {
            self.at += blanks + length;
        }
    }

    /// `p` if its coordinates are finite.
    pub(super) fn finite(&self, p: DVec3) -> Result<DVec3, SurfaceFileError> {
        if is_usable(p) {
            return Ok(p);
        }
        Err(self.error("coordinates within 1e9", format!("({}, {}, {})", p.x, p.y, p.z)))
    }

    /// The frame that a comment names by `SPACE=`, if it does.
    pub(super) fn space(&self, comment: &[u8]) -> Result<Option<Space>, SurfaceFileError> {
        const KEY: &[u8] = b"SPACE=";
        let Some(start) = comment.windows(KEY.len()).position(|w| w.eq_ignore_ascii_case(KEY)) else {
            return Ok(None);
        };
        let value = &comment[start + KEY.len()..];
        let length = value.iter().position(|b| !b.is_ascii_alphanumeric()).unwrap_or(value.len());
        match value[..length].to_ascii_uppercase().as_slice() {
            b"LPS" => Ok(Some(Space::Lps)),
            b"RAS" => Ok(Some(Space::Ras)),
            _ => {
                Err(self.error("SPACE=LPS or SPACE=RAS", quote(&comment[start..start + KEY.len() + length])))
            }
        }
    }
}

/// Whether coordinates, in the file's unit, are finite and not so large that squared lengths overflow later on: no organ
/// is that far away.
pub(super) fn is_usable(p: DVec3) -> bool {
    p.is_finite() && p.abs().max_element() <= 1e9
}

/// A piece of the file for an error message.
pub(super) fn quote(bytes: &[u8]) -> String {
    let shown = String::from_utf8_lossy(&bytes[..bytes.len().min(LONGEST_QUOTE)]);
    let more = if bytes.len() > LONGEST_QUOTE { "..." } else { "" };
    format!("'{}{more}'", shown.escape_debug())
}
