//! Segments of a segmentation: names, colours, numbers and layers.

use std::collections::{BTreeMap, BTreeSet};

use super::super::error::ImageError;
use super::super::stored::StoredData;
use super::super::text_header::TextHeader;
use crate::binary::{ByteOrder, NumberType};

/// A segment as the header describes it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Segment {
    pub(super) name: String,
    pub(super) colour: Option<[f32; 3]>,
    pub(super) label: u16,
    pub(super) layer: usize,
}

/// The segments of a header, in the order of their numbers.
pub(super) fn segments_of(header: &TextHeader) -> Result<Vec<Segment>, ImageError> {
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
            // Files before layers (Slicer below 4.11) number the segments by their order.
            None => u16::try_from(n + 1).unwrap_or(u16::MAX),
        };
        let layer = of("Layer").map_or(Ok(0), |field| header.whole(field, 0, 1 << 16))? as usize;
        let colour = of("Color").map(|field| header.numbers::<3>(field)).transpose()?;
        segments.push(Segment {
            name: of("Name").or(of("ID")).map(|field| field.value.clone()).unwrap_or_default(),
            colour: colour.map(|colour| colour.map(|part| part.clamp(0.0, 1.0) as f32)),
            label,
            layer,
        });
    }
    Ok(segments)
}

/// One label map of several layers, whose numbers stand layer by layer in each voxel; a later layer lies over an
/// earlier one. Also how many voxels hid something, and the segments with the labels that they got: their own, or
/// their order from 1 where two segments of different layers have the same.
pub(super) fn merged(
    header: &TextHeader,
    data: &StoredData,
    n_layers: usize,
    mut segments: Vec<Segment>,
) -> Result<(StoredData, usize, Vec<Segment>), ImageError> {
    if let Some(beyond) = segments.iter().position(|segment| segment.layer >= n_layers) {
        let field = header.get(&format!("Segment{beyond}_Layer"));
        let allowed = format!("0 to {}: the file has {n_layers} layer(s)", n_layers - 1);
        return Err(
            field.map_or_else(|| header.missing("Segment0_Layer"), |field| header.wrong(field, allowed))
        );
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
    let (mut here, mut n_hidden) = (0u16, 0);
    data.for_each(|index, value| {
        let layer = index % n_layers;
        let found = labels.get(&(layer, value as u16)).copied();
        if let Some(label) = found.filter(|_| value > 0.0) {
            n_hidden += usize::from(here != 0);
            here = label;
        }
        if layer + 1 == n_layers {
            merged.extend(here.to_le_bytes());
            here = 0;
        }
        Ok::<(), ImageError>(())
    })?;
    Ok((StoredData::plain(NumberType::U16, ByteOrder::Little, merged, 0), n_hidden, segments))
}
