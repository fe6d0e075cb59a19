//! Writes a session while it happens: into `FILE.partial`, renamed to `FILE` at the end, so that a crash loses at
//! most the last second and never an older recording. Beside it stands `FILE.partial.folder` with the folder of the scene's files.
//!
//! Who writes has the file locked. One that nobody has locked was cut off: it is set aside before a new one begins.

use anyhow::{Context, bail};
use glisson::record::session::{SessionEvent, SessionHeader, SessionWriter};
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// What a session's file is called while it is written.
pub fn partial_of(session: &Path) -> PathBuf {
    with_ending(session, ".partial")
}

/// Where the folder of its scene's files stands meanwhile.
fn folder_file_of(partial: &Path) -> PathBuf {
    with_ending(partial, ".folder")
}

fn with_ending(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(ending);
    PathBuf::from(name)
}

/// Whether somebody writes to this partial session now.
pub fn is_being_written(partial: &Path) -> bool {
    File::open(partial).is_ok_and(|file| matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock)))
}

/// The folder that the scene's files of a partial session are relative to, as its recorder left it.
pub fn folder_of_partial(partial: &Path) -> Option<PathBuf> {
    std::fs::read_to_string(folder_file_of(partial)).ok().map(|text| PathBuf::from(text.trim_end()))
}

/// Gives a partial session that was cut off a name of its own, so that nothing overwrites it and nobody is asked for it again.
///
/// # Errors
/// When it cannot be renamed.
pub fn set_aside(session: &Path) -> anyhow::Result<PathBuf> {
    let partial = partial_of(session);
    let stem = session.file_stem().unwrap_or_default().to_string_lossy();
    let kept = (1..)
        .map(|number| if number == 1 { String::new() } else { format!("-{number}") })
        .map(|number| session.with_file_name(format!("{stem}-interrupted{number}.jsonl")))
        .find(|kept| !kept.exists())
        .expect("numbers do not end");
    std::fs::rename(&partial, &kept)
        .with_context(|| format!("{}: cannot rename to {}", partial.display(), kept.display()))?;
    // It tells nothing any more; where it stays, the next recording writes it anew.
    let _ = std::fs::remove_file(folder_file_of(&partial));
    Ok(kept)
}

/// Forgets a partial session that nobody wants.
pub fn remove_partial(session: &Path) {
    let partial = partial_of(session);
    for file in [folder_file_of(&partial), partial] {
        // Mostly it was not begun yet.
        let _ = std::fs::remove_file(file);
    }
}

pub(crate) struct Recorder {
    writer: SessionWriter<BufWriter<File>>,
    partial: PathBuf,
    path: PathBuf,
    /// Whether anything was written since the last flush.
    is_dirty: bool,
    last_checkpoint: Option<u64>,
}

impl Recorder {
    /// Begins with `header` and the events that were before; `folder`: that of the scene's files.
    pub(crate) fn create(
        path: &Path,
        folder: &Path,
        header: &SessionHeader,
        before: &[SessionEvent],
    ) -> anyhow::Result<Self> {
        let partial = partial_of(path);
        if let Some(folder) = path.parent().filter(|folder| *folder != Path::new("")) {
            std::fs::create_dir_all(folder)
                .with_context(|| format!("{}: cannot make the folder", folder.display()))?;
        }
        let mut file = locked(&partial)?;
        if file.metadata().is_ok_and(|about| about.is_file() && about.len() > 0) {
            set_aside(path)?;
            file = locked(&partial)?;
        }
        let cannot = || format!("{}: cannot write", partial.display());
        let folder = std::fs::canonicalize(folder).unwrap_or_else(|_| folder.to_path_buf());
        std::fs::write(folder_file_of(&partial), folder.display().to_string()).with_context(cannot)?;
        let writer = SessionWriter::new(BufWriter::new(file), header).with_context(cannot)?;
        let mut recorder =
            Self { writer, partial, path: path.to_path_buf(), is_dirty: true, last_checkpoint: None };
        before.iter().try_for_each(|event| recorder.write(event))?;
        recorder.flush()?;
        Ok(recorder)
    }

    pub(crate) fn write(&mut self, event: &SessionEvent) -> anyhow::Result<()> {
        self.is_dirty = true;
        if let SessionEvent::Checkpoint { step, .. } = event {
            self.last_checkpoint = Some(*step);
        }
        self.writer.write(event).with_context(|| format!("{}: cannot write", self.partial.display()))
    }

    /// From here on a crash of the program loses nothing of what was written.
    pub(crate) fn flush(&mut self) -> anyhow::Result<()> {
        if std::mem::take(&mut self.is_dirty) {
            self.writer.flush().with_context(|| format!("{}: cannot write", self.partial.display()))?;
        }
        Ok(())
    }

    /// The step of the last check-point.
    pub(crate) fn last_checkpoint(&self) -> Option<u64> {
        self.last_checkpoint
    }

    /// Where it is written.
    pub(crate) fn partial(&self) -> &Path {
        &self.partial
    }

    pub(crate) fn finish(self) -> anyhow::Result<()> {
        let partial = &self.partial;
        let mut out = self.writer.into_inner();
        out.flush()
            .and_then(|()| out.get_ref().sync_all())
            .and_then(|()| std::fs::rename(partial, &self.path))
            .with_context(|| format!("{}: cannot complete the session", self.path.display()))?;
        // It is of use to a session that was cut off only.
        let _ = std::fs::remove_file(folder_file_of(partial));
        Ok(())
    }
}

/// A file that this program alone writes to, with what was in it.
fn locked(partial: &Path) -> anyhow::Result<File> {
    let opened = OpenOptions::new().write(true).create(true).truncate(false).open(partial);
    let file = opened.with_context(|| format!("{}: cannot record the session there", partial.display()))?;
    match file.try_lock() {
        Err(TryLockError::WouldBlock) => {
            bail!("{}: another program is recording a session there; give another file", partial.display())
        }
        // A file system without locks records all the same.
        Ok(()) | Err(TryLockError::Error(_)) => Ok(file),
    }
}
