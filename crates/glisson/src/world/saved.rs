//! Coming back to an earlier moment.

use super::constrain::MOST_IMPOSED;
use super::loops::LoopScratch;
use super::press::Press;
use super::slide::SlideScratch;
use super::{World, grasp};
use std::sync::Arc;

/// A world as it was: mesh with its removals, the model with accumulated stiffness, warm starts and factors, the
/// contact under way, loads, orders. Steps from it have the same bits as those that followed it.
pub struct SavedWorld(World);

/// Room that the steps of a world work in, some MB: what is in it matters to no step but the one that writes it. A moment that is kept
/// has none.
struct Room {
    slide: Box<SlideScratch>,
    press: Box<Press>,
}

impl Room {
    fn none() -> Self {
        Self { slide: Box::new(SlideScratch::without_room()), press: Box::new(Press::without_room()) }
    }

    fn for_nodes(n_nodes: usize) -> Self {
        Self { slide: Box::new(SlideScratch::for_nodes(n_nodes)), press: Box::new(Press::new()) }
    }
}

impl SavedWorld {
    /// A world that begins at this moment. Allocates.
    pub fn to_world(&self) -> World {
        let Self(world) = self;
        world.duplicate(Room::for_nodes(world.organ.mesh().positions_m.len()))
    }
}

impl World {
    /// A copy of everything that the next steps depend on; its edits cannot be undone. Allocates.
    pub fn save(&self) -> SavedWorld {
        SavedWorld(self.duplicate(Room::none()))
    }

    /// Comes back to a saved moment; `saved` serves again. Allocates.
    pub fn restore(&mut self, saved: &SavedWorld) {
        let stage_watch = self.stage_watch.take();
        *self = Self { stage_watch, ..saved.to_world() };
    }

    /// The same, and goes on with the room that it has. Only where no step or edit of it ended in a panic, which may have left anything in
    /// that room. Allocates.
    pub fn go_back(&mut self, SavedWorld(saved): &SavedWorld) {
        let stage_watch = self.stage_watch.take();
        let n_nodes = saved.organ.mesh().positions_m.len();
        let mut room = Room::none();
        std::mem::swap(&mut room.press, &mut self.press);
        std::mem::swap(&mut room.slide, &mut self.slide);
        if n_nodes > room.slide.n_nodes {
            room = Room::for_nodes(n_nodes);
        }
        *self = Self { stage_watch, ..saved.duplicate(room) };
    }

    fn duplicate(&self, Room { slide, mut press }: Room) -> Self {
        press.take_over(&self.press);
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
            slide,
            press,
            self_contact: self.self_contact.clone(),
            touch_at_start: self.touch_at_start.clone(),
            loads: self.loads.clone(),
            sutures: self.sutures.clone(),
            loops: self.loops.clone(),
            loop_scratch: LoopScratch::of(&self.spec.tools),
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
