//! Going on with a session that was cut off, from the command line.

use anyhow::ensure;
use glisson_runtime::cut_off::{CutOff, go_on_with};
use glisson_runtime::replay::read_session;
use glisson_runtime::{OpenScene, Simulation};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// The scene, recorded in `record`: from its beginning, or from where `resume` was cut off. Says what was cut off there before.
pub(super) fn open_recorded(
    source: OpenScene,
    record: &Path,
    resume: Option<&Path>,
) -> anyhow::Result<Simulation> {
    let Some(file) = resume else {
        if let Some(cut_off) = CutOff::of(record) {
            offer(&cut_off);
        }
        return Simulation::open(source, Some(record));
    };
    let session = read_session(file)?;
    ensure!(
        session.header.scene == source.scene.text,
        "{}: it is a session of another scene than {}, or the scene was changed since",
        file.display(),
        source.origin
    );
    let begun = Instant::now();
    println!("{}: replaying the session up to where it was cut off", file.display());
    let simulation = go_on_with(file, Some(&source.folder), record, source.n_threads)?;
    println!(
        "it goes on from {:.1} s (replayed in {:.1} s), and stands still until the page lets time pass",
        simulation.world().time_s(),
        begun.elapsed().as_secs_f64()
    );
    Ok(simulation)
}

/// A line on how to go on with a session that was cut off.
pub(super) fn offer(cut_off: &CutOff) {
    let file: PathBuf = cut_off.partial();
    println!("{}", cut_off.to_text());
    println!("  to go on with it: the same command with --resume {}", file.display());
    println!(
        "  (a new session under this name leaves it beside, with \"-interrupted\" in its name: then give that one)"
    );
}
