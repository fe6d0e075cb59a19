//! Explicit dynamics of lumped masses, shared by the tensor-mass models: central differences, held nodes,
//! outer forces, snapshots. The model brings its elastic forces.
//!
//! M u'' + C u' + f(u) = F with lumped mass m_i = sum rho V/4 over the node's tetrahedra and damping C = d M
//! (seed `003`, eq. 3.1 to 3.3; seed `002`, eq. 11 and 12). The reports write the damping with the sign of a
//! driving force; with c_i = d m_i > 0 dissipative, and F_i the net force (outer force minus f_i), a step h is
//!
//! (m_i/h^2 + c_i/(2h)) u_i(t+h) = F_i + (2 m_i/h^2) u_i(t) - (m_i/h^2 - c_i/(2h)) u_i(t-h),
//!
//! evaluated as u(t+h) - u(t) = [ (1/h^2 - d/(2h)) (u(t) - u(t-h)) + F/m ] / (1/h^2 + d/(2h)), which loses
//! fewer digits. It is stable for h <= 2/omega_max whatever the damping ([`StableStep`]).

mod stable;

pub(super) use stable::StiffTet;
pub use stable::{MOST_NODES_PROVEN, StableStep};

use super::{Constraints, ModelState, TopologyRefusal};
use crate::math::DVec3;
use crate::mesh::edit::TopologyChange;
use crate::mesh::{NodeId, TetId, TetMesh};
use crate::solve::SolveError;

/// Why there is no model with explicit dynamics.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ExplicitError {
    /// The mesh is unusable.
    #[error(transparent)]
    Solve(#[from] SolveError),
    /// A step above the stable one.
    #[error(
        "time step {} ms is above the stable one: central differences allow at most {:.4} ms here, because of \
         tetrahedron {tet} (smallest ratio of size to wave speed). Take a smaller step, a coarser mesh or a softer \
         material",
        1e3 * found_s,
        1e3 * allowed_s
    )]
    UnstableStep {
        /// What was asked for [s].
        found_s: f64,
        /// The largest allowed step [s].
        allowed_s: f64,
        /// The tetrahedron that limits it.
        tet: TetId,
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

/// Three numbers padded to four, so that one load fetches them.
pub(super) type Padded = [f64; 4];

pub(super) fn padded(v: DVec3) -> Padded {
    [v.x, v.y, v.z, 0.0]
}

pub(super) fn unpadded(v: &Padded) -> DVec3 {
    DVec3::new(v[0], v[1], v[2])
}

/// A step longer than this many parts is cut to it: the caller asked for minutes in one step.
const MOST_PARTS: f64 = 1e6;

/// A node that a tool holds.
#[derive(Clone, Copy, Debug)]
struct Held {
    place: u32,
    node: u32,
    start_m: DVec3,
    target_m: DVec3,
    /// Displacement before the part of the step under way.
    before: Padded,
}

/// What the motion of a body is made from.
#[derive(Clone, Copy, Debug)]
pub(super) struct ExplicitParams<'a> {
    /// The body at rest; every tetrahedron counts.
    pub mesh: &'a TetMesh,
    /// Density [kg/m3].
    pub density_kg_per_m3: f64,
    /// Nodes that never move.
    pub fixed_nodes: &'a [NodeId],
    /// Damping over mass, d [1/s].
    pub damping_per_s: f64,
    /// Gravity [m/s2].
    pub gravity_m_per_s2: DVec3,
    /// Largest internal step [s].
    pub time_step_s: f64,
}

impl ExplicitParams<'_> {
    /// Checks everything but the mesh.
    ///
    /// # Errors
    /// [`ExplicitError::Parameter`] for impossible damping, gravity or step.
    pub(super) fn check(&self) -> Result<(), ExplicitError> {
        let parameter = |what, found, allowed| Err(ExplicitError::Parameter { what, found, allowed });
        if !(self.damping_per_s.is_finite() && self.damping_per_s >= 0.0) {
            return parameter("damping [1/s]", self.damping_per_s, "a finite number from 0");
        }
        if !self.gravity_m_per_s2.is_finite() {
            return parameter("gravity [m/s2]", self.gravity_m_per_s2.length(), "finite numbers");
        }
        if !(self.time_step_s.is_finite() && self.time_step_s > 0.0) {
            return parameter("time step [s]", self.time_step_s, "a finite number above 0");
        }
        Ok(())
    }
}

/// A copy of the moving state. It holds for the same mesh and removals.
#[derive(Clone, Debug, PartialEq)]
pub struct ExplicitSnapshot {
    motion: Vec<Padded>,
    positions_m: Vec<DVec3>,
    velocities_m_per_s: Vec<DVec3>,
}

/// Masses, displacements and constraints of one body.
#[derive(Clone, Debug)]
pub(super) struct ExplicitMotion {
    damping_per_s: f64,
    gravity_m_per_s2: DVec3,
    time_step_s: f64,
    stable: StableStep,
    is_cut: bool,
    density_kg_per_m3: f64,
    rest_m: Vec<DVec3>,
    is_fixed: Vec<bool>,
    /// Live tetrahedra at each node.
    node_tets: Vec<u32>,
    mass_kg: Vec<f64>,
    /// Zero for nodes that do not move: fixed ones and those without a tetrahedron.
    inverse_mass_per_kg: Vec<f64>,

    // State: displacements u(t), displacements u(t-h), and the last h in the first number of the last entry.
    motion: Vec<Padded>,
    positions_m: Vec<DVec3>,
    velocities_m_per_s: Vec<DVec3>,

    // Constraints and scratch.
    force_n: Vec<Padded>,
    outer_forces: Vec<(u32, DVec3)>,
    held: Vec<Held>,
    constraint_forces_n: Vec<DVec3>,
    ignored_constraints: usize,
}

impl ExplicitMotion {
    /// Accumulates the masses; at rest.
    ///
    /// # Errors
    /// [`ExplicitError`]: impossible parameters, a fixed node that does not exist, a step above the stable one.
    pub(super) fn new(params: &ExplicitParams<'_>, stable: StableStep) -> Result<Self, ExplicitError> {
        let ExplicitParams { mesh, density_kg_per_m3, damping_per_s, gravity_m_per_s2, time_step_s, .. } =
            *params;
        params.check()?;
        let n_nodes = mesh.positions_m.len();
        if let Some(&node) = params.fixed_nodes.iter().find(|n| n.index() >= n_nodes) {
            return Err(SolveError::ConditionOutOfRange { node, n_nodes }.into());
        }
        if time_step_s > stable.step_s {
            let (allowed_s, tet) = (stable.step_s, stable.tet);
            return Err(ExplicitError::UnstableStep { found_s: time_step_s, allowed_s, tet });
        }
        let mut is_fixed = vec![false; n_nodes];
        for node in params.fixed_nodes {
            is_fixed[node.index()] = true;
        }
        let mut mass_kg = vec![0.0; n_nodes];
        let mut node_tets = vec![0; n_nodes];
        for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
            let share_kg = density_kg_per_m3 * mesh.tet_volume_m3(TetId::from_index(t)) / 4.0;
            for node in nodes {
                mass_kg[node.index()] += share_kg;
                node_tets[node.index()] += 1;
            }
        }
        let mut motion = Self {
            damping_per_s,
            gravity_m_per_s2,
            time_step_s,
            stable,
            is_cut: false,
            density_kg_per_m3,
            rest_m: mesh.positions_m.clone(),
            is_fixed,
            node_tets,
            mass_kg,
            inverse_mass_per_kg: vec![0.0; n_nodes],
            motion: vec![[0.0; 4]; 2 * n_nodes + 1],
            positions_m: mesh.positions_m.clone(),
            velocities_m_per_s: vec![DVec3::ZERO; n_nodes],
            force_n: vec![[0.0; 4]; n_nodes],
            outer_forces: Vec::with_capacity(n_nodes),
            held: Vec::with_capacity(n_nodes),
            constraint_forces_n: Vec::with_capacity(n_nodes),
            ignored_constraints: 0,
        };
        for n in 0..n_nodes {
            motion.update_inverse_mass(n);
        }
        motion.set_last_step_s(time_step_s);
        Ok(motion)
    }

    fn update_inverse_mass(&mut self, n: usize) {
        let moves = self.node_tets[n] > 0 && !self.is_fixed[n];
        self.inverse_mass_per_kg[n] = if moves { 1.0 / self.mass_kg[n] } else { 0.0 };
    }

    pub(super) fn n_nodes(&self) -> usize {
        self.rest_m.len()
    }

    pub(super) fn rest_m(&self, node: NodeId) -> DVec3 {
        self.rest_m[node.index()]
    }

    pub(super) fn mass_kg(&self, node: NodeId) -> f64 {
        self.mass_kg[node.index()]
    }

    pub(super) fn has_tets(&self, node: NodeId) -> bool {
        self.node_tets[node.index()] > 0
    }

    pub(super) fn time_step_s(&self) -> f64 {
        self.time_step_s
    }

    pub(super) fn ignored_constraints(&self) -> usize {
        self.ignored_constraints
    }

    /// Displacements u(t) [m].
    pub(super) fn displacements(&self) -> &[Padded] {
        &self.motion[..self.n_nodes()]
    }

    /// Displacements u(t-h) [m].
    pub(super) fn previous_displacements(&self) -> &[Padded] {
        &self.motion[self.n_nodes()..2 * self.n_nodes()]
    }

    fn last_step_s(&self) -> f64 {
        self.motion[2 * self.n_nodes()][0]
    }

    fn set_last_step_s(&mut self, h_s: f64) {
        let last = 2 * self.n_nodes();
        self.motion[last][0] = h_s;
    }

    pub(super) fn stable_step_s(&self) -> f64 {
        if self.is_cut { self.stable.after_cuts_s } else { self.stable.step_s }
    }

    pub(super) fn parts_of_step(&self, dt_s: f64) -> u64 {
        let longest_s = self.time_step_s.min(self.stable_step_s());
        // A hair below the whole number: dt = k times the step gives k parts in spite of rounding.
        (dt_s / longest_s - 1e-9).ceil().clamp(1.0, MOST_PARTS) as u64
    }

    pub(super) fn reset(&mut self) {
        let n = self.n_nodes();
        self.motion[..2 * n].fill([0.0; 4]);
        self.set_last_step_s(self.time_step_s);
        self.outer_forces.clear();
        self.held.clear();
        self.constraint_forces_n.clear();
        self.publish();
    }

    pub(super) fn snapshot(&self) -> ExplicitSnapshot {
        ExplicitSnapshot {
            motion: self.motion.clone(),
            positions_m: self.positions_m.clone(),
            velocities_m_per_s: self.velocities_m_per_s.clone(),
        }
    }

    pub(super) fn restore(&mut self, snapshot: &ExplicitSnapshot) {
        self.motion.copy_from_slice(&snapshot.motion);
        self.positions_m.copy_from_slice(&snapshot.positions_m);
        self.velocities_m_per_s.copy_from_slice(&snapshot.velocities_m_per_s);
    }

    /// Kinetic energy of the last half step [J].
    pub(super) fn kinetic_energy_j(&self) -> f64 {
        let of_node = |(m, v): (&f64, &DVec3)| 0.5 * m * v.length_squared();
        self.mass_kg.iter().zip(&self.velocities_m_per_s).map(of_node).sum()
    }

    /// The force that balances deformation, gravity and outer forces on every node: f(u) - m g - F.
    fn balance_forces(&mut self, add_elastic: &mut impl FnMut(&[Padded], &mut [Padded])) {
        let n = self.n_nodes();
        let force = &mut self.force_n[..n];
        let g = padded(self.gravity_m_per_s2);
        for (force, m) in force.iter_mut().zip(&self.mass_kg) {
            *force = g.map(|g| -m * g);
        }
        add_elastic(&self.motion[..n], force);
        for &(p, outer_n) in &self.outer_forces {
            let f = &mut force[p as usize];
            for i in 0..3 {
                f[i] -= outer_n[i];
            }
        }
    }

    /// One step of central differences for every node; nodes of infinite mass keep their velocity, which is
    /// zero for fixed ones.
    fn integrate(&mut self, h_s: f64) {
        let n = self.n_nodes();
        let (now, rest) = self.motion.split_at_mut(n);
        let previous = &mut rest[..n];
        let inertia = 1.0 / (h_s * h_s);
        let damping = 0.5 * self.damping_per_s / h_s;
        let scale = 1.0 / (inertia + damping);
        for p in 0..n {
            let inverse_mass = self.inverse_mass_per_kg[p];
            for i in 0..4 {
                let before = now[p][i] - previous[p][i];
                let change = ((inertia - damping) * before - inverse_mass * self.force_n[p][i]) * scale;
                previous[p][i] = now[p][i];
                now[p][i] += change;
            }
        }
    }

    /// Another length of step: the velocity stays, and with it u(t-h).
    fn change_step(&mut self, h_s: f64) {
        let n = self.n_nodes();
        let ratio = h_s / self.last_step_s();
        let (now, rest) = self.motion.split_at_mut(n);
        for (now, previous) in now.iter().zip(rest) {
            for i in 0..4 {
                previous[i] = now[i] - (now[i] - previous[i]) * ratio;
            }
        }
        self.set_last_step_s(h_s);
    }

    /// Positions and velocities from the displacements.
    fn publish(&mut self) {
        let n = self.n_nodes();
        let per_step = 1.0 / self.last_step_s();
        for p in 0..n {
            let (now, previous) = (unpadded(&self.motion[p]), unpadded(&self.motion[n + p]));
            self.positions_m[p] = self.rest_m[p] + now;
            self.velocities_m_per_s[p] = (now - previous) * per_step;
        }
    }

    fn takes_load(&self, node: NodeId) -> bool {
        self.inverse_mass_per_kg.get(node.index()).is_some_and(|&w| w > 0.0)
    }

    pub(super) fn apply(&mut self, constraints: &Constraints) {
        self.ignored_constraints = 0;
        self.outer_forces.clear();
        for force in &constraints.forces {
            let usable = self.takes_load(force.node) && force.force_n.is_finite();
            if usable && self.outer_forces.len() < self.outer_forces.capacity() {
                self.outer_forces.push((force.node.0, force.force_n));
            } else {
                self.ignored_constraints += 1;
            }
        }
        self.held.clear();
        for (place, imposed) in constraints.displacements.iter().enumerate() {
            let usable = self.takes_load(imposed.node) && imposed.displacement_m.is_finite();
            if usable && self.held.len() < self.held.capacity() {
                self.held.push(Held {
                    place: place as u32,
                    node: imposed.node.0,
                    start_m: DVec3::ZERO,
                    target_m: imposed.displacement_m,
                    before: [0.0; 4],
                });
            } else {
                self.ignored_constraints += 1;
            }
        }
        // Room was made for every node; more is a list with repetitions.
        self.constraint_forces_n.clear();
        self.constraint_forces_n.resize(constraints.displacements.len(), DVec3::ZERO);
    }

    /// Advances by `dt_s` in the fewest equal parts that are not longer than the time step and the stable step.
    /// `add_elastic(u, f)` adds the forces that balance the displacements u.
    /// Held nodes move evenly to where they are held; the constraint force is the one that balances them at
    /// the last part: elastic force and weight, without the held node's own inertia.
    pub(super) fn step(&mut self, dt_s: f64, mut add_elastic: impl FnMut(&[Padded], &mut [Padded])) {
        if !(dt_s.is_finite() && dt_s > 0.0) {
            return;
        }
        let n_parts = self.parts_of_step(dt_s);
        let parts = n_parts as f64;
        // Only a step of more than the most parts is cut off.
        let h_s = (dt_s / parts).min(self.time_step_s);
        if h_s != self.last_step_s() {
            self.change_step(h_s);
        }
        let n = self.n_nodes();
        for held in &mut self.held {
            held.start_m = unpadded(&self.motion[held.node as usize]);
        }
        for part in 1..=n_parts {
            let share = part as f64 / parts;
            for held in &mut self.held {
                let at_m =
                    if part == n_parts { held.target_m } else { held.start_m.lerp(held.target_m, share) };
                let at = &mut self.motion[held.node as usize];
                held.before = *at;
                *at = padded(at_m);
            }
            self.balance_forces(&mut add_elastic);
            self.integrate(h_s);
            // Held nodes do not follow their forces: they stay where they are, with the velocity of the tool.
            for held in &self.held {
                let p = held.node as usize;
                self.constraint_forces_n[held.place as usize] = unpadded(&self.force_n[p]);
                self.motion[p] = self.motion[n + p];
                self.motion[n + p] = held.before;
            }
        }
        self.publish();
    }

    pub(super) fn state(&self) -> ModelState<'_> {
        ModelState {
            positions_m: &self.positions_m,
            velocities_m_per_s: &self.velocities_m_per_s,
            history: self.motion.as_flattened(),
        }
    }

    pub(super) fn constraint_forces_n(&self) -> &[DVec3] {
        &self.constraint_forces_n
    }

    pub(super) fn take_over(&mut self, positions_m: &[DVec3]) {
        let n = self.n_nodes();
        assert_eq!(positions_m.len(), n, "one position a node");
        for p in 0..n {
            let u_m = if self.is_fixed[p] { DVec3::ZERO } else { positions_m[p] - self.rest_m[p] };
            self.motion[p] = padded(u_m);
            self.motion[n + p] = padded(u_m);
        }
        self.constraint_forces_n.fill(DVec3::ZERO);
        self.publish();
    }

    /// Takes the masses of one tetrahedron out, and the constraints on nodes that it leaves alone, which stay
    /// where they are.
    pub(super) fn remove_tet(&mut self, nodes: [NodeId; 4], volume_m3: f64) {
        self.is_cut = true;
        let share_kg = self.density_kg_per_m3 * volume_m3 / 4.0;
        let n_nodes = self.n_nodes();
        for n in nodes.map(NodeId::index) {
            self.node_tets[n] -= 1;
            if self.node_tets[n] == 0 {
                self.mass_kg[n] = 0.0;
                self.motion[n_nodes + n] = self.motion[n];
            } else {
                self.mass_kg[n] -= share_kg;
            }
            self.update_inverse_mass(n);
        }
        // A held node that lost its last tetrahedron has nothing to pull on.
        let inverse_mass_per_kg = &self.inverse_mass_per_kg;
        self.held.retain(|held| inverse_mass_per_kg[held.node as usize] > 0.0);
        self.outer_forces.retain(|(node, _)| inverse_mass_per_kg[*node as usize] > 0.0);
    }

    /// Drops nodes without a new id; the order of the others stays. Constraints are dropped with their node
    /// numbers.
    pub(super) fn compact(&mut self, new_ids: &[Option<NodeId>]) {
        let stays: Vec<bool> = new_ids.iter().map(Option::is_some).collect();
        let h_s = self.last_step_s();
        let stays_twice: Vec<bool> = stays.iter().chain(&stays).copied().collect();
        self.motion.pop();
        keep(&mut self.motion, &stays_twice);
        self.motion.push([0.0; 4]);
        keep(&mut self.rest_m, &stays);
        keep(&mut self.is_fixed, &stays);
        keep(&mut self.node_tets, &stays);
        keep(&mut self.mass_kg, &stays);
        keep(&mut self.inverse_mass_per_kg, &stays);
        keep(&mut self.positions_m, &stays);
        keep(&mut self.velocities_m_per_s, &stays);
        keep(&mut self.force_n, &stays);
        self.set_last_step_s(h_s);
        self.held.clear();
        self.outer_forces.clear();
        self.constraint_forces_n.clear();
    }
}

/// Keeps the values whose flag is set, in their order.
pub(super) fn keep<T>(values: &mut Vec<T>, stays: &[bool]) {
    let mut flags = stays.iter();
    values.retain(|_| *flags.next().expect("one flag a value"));
}

/// The new number of each entity that stays, when those that do not are dropped; any number for these.
pub(super) fn renumbered(stays: &[bool]) -> Vec<u32> {
    let mut n_kept = 0;
    let new_number = |&stays: &bool| {
        n_kept += u32::from(stays);
        n_kept.wrapping_sub(1)
    };
    stays.iter().map(new_number).collect()
}

/// Whether a change is one that models with accumulated stiffness follow: removals and compactions.
///
/// # Errors
/// [`TopologyRefusal::Frozen`] for new or moved nodes and new tetrahedra.
pub(super) fn follows(model: &'static str, change: &TopologyChange) -> Result<(), TopologyRefusal> {
    if change.tets.added.ids().is_empty()
        && change.nodes.added.ids().is_empty()
        && change.moved_nodes.is_empty()
    {
        return Ok(());
    }
    Err(TopologyRefusal::Frozen {
        model,
        reason: "it follows removals of tetrahedra and compactions; build it anew on a mesh with new or moved \
                 nodes",
    })
}
