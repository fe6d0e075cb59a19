//! Installing what a task needs.

use crate::{root, run, run_in};
use anyhow::{Context, bail};
use std::path::PathBuf;
use std::process::{Command, Stdio};

/// Whether `program --version` works.
pub(crate) fn is_there(program: &str) -> bool {
    Command::new(program)
        .arg("--version")
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|s| s.success())
}

pub(crate) fn is_root() -> bool {
    Command::new("id").arg("-u").output().is_ok_and(|o| o.stdout.trim_ascii() == b"0")
}

/// Makes sure that one of `programs` is there; installs the Debian `package` when that is allowed.
pub(crate) fn require(programs: &[&str], package: &str, purpose: &str) -> anyhow::Result<String> {
    let found = || programs.iter().find(|p| is_there(p)).map(|p| (*p).to_string());
    if let Some(program) = found() {
        return Ok(program);
    }
    let advice = format!("{purpose} needs {}; install it: apt-get install {package}", programs.join(" or "));
    if !is_root() || !is_there("apt-get") {
        bail!("{advice}");
    }
    println!("installing {package} ({purpose})");
    run("apt-get", &["update", "-qq"]).context(advice.clone())?;
    run("apt-get", &["install", "-y", "-qq", "--no-install-recommends", package]).context(advice.clone())?;
    found().with_context(|| format!("{package} was installed, but it does not start. {advice}"))
}

/// The npm packages of the viewer, as locked.
pub(crate) fn web_packages() -> anyhow::Result<()> {
    if !is_there("node") || !is_there("npm") {
        bail!("the viewer needs Node.js 20 or later with npm; install it: apt-get install nodejs npm");
    }
    let web = root().join("web");
    let (lock, stamp) = (web.join("package-lock.json"), web.join("node_modules/.glisson-lock"));
    let locked = std::fs::read(&lock).with_context(|| format!("{}: cannot read", lock.display()))?;
    if std::fs::read(&stamp).is_ok_and(|installed| installed == locked) {
        return Ok(());
    }
    run_in(&web, "npm", &["ci", "--no-audit", "--no-fund"])?;
    std::fs::write(&stamp, locked).with_context(|| format!("{}: cannot write", stamp.display()))
}

/// Where the system's Chromium lies.
pub(crate) fn chromium() -> anyhow::Result<PathBuf> {
    let name = require(&["chromium", "chromium-browser", "google-chrome"], "chromium", "the browser test")?;
    on_path(&name).with_context(|| format!("{name} starts, but is in no folder of PATH"))
}

/// Makes sure that `ffmpeg` is there, which the test of films would pass over.
pub(crate) fn ffmpeg() -> anyhow::Result<()> {
    match on_path("ffmpeg") {
        Some(_) => Ok(()),
        None => require_file("/usr/bin/ffmpeg", "ffmpeg"),
    }
}

/// A program in a folder of PATH.
fn on_path(name: &str) -> Option<PathBuf> {
    let folders = std::env::var_os("PATH").unwrap_or_default();
    std::env::split_paths(&folders).map(|folder| folder.join(name)).find(|file| file.is_file())
}

/// Makes sure that `file` is there; installs the Debian `package` that brings it when that is allowed.
pub(crate) fn require_file(file: &str, package: &str) -> anyhow::Result<()> {
    if std::path::Path::new(file).exists() {
        return Ok(());
    }
    if !is_root() || !is_there("apt-get") {
        bail!("{file} is missing; install it: apt-get install {package}");
    }
    println!("installing {package}");
    run("apt-get", &["update", "-qq"])?;
    run("apt-get", &["install", "-y", "-qq", "--no-install-recommends", package])?;
    if std::path::Path::new(file).exists() {
        return Ok(());
    }
    bail!("{package} was installed, but there is no {file}")
}
