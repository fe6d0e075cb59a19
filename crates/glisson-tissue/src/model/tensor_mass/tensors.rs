//! Stiffness tensors on vertices and edges: accumulated, applied, and taken out again.

use crate::model::explicit::{Insertions, LiveEdges, LiveTets, Padded, keep, padded, unpadded};
use crate::model::topology_update::TopologyUpdate;
use crate::model::{ModelUndo, UndoReader};
use crate::solve::{LOCAL_EDGES, MeshEdges, P1Gradients, SolveError, StiffnessTensors, TetStiffness};
use glisson_mesh::math::DMat3;
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};

/// K as B^pp on vertices and B^pj on edges (lower node p), in the layout of the force loop.
#[derive(Clone, Debug)]
pub(in crate::model) struct VertexEdgeTensors {
    edges: LiveEdges,
    /// First edge of each node that is the edge's lower node, and the end.
    edge_start: Vec<u32>,
    vertex: Vec<[Padded; 3]>,
    edge: Vec<[Padded; 3]>,
}

impl VertexEdgeTensors {
    /// Sums what `stiffness_of` says of each tetrahedron, in their order.
    ///
    /// # Errors
    /// [`SolveError`] for an unusable mesh.
    pub(in crate::model) fn accumulate(
        mesh: &TetMesh,
        stiffness_of: impl Fn(TetId, &P1Gradients) -> TetStiffness,
    ) -> Result<Self, SolveError> {
        let edges = MeshEdges::of_mesh(mesh)?;
        let tensors = StiffnessTensors::assemble_with(mesh, &edges, stiffness_of)?;
        Ok(Self {
            edge_start: edge_starts(&edges, mesh.positions_m.len()),
            vertex: tensors.vertex.into_iter().map(padded_columns).collect(),
            edge: tensors.edge.into_iter().map(padded_columns).collect(),
            edges: LiveEdges::new(edges),
        })
    }

    /// The edges, dead ones included, and those of each tetrahedron.
    pub(in crate::model) fn mesh_edges(&self) -> &MeshEdges {
        &self.edges.edges
    }

    /// Whether an edge has a tetrahedron, for each edge.
    pub(in crate::model) fn live_edges(&self) -> Vec<bool> {
        self.edges.is_live()
    }

    /// Whether `edge` has a tetrahedron.
    pub(in crate::model) fn is_live_edge(&self, edge: usize) -> bool {
        self.edges.tets[edge] > 0
    }

    /// Edges of which `node` is the lower one.
    pub(in crate::model) fn edges_up_from(&self, node: usize) -> std::ops::Range<usize> {
        self.edge_start[node] as usize..self.edge_start[node + 1] as usize
    }

    pub(in crate::model) fn vertex(&self, node: NodeId) -> DMat3 {
        matrix(&self.vertex[node.index()])
    }

    pub(in crate::model) fn edges(&self) -> impl Iterator<Item = ([NodeId; 2], DMat3)> + '_ {
        self.edges.edges.nodes.iter().copied().zip(self.edge.iter().map(matrix))
    }

    /// Adds K u.
    ///
    /// Edges in their order, each once: the lower node's force is summed in registers over its edges, the
    /// higher node's in memory.
    pub(in crate::model) fn add_forces(&self, u: &[Padded], force: &mut [Padded]) {
        for p in 0..u.len() {
            let (b, up) = (&self.vertex[p], &u[p]);
            let mut sum: Padded =
                std::array::from_fn(|i| b[0][i] * up[0] + b[1][i] * up[1] + b[2][i] * up[2]);
            let of_p = self.edges_up_from(p);
            for (&[_, j], b) in self.edges.edges.nodes[of_p.clone()].iter().zip(&self.edge[of_p]) {
                let j = j.index();
                let uj = &u[j];
                for i in 0..4 {
                    sum[i] += b[0][i] * uj[0] + b[1][i] * uj[1] + b[2][i] * uj[2];
                }
                let fj = &mut force[j];
                for i in 0..3 {
                    fj[i] += b[i][0] * up[0] + b[i][1] * up[1] + b[i][2] * up[2];
                }
            }
            for i in 0..4 {
                force[p][i] += sum[i];
            }
        }
    }

    /// 1/2 v^T K u [J].
    pub(in crate::model) fn energy_j(&self, v: &[Padded], u: &[Padded]) -> f64 {
        let u = |p: NodeId| unpadded(&u[p.index()]);
        let v = |p: NodeId| unpadded(&v[p.index()]);
        let mut energy_j = 0.0;
        for (p, b) in self.vertex.iter().enumerate() {
            let p = NodeId::from_index(p);
            energy_j += 0.5 * v(p).dot(matrix(b) * u(p));
        }
        for ([p, j], b) in self.edges() {
            energy_j += 0.5 * v(p).dot(b * u(j)) + 0.5 * u(p).dot(b * v(j));
        }
        energy_j
    }

    /// Takes tetrahedron `t` out; `stays`: whether each of its nodes still has a tetrahedron. What is left
    /// without one becomes exactly zero.
    pub(in crate::model) fn subtract_tet(
        &mut self,
        t: usize,
        nodes: [NodeId; 4],
        stiffness: &TetStiffness,
        stays: [bool; 4],
    ) {
        for (corner, node) in nodes.into_iter().enumerate() {
            let tensor = &mut self.vertex[node.index()];
            if stays[corner] {
                add(tensor, padded_columns(stiffness.vertex[corner]), -1.0);
            } else {
                *tensor = [[0.0; 4]; 3];
            }
        }
        for (e, [j, k]) in LOCAL_EDGES.into_iter().enumerate() {
            let edge = self.edges.edges.of_tet[t][e] as usize;
            if self.edges.take_tet(edge) {
                let b = stiffness.edge[e];
                let along = if nodes[j] < nodes[k] { b } else { b.transpose() };
                add(&mut self.edge[edge], padded_columns(along), -1.0);
            } else {
                self.edge[edge] = [[0.0; 4]; 3];
            }
        }
    }

    /// Keeps the tensors at a tetrahedron that is about to be taken out.
    pub(in crate::model) fn save_tet(&self, t: usize, nodes: [NodeId; 4], undo: &mut ModelUndo) {
        let vertices = nodes.iter().map(|n| &self.vertex[n.index()]);
        let edges = self.edges.edges.of_tet[t].iter().map(|&e| &self.edge[e as usize]);
        vertices.chain(edges).for_each(|b| undo.numbers.extend_from_slice(b.as_flattened()));
        undo.places.extend(self.edges.edges.of_tet[t].iter().map(|&e| self.edges.tets[e as usize]));
    }

    /// Comes back to [`VertexEdgeTensors::save_tet`].
    pub(in crate::model) fn put_tet_back(&mut self, t: usize, nodes: [NodeId; 4], from: &mut UndoReader<'_>) {
        for node in nodes {
            self.vertex[node.index()].as_flattened_mut().copy_from_slice(from.numbers(12));
        }
        for edge in self.edges.edges.of_tet[t] {
            self.edge[edge as usize].as_flattened_mut().copy_from_slice(from.numbers(12));
            self.edges.tets[edge as usize] = from.place() as u32;
        }
    }

    /// Room for the nodes, edges and tetrahedra that an edit brings in, with nothing in them. Where new edges come into
    /// the lists by edge.
    pub(in crate::model) fn grow(&mut self, tets: &LiveTets, growth: &TopologyUpdate) -> Insertions {
        self.vertex.resize(growth.n_nodes, [[0.0; 4]; 3]);
        let insertions = self.edges.grow(tets, &growth.added);
        insertions.spread(&mut self.edge, [[0.0; 4]; 3]);
        self.edge_start = edge_starts(&self.edges.edges, growth.n_nodes);
        insertions
    }

    /// Adds the tensors of tetrahedron `t`.
    pub(in crate::model) fn add_tet(&mut self, t: usize, nodes: [NodeId; 4], stiffness: &TetStiffness) {
        self.edges.add_tet(t);
        for (corner, node) in nodes.into_iter().enumerate() {
            add(&mut self.vertex[node.index()], padded_columns(stiffness.vertex[corner]), 1.0);
        }
        for (e, [j, k]) in LOCAL_EDGES.into_iter().enumerate() {
            let b = stiffness.edge[e];
            let along = if nodes[j] < nodes[k] { b } else { b.transpose() };
            add(&mut self.edge[self.edges.edges.of_tet[t][e] as usize], padded_columns(along), 1.0);
        }
    }

    /// Drops nodes without a new id, tetrahedra that do not live and edges without a tetrahedron.
    pub(in crate::model) fn compact(&mut self, new_ids: &[Option<NodeId>], live_tets: &[bool]) {
        let stays: Vec<bool> = new_ids.iter().map(Option::is_some).collect();
        keep(&mut self.vertex, &stays);
        let live_edges = self.edges.compact(new_ids, live_tets);
        keep(&mut self.edge, &live_edges);
        self.edge_start = edge_starts(&self.edges.edges, self.vertex.len());
    }
}

fn padded_columns(m: DMat3) -> [Padded; 3] {
    [padded(m.col(0)), padded(m.col(1)), padded(m.col(2))]
}

fn matrix(columns: &[Padded; 3]) -> DMat3 {
    DMat3::from_cols(unpadded(&columns[0]), unpadded(&columns[1]), unpadded(&columns[2]))
}

/// Where the edges of each lower node begin; edges ascend.
fn edge_starts(edges: &MeshEdges, n_nodes: usize) -> Vec<u32> {
    let mut starts = vec![0; n_nodes + 1];
    for edge in &edges.nodes {
        starts[edge[0].index() + 1] += 1;
    }
    for n in 0..n_nodes {
        starts[n + 1] += starts[n];
    }
    starts
}

fn add(to: &mut [[f64; 4]; 3], what: [[f64; 4]; 3], sign: f64) {
    for (to, what) in to.as_flattened_mut().iter_mut().zip(what.as_flattened()) {
        *to += sign * what;
    }
}
