//! What goes wrong with explicit models, and must not spread: inverted tetrahedra, values that are no numbers, steps that
//! became too long, impossible parameters.

use glisson_mesh::math::{DVec3, SeededRandom};
use glisson_mesh::mesh::edit::{EditableMesh, MeshEdit};
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};
use glisson_tissue::model::extended_mass_spring::EdgeLaw;
use glisson_tissue::model::nonlinear_tensor_mass::{NonlinearElasticity, NonlinearTensorMass};
use glisson_tissue::model::tensor_mass::{TensorMass, TensorMassError, TensorMassParams};
use glisson_tissue::model::{
    Attachment, Constraints, DeformableModel, DynamicBody, FixedNode, ImposedDisplacement, NodalForce,
    Rayleigh,
};
use glisson_tissue::solve::SolveError;

use crate::loads::{
    GRAVITY_M_PER_S2, KINDS, Kind, STEP_S, body, build, displacements, extended, extended_with, largest,
    ligament, linear, material, nonlinear, organ, random_vector, springs, supports,
};
use crate::model_meshes::{block, held, nodes_below, random_live_tets, shaken_block};

/// The law with logarithms is left out: its forces near flat tetrahedra ask for a shorter step than that of the rest
/// shape.
#[test]
fn a_node_thrown_through_its_neighbours_comes_back() {
    let size_m = DVec3::new(0.1, 0.08, 0.08);
    let mesh = shaken_block([5, 4, 4], size_m, 0.1, 2);
    let fixed = held(&nodes_below(&mesh, 0, 0.012));
    let off_centre_m = |n: &usize| mesh.positions_m[*n].distance(0.5 * size_m);
    let inner =
        (0..mesh.positions_m.len()).min_by(|a, b| off_centre_m(a).total_cmp(&off_centre_m(b))).unwrap();
    let damped = DynamicBody { fixed: &fixed, damping: Rayleigh::of_mass(60.0), ..body(&mesh) };
    for kind in KINDS {
        let mut model: Box<dyn DeformableModel> = match kind {
            Kind::Extended => Box::new(extended_with(damped, EdgeLaw::StVenantKirchhoff)),
            _ => build(kind, damped),
        };
        let mut thrown = mesh.positions_m.clone();
        thrown[inner] += DVec3::new(0.03, 0.002, 0.001);
        model.take_over(&thrown);
        model.step(STEP_S);
        let report = model.report();
        let expects_quarantine = matches!(kind, Kind::Nonlinear | Kind::Extended);
        assert_eq!(report.n_quarantined_tets > 0, expects_quarantine, "{kind:?}: {report:?}");
        assert_eq!(report.first_quarantined.is_some(), expects_quarantine);
        (0..10).for_each(|_| model.step(400.0 * STEP_S));
        let off_m = largest(&displacements(&*model, &mesh));
        assert_eq!(model.report().n_quarantined_tets, 0, "{kind:?}: {off_m}");
        assert!(off_m < 1e-3, "{kind:?}: {off_m}");
    }
}

/// Turned inside out, a tetrahedron whose law rests in the mirror image, or knows nothing there, is brought back through its base.
#[test]
fn an_inverted_tetrahedron_is_brought_back() {
    let mesh = TetMesh {
        positions_m: vec![
            DVec3::ZERO,
            DVec3::new(0.02, 0.0, 0.0),
            DVec3::new(0.0, 0.02, 0.0),
            DVec3::new(0.005, 0.005, 0.02),
        ],
        tetrahedra: vec![[0, 1, 2, 3].map(NodeId)],
        ..TetMesh::default()
    };
    let fixed = held(&[0, 1, 2].map(NodeId));
    let stress = [[100.0, -50.0, 200.0, 30.0, -20.0, 10.0]];
    let loaded = DynamicBody {
        fixed: &fixed,
        rest_stress_pa: &stress,
        gravity_m_per_s2: GRAVITY_M_PER_S2,
        damping: Rayleigh::of_mass(50.0),
        ..body(&mesh)
    };
    for kind in [Kind::Nonlinear, Kind::Extended] {
        let mut model = build(kind, loaded);
        let mut inverted = mesh.positions_m.clone();
        inverted[3].z = -0.014;
        model.take_over(&inverted);
        model.step(STEP_S);
        let report = model.report();
        assert_eq!((report.n_quarantined_tets, report.first_quarantined), (1, Some(TetId(0))), "{kind:?}");
        let mut n_steps = 0;
        while model.report().n_quarantined_tets > 0 {
            model.step(STEP_S);
            n_steps += 1;
            assert!(n_steps < 10_000, "{kind:?}");
        }
        assert!(model.state().positions_m[3].z > -1e-3);
    }
}

#[test]
fn what_is_no_number_never_spreads() {
    let mesh = organ();
    let fixed = supports(&mesh);
    let free: Vec<NodeId> = (0..mesh.positions_m.len())
        .map(NodeId::from_index)
        .filter(|n| fixed.iter().all(|f| f.node != *n))
        .collect();
    for kind in KINDS {
        let mut model = build(kind, DynamicBody { fixed: &fixed, ..body(&mesh) });
        model.apply(&Constraints {
            displacements: vec![ImposedDisplacement { node: free[0], displacement_m: DVec3::X * f64::NAN }],
            forces: vec![
                NodalForce { node: free[1], force_n: DVec3::Y * f64::INFINITY },
                NodalForce { node: free[2], force_n: DVec3::Y * f64::NAN },
            ],
        });
        model.set_gravity(DVec3::Z * f64::NAN);
        assert_eq!(model.report().n_ignored_constraints, 4, "{kind:?}");
        let mut broken = mesh.positions_m.clone();
        broken[free[3].index()] = DVec3::splat(f64::NAN);
        model.take_over(&broken);
        model.step(f64::NAN);
        (0..10).for_each(|_| model.step(STEP_S));
        assert!(largest(&displacements(&*model, &mesh)) < 1e-12, "{kind:?}");
        // A force that is a number, but too large for what it moves.
        let force_n = DVec3::Y * 1e300;
        let forces = vec![NodalForce { node: free[1], force_n }];
        model.apply(&Constraints { displacements: Vec::new(), forces });
        model.step(STEP_S);
        assert!(model.report().n_recovered_nodes > 0, "{kind:?}");
        model.apply(&Constraints::default());
        (0..100).for_each(|_| model.step(STEP_S));
        assert!(model.state().positions_m.iter().all(|p| p.is_finite()), "{kind:?}");
        assert!(largest(&displacements(&*model, &mesh)) < 0.1, "{kind:?}");
        assert_eq!(model.report().n_recovered_nodes, 0);
    }
}

/// A probe that pushes and lets go: nothing of it looks like a blow-up.
#[test]
fn the_energy_watch_sleeps_in_a_healthy_run() {
    let mesh = organ();
    let fixed = supports(&mesh);
    let highest = ligament(&mesh).node;
    for kind in KINDS {
        let mut model = build(
            kind,
            DynamicBody { fixed: &fixed, gravity_m_per_s2: GRAVITY_M_PER_S2 * 0.05, ..body(&mesh) },
        );
        for step in 0..1000 {
            let depth_m = 0.01 * libm::sin(step as f64 * 0.03).max(0.0);
            let pushed = ImposedDisplacement { node: highest, displacement_m: -DVec3::Z * depth_m };
            let displacements = if depth_m > 0.0 { vec![pushed] } else { Vec::new() };
            model.apply(&Constraints { displacements, forces: Vec::new() });
            model.step(STEP_S);
            let report = model.report();
            assert!(!report.energy_was_limited && report.n_recovered_nodes == 0, "{kind:?} {step}");
        }
    }
}

/// Stretched to four times its length the tissue is stiffer than the step was made for.
#[test]
fn a_blown_up_run_stays_finite_and_says_so() {
    let mesh = block([4, 2, 2], DVec3::new(0.08, 0.04, 0.04));
    let elasticity_step = {
        let material = material();
        let elasticity = NonlinearElasticity {
            material: &material,
            fibres: &[],
            volume_penalty_pa: 0.0,
            largest_stretch: 1.0,
        };
        NonlinearTensorMass::stable_step(&mesh, &elasticity).unwrap().step_s
    };
    let fixed = held(&nodes_below(&mesh, 0, 1e-6));
    let mut model =
        nonlinear(DynamicBody { fixed: &fixed, time_step_s: elasticity_step, ..body(&mesh) }, 1.0);
    let far = (0..mesh.positions_m.len()).filter(|&n| mesh.positions_m[n].x > 0.0799);
    let far: Vec<NodeId> = far.map(NodeId::from_index).collect();
    let mut was_limited = false;
    for step in 0..5000 {
        let share = (f64::from(step) / 500.0).min(1.0);
        let pulled = |&node| ImposedDisplacement { node, displacement_m: DVec3::X * (0.24 * share) };
        let displacements = far.iter().map(pulled).collect();
        model.apply(&Constraints { displacements, forces: Vec::new() });
        model.step(elasticity_step);
        was_limited |= model.report().energy_was_limited;
        let furthest_m = largest(&self::displacements(&model, &mesh));
        assert!(furthest_m < 10.0, "{step}: {furthest_m}");
    }
    assert!(was_limited);
}

/// At the step of the uncut mesh, with no more parts allowed: nodes become heavier, and the run stays stable.
#[test]
fn mass_scaling_keeps_the_scenes_step_stable_after_an_edit() {
    let mesh = shaken_block([6, 4, 4], DVec3::new(0.12, 0.08, 0.08), 0.2, 7);
    let fixed = held(&nodes_below(&mesh, 0, 0.012));
    for kind in KINDS {
        let at = |time_step_s: f64| DynamicBody { fixed: &fixed, time_step_s, most_parts: 1, ..body(&mesh) };
        let stable_s = match kind {
            Kind::Linear => linear(at(1e-5)).stable_step_s(),
            Kind::Nonlinear => nonlinear(at(1e-5), 1.3).stable_step_s(),
            Kind::Springs => springs(at(1e-5)).stable_step_s(),
            Kind::Extended => extended(at(1e-5)).stable_step_s(),
        };
        let h_s = 0.98 * stable_s;
        let mut model = build(kind, at(h_s));
        let mut editable = EditableMesh::new(mesh.clone()).unwrap();
        let mut random = SeededRandom::new(5);
        for round in 0..20 {
            let tets = random_live_tets(&editable, &mut random, 12);
            let change = editable.apply(&MeshEdit::Remove { tets }).unwrap();
            model.topology_changed(editable.mesh(), &change).unwrap();
            model.step(h_s);
            assert_eq!(model.report().n_parts, 1, "{kind:?} {round}");
        }
        // The springs' bound is far from sharp and may not ask for more mass.
        assert!(model.report().n_mass_scaled_nodes > 0 || kind == Kind::Springs, "{kind:?}");
        let shaken: Vec<DVec3> =
            mesh.positions_m.iter().map(|p| *p + random_vector(&mut random) * 1e-6).collect();
        model.take_over(&shaken);
        for _ in 0..3000 {
            model.step(h_s);
        }
        let off_m = largest(&displacements(&*model, &mesh));
        assert!(off_m < 1e-3, "{kind:?}: {off_m:e}");
        assert!(!model.report().energy_was_limited);
    }
}

#[test]
fn impossible_bodies_are_refused() {
    let mesh = organ();
    let refuse = |body: DynamicBody<'_>| {
        TensorMass::build(&TensorMassParams { body, material: &material() }).unwrap_err()
    };
    let stress = [[0.0; 6]; 3];
    let error = refuse(DynamicBody { rest_stress_pa: &stress, ..body(&mesh) });
    assert!(matches!(error, TensorMassError::RestStressCount { found: 3, .. }), "{error}");
    let slack_m = Attachment { slack_length_m: -1.0, ..ligament(&mesh) };
    let error = refuse(DynamicBody { attachments: &[slack_m], ..body(&mesh) });
    assert!(matches!(error, TensorMassError::Parameter { .. }), "{error}");
    let error = refuse(DynamicBody { most_parts: 0, ..body(&mesh) });
    assert!(matches!(error, TensorMassError::Parameter { .. }), "{error}");
    let nowhere = [FixedNode::all_axes(NodeId(100_000))];
    let error = refuse(DynamicBody { fixed: &nowhere, ..body(&mesh) });
    assert!(matches!(error, TensorMassError::Solve(SolveError::ConditionOutOfRange { .. })), "{error}");
    let error =
        refuse(DynamicBody { damping: Rayleigh { mass_per_s: 0.0, stiffness_s: f64::NAN }, ..body(&mesh) });
    assert!(matches!(error, TensorMassError::Parameter { .. }), "{error}");
}
