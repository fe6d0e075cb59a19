//! One edit or a list of edits as one change, with what it takes to take it back.

use std::borrow::Borrow;

use super::plan::Plan;
use super::replace::Exchange;
use super::{EditError, EditableMesh, MeshEdit, MeshUndo, TopologyChange};
use crate::fault;
use crate::mesh::change::MeshEntity;
use crate::mesh::{NodeId, TetId};

impl EditableMesh {
    /// [`EditableMesh::apply_into`], with what it takes to take the edit back in `undo`. A removal allocates
    /// nothing if both have room ([`MeshUndo::with_room_for_removals`]).
    ///
    /// # Errors
    /// [`EditError`] if the edit cannot be done; nothing changed then, `change` and `undo` are empty.
    pub fn apply_saving(
        &mut self,
        edit: &MeshEdit,
        change: &mut TopologyChange,
        undo: &mut MeshUndo,
    ) -> Result<(), EditError> {
        self.begin(change);
        undo.start(&self.topology);
        self.carry_out(edit, change, undo)?;
        if let Err(fault) = fault::check("mesh: after an edit") {
            self.take_back(undo);
            self.begin(change);
            undo.start(&self.topology);
            return Err(fault.into());
        }
        self.close(change);
        undo.close(&self.topology);
        Ok(())
    }

    /// A list of edits as one: each in the numbering left by those before it, where what comes in continues the
    /// numbering. What comes in and goes again within the list is not part of the change; if that leaves gaps
    /// among the new ids, they are closed in the end, in the same order, and
    /// [`provisional_ids`](super::EntityChange::provisional_ids) says what became of which id.
    ///
    /// # Errors
    /// [`EditError::InList`] if one of them cannot be done; then none is, `change` and `undo` are empty.
    pub fn apply_all_saving(
        &mut self,
        edits: &[MeshEdit],
        change: &mut TopologyChange,
        undo: &mut MeshUndo,
    ) -> Result<(), EditError> {
        let mut edits = edits.iter();
        self.apply_each_saving(change, undo, |_, _| edits.next())
    }

    /// [`EditableMesh::apply_all_saving`] for edits that are made one by one: `next` sees what those before have
    /// left and how many there were, and returns `None` when there are no more.
    ///
    /// # Errors
    /// As for a list.
    pub fn apply_each_saving<E: Borrow<MeshEdit>>(
        &mut self,
        change: &mut TopologyChange,
        undo: &mut MeshUndo,
        mut next: impl FnMut(&Self, usize) -> Option<E>,
    ) -> Result<(), EditError> {
        self.begin(change);
        undo.start(&self.topology);
        self.scratch.moved = Some(Vec::new());
        let mut at = 0;
        while let Some(edit) = next(self, at) {
            let edit = edit.borrow();
            let done = self.carry_out(edit, change, undo);
            let done = done.and_then(|()| Ok(fault::check("mesh: after an edit of a list")?));
            if let Err(cause) = done {
                self.take_back(undo);
                self.begin(change);
                undo.start(&self.topology);
                self.scratch.moved = None;
                return Err(EditError::InList { at, edit: edit.name(), cause: Box::new(cause) });
            }
            at += 1;
        }
        self.scratch.moved = None;
        self.close(change);
        undo.close(&self.topology);
        Ok(())
    }

    fn carry_out(
        &mut self,
        edit: &MeshEdit,
        change: &mut TopologyChange,
        undo: &mut MeshUndo,
    ) -> Result<(), EditError> {
        fault::check("mesh: before an edit")?;
        if let MeshEdit::Remove { tets } = edit {
            self.topology.check_removable(tets)?;
            for &tet in tets {
                self.topology.detach_tet(tet, change);
                undo.save_removal(tet);
            }
            return Ok(());
        }
        let mut plan = std::mem::take(&mut self.scratch.plan);
        plan.start(self);
        let planned = self.plan(edit, &mut plan);
        if planned.is_ok() {
            let n_outer = self.topology.n_surface_triangles();
            self.carry_out_plan(&plan, change, undo);
            if may_part(edit) {
                // Copies of nodes divide no triangle: without more of them outside, none was opened.
                let opened =
                    matches!(edit, MeshEdit::Replace(_)) || n_outer != self.topology.n_surface_triangles();
                self.judge_pieces(&plan, opened, change);
            }
        }
        self.scratch.plan = plan;
        planned
    }

    /// Works out an edit and checks it.
    fn plan(&mut self, edit: &MeshEdit, plan: &mut Plan) -> Result<(), EditError> {
        match edit {
            MeshEdit::Remove { .. } => Ok(()),
            MeshEdit::DuplicateVertex { node, tets_of_copy } => {
                self.plan_copies(&[(*node, tets_of_copy)], plan)
            }
            MeshEdit::DuplicateVertices { copies } => {
                let copies: Vec<(NodeId, &[TetId])> =
                    copies.iter().map(|c| (c.node, c.tets.as_slice())).collect();
                self.plan_copies(&copies, plan)
            }
            MeshEdit::MoveVertex { node, position_m } => self.plan_move(*node, *position_m, plan),
            MeshEdit::Split { edges } => self.plan_split(edges, plan),
            MeshEdit::Collapse { edge, kept, position_m } => {
                self.plan_collapse(*edge, *kept, *position_m, plan)
            }
            MeshEdit::Retetrahedralise { tets, new_nodes, new_tets } => {
                let new_tets = new_tets.iter().map(|&corners| (corners, [].as_slice())).collect();
                let exchange =
                    Exchange { tets, new_nodes, moved_nodes: &[], new_tets, keeps_outer_triangles: true };
                self.plan_exchange(&exchange, plan)
            }
            MeshEdit::Replace(replacement) => self.plan_exchange(&replacement.into(), plan),
        }
    }

    /// Brings the lists of `change` in order and closes gaps among the new ids.
    fn close(&mut self, change: &mut TopologyChange) {
        if change.has_gaps() {
            self.close_gaps(change);
        }
        change.close();
        if !change.moved_nodes.is_empty() {
            let from = std::mem::take(&mut change.moved_from_m).into_iter();
            let from = from.zip(std::mem::take(&mut change.moved_parents));
            let moved = std::mem::take(&mut change.moved_nodes).into_iter().zip(from);
            let mut moved: Vec<_> = moved.filter(|m| self.topology.is_live_node(m.0)).collect();
            moved.sort_by_key(|m| m.0);
            for (node, (from_m, parents)) in moved {
                change.moved_nodes.push(node);
                change.moved_from_m.push(from_m);
                change.moved_parents.push(parents);
            }
            let n_before = change.tets.n_before;
            let at_moved = change.moved_nodes.iter().flat_map(|&node| self.topology.node_tets(node));
            change.reshaped_tets.extend(at_moved.filter(|tet| tet.index() < n_before));
            change.reshaped_tets.sort_unstable();
            change.reshaped_tets.dedup();
        }
        change.set_counts_after(self.topology.lengths());
    }

    /// Takes everything new out and what is left of it in again, under ids without gaps.
    fn close_gaps(&mut self, change: &mut TopologyChange) {
        let before = change.lengths_before();
        let mut left = Plan::default();
        left.start(self);
        for (tet, parents) in change.tets.added.iter() {
            if self.topology.is_live_tet(tet) {
                left.add_tet(self.topology.tet_nodes(tet), parents);
            }
        }
        number_kept(&mut change.tets.provisional_ids, before.tets, change.tets.added.ids(), |t| {
            self.topology.is_live_tet(t)
        });
        number_kept(&mut change.nodes.provisional_ids, before.nodes, change.nodes.added.ids(), |n| {
            self.topology.is_live_node(n)
        });
        for (node, parents) in change.nodes.added.iter() {
            if self.topology.is_live_node(node) {
                left.add_node(self.mesh.positions_m[node.index()], parents);
            }
        }
        let new_ids = &change.nodes.provisional_ids;
        for node in left.fresh.iter_mut().flatten() {
            if let Some(at) = node.index().checked_sub(before.nodes) {
                *node = new_ids[at].expect("corners of live tetrahedra are live");
            }
        }
        for at in 0..change.tets.added.ids().len() {
            let tet = change.tets.added.ids()[at];
            if self.topology.is_live_tet(tet) {
                self.topology.take_out(tet, change);
            }
        }
        self.topology.truncate(before);
        self.mesh.tetrahedra.truncate(before.tets);
        self.mesh.positions_m.truncate(before.nodes);
        change.forget_additions();
        let mut waiting = std::mem::take(&mut self.scratch.waiting);
        waiting.set(&self.topology, &change.edges.removed, &change.triangles.removed);
        for ((_, parents), &position_m) in left.node_parents.iter().zip(&left.new_nodes_m) {
            let node = self.topology.push_node();
            self.mesh.positions_m.push(position_m);
            change.nodes.added.push(node, parents);
        }
        for (&corners, (_, parents)) in left.fresh.iter().zip(left.fresh_parents.iter()) {
            let tet = self.topology.add_tet(corners, &mut waiting, change);
            self.mesh.tetrahedra.push(corners);
            change.tets.added.push(tet, parents);
        }
        self.scratch.waiting = waiting;
        self.forget_revived([0; 3], change);
    }
}

/// Whether an edit can part what hangs together. The others leave the faces that hold a piece together, and its
/// nodes, as connected as they were.
fn may_part(edit: &MeshEdit) -> bool {
    match edit {
        MeshEdit::DuplicateVertex { .. } | MeshEdit::DuplicateVertices { .. } | MeshEdit::Replace(_) => true,
        MeshEdit::Remove { .. }
        | MeshEdit::MoveVertex { .. }
        | MeshEdit::Split { .. }
        | MeshEdit::Collapse { .. }
        | MeshEdit::Retetrahedralise { .. } => false,
    }
}

fn number_kept<I: MeshEntity>(
    new_ids: &mut Vec<Option<I>>,
    n_before: usize,
    added: &[I],
    is_live: impl Fn(I) -> bool,
) {
    let mut next = n_before;
    new_ids.clear();
    new_ids.extend(added.iter().map(|&id| {
        is_live(id).then(|| {
            next += 1;
            I::from_index(next - 1)
        })
    }));
}
