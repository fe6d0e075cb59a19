//! Why an edit was refused.

use crate::fault::OrderedFault;
use crate::math::DVec3;
use crate::mesh::{EdgeId, NodeId, TetId};

/// Why an edit was refused. Nothing changed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EditError {
    /// Only in tests.
    #[error(transparent)]
    Ordered(#[from] OrderedFault),
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
    #[error("the edit names tetrahedron {tet} twice; it may be named once")]
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
    /// There is no such edge, or it has no tetrahedron left.
    #[error("there is no live edge {edge}: the mesh has {n_edges}, numbered from 0, some of them dead")]
    NoSuchEdge {
        /// The one named.
        edge: EdgeId,
        /// How many there are, dead ones included.
        n_edges: usize,
    },
    /// A split names an edge twice.
    #[error("the split names edge {edge} twice; it may be named once: split the parts in a second edit")]
    RepeatedEdge {
        /// Which one.
        edge: EdgeId,
    },
    /// A split would put its node on an end of the edge, or outside.
    #[error(
        "edge {edge} cannot be split at {fraction}: the fraction must lie between 0 and 1, both excluded"
    )]
    BadFraction {
        /// The edge.
        edge: EdgeId,
        /// Where it was to be split.
        fraction: f64,
    },
    /// A tetrahedron would come in flat or inside out.
    #[error("a new tetrahedron over nodes {}, {}, {}, {} would have {volume_m3:e} m3; it must stay above 0",
        nodes[0], nodes[1], nodes[2], nodes[3])]
    FlatTet {
        /// Its nodes; those from the present number of nodes on are the edit's new ones.
        nodes: [NodeId; 4],
        /// Its volume [m3].
        volume_m3: f64,
    },
    /// A tetrahedron is to get a copy of a node that it does not have.
    #[error("tetrahedron {tet} is to get a copy of node {node}, which is none of its corners")]
    NotAtNode {
        /// The tetrahedron.
        tet: TetId,
        /// The node.
        node: NodeId,
    },
    /// Copies of a node would take all of its tetrahedra or none.
    #[error(
        "a copy of node {node} takes {n_copied} of its {n_tets} tetrahedra; some must go and some must stay"
    )]
    NoPartOfStar {
        /// The node.
        node: NodeId,
        /// How many tetrahedra the copies take.
        n_copied: usize,
        /// How many there are at the node.
        n_tets: usize,
    },
    /// The node to keep is no end of the edge.
    #[error("edge {edge} does not end in node {node}: keep one of its two nodes")]
    NotAnEnd {
        /// The edge.
        edge: EdgeId,
        /// The node.
        node: NodeId,
    },
    /// Pulling the ends of an edge together would glue what is apart, or pinch the mesh.
    #[error("edge {edge} cannot be collapsed: both of its ends are joined to node {}, or to the surface, without \
        the edge being so, which would change the shape's connectedness", nodes[0])]
    WouldPinch {
        /// The edge.
        edge: EdgeId,
        /// One to three nodes that both ends are joined to by an edge, a triangle or a tetrahedron.
        nodes: Vec<NodeId>,
    },
    /// The new tetrahedra have other outer triangles than the old ones.
    #[error("triangle ({}, {}, {}) does not bound both the old and the new tetrahedra from the same side",
        nodes[0], nodes[1], nodes[2])]
    OuterTriangleDiffers {
        /// Its nodes, counter-clockwise seen from outside.
        nodes: [NodeId; 3],
    },
    /// The new tetrahedra fill another volume than the old ones.
    #[error(
        "the new tetrahedra fill {new_m3:e} m3, the old ones {old_m3:e} m3: they overlap or leave a hole"
    )]
    VolumeDiffers {
        /// Volume of the tetrahedra that were to go [m3].
        old_m3: f64,
        /// Volume of those that were to come [m3].
        new_m3: f64,
    },
    /// A new tetrahedron names a node that it may not have.
    #[error(
        "new tetrahedron {place}: its corners must be four different nodes, live \
        old ones or new ones from the edit's list of {n_new}"
    )]
    BadCorners {
        /// Its place in the edit's list.
        place: usize,
        /// How many new nodes the edit has.
        n_new: usize,
    },
    /// A new node has no tetrahedron, no parents that are there, or weights that do not add up to 1.
    #[error(
        "new node {place}: it must be finite, a corner of a new tetrahedron, and have live parents with \
        weights of sum 1 (found {sum})"
    )]
    BadNewNode {
        /// Its place in the edit's list.
        place: usize,
        /// Sum of its parents' weights.
        sum: f64,
    },
    /// A node cannot go where the edit puts it.
    #[error(
        "{node} cannot move: it must be live, named once, go to a finite place, keep a tetrahedron, and come from \
        live nodes with weights of sum 1 (found {sum})"
    )]
    BadMove {
        /// The node.
        node: NodeId,
        /// Sum of the weights.
        sum: f64,
    },
    /// A new tetrahedron has parents that neither make room nor get another shape, or shares that do not add up to 1.
    #[error(
        "new tetrahedron {place} has parents that are neither replaced nor reshaped, or shares of sum {sum} instead of 1"
    )]
    BadParents {
        /// Its place in the edit.
        place: usize,
        /// Sum of the shares.
        sum: f64,
    },
    /// One of a list of edits was refused, and with it the list.
    #[error("edit {at} of the list, `{edit}`: {cause}")]
    InList {
        /// Its place in the list.
        at: usize,
        /// Name of its kind.
        edit: &'static str,
        /// Why.
        cause: Box<EditError>,
    },
}
