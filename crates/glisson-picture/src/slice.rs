//! A grey slice through a volume with its labels in colour, for reports.
//!
//! Drawn as radiologists expect: axial slices seen from the feet (the patient's right on the left, the
//! front on top), coronal ones from the front, sagittal ones from the patient's left. Pixels are square
//! whatever the voxels are; grey values are interpolated linearly, labels taken from the nearest voxel.

use anyhow::ensure;
use glisson::image::{LabelMap, Volume, VoxelGrid};
use glisson::math::DVec3;

use super::text::{Caption, CaptionPlace, draw_caption};
use super::{MAX_EDGE_PIXELS, Picture};

/// Opacity of a label's inside and of its rim.
const FILL_ALPHA: u8 = 56;
const RIM_ALPHA: u8 = 220;
/// Grey value outside the volume.
const OUTSIDE: [u8; 3] = [0; 3];

/// Direction of a slice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SlicePlane {
    /// Across the body.
    Axial,
    /// Parallel to the front.
    Coronal,
    /// From front to back.
    Sagittal,
}

impl SlicePlane {
    /// Directions to the right and down in the picture, and the letters at its left, right, top, bottom.
    fn directions(self) -> ([DVec3; 2], [&'static str; 4]) {
        match self {
            Self::Axial => ([DVec3::X, DVec3::Y], ["R", "L", "A", "P"]),
            Self::Coronal => ([DVec3::X, DVec3::NEG_Z], ["R", "L", "H", "F"]),
            Self::Sagittal => ([DVec3::Y, DVec3::NEG_Z], ["A", "P", "H", "F"]),
        }
    }
}

/// Which slice, and how to show it.
#[derive(Clone, Debug, PartialEq)]
pub struct SliceSpec {
    /// Its direction.
    pub plane: SlicePlane,
    /// A point of the slice [m], LPS.
    pub through_m: DVec3,
    /// Value shown as middle grey, and range of values from black to white (for CT in HU: 60 and 400).
    pub window_centre_width: [f64; 2],
    /// Labels to show in colour; all when empty.
    pub shown_labels: Vec<u16>,
    /// Height of the picture [pixels]; the width follows.
    pub height: usize,
    /// Text in the lower left corner; empty for none.
    pub caption: String,
}

/// Checks that there are as many values and labels as voxels.
fn check_values<T>(volume: &Volume<T>, labels: Option<&LabelMap>) -> anyhow::Result<()> {
    let grid = &volume.grid;
    ensure!(
        grid.n_voxels() > 0 && volume.values.len() == grid.n_voxels(),
        "a volume of {:?} voxels with {} values cannot be shown",
        grid.dims,
        volume.values.len()
    );
    if let Some(map) = labels {
        ensure!(
            map.labels.len() == map.grid.n_voxels(),
            "a label map of {:?} voxels with {} labels cannot be shown",
            map.grid.dims,
            map.labels.len()
        );
    }
    Ok(())
}

/// Writes the letters of the directions at the sides, and the caption below.
fn write_captions(picture: &mut Picture, letters: [&str; 4], caption: &str) {
    let places = [CaptionPlace::Left, CaptionPlace::Right, CaptionPlace::Top, CaptionPlace::Bottom];
    for (letter, place) in letters.into_iter().zip(places) {
        draw_caption(picture, &Caption { text: letter.to_owned(), place });
    }
    if !caption.is_empty() {
        let caption = Caption { text: caption.to_owned(), place: CaptionPlace::BottomLeft };
        draw_caption(picture, &caption);
    }
}

/// A slice through `volume`, with `labels` over it where they are not 0.
///
/// # Errors
/// When the grid is empty, the values do not match it, or the picture would be absurdly large.
pub fn slice_picture<T: Copy + Into<f64> + Sync>(
    volume: &Volume<T>,
    labels: Option<&LabelMap>,
    spec: &SliceSpec,
) -> anyhow::Result<Picture> {
    let grid = &volume.grid;
    check_values(volume, labels)?;
    let bounds = grid.bounds_m();
    let ([right, down], letters) = spec.plane.directions();
    let extent = [right, down].map(|d| d.abs().dot(bounds.size_m()).max(1e-6));
    let pixel_m = extent[1] / spec.height.max(1) as f64;
    let size = [(extent[0] / pixel_m).round().max(1.0) as usize, spec.height];
    ensure!(
        size.iter().all(|edge| (1..=MAX_EDGE_PIXELS).contains(edge)),
        "slice of {} x {} pixels: each edge must be 1 to {MAX_EDGE_PIXELS}",
        size[0],
        size[1]
    );
    let centre = bounds.center_m();
    let normal = right.cross(down);
    let middle = centre + (spec.through_m - centre).dot(normal) * normal;
    let position = |x: f64, y: f64| {
        middle + (x - 0.5 * size[0] as f64) * pixel_m * right + (y - 0.5 * size[1] as f64) * pixel_m * down
    };
    let [window_centre, window_width] = spec.window_centre_width;
    let shown = &spec.shown_labels;
    let label_at = |x: f64, y: f64| {
        let label = labels.map_or(0, |map| label_at(map, position(x, y)));
        if shown.is_empty() || shown.contains(&label) { label } else { 0 }
    };
    let mut picture = Picture::filled(size, OUTSIDE);
    for row in 0..size[1] {
        for column in 0..size[0] {
            let (x, y) = (column as f64 + 0.5, row as f64 + 0.5);
            let Some(value) = value_at(volume, position(x, y)) else { continue };
            let share = (value - window_centre) / window_width.max(f64::MIN_POSITIVE) + 0.5;
            let grey = (share.clamp(0.0, 1.0) * 255.0).round() as u8;
            picture.blend([column, row], [grey; 3], 255);
            let label = label_at(x, y);
            if label != 0 {
                let beside = [(-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0)];
                let at_rim = beside.iter().any(|(dx, dy)| label_at(x + dx, y + dy) != label);
                let alpha = if at_rim { RIM_ALPHA } else { FILL_ALPHA };
                picture.blend([column, row], label_colour(label), alpha);
            }
        }
    }
    write_captions(&mut picture, letters, &spec.caption);
    Ok(picture)
}

/// sRGB colour of a label: twelve hues told apart easily, then again.
pub(crate) fn label_colour(label: u16) -> [u8; 3] {
    const COLOURS: [[u8; 3]; 12] = [
        [230, 88, 70],
        [96, 190, 90],
        [70, 130, 230],
        [245, 190, 60],
        [176, 100, 210],
        [64, 196, 200],
        [240, 130, 190],
        [180, 200, 70],
        [240, 140, 60],
        [130, 160, 250],
        [200, 160, 120],
        [150, 220, 170],
    ];
    COLOURS[usize::from(label.wrapping_sub(1)) % COLOURS.len()]
}

/// Nearest voxel, if the place is within half a voxel of the volume.
fn nearest_voxel(grid: &VoxelGrid, position_m: DVec3) -> Option<[usize; 3]> {
    let place = grid.voxel_at(position_m).round();
    let inside =
        place.cmpge(DVec3::ZERO).all() && (0..3).all(|axis| place.to_array()[axis] < grid.dims[axis] as f64);
    inside.then(|| place.to_array().map(|c| c as usize))
}

fn label_at(map: &LabelMap, position_m: DVec3) -> u16 {
    nearest_voxel(&map.grid, position_m).map_or(0, |voxel| map.labels[map.grid.index(voxel)])
}

/// Value between the voxels, linearly; the border value up to half a voxel outside.
fn value_at<T: Copy + Into<f64>>(volume: &Volume<T>, position_m: DVec3) -> Option<f64> {
    let grid = &volume.grid;
    nearest_voxel(grid, position_m)?;
    let place = grid.voxel_at(position_m).to_array();
    let mut low = [0usize; 3];
    let mut share = [0.0; 3];
    for axis in 0..3 {
        let last = grid.dims[axis] - 1;
        let within = place[axis].clamp(0.0, last as f64);
        low[axis] = (within.floor() as usize).min(last.saturating_sub(1));
        share[axis] = within - low[axis] as f64;
    }
    let mut sum = 0.0;
    for corner in 0..8usize {
        let mut weight = 1.0;
        let mut voxel = low;
        for axis in 0..3 {
            let upper = corner >> axis & 1;
            weight *= if upper == 1 { share[axis] } else { 1.0 - share[axis] };
            voxel[axis] = (low[axis] + upper).min(grid.dims[axis] - 1);
        }
        if weight > 0.0 {
            sum += weight * volume.values[grid.index(voxel)].into();
        }
    }
    Some(sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::math::DMat3;

    fn grid(dims: [usize; 3], spacing_m: DVec3, axes: DMat3) -> VoxelGrid {
        VoxelGrid { dims, spacing_m, origin_m: DVec3::ZERO, axes }
    }

    #[test]
    fn an_axial_slice_has_right_on_the_left_and_front_on_top() {
        // i runs to the patient's right, j to the front: the picture must turn both.
        let axes = DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0));
        let grid = grid([40, 40, 3], DVec3::splat(1e-3), axes);
        let values: Vec<f64> = (0..grid.n_voxels()).map(|v| grid.voxel(v)[0] as f64).collect();
        let labels = (0..grid.n_voxels()).map(|v| u16::from(grid.voxel(v)[1] >= 30)).collect();
        let map = LabelMap { grid: grid.clone(), labels, names: Vec::new(), colours: Vec::new() };
        let spec = SliceSpec {
            plane: SlicePlane::Axial,
            through_m: grid.bounds_m().center_m(),
            window_centre_width: [19.5, 39.0],
            shown_labels: Vec::new(),
            height: 400,
            caption: String::new(),
        };
        let volume = Volume { grid, values };
        let plain = slice_picture(&volume, None, &spec).unwrap();
        assert_eq!(plain.size, [400, 400]);
        // Patient's right = large i = bright = left in the picture.
        assert!(plain.pixel(60, 100)[0] > 200 && plain.pixel(340, 100)[0] < 50);
        let with_labels = slice_picture(&volume, Some(&map), &spec).unwrap();
        assert_ne!(with_labels.pixel(150, 50), plain.pixel(150, 50));
        assert_eq!(with_labels.pixel(150, 250), plain.pixel(150, 250));
        let only_other = SliceSpec { shown_labels: vec![7], ..spec };
        assert_eq!(slice_picture(&volume, Some(&map), &only_other).unwrap(), plain);
    }

    #[test]
    fn values_between_voxels_are_linear_and_stop_half_a_voxel_outside() {
        let grid = grid([3, 4, 5], DVec3::new(1.0, 2.0, 3.0), DMat3::IDENTITY);
        let linear = |p: DVec3| 1.0 + 2.0 * p.x - 0.5 * p.y + 0.25 * p.z;
        let values = (0..grid.n_voxels())
            .map(|v| linear(grid.position_m(DVec3::from_array(grid.voxel(v).map(|c| c as f64)))))
            .collect();
        let volume = Volume { grid, values };
        let inside = DVec3::new(1.3, 4.1, 7.7);
        assert!((value_at(&volume, inside).unwrap() - linear(inside)).abs() < 1e-12);
        assert_eq!(value_at(&volume, DVec3::new(-0.51, 0.0, 0.0)), None);
        assert!(value_at(&volume, DVec3::new(-0.49, 0.0, 0.0)).is_some());
    }

    #[test]
    fn a_volume_with_missing_values_is_an_error() {
        let volume = Volume { grid: grid([2, 2, 2], DVec3::ONE, DMat3::IDENTITY), values: vec![0.0; 7] };
        let spec = SliceSpec {
            plane: SlicePlane::Coronal,
            through_m: DVec3::ZERO,
            window_centre_width: [0.0, 1.0],
            shown_labels: Vec::new(),
            height: 10,
            caption: String::new(),
        };
        assert!(slice_picture(&volume, None, &spec).unwrap_err().to_string().contains("7 values"));
    }
}
