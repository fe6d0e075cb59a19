//! How large cells are wanted, from place to place.
//!
//! Cells have the given size, but for places where they are to be smaller: around these they grow with the distance, so that
//! neighbours differ little.

use super::params::{FinerBall, Grading};
use super::regions::RegionGrid;
use crate::image::filter::distance_squared_m2;
use crate::image::{Volume, VoxelGrid};
use crate::math::DVec3;
use crate::mesh::stuffing::TETRAHEDRON_OVER_CELL;
use crate::progress::tell;

/// How much cells grow over a distance: two layers of cells more than double them.
const GROWTH: f64 = 0.7;

/// Cells for a number of tetrahedra are so much larger than this number in the volume would have: borders add tetrahedra.
const FOR_BORDERS: f64 = 1.3;

/// Cells are not smaller than this part of the largest.
const SMALLEST_PART: f64 = 1.0 / 32.0;

/// Places where cells are to be smaller, and how far everything is from them.
#[derive(Clone, Debug, Default)]
pub(super) struct FinePlaces {
    /// What the organs ask for: the edge of cells [m] that have grown on the way from the nearest of them; the smallest one beside it.
    of_organs: Option<(Around, f64)>,
    /// Distance [m] from the surface of all organs, with the factor.
    of_surface: Option<(Around, f64)>,
    balls: Vec<FinerBall>,
}

/// Numbers in metres in the box around all organs and a voxel more.
#[derive(Clone, Debug)]
struct Around(Volume<f32>);

impl Around {
    /// The regions in that box.
    fn regions(regions: &RegionGrid) -> (VoxelGrid, Vec<u16>) {
        let inner = regions.grid();
        let grid = VoxelGrid {
            dims: inner.dims.map(|n| n + 2),
            origin_m: inner.position_m(DVec3::NEG_ONE),
            ..inner.clone()
        };
        let mut of_voxels = vec![0; grid.n_voxels()];
        for (index, &region) in regions.of_voxels().iter().enumerate() {
            of_voxels[grid.index(inner.voxel(index).map(|n| n + 1))] = region;
        }
        (grid, of_voxels)
    }

    /// The number at a place, which outside the box grows as it does over the distance from it.
    fn at_m(&self, position_m: DVec3, growth: f64) -> f64 {
        let Volume { grid, .. } = &self.0;
        let voxel = grid.voxel_at(position_m);
        let last = DVec3::from_array(grid.dims.map(|n| n as f64 - 1.0));
        let beyond_m = (voxel - voxel.clamp(DVec3::ZERO, last)) * grid.spacing_m;
        self.0.value_at(position_m) + growth * beyond_m.length()
    }
}

impl FinePlaces {
    pub(super) fn new(regions: &RegionGrid, grading: &Grading) -> Self {
        let mut places = Self { balls: grading.balls.clone(), ..Self::default() };
        if grading.least_tetrahedra == 0 && grading.finer_at_surface.is_none() {
            return places;
        }
        let (grid, of_voxels) = Around::regions(regions);
        let distances_m = |is_there: &dyn Fn(u16) -> bool| -> Vec<f32> {
            let mask: Vec<bool> = of_voxels.iter().map(|&region| is_there(region)).collect();
            distance_squared_m2(&grid, &mask).into_iter().map(f32::sqrt).collect()
        };
        if grading.least_tetrahedra > 0 {
            let mut wanted_m = vec![f32::INFINITY; of_voxels.len()];
            let mut smallest_m = f64::INFINITY;
            for (region, volume_m3) in (1..).zip(regions.volumes_m3()) {
                let tet_m3 = volume_m3 / grading.least_tetrahedra as f64;
                let cell_m = FOR_BORDERS * libm::cbrt(tet_m3 / TETRAHEDRON_OVER_CELL);
                smallest_m = smallest_m.min(cell_m);
                for (wanted_m, distance_m) in wanted_m.iter_mut().zip(distances_m(&|r| r == region)) {
                    *wanted_m = wanted_m.min(cell_m as f32 + GROWTH as f32 * distance_m);
                }
                tell(0.0);
            }
            places.of_organs = Some((Around(Volume { grid: grid.clone(), values: wanted_m }), smallest_m));
        }
        if let Some(factor) = grading.finer_at_surface {
            let (from_inside, from_outside) = (distances_m(&|r| r > 0), distances_m(&|r| r == 0));
            // The surface is between the middles of voxels.
            let half_m = 0.5 * grid.spacing_m.min_element() as f32;
            let distance_m = |(a, b): (f32, f32)| (a.max(b) - half_m).max(0.0);
            let values = from_inside.into_iter().zip(from_outside).map(distance_m).collect();
            places.of_surface = Some((Around(Volume { grid, values }), factor));
        }
        places
    }
}

#[cfg(test)]
impl FinePlaces {
    /// Balls alone, for tests.
    pub(super) fn of_balls(balls: Vec<FinerBall>) -> Self {
        Self { balls, ..Self::default() }
    }
}

/// The wanted size of cells.
#[derive(Clone, Copy, Debug)]
pub(super) struct CellSize<'a> {
    largest_m: f64,
    places: &'a FinePlaces,
}

impl<'a> CellSize<'a> {
    /// Cells of `largest_m` but for the fine places.
    pub(super) fn new(largest_m: f64, places: &'a FinePlaces) -> Self {
        Self { largest_m, places }
    }

    /// Edge of the largest cells [m].
    pub(super) fn largest_m(&self) -> f64 {
        self.largest_m
    }

    /// Whether all cells have one size.
    pub(super) fn is_even(&self) -> bool {
        let FinePlaces { of_organs, of_surface, balls } = self.places;
        let are_organs_coarse =
            of_organs.as_ref().is_none_or(|(_, smallest_m)| *smallest_m >= self.largest_m);
        are_organs_coarse && of_surface.is_none() && balls.is_empty()
    }

    /// Edge of the cells at a place [m].
    pub(super) fn at_m(&self, position_m: DVec3) -> f64 {
        let FinePlaces { of_organs, of_surface, balls } = self.places;
        let organs = of_organs.iter().map(|(wanted, _)| wanted.at_m(position_m, GROWTH));
        let surface = of_surface
            .iter()
            .map(|(distance, factor)| self.largest_m / factor + GROWTH * distance.at_m(position_m, 1.0));
        let balls = balls.iter().map(|ball| {
            let distance_m = (position_m.distance(ball.center_m) - ball.radius_m).max(0.0);
            self.largest_m / ball.factor + GROWTH * distance_m
        });
        let wanted_m = organs.chain(surface).chain(balls).fold(self.largest_m, f64::min);
        wanted_m.max(SMALLEST_PART * self.largest_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::LabelMap;
    use crate::math::DMat3;

    /// A block of 20 x 20 x 20 mm in voxels of 1 mm, with another one of 4 mm in it.
    fn regions() -> RegionGrid {
        let grid = VoxelGrid {
            dims: [30; 3],
            spacing_m: DVec3::splat(1e-3),
            origin_m: DVec3::ZERO,
            axes: DMat3::IDENTITY,
        };
        let labels = (0..grid.n_voxels())
            .map(|v| match grid.voxel(v) {
                at if at.iter().all(|n| (13..17).contains(n)) => 2,
                at if at.iter().all(|n| (5..25).contains(n)) => 1,
                _ => 0,
            })
            .collect();
        let map = LabelMap { grid, labels, names: Vec::new(), colours: Vec::new() };
        RegionGrid::new(&map, &[]).unwrap()
    }

    #[test]
    fn cells_grow_from_the_surface_inwards_and_outwards_also_beyond_the_box() {
        let places =
            FinePlaces::new(&regions(), &Grading { finer_at_surface: Some(4.0), ..Grading::default() });
        let size = CellSize::new(8e-3, &places);
        let at = |x_mm: f64| size.at_m(1e-3 * DVec3::new(x_mm, 14.5, 14.5));
        assert!(!size.is_even());
        // The faces are at 4.5 and 24.5 mm, in the middle of two voxels.
        assert!(at(4.5) < 2.5e-3 && at(24.5) < 2.5e-3, "{} {}", at(4.5), at(24.5));
        assert!(at(14.5) > 7.5e-3, "{}", at(14.5));
        assert!(at(0.0) > at(3.0) && at(-3.0) > at(0.0) && at(-20.0) == 8e-3, "{} {}", at(3.0), at(-3.0));
    }

    #[test]
    fn cells_of_small_organs_are_small_and_those_around_grow() {
        let places = FinePlaces::new(&regions(), &Grading { least_tetrahedra: 300, ..Grading::default() });
        let size = CellSize::new(8e-3, &places);
        // 64 mm3 in 300 tetrahedra: 1.3 times the cube root of 12 times a 300th of it.
        let at = |x_mm: f64| size.at_m(1e-3 * DVec3::new(x_mm, 14.5, 14.5));
        assert!((at(14.5) - 1.7784e-3).abs() < 2e-7, "{}", at(14.5));
        assert!((at(20.0) - at(18.0) - 0.7 * 2e-3).abs() < 1e-6, "{} {}", at(18.0), at(20.0));
        assert!(CellSize::new(1.7e-3, &places).is_even());
    }
}
