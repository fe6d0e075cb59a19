//! Files that were dropped on the page: kept in a folder until they are read.

use anyhow::{Context, ensure};
use std::path::{Path, PathBuf};

/// Of a file's name so many signs count.
const MOST_NAME: usize = 120;
/// Files of one image at most: slices of a long scan in several phases. A choice.
const MOST_FILES: usize = 10_000;

/// The folder of the files that came.
pub(super) struct Upload {
    folder: PathBuf,
}

impl Upload {
    /// Files go to `folder`, which is emptied.
    pub(super) fn new(folder: PathBuf) -> anyhow::Result<Self> {
        let upload = Self { folder };
        upload.clear()?;
        Ok(upload)
    }

    /// Takes a file in.
    pub(super) fn keep(&self, name: &str, bytes: &[u8]) -> anyhow::Result<()> {
        let n_files = std::fs::read_dir(&self.folder).map(Iterator::count).unwrap_or(0);
        ensure!(
            n_files < MOST_FILES,
            "more than {MOST_FILES} files were dropped: drop the folder of one image"
        );
        std::fs::create_dir_all(&self.folder).with_context(|| self.folder.display().to_string())?;
        let path = self.folder.join(safe_name(name));
        std::fs::write(&path, bytes).with_context(|| path.display().to_string())
    }

    /// What is to be read: the only file, the header among files, or the folder.
    pub(super) fn image(&self) -> anyhow::Result<PathBuf> {
        let entries = std::fs::read_dir(&self.folder).into_iter().flatten().flatten();
        let mut files: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
        files.sort();
        let is_header = |path: &&PathBuf| has_extension(path, &["mhd", "nhdr"]);
        match &files[..] {
            [] => anyhow::bail!("no file came: drop a folder or a file of an image"),
            [only] => Ok(only.clone()),
            _ => Ok(files.iter().find(is_header).unwrap_or(&self.folder).clone()),
        }
    }

    /// Deletes what came.
    pub(super) fn clear(&self) -> anyhow::Result<()> {
        match std::fs::remove_dir_all(&self.folder) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                Err(error).with_context(|| self.folder.display().to_string())
            }
            _ => Ok(()),
        }
    }
}

impl Drop for Upload {
    fn drop(&mut self) {
        // Nobody is there to be told.
        let _ = self.clear();
    }
}

fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    path.extension().is_some_and(|found| extensions.iter().any(|name| found.eq_ignore_ascii_case(name)))
}

/// A name that stays in the folder: its last part, with signs that every file system takes.
fn safe_name(name: &str) -> String {
    let last = name.rsplit(['/', '\\']).next().unwrap_or_default();
    let sign = |c: char| if c.is_ascii_alphanumeric() || "._-".contains(c) { c } else { '_' };
    let safe: String = last.chars().map(sign).collect();
    let safe = &safe[safe.len().saturating_sub(MOST_NAME)..];
    match safe.trim_start_matches('.') {
        "" => "file".into(),
        kept => kept.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_stay_in_their_folder_and_go_when_the_page_does() {
        let parent = tempfile::tempdir().unwrap();
        let folder = parent.path().join("incoming");
        let upload = Upload::new(folder.clone()).unwrap();
        assert!(upload.image().is_err());
        for (name, kept) in [
            ("ct.nii.gz", "ct.nii.gz"),
            ("../../etc/passwd", "passwd"),
            ("..", "file"),
            ("a\\b\\IM 1.dcm", "IM_1.dcm"),
            (".hidden", "hidden"),
        ] {
            upload.keep(name, b"x").unwrap();
            assert!(folder.join(kept).is_file(), "{name}");
        }
        assert_eq!(std::fs::read_dir(parent.path()).unwrap().count(), 1);
        assert_eq!(upload.image().unwrap(), folder);
        upload.keep("scan.MHD", b"x").unwrap();
        assert_eq!(upload.image().unwrap(), folder.join("scan.MHD"));
        upload.clear().unwrap();
        upload.keep("only.nrrd", b"x").unwrap();
        assert_eq!(upload.image().unwrap(), folder.join("only.nrrd"));
        drop(upload);
        assert!(!folder.exists());
    }
}
