//! Putting tetrahedra in: the inverse of taking them out. Called by `mesh::edit` alone.

use super::{OptionalTetId, TET_EDGES, TET_TRIANGLES, Topology, local_edge};
use crate::mesh::change::{Lengths, TopologyChange};
use crate::mesh::{EdgeId, NodeId, TetId, TriangleId};
use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

/// Dead edges and triangles that may come back to life because the edit that left them without a tetrahedron
/// is not over: ascending by nodes.
///
/// And what was found already: the tetrahedra that come have most of their edges and triangles in common.
#[derive(Clone, Debug, Default)]
pub(in crate::mesh) struct Waiting {
    edges: Vec<(u64, EdgeId)>,
    triangles: Vec<(u128, TriangleId)>,
    found_edges: HashMap<u64, EdgeId, BuildHasherDefault<SpreadHasher>>,
    found_triangles: HashMap<u128, TriangleId, BuildHasherDefault<SpreadHasher>>,
}

/// Entries that tables keep room for from edit to edit.
const MOST_ROOM: usize = 8192;

/// Spreads keys that are numbers of nodes (the golden ratio as a share of 2^64; Knuth, The Art of Computer Programming 3,
/// s. 6.4). Nobody chooses them to collide.
#[derive(Clone, Copy, Debug, Default)]
struct SpreadHasher(u64);

impl Hasher for SpreadHasher {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&byte| self.write_u64(u64::from(byte)));
    }

    fn write_u64(&mut self, key: u64) {
        let spread = (self.0 ^ key).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        // What the high half of the key did has to reach the low half, too.
        self.0 = spread ^ (spread >> 32);
    }

    fn write_u128(&mut self, key: u128) {
        self.write_u64((key >> 64) as u64);
        self.write_u64(key as u64);
    }
}

/// Two ascending nodes as one number, which sorts faster.
fn edge_key([a, b]: [NodeId; 2]) -> u64 {
    u64::from(a.0) << 32 | u64::from(b.0)
}

fn triangle_key([a, b, c]: [NodeId; 3]) -> u128 {
    u128::from(a.0) << 64 | u128::from(edge_key([b, c]))
}

impl Waiting {
    /// The given edges and triangles and no others.
    pub(in crate::mesh) fn set(&mut self, topology: &Topology, edges: &[EdgeId], triangles: &[TriangleId]) {
        // To empty a table takes as long as it has room: one that a large edit left goes.
        self.found_edges.clear();
        self.found_edges.shrink_to(MOST_ROOM);
        self.found_triangles.clear();
        self.found_triangles.shrink_to(MOST_ROOM);
        self.edges.clear();
        self.edges.extend(edges.iter().map(|&e| (edge_key(topology.edge_nodes(e)), e)));
        self.edges.sort_unstable();
        self.triangles.clear();
        self.triangles.extend(triangles.iter().map(|&t| (triangle_key(topology.triangle_nodes(t)), t)));
        self.triangles.sort_unstable();
    }

    fn edge(&self, key: u64) -> Option<EdgeId> {
        self.edges.binary_search_by_key(&key, |e| e.0).ok().map(|at| self.edges[at].1)
    }

    fn triangle(&self, key: u128) -> Option<TriangleId> {
        self.triangles.binary_search_by_key(&key, |t| t.0).ok().map(|at| self.triangles[at].1)
    }
}

fn ascending(mut nodes: [NodeId; 3]) -> [NodeId; 3] {
    nodes.sort_unstable();
    nodes
}

impl Topology {
    /// Numbers of entities, dead ones included.
    pub(in crate::mesh) fn lengths(&self) -> Lengths {
        Lengths {
            nodes: self.n_nodes(),
            edges: self.n_edges(),
            triangles: self.n_triangles(),
            tets: self.n_tets(),
        }
    }

    /// Makes room for about `n_tets` more tetrahedra and what comes with them when old ones are divided.
    pub(in crate::mesh) fn reserve(&mut self, n_tets: usize) {
        // A divided tetrahedron brings about two triangles, one edge and a fraction of a node with each part; rows
        // that grow leave their place.
        let (n_triangles, n_edges, n_nodes, n_moved) = (2 * n_tets, n_tets, n_tets.div_ceil(2), 12 * n_tets);
        self.tet_nodes.reserve(n_tets);
        self.tet_edges.reserve(n_tets);
        self.tet_triangles.reserve(n_tets);
        self.tet_neighbours.reserve(n_tets);
        self.tet_live.reserve(n_tets);
        self.triangle_nodes.reserve(n_triangles);
        self.triangle_edges.reserve(n_triangles);
        self.triangle_tets.reserve(n_triangles);
        self.surface_triangles.reserve(n_triangles);
        self.edge_nodes.reserve(n_edges);
        self.edge_tets.reserve(n_edges, n_moved);
        self.edge_n_surface.reserve(n_edges);
        self.node_edges.reserve(n_nodes, n_moved);
        self.node_tets.reserve(n_nodes, 2 * n_moved);
        self.node_n_surface.reserve(n_nodes);
        self.surface_nodes.reserve(n_nodes);
    }

    /// The live triangle over three nodes, if there is one.
    pub fn triangle_between(&self, nodes: [NodeId; 3]) -> Option<TriangleId> {
        let nodes = ascending(nodes);
        let edge = self.edge_between(nodes[0], nodes[1])?;
        self.triangle_over(edge, nodes)
    }

    /// The live triangle over `nodes`, ascending, of which `edge` holds two.
    fn triangle_over(&self, edge: EdgeId, nodes: [NodeId; 3]) -> Option<TriangleId> {
        let [a, b] = self.edge_nodes(edge);
        let apex = nodes.into_iter().find(|&n| n != a && n != b).expect("three different nodes");
        let tet = self.edge_tets(edge).iter().copied().find(|&t| self.tet_nodes(t).contains(&apex))?;
        self.tet_triangles(tet).into_iter().find(|&t| self.triangle_nodes(t) == nodes)
    }

    /// A new node, dead until a tetrahedron has it.
    pub(in crate::mesh) fn push_node(&mut self) -> NodeId {
        let node = NodeId::from_index(self.n_nodes());
        self.node_edges.push_row();
        self.node_tets.push_row();
        self.node_n_surface.push(0);
        self.surface_nodes.set_room(self.n_nodes());
        node
    }

    fn push_edge(&mut self, nodes: [NodeId; 2]) -> EdgeId {
        let edge = EdgeId::from_index(self.n_edges());
        self.edge_nodes.push(nodes);
        self.edge_tets.push_row();
        self.edge_n_surface.push(0);
        edge
    }

    fn push_triangle(&mut self, nodes: [NodeId; 3], edges: [EdgeId; 3]) -> TriangleId {
        let triangle = TriangleId::from_index(self.n_triangles());
        self.triangle_nodes.push(nodes);
        self.triangle_edges.push(edges);
        self.triangle_tets.push([OptionalTetId::NONE; 2]);
        self.surface_triangles.set_room(self.n_triangles());
        triangle
    }

    /// Puts a new tetrahedron in, over nodes that are there, and adds to `change` what that did, but for the
    /// tetrahedron itself, whose parents the caller knows. Edges and triangles are taken from the live ones,
    /// then from those in `waiting`, and are new otherwise.
    pub(in crate::mesh) fn add_tet(
        &mut self,
        nodes: [NodeId; 4],
        waiting: &mut Waiting,
        change: &mut TopologyChange,
    ) -> TetId {
        // Loops: the closures of `map` were calls.
        let mut edges = [EdgeId(0); 6];
        for (edge, [i, j]) in edges.iter_mut().zip(TET_EDGES) {
            *edge = self.edge_for([nodes[i].min(nodes[j]), nodes[i].max(nodes[j])], waiting, change);
        }
        let mut triangles = [TriangleId(0); 4];
        for (triangle, [i, j, k]) in triangles.iter_mut().zip(TET_TRIANGLES) {
            let mut corners = [(nodes[i], i), (nodes[j], j), (nodes[k], k)];
            corners.sort_unstable();
            *triangle = self.triangle_for(corners, &edges, waiting, change);
        }
        let tet = TetId::from_index(self.n_tets());
        self.tet_nodes.push(nodes);
        self.tet_edges.push(edges);
        self.tet_triangles.push(triangles);
        self.tet_neighbours.push([OptionalTetId::NONE; 4]);
        self.tet_live.push(false);
        self.attach_tet(tet, change);
        tet
    }

    /// The edge between two nodes, ascending, for a tetrahedron that comes.
    fn edge_for(&mut self, nodes: [NodeId; 2], waiting: &mut Waiting, change: &mut TopologyChange) -> EdgeId {
        let key = edge_key(nodes);
        if let Some(&edge) = waiting.found_edges.get(&key) {
            return edge;
        }
        let there = self.edge_between(nodes[0], nodes[1]).or_else(|| waiting.edge(key));
        let edge = there.unwrap_or_else(|| {
            let edge = self.push_edge(nodes);
            change.edges.added.push(edge, &[]);
            edge
        });
        waiting.found_edges.insert(key, edge);
        edge
    }

    /// The triangle over nodes, ascending, each with its place in the tetrahedron with these edges that comes.
    fn triangle_for(
        &mut self,
        [(a, i), (b, j), (c, k)]: [(NodeId, usize); 3],
        edges: &[EdgeId; 6],
        waiting: &mut Waiting,
        change: &mut TopologyChange,
    ) -> TriangleId {
        let key = triangle_key([a, b, c]);
        // A triangle has two sides: it is asked for no more.
        if let Some(triangle) = waiting.found_triangles.remove(&key) {
            return triangle;
        }
        let sides = [edges[local_edge(j, k)], edges[local_edge(i, k)], edges[local_edge(i, j)]];
        let there = self.triangle_over(sides[2], [a, b, c]).or_else(|| waiting.triangle(key));
        let triangle = there.unwrap_or_else(|| {
            let triangle = self.push_triangle([a, b, c], sides);
            change.triangles.added.push(triangle, &[]);
            triangle
        });
        waiting.found_triangles.insert(key, triangle);
        triangle
    }

    /// Brings the dead tetrahedron `tet` to life with the nodes, edges and triangles of its record; inverse of
    /// [`Topology::detach_tet`], whose lists in `change` it does not shorten.
    pub(in crate::mesh) fn attach_tet(&mut self, tet: TetId, change: &mut TopologyChange) {
        debug_assert!(!self.is_live_tet(tet));
        self.tet_live[tet.index()] = true;
        self.live.tets += 1;
        for node in self.tet_nodes(tet) {
            self.live.nodes += usize::from(self.node_tets.insert(node.index(), tet) == 1);
        }
        for edge in self.tet_edges(tet) {
            if self.edge_tets.insert(edge.index(), tet) == 1 {
                self.live.edges += 1;
                for node in self.edge_nodes(edge) {
                    self.node_edges.insert(node.index(), edge);
                }
            }
        }
        for (place, triangle) in self.tet_triangles(tet).into_iter().enumerate() {
            let [first, second] = self.triangle_tets(triangle);
            debug_assert!(second.is_none(), "a triangle has two sides");
            match first.get() {
                None => {
                    self.live.triangles += 1;
                    self.triangle_tets[triangle.index()] = [tet.into(), OptionalTetId::NONE];
                    change.surface_triangles_added.push(triangle);
                    self.add_to_surface(triangle, &mut |node| change.surface_nodes_added.push(node));
                }
                Some(other) => {
                    let pair = if other < tet { [other, tet] } else { [tet, other] };
                    self.triangle_tets[triangle.index()] = pair.map(OptionalTetId::from);
                    self.tet_neighbours[tet.index()][place] = other.into();
                    let there = self.local_triangle(other, triangle);
                    self.tet_neighbours[other.index()][there] = tet.into();
                    change.surface_triangles_removed.push(triangle);
                    self.take_from_surface(triangle, &mut |node| change.surface_nodes_removed.push(node));
                }
            }
        }
    }

    /// Drops the entities from `lengths` on, which are all dead.
    pub(in crate::mesh) fn truncate(&mut self, lengths: Lengths) {
        self.tet_nodes.truncate(lengths.tets);
        self.tet_edges.truncate(lengths.tets);
        self.tet_triangles.truncate(lengths.tets);
        self.tet_neighbours.truncate(lengths.tets);
        self.tet_live.truncate(lengths.tets);
        self.triangle_nodes.truncate(lengths.triangles);
        self.triangle_edges.truncate(lengths.triangles);
        self.triangle_tets.truncate(lengths.triangles);
        self.surface_triangles.set_room(lengths.triangles);
        self.edge_nodes.truncate(lengths.edges);
        self.edge_tets.truncate(lengths.edges);
        self.edge_n_surface.truncate(lengths.edges);
        self.node_edges.truncate(lengths.nodes);
        self.node_tets.truncate(lengths.nodes);
        self.node_n_surface.truncate(lengths.nodes);
        self.surface_nodes.set_room(lengths.nodes);
    }
}
