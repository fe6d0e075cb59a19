//! One instrument in a world: where it is, what it touches and holds.

use super::StepInput;
use super::detection::{FirstTouch, Meeting, first_touch, touching_radius_m};
use super::grasp::{Grasp, HOLDS_BELOW};
use super::organ::Organ;
use super::overload::Overload;
use super::parts::{ToolPart, ToolPoint, capsule};
use super::skin::SurfacePlace;
use super::spec::Hand;
use super::touch::{ContactBegin, HeldContact};
use crate::contact::continuous::{CONTACT_TOLERANCE_M, FirstContact};
use crate::contact::tool_contact::ToolContact;
use crate::math::{DMat3, DVec3};
use crate::mesh::NodeId;
use crate::mesh::edit::TopologyChange;
use crate::mesh::topology::Topology;
use crate::tool::external_detection::{ExternalDetection, ExternalTouch};
use crate::tool::fracture::{Tearing, scissors_force_n};
use crate::tool::pose::{ToolFrame, rotation_vector_rad, turn_by};
use crate::tool::{Jaws, Tool, ToolInput};

/// What was found elsewhere counts while the part is no further from the touched place [m]: a choice, as far as a hand may come
/// while a simulation stalls.
const MOST_DEEP_M: f64 = 0.03;

/// Scissors whose jaws stood still for longer [s] close no more: a choice, some times as long as hands take to tell of their jaws.
const CLOSES_FOR_S: f64 = 0.05;

/// An instrument that is turned from how the hand wants it by less [rad] is as the hand wants it: far above rounding.
const LEAST_TURNED_RAD: f64 = 1e-9;

/// What contacts are looked for with.
#[derive(Clone, Copy)]
pub(super) struct ContactSearch<'a> {
    pub(super) organ: &'a Organ,
    pub(super) tearing: Option<&'a Tearing>,
    pub(super) is_placed: bool,
    /// Whether tissue that is held fixed stops the tool.
    pub(super) fixed_stops: bool,
    /// Whether the tool's loop is drawn around tissue: the tip is in the thread then and pushes nothing.
    pub(super) is_in_loop: bool,
    /// What was found elsewhere; then nothing is searched here.
    pub(super) detected: Option<&'a ExternalDetection>,
}

/// What a tool felt and did in a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ToolReport {
    /// Force that the organ, and with a hand that gives way other instruments exert on the tool [N].
    pub force_on_tool_n: DVec3,
    /// Torque of these forces about the tip [N m]; zero where hands impose their motion.
    pub torque_on_tool_n_m: DVec3,
    /// Whether a part of it touches the organ, or its jaws hold some of it.
    pub in_contact: bool,
    /// Whether it stands on tissue that is held fixed, which cannot give way.
    pub blocked_by_fixed_tissue: bool,
    /// Whether its input was not finite; it then stayed where it was.
    pub input_rejected: bool,
    /// Nodes that the jaws hold.
    pub n_held_nodes: u32,
    /// How far held or touched tissue slid on the tool in this step [m].
    pub slip_m: f64,
}

/// A tool and its contacts.
#[derive(Clone, Debug)]
pub(super) struct ToolState {
    pub(super) now: ToolInput,
    /// Where it was at the end of the last step.
    pub(super) before: ToolInput,
    /// Where the hand wants the tip, and wanted it in the step before [m]. The tip is there unless the hand gives way.
    pub(super) hand_tip_m: DVec3,
    pub(super) hand_before_m: DVec3,
    /// How far the instrument is turned from how the hand wants it, a rotation vector [rad]: zero unless the hand gives way, and
    /// through a trocar.
    pub(super) turned_rad: DVec3,
    /// How the hand wants it turned about its shaft [rad].
    pub(super) hand_roll_rad: f64,
    /// Share of this step's way that the tip made before it touched anything new.
    pub(super) free_share: f64,
    pub(super) contacts: [Option<HeldContact>; 3],
    /// Parts that were put into tissue: they touch nothing until they have come out of it.
    is_buried: [bool; 3],
    pub(super) grasp: Option<Grasp>,
    /// How far the jaws were open before they began to close: what they enclose.
    pub(super) opened_to: f64,
    /// Whether the jaws closed in the last step.
    pub(super) just_closed: bool,
    /// For how long the jaws of scissors still count as closing [s].
    pub(super) closing_s: f64,
    /// How long the active tip has been on and touching [s].
    pub(super) active_s: f64,
    /// What it does to tissue that stands no more.
    pub(super) overload: Overload,
    pub(super) report: ToolReport,
}

/// The force [N] that scissors would need to part tissue, if they are too weak.
pub(super) fn scissors_lack_n(jaws: &Jaws, tearing: Option<&Tearing>) -> Option<f64> {
    let needed_n = scissors_force_n(tearing?.energy, jaws.length_m);
    (jaws.closing_force_n < needed_n).then_some(needed_n)
}

/// Whether an edit put a node to another place in the tissue: who held it there holds it no more.
pub(super) fn went_elsewhere(node: NodeId, change: &TopologyChange) -> bool {
    let moved = change.moved_nodes.binary_search(&node);
    moved.is_ok_and(|at| !change.moved_parents[at].is_empty())
}

impl ToolState {
    /// A tool at its home.
    pub(super) fn at_home(tool: &Tool) -> Self {
        let home = tool.home.through(tool.trocar_m);
        Self {
            now: home,
            before: home,
            hand_tip_m: home.tip_in_world_m,
            hand_before_m: home.tip_in_world_m,
            turned_rad: DVec3::ZERO,
            hand_roll_rad: home.roll_rad,
            free_share: 1.0,
            contacts: [const { None }; 3],
            is_buried: [false; 3],
            grasp: None,
            opened_to: home.jaw_opening,
            just_closed: false,
            closing_s: 0.0,
            active_s: 0.0,
            overload: Overload::default(),
            report: ToolReport::default(),
        }
    }

    /// Everything that its next steps depend on but where it is.
    pub(super) fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        let contacts = self.contacts.iter().flatten().flat_map(HeldContact::numbers);
        let grasp = self.grasp.iter().flat_map(Grasp::numbers);
        let active = [self.active_s, self.closing_s].into_iter().filter(|s| *s > 0.0);
        let buried = ToolPart::ALL.into_iter().filter(|part| self.is_buried[part.index()]);
        let buried = buried.map(|part| part.index() as f64);
        let behind_m = self.hand_tip_m - self.now.tip_in_world_m;
        let behind = (behind_m != DVec3::ZERO).then(|| behind_m.to_array()).into_iter().flatten();
        let is_turned = self.turned_rad != DVec3::ZERO;
        let behind = behind.chain(is_turned.then(|| self.turned_rad.to_array()).into_iter().flatten());
        contacts.chain(grasp).chain(active).chain(buried).chain(self.overload.numbers()).chain(behind)
    }

    /// Takes the input of tool number `place` over. The tip goes where a hand that imposes its motion wants it; from one that
    /// gives way it is as far as that says it is after a step of `dt_s`.
    pub(super) fn move_to(
        &mut self,
        tool: &Tool,
        place: usize,
        input: &StepInput,
        hand: Option<(&Hand, f64)>,
    ) {
        self.report = ToolReport::default();
        self.before = self.now;
        self.hand_before_m = self.hand_tip_m;
        self.free_share = 1.0;
        let asked = &input.tools[place];
        self.report.input_rejected = !asked.is_finite();
        if !self.report.input_rejected {
            let is_placed = input.placed[place];
            self.now = tool.held(*asked, (!is_placed).then_some(&self.before));
            self.now.jaw_opening = asked.jaw_opening.clamp(0.0, 1.0);
            self.hand_tip_m = self.now.tip_in_world_m;
            self.hand_roll_rad = self.now.roll_rad;
            let behind_m = self.before.tip_in_world_m - self.hand_before_m;
            if let Some((hand, dt_s)) = hand.filter(|_| !is_placed)
                && behind_m != DVec3::ZERO
            {
                self.put_tip(tool, self.hand_tip_m + hand.left_behind_m(behind_m, dt_s));
            }
            let turned_rad = std::mem::take(&mut self.turned_rad);
            if let Some((hand, dt_s)) = hand.filter(|_| !is_placed) {
                let left_rad = hand.left_turned_rad(turned_rad, dt_s);
                if left_rad.length() > LEAST_TURNED_RAD {
                    self.turn(left_rad);
                }
            }
        } else if input.placed[place] {
            self.hand_tip_m = self.now.tip_in_world_m;
            self.hand_roll_rad = self.now.roll_rad;
            self.turned_rad = DVec3::ZERO;
        }
        if input.placed[place] {
            self.let_go();
            self.before = self.now;
        }
    }

    /// Share of this step's way that the tip made before it touched: none where it touched already.
    pub(super) fn start_share(&self) -> f64 {
        if self.contacts.iter().flatten().all(HeldContact::is_new) { self.free_share } else { 0.0 }
    }

    /// The tip elsewhere than asked for, through the trocar if there is one.
    pub(super) fn put_tip(&mut self, tool: &Tool, tip_m: DVec3) {
        self.now = tool.held(ToolInput { tip_in_world_m: tip_m, ..self.now }, Some(&self.before));
    }

    /// Turns the instrument about its tip by a rotation vector [rad], away from how the hand wants it.
    pub(super) fn turn(&mut self, by_rad: DVec3) {
        self.now = self.now.turned(by_rad);
        self.turned_rad = rotation_vector_rad(&(turn_by(by_rad) * turn_by(self.turned_rad)));
    }

    /// How the instrument was turned after a share of its way in this step, with the tip there.
    pub(super) fn on_way(&self, tool: &Tool, share: f64, tip_m: DVec3) -> ToolInput {
        let pose = ToolInput { tip_in_world_m: tip_m, ..self.before };
        if tool.trocar_m.is_some() || share == 0.0 {
            return tool.held(pose, Some(&self.before));
        }
        let (_, _, way_rad) = self.turned_way();
        pose.turned(way_rad * share)
    }

    /// How the instrument was turned before this step and is now, and the rotation vector between [rad].
    fn turned_way(&self) -> (DMat3, DMat3, DVec3) {
        let [from, to] = [&self.before, &self.now].map(|pose| ToolFrame::of(pose).world_from_tool);
        (from, to, rotation_vector_rad(&(to * from.transpose())))
    }

    /// Turns the instrument back to where its greatest torque lets a hand turn it in the step: after the share `until` of its way
    /// no further than `most_rad`.
    pub(super) fn hold_turn_back(&mut self, until: f64, most_rad: f64) {
        let (from, to, way_rad) = self.turned_way();
        let rest_rad = way_rad * (1.0 - until);
        if rest_rad.length() > most_rad {
            let wanted = turn_by(way_rad * until + rest_rad.clamp_length_max(most_rad)) * from;
            self.turn(rotation_vector_rad(&(wanted * to.transpose())));
        }
    }

    /// Whether the tool cuts with its edge: for a long scalpel that is on, and has broken in where tissue has strength.
    pub(super) fn edge_cuts(&self, tool: &Tool, tearing: Option<&Tearing>) -> bool {
        let is_on = tool.kind.blade().is_some() && self.now.is_triggered();
        is_on && (tearing.is_none() || self.overload.edge_is_in)
    }

    /// Whether its jaws are scissors' that close and are strong enough to part tissue.
    fn jaws_cut(&self, tool: &Tool, tearing: Option<&Tearing>) -> bool {
        self.closing_s > 0.0
            && tool.kind.parting_jaws().is_some_and(|(jaws, snip)| {
                snip.edge_cuts().is_some() && scissors_lack_n(jaws, tearing).is_none()
            })
    }

    /// Lets go of everything.
    pub(super) fn let_go(&mut self) {
        self.contacts = [const { None }; 3];
        self.is_buried = [false; 3];
        self.grasp = None;
        (self.active_s, self.closing_s) = (0.0, 0.0);
        self.overload = Overload::default();
    }

    /// Follows the jaws of a tool in a step.
    pub(super) fn follow_jaws(&mut self, tool: &Tool, dt_s: f64) {
        let (before, now) = (self.before.jaw_opening, self.now.jaw_opening);
        self.just_closed = now <= HOLDS_BELOW && before > HOLDS_BELOW;
        if now < before {
            self.opened_to = self.opened_to.max(before);
            self.closing_s = if tool.kind.edge_cuts().is_some() { CLOSES_FOR_S } else { 0.0 };
        } else if now > before {
            (self.opened_to, self.closing_s) = (now, 0.0);
        } else {
            self.closing_s = (self.closing_s - dt_s).max(0.0);
        }
    }

    /// A part goes on through the tissue: it touches nothing until it has come out.
    pub(super) fn bury(&mut self, part: ToolPart) {
        self.is_buried[part.index()] = true;
    }

    /// After an edit: contacts end on triangles that are gone, or whose nodes went to another place in the tissue; nodes that
    /// are gone or went there are no longer held.
    pub(super) fn follow(&mut self, topology: &Topology, change: &TopologyChange) {
        let went_elsewhere = |node| went_elsewhere(node, change);
        let has_changed = |contact: &HeldContact| {
            !topology.is_surface_triangle(contact.triangle)
                || topology.triangle_nodes(contact.triangle).into_iter().any(went_elsewhere)
        };
        for contact in &mut self.contacts {
            contact.take_if(|contact| has_changed(contact));
        }
        if let Some(grasp) = &mut self.grasp {
            grasp.retain_nodes(|node| topology.is_live_node(node) && !went_elsewhere(node));
        }
    }

    /// Finds what the parts touch that touch nothing yet.
    pub(super) fn find_contacts(&mut self, tool: &Tool, search: &ContactSearch<'_>) {
        let ContactSearch { organ, tearing, is_placed, fixed_stops, is_in_loop, detected } = *search;
        for part in ToolPart::ALL {
            let holds = self.grasp.is_some() && part != ToolPart::Shaft;
            // An edge that cuts does not push.
            let cuts = match part {
                ToolPart::Tip => self.edge_cuts(tool, tearing) || self.jaws_cut(tool, tearing),
                ToolPart::SecondJaw => self.jaws_cut(tool, tearing),
                ToolPart::Shaft => false,
            };
            if cuts {
                self.contacts[part.index()] = None;
                continue;
            }
            if is_in_loop && part == ToolPart::Tip {
                self.contacts[part.index()] = None;
                // Let go, it comes out first.
                self.bury(part);
                continue;
            }
            if self.contacts[part.index()].is_some() || holds {
                continue;
            }
            let Some(resting) = capsule(tool, part, &self.now) else { continue };
            let was_buried = std::mem::take(&mut self.is_buried[part.index()]);
            // The tip is the hand's own doing; of the rest nobody sees where it goes in.
            if was_buried || is_placed && part != ToolPart::Tip {
                self.is_buried[part.index()] = organ.skin().overlaps(&resting);
                // It was in the way when it moved off: its next motion counts.
                if was_buried || self.is_buried[part.index()] {
                    continue;
                }
            }
            let touch = match detected {
                Some(detected) => detected.touches[part.index()].and_then(|told| {
                    self.touch_as_told((tool, part), &told, (organ, fixed_stops), is_placed)
                }),
                None => self.touch(tool, part, (organ, fixed_stops), is_placed),
            };
            match touch {
                None => {}
                // Nothing holds it back.
                Some(ContactBegin::FromInside) => self.bury(part),
                Some(ContactBegin::OnFixedTissue) => self.report.blocked_by_fixed_tissue = true,
                Some(ContactBegin::Touches(contact, share)) => {
                    self.contacts[part.index()] = Some(contact);
                    self.free_share = self.free_share.min(share);
                }
            }
        }
    }

    fn touch(
        &self,
        tool: &Tool,
        part: ToolPart,
        (organ, fixed_stops): (&Organ, bool),
        is_placed: bool,
    ) -> Option<ContactBegin> {
        let surface = organ.skin().searched(!is_placed);
        let FirstTouch { found, at } = match first_touch(tool, part, [&self.before, &self.now], &surface)? {
            Meeting::Touch(touch) => touch,
            Meeting::FromInside => return Some(ContactBegin::FromInside),
        };
        let place = organ.skin().place_of(found);
        let at = ToolPoint::of(part, at);
        let point_m = at.in_world_m(tool, &self.now);
        Some(HeldContact::begin(&place, at, (point_m, touching_radius_m(tool, part)), (organ, fixed_stops)))
    }

    /// A touch that was found elsewhere, where the part still is at or behind the touched place.
    fn touch_as_told(
        &self,
        (tool, part): (&Tool, ToolPart),
        told: &ExternalTouch,
        (organ, fixed_stops): (&Organ, bool),
        is_placed: bool,
    ) -> Option<ContactBegin> {
        let slot = organ.skin().slot_of(told.triangle)?;
        let (triangle, nodes) = organ.skin().place_in_slot(slot);
        let positions_m = organ.positions_m();
        let touched_m: DVec3 = (0..3).map(|v| positions_m[nodes[v].index()] * told.weights[v]).sum();
        let at = ToolPoint::of(part, told.at);
        let point_m = at.in_world_m(tool, &self.now);
        let radius_m = touching_radius_m(tool, part);
        let way_m = point_m - touched_m;
        let is_there = told.normal.dot(way_m) - radius_m <= CONTACT_TOLERANCE_M
            && way_m.length() - radius_m <= MOST_DEEP_M;
        let contact = FirstContact {
            time: 1.0,
            points_m: [point_m, touched_m],
            normal: told.normal,
            // Tissue that was overlapped before is pushed out bit by bit, other tissue followed the part since.
            gap_m: told.gap_m.clamp(-MOST_DEEP_M, 0.0),
        };
        let found = ToolContact { triangle: slot, weights: told.weights, contact };
        let place = SurfacePlace { triangle, nodes, found };
        if !is_there {
            return None;
        }
        match HeldContact::begin(&place, at, (point_m, radius_m), (organ, fixed_stops)) {
            // The organ turned since the copy was told of it.
            ContactBegin::FromInside => self.touch(tool, part, (organ, fixed_stops), is_placed),
            // The part came through it somewhere on its way.
            ContactBegin::Touches(contact, _) => Some(ContactBegin::Touches(contact, 0.0)),
            begun @ ContactBegin::OnFixedTissue => Some(begun),
        }
    }
}
