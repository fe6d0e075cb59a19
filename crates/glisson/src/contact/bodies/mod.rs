//! Deformable bodies and rigid obstacles in one world of contact.
//!
//! A step of length h:
//! 1. every model makes its step under the contact forces of the step before (the free motion of an incremental
//!    problem: at rest nothing is left to correct, so that what a correction misses does not matter there);
//! 2. what is near is found, and its gaps at the start of the step;
//! 3. the forces are solved for on the models' compliance ([`super::constraint`]): a gap may close, not more;
//! 4. every model corrects its step by what changed of the forces ([`DeformableModel::correct_step`]): exactly for explicit
//!    models, to first order for implicit ones, by a second step for quasi-static ones. That is one step of the
//!    model where stepping twice (free, then with forces) would cost two and a copy of its state;
//! 5. what is left inside is moved out without velocity: no energy of motion comes from it.
//!
//! Impacts are plastic at the nodes: kinetic energy is lost, never gained. A step allocates nothing but for quasi-static
//! models that do so themselves.

mod near;
mod obstacle;
mod surfaces;
mod set_up;

pub use obstacle::{Obstacle, ObstacleShape};
pub use set_up::{BodyParams, ContactParams, ContactSetUpError, pair_friction};

use self::near::Near;
use self::obstacle::MovingObstacle;
use self::surfaces::Surfaces;
use super::constraint::{Contact, ContactKey, Response, SweepReport, Sweeps, solve};
use super::shapes::RigidPose;
use crate::math::DVec3;
use crate::mesh::NodeId;
use crate::model::{
    Answered, Constraints, Correction, DeformableModel, LocalModel, LocalWork, NodalForce, StepAnswer,
};

/// How the last step went.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ContactReport {
    /// Contacts, those without force included.
    pub n_contacts: u32,
    /// Contacts with a force.
    pub n_pressed: u32,
    /// Sweeps of the solver.
    pub n_sweeps: u32,
    /// Largest change of a force in the last one, as a share of the largest force.
    pub residual: f64,
    /// Deepest place inside another surface at the start of the step [m]: the skin does not count.
    pub penetration_m: f64,
    /// Largest slip of a pressed contact in the step [m].
    pub slip_m: f64,
    /// Pairs or contacts that found no room; above 0 make room for more.
    pub n_dropped: u32,
    /// Searches for pairs in this step.
    pub n_searches: u32,
    /// Something moved further in the step than pairs are searched for: contacts may have been missed.
    pub is_too_fast: bool,
}

/// A contact after a step, for display and forces to devices.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactPoint {
    /// Bodies or, from the number of bodies on, obstacles.
    pub partners: [u32; 2],
    /// Where at the start of the step [m].
    pub point_m: DVec3,
    /// Unit normal towards the first partner.
    pub normal: DVec3,
    /// Gap beyond the skin at the start of the step [m].
    pub gap_m: f64,
    /// Force on the first partner [N].
    pub force_n: DVec3,
}

/// A body with its part in contact.
struct Body {
    model: Box<dyn DeformableModel>,
    friction: f64,
    /// What acts from elsewhere.
    outside: Constraints,
    /// That and the contact forces.
    all: Constraints,
    corrections: Vec<NodalForce>,
    /// Versions of search and answer for which the group of the response holds.
    coupled_for: Option<(u64, u64)>,
    /// Answer of a coupled model.
    answer_m: Vec<DVec3>,
}

/// The bodies and obstacles. Bodies are counted first, then obstacles.
pub struct CollidingBodies {
    params: ContactParams,
    bodies: Vec<Body>,
    obstacles: Vec<MovingObstacle>,
    surfaces: Surfaces,
    near: Near,
    response: Response,
    contacts: Vec<Contact>,
    /// Those of the step before, ascending by key, and whether a new one took their force.
    before: Vec<(Contact, bool)>,
    /// For taking penetrations out.
    pushes: Vec<Contact>,
    shifts_m: Vec<DVec3>,
    /// Forces on the vertices that the models have felt, and that they are to feel [N].
    applied_n: Vec<DVec3>,
    wanted_n: Vec<DVec3>,
    near_vertices: Vec<u32>,
    local: LocalModel,
    work: LocalWork,
    report: ContactReport,
}

impl CollidingBodies {
    /// The model of a body.
    pub fn model(&self, body: usize) -> &dyn DeformableModel {
        self.bodies[body].model.as_ref()
    }

    /// The model of a body, to be changed between steps.
    pub fn model_mut(&mut self, body: usize) -> &mut Box<dyn DeformableModel> {
        &mut self.bodies[body].model
    }

    /// What acts on a body beside contact, from the next step on. Lists ascend by node; forces for which there is no room are
    /// left out.
    pub fn set_constraints(&mut self, body: usize, constraints: &Constraints) {
        let outside = &mut self.bodies[body].outside;
        outside.displacements.clear();
        outside.forces.clear();
        outside.displacements.extend_from_slice(&constraints.displacements);
        outside.forces.extend_from_slice(&constraints.forces);
    }

    /// Where an obstacle goes in the next step; it stays there.
    pub fn move_obstacle(&mut self, obstacle: usize, end: RigidPose) {
        self.obstacles[obstacle].end = end;
    }

    /// Number of bodies.
    pub fn n_bodies(&self) -> usize {
        self.bodies.len()
    }

    /// How the last step went.
    pub fn report(&self) -> ContactReport {
        self.report
    }

    /// The contacts of the last step.
    pub fn contacts(&self) -> impl Iterator<Item = ContactPoint> + '_ {
        self.contacts.iter().map(|c| ContactPoint {
            partners: self.partners(c),
            point_m: c.point_m,
            normal: c.normal,
            gap_m: c.gap_m,
            force_n: c.force_n,
        })
    }

    /// Sum of the forces [N] that a body or obstacle felt from all others in the last step.
    pub fn force_on_n(&self, partner: usize) -> DVec3 {
        let partner = partner as u32;
        let of_contact = |c: &Contact| {
            let [first, second] = self.partners(c);
            let sign = f64::from(u8::from(first == partner)) - f64::from(u8::from(second == partner));
            c.force_n * sign
        };
        self.contacts.iter().map(of_contact).sum()
    }

    fn partners(&self, contact: &Contact) -> [u32; 2] {
        let owner = |v: u32| self.surfaces.owner[v as usize];
        let first = owner(contact.vertices[0]);
        match contact.key {
            ContactKey::VertexTriangle(..) => [first, owner(contact.vertices[1])],
            ContactKey::Edges(..) => [first, owner(contact.vertices[2])],
            ContactKey::VertexObstacle(_, o)
            | ContactKey::TriangleObstacle(_, o)
            | ContactKey::EdgeObstacle(_, o) => [first, o],
        }
    }

    /// Advances everything by `dt_s`. Never fails.
    pub fn step(&mut self, dt_s: f64) {
        if !(dt_s.is_finite() && dt_s > 0.0) {
            return;
        }
        self.step_freely(dt_s);
        self.near.update(&self.surfaces);
        self.near.contacts_into(&self.surfaces, &self.obstacles, &mut self.contacts);
        self.begin_forces();
        self.update_response(dt_s);
        self.add_change_of_forces();
        let sweeps = Sweeps { most: self.params.most_sweeps, tolerance: self.params.tolerance };
        let found = solve(&mut self.contacts, &self.response, sweeps, &mut self.surfaces.moves_m);
        self.correct(dt_s);
        self.push_out(dt_s);
        self.end(found);
    }

    /// The models' own steps, under the forces of the last one; how far their surfaces went.
    fn step_freely(&mut self, dt_s: f64) {
        let Self { bodies, surfaces, obstacles, applied_n, .. } = self;
        for (b, body) in bodies.iter_mut().enumerate() {
            let vertices = surfaces.vertices_of(b);
            let positions_m = body.model.state().positions_m;
            for v in vertices.clone() {
                surfaces.start_m[v] = positions_m[surfaces.nodes[v].index()];
            }
            body.apply(&surfaces.nodes[vertices.clone()], &applied_n[vertices.clone()]);
            body.model.step(dt_s);
            let positions_m = body.model.state().positions_m;
            for v in vertices {
                surfaces.moves_m[v] = positions_m[surfaces.nodes[v].index()] - surfaces.start_m[v];
            }
        }
        let n_bodies = bodies.len();
        for (o, moving) in obstacles.iter().enumerate() {
            if let ObstacleShape::Mesh(shape) = &moving.obstacle.shape {
                for (v, p_m) in surfaces.vertices_of(n_bodies + o).zip(&shape.positions_m) {
                    let at = |pose: RigidPose| pose.rotation * *p_m + pose.origin_m;
                    surfaces.start_m[v] = at(moving.obstacle.pose);
                    surfaces.moves_m[v] = at(moving.end) - surfaces.start_m[v];
                }
            }
        }
    }

    /// Gives the contacts their friction and the forces of the step before.
    fn begin_forces(&mut self) {
        let friction_of = |partner: u32| {
            let obstacle = (partner as usize).checked_sub(self.bodies.len());
            match obstacle {
                Some(o) => self.obstacles[o].obstacle.friction,
                None => self.bodies[partner as usize].friction,
            }
        };
        for place in 0..self.contacts.len() {
            let partners = self.partners(&self.contacts[place]);
            self.contacts[place].friction = pair_friction(partners.map(friction_of));
            // What is static has no velocity that a correction could leave behind, and cannot be moved without force.
            let is_static = |p: &u32| {
                let body = self.bodies.get(*p as usize);
                body.is_some_and(|b| b.model.step_answer() == StepAnswer::Static)
            };
            if self.contacts[place].gap_m < 0.0 && partners.iter().any(is_static) {
                self.contacts[place].slack_m = PUSH_SHARE * self.contacts[place].gap_m;
            }
            let key = self.contacts[place].key;
            if let Ok(at) = self.before.binary_search_by_key(&key, |(c, _)| c.key) {
                self.before[at].1 = true;
                self.contacts[place].force_n = self.contacts[place].into_cone(self.before[at].0.force_n);
            }
        }
        // A vertex that went on to another triangle of the same partner takes its force along.
        for place in 0..self.contacts.len() {
            let contact = self.contacts[place];
            let ContactKey::VertexTriangle(v, _) = contact.key else { continue };
            if contact.force_n != DVec3::ZERO {
                continue;
            }
            let first = self.before.partition_point(|(c, _)| c.key < ContactKey::VertexTriangle(v, 0));
            let owner = &self.surfaces.owner;
            let same = self.before[first..]
                .iter_mut()
                .take_while(|(c, _)| matches!(c.key, ContactKey::VertexTriangle(w, _) if w == v))
                .find(|(c, taken)| {
                    !taken && owner[c.vertices[1] as usize] == owner[contact.vertices[1] as usize]
                });
            if let Some((known, taken)) = same {
                *taken = true;
                self.contacts[place].force_n = contact.into_cone(known.force_n);
            }
        }
    }

    /// How the vertices of the contacts answer in this step.
    fn update_response(&mut self, dt_s: f64) {
        for place in 0..self.contacts.len() {
            let contact = self.contacts[place];
            for (v, _) in contact.sides() {
                let owner = self.surfaces.owner[v as usize] as usize;
                let Some(body) = self.bodies.get(owner) else { continue };
                if body.model.step_answer() == StepAnswer::NodeByNode {
                    let answer = body.model.node_answer_m_per_n(self.surfaces.nodes[v as usize], dt_s);
                    self.response.set_alone(v, answer);
                }
            }
        }
        // What was pressed before and is no longer: its force is to be taken out.
        for v in (0..self.applied_n.len()).filter(|&v| self.applied_n[v] != DVec3::ZERO) {
            if let Some(body) = self.bodies.get(self.surfaces.owner[v] as usize)
                && body.model.step_answer() == StepAnswer::NodeByNode
            {
                let answer = body.model.node_answer_m_per_n(self.surfaces.nodes[v], dt_s);
                self.response.set_alone(v as u32, answer);
            }
        }
        for b in 0..self.bodies.len() {
            self.update_group(b, dt_s);
        }
    }

    /// How the vertices near contact of a body that answers as a whole do so, where that may have changed.
    fn update_group(&mut self, b: usize, dt_s: f64) {
        let answer = self.bodies[b].model.step_answer();
        let version = match answer {
            StepAnswer::Unknown | StepAnswer::NodeByNode => return,
            StepAnswer::Coupled { version } => version,
            StepAnswer::Static => 0,
        };
        let wanted = Some((self.near.version(), version));
        let range = self.surfaces.vertices_of(b);
        let is_of_body = |v: u32| range.contains(&(v as usize));
        let has_all = self
            .contacts
            .iter()
            .flat_map(Contact::sides)
            .map(|(v, _)| v)
            .chain(range.clone().filter(|&v| self.applied_n[v] != DVec3::ZERO).map(|v| v as u32))
            .all(|v| !is_of_body(v) || self.response.group(b).vertices.binary_search(&v).is_ok());
        if self.bodies[b].coupled_for == wanted && has_all && answer != StepAnswer::Static {
            return;
        }
        self.bodies[b].coupled_for = wanted;
        let list = &mut self.near_vertices;
        list.clear();
        let mut add = |v: u32| {
            if is_of_body(v) && list.len() < list.capacity() {
                list.push(v);
            }
        };
        if answer != StepAnswer::Static {
            self.near.for_each_near_vertex(&self.surfaces, &mut add);
        }
        self.contacts.iter().flat_map(Contact::sides).for_each(|(v, _)| add(v));
        range.clone().filter(|&v| self.applied_n[v] != DVec3::ZERO).for_each(|v| add(v as u32));
        list.sort_unstable();
        list.dedup();
        list.truncate(self.params.most_coupled);
        self.response.set_group(b, list.iter().copied());
        if answer == StepAnswer::Static {
            self.fill_static(b, dt_s);
        } else {
            self.fill_coupled(b);
        }
    }

    /// Columns of the compliance, three solutions a vertex.
    fn fill_coupled(&mut self, b: usize) {
        let Self { bodies, surfaces, response, near_vertices, .. } = self;
        let body = &mut bodies[b];
        let columns = &mut response.group_mut(b).compliance_m_per_n;
        columns.clear();
        for &by in near_vertices.iter() {
            let first = columns.len();
            columns.resize(first + near_vertices.len(), crate::math::DMat3::ZERO);
            for axis in 0..3 {
                let mut force_n = DVec3::ZERO;
                force_n[axis] = 1.0;
                let force = NodalForce { node: surfaces.nodes[by as usize], force_n };
                body.model.answer_into(&[force], &mut body.answer_m, Answered::Everywhere);
                for (of, block) in near_vertices.iter().zip(&mut columns[first..]) {
                    *block.col_mut(axis) = body.answer_m[surfaces.nodes[*of as usize].index()];
                }
            }
        }
    }

    /// The static compliance from local models of two halves of a patch at a time: exact for any number of vertices.
    fn fill_static(&mut self, b: usize, dt_s: f64) {
        const HALF: usize = LocalModel::MOST_NODES / 2;
        let Self { bodies, surfaces, response, near_vertices, local, work, .. } = self;
        let n = near_vertices.len();
        let columns = &mut response.group_mut(b).compliance_m_per_n;
        columns.clear();
        columns.resize(n * n, crate::math::DMat3::ZERO);
        let halves = || near_vertices.chunks(HALF).enumerate();
        for (i, one) in halves() {
            for (j, other) in halves().filter(|(j, _)| *j > i || near_vertices.len() <= HALF) {
                let mut patch = [NodeId(0); LocalModel::MOST_NODES];
                let mut places = [0; LocalModel::MOST_NODES];
                let mut len = 0;
                let mut add = |chunk: usize, list: &[u32]| {
                    for (k, v) in list.iter().enumerate() {
                        patch[len] = surfaces.nodes[*v as usize];
                        places[len] = chunk * HALF + k;
                        len += 1;
                    }
                };
                add(i, one);
                if j != i {
                    add(j, other);
                }
                bodies[b].model.local_model_into(&patch[..len], dt_s, work, local);
                for (p, row) in local.nodes.iter().enumerate() {
                    for (q, column) in local.nodes.iter().enumerate() {
                        let place = |node: &NodeId| {
                            patch[..len].iter().position(|n| n == node).map_or(0, |at| places[at])
                        };
                        columns[place(column) * n + place(row)] = local.tensor_m_per_n(p, q);
                    }
                }
            }
        }
    }

    /// Sums the forces of the contacts at the vertices.
    fn gather_forces(&mut self) {
        self.wanted_n.fill(DVec3::ZERO);
        for contact in &self.contacts {
            if contact.force_n != DVec3::ZERO {
                for (v, weight) in contact.sides() {
                    self.wanted_n[v as usize] += contact.force_n * weight;
                }
            }
        }
    }

    /// Brings the moves to what they would be under the first guess of the forces: normals and weights changed since they
    /// were applied, and some contacts went.
    fn add_change_of_forces(&mut self) {
        self.gather_forces();
        for (v, (wanted_n, applied_n)) in self.wanted_n.iter().zip(&self.applied_n).enumerate() {
            let change_n = *wanted_n - *applied_n;
            if change_n != DVec3::ZERO {
                self.response.add(v as u32, change_n, &mut self.surfaces.moves_m);
            }
        }
    }

    /// Brings the models to the step that the forces make.
    fn correct(&mut self, dt_s: f64) {
        self.gather_forces();
        let Self { bodies, surfaces, applied_n, wanted_n, .. } = self;
        for (b, body) in bodies.iter_mut().enumerate() {
            body.corrections.clear();
            for v in surfaces.vertices_of(b) {
                let force_n = wanted_n[v] - applied_n[v];
                if force_n != DVec3::ZERO {
                    body.corrections.push(NodalForce { node: surfaces.nodes[v], force_n });
                }
            }
            if body.corrections.is_empty() {
                continue;
            }
            if body.model.step_answer() == StepAnswer::Static {
                let vertices = surfaces.vertices_of(b);
                body.apply(&surfaces.nodes[vertices.clone()], &wanted_n[vertices]);
                body.model.step(dt_s);
            } else {
                body.model.correct_step(&body.corrections, dt_s, Correction::Motion);
            }
        }
        applied_n.copy_from_slice(wanted_n);
    }

    /// Moves what is inside outwards by a share of its depth, places alone.
    fn push_out(&mut self, dt_s: f64) {
        let is_inside = |c: &Contact, moves_m: &[DVec3]| {
            c.gap_m + c.normal.dot(c.relative_m(moves_m)) < -PUSH_TOLERANCE * self.params.skin_m
        };
        if !self.contacts.iter().any(|c| is_inside(c, &self.surfaces.moves_m)) {
            return;
        }
        self.pushes.clear();
        for contact in &self.contacts {
            let gap_m = contact.gap_m + contact.normal.dot(contact.relative_m(&self.surfaces.moves_m));
            let slack_m = if gap_m < 0.0 { PUSH_SHARE * gap_m } else { gap_m };
            self.pushes.push(contact.without_force(slack_m));
        }
        self.shifts_m.fill(DVec3::ZERO);
        let sweeps = Sweeps { most: PUSH_SWEEPS, tolerance: PUSH_ACCURACY };
        solve(&mut self.pushes, &self.response, sweeps, &mut self.shifts_m);
        self.wanted_n.fill(DVec3::ZERO);
        for push in &self.pushes {
            for (v, weight) in push.sides() {
                self.wanted_n[v as usize] += push.force_n * weight;
            }
        }
        let Self { bodies, surfaces, wanted_n, .. } = self;
        for (b, body) in bodies.iter_mut().enumerate() {
            body.corrections.clear();
            for v in surfaces.vertices_of(b).filter(|&v| wanted_n[v] != DVec3::ZERO) {
                body.corrections.push(NodalForce { node: surfaces.nodes[v], force_n: wanted_n[v] });
            }
            if !body.corrections.is_empty() {
                body.model.correct_step(&body.corrections, dt_s, Correction::Places);
            }
        }
    }

    /// Keeps the forces for the next step, and gives account.
    fn end(&mut self, found: SweepReport) {
        self.before.clear();
        let near = self.near.report();
        let mut report = ContactReport {
            n_contacts: self.contacts.len() as u32,
            n_sweeps: found.n_sweeps,
            residual: found.residual,
            n_dropped: near.n_dropped,
            n_searches: near.n_searches,
            is_too_fast: near.is_too_fast,
            ..ContactReport::default()
        };
        for contact in &self.contacts {
            report.penetration_m = report.penetration_m.max(-contact.gap_m - self.params.skin_m);
            if contact.force_n != DVec3::ZERO {
                report.n_pressed += 1;
                let u = contact.relative_m(&self.surfaces.moves_m);
                let slip_m = (u - contact.normal * u.dot(contact.normal)).length();
                report.slip_m = report.slip_m.max(slip_m);
                self.before.push((*contact, false));
            }
        }
        self.before.sort_unstable_by_key(|(contact, _)| contact.key);
        self.obstacles.iter_mut().for_each(MovingObstacle::end_step);
        self.report = report;
    }
}

impl Body {
    /// Tells the model what acts from elsewhere, and the forces of contact.
    fn apply(&mut self, nodes: &[NodeId], contact_n: &[DVec3]) {
        let Self { outside, all, .. } = self;
        all.displacements.clear();
        all.displacements.extend_from_slice(&outside.displacements);
        all.forces.clear();
        let mut rest = outside.forces.iter().peekable();
        for (node, force_n) in nodes.iter().zip(contact_n).filter(|(_, f)| **f != DVec3::ZERO) {
            while let Some(force) = rest.next_if(|force| force.node < *node) {
                all.forces.push(*force);
            }
            let also_n = rest.next_if(|force| force.node == *node).map_or(DVec3::ZERO, |force| force.force_n);
            all.forces.push(NodalForce { node: *node, force_n: *force_n + also_n });
        }
        all.forces.extend(rest);
        self.model.apply(&self.all);
    }
}

/// Depth, as a share of the skin, that is left alone.
const PUSH_TOLERANCE: f64 = 0.01;
/// Share of a depth that is taken out in a step, sweeps for it and when they end: choices.
const PUSH_SHARE: f64 = 0.2;
const PUSH_SWEEPS: u32 = 10;
const PUSH_ACCURACY: f64 = 1e-2;
