//! `glisson solve`.

use anyhow::bail;

/// Solve a static case given as files.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(_args: &Args) -> anyhow::Result<()> {
    bail!("not built yet")
}
