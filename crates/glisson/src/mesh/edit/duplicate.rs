//! New nodes at the places of old ones, for part of their tetrahedra: faces and edges open.

use super::plan::Plan;
use super::{EditError, EditableMesh, MeshEdit, TopologyChange};
use crate::mesh::{NodeId, TetId};

/// What it takes to judge whether copies of nodes have cut a piece in two.
pub(super) struct Opened {
    /// Each new node with the one it is a copy of.
    copies: Vec<(NodeId, NodeId)>,
    /// For each tetrahedron that comes in: which of its faces were on the surface before.
    was_surface: Vec<[bool; 4]>,
}

impl Opened {
    fn original(&self, node: NodeId) -> NodeId {
        self.copies.iter().find(|c| c.0 == node).map_or(node, |c| c.1)
    }
}

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

    /// What [`EditableMesh::judge_pieces`] must know from before an edit; `None` if the edit cannot part pieces.
    pub(super) fn opened_by(&self, edit: &MeshEdit, plan: &Plan) -> Option<Opened> {
        if !matches!(edit, MeshEdit::DuplicateVertex { .. } | MeshEdit::DuplicateVertices { .. }) {
            return None;
        }
        let copies = plan.node_parents.iter().map(|(copy, parents)| (copy, parents[0].0)).collect();
        let on_surface = |tet: &TetId| {
            self.topology.tet_triangles(*tet).map(|triangle| self.topology.is_surface_triangle(triangle))
        };
        Some(Opened { copies, was_surface: plan.doomed.iter().map(on_surface).collect() })
    }

    /// Judges on the spot whether a piece may have come apart: the two sides of an opened face hang together
    /// by faces if they still share an edge whose tetrahedra form a single fan, and the two stars of a node and
    /// its copy hang together by nodes if they share another node.
    pub(super) fn judge_pieces(&self, opened: &Opened, change: &mut TopologyChange) {
        let topology = &self.topology;
        let n_fresh = opened.was_surface.len();
        for (at, was_surface) in opened.was_surface.iter().enumerate() {
            let tet = TetId::from_index(topology.n_tets() - n_fresh + at);
            for (triangle, was_surface) in topology.tet_triangles(tet).into_iter().zip(was_surface) {
                if *was_surface || !topology.is_surface_triangle(triangle) {
                    continue;
                }
                let originals = |t| {
                    let mut nodes = topology.triangle_nodes(t).map(|n| opened.original(n));
                    nodes.sort_unstable();
                    nodes
                };
                let sides_meet = topology.triangle_edges(triangle).into_iter().any(|edge| {
                    !topology.is_pinched_edge(edge)
                        && topology
                            .surface_triangles_at_edge(edge)
                            .any(|other| other != triangle && originals(other) == originals(triangle))
                });
                change.pieces.through_faces.may_have_split |= !sides_meet;
            }
        }
        for &(copy, node) in &opened.copies {
            let stars_meet = topology.node_edges(copy).iter().any(|&edge| {
                let shared = topology.other_node(edge, copy);
                topology.edge_between(node, shared).is_some()
            });
            change.pieces.through_nodes.may_have_split |= !stars_meet;
        }
    }
}
