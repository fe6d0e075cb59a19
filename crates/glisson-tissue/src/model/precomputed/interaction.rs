//! Constraints in, forces and displacements out: the steps of the model.

use super::contact_system::{ContactPoint, ContactReport, MOST_POINTS};
use super::pairs::Pairs;
use super::response::{place_rows, respond_into, set_to_columns};
use super::table::place_of_displacement;
use super::{Load, PointConstraint, Precomputed, ResponseReport};
use crate::model::bounded_vec::BoundedVec;
use crate::model::kernel::KernelPath;
use crate::model::{Constraints, LocalModel, NodalForce};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::NodeId;

/// The target of a held point, and the constraint that it comes from.
#[derive(Clone, Copy, Debug)]
pub(super) struct Target {
    place: u32,
    displacement_m: DVec3,
}

impl Precomputed {
    /// Sets held points and forces from the next step on, in place of all earlier constraints. At most
    /// [`Precomputed::MAX_IMPOSED`] points count. [`Precomputed::response_report`] counts those left out: points of nodes
    /// that cannot be pushed, values that are not finite, more forces than there are loadable nodes.
    ///
    /// Put new points at the end and keep the order of the others: then the small system is not factored again.
    pub fn impose_points(&mut self, points: &[PointConstraint], forces: &[NodalForce]) {
        self.release_pieces();
        self.take_forces(forces);
        self.wanted.clear();
        self.targets.clear();
        for (place, point) in points.iter().enumerate() {
            match self.contact_point(point) {
                Some(contact) if self.wanted.try_push(contact) => {
                    self.targets
                        .try_push(Target { place: place as u32, displacement_m: point.displacement_m });
                }
                _ => self.report.ignored_displacements += 1,
            }
        }
        self.start_constraint_forces(points.len());
    }

    pub(super) fn take_constraints(&mut self, constraints: &Constraints) {
        self.release_pieces();
        self.take_forces(&constraints.forces);
        self.wanted.clear();
        self.targets.clear();
        for (place, imposed) in constraints.displacements.iter().enumerate() {
            let loaded = self.loadable_index(imposed.node).filter(|_| imposed.displacement_m.is_finite());
            match loaded {
                Some(m) if self.wanted.try_push(ContactPoint::node(m)) => {
                    let displacement_m = imposed.displacement_m;
                    self.targets.try_push(Target { place: place as u32, displacement_m });
                }
                _ if loaded.is_none() && self.move_piece(place, imposed) => {}
                _ => self.report.ignored_displacements += 1,
            }
        }
        self.start_constraint_forces(constraints.displacements.len());
    }

    fn take_forces(&mut self, forces: &[NodalForce]) {
        self.report = ResponseReport::default();
        self.forces.clear();
        for force in forces {
            match self.loadable_index(force.node) {
                Some(m) if force.force_n.is_finite() && self.forces.try_push((m, force.force_n)) => {}
                None if self.push_piece(force) => {}
                _ => self.report.ignored_forces += 1,
            }
        }
    }

    /// One entry per constraint, for as many as there are loadable nodes. A longer list has repetitions; its end has no
    /// entries.
    fn start_constraint_forces(&mut self, n: usize) {
        self.constraint_forces_n.clear();
        let n = n.min(self.constraint_forces_n.capacity());
        self.constraint_forces_n.resize(n, DVec3::ZERO);
        self.reactions.clear();
    }

    /// The point in the form of the small system, if any of its nodes can move.
    fn contact_point(&self, point: &PointConstraint) -> Option<ContactPoint> {
        let mut contact = ContactPoint { n_nodes: 0, n_directions: 0, ..ContactPoint::node(0) };
        contact.weights = [0.0; 3];
        contact.directions = [DVec3::ZERO; 3];
        if !point.displacement_m.is_finite() {
            return None;
        }
        for (&node, &weight) in point.nodes.iter().zip(&point.weights) {
            if !weight.is_finite() {
                return None;
            }
            if weight == 0.0 || self.fixed_nodes().binary_search(&node).is_ok() {
                continue;
            }
            contact.loaded[contact.n_nodes] = self.loadable_index(node)?;
            contact.weights[contact.n_nodes] = weight;
            contact.n_nodes += 1;
        }
        for direction in point.directions {
            if !direction.is_finite() {
                return None;
            }
            if direction != DVec3::ZERO {
                contact.directions[contact.n_directions] = direction;
                contact.n_directions += 1;
            }
        }
        (contact.n_nodes > 0 && contact.n_directions > 0).then_some(contact)
    }

    /// Acceleration that the body answers to, and what the rest shape has of the answer: what is left of a cut body
    /// carries its whole weight, an uncut one what goes beyond its rest.
    fn weight(&self) -> (DVec3, &[f64]) {
        match self.cuts.as_ref().and_then(|cuts| cuts.carried_m()) {
            Some(carried_m) => (self.pull_m_per_s2 + self.rest_gravity_m_per_s2, carried_m),
            None => (self.pull_m_per_s2, &[]),
        }
    }

    /// Computes the displacements of all rows from the outer forces and from the weight minus that at rest.
    fn respond_to_forces(&mut self) {
        // Taken out for the time being, so that the other fields can be borrowed.
        let mut displacement_m = std::mem::take(&mut self.displacement_m);
        let (weight_m_per_s2, carried_m) = self.weight();
        let has_weight = weight_m_per_s2 != DVec3::ZERO || !carried_m.is_empty();
        if has_weight {
            let columns = &self.compliance.weight_response_s2;
            set_to_columns(self.path, columns, weight_m_per_s2, &mut displacement_m);
            for (u, carried) in displacement_m.iter_mut().zip(carried_m) {
                *u -= carried;
            }
        }
        let table = &self.compliance.table;
        respond_into(self.path, table, &self.forces, !has_weight, &mut displacement_m);
        for pull in self.cuts.iter().flat_map(|cuts| cuts.pulls()) {
            respond_into(self.path, table, &[pull], false, &mut displacement_m);
        }
        self.displacement_m = displacement_m;
    }

    /// The same for one loadable node.
    fn response_to_forces_m(&self, loaded: usize) -> DVec3 {
        let weight = &self.compliance.weight_response_s2;
        let (weight_m_per_s2, carried_m) = self.weight();
        let mut u_m = DVec3::ZERO;
        if weight_m_per_s2 != DVec3::ZERO {
            u_m += super::table::tensor_of_columns(weight, loaded) * weight_m_per_s2;
        }
        if !carried_m.is_empty() {
            u_m -= DVec3::from_array([0, 1, 2].map(|axis| carried_m[place_of_displacement(loaded, axis)]));
        }
        let pulls = self.cuts.iter().flat_map(|cuts| cuts.pulls());
        for (m, force_n) in self.forces.iter().copied().chain(pulls) {
            u_m += self.compliance.table.tensor(loaded, m as usize) * force_n;
        }
        u_m
    }

    /// Reactions that hold the points, with `response_m` of the forces at a loadable node.
    fn solve_points(&mut self, response_m: impl Fn(&Self, usize) -> DVec3) {
        self.contacts.update(self.path, &self.compliance.table, &self.pairs, &self.wanted);
        let mut row = 0;
        for i in 0..self.wanted.len() {
            let (point, target) = (self.wanted[i], self.targets[i]);
            let mut missing_m = target.displacement_m;
            for (loaded, weight) in point.nodes() {
                missing_m -= response_m(self, loaded as usize) * weight;
            }
            for direction in &point.directions[..point.n_directions] {
                self.contacts.right_mut()[row] = direction.dot(missing_m);
                row += 1;
            }
        }
        self.contacts.solve(self.path, &self.compliance.table);
        let mut row = 0;
        for (point, target) in self.wanted.iter().zip(self.targets.iter()) {
            let reactions = &self.contacts.solution()[row..row + point.n_directions];
            let force_n = point.directions.iter().zip(reactions).map(|(d, x)| *d * *x).sum();
            row += point.n_directions;
            if let Some(of_constraint) = self.constraint_forces_n.get_mut(target.place as usize) {
                *of_constraint = force_n;
            }
        }
    }

    /// Reactions as forces on nodes, one per node.
    fn spread_reactions(&mut self) {
        self.reactions.clear();
        for (point, target) in self.wanted.iter().zip(self.targets.iter()) {
            let force_n = self.constraint_forces_n.get(target.place as usize).copied().unwrap_or(DVec3::ZERO);
            for (loaded, weight) in point.nodes() {
                match self.reactions.iter_mut().find(|(m, _)| *m == loaded) {
                    Some((_, sum_n)) => *sum_n += force_n * weight,
                    None => {
                        self.reactions.try_push((loaded, force_n * weight));
                    }
                }
            }
        }
    }

    /// Computes the response to the forces, then the reactions that hold the points, then the positions.
    pub(super) fn respond(&mut self) {
        self.respond_to_forces();
        if !self.wanted.is_empty() {
            self.solve_points(|model, loaded| model.displacement_of_row_m(loaded));
            self.spread_reactions();
            let table = &self.compliance.table;
            respond_into(self.path, table, &self.reactions, false, &mut self.displacement_m);
        }
        place_rows(&self.compliance.rows, &self.rest_m, &self.displacement_m, &mut self.positions_m);
    }

    /// Forces that hold the constraints of the last `apply` or [`Precomputed::impose_points`], in their order, without a
    /// step: for a haptic loop between two steps. They equal those of a step up to rounding.
    pub fn update_reactions(&mut self) -> &[DVec3] {
        if !self.wanted.is_empty() {
            self.solve_points(Self::response_to_forces_m);
        }
        &self.constraint_forces_n
    }

    /// Report on the last solution of the small system of the held points.
    pub fn contact_report(&self) -> ContactReport {
        if self.wanted.is_empty() { ContactReport::default() } else { self.contacts.report() }
    }

    /// Drops kept factors after a change of the compliance; contacts are read from the table again.
    pub(super) fn compliance_changed(&mut self) {
        self.pairs = Pairs::None;
        self.contacts.forget();
    }

    /// Renumbers loads and held points from the places of `old_rows` to the present ones. Drops those without a place.
    pub(super) fn follow_rows(&mut self, old_rows: &[NodeId]) {
        let find = |row_of: &[u32], n_loadable: usize, m: u32| {
            let row = row_of[old_rows[m as usize].index()];
            ((row as usize) < n_loadable).then_some(row)
        };
        let (row_of, n_loadable) = (&self.row_of, self.compliance.n_loadable);
        let mut forces = BoundedVec::with_capacity(n_loadable);
        forces.extend(
            self.forces.iter().filter_map(|&(m, f)| Some((find(row_of, n_loadable, m)?, f))).take(n_loadable),
        );
        self.forces = forces;
        let (mut wanted, mut targets) =
            (BoundedVec::with_capacity(Self::MAX_IMPOSED), BoundedVec::with_capacity(Self::MAX_IMPOSED));
        for (point, target) in self.wanted.iter().zip(self.targets.iter()) {
            let mut point = *point;
            let own = &mut point.loaded[..point.n_nodes];
            if own.iter_mut().all(|m| find(row_of, n_loadable, *m).map(|row| *m = row).is_some()) {
                wanted.push(point);
                targets.push(*target);
            }
        }
        (self.wanted, self.targets) = (wanted, targets);
        let mut reactions = BoundedVec::with_capacity(Self::MOST_REACTIONS);
        let kept = self.reactions.iter().filter_map(|&(m, f)| Some((find(row_of, n_loadable, m)?, f)));
        reactions.extend(kept.take(Self::MOST_REACTIONS));
        self.reactions = reactions;
        let n_nodes = self.rest_m.len();
        let n_more = n_nodes.saturating_sub(self.constraint_forces_n.len());
        self.constraint_forces_n.reserve(n_more);
        self.compliance_changed();
    }

    /// Sets the instruction set to compute with; the bits are the same on every one.
    pub fn set_path(&mut self, path: KernelPath) {
        self.path = path;
    }

    /// Displacement of a row [m].
    pub(super) fn displacement_of_row_m(&self, row: usize) -> DVec3 {
        DVec3::from_array([0, 1, 2].map(|axis| self.displacement_m[place_of_displacement(row, axis)]))
    }

    /// Displacement [m] of a point of weighted nodes after the last step; none for nodes that are not stored.
    pub fn point_displacement_m(&self, nodes: [NodeId; 3], weights: [f64; 3]) -> Option<DVec3> {
        let mut u_m = DVec3::ZERO;
        for (node, weight) in nodes.into_iter().zip(weights).filter(|(_, w)| *w != 0.0) {
            if self.fixed_nodes().binary_search(&node).is_err() {
                let row = *self.row_of.get(node.index()).filter(|row| **row != super::NONE)?;
                u_m += self.displacement_of_row_m(row as usize) * weight;
            }
        }
        Some(u_m)
    }

    /// The patch's part of the compliance: exact, and the same for any period. Nodes that other tools hold respond as if
    /// these were not there.
    pub(super) fn fill_local_model(&self, patch: &[NodeId], period_s: f64, out: &mut LocalModel) {
        out.start(patch, period_s, &self.positions_m);
        for j in 0..out.nodes.len() {
            let Some(by) = self.loadable_index(out.nodes[j]) else { continue };
            out.force_n[j] = self.load_on_n(by);
            for i in 0..out.nodes.len() {
                if let Some(of) = self.loadable_index(out.nodes[i]) {
                    out.set_tensor(i, j, self.compliance.table.tensor(of as usize, by as usize));
                }
            }
        }
        out.symmetrize();
    }

    /// Loads of the last step.
    fn load_on_n(&self, loaded: u32) -> DVec3 {
        let of = |list: &[Load]| list.iter().filter(|(m, _)| *m == loaded).map(|(_, f)| *f).sum::<DVec3>();
        of(&self.forces) + of(&self.reactions)
    }

    /// Largest number of nodal reactions: three nodes for each point.
    pub(super) const MOST_REACTIONS: usize = 3 * MOST_POINTS;
}
