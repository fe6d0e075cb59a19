//! Cutting a pre-computed body: its compliance follows the removal of tetrahedra.
//!
//! An edit goes so: tetrahedra that no longer bear a load are found (`rigid`) and leave the compliance with those
//! that were removed; nodes that they lay bare get rows and columns from the factor of the uncut body; nodes that are
//! left without a bearing tetrahedron are held for good, which does not touch the rest, and leave the table; the
//! removal is one change of low rank (`low_rank`) on the table and the response to weight. Of a loose piece only the
//! tetrahedra at its hinges are taken out of the stiffness: what is left of it does not touch the held body, and
//! three held points of each of its clusters keep the whole regular. The pieces go on by themselves (`loose`).
//!
//! A running estimate of the error: for one unit force after each edit, K0 x = f + sum over what was removed of
//! U U^T u is solved with the factor of the uncut body, where u is the table's response; x = u in exact arithmetic.

use std::sync::Arc;

use super::growth::{LowRankChange, RANK, add_low_rank_to, swap_rows_of};
use super::loose::{LooseParams, LoosePiece, MOST_PULL_SHARE, Owners};
use super::low_rank::{Change, History, NodeColumns, NodeWeight, RemovedTet, Working, WorkingNode};
use super::response::Load;
use super::rigid::{Clusters, loose_tets, span};
use super::table::{Table, n_displacements, place, place_of_displacement};
use super::{Compliance, NONE, Precision, Precomputed};
use crate::math::DVec3;
use crate::mesh::edit::{EditableMesh, TopologyChange};
use crate::mesh::{NodeId, TetId, TetMesh};
use crate::model::kind::ModelKind;
use crate::model::{ImposedDisplacement, ModelReport, NodalForce, TopologyRefusal};
use crate::solve::{
    BoundaryConditions, Factorization, FreeSystem, MeshEdges, SolveError, StiffnessTensors,
    add_gravity_forces,
};

/// Tetrahedra that are removed as one change at most: the dense work in a change grows with the square of their
/// number, the passes over the table with their number alone.
const MOST_TETS_IN_CHANGE: usize = 16;

/// Iterations for the largest stiffness of the pieces over that of the held body at the hinges.
const POWER_ITERATIONS: usize = 30;

/// Nodes that are solved for at once.
const NODES_IN_BLOCK: usize = 16;

/// Least share of rows and loaded nodes to spare when a table grows: 1 / 8. A choice.
const SPARE_SHARE: usize = 8;

/// Estimated error of the compliance, relative to its largest entry, from which on a fresh pre-computation is asked
/// for. A choice: well below what anyone sees or feels (1e-6 of the softest point's displacement), well above
/// rounding. Storage in f32 has errors of 6e-8 from the start.
pub const RECOMPUTATION_ERROR: f64 = 1e-6;

/// Columns in the history from which on a fresh pre-computation is asked for: that of 400 tetrahedra, which takes the
/// memory of a table of the standard liver. A choice.
pub const RECOMPUTATION_COLUMNS: usize = 2400;

/// How far a compliance has come from the pre-computed one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CutReport {
    /// Edits followed.
    pub n_edits: usize,
    /// Tetrahedra that left the compliance, loose ones at hinges included.
    pub n_taken_out: usize,
    /// Tetrahedra of pieces that came loose and were handed to a dynamic body.
    pub n_loose: usize,
    /// Columns of low rank in the history.
    pub n_columns: usize,
    /// Nodes laid bare that got rows and columns from the factor.
    pub n_laid_bare: usize,
    /// Least pivot of all capacitance matrices so far; 1 before the first.
    pub least_pivot: f64,
    /// Estimated error relative to the largest entry of the compliance: the largest of the last probes.
    pub error: f64,
    /// Whether a fresh pre-computation should take over.
    pub wants_recomputation: bool,
}

/// What stays of the uncut body.
struct Origin {
    system: FreeSystem,
    factor: Factorization,
    /// Response of each node to unit gravity along each axis: `[gravity axis][node]` [m per m/s2].
    weight_s2: Arc<[Vec<DVec3>; 3]>,
}

/// Everything that following a cut needs.
#[derive(Clone)]
pub(super) struct Cuts {
    origin: Arc<Origin>,
    body: EditableMesh,
    /// Tetrahedra whose stiffness is that of the held body.
    bears: Vec<bool>,
    is_fixed: Vec<bool>,
    /// Nodes without a bearing tetrahedron.
    is_out: Vec<bool>,
    history: History,
    taken_out: Vec<RemovedTet>,
    pub(super) pieces: Vec<LoosePiece>,
    owners: Owners,
    /// Pulls of the hinges on the held body: piece, hinge, loadable node.
    hinge_rows: Vec<(u32, u32, u32)>,
    pull_share: f64,
    numbers: Vec<f64>,
    /// Response of each node of the whole body to unit gravity along each axis [m per m/s2].
    whole_weight_s2: Arc<[Vec<DVec3>; 3]>,
    /// What the whole body's own weight does to the rows [m], in blocks: it is in the rest shape already, where that
    /// is the loaded one. Empty while nothing is cut.
    carried_m: Vec<f64>,
    report: CutReport,
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
        let system = FreeSystem::new(&edges, &tensors, &BoundaryConditions::fixed(&held))?;
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
    /// Before the first cut of `mesh`, of which the tetrahedra that `bears` counts are in the compliance.
    fn new(mesh: &TetMesh, bears: Vec<bool>, compliance: &Compliance) -> Result<Self, SolveError> {
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
            numbers: Vec::new(),
            report: CutReport { least_pivot: 1.0, ..CutReport::default() },
        })
    }

    /// Columns of nodes of the uncut body over the known unknowns, brought up to date. Nodes that are not known are
    /// admitted.
    fn columns_from_factor(&mut self, nodes: &[NodeId]) -> Vec<(NodeColumns, NodeWeight)> {
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

    fn corners(&self, tet: TetId) -> [NodeId; 4] {
        self.body.topology().tet_nodes(tet)
    }

    /// Nodes with a bearing tetrahedron.
    fn borne(&self) -> Vec<bool> {
        let mut borne = vec![false; self.is_out.len()];
        for t in (0..self.bears.len()).filter(|&t| self.bears[t]) {
            for node in self.corners(TetId::from_index(t)) {
                borne[node.index()] = true;
            }
        }
        borne
    }

    /// Nodes to be held so that what is left of loose pieces and nodes stays regular, ascending: all of `leaving`
    /// without a tetrahedron in `left`, and three points of each cluster of `left`.
    fn to_hold(&self, leaving: &[NodeId], left: &[TetId], has_row: impl Fn(NodeId) -> bool) -> Vec<NodeId> {
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
            // Nodes that have a column cost nothing.
            let with_row: Vec<NodeId> = nodes.iter().copied().filter(|&n| has_row(n)).collect();
            let chosen = span(&with_row, rest_m).or_else(|| span(&nodes, rest_m));
            held.extend(chosen.into_iter().flatten().filter(|n| !self.is_fixed[n.index()]));
            held.sort_unstable();
            held.dedup();
        }
        held.sort_unstable();
        held
    }

    /// Who moves a tool's node, if a piece does.
    pub(super) fn piece_of(&mut self, node: NodeId) -> Option<(&mut LoosePiece, u32)> {
        let piece = &mut self.pieces[self.owners.of(node)?];
        let local = piece.local(node)?;
        Some((piece, local))
    }

    /// Pulls of loose pieces on the held body: loadable node, force [N].
    pub(super) fn pulls(&self) -> impl Iterator<Item = Load> + '_ {
        self.hinge_rows.iter().map(|&(piece, hinge, loadable)| {
            (loadable, self.pieces[piece as usize].hinges[hinge as usize].pull_n)
        })
    }

    /// Moves the pieces, the latest first, since earlier ones can hang on it.
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
        self.write_numbers();
    }

    fn write_numbers(&mut self) {
        let mut rest = &mut self.numbers[..];
        for piece in &self.pieces {
            let (own, others) = rest.split_at_mut(piece.n_history());
            piece.write_history(own);
            rest = others;
        }
    }

    /// Makes hinges, and the lists that steps use, after an edit.
    fn join_pieces(&mut self, loadable: impl Fn(NodeId) -> Option<u32>) {
        let borne = self.borne();
        for (p, piece) in self.pieces.iter().enumerate().rev() {
            for (local, &node) in piece.nodes.iter().enumerate() {
                let owner = self.owners.of(node).map(|owner| &self.pieces[owner]);
                let has_owner = owner.is_some_and(|own| own.local(node).is_some_and(|l| own.moves(l)));
                // A hinge that its owner lost is the piece's own from now on.
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
        let n = self.pieces.iter().map(LoosePiece::n_history).sum();
        self.numbers.clear();
        self.numbers.resize(n, 0.0);
        self.write_numbers();
    }

    /// What the whole body's own weight does to the rows [m], in blocks; `None` while nothing is cut.
    pub(super) fn carried_m(&self) -> Option<&[f64]> {
        (!self.carried_m.is_empty()).then_some(&self.carried_m)
    }

    pub(super) fn numbers(&self) -> &[f64] {
        &self.numbers
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
        self.write_numbers();
    }

    pub(super) fn report(&self) -> CutReport {
        self.report
    }
}

/// What the model hands on to its loose pieces, and what they tell.
impl Precomputed {
    /// Pieces forget what acts on them.
    pub(super) fn release_pieces(&mut self) {
        for piece in self.cuts.iter_mut().flat_map(|cuts| &mut cuts.pieces) {
            piece.release();
        }
    }

    /// A force on a node that a piece may move; answers whether it does.
    pub(super) fn push_piece(&mut self, force: &NodalForce) -> bool {
        let piece = self.cuts.as_mut().and_then(|cuts| cuts.piece_of(force.node));
        force.force_n.is_finite() && piece.is_some_and(|(piece, local)| piece.push(local, force.force_n))
    }

    /// A displacement of a node that a piece may move; answers whether it does.
    pub(super) fn move_piece(&mut self, place: usize, imposed: &ImposedDisplacement) -> bool {
        let u_m = imposed.displacement_m;
        let piece = self.cuts.as_mut().and_then(|cuts| cuts.piece_of(imposed.node));
        u_m.is_finite() && piece.is_some_and(|(piece, local)| piece.impose(local, place as u32, u_m))
    }

    /// Moves the pieces, with the forces of tools that hold them.
    pub(super) fn step_pieces(&mut self, dt_s: f64) {
        let Some(cuts) = &mut self.cuts else { return };
        let felt_n = &mut self.constraint_forces_n;
        cuts.step_pieces(dt_s, &self.rest_m, &mut self.positions_m, |place, force_n| {
            if let Some(felt_n) = felt_n.get_mut(place) {
                *felt_n = force_n;
            }
        });
    }

    /// What the next step of the pieces depends on beside positions.
    pub(super) fn piece_numbers(&self) -> &[f64] {
        self.cuts.as_ref().map_or(&[], |cuts| cuts.numbers())
    }

    /// Adds what the cuts and the pieces tell.
    pub(super) fn add_cuts_to(&self, report: &mut ModelReport) {
        let Some(cuts) = &self.cuts else { return };
        report.n_reanalyses = cuts.report.n_edits as u32;
        report.compliance_error = cuts.report.error;
        report.wants_recomputation = cuts.report.wants_recomputation;
        for piece in &cuts.pieces {
            let own = piece.report();
            report.n_parts = report.n_parts.max(own.n_parts);
            report.n_quarantined_tets += own.n_quarantined_tets;
            report.n_recovered_nodes += own.n_recovered_nodes;
            report.n_mass_scaled_nodes += own.n_mass_scaled_nodes;
            report.kinetic_energy_j += own.kinetic_energy_j;
            report.energy_was_limited |= own.energy_was_limited;
        }
    }
}

impl Precomputed {
    /// Gets ready for cuts: factors K of the uncut body. Without this call the first cut does it. `mesh` is the one
    /// that the model was computed for.
    ///
    /// # Errors
    /// [`SolveError`] when memory is short.
    pub fn prepare_cutting(&mut self, mesh: &TetMesh) -> Result<(), SolveError> {
        if self.cuts.is_none() {
            let bears = vec![true; mesh.tetrahedra.len()];
            self.cuts = Some(Box::new(Cuts::new(mesh, bears, &self.compliance)?));
            self.grow(self.compliance.rows.len(), self.compliance.n_loadable);
        }
        Ok(())
    }

    /// How far the cuts have brought the compliance from the pre-computed one.
    pub fn cut_report(&self) -> CutReport {
        self.cuts.as_ref().map_or(CutReport { least_pivot: 1.0, ..CutReport::default() }, |c| c.report())
    }

    /// Whether tetrahedra were taken out since the pre-computation, or before it.
    pub(super) fn is_cut(&self) -> bool {
        self.cuts.as_ref().is_some_and(|cuts| cuts.body.topology().has_dead())
    }

    /// Nodes that loose pieces move.
    pub fn loose_nodes(&self) -> Vec<NodeId> {
        let Some(cuts) = &self.cuts else { return Vec::new() };
        let all = (0..cuts.is_out.len()).map(NodeId::from_index);
        all.filter(|&n| cuts.owners.of(n).is_some()).collect()
    }

    /// A model of the mesh as it was cut: `live` says which tetrahedra are there. Pieces that nothing holds start as
    /// loose ones at rest.
    ///
    /// # Errors
    /// As [`Precomputed::build`]; [`super::PrecomputedError::NothingLoadable`] when nothing is held.
    pub fn build_cut(
        params: &super::PrecomputedParams<'_>,
        live: &[bool],
    ) -> Result<Self, super::PrecomputedError> {
        let mesh = params.mesh;
        let n_nodes = mesh.positions_m.len();
        let mut is_fixed = vec![false; n_nodes];
        for node in params.fixed_nodes.iter().filter(|n| n.index() < n_nodes) {
            is_fixed[node.index()] = true;
        }
        let mut body = EditableMesh::new(mesh.clone()).map_err(|_| SolveError::EmptyMesh)?;
        let dead: Vec<TetId> = (0..live.len()).filter(|&t| !live[t]).map(TetId::from_index).collect();
        body.remove_into(&dead, &mut TopologyChange::default()).map_err(|_| SolveError::EmptyMesh)?;
        let loose = loose_tets(body.topology(), &mesh.positions_m, live, &is_fixed);
        let mut bears = live.to_vec();
        for tet in &loose {
            bears[tet.index()] = false;
        }
        let mut held = is_fixed;
        let mut is_borne = vec![false; n_nodes];
        let bearing: Vec<[NodeId; 4]> =
            (0..live.len()).filter(|&t| bears[t]).map(|t| mesh.tetrahedra[t]).collect();
        for node in bearing.iter().flatten() {
            is_borne[node.index()] = true;
        }
        held.iter_mut().zip(&is_borne).for_each(|(held, borne)| *held |= !borne);
        let held: Vec<NodeId> = (0..n_nodes).filter(|&n| held[n]).map(NodeId::from_index).collect();
        let part = TetMesh { positions_m: mesh.positions_m.clone(), tetrahedra: bearing };
        let part_params = super::PrecomputedParams { mesh: &part, fixed_nodes: &held, ..*params };
        let mut model = Self::build(&part_params)?;
        let mut fixed_nodes = params.fixed_nodes.to_vec();
        fixed_nodes.sort_unstable();
        fixed_nodes.dedup();
        model.compliance.fixed_nodes = fixed_nodes;
        model.compliance.mesh_hash = super::mesh_hash(mesh);
        let mut cuts = Cuts::new(mesh, bears, &model.compliance)?;
        cuts.body = body;
        model.cuts = Some(Box::new(cuts));
        model.grow(model.compliance.rows.len(), model.compliance.n_loadable);
        model.change_cuts(|model, cuts| {
            model.let_loose(cuts, &loose);
            model.join_pieces(cuts);
        });
        Ok(model)
    }

    /// Follows the removal of tetrahedra.
    pub(super) fn follow(&mut self, mesh: &TetMesh, change: &TopologyChange) -> Result<(), TopologyRefusal> {
        let brings_in = !(change.nodes.added.ids().is_empty() && change.tets.added.ids().is_empty());
        if change.is_renumbering() || brings_in || !change.moved_nodes.is_empty() {
            return Err(TopologyRefusal::Frozen {
                model: ModelKind::Precomputed.name(),
                reason: "it follows removals of tetrahedra only; pre-compute the new mesh",
            });
        }
        if change.tets.removed.is_empty() {
            return Ok(());
        }
        self.prepare_cutting(mesh).map_err(|_| TopologyRefusal::Frozen {
            model: ModelKind::Precomputed.name(),
            reason: "its stiffness matrix cannot be factored in the memory that there is",
        })?;
        self.change_cuts(|model, cuts| model.remove(cuts, &change.tets.removed));
        // Rows to spare are not shown.
        self.displacement_m.resize(n_displacements(self.compliance.rows.len()), 0.0);
        self.carry_weight();
        Ok(())
    }

    fn change_cuts(&mut self, change: impl FnOnce(&mut Self, &mut Cuts)) {
        let Some(mut cuts) = self.cuts.take() else { return };
        change(self, &mut cuts);
        self.cuts = Some(cuts);
    }

    fn remove(&mut self, cuts: &mut Cuts, tets: &[TetId]) {
        let live: Vec<TetId> =
            tets.iter().copied().filter(|&t| cuts.body.topology().is_live_tet(t)).collect();
        if live.is_empty() {
            return;
        }
        let old_rows = self.compliance.rows.clone();

        let (mut taken, of_pieces): (Vec<TetId>, Vec<TetId>) =
            live.iter().partition(|t| cuts.bears[t.index()]);
        cuts.body.remove_into(&live, &mut TopologyChange::default()).expect("live tetrahedra, each once");
        for piece in &mut cuts.pieces {
            let own: Vec<TetId> = of_pieces.iter().copied().filter(|&t| piece.has_tet(t)).collect();
            piece.remove(&own);
        }
        for tet in &taken {
            cuts.bears[tet.index()] = false;
        }
        let rest_m = &cuts.body.mesh().positions_m;
        let loose = loose_tets(cuts.body.topology(), rest_m, &cuts.bears, &cuts.is_fixed);
        for tet in &loose {
            cuts.bears[tet.index()] = false;
        }
        let borne = cuts.borne();
        // The stiffness of a loose piece at its hinges must go; the rest of it does not touch what is held.
        let is_at_hinge = |t: &&TetId| {
            let is_hinge = |n: NodeId| borne[n.index()] && !cuts.is_fixed[n.index()];
            cuts.corners(**t).into_iter().any(is_hinge)
        };
        let (at_hinges, left): (Vec<TetId>, Vec<TetId>) = loose.iter().partition(is_at_hinge);
        taken.extend(at_hinges);
        taken.sort_unstable();
        let leaving: Vec<NodeId> = (0..borne.len())
            .filter(|&n| !(borne[n] || cuts.is_out[n] || cuts.is_fixed[n]))
            .map(NodeId::from_index)
            .collect();
        let held = cuts.to_hold(&leaving, &left, |n| self.is_loadable(n));
        if !loose.is_empty() {
            self.let_loose(cuts, &loose);
        }
        if !taken.is_empty() {
            self.change_compliance(cuts, &taken, &held, &borne);
        }
        for node in leaving {
            cuts.is_out[node.index()] = true;
            self.drop_node(node);
        }
        cuts.report.n_edits += 1;
        self.probe(cuts);
        self.join_pieces(cuts);

        self.follow_rows(&old_rows);
    }

    /// Makes hinges between the pieces and what is held, and says how fast the held body feels their pull.
    fn join_pieces(&self, cuts: &mut Cuts) {
        cuts.join_pieces(|node| self.loadable_index(node));
        if cuts.hinge_rows.is_empty() {
            return;
        }
        // Power iteration on K C over the hinges, K of the pieces and C of the held body: how much stiffer they are.
        let n = cuts.hinge_rows.len();
        let mut x: Vec<DVec3> = (0..n).map(|i| DVec3::new(1.0, 0.7, 0.4 + i as f64 / n as f64)).collect();
        let mut ratio = 0.0;
        for _ in 0..POWER_ITERATIONS {
            let norm = x.iter().map(|x| x.length_squared()).sum::<f64>().sqrt();
            if norm <= 0.0 {
                break;
            }
            x.iter_mut().for_each(|x| *x /= norm);
            let u_m: Vec<DVec3> = cuts
                .hinge_rows
                .iter()
                .map(|&(_, _, l)| {
                    let by = cuts.hinge_rows.iter().zip(&x);
                    by.map(|(&(_, _, m), x)| self.compliance.table.tensor(l as usize, m as usize) * *x).sum()
                })
                .collect();
            x.fill(DVec3::ZERO);
            for (p, piece) in cuts.pieces.iter().enumerate() {
                let mut of_piece = vec![DVec3::ZERO; piece.hinges.len()];
                let mut force_n = of_piece.clone();
                let own = || cuts.hinge_rows.iter().enumerate().filter(|(_, row)| row.0 as usize == p);
                own().for_each(|(i, row)| of_piece[row.1 as usize] = u_m[i]);
                piece.add_hinge_forces(&self.compliance.material, &of_piece, &mut force_n);
                own().for_each(|(i, row)| x[i] = force_n[row.1 as usize]);
            }
            ratio = x.iter().map(|x| x.length_squared()).sum::<f64>().sqrt();
        }
        // Half of what is stable at rest: a stretched piece is stiffer.
        cuts.pull_share = MOST_PULL_SHARE.min(1.0 / (1.0 + ratio));
    }

    /// Makes a dynamic body of tetrahedra that came loose.
    fn let_loose(&mut self, cuts: &mut Cuts, loose: &[TetId]) {
        if loose.is_empty() {
            return;
        }
        let made = LoosePiece::new(&LooseParams {
            mesh: cuts.body.mesh(),
            material: &self.compliance.material,
            tets: loose,
            is_fixed: &cuts.is_fixed,
            positions_m: &self.positions_m,
            is_placed: &|node| self.row_of[node.index()] != NONE || cuts.owners.of(node).is_some(),
            gravity_m_per_s2: self.rest_gravity_m_per_s2 + self.pull_m_per_s2,
        });
        // A piece that no dynamic body can be made of (a flat tetrahedron) stays where it is.
        let Ok(piece) = made else { return };
        let borne = cuts.borne();
        let p = cuts.pieces.len();
        for &node in &piece.nodes {
            if !borne[node.index()] {
                cuts.owners.set(node, p);
            }
        }
        for (node, &now_m) in piece.nodes.iter().zip(piece.positions_m()) {
            if cuts.owners.of(*node) == Some(p) {
                self.positions_m[node.index()] = now_m;
            }
        }
        cuts.pieces.push(piece);
        cuts.report.n_loose += loose.len();
    }

    /// Takes the stiffness and weight of `taken` out of the compliance, with the nodes `held` held for good.
    fn change_compliance(&mut self, cuts: &mut Cuts, taken: &[TetId], held: &[NodeId], borne: &[bool]) {
        let mut touched: Vec<NodeId> = taken.iter().flat_map(|&t| cuts.corners(t)).collect();
        touched.extend(held);
        touched.sort_unstable();
        touched.dedup();
        touched.retain(|n| !(cuts.is_fixed[n.index()] || cuts.is_out[n.index()]));
        self.make_loadable(cuts, &touched);

        let mut working = self.working(cuts, &touched);
        let mut changes: Vec<Change> =
            held.chunks(MOST_TETS_IN_CHANGE).map(|nodes| working.hold(nodes)).collect();
        let material = self.compliance.material;
        let removed: Vec<RemovedTet> = taken
            .iter()
            .map(|&t| {
                let corners_m = cuts.body.mesh().corners_m(t);
                RemovedTet::new(cuts.corners(t), corners_m, material.lambda_pa(), material.mu_pa())
            })
            .collect();
        for tets in removed.chunks(MOST_TETS_IN_CHANGE) {
            let Some((change, least_pivot)) = working.remove(tets) else { continue };
            cuts.report.least_pivot = cuts.report.least_pivot.min(least_pivot);
            changes.push(change);
        }
        self.add_changes(cuts, &changes);
        for change in changes {
            cuts.history.push(change);
        }
        cuts.taken_out.extend(removed);

        let mut masses: Vec<(NodeId, f64)> = Vec::new();
        for &tet in taken {
            let corner_kg = material.density_kg_per_m3() * cuts.body.mesh().tet_volume_m3(tet) / 4.0;
            masses.extend(cuts.corners(tet).map(|n| (n, corner_kg)));
        }
        masses.retain(|(n, _)| borne[n.index()] && !cuts.is_fixed[n.index()]);
        for &(node, mass_kg) in &masses {
            let loaded = self.loadable_index(node).expect("corners of what goes are loadable");
            let response = &mut self.compliance.weight_response_s2;
            for axis in 0..3 {
                self.compliance.table.add_column_to(loaded as usize, axis, -mass_kg, response);
            }
        }
        let at =
            |&(n, m): &(NodeId, f64)| (cuts.history.place(n).expect("loadable nodes are known") as u32, m);
        let masses = masses.iter().map(at).collect();
        cuts.history.push_lighter(masses);
        cuts.report.n_columns = cuts.history.n_columns();
        cuts.report.n_taken_out = cuts.taken_out.len();
    }

    /// Gives nodes rows and columns that they lack.
    fn make_loadable(&mut self, cuts: &mut Cuts, nodes: &[NodeId]) {
        let bare: Vec<NodeId> = nodes.iter().copied().filter(|&n| !self.is_loadable(n)).collect();
        if bare.is_empty() {
            return;
        }
        self.make_room(self.compliance.rows.len() + bare.len(), self.compliance.n_loadable + bare.len());
        for (i, (columns, weight)) in cuts.columns_from_factor(&bare).into_iter().enumerate() {
            self.add_loadable(cuts, bare[i], &columns, &weight);
        }
        cuts.report.n_laid_bare += bare.len();
    }

    fn add_loadable(&mut self, cuts: &Cuts, node: NodeId, columns: &NodeColumns, weight: &NodeWeight) {
        let compliance = &mut self.compliance;
        let m = compliance.n_loadable;
        let mut row = self.row_of[node.index()] as usize;
        if self.row_of[node.index()] == NONE {
            row = compliance.rows.len();
            compliance.rows.push(node);
            self.row_of[node.index()] = row as u32;
            for d in 0..3 {
                for axis in 0..3 {
                    compliance.weight_response_s2[place(row, axis, d)] = weight[d][axis];
                }
            }
        }
        if row != m {
            let other = compliance.rows[m];
            compliance.rows.swap(row, m);
            compliance.table.swap_rows(row, m);
            swap_rows_of(&mut compliance.weight_response_s2, row, m);
            self.row_of[other.index()] = row as u32;
            self.row_of[node.index()] = m as u32;
        }
        compliance.table.push_loaded();
        compliance.n_loadable += 1;
        for row in 0..compliance.rows.len() {
            let of = cuts.history.place(compliance.rows[row]).expect("rows are known");
            let column =
                |d: usize| DVec3::from_slice(columns[d].get(3 * of..3 * of + 3).unwrap_or(&[0.0; 3]));
            let tensor = crate::math::DMat3::from_cols(column(0), column(1), column(2));
            compliance.table.set_tensor(row, m, &tensor);
            if row < m {
                compliance.table.set_tensor(m, row, &tensor.transpose());
            }
        }
    }

    /// Takes a node out of the table, if it is there.
    fn drop_node(&mut self, node: NodeId) {
        let row = self.row_of[node.index()];
        if row == NONE {
            return;
        }
        let mut row = row as usize;
        let compliance = &mut self.compliance;
        let mut exchange = |compliance: &mut Compliance, a: usize, b: usize| {
            if a != b {
                let (of_a, of_b) = (compliance.rows[a], compliance.rows[b]);
                compliance.rows.swap(a, b);
                compliance.table.swap_rows(a, b);
                swap_rows_of(&mut compliance.weight_response_s2, a, b);
                self.row_of[of_a.index()] = b as u32;
                self.row_of[of_b.index()] = a as u32;
            }
        };
        if row < compliance.n_loadable {
            let last = compliance.n_loadable - 1;
            compliance.table.swap_loaded(row, last);
            exchange(compliance, row, last);
            compliance.table.pop_loaded();
            compliance.n_loadable = last;
            row = last;
        }
        let last = compliance.rows.len() - 1;
        exchange(compliance, row, last);
        compliance.rows.pop();
        compliance.table.clear_row(last);
        for component in 0..9 {
            compliance.weight_response_s2[place(last, component / 3, component % 3)] = 0.0;
        }
        self.row_of[node.index()] = NONE;
    }

    /// Room for so many rows and loaded nodes.
    fn make_room(&mut self, n_rows: usize, n_loaded: usize) {
        if n_rows > self.compliance.table.room() {
            self.grow(n_rows, n_loaded);
        }
    }

    /// Room for so many rows and loaded nodes, and some to spare.
    fn grow(&mut self, n_rows: usize, n_loaded: usize) {
        let compliance = &mut self.compliance;
        let with_spare = |n: usize| n + (n / SPARE_SHARE).max(32);
        compliance.table = compliance.table.with_room(with_spare(n_rows), with_spare(n_loaded));
        let room = compliance.table.room();
        compliance.weight_response_s2.resize(Table::stride(room), 0.0);
    }

    /// After an edit, or when another gravity is carried at rest.
    pub(super) fn carry_weight(&mut self) {
        let n = n_displacements(self.compliance.rows.len());
        let g = self.rest_gravity_m_per_s2;
        let Some(cuts) = &mut self.cuts else { return };
        cuts.carried_m.clear();
        if g == DVec3::ZERO || !cuts.body.topology().has_dead() {
            return;
        }
        cuts.carried_m.resize(n, 0.0);
        for (row, node) in self.compliance.rows.iter().enumerate() {
            for axis in 0..3 {
                let along = |d: usize| cuts.whole_weight_s2[d][node.index()][axis] * g[d];
                cuts.carried_m[place_of_displacement(row, axis)] = along(0) + along(1) + along(2);
            }
        }
    }

    /// Columns and responses to weight of nodes that are loadable.
    fn working(&self, cuts: &mut Cuts, nodes: &[NodeId]) -> Working {
        let is_exact = self.compliance.table.precision() == Precision::F64;
        // Numbers of four bytes would not tell a mechanism from a thin bridge: the factor gives all digits.
        let from_factor = if is_exact { Vec::new() } else { cuts.columns_from_factor(nodes) };
        let mut from_factor = from_factor.into_iter();
        let of_node = |&node: &NodeId| {
            let loaded = self.row_of[node.index()] as usize;
            let (columns, weight) = from_factor.next().unwrap_or_else(|| {
                let mut columns: NodeColumns = std::array::from_fn(|_| vec![0.0; cuts.history.n_unknowns()]);
                for (row, n) in self.compliance.rows.iter().enumerate() {
                    let at = cuts.history.place(*n).expect("rows are known");
                    let tensor = self.compliance.table.tensor(row, loaded);
                    for (d, column) in columns.iter_mut().enumerate() {
                        column[3 * at..3 * at + 3].copy_from_slice(&tensor.col(d).to_array());
                    }
                }
                let response = &self.compliance.weight_response_s2;
                let weight: NodeWeight =
                    std::array::from_fn(|d| std::array::from_fn(|axis| response[place(loaded, axis, d)]));
                (columns, weight)
            });
            WorkingNode {
                node,
                place: cuts.history.place(node).expect("loadable nodes are known"),
                columns,
                weight,
            }
        };
        Working { nodes: nodes.iter().map(of_node).collect() }
    }

    /// Adds changes to the table and the response to weight.
    fn add_changes(&mut self, cuts: &Cuts, changes: &[Change]) {
        let compliance = &mut self.compliance;
        let places: Vec<usize> =
            compliance.rows.iter().map(|&n| 3 * cuts.history.place(n).expect("rows are known")).collect();
        let columns: Vec<(f64, &Vec<f64>, &[f64; 3])> = changes
            .iter()
            .flat_map(|c| c.columns().iter().zip(c.of_weight()).map(|(w, weight)| (c.sign(), w, weight)))
            .collect();
        for group in columns.chunks(RANK) {
            let of_row: Vec<_> = group
                .iter()
                .map(|&(_, w, _)| {
                    let places = &places;
                    move |row: usize, axis: usize| w[places[row] + axis]
                })
                .collect();
            let blocks = LowRankChange::blocks_of(compliance.rows.len(), &of_row);
            let mut factors = vec![[[0.0; 3]; RANK]; compliance.n_loadable];
            for (factors, &place) in factors.iter_mut().zip(&places) {
                for (factor, &(sign, w, _)) in factors.iter_mut().zip(group) {
                    *factor = [0, 1, 2].map(|d| sign * w[place + d]);
                }
            }
            let mut of_weight = [[0.0; 3]; RANK];
            for (factor, &(sign, _, weight)) in of_weight.iter_mut().zip(group) {
                *factor = weight.map(|x| sign * x);
            }
            add_low_rank_to(&mut compliance.weight_response_s2, &blocks, &of_weight);
            compliance.table.add_low_rank(&LowRankChange { blocks, factors });
        }
    }

    /// Estimates the error with the response to one unit force, another one after each edit.
    fn probe(&self, cuts: &mut Cuts) {
        let compliance = &self.compliance;
        if compliance.n_loadable == 0 {
            return;
        }
        // A prime step goes round all loadable nodes.
        let n_edits = cuts.report.n_edits;
        let (loaded, axis) = (n_edits * 7919 % compliance.n_loadable, n_edits % 3);
        let system = &cuts.origin.system;
        let mut right_n = vec![DVec3::ZERO; self.rest_m.len()];
        right_n[compliance.rows[loaded].index()] = DVec3::AXES[axis];
        let response = |n: NodeId| {
            let row = self.row_of[n.index()];
            if row == NONE {
                return DVec3::ZERO;
            }
            compliance.table.tensor(row as usize, loaded).col(axis)
        };
        for tet in &cuts.taken_out {
            let forces_n = tet.forces_n(tet.nodes.map(response));
            for (node, force_n) in tet.nodes.into_iter().zip(forces_n) {
                right_n[node.index()] += force_n;
            }
        }
        let mut solution = vec![0.0; system.n_free()];
        system.gather_into(&right_n, &mut solution);
        let factor = &cuts.origin.factor;
        factor.solve_in_place(&mut solution, 1, &mut factor.scratch(1));
        let mut difference = 0.0_f64;
        for &node in &compliance.rows {
            let table = response(node);
            for d in 0..3 {
                let exact = system.row_of(node, d).map_or(0.0, |row| solution[row]);
                let off = (table[d] - exact).abs();
                // A number that is not finite is an error beyond every bound.
                difference = if off.is_finite() { difference.max(off) } else { f64::INFINITY };
            }
        }
        let largest = (0..compliance.n_loadable)
            .flat_map(|m| {
                let tensor = compliance.table.tensor(m, m);
                [0, 1, 2].map(|d| tensor.col(d)[d])
            })
            .fold(f64::MIN_POSITIVE, f64::max);
        let report = &mut cuts.report;
        report.error = report.error.max(difference / largest);
        report.wants_recomputation =
            report.error > RECOMPUTATION_ERROR || report.n_columns > RECOMPUTATION_COLUMNS;
    }
}
