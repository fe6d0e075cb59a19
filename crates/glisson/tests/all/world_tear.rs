//! What tissue does not stand in a world: tips that break through, tissue that tears out of jaws, edges that need force,
//! and each cutting instrument with its refusal, its undo and its replay.

use crate::model_meshes::block;
use glisson::image::vessels::Tube;
use glisson::material::LinearElastic;
use glisson::math::DVec3;
use glisson::model::Rayleigh;
use glisson::model::kind::ModelKind;
use glisson::scene::{OrganBody, build_model};
use glisson::tool::fracture::{CrackFront, FractureEnergy, Tearing};
use glisson::tool::{Blade, BladeCuts, Burnt, CutRule, Grip, Jaws, Snip, Tool, ToolInput, ToolKind};
use glisson::world::spec::{Region, Support, WorldSpec, fixed_nodes};
use glisson::world::{EditRefusal, StepInput, ToolCuts, World};

const SIZE_M: f64 = 0.1;
const TIME_STEP_S: f64 = 3e-4;
const RADIUS_M: f64 = 3e-3;
const JAWS: Jaws = Jaws { length_m: 0.02, width_m: 0.01, greatest_opening_rad: 1.2, closing_force_n: 10.0 };

fn above(x_m: f64, y_m: f64, z_m: f64) -> ToolInput {
    ToolInput::at(DVec3::new(x_m, y_m, z_m), DVec3::Z)
}

fn material() -> LinearElastic {
    LinearElastic::from_young_poisson(5e3, 0.4, 1000.0).unwrap()
}

/// A soft block on a table, heavily damped; `energy_j_per_m2` of a crack, if it tears.
fn world(model: ModelKind, kind: ToolKind, energy_j_per_m2: Option<f64>) -> World {
    let grip = Grip { friction_coefficient: 10.0, is_sticky: false };
    let home = above(0.05, 0.05, 0.2);
    let tool = Tool { kind, grip, shaft_radius_m: 2e-3, ..Tool::probe(kind.name(), RADIUS_M, home) };
    let mesh = block([5, 5, 5], DVec3::splat(SIZE_M));
    let table = Region::Furthest { direction: -DVec3::Z, fraction: 1.0 / 6.0 };
    let mut spec = WorldSpec::new("block", TIME_STEP_S, tool);
    spec.supports = vec![Support::all_axes(table)];
    spec.tearing = energy_j_per_m2
        .map(|energy_j_per_m2| Tearing { energy: FractureEnergy { energy_j_per_m2 }, material: material() });
    // Through the upper edge that jaws close on.
    let ends_m = [0.01, 0.09].map(|y_m| DVec3::new(SIZE_M - 4e-3, y_m, SIZE_M - 1.5e-3));
    spec.vessels = vec![Tube { parent: None, ends_m, radii_m: [1e-3; 2] }];
    let mut body = OrganBody::new(mesh, material(), TIME_STEP_S);
    body.fixed = fixed_nodes(&spec.supports, &body.mesh.positions_m);
    body.damping = Rayleigh { mass_per_s: 60.0, stiffness_s: 0.0 };
    let built = build_model(&body, model).unwrap();
    World::new(spec, body.mesh, built, model).unwrap()
}

/// What a motion did.
#[derive(Debug, Default, PartialEq)]
struct Motion {
    greatest_n: f64,
    /// Work of the hand [J].
    work_j: f64,
    cuts: ToolCuts,
}

/// Steps in which the tool moves from `from` to `to`, with what it cuts after each.
fn glide(world: &mut World, from: &ToolInput, to: &ToolInput, steps: u32) -> Motion {
    let mut all = Motion::default();
    for i in 1..=steps {
        let t = f64::from(i) / f64::from(steps);
        let pose = ToolInput {
            tip_in_world_m: from.tip_in_world_m.lerp(to.tip_in_world_m, t),
            jaw_opening: from.jaw_opening + (to.jaw_opening - from.jaw_opening) * t,
            ..*to
        };
        let report = world.step(&StepInput::of(&[pose]));
        assert_eq!(report.n_non_finite_nodes, 0);
        let force_n = report.tools[0].force_on_tool_n;
        all.greatest_n = all.greatest_n.max(force_n.length());
        all.work_j -= force_n.dot(to.tip_in_world_m - from.tip_in_world_m) / f64::from(steps);
        let cuts = world.cut_with_tools();
        all.cuts.n_removed += cuts.n_removed;
        all.cuts.n_torn += cuts.n_torn;
        all.cuts.n_edits += cuts.n_edits;
        all.cuts.refusals.extend(cuts.refusals);
    }
    all
}

fn push(world: &mut World, depth_m: f64) -> Motion {
    let start = above(0.047, 0.053, SIZE_M + RADIUS_M + 1e-3);
    world.step(&StepInput::of(&[start]).placed());
    let deep = above(0.047, 0.053, SIZE_M + RADIUS_M - depth_m);
    glide(world, &start, &deep, 1000)
}

#[test]
fn a_tip_that_is_pushed_too_hard_breaks_through_and_its_force_stays_bounded() {
    let energy = 40.0;
    let critical_n =
        FractureEnergy { energy_j_per_m2: energy }.cutting_force_n(CrackFront::blunt(RADIUS_M).length_m);
    let whole = push(&mut world(ModelKind::Explicit, ToolKind::PROBE, None), 0.05);
    let torn = push(&mut world(ModelKind::Explicit, ToolKind::PROBE, Some(energy)), 0.05);
    assert_eq!((whole.cuts.n_torn, whole.cuts.n_removed), (0, 0));
    assert!(whole.greatest_n > 3.0 * critical_n, "{whole:?}, critical {critical_n} N");
    assert!(torn.cuts.n_torn > 0 && torn.greatest_n < 3.0 * critical_n, "{torn:?}, critical {critical_n} N");
    // A push that tissue stands leaves it whole.
    let gentle = push(&mut world(ModelKind::Explicit, ToolKind::PROBE, Some(energy)), 2.5e-3);
    assert!(
        gentle.cuts.n_torn == 0 && gentle.greatest_n > 0.1 * critical_n,
        "{gentle:?}, critical {critical_n} N"
    );
}

#[test]
fn tissue_of_a_model_that_cannot_be_cut_lets_the_tip_through() {
    let energy = 40.0;
    let critical_n =
        FractureEnergy { energy_j_per_m2: energy }.cutting_force_n(CrackFront::blunt(RADIUS_M).length_m);
    let mut world = world(ModelKind::Reduced, ToolKind::PROBE, Some(energy));
    let motion = push(&mut world, 0.05);
    assert!(motion.greatest_n < 5.0 * critical_n, "{} N, critical {critical_n} N", motion.greatest_n);
    assert!(matches!(motion.cuts.refusals[0].1, EditRefusal::Model(_)));
    assert!(!world.report().in_contact(), "it came through");
}

#[test]
fn tissue_that_is_pulled_too_hard_tears_out_of_jaws_that_do_not_slip() {
    let energy = 20.0;
    let mut world = world(ModelKind::Explicit, ToolKind::grasper(JAWS), Some(energy));
    let open = ToolInput { jaw_opening: 1.0, ..above(SIZE_M, 0.04, SIZE_M - 2e-3) };
    world.step(&StepInput::of(&[open]).placed());
    let closed = ToolInput { jaw_opening: 0.0, ..open };
    glide(&mut world, &open, &closed, 20);
    assert!(!world.held_nodes(0).is_empty());
    let volume_m3 = world.organ().body().volume_m3();
    let far = ToolInput { jaw_opening: 0.0, ..above(SIZE_M, 0.04, SIZE_M + 0.15) };
    let motion = glide(&mut world, &closed, &far, 1500);
    let front = CrackFront::around(JAWS.length_m, JAWS.width_m);
    let critical_n = FractureEnergy { energy_j_per_m2: energy }.cutting_force_n(front.length_m);
    assert!(motion.greatest_n < 4.0 * critical_n, "{} N, critical {critical_n} N", motion.greatest_n);
    assert!(motion.cuts.n_torn > 0 && world.organ().body().volume_m3() < volume_m3, "{motion:?}");
    // What is left has come back; only what the jaws took with them is far away.
    let off_m = world.report().tools[0].force_on_tool_n.length();
    assert!(off_m < 0.1 * critical_n, "the tool is free of the organ: {off_m} N");
}

/// A blade that goes through half of the block from outside, 30 mm deep.
fn stroke(world: &mut World) -> Motion {
    let pose = |x_m: f64| ToolInput { trigger: 1.0, ..above(x_m, 0.047, SIZE_M - 0.03) };
    let (start, end) = (pose(-0.02), pose(0.05));
    world.step(&StepInput::of(&[start]).placed());
    let mut motion = glide(world, &start, &end, 700);
    let off = ToolInput { trigger: 0.0, ..end };
    let last = glide(world, &end, &off, 1);
    motion.cuts.n_edits += last.cuts.n_edits;
    motion
}

/// Area of the organ's surface at rest [m2].
fn surface_m2(world: &World) -> f64 {
    let shown = world.display_topology();
    let at = |i: u32| shown.rest_positions_m[i as usize];
    shown.triangles.iter().map(|&[a, b, c]| 0.5 * (at(b) - at(a)).cross(at(c) - at(a)).length()).sum()
}

#[test]
fn an_edge_needs_force_before_it_cuts_and_work_for_what_it_cuts() {
    for cuts in [BladeCuts::Subdivision, BladeCuts::Displacement] {
        let energy = 20.0;
        let blade = ToolKind::scalpel(Blade { length_m: 0.06, edge_radius_m: RADIUS_M, cuts });
        let mut world = world(ModelKind::Explicit, blade, Some(energy));
        world.set_undo_depth(1000);
        let (volume_m3, area_m2) = (world.organ().body().volume_m3(), surface_m2(&world));
        // Held against the side with less than it takes: nothing is cut.
        let pose = |x_m: f64| ToolInput { trigger: 1.0, ..above(x_m, 0.047, SIZE_M - 0.03) };
        world.step(&StepInput::of(&[pose(-0.02)]).placed());
        let leant = glide(&mut world, &pose(-0.02), &pose(-RADIUS_M + 1e-3), 300);
        assert!(leant.cuts.n_edits == 0 && leant.greatest_n > 0.0, "{cuts:?}: {leant:?}");
        glide(&mut world, &pose(-RADIUS_M + 1e-3), &pose(-0.02), 300);
        let motion = stroke(&mut world);
        assert!(motion.cuts.n_edits > 0, "{cuts:?}: {motion:?}");
        let least_n = energy * 2.0 * RADIUS_M;
        assert!(motion.greatest_n > least_n, "{cuts:?}: {} N of {least_n}", motion.greatest_n);
        let crack_m2 = 0.5 * (surface_m2(&world) - area_m2);
        // Cuts come in jumps of a quarter of this stroke; the last one is not paid for, because the blade stops there.
        let price_j = energy * crack_m2;
        assert!(crack_m2 > 5e-4 && motion.work_j > 0.6 * price_j, "{cuts:?}: {crack_m2} m2, {motion:?}");
        let lost = 1.0 - world.organ().body().volume_m3() / volume_m3;
        assert!(motion.cuts.n_torn > 0 || lost.abs() < 1e-9, "{cuts:?}: {lost}");
        // Without tearing the same stroke costs nothing.
        let free = stroke(&mut self::world(ModelKind::Explicit, blade, None));
        assert_eq!((free.work_j, free.greatest_n), (0.0, 0.0), "{cuts:?}");
        while world.undo_edit() {}
        assert_eq!(world.organ().body().mesh(), &block([5, 5, 5], DVec3::splat(SIZE_M)), "{cuts:?}");
    }
}

/// A sharp point goes into tissue on which a blunt one leans.
#[test]
fn a_sharp_edge_goes_in_where_a_blunt_one_leans() {
    let press_and_draw = |edge_radius_m: f64| {
        let blade = Blade { length_m: 0.06, edge_radius_m, cuts: BladeCuts::Subdivision };
        let mut world = world(ModelKind::Explicit, ToolKind::scalpel(blade), Some(164.0));
        let pose = |out_m: f64| ToolInput { trigger: 1.0, ..above(0.047, 0.053, SIZE_M + out_m) };
        world.step(&StepInput::of(&[pose(0.01)]).placed());
        // As deep as a hand goes with a point.
        let pressed = glide(&mut world, &pose(0.01), &pose(-0.006), 400);
        let drawn = ToolInput { trigger: 1.0, ..above(0.077, 0.053, SIZE_M - 0.006) };
        let cut = glide(&mut world, &pose(-0.006), &drawn, 400);
        let end = glide(&mut world, &drawn, &ToolInput { trigger: 0.0, ..drawn }, 1);
        (pressed.greatest_n, cut.cuts.n_edits + end.cuts.n_edits, pressed.cuts.n_torn + cut.cuts.n_torn)
    };
    let [sharp, blunt] = [0.0, RADIUS_M].map(press_and_draw);
    assert!(sharp.1 > 0 && sharp.2 == 0, "{sharp:?}");
    assert!(blunt.0 > 164.0 * 2.0 * RADIUS_M && sharp.0 < 0.5 * blunt.0, "{sharp:?} {blunt:?}");
}

/// Drawn along its edge as well as across it, a blade cuts with less force and the same work (slicing: work G A over a longer way).
#[test]
fn slicing_takes_less_force_and_the_same_work() {
    let energy = 20.0;
    let mean_force_n = |along_m: f64| {
        let blade = Blade { length_m: 0.09, edge_radius_m: 0.0, cuts: BladeCuts::Subdivision };
        let mut world = world(ModelKind::Explicit, ToolKind::scalpel(blade), Some(energy));
        let area_m2 = surface_m2(&world);
        let pose = |x_m: f64, z_m: f64| ToolInput { trigger: 1.0, ..above(x_m, 0.047, SIZE_M - 0.03 + z_m) };
        // The part of the edge that is in the block goes down the block's side in both strokes.
        world.step(&StepInput::of(&[pose(-0.02, along_m)]).placed());
        let motion = glide(&mut world, &pose(-0.02, along_m), &pose(0.05, 0.0), 700);
        let crack_m2 = 0.5 * (surface_m2(&world) - area_m2);
        (motion.work_j / (energy * crack_m2), motion.work_j / crack_m2.sqrt() / 0.07_f64.hypot(along_m))
    };
    let [pushed, sliced] = [0.0, 0.025].map(mean_force_n);
    assert!((0.6..1.3).contains(&pushed.0) && (0.6..1.3).contains(&sliced.0), "{pushed:?} {sliced:?}");
    assert!(sliced.1 < pushed.1, "{pushed:?} {sliced:?}");
}

/// Closes jaws on the upper edge and lets the current flow for as many steps.
fn close_on_edge(world: &mut World, trigger: f64, steps: u32) -> Motion {
    let open = ToolInput { jaw_opening: 1.0, ..above(SIZE_M, 0.04, SIZE_M - 5e-3) };
    world.step(&StepInput::of(&[open]).placed());
    let closed = ToolInput { jaw_opening: 0.0, trigger, ..open };
    let mut motion = glide(world, &open, &closed, 20);
    let held = glide(world, &closed, &closed, steps);
    motion.cuts.n_removed += held.cuts.n_removed;
    motion.cuts.refusals.extend(held.cuts.refusals);
    motion
}

/// An instrument with jaws cuts, bleeds, is undone bit for bit, and does the same again; it refuses where the model
/// cannot follow.
fn cuts_and_is_taken_back(kind: ToolKind, energy_j_per_m2: Option<f64>, steps: u32) {
    let mut world = world(ModelKind::Explicit, kind, energy_j_per_m2);
    let motion = close_on_edge(&mut world, 1.0, steps);
    let has_cut = motion.cuts.n_removed + motion.cuts.n_edits > 0;
    assert!(has_cut && motion.cuts.refusals.is_empty(), "{motion:?}");
    let vessels = world.vessels().unwrap();
    let corners_m: Vec<[DVec3; 4]> =
        world.organ().removed_tetrahedra().iter().map(|&t| world.organ().mesh().corners_m(t)).collect();
    assert_eq!(vessels.open_ends().len(), 1, "the vessel in the edge bleeds: {corners_m:?}");
    assert!(vessels.bleeding_m3_per_s() > 0.0 && world.snapshot().bleeding.ends.len() == 1);

    let mut again = self::world(ModelKind::Explicit, kind, energy_j_per_m2);
    close_on_edge(&mut again, 1.0, steps);
    assert_eq!(again.state_hash(), world.state_hash(), "the same again");

    // A clip stops it, and is in the hash.
    let hash = world.state_hash();
    assert!(world.clip_vessel(0), "within reach of the jaws");
    assert!(world.state_hash() != hash);
    assert_eq!(world.snapshot().bleeding.rate_m3_per_s, 0.0);

    while world.undo_edit() {}
    assert_eq!(world.organ().body().mesh(), &block([5, 5, 5], DVec3::splat(SIZE_M)));
    assert!(world.organ().removed_tetrahedra().is_empty());
    assert_eq!(world.vessels().unwrap().bleeding_m3_per_s(), 0.0, "the vessel is whole again");

    let mut frozen = self::world(ModelKind::Reduced, kind, energy_j_per_m2);
    let refused = close_on_edge(&mut frozen, 1.0, steps);
    assert!(matches!(refused.cuts.refusals[0].1, EditRefusal::Model(_)), "{refused:?}");
    assert!(frozen.organ().removed_tetrahedra().is_empty());
}

#[test]
fn scissors_cut_are_taken_back_and_refuse() {
    for snip in [Snip::Tetrahedra, Snip::Subdivision] {
        cuts_and_is_taken_back(ToolKind::scissors(JAWS, snip), None, 1);
        cuts_and_is_taken_back(ToolKind::scissors(JAWS, snip), Some(164.0), 1);
    }
    let weak = Jaws { closing_force_n: 1.0, ..JAWS };
    let mut world = world(ModelKind::Explicit, ToolKind::scissors(weak, Snip::Tetrahedra), Some(164.0));
    let motion = close_on_edge(&mut world, 1.0, 1);
    let [(0, EditRefusal::TooWeak { found_n, needed_n })] = motion.cuts.refusals[..] else {
        panic!("{motion:?}")
    };
    assert!(found_n == 1.0 && (needed_n - 1.64).abs() < 1e-12 && motion.cuts.n_removed == 0);
}

#[test]
fn cautery_burns_is_taken_back_and_refuses() {
    let by_time = CutRule { least_force_n: 0.05, least_time_s: 0.01, power_w: 0.0, takes: Burnt::Tetrahedra };
    cuts_and_is_taken_back(ToolKind::cautery(JAWS, by_time), None, 100);
    // A hundred kilowatts, because the block's tetrahedra are as large as a hazelnut.
    let by_heat = CutRule { power_w: 1e5, ..by_time };
    cuts_and_is_taken_back(ToolKind::cautery(JAWS, by_heat), Some(164.0), 250);
    let mut world = world(ModelKind::Explicit, ToolKind::cautery(JAWS, by_time), None);
    assert_eq!(close_on_edge(&mut world, 0.0, 100).cuts.n_removed, 0, "without current it only holds");
}

/// Bipolar jaws hold the edge, warm it for so many steps, and pull at it. Answers when they parted something and what tore.
fn pulled_with_warm_jaws(warm_steps: u32) -> (Option<u32>, Motion) {
    let by_heat = CutRule { least_force_n: 0.05, least_time_s: 0.01, power_w: 1e5, takes: Burnt::Tetrahedra };
    let mut world = world(ModelKind::Explicit, ToolKind::cautery(JAWS, by_heat), Some(60.0));
    let open = ToolInput { jaw_opening: 1.0, ..above(SIZE_M, 0.04, SIZE_M - 2e-3) };
    world.step(&StepInput::of(&[open]).placed());
    let closed = ToolInput { jaw_opening: 0.0, ..open };
    glide(&mut world, &open, &closed, 20);
    assert!(!world.held_nodes(0).is_empty());
    let on = ToolInput { trigger: 1.0, ..closed };
    let parted = (1..=warm_steps).find(|_| glide(&mut world, &on, &on, 1).cuts.n_removed > 0);
    // Without current: what is warm stays weak.
    let far = ToolInput { jaw_opening: 0.0, ..above(SIZE_M, 0.04, SIZE_M + 0.02) };
    (parted, glide(&mut world, &closed, &far, 400))
}

#[test]
fn heat_between_jaws_weakens_what_they_hold() {
    let by_heat_alone = pulled_with_warm_jaws(1000).0.expect("the current parts it");
    let ((_, cold), (parted, warm)) = (pulled_with_warm_jaws(0), pulled_with_warm_jaws(by_heat_alone - 1));
    assert_eq!(parted, None, "just before that");
    assert!(cold.cuts.n_torn == 0 && cold.greatest_n > 0.0, "{cold:?}");
    assert!(warm.cuts.n_torn > 0, "{warm:?}");
    assert!(warm.greatest_n < cold.greatest_n, "{} N against {} N", warm.greatest_n, cold.greatest_n);
}

#[test]
fn what_tears_is_the_same_after_coming_back_and_steps_allocate_nothing() {
    let mut first = world(ModelKind::Explicit, ToolKind::PROBE, Some(40.0));
    let start = above(0.047, 0.053, SIZE_M + RADIUS_M + 1e-3);
    let (middle, deep) = (above(0.047, 0.053, SIZE_M - 0.012), above(0.047, 0.053, SIZE_M - 0.05));
    first.step(&StepInput::of(&[start]).placed());
    glide(&mut first, &start, &middle, 300);
    let saved = first.save();
    let torn = glide(&mut first, &middle, &deep, 500);
    let hash = first.state_hash();
    first.restore(&saved);
    assert_eq!(glide(&mut first, &middle, &deep, 500), torn);
    assert!(torn.cuts.n_torn > 0 && first.state_hash() == hash);
    let pose = [deep];
    first.step(&StepInput::of(&pose));
    let count = allocation_counter::measure(|| {
        for _ in 0..50 {
            first.step(&StepInput::of(&pose));
        }
    });
    assert_eq!(count.count_total, 0);
}
