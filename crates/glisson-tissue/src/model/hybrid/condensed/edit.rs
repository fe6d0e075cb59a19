//! Cuts: zones that become dynamic, tensors that are subtracted, pieces that come loose.

use super::super::NAME;
use super::dynamic::DynamicPart;
use super::{CondensedHybrid, Place, ZoneLaw};
use crate::material::contraction;
use crate::model::TopologyRefusal;
use crate::model::explicit::keep;
use crate::model::tet_law::TetLaw;
use crate::model::topology_update::{TopologyUpdate, blend_tets};
use crate::solve::{BoundaryConditions, MeshEdges, P1Gradients, SolveError};
use glisson_mesh::fault;
use glisson_mesh::math::{DMat3, DVec3, outer};
use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};

const NO_STABLE_MOTION: TopologyRefusal = TopologyRefusal::Frozen {
    model: NAME,
    reason: "what is left has no stable motion; switch to tensor_mass",
};

impl CondensedHybrid {
    /// Follows an edit. Zones that it changes become dynamic. After the checks of [`TopologyUpdate::of`], with which nothing has
    /// changed yet, nothing that a built body can lead to is refused (see `bring_together_again`).
    pub(super) fn follow_change(
        &mut self,
        mesh: &TetMesh,
        change: &TopologyChange,
    ) -> Result<(), TopologyRefusal> {
        TopologyRefusal::of_other_mesh(NAME, change, [self.is_live.len(), self.positions_m.len()])?;
        let live = self.mesh.tetrahedra.iter().enumerate().filter(|(t, _)| self.is_live[*t]);
        let growth = TopologyUpdate::of(NAME, mesh, change, &self.mesh.positions_m, live)?;
        let removed = &change.tets.removed[..];
        let strands = |dynamic: &DynamicPart| growth.is_none() && dynamic.would_strand(removed);
        let mut is_new = self.dynamic.as_ref().is_some_and(strands);
        let mut is_cut = false;
        if let Some(growth) = &growth {
            // What is shown now, for the numbers that there are now.
            self.catch_up();
            growth.reshaped.iter().for_each(|tet| is_new |= self.set_in_motion(tet.index()));
            is_new |= self.grow(mesh, change, growth);
        }
        for t in removed.iter().map(|t| t.index()) {
            if std::mem::take(&mut self.is_live[t]) {
                is_cut = true;
                is_new |= self.set_in_motion(t);
            }
        }
        let pieces = &change.pieces;
        let may_be_loose = !(pieces.through_faces.is_settled() && pieces.through_nodes.is_settled());
        if (is_cut || growth.is_some()) && (is_new || may_be_loose) && !self.zones.is_empty() {
            is_new |= self.let_go();
        }
        if growth.is_some() && !is_new {
            self.find_dynamic_nodes();
            is_new = !self.has_its_frontier();
        }
        if is_new {
            self.bring_together_again()?;
            fault::check("hybrid: after the zones were brought together")?;
        } else if growth.is_some() {
            self.make_dynamic_part_again()?;
            fault::check("hybrid: after the zones were brought together")?;
        } else if is_cut && let Some(mut dynamic) = self.dynamic.take() {
            removed.iter().for_each(|&t| dynamic.remove_tet(t, &self.whole()));
            dynamic.after_removals();
            self.dynamic = Some(dynamic);
        }
        if change.is_renumbering() {
            self.renumber(change);
        }
        Ok(())
    }

    /// Makes the zone of a tetrahedron dynamic; whether it was not.
    fn set_in_motion(&mut self, tet: usize) -> bool {
        self.set_zone_in_motion(self.zone_of_tet[tet] as usize)
    }

    fn set_zone_in_motion(&mut self, zone: usize) -> bool {
        let law = &mut self.laws[zone];
        let is_new = !law.is_dynamic();
        if is_new {
            *law = self.cut_law;
        }
        is_new
    }

    /// Takes in what an edit brings, and moves what it moves. New tetrahedra belong to the zones of those that they take after, and
    /// these become dynamic; so do zones inside which one of them ends. Whether a zone became dynamic.
    fn grow(&mut self, mesh: &TetMesh, change: &TopologyChange, growth: &TopologyUpdate) -> bool {
        let n_before = self.positions_m.len();
        self.held_axes.resize(growth.n_nodes, [false; 3]);
        for (n, axes) in growth.new_supports(|n| self.held_axes[n]) {
            self.held_axes[n] = axes;
        }
        let supports = |n: usize| self.held_axes[n];
        let displacement_m = |n: usize| self.positions_m[n] - self.mesh.positions_m[n];
        let displacements_m = growth.displacements_m(displacement_m, supports);
        let velocities = growth.velocities(|n| self.velocities_m_per_s[n], supports);
        // What is held stays where it is.
        for held in &mut self.constraints.displacements {
            if change.moved_nodes.binary_search(&held.node).is_ok() && held.node.index() < n_before {
                let n = held.node.index();
                held.displacement_m -= mesh.positions_m[n] - self.mesh.positions_m[n];
            }
        }
        for node in change.moved_nodes.iter().map(|node| node.index()).filter(|n| *n < n_before) {
            self.mesh.positions_m[node] = mesh.positions_m[node];
        }
        self.mesh.grow_to(mesh);
        self.positions_m.extend_from_slice(&mesh.positions_m[n_before..]);
        self.velocities_m_per_s.resize(growth.n_nodes, DVec3::ZERO);
        self.place.resize(growth.n_nodes, Place::Nowhere);
        for (n, u_m) in displacements_m {
            self.positions_m[n] = self.mesh.positions_m[n] + u_m;
        }
        for (n, velocity) in velocities {
            self.velocities_m_per_s[n] = velocity;
        }
        growth.take_over(&mut self.zone_of_tet);
        blend_tets(&mut self.rest_stress_pa, change);
        self.is_live.resize(growth.n_tets, false);
        let mut is_new = false;
        for tet in &growth.added {
            self.is_live[tet.index()] = true;
            is_new |= self.set_in_motion(tet.index());
        }
        for tet in growth.attached() {
            for node in self.mesh.tetrahedra[tet.index()] {
                if let Place::Own { zone, .. } = self.place[node.index()] {
                    is_new |= self.set_zone_in_motion(self.zone_numbers[zone as usize] as usize);
                }
            }
        }
        self.is_cut = true;
        self.dynamic_places.make_room(growth.n_nodes);
        self.loads.make_room(growth.n_nodes);
        self.constraint_forces_n.make_room(growth.n_nodes);
        self.make_room();
        is_new
    }

    /// Whether pre-computed zones border on the same dynamic nodes as when they were brought together.
    fn has_its_frontier(&self) -> bool {
        let mut nodes = self.interface.nodes.iter().enumerate();
        nodes.all(|(k, n)| self.is_dynamic[n.index()] == (k >= self.interface.n_condensed))
    }

    /// Makes the dynamic part anew between the zones as they are; dynamic nodes keep their state.
    fn make_dynamic_part_again(&mut self) -> Result<(), TopologyRefusal> {
        self.dynamic = self.dynamic_part(self.dynamic.as_ref()).map_err(|_| NO_STABLE_MOTION)?;
        self.find_places();
        self.go_on();
        Ok(())
    }

    /// Starts the dynamic nodes from where everything is, under the same constraints.
    fn go_on(&mut self) {
        if let Some(dynamic) = &mut self.dynamic {
            let velocities = Some(&self.velocities_m_per_s[..]);
            dynamic.start(&self.mesh.positions_m, &self.positions_m, velocities);
        }
        self.note_constraints();
    }

    /// Makes pre-computed zones dynamic that nothing holds any more; true if there were any.
    fn let_go(&mut self) -> bool {
        let mut is_new = false;
        loop {
            self.find_dynamic_nodes();
            let loose = self.unsupported_zones();
            for (zone, _) in &loose {
                self.laws[*zone as usize] = self.cut_law;
            }
            is_new |= !loose.is_empty();
            if loose.is_empty() {
                return is_new;
            }
        }
    }

    /// Rebuilds interface and dynamic part for the present laws; dynamic nodes keep their state.
    ///
    /// Where that fails, every zone becomes dynamic. This in turn fails only for faults of the body that
    /// [`CondensedHybrid::build`] refuses too (supports, ligaments, numbers, tetrahedra without volume), so not for a
    /// part of a body that was built. If it failed, the zones would be lost and the model would have to be replaced.
    fn bring_together_again(&mut self) -> Result<(), TopologyRefusal> {
        self.find_dynamic_nodes();
        let is_kept: Vec<bool> =
            self.zone_numbers.iter().map(|&z| self.laws[z as usize] == ZoneLaw::Precomputed).collect();
        // All zones, not only those that become dynamic here: below, every zone may have to.
        self.catch_up();
        self.slow_jumps_down();
        self.n_rebuilt += 1;
        let mut composed = self.interface.take_composed();
        keep(&mut composed, &is_kept);
        keep(&mut self.zones, &is_kept);
        keep(&mut self.ages, &is_kept);
        keep(&mut self.zone_numbers, &is_kept);
        fault::check("hybrid: before the zones are brought together")?;
        if self.bring_together(Some(&composed)).is_err() {
            // The tissue is held by so little that no equilibrium can be computed: make everything dynamic.
            let cut_law = self.cut_law;
            self.laws.iter_mut().filter(|law| !law.is_dynamic()).for_each(|law| *law = cut_law);
            self.zones.clear();
            self.zone_numbers.clear();
            self.find_dynamic_nodes();
            self.bring_together(Some(&Vec::new())).map_err(|_| NO_STABLE_MOTION)?;
        }
        self.go_on();
        Ok(())
    }

    /// Tissue without inertia jumps when jaws lose it or it is torn: in zones that become dynamic, velocities with which they would have
    /// more kinetic energy than elastic energy are lessened to as much.
    fn slow_jumps_down(&mut self) {
        let has_begun =
            |zone: u32| self.zone_numbers.contains(&zone) && self.laws[zone as usize].is_dynamic();
        let law = TetLaw::isotropic(&self.material);
        let (mut kinetic_j, mut elastic_j) = (0.0, 0.0);
        let mut nodes = Vec::new();
        for t in (0..self.is_live.len()).filter(|&t| self.is_live[t] && has_begun(self.zone_of_tet[t])) {
            let gradients = P1Gradients::in_mesh(&self.mesh, TetId::from_index(t));
            let corners = self.mesh.tetrahedra[t].map(NodeId::index);
            let mut gradient = DMat3::ZERO;
            for (n, alpha) in corners.into_iter().zip(gradients.alpha_per_m) {
                gradient += outer(self.positions_m[n] - self.mesh.positions_m[n], alpha);
                let corner_kg = self.density_kg_per_m3 * gradients.volume_m3 / 4.0;
                kinetic_j += 0.5 * corner_kg * self.velocities_m_per_s[n].length_squared();
            }
            let strain = (gradient + gradient.transpose()) * 0.5;
            elastic_j += 0.5 * gradients.volume_m3 * contraction(&law.stress_pa(strain), &strain);
            nodes.extend(corners.into_iter().filter(|n| !matches!(self.place[*n], Place::Dynamic(_))));
        }
        if kinetic_j > elastic_j {
            nodes.sort_unstable();
            nodes.dedup();
            let factor = (elastic_j / kinetic_j).sqrt();
            nodes.into_iter().for_each(|n| self.velocities_m_per_s[n] *= factor);
        }
    }

    /// Pre-computed zones that could move as rigid bodies, with the fault: those that neither supports nor dynamic nodes
    /// hold, and those of pieces that nothing holds.
    pub(super) fn unsupported_zones(&self) -> Vec<(u32, SolveError)> {
        let is_precomputed = |t: usize| self.law_of(t) == ZoneLaw::Precomputed;
        let is_tied = |n: NodeId| self.attachments.iter().any(|a| a.node == n);
        let among_zones = self.unsupported(
            |t| self.is_live[t] && is_precomputed(t),
            |n| if self.is_dynamic[n.index()] { [true; 3] } else { self.held_axes[n.index()] },
        );
        let among_all = self.unsupported(
            |t| self.is_live[t],
            |n| if is_tied(n) { [true; 3] } else { self.held_axes[n.index()] },
        );
        [among_zones, among_all].concat()
    }

    /// Pre-computed zones in those pieces of these tetrahedra that float with these axes of the nodes held.
    fn unsupported(
        &self,
        has: impl Fn(usize) -> bool,
        held: impl Fn(NodeId) -> [bool; 3],
    ) -> Vec<(u32, SolveError)> {
        let n_nodes = self.mesh.positions_m.len();
        let tets: Vec<usize> = (0..self.mesh.tetrahedra.len()).filter(|&t| has(t)).collect();
        let mut root: Vec<usize> = (0..n_nodes).collect();
        for &t in &tets {
            let nodes = self.mesh.tetrahedra[t].map(|n| find(&mut root, n.index()));
            let lowest = nodes.into_iter().min().unwrap_or(0);
            nodes.into_iter().for_each(|n| root[n] = lowest);
        }
        let mut of_piece: Vec<(usize, usize)> =
            tets.iter().map(|&t| (find(&mut root, self.mesh.tetrahedra[t][0].index()), t)).collect();
        of_piece.sort_unstable();
        let mut found = Vec::new();
        for piece in of_piece.chunk_by(|a, b| a.0 == b.0) {
            let is_precomputed = |t: usize| self.law_of(t) == ZoneLaw::Precomputed;
            let mut zones: Vec<u32> =
                piece.iter().filter(|p| is_precomputed(p.1)).map(|p| self.zone_of_tet[p.1]).collect();
            zones.sort_unstable();
            zones.dedup();
            if !zones.is_empty()
                && let Err(error) = self.check_piece(piece.iter().map(|p| p.1), &held)
            {
                found.extend(zones.into_iter().map(|z| (z, error.clone())));
            }
        }
        found
    }

    fn check_piece(
        &self,
        tets: impl Iterator<Item = usize>,
        held: impl Fn(NodeId) -> [bool; 3],
    ) -> Result<(), SolveError> {
        let mut tetrahedra: Vec<[NodeId; 4]> = tets.map(|t| self.mesh.tetrahedra[t]).collect();
        let mut nodes: Vec<NodeId> = tetrahedra.iter().flatten().copied().collect();
        nodes.sort_unstable();
        nodes.dedup();
        for n in tetrahedra.iter_mut().flatten() {
            *n = NodeId::from_index(nodes.binary_search(n).expect("a node of the piece"));
        }
        let positions_m = nodes.iter().map(|n| self.mesh.positions_m[n.index()]).collect();
        let mut conditions = BoundaryConditions::new();
        for (l, &n) in nodes.iter().enumerate() {
            for axis in (0..3).filter(|&axis| held(n)[axis]) {
                conditions.impose(NodeId::from_index(l), axis, 0.0);
            }
        }
        let mesh = TetMesh { positions_m, tetrahedra, ..TetMesh::default() };
        let edges = MeshEdges::of_mesh(&mesh)?;
        conditions.check(&mesh, &edges).map_err(|error| match error {
            SolveError::Floating { piece_nodes, node, rigid_modes, named } => {
                SolveError::Floating { piece_nodes, node: nodes[node.index()], rigid_modes, named }
            }
            other => other,
        })
    }

    /// Drops removed nodes and tetrahedra; the others keep their order.
    fn renumber(&mut self, change: &TopologyChange) {
        // Under the constraints that are dropped below.
        self.catch_up();
        let (nodes, tets) = (&change.nodes.new_ids, &change.tets.new_ids);
        let stays: Vec<bool> = nodes.iter().map(Option::is_some).collect();
        let tet_stays: Vec<bool> = tets.iter().map(Option::is_some).collect();
        let new = |n: NodeId| nodes[n.index()].expect("what is live has live nodes");
        keep(&mut self.mesh.positions_m, &stays);
        keep(&mut self.mesh.tetrahedra, &tet_stays);
        if !self.mesh.shares.is_empty() {
            keep(&mut self.mesh.shares, &tet_stays);
        }
        self.mesh.tetrahedra.iter_mut().flatten().for_each(|n| *n = new(*n));
        keep(&mut self.zone_of_tet, &tet_stays);
        keep(&mut self.is_live, &tet_stays);
        if !self.rest_stress_pa.is_empty() {
            keep(&mut self.rest_stress_pa, &tet_stays);
        }
        keep(&mut self.held_axes, &stays);
        keep(&mut self.is_dynamic, &stays);
        keep(&mut self.place, &stays);
        keep(&mut self.positions_m, &stays);
        keep(&mut self.velocities_m_per_s, &stays);
        self.attachments.retain_mut(|a| {
            let at = nodes[a.node.index()];
            a.node = at.unwrap_or(a.node);
            at.is_some()
        });
        for zone in &mut self.zones {
            zone.nodes.iter_mut().chain(&mut zone.frontier).for_each(|n| *n = new(*n));
        }
        self.interface.nodes.iter_mut().for_each(|n| *n = new(*n));
        if let Some(dynamic) = &mut self.dynamic {
            dynamic.renumber(nodes, tets);
        }
        self.constraints.forces.clear();
        self.constraints.displacements.clear();
        self.n_dropped = 0;
        self.note_constraints();
    }
}

fn find(root: &mut [usize], mut n: usize) -> usize {
    while root[n] != n {
        root[n] = root[root[n]];
        n = root[n];
    }
    n
}
