//! `glisson bench`.

use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

use crate::bench::{MachineBudget, Request, cases, measure};

/// Measure speed: CPU time, medians, beside the machine's peak.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  glisson bench                                  every benchmark at its own sizes\n  \
                  glisson bench collision --json                 one benchmark, for a program to read\n  \
                  glisson bench precompute --sizes 6300 --threads 2\n  glisson bench --list\n\n\
                  How to read the result: docs/bench.md."
)]
pub(crate) struct Args {
    /// Which benchmark; all when left out
    name: Option<String>,
    /// Print JSON instead of a table
    #[arg(long)]
    json: bool,
    /// Time for each benchmark and size [s]
    #[arg(long, value_name = "S", default_value_t = 1.0)]
    seconds: f64,
    /// Threads of the parallel benchmarks; with more than one, wall time counts instead of CPU time
    #[arg(long, value_name = "N", default_value_t = 1)]
    threads: usize,
    /// Sizes instead of the benchmark's own, in tetrahedra unless it says otherwise
    #[arg(long, value_name = "N,N", value_delimiter = ',')]
    sizes: Option<Vec<usize>>,
    /// List the benchmarks and what they time
    #[arg(long)]
    list: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    if args.list {
        let cases = cases();
        let width = cases.iter().map(|case| case.name.len()).max().unwrap_or(0);
        for case in cases {
            println!("{:width$}  {} (per {})", case.name, case.about, case.per);
        }
        return Ok(());
    }
    let request = Request {
        name: args.name.clone(),
        sizes: args.sizes.clone(),
        seconds: args.seconds,
        threads: args.threads,
        machine: MachineBudget::default(),
    };
    let bar = ProgressBar::no_length().with_style(
        ProgressStyle::with_template("{spinner} {pos}/{len} {msg}").expect("the template is well-formed"),
    );
    bar.enable_steady_tick(Duration::from_millis(200));
    let report = measure(&request, &|name, size, done, total| {
        bar.set_length(total as u64);
        bar.set_position(done as u64);
        bar.set_message(if size == 0 { name.to_owned() } else { format!("{name} at {size}") });
    });
    bar.finish_and_clear();
    let report = report?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        print!("{}", report.to_table());
    }
    Ok(())
}
