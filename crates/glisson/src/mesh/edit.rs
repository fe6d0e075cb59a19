//! Changes of connectivity: every one is a [`MeshEdit`] applied to an [`EditableMesh`], and its
//! [`TopologyChange`] tells all who keep data by node, edge, triangle or tetrahedron how to follow
//! ([`crate::mesh::remap`]).
//!
//! An edit is done whole or refused whole: a refusal touches nothing.

mod change;
mod replace;

pub use change::{Additions, EntityChange, PieceChange, PieceChanges, TopologyChange};
pub use replace::{NewTet, Replacement};

use crate::math::{DVec3, tetrahedron_volume_m3};
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
    /// Moves a node of the rest shape.
    MoveVertex {
        /// The node.
        node: NodeId,
        /// Where to [m].
        position_m: DVec3,
    },
    /// Puts new nodes on edges and divides every tetrahedron that has one of these edges.
    Split {
        /// Where; each edge once.
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
            Self::MoveVertex { .. } => "move vertex",
            Self::Split { .. } => "split",
            Self::Collapse { .. } => "collapse",
            Self::Retetrahedralise { .. } => "retetrahedralise",
        }
    }
}

/// Why an edit was refused. Nothing changed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EditError {
    /// This kind of edit is defined but cannot be carried out yet.
    #[error("the edit `{edit}` is not supported yet: remove tetrahedra instead")]
    NotSupportedYet {
        /// Name of the kind.
        edit: &'static str,
    },
    /// There is no such tetrahedron.
    #[error("there is no tetrahedron {tet}: the mesh has {n_tets}, numbered from 0")]
    NoSuchTet {
        /// The one named.
        tet: TetId,
        /// How many there are, dead ones included.
        n_tets: usize,
    },
    /// The tetrahedron was removed before.
    #[error("tetrahedron {tet} was removed before")]
    DeadTet {
        /// Which one.
        tet: TetId,
    },
    /// The edit names a tetrahedron twice.
    #[error("the edit names tetrahedron {tet} twice; each may be removed once")]
    RepeatedTet {
        /// Which one.
        tet: TetId,
    },
    /// There is no such node, or it has no tetrahedron left.
    #[error("there is no live node {node}: the mesh has {n_nodes}, numbered from 0, some of them dead")]
    NoSuchNode {
        /// The one named.
        node: NodeId,
        /// How many there are, dead ones included.
        n_nodes: usize,
    },
    /// A position is not a finite number.
    #[error("node {node} cannot go to {position_m} m: coordinates must be finite")]
    NotFinite {
        /// The node.
        node: NodeId,
        /// The position asked for [m].
        position_m: DVec3,
    },
    /// The edit would turn a tetrahedron inside out.
    #[error("moving node {node} would leave tetrahedron {tet} with {volume_m3:e} m3; it must stay above 0")]
    WouldInvert {
        /// The node.
        node: NodeId,
        /// The first tetrahedron that would be inside out.
        tet: TetId,
        /// Its volume after the move [m3].
        volume_m3: f64,
    },
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
}

impl EditableMesh {
    /// Takes a mesh over.
    ///
    /// # Errors
    /// [`TopologyError`] if it is no mesh.
    pub fn new(mesh: TetMesh) -> Result<Self, TopologyError> {
        let topology = Topology::build(&mesh)?;
        Ok(Self { mesh, topology })
    }

    /// Nodes at rest and tetrahedra, dead ones included.
    pub fn mesh(&self) -> &TetMesh {
        &self.mesh
    }

    /// The adjacency.
    pub fn topology(&self) -> &Topology {
        &self.topology
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
        match edit {
            MeshEdit::Remove { tets } => self.remove_into(tets, change),
            MeshEdit::MoveVertex { node, position_m } => self.move_node_into(*node, *position_m, change),
            MeshEdit::DuplicateVertex { .. }
            | MeshEdit::Split { .. }
            | MeshEdit::Collapse { .. }
            | MeshEdit::Retetrahedralise { .. } => {
                self.begin(change);
                Err(EditError::NotSupportedYet { edit: edit.name() })
            }
        }
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

    fn move_node_into(
        &mut self,
        node: NodeId,
        position_m: DVec3,
        change: &mut TopologyChange,
    ) -> Result<(), EditError> {
        self.begin(change);
        let n_nodes = self.topology.n_nodes();
        if node.index() >= n_nodes || !self.topology.is_live_node(node) {
            return Err(EditError::NoSuchNode { node, n_nodes });
        }
        if !position_m.is_finite() {
            return Err(EditError::NotFinite { node, position_m });
        }
        for &tet in self.topology.node_tets(node) {
            let mut corners_m = self.mesh.corners_m(tet);
            corners_m[self.topology.local_node(tet, node)] = position_m;
            let volume_m3 = tetrahedron_volume_m3(corners_m);
            if volume_m3 <= 0.0 {
                return Err(EditError::WouldInvert { node, tet, volume_m3 });
            }
        }
        self.mesh.positions_m[node.index()] = position_m;
        change.moved_nodes.push(node);
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
        change.set_counts_after(&self.topology);
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
        change.set_counts_before(&self.topology);
    }
}
