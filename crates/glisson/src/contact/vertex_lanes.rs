//! LaneBlock vertices and triangles at a time: the place of each triangle that is nearest to the vertex.
//!
//! The same operations in the same order as [`super::triangles::closest_weights`], so that the bits are the same; where that
//! one jumps, this one selects. Triangles that are slivers go there.

use super::lanes::{EightVectors, GROUPS, LANES, cross, dot, load, minus, store};
use super::triangles::{SLIVER, at_weights, closest_weights};
use crate::math::DVec3;
use fearless_simd::{Level, Simd, dispatch, f64x8, prelude::*};

/// So many vertices and triangles fit in [`NearestPlaces`].
pub(super) const BLOCK: usize = LANES * GROUPS;

#[derive(Clone, Copy)]
struct LaneBlock {
    /// The vertex, then the triangle's corners [m].
    points_m: [EightVectors; 4],
    weights: EightVectors,
    offset_m: EightVectors,
    distance_m: [f64; LANES],
}

/// The nearest places of up to [`BLOCK`] triangles.
pub(super) struct NearestPlaces {
    groups: [LaneBlock; GROUPS],
}

/// A place of a triangle.
#[derive(Clone, Copy, Debug)]
pub(super) struct NearestPlace {
    /// Barycentric weights.
    pub(super) weights: [f64; 3],
    /// From there to the vertex [m].
    pub(super) offset_m: DVec3,
    /// Length of it [m].
    pub(super) distance_m: f64,
}

impl NearestPlaces {
    /// Room for them.
    pub(super) fn new() -> Self {
        let zero = [[0.0; LANES]; 3];
        let nothing =
            LaneBlock { points_m: [zero; 4], weights: zero, offset_m: zero, distance_m: [0.0; LANES] };
        Self { groups: [nothing; GROUPS] }
    }

    /// Finds the place for each of `pairs`, a vertex and a triangle: at most [`BLOCK`].
    pub(super) fn find(
        &mut self,
        level: Level,
        pairs: &[[u32; 2]],
        positions_m: &[DVec3],
        triangles: &[[u32; 3]],
    ) {
        for (i, &[vertex, t]) in pairs.iter().enumerate() {
            let group = &mut self.groups[i / LANES];
            let [a, b, c] = triangles[t as usize];
            for (place, v) in group.points_m.iter_mut().zip([vertex, a, b, c]) {
                let p = positions_m[v as usize];
                place[0][i % LANES] = p.x;
                place[1][i % LANES] = p.y;
                place[2][i % LANES] = p.z;
            }
        }
        let used = &mut self.groups[..pairs.len().div_ceil(LANES)];
        dispatch!(level, simd => find_all(simd, used, pairs.len()));
    }

    /// Distance from the nearest place to vertex `i` of the last call [m].
    #[inline]
    pub(super) fn distance_m(&self, i: usize) -> f64 {
        self.groups[i / LANES].distance_m[i % LANES]
    }

    /// The place for pair `i` of the last call.
    pub(super) fn get(&self, i: usize) -> NearestPlace {
        let group = &self.groups[i / LANES];
        NearestPlace {
            weights: group.weights.map(|x| x[i % LANES]),
            offset_m: DVec3::from_array(group.offset_m.map(|x| x[i % LANES])),
            distance_m: group.distance_m[i % LANES],
        }
    }
}

#[inline(always)]
fn find_all<S: Simd>(simd: S, groups: &mut [LaneBlock], n: usize) {
    for (g, group) in groups.iter_mut().enumerate() {
        let n_here = (n - g * LANES).min(LANES);
        let mut slivers = find_eight(simd, group) & ((1 << n_here) - 1);
        while slivers != 0 {
            group.find_one(slivers.trailing_zeros() as usize);
            slivers &= slivers - 1;
        }
    }
}

impl LaneBlock {
    #[cold]
    fn find_one(&mut self, lane: usize) {
        let [point_m, a, b, c] = self.points_m.map(|p| DVec3::from_array(p.map(|x| x[lane])));
        let weights = closest_weights(point_m, [a, b, c]);
        let offset_m = point_m - at_weights([a, b, c], weights);
        for axis in 0..3 {
            self.weights[axis][lane] = weights[axis];
            self.offset_m[axis][lane] = offset_m[axis];
        }
        self.distance_m[lane] = offset_m.length();
    }
}

/// Writes the places; answers the bits of the lanes whose triangle is a sliver or broken, where they are no good. The names
/// are those of [`crate::math::closest_point_barycentric`].
#[inline(always)]
fn find_eight<S: Simd>(simd: S, group: &mut LaneBlock) -> u64 {
    let (zero, one) = (f64x8::splat(simd, 0.0), f64x8::splat(simd, 1.0));
    let p = load(simd, &group.points_m[0]);
    let a = load(simd, &group.points_m[1]);
    let b = load(simd, &group.points_m[2]);
    let c = load(simd, &group.points_m[3]);
    let (ab, ac) = (minus(b, a), minus(c, a));
    let normal = cross(ab, ac);
    let is_whole = dot(normal, normal).simd_gt(dot(ab, ab) * SLIVER * dot(ac, ac));
    let (ap, bp, cp) = (minus(p, a), minus(p, b), minus(p, c));
    let (d1, d2) = (dot(ab, ap), dot(ac, ap));
    let (d3, d4) = (dot(ab, bp), dot(ac, bp));
    let (d5, d6) = (dot(ab, cp), dot(ac, cp));
    let vc = d1 * d4 - d3 * d2;
    let vb = d5 * d2 - d1 * d6;
    let va = d3 * d6 - d5 * d4;
    // Of all that hold the first counts, in this order; else it is inside.
    let at_a = d1.simd_le(zero) & d2.simd_le(zero);
    let at_b = d3.simd_ge(zero) & d4.simd_le(d3);
    let at_ab = vc.simd_le(zero) & d1.simd_ge(zero) & d3.simd_le(zero);
    let at_c = d6.simd_ge(zero) & d5.simd_le(d6);
    let at_ac = vb.simd_le(zero) & d2.simd_ge(zero) & d6.simd_le(zero);
    let at_bc = va.simd_le(zero) & (d4 - d3).simd_ge(zero) & (d5 - d6).simd_ge(zero);
    let whole =
        at_ab.select(d1 - d3, at_ac.select(d2 - d6, at_bc.select((d4 - d3) + (d5 - d6), va + vb + vc)));
    let v = at_ab.select(d1, vb) / whole;
    let w = at_ac.select(d2, at_bc.select(d4 - d3, vc)) / whole;
    // Along the edges one weight is the rest of the other.
    let w = at_ab.select(zero, w);
    let v = at_ab.select(v, at_ac.select(zero, at_bc.select(one - w, v)));
    let on_bc = !at_ab & !at_ac & at_bc;
    let u = on_bc.select(zero, one - v - w);
    let is_c = at_c & !at_ab;
    let (u, v, w) = (is_c.select(zero, u), is_c.select(zero, v), is_c.select(one, w));
    let (u, v, w) = (at_b.select(zero, u), at_b.select(one, v), at_b.select(zero, w));
    let (u, v, w) = (at_a.select(one, u), at_a.select(zero, v), at_a.select(zero, w));
    let offset = [
        p[0] - (a[0] * u + b[0] * v + c[0] * w),
        p[1] - (a[1] * u + b[1] * v + c[1] * w),
        p[2] - (a[2] * u + b[2] * v + c[2] * w),
    ];
    store([u, v, w], &mut group.weights);
    store(offset, &mut group.offset_m);
    dot(offset, offset).sqrt().store_slice(&mut group.distance_m);
    (!is_whole).to_bitmask()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::SeededRandom;

    #[test]
    fn places_are_those_of_one_at_a_time_to_the_bit() {
        let mut random = SeededRandom::new(11);
        let mut n_at = [0; 8];
        // 0: anywhere; 1: on a coarse lattice, where places lie on edges, corners and slivers; 2: of very different sizes;
        // 3: far from the origin; 4: broken.
        for kind in 0..5 {
            for n in [BLOCK, 1, BLOCK - 5] {
                let positions_m: Vec<DVec3> = (0..4 * n)
                    .map(|i| {
                        let scale = if kind == 2 { libm::exp2(40.0 * random.uniform() - 20.0) } else { 2.0 };
                        let p = DVec3::new(random.normal(), random.normal(), random.normal()) * scale;
                        match kind {
                            1 => p.round(),
                            3 => p + 1e4,
                            4 if i % 7 == 0 => DVec3::new(p.x, f64::NAN, f64::INFINITY),
                            _ => p,
                        }
                    })
                    .collect();
                let pairs: Vec<[u32; 2]> = (0..n as u32).map(|i| [4 * i, i]).collect();
                let triangles: Vec<[u32; 3]> = pairs.iter().map(|[v, _]| [*v + 1, *v + 2, *v + 3]).collect();
                let mut places = NearestPlaces::new();
                places.find(Level::new(), &pairs, &positions_m, &triangles);
                for (i, [vertex, t]) in pairs.iter().enumerate() {
                    let point_m = positions_m[*vertex as usize];
                    let corners_m = triangles[*t as usize].map(|v| positions_m[v as usize]);
                    let weights = closest_weights(point_m, corners_m);
                    let offset_m = point_m - at_weights(corners_m, weights);
                    let found = places.get(i);
                    if weights.iter().any(|w| w.is_nan()) {
                        assert!(found.distance_m.is_nan(), "{found:?}");
                        continue;
                    }
                    let bits = |x: &[f64]| x.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
                    assert_eq!(bits(&found.weights), bits(&weights), "{kind}: {found:?}, {weights:?}");
                    assert_eq!(bits(&found.offset_m.to_array()), bits(&offset_m.to_array()));
                    assert_eq!(found.distance_m.to_bits(), places.distance_m(i).to_bits());
                    assert!(found.distance_m.to_bits() == offset_m.length().to_bits() || offset_m.is_nan());
                    n_at[weights
                        .iter()
                        .enumerate()
                        .fold(0, |bits, (k, w)| bits | usize::from(*w != 0.0) << k)] += 1;
                }
            }
        }
        assert!(
            n_at[0] == 0 && n_at[1..].iter().all(|n| *n > 10),
            "every corner, edge and the inside: {n_at:?}"
        );
    }
}
