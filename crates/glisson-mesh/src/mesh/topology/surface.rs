//! The surface of the live mesh: its triangles outward, normals, and where it is pinched.

use super::{TET_TRIANGLES, Topology};
use crate::math::DVec3;
use crate::mesh::{EdgeId, NodeId, TetMesh, TriangleId};
use crate::surface::TriMesh;

/// Where the surface is not a surface: the solid hangs together by less than a face there.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Pinches {
    /// Nodes around which the surface triangles form more than one fan, or at the end of a pinched edge.
    pub nodes: Vec<NodeId>,
    /// Edges with more than two surface triangles.
    pub edges: Vec<EdgeId>,
}

impl Pinches {
    /// Whether the surface is a closed two-manifold.
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty() && self.edges.is_empty()
    }
}

impl Topology {
    /// Triangles of the surface, ascending.
    pub fn surface_triangles(&self) -> impl Iterator<Item = TriangleId> + Clone + '_ {
        self.surface_triangles.iter()
    }

    /// Number of surface triangles.
    pub fn n_surface_triangles(&self) -> usize {
        self.surface_triangles.len()
    }

    /// Nodes of the surface, ascending.
    pub fn surface_nodes(&self) -> impl Iterator<Item = NodeId> + Clone + '_ {
        self.surface_nodes.iter()
    }

    /// Number of surface nodes.
    pub fn n_surface_nodes(&self) -> usize {
        self.surface_nodes.len()
    }

    /// Number of surface edges.
    pub fn n_surface_edges(&self) -> usize {
        self.n_surface_edges
    }

    /// Whether `triangle` is on the surface.
    pub fn is_surface_triangle(&self, triangle: TriangleId) -> bool {
        self.surface_triangles.contains(triangle)
    }

    /// Whether `edge` is on the surface.
    pub fn is_surface_edge(&self, edge: EdgeId) -> bool {
        self.edge_n_surface[edge.index()] > 0
    }

    /// Whether `node` is on the surface.
    pub fn is_surface_node(&self, node: NodeId) -> bool {
        self.surface_nodes.contains(node)
    }

    /// Nodes of `triangle`, counter-clockwise seen from outside its first live tetrahedron; ascending for a
    /// dead triangle.
    pub fn outward_nodes(&self, triangle: TriangleId) -> [NodeId; 3] {
        match self.triangle_tets(triangle)[0].get() {
            Some(tet) => {
                let nodes = self.tet_nodes(tet);
                TET_TRIANGLES[self.local_triangle(tet, triangle)].map(|k| nodes[k])
            }
            None => self.triangle_nodes(triangle),
        }
    }

    /// Area times outward unit normal [m2] of `triangle`.
    ///
    /// `positions_m`: one a node.
    pub fn area_vector_m2(&self, triangle: TriangleId, positions_m: &[DVec3]) -> DVec3 {
        let [a, b, c] = self.outward_nodes(triangle).map(|n| positions_m[n.index()]);
        0.5 * (b - a).cross(c - a)
    }

    /// Outward unit normal of `triangle`; zero for one without area.
    pub fn triangle_normal(&self, triangle: TriangleId, positions_m: &[DVec3]) -> DVec3 {
        self.area_vector_m2(triangle, positions_m).normalize_or_zero()
    }

    /// Outward unit normal at a surface node: mean of its triangles' normals weighted by area; zero inside.
    pub fn node_normal(&self, node: NodeId, positions_m: &[DVec3]) -> DVec3 {
        self.surface_triangles_at(node)
            .fold(DVec3::ZERO, |sum, t| sum + self.area_vector_m2(t, positions_m))
            .normalize_or_zero()
    }

    /// Surface triangles at `node`.
    pub fn surface_triangles_at(&self, node: NodeId) -> impl Iterator<Item = TriangleId> + '_ {
        self.node_tets(node).iter().flat_map(move |&tet| {
            let opposite = self.local_node(tet, node);
            let triangles = self.tet_triangles(tet);
            (0..4)
                .filter(move |&i| i != opposite)
                .map(move |i| triangles[i])
                .filter(|&t| self.is_surface_triangle(t))
        })
    }

    /// Surface triangles at `edge`.
    pub fn surface_triangles_at_edge(&self, edge: EdgeId) -> impl Iterator<Item = TriangleId> + '_ {
        let [a, b] = self.edge_nodes(edge);
        self.edge_tets(edge).iter().flat_map(move |&tet| {
            let (a, b) = (self.local_node(tet, a), self.local_node(tet, b));
            let triangles = self.tet_triangles(tet);
            (0..4)
                .filter(move |&i| i != a && i != b)
                .map(move |i| triangles[i])
                .filter(|&t| self.is_surface_triangle(t))
        })
    }

    /// Whether more than two surface triangles meet in `edge`: a hinge.
    pub fn is_pinched_edge(&self, edge: EdgeId) -> bool {
        self.edge_n_surface[edge.index()] > 2
    }

    /// Whether the surface triangles at `node` are anything but one closed fan: a ball joint, or the end of
    /// a hinge. Walks once around the node; allocates nothing.
    pub fn is_pinched_node(&self, node: NodeId) -> bool {
        let n_surface = self.node_n_surface[node.index()];
        let Some(start) = self.surface_triangles_at(node).next() else { return false };
        let mut triangle = start;
        let mut edge = self.edges_at(start, node)[0];
        let mut n_walked = 0;
        loop {
            if self.is_pinched_edge(edge) {
                return true;
            }
            n_walked += 1;
            triangle = self
                .surface_triangles_at_edge(edge)
                .find(|&t| t != triangle)
                .expect("a surface edge has an even number of surface triangles");
            if triangle == start || n_walked > n_surface {
                return n_walked != n_surface;
            }
            let [first, second] = self.edges_at(triangle, node);
            edge = if first == edge { second } else { first };
        }
    }

    /// The two edges of `triangle` that meet in `node`.
    fn edges_at(&self, triangle: TriangleId, node: NodeId) -> [EdgeId; 2] {
        let nodes = self.triangle_nodes(triangle);
        let [a, b, c] = self.triangle_edges(triangle);
        match nodes.iter().position(|&n| n == node) {
            Some(0) => [b, c],
            Some(1) => [a, c],
            _ => [a, b],
        }
    }

    /// All places where the surface is pinched, ascending.
    pub fn pinches(&self) -> Pinches {
        Pinches {
            nodes: self.surface_nodes().filter(|&n| self.is_pinched_node(n)).collect(),
            edges: self.live_edges().filter(|&e| self.is_pinched_edge(e)).collect(),
        }
    }
}

/// The surface of the live mesh as triangles of their own, and the node of each of its vertices (ascending).
pub fn surface_of(topology: &Topology, mesh: &TetMesh) -> (TriMesh, Vec<NodeId>) {
    let nodes: Vec<NodeId> = topology.surface_nodes().collect();
    let mut vertex_of = vec![u32::MAX; topology.n_nodes()];
    for (vertex, n) in nodes.iter().enumerate() {
        vertex_of[n.index()] = u32::try_from(vertex).expect("there are no more vertices than nodes");
    }
    let vertex = |n: NodeId| vertex_of[n.index()];
    let surface = TriMesh {
        positions_m: nodes.iter().map(|n| mesh.positions_m[n.index()]).collect(),
        triangles: topology.surface_triangles().map(|t| topology.outward_nodes(t).map(vertex)).collect(),
    };
    (surface, nodes)
}
