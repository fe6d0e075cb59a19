//! `glisson run`.

use anyhow::bail;

/// Run a scene without a window and record the session.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(_args: &Args) -> anyhow::Result<()> {
    bail!("not built yet")
}
