//! The stiffness of a mesh as 3x3 tensors on vertices and edges (seed `003`, eq. 1.11 and 1.12):
//! f_p = B^pp u_p + sum over edges (p, j) of B^pj u_j.

use super::{LOCAL_EDGES, P1Gradients, SolveError, TetStiffness};
use crate::material::LinearElastic;
use glisson_mesh::math::{DMat3, DVec3};
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};

/// The edges of a mesh: each once, ascending, and the six of each tetrahedron.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeshEdges {
    /// Lower and higher node of each edge; ascending.
    pub nodes: Vec<[NodeId; 2]>,
    /// Edge of each of a tetrahedron's [`LOCAL_EDGES`].
    pub of_tet: Vec<[u32; 6]>,
}

impl MeshEdges {
    /// The edges of `mesh`.
    ///
    /// # Errors
    /// [`SolveError`] when the mesh is empty, a tetrahedron names a missing node, or a position is not finite.
    pub fn of_mesh(mesh: &TetMesh) -> Result<Self, SolveError> {
        let n_nodes = mesh.positions_m.len();
        if mesh.tetrahedra.is_empty() {
            return Err(SolveError::EmptyMesh);
        }
        for (n, p) in mesh.positions_m.iter().enumerate() {
            if !p.is_finite() {
                let node = NodeId::from_index(n);
                return Err(SolveError::NonFinitePosition { node, position_m: p.to_array() });
            }
        }
        let mut keyed = Vec::with_capacity(6 * mesh.tetrahedra.len());
        for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
            if let Some(&node) = nodes.iter().find(|n| n.index() >= n_nodes) {
                return Err(SolveError::NodeOutOfRange { tet: TetId::from_index(t), node, n_nodes });
            }
            for (e, [j, k]) in LOCAL_EDGES.into_iter().enumerate() {
                let (a, b) = (nodes[j].min(nodes[k]), nodes[j].max(nodes[k]));
                keyed.push(([a, b], t, e));
            }
        }
        keyed.sort_unstable();
        let mut edges = Self { nodes: Vec::new(), of_tet: vec![[0; 6]; mesh.tetrahedra.len()] };
        for (key, t, e) in keyed {
            if edges.nodes.last() != Some(&key) {
                edges.nodes.push(key);
            }
            edges.of_tet[t][e] = u32::try_from(edges.nodes.len() - 1).expect("fewer than 2^32 edges");
        }
        Ok(edges)
    }
}

/// K of a mesh [N/m]: a tensor for each vertex and each edge.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StiffnessTensors {
    /// B^pp of each node.
    pub vertex: Vec<DMat3>,
    /// B^pj of each edge (p, j), p < j; B^jp is its transpose.
    pub edge: Vec<DMat3>,
}

impl StiffnessTensors {
    /// Accumulates the tensors of all tetrahedra, in their order.
    ///
    /// # Errors
    /// [`SolveError::Volume`] for a flat or inverted tetrahedron.
    pub fn assemble(mesh: &TetMesh, edges: &MeshEdges, material: &LinearElastic) -> Result<Self, SolveError> {
        Self::assemble_with(mesh, edges, |_, g| g.stiffness(material.lambda_pa(), material.mu_pa()))
    }

    /// Accumulates the stiffness `stiffness_of` of each tetrahedron, in their order.
    ///
    /// # Errors
    /// [`SolveError::Volume`] for a flat or inverted tetrahedron.
    pub fn assemble_with(
        mesh: &TetMesh,
        edges: &MeshEdges,
        stiffness_of: impl Fn(TetId, &P1Gradients) -> TetStiffness,
    ) -> Result<Self, SolveError> {
        let mut tensors = Self {
            vertex: vec![DMat3::ZERO; mesh.positions_m.len()],
            edge: vec![DMat3::ZERO; edges.nodes.len()],
        };
        for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
            let tet = TetId::from_index(t);
            let stiffness = stiffness_of(tet, &P1Gradients::of_tet(mesh, tet)?);
            for j in 0..4 {
                tensors.vertex[nodes[j].index()] += stiffness.vertex[j];
            }
            for (e, [j, k]) in LOCAL_EDGES.into_iter().enumerate() {
                let along =
                    if nodes[j] < nodes[k] { stiffness.edge[e] } else { stiffness.edge[e].transpose() };
                tensors.edge[edges.of_tet[t][e] as usize] += along;
            }
        }
        Ok(tensors)
    }

    /// Overwrites `force_n` with K u: the forces that balance the displacements.
    pub fn force_into(&self, edges: &MeshEdges, displacement_m: &[DVec3], force_n: &mut [DVec3]) {
        for (p, b) in self.vertex.iter().enumerate() {
            force_n[p] = *b * displacement_m[p];
        }
        for (&[p, j], b) in edges.nodes.iter().zip(&self.edge) {
            let (p, j) = (p.index(), j.index());
            force_n[p] += *b * displacement_m[j];
            force_n[j] += b.transpose() * displacement_m[p];
        }
    }
}

/// Nodes on the boundary, ascending: corners of triangles that belong to one tetrahedron only.
pub fn boundary_nodes(mesh: &TetMesh) -> Vec<NodeId> {
    let mut faces: Vec<[NodeId; 3]> = Vec::with_capacity(4 * mesh.tetrahedra.len());
    for nodes in &mesh.tetrahedra {
        for opposite in 0..4 {
            let mut face = [0, 1, 2].map(|i| nodes[(opposite + 1 + i) % 4]);
            face.sort_unstable();
            faces.push(face);
        }
    }
    faces.sort_unstable();
    let mut on_boundary = Vec::new();
    let mut i = 0;
    while i < faces.len() {
        let same = faces[i..].iter().take_while(|f| **f == faces[i]).count();
        if same == 1 {
            on_boundary.extend(faces[i]);
        }
        i += same;
    }
    on_boundary.sort_unstable();
    on_boundary.dedup();
    on_boundary
}
