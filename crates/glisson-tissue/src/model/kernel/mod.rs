//! The fast kernel: elastic forces, tetrahedron by tetrahedron, eight at a time, and central differences on top of
//! them.
//!
//! The physics is that of the tensor-mass models (seeds `002` to `004`), with further laws. `element` has the formula,
//! `extras` the optional parts of the stress ([`KernelExtras`]). The speed comes from
//! - tetrahedra sorted along a Hilbert curve and divided into parts whose nodes fit a first-level cache;
//! - nodes as padded rows of four numbers, which are loaded and transposed;
//! - byte offsets that are computed beforehand;
//! - two material numbers per tetrahedron;
//! - eight lanes, each with its own stretch of the part, so that they seldom wait for each other's nodes.
//!
//! The bits are the same on every path ([`KernelPath`]) and for any number of threads: every lane computes with the same
//! fused operations, forces are added lane after lane, and the parts and the order of their sums depend on the mesh alone.
//! Ids are always the caller's; the internal order is not visible.

mod advance;
mod build;
mod lane_block;
mod element;
mod extras;
mod general;
mod topology_update;
mod lanes;
mod step;
mod motion;
mod neo_hooke;
mod order;
mod part;
mod paths;
mod quarantine;
mod rows;

use self::order::Place;
use self::part::{ForceMode, Part, PartNodes, Parts};
use self::step::StepFactors;
use super::tet_law::FibreError;
use crate::material::LinearElastic;
use crate::solve::SolveError;
use crate::workers::Workers;
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};

pub use build::KernelExtras;
pub use general::SharedMaterial;
pub(in crate::model) use lane_block::{LaneBlock, LaneBlockWork};
pub use motion::NodeMotion;
pub use paths::KernelPath;
pub use quarantine::{MOST_STRESS, Quarantine, QuarantineReport};
pub use step::StepSums;
pub(in crate::model) use topology_update::{KernelCounts, NodeMass};

/// The kernel's laws.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum KernelLaw {
    /// Hooke's law with the small strain; valid while displacements stay below about a tenth of the body.
    Linear,
    /// St Venant-Kirchhoff: Hooke's law with the Green-Lagrange strain; large rotations, moderate strains.
    /// Softens when compressed to less than about 0.6 of its length, and does not resist inversion.
    StVenantKirchhoff,
    /// [`crate::material::NeoHookeLog`], stiff against vanishing volume; the force of an inverted tetrahedron is not a number.
    NeoHookeLog,
    /// [`crate::material::StableNeoHooke`], which pushes inverted tetrahedra back where [`Quarantine::NotFinite`] allows it.
    StableNeoHooke,
    /// Any laws, [`KernelExtras::laws`], one tetrahedron at a time; of the materials only the density counts.
    General,
}

impl KernelLaw {
    /// The fast code of the law of this name, if there is some.
    pub fn named(name: &str) -> Option<Self> {
        match name {
            "linear" => Some(Self::Linear),
            "st_venant_kirchhoff" => Some(Self::StVenantKirchhoff),
            "neo_hooke_log" => Some(Self::NeoHookeLog),
            "stable_neo_hooke" => Some(Self::StableNeoHooke),
            _ => None,
        }
    }
}

/// Why a kernel cannot be built.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum KernelError {
    /// The mesh is unusable.
    #[error(transparent)]
    Solve(#[from] SolveError),
    /// The number of materials is neither one nor that of the tetrahedra.
    #[error("{found} materials for {n_tets} tetrahedra; allowed: one, or one for each tetrahedron")]
    Materials {
        /// How many were given.
        found: usize,
        /// Tetrahedra of the mesh.
        n_tets: usize,
    },
    /// A number of general laws that does not suit the law.
    #[error(
        "{found} general laws for {n_tets} tetrahedra of law {law:?}; allowed: one or one for each with General, none else"
    )]
    Laws {
        /// How many were given.
        found: usize,
        /// The law.
        law: KernelLaw,
        /// Tetrahedra of the mesh.
        n_tets: usize,
    },
    /// The number of extras is neither zero nor that of the tetrahedra.
    #[error("{found} {what} for {n_tets} tetrahedra; allowed: none, or one for each")]
    ExtraCount {
        /// Of what.
        what: &'static str,
        /// How many were given.
        found: usize,
        /// Tetrahedra of the mesh.
        n_tets: usize,
    },
    /// A stress in the rest shape that is not finite.
    #[error("the stress of tetrahedron {tet} in the rest shape is not finite")]
    RestStress {
        /// Which tetrahedron.
        tet: TetId,
    },
    /// An impossible penalty of volume changes.
    #[error("the volume penalty is {found_pa} Pa; allowed: a finite number from 0")]
    VolumePenalty {
        /// What was given [Pa].
        found_pa: f64,
    },
    /// A fibre's direction or moduli.
    #[error(transparent)]
    Fibre(#[from] FibreError),
}

/// Parameters of a kernel.
#[derive(Clone, Copy, Debug)]
pub struct KernelParams<'a> {
    /// The body at rest; all its tetrahedra count.
    pub mesh: &'a TetMesh,
    /// The law of every tetrahedron.
    pub law: KernelLaw,
    /// One material, or one per tetrahedron. Their densities give the masses.
    pub materials: &'a [LinearElastic],
    /// The instruction set; [`KernelPath::fastest`] unless paths are compared.
    pub path: KernelPath,
}

/// Default stretch up to which tissue counts as calm. A choice: the largest that soft organs bear for long.
const CALM_STRETCH: f64 = 1.3;

/// A step of central differences.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExplicitStep {
    /// Length h [s]. The caller keeps it below the stable one.
    pub step_s: f64,
    /// Damping over mass, d [1/s].
    pub damping_per_s: f64,
}

/// Where a tetrahedron is.
#[derive(Clone, Copy, Debug)]
struct TetPlace {
    part: u32,
    block: u32,
    lane: u8,
    is_live: bool,
}

/// A body's displacements and forces.
///
/// ```
/// use glisson_tissue::material::LinearElastic;
/// use glisson_mesh::math::DVec3;
/// use glisson_mesh::mesh::{NodeId, TetMesh};
/// use glisson_tissue::model::kernel::{FastKernel, KernelLaw, KernelParams, KernelPath};
/// use glisson_tissue::workers::Sequential;
/// let mesh = TetMesh {
///     positions_m: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z],
///     tetrahedra: vec![[0, 1, 2, 3].map(NodeId)],
///     ..TetMesh::default()
/// };
/// let liver = LinearElastic::from_young_poisson(5000.0, 0.45, 1060.0)?;
/// let (law, path) = (KernelLaw::StVenantKirchhoff, KernelPath::fastest());
/// let mut kernel = FastKernel::new(&KernelParams { mesh: &mesh, law, materials: &[liver], path })?;
/// let mut force_n = [DVec3::ZERO; 4];
/// let moved = [DVec3::splat(0.1); 4];
/// kernel.force_into(&Sequential, &moved, &mut force_n);
/// assert_eq!(force_n, [DVec3::ZERO; 4]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone)]
pub struct FastKernel {
    parts: Parts,
    node_places: Vec<Option<Place>>,
    tet_places: Vec<TetPlace>,
    /// rho V / 4 of each tetrahedron.
    mass_share_kg: Vec<f64>,
    /// Tetrahedra added since the layout was made, and their number then.
    n_added: usize,
    n_laid_out: usize,
    quarantine: Quarantine,
    calm_stretch: f64,
    last_step_s: Option<f64>,
    stiffness_damping_s: f64,
}

impl std::fmt::Debug for FastKernel {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("FastKernel").field("parts", &self.parts).finish_non_exhaustive()
    }
}

impl FastKernel {
    fn of_parts(parts: Parts) -> Self {
        Self {
            parts,
            node_places: Vec::new(),
            tet_places: Vec::new(),
            mass_share_kg: Vec::new(),
            n_added: 0,
            n_laid_out: 0,
            quarantine: Quarantine::default(),
            calm_stretch: CALM_STRETCH,
            last_step_s: None,
            stiffness_damping_s: 0.0,
        }
    }

    fn place(&self, node: NodeId) -> Option<(&Part, usize)> {
        self.node_places[node.index()].map(|p| (&self.parts.all[p.part as usize], p.index as usize))
    }

    /// Adds or subtracts a tetrahedron's share of mass; a node that loses its last tetrahedron has exactly zero.
    fn change_mass(&self, node: NodeId, share_kg: f64, change: i32) {
        let Some((part, n)) = self.place(node) else { return };
        let mut nodes = part.nodes_mut();
        nodes.n_tets[n] = nodes.n_tets[n].saturating_add_signed(change);
        let mass_kg = nodes.mass_kg[n] + f64::from(change) * share_kg;
        nodes.mass_kg[n] = if nodes.n_tets[n] > 0 { mass_kg } else { 0.0 };
        nodes.update_inverse_mass(n);
    }

    /// Replaces the mass `before_kg` of a tetrahedron at `node` by `after_kg`. The node keeps moving, also when it has no other
    /// tetrahedron.
    fn exchange_mass(&self, node: NodeId, before_kg: f64, after_kg: f64) {
        let Some((part, n)) = self.place(node) else { return };
        let mut nodes = part.nodes_mut();
        let others_kg = if nodes.n_tets[n] > 1 { nodes.mass_kg[n] - before_kg } else { 0.0 };
        nodes.mass_kg[n] = others_kg + after_kg;
        nodes.update_inverse_mass(n);
    }

    /// The law.
    pub fn law(&self) -> KernelLaw {
        self.parts.law
    }

    /// The instruction set in use.
    pub fn path(&self) -> KernelPath {
        self.parts.path()
    }

    /// Sets the instruction set; the results are the same.
    pub fn set_path(&mut self, path: KernelPath) {
        self.parts.set_path(path);
    }

    /// Number of nodes, those without a tetrahedron included.
    pub fn n_nodes(&self) -> usize {
        self.node_places.len()
    }

    /// Number of tetrahedra, removed ones included.
    pub fn n_tets(&self) -> usize {
        self.tet_places.len()
    }

    /// Number of parts, which is the largest number of threads that can work at the same time.
    pub fn n_parts(&self) -> usize {
        self.parts.all.len()
    }

    /// Bytes that a computation of the forces reads and writes: tetrahedra, rows of the nodes.
    pub fn working_set_bytes(&self) -> usize {
        let of_part = |part: &Part| {
            let layout = part.layout();
            part.elements().n_bytes() + size_of::<rows::Row>() * 2 * (layout.own.len() + layout.n_rows())
        };
        self.parts.all.iter().map(of_part).sum()
    }

    /// Sets the displacement [m] of every node; a node without a tetrahedron has none.
    ///
    /// # Panics
    /// When there are not as many as nodes.
    pub fn set_displacements(&mut self, displacement_m: &[DVec3]) {
        assert_eq!(displacement_m.len(), self.n_nodes(), "one displacement a node");
        for part in &self.parts.all {
            let nodes = &mut *part.nodes_mut();
            for (row, node) in nodes.displacement_m.iter_mut().zip(&part.layout().own) {
                *row = padded(displacement_m[node.index()]);
            }
        }
    }

    /// Sets the displacement [m] of one node: one that is held.
    pub fn set_displacement(&mut self, node: NodeId, displacement_m: DVec3) {
        if let Some((part, n)) = self.place(node) {
            part.nodes_mut().displacement_m[n] = padded(displacement_m);
        }
    }

    /// Overwrites `displacement_m` with the displacement [m] of every node.
    ///
    /// # Panics
    /// When there are not as many as nodes.
    pub fn displacements_into(&self, displacement_m: &mut [DVec3]) {
        self.read_into(displacement_m, |nodes| &nodes.displacement_m);
    }

    /// Overwrites `force_n` with the force [N] that balances the deformation on every node, of the last
    /// computation or step: at the displacements before that step.
    ///
    /// # Panics
    /// When there are not as many as nodes.
    pub fn forces_into(&self, force_n: &mut [DVec3]) {
        self.read_into(force_n, |nodes| &nodes.force_n);
    }

    /// Overwrites `increment_m` with what the last step added to the displacement [m] of every node.
    ///
    /// # Panics
    /// When there are not as many as nodes.
    pub fn increments_into(&self, increment_m: &mut [DVec3]) {
        self.read_into(increment_m, |nodes| &nodes.increment_m);
    }

    fn read_into(&self, values: &mut [DVec3], of: impl Fn(&PartNodes) -> &Vec<rows::Row>) {
        assert_eq!(values.len(), self.n_nodes(), "one a node");
        for (value, place) in values.iter_mut().zip(&self.node_places) {
            if place.is_none() {
                *value = DVec3::ZERO;
            }
        }
        for part in &self.parts.all {
            for (row, node) in of(&part.nodes()).iter().zip(&part.layout().own) {
                values[node.index()] = DVec3::new(row[0], row[1], row[2]);
            }
        }
    }

    /// Computes the forces at the displacements set, for [`FastKernel::forces_into`].
    /// Nothing is in quarantine. A relaxing stress is that of a step of the last length that would end here;
    /// its memory stays.
    pub fn compute_forces(&mut self, workers: &dyn Workers) {
        self.parts.set_mode(ForceMode::default());
        self.parts.set_step(StepFactors::default());
        workers.run(self.n_parts(), &|p| self.parts.add_element_forces(p));
        workers.run(self.n_parts(), &|p| self.parts.sum_forces(p));
    }

    /// Overwrites `force_n` with the force [N] that balances the displacements `displacement_m` [m], dW/du; the
    /// tissue pulls with the opposite. In the caller's order of nodes.
    ///
    /// # Panics
    /// When there are not as many as nodes.
    pub fn force_into(&mut self, workers: &dyn Workers, displacement_m: &[DVec3], force_n: &mut [DVec3]) {
        self.set_displacements(displacement_m);
        self.compute_forces(workers);
        self.forces_into(force_n);
    }

    /// Removes a tetrahedron in constant time: it adds exact zeros from now on, and its nodes lose their shares of its mass. A
    /// second call has no effect.
    pub fn remove_tet(&mut self, mesh: &TetMesh, tet: TetId) {
        let place = &mut self.tet_places[tet.index()];
        if !std::mem::replace(&mut place.is_live, false) {
            return;
        }
        let TetPlace { part, block, lane, .. } = *place;
        let (part, block, lane) = (&self.parts.all[part as usize], block as usize, usize::from(lane));
        part.elements_mut().clear(block, lane);
        let n_blocks = part.elements().blocks.len();
        let history = &mut part.progress_mut().history;
        let a_block = history.len() / n_blocks;
        for numbers in &mut history[block * a_block..(block + 1) * a_block] {
            numbers[lane] = 0.0;
        }
        let share_kg = self.mass_share_kg[tet.index()];
        for node in mesh.tetrahedra[tet.index()] {
            self.change_mass(node, share_kg, -1);
        }
    }

    /// Whether a tetrahedron is live.
    pub fn is_live(&self, tet: TetId) -> bool {
        self.tet_places[tet.index()].is_live
    }

    /// Mass [kg] of a node.
    pub fn mass_kg(&self, node: NodeId) -> f64 {
        self.place(node).map_or(0.0, |(part, n)| part.nodes().mass_kg[n])
    }

    /// Holds a node at rest, or releases it: a step leaves a held node where it is.
    pub fn hold(&mut self, node: NodeId, is_held: bool) {
        self.hold_axes(node, [is_held; 3]);
    }

    /// Sets the force [N] from outside on a node, gravity included.
    pub fn set_outer_force(&mut self, node: NodeId, force_n: DVec3) {
        if let Some((part, n)) = self.place(node) {
            part.nodes_mut().outer_n[n] = padded(force_n);
        }
    }

    /// Sets what steps leave out.
    pub fn set_quarantine(&mut self, quarantine: Quarantine) {
        self.quarantine = quarantine;
    }

    /// Sets the stretch s beyond which strain is reported: where |2 E| = |F^T F - Id| exceeds s^2 - 1, its value for a single
    /// principal stretch. Without a report no principal stretch is larger. The default is 1.3.
    pub fn set_calm_stretch(&mut self, stretch: f64) {
        self.calm_stretch = stretch;
    }

    /// The stretch beyond which strain is reported.
    pub fn calm_stretch(&self) -> f64 {
        self.calm_stretch
    }

    /// What the last step left out.
    pub fn quarantined(&self) -> QuarantineReport {
        let mut all = QuarantineReport::default();
        for part in &self.parts.all {
            all.add(part.progress().quarantined);
        }
        all
    }

    /// Whether a tetrahedron of the last step was strained beyond what a step is made for: near to inversion or torn apart
    /// (det F below 0.5 or above 1.8), stretched beyond the stretch of [`FastKernel::set_calm_stretch`], or not finite. Not
    /// reported with [`Quarantine::Off`]; [`KernelLaw::Linear`] has the same stiffness at any stretch and reports volumes only.
    pub fn is_strained(&self) -> bool {
        self.parts.all.iter().any(|part| part.progress().is_strained)
    }

    /// Length of the memory of the relaxing stress: six numbers, and six for each term, per tetrahedron; zero without a series.
    pub fn history_len(&self) -> usize {
        let numbers_of_term = 6 * self.n_tets();
        self.parts.n_relaxation_terms().map_or(0, |n_terms| numbers_of_term * (1 + n_terms))
    }

    /// Overwrites `history` with the memory of the relaxing stress, tetrahedron after tetrahedron: V S_e of the end
    /// of the last step (xx, yy, zz, xy, xz, yz), then V h_k of each term [N m], of the stress S of law and
    /// fibres ([`crate::material::PronyHistory`], with the rest volume V). It is part of the state of the body.
    ///
    /// # Panics
    /// When there are not [`FastKernel::history_len`] numbers.
    pub fn history_into(&self, history: &mut [f64]) {
        assert_eq!(history.len(), self.history_len(), "the numbers of all tetrahedra");
        history.fill(0.0);
        self.for_each_history(|i, number| history[i] = *number);
    }

    /// Restores a memory of [`FastKernel::history_into`].
    ///
    /// # Panics
    /// When there are not [`FastKernel::history_len`] numbers.
    pub fn set_history(&mut self, history: &[f64]) {
        assert_eq!(history.len(), self.history_len(), "the numbers of all tetrahedra");
        self.for_each_history(|i, number| *number = history[i]);
    }

    /// Resets the memory of the relaxing stress, as for a body that was always at rest.
    pub fn forget_history(&mut self) {
        for part in &self.parts.all {
            part.progress_mut().history.as_flattened_mut().fill(0.0);
        }
    }

    /// Calls `visit` with each number of live tetrahedra and its place in [`FastKernel::history_into`].
    fn for_each_history(&self, mut visit: impl FnMut(usize, &mut f64)) {
        if self.history_len() == 0 {
            return;
        }
        let n = self.history_len() / self.n_tets();
        for (t, place) in self.tet_places.iter().enumerate().filter(|(_, place)| place.is_live) {
            let history = &mut self.parts.all[place.part as usize].progress_mut().history;
            let of_block = &mut history[place.block as usize * n..(place.block as usize + 1) * n];
            for (i, numbers) in of_block.iter_mut().enumerate() {
                visit(n * t + i, &mut numbers[usize::from(place.lane)]);
            }
        }
    }

    /// Stops all nodes where they are.
    pub fn stop(&mut self) {
        for part in &self.parts.all {
            part.nodes_mut().increment_m.fill([0.0; 4]);
        }
    }

    /// Advances by one step of central differences (seed `003`, eq. 3.3), the motion fused with the sum of
    /// the forces: u(t+h) - u(t) = [ (1/h^2 - d/(2h)) (u(t) - u(t-h)) + F/m ] / (1/h^2 + d/(2h)), F the
    /// outer force less the balancing one. After another step length, the last increment counts in proportion.
    ///
    /// A step that is too long diverges: the caller must not exceed the stable one.
    pub fn step(&mut self, workers: &dyn Workers, step: ExplicitStep) {
        let last_s = self.last_step_s.replace(step.step_s).unwrap_or(step.step_s);
        self.parts.set_relaxation_step(step.step_s);
        let factors = StepFactors::new(step, last_s, self.stiffness_damping_s);
        self.parts.set_step(factors);
        self.parts.set_mode(ForceMode {
            quarantine: Some(self.quarantine),
            in_step: true,
            calm_squared_strain: squared_strain_of(self.calm_stretch),
        });
        if factors.leads() {
            workers.run(self.n_parts(), &|p| self.parts.lead(p));
        }
        workers.run(self.n_parts(), &|p| self.parts.add_element_forces(p));
        workers.run(self.n_parts(), &|p| self.parts.sum_and_advance(p));
    }
}

/// |2 E|^2 of one principal stretch.
fn squared_strain_of(stretch: f64) -> f64 {
    let twice_strain = stretch * stretch - 1.0;
    twice_strain * twice_strain
}

fn padded(v: DVec3) -> rows::Row {
    [v.x, v.y, v.z, 0.0]
}
