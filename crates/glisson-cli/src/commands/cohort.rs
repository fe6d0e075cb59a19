//! `glisson cohort`: reads what a cohort is of; the Python package does it.

use anyhow::{Context, bail, ensure};
use glisson_runtime::tasks::task_named;
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use tokio::signal::unix::SignalKind;

/// Do the same with many patients, scenes and parameters, on all cores or on a cluster of Ray
///
/// The file says which (docs/cohorts.md). The results are a table, a Parquet file. A cohort that was cut off goes on where it was when it is
/// started again. It is done by the Python package glisson.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  glisson cohort study.toml --out study\n  glisson cohort study.toml --out study --ray\n  \
    glisson cohort study.toml --out study --ray --address auto\n\nA study.toml:\n  glisson_cohort = 1\n  scenes = [\"palpation\"]\n  \
    patients = { from = 1, to = 200 }\n  [values]\n  \"organ.damping\" = [\"5 1/s\", \"20 1/s\"]"
)]
pub(crate) struct Args {
    /// What is done: scenes, patients, values
    study: PathBuf,
    /// Folder for the results; those that are there are kept
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Jobs at a time on this machine; all cores without it
    #[arg(long, value_name = "N", conflicts_with = "ray", value_parser = clap::value_parser!(u16).range(1..))]
    workers: Option<u16>,
    /// Let Ray do it: on this machine, or on the cluster of --address
    #[arg(long)]
    ray: bool,
    /// Address of the cluster, as `ray start` tells it; "auto" for the one that this machine is in
    #[arg(long, requires = "ray")]
    address: Option<String>,
    /// Python that has the package glisson; without it the one that started this program, or python3
    #[arg(long, value_name = "PROGRAM")]
    python: Option<PathBuf>,
}

/// What the file says.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct StudyFile {
    glisson_cohort: u32,
    scenes: Vec<String>,
    patients: Option<Patients>,
    #[serde(default)]
    values: toml::Table,
}

#[derive(Deserialize)]
#[serde(untagged, expecting = "patients are a list of seeds, or { from = 1, to = 200 }")]
enum Patients {
    Listed(Vec<u32>),
    Between(Between),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Between {
    from: u32,
    to: u32,
}

/// What the package is told.
#[derive(Serialize)]
struct Study {
    scenes: Vec<String>,
    patients: Option<Vec<u32>>,
    values: toml::Table,
    out: PathBuf,
    workers: Option<u16>,
    ray: bool,
    address: Option<String>,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let text = std::fs::read_to_string(&args.study)
        .with_context(|| format!("{}: cannot read the study", args.study.display()))?;
    let file = read(&text).with_context(|| args.study.display().to_string())?;
    let folder = args.study.parent().unwrap_or(Path::new("."));
    let study = Study {
        scenes: file.scenes.iter().map(|scene| found_from(folder, scene)).collect(),
        patients: file.patients.map(Patients::seeds),
        values: file.values,
        out: args.out.clone(),
        workers: args.workers,
        ray: args.ray,
        address: args.address.clone(),
    };
    let python = args.python.clone().unwrap_or_else(|| {
        std::env::var_os("GLISSON_PYTHON").map_or_else(|| PathBuf::from("python3"), PathBuf::from)
    });
    let needs = if args.ray { "import glisson.ray" } else { "import glisson.cohorts, pyarrow.parquet" };
    let tried = Command::new(&python).args(["-c", needs]).stdin(Stdio::null()).output();
    let python_name = python.display();
    let tried = tried.with_context(|| format!("cannot start {python_name}; --python names another one"))?;
    if !tried.status.success() {
        let told = String::from_utf8_lossy(&tried.stderr);
        let why = told.trim_end().lines().last().unwrap_or_default().to_owned();
        let wanted = if args.ray { "glisson[ray]" } else { "glisson[cohorts]" };
        bail!(
            "{python_name} cannot do cohorts ({why}); install '{wanted}' there, or name another Python with --python"
        );
    }
    // Ctrl + C is for Python, which keeps what is done; this program waits for it.
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let _interrupts = runtime.block_on(async { tokio::signal::unix::signal(SignalKind::interrupt()) })?;
    let mut doing = Command::new(&python)
        .args(["-m", "glisson.cohorts"])
        .stdin(Stdio::piped())
        .spawn()
        .with_context(|| format!("cannot start {python_name}"))?;
    doing.stdin.take().context("its input")?.write_all(serde_json::to_string(&study)?.as_bytes())?;
    let status = doing.wait()?;
    // As shells tell it of Ctrl + C.
    ensure!(status.code() != Some(130), "the cohort was stopped; the same command goes on with it");
    ensure!(status.success(), "the cohort is not complete");
    Ok(())
}

fn read(text: &str) -> anyhow::Result<StudyFile> {
    let file: StudyFile = toml::from_str(text)?;
    ensure!(file.glisson_cohort == 1, "\"glisson_cohort\" is {}; this program reads 1", file.glisson_cohort);
    ensure!(!file.scenes.is_empty(), "\"scenes\" is empty; give names of tasks, or scene files");
    for (path, values) in &file.values {
        ensure!(
            !values.is_table(),
            "\"{path}\" of [values] is a table; put the path in quotes: \"{path}.damping\" = [...]"
        );
        ensure!(values.is_array(), "\"{path}\" of [values] is {values}; give a list of values, also of one");
    }
    if let Some(Patients::Between(Between { from, to })) = file.patients {
        ensure!(from <= to, "\"patients\" is from {from} to {to}; \"to\" is \"from\" or more");
    }
    Ok(file)
}

impl Patients {
    fn seeds(self) -> Vec<u32> {
        match self {
            Self::Listed(seeds) => seeds,
            Self::Between(Between { from, to }) => (from..=to).collect(),
        }
    }
}

/// Scene files are relative to the study's folder.
fn found_from(folder: &Path, scene: &str) -> String {
    let is_task = task_named(scene).is_some();
    if is_task { scene.to_owned() } else { folder.join(scene).to_string_lossy().into_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_study_says_scenes_patients_and_values() {
        let text = "glisson_cohort = 1\nscenes = [\"palpation\", \"mine.toml\"]\npatients = { from = 3, to = 5 }\n[values]\n\"organ.damping\" = [\"5 1/s\"]\n";
        let file = read(text).unwrap();
        assert_eq!(file.patients.unwrap().seeds(), [3, 4, 5]);
        assert_eq!(file.values["organ.damping"].as_array().unwrap().len(), 1);
        let folder = Path::new("studies");
        assert_eq!(found_from(folder, "palpation"), "palpation");
        assert_eq!(Path::new(&found_from(folder, "mine.toml")), folder.join("mine.toml"));
    }

    #[test]
    fn what_is_wrong_in_a_study_is_told() {
        let of = |more: &str| match read(&format!("glisson_cohort = 1\nscenes = [\"palpation\"]\n{more}\n")) {
            Ok(_) => String::new(),
            Err(error) => format!("{error:#}"),
        };
        for (more, expected) in [
            ("", ""),
            ("patient = 3", "unknown field `patient`"),
            ("patients = \"all\"", "a list of seeds, or { from = 1, to = 200 }"),
            ("patients = { from = 5, to = 3 }", "is from 5 to 3"),
            ("patients = { from = 1, to = 3, step = 2 }", "a list of seeds"),
            ("[values]\norgan.damping = [1]", "put the path in quotes"),
            ("values = { \"organ.damping\" = \"5 1/s\" }", "give a list of values"),
        ] {
            let told = of(more);
            assert!(told.contains(expected) && expected.is_empty() == told.is_empty(), "{more}: {told}");
        }
        assert!(
            read("glisson_cohort = 2\nscenes = [\"a\"]").is_err()
                && read("glisson_cohort = 1\nscenes = []").is_err()
        );
    }
}
