//! Each kind of edit on a case that can be followed by hand, and what each refuses.

use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::edit::{
    CavityNode, EdgeSplit, EditError, EditableMesh, MeshEdit, MeshUndo, NewNode, Replacement, TopologyChange,
};
use glisson_mesh::mesh::topology::{SingularEntities, StarGroups, Through};
use glisson_mesh::mesh::{EdgeId, NodeId, TetId, TetMesh};

use crate::mesh_edits::grid;
use crate::sample_edits::moved_and_divided;

fn one_tet() -> EditableMesh {
    let mesh = TetMesh {
        positions_m: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z],
        tetrahedra: vec![[0, 1, 2, 3].map(NodeId)],
        ..TetMesh::default()
    };
    EditableMesh::new(mesh).unwrap()
}

#[test]
fn split_of_one_edge_makes_two_of_one() {
    let mut body = one_tet();
    let change =
        body.apply(&MeshEdit::Split { edges: vec![EdgeSplit { edge: EdgeId(0), fraction: 0.25 }] }).unwrap();
    assert_eq!(change.tets.removed, [TetId(0)]);
    assert_eq!(change.tets.added.ids(), [1, 2].map(TetId));
    assert_eq!(change.tets.added.parents(1), [(TetId(0), 1.0)]);
    assert_eq!(change.nodes.added.parents(0), [(NodeId(0), 0.75), (NodeId(1), 0.25)]);
    assert_eq!(body.mesh().positions_m[4], DVec3::new(0.25, 0.0, 0.0));
    // Two halves of the edge, and one to each of the two nodes opposite; the old edge is dead.
    assert_eq!(change.edges.removed, [EdgeId(0)]);
    assert_eq!(change.edges.added.ids().len(), 4);
    // Two triangles divided, one between the halves, two untouched.
    assert_eq!((change.triangles.removed.len(), change.triangles.added.ids().len()), (2, 5));
    let volumes: Vec<f64> = [1, 2].map(|t| body.mesh().tet_volume_m3(TetId(t))).to_vec();
    assert!(
        (volumes[0] - 0.25 / 6.0).abs() < 1e-16 && (volumes[1] - 0.75 / 6.0).abs() < 1e-16,
        "{volumes:?}"
    );
}

#[test]
fn split_of_all_edges_matches_across_the_faces() {
    let mut body = EditableMesh::new(grid([2, 2, 2], |_| true)).unwrap();
    let n = body.topology().n_edges();
    let edges: Vec<EdgeSplit> =
        (0..n).map(|e| EdgeSplit { edge: EdgeId::from_index((e * 5) % n), fraction: 0.4 }).collect();
    assert!(!n.is_multiple_of(5), "each edge is named once");
    let volume = body.volume_m3();
    body.apply(&MeshEdit::Split { edges }).unwrap();
    // Six new nodes in a tetrahedron: four corners, and four around the inner octahedron's diagonal.
    assert_eq!(body.topology().live_counts().tets, 8 * 48);
    assert!((body.volume_m3() - volume).abs() < 1e-12);
    assert_eq!(body.topology().euler_characteristic(), 1);
    crate::mesh_edits::check_against_recount(body.topology());
}

#[test]
fn new_node_that_is_moved_takes_its_data_from_around_its_place() {
    let mut body = EditableMesh::new(grid([2, 2, 2], |_| true)).unwrap();
    let before = body.clone();
    let edge = body.topology().edge_between(NodeId(0), NodeId(13)).unwrap();
    // Split on the diagonal, then moved off it, within one of the tetrahedra there.
    for position_m in [DVec3::new(0.5, 0.45, 0.4), DVec3::new(0.4, 0.5, 0.45), DVec3::new(0.45, 0.4, 0.5)] {
        let edits = [
            MeshEdit::Split { edges: vec![EdgeSplit { edge, fraction: 0.5 }] },
            MeshEdit::MoveVertex { node: NodeId(27), position_m },
        ];
        let (mut change, mut undo) = (TopologyChange::default(), MeshUndo::default());
        body.apply_all_saving(&edits, &mut change, &mut undo).unwrap();
        assert!(change.moved_nodes.is_empty(), "a new node has no place to come from");
        let parents = change.nodes.added.parents(0);
        let place: DVec3 = parents.iter().map(|&(n, w)| w * before.mesh().positions_m[n.index()]).sum();
        assert!(place.distance(position_m) < 1e-15, "{place}");
        // The corners of the tetrahedron of the old mesh that holds the place, and no others.
        let weight: f64 = parents.iter().map(|p| p.1).sum();
        assert!((weight - 1.0).abs() < 1e-15 && parents.iter().all(|p| p.1 > -1e-15), "{parents:?}");
        body.undo(&undo);
        assert!(body == before);
    }
}

#[test]
fn duplicate_of_a_node_opens_the_faces_between() {
    // Two cells side by side; the four nodes between them get copies for the tetrahedra on the left.
    let mut body = EditableMesh::new(grid([2, 1, 1], |_| true)).unwrap();
    let left: Vec<TetId> = (0..6).map(TetId).collect();
    let at = |body: &EditableMesh, node: NodeId| -> Vec<TetId> {
        left.iter().copied().filter(|&t| body.topology().tet_nodes(t).contains(&node)).collect()
    };
    let middle = [1, 4, 7, 10].map(NodeId);
    let copies =
        middle.map(|node| glisson_mesh::mesh::edit::VertexCopy { node, tets: at(&body, node) }).to_vec();
    let change = body.apply(&MeshEdit::DuplicateVertices { copies: copies.clone() }).unwrap();
    assert!(change.pieces.through_faces.may_have_split && change.pieces.through_nodes.may_have_split);
    for through in [Through::Faces, Through::Nodes] {
        assert_eq!(body.topology().pieces(through).n_tets, [6, 6]);
    }
    assert_eq!(change.nodes.added.ids(), [12, 13, 14, 15].map(NodeId));
    assert_eq!(body.volume_m3(), 2.0);
    assert_eq!(body.topology().surface_euler_characteristic(), 4);

    // One at a time: only the last one parts the body, and what is sure is said.
    let mut body = EditableMesh::new(grid([2, 1, 1], |_| true)).unwrap();
    for (i, copy) in copies.iter().enumerate() {
        let on_left = |t: &TetId| body.mesh().corners_m(*t).iter().map(|p| p.x).sum::<f64>() < 4.0;
        let tets_of_copy = body.topology().node_tets(copy.node).iter().copied().filter(on_left).collect();
        let change = body.apply(&MeshEdit::DuplicateVertex { node: copy.node, tets_of_copy }).unwrap();
        assert_eq!(change.pieces.through_nodes.may_have_split, i == 3, "copy {i}");
        assert_eq!(body.topology().pieces(Through::Nodes).count(), if i == 3 { 2 } else { 1 });
    }
}

#[test]
fn collapse_takes_the_tetrahedra_at_the_edge_away() {
    let mut body = EditableMesh::new(grid([2, 2, 2], |_| true)).unwrap();
    // From the middle of a cell's diagonal back to an end of it: the split undone.
    let diagonal = body.topology().edge_between(NodeId(0), NodeId(13)).unwrap();
    body.apply(&MeshEdit::Split { edges: vec![EdgeSplit { edge: diagonal, fraction: 0.5 }] }).unwrap();
    let half = body.topology().edge_between(NodeId(0), NodeId(27)).unwrap();
    let volume = body.volume_m3();
    let position_m = body.mesh().positions_m[13];
    let other_half = body.topology().edge_between(NodeId(13), NodeId(27)).unwrap();
    let collapse = MeshEdit::Collapse { edge: other_half, kept: NodeId(13), position_m };
    let change = body.apply(&collapse).unwrap();
    assert_eq!(change.nodes.removed, [NodeId(27)]);
    assert_eq!((change.tets.removed.len(), change.tets.added.ids().len()), (12, 6));
    assert!(change.moved_nodes.is_empty());
    assert!((body.volume_m3() - volume).abs() < 1e-12);
    assert_eq!(body.topology().live_counts().tets, 48);
    assert!(!body.topology().is_live_edge(half));
    crate::mesh_edits::check_against_recount(body.topology());
}

#[test]
fn collapse_that_would_glue_is_refused() {
    // Through a wall: both ends on the surface, the edge inside.
    let mut body = EditableMesh::new(grid([1, 1, 1], |_| true)).unwrap();
    let edge = body.topology().edge_between(NodeId(0), NodeId(7)).unwrap();
    let position_m = body.mesh().positions_m[0];
    let collapse = MeshEdit::Collapse { edge, kept: NodeId(0), position_m };
    let refusal = body.apply(&collapse).unwrap_err();
    assert!(matches!(refusal, EditError::WouldPinch { .. }), "{refusal}");
    let mut single = one_tet();
    for e in 0..6 {
        let kept = single.topology().edge_nodes(EdgeId(e))[0];
        let position_m = single.mesh().positions_m[kept.index()];
        let refusal = single.apply(&MeshEdit::Collapse { edge: EdgeId(e), kept, position_m }).unwrap_err();
        assert!(matches!(refusal, EditError::WouldPinch { .. }), "{refusal}");
    }
    // A ring one cell wide: its rim cannot close up along a chord of three edges.
    let ring = EditableMesh::new(grid([3, 3, 1], |c| c != [1, 1, 0])).unwrap();
    let mut n_done = 0;
    for edge in ring.topology().live_edges() {
        let mut copy = ring.clone();
        let kept = copy.topology().edge_nodes(edge)[0];
        let position_m = copy.mesh().positions_m[kept.index()];
        if copy.apply(&MeshEdit::Collapse { edge, kept, position_m }).is_ok() {
            n_done += 1;
            assert_eq!(copy.topology().euler_characteristic(), 0);
            assert_eq!(copy.topology().surface_euler_characteristic(), 0);
        }
    }
    assert!(n_done > 0);
}

#[test]
fn flip_and_back() {
    let mut mesh = TetMesh {
        positions_m: vec![DVec3::X, DVec3::Y, -DVec3::X - DVec3::Y, DVec3::Z, -DVec3::Z],
        tetrahedra: vec![[0, 1, 2, 3].map(NodeId), [0, 2, 1, 4].map(NodeId)],
        ..TetMesh::default()
    };
    mesh.positions_m.iter_mut().for_each(|p| *p *= 0.01);
    let mut body = EditableMesh::new(mesh).unwrap();
    let old = |nodes: [u32; 4]| nodes.map(|n| CavityNode::Old(NodeId(n)));
    let three = vec![old([0, 1, 4, 3]), old([1, 2, 4, 3]), old([2, 0, 4, 3])];
    let flip = |tets: &[u32], new_tets: Vec<[CavityNode; 4]>| MeshEdit::Retetrahedralise {
        tets: tets.iter().copied().map(TetId).collect(),
        new_nodes: Vec::new(),
        new_tets,
    };
    let change = body.apply(&flip(&[0, 1], three.clone())).unwrap();
    assert_eq!(change.tets.added.parents(0), [(TetId(0), 0.5), (TetId(1), 0.5)]);
    assert_eq!((change.triangles.removed.len(), change.triangles.added.ids().len()), (1, 3));
    assert_eq!((change.edges.removed.len(), change.edges.added.ids().len()), (0, 1));
    let change = body.apply(&flip(&[2, 3, 4], vec![old([0, 1, 2, 3]), old([0, 2, 1, 4])])).unwrap();
    assert_eq!(change.edges.removed, [EdgeId(9)]);
    // A triangle whose nodes come together again is a new one: dead ids stay dead.
    assert_eq!(change.triangles.added.ids().len(), 1);
    assert_eq!(body.topology().live_counts().tets, 2);

    let two = |t: &[u32], new| body.clone().apply(&flip(t, new)).unwrap_err();
    assert!(matches!(two(&[5, 6], three[..2].to_vec()), EditError::OuterTriangleDiffers { .. }));
    let mut turned = three.clone();
    turned[0].swap(0, 1);
    assert!(matches!(two(&[5, 6], turned), EditError::OuterTriangleDiffers { .. }));
    assert!(matches!(two(&[5], three.clone()), EditError::OuterTriangleDiffers { .. }));
    let no_such_node = vec![old([0, 1, 9, 3])];
    assert!(matches!(two(&[5], no_such_node), EditError::BadCorners { place: 0, .. }));
    assert!(matches!(two(&[5, 5], three.clone()), EditError::RepeatedTet { .. }));
    let mut repeated = three;
    repeated[2] = old([0, 1, 1, 3]);
    assert!(matches!(two(&[5, 6], repeated), EditError::BadCorners { place: 2, .. }));
}

/// The first tetrahedron becomes four around a new node.
fn first_divided_at(whole: &EditableMesh, parents: &[(u32, f64)], position_m: DVec3) -> MeshEdit {
    let corners = whole.topology().tet_nodes(TetId(0));
    MeshEdit::Retetrahedralise {
        tets: vec![TetId(0)],
        new_nodes: vec![NewNode {
            position_m,
            parents: parents.iter().map(|&(n, w)| (NodeId(n), w)).collect(),
        }],
        new_tets: (0..4)
            .map(|at| {
                let mut part = corners.map(CavityNode::Old);
                part[at] = CavityNode::New(0);
                part
            })
            .collect(),
    }
}

#[test]
fn unfit_edits_are_refused_with_the_reason() {
    let whole = EditableMesh::new(grid([2, 2, 2], |_| true)).unwrap();
    let refused = |edit: MeshEdit| {
        let mut body = whole.clone();
        let error = body.apply(&edit).unwrap_err();
        assert!(body == whole, "{edit:?}");
        error
    };
    let split = |edges: &[(u32, f64)]| MeshEdit::Split {
        edges: edges.iter().map(|&(e, fraction)| EdgeSplit { edge: EdgeId(e), fraction }).collect(),
    };
    let n_edges = whole.topology().n_edges();
    assert_eq!(
        refused(split(&[(1, 0.5), (n_edges as u32, 0.5)])),
        EditError::NoSuchEdge { edge: EdgeId(n_edges as u32), n_edges }
    );
    for fraction in [0.0, 1.0, -1.0] {
        assert_eq!(refused(split(&[(1, fraction)])), EditError::BadFraction { edge: EdgeId(1), fraction });
    }
    assert!(matches!(refused(split(&[(1, f64::NAN)])), EditError::BadFraction { .. }));
    assert_eq!(refused(split(&[(1, 0.5), (2, 0.5), (1, 0.2)])), EditError::RepeatedEdge { edge: EdgeId(1) });
    // So near to the end that rounding takes the new node there.
    let edge = whole.topology().edge_between(NodeId(13), NodeId(26)).unwrap();
    assert!(matches!(refused(split(&[(edge.0, 1e-17)])), EditError::FlatTet { .. }));

    let node = NodeId(13);
    let star = whole.topology().node_tets(node).to_vec();
    let copy = |tets: &[TetId]| MeshEdit::DuplicateVertex { node, tets_of_copy: tets.to_vec() };
    let n_tets = star.len();
    assert_eq!(refused(copy(&star)), EditError::NoPartOfStar { node, n_copied: n_tets, n_tets });
    assert_eq!(refused(copy(&[])), EditError::NoPartOfStar { node, n_copied: 0, n_tets });
    assert_eq!(refused(copy(&[star[0], star[1], star[0]])), EditError::RepeatedTet { tet: star[0] });
    let away = whole.topology().live_tets().find(|t| !star.contains(t)).unwrap();
    assert_eq!(refused(copy(&[away])), EditError::NotAtNode { tet: away, node });

    let cavity = |parents: &[(u32, f64)], position_m: DVec3| first_divided_at(&whole, parents, position_m);
    let middle = whole.mesh().corners_m(TetId(0)).iter().sum::<DVec3>() * 0.25;
    assert_eq!(refused(cavity(&[], middle)), EditError::BadNewNode { place: 0, sum: 0.0 });
    assert_eq!(refused(cavity(&[(0, 0.5)], middle)), EditError::BadNewNode { place: 0, sum: 0.5 });
    assert!(matches!(refused(cavity(&[(0, 1.0)], middle + DVec3::X)), EditError::FlatTet { .. }));
    let edge = EdgeId(0);
    let far = NodeId(26);
    assert_eq!(
        refused(MeshEdit::Collapse { edge, kept: far, position_m: middle }),
        EditError::NotAnEnd { edge, node: far }
    );
}

#[test]
fn star_falls_into_groups_at_hinges_and_ball_joints() {
    let hinge = EditableMesh::new(grid([2, 2, 1], |c| c[0] == c[1])).unwrap();
    let mut groups = StarGroups::default();
    hinge.topology().star_groups_into(NodeId(4), &mut groups);
    assert_eq!(groups.count, 2);
    let of_second = hinge.topology().node_tets(NodeId(4)).iter().map(|t| u32::from(t.0 >= 6));
    assert!(groups.of_tet.iter().copied().eq(of_second));
    let all: Vec<NodeId> = hinge.topology().live_nodes().collect();
    let edge = hinge.topology().edge_between(NodeId(4), NodeId(13)).unwrap();
    assert_eq!(
        hinge.topology().singular_entities(&all),
        SingularEntities { nodes: vec![NodeId(4), NodeId(13)], edges: vec![edge] }
    );
    let joint = EditableMesh::new(grid([2, 2, 2], |c| c == [0; 3] || c == [1; 3])).unwrap();
    let all: Vec<NodeId> = joint.topology().live_nodes().collect();
    assert_eq!(
        joint.topology().singular_entities(&all),
        SingularEntities { nodes: vec![NodeId(13)], edges: Vec::new() }
    );
    let whole = EditableMesh::new(grid([2, 2, 2], |_| true)).unwrap();
    let all: Vec<NodeId> = whole.topology().live_nodes().collect();
    assert!(whole.topology().singular_entities(&all).is_empty());
    // A cut along the faces at x = 1 alone: the star of the middle node falls in two.
    whole.topology().star_groups_across_into(
        NodeId(13),
        |tet, face| {
            let nodes = whole.topology().triangle_nodes(whole.topology().tet_triangles(tet)[face]);
            nodes.iter().any(|n| whole.mesh().positions_m[n.index()].x != 1.0)
        },
        &mut groups,
    );
    assert_eq!(groups.count, 2);
}

/// Parts all singular places of `cells` and checks that nothing else happened.
fn parted(keep: impl Fn([usize; 3]) -> bool, size: [usize; 3]) -> (EditableMesh, TopologyChange) {
    let mut body = EditableMesh::new(grid(size, keep)).unwrap();
    let before = body.clone();
    let all: Vec<NodeId> = body.topology().live_nodes().collect();
    let (mut change, mut undo) = (TopologyChange::default(), MeshUndo::default());
    let edits = body.parting_edits(all);
    body.apply_all_saving(&edits, &mut change, &mut undo).unwrap();
    crate::mesh_edits::check_against_recount(body.topology());
    assert!(body.topology().pinches().is_empty(), "{:?}", body.topology().pinches());
    assert!((body.volume_m3() - before.volume_m3()).abs() < 1e-12);
    let mut back = body.clone();
    back.undo(&undo);
    assert!(back == before);
    (body, change)
}

#[test]
fn singular_places_are_parted() {
    // Hinge by an edge: two nodes are copied, two pieces.
    let (body, change) = parted(|c| c[0] == c[1], [2, 2, 1]);
    assert_eq!(change.nodes.added.ids().len(), 2);
    assert!(change.pieces.through_nodes.may_have_split && change.pieces.through_faces.is_settled());
    assert_eq!(body.topology().pieces(Through::Nodes).n_tets, [6, 6]);
    // By a node: one.
    let (body, change) = parted(|c| c == [0; 3] || c == [1; 3], [2, 2, 2]);
    assert_eq!(change.nodes.added.ids().len(), 1);
    assert_eq!(body.topology().pieces(Through::Nodes).n_tets, [6, 6]);
    // A hinge at whose ends the two sides hang together by faces: a slot between two beams is closed by a bridge
    // above and one below. The edge gets a middle, which is copied; one piece stays.
    let slot = |c: [usize; 3]| c[2] != 1 || c[0] == c[1];
    let (body, change) = parted(slot, [2, 2, 3]);
    assert_eq!(change.nodes.added.ids().len(), 2);
    assert_eq!(body.topology().pieces(Through::Faces).count(), 1);
    // A whole body has none: nothing happens.
    let (_, change) = parted(|_| true, [2, 2, 2]);
    assert!(change.nodes.added.ids().is_empty() && change.tets.removed.is_empty());
}

#[test]
fn a_removal_parts_the_hinge_that_it_leaves() {
    let mut body = EditableMesh::new(grid([2, 2, 1], |_| true)).unwrap();
    let before = body.clone();
    let in_corner = |p: DVec3| (p.x < 1.0) != (p.y < 1.0);
    let tets: Vec<TetId> = body
        .topology()
        .live_tets()
        .filter(|&t| in_corner(body.mesh().corners_m(t).into_iter().sum::<DVec3>() / 4.0))
        .collect();
    let edits = body.parting_removal(tets.clone()).unwrap();
    assert!(body == before, "a plan changes nothing");
    assert!(edits[0] == MeshEdit::Remove { tets: tets.clone() } && edits.len() == 2);
    let (mut change, mut undo) = (TopologyChange::default(), MeshUndo::default());
    body.apply_all_saving(&edits, &mut change, &mut undo).unwrap();
    crate::mesh_edits::check_against_recount(body.topology());
    assert!(tets.iter().all(|t| change.tets.removed.contains(t)));
    let live: Vec<NodeId> = body.topology().live_nodes().collect();
    assert!(body.topology().singular_entities(&live).is_empty());
    assert_eq!(body.topology().pieces(Through::Nodes).n_tets, [6, 6]);
    body.undo(&undo);
    assert!(body == before);
    // One that leaves no such place is alone; one that cannot be done is refused as ever.
    assert_eq!(body.parting_removal(vec![tets[0]]).unwrap().len(), 1);
    assert!(body.parting_removal(vec![TetId(9999)]).is_err());
    assert!(body == before);
}

#[test]
fn singular_places_after_a_removal_are_near_it() {
    let mut body = EditableMesh::new(grid([2, 2, 1], |_| true)).unwrap();
    // Take two opposite cells out: a hinge along the middle edge is left.
    let at = |x: f64, y: f64| {
        let mesh = body.mesh();
        let inside = move |p: DVec3| (p.x - x).abs() < 0.5 && (p.y - y).abs() < 0.5;
        body.topology()
            .live_tets()
            .filter(|&t| inside(mesh.corners_m(t).iter().sum::<DVec3>() * 0.25))
            .collect::<Vec<TetId>>()
    };
    let tets = [at(0.5, 1.5), at(1.5, 0.5)].concat();
    assert_eq!(tets.len(), 12);
    let change = body.apply(&MeshEdit::Remove { tets }).unwrap();
    let near = body.topology().nodes_near(&change);
    let all: Vec<NodeId> = body.topology().live_nodes().collect();
    let found = body.topology().singular_entities(&near);
    assert_eq!(found, body.topology().singular_entities(&all));
    assert_eq!((found.nodes.len(), found.edges.len()), (2, 1));
}

#[test]
fn moves_that_cannot_be_are_refused() {
    let mut body = EditableMesh::new(grid([2, 2, 2], |_| true)).unwrap();
    let before = body.clone();
    let inner = NodeId(13);
    let tet = body.topology().node_tets(inner)[0];
    let whole = |body: &EditableMesh| {
        let MeshEdit::Replace(edit) = moved_and_divided(body, tet) else { panic!("a replacement") };
        edit
    };
    let bad: [fn(&mut Replacement); 6] = [
        |edit| edit.moved_nodes[0].parents[0].1 = 0.5,
        |edit| edit.moved_nodes[0].parents.clear(),
        |edit| edit.moved_nodes[0].node = NodeId(1000),
        |edit| edit.moved_nodes[0].parents[0].0 = NodeId(1000),
        |edit| edit.moved_nodes[0].position_m.x = f64::NAN,
        |edit| edit.moved_nodes.push(edit.moved_nodes[0].clone()),
    ];
    for spoil in bad {
        let mut edit = whole(&body);
        spoil(&mut edit);
        let refusal = body.apply(&MeshEdit::Replace(edit)).unwrap_err();
        assert!(matches!(refusal, EditError::BadMove { .. }), "{refusal}");
        assert!(body == before);
    }
    // Far out, tetrahedra that stay would be turned inside out.
    let mut edit = whole(&body);
    edit.moved_nodes[0].position_m += DVec3::splat(9.0);
    assert!(matches!(body.apply(&MeshEdit::Replace(edit)), Err(EditError::FlatTet { .. })));
    assert!(body == before);
}
