//! Recordings within the page that plays them: one file without anything beside it.

use crate::local_page::packed;
use crate::server::ViewerFiles;
use glisson::base64;

/// The page that plays recordings, in the program's own files.
const PAGE: &str = "replay.html";
/// The elements that a recording is put into, and one that is played beside it.
const BEGINS: [&str; 2] = [
    "<script id=\"recording\" type=\"application/octet-stream\">",
    "<script id=\"recording-beside\" type=\"application/octet-stream\">",
];
/// The element for the page of the simulation itself.
const SIMULATOR: &str = "<script id=\"simulator\" type=\"application/octet-stream\">";
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

/// A page of [`page_with`], which can go on with the simulation itself: `simulator` is its page
/// ([`local_page_with`](crate::local_page::local_page_with)) with the session in the place of a scene. None if `page` is another one.
pub fn with_simulator(mut page: String, simulator: &str) -> Option<String> {
    let at = page.find(SIMULATOR)? + SIMULATOR.len();
    page.insert_str(at, &base64::encode(&packed(simulator.as_bytes())));
    Some(page)
}

/// The recordings in a page: none, one or two.
pub fn recordings_in(page: &str) -> Vec<Vec<u8>> {
    let one = |begin: &&str| {
        let (_, after) = page.split_once(*begin)?;
        base64::decode(after.split_once(END)?.0).filter(|bytes| !bytes.is_empty())
    };
    BEGINS.iter().filter_map(one).collect()
}
