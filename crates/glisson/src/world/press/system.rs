//! The contacts of a step as one system: what touches, how organ and instruments answer, and the forces that were found.

mod room;

use super::meeting::{MOST_OF_PAIR, Met, PairContact, PairKey};
use super::points::{AROUND, ContactPoint, Look, PointSearch};
use super::sub_grid::Indentation;
use super::turning::{HandAnswer, HandTurns, Turning};
use super::vertices::{MOST_NODES, N_VERTICES, side_of, turn_vertex_of, vertex_of};
use super::{JAWS, SIDES, VERTICES};
use crate::contact::constraint::{Contact, ContactKey, Response, Sweeps, Turn};
use crate::contact::delassus::Delassus;
use crate::contact::shapes::Capsule;
use crate::math::{DMat3, DVec3, outer};
use crate::mesh::{NodeId, TriangleId};
use crate::model::{LocalModel, NodalForce};
use crate::tool::pose::ToolFrame;
use crate::tool::{MAX_TOOLS, Tool, ToolInput};
use crate::world::grasp::{Grasp, MOST_HELD_NODES};
use crate::world::organ::Organ;
use crate::world::parts::{ToolPart, ToolPoint, capsule};
use crate::world::slide::UNKNOWN_M_PER_N;
use crate::world::tool_state::ToolState;
use crate::world::touch::{HeldContact, Seat};

/// Sweeps over all contacts at most, and when they end: choices.
const SWEEPS: Sweeps = Sweeps { most: 30, tolerance: 1e-4 };
/// The answer of the touched nodes is taken for at most so many times what the model says, grows by so much in a step at most,
/// and keeps this share of what it is beyond that: choices.
const MOST_SOFTER: f64 = 64.0;
const MOST_SOFTER_A_STEP: f64 = 4.0;
const KEPT_SOFTNESS: f64 = 0.9;
/// Elements answer the way of a step by at most so many times that way, turned round: h^2 K/m of a stable explicit step.
const MOST_ANSWER: f64 = 4.0;
/// Contact points of a part at most, the deepest: a choice.
const MOST_POINTS: usize = 64;
const MOST_CONTACTS: usize = 2 * MOST_POINTS + (3 + MOST_HELD_NODES) * MAX_TOOLS;
/// Contacts of instruments with each other, at most.
const MOST_BETWEEN: usize = MOST_OF_PAIR * MAX_TOOLS * (MAX_TOOLS - 1) / 2;
/// A part that is no further in the surface of the mesh than this touches nothing where it bears no force [m].
pub(super) const LEAST_FURTHER_OUT_M: f64 = 1e-6;
/// Tissue that is in a part is pushed out in about this time [s], and no faster than this [m/s], a hand's calm motion: at once it
/// would take a force that throws the nodes of explicit models. Choices.
const PUSH_OUT_S: f64 = 4e-3;
const PUSH_OUT_M_PER_S: f64 = 0.2;
/// Coefficient of friction of what sticks: it slides where it is pulled along the surface by more than it is pressed. A choice, beyond
/// any of tissue; with a much larger one contacts on many sides wedge each other and bear nothing.
const STICKY_FRICTION: f64 = 1.0;

/// What of a tool bears a contact.
#[derive(Clone, Copy, Debug)]
pub(super) enum Bearer {
    /// A part, at one of its points.
    Point(ContactPoint),
    /// A part that follows one place of the tissue.
    Anchor(ToolPart),
    /// Jaws, on the node that they hold.
    Jaws(NodeId),
    /// A place where it touches another instrument.
    Between(PairKey),
}

/// A point that bore a force in the last step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PressedPoint {
    /// The vertex of its part in the system.
    pub(super) vertex: u32,
    at: ContactPoint,
    pub(super) force_n: DVec3,
}

/// Where a part of an instrument pressed on the surface in the last step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::world) struct PressedPlace {
    /// The instrument's number, and its part's.
    pub(in crate::world) tool: usize,
    pub(in crate::world) part: usize,
    /// The touched triangle, its nodes and their weights at the place.
    pub(in crate::world) triangle: TriangleId,
    pub(in crate::world) nodes: [NodeId; 3],
    pub(in crate::world) weights: [f64; 3],
    /// Unit vector along which the part pushes.
    pub(in crate::world) inward: DVec3,
    /// Force on the organ [N].
    pub(in crate::world) force_n: DVec3,
}

/// What is kept of a touched node from one step to the next.
#[derive(Clone, Copy, Debug, PartialEq)]
struct TouchedNode {
    node: NodeId,
    /// Before the step.
    velocity_m_per_s: DVec3,
    /// Where it was expected to be after the step [m], and what of the way there was its answer to the change of the forces.
    expected_m: DVec3,
    answer_m: DVec3,
    /// The whole way there [m].
    way_m: DVec3,
}

/// The contacts of a step and what they need, with room for the most.
#[derive(Debug)]
pub(in crate::world) struct Press {
    pub(super) contacts: Vec<Contact>,
    /// Tool and part of each contact.
    pub(super) of: Vec<(usize, Bearer)>,
    pub(super) nodes: Vec<NodeId>,
    /// Whether jaws hold each of the nodes.
    is_held: Vec<bool>,
    pub(super) response: Response,
    /// How far the vertices go in the step [m]; those by which tools turn, how far these do [rad].
    pub(super) moves_m: Vec<DVec3>,
    /// How each tool turns when its tip moves [rad/m]: through a trocar.
    pub(super) turned_by_tip: [DMat3; MAX_TOOLS],
    /// Torque on each tool about its tip in the last step [N m]. No step depends on it.
    torques_n_m: [DVec3; MAX_TOOLS],
    /// Whether what the jaws of each tool hold slid along them in the last step.
    pub(super) slips: [bool; MAX_TOOLS],
    /// Forces on the nodes in the last step, ascending by node.
    forces: Vec<NodalForce>,
    touched: Vec<TouchedNode>,
    /// How many times as soft as the model says the touched nodes are taken to be.
    softness: f64,
    /// The points of the last step that bore a force: the first guess in the next.
    pub(super) pressed: Vec<PressedPoint>,
    /// How a part's surface on the mesh yields against the part, for what the mesh is too coarse for ([`sub_grid`]) [m/N].
    pub(super) sub_grid_m_per_n: [[f64; JAWS]; MAX_TOOLS],
    /// The way out of the organ along which it does.
    pub(super) outward: [[DVec3; JAWS]; MAX_TOOLS],
    /// How far it is in the surface of the mesh for that [m]. It comes out slowly: tissue that springs off for a step is not lost.
    pub(super) further_out_m: [[f64; JAWS]; MAX_TOOLS],
    /// Where instruments pressed on each other in the last step: the first guess in the next.
    pub(super) between: Vec<PairContact>,
    /// Scratch: where two instruments touch.
    pub(super) met: Vec<Met>,
    /// Scratch: forces of a part on nodes along its way.
    pub(super) on_nodes_n: Vec<(NodeId, f64)>,
    /// Scratch: the answer to the change of the forces.
    answers_m: Vec<DVec3>,
    delassus: Delassus,
    search: PointSearch,
}

/// How many times as soft as a model says the touched nodes are taken to be, after a step in which they went further than expected by
/// this share of what was expected; not a number where nothing was.
pub(in crate::world) fn softer(softness: f64, further: f64) -> f64 {
    let times = (1.0 + further).min(MOST_SOFTER_A_STEP);
    let kept = 1.0 + (softness - 1.0) * KEPT_SOFTNESS;
    let seen = if times.is_finite() { softness * times } else { 1.0 };
    kept.max(seen).clamp(1.0, MOST_SOFTER)
}

impl Press {
    /// Everything that the next step depends on.
    pub(in crate::world) fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        let forces = self.forces.iter().map(|force| (force.node, force.force_n));
        let touched = self.touched.iter().flat_map(|touched| {
            let vectors = [touched.velocity_m_per_s, touched.expected_m, touched.answer_m, touched.way_m];
            vectors.map(|vector| (touched.node, vector))
        });
        let numbers = forces.chain(touched).flat_map(|(node, v)| [f64::from(node.0), v.x, v.y, v.z]);
        let pressed = self.pressed.iter().flat_map(|point| {
            let force_n = point.force_n.to_array();
            let at = point.at.feature.numbers().into_iter().chain(point.at.weights);
            let at = at.chain(point.at.inward.to_array());
            [f64::from(point.vertex)].into_iter().chain(at).chain(force_n)
        });
        let yields = self.sub_grid_m_per_n.as_flattened().iter().zip(self.outward.as_flattened());
        let yields = yields.zip(self.further_out_m.as_flattened());
        let yields = yields.filter(|((_, out), _)| **out != DVec3::ZERO);
        let sub_grid = yields.flat_map(|((yields, out), further)| [*yields, out.x, out.y, out.z, *further]);
        let between = self.between.iter().flat_map(PairContact::numbers);
        let numbers = numbers.chain(pressed).chain(sub_grid).chain(between);
        numbers.chain((self.softness != 1.0).then_some(self.softness))
    }

    /// Where parts pressed on the surface in the last step; without those that follow one place of it, and without jaws that hold.
    pub(in crate::world) fn places(&self) -> impl Iterator<Item = PressedPlace> + '_ {
        self.pressed.iter().map(|PressedPoint { vertex, at, force_n }| {
            let number = *vertex as usize - MOST_NODES;
            PressedPlace {
                tool: number / VERTICES,
                part: number % VERTICES / SIDES,
                triangle: at.triangle,
                nodes: at.nodes,
                weights: at.weights,
                inward: at.inward,
                force_n: *force_n,
            }
        })
    }

    /// Forces on the nodes in this step, ascending by node.
    pub(in crate::world) fn forces(&self) -> &[NodalForce] {
        &self.forces
    }

    /// The nodes that a part bears on, with their shares of its push; none for a part that follows one place.
    pub(in crate::world) fn shares_into(
        &self,
        place: usize,
        part: ToolPart,
        shares: &mut Vec<(NodeId, f64)>,
    ) {
        let vertices = vertex_of(place, side_of(part, 0))..vertex_of(place, side_of(part, SIDES));
        let of_part = self.pressed.iter().filter(|point| vertices.contains(&point.vertex));
        let push_n = |point: &PressedPoint| point.force_n.dot(point.at.inward).max(0.0);
        let total_n: f64 = of_part.clone().map(push_n).sum();
        shares.clear();
        for point in of_part {
            let share = push_n(point) / total_n;
            for (node, weight) in point.at.nodes.into_iter().zip(point.at.weights).filter(|(_, w)| *w > 0.0) {
                let Some(known) = shares.iter_mut().find(|(n, _)| *n == node) else {
                    if shares.len() < shares.capacity() && share > 0.0 {
                        shares.push((node, share * weight));
                    }
                    continue;
                };
                known.1 += share * weight;
            }
        }
    }

    pub(in crate::world) fn forget(&mut self) {
        self.forget_forces();
        self.sub_grid_m_per_n = [[0.0; JAWS]; MAX_TOOLS];
        self.outward = [[DVec3::ZERO; JAWS]; MAX_TOOLS];
        self.further_out_m = [[0.0; JAWS]; MAX_TOOLS];
    }

    /// Nothing is touched in this step.
    pub(super) fn forget_forces(&mut self) {
        self.forces.clear();
        self.touched.clear();
        self.pressed.clear();
        self.between.clear();
        self.torques_n_m = [DVec3::ZERO; MAX_TOOLS];
        self.slips = [false; MAX_TOOLS];
        self.softness = 1.0;
    }

    /// After a step: whether the touched nodes, now at `positions_m`, are softer than they were taken to be.
    pub(super) fn learn_softness(&mut self, positions_m: &[DVec3]) {
        let (mut further_m2, mut answered_m2) = (0.0, 0.0);
        for touched in &self.touched {
            let Some(now_m) = positions_m.get(touched.node.index()) else { continue };
            further_m2 += (*now_m - touched.expected_m).dot(touched.answer_m);
            // Where the way is not the forces' doing, how far it led says little of them.
            answered_m2 += touched.answer_m.length_squared() + touched.way_m.length_squared();
        }
        self.softness = softer(self.softness, further_m2 / answered_m2);
    }

    /// Forgets the contacts of the step before; lists what jaws hold.
    pub(super) fn start(&mut self, states: &[ToolState]) {
        self.contacts.clear();
        self.of.clear();
        self.nodes.clear();
        self.is_held.clear();
        for node in states.iter().filter_map(|state| state.grasp.as_ref()).flat_map(Grasp::nodes) {
            self.number(node, true);
        }
    }

    /// A node's number in the patch, which it gets where there is room.
    fn number(&mut self, node: NodeId, is_held: bool) -> Option<usize> {
        let known = self.number_of(node);
        if known.is_none() && self.nodes.len() < MOST_NODES {
            self.nodes.push(node);
            self.is_held.push(is_held);
            return Some(self.nodes.len() - 1);
        }
        known
    }

    /// A contact between a place of a triangle and a tool's vertex; none where the patch has no room for its nodes.
    fn add(
        &mut self,
        (place, vertex): (usize, u32),
        bearer: Bearer,
        (nodes, weights): ([NodeId; 3], [f64; 3]),
        mut contact: Contact,
    ) {
        let n_before = self.nodes.len();
        let mut numbers = [0; 3];
        for v in (0..3).filter(|&v| weights[v] != 0.0) {
            let Some(number) = self.number(nodes[v], false) else {
                self.nodes.truncate(n_before);
                self.is_held.truncate(n_before);
                return;
            };
            numbers[v] = number as u32;
        }
        if self.contacts.len() < MOST_CONTACTS {
            contact.vertices[..3].copy_from_slice(&numbers);
            contact.vertices[3] = vertex;
            contact.weights[..3].copy_from_slice(&weights);
            self.contacts.push(contact);
            self.of.push((place, bearer));
        }
    }

    /// The points at which a part touches, or may in this step: from where it was it moves to where it would be alone. Those that
    /// push against the first side's way are of the second: a part in a fold.
    pub(super) fn add_points(&mut self, (place, part): (usize, ToolPart), touch: &PartTouch<'_>) {
        let mut touch = *touch;
        if part == ToolPart::Shaft {
            let axis = (touch.way.start.to_m - touch.way.start.from_m).normalize_or_zero();
            touch.way = touch.way.without_start(self.tip_further_out_m(place).dot(axis).max(0.0));
        }
        let touch = &touch;
        let sides = [0, 1].map(|side| side_of(part, side));
        let known = sides.map(|side| self.outward[place][side] != DVec3::ZERO);
        let pressed = std::mem::take(&mut self.pressed);
        let mut search = std::mem::replace(&mut self.search, PointSearch::none());
        for side in [0, 1] {
            if side == 1 && !known[1] {
                break;
            }
            let at = (place, part, side);
            let further_out_m = self.look_from(at, touch, &pressed, &mut search);
            for point in search.found().iter().take(MOST_POINTS) {
                let first = &mut self.outward[place][sides[0]];
                if *first == DVec3::ZERO {
                    *first = point.outward;
                }
                let of = usize::from(point.inward.dot(*first) > 0.0);
                if of == 1 && !known[1] {
                    // It shows itself in this step.
                    let second = &mut self.outward[place][sides[1]];
                    *second = if *second == DVec3::ZERO { point.outward } else { *second };
                    self.add_point((place, part, 1), touch, point, (DVec3::ZERO, &pressed));
                } else if of == side {
                    self.add_point(at, touch, point, (further_out_m, &pressed));
                }
            }
        }
        self.search = search;
        self.pressed = pressed;
    }

    /// How far the tip is in the surface of the mesh for what that is too coarse for, as the way out [m]. The shaft is so much
    /// further out too: its end would press the tissue that the tip bears, as if there were no detail.
    pub(in crate::world) fn tip_further_out_m(&self, place: usize) -> DVec3 {
        let sides = (0..SIDES).map(|side| side_of(ToolPart::Tip, side));
        sides.map(|side| self.outward[place][side] * self.further_out_m[place][side]).sum()
    }

    /// Looks for points around a part as one of its sides has it; how far that is further out [m].
    fn look_from(
        &mut self,
        (place, part, side): (usize, ToolPart, usize),
        touch: &PartTouch<'_>,
        pressed: &[PressedPoint],
        search: &mut PointSearch,
    ) -> DVec3 {
        let PartWay { start, end, .. } = touch.way;
        let way_m = start.from_m.distance(end.from_m).max(start.to_m.distance(end.to_m));
        let margin_m = way_m + AROUND * start.radius_m;
        let contact = touch.contact.filter(|_| part != ToolPart::Shaft);
        // As deep as the detail lets it, a part is not in the tissue: it touches from so much further out.
        let side = side_of(part, side);
        let further_out_m = self.further_out_m((place, side), start.radius_m, contact, (pressed, touch.dt_s));
        let touching =
            Capsule { from_m: start.from_m + further_out_m, to_m: start.to_m + further_out_m, ..start };
        let look = Look { organ: touch.organ, part: &touching, margin_m, is_linear: touch.is_linear };
        let vertex = vertex_of(place, side);
        let of_side = pressed.iter().filter(|point| point.vertex == vertex);
        search.find(&look, &of_side.map(|point| ContactPoint { is_kept: true, ..point.at }));
        further_out_m
    }

    fn add_point(
        &mut self,
        (place, part, side): (usize, ToolPart, usize),
        touch: &PartTouch<'_>,
        point: &ContactPoint,
        (further_out_m, pressed): (DVec3, &[PressedPoint]),
    ) {
        let PartTouch { tool, way: PartWay { start, end, turn }, dt_s, .. } = *touch;
        let vertex = vertex_of(place, side_of(part, side));
        let key = ContactKey::VertexObstacle(vertex, self.contacts.len() as u32);
        let mut contact = Contact::new(key, point.inward, point.gap_m);
        contact.slack_m = open_m(point.gap_m, dt_s);
        let arm_m = point.arm_m;
        contact.point_m = start.axis_point_m(point.along) + arm_m;
        let followed = touch.contact.map_or(1.0, |contact| contact.followed(start.radius_m, dt_s));
        let end_m = end.axis_point_m(point.along) + turn * arm_m;
        // What the part's surface on the mesh yields comes out of the system whole: what of it was there before is no motion.
        contact.moved_m = end_m - contact.point_m - further_out_m * followed;
        contact.weights[3] = -1.0;
        contact.turns[0] = touch.turning.at(end_m, 1.0).of_second();
        let coefficient = tool.grip.friction_coefficient;
        contact.friction = if tool.grip.is_sticky { STICKY_FRICTION } else { coefficient };
        let is_it = |p: &&PressedPoint| {
            point.is_kept && p.vertex == vertex && p.at.feature == point.feature && p.at.is_at(point)
        };
        let before = pressed.iter().find(is_it);
        contact.force_n = before.map_or(DVec3::ZERO, |point| contact.into_cone(point.force_n));
        self.add((place, vertex), Bearer::Point(*point), (point.nodes, point.weights), contact);
    }

    /// The place that a part follows.
    pub(super) fn add_anchor(
        &mut self,
        (place, part): (usize, ToolPart),
        held: &HeldContact,
        (tool, pose, turning): (&Tool, &ToolInput, &Turning),
        organ: &Organ,
    ) {
        let place_m = held.at.in_world_m(tool, pose);
        let target_m = place_m + held.offset_m;
        let key = ContactKey::VertexObstacle(place as u32, part.index() as u32);
        let mut contact = Contact::new(key, -held.normal, 0.0);
        contact.weights[3] = -1.0;
        contact.turns[0] = turning.at(place_m, 1.0).of_second();
        contact.point_m = target_m;
        contact.moved_m = target_m - held.point_m(organ.positions_m());
        contact.friction = tool.grip.friction_coefficient;
        contact.sticks = tool.grip.is_sticky;
        contact.force_n = held.force_on_organ_n();
        let vertex = vertex_of(place, side_of(part, 0));
        self.add((place, vertex), Bearer::Anchor(part), (held.nodes, held.weights), contact);
    }

    /// A node that jaws hold and move, with the force of the step before.
    pub(super) fn add_held(
        &mut self,
        (place, node): (usize, NodeId),
        [moved_m, force_n]: [DVec3; 2],
        turn: Turn,
    ) {
        let mut contact = Contact::new(ContactKey::VertexObstacle(place as u32, node.0), DVec3::Z, 0.0);
        contact.weights[3] = -1.0;
        contact.turns[0] = turn.of_second();
        contact.moved_m = moved_m;
        contact.sticks = true;
        contact.force_n = force_n;
        let vertex = vertex_of(place, JAWS);
        self.add((place, vertex), Bearer::Jaws(node), ([node; 3], [1.0, 0.0, 0.0]), contact);
    }

    /// How an instrument answers: its parts move as one and turn about its tip, with the hand's compliances; through a trocar it turns
    /// with its tip.
    pub(super) fn set_tool(&mut self, place: usize, answer: &HandAnswer, followed: impl Fn(ToolPart) -> f64) {
        let HandAnswer { m_per_n, turns } = *answer;
        let turn = turn_vertex_of(place);
        let sides = (0..VERTICES).map(|side| vertex_of(place, side));
        self.turned_by_tip[place] = DMat3::ZERO;
        match turns {
            HandTurns::Free { rad_per_n_m } => {
                self.response.set_group(1 + place, sides);
                self.response.set_alone(turn, DVec3::splat(rad_per_n_m));
            }
            HandTurns::WithTip { rad_per_m } => {
                self.turned_by_tip[place] = rad_per_m;
                self.response.set_group(1 + place, sides.chain([turn]));
            }
        }
        let group = self.response.group_mut(1 + place);
        let n = group.vertices.len();
        let compliance = &mut group.compliance_m_per_n;
        compliance.clear();
        compliance.resize(n * n, DMat3::IDENTITY * m_per_n);
        if let HandTurns::WithTip { rad_per_m } = turns {
            for side in 0..VERTICES {
                compliance[side * n + VERTICES] = rad_per_m * m_per_n;
                compliance[VERTICES * n + side] = rad_per_m.transpose() * m_per_n;
            }
            compliance[VERTICES * n + VERTICES] = rad_per_m * rad_per_m.transpose() * m_per_n;
        }
        for (side, yields) in self.sub_grid_m_per_n[place].into_iter().enumerate() {
            let out = self.outward[place][side];
            let followed = followed(ToolPart::ALL[side / SIDES]);
            compliance[side * n + side] += outer(out, out) * (yields * followed);
        }
    }

    /// A node's number in the patch.
    fn number_of(&self, node: NodeId) -> Option<usize> {
        self.nodes.iter().position(|n| *n == node)
    }

    pub(super) fn force_before_n(&self, node: NodeId) -> DVec3 {
        let found = self.forces.iter().find(|force| force.node == node);
        found.map_or(DVec3::ZERO, |force| force.force_n)
    }

    /// What of the patch's answer a model tells, with a guess for nodes of which it tells nothing; none for those that do not
    /// move under forces.
    pub(super) fn set_response(&mut self, local: &LocalModel, is_free: impl Fn(NodeId) -> bool, dt_s: f64) {
        let n = self.nodes.len();
        self.response.set_group(0, 0..n as u32);
        self.response.group_mut(0).compliance_m_per_n.clear();
        for j in 0..n {
            for i in 0..n {
                let both = i < local.nodes.len() && j < local.nodes.len();
                let is_free = both && is_free(self.nodes[i]) && is_free(self.nodes[j]);
                let tensor = if is_free { self.tensor_m_per_n(local, [i, j], dt_s) } else { DMat3::ZERO };
                self.response.group_mut(0).compliance_m_per_n.push(tensor);
            }
        }
    }

    /// No tissue is touched: only instruments move.
    pub(super) fn set_no_response(&mut self) {
        self.softness = 1.0;
        self.response.set_group(0, 0..0);
        self.response.group_mut(0).compliance_m_per_n.clear();
        self.moves_m.fill(DVec3::ZERO);
    }

    /// How node `i` of the patch is taken to answer to a force on node `j`.
    fn tensor_m_per_n(&self, local: &LocalModel, [i, j]: [usize; 2], dt_s: f64) -> DMat3 {
        let told = local.tensor_m_per_n(i, j);
        let held = |k: usize| self.is_held[k] && local.mass_kg[k] > 0.0;
        if !held(i) && !held(j) {
            let unknown = i == j && told == DMat3::ZERO;
            return if unknown { DMat3::IDENTITY * UNKNOWN_M_PER_N } else { told * self.softness };
        }
        if i != j {
            return DMat3::ZERO;
        }
        let with_others = (0..local.nodes.len()).filter(|&k| held(k));
        let of_patch = with_others.map(|k| most_of(&local.tensor_m_per_n(i, k))).sum::<f64>() * self.softness;
        let of_mass = dt_s * dt_s / local.mass_kg[i];
        DMat3::IDENTITY * if of_patch > 0.0 { of_mass.min(of_patch) } else { of_mass }
    }

    /// Where the nodes go without what touched them in the last step.
    pub(super) fn set_free_moves(&mut self, local: &LocalModel, velocities_m_per_s: &[DVec3], dt_s: f64) {
        let velocity = |node: &NodeId| velocities_m_per_s.get(node.index()).copied().unwrap_or(DVec3::ZERO);
        let fastest_m_per_s = local.nodes.iter().map(|node| velocity(node).length()).fold(0.0, f64::max);
        self.moves_m.fill(DVec3::ZERO);
        for (j, node) in local.nodes.iter().enumerate() {
            let momentum_kg_per_s = local.mass_kg[j] / dt_s;
            let v = velocity(node);
            let before = self.touched.iter().find(|touched| touched.node == *node);
            let change = before.map_or(DVec3::ZERO, |touched| v - touched.velocity_m_per_s);
            let mut force_n = change * momentum_kg_per_s - self.force_before_n(*node);
            // Of a longer step the elements' answer is that of all nodes together.
            let alone = local.changed_n[j].filter(|_| self.is_held[j] && is_stable(local, j, dt_s));
            match alone {
                Some(changed_n) => {
                    let most_n = MOST_ANSWER * fastest_m_per_s * momentum_kg_per_s;
                    force_n += v * momentum_kg_per_s + changed_n.clamp_length_max(most_n);
                }
                None => self.moves_m[j] += local.drift_m[j],
            }
            self.response.add(j as u32, force_n, &mut self.moves_m);
        }
    }

    /// After contacts were solved: keeps what is known of the touched nodes and what they are expected to do. `before` are the
    /// forces of the step before, with the nodes in the patch's order.
    pub(super) fn expect(
        &mut self,
        positions_m: &[DVec3],
        velocities_m_per_s: &[DVec3],
        before_n: &[DVec3; MOST_NODES],
    ) {
        self.answers_m.fill(DVec3::ZERO);
        self.touched.clear();
        for (i, &node) in self.nodes.iter().enumerate() {
            let force_n = self.force_before_n(node) - before_n[i];
            self.response.add(i as u32, force_n, &mut self.answers_m);
        }
        for (i, &node) in self.nodes.iter().enumerate() {
            self.touched.push(TouchedNode {
                node,
                velocity_m_per_s: velocities_m_per_s.get(node.index()).copied().unwrap_or(DVec3::ZERO),
                expected_m: positions_m[node.index()] + self.moves_m[i],
                answer_m: self.answers_m[i],
                way_m: self.moves_m[i],
            });
        }
    }

    /// Solves the contacts, from the forces that they had.
    pub(super) fn solve(&mut self) {
        for contact in &self.contacts {
            contact.push(contact.force_n, &self.response, &mut self.moves_m);
        }
        self.sweep();
    }

    pub(super) fn sweep(&mut self) {
        self.delassus.solve(&mut self.contacts, &self.response, SWEEPS, &mut self.moves_m);
    }

    /// Contacts of the last step.
    pub(in crate::world) fn n_contacts(&self) -> u32 {
        self.contacts.len() as u32
    }

    /// Torque on a tool about its tip in the last step [N m].
    pub(in crate::world) fn torque_on_tool_n_m(&self, tool: usize) -> DVec3 {
        self.torques_n_m.get(tool).copied().unwrap_or(DVec3::ZERO)
    }

    /// The torque of all contacts on a tool [N m]; forces that are no numbers, which only a broken model can bring about, are none.
    pub(super) fn sum_torque_n_m(&self, tool: usize) -> DVec3 {
        let torques = self.contacts.iter().map(|contact| contact.torque_n_m(turn_vertex_of(tool)));
        torques.filter(|torque_n_m| torque_n_m.is_finite()).sum()
    }

    /// After contacts were solved.
    pub(super) fn settle_torques(&mut self, n_tools: usize) {
        self.torques_n_m =
            std::array::from_fn(|tool| if tool < n_tools { self.sum_torque_n_m(tool) } else { DVec3::ZERO });
    }

    /// The contacts' forces by nodes, of those that move under forces.
    pub(super) fn gather_forces(&mut self, organ: &Organ) {
        self.forces.clear();
        for contact in &self.contacts {
            for (vertex, weight) in contact.sides().filter(|(v, _)| (*v as usize) < self.nodes.len()) {
                let (node, force_n) = (self.nodes[vertex as usize], contact.force_n * weight);
                if organ.is_fixed(node) {
                    continue;
                }
                match self.forces.iter_mut().find(|force| force.node == node) {
                    Some(force) => force.force_n += force_n,
                    None => self.forces.push(NodalForce { node, force_n }),
                }
            }
        }
        self.forces.sort_unstable_by_key(|force| force.node);
    }

    /// A part is told of as its point that bears most, with the force of all; none where none bears any. The way out turns by the
    /// share `learned` towards where its points push: with the points that happen to bear most, what yields along it would shake.
    pub(super) fn settle_points(
        &mut self,
        (place, part): (usize, ToolPart),
        learned: f64,
        held: &mut Option<HeldContact>,
    ) {
        let (mut force_n, mut most, mut most_n) = (DVec3::ZERO, None, 0.0);
        let (mut outward, mut pushes) = ([DVec3::ZERO; SIDES], [DVec3::ZERO; SIDES]);
        let first = vertex_of(place, side_of(part, 0));
        for (contact, (_, bearer)) in self.contacts.iter().zip(&self.of) {
            let Bearer::Point(point) = bearer else { continue };
            let side = contact.vertices[3].wrapping_sub(first) as usize;
            if side >= SIDES || contact.force_n == DVec3::ZERO {
                continue;
            }
            let vertex = contact.vertices[3];
            self.pressed.push(PressedPoint { vertex, at: *point, force_n: contact.force_n });
            let push_n = contact.force_n.dot(contact.normal);
            force_n += contact.force_n;
            // Along the surface's own way: a part's way would turn with where it touches, and that with it.
            outward[side] += point.outward * push_n;
            pushes[side] -= contact.normal * push_n;
            if push_n > most_n {
                most_n = push_n;
                most = Some(*point);
            }
        }
        let mut touches = false;
        for (side, outward) in outward.iter().enumerate() {
            let side = side_of(part, side);
            // What ended otherwise, as by an edit or by letting go, waits for nothing.
            let waits = held.is_some() && self.further_out_m[place][side] > LEAST_FURTHER_OUT_M;
            if *outward != DVec3::ZERO {
                let (known, now) = (self.outward[place][side], outward.normalize_or_zero());
                self.outward[place][side] = known.lerp(now, learned).normalize_or(now);
            } else if !waits {
                self.outward[place][side] = DVec3::ZERO;
                self.sub_grid_m_per_n[place][side] = 0.0;
                self.further_out_m[place][side] = 0.0;
            }
            touches |= self.outward[place][side] != DVec3::ZERO;
        }
        // Of a fold whose sides push against each other the one that pushes more is told of.
        let both: DVec3 = pushes.iter().sum();
        let stronger = pushes.into_iter().max_by(|a, b| a.length().total_cmp(&b.length()));
        let told =
            stronger.map(|most| if both.length() >= LEAST_OF_FOLD * most.length() { both } else { most });
        match (held.as_mut(), most) {
            (Some(held), Some(point)) => held.sit_on(&Seat {
                triangle: point.triangle,
                nodes: point.nodes,
                weights: point.weights,
                at: ToolPoint::OnAxis(part, point.along),
                normal: told.unwrap_or_default().normalize_or(-point.inward),
                force_n,
            }),
            (Some(held), None) if touches => held.forces_n = [DVec3::ZERO; 3],
            _ => *held = None,
        }
    }
}

/// More contacts than this are solved vertex by vertex: their operator would leave the caches. A choice.
const MOST_DENSE: usize = 128;

/// What of the stronger side's push has to be left of both sides' for them to be told of together: a choice.
const LEAST_OF_FOLD: f64 = 0.5;

/// What a gap may close by in a step [m]; with the sign turned, what an overlap has to open by.
pub(super) fn open_m(gap_m: f64, dt_s: f64) -> f64 {
    if gap_m > 0.0 {
        return gap_m;
    }
    (gap_m * (dt_s / PUSH_OUT_S).min(1.0)).max(-PUSH_OUT_M_PER_S * dt_s)
}

/// What a tensor makes of a vector at most, over the vector: a bound, its largest sum of a row.
fn most_of(tensor: &DMat3) -> f64 {
    let rows = tensor.transpose();
    [rows.x_axis, rows.y_axis, rows.z_axis].map(|row| row.abs().element_sum()).into_iter().fold(0.0, f64::max)
}

/// Whether a step is a stable one for what an explicit model says of node `j`.
fn is_stable(local: &LocalModel, j: usize, dt_s: f64) -> bool {
    let most_m_per_n = most_of(&local.tensor_m_per_n(j, j)) * (1.0 + MOST_ANSWER);
    dt_s * dt_s <= local.mass_kg[j] * most_m_per_n
}

/// Where a part moves from against the tissue, where it would be alone, and how the tool turns between.
#[derive(Clone, Copy)]
pub(super) struct PartWay {
    start: Capsule,
    end: Capsule,
    turn: DMat3,
}

impl PartWay {
    /// None of a part that the tool does not have.
    pub(super) fn of(tool: &Tool, part: ToolPart, [from, now]: [&ToolInput; 2]) -> Option<Self> {
        let turn = ToolFrame::of(now).world_from_tool * ToolFrame::of(from).world_from_tool.transpose();
        Some(Self { start: capsule(tool, part, from)?, end: capsule(tool, part, now)?, turn })
    }
}

impl PartWay {
    /// Without so much of the part's length at its start.
    fn without_start(self, length_m: f64) -> Self {
        let from = |capsule: Capsule| {
            let way_m = capsule.to_m - capsule.from_m;
            let off_m = way_m.clamp_length_max(length_m);
            Capsule { from_m: capsule.from_m + off_m, ..capsule }
        };
        Self { start: from(self.start), end: from(self.end), ..self }
    }
}

/// What of a part is needed for its points.
#[derive(Clone, Copy)]
pub(super) struct PartTouch<'a> {
    pub(super) tool: &'a Tool,
    pub(super) way: PartWay,
    pub(super) turning: &'a Turning,
    pub(super) organ: &'a Organ,
    pub(super) dt_s: f64,
    pub(super) contact: Option<&'a Indentation>,
    pub(super) is_linear: bool,
}
