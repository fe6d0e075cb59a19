//! Fewer triangles by collapsing edges in the order of the error they make.
//!
//! Error of a vertex: the sum of squared distances to the planes of the triangles it stands for, weighted by
//! area (M. Garland and P. Heckbert, "Surface simplification using quadric error metrics", 1997,
//! doi 10.1145/258734.258849), plus a little of the squared distance to the old vertices, which fixes it in
//! flat regions. An edge is collapsed only if the surface stays a manifold (its ends have exactly the two
//! common neighbours that close its triangles: the link condition of T. Dey, H. Edelsbrunner, S. Guha and
//! D. Nekhayev, "Topology preserving edge contraction", 1999) and no triangle turns over or becomes a sliver.
//!
//! `meshopt`'s simplifier has neither guarantee and works in `f32`, so it is not used.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use super::TriMesh;
use super::error::{Place, SurfaceError};
use super::intersect::self_intersections;
use crate::math::{DMat3, DVec3, outer};

/// Weight of the distance to the old vertices beside that to the planes.
const POSITION_WEIGHT: f64 = 1e-3;
/// A triangle may turn by at most this angle in one collapse: its cosine.
const LEAST_NORMAL_COSINE: f64 = 0.3;
/// A collapse may not make a triangle whose doubled area over its longest edge squared is below this, unless
/// the vertex had a worse one.
const LEAST_SHAPE: f64 = 0.15;
/// Attempts at a surface without self-intersection: each keeps the places of the last one's as they were.
const MOST_ATTEMPTS: usize = 8;

/// `mesh`, a closed manifold, with `target_triangles` triangles or one less (two go with each edge), with
/// the same topology and without self-intersection, if `mesh` has none. A mesh that has no more than that
/// comes back as it is.
///
/// # Errors
/// [`SurfaceError::TargetNotReached`] when no edge can be collapsed any more;
/// [`SurfaceError::Tangled`] when triangles keep crossing.
///
/// # Panics
/// If an index is out of range: check the mesh first.
pub fn decimate(mesh: &TriMesh, target_triangles: usize) -> Result<TriMesh, SurfaceError> {
    let target = target_triangles.max(4);
    if mesh.triangles.len() <= target {
        return Ok(mesh.clone());
    }
    let mut locked = vec![false; mesh.positions_m.len()];
    for attempt in 0.. {
        let mut work = Decimation::new(mesh, &locked);
        work.run(target);
        if work.n_triangles > target {
            return Err(SurfaceError::TargetNotReached { target, reached: work.n_triangles });
        }
        let (result, kept) = work.into_mesh();
        let pairs = self_intersections(&result, 1000);
        let Some(first) = pairs.first() else { return Ok(result) };
        if attempt == MOST_ATTEMPTS {
            let place = Place(result.corners_m(first[0] as usize)[0]);
            return Err(SurfaceError::Tangled { stage: "decimation", n: pairs.len(), place });
        }
        // Everything within the crossing triangles' boxes stays in the next attempt.
        let crossing = pairs.iter().flatten().map(|&t| t as usize);
        let boxes: Vec<_> = crossing.map(|t| crate::math::Aabb::of_points(&result.corners_m(t))).collect();
        for (lock, &p) in locked.iter_mut().zip(&mesh.positions_m) {
            *lock |= boxes.iter().any(|b| b.contains(p));
        }
        for v in pairs.iter().flatten().flat_map(|&t| result.triangles[t as usize]) {
            locked[kept[v as usize] as usize] = true;
        }
    }
    unreachable!("the last attempt returns")
}

/// (x, 1)^T [A b; b^T c] (x, 1).
#[derive(Clone, Copy)]
struct Quadric {
    a: DMat3,
    b: DVec3,
    c: f64,
}

impl Quadric {
    const ZERO: Self = Self { a: DMat3::ZERO, b: DVec3::ZERO, c: 0.0 };

    fn add(&mut self, other: &Self) {
        self.a += other.a;
        self.b += other.b;
        self.c += other.c;
    }

    /// `weight` times the squared distance to the plane through `point` with unit `normal`.
    fn of_plane(normal: DVec3, point: DVec3, weight: f64) -> Self {
        let d = -normal.dot(point);
        Self { a: weight * outer(normal, normal), b: weight * d * normal, c: weight * d * d }
    }

    /// `weight` times the squared distance to `point`.
    fn of_point(point: DVec3, weight: f64) -> Self {
        Self {
            a: DMat3::from_diagonal(DVec3::splat(weight)),
            b: -weight * point,
            c: weight * point.dot(point),
        }
    }

    fn at(&self, x: DVec3) -> f64 {
        x.dot(self.a * x) + 2.0 * self.b.dot(x) + self.c
    }
}

/// An edge waiting to be collapsed. Positions are in millimetres from the surface's centre.
struct Waiting {
    cost: f64,
    vertices: [u32; 2],
    versions: [u32; 2],
    place: DVec3,
}

impl Ord for Waiting {
    /// The heap's largest is the cheapest; equals by index.
    fn cmp(&self, other: &Self) -> Ordering {
        other.cost.total_cmp(&self.cost).then_with(|| other.vertices.cmp(&self.vertices))
    }
}

impl PartialOrd for Waiting {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Waiting {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Waiting {}

struct Decimation<'a> {
    locked: &'a [bool],
    centre_m: DVec3,
    positions_mm: Vec<DVec3>,
    quadrics: Vec<Quadric>,
    versions: Vec<u32>,
    /// Live triangles of each vertex.
    around: Vec<Vec<u32>>,
    /// Dead triangles are `[u32::MAX; 3]`.
    triangles: Vec<[u32; 3]>,
    n_triangles: usize,
    queue: BinaryHeap<Waiting>,
}

const DEAD: [u32; 3] = [u32::MAX; 3];

impl<'a> Decimation<'a> {
    fn new(mesh: &TriMesh, locked: &'a [bool]) -> Self {
        let n = mesh.positions_m.len();
        let centre_m = crate::math::Aabb::of_points(&mesh.positions_m).center_m();
        let positions_mm: Vec<DVec3> = mesh.positions_m.iter().map(|&p| 1e3 * (p - centre_m)).collect();
        let mut quadrics = vec![Quadric::ZERO; n];
        let mut around = vec![Vec::new(); n];
        for (t, triangle) in mesh.triangles.iter().enumerate() {
            let [a, b, c] = triangle.map(|v| positions_mm[v as usize]);
            let doubled = (b - a).cross(c - a);
            let third = doubled.length() / 6.0;
            let plane = Quadric::of_plane(doubled.normalize_or_zero(), a, third);
            for &v in triangle {
                quadrics[v as usize].add(&plane);
                quadrics[v as usize]
                    .add(&Quadric::of_point(positions_mm[v as usize], POSITION_WEIGHT * third));
                around[v as usize].push(u32::try_from(t).expect("meshes have fewer than 2^32 triangles"));
            }
        }
        Self {
            locked,
            centre_m,
            positions_mm,
            quadrics,
            versions: vec![0; n],
            around,
            triangles: mesh.triangles.clone(),
            n_triangles: mesh.triangles.len(),
            queue: BinaryHeap::new(),
        }
    }

    fn run(&mut self, target: usize) {
        loop {
            let before = self.n_triangles;
            self.fill_queue();
            while self.n_triangles > target {
                let Some(edge) = self.queue.pop() else { break };
                let [u, v] = edge.vertices.map(|v| v as usize);
                if edge.versions == [self.versions[u], self.versions[v]] && self.can_collapse(&edge) {
                    self.collapse(&edge);
                }
            }
            // Edges refused once may be free now.
            if self.n_triangles <= target || self.n_triangles == before {
                return;
            }
        }
    }

    fn fill_queue(&mut self) {
        self.queue.clear();
        let mut waiting = Vec::new();
        for &[a, b, c] in &self.triangles {
            if [a, b, c] != DEAD {
                // Each edge once: from the triangle that runs through it upwards.
                let upward = [[a, b], [b, c], [c, a]].into_iter().filter(|[u, v]| u < v);
                waiting.extend(upward.filter_map(|[u, v]| self.waiting(u, v)));
            }
        }
        self.queue = BinaryHeap::from(waiting);
    }

    fn waiting(&self, u: u32, v: u32) -> Option<Waiting> {
        let vertices = [u.min(v), u.max(v)];
        let [i, j] = vertices.map(|v| v as usize);
        if self.locked[i] || self.locked[j] {
            return None;
        }
        let mut sum = self.quadrics[i];
        sum.add(&self.quadrics[j]);
        let (p, q) = (self.positions_mm[i], self.positions_mm[j]);
        let middle = 0.5 * (p + q);
        // The position part keeps the matrix regular; where it is nearly singular the middle serves.
        let best = -(sum.a.inverse() * sum.b);
        let length = (q - p).length();
        let place = if best.is_finite() && (best - middle).length() <= length { best } else { middle };
        let cost = sum.at(place).max(0.0);
        let versions = [self.versions[i], self.versions[j]];
        Some(Waiting { cost, vertices, versions, place })
    }

    fn neighbours(&self, v: usize) -> Vec<u32> {
        let all = self.around[v].iter().flat_map(|&t| self.triangles[t as usize]);
        let mut list: Vec<u32> = all.filter(|&w| w as usize != v).collect();
        list.sort_unstable();
        list.dedup();
        list
    }

    fn can_collapse(&self, edge: &Waiting) -> bool {
        let [u, v] = edge.vertices;
        let (of_u, of_v) = (self.neighbours(u as usize), self.neighbours(v as usize));
        let common: Vec<u32> = of_u.iter().copied().filter(|w| of_v.binary_search(w).is_ok()).collect();
        // Each common neighbour loses a triangle; with three it would be left with two.
        if common.len() != 2 || common.iter().any(|&w| self.around[w as usize].len() < 4) {
            return false;
        }
        [(u, v), (v, u)].into_iter().all(|(from, other)| {
            self.around[from as usize].iter().all(|&t| {
                let triangle = self.triangles[t as usize];
                triangle.contains(&other) || self.stays_upright(triangle, from, edge.place)
            })
        })
    }

    /// Whether the triangle keeps its side and shape when `vertex` moves to `place`.
    fn stays_upright(&self, triangle: [u32; 3], vertex: u32, place: DVec3) -> bool {
        let old = triangle.map(|v| self.positions_mm[v as usize]);
        let new = triangle.map(|v| if v == vertex { place } else { self.positions_mm[v as usize] });
        let doubled = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a);
        let shape = |t: [DVec3; 3]| {
            let [a, b, c] = t;
            let longest =
                (b - a).length_squared().max((c - b).length_squared()).max((a - c).length_squared());
            doubled(t).length() / longest
        };
        let (before, after) = (doubled(old), doubled(new));
        after.dot(before) > LEAST_NORMAL_COSINE * after.length() * before.length()
            && shape(new) >= LEAST_SHAPE.min(shape(old))
    }

    fn collapse(&mut self, edge: &Waiting) {
        let [kept, gone] = edge.vertices;
        let (k, g) = (kept as usize, gone as usize);
        for t in std::mem::take(&mut self.around[g]) {
            let triangle = self.triangles[t as usize];
            if triangle.contains(&kept) {
                for v in triangle {
                    self.around[v as usize].retain(|&other| other != t);
                }
                self.triangles[t as usize] = DEAD;
                self.n_triangles -= 1;
            } else {
                self.triangles[t as usize] = triangle.map(|v| if v == gone { kept } else { v });
                self.around[k].push(t);
            }
        }
        let quadric = self.quadrics[g];
        self.quadrics[k].add(&quadric);
        self.positions_mm[k] = edge.place;
        self.versions[k] += 1;
        self.versions[g] += 1;
        for w in self.neighbours(k) {
            if let Some(waiting) = self.waiting(kept, w) {
                self.queue.push(waiting);
            }
        }
    }

    /// The live part, and for each of its vertices the vertex of the given mesh it was.
    fn into_mesh(self) -> (TriMesh, Vec<u32>) {
        let mut number = vec![u32::MAX; self.positions_mm.len()];
        let mut kept = Vec::new();
        let mut mesh = TriMesh::default();
        let live: Vec<[u32; 3]> = self.triangles.iter().copied().filter(|&t| t != DEAD).collect();
        for &v in live.iter().flatten() {
            number[v as usize] = 0;
        }
        for (v, number) in number.iter_mut().enumerate().filter(|(_, n)| **n == 0) {
            *number = u32::try_from(kept.len()).expect("no more vertices than before");
            kept.push(u32::try_from(v).expect("no more vertices than before"));
            mesh.positions_m.push(self.centre_m + 1e-3 * self.positions_mm[v]);
        }
        mesh.triangles = live.iter().map(|t| t.map(|v| number[v as usize])).collect();
        (mesh, kept)
    }
}
