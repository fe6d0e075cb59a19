//! Reading words and numbers out of text and binary bytes, and decimal numbers without rounding twice.

use std::borrow::Cow;
use std::fmt;

use roxmltree::Document;

use crate::units::LengthUnit;

/// Where in a file something is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// Line, from 1.
    Line(usize),
    /// Byte, from 0.
    Byte(usize),
    /// Something that has a name, such as a data array or a cell.
    Named(String),
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Line(line) => write!(f, "line {line}"),
            Self::Byte(byte) => write!(f, "byte {byte}"),
            Self::Named(name) => f.write_str(name),
        }
    }
}

/// What is wrong with the content of a file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{place}: found {found}, expected {expected}")]
pub struct FormatError {
    /// Where.
    pub place: Place,
    /// What stands there.
    pub found: String,
    /// What may stand there, and what to do.
    pub expected: String,
}

impl FormatError {
    /// A fault at something that has a name.
    pub(crate) fn named(
        name: impl Into<String>,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> Self {
        Self { place: Place::Named(name.into()), found: found.into(), expected: expected.into() }
    }
}

/// Text from a file for a message: short and printable.
pub(crate) fn quoted(bytes: &[u8]) -> String {
    let shown = String::from_utf8_lossy(&bytes[..bytes.len().min(40)]);
    let more = if bytes.len() > 40 { "..." } else { "" };
    format!("`{}`{more}", shown.escape_debug())
}

/// Place of `needle` in `bytes` at or after `from`.
pub(crate) fn find(bytes: &[u8], needle: &[u8], from: usize) -> Option<usize> {
    bytes.get(from..)?.windows(needle.len()).position(|w| w == needle).map(|at| from + at)
}

/// `xml` as a document.
pub(crate) fn parse_xml(xml: &str) -> Result<Document<'_>, FormatError> {
    Document::parse(xml).map_err(|error| FormatError {
        place: Place::Line(error.pos().row as usize),
        found: error.to_string(),
        expected: "an XML document".into(),
    })
}

/// A cursor over the bytes of a file.
#[derive(Clone, Debug)]
pub(crate) struct Scanner<'a> {
    bytes: &'a [u8],
    at: usize,
    line: usize,
    /// Starts a comment that lasts to the end of the line.
    comment: Option<u8>,
    digits: String,
}

impl<'a> Scanner<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0, line: 1, comment: None, digits: String::new() }
    }

    /// A scanner that passes over comments from `#` to the end of the line.
    pub(crate) fn with_comments(bytes: &'a [u8]) -> Self {
        Self { comment: Some(b'#'), ..Self::new(bytes) }
    }

    pub(crate) fn remaining(&self) -> usize {
        self.bytes.len() - self.at
    }

    pub(crate) fn rest(&self) -> &'a [u8] {
        &self.bytes[self.at..]
    }

    /// An error at the current line.
    pub(crate) fn error(&self, found: impl Into<String>, expected: impl Into<String>) -> FormatError {
        FormatError { place: Place::Line(self.line), found: found.into(), expected: expected.into() }
    }

    /// An error at the current byte.
    pub(crate) fn byte_error(&self, found: impl Into<String>, expected: impl Into<String>) -> FormatError {
        FormatError { place: Place::Byte(self.at), found: found.into(), expected: expected.into() }
    }

    fn skip_blank(&mut self) {
        while let Some(&byte) = self.bytes.get(self.at) {
            if self.comment == Some(byte) {
                while self.bytes.get(self.at).is_some_and(|&b| b != b'\n') {
                    self.at += 1;
                }
            } else if byte.is_ascii_whitespace() {
                self.line += usize::from(byte == b'\n');
                self.at += 1;
            } else {
                break;
            }
        }
    }

    /// The next word; none at the end.
    pub(crate) fn word(&mut self) -> Option<&'a [u8]> {
        self.skip_blank();
        let start = self.at;
        while self.bytes.get(self.at).is_some_and(|b| !b.is_ascii_whitespace() && self.comment != Some(*b)) {
            self.at += 1;
        }
        (self.at > start).then(|| &self.bytes[start..self.at])
    }

    /// The next word without taking it.
    pub(crate) fn peek(&mut self) -> Option<&'a [u8]> {
        self.skip_blank();
        let before = (self.at, self.line);
        let word = self.word();
        (self.at, self.line) = before;
        word
    }

    pub(crate) fn expect_word(&mut self, expected: &str) -> Result<&'a [u8], FormatError> {
        self.word().ok_or_else(|| self.error("the end of the file", expected))
    }

    /// The next word as text.
    pub(crate) fn expect_text(&mut self, expected: &str) -> Result<Cow<'a, str>, FormatError> {
        Ok(String::from_utf8_lossy(self.expect_word(expected)?))
    }

    /// The rest of the line without its end.
    pub(crate) fn line(&mut self) -> Option<&'a [u8]> {
        if self.at == self.bytes.len() {
            return None;
        }
        let rest = self.rest();
        let length = rest.iter().position(|&b| b == b'\n').unwrap_or(rest.len());
        self.at = (self.at + length + 1).min(self.bytes.len());
        self.line += 1;
        Some(rest[..length].strip_suffix(b"\r").unwrap_or(&rest[..length]))
    }

    pub(crate) fn integer(&mut self, expected: &str) -> Result<i64, FormatError> {
        let word = self.expect_word(expected)?;
        std::str::from_utf8(word)
            .ok()
            .and_then(|text| text.parse().ok())
            .ok_or_else(|| self.error(quoted(word), expected))
    }

    /// A count of things of which each takes at least `bytes_each` of the rest of the file.
    pub(crate) fn count(&mut self, what: &str, bytes_each: usize) -> Result<usize, FormatError> {
        let found = self.integer(&format!("the number of {what}"))?;
        self.check_count(found, what, bytes_each)
    }

    /// Checks a count against what the rest of the file can hold.
    pub(crate) fn check_count(
        &self,
        found: i64,
        what: &str,
        bytes_each: usize,
    ) -> Result<usize, FormatError> {
        // The last of the things may lack its separator.
        let most = (self.remaining() + 1) / bytes_each.max(1);
        match usize::try_from(found) {
            Ok(count) if count <= most => Ok(count),
            _ => Err(self.error(
                format!("{found} {what}"),
                format!("0 to {most}, which is all that the {} bytes left can hold", self.remaining()),
            )),
        }
    }

    /// A finite number.
    pub(crate) fn number(&mut self, expected: &str) -> Result<f64, FormatError> {
        self.length_m(LengthUnit::Metre, expected)
    }

    /// A finite length given in `unit` [m]: the decimal point is moved before the text is rounded to binary.
    pub(crate) fn length_m(&mut self, unit: LengthUnit, expected: &str) -> Result<f64, FormatError> {
        let word = self.expect_word(expected)?;
        let mut digits = std::mem::take(&mut self.digits);
        let value = parse_length_m(word, unit, &mut digits);
        self.digits = digits;
        value.ok_or_else(|| self.error(quoted(word), format!("{expected} (a finite number)")))
    }

    /// The next `n` bytes.
    pub(crate) fn take(&mut self, n: usize, what: &str) -> Result<&'a [u8], FormatError> {
        let bytes = self.rest().get(..n).ok_or_else(|| {
            self.byte_error(format!("{} bytes left", self.remaining()), format!("{n} bytes of {what}"))
        })?;
        self.at += n;
        Ok(bytes)
    }

    /// Goes behind the next `needle`, if there is one.
    pub(crate) fn skip_past(&mut self, needle: &[u8]) -> bool {
        let found = find(self.bytes, needle, self.at);
        if let Some(at) = found {
            let skipped = &self.bytes[self.at..at + needle.len()];
            self.line += skipped.iter().filter(|&&b| b == b'\n').count();
            self.at = at + needle.len();
        }
        found.is_some()
    }
}

/// The length [m] that `word` is in `unit`, if it is a finite number; `digits` is working space.
pub(crate) fn parse_length_m(word: &[u8], unit: LengthUnit, digits: &mut String) -> Option<f64> {
    let (factor, exponent) = unit.decimal();
    Some(parse_decimal(word, exponent, digits)? * factor).filter(|value| value.is_finite())
}

/// The finite number nearest to the decimal `word` times ten to `exponent`; none if it is no such number.
fn parse_decimal(word: &[u8], exponent: i32, digits: &mut String) -> Option<f64> {
    let text = std::str::from_utf8(word).ok()?;
    let value: f64 = if exponent == 0 {
        text.parse().ok()?
    } else {
        let (mantissa, own) = match text.find(['e', 'E']) {
            Some(at) => (&text[..at], text[at + 1..].parse::<i64>().ok()?),
            None => (text, 0),
        };
        digits.clear();
        digits.push_str(mantissa);
        digits.push('e');
        fmt::Write::write_fmt(digits, format_args!("{}", own.saturating_add(i64::from(exponent)))).ok()?;
        digits.parse().ok()?
    };
    value.is_finite().then_some(value)
}

/// `value_m` in millimetres, exactly: the shortest decimal of the metres with its point moved three places.
/// [`parse_decimal`] with exponent -3 gives back the same bits.
pub(crate) fn millimetres(value_m: f64) -> String {
    let text = format!("{value_m:e}");
    let (mantissa, exponent) = text.split_once('e').unwrap_or((&text, "0"));
    let exponent = exponent.parse::<i32>().unwrap_or(0) + 3;
    let (sign, mantissa) = mantissa.strip_prefix('-').map_or(("", mantissa), |m| ("-", m));
    let (whole, fraction) = mantissa.split_once('.').unwrap_or((mantissa, ""));
    let digits = format!("{whole}{fraction}");
    if digits == "0" {
        return format!("{sign}0");
    }
    // The point stands behind the first `point` digits.
    let point = exponent + 1;
    match usize::try_from(point) {
        Ok(point) if point >= digits.len() && point <= 17 => format!("{sign}{digits:0<point$}"),
        Ok(point) if point > 0 && point < digits.len() => {
            format!("{sign}{}.{}", &digits[..point], &digits[point..])
        }
        _ if (-6..=0).contains(&point) => {
            let zeros = "0".repeat(point.unsigned_abs() as usize);
            format!("{sign}0.{zeros}{digits}")
        }
        _ => format!("{sign}{mantissa}e{exponent}"),
    }
}
