//! The state of a simulation that displays are shown.

use crate::inside::Inside;
use crate::pace::{Pace, StepMeters};
use crate::watchers::Watchers;
use crate::{Notice, Parameters, Simulation};
use glisson::model::kind::ModelKind;
use glisson::model::{LevelOfDetail, StateHash};
use glisson::record::snapshot::{ContactPoints, DisplayTopology, Snapshot};
use glisson::training::task::{TaskRecord, TaskRun, TaskStatus};
use std::sync::Arc;

/// The latest displayed state.
#[derive(Clone, Debug)]
pub struct Published {
    /// What is displayed.
    pub snapshot: Snapshot,
    /// Where surfaces bear forces; none while nobody looks at them.
    pub contact_points: Option<ContactPoints>,
    /// What is inside of the bodies; none while nobody looks at it.
    pub inside: Option<Arc<Inside>>,
    /// The triangles that the snapshot's vertices belong to.
    pub topology: Arc<DisplayTopology>,
    /// How the simulation keeps up with the clock.
    pub pace: Pace,
    /// Hash of the world's state.
    pub state_hash: StateHash,
    /// Which model moves the organ.
    pub model: ModelKind,
    /// How what can be turned stands.
    pub parameters: Arc<Parameters>,
    /// What the user should know, in order: the newest, and how many there were altogether.
    pub notices: Vec<Notice>,
    /// How many notices there were altogether.
    pub n_notices: usize,
    /// How far the scene's task is, if it has one.
    pub task: Option<TaskStatus>,
    /// What was written down of the task, once it is over; in the last state of all, of one that was not over, too.
    pub task_record: Option<Arc<TaskRecord>>,
    /// Of the attempt that was over when the task was last begun anew.
    pub task_before: Option<Arc<TaskRecord>>,
    /// Whether the simulation broke and goes no further; the notices say why.
    pub is_broken: bool,
    /// How far the simulation fell behind.
    pub lateness: Lateness,
    /// How thoroughly steps are computed.
    pub effort: LevelOfDetail,
    /// How long steps take, up to now and not only up to this state.
    pub meters: Arc<StepMeters>,
    /// What is added to the world's own versions of its surface.
    pub versions_from: u32,
    /// Who looks at contact points, now and not only at this state.
    pub contact_watchers: Arc<Watchers>,
    /// Who looks at the inside of bodies.
    pub inside_watchers: Arc<Watchers>,
}

/// How far the simulation fell behind the clock.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lateness {
    /// Times that it gave up catching up.
    pub n_given_up: u64,
    /// What was then left out [s].
    pub left_out_s: f64,
}

/// What is gathered for who looks at it.
struct Watched<'a> {
    contacts: Arc<Watchers>,
    inside: Arc<Watchers>,
    /// The inside of the state before.
    before: Option<&'a Inside>,
}

impl Published {
    /// The state of a simulation of which nothing was shown yet.
    pub(crate) fn first(simulation: &Simulation, meters: &Arc<StepMeters>) -> Self {
        let topology = Arc::new(simulation.world().display_topology());
        // A session that goes on stands still at first.
        let pace = Pace { paused: simulation.is_resumed(), ..Pace::default() };
        let nobody = Watched { contacts: Arc::default(), inside: Arc::default(), before: None };
        Self { pace, ..Self::of(simulation, topology, meters, nobody) }
    }

    /// The state now, after this one. What still holds is shared.
    pub(crate) fn next(&self, simulation: &Simulation, pace: Pace, lateness: Lateness) -> Self {
        let world = simulation.world();
        let version = world.organ().topology_version() + self.versions_from;
        let topology = if version == self.topology.version {
            Arc::clone(&self.topology)
        } else {
            Arc::new(DisplayTopology { version, ..world.display_topology() })
        };
        let watched = Watched {
            contacts: Arc::clone(&self.contact_watchers),
            inside: Arc::clone(&self.inside_watchers),
            before: self.inside.as_deref(),
        };
        let next = Self::of(simulation, topology, &self.meters, watched);
        let task_record = self.task_record.clone().filter(|_| next.task_is_over());
        let task_record = task_record.or_else(|| record_of_finished(simulation));
        let is_same = next.parameters == self.parameters;
        let parameters = Arc::clone(if is_same { &self.parameters } else { &next.parameters });
        let snapshot = Snapshot { topology_version: version, ..next.snapshot };
        let versions_from = self.versions_from;
        Self { snapshot, versions_from, pace, lateness, task_record, parameters, ..next }
    }

    /// The world came back to an earlier moment, from which it counts the versions of its surface again: those that are shown go on.
    pub(crate) fn count_versions_on(&mut self) {
        self.versions_from = self.topology.version + 1;
        self.inside = None;
        self.task_record = None;
    }

    fn of(
        simulation: &Simulation,
        topology: Arc<DisplayTopology>,
        meters: &Arc<StepMeters>,
        watched: Watched<'_>,
    ) -> Self {
        let world = simulation.world();
        let inside = watched.inside.are_there().then(|| Arc::new(Inside::of(simulation, watched.before)));
        let contact_points = watched.contacts.are_there().then(|| {
            let mut points = ContactPoints::default();
            world.contact_points_into(&mut points);
            points
        });
        Self {
            snapshot: world.snapshot(),
            contact_points,
            inside,
            topology,
            pace: Pace::default(),
            state_hash: world.state_hash(),
            model: world.model_kind(),
            parameters: Arc::new(simulation.parameters()),
            notices: simulation.notices().to_vec(),
            n_notices: simulation.n_notices(),
            task: simulation.task().map(TaskRun::status),
            task_record: None,
            task_before: simulation.task_before().map(Arc::clone),
            is_broken: simulation.broken().is_some(),
            lateness: Lateness::default(),
            effort: world.effort(),
            meters: Arc::clone(meters),
            versions_from: 0,
            contact_watchers: watched.contacts,
            inside_watchers: watched.inside,
        }
    }

    /// The same state with what was written down of a task that the end of the simulation breaks off.
    pub(crate) fn with_task_broken_off(&self, simulation: &Simulation) -> Option<Self> {
        let task =
            simulation.task().filter(|task| self.task_record.is_none() && task.status().began_s.is_some())?;
        Some(Self { task_record: Some(Arc::new(task.record())), ..self.clone() })
    }

    fn task_is_over(&self) -> bool {
        self.task.as_ref().is_some_and(|task| task.outcome.is_some())
    }

    /// Whether somebody looks at something that this state does not have.
    pub(crate) fn lacks_what_is_watched(&self) -> bool {
        self.contact_points.is_none() && self.contact_watchers.are_there()
            || self.inside.is_none() && self.inside_watchers.are_there()
    }

    /// Those that came after the first `n_told` ones, but for what is no longer kept.
    pub fn notices_after(&self, n_told: usize) -> &[Notice] {
        let n_new = self.n_notices.saturating_sub(n_told).min(self.notices.len());
        &self.notices[self.notices.len() - n_new..]
    }
}

fn record_of_finished(simulation: &Simulation) -> Option<Arc<TaskRecord>> {
    let finished = simulation.task().filter(|task| task.outcome().is_some());
    finished.map(|task| Arc::new(task.record()))
}
