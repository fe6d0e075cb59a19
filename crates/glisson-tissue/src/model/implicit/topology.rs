//! Edits: the element list and masses are rebuilt, the factor follows ([`super::successor`]).

use super::elements::{Elements, ElementsParams, Recovery};
use super::ligaments::Ligaments;
use super::newton::Scratch;
use super::successor::Successor;
use super::{Attachment, FactorAge, ImplicitEuler, ImplicitLaw, TopologyRefusal};
use crate::model::topology_update::{TopologyUpdate, blend_tets};
use glisson_mesh::fault;
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::remap::follow;
use glisson_mesh::mesh::{NodeId, TetMesh};

const NAME: &str = "implicit";

fn refused(reason: &'static str) -> TopologyRefusal {
    TopologyRefusal::Frozen { model: NAME, reason }
}

impl ImplicitEuler {
    /// Follows all edits; all allocate. A refused edit leaves the model half changed: undo copies the whole model.
    pub(super) fn follow(&mut self, mesh: &TetMesh, change: &TopologyChange) -> Result<(), TopologyRefusal> {
        TopologyRefusal::of_other_mesh(NAME, change, [self.tet_is_live.len(), self.n_nodes()])?;
        self.steadying.clear(&mut self.scratch.ligament_n);
        let live = self.mesh.tetrahedra.iter().enumerate().filter(|(t, _)| self.tet_is_live[*t]);
        let growth = TopologyUpdate::of(NAME, mesh, change, &self.mesh.positions_m, live)?;
        if let Some(growth) = &growth {
            self.grow(mesh, change, growth);
        }
        for tet in change.tets.removed.iter().filter(|tet| tet.index() < change.tets.n_before) {
            self.tet_is_live[tet.index()] = false;
        }
        if change.is_renumbering() {
            self.compact(change);
        }
        let before = self.elements.recovery();
        let elements = Elements::new(&ElementsParams {
            mesh: &self.mesh,
            live: &self.tet_is_live,
            law: &self.law,
            stand_ins: &self.stand_ins,
            volume: self.volume,
            rest_stress_pa: &self.rest_stress_pa,
            is_viscous: self.relaxation.is_some(),
            known: (change.moved_nodes.is_empty() && !change.is_renumbering()).then_some(&self.elements),
        });
        fault::check("implicit: elements")?;
        self.elements = elements
            .map_err(|_| refused("a tetrahedron that is left cannot bear the law; undo the last edit"))?;
        self.is_suspect = true;
        // Parts of what is upright are upright; the next step looks.
        if before != Recovery::None || !change.moved_nodes.is_empty() {
            self.elements.quarantine(&self.displacement_m, before);
        }
        self.n_reanalyses += 1;
        fault::check("implicit: factor")?;
        if self.lagged.is_some() && !self.elements.tets().is_empty() && !change.is_renumbering() {
            self.serve_on(change);
        } else {
            self.analyse()
                .map_err(|_| refused("the remaining mesh could not be factored; build the model anew"))?;
        }
        // A held or loaded node that lost its last tetrahedron is released.
        for n in 0..self.n_nodes() {
            if !self.moves[n] {
                self.is_held[n] = false;
                self.outer_n[n] = DVec3::ZERO;
                self.velocities_m_per_s[n] = DVec3::ZERO;
                self.earlier_velocities_m_per_s[n] = DVec3::ZERO;
            }
        }
        let is_held = &self.is_held;
        self.held.retain(|held| is_held[held.node as usize]);
        self.update_mask();
        self.publish();
        Ok(())
    }

    /// The old factor goes on to serve, and its successor begins.
    fn serve_on(&mut self, change: &TopologyChange) {
        self.weigh();
        let mut now = self.lagged_state(self.time_step_s);
        let Some(mut lagged) = self.lagged.take() else { return };
        now.per_mass = lagged.state.per_mass;
        now.per_stiffness = lagged.state.per_stiffness;
        now.viscous_share = lagged.state.viscous_share;
        let changed = change.tets.removed.iter().copied().chain(change.tets.added.iter().map(|(tet, _)| tet));
        let of_changed = changed.flat_map(|tet| self.mesh.tetrahedra[tet.index()]);
        let moved = change.moved_nodes.iter().copied();
        lagged.serve_on(of_changed.chain(moved), &self.elements, self.node_terms(), &now);
        self.lagged = Some(lagged);
        self.successor = Some(Successor::default());
        self.has_fallen_back = false;
        self.factor_version += 1;
        self.age = FactorAge::default();
    }

    /// All of it before an edit. What stays behind has the same factor, for solutions alone; the edit begins a new successor, so the
    /// present one goes too.
    pub(super) fn before_edit(&mut self) -> Self {
        let lagged = self.lagged.take();
        let successor = self.successor.take();
        let mut before = self.clone();
        before.successor = successor;
        before.lagged = lagged;
        self.lagged = before.lagged.as_mut().map(|lagged| {
            let whole = lagged.retire();
            std::mem::replace(lagged, whole)
        });
        before
    }

    /// Grows the lists for an edit, and places new and moved nodes.
    fn grow(&mut self, mesh: &TetMesh, change: &TopologyChange, growth: &TopologyUpdate) {
        let (n_before, n_nodes) = (change.nodes.n_before, growth.n_nodes);
        let axes = |free: DVec3| free.to_array().map(|free| free == 0.0);
        let new_supports = growth.new_supports(|n| axes(self.free_axes[n]));
        self.free_axes.resize(n_nodes, DVec3::ONE);
        for (n, held) in new_supports {
            self.free_axes[n] = DVec3::from_array(held.map(|held| if held { 0.0 } else { 1.0 }));
        }
        let supports = |n: usize| axes(self.free_axes[n]);
        let placed = growth.displacements_m(|n| self.displacement_m[n], supports);
        for velocities in [&mut self.velocities_m_per_s, &mut self.earlier_velocities_m_per_s] {
            let of_new = growth.velocities(|n| velocities[n], supports);
            velocities.resize(n_nodes, DVec3::ZERO);
            of_new.into_iter().for_each(|(n, v)| velocities[n] = v);
        }
        self.displacement_m.resize(n_nodes, DVec3::ZERO);
        placed.into_iter().for_each(|(n, u_m)| self.displacement_m[n] = u_m);
        for held in self.held.iter_mut() {
            // A tool keeps holding a moved node at its position in space.
            let n = held.node as usize;
            held.target_m -= (mesh.positions_m[n] - self.mesh.positions_m[n]) * self.free_axes[n];
        }
        if let Some(relaxation) = &mut self.relaxation {
            relaxation.grow(change);
        }
        for node in change.moved_nodes.iter().filter(|node| node.index() < n_before) {
            self.mesh.positions_m[node.index()] = mesh.positions_m[node.index()];
        }
        self.mesh.grow_to(mesh);
        self.tet_is_live.resize(growth.n_tets, false);
        growth.added.iter().for_each(|tet| self.tet_is_live[tet.index()] = true);
        blend_tets(&mut self.rest_stress_pa, change);
        match &mut self.law {
            ImplicitLaw::NeoHookeLogOfEach(laws) => growth.take_over(laws),
            ImplicitLaw::StableNeoHookeOfEach(laws) => growth.take_over(laws),
            ImplicitLaw::General(laws) if laws.len() > 1 => growth.take_over(laws),
            ImplicitLaw::NeoHookeLog(_) | ImplicitLaw::StableNeoHooke(_) | ImplicitLaw::General(_) => {}
        }
        if self.stand_ins.len() > 1 {
            growth.take_over(&mut self.stand_ins);
        }
        self.positions_m.resize(n_nodes, DVec3::ZERO);
        self.outer_n.resize(n_nodes, DVec3::ZERO);
        self.is_held.resize(n_nodes, false);
        self.mask.resize(n_nodes, DVec3::ZERO);
        self.held.make_room(n_nodes);
        self.constraint_forces_n.make_room(n_nodes);
        self.scratch = Scratch::new(n_nodes);
    }

    /// Drops dead entities; the others keep their order. Constraints are dropped, because their node numbers change.
    fn compact(&mut self, change: &TopologyChange) {
        self.release_all();
        follow::<NodeId, DVec3>(&mut self.mesh.positions_m, change);
        follow::<NodeId, DVec3>(&mut self.displacement_m, change);
        follow::<NodeId, DVec3>(&mut self.velocities_m_per_s, change);
        follow::<NodeId, DVec3>(&mut self.earlier_velocities_m_per_s, change);
        follow::<NodeId, DVec3>(&mut self.free_axes, change);
        self.ligaments = Ligaments::new(
            self.ligaments
                .list
                .iter()
                .filter_map(|l| change.nodes.new_ids[l.node.index()].map(|node| Attachment { node, ..*l }))
                .collect(),
        );
        let n_nodes = self.mesh.positions_m.len();
        let live = &self.tet_is_live;
        keep_live(&mut self.mesh.tetrahedra, live);
        keep_live(&mut self.mesh.shares, live);
        keep_live(&mut self.rest_stress_pa, live);
        match &mut self.law {
            ImplicitLaw::NeoHookeLogOfEach(laws) => keep_live(laws, live),
            ImplicitLaw::StableNeoHookeOfEach(laws) => keep_live(laws, live),
            ImplicitLaw::General(laws) if laws.len() > 1 => keep_live(laws, live),
            ImplicitLaw::NeoHookeLog(_) | ImplicitLaw::StableNeoHooke(_) | ImplicitLaw::General(_) => {}
        }
        if self.stand_ins.len() > 1 {
            keep_live(&mut self.stand_ins, live);
        }
        if let Some(relaxation) = &mut self.relaxation {
            keep_live(&mut relaxation.histories, live);
        }
        for node in self.mesh.tetrahedra.iter_mut().flatten() {
            *node = change.nodes.new_ids[node.index()].expect("what is live has live nodes");
        }
        self.tet_is_live = vec![true; self.mesh.tetrahedra.len()];
        self.positions_m = self.mesh.positions_m.clone();
        self.outer_n = vec![DVec3::ZERO; n_nodes];
        self.is_held = vec![false; n_nodes];
        self.mask = vec![DVec3::ZERO; n_nodes];
        self.scratch = Scratch::new(n_nodes);
    }
}

/// Keeps the values of live tetrahedra; an empty list stays empty.
fn keep_live<T>(list: &mut Vec<T>, live: &[bool]) {
    let mut live = live.iter();
    list.retain(|_| *live.next().expect("one flag a tetrahedron"));
}
