//! Contact by constraints: the conditions of Signorini and Coulomb on the solver, and what follows from them for bodies of
//! every kind of model.

use std::sync::Arc;

use crate::model_meshes::nodes_below;
use glisson::contact::bodies::{
    BodyParams, CollidingBodies, ContactParams, ContactSetUpError, Obstacle, ObstacleShape,
};
use glisson::contact::constraint::{Contact, ContactKey, Response, Sweeps, solve};
use glisson::contact::shapes::RigidPose;
use glisson::contact::triangles::{at_weights, closest_weights};
use glisson::material::{LinearElastic, Material, NeoHookeLog};
use glisson::math::{DMat3, DVec3, SeededRandom};
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::topology::{Topology, surface_of};
use glisson::mesh::{NodeId, TetId, TetMesh};
use glisson::model::explicit_kernel::{ExplicitKernel, ExplicitKernelParams};
use glisson::model::implicit::{ImplicitEuler, ImplicitLaw, ImplicitParams};
use glisson::model::kernel::KernelLaw;
use glisson::model::precomputed::{Precision, Precomputed, PrecomputedParams, StoredNodes};
use glisson::model::tensor_mass::{TensorMass, TensorMassParams};
use glisson::model::{Constraints, DeformableModel, DynamicBody, FixedNode, NodalForce, Rayleigh};
use glisson::surface::TriMesh;
use glisson::workers::{Task, Workers};

const SIDE_M: f64 = 0.1;
const DENSITY: f64 = 1000.0;
const G: f64 = 9.81;
const SKIN_M: f64 = 1e-4;

fn material() -> LinearElastic {
    LinearElastic::from_young_poisson(20e3, 0.45, DENSITY).unwrap()
}

/// A block of 10 cm whose lowest corner is at `corner_m`.
fn block(cells: usize, corner_m: DVec3) -> TetMesh {
    let mut mesh = box_of_five([cells; 3], DVec3::splat(SIDE_M));
    mesh.positions_m.iter_mut().for_each(|p| *p += corner_m);
    mesh
}

fn resting(cells: usize) -> TetMesh {
    block(cells, DVec3::Z * SKIN_M)
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Kernel,
    TensorMass,
    Implicit,
}

#[derive(Clone, Copy)]
struct Setting<'a> {
    kind: Kind,
    mesh: &'a TetMesh,
    fixed: &'a [FixedNode],
    gravity_m_per_s2: DVec3,
    damping: Rayleigh,
}

impl<'a> Setting<'a> {
    fn new(kind: Kind, mesh: &'a TetMesh) -> Self {
        let damping = Rayleigh { mass_per_s: 0.0, stiffness_s: 2e-4 };
        Self { kind, mesh, fixed: &[], gravity_m_per_s2: DVec3::ZERO, damping }
    }

    /// The model and its step [s].
    fn build(self) -> (Box<dyn DeformableModel>, f64) {
        let material = material();
        let body = DynamicBody {
            fixed: self.fixed,
            gravity_m_per_s2: self.gravity_m_per_s2,
            damping: self.damping,
            ..DynamicBody::new(self.mesh, DENSITY)
        };
        match self.kind {
            Kind::Kernel => {
                let materials = [material];
                let (params, step_s) = kernel_params(body, &materials);
                (Box::new(ExplicitKernel::build(&params).unwrap()), step_s)
            }
            Kind::TensorMass => {
                let step_s = 0.5 * TensorMass::stable_step(self.mesh, &material).unwrap().step_s;
                let body = DynamicBody { time_step_s: step_s, ..body };
                let params = TensorMassParams { body, material: &material };
                (Box::new(TensorMass::build(&params).unwrap()), step_s)
            }
            Kind::Implicit => {
                let body = DynamicBody { time_step_s: 5e-3, ..body };
                let law = ImplicitLaw::neo_hooke(&material);
                let params = ImplicitParams { tolerance: 1e-6, ..ImplicitParams::new(body, &law) };
                (Box::new(ImplicitEuler::build(&params).unwrap()), 5e-3)
            }
        }
    }
}

fn kernel_params<'a>(
    body: DynamicBody<'a>,
    materials: &'a [LinearElastic],
) -> (ExplicitKernelParams<'a>, f64) {
    let params = ExplicitKernelParams::new(body, KernelLaw::NeoHookeLog, materials);
    let step_s = 0.9 * ExplicitKernel::stable_step(&params).unwrap().step_s;
    (ExplicitKernelParams { body: DynamicBody { time_step_s: step_s, ..body }, ..params }, step_s)
}

fn touching(mesh: &TetMesh, model: Box<dyn DeformableModel>, friction: f64) -> BodyParams {
    let (surface, nodes) = surface_of(&Topology::build(mesh).unwrap(), mesh);
    BodyParams { model, surface, nodes, friction }
}

fn floor(friction: f64) -> Obstacle {
    Obstacle::half_space(DVec3::ZERO, DVec3::Z, friction)
}

fn world(bodies: Vec<BodyParams>, obstacles: Vec<Obstacle>) -> CollidingBodies {
    CollidingBodies::new(bodies, obstacles, &ContactParams::default()).unwrap()
}

/// Mass of each node [kg].
fn masses_kg(mesh: &TetMesh) -> Vec<f64> {
    let mut mass_kg = vec![0.0; mesh.positions_m.len()];
    for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
        let share_kg = 0.25 * DENSITY * mesh.tet_volume_m3(TetId::from_index(t));
        nodes.iter().for_each(|n| mass_kg[n.index()] += share_kg);
    }
    mass_kg
}

fn center_m(mesh: &TetMesh, model: &dyn DeformableModel) -> DVec3 {
    let mass_kg = masses_kg(mesh);
    let moment: DVec3 = model.state().positions_m.iter().zip(&mass_kg).map(|(p, m)| *p * *m).sum();
    moment / mass_kg.iter().sum::<f64>()
}

fn momentum(mesh: &TetMesh, model: &dyn DeformableModel) -> DVec3 {
    model.state().velocities_m_per_s.iter().zip(masses_kg(mesh)).map(|(v, m)| *v * m).sum()
}

/// Energy of deformation and weight [J].
fn potential_j(mesh: &TetMesh, positions_m: &[DVec3], gravity_m_per_s2: DVec3, kind: Kind) -> f64 {
    let (neo_hooke, linear) = (NeoHookeLog::from(&material()), material());
    let mut energy_j = 0.0;
    for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
        let at = |list: &[DVec3]| {
            let x = nodes.map(|n| list[n.index()]);
            DMat3::from_cols(x[1] - x[0], x[2] - x[0], x[3] - x[0])
        };
        let f = at(positions_m) * at(&mesh.positions_m).inverse();
        let density = match kind {
            Kind::TensorMass => linear.energy_density_j_per_m3(&f),
            Kind::Kernel | Kind::Implicit => neo_hooke.energy_density_j_per_m3(&f),
        };
        energy_j += density * mesh.tet_volume_m3(TetId::from_index(t));
    }
    let weight =
        positions_m.iter().zip(masses_kg(mesh)).map(|(p, m)| -m * gravity_m_per_s2.dot(*p)).sum::<f64>();
    energy_j + weight
}

fn gravity(tilt: f64) -> DVec3 {
    DVec3::new(tilt.sin(), 0.0, -tilt.cos()) * G
}

/// Brings gravity on gently, over `ramp_s`.
fn load(world: &mut CollidingBodies, gravity_m_per_s2: DVec3, dt_s: f64, ramp_s: f64) {
    let n = (ramp_s / dt_s).ceil() as usize;
    for i in 1..=n {
        let s = i as f64 / n as f64;
        for b in 0..world.n_bodies() {
            world.model_mut(b).set_gravity(gravity_m_per_s2 * (s * s * (3.0 - 2.0 * s)));
        }
        world.step(dt_s);
    }
}

fn run(world: &mut CollidingBodies, dt_s: f64, time_s: f64) {
    for _ in 0..(time_s / dt_s).round() as usize {
        world.step(dt_s);
    }
}

/// Vertices with random answers, and contacts between them.
fn random_contacts(seed: u64, friction: f64) -> (Vec<Contact>, Response, Vec<DVec3>) {
    let mut random = SeededRandom::new(seed);
    let mut vector = || DVec3::new(random.normal(), random.normal(), random.normal());
    let n = 12;
    let mut response = Response::new(n, 1);
    for v in 0..6 {
        response.set_alone(v, vector().abs() + 0.2);
    }
    // The others answer together: A A^T + 1.
    response.set_group(0, 6..12);
    let rows: Vec<[DVec3; 6]> = (0..18).map(|_| [(); 6].map(|()| vector() * 0.3)).collect();
    let dot = |a: usize, b: usize| (0..6).map(|k| rows[a][k].dot(rows[b][k])).sum::<f64>();
    let group = response.group_mut(0);
    for column in 0..6 {
        for row in 0..6 {
            let mut block = DMat3::ZERO;
            for d in 0..3 {
                for a in 0..3 {
                    let is_same = 3 * row + a == 3 * column + d;
                    block.col_mut(d)[a] = dot(3 * row + a, 3 * column + d) + f64::from(u8::from(is_same));
                }
            }
            group.compliance_m_per_n.push(block);
        }
    }
    let moves_m: Vec<DVec3> = (0..n).map(|_| vector()).collect();
    let contacts = (0..6u32)
        .map(|k| {
            let key = ContactKey::VertexTriangle(k, k);
            let mut contact = Contact::new(key, vector().normalize(), 0.1 * f64::from(k % 3) - 0.05);
            contact.vertices = [k, 6 + k, 6 + (k + 1) % 6, 6 + (k + 2) % 6];
            contact.weights = [1.0, -0.5, -0.3, -0.2];
            contact.friction = friction;
            contact
        })
        .collect();
    (contacts, response, moves_m)
}

#[test]
fn the_solved_forces_fulfil_signorini_and_coulomb() {
    let (mut n_open, mut n_stuck, mut n_slipping) = (0, 0, 0);
    for seed in 0..40 {
        for friction in [0.0, 0.2, 0.6] {
            let (mut contacts, response, mut moves_m) = random_contacts(seed, friction);
            let free_m = moves_m.clone();
            let found =
                solve(&mut contacts, &response, Sweeps { most: 20_000, tolerance: 1e-13 }, &mut moves_m);
            assert!(found.residual <= 1e-13, "{seed} {friction} {found:?}");
            let mut expected_m = free_m;
            for contact in &contacts {
                for (v, weight) in contact.sides() {
                    response.add(v, contact.force_n * weight, &mut expected_m);
                }
                let (u, n, f) = (contact.relative_m(&moves_m), contact.normal, contact.force_n);
                let (gap, along) = (n.dot(u) + contact.slack_m, f.dot(n));
                assert!(gap > -1e-9 && along >= 0.0 && gap * along < 1e-9, "{seed}: {gap} {along}");
                let (slip, across) = (u - n * n.dot(u), f - n * along);
                let limit = friction * along;
                assert!(across.length() <= limit * (1.0 + 1e-12) + 1e-15);
                if along == 0.0 {
                    n_open += 1;
                } else if across.length() < limit * (1.0 - 1e-6) {
                    assert!(slip.length() < 1e-8, "{seed}: slips by {slip} inside the cone");
                    n_stuck += 1;
                } else if friction > 0.0 {
                    // Against the slip.
                    let cosine = across.dot(slip) / (across.length() * slip.length()).max(1e-300);
                    assert!(slip.length() < 1e-8 || cosine < -1.0 + 1e-6, "{seed}: {cosine}");
                    n_slipping += 1;
                }
            }
            for (found, expected) in moves_m.iter().zip(&expected_m) {
                assert!(found.distance(*expected) < 1e-9, "moves answer to the forces");
            }
        }
    }
    assert!(n_open > 50 && n_stuck > 10 && n_slipping > 50, "{n_open} {n_stuck} {n_slipping}");
}

#[test]
fn a_block_sticks_below_the_angle_of_friction() {
    for kind in [Kind::Kernel, Kind::Implicit] {
        let mesh = resting(4);
        let (model, dt_s) = Setting::new(kind, &mesh).build();
        let mut world = world(vec![touching(&mesh, model, 0.5)], vec![floor(0.5)]);
        load(&mut world, gravity((0.98 * 0.5_f64).atan()), dt_s, 1.0);
        let footprint = |world: &CollidingBodies| -> DVec3 {
            let below = nodes_below(&mesh, 2, 0.01);
            below.iter().map(|n| world.model(0).state().positions_m[n.index()]).sum::<DVec3>()
                / below.len() as f64
        };
        run(&mut world, dt_s, 0.5);
        let before_m = footprint(&world);
        run(&mut world, dt_s, 1.0);
        let creep_m = footprint(&world).distance(before_m);
        assert!(creep_m < 2e-5, "{kind:?}: {creep_m}");
        assert!(world.report().penetration_m == 0.0);
    }
}

#[test]
fn a_block_slides_above_it_with_the_acceleration_of_a_rigid_one() {
    let mu = 0.5;
    let tilt = (1.02_f64 * mu).atan();
    for kind in [Kind::Kernel, Kind::Implicit] {
        let mesh = resting(4);
        let (model, dt_s) = Setting::new(kind, &mesh).build();
        let mut world = world(vec![touching(&mesh, model, mu)], vec![floor(mu)]);
        load(&mut world, gravity(tilt), dt_s, 1.5);
        run(&mut world, dt_s, 0.5);
        let speed = |world: &CollidingBodies| momentum(&mesh, world.model(0)).x;
        // Over one second, in which what is left of the vibrations counts little.
        let (mut before, mut after) = (0.0, 0.0);
        let n = (0.5 / dt_s).round() as usize;
        for _ in 0..n {
            world.step(dt_s);
            before += speed(&world) / n as f64;
        }
        for _ in 0..n {
            world.step(dt_s);
            after += speed(&world) / n as f64;
        }
        let acceleration = (after - before) / (n as f64 * dt_s);
        let expected = G * (tilt.sin() - mu * tilt.cos());
        assert!((acceleration / expected - 1.0).abs() < 0.05, "{kind:?}: {acceleration} {expected}");
    }
}

#[test]
fn stacked_blocks_bear_their_weight_without_penetration() {
    for kind in [Kind::Kernel, Kind::TensorMass, Kind::Implicit] {
        // The upper one is coarser, and stands askew.
        let meshes = [resting(4), block(3, DVec3::new(4e-3, 7e-3, SIDE_M + 2.0 * SKIN_M))];
        let mut dt_s = f64::INFINITY;
        let mut bodies = Vec::new();
        for mesh in &meshes {
            let damping = Rayleigh { mass_per_s: 20.0, stiffness_s: 2e-4 };
            let (model, step_s) = Setting { damping, ..Setting::new(kind, mesh) }.build();
            dt_s = dt_s.min(step_s);
            bodies.push(touching(mesh, model, 0.4));
        }
        let mut world = world(bodies, vec![floor(0.4)]);
        load(&mut world, gravity(0.0), dt_s, 0.5);
        run(&mut world, dt_s, 0.7);
        let (on_floor_n, on_upper_n) = (world.force_on_n(2), world.force_on_n(1));
        assert!((on_floor_n + DVec3::Z * 2.0 * G).length() < 0.02 * G, "{kind:?}: {on_floor_n}");
        assert!((on_upper_n - DVec3::Z * G).length() < 0.02 * G, "{kind:?}: {on_upper_n}");
        let before_m = [0, 1].map(|b| center_m(&meshes[b], world.model(b)));
        run(&mut world, dt_s, 0.3);
        let after_m = [0, 1].map(|b| center_m(&meshes[b], world.model(b)));
        assert!(before_m[1].distance(after_m[1]) < 2e-4, "{kind:?}: {}", after_m[1] - before_m[1]);
        assert!(world.report().penetration_m <= 1e-5 && world.report().n_dropped == 0);
    }
}

#[test]
fn a_bounce_without_friction_gains_no_energy() {
    for kind in [Kind::Kernel, Kind::TensorMass, Kind::Implicit] {
        let mesh = block(3, DVec3::Z * 0.01);
        let setting = Setting {
            gravity_m_per_s2: gravity(0.0),
            damping: Rayleigh::default(),
            ..Setting::new(kind, &mesh)
        };
        let (model, dt_s) = setting.build();
        let mut world = world(vec![touching(&mesh, model, 0.0)], vec![floor(0.0)]);
        let now_j = |world: &CollidingBodies| {
            potential_j(&mesh, world.model(0).state().positions_m, gravity(0.0), kind)
        };
        let at_floor_j = potential_j(&resting(3), &resting(3).positions_m, gravity(0.0), kind);
        let (mut earlier_j, mut least_j) = (now_j(&world), now_j(&world));
        let drop_j = least_j - at_floor_j;
        let mut lifted_m = 0.0_f64;
        for _ in 0..(0.5 / dt_s) as usize {
            world.step(dt_s);
            let potential_j = now_j(&world);
            // Velocities of central differences are those of half a step ago.
            let between_j =
                if kind == Kind::Implicit { potential_j } else { 0.5 * (potential_j + earlier_j) };
            earlier_j = potential_j;
            let energy_j = between_j + world.model(0).report().kinetic_energy_j;
            assert!(energy_j < least_j + 1e-2 * drop_j, "{kind:?}: {energy_j} after {least_j}, {drop_j}");
            least_j = least_j.min(energy_j);
            lifted_m = lifted_m.max(world.contacts().map(|c| c.gap_m).fold(f64::INFINITY, f64::min).min(1.0));
        }
        assert!(least_j < at_floor_j + 0.9 * drop_j, "{kind:?}: it has to meet the floor");
        assert!(world.report().penetration_m <= 0.0 && lifted_m > 0.0);
    }
}

#[test]
fn bodies_that_meet_in_the_air_keep_their_momentum() {
    let meshes = [block(3, DVec3::ZERO), block(2, DVec3::new(0.03, 0.02, SIDE_M + 5e-3))];
    let mut dt_s = f64::INFINITY;
    let mut bodies = Vec::new();
    for mesh in &meshes {
        let (model, step_s) = Setting::new(Kind::Kernel, mesh).build();
        dt_s = dt_s.min(step_s);
        bodies.push(touching(mesh, model, 0.5));
    }
    let mut world = world(bodies, Vec::new());
    // Thrown at each other for a moment.
    world.model_mut(1).set_gravity(DVec3::new(3.0, 0.0, -40.0));
    run(&mut world, dt_s, 10e-3);
    world.model_mut(1).set_gravity(DVec3::ZERO);
    let total = |world: &CollidingBodies| -> DVec3 {
        (0..2).map(|b| momentum(&meshes[b], world.model(b))).sum::<DVec3>()
    };
    let before = total(&world);
    let mut most_pressed = 0;
    for _ in 0..(0.1 / dt_s) as usize {
        world.step(dt_s);
        most_pressed = most_pressed.max(world.report().n_pressed);
        assert!(total(&world).distance(before) < 1e-9 * before.length());
    }
    assert!(most_pressed > 3 && momentum(&meshes[0], world.model(0)).z < -0.1 * before.length());
}

#[test]
fn fixed_nodes_stay_where_they_are_whatever_presses() {
    for kind in [Kind::Kernel, Kind::TensorMass, Kind::Implicit] {
        let mesh = block(3, DVec3::ZERO);
        let fixed: Vec<FixedNode> =
            nodes_below(&mesh, 0, 0.01).into_iter().map(FixedNode::all_axes).collect();
        let (model, dt_s) = Setting { fixed: &fixed, ..Setting::new(kind, &mesh) }.build();
        let pose = RigidPose { rotation: DMat3::IDENTITY, origin_m: DVec3::new(0.02, 0.05, 0.112) };
        let ball = Obstacle { shape: ObstacleShape::Ball { radius_m: 0.011 }, pose, friction: 0.5 };
        let mut world = world(vec![touching(&mesh, model, 0.5)], vec![ball]);
        // Into the top near the held side, and over the held edge.
        let n = (0.2 / dt_s) as usize;
        let mut most_n = 0.0_f64;
        for i in 0..n {
            let s = (i + 1) as f64 / n as f64;
            let down_m = 0.012 * (4.0 * s).min(1.0);
            let origin_m = pose.origin_m - DVec3::Z * down_m - DVec3::X * 0.02 * (2.0 * s - 1.0).max(0.0);
            world.move_obstacle(0, RigidPose { origin_m, ..pose });
            world.step(dt_s);
            most_n = most_n.max(world.force_on_n(1).length());
            for node in &fixed {
                let n = node.node.index();
                assert_eq!(world.model(0).state().positions_m[n], mesh.positions_m[n], "{kind:?}");
            }
        }
        assert!(most_n > 1.0, "{kind:?}: the ball presses with {most_n}");
        assert!(world.model(0).state().positions_m.iter().all(|p| p.is_finite()), "{kind:?}");
    }
}

/// A block with a slot from one side: two prongs.
fn fork() -> TetMesh {
    let whole = box_of_five([6, 3, 7], DVec3::new(0.12, 0.03, 0.07));
    let in_slot = |t: &[NodeId; 4]| {
        let center = t.iter().map(|n| whole.positions_m[n.index()]).sum::<DVec3>() / 4.0;
        center.x > 0.02 && (0.03..0.04).contains(&center.z)
    };
    let tetrahedra: Vec<_> = whole.tetrahedra.iter().filter(|t| !in_slot(t)).copied().collect();
    let mut new_id = vec![None; whole.positions_m.len()];
    let mut mesh = TetMesh::default();
    for nodes in tetrahedra {
        mesh.tetrahedra.push(nodes.map(|n| {
            *new_id[n.index()].get_or_insert_with(|| {
                mesh.positions_m.push(whole.positions_m[n.index()]);
                NodeId::from_index(mesh.positions_m.len() - 1)
            })
        }));
    }
    mesh
}

#[test]
fn the_prongs_of_one_body_do_not_pass_through_each_other() {
    let deepest = |self_collision: bool| {
        let mesh = fork();
        let fixed: Vec<FixedNode> =
            nodes_below(&mesh, 0, 0.005).into_iter().map(FixedNode::all_axes).collect();
        let damping = Rayleigh { mass_per_s: 20.0, stiffness_s: 2e-4 };
        let (model, dt_s) = Setting { fixed: &fixed, damping, ..Setting::new(Kind::Kernel, &mesh) }.build();
        let params = ContactParams { self_collision, ..ContactParams::default() };
        let bodies = vec![touching(&mesh, model, 0.2)];
        let mut world = CollidingBodies::new(bodies, Vec::new(), &params).unwrap();
        // The ends are pressed together.
        let mut forces: Vec<NodalForce> = Vec::new();
        for (n, p) in mesh.positions_m.iter().enumerate().filter(|(_, p)| p.x > 0.119) {
            let down = f64::from(u8::from(p.z > 0.069)) - f64::from(u8::from(p.z < 0.001));
            if down != 0.0 {
                forces.push(NodalForce { node: NodeId::from_index(n), force_n: DVec3::Z * -0.15 * down });
            }
        }
        world.set_constraints(0, &Constraints { displacements: Vec::new(), forces });
        run(&mut world, dt_s, 0.4);
        // Between the inner faces of the prongs at their ends: nodes that faced each other at rest.
        let inner = |z: f64| {
            let is_there = |p: &DVec3| p.x > 0.119 && (p.z - z).abs() < 1e-6;
            let found = (0..mesh.positions_m.len()).filter(|n| is_there(&mesh.positions_m[*n]));
            let mut found: Vec<usize> = found.collect();
            found.sort_by(|a, b| mesh.positions_m[*a].y.total_cmp(&mesh.positions_m[*b].y));
            found
        };
        let positions_m = world.model(0).state().positions_m;
        let gap_m = |(above, below): (usize, usize)| positions_m[above].z - positions_m[below].z;
        inner(0.04).into_iter().zip(inner(0.03)).map(gap_m).fold(f64::INFINITY, f64::min)
    };
    let (with, without) = (deepest(true), deepest(false));
    assert!(with > 0.0 && with < 5e-3, "{with}");
    assert!(without < -5e-3, "without it they would pass: {without}");
}

#[test]
fn a_quasi_static_body_yields_to_a_ball_as_its_compliance_says() {
    let mesh = block(4, DVec3::ZERO);
    let material = material();
    let fixed = nodes_below(&mesh, 2, 0.01);
    let model = Precomputed::build(&PrecomputedParams {
        mesh: &mesh,
        material: &material,
        fixed_nodes: &fixed,
        stored: StoredNodes::Surface,
        precision: Precision::F64,
        progress: None,
    })
    .unwrap();
    let radius_m = 0.08;
    let pose = |down_m: f64| RigidPose {
        rotation: DMat3::IDENTITY,
        origin_m: DVec3::new(0.05, 0.05, SIDE_M + SKIN_M + radius_m - down_m),
    };
    let ball = Obstacle { shape: ObstacleShape::Ball { radius_m }, pose: pose(0.0), friction: 0.3 };
    let mut world = world(vec![touching(&mesh, Box::new(model), 0.3)], vec![ball]);
    for i in 1..=50 {
        world.move_obstacle(0, pose(1e-4 * f64::from(i)));
        world.step(1e-2);
    }
    for _ in 0..20 {
        world.step(1e-2);
    }
    // The middle node is pressed by 5 mm. Each triangle and each edge has a contact where it is nearest, and what is inside
    // comes out by forces.
    let center_m = pose(5e-3).origin_m;
    let positions_m = world.model(0).state().positions_m;
    let (surface, nodes) = surface_of(&Topology::build(&mesh).unwrap(), &mesh);
    let nearest = |t: &[u32; 3]| {
        let corners_m = t.map(|v| positions_m[nodes[v as usize].index()]);
        at_weights(corners_m, closest_weights(center_m, corners_m)).distance(center_m) - radius_m - SKIN_M
    };
    let gap_m = surface.triangles.iter().map(nearest).fold(f64::INFINITY, f64::min);
    assert!((-2e-5..1e-6).contains(&gap_m), "{gap_m}");
    let force_n = world.force_on_n(1);
    assert!(force_n.z > 0.5 && force_n.truncate().length() < 0.02 * force_n.z, "{force_n}");
    assert!(world.report().n_pressed >= 5, "{:?}", world.report());
}

#[test]
fn a_plate_of_triangles_bears_like_a_half_space() {
    let plate = TriMesh {
        positions_m: [[-0.05, -0.05], [0.15, -0.05], [0.15, 0.15], [-0.05, 0.15]]
            .iter()
            .map(|[x, y]| DVec3::new(*x, *y, 0.0))
            .collect(),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    };
    let shapes = [ObstacleShape::HalfSpace, ObstacleShape::Mesh(plate)];
    let found = shapes.map(|shape| {
        let mesh = resting(3);
        let damping = Rayleigh { mass_per_s: 20.0, stiffness_s: 2e-4 };
        let (model, dt_s) = Setting { damping, ..Setting::new(Kind::Kernel, &mesh) }.build();
        let obstacle = Obstacle { shape, pose: RigidPose::IDENTITY, friction: 0.3 };
        let mut world = world(vec![touching(&mesh, model, 0.3)], vec![obstacle]);
        load(&mut world, gravity(0.0), dt_s, 0.3);
        run(&mut world, dt_s, 0.6);
        assert!((world.force_on_n(0) - DVec3::Z * G).length() < 0.02 * G, "{}", world.force_on_n(0));
        center_m(&mesh, world.model(0))
    });
    assert!(found[0].distance(found[1]) < 1e-5, "{} {}", found[0], found[1]);
}

#[test]
fn what_begins_inside_comes_out_without_a_jump() {
    let mesh = block(3, DVec3::Z * -5e-4);
    let (model, dt_s) = Setting::new(Kind::Kernel, &mesh).build();
    let mut world = world(vec![touching(&mesh, model, 0.0)], vec![floor(0.0)]);
    let mut most_j = 0.0_f64;
    for _ in 0..400 {
        world.step(dt_s);
        most_j = most_j.max(world.model(0).report().kinetic_energy_j);
    }
    assert!(world.report().penetration_m < 1e-5, "{:?}", world.report());
    // Elastic energy of the layer that was pushed, not m v^2/2 of 0.5 mm a step.
    assert!(most_j < 2e-3, "{most_j}");
}

#[test]
fn a_contact_that_opens_leaves_no_force_behind() {
    for kind in [Kind::Kernel, Kind::Implicit] {
        let mesh = block(3, DVec3::ZERO);
        let fixed: Vec<FixedNode> =
            nodes_below(&mesh, 2, 0.01).into_iter().map(FixedNode::all_axes).collect();
        let damping = Rayleigh { mass_per_s: 50.0, stiffness_s: 2e-4 };
        let (model, dt_s) = Setting { fixed: &fixed, damping, ..Setting::new(kind, &mesh) }.build();
        let pose = |z: f64| RigidPose { rotation: DMat3::IDENTITY, origin_m: DVec3::new(0.05, 0.05, z) };
        let punch = Obstacle {
            shape: ObstacleShape::FlatPunch { radius_m: 0.03, length_m: 0.1 },
            pose: pose(SIDE_M + SKIN_M),
            friction: 0.5,
        };
        let mut world = world(vec![touching(&mesh, model, 0.5)], vec![punch]);
        let n = (0.1 / dt_s) as usize;
        for i in 1..=n {
            world.move_obstacle(0, pose(SIDE_M + SKIN_M - 5e-3 * i as f64 / n as f64));
            world.step(dt_s);
        }
        assert!(world.force_on_n(1).z > 1.0, "{kind:?}: {}", world.force_on_n(1));
        // Away at 1 m/s.
        for i in 1..=60 {
            world.move_obstacle(0, pose(SIDE_M - 5e-3 + 1e-3 * f64::from(i)));
            world.step(1e-3);
        }
        assert_eq!(world.force_on_n(1), DVec3::ZERO);
        run(&mut world, dt_s, 0.6);
        let rest = mesh.positions_m.iter().zip(world.model(0).state().positions_m);
        let furthest_m = rest.map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
        assert!(furthest_m < 1e-5, "{kind:?}: {furthest_m}");
    }
}

/// Hands tasks to threads, the last ones first.
struct Backwards;

impl Workers for Backwards {
    fn run(&self, n_tasks: usize, task: &Task<'_>) {
        std::thread::scope(|scope| {
            let half = n_tasks / 2;
            scope.spawn(move || (0..half).rev().for_each(task));
            (half..n_tasks).rev().for_each(task);
        });
    }
}

#[test]
fn steps_allocate_nothing_and_have_the_same_bits_at_any_number_of_threads() {
    let hash = |threads: bool| {
        let meshes = [resting(4), block(3, DVec3::new(0.01, 0.02, SIDE_M + 2.0 * SKIN_M))];
        let mut dt_s = f64::INFINITY;
        let mut bodies = Vec::new();
        for mesh in &meshes {
            let body = DynamicBody {
                damping: Rayleigh { mass_per_s: 0.0, stiffness_s: 2e-4 },
                gravity_m_per_s2: gravity(0.2),
                ..DynamicBody::new(mesh, DENSITY)
            };
            let materials = [material()];
            let (params, step_s) = kernel_params(body, &materials);
            let mut model = ExplicitKernel::build(&params).unwrap();
            if threads {
                model.set_workers(Arc::new(Backwards));
            }
            dt_s = dt_s.min(step_s);
            bodies.push(touching(mesh, Box::new(model), 0.3));
        }
        let params = ContactParams { self_collision: true, ..ContactParams::default() };
        let mut world = CollidingBodies::new(bodies, vec![floor(0.3)], &params).unwrap();
        world.step(dt_s);
        let mut most_pressed = 0;
        let count = allocation_counter::measure(|| {
            for _ in 0..300 {
                world.step(dt_s);
                most_pressed = most_pressed.max(world.report().n_pressed);
            }
        });
        assert!(threads || count.count_total == 0, "{} allocations", count.count_total);
        assert!(most_pressed > 20, "{most_pressed}");
        let bits = |v: &DVec3| v.to_array().map(f64::to_bits);
        (0..2).flat_map(|b| world.model(b).state().positions_m.iter().map(bits).collect::<Vec<_>>()).collect()
    };
    let alone: Vec<[u64; 3]> = hash(false);
    assert_eq!(alone, hash(false));
    assert_eq!(alone, hash(true));
}

#[test]
fn implicit_bodies_in_contact_allocate_nothing_either() {
    let mesh = resting(3);
    let setting = Setting { gravity_m_per_s2: gravity(0.2), ..Setting::new(Kind::Implicit, &mesh) };
    let (model, dt_s) = setting.build();
    let mut world = world(vec![touching(&mesh, model, 0.3)], vec![floor(0.3)]);
    world.step(dt_s);
    let count = allocation_counter::measure(|| (0..40).for_each(|_| world.step(dt_s)));
    assert_eq!(count.count_total, 0);
    assert!(world.report().n_pressed > 5);
}

#[test]
fn what_cannot_be_is_told() {
    let mesh = resting(2);
    let build = |params: &ContactParams, change: &dyn Fn(&mut BodyParams)| {
        let (model, _) = Setting::new(Kind::Kernel, &mesh).build();
        let mut body = touching(&mesh, model, 0.3);
        change(&mut body);
        CollidingBodies::new(vec![body], Vec::new(), params).map(|_| ()).unwrap_err()
    };
    let fine = ContactParams::default();
    let error = build(&ContactParams { skin_m: 0.0, ..fine }, &|_| {});
    assert_eq!(error.to_string(), "skin [m] is 0; allowed: a finite number above 0");
    let error = build(&fine, &|body| body.friction = -1.0);
    assert!(matches!(error, ContactSetUpError::Parameter { what: "coefficient of friction", .. }));
    let error = build(&fine, &|body| body.nodes.swap(0, 1));
    assert!(matches!(error, ContactSetUpError::Nodes { body: 0, n_vertices: 26, n_nodes: 26, n_model: 27 }));
    let error = build(&fine, &|body| body.surface.triangles[3][1] = 99);
    assert!(matches!(error, ContactSetUpError::Vertex { triangle: 3, vertex: 99, .. }), "{error}");
}
