//! An organ that touches itself: lobes driven together, a piece cut loose, and what does not count as contact.

use glisson::contact::crossing;
use glisson::contact::response::self_contact::{SelfContactParams, SelfContactResponse};
use glisson::material::LinearElastic;
use glisson::math::{Aabb, DVec3, tetrahedron_volume_m3};
use glisson::mesh::box_mesh::cells_of_five;
use glisson::mesh::edit::MeshEdit;
use glisson::mesh::{NodeId, TetId, TetMesh};
use glisson::model::Rayleigh;
use glisson::model::StateHash;
use glisson::model::kind::ModelKind;
use glisson::record::snapshot::{ContactKind, ContactPoints};
use glisson::scene::{OrganBody, build_model};
use glisson::tool::{Tool, ToolInput};
use glisson::world::spec::{Load, LoadTime, Region, Support, WorldSpec, fixed_nodes};
use glisson::world::{StepInput, World};

const CELL_M: f64 = 8e-3;
/// How far surfaces may go into each other [m]: what users see.
const MOST_CROSSING_M: f64 = 0.5e-3;
const GEOMETRIC: SelfContactResponse = SelfContactParams::geometric(0.2);
const SPRINGS: SelfContactResponse = SelfContactParams::penalty(100.0, 0.2);
/// Models with each way that they respond.
const RESPONDING: [(ModelKind, SelfContactResponse); 3] =
    [(ModelKind::Explicit, GEOMETRIC), (ModelKind::Implicit, GEOMETRIC), (ModelKind::Explicit, SPRINGS)];

struct Setting {
    kind: ModelKind,
    time_step_s: f64,
    response: Option<SelfContactResponse>,
}

impl Setting {
    fn of(kind: ModelKind, response: Option<SelfContactResponse>) -> Self {
        let time_step_s = if kind == ModelKind::Implicit { 2e-3 } else { 5e-4 };
        Self { kind, time_step_s, response }
    }

    fn world(&self, mesh: TetMesh, gravity_m_per_s2: DVec3, loads: Vec<Load>) -> World {
        let home = ToolInput::at(DVec3::splat(1.0), DVec3::Z);
        let mut spec = WorldSpec::new("folds", self.time_step_s, Tool::probe("ball", 5e-3, home));
        let bottom = Aabb { min_m: DVec3::splat(-1.0), max_m: DVec3::new(1.0, 1.0, 1e-6) };
        spec.supports = vec![Support::all_axes(Region::Box(bottom))];
        spec.gravity_m_per_s2 = gravity_m_per_s2;
        spec.loads = loads;
        spec.self_contact = self.response.map(|response| SelfContactParams { margin_m: 2e-3, response });
        let material = LinearElastic::from_young_poisson(5e3, 0.4, 1000.0).unwrap();
        let mut body = OrganBody::new(mesh, material, self.time_step_s);
        body.fixed = fixed_nodes(&spec.supports, &body.mesh.positions_m);
        body.damping = Rayleigh { mass_per_s: 10.0, stiffness_s: 0.0 };
        body.gravity_m_per_s2 = gravity_m_per_s2;
        body.is_imaged_under_gravity = false;
        let model = build_model(&body, self.kind).unwrap();
        World::new(spec, body.mesh, model, self.kind).unwrap()
    }

    fn steps(&self, time_s: f64) -> usize {
        (time_s / self.time_step_s).round() as usize
    }
}

fn idle(world: &World) -> StepInput {
    StepInput::of(&[world.tools()[0].home])
}

/// Deepest node of one part inside the tetrahedra of the other [m], either way. `part` tells by the place at rest.
fn crossing_m(world: &World, part: &dyn Fn(DVec3) -> Option<bool>) -> f64 {
    let (organ, now_m) = (world.organ(), world.state().positions_m);
    for (n, p) in now_m.iter().enumerate() {
        assert!(p.is_finite(), "node {n}");
    }
    crossing::crossing_m(organ.mesh(), organ.live_tetrahedra(), now_m, part)
}

/// A body with a slot, whose two lobes are pressed together from outside.
fn lobes(setting: &Setting) -> World {
    let mesh = cells_of_five([7, 2, 6], CELL_M, |[x, _, z]| x != 3 || z == 0);
    let press = |from: f64, to: f64, force_n: f64| Load {
        region: Region::Box(Aabb {
            min_m: DVec3::new(from, -0.1, 2.9) * CELL_M,
            max_m: DVec3::new(to, 10.0, 10.0) * CELL_M,
        }),
        force_n: DVec3::new(force_n, 0.0, 0.0),
        time: LoadTime::Always,
    };
    setting.world(mesh, DVec3::ZERO, vec![press(-0.1, 0.1, 0.05), press(6.9, 7.1, -0.05)])
}

fn lobe(rest_m: DVec3) -> Option<bool> {
    let place = rest_m / CELL_M;
    (place.z > 1.1 && !(3.1..3.9).contains(&place.x)).then_some(place.x > 3.5)
}

/// Largest crossing on the way.
fn crossing_of_lobes_m(setting: &Setting) -> f64 {
    let mut world = lobes(setting);
    let idle = idle(&world);
    let mut worst_m = 0.0_f64;
    for step in 0..setting.steps(0.2) {
        world.step(&idle);
        if step % setting.steps(0.01) == 0 {
            worst_m = worst_m.max(crossing_m(&world, &lobe));
        }
    }
    worst_m
}

fn assert_lobes_stay_apart(kind: ModelKind) {
    let through_m = crossing_of_lobes_m(&Setting::of(kind, None));
    assert!(through_m > 4e-3, "{kind} without contact: {through_m:e} m");
    for response in [GEOMETRIC, SPRINGS] {
        let crossing_m = crossing_of_lobes_m(&Setting::of(kind, Some(response)));
        assert!(crossing_m <= MOST_CROSSING_M, "{kind} with {response:?}: {crossing_m:e} m");
    }
}

#[test]
fn lobes_of_linear_tissue_that_are_driven_together_do_not_cross() {
    assert_lobes_stay_apart(ModelKind::TensorMass);
}

#[test]
fn lobes_of_an_explicit_model_that_are_driven_together_do_not_cross() {
    assert_lobes_stay_apart(ModelKind::Explicit);
}

#[test]
fn lobes_of_an_implicit_model_that_are_driven_together_do_not_cross() {
    assert_lobes_stay_apart(ModelKind::Implicit);
}

/// A small block on a wide one; what joins them is taken out, so that the small one falls by 3.2 mm.
fn block_on_a_block(setting: &Setting) -> World {
    let is_middle = |x: usize| (2..5).contains(&x);
    let mut mesh = cells_of_five([7, 7, 5], CELL_M, |[x, y, z]| z < 3 || is_middle(x) && is_middle(y));
    for p in mesh.positions_m.iter_mut().filter(|p| p.z > 3.5 * CELL_M) {
        p.z -= 0.6 * CELL_M;
    }
    setting.world(mesh, DVec3::new(0.0, 0.0, -9.81), Vec::new())
}

fn cut_loose(world: &mut World) {
    let mesh = world.organ().mesh();
    let is_between = |tet: &[NodeId; 4]| {
        let z = tet.iter().map(|n| mesh.positions_m[n.index()].z).sum::<f64>() / 4.0;
        z > 3.0 * CELL_M && z < 3.4 * CELL_M
    };
    let tets = (0..mesh.tetrahedra.len()).filter(|t| is_between(&mesh.tetrahedra[*t])).map(TetId::from_index);
    let tets = tets.collect();
    world.edit(&MeshEdit::Remove { tets }).unwrap();
}

fn piece(rest_m: DVec3) -> Option<bool> {
    Some(rest_m.z > 3.2 * CELL_M)
}

/// Mean displacement and largest speed of the loose piece.
fn piece_motion(world: &World) -> (DVec3, f64) {
    let (rest_m, state) = (&world.organ().mesh().positions_m, world.state());
    let nodes: Vec<usize> = (0..rest_m.len()).filter(|n| piece(rest_m[*n]) == Some(true)).collect();
    let moved_m = nodes.iter().map(|&n| state.positions_m[n] - rest_m[n]).sum::<DVec3>() / nodes.len() as f64;
    let speed_m_per_s = nodes.iter().map(|&n| state.velocities_m_per_s[n].length()).fold(0.0, f64::max);
    (moved_m, speed_m_per_s)
}

#[test]
fn a_piece_that_is_cut_loose_falls_on_the_rest_and_stays_there() {
    for kind in [ModelKind::Explicit, ModelKind::Implicit] {
        for response in [None, Some(GEOMETRIC)] {
            let setting = Setting::of(kind, response);
            let mut world = block_on_a_block(&setting);
            let idle = idle(&world);
            world.step(&idle);
            cut_loose(&mut world);
            let mut worst_m = 0.0_f64;
            for step in 0..setting.steps(0.4) {
                world.step(&idle);
                if step % setting.steps(0.01) == 0 && response.is_some() {
                    worst_m = worst_m.max(crossing_m(&world, &piece));
                }
            }
            let (moved_m, speed_m_per_s) = piece_motion(&world);
            if response.is_none() {
                assert!(moved_m.z < -0.1, "{kind}: it fell {moved_m} m");
                continue;
            }
            assert!(worst_m <= MOST_CROSSING_M, "{kind}: {worst_m:e} m");
            assert!(moved_m.z > -4.5e-3 && moved_m.z < -3.2e-3, "{kind}: it fell {moved_m} m");
            assert!(moved_m.truncate().length() < 0.3e-3, "{kind}: it drifted {moved_m} m");
            assert!(speed_m_per_s < 0.05, "{kind}: {speed_m_per_s} m/s");
            assert!(world.report().self_contact.n_contacts > 10, "{kind}");
        }
    }
}

/// The mean of the contacts' forces while a piece lies still is its weight, whatever keeps the surfaces apart.
#[test]
fn contact_points_bear_the_weight_of_a_loose_piece() {
    for (kind, response) in RESPONDING {
        let setting = Setting::of(kind, Some(response));
        let mut world = block_on_a_block(&setting);
        let idle = idle(&world);
        cut_loose(&mut world);
        let (organ, density_kg_per_m3) = (world.organ(), 1000.0);
        let mesh = organ.mesh();
        let live = mesh.tetrahedra.iter().zip(organ.live_tetrahedra()).filter(|(_, is_live)| **is_live);
        let above =
            live.filter(|(tet, _)| tet.iter().all(|n| piece(mesh.positions_m[n.index()]) == Some(true)));
        let volume_m3: f64 =
            above.map(|(tet, _)| tetrahedron_volume_m3(tet.map(|n| mesh.positions_m[n.index()]))).sum();
        let weight_n = volume_m3 * density_kg_per_m3 * 9.81;
        let (mut borne_n, mut found) = (0.0, ContactPoints::default());
        let (all, last) = (setting.steps(0.5), setting.steps(0.15));
        for step in 0..all {
            world.step(&idle);
            if step >= all - last {
                world.contact_points_into(&mut found);
                // Vertices of either side: what acts on one of the lower body, acts back on the piece.
                borne_n +=
                    found.points.iter().map(|p| p.force_n.z * p.normal.z.signum()).sum::<f64>() / last as f64;
            }
        }
        assert!(
            found.points.len() > 4 && found.points.iter().all(|p| p.kind == ContactKind::Itself),
            "{kind}"
        );
        assert!((borne_n / weight_n - 1.0).abs() < 0.05, "{kind} {response:?}: {borne_n} N of {weight_n} N");
        world.reset();
        world.contact_points_into(&mut found);
        assert_eq!(found, ContactPoints::default());
    }
}

fn hash_after(setting: &Setting) -> StateHash {
    let mut world = block_on_a_block(setting);
    let idle = idle(&world);
    cut_loose(&mut world);
    (0..setting.steps(0.05)).for_each(|_| {
        world.step(&idle.divided(2));
    });
    assert!(world.report().self_contact.n_contacts > 10);
    world.state_hash()
}

#[test]
fn contact_with_itself_has_the_same_bits_at_any_number_of_threads() {
    for (kind, response) in RESPONDING {
        let setting = Setting::of(kind, Some(response));
        let expected = hash_after(&setting);
        for threads in [1, 3] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            assert_eq!(pool.install(|| hash_after(&setting)), expected, "{kind} with {threads} threads");
        }
    }
}

#[test]
fn a_saved_moment_and_an_undone_cut_bring_the_contact_back() {
    let setting = Setting::of(ModelKind::Explicit, Some(GEOMETRIC));
    let mut world = block_on_a_block(&setting);
    let idle = idle(&world);
    let run = |world: &mut World, time_s: f64| {
        (0..setting.steps(time_s)).for_each(|_| {
            world.step(&idle);
        });
    };
    let before = world.save();
    cut_loose(&mut world);
    assert!(world.undo_edit());
    run(&mut world, 0.02);
    let uncut = world.state_hash();
    cut_loose(&mut world);
    run(&mut world, 0.05);
    let (middle, at_middle) = (world.save(), world.state_hash());
    run(&mut world, 0.03);
    let end = world.state_hash();
    world.restore(&middle);
    assert_eq!(world.state_hash(), at_middle);
    run(&mut world, 0.03);
    assert_eq!(world.state_hash(), end);
    world.restore(&before);
    run(&mut world, 0.02);
    assert_eq!(world.state_hash(), uncut);
    world.reset();
    assert_eq!(world.report().self_contact.n_contacts, 0);
}

#[test]
fn a_step_of_an_organ_that_touches_itself_allocates_nothing() {
    for (kind, response) in RESPONDING {
        let setting = Setting::of(kind, Some(response));
        let mut world = block_on_a_block(&setting);
        let idle = idle(&world);
        cut_loose(&mut world);
        // Until `implicit` has the factor of the cut mesh.
        for _ in 0..30 {
            world.step(&idle);
        }
        let mut most = 0;
        let mut count = || {
            let steps = setting.steps(0.06);
            allocation_counter::measure(|| {
                for _ in 0..steps {
                    most = most.max(world.step(&idle).self_contact.n_contacts);
                }
            })
            .count_total
        };
        assert_eq!(count(), 0, "{kind}");
        assert!(most > 10, "{kind}: {most} contacts");
        let saved = world.save();
        world.restore(&saved);
        let after = allocation_counter::measure(|| {
            world.step(&idle);
        });
        assert_eq!(after.count_total, 0, "{kind} after coming back");
    }
}

#[test]
fn a_wall_thinner_than_the_margin_does_not_touch_itself() {
    // A sheet of 1.6 mm that stands on edge and is bent; and its two faces are a cell's share apart.
    let hash = |response: Option<SelfContactResponse>| {
        let setting = Setting { kind: ModelKind::Implicit, time_step_s: 2e-3, response };
        let mut mesh = cells_of_five([1, 5, 5], CELL_M, |_| true);
        mesh.positions_m.iter_mut().for_each(|p| p.x *= 0.2);
        let top = Aabb { min_m: DVec3::new(-1.0, -1.0, 4.5 * CELL_M), max_m: DVec3::splat(1.0) };
        let (force_n, time) = (DVec3::new(2e-3, 0.0, 0.0), LoadTime::Always);
        let mut world =
            setting.world(mesh, DVec3::ZERO, vec![Load { region: Region::Box(top), force_n, time }]);
        let idle = idle(&world);
        (0..50).for_each(|_| {
            world.step(&idle);
        });
        let bent_m = world.state().positions_m.iter().zip(&world.organ().mesh().positions_m);
        assert!(bent_m.map(|(p, rest)| p.distance(*rest)).fold(0.0, f64::max) > 2e-3);
        (world.state_hash(), world.report().self_contact.n_contacts)
    };
    assert_eq!(hash(Some(GEOMETRIC)), hash(None));
}
