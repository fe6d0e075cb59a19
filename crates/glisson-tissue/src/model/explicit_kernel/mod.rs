//! Explicit dynamics on the fast kernel: the physics of the tensor-mass models, on all cores that are lent.
//!
//! Central differences as in [`super::tensor_mass`], with the elastic forces of [`super::kernel`]; supports along
//! single axes, ligaments, Rayleigh damping. A step gives the same bits for any number of threads.
//!
//! Watched in each internal step:
//! - A node whose new place is not finite stays where it was, at standstill ([`ModelReport::n_recovered_nodes`]).
//! - Kinetic energy. The scheme's kinetic energy of half steps grows by exactly the work of all forces along half
//!   of both increments. What the outer forces do is summed with the step; the elastic forces can give at most
//!   the energy that they hold, and the whole body holds at most W_max at the largest stretch that the step is made
//!   for. A growth of more than both comes from a step that is not stable there; the increments are then scaled
//!   so that the kinetic energy is no more than W_max (or than before, if that was more) and the outer work
//!   ([`ModelReport::energy_was_limited`]). W_max = sum V (9/2 lambda + 3 mu) e^2 with e = (s^2 - 1)/2 is St
//!   Venant-Kirchhoff's largest for principal stretches within [1/s, s].
//! - Speed, where a tetrahedron is strained beyond what the step is made for: one that hangs by a node can gather what the
//!   whole body may hold. Tissue that is driven by its own elasticity is not much faster than waves run through it, and
//!   increments are shortened to three times that of the fastest wave at the largest stretch (told as a limited energy).
//!
//! - Tetrahedra: inverted ones and those whose stress is not finite are counted
//!   ([`ModelReport::n_quarantined_tets`]). They are left out where the law gives no number; laws that are finite in
//!   every shape go on in them: leaving them out would make energy from nothing.
//!
//! Where a tetrahedron is near to inversion, torn apart or stretched beyond what the step is made for, or the energy was
//! limited, the next steps are divided into as many internal ones as the body allows: its law is stiffer there. A
//! linear law is as stiff at any strain.
//!
//! What is left without a tetrahedron stays where it is. New tetrahedra come into spare lanes of the kernel, which is laid out anew
//! when half as many have come in as there were. An edit goes over all tetrahedra, to find the step that the body bears now.

mod correction;
mod loads;
mod local;
mod params;
mod piece;
mod stability;
mod topology;
mod undo;
pub(super) mod row;

use std::sync::Arc;

use self::loads::Loads;
use self::stability::Stability;
use super::bounded_vec::BoundedVec;
use super::explicit::{ExplicitDynamics, Mover};
use super::kernel::{ExplicitStep, FastKernel, KernelLaw, Quarantine};
use super::topology_update::TopologyUpdate;
use super::{
    Constraints, Correction, DeformableModel, ModelReport, ModelState, ModelUndo, NodalForce, Rayleigh,
    TopologyRefusal,
};
use crate::workers::SharedWorkers;
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};

pub use super::explicit::{ExplicitError, StableStep};
use params::Substance;
pub use params::{DEFAULT_LARGEST_STRETCH, ExplicitKernelError, ExplicitKernelParams};

/// Scene name.
const NAME: &str = "explicit";

/// The kinetic energy is not held against less than the elastic energy at this stretch.
const LEAST_ENERGY_STRETCH: f64 = 1.1;
/// Steps that stay divided after the tissue was strained beyond what the step is made for: some vibrations of a
/// tetrahedron.
const CAREFUL_STEPS: u32 = 50;
/// Parts of divided steps that are no longer than this share of the stable step are enough for the stable neo-Hookean law: a
/// choice. A tetrahedron that is flattened to half its height bears half of it. Other laws stiffen more when they are stretched.
const CAREFUL_SHARE: f64 = 1.0 / 3.0;
/// A strained body's nodes are not let go faster than so many times its fastest wave: a choice; snapping through, tissue
/// that turned inside out was seen at up to twice that.
const MOST_WAVE_SPEEDS: f64 = 3.0;
/// A step longer than this many parts is cut to it: the caller asked for minutes in one step.
const MOST_PARTS: f64 = 1e6;

/// A law that is finite in every shape goes on in inverted tetrahedra.
fn quarantine_of(law: KernelLaw) -> Quarantine {
    match law {
        KernelLaw::Linear | KernelLaw::StableNeoHooke => Quarantine::NotFinite,
        KernelLaw::StVenantKirchhoff | KernelLaw::NeoHookeLog | KernelLaw::General => Quarantine::Inverted,
    }
}

/// A node that a tool holds.
#[derive(Clone, Copy, Debug)]
struct Held {
    place: usize,
    node: NodeId,
    start_m: DVec3,
    target_m: DVec3,
    /// Its last increment [m]: the velocity with which it is let go.
    moved_m: DVec3,
}

/// A copy of the moving state. It holds for the same mesh and removals.
#[derive(Clone, Debug, PartialEq)]
pub struct ExplicitKernelSnapshot {
    history: Vec<f64>,
    positions_m: Vec<DVec3>,
    velocities_m_per_s: Vec<DVec3>,
}

/// One organ moved by explicit dynamics on the fast kernel.
///
/// ```
/// use glisson_tissue::material::LinearElastic;
/// use glisson_mesh::math::DVec3;
/// use glisson_mesh::mesh::{NodeId, TetMesh};
/// use glisson_tissue::model::explicit_kernel::{ExplicitKernel, ExplicitKernelParams};
/// use glisson_tissue::model::kernel::KernelLaw;
/// use glisson_tissue::model::{DeformableModel, DynamicBody};
/// let mesh = TetMesh {
///     positions_m: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z],
///     tetrahedra: vec![[0, 1, 2, 3].map(NodeId)],
///     ..TetMesh::default()
/// };
/// let liver = LinearElastic::from_young_poisson(5000.0, 0.45, 1060.0)?;
/// let gravity_m_per_s2 = DVec3::new(0.0, 0.0, -9.81);
/// let body = DynamicBody { gravity_m_per_s2, ..DynamicBody::new(&mesh, 1060.0) };
/// let law = KernelLaw::StVenantKirchhoff;
/// let mut model = ExplicitKernel::build(&ExplicitKernelParams::new(body, law, &[liver]))?;
/// for _ in 0..100 {
///     model.step(1e-3);
/// }
/// // A free body falls without deformation: h^2 g n (n + 1)/2.
/// assert!((model.state().positions_m[0].z + 9.81e-6 * 5050.0).abs() < 1e-12);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone)]
pub struct ExplicitKernel {
    kernel: FastKernel,
    workers: SharedWorkers,

    // What the kernel is made from, for compactions.
    rest: TetMesh,
    substance: Substance,
    /// Axes of each node that do not move.
    supports: Vec<[bool; 3]>,

    damping: Rayleigh,
    time_step_s: f64,
    stability: Stability,
    is_cut: bool,
    /// Whether strain makes it stiffer.
    stiffens: bool,
    most_elastic_j: f64,
    most_parts: u32,
    /// The stretch that the stable step is made for.
    made_for_stretch: f64,
    /// Steps that are still divided as far as allowed, because the tissue was strained beyond what the step is for.
    careful_steps: u32,

    loads: Loads,
    held: BoundedVec<Held>,
    constraint_forces_n: BoundedVec<DVec3>,
    report: ModelReport,

    // State, with that of the kernel.
    displacements_m: Vec<DVec3>,
    positions_m: Vec<DVec3>,
    velocities_m_per_s: Vec<DVec3>,
}

impl std::fmt::Debug for ExplicitKernel {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ExplicitKernel")
            .field("kernel", &self.kernel)
            .field("time_step_s", &self.time_step_s)
            .field("report", &self.report)
            .finish_non_exhaustive()
    }
}

impl ExplicitKernel {
    /// The largest steps, and the tetrahedron that limits them; the time step plays no part in them.
    ///
    /// # Errors
    /// [`ExplicitKernelError`] of [`ExplicitKernel::build`], but for a step above the stable one.
    pub fn stable_step(params: &ExplicitKernelParams<'_>) -> Result<StableStep, ExplicitKernelError> {
        let (_, _, stability) = Self::parts(params)?;
        Ok(stability.step)
    }

    fn parts(
        params: &ExplicitKernelParams<'_>,
    ) -> Result<(FastKernel, Substance, Stability), ExplicitKernelError> {
        params.check()?;
        let substance = Substance::of(params)?;
        let mut kernel = substance.kernel(params.body.mesh, params.law, params.path)?;
        kernel.set_quarantine(quarantine_of(params.law));
        Ok((kernel, substance, Stability::of(params)?))
    }

    /// The body at rest. Every tetrahedron of the mesh counts as live.
    ///
    /// # Errors
    /// [`ExplicitKernelError`]: an unusable mesh, a wrong number of materials, a step above the stable one,
    /// impossible numbers, a support or ligament on a node that does not exist, a wrong number of rest stresses.
    pub fn build(params: &ExplicitKernelParams<'_>) -> Result<Self, ExplicitKernelError> {
        let (mut kernel, substance, stability) = Self::parts(params)?;
        let body = &params.body;
        let (mesh, time_step_s) = (body.mesh, body.time_step_s);
        let StableStep { step_s: allowed_s, tet, .. } = stability.step;
        if time_step_s > allowed_s {
            return Err(ExplicitError::UnstableStep { found_s: time_step_s, allowed_s, tet }.into());
        }
        kernel.set_stiffness_damping(body.damping.stiffness_s);
        let n_nodes = mesh.positions_m.len();
        let mut supports = vec![[false; 3]; n_nodes];
        for fixed in body.fixed {
            let axes = &mut supports[fixed.node.index()];
            *axes = [0, 1, 2].map(|i| axes[i] || fixed.axes[i]);
        }
        let made_for_stretch = params.largest_stretch.max(LEAST_ENERGY_STRETCH);
        let strain = 0.5 * (made_for_stretch * made_for_stretch - 1.0);
        let most_elastic_j = (0..mesh.tetrahedra.len())
            .map(TetId::from_index)
            .map(|tet| {
                let material = params.material(tet);
                let modulus_pa = 4.5 * material.lambda_pa().max(0.0) + 3.0 * material.mu_pa();
                mesh.tet_volume_m3(tet) * modulus_pa * strain * strain
            })
            .sum();
        let mut model = Self {
            kernel,
            workers: Arc::clone(&params.workers),
            rest: mesh.clone(),
            substance,
            supports,
            damping: body.damping,
            time_step_s,
            stability,
            is_cut: false,
            stiffens: params.law != KernelLaw::Linear || params.volume_penalty_pa > 0.0,
            most_elastic_j,
            most_parts: body.most_parts,
            made_for_stretch,
            careful_steps: 0,
            loads: Loads::new(body.gravity_m_per_s2, body.attachments, &mesh.positions_m),
            held: BoundedVec::with_capacity(n_nodes),
            constraint_forces_n: BoundedVec::with_capacity(n_nodes),
            report: ModelReport::default(),
            displacements_m: vec![DVec3::ZERO; n_nodes],
            positions_m: mesh.positions_m.clone(),
            velocities_m_per_s: vec![DVec3::ZERO; n_nodes],
        };
        model.hold_supports();
        model.loads.refresh_all(&mut model.kernel);
        if params.expects_edits {
            model.stability.measure(&model.rest, &model.substance, &model.kernel);
        }
        model.publish();
        Ok(model)
    }

    fn hold_supports(&mut self) {
        for (n, &axes) in self.supports.iter().enumerate() {
            if axes != [false; 3] {
                self.kernel.hold_axes(NodeId::from_index(n), axes);
            }
        }
    }

    /// Who computes from now on, with the same bits.
    pub fn set_workers(&mut self, workers: SharedWorkers) {
        self.workers = workers;
    }

    /// The kernel: its law, memory, masses and forces.
    pub fn kernel(&self) -> &FastKernel {
        &self.kernel
    }

    /// Largest internal step [s] asked for; a longer [`DeformableModel::step`] is divided into equal parts.
    pub fn time_step_s(&self) -> f64 {
        self.time_step_s
    }

    /// Largest step [s] that is stable now.
    pub fn stable_step_s(&self) -> f64 {
        if self.is_cut { self.stability.cut_s } else { self.stability.step.step_s }
    }

    /// Into how many equal parts a step of `dt_s` is divided now.
    pub fn parts_of_step(&self, dt_s: f64) -> u64 {
        let longest_s = self.time_step_s.min(self.stable_step_s());
        // A hair below the whole number: dt = k times the step gives k parts in spite of rounding.
        (dt_s / longest_s - 1e-9).ceil().clamp(1.0, MOST_PARTS) as u64
    }

    /// The stretch beyond which an undivided part of `part_s` is too long. The stable neo-Hookean tangent grows no faster than the
    /// sixth power of the stretch, and with beta of stiffness damping steps of h are stable up to a tangent of 4/(h (h + 2 beta)):
    /// shorter ones bear more.
    fn calm_stretch(&self, part_s: f64) -> f64 {
        if self.kernel.law() == KernelLaw::StableNeoHooke {
            let beta_s = self.damping.stiffness_s;
            let per_tangent = |step_s: f64| step_s * (step_s + 2.0 * beta_s);
            let share = (per_tangent(self.stable_step_s()) / per_tangent(part_s)).max(1.0);
            self.made_for_stretch * libm::cbrt(share.sqrt())
        } else {
            self.made_for_stretch
        }
    }

    /// Into how many the next one will be: more where the tissue is strained beyond what the step is for.
    fn parts_to_come(&self, dt_s: f64) -> u64 {
        let n_parts = self.parts_of_step(dt_s);
        if self.careful_steps == 0 {
            return n_parts;
        }
        let mut careful = u64::from(self.most_parts);
        if self.kernel.law() == KernelLaw::StableNeoHooke {
            let enough = (dt_s / (CAREFUL_SHARE * self.stable_step_s())).ceil();
            careful = careful.min(enough.clamp(1.0, MOST_PARTS) as u64);
        }
        n_parts.max(careful)
    }

    /// The moving state, to come back to with [`ExplicitKernel::restore`].
    pub fn snapshot(&self) -> ExplicitKernelSnapshot {
        ExplicitKernelSnapshot {
            history: DeformableModel::history(self),
            positions_m: self.positions_m.clone(),
            velocities_m_per_s: self.velocities_m_per_s.clone(),
        }
    }

    /// Comes back to a state of the same mesh and removals; constraints stay as they are.
    ///
    /// # Panics
    /// When the snapshot has another number of nodes.
    pub fn restore(&mut self, snapshot: &ExplicitKernelSnapshot) {
        self.positions_m.copy_from_slice(&snapshot.positions_m);
        self.velocities_m_per_s.copy_from_slice(&snapshot.velocities_m_per_s);
        self.put_history_back(&snapshot.history);
        for held in self.held.iter_mut() {
            held.moved_m = self.kernel.increment_m(held.node);
        }
    }

    /// Comes back to the numbers of [`Mover::history_into`].
    fn put_history_back(&mut self, history: &[f64]) {
        let n_nodes = self.rest.positions_m.len();
        let (of_nodes, others) = history.split_at(6 * n_nodes);
        let of_nodes = of_nodes.as_chunks::<3>().0.iter().map(|xyz| DVec3::from_array(*xyz));
        let (displacements_m, increments_m) = (of_nodes.clone(), of_nodes.skip(n_nodes));
        self.displacements_m.clear();
        self.displacements_m.extend(displacements_m.take(n_nodes));
        for (n, increment_m) in increments_m.enumerate() {
            let node = NodeId::from_index(n);
            self.kernel.set_displacement(node, self.displacements_m[n]);
            self.kernel.set_increment(node, increment_m);
        }
        self.kernel.set_last_step_s(known(others[0]));
        self.careful_steps = others[1] as u32;
        self.kernel.set_history(&others[3..]);
    }

    /// What the last step added to a node's displacement [m], held or not.
    fn increment_m(&self, node: NodeId) -> DVec3 {
        // Of a node that is held twice the last place counts.
        let held = self.held.iter().rev().find(|held| held.node == node);
        held.map_or_else(|| self.kernel.increment_m(node), |held| held.moved_m)
    }

    /// Whether a constraint on this node has something to act on.
    fn takes_load(&self, node: NodeId) -> bool {
        self.supports.get(node.index()).is_some_and(|axes| *axes != [true; 3]) && self.kernel.has_tets(node)
    }

    /// Lets the held nodes go, with the velocity that they had.
    fn release(&mut self) {
        while let Some(held) = self.held.pop() {
            self.kernel.hold_axes(held.node, self.supports[held.node.index()]);
            self.kernel.set_increment(held.node, held.moved_m);
        }
    }

    /// Moves the held nodes to their places of this part of the step.
    fn move_held(&mut self, share: f64, h_s: f64) {
        let per_last = self.kernel.last_step_s().unwrap_or(h_s) / h_s;
        for held in self.held.iter_mut() {
            let at_m = if share == 1.0 { held.target_m } else { held.start_m.lerp(held.target_m, share) };
            held.moved_m = at_m - self.kernel.displacement_m(held.node);
            self.kernel.set_displacement(held.node, at_m);
            // Its velocity, for stiffness damping, in the length of the last step as all others.
            self.kernel.set_increment(held.node, held.moved_m * per_last);
        }
    }

    /// Holds the kinetic energy against what can have been put in.
    fn watch_energy(&mut self) {
        let sums = self.kernel.step_sums();
        self.report.n_recovered_nodes += sums.n_recovered;
        let outer_j = sums.outer_work_j.max(0.0);
        let gain_j = sums.kinetic_after_j - sums.kinetic_before_j;
        if gain_j <= outer_j + self.most_elastic_j {
            return;
        }
        let allowed_j = sums.kinetic_before_j.max(self.most_elastic_j) + outer_j;
        let factor = (allowed_j / sums.kinetic_after_j).sqrt();
        self.kernel.scale_last_increments(if factor.is_finite() { factor.min(1.0) } else { 0.0 });
        self.report.energy_was_limited = true;
    }

    /// Positions and velocities from the kernel.
    fn publish(&mut self) {
        let per_step = 1.0 / self.kernel.last_step_s().unwrap_or(self.time_step_s);
        let mut kinetic_j = 0.0;
        let Self { displacements_m, positions_m, velocities_m_per_s, rest, kernel, .. } = self;
        kernel.for_each_node(|node, motion| {
            let n = node.index();
            displacements_m[n] = motion.displacement_m;
            positions_m[n] = rest.positions_m[n] + motion.displacement_m;
            // Not read back from where it is written: that waits for the write.
            let velocity_m_per_s = motion.increment_m * per_step;
            velocities_m_per_s[n] = velocity_m_per_s;
            kinetic_j += 0.5 * motion.inertia_kg * velocity_m_per_s.length_squared();
        });
        for held in self.held.iter() {
            let n = held.node.index();
            let velocity_m_per_s = held.moved_m * per_step;
            let added = velocity_m_per_s.length_squared() - velocities_m_per_s[n].length_squared();
            kinetic_j += 0.5 * kernel.inertia_kg(held.node) * added;
            velocities_m_per_s[n] = velocity_m_per_s;
        }
        self.report.kinetic_energy_j = kinetic_j;
    }

    /// [`ExplicitKernel::publish`] for these nodes alone, after an edit that left all others as they were. The kinetic
    /// energy stays that of the last step, as after a removal.
    fn publish_nodes(&mut self, nodes: impl Iterator<Item = NodeId>) {
        let per_step = 1.0 / self.kernel.last_step_s().unwrap_or(self.time_step_s);
        for node in nodes {
            let n = node.index();
            let (displacement_m, increment_m) =
                (self.kernel.displacement_m(node), self.kernel.increment_m(node));
            self.displacements_m[n] = displacement_m;
            self.positions_m[n] = self.rest.positions_m[n] + displacement_m;
            self.velocities_m_per_s[n] = increment_m * per_step;
        }
        for held in self.held.iter() {
            let n = held.node.index();
            self.velocities_m_per_s[n] = held.moved_m * per_step;
        }
    }
}

fn known(step_s: f64) -> Option<f64> {
    (step_s > 0.0).then_some(step_s)
}

impl Mover for ExplicitKernel {
    /// A displacement of a node that is fixed along some axes holds along the others.
    fn apply(&mut self, constraints: &Constraints) {
        self.report.n_ignored_constraints = 0;
        self.loads.clear(&mut self.kernel);
        for force in &constraints.forces {
            let usable = self.takes_load(force.node) && force.force_n.is_finite();
            if !(usable && self.loads.add(&mut self.kernel, force.node, force.force_n)) {
                self.report.n_ignored_constraints += 1;
            }
        }
        self.release();
        for (place, imposed) in constraints.displacements.iter().enumerate() {
            let node = imposed.node;
            let usable = self.takes_load(node) && imposed.displacement_m.is_finite();
            let mut is_held = false;
            if usable {
                let (moved_m, start_m) = (self.kernel.increment_m(node), self.kernel.displacement_m(node));
                let mut target_m = imposed.displacement_m;
                for (axis, is_fixed) in self.supports[node.index()].into_iter().enumerate() {
                    if is_fixed {
                        target_m[axis] = start_m[axis];
                    }
                }
                is_held = self.held.try_push(Held { place, node, start_m, target_m, moved_m });
            }
            if is_held {
                self.kernel.hold_axes(node, [true; 3]);
            } else {
                self.report.n_ignored_constraints += 1;
            }
        }
        // Room was made for every node; more is a list with repetitions.
        self.constraint_forces_n.clear();
        self.constraint_forces_n.resize(constraints.displacements.len(), DVec3::ZERO);
    }

    fn state(&self) -> ModelState<'_> {
        ModelState { positions_m: &self.positions_m, velocities_m_per_s: &self.velocities_m_per_s }
    }

    /// Displacements, last increments, three numbers of which the first ones are the last step's length and the careful steps, and
    /// the memory of relaxing stress.
    fn history_into(&self, numbers: &mut Vec<f64>) {
        numbers.extend(self.displacements_m.iter().flat_map(|u_m| u_m.to_array()));
        let first = numbers.len();
        numbers.resize(first + 3 * self.displacements_m.len(), 0.0);
        let increments_m = numbers[first..].as_chunks_mut::<3>().0;
        self.kernel.for_each_node(|node, motion| increments_m[node.index()] = motion.increment_m.to_array());
        for held in self.held.iter() {
            increments_m[held.node.index()] = held.moved_m.to_array();
        }
        numbers.extend([self.kernel.last_step_s().unwrap_or(0.0), f64::from(self.careful_steps), 0.0]);
        let first = numbers.len();
        numbers.resize(first + self.kernel.history_len(), 0.0);
        self.kernel.history_into(&mut numbers[first..]);
    }

    fn constraint_forces_n(&self) -> &[DVec3] {
        &self.constraint_forces_n
    }

    /// A position that is not finite leaves its node where it is. What relaxing stress remembers is forgotten.
    fn take_over(&mut self, positions_m: &[DVec3]) {
        let n_nodes = self.rest.positions_m.len();
        assert_eq!(positions_m.len(), n_nodes, "one position a node");
        for (n, &position_m) in positions_m.iter().enumerate() {
            if position_m.is_finite() {
                let mut u_m = position_m - self.rest.positions_m[n];
                for (axis, is_fixed) in self.supports[n].into_iter().enumerate() {
                    if is_fixed {
                        u_m[axis] = 0.0;
                    }
                }
                self.kernel.set_displacement(NodeId::from_index(n), u_m);
                // What never had a tetrahedron has no place in the kernel.
                self.displacements_m[n] = u_m;
                self.positions_m[n] = self.rest.positions_m[n] + u_m;
            }
        }
        self.kernel.stop();
        self.kernel.forget_history();
        for held in self.held.iter_mut() {
            held.moved_m = DVec3::ZERO;
        }
        self.constraint_forces_n.fill(DVec3::ZERO);
        self.publish();
    }

    /// Numbers that are not finite are left out.
    fn set_gravity(&mut self, gravity_m_per_s2: DVec3) {
        if gravity_m_per_s2.is_finite() {
            self.loads.gravity_m_per_s2 = gravity_m_per_s2;
            self.loads.refresh_all(&mut self.kernel);
        }
    }

    fn report(&self) -> ModelReport {
        let quarantined = self.kernel.quarantined();
        ModelReport {
            n_mass_scaled_nodes: self.stability.scaling.n_nodes,
            n_quarantined_tets: quarantined.n_tets,
            first_quarantined: quarantined.first,
            ..self.report
        }
    }

    fn node_answer_m_per_n(&self, node: NodeId, dt_s: f64) -> DVec3 {
        self.answer_of_node(node, dt_s)
    }

    fn correct(&mut self, forces: &[NodalForce], dt_s: f64, correction: Correction) {
        self.correct_nodes(forces, dt_s, correction);
    }
}

impl ExplicitDynamics for ExplicitKernel {
    type Mover = Self;

    fn mover(&self) -> &Self {
        self
    }

    fn mover_mut(&mut self) -> &mut Self {
        self
    }

    /// Advances by `dt_s` in the fewest equal parts that are not longer than [`ExplicitKernel::time_step_s`] and
    /// [`ExplicitKernel::stable_step_s`].
    /// Held nodes move evenly to where they are held; the constraint force is the one that balances them at
    /// the last part: elastic force, weight, ligaments and forces, without the held node's own inertia. Along a
    /// fixed axis it is the support's, and zero here.
    fn advance(&mut self, dt_s: f64) {
        if !(dt_s.is_finite() && dt_s > 0.0) {
            return;
        }
        let n_parts = self.parts_to_come(dt_s);
        let undivided_s = (dt_s / self.parts_of_step(dt_s) as f64).min(self.time_step_s);
        self.kernel.set_calm_stretch(self.calm_stretch(undivided_s));
        let mut is_strained = false;
        let parts = n_parts as f64;
        // Only a step of more than the most parts is cut off.
        let step_s = (dt_s / parts).min(self.time_step_s);
        let step = ExplicitStep { step_s, damping_per_s: self.damping.mass_per_s };
        self.report.n_parts = n_parts as u32;
        self.report.n_recovered_nodes = 0;
        self.report.energy_was_limited = false;
        for held in self.held.iter_mut() {
            held.start_m = self.kernel.displacement_m(held.node);
        }
        for part in 1..=n_parts {
            self.move_held(if part == n_parts { 1.0 } else { part as f64 / parts }, step_s);
            self.loads.refresh_attachments(&mut self.kernel);
            self.kernel.step(self.workers.as_ref(), step);
            self.watch_energy();
            if self.stiffens && self.kernel.is_strained() {
                is_strained = true;
                let furthest_m = MOST_WAVE_SPEEDS * self.stability.fastest_wave_m_per_s * step_s;
                self.report.energy_was_limited |= self.kernel.limit_last_increments(furthest_m);
            }
        }
        self.careful_steps = if is_strained || self.report.energy_was_limited {
            CAREFUL_STEPS
        } else {
            self.careful_steps.saturating_sub(1)
        };
        for held in self.held.iter() {
            let supports = self.supports[held.node.index()];
            let mut force_n = self.kernel.force_n(held.node) - self.kernel.outer_force_n(held.node);
            for (axis, is_fixed) in supports.into_iter().enumerate() {
                if is_fixed {
                    force_n[axis] = 0.0;
                }
            }
            self.constraint_forces_n[held.place] = force_n;
        }
        self.publish();
    }

    /// Follows all edits; removals allocate nothing.
    fn follow_change(&mut self, mesh: &TetMesh, change: &TopologyChange) -> Result<(), TopologyRefusal> {
        let counts = [self.rest.tetrahedra.len(), self.rest.positions_m.len()];
        TopologyRefusal::of_other_mesh(NAME, change, counts)?;
        let tets = self.rest.tetrahedra.iter().enumerate();
        let live = tets.filter(|(t, _)| self.kernel.is_live(TetId::from_index(*t)));
        match TopologyUpdate::of(NAME, mesh, change, &self.rest.positions_m, live)? {
            Some(growth) => self.grow(mesh, change, &growth),
            None => {
                for &tet in &change.tets.removed {
                    if self.kernel.is_live(tet) {
                        self.remove_tet(tet);
                    }
                }
                // A compaction does it itself.
                if !change.tets.removed.is_empty() && !change.is_renumbering() {
                    self.stability.measure(&self.rest, &self.substance, &self.kernel);
                }
            }
        }
        // A held node that lost its last tetrahedron has nothing to pull on.
        let kernel = &self.kernel;
        self.held.retain(|held| kernel.has_tets(held.node));
        if change.is_renumbering() {
            self.compact(change);
        }
        Ok(())
    }

    /// Short, but for edits after which the kernel may be laid out anew; those of removals allocate nothing in buffers that
    /// were used before.
    fn save_before(&self, change: &TopologyChange, undo: &mut ModelUndo) {
        self.save(change, undo);
    }

    fn put_back(&mut self, undo: &ModelUndo) {
        self.put_edit_back(undo);
    }
}
