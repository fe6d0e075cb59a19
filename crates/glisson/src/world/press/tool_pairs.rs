//! Instruments that touch each other, in the system of contacts: where they meet ([`super::meeting`]).

use super::JAWS;
use super::meeting::{MOST_MET, MOST_OF_PAIR, Met, PairContact, ToolPair, meet_into};
use super::system::{Bearer, Press, open_m};
use super::turning::Turning;
use super::vertices::vertex_of;
use crate::contact::constraint::{Contact, ContactKey, Turn};
use crate::math::DVec3;
use crate::tool::ToolInput;
use crate::world::World;
use crate::world::spec::Hand;

/// Coulomb's coefficient between two instruments: a choice, of wet steel on steel, between what is told of it dry (0.5 to 0.8) and
/// greased (0.05 to 0.15).
pub(in crate::world) const FRICTION: f64 = 0.2;

impl Press {
    /// Room for what two instruments are found to touch.
    pub(super) fn room_for_met() -> Vec<Met> {
        Vec::with_capacity(MOST_MET)
    }

    /// An instrument was put elsewhere: what it pressed on counts no more.
    pub(in crate::world) fn forget_tool(&mut self, tool: usize) {
        self.between.retain(|contact| !contact.tools().contains(&tool));
    }

    /// Where instruments pressed on each other in the last step.
    pub(in crate::world) fn pair_contacts(&self) -> &[PairContact] {
        &self.between
    }

    /// Force of the other instruments on one in the last step [N].
    pub(in crate::world) fn force_of_tools_n(&self, tool: usize) -> DVec3 {
        self.between.iter().map(|contact| contact.force_on_n(tool)).sum()
    }

    /// A place where two instruments touch, as a contact of the system.
    fn add_met(&mut self, met: &Met, pair: &ToolPair<'_>, dt_s: f64) {
        let vertices = pair.tools.map(|tool| vertex_of(tool, JAWS));
        let key = ContactKey::VertexObstacle(vertices[0], vertices[1]);
        let mut contact = Contact::new(key, met.normal, met.gap_m);
        contact.slack_m = open_m(met.gap_m, dt_s);
        contact.point_m = met.ends_m[0];
        contact.moved_m = -met.rest_m;
        contact.vertices = [vertices[0], 0, 0, vertices[1]];
        contact.weights = [1.0, 0.0, 0.0, -1.0];
        let turns: [Turn; 2] = std::array::from_fn(|i| {
            let turning = Turning::of(pair.tools[i], pair.ways[i]);
            turning.at(met.ends_m[i], 1.0 - met.time)
        });
        contact.turns = [turns[0], turns[1].of_second()];
        contact.friction = FRICTION;
        let before = self.between.iter().find(|before| before.key == met.key);
        contact.force_n = before.map_or(DVec3::ZERO, |before| contact.into_cone(before.force_n));
        self.contacts.push(contact);
        self.of.push((pair.tools[0], Bearer::Between(met.key)));
    }

    /// After contacts were solved: keeps those between instruments that bear a force.
    pub(super) fn settle_pairs(&mut self) {
        self.between.clear();
        for (contact, (_, bearer)) in self.contacts.iter().zip(&self.of) {
            let Bearer::Between(key) = *bearer else { continue };
            let [turn, _] = contact.turns;
            let turned_m = self.moves_m[turn.vertex as usize].cross(turn.arm_m);
            let place_m = contact.point_m + self.moves_m[contact.vertices[0] as usize] + turned_m;
            if contact.force_n != DVec3::ZERO && contact.force_n.is_finite() {
                let (normal, force_n) = (contact.normal, contact.force_n);
                self.between.push(PairContact { key, normal, place_m, force_n });
            }
        }
    }
}

impl World {
    /// All pairs of instruments with what they touch of each other on their ways, as `visit` takes it; instruments go where it
    /// leaves them only after all.
    fn visit_tool_pairs(&mut self, hand: &Hand, mut visit: impl FnMut(&mut Press, &[Met], &ToolPair<'_>)) {
        let dt_s = self.spec.time_step_s;
        let mut met = std::mem::take(&mut self.press.met);
        for first in 0..self.tool_states.len() {
            for second in first + 1..self.tool_states.len() {
                let tools = [first, second];
                let ways = tools.map(|tool| {
                    let state = &self.tool_states[tool];
                    [&state.before, &state.now]
                });
                let pair = ToolPair { tools, specs: tools.map(|tool| &self.spec.tools[tool]), ways };
                // As far as what else they touch can push them onto each other in the step.
                let margin_m = pair.specs.map(|tool| hand.most_pushed_m(tool, dt_s)).iter().sum();
                meet_into(&pair, margin_m, &self.press.between, &mut met);
                visit(&mut self.press, &met, &pair);
            }
        }
        self.press.met = met;
    }

    /// Before contacts are solved: an instrument that meets another goes no further from there than the hand's greatest force
    /// allows; `from` is where each moves from against the tissue.
    pub(super) fn hold_apart(&mut self, hand: &Hand, from: &mut [Option<ToolInput>]) {
        if self.tool_states.len() < 2 {
            return;
        }
        let mut until = [1.0_f64; crate::tool::MAX_TOOLS];
        self.visit_tool_pairs(hand, |_, met, pair| {
            for met in met.iter().filter(|met| met.approaches()) {
                for tool in pair.tools {
                    until[tool] = until[tool].min(met.time);
                }
            }
        });
        let most_m = hand.most_behind_m(self.spec.time_step_s);
        let most_rad = hand.most_turned_rad(self.spec.time_step_s);
        for (place, from) in from.iter_mut().enumerate().take(self.tool_states.len()) {
            let (state, tool) = (&mut self.tool_states[place], &self.spec.tools[place]);
            if until[place] >= 1.0 {
                continue;
            }
            let before_m = state.before.tip_in_world_m;
            let way_m = state.now.tip_in_world_m - before_m;
            let met_m = before_m + way_m * until[place];
            let is_earlier = |from: &ToolInput| {
                from.tip_in_world_m.distance_squared(before_m) > met_m.distance_squared(before_m)
            };
            if let Some(from) = from.as_mut().filter(|from| is_earlier(from)) {
                *from = state.on_way(tool, until[place], met_m);
            }
            let rest_m = (state.now.tip_in_world_m - met_m).clamp_length_max(most_m);
            state.put_tip(tool, met_m + rest_m);
            if tool.trocar_m.is_none() {
                state.hold_turn_back(until[place], most_rad);
            }
        }
    }

    /// Puts what instruments touch of each other into the system.
    pub(super) fn gather_pairs(&mut self, hand: &Hand) {
        if self.tool_states.len() < 2 {
            return;
        }
        let dt_s = self.spec.time_step_s;
        self.visit_tool_pairs(hand, |press, met, pair| {
            for met in met.iter().take(MOST_OF_PAIR) {
                press.add_met(met, pair, dt_s);
            }
        });
    }
}
