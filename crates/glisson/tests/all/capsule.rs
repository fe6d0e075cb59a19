//! Which triangles of an organ that was cut and refined are still its own surface.

use crate::bodies::on_a_table;
use crate::model_meshes::block;
use glisson::image::vessels::Tube;
use glisson::math::DVec3;
use glisson::mesh::edit::{EdgeSplit, MeshEdit};
use glisson::mesh::refine::FineRegion;
use glisson::mesh::{NodeId, TetId};
use glisson::record::snapshot::DisplayTopology;
use glisson::tool::{Blade, BladeCuts, Tool, ToolInput, ToolKind};
use glisson::world::spec::WorldSpec;
use glisson::world::{StepInput, World};

const SIZE_M: f64 = 0.1;
const TIME_STEP_S: f64 = 3e-4;

fn scalpel_at(x_m: f64, trigger: f64) -> ToolInput {
    ToolInput { trigger, ..ToolInput::at(DVec3::new(x_m, 0.047, SIZE_M - 0.03), DVec3::Z) }
}

fn world(cuts: BladeCuts) -> World {
    let kind = ToolKind::scalpel(Blade { length_m: 0.06, edge_radius_m: 0.0, cuts });
    let tool = Tool { kind, shaft_radius_m: 2e-3, ..Tool::probe("scalpel", 3e-3, scalpel_at(-0.02, 0.0)) };
    let spec = WorldSpec::new("block", TIME_STEP_S, tool);
    on_a_table(block([4, 4, 4], DVec3::splat(SIZE_M)), spec)
}

fn check(shown: &DisplayTopology) -> [usize; 2] {
    check_in(DVec3::splat(SIZE_M), shown)
}

/// The block's own surface is its six faces at rest: whether a triangle lies in one is known exactly. Answers how many lie in
/// them and how many in cuts.
fn check_in(size_m: DVec3, shown: &DisplayTopology) -> [usize; 2] {
    assert_eq!(shown.is_cut.len(), shown.triangles.len());
    let mut n = [0; 2];
    for (triangle, &is_cut) in shown.triangles.iter().zip(&shown.is_cut) {
        let corners_m = triangle.map(|v| shown.rest_positions_m[v as usize]);
        let lies_at = |axis: usize, at_m: f64| corners_m.iter().all(|p| (p[axis] - at_m).abs() < 1e-9);
        let is_own = (0..3).any(|axis| lies_at(axis, 0.0) || lies_at(axis, size_m[axis]));
        assert_eq!(is_cut, !is_own, "{corners_m:?}");
        n[usize::from(is_cut)] += 1;
    }
    n
}

#[test]
fn skin_that_is_divided_stays_skin_and_what_a_cut_uncovers_is_none() {
    for cuts in [BladeCuts::Subdivision, BladeCuts::Displacement] {
        let mut world = world(cuts);
        world.set_undo_depth(1000);
        let whole = world.display_topology();
        assert_eq!(check(&whole), [whole.triangles.len(), 0]);
        // Finer at a corner of the block: more skin, no cut.
        let region = FineRegion { center_m: DVec3::new(0.0, 0.0, SIZE_M), radius_m: 0.03, edge_m: 0.015 };
        assert!(world.refine(&region).unwrap() > 0);
        let [n_fine, n_cut] = check(&world.display_topology());
        assert!(n_fine > whole.triangles.len() && n_cut == 0, "{cuts:?}: {n_fine}");
        // A stroke from outside through half of the block; then a piece is taken out.
        world.step(&StepInput::of(&[scalpel_at(-0.01, 1.0)]).placed());
        for i in 1..=20 {
            world.step(&StepInput::of(&[scalpel_at(-0.01 + 0.003 * f64::from(i), 1.0)]));
            world.cut_with_tools();
        }
        world.step(&StepInput::of(&[scalpel_at(0.05, 0.0)]));
        world.cut_with_tools();
        let [_, n_stroke] = check(&world.display_topology());
        assert!(n_stroke > 4, "{cuts:?}: {n_stroke}");
        let last = world.organ().body().topology().live_tets().last().unwrap();
        world.remove_and_part(vec![last]).unwrap();
        check(&world.display_topology());
        // Taken back step by step, what is skin is known all the time.
        let mut n_undone = 0;
        while world.undo_edit() {
            check(&world.display_topology());
            n_undone += 1;
        }
        assert!(n_undone > 2, "{cuts:?}");
        assert_eq!(world.display_topology().is_cut, whole.is_cut);
        world.refine(&region).unwrap();
        assert_eq!(check(&world.display_topology()), [n_fine, 0]);
    }
}

#[test]
fn a_vessel_that_enters_through_the_skin_is_not_severed_when_the_skin_gets_finer_there() {
    let home = ToolInput::at(DVec3::splat(1.0), DVec3::Z);
    let mut spec = WorldSpec::new("block", TIME_STEP_S, Tool::probe("probe", 3e-3, home));
    let entry_m = DVec3::new(0.0412, 0.0531, SIZE_M);
    let ends_m = [entry_m + DVec3::Z * 0.02, entry_m - DVec3::new(0.003, 0.004, 0.06)];
    spec.vessels = vec![Tube { parent: None, ends_m, radii_m: [2e-3; 2] }];
    let mut world = on_a_table(block([4, 4, 4], DVec3::splat(SIZE_M)), spec);
    let region = FineRegion { center_m: entry_m, radius_m: 0.02, edge_m: 0.015 };
    assert!(world.refine(&region).unwrap() > 0);
    let severed = |world: &World| world.vessels().unwrap().severed_along(0);
    assert_eq!(severed(&world), None);
    // What is taken out around it is another matter.
    let deep_m = entry_m.z - 0.03;
    let body = world.organ().body();
    let is_deep = |t: &TetId| {
        let corners_m = body.mesh().corners_m(*t);
        corners_m.iter().any(|p| p.z > deep_m) && corners_m.iter().any(|p| p.z < deep_m)
    };
    let tets: Vec<TetId> = body.topology().live_tets().filter(is_deep).collect();
    world.remove_and_part(tets).unwrap();
    assert!(severed(&world).is_some_and(|along| along > 0.25), "{:?}", severed(&world));
}

/// Cells of 25 x 25 x 1 mm.
const SLAB_M: DVec3 = DVec3::new(SIZE_M, SIZE_M, 8e-3);

fn slab() -> World {
    let home = ToolInput::at(DVec3::splat(1.0), DVec3::Z);
    let spec = WorldSpec::new("slab", 1e-5, Tool::probe("probe", 3e-3, home));
    on_a_table(block([4, 4, 8], SLAB_M), spec)
}

/// The uppermost millimetre.
fn top(world: &World) -> Vec<TetId> {
    let body = world.organ().body();
    let is_top = |t: &TetId| body.mesh().corners_m(*t).iter().all(|p| p.z > SLAB_M.z - 1.5e-3);
    body.topology().live_tets().filter(is_top).collect()
}

#[test]
fn what_lies_close_under_skin_that_was_taken_out_is_none() {
    let mut world = slab();
    let tets = top(&world);
    world.remove_and_part(tets).unwrap();
    let [_, n_cut] = check_in(SLAB_M, &world.display_topology());
    assert_eq!(n_cut, 32);
}

#[test]
fn what_is_divided_close_under_skin_as_that_is_taken_out_is_none() {
    let mut world = slab();
    // Of the layer below, as the parting of what hangs on by an edge divides it.
    let edge = {
        let (topology, rest_m) = (world.organ().body().topology(), &world.organ().mesh().positions_m);
        let in_bed = |n: NodeId| (rest_m[n.index()].z - (SLAB_M.z - 1e-3)).abs() < 1e-9;
        topology.live_edges().filter(|&e| topology.edge_nodes(e).into_iter().all(in_bed)).nth(20).unwrap()
    };
    let remove = MeshEdit::Remove { tets: top(&world) };
    let split = MeshEdit::Split { edges: vec![EdgeSplit { edge, fraction: 0.5 }] };
    world.edit_all(&[remove, split]).unwrap();
    let [_, n_cut] = check_in(SLAB_M, &world.display_topology());
    assert!(n_cut > 32, "{n_cut}");
}
