//! The hybrid model by exact condensation: pre-computed zones that follow at once, dynamic ones that can be cut.
//!
//! Each zone of a mesh is pre-computed (quasi-static, linear) or dynamic (tensor-mass, linear or St Venant-Kirchhoff).
//! The tables of a pre-computed zone depend on its own tetrahedra alone (`zone`), so cutting or switching one zone
//! leaves those of the others valid. The common frontier is solved exactly in every step (`interface`), without the
//! iterations of seed `003` (s. 4.3.2.2). All dynamic zones move as one body (`dynamic`), which feels the rest through
//! a dense stiffness on its frontier. Seed `003` rejects condensation for its memory (s. 4.3.2.2); here the tables make
//! a step cheap.
//!
//! **What a step reads.** For every loaded node, three columns of its zone's compliance. They include the compliance of
//! the rest of the body, so that a zone with the only load needs nothing else. When something outside a zone moves its
//! frontier: the zone's extension. With more than [`MANY_LOADS`] loads on a zone, or a load on a node whose columns are
//! not stored: one solution with the zone's factor instead of the columns.
//!
//! **Cuts.** Removing a tetrahedron of a dynamic zone subtracts its tensors; an edit that brings something in or moves it makes the
//! dynamic zones' body anew. An edit in a pre-computed zone first makes the zone dynamic ([`CondensedParams::cut_law`]), at its
//! present position and with the velocity of its last step (inside: the mean since its nodes were shown). A pre-computed zone also becomes dynamic when nothing holds it any more or when it belongs to a piece cut
//! loose: only dynamic tissue has inertia, and the piece has to fall.
//!
//! **Non-linear zones** rotate and stretch as St Venant-Kirchhoff tissue; the rest stays linear and holds them by its
//! small-strain stiffness. The result is that of a fully non-linear body as long as the pre-computed zones rotate and
//! strain little. When a strongly deformed pre-computed zone becomes non-linear, its forces jump from one law to the
//! other.
//!
//! After any edit the model is the one that would be built from the remaining mesh with the present laws.

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

pub use self::params::{
    CondensedError, CondensedParams, CondensedSize, INSIDE_PERIOD_S, Loadable, Updated, ZoneLaw,
};
pub use crate::model::precomputed::{Precision, StoredNodes};

use self::contact::ContactSystem;
use self::dynamic::DynamicPart;
use self::interface::Interface;
use self::zone::{PrecomputedZone, Whole};
use crate::material::LinearElastic;
use crate::model::bounded_vec::BoundedVec;
use crate::model::explicit::Mover;
use crate::model::{
    Attachment, Constraints, DeformableModel, ImposedDisplacement, LocalModel, LocalWork, ModelReport,
    ModelState, NodalForce, Rayleigh, RestStress, TopologyRefusal,
};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::{NodeId, TetMesh};

/// Number of loads on a pre-computed zone above which its factor is used instead of the stored columns.
pub const MANY_LOADS: usize = 64;

/// What a node belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    /// Does not move: held along all axes, or without a tetrahedron.
    Nowhere,
    /// A pre-computed zone; `own` is the node's number among the zone's own nodes.
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
    /// Its displacement [m] without the tools, with the dynamic nodes at rest.
    without_m: DVec3,
    force_n: DVec3,
}

/// Numbers of a pre-computed zone that change from step to step.
#[derive(Clone, Default)]
struct ZoneWork {
    /// Response of all own nodes to the constant loads, the frontier held [m].
    constant_m: Vec<f64>,
    /// The same of the stored rows, with the compliance of the rest of the body.
    base_m: Vec<f64>,
    /// Displacements of the stored rows [m].
    rows_m: Vec<f64>,
    /// Displacements of p from the zone's own loads [m].
    own_m: Vec<f64>,
    /// Displacements or forces of its frontier.
    frontier: Vec<f64>,
    /// Whether its loads are solved with the factor.
    is_solved: bool,
    /// Whether it has loads or tools.
    is_loaded: bool,
    /// Whether this step finds the positions of its nodes inside.
    is_inside_due: bool,
}

/// Age of the published positions of some nodes.
#[derive(Clone, Copy)]
struct Age {
    /// Simulated time [s] since they were written.
    since_s: f64,
    /// Whether they were given, at rest or by another model: then they tell nothing about the velocity.
    was_given: bool,
}

impl Age {
    const GIVEN: Self = Self { since_s: 0.0, was_given: true };

    fn is_stale(self) -> bool {
        self.since_s > 0.0
    }

    /// One over the time since the positions were written [1/s], or 0 when a velocity cannot be told from them. Marks
    /// the positions as current.
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
    // Description; removed tetrahedra stay in the lists until a compaction.
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
    /// Whether edits brought something in.
    is_cut: bool,

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
    /// One per pre-computed zone.
    ages: Vec<Ages>,
    /// Of the frontier nodes between pre-computed zones.
    condensed_age: Age,

    // Constraints.
    constraints: Constraints,
    loads: BoundedVec<Load>,
    held: BoundedVec<Held>,
    dynamic_constraints: Constraints,
    /// Place among the constraints of each constraint of the dynamic part.
    dynamic_places: BoundedVec<u32>,
    constraint_forces_n: BoundedVec<DVec3>,
    n_ignored: u32,
    /// Constraints beyond one per node, for which there is no room.
    n_dropped: u32,
    /// How often an edit rebuilt the interface.
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
    /// Local model of the dynamic nodes of a patch, in the dynamic part's numbering.
    local: LocalModel,
}

impl CondensedHybrid {
    /// Most nodes of pre-computed zones that tools can hold at once.
    pub const MAX_HELD: usize = 64;

    /// Reserves capacity in the lists; a copy of a list has none.
    fn make_room(&mut self) {
        self.local = LocalModel::new();
        let n_nodes = self.mesh.positions_m.len();
        for constraints in [&mut self.constraints, &mut self.dynamic_constraints] {
            constraints.displacements.reserve(n_nodes - constraints.displacements.len().min(n_nodes));
            constraints.forces.reserve(n_nodes - constraints.forces.len().min(n_nodes));
        }
    }

    /// Marks the nodes of live dynamic tetrahedra that are not held along all axes.
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

    /// Sets the mass damping of dynamic zones [1/s]; ignores a value that is negative or not finite.
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

    /// Number of equal parts into which the dynamic zones divide a step of `dt_s` now.
    pub fn parts_of_step(&self, dt_s: f64) -> u64 {
        self.dynamic.as_ref().map_or(1, |d| d.motion.parts_of_step(dt_s))
    }

    /// Largest stable step [s] of the dynamic zones now.
    pub fn stable_step_s(&self) -> Option<f64> {
        self.dynamic.as_ref().map(|d| d.motion.stable_step_s())
    }

    /// Stiffness [N/m] of the pre-computed zones on the nodes that they share with dynamic zones, these nodes in
    /// ascending order: three rows and columns per node, by columns, symmetric.
    pub fn condensed_stiffness_n_per_m(&self) -> (&[NodeId], &[f64]) {
        (&self.interface.nodes[self.interface.n_condensed..], self.interface.stiffness_on_dynamic.numbers())
    }

    /// Sizes of the model.
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
        // There is room for one constraint per node; a longer list has repetitions, and the rest counts as ignored.
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

    /// Advances the dynamic zones by `dt_s`, divided as the tensor-mass model does. The pre-computed zones follow in
    /// every part; nodes of theirs that tools hold are at their targets from the first part on.
    fn step(&mut self, dt_s: f64) {
        if dt_s.is_finite() && dt_s > 0.0 {
            self.advance(dt_s);
        }
    }

    fn state(&self) -> ModelState<'_> {
        ModelState { positions_m: &self.positions_m, velocities_m_per_s: &self.velocities_m_per_s }
    }

    fn history_into(&self, numbers: &mut Vec<f64>) {
        if let Some(dynamic) = &self.dynamic {
            dynamic.motion.history_into(numbers);
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

    fn bring_up_to_date(&mut self) {
        self.catch_up();
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

    /// Pre-computed nodes respond with their exact static compliance. Their pull acts on the dynamic nodes of the patch
    /// only; the other nodes between pre-computed and dynamic zones are held. This is exact without dynamic zones or
    /// over a period that is short for those nodes, and too stiff otherwise. Dynamic nodes respond over the period
    /// ([`crate::model::local_model`]), with the pre-computed tetrahedra around them, whose other corners are held.
    /// Nodes that tools hold in pre-computed tissue respond too; nodes that tools cannot hold do not. Nodes that
    /// [`Updated`] leaves out are at their published positions.
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

    /// Removals in dynamic zones away from the frontier allocate nothing; all else does.
    fn topology_changed(&mut self, mesh: &TetMesh, change: &TopologyChange) -> Result<(), TopologyRefusal> {
        self.follow_change(mesh, change)
    }
}
