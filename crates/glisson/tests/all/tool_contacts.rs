//! What instruments touch: the same in a world that looks by itself and in one that is told where they are
//! put into tissue and come out of it.

use crate::bodies::held_at;
use crate::model_meshes::block;
use crate::surface_copy::follow;
use glisson::contact::shapes::MeshShape;
use glisson::math::{Aabb, DVec3};
use glisson::mesh::TetMesh;
use glisson::model::Rayleigh;
use glisson::model::kind::ModelKind;
use glisson::tool::{Blade, BladeCuts, Tool, ToolInput, ToolKind, ToolShape};
use glisson::world::detection::{SurfaceCopy, ToolDetector};
use glisson::world::spec::{Region, WorldSpec};
use glisson::world::{StepInput, World};

const TIME_STEP_S: f64 = 1e-3;
const SIZE_M: f64 = 0.1;
const RADIUS_M: f64 = 8e-3;

fn world_of(mesh: TetMesh, tool: Tool, kind: ModelKind) -> World {
    let table = Region::Box(Aabb { min_m: DVec3::splat(-1.0), max_m: DVec3::new(1.0, 1.0, 1e-6) });
    let spec = WorldSpec::new("tissue", TIME_STEP_S, tool);
    held_at(table, mesh, spec, kind, 0.4, Rayleigh::of_mass(30.0))
}

fn at(x_m: f64, z_m: f64) -> ToolInput {
    ToolInput::at(DVec3::new(x_m, 0.45 * SIZE_M, z_m), DVec3::Z)
}

fn probe(radius_m: f64) -> Tool {
    Tool::probe("ball", radius_m, at(2.0 * SIZE_M, 2.0 * SIZE_M))
}

/// Whether a tool touches after each of these poses, of which the first is put: in a world that looks by itself, and in one
/// that is told.
fn touches(tool: &Tool, poses: &[ToolInput]) -> Vec<bool> {
    let make = || world_of(block([5, 5, 5], DVec3::splat(SIZE_M)), tool.clone(), ModelKind::Precomputed);
    let (mut looks, mut is_told) = (make(), make());
    let mut copy = SurfaceCopy::new(&is_told.surface_list()).unwrap();
    let mut detector = ToolDetector::new(tool);
    let step = |(i, pose): (usize, &ToolInput)| {
        let input = StepInput::of(&[*pose]);
        let input = if i == 0 { input.placed() } else { input };
        follow(&mut copy, &is_told);
        let detected = [Some(detector.look(&copy, pose)), None, None, None, None];
        let found = is_told.step(&StepInput { detected, ..input }).in_contact();
        let expected = looks.step(&input).in_contact();
        assert_eq!(found, expected, "told and by itself, at pose {i}");
        found
    };
    poses.iter().enumerate().map(step).collect()
}

#[test]
fn a_tip_that_comes_out_of_the_organ_is_not_held_back_and_touches_again_from_outside() {
    let up = (0..50).map(|i| at(0.05, SIZE_M - 0.02 + 1e-3 * f64::from(i)));
    let down = (1..20).map(|i| at(0.05, SIZE_M + RADIUS_M + 0.021 - 2e-3 * f64::from(i)));
    let poses: Vec<ToolInput> = up.chain(down).collect();
    let found = touches(&probe(RADIUS_M), &poses);
    assert!(found[..50].iter().all(|touches| !touches), "{found:?}");
    assert!(found[68], "{found:?}");
}

#[test]
fn a_shaft_that_leaves_the_tissue_it_was_put_into_is_not_pushed_out_of_it_afterwards() {
    // The tip hangs below the block's edge, against which the shaft leans: 1.7 mm of it are in the block, its axis is not.
    let through = ToolInput::at(DVec3::new(SIZE_M + 0.0385, 0.045, 0.05), DVec3::new(-0.6, 0.0, 0.8));
    let beside = ToolInput { tip_in_world_m: through.tip_in_world_m + DVec3::X * 0.06, ..through };
    let back = |m: f64| ToolInput { tip_in_world_m: beside.tip_in_world_m - DVec3::X * m, ..beside };
    let found = touches(&probe(RADIUS_M), &[through, through, beside, beside, back(0.02), back(0.062)]);
    assert_eq!(found, [false, false, false, false, false, true]);
}

#[test]
fn a_tool_that_is_put_into_tissue_again_forgets_that_it_was_buried() {
    let tool = probe(RADIUS_M);
    let mut world = world_of(block([5, 5, 5], DVec3::splat(SIZE_M)), tool, ModelKind::Precomputed);
    // Its centre in the tissue: it is inside.
    assert!(!world.step(&StepInput::of(&[at(0.05, SIZE_M - 5e-3)]).placed()).in_contact());
    assert!(!world.step(&StepInput::of(&[at(0.05, SIZE_M + 5e-3)])).in_contact());
    assert!(world.step(&StepInput::of(&[at(0.05, SIZE_M + 5e-3)]).placed()).in_contact());
}

#[test]
fn what_crosses_the_surface_where_it_is_put_touches_alike_whoever_looks() {
    let blade = Blade { length_m: 0.02, edge_radius_m: 0.0, cuts: BladeCuts::Subdivision };
    let scalpel = Tool { kind: ToolKind::scalpel(blade), ..probe(1e-3) };
    let poses: Vec<ToolInput> = (0..40).map(|i| at(0.05, SIZE_M - 0.01 + 1e-3 * f64::from(i))).collect();
    let found = touches(&scalpel, &poses);
    assert!(found[39..].iter().all(|touches| !touches), "{found:?}");
    let corner = |i: usize| DVec3::new((i & 1) as f64, (i >> 1 & 1) as f64, (i >> 2) as f64) * 8e-3 - 4e-3;
    let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    let shape = MeshShape::new((0..8).map(corner).collect(), triangles);
    let cube = Tool { shape: ToolShape::Mesh(shape), ..probe(4e-3) };
    let found = touches(&cube, &[at(0.05, SIZE_M), at(0.05, SIZE_M)]);
    assert!(found[0], "out along the tissue's normal: {found:?}");
}
#[test]
fn a_tip_drawn_out_of_its_trocar_stays_in_it_and_comes_back_as_it_was() {
    let trocar_m = DVec3::new(0.05, 0.045, 0.3);
    let tool = Tool { trocar_m: Some(trocar_m), shaft_length_m: 0.25, home: at(0.05, 0.2), ..probe(3e-3) };
    let mut world = world_of(block([2, 2, 2], DVec3::splat(SIZE_M)), tool.clone(), ModelKind::Precomputed);
    let mut detector = ToolDetector::new(&tool);
    let copy = SurfaceCopy::new(&world.surface_list()).unwrap();
    let mut pose = |x_m: f64, z_m: f64| {
        let input = StepInput::of(&[at(x_m, z_m)]);
        detector.look(&copy, &input.tools[0]);
        world.step(&input);
        world.snapshot().tools[0].pose
    };
    let inside = pose(0.08, 0.25);
    assert!(inside.shaft_in_world.z > 0.8 && inside.tip_in_world_m.x == 0.08);
    for (x_m, z_m) in [(0.045, 0.305), (0.03, 0.33), (-0.02, 0.33), (0.02, 0.36)] {
        let out = pose(x_m, z_m);
        assert_eq!((out.tip_in_world_m, out.shaft_in_world), (trocar_m, inside.shaft_in_world));
    }
    // On the other side inside: the tool is there at once.
    let again = pose(-0.03, 0.27);
    assert!(again.shaft_in_world.z > 0.0 && again.tip_in_world_m.x == -0.03, "{again:?}");
    // No deeper than the shaft is long.
    let deep = pose(0.05, 0.01);
    assert!((deep.tip_in_world_m.z - 0.05).abs() < 1e-12 && deep.shaft_in_world.z > 1.0 - 1e-12, "{deep:?}");
    // Put there, past the pivot: the home tells which side is out.
    world.step(&StepInput::of(&[at(0.06, 0.35)]).placed());
    let put = world.snapshot().tools[0].pose;
    assert!(put.tip_in_world_m == trocar_m && put.shaft_in_world.z > 0.0, "{put:?}");
}
