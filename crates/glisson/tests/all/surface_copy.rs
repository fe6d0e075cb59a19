//! Detection beside a world, on a copy of its surface: it finds what the world would, misses nothing fast, and a world takes
//! what it is told only where that can be.

use crate::bodies::{TABLE, held_at};
use crate::model_meshes::block;
use glisson::math::DVec3;
use glisson::mesh::edit::MeshEdit;
use glisson::mesh::{NodeId, TetMesh, TriangleId};
use glisson::model::Rayleigh;
use glisson::model::kind::ModelKind;
use glisson::tool::external_detection::{ExternalDetection, ExternalTouch, TouchingPoint};
use glisson::tool::{Tool, ToolInput};
use glisson::world::detection::{SurfaceCopy, SurfaceList, SurfaceListError, ToolDetector};
use glisson::world::spec::WorldSpec;
use glisson::world::{StepInput, World};

const TIME_STEP_S: f64 = 1e-3;
const SIZE_M: f64 = 0.1;
const RADIUS_M: f64 = 8e-3;

fn probe() -> Tool {
    Tool::probe("ball", RADIUS_M, ToolInput::at(DVec3::splat(2.0 * SIZE_M), DVec3::Z))
}

fn world(kind: ModelKind) -> World {
    world_with(block([5, 5, 5], DVec3::splat(SIZE_M)), kind)
}

fn world_with(mesh: TetMesh, kind: ModelKind) -> World {
    let spec = WorldSpec::new("block", TIME_STEP_S, probe());
    held_at(TABLE, mesh, spec, kind, 0.45, Rayleigh::of_mass(30.0))
}

fn at(x_m: f64, z_m: f64) -> ToolInput {
    ToolInput::at(DVec3::new(x_m, 0.45 * SIZE_M, z_m), DVec3::Z)
}

/// The ball presses again and again, each time elsewhere.
fn pressing(step: u64) -> ToolInput {
    let t = step as f64 * 1e-2;
    at(SIZE_M * (0.5 + 0.3 * libm::sin(0.17 * t)), SIZE_M + RADIUS_M + 6e-3 * libm::cos(t))
}

/// The copy is brought to where the world's surface is.
pub(crate) fn follow(copy: &mut SurfaceCopy, world: &World) {
    for (node, position_m) in world.surface_list().nodes {
        copy.place(node, position_m);
    }
    copy.refresh();
}

#[test]
fn a_world_that_is_told_moves_as_one_that_looks_by_itself() {
    let (mut looks, mut is_told) = (world(ModelKind::Precomputed), world(ModelKind::Precomputed));
    let mut copy = SurfaceCopy::new(&is_told.surface_list()).unwrap();
    let mut detector = ToolDetector::new(&probe());
    let (mut touching, mut greatest_n, mut difference_n) = (0, 0.0_f64, 0.0_f64);
    for step in 0..3000 {
        let pose = pressing(step);
        follow(&mut copy, &is_told);
        let detected = [Some(detector.look(&copy, &pose)), None, None, None, None];
        let found = is_told.step(&StepInput { detected, ..StepInput::of(&[pose]) });
        let expected = looks.step(&StepInput::of(&[pose]));
        if !found.in_contact() && detected[0].is_some_and(|d| !d.is_free()) {
            detector.end_touches();
        }
        touching += u64::from(found.in_contact());
        let (a, b) = (found.tools[0].force_on_tool_n, expected.tools[0].force_on_tool_n);
        greatest_n = greatest_n.max(b.length());
        difference_n = difference_n.max(a.distance(b));
    }
    assert!(touching > 500 && greatest_n > 0.3, "{touching} steps, {greatest_n} N");
    // Nodes that moved less than 0.1 um are not followed.
    assert!(difference_n < 1e-3 * greatest_n, "{difference_n} of {greatest_n} N");
}

#[test]
fn a_tip_at_5_m_per_s_is_found_between_two_looks_and_a_look_allocates_nothing() {
    let list = SurfaceList::of_mesh(&block([5, 5, 5], DVec3::splat(SIZE_M))).unwrap();
    let copy = SurfaceCopy::new(&list).unwrap();
    let mut detector = ToolDetector::new(&probe());
    let (mut found_at, mut n_looks) = (None, 0);
    let counted = allocation_counter::measure(|| {
        // Deep into the block: 5 mm a look.
        for look in 0..24 {
            let z_m = 0.15 - 5e-3 * f64::from(look);
            let detected = detector.look(&copy, &at(0.05, z_m));
            n_looks += 1;
            if found_at.is_none() && !detected.is_free() {
                found_at = Some((z_m, detector.touches().next().map(|(_, touch)| *touch).unwrap()));
            }
        }
    });
    assert_eq!((counted.count_total, n_looks), (0, 24));
    let (z_m, touch) = found_at.unwrap();
    // Where the ball first touched, not where it was seen.
    assert!(z_m < SIZE_M + RADIUS_M && z_m > SIZE_M + RADIUS_M - 5e-3 - 1e-9, "{z_m}");
    assert!((touch.tip_m.z - (SIZE_M + RADIUS_M)).abs() < 2e-6, "{touch:?}");
    assert!((touch.surface_m.z - SIZE_M).abs() < 1e-9 && touch.found.normal.distance(DVec3::Z) < 1e-9);
    // It touches until it is out again, wherever it went meanwhile.
    assert!(detector.touches().next().is_some());
    assert!(!detector.look(&copy, &at(0.05, SIZE_M + RADIUS_M + 1e-4)).is_free());
    assert!(detector.look(&copy, &at(0.05, SIZE_M + RADIUS_M + 3e-4)).is_free());
    // A surface that comes to a tip that rests is found too.
    let mut copy = copy;
    let raised = list.nodes.iter().filter(|(_, p)| p.z > SIZE_M - 1e-9);
    raised.for_each(|(node, p)| copy.place(*node, *p + DVec3::Z * 0.04));
    assert!(copy.refresh());
    let resting = at(0.05, SIZE_M + RADIUS_M + 3e-4);
    let met = detector.look(&copy, &resting);
    assert!(!met.is_free() && !copy.refresh(), "{met:?}");
}

#[test]
fn a_move_of_the_surface_is_met_once() {
    let list = SurfaceList::of_mesh(&block([5, 5, 5], DVec3::splat(SIZE_M))).unwrap();
    let mut copy = SurfaceCopy::new(&list).unwrap();
    let mut detector = ToolDetector::new(&probe());
    detector.look(&copy, &at(0.05, SIZE_M + RADIUS_M + 1e-3));
    let lower = |copy: &mut SurfaceCopy, by_m: f64| {
        let top = list.nodes.iter().filter(|(_, p)| p.z > SIZE_M - 1e-9);
        top.for_each(|(node, p)| copy.place(*node, *p - DVec3::Z * by_m));
        assert!(copy.refresh());
    };
    // The tip follows a top that goes down, and is never nearer than 1 mm.
    lower(&mut copy, 4e-3);
    assert!(detector.look(&copy, &at(0.05, SIZE_M + RADIUS_M - 2e-3)).is_free());
    // No word of the surface since: it stands still, and the tip goes on.
    let met = detector.look(&copy, &at(0.05, SIZE_M + RADIUS_M - 3e-3));
    assert!(met.is_free(), "{met:?}");
    lower(&mut copy, -4e-3);
    assert!(!detector.look(&copy, &at(0.05, SIZE_M + RADIUS_M - 3e-3)).is_free(), "it came up");
}

#[test]
fn what_the_world_ended_is_told_again_only_after_the_part_was_out() {
    let copy =
        SurfaceCopy::new(&SurfaceList::of_mesh(&block([5, 5, 5], DVec3::splat(SIZE_M))).unwrap()).unwrap();
    let mut detector = ToolDetector::new(&probe());
    let deep = at(0.05, SIZE_M + RADIUS_M - 2e-3);
    detector.look(&copy, &at(0.05, SIZE_M + 0.02));
    assert!(!detector.look(&copy, &deep).is_free());
    detector.end_touches();
    assert!(detector.look(&copy, &deep).is_free());
    assert!(detector.look(&copy, &at(0.05, SIZE_M + RADIUS_M + 1e-3)).is_free());
    assert!(!detector.look(&copy, &deep).is_free());
    // From deep inside it comes out without touching.
    detector.look(&copy, &at(0.05, SIZE_M - 0.02));
    detector.end_touches();
    for i in 0..40 {
        let z_m = SIZE_M - 0.02 + 1e-3 * f64::from(i);
        assert!(detector.look(&copy, &at(0.05, z_m)).touches[0].is_none(), "{z_m}");
    }
    assert!(!detector.look(&copy, &deep).is_free());
    // Nobody held it: it was put there, and its tip touches where it is.
    detector.lift();
    let put = detector.look(&copy, &deep);
    assert!(put.touches[0].is_some_and(|touch| touch.gap_m < -1e-3), "{put:?}");
}

/// A touch of the top that is right.
fn good_touch(world: &World, pose: &ToolInput) -> ExternalDetection {
    let copy = SurfaceCopy::new(&world.surface_list()).unwrap();
    let mut detector = ToolDetector::new(&probe());
    detector.look(&copy, &at(pose.tip_in_world_m.x, SIZE_M + 0.02));
    detector.look(&copy, pose)
}

#[test]
fn a_world_takes_only_what_can_be() {
    let deep = at(0.05, SIZE_M + RADIUS_M - 1e-3);
    let above = at(0.05, SIZE_M + RADIUS_M + 1e-3);
    let step = |pose: ToolInput, change: &dyn Fn(&mut ExternalDetection)| {
        let mut world = world(ModelKind::Precomputed);
        world.step(&StepInput::of(&[at(0.05, SIZE_M + 0.02)]).placed());
        let mut detected = good_touch(&world, &deep);
        assert!(detected.touches[0].is_some());
        change(&mut detected);
        let input =
            StepInput { detected: [Some(detected), None, None, None, None], ..StepInput::of(&[pose]) };
        world.step(&input).in_contact()
    };
    let of_tip = |change: &'static dyn Fn(&mut ExternalTouch)| {
        move |detected: &mut ExternalDetection| change(detected.touches[0].as_mut().unwrap())
    };
    assert!(step(deep, &|_| {}));
    // Told that nothing touches, it does not look.
    assert!(!step(deep, &|detected| detected.touches = [None; 3]));
    // The tip is not there: no tissue is pulled to it.
    assert!(!step(above, &|_| {}));
    let far = ToolInput { tip_in_world_m: deep.tip_in_world_m - DVec3::Z * 0.05, ..deep };
    assert!(!step(far, &|_| {}));
    // A triangle that is none.
    assert!(!step(deep, &of_tip(&|touch| touch.triangle = TriangleId(u32::MAX))));
    // What makes no sense, or is of another surface, counts as nothing told: the world looks by itself.
    assert!(step(deep, &|detected| detected.surface_version += 1));
    assert!(step(deep, &of_tip(&|touch| touch.normal = -touch.normal)));
    assert!(step(deep, &of_tip(&|touch| touch.weights = [f64::NAN; 3])));
    assert!(step(deep, &of_tip(&|touch| touch.normal *= 2.0)));
    assert!(step(deep, &of_tip(&|touch| touch.at = TouchingPoint::OnAxis(3.0))));
}

#[test]
fn after_a_cut_the_new_surface_is_what_is_found() {
    let mut world = world(ModelKind::TensorMass);
    let before = world.surface_list();
    let mut copy = SurfaceCopy::new(&before).unwrap();
    // A pit of the size of the ball at the top's middle.
    let in_pit =
        |p: DVec3| p.z > 0.55 * SIZE_M && (p - DVec3::splat(0.5 * SIZE_M)).abs().truncate_max() < 0.025;
    let mesh = world.organ().mesh();
    let tets = (0..mesh.tetrahedra.len()).map(glisson::mesh::TetId::from_index).filter(|&tet| {
        let corners_m = mesh.corners_m(tet);
        in_pit(corners_m.iter().sum::<DVec3>() / 4.0)
    });
    let tets: Vec<_> = tets.collect();
    assert!(!tets.is_empty());
    world.edit(&MeshEdit::Remove { tets }).unwrap();
    let after = world.surface_list();
    assert_ne!((before.version, before.triangles.len()), (after.version, after.triangles.len()));
    let touched_z_m = |copy: &SurfaceCopy| {
        let mut detector = ToolDetector::new(&Tool::probe("thin", 2e-3, at(0.0, 0.3)));
        let pit = |z_m: f64| ToolInput::at(DVec3::new(0.05, 0.05, z_m), DVec3::Z);
        for i in 0..100 {
            detector.look(copy, &pit(0.13 - 1e-3 * f64::from(i)));
        }
        detector.touches().next().map(|(_, touch)| touch.surface_m.z).unwrap()
    };
    assert!((touched_z_m(&copy) - SIZE_M).abs() < 1e-6);
    copy = SurfaceCopy::new(&after).unwrap();
    assert_eq!(copy.version(), world.organ().topology_version());
    assert!(touched_z_m(&copy) < 0.8 * SIZE_M, "{}", touched_z_m(&copy));
}

trait TruncateMax {
    fn truncate_max(self) -> f64;
}

impl TruncateMax for DVec3 {
    /// Of x and y alone.
    fn truncate_max(self) -> f64 {
        self.x.max(self.y)
    }
}

#[test]
fn lists_that_are_no_surface_are_refused() {
    let good = SurfaceList::of_mesh(&block([1, 1, 1], DVec3::ONE)).unwrap();
    let refused = |change: &dyn Fn(&mut SurfaceList)| {
        let mut list = good.clone();
        change(&mut list);
        SurfaceCopy::new(&list).map(|_| ()).unwrap_err()
    };
    assert_eq!(refused(&|list| list.triangles.clear()), SurfaceListError::Empty);
    assert_eq!(refused(&|list| list.triangles.swap(0, 1)), SurfaceListError::Order(1));
    assert_eq!(refused(&|list| list.nodes[1] = list.nodes[0]), SurfaceListError::Order(1));
    assert_eq!(refused(&|list| list.nodes[2].1.x = f64::NAN), SurfaceListError::Position(2));
    let triangle = good.triangles[3].0.0;
    let missing = SurfaceListError::Node { triangle, node: 99 };
    assert_eq!(refused(&|list| list.triangles[3].1[0] = NodeId(99)), missing);
}

#[test]
fn a_fine_surface_in_reach_is_told_though_none_of_it_is_in_half_the_reach() {
    let size_m = DVec3::new(0.072, 0.072, 6e-3);
    let mut world = world_with(block([24, 24, 2], size_m), ModelKind::Implicit);
    let middle = |shift_m: f64| {
        ToolInput::at(DVec3::new(0.036 + shift_m, 0.036, size_m.z + RADIUS_M + 12e-3), DVec3::Z)
    };
    // At 0.2 m/s the haptic model looks further than 20 mm.
    world.step(&StepInput::of(&[middle(0.0)]).placed());
    world.step(&StepInput::of(&[middle(0.2 * TIME_STEP_S)]));
    let mut found = glisson::world::detection::NearbyNodes::default();
    world.nodes_near_into(0, 9, &mut found);
    assert_eq!(found.nodes().len(), 9);
    let model = world.haptic_model(0);
    assert!((model.gap_m - 12e-3).abs() < 1e-5 && model.normal.distance(DVec3::Z) < 1e-6, "{model:?}");
}

#[test]
fn a_world_tells_the_nodes_around_an_instrument_and_allocates_nothing() {
    let mut world = world(ModelKind::Precomputed);
    world.step(&StepInput::of(&[at(0.05, SIZE_M + 0.01)]).placed());
    let mut found = glisson::world::detection::NearbyNodes::default();
    let counted = allocation_counter::measure(|| world.nodes_near_into(0, 9, &mut found));
    assert_eq!((counted.count_total, found.nodes().len()), (0, 9));
    let away_m =
        |node: NodeId| world.surface_position_m(node).unwrap().distance(DVec3::new(0.05, 0.045, SIZE_M));
    let furthest_m = found.nodes().iter().map(|node| away_m(*node)).fold(0.0, f64::max);
    assert!(furthest_m < 0.045, "{furthest_m}");
    world.nodes_near_into(7, 9, &mut found);
    assert!(found.nodes().is_empty(), "there is no such instrument");
}
