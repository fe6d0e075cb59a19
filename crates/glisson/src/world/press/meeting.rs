//! Where instruments meet each other.
//!
//! Parts are capsules that move from where they were before the step to where they would be alone. Where two of them meet first
//! on that way ([`two_capsules`]: nothing is passed, however fast), the plane between them is kept: with the unit vector n from
//! the second to the first, the gap g then and the rest of the way u of one place against the other, n.u + g must not fall below
//! zero. Parts that do not meet on their way but are near may still be pushed onto each other by what else they touch: they
//! have the plane between their places before the step, unless their own way leads around it. Beside the places that are nearest
//! the ends of either axis touch: parts that lie along each other touch at both ends of what they share.
//!
//! Each such place is a contact of the one system, between the vertices by which each instrument moves and turns as a whole. Both feel the same force, in opposite directions. Parts that overlap when they were put there are
//! pushed out slowly, as tissue is.

use super::points::{AROUND, along_axis};
use crate::contact::continuous::two_capsules;
use crate::contact::shapes::{Capsule, CapsuleMotion};
use crate::contact::triangles::closest_on_segments;
use crate::math::{DMat3, DVec3};
use crate::tool::pose::ToolFrame;
use crate::tool::{Tool, ToolInput};
use crate::world::parts::{ToolPart, capsule_for_tools, motion_for_tools};

/// Places at which two parts may touch: the nearest, and the ends of either axis.
const PLACES: usize = 5;
/// Places at which two instruments touch at most, the deepest: a choice, above the five of two shafts along each other and those
/// of their tips.
pub(super) const MOST_OF_PAIR: usize = 12;
/// Pairs of parts of two instruments.
const PART_PAIRS: usize = ToolPart::ALL.len() * ToolPart::ALL.len();
/// Places at which two instruments are found to touch, at most.
pub(super) const MOST_MET: usize = PLACES * PART_PAIRS;
/// Axes that are nearer to each other than this [m] say of no direction that it leads out.
const ONE_PLACE_M: f64 = 1e-9;

/// Which places of which instruments touch, for telling them again in the next step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct PairKey {
    tools: [u8; 2],
    parts: [u8; 2],
    /// 0: the nearest places; 1 and 2: the ends of the first part; 3 and 4: those of the second.
    place: u8,
}

/// A place where an instrument pressed on another in the last step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::world) struct PairContact {
    pub(super) key: PairKey,
    /// Unit vector from the second instrument to the first.
    pub(in crate::world) normal: DVec3,
    /// Where, on the first [m].
    pub(in crate::world) place_m: DVec3,
    /// Force on the first [N].
    pub(in crate::world) force_n: DVec3,
}

impl PairContact {
    /// The numbers of both instruments.
    pub(in crate::world) fn tools(&self) -> [usize; 2] {
        self.key.tools.map(usize::from)
    }

    /// Force on one of the instruments [N].
    pub(in crate::world) fn force_on_n(&self, tool: usize) -> DVec3 {
        let [first, second] = self.tools();
        if tool == first {
            self.force_n
        } else if tool == second {
            -self.force_n
        } else {
            DVec3::ZERO
        }
    }

    /// Everything that the next step depends on.
    pub(super) fn numbers(&self) -> [f64; 11] {
        let PairKey { tools: [a, b], parts: [c, d], place } = self.key;
        let [nx, ny, nz] = self.normal.to_array();
        let [x, y, z] = self.force_n.to_array();
        let [a, b, c, d, place] = [a, b, c, d, place].map(f64::from);
        [a, b, c, d, place, nx, ny, nz, x, y, z]
    }
}

/// Two instruments on their way.
#[derive(Clone, Copy)]
pub(super) struct ToolPair<'a> {
    pub(super) tools: [usize; 2],
    pub(super) specs: [&'a Tool; 2],
    /// Before the step, and where each would be alone.
    pub(super) ways: [[&'a ToolInput; 2]; 2],
}

impl ToolPair<'_> {
    /// Whether the instruments come so near to each other in the step, taken as thick as their jaws are long.
    fn may_meet(&self, margin_m: f64) -> bool {
        let axis = |tool: usize, time: usize| {
            let pose = self.ways[tool][time];
            let end_m = pose.tip_in_world_m + pose.shaft_in_world * self.specs[tool].shaft_length_m;
            [pose.tip_in_world_m, end_m]
        };
        let reach_m = |tool: usize| {
            let spec = self.specs[tool];
            let jaws_m = spec.kind.jaws().map_or(0.0, |jaws| jaws.length_m);
            let blade_m = spec.kind.blade().map_or(0.0, |blade| blade.length_m);
            let [before_m, now_m] = [axis(tool, 0), axis(tool, 1)];
            let way_m = before_m[0].distance(now_m[0]).max(before_m[1].distance(now_m[1]));
            spec.tip_radius_m.max(spec.shaft_radius_m) + jaws_m.max(blade_m) + way_m
        };
        let apart_m = closest_on_segments(axis(0, 0), axis(1, 0)).distance_m;
        // Also where it is no number: then nothing is found.
        let is_far = apart_m > reach_m(0) + reach_m(1) + margin_m + AROUND * (reach_m(0) + reach_m(1));
        !is_far
    }
}

/// A part on its way.
#[derive(Clone, Copy)]
struct MovingPart {
    part: ToolPart,
    motion: CapsuleMotion,
    end: Capsule,
    /// How the instrument turns on the whole way.
    turn: DMat3,
}

impl MovingPart {
    /// None of a part that the instrument does not have.
    fn of(tool: &Tool, part: ToolPart, [before, now]: [&ToolInput; 2]) -> Option<Self> {
        let turn = ToolFrame::of(now).world_from_tool * ToolFrame::of(before).world_from_tool.transpose();
        let (motion, end) =
            (motion_for_tools(tool, part, [before, now])?, capsule_for_tools(tool, part, now)?);
        Some(Self { part, motion, end, turn })
    }

    /// How a place at its surface goes on from a time on [m].
    fn rest_of_way_m(&self, time: f64, along: f64, arm_m: DVec3) -> DVec3 {
        let from_m = self.motion.at(time).axis_point_m(along);
        self.end.axis_point_m(along) - from_m + (self.turn * arm_m - arm_m) * (1.0 - time)
    }
}

/// A place where two parts touch, or may in the step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Met {
    pub(super) key: PairKey,
    /// When on the way.
    pub(super) time: f64,
    pub(super) normal: DVec3,
    pub(super) gap_m: f64,
    /// The places at the surfaces at the end of the way, alone [m].
    pub(super) ends_m: [DVec3; 2],
    /// Motion of the first against the second from then on [m].
    pub(super) rest_m: DVec3,
    /// Whether they meet on their way.
    is_hit: bool,
}

impl Met {
    /// Whether they come deeper into each other than they were.
    pub(super) fn approaches(&self) -> bool {
        self.is_hit && self.gap_m.max(0.0) + self.normal.dot(self.rest_m) < 0.0
    }
}

/// Two parts as they are at the time that counts.
struct PartPair {
    parts: [MovingPart; 2],
    time: f64,
    is_hit: bool,
    capsules: [Capsule; 2],
    key: PairKey,
}

impl PartPair {
    fn of(pair: &ToolPair<'_>, parts: [MovingPart; 2]) -> Self {
        let [first, second] = parts;
        let hit = two_capsules(&first.motion, &second.motion, 1.0);
        let time = hit.map_or(0.0, |hit| hit.time);
        let capsules = parts.map(|part| part.motion.at(time));
        let key = PairKey {
            tools: pair.tools.map(|tool| tool as u8),
            parts: parts.map(|part| part.part as u8),
            place: 0,
        };
        Self { parts, time, is_hit: hit.is_some(), capsules, key }
    }

    /// Shares of both axes of a place; an end that has nothing beside it is far from the other's nearest end.
    fn along(&self, place: u8) -> [f64; 2] {
        let [a, b] = &self.capsules;
        let of_end = |end: f64, one: &Capsule, other: &Capsule| along_axis(other, one.axis_point_m(end));
        match place {
            0 => {
                let closest = closest_on_segments([a.from_m, a.to_m], [b.from_m, b.to_m]);
                [along_axis(a, closest.first_m), along_axis(b, closest.second_m)]
            }
            1 => [0.0, of_end(0.0, a, b)],
            2 => [1.0, of_end(1.0, a, b)],
            3 => [of_end(0.0, b, a), 0.0],
            _ => [of_end(1.0, b, a), 1.0],
        }
    }

    /// What two parts that have a place in common go apart along: across both axes, or across the one, to the side where the first
    /// is going.
    fn out_of_one_place(&self) -> DVec3 {
        let [a, b] = self.capsules.map(|part| (part.to_m - part.from_m).normalize_or_zero());
        let [first, second] = self.parts.map(|part| part.rest_of_way_m(self.time, 0.5, DVec3::ZERO));
        let way_m = first - second;
        let across = a.cross(b).normalize_or_zero();
        if across != DVec3::ZERO {
            return if way_m.dot(across) < 0.0 { -across } else { across };
        }
        let axis = if a == DVec3::ZERO { b } else { a };
        let aside = (way_m - axis * way_m.dot(axis)).normalize_or_zero();
        if aside == DVec3::ZERO { axis.normalize_or(DVec3::X).any_orthonormal_vector() } else { aside }
    }

    /// What touches at a place; `normal_before` is its normal of the step before, where it bore a force.
    fn met(&self, place: u8, normal_before: Option<DVec3>) -> Met {
        let [along_a, along_b] = self.along(place);
        let [a, b] = &self.capsules;
        let apart_m = a.axis_point_m(along_a) - b.axis_point_m(along_b);
        let straight =
            if apart_m.length() > ONE_PLACE_M { apart_m.normalize() } else { self.out_of_one_place() };
        // What has gone through in spite of all comes back.
        let overlapped = self.is_hit && self.time == 0.0;
        let has_passed = overlapped && normal_before.is_some_and(|before| before.dot(straight) < 0.0);
        let normal = if has_passed { -straight } else { straight };
        let gap_m = apart_m.dot(normal) - a.radius_m - b.radius_m;
        let arms_m = [normal * -a.radius_m, normal * b.radius_m];
        let [first, second] = &self.parts;
        let rest_m = first.rest_of_way_m(self.time, along_a, arms_m[0])
            - second.rest_of_way_m(self.time, along_b, arms_m[1]);
        let ends_m =
            [first.end.axis_point_m(along_a) + arms_m[0], second.end.axis_point_m(along_b) + arms_m[1]];
        let key = PairKey { place, ..self.key };
        Met { key, time: self.time, normal, gap_m, ends_m, rest_m, is_hit: self.is_hit }
    }

    /// The places that touch, or may when they are no further apart than the margin.
    fn places(
        &self,
        margin_m: f64,
        normal_before: impl Fn(PairKey) -> Option<DVec3>,
    ) -> [Option<Met>; PLACES] {
        let thickness_m = self.capsules[0].radius_m + self.capsules[1].radius_m;
        let nearest_m = {
            let [along, _] = self.along(0);
            self.capsules[0].axis_point_m(along)
        };
        std::array::from_fn(|place| {
            let place = place as u8;
            let met = self.met(place, normal_before(PairKey { place, ..self.key }));
            if !met.rest_m.is_finite() || !met.gap_m.is_finite() {
                return None;
            }
            let is_first = place == 0;
            let meets = is_first && self.is_hit;
            let [along, _] = self.along(place);
            let is_same = self.capsules[0].axis_point_m(along).distance(nearest_m) < thickness_m;
            let is_near = met.gap_m <= margin_m && (is_first || !is_same);
            // Its own way leads around.
            let goes_by = !self.is_hit && met.gap_m + met.normal.dot(met.rest_m) < 0.0;
            (meets || is_near && !goes_by).then_some(met)
        })
    }
}

/// Where two instruments touch each other, or may: the deepest first. Allocates nothing.
pub(super) fn meet_into(pair: &ToolPair<'_>, margin_m: f64, pressed: &[PairContact], found: &mut Vec<Met>) {
    found.clear();
    if !pair.may_meet(margin_m) {
        return;
    }
    let normal_before = |key: PairKey| pressed.iter().find(|at| at.key == key).map(|at| at.normal);
    let parts_of =
        |tool: usize| ToolPart::ALL.map(|part| MovingPart::of(pair.specs[tool], part, pair.ways[tool]));
    let seconds = parts_of(1);
    for first in parts_of(0).into_iter().flatten() {
        for second in seconds.into_iter().flatten() {
            let around_m = AROUND * (first.motion.radius_m + second.motion.radius_m);
            let parts = PartPair::of(pair, [first, second]);
            found.extend(parts.places(margin_m + around_m, normal_before).into_iter().flatten());
        }
    }
    found.sort_unstable_by(|a, b| a.gap_m.total_cmp(&b.gap_m).then_with(|| a.key.cmp(&b.key)));
}
