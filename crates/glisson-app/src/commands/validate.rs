//! `glisson validate`.

use anyhow::bail;

/// Reproduce the claims: every experiment with expected and obtained values.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

pub(crate) fn run(_args: &Args) -> anyhow::Result<()> {
    bail!("not built yet")
}
