//! Removals and compactions.

use super::{ExplicitKernel, quarantine_of};
use crate::math::DVec3;
use crate::mesh::edit::TopologyChange;
use crate::mesh::{NodeId, TetId};
use crate::model::explicit::keep;
use crate::model::kernel::FastKernel;

impl ExplicitKernel {
    pub(super) fn remove_tet(&mut self, tet: TetId) {
        let Self { kernel, stability, rest, loads, .. } = self;
        if !std::mem::replace(&mut self.is_cut, true) {
            stability.scaling.apply(rest, kernel);
        }
        kernel.remove_tet(rest, tet);
        stability.scaling.remove_tet(rest, tet, kernel);
        let n_nodes = rest.positions_m.len();
        for node in rest.tetrahedra[tet.index()] {
            loads.refresh(kernel, node);
            if !kernel.has_tets(node) {
                self.history[n_nodes + node.index()] = [0.0; 3];
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
        for node in self.rest.tetrahedra.iter_mut().flatten() {
            *node = new_nodes[node.index()].expect("what is live has live nodes");
        }
        keep(&mut self.rest.positions_m, &stays);
        let (law, path) = (self.kernel.law(), self.kernel.path());
        let mut kernel = if self.rest.tetrahedra.is_empty() {
            FastKernel::empty(law, path)
        } else {
            self.substance.kernel(&self.rest, law, path).expect("a part of a sound mesh is sound")
        };
        kernel.set_quarantine(quarantine_of(law));
        kernel.set_calm_stretch(self.kernel.calm_stretch());
        kernel.set_history(&memory);
        kernel.set_stiffness_damping(self.damping.stiffness_s);
        kernel.set_last_step_s(self.kernel.last_step_s());
        for (n, new) in new_nodes.iter().enumerate() {
            let (old, Some(new)) = (NodeId::from_index(n), *new) else { continue };
            kernel.set_displacement(new, self.kernel.displacement_m(old));
            kernel.set_increment(new, self.kernel.increment_m(old));
        }
        self.kernel = kernel;
        keep(&mut self.supports, &stays);
        keep(&mut self.positions_m, &stays);
        keep(&mut self.velocities_m_per_s, &stays);
        let stays_twice: Vec<bool> = stays.iter().chain(&stays).chain(&[true]).copied().collect();
        self.history.truncate(stays_twice.len());
        keep(&mut self.history, &stays_twice);
        self.history.resize(self.history.len() + memory.len() / 3, [0.0; 3]);
        self.stability.scaling = self.stability.scaling.renumbered(&new_tets, self.positions_m.len());
        if self.is_cut {
            self.stability.scaling.apply(&self.rest, &mut self.kernel);
        }
        self.loads = self.loads.renumbered(&new_nodes, &self.rest.positions_m);
        self.hold_supports();
        self.loads.refresh_all(&mut self.kernel);
        self.publish();
        self.report.n_reanalyses += 1;
    }
}

/// The maps of a compaction; without one every id stays.
fn or_same<I: Copy>(new_ids: &[Option<I>], n: usize, id: impl Fn(usize) -> I) -> Vec<Option<I>> {
    if new_ids.is_empty() { (0..n).map(|i| Some(id(i))).collect() } else { new_ids.to_vec() }
}
