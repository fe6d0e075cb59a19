//! Cutting a pre-computed body: its compliance follows the removal of tetrahedra.
//!
//! The steps of an edit:
//! - Tetrahedra that no longer bear a load are found (`rigid`); they leave the compliance with the removed ones.
//! - Nodes that are exposed get rows and columns from the factor of the uncut body.
//! - Nodes without a bearing tetrahedron are held for good, which does not change the rest, and leave the table.
//! - The removal is one low-rank update (`low_rank`) of the table and of the response to weight.
//!
//! Of a fragment only the tetrahedra at its hinges are taken out of the stiffness: the rest of it does not touch the
//! held body, and three held points of each of its clusters keep K regular. Loose pieces move as bodies of their own
//! (`loose`).
//!
//! The error is estimated after each edit (`following`).

use super::cut_report::CutReport;
use super::cuts::Cuts;
use super::fragments::{Fragment, FragmentParams, MOST_PULL_SHARE};
use super::rigid::fragment_tets;
use super::table::{n_displacements, place_of_displacement};
use super::{NAME, NONE, Precomputed};
use crate::model::{ImposedDisplacement, ModelReport, NodalForce, TopologyRefusal};
use crate::solve::SolveError;
use glisson_mesh::fault;
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::edit::{EditableMesh, TopologyChange};
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};

/// Power iterations for the largest ratio of the pieces' stiffness to that of the held body at the hinges.
const POWER_ITERATIONS: usize = 30;

/// Estimated error of the compliance, relative to its largest entry, above which a new pre-computation is requested. A
/// choice: well below what anyone sees or feels (1e-6 of the softest point's displacement), well above rounding.
pub const RECOMPUTATION_ERROR: f64 = 1e-6;

/// Columns in the history above which a new pre-computation is requested: those of 400 tetrahedra, which take about the
/// memory of a table of 614 nodes. A choice.
pub const RECOMPUTATION_COLUMNS: usize = 2400;

/// Limits above which a new pre-computation is requested.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecomputationLimits {
    /// Estimated error of the compliance, relative to its largest entry.
    pub error: f64,
    /// Columns in the history of changes.
    pub n_columns: usize,
}

impl Default for RecomputationLimits {
    fn default() -> Self {
        Self { error: RECOMPUTATION_ERROR, n_columns: RECOMPUTATION_COLUMNS }
    }
}

/// What passes between the model and its fragments.
impl Precomputed {
    /// Clears the loads and tools on the pieces.
    pub(super) fn release_pieces(&mut self) {
        for piece in self.cuts.iter_mut().flat_map(|cuts| &mut cuts.pieces) {
            piece.release();
        }
    }

    /// Applies a force to a node; returns whether a piece moves this node.
    pub(super) fn push_piece(&mut self, force: &NodalForce) -> bool {
        let piece = self.cuts.as_mut().and_then(|cuts| cuts.piece_of(force.node));
        force.force_n.is_finite() && piece.is_some_and(|(piece, local)| piece.push(local, force.force_n))
    }

    /// Imposes a displacement on a node; returns whether a piece moves this node.
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

    /// Velocities of all nodes; zero except for those of pieces; empty without pieces.
    pub(super) fn piece_velocities_m_per_s(&self) -> &[DVec3] {
        self.cuts.as_ref().map_or(&[], |cuts| cuts.velocities_m_per_s())
    }

    /// Adds the report of the cuts and the pieces. Stuck tetrahedra count as quarantined: no force moves them.
    pub(super) fn add_cuts_to(&self, report: &mut ModelReport) {
        let Some(cuts) = &self.cuts else { return };
        report.n_reanalyses = cuts.report.n_edits as u32;
        report.compliance_error = cuts.report.error;
        report.wants_recomputation = cuts.report.wants_recomputation;
        report.n_quarantined_tets += cuts.report.n_stuck as u32;
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
    /// Prepares for cuts: factors K of the uncut body. Without this call the first cut does it. `mesh` is the one that the
    /// model was computed for.
    ///
    /// # Errors
    /// [`SolveError`] when memory is short.
    pub fn prepare_cutting(&mut self, mesh: &TetMesh) -> Result<(), SolveError> {
        if self.cuts.is_none() {
            let bears = vec![true; mesh.tetrahedra.len()];
            self.cuts = Some(Box::new(Cuts::new(mesh, bears, &self.compliance)?));
        }
        Ok(())
    }

    /// Sets the limits above which a new pre-computation is requested, from the next edit on.
    pub fn set_recomputation_limits(&mut self, limits: RecomputationLimits) {
        self.recomputation_limits = limits;
    }

    /// Report on the cuts so far.
    pub fn cut_report(&self) -> CutReport {
        self.cuts.as_ref().map_or(CutReport { least_pivot: 1.0, ..CutReport::default() }, |c| c.report())
    }

    /// Whether tetrahedra were taken out since the pre-computation, or before it.
    pub(super) fn is_cut(&self) -> bool {
        self.cuts.as_ref().is_some_and(|cuts| cuts.body.topology().has_dead())
    }

    /// Nodes that fragments move.
    pub fn loose_nodes(&self) -> Vec<NodeId> {
        let Some(cuts) = &self.cuts else { return Vec::new() };
        let all = (0..cuts.is_out.len()).map(NodeId::from_index);
        all.filter(|&n| cuts.owners.of(n).is_some()).collect()
    }

    /// The model of a mesh with cuts: `live` tells which tetrahedra are there. Pieces that nothing holds start as loose
    /// pieces at rest.
    ///
    /// # Errors
    /// As [`Precomputed::build`]; [`SolveError::EmptyMesh`] when nothing that is held is left.
    ///
    /// # Panics
    /// When `live` has not one flag per tetrahedron.
    pub fn build_cut(
        params: &super::PrecomputedParams<'_>,
        live: &[bool],
    ) -> Result<Self, super::PrecomputedError> {
        let mesh = params.mesh;
        let n_nodes = mesh.positions_m.len();
        assert_eq!(live.len(), mesh.tetrahedra.len(), "one flag a tetrahedron");
        if let Some(&node) = params.fixed_nodes.iter().find(|n| n.index() >= n_nodes) {
            return Err(SolveError::ConditionOutOfRange { node, n_nodes }.into());
        }
        let mut is_fixed = vec![false; n_nodes];
        for node in params.fixed_nodes {
            is_fixed[node.index()] = true;
        }
        let mut body = EditableMesh::new(mesh.clone()).map_err(|_| SolveError::EmptyMesh)?;
        let dead: Vec<TetId> = (0..live.len()).filter(|&t| !live[t]).map(TetId::from_index).collect();
        body.remove_into(&dead, &mut TopologyChange::default()).map_err(|_| SolveError::EmptyMesh)?;
        let loose = fragment_tets(body.topology(), &mesh.positions_m, live, &is_fixed);
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
        let part =
            TetMesh { positions_m: mesh.positions_m.clone(), tetrahedra: bearing, ..TetMesh::default() };
        let part_params = super::PrecomputedParams { mesh: &part, fixed_nodes: &held, ..*params };
        let mut model = Self::build(&part_params)?;
        let mut fixed_nodes = params.fixed_nodes.to_vec();
        fixed_nodes.sort_unstable();
        fixed_nodes.dedup();
        model.compliance.fixed_nodes = fixed_nodes;
        model.compliance.mesh_hash = super::mesh_hash(mesh);
        let mut cuts = Cuts::new(mesh, bears, &model.compliance)?;
        cuts.body = body;
        model.free_fragments(&mut cuts, &loose);
        model.join_pieces(&mut cuts);
        model.cuts = Some(Box::new(cuts));
        Ok(model)
    }

    /// Follows the removal of tetrahedra.
    pub(super) fn follow(&mut self, mesh: &TetMesh, change: &TopologyChange) -> Result<(), TopologyRefusal> {
        let brings_in = !(change.nodes.added.ids().is_empty() && change.tets.added.ids().is_empty());
        if change.is_renumbering() || brings_in || !change.moved_nodes.is_empty() {
            return Err(TopologyRefusal::Frozen {
                model: NAME,
                reason: "it follows removals of tetrahedra only; pre-compute the new mesh",
            });
        }
        let n_tets = self.cuts.as_ref().map_or(change.tets.n_before, |cuts| cuts.bears.len());
        TopologyRefusal::of_other_mesh(NAME, change, [n_tets, self.rest_m.len()])?;
        if change.tets.removed.is_empty() {
            return Ok(());
        }
        fault::check("precomputed: before the factor")?;
        self.prepare_cutting(mesh).map_err(|_| TopologyRefusal::Frozen {
            model: NAME,
            reason: "its stiffness matrix cannot be factored in the memory that there is",
        })?;
        self.change_cuts(|model, cuts| model.remove(cuts, &change.tets.removed))?;
        // Rows were added and removed; spare rows are not shown.
        self.displacement_m.clear();
        self.displacement_m.resize(n_displacements(self.compliance.rows.len()), 0.0);
        for (row, node) in self.compliance.rows.iter().enumerate() {
            let u_m = self.positions_m[node.index()] - self.rest_m[node.index()];
            for axis in 0..3 {
                self.displacement_m[place_of_displacement(row, axis)] = u_m[axis];
            }
        }
        self.carry_weight();
        Ok(())
    }

    fn change_cuts(
        &mut self,
        change: impl FnOnce(&mut Self, &mut Cuts) -> Result<(), TopologyRefusal>,
    ) -> Result<(), TopologyRefusal> {
        let Some(mut cuts) = self.cuts.take() else { return Ok(()) };
        let changed = change(self, &mut cuts);
        self.cuts = Some(cuts);
        changed
    }

    /// After a refusal the model is of no use: it is put back from its copy.
    fn remove(&mut self, cuts: &mut Cuts, tets: &[TetId]) -> Result<(), TopologyRefusal> {
        let live: Vec<TetId> =
            tets.iter().copied().filter(|&t| cuts.body.topology().is_live_tet(t)).collect();
        if live.is_empty() {
            return Ok(());
        }
        let old_rows = self.compliance.rows.clone();

        let (mut taken, of_pieces): (Vec<TetId>, Vec<TetId>) =
            live.iter().partition(|t| cuts.bears[t.index()]);
        cuts.body.remove_into(&live, &mut TopologyChange::default()).expect("live tetrahedra, each once");
        for piece in &mut cuts.pieces {
            let own: Vec<TetId> = of_pieces.iter().copied().filter(|&t| piece.has_tet(t)).collect();
            piece.remove(&own)?;
        }
        for tet in &taken {
            cuts.bears[tet.index()] = false;
        }
        let rest_m = &cuts.body.mesh().positions_m;
        let loose = fragment_tets(cuts.body.topology(), rest_m, &cuts.bears, &cuts.is_fixed);
        for tet in &loose {
            cuts.bears[tet.index()] = false;
        }
        let borne = cuts.borne();
        // The stiffness of a fragment at its hinges must be removed; the rest of it does not touch the held body.
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
            self.free_fragments(cuts, &loose);
        }
        if !taken.is_empty() {
            self.change_compliance(cuts, &taken, &held, &borne);
        }
        for node in leaving {
            cuts.is_out[node.index()] = true;
            self.drop_node(node);
        }
        cuts.report.n_edits += 1;
        self.probe(cuts, &taken);
        self.join_pieces(cuts);

        self.follow_rows(&old_rows);
        Ok(())
    }

    /// Creates the hinges between the pieces and the held body, and computes the share of a new pull that acts per step.
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
        // Half of the share that is stable at rest: a stretched piece is stiffer.
        cuts.pull_share = MOST_PULL_SHARE.min(1.0 / (1.0 + ratio));
    }

    /// Creates a dynamic body from tetrahedra that came loose.
    fn free_fragments(&mut self, cuts: &mut Cuts, loose: &[TetId]) {
        if loose.is_empty() {
            return;
        }
        let made = Fragment::new(&FragmentParams {
            mesh: cuts.body.mesh(),
            material: &self.compliance.material,
            tets: loose,
            is_fixed: &cuts.is_fixed,
            positions_m: &self.positions_m,
            is_placed: &|node| self.row_of[node.index()] != NONE || cuts.owners.of(node).is_some(),
            gravity_m_per_s2: self.rest_gravity_m_per_s2 + self.pull_m_per_s2,
        });
        let Ok(piece) = made else {
            cuts.report.n_stuck += loose.len();
            return;
        };
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

    /// Updates the rows' weight after an edit, or when the gravity of the rest shape changes.
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
}
