//! The Python package: its tests, and the wheel that others install.

use crate::{pip_install, program, root, run, run_within, setup, target};
use anyhow::{Context, ensure};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// What the tests need beside the package.
const PACKAGES: [&str; 8] = [
    "numpy==2.2.6",
    "gymnasium==1.4.0",
    "pettingzoo==1.27.0",
    "pytest==9.0.1",
    "mypy==2.4.1",
    "pyarrow==26.0.1",
    "ray==2.60.0",
    "meshio==5.3.5",
];
/// What learning needs beside it.
const LEARNING: [&str; 3] = ["stable-baselines3==2.9.2", "torch==2.15.0", "gymnasium==1.4.0"];
/// Newton, and what it runs on; like the package they are for Python 3.10 or later.
const NEWTON: [&str; 2] = ["newton==1.8.0", "warp-lang==1.19.0"];
const MATURIN: &str = "maturin==1.16.0";
/// Where the package lies in the repository.
const SOURCE: &str = "crates/glisson-py";
/// How long the tests may take.
const CHECKING: Duration = Duration::from_secs(600);
/// How long making a wheel may take: everything is compiled for it.
const MAKING: Duration = Duration::from_secs(1800);
/// Pythons that are looked for, the newest first, down to the oldest that the package is for.
const PYTHONS: [&str; 5] = ["python3.14", "python3.13", "python3.12", "python3.11", "python3.10"];

/// Where everything is kept.
fn folder() -> PathBuf {
    target().join("python-check")
}

/// Builds the module and the release program, so that what both need is compiled once.
pub(crate) fn build() -> anyhow::Result<()> {
    run("cargo", &["build", "--release", "--locked", "--package", "glisson-cli", "--package", "glisson-py"])
}

/// Installs what the tests need; answers with the Python that has it.
pub(crate) fn install() -> anyhow::Result<String> {
    let python = setup::require(&["python3", "python"], "python3", "checking the Python package")?;
    let is_enough = ["-c", "import sys; sys.exit(sys.version_info < (3, 10))"];
    ensure!(run(&python, &is_enough).is_ok(), "the Python package is for Python 3.10 or later: install one");
    let packages = folder().join("packages");
    if !packages.join("meshio").exists() {
        pip_install(&python, &packages.to_string_lossy(), &PACKAGES)?;
    }
    Ok(python)
}

/// Runs the tests on the module that was built with the release program, with the Python of [`install`].
pub(crate) fn check(python: &str) -> anyhow::Result<()> {
    let words = words_for(python, &folder().join("packages"))?;
    let with_words = |more: &[&str]| {
        run_within(CHECKING, "env", &[&words.each_ref().map(String::as_str)[..], more].concat())
    };
    let tests = root().join(SOURCE).join("tests").to_string_lossy().into_owned();
    with_words(&["-m", "pytest", "-q", "-p", "no:cacheprovider", "--durations=5", &tests])?;
    // Its types, as its users check theirs against them.
    let package = root().join(module()).to_string_lossy().into_owned();
    let cache = folder().join("mypy").to_string_lossy().into_owned();
    with_words(&["-m", "mypy", "--strict", "--no-error-summary", "--cache-dir", &cache, &package])
}

/// Measures the environments.
pub(crate) fn bench(arguments: &[String]) -> anyhow::Result<()> {
    let python = setup::require(&["python3", "python"], "python3", "measuring the Python package")?;
    let packages = folder().join("bench");
    if !["mujoco", "newton"].iter().all(|name| packages.join(name).exists()) {
        let mujoco = format!("mujoco-core=={}", crate::peers::MUJOCO);
        let others = [&[mujoco.as_str()][..], &NEWTON[..]].concat();
        pip_install(&python, &packages.to_string_lossy(), &[&PACKAGES[..], &others[..]].concat())?;
    }
    let script = root().join(SOURCE).join("benches/environments.py").to_string_lossy().into_owned();
    let [mujoco, newton] = ["mujoco_flex.py", "newton_soft_body.py"]
        .map(|peer| root().join("xtask/peers").join(peer).to_string_lossy().into_owned());
    run_python(&python, &packages, &[&script, "--mujoco", &mujoco, "--newton", &newton], arguments)
}

/// Learns an environment.
pub(crate) fn learn(arguments: &[String]) -> anyhow::Result<()> {
    let python = setup::require(&["python3", "python"], "python3", "learning")?;
    let packages = folder().join("learning");
    if !packages.join("stable_baselines3").exists() {
        pip_install(&python, &packages.to_string_lossy(), &LEARNING)?;
    }
    let script = root().join(SOURCE).join("examples/learn.py").to_string_lossy().into_owned();
    run_python(&python, &packages, &[&script], arguments)
}

fn run_python(python: &str, packages: &Path, script: &[&str], arguments: &[String]) -> anyhow::Result<()> {
    let words = words_for(python, packages)?;
    let words = words.each_ref().map(String::as_str);
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    run("env", &[&words[..], script, &arguments].concat())
}

/// Where the package with the module that was built lies.
fn module() -> PathBuf {
    folder().join("module").join("glisson")
}

/// Lays the package with the module that was built beside what it needs: the words for `env` that run a Python with both.
fn words_for(python: &str, packages: &Path) -> anyhow::Result<[String; 4]> {
    let package = module();
    if package.exists() {
        fs::remove_dir_all(&package).with_context(|| package.display().to_string())?;
    }
    copy_folder(&root().join(SOURCE).join("python/glisson"), &package)?;
    let built = format!("{}_glisson{}", std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX);
    let module = target().join("release").join(built);
    let there = package.join("_glisson.abi3.so");
    fs::copy(&module, &there).with_context(|| format!("{} to {}", module.display(), there.display()))?;
    let folders = [folder().join("module"), packages.to_path_buf()];
    let path = std::env::join_paths(folders.map(|folder| root().join(folder)))?;
    Ok([
        format!("PYTHONPATH={}", path.display()),
        "PYTHONDONTWRITEBYTECODE=1".to_owned(),
        format!("GLISSON_PROGRAM={}", root().join(program()).display()),
        python.to_owned(),
    ])
}

fn copy_folder(from: &Path, to: &Path) -> anyhow::Result<()> {
    fs::create_dir_all(to).with_context(|| to.display().to_string())?;
    for entry in fs::read_dir(from).with_context(|| from.display().to_string())? {
        let entry = entry?;
        let (path, copy) = (entry.path(), to.join(entry.file_name()));
        if path.is_dir() && entry.file_name() != "__pycache__" {
            copy_folder(&path, &copy)?;
        } else if path.is_file() {
            fs::copy(&path, &copy).with_context(|| path.display().to_string())?;
        }
    }
    Ok(())
}

/// Makes the wheel, installs it in a clean environment of each Python that is found, and runs the tests there.
pub(crate) fn wheel() -> anyhow::Result<()> {
    let python = setup::require(&["python3", "python"], "python3", "making a wheel")?;
    let (tools, wheels) = (folder().join("maturin"), root().join(target()).join("wheels"));
    if !tools.join("maturin").exists() {
        pip_install(&python, &tools.to_string_lossy(), &[MATURIN])?;
    }
    if wheels.exists() {
        fs::remove_dir_all(&wheels).with_context(|| wheels.display().to_string())?;
    }
    let manifest = root().join(SOURCE).join("Cargo.toml");
    // Python's way to start it looks in its own folders alone.
    let maturin = root().join(&tools).join("bin/maturin");
    let [manifest, out, maturin] =
        [&manifest, &wheels, &maturin].map(|path| path.to_string_lossy().into_owned());
    let build = ["build", "--release", "--locked", "--manifest-path", &manifest, "--out", &out];
    run_within(MAKING, &maturin, &build)?;
    let wheel = fs::read_dir(&wheels)?.next().context("maturin made no wheel")??.path();
    let found: Vec<&str> = PYTHONS.into_iter().filter(|python| setup::is_there(python)).collect();
    ensure!(!found.is_empty(), "there is none of {}: the wheel is not tried", PYTHONS.join(", "));
    for python in &found {
        try_wheel(python, &wheel).with_context(|| format!("the wheel with {python}"))?;
    }
    println!("\nmade {}, tried with {}", wheel.display(), found.join(", "));
    Ok(())
}

fn try_wheel(python: &str, wheel: &Path) -> anyhow::Result<()> {
    let environment = root().join(folder()).join(format!("environment-{python}"));
    if environment.exists() {
        fs::remove_dir_all(&environment).with_context(|| environment.display().to_string())?;
    }
    let [place, wheel] = [&environment, &wheel.to_path_buf()].map(|path| path.to_string_lossy().into_owned());
    run(python, &["-m", "venv", &place])?;
    let inside = environment.join("bin/python").to_string_lossy().into_owned();
    let wanted = [&wheel, "gymnasium", "pettingzoo", "pytest", "pyarrow"];
    run_within(crate::INSTALLING, &inside, &[&["-m", "pip", "install", "--quiet"], &wanted[..]].concat())?;
    let import = "import time; a = time.perf_counter(); import glisson; b = time.perf_counter() - a; \
                  print(f'imported in {1e3 * b:.0f} ms'); assert b < 0.3";
    run(&inside, &["-c", import])?;
    let tests = root().join(SOURCE).join("tests").to_string_lossy().into_owned();
    run_within(CHECKING, &inside, &["-m", "pytest", "-q", "-p", "no:cacheprovider", &tests])
}
