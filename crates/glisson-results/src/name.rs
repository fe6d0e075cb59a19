//! Names of people and of groups.

/// Letters that a name may have.
pub const LONGEST_NAME: usize = 80;

/// Why a text is no name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NameError {
    /// Nothing, or nothing but spaces.
    #[error("a name is empty; write one of 1 to 80 letters")]
    Empty,
    /// Too long.
    #[error("the name \"{start}...\" has {n} letters; at most 80")]
    TooLong {
        /// How it begins.
        start: String,
        /// Its letters.
        n: usize,
    },
    /// A letter that cannot be printed.
    #[error("the name {name:?} has a letter that is not printed (U+{code:04X}); leave it out")]
    NotPrinted {
        /// The name.
        name: String,
        /// The letter.
        code: u32,
    },
    /// A sign before the first letter: programs for tables take some of them for the beginning of a formula.
    #[error("the name \"{name}\" begins with '{first}'; let it begin with a letter or a digit")]
    Beginning {
        /// The name.
        name: String,
        /// How it begins.
        first: char,
    },
}

/// The name without spaces around it.
///
/// # Errors
/// [`NameError`] where it is none: names are printed, compared, and written into tables.
pub fn checked_name(text: &str) -> Result<String, NameError> {
    let name = text.trim();
    let n = name.chars().count();
    let Some(first) = name.chars().next() else { return Err(NameError::Empty) };
    if n > LONGEST_NAME {
        return Err(NameError::TooLong { start: name.chars().take(20).collect(), n });
    }
    if let Some(letter) = name.chars().find(|letter| !is_printed(*letter)) {
        return Err(NameError::NotPrinted { name: name.into(), code: letter.into() });
    }
    if !first.is_alphanumeric() {
        return Err(NameError::Beginning { name: name.into(), first });
    }
    Ok(name.into())
}

/// Neither a control letter nor one of those without width that make two names look the same or turn lines around.
fn is_printed(letter: char) -> bool {
    let is_hidden = matches!(letter,
        '\u{ad}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}' | '\u{feff}' | '\u{fff9}'..='\u{fffb}');
    !letter.is_control() && !is_hidden
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_trimmed_and_others_are_refused() {
        assert_eq!(checked_name("  Zoë O'Neil-3 (left) \n").unwrap(), "Zoë O'Neil-3 (left)");
        assert_eq!(checked_name(&"ä".repeat(80)).unwrap().chars().count(), 80);
        for (text, expected) in [
            ("", "empty"),
            (" \t", "empty"),
            (&"a".repeat(81), "81 letters; at most 80"),
            ("a\nb", "U+000A"),
            ("a\u{202e}b", "U+202E"),
            ("=1+2", "begins with '='"),
            ("-x", "begins with '-'"),
        ] {
            let error = checked_name(text).unwrap_err().to_string();
            assert!(error.contains(expected), "{text:?}: {error}");
        }
    }
}
