//! What an edit of the mesh overwrites in a model, kept so that it can be put back bit for bit.

use super::{DeformableModel, ModelReport, TopologyRefusal};
use glisson_mesh::fault;
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::TetMesh;
use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::embedding::EmbeddingUndo;

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
    /// How the last step before the edit went.
    pub report: ModelReport,
    /// Of a model with embedded cuts: that of its copies.
    pub(in crate::model) embedding: Option<EmbeddingUndo>,
    /// Of a model of several bodies: that of each; of one with embedded cuts: that of the model of its copies.
    pub(in crate::model) parts: Vec<ModelUndo>,
    whole: Option<Box<dyn DeformableModel>>,
}

impl ModelUndo {
    /// Forgets everything but the buffers.
    pub fn clear(&mut self) {
        self.positions_m.clear();
        self.velocities_m_per_s.clear();
        self.numbers.clear();
        self.places.clear();
        self.report = ModelReport::default();
        self.parts.clear();
        self.embedding = None;
        self.whole = None;
    }

    /// Keeps the components of a vector among the numbers.
    pub(in crate::model) fn push_vector(&mut self, v: DVec3) {
        self.numbers.extend_from_slice(&v.to_array());
    }

    /// Keeps a count or an id among the places.
    pub(in crate::model) fn push_place(&mut self, place: usize) {
        self.places.push(u32::try_from(place).expect("meshes have fewer than 2^32 entities"));
    }

    /// Reads numbers and places in the order in which they were written.
    pub(in crate::model) fn reader(&self) -> UndoReader<'_> {
        UndoReader { numbers: &self.numbers, places: &self.places }
    }

    /// Keeps a copy of the whole model.
    pub fn keep_whole(&mut self, model: Box<dyn DeformableModel>) {
        self.whole = Some(model);
    }

    /// Whether it holds a copy of the whole model, or of a body's.
    pub fn keeps_whole(&self) -> bool {
        self.whole.is_some() || self.parts.iter().any(Self::keeps_whole)
    }

    /// Brings `model` back to the moment before the edit.
    pub fn put_back(&mut self, model: &mut Box<dyn DeformableModel>) {
        match self.whole.take() {
            Some(whole) => *model = whole,
            None => model.undo(self),
        }
    }

    /// The same where it serves again: a copy of the whole model is copied once more.
    pub(in crate::model) fn put_back_copy(&self, model: &mut Box<dyn DeformableModel>) {
        match &self.whole {
            Some(whole) => *model = whole.duplicate(),
            None => model.undo(self),
        }
    }
}

/// Has a model follow an edit of the mesh, with what it takes to take that back in `undo`. A model that cannot follow has
/// every bit from before.
///
/// # Errors
/// [`TopologyRefusal`] when the model cannot follow.
pub fn follow_edit(
    model: &mut Box<dyn DeformableModel>,
    mesh: &TetMesh,
    change: &TopologyChange,
    undo: &mut ModelUndo,
) -> Result<(), TopologyRefusal> {
    undo.clear();
    fault::check("model: before it follows")?;
    let n_nodes = model.state().positions_m.len();
    if n_nodes != change.nodes.n_before {
        // Before anything is saved by the numbers of another mesh.
        return Err(TopologyRefusal::OtherNodes { n_nodes, n_nodes_before: change.nodes.n_before });
    }
    let followed = model.follow_saving(mesh, change, undo);
    // One of several bodies brings them back itself.
    if followed.is_err() && undo.whole.is_some() {
        undo.put_back(model);
    }
    followed?;
    if let Err(fault) = fault::check("model: after it followed") {
        undo.put_back(model);
        return Err(fault.into());
    }
    Ok(())
}

/// What is left to read of a [`ModelUndo`].
pub(in crate::model) struct UndoReader<'a> {
    numbers: &'a [f64],
    places: &'a [u32],
}

impl<'a> UndoReader<'a> {
    pub(in crate::model) fn numbers(&mut self, n: usize) -> &'a [f64] {
        let (read, rest) = self.numbers.split_at(n);
        self.numbers = rest;
        read
    }

    pub(in crate::model) fn number(&mut self) -> f64 {
        self.numbers(1)[0]
    }

    pub(in crate::model) fn vector(&mut self) -> DVec3 {
        DVec3::from_slice(self.numbers(3))
    }

    pub(in crate::model) fn places(&mut self, n: usize) -> &'a [u32] {
        let (read, rest) = self.places.split_at(n);
        self.places = rest;
        read
    }

    pub(in crate::model) fn has_places(&self) -> bool {
        !self.places.is_empty()
    }

    pub(in crate::model) fn place(&mut self) -> usize {
        self.places(1)[0] as usize
    }
}
