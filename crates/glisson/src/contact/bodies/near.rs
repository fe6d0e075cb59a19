//! What is near what: pairs of features, searched anew only when something has moved, and their contacts.
//!
//! Vertex against triangle, edge against edge where both are ridges (on flat parts the vertices of either side carry), and
//! vertex or triangle against obstacles of simple shape. Pairs are searched with room to spare and serve until a vertex
//! has gone half of that (L. Verlet 1967, Computer "experiments" on classical fluids I, doi 10.1103/PhysRev.159.98).
//!
//! The surfaces keep a small distance, the skin: normals then come from real distances, and what rounding and
//! unfinished iterations leave is no penetration.

use super::obstacle::MovingObstacle;
use super::surfaces::Surfaces;
use crate::contact::broad_phase::BroadPhaseKind;
use crate::contact::constraint::{Contact, ContactKey};
use crate::contact::self_collision::{ClosePair, PairSearch, PairSearchParams};
use crate::contact::triangles::{at_weights, closest_on_segments, closest_weights};
use crate::math::DVec3;

/// Sine of the bend from which an edge is a ridge, about 3 degrees: a choice.
const RIDGE: f64 = 0.05;
/// Share of an edge at its ends that belongs to the vertices.
const END: f64 = 1e-3;
/// The normal of a vertex and that of what it touches do not agree by more than this cosine: a choice that lets
/// a ridge touch.
const AGREEMENT: f64 = 0.5;

/// Distances, all in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Reach {
    /// What the surfaces keep.
    pub(super) skin_m: f64,
    /// Gap up to which there is a contact.
    pub(super) margin_m: f64,
    /// Way of a vertex for which a search serves.
    pub(super) slack_m: f64,
}

/// Contacts and features that found no room, and what moved too far for the search.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct NearReport {
    pub(super) n_dropped: u32,
    pub(super) n_searches: u32,
    pub(super) is_too_fast: bool,
}

/// The pairs.
#[derive(Clone, Debug)]
pub(super) struct Near {
    reach: Reach,
    search: PairSearch,
    pairs: Vec<ClosePair>,
    /// Vertex and triangle, ascending.
    corners: Vec<[u32; 2]>,
    /// Two ridges, ascending.
    ridges: Vec<[u32; 2]>,
    normals: Vec<DVec3>,
    /// Positions of the last search [m].
    searched_m: Vec<DVec3>,
    is_searched: bool,
    /// One surface that does not touch itself: there are no pairs.
    is_alone: bool,
    n_bodies: u32,
    report: NearReport,
    /// Counts searches that changed which vertices are near.
    version: u64,
}

impl Near {
    pub(super) fn new(
        surfaces: &Surfaces,
        n_bodies: usize,
        reach: Reach,
        self_collision: bool,
        room: usize,
    ) -> Self {
        let params = PairSearchParams {
            kind: BroadPhaseKind::Hierarchy,
            self_collision,
            margin_m: reach.skin_m + reach.margin_m + reach.slack_m,
            pair_capacity: 4 * room,
        };
        let search =
            PairSearch::new(&params, &surfaces.start_m, &surfaces.triangles, &surfaces.triangle_owner);
        Self {
            reach,
            search,
            pairs: Vec::with_capacity(4 * room),
            corners: Vec::with_capacity(room),
            ridges: Vec::with_capacity(room),
            normals: vec![DVec3::ZERO; surfaces.owner.len()],
            searched_m: surfaces.start_m.clone(),
            is_searched: false,
            is_alone: !self_collision && surfaces.triangle_owner.windows(2).all(|pair| pair[0] == pair[1]),
            n_bodies: n_bodies as u32,
            report: NearReport::default(),
            version: 0,
        }
    }

    pub(super) fn report(&self) -> NearReport {
        self.report
    }

    pub(super) fn version(&self) -> u64 {
        self.version
    }

    /// Vertices that may touch something in the next steps, with repetitions.
    pub(super) fn for_each_near_vertex(&self, surfaces: &Surfaces, mut tell: impl FnMut(u32)) {
        for &[v, t] in &self.corners {
            tell(v);
            surfaces.triangles[t as usize].into_iter().for_each(&mut tell);
        }
        for &[e, f] in &self.ridges {
            for edge in [e, f] {
                surfaces.edges[edge as usize].into_iter().for_each(&mut tell);
            }
        }
    }

    /// Follows the surfaces in a step whose moves are as yet without contact.
    pub(super) fn update(&mut self, surfaces: &Surfaces) {
        self.report.n_searches = 0;
        self.report.n_dropped = 0;
        self.report.is_too_fast = false;
        if self.is_alone {
            return;
        }
        let served_m = 0.5 * self.reach.slack_m;
        let is_outside = |way_m: DVec3| way_m.length_squared() > served_m * served_m;
        let has_left = |now: &Self| {
            let places = surfaces.start_m.iter().zip(&surfaces.moves_m).zip(&now.searched_m);
            places
                .into_iter()
                .any(|((start, m), at)| is_outside(*start - *at) || is_outside(*start + *m - *at))
        };
        if !self.is_searched || has_left(self) {
            self.search(surfaces);
            self.report.is_too_fast = surfaces.moves_m.iter().any(|m| is_outside(*m));
        }
    }

    fn search(&mut self, surfaces: &Surfaces) {
        self.is_searched = true;
        self.version += 1;
        self.report.n_searches += 1;
        self.searched_m.copy_from_slice(&surfaces.start_m);
        self.normals.fill(DVec3::ZERO);
        for (t, corners) in surfaces.triangles.iter().enumerate() {
            let area_m2 = surfaces.area_m2(t as u32);
            for &v in corners {
                self.normals[v as usize] += area_m2;
            }
        }
        self.normals.iter_mut().for_each(|n| *n = n.normalize_or_zero());
        self.search.update(&surfaces.start_m);
        let count = self.search.close_into(&mut self.pairs);
        self.report.n_dropped += count.n_dropped as u32;
        self.corners.clear();
        self.ridges.clear();
        let within_m = self.reach.skin_m + self.reach.margin_m + self.reach.slack_m;
        for place in 0..self.pairs.len() {
            self.add_features(surfaces, self.pairs[place].triangles, within_m);
        }
        self.corners.sort_unstable();
        self.ridges.sort_unstable();
    }

    /// Adds the features of two triangles, each for the first triangle that has it.
    fn add_features(&mut self, surfaces: &Surfaces, [s, t]: [u32; 2], within_m: f64) {
        let is_rigid = |t: u32| surfaces.triangle_owner[t as usize] >= self.n_bodies;
        if is_rigid(s) && is_rigid(t) {
            return;
        }
        let is_same = surfaces.triangle_owner[s as usize] == surfaces.triangle_owner[t as usize];
        let agreement = if is_same { 0.0 } else { AGREEMENT };
        let mut has_room = true;
        for [s, t] in [[s, t], [t, s]] {
            let face = surfaces.area_m2(t).normalize_or_zero();
            for v in surfaces.triangles[s as usize] {
                if surfaces.first_triangle[v as usize] != s
                    || self.normals[v as usize].dot(face) > agreement
                    || surfaces.triangles[t as usize].contains(&v)
                {
                    continue;
                }
                let (point_m, corners_m) = (surfaces.start_m[v as usize], surfaces.corners_m(t));
                let near_m = at_weights(corners_m, closest_weights(point_m, corners_m));
                if near_m.distance(point_m) <= within_m {
                    has_room &= push(&mut self.corners, [v, t]);
                }
            }
        }
        for e in surfaces.triangle_edges[s as usize] {
            if surfaces.edge_triangles[e as usize][0] != s || !surfaces.is_ridge(e, RIDGE) {
                continue;
            }
            for f in surfaces.triangle_edges[t as usize] {
                let ends = surfaces.edges[e as usize];
                let is_apart = surfaces.edges[f as usize].iter().all(|v| !ends.contains(v));
                if is_apart
                    && surfaces.edge_triangles[f as usize][0] == t
                    && surfaces.is_ridge(f, RIDGE)
                    && edges_m(surfaces, [e, f]).is_some_and(|(_, _, d)| d <= within_m)
                {
                    has_room &= push(&mut self.ridges, [e, f]);
                }
            }
        }
        self.report.n_dropped += u32::from(!has_room);
    }

    /// Adds the contacts of the step, obstacles included, in an order that depends on the numbering alone.
    pub(super) fn contacts_into(
        &mut self,
        surfaces: &Surfaces,
        obstacles: &[MovingObstacle],
        contacts: &mut Vec<Contact>,
    ) {
        contacts.clear();
        for of_vertex in self.corners.chunk_by(|a, b| a[0] == b[0]) {
            let first = contacts.len();
            for &[v, t] in of_vertex {
                if let Some(found) = self.vertex_and_triangle(surfaces, v, t) {
                    self.report.n_dropped += u32::from(!keep(contacts, first, &found, surfaces));
                }
            }
        }
        for &[e, f] in &self.ridges {
            if let Some(contact) = self.edge_and_edge(surfaces, e, f) {
                self.report.n_dropped += u32::from(!push(contacts, contact));
            }
        }
        for (o, obstacle) in obstacles.iter().enumerate() {
            self.against(surfaces, obstacle, o as u32, contacts);
        }
    }

    /// Whether a gap may close in the step, or nearly.
    fn counts(&self, contact: &Contact, surfaces: &Surfaces) -> bool {
        let end_m = contact.gap_m + contact.normal.dot(contact.relative_m(&surfaces.moves_m));
        contact.gap_m.min(end_m) <= self.reach.margin_m && contact.gap_m.is_finite()
    }

    fn vertex_and_triangle(&self, surfaces: &Surfaces, v: u32, t: u32) -> Option<Found> {
        let (point_m, corners_m) = (surfaces.start_m[v as usize], surfaces.corners_m(t));
        let weights = closest_weights(point_m, corners_m);
        let off_m = point_m - at_weights(corners_m, weights);
        let face = surfaces.area_m2(t).normalize_or_zero();
        let above_m = off_m.dot(face);
        let is_within = weights.iter().all(|w| *w > 0.0);
        let (normal, distance_m) = if is_within {
            (face, above_m)
        } else {
            // Beside the triangle: above the plane only, and rounded unless nearly above the triangle itself.
            let beside_m = (off_m - face * above_m).length();
            if above_m <= 0.0 {
                return None;
            }
            if beside_m <= self.reach.skin_m {
                (face, above_m)
            } else {
                (off_m.normalize_or_zero(), off_m.length())
            }
        };
        let key = ContactKey::VertexTriangle(v, t);
        let mut contact = Contact::new(key, normal, distance_m - self.reach.skin_m);
        let [a, b, c] = surfaces.triangles[t as usize];
        contact.vertices = [v, a, b, c];
        contact.weights = [1.0, -weights[0], -weights[1], -weights[2]];
        contact.point_m = point_m;
        let is_deep = distance_m < -(self.reach.skin_m + self.reach.margin_m);
        (!is_deep && self.counts(&contact, surfaces)).then_some(Found { contact, is_within })
    }

    fn edge_and_edge(&self, surfaces: &Surfaces, e: u32, f: u32) -> Option<Contact> {
        let ([s, t], off_m, distance_m) = edges_m(surfaces, [e, f])?;
        let (first, second) = (surfaces.edge_normal(e), surfaces.edge_normal(f));
        let direction = off_m.normalize_or_zero();
        let is_apart = direction.dot(second) > 0.0 && direction.dot(first) < 0.0;
        let is_inside = direction.dot(second) < 0.0 && direction.dot(first) > 0.0;
        if !(is_apart || is_inside) {
            return None;
        }
        let sign = if is_apart { 1.0 } else { -1.0 };
        let gap_m = sign * distance_m - self.reach.skin_m;
        let mut contact = Contact::new(ContactKey::Edges(e, f), direction * sign, gap_m);
        let ([a, b], [c, d]) = (surfaces.edges[e as usize], surfaces.edges[f as usize]);
        contact.vertices = [a, b, c, d];
        contact.weights = [1.0 - s, s, t - 1.0, -t];
        contact.point_m = surfaces.start_m[a as usize].lerp(surfaces.start_m[b as usize], s);
        let is_deep = sign * distance_m < -(self.reach.skin_m + self.reach.margin_m);
        (!is_deep && self.counts(&contact, surfaces)).then_some(contact)
    }

    /// Contacts of all bodies with one obstacle.
    fn against(
        &mut self,
        surfaces: &Surfaces,
        obstacle: &MovingObstacle,
        o: u32,
        contacts: &mut Vec<Contact>,
    ) {
        let bodies = surfaces.vertices_of(0).start..surfaces.starts[self.n_bodies as usize] as usize;
        let partner = self.n_bodies + o;
        for v in bodies {
            let point_m = surfaces.start_m[v];
            let Some(place) = obstacle.place_near(point_m) else { return };
            let way_m = surfaces.moves_m[v].length() + self.reach.margin_m + self.reach.skin_m;
            if place.distance_m > way_m && place.distance_m > self.reach.margin_m + self.reach.skin_m {
                continue;
            }
            let key = ContactKey::VertexObstacle(v as u32, partner);
            let mut contact = Contact::new(key, place.normal, place.distance_m - self.reach.skin_m);
            contact.vertices[0] = v as u32;
            contact.weights[0] = 1.0;
            contact.point_m = point_m;
            contact.moved_m = obstacle.motion_at_m(point_m - place.normal * place.distance_m);
            if self.counts(&contact, surfaces) {
                self.report.n_dropped += u32::from(!push(contacts, contact));
            }
        }
        if obstacle.is_round() {
            self.against_round(surfaces, obstacle, partner, contacts);
        }
    }

    /// Contacts between the vertices with a ball: where each triangle and each edge is nearest. One place alone would let a
    /// large triangle rock on it, and bulge into the ball beside it.
    fn against_round(
        &mut self,
        surfaces: &Surfaces,
        obstacle: &MovingObstacle,
        partner: u32,
        contacts: &mut Vec<Contact>,
    ) {
        let within_m = self.reach.margin_m + self.reach.skin_m;
        let n_bodies = self.n_bodies;
        let is_of_body = |v: u32| surfaces.owner[v as usize] < n_bodies;
        let mut add = |key: ContactKey, vertices: [u32; 3], weights: [f64; 3]| {
            let point_m = at_weights(vertices.map(|v| surfaces.start_m[v as usize]), weights);
            let Some(place) = obstacle.place_near(point_m) else { return };
            let mut contact = Contact::new(key, place.normal, place.distance_m - self.reach.skin_m);
            let ([a, b, c], [u, v, w]) = (vertices, weights);
            contact.vertices = [a, b, c, 0];
            contact.weights = [u, v, w, 0.0];
            contact.point_m = point_m;
            contact.moved_m = obstacle.motion_at_m(point_m - place.normal * place.distance_m);
            if self.counts(&contact, surfaces) {
                self.report.n_dropped += u32::from(!push(contacts, contact));
            }
        };
        for (t, corners) in surfaces.triangles.iter().enumerate().take_while(|(_, c)| is_of_body(c[0])) {
            if let Some(weights) = obstacle.between_edges(surfaces.corners_m(t as u32), within_m) {
                add(ContactKey::TriangleObstacle(t as u32, partner), *corners, weights);
            }
        }
        for (e, &[a, b]) in surfaces.edges.iter().enumerate().take_while(|(_, ends)| is_of_body(ends[0])) {
            let ends_m = [a, b].map(|v| surfaces.start_m[v as usize]);
            if let Some(share) = obstacle.between_ends(ends_m, within_m) {
                add(ContactKey::EdgeObstacle(e as u32, partner), [a, b, b], [1.0 - share, share, 0.0]);
            }
        }
    }
}

/// A contact of a vertex, and whether it is above the triangle itself.
struct Found {
    contact: Contact,
    is_within: bool,
}

/// Keeps a contact of a vertex beside those from place `first` on: all that are above their triangle, and where there is
/// none, for each partner the nearest. False when there was no room.
fn keep(contacts: &mut Vec<Contact>, first: usize, found: &Found, surfaces: &Surfaces) -> bool {
    let &Found { contact, is_within } = found;
    let partner = |c: &Contact| surfaces.owner[c.vertices[1] as usize];
    let is_beside = |c: &Contact| c.weights[1..].contains(&0.0);
    let of_partner = |c: &&mut Contact| partner(c) == partner(&contact);
    if is_within {
        if let Some(beside) = contacts[first..].iter_mut().filter(of_partner).find(|c| is_beside(c)) {
            *beside = contact;
            return true;
        }
    } else if let Some(known) = contacts[first..].iter_mut().find(|c| partner(c) == partner(&contact)) {
        if is_beside(known) && contact.gap_m < known.gap_m {
            *known = contact;
        }
        return true;
    }
    push(contacts, contact)
}

fn push<T>(list: &mut Vec<T>, value: T) -> bool {
    let has_room = list.len() < list.capacity();
    if has_room {
        list.push(value);
    }
    has_room
}

/// Shares along two edges of their nearest points, the way from the second to the first and its length [m]; nothing where
/// a nearest point is at an end.
fn edges_m(surfaces: &Surfaces, [e, f]: [u32; 2]) -> Option<([f64; 2], DVec3, f64)> {
    let ends = |edge: u32| surfaces.edges[edge as usize].map(|v| surfaces.start_m[v as usize]);
    let (first, second) = (ends(e), ends(f));
    let closest = closest_on_segments(first, second);
    let share = |[a, b]: [DVec3; 2], p: DVec3| (p - a).dot(b - a) / (b - a).length_squared();
    let shares = [share(first, closest.first_m), share(second, closest.second_m)];
    let is_between = shares.iter().all(|s| (END..=1.0 - END).contains(s));
    is_between.then_some((shares, closest.first_m - closest.second_m, closest.distance_m))
}
