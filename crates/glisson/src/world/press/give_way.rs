//! Hands that give way: after contacts were solved no instrument bears more than its hand's greatest force, and it goes where what it
//! touches lets it.
//!
//! The forces of instruments that press on each other are lessened together, by the same share: so none of them is left with more
//! than it had, and what acts between them stays equal and opposite. A hand whose greatest torque is what gives way lets its instrument
//! turn about the tip. An instrument whose forces were lessened went less far out of what it touches than it has to: it is moved out,
//! and of two that touch each other the one that gives way more.

use super::VERTICES;
use super::system::{Bearer, Press};
use super::vertices::{turn_vertex_of, vertex_of};
use crate::contact::constraint::Contact;
use crate::math::DVec3;
use crate::tool::{MAX_TOOLS, Tool};
use crate::world::spec::Hand;
use std::ops::Range;

/// An instrument that turns about a point nearer than this share of its way to the tip does not give way there.
const LEAST_LEVER: f64 = 0.05;
/// A contact whose force is nearer to the tip than this [m] is not left by turning: a choice, the size of a tip.
const LEAST_ARM_M: f64 = 5e-3;

/// How an instrument gives way.
#[derive(Clone, Copy, Debug, Default)]
struct GivesWay {
    /// The share of its forces that its hand bears; more than 1 where that is all.
    own_share: f64,
    /// Whether the torque is what it does not bear.
    by_torque: bool,
    /// The share that is left.
    share: f64,
    /// Instruments that press on each other have the same number.
    group: usize,
}

fn is_held_by((place, bearer): (usize, Bearer), tool: usize) -> bool {
    place == tool && matches!(bearer, Bearer::Jaws(_))
}

/// The share of something that is not above `most`.
fn share_of(most: f64, found: f64) -> f64 {
    let share = most / found;
    if share.is_finite() { share } else { f64::MAX }
}

fn vertices_of(tool: usize) -> Range<u32> {
    vertex_of(tool, 0)..vertex_of(tool, VERTICES)
}

/// 1 for the first partner of a contact, -1 for the second, and 0 for an instrument that is none.
fn weight_of(contact: &Contact, tool: usize) -> f64 {
    let vertices = vertices_of(tool);
    contact.sides().filter(|(vertex, _)| vertices.contains(vertex)).map(|(_, weight)| weight).sum()
}

/// The arm of a contact about the tip of an instrument [m]; with the sign turned of the second partner.
fn arm_of_m(contact: &Contact, tool: usize) -> DVec3 {
    let turn = contact.turns.iter().find(|turn| turn.vertex == turn_vertex_of(tool));
    turn.map_or(DVec3::ZERO, |turn| turn.arm_m)
}

impl Press {
    /// Instruments whose contacts bear more than their hands do give way.
    pub(super) fn give_way(&mut self, specs: &[Tool], hand: &Hand) {
        let n_tools = specs.len().min(MAX_TOOLS);
        let mut tools = [GivesWay::default(); MAX_TOOLS];
        self.limit_each(hand.greatest_force_n);
        for (tool, (gives_way, spec)) in tools.iter_mut().zip(specs).enumerate() {
            let force = share_of(hand.greatest_force_n, self.sum_force_n(tool).length());
            // A trocar bears what would turn the instrument about it.
            let torque_n_m = if spec.trocar_m.is_none() { self.sum_torque_n_m(tool).length() } else { 0.0 };
            let torque = share_of(hand.greatest_torque_n_m, torque_n_m);
            let (own_share, by_torque) = (force.min(torque), torque < force);
            *gives_way = GivesWay { own_share, by_torque, share: 1.0, group: tool };
        }
        self.join_groups(&mut tools[..n_tools]);
        self.lessen_groups(&mut tools[..n_tools]);
        let mut order: [usize; MAX_TOOLS] = std::array::from_fn(|tool| tool);
        order[..n_tools].sort_unstable_by(|a, b| {
            let by_share = tools[*b].own_share.total_cmp(&tools[*a].own_share);
            by_share.then_with(|| a.cmp(b))
        });
        for (place, &tool) in order[..n_tools].iter().enumerate() {
            let rank = |other: usize| order[..n_tools].iter().position(|t| *t == other);
            let is_last = |other: usize| rank(other).is_none_or(|other| other < place);
            let turns = tools[tool].own_share < 1.0 && tools[tool].by_torque;
            self.stay_out((tool, turns), is_last);
            if tools[tool].share < 1.0 {
                self.stay_on(tool);
            }
        }
    }

    /// Leaves what jaws hold the share of its pull that their friction bears: beyond it the tissue slides along them.
    pub(super) fn slip_in_jaws(&mut self, tool: usize, most_n: f64) {
        let pull_n = self.held_by(tool).map(|contact| contact.force_n).sum::<DVec3>().length();
        self.slips[tool] = pull_n > most_n;
        for c in 0..self.contacts.len() {
            if self.slips[tool] && is_held_by(self.of[c], tool) {
                self.lessen(c, most_n / pull_n);
            }
        }
    }

    /// The contacts with what the jaws of an instrument hold.
    fn held_by(&self, tool: usize) -> impl Iterator<Item = &Contact> {
        let contacts = self.contacts.iter().zip(&self.of);
        contacts.filter(move |(_, of)| is_held_by(**of, tool)).map(|(contact, _)| contact)
    }

    /// How far what jaws hold slid along them in the last step [m].
    pub(in crate::world) fn slid_in_jaws_m(&self, tool: usize) -> DVec3 {
        let n = self.held_by(tool).count();
        if !self.slips[tool] || n == 0 {
            return DVec3::ZERO;
        }
        self.held_by(tool).map(|contact| contact.relative_m(&self.moves_m)).sum::<DVec3>() / n as f64
    }

    /// The force of all contacts on an instrument, as it is felt at the tip [N].
    fn sum_force_n(&self, tool: usize) -> DVec3 {
        let forces = self.contacts.iter().map(|contact| contact.force_n * weight_of(contact, tool));
        // What turns it about its trocar moves the tip.
        forces.sum::<DVec3>() + self.turned_by_tip[tool].transpose() * self.sum_torque_n_m(tool)
    }

    /// How far a contact opens along a direction when the tip of an instrument moves by a unit that way.
    fn moves_along(&self, contact: &Contact, tool: usize, along: DVec3) -> f64 {
        let turned_m = (self.turned_by_tip[tool] * along).cross(arm_of_m(contact, tool));
        weight_of(contact, tool) + turned_m.dot(along)
    }

    /// Gives instruments that press on each other the same group.
    fn join_groups(&self, tools: &mut [GivesWay]) {
        if tools.len() < 2 {
            return;
        }
        for contact in self.contacts.iter().filter(|contact| contact.force_n != DVec3::ZERO) {
            let mut touching = (0..tools.len()).filter(|&tool| weight_of(contact, tool) != 0.0);
            if let (Some(first), Some(second)) = (touching.next(), touching.next()) {
                let (kept, joined) = (tools[first].group, tools[second].group);
                tools.iter_mut().filter(|tool| tool.group == joined).for_each(|tool| tool.group = kept);
            }
        }
    }

    /// Leaves each group the share of its forces that all its hands bear.
    fn lessen_groups(&mut self, tools: &mut [GivesWay]) {
        for group in 0..tools.len() {
            let own = tools.iter().filter(|tool| tool.group == group).map(|tool| tool.own_share);
            let share = own.fold(1.0, f64::min);
            if share >= 1.0 {
                continue;
            }
            tools.iter_mut().filter(|tool| tool.group == group).for_each(|tool| tool.share = share);
            for c in 0..self.contacts.len() {
                let mut of_group = (0..tools.len()).filter(|&tool| tools[tool].group == group);
                if of_group.any(|tool| weight_of(&self.contacts[c], tool) != 0.0) {
                    self.lessen(c, share);
                }
            }
        }
    }

    /// Moves an instrument, or turns it, out of what it would be in; out of another instrument where `is_last` says that it is for
    /// this one.
    fn stay_out(&mut self, (tool, turns): (usize, bool), is_last: impl Fn(usize) -> bool) {
        for c in 0..self.contacts.len() {
            let contact = self.contacts[c];
            if contact.sticks || weight_of(&contact, tool) == 0.0 {
                continue;
            }
            let opening_m = contact.relative_m(&self.moves_m).dot(contact.normal) + contact.slack_m;
            let other = || (0..MAX_TOOLS).find(|&other| other != tool && weight_of(&contact, other) != 0.0);
            if !(opening_m < 0.0 && other().is_none_or(&is_last)) {
                continue;
            }
            let opens = self.moves_along(&contact, tool, contact.normal);
            if opens.abs() <= LEAST_LEVER {
                continue;
            }
            let arm_m = arm_of_m(&contact, tool).cross(contact.normal);
            if turns && arm_m.length() > LEAST_ARM_M {
                let turned_rad = arm_m * (-opening_m / arm_m.length_squared());
                self.moves_m[turn_vertex_of(tool) as usize] += turned_rad;
            } else {
                self.move_tool(tool, contact.normal * (-opening_m / opens));
            }
        }
    }

    /// Moves an instrument that gave way along with what sticks to it.
    fn stay_on(&mut self, tool: usize) {
        let (mut off_m, mut n) = (DVec3::ZERO, 0);
        for contact in self.contacts.iter().filter(|contact| contact.sticks) {
            let way_m = contact.relative_m(&self.moves_m);
            let moves = self.moves_along(contact, tool, way_m.normalize_or_zero());
            if weight_of(contact, tool) != 0.0 && moves.abs() > LEAST_LEVER {
                off_m += way_m / -moves;
                n += 1;
            }
        }
        if n > 0 {
            self.move_tool(tool, off_m / f64::from(n));
        }
    }

    fn move_tool(&mut self, tool: usize, way_m: DVec3) {
        for vertex in vertices_of(tool) {
            self.moves_m[vertex as usize] += way_m;
        }
        self.moves_m[turn_vertex_of(tool) as usize] += self.turned_by_tip[tool] * way_m;
    }

    /// No contact bears more than a hand can.
    fn limit_each(&mut self, most_n: f64) {
        for c in 0..self.contacts.len() {
            let share = most_n / self.contacts[c].force_n.length();
            if share < 1.0 {
                self.lessen(c, share);
            }
        }
    }

    /// Leaves a share of a contact's force.
    fn lessen(&mut self, c: usize, share: f64) {
        let contact = self.contacts[c];
        contact.push(contact.force_n * (share - 1.0), &self.response, &mut self.moves_m);
        self.contacts[c].force_n = contact.force_n * share;
    }
}
