//! Operations that lead the instruments by what they see of the organ, in the viewer and without a window alike.

use glisson::tool::{MAX_TOOLS, ToolInput};
use glisson::world::World;

/// What a script does in the next step.
#[derive(Clone, Copy, Debug)]
pub struct Lead {
    /// Where it has the instruments at the step's end.
    pub tools: [ToolInput; MAX_TOOLS],
    /// Which of them sets a clip then.
    pub clips: Option<usize>,
}

/// A clip that a script set, or wanted to.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct Clip {
    pub(crate) time_s: f64,
    /// Blood that the whole organ lost before and after [ml/min].
    pub(crate) before_ml_per_min: f64,
    pub(crate) after_ml_per_min: f64,
}

impl Clip {
    /// Whether it closed something.
    pub fn holds(&self) -> bool {
        self.after_ml_per_min < self.before_ml_per_min
    }
}

/// An operation. What it does depends on the world alone, and not on a clock.
pub trait Script: Send {
    /// The next step, asked once for each; none when it is over.
    fn lead(&mut self, world: &World) -> Option<Lead>;
    /// What a clip that it asked for did.
    fn see(&mut self, clip: &Clip);
    /// Share of it that is done, 0 to 1.
    fn progress(&self) -> f64;
    /// What came of it.
    fn result(&self, world: &World) -> anyhow::Result<String>;
}

/// Blood that the organ loses now [ml/min].
pub fn bleeding_ml_per_min(world: &World) -> f64 {
    world.vessels().map_or(0.0, |vessels| 60e6 * vessels.bleeding_m3_per_s())
}
