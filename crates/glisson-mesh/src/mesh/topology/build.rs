//! Building the adjacency by sorting: O(n log n), the same numbering for the same mesh on every machine.
//! Edges and triangles are numbered in the lexicographic order of their ascending nodes.

use super::{EntityCounts, OptionalTetId, TET_EDGES, TET_TRIANGLES, Topology, local_edge};
use super::{IdSet, Rows};
use crate::mesh::{EdgeId, NodeId, TetId, TetMesh, TriangleId};

/// Why a mesh has no topology.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TopologyError {
    /// More entities than 32-bit ids can number.
    #[error("{found} {what}, at most {allowed} can be numbered: coarsen the mesh")]
    TooMany {
        /// What there is too much of.
        what: &'static str,
        /// How many there are.
        found: usize,
        /// How many there may be.
        allowed: usize,
    },
    /// A tetrahedron names a node that is not there.
    #[error("tetrahedron {tet} names node {node}, but there are {n_nodes} nodes, numbered from 0")]
    NodeOutOfRange {
        /// Which tetrahedron.
        tet: TetId,
        /// The node it names.
        node: NodeId,
        /// How many nodes there are.
        n_nodes: usize,
    },
    /// A tetrahedron names a node twice.
    #[error("tetrahedron {tet} names node {node} twice; its four nodes must differ: remove it")]
    RepeatedNode {
        /// Which tetrahedron.
        tet: TetId,
        /// The node named twice.
        node: NodeId,
    },
    /// Two tetrahedra have the same four nodes.
    #[error("tetrahedra {} and {} have the same four nodes: remove one", tets[0], tets[1])]
    RepeatedTet {
        /// The two.
        tets: [TetId; 2],
    },
    /// A triangle belongs to more than two tetrahedra.
    #[error("triangle ({}, {}, {}) belongs to {n_tets} tetrahedra (among them {}, {}, {}), at most 2 may share one",
        nodes[0], nodes[1], nodes[2], first[0], first[1], first[2])]
    CrowdedTriangle {
        /// Its nodes.
        nodes: [NodeId; 3],
        /// How many tetrahedra share it.
        n_tets: usize,
        /// The first three of them.
        first: [TetId; 3],
    },
    /// Two neighbours lie on the same side of their common triangle, or one of them is inside out.
    #[error("tetrahedra {} and {} lie on the same side of triangle ({}, {}, {}): one is inside out (fix the \
        winding at import) or the mesh is folded there", tets[0], tets[1], nodes[0], nodes[1], nodes[2])]
    Folded {
        /// Nodes of the common triangle.
        nodes: [NodeId; 3],
        /// The two neighbours.
        tets: [TetId; 2],
    },
}

/// A face as its tetrahedron sees it: ascending nodes, `4 * tet + face`.
pub(crate) type FaceRecord = ([u32; 3], u32);

/// Ascending nodes of a face, and whether its outward order is an odd permutation of them.
pub(crate) fn sorted_face(nodes: [NodeId; 4], face: usize) -> ([u32; 3], bool) {
    let mut n = TET_TRIANGLES[face].map(|k| nodes[k].0);
    let mut odd = false;
    for (i, j) in [(0, 1), (1, 2), (0, 1)] {
        if n[i] > n[j] {
            n.swap(i, j);
            odd = !odd;
        }
    }
    (n, odd)
}

/// All faces of `tetrahedra` in ascending order, so that the faces that share a triangle stand together.
pub(crate) fn sorted_faces(tetrahedra: &[[NodeId; 4]]) -> Vec<FaceRecord> {
    let mut faces = Vec::with_capacity(4 * tetrahedra.len());
    for (t, &nodes) in (0u32..).zip(tetrahedra) {
        faces.extend((0..4u32).map(|f| (sorted_face(nodes, f as usize).0, 4 * t + f)));
    }
    faces.sort_unstable();
    faces
}

fn sorted_edges(tetrahedra: &[[NodeId; 4]]) -> Vec<([u32; 2], u32)> {
    let mut edges = Vec::with_capacity(6 * tetrahedra.len());
    for (t, &nodes) in (0u32..).zip(tetrahedra) {
        edges.extend((0u32..).zip(TET_EDGES).map(|(k, [a, b])| {
            let (a, b) = (nodes[a].0, nodes[b].0);
            ([a.min(b), a.max(b)], 6 * t + k)
        }));
    }
    edges.sort_unstable();
    edges
}

fn check_nodes(mesh: &TetMesh) -> Result<(), TopologyError> {
    let n_nodes = mesh.positions_m.len();
    // 6 * tet + edge and u32::MAX as "none" must fit.
    let most_tets = (u32::MAX / 6 - 1) as usize;
    if mesh.tetrahedra.len() > most_tets {
        let found = mesh.tetrahedra.len();
        return Err(TopologyError::TooMany { what: "tetrahedra", found, allowed: most_tets });
    }
    if n_nodes > u32::MAX as usize {
        return Err(TopologyError::TooMany { what: "nodes", found: n_nodes, allowed: u32::MAX as usize });
    }
    for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
        let tet = TetId::from_index(t);
        if let Some(&node) = nodes.iter().find(|n| n.index() >= n_nodes) {
            return Err(TopologyError::NodeOutOfRange { tet, node, n_nodes });
        }
        if let Some([a, _]) = TET_EDGES.iter().find(|[a, b]| nodes[*a] == nodes[*b]) {
            return Err(TopologyError::RepeatedNode { tet, node: nodes[*a] });
        }
    }
    Ok(())
}

/// Checks the faces that meet in one triangle: one, or two on opposite sides.
fn check_group(mesh: &TetMesh, group: &[FaceRecord]) -> Result<(), TopologyError> {
    let nodes = group[0].0.map(NodeId);
    let tet_of = |i: usize| TetId(group[i].1 / 4);
    let opposite = |i: usize| mesh.tetrahedra[tet_of(i).index()][(group[i].1 % 4) as usize];
    match group.len() {
        1 => Ok(()),
        2 => {
            let tets = [tet_of(0), tet_of(1)];
            if opposite(0) == opposite(1) {
                return Err(TopologyError::RepeatedTet { tets });
            }
            let odd = |i: usize| sorted_face(mesh.tetrahedra[tet_of(i).index()], (group[i].1 % 4) as usize).1;
            if odd(0) == odd(1) {
                return Err(TopologyError::Folded { nodes, tets });
            }
            Ok(())
        }
        n_tets => {
            let first = [tet_of(0), tet_of(1), tet_of(2)];
            Err(TopologyError::CrowdedTriangle { nodes, n_tets, first })
        }
    }
}

/// Nodes of every edge, in ascending order, and the edges of every tetrahedron.
fn number_edges(tetrahedra: &[[NodeId; 4]]) -> (Vec<[NodeId; 2]>, Vec<[EdgeId; 6]>) {
    let mut edge_nodes: Vec<[NodeId; 2]> = Vec::new();
    let mut tet_edges = vec![[EdgeId(0); 6]; tetrahedra.len()];
    for (nodes, owner) in sorted_edges(tetrahedra) {
        let nodes = nodes.map(NodeId);
        if edge_nodes.last() != Some(&nodes) {
            edge_nodes.push(nodes);
        }
        let edge = EdgeId::from_index(edge_nodes.len() - 1);
        tet_edges[(owner / 6) as usize][(owner % 6) as usize] = edge;
    }
    (edge_nodes, tet_edges)
}

/// The triangles of a mesh, in ascending order of their nodes.
struct Triangles {
    nodes: Vec<[NodeId; 3]>,
    edges: Vec<[EdgeId; 3]>,
    tets: Vec<[OptionalTetId; 2]>,
    of_tet: Vec<[TriangleId; 4]>,
    /// Tetrahedra behind the triangles of every tetrahedron.
    tet_neighbours: Vec<[OptionalTetId; 4]>,
}

impl Triangles {
    fn number(mesh: &TetMesh, tet_edges: &[[EdgeId; 6]]) -> Result<Self, TopologyError> {
        let n_tets = mesh.tetrahedra.len();
        let mut triangles = Self {
            nodes: Vec::new(),
            edges: Vec::new(),
            tets: Vec::new(),
            of_tet: vec![[TriangleId(0); 4]; n_tets],
            tet_neighbours: vec![[OptionalTetId::NONE; 4]; n_tets],
        };
        for group in sorted_faces(&mesh.tetrahedra).chunk_by(|a, b| a.0 == b.0) {
            check_group(mesh, group)?;
            triangles.push(group, mesh, tet_edges);
        }
        Ok(triangles)
    }

    /// Adds the triangle of one or two faces.
    fn push(&mut self, group: &[FaceRecord], mesh: &TetMesh, tet_edges: &[[EdgeId; 6]]) {
        let triangle = TriangleId::from_index(self.nodes.len());
        let nodes = group[0].0.map(NodeId);
        let place = |g: &FaceRecord| ((g.1 / 4) as usize, (g.1 % 4) as usize);
        let (tet, _) = place(&group[0]);
        let local = nodes.map(|n| {
            mesh.tetrahedra[tet].iter().position(|&m| m == n).expect("the face is of the tetrahedron")
        });
        self.nodes.push(nodes);
        self.edges
            .push([(1, 2), (0, 2), (0, 1)].map(|(a, b)| tet_edges[tet][local_edge(local[a], local[b])]));
        let mut tets = [OptionalTetId::NONE; 2];
        for (slot, (tet, face)) in group.iter().map(place).enumerate() {
            self.of_tet[tet][face] = triangle;
            tets[slot] = TetId::from_index(tet).into();
        }
        self.tets.push(tets);
        if let [first, second] = group {
            let ((t0, f0), (t1, f1)) = (place(first), place(second));
            self.tet_neighbours[t0][f0] = tets[1];
            self.tet_neighbours[t1][f1] = tets[0];
        }
    }
}

impl Topology {
    /// The adjacency of `mesh`. Nodes without a tetrahedron are dead.
    ///
    /// # Errors
    /// [`TopologyError`] at the first thing that is no mesh: nodes out of range or repeated, repeated
    /// tetrahedra, triangles of more than two tetrahedra, neighbours on the same side of their triangle.
    pub fn build(mesh: &TetMesh) -> Result<Self, TopologyError> {
        check_nodes(mesh)?;
        let n_tets = mesh.tetrahedra.len();
        let n_nodes = mesh.positions_m.len();

        let (edge_nodes, tet_edges) = number_edges(&mesh.tetrahedra);
        let triangles = Triangles::number(mesh, &tet_edges)?;
        let n_triangles = triangles.nodes.len();

        let node_tets = Rows::from_pairs(
            n_nodes,
            mesh.tetrahedra
                .iter()
                .enumerate()
                .flat_map(|(t, nodes)| nodes.iter().map(move |n| (n.index(), TetId::from_index(t)))),
        );
        let edge_tets = Rows::from_pairs(
            edge_nodes.len(),
            tet_edges
                .iter()
                .enumerate()
                .flat_map(|(t, edges)| edges.iter().map(move |e| (e.index(), TetId::from_index(t)))),
        );
        let node_edges = Rows::from_pairs(
            n_nodes,
            edge_nodes
                .iter()
                .enumerate()
                .flat_map(|(e, nodes)| nodes.iter().map(move |n| (n.index(), EdgeId::from_index(e)))),
        );
        let live = EntityCounts {
            nodes: (0..n_nodes).filter(|&n| !node_tets.row(n).is_empty()).count(),
            edges: edge_nodes.len(),
            triangles: n_triangles,
            tets: n_tets,
        };
        let mut topology = Self {
            tet_nodes: mesh.tetrahedra.clone(),
            tet_edges,
            tet_triangles: triangles.of_tet,
            tet_neighbours: triangles.tet_neighbours,
            tet_live: vec![true; n_tets],
            surface_triangles: IdSet::with_room_for(n_triangles),
            surface_nodes: IdSet::with_room_for(n_nodes),
            edge_n_surface: vec![0; edge_nodes.len()],
            node_n_surface: vec![0; n_nodes],
            n_surface_edges: 0,
            triangle_nodes: triangles.nodes,
            triangle_edges: triangles.edges,
            triangle_tets: triangles.tets,
            edge_nodes,
            edge_tets,
            node_edges,
            node_tets,
            live,
        };
        topology.find_surface();
        Ok(topology)
    }

    /// Fills everything that is known of the surface from the tetrahedra of the triangles.
    pub(super) fn find_surface(&mut self) {
        for t in 0..self.n_triangles() {
            if let [first, OptionalTetId::NONE] = self.triangle_tets[t]
                && !first.is_none()
            {
                self.add_to_surface(TriangleId::from_index(t), &mut |_| {});
            }
        }
    }
}
