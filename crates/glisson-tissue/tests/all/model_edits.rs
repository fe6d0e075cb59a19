//! Models after random edits of the mesh equal models built afresh from the edited mesh; undone edits leave no trace.

mod bodies;
mod composite;
mod steps;
mod undo;

use glisson_mesh::math::{DMat3, DVec3, SeededRandom};
use glisson_mesh::mesh::edit::{
    CavityNode, EdgeSplit, EditableMesh, MeshEdit, MeshUndo, NewNode, TopologyChange,
};
use glisson_mesh::mesh::{EdgeId, NodeId, TetId, TetMesh};
use glisson_tissue::model::{Constraints, DeformableModel, ImposedDisplacement};

use crate::model_meshes::{relative_difference, rounded_block, shaken_block};
use crate::sample_edits::moved_and_divided;
use bodies::{Body, Kind, kinds};

/// A block, a slab one cell thick, or a rounded body.
fn mesh_of(kind: usize, seed: u64) -> TetMesh {
    match kind {
        0 => shaken_block([3, 2, 2], DVec3::new(0.08, 0.05, 0.05), 0.1, seed),
        1 => shaken_block([4, 3, 1], DVec3::new(0.1, 0.08, 0.02), 0.1, seed),
        _ => rounded_block([3, 3, 2], DVec3::new(0.1, 0.09, 0.06)),
    }
}

/// Enough tetrahedra for several parts of the fast kernel.
fn large_mesh() -> TetMesh {
    rounded_block([4, 4, 3], DVec3::new(0.12, 0.1, 0.08))
}

fn pick<T: Copy>(random: &mut SeededRandom, items: &[T]) -> T {
    items[(random.next_u64() % items.len() as u64) as usize]
}

/// Some edit of a kind from 0 to 6; it may be one that is refused.
fn random_edit(random: &mut SeededRandom, mesh: &EditableMesh, kind: u64) -> MeshEdit {
    let topology = mesh.topology();
    let tets: Vec<TetId> = topology.live_tets().collect();
    let place_m = |n: NodeId| mesh.mesh().positions_m[n.index()];
    let tet = pick(random, &tets);
    let corners = topology.tet_nodes(tet);
    let edge = pick(random, &topology.tet_edges(tet));
    let ends = topology.edge_nodes(edge);
    let length_m = place_m(ends[0]).distance(place_m(ends[1]));
    match kind {
        0 => MeshEdit::Remove { tets: vec![tet] },
        1 => {
            let normal = DVec3::new(random.normal(), random.normal(), random.normal());
            let node = corners[0];
            let is_above = |t: &TetId| {
                let mean_m = mesh.mesh().corners_m(*t).into_iter().sum::<DVec3>() / 4.0;
                (mean_m - place_m(node)).dot(normal) > 0.0
            };
            let tets_of_copy = topology.node_tets(node).iter().copied().filter(is_above).collect();
            MeshEdit::DuplicateVertex { node, tets_of_copy }
        }
        2 => {
            let shift = DVec3::new(random.normal(), random.normal(), random.normal());
            let node = corners[1];
            MeshEdit::MoveVertex { node, position_m: place_m(node) + shift * (0.06 * length_m) }
        }
        3 => {
            let other: EdgeId = pick(random, &topology.tet_edges(tet));
            let edges = if other == edge { vec![edge] } else { vec![edge, other] };
            let split = |edge| EdgeSplit { edge, fraction: random.uniform_in(0.3, 0.7) };
            MeshEdit::Split { edges: edges.into_iter().map(split).collect() }
        }
        4 => {
            let position_m = 0.5 * (place_m(ends[0]) + place_m(ends[1]));
            MeshEdit::Collapse { edge, kept: ends[0], position_m }
        }
        5 => moved_and_divided(mesh, tet),
        _ => {
            // A node inside, not where its parents' weights say: one tetrahedron becomes four.
            let position_m =
                corners.into_iter().zip([0.4, 0.2, 0.2, 0.2]).map(|(n, w)| w * place_m(n)).sum::<DVec3>();
            let parents = vec![(corners[0], 0.5), (corners[3], 0.5)];
            let part = |at: usize| {
                let mut part = corners.map(CavityNode::Old);
                part[at] = CavityNode::New(0);
                part
            };
            let new_nodes = vec![NewNode { position_m, parents }];
            MeshEdit::Retetrahedralise { tets: vec![tet], new_nodes, new_tets: (0..4).map(part).collect() }
        }
    }
}

/// The next edit that is not refused: by turns of each kind, with its change.
fn next_edit(random: &mut SeededRandom, mesh: &mut EditableMesh, turn: u64) -> (TopologyChange, MeshUndo) {
    let (mut change, mut undo) = (TopologyChange::default(), MeshUndo::default());
    for attempt in 0.. {
        // A kind that is always refused lets the next one have its turn.
        let edit = random_edit(random, mesh, (turn + attempt / 30) % 7);
        if mesh.apply_saving(&edit, &mut change, &mut undo).is_ok() {
            break;
        }
    }
    (change, undo)
}

/// Forces [N] that hold every node with a tetrahedron at these places, in the order of the nodes; and what the mass of
/// each weighs in a strong field.
fn holding_forces_n(model: &mut dyn DeformableModel, at_m: &[DVec3], rest_m: &[DVec3]) -> [Vec<DVec3>; 2] {
    let displaced =
        |n: usize| ImposedDisplacement { node: NodeId::from_index(n), displacement_m: at_m[n] - rest_m[n] };
    let constraints =
        Constraints { displacements: (0..at_m.len()).map(displaced).collect(), ..Default::default() };
    [DVec3::ZERO, DVec3::new(300.0, -200.0, 500.0)].map(|gravity_m_per_s2| {
        model.apply(&Constraints::default());
        model.set_gravity(gravity_m_per_s2);
        model.take_over(at_m);
        model.apply(&constraints);
        model.step(1e-10);
        model.constraint_forces_n().to_vec()
    })
}

fn check_equal_to_fresh(
    kind: &Kind,
    model: &dyn DeformableModel,
    body: &Body,
    mesh: &EditableMesh,
    context: &str,
) {
    let rest_m = &mesh.mesh().positions_m;
    let fresh = kind.build(&body.live(mesh));
    let bent =
        |x: DVec3| x + DVec3::new(0.8 * x.z * x.z, 0.1 * x.x - 0.5 * x.y * x.z, 0.15 * x.z - x.x * x.x);
    let present_m = model.state().positions_m.to_vec();
    let places = [rest_m.clone(), rest_m.iter().map(|x| bent(*x)).collect(), present_m];
    for (p, at_m) in places.iter().enumerate() {
        let found = holding_forces_n(model.duplicate().as_mut(), at_m, rest_m);
        let expected = holding_forces_n(fresh.duplicate().as_mut(), at_m, rest_m);
        for g in 0..2 {
            let scale_n = expected[1].iter().map(|f| f.length()).fold(1e-9, f64::max);
            for n in 0..at_m.len() {
                let off_n = (found[g][n] - expected[g][n]).length();
                let context = || format!("{}, {context}, places {p}, gravity {g}, node {n}", kind.name);
                assert!(off_n < 1e-9 * scale_n, "{}: {} {}", context(), found[g][n], expected[g][n]);
                if !mesh.topology().is_live_node(NodeId::from_index(n)) {
                    assert_eq!(found[g][n], DVec3::ZERO, "{}", context());
                }
            }
        }
    }
}

#[test]
fn after_any_edits_models_equal_fresh_ones() {
    for (at, kind) in kinds().iter().enumerate() {
        for shape in 0..3 {
            let mut random = SeededRandom::new(100 * at as u64 + shape as u64);
            let is_parted = shape == 2 && kind.has_short_undo[1];
            let whole = if is_parted { large_mesh() } else { mesh_of(shape, random.next_u64()) };
            let mut mesh = EditableMesh::new(whole).unwrap();
            let mut body = Body::of(mesh.mesh().clone(), &mut random);
            let mut model = kind.build(&body);
            let moved: Vec<DVec3> =
                mesh.mesh().positions_m.iter().map(|x| *x + 0.1 * x.z * DVec3::X).collect();
            model.take_over(&moved);
            for turn in 0..12 {
                let (change, _) = next_edit(&mut random, &mut mesh, turn);
                body.follow(&mesh, &change);
                model.topology_changed(mesh.mesh(), &change).unwrap();
                model.step(2e-4);
                if turn % 6 == 5 {
                    let context = format!("shape {shape}, turn {turn}");
                    check_equal_to_fresh(kind, model.as_ref(), &body, &mesh, &context);
                }
            }
            let change = mesh.compact();
            body.compact(&change);
            model.topology_changed(mesh.mesh(), &change).unwrap();
            check_equal_to_fresh(kind, model.as_ref(), &body, &mesh, "compacted");
        }
    }
}

/// The tissue keeps its place in space: under one deformation gradient everywhere, what comes in or moves stands where
/// that gradient puts it.
#[test]
fn new_and_moved_nodes_stand_in_the_deformed_tissue() {
    let gradient =
        DMat3::from_cols(DVec3::new(1.1, 0.2, 0.0), DVec3::new(-0.1, 0.95, 0.1), DVec3::new(0.05, 0.0, 1.2));
    for kind in kinds() {
        let mut random = SeededRandom::new(3);
        let mut mesh = EditableMesh::new(mesh_of(0, 5)).unwrap();
        let mut body = Body::of(mesh.mesh().clone(), &mut random);
        body.fixed.clear();
        let mut model = kind.build(&body);
        let at_m: Vec<DVec3> = mesh.mesh().positions_m.iter().map(|x| gradient * *x).collect();
        model.take_over(&at_m);
        for turn in 0..18 {
            let (change, _) = next_edit(&mut random, &mut mesh, turn);
            body.follow(&mesh, &change);
            model.topology_changed(mesh.mesh(), &change).unwrap();
            for n in mesh.topology().live_nodes().map(NodeId::index) {
                let off_m = model.state().positions_m[n].distance(gradient * mesh.mesh().positions_m[n]);
                assert!(off_m < 1e-12, "{}, turn {turn}, node {n}: {off_m:e}", kind.name);
            }
        }
    }
}

#[test]
fn unsound_edits_are_refused_and_change_nothing() {
    for kind in kinds() {
        let mut random = SeededRandom::new(8);
        let mut mesh = EditableMesh::new(mesh_of(0, 5)).unwrap();
        let body = Body::of(mesh.mesh().clone(), &mut random);
        let mut model = kind.build(&body);
        let before = model.duplicate();
        let (change, _) = next_edit(&mut random, &mut mesh, 3);
        let mut bad = mesh.mesh().clone();
        let tet = change.tets.added.ids()[0].index();
        bad.tetrahedra[tet].swap(0, 1);
        let refusal = model.topology_changed(&bad, &change).unwrap_err().to_string();
        assert!(refusal.contains("cannot follow the edit: tetrahedron"), "{refusal}");
        for _ in 0..3 {
            model.step(1e-3);
        }
        let mut expected = before;
        for _ in 0..3 {
            expected.step(1e-3);
        }
        assert_eq!(model.state().positions_m, expected.state().positions_m, "{}", kind.name);
        assert_eq!(relative_difference(model.state().positions_m, expected.state().positions_m), 0.0);
    }
}
