//! Random sequences of all edits: after each the topology is that of a recount, and taking them back gives
//! what was there before, bit for bit.

use glisson_mesh::math::{DVec3, SeededRandom};
use glisson_mesh::mesh::edit::{
    CavityNode, EdgeSplit, EditError, EditableMesh, MeshEdit, MeshUndo, NewNode, TopologyChange, VertexCopy,
};
use glisson_mesh::mesh::remap::follow_in_tissue;
use glisson_mesh::mesh::topology::Topology;
use glisson_mesh::mesh::{EdgeId, NodeId, TetId, TetMesh};
use proptest::prelude::*;

use crate::mesh_edits::{check_against_recount, check_change, grid};
use crate::sample_edits::moved_and_divided;

fn pick<T: Copy>(random: &mut SeededRandom, items: &[T]) -> T {
    items[(random.next_u64() % items.len() as u64) as usize]
}

/// A block, a slab one cell thick, or a rough ball, all with their nodes shaken.
fn body(kind: usize, random: &mut SeededRandom) -> TetMesh {
    let mut mesh = match kind {
        0 => grid([3, 2, 2], |_| true),
        1 => grid([4, 4, 1], |_| true),
        _ => grid([4, 4, 4], |c| c.map(|i| (i as f64 - 1.5).powi(2)).iter().sum::<f64>() < 4.0),
    };
    for p in &mut mesh.positions_m {
        *p += 0.1 * DVec3::new(random.uniform(), random.uniform(), random.uniform());
    }
    mesh
}

/// Some edit of a random kind; it may be one that is refused.
fn random_edit(random: &mut SeededRandom, body: &EditableMesh) -> MeshEdit {
    let t = body.topology();
    let tets: Vec<TetId> = t.live_tets().collect();
    let nodes: Vec<NodeId> = t.live_nodes().collect();
    let edges: Vec<EdgeId> = t.live_edges().collect();
    let place = |n: NodeId| body.mesh().positions_m[n.index()];
    match random.next_u64() % 10 {
        0 => MeshEdit::Remove { tets: vec![pick(random, &tets)] },
        1 => {
            let node = pick(random, &nodes);
            MeshEdit::DuplicateVertex { node, tets_of_copy: half_star(random, body, node) }
        }
        2 => {
            let mut copies: Vec<VertexCopy> = Vec::new();
            for _ in 0..3 {
                let node = pick(random, &nodes);
                if copies.iter().all(|c| c.node != node) {
                    copies.push(VertexCopy { node, tets: half_star(random, body, node) });
                }
            }
            MeshEdit::DuplicateVertices { copies }
        }
        3 => {
            let node = pick(random, &nodes);
            let by = DVec3::new(random.uniform(), random.uniform(), random.uniform()) - 0.5;
            MeshEdit::MoveVertex { node, position_m: place(node) + 0.3 * by }
        }
        4 | 5 => {
            let around = t.tet_edges(pick(random, &tets));
            random_splits(random, &around, &edges)
        }
        6 => {
            let edge = pick(random, &edges);
            let ends = t.edge_nodes(edge);
            let kept = pick(random, &ends);
            let position_m =
                if random.uniform() < 0.5 { place(kept) } else { 0.5 * (place(ends[0]) + place(ends[1])) };
            MeshEdit::Collapse { edge, kept, position_m }
        }
        7 => divided_in_four(body, pick(random, &tets)),
        8 => moved_and_divided(body, pick(random, &tets)),
        _ => flip(random, t, &tets),
    }
}

/// Up to five splits, most of them of edges of one tetrahedron.
fn random_splits(random: &mut SeededRandom, around: &[EdgeId], edges: &[EdgeId]) -> MeshEdit {
    let mut splits: Vec<EdgeSplit> = Vec::new();
    for _ in 0..1 + random.next_u64() % 5 {
        let edge = if random.uniform() < 0.7 { pick(random, around) } else { pick(random, edges) };
        if splits.iter().all(|s| s.edge != edge) {
            splits.push(EdgeSplit { edge, fraction: 0.2 + 0.6 * random.uniform() });
        }
    }
    MeshEdit::Split { edges: splits }
}

/// A node inside: one tetrahedron becomes four.
fn divided_in_four(body: &EditableMesh, tet: TetId) -> MeshEdit {
    let corners = body.topology().tet_nodes(tet);
    let parents = corners.map(|n| (n, 0.25));
    let position_m = corners.map(|n| body.mesh().positions_m[n.index()]).iter().sum::<DVec3>() * 0.25;
    let new_tets = (0..4).map(|at| {
        let mut part = corners.map(CavityNode::Old);
        part[at] = CavityNode::New(0);
        part
    });
    let new_nodes = vec![NewNode { position_m, parents: parents.to_vec() }];
    MeshEdit::Retetrahedralise { tets: vec![tet], new_nodes, new_tets: new_tets.collect() }
}

/// Two neighbours become three tetrahedra around the line between their far corners.
fn flip(random: &mut SeededRandom, t: &Topology, tets: &[TetId]) -> MeshEdit {
    let tet = pick(random, tets);
    let corners = t.tet_nodes(tet);
    for at in 0..4 {
        let Some(other) = t.tet_neighbours(tet)[at].get() else { continue };
        let far = t.tet_nodes(other).into_iter().find(|n| !corners.contains(n)).unwrap();
        let new_tets = (0..4).filter(|&k| k != at).map(|k| {
            let mut part = corners;
            part[k] = far;
            part.map(CavityNode::Old)
        });
        return MeshEdit::Retetrahedralise {
            tets: vec![tet, other],
            new_nodes: Vec::new(),
            new_tets: new_tets.collect(),
        };
    }
    MeshEdit::Remove { tets: vec![tet] }
}

fn half_star(random: &mut SeededRandom, body: &EditableMesh, node: NodeId) -> Vec<TetId> {
    let normal = DVec3::new(random.uniform(), random.uniform(), random.uniform()) - 0.5;
    let center = body.mesh().positions_m[node.index()];
    let star = body.topology().node_tets(node).iter().copied();
    star.filter(|&tet| {
        let mean_m: DVec3 = body.mesh().corners_m(tet).iter().sum::<DVec3>() * 0.25;
        (mean_m - center).dot(normal) > 0.0
    })
    .collect()
}

fn check_parents(before: &EditableMesh, after: &EditableMesh, change: &TopologyChange, keeps_volume: bool) {
    let mut places = before.mesh().positions_m.clone();
    follow_in_tissue(&mut places, change);
    let moved =
        change.moved_nodes.iter().zip(&change.moved_parents).filter(|(_, parents)| !parents.is_empty());
    for &node in change.nodes.added.ids().iter().chain(moved.map(|(node, _)| node)) {
        let found = after.mesh().positions_m[node.index()];
        assert!(places[node.index()].distance(found) < 1e-12, "{node}: {} {found}", places[node.index()]);
    }
    for (node, parents) in change.nodes.added.iter() {
        assert!(parents.iter().all(|p| before.topology().is_live_node(p.0)), "{node} {parents:?}");
    }
    let mut filled: std::collections::BTreeMap<TetId, f64> = Default::default();
    for (tet, parents) in change.tets.added.iter() {
        let sum: f64 = parents.iter().map(|p| p.1).sum();
        assert!((sum - 1.0).abs() < 1e-12, "{tet} {parents:?}");
        for &(parent, weight) in parents {
            let has_other_shape =
                change.tets.removed.contains(&parent) || change.reshaped_tets.contains(&parent);
            assert!(has_other_shape, "{tet} {parents:?}");
            *filled.entry(parent).or_default() += weight * after.mesh().tet_volume_m3(tet);
        }
    }
    if keeps_volume {
        for &tet in &change.tets.removed {
            let (was, is) = (before.mesh().tet_volume_m3(tet), filled.get(&tet).copied().unwrap_or_default());
            assert!((was - is).abs() < 1e-12, "{tet}: {was} {is}");
        }
    }
    let mut moved: Vec<(NodeId, DVec3)> = Vec::new();
    for n in before.topology().live_nodes().filter(|&n| after.topology().is_live_node(n)) {
        if before.mesh().positions_m[n.index()] != after.mesh().positions_m[n.index()] {
            moved.push((n, before.mesh().positions_m[n.index()]));
        }
    }
    let named: Vec<_> = change.moved_nodes.iter().copied().zip(change.moved_from_m.iter().copied()).collect();
    assert_eq!(named, moved);
    let is_moved = |n: &NodeId| change.moved_nodes.contains(n);
    let live = before.topology().live_tets().filter(|&t| after.topology().is_live_tet(t));
    let reshaped: Vec<_> = live.filter(|&t| after.topology().tet_nodes(t).iter().any(is_moved)).collect();
    assert_eq!(change.reshaped_tets, reshaped);
}

fn check_shape(body: &EditableMesh) {
    check_against_recount(body.topology());
    for tet in body.topology().live_tets() {
        assert!(body.mesh().tet_volume_m3(tet) > 0.0);
        assert_eq!(body.topology().tet_nodes(tet), body.mesh().tetrahedra[tet.index()]);
    }
    let fresh = Topology::build(&body.live_mesh()).expect("what is live is a mesh");
    let live = body.topology().live_counts();
    assert_eq!(fresh.live_counts(), live);
    assert_eq!(fresh.n_surface_triangles(), body.topology().n_surface_triangles());
    assert_eq!(fresh.euler_characteristic(), body.topology().euler_characteristic());
    assert_eq!(fresh.surface_euler_characteristic(), body.topology().surface_euler_characteristic());
}

/// Whether an edit moves no volume from one tetrahedron to another.
fn is_conservative(edit: &MeshEdit) -> bool {
    matches!(
        edit,
        MeshEdit::Split { .. }
            | MeshEdit::DuplicateVertex { .. }
            | MeshEdit::DuplicateVertices { .. }
            | MeshEdit::Retetrahedralise { .. }
    )
}

/// Applies one edit. Whether it is conservative; `None` when it is refused, which changes nothing.
fn apply_one(
    random: &mut SeededRandom,
    editable: &mut EditableMesh,
    change: &mut TopologyChange,
    undo: &mut MeshUndo,
) -> Result<Option<bool>, TestCaseError> {
    let before = editable.clone();
    let edit = random_edit(random, editable);
    let euler = before.topology().euler_characteristic();
    if editable.apply_saving(&edit, change, undo).is_err() {
        prop_assert!(*editable == before);
        return Ok(None);
    }
    let keeps_euler = !matches!(
        edit,
        MeshEdit::Remove { .. } | MeshEdit::DuplicateVertex { .. } | MeshEdit::DuplicateVertices { .. }
    );
    if keeps_euler {
        prop_assert_eq!(editable.topology().euler_characteristic(), euler, "{:?}", edit);
    }
    Ok(Some(is_conservative(&edit)))
}

/// Applies a list, each edit made for what those before it left. Whether all are conservative.
fn apply_list(
    random: &mut SeededRandom,
    editable: &mut EditableMesh,
    change: &mut TopologyChange,
    undo: &mut MeshUndo,
) -> Result<bool, TestCaseError> {
    let mut ahead = editable.clone();
    let mut edits = Vec::new();
    for _ in 0..4 {
        if ahead.topology().live_counts().tets == 0 {
            break;
        }
        let edit = random_edit(random, &ahead);
        if ahead.apply(&edit).is_ok() {
            edits.push(edit);
        }
    }
    editable.apply_all_saving(&edits, change, undo).unwrap();
    prop_assert_eq!(editable.topology().live_counts(), ahead.topology().live_counts());
    prop_assert!((editable.volume_m3() - ahead.volume_m3()).abs() < 1e-12);
    // Provisional ids lead to the same tetrahedra.
    for (at, id) in change.tets.provisional_ids.iter().enumerate() {
        let provisional = TetId::from_index(change.tets.n_before + at);
        prop_assert_eq!(ahead.topology().is_live_tet(provisional), id.is_some());
        if let Some(id) = id {
            prop_assert_eq!(editable.mesh().corners_m(*id), ahead.mesh().corners_m(provisional));
        }
    }
    Ok(edits.iter().all(is_conservative))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 16, ..ProptestConfig::default() })]

    #[test]
    fn any_sequence_of_edits_is_right_and_can_be_taken_back(seed in any::<u64>(), kind in 0usize..3) {
        let mut random = SeededRandom::new(seed);
        let mut editable = EditableMesh::new(body(kind, &mut random)).unwrap();
        let mut change = TopologyChange::default();
        let mut journal: Vec<(EditableMesh, MeshUndo)> = Vec::new();
        for _ in 0..12 {
            if editable.topology().live_counts().tets == 0 {
                break;
            }
            let before = editable.clone();
            let mut undo = MeshUndo::default();
            let conservative = if random.uniform() < 0.5 {
                match apply_one(&mut random, &mut editable, &mut change, &mut undo)? {
                    Some(conservative) => conservative,
                    None => continue,
                }
            } else {
                apply_list(&mut random, &mut editable, &mut change, &mut undo)?
            };
            check_shape(&editable);
            check_change(before.topology(), editable.topology(), &change);
            check_parents(&before, &editable, &change, conservative);
            journal.push((before, undo));
        }
        for (before, undo) in journal.iter().rev() {
            editable.undo(undo);
            prop_assert!(editable == *before);
        }
        check_shape(&editable);
    }
}

#[test]
fn list_with_a_refused_edit_changes_nothing() {
    let mut editable = EditableMesh::new(grid([2, 2, 2], |_| true)).unwrap();
    let before = editable.clone();
    let edits = [
        MeshEdit::Split { edges: vec![EdgeSplit { edge: EdgeId(3), fraction: 0.5 }] },
        MeshEdit::MoveVertex {
            node: NodeId(27),
            position_m: before.mesh().positions_m[0] + DVec3::splat(0.1),
        },
        MeshEdit::Remove { tets: vec![TetId(0), TetId(0)] },
    ];
    let (mut change, mut undo) = (TopologyChange::default(), MeshUndo::default());
    let refusal = editable.apply_all_saving(&edits, &mut change, &mut undo).unwrap_err();
    assert!(matches!(refusal, EditError::InList { at: 1 | 2, .. }), "{refusal}");
    assert!(editable == before);
    assert_eq!(change.nodes.added.ids(), []);
    editable.undo(&undo);
    assert!(editable == before);
}
