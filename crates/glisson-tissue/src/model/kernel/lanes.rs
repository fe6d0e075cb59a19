//! The arithmetic of all paths: numbers of one or several lanes.
//!
//! Every multiplication followed by an addition is written as one fused operation, so that a lane gives the
//! same bits whether it is a `f64` or a part of a vector, and whether the processor fuses in hardware or not.
//! Sums, products, quotients and fused operations are rounded as IEEE 754 says, on every path; but for browsers without that
//! operation, whose class of [`Arithmetic`](glisson_mesh::math::Arithmetic) rounds product and sum.

#[cfg(target_arch = "wasm32")]
use fearless_simd::f64x2;
use fearless_simd::{Simd, prelude::*};
#[cfg(not(target_arch = "wasm32"))]
use fearless_simd::{f64x4, f64x8};

use super::rows::{LaneNumbers, N_LANES};
use glisson_mesh::math::fused;

/// Numbers in lanes, which never mix.
pub(super) trait Lanes: Copy {
    /// Number of lanes.
    const COUNT: usize;
    /// `value` in every lane.
    fn constant(self, value: f64) -> Self;
    /// Sum.
    fn plus(self, other: Self) -> Self;
    /// Difference.
    fn minus(self, other: Self) -> Self;
    /// Negation.
    fn negative(self) -> Self;
    /// Product.
    fn times(self, other: Self) -> Self;
    /// Quotient.
    fn over(self, other: Self) -> Self;
    /// Absolute value.
    fn magnitude(self) -> Self;
    /// `self * factor + term`, rounded once.
    fn fused(self, factor: Self, term: Self) -> Self;
    /// `self` in the lanes whose bit is set, `otherwise` elsewhere.
    fn chosen(self, bits: u32, otherwise: Self) -> Self;
    /// One bit per lane, the first lane's lowest: whether `self > limit`.
    fn above_bits(self, limit: Self) -> u32;
    /// The lanes of `numbers` from `first` on; `self` says only how many and on which path.
    fn load(self, numbers: &LaneNumbers, first: usize) -> Self;
    /// Overwrites the lanes of `numbers` from `first` on.
    fn store(self, numbers: &mut LaneNumbers, first: usize);
}

impl Lanes for f64 {
    const COUNT: usize = 1;
    #[inline(always)]
    fn constant(self, value: f64) -> Self {
        value
    }
    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        self + other
    }
    #[inline(always)]
    fn minus(self, other: Self) -> Self {
        self - other
    }
    #[inline(always)]
    fn negative(self) -> Self {
        -self
    }
    #[inline(always)]
    fn times(self, other: Self) -> Self {
        self * other
    }
    #[inline(always)]
    fn over(self, other: Self) -> Self {
        self / other
    }
    #[inline(always)]
    fn magnitude(self) -> Self {
        self.abs()
    }
    #[inline(always)]
    fn fused(self, factor: Self, term: Self) -> Self {
        fused(self, factor, term)
    }
    #[inline(always)]
    fn chosen(self, bits: u32, otherwise: Self) -> Self {
        if bits & 1 != 0 { self } else { otherwise }
    }
    #[inline(always)]
    fn above_bits(self, limit: Self) -> u32 {
        u32::from(self > limit)
    }
    #[inline(always)]
    fn load(self, numbers: &LaneNumbers, first: usize) -> Self {
        numbers[first]
    }
    #[inline(always)]
    fn store(self, numbers: &mut LaneNumbers, first: usize) {
        numbers[first] = self;
    }
}

macro_rules! vector_lanes {
    ($vector:ident, $count:literal, $fused:ident) => {
        impl<S: Simd> Lanes for $vector<S> {
            const COUNT: usize = $count;
            #[inline(always)]
            fn constant(self, value: f64) -> Self {
                Self::splat(self.simd, value)
            }
            #[inline(always)]
            fn plus(self, other: Self) -> Self {
                self + other
            }
            #[inline(always)]
            fn minus(self, other: Self) -> Self {
                self - other
            }
            #[inline(always)]
            fn negative(self) -> Self {
                -self
            }
            #[inline(always)]
            fn times(self, other: Self) -> Self {
                self * other
            }
            #[inline(always)]
            fn over(self, other: Self) -> Self {
                self / other
            }
            #[inline(always)]
            fn magnitude(self) -> Self {
                self.abs()
            }
            #[inline(always)]
            fn fused(self, factor: Self, term: Self) -> Self {
                self.$fused(factor, term)
            }
            #[inline(always)]
            fn chosen(self, bits: u32, otherwise: Self) -> Self {
                <Self as SimdBase<S>>::Mask::from_bitmask(self.simd, u64::from(bits)).select(self, otherwise)
            }
            #[inline(always)]
            fn above_bits(self, limit: Self) -> u32 {
                self.simd_gt(limit).to_bitmask() as u32
            }
            #[inline(always)]
            fn load(self, numbers: &LaneNumbers, first: usize) -> Self {
                Self::from_slice(self.simd, &numbers[first..first + $count])
            }
            #[inline(always)]
            fn store(self, numbers: &mut LaneNumbers, first: usize) {
                self.store_slice(&mut numbers[first..first + $count]);
            }
        }
    };
}

// In WebAssembly's class.
#[cfg(target_arch = "wasm32")]
vector_lanes!(f64x2, 2, mul_add);
#[cfg(not(target_arch = "wasm32"))]
vector_lanes!(f64x4, 4, mul_add_precise);
#[cfg(not(target_arch = "wasm32"))]
vector_lanes!(f64x8, 8, mul_add_precise);

/// 1/3, 1/5, ..., 1/23: the coefficients of atanh(s)/s - 1 in powers of s^2.
const ATANH: [f64; 11] = [
    1.0 / 3.0,
    1.0 / 5.0,
    1.0 / 7.0,
    1.0 / 9.0,
    1.0 / 11.0,
    1.0 / 13.0,
    1.0 / 15.0,
    1.0 / 17.0,
    1.0 / 19.0,
    1.0 / 21.0,
    1.0 / 23.0,
];
/// The series serves 1 + x from 0.707 to 1.414: |x - centre| below the reach.
const SERIES_CENTRE: f64 = 0.0605;
const SERIES_REACH: f64 = 0.3535;

/// ln(1 + x). NaN below x = -1.
///
/// With s = x/(2 + x), ln(1 + x) = 2 atanh(s) = x - s (x - r), r = 2 s^2 (1/3 + s^2/5 + ...). From 0.707 to 1.414
/// s^2 is at most 0.0295, so that the first term left out, s^22/25, is below 6e-19. Lanes beyond take `libm`'s
/// `log1p`: the value of a lane depends on that lane alone.
#[inline(always)]
pub(super) fn log_of_one_plus<V: Lanes>(x: V) -> V {
    let s = x.over(x.plus(x.constant(2.0)));
    let square = s.times(s);
    let mut series = x.constant(ATANH[ATANH.len() - 1]);
    for coefficient in ATANH.iter().rev().skip(1) {
        series = series.fused(square, x.constant(*coefficient));
    }
    let r = square.plus(square).times(series);
    let near = s.fused(r.minus(x), x);
    let away = x.minus(x.constant(SERIES_CENTRE)).magnitude();
    let inside = x.constant(SERIES_REACH).above_bits(away);
    if inside == (1 << V::COUNT) - 1 { near } else { with_far_logarithms(x, near, inside) }
}

#[cold]
#[inline(never)]
fn far_logarithms(x: &[f64], near: &mut [f64], inside: u32) {
    for (lane, (log, x)) in near.iter_mut().zip(x).enumerate() {
        if inside >> lane & 1 == 0 {
            *log = libm::log1p(*x);
        }
    }
}

#[inline(always)]
fn with_far_logarithms<V: Lanes>(x: V, near: V, inside: u32) -> V {
    let (mut numbers, mut logs) = ([0.0; N_LANES], [0.0; N_LANES]);
    x.store(&mut numbers, 0);
    near.store(&mut logs, 0);
    far_logarithms(&numbers[..V::COUNT], &mut logs[..V::COUNT], inside);
    near.load(&logs, 0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use fearless_simd::Level;

    fn close(found: f64, expected: f64) -> bool {
        let off = (found - expected).abs();
        found == expected || off <= 1e-15 * expected.abs() || (found.is_nan() && expected.is_nan())
    }

    #[test]
    fn the_logarithm_is_that_of_libm_on_every_number_of_lanes() {
        let near = (-3000..=4200).map(|i| f64::from(i) * 1e-4 + 1e-9);
        let tiny = (0..300).map(|e| libm::exp2(-f64::from(e)) * 0.7);
        let beyond =
            [-2.0, -1.0, -0.999_999, -0.9, -0.6, -0.5, -0.293, 0.414, 0.5, 0.8, 3.0, 1e3, 1e300, f64::NAN];
        let mut numbers: Vec<f64> = near.chain(tiny.clone()).chain(tiny.map(|x| -x)).chain(beyond).collect();
        numbers.resize(numbers.len().next_multiple_of(N_LANES), 0.0);
        for eight in numbers.as_chunks::<N_LANES>().0 {
            let one_by_one = eight.map(log_of_one_plus);
            for (&x, &log) in eight.iter().zip(&one_by_one) {
                assert!(close(log, libm::log1p(x)), "ln(1 + {x:e}) = {log:e}, libm {:e}", libm::log1p(x));
            }
            let bits = one_by_one.map(f64::to_bits);
            #[cfg(target_arch = "x86_64")]
            {
                let level = Level::new();
                if let Some(simd) = level.as_avx2() {
                    let logs: Vec<u64> = eight
                        .chunks(4)
                        .flat_map(|x| log_of_one_plus(f64x4::from_slice(simd, x)).to_array())
                        .map(f64::to_bits)
                        .collect();
                    assert!(same_or_nan(&logs, &bits));
                }
                if let Some(simd) = level.as_avx512() {
                    let logs = log_of_one_plus(f64x8::from_slice(simd, eight)).to_array().map(f64::to_bits);
                    assert!(same_or_nan(&logs, &bits));
                }
            }
        }
        assert_eq!(log_of_one_plus(0.0_f64).to_bits(), 0);
    }

    fn same_or_nan(found: &[u64], expected: &[u64]) -> bool {
        let nan = |bits: u64| f64::from_bits(bits).is_nan();
        found.iter().zip(expected).all(|(&f, &e)| f == e || (nan(f) && nan(e)))
    }
}
