//! What the haptic loop is told of a tool after a step: the force now, the stiffness of what it touches or holds, and when it
//! is free the place that it will touch next.

use super::World;
use super::grasp::pull_limit_n;
use super::parts::{ToolPart, capsule};
use super::skin::SurfacePlace;
use crate::contact::spread::motion_weights;
use crate::contact::tool_contact::ToolContact;
use crate::haptics::{HapticModel, PatchStiffness, Touch, TouchedPart};
use crate::math::{DMat3, DVec3, outer};
use crate::mesh::NodeId;
use crate::model::{LocalModel, LocalWork};
use crate::tool::pose::ToolFrame;
use crate::tool::{Tool, ToolInput, ToolKind};

/// How near tissue has to be to be told of [m]: beyond what the tool's speed may cover, which is added. A choice.
const REACH_M: f64 = 5e-3;
/// Periods for which the tool's speed is expected to last until a newer model is felt.
const PERIODS_AHEAD: f64 = 2.5;
/// Triangles that are looked at for the nearest one.
const MOST_NEAR: usize = 256;
/// The search is repeated in half the reach when there are more, so often at most.
const MOST_SEARCHES: usize = 4;

/// Time [s] that the stiffness is for, at least: a simulation that is just fast enough to look at. Over a shorter time the
/// patch's inertia counts, which answers to changes of speed, not to a motion that goes on.
const LEAST_RESPONSE_S: f64 = 1.0 / 30.0;
/// Rings of tetrahedra around a patch that count, and how well its columns are solved. Choices: what is left out makes the
/// patch of a triangle a tenth too stiff at most (its displacements fall with the distance), which the hand feels for a
/// step's way only.
const MOST_RINGS: u32 = 5;
const TOLERANCE: f64 = 1e-3;
/// Tissue that does not slide though the tool's coefficient would let it is caught in its own dent: it is taken to bear so
/// many times what it bears now.
const CAUGHT: f64 = 1.5;
/// What it bears along the surface over the push, at most.
const MOST_FRICTION: f64 = 20.0;

/// A node that follows the tool: which, how for a unit motion of the tip, and with which part.
#[derive(Clone, Copy, Debug)]
struct Follower {
    node: NodeId,
    motion: DMat3,
    part: usize,
}

/// Room for the largest patch and its solution.
pub(super) struct HapticScratch {
    work: LocalWork,
    local: LocalModel,
    patch: PatchStiffness,
    followers: Vec<Follower>,
    nodes: Vec<NodeId>,
    near: Vec<ToolContact>,
}

impl HapticScratch {
    fn for_nodes(n_nodes: usize) -> Self {
        Self {
            work: LocalWork::with_room_for(n_nodes).estimating(MOST_RINGS, TOLERANCE),
            local: LocalModel::new(),
            patch: PatchStiffness::new(),
            followers: Vec::with_capacity(LocalModel::MOST_NODES),
            nodes: Vec::with_capacity(LocalModel::MOST_NODES),
            near: Vec::with_capacity(MOST_NEAR),
        }
    }

    fn follow(&mut self, node: NodeId, motion: DMat3, part: usize) {
        let is_known = self.followers.iter().any(|f| f.node == node);
        if !is_known && self.followers.len() < LocalModel::MOST_NODES {
            self.followers.push(Follower { node, motion, part });
        }
    }
}

impl World {
    /// Makes room for [`World::haptic_model`], which then allocates nothing.
    pub fn prepare_haptics(&mut self) {
        if self.haptics.is_none() {
            let n_nodes = self.organ.mesh().positions_m.len();
            self.haptics = Some(Box::new(HapticScratch::for_nodes(n_nodes)));
        }
    }

    /// What the tissue does to a tool nearby and soon, after a step. The first call makes room, later ones allocate nothing.
    /// A tool that is not there is free.
    ///
    /// The stiffness is that of the nodes that follow the tool, over a step or a thirtieth of a second, with the rest of the organ free to
    /// follow; between contacts what the tip would touch next is told, of tissue that is not in the way of a blade at work.
    pub fn haptic_model(&mut self, tool: usize) -> HapticModel {
        self.haptic_model_over(tool, self.spec.time_step_s.max(LEAST_RESPONSE_S))
    }

    /// The same with the stiffness over another time [s]: a longer one counts less of the inertia, but costs more. Over times as
    /// short as a millisecond the inertia of what is touched counts in the stiffness; a world's forces leave it out.
    pub fn haptic_model_over(&mut self, tool: usize, response_s: f64) -> HapticModel {
        self.prepare_haptics();
        let dt_s = self.spec.time_step_s;
        let mut model = HapticModel {
            step: self.step,
            time_s: self.step as f64 * dt_s,
            period_s: response_s,
            ..HapticModel::default()
        };
        let Some(mut scratch) = self.haptics.take() else { return model };
        if tool < self.hands.len() {
            self.fill_haptic_model(tool, response_s, &mut scratch, &mut model);
        }
        self.haptics = Some(scratch);
        if model.is_finite() { model } else { HapticModel { step: model.step, ..HapticModel::default() } }
    }

    fn fill_haptic_model(
        &mut self,
        place: usize,
        response_s: f64,
        scratch: &mut HapticScratch,
        model: &mut HapticModel,
    ) {
        let dt_s = self.spec.time_step_s;
        let (hand, tool) = (&self.hands[place], &self.spec.tools[place]);
        let pose = hand.now;
        model.tip_m = pose.tip_in_world_m;
        model.tip_velocity_m_per_s = (pose.tip_in_world_m - hand.before.tip_in_world_m) / dt_s;
        if !tool.grip.is_sticky {
            model.friction_coefficient = tool.grip.friction_coefficient;
            model.hold_n = tool.kind.jaws().map_or(f64::INFINITY, |jaws| pull_limit_n(tool, jaws, &pose));
        }
        let positions_m = self.organ.positions_m();
        scratch.followers.clear();
        let mut n_parts = 0;
        if let Some(grasp) = &hand.grasp {
            for (node, place_m) in grasp.places_m(ToolFrame::of(&pose)) {
                scratch.follow(node, lever(tool, &pose, place_m), n_parts);
            }
            model.parts[n_parts] = TouchedPart {
                touch: Touch::Grasp,
                force_n: -self.force_on_organ_n(place, None),
                ..TouchedPart::default()
            };
            n_parts += 1;
        }
        for part in ToolPart::ALL {
            let Some(contact) = &hand.contacts[part.index()] else { continue };
            let motion = lever(tool, &pose, contact.at.in_world_m(tool, &pose));
            for (node, weight) in contact.nodes.into_iter().zip(contact.motion_weights) {
                if weight > 0.0 {
                    scratch.follow(node, motion * weight, n_parts);
                }
            }
            let force_n = -self.force_on_organ_n(place, Some(part));
            model.parts[n_parts] = TouchedPart {
                touch: Touch::Contact,
                force_n,
                normal: contact.normal,
                friction_coefficient: friction_now(tool, force_n, contact.normal, hand.report.slip_m > 0.0),
                ..TouchedPart::default()
            };
            if model.normal == DVec3::ZERO {
                model.friction_coefficient = model.parts[n_parts].friction_coefficient;
                model.normal = contact.normal;
                model.surface_m = contact.point_m(positions_m);
                model.surface_velocity_m_per_s =
                    self.organ.skin().velocity_m_per_s(contact.nodes, contact.weights, dt_s);
            }
            n_parts += 1;
        }
        if n_parts == 0 {
            self.meet_surface(place, response_s, scratch, model);
            return;
        }
        self.solve_patch(scratch, response_s);
        for (i, part) in model.parts[..n_parts].iter_mut().enumerate() {
            let followers = &scratch.followers;
            part.stiffness_n_per_m = scratch.patch.stiffness_n_per_m(|node| followers[node].part == i);
            model.stiffness_n_per_m += part.stiffness_n_per_m;
            model.force_n += part.force_n;
        }
        model.touch = model.parts[0].touch;
        if n_parts > 1 {
            model.n_parts = n_parts as u32;
        } else {
            model.parts = [TouchedPart::default(); HapticModel::MOST_PARTS];
        }
    }

    /// The place that a free tool will touch, and how stiff it is.
    fn meet_surface(
        &mut self,
        place: usize,
        response_s: f64,
        scratch: &mut HapticScratch,
        model: &mut HapticModel,
    ) {
        let (hand, tool) = (&self.hands[place], &self.spec.tools[place]);
        let is_cutting = matches!(tool.kind, ToolKind::Scalpel(_)) && hand.now.is_triggered();
        let mut reach_m = REACH_M + model.tip_velocity_m_per_s.length() * PERIODS_AHEAD * model.period_s;
        model.gap_m = reach_m;
        if is_cutting || !reach_m.is_finite() {
            return;
        }
        let mut nearest: Option<SurfacePlace> = None;
        for part in [ToolPart::Tip, ToolPart::SecondJaw] {
            let Some(shape) = capsule(tool, part, &hand.now) else { continue };
            for _ in 0..MOST_SEARCHES {
                scratch.near.clear();
                if self.organ.skin().near_into(&shape, reach_m, &mut scratch.near) == 0 {
                    break;
                }
                reach_m *= 0.5;
            }
            for found in &scratch.near {
                let gap_m = found.contact.gap_m;
                if nearest.is_none_or(|best| gap_m < best.found.contact.gap_m) {
                    nearest = Some(self.organ.skin().place_of(*found));
                }
            }
        }
        let Some(surface) = nearest else { return };
        let contact = &surface.found.contact;
        let is_outside = contact.normal.dot(self.organ.face_normal(surface.nodes)) > 0.0;
        let fixed = surface.nodes.map(|node| self.organ.is_fixed(node));
        let weights = surface.found.weights;
        let (true, Some(follow)) = (is_outside, motion_weights(weights, fixed)) else { return };
        model.normal = contact.normal;
        model.surface_m = contact.points_m[1];
        // A tip that is in tissue without touching it (put there, or just let go) is met from where it is.
        model.gap_m = contact.gap_m.max(0.0);
        model.surface_velocity_m_per_s =
            self.organ.skin().velocity_m_per_s(surface.nodes, weights, self.spec.time_step_s);
        for (node, weight) in surface.nodes.into_iter().zip(follow) {
            if weight > 0.0 {
                scratch.follow(node, DMat3::IDENTITY * weight, 0);
            }
        }
        self.solve_patch(scratch, response_s);
        model.stiffness_n_per_m = scratch.patch.stiffness_n_per_m(|_| true);
    }

    fn solve_patch(&mut self, scratch: &mut HapticScratch, response_s: f64) {
        scratch.nodes.clear();
        scratch.nodes.extend(scratch.followers.iter().map(|f| f.node));
        self.model.local_model_into(&scratch.nodes, response_s, &mut scratch.work, &mut scratch.local);
        let followers = &scratch.followers;
        scratch.patch.solve(&scratch.local, |node| followers[node].motion);
    }
}

/// Coefficient that the tissue shows now: that of the tool, or what it bears beyond it.
fn friction_now(tool: &Tool, force_n: DVec3, normal: DVec3, slides: bool) -> f64 {
    if tool.grip.is_sticky {
        return f64::INFINITY;
    }
    let push_n = force_n.dot(normal);
    let along_n = (force_n - normal * push_n).length();
    let shown = if push_n > 0.0 { along_n / push_n } else { 0.0 };
    let reserve = if slides { 1.0 } else { CAUGHT };
    tool.grip.friction_coefficient.max(shown * reserve).min(MOST_FRICTION)
}

/// Motion of a point of a tool for motions of its tip: the same, but for a tool that turns about its trocar c. With the
/// shaft's direction a, the tip's distance L from c and the point's place r from the tip, d goes to d (1 - a.r/L) + a (r.d)/L.
fn lever(tool: &Tool, pose: &ToolInput, point_m: DVec3) -> DMat3 {
    let Some(trocar_m) = tool.trocar_m else { return DMat3::IDENTITY };
    let length_m = trocar_m.distance(pose.tip_in_world_m);
    if length_m < tool.tip_radius_m {
        return DMat3::IDENTITY;
    }
    let (shaft, from_tip_m) = (pose.shaft_in_world, point_m - pose.tip_in_world_m);
    let turned = 1.0 - shaft.dot(from_tip_m) / length_m;
    DMat3::IDENTITY * turned + outer(shaft, from_tip_m) * (1.0 / length_m)
}
