//! The pre-computed quasi-static model (seed `001` s. 4 and seed `003` ch. 2, in compliance form).
//!
//! Set-up: with K u = f and the fixed nodes taken out, a unit force along each axis on each loadable node m
//! gives the columns of the compliance tensors T^lm [m/N]: u_l = T^lm f_m. Loadable are the free nodes on the
//! surface; stored are those nodes alone, or all free nodes.
//!
//! Use: forces f at loadable nodes give u_l = sum_m T^lm f_m (eq. 2.8). Displacements U*_i imposed on n nodes
//! need the forces r with sum_j T^ij r_j = U*_i - sum_m T^im f_m, a dense symmetric system of 3n rows
//! (eq. 2.12, where the report forgets the second term); then u_l += sum_j T^lj r_j (eq. 2.13). r is the
//! force that the tool exerts; the tool feels -r.
//!
//! Cuts: `cutting` follows removals of tetrahedra by changes of low rank.
//!
//! The tensors lie in `table` in the order in which a response reads them.

mod build;
mod cuts;
mod cutting;
mod dense;
mod file;
mod following;
mod growth;
mod loose;
mod low_rank;
mod rigid;
mod table;

pub use cutting::{CutReport, RECOMPUTATION_COLUMNS, RECOMPUTATION_ERROR};
pub use file::{PrecomputedExpectation, mesh_hash};
pub use table::Precision;

use std::path::PathBuf;

use self::cuts::Cuts;
use self::dense::SmallCholesky;
use self::table::{Table, add_blocks, n_displacements, place_of_displacement};
use super::{Constraints, DeformableModel, ModelReport, ModelState, TopologyRefusal};
use crate::material::LinearElastic;
use crate::math::{DMat3, DVec3};
use crate::mesh::edit::TopologyChange;
use crate::mesh::{NodeId, TetMesh};
use crate::solve::SolveError;

/// Why there is no pre-computed model.
#[derive(Debug, thiserror::Error)]
pub enum PrecomputedError {
    /// The mesh with its fixed nodes has no solution.
    #[error(transparent)]
    Solve(#[from] SolveError),
    /// Every node of the surface is fixed.
    #[error("all {n_surface} nodes of the surface are fixed: nothing is left to push")]
    NothingLoadable {
        /// Number of nodes on the surface.
        n_surface: usize,
    },
    /// The compliance does not fit in memory.
    #[error(
        "the compliance of {n_loadable} loadable times {n_rows} stored nodes needs {bytes} bytes of memory"
    )]
    Memory {
        /// Number of nodes that can be loaded.
        n_loadable: usize,
        /// Number of nodes whose displacement is stored.
        n_rows: usize,
        /// What that takes.
        bytes: u128,
    },
    /// A file cannot be read or written.
    #[error("{}: {cause}", file.display())]
    Io {
        /// Which file.
        file: PathBuf,
        /// What the system says.
        cause: std::io::Error,
    },
    /// Another kind of file.
    #[error("{}: not a pre-computed compliance (it starts with {found:02x?}, expected \"GLISCOMP\")", file.display())]
    Kind {
        /// Which file.
        file: PathBuf,
        /// Its first bytes.
        found: Vec<u8>,
    },
    /// Another version of the format.
    #[error("{}: format version {found}, this program reads version {expected}: pre-compute again", file.display())]
    Version {
        /// Which file.
        file: PathBuf,
        /// Its version.
        found: u32,
        /// The version that is read.
        expected: u32,
    },
    /// The file's length is not what its header says.
    #[error("{}: {found} bytes, but its header asks for {expected}: cut off or damaged; pre-compute again", file.display())]
    Length {
        /// Which file.
        file: PathBuf,
        /// Bytes in the file.
        found: u64,
        /// Bytes that the header asks for.
        expected: u128,
    },
    /// The contents are not those that were written.
    #[error("{}: checksum {found}, the file says {expected}: damaged; pre-compute again", file.display())]
    Checksum {
        /// Which file.
        file: PathBuf,
        /// BLAKE3 of the contents.
        found: String,
        /// BLAKE3 at the end of the file.
        expected: String,
    },
    /// The file belongs to another mesh, material or support.
    #[error("{}: made for {what} {found}, but the scene has {expected}: pre-compute again", file.display())]
    Mismatch {
        /// Which file.
        file: PathBuf,
        /// What differs.
        what: &'static str,
        /// What the file was made for.
        found: String,
        /// What is wanted.
        expected: String,
    },
    /// A compliance that followed cuts is of no mesh that a file could name.
    #[error("{}: not written: the compliance followed cuts; pre-compute the cut mesh and save that", file.display())]
    Cut {
        /// Which file.
        file: PathBuf,
    },
    /// A number in the file is impossible although the checksum holds.
    #[error("{}: {what}: not written by this program", file.display())]
    Contents {
        /// Which file.
        file: PathBuf,
        /// Which number.
        what: &'static str,
    },
}

/// Which nodes get their displacement in a response.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StoredNodes {
    /// Free nodes on the surface: what one sees and touches. Inner nodes stay at rest.
    #[default]
    Surface,
    /// All free nodes.
    All,
}

/// What a pre-computed model is made from.
#[derive(Clone, Copy)]
pub struct PrecomputedParams<'a> {
    /// The body at rest.
    pub mesh: &'a TetMesh,
    /// Its material.
    pub material: &'a LinearElastic,
    /// Nodes that never move.
    pub fixed_nodes: &'a [NodeId],
    /// Which displacements to keep.
    pub stored: StoredNodes,
    /// How to keep them.
    pub precision: Precision,
    /// Called with the number of loadable nodes done and their total, from any thread, in any order.
    pub progress: Option<&'a (dyn Fn(usize, usize) + Sync)>,
}

/// What a step had to leave out.
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

/// The columns T^lm, and what they were computed for.
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
    /// Loadable node and force [N].
    forces: Vec<(u32, DVec3)>,
    /// Place among the constraints, loadable node, displacement [m].
    imposed: Vec<(u32, u32, DVec3)>,
    system: SmallCholesky,
    constraint_forces_n: Vec<DVec3>,
    report: ResponseReport,
    /// Gravity that the rest shape carries [m/s2].
    rest_gravity_m_per_s2: DVec3,
    /// Gravity beyond it [m/s2].
    pull_m_per_s2: DVec3,
    /// What following cuts needs; made at the first one.
    cuts: Option<Box<Cuts>>,
}

impl Precomputed {
    /// Most nodes whose displacement can be imposed at once.
    pub const MAX_IMPOSED: usize = 64;

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
            forces: Vec::with_capacity(compliance.n_loadable),
            imposed: Vec::with_capacity(Self::MAX_IMPOSED),
            system: SmallCholesky::with_room_for(3 * Self::MAX_IMPOSED),
            constraint_forces_n: Vec::with_capacity(compliance.n_loadable.max(Self::MAX_IMPOSED)),
            report: ResponseReport::default(),
            rest_gravity_m_per_s2: DVec3::ZERO,
            pull_m_per_s2: DVec3::ZERO,
            cuts: None,
            compliance,
        }
    }

    /// The rest shape is the one under this gravity [m/s2]; without a call it is the weightless one.
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

    /// What the constraints of the last [`DeformableModel::apply`] lost.
    pub fn response_report(&self) -> ResponseReport {
        self.report
    }

    /// Back to the rest shape, without constraints.
    pub fn reset(&mut self) {
        self.forces.clear();
        self.imposed.clear();
        self.constraint_forces_n.clear();
        self.displacement_m.fill(0.0);
        self.positions_m.copy_from_slice(&self.rest_m);
        self.report = ResponseReport::default();
        self.release_pieces();
        if let Some(cuts) = &mut self.cuts {
            cuts.take_over(&self.rest_m, &mut self.positions_m);
        }
    }

    /// Displacement of a row [m].
    fn displacement_of_row_m(&self, row: usize) -> DVec3 {
        DVec3::from_array([0, 1, 2].map(|axis| self.displacement_m[place_of_displacement(row, axis)]))
    }

    /// Forces that hold the imposed displacements against the response to the forces.
    fn solve_imposed(&mut self) {
        let n = self.imposed.len();
        self.system.start(3 * n);
        for j in 0..n {
            let (_, loaded, target_m) = self.imposed[j];
            for i in j..n {
                let (_, row, _) = self.imposed[i];
                let tensor = self.compliance.table.tensor(row as usize, loaded as usize);
                for d in 0..3 {
                    let column = self.system.column_mut(3 * j + d);
                    column[3 * i..3 * i + 3].copy_from_slice(&tensor.col(d).to_array());
                }
            }
            let missing_m = target_m - self.displacement_of_row_m(loaded as usize);
            self.system.right_mut()[3 * j..3 * j + 3].copy_from_slice(&missing_m.to_array());
        }
        self.system.solve();
    }
}

impl DeformableModel for Precomputed {
    fn apply(&mut self, constraints: &Constraints) {
        self.report = ResponseReport::default();
        self.release_pieces();
        self.forces.clear();
        for force in &constraints.forces {
            match self.loadable_index(force.node) {
                Some(m) if force.force_n.is_finite() && self.forces.len() < self.forces.capacity() => {
                    self.forces.push((m, force.force_n));
                }
                None if self.push_piece(force) => {}
                _ => self.report.ignored_forces += 1,
            }
        }
        self.imposed.clear();
        for (place, imposed) in constraints.displacements.iter().enumerate() {
            match self.loadable_index(imposed.node) {
                Some(m) if imposed.displacement_m.is_finite() && self.imposed.len() < Self::MAX_IMPOSED => {
                    self.imposed.push((place as u32, m, imposed.displacement_m));
                }
                None if self.move_piece(place, imposed) => {}
                _ => self.report.ignored_displacements += 1,
            }
        }
        // Room was made for as many as there are loadable nodes; more is a list with repetitions.
        self.constraint_forces_n.clear();
        self.constraint_forces_n.resize(constraints.displacements.len(), DVec3::ZERO);
    }

    fn step(&mut self, dt_s: f64) {
        self.displacement_m.fill(0.0);
        let carried_m = self.cuts.as_ref().and_then(|cuts| cuts.carried_m());
        // What is left of a cut body carries its weight, less what the rest shape has of it.
        let weight_m_per_s2 = match carried_m {
            Some(_) => self.pull_m_per_s2 + self.rest_gravity_m_per_s2,
            None => self.pull_m_per_s2,
        };
        if weight_m_per_s2 != DVec3::ZERO {
            add_blocks(&self.compliance.weight_response_s2, weight_m_per_s2, &mut self.displacement_m);
        }
        for (u, carried) in self.displacement_m.iter_mut().zip(carried_m.unwrap_or_default()) {
            *u -= carried;
        }
        for &(m, force_n) in &self.forces {
            self.compliance.table.add_response(m as usize, force_n, &mut self.displacement_m);
        }
        if let Some(cuts) = &self.cuts {
            for (m, force_n) in cuts.pulls() {
                self.compliance.table.add_response(m, force_n, &mut self.displacement_m);
            }
        }
        if !self.imposed.is_empty() {
            self.solve_imposed();
            for (j, &(place, m, _)) in self.imposed.iter().enumerate() {
                let r = DVec3::from_slice(&self.system.right_mut()[3 * j..3 * j + 3]);
                self.compliance.table.add_response(m as usize, r, &mut self.displacement_m);
                self.constraint_forces_n[place as usize] = r;
            }
        }
        for row in 0..self.compliance.rows.len() {
            let node = self.compliance.rows[row].index();
            self.positions_m[node] = self.rest_m[node] + self.displacement_of_row_m(row);
        }
        if let Some(cuts) = &mut self.cuts {
            let felt_n = &mut self.constraint_forces_n;
            cuts.step_pieces(dt_s, &self.rest_m, &mut self.positions_m, |place, force_n| {
                if let Some(felt_n) = felt_n.get_mut(place) {
                    *felt_n = force_n;
                }
            });
        }
    }

    fn state(&self) -> ModelState<'_> {
        ModelState { positions_m: &self.positions_m, velocities_m_per_s: &[], history: self.piece_numbers() }
    }

    fn constraint_forces_n(&self) -> &[DVec3] {
        &self.constraint_forces_n
    }

    fn take_over(&mut self, positions_m: &[DVec3]) {
        // Nodes that a response does not move stay at rest, whatever they were in another model.
        for node in &self.compliance.rows {
            self.positions_m[node.index()] = positions_m[node.index()];
        }
        self.constraint_forces_n.fill(DVec3::ZERO);
        if let Some(cuts) = &mut self.cuts {
            cuts.take_over(positions_m, &mut self.positions_m);
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

    fn duplicate(&self) -> Box<dyn DeformableModel> {
        let mut copy = self.clone();
        // A clone has no room beyond what it holds.
        copy.forces.reserve(self.forces.capacity());
        copy.imposed.reserve(Self::MAX_IMPOSED);
        copy.constraint_forces_n.reserve(self.constraint_forces_n.capacity());
        copy.system = SmallCholesky::with_room_for(3 * Self::MAX_IMPOSED);
        Box::new(copy)
    }

    /// Follows removals; allocates.
    fn topology_changed(&mut self, mesh: &TetMesh, change: &TopologyChange) -> Result<(), TopologyRefusal> {
        self.follow(mesh, change)
    }
}
