//! The pre-computed model with a non-linear part: the St Venant-Kirchhoff law in a few reduced coordinates, and the linear
//! compliance for the rest.
//!
//! Displacements are u = V q + C_r f. V holds r modes (lowest vibrations, responses to given loads, and their static modal
//! derivatives). q is in non-linear equilibrium, f(q) = V^T f, with forces that are cubic polynomials with pre-computed
//! coefficients (Barbic and James 2005, doi 10.1145/1073204.1073300; modal derivatives: Idelsohn and Cardona 1985).
//! C_r = K^-1 - V diag(1/omega^2) V^T is the part of the linear compliance outside the modes. So under a small load the
//! model *is* the pre-computed linear one for any r, local dents included; under a large load the modes follow bending
//! and rotation. With r = all free components it is the full non-linear solution.
//!
//! Imposed displacements are met exactly, without penalty: the forces that hold them are unknowns besides q (`newton`).
//! Deformation outside the modes stays linear. C_r neither stiffens nor rotates with the tissue: a deep dent, or one in a
//! part that has rotated far, is no better than in the linear model (measured: `glisson validate reduced`). Put the
//! responses to forces at the places that matter into the basis (`loads`). As with any St Venant-Kirchhoff model,
//! tetrahedra can invert under strong compression; this is not detected.
//!
//! The model is quasi-static: each step solves for equilibrium, starting from the last one. Where several equilibria exist
//! (buckling), it takes the one that Newton's method finds from there. A rest shape under gravity is treated as in the
//! linear model: the response is to the difference of gravity, without the stiffness of the stress at rest.

mod basis;
mod build;
mod cubic;
mod dense;
mod local;
mod newton;
pub(super) mod row;

pub use newton::ReducedSolution;

use std::sync::Arc;

use self::cubic::ReducedForces;
use self::newton::Newton;
use super::bounded_vec::BoundedVec;
use super::{
    Constraints, DeformableModel, FixedNode, LevelOfDetail, LocalModel, LocalWork, ModelReport, ModelState,
    TopologyRefusal,
};
use crate::material::LinearElastic;
use crate::model::precomputed::StoredNodes;
use crate::solve::SolveError;
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::{NodeId, TetMesh};

/// Scene name.
const NAME: &str = "reduced";

/// Why a reduced model cannot be built.
#[derive(Debug, thiserror::Error)]
pub enum ReducedError {
    /// The mesh with its supports has no solution.
    #[error(transparent)]
    Solve(#[from] SolveError),
    /// Every node of the surface is held.
    #[error("all {n_surface} nodes of the surface are held along some axis: nothing is left to push")]
    NothingLoadable {
        /// Number of nodes on the surface.
        n_surface: usize,
    },
    /// Sizes that do not fit each other.
    #[error(
        "{n_modes} modes in {n_reduced} reduced coordinates of {n_free} free components; allowed: 1 <= modes <= reduced \
         coordinates <= {} and the free components, and loads of one force a node",
        Reduced::MAX_REDUCED
    )]
    Sizes {
        /// Vibrations.
        n_modes: usize,
        /// Reduced coordinates.
        n_reduced: usize,
        /// Free components of the mesh.
        n_free: usize,
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
}

/// Parameters of a reduced model.
#[derive(Clone, Copy, Debug)]
pub struct ReducedParams<'a> {
    /// The body at rest.
    pub mesh: &'a TetMesh,
    /// Its moduli, which are also those of the St Venant-Kirchhoff law, and its density.
    pub material: &'a LinearElastic,
    /// Nodes that are held along some or all axes.
    pub fixed: &'a [FixedNode],
    /// Lowest vibrations in the basis, at least 1.
    pub n_modes: usize,
    /// Number r of reduced coordinates, vibrations and loads included; at most [`Reduced::MAX_REDUCED`]. Linearly dependent
    /// derivatives are left out, and of more than [`Reduced::MAX_DERIVATIVES`] the weakest.
    pub n_reduced: usize,
    /// Loads, each a force on every node [N], whose responses belong to the basis too; only their directions matter.
    pub loads: &'a [Vec<DVec3>],
    /// Nodes for which the compliance outside the modes is stored; the modes move all nodes.
    pub stored: StoredNodes,
}

impl<'a> ReducedParams<'a> {
    /// Ten vibrations in thirty coordinates.
    pub fn new(mesh: &'a TetMesh, material: &'a LinearElastic, fixed: &'a [FixedNode]) -> Self {
        Self { mesh, material, fixed, n_modes: 10, n_reduced: 30, loads: &[], stored: StoredNodes::Surface }
    }
}

/// Marks a node that is not in a list.
const NONE: u32 = u32::MAX;

/// The data that do not change.
struct Constants {
    rest_m: Vec<DVec3>,
    mass_kg: Vec<f64>,
    /// Nodes with a row: the loadable ones ascending, then others.
    rows: Vec<NodeId>,
    row_of: Vec<u32>,
    n_loadable: usize,
    /// V: mode, node, axis.
    mode_m: Vec<f64>,
    forces: ReducedForces,
    /// C_r: loadable node, force axis, displacement axis, row [m/N].
    remainder_m_per_n: Vec<f64>,
    /// V^T of the weight under unit gravity along each axis.
    reduced_weight: [Vec<f64>; 3],
    /// C_r of it: displacement axis, row [m per m/s2].
    weight_remainder: [Vec<f64>; 3],
}

impl Constants {
    fn loadable_index(&self, node: NodeId) -> Option<u32> {
        let row = *self.row_of.get(node.index())?;
        ((row as usize) < self.n_loadable).then_some(row)
    }

    /// The three columns of C_r of a loaded node.
    fn remainder(&self, loaded: u32) -> &[f64] {
        let n = 9 * self.rows.len();
        &self.remainder_m_per_n[n * loaded as usize..n * (loaded as usize + 1)]
    }

    /// The modes' values at a component of a loadable node.
    fn modes_at(&self, loaded: u32, axis: usize) -> impl Iterator<Item = f64> {
        let at = 3 * self.rows[loaded as usize].index() + axis;
        self.mode_m.chunks_exact(3 * self.rest_m.len()).map(move |mode| mode[at])
    }
}

/// A body moved by its reduced non-linear equilibrium and its linear compliance.
pub struct Reduced {
    constants: Arc<Constants>,
    newton: Newton,
    solution: ReducedSolution,
    /// Newton iterations of one step at most.
    most_iterations: u32,
    negligible_j: f64,
    /// Loadable node and force [N].
    forces: BoundedVec<(u32, DVec3)>,
    /// Place among the constraints, loadable node, displacement [m].
    imposed: BoundedVec<(u32, u32, DVec3)>,
    n_ignored: u32,
    constraint_forces_n: BoundedVec<DVec3>,
    /// C_r f over the rows: all x, all y, all z [m].
    remainder_m: Vec<f64>,
    /// V q: node, axis [m].
    modes_m: Vec<f64>,
    positions_m: Vec<DVec3>,
    rest_gravity_m_per_s2: DVec3,
    pull_m_per_s2: DVec3,
}

/// Displacement, as a share of the body's size, whose linear energy is negligible.
const NEGLIGIBLE_SHARE: f64 = 1e-12;

impl Reduced {
    /// Most reduced coordinates: the coefficients grow with the fourth power (60: 13 MB, 100: 100 MB).
    pub const MAX_REDUCED: usize = 100;
    /// Largest number of modal derivatives from which the basis is chosen: those of 30 vibrations and loads with each other.
    /// The time for their principal directions grows with the third power of their number. A choice.
    pub const MAX_DERIVATIVES: usize = 465;
    /// Most nodes whose displacement can be imposed at once.
    pub const MAX_IMPOSED: usize = 96;
    /// Default limit of the Newton iterations in a step ([`Reduced::set_most_iterations`]): two or three are enough from one
    /// frame to the next, the rest is for jumps.
    pub const MOST_ITERATIONS: u32 = 20;

    fn new(constants: Constants) -> Self {
        let size_m = glisson_mesh::math::Aabb::of_points(&constants.rest_m).size_m().length();
        let lowest = constants.forces.squared_frequency_per_s2[0];
        let still_m = NEGLIGIBLE_SHARE * size_m;
        Self {
            newton: Newton::new(&constants.forces, 3 * Self::MAX_IMPOSED),
            solution: ReducedSolution { n_iterations: 0, converged: true },
            most_iterations: Self::MOST_ITERATIONS,
            negligible_j: lowest * constants.mass_kg.iter().sum::<f64>() * still_m * still_m,
            forces: BoundedVec::with_capacity(constants.n_loadable),
            imposed: BoundedVec::with_capacity(Self::MAX_IMPOSED),
            n_ignored: 0,
            constraint_forces_n: BoundedVec::with_capacity(constants.rest_m.len()),
            remainder_m: vec![0.0; 3 * constants.rows.len()],
            modes_m: vec![0.0; 3 * constants.rest_m.len()],
            positions_m: constants.rest_m.clone(),
            rest_gravity_m_per_s2: DVec3::ZERO,
            pull_m_per_s2: DVec3::ZERO,
            constants: Arc::new(constants),
        }
    }

    /// Declares that the rest shape is the one under this gravity [m/s2]; by default it is the weightless one.
    pub fn carry_at_rest(&mut self, gravity_m_per_s2: DVec3) {
        self.rest_gravity_m_per_s2 = gravity_m_per_s2;
        self.pull_m_per_s2 = DVec3::ZERO;
    }

    /// Sets the limit of the Newton iterations in a step, at least 1.
    pub fn set_most_iterations(&mut self, most_iterations: u32) {
        self.most_iterations = most_iterations.max(1);
    }

    /// Number of reduced coordinates.
    pub fn n_reduced(&self) -> usize {
        self.newton.q.len()
    }

    /// Squared circular frequencies of the modes [1/s2], ascending.
    pub fn squared_frequencies_per_s2(&self) -> &[f64] {
        &self.constants.forces.squared_frequency_per_s2
    }

    /// Reduced coordinates of the last step [m kg^1/2].
    pub fn coordinates(&self) -> &[f64] {
        &self.newton.q
    }

    /// Nodes that forces and displacements can act on, ascending.
    pub fn loadable_nodes(&self) -> &[NodeId] {
        &self.constants.rows[..self.constants.n_loadable]
    }

    /// Report on the last step.
    pub fn solution(&self) -> ReducedSolution {
        self.solution
    }

    /// Computes b = V^T f and C_r f of the applied forces and the weight.
    fn add_loads(&mut self) {
        let Self { constants, newton, remainder_m, .. } = self;
        newton.load.fill(0.0);
        remainder_m.fill(0.0);
        for axis in 0..3 {
            let pull = self.pull_m_per_s2[axis];
            if pull != 0.0 {
                newton.load.iter_mut().zip(&constants.reduced_weight[axis]).for_each(|(b, w)| *b += pull * w);
                let answer = constants.weight_remainder[axis].iter();
                remainder_m.iter_mut().zip(answer).for_each(|(u, w)| *u += pull * w);
            }
        }
        for &(loaded, force_n) in self.forces.iter() {
            for axis in 0..3 {
                let modes = constants.modes_at(loaded, axis);
                newton.load.iter_mut().zip(modes).for_each(|(b, v)| *b += v * force_n[axis]);
            }
            add_columns(constants.remainder(loaded), force_n, remainder_m);
        }
    }

    /// Computes V_c, C_c and U - u_0 of the imposed displacements.
    fn set_imposed(&mut self) {
        let Self { constants, newton, imposed, remainder_m, .. } = self;
        let (s, r, m) = (constants.rows.len(), newton.q.len(), 3 * imposed.len());
        for (j, &(_, loaded, target_m)) in imposed.iter().enumerate() {
            let columns = constants.remainder(loaded);
            for axis in 0..3 {
                let component = 3 * j + axis;
                let modes = &mut newton.modes_there[component * r..(component + 1) * r];
                modes.iter_mut().zip(constants.modes_at(loaded, axis)).for_each(|(to, v)| *to = v);
                newton.target_m[component] = target_m[axis] - remainder_m[axis * s + loaded as usize];
                for (i, &(_, row, _)) in imposed.iter().enumerate() {
                    for a in 0..3 {
                        newton.remainder_there[component * m + 3 * i + a] =
                            columns[(3 * axis + a) * s + row as usize];
                    }
                }
            }
        }
    }

    fn show(&mut self) {
        let Self { constants, newton, modes_m, remainder_m, .. } = self;
        modes_m.fill(0.0);
        for (mode, q) in constants.mode_m.chunks_exact(modes_m.len()).zip(&newton.q) {
            modes_m.iter_mut().zip(mode).for_each(|(u, v)| *u += q * v);
        }
        for ((position, rest), u) in
            self.positions_m.iter_mut().zip(&constants.rest_m).zip(modes_m.chunks_exact(3))
        {
            *position = *rest + DVec3::from_slice(u);
        }
        let s = constants.rows.len();
        for (row, node) in constants.rows.iter().enumerate() {
            self.positions_m[node.index()] +=
                DVec3::new(remainder_m[row], remainder_m[s + row], remainder_m[2 * s + row]);
        }
    }
}

/// Adds the three columns of a loaded node times the force on it.
fn add_columns(columns: &[f64], force_n: DVec3, displacement_m: &mut [f64]) {
    let n = displacement_m.len();
    let (x, rest) = columns.split_at(n);
    let (y, z) = rest.split_at(n);
    for (((u, x), y), z) in displacement_m.iter_mut().zip(x).zip(y).zip(z) {
        *u += x * force_n.x + y * force_n.y + z * force_n.z;
    }
}

impl DeformableModel for Reduced {
    fn apply(&mut self, constraints: &Constraints) {
        self.n_ignored = 0;
        self.forces.clear();
        for force in &constraints.forces {
            let loaded = self.constants.loadable_index(force.node).filter(|_| force.force_n.is_finite());
            if !loaded.is_some_and(|m| self.forces.try_push((m, force.force_n))) {
                self.n_ignored += 1;
            }
        }
        self.imposed.clear();
        for (place, imposed) in constraints.displacements.iter().enumerate() {
            let loaded =
                self.constants.loadable_index(imposed.node).filter(|_| imposed.displacement_m.is_finite());
            if !loaded.is_some_and(|m| self.imposed.try_push((place as u32, m, imposed.displacement_m))) {
                self.n_ignored += 1;
            }
        }
        self.constraint_forces_n.clear();
        for _ in 0..constraints.displacements.len() {
            self.constraint_forces_n.try_push(DVec3::ZERO);
        }
    }

    fn step(&mut self, _dt_s: f64) {
        self.add_loads();
        self.set_imposed();
        let m = 3 * self.imposed.len();
        let constants = Arc::clone(&self.constants);
        self.solution = self.newton.solve(&constants.forces, m, self.most_iterations, self.negligible_j);
        for (j, &(place, loaded, _)) in self.imposed.iter().enumerate() {
            let hold_n = DVec3::from_slice(&self.newton.hold_n[3 * j..3 * j + 3]);
            add_columns(constants.remainder(loaded), hold_n, &mut self.remainder_m);
            if let Some(force_n) = self.constraint_forces_n.get_mut(place as usize) {
                *force_n = hold_n;
            }
        }
        self.show();
    }

    fn state(&self) -> ModelState<'_> {
        ModelState { positions_m: &self.positions_m, velocities_m_per_s: &[] }
    }

    fn history_into(&self, numbers: &mut Vec<f64>) {
        numbers.extend_from_slice(&self.newton.q);
    }

    fn constraint_forces_n(&self) -> &[DVec3] {
        &self.constraint_forces_n
    }

    fn take_over(&mut self, positions_m: &[DVec3]) {
        let constants = &self.constants;
        // The modes are mass-orthonormal, so this is a projection. A node whose position is not finite starts at rest.
        for (q, mode) in
            self.newton.q.iter_mut().zip(constants.mode_m.chunks_exact(3 * constants.rest_m.len()))
        {
            *q = 0.0;
            let places = positions_m.iter().zip(&constants.rest_m).zip(&constants.mass_kg);
            for (((position, rest), mass_kg), v) in places.zip(mode.chunks_exact(3)) {
                if position.is_finite() {
                    *q += mass_kg * (*position - *rest).dot(DVec3::from_slice(v));
                }
            }
        }
        // Finite positions may still be too large for a sum.
        if !self.newton.q.iter().all(|q| q.is_finite()) {
            self.newton.q.fill(0.0);
        }
        for ((position, given), rest) in self.positions_m.iter_mut().zip(positions_m).zip(&constants.rest_m) {
            *position = if given.is_finite() { *given } else { *rest };
        }
        self.constraint_forces_n.fill(DVec3::ZERO);
    }

    fn set_gravity(&mut self, gravity_m_per_s2: DVec3) {
        self.pull_m_per_s2 = gravity_m_per_s2 - self.rest_gravity_m_per_s2;
    }

    fn set_level_of_detail(&mut self, effort: LevelOfDetail) -> bool {
        // Choices: two or three are enough from one frame to the next.
        self.most_iterations = match effort {
            LevelOfDetail::Full => Self::MOST_ITERATIONS,
            LevelOfDetail::Reduced => 4,
            LevelOfDetail::Least => 2,
        };
        true
    }

    fn report(&self) -> ModelReport {
        ModelReport {
            n_parts: 1,
            n_ignored_constraints: self.n_ignored,
            missed_tolerance: !self.solution.converged,
            ..ModelReport::default()
        }
    }

    /// V A^-1 V^T + C_r with A the reduced stiffness at the present coordinates: exact for this model, and the same for any
    /// period. Where A is not positive definite, multiples of the stiffness at rest are added, as in a step. Nodes that other
    /// tools hold respond too; nodes that cannot be loaded do not.
    fn local_model_into(&mut self, patch: &[NodeId], period_s: f64, _: &mut LocalWork, out: &mut LocalModel) {
        self.fill_local_model(patch, period_s, out);
    }

    fn duplicate(&self) -> Box<dyn DeformableModel> {
        Box::new(Self {
            constants: Arc::clone(&self.constants),
            newton: self.newton.clone(),
            solution: self.solution,
            most_iterations: self.most_iterations,
            negligible_j: self.negligible_j,
            forces: self.forces.clone(),
            imposed: self.imposed.clone(),
            n_ignored: self.n_ignored,
            constraint_forces_n: self.constraint_forces_n.clone(),
            remainder_m: self.remainder_m.clone(),
            modes_m: self.modes_m.clone(),
            positions_m: self.positions_m.clone(),
            rest_gravity_m_per_s2: self.rest_gravity_m_per_s2,
            pull_m_per_s2: self.pull_m_per_s2,
        })
    }

    fn topology_refusal(&self) -> Option<TopologyRefusal> {
        Some(TopologyRefusal::Frozen {
            model: NAME,
            reason: "its modes and compliance hold for the uncut mesh; switch to explicit before cutting",
        })
    }

    fn topology_changed(&mut self, _: &TetMesh, _: &TopologyChange) -> Result<(), TopologyRefusal> {
        self.topology_refusal().map_or(Ok(()), Err)
    }
}
