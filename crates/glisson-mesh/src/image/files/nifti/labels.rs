//! Names and colours of labels inside a NIfTI-1 file: ours, and those of programs that write GIFTI's label table.

use super::super::label_table::LabelTable;

/// Extension code of a plain-text comment.
pub(super) const COMMENT_EXTENSION: i32 = 6;

/// The labels in the first extension that names some. What other programs keep there is passed over.
pub(super) fn labels_in(extensions: &[u8], big_endian: bool) -> LabelTable {
    let i32_at = |byte: usize| -> Option<i32> {
        let bytes = extensions.get(byte..byte + 4)?.try_into().ok()?;
        Some(if big_endian { i32::from_be_bytes(bytes) } else { i32::from_le_bytes(bytes) })
    };
    if extensions.first().is_none_or(|&flag| flag == 0) {
        return LabelTable::default();
    }
    let mut at = 4;
    while let (Some(size), Some(code)) = (i32_at(at), i32_at(at + 4)) {
        let Some(content) = usize::try_from(size).ok().and_then(|n| extensions.get(at + 8..at + n)) else {
            break;
        };
        let end = content.iter().rposition(|&b| b != 0).map_or(0, |last| last + 1);
        let found = match code {
            COMMENT_EXTENSION => LabelTable::parse(&content[..end]),
            _ => std::str::from_utf8(&content[..end]).ok().and_then(gifti_labels),
        };
        if let Some(table) = found.filter(|table| !table.is_empty()) {
            return table;
        }
        at += size as usize;
    }
    LabelTable::default()
}

/// The labels of a GIFTI label table in a text, as TotalSegmentator and Connectome Workbench write it into NIfTI:
/// `<Label Key="5" Red="1" Green="0" Blue="0" Alpha="1">liver</Label>`.
fn gifti_labels(text: &str) -> Option<LabelTable> {
    let document = roxmltree::Document::parse(text.trim_start_matches('\u{feff}').trim()).ok()?;
    let mut table = LabelTable::default();
    for label in document.descendants().filter(|node| node.has_tag_name("Label")) {
        let Some(key) = label.attribute("Key").and_then(|key| key.trim().parse::<u16>().ok()) else {
            continue;
        };
        let name = label.text().unwrap_or_default().trim();
        if key == 0 || name.is_empty() {
            continue;
        }
        table.label_names.insert(key, name.to_owned());
        let part = |name| label.attribute(name).and_then(|text| text.trim().parse::<f32>().ok());
        if let (Some(red), Some(green), Some(blue)) = (part("Red"), part("Green"), part("Blue")) {
            table.label_colours.insert(key, [red, green, blue]);
        }
    }
    Some(table)
}
