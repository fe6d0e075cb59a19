//! The arithmetic that all paths share: numbers of one or several lanes.
//!
//! Every multiplication followed by an addition is written as one fused operation, so that a lane gives the
//! same bits whether it is a `f64` or a part of a vector, and whether the processor fuses in hardware or not.

use fearless_simd::{Simd, f64x4, f64x8, prelude::*};

/// Numbers computed side by side; lanes never mix.
pub(super) trait Lanes: Copy {
    /// Sum.
    fn plus(self, other: Self) -> Self;
    /// Product.
    fn times(self, other: Self) -> Self;
    /// `self * factor + term`, rounded once.
    fn fused(self, factor: Self, term: Self) -> Self;
}

impl Lanes for f64 {
    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        self + other
    }
    #[inline(always)]
    fn times(self, other: Self) -> Self {
        self * other
    }
    #[inline(always)]
    fn fused(self, factor: Self, term: Self) -> Self {
        self.mul_add(factor, term)
    }
}

macro_rules! vector_lanes {
    ($vector:ident) => {
        impl<S: Simd> Lanes for $vector<S> {
            #[inline(always)]
            fn plus(self, other: Self) -> Self {
                self + other
            }
            #[inline(always)]
            fn times(self, other: Self) -> Self {
                self * other
            }
            #[inline(always)]
            fn fused(self, factor: Self, term: Self) -> Self {
                self.mul_add_precise(factor, term)
            }
        }
    };
}

vector_lanes!(f64x4);
vector_lanes!(f64x8);
