//! A world with a clock, a session being recorded, and models that are made in the background.

mod guard;
mod keeping;
mod saving;
mod events;
mod scripted;
mod turning;

pub use guard::{Broken, panic_text};
pub use saving::{CannotSave, SavedSimulation};
pub use turning::{ParameterState, Parameters, Turn};

use crate::background::Background;
use crate::incidents::{Incidents, Notice, Notices, Once};
use crate::recorder::Recorder;
use crate::workers::shared_workers;
use anyhow::{Context, anyhow, bail};
use glisson::haptics::HapticModel;
use glisson::math::DVec3;
use glisson::mesh::refine::FineRegion;
use glisson::mesh::{TetId, TetMesh};
use glisson::model::StateHash;
use glisson::model::kind::ModelKind;
use glisson::model::{DeformableModel, LevelOfDetail};
use glisson::record::session::{SessionEvent, SessionHeader};
use glisson::scene::{BodySet, OrganBody, Scene, build_world, joint_mesh_hash};
use glisson::tool::MAX_TOOLS;
use glisson::training::task::{TaskRecord, TaskRun};
use glisson::world::spec::Hand;
use glisson::world::{StageWatch, StepInput, StepReport, World};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Steps between two check-point hashes of a session.
const CHECKPOINT_STEPS: u64 = 500;

/// From the order of a fresh pre-computation to the moment it takes over: several times what it takes on an organ of
/// 6,000 tetrahedra [s] ...
const RECOMPUTATION_S: f64 = 2.0;
/// ... which has so many surface nodes; with more of them it grows with their cube at most (0.3 s at 700, 75 s at 5,000).
const RECOMPUTATION_NODES: f64 = 700.0;

type BuiltModel = anyhow::Result<(Box<dyn DeformableModel>, ModelKind)>;

/// A scene and the folder that its files are relative to.
pub struct OpenScene {
    /// What it says.
    pub scene: Scene,
    /// Folder that its files are relative to.
    pub folder: PathBuf,
    /// Where the text comes from, for messages.
    pub origin: String,
    /// Threads of models that can use several; the bits do not depend on it.
    pub n_threads: usize,
}

impl OpenScene {
    /// Reads a scene file.
    pub fn read(path: &Path) -> anyhow::Result<Self> {
        let text = std::fs::read_to_string(path)
            .with_context(|| format!("{}: cannot read the scene", path.display()))?;
        let scene = Scene::parse(&text).map_err(|e| anyhow!("{}: {e}", path.display()))?;
        let folder = path.parent().map_or_else(|| PathBuf::from("."), Path::to_path_buf);
        Ok(Self { scene, folder, origin: path.display().to_string(), n_threads: 1 })
    }
}

/// A running world: every input goes through here, so that the session holds all of them.
pub struct Simulation {
    world: World,
    bodies: Arc<BodySet>,
    /// As the scene says, when numbers of it were turned.
    bodies_of_scene: Arc<BodySet>,
    hand_of_scene: Option<Hand>,
    turned: Option<turning::Turned>,
    recorder: Option<Recorder>,
    /// Why the session is not recorded any more.
    lost_recording: Option<String>,
    /// It goes on from a moment of a session.
    is_resumed: bool,
    builder: Option<Background<BuiltModel>>,
    incidents: Incidents,
    notices: Notices,
    /// Tools whose cut was refused in the last step.
    refused_last: [bool; MAX_TOOLS],
    /// Whether a fresh pre-computation is ordered when the model asks for one; in a replay the session says so.
    orders_recomputations: bool,
    is_live: bool,
    /// Tetrahedra that tore.
    n_torn: usize,
    /// Why nothing more can be done with the world.
    broken: Option<Broken>,
    /// What instruments follow that nobody has taken into the hand.
    script: Option<scripted::Run>,
    /// What the scene's task asks for.
    task: Option<TaskRun>,
    /// Gravity without what an event of the task adds to it [m/s2], while one does.
    steady_gravity_m_per_s2: Option<DVec3>,
    /// Of the attempt at it that was over when it was last begun anew.
    task_before: Option<Arc<TaskRecord>>,
}

impl Simulation {
    /// Sets a world up from a scene; with `record`, writes the session there.
    #[expect(clippy::needless_pass_by_value, reason = "a scene is opened once")]
    pub fn open(source: OpenScene, record: Option<&Path>) -> anyhow::Result<Self> {
        let workers = shared_workers(source.n_threads)?;
        let (world, bodies) =
            build_world(&source.scene, &source.folder, workers).with_context(|| source.origin.clone())?;
        let task = source.scene.task.as_ref().map(|task| TaskRun::new(task, &world)).transpose();
        let task = task.with_context(|| source.origin.clone())?;
        let recorder = record
            .map(|path| {
                let header = SessionHeader::new(source.scene.text.clone(), joint_mesh_hash(&bodies));
                Recorder::create(path, &source.folder, &header, &[])
            })
            .transpose()?;
        Ok(Self { recorder, ..Self::of(world, Arc::new(bodies), task) })
    }

    /// One at whose beginning nothing was told, turned or ordered.
    fn of(world: World, bodies: Arc<BodySet>, task: Option<TaskRun>) -> Self {
        Self {
            hand_of_scene: world.spec().hand,
            world,
            bodies_of_scene: Arc::clone(&bodies),
            bodies,
            turned: None,
            recorder: None,
            lost_recording: None,
            is_resumed: false,
            builder: None,
            incidents: Incidents::default(),
            notices: Notices::default(),
            refused_last: [false; MAX_TOOLS],
            orders_recomputations: true,
            is_live: true,
            n_torn: 0,
            broken: None,
            script: None,
            task,
            steady_gravity_m_per_s2: None,
            task_before: None,
        }
    }

    /// The scene's task, if it has one.
    pub fn task(&self) -> Option<&TaskRun> {
        self.task.as_ref()
    }

    /// What was written down of the attempt that was over when the task was last begun anew, for who may not have seen its end.
    pub fn task_before(&self) -> Option<&Arc<TaskRecord>> {
        self.task_before.as_ref()
    }

    /// Orders models only when told to: the session that is replayed holds all orders.
    pub(crate) fn leave_orders_to_the_session(&mut self) {
        self.orders_recomputations = false;
        self.is_live = false;
    }

    /// The world as it is now.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// From now on `watch` hears of the end of each stage of each step, for who times them.
    pub fn watch_stages(&mut self, watch: Option<StageWatch>) {
        self.world.watch_stages(watch);
    }

    /// The mesh at the start: the organ's, or that of all bodies.
    pub fn mesh(&self) -> &TetMesh {
        &self.bodies.joint.mesh
    }

    /// What a session names the mesh by.
    pub fn mesh_hash(&self) -> String {
        joint_mesh_hash(&self.bodies)
    }

    /// What models of the organ are made from; of several bodies that of the first organ, with the mesh of all.
    pub fn body(&self) -> &OrganBody {
        &self.bodies.joint
    }

    /// All bodies, with the numbers that hold.
    pub(crate) fn bodies(&self) -> &Arc<BodySet> {
        &self.bodies
    }

    /// One step; first waits for a model that takes over at it.
    ///
    /// # Errors
    /// [`Broken`] when the world cannot go on; when the session cannot be written or an input is not finite.
    pub fn advance(&mut self, input: &StepInput) -> anyhow::Result<StepReport> {
        self.guarded(|simulation| simulation.make_step(input))
    }

    fn make_step(&mut self, input: &StepInput) -> anyhow::Result<StepReport> {
        #[cfg(debug_assertions)]
        guard::break_if_ordered(self.world.steps_made());
        if let Some(kind) = self.world.awaited_model() {
            self.take_delivery(kind)?;
        }
        let impaired = self.impaired(input);
        let input = impaired.as_ref().unwrap_or(input);
        let n_tools = self.world.tools().len();
        let tools = input.tools[..n_tools].to_vec();
        if let Some(tool) = tools.iter().find(|tool| !tool.is_finite()) {
            bail!("the tool's place is not finite: {tool:?}");
        }
        let placed = (0..n_tools).filter(|&tool| input.placed[tool]).map(|tool| tool as u8).collect();
        let (step, n_substeps) = (self.world.steps_made(), input.n_substeps);
        let found = &input.detected[..n_tools];
        let detected = if found.iter().any(Option::is_some) { found.to_vec() } else { Vec::new() };
        self.record(&SessionEvent::Input { step, tools, n_substeps, placed, detected });
        let report = self.world.step(input);
        self.cut_with_tools();
        if report.n_non_finite_nodes > 0 {
            let reason = format!("{} nodes have no finite position", report.n_non_finite_nodes);
            return Err(self.break_off(reason).into());
        }
        if let Some(task) = &mut self.task {
            task.after_step(&self.world);
        }
        self.bring_events_about()?;
        let effort = self.world.effort();
        for notice in self.incidents.of_step(&report, effort) {
            self.notices.tell(notice);
        }
        let is_asked = report.model.wants_recomputation && self.builder.is_none();
        if is_asked && std::mem::take(&mut self.orders_recomputations) {
            let at_step = report.step.saturating_add(self.recomputation_steps());
            self.order_model_now(self.world.model_kind(), at_step)?;
        }
        if report.step.is_multiple_of(CHECKPOINT_STEPS) && self.recorder.is_some() {
            let state_hash = self.world.state_hash();
            self.record(&SessionEvent::Checkpoint { step: report.step, state_hash });
        }
        self.go_on_with_script()?;
        Ok(report)
    }

    /// Why nothing is cut is told when it begins, not in every step in which the trigger is held.
    fn cut_with_tools(&mut self) {
        let mut refuses = [false; MAX_TOOLS];
        let cuts = self.world.cut_with_tools();
        if cuts.n_torn > 0 && self.n_torn == 0 {
            self.tell("tissue tears: an instrument pushes or pulls harder than it bears".to_owned());
        }
        self.n_torn += cuts.n_torn;
        if let Some(refusal) = &cuts.tear_refusal {
            let notice = || format!("tissue is stretched too far and does not tear: {refusal}");
            self.notices.tell_once(Once::TearRefusal, notice);
        }
        for (tool, stroke) in cuts.strokes.iter().filter(|(_, stroke)| stroke.n_merged > 0) {
            let (cut_mm2, swept_mm2) = (1e6 * stroke.cut_area_m2, 1e6 * stroke.swept_area_m2);
            let name = &self.world.tools()[*tool].name;
            self.notices.tell_once(Once::MergedFaces(*tool), || {
                format!(
                    "the {name} opened {cut_mm2:.0} mm2 where its edge swept {swept_mm2:.0} mm2: faces of the cut merged with \
                     others nearby; worst angle of a tetrahedron {:.1} degrees (told once)",
                    stroke.worst_dihedral_deg.unwrap_or(180.0)
                )
            });
        }
        for (tool, refusal) in cuts.refusals {
            if !std::mem::replace(&mut refuses[tool], true) && !self.refused_last[tool] {
                self.tell(format!("the {} cut nothing: {refusal}", self.world.tools()[tool].name));
            }
        }
        self.refused_last = refuses;
    }

    /// Steps until a fresh pre-computation is surely there, on a machine that keeps pace.
    fn recomputation_steps(&self) -> u64 {
        let larger = self.world.organ().surface_nodes().len() as f64 / RECOMPUTATION_NODES;
        let delay_s = RECOMPUTATION_S * larger.powi(3).max(1.0);
        (delay_s / self.world.spec().time_step_s).ceil() as u64
    }

    /// Waits for the model that takes over now. One that cannot be made (its time step is too long, say) is no
    /// reason to stop: the present one goes on, as it does in a replay, and the reason is told.
    fn take_delivery(&mut self, kind: ModelKind) -> anyhow::Result<()> {
        let builder = self.builder.take().with_context(|| format!("nobody makes the {kind} model"))?;
        let made = builder.finish().unwrap_or_else(|panic| Err(anyhow!("{}", panic_text(panic.as_ref()))));
        match made {
            Ok((model, made)) => match self.world.deliver_model(model, made) {
                // The new one may ask in its turn; where none could be made it is not tried again.
                Ok(true) => {
                    self.orders_recomputations = self.is_live;
                    if let Some(turned) = self.turned.take() {
                        self.world.go_on_with_numbers_of(&turned.bodies);
                        self.bodies = turned.bodies;
                    }
                }
                Ok(false) => bail!("the {made} model was made, but the {kind} model was ordered"),
                Err(refusal) => self.refuse_model(kind, &refusal.into()),
            },
            Err(error) => self.refuse_model(kind, &error),
        }
        Ok(())
    }

    fn refuse_model(&mut self, kind: ModelKind, error: &anyhow::Error) {
        self.world.cancel_model_swap();
        let stays = if self.turned.take().is_some() { "; the numbers stay as they were" } else { "" };
        self.tell(format!("the {kind} model cannot take over: {error:#}{stays}"));
    }

    /// Tells what is wrong, or was not done. What was just said is not repeated.
    pub(crate) fn tell(&mut self, text: String) {
        self.notices.tell(Notice { text, is_problem: true });
    }

    /// Tells that there is no such instrument.
    pub(crate) fn refuse_tool(&mut self, tool: usize) {
        let n_tools = self.world.tools().len();
        self.tell(format!("there is no instrument {tool}: the scene has {n_tools}, numbered from 0"));
    }

    /// Tells what is as it should be. What was just said is not repeated.
    pub(crate) fn tell_news(&mut self, text: String) {
        self.notices.tell(Notice { text, is_problem: false });
    }

    /// Tells how fast time passes where no less can be computed; once.
    pub(crate) fn tell_slow_time(&mut self, real_time_factor: f64) {
        self.notices.tell_once(Once::TimeIsSlow, || {
            format!("the simulation is late and cannot compute less: time passes at {real_time_factor:.2} x")
        });
    }

    /// Tetrahedra that tore since the start.
    pub fn n_torn(&self) -> usize {
        self.n_torn
    }

    /// What the user should know: why ordered models could not take over, what went wrong in steps. In order, the newest.
    pub fn notices(&self) -> &[Notice] {
        self.notices.newest()
    }

    /// How many notices there were, with those that are no longer kept.
    pub(crate) fn n_notices(&self) -> usize {
        self.notices.n_told()
    }

    /// What the haptic loop evaluates for an instrument until the next step.
    pub fn haptic_model(&mut self, tool: usize) -> HapticModel {
        // Without a world there is nothing to feel.
        self.guarded(|simulation| Ok(simulation.world.haptic_model(tool))).unwrap_or_default()
    }

    /// Everything back to rest.
    pub fn reset(&mut self) -> anyhow::Result<()> {
        self.guarded(|simulation| {
            simulation.record(&SessionEvent::Reset { step: simulation.world.steps_made() });
            simulation.script = None;
            // The world has its scene's gravity again.
            simulation.steady_gravity_m_per_s2 = None;
            simulation.world.reset();
            if let Some(task) = simulation.task.take() {
                if task.outcome().is_some() {
                    simulation.task_before = Some(Arc::new(task.record()));
                }
                // Where tissue is gone that a goal is about, there is no task any more.
                match task.anew(&simulation.world) {
                    Ok(task) => simulation.task = Some(task),
                    Err(error) => simulation.tell(format!("the task cannot be begun again: {error}")),
                }
            }
            Ok(())
        })
    }

    /// Gravity from now on.
    pub fn set_gravity(&mut self, gravity_m_per_s2: DVec3) -> anyhow::Result<()> {
        self.guarded(|simulation| simulation.set_gravity_or_after_jerk(gravity_m_per_s2))
    }

    /// While an event of the task jerks, from its end on.
    fn set_gravity_or_after_jerk(&mut self, gravity_m_per_s2: DVec3) -> anyhow::Result<()> {
        // A session holds what came of both.
        if self.is_live
            && let Some(steady_m_per_s2) = &mut self.steady_gravity_m_per_s2
        {
            *steady_m_per_s2 = gravity_m_per_s2;
            return Ok(());
        }
        self.set_gravity_now(gravity_m_per_s2)
    }

    /// Gravity without what an event of the task adds to it [m/s2].
    fn gravity_m_per_s2(&self) -> DVec3 {
        self.steady_gravity_m_per_s2.unwrap_or(self.world.gravity_m_per_s2())
    }

    fn set_gravity_now(&mut self, gravity_m_per_s2: DVec3) -> anyhow::Result<()> {
        let step = self.world.steps_made();
        self.record(&SessionEvent::Gravity { step, gravity_m_per_s2 });
        self.world.set_gravity(gravity_m_per_s2);
        Ok(())
    }

    /// How thoroughly steps are computed from now on; answers whether that makes a difference to the present model.
    pub(crate) fn set_level_of_detail(&mut self, effort: LevelOfDetail) -> anyhow::Result<bool> {
        self.guarded(|simulation| {
            simulation.record(&SessionEvent::Effort { step: simulation.world.steps_made(), effort });
            Ok(simulation.world.set_level_of_detail(effort))
        })
    }

    /// Takes tetrahedra out of the organ. A model that cannot follow is no reason to stop: nothing changes, and the
    /// reason is told.
    pub fn remove_tetrahedra(&mut self, tets: Vec<TetId>) -> anyhow::Result<()> {
        self.guarded(|simulation| simulation.remove_tetrahedra_now(tets))
    }

    fn remove_tetrahedra_now(&mut self, tets: Vec<TetId>) -> anyhow::Result<()> {
        self.record(&SessionEvent::Remove { step: self.world.steps_made(), tets: tets.clone() });
        if let Err(refusal) = self.world.remove_and_part(tets) {
            self.tell(format!("nothing was cut: {refusal}"));
        }
        Ok(())
    }

    /// Makes the mesh finer around an instrument's tip; where that cannot be, the reason is told.
    pub fn refine_around(&mut self, tool: usize) -> anyhow::Result<()> {
        self.guarded(|simulation| simulation.refine_around_now(tool))
    }

    fn refine_around_now(&mut self, tool: usize) -> anyhow::Result<()> {
        let n_tools = self.world.tools().len();
        if tool >= n_tools {
            self.refuse_tool(tool);
            return Ok(());
        }
        match self.world.finer_region_at(tool) {
            Some(region) => self.refine(region),
            None => {
                self.tell("nothing was made finer: the instrument's tip is not at the organ".to_owned());
                Ok(())
            }
        }
    }

    /// Makes the mesh finer in a region.
    pub(crate) fn refine(&mut self, region: FineRegion) -> anyhow::Result<()> {
        self.guarded(|simulation| simulation.refine_now(region))
    }

    fn refine_now(&mut self, region: FineRegion) -> anyhow::Result<()> {
        let FineRegion { center_m, radius_m, edge_m } = region;
        self.record(&SessionEvent::Refine { step: self.world.steps_made(), center_m, radius_m, edge_m });
        match self.world.refine(&region) {
            Ok(0) => self.tell("nothing was made finer: the mesh is fine enough here".to_owned()),
            Ok(_) => {}
            Err(refusal) => self.tell(format!("nothing was made finer: {refusal}")),
        }
        Ok(())
    }

    /// Takes the last cut back, if there is one that can be.
    pub fn undo_edit(&mut self) -> anyhow::Result<()> {
        self.guarded(|simulation| simulation.undo_edit_now())
    }

    fn undo_edit_now(&mut self) -> anyhow::Result<()> {
        self.record(&SessionEvent::UndoEdit { step: self.world.steps_made() });
        let ordered = self.world.ordered_model();
        if !self.world.undo_edit() {
            self.tell("there is no cut that could be undone".to_owned());
        } else if self.builder.is_some() && self.world.ordered_model().is_none() {
            self.builder = None;
            self.orders_recomputations = self.is_live;
            // What was turned holds all the same, in a model of the organ as it is now.
            if let (Some(kind), Some(turned)) = (ordered, &self.turned) {
                self.make_in_background(kind, turned.at_step);
            }
        }
        Ok(())
    }

    /// An instrument sets a clip on the vessel nearest to its tip; where there is none, the reason is told.
    pub fn clip_vessel(&mut self, tool: usize) -> anyhow::Result<()> {
        self.guarded(|simulation| simulation.clip_vessel_now(tool))
    }

    fn clip_vessel_now(&mut self, tool: usize) -> anyhow::Result<()> {
        let n_tools = self.world.tools().len();
        if tool >= n_tools {
            self.refuse_tool(tool);
            return Ok(());
        }
        self.record(&SessionEvent::Clip { step: self.world.steps_made(), tool: tool as u8 });
        if !self.world.clip_vessel(tool) {
            let reason = match self.world.vessels() {
                None => "the scene's organ has no vessels",
                Some(_) => "no vessel is within reach of the instrument's tip",
            };
            self.tell(format!("no clip was set: {reason}"));
        }
        Ok(())
    }

    /// Takes out what an instrument's tip touches.
    pub fn cut_at_tip(&mut self, tool: usize) -> anyhow::Result<()> {
        self.guarded(|simulation| simulation.cut_at_tip_now(tool))
    }

    fn cut_at_tip_now(&mut self, tool: usize) -> anyhow::Result<()> {
        let tets = self.world.touched_tetrahedra(tool);
        if tets.is_empty() {
            self.tell("nothing was cut: the instrument's tip does not touch the organ".to_owned());
            return Ok(());
        }
        self.remove_tetrahedra(tets)
    }

    /// Starts making another model; it takes over before step `at_step`, whenever it is ready.
    pub(crate) fn order_model(&mut self, kind: ModelKind, at_step: u64) -> anyhow::Result<()> {
        self.guarded(|simulation| simulation.order_model_now(kind, at_step))
    }

    fn order_model_now(&mut self, kind: ModelKind, at_step: u64) -> anyhow::Result<()> {
        let step = self.world.steps_made();
        let at_step = at_step.max(step);
        self.record(&SessionEvent::QueueModelSwap { step, at_step, model: kind });
        self.make_in_background(kind, at_step);
        Ok(())
    }

    /// Makes a model with the numbers that hold, or were turned and are to hold with it.
    fn make_in_background(&mut self, kind: ModelKind, at_step: u64) {
        self.world.queue_model_swap(at_step, kind);
        let bodies = Arc::clone(self.turned.as_ref().map_or(&self.bodies, |turned| &turned.bodies));
        // Of an organ with new tetrahedra the model is made whole, and follows the edits when it is delivered.
        let mut live = self.world.organ().live_tetrahedra().to_vec();
        if !self.world.has_only_removals() {
            live = vec![true; self.bodies.joint.mesh.tetrahedra.len()];
        }
        self.builder = Some(Background::begin(move || {
            let model = bodies.build_as_cut(kind, &live)?;
            Ok((model, kind))
        }));
    }

    /// Ends the recording, if there is one.
    ///
    /// # Errors
    /// [`Broken`] when it broke off before, and when the session cannot be written.
    pub fn finish(mut self) -> anyhow::Result<StateHash> {
        if let Some(broken) = self.broken {
            return Err(broken.into());
        }
        let state_hash = self.world.state_hash();
        self.record(&SessionEvent::End { step: self.world.steps_made(), state_hash });
        self.finish_recording()?;
        Ok(state_hash)
    }
}

#[cfg(test)]
mod tests;
