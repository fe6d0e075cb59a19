//! Edits of the organ's mesh, as transactions: the mesh, the model, the supports, the surface, loads, contacts, grasps and
//! vessels follow together, or nothing changes. The last edits can be undone, last in, first out; every number has
//! its bits from before.

use super::refusal::EditRefusal;
use super::transaction::{EditRecord, are_finer};
use super::{QueuedSwap, World};
use crate::mesh::edit::{EditableMesh, MeshEdit, MeshUndo, TopologyChange};
use crate::mesh::refine::{FineRegion, refining};
use crate::mesh::repair::{MendParams, mending};
use crate::mesh::{NodeId, TetId, TetMesh};
use crate::model::{DeformableModel, TopologyRefusal};
use std::collections::VecDeque;

/// Radius of a region that is made finer around a tool, in edges as they are there: a choice.
const EDGES_TO_REFINE: f64 = 2.0;

/// Edits that can be undone, unless told otherwise: a choice.
const UNDO_DEPTH: usize = 32;
/// Of these, edits for which the model had to be copied whole, which can take a hundred megabytes each: a choice.
const MOST_WHOLE_COPIES: usize = 2;

/// The last edits, and those of the whole run in short.
pub(super) struct Journal {
    records: VecDeque<EditRecord>,
    spare: Vec<EditRecord>,
    depth: usize,
    /// What a model that is made from the organ of the start has to follow: first the tetrahedra that were removed before
    /// any other edit, in the order in which they went; there are no more of them than the organ had ...
    removed: Vec<TetId>,
    /// ... then all edits that stand from the first on that was no removal. They grow with the mesh, whose numbers
    /// only grow as well.
    later: Vec<Vec<MeshEdit>>,
    /// What edits did, if somebody wants to know.
    changes: Option<Vec<TopologyChange>>,
    /// No change.
    nothing: TopologyChange,
}

impl Journal {
    pub(super) fn new() -> Self {
        Self {
            records: VecDeque::new(),
            spare: Vec::new(),
            depth: UNDO_DEPTH,
            removed: Vec::new(),
            later: Vec::new(),
            changes: None,
            nothing: TopologyChange::default(),
        }
    }

    /// The same edits, of which none can be undone: their saved values belong to another world.
    pub(super) fn without_undo(&self) -> Self {
        let (removed, later) = (self.removed.clone(), self.later.clone());
        let changes = self.changes.as_ref().map(|_| Vec::new());
        Self { depth: self.depth, removed, later, changes, ..Self::new() }
    }

    /// No edit so far can be undone any more.
    pub(super) fn forget_undo(&mut self) {
        self.spare.extend(self.records.drain(..));
    }

    /// What was saved of a model that waits belongs to one that does not wait any more.
    pub(super) fn forget_waiting(&mut self) {
        self.records.iter_mut().for_each(|record| record.waiting = None);
    }

    /// Notes an edit that was made; answers how many tetrahedra joined those that were removed first.
    fn note(&mut self, edits: &[MeshEdit]) -> usize {
        let is_removal = |edit: &MeshEdit| matches!(edit, MeshEdit::Remove { .. });
        if !self.later.is_empty() || !edits.iter().all(is_removal) {
            self.later.push(edits.to_vec());
            return 0;
        }
        let n_before = self.removed.len();
        for edit in edits {
            if let MeshEdit::Remove { tets } = edit {
                self.removed.extend_from_slice(tets);
            }
        }
        self.removed.len() - n_before
    }

    /// Keeps an edit that was made; answers what it did.
    fn keep(&mut self, edits: &[MeshEdit], mut record: EditRecord) -> &TopologyChange {
        record.n_removed_first = self.note(edits);
        if let Some(changes) = &mut self.changes {
            changes.push(record.change.clone());
        }
        self.records.push_back(record);
        self.shorten();
        // With a depth of 0 the record went to the spare ones.
        let last = self.records.back().or(self.spare.last());
        last.map_or(&self.nothing, |record| &record.change)
    }

    /// The last edit was undone.
    fn forget_last(&mut self, record: &EditRecord) {
        if self.later.pop().is_none() {
            let n_left = self.removed.len().saturating_sub(record.n_removed_first);
            self.removed.truncate(n_left);
        }
    }

    /// Keeps to the depth, and few whole copies.
    fn shorten(&mut self) {
        while self.records.len() > self.depth {
            self.spare.extend(self.records.pop_front());
        }
        let is_whole = |record: &EditRecord| record.model.keeps_whole();
        if let Some(oldest) =
            self.records.iter().rev().enumerate().filter(|(_, r)| is_whole(r)).nth(MOST_WHOLE_COPIES)
        {
            let n_kept = oldest.0;
            let n_gone = self.records.len() - n_kept;
            self.spare.extend(self.records.drain(..n_gone));
        }
        // A whole copy is not kept for its buffers.
        for spare in &mut self.spare {
            spare.model.clear();
            spare.waiting = None;
        }
    }
}

impl World {
    /// Edits the organ's mesh. Contacts on triangles that are still there and grasps of nodes that are hold on.
    ///
    /// # Errors
    /// [`EditRefusal`] when the model or the mesh cannot; nothing changed then.
    pub fn edit(&mut self, edit: &MeshEdit) -> Result<TopologyChange, EditRefusal> {
        self.edit_in_place(std::slice::from_ref(edit)).cloned()
    }

    /// A list of edits as one ([`EditableMesh::apply_all_saving`]).
    ///
    /// # Errors
    /// As [`World::edit`]; a list is made whole or not at all.
    pub fn edit_all(&mut self, edits: &[MeshEdit]) -> Result<TopologyChange, EditRefusal> {
        self.edit_in_place(edits).cloned()
    }

    /// Takes tetrahedra out and parts what then hangs together by a node or an edge alone, as one edit
    /// ([`EditableMesh::parting_removal`]). Models that follow nothing but removals keep such places.
    ///
    /// # Errors
    /// As [`World::edit`].
    pub fn remove_and_part(&mut self, tets: Vec<TetId>) -> Result<(), EditRefusal> {
        let edits = self.organ.body_mut().parting_removal(tets)?;
        match self.edit_in_place(&edits) {
            Err(EditRefusal::Model(_)) if edits.len() > 1 => self.edit_in_place(&edits[..1]).map(|_| ()),
            done => done.map(|_| ()),
        }
    }

    /// Parts what hangs together by a node or an edge alone at `nodes`, as one edit that takes nothing out
    /// ([`EditableMesh::parting_edits`]); answers whether there was such a place.
    ///
    /// # Errors
    /// As [`World::edit`].
    pub fn part_singular_places(&mut self, nodes: &[NodeId]) -> Result<bool, EditRefusal> {
        let live = self.live_among(nodes);
        let edits = self.organ.body_mut().parting_edits(live);
        if edits.is_empty() {
            return Ok(false);
        }
        self.edit_in_place(&edits).map(|_| true)
    }

    /// Those that the mesh has now; an edit that was undone may have taken some with it.
    fn live_among(&self, nodes: &[NodeId]) -> Vec<NodeId> {
        let topology = self.organ.body().topology();
        let is_live = |n: &NodeId| n.index() < topology.n_nodes() && topology.is_live_node(*n);
        nodes.iter().copied().filter(is_live).collect()
    }

    /// Whether each node is held, loaded or at a ligament: cuts and mending leave it where it is.
    pub(super) fn anchored_nodes(&self) -> impl Iterator<Item = bool> + '_ {
        (0..self.organ.body().topology().n_nodes()).map(|n| {
            let node = NodeId::from_index(n);
            let is_from_start = self.anchored_at_start.get(n).copied().unwrap_or(false);
            is_from_start || self.organ.is_fixed(node) || self.loads.has(node)
        })
    }

    /// Mends the worst tetrahedra at `nodes` as one edit ([`mending`]); answers how many places got better. The surface, cuts
    /// included, stays, and so do nodes that are held, loaded or at a ligament.
    ///
    /// # Errors
    /// As [`World::edit`].
    pub fn mend(&mut self, nodes: &[NodeId]) -> Result<usize, EditRefusal> {
        let topology = self.organ.body().topology();
        let live = self.live_among(nodes).into_iter();
        let mut tets: Vec<TetId> = live.flat_map(|n| topology.node_tets(n)).copied().collect();
        tets.sort_unstable();
        tets.dedup();
        let stays: Vec<bool> = self.anchored_nodes().collect();
        let is_still = |node: NodeId| stays.get(node.index()).copied().unwrap_or(false);
        let mending = mending(self.organ.body_mut(), &tets, &MendParams::default(), &is_still);
        if mending.edits.is_empty() {
            return Ok(0);
        }
        self.edit_in_place(&mending.edits)?;
        Ok(mending.n_remeshed + mending.n_collapsed)
    }

    /// Makes a region of the organ finer while it is simulated, as one edit (seed `003` s. 3.5); answers how many edges
    /// were divided, none where it is fine enough.
    ///
    /// # Errors
    /// As [`World::edit`].
    pub fn refine(&mut self, region: &FineRegion) -> Result<usize, EditRefusal> {
        let edits = refining(self.organ.body_mut(), region)?;
        if edits.is_empty() {
            return Ok(0);
        }
        self.edit_in_place(&edits)?;
        let n_split = |edit: &MeshEdit| if let MeshEdit::Split { edges } = edit { edges.len() } else { 0 };
        Ok(edits.iter().map(n_split).sum())
    }

    /// A region at rest around the tissue that is nearest to a tool's tip, with edges half as long as they are there now;
    /// `None` if the tip is further from the surface than that region is wide, or there is no such tool.
    pub fn finer_region_at(&self, tool: usize) -> Option<FineRegion> {
        self.tool_states.get(tool)?;
        let tip_m = self.pose_on_mesh(tool).tip_in_world_m;
        let (topology, positions_m) = (self.organ.body().topology(), self.organ.positions_m());
        let rest_m = &self.organ.mesh().positions_m;
        let away_m = |node: NodeId| positions_m[node.index()].distance(tip_m);
        let nearest = topology.surface_nodes().min_by(|&a, &b| away_m(a).total_cmp(&away_m(b)))?;
        let edges = topology.node_edges(nearest);
        let lengths_m = edges.iter().map(|&edge| {
            let [a, b] = topology.edge_nodes(edge).map(|n| rest_m[n.index()]);
            a.distance(b)
        });
        let longest_m = lengths_m.fold(0.0, f64::max);
        let region = FineRegion {
            center_m: rest_m[nearest.index()],
            radius_m: EDGES_TO_REFINE * longest_m,
            edge_m: 0.5 * longest_m,
        };
        (away_m(nearest) <= region.radius_m).then_some(region)
    }

    /// [`World::edit_all`] without a copy of the change.
    ///
    /// # Errors
    /// As [`World::edit`].
    pub fn edit_in_place(&mut self, edits: &[MeshEdit]) -> Result<&TopologyChange, EditRefusal> {
        if let Some(refusal) = self.model.topology_refusal() {
            return Err(refusal.into());
        }
        let waiting = self.swap.as_ref().and_then(|swap| swap.model.as_ref());
        if let Some(refusal) = waiting.and_then(|model| model.topology_refusal()) {
            return Err(refusal.into());
        }
        let mut record = self.journal.spare.pop().unwrap_or_default();
        if let Err(refusal) = self.transact(edits, &mut record) {
            self.journal.spare.push(record);
            return Err(refusal);
        }
        Ok(self.journal.keep(edits, record))
    }

    /// Undoes the last edit, and an order of a model that was not delivered yet: mesh, model, supports, loads and vessels are what they were just before it, bit for bit,
    /// and so are contacts and grasps if no step was made since; else they are let go, because the organ is back where
    /// it was and the tools are not. Answers whether there was one to take back: as many as
    /// [`World::n_edits_to_undo`] says.
    pub fn undo_edit(&mut self) -> bool {
        let Some(mut record) = self.journal.records.pop_back() else { return false };
        self.undo_record(&mut record);
        self.journal.forget_last(&record);
        self.journal.spare.push(record);
        self.journal.shorten();
        true
    }

    /// How many edits can be undone.
    pub fn n_edits_to_undo(&self) -> usize {
        self.journal.records.len()
    }

    /// Keeps what each edit from now on does, also those of the tools, for [`World::take_changes`].
    pub fn keep_changes(&mut self) {
        self.journal.changes.get_or_insert_default();
    }

    /// What edits did since the last call, in their order; none unless [`World::keep_changes`] was called. One that was taken
    /// back since is among them.
    pub fn take_changes(&mut self) -> Vec<TopologyChange> {
        self.journal.changes.as_mut().map(std::mem::take).unwrap_or_default()
    }

    /// How many edits can be undone from now on at most. An edit of a model that has to be copied for it costs its
    /// memory; of these only the last two are kept.
    pub fn set_undo_depth(&mut self, depth: usize) {
        self.journal.depth = depth;
        self.journal.shorten();
    }

    /// Lets a model that was made from the organ of the start follow all edits that stand.
    pub(super) fn bring_up_to_date(&self, model: &mut dyn DeformableModel) -> Result<(), EditRefusal> {
        let Journal { removed, later, .. } = &self.journal;
        let (n_nodes, n_nodes_before) =
            (model.state().positions_m.len(), self.mesh_of_the_start.positions_m.len());
        if n_nodes != n_nodes_before {
            return Err(TopologyRefusal::OtherNodes { n_nodes, n_nodes_before }.into());
        }
        if removed.is_empty() && later.is_empty() {
            return Ok(());
        }
        if let Some(refusal) = model.topology_refusal() {
            return Err(refusal.into());
        }
        let mut whole = EditableMesh::new(TetMesh::clone(&self.mesh_of_the_start))?;
        let mut change = TopologyChange::default();
        if !removed.is_empty() {
            // All at once: a pre-computed model of what is left knows them already.
            let mut tets: Vec<TetId> = removed.clone();
            tets.sort_unstable();
            tets.dedup();
            whole.apply_into(&MeshEdit::Remove { tets }, &mut change)?;
            model.topology_changed(whole.mesh(), &change)?;
        }
        let mut undo = MeshUndo::default();
        for edits in later {
            match edits.as_slice() {
                [edit] => whole.apply_saving(edit, &mut change, &mut undo)?,
                _ => whole.apply_all_saving(edits, &mut change, &mut undo)?,
            }
            model.expect_finer_mesh(are_finer(edits));
            model.topology_changed(whole.mesh(), &change)?;
        }
        Ok(())
    }

    /// Whether the tetrahedra are those of the start, but for some that were taken out.
    pub fn has_only_removals(&self) -> bool {
        self.journal.later.is_empty()
    }

    pub(super) fn order_of(swap: Option<&QueuedSwap>) -> Option<QueuedSwap> {
        swap.map(|swap| QueuedSwap {
            at_step: swap.at_step,
            kind: swap.kind,
            model: swap.model.as_ref().map(|model| model.duplicate()),
        })
    }
}
