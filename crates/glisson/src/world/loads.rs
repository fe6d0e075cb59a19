//! The loads of a scene in time: which nodal forces and which gravity a step has.

use super::organ::{Organ, put_back};
use super::spec::{ForceField, Load, LoadTime, WorldSpec};
use crate::math::DVec3;
use crate::mesh::NodeId;
use crate::mesh::edit::TopologyChange;
use crate::mesh::remap::EntityArray;
use crate::model::NodalForce;
use crate::model::bounded_vec::BoundedVec;

/// The nodes of a load and the force on each.
#[derive(Clone, Debug)]
struct NodeLoad {
    is_loaded: EntityArray<NodeId, bool>,
    force_n: DVec3,
    time: LoadTime,
    acts: bool,
}

/// What an edit overwrites of the loads.
#[derive(Clone, Debug, Default)]
pub(super) struct LoadsBefore {
    /// Whether each node that was removed was loaded, one load after the other.
    is_loaded: Vec<bool>,
    forces: Vec<NodalForce>,
    is_stale: bool,
}

/// All loads of a world. What they amount to is found anew only in a step in which one begins or ends.
#[derive(Clone, Debug)]
pub(super) struct Loads {
    nodes: Vec<NodeLoad>,
    fields: Vec<ForceField>,
    time_step_s: f64,
    /// Step from which times count.
    start: u64,
    forces: BoundedVec<NodalForce>,
    is_stale: bool,
}

impl Loads {
    /// Loads act on the nodes of the surface that are not held along every axis.
    pub(super) fn new(spec: &WorldSpec, organ: &Organ) -> Self {
        let rest_m = &organ.mesh().positions_m;
        let mut can_be_loaded = vec![false; rest_m.len()];
        for &node in organ.surface_nodes() {
            can_be_loaded[node.index()] = !organ.is_fixed(node);
        }
        let of_nodes = |(load, mut nodes): (Load, Vec<NodeId>)| {
            nodes.retain(|node| can_be_loaded[node.index()]);
            let mut is_loaded = vec![false; rest_m.len()];
            for node in &nodes {
                is_loaded[node.index()] = true;
            }
            let force_n = load.force_n / nodes.len().max(1) as f64;
            NodeLoad { is_loaded: EntityArray::new(is_loaded), force_n, time: load.time, acts: false }
        };
        let nodes: Vec<NodeLoad> = spec.loaded_nodes(rest_m).into_iter().map(of_nodes).collect();
        let n_most = if nodes.is_empty() { 0 } else { rest_m.len() };
        Self {
            nodes,
            fields: spec.fields.clone(),
            time_step_s: spec.time_step_s,
            start: 0,
            forces: BoundedVec::with_capacity(n_most),
            is_stale: true,
        }
    }

    /// Whether any load is on a node.
    pub(super) fn has(&self, node: NodeId) -> bool {
        self.nodes.iter().any(|load| load.is_loaded[node])
    }

    fn n_nodes(&self) -> usize {
        self.nodes.first().map_or(0, |load| load.is_loaded.as_slice().len())
    }

    /// What the loads of the next steps depend on: how long they have run, if there are any in time.
    pub(super) fn clock(&self, step: u64) -> Option<f64> {
        let is_timed = !(self.nodes.is_empty() && self.fields.is_empty());
        is_timed.then(|| (step - self.start) as f64)
    }

    /// Whether some load or force field begins or ends at a time.
    pub(super) fn are_timed(&self) -> bool {
        let times = self.nodes.iter().map(|load| load.time).chain(self.fields.iter().map(|field| field.time));
        times.into_iter().any(|time| time != LoadTime::Always)
    }

    /// Another time step from the next step on; none of the loads is timed.
    pub(super) fn set_time_step(&mut self, time_step_s: f64) {
        self.time_step_s = time_step_s;
    }

    /// Times count from `step` on.
    pub(super) fn restart(&mut self, step: u64) {
        self.start = step;
    }

    /// After an edit of the mesh.
    pub(super) fn follow(&mut self, change: &TopologyChange, before: &mut LoadsBefore) {
        before.forces.clear();
        before.forces.extend_from_slice(&self.forces);
        before.is_stale = self.is_stale;
        before.is_loaded.clear();
        for load in &mut self.nodes {
            let removed = change.nodes.removed.iter();
            before.is_loaded.extend(removed.map(|n| n.index() < change.nodes.n_before && load.is_loaded[*n]));
            load.is_loaded.follow(change);
            // What is left without a tetrahedron has nothing to push.
            for node in change.nodes.removed.iter().filter(|_| !change.is_renumbering()) {
                load.is_loaded.as_mut_slice()[node.index()] = false;
            }
        }
        let n_nodes = self.n_nodes();
        self.forces.clear();
        self.forces.reserve(n_nodes);
        self.is_stale = true;
    }

    /// Undoes the last edit.
    pub(super) fn undo(&mut self, change: &TopologyChange, before: &LoadsBefore) {
        let n_removed = change.nodes.removed.len();
        for (i, load) in self.nodes.iter_mut().enumerate() {
            let of_load = &before.is_loaded[i * n_removed..(i + 1) * n_removed];
            put_back(&mut load.is_loaded, change, of_load.iter().copied());
        }
        self.forces.clear();
        self.is_stale = true;
    }

    /// The edit that was just undone is not to be seen.
    pub(super) fn forget_edit(&mut self, before: &LoadsBefore) {
        self.forces.extend_from_slice(&before.forces);
        self.is_stale = before.is_stale;
    }

    /// The nodal forces of a step, ascending by node. Allocates nothing.
    pub(super) fn forces_in_step(&mut self, step: u64) -> &[NodalForce] {
        let step = step - self.start;
        for load in &mut self.nodes {
            let acts = load.time.acts_in_step(step, self.time_step_s);
            self.is_stale |= acts != load.acts;
            load.acts = acts;
        }
        if std::mem::take(&mut self.is_stale) {
            self.gather();
        }
        &self.forces
    }

    /// Those of the last step, none after an edit.
    pub(super) fn forces(&self) -> &[NodalForce] {
        &self.forces
    }

    fn gather(&mut self) {
        self.forces.clear();
        for n in 0..self.n_nodes() {
            let on_node = self.nodes.iter().filter(|load| load.acts && load.is_loaded.as_slice()[n]);
            let (n_loads, force_n) = on_node.fold((0, DVec3::ZERO), |(i, f), load| (i + 1, f + load.force_n));
            if n_loads > 0 {
                self.forces.push(NodalForce { node: NodeId::from_index(n), force_n });
            }
        }
    }

    /// What the force fields of a step add to gravity [m/s2].
    pub(super) fn acceleration_in_step_m_per_s2(&self, step: u64) -> DVec3 {
        let acting = self.fields.iter().filter(|f| f.time.acts_in_step(step - self.start, self.time_step_s));
        acting.map(|f| f.acceleration_m_per_s2).sum()
    }
}
