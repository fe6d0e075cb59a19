//! The stages of a step, for who times them: the library itself reads no clock.

use super::World;

/// A stage of [`World::step`], in the order in which they end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepStage {
    /// Instruments have moved, and it is found what they begin to touch and hold.
    Hands,
    /// Contacts of instruments are solved, and the model is told of all loads.
    Touch,
    /// The model has made its step, bodies touched each other, and the surface has followed.
    Organ,
    /// It is read what the hands feel.
    Forces,
}

/// Hears of the end of each stage of each step.
pub type StageWatch = Box<dyn FnMut(StepStage) + Send>;

impl World {
    /// From now on `watch` hears of the end of each stage of each step; none for no more. It belongs to no state: no step depends on
    /// it, and it is not saved.
    pub fn watch_stages(&mut self, watch: Option<StageWatch>) {
        self.stage_watch = watch;
    }

    pub(super) fn end_stage(&mut self, stage: StepStage) {
        if let Some(watch) = &mut self.stage_watch {
            watch(stage);
        }
    }
}
