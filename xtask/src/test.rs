//! `cargo xtask test`: every check, in the order of how soon it can fail.

use crate::{build_program, ct, program, root, run, run_in, setup};
use anyhow::{Context, bail};
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Instant;

/// How long a server may take to say where it is [s]: set-up pre-computes a liver.
const SERVER_START_S: u64 = 120;
/// The optional network, from the workspace's root.
const NET: &str = "glisson-app/net";

/// Stages that ran, and how long each took [s].
#[derive(Default)]
pub(crate) struct Stages {
    done: Vec<(&'static str, f64)>,
}

impl Stages {
    pub(crate) fn run(
        &mut self,
        name: &'static str,
        stage: impl FnOnce() -> anyhow::Result<()>,
    ) -> anyhow::Result<()> {
        println!("\n== {name}");
        let start = Instant::now();
        stage().with_context(|| format!("stage \"{name}\" failed"))?;
        self.done.push((name, start.elapsed().as_secs_f64()));
        Ok(())
    }

    /// Says that all hold, and how long each took.
    pub(crate) fn tell(&self) {
        println!("\nAll stages hold:");
        for (name, seconds) in &self.done {
            println!("  {seconds:7.1} s  {name}");
        }
        let total_s: f64 = self.done.iter().map(|s| s.1).sum();
        println!("  {total_s:7.1} s  in all");
    }
}

/// Runs every check; fails at the first that does not hold.
pub(crate) fn all(require_ct: bool) -> anyhow::Result<()> {
    let mut stages = Stages::default();
    let mut skipped = Vec::new();
    stages.run("format", || run("cargo", &["fmt", "--all", "--check"]))?;
    stages.run("real CT", || match ct::fetch() {
        Ok(_) => Ok(()),
        Err(error) if require_ct => Err(error.context("--require-ct was given")),
        Err(error) => {
            println!("SKIPPED the tests on the real CT: {error:#}");
            skipped.push("real CT");
            Ok(())
        }
    })?;
    stages.run("viewer: types, lint, unit tests, build", viewer)?;
    stages.run("lint", || {
        run("cargo", &["clippy", "--workspace", "--all-targets", "--locked", "--", "-D", "warnings"])
    })?;
    stages.run("lint of the feature net", || {
        let package = ["--package", "glisson-app", "--features", "net", "--all-targets", "--locked"];
        run("cargo", &[&["clippy"], &package[..], &["--", "-D", "warnings"]].concat())
    })?;
    // With zenoh and ROS 2. The release program below is the one without.
    stages.run("unit and integration tests", || tests(&["--workspace", "--features", NET]))?;
    stages.run("documentation's examples", || {
        run("cargo", &["test", "--doc", "--workspace", "--locked", "--features", NET])
    })?;
    stages.run("release build", build_program)?;
    stages.run("full-size tests", || {
        tests(&[
            "--release",
            "--package",
            "glisson-app",
            "--features",
            "full-size-tests",
            "--test",
            "full_size",
        ])
    })?;
    stages.run("demo without a window", || {
        run(&program().to_string_lossy(), &["demo", "--headless", "--out", "out/test/demo"])
    })?;
    stages.run("browser test", || browser(&root().join("out/test/demo/scene.toml")))?;
    stages.tell();
    for name in skipped {
        println!("SKIPPED: {name}");
    }
    Ok(())
}

fn viewer() -> anyhow::Result<()> {
    setup::web_packages()?;
    for script in ["check", "test", "build"] {
        run_in(&root().join("web"), "npm", &["run", script])?;
    }
    Ok(())
}

/// Through nextest where it is installed, else through cargo's own runner.
fn tests(arguments: &[&str]) -> anyhow::Result<()> {
    let nextest =
        Command::new("cargo").args(["nextest", "--version"]).output().is_ok_and(|o| o.status.success());
    let mut all = if nextest { vec!["nextest", "run"] } else { vec!["test"] };
    all.push("--locked");
    all.extend(arguments);
    if !nextest && !arguments.contains(&"--test") {
        all.push("--all-targets");
    }
    run("cargo", &all)
}

/// A run that takes long; its report is committed.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub(crate) enum LongRun {
    /// A million steps of palpation with each model.
    Palpation,
    /// 100,000 random edits.
    Edits,
}

/// Makes a long run of `steps`, or of its own length.
pub(crate) fn soak(what: LongRun, steps: Option<u64>) -> anyhow::Result<()> {
    let (test, file, variables, own_steps) = match what {
        LongRun::Palpation => {
            let variables = ["GLISSON_SOAK_STEPS", "GLISSON_SOAK_REPORT"];
            ("soak::", "docs/soak.md", variables, 1_000_000)
        }
        LongRun::Edits => {
            let variables = ["GLISSON_SOAK_EDITS", "GLISSON_SOAK_EDITS_REPORT"];
            ("soak_edits::", "docs/soak_edits.md", variables, 100_000)
        }
    };
    let (report, steps) = (root().join(file), steps.unwrap_or(own_steps));
    if matches!(what, LongRun::Edits) {
        ct::fetch()?;
    }
    println!("$ cargo test --release --features full-size-tests --test full_size {test} ({steps} steps)");
    let status = Command::new("cargo")
        .args(["test", "--release", "--locked", "--package", "glisson-app"])
        .args(["--features", "full-size-tests", "--test", "full_size", test, "--", "--nocapture"])
        .current_dir(root())
        .env(variables[0], steps.to_string())
        .env(variables[1], &report)
        .status()
        .context("cannot start cargo")?;
    anyhow::ensure!(status.success(), "the soak failed ({status})");
    println!("written to {}", report.display());
    Ok(())
}

/// A running `glisson serve`; stopped when dropped.
struct Server {
    process: Child,
    address: String,
}

impl Server {
    fn start(scene: &Path, more: &[&str]) -> anyhow::Result<Self> {
        let mut process = Command::new(program())
            .args(["serve", "--port", "0", "--no-open"])
            .args(more)
            .arg(scene)
            .current_dir(root())
            .stdout(Stdio::piped())
            .spawn()
            .context("cannot start glisson serve")?;
        let out = process.stdout.take().expect("its output is piped");
        let (tell, told) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            for line in BufReader::new(out).lines().map_while(Result::ok) {
                println!("  serve: {line}");
                if let Some(at) = line.find("http://") {
                    let address = line[at..].split_whitespace().next().unwrap_or("").to_string();
                    // Nobody listens any more once the address was taken or waiting for it ended.
                    let _ = tell.send(address);
                }
            }
        });
        let address = told.recv_timeout(std::time::Duration::from_secs(SERVER_START_S));
        let mut server = Self { process, address: String::new() };
        match address {
            Ok(address) => server.address = address,
            Err(_) => bail!("glisson serve did not tell its address within {SERVER_START_S} s"),
        }
        Ok(server)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn browser(scene: &Path) -> anyhow::Result<()> {
    let chromium = setup::chromium()?;
    // All of it, and dragging again with the page as a device.
    for (tests, more) in [("test:browser", &[][..]), ("test:drag", &["--device", "viewer"])] {
        let server = Server::start(scene, more)?;
        println!("$ npm run {tests} (GLISSON_URL={}) {}", server.address, more.join(" "));
        let status = Command::new("npm")
            .args(["run", tests])
            .current_dir(root().join("web"))
            .env("GLISSON_URL", &server.address)
            .env("CHROMIUM", &chromium)
            .status()
            .context("cannot start npm")?;
        anyhow::ensure!(status.success(), "the browser test failed ({status}): {tests} {}", more.join(" "));
    }
    Ok(())
}
