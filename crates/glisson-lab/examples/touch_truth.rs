//! Balls pressed into blocks of every model and size, against the axisymmetric reference, or into livers (`--livers`),
//! or drawn over tissue (`--slides`): the table of `glisson validate touch_truth`, `touch_truth_livers` or `touch_sliding`, or a part of it, a line as soon as it is known.
//!
//! ```text
//! cargo run --release -p glisson-lab --example touch_truth -- \
//!     --models implicit,precomputed --sizes 2000,6300 --balls 3,10 --places 3 --most-explicit 50000
//! ```
#![expect(clippy::print_stdout, reason = "a program that prints a table")]

use anyhow::{Context, bail};
use glisson_lab::validate::touch_truth::{Selection, write_blocks, write_livers, write_slides};
use std::io::Write as _;

type WriteAll = fn(&Selection, &mut dyn FnMut(&str)) -> anyhow::Result<()>;

fn numbers(list: &str) -> anyhow::Result<Vec<f64>> {
    list.split(',').map(|text| text.parse().with_context(|| format!("{text:?} is no number"))).collect()
}

fn main() -> anyhow::Result<()> {
    let mut selection = Selection::default();
    let mut arguments = std::env::args().skip(1);
    let mut write_all: WriteAll = write_blocks;
    while let Some(name) = arguments.next() {
        let other: Option<WriteAll> = match name.as_str() {
            "--livers" => Some(write_livers),
            "--slides" => Some(write_slides),
            _ => None,
        };
        if let Some(other) = other {
            write_all = other;
            continue;
        }
        let value = arguments.next().with_context(|| format!("{name} needs a value"))?;
        match name.as_str() {
            "--models" => selection.models = value.split(',').map(str::to_owned).collect(),
            "--sizes" => selection.sizes = numbers(&value)?.into_iter().map(|x| x as usize).collect(),
            "--balls" => selection.balls_m = numbers(&value)?.into_iter().map(|x| x * 1e-3).collect(),
            "--places" => selection.n_places = value.parse()?,
            "--most-explicit" => selection.most_explicit = value.parse()?,
            _ => bail!(
                "{name}: there are --livers, --slides, --models, --sizes, --balls [mm], --places, --most-explicit"
            ),
        }
    }
    write_all(&selection, &mut |text| {
        print!("{text}");
        // A table that cannot be written is nobody's.
        let _ = std::io::stdout().flush();
    })
}
