//! `glisson replay`.

use anyhow::bail;

/// Replay a recorded session and compare the state hash.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(_args: &Args) -> anyhow::Result<()> {
    bail!("not built yet")
}
