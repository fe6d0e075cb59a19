//! Touch by force: a tip in a fold, and what friction bears.

use crate::model_meshes::shaken_block;
use glisson::material::{LawChoice, LinearElastic, law_named};
use glisson::math::{Aabb, DVec3};
use glisson::mesh::{NodeId, TetMesh};
use glisson::model::Rayleigh;
use glisson::model::kind::ModelKind;
use glisson::scene::{OrganBody, build_model};
use glisson::tool::{Grip, Tool, ToolInput};
use glisson::world::spec::{Hand, Region, Support, WorldSpec, fixed_nodes};
use glisson::world::{StepInput, World};

const STEP_S: f64 = 1e-3;
const RADIUS_M: f64 = 4e-3;

/// A world of tissue that is held where `held` says, touched by a ball.
fn world(mesh: &TetMesh, kind: ModelKind, held: &[Region], friction: f64) -> World {
    let supports: Vec<Support> = held.iter().map(|region| Support::all_axes(*region)).collect();
    let home = ToolInput::at(DVec3::new(0.0, 0.0, 0.25), DVec3::Z);
    let grip = Grip { friction_coefficient: friction, is_sticky: false };
    let tool = Tool { grip, shaft_radius_m: 1e-3, ..Tool::probe("ball", RADIUS_M, home) };
    let mut spec = WorldSpec::new("touched", STEP_S, tool);
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
