//! One edit of the organ as a transaction: mesh, model, the model that waits to take over, surface, supports, loads,
//! hands, vessels, self-contact and blades follow in this order. Each keeps what the edit overwrites; a refusal at any
//! place takes back what was done before it, in the opposite order, so that every bit is as before. Undo takes the same
//! way back.

use super::active::{ActiveBefore, ActiveTip};
use super::bodies::SurfaceContact;
use super::loads::LoadsBefore;
use super::loops::Loops;
use super::organ::OrganBefore;
use super::refusal::EditRefusal;
use super::sutures::Suture;
use super::tool_state::ToolState;
use super::vessels::Vessels;
use super::{QueuedSwap, World};
use crate::contact::response::persistent::ContactMemory;
use crate::mesh::edit::{MeshEdit, MeshUndo, TopologyChange};
use crate::model::{ModelUndo, follow_edit};
use glisson_mesh::fault;

/// What it takes to take one edit back. Buffers are used again.
#[derive(Default)]
pub(super) struct EditRecord {
    pub(super) change: TopologyChange,
    mesh: MeshUndo,
    pub(super) model: ModelUndo,
    /// Of the model that was delivered but had not taken over.
    pub(super) waiting: Option<ModelUndo>,
    organ: OrganBefore,
    loads: LoadsBefore,
    tool_states: Vec<ToolState>,
    active: Vec<ActiveBefore>,
    vessels: Option<Vessels>,
    sutures: Vec<Suture>,
    loops: Loops,
    /// Forces between bodies that last.
    contact: Option<ContactMemory>,
    /// Steps made when the edit was.
    step: u64,
    /// Tetrahedra that it removed before any other kind of edit was made.
    pub(super) n_removed_first: usize,
}

/// How far an edit has come.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
enum Stage {
    #[default]
    Nothing,
    Mesh,
    Model,
    WaitingModel,
    Surface,
    Loads,
    Hands,
    Vessels,
}

/// An edit under way.
#[derive(Default)]
struct Progress {
    stage: Stage,
    /// The ordered model that could not follow: it is dropped when all others have.
    left_behind: Option<QueuedSwap>,
}

/// Whether edits do nothing but make the mesh finer.
pub(super) fn are_finer(edits: &[MeshEdit]) -> bool {
    edits.iter().all(|edit| matches!(edit, MeshEdit::Split { .. }))
}

impl World {
    /// Carries edits out as one, with what it takes to take them back in `record`.
    ///
    /// # Errors
    /// [`EditRefusal`]; every bit is as before then.
    pub(super) fn transact(
        &mut self,
        edits: &[MeshEdit],
        record: &mut EditRecord,
    ) -> Result<(), EditRefusal> {
        let mut progress = Progress::default();
        let done = self.carry_out(edits, record, &mut progress);
        if done.is_err() {
            self.roll_back(record, progress);
        }
        done
    }

    fn carry_out(
        &mut self,
        edits: &[MeshEdit],
        record: &mut EditRecord,
        progress: &mut Progress,
    ) -> Result<(), EditRefusal> {
        self.keep_what_follows(record);
        let EditRecord { change, mesh, model, waiting, .. } = record;
        let body = self.organ.body_mut();
        match edits {
            [edit] => body.apply_saving(edit, change, mesh)?,
            _ => body.apply_all_saving(edits, change, mesh)?,
        }
        progress.stage = Stage::Mesh;
        self.model.expect_finer_mesh(are_finer(edits));
        follow_edit(&mut self.model, self.organ.mesh(), change, model)?;
        progress.stage = Stage::Model;
        if let Some(awaited) = self.swap.as_mut().and_then(|swap| swap.model.as_mut()) {
            let mut saved = ModelUndo::default();
            awaited.expect_finer_mesh(are_finer(edits));
            match follow_edit(awaited, self.organ.mesh(), change, &mut saved) {
                Ok(()) => *waiting = Some(saved),
                // The present model has followed: it goes on.
                Err(_) => progress.left_behind = self.swap.take(),
            }
        }
        progress.stage = Stage::WaitingModel;
        self.let_all_follow(record, progress)
    }

    /// What the edit may overwrite and does not keep itself.
    fn keep_what_follows(&self, record: &mut EditRecord) {
        record.step = self.step;
        record.waiting = None;
        record.tool_states.clone_from(&self.tool_states);
        record.active.clear();
        record.active.extend(self.active.iter().map(ActiveTip::before_edit));
        record.vessels.clone_from(&self.vessels);
        record.sutures.clone_from(&self.sutures);
        record.loops = self.loops.clone();
        record.contact = self.self_contact.as_ref().and_then(|contact| contact.memory());
    }

    fn let_all_follow(
        &mut self,
        record: &mut EditRecord,
        progress: &mut Progress,
    ) -> Result<(), EditRefusal> {
        let EditRecord { change, organ, loads, contact, .. } = &mut *record;
        fault::check("world: surface")?;
        self.organ.follow_edit(change, organ);
        self.organ.place_nodes(change, self.model.state().positions_m);
        progress.stage = Stage::Surface;
        fault::check("world: loads")?;
        self.loads.follow(change, loads);
        progress.stage = Stage::Loads;
        fault::check("world: hands")?;
        let topology = self.organ.body().topology();
        self.tool_states.iter_mut().for_each(|hand| hand.follow(topology, change));
        progress.stage = Stage::Hands;
        fault::check("world: vessels")?;
        if let Some(vessels) = &mut self.vessels {
            vessels.follow(self.organ.body(), change, |triangle| self.organ.is_cut(triangle));
        }
        progress.stage = Stage::Vessels;
        fault::check("world: self-contact")?;
        let self_contact = self.contact_as_it_is(contact.clone());
        fault::check("world: journal")?;
        // From here on nothing can fail.
        self.self_contact = self_contact;
        self.active.iter_mut().for_each(|active| active.follow(self.organ.body(), change));
        self.sutures.iter_mut().for_each(|suture| suture.follow_edit(self.organ.body()));
        let n_tied = self.n_tied_loops();
        self.loops.follow_edit(self.organ.body().topology(), change);
        if self.n_tied_loops() != n_tied {
            self.close_tied_vessels();
        }
        self.constraints.forces.reserve(self.organ.mesh().positions_m.len());
        Ok(())
    }

    /// How the organ touches itself now, or bodies each other, with the forces that last.
    fn contact_as_it_is(&self, memory: Option<ContactMemory>) -> Option<Box<SurfaceContact>> {
        let contact = SurfaceContact::of(&self.spec, &self.organ, self.model.as_ref())?;
        let mut memory = memory;
        let topology = self.organ.body().topology();
        if let Some(memory) = &mut memory {
            memory.keep(|node| node.index() < topology.n_nodes() && topology.is_live_node(node));
        }
        Some(contact.with_memory(memory.as_ref()))
    }

    /// Takes back what an edit did that came so far and no further.
    fn roll_back(&mut self, record: &mut EditRecord, progress: Progress) {
        let Progress { stage, left_behind } = progress;
        if stage >= Stage::Vessels {
            self.vessels.clone_from(&record.vessels);
        }
        if stage >= Stage::Hands {
            self.tool_states.clone_from(&record.tool_states);
        }
        if stage >= Stage::Loads {
            self.loads.undo(&record.change, &record.loads);
            self.loads.forget_edit(&record.loads);
        }
        if stage >= Stage::Model {
            record.model.put_back(&mut self.model);
        }
        if let Some(swap) = left_behind {
            self.swap = Some(swap);
        } else if let (Some(waiting), Some(saved)) =
            (self.swap.as_mut().and_then(|swap| swap.model.as_mut()), &mut record.waiting)
        {
            saved.put_back(waiting);
        }
        record.waiting = None;
        if stage >= Stage::Surface {
            self.organ.undo_edit(&record.mesh, &record.change, &mut record.organ);
            self.organ.forget_edit(&record.organ);
        } else if stage >= Stage::Mesh {
            self.organ.body_mut().undo(&record.mesh);
        }
    }

    /// Undoes an edit that was made, the last one that stands.
    pub(super) fn undo_record(&mut self, record: &mut EditRecord) {
        record.model.put_back(&mut self.model);
        // It was saved with the effort of its time.
        self.keep_level_of_detail();
        // A model that is still being made may be made from the organ with this cut.
        self.swap.take_if(|swap| swap.model.is_none());
        if let Some(waiting) = self.swap.as_mut().and_then(|swap| swap.model.as_mut()) {
            match &mut record.waiting {
                Some(saved) => saved.put_back(waiting),
                // It came after the edit, which it cannot take back.
                None => self.swap = None,
            }
        }
        self.organ.undo_edit(&record.mesh, &record.change, &mut record.organ);
        self.loads.undo(&record.change, &record.loads);
        if let Some((vessels, before)) = self.vessels.as_mut().zip(record.vessels.as_ref()) {
            vessels.go_back_to(before, self.organ.body());
        }
        if record.step == self.step {
            self.sutures.clone_from(&record.sutures);
            self.loops = record.loops.clone();
            self.tool_states.clone_from(&record.tool_states);
        } else {
            self.tool_states.iter_mut().for_each(ToolState::let_go);
            self.press.forget();
            self.sutures.iter_mut().for_each(|suture| suture.follow_edit(self.organ.body()));
            self.loops.go_back_to(&record.loops, self.organ.body().topology());
            self.organ.rest_at(self.model.state().positions_m);
        }
        self.close_tied_vessels();
        for (active, before) in self.active.iter_mut().zip(&record.active) {
            active.go_back_to(before);
        }
        self.self_contact = self.contact_as_it_is(record.contact.clone());
        self.owners.clear();
        self.constraints.displacements.clear();
        self.constraints.forces.clear();
    }
}
