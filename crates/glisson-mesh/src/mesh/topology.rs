//! Adjacency of a tetrahedral mesh: nodes, edges, triangles, tetrahedra and all their neighbours.
//!
//! Built once by sorting; afterwards tetrahedra can be taken out and put in one by one. Ids never change by
//! that: what is gone is dead, its record stays readable until the mesh is compacted, and the rows of its
//! neighbours shrink in place; what comes in continues the numbering. A removal therefore allocates nothing
//! and touches the 4 nodes, 6 edges, 4 triangles and 4 neighbours of the tetrahedron alone. Every row ascends
//! by id, whatever the history: sums over neighbours have the same bits in an edited mesh and in one restored
//! from a snapshot.
//!
//! Only [`crate::mesh::edit`] changes a topology.
//!
//! Numbering inside tetrahedron (n0, n1, n2, n3): edges 01, 02, 03, 12, 13, 23 (edge `5 - k` is opposite to
//! edge `k`), triangle `i` and neighbour `i` opposite to node `i`.

mod addition;
pub(crate) mod build;
mod pieces;
mod removal;
mod rows;
mod singular;
mod surface;

pub(in crate::mesh) use addition::Waiting;
pub use build::TopologyError;
pub use pieces::{Pieces, Through};
pub use singular::{SingularEntities, StarGroups};
pub use surface::{Pinches, surface_of};

use self::rows::{IdSet, Rows};
use crate::mesh::change::MeshEntity;
use crate::mesh::{EdgeId, NodeId, TetId, TriangleId};

/// Local nodes of the six edges of a tetrahedron.
pub const TET_EDGES: [[usize; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];

/// Local nodes of the triangle opposite to each node of a tetrahedron, counter-clockwise seen from outside.
pub const TET_TRIANGLES: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];

/// Place in [`TET_EDGES`] of the edge between two different local nodes.
pub(crate) fn local_edge(a: usize, b: usize) -> usize {
    const PLACE: [[usize; 4]; 4] = [[6, 0, 1, 2], [0, 6, 3, 4], [1, 3, 6, 5], [2, 4, 5, 6]];
    PLACE[a][b]
}

/// A tetrahedron, or none: four bytes. Across a face of the surface there is none.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(transparent)]
pub struct OptionalTetId(u32);

impl OptionalTetId {
    /// No tetrahedron: outside.
    pub const NONE: Self = Self(u32::MAX);

    /// The tetrahedron, or `None` outside.
    pub fn get(self) -> Option<TetId> {
        (self != Self::NONE).then_some(TetId(self.0))
    }

    /// Whether this is outside.
    pub fn is_none(self) -> bool {
        self == Self::NONE
    }

    /// The tetrahedron's number, or -1 outside (the notation of neighbour tables in print).
    pub fn number_or_minus_one(self) -> i64 {
        self.get().map_or(-1, |t| i64::from(t.0))
    }
}

impl From<TetId> for OptionalTetId {
    fn from(tet: TetId) -> Self {
        Self(tet.0)
    }
}

/// How many live entities of each kind there are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EntityCounts {
    /// Nodes with at least one tetrahedron.
    pub nodes: usize,
    /// Edges with at least one tetrahedron.
    pub edges: usize,
    /// Triangles with at least one tetrahedron.
    pub triangles: usize,
    /// Tetrahedra not removed.
    pub tets: usize,
}

/// All neighbours in a tetrahedral mesh. Arrays kept beside it have one entry for every entity, dead ones
/// included: `n_nodes()`, `n_edges()`, `n_triangles()`, `n_tets()`.
#[derive(Clone, Debug, PartialEq)]
pub struct Topology {
    tet_nodes: Vec<[NodeId; 4]>,
    tet_edges: Vec<[EdgeId; 6]>,
    tet_triangles: Vec<[TriangleId; 4]>,
    tet_neighbours: Vec<[OptionalTetId; 4]>,
    tet_live: Vec<bool>,
    triangle_nodes: Vec<[NodeId; 3]>,
    triangle_edges: Vec<[EdgeId; 3]>,
    triangle_tets: Vec<[OptionalTetId; 2]>,
    edge_nodes: Vec<[NodeId; 2]>,
    edge_tets: Rows<TetId>,
    node_edges: Rows<EdgeId>,
    node_tets: Rows<TetId>,
    surface_triangles: IdSet<TriangleId>,
    surface_nodes: IdSet<NodeId>,
    /// Surface triangles at each edge: 0 inside, 2 on a plain surface, more where the surface is pinched.
    edge_n_surface: Vec<u32>,
    node_n_surface: Vec<u32>,
    n_surface_edges: usize,
    live: EntityCounts,
}

impl Topology {
    /// Number of nodes, dead ones included.
    pub fn n_nodes(&self) -> usize {
        self.node_tets.n_rows()
    }

    /// Number of edges, dead ones included.
    pub fn n_edges(&self) -> usize {
        self.edge_nodes.len()
    }

    /// Number of triangles, dead ones included.
    pub fn n_triangles(&self) -> usize {
        self.triangle_nodes.len()
    }

    /// Number of tetrahedra, dead ones included.
    pub fn n_tets(&self) -> usize {
        self.tet_nodes.len()
    }

    /// Numbers of live entities.
    pub fn live_counts(&self) -> EntityCounts {
        self.live
    }

    /// Whether any entity is dead, so that compacting would renumber.
    pub fn has_dead(&self) -> bool {
        self.live
            != EntityCounts {
                nodes: self.n_nodes(),
                edges: self.n_edges(),
                triangles: self.n_triangles(),
                tets: self.n_tets(),
            }
    }

    /// Whether `node` has a tetrahedron. A loose node of the mesh is dead from the start.
    pub fn is_live_node(&self, node: NodeId) -> bool {
        !self.node_tets.row(node.index()).is_empty()
    }

    /// Whether `edge` has a tetrahedron.
    pub fn is_live_edge(&self, edge: EdgeId) -> bool {
        !self.edge_tets.row(edge.index()).is_empty()
    }

    /// Whether `triangle` has a tetrahedron.
    pub fn is_live_triangle(&self, triangle: TriangleId) -> bool {
        !self.triangle_tets[triangle.index()][0].is_none()
    }

    /// Whether `tet` was not removed.
    pub fn is_live_tet(&self, tet: TetId) -> bool {
        self.tet_live[tet.index()]
    }

    /// One flag a tetrahedron: not removed.
    pub fn live_tet_flags(&self) -> &[bool] {
        &self.tet_live
    }

    /// Live nodes, ascending.
    pub fn live_nodes(&self) -> impl Iterator<Item = NodeId> + '_ {
        (0..self.n_nodes()).map(NodeId::from_index).filter(|&n| self.is_live_node(n))
    }

    /// Live edges, ascending.
    pub fn live_edges(&self) -> impl Iterator<Item = EdgeId> + '_ {
        (0..self.n_edges()).map(EdgeId::from_index).filter(|&e| self.is_live_edge(e))
    }

    /// Live triangles, ascending.
    pub fn live_triangles(&self) -> impl Iterator<Item = TriangleId> + '_ {
        (0..self.n_triangles()).map(TriangleId::from_index).filter(|&t| self.is_live_triangle(t))
    }

    /// Live tetrahedra, ascending.
    pub fn live_tets(&self) -> impl Iterator<Item = TetId> + '_ {
        (0..self.n_tets()).map(TetId::from_index).filter(|&t| self.is_live_tet(t))
    }

    /// Nodes of a tetrahedron; of a dead one the nodes that it had.
    pub fn tet_nodes(&self, tet: TetId) -> [NodeId; 4] {
        self.tet_nodes[tet.index()]
    }

    /// Edges of a tetrahedron in the order of [`TET_EDGES`]; of a dead one the edges that it had.
    pub fn tet_edges(&self, tet: TetId) -> [EdgeId; 6] {
        self.tet_edges[tet.index()]
    }

    /// Triangles of a tetrahedron, each opposite to its node; of a dead one the triangles that it had.
    pub fn tet_triangles(&self, tet: TetId) -> [TriangleId; 4] {
        self.tet_triangles[tet.index()]
    }

    /// Tetrahedra across the four faces, each opposite to its node; all none for a dead one.
    pub fn tet_neighbours(&self, tet: TetId) -> [OptionalTetId; 4] {
        self.tet_neighbours[tet.index()]
    }

    /// Nodes of a triangle, ascending.
    pub fn triangle_nodes(&self, triangle: TriangleId) -> [NodeId; 3] {
        self.triangle_nodes[triangle.index()]
    }

    /// Edges of a triangle, each opposite to its node in [`Topology::triangle_nodes`].
    pub fn triangle_edges(&self, triangle: TriangleId) -> [EdgeId; 3] {
        self.triangle_edges[triangle.index()]
    }

    /// The one or two live tetrahedra of a triangle, ascending, none last; both none for a dead one.
    pub fn triangle_tets(&self, triangle: TriangleId) -> [OptionalTetId; 2] {
        self.triangle_tets[triangle.index()]
    }

    /// Nodes of an edge, ascending.
    pub fn edge_nodes(&self, edge: EdgeId) -> [NodeId; 2] {
        self.edge_nodes[edge.index()]
    }

    /// Live tetrahedra at an edge, ascending.
    pub fn edge_tets(&self, edge: EdgeId) -> &[TetId] {
        self.edge_tets.row(edge.index())
    }

    /// Live edges at a node, ascending.
    pub fn node_edges(&self, node: NodeId) -> &[EdgeId] {
        self.node_edges.row(node.index())
    }

    /// Live tetrahedra at a node, ascending.
    pub fn node_tets(&self, node: NodeId) -> &[TetId] {
        self.node_tets.row(node.index())
    }

    /// The live edge between two nodes, if there is one.
    pub fn edge_between(&self, a: NodeId, b: NodeId) -> Option<EdgeId> {
        let wanted = if a < b { [a, b] } else { [b, a] };
        let (of_a, of_b) = (self.node_edges(a), self.node_edges(b));
        let shorter = if of_b.len() < of_a.len() { of_b } else { of_a };
        shorter.iter().copied().find(|&e| self.edge_nodes(e) == wanted)
    }

    /// The node of `edge` that is not `node`.
    pub fn other_node(&self, edge: EdgeId, node: NodeId) -> NodeId {
        let [a, b] = self.edge_nodes(edge);
        if a == node { b } else { a }
    }

    /// Nodes - edges + triangles - tetrahedra of what is live: 1 for a ball, 0 for a solid ring, 2 for a
    /// ball with a cavity; pieces add up.
    pub fn euler_characteristic(&self) -> i64 {
        let EntityCounts { nodes, edges, triangles, tets } = self.live;
        nodes as i64 - edges as i64 + triangles as i64 - tets as i64
    }

    /// Nodes - edges + triangles of the surface: 2 for a sphere, 0 for a torus; closed surfaces add up.
    pub fn surface_euler_characteristic(&self) -> i64 {
        self.surface_nodes.len() as i64 - self.n_surface_edges as i64 + self.surface_triangles.len() as i64
    }

    /// Which of the four places of `tet` holds `node`.
    pub(crate) fn local_node(&self, tet: TetId, node: NodeId) -> usize {
        self.tet_nodes(tet).iter().position(|&n| n == node).expect("the tetrahedron has the node")
    }

    /// Which of the four places of `tet` holds `triangle`.
    fn local_triangle(&self, tet: TetId, triangle: TriangleId) -> usize {
        self.tet_triangles(tet).iter().position(|&t| t == triangle).expect("the tetrahedron has the triangle")
    }
}
