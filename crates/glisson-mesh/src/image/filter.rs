//! Filters on volumes and masks: Gaussian smoothing, morphology with a ball, connected pieces, cavities.
//!
//! Morphology goes through the exact Euclidean distance transform, so that its cost does not depend on the
//! radius and its ball is round in millimetres even where voxels are not cubes.
//! Rows are processed in parallel; each output voxel is computed by one thread in a fixed order, so the
//! bits do not depend on the number of threads.

use rayon::prelude::*;

use super::VoxelGrid;

/// Which voxels are neighbours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Connectivity {
    /// The 6 that share a face.
    Faces,
    /// The 26 that share a face, an edge or a corner.
    Corners,
}

/// The connected pieces of a mask.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Components {
    /// For each voxel 0 outside the mask, else 1 + the number of its piece.
    pub piece: Vec<u32>,
    /// Voxels of each piece. Pieces are numbered in the order of their first voxel.
    pub sizes: Vec<usize>,
}

/// Volume smoothed by a Gaussian of standard deviation `sigma_m` [m] along each axis, cut at 3.5 sigma; the border
/// value continues outside. A `sigma_m` of 0 returns the values as they are.
pub fn gaussian(grid: &VoxelGrid, values: &[f32], sigma_m: f64) -> Vec<f32> {
    assert_eq!(values.len(), grid.n_voxels(), "one value a voxel");
    let mut smoothed = values.to_vec();
    for axis in 0..3 {
        let kernel = gaussian_kernel(sigma_m / grid.spacing_m[axis]);
        if kernel.len() > 1 {
            smoothed = convolve(grid, &smoothed, axis, &kernel);
        }
    }
    smoothed
}

/// What [`gaussian`] does to white noise of standard deviation 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseGain {
    /// Standard deviation in the smoothed volume.
    pub smoothed: f64,
    /// Standard deviation of raw minus smoothed volume.
    pub residual: f64,
}

/// How much of white noise [`gaussian`] leaves: with the kernel w the variances are sum w^2 and
/// 1 - 2 w_0 + sum w^2.
pub fn gaussian_noise_gain(grid: &VoxelGrid, sigma_m: f64) -> NoiseGain {
    let (mut center, mut sum2) = (1.0, 1.0);
    for axis in 0..3 {
        let kernel: Vec<f64> =
            gaussian_kernel(sigma_m / grid.spacing_m[axis]).into_iter().map(f64::from).collect();
        center *= kernel[0];
        sum2 *= kernel[0] * kernel[0] + 2.0 * kernel[1..].iter().map(|w| w * w).sum::<f64>();
    }
    // Where nothing is smoothed there is no residual; any scale serves then.
    let residual = (1.0 - 2.0 * center + sum2).max(0.0).sqrt();
    NoiseGain { smoothed: sum2.sqrt(), residual: if residual > 1e-6 { residual } else { 1.0 } }
}

/// Weights of a Gaussian at offsets 0, 1, 2, ... voxels; the two-sided sum is 1.
fn gaussian_kernel(sigma_voxels: f64) -> Vec<f32> {
    if sigma_voxels <= 0.0 {
        return vec![1.0];
    }
    let n = (3.5 * sigma_voxels).ceil() as usize;
    let weights: Vec<f64> =
        (0..=n).map(|o| libm::exp(-0.5 * (o as f64 / sigma_voxels) * (o as f64 / sigma_voxels))).collect();
    let sum = weights[0] + 2.0 * weights[1..].iter().sum::<f64>();
    weights.iter().map(|w| (w / sum) as f32).collect()
}

fn convolve(grid: &VoxelGrid, values: &[f32], axis: usize, kernel: &[f32]) -> Vec<f32> {
    let [n_i, n_j, n_k] = grid.dims;
    let mut result = vec![0.0; values.len()];
    result.par_chunks_mut(n_i.max(1)).enumerate().for_each(|(row, out)| {
        let (j, k) = (row % n_j, row / n_j);
        if axis == 0 {
            let line = &values[row * n_i..][..n_i];
            for (i, o) in out.iter_mut().enumerate() {
                *o = kernel[0] * line[i];
                for (offset, weight) in kernel.iter().enumerate().skip(1) {
                    *o += weight * (line[i.saturating_sub(offset)] + line[(i + offset).min(n_i - 1)]);
                }
            }
            return;
        }
        let (at, n) = if axis == 1 { (j, n_j) } else { (k, n_k) };
        let line = |place: usize| {
            let row = if axis == 1 { place + n_j * k } else { j + n_j * place };
            &values[row * n_i..][..n_i]
        };
        for (offset, &weight) in kernel.iter().enumerate() {
            let (low, high) = (line(at.saturating_sub(offset)), line((at + offset).min(n - 1)));
            if offset == 0 {
                out.iter_mut().zip(low).for_each(|(o, v)| *o = weight * v);
            } else {
                out.iter_mut().zip(low).zip(high).for_each(|((o, a), b)| *o += weight * (a + b));
            }
        }
    });
    result
}

/// Squared distance [m2] of each voxel's centre to the nearest centre in `mask`: 0 inside, infinite
/// everywhere when the mask is empty.
///
/// Exact, in time proportional to the number of voxels: the lower envelope of parabolas along one axis
/// after the other (Felzenszwalb and Huttenlocher 2012, doi 10.4086/toc.2012.v008a019).
pub fn distance_squared_m2(grid: &VoxelGrid, mask: &[bool]) -> Vec<f32> {
    assert_eq!(mask.len(), grid.n_voxels(), "one flag a voxel");
    let [n_i, n_j, n_k] = grid.dims;
    let n_slice = n_i * n_j;
    let mut squared: Vec<f32> = mask.iter().map(|&m| if m { 0.0 } else { f32::INFINITY }).collect();
    if n_slice == 0 || n_k == 0 {
        return squared;
    }
    squared.par_chunks_mut(n_slice).for_each(|slice| {
        let mut envelope = Envelope::new(n_i.max(n_j));
        for j in 0..n_j {
            envelope.pass(slice, Line { start: j * n_i, stride: 1, n: n_i, step_m: grid.spacing_m.x });
        }
        for i in 0..n_i {
            envelope.pass(slice, Line { start: i, stride: n_i, n: n_j, step_m: grid.spacing_m.y });
        }
    });
    // Along k one (i, k) slab at a time, so that threads write disjoint memory.
    let slabs: Vec<Vec<f32>> = (0..n_j)
        .into_par_iter()
        .map(|j| {
            let mut slab = Vec::with_capacity(n_i * n_k);
            for k in 0..n_k {
                slab.extend_from_slice(&squared[(j + n_j * k) * n_i..][..n_i]);
            }
            let mut envelope = Envelope::new(n_k);
            for i in 0..n_i {
                envelope.pass(&mut slab, Line { start: i, stride: n_i, n: n_k, step_m: grid.spacing_m.z });
            }
            slab
        })
        .collect();
    squared.par_chunks_mut(n_i).enumerate().for_each(|(row, out)| {
        out.copy_from_slice(&slabs[row % n_j][(row / n_j) * n_i..][..n_i]);
    });
    squared
}

/// A line of voxels in a slab of values.
#[derive(Clone, Copy)]
struct Line {
    start: usize,
    stride: usize,
    n: usize,
    step_m: f64,
}

/// Scratch for the lower envelope of the parabolas (x - x_p)^2 + f_p along a line.
struct Envelope {
    values: Vec<f64>,
    /// Parabolas of the envelope, left to right.
    parabola: Vec<usize>,
    /// Where each of them begins to be the lowest [voxels].
    begin: Vec<f64>,
}

impl Envelope {
    fn new(n: usize) -> Self {
        Self { values: vec![0.0; n], parabola: Vec::with_capacity(n), begin: Vec::with_capacity(n) }
    }

    /// Replaces the values of `line` by the lower envelope.
    fn pass(&mut self, slab: &mut [f32], line: Line) {
        let step2 = line.step_m * line.step_m;
        self.parabola.clear();
        self.begin.clear();
        for p in 0..line.n {
            // In units of the step: distances become whole numbers.
            let value = f64::from(slab[line.start + p * line.stride]) / step2;
            self.values[p] = value;
            if value == f64::INFINITY {
                continue;
            }
            let mut from = f64::NEG_INFINITY;
            while let (Some(&q), Some(&q_begin)) = (self.parabola.last(), self.begin.last()) {
                let rise = (value + (p * p) as f64) - (self.values[q] + (q * q) as f64);
                from = rise / (2 * (p - q)) as f64;
                if from > q_begin {
                    break;
                }
                self.parabola.pop();
                self.begin.pop();
                from = f64::NEG_INFINITY;
            }
            self.parabola.push(p);
            self.begin.push(from);
        }
        if self.parabola.is_empty() {
            return;
        }
        let mut lowest = 0;
        for p in 0..line.n {
            while lowest + 1 < self.begin.len() && self.begin[lowest + 1] < p as f64 {
                lowest += 1;
            }
            let q = self.parabola[lowest];
            let offset = p.abs_diff(q) as f64;
            slab[line.start + p * line.stride] = ((offset * offset + self.values[q]) * step2) as f32;
        }
    }
}

/// Squared radius with room for the rounding of distances that equal the radius.
fn reach_m2(radius_m: f64) -> f32 {
    (radius_m * radius_m * (1.0 + 1e-5)) as f32
}

/// Mask grown by a ball: voxels whose centre is at most `radius_m` from a centre in `mask`.
pub fn dilate(grid: &VoxelGrid, mask: &[bool], radius_m: f64) -> Vec<bool> {
    let reach = reach_m2(radius_m);
    distance_squared_m2(grid, mask).iter().map(|&d| d <= reach).collect()
}

/// Mask shrunk by a ball: voxels whose centre is farther than `radius_m` from every centre outside `mask`.
/// The border of the volume does not shrink it.
pub fn erode(grid: &VoxelGrid, mask: &[bool], radius_m: f64) -> Vec<bool> {
    let outside: Vec<bool> = mask.iter().map(|&m| !m).collect();
    let reach = reach_m2(radius_m);
    distance_squared_m2(grid, &outside).iter().map(|&d| d > reach).collect()
}

/// Erosion, then dilation: removes what a ball of `radius_m` does not fit into.
pub fn open(grid: &VoxelGrid, mask: &[bool], radius_m: f64) -> Vec<bool> {
    dilate(grid, &erode(grid, mask, radius_m), radius_m)
}

/// Dilation, then erosion: fills what a ball of `radius_m` outside the mask does not reach into.
pub fn close(grid: &VoxelGrid, mask: &[bool], radius_m: f64) -> Vec<bool> {
    erode(grid, &dilate(grid, mask, radius_m), radius_m)
}

/// Offsets (i, j, k) of the neighbours.
fn neighbour_offsets(connectivity: Connectivity) -> Vec<[isize; 3]> {
    let mut offsets = Vec::with_capacity(26);
    for k in -1..=1isize {
        for j in -1..=1isize {
            for i in -1..=1isize {
                let n_changed = i.abs() + j.abs() + k.abs();
                if n_changed == 1 || (n_changed > 1 && connectivity == Connectivity::Corners) {
                    offsets.push([i, j, k]);
                }
            }
        }
    }
    offsets
}

/// Calls `visit` with the place of every neighbour of voxel `index` inside the volume.
fn for_each_neighbour(grid: &VoxelGrid, offsets: &[[isize; 3]], index: usize, mut visit: impl FnMut(usize)) {
    let voxel = grid.voxel(index);
    for offset in offsets {
        let mut neighbour = [0; 3];
        let mut inside = true;
        for axis in 0..3 {
            let place = voxel[axis] as isize + offset[axis];
            inside &= place >= 0 && place < grid.dims[axis] as isize;
            neighbour[axis] = place as usize;
        }
        if inside {
            visit(grid.index(neighbour));
        }
    }
}

/// Connected pieces of a mask.
pub fn components(grid: &VoxelGrid, mask: &[bool], connectivity: Connectivity) -> Components {
    assert_eq!(mask.len(), grid.n_voxels(), "one flag a voxel");
    let offsets = neighbour_offsets(connectivity);
    let mut found = Components { piece: vec![0; mask.len()], sizes: Vec::new() };
    let mut stack = Vec::new();
    for first in 0..mask.len() {
        if !mask[first] || found.piece[first] != 0 {
            continue;
        }
        let number = found.sizes.len() as u32 + 1;
        found.piece[first] = number;
        stack.push(first);
        let mut size = 0;
        while let Some(index) = stack.pop() {
            size += 1;
            for_each_neighbour(grid, &offsets, index, |n| {
                if mask[n] && found.piece[n] == 0 {
                    found.piece[n] = number;
                    stack.push(n);
                }
            });
        }
        found.sizes.push(size);
    }
    found
}

/// The piece of a mask with the most voxels (the first of equals); all false for an empty mask.
pub fn largest_piece(grid: &VoxelGrid, mask: &[bool], connectivity: Connectivity) -> Vec<bool> {
    let found = components(grid, mask, connectivity);
    let mut best = 0;
    for (number, &size) in found.sizes.iter().enumerate() {
        if size > found.sizes[best] {
            best = number;
        }
    }
    found.piece.iter().map(|&p| p as usize == best + 1).collect()
}

/// Adds to `mask` its cavities: outside voxels from which no walk over faces leads to the border of the
/// volume. Returns how many voxels were added.
pub fn fill_cavities(grid: &VoxelGrid, mask: &mut [bool]) -> usize {
    assert_eq!(mask.len(), grid.n_voxels(), "one flag a voxel");
    let offsets = neighbour_offsets(Connectivity::Faces);
    let on_border = |voxel: [usize; 3]| (0..3).any(|a| voxel[a] == 0 || voxel[a] + 1 == grid.dims[a]);
    let mut reached = vec![false; mask.len()];
    let mut stack: Vec<usize> =
        (0..mask.len()).filter(|&index| !mask[index] && on_border(grid.voxel(index))).collect();
    for &index in &stack {
        reached[index] = true;
    }
    while let Some(index) = stack.pop() {
        for_each_neighbour(grid, &offsets, index, |n| {
            if !mask[n] && !reached[n] {
                reached[n] = true;
                stack.push(n);
            }
        });
    }
    let mut n_filled = 0;
    for (inside, reached) in mask.iter_mut().zip(reached) {
        if !*inside && !reached {
            *inside = true;
            n_filled += 1;
        }
    }
    n_filled
}
