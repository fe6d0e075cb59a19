//! Which body has which nodes and tetrahedra of the joint mesh, and their numbers within it.

use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};

/// The place of an entity: its body, and its number there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Place {
    pub(super) part: u32,
    pub(super) local: u32,
}

/// Entities of one sort. Both directions ascend: the order of a body's numbers is that of the joint ones.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Numbering {
    places: Vec<Place>,
    /// Joint numbers of each body's entities.
    of_part: Vec<Vec<u32>>,
}

impl Numbering {
    /// Bodies one after the other.
    pub(super) fn of_counts(counts: impl Iterator<Item = usize>) -> Self {
        let mut numbering = Self::default();
        for (part, n) in counts.enumerate() {
            numbering.of_part.push(Vec::with_capacity(n));
            (0..n).for_each(|_| numbering.push(part as u32));
        }
        numbering
    }

    pub(super) fn len(&self) -> usize {
        self.places.len()
    }

    pub(super) fn get(&self, joint: usize) -> Option<Place> {
        self.places.get(joint).copied()
    }

    /// Joint numbers of a body's entities, ascending.
    pub(super) fn of_part(&self, part: usize) -> &[u32] {
        &self.of_part[part]
    }

    /// The next joint number goes to this body.
    pub(super) fn push(&mut self, part: u32) {
        let of_part = &mut self.of_part[part as usize];
        self.places.push(Place { part, local: of_part.len() as u32 });
        of_part.push(self.places.len() as u32 - 1);
    }

    /// Forgets the entities from this joint number on.
    pub(super) fn truncate(&mut self, n: usize) {
        self.places.truncate(n);
        for of_part in &mut self.of_part {
            of_part.truncate(of_part.partition_point(|&joint| (joint as usize) < n));
        }
    }
}

/// Nodes and tetrahedra.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Maps {
    pub(super) nodes: Numbering,
    pub(super) tets: Numbering,
}

impl Maps {
    /// Takes in what an edit added: a node is of its parents' body, a tetrahedron of its parents' or its
    /// corners'. Answers whether all found
    /// one; what was taken in until then stays.
    pub(super) fn extend(&mut self, mesh: &TetMesh, change: &TopologyChange) -> bool {
        for (_, parents) in change.nodes.added.iter() {
            let of_parent = parents.first().and_then(|(parent, _)| self.nodes.get(parent.index()));
            let Some(place) = of_parent else { return false };
            self.nodes.push(place.part);
        }
        for (tet, parents) in change.tets.added.iter() {
            let of_parent = parents.first().and_then(|(parent, _)| self.tets.get(parent.index()));
            let of_corner = || self.nodes.get(mesh.tetrahedra.get(tet.index())?[0].index());
            let Some(place) = of_parent.or_else(of_corner) else { return false };
            self.tets.push(place.part);
        }
        true
    }

    /// Writes a body's share of the joint mesh into `own`.
    pub(super) fn mesh_of_part_into(&self, part: usize, mesh: &TetMesh, own: &mut TetMesh) {
        own.positions_m.clear();
        let nodes = self.nodes.of_part(part).iter();
        own.positions_m.extend(nodes.map(|&n| mesh.positions_m[n as usize]));
        own.tetrahedra.clear();
        let corners = self.tets.of_part(part).iter().map(|&t| mesh.tetrahedra[t as usize]);
        own.tetrahedra.extend(corners.map(|corners| corners.map(|node| self.local_node(node))));
    }

    /// A node's number within its body.
    pub(super) fn local_node(&self, node: NodeId) -> NodeId {
        NodeId(self.nodes.get(node.index()).map_or(u32::MAX, |place| place.local))
    }

    /// A tetrahedron's number within its body.
    pub(super) fn local_tet(&self, tet: TetId) -> TetId {
        TetId(self.tets.get(tet.index()).map_or(u32::MAX, |place| place.local))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entities_join_their_body_and_go_again() {
        let mut numbering = Numbering::of_counts([3, 2].into_iter());
        assert_eq!(numbering.get(3), Some(Place { part: 1, local: 0 }));
        let before = numbering.clone();
        [0, 1, 0].into_iter().for_each(|part| numbering.push(part));
        assert_eq!(numbering.of_part(0), [0, 1, 2, 5, 7]);
        assert_eq!(numbering.of_part(1), [3, 4, 6]);
        assert_eq!(numbering.get(7), Some(Place { part: 0, local: 4 }));
        numbering.truncate(5);
        assert_eq!(numbering, before);
    }
}
