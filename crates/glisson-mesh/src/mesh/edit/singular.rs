//! Parting a solid where it hangs together by a node or an edge alone.

use super::{EdgeSplit, EditError, EditableMesh, MeshEdit, MeshUndo, TopologyChange, VertexCopy};
use crate::mesh::topology::{StarGroups, Topology};
use crate::mesh::{NodeId, TetId};

/// Rounds of [`EditableMesh::parting_edits`] that are worth trying: copies, divided edges, copies of their middles, and what
/// these leave.
const MOST_ROUNDS: usize = 8;

impl Topology {
    /// Live nodes of the tetrahedra that `change` took out, brought in or gave another shape, ascending: where singular
    /// places and bad shapes can have come about.
    pub fn nodes_near(&self, change: &TopologyChange) -> Vec<NodeId> {
        let tets = change.tets.removed.iter().chain(change.tets.added.ids()).chain(&change.reshaped_tets);
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
    /// node in its middle, unless it is too short for that. The mesh is as it was afterwards.
    pub fn parting_edits(&mut self, nodes: Vec<NodeId>) -> Vec<MeshEdit> {
        let (mut near, mut n_known) = (nodes, self.topology.n_nodes());
        let (mut done, mut undos) = (Vec::new(), Vec::new());
        for _ in 0..MOST_ROUNDS {
            near.extend((n_known..self.topology.n_nodes()).map(NodeId::from_index));
            n_known = self.topology.n_nodes();
            let Some(edit) = self.parting_edit(&near) else { break };
            let n_before = done.len();
            // An edge that is too short to be divided keeps the others from nothing.
            let alone = match &edit {
                MeshEdit::Split { edges } if edges.len() > 1 => edges.clone(),
                _ => Vec::new(),
            };
            let one_by_one = alone.into_iter().map(|edge| MeshEdit::Split { edges: vec![edge] });
            for (at, edit) in std::iter::once(edit).chain(one_by_one).enumerate() {
                let (mut change, mut undo) = (TopologyChange::default(), MeshUndo::default());
                if self.apply_saving(&edit, &mut change, &mut undo).is_ok() {
                    done.push(edit);
                    undos.push(undo);
                    if at == 0 {
                        break;
                    }
                }
            }
            if done.len() == n_before {
                break;
            }
        }
        undos.iter().rev().for_each(|undo| self.undo(undo));
        done
    }
}
