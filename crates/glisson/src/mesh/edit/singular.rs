//! Parting a solid where it hangs together by a node or an edge alone.

use super::{EdgeSplit, EditError, EditableMesh, MeshEdit, MeshUndo, TopologyChange, VertexCopy};
use crate::mesh::topology::{StarGroups, Topology};
use crate::mesh::{NodeId, TetId};

/// Rounds of [`EditableMesh::parting_edit`] that are worth trying: copies, divided edges, copies of their middles.
const MOST_ROUNDS: usize = 4;

impl Topology {
    /// Live nodes of the tetrahedra that `change` took out or brought in, ascending: where singular places can
    /// have come about.
    pub fn nodes_near(&self, change: &TopologyChange) -> Vec<NodeId> {
        let tets = change.tets.removed.iter().chain(change.tets.added.ids());
        let mut nodes: Vec<NodeId> = tets.flat_map(|&t| self.tet_nodes(t)).collect();
        nodes.sort_unstable();
        nodes.dedup();
        nodes.retain(|&n| self.is_live_node(n));
        nodes
    }
}

impl EditableMesh {
    /// The next edit that parts the singular ones among `nodes` and the edges at them
    /// ([`Topology::singular_entities`]); `None` if there are none. A node whose tetrahedra fall into groups
    /// keeps the first group, the others get copies. An edge at whose ends the groups still hang together gets a
    /// node in its middle, which is to be among `nodes` the next time.
    pub fn parting_edit(&self, nodes: &[NodeId]) -> Option<MeshEdit> {
        let topology = self.topology();
        let singular = topology.singular_entities(nodes);
        let mut groups = StarGroups::default();
        let mut copies = Vec::new();
        for &node in &singular.nodes {
            topology.star_groups_into(node, &mut groups);
            for group in 1..groups.count as u32 {
                let star = topology.node_tets(node).iter().zip(&groups.of_tet);
                let tets = star.filter(|(_, of_tet)| **of_tet == group).map(|(&tet, _)| tet).collect();
                copies.push(VertexCopy { node, tets });
            }
        }
        if !copies.is_empty() {
            return Some(MeshEdit::DuplicateVertices { copies });
        }
        let edges = singular.edges.iter().map(|&edge| EdgeSplit { edge, fraction: 0.5 });
        (!singular.edges.is_empty()).then(|| MeshEdit::Split { edges: edges.collect() })
    }

    /// Parts what hangs together by a node or an edge alone at `nodes`, as one edit that can be taken back.
    /// Nothing changes, and `change` says so, if there is no such place.
    ///
    /// # Errors
    /// [`EditError::InList`] if an edge is too short to be divided; nothing changed then.
    pub fn part_singular_entities_saving(
        &mut self,
        nodes: &[NodeId],
        change: &mut TopologyChange,
        undo: &mut MeshUndo,
    ) -> Result<(), EditError> {
        let mut next = self.partings(nodes.to_vec());
        self.apply_each_saving(change, undo, &mut next)
    }

    /// The edits that part what is singular at `near` and at the nodes that come with them, one round after the other: for
    /// [`EditableMesh::apply_each_saving`].
    fn partings(&self, mut near: Vec<NodeId>) -> impl FnMut(&Self, usize) -> Option<MeshEdit> + use<> {
        let mut n_known = self.topology.n_nodes();
        move |body, at| {
            near.extend((n_known..body.topology.n_nodes()).map(NodeId::from_index));
            n_known = body.topology.n_nodes();
            if at < MOST_ROUNDS { body.parting_edit(&near) } else { None }
        }
    }

    /// The removal of `tets`, followed by the edits that part the singular places which it leaves, as far as they can be
    /// parted: a list for [`EditableMesh::apply_all_saving`]. The mesh is as it was afterwards.
    ///
    /// # Errors
    /// As for the removal alone.
    pub fn parting_removal(&mut self, tets: Vec<TetId>) -> Result<Vec<MeshEdit>, EditError> {
        let mut edits = vec![MeshEdit::Remove { tets }];
        let (mut change, mut undo_removal) = (TopologyChange::default(), MeshUndo::default());
        self.apply_saving(&edits[0], &mut change, &mut undo_removal)?;
        edits.append(&mut self.parting_edits(self.topology.nodes_near(&change)));
        self.undo(&undo_removal);
        Ok(edits)
    }
    /// The edits that part what hangs together by a node or an edge alone at `nodes`, as far as it can be parted: a list
    /// for [`EditableMesh::apply_all_saving`], empty without such a place. Nothing is taken out: nodes get copies, an edge a
    /// node in its middle. The mesh is as it was afterwards.
    pub fn parting_edits(&mut self, nodes: Vec<NodeId>) -> Vec<MeshEdit> {
        let mut next = self.partings(nodes);
        let (mut partings, mut change, mut undo) =
            (Vec::new(), TopologyChange::default(), MeshUndo::default());
        let done = self.apply_each_saving(&mut change, &mut undo, |body, at| {
            let edit = next(body, at);
            partings.extend(edit.clone());
            edit
        });
        match done {
            Ok(()) => self.undo(&undo),
            // What came before the edge that is too short to be divided can be done without it.
            Err(EditError::InList { at, .. }) => partings.truncate(at),
            Err(_) => partings.clear(),
        }
        partings
    }
}
