//! The verbs of the program, one file each.

mod image_input;
mod output;
mod numbers;
mod progress;
mod task_text;
mod phantom;
mod import;
mod slice_contours;
mod segment;
mod mesh;
mod mesh_organs;
mod fit_simplex;
mod repair;
mod check;
mod precompute;
mod solve;
mod fit;
mod run;
mod held;
mod resuming;
mod serve;
mod patient;
mod watch;
mod device_page;
mod devices;
mod replay;
pub(crate) mod export;
mod results_text;
mod results;
mod task_keeping;
mod task;
mod cohort;
mod start;
mod bench;
mod validate;
mod demo;

/// Real-time soft-tissue surgery simulation, from a patient's image to an organ one can push.
#[derive(Debug, clap::Parser)]
#[command(name = "glisson", version, arg_required_else_help = true)]
pub(crate) struct CommandLine {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    Phantom(phantom::Args),
    Import(import::Args),
    Segment(segment::Args),
    Mesh(mesh::Args),
    MeshOrgans(mesh_organs::Args),
    FitSimplex(fit_simplex::Args),
    Repair(repair::Args),
    Check(check::Args),
    Precompute(precompute::Args),
    Solve(solve::Args),
    Fit(fit::Args),
    Run(run::Args),
    Serve(serve::Args),
    Patient(patient::Args),
    Task(task::Args),
    Start(start::Args),
    Results(results::Args),
    Cohort(cohort::Args),
    Watch(watch::Args),
    Devices(devices::Args),
    Replay(replay::Args),
    Export(export::Args),
    Bench(bench::Args),
    Validate(validate::Args),
    Demo(demo::Args),
}

/// Does what the command line asks for.
pub(crate) fn run(command_line: &CommandLine) -> anyhow::Result<()> {
    match &command_line.command {
        Command::Phantom(args) => phantom::run(args),
        Command::Import(args) => import::run(args),
        Command::Segment(args) => segment::run(args),
        Command::Mesh(args) => mesh::run(args),
        Command::MeshOrgans(args) => mesh_organs::run(args),
        Command::FitSimplex(args) => fit_simplex::run(args),
        Command::Repair(args) => repair::run(args),
        Command::Check(args) => check::run(args),
        Command::Precompute(args) => precompute::run(args),
        Command::Solve(args) => solve::run(args),
        Command::Fit(args) => fit::run(args),
        Command::Run(args) => run::run(args),
        Command::Serve(args) => serve::run(args),
        Command::Patient(args) => patient::run(args),
        Command::Task(args) => task::run(args),
        Command::Start(args) => start::run(args),
        Command::Results(args) => results::run(args),
        Command::Cohort(args) => cohort::run(args),
        Command::Watch(args) => watch::run(args),
        Command::Devices(args) => devices::run(args),
        Command::Replay(args) => replay::run(args),
        Command::Export(args) => export::run(args),
        Command::Bench(args) => bench::run(args),
        Command::Validate(args) => validate::run(args),
        Command::Demo(args) => demo::run(args),
    }
}
