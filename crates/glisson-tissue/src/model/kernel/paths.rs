//! One loop over a part's tetrahedra for each instruction set, all with the same bits.
//!
//! Lanes of a block are independent until the forces are added, which happens lane after lane, and in each lane corner after
//! corner, on every path. So two lanes may share a node.

#[cfg(target_arch = "x86_64")]
use fearless_simd::{Avx2, Avx512, Level, Simd, f64x4, f64x8, prelude::*, u8x32, u8x64};
#[cfg(target_arch = "wasm32")]
use fearless_simd::{Level, WasmSimd128, f64x2, f64x8, prelude::*, u8x16};

use super::element::{At, corner_forces, displacement_gradient};
use super::extras::Stress;
use super::lane_block::LaneBlockWork;
use super::lanes::Lanes;
#[cfg(any(target_arch = "x86_64", target_arch = "wasm32"))]
use super::rows::LaneNumbers;
use super::rows::{Block, N_LANES, Rows};

/// Work on rows of numbers, written once for any number of lanes.
pub(super) trait LaneWork {
    /// Runs the work; `any` only selects the lanes. Must be inlined.
    fn run<V: Lanes>(self, any: V);
}

/// Work on each instruction set.
trait PathWork {
    /// The result.
    type Output;
    #[cfg(target_arch = "x86_64")]
    fn in_eights(self, simd: Avx512) -> Self::Output;
    #[cfg(target_arch = "x86_64")]
    fn in_fours(self, simd: Avx2) -> Self::Output;
    #[cfg(target_arch = "wasm32")]
    fn in_twos(self, simd: WasmSimd128) -> Self::Output;
    fn one_by_one(self) -> Self::Output;
}

struct InLanes<W>(W);

impl<W: LaneWork> PathWork for InLanes<W> {
    type Output = ();

    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    fn in_eights(self, simd: Avx512) {
        self.0.run(f64x8::splat(simd, 0.0));
    }

    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    fn in_fours(self, simd: Avx2) {
        self.0.run(f64x4::splat(simd, 0.0));
    }

    #[cfg(target_arch = "wasm32")]
    #[inline(always)]
    fn in_twos(self, simd: WasmSimd128) {
        self.0.run(f64x2::splat(simd, 0.0));
    }

    #[inline(always)]
    fn one_by_one(self) {
        self.0.run(0.0_f64);
    }
}

struct ByEight<W>(W);

impl<W: LaneBlockWork> PathWork for ByEight<W> {
    type Output = W::Output;

    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    fn in_eights(self, simd: Avx512) -> W::Output {
        self.0.run(f64x8::splat(simd, 0.0))
    }

    /// LaneBlock numbers in two vectors.
    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    fn in_fours(self, simd: Avx2) -> W::Output {
        self.0.run(f64x8::splat(simd, 0.0))
    }

    /// LaneBlock numbers in four vectors.
    #[cfg(target_arch = "wasm32")]
    #[inline(always)]
    fn in_twos(self, simd: WasmSimd128) -> W::Output {
        self.0.run(f64x8::splat(simd, 0.0))
    }

    #[inline(always)]
    fn one_by_one(self) -> W::Output {
        self.0.run([0.0; 8])
    }
}

/// An instruction set of the kernel. The result is the same on each path.
#[derive(Clone, Copy, Debug)]
pub struct KernelPath(Path);

#[derive(Clone, Copy, Debug)]
enum Path {
    #[cfg(target_arch = "x86_64")]
    Avx512(Avx512),
    #[cfg(target_arch = "x86_64")]
    Avx2(Avx2),
    #[cfg(target_arch = "x86_64")]
    Scalar(Avx2),
    #[cfg(target_arch = "wasm32")]
    Wasm(WasmSimd128),
    Portable,
}

impl KernelPath {
    /// The paths that this processor has, the fastest first; the last one runs everywhere.
    ///
    /// `scalar` computes one tetrahedron at a time with scalar instructions, compiled for the same processor as
    /// `avx2`: what vectors are worth is the ratio to it. `portable` is compiled for every processor; where that does not
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
        #[cfg(target_arch = "wasm32")]
        paths.extend(Level::new().as_wasm_simd128().map(Path::Wasm));
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

    /// `avx512`, `avx2`, `scalar`, `wasm` or `portable`.
    pub fn name(self) -> &'static str {
        match self.0 {
            #[cfg(target_arch = "x86_64")]
            Path::Avx512(_) => "avx512",
            #[cfg(target_arch = "x86_64")]
            Path::Avx2(_) => "avx2",
            #[cfg(target_arch = "x86_64")]
            Path::Scalar(_) => "scalar",
            #[cfg(target_arch = "wasm32")]
            Path::Wasm(_) => "wasm",
            Path::Portable => "portable",
        }
    }

    /// Runs `work` in this path's lanes, compiled for its processor.
    #[inline(always)]
    pub(super) fn run(self, work: impl LaneWork) {
        self.run_in(InLanes(work));
    }

    /// Runs work on eight numbers at a time on this path.
    #[inline]
    pub(in crate::model) fn run_by_eight<W: LaneBlockWork>(self, work: W) -> W::Output {
        self.run_in(ByEight(work))
    }

    /// The only place that dispatches work to the instruction sets.
    #[inline(always)]
    fn run_in<W: PathWork>(self, work: W) -> W::Output {
        match self.0 {
            #[cfg(target_arch = "x86_64")]
            Path::Avx512(simd) => simd.vectorize(
                #[inline(always)]
                || work.in_eights(simd),
            ),
            #[cfg(target_arch = "x86_64")]
            Path::Avx2(simd) => simd.vectorize(
                #[inline(always)]
                || work.in_fours(simd),
            ),
            #[cfg(target_arch = "x86_64")]
            Path::Scalar(simd) => simd.vectorize(
                #[inline(always)]
                || work.one_by_one(),
            ),
            #[cfg(target_arch = "wasm32")]
            Path::Wasm(simd) => work.in_twos(simd),
            Path::Portable => work.one_by_one(),
        }
    }

    /// Runs `work` compiled for this path's processor.
    #[inline(always)]
    pub(super) fn vectorize<R>(self, work: impl FnOnce() -> R) -> R {
        match self.0 {
            #[cfg(target_arch = "x86_64")]
            Path::Avx512(simd) => simd.vectorize(work),
            #[cfg(target_arch = "x86_64")]
            Path::Avx2(simd) | Path::Scalar(simd) => simd.vectorize(work),
            #[cfg(target_arch = "wasm32")]
            Path::Wasm(_) => work(),
            Path::Portable => work(),
        }
    }

    /// Adds the forces of `blocks` at the displacements in `rows` to the forces there.
    pub(super) fn add_forces(self, stress: &mut impl Stress, blocks: &[Block], rows: &mut Rows) {
        self.run_in(AddForces { stress, blocks, rows });
    }
}

struct AddForces<'a, S> {
    stress: &'a mut S,
    blocks: &'a [Block],
    rows: &'a mut Rows,
}

impl<S: Stress> PathWork for AddForces<'_, S> {
    type Output = ();

    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    fn in_eights(self, simd: Avx512) {
        add_by_eight(simd, self.stress, self.blocks, self.rows);
    }

    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    fn in_fours(self, simd: Avx2) {
        add_by_four(simd, self.stress, self.blocks, self.rows);
    }

    #[cfg(target_arch = "wasm32")]
    #[inline(always)]
    fn in_twos(self, simd: WasmSimd128) {
        add_by_two(simd, self.stress, self.blocks, self.rows);
    }

    #[inline(always)]
    fn one_by_one(self) {
        add_one_by_one(self.stress, self.blocks, self.rows);
    }
}

/// LaneBlock lanes in one vector.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn add_by_eight(simd: Avx512, stress: &mut impl Stress, blocks: &[Block], rows: &mut Rows) {
    let Some(first) = blocks.first() else { return };
    let masks = Masks::opaque();
    // A block's displacements are loaded while the forces of the one before are on their way, and those are added
    // after the next one's gradients: no stage waits for the one just before it.
    let mut d = gather(simd, first, rows);
    let mut waiting = [[f64x8::splat(simd, 0.0); 3]; 3];
    let mut their_offsets = &first.offsets;
    for (i, block) in blocks.iter().enumerate() {
        let load = |numbers: &LaneNumbers| f64x8::from_slice(simd, numbers);
        let g = displacement_gradient(&d, &gradients(simd, block));
        scatter(simd, masks, rows, their_offsets, waiting);
        let material = [load(&block.material[0]), load(&block.material[1])];
        let p = stress.scaled_stress(&g, material, At { block: i, lane: 0 });
        // Loaded again: there are too few registers to keep them.
        waiting = corner_forces(&p, &gradients(simd, block));
        their_offsets = &block.offsets;
        d = gather(simd, blocks.get(i + 1).unwrap_or(first), rows);
    }
    scatter(simd, masks, rows, their_offsets, waiting);
}

/// Which numbers an operation leaves alone. The compiler must not know them: it would write the masked
/// operations, which cost nothing more, as whole ones and a shuffle.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy)]
struct Masks {
    /// The upper half.
    upper: u8,
    /// x, y, z of both rows.
    xyz: u8,
}

#[cfg(target_arch = "x86_64")]
impl Masks {
    fn opaque() -> Self {
        Self { upper: std::hint::black_box(0xf0), xyz: std::hint::black_box(0x77) }
    }
}

/// Adds the forces of eight lanes, lane after lane.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn scatter(
    simd: Avx512,
    masks: Masks,
    rows: &mut Rows,
    at: &[[u16; 4]; N_LANES],
    f: [[f64x8<Avx512>; 3]; 3],
) {
    let [a1, b1, c1, d1] = pairs_of_rows(simd, masks, f[0]);
    let [a2, b2, c2, d2] = pairs_of_rows(simd, masks, f[1]);
    let [a3, b3, c3, d3] = pairs_of_rows(simd, masks, f[2]);
    let (even, odd) = ([a1 + a2 + a3, a1, a2, a3], [b1 + b2 + b3, b1, b2, b3]);
    add_lane(simd, rows, &at[0], lower(even));
    add_lane(simd, rows, &at[1], lower(odd));
    add_upper_lane(simd, masks, rows, &at[2], even);
    add_upper_lane(simd, masks, rows, &at[3], odd);
    let (even, odd) = ([c1 + c2 + c3, c1, c2, c3], [d1 + d2 + d3, d1, d2, d3]);
    add_lane(simd, rows, &at[4], lower(even));
    add_lane(simd, rows, &at[5], lower(odd));
    add_upper_lane(simd, masks, rows, &at[6], even);
    add_upper_lane(simd, masks, rows, &at[7], odd);
}

#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn lower([a, b, c, d]: [f64x8<Avx512>; 4]) -> [f64x4<Avx512>; 4] {
    [a.split().0, b.split().0, c.split().0, d.split().0]
}

/// Adds the forces in the upper halves, which is where they lie in a node's pair of rows: nothing moves across.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn add_upper_lane(
    simd: Avx512,
    Masks { upper, .. }: Masks,
    rows: &mut Rows,
    at: &[u16; 4],
    [sum, f1, f2, f3]: [f64x8<Avx512>; 4],
) {
    use std::arch::x86_64::{__m512d, _mm512_mask_add_pd, _mm512_mask_sub_pd};
    fearless_simd::kernel!(
        #[inline(always)]
        fn add(_simd: Avx512, upper: u8, node: __m512d, force: __m512d) -> __m512d {
            _mm512_mask_add_pd(node, upper, node, force)
        }
    );
    fearless_simd::kernel!(
        #[inline(always)]
        fn subtract(_simd: Avx512, upper: u8, node: __m512d, force: __m512d) -> __m512d {
            _mm512_mask_sub_pd(node, upper, node, force)
        }
    );
    let at = four(at);
    let bytes = rows.node_mut(at[0]);
    let first: f64x8<Avx512> = u8x64::from_slice(simd, bytes).bitcast();
    let first: f64x8<Avx512> = subtract(simd, upper, first.into(), sum.into()).simd_into(simd);
    first.bitcast::<u8x64<Avx512>>().store_slice(bytes);
    for (offset, f) in [(at[1], f1), (at[2], f2), (at[3], f3)] {
        let bytes = rows.node_mut(offset);
        let node: f64x8<Avx512> = u8x64::from_slice(simd, bytes).bitcast();
        let node: f64x8<Avx512> = add(simd, upper, node.into(), f.into()).simd_into(simd);
        node.bitcast::<u8x64<Avx512>>().store_slice(bytes);
    }
}

/// alpha_1, alpha_2 and alpha_3 of eight lanes, each x, y, z.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn gradients(simd: Avx512, block: &Block) -> [[f64x8<Avx512>; 3]; 3] {
    let [a, b, c] = &block.alpha_per_m;
    let load = |numbers: &LaneNumbers| f64x8::from_slice(simd, numbers);
    [
        [load(&a[0]), load(&a[1]), load(&a[2])],
        [load(&b[0]), load(&b[1]), load(&b[2])],
        [load(&c[0]), load(&c[1]), load(&c[2])],
    ]
}

/// d_1, d_2 and d_3 of eight lanes, each x, y, z.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn gather(simd: Avx512, block: &Block, rows: &Rows) -> [[f64x8<Avx512>; 3]; 3] {
    let at = &block.offsets;
    let mut edges = [[f64x8::splat(simd, 0.0); 4]; 3];
    for (p, (a, b)) in PAIRS.into_iter().enumerate() {
        let (a, b) = (four(&at[a]), four(&at[b]));
        let first = row(simd, rows, a[0]).combine(row(simd, rows, b[0]));
        for k in 0..3 {
            edges[k][p] = row(simd, rows, a[k + 1]).combine(row(simd, rows, b[k + 1])) - first;
        }
    }
    [columns(simd, edges[0]), columns(simd, edges[1]), columns(simd, edges[2])]
}

/// Lanes whose rows share a vector of eight while they are transposed.
#[cfg(target_arch = "x86_64")]
const PAIRS: [(usize, usize); 4] = [(0, 2), (1, 3), (4, 6), (5, 7)];

/// Offsets of four corners by one load: loads are what these loops have most of.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn four(at: &[u16; 4]) -> [u16; 4] {
    let all: u64 = bytemuck::cast(*at);
    [all as u16, (all >> 16) as u16, (all >> 32) as u16, (all >> 48) as u16]
}

#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn row<S: Simd>(simd: S, rows: &Rows, offset: u16) -> f64x4<S> {
    u8x32::from_slice(simd, rows.displacement(offset)).bitcast()
}

/// x, y and z of eight lanes from the rows of [`PAIRS`].
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn columns(simd: Avx512, pairs: [f64x8<Avx512>; 4]) -> [f64x8<Avx512>; 3] {
    use std::arch::x86_64::{__m512d, _mm512_shuffle_f64x2, _mm512_unpackhi_pd, _mm512_unpacklo_pd};
    fearless_simd::kernel!(
        #[inline(always)]
        fn transpose(
            _simd: Avx512,
            a: __m512d,
            b: __m512d,
            c: __m512d,
            d: __m512d,
        ) -> (__m512d, __m512d, __m512d) {
            let (ab_xz, ab_y) = (_mm512_unpacklo_pd(a, b), _mm512_unpackhi_pd(a, b));
            let (cd_xz, cd_y) = (_mm512_unpacklo_pd(c, d), _mm512_unpackhi_pd(c, d));
            (
                _mm512_shuffle_f64x2::<0b10_00_10_00>(ab_xz, cd_xz),
                _mm512_shuffle_f64x2::<0b10_00_10_00>(ab_y, cd_y),
                _mm512_shuffle_f64x2::<0b11_01_11_01>(ab_xz, cd_xz),
            )
        }
    );
    let [a, b, c, d] = pairs;
    let (x, y, z) = transpose(simd, a.into(), b.into(), c.into(), d.into());
    [x.simd_into(simd), y.simd_into(simd), z.simd_into(simd)]
}

/// The rows of [`PAIRS`] from x, y and z of eight lanes.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn pairs_of_rows(simd: Avx512, masks: Masks, [x, y, z]: [f64x8<Avx512>; 3]) -> [f64x8<Avx512>; 4] {
    use std::arch::x86_64::{
        __m512d, _mm512_maskz_permutex2var_pd, _mm512_setr_epi64, _mm512_unpackhi_pd, _mm512_unpacklo_pd,
    };
    fearless_simd::kernel!(
        #[inline(always)]
        fn transpose(
            _simd: Avx512,
            xyz: u8,
            x: __m512d,
            y: __m512d,
            z: __m512d,
        ) -> (__m512d, __m512d, __m512d, __m512d) {
            // x and y of two lanes, then z of the first from `z`, a zero, and the same for the second.
            let (even, odd) = (_mm512_unpacklo_pd(x, y), _mm512_unpackhi_pd(x, y));
            (
                _mm512_maskz_permutex2var_pd(xyz, even, _mm512_setr_epi64(0, 1, 8, 0, 2, 3, 10, 0), z),
                _mm512_maskz_permutex2var_pd(xyz, odd, _mm512_setr_epi64(0, 1, 9, 0, 2, 3, 11, 0), z),
                _mm512_maskz_permutex2var_pd(xyz, even, _mm512_setr_epi64(4, 5, 12, 0, 6, 7, 14, 0), z),
                _mm512_maskz_permutex2var_pd(xyz, odd, _mm512_setr_epi64(4, 5, 13, 0, 6, 7, 15, 0), z),
            )
        }
    );
    let (a, b, c, d) = transpose(simd, masks.xyz, x.into(), y.into(), z.into());
    [a.simd_into(simd), b.simd_into(simd), c.simd_into(simd), d.simd_into(simd)]
}

/// Adds a tetrahedron's forces: the first is the sum that its first corner balances.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn add_lane<S: Simd>(simd: S, rows: &mut Rows, at: &[u16; 4], [sum, f1, f2, f3]: [f64x4<S>; 4]) {
    let at = four(at);
    let bytes = rows.force_mut(at[0]);
    let first: f64x4<S> = u8x32::from_slice(simd, bytes).bitcast();
    (first - sum).bitcast::<u8x32<S>>().store_slice(bytes);
    for (offset, f) in [(at[1], f1), (at[2], f2), (at[3], f3)] {
        let bytes = rows.force_mut(offset);
        let row: f64x4<S> = u8x32::from_slice(simd, bytes).bitcast();
        (row + f).bitcast::<u8x32<S>>().store_slice(bytes);
    }
}

/// LaneBlock lanes in two vectors, one after the other.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn add_by_four(simd: Avx2, stress: &mut impl Stress, blocks: &[Block], rows: &mut Rows) {
    let zero = f64x4::splat(simd, 0.0);
    for (i, block) in blocks.iter().enumerate() {
        for half in [0, 4] {
            let at = &block.offsets;
            let mut edges = [[zero; 4]; 3];
            for lane in 0..4 {
                let at = four(&at[half + lane]);
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
            let load = |numbers: &LaneNumbers| f64x4::from_slice(simd, &numbers[half..half + 4]);
            let alpha = [
                [load(&alpha[0][0]), load(&alpha[0][1]), load(&alpha[0][2])],
                [load(&alpha[1][0]), load(&alpha[1][1]), load(&alpha[1][2])],
                [load(&alpha[2][0]), load(&alpha[2][1]), load(&alpha[2][2])],
            ];
            let material = [load(&block.material[0]), load(&block.material[1])];
            let g = displacement_gradient(&d, &alpha);
            let f = corner_forces(&stress.scaled_stress(&g, material, At { block: i, lane: half }), &alpha);
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
fn transposed(simd: Avx2, rows: [f64x4<Avx2>; 4]) -> [f64x4<Avx2>; 4] {
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

/// Two lanes in a vector.
#[cfg(target_arch = "wasm32")]
#[inline(always)]
fn add_by_two(simd: WasmSimd128, stress: &mut impl Stress, blocks: &[Block], rows: &mut Rows) {
    let zero = f64x2::splat(simd, 0.0);
    // x and y, then z and a zero.
    let halves = |bytes: &[u8; 32]| -> [f64x2<WasmSimd128>; 2] {
        [0, 16].map(|at| u8x16::from_slice(simd, &bytes[at..at + 16]).bitcast())
    };
    for (i, block) in blocks.iter().enumerate() {
        for lane in (0..N_LANES).step_by(2) {
            let at = [&block.offsets[lane], &block.offsets[lane + 1]];
            let corner = |k: usize| {
                let [[xy, z], [xy1, z1]] = at.map(|at| halves(rows.displacement(at[k])));
                [xy.zip_low(xy1), xy.zip_high(xy1), z.zip_low(z1)]
            };
            let first = corner(0);
            let edge = |k: usize| {
                let corner = corner(k + 1);
                [corner[0] - first[0], corner[1] - first[1], corner[2] - first[2]]
            };
            let d = [edge(0), edge(1), edge(2)];
            let alpha = &block.alpha_per_m;
            let load = |numbers: &LaneNumbers| f64x2::from_slice(simd, &numbers[lane..lane + 2]);
            let gradient = |k: usize| [load(&alpha[k][0]), load(&alpha[k][1]), load(&alpha[k][2])];
            let alpha = [gradient(0), gradient(1), gradient(2)];
            let material = [load(&block.material[0]), load(&block.material[1])];
            let g = displacement_gradient(&d, &alpha);
            let [f1, f2, f3] =
                corner_forces(&stress.scaled_stress(&g, material, At { block: i, lane }), &alpha);
            let sum = |axis: usize| f1[axis] + f2[axis] + f3[axis];
            let corners = [[-sum(0), -sum(1), -sum(2)], f1, f2, f3];
            // Lane after lane, for two may share a node.
            for (in_lane, at) in at.into_iter().enumerate() {
                for (offset, [x, y, z]) in at.iter().zip(corners) {
                    let xy = if in_lane == 0 { x.zip_low(y) } else { x.zip_high(y) };
                    let z = if in_lane == 0 { z.zip_low(zero) } else { z.zip_high(zero) };
                    let bytes = rows.force_mut(*offset);
                    let [old_xy, old_z] = halves(bytes);
                    (old_xy + xy).bitcast::<u8x16<WasmSimd128>>().store_slice(&mut bytes[..16]);
                    (old_z + z).bitcast::<u8x16<WasmSimd128>>().store_slice(&mut bytes[16..]);
                }
            }
        }
    }
}

/// One lane after the other, without vectors: on `scalar`, where it serves to compare, its instructions are scalar ones,
/// as many as its formula has operations.
#[inline(always)]
fn add_one_by_one(stress: &mut impl Stress, blocks: &[Block], rows: &mut Rows) {
    for (i, block) in blocks.iter().enumerate() {
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
            let g = displacement_gradient(&d, &alpha);
            let p = stress.scaled_stress(&g, material, At { block: i, lane });
            let [f1, f2, f3] = corner_forces(&p, &alpha);
            let sum = |i: usize| f1[i].plus(f2[i]).plus(f3[i]);
            let corners = [[-sum(0), -sum(1), -sum(2)], f1, f2, f3];
            // Axis after axis. Corner after corner, the compiler would pack x and y of a row into a vector of two; for all
            // that it knows, corners share rows, and it keeps this order.
            for i in 0..3 {
                for (offset, f) in at.iter().zip(&corners) {
                    let number = &mut rows.force_mut(*offset)[8 * i..8 * (i + 1)];
                    let sum = f64::from_ne_bytes((&*number).try_into().expect("eight bytes")) + f[i];
                    number.copy_from_slice(&sum.to_ne_bytes());
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
