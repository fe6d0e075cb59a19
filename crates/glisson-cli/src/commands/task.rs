//! `glisson task`.

use super::export;
use super::resuming::{offer, open_recorded};
use super::serve::Address;
use super::task_keeping::{Keeper, KeepingArgs, now_text, time_in_names};
use super::task_text::task_text;
use crate::text_file::write_text;
use anyhow::{Context, bail};
use glisson::scene::{Choice, Scene, choose};
use glisson::training::task::{Outcome, TaskRun};
use glisson_report::{ReportContext, task_report};
use glisson_results::Attempt;
use glisson_runtime::cut_off::CutOff;
use glisson_runtime::script::PathScript;
use glisson_runtime::tasks::{TASKS, task_named};
use glisson_runtime::{OpenScene, Simulation};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// Tasks to train with: what there is, doing one, checking one of your own.
///
/// A task is a scene with a [task] table (docs/tasks.md). It is measured while it is done, and reported at its end.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  glisson task list\n  glisson task run palpation\n  \
    glisson task run palpation --person Ada --group experts\n  \
    glisson task run grasp_and_lift --headless --out out/tasks\n  glisson task check my_task.toml")]
pub(crate) struct Args {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, clap::Subcommand)]
enum Verb {
    /// The tasks that come with the program
    List {
        /// Print them as JSON
        #[arg(long)]
        json: bool,
    },
    /// Do a task in the browser, or let its demonstration do it
    Run(Run),
    /// Say whether a task can be done: reads it, makes its organs, and finds its places in them
    Check {
        /// A name of `glisson task list`, or a scene file with a [task]
        task: String,
        #[command(flatten)]
        choice: Chosen,
    },
}

/// How a task is done, where it leaves a choice.
#[derive(Clone, Debug, Default, clap::Args)]
struct Chosen {
    /// Do it with this synthetic patient, one of the task's
    #[arg(long, value_name = "SEED")]
    patient: Option<u32>,
    /// Do it at this level, one of the task's
    #[arg(long, value_name = "NAME")]
    level: Option<String>,
}

impl Chosen {
    fn choice(&self) -> Choice {
        Choice { patient: self.patient, level: self.level.clone() }
    }
}

#[derive(Debug, clap::Args)]
struct Run {
    /// A name of `glisson task list`, or a scene file with a [task]
    task: String,
    #[command(flatten)]
    choice: Chosen,
    /// Follow the paths of the scene's instruments without a window; exit code 1 if the task is not passed
    #[arg(long)]
    headless: bool,
    /// In the browser: the demonstration leads the instruments, until you take one into the hand
    #[arg(long, conflicts_with = "headless")]
    demonstrate: bool,
    /// Folder for the session, and without a window the report and its numbers
    #[arg(long, default_value = "out/tasks", value_name = "DIR")]
    out: PathBuf,
    /// Go on with this session of the task that was cut off: it is replayed to its last moment, and stands still there at first
    #[arg(long, value_name = "FILE", conflicts_with_all = ["headless", "demonstrate"])]
    resume: Option<PathBuf>,
    /// Threads of models that can use several; the results do not depend on it
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=64))]
    threads: u8,
    /// Without a window: print the result as JSON
    #[arg(long)]
    json: bool,
    /// Without a window: write the session as a page that plays it, to which the report's moments lead
    #[arg(long, requires = "headless")]
    replay: bool,
    #[command(flatten)]
    keeping: KeepingArgs,
    #[command(flatten)]
    address: Address,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    match &args.verb {
        Verb::List { json } => list(*json),
        Verb::Run(args) => do_task(args),
        Verb::Check { task, choice } => check(task, &choice.choice()),
    }
}

fn list(as_json: bool) -> anyhow::Result<()> {
    let mut all = Vec::new();
    for (name, text) in TASKS {
        let scene = Scene::parse(text).with_context(|| format!("the task {name}"))?;
        let task = scene.task.with_context(|| format!("the scene {name} has no task"))?;
        all.push((*name, task));
    }
    if as_json {
        let row = |(name, task): &(&str, glisson::scene::TaskSource)| {
            let stages: Vec<&str> = task.stages.iter().map(|stage| stage.title.as_str()).collect();
            json!({ "name": name, "title": task.title, "about": task.about, "stages": stages, "time_limit_s": task.time_limit_s, "levels": task.levels, "patients": task.patients })
        };
        println!("{}", serde_json::Value::from(all.iter().map(row).collect::<Vec<_>>()));
        return Ok(());
    }
    let width = all.iter().map(|(name, _)| name.len()).max().unwrap_or(0);
    for (name, task) in &all {
        println!("{name:width$}  {} ({:.0} s)", task.title, task.time_limit_s);
        println!("{:width$}  {}", "", task.about);
        if !task.levels.is_empty() {
            println!("{:width$}  --level {}", "", task.levels.join(", "));
        }
        if !task.patients.is_empty() {
            let patients: Vec<String> = task.patients.iter().map(u32::to_string).collect();
            println!("{:width$}  --patient {}", "", patients.join(", "));
        }
    }
    println!("\nDo one with `glisson task run {}`.", all.first().map_or("NAME", |(name, _)| name));
    Ok(())
}

/// A task of the program, or a scene file with one.
pub(super) fn open(task: &str, choice: &Choice, n_threads: usize) -> anyhow::Result<OpenScene> {
    let chosen_scene = |text: &str| -> anyhow::Result<Scene> { Ok(Scene::parse(&choose(text, choice)?)?) };
    let source = match task_named(task) {
        Some(text) => OpenScene {
            scene: chosen_scene(text).with_context(|| format!("the task {task}"))?,
            folder: PathBuf::from("."),
            origin: format!("the task {task}"),
            n_threads,
        },
        None => {
            let known: Vec<&str> = TASKS.iter().map(|(name, _)| *name).collect();
            let path = PathBuf::from(task);
            if !path.exists() {
                let suggestion = glisson::text::did_you_mean(task, &known);
                bail!("there is no task and no file \"{task}\"{suggestion}; tasks: {}", known.join(", "));
            }
            let read = OpenScene::read(&path)?;
            let scene = chosen_scene(&read.scene.text).with_context(|| read.origin.clone())?;
            OpenScene { n_threads, scene, ..read }
        }
    };
    if source.scene.task.is_none() {
        bail!("{}: the scene has no [task]; docs/tasks.md says how to write one", source.origin);
    }
    Ok(source)
}

impl Run {
    /// What the task is called in files and in the database.
    fn name(&self) -> String {
        Path::new(&self.task).file_stem().map_or("task".into(), |stem| stem.to_string_lossy()).into_owned()
    }

    /// Where this run writes. A person's runs have names of their own: later ones leave them as they are, and so do those that
    /// begin in the same millisecond.
    fn files(&self) -> Files {
        let own = || format!("_{}_{}", time_in_names(&now_text()), std::process::id());
        let own = self.keeping.person.as_ref().map(|_| own());
        Files { folder: self.out.clone(), stem: self.name() + &own.unwrap_or_default() }
    }
}

/// Files of a run.
struct Files {
    folder: PathBuf,
    stem: String,
}

impl Files {
    fn with(&self, ending: &str) -> PathBuf {
        self.folder.join(format!("{}{ending}", self.stem))
    }
}

/// A headless run.
struct Followed<'a> {
    args: &'a Run,
    files: Files,
    attempt: Attempt,
    keeper: Option<Arc<Keeper>>,
    /// Folder that the scene's files are relative to.
    scene_folder: PathBuf,
}

fn check(task: &str, choice: &Choice) -> anyhow::Result<()> {
    let source = open(task, choice, 1)?;
    let (scene, origin) = (source.scene.clone(), source.origin.clone());
    let simulation = Simulation::open(source, None)?;
    let task = scene.task.as_ref().context("a scene without a task was refused")?;
    println!("{origin}: {}", task.title);
    println!(
        "organ      {} tetrahedra, {}",
        simulation.mesh().tetrahedra.len(),
        simulation.body().material_text
    );
    for tool in &scene.world.tools {
        println!("instrument {} ({})", tool.name, tool.kind.name());
    }
    for (number, stage) in (1..).zip(&task.stages) {
        println!("stage {number}    {}", stage.title);
    }
    match scene.end_of_paths_s() {
        Some(end_s) => println!("its demonstration takes {end_s:.1} s"),
        None => println!("no demonstration: its instruments have no [[tool.path]]"),
    }
    println!("it can be done");
    Ok(())
}

fn do_task(args: &Run) -> anyhow::Result<()> {
    if args.replay {
        export::require_page()?;
    }
    // A taken port is better known before the work than after it.
    let listener = if args.headless { None } else { Some(args.address.bind()?) };
    let source = open(&args.task, &args.choice.choice(), usize::from(args.threads))?;
    let mut script = None;
    if args.headless || args.demonstrate {
        // One sees the beginning of a demonstration in the browser.
        let paths_of = if args.headless { PathScript::new } else { PathScript::for_viewers };
        let paths = paths_of(source.scene.clone());
        let none = "the task has no demonstration: its instruments have no [[tool.path]]";
        script = Some(paths.with_context(|| format!("{}: {none}", source.origin))?);
    }
    let (files, scene_folder) = (args.files(), source.folder.clone());
    let session = files.with(".jsonl");
    let attempt = args.keeping.attempt(&args.name(), &source.scene, &session)?;
    args.keeping.check()?;
    let keeper = args.keeping.keeper(&attempt, &args.out)?;
    if !args.headless && args.resume.is_none() {
        let is_of_task = |cut_off: &CutOff| {
            let name = cut_off.session.file_name().unwrap_or_default().to_string_lossy().into_owned();
            // The session's own name is offered when it is opened.
            name.starts_with(&format!("{}_", args.name())) && cut_off.session != session
        };
        CutOff::all_in(&args.out).iter().filter(|cut_off| is_of_task(cut_off)).for_each(offer);
    }
    let mut simulation = open_recorded(source, &session, args.resume.as_deref())?;
    keeper.iter().for_each(|keeper| keeper.pass_over(&simulation));
    if let Some(script) = script {
        simulation.follow_script(Box::new(script));
    }
    let Some(listener) = listener else {
        return follow_demonstration(&Followed { args, files, attempt, keeper, scene_folder }, simulation);
    };
    let Some(keeper) = keeper else { return args.address.serve(simulation, listener) };
    args.address.serve_task(simulation, listener, (keeper.watching(), keeper.comparing()))?;
    keeper.finish()
}

/// Follows the demonstration to its end, and writes what came of it.
fn follow_demonstration(followed: &Followed<'_>, mut simulation: Simulation) -> anyhow::Result<()> {
    let is_over = |simulation: &Simulation| simulation.task().is_some_and(|task| task.outcome().is_some());
    let (begin, mut steps) = (Instant::now(), 0_u64);
    while !is_over(&simulation) && !simulation.script_is_over() {
        let input = simulation.scripted_input().context("the demonstration goes on")?;
        simulation.advance(&input)?;
        steps += 1;
    }
    let simulated_s = steps as f64 * simulation.world().spec().time_step_s;
    let real_time_factor = simulated_s / begin.elapsed().as_secs_f64();
    let record = simulation.task().map(TaskRun::record).context("the scene has a task")?;
    let notices: Vec<String> = simulation.notices().iter().map(|notice| notice.text.clone()).collect();
    let state_hash = simulation.finish()?;
    let result = record.result();
    let Followed { args, files, attempt, keeper, scene_folder } = followed;
    let (session, report, numbers) = (files.with(".jsonl"), files.with(".html"), files.with(".json"));
    let attempt = Attempt { finished_at: now_text(), ..attempt.clone() };
    let whole = json!({
        "attempt": attempt, "result": &result, "steps": steps, "real_time_factor": real_time_factor,
        "state_hash": state_hash.to_string(), "notices": notices,
    });
    write_text(&numbers, &format!("{}\n", serde_json::to_string_pretty(&whole)?))?;
    let compared = keeper.as_ref().map(|keeper| {
        // The file and the database tell the same time, so that importing the file stores nothing twice.
        keeper.keep_at(&record, Some(&attempt.finished_at));
        keeper.compare(&record)
    });
    let compared = compared.transpose();
    let mut written = vec![session.clone(), numbers, report.clone()];
    let mut replay = None;
    if args.replay {
        let page = files.with("_replay.html");
        export::write_page(&session, scene_folder, &page)?;
        replay = page.file_name().map(|name| in_address(&name.to_string_lossy()));
        written.push(page);
    }
    let context = ReportContext {
        back: None,
        replay: replay.as_deref(),
        comparison: compared.as_ref().ok().and_then(Option::as_ref),
        note: compared.as_ref().err().map(String::as_str),
    };
    write_text(&report, &task_report(&record, &result, &context))?;
    if args.json {
        println!("{whole}");
    } else {
        print!("{}", task_text(&result));
        println!("real-time factor {real_time_factor:.1}");
        println!("state hash       {state_hash}");
        let written: Vec<String> = written.iter().map(|file| file.display().to_string()).collect();
        println!("written          {}", written.join(", "));
    }
    if let Some(keeper) = keeper {
        keeper.finish()?;
    }
    match result.outcome {
        Some(Outcome::Done) if result.is_passed => Ok(()),
        Some(Outcome::Done) => bail!("the task was done, but beyond its safety gate"),
        Some(Outcome::TimeOver) => bail!("the task was not done within its time"),
        None => bail!("the demonstration ended before the task was done"),
    }
}

/// A file's name in an address: all but letters, digits and a few signs as their bytes.
fn in_address(name: &str) -> String {
    let letter = |byte: u8| match byte {
        b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'-' | b'_' | b'.' | b'~' => char::from(byte).to_string(),
        _ => format!("%{byte:02X}"),
    };
    name.bytes().map(letter).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_with_signs_of_addresses_is_written_as_bytes() {
        assert_eq!(in_address("a b#1?_ä.html"), "a%20b%231%3F_%C3%A4.html");
    }
}
