//! A volume out of the planes of a series.

use std::path::Path;

use super::super::error::ImageError;
use super::super::placement::right_angled;
use super::super::stored::{StoredData, StoredImage};
use super::frames::{Frame, frames_of};
use super::pixels::Pixels;
use super::series::{Series, open};
use super::tilt::Tilt;
use crate::binary::{ByteOrder, NumberType};
use crate::image::VoxelGrid;
use crate::math::DVec3;
use crate::progress::tell;

/// What people call the format.
pub(super) const NAME: &str = "DICOM";

/// Largest difference of the directions of two slices.
const MAX_TURN: f64 = 1e-3;
/// Largest difference of two distances between slices, as a share of the usual one.
const MAX_UNEVENNESS: f64 = 0.02;
/// Slices nearer than this share of the usual distance are at one place.
const SAME_PLACE: f64 = 0.01;

/// The frames of all files of a series.
pub(super) fn frames_of_series(folder: &Path, series: &Series) -> Result<Vec<Frame>, ImageError> {
    let mut frames: Vec<Frame> = Vec::new();
    for file in &series.files {
        frames.extend(frames_of(file, &open(file, false)?)?);
    }
    let first = &frames[0];
    for frame in &frames[1..] {
        let refuse = |reason: String| Err(ImageError::Series { folder: folder.to_path_buf(), reason });
        let names = || format!("{} and {}", first.name(), frame.name());
        if frame.dims != first.dims {
            let ([a, b], [c, d]) = (first.dims, frame.dims);
            return refuse(format!("slices of {a} x {b} and {c} x {d} voxels in one series ({})", names()));
        }
        let turn = (0..2).map(|a| frame.directions[a].distance(first.directions[a])).fold(0.0, f64::max);
        if turn > MAX_TURN {
            return refuse(format!(
                "slices in different directions in one series ({}), as a localiser has; choose the files of one direction",
                names()
            ));
        }
        let is_same = (0..2).all(|a| (frame.spacing_mm[a] / first.spacing_mm[a] - 1.0).abs() < 1e-3);
        if !is_same {
            let (a, b) = (first.spacing_mm, frame.spacing_mm);
            return refuse(format!("voxels of {a:?} and {b:?} mm in one series ({})", names()));
        }
    }
    Ok(frames)
}

/// The place of a frame along the normal of its series [mm].
fn height_mm(frame: &Frame, normal: DVec3) -> f64 {
    frame.position_mm.dot(normal)
}

/// The middle one of the distances between neighbours that are not at one place; none without two places.
fn usual_distance_mm(sorted_heights_mm: &[f64]) -> Option<f64> {
    let reach_mm = sorted_heights_mm.last()? - sorted_heights_mm.first()?;
    let mut distances: Vec<f64> = sorted_heights_mm
        .windows(2)
        .map(|pair| pair[1] - pair[0])
        .filter(|&distance| distance > 1e-6 * reach_mm)
        .collect();
    distances.sort_by(f64::total_cmp);
    distances.get(distances.len() / 2).copied()
}

/// The frames in order along the normal, one at each place, and their distance [mm].
fn in_order(
    folder: &Path,
    mut frames: Vec<Frame>,
    notes: &mut Vec<String>,
) -> Result<(Vec<Frame>, f64), ImageError> {
    let refuse = |reason: String| Err(ImageError::Series { folder: folder.to_path_buf(), reason });
    let normal = frames[0].normal();
    frames.sort_by(|a, b| height_mm(a, normal).total_cmp(&height_mm(b, normal)));
    let heights: Vec<f64> = frames.iter().map(|frame| height_mm(frame, normal)).collect();
    let Some(usual_mm) = usual_distance_mm(&heights) else {
        if frames.len() > 1 {
            return refuse(format!(
                "{} slices at one place, e.g. of a measurement over time: not a volume",
                frames.len()
            ));
        }
        let distance_mm = frames[0].between_mm.or(frames[0].thickness_mm).unwrap_or(frames[0].spacing_mm[0]);
        return Ok((frames, distance_mm));
    };
    let mut kept: Vec<Frame> = Vec::with_capacity(frames.len());
    let mut n_twice = 0;
    for frame in frames {
        let Some(last) = kept.last() else {
            kept.push(frame);
            continue;
        };
        let distance_mm = height_mm(&frame, normal) - height_mm(last, normal);
        if distance_mm <= SAME_PLACE * usual_mm {
            if !have_same_content(last, &frame)? {
                return refuse(format!(
                    "two different slices at one place ({} and {}): several volumes in one series, e.g. phases of a \
                     contrast agent; keep the files of one of them",
                    last.name(),
                    frame.name()
                ));
            }
            n_twice += 1;
            continue;
        }
        if (distance_mm / usual_mm - 1.0).abs() > MAX_UNEVENNESS {
            let n_missing = distance_mm / usual_mm - 1.0;
            let is_gap =
                n_missing > 0.5 && (n_missing - n_missing.round()).abs() < MAX_UNEVENNESS * (1.0 + n_missing);
            let (place, name, next) = (height_mm(last, normal), last.name(), frame.name());
            return refuse(match is_gap {
                true => format!(
                    "{n_missing:.0} slice(s) missing between {name} and {next}, {distance_mm:.2} mm apart behind \
                     {place:.2} mm where slices are {usual_mm:.2} mm apart; export the series again, whole"
                ),
                false => format!(
                    "slices at uneven distances: {distance_mm:.3} mm between {name} and {next}, {usual_mm:.3} mm \
                     elsewhere; resample the image to even slices (e.g. with 3D Slicer)"
                ),
            });
        }
        kept.push(frame);
    }
    if n_twice > 0 {
        notes.push(format!("{n_twice} slice(s) were there twice with the same content and were taken once"));
    }
    let last = kept.len() - 1;
    let reach_mm = height_mm(&kept[last], normal) - height_mm(&kept[0], normal);
    Ok((kept, reach_mm / last as f64))
}

fn have_same_content(a: &Frame, b: &Frame) -> Result<bool, ImageError> {
    let values = |frame: &Frame| {
        let object = open(&frame.file, true)?;
        Pixels::new(&frame.file, &object, frame.dims, frame.index + 1)?.of_frame(frame.index)
    };
    Ok((a.slope, a.intercept) == (b.slope, b.intercept) && values(a)? == values(b)?)
}

/// The step from each plane to the next [mm]: that of their positions, which leans in slices of a tilted gantry.
fn step_of(folder: &Path, frames: &[Frame], distance_mm: f64) -> Result<DVec3, ImageError> {
    let first = &frames[0];
    let last = frames.len() - 1;
    let step = match last {
        0 => first.normal() * distance_mm,
        _ => (frames[last].position_mm - first.position_mm) / last as f64,
    };
    for (n, frame) in frames.iter().enumerate() {
        let off_mm = frame.position_mm.distance(first.position_mm + step * n as f64);
        let allowed_mm = 0.1 * first.spacing_mm[0].min(first.spacing_mm[1]).min(distance_mm);
        if off_mm > allowed_mm.max(MAX_UNEVENNESS * distance_mm * 2.0) {
            let reason = format!(
                "{} lies {off_mm:.2} mm beside the line of the other slices, {allowed_mm:.2} mm allowed; resample the image",
                frame.name()
            );
            return Err(ImageError::Series { folder: folder.to_path_buf(), reason });
        }
    }
    Ok(step)
}

/// The grid of planes in order that stand above each other.
fn grid_of(folder: &Path, frames: &[Frame], distance_mm: f64, step: DVec3) -> Result<VoxelGrid, ImageError> {
    let first = &frames[0];
    let [columns_mm, rows_mm] = first.spacing_mm;
    let dims = [first.dims[0], first.dims[1], frames.len()];
    let spacing_m = DVec3::new(columns_mm, rows_mm, distance_mm) * 1e-3;
    let steps = [first.directions[0], first.directions[1], step];
    right_angled(folder, dims, steps, spacing_m, first.position_mm * 1e-3)
}

/// The volume of a series.
///
/// # Errors
/// Slices that are no volume (see the module), or pixels that cannot be decoded.
pub(super) fn volume(folder: &Path, series: &Series) -> Result<StoredImage, ImageError> {
    let frames = frames_of_series(folder, series)?;
    let mut notes = Vec::new();
    let (frames, distance_mm) = in_order(folder, frames, &mut notes)?;
    let step_mm = step_of(folder, &frames, distance_mm)?;
    let tilt = Tilt::of(folder, &frames[0], frames.len(), step_mm)?;
    let is_interpolated = tilt.as_ref().is_some_and(Tilt::is_between_voxels);
    let (grid, data) = match tilt {
        None => (grid_of(folder, &frames, distance_mm, step_mm)?, numbers_of(&frames)?),
        Some(tilt) => {
            let (data, note) = tilt.straighten(&numbers_of(&frames)?);
            notes.push(note);
            (tilt.grid, data)
        }
    };
    let mut image = StoredImage::new(folder, NAME, grid, data);
    image.notes = notes;
    image.is_interpolated = is_interpolated;
    Ok(image)
}

/// The numbers of frames, one after the other: as they are stored where all mean the same, else scaled.
fn numbers_of(frames: &[Frame]) -> Result<StoredData, ImageError> {
    let (slope, intercept) = (frames[0].slope, frames[0].intercept);
    let mean_same = frames.iter().all(|frame| (frame.slope, frame.intercept) == (slope, intercept));
    if mean_same && let Some((kind, bytes)) = bytes_as_stored(frames)? {
        return Ok(StoredData { slope, intercept, ..StoredData::plain(kind, ByteOrder::Little, bytes, 0) });
    }
    let mut bytes = Vec::new();
    for_each_frame(frames, |frame, _, values| {
        for value in values {
            bytes.extend(((value as f64 * frame.slope + frame.intercept) as f32).to_le_bytes());
        }
    })?;
    Ok(StoredData::plain(NumberType::F32, ByteOrder::Little, bytes, 0))
}

/// The numbers of frames in the type in which all are stored; none where the types differ.
fn bytes_as_stored(frames: &[Frame]) -> Result<Option<(NumberType, Vec<u8>)>, ImageError> {
    let (mut first, mut differ, mut bytes) = (None, false, Vec::new());
    for_each_frame(frames, |_, kind, values| {
        differ |= *first.get_or_insert(kind) != kind;
        for value in values {
            bytes.extend_from_slice(&value.to_le_bytes()[..kind.n_bytes()]);
        }
    })?;
    Ok(first.filter(|_| !differ).map(|kind| (kind, bytes)))
}

/// Calls `visit` with each frame, the type of its numbers, and these.
fn for_each_frame(
    frames: &[Frame],
    mut visit: impl FnMut(&Frame, NumberType, Vec<i64>),
) -> Result<(), ImageError> {
    // Frames of one file that stand together, as they mostly do, are taken while it is open.
    let mut n_done = 0;
    for together in frames.chunk_by(|a, b| a.file == b.file) {
        tell(n_done as f64 / frames.len() as f64);
        n_done += together.len();
        let file = &together[0].file;
        let object = open(file, true)?;
        let n_needed = together.iter().map(|frame| frame.index + 1).max().unwrap_or(1);
        let pixels = Pixels::new(file, &object, together[0].dims, n_needed)?;
        for frame in together {
            visit(frame, pixels.number_type(), pixels.of_frame(frame.index)?);
        }
    }
    Ok(())
}
