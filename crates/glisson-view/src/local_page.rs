//! The page that has a simulation in itself (`web/src/local/`): a scene and its files within it are one file, which a browser opens from
//! disk.

use crate::server::ViewerFiles;
use flate2::Compression;
use flate2::write::GzEncoder;
use glisson::base64;
use std::io::Write;

/// The page, in the program's own files.
const PAGE: &str = "local.html";
/// The element that a scene is put into.
const BEGIN: &str = "<script id=\"scene-files\" type=\"application/octet-stream\">";

/// Whether the page was built into the program.
pub fn has_local_page() -> bool {
    ViewerFiles::get(PAGE).is_some()
}

/// The page with a scene in it: the name of its file, and all files by their names, with `/` between folders and none at the
/// beginning. None if the program was built without it.
pub fn local_page_with(scene: &str, files: &[(String, Vec<u8>)]) -> Option<String> {
    let page = ViewerFiles::get(PAGE)?;
    let mut whole = std::str::from_utf8(&page.data).ok()?.to_owned();
    let files: serde_json::Map<String, serde_json::Value> =
        files.iter().map(|(name, bytes)| (name.clone(), base64::encode(&packed(bytes)).into())).collect();
    // Names may hold what would end the element.
    let exported = serde_json::json!({ "scene": scene, "files": files }).to_string().replace('<', "\\u003c");
    let at = whole.find(BEGIN)? + BEGIN.len();
    whole.insert_str(at, &exported);
    Some(whole)
}

fn packed(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    encoder.write_all(bytes).and_then(|()| encoder.finish()).expect("memory takes all")
}
