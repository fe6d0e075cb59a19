//! Writes a session while it happens: into `FILE.partial`, renamed to `FILE` at the end, so that a crash loses at
//! most the last second and never an older recording.

use anyhow::Context;
use glisson::record::session::{SessionEvent, SessionHeader, SessionWriter};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

pub(crate) struct Recorder {
    writer: SessionWriter<BufWriter<File>>,
    partial: PathBuf,
    path: PathBuf,
}

impl Recorder {
    pub(crate) fn create(path: &Path, scene_text: &str, mesh_hash: String) -> anyhow::Result<Self> {
        let mut partial = path.as_os_str().to_owned();
        partial.push(".partial");
        let partial = PathBuf::from(partial);
        if let Some(folder) = path.parent().filter(|folder| *folder != Path::new("")) {
            std::fs::create_dir_all(folder)
                .with_context(|| format!("{}: cannot make the folder", folder.display()))?;
        }
        let file = File::create(&partial)
            .with_context(|| format!("{}: cannot record the session there", partial.display()))?;
        let header = SessionHeader::new(scene_text.to_string(), mesh_hash);
        let writer = SessionWriter::new(BufWriter::new(file), &header)
            .with_context(|| format!("{}: cannot write", partial.display()))?;
        Ok(Self { writer, partial, path: path.to_path_buf() })
    }

    pub(crate) fn write(&mut self, event: &SessionEvent) -> anyhow::Result<()> {
        self.writer.write(event).with_context(|| format!("{}: cannot write", self.partial.display()))
    }

    pub(crate) fn finish(self) -> anyhow::Result<()> {
        let partial = &self.partial;
        let mut out = self.writer.into_inner();
        out.flush()
            .and_then(|()| out.get_ref().sync_all())
            .and_then(|()| std::fs::rename(partial, &self.path))
            .with_context(|| format!("{}: cannot complete the session", self.path.display()))
    }
}
