//! The implicit step at several sizes beside other simulators; `cargo xtask peers` builds those and calls this.
//!
//! ```text
//! cargo run --release -p glisson-lab --example peers -- \
//!     --sizes 2000,6300 --seconds 5 --folder target/peers --docs docs \
//!     --peer "rapier3d" --step-ms 10 --command $PWD/target/peers/release/peer-rapier
//! ```
//! Every `--peer` is followed by its `--step-ms` and by one `--command` for the program and for each of its first arguments.
#![expect(clippy::print_stdout, reason = "a program that tells what it does")]

use anyhow::{Context, bail};
use glisson_lab::bench::peers::{Peer, PeersRequest, measure_peers};
use std::path::PathBuf;

fn main() -> anyhow::Result<()> {
    let mut request = PeersRequest {
        sizes: Vec::new(),
        seconds: 10.0,
        peers: Vec::new(),
        folder: PathBuf::from("target/peers"),
    };
    let mut docs = PathBuf::from("docs");
    let mut arguments = std::env::args().skip(1);
    while let Some(name) = arguments.next() {
        let value = arguments.next().with_context(|| format!("{name} needs a value"))?;
        let number = |text: &str| text.parse::<f64>().with_context(|| format!("{name} {text}: no number"));
        match name.as_str() {
            "--sizes" => {
                let sizes = value.split(',').map(str::parse).collect::<Result<_, _>>();
                request.sizes = sizes.with_context(|| format!("--sizes {value}: numbers of tetrahedra"))?;
            }
            "--seconds" => request.seconds = number(&value)?,
            "--folder" => request.folder = PathBuf::from(value),
            "--docs" => docs = PathBuf::from(value),
            "--peer" => request.peers.push(Peer { name: value, step_s: 0.01, command: Vec::new() }),
            "--step-ms" | "--command" => {
                let step_s = if name == "--step-ms" { Some(1e-3 * number(&value)?) } else { None };
                let peer =
                    request.peers.last_mut().with_context(|| format!("{name} belongs behind a --peer"))?;
                match step_s {
                    Some(step_s) => peer.step_s = step_s,
                    None => peer.command.push(value),
                }
            }
            _ => {
                bail!("{name}: there are --sizes, --seconds, --folder, --docs, --peer, --step-ms, --command")
            }
        }
    }
    let report = measure_peers(&request, &|next| println!("{next}"))?;
    for (file, text) in [("peers.md", &report.markdown), ("images/peers.svg", &report.svg)] {
        let path = docs.join(file);
        std::fs::write(&path, text).with_context(|| format!("{}: cannot be written", path.display()))?;
    }
    println!("{}", report.markdown);
    Ok(())
}
