//! Which vertices are at which triangles: from pairs of boxes to one contact for each vertex.
//!
//! Every vertex belongs to one triangle, and is tested against the triangles that its own box meets and that are not
//! attached to that one. What is found waits until there are some hundreds. Of all places within the margin the
//! nearest counts, of equal ones that in the lowest triangle, so that the answer does not depend on the order in which
//! they are found. So pairs within the margin and some slack are listed, and the list serves until a vertex has moved by half the
//! slack. A vertex is behind a surface when it lies against the normal between those of the triangle's vertices,
//! which are weighted by area.
//!
//! Within one body a wall thinner than the margin would count as pierced by its own other side, and what is around a corner
//! as near. [`ContactSearch::with_rest_shape`] tells them from contacts; without it the margin has to be smaller than that.

use super::NodeContact;
use crate::contact::broad_phase::BroadPhaseKind;
use crate::contact::self_collision::{PairSearch, PairSearchParams};
use crate::contact::triangles::at_weights;
use crate::contact::vertex_lanes::{BLOCK, NearestPlace, NearestPlaces};
use crate::contact::vertex_search::VertexSearch;
use crate::math::DVec3;
use crate::model::bounded_vec::BoundedVec;
use fearless_simd::Level;

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

/// At rest a place counts as the other side of a wall up to so many margins of thickness: a choice.
const THICKEST_WALL: f64 = 5.0;
/// At rest it lies behind the triangle when it is deeper than these shares of its distance and of the margin: choices.
const BEHIND_AT_REST: f64 = 0.1;
const DEEP_AT_REST: f64 = 1e-3;
/// Cosine to the face's normal of the way out to a place behind it, at least: a choice that leaves folds of 50 degrees.
const LEAST_STRAIGHT: f64 = 0.9;
/// Cosine between the normals of a vertex and of a triangle that face each other, at most: a choice between a flat place
/// (-1), an edge (-0.7) or a corner (-0.58) that comes down on a face, and one that slides along it (0).
const MOST_ALIKE: f64 = -0.25;
/// Pairs are listed up to this share of the margin beyond it: a choice.
const SLACK: f64 = 0.25;
/// Listed pairs for each vertex at most; a list that is full serves for one step. A choice.
const PAIRS_OF_VERTEX: usize = 96;
/// Distances and motions are good to this [m].
const ROUNDING_M: f64 = 1e-12;
/// Closer than this the way to a vertex has no direction of its own [m].
const LEAST_OFFSET_M: f64 = 1e-6;

/// One body at rest: what its surface touches of itself.
#[derive(Clone, Debug)]
struct RestShape {
    rest_m: Vec<DVec3>,
    /// The piece of each vertex.
    piece_of: Vec<u32>,
}

impl RestShape {
    /// Whether the tissue between a vertex and a place of a triangle is a wall.
    fn is_wall(&self, vertex: u32, triangle: [u32; 3], weights: [f64; 3], margin_m: f64) -> bool {
        let piece = |v: u32| self.piece_of[v as usize];
        if piece(vertex) != piece(triangle[0]) {
            return false;
        }
        let corners_m = triangle.map(|v| self.rest_m[v as usize]);
        let [a, b, c] = corners_m;
        let offset_m = self.rest_m[vertex as usize] - at_weights(corners_m, weights);
        let distance_m = offset_m.length();
        let depth_m = -offset_m.dot((b - a).cross(c - a).normalize_or_zero());
        distance_m < THICKEST_WALL * margin_m
            && depth_m > BEHIND_AT_REST * distance_m + DEEP_AT_REST * margin_m
    }
}

/// The search over the surfaces of all bodies. Finding never allocates.
#[derive(Clone, Debug)]
pub struct ContactSearch {
    search: PairSearch,
    margin_m: f64,
    triangles: Vec<[u32; 3]>,
    vertices: VertexSearch,
    /// Area vectors summed at the vertices, and of the triangles, twice the areas long.
    normals: Vec<Directed>,
    areas_m2: Vec<Directed>,
    nearest: Vec<Nearest>,
    own: Option<RestShape>,
    listed: PairList,
}

/// A vector with its length.
#[derive(Clone, Copy, Debug, Default)]
struct Directed {
    vector: DVec3,
    length: f64,
}

/// A triangle near a vertex, and how far from it [m] when it was listed.
#[derive(Clone, Copy, Debug)]
struct Listed {
    triangle: u32,
    distance_m: f64,
}

/// Vertices and triangles that came near each other when the vertices were at some places.
#[derive(Clone, Debug)]
struct PairList {
    /// Of each vertex from one start to the next, the nearest first.
    of_vertex: BoundedVec<Listed>,
    starts: Vec<u32>,
    /// As they are found, with the vertex of each: scratch.
    found: BoundedVec<(u32, Listed)>,
    at_m: Vec<DVec3>,
    /// Whether it has all pairs of that moment.
    is_complete: bool,
    /// The first of each vertex that was not looked at yet: scratch.
    next: Vec<u32>,
}

impl PairList {
    fn with_room_for(n_vertices: usize) -> Self {
        Self {
            of_vertex: BoundedVec::with_capacity(PAIRS_OF_VERTEX * n_vertices),
            starts: vec![0; n_vertices + 1],
            found: BoundedVec::with_capacity(PAIRS_OF_VERTEX * n_vertices),
            at_m: vec![DVec3::NAN; n_vertices],
            is_complete: false,
            next: vec![0; n_vertices],
        }
    }

    /// By how much any two may have come nearer to each other since [m]; none when the list serves no longer: a vertex is further
    /// from where it was than half the slack, or not all pairs found room.
    fn nearer_by_m(&self, positions_m: &[DVec3], slack_m: f64) -> Option<f64> {
        let moved_m2 = self.at_m.iter().zip(positions_m).map(|(a, b)| a.distance_squared(*b));
        // Places that are no numbers count as far.
        let most_m2 = moved_m2.fold(0.0, |most: f64, m2| if m2 <= most || most.is_nan() { most } else { m2 });
        let nearer_m = 2.0 * most_m2.sqrt() + ROUNDING_M;
        (self.is_complete && nearer_m <= slack_m).then_some(nearer_m)
    }

    /// Begins a new list.
    fn start(&mut self, positions_m: &[DVec3]) {
        self.found.clear();
        self.is_complete = true;
        self.at_m.copy_from_slice(positions_m);
    }

    fn add(&mut self, [vertex, triangle]: [u32; 2], distance_m: f64) {
        self.is_complete &= self.found.try_push((vertex, Listed { triangle, distance_m }));
    }

    /// Sorts what was added.
    fn finish(&mut self) {
        self.starts.fill(0);
        self.found.iter().for_each(|(vertex, _)| self.starts[*vertex as usize + 1] += 1);
        for v in 1..self.starts.len() {
            self.starts[v] += self.starts[v - 1];
        }
        self.next.copy_from_slice(&self.starts[..self.at_m.len()]);
        self.of_vertex.clear();
        self.of_vertex.resize(self.found.len(), Listed { triangle: NONE, distance_m: 0.0 });
        for &(vertex, listed) in self.found.iter() {
            let at = &mut self.next[vertex as usize];
            self.of_vertex[*at as usize] = listed;
            *at += 1;
        }
        for ends in self.starts.windows(2) {
            let of_vertex = &mut self.of_vertex[ends[0] as usize..ends[1] as usize];
            of_vertex.sort_unstable_by(|a, b| {
                a.distance_m.total_cmp(&b.distance_m).then(a.triangle.cmp(&b.triangle))
            });
        }
    }
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
            margin_m: (1.0 + SLACK) * params.margin_m,
            pair_capacity: params.pair_capacity,
        };
        let search = PairSearch::new(&pairs, positions_m, triangles, body_of);
        Self {
            vertices: VertexSearch::new(&search),
            search,
            margin_m: params.margin_m,
            triangles: triangles.to_vec(),
            normals: vec![Directed::default(); positions_m.len()],
            areas_m2: vec![Directed::default(); triangles.len()],
            nearest: vec![NOTHING; positions_m.len()],
            own: None,
            listed: PairList::with_room_for(positions_m.len()),
        }
    }

    /// For one body that touches itself: places that face the vertex count, and within a piece of the body no wall's own
    /// other side (thinner than five margins at rest). `rest_m` are the vertices at rest, `piece_of` their pieces.
    ///
    /// # Panics
    /// When a list has not as many entries as there are vertices.
    #[must_use]
    pub fn with_rest_shape(mut self, rest_m: Vec<DVec3>, piece_of: Vec<u32>) -> Self {
        assert_eq!([rest_m.len(), piece_of.len()], [self.normals.len(); 2], "one for each vertex");
        self.own = Some(RestShape { rest_m, piece_of });
        self
    }

    /// Follows the surfaces and writes the contacts into `found`, ascending by vertex, as far as its capacity goes; how many
    /// found no room, there or in the structure.
    pub fn find_into(&mut self, positions_m: &[DVec3], found: &mut Vec<NodeContact>) -> usize {
        found.clear();
        let slack_m = SLACK * self.margin_m;
        let nearer_m = self.listed.nearer_by_m(positions_m, slack_m).or_else(|| {
            self.list(positions_m);
            self.listed.nearer_by_m(positions_m, slack_m)
        });
        let Self { search, vertices, triangles, normals, areas_m2, nearest, margin_m, own, listed } = self;
        nearest.fill(NOTHING);
        if own.is_some() {
            sum_normals(triangles, positions_m, normals, areas_m2);
        }
        let own_shape = own.as_ref().map(|shape| OwnShape { shape, normals, areas_m2 });
        let margin_m = *margin_m;
        let mut test =
            DistanceTest { positions_m, triangles, nearest, margin_m, own: own_shape, has_any: false };
        match nearer_m {
            Some(nearer_m) => test.listed(listed, nearer_m),
            None => {
                let mut waiting = Waiting::default();
                vertices.for_each(search, |vertex, triangle| {
                    if test.can_face(vertex, triangle) {
                        waiting.add([vertex, triangle], |pairs| test.all(pairs));
                    }
                });
                waiting.finish(|pairs| test.all(pairs));
            }
        }
        let has_any = test.has_any;
        let corners_m = |t: u32| triangles[t as usize].map(|v| positions_m[v as usize]);
        let mut n_dropped = search.structure().n_dropped() as usize;
        if !has_any {
            return n_dropped;
        }
        if own.is_none() {
            sum_normals(triangles, positions_m, normals, areas_m2);
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
            let smooth =
                at_weights(triangle.map(|v| normals[v as usize].vector.normalize_or_zero()), place.weights);
            let is_behind = place.offset_m.dot(smooth) < 0.0;
            let gap_m = if is_behind { -place.distance_m } else { place.distance_m };
            // The way to the vertex; the face's own normal where they touch.
            let has_way = own.is_none() || place.distance_m > LEAST_OFFSET_M;
            let way = (place.offset_m / gap_m).try_normalize().filter(|_| has_way);
            let normal = way.unwrap_or(face);
            // No place inside a body is nearest to one of its convex edges: what is behind such an edge is beside it.
            let is_beside = own.is_some() && is_behind && normal.dot(face) < LEAST_STRAIGHT;
            if normal != DVec3::ZERO && !is_beside {
                found.push(NodeContact::with_triangle(vertex, triangle, place.weights, normal, gap_m));
            }
        }
        n_dropped
    }

    /// Lists the pairs that are near each other now.
    fn list(&mut self, positions_m: &[DVec3]) {
        let Self { search, vertices, listed, triangles, margin_m, .. } = self;
        search.update(positions_m);
        vertices.update(search);
        listed.start(positions_m);
        let (level, mut places) = (Level::new(), NearestPlaces::new());
        let most_m = (1.0 + SLACK) * *margin_m + ROUNDING_M;
        let mut measure = |pairs: &[[u32; 2]]| {
            for block in pairs.chunks(BLOCK) {
                places.find(level, block, positions_m, triangles);
                for (i, pair) in block.iter().enumerate() {
                    // What is no number may be near.
                    let distance_m = places.distance_m(i).max(0.0);
                    if distance_m <= most_m {
                        listed.add(*pair, distance_m);
                    }
                }
            }
        };
        let mut waiting = Waiting::default();
        vertices.for_each(search, |vertex, triangle| waiting.add([vertex, triangle], &mut measure));
        waiting.finish(measure);
        listed.finish();
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

/// The triangles' area vectors, and their sums at the vertices.
fn sum_normals(
    triangles: &[[u32; 3]],
    positions_m: &[DVec3],
    normals: &mut [Directed],
    areas_m2: &mut [Directed],
) {
    normals.fill(Directed::default());
    for (triangle, area_m2) in triangles.iter().zip(areas_m2) {
        let [a, b, c] = triangle.map(|v| positions_m[v as usize]);
        let vector = (b - a).cross(c - a);
        *area_m2 = Directed { vector, length: vector.length() };
        for v in triangle {
            normals[*v as usize].vector += vector;
        }
    }
    for normal in normals {
        normal.length = normal.vector.length();
    }
}

/// Vertices and triangles that wait for their test at most.
const N_WAITING: usize = 512;

/// One body that touches itself, now.
#[derive(Clone, Copy)]
struct OwnShape<'a> {
    shape: &'a RestShape,
    normals: &'a [Directed],
    areas_m2: &'a [Directed],
}

/// Keeps the nearest triangle of each vertex.
struct DistanceTest<'a> {
    positions_m: &'a [DVec3],
    triangles: &'a [[u32; 3]],
    nearest: &'a mut [Nearest],
    margin_m: f64,
    own: Option<OwnShape<'a>>,
    has_any: bool,
}

/// Pairs that wait until there are some hundreds.
struct Waiting {
    pairs: [[u32; 2]; N_WAITING],
    n: usize,
}

impl Default for Waiting {
    fn default() -> Self {
        Self { pairs: [[0; 2]; N_WAITING], n: 0 }
    }
}

impl Waiting {
    /// A pair waits for `test`, which takes all of them when there is room for no more.
    fn add(&mut self, pair: [u32; 2], test: impl FnOnce(&[[u32; 2]])) {
        self.pairs[self.n] = pair;
        self.n += 1;
        if self.n == N_WAITING {
            self.finish(test);
        }
    }

    fn finish(&mut self, test: impl FnOnce(&[[u32; 2]])) {
        test(&self.pairs[..self.n]);
        self.n = 0;
    }
}

impl DistanceTest<'_> {
    /// Tests the pairs of a list that can be nearest: of each vertex first the nearest that faces it, then what may be as near.
    fn listed(&mut self, list: &mut PairList, nearer_m: f64) {
        let PairList { of_vertex, starts, next, .. } = list;
        let mut waiting = Waiting::default();
        for is_first in [true, false] {
            for (vertex, next) in (0..).zip(&mut *next) {
                let ends = [starts[vertex as usize], starts[vertex as usize + 1]];
                // Nothing is known before the first round.
                let best_m = self.nearest[vertex as usize].distance_m;
                if is_first {
                    *next = ends[0];
                }
                let most_m = best_m.min(self.margin_m) + nearer_m;
                while *next < ends[1] {
                    let Listed { triangle, distance_m } = of_vertex[*next as usize];
                    if distance_m > most_m {
                        break;
                    }
                    *next += 1;
                    if self.can_face(vertex, triangle) {
                        waiting.add([vertex, triangle], |pairs| self.all(pairs));
                        if is_first {
                            break;
                        }
                    }
                }
            }
            waiting.finish(|pairs| self.all(pairs));
        }
    }

    fn all(&mut self, pairs: &[[u32; 2]]) {
        let level = Level::new();
        let mut places = NearestPlaces::new();
        for block in pairs.chunks(BLOCK) {
            places.find(level, block, self.positions_m, self.triangles);
            for (i, &[vertex, triangle]) in block.iter().enumerate() {
                let distance_m = places.distance_m(i);
                let best = &self.nearest[vertex as usize];
                let is_nearer =
                    distance_m < best.distance_m || distance_m == best.distance_m && triangle < best.triangle;
                if distance_m <= self.margin_m && is_nearer {
                    self.keep(vertex, triangle, places.get(i));
                }
            }
        }
    }

    /// Whether a vertex and a triangle of one body face each other; also false beside a vertex that is broken.
    fn can_face(&self, vertex: u32, triangle: u32) -> bool {
        let Some(OwnShape { normals, areas_m2, .. }) = self.own else { return true };
        let (normal, area_m2) = (&normals[vertex as usize], &areas_m2[triangle as usize]);
        normal.vector.dot(area_m2.vector) <= MOST_ALIKE * (normal.length * area_m2.length)
    }

    /// Keeps a place nearer than those before, if it can be a contact.
    fn keep(&mut self, vertex: u32, triangle: u32, place: NearestPlace) {
        let NearestPlace { weights, offset_m, distance_m } = place;
        if let Some(OwnShape { shape, .. }) = self.own
            && shape.is_wall(vertex, self.triangles[triangle as usize], weights, self.margin_m)
        {
            return;
        }
        self.nearest[vertex as usize] = Nearest { triangle, weights, offset_m, distance_m };
        self.has_any = true;
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
