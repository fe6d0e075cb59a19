//! `glisson demo`.

use super::serve::Address;
use crate::demo::{bed, operation, report, resection, scenery};
use anyhow::Context;
use clap::Parser;
use glisson_runtime::{OpenScene, Simulation};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// From a synthetic patient's image to an organ one can push.
///
/// Makes the patient's CT, finds the liver in it, meshes it, prepares the model, and serves the viewer; with
/// --headless runs a scripted palpation instead and writes pictures, plots, a report and a session.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  glisson demo\n  glisson demo --headless --out out/demo\n  \
    glisson demo --task resection --headless\n  \
    glisson demo --task bed --headless\n  \
    glisson demo --seed 7 --tetrahedra 20000 --port 0")]
pub(crate) struct Args {
    /// Folder for everything that is made
    #[arg(long, default_value = "out/demo", value_name = "DIR")]
    out: PathBuf,
    /// Run a scripted palpation without a window and write pictures, plots, a report and a session
    #[arg(long)]
    headless: bool,
    /// Which synthetic patient
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// What is done to the liver
    #[arg(long, value_enum, default_value_t = Task::Palpation)]
    task: Task,
    /// Tetrahedra of the liver
    #[arg(long, default_value_t = 6300)]
    tetrahedra: usize,
    #[command(flatten)]
    address: Address,
}

/// An operation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Task {
    /// A probe pushes the liver.
    Palpation,
    /// Two hands take a tumour out.
    Resection,
    /// It lies on its bed among other bodies, and nothing else holds it.
    Bed,
}

/// Runs another verb of this program, telling the command line so that the reader can repeat it.
fn verb(stages: &mut Vec<report::Stage>, words: &[&str]) -> anyhow::Result<()> {
    let command = format!("glisson {}", words.join(" "));
    println!("\n$ {command}");
    let start = Instant::now();
    let parsed = super::CommandLine::try_parse_from(std::iter::once("glisson").chain(words.iter().copied()))
        .context("the demo's own command line")?;
    super::run(&parsed)?;
    stages.push(report::Stage { command, elapsed_s: start.elapsed().as_secs_f64() });
    Ok(())
}

fn text(path: &Path) -> anyhow::Result<&str> {
    path.to_str().with_context(|| format!("{}: the path is not Unicode", path.display()))
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    // A taken port is better known before the work than after it.
    let listener = if args.headless { None } else { Some(args.address.bind()?) };
    std::fs::create_dir_all(&args.out)
        .with_context(|| format!("{}: cannot make the folder", args.out.display()))?;
    if args.task == Task::Bed {
        return on_bed(args, listener);
    }
    let files = scenery::Files::in_folder(&args.out);
    let (seed, tetrahedra) = (args.seed.to_string(), args.tetrahedra.to_string());
    let mut stages = Vec::new();
    let (ct, truth) = (text(&files.ct)?, text(&files.labels)?);
    let (liver_label, mesh) = (text(&files.liver_label)?, text(&files.mesh)?);
    verb(&mut stages, &["phantom", "--seed", &seed, "--out", text(&args.out)?])?;
    verb(&mut stages, &["segment", ct, "--truth", truth, "-o", liver_label])?;
    let surface = text(&files.surface)?;
    verb(
        &mut stages,
        &[
            "mesh",
            liver_label,
            "--label",
            "liver",
            "--tetrahedra",
            &tetrahedra,
            "--surface-out",
            surface,
            "-o",
            mesh,
        ],
    )?;
    verb(&mut stages, &["check", mesh, "--svg", text(&files.quality_plot)?])?;
    if args.task == Task::Resection {
        return resect(args, &files, listener);
    }
    scenery::write_scene(&files)?;
    verb(&mut stages, &["precompute", text(&files.scene)?, "-o", text(&files.precomputed)?])?;
    if let Some(listener) = listener {
        println!("\n$ glisson serve {}", files.scene.display());
        let simulation = Simulation::open(OpenScene::read(&files.scene)?, Some(&files.session))?;
        return args.address.serve(simulation, listener);
    }
    println!("\nscripted palpation");
    let palpation = operation::palpate(&files)?;
    report::write(&files, &stages, &palpation)?;
    println!("\nwritten to {}: look at report.md and the pictures", args.out.display());
    Ok(())
}

/// Serves the liver on its bed, or lets it lie without a window.
fn on_bed(args: &Args, listener: Option<TcpListener>) -> anyhow::Result<()> {
    let scene = bed::write_scene(&args.out, args.tetrahedra)?;
    if let Some(listener) = listener {
        println!("\n$ glisson serve {}", scene.display());
        return args.address.serve(bed::open(&scene)?, listener);
    }
    bed::lie(&scene)
}

/// Serves the resection, or operates without a window.
fn resect(args: &Args, files: &scenery::Files, listener: Option<TcpListener>) -> anyhow::Result<()> {
    resection::write_scene(files)?;
    let scene = resection::scene_file(files);
    if let Some(listener) = listener {
        println!("\n$ glisson serve {}", scene.display());
        let simulation = resection::begin(files)?;
        return args.address.serve(simulation, listener);
    }
    println!("\nscripted resection");
    let resection = resection::operate(files)?;
    anyhow::ensure!(
        resection.tumour_in_specimen == 1.0,
        "the piece that was lifted holds {:.2} % of the tumour only",
        100.0 * resection.tumour_in_specimen
    );
    if resection.margin_m <= 0.0 {
        println!("the cut comes to the tumour: its least distance is {:.1} mm", 1e3 * resection.margin_m);
    }
    println!(
        "written to {}: look at resection.md and the pictures; state {}",
        args.out.display(),
        resection.state_hash
    );
    Ok(())
}
