//! `glisson phantom`.

use anyhow::bail;

/// Write a synthetic patient: a portal-phase CT of an upper abdomen and its true label map.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(_args: &Args) -> anyhow::Result<()> {
    bail!("not built yet")
}
