//! Which vertices are at which triangles: from pairs of boxes to one contact for each vertex.
//!
//! Every vertex belongs to one triangle and is tested when that triangle's box meets another: no test is made twice. Of all
//! places within the margin the nearest counts, of equal ones that in the lowest triangle, so that the
//! answer does not depend on the order in which pairs are found. A vertex is behind a surface when it lies against the
//! normal between those of the triangle's vertices, which are weighted by area.
//!
//! Within one body (self-collision) a wall thinner than the margin would count as pierced by its own other side: the margin
//! has to be smaller than that.

use super::NodeContact;
use crate::contact::broad_phase::BroadPhaseKind;
use crate::contact::self_collision::{PairSearch, PairSearchParams};
use crate::contact::triangles::{at_weights, closest_weights};
use crate::math::DVec3;

const NONE: u32 = u32::MAX;

/// What is searched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactSearchParams {
    /// Structure of the broad phase.
    pub kind: BroadPhaseKind,
    /// Distance up to which a vertex counts, outside and inside [m]: more than it moves in a step.
    pub margin_m: f64,
    /// Whether a body can touch itself.
    pub self_collision: bool,
    /// Pairs of boxes at one time at most.
    pub pair_capacity: usize,
}

#[derive(Clone, Copy, Debug)]
struct Nearest {
    triangle: u32,
    weights: [f64; 3],
    offset_m: DVec3,
    distance_m: f64,
}

const NOTHING: Nearest =
    Nearest { triangle: NONE, weights: [0.0; 3], offset_m: DVec3::ZERO, distance_m: f64::INFINITY };

/// The search over the surfaces of all bodies. Finding never allocates.
#[derive(Clone, Debug)]
pub struct ContactSearch {
    search: PairSearch,
    margin_m: f64,
    triangles: Vec<[u32; 3]>,
    /// Of each triangle, whether each of its corners is tested with it.
    tests: Vec<[bool; 3]>,
    /// Area vectors summed at the vertices.
    normals: Vec<DVec3>,
    nearest: Vec<Nearest>,
}

impl ContactSearch {
    /// For `triangles` (vertices counted over all bodies) of the bodies `body_of`.
    ///
    /// # Panics
    /// When the two lists differ in length.
    pub fn new(
        params: &ContactSearchParams,
        positions_m: &[DVec3],
        triangles: &[[u32; 3]],
        body_of: &[u32],
    ) -> Self {
        let pairs = PairSearchParams {
            kind: params.kind,
            self_collision: params.self_collision,
            margin_m: params.margin_m,
            pair_capacity: params.pair_capacity,
        };
        let mut is_taken = vec![false; positions_m.len()];
        let mut tests = Vec::with_capacity(triangles.len());
        for triangle in triangles {
            tests.push(triangle.map(|v| !std::mem::replace(&mut is_taken[v as usize], true)));
        }
        Self {
            search: PairSearch::new(&pairs, positions_m, triangles, body_of),
            margin_m: params.margin_m,
            triangles: triangles.to_vec(),
            tests,
            normals: vec![DVec3::ZERO; positions_m.len()],
            nearest: vec![NOTHING; positions_m.len()],
        }
    }

    /// Follows the surfaces and writes the contacts into `found`, ascending by vertex, as far as its capacity goes; how many
    /// found no room, there or in the structure.
    pub fn find_into(&mut self, positions_m: &[DVec3], found: &mut Vec<NodeContact>) -> usize {
        found.clear();
        self.search.update(positions_m);
        let Self { search, triangles, tests, normals, nearest, margin_m } = self;
        nearest.fill(NOTHING);
        let margin_m = *margin_m;
        let mut has_any = false;
        let corners_m = |t: u32| triangles[t as usize].map(|v| positions_m[v as usize]);
        let (boxes, vertex_boxes) = (search.boxes(), search.vertex_boxes());
        let mut test = |from: u32, at: u32| {
            let has_vertex = tests[from as usize];
            if has_vertex == [false; 3] {
                return;
            }
            for (vertex, _) in triangles[from as usize].into_iter().zip(has_vertex).filter(|(_, is)| *is) {
                if !vertex_boxes[vertex as usize].overlaps(&boxes[at as usize]) {
                    continue;
                }
                let corners_m = corners_m(at);
                let point_m = positions_m[vertex as usize];
                let weights = closest_weights(point_m, corners_m);
                let offset_m = point_m - at_weights(corners_m, weights);
                let distance_m = offset_m.length();
                let best = &mut nearest[vertex as usize];
                let is_nearer =
                    distance_m < best.distance_m || distance_m == best.distance_m && at < best.triangle;
                if distance_m <= margin_m && is_nearer {
                    *best = Nearest { triangle: at, weights, offset_m, distance_m };
                    has_any = true;
                }
            }
        };
        search.structure().for_each_pair(boxes, search.rules(), |s, t| {
            test(s, t);
            test(t, s);
        });
        let mut n_dropped = search.structure().n_dropped() as usize;
        if !has_any {
            return n_dropped;
        }
        normals.fill(DVec3::ZERO);
        for (t, triangle) in triangles.iter().enumerate() {
            let [a, b, c] = corners_m(t as u32);
            let area_m2 = (b - a).cross(c - a);
            for v in triangle {
                normals[*v as usize] += area_m2;
            }
        }
        for (vertex, place) in (0..).zip(nearest.iter()) {
            if place.triangle == NONE {
                continue;
            }
            if found.len() == found.capacity() {
                n_dropped += 1;
                continue;
            }
            let triangle = triangles[place.triangle as usize];
            let [a, b, c] = corners_m(place.triangle);
            let face = (b - a).cross(c - a).normalize_or_zero();
            let smooth = at_weights(triangle.map(|v| normals[v as usize].normalize_or_zero()), place.weights);
            let is_behind = place.offset_m.dot(smooth) < 0.0;
            let gap_m = if is_behind { -place.distance_m } else { place.distance_m };
            // The way to the vertex; the face's own normal where they touch.
            let normal = (place.offset_m / gap_m).try_normalize().unwrap_or(face);
            if normal != DVec3::ZERO {
                found.push(NodeContact::with_triangle(vertex, triangle, place.weights, normal, gap_m));
            }
        }
        n_dropped
    }

    /// Vertices of the triangles.
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// Appends the contacts of some vertices with a rigid surface: `place` tells the distance [m] of a point from it, the unit
    /// normal out of it and its velocity there [m/s]. Answers how many found no room.
    pub fn add_rigid(
        &self,
        vertices: std::ops::Range<u32>,
        positions_m: &[DVec3],
        place: impl Fn(DVec3) -> RigidPlace,
        found: &mut Vec<NodeContact>,
    ) -> usize {
        let mut n_dropped = 0;
        for vertex in vertices {
            let at = place(positions_m[vertex as usize]);
            if at.distance_m.abs() > self.margin_m || at.distance_m.is_nan() {
                continue;
            }
            if found.len() == found.capacity() {
                n_dropped += 1;
            } else {
                found.push(NodeContact::with_rigid(vertex, at.normal, at.distance_m, at.velocity_m_per_s));
            }
        }
        n_dropped
    }
}

/// A rigid surface as seen from a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigidPlace {
    /// Distance [m], negative inside.
    pub distance_m: f64,
    /// Unit normal out of the body.
    pub normal: DVec3,
    /// Velocity there [m/s].
    pub velocity_m_per_s: DVec3,
}
