//! Touch by force: instruments that a hand holds by a spring, and all their contacts with the organ solved as one.
//!
//! A hand holds the tip x of an instrument by a spring k and a damper d between it and the place h where it wants it, up to a
//! greatest force ([`Hand`]). The instrument has no mass: in a step of length s a force F of the organ on it moves it from
//! where it would be alone, y, to
//!
//! x = y + F/(k + d/s),   y = h + (x(t) - h(t)) (d/s)/(k + d/s).
//!
//! How it is turned about its tip is held likewise, by a rotational spring and damper up to a greatest torque: a force F at the arm a
//! turns it by a x F/(k_r + d_r/s) from where it would be alone. Through a trocar it turns with its tip instead ([`turning`]).
//!
//! Where it touches, y is no further from the place x(t) (or from where it began to touch) than the greatest force over
//! k + d/s: the hand gives way, and the instrument follows it at that force. So no motion of a hand can bring about a
//! greater one, and none of its turns a greater torque ([`give_way`]). Instruments touch each other as well ([`tool_pairs`]).
//!
//! A part of an instrument touches at many points ([`points`]): where the surface is near it before the step, with the normals and
//! gaps that it has there. How the part moves from there is the instrument's motion.
//!
//! The organ answers to forces on its nodes in the step by C, the compliance of the touched nodes
//! ([`crate::model::LocalModel`]). With f and v of the last step, v' of the one before and the nodes' masses m, they go to
//!
//! x(t) + C (F - f + m (2 v - v')/s):
//!
//! what balanced f and the last acceleration goes on. Each contact is a point of a triangle and one of the tool, with the
//! laws of Signorini and Coulomb ([`crate::contact::constraint`]); the instrument is a body of the system with the
//! compliance above. A tip that is a mesh touches with one point, which stays on the tissue or slides ([`super::slide`]). Forces, not displacements, go to the model: whatever C misses is a gap or an overlap that the next step
//! closes, and no law of tissue can answer with more than the hand's force.
//!
//! A node that jaws hold is a contact that sticks and may pull. Of many nodes so near to each other C is not known well enough
//! (tissue that is pulled far has a tangent that is not even positive), so each is taken to answer alone: as soft as all that are held
//! make it together, a bound of what any motion of theirs meets, and not softer than its mass m is in the step, s^2/m. That never
//! overshoots, and is made good in some steps. Of a single explicit step s^2/m is exact once the change of the elements' forces since the
//! last step counts; without, forces between held nodes grow where s^2 K/m is above a half.
//!
//! Tissue may be softer than C says, which is then of a stiffer shape or of too small a region: forces would overshoot, and
//! grow from step to step where it is more than twice as soft. So C is multiplied by how much further the touched nodes went in
//! the last step for a change of their forces than they were expected to, if that was further; it comes back to itself in
//! some steps.

mod give_way;
mod points;
mod sub_grid;
mod system;
mod meeting;
mod tool_pairs;
mod turning;
mod vertices;
mod yielding;

use super::World;
use super::grasp::pull_limit_n;
use super::organ::Organ;
use super::parts::{ToolPart, mesh_of};
use super::slide::{Follow, PatchAnswer};
use super::spec::{Hand, WorldSpec};
use super::touch::HeldContact;
use crate::math::DVec3;
use crate::mesh::NodeId;
use crate::tool::pose::ToolFrame;
use crate::tool::{MAX_TOOLS, Tool, ToolInput};
pub(super) use meeting::PairContact;
use sub_grid::Indentation;
use system::{Bearer, PartTouch, PartWay};
pub(super) use system::{Press, softer};
pub(super) use tool_pairs::FRICTION as TOOL_FRICTION;
use turning::{HandAnswer, Turning};
use vertices::{side_of, turn_vertex_of, vertex_of};

/// How often the contacts are solved anew with the compliance that follows from their forces: a choice.
const SUB_GRID_ROUNDS: u32 = 2;
/// Sides of a part that touch by themselves: the two of a fold.
const SIDES: usize = 2;
/// Vertices of a tool in the system: one for each side of a part, and one for what its jaws hold.
const JAWS: usize = 3 * SIDES;
const VERTICES: usize = JAWS + 1;
/// Tissue further than this from where its tool would have it [m] is no longer touched by it: it went another way, as tissue that
/// was let go does. A choice, above the way of a step at 5 m/s.
const MOST_APART_M: f64 = 0.05;

impl World {
    /// Moves the instruments against what they touch, and finds the forces. Allocates nothing.
    pub(super) fn press(&mut self) {
        let Some(hand) = self.spec.hand else { return };
        let mut from = std::array::from_fn(|place| {
            (place < self.tool_states.len()).then(|| self.hold_back(place, &hand))
        });
        self.hold_apart(&hand, &mut from);
        for place in 0..self.tool_states.len() {
            self.anchor_new(place);
            self.slide_anchors(place, &hand);
        }
        self.gather_contacts(&hand, &from);
        self.gather_pairs(&hand);
        if self.press.contacts.is_empty() {
            self.press.forget_forces();
        } else {
            self.solve_contacts(&hand);
        }
        self.settle();
    }

    /// How a tip that just begins to touch at a node yields for what the mesh is too coarse for [m/N]; not where motions are imposed.
    pub(super) fn first_sub_grid_m_per_n(&self, tool: &Tool, node: NodeId) -> f64 {
        let body = self.organ.body_of_nodes()[node.index()] as usize;
        let tissue = self.spec.tissue_of(body).filter(|_| self.spec.hand.is_some());
        tissue.map_or(0.0, |tissue| Indentation::of(tissue).at_first_m_per_n(tool.tip_radius_m))
    }

    fn solve_contacts(&mut self, hand: &Hand) {
        self.press.solve();
        let knows_tissue = (0..self.spec.bodies.len().max(1)).any(|body| self.spec.tissue_of(body).is_some());
        if knows_tissue {
            let dt_s = self.spec.time_step_s;
            for _ in 0..SUB_GRID_ROUNDS {
                for (place, tool) in self.spec.tools.iter().enumerate() {
                    for part in ToolPart::ALL.into_iter().filter(|part| *part != ToolPart::Shaft) {
                        let held = self.tool_states[place].contacts[part.index()].as_ref();
                        let Some(contact) = indentation(&self.spec, &self.organ, held) else { continue };
                        for side in 0..SIDES {
                            let at = (place, side_of(part, side));
                            let with = (part.radius_m(tool), dt_s);
                            self.press.set_sub_grid(at, with, &contact, &self.organ);
                        }
                    }
                }
                self.press.sweep();
            }
        }
        for (place, (state, tool)) in self.tool_states.iter().zip(&self.spec.tools).enumerate() {
            let jaws = tool.kind.jaws().filter(|_| state.grasp.is_some() && !tool.grip.is_sticky);
            let holds_n = jaws.map_or(f64::INFINITY, |jaws| pull_limit_n(tool, jaws, &state.now));
            // A hand that bears less gives way before the tissue slides.
            let most_n = if holds_n < hand.greatest_force_n { holds_n } else { f64::INFINITY };
            self.press.slip_in_jaws(place, most_n);
        }
        self.press.give_way(&self.spec.tools, hand);
        let before_n = std::array::from_fn(|i| {
            self.press.nodes.get(i).map_or(DVec3::ZERO, |node| self.press.force_before_n(*node))
        });
        self.press.gather_forces(&self.organ);
        let velocities_m_per_s = self.model.state().velocities_m_per_s;
        self.press.expect(self.organ.positions_m(), velocities_m_per_s, &before_n);
    }

    /// Before contacts are solved: an instrument that touches or holds is no further from where it was than the hand's
    /// greatest force allows. Answers from where it moves against the tissue.
    fn hold_back(&mut self, place: usize, hand: &Hand) -> ToolInput {
        let dt_s = self.spec.time_step_s;
        let (state, tool) = (&mut self.tool_states[place], &self.spec.tools[place]);
        let touches = state.contacts.iter().any(Option::is_some);
        if !touches && state.grasp.is_none() {
            return state.before;
        }
        let (before_m, alone_m) = (state.before.tip_in_world_m, state.now.tip_in_world_m);
        let start = state.start_share();
        let from_m = before_m.lerp(alone_m, start);
        let from = state.on_way(tool, start, from_m);
        let tip_m = from_m + (alone_m - from_m).clamp_length_max(hand.most_behind_m(dt_s));
        state.put_tip(tool, tip_m);
        if tool.trocar_m.is_none() {
            state.hold_turn_back(start, hand.most_turned_rad(dt_s));
        }
        from
    }

    /// Contacts that are new keep what they overlap where the instrument is now.
    fn anchor_new(&mut self, place: usize) {
        let (state, tool) = (&mut self.tool_states[place], &self.spec.tools[place]);
        for contact in state.contacts.iter_mut().flatten().filter(|contact| contact.is_new()) {
            contact.anchor_overlap(contact.at.in_world_m(tool, &state.now), &self.organ);
        }
    }

    /// Lets the places that parts follow slide where friction does not hold them.
    fn slide_anchors(&mut self, place: usize, hand: &Hand) {
        let dt_s = self.spec.time_step_s;
        let (state, tool) = (&mut self.tool_states[place], &self.spec.tools[place]);
        for part in ToolPart::ALL {
            let contact = &mut state.contacts[part.index()];
            if !follows_one_place(tool, part) {
                continue;
            }
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
    fn gather_contacts(&mut self, hand: &Hand, from: &[Option<ToolInput>; MAX_TOOLS]) {
        let dt_s = self.spec.time_step_s;
        let press = &mut self.press;
        press.learn_softness(self.organ.positions_m());
        press.start(&self.tool_states);
        let organ = &self.organ;
        for (place, (state, tool)) in self.tool_states.iter().zip(&self.spec.tools).enumerate() {
            let turning = Turning::of(place, [&state.before, &state.now]);
            if let Some(grasp) = &state.grasp {
                for (node, place_m) in grasp.places_m(ToolFrame::of(&state.now)) {
                    let moved_m = place_m - organ.positions_m()[node.index()];
                    let force_n = grasp.force_on_node_n(node);
                    press.add_held((place, node), [moved_m, force_n], turning.at(place_m, 1.0));
                }
            }
            for part in ToolPart::ALL {
                let (Some(held), Some(from)) = (&state.contacts[part.index()], &from[place]) else {
                    continue;
                };
                if follows_one_place(tool, part) {
                    press.add_anchor((place, part), held, (tool, &state.now, &turning), organ);
                } else if let Some(way) = PartWay::of(tool, part, [from, &state.now]) {
                    let contact = indentation(&self.spec, organ, Some(held));
                    let is_linear = self.spec.is_linear(body_of(organ, held), self.model_kind);
                    let (turning, contact) = (&turning, contact.as_ref());
                    let touch = PartTouch { tool, way, turning, organ, dt_s, contact, is_linear };
                    press.add_points((place, part), &touch);
                }
            }
            let followed = |part: ToolPart| {
                let contact = indentation(&self.spec, organ, state.contacts[part.index()].as_ref());
                contact.map_or(1.0, |c| c.followed(part.radius_m(tool), dt_s))
            };
            let answer = HandAnswer::of(hand, tool, [&state.before, &state.now], dt_s);
            press.set_tool(place, &answer, followed);
        }
        let slide = &mut self.slide;
        if press.nodes.is_empty() {
            press.set_no_response();
            return;
        }
        // What jaws hold is known from what its elements do; what instruments press on, from how it answers.
        slide.drifting.set_telling_changes(self.tool_states.iter().any(|state| state.grasp.is_some()));
        self.model.local_model_into(&press.nodes, dt_s, &mut slide.drifting, &mut slide.local);
        press.set_response(&slide.local, |node| !organ.is_fixed(node), dt_s);
        press.set_free_moves(&slide.local, self.model.state().velocities_m_per_s, dt_s);
    }

    /// After contacts were solved: instruments go where their contacts let them, contacts learn their forces, and those that
    /// bear none end.
    fn settle(&mut self) {
        let dt_s = self.spec.time_step_s;
        let press = &mut self.press;
        press.pressed.clear();
        press.settle_pairs();
        press.settle_torques(self.tool_states.len());
        for (place, (state, tool)) in self.tool_states.iter_mut().zip(&self.spec.tools).enumerate() {
            let moved_m = press.moves_m[vertex_of(place, JAWS) as usize];
            let touches = !press.contacts.is_empty();
            if touches && moved_m != DVec3::ZERO && moved_m.is_finite() {
                state.put_tip(tool, state.now.tip_in_world_m + moved_m);
            }
            let turned_rad = press.moves_m[turn_vertex_of(place) as usize];
            // Through a trocar it has turned with its tip.
            let is_free = tool.trocar_m.is_none();
            if touches && is_free && turned_rad != DVec3::ZERO && turned_rad.is_finite() {
                state.turn(turned_rad);
            }
            for part in ToolPart::ALL {
                if !follows_one_place(tool, part) {
                    let held = &mut state.contacts[part.index()];
                    let contact = indentation(&self.spec, &self.organ, held.as_ref());
                    let learned = contact.map_or(1.0, |c| c.learned(part.radius_m(tool), dt_s));
                    press.settle_points((place, part), learned, held);
                }
            }
        }
        for (contact, &(place, bearer)) in press.contacts.iter().zip(&press.of) {
            let state = &mut self.tool_states[place];
            match bearer {
                Bearer::Point(..) | Bearer::Between(..) => {}
                Bearer::Anchor(part) => {
                    let held = &mut state.contacts[part.index()];
                    if let Some(held) = held {
                        held.forces_n = held.weights.map(|weight| contact.force_n * weight);
                    }
                    if contact.force_n == DVec3::ZERO && !contact.sticks {
                        *held = None;
                    }
                }
                Bearer::Jaws(node) => {
                    if let Some(grasp) = &mut state.grasp {
                        grasp.set_force_n(node, contact.force_n);
                    }
                }
            }
        }
    }
}

/// The body that a part touches.
fn body_of(organ: &Organ, held: &HeldContact) -> usize {
    organ.body_of_nodes()[held.nodes[0].index()] as usize
}

/// How balls go into the tissue at rest that a part touches, where it is known; of a part that touches nothing the first body's.
fn indentation(spec: &WorldSpec, organ: &Organ, held: Option<&HeldContact>) -> Option<Indentation> {
    let body = held.map_or(0, |held| body_of(organ, held));
    spec.tissue_of(body).map(Indentation::of)
}

/// Whether a part touches with one point, which the tissue follows.
fn follows_one_place(tool: &Tool, part: ToolPart) -> bool {
    part == ToolPart::Tip && mesh_of(tool).is_some()
}
