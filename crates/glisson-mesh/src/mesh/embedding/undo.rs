//! What an edit overwrites in an embedding, so that it can be put back bit for bit.

use super::{Embedding, Tie};
use crate::mesh::{NodeId, TetId};

/// Values from before an edit.
#[derive(Clone, Debug, Default)]
pub struct EmbeddingUndo {
    /// Nodes and tetrahedra of the copies, then of the cut mesh.
    n_before: [usize; 4],
    pub(super) pieces: Vec<(TetId, Option<Vec<TetId>>)>,
    pub(super) copy_of: Vec<(TetId, TetId)>,
    pub(super) ties: Vec<(NodeId, Tie)>,
}

impl EmbeddingUndo {
    /// Forgets everything but the buffers.
    pub(super) fn start(&mut self, of: &Embedding) {
        let copies = &of.copies;
        self.n_before =
            [copies.positions_m.len(), copies.tetrahedra.len(), of.places.len(), of.copy_of.len()];
        self.pieces.clear();
        self.copy_of.clear();
        self.ties.clear();
    }
}

impl Embedding {
    /// Back to before the edit that wrote `undo`. Edits are undone in the opposite order.
    pub fn undo(&mut self, undo: &EmbeddingUndo) {
        let [n_copied_nodes, n_copies, n_nodes, n_tets] = undo.n_before;
        self.copies.positions_m.truncate(n_copied_nodes);
        self.copies.tetrahedra.truncate(n_copies);
        self.copies.shares.truncate(n_copies);
        self.places.truncate(n_nodes);
        self.ties.truncate(n_nodes);
        self.origin_of.truncate(n_tets);
        self.copy_of.truncate(n_tets);
        for (origin, tets) in &undo.pieces {
            match tets {
                Some(tets) => _ = self.pieces.insert(*origin, tets.clone()),
                None => _ = self.pieces.remove(origin),
            }
        }
        // What was overwritten more than once comes back to its first value; what came in is gone.
        for &(tet, copy) in undo.copy_of.iter().rev().filter(|(tet, _)| tet.index() < n_tets) {
            self.copy_of[tet.index()] = copy;
        }
        for &(node, tie) in undo.ties.iter().rev().filter(|(node, _)| node.index() < n_nodes) {
            self.ties[node.index()] = tie;
        }
    }
}
