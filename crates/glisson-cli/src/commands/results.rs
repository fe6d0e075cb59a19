//! `glisson results`.

use super::output::{check_extension, make_folder_of};
use super::results_text::{comparison_text, curve_text, list_text};
use crate::text_file::write_text;
use anyhow::{Context, bail, ensure};
use glisson_report::curve_plot;
use glisson_results::{Added, Filter, Kept, Store, export};
use std::path::{Path, PathBuf};

/// Results of people at tasks: list, compare with a group, learning curves, export.
///
/// `glisson task run TASK --person NAME` stores them (docs/results.md).
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  glisson results list --person Ada\n  glisson results group add experts Ada Ben Cleo Dan\n  \
    glisson results show 12 --group experts\n  \
    glisson results curve --person Ada --task palpation --metric time --out curve.svg\n  \
    glisson results export --csv results.csv\n  glisson results forget Ada --yes"
)]
pub(crate) struct Args {
    #[command(flatten)]
    database: Database,
    #[command(subcommand)]
    verb: Verb,
}

/// Where results are.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Database {
    /// Database of results; else the one that the variable GLISSON_RESULTS names, else glisson-results.sqlite in this folder
    #[arg(long, value_name = "FILE", global = true)]
    pub(crate) database: Option<PathBuf>,
}

const DEFAULT_FILE: &str = "glisson-results.sqlite";

impl Database {
    /// The database's file.
    pub(super) fn path(&self) -> PathBuf {
        let named = std::env::var_os("GLISSON_RESULTS").filter(|name| !name.is_empty()).map(PathBuf::from);
        self.database.clone().or(named).unwrap_or_else(|| DEFAULT_FILE.into())
    }
}

#[derive(Debug, clap::Subcommand)]
enum Verb {
    /// The results, by time
    List(Chosen),
    /// All metrics of a result, beside the quartiles of a group
    Show {
        /// The result's number in `glisson results list`
        number: i64,
        /// Compare with this group
        #[arg(long, value_name = "NAME")]
        group: Option<String>,
    },
    /// A metric over the attempts of a person at a task
    Curve(Curve),
    /// Write results as CSV (a row for each metric) or JSON (which `import` reads)
    Export {
        #[command(flatten)]
        chosen: Chosen,
        #[command(flatten)]
        to: Target,
    },
    /// Store results from files: those of `glisson task run --headless`, those that could not be stored, or an export
    Import {
        /// Files of results (JSON)
        #[arg(required = true)]
        files: Vec<PathBuf>,
        /// Whose results they are, where the files do not tell
        #[arg(long, value_name = "NAME")]
        person: Option<String>,
    },
    /// Groups of people to compare with; there are none but those that you make
    Group {
        #[command(subcommand)]
        verb: GroupVerb,
    },
    /// Everybody with results, and the groups they are in
    People,
    /// Remove a result
    Delete {
        /// The result's number in `glisson results list`
        number: i64,
        /// Do it; without, it is only told what would be removed
        #[arg(long)]
        yes: bool,
    },
    /// Remove a person with all results; recorded sessions are files of their own and stay
    Forget {
        /// Whom
        person: String,
        /// Do it; without, it is only told what would be removed
        #[arg(long)]
        yes: bool,
    },
}

#[derive(Debug, clap::Args)]
struct Chosen {
    /// Only of this person
    #[arg(long, value_name = "NAME")]
    person: Option<String>,
    /// Only at this task
    #[arg(long, value_name = "NAME")]
    task: Option<String>,
    #[command(flatten)]
    variant: Variant,
}

/// Which of the variants of a task.
#[derive(Debug, clap::Args)]
struct Variant {
    /// Only at this level
    #[arg(long, value_name = "NAME")]
    level: Option<String>,
    /// Only of this synthetic patient
    #[arg(long, value_name = "SEED")]
    patient: Option<u32>,
}

impl Variant {
    fn filter(&self, person: Option<&str>, task: Option<&str>) -> Filter {
        let [person, task] = [person, task].map(|name| name.map(str::to_owned));
        Filter { person, task, level: self.level.clone(), patient: self.patient }
    }
}

impl Chosen {
    fn filter(&self) -> Filter {
        self.variant.filter(self.person.as_deref(), self.task.as_deref())
    }
}

#[derive(Debug, clap::Args)]
struct Curve {
    /// Whose attempts
    #[arg(long, value_name = "NAME")]
    person: String,
    /// At which task
    #[arg(long, value_name = "NAME")]
    task: String,
    #[command(flatten)]
    variant: Variant,
    /// Which metric, such as time, path_length, peak_force, smoothness_sparc
    #[arg(long, value_name = "NAME")]
    metric: String,
    /// The instrument, where several have that metric
    #[arg(long, value_name = "NAME")]
    tool: Option<String>,
    /// Draw the quartiles of this group, too
    #[arg(long, value_name = "NAME")]
    group: Option<String>,
    /// Write the curve as a plot (SVG)
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

#[derive(Debug, clap::Args)]
#[group(required = true, multiple = false)]
struct Target {
    /// CSV, a row for each metric
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// JSON, with the groups and all that is known of each result
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

#[derive(Debug, clap::Subcommand)]
enum GroupVerb {
    /// Take people into a group, which is made where there is none of that name
    Add {
        /// The group
        name: String,
        /// People with results
        #[arg(required = true)]
        people: Vec<String>,
    },
    /// Take people out of a group, or remove the group where none are named
    Remove {
        /// The group
        name: String,
        /// Its members
        people: Vec<String>,
    },
    /// The groups and who is in them
    List,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let path = args.database.path();
    if let Verb::Import { files, person } = &args.verb {
        return import(&path, files, person.as_deref());
    }
    let mut store = Store::open_existing(&path)?;
    match &args.verb {
        Verb::List(chosen) => print!("{}", list_text(&store.results(&chosen.filter())?)),
        Verb::Show { number, group } => {
            let stored = store.result(*number)?;
            print!("{}", comparison_text(&stored, &store.compare(*number, group.as_deref())?));
        }
        Verb::Curve(curve) => draw(&store, curve)?,
        Verb::Export { chosen, to } => write_export(&store, &chosen.filter(), to)?,
        Verb::Import { .. } => {}
        Verb::Group { verb } => group(&mut store, verb)?,
        Verb::People => {
            for person in store.people()? {
                let groups = if person.groups.is_empty() {
                    String::new()
                } else {
                    format!(", in {}", person.groups.join(", "))
                };
                println!("{}: {} results{groups}", person.name, person.n_results);
            }
        }
        Verb::Delete { number, yes } => {
            let stored = store.result(*number)?;
            let what = format!(
                "result {number}: {} at {} ({})",
                stored.person, stored.kept.attempt.task, stored.kept.attempt.finished_at
            );
            ensure!(yes, "{what} would be removed; add --yes to do it");
            store.delete(*number)?;
            println!("removed {what}");
        }
        Verb::Forget { person, yes } => forget(&mut store, person, *yes)?,
    }
    Ok(())
}

fn draw(store: &Store, args: &Curve) -> anyhow::Result<()> {
    if let Some(out) = &args.out {
        check_extension(out, &["svg"])?;
    }
    let filter = args.variant.filter(Some(&args.person), Some(&args.task));
    let (mut curves, n_left_out) = store.curves(&filter, &args.metric, args.group.as_deref())?;
    let tools: Vec<String> = curves.iter().filter_map(|curve| curve.of.tool.clone()).collect();
    if let Some(tool) = &args.tool {
        curves.retain(|curve| curve.of.tool.as_ref() == Some(tool));
        ensure!(
            !curves.is_empty(),
            "no instrument \"{tool}\" has the metric {}; these have it: {}",
            args.metric,
            tools.join(", ")
        );
    }
    for curve in &curves {
        print!("{}", curve_text(curve));
    }
    if n_left_out > 0 {
        println!(
            "{n_left_out} attempts are left out: another level or patient (--level and --patient choose them), or a scene that was changed since"
        );
    }
    let Some(out) = &args.out else { return Ok(()) };
    let [curve] = &curves[..] else {
        bail!(
            "several instruments have the metric {}; choose one for the plot with --tool: {}",
            args.metric,
            tools.join(", ")
        );
    };
    make_folder_of(out)?;
    let plot = curve_plot(curve, [880, 420]);
    ensure!(!curve.curve.points.is_empty(), "no attempt was done: there is nothing to plot");
    write_text(out, &plot.to_svg()?)?;
    println!("written {}", out.display());
    Ok(())
}

fn write_export(store: &Store, filter: &Filter, to: &Target) -> anyhow::Result<()> {
    let results = store.results(filter)?;
    let (path, text) = match (&to.csv, &to.json) {
        (Some(csv), _) => (csv, export::csv(&results)),
        (None, Some(json)) => {
            let value = export::json(&results, &store.groups()?);
            (json, format!("{}\n", serde_json::to_string_pretty(&value)?))
        }
        (None, None) => bail!("the command line asks for one of the two"),
    };
    make_folder_of(path)?;
    write_text(path, &text)?;
    println!("{} results written to {}", results.len(), path.display());
    Ok(())
}

fn import(database: &Path, files: &[PathBuf], person: Option<&str>) -> anyhow::Result<()> {
    let mut all: Vec<(&PathBuf, Kept)> = Vec::new();
    for file in files {
        let text =
            std::fs::read_to_string(file).with_context(|| format!("{}: cannot be read", file.display()))?;
        let results = export::read(&text).with_context(|| file.display().to_string())?;
        for mut kept in results {
            if kept.attempt.person.is_none() {
                kept.attempt.person = person.map(str::to_owned);
            }
            // One that is wrong keeps the others out, too: then nothing is half done.
            kept.checked().with_context(|| file.display().to_string())?;
            all.push((file, kept));
        }
    }
    let mut store = Store::open(database)?;
    let (files, all): (Vec<&PathBuf>, Vec<Kept>) = all.into_iter().unzip();
    let added = store.add_all(&all).context("nothing is imported")?;
    for ((file, kept), added) in files.into_iter().zip(&all).zip(added) {
        let (person, task) = (kept.attempt.person.as_deref().unwrap_or_default(), &kept.attempt.task);
        let what = match added {
            Added::New(id) => format!("stored as result {id}"),
            Added::There(id) => format!("is there already, as result {id}"),
        };
        println!("{}: {person} at {task} {what}", file.display());
    }
    Ok(())
}

fn group(store: &mut Store, verb: &GroupVerb) -> anyhow::Result<()> {
    match verb {
        GroupVerb::Add { name, people } => store.add_to_group(name, people)?,
        GroupVerb::Remove { name, people } => store.remove_from_group(name, people)?,
        GroupVerb::List => {}
    }
    let groups = store.groups()?;
    if groups.is_empty() {
        println!("there is no group; `glisson results group add NAME PERSON...` makes one");
    }
    for group in groups {
        println!("{}: {}", group.name, group.people.join(", "));
    }
    Ok(())
}

fn forget(store: &mut Store, person: &str, is_sure: bool) -> anyhow::Result<()> {
    let results = store.results(&Filter { person: Some(person.to_owned()), ..Filter::default() })?;
    let what = format!("{person} with {} results", results.len());
    ensure!(is_sure, "{what} would be removed; add --yes to do it");
    store.forget(person)?;
    println!("removed {what}");
    let mut sessions: Vec<&String> =
        results.iter().filter_map(|stored| stored.kept.attempt.session.as_ref()).collect();
    sessions.dedup();
    if !sessions.is_empty() {
        println!(
            "their sessions, and reports beside them, are files of their own; remove them yourself where they are still there:"
        );
        sessions.iter().for_each(|session| println!("  {session}"));
    }
    Ok(())
}
