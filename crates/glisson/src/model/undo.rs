//! What an edit of the mesh overwrites in a model, kept so that it can be put back bit for bit.

use super::DeformableModel;
use crate::math::DVec3;

/// Values from before an edit. Its buffers are used again, so that a journal of edits need not allocate.
#[derive(Default)]
pub struct ModelUndo {
    /// Node positions [m].
    pub positions_m: Vec<DVec3>,
    /// Node velocities [m/s].
    pub velocities_m_per_s: Vec<DVec3>,
    /// Further numbers, in an order that the model knows.
    pub numbers: Vec<f64>,
    /// Places where numbers go, in an order that the model knows.
    pub places: Vec<u32>,
    whole: Option<Box<dyn DeformableModel>>,
}

impl ModelUndo {
    /// Forgets everything but the buffers.
    pub fn clear(&mut self) {
        self.positions_m.clear();
        self.velocities_m_per_s.clear();
        self.numbers.clear();
        self.places.clear();
        self.whole = None;
    }

    /// Keeps a copy of the whole model.
    pub fn keep_whole(&mut self, model: Box<dyn DeformableModel>) {
        self.whole = Some(model);
    }

    /// Brings `model` back to the moment before the edit.
    pub fn put_back(&mut self, model: &mut Box<dyn DeformableModel>) {
        match self.whole.take() {
            Some(whole) => *model = whole,
            None => model.undo(self),
        }
    }
}
