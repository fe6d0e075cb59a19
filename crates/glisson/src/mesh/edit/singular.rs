//! Parting a solid where it hangs together by a node or an edge alone.

use super::{EdgeSplit, EditError, EditableMesh, MeshEdit, MeshUndo, TopologyChange, VertexCopy};
use crate::mesh::NodeId;
use crate::mesh::topology::{StarGroups, Topology};

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
        let n_before = self.topology.n_nodes();
        let mut near = nodes.to_vec();
        self.apply_each_saving(change, undo, |body, at| {
            let known = near.len() - nodes.len();
            near.extend((n_before + known..body.topology.n_nodes()).map(NodeId::from_index));
            if at < MOST_ROUNDS { body.parting_edit(&near) } else { None }
        })
    }
}
