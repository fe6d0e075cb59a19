//! Ligating loops: threads that an instrument draws tight around a stump, and those that were tied off and stay on it.
//!
//! An open loop is a circle before the instrument's tip, too light to push tissue. What lies wholly within it is what it is around;
//! where its thread is deeper in tissue than it swerves, it is caught there and goes around nothing until it has come free: it has to be
//! put over the end of a stump, and does not get around it from the side. From when the lever is moved on, the thread is drawn through
//! places of what it is around ([`noose`]), as far as the lever or its greatest pull takes it and not beyond a share of the girth. With
//! the trigger a loop that is tight is tied off and cut from the instrument, which has a new one when its lever is open again. Vessels
//! that go through what is tied off are closed there.

mod noose;
mod section;
mod tension;

use super::World;
use super::organ::Organ;
use crate::math::DVec3;
use crate::mesh::edit::TopologyChange;
use crate::mesh::topology::Topology;
use crate::model::bounded_vec::BoundedVec;
use crate::model::{LocalModel, NodalForce, NodalSpring, StepAnswer};
use crate::record::snapshot::ThreadSnapshot;
use crate::tool::ligating_loop::LigatingLoop;
use crate::tool::{MAX_TOOLS, Tool, ToolInput};
use crate::world::tissue_patch::add_force;
use crate::world::tool_state::went_elsewhere;
use noose::{MOST_ANCHORS, Noose, NooseScratch, Tip, Way};
use section::{Crossing, Section};

/// Loops that are tied off, at most.
pub const MOST_TIED: usize = 8;
/// A lever that is open so far leaves a loop as it is, and an instrument whose loop is spent has a new one: a choice.
const OPEN_ABOVE: f64 = 0.9;
/// How deep the thread of an open loop may be in tissue, which it gives way to, over the loop's diameter: a choice.
const SWERVES: f64 = 0.1;
/// What is tied is drawn to this share of its girth at most: a choice. Tissue that is crushed is not modelled.
const LEAST_GIRTH: f64 = 0.65;
/// A thread is drawn no faster than this [m/s]: a choice.
const DRAWN_M_PER_S: f64 = 0.1;
/// A loop is tight, and may be tied off, where it has drawn what it is around to this share of its girth, pulls with this share of its
/// greatest pull, or can press the tissue no further: choices.
const TIGHT_GIRTH: f64 = 0.85;
const TIGHT_PULL: f64 = 0.9;
/// Corners that an open loop is drawn with.
const CORNERS: usize = 32;

/// How far a loop is.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Stage {
    /// A circle.
    Open {
        /// Whether its thread is caught in tissue.
        is_caught: bool,
    },
    /// Its thread follows the lever.
    Drawn,
    /// It was tied off.
    Spent,
}

/// The loop of one instrument.
#[derive(Clone, Debug)]
struct ToolLoop {
    size: LigatingLoop,
    stage: Stage,
    noose: Noose,
    /// Girth of what it is around when it began to be drawn [m].
    girth_m: f64,
}

/// The loops of a world.
#[derive(Clone, Debug, Default)]
pub(super) struct Loops {
    /// In the order of the tools; none of those without.
    of_tools: Vec<Option<ToolLoop>>,
    /// Those that are tied off, with their numbers.
    tied: Vec<(u32, Noose)>,
    /// The number of the next one.
    next_number: u32,
    /// Forces of all on nodes in the last step, ascending by node.
    forces: Option<BoundedVec<NodalForce>>,
}

/// Room for a step; nothing in it lasts.
#[derive(Debug)]
pub(super) struct LoopScratch {
    section: Section,
    around: BoundedVec<Crossing>,
    noose: NooseScratch,
}

impl LoopScratch {
    /// Where an instrument has a loop.
    pub(super) fn of(tools: &[Tool]) -> Option<Box<Self>> {
        tools.iter().any(|tool| tool.kind.ligating_loop().is_some()).then(|| {
            Box::new(Self {
                section: Section::new(),
                around: BoundedVec::with_capacity(MOST_ANCHORS),
                noose: NooseScratch::new(),
            })
        })
    }
}

/// What a loop is told of a step.
struct Surroundings<'a> {
    organ: &'a Organ,
    pose: ToolInput,
    tip_radius_m: f64,
    dt_s: f64,
    /// Whether the model moves what is inside, too.
    knows_volumes: bool,
}

impl ToolLoop {
    fn new(size: LigatingLoop) -> Self {
        Self { size, stage: Stage::Open { is_caught: false }, noose: Noose::new(&size), girth_m: 0.0 }
    }

    /// Open and around nothing.
    fn let_go(&mut self) {
        self.stage = Stage::Open { is_caught: false };
        self.noose.clear();
    }

    /// Follows the lever and the tissue. Allocates nothing.
    fn follow(&mut self, around: &Surroundings<'_>, scratch: &mut LoopScratch) {
        let is_open = around.pose.jaw_opening > OPEN_ABOVE;
        if is_open && self.noose.tension_n() == 0.0 && !matches!(self.stage, Stage::Open { .. }) {
            self.let_go();
        }
        match self.stage {
            Stage::Open { is_caught } => self.look(is_caught, is_open, around, scratch),
            Stage::Drawn => {
                let tip_m = Some(around.pose.tip_in_world_m);
                let now_m = self.noose.girth_m(around.organ, tip_m, &mut scratch.noose.way);
                self.draw(around, now_m);
            }
            Stage::Spent => {}
        }
    }

    /// What an open loop is around.
    fn look(
        &mut self,
        was_caught: bool,
        is_open: bool,
        around: &Surroundings<'_>,
        scratch: &mut LoopScratch,
    ) {
        let Surroundings { organ, pose, .. } = around;
        let swerves_m = SWERVES * self.size.diameter_m;
        let ring = self.size.ring(pose);
        let found = scratch.section.look(&ring, 2.0 * swerves_m, organ);
        let was_around = !self.noose.is_empty();
        if found.is_around && !was_caught && found.deep_m <= swerves_m {
            scratch.section.around_into(&mut scratch.around);
            self.noose.go_around(&scratch.around, organ, scratch.section.near());
        } else if is_open || !was_around || !found.has_tissue {
            self.noose.clear();
            let is_caught = found.has_tissue && (was_caught || found.deep_m > swerves_m);
            self.stage = Stage::Open { is_caught };
            return;
        }
        // What it was around is in its thread's way now, or fills it.
        let way = &mut scratch.noose.way;
        let length_m = self.noose.girth_m(organ, Some(pose.tip_in_world_m), way);
        if !is_open && (!found.is_around || length_m >= self.size.length_m(pose.jaw_opening)) {
            self.stage = Stage::Drawn;
            self.girth_m = self.noose.girth_m(organ, None, way);
            self.noose.length_m = length_m;
            self.draw(around, length_m);
        }
    }

    /// The lever says how long the thread may be; the tip of the instrument lies in its way by its own size.
    fn draw(&mut self, around: &Surroundings<'_>, now_m: f64) {
        let least_m = LEAST_GIRTH * self.girth_m;
        let wanted_m = self.size.length_m(around.pose.jaw_opening).max(least_m) + 2.0 * around.tip_radius_m;
        let volume = if around.knows_volumes { self.noose.least_volume(around.organ) } else { 1.0 };
        self.noose.draw(wanted_m, DRAWN_M_PER_S * around.dt_s, (now_m, volume));
    }

    /// Whether it may be tied off.
    fn is_tight(&self, (organ, knows_volumes): (&Organ, bool), way: &mut Way) -> bool {
        let is_strong = self.noose.tension_n() > TIGHT_PULL * self.size.greatest_pull_n;
        let mut is_narrow = || self.noose.girth_m(organ, None, way) < TIGHT_GIRTH * self.girth_m;
        let has_pressed = || knows_volumes && self.noose.is_at_its_limit(organ);
        self.stage == Stage::Drawn && (is_strong || is_narrow() || has_pressed())
    }

    /// Where its thread is, once around.
    fn places_into(&self, organ: &Organ, pose: &ToolInput, out: &mut Vec<DVec3>) {
        match self.stage {
            Stage::Open { .. } => {
                let ring = self.size.ring(pose);
                out.extend((0..=CORNERS).map(|i| ring.point_m(i as f64 / CORNERS as f64)));
            }
            Stage::Drawn => {
                out.extend(self.noose.seen_m(organ.positions_m()));
                let (tip_m, n) = (pose.tip_in_world_m, out.len());
                let detour_m = |i: usize| {
                    let [from_m, to_m] = [out[i], out[(i + 1) % n]];
                    from_m.distance(tip_m) + tip_m.distance(to_m) - from_m.distance(to_m)
                };
                let nearest = (0..n).min_by(|&a, &b| detour_m(a).total_cmp(&detour_m(b)));
                out.rotate_left(nearest.map_or(0, |i| (i + 1) % n));
                out.push(tip_m);
                out.extend_from_within(..1);
            }
            Stage::Spent => {}
        }
    }

    fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        let stage = match self.stage {
            Stage::Open { is_caught } => f64::from(u8::from(is_caught)),
            Stage::Drawn => 2.0,
            Stage::Spent => 3.0,
        };
        self.noose.numbers().chain([stage, self.girth_m])
    }
}

impl Loops {
    /// Those of these instruments.
    pub(super) fn of(tools: &[Tool]) -> Self {
        let of_tools: Vec<_> =
            tools.iter().map(|tool| tool.kind.ligating_loop().copied().map(ToolLoop::new)).collect();
        if of_tools.iter().all(Option::is_none) {
            return Self::default();
        }
        let n_forces = LocalModel::MOST_NODES * (MOST_TIED + MAX_TOOLS);
        Self { of_tools, tied: Vec::new(), next_number: 0, forces: Some(BoundedVec::with_capacity(n_forces)) }
    }

    fn of_tool(&self, tool: usize) -> Option<&ToolLoop> {
        self.of_tools.get(tool)?.as_ref()
    }

    /// Those that are tied off.
    fn tied(&self) -> impl Iterator<Item = &Noose> {
        self.tied.iter().map(|(_, noose)| noose)
    }

    fn nooses(&self) -> impl Iterator<Item = &Noose> {
        self.of_tools.iter().flatten().map(|of_tool| &of_tool.noose).chain(self.tied())
    }

    /// Everything that the next steps depend on.
    pub(super) fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        let of_tools = self.of_tools.iter().flatten().flat_map(ToolLoop::numbers);
        of_tools.chain(self.tied().flat_map(Noose::numbers))
    }

    /// Forces on nodes in the last step, ascending by node.
    pub(super) fn forces(&self) -> &[NodalForce] {
        self.forces.as_ref().map_or(&[], |forces| forces)
    }

    /// Springs for the model, after the forces.
    pub(super) fn springs(&self) -> impl Iterator<Item = &NodalSpring> {
        self.nooses().flat_map(Noose::springs)
    }

    /// Force on an instrument in the last step [N].
    pub(super) fn force_on_tool_n(&self, tool: usize) -> DVec3 {
        self.of_tool(tool).map_or(DVec3::ZERO, |of_tool| of_tool.noose.on_tool_n())
    }

    /// Whether an instrument's loop pulls on tissue.
    pub(super) fn pulls(&self, tool: usize) -> bool {
        self.of_tool(tool).is_some_and(|of_tool| of_tool.noose.tension_n() > 0.0)
    }

    /// Whether an instrument draws its loop around tissue.
    pub(super) fn is_drawn(&self, tool: usize) -> bool {
        self.of_tool(tool).is_some_and(|of_tool| of_tool.stage == Stage::Drawn)
    }

    /// An instrument was put elsewhere.
    pub(super) fn let_go(&mut self, tool: usize) {
        if let Some(of_tool) = self.of_tools.get_mut(tool).and_then(Option::as_mut) {
            of_tool.let_go();
        }
    }

    /// All open, none tied off.
    pub(super) fn reset(&mut self) {
        self.let_all_go();
        self.tied.clear();
        self.gather_forces();
    }

    fn let_all_go(&mut self) {
        self.of_tools.iter_mut().flatten().for_each(ToolLoop::let_go);
    }

    /// After an edit of the tissue: what is left of too few places is around nothing. Allocates nothing.
    pub(super) fn follow_edit(&mut self, topology: &Topology, change: &TopologyChange) {
        let went_elsewhere = |node| went_elsewhere(node, change);
        for of_tool in self.of_tools.iter_mut().flatten() {
            of_tool.noose.follow_edit(topology, went_elsewhere);
            if of_tool.noose.is_empty() && of_tool.stage == Stage::Drawn {
                of_tool.let_go();
            }
        }
        self.tied.iter_mut().for_each(|(_, noose)| noose.follow_edit(topology, went_elsewhere));
        self.tied.retain(|(_, noose)| !noose.is_empty());
        self.gather_forces();
    }

    /// An edit was undone after steps: what had been tied off `before` it is around what it was, and what was since stays as far as
    /// its tissue is there.
    pub(super) fn go_back_to(&mut self, before: &Self, topology: &Topology) {
        self.let_all_go();
        let is_new = |(number, _): &(u32, Noose)| before.tied.iter().all(|(known, _)| known != number);
        let since: Vec<_> = self.tied.drain(..).filter(is_new).collect();
        self.tied.extend(before.tied.iter().cloned().chain(since));
        for (_, noose) in &mut self.tied {
            noose.follow_edit(topology, |_| false);
            noose.forget();
        }
        self.tied.retain(|(_, noose)| !noose.is_empty());
        self.gather_forces();
    }

    fn gather_forces(&mut self) {
        let Some(mut forces) = self.forces.take() else { return };
        forces.clear();
        for share in self.nooses().flat_map(Noose::forces) {
            add_force(&mut forces, *share);
        }
        self.forces = Some(forces);
    }

    /// Adds the threads that a viewer draws; allocates when there are more than before.
    pub(super) fn snapshot_into(
        &self,
        organ: &Organ,
        poses: impl Iterator<Item = ToolInput>,
        threads: &mut Vec<ThreadSnapshot>,
        n_before: usize,
    ) {
        let n = n_before + self.of_tools.iter().flatten().count() + self.tied.len();
        threads.resize_with(n, ThreadSnapshot::default);
        let mut next = threads[n_before..].iter_mut();
        let of_tools = self.of_tools.iter().zip(poses);
        for (of_tool, pose) in of_tools.filter_map(|(of_tool, pose)| Some((of_tool.as_ref()?, pose))) {
            let Some(thread) = next.next() else { return };
            thread.begin(of_tool.noose.radius_m());
            of_tool.places_into(organ, &pose, &mut thread.nodes_m);
        }
        for noose in self.tied() {
            let Some(thread) = next.next() else { return };
            thread.begin(noose.radius_m());
            thread.nodes_m.extend(noose.seen_m(organ.positions_m()));
            thread.nodes_m.extend_from_within(..1);
        }
    }
}

impl World {
    /// Draws the loops, and finds their forces. Allocates nothing.
    pub(super) fn draw_loops(&mut self) {
        let Some(mut scratch) = self.loop_scratch.take() else { return };
        let mut loops = std::mem::take(&mut self.loops);
        let dt_s = self.spec.time_step_s;
        let knows_volumes = self.moves_what_is_inside();
        let hand_n_per_m = self.spec.hand.map(|hand| hand.step_stiffness_n_per_m(dt_s));
        for (place, of_tool) in loops.of_tools.iter_mut().enumerate() {
            let Some(of_tool) = of_tool else { continue };
            let (pose, tool) = (self.tool_states[place].now, &self.spec.tools[place]);
            let tip_radius_m = tool.tip_radius_m;
            let around = Surroundings { organ: &self.organ, pose, tip_radius_m, dt_s, knows_volumes };
            of_tool.follow(&around, &mut scratch);
            if of_tool.stage != Stage::Drawn {
                continue;
            }
            let tip = Tip { place_m: pose.tip_in_world_m, m_per_n: hand_n_per_m.map_or(0.0, f64::recip) };
            self.settle_noose(&mut of_tool.noose, Some(tip), &mut scratch.noose);
            if tip.m_per_n > 0.0 {
                let to_m = pose.tip_in_world_m + of_tool.noose.on_tool_n() * tip.m_per_n;
                self.tool_states[place].put_tip(&self.spec.tools[place], to_m);
            }
        }
        for (_, noose) in &mut loops.tied {
            self.settle_noose(noose, None, &mut scratch.noose);
        }
        loops.gather_forces();
        self.loops = loops;
        self.loop_scratch = Some(scratch);
    }

    fn settle_noose(&mut self, noose: &mut Noose, tip: Option<Tip>, scratch: &mut NooseScratch) {
        noose.gather(&self.organ, &mut scratch.patch);
        self.ask_model(&scratch.patch);
        scratch.patch.learn(&self.patch_tissue(), noose.memory());
        let velocities_m_per_s = self.model.state().velocities_m_per_s;
        noose.settle(&self.organ, velocities_m_per_s, tip, scratch);
    }

    /// Between steps: a loop that is tight and whose instrument's trigger is pressed is tied off. Allocates.
    pub(super) fn tie_off(&mut self, tool: usize) {
        let is_triggered = self.tool_states[tool].now.is_triggered();
        let knows_volumes = self.moves_what_is_inside();
        let Loops { of_tools, tied, next_number, .. } = &mut self.loops;
        let Some(of_tool) = of_tools.get_mut(tool).and_then(Option::as_mut) else { return };
        let Some(LoopScratch { noose: scratch, .. }) = self.loop_scratch.as_deref_mut() else { return };
        let around = (&self.organ, knows_volumes);
        if !(is_triggered && tied.len() < MOST_TIED && of_tool.is_tight(around, &mut scratch.way)) {
            return;
        }
        tied.push((*next_number, of_tool.noose.tied_off(&self.organ, &mut scratch.way)));
        *next_number += 1;
        of_tool.noose.clear();
        of_tool.stage = Stage::Spent;
        self.close_tied_vessels();
    }

    /// Whether the model moves the nodes inside, too.
    fn moves_what_is_inside(&self) -> bool {
        self.model.step_answer() != StepAnswer::Static
    }

    /// Closes the vessels that go through what is tied off, and no others by threads. Allocates.
    pub(super) fn close_tied_vessels(&mut self) {
        let Some(vessels) = self.vessels.as_mut().filter(|_| self.loop_scratch.is_some()) else { return };
        let rest_m = &self.organ.mesh().positions_m;
        let around = self.loops.tied().map(|noose| noose.seen_m(rest_m).collect::<Vec<DVec3>>());
        vessels.tie(around, self.organ.body());
    }

    /// Loops that are tied off.
    pub fn n_tied_loops(&self) -> usize {
        self.loops.tied.len()
    }

    /// Length of the thread of each loop that is tied off, around what it is around as that is now, and around the same at rest [m].
    pub fn tied_girths_m(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        let mut way = Way::new();
        self.loops.tied().map(move |noose| {
            [noose.girth_m(&self.organ, None, &mut way), noose.girth_at_rest_m(&self.organ, &mut way)]
        })
    }

    /// The middle at rest of what each loop is around that is tied off [m].
    pub fn tied_loops_at_rest_m(&self) -> impl Iterator<Item = DVec3> + '_ {
        self.loops.tied().map(|noose| noose.middle_at_rest_m(&self.organ))
    }

    /// Tension of the loop of an instrument [N]; zero where it has none.
    pub fn loop_tension_n(&self, tool: usize) -> f64 {
        self.loops.of_tool(tool).map_or(0.0, |of_tool| of_tool.noose.tension_n())
    }
}
