//! What happens when a blade is lifted: singular places are parted, bad tetrahedra mended, the stroke is reported.

use crate::bodies::on_a_table;
use crate::model_meshes::block;
use glisson::math::{DVec3, SeededRandom};
use glisson::mesh::box_mesh::irregular_cube;
use glisson::mesh::edit::{EditableMesh, MeshEdit, MeshUndo, TopologyChange};
use glisson::mesh::quality::radius_ratio;
use glisson::mesh::repair::{MendParams, mending};
use glisson::mesh::topology::SingularEntities;
use glisson::mesh::{NodeId, TetId, TetMesh};
use glisson::tool::{Blade, BladeCuts, Tool, ToolInput, ToolKind};
use glisson::world::spec::WorldSpec;
use glisson::world::{BladeReport, StepInput, World};

const SIZE_M: f64 = 0.1;
const TIME_STEP_S: f64 = 3e-4;

fn singular(body: &EditableMesh) -> SingularEntities {
    let topology = body.topology();
    topology.singular_entities(&topology.live_nodes().collect::<Vec<_>>())
}

fn worst_ratio(body: &EditableMesh) -> f64 {
    body.topology().live_tets().map(|t| radius_ratio(body.mesh().corners_m(t))).fold(1.0, f64::min)
}

/// A block on a table and a long scalpel.
fn world(cuts: BladeCuts, mends_cuts: bool) -> World {
    world_of(block([5, 5, 5], DVec3::splat(SIZE_M)), cuts, mends_cuts)
}

fn world_of(mesh: TetMesh, cuts: BladeCuts, mends_cuts: bool) -> World {
    let home = ToolInput::at(DVec3::new(0.05, 0.05, 0.3), DVec3::Z);
    let kind = ToolKind::scalpel(Blade { length_m: 0.15, edge_radius_m: 0.0, cuts });
    let mut spec = WorldSpec::new("block", TIME_STEP_S, Tool { kind, ..Tool::probe("scalpel", 2e-4, home) });
    spec.mends_cuts = mends_cuts;
    let mut world = on_a_table(mesh, spec);
    world.set_undo_depth(1000);
    world
}

/// A stroke across the block at a random place and lean; what it did, told when the edge is lifted.
fn stroke(world: &mut World, random: &mut SeededRandom) -> Option<BladeReport> {
    let across = DVec3::new(random.normal(), random.normal(), 0.0).normalize();
    let lean = DVec3::new(0.4 * random.normal(), 0.4 * random.normal(), 1.0).normalize();
    let middle_m = DVec3::new(random.uniform_in(0.03, 0.07), random.uniform_in(0.03, 0.07), 0.06);
    let pose = |t: f64, trigger: f64| ToolInput {
        trigger,
        ..ToolInput::at(middle_m + across * (0.2 * t - 0.1), lean)
    };
    world.step(&StepInput::of(&[pose(0.0, 1.0)]).placed());
    for i in 0..=20 {
        world.step(&StepInput::of(&[pose(f64::from(i) / 20.0, 1.0)]).placed());
        let cuts = world.cut_with_tools();
        assert!(cuts.strokes.is_empty());
    }
    world.step(&StepInput::of(&[pose(1.0, 0.0)]).placed());
    world.cut_with_tools().strokes.pop().map(|(tool, report)| {
        assert_eq!(tool, 0);
        report
    })
}

#[test]
fn a_lifted_edge_leaves_nothing_that_hangs_together_by_a_node_or_an_edge() {
    let mut n_strokes = 0;
    for cuts in [BladeCuts::Subdivision, BladeCuts::Displacement] {
        let mut world = world(cuts, false);
        let whole_m3 = world.organ().body().volume_m3();
        let mut random = SeededRandom::new(5);
        for _ in 0..6 {
            let report = stroke(&mut world, &mut random);
            assert_eq!(singular(world.organ().body()), SingularEntities::default(), "{cuts:?}: {report:?}");
            let off = (world.organ().body().volume_m3() / whole_m3 - 1.0).abs();
            assert!(off < 1e-9, "{cuts:?}: {off}");
            if let Some(report) = report {
                assert!(report.cut_area_m2 > 0.0 && report.worst_dihedral_deg.is_some(), "{report:?}");
                n_strokes += 1;
            }
        }
        assert!(world.blades().cut_area_m2 > 0.0);
        while world.undo_edit() {}
    }
    assert!(n_strokes > 6, "{n_strokes}");
}

#[test]
fn places_that_hang_together_by_a_node_or_an_edge_are_parted_and_hang_together_again_when_it_is_taken_back() {
    let mut world = world(BladeCuts::Subdivision, false);
    let mut random = SeededRandom::new(3);
    let tets: Vec<TetId> =
        world.organ().body().topology().live_tets().filter(|_| random.uniform() < 0.3).collect();
    world.edit(&MeshEdit::Remove { tets }).unwrap();
    let before = world.organ().body().clone();
    assert!(!singular(&before).is_empty());
    let nodes: Vec<NodeId> = before.topology().live_nodes().collect();
    assert!(world.part_singular_places(&nodes).unwrap());
    assert!(singular(world.organ().body()).is_empty());
    assert!((world.organ().body().volume_m3() / before.volume_m3() - 1.0).abs() < 1e-12);
    assert!(!world.part_singular_places(&nodes).unwrap());
    assert!(world.undo_edit());
    assert!(*world.organ().body() == before);
}

#[test]
fn what_a_stroke_leaves_is_parted_also_after_its_last_edit_was_taken_back() {
    let mut world = world(BladeCuts::Subdivision, false);
    let mut random = SeededRandom::new(3);
    // Many places hang together by a node or an edge alone; the stroke comes by some.
    let tets: Vec<TetId> =
        world.organ().body().topology().live_tets().filter(|_| random.uniform() < 0.3).collect();
    world.edit(&MeshEdit::Remove { tets }).unwrap();
    let pose = |x_m: f64, trigger: f64| ToolInput {
        trigger,
        ..ToolInput::at(DVec3::new(x_m, 0.047, 0.03), DVec3::new(0.1, 0.2, 1.0).normalize())
    };
    let mut n_edits = 0;
    world.step(&StepInput::of(&[pose(-0.01, 1.0)]).placed());
    for i in 0..=8 {
        world.step(&StepInput::of(&[pose(-0.01 + 0.01 * f64::from(i), 1.0)]).placed());
        n_edits += world.cut_with_tools().n_edits;
    }
    assert!(n_edits > 1 && world.undo_edit(), "{n_edits}");
    let n_singular = |world: &World| {
        let found = singular(world.organ().body());
        found.nodes.len() + found.edges.len()
    };
    let n_before = n_singular(&world);
    world.step(&StepInput::of(&[pose(0.07, 0.0)]).placed());
    let cuts = world.cut_with_tools();
    assert_eq!(cuts.blades.n_partings, 1);
    assert!(n_singular(&world) < n_before, "{n_before}");
}

#[test]
fn mended_cuts_have_better_tetrahedra_and_the_same_surface() {
    let run = |mends_cuts: bool| {
        let mut world = world_of(irregular_cube(SIZE_M, 1), BladeCuts::Subdivision, mends_cuts);
        let mut random = SeededRandom::new(2);
        let report = stroke(&mut world, &mut random).expect("it cuts");
        (world, report)
    };
    let ((cut, _), (mut mended, report)) = (run(false), run(true));
    assert!(report.n_mended > 0, "{report:?}");
    let [before, after] = [&cut, &mended].map(|w| worst_ratio(w.organ().body()));
    assert!(after >= before, "{after} after {before}");
    let places = |world: &World| {
        let (topology, rest_m) = (world.organ().body().topology(), &world.organ().mesh().positions_m);
        let of_node = |n: NodeId| rest_m[n.index()].to_array().map(f64::to_bits);
        let mut places: Vec<_> =
            topology.surface_triangles().map(|t| topology.outward_nodes(t).map(of_node)).collect();
        places.iter_mut().for_each(|corners| corners.sort_unstable());
        places.sort_unstable();
        places
    };
    assert_eq!(places(&cut), places(&mended));
    let [a_m3, b_m3] = [&cut, &mended].map(|w| w.organ().body().volume_m3());
    assert!((a_m3 / b_m3 - 1.0).abs() < 1e-12);
    // An edit of its own, undone first.
    assert!(mended.undo_edit());
    assert_eq!(worst_ratio(mended.organ().body()), before);
}

#[test]
fn partings_are_planned_without_a_trace_and_keep_the_volume() {
    let mut n_singular = 0;
    for seed in 0..12 {
        let mut body = EditableMesh::new(irregular_cube(0.05, seed)).unwrap();
        let mut random = SeededRandom::new(seed);
        let tets: Vec<TetId> = body.topology().live_tets().filter(|_| random.uniform() < 0.3).collect();
        let change = body.apply(&MeshEdit::Remove { tets }).unwrap();
        let near = body.topology().nodes_near(&change);
        n_singular += singular(&body).edges.len() + singular(&body).nodes.len();
        let before = body.clone();
        let edits = body.parting_edits(near);
        assert!(body == before && !edits.is_empty());
        assert!(!edits.iter().any(|edit| matches!(edit, MeshEdit::Remove { .. })));
        let (mut change, mut undo) = (TopologyChange::default(), MeshUndo::default());
        body.apply_all_saving(&edits, &mut change, &mut undo).unwrap();
        assert!(singular(&body).is_empty());
        assert!((body.volume_m3() / before.volume_m3() - 1.0).abs() < 1e-12);
        body.undo(&undo);
        assert!(body == before);
    }
    assert!(n_singular > 100, "{n_singular}");
}

#[test]
fn mending_lifts_the_worst_tetrahedra_and_moves_nothing_that_is_told_to_stay() {
    let mut n_mended = 0;
    for seed in 0..6 {
        let mut body = EditableMesh::new(irregular_cube(0.05, seed)).unwrap();
        let before = body.clone();
        let topology = before.topology();
        let tets: Vec<TetId> = topology.live_tets().collect();
        let params = MendParams { bad_radius_ratio: 0.4, most_tried: 40, ..MendParams::default() };
        let stays = |node: NodeId| node.0.is_multiple_of(3);
        let mending = mending(&mut body, &tets, &params, &stays);
        assert!(body == before, "a plan leaves no trace");
        let n_places = mending.n_remeshed + mending.n_collapsed;
        assert!(n_places <= params.most_tried && n_places <= mending.n_bad, "{mending:?}");
        n_mended += n_places;
        let (mut change, mut undo) = (TopologyChange::default(), MeshUndo::default());
        body.apply_all_saving(&mending.edits, &mut change, &mut undo).unwrap();
        assert!(worst_ratio(&body) >= worst_ratio(&before));
        assert!((body.volume_m3() / before.volume_m3() - 1.0).abs() < 1e-12);
        for node in topology.live_nodes().filter(|&n| stays(n) || topology.is_surface_node(n)) {
            let [a, b] = [&before, &body].map(|body| body.mesh().positions_m[node.index()]);
            assert!(a == b && body.topology().is_live_node(node), "{node}");
        }
    }
    assert!(n_mended > 10, "{n_mended}");
}
