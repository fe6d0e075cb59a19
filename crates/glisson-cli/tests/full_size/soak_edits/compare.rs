//! The model that went through all edits against one made afresh.

use super::checks::{compliance_difference, difference, measured, within_measure};
use super::draw::Depth;
use super::patient::Patient;
use super::substance::Held;
use glisson::math::DVec3;
use glisson::mesh::{NodeId, TetId};
use glisson::model::{Attachment, FixedNode, ImposedDisplacement};
use glisson::world::spec::fixed_nodes;

/// Nodes that are held at once when compliances are compared: a choice.
const HELD_NODES: usize = 8;
/// Of the largest force. A pre-computed model wants to be made anew when its estimated error reaches 1e-6 of the largest
/// compliance; forces are the inverse of some of it.
pub(super) const COMPLIANCE_TOLERANCE: f64 = 1e-4;

impl Patient<'_> {
    /// The model that went through all edits against one made afresh from the edited mesh.
    pub(super) fn compare(&mut self) {
        let body = self.world.organ().body();
        let topology = body.topology();
        if topology.live_counts().tets == 0 || !matches!(self.draw.depth(), Depth::Forces | Depth::Afresh) {
            return;
        }
        let live: Vec<NodeId> = topology.live_nodes().collect();
        let fixed: Vec<FixedNode> = live
            .iter()
            .enumerate()
            .filter(|(_, node)| self.world.organ().is_fixed(**node))
            .map(|(new, _)| FixedNode::all_axes(NodeId::from_index(new)))
            .collect();
        let renumbered = |a: &Attachment| {
            let new = live.binary_search(&a.node).ok()?;
            Some(Attachment { node: NodeId::from_index(new), ..*a })
        };
        let ligaments: Vec<Attachment> = self.attached.ligaments.iter().filter_map(renumbered).collect();
        let material: Vec<u8> = topology.live_tets().map(|t| self.attached.material[t.index()]).collect();
        let (mesh, label) = (body.live_mesh(), self.label());
        let on = Held { mesh: &mesh, material: &material, fixed: &fixed, ligaments: &ligaments };
        let fresh = self.substance.model_for_forces(&on);
        let (now_m, n_put_back) = within_measure(body, self.world.state().positions_m);
        let (all_m, n_turned) = measured(&self.world, &now_m, self.draw.limit());
        let found = difference(body, &all_m, self.world.copy_of_model(), fresh, &label);
        assert!(found.forces < 1e-9 && found.weights < 1e-9, "{label}: {found:?}");
        self.tally.worst_forces = self.tally.worst_forces.max(found.forces);
        self.tally.worst_weights = self.tally.worst_weights.max(found.weights);
        self.tally.comparisons += 1;
        self.tally.put_back += (n_put_back + n_turned) as u64;
    }

    /// The compliance of a pre-computed model that went through removals against one computed afresh of what is left: the
    /// forces that hold some nodes out of their places at rest. A model that asks for it is replaced, as in a session.
    pub(super) fn compare_compliance(&mut self) {
        let organ = self.world.organ();
        let (body, label) = (organ.body(), self.label());
        if self.draw.depth() != Depth::Compliance || body.topology().live_counts().tets == 0 {
            return;
        }
        // Removals leave all nodes their numbers.
        let fixed = fixed_nodes(&self.world.spec().supports, &body.mesh().positions_m);
        let on = Held { mesh: body.mesh(), material: &self.attached.material, fixed: &fixed, ligaments: &[] };
        // Nothing that is held may be left.
        let Ok(fresh) = self.substance.model_as_cut(&on, organ.live_tetrahedra()) else { return };
        if self.world.report().model.wants_recomputation {
            self.world.queue_model_swap(self.world.steps_made(), self.draw.kind);
            let delivered = self.world.deliver_model(fresh, self.draw.kind);
            assert_eq!(delivered, Ok(true), "{label}: a fresh pre-computation");
            self.rest_after_edit();
            self.tally.renewed += 1;
            return;
        }
        let rest_m = body.mesh().positions_m.clone();
        let held = self.nodes_to_hold(&fixed);
        if held.is_empty() {
            return;
        }
        let found = compliance_difference(&rest_m, &held, self.world.copy_of_model(), fresh);
        assert!(found < COMPLIANCE_TOLERANCE, "{label}: compliance {found}");
        self.tally.worst_compliance = self.tally.worst_compliance.max(found);
        self.tally.comparisons += 1;
    }

    /// Some nodes of the surface, in tissue that hangs together with a support by faces, and where each is held [m].
    fn nodes_to_hold(&mut self, fixed: &[FixedNode]) -> Vec<ImposedDisplacement> {
        let organ = self.world.organ();
        let topology = organ.body().topology();
        let is_fixed = |n: &NodeId| fixed.binary_search_by_key(n, |f| f.node).is_ok();
        let mut is_borne = vec![false; topology.n_tets()];
        let mut next: Vec<TetId> = topology
            .live_tets()
            .filter(|&t| topology.tet_nodes(t).iter().filter(|n| is_fixed(n)).count() >= 3)
            .collect();
        next.iter().for_each(|t| is_borne[t.index()] = true);
        while let Some(tet) = next.pop() {
            for neighbour in topology.tet_neighbours(tet).into_iter().filter_map(|n| n.get()) {
                if !std::mem::replace(&mut is_borne[neighbour.index()], true) {
                    next.push(neighbour);
                }
            }
        }
        let mut nodes: Vec<NodeId> = topology
            .surface_nodes()
            .filter(|n| !is_fixed(n) && topology.node_tets(*n).iter().all(|t| is_borne[t.index()]))
            .collect();
        let mut held = Vec::new();
        while held.len() < HELD_NODES && !nodes.is_empty() {
            let node = nodes.swap_remove(self.index(nodes.len()));
            let displacement_m = self.way_along(DVec3::Y) * (0.1 * self.mean_edge_m);
            held.push(ImposedDisplacement { node, displacement_m });
        }
        held.sort_by_key(|h| h.node);
        held
    }
}
