//! `cargo xtask test`: every check, in the order of how soon it can fail.

use crate::served::Served;
use crate::{ct, images, metrics, program, python, root, run, run_in, setup, web};
use anyhow::Context;
use std::ffi::OsStr;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

/// How long a server may take to say where it is: set-up pre-computes a liver.
pub(crate) const SERVER_START: Duration = Duration::from_secs(120);

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
pub(crate) fn all(require_ct: bool, require_web: bool) -> anyhow::Result<()> {
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
    stages.run("ffmpeg", setup::ffmpeg)?;
    stages.run("simulation for browsers", || match web::build() {
        Ok(()) => Ok(()),
        Err(error) if require_web => Err(error.context("--require-web was given")),
        Err(error) => {
            println!("SKIPPED the simulation for browsers: {error:#}");
            skipped.push("simulation for browsers");
            Ok(())
        }
    })?;
    stages.run("viewer: types, lint, unit tests, build", viewer)?;
    // Without zenoh and ROS 2, 200 more packages: `cargo xtask network` has those.
    stages.run("lint", || {
        let lint = |what: &[&str]| {
            let common = ["clippy", "--workspace", "--locked"];
            run("cargo", &[&common[..], what, &["--", "-D", "warnings"]].concat())
        };
        lint(&["--all-targets"])?;
        // They are no target of all, but run where they are asked for by name.
        lint(&["--test", "full_size"])
    })?;
    stages.run("unit and integration tests", || tests(&["--workspace", "--tests"]))?;
    stages.run("documentation's examples", || run("cargo", &["test", "--doc", "--workspace", "--locked"]))?;
    stages.run("release build", python::build)?;
    stages.run("full-size tests", || {
        tests(&["--release", "--package", "glisson-cli", "--package", "glisson-py", "--test", "full_size"])
    })?;
    // With programs that are fetched: without a network there is nothing to compare with.
    let comparisons: [(&str, Install, Compare); 3] = [
        ("the Python package", python::install, python::check),
        ("image files against other programs", images::install, |python| images::check(python, false)),
        ("metrics against another program", metrics::install, metrics::check),
    ];
    for (name, install, compare) in comparisons {
        stages.run(name, || match install() {
            Ok(python) => compare(&python),
            Err(error) if require_ct => Err(error.context("--require-ct was given")),
            Err(error) => {
                println!("SKIPPED {name}: {error:#}");
                skipped.push(name);
                Ok(())
            }
        })?;
    }
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

/// Installs what to compare with; answers with the Python that has it.
type Install = fn() -> anyhow::Result<String>;

/// Compares, with that Python.
type Compare = fn(&str) -> anyhow::Result<()>;

/// Through nextest where it is installed, else through cargo's own runner.
fn tests(arguments: &[&str]) -> anyhow::Result<()> {
    let nextest =
        Command::new("cargo").args(["nextest", "--version"]).output().is_ok_and(|o| o.status.success());
    let mut all = if nextest { vec!["nextest", "run"] } else { vec!["test"] };
    all.push("--locked");
    all.extend(arguments);
    run("cargo", &all)
}

/// A run that takes long; its report is committed.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub(crate) enum LongRun {
    /// A million steps of palpation with each model.
    Palpation,
    /// 20,000 random edits: 200 seeds over all models that can be cut.
    Edits,
    /// Every task's demonstration in front of a page; `test` shows some of them.
    PageTasks,
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
            ("soak_edits::", "docs/soak_edits.md", variables, 20_000)
        }
        LongRun::PageTasks => {
            python::build()?;
            setup::web_packages()?;
            run_in(&root().join("web"), "npm", &["run", "build"])?;
            return tasks(&setup::chromium()?, "all");
        }
    };
    let (report, steps) = (root().join(file), steps.unwrap_or(own_steps));
    if matches!(what, LongRun::Edits) {
        ct::fetch()?;
    }
    println!("$ cargo test --release --test full_size {test} ({steps} steps)");
    let status = Command::new("cargo")
        .args(["test", "--release", "--locked", "--package", "glisson-cli"])
        .args(["--test", "full_size", test, "--", "--nocapture"])
        .current_dir(root())
        .env(variables[0], steps.to_string())
        .env(variables[1], &report)
        .status()
        .context("cannot start cargo")?;
    anyhow::ensure!(status.success(), "the soak failed ({status})");
    println!("written to {}", report.display());
    Ok(())
}

fn browser(scene: &Path) -> anyhow::Result<()> {
    let chromium = setup::chromium()?;
    // All of it, and dragging again with the page as a device.
    for (tests, more) in [("test:browser", &[][..]), ("test:drag", &["--device", "viewer"])] {
        let server = Served::serve(&program(), scene, more)?;
        let address = format!("http://{}", server.says_after("http://", SERVER_START)?);
        let out = scene.with_file_name("patient");
        if out.exists() {
            std::fs::remove_dir_all(&out).with_context(|| out.display().to_string())?;
        }
        let patient = Served::patient(&program(), &out)?;
        let patient_address = format!("http://{}", patient.says_after("http://", SERVER_START)?);
        println!("$ npm run {tests} (GLISSON_URL={address}) {}", more.join(" "));
        let status = Command::new("npm")
            .args(["run", tests])
            .current_dir(root().join("web"))
            .env("GLISSON_URL", &address)
            .env("GLISSON_PATIENT_URL", &patient_address)
            .env("GLISSON_PATIENT_OUT", &out)
            .env("GLISSON_CT", scene.with_file_name("ct.nii.gz"))
            .env("CHROMIUM", &chromium)
            .status()
            .context("cannot start npm")?;
        anyhow::ensure!(status.success(), "the browser test failed ({status}): {tests} {}", more.join(" "));
    }
    theatre(scene, &chromium)?;
    tasks(&chromium, "usual")?;
    start(&chromium)?;
    accessibility(&chromium)?;
    replay(scene, &chromium)
}

/// A recorded task as one file, opened from disk.
fn replay(demo_scene: &Path, chromium: &Path) -> anyhow::Result<()> {
    let out = demo_scene.with_file_name("tasks");
    let (session, page) = (out.join("palpation.jsonl"), out.join("palpation.replay.html"));
    let [out, session, page_name] = [&out, &session, &page].map(|path| path.to_string_lossy());
    let program = program();
    let program = program.to_string_lossy();
    run(&program, &["task", "run", "palpation", "--headless", "--out", &out])?;
    run(&program, &["export", &session, "--html", &page_name, "--check"])?;
    browser_test("test:replay", chromium, &[("GLISSON_REPLAY", root().join(&page).as_os_str())])
}

/// The view through an endoscope, of the same liver in a scene of its own.
fn theatre(demo_scene: &Path, chromium: &Path) -> anyhow::Result<()> {
    let scene = demo_scene.with_file_name("theatre.toml");
    std::fs::copy(root().join("web/e2e/theatre.toml"), &scene)
        .with_context(|| scene.display().to_string())?;
    let server = Served::serve(&program(), &scene, &[])?;
    let address = format!("http://{}", server.says_after("http://", SERVER_START)?);
    browser_test("test:theatre", chromium, &[("GLISSON_THEATRE_URL", address.as_ref())])
}

/// Tasks that come with the program, each done by its demonstration in front of a page: the usual ones, or all.
fn tasks(chromium: &Path, which: &str) -> anyhow::Result<()> {
    let program = root().join(program());
    browser_test(
        "test:tasks",
        chromium,
        &[("GLISSON_PROGRAM", program.as_os_str()), ("GLISSON_TASKS", which.as_ref())],
    )
}

/// The page that one begins with: to a task, to a new patient, and back; what a laboratory has beside the picture; a class; and the page
/// that has its simulation in itself.
fn start(chromium: &Path) -> anyhow::Result<()> {
    let program = root().join(program());
    ["test:start", "test:laboratory", "test:class", "test:local"]
        .into_iter()
        .try_for_each(|tests| browser_test(tests, chromium, &[("GLISSON_PROGRAM", program.as_os_str())]))
}

/// What axe-core finds on every page.
fn accessibility(chromium: &Path) -> anyhow::Result<()> {
    browser_test("test:accessibility", chromium, &[("GLISSON_PROGRAM", root().join(program()).as_os_str())])
}

/// Runs a browser test with what it needs to know.
fn browser_test(tests: &str, chromium: &Path, variables: &[(&str, &OsStr)]) -> anyhow::Result<()> {
    let told: Vec<String> =
        variables.iter().map(|(name, value)| format!("{name}={}", value.display())).collect();
    println!("$ npm run {tests} ({})", told.join(" "));
    let status = Command::new("npm")
        .args(["run", tests])
        .current_dir(root().join("web"))
        .envs(variables.iter().copied())
        .env("CHROMIUM", chromium)
        .status()
        .context("cannot start npm")?;
    anyhow::ensure!(status.success(), "the browser test failed ({status}): {tests}");
    Ok(())
}
