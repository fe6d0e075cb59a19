//! Numbers that make no sense, motions that blow up, bodies that cannot be.

use glisson_mesh::math::{DVec3, SeededRandom};
use glisson_mesh::mesh::NodeId;
use glisson_tissue::model::StateHash;
use glisson_tissue::model::explicit_kernel::{
    ExplicitError, ExplicitKernel, ExplicitKernelError, ExplicitKernelParams,
};
use glisson_tissue::model::kernel::{KernelError, KernelLaw};
use glisson_tissue::model::{
    Attachment, Constraints, DeformableModel, DynamicBody, FixedNode, ImposedDisplacement, NodalForce,
    Rayleigh,
};
use glisson_tissue::solve::SolveError;

use super::{LAWS, SIZE_M, body, body_of, build, material, organ, time_step_s, touched};
use crate::model_meshes::block;

#[test]
fn what_is_not_finite_or_has_nothing_to_act_on_is_left_out_and_counted() {
    let (mesh, fixed) = organ();
    let body = body(&mesh, &fixed);
    let n_nodes = mesh.positions_m.len();
    let free = touched(&mesh)[0];
    let displacement = |node, displacement_m| ImposedDisplacement { node, displacement_m };
    let force = |node, force_n| NodalForce { node, force_n };
    let bad = Constraints {
        displacements: vec![
            displacement(fixed[0].node, DVec3::ZERO),
            displacement(free, DVec3::new(0.0, f64::NAN, 0.0)),
            displacement(NodeId::from_index(n_nodes), DVec3::ZERO),
        ],
        forces: vec![
            force(fixed[0].node, DVec3::ONE),
            force(free, DVec3::new(f64::INFINITY, 0.0, 0.0)),
            force(NodeId::from_index(n_nodes), DVec3::ONE),
        ],
    };
    for law in LAWS {
        let (mut model, mut untouched) = (build(body, law), build(body, law));
        for _ in 0..50 {
            model.apply(&bad);
            model.set_gravity(DVec3::NAN);
            model.step(body.time_step_s);
            model.step(f64::NAN);
            untouched.step(body.time_step_s);
        }
        assert_eq!(model.report().n_ignored_constraints, 6);
        assert_eq!(StateHash::of_model(&model, &[], &[]), StateHash::of_model(&untouched, &[], &[]));
        assert_eq!(model.constraint_forces_n(), [DVec3::ZERO; 3]);
        let mut nowhere = mesh.positions_m.clone();
        nowhere[free.index()] = DVec3::NAN;
        model.take_over(&nowhere);
        assert!(model.state().positions_m.iter().all(|p| p.is_finite()));
    }
}

#[test]
fn a_node_thrown_beyond_all_numbers_leaves_the_others_finite() {
    let (mesh, fixed) = organ();
    let body = body(&mesh, &fixed);
    let mut model = build(body, KernelLaw::StVenantKirchhoff);
    let node = touched(&mesh)[0];
    let far = ImposedDisplacement { node, displacement_m: DVec3::splat(1e150) };
    model.apply(&Constraints { displacements: vec![far], forces: Vec::new() });
    model.step(body.time_step_s);
    let report = model.report();
    assert!(report.n_recovered_nodes + report.n_quarantined_tets > 0, "{report:?}");
    model.apply(&Constraints::default());
    for _ in 0..100 {
        model.step(body.time_step_s);
        assert!(model.state().positions_m.iter().all(|p| p.is_finite()));
        assert!(model.state().velocities_m_per_s.iter().all(|v| v.is_finite()));
    }
}

#[test]
fn a_run_that_blows_up_stays_finite_and_says_so() {
    let (mesh, fixed) = organ();
    let body = body(&mesh, &fixed);
    let mut model = build(body, KernelLaw::StVenantKirchhoff);
    // Six times as long and shaken: far from what the step is stable for.
    let mut random = SeededRandom::new(9);
    let blown: Vec<DVec3> = mesh.positions_m.iter().map(|&p| p * (6.0 + random.uniform())).collect();
    model.take_over(&blown);
    let mut limited = 0;
    for _ in 0..3000 {
        model.step(body.time_step_s);
        let report = model.report();
        limited += u32::from(report.energy_was_limited);
        assert!(report.kinetic_energy_j.is_finite());
    }
    assert!(limited > 0);
    let far_m = model.state().positions_m.iter().map(|p| p.length()).fold(0.0, f64::max);
    assert!(far_m < 1e4, "{far_m}");
}

/// A crumb may not gather what the whole body could hold.
#[test]
fn a_tetrahedron_that_hangs_by_a_node_and_is_thrown_goes_no_faster_than_waves() {
    let mut mesh = block([4, 4, 4], SIZE_M);
    let hook = mesh.positions_m.len() - 1;
    let first = mesh.positions_m.len();
    let edge_m = 0.5 * SIZE_M.x / 4.0;
    mesh.positions_m.extend([DVec3::X, DVec3::Y, DVec3::Z].map(|d| SIZE_M + d * edge_m));
    mesh.tetrahedra.push([hook, first, first + 1, first + 2].map(NodeId::from_index));
    let fixed: Vec<FixedNode> = (0..25).map(|n| FixedNode::all_axes(NodeId(n))).collect();
    // Neo-Hookean tissue stiffens more.
    let time_step_s = 0.5 * time_step_s(&mesh);
    let body = DynamicBody {
        damping: Rayleigh::default(),
        gravity_m_per_s2: DVec3::ZERO,
        ..body_of(&mesh, &fixed, time_step_s)
    };
    let node = NodeId::from_index(first + 2);
    for law in [KernelLaw::StVenantKirchhoff, KernelLaw::StableNeoHooke] {
        let mut model = build(body, law);
        let thrown = ImposedDisplacement { node, displacement_m: DVec3::new(0.1, -0.2, -0.3) };
        model.apply(&Constraints { displacements: vec![thrown], forces: Vec::new() });
        model.step(time_step_s);
        model.apply(&Constraints::default());
        let (mut furthest_m, mut fastest_m_per_s, mut was_limited) = (0.0_f64, 0.0_f64, false);
        for _ in 0..5000 {
            model.step(time_step_s);
            let state = model.state();
            for (p, rest) in state.positions_m.iter().zip(&mesh.positions_m) {
                furthest_m = furthest_m.max(p.distance(*rest));
            }
            fastest_m_per_s =
                state.velocities_m_per_s.iter().map(|v| v.length()).fold(fastest_m_per_s, f64::max);
            was_limited |= model.report().energy_was_limited;
        }
        // Without the limit: 640 m/s.
        assert!(was_limited, "{law:?}");
        assert!(furthest_m < 0.5 && fastest_m_per_s < 60.0, "{law:?}: {furthest_m} m, {fastest_m_per_s} m/s");
    }
}

/// What decays for ever passes through subnormal numbers, which are slow.
#[test]
fn a_damped_body_comes_to_a_standstill() {
    let mesh = block([2, 2, 1], SIZE_M);
    let fixed: Vec<FixedNode> = (0..9).map(|n| FixedNode::all_axes(NodeId(n))).collect();
    let damping = Rayleigh { mass_per_s: 100.0, stiffness_s: 0.0 };
    let body =
        DynamicBody { damping, gravity_m_per_s2: DVec3::ZERO, ..body_of(&mesh, &fixed, time_step_s(&mesh)) };
    for law in LAWS {
        let mut model = build(body, law);
        let moved: Vec<DVec3> = mesh.positions_m.iter().map(|&p| p + DVec3::new(1e-3, 0.0, 2e-3)).collect();
        model.take_over(&moved);
        for _ in 0..20_000 {
            model.step(body.time_step_s);
            let none_is_subnormal = model.history().iter().all(|x| *x == 0.0 || x.abs() >= 1e-90);
            assert!(none_is_subnormal);
        }
        let far_m =
            model.state().positions_m.iter().zip(&mesh.positions_m).map(|(p, rest)| p.distance(*rest));
        assert!(far_m.fold(0.0, f64::max) < 1e-80);
        assert!(model.state().velocities_m_per_s.iter().all(|v| *v == DVec3::ZERO));
    }
}

#[test]
fn impossible_input_is_refused_by_name() {
    let mesh = block([2, 1, 1], SIZE_M);
    let materials = [material()];
    let whole = body_of(&mesh, &[], 1e-4);
    let refusal = |body: DynamicBody<'_>| {
        let params = ExplicitKernelParams::new(body, KernelLaw::Linear, &materials);
        ExplicitKernel::build(&params).map(|_| ()).unwrap_err()
    };
    let text = |body| refusal(body).to_string();
    assert!(matches!(
        refusal(DynamicBody { time_step_s: 1.0, ..whole }),
        ExplicitKernelError::Explicit(ExplicitError::UnstableStep { found_s: 1.0, .. })
    ));
    let stress = [[f64::NAN; 6]; 12];
    assert!(text(DynamicBody { rest_stress_pa: &stress, ..whole }).contains("rest shape is not finite"));
    let beside = ExplicitKernelParams {
        volume_penalty_pa: 1.0,
        ..ExplicitKernelParams::new(whole, KernelLaw::NeoHookeLog, &materials)
    };
    let refused = ExplicitKernel::build(&beside).map(|_| ()).unwrap_err();
    let (what, law) = ("penalties of volume changes", KernelLaw::NeoHookeLog);
    assert_eq!(refused, ExplicitKernelError::NotBeside { what, law });
    assert!(text(DynamicBody { most_parts: 0, ..whole }).contains("most parts"));
    assert!(text(DynamicBody { density_kg_per_m3: 0.0, ..whole }).contains("ensity"));
    let damping = Rayleigh { mass_per_s: 0.0, stiffness_s: -1.0 };
    assert!(text(DynamicBody { damping, ..whole }).contains("stiffness [s] is -1"));
    let fixed = [FixedNode::all_axes(NodeId(99))];
    let out_of_range = SolveError::ConditionOutOfRange { node: NodeId(99), n_nodes: 12 };
    assert_eq!(refusal(DynamicBody { fixed: &fixed, ..whole }), out_of_range.into());
    let ligament =
        Attachment { node: NodeId(0), anchor_m: DVec3::NAN, slack_length_m: 0.0, stiffness_n_per_m: 1.0 };
    let ligaments = [ligament];
    assert!(text(DynamicBody { attachments: &ligaments, ..whole }).contains("anchor"));
    // A stiff ligament on a light node shortens the step.
    let ligaments = [Attachment { anchor_m: DVec3::ZERO, stiffness_n_per_m: 1e9, ..ligament }];
    assert!(text(DynamicBody { attachments: &ligaments, ..whole }).contains("above the stable one"));
    let two = [material(), material()];
    let params = ExplicitKernelParams::new(whole, KernelLaw::Linear, &two);
    let found = ExplicitKernel::build(&params).map(|_| ()).unwrap_err();
    assert_eq!(found, KernelError::Materials { found: 2, n_tets: 12 }.into());
}

/// At constant volume, beyond the stretch that the step is made for. A linear law is as stiff as at rest.
#[test]
fn a_step_is_divided_while_tissue_is_long_and_thin() {
    let mesh = block([2, 2, 1], SIZE_M);
    for (law, stretch, divided) in [
        (KernelLaw::StVenantKirchhoff, 1.2, 1),
        (KernelLaw::StVenantKirchhoff, 1.5, 8),
        (KernelLaw::Linear, 1.5, 1),
        (KernelLaw::Linear, 3.0, 1),
    ] {
        let body = DynamicBody { most_parts: 8, ..body_of(&mesh, &[], time_step_s(&mesh)) };
        let mut model = build(body, law);
        let thin = 1.0 / libm::sqrt(stretch);
        let places_m: Vec<DVec3> =
            mesh.positions_m.iter().map(|&p| p * DVec3::new(stretch, thin, thin)).collect();
        model.take_over(&places_m);
        for expected in [1, divided] {
            model.step(body.time_step_s);
            assert_eq!(model.report().n_parts, expected, "{law:?} {stretch}");
        }
    }
}

/// A corner pulled as far as the body is long: the law is far stiffer there than the step is made for.
#[test]
fn a_step_is_divided_while_tissue_is_strained_beyond_what_it_is_made_for() {
    let mesh = block([4, 3, 3], SIZE_M);
    let fixed: Vec<FixedNode> = (0..mesh.positions_m.len())
        .filter(|&n| mesh.positions_m[n].x < 1e-9)
        .map(|n| FixedNode::all_axes(NodeId::from_index(n)))
        .collect();
    let law = KernelLaw::StVenantKirchhoff;
    let one = ExplicitKernelParams::new(body_of(&mesh, &fixed, 1e-4), law, &[]);
    let materials = [material()];
    let stable_s =
        ExplicitKernel::stable_step(&ExplicitKernelParams { materials: &materials, ..one.clone() })
            .unwrap()
            .step_s;
    let corner = NodeId::from_index(mesh.positions_m.len() - 1);
    let greatest_force_n = |most_parts: u32| {
        let damping = Rayleigh { mass_per_s: 200.0, stiffness_s: 0.0 };
        let body = DynamicBody { most_parts, damping, ..body_of(&mesh, &fixed, 0.99 * stable_s) };
        let mut model =
            ExplicitKernel::build(&ExplicitKernelParams { body, materials: &materials, ..one.clone() })
                .unwrap();
        let (mut greatest_n, mut n_parts) = (0.0_f64, 0);
        for step in 0..2000 {
            let pull_m = DVec3::X * (0.5 * SIZE_M.x * (1.0 - libm::cos(f64::from(step) * 0.01)));
            let displacements = vec![ImposedDisplacement { node: corner, displacement_m: pull_m }];
            model.apply(&Constraints { displacements, forces: Vec::new() });
            model.step(0.99 * stable_s);
            greatest_n = greatest_n.max(model.constraint_forces_n()[0].length());
            n_parts = n_parts.max(model.report().n_parts);
        }
        model.apply(&Constraints::default());
        for _ in 0..2000 {
            model.step(0.99 * stable_s);
        }
        assert_eq!(model.report().n_parts, 1, "at rest again");
        (greatest_n, n_parts)
    };
    let (divided_n, n_parts) = greatest_force_n(8);
    assert_eq!(n_parts, 8);
    let (undivided_n, n_parts) = greatest_force_n(1);
    assert_eq!(n_parts, 1);
    // Slowly enough pulled, both are right.
    assert!((divided_n / undivided_n - 1.0).abs() < 1e-3, "{divided_n} {undivided_n}");
}
