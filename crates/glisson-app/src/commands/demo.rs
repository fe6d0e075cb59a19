//! `glisson demo`.

use anyhow::bail;

/// From a synthetic patient's image to an organ one can push.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(_args: &Args) -> anyhow::Result<()> {
    bail!("not built yet")
}
