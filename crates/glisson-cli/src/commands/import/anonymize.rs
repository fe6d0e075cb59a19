//! `glisson import --anonymize`.

use std::path::Path;

use anyhow::Context;
use glisson::image::files::{SeriesChoice, anonymize};
use serde_json::json;

/// Writes the copies and says what they are.
pub(super) fn run(input: &Path, series: Option<usize>, output: &Path, as_json: bool) -> anyhow::Result<()> {
    let choice = series.map_or(SeriesChoice::Only, SeriesChoice::Number);
    let copy = anonymize(input, &choice, output, random_key()?)?;
    if as_json {
        let answer = json!({
            "series": copy.n_series,
            "files": copy.n_files,
            "notes": copy.notes,
            "written": output.display().to_string(),
        });
        println!("{}", serde_json::to_string_pretty(&answer)?);
        return Ok(());
    }
    println!("copied     {} file(s) of {} series, without the patient", copy.n_files, copy.n_series);
    for note in &copy.notes {
        println!("note       {note}");
    }
    println!("written    {}", output.display());
    Ok(())
}

/// A key that nobody knows and that is forgotten with the program.
fn random_key() -> anyhow::Result<[u8; 32]> {
    let mut key = [0; 32];
    let n_bytes = rustix::rand::getrandom(&mut key, rustix::rand::GetRandomFlags::empty())
        .context("the system gives no random numbers")?;
    anyhow::ensure!(n_bytes == key.len(), "the system gives too few random numbers");
    Ok(key)
}
