//! `glisson bench`.

use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

use anyhow::{Context, bail};
use glisson_lab::bench::haptics::{self, HapticsRequest};
use glisson_lab::bench::link::{self, LinkRequest};
use glisson_lab::bench::scene::{self, SceneRequest};
use glisson_lab::bench::{MachineBudget, Request, cases, measure};
use glisson_net::link_address::LinkAddress;
use glisson_runtime::realtime::CoreKept;

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
    /// Time for each benchmark and size [s]; 1 when left out, 10 for each of the two runs of haptics and for link; the most for each scene of scene, 60 when left out
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
    /// Sizes instead of the benchmark's own, in tetrahedra unless it says otherwise
    #[arg(long, value_name = "N,N", value_delimiter = ',')]
    sizes: Option<Vec<usize>>,
    /// One motion of the benchmark scene: rest, push, drag, cut or grasp; all when left out
    #[arg(long, value_name = "NAME")]
    motion: Option<String>,
    /// One model of the benchmark scene; all when left out
    #[arg(long, value_name = "NAME")]
    model: Option<String>,
    /// List the benchmarks and what they time
    #[arg(long)]
    list: bool,
}

/// Not cases: they do not time a closure.
const LINK: &str = "link";
const HAPTICS: &str = "haptics";
const SCENE: &str = "scene";
/// Livers of the benchmark scene, in tetrahedra.
const SCENE_SIZES: [usize; 3] = [2_000, 6_300, 20_000];
/// The liver of the demo.
const HAPTICS_TETS: usize = 6_300;

fn run_haptics(args: &Args) -> anyhow::Result<()> {
    let n_tets = match args.sizes.as_deref() {
        None => HAPTICS_TETS,
        Some(&[n_tets]) if n_tets > 0 => n_tets,
        Some(sizes) => bail!("--sizes {sizes:?}: the benchmark haptics takes one size above 0"),
    };
    let program =
        std::env::current_exe().context("finding this program, whose verb `watch` is the viewer")?;
    let seconds = args.seconds.unwrap_or(10.0);
    // As `glisson serve` does, before any thread is started; the viewer's process keeps away, too.
    let kept = CoreKept::keep(None);
    let request = HapticsRequest { seconds, rate_hz: args.rate, n_tets, core: kept.core(), program };
    let answer = with_progress(|tell| haptics::measure(&request, tell))?;
    if args.json {
        println!("{answer:#}");
    } else {
        print!("{}", haptics::to_text(&answer));
    }
    Ok(())
}

fn run_scenes(args: &Args) -> anyhow::Result<()> {
    let request = SceneRequest {
        motion: args.motion.clone(),
        model: args.model.clone(),
        sizes: args.sizes.clone().unwrap_or(SCENE_SIZES.to_vec()),
        threads: args.threads,
        seconds: args.seconds.unwrap_or(60.0),
    };
    let report = with_progress(|tell| scene::measure(&request, tell))?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        print!("{}", report.to_table());
    }
    Ok(())
}

fn run_link(args: &Args) -> anyhow::Result<()> {
    if let (true, Some(link)) = (args.answer, &args.link) {
        return link::answer(link);
    }
    let program = std::env::current_exe().context("finding this program, whose second process answers")?;
    let (seconds, link) = (args.seconds.unwrap_or(10.0), args.link.clone());
    let answer = link::measure(&LinkRequest { seconds, rate_hz: args.rate, link, program })?;
    if args.json {
        println!("{answer:#}");
    } else {
        print!("{}", link::to_text(&answer));
    }
    Ok(())
}

/// What `work` answers; what it tells (text, done, total) is shown meanwhile.
fn with_progress<T>(
    work: impl FnOnce(&dyn Fn(&str, usize, usize)) -> anyhow::Result<T>,
) -> anyhow::Result<T> {
    let bar = ProgressBar::no_length().with_style(
        ProgressStyle::with_template("{spinner} {pos}/{len} {msg}").expect("the template is well-formed"),
    );
    bar.enable_steady_tick(Duration::from_millis(200));
    let answer = work(&|text, done, total| {
        bar.set_length(total as u64);
        bar.set_position(done as u64);
        bar.set_message(text.to_owned());
    });
    bar.finish_and_clear();
    answer
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    if args.list {
        let cases = cases();
        let width = cases.iter().map(|case| case.name.len()).max().unwrap_or(0);
        for case in cases {
            println!("{:width$}  {} (per {})", case.name, case.about, case.per);
        }
        println!(
            "{HAPTICS:width$}  the haptic loop beside a simulation and a viewer, with stalls and without (not in all)"
        );
        println!("{LINK:width$}  what a link between two machines adds (not in all)");
        println!(
            "{SCENE:width$}  whole scenes on a liver: rest, push, drag, cut, grasp with every model (not in all)"
        );
        return Ok(());
    }
    match args.name.as_deref() {
        Some(HAPTICS) => return run_haptics(args),
        Some(LINK) => return run_link(args),
        Some(SCENE) => return run_scenes(args),
        _ => {}
    }
    let request = Request {
        name: args.name.clone(),
        sizes: args.sizes.clone(),
        seconds: args.seconds.unwrap_or(1.0),
        threads: args.threads,
        machine: MachineBudget::default(),
    };
    let report = with_progress(|tell| {
        measure(&request, &|name, size, done, total| {
            let text = if size == 0 { name.to_owned() } else { format!("{name} at {size}") };
            tell(&text, done, total);
        })
    })?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        print!("{}", report.to_table());
    }
    Ok(())
}
