//! The pre-computed quasi-static model (seed `001` s. 4 and seed `003` ch. 2, in compliance form).
//!
//! Set-up: K u = f is solved without the fixed nodes. A unit force along each axis on each loadable node m gives the
//! columns of the compliance tensors T^lm [m/N]: u_l = T^lm f_m. The free nodes on the surface are loadable; the
//! displacements of these nodes alone, or of all free nodes, are stored.
//!
//! Use: forces f at loadable nodes give u_l = sum_m T^lm f_m (eq. 2.8). Displacements U*_i imposed on n nodes
//! need the forces r with sum_j T^ij r_j = U*_i - sum_m T^im f_m, a dense symmetric system of 3n rows
//! (eq. 2.12, where the report forgets the second term); then u_l += sum_j T^lj r_j (eq. 2.13). r is the
//! force that the tool exerts; the tool feels -r.
//!
//! Cuts: `cutting` follows removals of tetrahedra by low-rank updates.
//!
//! `table` stores the tensors in the order in which a response reads them.

mod error;
mod table;
mod build;
mod file;
mod stream;
mod unit_displacements;
mod check;
mod point;
mod pairs;
mod contact_system;
mod response;
mod interaction;
mod rigid;
mod low_rank;
mod table_rows;
mod following;
mod fragments;
mod cut_report;
mod cuts;
mod cutting;
pub(super) mod row;

pub use check::{ComplianceCheck, check_compliance};
pub use contact_system::ContactReport;
pub use cut_report::CutReport;
pub use cutting::{RECOMPUTATION_COLUMNS, RECOMPUTATION_ERROR, RecomputationLimits};
pub use error::PrecomputedError;
pub use file::{PrecomputedExpectation, mesh_hash};
pub use point::PointConstraint;
pub use stream::{StreamOptions, StreamSummary, partial_path, precompute_to_file};
pub use table::Precision;
pub use unit_displacements::{UnitDisplacement, UnitDisplacements};

use self::contact_system::{ContactPoint, ContactSystem, MOST_POINTS};
use self::cuts::Cuts;
use self::interaction::Target;
use self::pairs::Pairs;
use self::response::Load;
use self::table::{Table, n_displacements};
use super::bounded_vec::BoundedVec;
use super::kernel::KernelPath;
use super::{Constraints, DeformableModel, LocalModel, LocalWork, ModelReport, ModelState, TopologyRefusal};
use crate::material::LinearElastic;
use glisson_mesh::math::{DMat3, DVec3};
use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::{NodeId, TetMesh};

/// Which nodes get a displacement in a response.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StoredNodes {
    /// Free nodes on the surface, which one sees and touches. Inner nodes stay at rest.
    #[default]
    Surface,
    /// All free nodes.
    All,
}

/// Parameters of a pre-computed model.
#[derive(Clone, Copy)]
pub struct PrecomputedParams<'a> {
    /// The body at rest.
    pub mesh: &'a TetMesh,
    /// Its material.
    pub material: &'a LinearElastic,
    /// Nodes that never move.
    pub fixed_nodes: &'a [NodeId],
    /// Which displacements to store.
    pub stored: StoredNodes,
    /// In which precision to store them.
    pub precision: Precision,
    /// Progress: called with the number of finished loadable nodes and their total, from any thread, in any order.
    pub progress: Option<&'a (dyn Fn(usize, usize) + Sync)>,
}

/// Constraints that a step left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ResponseReport {
    /// Forces on nodes that cannot be loaded, or that are not finite.
    pub ignored_forces: usize,
    /// Imposed displacements on nodes that cannot be loaded, that are not finite, or beyond
    /// [`Precomputed::MAX_IMPOSED`].
    pub ignored_displacements: usize,
}

/// Marks a node that is not in a list.
const NONE: u32 = u32::MAX;

/// Scene name.
const NAME: &str = "precomputed";

/// The columns T^lm, and the body that they were computed for.
#[derive(Clone, Debug, PartialEq)]
struct Compliance {
    material: LinearElastic,
    /// Ascending.
    fixed_nodes: Vec<NodeId>,
    /// Stored nodes: the loadable ones ascending, then the inner ones ascending.
    rows: Vec<NodeId>,
    n_loadable: usize,
    mesh_hash: [u8; 32],
    /// T^lm [m/N].
    table: Table,
    /// Displacement for the weight under unit gravity along each axis [m per m/s2], in the layout of a loaded node.
    weight_response_s2: Vec<f64>,
}

/// One organ moved by its pre-computed compliance.
#[derive(Clone, Debug)]
pub struct Precomputed {
    compliance: Compliance,
    rest_m: Vec<DVec3>,
    row_of: Vec<u32>,
    positions_m: Vec<DVec3>,
    /// Displacements of the rows [m], in blocks.
    displacement_m: Vec<f64>,
    path: KernelPath,
    /// Outer forces.
    forces: BoundedVec<Load>,
    /// Held points and their targets.
    wanted: BoundedVec<ContactPoint>,
    targets: BoundedVec<Target>,
    contacts: ContactSystem,
    pairs: Pairs,
    /// Forces of the held points on their nodes.
    reactions: BoundedVec<Load>,
    constraint_forces_n: BoundedVec<DVec3>,
    report: ResponseReport,
    /// Gravity that the rest shape carries [m/s2].
    rest_gravity_m_per_s2: DVec3,
    /// Gravity minus that one [m/s2].
    pull_m_per_s2: DVec3,
    /// State that following cuts needs; created at the first one.
    cuts: Option<Box<Cuts>>,
    recomputation_limits: RecomputationLimits,
}

impl Precomputed {
    /// Most nodes whose displacement can be imposed at once.
    pub const MAX_IMPOSED: usize = MOST_POINTS;

    fn new(compliance: Compliance, mesh: &TetMesh) -> Self {
        let mut row_of = vec![NONE; mesh.positions_m.len()];
        for (row, node) in compliance.rows.iter().enumerate() {
            row_of[node.index()] = row as u32;
        }
        Self {
            rest_m: mesh.positions_m.clone(),
            row_of,
            positions_m: mesh.positions_m.clone(),
            displacement_m: vec![0.0; n_displacements(compliance.rows.len())],
            path: KernelPath::fastest(),
            forces: BoundedVec::with_capacity(compliance.n_loadable),
            wanted: BoundedVec::with_capacity(Self::MAX_IMPOSED),
            targets: BoundedVec::with_capacity(Self::MAX_IMPOSED),
            contacts: ContactSystem::new(),
            pairs: Pairs::of_table(&compliance.table, compliance.n_loadable),
            reactions: BoundedVec::with_capacity(Self::MOST_REACTIONS),
            constraint_forces_n: BoundedVec::with_capacity(compliance.n_loadable.max(Self::MAX_IMPOSED)),
            report: ResponseReport::default(),
            rest_gravity_m_per_s2: DVec3::ZERO,
            pull_m_per_s2: DVec3::ZERO,
            cuts: None,
            recomputation_limits: RecomputationLimits::default(),
            compliance,
        }
    }

    /// Declares that the rest shape is the one under this gravity [m/s2]; by default it is the weightless one.
    pub fn carry_at_rest(&mut self, gravity_m_per_s2: DVec3) {
        self.rest_gravity_m_per_s2 = gravity_m_per_s2;
        self.pull_m_per_s2 = DVec3::ZERO;
        for piece in self.cuts.iter_mut().flat_map(|cuts| &mut cuts.pieces) {
            piece.set_gravity(gravity_m_per_s2);
        }
        self.carry_weight();
    }

    /// Nodes that forces and displacements can act on: ascending, until a cut changes them.
    pub fn loadable_nodes(&self) -> &[NodeId] {
        &self.compliance.rows[..self.compliance.n_loadable]
    }

    /// Nodes whose displacement is computed: the loadable ones, then the inner ones.
    pub fn stored_nodes(&self) -> &[NodeId] {
        &self.compliance.rows
    }

    /// Nodes that never move, ascending.
    pub fn fixed_nodes(&self) -> &[NodeId] {
        &self.compliance.fixed_nodes
    }

    /// The material it was computed for.
    pub fn material(&self) -> &LinearElastic {
        &self.compliance.material
    }

    /// Whether `node` can be pushed.
    pub fn is_loadable(&self, node: NodeId) -> bool {
        self.loadable_index(node).is_some()
    }

    fn loadable_index(&self, node: NodeId) -> Option<u32> {
        let row = *self.row_of.get(node.index())?;
        ((row as usize) < self.compliance.n_loadable).then_some(row)
    }

    /// Tensor T^lm [m/N]: displacement of the stored node `of` for a force on the loadable node `by`.
    pub fn compliance_m_per_n(&self, of: NodeId, by: NodeId) -> Option<DMat3> {
        let row = *self.row_of.get(of.index())?;
        let loaded = self.loadable_index(by)?;
        (row != NONE).then(|| self.compliance.table.tensor(row as usize, loaded as usize))
    }

    /// Constraints of the last [`DeformableModel::apply`] that were left out.
    pub fn response_report(&self) -> ResponseReport {
        self.report
    }

    /// Returns to the rest shape, without constraints.
    pub fn reset(&mut self) {
        self.forces.clear();
        self.wanted.clear();
        self.targets.clear();
        self.reactions.clear();
        self.constraint_forces_n.clear();
        self.contacts.forget();
        self.displacement_m.fill(0.0);
        self.positions_m.copy_from_slice(&self.rest_m);
        self.report = ResponseReport::default();
        self.release_pieces();
        if let Some(cuts) = &mut self.cuts {
            cuts.take_over(&self.rest_m, &mut self.positions_m);
        }
    }
}

impl DeformableModel for Precomputed {
    fn apply(&mut self, constraints: &Constraints) {
        self.take_constraints(constraints);
    }

    fn step(&mut self, dt_s: f64) {
        self.respond();
        self.step_pieces(dt_s);
    }

    fn state(&self) -> ModelState<'_> {
        ModelState { positions_m: &self.positions_m, velocities_m_per_s: self.piece_velocities_m_per_s() }
    }

    fn history_into(&self, numbers: &mut Vec<f64>) {
        if let Some(cuts) = &self.cuts {
            cuts.history_into(numbers);
        }
    }

    fn constraint_forces_n(&self) -> &[DVec3] {
        &self.constraint_forces_n
    }

    fn take_over(&mut self, positions_m: &[DVec3]) {
        // Nodes that a response does not move stay at rest, wherever another model had them.
        for node in &self.compliance.rows {
            self.positions_m[node.index()] = positions_m[node.index()];
        }
        self.constraint_forces_n.fill(DVec3::ZERO);
        if let Some(cuts) = &mut self.cuts {
            cuts.take_over(positions_m, &mut self.positions_m);
        }
    }

    /// Loose pieces keep their velocities.
    fn take_over_in_motion(&mut self, state: &ModelState<'_>, _clocks_s: &[f64]) {
        self.take_over(state.positions_m);
        if let Some(cuts) = &mut self.cuts
            && state.velocities_m_per_s.len() == self.rest_m.len()
        {
            cuts.start_with(state.velocities_m_per_s);
        }
    }

    fn set_gravity(&mut self, gravity_m_per_s2: DVec3) {
        self.pull_m_per_s2 = gravity_m_per_s2 - self.rest_gravity_m_per_s2;
        for piece in self.cuts.iter_mut().flat_map(|cuts| &mut cuts.pieces) {
            piece.set_gravity(gravity_m_per_s2);
        }
    }

    fn report(&self) -> ModelReport {
        let ResponseReport { ignored_forces, ignored_displacements } = self.report;
        let n_ignored_constraints = (ignored_forces + ignored_displacements) as u32;
        let mut report = ModelReport { n_parts: 1, n_ignored_constraints, ..ModelReport::default() };
        self.add_cuts_to(&mut report);
        report
    }

    /// Nodes of the held body respond with their static compliance, those of fragments with that of the piece over the
    /// period, its hinges held.
    fn local_model_into(
        &mut self,
        patch: &[NodeId],
        period_s: f64,
        work: &mut LocalWork,
        out: &mut LocalModel,
    ) {
        self.fill_local_model(patch, period_s, out);
        if let Some(cuts) = &mut self.cuts {
            cuts.add_pieces_to(period_s, work, out);
        }
    }

    fn duplicate(&self) -> Box<dyn DeformableModel> {
        Box::new(self.clone())
    }

    /// Follows removals; allocates.
    fn topology_changed(&mut self, mesh: &TetMesh, change: &TopologyChange) -> Result<(), TopologyRefusal> {
        self.follow(mesh, change)
    }
}
