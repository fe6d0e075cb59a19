//! The patient's image: what it holds, and slices of it.

use anyhow::{Context, ensure};
use glisson::image::files::{SeriesChoice, StoredImage, read_image, read_series, series_in};
use glisson::image::{LabelMap, Volume, VoxelGrid};
use glisson::math::DVec3;
use serde_json::{Value, json};
use std::path::Path;
use std::sync::Arc;

use glisson_picture::{SlicePlane, SliceSpec, slice_picture};

/// Window of a CT's soft tissue [HU]: centre and width.
const SOFT_TISSUE_HU: [f64; 2] = [60.0, 400.0];
/// Values below this are of a CT: air.
const AIR_HU: f32 = -300.0;
/// Voxels in each direction at least.
const LEAST_VOXELS: usize = 4;
/// Height of a slice's picture, and its width at most [pixels].
const SLICE_HEIGHT: usize = 420;
const SLICE_WIDTH: f64 = 2000.0;
/// An image as it was read.
pub(super) struct Image {
    /// Values of tissue, or the numbers of labels.
    volume: Arc<Volume<f32>>,
    /// Organs that were found elsewhere; none where an organ is to be found.
    labels: Option<LabelMap>,
    /// What its file says: format, modality, notes.
    about: Value,
    /// What the page shows of it.
    pub(super) summary: Value,
}

/// The series of a folder, for who has to choose one; none where it is no DICOM folder with several.
pub(super) fn series_of(path: &Path) -> Vec<String> {
    let series = series_in(path).unwrap_or_default();
    if series.len() < 2 { Vec::new() } else { series.iter().map(ToString::to_string).collect() }
}

impl Image {
    /// Reads a file or folder; of several DICOM series the one of this number, from 1.
    pub(super) fn read(path: &Path, series: Option<usize>) -> anyhow::Result<Self> {
        let stored = match series {
            Some(number) => read_series(path, &SeriesChoice::Number(number)),
            None => read_image(path),
        }?;
        Self::of(&stored)
    }

    fn of(stored: &StoredImage) -> anyhow::Result<Self> {
        let dims = stored.grid.dims;
        ensure!(
            dims.iter().all(|n| *n >= LEAST_VOXELS),
            "found {} x {} x {} voxels, at least {LEAST_VOXELS} are needed in each direction to find an organ",
            dims[0],
            dims[1],
            dims[2]
        );
        let volume = Arc::new(stored.volume());
        let are_named = stored.is_of_labels();
        let labels = if are_named { Some(stored.label_map()?) } else { stored.likely_labels() };
        let about = json!({
            "format": stored.format,
            "modality": stored.modality,
            "notes": stored.notes,
            "are_labels_guessed": labels.is_some() && !are_named,
        });
        Ok(Self::new(volume, labels, about))
    }

    fn new(volume: Arc<Volume<f32>>, labels: Option<LabelMap>, about: Value) -> Self {
        let grid = &volume.grid;
        let bounds = grid.bounds_m();
        let mm = |p: DVec3| (p * 1e3).to_array();
        let (least, most) =
            volume.values.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(a, b), v| (a.min(*v), b.max(*v)));
        let window = match &labels {
            Some(_) => [0.5 * f64::from(most), f64::from(most).max(1.0)],
            None if least < AIR_HU => SOFT_TISSUE_HU,
            None => [0.5 * f64::from(least + most), f64::from(most - least).max(1.0)],
        };
        let name_of =
            |map: &LabelMap, label: u16| map.name_of(label).map_or_else(|| label.to_string(), String::from);
        let organs: Vec<Value> = labels
            .iter()
            .flat_map(|map| map.present().into_iter().map(move |label| (label, name_of(map, label))))
            .map(|(label, name)| json!({"label": label, "name": name}))
            .collect();
        let mut summary = json!({
            "voxels": grid.dims,
            "spacing_mm": mm(grid.spacing_m),
            "steps_mm": mm(steps_m(grid)),
            "from_mm": mm(bounds.min_m),
            "to_mm": mm(bounds.max_m),
            "window": window,
            "values": [least, most],
            "labels": organs,
            "plane_of_slices": plane_of_slices(grid),
        });
        if let (Some(summary), Some(about)) = (summary.as_object_mut(), about.as_object()) {
            summary.extend(about.clone());
        }
        Self { volume, labels, about, summary }
    }

    /// The same with its numbers as values, where they were taken for labels.
    pub(super) fn as_values(&self) -> anyhow::Result<Self> {
        ensure!(
            self.about["are_labels_guessed"] == true,
            "the file says what its numbers are; only a guess can be corrected"
        );
        let mut about = self.about.clone();
        about["are_labels_guessed"] = false.into();
        Ok(Self::new(Arc::clone(&self.volume), None, about))
    }

    pub(super) fn grid(&self) -> &VoxelGrid {
        &self.volume.grid
    }

    /// The values, to find an organ in.
    pub(super) fn values(&self) -> anyhow::Result<&Volume<f32>> {
        ensure!(self.labels.is_none(), "the image holds labels: choose one of them");
        Ok(&self.volume)
    }

    /// The labels, to choose one of.
    pub(super) fn labels(&self) -> anyhow::Result<&LabelMap> {
        self.labels.as_ref().context("the image holds values, no labels: find the organ by points")
    }

    /// A slice as PNG, with the organs, or the image's own labels, over it.
    pub(super) fn slice_png(
        &self,
        organs: Option<&LabelMap>,
        plane: SlicePlane,
        through_m: DVec3,
        window_centre_width: [f64; 2],
    ) -> anyhow::Result<Vec<u8>> {
        let size_m = self.volume.grid.bounds_m().size_m();
        let aspect = match plane {
            SlicePlane::Axial => size_m.x / size_m.y,
            SlicePlane::Coronal => size_m.x / size_m.z,
            SlicePlane::Sagittal => size_m.y / size_m.z,
        };
        let spec = SliceSpec {
            plane,
            through_m,
            window_centre_width,
            shown_labels: Vec::new(),
            height: SLICE_HEIGHT.min((SLICE_WIDTH / aspect) as usize).max(1),
            caption: String::new(),
        };
        slice_picture(&self.volume, organs.or(self.labels.as_ref()), &spec)?.png()
    }
}

/// Distance of the voxels' layers along each patient axis [m]: that of the voxel axis that is nearest to it.
fn steps_m(grid: &VoxelGrid) -> DVec3 {
    let of_axis = |patient: usize| {
        let along = |voxel: &usize| grid.axes.col(*voxel)[patient].abs();
        let nearest = (0..3).max_by(|a, b| along(a).total_cmp(&along(b))).unwrap_or(patient);
        grid.spacing_m[nearest]
    };
    DVec3::from([0, 1, 2].map(of_axis))
}

/// The plane that the image's slices (of constant k) are nearest to: where outlines are drawn.
fn plane_of_slices(grid: &VoxelGrid) -> &'static str {
    let normal = grid.axes.z_axis.abs();
    ["sagittal", "coronal", "axial"][normal.max_position()]
}
