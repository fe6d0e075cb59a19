//! Text files that verbs write.

use anyhow::Context;
use glisson::files::write_atomically;
use std::io::Write;
use std::path::Path;

/// Writes a text file, whole or not at all.
///
/// # Errors
/// With the file's name.
pub(crate) fn write_text(path: &Path, text: &str) -> anyhow::Result<()> {
    write_atomically(path, |out| out.write_all(text.as_bytes()))
        .with_context(|| format!("{}: cannot write", path.display()))
}
