//! The world's contract with real models: a step allocates nothing, the same inputs make the same bits at any
//! number of threads, and a saved moment comes back whole.

use crate::model_meshes::block;
use glisson::material::{LinearElastic, PronyTerm, law_named};
use glisson::math::DVec3;
use glisson::mesh::edit::MeshEdit;
use glisson::mesh::{NodeId, TetId};
use glisson::model::StateHash;
use glisson::model::kind::ModelKind;
use glisson::model::{Constraints, DeformableModel, FollowedEdits, NodalForce, Rayleigh};
use glisson::scene::{MeasuredSample, OrganBody, build_model, build_model_as_cut};
use glisson::solve::equilibrating_stress;
use glisson::tool::{Tool, ToolInput};
use glisson::world::spec::{Load, LoadTime, Region, Support, WorldSpec, fixed_nodes};
use glisson::world::{StepInput, World};

const TIME_STEP_S: f64 = 3e-4;
const SIZE_M: f64 = 0.1;

/// A block on a table, a ball above it; a load comes and goes.
fn world(kind: ModelKind) -> World {
    let mesh = block([5, 5, 5], DVec3::splat(SIZE_M));
    let table = Region::Furthest { direction: -DVec3::Z, fraction: 1.0 / 6.0 };
    let home = ToolInput::at(DVec3::splat(2.0 * SIZE_M), DVec3::Z);
    let tool = Tool::probe("ball", 8e-3, home);
    let mut spec = WorldSpec::new("block", TIME_STEP_S, tool);
    spec.supports = vec![Support::all_axes(table)];
    let corner = Region::Ball { center_m: DVec3::splat(SIZE_M), radius_m: 0.3 * SIZE_M };
    let (force_n, time) = (DVec3::new(0.02, 0.0, 0.0), LoadTime::During { from_s: 0.1, to_s: 0.2 });
    spec.loads = vec![Load { region: corner, force_n, time }];
    let material = LinearElastic::from_young_poisson(5e3, 0.45, 1000.0).unwrap();
    let mut body = OrganBody::new(mesh, material, TIME_STEP_S);
    body.fixed = fixed_nodes(&spec.supports, &body.mesh.positions_m);
    body.damping = Rayleigh { mass_per_s: 30.0, stiffness_s: 0.0 };
    let folder = tempfile::tempdir().unwrap();
    let curve = folder.path().join("curve.csv");
    std::fs::write(&curve, "axial_displacement_mm,force_mn\n0,0\n1,90\n2,200\n3,340\n4,520\n5,760\n6,1100\n")
        .unwrap();
    body.measured = Some(MeasuredSample { curve, height_m: 0.02, radius_m: 0.01, degree: 4 });
    let model = build_model(&body, kind).unwrap();
    World::new(spec, body.mesh, model, kind).unwrap()
}

/// The ball bounces on the block, each time elsewhere.
fn input(step: u64) -> StepInput {
    let t = step as f64 * 5e-3;
    let x_m = SIZE_M * (0.5 + 0.3 * libm::sin(0.37 * t));
    let z_m = SIZE_M + 8e-3 + 8e-3 * libm::cos(t);
    let tool = ToolInput::at(DVec3::new(x_m, 0.45 * SIZE_M, z_m), DVec3::Z);
    let input = StepInput::of(&[tool]).divided(1 + u32::from(step.is_multiple_of(7)));
    if step.is_multiple_of(400) { input.placed() } else { input }
}

/// How many steps of a kind a test can afford.
fn affordable(kind: ModelKind, steps: u64) -> u64 {
    if kind == ModelKind::Implicit { steps / 4 } else { steps }
}

fn run(kind: ModelKind, steps: u64) -> (StateHash, u64) {
    let mut world = world(kind);
    let touching = (0..steps).filter(|&step| world.step(&input(step)).in_contact()).count() as u64;
    (world.state_hash(), touching)
}

#[test]
fn a_step_allocates_nothing() {
    for kind in ModelKind::ALL {
        let mut world = world(kind);
        let mut snapshot = world.snapshot();
        world.step(&input(0));
        let mut contacts = 0;
        let count = allocation_counter::measure(|| {
            for step in 1..1000 {
                contacts += u32::from(world.step(&input(step)).in_contact());
                world.snapshot_into(&mut snapshot);
            }
        });
        assert!(contacts > 100, "{kind}: {contacts} steps in contact");
        assert_eq!(count.count_total, 0, "{kind}");
    }
}

#[test]
fn the_same_inputs_make_the_same_bits_at_any_number_of_threads() {
    for kind in ModelKind::ALL {
        let steps = affordable(kind, 2000);
        let expected = run(kind, steps);
        assert!(expected.1 > steps / 10 && expected.1 < steps, "{kind}: {} steps in contact", expected.1);
        for threads in [1, 2, 4] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            assert_eq!(pool.install(|| run(kind, steps)), expected, "{kind} with {threads} threads");
        }
    }
}

/// Steps `from..to`; before every twentieth a tetrahedron goes. Answers the steps in contact.
fn cut_along(world: &mut World, from: u64, to: u64) -> u64 {
    let mut touching = 0;
    for step in from..to {
        if step.is_multiple_of(20) {
            let tets = vec![TetId::from_index((step as usize * 7) % 5 * 3 + step as usize / 20 * 5)];
            let refusal = world.edit(&MeshEdit::Remove { tets }).err();
            let is_frozen = world.model_kind().row().edits == FollowedEdits::None;
            assert_eq!(refusal.is_some(), is_frozen, "{}: {refusal:?}", world.model_kind());
        }
        touching += u64::from(world.step(&input(step)).in_contact());
    }
    touching
}

#[test]
fn a_saved_moment_comes_back_in_mid_contact_with_its_cuts() {
    for kind in ModelKind::ALL {
        let mut first = world(kind);
        let touching = cut_along(&mut first, 1, 410);
        assert!(touching > 50, "{kind}: {touching} steps in contact");
        let saved = first.save();
        let at_save = first.state_hash();
        cut_along(&mut first, 410, 600);
        let expected = first.state_hash();

        let mut again = world(kind);
        again.step(&input(0));
        for world in [&mut first, &mut again] {
            world.restore(&saved);
            assert_eq!(world.state_hash(), at_save, "{kind}");
            let count = allocation_counter::measure(|| {
                for step in 410..419 {
                    world.step(&input(step));
                }
            });
            assert_eq!(count.count_total, 0, "{kind}: steps after restoring");
            world.restore(&saved);
            cut_along(world, 410, 600);
            assert_eq!(world.state_hash(), expected, "{kind}");
        }
    }
}

#[test]
fn a_model_that_takes_over_has_the_cuts_of_the_one_before() {
    let mut world = world(ModelKind::TensorMass);
    let material = LinearElastic::from_young_poisson(5e3, 0.45, 1000.0).unwrap();
    let mut body = OrganBody::new(world.organ().mesh().clone(), material, TIME_STEP_S);
    body.fixed = fixed_nodes(&world.spec().supports, &body.mesh.positions_m);
    cut_along(&mut world, 1, 100);
    world.queue_model_swap(100, ModelKind::NonlinearTensorMass);
    let model = build_model(&body, ModelKind::NonlinearTensorMass).unwrap();
    assert_eq!(world.deliver_model(model, ModelKind::NonlinearTensorMass), Ok(true));
    // A cut between delivery and take-over reaches both.
    cut_along(&mut world, 100, 200);
    assert_eq!(world.model_kind(), ModelKind::NonlinearTensorMass);
    world.queue_model_swap(200, ModelKind::Precomputed);
    let live = world.organ().live_tetrahedra().to_vec();
    cut_along(&mut world, 200, 200);
    let of_the_whole = build_model(&body, ModelKind::Precomputed).unwrap();
    assert_eq!(world.deliver_model(of_the_whole, ModelKind::Precomputed), Ok(true));
    let mut again = self::world(ModelKind::TensorMass);
    again.restore(&world.save());
    let of_the_rest = build_model_as_cut(&body, ModelKind::Precomputed, &live).unwrap();
    assert_eq!(again.deliver_model(of_the_rest, ModelKind::Precomputed), Ok(true));
    for world in [&mut world, &mut again] {
        cut_along(world, 200, 300);
        assert_eq!(world.model_kind(), ModelKind::Precomputed);
    }
    let positions_m = world.state().positions_m.iter().zip(again.state().positions_m);
    let difference_m = positions_m.map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
    assert!(difference_m < 1e-9, "{difference_m:e}");
}

#[test]
fn a_world_saved_before_a_touch_feels_it_after() {
    for kind in ModelKind::ALL {
        let mut first = world(kind);
        first.step(&input(1));
        let saved = first.save();
        let mut again = world(kind);
        again.restore(&saved);
        let steps = affordable(kind, 500);
        let count = allocation_counter::measure(|| {
            for step in 2..steps {
                // Quasi-static models show a touch at once, so that both have to be asked in every step.
                let ignored = again.step(&input(step)).model.n_ignored_constraints;
                assert_eq!(ignored, 0, "{kind} at {step}");
            }
        });
        assert_eq!(count.count_total, 0, "{kind}");
        let touching = (2..steps).filter(|&step| first.step(&input(step)).in_contact()).count();
        assert!(kind == ModelKind::Implicit || touching > 50, "{kind}: {touching} steps in contact");
        assert_eq!(again.state_hash(), first.state_hash(), "{kind}");
    }
}

#[test]
fn reset_forgets_what_relaxing_stress_remembers() {
    for kind in [ModelKind::Explicit, ModelKind::Implicit] {
        let mesh = block([3, 3, 3], DVec3::splat(SIZE_M));
        let material = LinearElastic::from_young_poisson(5e3, 0.45, 1000.0).unwrap();
        let mut body = OrganBody::new(mesh, material, TIME_STEP_S);
        let table = Region::Furthest { direction: -DVec3::Z, fraction: 0.25 };
        body.fixed = fixed_nodes(&[Support::all_axes(table)], &body.mesh.positions_m);
        body.relaxation = vec![PronyTerm { share: 0.5, time_s: 0.01 }];
        body.gravity_m_per_s2 = DVec3::new(3.0, 0.0, 0.0);
        let mut model = build_model(&body, kind).unwrap();
        for _ in 0..100 {
            model.step(TIME_STEP_S);
        }
        let sag_m = |model: &dyn DeformableModel| {
            let moved = model.state().positions_m.iter().zip(&body.mesh.positions_m);
            moved.map(|(p, rest)| p.distance(*rest)).fold(0.0, f64::max)
        };
        let largest_m = sag_m(model.as_ref());
        assert!(largest_m > 1e-4, "{kind}: {largest_m}");
        model.set_gravity(DVec3::ZERO);
        model.take_over(&body.mesh.positions_m);
        for _ in 0..100 {
            model.step(TIME_STEP_S);
        }
        assert!(sag_m(model.as_ref()) < 1e-9 * largest_m, "{kind}: {}", sag_m(model.as_ref()));
    }
}

#[test]
fn tissue_too_soft_for_its_weight_is_refused_by_models_that_would_buckle() {
    for (young_pa, is_stiff) in [(20e3, true), (600.0, false)] {
        let mesh = block([6, 2, 2], DVec3::new(SIZE_M, 0.3 * SIZE_M, 0.3 * SIZE_M));
        let material = LinearElastic::from_young_poisson(young_pa, 0.4, 1000.0).unwrap();
        let mut body = OrganBody::new(mesh, material, 1e-4);
        let wall = Region::Furthest { direction: -DVec3::X, fraction: 0.1 };
        body.fixed = fixed_nodes(&[Support::all_axes(wall)], &body.mesh.positions_m);
        body.gravity_m_per_s2 = DVec3::new(-9.81, 0.0, 0.0);
        let gravity = body.gravity_m_per_s2;
        body.rest_stress_pa =
            equilibrating_stress(&body.mesh, &body.material, &body.fixed, &[], gravity).unwrap();
        assert!(build_model(&body, ModelKind::TensorMass).is_ok());
        let linear = OrganBody { law: law_named("linear"), ..body.clone() };
        assert!(build_model(&linear, ModelKind::Explicit).is_ok());
        // It has a law of its own.
        assert_eq!(build_model(&linear, ModelKind::NonlinearTensorMass).is_ok(), is_stiff);
        for kind in [ModelKind::NonlinearTensorMass, ModelKind::Explicit, ModelKind::Implicit] {
            match build_model(&body, kind) {
                Ok(mut model) => {
                    assert!(is_stiff, "{kind}");
                    // A little push from its side does not grow.
                    let node = NodeId::from_index(body.mesh.positions_m.len() - 1);
                    let force_n = DVec3::new(0.0, 1e-6, 1e-6);
                    let forces = vec![NodalForce { node, force_n }];
                    model.apply(&Constraints { displacements: Vec::new(), forces });
                    (0..3000).for_each(|_| model.step(1e-4));
                    let moved = model.state().positions_m.iter().zip(&body.mesh.positions_m);
                    let furthest_m = moved.map(|(p, rest)| p.distance(*rest)).fold(0.0, f64::max);
                    assert!(furthest_m < 1e-4, "{kind}: {furthest_m}");
                }
                Err(error) => assert!(!is_stiff && error.to_string().contains("buckle"), "{kind}: {error}"),
            }
        }
    }
}
