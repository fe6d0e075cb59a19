//! Planes of voxels: where each frame of a file is and what its numbers mean.

use std::path::{Path, PathBuf};

use dicom_core::VR;
use dicom_core::header::HasLength;
use dicom_dictionary_std::tags;
use dicom_object::{DefaultDicomObject, InMemDicomObject, Tag};

use super::super::error::{HeaderPlace, ImageError};
use crate::math::DVec3;

/// A plane of voxels.
#[derive(Clone, Debug)]
pub(super) struct Frame {
    pub(super) file: PathBuf,
    /// Its place among the frames of its file.
    pub(super) index: usize,
    /// Columns and rows.
    pub(super) dims: [usize; 2],
    /// Centre of its first voxel [mm], LPS.
    pub(super) position_mm: DVec3,
    /// Directions of growing column and row number.
    pub(super) directions: [DVec3; 2],
    /// Distances of neighbouring columns and rows [mm].
    pub(super) spacing_mm: [f64; 2],
    /// Distance of neighbouring planes that the file states [mm].
    pub(super) between_mm: Option<f64>,
    /// Thickness of a plane [mm]: not their distance.
    pub(super) thickness_mm: Option<f64>,
    pub(super) slope: f64,
    pub(super) intercept: f64,
    /// Number of the segment that a frame of a segmentation shows.
    pub(super) segment: Option<u16>,
}

impl Frame {
    /// The normal of its plane.
    pub(super) fn normal(&self) -> DVec3 {
        self.directions[0].cross(self.directions[1])
    }

    /// How it is called in messages.
    pub(super) fn name(&self) -> String {
        let file = self.file.file_name().unwrap_or_default().to_string_lossy();
        format!("{file}, frame {}", self.index + 1)
    }
}

/// The words of an element; none where it is absent or empty.
pub(super) fn text(object: &InMemDicomObject, tag: Tag) -> Option<String> {
    let text = object.get(tag)?.to_str().ok()?.trim_end_matches('\0').trim().to_owned();
    (!text.is_empty()).then_some(text)
}

/// The first integer of an element.
pub(super) fn integer(object: &InMemDicomObject, tag: Tag) -> Option<i64> {
    object.get(tag)?.to_int::<i64>().ok()
}

/// The finite numbers of an element, `N` of them.
fn numbers<const N: usize>(object: &InMemDicomObject, tag: Tag) -> Option<[f64; N]> {
    let list = object.get(tag)?.to_multi_float64().ok()?;
    <[f64; N]>::try_from(list).ok().filter(|list| list.iter().all(|number| number.is_finite()))
}

/// The first item of a sequence.
pub(super) fn first_item(object: &InMemDicomObject, tag: Tag) -> Option<&InMemDicomObject> {
    object.get(tag)?.items()?.first()
}

/// An element that is missing or holds what is not allowed.
pub(super) fn wrong(
    file: &Path,
    object: &InMemDicomObject,
    tag: Tag,
    name: &str,
    allowed: impl Into<String>,
) -> ImageError {
    let found = match object.get(tag) {
        None => "missing".to_owned(),
        Some(element) => {
            element.to_str().map_or("not readable".into(), |text| format!("\"{}\"", text.trim()))
        }
    };
    ImageError::Header {
        file: file.to_path_buf(),
        field: name.into(),
        place: HeaderPlace::Tag { group: tag.group(), element: tag.element() },
        found,
        allowed: allowed.into(),
    }
}

/// Where a frame looks for what describes it: its own functional groups, those that all frames share, the file.
struct Sources<'a> {
    file: &'a Path,
    object: &'a InMemDicomObject,
    groups: [Option<&'a InMemDicomObject>; 2],
}

impl<'a> Sources<'a> {
    /// The object that holds `tag`: the item of `group` in a functional group, or the file itself.
    fn with(&self, group: Tag, tag: Tag) -> &'a InMemDicomObject {
        let in_groups = self.groups.iter().flatten().filter_map(|groups| first_item(groups, group));
        in_groups.into_iter().find(|item| item.get(tag).is_some()).unwrap_or(self.object)
    }

    fn needed<const N: usize>(
        &self,
        group: Tag,
        tag: Tag,
        name: &str,
        allowed: &str,
    ) -> Result<[f64; N], ImageError> {
        let object = self.with(group, tag);
        numbers(object, tag).ok_or_else(|| wrong(self.file, object, tag, name, allowed))
    }

    /// One number; none where the element is absent or empty. What is there has to be readable: a scale that is
    /// silently left out makes other values.
    fn optional(&self, group: Tag, tag: Tag, name: &str) -> Result<Option<f64>, ImageError> {
        let object = self.with(group, tag);
        if object.get(tag).is_none_or(|element| element.is_empty()) {
            return Ok(None);
        }
        let found = numbers::<1>(object, tag).map(|[number]| number);
        found.map(Some).ok_or_else(|| wrong(self.file, object, tag, name, "one finite number"))
    }
}

/// Every frame of a file.
pub(super) fn frames_of(file: &Path, object: &DefaultDicomObject) -> Result<Vec<Frame>, ImageError> {
    let size = |tag, name| {
        let found = integer(object, tag).filter(|size| (1..=65_535).contains(size));
        found.map(|size| size as usize).ok_or_else(|| wrong(file, object, tag, name, "1 to 65535"))
    };
    let dims = [size(tags::COLUMNS, "Columns")?, size(tags::ROWS, "Rows")?];
    if integer(object, tags::SAMPLES_PER_PIXEL).unwrap_or(1) != 1 {
        let allowed = "1: one number a voxel (a colour image is no volume of a scanner)";
        return Err(wrong(file, object, tags::SAMPLES_PER_PIXEL, "SamplesPerPixel", allowed));
    }
    let n_frames = match object.get(tags::NUMBER_OF_FRAMES) {
        None => 1,
        Some(_) => {
            let found = integer(object, tags::NUMBER_OF_FRAMES).filter(|n| (1..=100_000).contains(n));
            found
                .ok_or_else(|| wrong(file, object, tags::NUMBER_OF_FRAMES, "NumberOfFrames", "1 to 100000"))?
        }
    } as usize;
    let shared = first_item(object, tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE);
    let own = object.get(tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE).and_then(|element| element.items());
    let offsets = if own.is_none() && n_frames > 1 { offsets_of(file, object, n_frames)? } else { None };
    if n_frames > 1 && offsets.is_none() && own.is_none_or(|items| items.len() != n_frames) {
        let allowed = format!(
            "one item a frame, {n_frames}, or as many numbers in GridFrameOffsetVector (3004,000C), which is missing too: \
             nothing says where each frame is, as in many NM and ultrasound files, and frames without a place are no \
             volume"
        );
        let tag = tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE;
        return Err(ImageError::Header {
            file: file.to_path_buf(),
            field: "PerFrameFunctionalGroupsSequence".into(),
            place: HeaderPlace::Tag { group: tag.group(), element: tag.element() },
            found: own.map_or("missing".into(), |items| format!("{} items", items.len())),
            allowed,
        });
    }
    let mut frames = Vec::with_capacity(n_frames);
    for index in 0..n_frames {
        let sources = Sources { file, object, groups: [own.and_then(|items| items.get(index)), shared] };
        let mut frame = sources.frame(index, dims)?;
        if let Some(offsets) = &offsets {
            frame.position_mm += place_of(file, object, &frame, offsets, index)?;
        }
        frames.push(frame);
    }
    Ok(frames)
}

/// Offsets of the frames of a file along its stack [mm], as RT doses have them (DICOM PS3.3, C.8.8.3.2).
fn offsets_of(
    file: &Path,
    object: &InMemDicomObject,
    n_frames: usize,
) -> Result<Option<Vec<f64>>, ImageError> {
    let tag = tags::GRID_FRAME_OFFSET_VECTOR;
    let Some(element) = object.get(tag) else { return Ok(None) };
    let offsets = element.to_multi_float64().unwrap_or_default();
    if offsets.len() != n_frames || !offsets.iter().all(|offset| offset.is_finite()) {
        // Programs that do not know an element write its bytes.
        let found = match element.vr() {
            VR::UN => "of unknown kind (UN)".into(),
            _ => format!("{} numbers", offsets.len()),
        };
        return Err(ImageError::Header {
            file: file.to_path_buf(),
            field: "GridFrameOffsetVector".into(),
            place: HeaderPlace::Tag { group: tag.group(), element: tag.element() },
            found,
            allowed: format!("one finite number in mm for each of the {n_frames} frames"),
        });
    }
    Ok(Some(offsets))
}

/// From the place of the file to that of frame `index` [mm]. Offsets that begin with zero count along the normal of the
/// planes from the file's place; others are the z of planes across the patient, the first that of the file's place.
fn place_of(
    file: &Path,
    object: &InMemDicomObject,
    frame: &Frame,
    offsets: &[f64],
    index: usize,
) -> Result<DVec3, ImageError> {
    let (normal, start_mm) = (frame.normal(), frame.position_mm.z);
    if offsets[0] == 0.0 {
        return Ok(normal * offsets[index]);
    }
    let is_across = normal.z.abs() > 1.0 - 1e-6;
    if is_across && (offsets[0] - start_mm).abs() < 1e-2 {
        return Ok(DVec3::Z * (offsets[index] - offsets[0]));
    }
    let allowed = format!(
        "numbers that begin with 0, or, of planes across the patient, with the z of ImagePositionPatient, {start_mm}"
    );
    Err(wrong(file, object, tags::GRID_FRAME_OFFSET_VECTOR, "GridFrameOffsetVector", allowed))
}

impl Sources<'_> {
    fn frame(&self, index: usize, dims: [usize; 2]) -> Result<Frame, ImageError> {
        let [x, y, z] = self.needed(
            tags::PLANE_POSITION_SEQUENCE,
            tags::IMAGE_POSITION_PATIENT,
            "ImagePositionPatient",
            "three numbers in mm: where the slice is",
        )?;
        let axes: [f64; 6] = self.needed(
            tags::PLANE_ORIENTATION_SEQUENCE,
            tags::IMAGE_ORIENTATION_PATIENT,
            "ImageOrientationPatient",
            "six numbers: the directions of rows and columns, without which nothing says which side is left",
        )?;
        let directions = [DVec3::new(axes[0], axes[1], axes[2]), DVec3::new(axes[3], axes[4], axes[5])];
        let is_pair = directions.iter().all(|d| (d.length() - 1.0).abs() < 1e-3);
        if !is_pair || directions[0].dot(directions[1]).abs() > 1e-3 {
            let object = self.with(tags::PLANE_ORIENTATION_SEQUENCE, tags::IMAGE_ORIENTATION_PATIENT);
            let allowed = "two directions of length 1 at a right angle";
            return Err(wrong(
                self.file,
                object,
                tags::IMAGE_ORIENTATION_PATIENT,
                "ImageOrientationPatient",
                allowed,
            ));
        }
        let measures = tags::PIXEL_MEASURES_SEQUENCE;
        let [of_rows, of_columns]: [f64; 2] =
            self.needed(measures, tags::PIXEL_SPACING, "PixelSpacing", "two sizes above 0 in mm")?;
        if of_rows <= 0.0 || of_columns <= 0.0 {
            let object = self.with(measures, tags::PIXEL_SPACING);
            return Err(wrong(
                self.file,
                object,
                tags::PIXEL_SPACING,
                "PixelSpacing",
                "two sizes above 0 in mm",
            ));
        }
        let between = self.optional(measures, tags::SPACING_BETWEEN_SLICES, "SpacingBetweenSlices")?;
        let thickness = self.optional(measures, tags::SLICE_THICKNESS, "SliceThickness")?;
        let values = tags::PIXEL_VALUE_TRANSFORMATION_SEQUENCE;
        // Doses have a scale of their own (DICOM PS3.3, C.8.8.3.4).
        let dose = self.optional(values, tags::DOSE_GRID_SCALING, "DoseGridScaling")?;
        let slope = dose.or(self.optional(values, tags::RESCALE_SLOPE, "RescaleSlope")?).unwrap_or(1.0);
        let intercept = self.optional(values, tags::RESCALE_INTERCEPT, "RescaleIntercept")?.unwrap_or(0.0);
        let size = |size: Option<f64>| size.map(f64::abs).filter(|&size| size > 0.0);
        let segment = self.with(tags::SEGMENT_IDENTIFICATION_SEQUENCE, tags::REFERENCED_SEGMENT_NUMBER);
        Ok(Frame {
            file: self.file.to_path_buf(),
            index,
            dims,
            position_mm: DVec3::new(x, y, z),
            directions: directions.map(DVec3::normalize),
            spacing_mm: [of_columns, of_rows],
            between_mm: size(between),
            thickness_mm: size(thickness),
            slope,
            intercept,
            segment: integer(segment, tags::REFERENCED_SEGMENT_NUMBER).and_then(|n| u16::try_from(n).ok()),
        })
    }
}
