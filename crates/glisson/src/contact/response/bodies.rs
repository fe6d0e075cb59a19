//! Explicit models that answer to each other's contacts: search, response, step in one thread, as the thesis ends up with
//! (seed `000`, s. 4.2.2, its second implementation).
//!
//! Penalty: contacts of the present state, their forces, then the models' steps. Impulse and geometric alteration: the models'
//! steps, then the contacts of what came out, whose impulses and shifts are put into the models
//! ([`DeformableModel::correct_step`]). Nodes that supports or tools hold do not answer.

use super::find::{ContactSearch, ContactSearchParams, RigidPlace};
use super::geometric::{self, GeometricParams};
use super::impulse::{self, ImpulseParams};
use super::penalty::{self, PenaltyParams};
use super::{Answer, NodeContact};
use crate::math::DVec3;
use crate::mesh::topology::{Topology, TopologyError, surface_of};
use crate::mesh::{NodeId, TetMesh};
use crate::model::{Constraints, Correction, DeformableModel, NodalForce, StepAnswer};

/// Which response.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ResponseKind {
    /// Springs and dampers.
    Penalty(PenaltyParams),
    /// Exchange of momentum.
    Impulse(ImpulseParams),
    /// Places and velocities are altered.
    Geometric(GeometricParams),
}

/// A body to put in.
pub struct RespondingBody {
    /// Its mesh at rest, compact.
    pub mesh: TetMesh,
    /// Its model, of the same mesh.
    pub model: Box<dyn DeformableModel>,
}

/// Why bodies cannot respond.
#[derive(Debug, thiserror::Error)]
pub enum ResponseSetUpError {
    /// A mesh is no mesh.
    #[error("body {body}: {source}")]
    Topology {
        /// Which body, from 0.
        body: usize,
        /// Why.
        source: TopologyError,
    },
    /// A model whose nodes do not answer one by one.
    #[error(
        "body {body}: its model answers to contact as {found:?}, but impulses act on single nodes; take an explicit \
         model, or the response by constraints"
    )]
    NotExplicit {
        /// Which body, from 0.
        body: usize,
        /// What it is.
        found: StepAnswer,
    },
    /// A body and its model have not the same nodes.
    #[error("body {body}: the mesh has {n_mesh} nodes, the model {n_model}")]
    Nodes {
        /// Which body, from 0.
        body: usize,
        /// Nodes of the mesh.
        n_mesh: usize,
        /// Nodes of the model.
        n_model: usize,
    },
}

/// How the last step went.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ResponseReport {
    /// Vertices within the margin of a surface.
    pub n_contacts: u32,
    /// Deepest vertex behind a surface, before the response [m].
    pub penetration_m: f64,
    /// Contacts and pairs that found no room.
    pub n_dropped: u32,
}

struct Body {
    model: Box<dyn DeformableModel>,
    outside: Constraints,
    all: Constraints,
    forces: Vec<NodalForce>,
}

/// The bodies. A step allocates nothing.
pub struct RespondingBodies {
    kind: ResponseKind,
    bodies: Vec<Body>,
    /// First vertex of each body, and the end.
    starts: Vec<usize>,
    /// The node of each vertex.
    nodes: Vec<NodeId>,
    search: ContactSearch,
    contacts: Vec<NodeContact>,
    positions_m: Vec<DVec3>,
    velocities_m_per_s: Vec<DVec3>,
    inverse_mass_per_kg: Vec<DVec3>,
    forces_n: Vec<DVec3>,
    answer: Answer,
    report: ResponseReport,
}

impl RespondingBodies {
    /// The bodies as they stand.
    ///
    /// # Errors
    /// [`ResponseSetUpError`]: a mesh that is none, a model that is not explicit or has other nodes.
    pub fn new(
        bodies: Vec<RespondingBody>,
        kind: ResponseKind,
        params: &ContactSearchParams,
    ) -> Result<Self, ResponseSetUpError> {
        let (mut starts, mut nodes, mut positions_m) = (vec![0], Vec::new(), Vec::new());
        let (mut triangles, mut body_of, mut kept) = (Vec::new(), Vec::new(), Vec::new());
        for (b, RespondingBody { mesh, model }) in bodies.into_iter().enumerate() {
            let (n_mesh, n_model) = (mesh.positions_m.len(), model.state().positions_m.len());
            if n_mesh != n_model {
                return Err(ResponseSetUpError::Nodes { body: b, n_mesh, n_model });
            }
            let found = model.step_answer();
            if found != StepAnswer::NodeByNode {
                return Err(ResponseSetUpError::NotExplicit { body: b, found });
            }
            let topology =
                Topology::build(&mesh).map_err(|source| ResponseSetUpError::Topology { body: b, source })?;
            let (surface, of_surface) = surface_of(&topology, &mesh);
            let first = nodes.len() as u32;
            triangles.extend(surface.triangles.iter().map(|t| t.map(|v| v + first)));
            body_of.resize(triangles.len(), b as u32);
            positions_m.extend(of_surface.iter().map(|n| model.state().positions_m[n.index()]));
            nodes.extend(of_surface);
            starts.push(nodes.len());
            let n = nodes.len() - first as usize;
            kept.push(Body {
                model,
                outside: Constraints::default(),
                all: Constraints {
                    displacements: Vec::with_capacity(n_mesh),
                    forces: Vec::with_capacity(n_mesh),
                },
                forces: Vec::with_capacity(n),
            });
        }
        let n = nodes.len();
        Ok(Self {
            kind,
            bodies: kept,
            starts,
            nodes,
            search: ContactSearch::new(params, &positions_m, &triangles, &body_of),
            // One for each vertex and one with a rigid surface.
            contacts: Vec::with_capacity(2 * n),
            positions_m,
            velocities_m_per_s: vec![DVec3::ZERO; n],
            inverse_mass_per_kg: vec![DVec3::ZERO; n],
            forces_n: vec![DVec3::ZERO; n],
            answer: Answer::none(n),
            report: ResponseReport::default(),
        })
    }

    /// A body's model.
    pub fn model(&self, body: usize) -> &dyn DeformableModel {
        self.bodies[body].model.as_ref()
    }

    /// A body's model, to be changed between steps.
    pub fn model_mut(&mut self, body: usize) -> &mut dyn DeformableModel {
        self.bodies[body].model.as_mut()
    }

    /// What acts on a body beside contact, from the next step on; lists ascend by node.
    pub fn set_constraints(&mut self, body: usize, constraints: &Constraints) {
        self.bodies[body].outside.clone_from(constraints);
    }

    /// How the last step went.
    pub fn report(&self) -> ResponseReport {
        self.report
    }

    /// The contacts of the last step.
    pub fn contacts(&self) -> &[NodeContact] {
        &self.contacts
    }

    /// Advances by `dt_s` without rigid surfaces.
    pub fn step(&mut self, dt_s: f64) {
        self.step_against(dt_s, None);
    }

    /// Advances by `dt_s`; `rigid` tells where a point is against rigid surfaces. Never fails.
    pub fn step_against(&mut self, dt_s: f64, rigid: Option<&dyn Fn(DVec3) -> RigidPlace>) {
        if !(dt_s.is_finite() && dt_s > 0.0) {
            return;
        }
        if let ResponseKind::Penalty(params) = self.kind {
            self.gather();
            self.find(rigid);
            self.forces_n.fill(DVec3::ZERO);
            penalty::add_forces(&params, &self.contacts, &self.velocities_m_per_s, &mut self.forces_n);
            for b in 0..self.bodies.len() {
                self.apply(b);
                self.bodies[b].model.step(dt_s);
            }
            return;
        }
        self.forces_n.fill(DVec3::ZERO);
        for b in 0..self.bodies.len() {
            self.apply(b);
            self.bodies[b].model.step(dt_s);
        }
        self.respond_to_step(dt_s, rigid);
    }

    /// Search, response and correction after steps of the models: what a step of impulses or geometric alteration does beside
    /// deforming. Does nothing for penalties.
    pub fn respond_to_step(&mut self, dt_s: f64, rigid: Option<&dyn Fn(DVec3) -> RigidPlace>) {
        self.gather();
        self.find(rigid);
        if self.contacts.is_empty() {
            return;
        }
        self.weigh(dt_s);
        self.answer.clear();
        let Self { contacts, inverse_mass_per_kg, velocities_m_per_s, answer, .. } = self;
        match &self.kind {
            ResponseKind::Penalty(_) => return,
            ResponseKind::Impulse(params) => {
                impulse::respond(params, contacts, inverse_mass_per_kg, velocities_m_per_s, answer);
            }
            ResponseKind::Geometric(params) => {
                geometric::respond(params, contacts, inverse_mass_per_kg, velocities_m_per_s, answer);
            }
        }
        for b in 0..self.bodies.len() {
            self.correct(b, dt_s);
        }
    }

    fn gather(&mut self) {
        for (b, body) in self.bodies.iter().enumerate() {
            let state = body.model.state();
            for v in self.starts[b]..self.starts[b + 1] {
                let n = self.nodes[v].index();
                self.positions_m[v] = state.positions_m[n];
                self.velocities_m_per_s[v] = state.velocities_m_per_s[n];
            }
        }
    }

    fn find(&mut self, rigid: Option<&dyn Fn(DVec3) -> RigidPlace>) {
        let mut n_dropped = self.search.find_into(&self.positions_m, &mut self.contacts);
        if let Some(place) = rigid {
            let all = 0..self.positions_m.len() as u32;
            n_dropped += self.search.add_rigid(all, &self.positions_m, place, &mut self.contacts);
        }
        self.report = ResponseReport {
            n_contacts: self.contacts.len() as u32,
            penetration_m: self.contacts.iter().fold(0.0, |deepest, c| deepest.max(-c.gap_m)),
            n_dropped: n_dropped as u32,
        };
    }

    /// Inverse masses of the vertices of contacts.
    fn weigh(&mut self, dt_s: f64) {
        for contact in &self.contacts {
            for (v, _) in contact.sides() {
                let body = self.starts.partition_point(|start| *start <= v) - 1;
                let answer_m_per_n = self.bodies[body].model.node_answer_m_per_n(self.nodes[v], dt_s);
                self.inverse_mass_per_kg[v] = answer_m_per_n / (dt_s * dt_s);
            }
        }
    }

    /// Outside constraints and contact forces; both ascend by node.
    fn apply(&mut self, b: usize) {
        let Body { model, outside, all, .. } = &mut self.bodies[b];
        all.displacements.clone_from(&outside.displacements);
        all.forces.clear();
        let mut from_outside = outside.forces.iter().copied().peekable();
        for v in self.starts[b]..self.starts[b + 1] {
            let (node, contact_n) = (self.nodes[v], self.forces_n[v]);
            if contact_n == DVec3::ZERO {
                continue;
            }
            while let Some(before) = from_outside.next_if(|f| f.node < node) {
                all.forces.push(before);
            }
            let also = from_outside.next_if(|f| f.node == node).map_or(DVec3::ZERO, |f| f.force_n);
            all.forces.push(NodalForce { node, force_n: contact_n + also });
        }
        all.forces.extend(from_outside);
        model.apply(all);
    }

    /// Velocities change by the impulses, places by the shifts alone.
    fn correct(&mut self, b: usize, dt_s: f64) {
        let Body { model, forces, .. } = &mut self.bodies[b];
        let vertices = self.starts[b]..self.starts[b + 1];
        let mut put_in = |correction, force_n: &dyn Fn(usize) -> DVec3| {
            forces.clear();
            forces.extend(vertices.clone().filter_map(|v| {
                let force_n = force_n(v);
                (force_n != DVec3::ZERO).then_some(NodalForce { node: self.nodes[v], force_n })
            }));
            if !forces.is_empty() {
                model.correct_step(forces, dt_s, correction);
            }
        };
        let Answer { impulses_n_s, shifts_kg_m } = &self.answer;
        put_in(Correction::Motion, &|v| impulses_n_s[v] / dt_s);
        // A corrected motion has also moved the nodes by dt times the change of velocity.
        put_in(Correction::Places, &|v| (shifts_kg_m[v] - impulses_n_s[v] * dt_s) / (dt_s * dt_s));
    }
}
