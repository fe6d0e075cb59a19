//! Contact points as those who look on see them: they add up to what instruments feel.

use std::sync::Arc;

use crate::bodies::{TABLE, held_at};
use crate::edit_faults::list_file;
use crate::model_meshes::{block, shaken_block};
use glisson::math::DVec3;
use glisson::mesh::edit::MeshEdit;
use glisson::model::Rayleigh;
use glisson::model::kind::ModelKind;
use glisson::record::snapshot::{ContactKind, ContactPoints};
use glisson::scene::{Scene, build_world};
use glisson::tool::{Grip, Jaws, Tool, ToolInput, ToolKind};
use glisson::workers::Sequential;
use glisson::world::spec::{Hand, WorldSpec};
use glisson::world::{StepInput, World};

const STEP_S: f64 = 1e-3;
const SIZE_M: f64 = 0.06;
/// Wider than the mesh's edges: it touches at several places.
const RADIUS_M: f64 = 9e-3;

fn above(z_m: f64) -> ToolInput {
    ToolInput::at(DVec3::new(0.031, 0.029, z_m), DVec3::Z)
}

/// A block on a table and an instrument over it.
fn world(kind: ModelKind, hand: Option<Hand>) -> World {
    let grip = Grip { friction_coefficient: 0.1, is_sticky: false };
    let tool = Tool { grip, ..Tool::probe("ball", RADIUS_M, above(SIZE_M + 0.03)) };
    let mut spec = WorldSpec::new("pressed", STEP_S, tool);
    spec.hand = hand;
    let mesh = shaken_block([10; 3], DVec3::splat(SIZE_M), 0.15, 3);
    held_at(TABLE, mesh, spec, kind, 0.45, Rayleigh::of_mass(60.0))
}

fn points_of(world: &World) -> ContactPoints {
    let mut points = ContactPoints::default();
    world.contact_points_into(&mut points);
    points
}

/// Presses the tip so deep into the block.
fn press(world: &mut World, depth_m: f64) {
    world.step(&StepInput::of(&[above(SIZE_M + 0.03)]).placed());
    for i in 0..=200 {
        let share = f64::from(i) / 200.0;
        world.step(&StepInput::of(&[above(SIZE_M + RADIUS_M + 2e-3 - (2e-3 + depth_m) * share)]));
    }
}

#[test]
fn points_of_an_instrument_add_up_to_the_force_on_it() {
    for (kind, hand, least) in [
        (ModelKind::Precomputed, Some(Hand::default()), 3),
        (ModelKind::Implicit, Some(Hand::default()), 3),
        (ModelKind::Precomputed, None, 1),
        (ModelKind::Implicit, None, 1),
    ] {
        let mut world = world(kind, hand);
        assert_eq!(points_of(&world), ContactPoints::default());
        press(&mut world, 5e-3);
        let name = format!("{kind}, hand {}", hand.is_some());
        let hash = world.state_hash();
        let found = points_of(&world);
        assert_eq!(world.state_hash(), hash);
        assert!(found.points.len() >= least && found.n_left_out() == 0, "{name}: {}", found.points.len());
        let felt_n = world.report().tools[0].force_on_tool_n;
        let sum_n: DVec3 = found.points.iter().map(|point| point.force_n).sum();
        assert!(
            felt_n.z > 0.05 && sum_n.distance(felt_n) < 1e-9 * felt_n.length(),
            "{name}: {sum_n} {felt_n}"
        );
        let tip_m = world.snapshot().tools[0].pose.tip_in_world_m;
        for point in &found.points {
            assert_eq!((point.kind, point.touched, point.by), (ContactKind::ToolOrgan, 0, 0), "{name}");
            // What the mesh does not show of the depth is up to a radius or so.
            assert!(point.place_m.distance(tip_m) < 2.0 * RADIUS_M, "{name}: {point:?} {tip_m}");
            assert!((point.normal.length() - 1.0).abs() < 1e-9 && point.normal.z > 0.0, "{name}: {point:?}");
            // In the cone of friction, and the imposed contact's force is along its normal within as much.
            let along_n = point.force_n.dot(point.normal);
            assert!(along_n > 0.7 * point.force_n.length(), "{name}: {point:?}");
        }
        let sizes: Vec<f64> = found.points.iter().map(|point| point.force_n.length()).collect();
        assert!(sizes.is_sorted_by(|a, b| a >= b), "{name}: {sizes:?}");
        world.reset();
        assert_eq!(points_of(&world), ContactPoints::default(), "{name}");
    }
}

#[test]
fn what_is_cut_away_under_an_instrument_is_no_contact_any_more() {
    for hand in [None, Some(Hand::default())] {
        let mut world = world(ModelKind::Implicit, hand);
        press(&mut world, 3e-3);
        let before = points_of(&world);
        let tets = world.touched_tetrahedra(0);
        world.edit(&MeshEdit::Remove { tets }).unwrap();
        let after = points_of(&world);
        assert!(after.points.len() < before.points.len(), "{before:?} {after:?}");
        assert!(after.points.iter().all(|point| before.points.contains(point)));
        assert!(world.undo_edit());
        assert!(points_of(&world).points.iter().all(|point| before.points.contains(point)));
        world.step(&StepInput::of(&[above(SIZE_M)]));
        assert!(points_of(&world).points.iter().all(|point| point.place_m.is_finite()));
    }
}

#[test]
fn what_jaws_hold_is_told_node_by_node_without_a_normal() {
    let jaws = Jaws { length_m: 0.02, width_m: 0.01, greatest_opening_rad: 1.2, closing_force_n: 10.0 };
    let at = |z_m: f64, jaw_opening: f64| ToolInput {
        jaw_opening,
        ..ToolInput::at(DVec3::new(SIZE_M, 0.03, z_m), DVec3::Z)
    };
    for hand in [None, Some(Hand::default())] {
        let grip = Grip { friction_coefficient: 10.0, is_sticky: false };
        let kind = ToolKind::grasper(jaws);
        let tool = Tool { kind, grip, shaft_radius_m: 2e-3, ..Tool::probe("grasper", 3e-3, at(0.2, 1.0)) };
        let mut spec = WorldSpec::new("held", STEP_S, tool);
        spec.hand = hand;
        let mesh = block([4; 3], DVec3::splat(SIZE_M));
        let mut world = held_at(TABLE, mesh, spec, ModelKind::Implicit, 0.45, Rayleigh::of_mass(60.0));
        world.step(&StepInput::of(&[at(SIZE_M - 2e-3, 1.0)]).placed());
        for i in 1..=20 {
            world.step(&StepInput::of(&[at(SIZE_M - 2e-3, 1.0 - f64::from(i) / 20.0)]));
        }
        for i in 1..=200 {
            world.step(&StepInput::of(&[at(SIZE_M - 2e-3 + 5e-3 * f64::from(i) / 200.0, 0.0)]));
        }
        let held: Vec<DVec3> =
            world.held_nodes(0).iter().map(|n| world.state().positions_m[n.index()]).collect();
        let found = points_of(&world);
        let of_jaws: Vec<_> = found.points.iter().filter(|point| point.normal == DVec3::ZERO).collect();
        assert!(!held.is_empty() && of_jaws.len() == held.len(), "{} {}", held.len(), of_jaws.len());
        assert!(of_jaws.iter().all(|point| held.contains(&point.place_m)));
        let sum_n: DVec3 = found.points.iter().map(|point| point.force_n).sum();
        let felt_n = world.report().tools[0].force_on_tool_n;
        assert!(felt_n.z < -0.01 && sum_n.distance(felt_n) < 1e-9 * felt_n.length(), "{sum_n} {felt_n}");
    }
}

#[test]
fn an_instrument_on_a_rigid_body_is_told_as_that() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("cube.tet"), list_file(&block([2; 3], DVec3::splat(0.02)))).unwrap();
    let text = "glisson_scene = 1\n[simulation]\ntime_step = \"2 ms\"\n[hand]\n\
        [[organ]]\nname = \"cube\"\nmesh = \"cube.tet\"\nyoung_modulus = \"10 kPa\"\npoisson_ratio = 0.3\n\
        density = \"1000 kg/m3\"\nmodel = \"implicit\"\nimaged_under_gravity = false\n\
        [[rigid]]\nname = \"slab\"\nslab = { point = [0, 0, 0], normal = [0, 0, 1], size = \"200 mm\", thickness = \"20 mm\" }\n\
        [tool]\ntip_radius = \"5 mm\"\nhome_tip = [\"60 mm\", \"60 mm\", \"9 mm\"]\nhome_shaft = [0, 0, 1]\n";
    let (mut world, _) =
        build_world(&Scene::parse(text).unwrap(), folder.path(), Arc::new(Sequential)).unwrap();
    for i in 0..100 {
        let z_m = 0.009 - 0.006 * f64::from(i) / 100.0;
        world.step(&StepInput::of(&[ToolInput::at(DVec3::new(0.06, 0.06, z_m), DVec3::Z)]));
    }
    let found = points_of(&world);
    assert!(!found.points.is_empty());
    let is_of_slab = |kind: ContactKind, touched: u8| kind == ContactKind::ToolRigid && touched == 1;
    assert!(found.points.iter().all(|point| is_of_slab(point.kind, point.touched)), "{found:?}");
    let felt_n = world.report().tools[0].force_on_tool_n;
    let sum = found.sums[ContactKind::ToolRigid as usize];
    assert!(felt_n.z > 1.0 && sum.n as usize == found.points.len(), "{felt_n}");
    assert!((sum.force_n / felt_n.length() - 1.0).abs() < 0.05, "{sum:?} {felt_n}");
}
