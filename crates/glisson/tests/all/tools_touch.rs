//! Two instruments that touch each other, held by hands that give way.

use crate::bodies::{Backwards, TABLE, held_at, held_by};
use crate::model_meshes::{block, shaken_block};
use glisson::haptics::Touch;
use glisson::math::DVec3;
use glisson::model::kind::ModelKind;
use glisson::model::{Rayleigh, StateHash};
use glisson::record::snapshot::{ContactKind, ContactPoints};
use glisson::tool::{Tool, ToolInput};
use glisson::workers::{Sequential, SharedWorkers};
use glisson::world::spec::{Hand, WorldSpec};
use glisson::world::{StepInput, World};
use std::sync::Arc;

const STEP_S: f64 = 1e-3;
const RADIUS_M: f64 = 2.5e-3;
/// Distance of the axes of two shafts that touch.
const APART_M: f64 = 2.0 * RADIUS_M;
/// From the tips of the crossing instruments to where they cross.
const ARM_M: f64 = 0.1;
/// Height at which they cross, over a block that they do not touch.
const HEIGHT_M: f64 = 0.3;

fn rod(name: &str, trocar_m: Option<DVec3>) -> Tool {
    let home = ToolInput::at(DVec3::new(-0.3, 0.3, HEIGHT_M), DVec3::Z);
    Tool { shaft_radius_m: RADIUS_M, trocar_m, ..Tool::probe(name, RADIUS_M, home) }
}

/// Two rods and a block on a table.
fn world_of(rods: Vec<Tool>, hand: Option<Hand>) -> World {
    let mut spec = WorldSpec::new("crossed", STEP_S, rods[0].clone());
    spec.tools = rods;
    spec.hand = hand;
    let mesh = block([2; 3], DVec3::splat(0.02));
    held_at(TABLE, mesh, spec, ModelKind::Precomputed, 0.45, Rayleigh::of_mass(60.0))
}

fn world(hand: Option<Hand>) -> World {
    world_of(vec![rod("below", None), rod("above", None)], hand)
}

/// The one below lies along x, the one above along y: so far over the other that their surfaces have this gap, and so far along it.
fn crossed(gap_m: f64, along_m: f64) -> [ToolInput; 2] {
    let below = ToolInput::at(DVec3::new(-ARM_M, 0.0, HEIGHT_M), DVec3::X);
    let above = ToolInput::at(DVec3::new(along_m, ARM_M, HEIGHT_M + APART_M + gap_m), DVec3::NEG_Y);
    [below, above]
}

fn put(world: &mut World, tools: &[ToolInput]) {
    world.step(&StepInput::of(tools).placed());
}

/// Moves the one above from one gap to another.
fn press(world: &mut World, [from_m, to_m]: [f64; 2], speed_m_per_s: f64) {
    let n = ((from_m - to_m).abs() / (speed_m_per_s * STEP_S)).ceil() as u32;
    for i in 1..=n {
        let gap_m = from_m + (to_m - from_m) * f64::from(i) / f64::from(n);
        world.step(&StepInput::of(&crossed(gap_m, 0.0)));
    }
}

fn stay(world: &mut World, tools: &[ToolInput], n: u32) {
    for _ in 0..n {
        world.step(&StepInput::of(tools));
    }
}

fn points_of(world: &World) -> ContactPoints {
    let mut points = ContactPoints::default();
    world.contact_points_into(&mut points);
    points
}

fn forces_n(world: &World) -> [DVec3; 2] {
    [0, 1].map(|tool| world.report().tools[tool].force_on_tool_n)
}

fn poses(world: &World) -> [ToolInput; 2] {
    let snapshot = world.snapshot();
    [0, 1].map(|tool| snapshot.tools[tool].pose)
}

/// Height of the axis above over the axis below where they cross, measured across both.
fn over_m(world: &World) -> f64 {
    let [below, above] = poses(world);
    let across = above.shaft_in_world.cross(below.shaft_in_world).normalize();
    (above.tip_in_world_m - below.tip_in_world_m).dot(across)
}

/// What a newton between the two lets them give way by: the springs of both hands, which turn them about their tips as well.
fn yields_m_per_n(hand: &Hand) -> f64 {
    2.0 / hand.stiffness_n_per_m + 2.0 * ARM_M * ARM_M / hand.rotational_stiffness_n_m_per_rad
}

#[test]
fn crossed_instruments_bear_the_same_force_as_their_springs_say() {
    let hand = Hand::default();
    let mut world = world(Some(hand));
    put(&mut world, &crossed(1e-3, 0.0));
    assert_eq!(forces_n(&world), [DVec3::ZERO; 2]);
    for depth_m in [1e-3, 5e-3, 10e-3] {
        press(&mut world, [1e-3, -depth_m], 0.1);
        stay(&mut world, &crossed(-depth_m, 0.0), 100);
        let [below_n, above_n] = forces_n(&world);
        assert!((below_n + above_n).length() < 1e-9, "{below_n} {above_n}");
        let expected_n = depth_m / yields_m_per_n(&hand);
        assert!((above_n.z / expected_n - 1.0).abs() < 0.01, "{depth_m}: {above_n}, expected {expected_n}");
        assert!((over_m(&world) - APART_M).abs() < 1e-5, "{depth_m}: {}", over_m(&world));
        let found = points_of(&world);
        let [point] = found.points[..] else { panic!("{found:?}") };
        assert_eq!((point.kind, point.touched, point.by), (ContactKind::Tools, 1, 0));
        assert!(point.force_n.distance(below_n) < 1e-12 && point.normal.z < -0.995, "{point:?}");
        assert!(point.place_m.truncate().length() < 1e-3, "{point:?}");
        press(&mut world, [-depth_m, 1e-3], 0.1);
        stay(&mut world, &crossed(1e-3, 0.0), 50);
        assert_eq!((forces_n(&world), points_of(&world)), ([DVec3::ZERO; 2], ContactPoints::default()));
    }
}

#[test]
fn no_hand_bears_more_than_its_force_and_torque() {
    // The torque is reached first where they cross far from their tips, the force where they cross near them.
    let by_force =
        Hand { greatest_torque_n_m: 1e3, rotational_stiffness_n_m_per_rad: 100.0, ..Hand::default() };
    let weak = Hand { greatest_force_n: 2.0, ..Hand::default() };
    for (hand, expected_n) in [(Hand::default(), 10.0), (by_force, 30.0), (weak, 2.0)] {
        let mut world = world(Some(hand));
        put(&mut world, &crossed(1e-3, 0.0));
        let mut most_n = 0.0_f64;
        for i in 0..200 {
            let gap_m = 1e-3 - 0.1 * f64::from(i.min(100)) / 100.0;
            let report = world.step(&StepInput::of(&crossed(gap_m, 0.0)));
            for tool in &report.tools[..2] {
                let (force_n, torque_n_m) = (tool.force_on_tool_n.length(), tool.torque_on_tool_n_m.length());
                assert!(force_n <= hand.greatest_force_n * (1.0 + 1e-9), "{hand:?}: {force_n}");
                assert!(torque_n_m <= hand.greatest_torque_n_m * (1.0 + 1e-9), "{hand:?}: {torque_n_m}");
                most_n = most_n.max(force_n);
            }
            let [below_n, above_n] = forces_n(&world);
            assert!((below_n + above_n).length() < 1e-9, "{hand:?} {i}: {below_n} {above_n}");
            assert!(over_m(&world) > 0.9 * APART_M, "{hand:?} {i}: {}", over_m(&world));
        }
        assert!((most_n / expected_n - 1.0).abs() < 0.05, "{hand:?}: {most_n} {:?}", forces_n(&world));
    }
}

#[test]
fn instruments_do_not_pass_through_each_other_at_5_m_per_s() {
    for hand in
        [Hand::default(), Hand { greatest_force_n: 300.0, greatest_torque_n_m: 10.0, ..Hand::default() }]
    {
        for speed_m_per_s in [0.5, 5.0, 20.0] {
            let mut world = world(Some(hand));
            put(&mut world, &crossed(20e-3, 0.0));
            press(&mut world, [20e-3, -60e-3], speed_m_per_s);
            assert!(over_m(&world) > 0.9 * APART_M, "{speed_m_per_s}: {}", over_m(&world));
            stay(&mut world, &crossed(-60e-3, 0.0), 100);
            assert!((over_m(&world) - APART_M).abs() < 2e-4, "{speed_m_per_s}: {}", over_m(&world));
            assert!(forces_n(&world)[1].z > 5.0, "{speed_m_per_s}: {:?}", forces_n(&world));
        }
    }
}

/// Tips that run into each other head on, and a tip into a shaft: they stop each other.
#[test]
fn tips_stop_at_5_m_per_s_as_well() {
    let at = |x_m: f64, shaft: DVec3| ToolInput::at(DVec3::new(x_m, 0.0, HEIGHT_M), shaft);
    let slanted = at(0.03, DVec3::new(0.0, 0.6, 0.8));
    let with_shaft =
        ToolInput { tip_in_world_m: slanted.tip_in_world_m - 0.01 * slanted.shaft_in_world, ..slanted };
    for (name, other) in [("tip", at(0.03, DVec3::X)), ("shaft", with_shaft)] {
        let mut world = world(Some(Hand::default()));
        put(&mut world, &[at(0.0, DVec3::NEG_X), other]);
        for i in 1..=12 {
            world.step(&StepInput::of(&[at(5e-3 * f64::from(i), DVec3::NEG_X), other]));
            let [first, second] = poses(&world);
            let between_m = second.tip_in_world_m.x - first.tip_in_world_m.x;
            assert!(between_m > 0.9 * APART_M, "{name} {i}: {between_m}");
        }
        stay(&mut world, &[at(0.06, DVec3::NEG_X), other], 50);
        let [first_n, second_n] = forces_n(&world);
        assert!((first_n + second_n).length() < 1e-9 && second_n.x > 20.0, "{name}: {first_n} {second_n}");
        assert!(second_n.length() <= 30.0 * (1.0 + 1e-9), "{name}: {second_n}");
    }
}

/// The one above is drawn along the one below: what acts across the push is the coefficient of friction of the push.
#[test]
fn instruments_rub_on_each_other() {
    let mut world = world(Some(Hand::default()));
    let gap_m = -3e-3;
    put(&mut world, &crossed(1e-3, 0.0));
    press(&mut world, [1e-3, gap_m], 0.1);
    stay(&mut world, &crossed(gap_m, 0.0), 50);
    for i in 1..=1000 {
        world.step(&StepInput::of(&crossed(gap_m, 2e-5 * f64::from(i))));
    }
    let [below_n, above_n] = forces_n(&world);
    let [point] = points_of(&world).points[..] else { panic!("one place") };
    let push_n = below_n.dot(point.normal);
    let rub = (below_n - point.normal * push_n).length() / push_n;
    assert!((rub - 0.2).abs() < 0.002 && below_n.x > 0.0, "{rub}: {below_n}");
    assert!((below_n + above_n).length() < 1e-9, "{below_n} {above_n}");
    // Held still it sticks: what acts across stays within the cone.
    let at = crossed(gap_m, 0.02 - 1e-4);
    stay(&mut world, &at, 50);
    let held_n = forces_n(&world)[0];
    let push_n = held_n.dot(point.normal);
    let rub = (held_n - point.normal * push_n).length() / push_n;
    assert!(rub < 0.19, "{rub}: {held_n}");
}

/// Put into each other they come apart, slowly: faster than by 0.2 m/s nothing is pushed out, and no force is above the hand's.
#[test]
fn instruments_that_were_put_into_each_other_come_apart() {
    for gap_m in [-0.5 * APART_M, -APART_M, -1.2 * APART_M] {
        let mut world = world(Some(Hand { stiffness_n_per_m: 1e3, ..Hand::default() }));
        let tools = crossed(gap_m, 0.0);
        let mut before = tools;
        for i in 0..300 {
            let input = StepInput::of(&tools);
            let report = world.step(&if i == 0 { input.placed() } else { input });
            assert!(report.tools.iter().all(|tool| tool.force_on_tool_n.length() <= 30.0 * (1.0 + 1e-9)));
            let now = poses(&world);
            for tool in 0..2 {
                let way_m = now[tool].tip_in_world_m.distance(before[tool].tip_in_world_m);
                assert!(way_m < 0.25e-3, "{gap_m} {i}: {way_m}");
            }
            before = now;
        }
        assert!(over_m(&world).abs() > APART_M - 1e-4, "{gap_m}: {}", over_m(&world));
    }
}

/// Two shafts that lie along each other, the rear end of each 50 mm before the other's tip, touch at both rear ends.
#[test]
fn shafts_along_each_other_touch_at_both_ends() {
    let hand = Hand::default();
    let (before_m, shared_m) = (0.05, 0.25);
    let at = |gap_m: f64| {
        let below = ToolInput::at(DVec3::new(-0.1, 0.0, HEIGHT_M), DVec3::X);
        let above_m = DVec3::new(shared_m, 0.0, HEIGHT_M + APART_M + gap_m);
        [below, ToolInput::at(above_m, DVec3::NEG_X)]
    };
    let mut world = world(Some(hand));
    put(&mut world, &at(1e-3));
    for i in 0..=40 {
        world.step(&StepInput::of(&at(1e-3 - 5e-5 * f64::from(i))));
    }
    stay(&mut world, &at(-1e-3), 200);
    let [below_n, above_n] = forces_n(&world);
    // Both forces act on both springs of both: near the tip of the one, far from that of the other.
    let arms_m = 2.0 * before_m + shared_m;
    let at_end_m_per_n =
        4.0 / hand.stiffness_n_per_m + arms_m * arms_m / hand.rotational_stiffness_n_m_per_rad;
    let expected_n = 2.0 * 1e-3 / at_end_m_per_n;
    assert!((above_n.z / expected_n - 1.0).abs() < 0.03, "{above_n}, expected {expected_n}");
    assert!((below_n + above_n).length() < 1e-9, "{below_n} {above_n}");
    let places_m: Vec<f64> = points_of(&world).points.iter().map(|point| point.place_m.x).collect();
    let [first_m, last_m] = [f64::min, f64::max].map(|of| places_m.iter().copied().reduce(of).unwrap());
    assert!((last_m - first_m - shared_m).abs() < 5e-3, "{places_m:?}");
}

#[test]
fn hands_that_impose_their_motion_pass_through_each_other() {
    let mut world = world(None);
    put(&mut world, &crossed(1e-3, 0.0));
    press(&mut world, [1e-3, -0.02], 0.5);
    assert_eq!((forces_n(&world), points_of(&world).points.len()), ([DVec3::ZERO; 2], 0));
    assert_eq!(poses(&world), crossed(-0.02, 0.0));
}

/// Through trocars: what they turn about bears its share, the force is still the same on both.
#[test]
fn instruments_in_trocars_push_each_other_aside() {
    let trocars_m = [DVec3::new(0.2, 0.0, HEIGHT_M), DVec3::new(0.0, -0.2, HEIGHT_M + APART_M)];
    let rods = vec![rod("below", Some(trocars_m[0])), rod("above", Some(trocars_m[1]))];
    let mut world = world_of(rods, Some(Hand::default()));
    put(&mut world, &crossed(1e-3, 0.0));
    press(&mut world, [1e-3, -2e-3], 0.2);
    let tools = crossed(-2e-3, 0.0);
    stay(&mut world, &tools, 100);
    let [below_n, above_n] = forces_n(&world);
    assert!((below_n + above_n).length() < 1e-9 && above_n.z > 1.0, "{below_n} {above_n}");
    // A third of the way to the trocar there are two thirds of the tip's motion left.
    let lever = 1.0 - ARM_M / 0.3;
    let closer_m = lever * 2e-3;
    let expected_n = closer_m / (2.0 * lever * lever / 1e4);
    assert!((above_n.z / expected_n - 1.0).abs() < 0.03, "{above_n}, expected {expected_n}");
    assert!((over_m(&world) - APART_M).abs() < 1e-4, "{}", over_m(&world));
    for (pose, trocar_m) in poses(&world).iter().zip(trocars_m) {
        let off_m = (trocar_m - pose.tip_in_world_m).cross(pose.shaft_in_world).length();
        assert!(off_m < 1e-9, "{off_m}");
    }
}

/// An instrument that lies on tissue is pushed into it by another.
fn on_tissue(kind: ModelKind) -> (World, impl Fn(f64) -> [ToolInput; 2]) {
    on_tissue_by(Arc::new(Sequential), kind)
}

fn on_tissue_by(workers: SharedWorkers, kind: ModelKind) -> (World, impl Fn(f64) -> [ToolInput; 2]) {
    let mut spec = WorldSpec::new("crossed on tissue", 0.5 * STEP_S, rod("below", None));
    spec.tools.push(rod("above", None));
    spec.hand = Some(Hand::default());
    let size_m = DVec3::new(0.06, 0.06, 0.03);
    let mesh = shaken_block([8, 8, 4], size_m, 0.1, 3);
    let world = held_by(workers, TABLE, mesh, spec, kind, 0.45, Rayleigh::of_mass(60.0));
    let at = move |gap_m: f64| {
        let below_z_m = size_m.z + RADIUS_M - 1e-3;
        let below = ToolInput::at(DVec3::new(0.03, 0.03, below_z_m), DVec3::new(0.8, 0.0, 0.6));
        let beyond = below.tip_in_world_m + below.shaft_in_world * 0.02;
        let above = beyond + DVec3::new(-0.6, 0.0, 0.8) * (APART_M + gap_m) + DVec3::Y * 0.02;
        [below, ToolInput::at(above, DVec3::NEG_Y)]
    };
    (world, at)
}

#[test]
fn instruments_that_cross_while_one_presses_into_tissue_share_its_force() {
    for kind in [ModelKind::Precomputed, ModelKind::Implicit, ModelKind::Explicit] {
        let (mut world, at) = on_tissue(kind);
        put(
            &mut world,
            &at(0.02).map(|pose| ToolInput { tip_in_world_m: pose.tip_in_world_m + DVec3::Z * 0.03, ..pose }),
        );
        for i in 0..=100 {
            let up_m = DVec3::Z * 0.03 * (1.0 - f64::from(i) / 100.0);
            let lifted =
                at(0.02).map(|pose| ToolInput { tip_in_world_m: pose.tip_in_world_m + up_m, ..pose });
            world.step(&StepInput::of(&lifted));
        }
        stay(&mut world, &at(0.02), 100);
        let alone_n = forces_n(&world)[0];
        for i in 0..=100 {
            world.step(&StepInput::of(&at(0.02 - 0.025 * f64::from(i) / 100.0)));
        }
        stay(&mut world, &at(-5e-3), 200);
        let found = points_of(&world);
        let sum_of = |of: ContactKind| -> DVec3 {
            found.points.iter().filter(|point| point.kind == of).map(|point| point.force_n).sum()
        };
        let (of_tissue_n, between_n) = (sum_of(ContactKind::ToolOrgan), sum_of(ContactKind::Tools));
        let [below_n, above_n] = forces_n(&world);
        assert!(
            between_n.z < -1.0 && of_tissue_n.z > alone_n.z,
            "{kind}: {between_n} {of_tissue_n} {alone_n}"
        );
        assert!((below_n - of_tissue_n - between_n).length() < 1e-9, "{kind}: {below_n}");
        assert!((above_n + between_n).length() < 1e-9, "{kind}: {above_n}");
        let limit_n = Hand::default().greatest_force_n * (1.0 + 1e-9);
        assert!([below_n, above_n].iter().all(|force_n| force_n.length() <= limit_n), "{kind}");
    }
}

#[test]
fn a_device_feels_the_other_instrument_and_its_hands_spring() {
    let hand = Hand::default();
    let mut world = world(Some(hand));
    put(&mut world, &crossed(1e-3, 0.0));
    press(&mut world, [1e-3, -5e-3], 0.1);
    stay(&mut world, &crossed(-5e-3, 0.0), 100);
    for tool in 0..2 {
        let model = world.haptic_model(tool);
        assert_eq!(model.touch, Touch::Contact);
        assert!((model.force_n - forces_n(&world)[tool]).length() < 1e-9, "{model:?}");
        let stiffness_n_per_m = DVec3::Z.dot(model.stiffness_n_per_m * DVec3::Z);
        let expected = 1.0 / yields_m_per_n(&hand);
        assert!((stiffness_n_per_m / expected - 1.0).abs() < 0.01, "{stiffness_n_per_m} {expected}");
    }
    let before_n = forces_n(&world)[1];
    let model = world.haptic_model(1);
    let tools = crossed(-6e-3, 0.0);
    stay(&mut world, &tools, 100);
    let (found_n, said_n) = (forces_n(&world)[1], model.force_at(tools[1].tip_in_world_m, 0.0));
    assert!((said_n - found_n).length() < 0.02 * (found_n - before_n).length(), "{said_n} {found_n}");
}

#[test]
fn an_instrument_that_another_strikes_does_not_go_through_the_tissue_under_it() {
    // In a step of that length a hand gives way by more than the radius.
    const STEP_S: f64 = 1e-2;
    const THIN_M: f64 = 1e-3;
    for kind in [ModelKind::Precomputed, ModelKind::Implicit] {
        let thin = Tool { shaft_radius_m: THIN_M, ..rod("below", None) };
        let mut spec = WorldSpec::new("struck", STEP_S, thin);
        spec.tools.push(rod("above", None));
        spec.hand = Some(Hand::default());
        let size_m = DVec3::new(0.03, 0.03, 0.03);
        let mut world =
            held_at(TABLE, shaken_block([5; 3], size_m, 0.1, 3), spec, kind, 0.45, Rayleigh::of_mass(60.0));
        // Over the block, far from its tip, and a little above it.
        let below = ToolInput::at(DVec3::new(-ARM_M, 0.015, size_m.z + THIN_M + 1e-3), DVec3::X);
        let above = |gap_m: f64| {
            let tip_m = DVec3::new(0.015, -0.02, below.tip_in_world_m.z + THIN_M + RADIUS_M + gap_m);
            ToolInput::at(tip_m, DVec3::Y)
        };
        put(&mut world, &[below, above(5e-3)]);
        for i in 1..=60 {
            let gap_m = (5e-3 - 5.0 * STEP_S * f64::from(i)).max(-0.02);
            world.step(&StepInput::of(&[below, above(gap_m)]));
            let pose = world.snapshot().tools[0].pose;
            let over_block_m = pose.tip_in_world_m + pose.shaft_in_world * (ARM_M + 0.015);
            let on_tissue = points_of(&world).sums[ContactKind::ToolOrgan as usize].n > 0;
            assert!(i < 3 || on_tissue, "{kind} step {i}: {over_block_m}");
        }
    }
}

/// What two instruments do on tissue and to each other in so many steps.
fn wander(world: &mut World, at: &dyn Fn(f64) -> [ToolInput; 2], steps: std::ops::Range<u32>) {
    for step in steps {
        let phase = f64::from(step);
        let [mut below, mut above] = at(0.01 - 0.015 * (phase / 60.0).sin().abs());
        below.tip_in_world_m += DVec3::new(2e-3 * (phase / 23.0).sin(), 0.0, -1e-3 * (phase / 31.0).sin());
        above.tip_in_world_m.x += 3e-3 * (phase / 17.0).sin();
        above.roll_rad = 0.3 * (phase / 40.0).sin();
        world.step(&StepInput::of(&[below, above]));
    }
}

#[test]
fn instruments_in_contact_make_the_same_bits_at_any_number_of_threads_and_after_coming_back() {
    for kind in [ModelKind::Precomputed, ModelKind::Implicit, ModelKind::Explicit] {
        let run = |workers: SharedWorkers| -> StateHash {
            let (mut world, at) = on_tissue_by(workers, kind);
            put(&mut world, &at(0.01));
            wander(&mut world, &at, 0..300);
            assert!(points_of(&world).sums[ContactKind::Tools as usize].n > 0, "{kind}");
            world.state_hash()
        };
        let expected = run(Arc::new(Sequential));
        assert_eq!(run(Arc::new(Backwards)), expected, "{kind}");
        for threads in [1, 2, 4] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            assert_eq!(pool.install(|| run(Arc::new(Sequential))), expected, "{kind} with {threads} threads");
        }
        let (mut first, at) = on_tissue(kind);
        put(&mut first, &at(0.01));
        wander(&mut first, &at, 0..250);
        assert!(points_of(&first).sums[ContactKind::Tools as usize].n > 0, "{kind}");
        let (saved, points) = (first.save(), points_of(&first));
        let (mut snapshot, mut room) = (first.snapshot(), points_of(&first));
        room.points.reserve(1000);
        first.prepare_haptics();
        let count = allocation_counter::measure(|| {
            for from in (250..300).step_by(10) {
                wander(&mut first, &at, from..from + 10);
                first.snapshot_into(&mut snapshot);
                first.contact_points_into(&mut room);
                first.haptic_model(0);
                first.haptic_model(1);
            }
        });
        assert_eq!(count.count_total, 0, "{kind}: {count:?}");
        assert_eq!(first.state_hash(), expected, "{kind}");
        let (mut again, _) = on_tissue(kind);
        again.restore(&saved);
        assert_eq!(points_of(&again), points, "{kind}");
        wander(&mut again, &at, 250..300);
        assert_eq!(again.state_hash(), expected, "{kind}");
    }
}
