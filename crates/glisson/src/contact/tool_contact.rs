//! Instruments against a deforming surface: everything near, and the first contact of a step.

use super::boxes::{PairRules, RoundedBox, fill_vertex_boxes};
use super::broad_phase::{BroadPhase, BroadPhaseKind, Wanted};
use super::continuous::{FirstContact, capsule_and_triangle, two_triangles, weights_at};
use super::shapes::{Capsule, CapsuleMotion};
use super::triangles::{Closest, closest_on_segment_and_triangle, closest_weights};
use crate::math::DVec3;

/// A triangle that a tool touches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolContact {
    /// Which triangle.
    pub triangle: u32,
    /// Barycentric weights of the touched point.
    pub weights: [f64; 3],
    /// When and where; the tool is the first body.
    pub contact: FirstContact,
}

/// Boxes are larger than they have to be on each side by this share of the mean box's longest edge: a choice. They hold for as
/// many steps as the surface takes to go that far, and a little more is looked at.
const SLACK_SHARE: f64 = 0.05;
/// Vertices that are compared before it is seen whether one went too far.
const COMPARED: usize = 32;

/// A surface that deforms, searched for what a tool can touch. Updating and asking never allocate. What is found does not depend
/// on when the boxes were made, but for what [`SurfaceSearch::near_into`] has no room for.
#[derive(Clone, Debug)]
pub struct SurfaceSearch {
    /// Vertices of each slot; `None` for a slot that holds no triangle.
    triangles: Vec<Option<[u32; 3]>>,
    /// Where the vertices were when the boxes were made [m].
    boxed_m: Vec<DVec3>,
    /// How far they may go from there, along each axis, before the boxes are made anew [m].
    slack_m: f64,
    /// Whether a slot changed since then.
    is_stale: bool,
    /// Boxes of the vertices.
    corners: Vec<RoundedBox>,
    boxes: Vec<RoundedBox>,
    rules: PairRules,
    structure: BroadPhase,
}

impl SurfaceSearch {
    /// For `triangles` over `positions_m`, with room for `n_spare` more (a cut exposes new ones).
    pub fn new(kind: BroadPhaseKind, positions_m: &[DVec3], triangles: &[[u32; 3]], n_spare: usize) -> Self {
        let mut slots: Vec<Option<[u32; 3]>> = triangles.iter().copied().map(Some).collect();
        slots.resize(triangles.len() + n_spare, None);
        let mut corners = vec![RoundedBox::NOTHING; positions_m.len()];
        let mut boxes = vec![RoundedBox::NOTHING; slots.len()];
        fill_boxes(&slots, [positions_m; 2], 0.0, &mut corners, &mut boxes);
        let slack_m = SLACK_SHARE * mean_longest_edge_m(&boxes);
        fill_boxes(&slots, [positions_m; 2], slack_m, &mut corners, &mut boxes);
        let rules = PairRules::new(&[], &[], false);
        let structure = BroadPhase::new(kind, &boxes, &rules, Wanted::Queries);
        let boxed_m = positions_m.to_vec();
        Self { triangles: slots, boxed_m, slack_m, is_stale: false, corners, boxes, rules, structure }
    }

    /// Puts a triangle into a slot, or takes it out; counts from the next update on.
    ///
    /// # Panics
    /// When there is no such slot.
    pub fn set_triangle(&mut self, slot: u32, triangle: Option<[u32; 3]>) {
        self.triangles[slot as usize] = triangle;
        self.is_stale = true;
    }

    /// Vertices of the triangle in a slot.
    pub fn triangle(&self, slot: u32) -> Option<[u32; 3]> {
        self.triangles.get(slot as usize).copied().flatten()
    }

    /// Number of slots.
    pub fn n_slots(&self) -> usize {
        self.triangles.len()
    }

    /// The structure in use.
    pub fn structure(&self) -> &BroadPhase {
        &self.structure
    }

    /// Follows a surface whose vertices move on straight lines from `start_m` to `end_m` during the step; the same list
    /// twice for a surface that stands still. The boxes stay as they are while they hold it. At least as many vertices as at the start; more do not count.
    ///
    /// # Panics
    /// When either list has fewer.
    pub fn update(&mut self, start_m: &[DVec3], end_m: &[DVec3]) {
        let (n, fewer) = (self.corners.len(), start_m.len().min(end_m.len()));
        assert!(fewer >= n, "{fewer} positions of {n} vertices");
        let boxes_hold = !self.is_stale && [start_m, end_m].iter().all(|m| self.holds(m));
        if boxes_hold {
            return;
        }
        fill_boxes(&self.triangles, [start_m, end_m], self.slack_m, &mut self.corners, &mut self.boxes);
        self.structure.update(&self.boxes, &self.rules);
        self.boxed_m.copy_from_slice(&end_m[..n]);
        self.is_stale = false;
    }

    /// Whether the boxes hold the surface with its vertices here. One that is not finite is in no box.
    fn holds(&self, positions_m: &[DVec3]) -> bool {
        let is_near = |(now_m, boxed_m): (&DVec3, &DVec3)| {
            let gone_m = (*now_m - *boxed_m).abs();
            (gone_m.x <= self.slack_m) & (gone_m.y <= self.slack_m) & (gone_m.z <= self.slack_m)
        };
        let mut pairs = positions_m.chunks(COMPARED).zip(self.boxed_m.chunks(COMPARED));
        pairs.all(|(now_m, boxed_m)| now_m.iter().zip(boxed_m).fold(true, |all, pair| all & is_near(pair)))
    }

    /// First contact of the step of a capsule with the surface of the last update, which was given the same positions:
    /// the earliest; of several at once the deepest, then the lower triangle.
    pub fn first_contact(
        &self,
        capsule: &CapsuleMotion,
        start_m: &[DVec3],
        end_m: &[DVec3],
    ) -> Option<ToolContact> {
        self.first_contact_among(capsule, start_m, end_m, &|_, _| true)
    }

    /// [`SurfaceSearch::first_contact`] of those that count: answered for a triangle and its own first contact.
    pub fn first_contact_among(
        &self,
        capsule: &CapsuleMotion,
        start_m: &[DVec3],
        end_m: &[DVec3],
        counts: &dyn Fn(u32, &FirstContact) -> bool,
    ) -> Option<ToolContact> {
        let mut best: Option<(u32, FirstContact)> = None;
        // The tolerance is searched too, so that what is found does not depend on the boxes.
        let reach = capsule.reach(super::continuous::CONTACT_TOLERANCE_M);
        self.structure.for_each_near(&self.boxes, &reach, |t| {
            let Some(triangle) = self.triangles[t as usize] else { return };
            let latest = latest_of_interest(best.as_ref());
            let (start, end) = (corners(triangle, start_m), corners(triangle, end_m));
            let found = capsule_and_triangle(capsule, start, end, latest);
            if let Some(found) = found.filter(|found| counts(t, found)) {
                keep_first(&mut best, t, found);
            }
        });
        self.with_weights(best?, start_m, end_m)
    }

    /// First contact of the step of one triangle of a moving tool mesh, corners at the start and at the end, grown by
    /// `reach_m` (at least the path error of [`super::shapes::MeshShape`]).
    pub fn first_contact_of_triangle(
        &self,
        tool_m: [[DVec3; 3]; 2],
        reach_m: f64,
        start_m: &[DVec3],
        end_m: &[DVec3],
    ) -> Option<ToolContact> {
        self.first_contact_of_triangle_among((tool_m, reach_m), start_m, end_m, &|_, _| true)
    }

    /// [`SurfaceSearch::first_contact_of_triangle`] of those that count.
    pub fn first_contact_of_triangle_among(
        &self,
        (tool_m, reach_m): ([[DVec3; 3]; 2], f64),
        start_m: &[DVec3],
        end_m: &[DVec3],
        counts: &dyn Fn(u32, &FirstContact) -> bool,
    ) -> Option<ToolContact> {
        let bounds = RoundedBox::of_moving_triangle(
            tool_m[0],
            tool_m[1],
            reach_m + super::continuous::CONTACT_TOLERANCE_M,
        );
        let (low_m, high_m) = (bounds.low_m().as_dvec3(), bounds.high_m().as_dvec3());
        let middle_m = 0.5 * (low_m + high_m);
        let around = super::boxes::ThickSegment {
            from_m: middle_m,
            to_m: middle_m,
            radius_m: 0.5 * (high_m - low_m).max_element() * (1.0 + 1e-6),
        };
        let mut best: Option<(u32, FirstContact)> = None;
        self.structure.for_each_near(&self.boxes, &around, |t| {
            let Some(triangle) = self.triangles[t as usize] else { return };
            if !bounds.overlaps(&self.boxes[t as usize]) {
                return;
            }
            let latest = latest_of_interest(best.as_ref());
            let second_m = [corners(triangle, start_m), corners(triangle, end_m)];
            let found = two_triangles(tool_m, second_m, reach_m, latest);
            if let Some(found) = found.filter(|found| counts(t, found)) {
                keep_first(&mut best, t, found);
            }
        });
        self.with_weights(best?, start_m, end_m)
    }

    /// The contact with the weights of its triangle's corners.
    #[inline]
    fn with_weights(
        &self,
        (triangle, contact): (u32, FirstContact),
        start_m: &[DVec3],
        end_m: &[DVec3],
    ) -> Option<ToolContact> {
        let vertices = self.triangles[triangle as usize]?;
        let weights = weights_at(&contact, corners(vertices, start_m), corners(vertices, end_m));
        Some(ToolContact { triangle, weights, contact })
    }

    /// Puts the triangles that are nearest to a resting capsule, and within `reach_m` of it, into `found`, nearest first and of
    /// equal ones the lower triangle first: as many as it has room for, whatever lies further out. What was in it goes.
    pub fn nearest_into(
        &self,
        capsule: &Capsule,
        reach_m: f64,
        positions_m: &[DVec3],
        found: &mut Vec<ToolContact>,
    ) {
        found.clear();
        self.for_each_within(capsule, reach_m, positions_m, |t, gap_m, contact| {
            let before =
                |near: &ToolContact| near.contact.gap_m.total_cmp(&gap_m).then(near.triangle.cmp(&t)).is_lt();
            let place = found.partition_point(before);
            if found.len() == found.capacity() {
                if place == found.len() {
                    return;
                }
                found.pop();
            }
            found.insert(place, contact());
        });
    }

    /// Appends every triangle that is within `margin_m` of a resting capsule to `found`, ascending by triangle, as far
    /// as its capacity goes; answers how many found no room.
    pub fn near_into(
        &self,
        capsule: &Capsule,
        margin_m: f64,
        positions_m: &[DVec3],
        found: &mut Vec<ToolContact>,
    ) -> usize {
        let first = found.len();
        let mut n_dropped = 0;
        self.for_each_within(capsule, margin_m, positions_m, |_, _, contact| {
            if found.len() == found.capacity() {
                n_dropped += 1;
                return;
            }
            found.push(contact());
        });
        found[first..].sort_unstable_by_key(|c| c.triangle);
        n_dropped
    }

    /// Visits triangles within `reach_m` of a resting capsule in no certain order, with their gap [m] and a contact that is
    /// made when it is asked for.
    fn for_each_within(
        &self,
        capsule: &Capsule,
        reach_m: f64,
        positions_m: &[DVec3],
        mut visit: impl FnMut(u32, f64, &dyn Fn() -> ToolContact),
    ) {
        self.structure.for_each_near(&self.boxes, &capsule.reach(reach_m), |t| {
            let Some(triangle) = self.triangles[t as usize] else { return };
            let corners_m = corners(triangle, positions_m);
            let closest = closest_on_segment_and_triangle([capsule.from_m, capsule.to_m], corners_m);
            let gap_m = closest.distance_m - capsule.radius_m;
            if gap_m > reach_m {
                return;
            }
            visit(t, gap_m, &|| ToolContact {
                triangle: t,
                weights: closest_weights(closest.second_m, corners_m),
                contact: resting(&closest, gap_m),
            });
        });
    }
}

/// Later contacts than the one that is known do not matter. A little more is allowed, so that triangles that are touched
/// at the same time are all looked at, in whatever order they come.
fn latest_of_interest(best: Option<&(u32, FirstContact)>) -> f64 {
    best.map_or(1.0, |(_, found)| (found.time + 1e-12).min(1.0))
}

fn resting(closest: &Closest, gap_m: f64) -> FirstContact {
    FirstContact {
        time: 0.0,
        points_m: [closest.first_m, closest.second_m],
        normal: (closest.first_m - closest.second_m).normalize_or_zero(),
        gap_m,
    }
}

fn corners(triangle: [u32; 3], positions_m: &[DVec3]) -> [DVec3; 3] {
    triangle.map(|v| positions_m[v as usize])
}

fn mean_longest_edge_m(boxes: &[RoundedBox]) -> f64 {
    let edges_m = || boxes.iter().filter(|b| !b.is_nothing()).map(|b| f64::from(b.size_m().max_element()));
    edges_m().sum::<f64>() / edges_m().count().max(1) as f64
}

/// Boxes of triangles whose vertices move between these places, with `slack_m` around them.
fn fill_boxes(
    triangles: &[Option<[u32; 3]>],
    [start_m, end_m]: [&[DVec3]; 2],
    slack_m: f64,
    corners: &mut [RoundedBox],
    boxes: &mut [RoundedBox],
) {
    fill_vertex_boxes(start_m, end_m, slack_m, corners);
    for (bounds, triangle) in boxes.iter_mut().zip(triangles) {
        *bounds = match triangle {
            Some(vertices) => RoundedBox::around(vertices.map(|v| corners[v as usize])),
            None => RoundedBox::NOTHING,
        };
    }
}

fn keep_first(best: &mut Option<(u32, FirstContact)>, triangle: u32, found: FirstContact) {
    let is_first = match best {
        None => true,
        Some((t, b)) => {
            found.time < b.time
                || found.time == b.time && (found.gap_m < b.gap_m || found.gap_m == b.gap_m && triangle < *t)
        }
    };
    if is_first {
        *best = Some((triangle, found));
    }
}
