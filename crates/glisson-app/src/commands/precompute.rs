//! `glisson precompute`.

use anyhow::bail;

/// Compute and save the compliance of a mesh for the pre-computed model.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(_args: &Args) -> anyhow::Result<()> {
    bail!("not built yet")
}
