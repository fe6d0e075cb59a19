//! One organ, one instrument, and the step that joins them.
//!
//! Stages of a step, in order: contacts, constraints and loads, model, report. Cuts are made
//! between steps ([`World::edit`]). A step never fails, allocates, locks, logs or reads a clock.

mod cut;
mod loads;
pub mod organ;
pub mod saved;
pub mod spec;
pub mod touch;

use crate::contact::sphere::{BallPath, SurfaceView};
use crate::math::DVec3;
use crate::mesh::TetMesh;
use crate::mesh::edit::{EditError, EditableMesh, MeshEdit, TopologyChange};
use crate::mesh::topology::TopologyError;
use crate::model::kind::ModelKind;
use crate::model::{
    Constraints, DeformableModel, ImposedDisplacement, ModelReport, ModelState, TopologyRefusal,
};
use crate::record::hash::StateHash;
use crate::record::snapshot::{ContactReport, DisplayTopology, Snapshot};
use crate::tool::ToolInput;
use loads::Loads;
use organ::{Organ, OrganError};
use spec::WorldSpec;
use touch::HeldContact;

/// Everything that one step is told from outside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepInput {
    /// Where the tool is at the end of the step.
    pub tool: ToolInput,
    /// Equal parts that the time step is divided into; at least 1. Decided outside, because it may depend on
    /// time that a clock measured.
    pub n_substeps: u32,
    /// The tool was put there without touching anything between: a contact is let go, the way is not searched.
    pub placed: bool,
}

/// How a step went.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepReport {
    /// Steps made so far.
    pub step: u64,
    /// Force that the organ exerts on the tool [N].
    pub force_on_tool_n: DVec3,
    /// Whether the tool touches the organ.
    pub in_contact: bool,
    /// Whether the tool stands on tissue that is held fixed, which cannot give way.
    pub blocked_by_fixed_tissue: bool,
    /// Whether the input was not finite; the tool then stayed where it was.
    pub input_rejected: bool,
    /// Whether the step was not made because the model that takes over now has not been delivered.
    pub waits_for_model: bool,
    /// Nodes whose position is not finite, which only a broken model can bring about.
    pub n_non_finite_nodes: u32,
    /// What the model says about the step; of several sub-steps the last one, with the internal steps of all.
    pub model: ModelReport,
}

/// Why an edit of the organ was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EditRefusal {
    /// The model cannot follow.
    #[error(transparent)]
    Model(#[from] TopologyRefusal),
    /// The mesh cannot be edited so.
    #[error(transparent)]
    Mesh(#[from] EditError),
    /// The mesh is no mesh.
    #[error(transparent)]
    Topology(#[from] TopologyError),
}

/// A model that takes over at a step fixed when it was ordered.
struct QueuedSwap {
    at_step: u64,
    kind: ModelKind,
    model: Option<Box<dyn DeformableModel>>,
}

/// One organ and one instrument in time.
pub struct World {
    spec: WorldSpec,
    organ: Organ,
    model: Box<dyn DeformableModel>,
    model_kind: ModelKind,
    swap: Option<QueuedSwap>,
    tool: ToolInput,
    contact: Option<HeldContact>,
    constraints: Constraints,
    loads: Loads,
    gravity_m_per_s2: DVec3,
    /// Gravity and force fields of the last step.
    pull_m_per_s2: DVec3,
    step: u64,
    report: StepReport,
}

impl World {
    /// A world at rest, the tool at its home.
    ///
    /// # Errors
    /// [`OrganError`] when the mesh is not a body with a surface.
    pub fn new(
        spec: WorldSpec,
        mesh: TetMesh,
        model: Box<dyn DeformableModel>,
        kind: ModelKind,
    ) -> Result<Self, OrganError> {
        let organ = Organ::new(mesh, &spec.supports)?;
        let loads = Loads::new(&spec, &organ);
        let tool = spec.tool.home;
        let mut constraints = Constraints::default();
        constraints.displacements.reserve(3);
        constraints.forces.reserve(organ.mesh().positions_m.len());
        let gravity_m_per_s2 = spec.gravity_m_per_s2;
        Ok(Self {
            spec,
            organ,
            model,
            model_kind: kind,
            swap: None,
            tool,
            contact: None,
            constraints,
            loads,
            gravity_m_per_s2,
            pull_m_per_s2: gravity_m_per_s2,
            step: 0,
            report: StepReport::default(),
        })
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

    /// The model's state.
    pub fn state(&self) -> ModelState<'_> {
        self.model.state()
    }

    /// Hash of everything that the next step depends on but the input: the model's state, live tetrahedra, the held
    /// contact, gravity, the loads' clock. A model that was ordered counts from its first step on.
    pub fn state_hash(&self) -> StateHash {
        let gravity = self.gravity_m_per_s2.to_array();
        let contact = self.contact.iter().flat_map(HeldContact::numbers);
        let surroundings: Vec<f64> =
            gravity.into_iter().chain(self.loads.clock(self.step)).chain(contact).collect();
        StateHash::of(&self.model.state(), self.organ.live_tetrahedra(), &surroundings)
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
        self.swap = Some(QueuedSwap { at_step: at_step.max(self.step), kind, model: None });
    }

    /// Brings the ordered model, made from the organ as it was at the start: it follows the removals so far.
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
        let tets = self.organ.removed_tetrahedra();
        if !tets.is_empty() {
            if let Some(refusal) = model.topology_refusal() {
                return Err(refusal.into());
            }
            let mut whole = EditableMesh::new(self.organ.mesh().clone())?;
            let change = whole.apply(&MeshEdit::Remove { tets })?;
            model.topology_changed(whole.mesh(), &change)?;
        }
        if let Some(swap) = &mut self.swap {
            swap.model = Some(model);
        }
        Ok(true)
    }

    /// Takes an order back: the model could not be made, and the present one goes on.
    pub fn cancel_model_swap(&mut self) {
        self.swap = None;
    }

    /// The model that the next step waits for, if it has not been delivered.
    pub fn awaited_model(&self) -> Option<ModelKind> {
        self.swap.as_ref().filter(|s| s.at_step <= self.step && s.model.is_none()).map(|s| s.kind)
    }

    /// Everything back to rest; the count of steps and the model stay.
    pub fn reset(&mut self) {
        self.contact = None;
        self.tool = self.spec.tool.home;
        self.constraints.displacements.clear();
        self.constraints.forces.clear();
        self.model.apply(&self.constraints);
        self.model.take_over(&self.organ.mesh().positions_m);
        self.organ.follow(self.model.state().positions_m);
        self.gravity_m_per_s2 = self.spec.gravity_m_per_s2;
        self.pull_m_per_s2 = self.gravity_m_per_s2;
        self.model.set_gravity(self.pull_m_per_s2);
        self.loads.restart(self.step);
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

    /// Edits the organ's mesh: the model, the supports and the surface follow. A contact is let go.
    ///
    /// # Errors
    /// [`EditRefusal`] when the model or the mesh cannot; nothing changed then but that a contact is let go. (A removal that
    /// a model cannot follow because memory is short leaves the organ cut.)
    pub fn edit(&mut self, edit: &MeshEdit) -> Result<TopologyChange, EditRefusal> {
        if let Some(refusal) = self.model.topology_refusal() {
            return Err(refusal.into());
        }
        let waiting = self.swap.as_ref().and_then(|swap| swap.model.as_ref());
        if let Some(refusal) = waiting.and_then(|model| model.topology_refusal()) {
            return Err(refusal.into());
        }
        // Every model follows removals but for want of memory; of other edits the model is asked with the edit made.
        let before = (!matches!(edit, MeshEdit::Remove { .. })).then(|| self.organ.clone());
        let change = self.organ.edit(edit, self.model.state().positions_m)?;
        if let Err(refusal) = self.model.topology_changed(self.organ.mesh(), &change) {
            if let Some(before) = before {
                self.organ = before;
            }
            self.contact = None;
            return Err(refusal.into());
        }
        if let Some(waiting) = self.swap.as_mut().and_then(|swap| swap.model.as_mut())
            && waiting.topology_changed(self.organ.mesh(), &change).is_err()
        {
            // The present model has followed: it goes on.
            self.swap = None;
        }
        self.loads.follow(&change);
        self.contact = None;
        Ok(change)
    }

    /// One step of the scene's time step.
    pub fn step(&mut self, input: &StepInput) -> StepReport {
        self.report = StepReport { step: self.step, ..StepReport::default() };
        if !self.take_over_queued_model() {
            self.report.waits_for_model = true;
            return self.report;
        }
        let mut from_m = self.tool.tip_in_world_m;
        self.report.input_rejected = !input.tool.is_finite();
        if !self.report.input_rejected {
            self.tool = input.tool;
        }
        if input.placed {
            self.contact = None;
            from_m = self.tool.tip_in_world_m;
        }
        self.find_contact(from_m);
        self.constrain();
        self.move_organ(input.n_substeps.max(1));
        self.read_force();
        self.step += 1;
        self.report.step = self.step;
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
            model.take_over_in_motion(&self.model.state());
            model.set_gravity(self.pull_m_per_s2);
            self.model = model;
            self.model_kind = swap.kind;
        }
        true
    }

    fn find_contact(&mut self, from_m: DVec3) {
        if self.contact.is_some() {
            return;
        }
        let path = BallPath { from_m, to_m: self.tool.tip_in_world_m, radius_m: self.spec.tool.tip_radius_m };
        let Some(touch) = self.surface_view().first_touch(&path) else { return };
        self.contact = HeldContact::begin(&touch, &self.organ, self.model.state().positions_m);
        self.report.blocked_by_fixed_tissue = self.contact.is_none();
    }

    fn constrain(&mut self) {
        self.constraints.displacements.clear();
        if let Some(contact) = &self.contact {
            contact.add_constraints(self.tool.tip_in_world_m, &mut self.constraints.displacements);
        }
        self.constraints.forces.clear();
        self.constraints.forces.extend_from_slice(self.loads.forces_in_step(self.step));
        self.model.apply(&self.constraints);
        let fields_m_per_s2 = self.loads.acceleration_in_step_m_per_s2(self.step);
        let pull_m_per_s2 = self.gravity_m_per_s2 + fields_m_per_s2;
        if pull_m_per_s2 != self.pull_m_per_s2 {
            self.pull_m_per_s2 = pull_m_per_s2;
            self.model.set_gravity(pull_m_per_s2);
        }
    }

    fn move_organ(&mut self, n_substeps: u32) {
        let dt_s = self.spec.time_step_s / f64::from(n_substeps);
        let mut n_parts = 0;
        for _ in 0..n_substeps {
            self.model.step(dt_s);
            n_parts += self.model.report().n_parts;
        }
        self.report.model = ModelReport { n_parts, ..self.model.report() };
        let positions_m = self.model.state().positions_m;
        self.report.n_non_finite_nodes = positions_m.iter().filter(|p| !p.is_finite()).count() as u32;
        self.organ.follow(positions_m);
    }

    fn read_force(&mut self) {
        let Some(contact) = &self.contact else { return };
        let force_on_organ_n: DVec3 = self.model.constraint_forces_n().iter().sum();
        // A force that is no number, which only a broken model can bring about, is none.
        let is_broken = !force_on_organ_n.is_finite();
        if is_broken || contact.lets_go(self.tool.tip_in_world_m, force_on_organ_n) {
            self.contact = None;
        } else {
            self.report.in_contact = true;
            self.report.force_on_tool_n = -force_on_organ_n;
        }
    }

    fn surface_view(&self) -> SurfaceView<'_> {
        self.organ.surface_view()
    }

    /// The constraints of the last step.
    pub fn constrained_nodes(&self) -> &[ImposedDisplacement] {
        &self.constraints.displacements
    }

    /// The organ's displayed surface.
    pub fn display_topology(&self) -> DisplayTopology {
        self.organ.display_topology()
    }

    /// The displayed state now.
    pub fn snapshot(&self) -> Snapshot {
        let mut snapshot = Snapshot {
            step: 0,
            time_s: 0.0,
            topology_version: 0,
            positions_m: Vec::new(),
            tool: self.tool,
            force_on_tool_n: DVec3::ZERO,
            contact: None,
        };
        self.snapshot_into(&mut snapshot);
        snapshot
    }

    /// Writes the displayed state now into `snapshot`.
    pub fn snapshot_into(&self, snapshot: &mut Snapshot) {
        snapshot.step = self.step;
        snapshot.time_s = self.step as f64 * self.spec.time_step_s;
        snapshot.topology_version = self.organ.topology_version();
        snapshot.positions_m.clear();
        snapshot.positions_m.extend_from_slice(self.organ.surface_positions_m());
        snapshot.tool = self.tool;
        snapshot.force_on_tool_n = self.report.force_on_tool_n;
        snapshot.contact = self.contact.as_ref().map(|contact| ContactReport {
            point_m: contact.point_m(self.model.state().positions_m),
            normal: contact.normal(),
            nodes: contact.nodes(),
            weights: contact.weights(),
        });
    }
}

#[cfg(test)]
mod tests;
