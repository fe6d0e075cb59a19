//! Edits that tests of meshes and of models make.

use glisson_mesh::mesh::TetId;
use glisson_mesh::mesh::edit::{CavityNode, EditableMesh, MeshEdit, MovedNode, NewNode, NewTet, Replacement};

/// A corner of a tetrahedron moves towards another, and the tetrahedron becomes four.
pub(crate) fn moved_and_divided(body: &EditableMesh, tet: TetId) -> MeshEdit {
    let corners @ [a, b, c, d] = body.topology().tet_nodes(tet);
    let [a_m, b_m, c_m, d_m] = body.mesh().corners_m(tet);
    let to_m = 0.9 * a_m + 0.1 * b_m;
    let parents = vec![(a, 0.225), (b, 0.275), (c, 0.25), (d, 0.25)];
    let part = |at: usize| {
        let mut corners = corners.map(CavityNode::Old);
        corners[at] = CavityNode::New(0);
        NewTet { corners, parents: Vec::new() }
    };
    MeshEdit::Replace(Replacement {
        tets: vec![tet],
        new_nodes: vec![NewNode { position_m: 0.25 * (to_m + b_m + c_m + d_m), parents }],
        moved_nodes: vec![MovedNode { node: a, position_m: to_m, parents: vec![(a, 0.9), (b, 0.1)] }],
        new_tets: (0..4).map(part).collect(),
    })
}
