//! `glisson run`.

use super::task_text::task_text;
use crate::text_file::write_text;
use anyhow::bail;
use glisson::scene::Scene;
use glisson::world::{StepInput, StepReport, World};
use glisson_runtime::account::Account;
use glisson_runtime::{OpenScene, Simulation};
use serde_json::json;
use std::path::PathBuf;
use std::time::Instant;

/// Run a scene without a window and record the session.
///
/// The tool follows the path of the scene; without one it stays at home.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  glisson run out/demo/scene.toml --record session.jsonl\n  \
    glisson run scene.toml --steps 10000 --csv force.csv --json")]
pub(crate) struct Args {
    /// Scene file (TOML)
    scene: PathBuf,
    /// Steps to make; to the end of the tool's path if not given
    #[arg(long)]
    steps: Option<u64>,
    /// Record the session to this file
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// Threads of the explicit model; the results do not depend on it
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=64))]
    threads: u8,
    /// Write time, tool tip and force of every step as CSV
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let source = OpenScene { n_threads: usize::from(args.threads), ..OpenScene::read(&args.scene)? };
    let scene = source.scene.clone();
    let steps = match (args.steps, scene.end_of_paths_s()) {
        (Some(steps), _) => steps,
        (None, Some(end_s)) => (end_s / scene.world.time_step_s).ceil() as u64,
        (None, None) => bail!("the scene has no [[tool.path]] to follow; say how long with --steps"),
    };
    let mut simulation = Simulation::open(source, args.record.as_deref())?;
    let mut done = Done::new(&scene, args.csv.is_some());
    let start = Instant::now();
    let made = (1..=steps).try_for_each(|step| {
        let (input, report) = simulation.follow_paths(&scene, step)?;
        done.add(step, &input, &report);
        Ok(())
    });
    let elapsed_s = start.elapsed().as_secs_f64();
    // What there is up to a step that broke is told, too.
    if let Some(csv) = &args.csv {
        write_text(csv, &done.rows)?;
    }
    for notice in simulation.notices() {
        eprintln!("{}", notice.text);
    }
    made.and_then(|()| tell(args, simulation, &done, elapsed_s))
}

/// What a run felt.
struct Done {
    n_tools: usize,
    time_step_s: f64,
    steps: u64,
    greatest_force_n: f64,
    contact_steps: u64,
    /// Deepest overlap of bodies in any step, before it was undone [m].
    deepest_overlap_m: f64,
    wants_rows: bool,
    /// A line of the CSV file for each step.
    rows: String,
}

impl Done {
    fn new(scene: &Scene, wants_rows: bool) -> Self {
        let mut rows = String::from("time_s,tip_x_m,tip_y_m,tip_z_m,force_x_n,force_y_n,force_z_n,contact");
        // Those of further tools follow in the same line.
        for tool in 2..=scene.world.tools.len() {
            let columns = ["tip_x_m", "tip_y_m", "tip_z_m", "force_x_n", "force_y_n", "force_z_n", "contact"];
            columns.iter().for_each(|column| rows += &format!(",{column}_{tool}"));
        }
        rows += "\n";
        let (n_tools, time_step_s) = (scene.world.tools.len(), scene.world.time_step_s);
        Self {
            n_tools,
            time_step_s,
            steps: 0,
            greatest_force_n: 0.0,
            contact_steps: 0,
            deepest_overlap_m: 0.0,
            wants_rows,
            rows,
        }
    }

    fn add(&mut self, step: u64, input: &StepInput, report: &StepReport) {
        self.steps = step;
        let felt = &report.tools[..self.n_tools];
        let forces_n = felt.iter().map(|tool| tool.force_on_tool_n.length());
        self.greatest_force_n = forces_n.fold(self.greatest_force_n, f64::max);
        self.contact_steps += u64::from(report.in_contact());
        self.deepest_overlap_m = self.deepest_overlap_m.max(report.self_contact.penetration_m);
        if !self.wants_rows {
            return;
        }
        self.rows += &(step as f64 * self.time_step_s).to_string();
        for (tool, felt) in input.tools.iter().zip(felt) {
            let (tip, force) = (tool.tip_in_world_m, felt.force_on_tool_n);
            for number in [tip.x, tip.y, tip.z, force.x, force.y, force.z] {
                self.rows += &format!(",{number}");
            }
            self.rows += &format!(",{}", u8::from(felt.in_contact));
        }
        self.rows += "\n";
    }
}

/// Name of each of several bodies, whether it is rigid, and its tetrahedra at the start.
fn bodies_of(world: &World) -> Vec<(String, bool, usize)> {
    let bodies = world.spec().bodies.iter();
    bodies.map(|body| (body.name.clone(), body.is_rigid, body.tetrahedra.len())).collect()
}

/// Ends the recording and tells how it went.
fn tell(args: &Args, simulation: Simulation, done: &Done, elapsed_s: f64) -> anyhow::Result<()> {
    let Done { steps, greatest_force_n, contact_steps, .. } = *done;
    let model = simulation.world().model_kind().name();
    let account = Account::of(simulation.world());
    let bodies = bodies_of(simulation.world());
    let task = simulation.task().map(|task| task.record().result());
    let state_hash = simulation.finish()?;
    let simulated_s = steps as f64 * done.time_step_s;
    if args.json {
        println!(
            "{}",
            json!({
                "steps": steps, "model": model, "simulated_s": simulated_s, "elapsed_s": elapsed_s,
                "real_time_factor": simulated_s / elapsed_s, "greatest_force_n": greatest_force_n,
                "contact_steps": contact_steps, "state_hash": state_hash.to_string(),
                "account": account.to_json(),
                "bodies": bodies.iter().map(|(name, is_rigid, n_tets)| json!({
                    "name": name, "is_rigid": is_rigid, "n_tetrahedra": n_tets,
                })).collect::<Vec<_>>(),
                "deepest_overlap_m": done.deepest_overlap_m,
                "task": task,
            })
        );
    } else {
        println!("steps            {steps} ({simulated_s:.3} s simulated in {elapsed_s:.3} s, {model})");
        println!("real-time factor {:.1}", simulated_s / elapsed_s);
        println!("greatest force   {greatest_force_n:.3} N; contact in {contact_steps} steps");
        print!("{}", account.to_text());
        for (name, is_rigid, n_tets) in &bodies {
            let sort = if *is_rigid { "rigid" } else { "deforms" };
            println!("body             {name}: {sort}, {n_tets} tetrahedra");
        }
        if !bodies.is_empty() {
            println!("deepest overlap  {:.3} mm, before it was undone", 1e3 * done.deepest_overlap_m);
        }
        println!("state hash       {state_hash}");
        if let Some(task) = &task {
            print!("\n{}", task_text(task));
        }
    }
    Ok(())
}
