//! A step of a thread with all that holds it: the rounds in which thread, tissue and instruments come to terms.

use super::grip::HALF_CLIP_M;
use super::passage::MOST_PASSAGES;
use super::walls::Wall;
use super::{ROUNDS, Suture};
use crate::contact::tool_contact::ToolContact;
use crate::math::{DMat3, DVec3};
use crate::mesh::NodeId;
use crate::model::bounded_vec::BoundedVec;
use crate::model::{NodalForce, StepAnswer};
use crate::suture::{Bond, Surroundings, Tie, TieLaw};
use crate::tool::pose::ToolFrame;
use crate::tool::{MAX_TOOLS, Tool};
use crate::world::World;
use crate::world::grasp::pull_limit_n;
use crate::world::organ::Organ;
use crate::world::slide::UNKNOWN_M_PER_N;
use crate::world::spec::Hand;
use crate::world::suture_spec::SutureSpec;
use crate::world::tissue_patch::{PatchTissue, TissuePatch, add_force};
use crate::world::tool_state::ToolState;

/// Tissue is taken to be at least so soft [m/N]: what is fixed then holds a thread by a spring of 100 N/mm.
const LEAST_M_PER_N: f64 = 1e-5;
/// Stiffness of jaws that impose their motion, and of a clip that holds two strands [N/m]: choices.
const JAWS_N_PER_M: f64 = 1e4;
const CLIP_N_PER_M: f64 = 1e4;
/// Two passages keep so far apart along the thread [m].
const APART_M: f64 = 1e-5;
/// Room for what a search finds beside a node.
const MOST_NEAR: usize = 12;

/// What holds a place of the thread.
#[derive(Clone, Copy, Debug)]
enum Holder {
    Passage(usize),
    Wall(usize),
    Grip { tool: usize, which: usize },
}

/// A tie, and how its other side gives way.
#[derive(Clone, Copy, Debug)]
struct Held {
    holder: Holder,
    /// Nodes of the tissue, and their weights; of a grip none.
    nodes: [NodeId; 4],
    weights: [f64; 4],
    n_nodes: usize,
    /// Places of the nodes in the patch; none of them where the model is not asked.
    places: Option<[usize; 4]>,
    /// Force of the last step [N].
    before_n: DVec3,
    /// Where the other side goes under that force [m].
    free_m: DVec3,
    /// How it is taken to give way [m/N].
    own_m_per_n: f64,
}

/// Room for a step.
#[derive(Debug)]
pub(super) struct Scratch {
    pub(super) walls: BoundedVec<Wall>,
    pub(super) near: Vec<ToolContact>,
    /// The tissue's nodes that the model is asked for.
    patch: TissuePatch,
    ties: BoundedVec<Tie>,
    held: BoundedVec<Held>,
    bonds: BoundedVec<Bond>,
    /// How many places each of the patch's nodes bears, by their weights.
    borne: Vec<f64>,
}

impl Clone for Scratch {
    fn clone(&self) -> Self {
        // Nothing in it lasts from step to step.
        Self::for_nodes(self.walls.capacity())
    }
}

impl Scratch {
    /// For a thread of so many nodes.
    pub(super) fn for_nodes(n_nodes: usize) -> Self {
        let n_ties = MOST_PASSAGES + n_nodes + 2 * MAX_TOOLS;
        Self {
            walls: BoundedVec::with_capacity(n_nodes),
            near: Vec::with_capacity(MOST_NEAR),
            patch: TissuePatch::new(),
            ties: BoundedVec::with_capacity(n_ties),
            held: BoundedVec::with_capacity(n_ties),
            bonds: BoundedVec::with_capacity(super::MOST_CLIPS),
            borne: vec![0.0; TissuePatch::MOST_NODES],
        }
    }

    /// Whether a place inside moves in the model at all. One that knows of the surface alone holds a thread by the holes.
    fn yields(&self, (nodes, weights): (&[NodeId; 4], &[f64; 4]), organ: &Organ) -> bool {
        let patch = &self.patch;
        let knows = |node: &NodeId| {
            let place = patch.place_of(*node);
            place.is_none_or(|i| patch.tensor_m_per_n(i, i) != DMat3::ZERO) || organ.is_fixed(*node)
        };
        let known = nodes.iter().zip(weights).filter(|(node, _)| knows(node));
        known.map(|(_, weight)| weight).sum::<f64>() > 0.5
    }

    /// How soft the patch is where all places pull together: at most so much for each of its nodes [m/N].
    fn softness_m_per_n(&self, place: usize) -> f64 {
        let most = |tensor: DMat3| (0..3).map(|a| tensor.col(a)[a].abs()).fold(0.0, f64::max);
        let borne = self.borne[..self.patch.nodes.len()].iter().enumerate();
        borne.map(|(j, borne)| most(self.patch.tensor_m_per_n(place, j)) * borne).sum()
    }

    fn places_of(&self, nodes: &[NodeId]) -> [usize; 4] {
        let mut places = [0; 4];
        for (place, node) in places.iter_mut().zip(nodes) {
            *place = self.patch.place_of(*node).unwrap_or(0);
        }
        places
    }
}

/// The instruments in a step.
struct Instruments<'a> {
    tools: &'a [Tool],
    states: &'a [ToolState],
    hand: Option<&'a Hand>,
    dt_s: f64,
}

impl Instruments<'_> {
    /// How stiffly an instrument is held [N/m].
    fn stiffness_n_per_m(&self) -> f64 {
        self.hand.map_or(JAWS_N_PER_M, |hand| hand.step_stiffness_n_per_m(self.dt_s))
    }
}

impl World {
    /// Asks the model how a patch answers in a step.
    pub(in crate::world) fn ask_model(&mut self, patch: &TissuePatch) {
        if patch.nodes.is_empty() {
            return;
        }
        self.slide.drifting.set_telling_changes(false);
        let (work, local) = (&mut self.slide.drifting, &mut self.slide.local);
        self.model.local_model_into(&patch.nodes, self.spec.time_step_s, work, local);
    }

    /// What the patch that was asked for last is told.
    pub(in crate::world) fn patch_tissue(&self) -> PatchTissue<'_> {
        PatchTissue {
            organ: &self.organ,
            local: &self.slide.local,
            velocities_m_per_s: self.model.state().velocities_m_per_s,
            goes_on: self.model.step_answer() == StepAnswer::NodeByNode,
            dt_s: self.spec.time_step_s,
        }
    }

    /// A step of one thread; instruments that hold it come after it.
    pub(super) fn settle_thread(&mut self, number: usize, suture: &mut Suture) {
        let dt_s = self.spec.time_step_s;
        suture.memory.learn_softness(self.organ.positions_m());
        suture.find_walls(&self.organ, dt_s);
        suture.gather_patch(&self.organ);
        self.ask_model(&suture.scratch.patch);
        let state = self.model.state();
        let with = Instruments {
            tools: &self.spec.tools,
            states: &self.tool_states,
            hand: self.spec.hand.as_ref(),
            dt_s,
        };
        let spec = &self.spec.sutures[number];
        suture.scratch.patch.learn(&self.patch_tissue(), &suture.memory);
        suture.gather_ties(&self.organ, &with);
        suture.come_to_terms(spec, &with, self.gravity_m_per_s2);
        suture.keep_forces(state.velocities_m_per_s, self.organ.positions_m());
        if self.spec.hand.is_some() {
            let held_n_per_m = with.stiffness_n_per_m();
            for (place, (hand, tool)) in self.tool_states.iter_mut().zip(&self.spec.tools).enumerate() {
                let moved_m = suture.on_tools_n[place] / held_n_per_m;
                if moved_m != DVec3::ZERO && moved_m.is_finite() {
                    hand.put_tip(tool, hand.now.tip_in_world_m + moved_m);
                }
            }
        }
    }
}

impl Suture {
    /// Nodes that the model is asked for: of all passages, then of what the thread lies on.
    fn gather_patch(&mut self, organ: &Organ) {
        let scratch = &mut *self.scratch;
        scratch.patch.nodes.clear();
        for passage in self.passages.iter() {
            scratch.patch.ask_for(&passage.site.nodes(organ.body()));
        }
        for force in self.forces.iter() {
            scratch.patch.ask_for(&[force.node]);
        }
        for i in 0..scratch.walls.len() {
            let wall = scratch.walls[i];
            if wall.is_near {
                scratch.walls[i].is_near = scratch.patch.ask_for(&wall.nodes);
            }
        }
        scratch.patch.set_before(&self.forces);
    }

    fn gather_ties(&mut self, organ: &Organ, with: &Instruments<'_>) {
        let scratch = &mut *self.scratch;
        scratch.held.clear();
        scratch.borne.fill(0.0);
        for (i, passage) in self.passages.iter().enumerate() {
            let nodes = passage.site.nodes(organ.body());
            let (weights, before_n) = (passage.site.weights, passage.force_n);
            if !scratch.yields((&nodes, &weights), organ) {
                continue;
            }
            let place = Place { nodes, weights, n_nodes: 4, offset_m: DVec3::ZERO, is_asked: true };
            add(scratch, Holder::Passage(i), &place, before_n, organ);
        }
        for i in 0..scratch.walls.len() {
            let wall = scratch.walls[i];
            let ([a, b, c], [u, v, w]) = (wall.nodes, wall.weights);
            let place = Place {
                nodes: [a, b, c, a],
                weights: [u, v, w, 0.0],
                n_nodes: 3,
                offset_m: wall.normal * self.rod.radius_m(),
                is_asked: wall.is_near,
            };
            add(scratch, Holder::Wall(i), &place, self.lies_n[wall.node], organ);
        }
        for held in scratch.held.iter() {
            let Some(places) = held.places else { continue };
            (0..held.n_nodes).for_each(|v| scratch.borne[places[v]] += held.weights[v]);
        }
        for i in 0..scratch.held.len() {
            let held = scratch.held[i];
            let softness = held.places.map_or(UNKNOWN_M_PER_N, |places| {
                (0..held.n_nodes).map(|v| held.weights[v] * scratch.softness_m_per_n(places[v])).sum()
            });
            scratch.held[i].own_m_per_n = softness.max(LEAST_M_PER_N);
        }
        for (tool, grip) in self.grips.iter().enumerate() {
            let Some(grip) = grip else { continue };
            let frame = ToolFrame::of(&with.states[tool].now);
            for which in 0..grip.n_places() {
                scratch.held.try_push(Held {
                    holder: Holder::Grip { tool, which },
                    nodes: [NodeId(0); 4],
                    weights: [0.0; 4],
                    n_nodes: 0,
                    places: None,
                    before_n: DVec3::ZERO,
                    free_m: frame.to_world_m(grip.in_tool_m[which]),
                    own_m_per_n: grip.n_places() as f64 / with.stiffness_n_per_m(),
                });
            }
        }
        scratch.bonds.clear();
        for clip in self.clips.iter().filter(|clip| clip.joins()) {
            let at = clip.along_m.map(|along_m| self.rod.place_at(along_m));
            scratch.bonds.try_push(Bond { at, stiffness_n_per_m: CLIP_N_PER_M });
        }
    }

    fn come_to_terms(&mut self, spec: &SutureSpec, with: &Instruments<'_>, gravity_m_per_s2: DVec3) {
        self.scratch.ties.clear();
        for i in 0..self.scratch.held.len() {
            let held = self.scratch.held[i];
            let tie = Tie {
                at: match held.holder {
                    Holder::Wall(i) => self.rod.place_of(self.scratch.walls[i].node),
                    holder => self.rod.place_at(self.along_m(holder)),
                },
                law: self.law(held.holder),
                stiffness_n_per_m: 1.0 / held.own_m_per_n,
                place_m: held.free_m,
                force_before_n: held.before_n,
            };
            self.scratch.ties.try_push(tie);
        }
        self.respond(spec.friction_coefficient);
        self.solver.start(&self.rod, gravity_m_per_s2, with.dt_s);
        for _ in 0..ROUNDS {
            let around =
                Surroundings { ties: &self.scratch.ties, bonds: &self.scratch.bonds, dt_s: with.dt_s };
            self.solver.settle(&mut self.rod, &around);
            self.slide(spec, with);
            self.answer(spec.friction_coefficient);
        }
        self.solver.finish(&mut self.rod, with.dt_s);
    }

    /// Which place of the thread is held.
    fn along_m(&self, holder: Holder) -> f64 {
        match holder {
            Holder::Passage(i) => self.passages[i].along_m,
            Holder::Wall(i) => self.rod.spacing_m() * self.scratch.walls[i].node as f64,
            Holder::Grip { tool, which } => self.grips[tool].map_or(0.0, |grip| grip.along_m[which]),
        }
    }

    /// How a place is held; the limit of friction is found where the tissue answers.
    fn law(&self, holder: Holder) -> TieLaw {
        let Holder::Wall(i) = holder else { return TieLaw::Held };
        TieLaw::Wall { normal: self.scratch.walls[i].normal, most_friction_n: 0.0 }
    }

    /// After a round: the thread slides through what holds it where that pulls along it by more than friction bears.
    fn slide(&mut self, spec: &SutureSpec, with: &Instruments<'_>) {
        for i in 0..self.scratch.held.len() {
            let (held, tie) = (self.scratch.held[i], self.scratch.ties[i]);
            let force_n = tie.force_n(&self.rod.positions_m);
            let along = self.rod.direction_at(self.along_m(held.holder));
            let pull_n = force_n.dot(along);
            let across_n = (force_n - along * pull_n).length();
            let most_n = match held.holder {
                Holder::Wall(_) => continue,
                Holder::Passage(_) => spec.friction_coefficient * across_n,
                Holder::Grip { tool, .. } => match with.tools[tool].kind.jaws() {
                    _ if with.tools[tool].grip.is_sticky => f64::INFINITY,
                    Some(jaws) => {
                        pull_limit_n(&with.tools[tool], jaws, &with.states[tool].now)
                            * self.share_of_grip(tool)
                    }
                    None => 0.0,
                },
            };
            let beyond_n = pull_n.abs() - most_n;
            if beyond_n <= 0.0 || !beyond_n.is_finite() {
                continue;
            }
            let way_m = -pull_n.signum() * beyond_n / tie.stiffness_n_per_m;
            let along_m = self.slid(held.holder, way_m.clamp(-self.rod.spacing_m(), self.rod.spacing_m()));
            self.scratch.ties[i].at = self.rod.place_at(along_m);
        }
    }

    fn share_of_grip(&self, tool: usize) -> f64 {
        self.grips[tool].map_or(1.0, |grip| 1.0 / grip.n_places() as f64)
    }

    /// Lets what holds the thread go along it, no further than what is beside it and clips allow; answers where it is [m].
    fn slid(&mut self, holder: Holder, way_m: f64) -> f64 {
        let (from_m, length_m) = (self.along_m(holder), self.rod.length_m());
        let Holder::Passage(i) = holder else {
            let to_m = from_m + way_m;
            if let Holder::Grip { tool, which } = holder
                && let Some(grip) = &mut self.grips[tool]
            {
                grip.along_m[which] = to_m;
            }
            return to_m;
        };
        // Beyond the ends it has slipped out, which the end of the step sees.
        let (mut least_m, mut most_m) = (-APART_M, length_m + APART_M);
        if let Some(before) = i.checked_sub(1) {
            least_m = self.passages[before].along_m + APART_M;
        }
        if let Some(after) = self.passages.get(i + 1) {
            most_m = after.along_m - APART_M;
        }
        for clip_m in self.clips.iter().flat_map(|clip| clip.along_m) {
            if clip_m <= from_m {
                least_m = least_m.max(clip_m + HALF_CLIP_M);
            } else {
                most_m = most_m.min(clip_m - HALF_CLIP_M);
            }
        }
        // One that is beyond a limit already comes no nearer to it.
        let to_m = (from_m + way_m).max(least_m.min(from_m)).min(most_m.max(from_m));
        self.passages[i].along_m = to_m;
        to_m
    }

    /// After a round: the tissue answers to the forces of the round, and the next one begins there.
    fn answer(&mut self, friction_coefficient: f64) {
        let scratch = &mut *self.scratch;
        for (held, tie) in scratch.held.iter().zip(scratch.ties.iter_mut()) {
            if !matches!(held.holder, Holder::Grip { .. }) {
                tie.force_before_n = tie.force_n(&self.rod.positions_m);
            }
        }
        self.respond(friction_coefficient);
    }

    /// Where the forces of the ties take the tissue. What the thread let go of since the last step counts too: a place that it lies on
    /// is another one when it has slid on.
    fn respond(&mut self, friction_coefficient: f64) {
        let scratch = &mut *self.scratch;
        let patch = &mut scratch.patch;
        for (change_n, before_n) in patch.change_n.iter_mut().zip(&patch.before_n) {
            *change_n = -*before_n;
        }
        for (held, tie) in scratch.held.iter().zip(scratch.ties.iter_mut()) {
            let force_n = tie.force_before_n;
            match held.places {
                Some(places) => {
                    (0..held.n_nodes).for_each(|v| patch.change_n[places[v]] += force_n * held.weights[v]);
                }
                None if held.n_nodes > 0 => {
                    tie.place_m = held.free_m + (force_n - held.before_n) * held.own_m_per_n;
                    // What it pulls on may be known to others.
                    for v in 0..held.n_nodes {
                        if let Some(place) = patch.place_of(held.nodes[v]) {
                            patch.change_n[place] += force_n * held.weights[v];
                        }
                    }
                }
                None => {}
            }
        }
        patch.answer();
        for (held, tie) in scratch.held.iter().zip(scratch.ties.iter_mut()) {
            if let Some(places) = held.places {
                let moved_m: DVec3 =
                    (0..held.n_nodes).map(|v| patch.moves_m[places[v]] * held.weights[v]).sum();
                tie.place_m = held.free_m + moved_m;
            }
            if let TieLaw::Wall { normal, most_friction_n } = &mut tie.law {
                let push_n = (-tie.force_before_n.dot(*normal)).max(0.0);
                *most_friction_n = friction_coefficient * push_n;
            }
        }
    }

    /// After the rounds: what lasts until the next step.
    fn keep_forces(&mut self, velocities_m_per_s: &[DVec3], positions_m: &[DVec3]) {
        self.on_tools_n = [DVec3::ZERO; MAX_TOOLS];
        self.forces.clear();
        self.lies_n.fill(DVec3::ZERO);
        for (held, tie) in self.scratch.held.iter().zip(self.scratch.ties.iter()) {
            // Of the last round: what the tissue answered to.
            let force_n = match held.holder {
                Holder::Grip { .. } => tie.force_n(&self.rod.positions_m),
                _ => tie.force_before_n,
            };
            if !force_n.is_finite() {
                continue;
            }
            match held.holder {
                Holder::Passage(i) => self.passages[i].force_n = force_n,
                Holder::Wall(i) => self.lies_n[self.scratch.walls[i].node] = force_n,
                Holder::Grip { tool, .. } => self.on_tools_n[tool] += force_n,
            }
            for v in 0..held.n_nodes {
                let force_n = force_n * held.weights[v];
                add_force(&mut self.forces, NodalForce { node: held.nodes[v], force_n });
            }
        }
        self.scratch.patch.keep(velocities_m_per_s, positions_m, &mut self.memory);
        self.let_slip_out();
    }

    /// Passages and jaws that the thread has slipped out of hold it no more.
    fn let_slip_out(&mut self) {
        let length_m = self.rod.length_m();
        while let Some(first) = self.passages.first().filter(|first| first.along_m < 0.0) {
            self.tip_is_inside ^= first.is_hole;
            self.passages.remove(0);
        }
        for grip in &mut self.grips {
            grip.take_if(|grip| grip.along_m.iter().any(|m| !(0.0..=length_m).contains(m)));
        }
        while self.passages.last().is_some_and(|last| last.along_m > length_m) {
            self.passages.pop();
        }
        self.tip_is_inside &= !self.passages.is_empty();
    }
}

/// A place of the tissue.
struct Place {
    nodes: [NodeId; 4],
    weights: [f64; 4],
    n_nodes: usize,
    /// How far from it the middle of the thread is [m].
    offset_m: DVec3,
    /// Whether the model was asked for its nodes.
    is_asked: bool,
}

/// Adds a place that tissue holds.
fn add(scratch: &mut Scratch, holder: Holder, place: &Place, before_n: DVec3, organ: &Organ) {
    let Place { nodes, weights, n_nodes, .. } = *place;
    let is_known = place.is_asked && nodes[..n_nodes].iter().all(|node| scratch.patch.nodes.contains(node));
    let places = is_known.then(|| scratch.places_of(&nodes[..n_nodes]));
    let node_m = |v: usize| {
        let known = places.map(|places| scratch.patch.free_m[places[v]]);
        known.unwrap_or(organ.positions_m()[nodes[v].index()])
    };
    let free_m = place.offset_m + (0..n_nodes).map(|v| node_m(v) * weights[v]).sum::<DVec3>();
    let own_m_per_n = UNKNOWN_M_PER_N;
    scratch.held.try_push(Held { holder, nodes, weights, n_nodes, places, before_n, free_m, own_m_per_n });
}
