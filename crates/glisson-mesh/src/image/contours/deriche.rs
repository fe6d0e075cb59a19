//! Gradient of a volume by Deriche's recursive filters: the cost does not depend on their width.
//!
//! With a decay a [1/voxel] and q = exp(-a), along one axis
//! - derivative: kernel d(n) = c n q^|n|, with c such that a ramp of slope 1 gives 1;
//! - smoothing: kernel s(n) = k (1 + a |n|) q^|n|, with k such that a constant stays what it is.
//!
//! Each is the sum of a filter of second order that runs forwards and one that runs backwards over the same
//! poles (Deriche 1987, "Using Canny's Criteria to Derive a Recursively Implemented Optimal Edge Detector", doi
//! 10.1007/BF00123164). In a volume each component of the gradient takes the derivative along its own axis and the smoothing along
//! the other two (Monga, Deriche and Rocchisani 1991, "3D edge detection using recursive filtering: application to scanner images",
//! CVGIP: Image Understanding 53(1), 76-87). Where we differ: the decay is the same
//! along the axes in metres, not in voxels; the borders start from the state that the border value, continued for ever, leaves.

use rayon::prelude::*;

use super::edges::Gradient;
use crate::image::VoxelGrid;

/// A filter that runs forwards and backwards:
/// forwards y(n) = b0 x(n) + b1 x(n-1) + 2 q y(n-1) - q^2 y(n-2),
/// backwards z(n) = c1 x(n+1) + c2 x(n+2) + 2 q z(n+1) - q^2 z(n+2), result y + z.
#[derive(Clone, Copy, Debug)]
struct Recursion {
    forward: [f64; 2],
    backward: [f64; 2],
    /// 2 q and -q^2.
    feedback: [f64; 2],
}

impl Recursion {
    fn smoothing(decay: f64) -> Self {
        let q = libm::exp(-decay);
        let k = (1.0 - q) * (1.0 - q) / (1.0 + 2.0 * decay * q - q * q);
        Self {
            forward: [k, k * q * (decay - 1.0)],
            backward: [k * q * (decay + 1.0), -k * q * q],
            feedback: [2.0 * q, -q * q],
        }
    }

    fn derivative(decay: f64) -> Self {
        let q = libm::exp(-decay);
        // A ramp gives 2 c sum n^2 q^(n-1) = 2 c (1 + q) / (1 - q)^3.
        let c = (1.0 - q) * (1.0 - q) * (1.0 - q) / (2.0 * (1.0 + q));
        Self { forward: [0.0, -c], backward: [c, 0.0], feedback: [2.0 * q, -q * q] }
    }

    /// Filters `line`; `scratch` has room for it.
    fn run(self, line: &mut [f64], scratch: &mut [f64]) {
        let n = line.len();
        let [Some(&first), Some(&last)] = [line.first(), line.last()] else { return };
        let still = 1.0 - self.feedback[0] - self.feedback[1];
        let rest = first * (self.forward[0] + self.forward[1]) / still;
        let (mut y1, mut y2, mut x1) = (rest, rest, first);
        for place in 0..n {
            let x = line[place];
            let y =
                self.forward[0] * x + self.forward[1] * x1 + self.feedback[0] * y1 + self.feedback[1] * y2;
            scratch[place] = y;
            (y2, y1, x1) = (y1, y, x);
        }
        let rest = last * (self.backward[0] + self.backward[1]) / still;
        let (mut z1, mut z2, mut x1, mut x2) = (rest, rest, last, last);
        for place in (0..n).rev() {
            let z =
                self.backward[0] * x1 + self.backward[1] * x2 + self.feedback[0] * z1 + self.feedback[1] * z2;
            (x2, x1) = (x1, line[place]);
            (z2, z1) = (z1, z);
            line[place] = scratch[place] + z;
        }
    }
}

/// Gradient of a volume, smoothed by kernels that decay by exp(-1) over `decay_length_m` [m].
///
/// A step smoothed by the derivative's kernel is about as wide as with a Gaussian of 1.4 times this deviation.
pub fn recursive_gradient(grid: &VoxelGrid, values: &[f32], decay_length_m: f64) -> Gradient {
    assert_eq!(values.len(), grid.n_voxels(), "one value a voxel");
    let decay = [0, 1, 2].map(|a| grid.spacing_m[a] / decay_length_m);
    let along = [0, 1, 2].map(|component| {
        let filters = [0, 1, 2].map(|axis| match axis == component {
            true => Recursion::derivative(decay[axis]),
            false => Recursion::smoothing(decay[axis]),
        });
        let mut result = values.to_vec();
        in_slices(grid, &mut result, [filters[0], filters[1]]);
        across_slices(grid, &mut result, filters[2]);
        let per_voxel = (1.0 / grid.spacing_m[component]) as f32;
        result.iter_mut().for_each(|v| *v *= per_voxel);
        result
    });
    Gradient { n_dimensions: 3, along }
}

/// Filters along i and then along j, in place.
fn in_slices(grid: &VoxelGrid, values: &mut [f32], filters: [Recursion; 2]) {
    let [n_i, n_j, _] = grid.dims;
    values.par_chunks_mut((n_i * n_j).max(1)).for_each(|slice| {
        let (mut line, mut scratch) = (vec![0.0; n_i.max(n_j)], vec![0.0; n_i.max(n_j)]);
        for row in slice.chunks_mut(n_i) {
            row.iter().zip(&mut line).for_each(|(v, l)| *l = f64::from(*v));
            filters[0].run(&mut line[..n_i], &mut scratch);
            row.iter_mut().zip(&line).for_each(|(v, l)| *v = *l as f32);
        }
        for i in 0..n_i {
            (0..n_j).for_each(|j| line[j] = f64::from(slice[i + n_i * j]));
            filters[1].run(&mut line[..n_j], &mut scratch);
            (0..n_j).for_each(|j| slice[i + n_i * j] = line[j] as f32);
        }
    });
}

/// Filters along k, in place: rows of constant j are gathered so that threads write disjoint memory.
fn across_slices(grid: &VoxelGrid, values: &mut [f32], filter: Recursion) {
    let [n_i, n_j, n_k] = grid.dims;
    let slabs: Vec<Vec<f32>> = (0..n_j)
        .into_par_iter()
        .map(|j| {
            let mut slab = vec![0.0; n_i * n_k];
            let (mut line, mut scratch) = (vec![0.0; n_k], vec![0.0; n_k]);
            for i in 0..n_i {
                (0..n_k).for_each(|k| line[k] = f64::from(values[i + n_i * (j + n_j * k)]));
                filter.run(&mut line, &mut scratch);
                (0..n_k).for_each(|k| slab[i + n_i * k] = line[k] as f32);
            }
            slab
        })
        .collect();
    values.par_chunks_mut(n_i.max(1)).enumerate().for_each(|(row, out)| {
        out.copy_from_slice(&slabs[row % n_j][(row / n_j) * n_i..][..n_i]);
    });
}
