//! What every explicitly integrated body has, whichever way it is moved: masses, supports, loads, constraints, the
//! length of its steps and the account of them.
//!
//! A step is divided into equal parts ([`Frame::begin_step`]). After an edit the stable step is shorter; where more
//! parts than allowed would be needed, the inertia of the limiting tetrahedra grows, of their weight nothing: states
//! at rest stay as they are. With a factor s on the mass of a tetrahedron its squared frequency is divided by s,
//! so that by the element eigenvalue theorem (see [`super::StableStep`]) the whole stays below the limit.
//!
//! Energy watch. In one part the kinetic energy cannot grow by more than the work of weight, outer forces, ligaments
//! and tools in it, and the elastic energy that was there. The latter is taken to be less than that of a body in which
//! every tetrahedron is strained by 1, half the modulus times the volume, summed: tissue tears long before, and waves
//! give up the energy of a tetrahedron over several parts. TopologyUpdate beyond the sum comes from an unstable step; the
//! velocities are then cut down to the energy before, or to that bound.

use super::cuttable::LiveTets;
use super::stable::Stability;
use super::{ExplicitError, keep};
use crate::model::bounded_vec::BoundedVec;
use crate::model::local_model::LocalFrame;
use crate::model::topology_update::TopologyUpdate;
use crate::model::{Attachment, Constraints, DynamicBody, ModelReport, ModelUndo, Rayleigh, UndoReader};
use crate::solve::SolveError;
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};

/// A step longer than this many parts is cut to it: the caller asked for minutes in one step.
const MOST_PARTS: f64 = 1e6;

/// A node that a tool holds.
#[derive(Clone, Copy, Debug)]
pub(super) struct Held {
    pub(super) place: u32,
    pub(super) node: u32,
    /// Axes along which a support holds it: there the tool has no say and bears nothing.
    supported: [bool; 3],
    pub(super) start_m: DVec3,
    pub(super) target_m: DVec3,
    /// Where it was before the part of the step under way.
    pub(super) before_m: DVec3,
}

impl Held {
    /// Where it stands at the end of a part; evenly on its way.
    pub(super) fn at_m(&self, part: u64, n_parts: u64) -> DVec3 {
        let share = part as f64 / n_parts as f64;
        let mut at_m = if part == n_parts { self.target_m } else { self.start_m.lerp(self.target_m, share) };
        for axis in (0..3).filter(|&axis| self.supported[axis]) {
            at_m[axis] = self.start_m[axis];
        }
        at_m
    }

    /// The tool's part of the force that holds the node.
    pub(super) fn on_tool_n(&self, mut force_n: DVec3) -> DVec3 {
        for axis in (0..3).filter(|&axis| self.supported[axis]) {
            force_n[axis] = 0.0;
        }
        force_n
    }
}

/// A node that is held along some axes only.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sliding {
    pub(super) node: u32,
    pub(super) supported: [bool; 3],
}

/// Steps that stay divided after tetrahedra were inverted or the energy was limited: some vibrations of a tetrahedron.
const CAREFUL_STEPS: u32 = 50;
/// A strained body's nodes are not let go faster than so many times its fastest wave at rest: a choice, three times that of St
/// Venant-Kirchhoff tissue stretched by 1.3.
const MOST_WAVE_SPEEDS: f64 = 4.3;

/// Of the energy of a strain of 1, what a body whose energy is limited may keep moving with.
const LEAST_SHARE_OF_ENERGY: f64 = 0.01;

/// Tetrahedra that were left out of one evaluation of the forces.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(in crate::model) struct Quarantine {
    pub(in crate::model) n_tets: u32,
    pub(in crate::model) first: Option<TetId>,
}

impl Quarantine {
    pub(in crate::model) fn add(&mut self, t: usize) {
        self.n_tets += 1;
        self.first = self.first.or(Some(TetId::from_index(t)));
    }
}

/// Masses, supports, loads and constraints of one body.
#[derive(Clone, Debug)]
pub(in crate::model) struct Frame {
    density_kg_per_m3: f64,
    pub(super) gravity_m_per_s2: DVec3,
    pub(in crate::model) damping: Rayleigh,
    pub(super) time_step_s: f64,
    most_parts: u32,
    /// Steps that are still divided as far as allowed, because tetrahedra were inverted or the energy was limited.
    careful_steps: u32,
    pub(super) is_cut: bool,
    /// The largest stable step now [s].
    pub(super) stable_step_s: f64,
    /// Of each tetrahedron by itself [1/s2].
    tet_squared_frequency_per_s2: Vec<f64>,
    /// Energy of the body with every tetrahedron strained by 1 [J].
    full_strain_energy_j: f64,
    /// Speed of the fastest wave at rest [m/s].
    wave_m_per_s: f64,

    pub(super) rest_m: Vec<DVec3>,
    pub(super) is_fixed: Vec<bool>,
    /// Ascending by node.
    pub(super) sliding: Vec<Sliding>,
    /// Ascending by node.
    pub(super) attachments: Vec<Attachment>,
    /// Live tetrahedra at each node.
    pub(super) node_tets: Vec<u32>,
    pub(super) mass_kg: Vec<f64>,
    /// What a node is heavier than its tissue, so that the step stays stable.
    extra_kg: Vec<f64>,

    pub(super) outer_forces: BoundedVec<(u32, DVec3)>,
    pub(super) held: BoundedVec<Held>,
    pub(super) constraint_forces_n: BoundedVec<DVec3>,
    report: ModelReport,
}

/// Refuses what no body can be made from; the mesh is looked at elsewhere.
///
/// # Errors
/// [`ExplicitError`] naming the first impossible number.
pub(in crate::model) fn check_body(body: &DynamicBody<'_>) -> Result<(), ExplicitError> {
    let check = |what, found: f64, is_allowed: bool, allowed| {
        if found.is_finite() && is_allowed {
            return Ok(());
        }
        Err(ExplicitError::Parameter { what, found, allowed })
    };
    let (density, h) = (body.density_kg_per_m3, body.time_step_s);
    let Rayleigh { mass_per_s, stiffness_s } = body.damping;
    check("density [kg/m3]", density, density > 0.0, "a finite number above 0")?;
    check("damping [1/s]", mass_per_s, mass_per_s >= 0.0, "a finite number from 0")?;
    check("damping of the stiffness [s]", stiffness_s, stiffness_s >= 0.0, "a finite number from 0")?;
    check("gravity [m/s2]", body.gravity_m_per_s2.length(), true, "finite numbers")?;
    check("time step [s]", h, h > 0.0, "a finite number above 0")?;
    check("most parts of a step", f64::from(body.most_parts), body.most_parts > 0, "a number from 1")?;
    let n_nodes = body.mesh.positions_m.len();
    let nodes = body.fixed.iter().map(|f| f.node).chain(body.attachments.iter().map(|a| a.node));
    if let Some(node) = nodes.into_iter().find(|n| n.index() >= n_nodes) {
        return Err(SolveError::ConditionOutOfRange { node, n_nodes }.into());
    }
    for a in body.attachments {
        check("anchor of a ligament [m]", a.anchor_m.length(), true, "finite numbers")?;
        let (slack_m, k) = (a.slack_length_m, a.stiffness_n_per_m);
        check("slack length of a ligament [m]", slack_m, slack_m >= 0.0, "a finite number from 0")?;
        check("stiffness of a ligament [N/m]", k, k >= 0.0, "a finite number from 0")?;
    }
    let (found, n_tets) = (body.rest_stress_pa.len(), body.mesh.tetrahedra.len());
    if found != 0 && found != n_tets {
        return Err(ExplicitError::RestStressCount { found, n_tets });
    }
    for stress_pa in body.rest_stress_pa.iter().flatten() {
        check("stress at rest [Pa]", *stress_pa, true, "finite numbers")?;
    }
    Ok(())
}

impl Frame {
    /// A body at rest. `full_strain_energy_j`: see the module.
    ///
    /// # Errors
    /// [`ExplicitError`] of [`check_body`].
    pub(super) fn new(body: &DynamicBody<'_>, full_strain_energy_j: f64) -> Result<Self, ExplicitError> {
        check_body(body)?;
        let n_nodes = body.mesh.positions_m.len();
        let mut supported = vec![[false; 3]; n_nodes];
        for fixed in body.fixed {
            let axes = &mut supported[fixed.node.index()];
            axes.iter_mut().zip(fixed.axes).for_each(|(held, also)| *held |= also);
        }
        let some = |axes: &[bool; 3]| axes.contains(&true) && axes.contains(&false);
        let sliding = supported.iter().enumerate().filter(|(_, axes)| some(axes));
        let mut attachments = body.attachments.to_vec();
        attachments.sort_by_key(|a| a.node);
        let mut mass_kg = vec![0.0; n_nodes];
        let mut node_tets = vec![0; n_nodes];
        for (t, nodes) in body.mesh.tetrahedra.iter().enumerate() {
            let share_kg = body.density_kg_per_m3 * body.mesh.tet_volume_m3(TetId::from_index(t)) / 4.0;
            for node in nodes {
                mass_kg[node.index()] += share_kg;
                node_tets[node.index()] += 1;
            }
        }
        let wave_m_per_s = (2.0 * full_strain_energy_j / mass_kg.iter().sum::<f64>()).sqrt();
        Ok(Self {
            density_kg_per_m3: body.density_kg_per_m3,
            gravity_m_per_s2: body.gravity_m_per_s2,
            damping: body.damping,
            time_step_s: body.time_step_s,
            most_parts: body.most_parts,
            careful_steps: 0,
            is_cut: false,
            stable_step_s: f64::INFINITY,
            tet_squared_frequency_per_s2: Vec::new(),
            full_strain_energy_j,
            wave_m_per_s,
            rest_m: body.mesh.positions_m.clone(),
            sliding: sliding.map(|(n, &supported)| Sliding { node: n as u32, supported }).collect(),
            is_fixed: supported.iter().map(|axes| *axes == [true; 3]).collect(),
            attachments,
            node_tets,
            mass_kg,
            extra_kg: vec![0.0; n_nodes],
            outer_forces: BoundedVec::with_capacity(n_nodes),
            held: BoundedVec::with_capacity(n_nodes),
            constraint_forces_n: BoundedVec::with_capacity(n_nodes),
            report: ModelReport::default(),
        })
    }

    /// Keeps what is known of the tetrahedra's frequencies, for the time after cuts.
    pub(super) fn keep_frequencies(&mut self, stability: Stability) {
        self.tet_squared_frequency_per_s2 = stability.tet_squared_frequency_per_s2;
    }

    pub(super) fn n_nodes(&self) -> usize {
        self.rest_m.len()
    }

    /// Mass with what was added for the sake of the step.
    pub(in crate::model) fn inertia_kg(&self, n: usize) -> f64 {
        self.mass_kg[n] + self.extra_kg[n]
    }

    /// Not fixed, and with a tetrahedron.
    pub(super) fn takes_load(&self, n: usize) -> bool {
        self.node_tets[n] > 0 && !self.is_fixed[n]
    }

    /// Axes along which a node moves freely but for a tool's hold.
    pub(in crate::model) fn free_axes(&self, n: usize) -> [bool; 3] {
        if !self.takes_load(n) {
            return [false; 3];
        }
        let place = self.sliding.binary_search_by_key(&(n as u32), |s| s.node);
        place.map_or([true; 3], |at| self.sliding[at].supported.map(|is_supported| !is_supported))
    }

    pub(in crate::model) fn is_held(&self, n: usize) -> bool {
        self.held.iter().any(|held| held.node as usize == n)
    }

    /// Forces [N] of constraints and from outside on a node, without weight.
    pub(in crate::model) fn load_on_n(&self, n: usize) -> DVec3 {
        let outer = self.outer_forces.iter().filter(|(node, _)| *node as usize == n).map(|(_, f)| *f);
        let held = self.held.iter().filter(|held| held.node as usize == n);
        outer.sum::<DVec3>() + held.map(|held| self.constraint_forces_n[held.place as usize]).sum::<DVec3>()
    }

    /// Into how many equal parts a step of `dt_s` is divided now.
    pub(super) fn parts_of_step(&self, dt_s: f64) -> u64 {
        let longest_s = self.time_step_s.min(self.stable_step_s);
        // A hair below the whole number: dt = k times the step gives k parts in spite of rounding.
        (dt_s / longest_s - 1e-9).ceil().clamp(1.0, MOST_PARTS) as u64
    }

    /// Number and length [s] of the parts of a step, whose report begins; nothing for what is no step.
    pub(super) fn begin_step(&mut self, dt_s: f64) -> Option<(u64, f64)> {
        if !(dt_s.is_finite() && dt_s > 0.0) {
            return None;
        }
        let is_strained = self.report.n_quarantined_tets > 0 || self.report.energy_was_limited;
        self.careful_steps = if is_strained { CAREFUL_STEPS } else { self.careful_steps.saturating_sub(1) };
        let mut n_parts = self.parts_of_step(dt_s);
        if self.careful_steps > 0 {
            n_parts = n_parts.max(u64::from(self.most_parts));
        }
        self.report.n_parts = n_parts as u32;
        self.report.n_quarantined_tets = 0;
        self.report.first_quarantined = None;
        self.report.n_recovered_nodes = 0;
        self.report.energy_was_limited = false;
        self.report.missed_tolerance = false;
        // Only a step of more than the most parts is cut off.
        Some((n_parts, (dt_s / n_parts as f64).min(self.time_step_s)))
    }

    /// How far a node may go in a part of `h_s` [m], in a body that is strained beyond what the step is made for: tissue that is
    /// driven by its own elasticity is not much faster than waves run through it.
    pub(super) fn furthest_m(&self, h_s: f64) -> Option<f64> {
        let is_strained = self.careful_steps > 0 || self.report.n_quarantined_tets > 0;
        let furthest_m = MOST_WAVE_SPEEDS * self.wave_m_per_s * h_s;
        (is_strained && furthest_m.is_finite()).then_some(furthest_m)
    }

    pub(super) fn note_limited_energy(&mut self) {
        self.report.energy_was_limited = true;
    }

    /// Takes note of what one part left out: of the part that left out most.
    pub(super) fn note_quarantine(&mut self, quarantine: Quarantine) {
        if quarantine.n_tets > self.report.n_quarantined_tets {
            self.report.n_quarantined_tets = quarantine.n_tets;
            self.report.first_quarantined = quarantine.first;
        }
    }

    pub(super) fn note_missed_tolerance(&mut self) {
        self.report.missed_tolerance = true;
    }

    pub(super) fn note_recovered_node(&mut self) {
        self.report.n_recovered_nodes += 1;
    }

    pub(super) fn report(&self, kinetic_energy_j: f64) -> ModelReport {
        ModelReport { kinetic_energy_j, ..self.report }
    }

    /// A gravity that is not finite is left out and counted.
    pub(super) fn set_gravity(&mut self, gravity_m_per_s2: DVec3) {
        if gravity_m_per_s2.is_finite() {
            self.gravity_m_per_s2 = gravity_m_per_s2;
        } else {
            self.report.n_ignored_constraints += 1;
        }
    }

    pub(super) fn ignored_constraints(&self) -> usize {
        self.report.n_ignored_constraints as usize
    }

    /// Takes over constraints; targets of held nodes are displacements.
    pub(super) fn apply(&mut self, constraints: &Constraints) {
        let mut ignored = 0;
        self.outer_forces.clear();
        for force in &constraints.forces {
            let n = force.node.index();
            let usable = n < self.n_nodes() && self.takes_load(n) && force.force_n.is_finite();
            if !(usable && self.outer_forces.try_push((force.node.0, force.force_n))) {
                ignored += 1;
            }
        }
        self.held.clear();
        for (place, imposed) in constraints.displacements.iter().enumerate() {
            let n = imposed.node.index();
            let usable = n < self.n_nodes() && self.takes_load(n) && imposed.displacement_m.is_finite();
            let mut is_held = false;
            if usable {
                let node = imposed.node.0;
                let supported = self
                    .sliding
                    .binary_search_by_key(&node, |s| s.node)
                    .map_or([false; 3], |at| self.sliding[at].supported);
                is_held = self.held.try_push(Held {
                    place: place as u32,
                    node,
                    supported,
                    start_m: DVec3::ZERO,
                    target_m: imposed.displacement_m,
                    before_m: DVec3::ZERO,
                });
            }
            ignored += u32::from(!is_held);
        }
        self.report.n_ignored_constraints = ignored;
        // Room was made for every node; more is a list with repetitions.
        self.constraint_forces_n.clear();
        self.constraint_forces_n.resize(constraints.displacements.len(), DVec3::ZERO);
    }

    pub(super) fn drop_constraints(&mut self) {
        self.outer_forces.clear();
        self.held.clear();
        self.constraint_forces_n.clear();
    }

    /// Holds a node along all axes from now on; whether it was free before.
    pub(super) fn fix(&mut self, node: NodeId) -> bool {
        let free = self.is_fixed.get(node.index()) == Some(&false);
        if free {
            self.is_fixed[node.index()] = true;
            self.held.retain(|held| held.node != node.0);
            self.outer_forces.retain(|(n, _)| *n != node.0);
        }
        free
    }

    /// Takes the masses of one tetrahedron out; [`Frame::let_loose_nodes_go`] has to follow.
    pub(super) fn remove_tet(&mut self, nodes: [NodeId; 4], volume_m3: f64) {
        self.is_cut = true;
        let share_kg = self.density_kg_per_m3 * volume_m3 / 4.0;
        for n in nodes.map(NodeId::index) {
            self.node_tets[n] -= 1;
            if self.node_tets[n] == 0 {
                self.mass_kg[n] = 0.0;
                self.extra_kg[n] = 0.0;
            } else {
                self.mass_kg[n] -= share_kg;
            }
        }
    }

    /// Adds the masses of one tetrahedron. `squared_frequency_per_s2`: by itself; of no meaning for models whose
    /// tetrahedra have none.
    pub(super) fn add_tet(
        &mut self,
        t: usize,
        nodes: [NodeId; 4],
        volume_m3: f64,
        squared_frequency_per_s2: f64,
    ) {
        let share_kg = self.density_kg_per_m3 * volume_m3 / 4.0;
        for n in nodes.map(NodeId::index) {
            self.node_tets[n] += 1;
            self.mass_kg[n] += share_kg;
        }
        if let Some(of_tet) = self.tet_squared_frequency_per_s2.get_mut(t) {
            *of_tet = squared_frequency_per_s2;
        }
    }

    /// Density [kg/m3].
    pub(super) fn density_kg_per_m3(&self) -> f64 {
        self.density_kg_per_m3
    }

    /// Squared frequency of a tetrahedron by itself, for every shape allowed for [1/s2].
    pub(super) fn tet_per_s2(&self, t: usize) -> f64 {
        self.tet_squared_frequency_per_s2[t]
    }

    /// Highest squared frequency of a live tetrahedron by itself [1/s2]: a bound of the whole after any cuts.
    pub(super) fn highest_tet_per_s2(&self, is_live: &[bool]) -> f64 {
        let live = self.tet_squared_frequency_per_s2.iter().zip(is_live).filter(|(_, live)| **live);
        live.map(|(of_tet, _)| *of_tet).fold(0.0, f64::max)
    }

    /// A held node that lost its last tetrahedron has nothing to pull on.
    pub(super) fn let_loose_nodes_go(&mut self) {
        let node_tets = &self.node_tets;
        self.held.retain(|held| node_tets[held.node as usize] > 0);
        self.outer_forces.retain(|(node, _)| node_tets[*node as usize] > 0);
    }

    /// Axes along which a support holds a node.
    pub(super) fn supports(&self, n: usize) -> [bool; 3] {
        if self.is_fixed[n] {
            return [true; 3];
        }
        let place = self.sliding.binary_search_by_key(&(n as u32), |s| s.node);
        place.map_or([false; 3], |at| self.sliding[at].supported)
    }

    /// Room for what an edit brings in. A tool goes on holding a moved node at its place in space.
    pub(super) fn grow(&mut self, mesh: &TetMesh, change: &TopologyChange, growth: &TopologyUpdate) {
        let (n_before, n_nodes) = (self.n_nodes(), growth.n_nodes);
        for held in self.held.iter_mut() {
            let n = held.node as usize;
            let moved_m = mesh.positions_m[n] - self.rest_m[n];
            held.start_m -= moved_m;
            held.target_m -= moved_m;
        }
        for node in change.moved_nodes.iter().filter(|node| node.index() < n_before) {
            self.rest_m[node.index()] = mesh.positions_m[node.index()];
        }
        self.rest_m.extend_from_slice(&mesh.positions_m[n_before..n_nodes]);
        self.is_fixed.resize(n_nodes, false);
        for (n, supported) in growth.new_supports(|n| self.supports(n)) {
            self.is_fixed[n] = supported == [true; 3];
            if !self.is_fixed[n] && supported.contains(&true) {
                self.sliding.push(Sliding { node: n as u32, supported });
            }
        }
        self.node_tets.resize(n_nodes, 0);
        self.mass_kg.resize(n_nodes, 0.0);
        self.extra_kg.resize(n_nodes, 0.0);
        if !self.tet_squared_frequency_per_s2.is_empty() {
            self.tet_squared_frequency_per_s2.resize(growth.n_tets, 0.0);
        }
        self.outer_forces.make_room(n_nodes);
        self.held.make_room(n_nodes);
        self.constraint_forces_n.make_room(n_nodes);
        self.is_cut = true;
    }

    /// Keeps masses, constraints and what the next step depends on.
    pub(super) fn save(&self, undo: &mut ModelUndo) {
        undo.report = self.report;
        undo.push_place(self.careful_steps as usize);
        undo.push_place(usize::from(self.is_cut));
        undo.numbers.extend_from_slice(&[self.stable_step_s, self.damping.mass_per_s]);
        undo.push_vector(self.gravity_m_per_s2);
        undo.numbers.extend_from_slice(&self.mass_kg);
        undo.numbers.extend_from_slice(&self.extra_kg);
        undo.places.extend_from_slice(&self.node_tets);
        undo.push_place(self.outer_forces.len());
        for (node, force_n) in self.outer_forces.iter() {
            undo.places.push(*node);
            undo.push_vector(*force_n);
        }
        undo.push_place(self.held.len());
        for held in self.held.iter() {
            let supported = held.supported.iter().enumerate().map(|(axis, held)| u32::from(*held) << axis);
            undo.places.extend_from_slice(&[held.place, held.node, supported.sum()]);
            [held.start_m, held.target_m, held.before_m].into_iter().for_each(|v| undo.push_vector(v));
        }
        undo.push_place(self.constraint_forces_n.len());
        self.constraint_forces_n.iter().for_each(|force_n| undo.push_vector(*force_n));
    }

    /// Comes back to [`Frame::save`] of the same nodes.
    pub(super) fn put_back(&mut self, undo: &ModelUndo, from: &mut UndoReader<'_>) {
        let n_nodes = self.n_nodes();
        self.report = undo.report;
        self.careful_steps = from.place() as u32;
        self.is_cut = from.place() == 1;
        self.stable_step_s = from.number();
        self.damping.mass_per_s = from.number();
        self.gravity_m_per_s2 = from.vector();
        self.mass_kg.copy_from_slice(from.numbers(n_nodes));
        self.extra_kg.copy_from_slice(from.numbers(n_nodes));
        self.node_tets.copy_from_slice(from.places(n_nodes));
        self.drop_constraints();
        for _ in 0..from.place() {
            self.outer_forces.try_push((from.place() as u32, from.vector()));
        }
        for _ in 0..from.place() {
            let [place, node, supported] = [0; 3].map(|_| from.place() as u32);
            let [start_m, target_m, before_m] = [0; 3].map(|_| from.vector());
            let supported = [0, 1, 2].map(|axis| supported >> axis & 1 == 1);
            self.held.try_push(Held { place, node, supported, start_m, target_m, before_m });
        }
        for _ in 0..from.place() {
            self.constraint_forces_n.try_push(from.vector());
        }
    }

    /// Largest stiffness of ligaments over inertia at a node [1/s2]: by so much they raise a squared frequency at most,
    /// for the slope of a taut ligament's force is at most its stiffness in any direction.
    pub(super) fn attachment_squared_frequency_per_s2(&self, inertia_kg: impl Fn(usize) -> f64) -> f64 {
        let mut largest = 0.0_f64;
        for of_node in self.attachments.chunk_by(|a, b| a.node == b.node) {
            let n = of_node[0].node.index();
            if self.takes_load(n) {
                let stiffness: f64 = of_node.iter().map(|a| a.stiffness_n_per_m).sum();
                largest = largest.max(stiffness / inertia_kg(n));
            }
        }
        largest
    }

    /// The least stable step [s] for which the most parts suffice.
    pub(super) fn least_stable_step_s(&self) -> f64 {
        self.time_step_s / f64::from(self.most_parts)
    }

    /// All nodes as heavy as their tissue.
    pub(super) fn forget_scaling(&mut self) {
        self.extra_kg.fill(0.0);
        self.report.n_mass_scaled_nodes = 0;
    }

    /// Makes the nodes of ligaments so heavy that their squared frequency stays below half of the one allowed for
    /// everything; what is left of it for the tissue.
    pub(super) fn scale_attached(&mut self, allowed_per_s2: f64) -> f64 {
        let share_per_s2 = 0.5 * allowed_per_s2;
        for at in 0..self.attachments.len() {
            let node = self.attachments[at].node;
            let of_node = self.attachments.iter().filter(|a| a.node == node);
            let stiffness: f64 = of_node.map(|a| a.stiffness_n_per_m).sum();
            let n = node.index();
            if self.takes_load(n) {
                self.add_inertia(n, stiffness / share_per_s2 - self.inertia_kg(n));
            }
        }
        let taken = self.attachment_squared_frequency_per_s2(|n| self.inertia_kg(n));
        allowed_per_s2 - taken.min(share_per_s2)
    }

    /// Makes tetrahedra so heavy that none alone has a squared frequency above `allowed_per_s2`.
    pub(super) fn scale_tets(&mut self, allowed_per_s2: f64, tets: &LiveTets) {
        for (t, nodes) in tets.iter() {
            let excess = self.tet_squared_frequency_per_s2[t] / allowed_per_s2 - 1.0;
            if excess > 0.0 {
                let volume_m3 = tets.gradients(t, &self.rest_m).volume_m3;
                for node in nodes {
                    self.add_inertia(node.index(), excess * self.density_kg_per_m3 * volume_m3 / 4.0);
                }
            }
        }
    }

    /// Makes a node heavier by `extra_kg`, if that is positive.
    pub(super) fn add_inertia(&mut self, n: usize, extra_kg: f64) {
        if extra_kg > 0.0 {
            self.report.n_mass_scaled_nodes += u32::from(self.extra_kg[n] == 0.0);
            self.extra_kg[n] += extra_kg;
        }
    }

    pub(super) fn note_all_scaled(&mut self) {
        self.report.n_mass_scaled_nodes = self.node_tets.iter().filter(|n| **n > 0).count() as u32;
    }

    /// The kinetic energy [J] that is allowed after a part that began with `before_j`, when it has `after_j`:
    /// `None` when nothing is wrong. `work_j`: of the outside in it.
    pub(super) fn limited_kinetic_j(&mut self, before_j: f64, after_j: f64, work_j: f64) -> Option<f64> {
        if after_j <= before_j + self.full_strain_energy_j + work_j.max(0.0) {
            return None;
        }
        self.report.energy_was_limited = true;
        // Some of what the body may hold: it has to come to rest, not to stop where it is.
        Some(before_j.clamp(LEAST_SHARE_OF_ENERGY * self.full_strain_energy_j, self.full_strain_energy_j))
    }

    /// Whether a growth needs no further look: the elastic energy alone can explain it.
    #[inline]
    pub(super) fn is_plain_growth(&self, before_j: f64, after_j: f64) -> bool {
        after_j <= before_j + self.full_strain_energy_j
    }

    /// Work [J] of the outside in a part: weight, outer forces, ligaments, tools. `before_m`: positions at its begin;
    /// `way_m`: how far the nodes went.
    pub(super) fn outside_work_j(
        &self,
        before_m: impl Fn(usize) -> DVec3,
        way_m: impl Fn(usize) -> DVec3,
    ) -> f64 {
        let falling = (0..self.n_nodes()).filter(|&n| self.takes_load(n));
        let weight_j: f64 = falling.map(|n| self.mass_kg[n] * self.gravity_m_per_s2.dot(way_m(n))).sum();
        let outer_j: f64 = self.outer_forces.iter().map(|(n, f)| f.dot(way_m(*n as usize))).sum();
        let ligament = |a: &Attachment| a.force_n(before_m(a.node.index())).dot(way_m(a.node.index()));
        let ligaments_j: f64 = self.attachments.iter().map(ligament).sum();
        let tool = |h: &Held| self.constraint_forces_n[h.place as usize].dot(way_m(h.node as usize)).abs();
        let tools_j: f64 = self.held.iter().map(tool).sum();
        weight_j + outer_j + ligaments_j + tools_j
    }

    /// Drops nodes without a new id; the order of the others stays. Constraints are dropped with their node numbers,
    /// ligaments and supports with their node.
    pub(super) fn compact(&mut self, new_ids: &[Option<NodeId>], live_tets: &[bool]) {
        let stays: Vec<bool> = new_ids.iter().map(Option::is_some).collect();
        keep(&mut self.rest_m, &stays);
        keep(&mut self.is_fixed, &stays);
        keep(&mut self.node_tets, &stays);
        keep(&mut self.mass_kg, &stays);
        keep(&mut self.extra_kg, &stays);
        if !self.tet_squared_frequency_per_s2.is_empty() {
            keep(&mut self.tet_squared_frequency_per_s2, live_tets);
        }
        self.sliding.retain_mut(|s| {
            let new = new_ids[s.node as usize];
            s.node = new.map_or(s.node, |n| n.0);
            new.is_some()
        });
        self.attachments.retain_mut(|a| {
            let new = new_ids[a.node.index()];
            a.node = new.unwrap_or(a.node);
            new.is_some()
        });
        self.drop_constraints();
    }
}

impl LocalFrame for Frame {
    fn inertia_kg(&self, n: usize) -> f64 {
        self.inertia_kg(n)
    }

    fn free_axes(&self, n: usize) -> [bool; 3] {
        self.free_axes(n)
    }

    fn is_held(&self, n: usize) -> bool {
        self.is_held(n)
    }

    fn load_on_n(&self, n: usize) -> DVec3 {
        self.load_on_n(n)
    }

    fn damping(&self) -> Rayleigh {
        self.damping
    }
}
