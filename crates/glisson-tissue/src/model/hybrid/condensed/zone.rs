//! The tables of a pre-computed zone, from its own tetrahedra alone.
//!
//! Let I be its own nodes, G its frontier, and K the stiffness of its own tetrahedra:
//! - the extension B = -K_II^-1 K_IG: how its nodes follow the frontier;
//! - the compliance T = K_II^-1 with the frontier held, for the loadable nodes;
//! - the Schur complement S = K_GG + K_GI B: the stiffness that the frontier feels
//!   (Bro-Nielsen and Cotin 1996, doi 10.1111/1467-8659.1530057; seed `003`, eq. 4.6);
//! - the factor of K_II, for loads on any node and for nodes whose rows are not stored.
//!
//! A load f_I acts on the frontier like the force B^T f_I = -K_GI K_II^-1 f_I.

use crate::material::LinearElastic;
use crate::model::RestStress;
use crate::model::precomputed::{Precision, StoredNodes};
use crate::solve::{
    BoundaryConditions, FactorScratch, Factorization, FreeSystem, MeshEdges, P1Gradients, SolveError,
    StiffnessTensors, solve_columns_into,
};
use glisson_mesh::math::{DMat3, DVec3};
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};
use std::sync::Arc;

use super::columns::Columns;

/// Number of constant loads: the weight under unit acceleration along x, y and z, and the stress at rest.
pub(super) const N_CONSTANT: usize = 4;

/// The whole body, as far as the tables of a zone depend on it.
pub(super) struct Whole<'a> {
    pub(super) mesh: &'a TetMesh,
    pub(super) material: &'a LinearElastic,
    pub(super) density_kg_per_m3: f64,
    /// One per tetrahedron, or none.
    pub(super) rest_stress_pa: &'a [RestStress],
    /// Axes along which each node is held.
    pub(super) held: &'a [[bool; 3]],
    pub(super) is_loadable: &'a [bool],
    pub(super) is_surface: &'a [bool],
    /// Nodes that belong to several zones.
    pub(super) is_frontier: &'a [bool],
    pub(super) stored: StoredNodes,
    pub(super) precision: Precision,
}

/// A block of K between a frontier node and a node of the zone's own.
#[derive(Clone, Copy, Debug)]
struct Bond {
    frontier: u32,
    own: u32,
    /// Force on the frontier node for a displacement of the own node [N/m].
    stiffness_n_per_m: DMat3,
}

/// A zone that follows its frontier and its loads statically.
#[derive(Clone)]
pub(super) struct PrecomputedZone {
    /// Nodes that move and belong to this zone alone: loadable ones, other surface nodes, inner nodes. Each group
    /// ascends.
    pub(super) nodes: Vec<NodeId>,
    pub(super) n_loadable: usize,
    /// Number of loadable and other surface nodes.
    pub(super) n_shown: usize,
    /// Number of nodes, from the first on, whose rows are in the tables.
    pub(super) n_stored: usize,
    /// Ascending.
    pub(super) frontier: Vec<NodeId>,
    /// S [N/m].
    pub(super) frontier_stiffness: Columns,
    /// B, the rows of the stored nodes.
    pub(super) extension: Columns,
    /// T of the stored rows [m/N]; the interface adds the compliance of the rest of the body.
    pub(super) compliance: Columns,
    /// Response to each constant load, for all own nodes [m].
    pub(super) constant_response: Columns,
    /// Force of each constant load on the frontier [N]: from the own nodes, and the frontier nodes' own share.
    pub(super) constant_transfer: Columns,
    pub(super) constant_on_frontier: Columns,
    bonds: Vec<Bond>,
    /// Copies share it.
    factor: Arc<Factorization>,
    /// Row of each own node's components in the factored system.
    free_of: Vec<[Option<u32>; 3]>,
    scratch: FactorScratch,
    free: Vec<f64>,
}

/// Some tetrahedra of a mesh as a mesh of their own.
pub(super) struct SubMesh {
    /// Their nodes in the whole mesh, ascending.
    pub(super) nodes: Vec<NodeId>,
    pub(super) mesh: TetMesh,
}

impl SubMesh {
    pub(super) fn of(whole: &TetMesh, tets: impl Iterator<Item = TetId> + Clone) -> Self {
        let shares = if whole.shares.is_empty() {
            Vec::new()
        } else {
            tets.clone().map(|tet| whole.share(tet)).collect()
        };
        let corners = |t: TetId| whole.tetrahedra[t.index()];
        let mut nodes: Vec<NodeId> = tets.clone().flat_map(corners).collect();
        nodes.sort_unstable();
        nodes.dedup();
        let positions_m = nodes.iter().map(|n| whole.positions_m[n.index()]).collect();
        let local = |n: NodeId| NodeId::from_index(nodes.binary_search(&n).expect("a corner"));
        let tetrahedra = tets.map(|t| corners(t).map(local)).collect();
        Self { nodes, mesh: TetMesh { positions_m, tetrahedra, shares } }
    }

    /// The number here of a node of the whole mesh.
    pub(super) fn local(&self, node: NodeId) -> Option<NodeId> {
        self.nodes.binary_search(&node).ok().map(NodeId::from_index)
    }
}

/// The supports of a zone with its frontier held; `nodes`: its nodes in the whole mesh.
fn frontier_held(whole: &Whole<'_>, nodes: &[NodeId]) -> BoundaryConditions {
    let mut conditions = BoundaryConditions::new();
    for (l, node) in nodes.iter().enumerate() {
        for axis in 0..3 {
            if whole.is_frontier[node.index()] || whole.held[node.index()][axis] {
                conditions.impose(NodeId::from_index(l), axis, 0.0);
            }
        }
    }
    conditions
}

/// The nodes of a zone that move, in the order of its tables.
struct ZoneNodes {
    /// Its own: loadable ones, others of the surface, inner ones.
    own: Vec<NodeId>,
    n_loadable: usize,
    /// Number of loadable and other surface nodes.
    n_shown: usize,
    frontier: Vec<NodeId>,
}

impl ZoneNodes {
    fn of(whole: &Whole<'_>, nodes: &[NodeId]) -> Self {
        let moves = |n: &NodeId| whole.held[n.index()] != [true; 3];
        let is_frontier = |n: &NodeId| whole.is_frontier[n.index()];
        let (mut own, others): (Vec<NodeId>, Vec<NodeId>) =
            nodes.iter().filter(|n| moves(n) && !is_frontier(n)).partition(|n| whole.is_loadable[n.index()]);
        let n_loadable = own.len();
        let (shown, inner): (Vec<NodeId>, Vec<NodeId>) =
            others.into_iter().partition(|n| whole.is_surface[n.index()]);
        own.extend(shown);
        let n_shown = own.len();
        own.extend(inner);
        let frontier = nodes.iter().copied().filter(|n| moves(n) && is_frontier(n)).collect();
        Self { own, n_loadable, n_shown, frontier }
    }
}

/// K between the frontier nodes, and its blocks between a frontier node and one of the zone's own.
fn frontier_blocks(
    part: &SubMesh,
    own: &[NodeId],
    frontier: &[NodeId],
    (edges, tensors): (&MeshEdges, &StiffnessTensors),
) -> (Columns, Vec<Bond>) {
    let local = |n: NodeId| part.local(n).expect("a node of the zone").index();
    // Where each of the zone's nodes stands among its own or its frontier nodes.
    let mut own_at = vec![None; part.nodes.len()];
    for (i, &n) in own.iter().enumerate() {
        own_at[local(n)] = Some(i as u32);
    }
    let frontier_at = |l: NodeId| frontier.binary_search(&part.nodes[l.index()]).ok();
    let mut stiffness = Columns::zeros(3 * frontier.len(), 3 * frontier.len());
    for (k, &n) in frontier.iter().enumerate() {
        stiffness.add_block(k, k, tensors.vertex[local(n)]);
    }
    let mut bonds = Vec::new();
    for (&[p, q], &block) in edges.nodes.iter().zip(&tensors.edge) {
        let bond = |frontier: usize, own: u32, stiffness_n_per_m| Bond {
            frontier: frontier as u32,
            own,
            stiffness_n_per_m,
        };
        match (frontier_at(p), frontier_at(q)) {
            (Some(p), Some(q)) => {
                stiffness.add_block(p, q, block);
                stiffness.add_block(q, p, block.transpose());
            }
            (Some(p), None) => bonds.extend(own_at[q.index()].map(|q| bond(p, q, block))),
            (None, Some(q)) => bonds.extend(own_at[p.index()].map(|p| bond(q, p, block.transpose()))),
            (None, None) => (),
        }
    }
    bonds.sort_by_key(|b| (b.frontier, b.own));
    (stiffness, bonds)
}

impl PrecomputedZone {
    /// Pre-computes the zone of these tetrahedra.
    ///
    /// # Errors
    /// [`SolveError`]: a part of the zone that neither its frontier nor a support holds; nodes are those of the
    /// whole mesh.
    pub(super) fn build(whole: &Whole<'_>, tets: &[TetId]) -> Result<Self, SolveError> {
        let part = SubMesh::of(whole.mesh, tets.iter().copied());
        let edges = MeshEdges::of_mesh(&part.mesh)?;
        let tensors = StiffnessTensors::assemble(&part.mesh, &edges, whole.material)?;
        let conditions = frontier_held(whole, &part.nodes);
        let of_whole = |error| match error {
            SolveError::Floating { piece_nodes, node, rigid_modes, named } => {
                SolveError::Floating { piece_nodes, node: part.nodes[node.index()], rigid_modes, named }
            }
            other => other,
        };
        conditions.check(&part.mesh, &edges).map_err(of_whole)?;
        let system = FreeSystem::new(&edges, &tensors, &conditions)?;
        let factor = system.factorize()?;

        let ZoneNodes { own, n_loadable, n_shown, frontier } = ZoneNodes::of(whole, &part.nodes);
        let n_stored = match whole.stored {
            StoredNodes::Surface => n_shown,
            StoredNodes::All => own.len(),
        };
        let local = |n: NodeId| part.local(n).expect("a node of the zone");
        let row_of = |n: NodeId, axis: usize| system.row_of(local(n), axis).map(|row| row as u32);
        let free_of = own.iter().map(|&n| [0, 1, 2].map(|axis| row_of(n, axis))).collect();
        let (stiffness, bonds) = frontier_blocks(&part, &own, &frontier, (&edges, &tensors));
        let (n_free, n_frontier) = (factor.n_rows(), frontier.len());
        let mut zone = Self {
            n_loadable,
            n_shown,
            n_stored,
            frontier_stiffness: Columns::zeros(0, 0),
            extension: Columns::zeros(0, 0),
            compliance: Columns::zeros(0, 0),
            constant_response: Columns::zeros(3 * own.len(), N_CONSTANT),
            constant_transfer: Columns::zeros(3 * n_frontier, N_CONSTANT),
            constant_on_frontier: Columns::zeros(3 * n_frontier, N_CONSTANT),
            scratch: factor.scratch(1),
            free: vec![0.0; n_free],
            nodes: own,
            frontier,
            bonds,
            factor: Arc::new(factor),
            free_of,
        };
        zone.extend_over_frontier(stiffness, whole.precision);
        zone.fill_compliance();
        zone.fill_constants(whole, tets);
        Ok(zone)
    }

    /// Computes B and S: the response to a unit displacement of each frontier component.
    fn extend_over_frontier(&mut self, mut stiffness: Columns, precision: Precision) {
        let (n_frontier, n_rows) = (self.frontier.len(), 3 * self.n_stored);
        let n_out = n_rows + 3 * n_frontier;
        let mut bonds_of = vec![Vec::new(); n_frontier];
        for bond in &self.bonds {
            bonds_of[bond.frontier as usize].push(*bond);
        }
        let mut out = vec![0.0; n_out * 3 * n_frontier];
        if self.factor.n_rows() > 0 && n_frontier > 0 {
            let fill = |column: usize, right: &mut [f64]| {
                for bond in &bonds_of[column / 3] {
                    let pull = -bond.stiffness_n_per_m.row(column % 3);
                    self.put(bond.own as usize, pull, right);
                }
            };
            let take = |_: usize, solutions: &[f64], out: &mut [f64]| {
                let n_free = self.factor.n_rows();
                for (u, out) in solutions.chunks_exact(n_free).zip(out.chunks_exact_mut(n_out)) {
                    let (rows, forces) = out.split_at_mut(n_rows);
                    for (i, row) in rows.chunks_exact_mut(3).enumerate() {
                        row.copy_from_slice(&self.get(i, u).to_array());
                    }
                    for bond in &self.bonds {
                        let f = bond.stiffness_n_per_m * self.get(bond.own as usize, u);
                        let at = 3 * bond.frontier as usize;
                        forces[at..at + 3].iter_mut().zip(f.to_array()).for_each(|(to, x)| *to += x);
                    }
                }
            };
            solve_columns_into(&self.factor, 3, &mut out, 3 * n_out, fill, take);
        }
        let mut extension = Vec::with_capacity(n_rows * 3 * n_frontier);
        for (j, out) in out.chunks_exact(n_out.max(1)).enumerate() {
            extension.extend_from_slice(&out[..n_rows]);
            stiffness.column_mut(j).iter_mut().zip(&out[n_rows..]).for_each(|(to, x)| *to += x);
        }
        stiffness.symmetrize();
        self.frontier_stiffness = stiffness;
        self.extension = Columns::of(n_rows, 3 * n_frontier, extension).kept_in(precision);
    }

    /// Computes T: the response to a unit force on each loadable component, with the frontier held.
    fn fill_compliance(&mut self) {
        let (n_rows, n_columns) = (3 * self.n_stored, 3 * self.n_loadable);
        let mut out = vec![0.0; n_rows * n_columns];
        if !out.is_empty() && self.factor.n_rows() > 0 {
            let fill = |column: usize, right: &mut [f64]| {
                self.put(column / 3, DVec3::AXES[column % 3], right);
            };
            let take = |_: usize, solutions: &[f64], out: &mut [f64]| {
                let columns = solutions.chunks_exact(self.factor.n_rows()).zip(out.chunks_exact_mut(n_rows));
                for (u, out) in columns {
                    for (i, row) in out.chunks_exact_mut(3).enumerate() {
                        row.copy_from_slice(&self.get(i, u).to_array());
                    }
                }
            };
            solve_columns_into(&self.factor, 3, &mut out, 3 * n_rows, fill, take);
        }
        self.compliance = Columns::of(n_rows, n_columns, out);
    }

    /// Fills the tables of the constant loads.
    fn fill_constants(&mut self, whole: &Whole<'_>, tets: &[TetId]) {
        let mut loads = vec![[DVec3::ZERO; N_CONSTANT]; whole.mesh.positions_m.len()];
        for t in tets {
            let nodes = whole.mesh.tetrahedra[t.index()];
            let gradients = P1Gradients::in_mesh(whole.mesh, *t);
            let share_kg = whole.density_kg_per_m3 * gradients.volume_m3 / 4.0;
            let of_stress =
                whole.rest_stress_pa.get(t.index()).map(|&stress_pa| gradients.stress_forces_n(stress_pa));
            for (corner, n) in nodes.into_iter().enumerate() {
                for axis in 0..3 {
                    loads[n.index()][axis] += DVec3::AXES[axis] * share_kg;
                }
                loads[n.index()][3] -= of_stress.map_or(DVec3::ZERO, |f| f[corner]);
            }
        }
        for load in 0..N_CONSTANT {
            self.start_load();
            for i in 0..self.nodes.len() {
                self.add_load(i, loads[self.nodes[i].index()][load]);
            }
            let mut transfer = vec![0.0; 3 * self.frontier.len()];
            self.solve_load(&mut transfer);
            self.constant_transfer.column_mut(load).copy_from_slice(&transfer);
            for i in 0..self.nodes.len() {
                let u = self.loaded_m(i).to_array();
                self.constant_response.column_mut(load)[3 * i..3 * i + 3].copy_from_slice(&u);
            }
            for (k, n) in self.frontier.iter().enumerate() {
                self.constant_on_frontier.column_mut(load)[3 * k..3 * k + 3]
                    .copy_from_slice(&loads[n.index()][load].to_array());
            }
        }
    }

    fn put(&self, own: usize, of_node: DVec3, free: &mut [f64]) {
        for axis in 0..3 {
            if let Some(row) = self.free_of[own][axis] {
                free[row as usize] += of_node[axis];
            }
        }
    }

    fn get(&self, own: usize, free: &[f64]) -> DVec3 {
        DVec3::from_array(self.free_of[own].map(|row| row.map_or(0.0, |row| free[row as usize])))
    }

    /// Starts a load on the own nodes.
    pub(super) fn start_load(&mut self) {
        self.free.fill(0.0);
    }

    /// Adds a force [N] on an own node.
    pub(super) fn add_load(&mut self, own: usize, force_n: DVec3) {
        for axis in 0..3 {
            if let Some(row) = self.free_of[own][axis] {
                self.free[row as usize] += force_n[axis];
            }
        }
    }

    /// Adds -K_IG u, the pull of the frontier's displacements [m] on the own nodes.
    pub(super) fn add_pull_of_frontier(&mut self, frontier_m: &[f64]) {
        for b in 0..self.bonds.len() {
            let Bond { frontier, own, stiffness_n_per_m } = self.bonds[b];
            let u = DVec3::from_slice(&frontier_m[3 * frontier as usize..]);
            self.add_load(own as usize, -(stiffness_n_per_m.transpose() * u));
        }
    }

    /// Solves with the frontier held, and adds the forces [N] that the load exerts on the frontier.
    pub(super) fn solve_load(&mut self, frontier_n: &mut [f64]) {
        self.factor.solve_in_place(&mut self.free, 1, &mut self.scratch);
        for bond in &self.bonds {
            let f = bond.stiffness_n_per_m * self.get(bond.own as usize, &self.free);
            let at = 3 * bond.frontier as usize;
            for axis in 0..3 {
                frontier_n[at + axis] -= f[axis];
            }
        }
    }

    /// Displacement [m] of an own node after [`PrecomputedZone::solve_load`].
    pub(super) fn loaded_m(&self, own: usize) -> DVec3 {
        self.get(own, &self.free)
    }

    /// Bytes of the tables and the factor.
    pub(super) fn bytes(&self) -> usize {
        self.extension.bytes()
            + self.compliance.bytes()
            + self.frontier_stiffness.bytes()
            + 8 * self.factor.n_entries()
    }
}
