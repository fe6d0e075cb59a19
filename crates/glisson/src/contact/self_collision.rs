//! Triangles of deforming surfaces against each other: of one organ (self-collision) and of several.
//!
//! All surfaces share one list of vertices and one of triangles. Attached triangles (a common vertex) never count. Pairs
//! that are reported are sorted, so that they do not depend on the structure that found them nor on its history.

use super::boxes::{PairRules, RoundedBox, fill_vertex_boxes};
use super::broad_phase::{BroadPhase, BroadPhaseKind, Wanted};
use super::continuous::{FirstContact, two_triangles};
use super::triangle_lanes::keep_unparted;
use super::triangles::{Closest, closest_on_triangles, triangles_meet};
use crate::math::DVec3;
use fearless_simd::Level;

/// What is searched, and with how much room.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairSearchParams {
    /// Structure of the broad phase.
    pub kind: BroadPhaseKind,
    /// Whether triangles of one body count.
    pub self_collision: bool,
    /// Distance up to which pairs are reported by [`PairSearch::close_into`] [m].
    pub margin_m: f64,
    /// Pairs of overlapping boxes at one time at most, attached ones not counted: sweep and prune needs room for them.
    pub pair_capacity: usize,
}

/// A close pair of triangles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClosePair {
    /// The triangles, ascending.
    pub triangles: [u32; 2],
    /// Their closest points.
    pub closest: Closest,
}

/// A pair of triangles that come into contact during a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MovingPair {
    /// The triangles, ascending.
    pub triangles: [u32; 2],
    /// When and where; the triangle of lower index is the first body.
    pub contact: FirstContact,
}

/// What fits into a list that does not grow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PairCount {
    /// Pairs of triangles whose boxes overlap.
    pub n_candidates: usize,
    /// Pairs that found no room, in the caller's list or in the structure. Above 0 the answer is incomplete: make room
    /// for twice as many between two steps.
    pub n_dropped: usize,
}

/// The search. Updating and asking never allocate.
#[derive(Clone, Debug)]
pub struct PairSearch {
    rules: PairRules,
    margin_m: f64,
    /// Boxes of the vertices.
    corners: Vec<RoundedBox>,
    boxes: Vec<RoundedBox>,
    /// Vertices at the end of the step [m].
    positions_m: Vec<DVec3>,
    structure: BroadPhase,
}

impl PairSearch {
    /// For `triangles` (vertices counted over all bodies) of the bodies `body_of`.
    ///
    /// # Panics
    /// When the two lists differ in length.
    pub fn new(
        params: &PairSearchParams,
        positions_m: &[DVec3],
        triangles: &[[u32; 3]],
        body_of: &[u32],
    ) -> Self {
        let rules = PairRules::new(triangles, body_of, params.self_collision);
        let mut corners = vec![RoundedBox::NOTHING; positions_m.len()];
        let mut boxes = vec![RoundedBox::NOTHING; triangles.len()];
        // Half of the margin for each of the two.
        fill_vertex_boxes(positions_m, positions_m, 0.5 * params.margin_m, &mut corners);
        fill_triangle_boxes(&rules, &corners, &mut boxes);
        let wanted = Wanted::Pairs { capacity: params.pair_capacity };
        let structure = BroadPhase::new(params.kind, &boxes, &rules, wanted);
        Self {
            rules,
            margin_m: params.margin_m,
            corners,
            boxes,
            positions_m: positions_m.to_vec(),
            structure,
        }
    }

    /// The structure in use.
    pub fn structure(&self) -> &BroadPhase {
        &self.structure
    }

    /// Boxes of the last update.
    pub fn boxes(&self) -> &[RoundedBox] {
        &self.boxes
    }

    /// Which pairs count.
    pub fn rules(&self) -> &PairRules {
        &self.rules
    }

    /// Follows the surfaces; the boxes hold the margin. As many vertices as at the start.
    ///
    /// # Panics
    /// When there are fewer or more.
    pub fn update(&mut self, positions_m: &[DVec3]) {
        self.update_moving(positions_m, positions_m);
    }

    /// Follows surfaces whose vertices move on straight lines during the step; the boxes hold the whole way and the
    /// margin. [`PairSearch::meeting_into`] and [`PairSearch::close_into`] then speak of the end of the step.
    ///
    /// # Panics
    /// When there are fewer or more vertices than at the start.
    pub fn update_moving(&mut self, start_m: &[DVec3], end_m: &[DVec3]) {
        assert_eq!(start_m.len(), end_m.len(), "a start and an end for each vertex");
        self.positions_m.copy_from_slice(end_m);
        fill_vertex_boxes(start_m, end_m, 0.5 * self.margin_m, &mut self.corners);
        fill_triangle_boxes(&self.rules, &self.corners, &mut self.boxes);
        self.structure.update(&self.boxes, &self.rules);
    }

    /// Boxes of the vertices at the last update, each with half of the margin as those of the triangles; they reach to
    /// infinity for vertices that are broken.
    pub(super) fn vertex_boxes(&self) -> &[RoundedBox] {
        &self.corners
    }

    fn corners_m(&self, t: u32) -> [DVec3; 3] {
        self.rules.vertices(t).map(|v| self.positions_m[v as usize])
    }

    /// Writes the pairs of triangles that meet now into `found`, sorted, as far as its capacity goes.
    pub fn meeting_into(&self, found: &mut Vec<[u32; 2]>) -> PairCount {
        found.clear();
        let level = Level::new();
        let mut n_dropped = self.structure.n_dropped() as usize;
        let n_candidates = self.for_each_block(|pairs| {
            let n_left = keep_unparted(level, pairs, &self.positions_m, self.rules.triangles());
            for &[s, t] in &pairs[..n_left] {
                if triangles_meet(self.corners_m(s), self.corners_m(t)) {
                    n_dropped += usize::from(!push_if_room(found, [s, t]));
                }
            }
        });
        found.sort_unstable();
        PairCount { n_candidates, n_dropped }
    }

    /// Writes the pairs that are no further apart than the margin into `found`, with their closest points, sorted, as far
    /// as its capacity goes.
    pub fn close_into(&self, found: &mut Vec<ClosePair>) -> PairCount {
        found.clear();
        let count = self.collect(found, |s, t| {
            let closest = closest_on_triangles(self.corners_m(s), self.corners_m(t));
            (closest.distance_m <= self.margin_m).then_some(ClosePair { triangles: [s, t], closest })
        });
        found.sort_unstable_by_key(|pair| pair.triangles);
        count
    }

    /// Writes the pairs that come closer than the margin during the step into `found`, each with its first contact,
    /// sorted by triangles, as far as its capacity goes. After [`PairSearch::update_moving`] with the same positions.
    pub fn first_contacts_into(
        &self,
        start_m: &[DVec3],
        end_m: &[DVec3],
        found: &mut Vec<MovingPair>,
    ) -> PairCount {
        found.clear();
        let corners = |t: u32| {
            let vertices = self.rules.vertices(t);
            [start_m, end_m].map(|list| vertices.map(|v| list[v as usize]))
        };
        let count = self.collect(found, |s, t| {
            let contact = two_triangles(corners(s), corners(t), self.margin_m, 1.0)?;
            Some(MovingPair { triangles: [s, t], contact })
        });
        found.sort_unstable_by_key(|pair| pair.triangles);
        count
    }

    /// Tests every pair of overlapping boxes.
    fn collect<T>(&self, found: &mut Vec<T>, mut test: impl FnMut(u32, u32) -> Option<T>) -> PairCount {
        let mut n_dropped = self.structure.n_dropped() as usize;
        let n_candidates = self.for_each_block(|pairs| {
            for &mut [s, t] in pairs {
                let Some(pair) = test(s, t) else { continue };
                n_dropped += usize::from(!push_if_room(found, pair));
            }
        });
        PairCount { n_candidates, n_dropped }
    }

    /// Calls `test_all` with the pairs of overlapping boxes, some hundreds at a time: searching and testing take turns, each
    /// with its own data and code. Answers how many there are.
    fn for_each_block(&self, mut test_all: impl FnMut(&mut [[u32; 2]])) -> usize {
        let mut waiting = [[0u32; 2]; N_WAITING];
        let (mut n_waiting, mut n_candidates) = (0, 0);
        self.structure.for_each_pair(&self.boxes, &self.rules, |s, t| {
            waiting[n_waiting] = [s, t];
            n_waiting += 1;
            n_candidates += 1;
            if n_waiting == N_WAITING {
                test_all(&mut waiting);
                n_waiting = 0;
            }
        });
        test_all(&mut waiting[..n_waiting]);
        n_candidates
    }
}

/// Whether there was room.
fn push_if_room<T>(found: &mut Vec<T>, item: T) -> bool {
    let has_room = found.len() < found.capacity();
    if has_room {
        found.push(item);
    }
    has_room
}

/// Pairs that wait for their test at most.
const N_WAITING: usize = 512;

fn fill_triangle_boxes(rules: &PairRules, corners: &[RoundedBox], boxes: &mut [RoundedBox]) {
    for (t, bounds) in boxes.iter_mut().enumerate() {
        *bounds = RoundedBox::around(rules.vertices(t as u32).map(|v| corners[v as usize]));
    }
}
