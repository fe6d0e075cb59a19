//! One loop over a part's tetrahedra for each instruction set, all with the same bits.
//!
//! Lanes of a block are independent until the forces are added up; that happens lane after lane, in each lane
//! corner after corner, on every path. So two lanes may even share a node.

use fearless_simd::{Level, Simd, f64x4, f64x8, prelude::*, u8x32};

use super::KernelLaw;
use super::element::{ElementLaw, Linear, StVenantKirchhoff, corner_forces};
use super::lanes::Lanes;
use super::rows::{Block, N_LANES, Rows};

/// How the kernel computes. The result is the same on each path.
#[derive(Clone, Copy, Debug)]
pub struct KernelPath(Path);

#[derive(Clone, Copy, Debug)]
enum Path {
    #[cfg(target_arch = "x86_64")]
    Avx512(fearless_simd::Avx512),
    #[cfg(target_arch = "x86_64")]
    Avx2(fearless_simd::Avx2),
    #[cfg(target_arch = "x86_64")]
    Scalar(fearless_simd::Avx2),
    Portable,
}

impl KernelPath {
    /// The paths that this processor has, the fastest first; the last one runs everywhere.
    ///
    /// `scalar` computes one tetrahedron at a time, compiled for the same processor as `avx2`: what vectors are
    /// worth is the ratio to it. `portable` is compiled for every processor; where that does not
    /// promise a fused multiply-add in hardware, it is slow.
    pub fn available() -> Vec<Self> {
        let mut paths = Vec::new();
        #[cfg(target_arch = "x86_64")]
        {
            let level = Level::new();
            paths.extend(level.as_avx512().map(Path::Avx512));
            paths.extend(level.as_avx2().map(Path::Avx2));
            paths.extend(level.as_avx2().map(Path::Scalar));
        }
        paths.push(Path::Portable);
        paths.into_iter().map(Self).collect()
    }

    /// The fastest path here.
    pub fn fastest() -> Self {
        Self::available()[0]
    }

    /// The path of this name, if the processor has it.
    pub fn named(name: &str) -> Option<Self> {
        Self::available().into_iter().find(|path| path.name() == name)
    }

    /// `avx512`, `avx2`, `scalar` or `portable`.
    pub fn name(self) -> &'static str {
        match self.0 {
            #[cfg(target_arch = "x86_64")]
            Path::Avx512(_) => "avx512",
            #[cfg(target_arch = "x86_64")]
            Path::Avx2(_) => "avx2",
            #[cfg(target_arch = "x86_64")]
            Path::Scalar(_) => "scalar",
            Path::Portable => "portable",
        }
    }

    /// Adds the forces of `blocks` at the displacements in `rows` to the forces there.
    pub(super) fn add_forces(self, law: KernelLaw, blocks: &[Block], rows: &mut Rows) {
        match law {
            KernelLaw::Linear => self.add_forces_of::<Linear>(blocks, rows),
            KernelLaw::StVenantKirchhoff => {
                self.add_forces_of::<StVenantKirchhoff>(blocks, rows);
            }
        }
    }

    fn add_forces_of<L: ElementLaw>(self, blocks: &[Block], rows: &mut Rows) {
        match self.0 {
            #[cfg(target_arch = "x86_64")]
            Path::Avx512(simd) => simd.vectorize(
                #[inline(always)]
                || add_by_eight::<_, L>(simd, blocks, rows),
            ),
            #[cfg(target_arch = "x86_64")]
            Path::Avx2(simd) => simd.vectorize(
                #[inline(always)]
                || add_by_four::<L>(simd, blocks, rows),
            ),
            #[cfg(target_arch = "x86_64")]
            Path::Scalar(simd) => simd.vectorize(
                #[inline(always)]
                || add_one_by_one::<L>(blocks, rows),
            ),
            Path::Portable => add_one_by_one::<L>(blocks, rows),
        }
    }
}

/// Eight lanes in one vector.
#[inline(always)]
fn add_by_eight<S: Simd, L: ElementLaw>(simd: S, blocks: &[Block], rows: &mut Rows) {
    let zero = f64x8::splat(simd, 0.0);
    for block in blocks {
        let at = &block.offsets;
        // Lanes 2 p and 2 p + 1: their rows side by side.
        let mut edges = [[zero; 4]; 3];
        for p in 0..4 {
            let (a, b) = (&at[2 * p], &at[2 * p + 1]);
            let first = row(simd, rows, a[0]).combine(row(simd, rows, b[0]));
            for k in 0..3 {
                let corner = row(simd, rows, a[k + 1]).combine(row(simd, rows, b[k + 1]));
                edges[k][p] = corner - first;
            }
        }
        let d = [columns(&edges[0]), columns(&edges[1]), columns(&edges[2])];
        let alpha = &block.alpha_per_m;
        let load = |numbers: &[f64; N_LANES]| f64x8::from_slice(simd, numbers);
        let alpha = [
            [load(&alpha[0][0]), load(&alpha[0][1]), load(&alpha[0][2])],
            [load(&alpha[1][0]), load(&alpha[1][1]), load(&alpha[1][2])],
            [load(&alpha[2][0]), load(&alpha[2][1]), load(&alpha[2][2])],
        ];
        let material = [load(&block.material[0]), load(&block.material[1])];
        let f = corner_forces::<L, _>(&d, &alpha, material);
        let pairs = [pairs_of_rows(&f[0], zero), pairs_of_rows(&f[1], zero), pairs_of_rows(&f[2], zero)];
        for p in 0..4 {
            let (f1, f2, f3) = (pairs[0][p], pairs[1][p], pairs[2][p]);
            let sum = f1 + f2 + f3;
            let (sum, f1, f2, f3) = (sum.split(), f1.split(), f2.split(), f3.split());
            add_lane(simd, rows, &at[2 * p], [sum.0, f1.0, f2.0, f3.0]);
            add_lane(simd, rows, &at[2 * p + 1], [sum.1, f1.1, f2.1, f3.1]);
        }
    }
}

#[inline(always)]
fn row<S: Simd>(simd: S, rows: &Rows, offset: u16) -> f64x4<S> {
    u8x32::from_slice(simd, rows.displacement(offset)).bitcast()
}

/// x, y and z of eight lanes from four pairs of rows.
#[inline(always)]
fn columns<S: Simd>(pairs: &[f64x8<S>; 4]) -> [f64x8<S>; 3] {
    let [a, b, c, d] = *pairs;
    let (xz_low, xz_high) = (a.unzip_low(b), c.unzip_low(d));
    let (y_low, y_high) = (a.unzip_high(b), c.unzip_high(d));
    [xz_low.unzip_low(xz_high), y_low.unzip_low(y_high), xz_low.unzip_high(xz_high)]
}

/// Four pairs of rows from x, y and z of eight lanes.
#[inline(always)]
fn pairs_of_rows<S: Simd>(xyz: &[f64x8<S>; 3], zero: f64x8<S>) -> [f64x8<S>; 4] {
    let [x, y, z] = *xyz;
    let (xz_low, xz_high) = (x.zip_low(z), x.zip_high(z));
    let (y_low, y_high) = (y.zip_low(zero), y.zip_high(zero));
    [xz_low.zip_low(y_low), xz_low.zip_high(y_low), xz_high.zip_low(y_high), xz_high.zip_high(y_high)]
}

/// Adds a tetrahedron's forces: the first is the sum that its first corner balances.
#[inline(always)]
fn add_lane<S: Simd>(simd: S, rows: &mut Rows, at: &[u16; 4], [sum, f1, f2, f3]: [f64x4<S>; 4]) {
    let bytes = rows.force_mut(at[0]);
    let first: f64x4<S> = u8x32::from_slice(simd, bytes).bitcast();
    (first - sum).bitcast::<u8x32<S>>().store_slice(bytes);
    for (offset, f) in [(at[1], f1), (at[2], f2), (at[3], f3)] {
        let bytes = rows.force_mut(offset);
        let row: f64x4<S> = u8x32::from_slice(simd, bytes).bitcast();
        (row + f).bitcast::<u8x32<S>>().store_slice(bytes);
    }
}

/// Eight lanes in two vectors, one after the other.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn add_by_four<L: ElementLaw>(simd: fearless_simd::Avx2, blocks: &[Block], rows: &mut Rows) {
    let zero = f64x4::splat(simd, 0.0);
    for block in blocks {
        for half in [0, 4] {
            let at = &block.offsets;
            let mut edges = [[zero; 4]; 3];
            for lane in 0..4 {
                let at = &at[half + lane];
                let first = row(simd, rows, at[0]);
                for k in 0..3 {
                    edges[k][lane] = row(simd, rows, at[k + 1]) - first;
                }
            }
            let [x0, y0, z0, _] = transposed(simd, edges[0]);
            let [x1, y1, z1, _] = transposed(simd, edges[1]);
            let [x2, y2, z2, _] = transposed(simd, edges[2]);
            let d = [[x0, y0, z0], [x1, y1, z1], [x2, y2, z2]];
            let alpha = &block.alpha_per_m;
            let load = |numbers: &[f64; N_LANES]| f64x4::from_slice(simd, &numbers[half..half + 4]);
            let alpha = [
                [load(&alpha[0][0]), load(&alpha[0][1]), load(&alpha[0][2])],
                [load(&alpha[1][0]), load(&alpha[1][1]), load(&alpha[1][2])],
                [load(&alpha[2][0]), load(&alpha[2][1]), load(&alpha[2][2])],
            ];
            let material = [load(&block.material[0]), load(&block.material[1])];
            let f = corner_forces::<L, _>(&d, &alpha, material);
            let f1 = transposed(simd, [f[0][0], f[0][1], f[0][2], zero]);
            let f2 = transposed(simd, [f[1][0], f[1][1], f[1][2], zero]);
            let f3 = transposed(simd, [f[2][0], f[2][1], f[2][2], zero]);
            for lane in 0..4 {
                let sum = f1[lane] + f2[lane] + f3[lane];
                add_lane(simd, rows, &at[half + lane], [sum, f1[lane], f2[lane], f3[lane]]);
            }
        }
    }
}

/// Rows become columns.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn transposed(
    simd: fearless_simd::Avx2,
    rows: [f64x4<fearless_simd::Avx2>; 4],
) -> [f64x4<fearless_simd::Avx2>; 4] {
    use std::arch::x86_64::{__m256d, _mm256_permute2f128_pd, _mm256_unpackhi_pd, _mm256_unpacklo_pd};
    fearless_simd::kernel!(
        #[inline(always)]
        fn transpose(
            _simd: Avx2,
            a: __m256d,
            b: __m256d,
            c: __m256d,
            d: __m256d,
        ) -> (__m256d, __m256d, __m256d, __m256d) {
            let (ab_even, ab_odd) = (_mm256_unpacklo_pd(a, b), _mm256_unpackhi_pd(a, b));
            let (cd_even, cd_odd) = (_mm256_unpacklo_pd(c, d), _mm256_unpackhi_pd(c, d));
            (
                _mm256_permute2f128_pd::<0x20>(ab_even, cd_even),
                _mm256_permute2f128_pd::<0x20>(ab_odd, cd_odd),
                _mm256_permute2f128_pd::<0x31>(ab_even, cd_even),
                _mm256_permute2f128_pd::<0x31>(ab_odd, cd_odd),
            )
        }
    );
    let [a, b, c, d] = rows;
    let (a, b, c, d) = transpose(simd, a.into(), b.into(), c.into(), d.into());
    [a.simd_into(simd), b.simd_into(simd), c.simd_into(simd), d.simd_into(simd)]
}

/// One lane after the other, without vectors.
#[inline(always)]
fn add_one_by_one<L: ElementLaw>(blocks: &[Block], rows: &mut Rows) {
    for block in blocks {
        for lane in 0..N_LANES {
            let at = &block.offsets[lane];
            let first = numbers(rows.displacement(at[0]));
            let edge = |k: usize| {
                let corner = numbers(rows.displacement(at[k + 1]));
                [corner[0] - first[0], corner[1] - first[1], corner[2] - first[2]]
            };
            let d = [edge(0), edge(1), edge(2)];
            let alpha = &block.alpha_per_m;
            let gradient = |k: usize| [alpha[k][0][lane], alpha[k][1][lane], alpha[k][2][lane]];
            let alpha = [gradient(0), gradient(1), gradient(2)];
            let material = [block.material[0][lane], block.material[1][lane]];
            let [f1, f2, f3] = corner_forces::<L, f64>(&d, &alpha, material);
            let sum = |i: usize| f1[i].plus(f2[i]).plus(f3[i]);
            let balance = [-sum(0), -sum(1), -sum(2)];
            for (offset, f) in [(at[0], balance), (at[1], f1), (at[2], f2), (at[3], f3)] {
                let bytes = rows.force_mut(offset);
                let row = numbers(bytes);
                for i in 0..3 {
                    bytes[8 * i..8 * (i + 1)].copy_from_slice(&(row[i] + f[i]).to_ne_bytes());
                }
            }
        }
    }
}

/// x, y and z of a row.
#[inline(always)]
fn numbers(bytes: &[u8; 32]) -> [f64; 3] {
    let number = |i: usize| f64::from_ne_bytes(bytes[8 * i..8 * (i + 1)].try_into().expect("eight bytes"));
    [number(0), number(1), number(2)]
}
