//! `glisson serve`.

use anyhow::bail;

/// Serve the viewer and simulate a scene in real time.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(_args: &Args) -> anyhow::Result<()> {
    bail!("not built yet")
}
