//! The hybrid model of seed `003` ch. 4: zones that exchange forces until they agree.
//!
//! Each zone is pre-computed or moves as tensor-mass. A sweep visits the zones. A pre-computed zone takes the forces
//! of its neighbours on the shared frontier nodes, then responds to them and to the outer forces with its own
//! compliance (`zone`; eq. 4.16). Its matrix K_zz is a principal submatrix of K, so that K_zz is definite also where
//! the zone is held by its neighbours alone, and a sweep in turn (Gauss-Seidel) is a minimization of the energy over
//! the zone's nodes: it always converges to the solution of K u = F, from any start.
//! Zones at once (Jacobi) read the sweep before; where zones disagree on a frontier node the lowest zone's value
//! counts. With two zones 2 n sweeps are worth n in turn.
//!
//! Order of a visit, where the report differs: forces that hold imposed displacements are computed after the
//! neighbours' forces, which they subtract; before them (s. 4.4.1) the fixed point is wrong. A displacement imposed
//! on a frontier node is imposed in each of its zones. Forces of more than two zones on a node are exact:
//! g_p = F_p - sum over neighbours j outside the zone of B^pj u_j, where eq. 4.15 leaves a case out.
//!
//! [`Method::AllNodes`] (the report's B, retained there) keeps all displacements of a zone and derives forces from
//! positions; [`Method::Surface`] (A) keeps those of surface and frontier, and the frontier forces themselves.
//!
//! Frontier between tensor-mass and pre-computed ([`Overlap`]). With an overlap of two nodes the pre-computed zone has
//! the frontier nodes and sees the first tensor-mass nodes behind them, and these see the frontier: Schwarz's
//! alternation. Eliminating the pre-computed nodes can only soften what the others feel, so the stable step stays.
//! More nodes: tensor-mass moves copies of nodes further into the neighbour; that converges where it comes to rest
//! between two exchanges and can make energy where it does not. With one node the frontier alone is common:
//! tensor-mass has displacements imposed there and returns forces, to which the pre-computed zone, made of its own
//! tetrahedra, answers with displacements (Cotin's loop, fig. 4.13). That needs a relaxation below 2 / (1 + rho), rho
//! the largest ratio of tensor-mass' stiffness at the frontier to the neighbour's.
//!
//! A non-linear zone ([`ZoneLaw::NonlinearTensorMass`]) is exchanged in the same way: its neighbours keep the tensors of
//! small strain in their matrices, and are loaded with what these bear too much, at the displacements of the sweep
//! before. The fixed point is the equilibrium with the non-linear forces.
//!
//! Left out: the variant of P.-L. Lions (1990, third international symposium on domain decomposition methods), which
//! exchanges normal derivatives plus lambda times values between zones without overlap. The stress of linear
//! tetrahedra jumps at a frontier, so that a normal derivative at its nodes is not defined but by the nodal forces
//! used here; a Robin condition lambda u in each zone's matrix would have to be tuned for every mesh and partition
//! and would make a pre-computed zone depend on who its neighbours are, also when one of them turns dynamic.

mod build;
mod cost;
mod dense;
mod dynamic;
mod edit;
mod zone;

pub use cost::{ExchangeCount, ZoneSize};
pub use edit::EditReport;

use self::dynamic::{DynamicZones, Parts};
use self::zone::{PrecomputedZone, Shared};
use super::NAME;
use crate::material::LinearElastic;
use crate::model::{
    Constraints, DeformableModel, ImposedDisplacement, ModelReport, ModelState, NodalForce, TopologyRefusal,
};
use crate::solve::{MeshEdges, SolveError, StiffnessTensors};
use glisson_mesh::math::{DMat3, DVec3};
use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::zones::Zones;
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};
use rayon::prelude::*;
use std::sync::Arc;

/// Why a hybrid model cannot be built, or an edit of it failed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ExchangeError {
    /// The mesh with its fixed nodes has no solution.
    #[error(transparent)]
    Solve(#[from] SolveError),
    /// The number of laws is not that of the zones.
    #[error("{found} laws are given for {n_zones} zones; allowed: one for each")]
    LawCount {
        /// Laws given.
        found: usize,
        /// Zones there are.
        n_zones: usize,
    },
    /// An impossible number.
    #[error("{what} is {found}; allowed: {allowed}")]
    Parameter {
        /// Which one, with its unit.
        what: &'static str,
        /// What was given.
        found: f64,
        /// What may be given.
        allowed: &'static str,
    },
    /// A pre-computed zone that nothing holds.
    #[error(
        "zone {zone} is held by tensor-mass zones alone, and with an overlap of one node these do not count: fix \
         nodes of it, make it tensor-mass, or take an overlap of two nodes"
    )]
    WithoutSupport {
        /// Which zone.
        zone: usize,
    },
    /// The tensors of a zone do not fit in memory.
    #[error("the tensors of zone {zone} need {bytes} bytes of memory")]
    Memory {
        /// Which zone.
        zone: usize,
        /// What they take.
        bytes: u128,
    },
    /// The law of cut zones cannot be cut.
    #[error("cut_law is Precomputed; allowed: TensorMass or NonlinearTensorMass, which can be cut")]
    CutLaw,
    /// No such zone.
    #[error("there is no zone {zone}; allowed: 0 to {}", n_zones - 1)]
    NoSuchZone {
        /// Which zone.
        zone: usize,
        /// Zones there are.
        n_zones: usize,
    },
    /// No such tetrahedron.
    #[error("there is no tetrahedron {}; allowed: 0 to {}", tet.index(), n_tets - 1)]
    NoSuchTet {
        /// Which one.
        tet: TetId,
        /// Tetrahedra of the body at rest.
        n_tets: usize,
    },
}

/// How a zone is solved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ZoneLaw {
    /// By its compliance: always in equilibrium with what is around it.
    Precomputed,
    /// Explicit linear dynamics, which can be cut.
    TensorMass,
    /// The same of St Venant-Kirchhoff tissue, correct under large rotations.
    NonlinearTensorMass,
}

/// What the pre-computed zones store.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// A: displacements of surface and frontier, and frontier forces. Inner nodes are published at rest.
    Surface,
    /// B: displacements of all nodes.
    #[default]
    AllNodes,
}

/// In which order a sweep visits the pre-computed zones; tensor-mass zones have moved before.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SweepOrder {
    /// One after the other, each with the latest values of the others.
    #[default]
    GaussSeidel,
    /// All at once, with the values from before the sweep.
    Jacobi,
}

/// Which forces are passed on in a sweep. The solution stays the same: the others are passed on later.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum ExchangeAmount {
    /// Every frontier node's force.
    #[default]
    All,
    /// Every `n_sets`-th frontier node's force in turn.
    InTurn {
        /// Number of sets, at least 1.
        n_sets: u32,
    },
    /// Forces whose change is at least this share of the zone's largest change.
    Largest {
        /// From 0 (all) to 1 (the largest alone).
        share: f64,
    },
}

/// The overlap of tensor-mass and pre-computed zones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Overlap {
    /// The frontier nodes: displacements one way, forces the other way.
    OneNode {
        /// Share of the frontier's change that tensor-mass follows in one sweep, above 0 to 1.
        relaxation: f64,
    },
    /// A band so many nodes wide, at least 2: displacements both ways. Above 2 with all nodes kept only, and for
    /// steps in which tensor-mass comes to rest.
    Nodes(u32),
}

impl Default for Overlap {
    fn default() -> Self {
        Self::Nodes(2)
    }
}

/// Parameters of the hybrid model.
#[derive(Clone, Copy, Debug)]
pub struct ExchangeParams<'a> {
    /// The body at rest.
    pub mesh: &'a TetMesh,
    /// Its material.
    pub material: &'a LinearElastic,
    /// Nodes that never move.
    pub fixed_nodes: &'a [NodeId],
    /// The zones.
    pub zones: &'a Zones,
    /// The law of each zone.
    pub laws: &'a [ZoneLaw],
    /// What pre-computed zones store.
    pub method: Method,
    /// Order of the visits.
    pub order: SweepOrder,
    /// What is passed on in a sweep.
    pub amount: ExchangeAmount,
    /// Overlap of tensor-mass and pre-computed zones.
    pub overlap: Overlap,
    /// Sweeps in a step, at least 1; tensor-mass zones move by an equal part of the step in each.
    pub sweeps_per_step: u32,
    /// d of the damping C = d M of tensor-mass zones [1/s].
    pub damping_per_s: f64,
    /// The law of a pre-computed zone after a cut.
    pub cut_law: ZoneLaw,
}

impl<'a> ExchangeParams<'a> {
    /// Method B, one zone after the other, all forces, one sweep per step, no damping.
    pub fn new(
        mesh: &'a TetMesh,
        material: &'a LinearElastic,
        fixed_nodes: &'a [NodeId],
        zones: &'a Zones,
        laws: &'a [ZoneLaw],
    ) -> Self {
        Self {
            mesh,
            material,
            fixed_nodes,
            zones,
            laws,
            method: Method::default(),
            order: SweepOrder::default(),
            amount: ExchangeAmount::default(),
            overlap: Overlap::default(),
            sweeps_per_step: 1,
            damping_per_s: 0.0,
            cut_law: ZoneLaw::TensorMass,
        }
    }
}

/// The parts of the model that never change.
#[derive(Debug)]
struct Body {
    mesh: TetMesh,
    material: LinearElastic,
    zones: Zones,
    edges: MeshEdges,
    /// Neighbours of each node and the edges to them.
    neighbours: zone::Lists<(NodeId, u32)>,
    is_fixed: Vec<bool>,
    is_on_surface: Vec<bool>,
}

/// How the model is run.
#[derive(Clone, Copy, Debug)]
struct Settings {
    method: Method,
    order: SweepOrder,
    amount: ExchangeAmount,
    overlap: Overlap,
    sweeps_per_step: u32,
    damping_per_s: f64,
    cut_law: ZoneLaw,
}

/// A body of pre-computed and tensor-mass zones.
#[derive(Debug)]
pub struct HybridExchange {
    body: Arc<Body>,
    settings: Settings,
    laws: Vec<ZoneLaw>,
    is_live: Vec<bool>,
    is_cut: bool,
    /// K of all live tetrahedra, and K in the matrices of the pre-computed zones.
    all: Arc<StiffnessTensors>,
    compliant: Arc<StiffnessTensors>,

    zones: Vec<PrecomputedZone>,
    dynamic: DynamicZones,
    shared: Shared,
    velocity_m_per_s: Vec<DVec3>,
    positions_m: Vec<DVec3>,
    /// Displacements before the last step [m], and its length [s].
    before_m: Vec<DVec3>,
    last_dt_s: f64,
    rest_gravity_m_per_s2: DVec3,

    constraints: Constraints,
    constraint_forces_n: Vec<DVec3>,
    /// Constraints of the last application for which there was no room.
    n_without_room: u32,
    n_ignored: u32,
    n_sweeps: u64,
    n_parts: u64,
    count: ExchangeCount,
    n_rebuilt: u32,
}

impl Clone for HybridExchange {
    fn clone(&self) -> Self {
        let n = self.positions_m.len();
        let mut constraints = room_for_constraints(n);
        constraints.displacements.extend_from_slice(&self.constraints.displacements);
        constraints.forces.extend_from_slice(&self.constraints.forces);
        let mut constraint_forces_n = Vec::with_capacity(n);
        constraint_forces_n.extend_from_slice(&self.constraint_forces_n);
        Self {
            body: Arc::clone(&self.body),
            laws: self.laws.clone(),
            is_live: self.is_live.clone(),
            all: Arc::clone(&self.all),
            compliant: Arc::clone(&self.compliant),
            zones: self.zones.clone(),
            dynamic: self.dynamic.clone(),
            shared: self.shared.clone(),
            velocity_m_per_s: self.velocity_m_per_s.clone(),
            positions_m: self.positions_m.clone(),
            before_m: self.before_m.clone(),
            constraints,
            constraint_forces_n,
            ..*self
        }
    }
}

fn room_for_constraints(n_nodes: usize) -> Constraints {
    Constraints { displacements: Vec::with_capacity(n_nodes), forces: Vec::with_capacity(n_nodes) }
}

/// B^pj of an edge as seen from p.
fn edge_tensor(tensors: &StiffnessTensors, p: NodeId, j: NodeId, edge: u32) -> DMat3 {
    let along = tensors.edge[edge as usize];
    if p < j { along } else { along.transpose() }
}

impl HybridExchange {
    /// Latest displacements of all nodes [m]. Inner nodes of pre-computed zones stay zero with method A.
    pub fn displacements_m(&self) -> &[DVec3] {
        &self.shared.displacement_m
    }

    /// How each zone is solved now.
    pub fn laws(&self) -> &[ZoneLaw] {
        &self.laws
    }

    /// N, F and S of each pre-computed zone, with its number.
    pub fn zone_sizes(&self) -> impl Iterator<Item = (usize, ZoneSize)> + '_ {
        self.zones.iter().map(|zone| {
            let size = ZoneSize {
                n_nodes: zone.nodes.len() as u64,
                n_frontier: zone.n_frontier as u64,
                n_surface: (zone.n_loadable - zone.n_frontier) as u64,
            };
            (zone.zone, size)
        })
    }

    /// Tensors that pre-computed zones store for forces on nodes; those for gravity are not among them.
    pub fn n_tensors(&self) -> usize {
        self.zones.iter().map(|z| z.table.len() / 9 - z.stride() / 9).sum()
    }

    /// Edges, seen from a frontier node, that leave its pre-computed zone: products per sweep for neighbours' forces.
    pub fn n_leaving_edges(&self) -> usize {
        self.zones.iter().map(|z| z.incoming.nodes.n_items() + z.incoming.dynamic.n_items()).sum()
    }

    /// What the last step computed.
    pub fn count(&self) -> ExchangeCount {
        self.count
    }

    /// Nodes that move in tensor-mass zones.
    pub fn n_moving_nodes(&self) -> usize {
        self.dynamic.nodes.len()
    }

    /// Largest stable step of the tensor-mass zones [s]; longer ones are divided.
    pub fn stable_step_s(&self) -> f64 {
        self.dynamic.stable_step_s
    }

    /// Declares that the rest shape is the one under this gravity [m/s2].
    pub fn carry_at_rest(&mut self, gravity_m_per_s2: DVec3) {
        self.rest_gravity_m_per_s2 = gravity_m_per_s2;
        self.shared.pull_m_per_s2 = DVec3::ZERO;
        self.zones.iter_mut().for_each(PrecomputedZone::renew);
    }

    /// Sets the number of sweeps per step.
    ///
    /// # Errors
    /// [`ExchangeError::Parameter`] for zero.
    pub fn set_sweeps_per_step(&mut self, sweeps_per_step: u32) -> Result<(), ExchangeError> {
        build::check_sweeps(sweeps_per_step)?;
        self.settings.sweeps_per_step = sweeps_per_step;
        Ok(())
    }

    /// Returns to rest without constraints; removed tetrahedra stay removed.
    pub fn reset(&mut self) {
        self.constraints.displacements.clear();
        self.constraints.forces.clear();
        self.constraint_forces_n.clear();
        (self.n_without_room, self.n_ignored) = (0, 0);
        // The sets of an exchange in turn, and the renewals, depend on the number of sweeps.
        (self.n_sweeps, self.n_parts, self.last_dt_s) = (0, 0, 0.0);
        self.count = ExchangeCount::default();
        self.zones.iter_mut().for_each(PrecomputedZone::reset);
        self.dynamic.clear_constraints();
        let Shared { displacement_m, dynamic_view_m, outgoing_n, .. } = &mut self.shared;
        displacement_m.fill(DVec3::ZERO);
        dynamic_view_m.fill(DVec3::ZERO);
        outgoing_n.iter_mut().for_each(|forces| forces.fill(DVec3::ZERO));
        self.shared.surplus_n.fill(DVec3::ZERO);
        self.velocity_m_per_s.fill(DVec3::ZERO);
        self.before_m.fill(DVec3::ZERO);
        self.positions_m.copy_from_slice(&self.body.mesh.positions_m);
    }

    /// [`DeformableModel::step`] with the pre-computed zones of a Jacobi sweep as tasks of the current rayon pool. The
    /// bits are those of one thread.
    pub fn step_in_pool(&mut self, dt_s: f64) {
        self.step_with(dt_s, true);
    }

    fn step_with(&mut self, dt_s: f64, in_pool: bool) {
        self.before_m.copy_from_slice(&self.shared.displacement_m);
        self.last_dt_s = dt_s;
        self.count = ExchangeCount::default();
        self.n_parts = 0;
        let n_sweeps = u64::from(self.settings.sweeps_per_step);
        let n_parts = self.dynamic.parts_of(dt_s / n_sweeps as f64);
        let n_all = n_parts * n_sweeps;
        for sweep in 0..n_sweeps {
            if n_parts > 0 && dt_s > 0.0 {
                let h_s = dt_s / n_all as f64;
                let parts = Parts { h_s, n_now: n_parts, n_gone: sweep * n_parts, n_all };
                self.dynamic.advance(&mut self.shared, &mut self.velocity_m_per_s, parts);
            }
            self.sweep_precomputed(in_pool);
        }
        self.n_parts = n_all;
        self.count.n_sweeps = n_sweeps;
        for zone in &mut self.zones {
            self.count.add(&std::mem::take(&mut zone.count));
        }
        self.count.add(&std::mem::take(&mut self.dynamic.count));
        self.collect();
    }

    fn sweep_precomputed(&mut self, in_pool: bool) {
        let (amount, sweep) = (self.settings.amount, self.n_sweeps);
        self.n_sweeps += 1;
        let Self { zones, shared, .. } = self;
        match self.settings.order {
            SweepOrder::GaussSeidel => {
                for zone in zones {
                    zone.visit(shared, amount, sweep);
                    publish(zone, shared, false);
                }
            }
            SweepOrder::Jacobi => {
                if in_pool {
                    zones.par_iter_mut().with_max_len(1).for_each(|zone| zone.visit(shared, amount, sweep));
                } else {
                    zones.iter_mut().for_each(|zone| zone.visit(shared, amount, sweep));
                }
                zones.iter().for_each(|zone| publish(zone, shared, true));
            }
        }
    }

    /// Publishes positions and constraint forces.
    fn collect(&mut self) {
        let rest_m = &self.body.mesh.positions_m;
        for (n, position_m) in self.positions_m.iter_mut().enumerate() {
            *position_m = rest_m[n] + self.shared.displacement_m[n];
        }
        for (place, force_n) in self.dynamic.reactions_n() {
            self.constraint_forces_n[place as usize] = force_n;
        }
        // The lowest zone of a frontier node writes last.
        for (place, force_n) in self.zones.iter().rev().flat_map(PrecomputedZone::reactions_n) {
            self.constraint_forces_n[place as usize] = force_n;
        }
    }

    /// Distributes the constraints to the zones.
    fn distribute(&mut self) {
        self.n_ignored = self.n_without_room;
        self.zones.iter_mut().for_each(PrecomputedZone::clear_constraints);
        self.dynamic.clear_constraints();
        for &NodalForce { node, force_n } in &self.constraints.forces {
            let mut is_taken = false;
            if force_n.is_finite() {
                for zone in &mut self.zones {
                    if let Some(loadable) = zone.loadable_of(node) {
                        zone.add_outer_force(loadable, force_n);
                        is_taken = true;
                    }
                }
                if let Some(moving) = self.dynamic.moving_of(node) {
                    self.dynamic.add_outer_force(moving, force_n);
                    is_taken = true;
                }
            }
            self.n_ignored += u32::from(!is_taken);
        }
        for (place, imposed) in self.constraints.displacements.iter().enumerate() {
            let ImposedDisplacement { node, displacement_m } = *imposed;
            let mut is_taken = false;
            if displacement_m.is_finite() {
                for zone in &mut self.zones {
                    if let Some(loadable) = zone.loadable_of(node) {
                        is_taken |= zone.impose(place as u32, loadable, displacement_m);
                    }
                }
                if let Some(moving) = self.dynamic.moving_of(node) {
                    is_taken |= self.dynamic.impose(place as u32, moving, displacement_m);
                }
            }
            self.n_ignored += u32::from(!is_taken);
        }
        self.zones.iter_mut().for_each(PrecomputedZone::factor_imposed);
        self.constraint_forces_n.clear();
        self.constraint_forces_n.resize(self.constraints.displacements.len(), DVec3::ZERO);
    }
}

/// Publishes a zone's results to the others; `as_owner`: only those of nodes that no lower zone has.
fn publish(zone: &PrecomputedZone, shared: &mut Shared, as_owner: bool) {
    for (row, node) in zone.nodes[..zone.n_rows].iter().enumerate() {
        if !as_owner || zone.is_owner[row] {
            shared.displacement_m[node.index()] = zone.displacement_m(row);
        }
    }
    if zone.n_force_rows > 0 {
        zone.outgoing_into(&mut shared.outgoing_n[zone.zone]);
    }
}

impl DeformableModel for HybridExchange {
    fn apply(&mut self, constraints: &Constraints) {
        // There is room for one constraint per node; a longer list has repetitions, and its end is left out.
        let n = self.positions_m.len();
        self.constraints.displacements.clear();
        self.constraints.forces.clear();
        self.constraints.displacements.extend(constraints.displacements.iter().take(n));
        self.constraints.forces.extend(constraints.forces.iter().take(n));
        let beyond = |length: usize| length.saturating_sub(n) as u32;
        self.n_without_room = beyond(constraints.displacements.len()) + beyond(constraints.forces.len());
        self.distribute();
    }

    /// [`ExchangeParams::sweeps_per_step`] sweeps; tensor-mass zones advance by `dt_s` in parts that are stable.
    fn step(&mut self, dt_s: f64) {
        self.step_with(dt_s, false);
    }

    fn state(&self) -> ModelState<'_> {
        ModelState { positions_m: &self.positions_m, velocities_m_per_s: &self.velocity_m_per_s }
    }

    fn history_into(&self, _numbers: &mut Vec<f64>) {}

    fn constraint_forces_n(&self) -> &[DVec3] {
        &self.constraint_forces_n
    }

    /// A node whose position is not finite stays where it is.
    fn take_over(&mut self, positions_m: &[DVec3]) {
        let rest_m = &self.body.mesh.positions_m;
        assert_eq!(positions_m.len(), rest_m.len(), "one position a node");
        for n in 0..rest_m.len() {
            let displacement_m = if self.body.is_fixed[n] {
                DVec3::ZERO
            } else if positions_m[n].is_finite() {
                positions_m[n] - rest_m[n]
            } else {
                self.shared.displacement_m[n]
            };
            self.shared.displacement_m[n] = displacement_m;
            self.positions_m[n] = rest_m[n] + displacement_m;
        }
        self.shared.dynamic_view_m.copy_from_slice(&self.shared.displacement_m);
        self.before_m.copy_from_slice(&self.shared.displacement_m);
        self.velocity_m_per_s.fill(DVec3::ZERO);
        self.constraint_forces_n.fill(DVec3::ZERO);
    }

    /// Ignores a gravity that is not finite.
    fn set_gravity(&mut self, gravity_m_per_s2: DVec3) {
        if gravity_m_per_s2.is_finite() {
            self.shared.pull_m_per_s2 = gravity_m_per_s2 - self.rest_gravity_m_per_s2;
            self.zones.iter_mut().for_each(PrecomputedZone::renew);
        }
    }

    fn report(&self) -> ModelReport {
        let moving = self.dynamic.nodes.iter().zip(&self.dynamic.mass_kg);
        ModelReport {
            n_parts: self.n_parts.max(1) as u32,
            n_ignored_constraints: self.n_ignored,
            n_quarantined_tets: self.dynamic.n_inverted,
            first_quarantined: self.dynamic.first_inverted,
            kinetic_energy_j: moving
                .map(|(node, m)| 0.5 * m * self.velocity_m_per_s[node.index()].length_squared())
                .sum(),
            n_reanalyses: self.n_rebuilt,
            ..ModelReport::default()
        }
    }

    fn duplicate(&self) -> Box<dyn DeformableModel> {
        Box::new(self.clone())
    }

    /// Follows removals; zones that lose a tetrahedron become tensor-mass.
    fn topology_changed(&mut self, _: &TetMesh, change: &TopologyChange) -> Result<(), TopologyRefusal> {
        let refused = |reason| Err(TopologyRefusal::Frozen { model: NAME, reason });
        let has_new = !change.tets.added.ids().is_empty() || !change.nodes.added.ids().is_empty();
        if has_new || !change.moved_nodes.is_empty() || change.is_renumbering() {
            return refused("it follows removals of tetrahedra only: make it anew for other edits");
        }
        let removed: Vec<TetId> = change.tets.removed.clone();
        match self.remove_tets(&removed) {
            Ok(_) => Ok(()),
            Err(ExchangeError::NoSuchTet { .. }) => {
                refused("a tetrahedron that goes is none of its mesh: make it anew for another mesh")
            }
            Err(_) => refused("a zone next to the cut cannot be pre-computed any more: make it tensor-mass"),
        }
    }
}
