//! A bucket grid over the triangles of a deforming surface, for queries near a small tool.
//!
//! Source: Cotin, Delingette and Ayache 1998 (RR-3511) s. 5: the box around the organ is cut into buckets, and
//! a query looks at its own bucket and the neighbours. They store nodes and then test the triangles of the
//! nearest one; the closest triangle need not touch the nearest node, so triangles are stored here, by their
//! centroid, and the search reaches as far as a triangle's corner can be from its centroid.

use crate::math::{Aabb, DVec3};

/// Triangles sorted into equal cubes by their centroid. Updating and asking never allocate.
#[derive(Clone, Debug)]
pub struct BucketGrid {
    bounds: Aabb,
    bucket_m: f64,
    dims: [usize; 3],
    /// Where each bucket's triangles start in `sorted`; one more than there are buckets.
    starts: Vec<u32>,
    sorted: Vec<u32>,
    bucket_of: Vec<u32>,
    /// Largest distance of a corner from its triangle's centroid [m].
    reach_m: f64,
}

/// Buckets along one axis at most: bounds the memory for a mesh with one far outlier.
const MAX_BUCKETS_AN_AXIS: usize = 64;

impl BucketGrid {
    /// A grid for `triangles` over `positions_m`, with room for the surface to move half its size outwards
    /// (what moves further falls into the outermost buckets: slower, still found).
    pub fn new(positions_m: &[DVec3], triangles: &[[u32; 3]]) -> Self {
        let used = triangles.iter().flatten().map(|&v| positions_m[v as usize]);
        let bounds = used.fold(Aabb::EMPTY, Aabb::including);
        let bounds =
            if triangles.is_empty() { Aabb { min_m: DVec3::ZERO, max_m: DVec3::ONE } } else { bounds };
        let size = bounds.size_m().max_element();
        let bounds = bounds.grown(0.25 * size + f64::MIN_POSITIVE);
        // About one triangle a bucket on the surface: sqrt(n) buckets along the longest side.
        let across = (triangles.len() as f64).sqrt().ceil().clamp(1.0, MAX_BUCKETS_AN_AXIS as f64);
        let bucket_m = bounds.size_m().max_element() / across;
        let dims = (bounds.size_m() / bucket_m).ceil().to_array();
        let dims = dims.map(|d| (d as usize).clamp(1, MAX_BUCKETS_AN_AXIS));
        let mut grid = Self {
            bounds,
            bucket_m,
            dims,
            starts: vec![0; dims.iter().product::<usize>() + 1],
            sorted: vec![0; triangles.len()],
            bucket_of: vec![0; triangles.len()],
            reach_m: 0.0,
        };
        grid.update(positions_m, triangles);
        grid
    }

    /// Sorts the triangles anew after their corners moved. The same number of triangles as at the start, or
    /// fewer.
    pub fn update(&mut self, positions_m: &[DVec3], triangles: &[[u32; 3]]) {
        self.sorted.truncate(triangles.len());
        self.bucket_of.truncate(triangles.len());
        self.starts.fill(0);
        let mut reach_squared = 0.0_f64;
        for (t, triangle) in triangles.iter().enumerate() {
            let corners = triangle.map(|v| positions_m[v as usize]);
            let centroid = (corners[0] + corners[1] + corners[2]) / 3.0;
            reach_squared = corners.iter().fold(reach_squared, |r, c| r.max(c.distance_squared(centroid)));
            let bucket = self.bucket_index(self.cell(centroid));
            self.bucket_of[t] = bucket as u32;
            self.starts[bucket + 1] += 1;
        }
        self.reach_m = reach_squared.sqrt();
        for b in 1..self.starts.len() {
            self.starts[b] += self.starts[b - 1];
        }
        // Filled from the back, so that triangles ascend within a bucket and `starts` ends up right.
        for t in (0..triangles.len()).rev() {
            let end = &mut self.starts[self.bucket_of[t] as usize + 1];
            *end -= 1;
            self.sorted[*end as usize] = t as u32;
        }
        // Each entry now holds the start of the bucket before it: shift back by one.
        let n = self.starts.len();
        self.starts.copy_within(1..n, 0);
        self.starts[n - 1] = triangles.len() as u32;
    }

    fn cell(&self, point_m: DVec3) -> [usize; 3] {
        let cell = (point_m - self.bounds.min_m) / self.bucket_m;
        // A NaN casts to 0: a broken triangle lands in a bucket like any other.
        let along = |axis: usize| (cell[axis].max(0.0) as usize).min(self.dims[axis] - 1);
        [along(0), along(1), along(2)]
    }

    fn bucket_index(&self, [i, j, k]: [usize; 3]) -> usize {
        i + self.dims[0] * (j + self.dims[1] * k)
    }

    /// Calls `visit` with every triangle that can have a point within `distance_m` of `point_m`, and perhaps
    /// others near by, bucket by bucket, always in the same order.
    pub fn for_each_near(&self, point_m: DVec3, distance_m: f64, mut visit: impl FnMut(usize)) {
        let reach = DVec3::splat(distance_m + self.reach_m);
        let (low, high) = (self.cell(point_m - reach), self.cell(point_m + reach));
        for k in low[2]..=high[2] {
            for j in low[1]..=high[1] {
                // Buckets along i are neighbours in memory: one run.
                let first = self.starts[self.bucket_index([low[0], j, k])] as usize;
                let last = self.starts[self.bucket_index([high[0], j, k]) + 1] as usize;
                for &t in &self.sorted[first..last] {
                    visit(t as usize);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{SeededRandom, closest_point_barycentric};
    use proptest::prelude::*;

    fn random_triangles(seed: u64, n: usize) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let mut random = SeededRandom::new(seed);
        let mut point = |scale: f64| {
            DVec3::new(random.uniform() - 0.5, random.uniform() - 0.5, random.uniform() - 0.5) * scale
        };
        let mut positions = Vec::new();
        for _ in 0..n {
            let center = point(1.0);
            positions.extend([center + point(0.1), center + point(0.1), center + point(0.1)]);
        }
        (positions, (0..n as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect())
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn every_triangle_in_reach_is_visited_once_also_after_a_large_move(
            seed in 0u64..1000, n in 1usize..200, distance in 0.0f64..0.3, moved in 0.0f64..3.0,
        ) {
            let (mut positions, triangles) = random_triangles(seed, n);
            let mut grid = BucketGrid::new(&positions, &triangles);
            for (i, p) in positions.iter_mut().enumerate() {
                *p += DVec3::new(moved, 0.0, 0.0) * ((i / 3) % 2) as f64;
            }
            grid.update(&positions, &triangles);
            let point = positions[0] + DVec3::splat(0.05);
            let mut visited = vec![0; n];
            grid.for_each_near(point, distance, |t| visited[t] += 1);
            for t in 0..n {
                let corners = triangles[t].map(|v| positions[v as usize]);
                let k = closest_point_barycentric(point, corners);
                let closest = corners[0] * k[0] + corners[1] * k[1] + corners[2] * k[2];
                prop_assert!(visited[t] <= 1);
                prop_assert!(closest.distance(point) > distance || visited[t] == 1);
            }
        }
    }
}
