//! Contact between the bodies of one model, with forces that last from step to step.
//!
//! The bodies share one mesh ([`crate::model::composite`]). Their joint surface is searched after each step ([`super::find`]);
//! pairs of one body count only where it may touch itself. Sought are forces f of the contacts, which act on the model from
//! the beginning of the next step on, so that what rests stays at rest. With the forces F of the last solution, which have acted
//! in the step, and the model's answer A, the places touched move against each other by r = J A (J^T f - F). With the gap g and
//! the way s that a contact has slid in the step, in every contact
//!
//! 0 <= f.n,   g - g0 + n.r >= 0,   f.n (g - g0 + n.r) = 0,   |f_t| <= mu f.n, f_t against s + r_t.
//!
//! g0 is zero, or for places that were already behind each other before the step most of that depth: it is pushed out slowly.
//! The system is solved as in [`super::coupled`], from the forces of the last step on: f = P(f - rho q) with q the left sides
//! above, P the projection on the friction cone, rho by Barzilai and Borwein (1988, doi 10.1093/imanum/8.1.141). The model is
//! asked a bounded number of times a step; what is left over is made good in the next ones.
//!
//! An attachment between two bodies ([`Bond`]) is a row of the same system: a spring k with a damper d between a node and a place
//! of the other body, at the end of the step. With its stretch e it asks for e + r + f/(k + d/h) = (d/h)/(k + d/h) e(t), so that
//! springs of any stiffness are stable.

use super::bodies::ResponseReport;
use super::bond::{Bond, BondRow};
use super::find::{ContactSearch, ContactSearchParams};
use super::rest_gaps::RestGaps;
use super::{NodeContact, within_cone};
use crate::contact::broad_phase::BroadPhaseKind;
use crate::math::DVec3;
use crate::mesh::topology::{Through, Topology, surface_of};
use crate::mesh::{NodeId, TetMesh};
use crate::model::{Answered, Correction, DeformableModel, NodalForce};

/// How bodies touch each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyContactParams {
    /// Distance up to which a vertex counts, outside and inside [m]: more than it moves in a step.
    pub margin_m: f64,
    /// Coulomb's coefficient.
    pub friction: f64,
    /// Whether a body touches itself, too.
    pub touches_itself: bool,
    /// What is not further apart, or in each other, in the rest shape [m], counts as just touching: meshes made from an image fit
    /// no better ([`super::rest_gaps`]). Zero where shapes are exact.
    pub touch_m: f64,
}

/// Of an overlap from before the step so much is pushed out in it, at this speed at most [m/s]: choices.
const PUSHED_OUT: f64 = 0.2;
const PUSH_OUT_M_PER_S: f64 = 0.05;
/// Answers of the model in a step at most: a choice.
const MOST_ANSWERS: u32 = 8;
/// The search ends when no row misses its law by more than the way of this speed in the step: what rests creeps no faster, a choice
/// of a tenth of a millimetre in three minutes.
const TOLERANCE_M_PER_S: f64 = 5e-7;
/// A length of a step of the search may change by this factor at once: a choice.
const MOST_CHANGE: f64 = 10.0;

/// What lasts from step to step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ContactMemory {
    /// Force of each node's contact with another body's triangle [N], those that are not zero.
    of_contacts: Vec<NodalForce>,
    /// Force of each bond [N].
    of_bonds: Vec<DVec3>,
    /// Bonds that were parted, ascending.
    parted: Vec<u32>,
    /// The forces on nodes, ascending.
    on_nodes: Vec<NodalForce>,
    rho_n_per_m: f64,
}

impl ContactMemory {
    /// Starts with the force of a node's contact, and its sides: nodes with the forces on them.
    pub fn start_with(&mut self, of_contact: NodalForce, sides: impl Iterator<Item = (NodeId, DVec3)>) {
        let at = self.of_contacts.partition_point(|force| force.node < of_contact.node);
        self.of_contacts.insert(at, of_contact);
        for (node, force_n) in sides {
            match self.on_nodes.binary_search_by_key(&node, |force| force.node) {
                Ok(at) => self.on_nodes[at].force_n += force_n,
                Err(at) => self.on_nodes.insert(at, NodalForce { node, force_n }),
            }
        }
    }

    /// Forgets the forces on nodes that are no longer there.
    pub fn keep(&mut self, is_live: impl Fn(NodeId) -> bool) {
        self.of_contacts.retain(|force| is_live(force.node));
        self.on_nodes.retain(|force| is_live(force.node));
    }
}

/// The search, the forces and what a step needs. Steps allocate nothing; made anew after each edit of the mesh.
#[derive(Debug)]
pub struct BodyContact {
    params: BodyContactParams,
    /// The node of each vertex, ascending.
    nodes: Vec<NodeId>,
    /// Whether each vertex is of a rigid body.
    is_rigid: Vec<bool>,
    n_nodes: usize,
    search: ContactSearch,
    contacts: Vec<NodeContact>,
    bonds: Vec<Bond>,
    bond_rows: Vec<BondRow>,
    rest: RestGaps,
    positions_m: Vec<DVec3>,
    velocities_m_per_s: Vec<DVec3>,
    // What lasts.
    of_vertex_n: Vec<DVec3>,
    of_bond_n: Vec<DVec3>,
    is_parted: Vec<bool>,
    acted: Vec<NodalForce>,
    rho_n_per_m: f64,
    /// Whether a row of this step has the vertex.
    is_of_row: Vec<bool>,
    // Rows: contacts, then bonds.
    openings_m: Vec<DVec3>,
    forces_n: Vec<DVec3>,
    moves_m: Vec<DVec3>,
    before_n: Vec<DVec3>,
    before_m: Vec<DVec3>,
    best_n: Vec<DVec3>,
    /// How stiff each row is against the others.
    stiffness: Vec<f64>,
    // Scratch.
    sum_n: Vec<DVec3>,
    acted_n: Vec<DVec3>,
    of_nodes_m: Vec<DVec3>,
    list: Vec<NodalForce>,
    report: ResponseReport,
}

impl Clone for BodyContact {
    /// A copy with all its room.
    fn clone(&self) -> Self {
        let n = self.nodes.len();
        let mut acted = Vec::with_capacity(n);
        acted.extend_from_slice(&self.acted);
        Self {
            params: self.params,
            nodes: self.nodes.clone(),
            is_rigid: self.is_rigid.clone(),
            n_nodes: self.n_nodes,
            search: self.search.clone(),
            contacts: Vec::with_capacity(n),
            bonds: self.bonds.clone(),
            bond_rows: self.bond_rows.clone(),
            rest: self.rest.clone(),
            positions_m: self.positions_m.clone(),
            velocities_m_per_s: self.velocities_m_per_s.clone(),
            of_vertex_n: self.of_vertex_n.clone(),
            of_bond_n: self.of_bond_n.clone(),
            is_parted: self.is_parted.clone(),
            acted,
            rho_n_per_m: self.rho_n_per_m,
            is_of_row: self.is_of_row.clone(),
            openings_m: self.openings_m.clone(),
            forces_n: self.forces_n.clone(),
            moves_m: self.moves_m.clone(),
            before_n: self.before_n.clone(),
            before_m: self.before_m.clone(),
            best_n: self.best_n.clone(),
            stiffness: self.stiffness.clone(),
            sum_n: self.sum_n.clone(),
            acted_n: self.acted_n.clone(),
            of_nodes_m: self.of_nodes_m.clone(),
            list: Vec::with_capacity(n),
            report: self.report,
        }
    }
}

/// A surface of several bodies.
pub struct BodiesOfSurface<'a> {
    /// Adjacency of the joint mesh.
    pub topology: &'a Topology,
    /// The joint mesh at rest.
    pub mesh: &'a TetMesh,
    /// The body of each node.
    pub body_of: &'a [u32],
    /// Whether each body is rigid: two such bodies have no contact with each other.
    pub is_rigid: &'a [bool],
}

impl BodyContact {
    /// For bodies whose nodes are at `positions_m`; bonds of which a node is not on the surface do not count.
    pub fn new(
        params: &BodyContactParams,
        bodies: &BodiesOfSurface<'_>,
        bonds: &[Bond],
        positions_m: &[DVec3],
    ) -> Self {
        let (surface, nodes) = surface_of(bodies.topology, bodies.mesh);
        let pieces = bodies.topology.pieces(Through::Nodes);
        let piece =
            |n: &NodeId| bodies.topology.node_tets(*n).first().map_or(0, |t| pieces.of_tet[t.index()]);
        let piece_of: Vec<u32> = nodes.iter().map(piece).collect();
        let body = |t: &[u32; 3]| bodies.body_of[nodes[t[0] as usize].index()];
        let is_rigid_body = |n: &NodeId| {
            let body = bodies.body_of[n.index()] as usize;
            bodies.is_rigid.get(body).copied().unwrap_or(false)
        };
        let is_rigid: Vec<bool> = nodes.iter().map(is_rigid_body).collect();
        let body_of: Vec<u32> = surface.triangles.iter().map(body).collect();
        let now_m: Vec<DVec3> = nodes.iter().map(|n| positions_m[n.index()]).collect();
        let rest_m = surface.positions_m;
        let mut search = ContactSearch::new(&search_of(params), &rest_m, &surface.triangles, &body_of)
            .with_rest_shape(rest_m.clone(), piece_of);
        let mut contacts = Vec::with_capacity(nodes.len());
        if params.touch_m > 0.0 {
            search.find_into(&rest_m, &mut contacts);
        }
        let body_of_vertex = nodes.iter().map(|n| bodies.body_of[n.index()]).collect();
        let rest = RestGaps::new(params.touch_m, rest_m, body_of_vertex, &contacts);
        contacts.clear();
        let bond_rows: Vec<BondRow> = bonds.iter().map(|bond| BondRow::new(bond, &nodes)).collect();
        let (n, n_nodes) = (nodes.len(), bodies.mesh.positions_m.len());
        let none = |n: usize| vec![DVec3::ZERO; n];
        let n_rows = n + bonds.len();
        Self {
            params: *params,
            search,
            contacts,
            bonds: bonds.to_vec(),
            bond_rows,
            rest,
            positions_m: now_m,
            velocities_m_per_s: none(n),
            of_vertex_n: none(n),
            of_bond_n: none(bonds.len()),
            is_parted: vec![false; bonds.len()],
            acted: Vec::with_capacity(n),
            rho_n_per_m: 0.0,
            is_of_row: vec![false; n],
            openings_m: none(n_rows),
            forces_n: none(n_rows),
            moves_m: none(n_rows),
            before_n: none(n_rows),
            before_m: none(n_rows),
            best_n: none(n_rows),
            stiffness: vec![1.0; n_rows],
            sum_n: none(n),
            acted_n: none(n),
            of_nodes_m: none(n_nodes),
            list: Vec::with_capacity(n),
            report: ResponseReport::default(),
            n_nodes,
            is_rigid,
            nodes,
        }
    }

    /// Goes on with forces from before.
    #[must_use]
    pub fn with_memory(mut self, memory: &ContactMemory) -> Self {
        self.go_on_with(memory);
        self
    }

    /// Goes on with forces from before, where it had none.
    pub fn go_on_with(&mut self, memory: &ContactMemory) {
        let vertex = |nodes: &[NodeId], node: NodeId| nodes.binary_search(&node).ok();
        for force in &memory.of_contacts {
            if let Some(v) = vertex(&self.nodes, force.node) {
                self.of_vertex_n[v] = force.force_n;
            }
        }
        for (force_n, before_n) in self.of_bond_n.iter_mut().zip(&memory.of_bonds) {
            *force_n = *before_n;
        }
        for &bond in &memory.parted {
            self.part_bond(bond as usize);
        }
        let Self { acted, nodes, .. } = self;
        acted.extend(memory.on_nodes.iter().filter(|force| vertex(nodes, force.node).is_some()));
        self.rho_n_per_m = memory.rho_n_per_m;
    }

    /// What lasts, for one that goes on.
    pub fn memory(&self) -> ContactMemory {
        let of_vertex = self.nodes.iter().zip(&self.of_vertex_n);
        ContactMemory {
            of_contacts: of_vertex
                .filter(|(_, force_n)| **force_n != DVec3::ZERO)
                .map(|(&node, &force_n)| NodalForce { node, force_n })
                .collect(),
            of_bonds: self.of_bond_n.clone(),
            parted: self.parted().collect(),
            on_nodes: self.acted.clone(),
            rho_n_per_m: self.rho_n_per_m,
        }
    }

    /// The bonds that were parted, ascending.
    fn parted(&self) -> impl Iterator<Item = u32> + '_ {
        (0..).zip(&self.is_parted).filter(|(_, is_parted)| **is_parted).map(|(bond, _)| bond)
    }

    fn part_bond(&mut self, bond: usize) {
        self.is_parted[bond] = true;
        self.of_bond_n[bond] = DVec3::ZERO;
        self.bond_rows[bond].part();
    }

    /// The bonds that hold, by their numbers, with their ends [m]; for the places of all nodes [m].
    pub fn bonds_m<'a>(&'a self, positions_m: &'a [DVec3]) -> impl Iterator<Item = (usize, [DVec3; 2])> + 'a {
        let ends = self.bond_rows.iter().map(|row| row.ends_m(&self.nodes, positions_m));
        ends.enumerate().filter_map(|(bond, ends_m)| Some((bond, ends_m?)))
    }

    /// Parts the bonds that can be cut and that `meets` takes by their ends [m]; answers how many.
    pub fn part_bonds(&mut self, positions_m: &[DVec3], meets: impl Fn([DVec3; 2]) -> bool) -> usize {
        let mut n_parted = 0;
        for bond in 0..self.bonds.len() {
            let ends_m = self.bond_rows[bond].ends_m(&self.nodes, positions_m);
            if self.bonds[bond].can_be_cut && ends_m.is_some_and(&meets) {
                self.part_bond(bond);
                n_parted += 1;
            }
        }
        n_parted
    }

    /// Forgets all forces; what was parted stays so.
    pub fn forget(&mut self) {
        self.contacts.clear();
        self.of_vertex_n.fill(DVec3::ZERO);
        self.of_bond_n.fill(DVec3::ZERO);
        self.acted.clear();
        self.rho_n_per_m = 0.0;
        self.report = ResponseReport::default();
    }

    /// Everything that the next step depends on.
    pub fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        let of_vertex = self.nodes.iter().zip(&self.of_vertex_n);
        let of_contacts = of_vertex.filter(|(_, force_n)| **force_n != DVec3::ZERO);
        let of_contacts = of_contacts.map(|(node, force_n)| (*node, *force_n));
        let on_nodes = self.acted.iter().map(|force| (force.node, force.force_n));
        let of_nodes = of_contacts.chain(on_nodes).flat_map(|(node, f)| [f64::from(node.0), f.x, f.y, f.z]);
        let of_bonds = self.of_bond_n.iter().flat_map(|f| f.to_array());
        of_nodes.chain(of_bonds).chain(self.parted().map(f64::from)).chain([self.rho_n_per_m])
    }

    /// How it is done.
    pub fn params(&self) -> &BodyContactParams {
        &self.params
    }

    /// How the last step went; its penetration is that before the response.
    pub fn report(&self) -> ResponseReport {
        self.report
    }

    /// The contacts of the last step, over vertices ([`BodyContact::nodes`]).
    pub fn contacts(&self) -> &[NodeContact] {
        &self.contacts
    }

    /// The node of each vertex.
    pub fn nodes(&self) -> &[NodeId] {
        &self.nodes
    }

    /// Forces of the contacts of the last step, which act in the next one; ascending by node.
    pub fn forces(&self) -> &[NodalForce] {
        &self.acted
    }

    /// The force that the other body exerts on each vertex with a contact [N], in the order of [`BodyContact::contacts`].
    pub fn contact_forces_n(&self) -> &[DVec3] {
        &self.forces_n[..self.contacts.len()]
    }

    /// Answers to what a step of `dt_s` brought about, in which [`BodyContact::forces`] acted. Allocates nothing.
    pub fn respond_to_step(&mut self, model: &mut dyn DeformableModel, dt_s: f64) {
        if model.state().positions_m.len() != self.n_nodes {
            self.report = ResponseReport::default();
            return;
        }
        self.find(model);
        if self.contacts.is_empty() && self.bonds.is_empty() && self.acted.is_empty() {
            return;
        }
        self.open(dt_s);
        self.solve(model, dt_s);
        self.collect(true, false);
        if !self.list.is_empty() {
            model.correct_step(&self.list, dt_s, Correction::Motion);
        }
        self.remember();
    }

    fn find(&mut self, model: &dyn DeformableModel) {
        let state = model.state();
        let is_moving = state.velocities_m_per_s.len() == state.positions_m.len();
        for (v, node) in self.nodes.iter().enumerate() {
            self.positions_m[v] = state.positions_m[node.index()];
            self.velocities_m_per_s[v] =
                if is_moving { state.velocities_m_per_s[node.index()] } else { DVec3::ZERO };
        }
        let n_dropped = self.search.find_into(&self.positions_m, &mut self.contacts) as u32;
        let is_rigid = &self.is_rigid;
        self.contacts.retain(|contact| contact.sides().any(|(v, _)| !is_rigid[v]));
        for contact in &mut self.contacts {
            contact.gap_m -= self.rest.gap_m(contact);
        }
        let penetration_m = self.contacts.iter().fold(0.0, |deepest: f64, c| deepest.max(-c.gap_m));
        self.report = ResponseReport { n_contacts: self.contacts.len() as u32, penetration_m, n_dropped };
    }

    /// What each row has left without further forces, and the forces of the last step as a start.
    fn open(&mut self, dt_s: f64) {
        self.acted_n.fill(DVec3::ZERO);
        for force in &self.acted {
            if let Ok(v) = self.nodes.binary_search(&force.node) {
                self.acted_n[v] = force.force_n;
            }
        }
        let most_m = PUSH_OUT_M_PER_S * dt_s;
        for (row, contact) in self.contacts.iter().enumerate() {
            let n = contact.normal;
            let way_m = contact.relative_m_per_s(&self.velocities_m_per_s) * dt_s;
            let along_m = way_m.dot(n);
            let before_m = (contact.gap_m - along_m).min(0.0);
            let floor_m = before_m + (PUSHED_OUT * -before_m).min(most_m);
            self.openings_m[row] = n * (contact.gap_m - floor_m) + (way_m - n * along_m);
            let force_n = self.of_vertex_n[contact.vertices[0] as usize];
            self.forces_n[row] = within_cone(n, force_n, self.params.friction);
        }
        let first = self.contacts.len();
        for (b, (bond, row)) in self.bonds.iter().zip(&mut self.bond_rows).enumerate() {
            row.open(bond, &self.positions_m, &self.velocities_m_per_s, dt_s);
            self.openings_m[first + b] = row.opening_m;
            self.forces_n[first + b] = row.project(self.of_bond_n[b]);
        }
        self.is_of_row.fill(false);
        let rows = self.contacts.iter().chain(self.bond_rows.iter().map(|row| &row.sides));
        rows.flat_map(NodeContact::sides).for_each(|(v, _)| self.is_of_row[v] = true);
    }

    /// The sides of a row.
    fn sides(&self, row: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let n = self.contacts.len();
        let contact = if row < n { &self.contacts[row] } else { &self.bond_rows[row - n].sides };
        contact.sides()
    }

    fn n_rows(&self) -> usize {
        self.contacts.len() + self.bond_rows.len()
    }

    fn project(&self, row: usize, force_n: DVec3) -> DVec3 {
        let n = self.contacts.len();
        if row < n {
            within_cone(self.contacts[row].normal, force_n, self.params.friction)
        } else {
            self.bond_rows[row - n].project(force_n)
        }
    }

    /// What the row misses of its law [m].
    fn missed_m(&self, row: usize) -> DVec3 {
        let n = self.contacts.len();
        let of_spring_m =
            if row < n { DVec3::ZERO } else { self.forces_n[row] * self.bond_rows[row - n].yields_m_per_n };
        self.openings_m[row] + self.moves_m[row] + of_spring_m
    }

    /// The change of the forces on nodes against those that acted, or the forces themselves, in the list: those that are not zero, and to
    /// ask about them those of all rows.
    fn collect(&mut self, is_change: bool, is_question: bool) {
        self.sum_n.fill(DVec3::ZERO);
        for row in 0..self.n_rows() {
            let force_n = self.forces_n[row];
            if force_n == DVec3::ZERO {
                continue;
            }
            let n = self.contacts.len();
            let contact = if row < n { &self.contacts[row] } else { &self.bond_rows[row - n].sides };
            for (v, w) in contact.sides() {
                self.sum_n[v] += force_n * w;
            }
        }
        self.list.clear();
        for (v, &node) in self.nodes.iter().enumerate() {
            let acted_n = if is_change { self.acted_n[v] } else { DVec3::ZERO };
            let force_n = self.sum_n[v] - acted_n;
            if force_n != DVec3::ZERO || is_question && self.is_of_row[v] {
                self.list.push(NodalForce { node, force_n });
            }
        }
    }

    /// Relative displacements for the present forces.
    fn answer(&mut self, model: &mut dyn DeformableModel) {
        self.collect(true, true);
        if self.list.iter().all(|force| force.force_n == DVec3::ZERO) {
            self.moves_m.fill(DVec3::ZERO);
            return;
        }
        model.answer_into(&self.list, &mut self.of_nodes_m, Answered::AtForces);
        for row in 0..self.n_rows() {
            let moved_m = |(v, w): (usize, f64)| self.of_nodes_m[self.nodes[v].index()] * w;
            self.moves_m[row] = self.sides(row).map(moved_m).sum();
        }
    }

    fn solve(&mut self, model: &mut dyn DeformableModel, dt_s: f64) {
        let n_rows = self.n_rows();
        if !(self.rho_n_per_m.is_finite() && self.rho_n_per_m > 0.0) {
            self.rho_n_per_m = self.first_length_n_per_m(model, dt_s);
        }
        // The steps of the search do not come nearer each time: the best of all forces counts, measured alike.
        let measure_n_per_m = self.rho_n_per_m;
        self.weigh(model, dt_s);
        let mut least_m2 = f64::INFINITY;
        for turn in 0..MOST_ANSWERS {
            self.answer(model);
            if turn > 0 {
                self.change_length(n_rows);
            }
            let rho_n_per_m = self.rho_n_per_m;
            let (mut worst_m, mut all_m2) = (0.0_f64, 0.0);
            for row in 0..n_rows {
                let (now_n, missed_m) = (self.forces_n[row], self.missed_m(row));
                self.before_n[row] = now_n;
                self.before_m[row] = missed_m;
                let length_n_per_m = measure_n_per_m * self.stiffness[row];
                let is_missed_n = self.project(row, now_n - missed_m * length_n_per_m) - now_n;
                let is_missed_m = is_missed_n.length() / length_n_per_m;
                worst_m = worst_m.max(is_missed_m);
                all_m2 += is_missed_m * is_missed_m;
            }
            if all_m2 < least_m2 {
                least_m2 = all_m2;
                self.best_n[..n_rows].copy_from_slice(&self.forces_n[..n_rows]);
            }
            if worst_m <= TOLERANCE_M_PER_S * dt_s {
                break;
            }
            for row in 0..n_rows {
                let next_n = self.project(
                    row,
                    self.before_n[row] - self.before_m[row] * (rho_n_per_m * self.stiffness[row]),
                );
                // What is no number, from a body that broke, stays out.
                if next_n.is_finite() {
                    self.forces_n[row] = next_n;
                }
            }
        }
        if least_m2.is_finite() {
            self.forces_n[..n_rows].copy_from_slice(&self.best_n[..n_rows]);
        }
    }

    /// Rows between light nodes yield more than those between heavy ones: where the model tells how its nodes answer, the lengths of
    /// the search follow that.
    fn weigh(&mut self, model: &dyn DeformableModel, dt_s: f64) {
        let n_rows = self.n_rows();
        let (mut softest, mut is_known) = (0.0_f64, true);
        for row in 0..n_rows {
            let answer =
                |(v, w): (usize, f64)| w * w * model.node_answer_m_per_n(self.nodes[v], dt_s).element_sum();
            let yields: f64 = self.sides(row).map(answer).sum();
            self.stiffness[row] = yields;
            softest = softest.max(yields);
            is_known &= yields > 0.0;
        }
        for stiffness in &mut self.stiffness[..n_rows] {
            *stiffness = if is_known { softest / *stiffness } else { 1.0 };
        }
    }

    /// Barzilai and Borwein's length of the next step, from what the last one changed.
    fn change_length(&mut self, n_rows: usize) {
        let (mut of_both, mut of_missed) = (0.0, 0.0);
        for row in 0..n_rows {
            let changed_n = self.forces_n[row] - self.before_n[row];
            let yielded_m = self.missed_m(row) - self.before_m[row];
            of_both += changed_n.dot(yielded_m);
            of_missed += yielded_m.length_squared() * self.stiffness[row];
        }
        let length_n_per_m = of_both / of_missed;
        if length_n_per_m.is_finite() && length_n_per_m > 0.0 {
            let (least, most) = (self.rho_n_per_m / MOST_CHANGE, self.rho_n_per_m * MOST_CHANGE);
            self.rho_n_per_m = length_n_per_m.clamp(least, most);
        }
    }

    /// The length along the first direction, from one answer of the model to it.
    fn first_length_n_per_m(&mut self, model: &mut dyn DeformableModel, dt_s: f64) -> f64 {
        let n_rows = self.n_rows();
        let mut length_n2 = 0.0;
        for row in 0..n_rows {
            self.before_n[row] = self.forces_n[row];
            self.forces_n[row] = self.project(row, -self.openings_m[row]);
            length_n2 += self.forces_n[row].length_squared();
        }
        self.collect(false, true);
        model.answer_into(&self.list, &mut self.of_nodes_m, Answered::AtForces);
        let mut work = 0.0;
        for row in 0..n_rows {
            let moved_m = |(v, w): (usize, f64)| self.of_nodes_m[self.nodes[v].index()] * w;
            let moved_m: DVec3 = self.sides(row).map(moved_m).sum();
            work += self.forces_n[row].dot(moved_m);
            self.forces_n[row] = self.before_n[row];
        }
        let length_n_per_m = length_n2 / work;
        // Nothing is pressed yet: the stiffness of a gram in a step (a choice that the next steps correct).
        let fallback_n_per_m = 1e-3 / (dt_s * dt_s);
        if length_n_per_m.is_finite() && length_n_per_m > 0.0 { length_n_per_m } else { fallback_n_per_m }
    }

    /// Keeps the forces for the next step.
    fn remember(&mut self) {
        self.of_vertex_n.fill(DVec3::ZERO);
        for (contact, force_n) in self.contacts.iter().zip(&self.forces_n) {
            self.of_vertex_n[contact.vertices[0] as usize] = *force_n;
        }
        let first = self.contacts.len();
        self.of_bond_n.copy_from_slice(&self.forces_n[first..first + self.bonds.len()]);
        for bond in 0..self.bonds.len() {
            let pull_n = self.bond_rows[bond].pull_n(self.of_bond_n[bond], &self.positions_m);
            if pull_n > self.bonds[bond].strength_n {
                self.part_bond(bond);
                self.forces_n[first + bond] = DVec3::ZERO;
            }
        }
        self.collect(false, false);
        std::mem::swap(&mut self.acted, &mut self.list);
    }
}

/// Where bodies touch each other in the rest shape.
#[derive(Default)]
pub struct PlacesInTouch {
    /// The contacts, over `nodes`.
    pub contacts: Vec<NodeContact>,
    /// The node of each vertex of the surface.
    pub nodes: Vec<NodeId>,
    /// A third of the triangles around each vertex [m2].
    pub areas_m2: Vec<f64>,
}

/// The places that touch in the rest shape: one for each vertex that is near another body.
pub fn places_in_touch(params: &BodyContactParams, bodies: &BodiesOfSurface<'_>) -> PlacesInTouch {
    let mut contact = BodyContact::new(params, bodies, &[], &bodies.mesh.positions_m);
    contact.search.find_into(&contact.positions_m, &mut contact.contacts);
    let is_rigid = &contact.is_rigid;
    let is_soft = |contact: &NodeContact| contact.sides().any(|(v, _)| !is_rigid[v]);
    contact.contacts.retain(|contact| contact.gap_m <= params.touch_m && is_soft(contact));
    let mut areas_m2 = vec![0.0; contact.nodes.len()];
    for corners in contact.search.triangles() {
        let [a, b, c] = corners.map(|v| contact.positions_m[v as usize]);
        let third_m2 = (b - a).cross(c - a).length() / 6.0;
        corners.iter().for_each(|&v| areas_m2[v as usize] += third_m2);
    }
    PlacesInTouch { contacts: contact.contacts, nodes: contact.nodes, areas_m2 }
}

/// How contacts between bodies are looked for.
fn search_of(params: &BodyContactParams) -> ContactSearchParams {
    ContactSearchParams {
        kind: BroadPhaseKind::Hierarchy,
        margin_m: params.margin_m,
        self_collision: params.touches_itself,
        pair_capacity: 0,
    }
}
