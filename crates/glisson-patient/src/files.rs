//! Files that came for an image.

use anyhow::bail;
use std::path::{Path, PathBuf};

/// What is to be read of the files in a folder: the only one, the only header among them, or the folder.
///
/// # Errors
/// A folder without files.
pub fn image_among(folder: &Path) -> anyhow::Result<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    files.sort();
    let headers: Vec<&PathBuf> = files.iter().filter(|path| has_extension(path, &["mhd", "nhdr"])).collect();
    match (&files[..], &headers[..]) {
        ([], _) => bail!("no file came: drop a folder or a file of an image"),
        ([only], _) => Ok(only.clone()),
        (_, [header]) => Ok((*header).clone()),
        _ => Ok(folder.to_owned()),
    }
}

fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    path.extension().is_some_and(|found| extensions.iter().any(|name| found.eq_ignore_ascii_case(name)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_stands_for_its_files_and_many_files_for_their_folder() {
        let folder = tempfile::tempdir().unwrap();
        let here = folder.path();
        assert!(image_among(here).is_err());
        let add = |name: &str| std::fs::write(here.join(name), "x").unwrap();
        add("a.raw");
        assert_eq!(image_among(here).unwrap(), here.join("a.raw"));
        add("b.raw");
        assert_eq!(image_among(here).unwrap(), here);
        add("CT liver.MHD");
        assert_eq!(image_among(here).unwrap(), here.join("CT liver.MHD"));
        add("other.mhd");
        assert_eq!(image_among(here).unwrap(), here);
    }
}
