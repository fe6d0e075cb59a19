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
        if let Some((t, node)) = (mesh.tetrahedra.iter().enumerate())
            .find_map(|(t, nodes)| nodes.iter().find(|n| n.index() >= n_nodes).map(|node| (t, *node)))
        {
            return Err(SolveError::NodeOutOfRange { tet: TetId::from_index(t), node, n_nodes });
        }
        Ok(Self::of_tetrahedra(n_nodes, &mesh.tetrahedra))
    }

    /// The edges of tetrahedra between nodes below `n_nodes`.
    ///
    /// # Panics
    /// When a tetrahedron names another node.
    pub(crate) fn of_tetrahedra(n_nodes: usize, tetrahedra: &[[NodeId; 4]]) -> Self {
        let ends = |nodes: &[NodeId; 4], [j, k]: [usize; 2]| (nodes[j].min(nodes[k]), nodes[j].max(nodes[k]));
        // By lower node, then each of these short lists by the higher one.
        let mut start = vec![0u32; n_nodes + 1];
        for nodes in tetrahedra {
            LOCAL_EDGES.into_iter().for_each(|edge| start[ends(nodes, edge).0.index() + 1] += 1);
        }
        for n in 0..n_nodes {
            start[n + 1] += start[n];
        }
        let mut next = start.clone();
        let mut uses = vec![(NodeId(0), 0u32); 6 * tetrahedra.len()];
        for (t, nodes) in tetrahedra.iter().enumerate() {
            for (e, edge) in LOCAL_EDGES.into_iter().enumerate() {
                let (low, high) = ends(nodes, edge);
                let place = &mut next[low.index()];
                uses[*place as usize] = (high, (6 * t + e) as u32);
                *place += 1;
            }
        }
        let mut edges =
            Self { nodes: Vec::with_capacity(uses.len() / 3), of_tet: vec![[0; 6]; tetrahedra.len()] };
        for n in 0..n_nodes {
            let uses = &mut uses[start[n] as usize..start[n + 1] as usize];
            uses.sort_unstable();
            for (at, &(high, place)) in uses.iter().enumerate() {
                if at == 0 || uses[at - 1].0 != high {
                    edges.nodes.push([NodeId::from_index(n), high]);
                }
                let edge = u32::try_from(edges.nodes.len() - 1).expect("fewer than 2^32 edges");
                edges.of_tet[place as usize / 6][place as usize % 6] = edge;
            }
        }
        edges
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
    /// No stiffness.
    pub(crate) fn zeros(n_nodes: usize, edges: &MeshEdges) -> Self {
        Self { vertex: vec![DMat3::ZERO; n_nodes], edge: vec![DMat3::ZERO; edges.nodes.len()] }
    }

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
        let mut tensors = Self::zeros(mesh.positions_m.len(), edges);
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
