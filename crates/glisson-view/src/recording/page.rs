//! Recordings within the page that plays them: one file without anything beside it.

use crate::server::ViewerFiles;
use glisson::base64;

/// The page that plays recordings, in the program's own files.
const PAGE: &str = "replay.html";
/// The elements that a recording is put into, and one that is played beside it.
const BEGINS: [&str; 2] = [
    "<script id=\"recording\" type=\"application/octet-stream\">",
    "<script id=\"recording-beside\" type=\"application/octet-stream\">",
];
const END: &str = "</script>";

/// The page with a recording in it, or with two to be compared; none if the program was built without pages.
pub fn page_with(recordings: &[&[u8]]) -> Option<String> {
    let page = ViewerFiles::get(PAGE)?;
    let mut whole = std::str::from_utf8(&page.data).ok()?.to_owned();
    for (begin, recording) in BEGINS.iter().zip(recordings) {
        let at = whole.find(begin)? + begin.len();
        whole.insert_str(at, &base64::encode(recording));
    }
    Some(whole)
}

/// The recordings in a page: none, one or two.
pub fn recordings_in(page: &str) -> Vec<Vec<u8>> {
    let one = |begin: &&str| {
        let (_, after) = page.split_once(*begin)?;
        base64::decode(after.split_once(END)?.0).filter(|bytes| !bytes.is_empty())
    };
    BEGINS.iter().filter_map(one).collect()
}
