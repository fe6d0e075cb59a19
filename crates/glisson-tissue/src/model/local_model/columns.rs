//! The columns of a patch by conjugate gradients, eight at a time.

use super::{LocalModel, LocalWork, MOST_ITERATIONS};
use crate::model::kernel::{LaneBlock, LaneBlockWork};

/// How conjugate gradients ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Solved {
    /// To the tolerance.
    Wholly,
    /// The iterations were over before.
    Partly,
    /// The matrix is not positive definite.
    Never,
}

/// All columns of the patch.
pub(super) struct Columns<'a> {
    pub(super) work: &'a mut LocalWork,
    pub(super) out: &'a mut LocalModel,
}

impl LaneBlockWork for Columns<'_> {
    type Output = Solved;

    #[inline(always)]
    fn run<V: LaneBlock>(self, zero: V) -> Solved {
        let Self { work, out } = self;
        let n_columns = 3 * out.nodes.len();
        let n_right = n_columns + usize::from(!work.braking_n.is_empty());
        let mut solved = Solved::Wholly;
        for first in (0..n_right).step_by(8) {
            let n_lanes = (n_right - first).min(8);
            match solve_eight(zero, work, first, n_lanes) {
                Solved::Wholly => {}
                Solved::Partly => solved = Solved::Partly,
                Solved::Never => return Solved::Never,
            }
            let solution = &work.vectors[0];
            for row in 0..n_columns {
                for lane in 0..n_lanes.min(n_columns.saturating_sub(first)) {
                    out.compliance_m_per_n[n_columns * row + first + lane] = solution[row][lane];
                }
            }
            if let Some(lane) = (n_right > n_columns).then(|| n_columns.checked_sub(first)).flatten()
                && lane < n_lanes
            {
                for (row, lanes) in solution[..n_columns].iter().enumerate() {
                    out.drift_m[row / 3][row % 3] += lanes[lane];
                }
            }
        }
        solved
    }
}

/// Conjugate gradients for unit forces on the unknowns from `first` on, into the first of the vectors.
#[inline(always)]
fn solve_eight<V: LaneBlock>(zero: V, work: &mut LocalWork, first: usize, n_lanes: usize) -> Solved {
    let LocalWork {
        row_start,
        columns,
        entries,
        inverse_diagonal,
        braking_n,
        vectors,
        tolerance,
        n_patch,
        ..
    } = work;
    let matrix = Matrix { row_start, columns, entries };
    let n_columns = 3 * *n_patch;
    let mut rho = start_eight((inverse_diagonal, braking_n), n_columns, vectors, first..first + n_lanes);
    let least = rho.map(|rho| *tolerance * *tolerance * rho);
    let is_done = |rho: &[f64; 8]| (0..8).all(|lane| rho[lane] <= least[lane]);
    for _ in 0..MOST_ITERATIONS {
        if is_done(&rho) {
            return Solved::Wholly;
        }
        let [_, _, p, q] = vectors;
        let curvature = matrix.product_into(zero, p, q);
        let mut alpha = [0.0; 8];
        for lane in 0..8 {
            if rho[lane] > least[lane] {
                alpha[lane] = rho[lane] / curvature[lane];
                if !(curvature[lane] > 0.0 && alpha[lane].is_finite()) {
                    return Solved::Never;
                }
            }
        }
        let next = go_along(zero, &alpha, inverse_diagonal, vectors);
        let beta = std::array::from_fn(|lane| if rho[lane] > 0.0 { next[lane] / rho[lane] } else { 0.0 });
        let beta = zero.load(&beta);
        let [_, r, p, _] = vectors;
        for (i, inverse) in inverse_diagonal.iter().enumerate() {
            let z = zero.load(&r[i]).times(zero.constant(*inverse));
            zero.load(&p[i]).fused(beta, z).store(&mut p[i]);
        }
        rho = next;
    }
    if is_done(&rho) { Solved::Wholly } else { Solved::Partly }
}

/// Sets x = 0, unit residuals r on the unknowns of `right` (after the patch's the braking instead), and the directions
/// p = z for the inverse diagonal times r; r . z of each lane.
#[inline(always)]
fn start_eight(
    (inverse_diagonal, braking_n): (&[f64], &[f64]),
    n_columns: usize,
    vectors: &mut [Vec<[f64; 8]>; 4],
    right: std::ops::Range<usize>,
) -> [f64; 8] {
    for vector in vectors.iter_mut() {
        vector.clear();
        vector.resize(inverse_diagonal.len(), [0.0; 8]);
    }
    let [_, r, p, _] = vectors;
    // Unknowns that are not free have a zero in the preconditioner, and so stay zero.
    for (lane, unknown) in right.enumerate() {
        if unknown >= n_columns {
            for ((r, force_n), inverse) in r.iter_mut().zip(braking_n).zip(inverse_diagonal) {
                r[lane] = if *inverse > 0.0 { *force_n } else { 0.0 };
            }
        } else if inverse_diagonal[unknown] > 0.0 {
            r[unknown][lane] = 1.0;
        }
    }
    let mut rho = [0.0; 8];
    for (i, inverse) in inverse_diagonal.iter().enumerate() {
        for lane in 0..8 {
            p[i][lane] = inverse * r[i][lane];
            rho[lane] += r[i][lane] * p[i][lane];
        }
    }
    rho
}

/// The region's matrix by rows of blocks.
struct Matrix<'a> {
    row_start: &'a [u32],
    columns: &'a [u32],
    entries: &'a [[f64; 9]],
}

impl Matrix<'_> {
    /// Overwrites `q` with the matrix times `p`; p . q of each lane.
    #[inline(always)]
    fn product_into<V: LaneBlock>(&self, zero: V, p: &[[f64; 8]], q: &mut [[f64; 8]]) -> [f64; 8] {
        let Self { row_start, columns, entries } = self;
        let mut curvature = zero;
        for (row, q) in q.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            let mut sums = [zero; 3];
            for at in row_start[row] as usize..row_start[row + 1] as usize {
                let (block, column) = (&entries[at], 3 * columns[at] as usize);
                for c in 0..3 {
                    let p = zero.load(&p[column + c]);
                    for (a, sum) in sums.iter_mut().enumerate() {
                        *sum = p.fused(zero.constant(block[3 * a + c]), *sum);
                    }
                }
            }
            for (a, sum) in sums.into_iter().enumerate() {
                curvature = sum.fused(zero.load(&p[3 * row + a]), curvature);
                sum.store(&mut q[a]);
            }
        }
        let mut of_lane = [0.0; 8];
        curvature.store(&mut of_lane);
        of_lane
    }
}

/// Adds `alpha` times p to x and takes `alpha` times q from r; the new r . z of each lane.
#[inline(always)]
fn go_along<V: LaneBlock>(
    zero: V,
    alpha: &[f64; 8],
    inverse_diagonal: &[f64],
    vectors: &mut [Vec<[f64; 8]>; 4],
) -> [f64; 8] {
    let [x, r, p, q] = vectors;
    let (forth, back) = (zero.load(alpha), zero.load(&alpha.map(|a| -a)));
    let mut sum = zero;
    for (i, inverse) in inverse_diagonal.iter().enumerate() {
        zero.load(&p[i]).fused(forth, zero.load(&x[i])).store(&mut x[i]);
        // A row that is not free has a residual that does not count.
        let left = zero.load(&q[i]).fused(back, zero.load(&r[i]));
        left.store(&mut r[i]);
        let z = left.times(zero.constant(*inverse));
        sum = z.fused(left, sum);
    }
    let mut next = [0.0; 8];
    sum.store(&mut next);
    next
}
