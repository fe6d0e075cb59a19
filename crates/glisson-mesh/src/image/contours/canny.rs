//! Gradient of each slice by derivatives of a Gaussian, as Canny's edge detector takes it (Canny 1986, doi
//! 10.1109/TPAMI.1986.4767851).
//!
//! The smoothing kernel is the sampled Gaussian w_o = exp(-o^2 / 2 s^2), cut at 4 s, with the sum 1; the
//! derivative is sum o w_o v(x + o) / sum o^2 w_o, which is exact for a ramp.

use rayon::prelude::*;

use super::edges::Gradient;
use super::plane::Plane;
use crate::image::VoxelGrid;

/// Weights at offsets 0, 1, 2, ... of the smoothing (even) and of the derivative (odd) [1/voxel].
struct Kernels {
    smooth: Vec<f32>,
    derivative: Vec<f32>,
}

impl Kernels {
    fn new(sigma_voxels: f64) -> Self {
        let n = (4.0 * sigma_voxels).ceil().max(1.0) as usize;
        let weights: Vec<f64> = (0..=n)
            .map(|o| {
                libm::exp(-0.5 * (o as f64 / sigma_voxels.max(1e-3)) * (o as f64 / sigma_voxels.max(1e-3)))
            })
            .collect();
        let sum = weights[0] + 2.0 * weights[1..].iter().sum::<f64>();
        // A Gaussian far narrower than a voxel leaves the difference of the neighbours.
        let moments: Vec<f64> = if weights[1] < 1e-6 {
            (0..=n).map(|o| f64::from(u8::from(o == 1))).collect()
        } else {
            weights.iter().enumerate().map(|(o, w)| o as f64 * w).collect()
        };
        let ramp = 2.0 * moments.iter().enumerate().map(|(o, m)| o as f64 * m).sum::<f64>();
        Self {
            smooth: weights.iter().map(|w| (w / sum) as f32).collect(),
            derivative: moments.iter().map(|m| (m / ramp) as f32).collect(),
        }
    }
}

/// Gradient of each slice, smoothed in the slice by a Gaussian of deviation `sigma_m` [m]. The border value
/// continues outside.
pub fn gaussian_gradient(grid: &VoxelGrid, values: &[f32], sigma_m: f64) -> Gradient {
    assert_eq!(values.len(), grid.n_voxels(), "one value a voxel");
    let plane = Plane::of(grid);
    let n_slice = plane.n_pixels();
    let kernels = [0, 1].map(|a| Kernels::new(sigma_m / plane.spacing_m[a]));
    let mut along = [0, 1, 2].map(|_| vec![0.0f32; values.len()]);
    if n_slice == 0 {
        return Gradient { n_dimensions: 2, along };
    }
    let [along_i, along_j, _] = &mut along;
    let slices = along_i.par_chunks_mut(n_slice).zip(along_j.par_chunks_mut(n_slice));
    slices.zip(values.par_chunks(n_slice)).for_each(|((out_i, out_j), slice)| {
        let mut rows = vec![0.0; n_slice];
        let [per_i, per_j] = [0, 1].map(|a| (1.0 / plane.spacing_m[a]) as f32);
        along_rows(&plane, slice, &kernels[0].derivative, -1.0, &mut rows);
        along_columns(&plane, &rows, &kernels[1].smooth, 1.0, out_i);
        along_rows(&plane, slice, &kernels[0].smooth, 1.0, &mut rows);
        along_columns(&plane, &rows, &kernels[1].derivative, -1.0, out_j);
        out_i.iter_mut().for_each(|v| *v *= per_i);
        out_j.iter_mut().for_each(|v| *v *= per_j);
    });
    Gradient { n_dimensions: 2, along }
}

/// Convolution of each row with weights at offsets 0, 1, 2, ...; `parity` is the sign at negative offsets.
fn along_rows(plane: &Plane, slice: &[f32], kernel: &[f32], parity: f32, out: &mut [f32]) {
    let n_i = plane.dims[0];
    for (line, out) in slice.chunks(n_i).zip(out.chunks_mut(n_i)) {
        for i in 0..n_i {
            let mut sum = kernel[0] * line[i];
            for (offset, weight) in kernel.iter().enumerate().skip(1) {
                sum += weight * (line[(i + offset).min(n_i - 1)] + parity * line[i.saturating_sub(offset)]);
            }
            out[i] = sum;
        }
    }
}

/// As [`along_rows`], for columns.
fn along_columns(plane: &Plane, slice: &[f32], kernel: &[f32], parity: f32, out: &mut [f32]) {
    let [n_i, n_j] = plane.dims;
    let line = |j: usize| &slice[j * n_i..][..n_i];
    for (j, out) in out.chunks_mut(n_i).enumerate() {
        out.iter_mut().zip(line(j)).for_each(|(o, v)| *o = kernel[0] * v);
        for (offset, &weight) in kernel.iter().enumerate().skip(1) {
            let (low, high) = (line(j.saturating_sub(offset)), line((j + offset).min(n_j - 1)));
            out.iter_mut().zip(high).zip(low).for_each(|((o, h), l)| *o += weight * (h + parity * l));
        }
    }
}
