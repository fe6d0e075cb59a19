//! Going back to an earlier moment: for who tries many things from one state.

use super::{Broken, Simulation, turning};
use glisson::math::DVec3;
use glisson::scene::BodySet;
use glisson::tool::MAX_TOOLS;
use glisson::training::task::TaskRun;
use glisson::world::saved::SavedWorld;
use std::sync::Arc;

/// A simulation as it was: its world, and how far its task is. Steps from it have the same bits as those that followed it.
pub struct SavedSimulation {
    world: SavedWorld,
    task: Option<TaskRun>,
    bodies: Arc<BodySet>,
    refused_last: [bool; MAX_TOOLS],
    orders_recomputations: bool,
    n_torn: usize,
    steady_gravity_m_per_s2: Option<DVec3>,
}

/// Why a moment cannot be saved, or come back.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CannotSave {
    /// A session tells what happened in the order in which it did.
    #[error(
        "a simulation that is recorded cannot go back: open it without a session, or finish the recording first"
    )]
    Recorded,
    /// A model is being made in another thread.
    #[error(
        "a model is being made, which takes over at a later step: save before it is ordered, or step until it has taken over"
    )]
    ModelOrdered,
    /// It follows a script.
    #[error(
        "a simulation that follows a script cannot go back: lead its instruments by the inputs of its steps"
    )]
    Scripted,
    /// It cannot go on.
    #[error(transparent)]
    Broken(#[from] Broken),
}

impl Simulation {
    /// A copy of everything that the next steps depend on; its edits cannot be undone.
    ///
    /// # Errors
    /// [`CannotSave`].
    pub fn save(&self) -> Result<SavedSimulation, CannotSave> {
        if let Some(broken) = &self.broken {
            return Err(broken.clone().into());
        }
        self.may_go_back()?;
        if self.builder.is_some() || self.turned.is_some() {
            return Err(CannotSave::ModelOrdered);
        }
        Ok(SavedSimulation {
            world: self.world.save(),
            task: self.task.clone(),
            bodies: Arc::clone(&self.bodies),
            refused_last: self.refused_last,
            orders_recomputations: self.orders_recomputations,
            n_torn: self.n_torn,
            steady_gravity_m_per_s2: self.steady_gravity_m_per_s2,
        })
    }

    /// Comes back to a saved moment of a simulation of the same scene, also where this one broke; `saved` serves again. What was told since
    /// stays told.
    ///
    /// # Errors
    /// [`CannotSave`].
    pub fn restore(&mut self, saved: &SavedSimulation) -> Result<(), CannotSave> {
        self.may_go_back()?;
        // What broke is left behind with its world, and with the room that it worked in.
        match self.broken {
            Some(_) => self.world.restore(&saved.world),
            None => self.world.go_back(&saved.world),
        }
        self.broken = None;
        // Whoever makes a model for the moment that is left delivers it to nobody.
        self.builder = None;
        self.turned = None::<turning::Turned>;
        self.task.clone_from(&saved.task);
        self.bodies = Arc::clone(&saved.bodies);
        self.refused_last = saved.refused_last;
        self.orders_recomputations = saved.orders_recomputations;
        self.n_torn = saved.n_torn;
        self.steady_gravity_m_per_s2 = saved.steady_gravity_m_per_s2;
        Ok(())
    }

    /// Another simulation of the same scene, which begins at a saved moment of this one or of another: made sooner than from the scene.
    pub fn another_at(&self, saved: &SavedSimulation) -> Self {
        Self {
            hand_of_scene: self.hand_of_scene,
            bodies_of_scene: Arc::clone(&self.bodies_of_scene),
            is_live: self.is_live,
            refused_last: saved.refused_last,
            orders_recomputations: saved.orders_recomputations,
            n_torn: saved.n_torn,
            steady_gravity_m_per_s2: saved.steady_gravity_m_per_s2,
            ..Self::of(saved.world.to_world(), Arc::clone(&saved.bodies), saved.task.clone())
        }
    }

    fn may_go_back(&self) -> Result<(), CannotSave> {
        if self.recorder.is_some() {
            return Err(CannotSave::Recorded);
        }
        if self.script.is_some() {
            return Err(CannotSave::Scripted);
        }
        Ok(())
    }
}
