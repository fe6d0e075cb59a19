//! The plane of a slice: its pixels, and places on it in metres.

use crate::image::VoxelGrid;
use crate::math::{DMat3, DVec2, DVec3};

/// The pixels of a slice of constant k. Pixel (i, j) has its centre at (i, j) * `spacing_m`: places on the
/// plane are measured from the centre of pixel (0, 0) along the image's own i and j.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// Number of pixels along i, j.
    pub dims: [usize; 2],
    /// Distance of neighbouring centres along i, j [m].
    pub spacing_m: DVec2,
}

impl Plane {
    /// The plane that all slices of a grid share.
    pub fn of(grid: &VoxelGrid) -> Self {
        Self { dims: [grid.dims[0], grid.dims[1]], spacing_m: grid.spacing_m.truncate() }
    }

    /// Number of pixels.
    pub fn n_pixels(&self) -> usize {
        self.dims[0] * self.dims[1]
    }

    /// Area of a pixel [m2].
    pub fn pixel_area_m2(&self) -> f64 {
        self.spacing_m.x * self.spacing_m.y
    }

    /// A grid of this slice alone.
    pub(super) fn grid(&self) -> VoxelGrid {
        VoxelGrid {
            dims: [self.dims[0], self.dims[1], 1],
            spacing_m: self.spacing_m.extend(self.spacing_m.max_element()),
            origin_m: DVec3::ZERO,
            axes: DMat3::IDENTITY,
        }
    }

    /// Pixel whose centre is nearest to a place, if the place is on the image.
    pub fn pixel_at(&self, place_m: DVec2) -> Option<[usize; 2]> {
        let pixel = (place_m / self.spacing_m).round();
        let inside =
            pixel.cmpge(DVec2::ZERO).all() && pixel.x < self.dims[0] as f64 && pixel.y < self.dims[1] as f64;
        inside.then_some([pixel.x as usize, pixel.y as usize])
    }

    /// Value of a slice at a place, bilinear between pixels; the border value continues outside.
    pub fn sample(&self, values: &[f32], place_m: DVec2) -> f32 {
        let last = DVec2::new((self.dims[0] - 1) as f64, (self.dims[1] - 1) as f64);
        let at = (place_m / self.spacing_m).clamp(DVec2::ZERO, last);
        let low = at.floor();
        let (i, j) = (low.x as usize, low.y as usize);
        let (next_i, next_j) = ((i + 1).min(self.dims[0] - 1), (j + 1).min(self.dims[1] - 1));
        let share = (at - low).as_vec2();
        let row = |j: usize| {
            let (a, b) = (values[i + self.dims[0] * j], values[next_i + self.dims[0] * j]);
            a + share.x * (b - a)
        };
        let (a, b) = (row(j), row(next_j));
        a + share.y * (b - a)
    }
}
