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
//! What jaws hold follows them exactly. The instrument then goes by the force that it bore and an estimate of how that grows.

use super::World;
use super::parts::ToolPart;
use super::slide::{Follow, PatchAnswer, UNKNOWN_M_PER_N};
use super::spec::Hand;
use crate::contact::constraint::{Contact, ContactKey, Response, Sweeps, solve};
use crate::math::{DMat3, DVec3};
use crate::mesh::NodeId;
use crate::model::{LocalModel, NodalForce};
use crate::tool::pose::ToolFrame;
use crate::tool::{MAX_TOOLS, Tool, ToolInput};

/// Sweeps over all contacts at most, and when they end: choices.
const SWEEPS: Sweeps = Sweeps { most: 30, tolerance: 1e-4 };
const MOST_NODES: usize = LocalModel::MOST_NODES;
const MOST_CONTACTS: usize = 3 * MAX_TOOLS;
/// An instrument that turns about a point nearer than this share of its way to the tip does not give way there.
const LEAST_LEVER: f64 = 0.05;

/// A touched node and its velocity before the last step [m/s].
#[derive(Clone, Copy, Debug, PartialEq)]
struct TouchedNode {
    node: NodeId,
    velocity_m_per_s: DVec3,
}

/// The contacts of a step and what they need, with room for the most.
#[derive(Debug)]
pub(super) struct Press {
    contacts: Vec<Contact>,
    /// Tool and part of each contact.
    of: Vec<(usize, ToolPart)>,
    nodes: Vec<NodeId>,
    response: Response,
    moves_m: Vec<DVec3>,
    /// Forces on the nodes in the last step, ascending by node.
    forces: Vec<NodalForce>,
    touched: Vec<TouchedNode>,
}

impl Press {
    pub(super) fn new() -> Self {
        Self {
            contacts: Vec::with_capacity(MOST_CONTACTS),
            of: Vec::with_capacity(MOST_CONTACTS),
            nodes: Vec::with_capacity(MOST_NODES),
            response: Response::new(MOST_NODES + MAX_TOOLS, 1).with_room_for_groups_of(MOST_NODES),
            moves_m: vec![DVec3::ZERO; MOST_NODES + MAX_TOOLS],
            forces: Vec::with_capacity(MOST_NODES),
            touched: Vec::with_capacity(MOST_NODES),
        }
    }

    /// The same with its room.
    pub(super) fn duplicate(&self) -> Self {
        let mut copy = Self::new();
        copy.forces.extend_from_slice(&self.forces);
        copy.touched.extend_from_slice(&self.touched);
        copy
    }

    /// Everything that the next step depends on.
    pub(super) fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        let forces = self.forces.iter().map(|force| (force.node, force.force_n));
        let touched = self.touched.iter().map(|touched| (touched.node, touched.velocity_m_per_s));
        forces.chain(touched).flat_map(|(node, v)| [f64::from(node.0), v.x, v.y, v.z])
    }

    /// Forces on the nodes in this step, ascending by node.
    pub(super) fn forces(&self) -> &[NodalForce] {
        &self.forces
    }

    pub(super) fn forget(&mut self) {
        self.forces.clear();
        self.touched.clear();
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
    fn set_response(&mut self, local: &LocalModel, is_free: impl Fn(NodeId) -> bool) {
        let n = self.nodes.len();
        self.response.set_group(0, 0..n as u32);
        let group = self.response.group_mut(0);
        group.compliance_m_per_n.clear();
        for j in 0..n {
            for i in 0..n {
                let both = i < local.nodes.len() && j < local.nodes.len();
                let is_free = both && is_free(self.nodes[i]) && is_free(self.nodes[j]);
                let told = if is_free { local.tensor_m_per_n(i, j) } else { DMat3::ZERO };
                let unknown = is_free && i == j && told == DMat3::ZERO;
                let tensor = if unknown { DMat3::IDENTITY * UNKNOWN_M_PER_N } else { told };
                group.compliance_m_per_n.push(tensor);
            }
        }
    }

    /// Where the nodes go without what touched them in the last step.
    fn set_free_moves(&mut self, local: &LocalModel, velocities_m_per_s: &[DVec3], dt_s: f64) {
        self.moves_m.fill(DVec3::ZERO);
        for (i, drift_m) in local.drift_m.iter().enumerate() {
            self.moves_m[i] = *drift_m;
        }
        for j in 0..local.nodes.len() {
            let node = local.nodes[j];
            let v = velocities_m_per_s.get(node.index()).copied().unwrap_or(DVec3::ZERO);
            let before = self.touched.iter().find(|touched| touched.node == node);
            let change = before.map_or(DVec3::ZERO, |touched| v - touched.velocity_m_per_s);
            let force_n = change * (local.mass_kg[j] / dt_s) - self.force_before_n(node);
            self.response.add(j as u32, force_n, &mut self.moves_m);
        }
        self.touched.clear();
        let touched = local.nodes.iter().filter_map(|&node| {
            let velocity_m_per_s = *velocities_m_per_s.get(node.index())?;
            Some(TouchedNode { node, velocity_m_per_s })
        });
        self.touched.extend(touched);
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
        let on_tool_n = |contact: &Contact| contact.force_n * contact.weights[3];
        let own = |contact: &&Contact| contact.vertices[3] == vertex;
        let force_n: DVec3 = self.contacts.iter().filter(own).map(on_tool_n).sum();
        let share = hand.greatest_force_n / force_n.length();
        if share.is_finite() && share < 1.0 {
            for c in 0..self.contacts.len() {
                let contact = self.contacts[c];
                if contact.vertices[3] != vertex {
                    continue;
                }
                let less_n = contact.force_n * (share - 1.0);
                for (vertex, weight) in contact.sides() {
                    self.response.add(vertex, less_n * weight, &mut self.moves_m);
                }
                self.contacts[c].force_n = contact.force_n * share;
            }
        }
        for contact in self.contacts.iter().filter(own) {
            let opening_m = contact.relative_m(&self.moves_m).dot(contact.normal) + contact.slack_m;
            if opening_m < 0.0 && contact.weights[3] < -LEAST_LEVER {
                self.moves_m[vertex as usize] += contact.normal * (opening_m / -contact.weights[3]);
            }
        }
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
        self.press.gather_forces();
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
        let from_m = before_m.lerp(alone_m, if state.grasp.is_some() { 0.0 } else { state.start_share() });
        let ahead_m = (alone_m - from_m).clamp_length_max(hand.most_behind_m(dt_s));
        let mut tip_m = from_m + ahead_m;
        if state.grasp.is_some() {
            let stiffness_n_per_m = hand.step_stiffness_n_per_m(dt_s);
            let pull_n = ahead_m * stiffness_n_per_m + state.grasp_force_n;
            tip_m = from_m + pull_n / (stiffness_n_per_m + state.grasp_n_per_m);
        }
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
            let Some(contact) = &mut state.contacts[part.index()] else { continue };
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
        press.contacts.clear();
        press.of.clear();
        press.nodes.clear();
        for state in &self.tool_states {
            for node in state.contacts.iter().flatten().flat_map(|contact| contact.nodes) {
                if press.number_of(node).is_none() && press.nodes.len() < MOST_NODES {
                    press.nodes.push(node);
                }
            }
        }
        if press.nodes.is_empty() {
            return;
        }
        let (organ, states) = (&self.organ, &self.tool_states);
        let is_held = |node| states.iter().any(|s| s.grasp.as_ref().is_some_and(|grasp| grasp.has(node)));
        let slide = &mut self.slide;
        self.model.local_model_into(&press.nodes, dt_s, &mut slide.drifting, &mut slide.local);
        press.set_response(&slide.local, |node| !organ.is_fixed(node) && !is_held(node));
        press.set_free_moves(&slide.local, self.model.state().velocities_m_per_s, dt_s);
        for state in states {
            let Some(grasp) = &state.grasp else { continue };
            for (node, place_m) in grasp.places_m(ToolFrame::of(&state.now)) {
                if let Some(i) = press.nodes.iter().position(|n| *n == node) {
                    press.moves_m[i] = place_m - organ.positions_m()[node.index()];
                }
            }
        }
        for (place, (state, tool)) in states.iter().zip(&self.spec.tools).enumerate() {
            let stiffness_n_per_m = hand.step_stiffness_n_per_m(dt_s) + state.grasp_n_per_m;
            let vertex = (MOST_NODES + place) as u32;
            press.response.set_alone(vertex, DVec3::splat(1.0 / stiffness_n_per_m));
            for part in ToolPart::ALL {
                let Some(held) = &state.contacts[part.index()] else { continue };
                let place_m = held.at.in_world_m(tool, &state.now);
                let numbers = held.nodes.map(|node| press.number_of(node));
                let [Some(a), Some(b), Some(c)] = numbers else { continue };
                let lever = lever(tool, &state.now, place_m);
                let key = ContactKey::VertexObstacle(place as u32, part.index() as u32);
                let target_m = place_m + held.offset_m;
                let mut contact = Contact::new(key, -held.normal, 0.0);
                contact.vertices = [a as u32, b as u32, c as u32, vertex];
                contact.weights = [held.weights[0], held.weights[1], held.weights[2], -lever];
                contact.point_m = target_m;
                contact.moved_m = target_m - held.point_m(organ.positions_m());
                contact.friction = tool.grip.friction_coefficient;
                contact.sticks = tool.grip.is_sticky;
                contact.force_n = held.force_on_organ_n();
                press.contacts.push(contact);
                press.of.push((place, part));
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
        for (contact, &(place, part)) in self.press.contacts.iter().zip(&self.press.of) {
            let held = &mut self.tool_states[place].contacts[part.index()];
            if let Some(held) = held {
                held.forces_n = held.weights.map(|weight| contact.force_n * weight);
            }
            if contact.force_n == DVec3::ZERO && !contact.sticks {
                *held = None;
            }
        }
    }
}
