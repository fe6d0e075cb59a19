//! The patient's image and the organ in it.

use anyhow::{Context, ensure};
use glisson::image::files::{SeriesChoice, StoredImage, read_image, read_series, series_in};
use glisson::image::labels::{Parts, mask_volume_m3, sides_at_border};
use glisson::image::segment::{SeededParams, Seeds, segment_with_seeds};
use glisson::image::{LabelMap, Volume, VoxelGrid};
use glisson::math::DVec3;
use glisson::mesh::TetMesh;
use glisson::mesh::generate::{MeshParams, MeshReport, WantedSize, generate};
use glisson::mesh::topology::{Topology, surface_of};
use glisson::surface::extract::{SurfaceParams, surface_of_mask};
use serde_json::{Value, json};
use std::path::Path;

use crate::picture::{
    Camera, Look, Picture, PictureScene, ShadedSurface, SlicePlane, SliceSpec, View, slice_picture,
};

/// Window of a CT's soft tissue [HU]: centre and width.
const SOFT_TISSUE_HU: [f64; 2] = [60.0, 400.0];
/// Values below this are of a CT: air.
const AIR_HU: f32 = -300.0;
/// Voxels in each direction at least.
const LEAST_VOXELS: usize = 4;
/// Height of a slice's picture, and its width at most [pixels].
const SLICE_HEIGHT: usize = 420;
const SLICE_WIDTH: f64 = 2000.0;
/// Size of the organ's picture [pixels].
const ORGAN_SIZE: [usize; 2] = [640, 420];

/// An image as it was read.
pub(super) struct Image {
    /// Values of tissue, or the numbers of labels.
    volume: Volume<f32>,
    /// Organs that were found elsewhere; none where an organ is to be found.
    labels: Option<LabelMap>,
    /// What the page shows of it.
    pub(super) summary: Value,
}

/// An organ in the image.
pub(super) struct Organ {
    /// 1 inside, on the image's grid.
    pub(super) map: LabelMap,
    pub(super) summary: Value,
}

/// Its tetrahedra.
pub(super) struct Meshed {
    pub(super) mesh: TetMesh,
    pub(super) picture: Vec<u8>,
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
        let volume = stored.volume();
        let labels = if stored.is_of_labels() { Some(stored.label_map()?) } else { stored.likely_labels() };
        let bounds = volume.grid.bounds_m();
        let mm = |p: DVec3| (p * 1e3).to_array();
        let (least, most) =
            volume.values.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(a, b), v| (a.min(*v), b.max(*v)));
        let window = match &labels {
            Some(_) => [0.5 * f64::from(most), f64::from(most).max(1.0)],
            None if least < AIR_HU => SOFT_TISSUE_HU,
            None => [0.5 * f64::from(least + most), f64::from(most - least).max(1.0)],
        };
        let organs: Vec<Value> = labels
            .iter()
            .flat_map(|map| {
                map.present().into_iter().map(|label| json!({
            "label": label, "name": map.name_of(label).map_or_else(|| label.to_string(), String::from),
        }))
            })
            .collect();
        let summary = json!({
            "format": stored.format,
            "modality": stored.modality,
            "voxels": volume.grid.dims,
            "spacing_mm": mm(volume.grid.spacing_m),
            "steps_mm": mm(steps_m(&volume.grid)),
            "from_mm": mm(bounds.min_m),
            "to_mm": mm(bounds.max_m),
            "window": window,
            "values": [least, most],
            "labels": organs,
            "notes": stored.notes,
        });
        Ok(Self { volume, labels, summary })
    }

    /// A slice as PNG, with the organ, or the image's own labels, over it.
    pub(super) fn slice_png(
        &self,
        organ: Option<&Organ>,
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
        slice_picture(&self.volume, organ.map(|organ| &organ.map).or(self.labels.as_ref()), &spec)?.png()
    }

    /// The organ around points inside and away from those outside; without points the liver.
    pub(super) fn find_organ(&self, inside_m: Vec<DVec3>, outside_m: Vec<DVec3>) -> anyhow::Result<Organ> {
        ensure!(self.labels.is_none(), "the image holds labels: choose one of them");
        let found =
            segment_with_seeds(&self.volume, &Seeds { inside_m, outside_m }, &SeededParams::default())?;
        Ok(Organ::of(self, &found.mask))
    }

    /// The organ of a label.
    pub(super) fn choose_label(&self, name: &str) -> anyhow::Result<Organ> {
        let map =
            self.labels.as_ref().context("the image holds values, no labels: find the organ by points")?;
        let selection = map.select(name, Parts::Included)?;
        Ok(Organ::of(self, &map.mask(&selection)))
    }
}

impl Organ {
    fn of(image: &Image, mask: &[bool]) -> Self {
        let grid = image.volume.grid.clone();
        let summary = json!({
            "volume_ml": 1e6 * mask_volume_m3(&grid, mask),
            "cut_off_at": sides_at_border(&grid, mask),
        });
        let labels = mask.iter().map(|&inside| u16::from(inside)).collect();
        Self {
            map: LabelMap { grid, labels, names: vec![(1, "organ".into())], colours: Vec::new() },
            summary,
        }
    }

    /// Fills the organ with about so many tetrahedra.
    pub(super) fn mesh(&self, n_tets: usize) -> anyhow::Result<Meshed> {
        let grid = &self.map.grid;
        let mask: Vec<bool> = self.map.labels.iter().map(|&label| label != 0).collect();
        let is_cut_off = !sides_at_border(grid, &mask).is_empty();
        let params = SurfaceParams { cap_at_border: is_cut_off, ..SurfaceParams::default() };
        let (surface, _) = surface_of_mask(grid, &mask, &params).context("the surface of the organ")?;
        let volume_m3 = mask_volume_m3(grid, &mask);
        let params = MeshParams { size: WantedSize::Tetrahedra(n_tets), volume_m3: Some(volume_m3) };
        let (mesh, report) = generate(&surface, &params).context("filling the organ with tetrahedra")?;
        let picture = picture_of(&mesh)?;
        let summary = summary_of(&mesh, &report, volume_m3);
        Ok(Meshed { mesh, picture, summary })
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

fn picture_of(mesh: &TetMesh) -> anyhow::Result<Vec<u8>> {
    let (surface, _) = surface_of(&Topology::build(mesh)?, mesh);
    ensure!(!surface.triangles.is_empty(), "the mesh has no surface");
    let camera = Camera::framing_points(&surface.positions_m, ORGAN_SIZE, View::default());
    let scene = PictureScene {
        surfaces: vec![ShadedSurface {
            rest_positions_m: surface.positions_m.clone(),
            positions_m: surface.positions_m,
            triangles: surface.triangles,
            look: Look::Liver,
        }],
        instruments: Vec::new(),
        arrows: Vec::new(),
        captions: Vec::new(),
        camera,
        size: ORGAN_SIZE,
    };
    Picture::render(&scene)?.png()
}

fn summary_of(mesh: &TetMesh, report: &MeshReport, volume_m3: f64) -> Value {
    let quality = &report.quality;
    json!({
        "tetrahedra": mesh.tetrahedra.len(),
        "nodes": mesh.positions_m.len(),
        "volume_ml": 1e6 * quality.volume_m3,
        "volume_error": quality.volume_m3 / volume_m3 - 1.0,
        "dihedral_deg": [quality.min_dihedral_deg, quality.max_dihedral_deg],
        "mean_edge_mm": 1e3 * quality.mean_edge_m,
        "thin_places": report.thin_features.len(),
    })
}
