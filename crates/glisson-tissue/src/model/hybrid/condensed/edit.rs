//! Cuts: zones that become dynamic, tensors that are subtracted, pieces that come loose.

use super::super::NAME;
use super::{CondensedHybrid, ZoneLaw};
use crate::model::TopologyRefusal;
use crate::model::explicit::{follows, keep};
use crate::solve::{BoundaryConditions, MeshEdges, SolveError};
use glisson_mesh::fault;
use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::{NodeId, TetMesh};

impl CondensedHybrid {
    /// Follows removals and compactions. Additions and moved nodes are refused before anything changes. After that
    /// nothing that a built body can lead to is refused (see `bring_together_again`).
    pub(super) fn follow_change(&mut self, change: &TopologyChange) -> Result<(), TopologyRefusal> {
        follows(NAME, change)?;
        TopologyRefusal::of_other_mesh(NAME, change, [self.is_live.len(), self.positions_m.len()])?;
        let removed = &change.tets.removed[..];
        let mut is_new = self.dynamic.as_ref().is_some_and(|d| d.would_strand(removed));
        let mut is_cut = false;
        for t in removed.iter().map(|t| t.index()) {
            if std::mem::take(&mut self.is_live[t]) {
                is_cut = true;
                let law = &mut self.laws[self.zone_of_tet[t] as usize];
                if !law.is_dynamic() {
                    *law = self.cut_law;
                    is_new = true;
                }
            }
        }
        let pieces = &change.pieces;
        let may_be_loose = !(pieces.through_faces.is_settled() && pieces.through_nodes.is_settled());
        if is_cut && (is_new || may_be_loose) && !self.zones.is_empty() {
            is_new |= self.let_go();
        }
        if is_new {
            self.bring_together_again()?;
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
            let refusal = TopologyRefusal::Frozen {
                model: NAME,
                reason: "what is left has no stable motion; switch to tensor_mass",
            };
            self.bring_together(Some(&Vec::new())).map_err(|_| refusal)?;
        }
        if let Some(dynamic) = &mut self.dynamic {
            let velocities = Some(&self.velocities_m_per_s[..]);
            dynamic.start(&self.mesh.positions_m, &self.positions_m, velocities);
        }
        self.note_constraints();
        Ok(())
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
        let (nodes, tets) = (&change.nodes.new_ids, &change.tets.new_ids);
        let stays: Vec<bool> = nodes.iter().map(Option::is_some).collect();
        let tet_stays: Vec<bool> = tets.iter().map(Option::is_some).collect();
        let new = |n: NodeId| nodes[n.index()].expect("what is live has live nodes");
        keep(&mut self.mesh.positions_m, &stays);
        keep(&mut self.mesh.tetrahedra, &tet_stays);
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
