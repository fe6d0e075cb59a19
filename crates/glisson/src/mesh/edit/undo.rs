//! Taking edits back, last in, first out.
//!
//! An edit only adds entities at the end, takes older ones out, whose records stay, and moves nodes. To take
//! it back, what was added is taken out and its records dropped, what was taken out is put in again by its
//! record, and the old places are written back: afterwards everything has the bits from before.

use super::EditableMesh;
use crate::math::DVec3;
use crate::mesh::topology::Lengths;
use crate::mesh::{NodeId, TetId};

/// What it takes to take an edit back. Its buffers are used again.
#[derive(Clone, Debug, Default)]
pub struct MeshUndo {
    before: Lengths,
    after: Lengths,
    removed: Vec<TetId>,
    moved: Vec<(NodeId, DVec3)>,
}

impl MeshUndo {
    /// With room for the removal of `n_tets` tetrahedra.
    pub fn with_room_for_removals(n_tets: usize) -> Self {
        Self { removed: Vec::with_capacity(n_tets), ..Self::default() }
    }

    /// Forgets everything but the buffers: taking this back does nothing.
    pub(super) fn start(&mut self, lengths: Lengths) {
        self.before = lengths;
        self.after = lengths;
        self.removed.clear();
        self.moved.clear();
    }

    pub(super) fn save_removal(&mut self, tet: TetId) {
        // What came in with this edit is dropped, not put back.
        if tet.index() < self.before.tets {
            self.removed.push(tet);
        }
    }

    pub(super) fn save_move(&mut self, node: NodeId, from_m: DVec3) {
        if node.index() < self.before.nodes {
            self.moved.push((node, from_m));
        }
    }

    pub(super) fn close(&mut self, lengths: Lengths) {
        self.after = lengths;
    }
}

impl EditableMesh {
    /// Takes back the last edit: mesh and topology are what they were before it, bit for bit.
    ///
    /// # Panics
    /// If `undo` is not of the last edit, or the mesh was compacted since.
    pub fn undo(&mut self, undo: &MeshUndo) {
        assert_eq!(undo.after, self.topology.lengths(), "edits are taken back last in, first out");
        self.take_back(undo);
    }

    /// [`EditableMesh::undo`] of an edit that may be half done.
    pub(super) fn take_back(&mut self, undo: &MeshUndo) {
        let mut change = std::mem::take(&mut self.scratch.change);
        change.clear();
        for tet in (undo.before.tets..self.topology.n_tets()).map(TetId::from_index) {
            if self.topology.is_live_tet(tet) {
                self.topology.detach_tet(tet, &mut change);
            }
        }
        self.topology.truncate(undo.before);
        self.mesh.tetrahedra.truncate(undo.before.tets);
        self.mesh.positions_m.truncate(undo.before.nodes);
        for &tet in undo.removed.iter().rev() {
            self.topology.attach_tet(tet, &mut change);
        }
        for &(node, from_m) in undo.moved.iter().rev() {
            self.mesh.positions_m[node.index()] = from_m;
        }
        self.scratch.change = change;
    }
}
