//! What an edit is going to do, worked out before anything changes, and the one way in which it is done.

use super::{EditError, EditableMesh, MeshUndo, NodeWeights, TopologyChange};
use crate::math::{DVec3, is_inverted, tetrahedron_volume_m3};
use crate::mesh::change::sum_repeated;
use crate::mesh::edit::Additions;
use crate::mesh::topology::Waiting;
use crate::mesh::{NodeId, TetId, TetMesh};

/// A node that moves.
pub(super) struct Move {
    pub(super) node: NodeId,
    /// Where to [m].
    pub(super) position_m: DVec3,
    /// Weights that give its new place from old places of nodes.
    pub(super) parents: NodeWeights,
    /// Whether they also say where it is in the deformed tissue.
    pub(super) is_blend: bool,
}

/// An edit in terms of tetrahedra that go and come. Nodes that come in are named by the ids that they will have.
#[derive(Default)]
pub(super) struct Plan {
    /// Tetrahedra that go.
    pub(super) doomed: Vec<TetId>,
    /// Corners of the tetrahedra that come.
    pub(super) fresh: Vec<[NodeId; 4]>,
    /// Their parents.
    pub(super) fresh_parents: Additions<TetId>,
    /// Where the new nodes are at rest [m].
    pub(super) new_nodes_m: Vec<DVec3>,
    /// Their parents.
    pub(super) node_parents: Additions<NodeId>,
    /// Nodes that move, ascending.
    pub(super) moved: Vec<Move>,
    n_nodes: usize,
    n_tets: usize,
}

impl Plan {
    /// A plan for `body` that does nothing yet.
    pub(super) fn start(&mut self, body: &EditableMesh) {
        self.doomed.clear();
        self.fresh.clear();
        self.fresh_parents.clear();
        self.new_nodes_m.clear();
        self.node_parents.clear();
        self.moved.clear();
        self.n_nodes = body.topology.n_nodes();
        self.n_tets = body.topology.n_tets();
    }

    /// The id that a new node will have.
    pub(super) fn add_node(&mut self, position_m: DVec3, parents: &[(NodeId, f64)]) -> NodeId {
        let node = NodeId::from_index(self.n_nodes + self.new_nodes_m.len());
        self.new_nodes_m.push(position_m);
        self.node_parents.push(node, parents);
        node
    }

    /// Adds a tetrahedron that comes.
    pub(super) fn add_tet(&mut self, corners: [NodeId; 4], parents: &[(TetId, f64)]) {
        let tet = TetId::from_index(self.n_tets + self.fresh.len());
        self.fresh.push(corners);
        self.fresh_parents.push(tet, parents);
    }

    /// Where `node` will be at rest [m].
    pub(super) fn position_m(&self, mesh: &TetMesh, node: NodeId) -> DVec3 {
        if let Some(at) = node.index().checked_sub(self.n_nodes) {
            return self.new_nodes_m[at];
        }
        match self.moved.binary_search_by_key(&node, |m| m.node) {
            Ok(at) => self.moved[at].position_m,
            Err(_) => mesh.positions_m[node.index()],
        }
    }

    /// Volume [m3] of a tetrahedron that comes.
    pub(super) fn volume_m3(&self, mesh: &TetMesh, corners: [NodeId; 4]) -> f64 {
        tetrahedron_volume_m3(corners.map(|n| self.position_m(mesh, n)))
    }

    /// Refuses tetrahedra that would come in flat or inside out.
    pub(super) fn check_volumes(&self, mesh: &TetMesh) -> Result<(), EditError> {
        for &nodes in &self.fresh {
            let volume_m3 = self.volume_m3(mesh, nodes);
            if is_inverted(volume_m3) {
                return Err(EditError::FlatTet { nodes, volume_m3 });
            }
        }
        Ok(())
    }
}

/// Buffers of the edits; they say nothing about the mesh.
#[derive(Default)]
pub(super) struct Scratch {
    pub(super) plan: Plan,
    pub(super) waiting: Waiting,
    pub(super) undo: MeshUndo,
    pub(super) change: TopologyChange,
    /// While a list of edits is carried out: the old nodes moved so far, each with the weights that give its new
    /// place from the places before the list.
    pub(super) moved: Option<Vec<(NodeId, NodeWeights)>>,
}

impl Clone for Scratch {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl std::fmt::Debug for Scratch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Scratch")
    }
}

impl EditableMesh {
    /// Does what `plan` says. Pieces are not judged.
    pub(super) fn carry_out_plan(&mut self, plan: &Plan, change: &mut TopologyChange, undo: &mut MeshUndo) {
        for ((_, parents), &position_m) in plan.node_parents.iter().zip(&plan.new_nodes_m) {
            let node = self.topology.push_node();
            self.mesh.positions_m.push(position_m);
            match self.parents_before(parents, change) {
                Some(older) => change.nodes.added.push(node, &older),
                None => change.nodes.added.push(node, parents),
            }
        }
        // They come from where all nodes were before.
        let olders: Vec<_> = plan.moved.iter().map(|m| self.parents_before(&m.parents, change)).collect();
        for (moved, older) in plan.moved.iter().zip(olders) {
            self.move_node(moved, older, change, undo);
        }
        self.replace_tets(plan, change, undo);
    }

    /// `parents` in terms of nodes that were there before the edit or list of edits, with their places from then;
    /// `None` if they are that already.
    fn parents_before(&self, parents: &[(NodeId, f64)], change: &TopologyChange) -> Option<NodeWeights> {
        let moved = self.scratch.moved.as_deref().unwrap_or_default();
        let n_before = change.nodes.n_before;
        let is_plain = |node: NodeId| node.index() < n_before && moved.iter().all(|m| m.0 != node);
        if parents.iter().all(|p| is_plain(p.0)) {
            return None;
        }
        let mut found = NodeWeights::new();
        for &(parent, weight) in parents {
            let older = match parent.index().checked_sub(n_before) {
                Some(at) => change.nodes.added.parents(at),
                None => match moved.iter().find(|m| m.0 == parent) {
                    Some((_, older)) => older.as_slice(),
                    None => &[(parent, 1.0)],
                },
            };
            found.extend(older.iter().map(|&(p, w)| (p, w * weight)));
        }
        sum_repeated(&mut found);
        Some(found)
    }

    /// `older`: its parents as [`EditableMesh::parents_before`] has them.
    fn move_node(
        &mut self,
        Move { node, position_m, parents, is_blend }: &Move,
        older: Option<NodeWeights>,
        change: &mut TopologyChange,
        undo: &mut MeshUndo,
    ) {
        let from_m = std::mem::replace(&mut self.mesh.positions_m[node.index()], *position_m);
        let parents = older.unwrap_or_else(|| parents.clone());
        if let Some(at) = node.index().checked_sub(change.nodes.n_before) {
            change.nodes.added.set_parents(at, &parents);
            return;
        }
        undo.save_move(*node, from_m);
        let of_blend = if *is_blend { parents.clone() } else { NodeWeights::new() };
        if let Some(moved) = &mut self.scratch.moved {
            moved.retain(|m| m.0 != *node);
            moved.push((*node, parents));
        }
        match change.moved_nodes.iter().position(|n| n == node) {
            Some(at) => change.moved_parents[at] = of_blend,
            None => {
                change.moved_nodes.push(*node);
                change.moved_from_m.push(from_m);
                change.moved_parents.push(of_blend);
            }
        }
    }

    /// Takes out what goes and puts in what comes. Edges, triangles and nodes that are left without a tetrahedron
    /// for a moment in between keep their ids.
    fn replace_tets(&mut self, plan: &Plan, change: &mut TopologyChange, undo: &mut MeshUndo) {
        let from = [change.nodes.removed.len(), change.edges.removed.len(), change.triangles.removed.len()];
        for &tet in &plan.doomed {
            self.topology.take_out(tet, change);
            undo.save_removal(tet);
        }
        let mut waiting = std::mem::take(&mut self.scratch.waiting);
        waiting.set(&self.topology, &change.edges.removed[from[1]..], &change.triangles.removed[from[2]..]);
        for (&corners, (_, parents)) in plan.fresh.iter().zip(plan.fresh_parents.iter()) {
            let tet = self.topology.add_tet(corners, &mut waiting, change);
            self.mesh.tetrahedra.push(corners);
            change.tets.add_with_parents(tet, parents);
        }
        self.scratch.waiting = waiting;
        self.forget_revived(from, change);
    }

    /// Strikes out what is live again from the lists of what was removed, from the given places on.
    pub(super) fn forget_revived(&self, [nodes, edges, triangles]: [usize; 3], change: &mut TopologyChange) {
        retain_from(&mut change.nodes.removed, nodes, |n| !self.topology.is_live_node(n));
        retain_from(&mut change.edges.removed, edges, |e| !self.topology.is_live_edge(e));
        retain_from(&mut change.triangles.removed, triangles, |t| !self.topology.is_live_triangle(t));
    }
}

fn retain_from<I: Copy>(ids: &mut Vec<I>, start: usize, keep: impl Fn(I) -> bool) {
    let mut kept = start;
    for at in start..ids.len() {
        if keep(ids[at]) {
            ids[kept] = ids[at];
            kept += 1;
        }
    }
    ids.truncate(kept);
}
