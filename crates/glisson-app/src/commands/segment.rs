//! `glisson segment`.

use anyhow::bail;

/// Find the liver in a CT volume.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(_args: &Args) -> anyhow::Result<()> {
    bail!("not built yet")
}
