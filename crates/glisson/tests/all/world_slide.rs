//! Tools that press deep and slide: calm forces inside Coulomb's cone, slip along the whole way, no energy from nowhere.

use crate::model_meshes::shaken_block;
use glisson::material::LinearElastic;
use glisson::math::{DVec3, SeededRandom};
use glisson::model::explicit_kernel::{ExplicitKernel, ExplicitKernelParams};
use glisson::model::kernel::KernelLaw;
use glisson::model::kind::ModelKind;
use glisson::model::{DynamicBody, Rayleigh};
use glisson::scene::{OrganBody, build_model};
use glisson::tool::{Grip, Tool, ToolInput};
use glisson::world::spec::{Region, Support, WorldSpec, fixed_nodes};
use glisson::world::{StepInput, World};

const TICK_S: f64 = 1e-3;
const CELL_M: f64 = 12e-3;
const TIP_RADIUS_M: f64 = 5e-3;
const YOUNG_MODULUS_PA: f64 = 5e3;
/// Stiffness that tissue and cell set [N/m].
const SCALE_N_PER_M: f64 = YOUNG_MODULUS_PA * CELL_M;

/// An irregular block of edges of 12 mm on a table, its upper face about z = 0, and into how many parts a step is divided.
fn soft_block(kind: ModelKind, friction: f64, step_s: f64) -> (World, u32) {
    soft_wedge(kind, friction, step_s, 0.0)
}

/// The block with sides that lean over by so much of its height, towards +x: its upper edge there is acute.
fn soft_wedge(kind: ModelKind, friction: f64, step_s: f64, lean: f64) -> (World, u32) {
    let cells = [7, 7, 4];
    let size_m = DVec3::from(cells.map(|n| n as f64)) * CELL_M;
    let mut mesh = shaken_block(cells, size_m, 0.15, 7);
    for p in &mut mesh.positions_m {
        *p -= DVec3::new(0.5, 0.5, 1.0) * size_m;
        p.x += lean * p.z;
    }
    let table = Region::Furthest { direction: -DVec3::Z, fraction: 0.15 };
    let supports = vec![Support::all_axes(table)];
    let fixed = fixed_nodes(&supports, &mesh.positions_m);
    let material = LinearElastic::from_young_poisson(YOUNG_MODULUS_PA, 0.45, 1060.0).unwrap();
    let home = ToolInput::at(DVec3::Z * 0.3, DVec3::Z);
    let grip = Grip { friction_coefficient: friction, is_sticky: false };
    let mut spec = WorldSpec::new("block", step_s, Tool { grip, ..Tool::probe("probe", TIP_RADIUS_M, home) });
    spec.supports = supports;
    if kind != ModelKind::Explicit {
        let mut body = OrganBody::new(mesh, material, step_s);
        body.fixed = fixed;
        body.damping = Rayleigh::of_mass(60.0);
        let model = build_model(&body, kind).unwrap();
        return (World::new(spec, body.mesh, model, kind).unwrap(), 1);
    }
    let damping = Rayleigh::of_mass(60.0);
    let body = DynamicBody { fixed: &fixed, damping, ..DynamicBody::new(&mesh, 1060.0) };
    let materials = &[material];
    let params = ExplicitKernelParams::new(body, KernelLaw::NeoHookeLog, materials);
    let parts = (TICK_S / (0.7 * ExplicitKernel::stable_step(&params).unwrap().step_s)).ceil();
    let body = DynamicBody { time_step_s: TICK_S / parts, ..body };
    let model = Box::new(ExplicitKernel::build(&ExplicitKernelParams { body, ..params }).unwrap());
    let n_parts = (parts * step_s / TICK_S).round() as u32;
    (World::new(spec, mesh, model, kind).unwrap(), n_parts)
}

/// What the tip did along corners of a path, at an even speed.
#[derive(Debug, Default)]
struct Ride {
    peak_n: f64,
    /// Largest change of the force in a step over the tool's motion in it [N/m].
    jump_n_per_m: f64,
    /// Largest force along the surface beyond what friction bears [N].
    beyond_cone_n: f64,
    slip_m: f64,
    /// Way of the touched point through the tissue at rest [m].
    way_in_tissue_m: f64,
    /// Work of the hand [J].
    work_j: f64,
}

fn ride((world, n_parts): &mut (World, u32), corners_m: &[DVec3], speed_m_per_s: f64, friction: f64) -> Ride {
    let step_s = world.spec().time_step_s;
    let mut ride = Ride::default();
    let mut last_m = corners_m[0];
    let mut last_n = world.report().tools[0].force_on_tool_n;
    let mut last_in_tissue_m = None;
    for ends in corners_m.windows(2) {
        let n = (ends[0].distance(ends[1]) / (speed_m_per_s * step_s)).ceil() as u32;
        for i in 1..=n {
            let tip_m = ends[0].lerp(ends[1], f64::from(i) / f64::from(n));
            let report = world.step(&StepInput::of(&[ToolInput::at(tip_m, DVec3::Z)]).divided(*n_parts));
            assert_eq!(report.n_non_finite_nodes, 0);
            let (force_n, moved_m) = (report.tools[0].force_on_tool_n, tip_m - last_m);
            ride.peak_n = ride.peak_n.max(force_n.length());
            ride.jump_n_per_m = ride.jump_n_per_m.max(force_n.distance(last_n) / moved_m.length());
            ride.slip_m += report.tools[0].slip_m;
            ride.work_j -= 0.5 * (force_n + last_n).dot(moved_m);
            let contact = world.snapshot().tools[0].contacts[0];
            let in_tissue_m = contact.map(|c| {
                let push_n = force_n.dot(c.normal);
                let along_n = (force_n - c.normal * push_n).length();
                ride.beyond_cone_n = ride.beyond_cone_n.max(along_n - friction * push_n.max(0.0));
                let rest_m = &world.organ().mesh().positions_m;
                (0..3).map(|v| rest_m[c.nodes[v].index()] * c.weights[v]).sum::<DVec3>()
            });
            if let (Some(a), Some(b)) = (last_in_tissue_m, in_tissue_m) {
                ride.way_in_tissue_m += b.distance(a);
            }
            (last_m, last_n, last_in_tissue_m) = (tip_m, force_n, in_tissue_m);
        }
    }
    ride
}

/// Tool's tip at a depth below the flat face.
fn at(x_m: f64, y_m: f64, depth_m: f64) -> DVec3 {
    DVec3::new(x_m, y_m, TIP_RADIUS_M - depth_m)
}

fn placed((world, n_parts): &mut (World, u32), tip_m: DVec3) {
    world.step(&StepInput::of(&[ToolInput::at(tip_m, DVec3::Z)]).placed().divided(*n_parts));
}

/// No jumps (the stiffest that a step of a millisecond shows is some 20 times the scale), and Coulomb's cone but for this
/// share of the largest force.
fn is_calm(ride: &Ride, beyond_cone: f64, what: &str) {
    assert!(ride.jump_n_per_m < 40.0 * SCALE_N_PER_M, "{what}: {ride:?}");
    assert!(ride.beyond_cone_n < beyond_cone * ride.peak_n, "{what}: {ride:?}");
}

#[test]
fn a_probe_deep_in_soft_tissue_slides_nearly_as_far_as_it_goes() {
    for (depth_m, friction, step_s) in
        [(2e-3, 0.0, TICK_S), (5e-3, 0.05, TICK_S), (10e-3, 0.05, TICK_S), (10e-3, 0.05, 1.0 / 30.0)]
    {
        let what = format!("{depth_m} {friction} {step_s}");
        let mut block = soft_block(ModelKind::Explicit, friction, step_s);
        placed(&mut block, at(-8e-3, 1e-3, -2e-3));
        ride(&mut block, &[at(-8e-3, 1e-3, -2e-3), at(-8e-3, 1e-3, depth_m)], 50e-3, friction);
        let slide = ride(&mut block, &[at(-8e-3, 1e-3, depth_m), at(7e-3, 1e-3, depth_m)], 50e-3, friction);
        is_calm(&slide, 0.05, &what);
        assert!((0.8..1.2).contains(&(slide.slip_m / 15e-3)), "{what}: {slide:?}");
        assert!((0.8..1.2).contains(&(slide.way_in_tissue_m / 15e-3)), "{what}: {slide:?}");
        assert!(slide.peak_n < 5.0 * SCALE_N_PER_M * depth_m, "{what}: {slide:?}");
    }
}

#[test]
fn whatever_the_depth_friction_speed_and_way_the_force_is_calm_and_a_loop_costs_the_hand_work() {
    let mut random = SeededRandom::new(5);
    for case in 0..4 {
        let depth_m = random.uniform_in(1e-3, 10e-3);
        let friction = random.uniform_in(0.0, 0.4);
        let speed_m_per_s = random.uniform_in(40e-3, 100e-3);
        let mut place = || at(random.uniform_in(-12e-3, 12e-3), random.uniform_in(-12e-3, 12e-3), depth_m);
        let [a, b, c] = [place(), place(), place()];
        let above = a + DVec3::Z * (depth_m + 2e-3);
        let mut block = soft_block(ModelKind::Explicit, friction, TICK_S);
        placed(&mut block, above);
        // Closed: pressed and lifted at the same place.
        let ride = ride(&mut block, &[above, a, b, c, a, above], speed_m_per_s, friction);
        let what = format!("case {case}: {depth_m} {friction} {speed_m_per_s} {a} {b} {c}");
        // Where a way turns sharply at this speed the nodes lag behind: 8.8 % where this was written.
        is_calm(&ride, 0.12, &what);
        assert!(ride.peak_n < 6.0 * SCALE_N_PER_M * depth_m, "{what}: {ride:?}");
        assert!(ride.work_j > 0.0, "{what}: {ride:?}");
        assert!(!block.0.report().in_contact(), "{what}");
    }
}

#[test]
fn models_without_inertia_and_with_long_steps_slide_as_well() {
    for (kind, step_s) in [
        (ModelKind::Precomputed, 1.0 / 30.0),
        (ModelKind::Precomputed, TICK_S),
        (ModelKind::Implicit, 1.0 / 30.0),
    ] {
        let (friction, depth_m) = (0.05, 4e-3);
        let mut block = soft_block(kind, friction, step_s);
        placed(&mut block, at(-8e-3, 1e-3, -2e-3));
        ride(&mut block, &[at(-8e-3, 1e-3, -2e-3), at(-8e-3, 1e-3, depth_m)], 50e-3, friction);
        let slide = ride(&mut block, &[at(-8e-3, 1e-3, depth_m), at(7e-3, 1e-3, depth_m)], 50e-3, friction);
        is_calm(&slide, 0.05, &format!("{kind} {step_s}"));
        assert!((0.75..1.25).contains(&(slide.slip_m / 15e-3)), "{kind} {step_s}: {slide:?}");
    }
}

#[test]
fn a_probe_that_slides_over_a_sharp_edge_of_the_tissue_lets_go_of_it_calmly() {
    // How far from the edge it is set down: beside it and on it, where the point has no way to slide.
    for (depth_m, friction, inside_m) in [
        (2e-3, 0.0, 12e-3),
        (0.5e-3, 0.0, 0.5e-3),
        (5e-3, 0.05, 0.1e-3),
        (2e-3, 0.3, 1e-3),
        (10e-3, 0.3, 3e-3),
    ] {
        let what = format!("{depth_m} {friction} {inside_m}");
        let mut block = soft_wedge(ModelKind::Explicit, friction, TICK_S, 1.0);
        let edge_m = 3.5 * CELL_M;
        let first = at(edge_m - inside_m, 1e-3, depth_m);
        let above = first + DVec3::Z * (depth_m + 2e-3);
        placed(&mut block, above);
        ride(&mut block, &[above, first], 50e-3, friction);
        let over =
            ride(&mut block, &[first, at(edge_m + 4.0 * TIP_RADIUS_M, 1e-3, depth_m)], 50e-3, friction);
        assert!(!block.0.report().in_contact(), "{what}: {over:?}");
        // Without friction nothing is borne but by the turning edge: 30 % of the little that it bears.
        is_calm(&over, 0.35, &what);
        assert!(over.peak_n < 6.0 * SCALE_N_PER_M * depth_m, "{what}: {over:?}");
    }
}
