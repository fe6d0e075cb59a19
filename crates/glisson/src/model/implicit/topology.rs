//! Cutting by removal: the element list, masses and the sparse pattern are made anew.

use super::elements::{Elements, ElementsParams};
use super::ligaments::Ligaments;
use super::newton::Scratch;
use super::{Attachment, ImplicitEuler, ImplicitLaw, TopologyRefusal};
use crate::math::DVec3;
use crate::mesh::NodeId;
use crate::mesh::edit::TopologyChange;
use crate::mesh::remap::follow;

impl ImplicitEuler {
    /// Follows removals and compactions; both allocate.
    pub(super) fn follow(&mut self, change: &TopologyChange) -> Result<(), TopologyRefusal> {
        if !(change.tets.added.ids().is_empty()
            && change.nodes.added.ids().is_empty()
            && change.moved_nodes.is_empty())
        {
            return Err(TopologyRefusal::Frozen {
                model: "implicit",
                reason: "it follows removals of tetrahedra and compactions; build it anew on a mesh with new or moved \
                         nodes",
            });
        }
        assert_eq!(change.tets.n_before, self.tet_is_live.len(), "the model missed a change of the mesh");
        assert_eq!(change.nodes.n_before, self.n_nodes(), "the model missed a change of the mesh");
        for &tet in &change.tets.removed {
            self.tet_is_live[tet.index()] = false;
        }
        if change.is_renumbering() {
            self.compact(change);
        }
        let before = self.elements.recovery();
        self.elements = Elements::new(&ElementsParams {
            mesh: &self.mesh,
            live: &self.tet_is_live,
            law: &self.law,
            stand_ins: &self.stand_ins,
            volume: self.volume,
            rest_stress_pa: &self.rest_stress_pa,
            is_viscous: self.relaxation.is_some(),
        })
        .expect("the tetrahedra were usable when the model was built");
        self.is_suspect = true;
        self.elements.quarantine(&self.displacement_m, before);
        self.n_reanalyses += 1;
        let refusal = self.analyse().is_err();
        // A held or loaded node that lost its last tetrahedron has nothing to pull on.
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
        if refusal {
            return Err(TopologyRefusal::Frozen {
                model: "implicit",
                reason: "the remaining mesh could not be factored; build the model anew",
            });
        }
        Ok(())
    }

    /// Drops dead entities; the order of the others stays. Constraints are dropped with their node numbers.
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
        keep_live(&mut self.rest_stress_pa, live);
        if let ImplicitLaw::General(laws) = &mut self.law
            && laws.len() > 1
        {
            keep_live(laws, live);
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
