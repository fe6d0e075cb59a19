//! A recording within the page that plays it: one file without anything beside it.

use crate::server::ViewerFiles;
use glisson::base64;

/// The page that plays recordings, in the program's own files.
const PAGE: &str = "replay.html";
/// The element that a recording is put into.
const BEGIN: &str = "<script id=\"recording\" type=\"application/octet-stream\">";
const END: &str = "</script>";

/// The page with `recording` in it; none if the program was built without pages.
pub fn page_with(recording: &[u8]) -> Option<String> {
    let page = ViewerFiles::get(PAGE)?;
    let page = std::str::from_utf8(&page.data).ok()?;
    let (before, after) = page.split_once(BEGIN)?;
    Some([before, BEGIN, &base64::encode(recording), after].concat())
}

/// The recording in a page; none if there is none.
pub fn recording_in(page: &str) -> Option<Vec<u8>> {
    let (_, after) = page.split_once(BEGIN)?;
    base64::decode(after.split_once(END)?.0)
}
