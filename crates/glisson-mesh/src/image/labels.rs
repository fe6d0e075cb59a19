//! Choosing organs in a label map, and comparing masks.
//!
//! An organ is asked for by name or number. Organs that image annotation splits into parts (a liver with
//! its vessels and tumour) are taken whole unless one asks otherwise: a surface around the liver must not
//! follow every vein inside it.

use std::collections::BTreeSet;

use super::filter;
use super::resample::VoxelBox;
use super::{LabelMap, VoxelGrid};
use crate::math::DVec3;
use crate::text::closest_name;

/// Organ that is taken where none is named.
const USUAL_LABEL: &str = "liver";

/// Labels that lie inside another organ: (organ, names of its parts).
/// Names that start with the organ's name and `_` count as parts too, e.g. `liver_vessel`.
const PARTS: [(&str, &[&str]); 1] = [("liver", &["portal_vein", "hepatic_vein"])];

/// Why an organ could not be taken from a label map.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LabelError {
    /// No label has this name.
    #[error(
        "the label map has no label named `{wanted}`{}; available: {available}",
        .suggestion.as_ref().map_or(String::new(), |s| format!(", did you mean `{s}`?"))
    )]
    UnknownName {
        /// What was asked for.
        wanted: String,
        /// The closest name, if one is close.
        suggestion: Option<String>,
        /// Labels of the map, as text.
        available: String,
    },
    /// The label exists by name, or was given by number, but no voxel has it.
    #[error("label {label} is empty: none of the {n_voxels} voxels has it; available: {available}")]
    Empty {
        /// The label, with its name.
        label: String,
        /// Voxels of the map.
        n_voxels: usize,
        /// Labels of the map, as text.
        available: String,
    },
    /// The organ is cut by the border of the image.
    #[error(
        "the label touches the border of the volume: {n_voxels} of its voxels lie on {side}, 0 allowed; the organ is cut off there, use an image that holds all of it (or `glisson mesh --cut-at-border`, which closes it with a flat face)"
    )]
    LabelTouchesBorder {
        /// The side, e.g. `i = 0 (right)`.
        side: String,
        /// Voxels of the label on that side.
        n_voxels: usize,
    },
}

/// Whether an organ is taken with the labels that lie inside it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Parts {
    /// The whole organ, with its vessels and tumours.
    #[default]
    Included,
    /// Only the voxels that carry the organ's own label.
    Excluded,
}

/// The labels that together are the wanted organ.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LabelSelection {
    /// Labels, ascending.
    pub labels: Vec<u16>,
}

/// Names are compared in lower case, with `_` for spaces and hyphens.
fn normalized(name: &str) -> String {
    name.trim().to_lowercase().replace([' ', '-'], "_")
}

impl LabelMap {
    /// Labels that at least one voxel has, ascending, without 0.
    pub fn present(&self) -> Vec<u16> {
        let mut seen = vec![false; 1 << 16];
        for &label in &self.labels {
            seen[usize::from(label)] = true;
        }
        (1..=u16::MAX).filter(|&label| seen[usize::from(label)]).collect()
    }

    /// Name of `label`, if it has one.
    pub fn name_of(&self, label: u16) -> Option<&str> {
        self.names.iter().find(|(l, _)| *l == label).map(|(_, name)| name.as_str())
    }

    /// `number` or `number (name)`.
    fn described(&self, label: u16) -> String {
        self.name_of(label).map_or(label.to_string(), |name| format!("{label} ({name})"))
    }

    fn available(&self) -> String {
        let present = self.present();
        match present.is_empty() {
            true => "none, every voxel is 0".into(),
            false => present.iter().map(|&l| self.described(l)).collect::<Vec<_>>().join(", "),
        }
    }

    /// Label of a name or number, which at least one voxel has.
    ///
    /// # Errors
    /// An unknown name, with the closest one; a label that no voxel has.
    pub fn resolve(&self, name_or_number: &str) -> Result<u16, LabelError> {
        let wanted = normalized(name_or_number);
        let by_name = self.names.iter().find(|(_, name)| normalized(name) == wanted);
        let label = match (by_name, wanted.parse::<u16>()) {
            (Some((label, _)), _) => *label,
            (None, Ok(label)) => label,
            (None, Err(_)) => {
                let names: Vec<&str> = self.names.iter().map(|(_, name)| name.as_str()).collect();
                return Err(LabelError::UnknownName {
                    wanted: name_or_number.into(),
                    suggestion: closest_name(name_or_number, &names).map(String::from),
                    available: self.available(),
                });
            }
        };
        if label == 0 || !self.labels.contains(&label) {
            return Err(LabelError::Empty {
                label: self.described(label),
                n_voxels: self.labels.len(),
                available: self.available(),
            });
        }
        Ok(label)
    }

    /// The organ of a name or number, with or without the labels inside it; several with `+` between them are one organ.
    ///
    /// # Errors
    /// As [`LabelMap::resolve`].
    pub fn select(&self, names_or_numbers: &str, parts: Parts) -> Result<LabelSelection, LabelError> {
        let mut labels = BTreeSet::new();
        // A name may have a plus itself.
        let asked: Vec<&str> = match self.resolve(names_or_numbers) {
            Ok(_) => vec![names_or_numbers],
            Err(_) => names_or_numbers.split('+').collect(),
        };
        for name_or_number in asked {
            let label = self.resolve(name_or_number)?;
            labels.insert(label);
            if let (Parts::Included, Some(organ)) = (parts, self.name_of(label).map(normalized)) {
                let listed = PARTS.iter().find(|(o, _)| *o == organ).map_or(&[][..], |(_, names)| names);
                let prefix = format!("{organ}_");
                let is_part = |name: &str| listed.contains(&name) || name.starts_with(&prefix);
                labels.extend(
                    self.names.iter().filter(|(_, name)| is_part(&normalized(name))).map(|(l, _)| *l),
                );
            }
        }
        Ok(LabelSelection { labels: labels.into_iter().collect() })
    }

    /// The organ of a name or number as [`LabelMap::select`]; without one the liver, or the only label there is.
    ///
    /// # Errors
    /// As [`LabelMap::resolve`].
    pub fn select_or_usual(
        &self,
        names_or_numbers: Option<&str>,
        parts: Parts,
    ) -> Result<LabelSelection, LabelError> {
        if let Some(asked) = names_or_numbers {
            return self.select(asked, parts);
        }
        let only = match self.present()[..] {
            [only] if !self.names.iter().any(|(_, name)| name == USUAL_LABEL) => Some(only.to_string()),
            _ => None,
        };
        self.select(only.as_deref().unwrap_or(USUAL_LABEL), parts)
    }

    /// For each voxel whether it belongs to `selection`.
    pub fn mask(&self, selection: &LabelSelection) -> Vec<bool> {
        self.labels.iter().map(|label| selection.labels.binary_search(label).is_ok()).collect()
    }

    /// Volume of the voxels of `selection` [m3].
    pub fn volume_m3(&self, selection: &LabelSelection) -> f64 {
        mask_volume_m3(&self.grid, &self.mask(selection))
    }
}

/// Volume of the voxels of a mask [m3].
pub fn mask_volume_m3(grid: &VoxelGrid, mask: &[bool]) -> f64 {
    mask.iter().filter(|&&inside| inside).count() as f64 * grid.voxel_volume_m3()
}

/// Overlap 2 |A and B| / (|A| + |B|) of two masks; 1 for two empty ones
/// (Dice 1945, doi 10.2307/1932409).
///
/// # Panics
/// Masks of different length.
pub fn dice(a: &[bool], b: &[bool]) -> f64 {
    assert_eq!(a.len(), b.len(), "masks of the same grid");
    let n_both = a.iter().zip(b).filter(|&(&x, &y)| x && y).count();
    let n_sum = a.iter().filter(|&&x| x).count() + b.iter().filter(|&&y| y).count();
    if n_sum == 0 { 1.0 } else { 2.0 * n_both as f64 / n_sum as f64 }
}

/// The 95 % Hausdorff distance [m] of two masks: 95 % of the border voxels of both are at most so far from the nearest border
/// voxel of the other mask. `None` when a mask is empty.
///
/// # Panics
/// Masks of different length.
pub fn hausdorff_95_m(grid: &VoxelGrid, a: &[bool], b: &[bool]) -> Option<f64> {
    assert_eq!(a.len(), b.len(), "masks of the same grid");
    let either: Vec<bool> = a.iter().zip(b).map(|(&x, &y)| x || y).collect();
    let part = VoxelBox::around(grid, &either, 0.0)?;
    let near = part.grid(grid);
    let borders = [a, b].map(|mask| border_of(&near, &part.cut(grid, mask)));
    let [to_a, to_b] = [0, 1].map(|m| filter::distance_squared_m2(&near, &borders[m]));
    let of = |border: &[bool], distance2: &[f32]| -> Vec<f32> {
        border.iter().zip(distance2).filter(|(is_border, _)| **is_border).map(|(_, &d)| d).collect()
    };
    let (mut all, of_b) = (of(&borders[0], &to_b), of(&borders[1], &to_a));
    if all.is_empty() || of_b.is_empty() {
        return None;
    }
    all.extend(of_b);
    let place = (0.95 * (all.len() - 1) as f64).round() as usize;
    Some(f64::from(*all.select_nth_unstable_by(place, f32::total_cmp).1).sqrt())
}

/// Voxels of a mask with a face towards a voxel outside it, or towards the outside of the grid.
fn border_of(grid: &VoxelGrid, mask: &[bool]) -> Vec<bool> {
    let step = [1, grid.dims[0], grid.dims[0] * grid.dims[1]];
    let is_border = |index: usize| {
        let voxel = grid.voxel(index);
        (0..3).any(|a| {
            voxel[a] == 0 || voxel[a] + 1 == grid.dims[a] || !mask[index - step[a]] || !mask[index + step[a]]
        })
    };
    (0..mask.len()).map(|index| mask[index] && is_border(index)).collect()
}

/// Voxels of a mask on each side of its volume: side 2 a is the low end of axis a, side 2 a + 1 the high end.
fn count_at_border(grid: &VoxelGrid, mask: &[bool]) -> [usize; 6] {
    let mut n_on_side = [0usize; 6];
    for (index, _) in mask.iter().enumerate().filter(|&(_, &inside)| inside) {
        let voxel = grid.voxel(index);
        for axis in 0..3 {
            n_on_side[2 * axis] += usize::from(voxel[axis] == 0);
            n_on_side[2 * axis + 1] += usize::from(voxel[axis] + 1 == grid.dims[axis]);
        }
    }
    n_on_side
}

/// The sides of the volume on which the mask is cut off, with the number of its voxels there.
pub fn sides_at_border(grid: &VoxelGrid, mask: &[bool]) -> Vec<String> {
    let n_on_side = count_at_border(grid, mask);
    let sides = (0..6).filter(|&side| n_on_side[side] > 0);
    sides.map(|side| format!("{}, {} voxels", side_name(grid, side), n_on_side[side])).collect()
}

/// Refuses a mask that reaches the border of its volume: the organ is cut off there.
///
/// # Errors
/// [`LabelError::LabelTouchesBorder`] for the side with the most voxels.
pub fn check_clear_of_border(grid: &VoxelGrid, mask: &[bool]) -> Result<(), LabelError> {
    let n_on_side = count_at_border(grid, mask);
    let worst = (0..6).fold(0, |worst, side| if n_on_side[side] > n_on_side[worst] { side } else { worst });
    if n_on_side[worst] == 0 {
        return Ok(());
    }
    Err(LabelError::LabelTouchesBorder { side: side_name(grid, worst), n_voxels: n_on_side[worst] })
}

/// `k = 0 (inferior)`: a side of the volume and where it is in the patient. Side 2 a is the low end of
/// axis a, side 2 a + 1 the high end.
fn side_name(grid: &VoxelGrid, side: usize) -> String {
    let (axis, high) = (side / 2, side % 2 == 1);
    let outward: DVec3 = grid.axes.col(axis) * if high { 1.0 } else { -1.0 };
    let size = outward.abs();
    let (along, ends) = if size.x >= size.y && size.x >= size.z {
        (outward.x, ["right", "left"])
    } else if size.y >= size.z {
        (outward.y, ["anterior", "posterior"])
    } else {
        (outward.z, ["inferior", "superior"])
    };
    let place = if high { grid.dims[axis].saturating_sub(1) } else { 0 };
    format!("{} = {place} ({})", ["i", "j", "k"][axis], ends[usize::from(along > 0.0)])
}
