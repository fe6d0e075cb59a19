//! Implicit Euler for a ln J neo-Hooke body: large steps, stable at any stiffness.
//!
//! With u the displacements, x = u(t) + h v(t), f(u) the forces that balance the deformation, C = alpha M and
//! Rayleigh's second term beta K v written as beta (f(u) - f(u(t)))/h (equal to it to first order, and zero for
//! a body that only turns), one step solves
//!
//! r(u) = M (u - x)/h^2 + alpha M (u - u(t))/h + f(u) + beta (f(u) - f(u(t)))/h - F = 0,   v = (u - u(t))/h,
//!
//! which is the minimum of an incremental potential (Martin et al. 2011, doi 10.1145/2010324.1964967). Newton's
//! method with conjugate gradients on the exact tangent, element by element; the preconditioner is the factor
//! of the tangent at an earlier state, its negative eigenvalues removed ([`projected`]). It is made anew when
//! the iterations since then have cost about as much as a factor, never by a clock. Where the exact tangent has
//! a negative direction, the projected one is factored at once and gives the direction. A direction is
//! shortened until no tetrahedron is inverted and the potential has fallen: ln J needs J > 0.
//!
//! A step ends when |r| <= tolerance (|F| + |M a| + |forces of the held nodes|); what else can happen is in
//! [`ImplicitReport`].

mod elements;
mod lagged;
mod newton;
mod projected;
mod topology;

pub use elements::VolumeResistance;
pub use newton::{ImplicitReport, ImplicitStatus};

use self::elements::Elements;
use self::lagged::{Lagged, LaggedParams, LaggedState};
use self::newton::Scratch;
use super::{Constraints, DeformableModel, ModelState, TopologyRefusal};
use crate::material::LinearElastic;
use crate::math::DVec3;
use crate::mesh::edit::TopologyChange;
use crate::mesh::{NodeId, TetId, TetMesh};
use crate::solve::SolveError;

/// Why there is no implicit model.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ImplicitError {
    /// The mesh is unusable.
    #[error(transparent)]
    Solve(#[from] SolveError),
    /// A parameter that is negative or no number.
    #[error("{what} is {found}; allowed: {allowed}")]
    Parameter {
        /// Which one, with its unit.
        what: &'static str,
        /// What was given.
        found: f64,
        /// What may be given.
        allowed: &'static str,
    },
}

/// What an implicit model is made from.
#[derive(Clone, Copy, Debug)]
pub struct ImplicitParams<'a> {
    /// The body at rest.
    pub mesh: &'a TetMesh,
    /// lambda, mu and density of the ln J neo-Hooke law.
    pub material: &'a LinearElastic,
    /// Where the volume change is resisted.
    pub volume: VolumeResistance,
    /// Nodes that never move.
    pub fixed_nodes: &'a [NodeId],
    /// Rayleigh's alpha [1/s]: damping over mass.
    pub mass_damping_per_s: f64,
    /// Rayleigh's beta [s]: damping over stiffness.
    pub stiffness_damping_s: f64,
    /// Gravity [m/s2]; zero where the rest shape already carries it.
    pub gravity_m_per_s2: DVec3,
    /// Usual step [s]: the first factor is made for it.
    pub time_step_s: f64,
    /// Residual over applied, inertial and holding forces at which a step ends; [`DEFAULT_TOLERANCE`].
    pub tolerance: f64,
}

/// A tenth of a per cent of the forces: below what linear tetrahedra of organ size can promise.
pub const DEFAULT_TOLERANCE: f64 = 1e-3;

/// A node that a tool holds.
#[derive(Clone, Copy, Debug)]
struct Held {
    place: u32,
    node: u32,
    target_m: DVec3,
}

/// How the lagged factor has served so far.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct FactorAge {
    /// Steps with this factor.
    n_steps: u32,
    /// Iterations of its first step.
    first_iterations: u32,
    /// Iterations of later steps beyond those of the first, added up.
    excess_iterations: u32,
}

/// One organ moved by implicit Euler.
#[derive(Clone)]
pub struct ImplicitEuler {
    material: LinearElastic,
    volume: VolumeResistance,
    mass_damping_per_s: f64,
    stiffness_damping_s: f64,
    gravity_m_per_s2: DVec3,
    tolerance: f64,
    time_step_s: f64,
    /// Forces [N] below this are rounding.
    least_force_n: f64,

    // The body; changed by edits only.
    mesh: TetMesh,
    tet_is_live: Vec<bool>,
    is_fixed: Vec<bool>,
    mass_kg: Vec<f64>,
    /// Nodes that are neither fixed nor without a tetrahedron.
    moves: Vec<bool>,
    elements: Elements,
    /// None without a tetrahedron.
    lagged: Option<Lagged>,

    // State.
    displacement_m: Vec<DVec3>,
    velocities_m_per_s: Vec<DVec3>,
    /// Velocities before the last step: they make the next first guess.
    earlier_velocities_m_per_s: Vec<DVec3>,
    age: FactorAge,
    positions_m: Vec<DVec3>,
    history: Vec<f64>,

    // Constraints and scratch.
    outer_n: Vec<DVec3>,
    held: Vec<Held>,
    is_held: Vec<bool>,
    constraint_forces_n: Vec<DVec3>,
    ignored_constraints: usize,
    scratch: Scratch,
    report: ImplicitReport,
}

/// A copy of the moving state, for [`ImplicitEuler::restore`]. It holds for the same mesh and removals.
#[derive(Clone, Debug, PartialEq)]
pub struct ImplicitSnapshot {
    displacement_m: Vec<DVec3>,
    velocities_m_per_s: Vec<DVec3>,
    earlier_velocities_m_per_s: Vec<DVec3>,
    age: FactorAge,
    lagged: Option<LaggedState>,
}

impl ImplicitEuler {
    /// Masses, sparse pattern and first factor. Every tetrahedron of the mesh counts as live.
    ///
    /// # Errors
    /// [`ImplicitError`]: an unusable mesh, impossible damping, gravity, step or tolerance.
    pub fn build(params: &ImplicitParams<'_>) -> Result<Self, ImplicitError> {
        let parameter = |what, found, allowed| Err(ImplicitError::Parameter { what, found, allowed });
        for (what, found) in [
            ("mass damping [1/s]", params.mass_damping_per_s),
            ("stiffness damping [s]", params.stiffness_damping_s),
        ] {
            if !(found.is_finite() && found >= 0.0) {
                return parameter(what, found, "a finite number from 0");
            }
        }
        if !params.gravity_m_per_s2.is_finite() {
            return parameter("gravity [m/s2]", params.gravity_m_per_s2.length(), "finite numbers");
        }
        if !(params.time_step_s.is_finite() && params.time_step_s > 0.0) {
            return parameter("time step [s]", params.time_step_s, "a finite number above 0");
        }
        if !(params.tolerance >= LEAST_TOLERANCE && params.tolerance <= 0.1) {
            return parameter("tolerance", params.tolerance, "1e-12 to 0.1");
        }
        let n_nodes = params.mesh.positions_m.len();
        if params.mesh.tetrahedra.is_empty() {
            return Err(SolveError::EmptyMesh.into());
        }
        if let Some((t, node)) = params
            .mesh
            .tetrahedra
            .iter()
            .enumerate()
            .find_map(|(t, nodes)| nodes.iter().find(|n| n.index() >= n_nodes).map(|&n| (t, n)))
        {
            return Err(SolveError::NodeOutOfRange { tet: TetId::from_index(t), node, n_nodes }.into());
        }
        if let Some(&node) = params.fixed_nodes.iter().find(|n| n.index() >= n_nodes) {
            return Err(SolveError::ConditionOutOfRange { node, n_nodes }.into());
        }
        let mut is_fixed = vec![false; n_nodes];
        for node in params.fixed_nodes {
            is_fixed[node.index()] = true;
        }
        let tet_is_live = vec![true; params.mesh.tetrahedra.len()];
        let lame_pa = [params.material.lambda_pa(), params.material.mu_pa()];
        let mut model = Self {
            material: *params.material,
            volume: params.volume,
            mass_damping_per_s: params.mass_damping_per_s,
            stiffness_damping_s: params.stiffness_damping_s,
            gravity_m_per_s2: params.gravity_m_per_s2,
            tolerance: params.tolerance,
            time_step_s: params.time_step_s,
            least_force_n: 0.0,
            elements: Elements::new(params.mesh, &tet_is_live, lame_pa, params.volume)?,
            mesh: params.mesh.clone(),
            tet_is_live,
            is_fixed,
            mass_kg: Vec::new(),
            moves: Vec::new(),
            lagged: None,
            displacement_m: vec![DVec3::ZERO; n_nodes],
            velocities_m_per_s: vec![DVec3::ZERO; n_nodes],
            earlier_velocities_m_per_s: vec![DVec3::ZERO; n_nodes],
            age: FactorAge::default(),
            positions_m: params.mesh.positions_m.clone(),
            history: Vec::new(),
            outer_n: vec![DVec3::ZERO; n_nodes],
            held: Vec::with_capacity(n_nodes),
            is_held: vec![false; n_nodes],
            constraint_forces_n: Vec::with_capacity(n_nodes),
            ignored_constraints: 0,
            scratch: Scratch::new(n_nodes),
            report: ImplicitReport::default(),
        };
        model.analyse()?;
        model.publish();
        Ok(model)
    }

    /// Masses, pattern and factor of the live tetrahedra at the present state.
    fn analyse(&mut self) -> Result<(), SolveError> {
        let density = self.material.density_kg_per_m3();
        self.mass_kg = self.elements.node_volume_m3().iter().map(|v| density * v).collect();
        self.moves = self.mass_kg.iter().zip(&self.is_fixed).map(|(m, fixed)| *m > 0.0 && !fixed).collect();
        let volume_m3: f64 = self.elements.node_volume_m3().iter().sum();
        let modulus_pa = self.material.lambda_pa() + 2.0 * self.material.mu_pa();
        self.least_force_n = ROUNDING * modulus_pa * libm::cbrt(volume_m3 * volume_m3);
        self.age = FactorAge::default();
        let state = self.lagged_state(self.time_step_s);
        let live = TetMesh {
            positions_m: self.mesh.positions_m.clone(),
            tetrahedra: (0..self.tet_is_live.len())
                .filter(|&t| self.tet_is_live[t])
                .map(|t| self.mesh.tetrahedra[t])
                .collect(),
        };
        self.lagged = None;
        if live.tetrahedra.is_empty() {
            return Ok(());
        }
        let immobile: Vec<bool> = self.moves.iter().map(|moves| !moves).collect();
        let params = LaggedParams {
            mesh: &live,
            immobile: &immobile,
            mass_kg: &self.mass_kg,
            lame_pa: self.preconditioner_lame_pa(),
        };
        self.lagged = Some(Lagged::new(&params, &self.elements, state)?);
        Ok(())
    }

    /// Node-averaged pressure is softer than the tetrahedra's own, which make the preconditioner: a smaller
    /// lambda comes closer.
    fn preconditioner_lame_pa(&self) -> [f64; 2] {
        let (lambda_pa, mu_pa) = (self.material.lambda_pa(), self.material.mu_pa());
        match self.volume {
            VolumeResistance::Element => [lambda_pa, mu_pa],
            VolumeResistance::NodeAveraged => [lambda_pa.min(SOFTENED_LAMBDA_OVER_MU * mu_pa), mu_pa],
        }
    }

    /// What a factor made now for steps of `h_s` would depend on.
    fn lagged_state(&self, h_s: f64) -> LaggedState {
        LaggedState {
            displacement_m: self.displacement_m.clone(),
            held: self.is_held.clone(),
            per_mass: 1.0 / (h_s * h_s) + self.mass_damping_per_s / h_s,
            per_stiffness: 1.0 + self.stiffness_damping_s / h_s,
        }
    }

    fn n_nodes(&self) -> usize {
        self.displacement_m.len()
    }

    /// How the last step ended.
    pub fn report(&self) -> &ImplicitReport {
        &self.report
    }

    /// lambda, mu and density of the law.
    pub fn material(&self) -> &LinearElastic {
        &self.material
    }

    /// Mass [kg] of a node.
    pub fn mass_kg(&self, node: NodeId) -> f64 {
        self.mass_kg[node.index()]
    }

    /// Displacements [m] from the rest shape.
    pub fn displacements_m(&self) -> &[DVec3] {
        &self.displacement_m
    }

    /// What the last step left over at each node [N]: the support's force on fixed nodes, the tool's on held
    /// ones, the residual elsewhere.
    pub fn support_forces_n(&self) -> &[DVec3] {
        &self.scratch.residual_n
    }

    /// Kinetic and elastic energy [J].
    pub fn energy_j(&mut self) -> f64 {
        let kinetic_j: f64 = self
            .mass_kg
            .iter()
            .zip(&self.velocities_m_per_s)
            .map(|(m, v)| 0.5 * m * v.length_squared())
            .sum();
        let mut force_n = std::mem::take(&mut self.scratch.product_n);
        let elastic_j = self.elements.evaluate(&self.displacement_m, &mut force_n).energy_j;
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
    /// When they are not one a node.
    pub fn set_velocities(&mut self, velocities_m_per_s: &[DVec3]) {
        assert_eq!(velocities_m_per_s.len(), self.n_nodes(), "one velocity a node");
        for n in 0..self.n_nodes() {
            let v = velocities_m_per_s[n];
            self.velocities_m_per_s[n] = if self.moves[n] && v.is_finite() { v } else { DVec3::ZERO };
        }
        self.earlier_velocities_m_per_s.copy_from_slice(&self.velocities_m_per_s);
        self.publish();
    }

    /// The moving state, to come back to.
    pub fn snapshot(&self) -> ImplicitSnapshot {
        ImplicitSnapshot {
            displacement_m: self.displacement_m.clone(),
            velocities_m_per_s: self.velocities_m_per_s.clone(),
            earlier_velocities_m_per_s: self.earlier_velocities_m_per_s.clone(),
            age: self.age,
            lagged: self.lagged.as_ref().map(|lagged| lagged.state.clone()),
        }
    }

    /// Comes back to a state of the same mesh and removals; constraints stay as they are. The factor is made
    /// anew where it was made then, so that the next steps have the same bits.
    ///
    /// # Panics
    /// When the snapshot has another number of nodes.
    pub fn restore(&mut self, snapshot: &ImplicitSnapshot) {
        self.displacement_m.copy_from_slice(&snapshot.displacement_m);
        self.velocities_m_per_s.copy_from_slice(&snapshot.velocities_m_per_s);
        self.earlier_velocities_m_per_s.copy_from_slice(&snapshot.earlier_velocities_m_per_s);
        self.age = snapshot.age;
        if let (Some(lagged), Some(state)) = (&mut self.lagged, &snapshot.lagged)
            && lagged.state != *state
        {
            lagged.state = state.clone();
            lagged.refresh(&self.elements, &self.mass_kg);
        }
        self.publish();
    }

    /// Positions from displacements, and the rest of the state as numbers.
    fn publish(&mut self) {
        for n in 0..self.n_nodes() {
            self.positions_m[n] = self.mesh.positions_m[n] + self.displacement_m[n];
        }
        let history = &mut self.history;
        history.clear();
        history.extend(self.earlier_velocities_m_per_s.iter().flat_map(|v| v.to_array()));
        if let Some(lagged) = &self.lagged {
            history.extend(lagged.state.displacement_m.iter().flat_map(|u| u.to_array()));
            history.extend(lagged.state.held.iter().map(|&held| f64::from(u8::from(held))));
            history.extend([lagged.state.per_mass, lagged.state.per_stiffness]);
        }
        let FactorAge { n_steps, first_iterations, excess_iterations } = self.age;
        history.extend([n_steps, first_iterations, excess_iterations].map(f64::from));
    }

    fn takes_load(&self, node: NodeId) -> bool {
        self.moves.get(node.index()).is_some_and(|&moves| moves)
    }

    fn release_all(&mut self) {
        self.outer_n.fill(DVec3::ZERO);
        self.is_held.fill(false);
        self.held.clear();
        self.constraint_forces_n.clear();
    }
}

/// A residual below this share of modulus times area is rounding.
const ROUNDING: f64 = 1e-14;
/// Newton's iteration cannot promise less than this in double precision.
const LEAST_TOLERANCE: f64 = 1e-12;
/// lambda over mu of nu = 0.4.
const SOFTENED_LAMBDA_OVER_MU: f64 = 4.0;

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
                && place < self.constraint_forces_n.capacity();
            if usable {
                self.is_held[n] = true;
                self.held.push(Held {
                    place: place as u32,
                    node: imposed.node.0,
                    target_m: imposed.displacement_m,
                });
            } else {
                self.ignored_constraints += 1;
            }
        }
        let n_forces = constraints.displacements.len().min(self.constraint_forces_n.capacity());
        self.constraint_forces_n.resize(n_forces, DVec3::ZERO);
    }

    fn step(&mut self, dt_s: f64) {
        if !(dt_s.is_finite() && dt_s > 0.0) {
            return;
        }
        self.advance(dt_s);
        self.publish();
    }

    fn state(&self) -> ModelState<'_> {
        ModelState {
            positions_m: &self.positions_m,
            velocities_m_per_s: &self.velocities_m_per_s,
            history: &self.history,
        }
    }

    fn constraint_forces_n(&self) -> &[DVec3] {
        &self.constraint_forces_n
    }

    fn take_over(&mut self, positions_m: &[DVec3]) {
        assert_eq!(positions_m.len(), self.n_nodes(), "one position a node");
        for n in 0..self.n_nodes() {
            self.displacement_m[n] =
                if self.moves[n] { positions_m[n] - self.mesh.positions_m[n] } else { DVec3::ZERO };
        }
        self.velocities_m_per_s.fill(DVec3::ZERO);
        self.earlier_velocities_m_per_s.fill(DVec3::ZERO);
        self.publish();
    }

    fn duplicate(&self) -> Box<dyn DeformableModel> {
        Box::new(self.clone())
    }

    fn topology_changed(&mut self, _mesh: &TetMesh, change: &TopologyChange) -> Result<(), TopologyRefusal> {
        self.follow(change)
    }
}
