//! What the models with their own force law on moving nodes share: masses, supports, constraints, time steps.
//!
//! A model gives the forces of its links ([`InternalForces`]); [`ExplicitBody`] moves the nodes by one of the
//! schemes of [`crate::solve::integrators`]. Node i has the weight of its mass m_i and an inertia, which is m_i
//! or, with [`Inertia::Unit`], the same for every node (seed `003` s. 3.4); then only states at rest are physical.
//!
//! Held nodes move evenly to where they are held. The force on them is the one that balances link forces, weight
//! and outer forces at the last evaluation of the scheme, without the held node's own inertia.

use super::{Constraints, ModelState};
use crate::math::DVec3;
use crate::mesh::NodeId;
use crate::mesh::edit::TopologyChange;
use crate::solve::integrators::{EquationsOfMotion, FixedPoint, Integrator, ModeBounds, Motion, Scheme};

/// Why there is no such body.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ExplicitBodyError {
    /// The mesh is unusable.
    #[error(transparent)]
    Solve(#[from] crate::solve::SolveError),
    /// A step above the stable one.
    #[error(
        "time step {found_s:e} s is above the stable one: {scheme} allows at most {allowed_s:e} s here. Take a \
         smaller step, a coarser mesh, a softer material or (Runge-Kutta 2) more damping"
    )]
    UnstableStep {
        /// Name of the scheme.
        scheme: &'static str,
        /// What was asked for [s].
        found_s: f64,
        /// The largest allowed step [s].
        allowed_s: f64,
    },
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

/// What resists the acceleration of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Inertia {
    /// Its mass.
    Mass,
    /// The same for every node, the mean mass: better conditioned, and only states at rest are physical.
    Unit,
}

/// How a body moves in time.
#[derive(Clone, Copy, Debug)]
pub struct Dynamics<'a> {
    /// Nodes that never move.
    pub fixed_nodes: &'a [NodeId],
    /// The time integration.
    pub scheme: Scheme,
    /// When an implicit step is found.
    pub fixed_point: FixedPoint,
    /// What resists acceleration.
    pub inertia: Inertia,
    /// Damping over inertia, d [1/s]: a free motion decays as exp(-d t/2).
    pub damping_per_s: f64,
    /// Gravity [m/s2]; zero where the rest shape already carries it.
    pub gravity_m_per_s2: DVec3,
    /// Largest internal step [s]; at most the stable one.
    pub time_step_s: f64,
    /// How many times its value at rest the highest frequency may become under deformation, at least 1; it
    /// divides the stable step.
    pub frequency_reserve: f64,
}

impl Default for Dynamics<'_> {
    /// Semi-implicit Euler at 1 ms, nothing fixed, undamped, weightless.
    fn default() -> Self {
        Self {
            fixed_nodes: &[],
            scheme: Scheme::SemiImplicitEuler,
            fixed_point: FixedPoint::default(),
            inertia: Inertia::Mass,
            damping_per_s: 0.0,
            gravity_m_per_s2: DVec3::ZERO,
            time_step_s: 1e-3,
            frequency_reserve: 1.0,
        }
    }
}

/// Checks a number that must be finite and at least `least`.
pub(super) fn check_number(what: &'static str, found: f64, least: f64) -> Result<(), ExplicitBodyError> {
    if found.is_finite() && found >= least {
        return Ok(());
    }
    let allowed = if least == 0.0 { "a finite number from 0" } else { "a finite number from 1" };
    Err(ExplicitBodyError::Parameter { what, found, allowed })
}

/// The forces between the nodes of a body.
pub(super) trait InternalForces {
    /// Adds the force [N] that the links exert on each node.
    fn add_forces(&mut self, positions_m: &[DVec3], velocities_m_per_s: &[DVec3], force_n: &mut [DVec3]);
}

/// A node that a tool holds.
#[derive(Clone, Copy, Debug)]
struct Held {
    place: u32,
    node: u32,
    start_m: DVec3,
    target_m: DVec3,
}

/// Nodes in motion.
#[derive(Clone, Debug)]
pub(super) struct ExplicitBody {
    integrator: Integrator,
    inertia: Inertia,
    damping_per_s: f64,
    frequency_reserve: f64,
    gravity_m_per_s2: DVec3,
    time_step_s: f64,
    stable_step_s: f64,

    pub(super) rest_m: Vec<DVec3>,
    is_fixed: Vec<bool>,
    /// Zero for nodes without a tetrahedron.
    pub(super) mass_kg: Vec<f64>,
    inertia_kg: Vec<f64>,
    /// Not fixed, and with a tetrahedron.
    takes_load: Vec<bool>,
    /// Takes load and is not held.
    moves: Vec<bool>,
    node_damping_per_s: Vec<f64>,

    pub(super) positions_m: Vec<DVec3>,
    pub(super) velocities_m_per_s: Vec<DVec3>,
    force_n: Vec<DVec3>,
    outer_force_n: Vec<DVec3>,
    held: Vec<Held>,
    constraint_forces_n: Vec<DVec3>,
    ignored_constraints: usize,
    missed_fixed_points: u64,
}

/// A step longer than this many parts is cut to it: the caller asked for minutes in one step.
const MOST_PARTS: f64 = 1e6;

impl ExplicitBody {
    /// Nodes at rest; `bounds` are those of [`ExplicitBody::mode_bounds`] for the highest frequency of the body
    /// with `mass_kg`.
    pub(super) fn new(
        rest_m: &[DVec3],
        mass_kg: Vec<f64>,
        dynamics: &Dynamics<'_>,
    ) -> Result<Self, ExplicitBodyError> {
        check_number("damping [1/s]", dynamics.damping_per_s, 0.0)?;
        check_number("frequency reserve", dynamics.frequency_reserve, 1.0)?;
        if !dynamics.gravity_m_per_s2.is_finite() {
            let found = dynamics.gravity_m_per_s2.length();
            let (what, allowed) = ("gravity [m/s2]", "finite numbers");
            return Err(ExplicitBodyError::Parameter { what, found, allowed });
        }
        let h = dynamics.time_step_s;
        if !(h.is_finite() && h > 0.0) {
            let (what, allowed) = ("time step [s]", "a finite number above 0");
            return Err(ExplicitBodyError::Parameter { what, found: h, allowed });
        }
        let n_nodes = rest_m.len();
        let mut is_fixed = vec![false; n_nodes];
        for &node in dynamics.fixed_nodes {
            match is_fixed.get_mut(node.index()) {
                Some(flag) => *flag = true,
                None => return Err(crate::solve::SolveError::ConditionOutOfRange { node, n_nodes }.into()),
            }
        }
        let mut body = Self {
            integrator: Integrator::new(dynamics.scheme, dynamics.fixed_point, n_nodes),
            inertia: dynamics.inertia,
            damping_per_s: dynamics.damping_per_s,
            frequency_reserve: dynamics.frequency_reserve,
            gravity_m_per_s2: dynamics.gravity_m_per_s2,
            time_step_s: h,
            stable_step_s: f64::INFINITY,
            rest_m: rest_m.to_vec(),
            is_fixed,
            mass_kg,
            inertia_kg: vec![0.0; n_nodes],
            takes_load: vec![false; n_nodes],
            moves: vec![false; n_nodes],
            node_damping_per_s: vec![dynamics.damping_per_s; n_nodes],
            positions_m: rest_m.to_vec(),
            velocities_m_per_s: vec![DVec3::ZERO; n_nodes],
            force_n: vec![DVec3::ZERO; n_nodes],
            outer_force_n: vec![DVec3::ZERO; n_nodes],
            held: Vec::with_capacity(n_nodes),
            constraint_forces_n: Vec::with_capacity(n_nodes),
            ignored_constraints: 0,
            missed_fixed_points: 0,
        };
        body.masses_changed();
        Ok(body)
    }

    /// Bounds of the body's modes when the links alone have, with the true masses, at most this frequency and
    /// viscous damping over mass.
    fn mode_bounds(&self, frequency_rad_per_s: f64, viscosity_per_s: f64) -> ModeBounds {
        // x^T K x <= omega^2 x^T M x <= omega^2 (largest m_i/inertia_i) x^T I x.
        let lightness = self
            .mass_kg
            .iter()
            .zip(&self.inertia_kg)
            .filter(|(_, inertia)| **inertia > 0.0)
            .map(|(m, inertia)| m / inertia)
            .fold(0.0, f64::max);
        ModeBounds {
            highest_frequency_rad_per_s: frequency_rad_per_s * lightness.sqrt() * self.frequency_reserve,
            damping_per_s: [self.damping_per_s; 2],
            viscosity_per_s: viscosity_per_s * lightness,
        }
    }

    /// Takes over the highest frequency and viscous damping of the links.
    pub(super) fn set_bounds(&mut self, frequency_rad_per_s: f64, viscosity_per_s: f64) {
        let bounds = self.mode_bounds(frequency_rad_per_s, viscosity_per_s);
        self.stable_step_s = self.integrator.scheme().stable_step_s(&bounds);
    }

    /// Refuses a step above the stable one.
    pub(super) fn check_step(&self) -> Result<(), ExplicitBodyError> {
        if self.time_step_s <= self.stable_step_s {
            return Ok(());
        }
        Err(ExplicitBodyError::UnstableStep {
            scheme: self.integrator.scheme().name(),
            found_s: self.time_step_s,
            allowed_s: self.stable_step_s,
        })
    }

    pub(super) fn stable_step_s(&self) -> f64 {
        self.stable_step_s
    }

    pub(super) fn time_step_s(&self) -> f64 {
        self.time_step_s
    }

    pub(super) fn ignored_constraints(&self) -> usize {
        self.ignored_constraints
    }

    pub(super) fn missed_fixed_points(&self) -> u64 {
        self.missed_fixed_points
    }

    /// Into how many equal parts a step of `dt_s` is divided now.
    pub(super) fn parts_of_step(&self, dt_s: f64) -> u64 {
        let longest_s = self.time_step_s.min(self.stable_step_s);
        // A hair below the whole number: dt = k times the step gives k parts in spite of rounding.
        (dt_s / longest_s - 1e-9).ceil().clamp(1.0, MOST_PARTS) as u64
    }

    /// Makes inertias and flags follow `mass_kg`.
    pub(super) fn masses_changed(&mut self) {
        let n_live = self.mass_kg.iter().filter(|m| **m > 0.0).count().max(1);
        let mean_kg = self.mass_kg.iter().sum::<f64>() / n_live as f64;
        for i in 0..self.mass_kg.len() {
            let live = self.mass_kg[i] > 0.0;
            self.inertia_kg[i] = match self.inertia {
                _ if !live => 0.0,
                Inertia::Mass => self.mass_kg[i],
                Inertia::Unit => mean_kg,
            };
            self.takes_load[i] = live && !self.is_fixed[i];
            if !live {
                self.velocities_m_per_s[i] = DVec3::ZERO;
                self.outer_force_n[i] = DVec3::ZERO;
            }
        }
        // A held node that lost its last tetrahedron has nothing to pull on.
        let takes_load = &self.takes_load;
        self.held.retain(|held| takes_load[held.node as usize]);
        self.update_moves();
    }

    fn update_moves(&mut self) {
        self.moves.copy_from_slice(&self.takes_load);
        for held in &self.held {
            self.moves[held.node as usize] = false;
        }
    }

    pub(super) fn apply(&mut self, constraints: &Constraints) {
        self.ignored_constraints = 0;
        let takes_load = |node: NodeId| self.takes_load.get(node.index()).is_some_and(|&takes| takes);
        self.outer_force_n.fill(DVec3::ZERO);
        for force in &constraints.forces {
            if takes_load(force.node) && force.force_n.is_finite() {
                self.outer_force_n[force.node.index()] += force.force_n;
            } else {
                self.ignored_constraints += 1;
            }
        }
        for held in &self.held {
            // A node that is let go keeps its velocity.
            self.moves[held.node as usize] = true;
        }
        self.held.clear();
        for (place, imposed) in constraints.displacements.iter().enumerate() {
            let usable = takes_load(imposed.node) && imposed.displacement_m.is_finite();
            if usable && self.held.len() < self.held.capacity() {
                let target_m = self.rest_m[imposed.node.index()] + imposed.displacement_m;
                let (place, node) = (place as u32, imposed.node.0);
                self.held.push(Held { place, node, start_m: target_m, target_m });
            } else {
                self.ignored_constraints += 1;
            }
        }
        self.update_moves();
        // Room was made for every node; more is a list with repetitions.
        self.constraint_forces_n.clear();
        self.constraint_forces_n.resize(constraints.displacements.len(), DVec3::ZERO);
    }

    /// Advances by `dt_s` in the fewest equal parts that are not longer than the time step and the stable step.
    pub(super) fn step(&mut self, dt_s: f64, forces: &mut impl InternalForces) {
        if !(dt_s.is_finite() && dt_s > 0.0) {
            return;
        }
        let n_parts = self.parts_of_step(dt_s);
        // Only a step of more than the most parts is cut off.
        let h_s = (dt_s / n_parts as f64).min(self.time_step_s);
        for held in &mut self.held {
            held.start_m = self.positions_m[held.node as usize];
        }
        for part in 1..=n_parts {
            let share = part as f64 / n_parts as f64;
            for held in &self.held {
                let n = held.node as usize;
                let at_m =
                    if part == n_parts { held.target_m } else { held.start_m.lerp(held.target_m, share) };
                self.velocities_m_per_s[n] = (at_m - self.positions_m[n]) / h_s;
                self.positions_m[n] = at_m;
            }
            let mut equations = Newton {
                forces,
                force_n: &mut self.force_n,
                outer_force_n: &self.outer_force_n,
                mass_kg: &self.mass_kg,
                inertia_kg: &self.inertia_kg,
                gravity_m_per_s2: self.gravity_m_per_s2,
            };
            let mut motion = Motion {
                positions_m: &mut self.positions_m,
                velocities_m_per_s: &mut self.velocities_m_per_s,
                moves: &self.moves,
                damping_per_s: &self.node_damping_per_s,
            };
            let effort = self.integrator.step(&mut equations, &mut motion, h_s);
            self.missed_fixed_points += u64::from(effort.missed_fixed_point);
        }
        for held in &self.held {
            self.constraint_forces_n[held.place as usize] = -self.force_n[held.node as usize];
        }
    }

    pub(super) fn state(&self) -> ModelState<'_> {
        ModelState {
            positions_m: &self.positions_m,
            velocities_m_per_s: &self.velocities_m_per_s,
            history: self.integrator.history(),
        }
    }

    pub(super) fn constraint_forces_n(&self) -> &[DVec3] {
        &self.constraint_forces_n
    }

    pub(super) fn take_over(&mut self, positions_m: &[DVec3]) {
        assert_eq!(positions_m.len(), self.rest_m.len(), "one position a node");
        for (n, &position_m) in positions_m.iter().enumerate() {
            self.positions_m[n] = if self.is_fixed[n] { self.rest_m[n] } else { position_m };
        }
        self.velocities_m_per_s.fill(DVec3::ZERO);
        self.constraint_forces_n.fill(DVec3::ZERO);
        self.integrator.restart();
    }

    /// Sets the velocities of nodes that move freely [m/s].
    pub(super) fn set_velocities(&mut self, velocities_m_per_s: &[DVec3]) {
        for (n, &v) in velocities_m_per_s.iter().enumerate() {
            if self.moves[n] {
                self.velocities_m_per_s[n] = v;
            }
        }
        self.integrator.restart();
    }

    /// Kinetic energy 1/2 sum inertia v^2 [J].
    pub(super) fn kinetic_energy_j(&self) -> f64 {
        let of_node = |(m, v): (&f64, &DVec3)| 0.5 * m * v.length_squared();
        self.inertia_kg.iter().zip(&self.velocities_m_per_s).map(of_node).sum()
    }

    /// Drops dead nodes after a compaction. Constraints are dropped with their node numbers.
    pub(super) fn compact(&mut self, change: &TopologyChange) {
        let stays: Vec<bool> = change.nodes.new_ids.iter().map(Option::is_some).collect();
        keep(&mut self.rest_m, &stays);
        keep(&mut self.is_fixed, &stays);
        keep(&mut self.mass_kg, &stays);
        keep(&mut self.inertia_kg, &stays);
        keep(&mut self.takes_load, &stays);
        keep(&mut self.moves, &stays);
        keep(&mut self.node_damping_per_s, &stays);
        keep(&mut self.positions_m, &stays);
        keep(&mut self.velocities_m_per_s, &stays);
        keep(&mut self.force_n, &stays);
        keep(&mut self.outer_force_n, &stays);
        self.outer_force_n.fill(DVec3::ZERO);
        self.held.clear();
        self.constraint_forces_n.clear();
        self.update_moves();
        let history = self.integrator.history().to_vec();
        let n_before = stays.len();
        let n_after = self.rest_m.len();
        self.integrator.resize(n_after);
        // History: ages of three numbers a node, and one number at the end.
        let mut kept: Vec<f64> = history[..history.len() - 1]
            .chunks_exact(3)
            .enumerate()
            .filter(|(at, _)| stays[at % n_before])
            .flat_map(|(_, xyz)| xyz.iter().copied())
            .collect();
        kept.extend(history.last());
        self.integrator.set_history(&kept);
    }
}

/// Keeps the values whose flag is set.
pub(super) fn keep<T>(values: &mut Vec<T>, stays: &[bool]) {
    let mut flags = stays.iter();
    values.retain(|_| *flags.next().expect("one flag a value"));
}

/// a = (link forces + outer forces)/inertia + (mass/inertia) gravity. `force_n` keeps the sum of the forces.
struct Newton<'a, F> {
    forces: &'a mut F,
    force_n: &'a mut [DVec3],
    outer_force_n: &'a [DVec3],
    mass_kg: &'a [f64],
    inertia_kg: &'a [f64],
    gravity_m_per_s2: DVec3,
}

impl<F: InternalForces> EquationsOfMotion for Newton<'_, F> {
    fn accelerations_into(
        &mut self,
        positions_m: &[DVec3],
        velocities_m_per_s: &[DVec3],
        accelerations_m_per_s2: &mut [DVec3],
    ) {
        for n in 0..self.force_n.len() {
            self.force_n[n] = self.outer_force_n[n] + self.mass_kg[n] * self.gravity_m_per_s2;
        }
        self.forces.add_forces(positions_m, velocities_m_per_s, self.force_n);
        for n in 0..self.force_n.len() {
            let inertia_kg = self.inertia_kg[n];
            accelerations_m_per_s2[n] =
                if inertia_kg > 0.0 { self.force_n[n] / inertia_kg } else { DVec3::ZERO };
        }
    }
}
