//! Random violent motions of a hand, for every model and law: the table of `glisson validate rough_hands`, or a part of it, a
//! line as soon as it is known.
//!
//! ```text
//! cargo run --release -p glisson-lab --example rough_hands -- \
//!     --models explicit,implicit --laws stable_neo_hooke --seeds 0,6 --limits 1,10 --tets 2000
//! ```
#![expect(clippy::print_stdout, reason = "a program that prints a table")]

use anyhow::{Context, bail};
use glisson_lab::validate::rough_hands::{Selection, write_motions};
use std::io::Write as _;
use std::str::FromStr;

fn numbers<T: FromStr>(list: &str) -> anyhow::Result<Vec<T>> {
    let number = |text: &str| text.parse().ok().with_context(|| format!("{text:?} is no such number"));
    list.split(',').map(number).collect()
}

fn main() -> anyhow::Result<()> {
    let mut selection = Selection::default();
    let mut arguments = std::env::args().skip(1);
    while let Some(name) = arguments.next() {
        let value = arguments.next().with_context(|| format!("{name} needs a value"))?;
        let names = || value.split(',').map(str::to_owned).collect();
        match name.as_str() {
            "--models" => selection.models = names(),
            "--laws" => selection.laws = names(),
            "--limits" => selection.limits = numbers(&value)?,
            "--tets" => selection.n_tets = value.parse()?,
            "--seeds" => {
                let [first, n] = numbers(&value)?[..] else { bail!("--seeds FIRST,HOW_MANY") };
                (selection.first_seed, selection.n_motions) = (first, n);
            }
            _ => bail!("{name}: there are --models, --laws, --limits, --seeds FIRST,HOW_MANY, --tets"),
        }
    }
    write_motions(&selection, &mut |text| {
        print!("{text}");
        // A table that cannot be written is nobody's.
        let _ = std::io::stdout().flush();
    })
}
