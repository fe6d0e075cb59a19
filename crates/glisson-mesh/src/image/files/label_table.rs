//! Names and colours of labels as JSON, as NIfTI and MetaImage files hold them.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::stored::StoredImage;

/// `{"label_names": {"1": "liver"}, "label_colours": {"1": [0.7, 0.3, 0.2]}}`.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct LabelTable {
    #[serde(default)]
    pub(super) label_names: BTreeMap<u16, String>,
    /// Red, green, blue from 0 to 1.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub(super) label_colours: BTreeMap<u16, [f32; 3]>,
}

impl LabelTable {
    pub(super) fn of(names: &[(u16, String)], colours: &[(u16, [f32; 3])]) -> Self {
        let label_names = names.iter().cloned().collect();
        Self { label_names, label_colours: colours.iter().copied().collect() }
    }

    pub(super) fn parse(json: &[u8]) -> Option<Self> {
        serde_json::from_slice(json).ok()
    }

    pub(super) fn to_json(&self) -> String {
        serde_json::to_string(self).expect("maps of numbers and text always serialize")
    }

    pub(super) fn is_empty(&self) -> bool {
        self.label_names.is_empty() && self.label_colours.is_empty()
    }

    /// Gives an image its names and colours, ascending by label.
    pub(super) fn name_labels_of(self, image: &mut StoredImage) {
        image.names = self.label_names.into_iter().filter(|(label, _)| *label != 0).collect();
        image.colours = self.label_colours.into_iter().filter(|(label, _)| *label != 0).collect();
    }
}
