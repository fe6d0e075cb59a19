//! What is shown of a simulation: where it goes, and what it begins with.

use crate::Simulation;
use crate::display::DisplayFeed;
use crate::pace::{Pace, StepMeters};
use crate::published::{Lateness, Published};
use anyhow::Context;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;

/// What is shown of a simulation: where it goes, and what it begins with.
pub struct Shown {
    /// None where whoever shows it asks for it: `live::Turns`.
    feed: Option<DisplayFeed>,
    /// What displays were told last.
    pub(crate) latest: Arc<Published>,
}

impl Shown {
    /// That of a simulation as it is now, and where those who show it find it.
    ///
    /// # Errors
    /// When no thread can be started.
    pub fn start(simulation: &Simulation) -> anyhow::Result<(Self, watch::Receiver<Arc<Published>>)> {
        let alone = Self::alone(simulation);
        let (feed, published) =
            DisplayFeed::start((*alone.latest).clone()).context("starting the display's thread")?;
        Ok((Self { feed: Some(feed), ..alone }, published))
    }

    /// That of a simulation as it is now, which goes to nobody.
    pub(crate) fn alone(simulation: &Simulation) -> Self {
        let budget = Duration::from_secs_f64(simulation.world().spec().time_step_s);
        let meters = Arc::new(StepMeters::within(budget));
        Self { feed: None, latest: Arc::new(Published::first(simulation, &meters)) }
    }

    pub(crate) fn publish(&mut self) {
        if let Some(feed) = &mut self.feed {
            feed.publish(Arc::clone(&self.latest));
        }
    }

    /// Shows that it broke: what was shown last stays, for nobody knows what is left of the world.
    pub(crate) fn show_broken(&mut self, simulation: &Simulation, pace: Pace) {
        let last = Arc::make_mut(&mut self.latest);
        last.notices = simulation.notices().to_vec();
        last.n_notices = simulation.n_notices();
        last.is_broken = true;
        last.pace = Pace { paused: true, ..pace };
        self.publish();
    }

    /// Whether somebody looks at what was not gathered for the last state.
    pub(crate) fn lacks_what_is_watched(&self) -> bool {
        self.latest.lacks_what_is_watched()
    }

    /// The simulation came back to an earlier moment.
    pub(crate) fn went_back(&mut self) {
        Arc::make_mut(&mut self.latest).count_versions_on();
    }

    /// Shows it as it is now.
    pub(crate) fn show(&mut self, simulation: &Simulation, pace: Pace, lateness: Lateness) {
        self.latest = Arc::new(self.latest.next(simulation, pace, lateness));
        self.publish();
    }
}
