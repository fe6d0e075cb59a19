//! Benchmarks: what a part of the program costs, beside what the machine could do at most.
//!
//! A [`Case`] has a name, sizes and a function that sets up and returns the closure to time. Adding one is an entry in the
//! `CASES` of the file it belongs to, or a new file with its line in the table of this one. A [`Trial`] is a benchmark that
//! is more than a closure; it has its line in a table, too. `docs/bench.md` says how to read the result.

mod machine;
mod model_edits;
pub(crate) mod timing;
mod world;
mod haptic_model;
pub(crate) mod body;
mod meshing;
mod models;
mod precomputed;
pub(crate) mod hybrid;
mod precomputed_cutting;
mod implicit;
mod kernel;
mod reference;
mod reduced;
pub(crate) mod contact;
mod collision;
pub(crate) mod colliding;
mod colliding_bodies;
pub(crate) mod response;
mod thesis_cube;
mod drawing;
mod hybrid_exchange;
mod scalpel;
mod mesh_edits;
mod cut_subdivision;
mod core_use;
mod empty_loop;
mod haptics;
pub mod link;
pub mod peers;
mod scene;
mod viewers;

pub use machine::{Machine, MachineBudget};
pub(crate) use timing::thread_cpu_ns;

use machine::isa_name;

use anyhow::{Context, bail, ensure};
use glisson_net::link_address::LinkAddress;
use timing::{Clock, time_of};

/// What a case is set up for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Settings {
    /// Wanted size, in tetrahedra unless the case says otherwise.
    pub(crate) size: usize,
    /// Threads that a parallel case may use; 1 for the others.
    pub(crate) threads: usize,
}

/// Operations and bytes that a call needs at least, to compare with the machine's peaks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Work {
    /// Floating-point operations.
    pub(crate) flops: f64,
    /// Bytes read and written.
    pub(crate) bytes: f64,
    /// Bytes touched: decides which level of memory they come from.
    pub(crate) working_set_bytes: f64,
}

/// A case ready to run.
pub(crate) struct Prepared {
    /// Size that was reached.
    pub(crate) size: usize,
    /// Instruction set of the code that is timed: `avx512`, `avx2`, ..., or `portable` when it was compiled
    /// for every processor.
    pub(crate) isa: &'static str,
    /// `f64` or `f32`.
    pub(crate) precision: &'static str,
    /// Least work of a call, where it is known.
    pub(crate) work: Option<Work>,
    /// Further figures that explain the size.
    pub(crate) note: String,
    /// What is timed.
    pub(crate) run: Box<dyn FnMut() + Send>,
}

/// A benchmark.
#[derive(Clone, Copy)]
pub struct Case {
    /// Name on the command line and in the result.
    pub name: &'static str,
    /// One line: what is timed.
    pub about: &'static str,
    /// What the time is for: `step`, `build`, ...
    pub per: &'static str,
    /// Sizes when none are asked for.
    pub(crate) sizes: &'static [usize],
    /// Whether it uses `Settings::threads`.
    pub(crate) parallel: bool,
    /// Sets up.
    pub(crate) prepare: fn(Settings) -> anyhow::Result<Prepared>,
}

/// The benchmarks, in the order in which they run. A new one is a file (and its `mod` above) and a line here; the file's
/// `CASES` say name, what is timed and the function that sets up.
const CASES: &[&[Case]] = &[
    meshing::CASES,
    models::CASES,
    precomputed::CASES,
    hybrid::CASES,
    precomputed_cutting::CASES,
    kernel::CASES,
    reference::CASES,
    model_edits::CASES,
    implicit::CASES,
    reduced::CASES,
    contact::CASES,
    collision::CASES,
    colliding_bodies::CASES,
    response::CASES,
    drawing::CASES,
    hybrid_exchange::CASES,
    scalpel::CASES,
    mesh_edits::CASES,
    world::CASES,
    haptic_model::CASES,
    cut_subdivision::CASES,
];

/// Every case, in the order in which they run.
pub fn cases() -> Vec<Case> {
    CASES.concat()
}

/// A benchmark that times no closure, but a whole program at work. It takes its own time, and does not run with all.
pub struct Trial {
    /// Name on the command line and in the result.
    pub name: &'static str,
    /// One line: what is measured.
    pub about: &'static str,
    /// Measures; hears what comes next with `tell` (name, number done, number in all). Called while the program has no other
    /// thread, which the first call of `tell` may start.
    pub measure: fn(&TrialRequest, Tell<'_>) -> anyhow::Result<Answer>,
}

/// Hears what comes next: its name, the number done, the number in all.
pub type Tell<'a> = &'a dyn Fn(&str, usize, usize);

/// The benchmarks that are no cases. A new one is a file (and its `mod` above) and its name here.
pub const TRIALS: &[Trial] = &[haptics::TRIAL, link::TRIAL, scene::TRIAL, viewers::TRIAL];

/// What a [`Trial`] may be asked; each says in `docs/bench.md` what it takes.
#[derive(Clone, Debug)]
pub struct TrialRequest {
    /// Sizes instead of its own.
    pub sizes: Option<Vec<usize>>,
    /// Time instead of its own [s].
    pub seconds: Option<f64>,
    /// Threads of models that can use several.
    pub threads: usize,
    /// Ticks a second [Hz].
    pub rate_hz: f64,
    /// How two processes reach each other; a free port of this machine for none.
    pub link: Option<LinkAddress>,
    /// One motion; all for none.
    pub motion: Option<String>,
    /// One model; all for none.
    pub model: Option<String>,
    /// Whether hands impose their motion instead of giving way.
    pub imposed: bool,
    /// The longest step of scenes [s]; each model its own for none.
    pub step_s: Option<f64>,
}

/// What a [`Trial`] found.
pub struct Answer {
    /// For programs.
    pub json: String,
    /// For people.
    pub text: String,
}

/// What a name stands for.
pub enum Chosen {
    /// These cases.
    Cases(Vec<Case>),
    /// This benchmark that is no case.
    Trial(&'static Trial),
}

/// Names for several cases at once.
const GROUPS: &[(&str, &[&str])] = &[("precomputed_response", precomputed::RESPONSES)];

/// How to measure cases.
#[derive(Clone, Debug)]
pub struct Request {
    /// What was asked for; all for none.
    pub name: Option<String>,
    /// Sizes instead of the case's own.
    pub sizes: Option<Vec<usize>>,
    /// Time for each case and size [s].
    pub seconds: f64,
    /// Threads of the parallel cases.
    pub threads: usize,
    /// Effort for the machine's peaks.
    pub machine: MachineBudget,
}

/// Times of one case at one size.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub(crate) struct Outcome {
    /// The case's name.
    pub(crate) case: &'static str,
    /// Size that was reached, in tetrahedra unless `note` says otherwise.
    pub(crate) size: usize,
    /// Threads that worked.
    pub(crate) threads: usize,
    /// Instruction set of the timed code.
    pub(crate) isa: &'static str,
    /// `f64` or `f32`.
    pub(crate) precision: &'static str,
    /// Median time of a call [ns].
    pub(crate) median_ns: f64,
    /// 99th percentile [ns].
    pub(crate) p99_ns: f64,
    /// What a call is.
    pub(crate) per: &'static str,
    /// Which time.
    pub(crate) clock: Clock,
    /// Processor time of all threads, a call [ns].
    pub(crate) cpu_ns: f64,
    /// Number of samples.
    pub(crate) samples: usize,
    /// Calls averaged in a sample.
    pub(crate) calls_per_sample: usize,
    /// Least possible time on one core over the median; only where the work is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) share_of_limit: Option<f64>,
    /// Further figures.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub(crate) note: String,
}

/// The answer to a request.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Report {
    /// The case asked for, or `all`.
    pub(crate) bench: String,
    /// The machine's peaks.
    pub(crate) machine: Machine,
    /// One for each case and size.
    pub(crate) results: Vec<Outcome>,
}

/// What the name of a benchmark stands for; every case for none.
///
/// # Errors
/// For a name that is no benchmark, with the list and the probable meaning.
pub fn chosen(name: Option<&str>) -> anyhow::Result<Chosen> {
    let all = cases();
    let Some(name) = name else { return Ok(Chosen::Cases(all)) };
    if let Some(case) = all.iter().find(|case| case.name == name) {
        return Ok(Chosen::Cases(vec![*case]));
    }
    if let Some((_, of_group)) = GROUPS.iter().find(|(group, _)| *group == name) {
        return Ok(Chosen::Cases(all.into_iter().filter(|case| of_group.contains(&case.name)).collect()));
    }
    if let Some(trial) = TRIALS.iter().find(|trial| trial.name == name) {
        return Ok(Chosen::Trial(trial));
    }
    let others = GROUPS.iter().map(|(group, _)| *group).chain(TRIALS.iter().map(|trial| trial.name));
    let names: Vec<&str> = all.iter().map(|case| case.name).chain(others).collect();
    let hint = glisson::text::did_you_mean(name, &names);
    bail!("there is no benchmark {name:?}{hint}\nknown: {}", names.join(", "))
}

/// Measures the machine and the cases; `tell` hears before each what comes.
///
/// # Errors
/// For a bad setting, or when a case cannot be set up.
pub fn measure(cases: &[Case], request: &Request, tell: Tell<'_>) -> anyhow::Result<Report> {
    ensure!(
        request.seconds > 0.0 && request.seconds.is_finite(),
        "--seconds {}: must be above 0",
        request.seconds
    );
    ensure!((1..=256).contains(&request.threads), "--threads {}: must be 1 to 256", request.threads);
    let sizes_of = |case: &Case| request.sizes.clone().unwrap_or_else(|| case.sizes.to_vec());
    let jobs: Vec<(Case, usize)> =
        cases.iter().flat_map(|case| sizes_of(case).into_iter().map(move |size| (*case, size))).collect();
    ensure!(jobs.iter().all(|(_, size)| *size > 0), "--sizes: a size must be above 0");
    tell("machine", 0, jobs.len());
    let machine = Machine::measure(request.machine)?;
    let mut results = Vec::new();
    for (done, (case, size)) in jobs.iter().enumerate() {
        tell(&format!("{} at {size}", case.name), done, jobs.len());
        let outcome = measure_case(case, *size, request, &machine)
            .with_context(|| format!("benchmark {} at size {size}", case.name))?;
        results.push(outcome);
    }
    let bench = request.name.clone().unwrap_or_else(|| "all".to_owned());
    Ok(Report { bench, machine, results })
}

fn measure_case(case: &Case, size: usize, request: &Request, machine: &Machine) -> anyhow::Result<Outcome> {
    let threads = if case.parallel { request.threads } else { 1 };
    let clock = if threads == 1 { Clock::ThreadCpu } else { Clock::Wall };
    // Set-up and timing run inside a pool of exactly these threads: with one, everything that is timed
    // runs on the thread whose clock is read.
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .with_context(|| format!("starting {threads} threads"))?;
    let mut prepared = pool.install(|| (case.prepare)(Settings { size, threads }))?;
    let times = pool.install(|| time_of(&mut *prepared.run, clock, request.seconds));
    let share_of_limit =
        prepared.work.map(|work| machine.limit_ns(&work, prepared.precision) / times.median_ns);
    Ok(Outcome {
        case: case.name,
        size: prepared.size,
        threads,
        isa: prepared.isa,
        precision: prepared.precision,
        median_ns: times.median_ns,
        p99_ns: times.p99_ns,
        per: case.per,
        clock,
        cpu_ns: times.cpu_ns,
        samples: times.samples,
        calls_per_sample: times.calls_per_sample,
        share_of_limit,
        note: prepared.note,
    })
}

impl Report {
    /// A table for people: the machine first.
    pub fn to_table(&self) -> String {
        let m = &self.machine;
        let rates = m.read_gb_per_s;
        let mut text = format!(
            "machine: {} ({}), one core: FMA {:.1} GFLOP/s f64, {:.1} f32; reads L1 {:.0}, L2 {:.0}, L3 {:.0}, \
             DRAM {:.1} GB/s\n",
            m.cpu, m.isa, m.fma_gflops_f64, m.fma_gflops_f32, rates.l1, rates.l2, rates.l3, rates.dram
        );
        if let Some(note) = &m.note {
            text += &format!("note: {note}\n");
        }
        let head =
            ["case", "size", "threads", "isa", "precision", "median", "p99", "clock", "per", "limit", "note"];
        let mut rows = vec![head.map(str::to_owned)];
        rows.extend(self.results.iter().map(|r| {
            [
                r.case.to_owned(),
                r.size.to_string(),
                r.threads.to_string(),
                r.isa.to_owned(),
                r.precision.to_owned(),
                readable(r.median_ns),
                readable(r.p99_ns),
                match r.clock {
                    Clock::ThreadCpu => "cpu".to_owned(),
                    Clock::Wall => "wall".to_owned(),
                },
                r.per.to_owned(),
                r.share_of_limit.map_or(String::new(), |share| format!("{:.0} %", 100.0 * share)),
                r.note.clone(),
            ]
        }));
        let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
        let widths: Vec<usize> = (0..head.len()).map(width).collect();
        for row in &rows {
            let cells = row.iter().zip(&widths).enumerate().map(|(column, (cell, &width))| {
                let number = [1, 2, 5, 6, 9].contains(&column);
                if number { format!("{cell:>width$}") } else { format!("{cell:<width$}") }
            });
            text += cells.collect::<Vec<_>>().join("  ").trim_end();
            text.push('\n');
        }
        text
    }
}

/// A time with the unit that suits it.
fn readable(ns: f64) -> String {
    let (value, unit) = match ns {
        _ if ns < 1e3 => (ns, "ns"),
        _ if ns < 1e6 => (ns * 1e-3, "us"),
        _ if ns < 1e9 => (ns * 1e-6, "ms"),
        _ => (ns * 1e-9, "s"),
    };
    let decimals = if value < 10.0 {
        2
    } else if value < 100.0 {
        1
    } else {
        0
    };
    format!("{value:.decimals$} {unit}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tiny(size: usize) -> Request {
        Request {
            name: None,
            sizes: Some(vec![size]),
            seconds: 1e-3,
            threads: 2,
            machine: MachineBudget { seconds: 1e-3, max_array_bytes: 1 << 20 },
        }
    }

    #[test]
    fn every_case_gives_a_result_of_the_promised_shape() {
        let report = measure(&cases(), &tiny(1_000), &|_, _, _| {}).unwrap();
        let json = serde_json::to_value(&report).unwrap();
        assert_eq!(json["bench"], "all");
        for field in ["fma_gflops_f64", "fma_gflops_f32"] {
            assert!(json["machine"][field].as_f64().unwrap() > 0.0, "{field}");
        }
        for level in ["l1", "l2", "l3", "dram"] {
            assert!(json["machine"]["read_gb_per_s"][level].as_f64().unwrap() > 0.0, "{level}");
        }
        let results = json["results"].as_array().unwrap();
        assert_eq!(results.len(), cases().len());
        for (result, case) in results.iter().zip(cases()) {
            assert_eq!(result["case"], case.name);
            assert_eq!(result["per"], case.per);
            assert_eq!(result["threads"], if case.parallel { 2 } else { 1 });
            assert!(result["size"].as_u64().unwrap() > 0 && result["samples"].as_u64().unwrap() > 0);
            assert!(!result["isa"].as_str().unwrap().is_empty());
            assert!(["f64", "f32"].contains(&result["precision"].as_str().unwrap()));
            let (median, p99) = (result["median_ns"].as_f64().unwrap(), result["p99_ns"].as_f64().unwrap());
            assert!(median > 0.0 && p99 >= median, "{}: {median} {p99}", case.name);
        }
        let table = report.to_table();
        assert!(table.starts_with("machine: "));
        assert_eq!(table.lines().filter(|l| l.starts_with("collision ")).count(), 1);
    }

    #[test]
    fn an_unknown_name_gets_the_list_and_a_guess() {
        for (wrong, meant) in [("colision", "collision"), ("haptic", "haptics")] {
            let message = chosen(Some(wrong)).err().unwrap().to_string();
            assert!(message.contains(&format!("did you mean \"{meant}\"?")), "{message}");
            assert!(message.contains("known: "), "{message}");
        }
        let n_cases = |name| match chosen(name).unwrap() {
            Chosen::Cases(cases) => cases.len(),
            Chosen::Trial(_) => 0,
        };
        assert_eq!([None, Some("picture")].map(n_cases), [cases().len(), 1]);
        for trial in TRIALS {
            let found = chosen(Some(trial.name)).unwrap();
            assert!(matches!(found, Chosen::Trial(found) if found.name == trial.name));
        }
    }

    #[test]
    fn names_are_unique_and_bad_settings_are_refused() {
        let others = GROUPS.iter().map(|group| group.0).chain(TRIALS.iter().map(|trial| trial.name));
        let mut names: Vec<&str> = cases().iter().map(|case| case.name).chain(others).collect();
        names.sort_unstable();
        assert!(names.windows(2).all(|pair| pair[0] != pair[1]));
        let refused = |request: Request| measure(&cases(), &request, &|_, _, _| {}).unwrap_err().to_string();
        assert!(refused(Request { seconds: 0.0, ..tiny(300) }).contains("--seconds"));
        assert!(refused(Request { threads: 0, ..tiny(300) }).contains("--threads"));
        assert!(refused(tiny(0)).contains("--sizes"));
    }

    #[test]
    fn times_are_readable() {
        assert_eq!(readable(12.34), "12.3 ns");
        assert_eq!(readable(1_234.0), "1.23 us");
        assert_eq!(readable(456e6), "456 ms");
        assert_eq!(readable(7.5e9), "7.50 s");
    }
}
