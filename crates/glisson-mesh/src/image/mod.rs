//! Volumes and label maps in the patient frame.

pub mod files;
pub mod labels;
pub mod filter;
pub mod contours;
pub mod phantom;
pub mod resample;
pub mod segment;
pub mod topology;
pub mod vessels;

use crate::math::{Aabb, DMat3, DVec3};

/// Where the voxels of a volume are: voxel (i, j, k) has its centre at
/// `origin_m + axes * ((i, j, k) * spacing_m)`.
#[derive(Clone, Debug, PartialEq)]
pub struct VoxelGrid {
    /// Number of voxels along i, j, k.
    pub dims: [usize; 3],
    /// Distance of neighbouring centres along i, j, k [m].
    pub spacing_m: DVec3,
    /// Centre of voxel (0, 0, 0) [m], LPS.
    pub origin_m: DVec3,
    /// Orthonormal columns: directions of i, j, k in LPS. A left-handed set is allowed.
    pub axes: DMat3,
}

impl VoxelGrid {
    /// Number of voxels.
    pub fn n_voxels(&self) -> usize {
        self.dims.iter().product()
    }

    /// Volume of one voxel [m3].
    pub fn voxel_volume_m3(&self) -> f64 {
        self.spacing_m.x * self.spacing_m.y * self.spacing_m.z
    }

    /// Place of voxel (i, j, k) in the data: i runs fastest.
    pub fn index(&self, [i, j, k]: [usize; 3]) -> usize {
        i + self.dims[0] * (j + self.dims[1] * k)
    }

    /// Voxel (i, j, k) of a place in the data.
    pub fn voxel(&self, index: usize) -> [usize; 3] {
        let (row, i) = (index / self.dims[0], index % self.dims[0]);
        [i, row % self.dims[1], row / self.dims[1]]
    }

    /// Centre of a voxel, or of a fractional place between voxels [m], LPS.
    pub fn position_m(&self, voxel: DVec3) -> DVec3 {
        self.origin_m + self.axes * (voxel * self.spacing_m)
    }

    /// Centre of the voxel at a place in the data [m], LPS.
    pub fn center_m(&self, index: usize) -> DVec3 {
        self.position_m(DVec3::from_array(self.voxel(index).map(|v| v as f64)))
    }

    /// Fractional voxel coordinates of a point: the inverse of [`VoxelGrid::position_m`].
    pub fn voxel_at(&self, position_m: DVec3) -> DVec3 {
        (self.axes.transpose() * (position_m - self.origin_m)) / self.spacing_m
    }

    /// How far two grids are apart at their lowest and highest corners, together [m].
    pub fn corner_distance_m(&self, other: &Self) -> f64 {
        let (a, b) = (self.bounds_m(), other.bounds_m());
        a.min_m.distance(b.min_m) + a.max_m.distance(b.max_m)
    }

    /// Box around all voxel centres [m].
    pub fn bounds_m(&self) -> Aabb {
        let last = DVec3::new(
            self.dims[0].saturating_sub(1) as f64,
            self.dims[1].saturating_sub(1) as f64,
            self.dims[2].saturating_sub(1) as f64,
        );
        (0..8).fold(Aabb::EMPTY, |b, c| {
            let corner = DVec3::new(f64::from(c & 1), f64::from((c >> 1) & 1), f64::from(c >> 2));
            b.including(self.position_m(corner * last))
        })
    }
}

/// One value a voxel, i fastest.
#[derive(Clone, Debug, PartialEq)]
pub struct Volume<T> {
    /// Where the voxels are.
    pub grid: VoxelGrid,
    /// `grid.n_voxels()` values.
    pub values: Vec<T>,
}

/// Which organ each voxel belongs to; 0 is none.
#[derive(Clone, Debug, PartialEq)]
pub struct LabelMap {
    /// Where the voxels are.
    pub grid: VoxelGrid,
    /// `grid.n_voxels()` labels.
    pub labels: Vec<u16>,
    /// Names of the labels that have one, ascending.
    pub names: Vec<(u16, String)>,
    /// Colours of the labels that have one: red, green, blue from 0 to 1, ascending.
    pub colours: Vec<(u16, [f32; 3])>,
}
