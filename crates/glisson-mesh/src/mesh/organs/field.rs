//! Smooth shares of the regions at any place: the label map seen through a cubic B-spline.
//!
//! The share of region r at place x is `phi_r(x) = sum of w(x - x_v) over the voxels v of r`, with the tensor product of
//! cubic B-splines `w` of half width `2 a` along each voxel axis (variance `a^2 / 3`; twice continuously differentiable, so
//! that borders have normals), divided by the sum over all voxels. All shares, that of the outside (region 0) included, add
//! up to 1. The border of two regions is where their shares are equal, that of any with the outside where the outside's share is a
//! half: so the outer surface runs on smoothly where an interface meets it (indicator functions as in Bronson, Levine and
//! Whitaker, Lattice Cleaving, IEEE Transactions on Visualization and Computer Graphics 20(2), 2014,
//! doi 10.1109/TVCG.2013.115).

use super::cell_size::CellSize;
use super::regions::RegionGrid;
use crate::math::DVec3;

/// Kernel scale `a` in voxels below which the voxels' steps would show.
const SMALLEST_SCALE_VOXELS: f64 = 1.25;

/// Kernel scale `a` over the lattice cell: smaller waves than the cells can show are smoothed away.
const SCALE_OVER_CELL: f64 = 0.45;

/// Slope of the difference of two shares across a flat border, times `a`: twice the kernel's peak of 2/3.
const FLAT_SLOPE_TIMES_SCALE: f64 = 4.0 / 3.0;

/// Shares of all regions at one place, and their gradients; reused from place to place.
#[derive(Clone, Debug)]
pub(super) struct Shares {
    /// One a region, 0 first.
    pub(super) value: Vec<f64>,
    /// One a region [1/m].
    pub(super) gradient: Vec<DVec3>,
    /// Slope of the difference of two shares across a flat border here [1/m]; along the voxels' longest axis if they are not cubes.
    pub(super) flat_slope: f64,
    taps: [Taps; 3],
}

/// Weights of the voxels along one axis.
#[derive(Clone, Debug, Default)]
struct Taps {
    first: usize,
    weight: Vec<f64>,
    /// Derivative by the place [1/voxel].
    slope: Vec<f64>,
}

/// The smooth shares of a region grid.
#[derive(Clone, Debug)]
pub(super) struct ShareField<'a> {
    regions: &'a RegionGrid,
    size: CellSize<'a>,
    /// With the largest cells.
    scale: Scale,
}

/// How smooth the shares are.
#[derive(Clone, Copy, Debug)]
struct Scale {
    voxels: DVec3,
    flat_slope: f64,
}

impl<'a> ShareField<'a> {
    /// Shares smooth enough for cells of this size.
    pub(super) fn new(regions: &'a RegionGrid, size: CellSize<'a>) -> Self {
        Self { regions, size, scale: Scale::new(regions, size.largest_m()) }
    }

    fn scale_at(&self, position_m: DVec3) -> Scale {
        if self.size.is_even() { self.scale } else { Scale::new(self.regions, self.size.at_m(position_m)) }
    }

    /// Slope of the difference of two shares across a flat border where cells are largest [1/m].
    pub(super) fn least_flat_slope(&self) -> f64 {
        self.scale.flat_slope
    }

    /// The same at a place.
    pub(super) fn flat_slope_at(&self, position_m: DVec3) -> f64 {
        self.scale_at(position_m).flat_slope
    }

    /// Room for the shares at a place.
    pub(super) fn shares(&self) -> Shares {
        let n = self.regions.n_regions() + 1;
        Shares {
            value: vec![0.0; n],
            gradient: vec![DVec3::ZERO; n],
            flat_slope: self.scale.flat_slope,
            taps: Default::default(),
        }
    }

    /// Shares and gradients at `position_m`.
    pub(super) fn sample_into(&self, position_m: DVec3, shares: &mut Shares) {
        let grid = self.regions.grid();
        let at = grid.voxel_at(position_m);
        let scale = self.scale_at(position_m);
        let Shares { value, gradient, flat_slope, taps } = shares;
        *flat_slope = scale.flat_slope;
        value.fill(0.0);
        gradient.fill(DVec3::ZERO);
        for axis in 0..3 {
            taps[axis].place(at[axis], scale.voxels[axis], grid.dims[axis]);
        }
        let [along_i, along_j, along_k] = &*taps;
        for (k, (&w_k, &s_k)) in (along_k.first..).zip(along_k.weight.iter().zip(&along_k.slope)) {
            for (j, (&w_j, &s_j)) in (along_j.first..).zip(along_j.weight.iter().zip(&along_j.slope)) {
                let (w, s_y, s_z) = (w_j * w_k, s_j * w_k, w_j * s_k);
                let row =
                    &self.regions.of_voxels()[grid.index([along_i.first, j, k])..][..along_i.weight.len()];
                let mut start = 0;
                for run in row.chunk_by(|a, b| a == b) {
                    let range = start..start + run.len();
                    start = range.end;
                    if run[0] == 0 {
                        continue;
                    }
                    let sum: f64 = along_i.weight[range.clone()].iter().sum();
                    let slope: f64 = along_i.slope[range].iter().sum();
                    let region = usize::from(run[0]);
                    value[region] += w * sum;
                    gradient[region] += DVec3::new(w * slope, s_y * sum, s_z * sum);
                }
            }
        }
        // What no region holds is outside, beyond the grid, too.
        let mut outside = (1.0, DVec3::ZERO);
        for (v, g) in value.iter().zip(gradient.iter_mut()).skip(1) {
            *g = grid.axes * (*g / grid.spacing_m);
            outside.0 -= v;
            outside.1 -= *g;
        }
        (value[0], gradient[0]) = outside;
    }
}

impl Scale {
    fn new(regions: &RegionGrid, cell_m: f64) -> Self {
        let spacing_m = regions.grid().spacing_m;
        let voxels = (SCALE_OVER_CELL * cell_m / spacing_m).max(DVec3::splat(SMALLEST_SCALE_VOXELS));
        Self { voxels, flat_slope: FLAT_SLOPE_TIMES_SCALE / (voxels * spacing_m).max_element() }
    }
}

impl Shares {
    /// By how much region `a` leads over region `b` (ascending numbers, `b` before `a`), and its gradient [1/m]: positive on the
    /// side of a, 0 on the border.
    pub(super) fn lead(&self, b: usize, a: usize) -> (f64, DVec3) {
        if b == 0 {
            // Over all regions together: phi_a - phi_0 where there is no third region.
            return (1.0 - 2.0 * self.value[0], -2.0 * self.gradient[0]);
        }
        (self.value[a] - self.value[b], self.gradient[a] - self.gradient[b])
    }
}

impl Taps {
    /// Weights of the voxels `0..n` that lie within two scales of `at`; their sum over an endless row would be 1.
    fn place(&mut self, at: f64, scale: f64, n: usize) {
        self.weight.clear();
        self.slope.clear();
        let (low, high) = ((at - 2.0 * scale).ceil(), (at + 2.0 * scale).floor());
        let (mut sum, mut sum_slope) = (0.0, 0.0);
        self.first = low.max(0.0) as usize;
        let mut voxel = low;
        while voxel <= high {
            let (weight, slope) = cubic_b_spline((at - voxel) / scale);
            sum += weight;
            sum_slope += slope / scale;
            if voxel >= 0.0 && voxel < n as f64 {
                self.weight.push(weight);
                self.slope.push(slope / scale);
            }
            voxel += 1.0;
        }
        for (weight, slope) in self.weight.iter_mut().zip(&mut self.slope) {
            *slope = (*slope - *weight * sum_slope / sum) / sum;
            *weight /= sum;
        }
        if self.weight.is_empty() {
            self.first = 0;
        }
    }
}

/// The cubic B-spline of unit knots at `t` and its derivative: peak 2/3, zero from |t| = 2 on.
fn cubic_b_spline(t: f64) -> (f64, f64) {
    let x = t.abs();
    let (value, slope) = if x < 1.0 {
        (2.0 / 3.0 - x * x + 0.5 * x * x * x, -2.0 * x + 1.5 * x * x)
    } else if x < 2.0 {
        let y = 2.0 - x;
        (y * y * y / 6.0, -0.5 * y * y)
    } else {
        (0.0, 0.0)
    };
    (value, slope * t.signum())
}
