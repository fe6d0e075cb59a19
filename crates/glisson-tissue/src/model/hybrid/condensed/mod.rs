//! The hybrid model by exact condensation: pre-computed zones that follow at once, dynamic ones that can be cut.
//!
//! Each zone of a mesh is pre-computed (quasi-static, linear) or dynamic (tensor-mass, linear or of St Venant-Kirchhoff
//! tissue). A pre-computed zone keeps
//! what follows from its own tetrahedra alone (`zone`), so cutting or switching one zone leaves the others' data
//! valid. Their common frontier is solved exactly in every step (`interface`); the iterations of seed `003`
//! (s. 4.3.2.2) are not needed. All dynamic zones move as one body (`dynamic`) that feels the rest through a dense
//! stiffness on its frontier. Seed `003` weighs condensation and puts it aside for its storage (s. 4.3.2.2); the
//! tables are what makes a step cheap here.
//!
//! What a step reads: for every loaded node three columns of its zone's compliance, composed beforehand with what
//! the rest of the body gives way, so that a zone with the only load needs nothing else; the extension of a zone, when
//! something outside it moves its frontier; for more than [`MANY_LOADS`] loads on a zone, or one on a node whose
//! columns are not stored, one solution with the zone's factor instead of the columns.
//!
//! **Cuts.** Removing a tetrahedron of a dynamic zone subtracts its tensors. Removing one of a pre-computed zone makes
//! the zone dynamic first ([`CondensedParams::cut_law`]), from where it is, with the velocity of its last step. A pre-computed zone that nothing
//! holds any more, or that hangs on a piece cut loose, becomes dynamic too, because only dynamic tissue has inertia:
//! the piece falls.
//!
//! **Non-linear zones** turn and stretch as St Venant-Kirchhoff tissue does, the rest stays linear: the exact interface
//! holds the zone by the rest's small-strain stiffness. It equals a wholly non-linear body as far as the pre-computed
//! zones turn and strain little. Where a pre-computed zone that is much deformed becomes non-linear, its forces jump from
//! those of the one law to those of the other.
//!
//! After any edit the model is the one that would be built from what is left, with these laws.

mod build;
mod columns;
mod contact;
mod dynamic;
mod edit;
mod interface;
mod local;
mod params;
mod step;
mod zone;

pub use self::params::{CondensedError, CondensedParams, CondensedSize, Loadable, Updated, ZoneLaw};
pub use crate::model::precomputed::{Precision, StoredNodes};

use self::contact::ContactSystem;
use self::dynamic::DynamicPart;
use self::interface::Interface;
use self::zone::{PrecomputedZone, Whole};
use crate::material::LinearElastic;
use crate::model::roomy::Roomy;
use crate::model::{
    Attachment, Constraints, DeformableModel, ImposedDisplacement, LocalModel, LocalWork, ModelReport,
    ModelState, NodalForce, Rayleigh, RestStress, TopologyRefusal,
};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::{NodeId, TetMesh};

/// Loads on a pre-computed zone from which on its factor is used instead of stored columns.
pub const MANY_LOADS: usize = 64;

/// What a node belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    /// Does not move: held wholly, or without a tetrahedron.
    Nowhere,
    /// A pre-computed zone, and which of its own nodes.
    Own { zone: u32, own: u32 },
    /// The frontier between pre-computed zones.
    Condensed(u32),
    /// The dynamic part.
    Dynamic(u32),
}

/// A force on a node of a pre-computed zone or of their frontier.
#[derive(Clone, Copy, Debug)]
struct Load {
    place: Place,
    force_n: DVec3,
}

/// A node of a pre-computed zone that a tool holds.
#[derive(Clone, Copy, Debug)]
struct Held {
    /// Place among the constraints.
    at: u32,
    place: Place,
    target_m: DVec3,
    /// Where it would be without the tools, with the dynamic nodes at rest.
    without_m: DVec3,
    force_n: DVec3,
}

/// Numbers of a pre-computed zone that change from step to step.
#[derive(Clone, Default)]
struct ZoneWork {
    /// Response to the constant loads, the frontier held, of all own nodes [m].
    constant_m: Vec<f64>,
    /// The same of the stored rows, with what the rest gives way.
    base_m: Vec<f64>,
    /// Displacements of the stored rows [m].
    rows_m: Vec<f64>,
    /// Displacements of p through the zone's own loads [m].
    own_m: Vec<f64>,
    /// Displacements or forces of its frontier.
    frontier: Vec<f64>,
    /// Its loads go through the factor.
    is_solved: bool,
    /// It has loads or tools.
    is_loaded: bool,
}

/// How old the shown positions of some nodes are.
#[derive(Clone, Copy)]
struct Age {
    /// Time [s] of the steps since they were written.
    since_s: f64,
    /// They were given, at rest or by a model before, so that they tell nothing about the velocity.
    was_given: bool,
}

impl Age {
    const GIVEN: Self = Self { since_s: 0.0, was_given: true };

    fn is_stale(self) -> bool {
        self.since_s > 0.0
    }

    /// One over the time that a way to the places of now has taken [1/s], 0 when that is not known; the places are
    /// those of now afterwards.
    fn renew(&mut self) -> f64 {
        let per_s = if self.was_given || self.since_s <= 0.0 { 0.0 } else { 1.0 / self.since_s };
        *self = Self { since_s: 0.0, was_given: false };
        per_s
    }
}

/// Ages of a zone's nodes: those of the surface, the other stored ones, those without rows.
type Ages = [Age; 3];

/// One organ of pre-computed and dynamic zones.
#[derive(Clone)]
pub struct CondensedHybrid {
    // Description; tetrahedra that are gone stay in the lists until a compaction.
    mesh: TetMesh,
    material: LinearElastic,
    density_kg_per_m3: f64,
    rest_stress_pa: Vec<RestStress>,
    attachments: Vec<Attachment>,
    gravity_m_per_s2: DVec3,
    damping: Rayleigh,
    time_step_s: f64,
    most_parts: u32,
    stored: StoredNodes,
    precision: Precision,
    held_axes: Vec<[bool; 3]>,
    is_live: Vec<bool>,
    zone_of_tet: Vec<u32>,
    laws: Vec<ZoneLaw>,
    cut_law: ZoneLaw,
    largest_stretch: f64,

    // Mechanics.
    zones: Vec<PrecomputedZone>,
    /// Number of each pre-computed zone.
    zone_numbers: Vec<u32>,
    interface: Interface,
    dynamic: Option<DynamicPart>,
    place: Vec<Place>,
    is_dynamic: Vec<bool>,

    // State: that of the dynamic part, and these.
    positions_m: Vec<DVec3>,
    velocities_m_per_s: Vec<DVec3>,
    /// One a pre-computed zone.
    ages: Vec<Ages>,
    /// Of the frontier nodes between pre-computed zones.
    condensed_age: Age,

    // Constraints.
    constraints: Constraints,
    loads: Roomy<Load>,
    held: Roomy<Held>,
    dynamic_constraints: Constraints,
    /// Place among the constraints of each that the dynamic part has.
    dynamic_places: Roomy<u32>,
    constraint_forces_n: Roomy<DVec3>,
    n_ignored: u32,
    /// Constraints beyond one a node, which have no room.
    n_dropped: u32,
    /// How often an edit made the interface anew.
    n_rebuilt: u32,
    updated: Updated,

    // Scratch.
    work: Vec<ZoneWork>,
    /// Constant loads alone: displacements of p, forces on d.
    constant: Vec<f64>,
    /// With the loads.
    reduced: Vec<f64>,
    row: Vec<f64>,
    system: ContactSystem,
    /// Of the dynamic nodes of a patch, by the dynamic part's numbers.
    local: LocalModel,
}

impl CondensedHybrid {
    /// Most nodes of pre-computed zones that tools can hold at once.
    pub const MAX_HELD: usize = 64;

    /// Room in the lists, which a copy of a list has not.
    fn make_room(&mut self) {
        self.local = LocalModel::new();
        let n_nodes = self.mesh.positions_m.len();
        for constraints in [&mut self.constraints, &mut self.dynamic_constraints] {
            constraints.displacements.reserve(n_nodes - constraints.displacements.len().min(n_nodes));
            constraints.forces.reserve(n_nodes - constraints.forces.len().min(n_nodes));
        }
    }

    /// Nodes of live tetrahedra in dynamic zones that are not held wholly.
    fn find_dynamic_nodes(&mut self) {
        self.is_dynamic.clear();
        self.is_dynamic.resize(self.mesh.positions_m.len(), false);
        for (t, nodes) in self.mesh.tetrahedra.iter().enumerate() {
            if self.is_live[t] && self.law_of(t).is_dynamic() {
                for n in nodes.iter().filter(|n| self.held_axes[n.index()] != [true; 3]) {
                    self.is_dynamic[n.index()] = true;
                }
            }
        }
    }

    fn law_of(&self, tet: usize) -> ZoneLaw {
        self.laws[self.zone_of_tet[tet] as usize]
    }

    fn whole(&self) -> Whole<'_> {
        Whole {
            mesh: &self.mesh,
            material: &self.material,
            density_kg_per_m3: self.density_kg_per_m3,
            rest_stress_pa: &self.rest_stress_pa,
            held: &self.held_axes,
            is_loadable: &[],
            is_surface: &[],
            is_frontier: &[],
            stored: self.stored,
            precision: self.precision,
        }
    }

    /// Which positions the next steps bring up to date.
    pub fn set_updated(&mut self, updated: Updated) {
        self.updated = updated;
    }

    /// Other damping of the mass of dynamic zones [1/s], a finite number from 0; any other is left out.
    pub fn set_mass_damping(&mut self, mass_per_s: f64) {
        if mass_per_s.is_finite() && mass_per_s >= 0.0 {
            self.damping.mass_per_s = mass_per_s;
            if let Some(dynamic) = &mut self.dynamic {
                dynamic.motion.set_mass_damping(mass_per_s);
            }
        }
    }

    /// The law of each zone now.
    pub fn laws(&self) -> &[ZoneLaw] {
        &self.laws
    }

    /// Whether a tool can hold `node`.
    pub fn is_loadable(&self, node: NodeId) -> bool {
        match self.place.get(node.index()) {
            Some(&Place::Own { zone, own }) => (own as usize) < self.zones[zone as usize].n_loadable,
            Some(place) => *place != Place::Nowhere,
            None => false,
        }
    }

    /// Into how many equal parts the dynamic zones divide a step of `dt_s` now.
    pub fn parts_of_step(&self, dt_s: f64) -> u64 {
        self.dynamic.as_ref().map_or(1, |d| d.motion.parts_of_step(dt_s))
    }

    /// Largest stable step [s] of the dynamic zones now.
    pub fn stable_step_s(&self) -> Option<f64> {
        self.dynamic.as_ref().map(|d| d.motion.stable_step_s())
    }

    /// Stiffness [N/m] of the pre-computed zones that the nodes they share with dynamic ones feel, these nodes
    /// ascending: 3 x 3 times their number, by columns, symmetric.
    pub fn condensed_stiffness_n_per_m(&self) -> (&[NodeId], &[f64]) {
        (&self.interface.nodes[self.interface.n_condensed..], self.interface.stiffness_on_dynamic.numbers())
    }

    /// How large it is.
    pub fn size(&self) -> CondensedSize {
        let n_condensed_nodes = self.interface.n_condensed;
        CondensedSize {
            n_precomputed_zones: self.zones.len(),
            n_condensed_nodes,
            n_dynamic_frontier_nodes: self.interface.nodes.len() - n_condensed_nodes,
            n_dynamic_nodes: self.is_dynamic.iter().filter(|d| **d).count(),
            n_loadable_nodes: n_condensed_nodes + self.zones.iter().map(|z| z.n_loadable).sum::<usize>(),
            bytes: self.interface.bytes() + self.zones.iter().map(PrecomputedZone::bytes).sum::<usize>(),
        }
    }

    fn note_constraints(&mut self) {
        self.n_ignored = self.n_dropped;
        self.loads.clear();
        self.held.clear();
        self.dynamic_places.clear();
        self.dynamic_constraints.forces.clear();
        self.dynamic_constraints.displacements.clear();
        self.work.iter_mut().for_each(|work| (work.is_solved, work.is_loaded) = (false, false));
        let place_of = |n: NodeId| self.place.get(n.index()).copied().unwrap_or(Place::Nowhere);
        for force in &self.constraints.forces {
            let force_n = force.force_n;
            let is_taken = match place_of(force.node) {
                _ if !force_n.is_finite() => false,
                Place::Nowhere => false,
                Place::Dynamic(local) => {
                    let node = NodeId(local);
                    self.dynamic_constraints.forces.push(NodalForce { node, force_n });
                    true
                }
                place => self.loads.try_push(Load { place, force_n }),
            };
            self.n_ignored += u32::from(!is_taken);
        }
        for (at, imposed) in self.constraints.displacements.iter().enumerate() {
            let (at, target_m) = (at as u32, imposed.displacement_m);
            let is_taken = match place_of(imposed.node) {
                _ if !target_m.is_finite() => false,
                Place::Nowhere => false,
                Place::Dynamic(local) => {
                    let imposed = ImposedDisplacement { node: NodeId(local), displacement_m: target_m };
                    self.dynamic_constraints.displacements.push(imposed);
                    self.dynamic_places.try_push(at)
                }
                Place::Own { zone, own } if own as usize >= self.zones[zone as usize].n_loadable => false,
                place => {
                    let (without_m, force_n) = (DVec3::ZERO, DVec3::ZERO);
                    let held = Held { at, place, target_m, without_m, force_n };
                    self.held.len() < Self::MAX_HELD && self.held.try_push(held)
                }
            };
            self.n_ignored += u32::from(!is_taken);
        }
        for (z, work) in self.work.iter_mut().enumerate() {
            let of_zone = |load: &&Load| matches!(load.place, Place::Own { zone, .. } if zone as usize == z);
            let n_loadable = self.zones[z].n_loadable;
            let beyond =
                |load: &Load| matches!(load.place, Place::Own { own, .. } if own as usize >= n_loadable);
            let n_loads = self.loads.iter().filter(of_zone).count();
            work.is_solved = n_loads > MANY_LOADS || self.loads.iter().filter(of_zone).any(beyond);
            work.is_loaded = n_loads > 0
                || self.held.iter().any(|h| matches!(h.place, Place::Own { zone, .. } if zone as usize == z));
        }
        self.constraint_forces_n.clear();
        self.constraint_forces_n.resize(self.constraints.displacements.len(), DVec3::ZERO);
        if let Some(dynamic) = &mut self.dynamic {
            dynamic.motion.apply(&self.dynamic_constraints);
        }
    }
}

impl DeformableModel for CondensedHybrid {
    fn apply(&mut self, constraints: &Constraints) {
        let n_nodes = self.mesh.positions_m.len();
        // Room was made for every node; more is a list with repetitions, whose rest counts as ignored.
        let fill = |from: usize| from.min(n_nodes);
        let beyond = |len: usize| len.saturating_sub(n_nodes) as u32;
        self.n_dropped = beyond(constraints.forces.len()) + beyond(constraints.displacements.len());
        self.constraints.forces.clear();
        self.constraints.displacements.clear();
        let n_forces = fill(constraints.forces.len());
        self.constraints.forces.extend_from_slice(&constraints.forces[..n_forces]);
        let n_displacements = fill(constraints.displacements.len());
        self.constraints.displacements.extend_from_slice(&constraints.displacements[..n_displacements]);
        self.note_constraints();
    }

    /// Advances the dynamic zones by `dt_s`, divided as the tensor-mass model does; the pre-computed ones follow in
    /// every part, tools in them are where they are held from the first part on.
    fn step(&mut self, dt_s: f64) {
        if dt_s.is_finite() && dt_s > 0.0 {
            self.advance(dt_s);
        }
    }

    fn state(&self) -> ModelState<'_> {
        ModelState {
            positions_m: &self.positions_m,
            velocities_m_per_s: &self.velocities_m_per_s,
            history: self.dynamic.as_ref().map_or(&[], |d| d.motion.state().history),
        }
    }

    fn constraint_forces_n(&self) -> &[DVec3] {
        &self.constraint_forces_n
    }

    fn take_over(&mut self, positions_m: &[DVec3]) {
        assert_eq!(positions_m.len(), self.positions_m.len(), "one position a node");
        for n in 0..positions_m.len() {
            if self.place[n] != Place::Nowhere && positions_m[n].is_finite() {
                self.positions_m[n] = positions_m[n];
            }
            self.velocities_m_per_s[n] = DVec3::ZERO;
        }
        self.ages.fill([Age::GIVEN; 3]);
        self.condensed_age = Age::GIVEN;
        if let Some(dynamic) = &mut self.dynamic {
            dynamic.start(&self.mesh.positions_m, &self.positions_m, None);
        }
        self.constraint_forces_n.fill(DVec3::ZERO);
    }

    fn set_gravity(&mut self, gravity_m_per_s2: DVec3) {
        if let Some(dynamic) = &mut self.dynamic {
            dynamic.motion.set_gravity(gravity_m_per_s2);
        }
        if gravity_m_per_s2.is_finite() && gravity_m_per_s2 != self.gravity_m_per_s2 {
            self.gravity_m_per_s2 = gravity_m_per_s2;
            self.combine_constant_loads();
        }
    }

    fn report(&self) -> ModelReport {
        let of_dynamic = self
            .dynamic
            .as_ref()
            .map_or(ModelReport { n_parts: 1, ..ModelReport::default() }, DynamicPart::report);
        ModelReport {
            n_ignored_constraints: of_dynamic.n_ignored_constraints + self.n_ignored,
            n_reanalyses: self.n_rebuilt,
            ..of_dynamic
        }
    }

    /// Pre-computed nodes answer with their exact static compliance. What they pull on is felt at the dynamic nodes of
    /// the patch only, the other nodes between pre-computed and dynamic zones being held: over a period that is short for
    /// those, or without dynamic zones, it is exact, else too stiff. Dynamic nodes answer over the period
    /// ([`crate::model::local_model`]), with the pre-computed tetrahedra around them, of which the corners elsewhere
    /// are held. What tools hold in pre-computed tissue yields. Nodes that tools cannot hold do not yield. Positions of
    /// nodes that [`Updated`] leaves out are the shown ones.
    fn local_model_into(
        &mut self,
        patch: &[NodeId],
        period_s: f64,
        work: &mut LocalWork,
        out: &mut LocalModel,
    ) {
        self.fill_local_model(patch, period_s, work, out);
    }

    fn duplicate(&self) -> Box<dyn DeformableModel> {
        let mut copy = self.clone();
        copy.make_room();
        Box::new(copy)
    }

    /// Follows removals and compactions. Removals in dynamic zones away from the frontier allocate nothing; a zone that
    /// becomes dynamic does.
    fn topology_changed(&mut self, _: &TetMesh, change: &TopologyChange) -> Result<(), TopologyRefusal> {
        self.follow_change(change)
    }
}
