//! Contours on the slices of an image, as `glisson segment` writes and reads them.

use std::path::Path;

use anyhow::Context;
use glisson::image::contours::SliceContour;
use glisson::math::DVec2;
use serde::{Deserialize, Serialize};

use super::output::make_folder_of;

/// A file of contours.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ContourFile {
    contours: Vec<ContourRecord>,
}

/// A closed outline.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ContourRecord {
    /// Slice k from 0.
    slice: usize,
    /// Corners [mm] along i and j, from the centre of the first voxel of the slice.
    points_mm: Vec<[f64; 2]>,
}

pub(crate) fn read(path: &Path) -> anyhow::Result<Vec<SliceContour>> {
    let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
    let file: ContourFile = serde_json::from_str(&text).with_context(|| {
        format!(
            "{}: no contours; expected {{\"contours\": [{{\"slice\": 12, \"points_mm\": [[80, 110.5], ...]}}]}}, as --contours-out writes them",
            path.display()
        )
    })?;
    let contours = file.contours.into_iter().map(|contour| SliceContour {
        slice: contour.slice,
        points_m: contour.points_mm.into_iter().map(|p| 1e-3 * DVec2::from_array(p)).collect(),
    });
    Ok(contours.collect())
}

pub(crate) fn write(path: &Path, contours: &[SliceContour]) -> anyhow::Result<()> {
    let contours = contours.iter().map(|contour| ContourRecord {
        slice: contour.slice,
        points_mm: contour.points_m.iter().map(|&p| (1e3 * p).to_array()).collect(),
    });
    let file = ContourFile { contours: contours.collect() };
    make_folder_of(path)?;
    glisson::files::write_atomically(path, |out| Ok(serde_json::to_writer(out, &file)?))
        .with_context(|| path.display().to_string())
}
