//! Vectors of eight places at a time.

use fearless_simd::{Simd, f64x8, prelude::*};

pub(super) const LANES: usize = 8;
/// Groups of eight that are gathered before the first is computed with: what was just written in small pieces is not
/// ready to be read as a whole.
pub(super) const GROUPS: usize = 8;

/// x, y and z of eight, as they are gathered.
pub(super) type EightVectors = [[f64; LANES]; 3];

/// x, y and z of eight.
pub(super) type Vector<S> = [f64x8<S>; 3];

#[inline(always)]
pub(super) fn load<S: Simd>(simd: S, x: &EightVectors) -> Vector<S> {
    [f64x8::from_slice(simd, &x[0]), f64x8::from_slice(simd, &x[1]), f64x8::from_slice(simd, &x[2])]
}

#[inline(always)]
pub(super) fn store<S: Simd>(x: Vector<S>, to: &mut EightVectors) {
    x[0].store_slice(&mut to[0]);
    x[1].store_slice(&mut to[1]);
    x[2].store_slice(&mut to[2]);
}

#[inline(always)]
pub(super) fn minus<S: Simd>(a: Vector<S>, b: Vector<S>) -> Vector<S> {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
pub(super) fn dot<S: Simd>(a: Vector<S>, b: Vector<S>) -> f64x8<S> {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
pub(super) fn cross<S: Simd>(a: Vector<S>, b: Vector<S>) -> Vector<S> {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
