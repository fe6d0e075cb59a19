//! The state of a simulation that displays are shown.

use crate::pace::{Pace, StepMeters};
use crate::{Notice, Simulation};
use glisson::model::kind::ModelKind;
use glisson::model::{LevelOfDetail, StateHash};
use glisson::record::snapshot::{DisplayTopology, Snapshot};
use std::sync::Arc;

/// The latest displayed state.
#[derive(Clone, Debug)]
pub struct Published {
    /// What is displayed.
    pub snapshot: Snapshot,
    /// The triangles that the snapshot's vertices belong to.
    pub topology: Arc<DisplayTopology>,
    /// How the simulation keeps up with the clock.
    pub pace: Pace,
    /// Hash of the world's state.
    pub state_hash: StateHash,
    /// Which model moves the organ.
    pub model: ModelKind,
    /// What the user should know, in order: the newest, and how many there were altogether.
    pub notices: Vec<Notice>,
    /// How many notices there were altogether.
    pub n_notices: usize,
    /// Whether the simulation broke and goes no further; the notices say why.
    pub is_broken: bool,
    /// How far the simulation fell behind.
    pub lateness: Lateness,
    /// How thoroughly steps are computed.
    pub effort: LevelOfDetail,
    /// How long steps take, up to now and not only up to this state.
    pub meters: Arc<StepMeters>,
}

/// How far the simulation fell behind the clock.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lateness {
    /// Times that it gave up catching up.
    pub n_given_up: u64,
    /// What was then left out [s].
    pub left_out_s: f64,
}

impl Published {
    /// `known` is kept as long as it holds.
    pub(crate) fn of(
        simulation: &Simulation,
        known: Option<&Arc<DisplayTopology>>,
        pace: Pace,
        meters: &Arc<StepMeters>,
    ) -> Self {
        let world = simulation.world();
        let (snapshot, state_hash) = (world.snapshot(), world.state_hash());
        let topology = known
            .filter(|topology| topology.version == snapshot.topology_version)
            .map_or_else(|| Arc::new(world.display_topology()), Arc::clone);
        let (notices, n_notices) = (simulation.notices().to_vec(), simulation.n_notices());
        Self {
            snapshot,
            topology,
            pace,
            state_hash,
            model: world.model_kind(),
            notices,
            n_notices,
            is_broken: simulation.broken().is_some(),
            lateness: Lateness::default(),
            effort: world.effort(),
            meters: Arc::clone(meters),
        }
    }

    /// Those that came after the first `n_told` ones, but for what is no longer kept.
    pub fn notices_after(&self, n_told: usize) -> &[Notice] {
        let n_new = self.n_notices.saturating_sub(n_told).min(self.notices.len());
        &self.notices[self.notices.len() - n_new..]
    }
}
