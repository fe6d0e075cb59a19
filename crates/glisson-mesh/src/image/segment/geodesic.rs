//! A geodesic active contour with the best place found by convex optimisation.
//!
//! A geodesic active contour (Caselles, Kimmel and Sapiro 1997, doi 10.1023/A:1007979827043) is the surface of
//! least area where area counts less on edges of the image. With u = 1 inside and 0 outside the area is the total
//! variation, weighted by g, and for u in [0, 1] the problem
//!
//! ```text
//! minimise  sum over voxels of  g |grad u| + cost u
//! ```
//!
//! is convex: whatever the start, level sets of the minimum are best surfaces (Bresson, Esedoglu, Vandergheynst, Thiran and
//! Osher, Fast global minimization of the active contour/snake model, 2007). It is solved by the primal-dual steps of
//! Chambolle and Pock 2011 (doi 10.1007/s10851-010-0251-1), algorithm 1, each voxel by itself, so that the bits do not
//! depend on threads.

use rayon::prelude::*;

use crate::image::VoxelGrid;
use crate::progress::tell;

/// What an area on an edge counts at least.
const LEAST_AREA: f32 = 0.03;

/// A contour to find. Lengths are in millimetres, so that costs and areas have handy sizes in `f32`.
pub(super) struct Contour<'a> {
    pub(super) grid: &'a VoxelGrid,
    /// What a unit of area counts in each voxel: 1 where the image is flat, less on edges.
    pub(super) area: Vec<f32>,
    /// What a unit of volume inside costs in each voxel [1/mm]; negative inside the organ.
    pub(super) cost: Vec<f32>,
}

/// What a unit of area counts: exp(-d / `edge_hu`) with the difference d between neighbouring voxels, brought
/// to cubic voxels of the same volume.
pub(super) fn areas(grid: &VoxelGrid, values: &[f32], edge_hu: f32) -> Vec<f32> {
    let [n_i, n_j, n_k] = grid.dims;
    let cube_m = libm::cbrt(grid.voxel_volume_m3());
    let scale = grid.spacing_m.to_array().map(|s| (cube_m / s) as f32);
    let step = [1, n_i, n_i * n_j];
    let n = [n_i, n_j, n_k];
    (0..values.len())
        .into_par_iter()
        .map(|index| {
            let voxel = grid.voxel(index);
            let slope2: f32 = (0..3)
                .filter(|&a| voxel[a] + 1 < n[a])
                .map(|a| scale[a] * (values[index + step[a]] - values[index]))
                .map(|d| d * d)
                .sum();
            libm::expf(-slope2.sqrt() / edge_hu).max(LEAST_AREA)
        })
        .collect()
}

impl Contour<'_> {
    /// Makes `n_steps` steps from `inside`, the shares of the voxels that are inside: from 0 to 1.
    pub(super) fn relax(&self, inside: &mut [f32], n_steps: usize) {
        let [n_i, n_j, _] = self.grid.dims;
        let slice = (n_i * n_j).max(1);
        let per_mm = self.grid.spacing_m.to_array().map(|s| (1e-3 / s) as f32);
        // The largest the gradient can make of a field: its square is at most 4 sum 1/h^2.
        let norm = 2.0 * per_mm.iter().map(|w| w * w).sum::<f32>().sqrt();
        let step = 1.0 / norm;
        let mut flow: Vec<[f32; 3]> = vec![[0.0; 3]; inside.len()];
        let mut ahead = inside.to_vec();
        for n_done in 0..n_steps {
            tell(n_done as f64 / n_steps as f64);
            flow.par_chunks_mut(slice).enumerate().for_each(|(k, flow)| {
                for j in 0..n_j {
                    let row = k * slice + j * n_i;
                    let here = &ahead[row..][..n_i];
                    // Beyond the last row: the same values, so no slope.
                    let next = if j + 1 < n_j { &ahead[row + n_i..][..n_i] } else { here };
                    let above = ahead.get(row + slice..row + slice + n_i).unwrap_or(here);
                    let area = &self.area[row..][..n_i];
                    for (i, flow) in flow[j * n_i..][..n_i].iter_mut().enumerate() {
                        let right = if i + 1 < n_i { here[i + 1] } else { here[i] };
                        let slope = [right - here[i], next[i] - here[i], above[i] - here[i]];
                        let [x, y, z] = [0, 1, 2].map(|a| flow[a] + step * per_mm[a] * slope[a]);
                        let length = (x * x + y * y + z * z).sqrt();
                        let shrink = area[i] / length.max(area[i]);
                        *flow = [x * shrink, y * shrink, z * shrink];
                    }
                }
            });
            inside.par_chunks_mut(slice).zip(ahead.par_chunks_mut(slice)).enumerate().for_each(
                |(k, (inside, ahead))| {
                    for (place, (inside, ahead)) in inside.iter_mut().zip(ahead).enumerate() {
                        let index = k * slice + place;
                        let (i, j) = (place % n_i, place / n_i);
                        let out = flow[index];
                        let before_i = if i > 0 { flow[index - 1][0] } else { 0.0 };
                        let before_j = if j > 0 { flow[index - n_i][1] } else { 0.0 };
                        let before_k = if k > 0 { flow[index - slice][2] } else { 0.0 };
                        let divergence = per_mm[0] * (out[0] - before_i)
                            + per_mm[1] * (out[1] - before_j)
                            + per_mm[2] * (out[2] - before_k);
                        let new = (*inside + step * (divergence - self.cost[index])).clamp(0.0, 1.0);
                        *ahead = 2.0 * new - *inside;
                        *inside = new;
                    }
                },
            );
        }
    }
}
