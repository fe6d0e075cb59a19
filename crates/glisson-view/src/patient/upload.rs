//! Files that come by the page: each image in a folder of its own until it is read.

use anyhow::{Context, ensure};
use glisson_patient::image_among;
use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Files of one image at most: slices of a long scan in several phases. A choice.
const MOST_FILES: usize = 10_000;
/// Bytes of a file at most: more than any scan has. A choice.
const MOST_BYTES: u64 = 64 << 30;
/// Bytes of a name at most, with room for a number before it: what file systems take.
const MOST_NAME: usize = 200;

/// Where the files come to. One image after the other: what comes late for an earlier one is refused.
pub(super) struct Upload {
    folder: PathBuf,
    /// Number of the image that comes now, and how many files of it came.
    current: Mutex<(u64, usize)>,
}

impl Upload {
    /// Files go to folders in `folder`, which this program alone has.
    pub(super) fn new(folder: PathBuf) -> Self {
        Self { folder, current: Mutex::new((0, 0)) }
    }

    /// A new image begins; answers its number. What came before is deleted, unless it is in use: its page may be gone.
    pub(super) fn begin(&self, in_use: Option<u64>) -> u64 {
        let mut current = self.current.lock().unwrap_or_else(PoisonError::into_inner);
        if in_use != Some(current.0) {
            self.forget(current.0);
        }
        *current = (current.0 + 1, 0);
        current.0
    }

    fn folder_of(&self, image: u64) -> PathBuf {
        self.folder.join(image.to_string())
    }

    /// A file of an image, to be written as it comes.
    pub(super) fn create(&self, image: u64, name: &str) -> anyhow::Result<IncomingFile> {
        let number = {
            let mut current = self.current.lock().unwrap_or_else(PoisonError::into_inner);
            ensure!(current.0 == image, "another image is being sent since");
            ensure!(current.1 < MOST_FILES, "more than {MOST_FILES} files came: send those of one image");
            current.1 += 1;
            current.1
        };
        let folder = self.folder_of(image);
        std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
        let name = safe_name(name);
        let create = |name: &str| {
            let path = folder.join(name);
            OpenOptions::new().write(true).create_new(true).open(&path).map(|file| (file, path))
        };
        // Slices in several folders may have the same names.
        let created = create(&name).or_else(|_| create(&format!("{number}_{name}")));
        let (file, path) = created.with_context(|| folder.display().to_string())?;
        Ok(IncomingFile { file, path, n_bytes: 0, is_whole: false })
    }

    /// What is to be read of an image.
    pub(super) fn image(&self, image: u64) -> anyhow::Result<PathBuf> {
        image_among(&self.folder_of(image))
    }

    /// Deletes what came of an image.
    pub(super) fn forget(&self, image: u64) {
        delete(&self.folder_of(image));
    }

    /// Deletes all that came.
    pub(super) fn forget_all(&self) {
        delete(&self.folder);
    }
}

/// A file that is coming; deleted unless it comes as a whole.
pub(super) struct IncomingFile {
    file: File,
    path: PathBuf,
    n_bytes: u64,
    is_whole: bool,
}

impl IncomingFile {
    /// It came as a whole.
    pub(super) fn keep(mut self) {
        self.is_whole = true;
    }
}

impl Write for IncomingFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let n_written = self.file.write(bytes)?;
        self.n_bytes += n_written as u64;
        if self.n_bytes > MOST_BYTES {
            return Err(io::Error::other(format!("a file of more than {MOST_BYTES} bytes came")));
        }
        Ok(n_written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Drop for IncomingFile {
    fn drop(&mut self) {
        if !self.is_whole {
            // Where it cannot be deleted, it goes with its folder.
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

impl Drop for Upload {
    fn drop(&mut self) {
        self.forget_all();
    }
}

/// Deletes a folder; where it is not there, or cannot be deleted, nobody is there to be told.
fn delete(folder: &Path) {
    let _ = std::fs::remove_dir_all(folder);
}

/// A name that stays in the folder: its last part, as headers name the files of their numbers.
fn safe_name(name: &str) -> String {
    let last = name.rsplit(['/', '\\']).next().unwrap_or_default();
    let kept: String = last.chars().filter(|c| !c.is_control()).collect();
    let mut kept = kept.trim_start_matches('.');
    while kept.len() > MOST_NAME {
        kept = &kept[kept.char_indices().nth(1).map_or(kept.len(), |(at, _)| at)..];
    }
    if kept.is_empty() { "file".into() } else { kept.into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keep(upload: &Upload, image: u64, name: &str) -> anyhow::Result<()> {
        let mut file = upload.create(image, name)?;
        file.write_all(b"x")?;
        file.keep();
        Ok(())
    }

    #[test]
    fn files_stay_in_their_folder_and_go_when_the_page_does() {
        let parent = tempfile::tempdir().unwrap();
        let folder = parent.path().join("incoming");
        let upload = Upload::new(folder.clone());
        let first = upload.begin(None);
        assert!(upload.image(first).is_err());
        let long = format!("{}.dcm", "n".repeat(300));
        for (name, kept) in [
            ("ct.nii.gz", "ct.nii.gz"),
            ("../../etc/passwd", "passwd"),
            ("..", "file"),
            ("a\\b\\Bild ä.dcm", "Bild ä.dcm"),
            (".hidden", "hidden"),
            (&long, &long[104..]),
        ] {
            keep(&upload, first, name).unwrap();
            assert!(folder.join("1").join(kept).is_file(), "{name}");
        }
        assert_eq!(std::fs::read_dir(parent.path()).unwrap().count(), 1);
        assert_eq!(upload.image(first).unwrap(), folder.join("1"));
        keep(&upload, first, "CT liver.MHD").unwrap();
        assert_eq!(upload.image(first).unwrap(), folder.join("1/CT liver.MHD"));
        keep(&upload, first, "other.mhd").unwrap();
        assert_eq!(upload.image(first).unwrap(), folder.join("1"));
        // The same name again is another file.
        keep(&upload, first, "passwd").unwrap();
        assert_eq!(std::fs::read_dir(folder.join("1")).unwrap().count(), 9);

        // What breaks off is not kept.
        drop(upload.create(first, "half").unwrap());
        assert!(!folder.join("1/half").exists());

        let second = upload.begin(Some(first));
        assert!(keep(&upload, first, "late").is_err());
        keep(&upload, second, "only.nrrd").unwrap();
        assert_eq!(upload.image(second).unwrap(), folder.join("2/only.nrrd"));
        upload.forget(second);
        assert!(!folder.join("2").exists() && folder.join("1").exists());
        keep(&upload, second, "left").unwrap();
        let third = upload.begin(Some(first));
        assert!(!folder.join("2").exists() && folder.join("1").exists());
        assert!(upload.begin(None) > third);
        drop(upload);
        assert!(!folder.exists());
    }
}
