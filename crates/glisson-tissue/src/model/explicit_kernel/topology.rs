//! Removals, additions and compactions.

use super::{ExplicitKernel, quarantine_of};
use crate::model::explicit::keep;
use crate::model::kernel::FastKernel;
use crate::model::topology_update::TopologyUpdate;
use crate::solve::P1Gradients;
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};

impl ExplicitKernel {
    pub(super) fn remove_tet(&mut self, tet: TetId) {
        let Self { kernel, stability, rest, loads, .. } = self;
        if !std::mem::replace(&mut self.is_cut, true) {
            stability.scaling.apply(rest, kernel);
        }
        kernel.remove_tet(rest, tet);
        stability.scaling.remove_tet(rest, tet, kernel);
        for node in rest.tetrahedra[tet.index()] {
            loads.refresh(kernel, node);
            if !kernel.has_tets(node) {
                self.velocities_m_per_s[node.index()] = DVec3::ZERO;
            }
        }
    }

    /// Builds the kernel anew from what is left; the order of nodes and tetrahedra stays. Constraints are dropped
    /// with their node numbers.
    pub(super) fn compact(&mut self, change: &TopologyChange) {
        self.release();
        self.loads.clear(&mut self.kernel);
        self.constraint_forces_n.clear();
        let n_before = self.rest.positions_m.len();
        let new_nodes = or_same(&change.nodes.new_ids, n_before, NodeId::from_index);
        let new_tets = or_same(&change.tets.new_ids, self.rest.tetrahedra.len(), TetId::from_index);
        let stays: Vec<bool> = new_nodes.iter().map(Option::is_some).collect();
        let tet_stays: Vec<bool> = new_tets.iter().map(Option::is_some).collect();
        let mut memory = vec![0.0; self.kernel.history_len()];
        self.kernel.history_into(&mut memory);
        let numbers_of_tet = memory.len() / self.rest.tetrahedra.len();
        let memory_stays: Vec<bool> =
            tet_stays.iter().flat_map(|&stays| std::iter::repeat_n(stays, numbers_of_tet)).collect();
        keep(&mut memory, &memory_stays);
        self.substance.keep(&tet_stays);
        keep(&mut self.rest.tetrahedra, &tet_stays);
        if !self.rest.shares.is_empty() {
            keep(&mut self.rest.shares, &tet_stays);
        }
        for node in self.rest.tetrahedra.iter_mut().flatten() {
            *node = new_nodes[node.index()].expect("what is live has live nodes");
        }
        keep(&mut self.rest.positions_m, &stays);
        let is_live = vec![true; self.rest.tetrahedra.len()];
        let mut kernel = self.laid_out_anew(&is_live, &memory);
        for (n, new) in new_nodes.iter().enumerate() {
            let (old, Some(new)) = (NodeId::from_index(n), *new) else { continue };
            kernel.set_displacement(new, self.kernel.displacement_m(old));
            kernel.set_increment(new, self.kernel.increment_m(old));
        }
        self.kernel = kernel;
        keep(&mut self.supports, &stays);
        keep(&mut self.positions_m, &stays);
        keep(&mut self.velocities_m_per_s, &stays);
        keep(&mut self.displacements_m, &stays);
        self.stability.compact(&new_nodes, &new_tets);
        if self.is_cut {
            self.stability.scaling.apply(&self.rest, &mut self.kernel);
        }
        self.loads = self.loads.renumbered(&new_nodes, &self.rest.positions_m);
        self.stability.measure(&self.rest, &self.substance, &self.kernel);
        self.hold_supports();
        self.loads.refresh_all(&mut self.kernel);
        self.publish();
        self.report.n_reanalyses += 1;
    }

    /// A kernel of the live tetrahedra at rest, with the memory of all.
    fn laid_out_anew(&self, is_live: &[bool], memory: &[f64]) -> FastKernel {
        let (law, path) = (self.kernel.law(), self.kernel.path());
        let mut kernel = if is_live.contains(&true) {
            let params = self.substance.kernel_params(&self.rest, law, path);
            FastKernel::of_live(&params, &self.substance.extras(), is_live)
                .expect("a part of a sound mesh is sound")
        } else {
            FastKernel::empty(law, path)
        };
        kernel.set_quarantine(quarantine_of(law));
        kernel.set_calm_stretch(self.kernel.calm_stretch());
        kernel.set_history(memory);
        kernel.set_stiffness_damping(self.damping.stiffness_s);
        kernel.set_last_step_s(self.kernel.last_step_s());
        kernel
    }

    /// Follows an edit that adds or moves something.
    pub(super) fn grow(&mut self, mesh: &TetMesh, change: &TopologyChange, growth: &TopologyUpdate) {
        let (n_before, n_nodes) = (change.nodes.n_before, growth.n_nodes);
        self.supports.resize(n_nodes, [false; 3]);
        for (n, axes) in growth.new_supports(|n| self.supports[n]) {
            self.supports[n] = axes;
        }
        let supports = |n: usize| self.supports[n];
        let increment_m = |n: usize| self.increment_m(NodeId::from_index(n));
        let placed = growth.displacements_m(|n| self.displacements_m[n], supports);
        let moving = growth.velocities(increment_m, supports);
        let memories = self.memories_of_new(change, growth);
        let removed = change.tets.removed.iter().filter(|tet| tet.index() < change.tets.n_before);
        let at_removed: Vec<(NodeId, DVec3)> = removed
            .flat_map(|tet| self.rest.tetrahedra[tet.index()])
            .map(|node| (node, increment_m(node.index())))
            .collect();
        let n_reanalyses = self.report.n_reanalyses;

        self.take_over_mesh(mesh, change, growth);
        for (tet, memory) in memories {
            self.kernel.set_tet_history(tet, &memory);
        }

        // What a node's last tetrahedron took along with it, unless others came in its place.
        for &(node, increment_m) in &at_removed {
            if self.kernel.has_tets(node) && !self.held.iter().any(|held| held.node == node) {
                self.kernel.set_increment(node, increment_m);
            }
        }
        for n in n_before..n_nodes {
            if self.supports[n] != [false; 3] {
                self.kernel.hold_axes(NodeId::from_index(n), self.supports[n]);
            }
        }
        self.make_room_for_state();
        for (n, u_m) in placed {
            self.kernel.set_displacement(NodeId::from_index(n), u_m);
            self.displacements_m[n] = u_m;
            self.positions_m[n] = self.rest.positions_m[n] + u_m;
        }
        for (n, increment_m) in moving {
            self.kernel.set_increment(NodeId::from_index(n), increment_m);
        }
        self.stability.measure(&self.rest, &self.substance, &self.kernel);
        self.loads.grow(&self.rest.positions_m);
        if self.report.n_reanalyses == n_reanalyses {
            self.publish_changed(growth, &at_removed);
        } else {
            self.loads.refresh_all(&mut self.kernel);
            self.publish();
        }
    }

    /// Brings mesh at rest, kernel, substance and stable step from before an edit to after it.
    fn take_over_mesh(&mut self, mesh: &TetMesh, change: &TopologyChange, growth: &TopologyUpdate) {
        let n_before = change.nodes.n_before;
        if !std::mem::replace(&mut self.is_cut, true) {
            self.stability.scaling.apply(&self.rest, &mut self.kernel);
        }
        for &tet in &change.tets.removed {
            if tet.index() < change.tets.n_before && self.kernel.is_live(tet) {
                self.remove_tet(tet);
            }
        }
        for held in self.held.iter_mut() {
            // A tool goes on holding a moved node at its place in space.
            let n = held.node.index();
            let moved_m = mesh.positions_m[n] - self.rest.positions_m[n];
            held.start_m -= moved_m;
            held.target_m -= moved_m;
        }
        for tet in &growth.reshaped {
            self.stability.scaling.remove_tet(&self.rest, *tet, &mut self.kernel);
        }
        for node in change.moved_nodes.iter().filter(|node| node.index() < n_before) {
            self.rest.positions_m[node.index()] = mesh.positions_m[node.index()];
        }
        self.rest.grow_to(mesh);
        self.substance.grow(change, growth);
        self.stability.grow(change);
        self.add_tets(change, growth);
    }

    /// Loads and shown state of the nodes that an edit changed.
    fn publish_changed(&mut self, growth: &TopologyUpdate, at_removed: &[(NodeId, DVec3)]) {
        // Weight changes with the mass, and ligaments are as long as they are now.
        let attached = growth.attached().flat_map(|tet| self.rest.tetrahedra[tet.index()]);
        let removed = at_removed.iter().map(|(node, _)| *node);
        let mut changed: Vec<NodeId> = growth.placed_nodes().chain(attached).chain(removed).collect();
        changed.sort_unstable();
        changed.dedup();
        for &node in &changed {
            self.loads.refresh(&mut self.kernel, node);
        }
        self.loads.refresh_attachments(&mut self.kernel);
        self.publish_nodes(changed.into_iter());
    }

    /// Memory of relaxing stress of the new tetrahedra: that of their parents, for their volumes.
    fn memories_of_new(&self, change: &TopologyChange, growth: &TopologyUpdate) -> Vec<(TetId, Vec<f64>)> {
        if self.kernel.history_len() == 0 {
            return Vec::new();
        }
        let of_new = |tet: TetId, parents: &[(TetId, f64)], volume_m3: f64| {
            let mut memory = vec![0.0; self.kernel.history_len() / self.kernel.n_tets()];
            for &(parent, weight) in parents {
                let share = weight * volume_m3 / self.rest.tet_volume_m3(parent);
                let of_parent = self.kernel.tet_history(parent);
                memory.iter_mut().zip(of_parent).for_each(|(sum, number)| *sum += share * number);
            }
            (tet, memory)
        };
        let added = change.tets.added.iter().filter(|(tet, _)| growth.added.binary_search(tet).is_ok());
        added.map(|(tet, parents)| of_new(tet, parents, growth.volume_m3(tet))).collect()
    }

    /// Puts new and reshaped tetrahedra into the kernel, or lays it out anew where they do not fit.
    fn add_tets(&mut self, change: &TopologyChange, growth: &TopologyUpdate) {
        let (law, path) = (self.kernel.law(), self.kernel.path());
        let Self { kernel, substance, rest, .. } = self;
        let (params, extras) = (substance.kernel_params(rest, law, path), substance.extras());
        kernel.grow(growth.n_nodes, &extras, growth.n_tets);
        for &tet in &growth.reshaped {
            kernel.reshape_tet(&params, &extras, tet);
        }
        let fits = !kernel.is_outgrown_by(growth.added.len())
            && growth.added.iter().all(|&tet| kernel.add_tet(&params, &extras, tet, growth.source(tet)));
        if !fits {
            self.lay_out_anew(change, growth);
        }
        for tet in growth.attached() {
            let gradients = P1Gradients::in_mesh(&self.rest, tet);
            let at_rest = self.substance.stiffness_at_rest(tet, &gradients);
            self.stability.add_tet(&self.rest, tet, &at_rest, &mut self.kernel);
        }
    }

    fn lay_out_anew(&mut self, change: &TopologyChange, growth: &TopologyUpdate) {
        let n_before = change.nodes.n_before;
        let mut is_live: Vec<bool> =
            (0..growth.n_tets).map(|t| self.kernel.is_live(TetId::from_index(t))).collect();
        growth.added.iter().for_each(|tet| is_live[tet.index()] = true);
        let mut memory = vec![0.0; self.kernel.history_len()];
        self.kernel.history_into(&mut memory);
        let mut kernel = self.laid_out_anew(&is_live, &memory);
        for (n, &axes) in self.supports.iter().enumerate().take(n_before) {
            let node = NodeId::from_index(n);
            kernel.set_displacement(node, self.displacements_m[n]);
            kernel.hold_axes(node, axes);
            kernel.set_increment(node, self.increment_m(node));
            kernel.set_added_mass(node, self.stability.scaling.added_kg(node));
        }
        for held in self.held.iter() {
            kernel.hold_axes(held.node, [true; 3]);
        }
        self.kernel = kernel;
        self.report.n_reanalyses += 1;
    }

    /// Makes room for new nodes in the state.
    fn make_room_for_state(&mut self) {
        let n_nodes = self.rest.positions_m.len();
        self.displacements_m.resize(n_nodes, DVec3::ZERO);
        self.positions_m.extend_from_slice(&self.rest.positions_m[self.positions_m.len()..]);
        self.velocities_m_per_s.resize(n_nodes, DVec3::ZERO);
        self.held.make_room(n_nodes);
        self.constraint_forces_n.make_room(n_nodes);
    }
}

/// The maps of a compaction; without one every id stays.
fn or_same<I: Copy>(new_ids: &[Option<I>], n: usize, id: impl Fn(usize) -> I) -> Vec<Option<I>> {
    if new_ids.is_empty() { (0..n).map(|i| Some(id(i))).collect() } else { new_ids.to_vec() }
}
