//! Taking a tetrahedron out, and renumbering what is left. Called by `mesh::edit` alone.

use super::{IdSet, MeshEntity, OptionalTetId, Rows, TET_EDGES, Topology};
use crate::mesh::change::TopologyChange;
use crate::mesh::edit::EditError;
use crate::mesh::{EdgeId, NodeId, TetId, TriangleId};

/// Number of groups that `n` things form when `joined(i, j)` says which pairs hang together; things for
/// which `there` is false do not count.
fn n_groups(there: [bool; 4], joined: impl Fn(usize, usize) -> bool) -> usize {
    let mut group = [0, 1, 2, 3];
    for [i, j] in TET_EDGES {
        if there[i] && there[j] && joined(i, j) {
            let (from, to) = (group[i].max(group[j]), group[i].min(group[j]));
            for g in &mut group {
                if *g == from {
                    *g = to;
                }
            }
        }
    }
    (0..4).filter(|&i| there[i] && group[i] == i).count()
}

impl Topology {
    /// Makes `triangle` part of the surface; `on_node` hears of each node that becomes a surface node.
    pub(super) fn add_to_surface(&mut self, triangle: TriangleId, on_node: &mut impl FnMut(NodeId)) {
        self.surface_triangles.insert(triangle);
        for edge in self.triangle_edges[triangle.index()] {
            let n = &mut self.edge_n_surface[edge.index()];
            *n += 1;
            self.n_surface_edges += usize::from(*n == 1);
        }
        for node in self.triangle_nodes[triangle.index()] {
            let n = &mut self.node_n_surface[node.index()];
            *n += 1;
            if *n == 1 {
                self.surface_nodes.insert(node);
                on_node(node);
            }
        }
    }

    pub(super) fn take_from_surface(&mut self, triangle: TriangleId, on_node: &mut impl FnMut(NodeId)) {
        self.surface_triangles.remove(triangle);
        for edge in self.triangle_edges[triangle.index()] {
            let n = &mut self.edge_n_surface[edge.index()];
            *n -= 1;
            self.n_surface_edges -= usize::from(*n == 0);
        }
        for node in self.triangle_nodes[triangle.index()] {
            let n = &mut self.node_n_surface[node.index()];
            *n -= 1;
            if *n == 0 {
                self.surface_nodes.remove(node);
                on_node(node);
            }
        }
    }

    /// Checks that `tets` are there, live, and named once each.
    pub(in crate::mesh) fn check_removable(&mut self, tets: &[TetId]) -> Result<(), EditError> {
        // The live flags serve as marks, so that nothing is allocated; they are put back.
        let mut n_marked = 0;
        let mut found = Ok(());
        for &tet in tets {
            match self.tet_live.get_mut(tet.index()) {
                Some(live @ true) => *live = false,
                Some(false) if tets[..n_marked].contains(&tet) => found = Err(EditError::RepeatedTet { tet }),
                Some(false) => found = Err(EditError::DeadTet { tet }),
                None => found = Err(EditError::NoSuchTet { tet, n_tets: self.tet_live.len() }),
            }
            if found.is_err() {
                break;
            }
            n_marked += 1;
        }
        for tet in &tets[..n_marked] {
            self.tet_live[tet.index()] = true;
        }
        found
    }

    /// Takes the live tetrahedron `tet` out and adds what that did to `change`, whose lists are neither
    /// sorted nor free of what came and went within one edit: the caller closes the change.
    ///
    /// Whether a piece may have come apart is judged on the spot: the neighbours across two faces stay
    /// together if the edge of the two faces was inside, because its ring of tetrahedra was closed.
    pub(in crate::mesh) fn detach_tet(&mut self, tet: TetId, change: &mut TopologyChange) {
        let edges = self.tet_edges[tet.index()];
        let neighbours = self.tet_neighbours[tet.index()];
        let by_faces = n_groups(neighbours.map(|n| !n.is_none()), |i, j| {
            let between_faces = edges[5 - super::local_edge(i, j)];
            self.edge_n_surface[between_faces.index()] == 0
        });
        change.pieces.through_faces.count_removal(by_faces);
        let there = self.take_out(tet, change);
        let by_nodes = n_groups(there, |i, j| self.is_live_edge(edges[super::local_edge(i, j)]));
        change.pieces.through_nodes.count_removal(by_nodes);
    }

    /// [`Topology::detach_tet`] without judging pieces; returns which of its nodes are left.
    pub(in crate::mesh) fn take_out(&mut self, tet: TetId, change: &mut TopologyChange) -> [bool; 4] {
        let edges = self.tet_edges[tet.index()];
        let neighbours = self.tet_neighbours[tet.index()];
        self.tet_live[tet.index()] = false;
        self.live.tets -= 1;
        change.tets.removed.push(tet);
        self.detach_triangles(tet, neighbours, change);
        for edge in edges {
            if self.edge_tets.remove(edge.index(), tet) == 0 {
                self.live.edges -= 1;
                change.edges.removed.push(edge);
                for node in self.edge_nodes[edge.index()] {
                    self.node_edges.remove(node.index(), edge);
                }
            }
        }
        let nodes = self.tet_nodes[tet.index()];
        let mut there = [true; 4];
        for (i, node) in nodes.into_iter().enumerate() {
            if self.node_tets.remove(node.index(), tet) == 0 {
                there[i] = false;
                self.live.nodes -= 1;
                change.nodes.removed.push(node);
            }
        }
        there
    }

    fn detach_triangles(&mut self, tet: TetId, neighbours: [OptionalTetId; 4], change: &mut TopologyChange) {
        let triangles = self.tet_triangles[tet.index()];
        // New surface first: a node that stays on the surface is not reported as leaving it.
        for (triangle, neighbour) in triangles.into_iter().zip(neighbours) {
            if let Some(other) = neighbour.get() {
                let place = self.local_triangle(other, triangle);
                self.tet_neighbours[other.index()][place] = OptionalTetId::NONE;
                self.triangle_tets[triangle.index()] = [neighbour, OptionalTetId::NONE];
                change.surface_triangles_added.push(triangle);
                self.add_to_surface(triangle, &mut |node| change.surface_nodes_added.push(node));
            }
        }
        for (triangle, neighbour) in triangles.into_iter().zip(neighbours) {
            if neighbour.is_none() {
                self.triangle_tets[triangle.index()] = [OptionalTetId::NONE; 2];
                self.live.triangles -= 1;
                change.triangles.removed.push(triangle);
                change.surface_triangles_removed.push(triangle);
                self.take_from_surface(triangle, &mut |node| change.surface_nodes_removed.push(node));
            }
        }
        self.tet_neighbours[tet.index()] = [OptionalTetId::NONE; 4];
    }

    /// Drops the dead and numbers the live anew, in the old order. The maps in `change` say how.
    pub(in crate::mesh) fn compact(&mut self, change: &mut TopologyChange) {
        number_live(self.n_nodes(), |n| self.is_live_node(n), &mut change.nodes.new_ids);
        number_live(self.n_edges(), |e| self.is_live_edge(e), &mut change.edges.new_ids);
        number_live(self.n_triangles(), |t| self.is_live_triangle(t), &mut change.triangles.new_ids);
        number_live(self.n_tets(), |t| self.is_live_tet(t), &mut change.tets.new_ids);
        let node = |n: NodeId| new_id(&change.nodes.new_ids, n);
        let edge = |e: EdgeId| new_id(&change.edges.new_ids, e);
        let triangle = |t: TriangleId| new_id(&change.triangles.new_ids, t);
        let tet = |t: TetId| new_id(&change.tets.new_ids, t);
        let optional = |t: OptionalTetId| t.get().map_or(OptionalTetId::NONE, |t| tet(t).into());

        let edge_tets = live_rows(&self.edge_tets, &change.edges.new_ids, tet);
        let node_tets = live_rows(&self.node_tets, &change.nodes.new_ids, tet);
        let node_edges = live_rows(&self.node_edges, &change.nodes.new_ids, edge);
        keep_live(&mut self.tet_nodes, &change.tets.new_ids, |r| r.map(node));
        keep_live(&mut self.tet_edges, &change.tets.new_ids, |r| r.map(edge));
        keep_live(&mut self.tet_triangles, &change.tets.new_ids, |r| r.map(triangle));
        keep_live(&mut self.tet_neighbours, &change.tets.new_ids, |r| r.map(optional));
        keep_live(&mut self.tet_live, &change.tets.new_ids, |live| live);
        keep_live(&mut self.triangle_nodes, &change.triangles.new_ids, |r| r.map(node));
        keep_live(&mut self.triangle_edges, &change.triangles.new_ids, |r| r.map(edge));
        keep_live(&mut self.triangle_tets, &change.triangles.new_ids, |r| r.map(optional));
        keep_live(&mut self.edge_nodes, &change.edges.new_ids, |r| r.map(node));
        (self.edge_tets, self.node_tets, self.node_edges) = (edge_tets, node_tets, node_edges);
        self.surface_triangles = IdSet::with_room_for(self.n_triangles());
        self.surface_nodes = IdSet::with_room_for(self.n_nodes());
        self.edge_n_surface = vec![0; self.n_edges()];
        self.node_n_surface = vec![0; self.n_nodes()];
        self.n_surface_edges = 0;
        self.find_surface();
    }
}

fn number_live<I: MeshEntity>(n: usize, is_live: impl Fn(I) -> bool, new_ids: &mut Vec<Option<I>>) {
    let mut next = 0;
    new_ids.clear();
    new_ids.extend((0..n).map(|i| {
        is_live(I::from_index(i)).then(|| {
            next += 1;
            I::from_index(next - 1)
        })
    }));
}

fn new_id<I: MeshEntity>(new_ids: &[Option<I>], id: I) -> I {
    new_ids[id.index()].expect("live entities have live neighbours")
}

fn keep_live<T: Copy, I>(values: &mut Vec<T>, new_ids: &[Option<I>], renumber: impl Fn(T) -> T) {
    let mut at = 0;
    values.retain_mut(|value| {
        let keep = new_ids[at].is_some();
        at += 1;
        if keep {
            *value = renumber(*value);
        }
        keep
    });
}

fn live_rows<I: MeshEntity, R>(
    rows: &Rows<I>,
    new_rows: &[Option<R>],
    renumber: impl Fn(I) -> I + Copy,
) -> Rows<I> {
    let live = (0..rows.n_rows()).filter(|&row| new_rows[row].is_some());
    let pairs = live
        .clone()
        .enumerate()
        .flat_map(|(new_row, row)| rows.row(row).iter().map(move |&item| (new_row, renumber(item))));
    Rows::from_pairs(live.count(), pairs)
}
