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
/// What it bears along the surface over the push, at most.
const MOST_FRICTION: f64 = 20.0;

/// A point of tissue that follows the tool: how for a unit motion of the tip, and with which part. Its weights are those of
/// the followers that name it.
#[derive(Clone, Copy, Debug)]
struct PressedPoint {
    motion: DMat3,
    part: usize,
}

/// A node that bears a share of the force on a point.
#[derive(Clone, Copy, Debug)]
struct Follower {
    node: NodeId,
    weight: f64,
    point: usize,
}

/// Room for the largest patch and its solution.
pub(super) struct HapticScratch {
    work: LocalWork,
    local: LocalModel,
    /// The answer of the points.
    pressed: LocalModel,
    patch: PatchStiffness,
    points: Vec<PressedPoint>,
    followers: Vec<Follower>,
    nodes: Vec<NodeId>,
    near: Vec<ToolContact>,
}

impl HapticScratch {
    fn for_nodes(n_nodes: usize) -> Self {
        Self {
            work: LocalWork::with_room_for(n_nodes).estimating(MOST_RINGS, TOLERANCE),
            local: LocalModel::new(),
            pressed: LocalModel::new(),
            patch: PatchStiffness::new(),
            points: Vec::with_capacity(LocalModel::MOST_NODES),
            followers: Vec::with_capacity(LocalModel::MOST_NODES),
            nodes: Vec::with_capacity(LocalModel::MOST_NODES),
            near: Vec::with_capacity(MOST_NEAR),
        }
    }

    fn clear(&mut self) {
        self.points.clear();
        self.followers.clear();
    }

    /// A point that presses on `nodes` by `weights`; nodes that are known already, and those without weight, do not count.
    fn follow<const N: usize>(&mut self, nodes: [NodeId; N], weights: [f64; N], motion: DMat3, part: usize) {
        let point = self.points.len();
        let n_before = self.followers.len();
        for (node, weight) in nodes.into_iter().zip(weights) {
            let is_known = self.followers[..n_before].iter().any(|f| f.node == node);
            if weight > 0.0 && !is_known && self.followers.len() < LocalModel::MOST_NODES {
                self.followers.push(Follower { node, weight, point });
            }
        }
        if self.followers.len() > n_before {
            self.points.push(PressedPoint { motion, part });
        }
    }

    /// From the nodes' compliance C to that of the points, sum of w_i w_j C_ij: a force at a point loads its nodes by their
    /// weights, and moves it by the weighted mean of theirs.
    fn gather(&mut self) {
        let (n, n_local) = (3 * self.points.len(), 3 * self.local.nodes.len());
        let (of_points, of_nodes) = (&mut self.pressed, &self.local.compliance_m_per_n);
        of_points.nodes.clear();
        of_points.nodes.extend(self.points.iter().map(|_| NodeId(0)));
        of_points.compliance_m_per_n.clear();
        of_points.compliance_m_per_n.resize(n * n, 0.0);
        if 3 * self.followers.len() != n_local {
            return;
        }
        for (i, of) in self.followers.iter().enumerate() {
            for (j, by) in self.followers.iter().enumerate() {
                for axis in 0..3 {
                    for along in 0..3 {
                        of_points.compliance_m_per_n[n * (3 * of.point + axis) + 3 * by.point + along] +=
                            of.weight * by.weight * of_nodes[n_local * (3 * i + axis) + 3 * j + along];
                    }
                }
            }
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
        scratch.clear();
        let mut n_parts = 0;
        if let Some(grasp) = &hand.grasp {
            for (node, place_m) in grasp.places_m(ToolFrame::of(&pose)) {
                scratch.follow([node], [1.0], lever(tool, &pose, place_m), n_parts);
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
            scratch.follow(contact.nodes, self.free_weights(contact.nodes, contact.weights), motion, n_parts);
            let force_n = -self.force_on_organ_n(place, Some(part));
            model.parts[n_parts] = TouchedPart {
                touch: Touch::Contact,
                force_n,
                normal: contact.normal,
                friction_coefficient: friction_now(tool, force_n, contact.normal),
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
            let points = &scratch.points;
            part.stiffness_n_per_m = scratch.patch.stiffness_n_per_m(|point| points[point].part == i);
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
        let weights = self.free_weights(surface.nodes, surface.found.weights);
        if !is_outside || weights == [0.0; 3] {
            return;
        }
        model.normal = contact.normal;
        model.surface_m = contact.points_m[1];
        // A tip that is in tissue without touching it (put there, or just let go) is met from where it is.
        model.gap_m = contact.gap_m.max(0.0);
        model.surface_velocity_m_per_s =
            self.organ.skin().velocity_m_per_s(surface.nodes, surface.found.weights, self.spec.time_step_s);
        scratch.follow(surface.nodes, weights, DMat3::IDENTITY, 0);
        self.solve_patch(scratch, response_s);
        model.stiffness_n_per_m = scratch.patch.stiffness_n_per_m(|_| true);
    }

    fn solve_patch(&mut self, scratch: &mut HapticScratch, response_s: f64) {
        scratch.nodes.clear();
        scratch.nodes.extend(scratch.followers.iter().map(|f| f.node));
        self.model.local_model_into(&scratch.nodes, response_s, &mut scratch.work, &mut scratch.local);
        scratch.gather();
        let points = &scratch.points;
        scratch.patch.solve(&scratch.pressed, |point| points[point].motion);
    }

    /// Weights of the nodes that yield; none where the tool presses on held tissue.
    fn free_weights(&self, nodes: [NodeId; 3], weights: [f64; 3]) -> [f64; 3] {
        let fixed = nodes.map(|node| self.organ.is_fixed(node));
        match motion_weights(weights, fixed) {
            Some(_) => [0, 1, 2].map(|v| if fixed[v] { 0.0 } else { weights[v] }),
            None => [0.0; 3],
        }
    }
}

/// Coefficient that the tissue shows now: that of the tool, or the little more that a step leaves beyond it.
fn friction_now(tool: &Tool, force_n: DVec3, normal: DVec3) -> f64 {
    if tool.grip.is_sticky {
        return f64::INFINITY;
    }
    let push_n = force_n.dot(normal);
    let along_n = (force_n - normal * push_n).length();
    let shown = if push_n > 0.0 { along_n / push_n } else { 0.0 };
    tool.grip.friction_coefficient.max(shown.min(MOST_FRICTION))
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
