//! LaneBlock pairs of triangles at a time: which of them certainly do not meet.
//!
//! The same tests, with the same bounds, that [`super::triangles::triangles_meet`] begins with: the plane of one triangle has the
//! other one on one side, or the pieces of the planes' line in both are apart. Nearly all pairs that do not meet end
//! there. What is left goes to `triangles_meet`.

use super::lanes::{EightVectors, GROUPS, LANES, Vector, cross, dot, load, minus};
use super::triangles::{ROUNDING_OF_DETERMINANTS, SURE, UNSURE_SHARE};
use crate::math::DVec3;
use fearless_simd::{Level, Simd, dispatch, f64x8, mask64x8, prelude::*};

/// The six corners of eight pairs, x, y and z of each.
type EightPairs = [EightVectors; 6];

/// Moves those of `pairs` that may meet to the front, in their order, and answers how many they are.
pub(super) fn keep_unparted(
    level: Level,
    pairs: &mut [[u32; 2]],
    positions_m: &[DVec3],
    triangles: &[[u32; 3]],
) -> usize {
    dispatch!(level, simd => keep(simd, pairs, positions_m, triangles))
}

#[inline(always)]
fn keep<S: Simd>(simd: S, pairs: &mut [[u32; 2]], positions_m: &[DVec3], triangles: &[[u32; 3]]) -> usize {
    let mut lanes: [EightPairs; GROUPS] = [[[[0.0; LANES]; 3]; 6]; GROUPS];
    let mut n_kept = 0;
    let mut first = 0;
    while first < pairs.len() {
        let n = (pairs.len() - first).min(LANES * GROUPS);
        for (i, pair) in pairs[first..first + n].iter().enumerate() {
            let group = &mut lanes[i / LANES];
            for (side, t) in pair.iter().enumerate() {
                for (corner, v) in triangles[*t as usize].iter().enumerate() {
                    let p = positions_m[*v as usize];
                    let place = &mut group[3 * side + corner];
                    place[0][i % LANES] = p.x;
                    place[1][i % LANES] = p.y;
                    place[2][i % LANES] = p.z;
                }
            }
        }
        for (g, group) in lanes.iter().enumerate().take(n.div_ceil(LANES)) {
            let mut may_meet = !parted(simd, group);
            let n_here = (n - g * LANES).min(LANES);
            may_meet &= (1 << n_here) - 1;
            while may_meet != 0 {
                let lane = may_meet.trailing_zeros() as usize;
                may_meet &= may_meet - 1;
                pairs[n_kept] = pairs[first + g * LANES + lane];
                n_kept += 1;
            }
        }
        first += n;
    }
    n_kept
}

/// Bits of the lanes in which all three are above the bound, or all below it on the other side.
#[inline(always)]
fn on_one_side<S: Simd>([x, y, z]: Vector<S>, bound: f64x8<S>) -> mask64x8<S> {
    let above = x.min(y).min(z).simd_gt(bound);
    let below = x.max(y).max(z).simd_lt(-bound);
    above | below
}

/// The piece of a line in a triangle, as in `triangles::piece_of_line`.
struct Piece<S: Simd> {
    low: f64x8<S>,
    high: f64x8<S>,
    is_sure: mask64x8<S>,
}

/// `above` are the corners' distances from the other plane times a factor, `along` their places along the line.
#[inline(always)]
fn piece_of_line<S: Simd>(simd: S, above: Vector<S>, along: Vector<S>, bound: f64x8<S>) -> Piece<S> {
    let zero = f64x8::splat(simd, 0.0);
    let least = above[0].abs().min(above[1].abs()).min(above[2].abs());
    let sides = [above[0].simd_gt(zero), above[1].simd_gt(zero), above[2].simd_gt(zero)];
    let first_is_lone = !(sides[1] ^ sides[2]);
    let second_is_lone = !(sides[0] ^ sides[2]);
    let (lone, from) = (
        first_is_lone.select(above[0], second_is_lone.select(above[1], above[2])),
        first_is_lone.select(along[0], second_is_lone.select(along[1], along[2])),
    );
    let (next, to_next) = (
        first_is_lone.select(above[1], second_is_lone.select(above[2], above[0])),
        first_is_lone.select(along[1], second_is_lone.select(along[2], along[0])),
    );
    let (last, to_last) = (
        first_is_lone.select(above[2], second_is_lone.select(above[0], above[1])),
        first_is_lone.select(along[2], second_is_lone.select(along[0], along[1])),
    );
    let (height, other_height) = (lone - next, lone - last);
    let x = from + (to_next - from) * (lone / height);
    let y = from + (to_last - from) * (lone / other_height);
    let is_sure = least.simd_gt(bound) & (height.abs().min(other_height.abs()) * SURE).simd_gt(bound);
    Piece { low: x.min(y), high: x.max(y), is_sure }
}

/// Bits of the pairs that are parted.
#[inline(always)]
fn parted<S: Simd>(simd: S, pairs: &EightPairs) -> u64 {
    let origin = load(simd, &pairs[0]);
    let a1 = minus(load(simd, &pairs[1]), origin);
    let a2 = minus(load(simd, &pairs[2]), origin);
    let b0 = minus(load(simd, &pairs[3]), origin);
    let b1 = minus(load(simd, &pairs[4]), origin);
    let b2 = minus(load(simd, &pairs[5]), origin);
    let mut extent = [b0[0].abs(), b0[1].abs(), b0[2].abs()];
    for axis in 0..3 {
        let of_a = a1[axis].abs().max(a2[axis].abs());
        extent[axis] = extent[axis].max(of_a).max(b1[axis].abs()).max(b2[axis].abs());
    }
    let size = extent[0].max(extent[1]).max(extent[2]);
    let bound = size * size * size * ROUNDING_OF_DETERMINANTS;
    let normal_a = cross(a1, a2);
    let b_above_a = [dot(normal_a, b0), dot(normal_a, b1), dot(normal_a, b2)];
    let normal_b = cross(minus(b1, b0), minus(b2, b0));
    let a_above_b = [-dot(normal_b, b0), dot(normal_b, minus(a1, b0)), dot(normal_b, minus(a2, b0))];
    let by_planes = on_one_side(b_above_a, bound) | on_one_side(a_above_b, bound);
    let line = cross(normal_a, normal_b);
    let least_square = dot(normal_a, normal_a) * dot(normal_b, normal_b) * (SURE * SURE);
    let zero = f64x8::splat(simd, 0.0);
    let of_a = piece_of_line(simd, a_above_b, [zero, dot(line, a1), dot(line, a2)], bound);
    let of_b = piece_of_line(simd, b_above_a, [dot(line, b0), dot(line, b1), dot(line, b2)], bound);
    let common = of_a.high.min(of_b.high) - of_a.low.max(of_b.low);
    let reach = line[0].abs() * extent[0] + line[1].abs() * extent[1] + line[2].abs() * extent[2];
    let is_sure = of_a.is_sure & of_b.is_sure & dot(line, line).simd_gt(least_square);
    let on_the_line = is_sure & common.simd_lt(reach * (-UNSURE_SHARE));
    (by_planes | on_the_line).to_bitmask()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contact::triangles::triangles_meet;
    use crate::math::SeededRandom;

    /// Pairs in which every corner of one is its own.
    fn kept(corners_m: &[[DVec3; 6]]) -> Vec<usize> {
        let positions_m: Vec<DVec3> = corners_m.iter().flatten().copied().collect();
        let n = corners_m.len() as u32;
        let triangles: Vec<[u32; 3]> = (0..2 * n).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        let mut pairs: Vec<[u32; 2]> = (0..n).map(|i| [2 * i, 2 * i + 1]).collect();
        let n_kept = keep_unparted(Level::new(), &mut pairs, &positions_m, &triangles);
        pairs[..n_kept].iter().map(|pair| pair[0] as usize / 2).collect()
    }

    #[test]
    fn pairs_that_meet_are_kept_in_their_order_and_hardly_any_others() {
        let mut random = SeededRandom::new(3);
        // 0: anywhere; 1: of very different sizes; 2: on a coarse lattice, where they touch, lie in one plane or have no area;
        // 3: far from the origin.
        for kind in 0..4 {
            let cases: Vec<[DVec3; 6]> = (0..3001)
                .map(|_| {
                    let size = if kind == 1 { libm::exp2(60.0 * random.uniform() - 30.0) } else { 1.0 };
                    let far_m = if kind == 3 { 1e4 } else { 0.0 };
                    std::array::from_fn(|_| {
                        let p = DVec3::new(random.normal(), random.normal(), random.normal()) * size;
                        if kind == 2 { p.round() } else { p + far_m }
                    })
                })
                .collect();
            let kept = kept(&cases);
            let n_meeting = (0..cases.len())
                .filter(|&i| {
                    let [a, b, c, d, e, f] = cases[i];
                    let meets = triangles_meet([a, b, c], [d, e, f]);
                    assert!(!meets || kept.binary_search(&i).is_ok(), "kind {kind}: {:?}", cases[i]);
                    meets
                })
                .count();
            assert!(kept.is_sorted() && n_meeting > 500, "{n_meeting}");
            assert!(kind == 2 || kept.len() <= n_meeting + 10, "kind {kind}: {} of {n_meeting}", kept.len());
        }
    }

    #[test]
    fn a_pair_with_a_broken_corner_may_be_kept_and_spoils_no_other() {
        let cross = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::splat(-0.1), DVec3::Z, DVec3::splat(0.3)];
        for bad in [f64::NAN, f64::INFINITY, 1e300] {
            let mut cases = [cross; 19];
            cases[4][2].y = bad;
            let kept = kept(&cases);
            assert!((0..19).all(|i| i == 4 || kept.contains(&i)), "{bad}: {kept:?}");
        }
    }
}
