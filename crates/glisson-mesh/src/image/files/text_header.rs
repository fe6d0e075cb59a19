//! Headers of lines with a key and a value each, as NRRD, MetaImage and INRIMAGE have them.

use std::path::{Path, PathBuf};

use super::error::{HeaderPlace, ImageError};
use crate::binary::{ByteOrder, NumberType};
use crate::text::did_you_mean;

/// A header is looked for in so many bytes at the beginning of a file.
pub(super) const MAX_HEADER_BYTES: usize = 1 << 20;

/// Most bytes that the numbers of an image may take: sums and products of counts stay far from overflow.
const MAX_DATA_BYTES: u64 = 1 << 48;

/// A line of a header.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Field {
    /// As written.
    pub(super) key: String,
    pub(super) value: String,
    /// From 1.
    pub(super) line: usize,
}

/// The lines of a header.
#[derive(Debug)]
pub(super) struct TextHeader {
    pub(super) file: PathBuf,
    pub(super) fields: Vec<Field>,
}

impl TextHeader {
    pub(super) fn new(file: &Path) -> Self {
        Self { file: file.to_path_buf(), fields: Vec::new() }
    }

    pub(super) fn add(&mut self, key: &str, value: &str, line: usize) {
        self.fields.push(Field { key: key.trim().into(), value: value.trim().into(), line });
    }

    /// The first field of a key, in upper or lower case.
    pub(super) fn get(&self, key: &str) -> Option<&Field> {
        self.fields.iter().find(|field| field.key.eq_ignore_ascii_case(key))
    }

    /// The first field that has one of these keys: the names that a format had for the same in its history.
    pub(super) fn first_of(&self, keys: &[&str]) -> Option<&Field> {
        keys.iter().find_map(|key| self.get(key))
    }

    pub(super) fn required(&self, key: &str) -> Result<&Field, ImageError> {
        self.get(key).ok_or_else(|| self.missing(key))
    }

    /// A field that the format asks for and the header lacks.
    pub(super) fn missing(&self, key: &str) -> ImageError {
        ImageError::Header {
            file: self.file.clone(),
            field: key.into(),
            place: HeaderPlace::Whole,
            found: "missing".into(),
            allowed: "one line with it".into(),
        }
    }

    pub(super) fn wrong(&self, field: &Field, allowed: impl Into<String>) -> ImageError {
        ImageError::Header {
            file: self.file.clone(),
            field: field.key.clone(),
            place: HeaderPlace::Line(field.line),
            found: format!("\"{}\"", shortened(&field.value)),
            allowed: allowed.into(),
        }
    }

    /// The finite numbers of a field, blanks between them.
    pub(super) fn numbers<const N: usize>(&self, field: &Field) -> Result<[f64; N], ImageError> {
        let numbers: Option<Vec<f64>> = field
            .value
            .split_whitespace()
            .map(|word| word.parse::<f64>().ok().filter(|number| number.is_finite()))
            .collect();
        let numbers = numbers.and_then(|list| <[f64; N]>::try_from(list).ok());
        numbers.ok_or_else(|| self.wrong(field, format!("{N} finite numbers with blanks between them")))
    }

    /// A whole number from `least` to `most`.
    pub(super) fn whole(&self, field: &Field, least: i64, most: i64) -> Result<i64, ImageError> {
        let number = field.value.parse::<i64>().ok().filter(|number| (least..=most).contains(number));
        number.ok_or_else(|| self.wrong(field, format!("a whole number from {least} to {most}")))
    }

    /// Numbers of voxels, whose product with eight bytes each is below [`MAX_DATA_BYTES`].
    pub(super) fn sizes(&self, field: &Field, n: usize) -> Result<Vec<usize>, ImageError> {
        let sizes: Option<Vec<usize>> = field
            .value
            .split_whitespace()
            .map(|word| word.parse::<usize>().ok().filter(|&size| (1..=1 << 24).contains(&size)))
            .collect();
        let sizes = sizes.filter(|sizes| sizes.len() == n).filter(|sizes| {
            let n_bytes = sizes.iter().try_fold(8u64, |product, &size| product.checked_mul(size as u64));
            n_bytes.is_some_and(|n_bytes| n_bytes <= MAX_DATA_BYTES)
        });
        sizes.ok_or_else(|| {
            self.wrong(field, format!("{n} numbers of voxels from 1 to {}, together below 2^45", 1 << 24))
        })
    }

    /// What a word of a list stands for.
    pub(super) fn chosen<T: Copy>(&self, field: &Field, list: &[(&str, T)]) -> Result<T, ImageError> {
        let found = list.iter().find(|(word, _)| field.value.eq_ignore_ascii_case(word));
        found.map(|(_, meaning)| *meaning).ok_or_else(|| {
            let words: Vec<&str> = list.iter().map(|(word, _)| *word).collect();
            let hint = did_you_mean(&field.value, &words);
            self.wrong(field, format!("{}{hint}", words.join(", ")))
        })
    }
}

/// The beginning of a value for a message.
fn shortened(value: &str) -> String {
    const N_SHOWN: usize = 60;
    match value.char_indices().nth(N_SHOWN) {
        Some((at, _)) => format!("{}...", &value[..at]),
        None => value.to_owned(),
    }
}

/// The next line from byte `at`, without its end, and where the one after it begins; none at the end of the bytes.
pub(super) fn line_at(bytes: &[u8], at: usize) -> Option<(&[u8], usize)> {
    let rest = bytes.get(at..).filter(|rest| !rest.is_empty())?;
    let (length, next) = match rest.iter().position(|&b| b == b'\n') {
        Some(end) => (end, at + end + 1),
        None => (rest.len(), bytes.len()),
    };
    Some((rest[..length].strip_suffix(b"\r").unwrap_or(&rest[..length]), next))
}

/// As many numbers as `n` written as text, as the bytes of numbers of eight bytes: what `stored` holds.
///
/// # Errors
/// A word that is no number, or another number of them, told by `wrong` (found, allowed).
pub(super) fn numbers_in_text(
    bytes: &[u8],
    n: usize,
    wrong: impl Fn(String, String) -> ImageError,
) -> Result<(NumberType, ByteOrder, Vec<u8>), ImageError> {
    // A number and a blank take two bytes: memory follows the text that is there.
    if n > bytes.len().div_ceil(2) {
        return Err(wrong(format!("{} bytes of text", bytes.len()), format!("{n} numbers")));
    }
    let mut numbers = Vec::with_capacity(8 * n);
    for word in bytes.split(|b| b.is_ascii_whitespace() || *b == b',').filter(|word| !word.is_empty()) {
        let number = std::str::from_utf8(word).ok().and_then(|word| word.parse::<f64>().ok());
        let Some(number) = number else {
            let found = String::from_utf8_lossy(&word[..word.len().min(40)]).into_owned();
            return Err(wrong(format!("\"{found}\""), "numbers".into()));
        };
        numbers.extend(number.to_le_bytes());
    }
    match numbers.len() == 8 * n {
        true => Ok((NumberType::F64, ByteOrder::Little, numbers)),
        false => Err(wrong(format!("{} numbers", numbers.len() / 8), format!("{n}"))),
    }
}

/// The file that a header names, which has to lie in the header's folder or below it.
pub(super) fn beside(header: &TextHeader, field: &Field) -> Result<PathBuf, ImageError> {
    let name = Path::new(&field.value);
    let is_inside = name
        .components()
        .all(|part| matches!(part, std::path::Component::Normal(_) | std::path::Component::CurDir));
    if !is_inside || field.value.is_empty() {
        return Err(header.wrong(field, "the name of a file in the header's folder"));
    }
    Ok(header.file.parent().unwrap_or(Path::new("")).join(name))
}
