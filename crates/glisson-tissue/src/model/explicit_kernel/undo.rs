//! Taking edits back with the values from before.
//!
//! The state is kept whole, of the rest what the edit is about to overwrite: the masses of the nodes at tetrahedra that go
//! or change their shape, the inertia added to them, places at rest. What a tetrahedron has in the kernel follows from
//! its shape at rest and its substance, by the computation that it came in with, so that it has the same bits. An
//! edit after which the kernel may be laid out anew is kept as a copy of the whole model.

use super::{ExplicitKernel, Held};
use crate::model::kernel::{KernelCounts, NodeMass};
use crate::model::topology_update::grows;
use crate::model::{DeformableModel, ModelUndo, UndoReader};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::{NodeId, TetId};

impl ExplicitKernel {
    /// Kept in this order: state, constraints, counts, places at rest, tetrahedra, masses.
    pub(super) fn save(&self, change: &TopologyChange, undo: &mut ModelUndo) {
        undo.clear();
        let n_added = change.tets.added.ids().len();
        let is_outgrown =
            n_added > 0 && (self.kernel.is_outgrown_by(n_added) || !self.kernel.has_rows_for(n_added));
        if is_outgrown || change.is_renumbering() {
            undo.keep_whole(self.duplicate());
            return;
        }
        undo.report = self.report;
        // Growing while the last numbers arrive would copy all of them once more.
        let n_history = 6 * self.displacements_m.len() + 3 + self.kernel.history_len();
        undo.numbers.reserve(n_history + NUMBERS_BESIDE_STATE);
        undo.push_place(n_history);
        self.history_into(&mut undo.numbers);
        undo.push_vector(self.loads.gravity_m_per_s2);
        self.save_constraints(undo);

        let KernelCounts { n_nodes, n_tets, n_added } = self.kernel.counts();
        [n_nodes, n_tets, n_added, usize::from(grows(change))].into_iter().for_each(|n| undo.push_place(n));
        if grows(change) {
            self.kernel.part_counts().flatten().for_each(|n| undo.push_place(n));
        }
        let moved = || change.moved_nodes.iter().filter(|node| node.index() < n_nodes);
        undo.push_place(moved().count());
        for &node in moved() {
            undo.places.push(node.0);
            undo.push_vector(self.rest.positions_m[node.index()]);
        }

        undo.push_place(usize::from(self.is_cut));
        self.stability.save(undo);
        let start = undo.places.len();
        undo.push_place(0);
        for &tet in change.reshaped_tets.iter().filter(|tet| self.kernel.is_live(**tet)) {
            undo.places[start] += 1;
            self.save_tet(tet, undo);
        }
        let start = undo.places.len();
        undo.push_place(0);
        for &tet in &change.tets.removed {
            if tet.index() < n_tets && self.kernel.is_live(tet) {
                undo.places[start] += 1;
                self.save_tet(tet, undo);
            }
        }
    }

    fn save_constraints(&self, undo: &mut ModelUndo) {
        undo.push_place(self.held.len());
        for held in self.held.iter() {
            undo.push_place(held.place);
            undo.places.push(held.node.0);
            [held.start_m, held.target_m, held.moved_m].into_iter().for_each(|v| undo.push_vector(v));
        }
        undo.push_place(self.constraint_forces_n.len());
        self.constraint_forces_n.iter().for_each(|f| undo.push_vector(*f));
        undo.push_place(self.loads.loaded().len());
        for &node in self.loads.loaded() {
            undo.places.push(node.0);
            undo.push_vector(self.loads.on_n(node.index()));
        }
    }

    fn save_tet(&self, tet: TetId, undo: &mut ModelUndo) {
        let nodes = self.rest.tetrahedra[tet.index()];
        undo.places.push(tet.0);
        self.stability.save_tet(tet, nodes, undo);
        for node in nodes {
            let NodeMass { mass_kg, added_kg, n_tets } = self.kernel.node_mass(node);
            undo.numbers.extend_from_slice(&[mass_kg, added_kg]);
            undo.places.push(n_tets);
        }
    }

    pub(super) fn put_edit_back(&mut self, undo: &ModelUndo) {
        let mut from = undo.reader();
        self.release();
        self.loads.clear(&mut self.kernel);
        let n_history = from.place();
        let history = from.numbers(n_history);
        self.loads.gravity_m_per_s2 = from.vector();
        self.report = undo.report;
        let constraints = self.read_constraints(&mut from);

        let (n_nodes, n_tets) = self.shrink(&mut from);
        let has_moved = self.put_nodes_back(&mut from);
        self.is_cut = from.place() == 1;
        let n_scaled_before = self.stability.put_back(&mut from, n_nodes, n_tets);
        self.put_tets_back(&mut from, has_moved);
        if !self.is_cut {
            self.stability.scaling.reset(&mut self.kernel);
        }
        self.stability.scaling.n_nodes = n_scaled_before;

        self.put_history_back(history);
        let per_step = 1.0 / self.kernel.last_step_s().unwrap_or(self.time_step_s);
        let increments_m = history[3 * n_nodes..6 * n_nodes].as_chunks::<3>().0;
        let rest_m = &self.rest.positions_m;
        self.positions_m.clear();
        self.positions_m.extend(rest_m.iter().zip(&self.displacements_m).map(|(rest_m, u_m)| *rest_m + *u_m));
        self.velocities_m_per_s.clear();
        self.velocities_m_per_s.extend(increments_m.iter().map(|xyz| DVec3::from_array(*xyz) * per_step));
        self.hold_and_load(&constraints);
        self.loads.refresh_all(&mut self.kernel);
    }

    fn read_constraints<'a>(&mut self, from: &mut UndoReader<'a>) -> SavedConstraints<'a> {
        let n_held = from.place();
        let (held, held_m) = (from.places(2 * n_held), from.numbers(9 * n_held));
        let n_forces = from.place();
        let forces_n = from.numbers(3 * n_forces);
        let n_loaded = from.place();
        let loaded = from.places(n_loaded);
        SavedConstraints { held, held_m, forces_n, loaded, loads_n: from.numbers(3 * n_loaded) }
    }

    fn hold_and_load(&mut self, saved: &SavedConstraints<'_>) {
        let vector = |numbers: &[f64], i: usize| DVec3::from_slice(&numbers[3 * i..3 * i + 3]);
        for (h, ids) in saved.held.as_chunks::<2>().0.iter().enumerate() {
            let [start_m, target_m, moved_m] = [0, 1, 2].map(|i| vector(saved.held_m, 3 * h + i));
            let node = NodeId(ids[1]);
            self.held.try_push(Held { place: ids[0] as usize, node, start_m, target_m, moved_m });
            self.kernel.hold_axes(node, [true; 3]);
        }
        self.constraint_forces_n.clear();
        self.constraint_forces_n
            .extend(saved.forces_n.as_chunks::<3>().0.iter().map(|f| DVec3::from_array(*f)));
        for (i, &node) in saved.loaded.iter().enumerate() {
            self.loads.put_back(NodeId(node), vector(saved.loads_n, i));
        }
    }

    /// Numbers of nodes and tetrahedra from before, to which everything is brought back.
    fn shrink(&mut self, from: &mut UndoReader<'_>) -> (usize, usize) {
        let [n_nodes, n_tets, n_added, grew] = [0; 4].map(|_| from.place());
        if grew == 1 {
            let parts = from.places(3 * self.kernel.n_parts());
            let parts = parts.as_chunks::<3>().0.iter().map(|counts| counts.map(|n| n as usize));
            self.kernel.shrink(&KernelCounts { n_nodes, n_tets, n_added }, parts);
            self.rest.truncate(n_nodes, n_tets);
            self.supports.truncate(n_nodes);
            self.substance.truncate(n_tets);
        }
        (n_nodes, n_tets)
    }

    fn put_nodes_back(&mut self, from: &mut UndoReader<'_>) -> bool {
        let n_moved = from.place();
        for node in from.places(n_moved) {
            self.rest.positions_m[*node as usize] = from.vector();
        }
        self.loads.grow(&self.rest.positions_m);
        n_moved > 0
    }

    /// Tetrahedra get their shapes and lanes back, in the opposite order, and their nodes what they weighed.
    fn put_tets_back(&mut self, from: &mut UndoReader<'_>, has_moved: bool) {
        let (law, path) = (self.kernel.law(), self.kernel.path());
        let Self { kernel, substance, rest, stability, .. } = self;
        let (params, extras) = (substance.kernel_params(rest, law, path), substance.extras());
        let n_reshaped = from.place();
        let of_reshaped = from.places(n_reshaped * PLACES_OF_TET);
        let n_removed = from.place();
        let of_removed = from.places(n_removed * PLACES_OF_TET);
        if has_moved {
            for of_tet in of_reshaped.as_chunks::<PLACES_OF_TET>().0 {
                kernel.reshape_tet(&params, &extras, TetId(of_tet[0]));
            }
        }
        for of_tet in of_removed.as_chunks::<PLACES_OF_TET>().0.iter().rev() {
            kernel.put_back_tet(&params, &extras, TetId(of_tet[0]));
        }
        for of_tet in of_reshaped.as_chunks::<PLACES_OF_TET>().0.iter().chain(of_removed.as_chunks().0) {
            let [tet, n_scaled @ .., a, b, c, d] = *of_tet;
            let tet = TetId(tet);
            let nodes = rest.tetrahedra[tet.index()];
            stability.put_tet_back(tet, nodes, n_scaled, from);
            for (node, n_tets) in nodes.into_iter().zip([a, b, c, d]) {
                let [mass_kg, added_kg] = [from.number(), from.number()];
                kernel.set_node_mass(node, &NodeMass { mass_kg, added_kg, n_tets });
                stability.scaling.set_added_kg(node, added_kg);
            }
        }
    }
}

/// Enough for what most edits keep beside the state.
const NUMBERS_BESIDE_STATE: usize = 4096;

/// Id, four counts of scaled tetrahedra and four of tetrahedra.
const PLACES_OF_TET: usize = 9;

/// What the outside did.
struct SavedConstraints<'a> {
    held: &'a [u32],
    held_m: &'a [f64],
    forces_n: &'a [f64],
    loaded: &'a [u32],
    loads_n: &'a [f64],
}
