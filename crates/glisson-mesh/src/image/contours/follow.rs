//! Following the organ from slice to slice.
//!
//! A slice starts from the contours of the slice before, slightly shrunk, and its own come to rest on the image. The
//! first slices start from circles at the seeds, or are given by hand. Sweeps up and down are repeated
//! as long as a slice suggests to its neighbour a piece that the neighbour does not have: a lobe that hangs
//! down beside the others is found on the way back.

use super::edges::SliceEdges;
use super::level::OrganLevel;
use super::params::ContourParams;
use super::plane::Plane;
use super::raster::{outlines, rasterised};
use super::snake::{Settled, SliceImage, settle};
use crate::image::VoxelGrid;
use crate::image::filter::{self, Connectivity};
use crate::image::resample::VoxelBox;
use crate::image::segment::statistics::median;
use crate::math::DVec2;
use crate::progress::tell;

/// Most sweeps up and down.
const MAX_SWEEPS: usize = 4;
/// Radius of the circle at a seed [m].
const SEED_RADIUS_M: f64 = 6e-3;

/// A slice with the polygons on it.
pub(super) type SlicePolygons = (usize, Vec<Vec<DVec2>>);

/// The contours of all slices while they are found.
pub(super) struct Follower<'a> {
    pub(super) plane: Plane,
    /// The denoised image [HU].
    pub(super) smooth: &'a [f32],
    pub(super) edges: &'a [SliceEdges],
    pub(super) level: &'a OrganLevel,
    /// [`stiffness_kernel`](super::snake::stiffness_kernel) of `params`.
    pub(super) kernel: &'a [f64],
    pub(super) params: &'a ContourParams,
}

impl Follower<'_> {
    fn image(&self, k: usize) -> SliceImage<'_> {
        let n = self.plane.n_pixels();
        SliceImage {
            plane: &self.plane,
            smooth: &self.smooth[k * n..][..n],
            edges: &self.edges[k],
            level: self.level,
            kernel: self.kernel,
        }
    }

    /// Contours of all slices. `seeds` are slices with a place on them; `given` are slices with contours that stay.
    pub(super) fn follow(&self, seeds: &[(usize, DVec2)], given: &[SlicePolygons]) -> Vec<Settled> {
        let n_slices = self.edges.len();
        let empty = Settled { mask: vec![false; self.plane.n_pixels()], ..Settled::default() };
        let mut slices = vec![empty; n_slices];
        let mut is_given = vec![false; n_slices];
        for (k, polygons) in given {
            is_given[*k] = true;
            let mask = rasterised(&self.plane, polygons);
            slices[*k] = Settled { polygons: polygons.clone(), mask, n_steps: 0, at_rest: true };
        }
        for &(k, place_m) in seeds {
            if !is_given[k] {
                // Around the circle also what is in the band, so that a vessel beside the seed is enclosed.
                let near = rasterised(&self.plane, &[circle(place_m, SEED_RADIUS_M)]);
                let around = rasterised(&self.plane, &[circle(place_m, 2.0 * SEED_RADIUS_M)]);
                let smooth = self.image(k).smooth;
                let mut start = slices[k].mask.clone();
                for (pixel, inside) in start.iter_mut().enumerate() {
                    *inside |= near[pixel] || (around[pixel] && self.level.holds(smooth[pixel]));
                }
                slices[k] = settle(&self.image(k), outlines(&self.plane, &start), self.params);
            }
        }
        for sweep in 0..2 * MAX_SWEEPS {
            let mut n_changed = 0;
            for step in 1..n_slices {
                // The first two sweeps are most of the work.
                let n_swept = (sweep * n_slices + step) as f64 / n_slices as f64;
                tell(n_swept / (n_swept + 1.0));
                let (k, before) = match sweep % 2 {
                    0 => (step, step - 1),
                    _ => (n_slices - 1 - step, n_slices - step),
                };
                if is_given[k] {
                    continue;
                }
                if let Some(start) = self.suggested(k, &slices[before].mask, &slices[k].mask) {
                    let found = settle(&self.image(k), outlines(&self.plane, &start), self.params);
                    let n_new =
                        found.mask.iter().zip(&slices[k].mask).filter(|(new, old)| **new && !**old).count();
                    if n_new as f64 * self.plane.pixel_area_m2() >= self.params.least_area_m2 {
                        n_changed += 1;
                        slices[k] = found;
                    }
                }
            }
            if n_changed == 0 && sweep > 0 {
                break;
            }
        }
        slices
    }

    /// What slice `k` starts from: its own pixels and the pieces of the slice before that it does not have; `None`
    /// when there are no such pieces.
    fn suggested(&self, k: usize, before: &[bool], own: &[bool]) -> Option<Vec<bool>> {
        let whole = self.plane.grid();
        let margin_m = self.params.shrink_m + whole.spacing_m.max_element();
        let part = VoxelBox::around(&whole, before, margin_m)?;
        let near = part.grid(&whole);
        let smooth = part.cut(&whole, self.image(k).smooth);
        let shrunk = filter::erode(&near, &part.cut(&whole, before), self.params.shrink_m);
        let new: Vec<bool> = shrunk.iter().zip(part.cut(&whole, own)).map(|(&s, o)| s && !o).collect();
        let mut start = own.to_vec();
        let mut is_new = false;
        for piece in self.large_pieces(&near, &new) {
            let mut values: Vec<f32> = piece.iter().map(|&p| smooth[p]).collect();
            let is_organ = median(&mut values).is_some_and(|m| self.level.holds(m as f32));
            let taken = if is_organ {
                piece
            } else {
                // Most of it is something else: the organ has parted there, or come to its end.
                let mut organ = vec![false; new.len()];
                piece.iter().filter(|&&p| self.level.holds(smooth[p])).for_each(|&p| organ[p] = true);
                let organ = filter::open(&near, &organ, self.params.shrink_m);
                self.large_pieces(&near, &organ).concat()
            };
            is_new |= !taken.is_empty();
            taken.into_iter().for_each(|p| start[part.index_in(&whole, p)] = true);
        }
        is_new.then_some(start)
    }

    /// The pixels of each connected piece of at least the least area.
    fn large_pieces(&self, grid: &VoxelGrid, mask: &[bool]) -> Vec<Vec<usize>> {
        let found = filter::components(grid, mask, Connectivity::Faces);
        let mut pieces = vec![Vec::new(); found.sizes.len()];
        for (pixel, &piece) in found.piece.iter().enumerate().filter(|(_, piece)| **piece > 0) {
            pieces[piece as usize - 1].push(pixel);
        }
        pieces.retain(|p| p.len() as f64 * self.plane.pixel_area_m2() >= self.params.least_area_m2);
        pieces
    }
}

fn circle(center_m: DVec2, radius_m: f64) -> Vec<DVec2> {
    const N: usize = 24;
    let angle = |p: usize| std::f64::consts::TAU * p as f64 / N as f64;
    (0..N).map(|p| center_m + radius_m * DVec2::new(libm::cos(angle(p)), libm::sin(angle(p)))).collect()
}
