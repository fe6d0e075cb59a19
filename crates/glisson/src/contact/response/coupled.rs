//! Contact forces of a model whose nodes answer together: non-penetration and Coulomb's friction without a matrix.
//!
//! Sought are forces f of the contacts with the relative displacements r = J A J^T f that they bring about in the step, A
//! the model's answer ([`DeformableModel::answer_into`]). With the opening o that each contact has left without them and the way
//! s it slides, in every contact
//!
//! 0 <= f.n,   o + n.r >= 0,   f.n (o + n.r) = 0,   |f_t| <= mu f.n, f_t against s + r_t.
//!
//! It is the fixed point of f = P(f - rho q), q = n (o + n.r) + (s + r_t), P the projection of the normal part to f.n >= 0
//! and of f_t to the disc of radius mu f.n, found with steps rho by Barzilai and Borwein (1988, "Two-point step size
//! gradient methods", IMA J. Numer. Anal. 8(1), doi 10.1093/imanum/8.1.141). Every step asks the model once, whatever the
//! number of contacts: what is left after a given number of them is made good in the next steps. Such steps do not come nearer each
//! time. Those forces count of all that were tried for which f.(o + s + r/2) is least, the energy that f would minimize without
//! friction: it is zero without forces, so that contact never gives the body energy.

use super::NodeContact;
use crate::math::DVec3;
use crate::mesh::NodeId;
use crate::model::{Answered, DeformableModel, NodalForce};

/// A change of all forces by less than this share ends the search: a choice.
const SMALL_CHANGE: f64 = 1e-3;

/// Forces and relative displacements of contacts, one each. Solving allocates nothing.
#[derive(Clone, Debug)]
pub(super) struct CoupledForces {
    /// What each contact's opening is without forces [m]: negative where there is too little.
    pub(super) openings_m: Vec<DVec3>,
    forces_n: Vec<DVec3>,
    moves_m: Vec<DVec3>,
    tried_n: Vec<DVec3>,
    moves_before_m: Vec<DVec3>,
    best_n: Vec<DVec3>,
    best_moves_m: Vec<DVec3>,
    of_vertex_n: Vec<DVec3>,
    is_of_contact: Vec<bool>,
    of_nodes_m: Vec<DVec3>,
    list: Vec<NodalForce>,
}

impl CoupledForces {
    /// Room for a body of `n_nodes` nodes, of which `n_vertices` are on its surface.
    pub(super) fn new(n_vertices: usize, n_nodes: usize) -> Self {
        let none = || vec![DVec3::ZERO; n_vertices];
        Self {
            openings_m: none(),
            forces_n: none(),
            moves_m: none(),
            tried_n: none(),
            moves_before_m: none(),
            best_n: none(),
            best_moves_m: none(),
            of_vertex_n: none(),
            is_of_contact: vec![false; n_vertices],
            of_nodes_m: vec![DVec3::ZERO; n_nodes],
            list: Vec::with_capacity(n_vertices),
        }
    }

    /// The same, with its room.
    pub(super) fn duplicate(&self) -> Self {
        Self { list: Vec::with_capacity(self.list.capacity()), ..self.clone() }
    }

    /// Relative displacements that the forces brought about [m].
    pub(super) fn moves_m(&self) -> &[DVec3] {
        &self.moves_m
    }

    /// The force of each contact on its vertex [N].
    pub(super) fn forces_n(&self) -> &[DVec3] {
        &self.forces_n
    }

    /// The forces on the nodes, ascending.
    pub(super) fn nodal_forces(&mut self, contacts: &[NodeContact], nodes: &[NodeId]) -> &[NodalForce] {
        self.list_forces(contacts, nodes, false);
        &self.list
    }

    /// Those that are not zero, and to ask about them those of all contacts.
    fn list_forces(&mut self, contacts: &[NodeContact], nodes: &[NodeId], is_question: bool) {
        self.of_vertex_n.fill(DVec3::ZERO);
        self.is_of_contact.fill(false);
        for (contact, force_n) in contacts.iter().zip(&self.forces_n) {
            for (v, w) in contact.sides() {
                self.of_vertex_n[v] += *force_n * w;
                self.is_of_contact[v] = is_question;
            }
        }
        self.list.clear();
        let forces = self.of_vertex_n.iter().zip(&self.is_of_contact).zip(nodes);
        let listed = forces.filter(|((force_n, is_asked), _)| **is_asked || **force_n != DVec3::ZERO);
        self.list.extend(listed.map(|((&force_n, _), &node)| NodalForce { node, force_n }));
    }

    /// Writes the relative displacements for the present forces.
    fn answer(&mut self, model: &mut dyn DeformableModel, contacts: &[NodeContact], nodes: &[NodeId]) {
        self.list_forces(contacts, nodes, true);
        model.answer_into(&self.list, &mut self.of_nodes_m, Answered::AtForces);
        for (contact, move_m) in contacts.iter().zip(&mut self.moves_m) {
            *move_m = contact.sides().map(|(v, w)| self.of_nodes_m[nodes[v].index()] * w).sum();
        }
    }

    /// Solves for the forces of `contacts`, whose openings (n o + s, see the module) stand in `openings_m`, asking the model
    /// at most `n_answers` times. Answers whether any contact bears a force.
    pub(super) fn solve(
        &mut self,
        model: &mut dyn DeformableModel,
        contacts: &[NodeContact],
        nodes: &[NodeId],
        params: &CoupledParams,
    ) -> bool {
        let n = contacts.len();
        self.forces_n[..n].fill(DVec3::ZERO);
        self.moves_m[..n].fill(DVec3::ZERO);
        // Along the first direction the best length is known, because the answer is linear.
        let mut length_n2 = 0.0;
        for (c, contact) in contacts.iter().enumerate() {
            let force_n = params.within_cone(contact.normal, -self.openings_m[c]);
            self.forces_n[c] = force_n;
            length_n2 += force_n.length_squared();
        }
        if !(length_n2 > 0.0 && length_n2.is_finite()) {
            return false;
        }
        self.answer(model, contacts, nodes);
        let work = |a: &[DVec3], b: &[DVec3]| a.iter().zip(b).map(|(x, y)| x.dot(*y)).sum::<f64>();
        let first_n_per_m = length_n2 / work(&self.forces_n[..n], &self.moves_m[..n]);
        if !(first_n_per_m > 0.0 && first_n_per_m.is_finite()) {
            self.forces_n[..n].fill(DVec3::ZERO);
            self.moves_m[..n].fill(DVec3::ZERO);
            return false;
        }
        for (force_n, move_m) in self.forces_n[..n].iter_mut().zip(&mut self.moves_m) {
            *force_n *= first_n_per_m;
            *move_m *= first_n_per_m;
        }
        let mut rho_n_per_m = first_n_per_m;
        let mut least_j = f64::INFINITY;
        self.keep_if_better(n, &mut least_j);
        for _ in 1..params.n_answers {
            let (mut changed_n2, mut all_n2) = (0.0, 0.0);
            for (c, contact) in contacts.iter().enumerate() {
                let wrong_m = self.openings_m[c] + self.moves_m[c];
                let now_n = self.forces_n[c];
                let next_n = params.within_cone(contact.normal, now_n - wrong_m * rho_n_per_m);
                self.tried_n[c] = next_n - now_n;
                self.forces_n[c] = next_n;
                changed_n2 += self.tried_n[c].length_squared();
                all_n2 += next_n.length_squared();
            }
            if changed_n2 <= SMALL_CHANGE * SMALL_CHANGE * all_n2 {
                break;
            }
            self.moves_before_m[..n].copy_from_slice(&self.moves_m[..n]);
            self.answer(model, contacts, nodes);
            self.keep_if_better(n, &mut least_j);
            for (before_m, now_m) in self.moves_before_m[..n].iter_mut().zip(&self.moves_m) {
                *before_m = *now_m - *before_m;
            }
            let yielded = work(&self.moves_before_m[..n], &self.moves_before_m[..n]);
            let next_n_per_m = work(&self.tried_n[..n], &self.moves_before_m[..n]) / yielded;
            if next_n_per_m.is_finite() && next_n_per_m > 0.0 {
                rho_n_per_m = next_n_per_m;
            }
        }
        if least_j < 0.0 {
            self.forces_n[..n].copy_from_slice(&self.best_n[..n]);
            self.moves_m[..n].copy_from_slice(&self.best_moves_m[..n]);
            return true;
        }
        self.forces_n[..n].fill(DVec3::ZERO);
        self.moves_m[..n].fill(DVec3::ZERO);
        false
    }

    /// Keeps the forces and what they bring about where their energy is less than the least so far.
    fn keep_if_better(&mut self, n: usize, least_j: &mut f64) {
        let rows = self.forces_n[..n].iter().zip(&self.openings_m).zip(&self.moves_m);
        let energy_j: f64 =
            rows.map(|((force_n, opening_m), move_m)| force_n.dot(*opening_m + *move_m * 0.5)).sum();
        if energy_j < *least_j {
            *least_j = energy_j;
            self.best_n[..n].copy_from_slice(&self.forces_n[..n]);
            self.best_moves_m[..n].copy_from_slice(&self.moves_m[..n]);
        }
    }
}

/// How a contact of a coupled model is solved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct CoupledParams {
    /// Coulomb's coefficient.
    pub(super) friction: f64,
    /// Answers of the model at most.
    pub(super) n_answers: u32,
}

impl CoupledParams {
    fn within_cone(&self, normal: DVec3, force_n: DVec3) -> DVec3 {
        let push_n = force_n.dot(normal).max(0.0);
        let across_n = force_n - normal * force_n.dot(normal);
        normal * push_n + across_n.clamp_length_max(self.friction * push_n)
    }
}
