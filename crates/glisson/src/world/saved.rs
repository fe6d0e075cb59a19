//! Coming back to an earlier moment.

use super::constrain::MOST_IMPOSED;
use super::slide::SlideScratch;
use super::{World, grasp};
use std::sync::Arc;

/// A world as it was: mesh with its removals, the model with accumulated stiffness, warm starts and factors, the
/// contact under way, loads, orders. Steps from it have the same bits as those that followed it.
pub struct SavedWorld(World);

impl World {
    /// A copy of everything that the next steps depend on; its edits cannot be undone. Allocates.
    pub fn save(&self) -> SavedWorld {
        SavedWorld(self.duplicate())
    }

    /// Comes back to a saved moment; `saved` serves again. Allocates.
    pub fn restore(&mut self, saved: &SavedWorld) {
        let stage_watch = self.stage_watch.take();
        *self = Self { stage_watch, ..saved.0.duplicate() };
    }

    fn duplicate(&self) -> Self {
        let swap = Self::order_of(self.swap.as_ref());
        // A clone has no room beyond what it holds.
        let mut constraints = self.constraints.clone();
        constraints.displacements.reserve(MOST_IMPOSED);
        constraints.forces.reserve(self.organ.mesh().positions_m.len());
        let mut owners = self.owners.clone();
        owners.reserve(MOST_IMPOSED);
        Self {
            spec: self.spec.clone(),
            organ: self.organ.clone(),
            model: self.model.duplicate(),
            model_kind: self.model_kind,
            swap,
            tool_states: self.tool_states.clone(),
            active: self.active.clone(),
            blades: self.blades,
            vessels: self.vessels.clone(),
            journal: self.journal.without_undo(),
            mesh_of_the_start: Arc::clone(&self.mesh_of_the_start),
            anchored_at_start: Arc::clone(&self.anchored_at_start),
            constraints,
            owners,
            between_jaws: grasp::room_for_search(),
            haptics: None,
            slide: Box::new(SlideScratch::for_nodes(self.organ.mesh().positions_m.len())),
            press: Box::new(self.press.duplicate()),
            self_contact: self.self_contact.clone(),
            touch_at_start: self.touch_at_start.clone(),
            loads: self.loads.clone(),
            sutures: self.sutures.clone(),
            gravity_m_per_s2: self.gravity_m_per_s2,
            pull_m_per_s2: self.pull_m_per_s2,
            step: self.step,
            clock_base: self.clock_base,
            n_resets: self.n_resets,
            report: self.report,
            effort: self.effort,
            // Whoever listens to this world does not listen to its copy.
            stage_watch: None,
        }
    }
}
