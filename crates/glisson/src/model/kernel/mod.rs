//! The fast kernel: forces of linear elasticity and St Venant-Kirchhoff, tetrahedron by tetrahedron, eight at a
//! time, and central differences on top of them.
//!
//! The physics is that of the tensor-mass models (seeds `002` to `004`); `element` has the formula. What makes it
//! fast: tetrahedra sorted along a Hilbert curve and cut into parts whose nodes fit a first-level cache;
//! nodes as padded rows of four numbers, loaded and transposed; offsets multiplied beforehand; the material in
//! two numbers a tetrahedron; and eight lanes that each walk a stretch of the part of their own, so that they
//! seldom wait for each other's nodes.
//!
//! Same bits on every path ([`KernelPath`]) and for any number of threads: every lane computes with the same fused
//! operations, forces are added lane after lane, and the parts and the order of their sums depend on the mesh
//! alone. Ids are the caller's throughout; the order inside shows nowhere.

mod element;
mod lanes;
mod motion;
mod order;
mod part;
mod paths;
mod rows;
mod workers;

use std::sync::Arc;

use self::motion::StepFactors;
use self::order::{PartPlan, Place, partition};
use self::part::{Exchange, Part, PartNodes, Parts};
use self::rows::{Block, N_LANES, offset_of};
use crate::material::LinearElastic;
use crate::math::DVec3;
use crate::mesh::{NodeId, TetId, TetMesh};
use crate::solve::{P1Gradients, SolveError};

pub use motion::{NodeMotion, StepSums};
pub use paths::KernelPath;
pub use workers::{Sequential, Task, Workers};

/// The kernel's laws.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum KernelLaw {
    /// Hooke's law with the small strain; valid while displacements stay below about a tenth of the body.
    Linear,
    /// St Venant-Kirchhoff: Hooke's law with the Green-Lagrange strain; large rotations, moderate strains.
    /// Softens when compressed to less than about 0.6 of its length, and does not resist inversion.
    StVenantKirchhoff,
}

/// Why there is no kernel.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum KernelError {
    /// The mesh is unusable.
    #[error(transparent)]
    Solve(#[from] SolveError),
    /// Neither one material nor one for each tetrahedron.
    #[error("{found} materials for {n_tets} tetrahedra; allowed: one, or one for each tetrahedron")]
    Materials {
        /// How many were given.
        found: usize,
        /// Tetrahedra of the mesh.
        n_tets: usize,
    },
}

/// What a kernel is made from.
#[derive(Clone, Copy, Debug)]
pub struct KernelParams<'a> {
    /// The body at rest; all its tetrahedra count.
    pub mesh: &'a TetMesh,
    /// The law of every tetrahedron.
    pub law: KernelLaw,
    /// One material, or one for each tetrahedron. Densities make the masses.
    pub materials: &'a [LinearElastic],
    /// How to compute; [`KernelPath::fastest`] unless paths are compared.
    pub path: KernelPath,
}

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
/// use glisson::material::LinearElastic;
/// use glisson::math::DVec3;
/// use glisson::mesh::{NodeId, TetMesh};
/// use glisson::model::kernel::{FastKernel, KernelLaw, KernelParams, KernelPath, Sequential};
/// let mesh = TetMesh {
///     positions_m: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z],
///     tetrahedra: vec![[0, 1, 2, 3].map(NodeId)],
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
pub struct FastKernel {
    parts: Arc<Parts>,
    node_places: Vec<Option<Place>>,
    tet_places: Vec<TetPlace>,
    /// rho V / 4 of each tetrahedron.
    mass_share_kg: Vec<f64>,
    last_step_s: Option<f64>,
    stiffness_damping_s: f64,
    // The tasks of the phases, made once: a step allocates nothing.
    lead: Task,
    add_element_forces: Task,
    sum_forces: Task,
    sum_and_advance: Task,
}

impl std::fmt::Debug for FastKernel {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("FastKernel").field("parts", &self.parts).finish_non_exhaustive()
    }
}

impl FastKernel {
    /// Sorts the mesh in space and lays out its memory; the body is at rest, no node is held.
    ///
    /// # Errors
    /// [`KernelError`]: an empty mesh, missing nodes, flat or inverted tetrahedra, a wrong number of materials.
    pub fn new(params: &KernelParams<'_>) -> Result<Self, KernelError> {
        let KernelParams { mesh, law, materials, path } = *params;
        check(mesh, materials)?;
        let n_tets = mesh.tetrahedra.len();
        let (plans, node_places) = partition(mesh);
        let dead = TetPlace { part: 0, block: 0, lane: 0, is_live: false };
        let mut kernel_places = vec![dead; n_tets];
        let mut mass_share_kg = vec![0.0; n_tets];
        // Row of each node in the part under construction.
        let mut row_of = vec![0_usize; mesh.positions_m.len()];
        let mut parts = Vec::with_capacity(plans.len());
        for (p, plan) in plans.iter().enumerate() {
            for (row, node) in plan.own.iter().chain(&plan.borrowed).enumerate() {
                row_of[node.index()] = row;
            }
            let n_blocks = plan.tets.len().div_ceil(N_LANES);
            let mut blocks = vec![Block::EMPTY; n_blocks];
            for (i, &tet) in plan.tets.iter().enumerate() {
                // Each lane walks a stretch of its own.
                let (lane, b) = (i / n_blocks, i % n_blocks);
                let material = materials[if materials.len() == 1 { 0 } else { tet.index() }];
                let gradients = P1Gradients::of_tet(mesh, tet)?;
                let volume_m3 = gradients.volume_m3;
                let block = &mut blocks[b];
                block.offsets[lane] = mesh.tetrahedra[tet.index()].map(|n| offset_of(row_of[n.index()]));
                for k in 0..3 {
                    for (axis, alpha) in gradients.alpha_per_m[k + 1].to_array().into_iter().enumerate() {
                        block.alpha_per_m[k][axis][lane] = alpha;
                    }
                }
                block.material[0][lane] = 0.5 * volume_m3 * material.lambda_pa();
                block.material[1][lane] = volume_m3 * material.mu_pa();
                mass_share_kg[tet.index()] = 0.25 * material.density_kg_per_m3() * volume_m3;
                let number = |i: usize| u32::try_from(i).expect("fewer than 2^32 tetrahedra");
                kernel_places[tet.index()] =
                    TetPlace { part: number(p), block: number(b), lane: lane as u8, is_live: true };
            }
            let nodes = PartNodes::at_rest(plan.own.len());
            parts.push(Part::new(plan.own.clone(), plan.own.len() + plan.borrowed.len(), blocks, nodes));
        }
        connect(&mut parts, &plans, &node_places);
        let step = StepFactors::default().into();
        let kernel = Self {
            node_places,
            tet_places: kernel_places,
            mass_share_kg,
            ..Self::of_parts(Parts { law, path: path.into(), all: parts, step })
        };
        for (nodes, &share_kg) in mesh.tetrahedra.iter().zip(&kernel.mass_share_kg) {
            for node in nodes {
                kernel.change_mass(*node, share_kg, 1);
            }
        }
        Ok(kernel)
    }

    fn of_parts(parts: Parts) -> Self {
        let parts = Arc::new(parts);
        Self {
            lead: task(&parts, Parts::lead),
            add_element_forces: task(&parts, Parts::add_element_forces),
            sum_forces: task(&parts, Parts::sum_forces),
            sum_and_advance: task(&parts, Parts::sum_and_advance),
            parts,
            node_places: Vec::new(),
            tet_places: Vec::new(),
            mass_share_kg: Vec::new(),
            last_step_s: None,
            stiffness_damping_s: 0.0,
        }
    }

    fn place(&self, node: NodeId) -> Option<(&Part, usize)> {
        self.node_places[node.index()].map(|p| (&self.parts.all[p.part as usize], p.index as usize))
    }

    /// Adds or subtracts a tetrahedron's share; a node that loses its last one has exactly none left.
    fn change_mass(&self, node: NodeId, share_kg: f64, change: i32) {
        let Some((part, n)) = self.place(node) else { return };
        let mut nodes = part.nodes_mut();
        nodes.n_tets[n] = nodes.n_tets[n].saturating_add_signed(change);
        let mass_kg = nodes.mass_kg[n] + f64::from(change) * share_kg;
        nodes.mass_kg[n] = if nodes.n_tets[n] > 0 { mass_kg } else { 0.0 };
        nodes.update_inverse_mass(n);
    }

    /// The law.
    pub fn law(&self) -> KernelLaw {
        self.parts.law
    }

    /// How it computes.
    pub fn path(&self) -> KernelPath {
        self.parts.path()
    }

    /// Computes another way from now on, with the same results.
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

    /// Number of parts: as many threads can work at the same time.
    pub fn n_parts(&self) -> usize {
        self.parts.all.len()
    }

    /// Bytes that a computation of the forces reads and writes: tetrahedra, rows of the nodes.
    pub fn working_set_bytes(&self) -> usize {
        let of_part = |part: &Part| {
            size_of_val(part.blocks().as_slice())
                + size_of::<rows::Row>() * 2 * (part.own.len() + part.n_rows)
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
            for (row, node) in nodes.displacement_m.iter_mut().zip(&part.own) {
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
            for (row, node) in of(&part.nodes()).iter().zip(&part.own) {
                values[node.index()] = DVec3::new(row[0], row[1], row[2]);
            }
        }
    }

    /// Computes the forces at the displacements set, for [`FastKernel::forces_into`].
    pub fn compute_forces(&mut self, workers: &dyn Workers) {
        self.parts.set_step(StepFactors::default());
        workers.run(self.n_parts(), &self.add_element_forces);
        workers.run(self.n_parts(), &self.sum_forces);
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

    /// Takes a tetrahedron out: from now on it adds exact zeros, and its nodes lose their shares of its mass.
    /// In constant time; a second time it does nothing.
    pub fn remove_tet(&mut self, mesh: &TetMesh, tet: TetId) {
        let place = &mut self.tet_places[tet.index()];
        if !std::mem::replace(&mut place.is_live, false) {
            return;
        }
        let TetPlace { part, block, lane, .. } = *place;
        self.parts.all[part as usize].blocks_mut()[block as usize].clear(usize::from(lane));
        let share_kg = self.mass_share_kg[tet.index()];
        for node in mesh.tetrahedra[tet.index()] {
            self.change_mass(node, share_kg, -1);
        }
    }

    /// Whether a tetrahedron was not removed.
    pub fn is_live(&self, tet: TetId) -> bool {
        self.tet_places[tet.index()].is_live
    }

    /// Mass [kg] of a node.
    pub fn mass_kg(&self, node: NodeId) -> f64 {
        self.place(node).map_or(0.0, |(part, n)| part.nodes().mass_kg[n])
    }

    /// Holds a node, at standstill, or lets it go: a step leaves a held node where it is.
    pub fn hold(&mut self, node: NodeId, is_held: bool) {
        self.hold_axes(node, [is_held; 3]);
    }

    /// Sets the force [N] from outside on a node, gravity included.
    pub fn set_outer_force(&mut self, node: NodeId, force_n: DVec3) {
        if let Some((part, n)) = self.place(node) {
            part.nodes_mut().outer_n[n] = padded(force_n);
        }
    }

    /// Brings all nodes to standstill where they are.
    pub fn stop(&mut self) {
        for part in &self.parts.all {
            part.nodes_mut().increment_m.fill([0.0; 4]);
        }
    }

    /// Advances by one step of central differences (seed `003`, eq. 3.3), the motion fused with the sum of
    /// the forces: u(t+h) - u(t) = [ (1/h^2 - d/(2h)) (u(t) - u(t-h)) + F/m ] / (1/h^2 + d/(2h)), F the
    /// outer force less the balancing one. After another step length, the last increment counts in proportion.
    ///
    /// A step that is too long diverges: the caller keeps to the stable one.
    pub fn step(&mut self, workers: &dyn Workers, step: ExplicitStep) {
        let last_s = self.last_step_s.replace(step.step_s).unwrap_or(step.step_s);
        let factors = StepFactors::new(step, last_s, self.stiffness_damping_s);
        self.parts.set_step(factors);
        if factors.leads() {
            workers.run(self.n_parts(), &self.lead);
        }
        workers.run(self.n_parts(), &self.add_element_forces);
        workers.run(self.n_parts(), &self.sum_and_advance);
    }
}

fn task(parts: &Arc<Parts>, phase: fn(&Parts, usize)) -> Task {
    let parts = Arc::clone(parts);
    Arc::new(move |p| phase(&parts, p))
}

fn padded(v: DVec3) -> rows::Row {
    [v.x, v.y, v.z, 0.0]
}

fn check(mesh: &TetMesh, materials: &[LinearElastic]) -> Result<(), KernelError> {
    let (n_nodes, n_tets) = (mesh.positions_m.len(), mesh.tetrahedra.len());
    if n_tets == 0 {
        return Err(SolveError::EmptyMesh.into());
    }
    if materials.len() != 1 && materials.len() != n_tets {
        return Err(KernelError::Materials { found: materials.len(), n_tets });
    }
    for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
        let tet = TetId::from_index(t);
        if let Some(&node) = nodes.iter().find(|n| n.index() >= n_nodes) {
            return Err(SolveError::NodeOutOfRange { tet, node, n_nodes }.into());
        }
        if let Some(&node) = nodes.iter().find(|n| !mesh.positions_m[n.index()].is_finite()) {
            let position_m = mesh.positions_m[node.index()].to_array();
            return Err(SolveError::NonFinitePosition { node, position_m }.into());
        }
    }
    Ok(())
}

/// Who borrows which rows from whom.
fn connect(parts: &mut [Part], plans: &[PartPlan], node_places: &[Option<Place>]) {
    let row = |i: usize| u16::try_from(i).expect("parts are small");
    for (p, plan) in plans.iter().enumerate() {
        for (i, node) in plan.borrowed.iter().enumerate() {
            let owner = node_places[node.index()].expect("a borrowed node has an owner");
            let here = row(plan.own.len() + i);
            let there = row(owner.index as usize);
            let owner = owner.part as usize;
            add_rows(&mut parts[p].borrowed, owner, [here, there]);
            add_rows(&mut parts[owner].lent, p, [there, here]);
        }
    }
}

fn add_rows(exchanges: &mut Vec<Exchange>, part: usize, rows: [u16; 2]) {
    match exchanges.last_mut() {
        Some(last) if last.part == part => last.rows.push(rows),
        _ => exchanges.push(Exchange { part, rows: vec![rows] }),
    }
}
