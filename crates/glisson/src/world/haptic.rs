//! What the haptic loop is told of a tool after a step: the force now, the stiffness of what it touches or holds, and when it
//! is free the place that it will touch next.

use super::World;
use super::grasp::{pull_limit_n, squeeze_j};
use super::parts::{ToolPart, ToolPoint, capsule};
use super::press::TOOL_FRICTION;
use super::skin::SurfacePlace;
use super::spec::Hand;
use crate::contact::spread::motion_weights;
use crate::contact::tool_contact::ToolContact;
use crate::haptics::{AxesModel, HapticModel, PatchStiffness, Touch, TouchedPart};
use crate::math::{DMat3, DVec3, cross_matrix, outer};
use crate::mesh::NodeId;
use crate::model::{LocalModel, LocalWork};
use crate::tool::pose::ToolFrame;
use crate::tool::{Tool, ToolInput};

/// How near tissue has to be to be told of [m]: beyond what the tool's speed may cover, which is added. A choice.
const REACH_M: f64 = 5e-3;
/// Periods for which the tool's speed is expected to last until a newer model is felt.
const PERIODS_AHEAD: f64 = 2.5;

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

/// A contact so near the trocar that it moves less than this share across the shaft is told at the tip: a choice.
const LEAST_LEVER: f64 = 0.05;

/// A point of tissue that follows the tool: how for a unit motion of the tip, and with which part. Its weights are those of
/// the followers that name it.
#[derive(Clone, Copy, Debug)]
struct PressedPoint {
    motion: DMat3,
    part: usize,
    /// How it moves when the jaws open by their whole way [m], when the instrument turns about its shaft [m/rad], and not.
    by_axes: DMat3,
    /// What the mesh is too coarse for, or another hand, yields by itself [m/N].
    sub_grid_m_per_n: f64,
    /// From the tip, about which a hand that gives way lets the instrument turn [m]; zero where it turns about a trocar.
    arm_m: DVec3,
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
    /// The nearest place.
    near: Vec<ToolContact>,
    /// Nodes that a part bears on, with their shares of its force.
    shares: Vec<(NodeId, f64)>,
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
            near: Vec::with_capacity(1),
            shares: Vec::with_capacity(LocalModel::MOST_NODES),
        }
    }

    fn clear(&mut self) {
        self.points.clear();
        self.followers.clear();
    }

    /// A point that presses on `nodes` by `weights`; nodes that are known already, and those without weight, do not count: the
    /// others bear their share. A point that was left with a small share would be as good as held.
    fn follow(&mut self, nodes: impl IntoIterator<Item = (NodeId, f64)>, of: PressedPoint) {
        let point = self.points.len();
        let n_before = self.followers.len();
        let (mut all, mut own) = (0.0, 0.0);
        for (node, weight) in nodes {
            let is_known = self.followers[..n_before].iter().any(|f| f.node == node);
            all += weight.max(0.0);
            if weight > 0.0 && !is_known && self.followers.len() < LocalModel::MOST_NODES {
                own += weight;
                self.followers.push(Follower { node, weight, point });
            }
        }
        if self.followers.len() > n_before {
            if own < all {
                self.followers[n_before..].iter_mut().for_each(|f| f.weight *= all / own);
            }
            self.points.push(of);
        }
    }

    /// A point that presses on no node; answers whether there was room.
    fn add_point(&mut self, of: PressedPoint) -> bool {
        let has_room = self.points.len() < LocalModel::MOST_NODES;
        if has_room {
            self.points.push(of);
        }
        has_room
    }

    /// From the nodes' compliance C to that of the points, sum of w_i w_j C_ij: a force at a point loads its nodes by their
    /// weights, and moves it by the weighted mean of theirs.
    ///
    /// A hand that gives way adds what its spring does to each of them: with the points' motions M_i and the spring k,
    /// M_i M_j^T/k, and with their arms a_i about the tip and its rotational spring r, [a_i] [a_j]^T/r.
    fn gather(&mut self, hand: Option<&Hand>) {
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
        for (i, of) in self.points.iter().enumerate() {
            for axis in 0..3 {
                of_points.compliance_m_per_n[n * (3 * i + axis) + 3 * i + axis] += of.sub_grid_m_per_n;
            }
        }
        let Some(hand) = hand else { return };
        for (i, of) in self.points.iter().enumerate() {
            for (j, by) in self.points.iter().enumerate() {
                let turned = cross_matrix(of.arm_m) * cross_matrix(by.arm_m).transpose();
                let tensor = of.motion * by.motion.transpose() * (1.0 / hand.stiffness_n_per_m)
                    + turned * (1.0 / hand.rotational_stiffness_n_m_per_rad);
                for along in 0..3 {
                    for axis in 0..3 {
                        of_points.compliance_m_per_n[n * (3 * i + axis) + 3 * j + along] +=
                            tensor.col(along)[axis];
                    }
                }
            }
        }
    }
}

/// What the tool is found to touch and hold, while its parts are gone through.
struct TouchedSoFar<'a> {
    scratch: &'a mut HapticScratch,
    model: &'a mut HapticModel,
    axes: AxesForces,
    n_parts: usize,
}

impl TouchedSoFar<'_> {
    fn add(&mut self, part: TouchedPart) {
        if let Some(place) = self.model.parts.get_mut(self.n_parts) {
            *place = part;
            self.n_parts += 1;
        }
    }
}

/// Gives each part its share of the patch's stiffness, and the model the sums at the tip.
fn share_stiffness(scratch: &HapticScratch, n_parts: usize, model: &mut HapticModel) {
    let points = &scratch.points;
    for (i, part) in model.parts[..n_parts].iter_mut().enumerate() {
        let at_tip_n_per_m = scratch.patch.stiffness_n_per_m(|point| points[point].part == i);
        model.stiffness_n_per_m += at_tip_n_per_m;
        model.force_n += part.at_tip_n(part.force_n);
        part.stiffness_n_per_m = if part.lever == DMat3::IDENTITY {
            at_tip_n_per_m
        } else {
            let back = part.lever.inverse();
            back.transpose() * at_tip_n_per_m * back
        };
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
        if tool < self.tool_states.len() {
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
        self.tell_motion(place, model);
        scratch.clear();
        let mut touched = TouchedSoFar { scratch, model, axes: AxesForces::default(), n_parts: 0 };
        self.add_grasp(place, &mut touched);
        self.add_contacts(place, &mut touched);
        self.add_other_tools(place, &mut touched);
        let TouchedSoFar { axes, n_parts, .. } = touched;
        if n_parts == 0 {
            self.meet_surface(place, response_s, scratch, model);
            return;
        }
        self.solve_patch(scratch, response_s);
        share_stiffness(scratch, n_parts, model);
        model.touch = model.parts[0].touch;
        let (tool, pose) = (&self.spec.tools[place], &self.tool_states[place].now);
        let closing = ToolFrame::of(pose).world_from_tool.x_axis;
        let held =
            (model.touch == Touch::Grasp).then(|| closing.dot(model.parts[0].stiffness_n_per_m * closing));
        if n_parts > 1 || model.parts[0].lever != DMat3::IDENTITY {
            model.n_parts = n_parts as u32;
        } else {
            model.parts = [TouchedPart::default(); HapticModel::MOST_PARTS];
        }
        let [slope_j, slope_n_m_per_rad] = axes.slopes(scratch);
        let squeezed_j = match (tool.kind.jaws(), held) {
            (Some(jaws), Some(tissue_n_per_m)) => squeeze_j(jaws, pose, tissue_n_per_m),
            _ => [0.0; 2],
        };
        model.axes = AxesModel {
            twist_n_m: axes.twist_n_m,
            roll_rad: if self.spec.hand.is_some() {
                self.tool_states[place].hand_roll_rad
            } else {
                pose.roll_rad
            },
            twist_stiffness_n_m_per_rad: slope_n_m_per_rad,
            jaw_j: axes.jaw_j + squeezed_j[0],
            jaw_opening: pose.jaw_opening,
            jaw_stiffness_j: slope_j + squeezed_j[1],
        };
    }

    /// Where the tip is, how fast it moves, and how well the instrument grips.
    fn tell_motion(&self, place: usize, model: &mut HapticModel) {
        let (hand, tool) = (&self.tool_states[place], &self.spec.tools[place]);
        let pose = hand.now;
        // A device is where the hand is, which is in front of the tip where the hand gives way.
        model.tip_m = if self.spec.hand.is_some() { hand.hand_tip_m } else { pose.tip_in_world_m };
        let before_m = if self.spec.hand.is_some() { hand.hand_before_m } else { hand.before.tip_in_world_m };
        model.tip_velocity_m_per_s = (model.tip_m - before_m) / self.spec.time_step_s;
        if !tool.grip.is_sticky {
            model.friction_coefficient = tool.grip.friction_coefficient;
            model.hold_n = tool.kind.jaws().map_or(f64::INFINITY, |jaws| pull_limit_n(tool, jaws, &pose));
        }
    }

    /// Adds what the tool holds, if it holds anything.
    fn add_grasp(&self, place: usize, told: &mut TouchedSoFar<'_>) {
        let (hand, tool) = (&self.tool_states[place], &self.spec.tools[place]);
        let Some(grasp) = &hand.grasp else { return };
        let pose = hand.now;
        let mut touched = Touching::default();
        for (node, place_m) in grasp.places_m(ToolFrame::of(&pose)) {
            let point = PressedPoint {
                motion: lever(tool, &pose, place_m),
                part: told.n_parts,
                by_axes: DMat3::from_cols(DVec3::ZERO, turn_m_per_rad(&pose, place_m), DVec3::ZERO),
                sub_grid_m_per_n: 0.0,
                arm_m: arm_m(tool, &pose, place_m),
            };
            told.scratch.follow([(node, 1.0)], point);
            let force_n = -self.force_on_node_n(place, node);
            touched.add(force_n, place_m, &point.motion);
            told.axes.add(force_n, &point);
        }
        told.add(touched.part(Touch::Grasp, tool, &pose));
    }

    /// Adds what the parts of the tool touch. The first contact gives the surface.
    fn add_contacts(&self, place: usize, told: &mut TouchedSoFar<'_>) {
        let (hand, tool) = (&self.tool_states[place], &self.spec.tools[place]);
        let pose = hand.now;
        for part in ToolPart::ALL {
            let Some(contact) = &hand.contacts[part.index()] else { continue };
            let place_m = contact.at.in_world_m(tool, &pose);
            let (opening, turn) = (opening_m(tool, &pose, contact.at), turn_m_per_rad(&pose, place_m));
            let point = PressedPoint {
                motion: lever(tool, &pose, place_m),
                part: told.n_parts,
                by_axes: DMat3::from_cols(opening, turn, DVec3::ZERO),
                sub_grid_m_per_n: self.press.sub_grid_m_per_n(place, part, contact.normal),
                arm_m: arm_m(tool, &pose, place_m),
            };
            let weights = self.free_weights(contact.nodes, contact.weights);
            let mut shares = std::mem::take(&mut told.scratch.shares);
            self.press.shares_into(place, part, &mut shares);
            if shares.is_empty() {
                told.scratch.follow(contact.nodes.into_iter().zip(weights), point);
            } else {
                let yields = shares.iter().copied().filter(|(node, _)| !self.organ.is_fixed(*node));
                told.scratch.follow(yields, point);
            }
            told.scratch.shares = shares;
            let force_n = -self.force_on_organ_n(place, Some(part));
            let mut touched = Touching::default();
            touched.add(force_n, place_m, &point.motion);
            told.axes.add(force_n, &point);
            let mut touched =
                TouchedPart { normal: contact.normal, ..touched.part(Touch::Contact, tool, &pose) };
            touched.friction_coefficient = friction_now(tool, touched.force_n, contact.normal);
            told.add(touched);
            if told.model.normal == DVec3::ZERO {
                let dt_s = self.spec.time_step_s;
                told.model.friction_coefficient = touched.friction_coefficient;
                told.model.normal = contact.normal;
                told.model.surface_m = contact.point_m(self.organ.positions_m());
                told.model.surface_velocity_m_per_s =
                    self.organ.skin().velocity_m_per_s(contact.nodes, contact.weights, dt_s);
            }
        }
    }

    /// Adds the other instruments that the tool touches, as one part: each yields as its hand does.
    fn add_other_tools(&self, place: usize, told: &mut TouchedSoFar<'_>) {
        let (Some(hand), tool) = (&self.spec.hand, &self.spec.tools[place]) else { return };
        let pose = self.tool_states[place].now;
        let (mut touched, mut pushed_n, mut on_tool_n) = (Touching::default(), DVec3::ZERO, DVec3::ZERO);
        let touches_nothing_else = told.model.normal == DVec3::ZERO;
        for contact in self.press.pair_contacts() {
            let tools = contact.tools();
            let Some(own) = tools.iter().position(|tool| *tool == place) else { continue };
            let other = tools[1 - own];
            let yields_m_per_n = self.hand_yields_m_per_n(hand, other, (contact.place_m, contact.normal));
            let point = PressedPoint {
                motion: lever(tool, &pose, contact.place_m),
                part: told.n_parts,
                by_axes: DMat3::from_cols(DVec3::ZERO, turn_m_per_rad(&pose, contact.place_m), DVec3::ZERO),
                sub_grid_m_per_n: yields_m_per_n,
                arm_m: arm_m(tool, &pose, contact.place_m),
            };
            let force_n = contact.force_on_n(place);
            if !told.scratch.add_point(point) {
                continue;
            }
            touched.add(force_n, contact.place_m, &point.motion);
            told.axes.add(force_n, &point);
            on_tool_n += force_n;
            // The first is pushed along the normal, the second against it.
            let out = if own == 0 { contact.normal } else { -contact.normal };
            pushed_n += out * force_n.dot(out);
            if touches_nothing_else && touched.n == 1 {
                told.model.surface_m = contact.place_m;
            }
        }
        if touched.n == 0 {
            return;
        }
        let normal = pushed_n.normalize_or_zero();
        let mut part = TouchedPart { normal, ..touched.part(Touch::Contact, tool, &pose) };
        part.friction_coefficient = TOOL_FRICTION.max(shown_friction(on_tool_n, normal));
        if touches_nothing_else {
            // Of a single part the model itself is what the law takes.
            told.model.normal = part.normal;
            told.model.friction_coefficient = part.friction_coefficient;
        }
        told.add(part);
    }

    /// How a place of a tool yields along a direction by its hand [m/N].
    fn hand_yields_m_per_n(&self, hand: &Hand, tool: usize, (place_m, along): (DVec3, DVec3)) -> f64 {
        let (spec, pose) = (&self.spec.tools[tool], &self.tool_states[tool].now);
        let at_tip = lever(spec, pose, place_m).transpose() * along;
        let turned_m = arm_m(spec, pose, place_m).cross(along);
        at_tip.length_squared() / hand.stiffness_n_per_m
            + turned_m.length_squared() / hand.rotational_stiffness_n_m_per_rad
    }

    /// The place that a free tool will touch, and how stiff it is.
    fn meet_surface(
        &mut self,
        place: usize,
        response_s: f64,
        scratch: &mut HapticScratch,
        model: &mut HapticModel,
    ) {
        let (hand, tool) = (&self.tool_states[place], &self.spec.tools[place]);
        let is_cutting = tool.kind.blade().is_some() && hand.now.is_triggered();
        let reach_m = REACH_M + model.tip_velocity_m_per_s.length() * PERIODS_AHEAD * model.period_s;
        model.gap_m = reach_m;
        if is_cutting || !reach_m.is_finite() {
            return;
        }
        let mut nearest: Option<SurfacePlace> = None;
        for part in [ToolPart::Tip, ToolPart::SecondJaw] {
            let Some(shape) = capsule(tool, part, &hand.now) else { continue };
            self.organ.skin().nearest_into(&shape, reach_m, &mut scratch.near);
            let Some(found) = scratch.near.first() else { continue };
            if nearest.is_none_or(|best| found.contact.gap_m < best.found.contact.gap_m) {
                nearest = Some(self.organ.skin().place_of(*found));
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
        let at_tip = PressedPoint {
            motion: DMat3::IDENTITY,
            part: 0,
            by_axes: DMat3::ZERO,
            sub_grid_m_per_n: self.first_sub_grid_m_per_n(tool, surface.nodes[0]),
            arm_m: DVec3::ZERO,
        };
        scratch.follow(surface.nodes.into_iter().zip(weights), at_tip);
        self.solve_patch(scratch, response_s);
        model.stiffness_n_per_m = scratch.patch.stiffness_n_per_m(|_| true);
    }

    fn solve_patch(&mut self, scratch: &mut HapticScratch, response_s: f64) {
        scratch.nodes.clear();
        scratch.nodes.extend(scratch.followers.iter().map(|f| f.node));
        if scratch.nodes.is_empty() {
            scratch.local.nodes.clear();
        } else {
            let (work, local) = (&mut scratch.work, &mut scratch.local);
            self.model.local_model_into(&scratch.nodes, response_s, work, local);
        }
        scratch.gather(self.spec.hand.as_ref());
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

/// Contacts that are told as one part: what they do at the tip, and where they are in the middle.
#[derive(Clone, Copy, Debug, Default)]
struct Touching {
    at_tip_n: DVec3,
    places_m: DVec3,
    n: u32,
}

impl Touching {
    fn add(&mut self, force_n: DVec3, place_m: DVec3, motion: &DMat3) {
        self.at_tip_n += motion.transpose() * force_n;
        self.places_m += place_m;
        self.n += 1;
    }

    /// The force in their middle that does the same at the tip. What touches in the trocar itself moves with no tip: it is told
    /// at the tip.
    fn part(&self, touch: Touch, tool: &Tool, pose: &ToolInput) -> TouchedPart {
        let middle = lever(tool, pose, self.places_m / f64::from(self.n.max(1)));
        let is_level = middle.determinant() >= LEAST_LEVER * LEAST_LEVER;
        let lever = if is_level { middle } else { DMat3::IDENTITY };
        let force_n = lever.inverse().transpose() * self.at_tip_n;
        TouchedPart { touch, force_n, lever, ..TouchedPart::default() }
    }
}

/// Moment about the shaft and work on the jaws.
#[derive(Clone, Copy, Debug, Default)]
struct AxesForces {
    twist_n_m: f64,
    jaw_j: f64,
    /// Whether any point moves with them.
    moves: bool,
}

impl AxesForces {
    fn add(&mut self, force_n: DVec3, point: &PressedPoint) {
        self.jaw_j += force_n.dot(point.by_axes.x_axis);
        self.twist_n_m += force_n.dot(point.by_axes.y_axis);
        self.moves |= point.by_axes != DMat3::ZERO;
    }

    /// How they fall when the jaws open by their whole way [J] and when the instrument turns [N m/rad]; the patch is solved anew.
    fn slopes(&self, scratch: &mut HapticScratch) -> [f64; 2] {
        if !self.moves {
            return [0.0; 2];
        }
        let points = &scratch.points;
        scratch.patch.solve(&scratch.pressed, |point| points[point].by_axes);
        let slopes = scratch.patch.rise_n_per_m(|_| true);
        [slopes.x_axis.x, slopes.y_axis.y].map(|slope| if slope.is_finite() { slope.max(0.0) } else { 0.0 })
    }
}

/// From the tip to a place of a tool that turns about it [m]; zero through a trocar.
fn arm_m(tool: &Tool, pose: &ToolInput, place_m: DVec3) -> DVec3 {
    if tool.trocar_m.is_none() { place_m - pose.tip_in_world_m } else { DVec3::ZERO }
}

/// How a place that is fixed to the tool moves when the instrument turns about its shaft [m/rad].
fn turn_m_per_rad(pose: &ToolInput, place_m: DVec3) -> DVec3 {
    pose.shaft_in_world.cross(place_m - pose.tip_in_world_m)
}

/// How a point on a jaw moves when the jaws open by their whole way [m].
fn opening_m(tool: &Tool, pose: &ToolInput, point: ToolPoint) -> DVec3 {
    let (Some(jaws), ToolPoint::OnAxis(part, along)) = (tool.kind.jaws(), point) else { return DVec3::ZERO };
    let side = match part {
        ToolPart::Tip => 1.0,
        ToolPart::SecondJaw => -1.0,
        ToolPart::Shaft => return DVec3::ZERO,
    };
    let (sine, cosine) = libm::sincos(0.5 * jaws.opening_rad(pose.jaw_opening));
    let arm_m = (1.0 - along) * jaws.length_m;
    let in_tool_m = DVec3::new(side * cosine, 0.0, sine) * (0.5 * jaws.greatest_opening_rad * arm_m);
    ToolFrame::of(pose).world_from_tool * in_tool_m
}

/// Coefficient that the tissue shows now: that of the tool, or the little more that a step leaves beyond it.
fn friction_now(tool: &Tool, force_n: DVec3, normal: DVec3) -> f64 {
    if tool.grip.is_sticky {
        return f64::INFINITY;
    }
    tool.grip.friction_coefficient.max(shown_friction(force_n, normal))
}

/// Coefficient that a force shows.
fn shown_friction(force_n: DVec3, normal: DVec3) -> f64 {
    let push_n = force_n.dot(normal);
    let along_n = (force_n - normal * push_n).length();
    if push_n > 0.0 { (along_n / push_n).min(MOST_FRICTION) } else { 0.0 }
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A shaft behind a tip that bears on the same nodes: with a tenth of its share left it would seem a hundred times as stiff.
    #[test]
    fn a_point_that_shares_its_nodes_bears_wholly_on_those_that_are_left() {
        let point = |part| PressedPoint {
            motion: DMat3::IDENTITY,
            part,
            by_axes: DMat3::ZERO,
            sub_grid_m_per_n: 0.0,
            arm_m: DVec3::ZERO,
        };
        let mut scratch = HapticScratch::for_nodes(8);
        scratch.follow([(NodeId(0), 0.5), (NodeId(1), 0.5)], point(0));
        scratch.follow([(NodeId(0), 0.6), (NodeId(1), 0.3), (NodeId(2), 0.1)], point(1));
        scratch.follow([(NodeId(2), 1.0), (NodeId(0), 0.0)], point(2));
        let found: Vec<_> = scratch.followers.iter().map(|f| (f.node, f.point)).collect();
        assert_eq!(found, [(NodeId(0), 0), (NodeId(1), 0), (NodeId(2), 1)]);
        assert!((scratch.followers[2].weight - 1.0).abs() < 1e-12, "{:?}", scratch.followers);
        assert_eq!(scratch.points.len(), 2);
    }
}
