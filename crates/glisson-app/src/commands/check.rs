//! `glisson check`.

use anyhow::bail;

/// Report the quality of a mesh or surface file.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(_args: &Args) -> anyhow::Result<()> {
    bail!("not built yet")
}
