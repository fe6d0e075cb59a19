//! One organ or several bodies ([`bodies`]), up to five instruments, and the step that joins them.
//!
//! Stages of a step, in order: hands, contacts and grasps, constraints and loads, model, forces. Cuts are made
//! between steps ([`World::edit`], [`World::cut_with_tools`]). A step never fails, allocates, locks, logs or reads a clock.

mod active;
mod attachments;
pub mod bodies;
mod burn;
mod constrain;
mod contact_points;
mod cut;
pub mod detection;
mod display;
mod edits;
mod grasp;
mod hand;
mod tool_state;
mod haptic;
mod loads;
pub mod loops;
mod node_answer;
mod numbers;
pub mod organ;
mod parts;
mod press;
mod overload;
mod refusal;
pub mod saved;
mod skin;
mod capsule;
mod slide;
pub mod spec;
mod site;
mod clip;
mod stage;
pub mod suture_spec;
pub mod sutures;
mod tear;
mod tissue_patch;
pub mod touch;
mod transaction;
pub mod vessels;

pub use cut::{BladeReport, ToolCuts};
pub use parts::ToolPart;
pub use refusal::EditRefusal;
pub use stage::{StageWatch, StepStage};
pub use tool_state::ToolReport;

use crate::contact::response::bodies::ResponseReport;
use crate::contact::response::persistent::ContactMemory;
use crate::contact::tool_contact::ToolContact;
use crate::math::DVec3;
use crate::mesh::TetMesh;
use crate::model::StateHash;
use crate::model::kind::ModelKind;
use crate::model::{Constraints, DeformableModel, LevelOfDetail, ModelReport, ModelState, NodalForce};
pub use crate::record::session::MOST_SUBSTEPS;
use crate::record::snapshot::{
    BleedingSnapshot, ContactReport, DisplayTopology, Snapshot, ThreadSnapshot, ToolSnapshot,
};
use crate::tool::endoscope::Eye;
use crate::tool::external_detection::ExternalDetection;
use crate::tool::{MAX_TOOLS, Tool, ToolInput};
use active::ActiveTip;
use bodies::SurfaceContact;
use constrain::{MOST_IMPOSED, Owner};
use edits::Journal;
use haptic::HapticScratch;
use loads::Loads;
use loops::{LoopScratch, Loops};
use organ::{Organ, OrganError};
use press::Press;
use slide::SlideScratch;
use spec::WorldSpec;
use std::sync::Arc;
use sutures::Suture;
use tool_state::ToolState;
use touch::HeldContact;
use vessels::{ClipApplier, Vessels};

/// Everything that one step is told from outside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepInput {
    /// Where the tools are at the end of the step, in the scene's order; those beyond the last one do not count.
    pub tools: [ToolInput; MAX_TOOLS],
    /// Equal parts that the time step is divided into, 1 to [`MOST_SUBSTEPS`]. Decided outside, because it may depend on
    /// time that a clock measured.
    pub n_substeps: u32,
    /// Tools that were put there without touching anything between: contacts are let go, the way is not searched.
    pub placed: [bool; MAX_TOOLS],
    /// What was found for each tool outside of this world, on a copy of its surface; for `None`, and on another surface,
    /// the world searches by itself.
    pub detected: [Option<ExternalDetection>; MAX_TOOLS],
}

impl StepInput {
    /// Tools that moved there, in a step that is not divided; the last one stands for all that are not given.
    ///
    /// # Panics
    /// With no tool, or more than [`MAX_TOOLS`].
    pub fn of(tools: &[ToolInput]) -> Self {
        assert!((1..=MAX_TOOLS).contains(&tools.len()), "{} tools", tools.len());
        let tools = std::array::from_fn(|i| tools[i.min(tools.len() - 1)]);
        Self { tools, n_substeps: 1, placed: [false; MAX_TOOLS], detected: [None; MAX_TOOLS] }
    }

    /// The same tools, put there.
    #[must_use]
    pub fn placed(self) -> Self {
        Self { placed: [true; MAX_TOOLS], ..self }
    }

    /// What was found for a tool on the surface of this version, if it makes sense.
    fn detected_on(&self, tool: usize, surface_version: u32) -> Option<&ExternalDetection> {
        let detected = self.detected[tool].as_ref();
        detected.filter(|d| d.surface_version == surface_version && d.is_plausible())
    }

    /// The same in `n_substeps` parts.
    #[must_use]
    pub fn divided(self, n_substeps: u32) -> Self {
        Self { n_substeps, ..self }
    }
}

/// How a step went.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepReport {
    /// Steps made so far.
    pub step: u64,
    /// What each tool felt, in the scene's order.
    pub tools: [ToolReport; MAX_TOOLS],
    /// Whether the step was not made because the model that takes over now has not been delivered.
    pub waits_for_model: bool,
    /// Nodes whose position is not finite, which only a broken model can bring about.
    pub n_non_finite_nodes: u32,
    /// Places at which instruments touched or held something, or might have in the step: what its contacts were solved for.
    pub n_contact_points: u32,
    /// How the organ touched itself, or bodies each other; of several sub-steps the last one.
    pub self_contact: ResponseReport,
    /// What the model says about the step; of several sub-steps the last one, with the internal steps of all.
    pub model: ModelReport,
}

impl StepReport {
    /// Whether any tool touches the organ.
    pub fn in_contact(&self) -> bool {
        self.tools.iter().any(|tool| tool.in_contact)
    }
}

/// A model that takes over at a step fixed when it was ordered.
struct QueuedSwap {
    at_step: u64,
    kind: ModelKind,
    model: Option<Box<dyn DeformableModel>>,
}

/// One organ and its instruments in time.
pub struct World {
    spec: WorldSpec,
    organ: Organ,
    model: Box<dyn DeformableModel>,
    model_kind: ModelKind,
    swap: Option<QueuedSwap>,
    tool_states: Vec<ToolState>,
    active: Vec<ActiveTip>,
    /// Of all steps; no step depends on it.
    blades: BladeReport,
    vessels: Option<Vessels>,
    journal: Journal,
    /// What models that are made later are made from.
    mesh_of_the_start: Arc<TetMesh>,
    /// Whether each of its nodes is supported or at a ligament.
    anchored_at_start: Arc<[bool]>,
    constraints: Constraints,
    /// Whose each imposed displacement is.
    owners: Vec<Owner>,
    /// Scratch of the search for what is between jaws.
    between_jaws: Vec<ToolContact>,
    /// Scratch of what the haptic loop is told; made when it is first asked for.
    haptics: Option<Box<HapticScratch>>,
    /// Scratch of what touched patches answer.
    slide: Box<SlideScratch>,
    /// What touches by force, and with what force it did.
    press: Box<Press>,
    /// How the organ touches itself, or bodies each other, if the scene wants it.
    self_contact: Option<Box<SurfaceContact>>,
    /// Forces between bodies in the rest shape.
    touch_at_start: ContactMemory,
    loads: Loads,
    sutures: Vec<Suture>,
    loops: Loops,
    /// Only where an instrument has a loop.
    loop_scratch: Option<Box<LoopScratch>>,
    gravity_m_per_s2: DVec3,
    /// Gravity and force fields of the last step.
    pull_m_per_s2: DVec3,
    step: u64,
    /// Steps and time [s] up to where the time step was last another one.
    clock_base: (u64, f64),
    /// For who looks on.
    n_resets: u32,
    report: StepReport,
    /// None until somebody chose one.
    effort: Option<LevelOfDetail>,
    stage_watch: Option<StageWatch>,
}

impl World {
    /// A world at rest, the tools at their homes.
    ///
    /// # Errors
    /// [`OrganError`] when the mesh is not a body with a surface, the model is of another mesh, and when there is no tool or
    /// too many.
    pub fn new(
        spec: WorldSpec,
        mesh: TetMesh,
        model: Box<dyn DeformableModel>,
        kind: ModelKind,
    ) -> Result<Self, OrganError> {
        if !(1..=MAX_TOOLS).contains(&spec.tools.len()) {
            return Err(OrganError::Tools { n_tools: spec.tools.len() });
        }
        let (n_nodes, expected) = (model.state().positions_m.len(), mesh.positions_m.len());
        if n_nodes != expected {
            return Err(OrganError::Model { n_nodes, expected });
        }
        let mesh_of_the_start = Arc::new(mesh.clone());
        let anchored_at_start = spec.anchored_nodes(&mesh.positions_m).into();
        let body_of = spec.body_of_nodes(mesh.positions_m.len());
        let fixed = spec.fixed_nodes(&mesh.positions_m);
        let mut organ = Organ::new(mesh, &fixed, body_of)?;
        if spec.hand.is_some() {
            organ.learn_node_answers(|body| spec.tissue_of(body));
        }
        let mut vessels = None;
        if !spec.vessels.is_empty() {
            let found = Vessels::new(spec.vessels.clone(), organ.body());
            vessels = Some(found.map_err(|(number, error)| OrganError::Vessel { number, error })?);
        }
        let of_suture = |suture| Suture::new(suture, &organ);
        let sutures: Vec<Suture> = spec.sutures.iter().map(of_suture).collect::<Result<_, _>>()?;
        let loads = Loads::new(&spec, &organ);
        let (loops, loop_scratch) = (Loops::of(&spec.tools), LoopScratch::of(&spec.tools));
        let slide = Box::new(SlideScratch::for_nodes(organ.mesh().positions_m.len()));
        let self_contact = SurfaceContact::of(&spec, &organ, model.as_ref());
        let hands = spec.tools.iter().map(ToolState::at_home).collect();
        let active = spec.tools.iter().map(|tool| ActiveTip::new(tool, organ.body())).collect();
        let mut constraints = Constraints::default();
        constraints.displacements.reserve(MOST_IMPOSED);
        constraints.forces.reserve(organ.mesh().positions_m.len());
        let gravity_m_per_s2 = spec.gravity_m_per_s2;
        let mut world = Self {
            spec,
            organ,
            model,
            model_kind: kind,
            swap: None,
            tool_states: hands,
            active,
            blades: BladeReport::default(),
            vessels,
            journal: Journal::new(),
            mesh_of_the_start,
            anchored_at_start,
            constraints,
            owners: Vec::with_capacity(MOST_IMPOSED),
            between_jaws: grasp::room_for_search(),
            haptics: None,
            slide,
            press: Box::new(Press::new()),
            self_contact,
            touch_at_start: ContactMemory::default(),
            loads,
            sutures,
            loops,
            loop_scratch,
            gravity_m_per_s2,
            pull_m_per_s2: gravity_m_per_s2,
            step: 0,
            clock_base: (0, 0.0),
            n_resets: 0,
            report: StepReport::default(),
            effort: None,
            stage_watch: None,
        };
        world.hold_threads_at_start();
        Ok(world)
    }

    /// What the world was made from.
    pub fn spec(&self) -> &WorldSpec {
        &self.spec
    }

    /// The organ's mesh, surface and supports.
    pub fn organ(&self) -> &Organ {
        &self.organ
    }

    /// Which model moves the organ now.
    pub fn model_kind(&self) -> ModelKind {
        self.model_kind
    }

    /// A copy of the model as it is now.
    pub fn copy_of_model(&self) -> Box<dyn DeformableModel> {
        self.model.duplicate()
    }

    /// The model's state.
    pub fn state(&self) -> ModelState<'_> {
        self.model.state()
    }

    /// What else of the model its next step depends on ([`DeformableModel::history_into`]).
    pub fn history(&self) -> Vec<f64> {
        self.model.history()
    }

    /// Hash of everything that the next step depends on but the input: the model's state, live tetrahedra, contacts
    /// and grasps, gravity, the loads' clock, blood lost, severed and clipped vessels. A model that was ordered counts from its first step on.
    /// When the next step finds the places inside which zones of a hybrid follows from the steps since the start and is not in it.
    pub fn state_hash(&self) -> StateHash {
        let gravity = self.gravity_m_per_s2.to_array();
        let active = self.active.iter().flat_map(ActiveTip::numbers);
        let hands = self.tool_states.iter().flat_map(ToolState::numbers).chain(active);
        let vessels = self.vessels.iter().flat_map(Vessels::numbers);
        let clock = self.loads.clock(self.step);
        let pressed = self.press.numbers();
        let between = self.self_contact.iter().flat_map(|contact| contact.numbers());
        let surroundings = gravity.into_iter().chain(clock).chain(hands).chain(vessels).chain(pressed);
        let surroundings = surroundings.chain(between).chain(self.sutures.iter().flat_map(Suture::numbers));
        let surroundings = surroundings.chain(self.loops.numbers());
        let surroundings: Vec<f64> = surroundings.collect();
        StateHash::of_model(self.model.as_ref(), self.organ.live_tetrahedra(), &surroundings)
    }

    /// Steps made so far.
    pub fn steps_made(&self) -> u64 {
        self.step
    }

    /// How the last step went.
    pub fn report(&self) -> &StepReport {
        &self.report
    }

    /// Orders another model: it takes over before step `at_step` (index from 0, not before the next one), and
    /// that step waits until [`World::deliver_model`] brought it. An order that was not carried out is replaced.
    pub fn queue_model_swap(&mut self, at_step: u64, kind: ModelKind) {
        self.journal.forget_waiting();
        self.swap = Some(QueuedSwap { at_step: at_step.max(self.step), kind, model: None });
    }

    /// Brings the ordered model, made from the organ as it was at the start: it follows the edits so far.
    /// Answers whether it was ordered; if not, `model` is dropped.
    ///
    /// # Errors
    /// [`EditRefusal`] when the model cannot follow them; it is still awaited then.
    pub fn deliver_model(
        &mut self,
        mut model: Box<dyn DeformableModel>,
        kind: ModelKind,
    ) -> Result<bool, EditRefusal> {
        if self.swap.as_ref().is_none_or(|swap| swap.kind != kind) {
            return Ok(false);
        }
        self.bring_up_to_date(model.as_mut())?;
        if let Some(swap) = &mut self.swap {
            // What was saved of one that was delivered before is not this one's.
            self.journal.forget_waiting();
            swap.model = Some(model);
        }
        Ok(true)
    }

    /// Takes an order back: the model could not be made, and the present one goes on.
    pub fn cancel_model_swap(&mut self) {
        self.journal.forget_waiting();
        self.swap = None;
    }

    /// The model that was ordered and has not taken over.
    pub fn ordered_model(&self) -> Option<ModelKind> {
        self.swap.as_ref().map(|swap| swap.kind)
    }

    /// The model that the next step waits for, if it has not been delivered.
    pub fn awaited_model(&self) -> Option<ModelKind> {
        self.swap.as_ref().filter(|s| s.at_step <= self.step && s.model.is_none()).map(|s| s.kind)
    }

    /// Everything back to rest; the count of steps and the model stay.
    pub fn reset(&mut self) {
        self.n_resets += 1;
        for (hand, tool) in self.tool_states.iter_mut().zip(&self.spec.tools) {
            *hand = ToolState::at_home(tool);
        }
        self.active.iter_mut().for_each(ActiveTip::lift);
        self.owners.clear();
        self.press.forget();
        if let Some(contact) = &mut self.self_contact {
            contact.forget();
            contact.go_on_with(&self.touch_at_start);
        }
        self.constraints.displacements.clear();
        self.constraints.forces.clear();
        self.model.apply(&self.constraints);
        self.model.take_over(&self.organ.mesh().positions_m);
        self.organ.rest_at(self.model.state().positions_m);
        self.gravity_m_per_s2 = self.spec.gravity_m_per_s2;
        self.pull_m_per_s2 = self.gravity_m_per_s2;
        self.model.set_gravity(self.pull_m_per_s2);
        self.loads.restart(self.step);
        self.lay_threads_anew();
        self.loops.reset();
        self.close_tied_vessels();
        self.report = StepReport { step: self.step, ..StepReport::default() };
    }

    /// Gravity from the next step on [m/s2]: the table is tilted.
    pub fn set_gravity(&mut self, gravity_m_per_s2: DVec3) {
        if gravity_m_per_s2.is_finite() {
            self.gravity_m_per_s2 = gravity_m_per_s2;
        }
    }

    /// Gravity now [m/s2], without the scene's force fields.
    pub fn gravity_m_per_s2(&self) -> DVec3 {
        self.gravity_m_per_s2
    }

    /// How thoroughly steps are computed from the next one on, also by models that take over later; answers whether that
    /// makes a difference to the present one.
    pub fn set_level_of_detail(&mut self, effort: LevelOfDetail) -> bool {
        self.effort = Some(effort);
        self.keep_level_of_detail()
    }

    /// How thoroughly steps are computed.
    pub fn effort(&self) -> LevelOfDetail {
        self.effort.unwrap_or_default()
    }

    fn keep_level_of_detail(&mut self) -> bool {
        self.effort.is_some_and(|effort| self.model.set_level_of_detail(effort))
    }

    /// One step of the scene's time step.
    pub fn step(&mut self, input: &StepInput) -> StepReport {
        self.report = StepReport { step: self.step, ..StepReport::default() };
        if !self.take_over_queued_model() {
            self.report.waits_for_model = true;
            return self.report;
        }
        self.move_hands(input);
        self.end_stage(StepStage::Hands);
        let n_substeps = input.n_substeps.clamp(1, MOST_SUBSTEPS);
        self.constrain(n_substeps);
        self.end_stage(StepStage::Touch);
        self.move_organ(n_substeps);
        self.end_stage(StepStage::Organ);
        self.read_forces();
        self.end_stage(StepStage::Forces);
        if let Some(vessels) = &mut self.vessels {
            vessels.advance(self.spec.time_step_s);
        }
        self.step += 1;
        self.report.step = self.step;
        for (report, hand) in self.report.tools.iter_mut().zip(&self.tool_states) {
            *report = hand.report;
        }
        self.report
    }

    /// Answers whether the step can be made.
    fn take_over_queued_model(&mut self) -> bool {
        if self.awaited_model().is_some() {
            return false;
        }
        if let Some(swap) = self.swap.take_if(|s| s.at_step <= self.step)
            && let Some(mut model) = swap.model
        {
            self.model.bring_up_to_date();
            model.take_over_in_motion(&self.model.state(), self.model.clocks_s());
            model.set_gravity(self.pull_m_per_s2);
            self.model = model;
            self.keep_level_of_detail();
            self.model_kind = swap.kind;
            // What was saved belongs to the model before.
            self.journal.forget_undo();
        }
        true
    }

    fn move_organ(&mut self, n_substeps: u32) {
        let dt_s = self.spec.time_step_s / f64::from(n_substeps);
        let mut n_parts = 0;
        for part in 0..n_substeps {
            if part > 0 {
                self.push_self_contacts(n_substeps);
            }
            self.model.step(dt_s);
            if let Some(self_contact) = &mut self.self_contact {
                self_contact.respond_to_step(self.model.as_mut(), dt_s);
                self.report.self_contact = self_contact.report();
            }
            n_parts += self.model.report().n_parts;
        }
        self.report.model = ModelReport { n_parts, ..self.model.report() };
        let positions_m = self.model.state().positions_m;
        self.report.n_non_finite_nodes = positions_m.iter().filter(|p| !p.is_finite()).count() as u32;
        self.organ.follow(positions_m);
    }

    /// The organ's displayed surface.
    pub fn display_topology(&self) -> DisplayTopology {
        self.organ.display_topology()
    }

    /// The displayed state now.
    pub fn snapshot(&self) -> Snapshot {
        let (positions_m, tools) = (Vec::new(), Vec::new());
        let bleeding = BleedingSnapshot::default();
        let mut snapshot = Snapshot {
            step: 0,
            time_s: 0.0,
            topology_version: 0,
            positions_m,
            tools,
            bleeding,
            threads: Vec::new(),
            strands_m: Vec::new(),
            n_resets: 0,
        };
        self.snapshot_into(&mut snapshot);
        snapshot
    }

    /// Writes the displayed state now into `snapshot`.
    pub fn snapshot_into(&self, snapshot: &mut Snapshot) {
        snapshot.step = self.step;
        snapshot.time_s = self.time_s();
        snapshot.topology_version = self.organ.topology_version();
        let positions_m = self.organ.positions_m();
        snapshot.positions_m.clear();
        snapshot.positions_m.extend(self.organ.surface_nodes().iter().map(|n| positions_m[n.index()]));
        snapshot.tools.clear();
        snapshot.tools.extend(self.tool_states.iter().enumerate().map(|(place, hand)| {
            ToolSnapshot {
                pose: hand.now,
                shown_further_out_m: self.further_out_m(place),
                force_n: hand.report.force_on_tool_n,
                contacts: hand
                    .contacts
                    .each_ref()
                    .map(|contact| contact.as_ref().map(|c| contact_report(c, positions_m))),
                n_held_nodes: hand.report.n_held_nodes,
            }
        }));
        snapshot.threads.resize_with(snapshot.threads.len().max(self.sutures.len()), ThreadSnapshot::default);
        for ((suture, spec), thread) in self.sutures.iter().zip(&self.spec.sutures).zip(&mut snapshot.threads)
        {
            suture.snapshot_into(spec, thread);
        }
        let poses = self.tool_states.iter().map(|hand| hand.now);
        self.loops.snapshot_into(&self.organ, poses, &mut snapshot.threads, self.sutures.len());
        snapshot.n_resets = self.n_resets;
        snapshot.strands_m.clear();
        snapshot.strands_m.extend(self.strands_m().map(|(_, ends_m)| ends_m));
        match &self.vessels {
            None => snapshot.bleeding.has_vessels = false,
            Some(vessels) => {
                vessels.bleeding_into(self.organ.body(), positions_m, &mut snapshot.bleeding);
            }
        }
    }

    /// The vessels, if the organ has some.
    pub fn vessels(&self) -> Option<&Vessels> {
        self.vessels.as_ref()
    }

    /// Volume at rest of what was taken out of the organ so far [m3].
    pub fn removed_volume_m3(&self) -> f64 {
        (self.mesh_of_the_start.volume_m3() - self.organ.body().volume_m3()).max(0.0)
    }

    /// How far out of the organ a tool is on the mesh, from where it is [m]: by what the mesh is too coarse for. What it does to the
    /// mesh, as to cut and to grasp, it does from there.
    fn further_out_m(&self, tool: usize) -> DVec3 {
        let hand = &self.tool_states[tool];
        let held = hand.grasp.as_ref().map(|grasp| grasp.further_out_m(&hand.now));
        held.unwrap_or_else(|| self.press.tip_further_out_m(tool))
    }

    /// A tool's pose on the mesh.
    fn pose_on_mesh(&self, tool: usize) -> ToolInput {
        self.tool_states[tool].now.moved_by(self.further_out_m(tool))
    }

    /// Sets a clip on the vessel nearest to the tip of a tool, if one is within its reach; answers whether one was.
    pub fn clip_vessel(&mut self, tool: usize) -> bool {
        let Some((hand, spec)) = self.tool_states.get(tool).zip(self.spec.tools.get(tool)) else {
            return false;
        };
        let tip_m = hand.now.tip_in_world_m + self.further_out_m(tool);
        let reach_m = spec.tip_radius_m + spec.kind.jaws().map_or(0.0, |jaws| jaws.length_m);
        let applier = ClipApplier { tip_m, shaft: hand.now.shaft_in_world, reach_m };
        let positions_m = self.model.state().positions_m;
        let Some(vessels) = &mut self.vessels else { return false };
        vessels.clip(&applier, self.organ.body(), positions_m)
    }

    /// Tears the vessel that is nearest to a place at rest, there; answers whether blood came of it.
    pub fn tear_vessel(&mut self, near_m: DVec3) -> bool {
        self.vessels.as_mut().is_some_and(|vessels| vessels.tear(near_m, self.organ.body()))
    }

    /// Forces of the scene's loads on nodes in the last step, ascending by node; none between an edit and the next step.
    pub fn load_forces(&self) -> &[NodalForce] {
        self.loads.forces()
    }

    /// Forces of instruments on nodes in the last step, ascending by node; empty where hands impose their motion.
    pub fn touch_forces(&self) -> &[NodalForce] {
        self.press.forces()
    }

    /// Where an instrument is.
    pub fn tool_pose(&self, tool: usize) -> ToolInput {
        self.tool_states[tool].now
    }

    /// Where an endoscope looks from and to; none for other instruments.
    pub fn eye(&self, tool: usize) -> Option<Eye> {
        let optics = self.spec.tools[tool].kind.optics()?;
        Some(Eye::of(&self.tool_states[tool].now, optics))
    }

    /// Where the tissue that the tip of an instrument, or its first jaw, touches was at rest [m].
    pub fn touched_at_rest_m(&self, tool: usize) -> Option<DVec3> {
        let contact = self.tool_states[tool].contacts[ToolPart::Tip.index()].as_ref()?;
        Some(contact.point_m(&self.organ.mesh().positions_m))
    }

    /// The instruments.
    pub fn tools(&self) -> &[Tool] {
        &self.spec.tools
    }
}

fn contact_report(contact: &HeldContact, positions_m: &[DVec3]) -> ContactReport {
    ContactReport {
        point_m: contact.point_m(positions_m),
        normal: contact.normal(),
        nodes: contact.nodes(),
        weights: contact.weights(),
    }
}

#[cfg(test)]
mod tests;
