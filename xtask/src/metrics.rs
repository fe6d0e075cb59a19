//! The metrics of smoothness against the program of who published them: monalysa, fetched at test time; nothing of it enters the
//! repository.

use crate::{pip_install, root, run, run_within, setup, target};
use anyhow::Context;
use std::path::PathBuf;
use std::time::Duration;

const PACKAGES: [&str; 2] = ["monalysa==0.2.1", "numpy==2.4.6"];
/// Makes motions, and compares what both programs say of them.
const SCRIPT: &str = include_str!("metrics.py");
/// How long the script may take.
const CHECKING: Duration = Duration::from_secs(120);

/// Where everything is kept.
fn folder() -> PathBuf {
    target().join("metrics-check")
}

/// Installs what to compare with; answers with the Python that has it.
pub(crate) fn install() -> anyhow::Result<String> {
    let packages = folder().join("packages");
    let python = setup::require(&["python3", "python"], "python3", "checking the metrics of smoothness")?;
    if !packages.join("monalysa").exists() {
        pip_install(&python, &packages.to_string_lossy(), &PACKAGES)?;
    }
    Ok(python)
}

/// Compares, with the Python of [`install`].
pub(crate) fn check(python: &str) -> anyhow::Result<()> {
    run("cargo", &["build", "--locked", "--package", "glisson-examples", "--bin", "smoothness"])?;
    let ours = target().join("debug").join(format!("smoothness{}", std::env::consts::EXE_SUFFIX));
    let script = folder().join("metrics.py");
    std::fs::write(&script, SCRIPT).with_context(|| format!("{}: cannot write", script.display()))?;
    let packages = folder().join("packages");
    let words =
        [&script, &packages, &root().join(ours), &folder()].map(|path| path.to_string_lossy().into_owned());
    run_within(CHECKING, python, &words.iter().map(String::as_str).collect::<Vec<_>>())
}
