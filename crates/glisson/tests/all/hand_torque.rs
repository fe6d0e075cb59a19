//! The torque of a hand: an instrument that is pressed far from its tip turns about it.

use crate::bodies::{Backwards, TABLE, held_by};
use crate::model_meshes::shaken_block;
use glisson::math::DVec3;
use glisson::model::Rayleigh;
use glisson::model::kind::ModelKind;
use glisson::record::snapshot::ContactPoints;
use glisson::tool::{Tool, ToolInput};
use glisson::workers::{Sequential, SharedWorkers};
use glisson::world::spec::{Hand, WorldSpec};
use glisson::world::{StepInput, World};
use std::sync::Arc;

const STEP_S: f64 = 5e-4;
const RADIUS_M: f64 = 2.5e-3;
const SIZE_M: DVec3 = DVec3::new(0.03, 0.06, 0.03);
/// From the tip to the middle of the block.
const ARM_M: f64 = 0.1;

/// A shaft along x over a block: so deep in its top, its tip beyond.
fn lying(depth_m: f64) -> ToolInput {
    ToolInput::at(DVec3::new(0.5 * SIZE_M.x - ARM_M, 0.5 * SIZE_M.y, SIZE_M.z + RADIUS_M - depth_m), DVec3::X)
}

fn world(kind: ModelKind, hand: Hand, trocar_m: Option<DVec3>) -> World {
    world_by(Arc::new(Sequential), kind, hand, trocar_m)
}

fn world_by(workers: SharedWorkers, kind: ModelKind, hand: Hand, trocar_m: Option<DVec3>) -> World {
    let tool = Tool { shaft_radius_m: RADIUS_M, trocar_m, ..Tool::probe("rod", RADIUS_M, lying(-0.05)) };
    let mut spec = WorldSpec::new("lever", STEP_S, tool);
    spec.hand = Some(hand);
    let mesh = shaken_block([4, 8, 4], SIZE_M, 0.1, 3);
    held_by(workers, TABLE, mesh, spec, kind, 0.45, Rayleigh::of_mass(60.0))
}

/// Presses the shaft slowly into the block and holds it there.
fn press(world: &mut World, depth_m: f64) {
    world.step(&StepInput::of(&[lying(-2e-3)]).placed());
    for i in 1..=400 {
        world.step(&StepInput::of(&[lying(-2e-3 + (2e-3 + depth_m) * f64::from(i) / 400.0)]));
    }
    for _ in 0..1000 {
        world.step(&StepInput::of(&[lying(depth_m)]));
    }
}

fn pose(world: &World) -> ToolInput {
    world.snapshot().tools[0].pose
}

/// By how much a shaft is turned from along x, as a rotation vector [rad].
fn turned_rad(pose: &ToolInput) -> DVec3 {
    let across = DVec3::X.cross(pose.shaft_in_world);
    across.normalize_or_zero() * across.length().asin()
}

#[test]
fn a_shaft_pressed_far_from_its_tip_lags_by_torque_over_stiffness() {
    for kind in [ModelKind::Precomputed, ModelKind::Implicit, ModelKind::Explicit] {
        let hand = Hand::default();
        let mut world = world(kind, hand, None);
        press(&mut world, 5e-3);
        let report = world.report().tools[0];
        let tip_m = pose(&world).tip_in_world_m;
        let mut points = ContactPoints::default();
        world.contact_points_into(&mut points);
        let torque_n_m: DVec3 =
            points.points.iter().map(|point| (point.place_m - tip_m).cross(point.force_n)).sum();
        let found = report.torque_on_tool_n_m;
        assert!(found.length() > 0.02, "{kind}: {report:?}");
        // The places of nodes, which are in the surface of the mesh by what that is too coarse for.
        assert!((found - torque_n_m).length() < 0.01 * found.length(), "{kind}: {found} {torque_n_m}");
        assert!(
            (found.length() / (report.force_on_tool_n.z * ARM_M) - 1.0).abs() < 0.15,
            "{kind}: {report:?}"
        );
        let expected_rad = found / hand.rotational_stiffness_n_m_per_rad;
        let off_rad = turned_rad(&pose(&world)) - expected_rad;
        let across = DVec3::new(0.0, off_rad.y, off_rad.z).length();
        assert!(
            across < 0.01 * expected_rad.length(),
            "{kind}: {} {expected_rad}",
            turned_rad(&pose(&world))
        );
        let behind_m = pose(&world).tip_in_world_m - lying(5e-3).tip_in_world_m;
        let spring_n = behind_m * hand.stiffness_n_per_m;
        assert!(
            (spring_n - report.force_on_tool_n).length() < 0.01 * spring_n.length(),
            "{kind}: {spring_n} {report:?}"
        );
    }
}

#[test]
fn a_hand_gives_way_at_its_greatest_torque() {
    for kind in [ModelKind::Precomputed, ModelKind::Implicit, ModelKind::Explicit] {
        let hand = Hand { greatest_torque_n_m: 0.05, ..Hand::default() };
        let mut world = world(kind, hand, None);
        world.step(&StepInput::of(&[lying(-2e-3)]).placed());
        let (mut most_n_m, mut most_rad) = (0.0_f64, 0.0_f64);
        for i in 1..=1200 {
            let depth_m = -2e-3 + 0.02 * (f64::from(i) / 600.0).min(1.0);
            let report = world.step(&StepInput::of(&[lying(depth_m)])).tools[0];
            let torque_n_m = report.torque_on_tool_n_m.length();
            assert!(torque_n_m <= hand.greatest_torque_n_m * (1.0 + 1e-9), "{kind}: {torque_n_m}");
            most_n_m = most_n_m.max(torque_n_m);
            if torque_n_m > 0.99 * hand.greatest_torque_n_m {
                most_rad = most_rad.max(turned_rad(&pose(&world)).length());
            }
        }
        assert!(most_n_m > 0.95 * hand.greatest_torque_n_m, "{kind}: {most_n_m}");
        // It is turned further than its spring is by that torque: the hand has given way.
        // Compressed so far, the St Venant-Kirchhoff tissue of explicit models does not come to rest.
        let rests = kind != ModelKind::Explicit;
        let angle_rad = if rests { turned_rad(&pose(&world)).length() } else { most_rad };
        assert!(angle_rad > 2.0 * 0.05 / hand.rotational_stiffness_n_m_per_rad, "{kind}: {angle_rad}");
        // It comes back to the hand where nothing holds it.
        for i in 1..=800 {
            world.step(&StepInput::of(&[lying(0.018 - 0.1 * (f64::from(i) / 400.0).min(1.0))]));
        }
        assert_eq!(pose(&world).shaft_in_world, DVec3::X, "{kind} {:?}", pose(&world));
        assert_eq!(pose(&world).roll_rad, 0.0, "{kind}");
    }
}

#[test]
fn an_instrument_in_a_trocar_turns_with_its_tip_alone() {
    let trocar_m = lying(0.0).tip_in_world_m + DVec3::X * 0.25;
    let mut world = world(ModelKind::Precomputed, Hand::default(), Some(trocar_m));
    press(&mut world, 5e-3);
    let report = world.report().tools[0];
    assert!(report.force_on_tool_n.z > 0.1 && report.torque_on_tool_n_m.length() > 0.01, "{report:?}");
    let pose = pose(&world);
    let to_trocar_m = trocar_m - pose.tip_in_world_m;
    assert!(to_trocar_m.cross(pose.shaft_in_world).length() < 1e-9, "{pose:?}");
}

#[test]
fn a_turned_instrument_makes_the_same_bits_after_coming_back_and_steps_allocate_nothing() {
    for kind in [ModelKind::Precomputed, ModelKind::Implicit, ModelKind::Explicit] {
        let go_on = |world: &mut World, steps: std::ops::Range<u32>| {
            for step in steps {
                let phase = f64::from(step) / 20.0;
                let mut tool = lying(5e-3 + 2e-3 * phase.sin());
                tool.roll_rad = 0.2 * phase.sin();
                tool.shaft_in_world = DVec3::new(1.0, 0.1 * (0.7 * phase).sin(), 0.0).normalize();
                world.step(&StepInput::of(&[tool]));
            }
        };
        let hash = |workers: SharedWorkers| {
            let mut world = world_by(workers, kind, Hand::default(), None);
            press(&mut world, 5e-3);
            go_on(&mut world, 0..100);
            world.state_hash()
        };
        let run = || {
            let mut world = world(kind, Hand::default(), None);
            press(&mut world, 5e-3);
            go_on(&mut world, 0..50);
            let saved = world.save();
            let count = allocation_counter::measure(|| go_on(&mut world, 50..100));
            assert_eq!(count.count_total, 0, "{kind}: {count:?}");
            (saved, world.state_hash())
        };
        let (saved, expected) = run();
        assert_eq!(hash(Arc::new(Backwards)), expected, "{kind}");
        for threads in [1, 2, 4] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            assert_eq!(pool.install(|| run().1), expected, "{kind} with {threads} threads");
        }
        let mut again = world(kind, Hand::default(), None);
        again.restore(&saved);
        go_on(&mut again, 50..100);
        assert_eq!(again.state_hash(), expected, "{kind}");
    }
}
