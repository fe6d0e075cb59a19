//! Touch by force: a tip in a fold, and what friction bears.

use crate::model_meshes::shaken_block;
use glisson::material::{LawChoice, LinearElastic, law_named};
use glisson::math::{Aabb, DVec3};
use glisson::mesh::{NodeId, TetId, TetMesh};
use glisson::model::Rayleigh;
use glisson::model::kind::ModelKind;
use glisson::scene::{OrganBody, build_model};
use glisson::tool::{Grip, Jaws, Tool, ToolInput, ToolKind};
use glisson::world::spec::{Hand, Region, Support, WorldSpec, fixed_nodes};
use glisson::world::{StepInput, World};

const STEP_S: f64 = 1e-3;
const RADIUS_M: f64 = 4e-3;

/// A world of tissue that is held where `held` says, touched by a ball.
fn world(mesh: &TetMesh, kind: ModelKind, held: &[Region], friction: f64) -> World {
    let grip = Grip { friction_coefficient: friction, is_sticky: false };
    let ball = |home| Tool { grip, shaft_radius_m: 1e-3, ..Tool::probe("ball", RADIUS_M, home) };
    world_with(mesh, kind, held, ball)
}

fn world_with(mesh: &TetMesh, kind: ModelKind, held: &[Region], tool: impl Fn(ToolInput) -> Tool) -> World {
    let supports: Vec<Support> = held.iter().map(|region| Support::all_axes(*region)).collect();
    let home = ToolInput::at(DVec3::new(0.0, 0.0, 0.25), DVec3::Z);
    let mut spec = WorldSpec::new("touched", STEP_S, tool(home));
    spec.supports.clone_from(&supports);
    spec.hand = Some(Hand::default());
    let material = LinearElastic::from_young_poisson(5e3, 0.45, 1060.0).unwrap();
    spec.tissue = Some(material);
    let mut body = OrganBody::new(mesh.clone(), material, STEP_S);
    body.fixed = fixed_nodes(&supports, &mesh.positions_m);
    body.damping = Rayleigh::of_mass(60.0);
    if kind == ModelKind::Implicit {
        body.law = Some(LawChoice::typical(law_named("stable_neo_hooke").unwrap().entry()));
    }
    World::new(spec, mesh.clone(), build_model(&body, kind).unwrap(), kind).unwrap()
}

/// Two slabs that face each other across a gap around x = 0, as one mesh.
fn slabs(gap_m: f64) -> TetMesh {
    let size_m = DVec3::new(0.03, 0.06, 0.06);
    let mut mesh = shaken_block([4, 8, 8], size_m, 0.15, 3);
    let n = mesh.positions_m.len();
    let first_m = DVec3::new(0.5 * gap_m, -0.5 * size_m.y, -0.5 * size_m.z);
    mesh.positions_m.iter_mut().for_each(|p| *p += first_m);
    // The mirror image, with its tetrahedra turned the right way round.
    let mirrored: Vec<DVec3> = mesh.positions_m.iter().map(|p| DVec3::new(-p.x, p.y, p.z)).collect();
    mesh.positions_m.extend(mirrored);
    let other = |node: NodeId| NodeId::from_index(node.index() + n);
    let turned: Vec<[NodeId; 4]> =
        mesh.tetrahedra.iter().map(|&[a, b, c, d]| [other(b), other(a), other(c), other(d)]).collect();
    mesh.tetrahedra.extend(turned);
    mesh
}

/// A ball between two slabs that are nearer to each other than it is wide pushes both away, and feels the difference.
#[test]
fn a_ball_in_a_fold_touches_both_sides() {
    let mesh = slabs(2.0 * RADIUS_M - 2e-3);
    for kind in [ModelKind::Precomputed, ModelKind::Implicit] {
        // Held on their far sides.
        let far = |sign: f64| {
            let (near_m, far_m) = (0.03 * sign, sign);
            let min_m = DVec3::new(near_m.min(far_m), -1.0, -1.0);
            Region::Box(Aabb { min_m, max_m: DVec3::new(near_m.max(far_m), 1.0, 1.0) })
        };
        let mut world = world(&mesh, kind, &[far(1.0), far(-1.0)], 0.0);
        let between = StepInput::of(&[ToolInput::at(DVec3::ZERO, DVec3::Z)]);
        world.step(&between.placed());
        for _ in 0..500 {
            world.step(&between);
        }
        let positions_m = world.state().positions_m;
        let moved_m = |side: f64| {
            let near = |p: &DVec3| p.x * side > 0.0 && p.x.abs() < 5e-3 && p.y.hypot(p.z) < 6e-3;
            let nodes = mesh.positions_m.iter().zip(positions_m).filter(|(rest_m, _)| near(rest_m));
            let ways_m: Vec<f64> = nodes.map(|(rest_m, now_m)| (now_m.x - rest_m.x) * side).collect();
            ways_m.iter().sum::<f64>() / ways_m.len() as f64
        };
        let [right_m, left_m] = [moved_m(1.0), moved_m(-1.0)];
        let net_n = world.report().tools[0].force_on_tool_n;
        assert!(right_m > 3e-5 && left_m > 3e-5, "{kind}: {right_m} {left_m}");
        assert!((right_m / left_m - 1.0).abs() < 0.05, "{kind}: {right_m} {left_m}");
        assert!(net_n.x.abs() < 0.01, "{kind}: {net_n}");
    }
}

/// Steady sliding over flat tissue that is pushed along its normal at rest: the force across the push is what friction bears.
/// (Pushed along the normals of its present shape, the sides of the crater add their share.)
#[test]
fn sliding_bears_the_coefficient_of_friction() {
    let size_m = DVec3::new(0.08, 0.08, 0.04);
    let mut mesh = shaken_block([12, 12, 6], size_m, 0.0, 5);
    mesh.positions_m.iter_mut().for_each(|p| *p -= DVec3::new(0.5, 0.5, 1.0) * size_m);
    let base = Region::Furthest { direction: -DVec3::Z, fraction: 0.1 };
    for kind in [ModelKind::Precomputed, ModelKind::Hybrid] {
        for friction in [0.0, 0.05, 0.3, 0.6] {
            let mut world = world(&mesh, kind, &[base], friction);
            let at = |x_m: f64, depth_m: f64| {
                StepInput::of(&[ToolInput::at(DVec3::new(x_m, 1e-3, RADIUS_M - depth_m), DVec3::Z)])
            };
            world.step(&at(-0.015, -2e-3).placed());
            for i in 1..=100 {
                world.step(&at(-0.015, -2e-3 + 4e-3 * f64::from(i) / 100.0));
            }
            // At 2 cm/s; read over the second half.
            let (mut across_n, mut push_n) = (0.0, 0.0);
            for i in 1..=600 {
                let force_n = world.step(&at(-0.015 + 2e-5 * f64::from(i), 2e-3)).tools[0].force_on_tool_n;
                if i > 300 {
                    across_n -= force_n.x;
                    push_n += force_n.z;
                }
            }
            let found = across_n / push_n;
            assert!(
                push_n > 0.0 && (found - friction).abs() < 0.03 * friction + 0.01,
                "{kind} {friction}: {found}"
            );
        }
    }
}

/// A ball that is far smaller than the edges of the mesh goes in by many radii. The shaft behind it is as far out of the mesh's surface
/// as the ball is: its end would press that surface as if there were no detail, with three times the force.
#[test]
fn a_small_ball_feels_a_half_space_many_radii_deep() {
    let radius_m = 1.5e-3;
    for kind in [ModelKind::Precomputed, ModelKind::Implicit] {
        let mut world = coarse_block_with(kind, |home| Tool {
            grip: Grip { friction_coefficient: 0.0, is_sticky: false },
            shaft_radius_m: 0.25 * radius_m,
            ..Tool::probe("ball", radius_m, home)
        });
        let at = |depth_m: f64| StepInput::of(&[ToolInput::at(DVec3::Z * (radius_m - depth_m), DVec3::Z)]);
        world.step(&at(-1e-3).placed());
        for deep in [4.0, 8.0, 12.0] {
            let (from_m, to_m) = ((deep - 4.0) * 1e-3, deep * 1e-3);
            for i in 1..=400 {
                world.step(&at(from_m + (to_m - from_m) * (f64::from(i) / 200.0).min(1.0)));
            }
            let on_tool_n = world.report().tools[0].force_on_tool_n;
            let on_tissue_n: DVec3 = world.touch_forces().iter().map(|force| force.force_n).sum();
            assert!(on_tool_n.distance(-on_tissue_n) < 1e-9, "{kind}: {on_tool_n} N, {on_tissue_n} N");
            let force_n = on_tool_n.z;
            // The hand gives way by 1 mm for 10 N.
            let depth_m = to_m - force_n / Hand::default().stiffness_n_per_m;
            // Sneddon's ball, so deep that its contact is as wide as it is: F = E* R (2 d - R).
            let reduced_pa = 5e3 / (1.0 - 0.45 * 0.45);
            let wanted_n = reduced_pa * radius_m * (2.0 * depth_m - radius_m);
            let ratio = force_n / wanted_n;
            assert!((ratio - 1.0).abs() < 0.1, "{kind} {deep} mm: {force_n} N of {wanted_n}");
            // What it cuts is the tissue that it presses, which is far before it on the mesh.
            let cut = world.touched_tetrahedra(0);
            let topology = world.organ().body().topology();
            let pressed = world.snapshot().tools[0].contacts[0].as_ref().expect("it touches").nodes;
            let is_pressed = |tet: &TetId| topology.tet_nodes(*tet).iter().any(|node| pressed.contains(node));
            assert!(cut.iter().any(is_pressed), "{kind} {deep} mm: {cut:?} are cut");
        }
    }
}

/// Jaws that are small beside the edges of the mesh are deep in its surface where they press it. They take what they press, and
/// neither the tissue nor what is drawn jumps.
#[test]
fn small_jaws_take_the_tissue_that_they_press() {
    let radius_m = 1.5e-3;
    let jaws = Jaws { length_m: 8e-3, width_m: 3e-3, greatest_opening_rad: 0.3, closing_force_n: 10.0 };
    for kind in [ModelKind::Precomputed, ModelKind::Implicit] {
        let mut world = coarse_block_with(kind, |home| Tool {
            kind: ToolKind::grasper(jaws),
            shaft_radius_m: 0.25 * radius_m,
            ..Tool::probe("jaws", radius_m, home)
        });
        let at = |depth_m: f64, jaw_opening: f64| {
            let tip_m = DVec3::Z * (radius_m - depth_m);
            StepInput::of(&[ToolInput { jaw_opening, ..ToolInput::at(tip_m, DVec3::Z) }])
        };
        world.step(&at(-1e-3, 0.4).placed());
        for i in 1..=400 {
            world.step(&at(8e-3 * (f64::from(i) / 200.0).min(1.0), 0.4));
        }
        let further_m = |world: &World| world.snapshot().tools[0].shown_further_out_m;
        let before_m = further_m(&world);
        assert!(before_m.z > 3e-3, "{kind}: {before_m}");
        let pressed_m = world.state().positions_m.to_vec();
        for i in 0..20 {
            world.step(&at(8e-3, 0.4 - 0.02 * f64::from(i + 1)));
        }
        assert!(world.report().tools[0].n_held_nodes > 0, "{kind}: nothing is held");
        let moved_m = pressed_m.iter().zip(world.state().positions_m).map(|(a, b)| a.distance(*b));
        assert!(moved_m.fold(0.0, f64::max) < 1e-3, "{kind}: the tissue jumps");
        let after_m = further_m(&world);
        assert!(after_m.distance(before_m) < 0.3 * before_m.length(), "{kind}: {before_m} to {after_m}");
        for _ in 0..200 {
            world.step(&at(8e-3, 0.0));
        }
        assert!(further_m(&world).distance(after_m) < 1e-6, "{kind}: what is held moves in the jaws");
    }
}

/// A block of edges of 12 mm, its top at z = 0 and its base held, under a tool.
fn coarse_block_with(kind: ModelKind, tool: impl Fn(ToolInput) -> Tool) -> World {
    let size_m = DVec3::new(0.1, 0.1, 0.06);
    let mut mesh = shaken_block([8, 8, 5], size_m, 0.0, 5);
    let to_top_m = DVec3::new(0.5, 0.5, 1.0) * size_m;
    mesh.positions_m.iter_mut().for_each(|p| *p -= to_top_m);
    let base = Region::Box(Aabb { min_m: DVec3::splat(-1.0), max_m: DVec3::new(1.0, 1.0, -size_m.z + 1e-3) });
    world_with(&mesh, kind, &[base], tool)
}
