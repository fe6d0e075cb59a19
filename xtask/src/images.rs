//! Image and mesh files against other people's programs: SimpleITK, nibabel, pydicom with its sample files, meshio, and
//! the liver that comes with CGAL. All are fetched at test time; nothing of them enters the repository.

use crate::{INSTALLING, pip_install, program, run_in, run_within, setup, target};
use anyhow::Context;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

const PACKAGES: [&str; 5] =
    ["SimpleITK==2.5.7", "nibabel==5.4.2", "pydicom==3.0.2", "meshio==5.3.5", "numpy==2.4.6"];
/// pydicom decodes JPEG-LS and JPEG 2000 with these.
const DECODERS: [&str; 3] = ["pylibjpeg==2.1.0", "pylibjpeg-openjpeg==2.6.0", "pylibjpeg-libjpeg==2.5.0"];

/// Writes files with those programs, reads them with ours, and the other way round.
const SCRIPT: &str = include_str!("images.py");
/// How long the script may take.
const CHECKING: Duration = Duration::from_secs(600);
/// Debian's package with CGAL's images, and where they lie in it.
const CGAL: &str = "libcgal-demo";
const CGAL_DATA: &str = "usr/share/doc/libcgal-dev/data.tar.gz";
const CGAL_LIVER: &str = "data/images/liver.inr.gz";

/// Where everything is kept.
fn folder() -> PathBuf {
    target().join("images-check")
}

/// Installs the programs to compare with; answers with the Python that has them.
pub(crate) fn install() -> anyhow::Result<String> {
    let packages = folder().join("packages");
    let python = setup::require(&["python3", "python"], "python3", "checking image files")?;
    if !packages.join("SimpleITK").exists() {
        pip_install(&python, &packages.to_string_lossy(), &[&PACKAGES[..], &DECODERS].concat())?;
    }
    Ok(python)
}

/// Checks the release program with the Python of [`install`]; with CGAL's liver when `with_cgal`.
pub(crate) fn check(python: &str, with_cgal: bool) -> anyhow::Result<()> {
    let folder = folder();
    let packages = folder.join("packages");
    let mut arguments = vec![program(), folder.join("files")];
    if with_cgal {
        arguments.push(cgal_liver(&folder).context("cannot get CGAL's liver")?);
    }
    let script = folder.join("images.py");
    std::fs::write(&script, SCRIPT).with_context(|| format!("{}: cannot write", script.display()))?;
    let path = format!("PYTHONPATH={}", packages.display());
    let words: Vec<String> = arguments.iter().map(|a| a.to_string_lossy().into_owned()).collect();
    let mut all = vec![path.as_str(), python];
    let script = script.to_string_lossy().into_owned();
    all.push(&script);
    all.extend(words.iter().map(String::as_str));
    run_within(CHECKING, "env", &all)
}

/// The liver that comes with CGAL, out of Debian's package, which is fetched and unpacked but not installed.
fn cgal_liver(folder: &Path) -> anyhow::Result<PathBuf> {
    let liver = folder.join(CGAL_LIVER);
    if liver.exists() {
        return Ok(liver);
    }
    let fetched = || run_in(folder, "apt-get", &["download", "-q", CGAL]);
    if fetched().is_err() {
        run_within(INSTALLING, "apt-get", &["update", "-qq"])?;
        fetched()?;
    }
    let is_package = |path: &PathBuf| {
        path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(CGAL))
            && path.extension().is_some_and(|e| e == "deb")
    };
    let entries = std::fs::read_dir(folder)?.filter_map(|entry| entry.ok().map(|entry| entry.path()));
    let package =
        entries.into_iter().find(is_package).context("the package is not where it was fetched to")?;
    let unpacked = folder.join("cgal");
    let status =
        Command::new("dpkg").arg("-x").arg(&package).arg(&unpacked).status().context("cannot start dpkg")?;
    anyhow::ensure!(status.success(), "dpkg -x failed ({status})");
    run_in(folder, "tar", &["xzf", &unpacked.join(CGAL_DATA).to_string_lossy(), CGAL_LIVER])?;
    Ok(liver)
}
