//! How large cells are wanted, from place to place.
//!
//! Cells have the given size, but for places where they are to be smaller: around these they grow with the distance, so that
//! neighbours differ little.

use super::params::{FinerBall, Grading};
use super::regions::RegionGrid;
use crate::image::Volume;
use crate::image::filter::distance_squared_m2;
use crate::math::DVec3;
use crate::mesh::stuffing::TETRAHEDRON_OVER_CELL;

/// How much cells grow over a distance: two layers of cells more than double them.
const GROWTH: f64 = 0.7;

/// Cells for a number of tetrahedra are so much larger than this number in the volume would have: borders add tetrahedra.
const FOR_BORDERS: f64 = 1.3;

/// Cells are not smaller than this part of the largest.
const SMALLEST_PART: f64 = 1.0 / 32.0;

/// Places where cells are to be smaller, and how far everything is from them.
#[derive(Clone, Debug, Default)]
pub(super) struct FinePlaces {
    /// Distance [m] with the size of the cells in these places [m].
    of_organs: Vec<(Volume<f32>, f64)>,
    /// Distance [m] from the surface of all organs with the factor.
    of_surface: Option<(Volume<f32>, f64)>,
    balls: Vec<FinerBall>,
}

impl FinePlaces {
    pub(super) fn new(regions: &RegionGrid, grading: &Grading) -> Self {
        let distance_m = |is_there: Vec<bool>| Volume {
            grid: regions.grid().clone(),
            values: distance_squared_m2(regions.grid(), &is_there).into_iter().map(f32::sqrt).collect(),
        };
        let where_region =
            |test: &dyn Fn(u16) -> bool| regions.of_voxels().iter().map(|&r| test(r)).collect();
        let mut places = Self { balls: grading.balls.clone(), ..Self::default() };
        if grading.least_tetrahedra > 0 {
            for (region, volume_m3) in (1..).zip(regions.volumes_m3()) {
                let tet_m3 = volume_m3 / grading.least_tetrahedra as f64;
                let cell_m = FOR_BORDERS * libm::cbrt(tet_m3 / TETRAHEDRON_OVER_CELL);
                places.of_organs.push((distance_m(where_region(&|r| r == region)), cell_m));
            }
        }
        if let Some(factor) = grading.finer_at_surface {
            let from_outside = distance_m(where_region(&|r| r == 0)).values;
            let mut from_inside = distance_m(where_region(&|r| r > 0));
            for (to_inside, to_outside) in from_inside.values.iter_mut().zip(from_outside) {
                // An organ that fills its box has no voxel outside.
                *to_inside = to_inside.max(if to_outside.is_finite() { to_outside } else { 0.0 });
            }
            places.of_surface = Some((from_inside, factor));
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
        let are_organs_coarse = of_organs.iter().all(|(_, cell_m)| *cell_m >= self.largest_m);
        are_organs_coarse && of_surface.is_none() && balls.is_empty()
    }

    /// Edge of the cells at a place [m].
    pub(super) fn at_m(&self, position_m: DVec3) -> f64 {
        let FinePlaces { of_organs, of_surface, balls } = self.places;
        let organs = of_organs
            .iter()
            .filter(|(_, cell_m)| *cell_m < self.largest_m)
            .map(|(distance_m, cell_m)| (distance_m.value_at(position_m), *cell_m));
        let surface = of_surface
            .iter()
            .map(|(distance_m, factor)| (distance_m.value_at(position_m), self.largest_m / factor));
        let balls = balls.iter().map(|ball| {
            let distance_m = (position_m.distance(ball.center_m) - ball.radius_m).max(0.0);
            (distance_m, self.largest_m / ball.factor)
        });
        let wanted_m =
            organs.chain(surface).chain(balls).map(|(distance_m, cell_m)| cell_m + GROWTH * distance_m);
        wanted_m.fold(self.largest_m, f64::min).max(SMALLEST_PART * self.largest_m)
    }
}
