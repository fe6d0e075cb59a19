//! New nodes at the places of old ones, for part of their tetrahedra: faces and edges open.

use super::plan::Plan;
use super::{EditError, EditableMesh};
use crate::mesh::{NodeId, TetId};

impl EditableMesh {
    pub(super) fn plan_copies(
        &mut self,
        copies: &[(NodeId, &[TetId])],
        plan: &mut Plan,
    ) -> Result<(), EditError> {
        // Tetrahedron, its old node, the copy that takes its place.
        let mut takes: Vec<(TetId, NodeId, NodeId)> = Vec::new();
        // Node, number of tetrahedra that go to copies of it.
        let mut taken: Vec<(NodeId, usize)> = Vec::with_capacity(copies.len());
        for &(node, tets) in copies {
            self.check_node(node)?;
            self.topology.check_removable(tets)?;
            let n_tets = self.topology.node_tets(node).len();
            if tets.is_empty() {
                return Err(EditError::NoPartOfStar { node, n_copied: 0, n_tets });
            }
            let copy = plan.add_node(self.mesh.positions_m[node.index()], &[(node, 1.0)]);
            for &tet in tets {
                if !self.topology.tet_nodes(tet).contains(&node) {
                    return Err(EditError::NotAtNode { tet, node });
                }
                takes.push((tet, node, copy));
            }
            taken.push((node, tets.len()));
        }
        takes.sort_unstable();
        if let Some(pair) = takes.windows(2).find(|pair| (pair[0].0, pair[0].1) == (pair[1].0, pair[1].1)) {
            return Err(EditError::RepeatedTet { tet: pair[0].0 });
        }
        taken.sort_unstable();
        for of_node in taken.chunk_by(|a, b| a.0 == b.0) {
            let (node, n_copied) = (of_node[0].0, of_node.iter().map(|t| t.1).sum());
            let n_tets = self.topology.node_tets(node).len();
            if n_copied >= n_tets {
                return Err(EditError::NoPartOfStar { node, n_copied, n_tets });
            }
        }
        for of_tet in takes.chunk_by(|a, b| a.0 == b.0) {
            let tet = of_tet[0].0;
            let corners = self
                .topology
                .tet_nodes(tet)
                .map(|corner| of_tet.iter().find(|t| t.1 == corner).map_or(corner, |t| t.2));
            plan.doomed.push(tet);
            plan.add_tet(corners, &[(tet, 1.0)]);
        }
        Ok(())
    }
}
