//! The newcomer's two commands, `cargo xtask demo` and `cargo xtask test`, and what they need.
//!
//! Both do all the set-up: npm packages, and through the system's package manager, when run as root, Chromium and
//! pip; otherwise they say exactly what to install.
#![allow(clippy::print_stdout, reason = "a command-line program tells what it does on standard output")]

mod ct;
mod igtl;
mod images;
mod metrics;
mod netns;
mod network;
mod peers;
mod python;
mod release;
mod ros2;
mod served;
mod setup;
mod test;
mod web;

use anyhow::Context;
use clap::{Parser, Subcommand};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus};
use std::time::{Duration, Instant};

#[derive(Parser)]
#[command(name = "cargo xtask", about = "The two commands a newcomer needs, and the longer ones")]
struct CommandLine {
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    /// Build everything, make the synthetic patient and push its liver in the browser
    Demo {
        /// Arguments of `glisson demo`, such as --headless --out DIR
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
    /// Format, lint, and run every test: library, program, page, browser and real CT
    Test {
        /// Fail instead of skipping when the real CT cannot be fetched
        #[arg(long)]
        require_ct: bool,
        /// Fail instead of skipping when the simulation cannot be compiled for browsers
        #[arg(long)]
        require_web: bool,
    },
    /// Compile the simulation for browsers (WebAssembly) into web/wasm. Programs that are built afterwards hold it, and `glisson export`
    /// makes a page of a scene that simulates it without a server
    Web,
    /// The long runs: palpation (a million steps with each model, replayed), edits (20,000 random cuts, grasps and
    /// tears: 200 seeds over all models that can be cut, their laws and scenes), and page-tasks (every task's demonstration in front of a
    /// page); the first two write docs/soak.md and docs/soak_edits.md. With GLISSON_SOAK_EDITS_LOG=FILE the seeds of edits that ended
    /// are kept there, and a run that was stopped goes on after them; a log of other seeds, or of a version that made
    /// other edits, is refused. GLISSON_SOAK_EDITS_SEEDS=N spreads the edits over N seeds, GLISSON_SOAK_EDITS_SEED=N runs one alone
    Soak {
        /// Which one
        #[arg(value_enum, default_value_t = test::LongRun::Palpation)]
        what: test::LongRun,
        /// Steps with each model, or edits altogether
        #[arg(long)]
        steps: Option<u64>,
    },
    /// The network: builds with the feature `net` and tests links over UDP and zenoh (with TLS, and between two processes
    /// whose link is cut), ROS 2's topics, and the OpenIGTLink server with clients of other people (Debian's examples and
    /// pyigtl, which it installs where it may)
    Network {
        /// A scene to show them, such as out/demo/scene.toml; one of its own for none
        scene: Option<PathBuf>,
        /// Fail instead of skipping what cannot be had or run here
        #[arg(long)]
        require: bool,
    },
    /// The implicit step beside rapier3d's soft body and MuJoCo's flex, which it installs from their registries; it writes docs/peers.md
    /// with its plot. Not a part of the tests
    Peers {
        /// Sizes in tetrahedra
        #[arg(long, value_delimiter = ',', default_values_t = [2_000, 6_300, 20_000, 50_000, 100_000])]
        sizes: Vec<usize>,
        /// Time for each figure [s]
        #[arg(long, default_value_t = 10.0)]
        seconds: f64,
    },
    /// Image and mesh files against SimpleITK, nibabel, pydicom (with its sample files) and meshio, and CGAL's liver from
    /// file to running simulation; it installs them into a folder of its own. `test` does all of it but CGAL's liver
    Images,
    /// The metrics of smoothness against monalysa, which it installs into a folder of its own; `test` does it, too
    Metrics,
    /// The Python package: builds its module with the release program and runs its tests; `test` does it, too
    Python,
    /// Environment steps a second of the Python package, beside MuJoCo's flex and Newton's soft body, which it installs.
    /// Not a part of the tests
    BenchPython {
        /// What else its script is asked (see crates/glisson-py/benches/environments.py)
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
    /// Learn an environment of the Python package with PPO of Stable-Baselines3, which it installs: curve, policy and success in out/learn.
    /// Not a part of the tests
    Learn {
        /// What its script is asked: an environment, and options (see crates/glisson-py/examples/learn.py)
        #[arg(trailing_var_arg = true, allow_hyphen_values = true, required = true)]
        arguments: Vec<String>,
    },
    /// Make the Python package's wheel, and try it in a clean environment of each Python that is found (3.10 to 3.14)
    Wheel,
    /// Make the files of a release in target/release-files: licences of all that is linked, what the program is made of (CycloneDX), a
    /// Debian package, the root of a container, the crates, each compiled from what it holds alone, the wheel, and their sums. It
    /// installs the cargo commands that it needs into target/tools
    Release {
        /// The next version: writes it into the manifests, and what is unreleased in the changelog under it
        #[arg(required_unless_present = "dry_run")]
        version: Option<String>,
        /// Of the version that is there, and nothing is written into the tree
        #[arg(long, conflicts_with = "version")]
        dry_run: bool,
        /// Without the wheel and the check of the crates, for which everything is compiled again
        #[arg(long)]
        no_wheel: bool,
    },
    /// Fetch the real CT that the tests use into data/ct (nothing of it enters the repository)
    FetchCt,
}

/// The workspace's root folder.
fn root() -> PathBuf {
    let own = Path::new(env!("CARGO_MANIFEST_DIR"));
    own.parent().expect("xtask lies in the workspace").to_path_buf()
}

/// A program without what cargo told this one about its own package: build scripts that look at it (ring's) would run again,
/// and all that depends on them be compiled again, at every change between here and a shell.
fn command(program: &str) -> Command {
    let mut command = Command::new(program);
    for (name, _) in std::env::vars_os() {
        let is_own =
            ["CARGO_PKG_", "CARGO_MANIFEST_", "CARGO_BIN_", "CARGO_CRATE_NAME", "CARGO_PRIMARY_PACKAGE"]
                .iter()
                .any(|own| name.to_string_lossy().starts_with(own));
        if is_own {
            command.env_remove(name);
        }
    }
    command
}

/// Runs a program in the workspace's root and fails when it does.
fn run(program: &str, arguments: &[&str]) -> anyhow::Result<()> {
    run_in(&root(), program, arguments)
}

fn run_in(folder: &Path, program: &str, arguments: &[&str]) -> anyhow::Result<()> {
    println!("$ {program} {}", arguments.join(" "));
    let status = command(program)
        .args(arguments)
        .current_dir(folder)
        .status()
        .with_context(|| format!("cannot start {program}; is it installed?"))?;
    anyhow::ensure!(status.success(), "`{program} {}` failed ({status})", arguments.join(" "));
    Ok(())
}

/// Runs a program in the workspace's root, and fails when it does or takes longer than `limit`.
fn run_within(limit: Duration, program: &str, arguments: &[&str]) -> anyhow::Result<()> {
    println!("$ {program} {}  (at most {} s)", arguments.join(" "), limit.as_secs());
    let mut process = command(program)
        .args(arguments)
        .current_dir(root())
        .spawn()
        .with_context(|| format!("cannot start {program}; is it installed?"))?;
    let status = finished_within(limit, &mut process)?;
    let status = status.with_context(|| {
        format!(
            "`{program} {}` did not end within {} s and was stopped",
            arguments.join(" "),
            limit.as_secs()
        )
    })?;
    anyhow::ensure!(status.success(), "`{program} {}` failed ({status})", arguments.join(" "));
    Ok(())
}

/// How the process ended; none when it had to be stopped.
fn finished_within(limit: Duration, process: &mut Child) -> anyhow::Result<Option<ExitStatus>> {
    let end = Instant::now() + limit;
    while Instant::now() < end {
        if let Some(status) = process.try_wait()? {
            return Ok(Some(status));
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    process.kill()?;
    process.wait()?;
    Ok(None)
}

/// How long a compiler of one file or a package manager may take.
const INSTALLING: Duration = Duration::from_secs(300);

/// Installs Python packages into a folder of their own.
fn pip_install(python: &str, folder: &str, packages: &[&str]) -> anyhow::Result<()> {
    let arguments = ["-m", "pip", "install", "--quiet", "--upgrade", "--target", folder];
    run_within(INSTALLING, python, &[&arguments[..], packages].concat())
}

/// The folder that cargo builds into.
fn target() -> PathBuf {
    std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), PathBuf::from)
}

/// The release program.
fn program() -> PathBuf {
    target().join("release").join(format!("glisson{}", std::env::consts::EXE_SUFFIX))
}

/// Builds the viewer, then the release program that holds it.
fn build_all() -> anyhow::Result<()> {
    setup::web_packages()?;
    run_in(&root().join("web"), "npm", &["run", "build"])?;
    build_program()
}

fn build_program() -> anyhow::Result<()> {
    run("cargo", &["build", "--release", "--locked", "--package", "glisson-cli"])
}

fn main() -> anyhow::Result<()> {
    match CommandLine::parse().task {
        Task::Demo { arguments } => {
            build_all()?;
            let program = program();
            let mut all = vec!["demo"];
            all.extend(arguments.iter().map(String::as_str));
            run(&program.to_string_lossy(), &all)
        }
        Task::Test { require_ct, require_web } => test::all(require_ct, require_web),
        Task::Web => web::build(),
        Task::Soak { what, steps } => test::soak(what, steps),
        Task::Network { scene, require } => {
            let scene = scene.map(|scene| root().join(scene));
            network::all(&network::Request { scene: scene.as_deref(), requires_all: require })
        }
        Task::Images => {
            build_program()?;
            images::check(&images::install()?, true)
        }
        Task::Metrics => metrics::check(&metrics::install()?),
        Task::Python => {
            python::build()?;
            python::check(&python::install()?)
        }
        Task::BenchPython { arguments } => {
            python::build()?;
            python::bench(&arguments)
        }
        Task::Learn { arguments } => {
            python::build()?;
            python::learn(&arguments)
        }
        Task::Wheel => python::wheel(),
        Task::Release { version, dry_run: _, no_wheel } => release::make(version.as_deref(), !no_wheel),
        Task::Peers { sizes, seconds } => peers::measure(&sizes, seconds),
        Task::FetchCt => {
            let folder = ct::fetch()?;
            println!("real CT in {}", folder.display());
            Ok(())
        }
    }
}
