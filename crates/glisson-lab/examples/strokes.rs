//! Random strokes of scalpel, scissors and hook, for every model and law: the table of `glisson validate strokes`, or a part of it,
//! a line as soon as it is known.
//!
//! ```text
//! cargo run --release -p glisson-lab --example strokes -- --models explicit,implicit --seeds 0,6 --tets 6300
//! ```
#![expect(clippy::print_stdout, reason = "a program that prints a table")]

use anyhow::{Context, bail};
use glisson_lab::validate::strokes::{Selection, write_cases};
use std::io::Write as _;

fn main() -> anyhow::Result<()> {
    let mut selection = Selection::default();
    let mut arguments = std::env::args().skip(1);
    while let Some(name) = arguments.next() {
        let value = arguments.next().with_context(|| format!("{name} needs a value"))?;
        match name.as_str() {
            "--models" => selection.models = value.split(',').map(str::to_owned).collect(),
            "--tets" => selection.n_tets = value.parse()?,
            "--seeds" => {
                let (first, n) = value.split_once(',').context("--seeds FIRST,HOW_MANY")?;
                (selection.first_seed, selection.n_cases) = (first.parse()?, n.parse()?);
            }
            _ => bail!("{name}: there are --models, --seeds FIRST,HOW_MANY, --tets"),
        }
    }
    write_cases(&selection, &mut |text| {
        print!("{text}");
        // A table that cannot be written is nobody's.
        let _ = std::io::stdout().flush();
    })
}
