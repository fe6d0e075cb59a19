//! Files that commands write.

use std::path::Path;

use anyhow::{Context, ensure};

/// Refuses a name whose extension is not one of `allowed`, given in lower case and without dots.
pub(crate) fn check_extension(path: &Path, allowed: &[&str]) -> anyhow::Result<()> {
    let found = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    let listed = allowed.join(", .");
    let known = allowed.contains(&found.as_str());
    ensure!(known, "{}: found the extension `{found}`, allowed: .{listed}", path.display());
    Ok(())
}

/// Makes the folder that a file is to be written into.
pub(crate) fn make_folder_of(path: &Path) -> anyhow::Result<()> {
    let Some(folder) = path.parent() else { return Ok(()) };
    std::fs::create_dir_all(folder).with_context(|| format!("cannot make folder {}", folder.display()))
}
