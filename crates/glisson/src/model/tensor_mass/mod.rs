//! The linear tensor-mass model (seed `003` ch. 3): explicit dynamics on vertices and edges.
//!
//! M u'' + C u' + K u = F with lumped mass m_i = sum rho V/4 over the node's tetrahedra and damping
//! C = d M. K lives as tensors on vertices and edges, accumulated from the tetrahedra; the force that balances
//! the deformation is f_p = B^pp u_p + sum over edges B^pj u_j.
//!
//! Central differences with step h (eq. 3.3). The report writes the damping into its eq. 3.1 with the sign of
//! a driving force; with c_i = d m_i > 0 dissipative, and F_i the net force (outer force minus f_i), it is
//!
//! (m_i/h^2 + c_i/(2h)) u_i(t+h) = F_i + (2 m_i/h^2) u_i(t) - (m_i/h^2 - c_i/(2h)) u_i(t-h),
//!
//! evaluated as u(t+h) - u(t) = [ (1/h^2 - d/(2h)) (u(t) - u(t-h)) + F/m ] / (1/h^2 + d/(2h)), which loses
//! fewer digits. It is stable for h <= 2/omega_max whatever the damping ([`StableStep`]).
//!
//! Removing a tetrahedron subtracts its tensors and masses; what is left without a tetrahedron becomes
//! exactly zero.

mod removal;
mod stable;

pub use stable::{MOST_NODES_PROVEN, StableStep};

use super::{Constraints, DeformableModel, ModelState, TopologyRefusal};
use crate::material::LinearElastic;
use crate::math::{DMat3, DVec3};
use crate::mesh::edit::TopologyChange;
use crate::mesh::{NodeId, TetId, TetMesh};
use crate::solve::{MeshEdges, SolveError, StiffnessTensors};

/// Why there is no tensor-mass model.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TensorMassError {
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

/// What a tensor-mass model is made from.
#[derive(Clone, Copy, Debug)]
pub struct TensorMassParams<'a> {
    /// The body at rest.
    pub mesh: &'a TetMesh,
    /// Its material; the density makes the masses.
    pub material: &'a LinearElastic,
    /// Nodes that never move.
    pub fixed_nodes: &'a [NodeId],
    /// Damping over mass, d [1/s]: a free motion decays as exp(-d t/2).
    pub damping_per_s: f64,
    /// Gravity [m/s2]; zero where the rest shape already carries it.
    pub gravity_m_per_s2: DVec3,
    /// Largest internal step [s]; at most `step_s` of [`TensorMass::stable_step`].
    pub time_step_s: f64,
}

/// Three numbers padded to four, so that one load fetches them.
type Padded = [f64; 4];

fn padded(v: DVec3) -> Padded {
    [v.x, v.y, v.z, 0.0]
}

fn unpadded(v: &Padded) -> DVec3 {
    DVec3::new(v[0], v[1], v[2])
}

fn padded_columns(m: DMat3) -> [Padded; 3] {
    [padded(m.col(0)), padded(m.col(1)), padded(m.col(2))]
}

fn matrix(columns: &[Padded; 3]) -> DMat3 {
    DMat3::from_cols(unpadded(&columns[0]), unpadded(&columns[1]), unpadded(&columns[2]))
}

/// Where the edges of each lower node begin; edges ascend.
fn edge_starts(edges: &MeshEdges, n_nodes: usize) -> Vec<u32> {
    let mut starts = vec![0; n_nodes + 1];
    for edge in &edges.nodes {
        starts[edge[0].index() + 1] += 1;
    }
    for n in 0..n_nodes {
        starts[n + 1] += starts[n];
    }
    starts
}

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

/// One organ moved by explicit dynamics.
#[derive(Clone, Debug)]
pub struct TensorMass {
    material: LinearElastic,
    damping_per_s: f64,
    gravity_m_per_s2: DVec3,
    time_step_s: f64,
    stable: StableStep,
    is_cut: bool,
    rest_m: Vec<DVec3>,
    is_fixed: Vec<bool>,

    // Mechanics, changed by removals only.
    tet_nodes: Vec<[NodeId; 4]>,
    tet_is_live: Vec<bool>,
    edges: MeshEdges,
    /// First edge of each node that is the edge's lower node, and the end.
    edge_start: Vec<u32>,
    vertex_tensor: Vec<[Padded; 3]>,
    edge_tensor: Vec<[Padded; 3]>,
    vertex_tets: Vec<u32>,
    edge_tets: Vec<u32>,
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

/// A copy of the moving state, for [`TensorMass::restore`]. It holds for the same mesh and removals.
#[derive(Clone, Debug, PartialEq)]
pub struct TensorMassSnapshot {
    motion: Vec<Padded>,
    positions_m: Vec<DVec3>,
    velocities_m_per_s: Vec<DVec3>,
}

impl TensorMass {
    /// The largest steps for a mesh of a material, and the tetrahedron that limits them.
    ///
    /// # Errors
    /// [`SolveError`] for an unusable mesh.
    pub fn stable_step(mesh: &TetMesh, material: &LinearElastic) -> Result<StableStep, SolveError> {
        StableStep::of(mesh, material)
    }

    /// Accumulates masses and tensors. The mesh must be compact: every tetrahedron of it counts as live.
    ///
    /// # Errors
    /// [`TensorMassError`]: an unusable mesh, a step above the stable one, impossible damping or gravity.
    pub fn build(params: &TensorMassParams<'_>) -> Result<Self, TensorMassError> {
        let TensorMassParams { mesh, material, damping_per_s, gravity_m_per_s2, time_step_s, .. } = *params;
        let parameter = |what, found, allowed| Err(TensorMassError::Parameter { what, found, allowed });
        if !(damping_per_s.is_finite() && damping_per_s >= 0.0) {
            return parameter("damping [1/s]", damping_per_s, "a finite number from 0");
        }
        if !gravity_m_per_s2.is_finite() {
            return parameter("gravity [m/s2]", gravity_m_per_s2.length(), "finite numbers");
        }
        if !(time_step_s.is_finite() && time_step_s > 0.0) {
            return parameter("time step [s]", time_step_s, "a finite number above 0");
        }
        let edges = MeshEdges::of_mesh(mesh)?;
        let n_nodes = mesh.positions_m.len();
        if let Some(&node) = params.fixed_nodes.iter().find(|n| n.index() >= n_nodes) {
            return Err(SolveError::ConditionOutOfRange { node, n_nodes }.into());
        }
        let tensors = StiffnessTensors::assemble(mesh, &edges, material)?;
        let stable = StableStep::of(mesh, material)?;
        if time_step_s > stable.step_s {
            let (allowed_s, tet) = (stable.step_s, stable.tet);
            return Err(TensorMassError::UnstableStep { found_s: time_step_s, allowed_s, tet });
        }

        let mut is_fixed = vec![false; n_nodes];
        for node in params.fixed_nodes {
            is_fixed[node.index()] = true;
        }
        let mut mass_kg = vec![0.0; n_nodes];
        let mut vertex_tets = vec![0; n_nodes];
        let mut edge_tets = vec![0; edges.nodes.len()];
        for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
            let share_kg = material.density_kg_per_m3() * mesh.tet_volume_m3(TetId::from_index(t)) / 4.0;
            for node in nodes {
                mass_kg[node.index()] += share_kg;
                vertex_tets[node.index()] += 1;
            }
            for edge in edges.of_tet[t] {
                edge_tets[edge as usize] += 1;
            }
        }
        let mut model = Self {
            material: *material,
            damping_per_s,
            gravity_m_per_s2,
            time_step_s,
            stable,
            is_cut: false,
            rest_m: mesh.positions_m.clone(),
            is_fixed,
            tet_nodes: mesh.tetrahedra.clone(),
            tet_is_live: vec![true; mesh.tetrahedra.len()],
            vertex_tensor: tensors.vertex.into_iter().map(padded_columns).collect(),
            edge_tensor: tensors.edge.into_iter().map(padded_columns).collect(),
            edge_start: edge_starts(&edges, n_nodes),
            edges,
            vertex_tets,
            edge_tets,
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
            model.update_inverse_mass(n);
        }
        model.set_last_step_s(time_step_s);
        Ok(model)
    }

    fn update_inverse_mass(&mut self, n: usize) {
        let moves = self.vertex_tets[n] > 0 && !self.is_fixed[n];
        self.inverse_mass_per_kg[n] = if moves { 1.0 / self.mass_kg[n] } else { 0.0 };
    }

    fn n_nodes(&self) -> usize {
        self.rest_m.len()
    }

    fn last_step_s(&self) -> f64 {
        self.motion[2 * self.n_nodes()][0]
    }

    fn set_last_step_s(&mut self, h_s: f64) {
        let last = 2 * self.n_nodes();
        self.motion[last][0] = h_s;
    }

    /// Largest step [s] for which central differences are proven stable now: after the first removal the one
    /// that holds after any further ones.
    pub fn stable_step_s(&self) -> f64 {
        if self.is_cut { self.stable.after_cuts_s } else { self.stable.step_s }
    }

    /// Into how many equal parts a step of `dt_s` is divided now.
    pub fn parts_of_step(&self, dt_s: f64) -> u64 {
        let longest_s = self.time_step_s.min(self.stable_step_s());
        // A hair below the whole number: dt = k times the step gives k parts in spite of rounding.
        (dt_s / longest_s - 1e-9).ceil().clamp(1.0, MOST_PARTS) as u64
    }

    /// Largest internal step [s] asked for; a longer [`DeformableModel::step`] is divided into equal parts.
    pub fn time_step_s(&self) -> f64 {
        self.time_step_s
    }

    /// The material.
    pub fn material(&self) -> &LinearElastic {
        &self.material
    }

    /// Mass [kg] of a node.
    pub fn mass_kg(&self, node: NodeId) -> f64 {
        self.mass_kg[node.index()]
    }

    /// Tensor B^pp [N/m] of a node.
    pub fn vertex_tensor_n_per_m(&self, node: NodeId) -> DMat3 {
        matrix(&self.vertex_tensor[node.index()])
    }

    /// Edges (lower node first, ascending) with their tensors B^pj [N/m]; edges left without a tetrahedron are
    /// among them, with a zero tensor, until the mesh is compacted.
    pub fn edge_tensors_n_per_m(&self) -> impl Iterator<Item = ([NodeId; 2], DMat3)> + '_ {
        self.edges.nodes.iter().copied().zip(self.edge_tensor.iter().map(matrix))
    }

    /// Constraints of the last [`DeformableModel::apply`] that were left out: on nodes that do not exist, are
    /// fixed or have no tetrahedron, and values that are not finite.
    pub fn ignored_constraints(&self) -> usize {
        self.ignored_constraints
    }

    /// Back to the rest shape at standstill, without constraints. Removed tetrahedra stay removed.
    pub fn reset(&mut self) {
        let n = self.n_nodes();
        self.motion[..2 * n].fill([0.0; 4]);
        self.set_last_step_s(self.time_step_s);
        self.outer_forces.clear();
        self.held.clear();
        self.constraint_forces_n.clear();
        self.publish();
    }

    /// The moving state, to come back to.
    pub fn snapshot(&self) -> TensorMassSnapshot {
        TensorMassSnapshot {
            motion: self.motion.clone(),
            positions_m: self.positions_m.clone(),
            velocities_m_per_s: self.velocities_m_per_s.clone(),
        }
    }

    /// Comes back to a state of the same mesh and removals; constraints stay as they are.
    ///
    /// # Panics
    /// When the snapshot has another number of nodes.
    pub fn restore(&mut self, snapshot: &TensorMassSnapshot) {
        self.motion.copy_from_slice(&snapshot.motion);
        self.positions_m.copy_from_slice(&snapshot.positions_m);
        self.velocities_m_per_s.copy_from_slice(&snapshot.velocities_m_per_s);
    }

    /// Kinetic energy of the last half step plus elastic energy 1/2 u(t-h)^T K u(t) [J]: the scheme keeps it
    /// constant to rounding without damping, outer forces and gravity.
    pub fn energy_j(&self) -> f64 {
        let n = self.n_nodes();
        let u = |p: usize| unpadded(&self.motion[p]);
        let previous = |p: usize| unpadded(&self.motion[n + p]);
        let mut energy_j = 0.0;
        for p in 0..n {
            energy_j += 0.5 * self.mass_kg[p] * self.velocities_m_per_s[p].length_squared();
            energy_j += 0.5 * previous(p).dot(matrix(&self.vertex_tensor[p]) * u(p));
        }
        for (&[p, j], b) in self.edges.nodes.iter().zip(&self.edge_tensor) {
            let (p, j, b) = (p.index(), j.index(), matrix(b));
            energy_j += 0.5 * previous(p).dot(b * u(j)) + 0.5 * u(p).dot(b * previous(j));
        }
        energy_j
    }

    /// The force that balances deformation, gravity and outer forces on every node: K u - m g - F.
    ///
    /// Edges in their order, each once: the lower node's force is summed in registers over its edges, the
    /// higher node's in memory.
    fn balance_forces(&mut self) {
        let n = self.n_nodes();
        let u = &self.motion[..n];
        let force = &mut self.force_n[..n];
        let g = padded(self.gravity_m_per_s2);
        for (force, m) in force.iter_mut().zip(&self.mass_kg) {
            *force = g.map(|g| -m * g);
        }
        for p in 0..n {
            let (b, up) = (&self.vertex_tensor[p], &u[p]);
            let mut sum: Padded =
                std::array::from_fn(|i| b[0][i] * up[0] + b[1][i] * up[1] + b[2][i] * up[2]);
            let of_p = self.edge_start[p] as usize..self.edge_start[p + 1] as usize;
            for (&[_, j], b) in self.edges.nodes[of_p.clone()].iter().zip(&self.edge_tensor[of_p]) {
                let j = j.index();
                let uj = &u[j];
                for i in 0..4 {
                    sum[i] += b[0][i] * uj[0] + b[1][i] * uj[1] + b[2][i] * uj[2];
                }
                let fj = &mut force[j];
                for i in 0..3 {
                    fj[i] += b[i][0] * up[0] + b[i][1] * up[1] + b[i][2] * up[2];
                }
            }
            for i in 0..4 {
                force[p][i] += sum[i];
            }
        }
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
}

/// A step longer than this many parts is cut to it: the caller asked for minutes in one step.
const MOST_PARTS: f64 = 1e6;

impl DeformableModel for TensorMass {
    fn apply(&mut self, constraints: &Constraints) {
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

    /// Advances by `dt_s` in the fewest equal parts that are not longer than [`TensorMass::time_step_s`] and
    /// [`TensorMass::stable_step_s`].
    /// Held nodes move evenly to where they are held; the constraint force is the one that balances them at
    /// the last part: elastic force and weight, without the held node's own inertia.
    fn step(&mut self, dt_s: f64) {
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
            self.balance_forces();
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

    fn state(&self) -> ModelState<'_> {
        ModelState {
            positions_m: &self.positions_m,
            velocities_m_per_s: &self.velocities_m_per_s,
            history: self.motion.as_flattened(),
        }
    }

    fn constraint_forces_n(&self) -> &[DVec3] {
        &self.constraint_forces_n
    }

    fn take_over(&mut self, positions_m: &[DVec3]) {
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

    fn topology_changed(&mut self, _: &TetMesh, change: &TopologyChange) -> Result<(), TopologyRefusal> {
        self.follow(change)
    }
}
