//! An edit of the joint mesh, told to each body in its own numbers.

use super::maps::{Maps, Numbering};
use super::part::Part;
use super::{Composite, NAME, lock};
use crate::model::{ModelUndo, TopologyRefusal, follow_edit};
use glisson_mesh::mesh::edit::{EntityChange, TopologyChange};
use glisson_mesh::mesh::remap::MeshEntity;
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};

const RENUMBERS: &str =
    "an edit that renumbers the mesh cannot be told to several bodies; make the model anew";
const HOMELESS: &str = "an edit brought in tissue that hangs together with no body";

/// A body's share of an edit.
struct PartChange {
    part: usize,
    change: TopologyChange,
}

/// One kind of entity in a body's numbers; `after` has the new ones too.
fn entities<I: MeshEntity>(change: &EntityChange<I>, after: &Numbering, part: usize) -> EntityChange<I> {
    let of_part = after.of_part(part);
    let local = |id: I| -> Option<I> {
        let place = after.get(id.index())?;
        (place.part as usize == part).then(|| I::from_index(place.local as usize))
    };
    let mut own = EntityChange {
        n_before: of_part.partition_point(|&joint| (joint as usize) < change.n_before),
        n_after: of_part.len(),
        removed: change.removed.iter().filter_map(|&id| local(id)).collect(),
        ..EntityChange::default()
    };
    for (id, parents) in change.added.iter() {
        if let Some(id) = local(id) {
            let parents: Vec<(I, f64)> =
                parents.iter().filter_map(|&(parent, weight)| Some((local(parent)?, weight))).collect();
            own.added.push(id, &parents);
        }
    }
    own
}

/// A body's share, which is empty if the edit does not touch it.
fn share(change: &TopologyChange, after: &Maps, part: usize) -> TopologyChange {
    let local_node = |node: NodeId| -> Option<NodeId> {
        let place = after.nodes.get(node.index())?;
        (place.part as usize == part).then_some(NodeId(place.local))
    };
    let mut own = TopologyChange {
        nodes: entities(&change.nodes, &after.nodes, part),
        tets: entities(&change.tets, &after.tets, part),
        pieces: change.pieces,
        ..TopologyChange::default()
    };
    for (at, &node) in change.moved_nodes.iter().enumerate() {
        let Some(node) = local_node(node) else { continue };
        own.moved_nodes.push(node);
        own.moved_from_m.extend(change.moved_from_m.get(at));
        let parents = change.moved_parents.get(at).into_iter();
        own.moved_parents.extend(parents.map(|parents| {
            parents.iter().filter_map(|&(node, weight)| Some((local_node(node)?, weight))).collect()
        }));
    }
    let is_own = |tet: &&TetId| after.tets.get(tet.index()).is_some_and(|place| place.part as usize == part);
    own.reshaped_tets.extend(change.reshaped_tets.iter().filter(is_own).map(|&tet| after.local_tet(tet)));
    own
}

fn is_empty(change: &TopologyChange) -> bool {
    change.nodes.removed.is_empty()
        && change.nodes.added.ids().is_empty()
        && change.tets.removed.is_empty()
        && change.tets.added.ids().is_empty()
        && change.moved_nodes.is_empty()
        && change.reshaped_tets.is_empty()
}

impl Composite {
    /// The bodies that follow an edit with their shares, and the numbers after it.
    fn shares(
        &self,
        mesh: &TetMesh,
        change: &TopologyChange,
    ) -> Result<(Maps, Vec<PartChange>), TopologyRefusal> {
        let refuse = |reason| Err(TopologyRefusal::Frozen { model: NAME, reason });
        TopologyRefusal::of_other_mesh(NAME, change, [self.maps.tets.len(), self.maps.nodes.len()])?;
        if change.is_renumbering() {
            return refuse(RENUMBERS);
        }
        let mut after = self.maps.clone();
        if !after.extend(mesh, change) {
            return refuse(HOMELESS);
        }
        let shares = (0..self.parts.len())
            .map(|part| PartChange { part, change: share(change, &after, part) })
            .filter(|share| !is_empty(&share.change) || lock(&self.parts[share.part]).follows_all)
            .collect();
        Ok((after, shares))
    }

    /// Lets the bodies follow that the edit touches. Where one refuses, all are brought back.
    pub(super) fn follow(&mut self, mesh: &TetMesh, change: &TopologyChange) -> Result<(), TopologyRefusal> {
        let (after, shares) = self.shares(mesh, change)?;
        let mut followed: Vec<(usize, ModelUndo)> = Vec::new();
        for PartChange { part, change } in &shares {
            let mut own = lock(&self.parts[*part]);
            let Part { model, mesh: own_mesh, .. } = &mut *own;
            after.mesh_of_part_into(*part, mesh, own_mesh);
            let mut undo = ModelUndo::default();
            let done = follow_edit(model, own_mesh, change, &mut undo);
            drop(own);
            if let Err(refusal) = done {
                for (part, undo) in followed.iter_mut().rev() {
                    undo.put_back(&mut lock(&self.parts[*part]).model);
                }
                return Err(refusal);
            }
            followed.push((*part, undo));
        }
        self.maps = after;
        self.make_room();
        Ok(())
    }

    /// What the edit will overwrite, and the state of the bodies that it does not touch: they go back in time as well.
    pub(super) fn save(&self, change: &TopologyChange, undo: &mut ModelUndo) {
        undo.push_place(self.maps.nodes.len());
        undo.push_place(self.maps.tets.len());
        let after = self.maps_after(change);
        for part in 0..self.parts.len() {
            let mut own = ModelUndo::default();
            let mut of_part = lock(&self.parts[part]);
            of_part.model.save_for_undo(&share(change, &after, part), &mut own);
            of_part.follows_all = !own.keeps_whole() && of_part.model.topology_refusal().is_none();
            undo.parts.push(own);
        }
    }

    /// The numbers after an edit whose mesh is not known yet: new tissue is of its parents' body.
    fn maps_after(&self, change: &TopologyChange) -> Maps {
        let mut after = self.maps.clone();
        let of_tets = change.tets.removed.iter().filter_map(|tet| after.tets.get(tet.index()));
        let of_nodes = change.moved_nodes.iter().filter_map(|node| after.nodes.get(node.index()));
        // Tissue without parents fills a place that something else left.
        let touched = of_tets.chain(of_nodes).map(|place| place.part).next().unwrap_or(0);
        for (_, parents) in change.nodes.added.iter() {
            let place = parents.first().and_then(|(parent, _)| after.nodes.get(parent.index()));
            after.nodes.push(place.map_or(touched, |place| place.part));
        }
        for (_, parents) in change.tets.added.iter() {
            let place = parents.first().and_then(|(parent, _)| after.tets.get(parent.index()));
            after.tets.push(place.map_or(touched, |place| place.part));
        }
        after
    }

    /// Back to before the edit.
    pub(super) fn go_back(&mut self, undo: &ModelUndo) {
        for (part, own) in self.parts.iter().zip(&undo.parts) {
            own.put_back_copy(&mut lock(part).model);
        }
        let mut saved = undo.reader();
        let (n_nodes, n_tets) = (saved.place(), saved.place());
        self.maps.nodes.truncate(n_nodes);
        self.maps.tets.truncate(n_tets);
        self.make_room();
        self.read_constraint_forces();
        for mut part in self.all() {
            let n_nodes = part.n_nodes();
            part.moves_m.truncate(n_nodes);
            part.velocities_m_per_s.truncate(n_nodes);
        }
    }
}
