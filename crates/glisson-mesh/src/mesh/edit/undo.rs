//! Taking edits back, last in, first out.
//!
//! An edit only adds entities at the end, takes older ones out, whose records stay, and moves nodes. To take
//! it back, what was added is taken out and its records dropped, what was taken out is put in again by its
//! record, and the old places are written back: afterwards everything has the bits from before.

use super::EditableMesh;
use crate::math::DVec3;
use crate::mesh::change::Lengths;
use crate::mesh::topology::{EntityCounts, Topology};
use crate::mesh::{NodeId, TetId};

/// What it takes to take an edit back. Its buffers are used again.
#[derive(Clone, Debug, Default)]
pub struct MeshUndo {
    before: Lengths,
    after: Lengths,
    live_after: EntityCounts,
    removed: Vec<TetId>,
    moved: Vec<(NodeId, DVec3)>,
}

impl MeshUndo {
    /// With room for the removal of `n_tets` tetrahedra.
    pub fn with_room_for_removals(n_tets: usize) -> Self {
        Self { removed: Vec::with_capacity(n_tets), ..Self::default() }
    }

    /// Forgets everything but the buffers: taking this back does nothing.
    pub(super) fn start(&mut self, topology: &Topology) {
        self.before = topology.lengths();
        self.close(topology);
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

    pub(super) fn close(&mut self, topology: &Topology) {
        self.after = topology.lengths();
        self.live_after = topology.live_counts();
    }
}

impl EditableMesh {
    /// Takes back the last edit: mesh and topology are what they were before it, bit for bit.
    ///
    /// # Panics
    /// If `undo` is not of the last edit, or the mesh was compacted since.
    pub fn undo(&mut self, undo: &MeshUndo) {
        let now = (self.topology.lengths(), self.topology.live_counts());
        assert_eq!((undo.after, undo.live_after), now, "edits are undone last in, first out");
        self.take_back(undo);
    }

    /// [`EditableMesh::undo`] of an edit that may be half done.
    pub(super) fn take_back(&mut self, undo: &MeshUndo) {
        let mut change = std::mem::take(&mut self.scratch.change);
        change.clear();
        for tet in (undo.before.tets..self.topology.n_tets()).rev().map(TetId::from_index) {
            if self.topology.is_live_tet(tet) {
                self.topology.take_out(tet, &mut change);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::box_mesh::box_of_five;
    use crate::mesh::edit::TopologyChange;

    #[test]
    fn saving_a_removal_needs_no_more_room_than_was_reserved() {
        let mut body = EditableMesh::new(box_of_five([3; 3], DVec3::ONE)).expect("a mesh");
        let before = body.clone();
        let mut change = TopologyChange::with_room_for_removals(1);
        let mut journal = Vec::new();
        for tet in before.topology().live_tets() {
            let mut undo = MeshUndo::with_room_for_removals(1);
            let room = undo.removed.capacity();
            body.remove_saving(&[tet], &mut change, &mut undo).expect("it is live");
            assert_eq!((undo.removed.capacity(), undo.moved.capacity()), (room, 0));
            journal.push(undo);
        }
        for undo in journal.iter().rev() {
            body.undo(undo);
        }
        assert!(body == before);
    }

    #[test]
    #[should_panic(expected = "last in, first out")]
    fn taking_back_out_of_order_is_a_bug() {
        let mut body = EditableMesh::new(box_of_five([1; 3], DVec3::ONE)).expect("a mesh");
        let (mut change, mut first, mut second) =
            (TopologyChange::default(), MeshUndo::default(), MeshUndo::default());
        body.remove_saving(&[TetId(0)], &mut change, &mut first).expect("it is live");
        body.remove_saving(&[TetId(1)], &mut change, &mut second).expect("it is live");
        body.undo(&first);
    }
}
