//! What acts on the nodes from outside: weight, ligaments, forces of the step.

use crate::model::Attachment;
use crate::model::bounded_vec::BoundedVec;
use crate::model::kernel::FastKernel;
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::NodeId;

/// Loads of one body, kept up in its kernel's outer forces.
#[derive(Clone, Debug)]
pub(super) struct Loads {
    pub(super) gravity_m_per_s2: DVec3,
    /// Ascending by node.
    attachments: Vec<Attachment>,
    rest_m: Vec<DVec3>,
    /// Forces of the constraints [N], zero but on the nodes of `loaded`.
    nodal_n: Vec<DVec3>,
    /// With room for every node.
    loaded: BoundedVec<NodeId>,
}

impl Loads {
    pub(super) fn new(gravity_m_per_s2: DVec3, attachments: &[Attachment], rest_m: &[DVec3]) -> Self {
        let mut attachments = attachments.to_vec();
        attachments.sort_by_key(|attachment| attachment.node);
        Self {
            gravity_m_per_s2,
            attachments,
            rest_m: rest_m.to_vec(),
            nodal_n: vec![DVec3::ZERO; rest_m.len()],
            loaded: BoundedVec::with_capacity(rest_m.len()),
        }
    }

    /// Tells the kernel a node's outer force: m g + F + ligaments, with the ligaments as long as they are now.
    pub(super) fn refresh(&self, kernel: &mut FastKernel, node: NodeId) {
        let mut force_n = self.gravity_m_per_s2 * kernel.mass_kg(node) + self.nodal_n[node.index()];
        let first = self.attachments.partition_point(|a| a.node < node);
        let at_node = self.attachments[first..].iter().take_while(|a| a.node == node);
        let mut position_m = None;
        for attachment in at_node {
            let position_m =
                *position_m.get_or_insert_with(|| self.rest_m[node.index()] + kernel.displacement_m(node));
            force_n += attachment.force_n(position_m);
        }
        kernel.set_outer_force(node, force_n);
    }

    pub(super) fn refresh_all(&self, kernel: &mut FastKernel) {
        for node in (0..self.rest_m.len()).map(NodeId::from_index) {
            self.refresh(kernel, node);
        }
    }

    /// Before each internal step: ligaments change their length.
    pub(super) fn refresh_attachments(&self, kernel: &mut FastKernel) {
        let mut last = None;
        for attachment in &self.attachments {
            if last.replace(attachment.node) != Some(attachment.node) {
                self.refresh(kernel, attachment.node);
            }
        }
    }

    /// Takes the nodal forces back.
    pub(super) fn clear(&mut self, kernel: &mut FastKernel) {
        while let Some(node) = self.loaded.pop() {
            self.nodal_n[node.index()] = DVec3::ZERO;
            self.refresh(kernel, node);
        }
    }

    /// Adds a force on a node; false when the list is full of repetitions.
    pub(super) fn add(&mut self, kernel: &mut FastKernel, node: NodeId, force_n: DVec3) -> bool {
        let has_room = self.loaded.try_push(node);
        if has_room {
            self.nodal_n[node.index()] += force_n;
            self.refresh(kernel, node);
        }
        has_room
    }

    /// Nodes with a force of the constraints, perhaps several times.
    pub(super) fn loaded(&self) -> &[NodeId] {
        &self.loaded
    }

    /// Comes back to the force of the constraints on a node; the kernel is to be told.
    pub(super) fn put_back(&mut self, node: NodeId, force_n: DVec3) {
        if self.loaded.try_push(node) {
            self.nodal_n[node.index()] = force_n;
        }
    }

    /// Force of the constraints on a node [N].
    pub(super) fn on_n(&self, n: usize) -> DVec3 {
        self.nodal_n[n]
    }

    /// Room for new nodes; all places at rest may be other ones.
    pub(super) fn grow(&mut self, rest_m: &[DVec3]) {
        self.rest_m.clear();
        self.rest_m.extend_from_slice(rest_m);
        self.nodal_n.resize(rest_m.len(), DVec3::ZERO);
        debug_assert!(self.loaded.iter().all(|node| node.index() < rest_m.len()));
        self.loaded.make_room(rest_m.len());
    }

    /// For the nodes that stay, under their new ids; without nodal forces.
    pub(super) fn renumbered(&self, new_ids: &[Option<NodeId>], rest_m: &[DVec3]) -> Self {
        let moved = |a: &Attachment| new_ids[a.node.index()].map(|node| Attachment { node, ..*a });
        let attachments: Vec<Attachment> = self.attachments.iter().filter_map(moved).collect();
        Self::new(self.gravity_m_per_s2, &attachments, rest_m)
    }
}
