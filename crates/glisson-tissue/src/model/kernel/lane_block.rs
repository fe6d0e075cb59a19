//! Arithmetic on eight numbers at once, with the same bits on every path: for loops over rows outside the kernel.
//!
//! As in `lanes`, a multiplication followed by an addition is one fused operation, rounded once. Sums over the lanes have a
//! fixed order.

#[cfg(any(target_arch = "x86_64", target_arch = "wasm32"))]
use fearless_simd::{Simd, f64x8, prelude::*};
use glisson_mesh::math::fused;

/// LaneBlock numbers; lanes mix only in [`LaneBlock::sum`].
pub(in crate::model) trait LaneBlock: Copy {
    /// `value` in every lane; `self` says only on which path.
    fn constant(self, value: f64) -> Self;
    /// The lanes of `numbers`.
    fn load(self, numbers: &[f64; 8]) -> Self;
    /// Overwrites `numbers`.
    fn store(self, numbers: &mut [f64; 8]);
    /// Product.
    fn times(self, other: Self) -> Self;
    /// `self * factor + term`, rounded once.
    fn fused(self, factor: Self, term: Self) -> Self;

    /// The lanes of `numbers`, which are exact in twice the width.
    #[inline(always)]
    fn load_narrow(self, numbers: &[f32; 8]) -> Self {
        self.load(&numbers.map(f64::from))
    }

    /// Sum of the lanes: halves, quarters, pairs.
    #[inline(always)]
    fn sum(self) -> f64 {
        let mut n = [0.0; 8];
        self.store(&mut n);
        ((n[0] + n[4]) + (n[2] + n[6])) + ((n[1] + n[5]) + (n[3] + n[7]))
    }
}

impl LaneBlock for [f64; 8] {
    #[inline(always)]
    fn constant(self, value: f64) -> Self {
        [value; 8]
    }
    #[inline(always)]
    fn load(self, numbers: &[f64; 8]) -> Self {
        *numbers
    }
    #[inline(always)]
    fn store(self, numbers: &mut [f64; 8]) {
        *numbers = self;
    }
    #[inline(always)]
    fn times(self, other: Self) -> Self {
        std::array::from_fn(|i| self[i] * other[i])
    }
    #[inline(always)]
    fn fused(self, factor: Self, term: Self) -> Self {
        std::array::from_fn(|i| fused(self[i], factor[i], term[i]))
    }
}

#[cfg(any(target_arch = "x86_64", target_arch = "wasm32"))]
impl<S: Simd> LaneBlock for f64x8<S> {
    #[inline(always)]
    fn constant(self, value: f64) -> Self {
        Self::splat(self.simd, value)
    }
    #[inline(always)]
    fn load(self, numbers: &[f64; 8]) -> Self {
        Self::from_slice(self.simd, numbers)
    }
    #[inline(always)]
    fn store(self, numbers: &mut [f64; 8]) {
        self.store_slice(numbers);
    }
    #[inline(always)]
    fn times(self, other: Self) -> Self {
        self * other
    }
    #[inline(always)]
    fn fused(self, factor: Self, term: Self) -> Self {
        #[cfg(target_arch = "wasm32")]
        return self.mul_add(factor, term);
        #[cfg(not(target_arch = "wasm32"))]
        self.mul_add_precise(factor, term)
    }
}

/// Work that is written once for all paths.
pub(in crate::model) trait LaneBlockWork {
    /// The result.
    type Output;
    /// Runs the work; `zero` is eight zeros of the path. Must always be inlined.
    fn run<V: LaneBlock>(self, zero: V) -> Self::Output;
}
