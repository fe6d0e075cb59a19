//! `glisson validate`.

use crate::text_file::write_text;
use anyhow::{Context, bail};
use glisson_lab::validate::{Experiment, Figure, GROUPS, Group, Outcome, SLOW_GROUPS};
use serde_json::json;
use std::path::PathBuf;

/// Reproduce the claims: every experiment with expected and obtained values.
///
/// Exit code 1 when one does not hold.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  glisson validate\n  glisson validate elasticity --json\n  \
    glisson validate --out out/validate")]
pub(crate) struct Args {
    /// Group of experiments; all if not given
    group: Option<String>,
    /// Also run the groups that take minutes each
    #[arg(long)]
    slow: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Tell, but do not fail, when processor times compare otherwise than claimed: for machines that are busy
    #[arg(long)]
    busy: bool,
    /// Folder for validation.json, validation.md and its figures
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

fn table(experiments: &[Experiment]) -> String {
    let mut text = String::from(
        "| | experiment | expected | obtained | tolerance | source |\n|---|---|---|---|---|---|\n",
    );
    for e in experiments {
        let sign = if e.pass { "pass" } else { "FAIL" };
        let obtained = if e.obtained != 0.0 && e.obtained.abs() < 1e-3 {
            format!("{:.2e}", e.obtained)
        } else {
            format!("{:.4}", e.obtained)
        };
        text += &format!(
            "| {sign} | {} | {} | {obtained} | {} | {} |\n",
            e.name, e.expected, e.tolerance, e.source
        );
    }
    text
}

/// The page: a section a group, with table, figures and notes.
fn page(outcomes: &[(&Group, Outcome)]) -> String {
    let mut text = String::from(
        "# Validation\n\nEvery claim with its source, the value expected and the one obtained. Made by \
         `cargo run --release -p glisson-cli -- validate --out docs/validation` (any folder will do); \
         `validation.json` has the same table for programs.\n",
    );
    for (group, outcome) in outcomes {
        text += &format!("\n## {}\n{}\n\n{}", group.name, group.about, table(&outcome.experiments));
        for Figure { file, caption, .. } in &outcome.figures {
            text += &format!("\n![{caption}]({file})\n\n{caption}\n");
        }
        if !outcome.notes.is_empty() {
            text += &format!("\n{}\n", outcome.notes.trim_end());
        }
    }
    text
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let names: Vec<&str> = GROUPS.iter().chain(SLOW_GROUPS).map(|g| g.name).collect();
    if let Some(group) = &args.group
        && !names.contains(&group.as_str())
    {
        let suggestion = glisson::text::did_you_mean(group, &names);
        bail!("no group \"{group}\" of experiments; there are: {}{suggestion}", names.join(", "));
    }
    if let Some(folder) = &args.out {
        std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot make", folder.display()))?;
    }
    let mut outcomes = Vec::new();
    // A slow group that is named is asked for.
    let slow = if args.slow || args.group.is_some() { SLOW_GROUPS } else { &[] };
    let is_wanted = |g: &&Group| args.group.as_ref().is_none_or(|wanted| wanted == g.name);
    for group in GROUPS.iter().chain(slow).filter(is_wanted) {
        eprintln!("{} ...", group.name);
        let outcome = (group.run)().with_context(|| format!("experiments of group {}", group.name))?;
        outcomes.push((group, outcome));
    }
    let experiments: Vec<&Experiment> = outcomes.iter().flat_map(|(_, o)| &o.experiments).collect();
    let document = serde_json::to_string_pretty(&json!({ "experiments": experiments }))? + "\n";
    let page = page(&outcomes);
    print!("{}", if args.json { &document } else { &page });
    if let Some(folder) = &args.out {
        write_text(&folder.join("validation.json"), &document)?;
        write_text(&folder.join("validation.md"), &page)?;
        for figure in outcomes.iter().flat_map(|(_, o)| &o.figures) {
            figure.plot.write_svg(&folder.join(figure.file))?;
        }
    }
    let counts = |e: &&&Experiment| !(e.pass || (args.busy && e.compares_times));
    let failed = experiments.iter().filter(counts).count();
    if failed > 0 {
        bail!("{failed} of {} experiments do not hold", experiments.len());
    }
    if !args.json {
        let n_told = experiments.iter().filter(|e| !e.pass).count();
        println!("\n{} of {} experiments hold", experiments.len() - n_told, experiments.len());
    }
    Ok(())
}
