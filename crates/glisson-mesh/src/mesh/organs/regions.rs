//! The labels to be meshed, cut out of their map and numbered from 1 on: the regions.

use super::error::OrganMeshError;
use crate::image::labels::check_clear_of_border;
use crate::image::resample::VoxelBox;
use crate::image::{LabelMap, VoxelGrid};

/// Regions of the voxels in the box around all of them; 0 is outside.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct RegionGrid {
    grid: VoxelGrid,
    of_voxels: Vec<u16>,
    labels: Vec<u16>,
    n_voxels: Vec<usize>,
}

impl RegionGrid {
    /// The regions of `labels`, ascending; of all labels of the map where none is named.
    ///
    /// # Errors
    /// No label at all, a label without voxels, one that touches the border of the map.
    pub(super) fn new(map: &LabelMap, labels: &[u16]) -> Result<Self, OrganMeshError> {
        let grid = &map.grid;
        if map.labels.len() != grid.n_voxels() {
            return Err(OrganMeshError::BadMap { found: map.labels.len(), allowed: grid.n_voxels() });
        }
        if labels.contains(&0) {
            return Err(OrganMeshError::BadParameter {
                what: "a wanted label",
                found: "0".into(),
                allowed: "1 to 65535, 0 being the outside,".into(),
            });
        }
        let mut wanted = if labels.is_empty() { map.present() } else { labels.to_vec() };
        wanted.sort_unstable();
        wanted.dedup();
        if wanted.is_empty() {
            return Err(OrganMeshError::NoLabels);
        }
        let mut region_of_label = vec![0u16; 1 << 16];
        for (region, &label) in (1..).zip(&wanted) {
            region_of_label[usize::from(label)] = region;
        }
        let mut n_voxels = vec![0; wanted.len()];
        let mut is_wanted = Vec::with_capacity(map.labels.len());
        for &label in &map.labels {
            let region = region_of_label[usize::from(label)];
            is_wanted.push(region > 0);
            if region > 0 {
                n_voxels[usize::from(region) - 1] += 1;
            }
        }
        if let Some(region) = n_voxels.iter().position(|&n| n == 0) {
            let (label, available) = (wanted[region], map.present());
            return Err(OrganMeshError::UnknownLabel { label, available });
        }
        let part = VoxelBox::around(grid, &is_wanted, 0.0).ok_or(OrganMeshError::NoLabels)?;
        let touches = (0..3).any(|a| part.first[a] == 0 || part.first[a] + part.dims[a] == grid.dims[a]);
        let is_at_border = |index: usize| {
            let voxel = grid.voxel(index);
            (0..3).any(|a| voxel[a] == 0 || voxel[a] + 1 == grid.dims[a])
        };
        let first = |index: &usize| is_wanted[*index] && is_at_border(*index);
        if let Some(index) = touches.then(|| (0..is_wanted.len()).find(first)).flatten() {
            let label = map.labels[index];
            let mask: Vec<bool> = map.labels.iter().map(|&l| l == label).collect();
            check_clear_of_border(grid, &mask)
                .map_err(|cut_off| OrganMeshError::Border { label, cut_off })?;
        }
        let labels = part.cut(grid, &map.labels);
        let of_voxels = labels.into_iter().map(|label| region_of_label[usize::from(label)]).collect();
        let cropped = part.grid(grid);
        Ok(Self { grid: cropped, of_voxels, labels: wanted, n_voxels })
    }

    /// Where the voxels are.
    pub(super) fn grid(&self) -> &VoxelGrid {
        &self.grid
    }

    /// Region of each voxel.
    pub(super) fn of_voxels(&self) -> &[u16] {
        &self.of_voxels
    }

    /// Number of regions, without the outside.
    pub(super) fn n_regions(&self) -> usize {
        self.labels.len()
    }

    /// Label of a region; 0 of the outside.
    pub(super) fn label(&self, region: u16) -> u16 {
        if region == 0 { 0 } else { self.labels[usize::from(region) - 1] }
    }

    /// Number of voxels of a region other than 0.
    pub(super) fn n_voxels(&self, region: u16) -> usize {
        self.n_voxels[usize::from(region) - 1]
    }

    /// Volume of the voxels of each region [m3], from region 1 on.
    pub(super) fn volumes_m3(&self) -> Vec<f64> {
        self.n_voxels.iter().map(|&n| n as f64 * self.grid.voxel_volume_m3()).collect()
    }
}
