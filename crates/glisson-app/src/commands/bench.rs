//! `glisson bench`.

use anyhow::bail;

/// Measure speed: CPU time, medians, beside the machine's peak.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(_args: &Args) -> anyhow::Result<()> {
    bail!("not built yet")
}
