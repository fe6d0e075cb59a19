//! Edges of a gradient: thinned where the gradient is steepest, placed between pixels, kept when strong.
//!
//! - A voxel is an edge where the size of the gradient is largest among its two neighbours along the
//!   gradient. These lie where the direction meets the next row of voxels, interpolated in it (Canny 1986, "A Computational
//!   Approach to Edge Detection", doi 10.1109/TPAMI.1986.4767851).
//! - The place between voxels is the top of the parabola through the logarithms of the three: exact where
//!   the response to a step is a Gaussian.
//! - An edge is kept when its gradient is above the higher threshold, or above the lower one and connected
//!   to one that is above the higher: hysteresis.
//! - The thresholds are multiples of what noise does to one component of the gradient. The size of the gradient of
//!   noise in n dimensions is a chi variable with n degrees of freedom, whose median is known; the median over tissue, where
//!   edges are rare, gives the deviation.

use rayon::prelude::*;

use super::plane::Plane;
use crate::image::VoxelGrid;
use crate::image::segment::statistics::median;
use crate::math::{DVec2, DVec3};

/// Median of the size of a vector of n standard normal components, n = 2 (Rayleigh: sqrt(2 ln 2)) and n = 3
/// (Maxwell).
const MEDIAN_OF_SIZE: [(usize, f64); 2] = [(2, 1.177_410_022_515_474_6), (3, 1.538_172_254_455_4)];

/// Gradient of an image.
#[derive(Clone, Debug, PartialEq)]
pub struct Gradient {
    /// Dimensions it was taken in: 2, in each slice by itself, or 3.
    pub n_dimensions: usize,
    /// Derivatives along i, j, k [1/m, times the unit of the image]; along k 0 when taken in slices.
    pub along: [Vec<f32>; 3],
}

impl Gradient {
    /// Size at a voxel.
    pub fn size(&self, index: usize) -> f32 {
        let [x, y, z] = [0, 1, 2].map(|a| self.along[a][index]);
        (x * x + y * y + z * z).sqrt()
    }

    /// Standard deviation that noise gives one component of the gradient, from the median size over the
    /// voxels of `is_tissue`; `None` without such voxels.
    pub fn noise(&self, is_tissue: &[bool]) -> Option<f64> {
        let mut sizes: Vec<f32> =
            (0..is_tissue.len()).filter(|&v| is_tissue[v]).map(|v| self.size(v)).collect();
        let of_unit = MEDIAN_OF_SIZE.iter().find(|(n, _)| *n == self.n_dimensions).map_or(1.0, |(_, m)| *m);
        Some(median(&mut sizes)? / of_unit)
    }
}

/// An edge in a pixel of a slice.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Edge {
    /// Where it crosses the slice [m].
    pub place_m: DVec2,
    /// Unit vector to the brighter side.
    pub to_brighter: DVec2,
    /// Size of the gradient [1/m, times the unit of the image].
    pub strength: f32,
}

/// The edges of a slice.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SliceEdges {
    /// For each pixel 0, or 1 + the number of its edge.
    pub number: Vec<u32>,
    /// The edges, in the order of their pixels.
    pub edges: Vec<Edge>,
}

impl SliceEdges {
    /// Signed distance [m] along the unit vector `normal` from `place_m` to the nearest edge that a probe of
    /// `reach_m` to both sides passes and that `accept` takes.
    pub fn nearest_along(
        &self,
        plane: &Plane,
        place_m: DVec2,
        normal: DVec2,
        reach_m: f64,
        accept: impl Fn(&Edge) -> bool,
    ) -> Option<f64> {
        let pixel_m = plane.spacing_m.max_element();
        let step_m = 0.5 * plane.spacing_m.min_element();
        // A row of edges that runs diagonally has places up to sqrt(2) pixels apart.
        let aside_m = 0.75 * pixel_m;
        let mut best: Option<f64> = None;
        let n_steps = ((reach_m + pixel_m) / step_m).ceil() as isize;
        for ring in 0..=n_steps {
            if best.is_some_and(|b| ring as f64 * step_m > b.abs() + pixel_m) {
                break;
            }
            for sense in if ring == 0 { &[1.0][..] } else { &[1.0, -1.0] } {
                let probe_m = place_m + normal * (ring as f64 * step_m * sense);
                let Some([i, j]) = plane.pixel_at(probe_m) else { continue };
                for [di, dj] in [[0, 0], [-1, 0], [1, 0], [0, -1], [0, 1isize]] {
                    let (Some(i), Some(j)) = (i.checked_add_signed(di), j.checked_add_signed(dj)) else {
                        continue;
                    };
                    if i >= plane.dims[0] || j >= plane.dims[1] {
                        continue;
                    }
                    let number = self.number[i + plane.dims[0] * j];
                    if number == 0 {
                        continue;
                    }
                    let edge = &self.edges[number as usize - 1];
                    let offset = edge.place_m - place_m;
                    let along = offset.dot(normal);
                    let is_near = along.abs() <= reach_m && offset.perp_dot(normal).abs() <= aside_m;
                    if is_near && best.is_none_or(|b| along.abs() < b.abs()) && accept(edge) {
                        best = Some(along);
                    }
                }
            }
        }
        best
    }
}

/// Edges of a gradient, slice by slice: thinned, placed, and kept by hysteresis between two `thresholds`.
///
/// A gradient in 3 dimensions is thinned in 3 dimensions and its edges are connected through slices; an edge is
/// placed where its plane cuts the slice, and left out where it runs along the slice (within 12 degrees).
pub fn edges(grid: &VoxelGrid, gradient: &Gradient, thresholds: [f64; 2]) -> Vec<SliceEdges> {
    let plane = Plane::of(grid);
    let n_slice = plane.n_pixels();
    let mut slices: Vec<SliceEdges> = (0..grid.dims[2])
        .into_par_iter()
        .map(|k| {
            let mut slice = SliceEdges { number: vec![0; n_slice], edges: Vec::new() };
            for pixel in 0..n_slice {
                let index = pixel + n_slice * k;
                if f64::from(gradient.size(index)) < thresholds[0] {
                    continue;
                }
                if let Some(edge) = thinned(grid, gradient, index) {
                    slice.edges.push(edge);
                    slice.number[pixel] = slice.edges.len() as u32;
                }
            }
            slice
        })
        .collect();
    let reach = isize::from(gradient.n_dimensions == 3);
    let keep = connected_to_strong(&plane, &slices, thresholds[1], reach);
    slices.par_iter_mut().zip(keep).for_each(|(slice, keep)| {
        let all = std::mem::take(&mut slice.edges);
        for number in slice.number.iter_mut().filter(|n| **n > 0) {
            let place = *number as usize - 1;
            *number = 0;
            if keep[place] {
                slice.edges.push(all[place]);
                *number = slice.edges.len() as u32;
            }
        }
    });
    slices
}

/// For each edge whether a walk over neighbouring pixels (`reach` slices up and down) leads to a strong one.
fn connected_to_strong(plane: &Plane, slices: &[SliceEdges], strong: f64, reach: isize) -> Vec<Vec<bool>> {
    let [n_i, n_j] = plane.dims;
    let mut keep: Vec<Vec<bool>> = slices.iter().map(|s| vec![false; s.edges.len()]).collect();
    let mut stack: Vec<(usize, usize)> = Vec::new();
    for (k, slice) in slices.iter().enumerate() {
        for (pixel, &number) in slice.number.iter().enumerate().filter(|(_, n)| **n > 0) {
            if f64::from(slice.edges[number as usize - 1].strength) >= strong {
                keep[k][number as usize - 1] = true;
                stack.push((k, pixel));
            }
        }
    }
    while let Some((k, pixel)) = stack.pop() {
        let (i, j) = (pixel % n_i, pixel / n_i);
        for dk in -reach..=reach {
            let Some(k) = k.checked_add_signed(dk).filter(|&k| k < slices.len()) else { continue };
            for j in j.saturating_sub(1)..(j + 2).min(n_j) {
                for i in i.saturating_sub(1)..(i + 2).min(n_i) {
                    let number = slices[k].number[i + n_i * j] as usize;
                    if number > 0 && !keep[k][number - 1] {
                        keep[k][number - 1] = true;
                        stack.push((k, i + n_i * j));
                    }
                }
            }
        }
    }
    keep
}

/// The edge of a voxel, if the gradient is steepest there.
fn thinned(grid: &VoxelGrid, gradient: &Gradient, index: usize) -> Option<Edge> {
    /// Least share of the direction that lies in the slice: sin 12 degrees.
    const LEAST_IN_SLICE: f64 = 0.2;
    let voxel = grid.voxel(index);
    let uphill = DVec3::from_array([0, 1, 2].map(|a| f64::from(gradient.along[a][index])));
    let size = gradient.size(index);
    if size <= 0.0 {
        return None;
    }
    // One voxel along the axis that dominates, in voxels.
    let step = uphill / grid.spacing_m;
    let step = step / step.abs().max_element();
    let at = DVec3::from_array(voxel.map(|v| v as f64));
    let before = size_at(grid, gradient, at - step)?;
    let after = size_at(grid, gradient, at + step)?;
    if before >= size || after > size {
        return None;
    }
    let log = |x: f32| libm::log(f64::from(x).max(1e-9 * f64::from(size)));
    let (a, b, c) = (log(before), log(size), log(after));
    let bend = a - 2.0 * b + c;
    let offset = if bend < 0.0 { (0.5 * (a - c) / bend).clamp(-0.5, 0.5) } else { 0.0 };
    // The edge is the plane across `uphill` at this distance [m]; where it meets the slice:
    let distance_m = offset * (step * grid.spacing_m).length();
    let normal = uphill / uphill.length();
    let in_slice = normal.truncate().length();
    if in_slice < LEAST_IN_SLICE {
        return None;
    }
    let to_brighter = normal.truncate() / in_slice;
    let place_m = at.truncate() * grid.spacing_m.truncate() + to_brighter * (distance_m / in_slice);
    Some(Edge { place_m, to_brighter, strength: size })
}

/// Size of the gradient between voxels, linear along the axes in which `at` is no whole number; `None` outside.
fn size_at(grid: &VoxelGrid, gradient: &Gradient, at: DVec3) -> Option<f32> {
    let low = at.floor();
    let share = at - low;
    let mut sum = 0.0;
    for corner in 0..8usize {
        let bits = [corner & 1, (corner >> 1) & 1, corner >> 2];
        let mut weight = 1.0;
        let mut voxel = [0; 3];
        for axis in 0..3 {
            weight *= if bits[axis] == 1 { share[axis] } else { 1.0 - share[axis] };
            voxel[axis] = low[axis] as isize + bits[axis] as isize;
        }
        if weight == 0.0 {
            continue;
        }
        if (0..3).any(|a| voxel[a] < 0 || voxel[a] >= grid.dims[a] as isize) {
            return None;
        }
        sum += weight * f64::from(gradient.size(grid.index(voxel.map(|v| v as usize))));
    }
    Some(sum as f32)
}
