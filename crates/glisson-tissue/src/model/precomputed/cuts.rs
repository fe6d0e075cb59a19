//! State that following cuts needs besides the table: the factor of the uncut body, the history of changes, fragments.

use std::sync::Arc;

use super::Compliance;
use super::cut_report::CutReport;
use super::fragments::{Fragment, MOST_PULL_SHARE, Owners};
use super::low_rank::{History, NodeColumns, NodeWeight, RemovedTet};
use super::response::Load;
use super::rigid::{Clusters, span};
use crate::model::{LocalModel, LocalWork};
use crate::solve::{
    BoundaryConditions, Factorization, FreeSystem, MeshEdges, SolveError, StiffnessTensors,
    add_gravity_forces,
};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::edit::{EditableMesh, TopologyChange};
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};

/// Nodes in one block of right-hand sides.
const NODES_IN_BLOCK: usize = 16;

/// Data of the uncut body.
pub(super) struct Origin {
    pub(super) system: FreeSystem,
    pub(super) factor: Factorization,
    /// Response of each node to unit gravity along each axis: `[gravity axis][node]` [m per m/s2].
    pub(super) weight_s2: Arc<[Vec<DVec3>; 3]>,
}

/// State that following cuts needs.
#[derive(Clone)]
pub(super) struct Cuts {
    pub(super) origin: Arc<Origin>,
    pub(super) body: EditableMesh,
    /// Tetrahedra whose stiffness is that of the held body.
    pub(super) bears: Vec<bool>,
    pub(super) is_fixed: Vec<bool>,
    /// Nodes without a bearing tetrahedron.
    pub(super) is_out: Vec<bool>,
    pub(super) history: History,
    pub(super) taken_out: Vec<RemovedTet>,
    pub(super) pieces: Vec<Fragment>,
    pub(super) owners: Owners,
    /// Pulls of the hinges on the held body: piece, hinge, loadable node.
    pub(super) hinge_rows: Vec<(u32, u32, u32)>,
    pub(super) pull_share: f64,
    /// Of all nodes; zero except for those that pieces move; empty without pieces.
    velocities_m_per_s: Vec<DVec3>,
    /// Response of each node of the whole body to unit gravity along each axis [m per m/s2].
    pub(super) whole_weight_s2: Arc<[Vec<DVec3>; 3]>,
    /// Displacement of the rows under the whole body's own weight [m], in blocks. A rest shape under gravity contains it
    /// already. Empty while nothing is cut.
    pub(super) carried_m: Vec<f64>,
    pub(super) report: CutReport,
}

impl std::fmt::Debug for Cuts {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Cuts").field("report", &self.report).finish_non_exhaustive()
    }
}

impl Origin {
    /// Factors K of the bearing tetrahedra; nodes that have none are held.
    fn new(mesh: &TetMesh, compliance: &Compliance, is_held: &[bool]) -> Result<Self, SolveError> {
        let held: Vec<NodeId> = (0..is_held.len()).filter(|&n| is_held[n]).map(NodeId::from_index).collect();
        let edges = MeshEdges::of_mesh(mesh)?;
        let tensors = StiffnessTensors::assemble(mesh, &edges, &compliance.material)?;
        let system = FreeSystem::for_many_solutions(
            &mesh.positions_m,
            &edges,
            &tensors,
            &BoundaryConditions::fixed(&held),
        )?;
        let factor = system.factorize()?;
        let n_free = system.n_free();
        let mut right = vec![0.0; 3 * n_free];
        let mut weight_n = vec![DVec3::ZERO; is_held.len()];
        for (axis, right) in right.chunks_exact_mut(n_free.max(1)).enumerate() {
            weight_n.fill(DVec3::ZERO);
            add_gravity_forces(mesh, &compliance.material, DVec3::AXES[axis], &mut weight_n);
            system.gather_into(&weight_n, right);
        }
        factor.solve_in_place(&mut right, 3, &mut factor.scratch(3));
        let mut solutions = right.chunks_exact(n_free.max(1));
        let weight_s2: [Vec<DVec3>; 3] = std::array::from_fn(|_| {
            let mut of_node = vec![DVec3::ZERO; is_held.len()];
            system.add_scattered(solutions.next().expect("three columns"), &mut of_node);
            of_node
        });
        Ok(Self { system, factor, weight_s2: Arc::new(weight_s2) })
    }
}

impl Cuts {
    /// The state before the first cut of `mesh`; `bears` tells which tetrahedra are in the compliance.
    pub(super) fn new(mesh: &TetMesh, bears: Vec<bool>, compliance: &Compliance) -> Result<Self, SolveError> {
        let n_nodes = mesh.positions_m.len();
        let mut is_fixed = vec![false; n_nodes];
        for node in &compliance.fixed_nodes {
            is_fixed[node.index()] = true;
        }
        let mut body = EditableMesh::new(mesh.clone()).map_err(|_| SolveError::EmptyMesh)?;
        let dead: Vec<TetId> = (0..bears.len()).filter(|&t| !bears[t]).map(TetId::from_index).collect();
        body.remove_into(&dead, &mut TopologyChange::default()).expect("live tetrahedra, each once");
        let bearing = TetMesh {
            positions_m: mesh.positions_m.clone(),
            tetrahedra: (0..bears.len()).filter(|&t| bears[t]).map(|t| mesh.tetrahedra[t]).collect(),
            ..TetMesh::default()
        };
        let is_out: Vec<bool> =
            (0..n_nodes).map(|n| !body.topology().is_live_node(NodeId::from_index(n))).collect();
        let is_held: Vec<bool> = is_fixed.iter().zip(&is_out).map(|(a, b)| *a || *b).collect();
        let origin = Arc::new(Origin::new(&bearing, compliance, &is_held)?);
        let whole_weight_s2 = if dead.is_empty() {
            Arc::clone(&origin.weight_s2)
        } else {
            Origin::new(mesh, compliance, &is_fixed)?.weight_s2
        };
        Ok(Self {
            origin,
            whole_weight_s2,
            carried_m: Vec::new(),
            body,
            bears,
            is_fixed,
            is_out,
            history: History::new(compliance.rows.clone(), n_nodes),
            taken_out: Vec::new(),
            pieces: Vec::new(),
            owners: Owners::none(n_nodes),
            hinge_rows: Vec::new(),
            pull_share: MOST_PULL_SHARE,
            velocities_m_per_s: Vec::new(),
            report: CutReport { least_pivot: 1.0, ..CutReport::default() },
        })
    }

    /// Columns of nodes over the known unknowns, with all changes so far. Nodes that are not known yet become known.
    pub(super) fn columns_from_factor(&mut self, nodes: &[NodeId]) -> Vec<(NodeColumns, NodeWeight)> {
        let Origin { system, factor, weight_s2 } = &*self.origin;
        let n_free = system.n_free();
        let mut scratch = factor.scratch(3 * nodes.len().min(NODES_IN_BLOCK));
        let mut columns = Vec::with_capacity(nodes.len());
        for block in nodes.chunks(NODES_IN_BLOCK) {
            let n_columns = 3 * block.len();
            let mut right = vec![0.0; n_columns * n_free];
            for (i, &node) in block.iter().enumerate() {
                for axis in 0..3 {
                    let row = system.row_of(node, axis).expect("nodes with columns are free");
                    right[(3 * i + axis) * n_free + row] = 1.0;
                }
            }
            factor.solve_in_place(&mut right, n_columns, &mut scratch);
            for (i, &node) in block.iter().enumerate() {
                let is_new = self.history.admit(node);
                let mut of_node: NodeColumns = std::array::from_fn(|d| {
                    let full = &right[(3 * i + d) * n_free..(3 * i + d + 1) * n_free];
                    let known = self.history.known().iter();
                    known
                        .flat_map(|&n| {
                            [0, 1, 2].map(|axis| system.row_of(n, axis).map_or(0.0, |row| full[row]))
                        })
                        .collect()
                });
                let mut weight: NodeWeight =
                    std::array::from_fn(|d| std::array::from_fn(|axis| weight_s2[axis][node.index()][d]));
                self.history.bring_up_to_date(&mut of_node, &mut weight, is_new);
                columns.push((of_node, weight));
            }
        }
        columns
    }

    pub(super) fn corners(&self, tet: TetId) -> [NodeId; 4] {
        self.body.topology().tet_nodes(tet)
    }

    /// Nodes with a bearing tetrahedron.
    pub(super) fn borne(&self) -> Vec<bool> {
        let mut borne = vec![false; self.is_out.len()];
        for t in (0..self.bears.len()).filter(|&t| self.bears[t]) {
            for node in self.corners(TetId::from_index(t)) {
                borne[node.index()] = true;
            }
        }
        borne
    }

    /// Nodes to be held so that the rest of fragments and nodes does not make K singular, ascending: all of `leaving`
    /// without a tetrahedron in `left`, and three points of each cluster of `left`.
    pub(super) fn to_hold(
        &self,
        leaving: &[NodeId],
        left: &[TetId],
        has_row: impl Fn(NodeId) -> bool,
    ) -> Vec<NodeId> {
        let mut counts = vec![false; self.bears.len()];
        let mut is_left = vec![false; self.is_out.len()];
        for &t in left {
            counts[t.index()] = true;
            for node in self.corners(t) {
                is_left[node.index()] = true;
            }
        }
        let mut held: Vec<NodeId> = leaving.iter().copied().filter(|n| !is_left[n.index()]).collect();
        let topology = self.body.topology();
        let rest_m = &self.body.mesh().positions_m;
        for nodes in Clusters::of(topology, &counts).nodes(topology) {
            let is_held = |n: &NodeId| self.is_fixed[n.index()] || held.contains(n);
            let already: Vec<NodeId> = nodes.iter().copied().filter(is_held).collect();
            if span(&already, rest_m).is_some() {
                continue;
            }
            // Prefer nodes that have a column already.
            let with_row: Vec<NodeId> = nodes.iter().copied().filter(|&n| has_row(n)).collect();
            let chosen = span(&with_row, rest_m).or_else(|| span(&nodes, rest_m));
            held.extend(chosen.into_iter().flatten().filter(|n| !self.is_fixed[n.index()]));
            held.sort_unstable();
            held.dedup();
        }
        held.sort_unstable();
        held
    }

    /// The piece that moves a tool's node, if one does.
    pub(super) fn piece_of(&mut self, node: NodeId) -> Option<(&mut Fragment, u32)> {
        let piece = &mut self.pieces[self.owners.of(node)?];
        let local = piece.local(node)?;
        Some((piece, local))
    }

    /// Pulls of fragments on the held body: loadable node, force [N].
    pub(super) fn pulls(&self) -> impl Iterator<Item = Load> + '_ {
        self.hinge_rows.iter().map(|&(piece, hinge, loadable)| {
            (loadable, self.pieces[piece as usize].hinges[hinge as usize].pull_n)
        })
    }

    /// Moves the pieces, the latest first, because earlier ones can hang on later ones.
    pub(super) fn step_pieces(
        &mut self,
        dt_s: f64,
        rest_m: &[DVec3],
        positions_m: &mut [DVec3],
        mut feel: impl FnMut(usize, DVec3),
    ) {
        for p in (0..self.pieces.len()).rev() {
            let piece = &mut self.pieces[p];
            piece.step(
                dt_s,
                |node| positions_m[node.index()] - rest_m[node.index()],
                self.pull_share,
                |place, force_n| feel(place as usize, force_n),
            );
            let now_m = piece.positions_m();
            for (local, &node) in piece.nodes.iter().enumerate() {
                if self.owners.of(node) == Some(p) && piece.moves(local as u32) {
                    positions_m[node.index()] = now_m[local];
                }
            }
        }
        self.write_velocities();
    }

    fn write_velocities(&mut self) {
        let velocities = &mut self.velocities_m_per_s;
        for (p, piece) in self.pieces.iter().enumerate() {
            for (local, (&node, &of_node)) in piece.nodes.iter().zip(piece.velocities_m_per_s()).enumerate() {
                if self.owners.of(node) == Some(p) {
                    let moves = piece.moves(local as u32);
                    velocities[node.index()] = if moves { of_node } else { DVec3::ZERO };
                }
            }
        }
    }

    /// Updates the hinges, and the lists that steps use, after an edit.
    pub(super) fn join_pieces(&mut self, loadable: impl Fn(NodeId) -> Option<u32>) {
        let borne = self.borne();
        for (p, piece) in self.pieces.iter().enumerate().rev() {
            for (local, &node) in piece.nodes.iter().enumerate() {
                let owner = self.owners.of(node).map(|owner| &self.pieces[owner]);
                let has_owner = owner.is_some_and(|own| own.local(node).is_some_and(|l| own.moves(l)));
                // A hinge that its owner lost belongs to the piece from now on.
                if !borne[node.index()] && !has_owner && piece.moves(local as u32) {
                    self.owners.set(node, p);
                }
            }
        }
        for p in 0..self.pieces.len() {
            // A piece moves what nothing held and no later piece moves.
            let (fixed, owners) = (&self.is_fixed, &self.owners);
            let is_driven = |n: NodeId| {
                !fixed[n.index()] && (borne[n.index()] || owners.of(n).is_some_and(|owner| owner != p))
            };
            self.pieces[p].set_hinges(is_driven);
        }
        self.hinge_rows.clear();
        for (p, piece) in self.pieces.iter().enumerate() {
            for (h, hinge) in piece.hinges.iter().enumerate() {
                if let Some(m) = loadable(hinge.node) {
                    self.hinge_rows.push((p as u32, h as u32, m));
                }
            }
        }
        if !self.pieces.is_empty() {
            self.velocities_m_per_s.resize(self.is_out.len(), DVec3::ZERO);
        }
        self.write_velocities();
    }

    /// Displacement of the rows under the whole body's own weight [m], in blocks; `None` while nothing is cut.
    pub(super) fn carried_m(&self) -> Option<&[f64]> {
        (!self.carried_m.is_empty()).then_some(&self.carried_m)
    }

    /// Fills the compliances of nodes that pieces move.
    pub(super) fn add_pieces_to(&mut self, period_s: f64, work: &mut LocalWork, out: &mut LocalModel) {
        for (p, piece) in self.pieces.iter_mut().enumerate() {
            // Place among the patch's nodes and number in the piece of those that it moves.
            let mut own = [(0, NodeId(0)); LocalModel::MOST_NODES];
            let mut n_own = 0;
            for (at, &node) in out.nodes.iter().enumerate() {
                if self.owners.of(node) == Some(p)
                    && let Some(local) = piece.local(node)
                {
                    own[n_own] = (at, NodeId(local));
                    n_own += 1;
                }
            }
            let own = &own[..n_own];
            if own.is_empty() {
                continue;
            }
            let locals = own.iter().map(|(_, local)| *local);
            let model = piece.local_model(locals, period_s, work);
            for (j, &(by, _)) in own.iter().enumerate() {
                out.force_n[by] = model.force_n[j];
                (out.mass_kg[by], out.drift_m[by]) = (model.mass_kg[j], model.drift_m[j]);
                out.changed_n[by] = model.changed_n[j];
                for (i, &(of, _)) in own.iter().enumerate() {
                    out.set_tensor(of, by, model.tensor_m_per_n(i, j));
                }
            }
            let fewest = |n_rings: u32| out.n_rings.map_or(n_rings, |other| other.min(n_rings));
            out.n_rings = model.n_rings.map(fewest).or(out.n_rings);
            out.is_inertial |= model.is_inertial;
            out.missed_tolerance |= model.missed_tolerance;
        }
    }

    /// Sets the velocities [m/s] of the pieces' nodes.
    pub(super) fn start_with(&mut self, velocities_m_per_s: &[DVec3]) {
        for piece in &mut self.pieces {
            piece.start_with(velocities_m_per_s);
        }
        self.write_velocities();
    }

    pub(super) fn velocities_m_per_s(&self) -> &[DVec3] {
        &self.velocities_m_per_s
    }

    /// Appends the state of the pieces that the next step depends on besides positions.
    pub(super) fn history_into(&self, numbers: &mut Vec<f64>) {
        self.pieces.iter().for_each(|piece| piece.history_into(numbers));
    }

    pub(super) fn take_over(&mut self, positions_m: &[DVec3], shown_m: &mut [DVec3]) {
        for (p, piece) in self.pieces.iter_mut().enumerate() {
            piece.take_over(positions_m);
            for (&now_m, &node) in piece.positions_m().iter().zip(&piece.nodes) {
                if self.owners.of(node) == Some(p) {
                    shown_m[node.index()] = now_m;
                }
            }
        }
        self.write_velocities();
    }

    pub(super) fn report(&self) -> CutReport {
        self.report
    }
}
