//! Four boxes side by side, one coordinate of all four after the other, so that groups are compared at once.

use super::boxes::RoundedBox;
use fearless_simd::{Simd, f32x4, f32x8, mask32x8, prelude::*};
use glam::{Mat4, Vec3, Vec4};

/// Four boxes.
#[derive(Clone, Copy, Debug)]
pub(super) struct FourBoxes {
    low_m: [Vec4; 3],
    high_m: [Vec4; 3],
}

/// Which boxes j of one group overlap boxes i of another, a bit each: bits 0 to 3 are those with j = i, the others those
/// with j beyond i by 2, 1 and 3, counted around. So eight are compared with a group that is turned, not spread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Overlaps(u16);

impl Overlaps {
    /// All pairs.
    pub(super) const ALL: Self = Self(u16::MAX);
    /// Each pair of one group once, and none of a box with itself: those with i < j.
    pub(super) const OF_ONE_GROUP: Self = Self(Self::with_ascending());

    const fn with_ascending() -> u16 {
        let (mut bits, mut bit) = (0, 0);
        while bit < 16 {
            let [i, j] = Self::pair(bit);
            if i < j {
                bits |= 1 << bit;
            }
            bit += 1;
        }
        bits
    }

    /// i and j of a bit.
    #[inline(always)]
    const fn pair(bit: u32) -> [u32; 2] {
        let i = bit & 3;
        let beyond = (bit >> 3) | ((bit >> 1) & 2);
        [i, (i + beyond) & 3]
    }

    /// Those that are in both.
    #[inline(always)]
    pub(super) fn and(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }

    /// Those without one that was taken from it.
    pub(super) fn without(self, taken: Taken) -> Self {
        Self(self.0 & !(1 << taken.bit))
    }

    /// Takes a pair out.
    #[inline(always)]
    pub(super) fn take(&mut self) -> Option<Taken> {
        if self.0 == 0 {
            return None;
        }
        let bit = u32::from(self.0).trailing_zeros();
        self.0 &= self.0 - 1;
        let [i, j] = Self::pair(bit);
        Some(Taken { bit, i, j })
    }
}

/// A pair that was taken out.
#[derive(Clone, Copy, Debug)]
pub(super) struct Taken {
    bit: u32,
    pub(super) i: u32,
    pub(super) j: u32,
}

impl FourBoxes {
    pub(super) const NOTHING: Self = Self { low_m: [Vec4::INFINITY; 3], high_m: [Vec4::NEG_INFINITY; 3] };

    #[inline(always)]
    pub(super) fn of(boxes: [RoundedBox; 4]) -> Self {
        let [x, y, z, _] = columns(boxes.map(RoundedBox::low4_m));
        let low_m = [x, y, z];
        let [x, y, z, _] = columns(boxes.map(RoundedBox::high4_m));
        Self { low_m, high_m: [x, y, z] }
    }

    /// The boxes around each of four groups.
    #[inline(always)]
    pub(super) fn around(groups: [&Self; 4]) -> Self {
        let mut around = Self::NOTHING;
        for axis in 0..3 {
            let [a, b, c, d] = columns(groups.map(|group| group.low_m[axis]));
            around.low_m[axis] = a.min(b).min(c.min(d));
            let [a, b, c, d] = columns(groups.map(|group| group.high_m[axis]));
            around.high_m[axis] = a.max(b).max(c.max(d));
        }
        around
    }

    /// Corners of one box [m].
    #[inline(always)]
    pub(super) fn corners_m(&self, lane: usize) -> [Vec3; 2] {
        [self.low_m, self.high_m].map(|list| Vec3::from_array(list.map(|x| x[lane])))
    }

    /// Bits of the boxes here that overlap `other`.
    #[inline(always)]
    pub(super) fn overlapping(&self, other: &RoundedBox) -> u32 {
        let (low, high) = (other.low4_m(), other.high4_m());
        let all = |axis: usize| {
            Vec4::splat(low[axis]).cmple(self.high_m[axis]) & self.low_m[axis].cmple(Vec4::splat(high[axis]))
        };
        (all(0) & all(1) & all(2)).bitmask()
    }

    /// Boxes j of `other` that overlap boxes i here. All sixteen are compared before any is looked at: one loop over few
    /// bits costs one wrong guess of the processor, four loops cost four.
    #[inline(always)]
    pub(super) fn overlaps<S: Simd>(&self, simd: S, other: &Self) -> Overlaps {
        let [x, far_x] = self.overlaps_along(simd, other, 0);
        let [y, far_y] = self.overlaps_along(simd, other, 1);
        let [z, far_z] = self.overlaps_along(simd, other, 2);
        let (near, far) = ((x & y & z).to_bitmask(), (far_x & far_y & far_z).to_bitmask());
        Overlaps((near | far << 8) as u16)
    }

    /// The same seen along one axis, for the first eight and the last eight bits.
    #[inline(always)]
    fn overlaps_along<S: Simd>(&self, simd: S, other: &Self, axis: usize) -> [mask32x8<S>; 2] {
        let low = f32x8::block_splat(four(simd, self.low_m[axis]));
        let high = f32x8::block_splat(four(simd, self.high_m[axis]));
        let (other_low, other_high) = (four(simd, other.low_m[axis]), four(simd, other.high_m[axis]));
        let other_low = other_low.combine(other_low.slide::<2>(other_low));
        let other_high = other_high.combine(other_high.slide::<2>(other_high));
        let next_low = other_low.slide_within_blocks::<1>(other_low);
        let next_high = other_high.slide_within_blocks::<1>(other_high);
        let near = low.simd_le(other_high) & other_low.simd_le(high);
        let far = low.simd_le(next_high) & next_low.simd_le(high);
        [near, far]
    }

    /// Half the surface of each [m2].
    #[inline(always)]
    pub(super) fn surfaces_m2(&self) -> Vec4 {
        let [x, y, z] = [0, 1, 2].map(|axis| (self.high_m[axis] - self.low_m[axis]).max(Vec4::ZERO));
        x * y + y * z + z * x
    }
}

#[inline(always)]
fn four<S: Simd>(simd: S, x: Vec4) -> f32x4<S> {
    f32x4::simd_from(simd, x.to_array())
}

/// First, second, third and fourth numbers of the four.
#[inline(always)]
fn columns([a, b, c, d]: [Vec4; 4]) -> [Vec4; 4] {
    let turned = Mat4::from_cols(a, b, c, d).transpose();
    [turned.x_axis, turned.y_axis, turned.z_axis, turned.w_axis]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{DVec3, SeededRandom};
    use fearless_simd::{Level, dispatch};

    fn random_boxes(random: &mut SeededRandom) -> [RoundedBox; 4] {
        std::array::from_fn(|_| {
            if random.uniform() < 0.1 {
                return RoundedBox::NOTHING;
            }
            let mut point = || DVec3::new(random.uniform(), random.uniform(), random.uniform());
            let (low, size) = (point(), point());
            RoundedBox::new(low, low + size, 0.0)
        })
    }

    #[test]
    fn groups_overlap_as_their_boxes_do() {
        let mut random = SeededRandom::new(11);
        let mut n_overlapping = 0;
        for _ in 0..2000 {
            let (one, other) = (random_boxes(&mut random), random_boxes(&mut random));
            let (group, other_group) = (FourBoxes::of(one), FourBoxes::of(other));
            for level in [Level::new(), Level::baseline()] {
                let mut found = dispatch!(level, simd => group.overlaps(simd, &other_group));
                let mut overlaps = [[false; 4]; 4];
                while let Some(Taken { i, j, .. }) = found.take() {
                    overlaps[i as usize][j as usize] = true;
                    n_overlapping += 1;
                }
                for i in 0..4 {
                    let bits = other_group.overlapping(&one[i]);
                    for j in 0..4 {
                        assert_eq!(overlaps[i][j], one[i].overlaps(&other[j]));
                        assert_eq!(bits >> j & 1 == 1, one[i].overlaps(&other[j]));
                    }
                }
            }
        }
        assert!(n_overlapping > 5000, "{n_overlapping}");
    }

    #[test]
    fn a_group_holds_four_groups_and_no_more() {
        let mut random = SeededRandom::new(12);
        for _ in 0..500 {
            let below: [[RoundedBox; 4]; 4] = std::array::from_fn(|_| random_boxes(&mut random));
            let groups = below.map(FourBoxes::of);
            let around = FourBoxes::around([&groups[0], &groups[1], &groups[2], &groups[3]]);
            for (lane, boxes) in below.iter().enumerate() {
                let [a, b, c, d] = boxes;
                let whole = a.joined(b).joined(&c.joined(d));
                assert_eq!(around.corners_m(lane), [whole.low_m(), whole.high_m()]);
            }
        }
    }

    #[test]
    fn each_pair_of_a_group_comes_once() {
        let mut pairs = Overlaps::OF_ONE_GROUP;
        let mut seen = Vec::new();
        while let Some(Taken { i, j, .. }) = pairs.take() {
            seen.push([i, j]);
        }
        seen.sort_unstable();
        assert_eq!(seen, [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]);
    }
}
