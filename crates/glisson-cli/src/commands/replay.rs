//! `glisson replay`.

use super::task_text::task_text;
use anyhow::bail;
use glisson::record::session::Session;
use glisson_runtime::replay::{self, ReplayReport};
use std::path::{Path, PathBuf};

/// Replay a recorded session and compare the state hash.
///
/// Exit code 0 when the replay made the same bits as the recording, 1 when it did not. A session that was recorded in a browser may have
/// other bits than the program makes (docs/local.md): then that is said, with exit code 0.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  glisson replay out/demo/session.jsonl\n  \
    glisson replay session.jsonl --folder folder/of/the/scene")]
pub(crate) struct Args {
    #[command(flatten)]
    source: Source,
}

/// A recorded session and where its scene is.
#[derive(Debug, clap::Args)]
pub(crate) struct Source {
    /// Session file (JSON lines)
    session: PathBuf,
    /// Folder that the scene's files are relative to; the session's own folder if not given
    #[arg(long, value_name = "DIR")]
    folder: Option<PathBuf>,
}

impl Source {
    pub(super) fn read(&self) -> anyhow::Result<Session> {
        replay::read_session(&self.session)
    }

    pub(super) fn session(&self) -> &Path {
        &self.session
    }

    /// What the session is called: its file without an ending.
    pub(super) fn name(&self) -> String {
        self.session.file_stem().unwrap_or_default().to_string_lossy().into_owned()
    }

    /// Another session, whose scene is in the same folder where one was given.
    pub(super) fn beside(&self, session: &Path) -> Self {
        Self { session: session.to_path_buf(), folder: self.folder.clone() }
    }

    pub(super) fn folder(&self) -> &Path {
        let own_folder = self.session.parent().filter(|folder| *folder != Path::new(""));
        self.folder.as_deref().or(own_folder).unwrap_or(Path::new("."))
    }
}

/// What is to be said of a replay that made the bits of the recording.
pub(super) fn same_bits(report: &ReplayReport) -> anyhow::Result<&'static str> {
    let differs = report.recorded_hash.is_some_and(|recorded| recorded != report.state_hash);
    if report.other_arithmetic.is_some() && (differs || report.first_difference.is_some()) {
        return Ok(
            "other bits, as between a browser and a program: the session was recorded in another arithmetic",
        );
    }
    if let Some(step) = report.first_difference {
        bail!("the replay differs from the recording: first at the check-point of step {step}");
    }
    match report.recorded_hash {
        Some(recorded) if recorded == report.state_hash => Ok("same bits as the recording"),
        Some(recorded) => bail!("the replay differs from the recording, whose last state hash is {recorded}"),
        None => Ok("the recording was cut off: nothing to compare the last state with"),
    }
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let session = args.source.read()?;
    let report = replay::replay(&session, args.source.folder(), |_| Ok(()))?;
    println!("steps            {}", report.steps);
    print!("{}", report.account.to_text());
    if let Some(task) = &report.task {
        print!("{}", task_text(&task.result()));
    }
    println!("state hash       {}", report.state_hash);
    println!("check-points     {} compared", report.checkpoints);
    println!("{}", same_bits(&report)?);
    Ok(())
}
