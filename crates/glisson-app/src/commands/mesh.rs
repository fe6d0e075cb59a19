//! `glisson mesh`.

use anyhow::bail;

/// Turn a label map or a closed surface into a tetrahedral mesh.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(_args: &Args) -> anyhow::Result<()> {
    bail!("not built yet")
}
