//! Where a body, or a gap between its parts, is too thin for a cell size.
//!
//! A body is thick enough where a ball of one cell's radius (two cells across) that lies inside reaches: the
//! morphological opening of the body by that ball (Serra, Image Analysis and Mathematical Morphology, 1982).
//! With the signed distance d on a grid: the ball's centres are the nodes with d <= -r, and a node inside is
//! thin when its distance to the nearest centre is above r. Gaps are the same with the sign of d turned.
//! Distances to the centres are exact Euclidean ones between grid nodes (Felzenszwalb and Huttenlocher 2012,
//! doi 10.4086/toc.2012.v008a019); a slack of one grid spacing covers the rounding of centres to nodes.

use crate::math::{Aabb, DVec3};
use crate::surface::signed_distance::SignedDistance;

/// Which side of the surface is thin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ThinKind {
    /// The body itself: a sharp rim, a sheet, a cord.
    Body,
    /// The space between parts of the body: a fissure, a hollow rim.
    Gap,
}

/// One connected region that no ball of the cell's radius reaches.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct ThinFeature {
    /// Body or gap.
    pub kind: ThinKind,
    /// Place of the region's deepest node [m].
    pub position_m: [f64; 3],
    /// Thickness there [m]: twice the depth.
    pub thickness_m: f64,
    /// Diagonal of the region's box [m].
    pub extent_m: f64,
    /// Volume of the region [m3].
    pub volume_m3: f64,
}

/// Regions where the body or a gap is thinner than `2 radius_m`, the largest first, without those smaller
/// than a ball of half the radius.
pub fn thin_features(field: &SignedDistance, radius_m: f64) -> Vec<ThinFeature> {
    let mut found = thin_of_kind(field, radius_m, ThinKind::Body);
    found.extend(thin_of_kind(field, radius_m, ThinKind::Gap));
    found.sort_by(|a, b| b.volume_m3.total_cmp(&a.volume_m3));
    found
}

fn thin_of_kind(field: &SignedDistance, radius_m: f64, kind: ThinKind) -> Vec<ThinFeature> {
    let [nx, ny, nz] = field.dims();
    let n_nodes = nx * ny * nz;
    let spacing_m = field.spacing_m();
    let depth_m = |node: usize| match kind {
        ThinKind::Body => -field.values_m()[node],
        ThinKind::Gap => field.values_m()[node],
    };
    let mut squared: Vec<f64> =
        (0..n_nodes).map(|n| if depth_m(n) >= radius_m { 0.0 } else { f64::INFINITY }).collect();
    squared_distances(&mut squared, [nx, ny, nz]);
    let reach = radius_m / spacing_m + 1.0;
    // The grid's border cuts gaps off from the balls outside it.
    let margin = (reach.ceil() as usize).max(1);
    let in_margin = |node: usize| {
        let (row, i) = (node / nx, node % nx);
        let far = |at: usize, n: usize| at >= margin && at + margin < n;
        !(far(i, nx) && far(row % ny, ny) && far(row / ny, nz))
    };
    let mut thin: Vec<bool> = (0..n_nodes)
        .map(|n| depth_m(n) > 0.0 && squared[n] > reach * reach && !(kind == ThinKind::Gap && in_margin(n)))
        .collect();
    let least_volume_m3 = 4.0 / 3.0 * std::f64::consts::PI * (0.125 * radius_m * radius_m * radius_m);
    let mut features = Vec::new();
    for seed in 0..n_nodes {
        if !std::mem::take(&mut thin[seed]) {
            continue;
        }
        let Region { count, deepest, bounds_m } = region_from(seed, field, &mut thin, depth_m);
        let volume_m3 = count as f64 * (spacing_m * spacing_m * spacing_m);
        if volume_m3 >= least_volume_m3 {
            let (row, i) = (deepest / nx, deepest % nx);
            let position_m: DVec3 = field.node_position_m([i, row % ny, row / ny]);
            features.push(ThinFeature {
                kind,
                position_m: position_m.to_array(),
                thickness_m: 2.0 * depth_m(deepest),
                extent_m: bounds_m.size_m().length(),
                volume_m3,
            });
        }
    }
    features
}

/// Thin nodes that hang together.
struct Region {
    count: usize,
    /// The deepest node, of several the one with the lowest number.
    deepest: usize,
    bounds_m: Aabb,
}

/// The region around `seed`, which is taken out of `thin`.
fn region_from(
    seed: usize,
    field: &SignedDistance,
    thin: &mut [bool],
    depth_m: impl Fn(usize) -> f64,
) -> Region {
    let [nx, ny, nz] = field.dims();
    let mut stack = vec![seed];
    let (mut count, mut deepest) = (0usize, seed);
    let mut bounds_m = Aabb::EMPTY;
    while let Some(node) = stack.pop() {
        count += 1;
        let (row, i) = (node / nx, node % nx);
        let (j, k) = (row % ny, row / ny);
        bounds_m = bounds_m.including(field.node_position_m([i, j, k]));
        let is_deeper = depth_m(node) > depth_m(deepest);
        if is_deeper || (depth_m(node) == depth_m(deepest) && node < deepest) {
            deepest = node;
        }
        let mut visit = |exists: bool, other: usize| {
            if exists && std::mem::take(&mut thin[other]) {
                stack.push(other);
            }
        };
        visit(i > 0, node.wrapping_sub(1));
        visit(i + 1 < nx, node + 1);
        visit(j > 0, node.wrapping_sub(nx));
        visit(j + 1 < ny, node + nx);
        visit(k > 0, node.wrapping_sub(nx * ny));
        visit(k + 1 < nz, node + nx * ny);
    }
    Region { count, deepest, bounds_m }
}

/// Replaces zeros and infinities on a grid by the squared distances [cells^2] to the nearest zero.
fn squared_distances(values: &mut [f64], [nx, ny, nz]: [usize; 3]) {
    let longest = nx.max(ny).max(nz);
    let mut line = vec![0.0; longest];
    let mut scratch = Envelope { places: vec![0; longest], borders: vec![0.0; longest + 1] };
    for (n, stride, starts) in [(nx, 1, ny * nz), (ny, nx, nx * nz), (nz, nx * ny, nx * ny)] {
        for start in 0..starts {
            let first = match stride {
                1 => start * nx,
                s if s == nx => (start / nx) * nx * ny + start % nx,
                _ => start,
            };
            for at in 0..n {
                line[at] = values[first + at * stride];
            }
            scratch.lower(&line[..n], |at, value| values[first + at * stride] = value);
        }
    }
}

/// Lower envelope of parabolas of one line.
struct Envelope {
    places: Vec<usize>,
    borders: Vec<f64>,
}

impl Envelope {
    /// Gives for each place q the minimum over p of (q - p)^2 + line[p].
    fn lower(&mut self, line: &[f64], mut give: impl FnMut(usize, f64)) {
        let mut n_parabolas = 0;
        for (q, &value) in line.iter().enumerate().filter(|(_, v)| v.is_finite()) {
            let meets = |p: usize| {
                let (p_at, q_at) = (p as f64, q as f64);
                (value + q_at * q_at - line[p] - p_at * p_at) / (2.0 * (q_at - p_at))
            };
            while n_parabolas > 0 && meets(self.places[n_parabolas - 1]) <= self.borders[n_parabolas - 1] {
                n_parabolas -= 1;
            }
            self.borders[n_parabolas] =
                if n_parabolas == 0 { f64::NEG_INFINITY } else { meets(self.places[n_parabolas - 1]) };
            self.places[n_parabolas] = q;
            n_parabolas += 1;
        }
        if n_parabolas == 0 {
            return;
        }
        let mut at = 0;
        for q in 0..line.len() {
            while at + 1 < n_parabolas && self.borders[at + 1] < q as f64 {
                at += 1;
            }
            let offset = q as f64 - self.places[at] as f64;
            give(q, offset * offset + line[self.places[at]]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::SeededRandom;

    #[test]
    fn squared_distances_are_those_of_the_search_over_all_zeros() {
        let dims = [7, 5, 6];
        let mut random = SeededRandom::new(3);
        let mut values: Vec<f64> =
            (0..210).map(|_| if random.uniform() < 0.03 { 0.0 } else { f64::INFINITY }).collect();
        let place = |n: usize| [n % 7, n / 7 % 5, n / 35].map(|x| x as f64);
        let zeros: Vec<_> = (0..210).filter(|&n| values[n] == 0.0).map(place).collect();
        assert!(zeros.len() > 2);
        squared_distances(&mut values, dims);
        for n in 0..210 {
            let p = place(n);
            let expected = zeros
                .iter()
                .map(|z| (0..3).map(|a| (p[a] - z[a]).powi(2)).sum::<f64>())
                .fold(f64::INFINITY, f64::min);
            assert_eq!(values[n], expected);
        }
    }
}
