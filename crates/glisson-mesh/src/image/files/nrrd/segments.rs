//! Segments of a segmentation: names, colours, numbers and layers.

use std::collections::{BTreeMap, BTreeSet};

use super::super::error::ImageError;
use super::super::stored::StoredData;
use super::super::text_header::TextHeader;
use crate::binary::{ByteOrder, NumberType};

/// A segment as the header describes it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Segment {
    /// N of its keys `SegmentN_...`.
    number: usize,
    pub(super) name: String,
    pub(super) colour: Option<[f32; 3]>,
    pub(super) label: u16,
    pub(super) layer: usize,
}

/// The segments of a header, in the order of their numbers. Files of 3D Slicer before 4.11 do not number them: of one
/// that `is_layered` each segment is a layer of zeros and ones, else it has its order for its number.
pub(super) fn segments_of(header: &TextHeader, is_layered: bool) -> Result<Vec<Segment>, ImageError> {
    let number_of = |key: &str| -> Option<usize> {
        key.strip_prefix("Segment")?
            .strip_suffix("_ID")
            .or(key.strip_prefix("Segment")?.strip_suffix("_Name"))?
            .parse()
            .ok()
    };
    let numbers: BTreeSet<usize> = header.fields.iter().filter_map(|field| number_of(&field.key)).collect();
    let mut segments = Vec::new();
    for n in numbers {
        let of = |part: &str| header.get(&format!("Segment{n}_{part}"));
        let label = match of("LabelValue") {
            Some(field) => header.whole(field, 1, i64::from(u16::MAX))? as u16,
            None if is_layered => 1,
            None => u16::try_from(n + 1).unwrap_or(u16::MAX),
        };
        let layer = match of("Layer") {
            Some(field) => header.whole(field, 0, 1 << 16)? as usize,
            None if is_layered => n,
            None => 0,
        };
        let colour = of("Color").map(|field| header.numbers::<3>(field)).transpose()?;
        segments.push(Segment {
            number: n,
            name: of("Name").or(of("ID")).map(|field| field.value.clone()).unwrap_or_default(),
            colour: colour.map(|colour| colour.map(|part| part.clamp(0.0, 1.0) as f32)),
            label,
            layer,
        });
    }
    Ok(segments)
}

/// One label map of several layers.
pub(super) struct Merged {
    pub(super) data: StoredData,
    /// With the labels that they got: their own, or their order from 1 where two of different layers have the same.
    pub(super) segments: Vec<Segment>,
    /// Voxels in which a segment lies over another.
    pub(super) n_hidden: usize,
    /// Numbers above 0 that no segment has.
    pub(super) n_unknown: usize,
}

/// One label map of several layers, whose numbers stand layer by layer in each voxel; a later layer lies over an
/// earlier one.
pub(super) fn merged(
    header: &TextHeader,
    data: &StoredData,
    n_layers: usize,
    mut segments: Vec<Segment>,
) -> Result<Merged, ImageError> {
    if segments.is_empty() {
        let field = header.required("sizes")?;
        let allowed = "layers of a segmentation, with Segment0_ID and so on (of a series of images take one volume a file)";
        return Err(header.wrong(field, allowed));
    }
    if let Some(beyond) = segments.iter().find(|segment| segment.layer >= n_layers) {
        let key = format!("Segment{}_Layer", beyond.number);
        let allowed = format!("0 to {}: the file has {n_layers} layer(s)", n_layers - 1);
        return Err(header
            .get(&key)
            .map_or_else(|| header.missing(&key), |field| header.wrong(field, allowed)));
    }
    let in_file: Vec<(usize, u16)> = segments.iter().map(|segment| (segment.layer, segment.label)).collect();
    let n_different = segments.iter().map(|segment| segment.label).collect::<BTreeSet<_>>().len();
    if n_different < segments.len() {
        for (n, segment) in segments.iter_mut().enumerate() {
            segment.label = u16::try_from(n + 1).unwrap_or(u16::MAX);
        }
    }
    let labels: BTreeMap<(usize, u16), u16> =
        in_file.into_iter().zip(segments.iter().map(|segment| segment.label)).collect();
    let mut merged: Vec<u8> = Vec::with_capacity(2 * data.n_numbers() / n_layers);
    let (mut here, mut n_hidden, mut n_unknown) = (0u16, 0, 0);
    data.for_each(|index, value| {
        let layer = index % n_layers;
        let found = labels.get(&(layer, value as u16)).copied();
        match found.filter(|_| value > 0.0) {
            Some(label) => {
                n_hidden += usize::from(here != 0);
                here = label;
            }
            None => n_unknown += usize::from(value > 0.0),
        }
        if layer + 1 == n_layers {
            merged.extend(here.to_le_bytes());
            here = 0;
        }
        Ok::<(), ImageError>(())
    })?;
    let data = StoredData::plain(NumberType::U16, ByteOrder::Little, merged, 0);
    Ok(Merged { data, segments, n_hidden, n_unknown })
}
