//! Explicit dynamics as a [`DeformableModel`]: written once, for every model that brings its own forces.
//!
//! A model of this kind is two things. A [`Mover`] holds the nodes: masses, supports, loads, the tool's hold, positions
//! and velocities. The model itself ([`ExplicitDynamics`]) brings the elastic forces of a step, the tangent of its
//! elements for local models ([`LocalBody`]), and how it follows an edit of the mesh.

use crate::model::local_model::{self, LocalBody};
use crate::model::{
    Constraints, Correction, DeformableModel, LevelOfDetail, LocalModel, LocalWork, ModelReport, ModelState,
    ModelUndo, NodalForce, StepAnswer, TopologyRefusal,
};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::{NodeId, TetMesh};

/// The nodes of one body in explicit dynamics: what holds and loads them, and where they are.
///
/// Each method means what the method of that name in [`DeformableModel`] does.
pub(in crate::model) trait Mover {
    /// Takes over the constraints that hold from the next step on.
    fn apply(&mut self, constraints: &Constraints);

    /// Positions and velocities after the last step.
    fn state(&self) -> ModelState<'_>;

    /// Appends the further numbers that the next step depends on.
    fn history_into(&self, numbers: &mut Vec<f64>);

    /// Force [N] that the constraint exerts on each held node.
    fn constraint_forces_n(&self) -> &[DVec3];

    /// Starts from these node positions [m] with velocities zero.
    fn take_over(&mut self, positions_m: &[DVec3]);

    /// Gravity from the next step on [m/s2].
    fn set_gravity(&mut self, gravity_m_per_s2: DVec3);

    /// How the last step went.
    fn report(&self) -> ModelReport;

    /// Displacement of a node for a unit force along each axis in a step of `dt_s` [m/N].
    fn node_answer_m_per_n(&self, node: NodeId, dt_s: f64) -> DVec3;

    /// Corrects the last step by what further forces would have done.
    fn correct(&mut self, forces: &[NodalForce], dt_s: f64, correction: Correction);
}

/// A model with explicit dynamics: its forces, its elements and its edits. [`DeformableModel`] follows.
pub(in crate::model) trait ExplicitDynamics: LocalBody + Clone + Send + 'static {
    /// What moves its nodes.
    type Mover: Mover;

    /// The nodes.
    fn mover(&self) -> &Self::Mover;

    /// The nodes, to be loaded and moved.
    fn mover_mut(&mut self) -> &mut Self::Mover;

    /// Advances by `dt_s` in the fewest equal parts that are not longer than the time step and the stable step.
    ///
    /// Held nodes move evenly to where they are held; the constraint force is the one that balances them at the last
    /// part, without the held node's own inertia. Allocates nothing.
    fn advance(&mut self, dt_s: f64);

    /// How thoroughly it computes from the next step on; answers whether that makes a difference.
    fn choose_level_of_detail(&mut self, _effort: LevelOfDetail) -> bool {
        false
    }

    /// Follows an edit of the mesh; a refusal leaves the model as it was. Removals allocate nothing.
    ///
    /// # Errors
    /// [`TopologyRefusal`] when it cannot follow.
    fn follow_change(&mut self, mesh: &TetMesh, change: &TopologyChange) -> Result<(), TopologyRefusal>;

    /// Writes what [`ExplicitDynamics::follow_change`] is about to overwrite; without a shorter answer the whole model.
    fn save_before(&self, _change: &TopologyChange, undo: &mut ModelUndo) {
        undo.keep_whole(Box::new(self.clone()));
    }

    /// Puts back what [`ExplicitDynamics::save_before`] wrote.
    fn put_back(&mut self, _undo: &ModelUndo) {}
}

impl<M: ExplicitDynamics> DeformableModel for M {
    fn apply(&mut self, constraints: &Constraints) {
        self.mover_mut().apply(constraints);
    }

    fn step(&mut self, dt_s: f64) {
        self.advance(dt_s);
    }

    fn state(&self) -> ModelState<'_> {
        self.mover().state()
    }

    fn history_into(&self, numbers: &mut Vec<f64>) {
        self.mover().history_into(numbers);
    }

    fn constraint_forces_n(&self) -> &[DVec3] {
        self.mover().constraint_forces_n()
    }

    fn take_over(&mut self, positions_m: &[DVec3]) {
        self.mover_mut().take_over(positions_m);
    }

    fn set_gravity(&mut self, gravity_m_per_s2: DVec3) {
        self.mover_mut().set_gravity(gravity_m_per_s2);
    }

    fn set_level_of_detail(&mut self, effort: LevelOfDetail) -> bool {
        self.choose_level_of_detail(effort)
    }

    fn report(&self) -> ModelReport {
        self.mover().report()
    }

    fn local_model_into(
        &mut self,
        patch: &[NodeId],
        period_s: f64,
        work: &mut LocalWork,
        out: &mut LocalModel,
    ) {
        out.start(patch, period_s, self.mover().state().positions_m);
        local_model::compute(self, work, out);
    }

    fn step_answer(&self) -> StepAnswer {
        StepAnswer::NodeByNode
    }

    fn node_answer_m_per_n(&self, node: NodeId, dt_s: f64) -> DVec3 {
        self.mover().node_answer_m_per_n(node, dt_s)
    }

    fn correct_step(&mut self, forces: &[NodalForce], dt_s: f64, correction: Correction) {
        self.mover_mut().correct(forces, dt_s, correction);
    }

    fn duplicate(&self) -> Box<dyn DeformableModel> {
        Box::new(self.clone())
    }

    fn topology_changed(&mut self, mesh: &TetMesh, change: &TopologyChange) -> Result<(), TopologyRefusal> {
        self.follow_change(mesh, change)
    }

    fn save_for_undo(&self, change: &TopologyChange, undo: &mut ModelUndo) {
        self.save_before(change, undo);
    }

    fn undo(&mut self, undo: &ModelUndo) {
        self.put_back(undo);
    }
}
