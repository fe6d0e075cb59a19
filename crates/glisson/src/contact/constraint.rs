//! Unilateral contact with Coulomb friction, solved on the compliance of what touches.
//!
//! A contact joins up to four vertices with weights w: its relative displacement in the step is u = sum w_i d_i - m, with m
//! the motion of a rigid partner. With the gap g at the start of the step, the normal n (away from the second partner)
//! and the force f on the first, the conditions are those of Signorini and Coulomb,
//!
//! 0 <= n.f, 0 <= n.u + g, (n.f)(n.u + g) = 0, |f_t| <= mu n.f, f_t against u_t where that is reached, u_t = 0 else,
//!
//! and d answers to the forces by the compliance C of the bodies ([`crate::model::StepAnswer`]). A partner that turns as a rigid body
//! has a vertex more: its displacement is a rotation vector t, which adds t x a with the arm a to the contact, and its force is the
//! torque a x f. All are solved contact by contact, each with its own 3 x 3 block of the Delassus operator, in a fixed order that
//! turns round in every sweep: the projected Gauss-Seidel form of the non-smooth contact dynamics (M. Jean 1999, The non-smooth
//! contact dynamics method, doi 10.1016/S0045-7825(98)00383-1). The forces of the step before are the first guess.

use crate::math::{DMat3, DVec3, cross_matrix};

/// What touches what, for keeping forces from step to step. Ascending keys are the order of solution.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum ContactKey {
    /// A vertex and a triangle, both counted over all surfaces.
    VertexTriangle(u32, u32),
    /// Two edges.
    Edges(u32, u32),
    /// A vertex and an obstacle.
    VertexObstacle(u32, u32),
    /// A triangle between its edges and an obstacle.
    TriangleObstacle(u32, u32),
    /// An edge between its ends and an obstacle.
    EdgeObstacle(u32, u32),
}

/// How a contact moves with a rigid body that turns.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Turn {
    /// The vertex whose displacement is a rotation vector [rad], and whose force is a torque [N m].
    pub vertex: u32,
    /// From what the body turns about to the contact [m]; of the second partner with the sign turned. None where it is zero.
    pub arm_m: DVec3,
}

impl Turn {
    /// The same of the second partner.
    #[must_use]
    pub fn of_second(self) -> Self {
        Self { arm_m: -self.arm_m, ..self }
    }
}

/// A contact of one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// What touches.
    pub key: ContactKey,
    /// The vertices; those without weight do not count.
    pub vertices: [u32; 4],
    /// Their weights: positive on the first partner, with sum 1, and negative on the second.
    pub weights: [f64; 4],
    /// The partners that turn.
    pub turns: [Turn; 2],
    /// Where it is on the first partner at the start of the step [m].
    pub point_m: DVec3,
    /// Unit normal from the second partner to the first.
    pub normal: DVec3,
    /// Distance at the start of the step beyond the one that is kept [m]; negative inside.
    pub gap_m: f64,
    /// What n.u must not fall short of, with the sign turned [m].
    pub slack_m: f64,
    /// Motion of a rigid second partner at the contact in the step [m].
    pub moved_m: DVec3,
    /// Coefficient of friction.
    pub friction: f64,
    /// Whether it may pull, and never slips.
    pub sticks: bool,
    /// Force on the first partner [N].
    pub force_n: DVec3,
    /// 1/compliance along the normal and across it [N/m]; zero where nothing yields.
    pub(super) stiffness_n_per_m: [f64; 2],
}

impl Contact {
    /// Without force and vertices; the slack of a gap that may close and need not open.
    pub fn new(key: ContactKey, normal: DVec3, gap_m: f64) -> Self {
        Self {
            key,
            vertices: [0; 4],
            weights: [0.0; 4],
            turns: [Turn::default(); 2],
            point_m: DVec3::ZERO,
            normal,
            gap_m,
            slack_m: gap_m.max(0.0),
            moved_m: DVec3::ZERO,
            friction: 0.0,
            sticks: false,
            force_n: DVec3::ZERO,
            stiffness_n_per_m: [0.0; 2],
        }
    }

    /// The same place with another slack, nothing of the step's forces and motion.
    pub fn without_force(&self, slack_m: f64) -> Self {
        Self { slack_m, friction: 0.0, force_n: DVec3::ZERO, moved_m: DVec3::ZERO, ..*self }
    }

    /// Vertices with a weight.
    pub fn sides(&self) -> impl Iterator<Item = (u32, f64)> + '_ {
        self.vertices.iter().copied().zip(self.weights).filter(|(_, w)| *w != 0.0)
    }

    /// Relative displacement in the step [m].
    #[inline]
    pub fn relative_m(&self, moves_m: &[DVec3]) -> DVec3 {
        let mut u = -self.moved_m;
        for i in 0..4 {
            if self.weights[i] != 0.0 {
                u += moves_m[self.vertices[i] as usize] * self.weights[i];
            }
        }
        for turn in &self.turns {
            if turn.arm_m != DVec3::ZERO {
                u += moves_m[turn.vertex as usize].cross(turn.arm_m);
            }
        }
        u
    }

    /// Torque of its force on a partner that turns by this vertex [N m].
    pub fn torque_n_m(&self, vertex: u32) -> DVec3 {
        let turns = self.turns.iter().filter(|turn| turn.vertex == vertex);
        turns.map(|turn| turn.arm_m.cross(self.force_n)).sum()
    }

    /// Adds the answer to a force on the first partner, and the opposite one on the second.
    #[inline]
    pub fn push(&self, by_n: DVec3, response: &Response, moves_m: &mut [DVec3]) {
        for i in 0..4 {
            if self.weights[i] != 0.0 {
                response.add(self.vertices[i], by_n * self.weights[i], moves_m);
            }
        }
        for turn in &self.turns {
            if turn.arm_m != DVec3::ZERO {
                response.add(turn.vertex, turn.arm_m.cross(by_n), moves_m);
            }
        }
    }

    /// Brings a force into the cone of friction.
    pub fn into_cone(&self, force_n: DVec3) -> DVec3 {
        let along_n = force_n.dot(self.normal).max(0.0);
        let across_n = force_n - self.normal * force_n.dot(self.normal);
        self.normal * along_n + limited(across_n, self.friction * along_n)
    }
}

fn limited(v: DVec3, most: f64) -> DVec3 {
    let length = v.length();
    if length > most { v * (most / length) } else { v }
}

/// Marks a vertex without a slot.
const NO_SLOT: u32 = u32::MAX;

/// How the vertices answer to forces in this step.
#[derive(Clone, Debug, Default)]
pub struct Response {
    /// Displacement for a unit force along each axis [m/N], of vertices that answer alone.
    alone_m_per_n: Vec<DVec3>,
    /// Group and place in it of vertices that answer together.
    slots: Vec<[u32; 2]>,
    groups: Vec<CoupledVertices>,
}

/// Vertices of one body that answer together.
#[derive(Clone, Debug, Default)]
pub struct CoupledVertices {
    /// The vertices, ascending.
    pub vertices: Vec<u32>,
    /// C [m/N] by row and column of `vertices`; columns lie one after the other.
    pub compliance_m_per_n: Vec<DMat3>,
}

impl Response {
    /// For so many vertices, none of which yields, and so many groups.
    pub fn new(n_vertices: usize, n_groups: usize) -> Self {
        Self {
            alone_m_per_n: vec![DVec3::ZERO; n_vertices],
            slots: vec![[NO_SLOT; 2]; n_vertices],
            groups: vec![CoupledVertices::default(); n_groups],
        }
    }

    /// Makes room for so many vertices in each group: later calls allocate nothing.
    #[must_use]
    pub fn with_room_for_groups_of(mut self, n_vertices: impl IntoIterator<Item = usize>) -> Self {
        for (group, n) in self.groups.iter_mut().zip(n_vertices) {
            group.vertices.reserve(n);
            group.compliance_m_per_n.reserve(n * n);
        }
        self
    }

    /// Sets how a vertex answers alone.
    pub fn set_alone(&mut self, vertex: u32, answer_m_per_n: DVec3) {
        self.alone_m_per_n[vertex as usize] = answer_m_per_n;
    }

    /// Gives a group other vertices; its compliance is for the caller to fill.
    pub fn set_group(&mut self, group: usize, vertices: impl Iterator<Item = u32>) {
        for &v in &self.groups[group].vertices {
            self.slots[v as usize] = [NO_SLOT; 2];
        }
        let members = &mut self.groups[group].vertices;
        members.clear();
        members.extend(vertices);
        for (slot, &v) in members.iter().enumerate() {
            self.slots[v as usize] = [group as u32, slot as u32];
        }
    }

    /// One of the groups.
    pub fn group(&self, group: usize) -> &CoupledVertices {
        &self.groups[group]
    }

    /// The compliance of a group, to be filled.
    pub fn group_mut(&mut self, group: usize) -> &mut CoupledVertices {
        &mut self.groups[group]
    }

    /// Adds a share of how vertex `of` answers to a force on `by`.
    #[inline(always)]
    fn add_answer(&self, [of, by]: [u32; 2], share: f64, sum: &mut DMat3) {
        let ([group, column], [other, row]) = (self.slots[by as usize], self.slots[of as usize]);
        if group == NO_SLOT {
            if of == by {
                *sum += DMat3::from_diagonal(self.alone_m_per_n[of as usize] * share);
            }
        } else if other == group {
            let CoupledVertices { vertices, compliance_m_per_n } = &self.groups[group as usize];
            let block = &compliance_m_per_n[column as usize * vertices.len() + row as usize];
            sum.x_axis += block.x_axis * share;
            sum.y_axis += block.y_axis * share;
            sum.z_axis += block.z_axis * share;
        }
    }

    /// How vertex `of` answers to a force on `by`.
    #[inline(always)]
    fn block(&self, of: u32, by: u32) -> DMat3 {
        let mut block = DMat3::ZERO;
        self.add_answer([of, by], 1.0, &mut block);
        block
    }

    /// Adds the answer to a force on a vertex.
    #[inline]
    pub fn add(&self, vertex: u32, force_n: DVec3, moves_m: &mut [DVec3]) {
        let [group, column] = self.slots[vertex as usize];
        if group == NO_SLOT {
            moves_m[vertex as usize] += self.alone_m_per_n[vertex as usize] * force_n;
            return;
        }
        let CoupledVertices { vertices, compliance_m_per_n } = &self.groups[group as usize];
        let first = column as usize * vertices.len();
        for (v, block) in vertices.iter().zip(&compliance_m_per_n[first..]) {
            moves_m[*v as usize] += *block * force_n;
        }
    }
}

/// When to stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sweeps {
    /// Sweeps over all contacts at most.
    pub most: u32,
    /// The change of a force in a sweep below which it ends, as a share of the largest force.
    pub tolerance: f64,
}

/// How it went.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SweepReport {
    /// Sweeps made.
    pub n_sweeps: u32,
    /// Largest change of a force in the last one, as a share of the largest force.
    pub residual: f64,
}

/// Finds the forces of `contacts`, starting from those that they have and that `moves_m` already answers to; adds what they
/// change to `moves_m` [m]. Never fails, never allocates.
pub fn solve(
    contacts: &mut [Contact],
    response: &Response,
    sweeps: Sweeps,
    moves_m: &mut [DVec3],
) -> SweepReport {
    for contact in contacts.iter_mut() {
        contact.stiffness_n_per_m = own_stiffness(contact, response);
    }
    sweep(contacts.len(), sweeps, |place| {
        let contact = &mut contacts[place];
        let before_n = contact.force_n;
        relax(contact, response, moves_m);
        [contact.force_n, contact.force_n - before_n]
    })
}

/// Relaxes so many contacts one after the other, in an order that turns round in every sweep, until that changes little; `relax`
/// answers a contact's force and its change [N].
#[inline(always)]
pub(super) fn sweep(n: usize, sweeps: Sweeps, mut relax: impl FnMut(usize) -> [DVec3; 2]) -> SweepReport {
    let mut report = SweepReport::default();
    while n > 0 && report.n_sweeps < sweeps.most {
        let (mut most_n, mut change_n) = (0.0_f64, 0.0_f64);
        let is_forward = report.n_sweeps.is_multiple_of(2);
        for place in 0..n {
            let [force_n, by_n] = relax(if is_forward { place } else { n - 1 - place });
            most_n = most_n.max(force_n.length_squared());
            change_n = change_n.max(by_n.length_squared());
        }
        report.n_sweeps += 1;
        report.residual = if most_n > 0.0 { (change_n / most_n).sqrt() } else { 0.0 };
        if report.residual <= sweeps.tolerance {
            break;
        }
    }
    report
}

/// Solves one contact: along the normal, then across it with what friction allows. `u` is its relative displacement [m], and `push`
/// answers what that is after a change of its force; answers the force, and what of its change is across the normal [N].
#[inline(always)]
pub(super) fn relaxed_n(contact: &Contact, u: DVec3, push: impl FnOnce(DVec3) -> DVec3) -> [DVec3; 2] {
    let [along, across] = contact.stiffness_n_per_m;
    let normal = contact.normal;
    let before_n = contact.force_n.dot(normal);
    let wanted_n = before_n - along * (u.dot(normal) + contact.slack_m);
    let normal_n = if contact.sticks { wanted_n } else { wanted_n.max(0.0) };
    let u = push(normal * (normal_n - before_n));
    if contact.friction == 0.0 && !contact.sticks {
        return [normal * normal_n, DVec3::ZERO];
    }
    let across_n = contact.force_n - normal * before_n;
    let wanted_n = across_n - (u - normal * u.dot(normal)) * across;
    let friction_n = if contact.sticks { wanted_n } else { limited(wanted_n, contact.friction * normal_n) };
    [normal * normal_n + friction_n, friction_n - across_n]
}

#[inline]
fn relax(contact: &mut Contact, response: &Response, moves_m: &mut [DVec3]) {
    let [force_n, across_n] = relaxed_n(contact, contact.relative_m(moves_m), |by_n| {
        change(contact, by_n, response, moves_m);
        contact.relative_m(moves_m)
    });
    change(contact, across_n, response, moves_m);
    contact.force_n = force_n;
}

#[inline]
fn change(contact: &Contact, by_n: DVec3, response: &Response, moves_m: &mut [DVec3]) {
    if by_n != DVec3::ZERO {
        contact.push(by_n, response, moves_m);
    }
}

/// Below this share of the trace of its block, a contact does not yield along a direction.
const RIGID_SHARE: f64 = 1e-12;

/// W of one contact's motion by another's force [m/N].
#[inline(always)]
pub(super) fn delassus_block(of: &Contact, by: &Contact, response: &Response) -> DMat3 {
    let mut sum = DMat3::ZERO;
    for (a, weight) in of.sides() {
        for (b, other) in by.sides() {
            response.add_answer([a, b], weight * other, &mut sum);
        }
    }
    // What a unit force does at a vertex that turns.
    let turns = |contact: &Contact| contact.turns.map(|turn| (turn.vertex, turn.arm_m)).into_iter();
    let turning = |contact: &Contact| turns(contact).filter(|(_, arm_m)| *arm_m != DVec3::ZERO);
    for (b, arm_m) in turning(by) {
        let torque = cross_matrix(arm_m);
        for (a, weight) in of.sides() {
            sum += response.block(a, b) * torque * weight;
        }
        for (a, of_arm_m) in turning(of) {
            sum += cross_matrix(of_arm_m).transpose() * response.block(a, b) * torque;
        }
    }
    for (a, of_arm_m) in turning(of) {
        for (b, other) in by.sides() {
            sum += cross_matrix(of_arm_m).transpose() * response.block(a, b) * other;
        }
    }
    sum
}

/// 1/n.W n and 1 over the larger eigenvalue of W across n, W the contact's own block of the Delassus operator.
fn own_stiffness(contact: &Contact, response: &Response) -> [f64; 2] {
    stiffness_of(&delassus_block(contact, contact, response), contact.normal)
}

/// The same of a block W and a normal.
pub(super) fn stiffness_of(block: &DMat3, n: DVec3) -> [f64; 2] {
    let block = *block;
    let trace = block.x_axis.x + block.y_axis.y + block.z_axis.z;
    let (s, t) = n.any_orthonormal_pair();
    let along = n.dot(block * n);
    let (a, b, c) = (s.dot(block * s), s.dot(block * t), t.dot(block * t));
    let across = 0.5 * (a + c) + (0.25 * (a - c) * (a - c) + b * b).sqrt();
    let least = RIGID_SHARE * trace;
    [along, across].map(|w| if w > least && w.is_finite() && w > 0.0 { 1.0 / w } else { 0.0 })
}
