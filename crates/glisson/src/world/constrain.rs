//! The stages of a step around the model: what the hands do to it, and what they feel of it.

use super::bodies::SurfaceContact;
use super::grasp::{Grasp, Hold};
use super::parts::ToolPart;
use super::slide::{Follow, PatchAnswer};
use super::spec::MOST_SUTURES;
use super::sutures::Suture;
use super::tear::edge_motion_m;
use super::tool_state::{ContactSearch, ToolState};
use super::touch::HeldContact;
use super::{StepInput, World};
use crate::math::DVec3;
use crate::mesh::NodeId;
use crate::model::{ImposedDisplacement, NodalForce};
use crate::tool::pose::ToolFrame;

/// Displacements imposed at once at most: what every model takes.
pub(super) const MOST_IMPOSED: usize = 64;

/// Whose an imposed displacement is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Owner {
    hand: u8,
    /// A part that touches; `None` for jaws that hold.
    part: Option<ToolPart>,
}

/// Lists that ascend by node as one.
fn merge_into<const N: usize>(lists: [&[NodalForce]; N], forces: &mut Vec<NodalForce>) {
    let mut left = lists;
    forces.clear();
    while let Some(node) = left.iter().filter_map(|list| list.first()).map(|force| force.node).min() {
        let mut force_n = DVec3::ZERO;
        for list in &mut left {
            if let Some((force, rest)) = list.split_first().filter(|(force, _)| force.node == node) {
                force_n += force.force_n;
                *list = rest;
            }
        }
        forces.push(NodalForce { node, force_n });
    }
}

impl World {
    /// Moves the tools and finds what they begin to touch and hold.
    pub(super) fn move_hands(&mut self, input: &StepInput) {
        self.organ.refresh();
        let held = self.spec.hand.as_ref().map(|hand| (hand, self.spec.time_step_s));
        for (place, (hand, tool)) in self.tool_states.iter_mut().zip(&self.spec.tools).enumerate() {
            hand.move_to(tool, place, input, held);
            if input.placed[place] {
                self.press.forget_tool(place);
                self.sutures.iter_mut().for_each(|suture| suture.let_go(place));
                self.loops.let_go(place);
            }
            if let Some(jaws) = tool.kind.jaws() {
                let pose = hand.now;
                if hand.grasp.as_ref().is_some_and(|grasp| !grasp.holds(&pose)) {
                    hand.grasp = None;
                }
                hand.follow_jaws(tool, self.spec.time_step_s);
                if hand.just_closed && hand.grasp.is_none() && tool.kind.holds() {
                    let (opening, near) = (hand.opened_to, &mut self.between_jaws);
                    let on_mesh = (&pose, self.press.tip_further_out_m(place));
                    hand.grasp = Grasp::close(tool, jaws, on_mesh, opening, &self.organ, near);
                    if hand.grasp.is_some() {
                        hand.contacts[ToolPart::Tip.index()] = None;
                        hand.contacts[ToolPart::SecondJaw.index()] = None;
                    }
                }
            }
            hand.follow_edge(tool, &self.organ);
            let search = ContactSearch {
                organ: &self.organ,
                tearing: self.spec.tearing.as_ref(),
                is_placed: input.placed[place],
                fixed_stops: self.spec.hand.is_some(),
                is_in_loop: self.loops.is_drawn(place),
                detected: input.detected_on(place, self.organ.topology_version()),
            };
            hand.find_contacts(tool, &search);
            for contact in hand.contacts.iter_mut().flatten() {
                contact.push_out(self.spec.time_step_s);
            }
        }
    }

    /// Tells the model what the hands and the loads impose, in a step of so many parts.
    pub(super) fn constrain(&mut self, n_substeps: u32) {
        self.constraints.displacements.clear();
        self.owners.clear();
        if self.spec.hand.is_some() {
            self.press();
            self.report.n_contact_points = self.press.n_contacts();
        } else {
            self.impose_grasps();
            for part in ToolPart::ALL {
                self.impose_contacts(part);
            }
        }
        self.hold_back_from_threads();
        self.sew();
        self.draw_loops();
        self.sort_imposed();
        self.gather_forces(n_substeps);
        self.apply_constraints();
        let fields_m_per_s2 = self.loads.acceleration_in_step_m_per_s2(self.step);
        let pull_m_per_s2 = self.gravity_m_per_s2 + fields_m_per_s2;
        if pull_m_per_s2 != self.pull_m_per_s2 {
            self.pull_m_per_s2 = pull_m_per_s2;
            self.model.set_gravity(pull_m_per_s2);
        }
    }

    /// The loads, and the springs where the organ touches itself.
    fn gather_forces(&mut self, n_substeps: u32) {
        let dt_s = self.spec.time_step_s / f64::from(n_substeps);
        let springs = match &mut self.self_contact {
            Some(self_contact) => self_contact.forces(self.model.as_ref(), dt_s),
            None => &[],
        };
        let of_threads: [&[NodalForce]; MOST_SUTURES] =
            std::array::from_fn(|i| self.sutures.get(i).map_or(&[][..], Suture::forces));
        let [a, b, c, d] = of_threads;
        let loads = self.loads.forces_in_step(self.step);
        merge_into(
            [springs, loads, self.press.forces(), a, b, c, d, self.loops.forces()],
            &mut self.constraints.forces,
        );
    }

    /// The springs' forces for the next part of a step.
    pub(super) fn push_self_contacts(&mut self, n_substeps: u32) {
        if self.self_contact.as_deref().is_some_and(SurfaceContact::acts_by_forces) {
            self.gather_forces(n_substeps);
            self.apply_constraints();
        }
    }

    fn apply_constraints(&mut self) {
        self.model.apply(&self.constraints);
        self.loops.springs().for_each(|spring| self.model.steady(*spring));
    }

    /// What jaws hold, the first hand's first: a node that two hold follows the first.
    fn impose_grasps(&mut self) {
        let rest_m = &self.organ.mesh().positions_m;
        for (place, hand) in self.tool_states.iter().enumerate() {
            let Some(grasp) = &hand.grasp else { continue };
            for (node, place_m) in grasp.places_m(ToolFrame::of(&hand.now)) {
                let displacements = &mut self.constraints.displacements;
                let is_free = displacements.iter().all(|c| c.node != node);
                if is_free && displacements.len() < MOST_IMPOSED {
                    let displacement_m = place_m - rest_m[node.index()];
                    displacements.push(ImposedDisplacement { node, displacement_m });
                    self.owners.push(Owner { hand: place as u8, part: None });
                }
            }
        }
    }

    /// What one part of every tool touches, but for nodes that something else moves already.
    fn impose_contacts(&mut self, part: ToolPart) {
        let response_s = self.spec.time_step_s;
        for (place, (hand, tool)) in self.tool_states.iter_mut().zip(&self.spec.tools).enumerate() {
            let Some(contact) = &mut hand.contacts[part.index()] else { continue };
            let displacements = &mut self.constraints.displacements;
            let follow = Follow {
                organ: &self.organ,
                point_m: contact.at.in_world_m(tool, &hand.now),
                radius_m: part.radius_m(tool),
                friction: if tool.grip.is_sticky { f64::INFINITY } else { tool.grip.friction_coefficient },
                hand_m_per_n: None,
            };
            let (model, slide) = (&mut self.model, &mut self.slide);
            let answer = |nodes: [NodeId; 3]| {
                model.local_model_into(&nodes, response_s, &mut slide.work, &mut slide.local);
                let is_taken = |node: NodeId| displacements.iter().any(|c| c.node == node);
                let is_free = nodes.map(|node| !is_taken(node) && !self.organ.is_fixed(node));
                PatchAnswer::of(&slide.local, is_free)
            };
            let found_m = contact.follow(&follow, answer);
            for (node, displacement_m) in contact.nodes.into_iter().zip(found_m) {
                if let Some(displacement_m) = displacement_m
                    && displacements.len() < MOST_IMPOSED
                {
                    displacements.push(ImposedDisplacement { node, displacement_m });
                    self.owners.push(Owner { hand: place as u8, part: Some(part) });
                }
            }
        }
    }

    /// Ascending by node, as models ask for; few enough for sorting by insertion.
    fn sort_imposed(&mut self) {
        let displacements = &mut self.constraints.displacements;
        for i in 1..displacements.len() {
            let mut at = i;
            while at > 0 && displacements[at - 1].node > displacements[at].node {
                displacements.swap(at - 1, at);
                self.owners.swap(at - 1, at);
                at -= 1;
            }
        }
    }

    /// Force that a hand exerts on the organ in the last step [N]: with one part, or with what its jaws hold.
    pub(super) fn force_on_organ_n(&self, hand: usize, part: Option<ToolPart>) -> DVec3 {
        if self.spec.hand.is_some() {
            let state = &self.tool_states[hand];
            return match part {
                Some(part) => {
                    state.contacts[part.index()].as_ref().map_or(DVec3::ZERO, HeldContact::force_on_organ_n)
                }
                None => state.grasp.as_ref().map_or(DVec3::ZERO, Grasp::force_on_organ_n),
            };
        }
        let owner = Owner { hand: hand as u8, part };
        let forces = self.model.constraint_forces_n().iter().zip(&self.owners);
        forces.filter(|(_, o)| **o == owner).map(|(force_n, _)| *force_n).sum()
    }

    /// Force of a hand on one of the nodes that its jaws hold in the last step [N].
    pub(super) fn force_on_node_n(&self, hand: usize, node: NodeId) -> DVec3 {
        if self.spec.hand.is_some() {
            let grasp = self.tool_states[hand].grasp.as_ref();
            return grasp.map_or(DVec3::ZERO, |grasp| grasp.force_on_node_n(node));
        }
        let owner = Owner { hand: hand as u8, part: None };
        let imposed = self.constraints.displacements.iter().zip(&self.owners);
        let mut forces = imposed.zip(self.model.constraint_forces_n());
        let found = forces.find(|((imposed, found), _)| imposed.node == node && **found == owner);
        found.map_or(DVec3::ZERO, |(_, force_n)| *force_n)
    }

    /// Force of one part of a hand on each of three nodes in the last step [N].
    fn forces_on_nodes_n(&self, hand: usize, part: ToolPart, nodes: [NodeId; 3]) -> [DVec3; 3] {
        if self.spec.hand.is_some() {
            let contact = self.tool_states[hand].contacts[part.index()].as_ref();
            return contact.map_or([DVec3::ZERO; 3], |contact| contact.forces_n);
        }
        let owner = Owner { hand: hand as u8, part: Some(part) };
        let imposed = self.constraints.displacements.iter().zip(&self.owners);
        let mut forces_n = [DVec3::ZERO; 3];
        for ((imposed, found), force_n) in imposed.zip(self.model.constraint_forces_n()) {
            if let Some(v) = nodes.iter().position(|n| *n == imposed.node).filter(|_| *found == owner) {
                forces_n[v] = *force_n;
            }
        }
        forces_n
    }

    /// What the hands feel; contacts that would pull end.
    pub(super) fn read_forces(&mut self) {
        let dt_s = self.spec.time_step_s;
        for place in 0..self.tool_states.len() {
            let mut force_on_tool_n = DVec3::ZERO;
            let mut in_contact = false;
            let mut slip_m = 0.0;
            for part in ToolPart::ALL {
                let Some(contact) = &self.tool_states[place].contacts[part.index()] else {
                    self.load_part(place, part, None);
                    continue;
                };
                let forces_n = self.forces_on_nodes_n(place, part, contact.nodes);
                let force_on_organ_n: DVec3 = forces_n.into_iter().sum();
                let (hand, tool) = (&mut self.tool_states[place], &self.spec.tools[place]);
                let Some(contact) = &mut hand.contacts[part.index()] else { continue };
                contact.feel(&self.organ, forces_n);
                slip_m += contact.slip_m;
                // A force that is no number, which only a broken model can bring about, is none.
                let is_broken = !force_on_organ_n.is_finite();
                // With a hand that gives way the contacts' own law decides.
                let lets_go =
                    self.spec.hand.is_none() && contact.lets_go(force_on_organ_n, tool.grip.is_sticky);
                if is_broken || lets_go {
                    hand.contacts[part.index()] = None;
                    self.load_part(place, part, None);
                } else {
                    in_contact = true;
                    force_on_tool_n -= force_on_organ_n;
                    self.load_part(place, part, Some(-force_on_organ_n));
                }
            }
            let force_of_jaws_n = -self.force_on_organ_n(place, None);
            if let Some(jaws) = self.spec.tools[place].kind.jaws().copied() {
                let holds = self.tool_states[place].grasp.is_some() && force_of_jaws_n.is_finite();
                self.load_jaws(place, &jaws, holds.then_some(force_of_jaws_n));
            }
            in_contact |= self.holds_thread(place);
            let force_of_threads_n = self.force_of_threads_n(place);
            let (hand, tool) = (&mut self.tool_states[place], &self.spec.tools[place]);
            let pose = hand.now;
            if let (Some(grasp), Some(jaws)) = (&mut hand.grasp, tool.kind.jaws()) {
                if force_of_jaws_n.is_finite() {
                    let hold = Hold { force_on_tool_n: force_of_jaws_n, dt_s };
                    slip_m += if self.spec.hand.is_some() {
                        grasp.slide((tool, jaws), &pose, self.press.slid_in_jaws_m(place), dt_s)
                    } else {
                        grasp.slip(tool, jaws, &pose, &hold)
                    };
                    force_on_tool_n += force_of_jaws_n;
                }
                hand.report.n_held_nodes = grasp.n_nodes() as u32;
                in_contact = true;
                if grasp.n_nodes() == 0 {
                    hand.grasp = None;
                }
            }
            let edge_motion_m = edge_motion_m(tool, &hand.before, &hand.now);
            let force_of_tools_n = self.press.force_of_tools_n(place);
            let most_n = self.spec.hand.map_or(f64::INFINITY, |hand| hand.greatest_force_n);
            let beside = (force_on_tool_n + force_of_tools_n, most_n);
            force_on_tool_n += hand.overload.pay_for_cuts_n(edge_motion_m, tool.tip_radius_m, beside);
            // Of the tissue alone: pressing on another instrument is no work on it.
            hand.count_activity(tool, force_on_tool_n, dt_s);
            force_on_tool_n += force_of_tools_n + force_of_threads_n;
            hand.report.in_contact = in_contact || hand.overload.edge_is_in;
            hand.report.slip_m = slip_m;
            hand.report.torque_on_tool_n_m = self.press.torque_on_tool_n_m(place);
            hand.report.force_on_tool_n = force_on_tool_n;
        }
    }

    /// The constraints of the last step.
    pub fn constrained_nodes(&self) -> &[ImposedDisplacement] {
        &self.constraints.displacements
    }

    /// The nodes that the jaws of a tool hold, ascending.
    pub fn held_nodes(&self, tool: usize) -> Vec<NodeId> {
        let grasp = self.tool_states.get(tool).and_then(|hand: &ToolState| hand.grasp.as_ref());
        let nodes =
            grasp.map(|g| g.places_m(ToolFrame::of(&self.tool_states[tool].now)).map(|(n, _)| n).collect());
        nodes.unwrap_or_default()
    }
}
