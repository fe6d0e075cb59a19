//! A label map out of a DICOM segmentation.

use std::collections::BTreeMap;
use std::path::Path;

use dicom_dictionary_std::tags;
use dicom_object::{DefaultDicomObject, InMemDicomObject};

use super::super::error::ImageError;
use super::super::placement::right_angled;
use super::super::stored::{StoredData, StoredImage};
use super::frames::{Frame, first_item, integer, text, wrong};
use super::pixels::Pixels;
use super::series::{Series, open};
use super::volume::{NAME, frames_of_series};
use crate::binary::{ByteOrder, NumberType};
use crate::math::DVec3;

/// Most voxels of a segmentation: planes in which nothing is are not in the file, so its size does not bound them.
const MAX_VOXELS: f64 = (1u64 << 29) as f64;
/// Planes nearer than this share of a voxel are one.
const SAME_PLANE: f64 = 0.01;

/// The distance of neighbouring planes [mm]: the smallest between frames, or a whole part of it where the file states
/// one, because planes without anything of a segment are not there. None for one plane of no stated thickness.
fn distance_of_planes_mm(first: &Frame, sorted_heights_mm: &[f64]) -> Option<f64> {
    let least_mm = SAME_PLANE * first.spacing_mm[0].min(first.spacing_mm[1]);
    let gaps = sorted_heights_mm.windows(2).map(|pair| pair[1] - pair[0]).filter(|&gap| gap > least_mm);
    let smallest_mm = gaps.fold(f64::INFINITY, f64::min);
    if smallest_mm == f64::INFINITY {
        return first.between_mm.or(first.thickness_mm);
    }
    let n_between = first.between_mm.map_or(1.0, |stated_mm| smallest_mm / stated_mm);
    let is_whole = n_between > 1.5 && (n_between - n_between.round()).abs() < 0.05;
    let distance_mm = if is_whole { smallest_mm / n_between.round() } else { smallest_mm };
    // Over the whole reach, so that rounded positions do not add up.
    let reach_mm = sorted_heights_mm[sorted_heights_mm.len() - 1] - sorted_heights_mm[0];
    Some(reach_mm / (reach_mm / distance_mm).round())
}

/// How a segmentation says what is inside.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// A frame shows one segment, inside or not.
    Binary,
    /// A frame shows shares of one segment; from half on is inside.
    Fractional {
        /// The number that stands for all.
        all: i64,
    },
    /// The numbers in a frame are those of segments.
    Labels,
}

/// The label map of a segmentation: one file.
///
/// # Errors
/// Several files, frames that are not on one grid, or pixels that cannot be decoded.
pub(super) fn label_map(folder: &Path, series: &Series) -> Result<StoredImage, ImageError> {
    let refuse = |reason: String| Err(ImageError::Series { folder: folder.to_path_buf(), reason });
    let [file] = &series.files[..] else {
        return refuse(format!(
            "{} segmentations in one series, one file allowed: name the file",
            series.files.len()
        ));
    };
    let frames = frames_of_series(folder, series)?;
    let object = open(file, true)?;
    let kind = kind_of(file, &object)?;
    let (first, normal) = (&frames[0], frames[0].normal());
    let height_mm = |frame: &Frame| frame.position_mm.dot(normal);
    let mut heights_mm: Vec<f64> = frames.iter().map(height_mm).collect();
    heights_mm.sort_by(f64::total_cmp);
    let (low_mm, reach_mm) = (heights_mm[0], heights_mm[heights_mm.len() - 1] - heights_mm[0]);
    let Some(distance_mm) = distance_of_planes_mm(first, &heights_mm) else {
        return Err(wrong(
            file,
            &object,
            tags::SPACING_BETWEEN_SLICES,
            "SpacingBetweenSlices",
            "a size above 0 in mm",
        ));
    };
    let n_planes = (reach_mm / distance_mm).round() + 1.0;
    let n_voxels = n_planes * first.dims[0] as f64 * first.dims[1] as f64;
    if n_voxels > MAX_VOXELS {
        return refuse(format!(
            "{n_planes} planes of {} x {} voxels, {distance_mm:.3} mm apart: {n_voxels:.1e} voxels, at most {MAX_VOXELS:.1e} allowed",
            first.dims[0], first.dims[1]
        ));
    }
    let dims = [first.dims[0], first.dims[1], n_planes as usize];
    let spacing_m = DVec3::new(first.spacing_mm[0], first.spacing_mm[1], distance_mm) * 1e-3;
    let lowest = frames.iter().min_by(|a, b| height_mm(a).total_cmp(&height_mm(b))).unwrap_or(first);
    let steps = [first.directions[0], first.directions[1], normal];
    let grid = right_angled(folder, dims, steps, spacing_m, lowest.position_mm * 1e-3)?;

    let pixels = Pixels::new(file, &object, first.dims, frames.len())?;
    let n_in_plane = dims[0] * dims[1];
    let mut labels = vec![0u16; grid.n_voxels()];
    let mut n_shared = 0usize;
    for frame in &frames {
        let place = (height_mm(frame) - low_mm) / distance_mm;
        let aside_mm =
            (frame.position_mm - lowest.position_mm - normal * (height_mm(frame) - low_mm)).length();
        if aside_mm > 0.1 * first.spacing_mm[0] {
            return refuse(format!(
                "{} lies {aside_mm:.2} mm beside the line across the planes of the other frames, as on slices of a tilted \
                 gantry: these cannot be put upright without labels that nothing has; resample the segmentation by the \
                 nearest voxel (e.g. with 3D Slicer)",
                frame.name()
            ));
        }
        if (place - place.round()).abs() > 0.1 {
            return refuse(format!("{} is not on the grid of the other frames", frame.name()));
        }
        let plane = &mut labels[place.round() as usize * n_in_plane..][..n_in_plane];
        let segment = match (kind, frame.segment) {
            (Kind::Labels, _) => 0,
            (_, Some(segment)) if segment > 0 => segment,
            _ => return refuse(format!("{} does not say which segment it shows", frame.name())),
        };
        let label_of = |value: i64| match kind {
            Kind::Labels => u16::try_from(value).ok(),
            Kind::Binary => Some(if value != 0 { segment } else { 0 }),
            Kind::Fractional { all } => Some(if 2 * value >= all { segment } else { 0 }),
        };
        for (label, value) in plane.iter_mut().zip(pixels.of_frame(frame.index)?) {
            let Some(found) = label_of(value) else {
                return refuse(format!("{} has the label {value}, 0 to 65535 allowed", frame.name()));
            };
            if found != 0 {
                n_shared += usize::from(*label != 0);
                *label = found;
            }
        }
    }
    let bytes = labels.iter().flat_map(|label| label.to_le_bytes()).collect();
    let data = StoredData::plain(NumberType::U16, ByteOrder::Little, bytes, 0);
    let mut image = StoredImage::new(folder, NAME, grid, data);
    if n_shared > 0 {
        image.notes.push(format!("segments overlap in {n_shared} voxels; the later frame was taken there"));
    }
    let segments = segments_of(&object);
    image.names = segments.iter().map(|(label, (name, _))| (*label, name.clone())).collect();
    image.colours = segments.iter().filter_map(|(label, (_, colour))| Some((*label, (*colour)?))).collect();
    Ok(image)
}

fn kind_of(file: &Path, object: &DefaultDicomObject) -> Result<Kind, ImageError> {
    match text(object, tags::SEGMENTATION_TYPE).as_deref() {
        Some("BINARY") => Ok(Kind::Binary),
        Some("LABELMAP") => Ok(Kind::Labels),
        Some("FRACTIONAL") => Ok(Kind::Fractional {
            all: integer(object, tags::MAXIMUM_FRACTIONAL_VALUE).unwrap_or(255).max(1),
        }),
        _ => Err(wrong(
            file,
            object,
            tags::SEGMENTATION_TYPE,
            "SegmentationType",
            "BINARY, FRACTIONAL or LABELMAP",
        )),
    }
}

/// Names and colours of the segments by their numbers.
fn segments_of(object: &DefaultDicomObject) -> BTreeMap<u16, (String, Option<[f32; 3]>)> {
    let items = object.get(tags::SEGMENT_SEQUENCE).and_then(|element| element.items()).unwrap_or_default();
    let numbered = items.iter().filter_map(|item| {
        let number =
            integer(item, tags::SEGMENT_NUMBER).and_then(|n| u16::try_from(n).ok()).filter(|&n| n > 0)?;
        Some((number, (name_of(item), colour_of(item))))
    });
    numbered.collect()
}

/// A segment's label, or else what its type is called.
fn name_of(item: &InMemDicomObject) -> String {
    let label = text(item, tags::SEGMENT_LABEL);
    let kind = || text(first_item(item, tags::SEGMENTED_PROPERTY_TYPE_CODE_SEQUENCE)?, tags::CODE_MEANING);
    label.or_else(kind).unwrap_or_default()
}

/// A segment's colour: CIELab under D50 in 16 bits (PS3.3 C.10.7.1.1) to sRGB (IEC 61966-2-1; the matrix with
/// Bradford's adaptation from D50 to D65 by B. Lindbloom).
fn colour_of(item: &InMemDicomObject) -> Option<[f32; 3]> {
    let lab = item.get(tags::RECOMMENDED_DISPLAY_CIE_LAB_VALUE)?.to_multi_int::<u16>().ok()?;
    let [l, a, b] = <[u16; 3]>::try_from(lab).ok()?.map(|part| f64::from(part) / 65_535.0);
    let (l, a, b) = (100.0 * l, 255.0 * a - 128.0, 255.0 * b - 128.0);
    let y = (l + 16.0) / 116.0;
    let inverse =
        |t: f64| if t > 6.0 / 29.0 { t * t * t } else { 3.0 * (6.0f64 / 29.0).powi(2) * (t - 4.0 / 29.0) };
    let white = [0.96422, 1.0, 0.82521];
    let xyz = [white[0] * inverse(y + a / 500.0), white[1] * inverse(y), white[2] * inverse(y - b / 200.0)];
    let rows = [
        [3.133_856_1, -1.616_866_7, -0.490_614_6],
        [-0.978_768_4, 1.916_141_5, 0.033_454_0],
        [0.071_945_3, -0.228_991_4, 1.405_242_7],
    ];
    Some(rows.map(|row: [f64; 3]| {
        let linear = (row[0] * xyz[0] + row[1] * xyz[1] + row[2] * xyz[2]).clamp(0.0, 1.0);
        let encoded =
            if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * libm::pow(linear, 1.0 / 2.4) - 0.055 };
        encoded as f32
    }))
}
