//! Implicit Euler for a body of any law: large steps, stable at any stiffness.
//!
//! With u the displacements, x = u(t) + h v(t), f(u) the forces that balance the deformation, C = alpha M and
//! Rayleigh's second term beta K v written as beta (f(u) - f(u(t)))/h (equal to first order, and zero for a body that
//! only rotates), one step solves
//!
//! r(u) = M (u - x)/h^2 + alpha M (u - u(t))/h + f(u) + beta (f(u) - f(u(t)))/h - F - L(u) = 0,
//! v = (u - u(t))/h,
//!
//! with gravity and outer forces F and the pull L of the ligaments, which is the minimum of an incremental
//! potential (Martin et al. 2011, doi 10.1145/2010324.1964967). f holds the law's stress, the stress at rest
//! ([`super::RestStress`]) and the viscous memory. The solver is Newton's method with conjugate gradients on the exact
//! tangent, element by element. The preconditioner is the factor of the tangent at an earlier state, with its negative
//! eigenvalues removed. It is recomputed when the iterations since then have cost about as much as a factor, never by a
//! clock: in slices over the next steps, for the state in which it was found to be due. After an edit the old factor serves beside
//! the blocks of the nodes that have changed, until the new one has been made over the next steps. In large bodies two grids
//! ([`Preconditioner::TwoGrid`]) take the place of the factor, which grows faster than they do; where they do not solve, a
//! factor is made at once and serves for the next steps. Where the exact tangent has a
//! direction of negative curvature, the projected one is factored at once and gives the direction. A direction is shortened until the law allows every tetrahedron (ln J needs J > 0) and the potential
//! has decreased.
//!
//! In a step that starts with an inverted tetrahedron, beta is zero: the forces there are no measure of motion.
//!
//! A step ends when |r| <= tolerance (|F| + |M a| + |forces of the held nodes|), with F without the part that the stress at
//! rest balances; [`ImplicitReport`] lists the other endings. Only [`DeformableModel::take_over`] can give a shape in which
//! the law has no energy; the body then recovers by the stable neo-Hookean law (quarantine).

mod correction;
mod descent;
mod direct;
mod elements;
mod evaluation;
mod general;
mod lagged;
mod lagged_state;
mod lanes;
mod late;
mod law;
mod ligaments;
mod local;
mod neo_hooke;
mod newton;
mod params;
mod patch_inverse;
mod projected;
mod relaxation;
pub(super) mod row;
mod shares;
mod stable_neo_hooke;
mod steadying;
mod successor;
mod topology;

pub use law::{ImplicitLaw, SharedLaw};
pub use newton::{ImplicitReport, ImplicitStatus};
pub use params::{DEFAULT_TOLERANCE, ImplicitError, ImplicitParams, Preconditioner};

use self::elements::{Elements, ElementsParams, Recovery};
use self::lagged::{Lagged, Pending};
use self::lagged_state::{Edited, LaggedState, NodeTerms};
use self::ligaments::Ligaments;
use self::newton::{MOST_NEWTON_ITERATIONS, Scratch};
use self::relaxation::Relaxation;
use self::steadying::Steadying;
use self::successor::Successor;
use super::bounded_vec::BoundedVec;
use super::{
    Answered, Attachment, Constraints, Correction, DeformableModel, DynamicBody, LevelOfDetail, LocalModel,
    LocalWork, ModelReport, ModelState, ModelUndo, NodalForce, NodalSpring, Rayleigh, RestStress, StepAnswer,
    TopologyRefusal,
};
use crate::material::{PronyHistory, StableNeoHooke};
use crate::solve::SolveError;
use crate::workers::{Sequential, SharedWorkers};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::{NodeId, TetMesh};
use std::sync::Arc;

/// Where the volume change is resisted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum VolumeResistance {
    /// In each tetrahedron: stiff, locks when nearly incompressible.
    #[default]
    Element,
    /// In the volume of all tetrahedra around each node: does not lock when nearly incompressible. The ln J
    /// neo-Hookean law only.
    NodeAveraged,
    /// As [`Self::NodeAveraged`], with four fifths of the shear averaged too: does not lock in bending either. The ln J
    /// neo-Hookean law only, without relaxation.
    NodeAveragedStrain,
}

/// A node that a tool holds.
#[derive(Clone, Copy, Debug)]
struct Held {
    place: u32,
    node: u32,
    target_m: DVec3,
}

/// Use of the lagged factor so far.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct FactorAge {
    /// Steps with this factor.
    n_steps: u32,
    /// Iterations of its first step.
    first_iterations: u32,
    /// Iterations of later steps beyond those of the first, added up.
    excess_iterations: u32,
}

/// Newton iterations with reduced and with least effort: choices. A single one is the linearly implicit Euler step of
/// D. Baraff and A. Witkin (Large steps in cloth simulation, 1998, doi 10.1145/280814.280821); two leave a smaller residual.
const REDUCED_ITERATIONS: u32 = 5;
const LEAST_ITERATIONS: u32 = 2;

/// One organ moved by implicit Euler.
#[derive(Clone)]
pub struct ImplicitEuler {
    law: ImplicitLaw,
    /// One, or one per tetrahedron.
    stand_ins: Vec<StableNeoHooke>,
    volume: VolumeResistance,
    density_kg_per_m3: f64,
    damping: Rayleigh,
    gravity_m_per_s2: DVec3,
    tolerance: f64,
    preconditioner: Preconditioner,
    workers: SharedWorkers,
    /// Limit of the Newton iterations of a step once all held nodes are at their targets.
    most_iterations: u32,
    time_step_s: f64,
    /// Forces [N] below this are rounding.
    least_force_n: f64,
    /// So are differences of energy [J] below this.
    least_energy_j: f64,

    // The body; changed by edits only.
    mesh: TetMesh,
    tet_is_live: Vec<bool>,
    rest_stress_pa: Vec<RestStress>,
    /// 1 along the axes that no support holds, 0 along the others.
    free_axes: Vec<DVec3>,
    mass_kg: Vec<f64>,
    /// Nodes with a tetrahedron and a free axis.
    moves: Vec<bool>,
    ligaments: Ligaments,
    steadying: Steadying,
    /// Forces [N] that the stress at rest balances, without the ligaments' pull at rest.
    rest_load_n: Vec<DVec3>,
    elements: Elements,
    /// None without a tetrahedron.
    lagged: Option<Lagged>,
    /// The factor that is being made since an edit: the present one is of the mesh before.
    successor: Option<Successor>,
    /// Whether a sparse factor of the mesh as it is serves in the place of two grids until the successor is made.
    has_fallen_back: bool,

    // State.
    displacement_m: Vec<DVec3>,
    velocities_m_per_s: Vec<DVec3>,
    /// Velocities before the last step, for the next first guess.
    earlier_velocities_m_per_s: Vec<DVec3>,
    relaxation: Option<Relaxation>,
    age: FactorAge,
    /// Factors made so far.
    factor_version: u64,
    positions_m: Vec<DVec3>,

    // Constraints and scratch.
    outer_n: Vec<DVec3>,
    held: BoundedVec<Held>,
    is_held: Vec<bool>,
    /// [`Self::free_axes`], zero for nodes that a tool holds and for those without a tetrahedron.
    mask: Vec<DVec3>,
    constraint_forces_n: BoundedVec<DVec3>,
    ignored_constraints: usize,
    /// Whether the shape may hold tetrahedra in which the law has no energy.
    is_suspect: bool,
    n_recovered_nodes: u32,
    n_reanalyses: u32,
    scratch: Scratch,
    step_report: ImplicitReport,
    /// Whether the velocities of the last step were made smaller.
    energy_was_limited: bool,
    report: ModelReport,
}

/// A copy of the dynamic state, for [`ImplicitEuler::restore`]. It is valid for the same mesh and removals.
#[derive(Clone, Debug, PartialEq)]
pub struct ImplicitSnapshot {
    displacement_m: Vec<DVec3>,
    velocities_m_per_s: Vec<DVec3>,
    earlier_velocities_m_per_s: Vec<DVec3>,
    viscous: Vec<PronyHistory>,
    recovery: Recovery,
    age: FactorAge,
    lagged: Option<LaggedState>,
    pending: Option<Pending>,
}

impl ImplicitEuler {
    /// Computes masses, sparse pattern and first factor. Every tetrahedron of the mesh counts as live.
    ///
    /// # Errors
    /// [`ImplicitError`]: an unusable mesh, impossible supports, loads, damping, step or tolerance, a law without
    /// stiffness at rest, a combination of law, volume resistance and relaxation that there is not.
    pub fn build(params: &ImplicitParams<'_>) -> Result<Self, ImplicitError> {
        params.check()?;
        let mut model = Self::at_rest(params)?;
        model.analyse()?;
        model.publish();
        Ok(model)
    }

    /// The body at rest, without masses and factor.
    fn at_rest(params: &ImplicitParams<'_>) -> Result<Self, ImplicitError> {
        let DynamicBody { mesh, .. } = params.body;
        let n_nodes = mesh.positions_m.len();
        let n_tets = mesh.tetrahedra.len();
        let tet_is_live = vec![true; n_tets];
        let stand_ins = params.law.stand_ins(n_tets)?;
        let elements = Elements::new(&ElementsParams {
            mesh,
            live: &tet_is_live,
            law: params.law,
            stand_ins: &stand_ins,
            volume: params.volume,
            rest_stress_pa: params.body.rest_stress_pa,
            is_viscous: params.relaxation.is_some(),
            known: None,
        })?;
        let zero = vec![DVec3::ZERO; n_nodes];
        Ok(Self {
            law: params.law.clone(),
            stand_ins,
            volume: params.volume,
            density_kg_per_m3: params.body.density_kg_per_m3,
            damping: params.body.damping,
            gravity_m_per_s2: params.body.gravity_m_per_s2,
            tolerance: params.tolerance,
            preconditioner: params.preconditioner,
            workers: Arc::new(Sequential),
            most_iterations: MOST_NEWTON_ITERATIONS,
            time_step_s: params.body.time_step_s,
            least_force_n: 0.0,
            least_energy_j: 0.0,
            elements,
            mesh: mesh.clone(),
            tet_is_live,
            rest_stress_pa: params.body.rest_stress_pa.to_vec(),
            free_axes: params.free_axes()?,
            mass_kg: Vec::new(),
            moves: Vec::new(),
            ligaments: Ligaments::new(params.body.attachments.to_vec()),
            steadying: Steadying::new(),
            rest_load_n: zero.clone(),
            lagged: None,
            successor: None,
            has_fallen_back: false,
            displacement_m: zero.clone(),
            velocities_m_per_s: zero.clone(),
            earlier_velocities_m_per_s: zero.clone(),
            relaxation: params.relaxation.map(|s| Relaxation::new(s, params.body.time_step_s, n_tets)),
            age: FactorAge::default(),
            factor_version: 0,
            positions_m: mesh.positions_m.clone(),
            outer_n: zero.clone(),
            held: BoundedVec::with_capacity(n_nodes),
            is_held: vec![false; n_nodes],
            mask: zero,
            constraint_forces_n: BoundedVec::with_capacity(n_nodes),
            ignored_constraints: 0,
            is_suspect: false,
            n_recovered_nodes: 0,
            n_reanalyses: 0,
            scratch: Scratch::new(n_nodes),
            step_report: ImplicitReport::default(),
            energy_was_limited: false,
            report: ModelReport::default(),
        })
    }

    /// Computes masses, pattern and factor of the live tetrahedra at the present state.
    fn analyse(&mut self) -> Result<(), SolveError> {
        self.weigh();
        let state = self.lagged_state(self.time_step_s);
        self.factor_at_once(state)
    }

    /// Computes what follows from the live tetrahedra alone: masses, what moves, and the loads at rest.
    fn weigh(&mut self) {
        let density = self.density_kg_per_m3;
        self.mass_kg = self.elements.node_volume_m3().iter().map(|v| density * v).collect();
        self.moves = self
            .mass_kg
            .iter()
            .zip(&self.free_axes)
            .map(|(m, free)| *m > 0.0 && *free != DVec3::ZERO)
            .collect();
        self.update_mask();
        self.balance_rest();
    }

    /// Pattern and factor for a state of the mesh as it is. Without one, what there was serves on.
    fn factor_at_once(&mut self, state: LaggedState) -> Result<(), SolveError> {
        self.factor_by(self.preconditioner, state)
    }

    fn factor_by(&mut self, preconditioner: Preconditioner, state: LaggedState) -> Result<(), SolveError> {
        let free_axes = self.axes_that_move();
        let edited = Edited { preconditioner, ..self.edited(&free_axes) };
        let new = |state| Lagged::new(&edited, state);
        // Where the present shape has no factor, that of the rest shape is the preconditioner.
        let of_rest = state.at_rest();
        let has_tets = !self.elements.tets().is_empty();
        let lagged = has_tets.then(|| new(state).or_else(|_| new(of_rest))).transpose()?;
        self.lagged = lagged;
        self.successor = None;
        self.has_fallen_back = false;
        self.factor_version += 1;
        self.age = FactorAge::default();
        Ok(())
    }

    /// What a preconditioner is made from.
    fn edited<'a>(&'a self, free_axes: &'a [DVec3]) -> Edited<'a> {
        let (elements, terms, preconditioner) = (&self.elements, self.node_terms(), self.preconditioner);
        Edited { elements, terms, free_axes, preconditioner }
    }

    fn axes_that_move(&self) -> Vec<DVec3> {
        let of_node = |(moves, free): (&bool, &DVec3)| if *moves { *free } else { DVec3::ZERO };
        self.moves.iter().zip(&self.free_axes).map(of_node).collect()
    }

    fn node_terms(&self) -> NodeTerms<'_> {
        NodeTerms { rest_m: &self.mesh.positions_m, mass_kg: &self.mass_kg, ligaments: &self.ligaments }
    }

    /// Computes the load that the stress at rest carries, and the force below which a residual is rounding.
    fn balance_rest(&mut self) {
        let volume_m3: f64 = self.elements.node_volume_m3().iter().sum();
        self.least_force_n = ROUNDING * self.law.modulus_pa() * libm::cbrt(volume_m3 * volume_m3);
        self.least_energy_j = ROUNDING * self.law.modulus_pa() * volume_m3;
        self.rest_load_n = vec![DVec3::ZERO; self.n_nodes()];
        if self.rest_stress_pa.is_empty() && self.ligaments.is_empty() {
            return;
        }
        let at_rest = vec![DVec3::ZERO; self.n_nodes()];
        // The elements are new: there is no viscous memory yet.
        self.elements.evaluate(self.workers.as_ref(), &at_rest, &mut self.rest_load_n);
        self.ligaments.pull_into(&self.mesh.positions_m, &at_rest, &mut self.scratch.ligament_n);
        for (load_n, pull_n) in self.rest_load_n.iter_mut().zip(&self.scratch.ligament_n) {
            *load_n -= *pull_n;
        }
        self.least_force_n +=
            REST_ROUNDING * self.rest_load_n.iter().map(|f| f.length_squared()).sum::<f64>().sqrt();
    }

    /// The state on which a factor made now for steps of `h_s` would depend.
    fn lagged_state(&mut self, h_s: f64) -> LaggedState {
        let mut strays = vec![false; self.elements.tets().len()];
        self.elements.strays_into(&mut strays);
        LaggedState {
            displacement_m: self.displacement_m.clone(),
            held: self.is_held.clone(),
            strays,
            per_mass: 1.0 / (h_s * h_s) + self.damping.mass_per_s / h_s,
            per_stiffness: 1.0 + self.damping.stiffness_s / h_s,
            viscous_share: self.relaxation.as_mut().map_or(1.0, |r| r.stiffness_share(h_s)),
        }
    }

    fn update_mask(&mut self) {
        for n in 0..self.mask.len() {
            let is_free = self.moves[n] && !self.is_held[n];
            self.mask[n] = if is_free { self.free_axes[n] } else { DVec3::ZERO };
        }
    }

    fn n_nodes(&self) -> usize {
        self.displacement_m.len()
    }

    /// Who computes from now on, with the same bits; the calling thread alone at first. Who runs this model in a task gives it other
    /// workers.
    pub fn set_workers(&mut self, workers: SharedWorkers) {
        self.workers = workers;
    }

    /// Report on Newton's method in the last step.
    pub fn step_report(&self) -> &ImplicitReport {
        &self.step_report
    }

    /// The law.
    pub fn law(&self) -> &ImplicitLaw {
        &self.law
    }

    /// Mass [kg] of a node.
    pub fn mass_kg(&self, node: NodeId) -> f64 {
        self.mass_kg[node.index()]
    }

    /// Displacements [m] from the rest shape.
    pub fn displacements_m(&self) -> &[DVec3] {
        &self.displacement_m
    }

    /// Unbalanced force at each node after the last step [N]: the support's force on fixed nodes, the tool's on held ones, the
    /// residual elsewhere.
    pub fn support_forces_n(&self) -> &[DVec3] {
        &self.scratch.residual_n
    }

    fn kinetic_energy_j(&self) -> f64 {
        self.mass_kg.iter().zip(&self.velocities_m_per_s).map(|(m, v)| 0.5 * m * v.length_squared()).sum()
    }

    /// Kinetic energy and that of the tissue's deformation [J], the stress at rest included. With relaxation the
    /// latter is that of the last step's potential.
    pub fn energy_j(&mut self) -> f64 {
        let kinetic_j = self.kinetic_energy_j();
        let mut force_n = std::mem::take(&mut self.scratch.product_n);
        let elastic_j =
            self.elements.evaluate(self.workers.as_ref(), &self.displacement_m, &mut force_n).energy_j;
        self.scratch.product_n = force_n;
        kinetic_j + elastic_j
    }

    /// Constraints of the last [`DeformableModel::apply`] that were left out: on nodes that do not exist, are
    /// fixed or have no tetrahedron, and values that are not finite.
    pub fn ignored_constraints(&self) -> usize {
        self.ignored_constraints
    }

    /// Sets all velocities [m/s]; nodes that do not move keep zero.
    ///
    /// # Panics
    /// When there is not one velocity per node.
    pub fn set_velocities(&mut self, velocities_m_per_s: &[DVec3]) {
        assert_eq!(velocities_m_per_s.len(), self.n_nodes(), "one velocity a node");
        for n in 0..self.n_nodes() {
            let v = velocities_m_per_s[n];
            self.velocities_m_per_s[n] =
                if self.moves[n] && v.is_finite() { v * self.free_axes[n] } else { DVec3::ZERO };
        }
        self.earlier_velocities_m_per_s.copy_from_slice(&self.velocities_m_per_s);
        self.publish();
    }

    /// A copy of the dynamic state.
    pub fn snapshot(&self) -> ImplicitSnapshot {
        ImplicitSnapshot {
            displacement_m: self.displacement_m.clone(),
            velocities_m_per_s: self.velocities_m_per_s.clone(),
            earlier_velocities_m_per_s: self.earlier_velocities_m_per_s.clone(),
            viscous: self.relaxation.as_ref().map_or(Vec::new(), |r| r.histories.clone()),
            recovery: self.elements.recovery(),
            age: self.age,
            lagged: self.lagged.as_ref().map(|lagged| lagged.state.clone()),
            pending: self.lagged.as_ref().and_then(|lagged| lagged.pending().cloned()),
        }
    }

    /// Returns to a state of the same mesh and removals; constraints stay as they are. The factor is recomputed at the state
    /// at which it was made then, and so are the slices of one that was being made, so that the next steps have the same bits.
    /// Where the factor of an edited mesh was not there yet, then or now, it is made at once, and so are two grids where a factor
    /// served in their place.
    ///
    /// # Panics
    /// When the snapshot has another number of nodes.
    pub fn restore(&mut self, snapshot: &ImplicitSnapshot) {
        self.displacement_m.copy_from_slice(&snapshot.displacement_m);
        self.velocities_m_per_s.copy_from_slice(&snapshot.velocities_m_per_s);
        self.earlier_velocities_m_per_s.copy_from_slice(&snapshot.earlier_velocities_m_per_s);
        if let Some(relaxation) = &mut self.relaxation {
            relaxation.histories.clone_from_slice(&snapshot.viscous);
        }
        self.age = snapshot.age;
        self.is_suspect = true;
        self.elements.quarantine(&self.displacement_m, snapshot.recovery);
        let sizes = [self.n_nodes(), self.elements.tets().len()];
        let fits = |state: &LaggedState| [state.displacement_m.len(), state.strays.len()] == sizes;
        if self.successor.is_some() || !snapshot.lagged.as_ref().is_none_or(fits) {
            let state = self.lagged_state(self.time_step_s);
            // Without one, the next steps look for it.
            let _ = self.factor_at_once(state);
        } else if let (Some(lagged), Some(state)) = (&mut self.lagged, &snapshot.lagged) {
            let nodes = NodeTerms {
                rest_m: &self.mesh.positions_m,
                mass_kg: &self.mass_kg,
                ligaments: &self.ligaments,
            };
            if lagged.state != *state {
                lagged.state = state.clone();
                let is_made = lagged.refresh(&self.elements, nodes);
                self.factor_version += 1;
                if !is_made && lagged.direct().is_none() {
                    self.fall_back(state.clone());
                    self.publish();
                    return;
                }
            }
            lagged.resume(snapshot.pending.as_ref(), &self.elements, nodes);
        }
        self.publish();
    }

    /// Updates the positions from the displacements.
    fn publish(&mut self) {
        for n in 0..self.n_nodes() {
            self.positions_m[n] = self.mesh.positions_m[n] + self.displacement_m[n];
        }
    }

    fn takes_load(&self, node: NodeId) -> bool {
        self.moves.get(node.index()).is_some_and(|&moves| moves)
    }

    fn release_all(&mut self) {
        self.steadying.clear(&mut self.scratch.ligament_n);
        self.outer_n.fill(DVec3::ZERO);
        self.is_held.fill(false);
        self.held.clear();
        self.constraint_forces_n.clear();
    }
}

/// A residual below this share of modulus times area is rounding.
const ROUNDING: f64 = 1e-14;
/// Share of the load at rest below which a residual is rounding.
const REST_ROUNDING: f64 = 1e-11;

impl DeformableModel for ImplicitEuler {
    fn apply(&mut self, constraints: &Constraints) {
        self.release_all();
        self.ignored_constraints = 0;
        for force in &constraints.forces {
            if self.takes_load(force.node) && force.force_n.is_finite() {
                self.outer_n[force.node.index()] += force.force_n;
            } else {
                self.ignored_constraints += 1;
            }
        }
        for (place, imposed) in constraints.displacements.iter().enumerate() {
            let n = imposed.node.index();
            let usable = self.takes_load(imposed.node)
                && imposed.displacement_m.is_finite()
                && !self.is_held[n]
                && place < self.n_nodes();
            if usable {
                self.is_held[n] = true;
                self.held.push(Held {
                    place: place as u32,
                    node: imposed.node.0,
                    target_m: imposed.displacement_m * self.free_axes[n],
                });
            } else {
                self.ignored_constraints += 1;
            }
        }
        let n_forces = constraints.displacements.len().min(self.n_nodes());
        self.constraint_forces_n.resize(n_forces, DVec3::ZERO);
        self.update_mask();
    }

    fn steady(&mut self, spring: NodalSpring) {
        let is_sound = spring.place_m.is_finite() && spring.stiffness_n_per_m >= 0.0;
        if self.takes_load(spring.node) && is_sound {
            self.steadying.add(spring);
        }
    }

    fn step(&mut self, dt_s: f64) {
        if !(dt_s.is_finite() && dt_s > 0.0) {
            return;
        }
        self.advance(dt_s);
        self.publish();
        self.report = ModelReport {
            n_parts: 1,
            n_quarantined_tets: self.step_report.n_quarantined_tets,
            first_quarantined: self.step_report.first_quarantined,
            n_recovered_nodes: std::mem::take(&mut self.n_recovered_nodes),
            n_ignored_constraints: u32::try_from(self.ignored_constraints).unwrap_or(u32::MAX),
            kinetic_energy_j: self.kinetic_energy_j(),
            energy_was_limited: self.energy_was_limited,
            missed_tolerance: self.step_report.status != ImplicitStatus::Converged,
            n_reanalyses: self.n_reanalyses,
            ..ModelReport::default()
        };
    }

    fn state(&self) -> ModelState<'_> {
        ModelState { positions_m: &self.positions_m, velocities_m_per_s: &self.velocities_m_per_s }
    }

    fn history_into(&self, numbers: &mut Vec<f64>) {
        numbers.extend(self.earlier_velocities_m_per_s.iter().flat_map(|v| v.to_array()));
        if let Some(lagged) = &self.lagged {
            numbers.extend(lagged.state.numbers());
            if let Some(pending) = lagged.pending() {
                numbers.extend(pending.state.numbers());
                numbers.push(f64::from(pending.n_slices));
            }
            numbers.extend(lagged.late().numbers());
        }
        if let Some(successor) = &self.successor {
            numbers.extend(successor.numbers());
        }
        if let Some(relaxation) = &self.relaxation {
            numbers.extend(relaxation.numbers());
        }
        let FactorAge { n_steps, first_iterations, excess_iterations } = self.age;
        let recovery = self.elements.recovery() as u32;
        numbers.extend([n_steps, first_iterations, excess_iterations, recovery].map(f64::from));
    }

    fn constraint_forces_n(&self) -> &[DVec3] {
        &self.constraint_forces_n
    }

    fn take_over(&mut self, positions_m: &[DVec3]) {
        assert_eq!(positions_m.len(), self.n_nodes(), "one position a node");
        for n in 0..self.n_nodes() {
            let u = positions_m[n] - self.mesh.positions_m[n];
            if !self.moves[n] {
                self.displacement_m[n] = DVec3::ZERO;
            } else if u.is_finite() {
                self.displacement_m[n] = u * self.free_axes[n];
            } else {
                self.n_recovered_nodes += 1;
            }
        }
        if let Some(relaxation) = &mut self.relaxation {
            relaxation.forget();
        }
        if let Some(lagged) = &mut self.lagged {
            // For a shape that has nothing to do with the new one.
            lagged.drop_pending();
        }
        self.is_suspect = true;
        self.velocities_m_per_s.fill(DVec3::ZERO);
        self.earlier_velocities_m_per_s.fill(DVec3::ZERO);
        self.publish();
    }

    fn set_gravity(&mut self, gravity_m_per_s2: DVec3) {
        if gravity_m_per_s2.is_finite() {
            self.gravity_m_per_s2 = gravity_m_per_s2;
        }
    }

    fn set_level_of_detail(&mut self, effort: LevelOfDetail) -> bool {
        self.most_iterations = match effort {
            LevelOfDetail::Full => MOST_NEWTON_ITERATIONS,
            LevelOfDetail::Reduced => REDUCED_ITERATIONS,
            LevelOfDetail::Least => LEAST_ITERATIONS,
        };
        true
    }

    fn report(&self) -> ModelReport {
        self.report
    }

    fn local_model_into(
        &mut self,
        patch: &[NodeId],
        period_s: f64,
        work: &mut LocalWork,
        out: &mut LocalModel,
    ) {
        self.fill_local_model(patch, period_s, work, out);
    }

    fn step_answer(&self) -> StepAnswer {
        StepAnswer::Coupled { version: self.factor_version }
    }

    fn answer_into(&mut self, forces: &[NodalForce], moves_m: &mut [DVec3], at: Answered) {
        self.answer(forces, moves_m, at);
    }

    fn correct_step(&mut self, forces: &[NodalForce], dt_s: f64, correction: Correction) {
        self.correct(forces, dt_s, correction);
    }

    fn duplicate(&self) -> Box<dyn DeformableModel> {
        Box::new(self.clone())
    }

    fn follow_saving(
        &mut self,
        mesh: &TetMesh,
        change: &TopologyChange,
        undo: &mut ModelUndo,
    ) -> Result<(), TopologyRefusal> {
        undo.keep_whole(Box::new(self.before_edit()));
        self.follow(mesh, change)
    }

    fn topology_changed(&mut self, mesh: &TetMesh, change: &TopologyChange) -> Result<(), TopologyRefusal> {
        self.follow(mesh, change)
    }
}
