//! Touch by force: instruments that a hand holds by a spring, and all their contacts with the organ solved as one.
//!
//! A hand holds the tip x of an instrument by a spring k and a damper d between it and the place h where it wants it, up to a
//! greatest force ([`Hand`]). The instrument has no mass: in a step of length s a force F of the organ on it moves it from
//! where it would be alone, y, to
//!
//! x = y + F/(k + d/s),   y = h + (x(t) - h(t)) (d/s)/(k + d/s).
//!
//! Where it touches, y is no further from the place x(t) (or from where it began to touch) than the greatest force over
//! k + d/s: the hand gives way, and the instrument follows it at that force. So no motion of a hand can bring about a
//! greater one.
//!
//! The organ answers to forces on its nodes in the step by C, the compliance of the touched nodes
//! ([`crate::model::LocalModel`]). With f and v of the last step, v' of the one before and the nodes' masses m, they go to
//!
//! x(t) + C (F - f + m (2 v - v')/s):
//!
//! what balanced f and the last acceleration goes on. Each contact is a point of a triangle and one of the tool, with the
//! laws of Signorini and Coulomb ([`crate::contact::constraint`]); the instrument is a body of the system with the
//! compliance above. Forces, not displacements, go to the model: whatever C misses is a gap or an overlap that the next step
//! closes, and no law of tissue can answer with more than the hand's force.
//!
//! A node that jaws hold is a contact that sticks and may pull. Of many nodes so near to each other C is not known well enough
//! (tissue that is pulled far has a tangent that is not even positive), so each is taken to answer alone, not softer than its
//! mass m is in the step, s^2/m: that never overshoots, and is made good in some steps.
//!
//! Tissue may be softer than C says, which is then of a stiffer shape or of too small a region: forces would overshoot, and
//! grow from step to step where it is more than twice as soft. So C is multiplied by how much further the touched nodes went in
//! the last step for a change of their forces than they were expected to, if that was further; it comes back to itself in
//! some steps.

use super::World;
use super::grasp::{Grasp, MOST_HELD_NODES};
use super::organ::Organ;
use super::parts::ToolPart;
use super::slide::{Follow, PatchAnswer, UNKNOWN_M_PER_N};
use super::spec::Hand;
use super::tool_state::ToolState;
use super::touch::HeldContact;
use crate::contact::constraint::{Contact, ContactKey, Response, Sweeps, solve};
use crate::math::{DMat3, DVec3};
use crate::mesh::NodeId;
use crate::model::{LocalModel, NodalForce};
use crate::tool::pose::ToolFrame;
use crate::tool::{MAX_TOOLS, Tool, ToolInput};

/// Sweeps over all contacts at most, and when they end: choices.
const SWEEPS: Sweeps = Sweeps { most: 30, tolerance: 1e-4 };
/// The answer of the touched nodes is taken for at most so many times what the model says, grows by so much in a step at most,
/// and keeps this share of what it is beyond that: choices.
const MOST_SOFTER: f64 = 64.0;
const MOST_SOFTER_A_STEP: f64 = 4.0;
const KEPT_SOFTNESS: f64 = 0.9;
/// What jaws hold is taken to be so many times as soft as the model says, each node by itself: no less than what the nodes
/// around it, which are held with it, add. A choice.
const SOFT_HOLD: f64 = 4.0;
const MOST_NODES: usize = LocalModel::MOST_NODES;
const MOST_CONTACTS: usize = (3 + MOST_HELD_NODES) * MAX_TOOLS;
/// Tissue further than this from where its tool would have it [m] is no longer touched by it: it went another way, as tissue that
/// was let go does. A choice, above the way of a step at 5 m/s.
const MOST_APART_M: f64 = 0.05;
/// An instrument that turns about a point nearer than this share of its way to the tip does not give way there.
const LEAST_LEVER: f64 = 0.05;

/// What of a tool bears a contact.
#[derive(Clone, Copy, Debug)]
enum Bearer {
    Part(ToolPart),
    /// Jaws, on the node that they hold.
    Jaws(NodeId),
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
pub(super) struct Press {
    contacts: Vec<Contact>,
    /// Tool and part of each contact.
    of: Vec<(usize, Bearer)>,
    nodes: Vec<NodeId>,
    /// Whether jaws hold each of the nodes.
    is_held: Vec<bool>,
    response: Response,
    moves_m: Vec<DVec3>,
    /// Forces on the nodes in the last step, ascending by node.
    forces: Vec<NodalForce>,
    touched: Vec<TouchedNode>,
    /// How many times as soft as the model says the touched nodes are taken to be.
    softness: f64,
    /// Scratch: the answer to the change of the forces.
    answers_m: Vec<DVec3>,
}

impl Press {
    pub(super) fn new() -> Self {
        Self {
            contacts: Vec::with_capacity(MOST_CONTACTS),
            of: Vec::with_capacity(MOST_CONTACTS),
            nodes: Vec::with_capacity(MOST_NODES),
            is_held: Vec::with_capacity(MOST_NODES),
            response: Response::new(MOST_NODES + MAX_TOOLS, 1).with_room_for_groups_of(MOST_NODES),
            moves_m: vec![DVec3::ZERO; MOST_NODES + MAX_TOOLS],
            forces: Vec::with_capacity(MOST_NODES),
            touched: Vec::with_capacity(MOST_NODES),
            softness: 1.0,
            answers_m: vec![DVec3::ZERO; MOST_NODES + MAX_TOOLS],
        }
    }

    /// The same with its room.
    pub(super) fn duplicate(&self) -> Self {
        let mut copy = Self::new();
        copy.forces.extend_from_slice(&self.forces);
        copy.touched.extend_from_slice(&self.touched);
        copy.softness = self.softness;
        copy
    }

    /// Everything that the next step depends on.
    pub(super) fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        let forces = self.forces.iter().map(|force| (force.node, force.force_n));
        let touched = self.touched.iter().flat_map(|touched| {
            let vectors = [touched.velocity_m_per_s, touched.expected_m, touched.answer_m, touched.way_m];
            vectors.map(|vector| (touched.node, vector))
        });
        let numbers = forces.chain(touched).flat_map(|(node, v)| [f64::from(node.0), v.x, v.y, v.z]);
        numbers.chain((self.softness != 1.0).then_some(self.softness))
    }

    /// Forces on the nodes in this step, ascending by node.
    pub(super) fn forces(&self) -> &[NodalForce] {
        &self.forces
    }

    pub(super) fn forget(&mut self) {
        self.forces.clear();
        self.touched.clear();
        self.softness = 1.0;
    }

    /// After a step: whether the touched nodes, now at `positions_m`, are softer than they were taken to be.
    fn learn_softness(&mut self, positions_m: &[DVec3]) {
        let (mut further_m2, mut answered_m2) = (0.0, 0.0);
        for touched in &self.touched {
            let Some(now_m) = positions_m.get(touched.node.index()) else { continue };
            further_m2 += (*now_m - touched.expected_m).dot(touched.answer_m);
            // Where the way is not the forces' doing, how far it led says little of them.
            answered_m2 += touched.answer_m.length_squared() + touched.way_m.length_squared();
        }
        let times = (1.0 + further_m2 / answered_m2).min(MOST_SOFTER_A_STEP);
        let kept = 1.0 + (self.softness - 1.0) * KEPT_SOFTNESS;
        let seen = if times.is_finite() { self.softness * times } else { 1.0 };
        self.softness = kept.max(seen).clamp(1.0, MOST_SOFTER);
    }

    /// Forgets the contacts of the step before and lists what is touched now.
    fn start(&mut self, states: &[ToolState]) {
        self.contacts.clear();
        self.of.clear();
        self.nodes.clear();
        self.is_held.clear();
        let held = states.iter().filter_map(|state| state.grasp.as_ref()).flat_map(Grasp::nodes);
        let touched = states.iter().flat_map(|state| state.contacts.iter().flatten());
        let touched = touched.flat_map(|contact| contact.nodes).map(|node| (node, false));
        for (node, is_held) in held.map(|node| (node, true)).chain(touched) {
            if self.number_of(node).is_none() && self.nodes.len() < MOST_NODES {
                self.nodes.push(node);
                self.is_held.push(is_held);
            }
        }
    }

    /// The contact of a part of a tool.
    fn add_part(
        &mut self,
        (place, part): (usize, ToolPart),
        held: &HeldContact,
        (tool, pose): (&Tool, &ToolInput),
        organ: &Organ,
    ) {
        let place_m = held.at.in_world_m(tool, pose);
        let target_m = place_m + held.offset_m;
        let [Some(a), Some(b), Some(c)] = held.nodes.map(|node| self.number_of(node)) else { return };
        let key = ContactKey::VertexObstacle(place as u32, part.index() as u32);
        let mut contact = Contact::new(key, -held.normal, 0.0);
        contact.vertices = [a as u32, b as u32, c as u32, (MOST_NODES + place) as u32];
        let [wa, wb, wc] = held.weights;
        contact.weights = [wa, wb, wc, -lever(tool, pose, place_m)];
        contact.point_m = target_m;
        contact.moved_m = target_m - held.point_m(organ.positions_m());
        contact.friction = tool.grip.friction_coefficient;
        contact.sticks = tool.grip.is_sticky;
        contact.force_n = held.force_on_organ_n();
        self.contacts.push(contact);
        self.of.push((place, Bearer::Part(part)));
    }

    /// A node that jaws hold and move, with the force of the step before.
    fn add_held(&mut self, (place, node): (usize, NodeId), [moved_m, force_n]: [DVec3; 2], lever: f64) {
        let Some(number) = self.number_of(node) else { return };
        let mut contact = Contact::new(ContactKey::VertexObstacle(place as u32, node.0), DVec3::Z, 0.0);
        contact.vertices = [number as u32, 0, 0, (MOST_NODES + place) as u32];
        contact.weights = [1.0, 0.0, 0.0, -lever];
        contact.moved_m = moved_m;
        contact.sticks = true;
        contact.force_n = force_n;
        self.contacts.push(contact);
        self.of.push((place, Bearer::Jaws(node)));
    }

    /// A node's number in the patch.
    fn number_of(&self, node: NodeId) -> Option<usize> {
        self.nodes.iter().position(|n| *n == node)
    }

    fn force_before_n(&self, node: NodeId) -> DVec3 {
        let found = self.forces.iter().find(|force| force.node == node);
        found.map_or(DVec3::ZERO, |force| force.force_n)
    }

    /// What of the patch's answer a model tells, with a guess for nodes of which it tells nothing; none for those that do not
    /// move under forces.
    fn set_response(&mut self, local: &LocalModel, is_free: impl Fn(NodeId) -> bool, dt_s: f64) {
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
        let of_mass = dt_s * dt_s / local.mass_kg[i];
        let of_patch = told * SOFT_HOLD;
        let mean = (of_patch.x_axis.x + of_patch.y_axis.y + of_patch.z_axis.z) / 3.0;
        if mean > 0.0 && mean < of_mass { of_patch } else { DMat3::IDENTITY * of_mass }
    }

    /// Where the nodes go without what touched them in the last step.
    fn set_free_moves(&mut self, local: &LocalModel, velocities_m_per_s: &[DVec3], dt_s: f64) {
        self.moves_m.fill(DVec3::ZERO);
        for (i, drift_m) in local.drift_m.iter().enumerate() {
            // What jaws hold is taken to answer node by node, to its own momentum too.
            self.moves_m[i] = if self.is_held[i] { DVec3::ZERO } else { *drift_m };
        }
        for j in 0..local.nodes.len() {
            let node = local.nodes[j];
            let v = velocities_m_per_s.get(node.index()).copied().unwrap_or(DVec3::ZERO);
            let before = self.touched.iter().find(|touched| touched.node == node);
            let change = before.map_or(DVec3::ZERO, |touched| v - touched.velocity_m_per_s);
            let own = if self.is_held[j] { v } else { DVec3::ZERO };
            let force_n = (own + change) * (local.mass_kg[j] / dt_s) - self.force_before_n(node);
            self.response.add(j as u32, force_n, &mut self.moves_m);
        }
    }

    /// After contacts were solved: keeps what is known of the touched nodes and what they are expected to do. `before` are the
    /// forces of the step before, with the nodes in the patch's order.
    fn expect(
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
    fn solve(&mut self) {
        for contact in &self.contacts {
            for (vertex, weight) in contact.sides() {
                self.response.add(vertex, contact.force_n * weight, &mut self.moves_m);
            }
        }
        solve(&mut self.contacts, &self.response, SWEEPS, &mut self.moves_m);
    }

    /// Where an instrument whose contacts bear more than the hand's greatest force goes with that force: it stays on what it
    /// touches.
    fn give_way(&mut self, tool: usize, hand: &Hand) {
        let vertex = (MOST_NODES + tool) as u32;
        self.limit_each(vertex, hand.greatest_force_n);
        let on_tool_n = |contact: &Contact| contact.force_n * contact.weights[3];
        let own = |contact: &&Contact| contact.vertices[3] == vertex;
        let force_n: DVec3 = self.contacts.iter().filter(own).map(on_tool_n).sum();
        let share = hand.greatest_force_n / force_n.length();
        let gives_way = share.is_finite() && share < 1.0;
        if gives_way {
            for c in 0..self.contacts.len() {
                if self.contacts[c].vertices[3] == vertex {
                    self.lessen(c, share);
                }
            }
        }
        let free = |contact: &&Contact| own(contact) && !contact.sticks;
        for contact in self.contacts.iter().filter(free) {
            let opening_m = contact.relative_m(&self.moves_m).dot(contact.normal) + contact.slack_m;
            if opening_m < 0.0 && contact.weights[3] < -LEAST_LEVER {
                self.moves_m[vertex as usize] += contact.normal * (opening_m / -contact.weights[3]);
            }
        }
        let (mut off_m, mut n) = (DVec3::ZERO, 0);
        let held = |contact: &&Contact| own(contact) && contact.sticks && contact.weights[3] < -LEAST_LEVER;
        for contact in self.contacts.iter().filter(held).filter(|_| gives_way) {
            off_m += contact.relative_m(&self.moves_m) / -contact.weights[3];
            n += 1;
        }
        if n > 0 {
            self.moves_m[vertex as usize] += off_m / f64::from(n);
        }
    }

    /// No contact of a tool bears more than its hand can.
    fn limit_each(&mut self, vertex: u32, most_n: f64) {
        for c in 0..self.contacts.len() {
            let share = most_n / self.contacts[c].force_n.length();
            if self.contacts[c].vertices[3] == vertex && share < 1.0 {
                self.lessen(c, share);
            }
        }
    }

    /// Leaves a share of a contact's force.
    fn lessen(&mut self, c: usize, share: f64) {
        let contact = self.contacts[c];
        for (vertex, weight) in contact.sides() {
            self.response.add(vertex, contact.force_n * ((share - 1.0) * weight), &mut self.moves_m);
        }
        self.contacts[c].force_n = contact.force_n * share;
    }

    /// The contacts' forces by nodes.
    fn gather_forces(&mut self) {
        self.forces.clear();
        for contact in &self.contacts {
            for (vertex, weight) in contact.sides().filter(|(v, _)| (*v as usize) < self.nodes.len()) {
                let (node, force_n) = (self.nodes[vertex as usize], contact.force_n * weight);
                match self.forces.iter_mut().find(|force| force.node == node) {
                    Some(force) => force.force_n += force_n,
                    None => self.forces.push(NodalForce { node, force_n }),
                }
            }
        }
        self.forces.sort_unstable_by_key(|force| force.node);
    }
}

/// How far a point of a tool moves across its shaft when the tip moves: less, nearer to a trocar.
fn lever(tool: &Tool, pose: &ToolInput, point_m: DVec3) -> f64 {
    let Some(trocar_m) = tool.trocar_m else { return 1.0 };
    let length_m = trocar_m.distance(pose.tip_in_world_m);
    let behind_m = pose.shaft_in_world.dot(point_m - pose.tip_in_world_m);
    if length_m > tool.tip_radius_m { (1.0 - behind_m / length_m).clamp(0.0, 1.0) } else { 1.0 }
}

impl World {
    /// Moves the instruments against what they touch, and finds the forces. Allocates nothing.
    pub(super) fn press(&mut self) {
        let Some(hand) = self.spec.hand else { return };
        for place in 0..self.tool_states.len() {
            self.hold_back(place, &hand);
            self.slide_contacts(place, &hand);
        }
        self.gather_contacts(&hand);
        if self.press.contacts.is_empty() {
            self.press.forget();
            return;
        }
        self.press.solve();
        for place in 0..self.tool_states.len() {
            self.press.give_way(place, &hand);
        }
        let before_n = std::array::from_fn(|i| {
            self.press.nodes.get(i).map_or(DVec3::ZERO, |node| self.press.force_before_n(*node))
        });
        self.press.gather_forces();
        let velocities_m_per_s = self.model.state().velocities_m_per_s;
        self.press.expect(self.organ.positions_m(), velocities_m_per_s, &before_n);
        self.settle();
    }

    /// Before contacts are solved: an instrument that touches or holds is no further from where it was than the hand's
    /// greatest force allows.
    fn hold_back(&mut self, place: usize, hand: &Hand) {
        let dt_s = self.spec.time_step_s;
        let (state, tool) = (&mut self.tool_states[place], &self.spec.tools[place]);
        let touches = state.contacts.iter().any(Option::is_some);
        if !touches && state.grasp.is_none() {
            return;
        }
        let (before_m, alone_m) = (state.before.tip_in_world_m, state.now.tip_in_world_m);
        let from_m = before_m.lerp(alone_m, state.start_share());
        let tip_m = from_m + (alone_m - from_m).clamp_length_max(hand.most_behind_m(dt_s));
        state.put_tip(tool, tip_m);
        for contact in state.contacts.iter_mut().flatten() {
            if contact.is_new() {
                contact.anchor_overlap(contact.at.in_world_m(tool, &state.now), &self.organ);
            }
        }
    }

    /// Lets the touched points slide where friction does not hold them.
    fn slide_contacts(&mut self, place: usize, hand: &Hand) {
        let dt_s = self.spec.time_step_s;
        let (state, tool) = (&mut self.tool_states[place], &self.spec.tools[place]);
        for part in ToolPart::ALL {
            let contact = &mut state.contacts[part.index()];
            contact.take_if(|contact| {
                let target_m = contact.at.in_world_m(tool, &state.now) + contact.offset_m;
                target_m.distance(contact.point_m(self.organ.positions_m())) > MOST_APART_M
            });
            let Some(contact) = contact else { continue };
            let follow = Follow {
                organ: &self.organ,
                point_m: contact.at.in_world_m(tool, &state.now),
                radius_m: part.radius_m(tool),
                friction: if tool.grip.is_sticky { f64::INFINITY } else { tool.grip.friction_coefficient },
                hand_m_per_n: Some(1.0 / hand.step_stiffness_n_per_m(dt_s)),
            };
            let (model, slide) = (&mut self.model, &mut self.slide);
            contact.slide(&follow, |nodes| {
                model.local_model_into(&nodes, dt_s, &mut slide.work, &mut slide.local);
                PatchAnswer::of(&slide.local, nodes.map(|node| !self.organ.is_fixed(node)))
            });
        }
    }

    /// Puts all contacts into one system, with how organ and instruments answer.
    fn gather_contacts(&mut self, hand: &Hand) {
        let dt_s = self.spec.time_step_s;
        let press = &mut self.press;
        press.learn_softness(self.organ.positions_m());
        press.start(&self.tool_states);
        if press.nodes.is_empty() {
            return;
        }
        let (organ, states) = (&self.organ, &self.tool_states);
        let slide = &mut self.slide;
        self.model.local_model_into(&press.nodes, dt_s, &mut slide.drifting, &mut slide.local);
        press.set_response(&slide.local, |node| !organ.is_fixed(node), dt_s);
        press.set_free_moves(&slide.local, self.model.state().velocities_m_per_s, dt_s);
        for (place, (state, tool)) in states.iter().zip(&self.spec.tools).enumerate() {
            let stiffness_n_per_m = hand.step_stiffness_n_per_m(dt_s);
            let vertex = (MOST_NODES + place) as u32;
            press.response.set_alone(vertex, DVec3::splat(1.0 / stiffness_n_per_m));
            for part in ToolPart::ALL {
                let Some(held) = &state.contacts[part.index()] else { continue };
                press.add_part((place, part), held, (tool, &state.now), organ);
            }
            let Some(grasp) = &state.grasp else { continue };
            for (node, place_m) in grasp.places_m(ToolFrame::of(&state.now)) {
                let moved_m = place_m - organ.positions_m()[node.index()];
                let force_n = grasp.force_on_node_n(node);
                press.add_held((place, node), [moved_m, force_n], lever(tool, &state.now, place_m));
            }
        }
    }

    /// After contacts were solved: instruments go where their contacts let them, contacts learn their forces, and those that
    /// bear none end.
    fn settle(&mut self) {
        for (place, (state, tool)) in self.tool_states.iter_mut().zip(&self.spec.tools).enumerate() {
            let moved_m = self.press.moves_m[MOST_NODES + place];
            if moved_m != DVec3::ZERO && moved_m.is_finite() {
                state.put_tip(tool, state.now.tip_in_world_m + moved_m);
            }
        }
        for (contact, &(place, bearer)) in self.press.contacts.iter().zip(&self.press.of) {
            let state = &mut self.tool_states[place];
            let part = match bearer {
                Bearer::Part(part) => part,
                Bearer::Jaws(node) => {
                    if let Some(grasp) = &mut state.grasp {
                        grasp.set_force_n(node, contact.force_n);
                    }
                    continue;
                }
            };
            let held = &mut state.contacts[part.index()];
            if let Some(held) = held {
                held.forces_n = held.weights.map(|weight| contact.force_n * weight);
            }
            if contact.force_n == DVec3::ZERO && !contact.sticks {
                *held = None;
            }
        }
    }
}
