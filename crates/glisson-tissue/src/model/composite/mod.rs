//! Several bodies as one model: each has a model of its own, and the joint numbers of nodes and tetrahedra are translated.
//!
//! The bodies are parts of one mesh without a common node. They do not know of each other: what acts between them (contact,
//! attachments) comes from outside as forces, and as corrections of a step. So each body has the bits that it has alone.
//!
//! Bodies step in parallel where the workers have several threads; within a body one thread computes then. Each body's part is
//! behind a lock that nobody else asks for at that moment: no thread ever waits for one.

mod edit;
mod maps;
mod part;

use self::maps::{Maps, Numbering};
use self::part::Part;
use super::{
    Answered, Constraints, Correction, DeformableModel, LevelOfDetail, LocalModel, LocalWork, ModelReport,
    ModelState, ModelUndo, NodalForce, NodalSpring, StepAnswer, TopologyRefusal,
};
use crate::workers::SharedWorkers;
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// How a body that is put in is called in messages.
pub(super) const NAME: &str = "composite";

/// A body of a composite model.
pub struct CompositePart {
    /// Its model.
    pub model: Box<dyn DeformableModel>,
    /// Tetrahedra of its mesh.
    pub n_tets: usize,
    /// Whether its motion depends on time alone, and its history is one number: its clock.
    pub has_clock: bool,
}

/// Where a displacement's force is found.
#[derive(Clone, Copy, Debug)]
struct ImposedAt {
    part: u32,
    place: u32,
}

type Parts = Vec<Mutex<Part>>;

/// Several bodies, one after the other in the joint mesh.
pub struct Composite {
    parts: Parts,
    maps: Maps,
    workers: SharedWorkers,
    /// Whether bodies step at the same time.
    in_parallel: bool,
    // What all have together.
    positions_m: Vec<DVec3>,
    velocities_m_per_s: Vec<DVec3>,
    clocks_s: Vec<f64>,
    imposed_at: Vec<ImposedAt>,
    constraint_forces_n: Vec<DVec3>,
    // Scratch of local models.
    patch: Vec<NodeId>,
    patch_at: Vec<usize>,
    local: LocalModel,
}

fn lock(part: &Mutex<Part>) -> MutexGuard<'_, Part> {
    part.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Displacements at once for which room is kept.
const IMPOSED: usize = 128;

impl Composite {
    /// Joins bodies; the nodes and tetrahedra of the joint mesh are theirs, one body after the other. With `in_parallel` the
    /// bodies step at the same time on the threads of `workers`; then none of their models may use these workers itself.
    pub fn new(parts: Vec<CompositePart>, workers: SharedWorkers, in_parallel: bool) -> Self {
        let n_tets: Vec<usize> = parts.iter().map(|part| part.n_tets).collect();
        let parts: Vec<Part> = parts.into_iter().map(|part| Part::new(part.model, part.has_clock)).collect();
        let maps = Maps {
            nodes: Numbering::of_counts(parts.iter().map(Part::n_nodes)),
            tets: Numbering::of_counts(n_tets.into_iter()),
        };
        Self::of_parts(parts, maps, workers, in_parallel)
    }

    fn of_parts(parts: Vec<Part>, maps: Maps, workers: SharedWorkers, in_parallel: bool) -> Self {
        let parts: Parts = parts.into_iter().map(Mutex::new).collect();
        let most = LocalModel::MOST_NODES;
        let mut joined = Self {
            parts,
            maps,
            workers,
            in_parallel,
            positions_m: Vec::new(),
            velocities_m_per_s: Vec::new(),
            clocks_s: Vec::new(),
            imposed_at: Vec::with_capacity(IMPOSED),
            constraint_forces_n: Vec::with_capacity(IMPOSED),
            patch: Vec::with_capacity(most),
            patch_at: Vec::with_capacity(most),
            local: LocalModel::new(),
        };
        joined.make_room();
        joined
    }

    /// How many bodies there are.
    pub fn n_parts(&self) -> usize {
        self.parts.len()
    }

    fn all(&self) -> impl Iterator<Item = MutexGuard<'_, Part>> {
        self.parts.iter().map(lock)
    }

    /// Room for what steps write, after the bodies changed.
    fn make_room(&mut self) {
        self.all().for_each(|mut part| part.make_room());
        self.publish();
        let n_nodes = self.maps.nodes.len();
        self.velocities_m_per_s.reserve(n_nodes.saturating_sub(self.velocities_m_per_s.len()));
    }

    /// Brings the joint state up to date.
    fn publish(&mut self) {
        let n_nodes = self.maps.nodes.len();
        let Self { parts, maps, positions_m, velocities_m_per_s, clocks_s, .. } = self;
        let moves = parts.iter().any(|part| !lock(part).model.state().velocities_m_per_s.is_empty());
        positions_m.resize(n_nodes, DVec3::ZERO);
        velocities_m_per_s.resize(if moves { n_nodes } else { 0 }, DVec3::ZERO);
        clocks_s.clear();
        for (p, part) in parts.iter().enumerate() {
            let part = lock(part);
            if part.has_clock {
                clocks_s.extend_from_slice(part.model.clocks_s());
            }
            let state = part.model.state();
            let of_part = maps.nodes.of_part(p);
            for (&joint, position_m) in of_part.iter().zip(state.positions_m) {
                positions_m[joint as usize] = *position_m;
            }
            if moves && state.velocities_m_per_s.is_empty() {
                of_part.iter().for_each(|&joint| velocities_m_per_s[joint as usize] = DVec3::ZERO);
            }
            for (&joint, velocity_m_per_s) in of_part.iter().zip(state.velocities_m_per_s) {
                velocities_m_per_s[joint as usize] = *velocity_m_per_s;
            }
        }
    }

    fn read_constraint_forces(&mut self) {
        let Self { parts, imposed_at, constraint_forces_n, .. } = self;
        for (force_n, at) in constraint_forces_n.iter_mut().zip(imposed_at) {
            let part = lock(&parts[at.part as usize]);
            let found = part.model.constraint_forces_n().get(at.place as usize).copied();
            *force_n = found.unwrap_or(DVec3::ZERO);
        }
    }

    /// Hands every body its share of forces on nodes.
    fn hand_out(&self, forces: &[NodalForce]) {
        self.all().for_each(|mut part| part.forces.clear());
        for force in forces {
            if let Some(place) = self.maps.nodes.get(force.node.index()) {
                let of_part = NodalForce { node: NodeId(place.local), force_n: force.force_n };
                lock(&self.parts[place.part as usize]).forces.try_push(of_part);
            }
        }
    }

    fn for_each(&self, does: fn(&mut Part)) {
        let task = |i: usize| does(&mut lock(&self.parts[i]));
        if self.in_parallel {
            self.workers.run(self.parts.len(), &task);
        } else {
            (0..self.parts.len()).for_each(task);
        }
    }

    /// One body's share of a local model.
    fn add_local(&mut self, p: usize, period_s: f64, work: &mut LocalWork, out: &mut LocalModel) {
        self.patch.clear();
        self.patch_at.clear();
        for (at, node) in out.nodes.iter().enumerate() {
            if let Some(place) = self.maps.nodes.get(node.index())
                && place.part as usize == p
            {
                self.patch.push(NodeId(place.local));
                self.patch_at.push(at);
            }
        }
        if self.patch.is_empty() {
            return;
        }
        let (patch, local, at) = (&self.patch, &mut self.local, &self.patch_at);
        lock(&self.parts[p]).model.local_model_into(patch, period_s, work, local);
        for (i, &of) in at.iter().enumerate().take(local.nodes.len()) {
            out.position_m[of] = local.position_m[i];
            out.force_n[of] = local.force_n[i];
            out.mass_kg[of] = local.mass_kg[i];
            out.drift_m[of] = local.drift_m[i];
            out.changed_n[of] = local.changed_n[i];
            for (j, &by) in at.iter().enumerate().take(local.nodes.len()) {
                out.set_tensor(of, by, local.tensor_m_per_n(i, j));
            }
        }
        out.n_rings = out.n_rings.max(local.n_rings);
        out.is_inertial |= local.is_inertial;
        out.missed_tolerance |= local.missed_tolerance;
    }
}

impl DeformableModel for Composite {
    fn apply(&mut self, constraints: &Constraints) {
        self.imposed_at.clear();
        self.constraint_forces_n.clear();
        for mut part in self.all() {
            part.constraints.displacements.clear();
            part.constraints.forces.clear();
        }
        for imposed in &constraints.displacements {
            // The number of a node that there is not is one that no body has.
            let none = maps::Place { part: 0, local: u32::MAX };
            let place = self.maps.nodes.get(imposed.node.index()).unwrap_or(none);
            let mut part = lock(&self.parts[place.part as usize]);
            let at = ImposedAt { part: place.part, place: part.constraints.displacements.len() as u32 };
            part.impose(place.local, imposed.displacement_m);
            self.imposed_at.push(at);
            self.constraint_forces_n.push(DVec3::ZERO);
        }
        for force in &constraints.forces {
            if let Some(place) = self.maps.nodes.get(force.node.index()) {
                let of_part = NodalForce { node: NodeId(place.local), force_n: force.force_n };
                lock(&self.parts[place.part as usize]).constraints.forces.push(of_part);
            }
        }
        for mut part in self.all() {
            let Part { model, constraints, .. } = &mut *part;
            model.apply(constraints);
        }
    }

    fn steady(&mut self, spring: NodalSpring) {
        if let Some(place) = self.maps.nodes.get(spring.node.index()) {
            let of_part = NodalSpring { node: NodeId(place.local), ..spring };
            lock(&self.parts[place.part as usize]).model.steady(of_part);
        }
    }

    fn step(&mut self, dt_s: f64) {
        self.all().for_each(|mut part| part.dt_s = dt_s);
        self.for_each(|part| part.model.step(part.dt_s));
        self.publish();
        self.read_constraint_forces();
    }

    fn state(&self) -> ModelState<'_> {
        ModelState { positions_m: &self.positions_m, velocities_m_per_s: &self.velocities_m_per_s }
    }

    /// The clocks of bodies that have one come first.
    fn history_into(&self, numbers: &mut Vec<f64>) {
        for is_clock in [true, false] {
            for part in self.all().filter(|part| part.has_clock == is_clock) {
                part.model.history_into(numbers);
            }
        }
    }

    fn constraint_forces_n(&self) -> &[DVec3] {
        &self.constraint_forces_n
    }

    fn take_over(&mut self, positions_m: &[DVec3]) {
        for (p, mut part) in self.all().enumerate() {
            let Part { model, moves_m, .. } = &mut *part;
            for (place_m, &joint) in moves_m.iter_mut().zip(self.maps.nodes.of_part(p)) {
                *place_m = positions_m[joint as usize];
            }
            model.take_over(moves_m);
        }
        self.publish();
    }

    fn clocks_s(&self) -> &[f64] {
        &self.clocks_s
    }

    fn take_over_in_motion(&mut self, state: &ModelState<'_>, clocks_s: &[f64]) {
        let mut clocks = clocks_s.iter();
        for (p, mut part) in self.all().enumerate() {
            let of_part = self.maps.nodes.of_part(p);
            let Part { model, moves_m, velocities_m_per_s, has_clock, .. } = &mut *part;
            for (place_m, &joint) in moves_m.iter_mut().zip(of_part) {
                *place_m = state.positions_m[joint as usize];
            }
            for (velocity_m_per_s, &joint) in velocities_m_per_s.iter_mut().zip(of_part) {
                let known = state.velocities_m_per_s.get(joint as usize);
                *velocity_m_per_s = known.copied().unwrap_or(DVec3::ZERO);
            }
            let velocities_m_per_s: &[DVec3] =
                if state.velocities_m_per_s.is_empty() { &[] } else { velocities_m_per_s };
            let of_part_s =
                if *has_clock { clocks.next().map_or(&[][..], std::slice::from_ref) } else { &[] };
            model.take_over_in_motion(&ModelState { positions_m: moves_m, velocities_m_per_s }, of_part_s);
        }
        self.publish();
    }

    fn set_gravity(&mut self, gravity_m_per_s2: DVec3) {
        self.all().for_each(|mut part| part.model.set_gravity(gravity_m_per_s2));
    }

    /// Bodies that lie on each other are computed whole always: the answers of less thorough steps let the forces between them
    /// swing up.
    fn set_level_of_detail(&mut self, _: LevelOfDetail) -> bool {
        false
    }

    fn report(&self) -> ModelReport {
        let mut all = ModelReport::default();
        for (p, part) in self.all().enumerate() {
            let own = part.model.report();
            let of_part = self.maps.tets.of_part(p);
            let first = own.first_quarantined.and_then(|tet| of_part.get(tet.index()).copied());
            all.n_parts = all.n_parts.max(own.n_parts);
            all.n_quarantined_tets += own.n_quarantined_tets;
            all.first_quarantined = all.first_quarantined.or(first.map(TetId));
            all.n_recovered_nodes += own.n_recovered_nodes;
            all.n_mass_scaled_nodes += own.n_mass_scaled_nodes;
            all.n_ignored_constraints += own.n_ignored_constraints;
            all.kinetic_energy_j += own.kinetic_energy_j;
            all.energy_was_limited |= own.energy_was_limited;
            all.missed_tolerance |= own.missed_tolerance;
            all.n_reanalyses += own.n_reanalyses;
            all.compliance_error = all.compliance_error.max(own.compliance_error);
            all.wants_recomputation |= own.wants_recomputation;
        }
        all
    }

    fn duplicate(&self) -> Box<dyn DeformableModel> {
        let parts = self.all().map(|part| part.duplicate()).collect();
        let workers = Arc::clone(&self.workers);
        let mut copy = Self::of_parts(parts, self.maps.clone(), workers, self.in_parallel);
        copy.imposed_at.extend_from_slice(&self.imposed_at);
        copy.constraint_forces_n.extend_from_slice(&self.constraint_forces_n);
        Box::new(copy)
    }

    fn local_model_into(
        &mut self,
        patch: &[NodeId],
        period_s: f64,
        work: &mut LocalWork,
        out: &mut LocalModel,
    ) {
        out.start(patch, period_s, &self.positions_m);
        for p in 0..self.parts.len() {
            self.add_local(p, period_s, work, out);
        }
    }

    fn step_answer(&self) -> StepAnswer {
        let (mut is_single, mut joint_version) = (true, 0_u64);
        for part in self.all() {
            match part.model.step_answer() {
                StepAnswer::Unknown => return StepAnswer::Unknown,
                StepAnswer::NodeByNode => {}
                StepAnswer::Coupled { version } => {
                    is_single = false;
                    joint_version += version;
                }
                StepAnswer::Static => is_single = false,
            }
        }
        if is_single { StepAnswer::NodeByNode } else { StepAnswer::Coupled { version: joint_version } }
    }

    fn node_answer_m_per_n(&self, node: NodeId, dt_s: f64) -> DVec3 {
        let Some(place) = self.maps.nodes.get(node.index()) else { return DVec3::ZERO };
        let part = lock(&self.parts[place.part as usize]);
        part.model.node_answer_m_per_n(NodeId(place.local), dt_s)
    }

    fn carrier_m(&self, tet: TetId) -> Option<[[DVec3; 4]; 2]> {
        let place = self.maps.tets.get(tet.index())?;
        lock(&self.parts[place.part as usize]).model.carrier_m(TetId(place.local))
    }

    fn can_part(&self, sides: &mut dyn Iterator<Item = (NodeId, f64)>) -> bool {
        let mut places = sides.map(|(node, weight)| (self.maps.nodes.get(node.index()), weight)).peekable();
        let Some(&(Some(first), _)) = places.peek() else { return true };
        let mut is_one_body = true;
        let mut of_part = places.map_while(|(place, weight)| {
            let own = place.filter(|place| place.part == first.part);
            is_one_body &= own.is_some();
            own.map(|place| (NodeId(place.local), weight))
        });
        let can_part = lock(&self.parts[first.part as usize]).model.can_part(&mut of_part);
        of_part.for_each(drop);
        can_part || !is_one_body
    }

    fn answer_into(&mut self, forces: &[NodalForce], moves_m: &mut [DVec3], at: Answered) {
        self.hand_out(forces);
        self.for_each(match at {
            Answered::Everywhere => |part| part.answer(Answered::Everywhere),
            Answered::AtForces => |part| part.answer(Answered::AtForces),
        });
        for (p, part) in self.all().enumerate() {
            for (&joint, move_m) in self.maps.nodes.of_part(p).iter().zip(&part.moves_m) {
                moves_m[joint as usize] = *move_m;
            }
        }
    }

    fn correct_step(&mut self, forces: &[NodalForce], dt_s: f64, correction: Correction) {
        self.hand_out(forces);
        self.all().for_each(|mut part| part.correct(dt_s, correction));
        self.publish();
        self.read_constraint_forces();
    }

    fn bring_up_to_date(&mut self) {
        self.all().for_each(|mut part| part.model.bring_up_to_date());
        self.publish();
    }

    fn expect_finer_mesh(&mut self, is_finer: bool) {
        self.all().for_each(|mut part| part.model.expect_finer_mesh(is_finer));
    }

    fn topology_refusal(&self) -> Option<TopologyRefusal> {
        let mut refusals = self.all().map(|part| part.model.topology_refusal());
        let first = refusals.next().flatten();
        if refusals.all(|refusal| refusal.is_some()) { first } else { None }
    }

    fn topology_changed(&mut self, mesh: &TetMesh, change: &TopologyChange) -> Result<(), TopologyRefusal> {
        self.follow(mesh, change)
    }

    fn save_for_undo(&self, change: &TopologyChange, undo: &mut ModelUndo) {
        self.save(change, undo);
    }

    fn undo(&mut self, undo: &ModelUndo) {
        self.go_back(undo);
    }
}
