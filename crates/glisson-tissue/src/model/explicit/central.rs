//! Central differences of the displacements.
//!
//! M u'' + C u' + f(u) = F with lumped mass m_i = sum rho V/4 over the node's tetrahedra and damping C = d M
//! (seed `003`, eq. 3.1 to 3.3; seed `002`, eq. 11 and 12). The reports write the damping with the sign of a
//! driving force; with c_i = d m_i > 0 dissipative, and F_i the net force (outer force minus f_i), a step h is
//!
//! (m_i/h^2 + c_i/(2h)) u_i(t+h) = F_i + (2 m_i/h^2) u_i(t) - (m_i/h^2 - c_i/(2h)) u_i(t-h),
//!
//! evaluated as u(t+h) - u(t) = [ (1/h^2 - d/(2h)) (u(t) - u(t-h)) + F/m ] / (1/h^2 + d/(2h)), which loses
//! fewer digits. It is stable for h <= 2/omega_max whatever d is ([`super::StableStep`]).
//!
//! The part b K of Rayleigh's damping comes from the elastic forces at u + b (u(t) - u(t-h))/h: the velocity is half a
//! step old. A mode then has (1 + d h/2) z^2 - (2 - A - B) z + 1 - d h/2 - B = 0 with A = (omega h)^2 and
//! B = b h omega^2; its roots stay in the unit circle for A + 2 B <= 4 (Jury's conditions; d drops out), so for
//! h <= sqrt(b^2 + (2/omega)^2) - b.

use super::cuttable::LiveTets;
use super::dynamics::Mover;
use super::frame::{Frame, Quarantine};
use super::mass_shares::StiffTet;
use super::stable::{MARGIN, Stability, StableStep};
use super::{ExplicitError, Padded, keep, padded, unpadded};
use crate::model::topology_update::TopologyUpdate;
use crate::model::{
    Constraints, Correction, DynamicBody, ModelReport, ModelState, ModelUndo, NodalForce, UndoReader,
};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::{NodeId, TetMesh};

/// A copy of the moving state. It holds for the same mesh and removals.
#[derive(Clone, Debug, PartialEq)]
pub struct ExplicitSnapshot {
    motion: Vec<Padded>,
    positions_m: Vec<DVec3>,
    velocities_m_per_s: Vec<DVec3>,
}

/// A body moved by central differences.
#[derive(Clone, Debug)]
pub(in crate::model) struct ExplicitMotion {
    frame: Frame,
    stable: StableStep,
    /// Constant forces [N] that balance the stress at rest; empty without any.
    rest_forces_n: Vec<Padded>,
    inertia_kg: Vec<f64>,
    /// Zero for nodes that do not move: fixed ones and those without a tetrahedron.
    inverse_inertia_per_kg: Vec<f64>,

    // State: displacements u(t), displacements u(t-h), and one entry of the last h and the kinetic energy.
    motion: Vec<Padded>,
    positions_m: Vec<DVec3>,
    velocities_m_per_s: Vec<DVec3>,

    // Scratch; the second one for damping of the stiffness only.
    force_n: Vec<Padded>,
    ahead_m: Vec<Padded>,
}

impl ExplicitMotion {
    /// A body at rest. `full_strain_energy_j`: elastic energy with every tetrahedron strained by 1.
    ///
    /// # Errors
    /// [`ExplicitError`] for supports and loads that no body can have, and a step above the stable one.
    pub(in crate::model) fn new(
        body: &DynamicBody<'_>,
        stability: Stability,
        full_strain_energy_j: f64,
    ) -> Result<Self, ExplicitError> {
        let mut frame = Frame::new(body, full_strain_energy_j)?;
        let stable = stability.step;
        frame.keep_frequencies(stability);
        let n_nodes = frame.n_nodes();
        let n_ahead = if body.damping.stiffness_s > 0.0 { n_nodes } else { 0 };
        let mut motion = Self {
            stable,
            rest_forces_n: Vec::new(),
            inertia_kg: vec![0.0; n_nodes],
            inverse_inertia_per_kg: vec![0.0; n_nodes],
            motion: vec![[0.0; 4]; 2 * n_nodes + 1],
            positions_m: frame.rest_m.clone(),
            velocities_m_per_s: vec![DVec3::ZERO; n_nodes],
            force_n: vec![[0.0; 4]; n_nodes],
            ahead_m: vec![[0.0; 4]; n_ahead],
            frame,
        };
        (0..n_nodes).for_each(|n| motion.update_inertia(n));
        motion.frame.stable_step_s = motion.step_for(stable.step_s);
        if body.time_step_s > motion.frame.stable_step_s {
            let (found_s, allowed_s) = (body.time_step_s, motion.frame.stable_step_s);
            return Err(ExplicitError::UnstableStep { found_s, allowed_s, tet: stable.tet });
        }
        motion.set_last_step_s(body.time_step_s);
        Ok(motion)
    }

    /// Goes on in steps of so many seconds [s], as after an edit: where they would need more than the most parts, nodes are made
    /// heavier.
    pub(in crate::model) fn go_on_in_steps_of(&mut self, time_step_s: f64, tets: &LiveTets) {
        self.frame.time_step_s = time_step_s;
        self.set_last_step_s(time_step_s);
        self.after_removals(tets);
    }

    /// Stable step [s] with ligaments and damping of the stiffness, for tissue that alone has `elastic_s`.
    fn step_for(&self, elastic_s: f64) -> f64 {
        let ligaments_per_s2 = self.frame.attachment_squared_frequency_per_s2(|n| self.inertia_kg[n]);
        let b = self.frame.damping.stiffness_s;
        if ligaments_per_s2 == 0.0 && b == 0.0 {
            return elastic_s;
        }
        let inverse_per_s2 = 1.0 / (elastic_s * elastic_s) + ligaments_per_s2 / (4.0 * MARGIN * MARGIN);
        let square_s2 = 1.0 / inverse_per_s2;
        square_s2 / (b + (b * b + square_s2).sqrt())
    }

    /// Adds constant forces that balance the stress at rest of a tetrahedron, or takes them out.
    pub(in crate::model) fn add_rest_forces(&mut self, nodes: [NodeId; 4], force_n: [DVec3; 4], sign: f64) {
        if self.rest_forces_n.is_empty() {
            self.rest_forces_n = vec![[0.0; 4]; self.frame.n_nodes()];
        }
        for (n, f) in nodes.map(NodeId::index).into_iter().zip(force_n) {
            let at = &mut self.rest_forces_n[n];
            for i in 0..3 {
                at[i] += sign * f[i];
            }
            if self.frame.node_tets[n] == 0 {
                *at = [0.0; 4];
            }
        }
    }

    /// Constant force [N] that balances the stress at rest at a node.
    pub(in crate::model) fn rest_force_n(&self, n: usize) -> DVec3 {
        self.rest_forces_n.get(n).map_or(DVec3::ZERO, unpadded)
    }

    fn update_inertia(&mut self, n: usize) {
        let inertia_kg = self.frame.inertia_kg(n);
        self.inertia_kg[n] = inertia_kg;
        self.inverse_inertia_per_kg[n] = if self.frame.takes_load(n) { 1.0 / inertia_kg } else { 0.0 };
    }

    pub(in crate::model) fn frame(&self) -> &Frame {
        &self.frame
    }

    pub(in crate::model) fn n_nodes(&self) -> usize {
        self.frame.n_nodes()
    }

    pub(in crate::model) fn rest_m(&self) -> &[DVec3] {
        &self.frame.rest_m
    }

    pub(in crate::model) fn mass_kg(&self, node: NodeId) -> f64 {
        self.frame.mass_kg[node.index()]
    }

    pub(in crate::model) fn has_tets(&self, node: NodeId) -> bool {
        self.frame.node_tets[node.index()] > 0
    }

    pub(in crate::model) fn time_step_s(&self) -> f64 {
        self.frame.time_step_s
    }

    pub(in crate::model) fn stable_step_s(&self) -> f64 {
        self.frame.stable_step_s
    }

    pub(in crate::model) fn parts_of_step(&self, dt_s: f64) -> u64 {
        self.frame.parts_of_step(dt_s)
    }

    pub(in crate::model) fn ignored_constraints(&self) -> usize {
        self.frame.ignored_constraints()
    }

    /// Displacements u(t) [m].
    pub(in crate::model) fn displacements(&self) -> &[Padded] {
        &self.motion[..self.n_nodes()]
    }

    /// Displacements u(t-h) [m].
    pub(in crate::model) fn previous_displacements(&self) -> &[Padded] {
        &self.motion[self.n_nodes()..2 * self.n_nodes()]
    }

    fn last_step_s(&self) -> f64 {
        self.motion[2 * self.n_nodes()][0]
    }

    fn set_last_step_s(&mut self, h_s: f64) {
        let last = 2 * self.n_nodes();
        self.motion[last][0] = h_s;
    }

    /// Of free nodes, after the last part.
    fn last_kinetic_j(&self) -> f64 {
        self.motion[2 * self.n_nodes()][1]
    }

    fn set_last_kinetic_j(&mut self, kinetic_j: f64) {
        let last = 2 * self.n_nodes();
        self.motion[last][1] = kinetic_j;
    }

    pub(in crate::model) fn reset(&mut self) {
        let n = self.n_nodes();
        for p in (0..n).filter(|&p| !self.frame.is_fixed[p]) {
            self.motion[p] = [0.0; 4];
            self.motion[n + p] = [0.0; 4];
        }
        self.set_last_step_s(self.frame.time_step_s);
        self.set_last_kinetic_j(0.0);
        self.frame.drop_constraints();
        self.publish();
    }

    pub(in crate::model) fn snapshot(&self) -> ExplicitSnapshot {
        ExplicitSnapshot {
            motion: self.motion.clone(),
            positions_m: self.positions_m.clone(),
            velocities_m_per_s: self.velocities_m_per_s.clone(),
        }
    }

    pub(in crate::model) fn restore(&mut self, snapshot: &ExplicitSnapshot) {
        self.motion.copy_from_slice(&snapshot.motion);
        self.positions_m.copy_from_slice(&snapshot.positions_m);
        self.velocities_m_per_s.copy_from_slice(&snapshot.velocities_m_per_s);
    }

    /// Kinetic energy of the last half step [J].
    pub(in crate::model) fn kinetic_energy_j(&self) -> f64 {
        let of_node = |(m, v): (&f64, &DVec3)| 0.5 * m * v.length_squared();
        self.inertia_kg.iter().zip(&self.velocities_m_per_s).map(of_node).sum()
    }

    /// Holds a node where it is from now on.
    pub(in crate::model) fn fix_in_place(&mut self, node: NodeId) {
        if self.frame.fix(node) {
            let (n, p) = (self.n_nodes(), node.index());
            self.motion[n + p] = self.motion[p];
            self.velocities_m_per_s[p] = DVec3::ZERO;
            self.update_inertia(p);
        }
    }

    /// The force that balances deformation, stress at rest, gravity and outer forces on every node: f(u) - m g - F.
    fn balance_forces(
        &mut self,
        h_s: f64,
        add_elastic: &mut impl FnMut(&[Padded], &mut [Padded]) -> Quarantine,
    ) {
        let n = self.n_nodes();
        let force = &mut self.force_n[..n];
        let g = padded(self.frame.gravity_m_per_s2);
        if self.rest_forces_n.is_empty() {
            for (force, m) in force.iter_mut().zip(&self.frame.mass_kg) {
                *force = g.map(|g| -m * g);
            }
        } else {
            for ((force, m), rest) in force.iter_mut().zip(&self.frame.mass_kg).zip(&self.rest_forces_n) {
                *force = std::array::from_fn(|i| rest[i] - m * g[i]);
            }
        }
        let b = self.frame.damping.stiffness_s;
        let quarantine = if b > 0.0 {
            let share = b / h_s;
            for (p, ahead) in self.ahead_m.iter_mut().enumerate() {
                let (now, previous) = (&self.motion[p], &self.motion[n + p]);
                *ahead = std::array::from_fn(|i| now[i] + share * (now[i] - previous[i]));
            }
            for held in self.frame.held.iter() {
                let p = held.node as usize;
                let (now, before) = (unpadded(&self.motion[p]), held.before_m);
                self.ahead_m[p] = padded(now + share * (now - before));
            }
            add_elastic(&self.ahead_m, force)
        } else {
            add_elastic(&self.motion[..n], force)
        };
        self.frame.note_quarantine(quarantine);
        let mut take = |p: usize, f_n: DVec3| {
            let f = &mut force[p];
            for i in 0..3 {
                f[i] -= f_n[i];
            }
        };
        for &(p, outer_n) in self.frame.outer_forces.iter() {
            take(p as usize, outer_n);
        }
        for ligament in &self.frame.attachments {
            let p = ligament.node.index();
            take(p, ligament.force_n(self.frame.rest_m[p] + unpadded(&self.motion[p])));
        }
        for slides in &self.frame.sliding {
            for axis in (0..3).filter(|&axis| slides.supported[axis]) {
                force[slides.node as usize][axis] = 0.0;
            }
        }
    }

    /// One step of central differences for every node; nodes of infinite mass keep their velocity, which is
    /// zero for fixed ones. The kinetic energy [J] after it.
    fn integrate(&mut self, h_s: f64) -> f64 {
        let n = self.n_nodes();
        let (now, rest) = self.motion.split_at_mut(n);
        let previous = &mut rest[..n];
        let (weights, masses) = (&self.inverse_inertia_per_kg[..n], &self.inertia_kg[..n]);
        let forces = &self.force_n[..n];
        let inertia = 1.0 / (h_s * h_s);
        let damping = 0.5 * self.frame.damping.mass_per_s / h_s;
        let scale = 1.0 / (inertia + damping);
        let mut squares = [0.0; 4];
        for p in 0..n {
            let inverse_mass = weights[p];
            for i in 0..4 {
                let before = now[p][i] - previous[p][i];
                let change = ((inertia - damping) * before - inverse_mass * forces[p][i]) * scale;
                previous[p][i] = now[p][i];
                now[p][i] += change;
                squares[i] += masses[p] * (change * change);
            }
        }
        0.5 * inertia * (squares[0] + squares[1] + squares[2])
    }

    /// Held nodes do not follow their forces: they stay where they are, with the velocity of the tool, and count
    /// as outside.
    fn bring_back_held(&mut self, h_s: f64, kinetic_j: &mut f64) {
        let n = self.frame.n_nodes();
        for at in 0..self.frame.held.len() {
            let held = self.frame.held[at];
            let p = held.node as usize;
            let strayed_m = unpadded(&self.motion[p]) - unpadded(&self.motion[n + p]);
            *kinetic_j -= 0.5 * self.inertia_kg[p] * (strayed_m / h_s).length_squared();
            let force_n = held.on_tool_n(unpadded(&self.force_n[p]));
            self.frame.constraint_forces_n[held.place as usize] = force_n;
            self.motion[p] = self.motion[n + p];
            self.motion[n + p] = padded(held.before_m);
        }
    }

    /// No node goes further in a part than that.
    #[cold]
    fn limit_ways(&mut self, furthest_m: f64, h_s: f64, kinetic_j: &mut f64) {
        let n = self.n_nodes();
        let mut is_any = false;
        for p in (0..n).filter(|&p| self.inverse_inertia_per_kg[p] > 0.0) {
            let (now_m, before_m) = (unpadded(&self.motion[p]), unpadded(&self.motion[n + p]));
            let way_m = now_m - before_m;
            if way_m.length_squared() > furthest_m * furthest_m {
                self.motion[p] = padded(before_m + way_m.clamp_length_max(furthest_m));
                is_any = true;
            }
        }
        if is_any {
            *kinetic_j = self.free_kinetic_j(h_s);
            self.frame.note_limited_energy();
        }
    }

    /// What a part may have gone wrong with: places that are no numbers, and energy from nowhere.
    #[cold]
    fn put_right(&mut self, h_s: f64) -> f64 {
        let n = self.n_nodes();
        for p in 0..n {
            let way_m = unpadded(&self.motion[p]) - unpadded(&self.motion[n + p]);
            let energy_j = self.inertia_kg[p] * (way_m / h_s).length_squared();
            if !(energy_j.is_finite() && unpadded(&self.motion[p]).is_finite()) {
                self.motion[p] = self.motion[n + p];
                self.frame.note_recovered_node();
            }
        }
        let free = self.free_kinetic_j(h_s);
        let motion = &self.motion;
        let before_m = |p: usize| self.frame.rest_m[p] + unpadded(&motion[n + p]);
        let way_m = |p: usize| unpadded(&motion[p]) - unpadded(&motion[n + p]);
        let work_j = self.frame.outside_work_j(before_m, way_m);
        let Some(allowed_j) = self.frame.limited_kinetic_j(self.motion[2 * n][1], free, work_j) else {
            return free;
        };
        let slower = (allowed_j / free).sqrt();
        for p in (0..n).filter(|&p| self.inverse_inertia_per_kg[p] > 0.0) {
            for i in 0..3 {
                self.motion[p][i] =
                    self.motion[n + p][i] + slower * (self.motion[p][i] - self.motion[n + p][i]);
            }
        }
        allowed_j
    }

    /// Kinetic energy [J] of the nodes that no tool holds.
    fn free_kinetic_j(&self, h_s: f64) -> f64 {
        let n = self.n_nodes();
        let of_node = |p: usize| {
            let way_m = unpadded(&self.motion[p]) - unpadded(&self.motion[n + p]);
            0.5 * self.inertia_kg[p] * (way_m / h_s).length_squared()
        };
        let all: f64 = (0..n).map(of_node).sum();
        let held: f64 = self.frame.held.iter().map(|h| of_node(h.node as usize)).sum();
        (all - held).max(0.0)
    }

    /// Another length of step: the velocity stays, and with it u(t-h).
    fn change_step(&mut self, h_s: f64) {
        let n = self.n_nodes();
        let ratio = h_s / self.last_step_s();
        let (now, rest) = self.motion.split_at_mut(n);
        for (now, previous) in now.iter().zip(rest) {
            for i in 0..4 {
                previous[i] = now[i] - (now[i] - previous[i]) * ratio;
            }
        }
        self.set_last_step_s(h_s);
    }

    /// Positions and velocities from the displacements.
    fn publish(&mut self) {
        let n = self.n_nodes();
        let per_step = 1.0 / self.last_step_s();
        for p in 0..n {
            let (now, previous) = (unpadded(&self.motion[p]), unpadded(&self.motion[n + p]));
            self.positions_m[p] = self.frame.rest_m[p] + now;
            self.velocities_m_per_s[p] = (now - previous) * per_step;
        }
    }

    /// Advances by `dt_s` in the fewest equal parts that are not longer than the time step and the stable step.
    /// `add_elastic(u, f)` adds the forces that balance the displacements u and tells what it left out.
    /// Held nodes move evenly to where they are held; the constraint force is the one that balances them at
    /// the last part: elastic force and weight, without the held node's own inertia.
    pub(in crate::model) fn step(
        &mut self,
        dt_s: f64,
        mut add_elastic: impl FnMut(&[Padded], &mut [Padded]) -> Quarantine,
    ) {
        let Some((n_parts, h_s)) = self.frame.begin_step(dt_s) else { return };
        if h_s != self.last_step_s() {
            self.change_step(h_s);
        }
        for held in self.frame.held.iter_mut() {
            held.start_m = unpadded(&self.motion[held.node as usize]);
        }
        for part in 1..=n_parts {
            for held in self.frame.held.iter_mut() {
                let at = &mut self.motion[held.node as usize];
                held.before_m = unpadded(at);
                *at = padded(held.at_m(part, n_parts));
            }
            self.balance_forces(h_s, &mut add_elastic);
            let mut kinetic_j = self.integrate(h_s);
            self.bring_back_held(h_s, &mut kinetic_j);
            if let Some(furthest_m) = self.frame.furthest_m(h_s) {
                self.limit_ways(furthest_m, h_s, &mut kinetic_j);
            }
            if !self.frame.is_plain_growth(self.last_kinetic_j(), kinetic_j) {
                kinetic_j = self.put_right(h_s);
            }
            self.set_last_kinetic_j(kinetic_j);
        }
        self.publish();
    }

    /// Takes other damping from the next step on.
    pub(in crate::model) fn set_mass_damping(&mut self, mass_per_s: f64) {
        self.frame.damping.mass_per_s = mass_per_s;
    }

    /// Starts a node that is not fixed from a displacement [m] with a velocity; the state is shown from the next step
    /// on.
    pub(in crate::model) fn start_node(&mut self, p: usize, displacement_m: DVec3, velocity_m_per_s: DVec3) {
        let (n, h_s) = (self.n_nodes(), self.last_step_s());
        if self.frame.is_fixed[p] {
            return;
        }
        let (mut u_m, mut velocity) = (displacement_m, velocity_m_per_s);
        for slides in self.frame.sliding.iter().filter(|s| s.node as usize == p) {
            for axis in (0..3).filter(|&axis| slides.supported[axis]) {
                (u_m[axis], velocity[axis]) = (self.motion[p][axis], 0.0);
            }
        }
        self.motion[p] = padded(u_m);
        self.motion[n + p] = padded(u_m - h_s * velocity);
        self.velocities_m_per_s[p] = velocity;
        self.positions_m[p] = self.frame.rest_m[p] + u_m;
    }

    /// Takes the masses of one tetrahedron out; [`ExplicitMotion::after_removals`] has to follow.
    pub(in crate::model) fn remove_tet(&mut self, nodes: [NodeId; 4], volume_m3: f64) {
        self.frame.remove_tet(nodes, volume_m3);
        nodes.into_iter().for_each(|n| self.update_inertia(n.index()));
    }

    /// Adds the masses of one tetrahedron; `stiff`: its tensors, and how much stiffer it may become.
    pub(in crate::model) fn add_tet(
        &mut self,
        t: usize,
        nodes: [NodeId; 4],
        volume_m3: f64,
        stiff: &StiffTet,
    ) {
        let corner_kg = 0.25 * self.frame.density_kg_per_m3() * volume_m3;
        self.frame.add_tet(t, nodes, volume_m3, stiff.squared_frequency_per_s2([corner_kg; 4]));
        nodes.into_iter().for_each(|n| self.update_inertia(n.index()));
    }

    /// Keeps the state, masses and constraints.
    pub(in crate::model) fn save(&self, undo: &mut ModelUndo) {
        self.frame.save(undo);
        undo.positions_m.extend_from_slice(&self.positions_m);
        undo.velocities_m_per_s.extend_from_slice(&self.velocities_m_per_s);
        undo.numbers.extend_from_slice(self.motion.as_flattened());
        undo.numbers.extend_from_slice(self.rest_forces_n.as_flattened());
    }

    /// Comes back to [`ExplicitMotion::save`] of the same nodes.
    pub(in crate::model) fn put_back(&mut self, undo: &ModelUndo, from: &mut UndoReader<'_>) {
        self.frame.put_back(undo, from);
        self.positions_m.copy_from_slice(&undo.positions_m);
        self.velocities_m_per_s.copy_from_slice(&undo.velocities_m_per_s);
        let motion = self.motion.as_flattened_mut();
        motion.copy_from_slice(from.numbers(motion.len()));
        let rest_forces_n = self.rest_forces_n.as_flattened_mut();
        rest_forces_n.copy_from_slice(from.numbers(rest_forces_n.len()));
        (0..self.n_nodes()).for_each(|n| self.update_inertia(n));
    }

    /// Room for what an edit brings in; new and moved nodes are at their places afterwards.
    pub(in crate::model) fn grow(
        &mut self,
        mesh: &TetMesh,
        change: &TopologyChange,
        growth: &TopologyUpdate,
    ) {
        let (n_before, n_nodes) = (self.n_nodes(), growth.n_nodes);
        self.frame.grow(mesh, change, growth);
        let supports = |n: usize| self.frame.supports(n);
        let way_m = |n: usize| unpadded(&self.motion[n]) - unpadded(&self.motion[n_before + n]);
        let mut ways: Vec<(usize, DVec3)> = growth.velocities(way_m, supports);
        let now = growth.displacements_m(|n| unpadded(&self.motion[n]), supports);
        let mut motion = Vec::with_capacity(2 * n_nodes + 1);
        for nodes in [0..n_before, n_before..2 * n_before] {
            motion.extend_from_slice(&self.motion[nodes]);
            motion.resize(motion.len() + n_nodes - n_before, [0.0; 4]);
        }
        ways.extend(now.iter().filter(|(n, _)| *n < n_before).map(|(n, _)| (*n, way_m(*n))));
        now.into_iter().for_each(|(n, u_m)| motion[n] = padded(u_m));
        for (n, way_m) in ways {
            motion[n_nodes + n] = padded(unpadded(&motion[n]) - way_m);
        }
        motion.push(self.motion[2 * n_before]);
        self.motion = motion;
        if !self.rest_forces_n.is_empty() {
            self.rest_forces_n.resize(n_nodes, [0.0; 4]);
        }
        self.inertia_kg.resize(n_nodes, 0.0);
        self.inverse_inertia_per_kg.resize(n_nodes, 0.0);
        self.positions_m.resize(n_nodes, DVec3::ZERO);
        self.velocities_m_per_s.resize(n_nodes, DVec3::ZERO);
        self.force_n.resize(n_nodes, [0.0; 4]);
        if self.frame.damping.stiffness_s > 0.0 {
            self.ahead_m.resize(n_nodes, [0.0; 4]);
        }
    }

    /// After an edit that added or moved something: the step that is stable now and after any cuts.
    pub(in crate::model) fn after_growth(&mut self, tets: &LiveTets) {
        let highest_per_s2 = self.frame.highest_tet_per_s2(&tets.is_live);
        if highest_per_s2 > 0.0 {
            self.stable.after_cuts_s = MARGIN * 2.0 / highest_per_s2.sqrt();
        }
        self.after_removals(tets);
        self.publish();
    }

    /// Squared frequency of a tetrahedron by itself, for every shape allowed for [1/s2].
    pub(in crate::model) fn tet_per_s2(&self, t: usize) -> f64 {
        self.frame.tet_per_s2(t)
    }

    /// After removals: the step that is stable after any cuts, and heavier nodes where the most parts would not
    /// suffice. Nodes left alone stay where they are, without constraints.
    pub(in crate::model) fn after_removals(&mut self, tets: &LiveTets) {
        self.frame.let_loose_nodes_go();
        let n_nodes = self.n_nodes();
        for n in (0..n_nodes).filter(|&n| self.frame.node_tets[n] == 0) {
            self.motion[n_nodes + n] = self.motion[n];
        }
        let was_scaled = self.frame.report(0.0).n_mass_scaled_nodes > 0;
        if was_scaled {
            self.frame.forget_scaling();
            (0..self.n_nodes()).for_each(|n| self.update_inertia(n));
        }
        self.frame.stable_step_s = self.step_for(self.stable.after_cuts_s);
        let least_s = self.frame.least_stable_step_s();
        if self.frame.stable_step_s >= least_s {
            return;
        }
        // h <= sqrt(b^2 + 4/omega^2) - b at h = the least step.
        let b = self.frame.damping.stiffness_s;
        let allowed_per_s2 = 4.0 * MARGIN * MARGIN / (least_s * (least_s + 2.0 * b));
        let of_tets_per_s2 = self.frame.scale_attached(allowed_per_s2);
        self.frame.scale_tets(of_tets_per_s2, tets);
        (0..self.n_nodes()).for_each(|n| self.update_inertia(n));
        self.frame.stable_step_s = least_s;
    }

    /// Drops nodes without a new id; the order of the others stays. Constraints are dropped with their node
    /// numbers.
    pub(in crate::model) fn compact(&mut self, new_ids: &[Option<NodeId>], live_tets: &[bool]) {
        let stays: Vec<bool> = new_ids.iter().map(Option::is_some).collect();
        let last = self.motion.pop().expect("the entry of step and energy");
        let stays_twice: Vec<bool> = stays.iter().chain(&stays).copied().collect();
        keep(&mut self.motion, &stays_twice);
        self.motion.push(last);
        self.frame.compact(new_ids, live_tets);
        if !self.rest_forces_n.is_empty() {
            keep(&mut self.rest_forces_n, &stays);
        }
        keep(&mut self.inertia_kg, &stays);
        keep(&mut self.inverse_inertia_per_kg, &stays);
        keep(&mut self.positions_m, &stays);
        keep(&mut self.velocities_m_per_s, &stays);
        keep(&mut self.force_n, &stays);
        if !self.ahead_m.is_empty() {
            keep(&mut self.ahead_m, &stays);
        }
    }
}

impl Mover for ExplicitMotion {
    fn apply(&mut self, constraints: &Constraints) {
        self.frame.apply(constraints);
    }

    fn state(&self) -> ModelState<'_> {
        ModelState { positions_m: &self.positions_m, velocities_m_per_s: &self.velocities_m_per_s }
    }

    fn history_into(&self, numbers: &mut Vec<f64>) {
        numbers.extend_from_slice(self.motion.as_flattened());
    }

    fn constraint_forces_n(&self) -> &[DVec3] {
        &self.frame.constraint_forces_n
    }

    /// Starts at standstill; fixed nodes stay where they are, those whose place is no number where they rest.
    fn take_over(&mut self, positions_m: &[DVec3]) {
        let n = self.n_nodes();
        assert_eq!(positions_m.len(), n, "one position a node");
        for p in 0..n {
            if !self.frame.is_fixed[p] {
                let u_m = positions_m[p] - self.frame.rest_m[p];
                self.motion[p] = padded(if u_m.is_finite() { u_m } else { DVec3::ZERO });
            }
        }
        for slides in &self.frame.sliding {
            for axis in (0..3).filter(|&axis| slides.supported[axis]) {
                self.motion[slides.node as usize][axis] = self.motion[n + slides.node as usize][axis];
            }
        }
        self.motion.copy_within(..n, n);
        self.set_last_kinetic_j(0.0);
        self.frame.constraint_forces_n.fill(DVec3::ZERO);
        self.publish();
    }

    fn set_gravity(&mut self, gravity_m_per_s2: DVec3) {
        self.frame.set_gravity(gravity_m_per_s2);
    }

    fn report(&self) -> ModelReport {
        self.frame.report(self.kinetic_energy_j())
    }

    /// Displacement of a node for a unit force along each axis in a step [m/N].
    fn node_answer_m_per_n(&self, node: NodeId, dt_s: f64) -> DVec3 {
        let n = node.index();
        if n >= self.n_nodes() || self.frame.is_held(n) {
            return DVec3::ZERO;
        }
        let free = self.frame.free_axes(n).map(|is_free| f64::from(u8::from(is_free)));
        DVec3::from_array(free) * (dt_s * dt_s * self.inverse_inertia_per_kg[n])
    }

    /// What further forces would have done in the last step. u(t-h) follows u(t) so far that the velocity changes by
    /// the move over the whole step, not over its last part.
    fn correct(&mut self, forces: &[NodalForce], dt_s: f64, correction: Correction) {
        let n_nodes = self.n_nodes();
        let last_s = self.last_step_s();
        let share = match correction {
            Correction::Motion => 1.0 - last_s / dt_s,
            Correction::Places => 1.0,
        };
        let mut gained_j = 0.0;
        for force in forces {
            let move_m = self.node_answer_m_per_n(force.node, dt_s) * force.force_n;
            if move_m == DVec3::ZERO || !move_m.is_finite() {
                continue;
            }
            let n = force.node.index();
            let now_m = unpadded(&self.motion[n]) + move_m;
            self.motion[n] = padded(now_m);
            self.positions_m[n] = self.frame.rest_m[n] + now_m;
            let previous_m = unpadded(&self.motion[n_nodes + n]) + move_m * share;
            self.motion[n_nodes + n] = padded(previous_m);
            if correction == Correction::Motion {
                let velocity_m_per_s = (now_m - previous_m) / last_s;
                let before_m_per_s = std::mem::replace(&mut self.velocities_m_per_s[n], velocity_m_per_s);
                let gained = velocity_m_per_s.length_squared() - before_m_per_s.length_squared();
                gained_j += 0.5 * self.inertia_kg[n] * gained;
            }
        }
        self.set_last_kinetic_j((self.last_kinetic_j() + gained_j).max(0.0));
    }
}
