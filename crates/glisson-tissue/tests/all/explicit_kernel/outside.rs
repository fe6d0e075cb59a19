//! Supports, ligaments, gravity and damping against exact solutions.

use glisson_mesh::math::{DVec3, SeededRandom};
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};
use glisson_tissue::model::explicit_kernel::{ExplicitKernel, ExplicitKernelParams};
use glisson_tissue::model::kernel::KernelLaw;
use glisson_tissue::model::{
    Attachment, Constraints, DeformableModel, DynamicBody, FixedNode, ImposedDisplacement, Rayleigh,
};

use super::{LAWS, body, body_of, build, material, organ, time_step_s};
use crate::model_meshes::block;

/// A block pulled at one face, on rollers at three: the uniform strain of the textbook.
#[test]
fn rollers_hold_one_axis_and_let_the_others_go() {
    let side_m = 0.05;
    let mesh = block([3, 2, 2], DVec3::splat(side_m));
    let on_face = |n: usize, axis: usize| mesh.positions_m[n][axis] < 1e-9;
    let fixed: Vec<FixedNode> = (0..mesh.positions_m.len())
        .map(|n| FixedNode { node: NodeId::from_index(n), axes: [0, 1, 2].map(|axis| on_face(n, axis)) })
        .filter(|f| f.axes != [false; 3])
        .collect();
    let step_s = time_step_s(&mesh);
    let body = DynamicBody { gravity_m_per_s2: DVec3::ZERO, ..body_of(&mesh, &fixed, step_s) };
    let mut model = build(body, KernelLaw::Linear);
    // Pressed to 2 % in x, evenly: the face is held along x only, through its roller's own displacement.
    let strain = 0.02;
    let held: Vec<ImposedDisplacement> = (0..mesh.positions_m.len())
        .filter(|&n| mesh.positions_m[n].x > side_m * (1.0 - 1e-9))
        .map(|n| {
            let lateral_m = 0.45 * strain * mesh.positions_m[n];
            let displacement_m = DVec3::new(-strain * side_m, lateral_m.y, lateral_m.z);
            ImposedDisplacement { node: NodeId::from_index(n), displacement_m }
        })
        .collect();
    let area_m2 = side_m * side_m;
    model.apply(&Constraints { displacements: held, forces: Vec::new() });
    for _ in 0..6000 {
        model.step(step_s);
    }
    for (n, p) in model.state().positions_m.iter().enumerate() {
        let rest = mesh.positions_m[n];
        let expected = DVec3::new(-strain * rest.x, 0.45 * strain * rest.y, 0.45 * strain * rest.z);
        assert!((*p - rest - expected).length() < 1e-7 * side_m, "node {n}: {}", *p - rest - expected);
        for axis in 0..3 {
            assert!(!on_face(n, axis) || p[axis] == rest[axis], "node {n} leaves its roller");
        }
    }
    let total: DVec3 = model.constraint_forces_n().iter().sum();
    let expected_n = -5000.0 * strain * area_m2;
    assert!((total.x / expected_n - 1.0).abs() < 1e-6, "{total} {expected_n}");
    assert!(total.y.abs() < 1e-6 * expected_n.abs() && total.z.abs() < 1e-6 * expected_n.abs(), "{total}");
}

#[test]
fn ligaments_carry_a_body_and_gravity_can_be_turned() {
    let mesh = TetMesh {
        positions_m: vec![DVec3::ZERO, 0.02 * DVec3::X, 0.02 * DVec3::Y, 0.02 * DVec3::Z],
        tetrahedra: vec![[0, 1, 2, 3].map(NodeId)],
        ..TetMesh::default()
    };
    let (slack_length_m, stiffness_n_per_m) = (0.03, 0.5);
    let up = DVec3::new(0.0, 0.6, 0.8);
    let attachments: Vec<Attachment> = (0..4)
        .map(|n| {
            let anchor_m = mesh.positions_m[n] + up * slack_length_m;
            Attachment { node: NodeId::from_index(n), anchor_m, slack_length_m, stiffness_n_per_m }
        })
        .collect();
    let step_s = 0.5 * time_step_s(&mesh);
    let body = DynamicBody { attachments: &attachments, ..body_of(&mesh, &[], step_s) };
    let mut model = build(body, KernelLaw::StVenantKirchhoff);
    model.set_gravity(-9.81 * up);
    for _ in 0..30_000 {
        model.step(step_s);
    }
    let mass_kg = model.kernel().mass_kg(NodeId(0));
    let sag_m = -up * (9.81 * mass_kg / stiffness_n_per_m);
    for (p, rest) in model.state().positions_m.iter().zip(&mesh.positions_m) {
        assert!((*p - *rest - sag_m).length() < 1e-9, "{} {sag_m}", *p - *rest);
    }
    // Slack ligaments do nothing: thrown up, the body flies.
    model.take_over(&mesh.positions_m);
    model.set_gravity(2.0 * up);
    model.step(step_s);
    let per_step = model.state().velocities_m_per_s[0];
    let damped = 1.0 / (1.0 + 0.5 * 20.0 * step_s);
    assert!((per_step - 2.0 * up * step_s * damped).length() < 1e-15, "{per_step}");
}

/// A node on a spring of its tetrahedron, along x: the scheme's recursion, and the decay of the theory.
#[test]
fn rayleigh_damping_follows_its_theory() {
    let mesh = TetMesh {
        positions_m: vec![DVec3::ZERO, 0.02 * DVec3::X, 0.02 * DVec3::Y, 0.02 * DVec3::Z],
        tetrahedra: vec![[0, 1, 2, 3].map(NodeId)],
        ..TetMesh::default()
    };
    let mut fixed: Vec<FixedNode> = [0, 2, 3].map(|n| FixedNode::all_axes(NodeId(n))).to_vec();
    fixed.push(FixedNode { node: NodeId(1), axes: [false, true, true] });
    let damping = Rayleigh { mass_per_s: 4.0, stiffness_s: 2e-4 };
    let step_s = 2e-5;
    let no_weight = DynamicBody { gravity_m_per_s2: DVec3::ZERO, damping, ..body_of(&mesh, &fixed, step_s) };
    let mut model = build(no_weight, KernelLaw::Linear);
    let start_m = 1e-3;
    let mut moved = mesh.positions_m.clone();
    moved[1].x += start_m;
    model.take_over(&moved);
    // Stiffness of the one free axis: V (lambda + 2 mu) alpha^2, alpha = 1/0.02.
    let material = material();
    let volume_m3 = mesh.tet_volume_m3(TetId(0));
    let stiffness = volume_m3 * (material.lambda_pa() + 2.0 * material.mu_pa()) / (0.02 * 0.02);
    let squared = stiffness / model.kernel().mass_kg(NodeId(1));
    let (d, beta, h) = (damping.mass_per_s, damping.stiffness_s, step_s);
    let (mut now, mut before) = (start_m, start_m);
    let n_steps = 4000;
    let mut peak = 0.0_f64;
    for step in 1..=n_steps {
        model.step(step_s);
        let force = squared * (now + beta * (now - before) / h);
        let change = ((1.0 / h - 0.5 * d) / h * (now - before) - force) / ((1.0 / h + 0.5 * d) / h);
        (before, now) = (now, now + change);
        let found = model.state().positions_m[1].x - 0.02;
        assert!((found - now).abs() < 1e-9 * start_m, "step {step}: {found} {now}");
        let t = f64::from(step) * h;
        // Undo the decay of the theory: the oscillation keeps its height.
        let rate = 0.5 * (d + beta * squared);
        if step > n_steps / 2 {
            peak = peak.max(found.abs() * libm::exp(rate * t) / start_m);
        }
    }
    assert!((peak - 1.0).abs() < 0.05, "{peak}");
    // The longest step shrinks with beta as derived, and a longer one is refused.
    let stable = |damping: Rayleigh| {
        let body = DynamicBody { damping, ..no_weight };
        ExplicitKernel::stable_step(&ExplicitKernelParams::new(body, KernelLaw::Linear, &[material]))
            .unwrap()
            .step_s
    };
    let (plain_s, beta) = (stable(Rayleigh::default()), 1e-3);
    let damped_s = stable(Rayleigh { mass_per_s: 0.0, stiffness_s: beta });
    let expected_s = (beta * beta + plain_s * plain_s).sqrt() - beta;
    assert!((damped_s / expected_s - 1.0).abs() < 1e-9, "{damped_s} {expected_s}");
}

#[test]
fn stiffness_damping_is_stable_up_to_its_longest_step() {
    let (mesh, fixed) = organ();
    let damping = Rayleigh { mass_per_s: 1.0, stiffness_s: 1e-3 };
    for law in LAWS {
        let mut body = DynamicBody { damping, ..body(&mesh, &fixed) };
        let params = ExplicitKernelParams::new(body, law, &[]);
        let materials = &[material()];
        let params = ExplicitKernelParams { materials, ..params };
        body.time_step_s = ExplicitKernel::stable_step(&params).unwrap().step_s;
        let mut model = build(body, law);
        let mut random = SeededRandom::new(12);
        let shaken: Vec<DVec3> = mesh
            .positions_m
            .iter()
            .map(|p| *p + DVec3::from_array(std::array::from_fn(|_| random.uniform_in(-2e-4, 2e-4))))
            .collect();
        model.take_over(&shaken);
        let mut greatest_j = 0.0_f64;
        for _ in 0..2000 {
            model.step(body.time_step_s);
            greatest_j = greatest_j.max(model.report().kinetic_energy_j);
        }
        // It sags to rest under its weight.
        let report = model.report();
        assert!(!report.energy_was_limited && report.kinetic_energy_j < 0.5 * greatest_j, "{report:?}");
    }
}
