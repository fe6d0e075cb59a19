//! What an edit did, in buffers that are used again.

use crate::math::DVec3;
use crate::mesh::{EdgeId, NodeId, TetId, TriangleId};
use std::fmt;

/// A kind of entity, known by its id type: node, edge, triangle or tetrahedron.
pub trait MeshEntity: Copy + Ord + fmt::Debug {
    /// The id as a place in an array.
    fn index(self) -> usize;

    /// The id of a place in an array.
    fn from_index(index: usize) -> Self;

    /// What `change` did to the entities of this kind.
    fn changed_in(change: &TopologyChange) -> &EntityChange<Self>;
}

macro_rules! mesh_entity {
    ($id:ident, $field:ident) => {
        impl MeshEntity for $id {
            fn index(self) -> usize {
                $id::index(self)
            }

            fn from_index(index: usize) -> Self {
                $id::from_index(index)
            }

            fn changed_in(change: &TopologyChange) -> &EntityChange<Self> {
                &change.$field
            }
        }
    };
}

mesh_entity!(NodeId, nodes);
mesh_entity!(EdgeId, edges);
mesh_entity!(TriangleId, triangles);
mesh_entity!(TetId, tets);

/// How many entities of each kind there are, dead ones included.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(in crate::mesh) struct Lengths {
    pub(in crate::mesh) nodes: usize,
    pub(in crate::mesh) edges: usize,
    pub(in crate::mesh) triangles: usize,
    pub(in crate::mesh) tets: usize,
}

/// New entities of one kind, each with its parents.
#[derive(Clone, Debug, PartialEq)]
pub struct Additions<I> {
    ids: Vec<I>,
    ends: Vec<usize>,
    parents: Vec<(I, f64)>,
}

impl<I> Default for Additions<I> {
    fn default() -> Self {
        Self { ids: Vec::new(), ends: Vec::new(), parents: Vec::new() }
    }
}

impl<I: MeshEntity> Additions<I> {
    /// Adds an entity. `parents`: older entities of the same kind with weights, of sum 1 where the data are
    /// interpolated; none for an entity that starts from cleared data.
    pub fn push(&mut self, id: I, parents: &[(I, f64)]) {
        self.ids.push(id);
        self.parents.extend_from_slice(parents);
        self.ends.push(self.parents.len());
    }

    /// Each new entity with its parents, ascending.
    pub fn iter(&self) -> impl Iterator<Item = (I, &[(I, f64)])> + '_ {
        self.ids.iter().enumerate().map(|(at, &id)| {
            let start = if at == 0 { 0 } else { self.ends[at - 1] };
            (id, &self.parents[start..self.ends[at]])
        })
    }

    /// The new entities, ascending.
    pub fn ids(&self) -> &[I] {
        &self.ids
    }

    /// Parents of the entity at place `at` of [`Additions::ids`].
    pub fn parents(&self, at: usize) -> &[(I, f64)] {
        let start = if at == 0 { 0 } else { self.ends[at - 1] };
        &self.parents[start..self.ends[at]]
    }

    /// Replaces the parents of the entity at place `at`.
    pub(super) fn set_parents(&mut self, at: usize, parents: &[(I, f64)]) {
        let start = if at == 0 { 0 } else { self.ends[at - 1] };
        let (old, new) = (self.ends[at] - start, parents.len());
        self.parents.splice(start..self.ends[at], parents.iter().copied());
        for end in &mut self.ends[at..] {
            *end = *end + new - old;
        }
    }

    pub(super) fn clear(&mut self) {
        self.ids.clear();
        self.ends.clear();
        self.parents.clear();
    }
}

/// What happened to the entities of one kind. Order of events: `added`, then `removed`, then `new_ids`. What came
/// and went within the edit is in neither list, and ids of additions have no gaps.
#[derive(Clone, Debug, PartialEq)]
pub struct EntityChange<I> {
    /// Number of entities before, dead ones included.
    pub n_before: usize,
    /// Number of entities afterwards, dead ones included.
    pub n_after: usize,
    /// Entities that are dead now, ascending: tetrahedra taken out, and what was left without a
    /// tetrahedron. Their records in the topology can still be read.
    pub removed: Vec<I>,
    /// Entities that came in; their ids continue the numbering from `n_before`. Parents are entities from before
    /// the edit, with their values from then; edges and triangles have none.
    pub added: Additions<I>,
    /// For nodes and tetrahedra after a list of edits in which some of those that came in went again: the id of
    /// what had the id `n_before + i` while the list was carried out. Else empty: the ids stand.
    pub provisional_ids: Vec<Option<I>>,
    /// After a compaction: the new id of each old one, `None` for what is dropped. Else empty.
    pub new_ids: Vec<Option<I>>,
}

impl<I> Default for EntityChange<I> {
    fn default() -> Self {
        Self {
            n_before: 0,
            n_after: 0,
            removed: Vec::new(),
            added: Additions::default(),
            provisional_ids: Vec::new(),
            new_ids: Vec::new(),
        }
    }
}

impl<I: MeshEntity> EntityChange<I> {
    fn clear(&mut self) {
        self.removed.clear();
        self.added.clear();
        self.provisional_ids.clear();
        self.new_ids.clear();
    }

    fn has_gaps(&self) -> bool {
        !self.added.ids.is_empty() && self.removed.iter().any(|id| id.index() >= self.n_before)
    }

    fn forget_additions(&mut self) {
        self.added.clear();
        let n_before = self.n_before;
        self.removed.retain(|id| id.index() < n_before);
    }

    /// Adds an entity whose parents may be new themselves; their parents stand for them.
    pub(super) fn add_with_parents(&mut self, id: I, parents: &[(I, f64)]) {
        if parents.iter().all(|(parent, _)| parent.index() < self.n_before) {
            self.added.push(id, parents);
        } else {
            let parents = self.parents_before(parents);
            self.added.push(id, &parents);
        }
    }

    /// `parents` without new entities, ascending: their parents stand for them.
    pub(super) fn parents_before(&self, parents: &[(I, f64)]) -> Vec<(I, f64)> {
        let mut found: Vec<(I, f64)> = Vec::new();
        for &(parent, weight) in parents {
            match parent.index().checked_sub(self.n_before) {
                None => found.push((parent, weight)),
                Some(at) => found.extend(self.added.parents(at).iter().map(|&(p, w)| (p, w * weight))),
            }
        }
        sum_repeated(&mut found);
        found
    }

    fn start_with(&mut self, n: usize) {
        self.n_before = n;
        self.n_after = n;
    }
}

/// What an edit may have done to the number of pieces. Exact counts: [`crate::mesh::topology::Topology::pieces_into`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PieceChange {
    /// Pieces that vanished because their last tetrahedron was removed, those that the edit itself had split
    /// off included.
    pub n_gone: usize,
    /// Whether a piece may have come apart. False is certain; true asks for a count.
    pub may_have_split: bool,
}

impl PieceChange {
    /// Whether the number of pieces is surely what it was, but for those that are gone.
    pub fn is_settled(self) -> bool {
        !self.may_have_split
    }

    /// One tetrahedron was removed; what it touched forms `n_groups` groups that hang together near it.
    pub(crate) fn count_removal(&mut self, n_groups: usize) {
        self.n_gone += usize::from(n_groups == 0);
        self.may_have_split |= n_groups > 1;
    }
}

/// [`PieceChange`] for both notions of a piece ([`crate::mesh::topology::Through`]).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PieceChanges {
    /// Pieces held together by faces.
    pub through_faces: PieceChange,
    /// Pieces held together by nodes.
    pub through_nodes: PieceChange,
}

/// Nodes with weights.
pub type NodeWeights = Vec<(NodeId, f64)>;

/// What an edit did. All lists ascend; nothing that came and went within the edit is on a surface list.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TopologyChange {
    /// The nodes.
    pub nodes: EntityChange<NodeId>,
    /// The edges.
    pub edges: EntityChange<EdgeId>,
    /// The triangles.
    pub triangles: EntityChange<TriangleId>,
    /// The tetrahedra.
    pub tets: EntityChange<TetId>,
    /// Nodes that were there before and whose rest position changed; each tetrahedron at one has a new rest shape.
    pub moved_nodes: Vec<NodeId>,
    /// Where each of `moved_nodes` was at rest before [m].
    pub moved_from_m: Vec<DVec3>,
    /// For each of `moved_nodes`, nodes from before with weights of sum 1 whose places then give the place where it is now,
    /// at rest as in the deformed tissue; none where the edit says only where it is at rest.
    pub moved_parents: Vec<NodeWeights>,
    /// Live tetrahedra from before at a node of `moved_nodes`: their shape at rest is another.
    pub reshaped_tets: Vec<TetId>,
    /// Triangles that are on the surface now and were not.
    pub surface_triangles_added: Vec<TriangleId>,
    /// Triangles that were on the surface and are not.
    pub surface_triangles_removed: Vec<TriangleId>,
    /// Nodes that are on the surface now and were not.
    pub surface_nodes_added: Vec<NodeId>,
    /// Nodes that were on the surface and are not.
    pub surface_nodes_removed: Vec<NodeId>,
    /// What happened to the pieces.
    pub pieces: PieceChanges,
}

impl TopologyChange {
    /// An empty change with room for the removal of `n_tets` tetrahedra at once.
    pub fn with_room_for_removals(n_tets: usize) -> Self {
        let mut change = Self::default();
        change.tets.removed.reserve(n_tets);
        change.triangles.removed.reserve(4 * n_tets);
        change.edges.removed.reserve(6 * n_tets);
        change.nodes.removed.reserve(4 * n_tets);
        change.surface_triangles_added.reserve(4 * n_tets);
        change.surface_triangles_removed.reserve(4 * n_tets);
        // A node can come to the surface and leave it with each of the tetrahedra.
        change.surface_nodes_added.reserve(4 * n_tets);
        change.surface_nodes_removed.reserve(4 * n_tets);
        change
    }

    /// Whether ids changed their meaning: every stored id must go through `new_ids`.
    pub fn is_renumbering(&self) -> bool {
        !(self.nodes.new_ids.is_empty()
            && self.edges.new_ids.is_empty()
            && self.triangles.new_ids.is_empty()
            && self.tets.new_ids.is_empty())
    }

    /// Forgets everything but the buffers.
    pub fn clear(&mut self) {
        self.nodes.clear();
        self.edges.clear();
        self.triangles.clear();
        self.tets.clear();
        self.moved_nodes.clear();
        self.moved_from_m.clear();
        self.moved_parents.clear();
        self.reshaped_tets.clear();
        self.surface_triangles_added.clear();
        self.surface_triangles_removed.clear();
        self.surface_nodes_added.clear();
        self.surface_nodes_removed.clear();
        self.pieces = PieceChanges::default();
    }

    pub(super) fn set_counts_before(&mut self, lengths: Lengths) {
        self.nodes.start_with(lengths.nodes);
        self.edges.start_with(lengths.edges);
        self.triangles.start_with(lengths.triangles);
        self.tets.start_with(lengths.tets);
    }

    pub(super) fn set_counts_after(&mut self, lengths: Lengths) {
        self.nodes.n_after = lengths.nodes;
        self.edges.n_after = lengths.edges;
        self.triangles.n_after = lengths.triangles;
        self.tets.n_after = lengths.tets;
    }

    pub(super) fn lengths_before(&self) -> Lengths {
        Lengths {
            nodes: self.nodes.n_before,
            edges: self.edges.n_before,
            triangles: self.triangles.n_before,
            tets: self.tets.n_before,
        }
    }

    /// Whether something that came in went again.
    pub(super) fn has_gaps(&self) -> bool {
        self.nodes.has_gaps() || self.edges.has_gaps() || self.triangles.has_gaps() || self.tets.has_gaps()
    }

    /// Strikes everything that came in from all lists but those of the surface.
    pub(super) fn forget_additions(&mut self) {
        self.nodes.forget_additions();
        self.edges.forget_additions();
        self.triangles.forget_additions();
        self.tets.forget_additions();
    }

    /// Sorts the lists and strikes what came and went.
    pub(super) fn close(&mut self) {
        self.nodes.removed.sort_unstable();
        self.edges.removed.sort_unstable();
        self.triangles.removed.sort_unstable();
        self.tets.removed.sort_unstable();
        strike_common(&mut self.surface_triangles_added, &mut self.surface_triangles_removed);
        strike_common(&mut self.surface_nodes_added, &mut self.surface_nodes_removed);
    }
}

/// Sorts by entity and adds up the weights of each.
pub(super) fn sum_repeated<I: MeshEntity>(weights: &mut Vec<(I, f64)>) {
    weights.sort_by_key(|w| w.0);
    weights.dedup_by(|next, kept| {
        let same = next.0 == kept.0;
        if same {
            kept.1 += next.1;
        }
        same
    });
}

/// Sorts both lists and takes what stands in both out of both, as often as it does.
fn strike_common<I: Copy + Ord>(a: &mut Vec<I>, b: &mut Vec<I>) {
    a.sort_unstable();
    b.sort_unstable();
    let (mut i, mut j, mut kept_a, mut kept_b) = (0, 0, 0, 0);
    while i < a.len() || j < b.len() {
        if i < a.len() && j < b.len() && a[i] == b[j] {
            i += 1;
            j += 1;
        } else if j == b.len() || (i < a.len() && a[i] < b[j]) {
            a[kept_a] = a[i];
            kept_a += 1;
            i += 1;
        } else {
            b[kept_b] = b[j];
            kept_b += 1;
            j += 1;
        }
    }
    a.truncate(kept_a);
    b.truncate(kept_b);
}
