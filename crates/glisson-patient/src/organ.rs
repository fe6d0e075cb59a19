//! The organs that were found in the image, one after the other.

use anyhow::ensure;
use glisson::image::contours::{ContourParams, SliceContour, segment_by_contours};
use glisson::image::labels::{Parts, mask_volume_m3, sides_at_border};
use glisson::image::segment::{SeededParams, Seeds, segment_with_seeds};
use glisson::image::{LabelMap, VoxelGrid};
use glisson::math::DVec3;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::sync::Arc;

use super::image::Image;

/// Letters of an organ's name at most.
const MOST_NAME: usize = 60;
/// Organs at most: more are no scene for a hand.
const MOST_ORGANS: usize = 30;
/// How far a point of a contour may be from the middle of its slice [slices].
const HALF_SLICE: f64 = 0.51;

/// How an organ is found where the image shows values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Method {
    /// By points inside and outside: the surface of least area that is drawn to edges.
    #[default]
    Points,
    /// By contours, slice by slice.
    Contours,
}

/// An outline in a slice of the image, LPS [mm].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Outline {
    /// A point of the slice.
    through_mm: [f64; 3],
    /// Corners in turn; none: the organ is not in this slice.
    points_mm: Vec<[f64; 3]>,
}

/// How the page wants an organ to be found.
#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct OrganChoice {
    name: String,
    /// One of the image's labels.
    label: Option<String>,
    method: Method,
    inside_mm: Vec<[f64; 3]>,
    outside_mm: Vec<[f64; 3]>,
    /// Drawn by hand, for contours.
    outlines: Vec<Outline>,
}

/// An organ in the image.
pub(super) struct Organ {
    pub(super) name: String,
    /// Whether each voxel of the image is inside.
    mask: Vec<bool>,
    /// The contours that it was made from.
    pub(super) outlines: Vec<Outline>,
    pub(super) summary: Value,
}

/// All organs, in the order in which they were found.
#[derive(Default)]
pub(super) struct Organs {
    list: Vec<Arc<Organ>>,
    /// From 1, in this order; where organs overlap the later one counts: a tumour lies in its organ.
    map: Option<LabelMap>,
}

impl OrganChoice {
    /// Finds the organ.
    pub(super) fn find(self, image: &Image) -> anyhow::Result<Organ> {
        let name = self.name.trim().to_owned();
        let n_letters = name.chars().count();
        ensure!(
            (1..=MOST_NAME).contains(&n_letters) && !name.contains(char::is_control),
            "found a name of {n_letters} letters for the organ, allowed: 1 to {MOST_NAME}"
        );
        if let Some(label) = &self.label {
            let map = image.labels()?;
            let mask = map.mask(&map.select(label, Parts::Included)?);
            return Ok(Organ::of(&map.grid, name, mask, Vec::new(), &[]));
        }
        let ct = image.values()?;
        let in_m = |points: Vec<[f64; 3]>| points.into_iter().map(|p| 1e-3 * DVec3::from_array(p)).collect();
        let inside_m: Vec<DVec3> = in_m(self.inside_mm);
        match self.method {
            Method::Points => {
                ensure!(self.outlines.is_empty(), "outlines are for the method of contours");
                let seeds = Seeds { inside_m, outside_m: in_m(self.outside_mm) };
                let found = segment_with_seeds(ct, &seeds, &SeededParams::default())?;
                Ok(Organ::of(&ct.grid, name, found.mask, Vec::new(), &[]))
            }
            Method::Contours => {
                ensure!(
                    self.outside_mm.is_empty(),
                    "points outside are for the method of points: draw the contours"
                );
                let corrections = self.outlines.iter().map(|outline| outline.in_slice(&ct.grid));
                let params = ContourParams {
                    seeds_m: inside_m,
                    corrections: corrections.collect::<anyhow::Result<_>>()?,
                    ..ContourParams::default()
                };
                let found = segment_by_contours(ct, &params)?;
                let outlines = found.contours.iter().map(|contour| Outline::of(contour, &ct.grid)).collect();
                let restless = &found.report.slices_not_at_rest;
                let not_at_rest: Vec<_> = restless.iter().map(|k| slice_middle_mm(&ct.grid, *k)).collect();
                Ok(Organ::of(&ct.grid, name, found.mask, outlines, &not_at_rest))
            }
        }
    }
}

/// The middle of slice `k`, LPS [mm].
fn slice_middle_mm(grid: &VoxelGrid, k: usize) -> [f64; 3] {
    let [i, j, _] = grid.dims.map(|n| 0.5 * (n as f64 - 1.0));
    rounded_mm(grid.position_m(DVec3::new(i, j, k as f64)))
}

/// To the hundredth of a millimetre: what a page needs.
fn rounded_mm(point_m: DVec3) -> [f64; 3] {
    ((1e5 * point_m).round() * 1e-2).to_array()
}

impl Outline {
    fn of(contour: &SliceContour, grid: &VoxelGrid) -> Self {
        let at = |p: &glisson::math::DVec2| {
            let in_slice = *p / grid.spacing_m.truncate();
            rounded_mm(grid.position_m(in_slice.extend(contour.slice as f64)))
        };
        Self {
            through_mm: slice_middle_mm(grid, contour.slice),
            points_mm: contour.points_m.iter().map(at).collect(),
        }
    }

    /// In the nearest slice of the image.
    fn in_slice(&self, grid: &VoxelGrid) -> anyhow::Result<SliceContour> {
        let voxel = |p: &[f64; 3]| grid.voxel_at(1e-3 * DVec3::from_array(*p));
        let k = voxel(&self.through_mm).z;
        let last = grid.dims[2] as f64 - 1.0;
        ensure!(
            k >= -0.5 && k <= last + 0.5,
            "an outline through {:?} mm is outside the image's slices",
            self.through_mm
        );
        let k = k.round().clamp(0.0, last);
        let mut points_m = Vec::with_capacity(self.points_mm.len());
        for point_mm in &self.points_mm {
            let at = voxel(point_mm);
            ensure!(
                (at.z - k).abs() <= HALF_SLICE,
                "an outline goes through several slices of the image, {:.1} slices off at {point_mm:?} mm: the slices are \
                 oblique to the plane it was drawn in",
                at.z - k
            );
            points_m.push(at.truncate() * grid.spacing_m.truncate());
        }
        Ok(SliceContour { slice: k as usize, points_m })
    }
}

impl Organ {
    fn of(
        grid: &VoxelGrid,
        name: String,
        mask: Vec<bool>,
        outlines: Vec<Outline>,
        not_at_rest_mm: &[[f64; 3]],
    ) -> Self {
        let summary = json!({
            "name": name,
            "volume_ml": 1e6 * mask_volume_m3(grid, &mask),
            "cut_off_at": sides_at_border(grid, &mask),
            "n_outlines": outlines.len(),
            "not_at_rest_mm": not_at_rest_mm,
        });
        Self { name, mask, outlines, summary }
    }
}

impl Organs {
    pub(super) fn list(&self) -> &[Arc<Organ>] {
        &self.list
    }

    /// The label map of all organs; none without an organ.
    pub(super) fn map(&self) -> Option<&LabelMap> {
        self.map.as_ref()
    }

    /// With another organ, in place of one that has its name.
    pub(super) fn with(&self, organ: Organ, grid: &VoxelGrid) -> anyhow::Result<Self> {
        let mut list = self.list.clone();
        let organ = Arc::new(organ);
        match list.iter_mut().find(|known| known.name == organ.name) {
            Some(known) => *known = organ,
            None => list.push(organ),
        }
        ensure!(list.len() <= MOST_ORGANS, "found {} organs, allowed: {MOST_ORGANS}", list.len());
        Ok(Self::of(list, grid))
    }

    pub(super) fn without(&self, name: &str, grid: &VoxelGrid) -> Self {
        Self::of(self.list.iter().filter(|organ| organ.name != name).cloned().collect(), grid)
    }

    fn of(list: Vec<Arc<Organ>>, grid: &VoxelGrid) -> Self {
        if list.is_empty() {
            return Self::default();
        }
        let mut labels = vec![0; grid.n_voxels()];
        for (label, organ) in (1..).zip(&list) {
            labels.iter_mut().zip(&organ.mask).filter(|(_, inside)| **inside).for_each(|(l, _)| *l = label);
        }
        let names = (1..).zip(&list).map(|(label, organ)| (label, organ.name.clone())).collect();
        Self { map: Some(LabelMap { grid: grid.clone(), labels, names, colours: Vec::new() }), list }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::math::DMat3;

    /// Slices of 4 mm along y, as of a coronal series.
    fn grid() -> VoxelGrid {
        VoxelGrid {
            dims: [20, 10, 8],
            spacing_m: DVec3::new(1e-3, 2e-3, 4e-3),
            origin_m: DVec3::new(0.01, 0.02, 0.03),
            axes: DMat3::from_cols(DVec3::X, DVec3::NEG_Z, DVec3::Y),
        }
    }

    #[test]
    fn outlines_come_back_from_their_slice() {
        let grid = grid();
        let corners = [[2.0, 1.0], [12.5, 3.0], [7.0, 8.0]];
        let at = |[i, j]: [f64; 2]| (1e3 * grid.position_m(DVec3::new(i, j, 3.3))).to_array();
        let outline = Outline { through_mm: at([0.0, 0.0]), points_mm: corners.map(at).to_vec() };
        let contour = outline.in_slice(&grid).unwrap();
        assert_eq!(contour.slice, 3);
        for (found, [i, j]) in contour.points_m.iter().zip(corners) {
            assert!((found.x - 1e-3 * i).abs() < 1e-12 && (found.y - 2e-3 * j).abs() < 1e-12, "{found}");
        }
        let back = Outline::of(&contour, &grid);
        assert_eq!(back.in_slice(&grid).unwrap().slice, 3);
        for (a, b) in back.points_mm.iter().zip(&outline.points_mm) {
            // In the slice's middle now, 1.2 mm from where it was drawn.
            assert!(
                (a[0] - b[0]).abs() < 0.01 && (a[2] - b[2]).abs() < 0.01 && (a[1] - b[1] + 1.2).abs() < 0.01
            );
        }
        let axial = Outline {
            points_mm: vec![[10.0, 20.0, 30.0], [20.0, 40.0, 30.0], [10.0, 40.0, 30.0]],
            ..outline
        };
        assert!(axial.in_slice(&grid).unwrap_err().to_string().contains("oblique"));
        let outside = Outline { through_mm: [10.0, 90.0, 30.0], points_mm: Vec::new() };
        assert!(outside.in_slice(&grid).unwrap_err().to_string().contains("outside"));
    }

    #[test]
    fn a_later_organ_takes_what_it_shares_and_one_of_the_same_name_is_replaced() {
        let grid = grid();
        let organ = |name: &str, from: usize, to: usize| {
            let mask = (0..grid.n_voxels()).map(|v| (from..to).contains(&v)).collect();
            Organ::of(&grid, name.into(), mask, Vec::new(), &[])
        };
        let organs = Organs::default().with(organ("liver", 0, 100), &grid).unwrap();
        let organs = organs.with(organ("tumour", 40, 50), &grid).unwrap();
        let count =
            |organs: &Organs, label| organs.map().unwrap().labels.iter().filter(|l| **l == label).count();
        assert_eq!([count(&organs, 1), count(&organs, 2)], [90, 10]);
        let organs = organs.with(organ("liver", 0, 45), &grid).unwrap();
        assert_eq!((organs.list().len(), count(&organs, 1), count(&organs, 2)), (2, 40, 10));
        let organs = organs.without("liver", &grid);
        assert_eq!((organs.list().len(), count(&organs, 1)), (1, 10));
        assert!(organs.without("tumour", &grid).map().is_none());
    }
}
