//! Changes of connectivity: every one is a [`MeshEdit`] applied to an [`EditableMesh`], and its
//! [`TopologyChange`] tells all who keep data by node, edge, triangle or tetrahedron how to follow
//! ([`crate::mesh::remap`]).
//!
//! An edit is done whole or refused whole: a refusal touches nothing. Each is first planned, as tetrahedra that
//! go, others that come and nodes that come or move, and then carried out by one mechanism (`plan`), which
//! also serves lists of edits (`transaction`). [`EditableMesh::undo`] takes the last edit back (`undo`).
//!
//! New entities continue the numbering. A tetrahedron whose corners change is removed and a new one comes in
//! with the old one as its parent. Edges and triangles that keep their nodes through an edit keep their ids.

mod collapse;
mod duplicate;
mod error;
mod judgement;
mod moves;
mod overlap;
mod parents;
mod plan;
mod replace;
mod sides;
mod singular;
mod split;
mod transaction;
mod undo;

pub use crate::mesh::change::{
    Additions, EntityChange, NodeWeights, PieceChange, PieceChanges, TopologyChange,
};
pub use error::EditError;
pub use replace::{MovedNode, NewTet, Replacement};
pub use undo::MeshUndo;

use self::plan::Scratch;
use crate::math::DVec3;
use crate::mesh::topology::{Topology, TopologyError};
use crate::mesh::{EdgeId, NodeId, TetId, TetMesh};

/// A change of the mesh, in the numbering from before it.
#[derive(Clone, Debug, PartialEq)]
pub enum MeshEdit {
    /// Takes tetrahedra out.
    Remove {
        /// Which ones; live, each once.
        tets: Vec<TetId>,
    },
    /// Gives part of a node's tetrahedra a node of their own at the same place: opens a cut.
    DuplicateVertex {
        /// The node.
        node: NodeId,
        /// The tetrahedra at the node that get the new one; the others keep the old.
        tets_of_copy: Vec<TetId>,
    },
    /// Many [`MeshEdit::DuplicateVertex`] at once, all in the numbering from before.
    DuplicateVertices {
        /// The copies; their new nodes are numbered in this order. A tetrahedron may be named with each of its
        /// nodes, and a node may have several copies.
        copies: Vec<VertexCopy>,
    },
    /// Moves a node of the rest shape.
    MoveVertex {
        /// The node.
        node: NodeId,
        /// Where to [m].
        position_m: DVec3,
    },
    /// Puts new nodes on edges and divides every tetrahedron that has one of these edges.
    Split {
        /// Where; each edge once. A tetrahedron with several of them is cut in two at the first, the parts
        /// with the second at that, and so on: so do its neighbours, and the faces match. The new nodes are
        /// numbered in this order.
        edges: Vec<EdgeSplit>,
    },
    /// Pulls the two nodes of an edge together; the tetrahedra at the edge vanish.
    Collapse {
        /// The edge.
        edge: EdgeId,
        /// Which of its nodes stays.
        kept: NodeId,
        /// Where the kept node goes [m].
        position_m: DVec3,
    },
    /// Fills the place of some tetrahedra with others that have the same outer triangles.
    Retetrahedralise {
        /// The tetrahedra that make room.
        tets: Vec<TetId>,
        /// Nodes that come in.
        new_nodes: Vec<NewNode>,
        /// The tetrahedra that take their place.
        new_tets: Vec<[CavityNode; 4]>,
    },
    /// Puts tetrahedra in the place of others whose descendants they are, and moves nodes: a cut in one edit.
    Replace(Replacement),
}

/// A new node at the place of an old one.
#[derive(Clone, Debug, PartialEq)]
pub struct VertexCopy {
    /// The old node.
    pub node: NodeId,
    /// The tetrahedra that get the new one.
    pub tets: Vec<TetId>,
}

/// A new node on an edge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgeSplit {
    /// The edge.
    pub edge: EdgeId,
    /// Where between its first node (0) and its second (1), both excluded.
    pub fraction: f64,
}

/// A node that an edit brings in.
#[derive(Clone, Debug, PartialEq)]
pub struct NewNode {
    /// Where [m].
    pub position_m: DVec3,
    /// The nodes that it takes its data from, with weights of sum 1.
    pub parents: Vec<(NodeId, f64)>,
}

/// A corner of a new tetrahedron.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CavityNode {
    /// A node that was there.
    Old(NodeId),
    /// Place in the edit's list of new nodes.
    New(u32),
}

impl MeshEdit {
    /// Name of the kind of edit.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Remove { .. } => "remove",
            Self::DuplicateVertex { .. } => "duplicate vertex",
            Self::DuplicateVertices { .. } => "duplicate vertices",
            Self::MoveVertex { .. } => "move vertex",
            Self::Split { .. } => "split",
            Self::Collapse { .. } => "collapse",
            Self::Retetrahedralise { .. } => "retetrahedralise",
            Self::Replace(_) => "replace",
        }
    }
}

/// A mesh and its adjacency, kept together: the only way to change connectivity.
///
/// Dead tetrahedra stay in `mesh().tetrahedra` until [`EditableMesh::compact`]; go through
/// `topology().live_tets()`. Removing the dead tetrahedra of a snapshot from the mesh it was made from gives
/// back the same topology, whatever the order in which they went.
#[derive(Clone, Debug)]
pub struct EditableMesh {
    mesh: TetMesh,
    topology: Topology,
    scratch: Scratch,
}

/// Equal when meshes and adjacencies are.
impl PartialEq for EditableMesh {
    fn eq(&self, other: &Self) -> bool {
        self.mesh == other.mesh && self.topology == other.topology
    }
}

impl EditableMesh {
    /// Takes a mesh over.
    ///
    /// # Errors
    /// [`TopologyError`] if it is no mesh.
    pub fn new(mesh: TetMesh) -> Result<Self, TopologyError> {
        let topology = Topology::build(&mesh)?;
        Ok(Self { mesh, topology, scratch: Scratch::default() })
    }

    /// Nodes at rest and tetrahedra, dead ones included.
    pub fn mesh(&self) -> &TetMesh {
        &self.mesh
    }

    /// The adjacency.
    pub fn topology(&self) -> &Topology {
        &self.topology
    }

    /// Makes room for about `n_tets` more tetrahedra, so that the first edits need not move the tables.
    pub fn reserve(&mut self, n_tets: usize) {
        self.topology.reserve(n_tets);
        self.mesh.tetrahedra.reserve(n_tets);
        self.mesh.positions_m.reserve(n_tets.div_ceil(2));
    }

    /// Volume [m3] of what is live.
    pub fn volume_m3(&self) -> f64 {
        self.topology.live_tets().map(|t| self.mesh.tet_volume_m3(t)).sum()
    }

    /// What an edit did.
    ///
    /// # Errors
    /// [`EditError`] if it cannot be done; nothing changed then.
    pub fn apply(&mut self, edit: &MeshEdit) -> Result<TopologyChange, EditError> {
        let mut change = TopologyChange::default();
        self.apply_into(edit, &mut change)?;
        Ok(change)
    }

    /// [`EditableMesh::apply`] into a change whose buffers are used again: a removal allocates nothing if
    /// they have room ([`TopologyChange::with_room_for_removals`]).
    ///
    /// # Errors
    /// [`EditError`] if the edit cannot be done; nothing changed then, and `change` is empty.
    pub fn apply_into(&mut self, edit: &MeshEdit, change: &mut TopologyChange) -> Result<(), EditError> {
        let mut undo = std::mem::take(&mut self.scratch.undo);
        let done = self.apply_saving(edit, change, &mut undo);
        self.scratch.undo = undo;
        done
    }

    /// [`MeshEdit::Remove`] from a slice.
    ///
    /// # Errors
    /// [`EditError`] if a tetrahedron is not there, dead, or named twice; nothing changed then.
    pub fn remove_into(&mut self, tets: &[TetId], change: &mut TopologyChange) -> Result<(), EditError> {
        self.begin(change);
        self.topology.check_removable(tets)?;
        for &tet in tets {
            self.topology.detach_tet(tet, change);
        }
        change.close();
        Ok(())
    }

    /// [`EditableMesh::remove_into`] with what it takes to take the removal back. It allocates nothing if both
    /// buffers have room ([`MeshUndo::with_room_for_removals`]).
    ///
    /// # Errors
    /// As there; `undo` is empty then.
    pub fn remove_saving(
        &mut self,
        tets: &[TetId],
        change: &mut TopologyChange,
        undo: &mut MeshUndo,
    ) -> Result<(), EditError> {
        undo.start(&self.topology);
        self.remove_into(tets, change)?;
        tets.iter().for_each(|&tet| undo.save_removal(tet));
        undo.close(&self.topology);
        Ok(())
    }

    /// Drops what is dead and numbers what is left anew, in the old order.
    pub fn compact(&mut self) -> TopologyChange {
        let mut change = TopologyChange::default();
        self.compact_into(&mut change);
        change
    }

    /// [`EditableMesh::compact`] into a change whose buffers are used again. Without anything dead nothing
    /// changes, and `change` says so.
    pub fn compact_into(&mut self, change: &mut TopologyChange) {
        self.begin(change);
        if !self.topology.has_dead() {
            return;
        }
        self.topology.compact(change);
        change.set_counts_after(self.topology.lengths());
        crate::mesh::remap::follow::<NodeId, DVec3>(&mut self.mesh.positions_m, change);
        self.mesh.tetrahedra.clear();
        let topology = &self.topology;
        self.mesh.tetrahedra.extend(topology.live_tets().map(|t| topology.tet_nodes(t)));
    }

    /// A compact copy of what is live: what files and checks want.
    pub fn live_mesh(&self) -> TetMesh {
        let mut copy = self.clone();
        copy.compact();
        copy.mesh
    }

    /// Empties `change` and notes the counts from before the edit.
    fn begin(&self, change: &mut TopologyChange) {
        change.clear();
        change.set_counts_before(self.topology.lengths());
    }
}
