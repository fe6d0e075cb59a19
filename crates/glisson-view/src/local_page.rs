//! The pages that have the simulation in themselves (`web/src/local/`), each one file that a browser opens from disk: a scene and its files,
//! or a new patient.

use crate::server::ViewerFiles;
use anyhow::Context;
use flate2::Compression;
use flate2::write::GzEncoder;
use glisson::base64;
use std::io::Write;

/// The page of a scene, in the program's own files, and that for a new patient, which makes one of the first kind.
const PAGE: &str = "local.html";
const PATIENT_PAGE: &str = "local_patient.html";
/// The element that a scene is put into.
const BEGIN: &str = "<script id=\"scene-files\" type=\"application/octet-stream\">";

fn page_named(name: &str) -> anyhow::Result<String> {
    let page = ViewerFiles::get(name).context(
        "this program was built without the simulator for browsers; `cargo xtask web` builds it, then `cargo xtask demo` the program",
    )?;
    Ok(std::str::from_utf8(&page.data)?.to_owned())
}

/// Whether the pages were built into the program.
///
/// # Errors
/// They were not: what to do.
pub fn check_built() -> anyhow::Result<()> {
    page_named(PAGE).map(drop)
}

/// The page with a scene in it: the name of its file, and all files by their names, with `/` between folders and none at the
/// beginning. In the place of the scene's file there may be a session's, for a page of [`recording`](crate::recording).
///
/// # Errors
/// The program was built without it.
pub fn local_page_with(scene: &str, files: &[(String, Vec<u8>)]) -> anyhow::Result<String> {
    let mut whole = page_named(PAGE)?;
    let files: serde_json::Map<String, serde_json::Value> =
        files.iter().map(|(name, bytes)| (name.clone(), base64::encode(&packed(bytes)).into())).collect();
    // Names may hold what would end the element.
    let exported = serde_json::json!({ "scene": scene, "files": files }).to_string().replace('<', "\\u003c");
    let at = whole.find(BEGIN).context("the program's page has no place for a scene")? + BEGIN.len();
    whole.insert_str(at, &exported);
    Ok(whole)
}

/// The page for a new patient that does all by itself.
///
/// # Errors
/// The program was built without it.
pub fn patient_page() -> anyhow::Result<String> {
    page_named(PATIENT_PAGE)
}

pub(crate) fn packed(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    encoder.write_all(bytes).and_then(|()| encoder.finish()).expect("memory takes all")
}
