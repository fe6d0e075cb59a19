//! What the haptic loop is told: forces between publications without jumps, and a world's own answer nearby.

use crate::model_meshes::block;
use glisson::haptics::spread::{MOST_RATE_N_PER_S, SPREAD_S};
use glisson::haptics::{ForceEstimate, Handover, HapticModel, Touch, TouchedPart};
use glisson::material::LinearElastic;
use glisson::math::{DMat3, DVec3, SeededRandom, outer};
use glisson::mesh::TetId;
use glisson::mesh::edit::MeshEdit;
use glisson::model::Rayleigh;
use glisson::model::kind::ModelKind;
use glisson::scene::{OrganBody, build_model};
use glisson::tool::{Grip, Jaws, Tool, ToolInput, ToolKind};
use glisson::world::spec::{Region, Support, WorldSpec, fixed_nodes};
use glisson::world::{StepInput, World};
use proptest::prelude::*;

const TICK_S: f64 = 1e-3;

fn random_vector(random: &mut SeededRandom, size: f64) -> DVec3 {
    DVec3::from_array([0.0; 3].map(|_: f64| random.uniform_in(-size, size)))
}

fn random_stiffness(random: &mut SeededRandom, size: f64) -> DMat3 {
    let part = |random: &mut SeededRandom| {
        let v = random_vector(random, size.sqrt());
        outer(v, v)
    };
    part(random) + part(random) + part(random)
}

/// Of places up to half-way to the trocar, and now and then of the tip itself.
fn random_lever(random: &mut SeededRandom) -> DMat3 {
    let shaft = random_vector(random, 1.0).normalize_or(DVec3::Z);
    let from_tip_m = shaft * random.uniform_in(0.0, 0.05) + random_vector(random, 3e-3);
    if random.next_u64().is_multiple_of(3) {
        return DMat3::IDENTITY;
    }
    DMat3::IDENTITY * (1.0 - shaft.dot(from_tip_m) / 0.1) + outer(shaft, from_tip_m) * (1.0 / 0.1)
}

fn random_model(random: &mut SeededRandom, step: u64, tip_m: DVec3) -> HapticModel {
    let touches = [Touch::Free, Touch::Contact, Touch::Grasp];
    let mut pick = |n: u64| random.next_u64() % n;
    let (touch, n_parts) = (touches[pick(3) as usize], if pick(4) == 0 { 1 + pick(4) as u32 } else { 0 });
    let is_broken = pick(40) == 0;
    let has_friction = pick(3) > 0;
    let part = |random: &mut SeededRandom, touch: Touch| TouchedPart {
        touch,
        force_n: random_vector(random, 5.0),
        stiffness_n_per_m: random_stiffness(random, 300.0),
        normal: random_vector(random, 1.0).normalize_or(DVec3::Z),
        friction_coefficient: if !random.next_u64().is_multiple_of(3) {
            random.uniform_in(0.0, 1.0)
        } else {
            f64::INFINITY
        },
        lever: random_lever(random),
    };
    let mut model =
        HapticModel { step, time_s: step as f64 * 0.03, period_s: 0.03, touch, ..HapticModel::default() };
    for i in 0..n_parts as usize {
        model.parts[i] = part(random, touches[1 + i % 2]);
    }
    let whole = part(random, touch);
    model.n_parts = n_parts;
    model.tip_m = tip_m + random_vector(random, 2e-3);
    (model.force_n, model.stiffness_n_per_m, model.normal) =
        (whole.force_n, whole.stiffness_n_per_m, whole.normal);
    model.gap_m = random.uniform_in(0.0, 3e-3);
    model.surface_velocity_m_per_s = random_vector(random, 0.05);
    if has_friction {
        model.friction_coefficient = random.uniform_in(0.0, 1.0);
    }
    model.hold_n = random.uniform_in(0.1, 5.0);
    if is_broken {
        model.force_n.x = f64::NAN;
    }
    model
}

/// A bound of how much the force follows motion [N/m]: Frobenius norms, of all parts, with friction.
fn follows_n_per_m(model: &HapticModel) -> f64 {
    if !model.is_finite() {
        return 0.0;
    }
    let size = |m: &DMat3| m.to_cols_array().iter().map(|x| x * x).sum::<f64>().sqrt();
    let of = |stiffness: &DMat3, mu: f64| {
        let mu = if mu.is_finite() { mu } else { 20.0 };
        // What a slide adds is no steeper than the stiffness, along the push and, with friction, along the drag.
        ((2.0 + mu) * (2.0 + mu) + 2.0 + mu) * size(stiffness)
    };
    let parts = &model.parts[..model.n_parts as usize];
    let of_part =
        |p: &TouchedPart| of(&p.stiffness_n_per_m, p.friction_coefficient) * size(&p.lever) * size(&p.lever);
    let of_parts: f64 = parts.iter().map(of_part).sum();
    if model.n_parts > 0 { of_parts } else { of(&model.stiffness_n_per_m, model.friction_coefficient) }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn whatever_is_published_the_force_never_jumps(seed in any::<u64>(), estimate in 0..4usize) {
        let random = &mut SeededRandom::new(seed);
        let estimate = ForceEstimate::ALL[estimate];
        let mut handover = Handover::new(estimate);
        let (mut tip_m, mut last_n) = (DVec3::ZERO, DVec3::ZERO);
        let (mut model, mut age_s) = (random_model(random, 0, tip_m), 0.0);
        for step in 1..600_u64 {
            let period = 1 + random.next_u64() % 40;
            let is_new = random.next_u64().is_multiple_of(period);
            if is_new {
                model = random_model(random, step, tip_m);
                age_s = random.uniform_in(0.0, 0.03);
            }
            let way_m = random_vector(random, 2e-4);
            tip_m += way_m;
            age_s += TICK_S;
            let force_n = handover.force(&model, tip_m, age_s, TICK_S);
            prop_assert!(force_n.is_finite());
            let surface_m = model.surface_velocity_m_per_s.length() * TICK_S;
            let change_n = (force_n - last_n).length();
            let explained_n = match estimate {
                ForceEstimate::Hold => 0.0,
                ForceEstimate::LocalModel => follows_n_per_m(&model) * (way_m.length() + surface_m),
                // Extrapolations promise nothing but that a publication does not jump.
                _ => f64::INFINITY,
            };
            prop_assert!(
                change_n <= MOST_RATE_N_PER_S * TICK_S + explained_n + 2e-4,
                "step {step}: {change_n} N, {explained_n} N explained; {model:?}"
            );
            last_n = force_n;
        }
    }
}

fn held(force_n: DVec3, step: u64) -> HapticModel {
    let stiffness_n_per_m = DMat3::IDENTITY * 100.0;
    HapticModel { step, touch: Touch::Grasp, force_n, stiffness_n_per_m, ..HapticModel::default() }
}

#[test]
fn a_ruptures_drop_is_spread_and_all_of_it_is_felt() {
    for drop_n in [0.1, 0.7, 3.0] {
        let before = held(DVec3::Z * (drop_n + 0.2), 1);
        let after = held(DVec3::Z * 0.2, 2);
        let mut handover = Handover::new(ForceEstimate::LocalModel);
        let mut felt_n = DVec3::ZERO;
        for tick in 0..2000 {
            felt_n = handover.force(&before, DVec3::ZERO, f64::from(tick) * TICK_S, TICK_S);
        }
        assert!((felt_n - before.force_n).length() < 1e-12, "the start is over");
        let mut n_ticks = 0;
        while (felt_n - after.force_n).length() > 1e-9 {
            let next_n = handover.force(&after, DVec3::ZERO, f64::from(n_ticks) * TICK_S, TICK_S);
            assert!((next_n - felt_n).length() <= 0.05, "{drop_n}");
            (felt_n, n_ticks) = (next_n, n_ticks + 1);
            assert!(n_ticks < 1000);
        }
        let expected = (drop_n / MOST_RATE_N_PER_S).max(SPREAD_S) / TICK_S;
        assert!((f64::from(n_ticks) - expected).abs() <= 1.0, "{drop_n} N in {n_ticks} ticks");
        assert!(f64::from(n_ticks) >= SPREAD_S / TICK_S - 1e-9);
    }
}

#[test]
fn models_that_come_at_every_tick_still_bring_all_of_a_drop() {
    let mut handover = Handover::new(ForceEstimate::LocalModel);
    for step in 0..2000 {
        handover.force(&held(DVec3::Z * 2.0, step), DVec3::ZERO, 0.0, TICK_S);
    }
    let mut felt_n = DVec3::Z * 2.0;
    for step in 2000..2300 {
        let next_n = handover.force(&held(DVec3::ZERO, step), DVec3::ZERO, 0.0, TICK_S);
        assert!((next_n - felt_n).length() <= 0.05 && next_n.z <= felt_n.z);
        felt_n = next_n;
    }
    assert!(felt_n.length() < 1e-3, "{felt_n}");
}

#[test]
fn a_start_and_a_reconnection_begin_at_nothing_and_a_reason_that_is_no_number_is_none() {
    let model = held(DVec3::Z * 4.0, 1);
    let mut handover = Handover::default();
    for _ in 0..2 {
        let first_n = handover.force(&model, DVec3::X * 1e-3, 0.01, TICK_S);
        assert!(first_n.length() <= 0.05, "{first_n}");
        for _ in 0..1000 {
            handover.force(&model, DVec3::X * 1e-3, 0.01, TICK_S);
        }
        let felt_n = handover.force(&model, DVec3::X * 1e-3, 0.01, TICK_S);
        assert!((felt_n - model.force_at(DVec3::X * 1e-3, 0.01)).length() < 1e-9);
        assert_eq!(handover.force(&model, DVec3::NAN, 0.01, TICK_S), felt_n);
        handover.restart();
    }
    let broken = HapticModel { stiffness_n_per_m: DMat3::IDENTITY * f64::NAN, ..model };
    for _ in 0..1000 {
        assert!(handover.force(&broken, DVec3::X, 0.01, TICK_S).is_finite());
    }
    assert_eq!(handover.force(&broken, DVec3::X, 0.01, TICK_S), DVec3::ZERO);
}

const SIZE_M: f64 = 0.1;
const RADIUS_M: f64 = 3e-3;
const STEP_S: f64 = 2e-3;
const JAWS: Jaws = Jaws { length_m: 0.02, width_m: 0.01, greatest_opening_rad: 1.2, closing_force_n: 10.0 };

fn above(x_m: f64, z_m: f64) -> ToolInput {
    ToolInput::at(DVec3::new(x_m, 0.047, z_m), DVec3::Z)
}

fn tool(kind: ToolKind, grip: Grip) -> Tool {
    Tool { kind, grip, shaft_radius_m: 2e-3, ..Tool::probe("tool", RADIUS_M, above(0.052, 0.2)) }
}

const STICKY: Grip = Grip { friction_coefficient: 1.0, is_sticky: true };

/// A soft block on a table.
fn world(kind: ModelKind, tool: Tool) -> World {
    let mesh = block([6, 6, 6], DVec3::splat(SIZE_M));
    let mut spec = WorldSpec::new("block", step_s(kind), tool);
    let table = Region::Furthest { direction: -DVec3::Z, fraction: 1.0 / 7.0 };
    spec.supports = vec![Support::all_axes(table)];
    let material = LinearElastic::from_young_poisson(5e3, 0.4, 1000.0).unwrap();
    let mut body = OrganBody::new(mesh, material, step_s(kind) / f64::from(parts(kind)));
    body.fixed = fixed_nodes(&spec.supports, &body.mesh.positions_m);
    body.damping = Rayleigh { mass_per_s: 60.0, stiffness_s: 0.0 };
    let model = build_model(&body, kind).unwrap();
    World::new(spec, body.mesh, model, kind).unwrap()
}

/// The implicit model's step is as long as between two pictures: over shorter ones the inertia of what is touched counts in
/// the stiffness, and a world's forces leave it out.
fn step_s(kind: ModelKind) -> f64 {
    if kind == ModelKind::Implicit { 1.0 / 30.0 } else { STEP_S }
}

/// Parts of a step that the model makes.
fn parts(kind: ModelKind) -> u32 {
    if kind == ModelKind::Explicit { 8 } else { 1 }
}

fn step_to(world: &mut World, at: ToolInput) -> DVec3 {
    let n_parts = parts(world.model_kind());
    world.step(&StepInput::of(&[at]).divided(n_parts)).tools[0].force_on_tool_n
}

/// Slowly down to `depth_m` below the surface, there for a while.
fn press(world: &mut World, depth_m: f64) -> ToolInput {
    for i in 0..=100 {
        step_to(world, above(0.052, SIZE_M + RADIUS_M + 1e-3 - (1e-3 + depth_m) * f64::from(i) / 100.0));
    }
    above(0.052, SIZE_M + RADIUS_M - depth_m)
}

#[test]
fn a_published_model_says_what_the_next_step_answers() {
    // What a linear model answers at once is exact but for the symmetric part; over a step of a dynamic one it is a prediction:
    // 26 % off at most where this was written, too stiff because what is beyond five rings is held.
    for (kind, tolerance) in [(ModelKind::Precomputed, 0.01), (ModelKind::Implicit, 0.3)] {
        let mut world = world(kind, tool(ToolKind::PROBE, STICKY));
        let at = press(&mut world, 5e-3);
        // The next step is as short as the world's.
        let model = world.haptic_model_over(0, step_s(kind));
        assert_eq!(model.touch, Touch::Contact);
        assert_eq!(model.step, world.steps_made());
        assert_eq!(model.force_n, world.report().tools[0].force_on_tool_n);
        assert_eq!(model.force_at(model.tip_m, 0.0), model.force_n, "{kind}");
        let saved = world.save();
        for way_m in [DVec3::Z * -5e-4, DVec3::Z * 5e-4, DVec3::X * 5e-4, DVec3::new(3e-4, -2e-4, -3e-4)] {
            world.restore(&saved);
            let moved = ToolInput { tip_in_world_m: at.tip_in_world_m + way_m, ..at };
            let found_n = step_to(&mut world, moved);
            let said_n = model.force_at(moved.tip_in_world_m, step_s(kind));
            let rise_n = (found_n - model.force_n).length();
            let off_n = (said_n - found_n).length();
            assert!(off_n <= tolerance * rise_n, "{kind} {way_m}: {off_n} of {rise_n}; {said_n} {found_n}");
        }
    }
}

#[test]
fn free_tissue_is_felt_before_the_simulation_knows_of_the_touch() {
    for kind in [ModelKind::Precomputed, ModelKind::Implicit] {
        let mut world = world(kind, tool(ToolKind::PROBE, STICKY));
        let near = above(0.052, SIZE_M + RADIUS_M + 3e-4);
        world.step(&StepInput::of(&[near]).placed());
        let model = world.haptic_model_over(0, step_s(kind));
        assert_eq!((model.touch, model.force_n), (Touch::Free, DVec3::ZERO));
        assert!((model.gap_m - 3e-4).abs() < 1e-9 && model.normal.z > 0.999, "{model:?}");
        let deep = above(0.052, SIZE_M + RADIUS_M - 7e-4);
        let found_n = step_to(&mut world, deep).z;
        let said_n = model.force_at(deep.tip_in_world_m, step_s(kind)).z;
        assert!(found_n > 0.02 && (said_n - found_n).abs() < 0.25 * found_n, "{kind}: {said_n} {found_n}");
        world.step(&StepInput::of(&[above(0.052, 0.2)]).placed());
        let far = world.haptic_model(0);
        assert_eq!(far.force_at(far.tip_m - DVec3::Z * 4e-3, 0.03), DVec3::ZERO);
    }
}

#[test]
fn held_tissue_pulls_and_what_is_told_allocates_nothing() {
    for kind in [ModelKind::Precomputed, ModelKind::Explicit, ModelKind::Implicit] {
        let grip = Grip { friction_coefficient: 0.8, is_sticky: false };
        let mut world = world(kind, tool(ToolKind::grasper(JAWS), grip));
        let open = ToolInput { jaw_opening: 1.0, ..above(SIZE_M, SIZE_M - 2e-3) };
        world.step(&StepInput::of(&[open]).placed().divided(parts(kind)));
        let mut closed = open;
        for i in 0..20 {
            closed.jaw_opening = 1.0 - f64::from(i + 1) / 20.0;
            step_to(&mut world, closed);
        }
        for _ in 0..20 {
            closed.tip_in_world_m.z += 1e-4;
            step_to(&mut world, closed);
        }
        let model = world.haptic_model(0);
        assert_eq!(model.touch, Touch::Grasp, "{kind}");
        assert!(model.force_n.z < 0.0 && model.hold_n == 8.0, "{kind}: {model:?}");
        assert!(model.stiffness_n_per_m.z_axis.z > 10.0, "{kind}: {model:?}");
        let further_n = model.force_at(model.tip_m + DVec3::Z * 1e-3, 0.0);
        assert!(further_n.z < model.force_n.z && further_n.length() <= model.hold_n * 1.000_001);
        let count = allocation_counter::measure(|| {
            for _ in 0..3 {
                std::hint::black_box(world.haptic_model(0));
            }
        });
        assert_eq!(count.count_total, 0, "{kind}");
        assert_eq!(world.haptic_model(0), world.haptic_model(0), "the same bits");
    }
}

/// A hand's own path at 1 kHz over models that come every fifth tick: what the tissue did is felt without jumps.
#[test]
fn a_cut_under_the_tip_is_no_jump_and_the_lost_force_is_gone_in_the_end() {
    let mut world = world(ModelKind::Explicit, tool(ToolKind::PROBE, STICKY));
    let at = press(&mut world, 8e-3);
    let mut handover = Handover::default();
    let mut felt_n = DVec3::ZERO;
    let mut model = world.haptic_model(0);
    for _ in 0..1000 {
        felt_n = handover.force(&model, at.tip_in_world_m, 0.0, TICK_S);
    }
    let before_n = felt_n.length();
    assert!(before_n > 0.1, "{before_n}");
    let touched = world.snapshot().tools[0].contacts[0].expect("it is pressed in").nodes;
    let mesh = world.organ().mesh();
    let tets = (0..mesh.tetrahedra.len()).map(TetId::from_index);
    let gone = tets.filter(|t| mesh.tetrahedra[t.index()].iter().any(|n| touched.contains(n))).collect();
    world.edit(&MeshEdit::Remove { tets: gone }).unwrap();
    for _ in 0..60 {
        step_to(&mut world, at);
        model = world.haptic_model(0);
        for tick in 1..=2 {
            let next_n = handover.force(&model, at.tip_in_world_m, f64::from(tick) * TICK_S, TICK_S);
            assert!((next_n - felt_n).length() <= 0.05, "{next_n} after {felt_n}");
            felt_n = next_n;
        }
    }
    assert!(felt_n.length() < 0.3 * before_n, "{felt_n} of {before_n}");
}

/// Where the shaft of the next test goes in: beside the block, as high as its top, so that the shaft meets the edge.
const TROCAR_M: DVec3 = DVec3::new(-0.03, 0.047, SIZE_M);

/// A rod that lies on the block: its tip presses, and its shaft does between the tip and the trocar. What is felt at the tip
/// has to have the moment of both about the trocar, and their force along the shaft.
#[test]
fn a_shaft_and_a_tip_together_are_felt_with_the_moment_of_both() {
    let smooth = Grip { friction_coefficient: 0.0, is_sticky: false };
    for (grip, tolerance) in [(smooth, 0.02), (STICKY, 0.05)] {
        let rod = Tool { trocar_m: Some(TROCAR_M), ..tool(ToolKind::PROBE, grip) };
        let mut world = world(ModelKind::Precomputed, rod);
        let lying = |z_m: f64| ToolInput::at(DVec3::new(0.09, 0.047, z_m), DVec3::NEG_X);
        world.step(&StepInput::of(&[lying(0.12)]).placed());
        for i in 0..=100 {
            world.step(&StepInput::of(&[lying(0.12 - 0.0205 * f64::from(i) / 100.0)]));
        }
        let contacts = world.snapshot().tools[0].contacts;
        let (tip, shaft) = (contacts[0].expect("the tip presses"), contacts[2].expect("so does the shaft"));
        let model = world.haptic_model(0);
        assert_eq!(model.n_parts, 2);
        let [at_tip, at_shaft] = [model.parts[0], model.parts[1]];
        assert!(at_tip.force_n.length() > 0.05 && at_shaft.force_n.length() > 0.05, "{model:?}");
        let sum_n = at_tip.force_n + at_shaft.force_n;
        assert!(sum_n.distance(world.report().tools[0].force_on_tool_n) < 1e-9 * sum_n.length());
        let moment_n_m = (tip.point_m - TROCAR_M).cross(at_tip.force_n)
            + (shaft.point_m - TROCAR_M).cross(at_shaft.force_n);
        let along = (TROCAR_M - model.tip_m).normalize();
        let felt_n = model.force_at(model.tip_m, 0.0);
        assert!(felt_n.distance(model.force_n) < 1e-12);
        let off_n_m = ((model.tip_m - TROCAR_M).cross(felt_n) - moment_n_m).reject_from(along);
        assert!(off_n_m.length() < tolerance * moment_n_m.length(), "{off_n_m} of {moment_n_m}");
        assert!((felt_n.dot(along) - sum_n.dot(along)).abs() < 1e-12);
        // As if both acted at the tip it would be more than that.
        let summed_n_m = (model.tip_m - TROCAR_M).cross(sum_n);
        assert!(
            summed_n_m.length() > (1.0 + 1.5 * tolerance) * moment_n_m.length(),
            "{summed_n_m} {moment_n_m}"
        );
        // The stiffness goes through the levers as well.
        let saved = world.save();
        for way_m in [DVec3::Z * -3e-4, DVec3::Z * 3e-4] {
            world.restore(&saved);
            let tip_m = model.tip_m + way_m;
            world.step(&StepInput::of(&[ToolInput::at(tip_m, along)]));
            let found_n = world.haptic_model(0).force_n;
            let (off_n, rise_n) = (model.force_at(tip_m, 0.0) - found_n, found_n - model.force_n);
            // What slides finds another place of the faceted surface, with another normal: there only the push is compared.
            let (off_n, bound) = if grip.is_sticky { (off_n.length(), 0.02) } else { (off_n.z.abs(), 0.15) };
            assert!(off_n < bound * rise_n.length(), "{way_m}: {off_n} of {rise_n}");
        }
    }
}

/// Closed jaws in the block's edge that turn about the shaft are turned back, and feel what they squeeze.
#[test]
fn jaws_that_hold_are_turned_back_and_pushed_open() {
    let grip = Grip { friction_coefficient: 1.0, is_sticky: true };
    let mut world = world(ModelKind::Precomputed, tool(ToolKind::grasper(JAWS), grip));
    let open = ToolInput { jaw_opening: 1.0, ..above(SIZE_M, SIZE_M - 2e-3) };
    world.step(&StepInput::of(&[open]).placed());
    let mut closed = open;
    for i in 0..20 {
        closed.jaw_opening = 1.0 - f64::from(i + 1) / 20.0;
        step_to(&mut world, closed);
    }
    let model = world.haptic_model(0);
    assert_eq!(model.touch, Touch::Grasp);
    let axes = model.axes;
    assert!(axes.jaw_j > 0.0 && axes.jaw_stiffness_j > 0.0 && axes.jaw_opening == 0.0, "{axes:?}");
    // No more than the closing force of both jaws at their middle.
    let most_j = 2.0 * JAWS.closing_force_n * 0.25 * JAWS.length_m * JAWS.greatest_opening_rad;
    assert!(axes.jaw_j < most_j && axes.jaw_at_j(0.35) < 1e-12, "{axes:?}");
    assert!(axes.twist_stiffness_n_m_per_rad > 0.0, "{axes:?}");
    for turn_rad in [0.05, -0.05] {
        let saved = world.save();
        step_to(&mut world, ToolInput { roll_rad: turn_rad, ..closed });
        let found_n_m = world.haptic_model(0).axes.twist_n_m;
        world.restore(&saved);
        let (said_n_m, rise_n_m) = (axes.twist_at_n_m(turn_rad), found_n_m - axes.twist_n_m);
        assert!(rise_n_m * turn_rad < 0.0, "{found_n_m}");
        assert!((said_n_m - found_n_m).abs() < 0.1 * rise_n_m.abs(), "{said_n_m} {found_n_m}");
    }
    world.haptic_model(0);
    let count = allocation_counter::measure(|| {
        std::hint::black_box(world.haptic_model(0));
    });
    assert_eq!(count.count_total, 0);
}
