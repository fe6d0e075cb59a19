//! `glisson bench`.

use std::cell::OnceCell;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

use glisson_lab::bench::{
    Answer, Chosen, MachineBudget, Request, TRIALS, Tell, TrialRequest, cases, chosen, link, measure,
};
use glisson_net::link_address::LinkAddress;

/// Measure speed: CPU time, medians, beside the machine's peak.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  glisson bench                                  every benchmark at its own sizes\n  \
                  glisson bench collision --json                 one benchmark, for a program to read\n  \
                  glisson bench precompute --sizes 6300 --threads 2\n  \
                  glisson bench haptics --seconds 60 --json      the haptic loop, with and without stalls\n  glisson bench scene --motion push --model implicit --sizes 6300
  glisson bench --list\n\n\
                  How to read the result: docs/bench.md."
)]
pub(crate) struct Args {
    /// Which benchmark; all when left out
    name: Option<String>,
    /// Print JSON instead of a table
    #[arg(long)]
    json: bool,
    /// Time for each benchmark and size [s]; 1 when left out, 10 for each of the two runs of haptics and for link; 5 for each run of viewers; the most for each scene of scene, 60 when left out
    #[arg(long, value_name = "S")]
    seconds: Option<f64>,
    /// Ticks a second of the benchmarks haptics and link [Hz]: 100 to 4000
    #[arg(long, value_name = "HZ", default_value_t = 1000.0)]
    rate: f64,
    /// How the two processes of the benchmark link reach each other, as for `glisson serve`; UDP on this machine when left
    /// out
    #[arg(long, value_name = "ADDRESS")]
    link: Option<LinkAddress>,
    /// This is the other process of the benchmark link
    #[arg(long, hide = true, requires = "link")]
    answer: bool,
    /// Threads of the parallel benchmarks; with more than one, wall time counts instead of CPU time
    #[arg(long, value_name = "N", default_value_t = 1)]
    threads: usize,
    /// Sizes instead of the benchmark's own, in tetrahedra unless it says otherwise; numbers of viewers for viewers
    #[arg(long, value_name = "N,N", value_delimiter = ',')]
    sizes: Option<Vec<usize>>,
    /// One motion of the benchmark scene: rest, push, drag, cut or grasp; all when left out
    #[arg(long, value_name = "NAME")]
    motion: Option<String>,
    /// One model of the benchmark scene; all when left out
    #[arg(long, value_name = "NAME")]
    model: Option<String>,
    /// Hands of the benchmark scene impose their motion (touch = "imposed") instead of giving way
    #[arg(long)]
    imposed: bool,
    /// Longest time step of the benchmark scene in milliseconds (2 for implicit, 1 for the others), shortened until the model takes it
    #[arg(long, value_name = "MS", value_parser = step_ms)]
    step_ms: Option<f64>,
    /// List the benchmarks and what they time
    #[arg(long)]
    list: bool,
}

/// What `work` answers; what it tells (text, done, total) is shown meanwhile, by a thread that the first of it starts.
fn with_progress<T>(work: impl FnOnce(Tell<'_>) -> anyhow::Result<T>) -> anyhow::Result<T> {
    let bar = ProgressBar::no_length().with_style(
        ProgressStyle::with_template("{spinner} {pos}/{len} {msg}").expect("the template is well-formed"),
    );
    let ticks = OnceCell::new();
    let answer = work(&|text, done, total| {
        ticks.get_or_init(|| bar.enable_steady_tick(Duration::from_millis(200)));
        bar.set_length(total as u64);
        bar.set_position(done as u64);
        bar.set_message(text.to_owned());
    });
    bar.finish_and_clear();
    answer
}

fn list() {
    let (cases, trials) = (cases(), TRIALS.iter());
    let names = cases.iter().map(|case| case.name).chain(trials.clone().map(|trial| trial.name));
    let width = names.map(str::len).max().unwrap_or(0);
    for case in cases {
        println!("{:width$}  {} (per {})", case.name, case.about, case.per);
    }
    for trial in trials {
        println!("{:width$}  {} (not in all)", trial.name, trial.about);
    }
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    if args.list {
        list();
        return Ok(());
    }
    if let (true, Some(link)) = (args.answer, &args.link) {
        return link::answer(link);
    }
    let answer = match chosen(args.name.as_deref())? {
        Chosen::Trial(trial) => {
            let request = TrialRequest {
                sizes: args.sizes.clone(),
                seconds: args.seconds,
                threads: args.threads,
                rate_hz: args.rate,
                link: args.link.clone(),
                motion: args.motion.clone(),
                model: args.model.clone(),
                imposed: args.imposed,
                step_s: args.step_ms.map(|ms| 1e-3 * ms),
            };
            with_progress(|tell| (trial.measure)(&request, tell))?
        }
        Chosen::Cases(cases) => {
            let request = Request {
                name: args.name.clone(),
                sizes: args.sizes.clone(),
                seconds: args.seconds.unwrap_or(1.0),
                threads: args.threads,
                machine: MachineBudget::default(),
            };
            let report = with_progress(|tell| measure(&cases, &request, tell))?;
            Answer { json: serde_json::to_string_pretty(&report)?, text: report.to_table() }
        }
    };
    if args.json {
        println!("{}", answer.json);
    } else {
        print!("{}", answer.text);
    }
    Ok(())
}

fn step_ms(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(ms) if (0.01..=100.0).contains(&ms) => Ok(ms),
        _ => Err(format!("{text:?} is no time step; allowed are 0.01 to 100 ms")),
    }
}
