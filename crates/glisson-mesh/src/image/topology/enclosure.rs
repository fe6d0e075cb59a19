//! A ball around a voxel set that is much smaller than its filled box, without looking at single voxels.
//!
//! Along one axis every column of the box is filled from its lowest to its highest voxel and on to a plane that
//! all columns share: two landscapes back to back, whose layers shrink away from the plane, are a ball whatever
//! their heights. Lakes of the landscapes are filled to their outlet, so that a tunnel along the axis is inside
//! as a whole and shrinking finds its narrowest place (L. Vincent and P. Soille, "Watersheds in digital
//! spaces", 1991, doi 10.1109/34.87344, flood in the same order). Where two columns that touch by an edge
//! stand above both of the others around that edge, one of the others is raised: then it is well-composed.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use super::propagation::Crop;

/// A well-composed ball around `given` and within its box.
pub(super) fn enclosing_ball(given: &Crop) -> Crop {
    let spans = [0, 1, 2].map(|axis| Spans::of(given, axis));
    let smallest = spans.into_iter().min_by_key(Spans::n_voxels).expect("three axes");
    smallest.ball(given)
}

/// Lowest and highest voxel of every column along one axis; 1 is the box's first.
struct Spans {
    axis: usize,
    /// Columns along the two other axes, the lower axis fastest.
    n: [usize; 2],
    /// The plane within all columns.
    plane: u32,
    low: Vec<u32>,
    high: Vec<u32>,
}

impl Spans {
    /// The spans of `given` stretched to a common plane, the one that needs the fewest voxels.
    fn of(given: &Crop, axis: usize) -> Self {
        let inner = given.inner_dims();
        let [u, v] = other_axes(axis);
        let n = [inner[u], inner[v]];
        let mut low = vec![u32::MAX; n[0] * n[1]];
        let mut high = vec![0; n[0] * n[1]];
        for (j, k) in (1..=inner[2]).flat_map(|k| (1..=inner[1]).map(move |j| (j, k))) {
            let start = given.index([1, j, k]);
            for (i, _) in given.cells[start..start + inner[0]].iter().enumerate().filter(|&(_, &c)| c == 1) {
                let voxel = [i + 1, j, k];
                let place = voxel[u] - 1 + n[0] * (voxel[v] - 1);
                low[place] = low[place].min(voxel[axis] as u32);
                high[place] = high[place].max(voxel[axis] as u32);
            }
        }
        // Moving the plane up by one adds a voxel to the columns below it and saves one in those above.
        let (mut n_low, mut n_high) = (vec![0usize; inner[axis] + 1], vec![0usize; inner[axis] + 1]);
        for (&low, &high) in low.iter().zip(&high).filter(|&(low, high)| low <= high) {
            n_low[low as usize] += 1;
            n_high[high as usize] += 1;
        }
        let mut plane = 1;
        let (mut n_below, mut n_above) = (n_high[1], n_low[2..].iter().sum::<usize>());
        while n_below < n_above {
            plane += 1;
            n_below += n_high[plane];
            n_above -= n_low[plane];
        }
        let plane = plane as u32;
        low.iter_mut().for_each(|x| *x = plane.min(*x));
        high.iter_mut().for_each(|x| *x = plane.max(*x));
        Self { axis, n, plane, low, high }
    }

    fn n_voxels(&self) -> u64 {
        self.low.iter().zip(&self.high).map(|(low, high)| u64::from(high + 1 - low)).sum()
    }

    fn ball(mut self, given: &Crop) -> Crop {
        fill_lakes(&mut self.high, self.n);
        raise_saddles(&mut self.high, self.n);
        // Upside down the valleys of the lower side are a landscape, too.
        self.low.iter_mut().for_each(|x| *x = self.plane - *x);
        fill_lakes(&mut self.low, self.n);
        raise_saddles(&mut self.low, self.n);
        let mut ball = given.emptied();
        let [u, v] = other_axes(self.axis);
        let stride = given.strides()[self.axis];
        for (place, (&depth, &high)) in self.low.iter().zip(&self.high).enumerate() {
            let mut voxel = [0; 3];
            voxel[u] = place % self.n[0] + 1;
            voxel[v] = place / self.n[0] + 1;
            voxel[self.axis] = (self.plane - depth) as usize;
            let start = given.index(voxel);
            for step in 0..=(high + depth - self.plane) as usize {
                ball.cells[start + step * stride] = 1;
            }
        }
        ball
    }
}

fn other_axes(axis: usize) -> [usize; 2] {
    [[1, 2], [0, 2], [0, 1]][axis]
}

/// Raises every column to the lowest level over which water would run off to the border (by faces).
fn fill_lakes(height: &mut [u32], n: [usize; 2]) {
    let mut reached = vec![false; height.len()];
    let mut shore = BinaryHeap::new();
    for place in 0..height.len() {
        let (i, j) = (place % n[0], place / n[0]);
        if i == 0 || j == 0 || i + 1 == n[0] || j + 1 == n[1] {
            reached[place] = true;
            shore.push(Reverse((height[place], place)));
        }
    }
    while let Some(Reverse((level, place))) = shore.pop() {
        let (i, j) = (place % n[0], place / n[0]);
        let neighbours = [
            (i > 0).then(|| place - 1),
            (i + 1 < n[0]).then(|| place + 1),
            (j > 0).then(|| place - n[0]),
            (j + 1 < n[1]).then(|| place + n[0]),
        ];
        for next in neighbours.into_iter().flatten() {
            if !std::mem::replace(&mut reached[next], true) {
                height[next] = height[next].max(level);
                shore.push(Reverse((height[next], next)));
            }
        }
    }
}

/// Raises columns until no two diagonal neighbours stand above both columns beside them.
fn raise_saddles(height: &mut [u32], n: [usize; 2]) {
    let mut changed = true;
    while changed {
        changed = false;
        for j in 1..n[1] {
            for i in 1..n[0] {
                let d = i + n[0] * j;
                let [a, b, c] = [d - n[0] - 1, d - n[0], d - 1];
                for ([p, q], [r, s]) in [([a, d], [b, c]), ([b, c], [a, d])] {
                    let upper = height[p].min(height[q]);
                    if height[r].max(height[s]) < upper {
                        height[if height[r] >= height[s] { r } else { s }] = upper;
                        changed = true;
                    }
                }
            }
        }
    }
}
