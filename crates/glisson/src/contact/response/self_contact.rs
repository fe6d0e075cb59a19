//! A body that touches itself: folds of its surface, and pieces that were cut loose within the same mesh.
//!
//! The body's whole surface is searched ([`super::find`] with its rest shape); places that share a vertex, that face the same
//! way or that are the two sides of a wall do not count. Contacts of the step just made are answered
//! - by geometric alteration ([`super::geometric`]) when the model's nodes answer one by one,
//! - by forces solved for on the model's answer ([`super::coupled`]) when they answer together: first what keeps the gaps from
//!   closing further, as motion, then what opens those that are too narrow, as places alone;
//!
//! or by springs ([`super::penalty`]) that act in the next step, which any model follows that knows forces.
//! The answer depends on the present state alone. What is nearer than the margin to a triangle's back counts as having
//! come through it: nothing may move by more than the margin in a step.

use super::bodies::ResponseReport;
use super::coupled::{CoupledForces, CoupledParams};
use super::find::{ContactSearch, ContactSearchParams};
use super::geometric::{self, GeometricParams};
use super::penalty::{PenaltyLaw, PenaltyParams};
use super::{Answer, NodeContact};
use crate::contact::broad_phase::BroadPhaseKind;
use crate::math::DVec3;
use crate::mesh::topology::{Through, Topology, surface_of};
use crate::mesh::{NodeId, TetMesh};
use crate::model::{Correction, DeformableModel, NodalForce, StepAnswer};

/// Which response.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SelfContactResponse {
    /// Places and velocities of the step just made are altered.
    Geometric(GeometricParams),
    /// Springs and dampers act in the next step.
    Penalty(PenaltyParams),
}

/// How a body touches itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SelfContactParams {
    /// Distance up to which a vertex counts, outside and inside [m]: more than it moves in a step.
    pub margin_m: f64,
    /// What keeps the surfaces apart.
    pub response: SelfContactResponse,
}

impl SelfContactParams {
    /// Margin when none is given [m], in steps of `dt_s`: 2 mm, or the way at 1 m/s if that is more. Choices.
    pub fn default_margin_m(dt_s: f64) -> f64 {
        (FASTEST_M_PER_S * dt_s).max(LEAST_MARGIN_M)
    }

    /// Friction of wet tissue on itself when none is given: a choice.
    pub const DEFAULT_FRICTION: f64 = 0.2;

    /// The geometric response: all of the depth is undone in a step, in four rounds (choices).
    pub const fn geometric(friction: f64) -> SelfContactResponse {
        SelfContactResponse::Geometric(GeometricParams { rest_gap_m: 0.0, share: 1.0, friction, n_sweeps: 4 })
    }

    /// A linear spring on each vertex that gives back a quarter of its force when the surfaces recede (a choice).
    pub const fn penalty(stiffness_n_per_m: f64, friction: f64) -> SelfContactResponse {
        let elastic = PenaltyParams::linear(stiffness_n_per_m, 0.0);
        SelfContactResponse::Penalty(PenaltyParams { receding_share: 0.25, friction, ..elastic })
    }
}

const FASTEST_M_PER_S: f64 = 1.0;
const LEAST_MARGIN_M: f64 = 2e-3;

/// Answers of a coupled model in a step at most, for motion and for places: choices.
const ANSWERS_FOR_MOTION: u32 = 8;
const ANSWERS_FOR_PLACES: u32 = 4;
/// Overlap that is not worth a correction of places [m].
const SMALL_OVERLAP_M: f64 = 1e-6;
/// A spring moves a node of an explicit model by this share of its depth in a step at most: with more it would swing up.
const MOST_OF_DEPTH: f64 = 0.5;

/// The search and the response. Steps allocate nothing; made anew after each edit of the mesh.
#[derive(Debug)]
pub struct SelfContact {
    params: SelfContactParams,
    /// The node of each vertex, ascending.
    nodes: Vec<NodeId>,
    n_nodes: usize,
    search: ContactSearch,
    contacts: Vec<NodeContact>,
    /// What each contact bore in the last step, for those who look on.
    contact_forces_n: Vec<DVec3>,
    positions_m: Vec<DVec3>,
    velocities_m_per_s: Vec<DVec3>,
    inverse_mass_per_kg: Vec<DVec3>,
    forces_n: Vec<DVec3>,
    answer: Answer,
    coupled: CoupledForces,
    list: Vec<NodalForce>,
    report: ResponseReport,
}

impl Clone for SelfContact {
    /// A copy with all its room.
    fn clone(&self) -> Self {
        let n = self.nodes.len();
        Self {
            params: self.params,
            nodes: self.nodes.clone(),
            n_nodes: self.n_nodes,
            search: self.search.clone(),
            contacts: Vec::with_capacity(n),
            contact_forces_n: Vec::with_capacity(n),
            positions_m: self.positions_m.clone(),
            velocities_m_per_s: self.velocities_m_per_s.clone(),
            inverse_mass_per_kg: self.inverse_mass_per_kg.clone(),
            forces_n: self.forces_n.clone(),
            answer: self.answer.clone(),
            coupled: self.coupled.duplicate(),
            list: Vec::with_capacity(n),
            report: self.report,
        }
    }
}

impl SelfContact {
    /// For a body with this mesh at rest whose nodes are at `positions_m`.
    pub fn new(
        params: &SelfContactParams,
        topology: &Topology,
        mesh: &TetMesh,
        positions_m: &[DVec3],
    ) -> Self {
        let (surface, nodes) = surface_of(topology, mesh);
        let pieces = topology.pieces(Through::Nodes);
        let piece = |n: &NodeId| topology.node_tets(*n).first().map_or(0, |t| pieces.of_tet[t.index()]);
        let piece_of: Vec<u32> = nodes.iter().map(piece).collect();
        let now_m: Vec<DVec3> = nodes.iter().map(|n| positions_m[n.index()]).collect();
        let body_of = vec![0; surface.triangles.len()];
        let search = ContactSearchParams {
            kind: BroadPhaseKind::Hierarchy,
            margin_m: params.margin_m,
            self_collision: true,
            pair_capacity: 0,
        };
        let n = nodes.len();
        Self {
            params: *params,
            search: ContactSearch::new(&search, &now_m, &surface.triangles, &body_of)
                .with_rest_shape(surface.positions_m, piece_of),
            contacts: Vec::with_capacity(n),
            contact_forces_n: Vec::with_capacity(n),
            positions_m: now_m,
            velocities_m_per_s: vec![DVec3::ZERO; n],
            inverse_mass_per_kg: vec![DVec3::ZERO; n],
            forces_n: vec![DVec3::ZERO; n],
            answer: Answer::none(n),
            coupled: CoupledForces::new(n, mesh.positions_m.len()),
            list: Vec::with_capacity(n),
            n_nodes: mesh.positions_m.len(),
            nodes,
            report: ResponseReport::default(),
        }
    }

    /// How it is done.
    pub fn params(&self) -> &SelfContactParams {
        &self.params
    }

    /// How the last step went; its penetration is that before the response.
    pub fn report(&self) -> ResponseReport {
        self.report
    }

    /// The contacts of the last step, over vertices ([`SelfContact::nodes`]).
    pub fn contacts(&self) -> &[NodeContact] {
        &self.contacts
    }

    /// Force on the vertex of each of these contacts in the last step [N]: what stopped the two sides, without what put them back
    /// out of each other.
    pub fn contact_forces_n(&self) -> &[DVec3] {
        &self.contact_forces_n
    }

    /// The node of each vertex.
    pub fn nodes(&self) -> &[NodeId] {
        &self.nodes
    }

    /// Forgets the contacts of the last step.
    pub fn forget(&mut self) {
        self.contacts.clear();
        self.contact_forces_n.clear();
        self.report = ResponseReport::default();
    }

    /// Finds the contacts of the present state.
    fn find(&mut self, model: &dyn DeformableModel) {
        let state = model.state();
        let is_moving = state.velocities_m_per_s.len() == state.positions_m.len();
        for (v, node) in self.nodes.iter().enumerate() {
            self.positions_m[v] = state.positions_m[node.index()];
            self.velocities_m_per_s[v] =
                if is_moving { state.velocities_m_per_s[node.index()] } else { DVec3::ZERO };
        }
        let n_dropped = self.search.find_into(&self.positions_m, &mut self.contacts) as u32;
        let nodes = &self.nodes;
        self.contacts
            .retain(|contact| model.can_part(&mut contact.sides().map(|(v, weight)| (nodes[v], weight))));
        self.contact_forces_n.clear();
        self.contact_forces_n.resize(self.contacts.len(), DVec3::ZERO);
        let penetration_m = self.contacts.iter().fold(0.0, |deepest: f64, c| deepest.max(-c.gap_m));
        self.report = ResponseReport { n_contacts: self.contacts.len() as u32, penetration_m, n_dropped };
    }

    /// Forces of the springs in the next step of `dt_s`, ascending by node; none with the geometric response. Allocates nothing.
    pub fn forces(&mut self, model: &dyn DeformableModel, dt_s: f64) -> &[NodalForce] {
        self.list.clear();
        let SelfContactResponse::Penalty(params) = self.params.response else { return &self.list };
        if model.state().positions_m.len() != self.n_nodes {
            return &self.list;
        }
        self.find(model);
        self.forces_n.fill(DVec3::ZERO);
        let is_explicit = model.step_answer() == StepAnswer::NodeByNode;
        for (contact, contact_force_n) in self.contacts.iter().zip(&mut self.contact_forces_n) {
            let mut params = params;
            if let (true, PenaltyLaw::Linear { stiffness_n_per_m }) = (is_explicit, params.law) {
                let answers_m_per_n = |v: usize| model.node_answer_m_per_n(self.nodes[v], dt_s);
                let along = |v: usize| contact.normal.dot(answers_m_per_n(v) * contact.normal);
                let yields_m_per_n: f64 = contact.sides().map(|(v, w)| w * w * along(v)).sum();
                let most_n_per_m = MOST_OF_DEPTH / yields_m_per_n.max(f64::MIN_POSITIVE);
                params.law = PenaltyLaw::Linear { stiffness_n_per_m: stiffness_n_per_m.min(most_n_per_m) };
            }
            *contact_force_n = params.force_n(contact, &self.velocities_m_per_s);
            for (v, w) in contact.sides() {
                self.forces_n[v] += *contact_force_n * w;
            }
        }
        list_forces(&self.forces_n, &self.nodes, &mut self.list);
        &self.list
    }

    /// Answers to the contacts that a step of `dt_s` brought about; springs have done so before it. Allocates nothing.
    pub fn respond_to_step(&mut self, model: &mut dyn DeformableModel, dt_s: f64) {
        let SelfContactResponse::Geometric(params) = self.params.response else { return };
        let answer = model.step_answer();
        let is_told = matches!(answer, StepAnswer::NodeByNode | StepAnswer::Coupled { .. });
        if !is_told || model.state().positions_m.len() != self.n_nodes {
            self.forget();
            return;
        }
        self.find(model);
        if self.contacts.is_empty() {
            return;
        }
        if answer == StepAnswer::NodeByNode {
            self.respond_node_by_node(&params, model, dt_s);
        } else {
            self.respond_coupled(&params, model, dt_s);
        }
    }

    fn respond_node_by_node(&mut self, params: &GeometricParams, model: &mut dyn DeformableModel, dt_s: f64) {
        for contact in &self.contacts {
            for (v, _) in contact.sides() {
                let answer_m_per_n = model.node_answer_m_per_n(self.nodes[v], dt_s);
                self.inverse_mass_per_kg[v] = answer_m_per_n / (dt_s * dt_s);
            }
        }
        self.answer.clear();
        let Self { contacts, contact_forces_n, inverse_mass_per_kg, velocities_m_per_s, answer, .. } = self;
        let note = |place: usize, impulse_n_s: DVec3| contact_forces_n[place] += impulse_n_s / dt_s;
        geometric::respond_noting(params, contacts, inverse_mass_per_kg, velocities_m_per_s, answer, note);
        let Self { answer, forces_n, nodes, list, .. } = self;
        let Answer { impulses_n_s, shifts_kg_m } = &*answer;
        for (force_n, impulse_n_s) in forces_n.iter_mut().zip(impulses_n_s) {
            *force_n = *impulse_n_s / dt_s;
        }
        list_forces(forces_n, nodes, list);
        if !list.is_empty() {
            model.correct_step(list, dt_s, Correction::Motion);
        }
        // A corrected motion has also moved the nodes by dt times the change of velocity.
        for ((force_n, impulse_n_s), shift_kg_m) in forces_n.iter_mut().zip(impulses_n_s).zip(shifts_kg_m) {
            *force_n = (*shift_kg_m - *impulse_n_s * dt_s) / (dt_s * dt_s);
        }
        list_forces(forces_n, nodes, list);
        if !list.is_empty() {
            model.correct_step(list, dt_s, Correction::Places);
        }
    }

    fn respond_coupled(&mut self, params: &GeometricParams, model: &mut dyn DeformableModel, dt_s: f64) {
        let Self { contacts, contact_forces_n, velocities_m_per_s, coupled, nodes, .. } = self;
        for (contact, opening_m) in contacts.iter().zip(&mut coupled.openings_m) {
            let n = contact.normal;
            let way_m = contact.relative_m_per_s(velocities_m_per_s) * dt_s;
            let opens_m = way_m.dot(n);
            // A gap may close, an overlap may stay: it is no motion that takes it out.
            *opening_m = n * opens_m.max(contact.gap_m - params.rest_gap_m) + (way_m - n * opens_m);
        }
        let motion = CoupledParams { friction: params.friction, n_answers: ANSWERS_FOR_MOTION };
        if coupled.solve(model, contacts, nodes, &motion) {
            model.correct_step(coupled.nodal_forces(contacts, nodes), dt_s, Correction::Motion);
            contact_forces_n.copy_from_slice(&coupled.forces_n()[..contacts.len()]);
        }
        let mut narrowest_m = 0.0_f64;
        for (c, contact) in contacts.iter().enumerate() {
            let n = contact.normal;
            let room_m = contact.gap_m - params.rest_gap_m + coupled.moves_m()[c].dot(n);
            let opening_m = if room_m < 0.0 { params.share * room_m } else { room_m };
            coupled.openings_m[c] = n * opening_m;
            narrowest_m = narrowest_m.min(room_m);
        }
        let places = CoupledParams { friction: 0.0, n_answers: ANSWERS_FOR_PLACES };
        if narrowest_m < -SMALL_OVERLAP_M && coupled.solve(model, contacts, nodes, &places) {
            model.correct_step(coupled.nodal_forces(contacts, nodes), dt_s, Correction::Places);
        }
    }
}

/// Those that are not zero, ascending.
fn list_forces(forces_n: &[DVec3], nodes: &[NodeId], list: &mut Vec<NodalForce>) {
    list.clear();
    let forces = forces_n.iter().zip(nodes).filter(|(force_n, _)| **force_n != DVec3::ZERO);
    list.extend(forces.map(|(&force_n, &node)| NodalForce { node, force_n }));
}
