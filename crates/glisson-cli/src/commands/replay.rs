//! `glisson replay`.

use super::task_text::task_text;
use anyhow::bail;
use glisson_runtime::replay;
use std::path::{Path, PathBuf};

/// Replay a recorded session and compare the state hash.
///
/// Exit code 0 when the replay made the same bits as the recording, 1 when it did not.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  glisson replay out/demo/session.jsonl\n  \
    glisson replay session.jsonl --folder folder/of/the/scene")]
pub(crate) struct Args {
    /// Session file (JSON lines)
    session: PathBuf,
    /// Folder that the scene's files are relative to; the session's own folder if not given
    #[arg(long, value_name = "DIR")]
    folder: Option<PathBuf>,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let session = replay::read_session(&args.session)?;
    let own_folder = args.session.parent().filter(|folder| *folder != Path::new(""));
    let own_folder = own_folder.unwrap_or(Path::new("."));
    let folder = args.folder.as_deref().unwrap_or(own_folder);
    let report = replay::replay(&session, folder, |_| Ok(()))?;
    println!("steps            {}", report.steps);
    print!("{}", report.account.to_text());
    if let Some(task) = &report.task {
        print!("{}", task_text(&task.result()));
    }
    println!("state hash       {}", report.state_hash);
    println!("check-points     {} compared", report.checkpoints);
    if let Some(step) = report.first_difference {
        bail!("the replay differs from the recording: first at the check-point of step {step}");
    }
    match report.recorded_hash {
        Some(recorded) if recorded == report.state_hash => println!("same bits as the recording"),
        Some(recorded) => bail!("the replay differs from the recording, whose last state hash is {recorded}"),
        None => println!("the recording was cut off: nothing to compare the last state with"),
    }
    Ok(())
}
