//! Changes of connectivity: every one is a [`MeshEdit`], and its [`TopologyChange`] tells all who keep data
//! by node, edge, triangle or tetrahedron how to follow.

/// What an edit did.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TopologyChange {}
