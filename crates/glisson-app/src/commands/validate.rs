//! `glisson validate`.

use crate::validate::{Experiment, GROUPS};
use anyhow::{Context, bail};
use glisson::files::write_atomically;
use serde_json::json;
use std::io::Write;
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
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Folder for validation.json and validation.md
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

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let names = GROUPS.map(|g| g.name);
    if let Some(group) = &args.group
        && !names.contains(&group.as_str())
    {
        let suggestion = glisson::text::did_you_mean(group, &names);
        bail!("no group \"{group}\" of experiments; there are: {}{suggestion}", names.join(", "));
    }
    let mut experiments = Vec::new();
    for group in GROUPS.iter().filter(|g| args.group.as_ref().is_none_or(|wanted| wanted == g.name)) {
        if !args.json {
            eprintln!("{} ...", group.name);
        }
        experiments.extend((group.run)().with_context(|| format!("experiments of group {}", group.name))?);
    }
    let document = serde_json::to_string_pretty(&json!({ "experiments": experiments }))? + "\n";
    if args.json {
        print!("{document}");
    } else {
        print!("{}", table(&experiments));
    }
    if let Some(folder) = &args.out {
        std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot make", folder.display()))?;
        for (name, text) in [("validation.json", &document), ("validation.md", &table(&experiments))] {
            let path = folder.join(name);
            write_atomically(&path, |out| out.write_all(text.as_bytes()))
                .with_context(|| format!("{}: cannot write", path.display()))?;
        }
    }
    let failed = experiments.iter().filter(|e| !e.pass).count();
    if failed > 0 {
        bail!("{failed} of {} experiments do not hold", experiments.len());
    }
    if !args.json {
        println!("\nall {} experiments hold", experiments.len());
    }
    Ok(())
}
