//! Weight, supports along single axes, ligaments, stress at rest, damping and what goes wrong: what all explicit
//! models have in common.

use glisson_mesh::math::{DVec3, SeededRandom};
use glisson_mesh::mesh::edit::{EditableMesh, MeshEdit};
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};
use glisson_tissue::material::LinearElastic;
use glisson_tissue::model::extended_mass_spring::{EdgeLaw, ExtendedMassSpring, ExtendedMassSpringParams};
use glisson_tissue::model::mass_spring::{MassSpring, MassSpringParams, NodalMasses};
use glisson_tissue::model::nonlinear_tensor_mass::{
    NonlinearElasticity, NonlinearTensorMass, NonlinearTensorMassParams,
};
use glisson_tissue::model::tensor_mass::{TensorMass, TensorMassError, TensorMassParams};
use glisson_tissue::model::{
    Attachment, Constraints, DeformableModel, DynamicBody, FixedNode, ImposedDisplacement, Integration,
    Rayleigh, RestStress,
};
use glisson_tissue::solve::{
    BoundaryConditions, SolveError, StaticProblem, add_gravity_forces, equilibrating_stress, solve_static,
    stress_forces_into,
};

use crate::model_meshes::{
    block, held, nodes_below, random_live_tets, relative_difference, rounded_block, shaken_block,
};

pub(crate) const GRAVITY_M_PER_S2: DVec3 = DVec3::new(0.0, 0.0, -9.81);

pub(crate) fn material() -> LinearElastic {
    LinearElastic::from_young_poisson(5000.0, 0.45, 1060.0).unwrap()
}

/// Some 2,000 tetrahedra, rounded as an organ, 15 x 10 x 6 cm.
pub(crate) fn organ() -> TetMesh {
    rounded_block([9, 7, 5], DVec3::new(0.15, 0.10, 0.06))
}

/// The lower nodes lie on a table that does not hold them sideways; a few behind are grown to it.
pub(crate) fn supports(mesh: &TetMesh) -> Vec<FixedNode> {
    let grown = nodes_below(mesh, 1, -0.03);
    assert!(grown.len() > 5);
    let mut fixed: Vec<FixedNode> = grown.iter().map(|&node| FixedNode::all_axes(node)).collect();
    for node in nodes_below(mesh, 2, -0.02) {
        if !grown.contains(&node) {
            fixed.push(FixedNode { node, axes: [false, false, true] });
        }
    }
    assert!(fixed.len() > grown.len() + 10);
    fixed
}

/// A ligament that is a little stretched at rest, from the highest node upwards.
pub(crate) fn ligament(mesh: &TetMesh) -> Attachment {
    let height = |&n: &usize| mesh.positions_m[n].z;
    let highest = (0..mesh.positions_m.len()).max_by(|a, b| height(a).total_cmp(&height(b))).unwrap();
    Attachment {
        node: NodeId::from_index(highest),
        anchor_m: mesh.positions_m[highest] + DVec3::new(0.01, 0.0, 0.04),
        slack_length_m: 0.04,
        stiffness_n_per_m: 50.0,
    }
}

/// Forces of the stress minus the loads, over the largest nodal weight, at components that are not held.
fn unbalanced(
    mesh: &TetMesh,
    fixed: &[FixedNode],
    attachments: &[Attachment],
    stress_pa: &[RestStress],
) -> f64 {
    let mut weight_n = vec![DVec3::ZERO; mesh.positions_m.len()];
    add_gravity_forces(mesh, &material(), GRAVITY_M_PER_S2, &mut weight_n);
    let largest_n = weight_n.iter().map(|f| f.length()).fold(0.0, f64::max);
    let mut force_n = vec![DVec3::ZERO; mesh.positions_m.len()];
    stress_forces_into(mesh, stress_pa, &mut force_n);
    for attachment in attachments {
        let n = attachment.node.index();
        force_n[n] -= attachment.force_n(mesh.positions_m[n]);
    }
    let mut off_n = 0.0_f64;
    for n in 0..force_n.len() {
        let held = fixed.iter().find(|f| f.node.index() == n).map_or([false; 3], |f| f.axes);
        for axis in (0..3).filter(|&axis| !held[axis]) {
            off_n = off_n.max((force_n[n] - weight_n[n])[axis].abs());
        }
    }
    off_n / largest_n
}

#[test]
fn the_equilibrating_stress_carries_the_weight_in_the_rest_shape() {
    for mesh in [organ(), shaken_block([6, 5, 4], DVec3::new(0.15, 0.10, 0.06), 0.1, 4)] {
        let mut fixed = supports(&organ());
        if mesh.positions_m.len() != organ().positions_m.len() {
            fixed = nodes_below(&mesh, 0, 0.02).into_iter().map(FixedNode::all_axes).collect();
        }
        for attachments in [&[][..], &[ligament(&mesh)]] {
            let stress_pa =
                equilibrating_stress(&mesh, &material(), &fixed, attachments, GRAVITY_M_PER_S2).unwrap();
            let off = unbalanced(&mesh, &fixed, attachments, &stress_pa);
            assert!(off <= 1e-12, "{off:e}");
            let nothing = vec![[0.0; 6]; stress_pa.len()];
            assert!(unbalanced(&mesh, &fixed, attachments, &nothing) > 0.5);
        }
    }
}

/// A column on a table that does not hold it sideways carries just what stands above.
#[test]
fn a_column_has_the_pressure_of_what_stands_on_it() {
    let mesh = block([1, 1, 20], DVec3::new(0.01, 0.01, 0.2));
    let mut fixed: Vec<FixedNode> = nodes_below(&mesh, 2, 1e-6)
        .into_iter()
        .map(|node| FixedNode { node, axes: [false, false, true] })
        .collect();
    fixed[0].axes = [true; 3];
    fixed[1].axes = [false, true, true];
    let stress_pa = equilibrating_stress(&mesh, &material(), &fixed, &[], GRAVITY_M_PER_S2).unwrap();
    let layer_n = 1060.0 * 1e-4 * 0.01 * 9.81;
    for layer in 0..20 {
        // Each layer of six carries, on average, what is above its middle.
        let mean_pa = (0..6).map(|i| stress_pa[6 * layer + i][2]).sum::<f64>() / 6.0;
        let expected_pa = -layer_n / 1e-4 * (19.5 - layer as f64);
        assert!((mean_pa - expected_pa).abs() <= 1e-9 * layer_n / 1e-4, "{layer}: {mean_pa} {expected_pa}");
    }
}

#[test]
fn what_floats_or_does_not_exist_has_no_equilibrating_stress() {
    let mesh = organ();
    let solve = |fixed: &[FixedNode], attachments: &[Attachment], gravity: DVec3| {
        equilibrating_stress(&mesh, &material(), fixed, attachments, gravity).unwrap_err()
    };
    let fixed = supports(&mesh);
    assert!(matches!(solve(&[], &[ligament(&mesh)], GRAVITY_M_PER_S2), SolveError::Floating { .. }));
    let nowhere = Attachment { node: NodeId(100_000), ..ligament(&mesh) };
    assert!(matches!(solve(&fixed, &[nowhere], GRAVITY_M_PER_S2), SolveError::ConditionOutOfRange { .. }));
    assert!(matches!(solve(&fixed, &[], GRAVITY_M_PER_S2 * f64::NAN), SolveError::NonFiniteCondition { .. }));
}

pub(crate) const STEP_S: f64 = 2e-4;
const DENSITY_KG_PER_M3: f64 = 1060.0;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Kind {
    Linear,
    Nonlinear,
    Springs,
    Extended,
}

pub(crate) const KINDS: [Kind; 4] = [Kind::Linear, Kind::Nonlinear, Kind::Springs, Kind::Extended];

pub(crate) fn linear(body: DynamicBody<'_>) -> TensorMass {
    TensorMass::build(&TensorMassParams { body, material: &material() }).unwrap()
}

pub(crate) fn nonlinear(body: DynamicBody<'_>, largest_stretch: f64) -> NonlinearTensorMass {
    let material = material();
    let elasticity =
        NonlinearElasticity { material: &material, fibres: &[], volume_penalty_pa: 0.0, largest_stretch };
    NonlinearTensorMass::build(&NonlinearTensorMassParams { body, elasticity }).unwrap()
}

pub(crate) fn springs(body: DynamicBody<'_>) -> MassSpring {
    MassSpring::build(&MassSpringParams {
        body,
        young_modulus_pa: 5000.0,
        masses: NodalMasses::VolumeWeighted,
        link_damping_n_s_per_m: 0.0,
        node_damping_n_s_per_m: 0.0,
        integration: Integration::default(),
    })
    .unwrap()
}

pub(crate) fn extended(body: DynamicBody<'_>) -> ExtendedMassSpring {
    extended_with(body, EdgeLaw::NeoHooke)
}

pub(crate) fn extended_with(body: DynamicBody<'_>, law: EdgeLaw) -> ExtendedMassSpring {
    ExtendedMassSpring::build(&ExtendedMassSpringParams {
        body,
        law,
        material: &material(),
        viscosity_kg_per_m3_s: 0.0,
        integration: Integration::default(),
    })
    .unwrap()
}

pub(crate) fn build(kind: Kind, body: DynamicBody<'_>) -> Box<dyn DeformableModel> {
    match kind {
        Kind::Linear => Box::new(linear(body)),
        Kind::Nonlinear => Box::new(nonlinear(body, 1.3)),
        Kind::Springs => Box::new(springs(body)),
        Kind::Extended => Box::new(extended(body)),
    }
}

pub(crate) fn body(mesh: &TetMesh) -> DynamicBody<'_> {
    DynamicBody { time_step_s: STEP_S, ..DynamicBody::new(mesh, DENSITY_KG_PER_M3) }
}

pub(crate) fn displacements(model: &dyn DeformableModel, mesh: &TetMesh) -> Vec<DVec3> {
    model.state().positions_m.iter().zip(&mesh.positions_m).map(|(x, rest)| *x - *rest).collect()
}

pub(crate) fn largest(vectors: &[DVec3]) -> f64 {
    vectors.iter().map(|v| v.length()).fold(0.0, f64::max)
}

pub(crate) fn random_vector(random: &mut SeededRandom) -> DVec3 {
    DVec3::new(random.normal(), random.normal(), random.normal())
}

fn run_to_rest(model: &mut dyn DeformableModel) {
    for _ in 0..400 {
        model.step(200.0 * STEP_S);
        assert!(!model.report().energy_was_limited);
        if largest(model.state().velocities_m_per_s) < 1e-9 {
            return;
        }
    }
    panic!("no rest: {}", largest(model.state().velocities_m_per_s));
}

#[test]
fn the_loaded_rest_shape_stays_at_rest() {
    let mesh = organ();
    let fixed = supports(&mesh);
    let attachments = [ligament(&mesh)];
    let stress = equilibrating_stress(&mesh, &material(), &fixed, &attachments, GRAVITY_M_PER_S2).unwrap();
    let loaded = DynamicBody {
        fixed: &fixed,
        attachments: &attachments,
        rest_stress_pa: &stress,
        gravity_m_per_s2: GRAVITY_M_PER_S2,
        ..body(&mesh)
    };
    for kind in KINDS {
        let mut model = build(kind, loaded);
        for _ in 0..1000 {
            model.step(STEP_S);
        }
        let off_m = largest(&displacements(&*model, &mesh));
        assert!(off_m <= 1e-12 * 0.15, "{kind:?}: {off_m:e} m");
        let report = model.report();
        assert!(!report.energy_was_limited && report.n_parts == 1 && report.n_quarantined_tets == 0);
        // Without the stress it sags at once.
        let mut sagging = build(kind, DynamicBody { rest_stress_pa: &[], ..loaded });
        (0..100).for_each(|_| sagging.step(STEP_S));
        assert!(largest(&displacements(&*sagging, &mesh)) > 1e-4, "{kind:?}");
    }
}

/// The table is tilted: what changes is the static solution of the difference, with nodes that slide on their support.
#[test]
fn tilted_gravity_deforms_by_its_difference() {
    let mesh = organ();
    let fixed = supports(&mesh);
    let stress = equilibrating_stress(&mesh, &material(), &fixed, &[], GRAVITY_M_PER_S2).unwrap();
    let tilted = DVec3::new(0.5, 0.0, -9.79);
    let mut nodal_force_n = vec![DVec3::ZERO; mesh.positions_m.len()];
    add_gravity_forces(&mesh, &material(), tilted - GRAVITY_M_PER_S2, &mut nodal_force_n);
    let mut conditions = BoundaryConditions::new();
    for support in &fixed {
        for axis in (0..3).filter(|&axis| support.axes[axis]) {
            conditions.impose(support.node, axis, 0.0);
        }
    }
    let problem = StaticProblem {
        mesh: &mesh,
        material: &material(),
        conditions: &conditions,
        nodal_force_n: &nodal_force_n,
    };
    let expected = solve_static(&problem).unwrap().displacement_m;
    let loaded = DynamicBody {
        fixed: &fixed,
        rest_stress_pa: &stress,
        gravity_m_per_s2: GRAVITY_M_PER_S2,
        damping: Rayleigh::of_mass(40.0),
        ..body(&mesh)
    };
    let mut model = linear(loaded);
    model.step(STEP_S);
    model.set_gravity(tilted);
    run_to_rest(&mut model);
    let found = displacements(&model, &mesh);
    let off = relative_difference(&found, &expected);
    assert!(off < 1e-6, "{off:e}");
    let sliding = fixed.iter().filter(|f| f.axes != [true; 3]);
    assert!(sliding.clone().any(|f| found[f.node.index()].x.abs() > 1e-4));
    for support in sliding {
        assert_eq!(found[support.node.index()].z, 0.0);
    }
    // The other laws carry the same stress and differ by large rotations only; a small tilt is linear.
    let small = GRAVITY_M_PER_S2 + (tilted - GRAVITY_M_PER_S2) * 1e-3;
    for kind in [Kind::Nonlinear, Kind::Extended] {
        let mut model = build(kind, loaded);
        model.set_gravity(small);
        run_to_rest(&mut *model);
        let mut found = displacements(&*model, &mesh);
        found.iter_mut().for_each(|u| *u *= 1e3);
        // The stress at rest stiffens a little: F S0 turns with the tissue.
        let off = relative_difference(&found, &expected);
        assert!(off < 0.2, "{kind:?}: {off}");
    }
}

/// A tool that holds a sliding node bears nothing along the support.
#[test]
fn a_tool_moves_sliding_nodes_along_their_support_only() {
    let mesh = organ();
    let fixed = supports(&mesh);
    let node = fixed.iter().find(|f| f.axes == [false, false, true]).unwrap().node;
    for kind in KINDS {
        let mut model = build(kind, DynamicBody { fixed: &fixed, ..body(&mesh) });
        let displacement_m = DVec3::new(2e-3, -1e-3, 5e-3);
        let displacements_list = vec![ImposedDisplacement { node, displacement_m }];
        model.apply(&Constraints { displacements: displacements_list, forces: Vec::new() });
        (0..50).for_each(|_| model.step(STEP_S));
        let u = displacements(&*model, &mesh)[node.index()];
        assert!((u - DVec3::new(2e-3, -1e-3, 0.0)).length() < 1e-15, "{kind:?}: {u}");
        let force_n = model.constraint_forces_n()[0];
        assert!(force_n.z == 0.0 && force_n.x > 0.0, "{kind:?}: {force_n}");
    }
}

/// Removes a layer of a hanging column: what is below falls as one body with its full weight.
#[test]
fn a_piece_cut_loose_falls_with_its_full_weight() {
    let mesh = shaken_block([3, 3, 9], DVec3::new(0.05, 0.05, 0.15), 0.1, 2);
    let top: Vec<FixedNode> = (0..mesh.positions_m.len())
        .filter(|&n| mesh.positions_m[n].z > 0.145)
        .map(|n| FixedNode::all_axes(NodeId::from_index(n)))
        .collect();
    let stress = equilibrating_stress(&mesh, &material(), &top, &[], GRAVITY_M_PER_S2).unwrap();
    let middle = |t: usize| mesh.corners_m(TetId::from_index(t)).iter().map(|p| p.z).sum::<f64>() / 4.0;
    let cut: Vec<TetId> = (0..mesh.tetrahedra.len())
        .filter(|&t| (0.08..0.11).contains(&middle(t)))
        .map(TetId::from_index)
        .collect();
    let mut masses_kg = vec![0.0; mesh.positions_m.len()];
    for t in (0..mesh.tetrahedra.len()).filter(|&t| middle(t) < 0.08) {
        for node in mesh.tetrahedra[t] {
            masses_kg[node.index()] += mesh.tet_volume_m3(TetId::from_index(t));
        }
    }
    let total: f64 = masses_kg.iter().sum();
    for kind in KINDS {
        let mut model = build(
            kind,
            DynamicBody {
                fixed: &top,
                rest_stress_pa: &stress,
                gravity_m_per_s2: GRAVITY_M_PER_S2,
                ..body(&mesh)
            },
        );
        let mut editable = EditableMesh::new(mesh.clone()).unwrap();
        let change = editable.apply(&MeshEdit::Remove { tets: cut.clone() }).unwrap();
        model.topology_changed(editable.mesh(), &change).unwrap();
        for k in 1..=300 {
            model.step(STEP_S);
            assert_eq!(model.report().n_parts, 1, "{kind:?}");
            let u = displacements(&*model, &mesh);
            let fallen_m = u.iter().zip(&masses_kg).map(|(u, m)| *u * *m).sum::<DVec3>() / total;
            // The parabola of both schemes.
            let expected_m = GRAVITY_M_PER_S2 * (0.5 * STEP_S * STEP_S * f64::from(k * (k + 1)));
            let off = (fallen_m - expected_m).length() / expected_m.length();
            assert!(off <= 1e-10, "{kind:?} {k}: {off:e}");
        }
        assert!(!model.report().energy_was_limited);
        // Freed of its weight, the piece springs back: it is no rigid stone.
        let u = displacements(&*model, &mesh);
        let moving = (0..u.len()).filter(|&n| masses_kg[n] > 0.0).map(|n| u[n]);
        let spread_m = moving.clone().map(|u| u.z).fold(f64::MIN, f64::max)
            - moving.map(|u| u.z).fold(f64::MAX, f64::min);
        assert!(spread_m > 1e-4, "{kind:?}: {spread_m}");
    }
}

/// Nodes are moved, then fixed there (seed `003`, s. 3.2); the cut body relaxes.
#[test]
fn moved_nodes_fixed_in_place_hold_a_prestress() {
    let mesh = shaken_block([3, 3, 5], DVec3::new(0.05, 0.05, 0.08), 0.1, 3);
    let low = held(&nodes_below(&mesh, 2, 0.008));
    let high: Vec<NodeId> = (0..mesh.positions_m.len())
        .filter(|&n| mesh.positions_m[n].z > 0.072)
        .map(NodeId::from_index)
        .collect();
    let pulled = |node| ImposedDisplacement { node, displacement_m: DVec3::new(0.0, 0.005, 0.01) };
    let mut model = linear(DynamicBody { fixed: &low, damping: Rayleigh::of_mass(60.0), ..body(&mesh) });
    model.apply(&Constraints {
        displacements: high.iter().map(|&node| pulled(node)).collect(),
        forces: Vec::new(),
    });
    run_to_rest(&mut model);
    let pulled_m = displacements(&model, &mesh);
    high.iter().for_each(|&node| model.fix_in_place(node));
    model.apply(&Constraints::default());
    run_to_rest(&mut model);
    assert!(relative_difference(&displacements(&model, &mesh), &pulled_m) < 1e-9);
    // Cut half through: the upper part springs back where nothing pulls on it any more, the fixed nodes stay.
    let mut editable = EditableMesh::new(mesh.clone()).unwrap();
    let cut = (0..mesh.tetrahedra.len()).map(TetId::from_index).filter(|&tet| {
        let middle_m = mesh.corners_m(tet).iter().sum::<DVec3>() / 4.0;
        middle_m.x < 0.03 && (0.03..0.05).contains(&middle_m.z)
    });
    let change = editable.apply(&MeshEdit::Remove { tets: cut.collect() }).unwrap();
    model.topology_changed(editable.mesh(), &change).unwrap();
    run_to_rest(&mut model);
    let relaxed_m = displacements(&model, &mesh);
    assert!(relative_difference(&relaxed_m, &pulled_m) > 0.05);
    for node in &high {
        assert_eq!(relaxed_m[node.index()], pulled_m[node.index()]);
    }
    model.take_over(&mesh.positions_m);
    assert_eq!(displacements(&model, &mesh)[high[0].index()], pulled_m[high[0].index()]);
}

#[test]
fn ligaments_carry_a_body_that_nothing_else_holds() {
    let mesh = shaken_block([2, 2, 2], DVec3::splat(0.04), 0.1, 5);
    let weight_n = DENSITY_KG_PER_M3 * mesh.volume_m3() * 9.81;
    let top = (0..mesh.positions_m.len()).filter(|&n| mesh.positions_m[n].z > 0.036);
    let attachments: Vec<Attachment> = top
        .map(|n| Attachment {
            node: NodeId::from_index(n),
            anchor_m: mesh.positions_m[n] + DVec3::Z * 0.05,
            slack_length_m: 0.051,
            stiffness_n_per_m: 20.0,
        })
        .collect();
    assert!(attachments.len() >= 4);
    for kind in KINDS {
        let mut model = build(
            kind,
            DynamicBody {
                attachments: &attachments,
                gravity_m_per_s2: GRAVITY_M_PER_S2,
                damping: Rayleigh::of_mass(20.0),
                ..body(&mesh)
            },
        );
        for _ in 0..100 {
            model.step(200.0 * STEP_S);
            assert!(!model.report().energy_was_limited);
        }
        let x = model.state().positions_m;
        let carried_n: DVec3 = attachments.iter().map(|a| a.force_n(x[a.node.index()])).sum();
        let off_n = (carried_n - DVec3::Z * weight_n).length();
        assert!(off_n < 1e-5 * weight_n, "{kind:?}: {carried_n} {weight_n}");
    }
    let stiff: Vec<Attachment> =
        attachments.iter().map(|a| Attachment { stiffness_n_per_m: 1e7, ..*a }).collect();
    let refused = TensorMass::build(&TensorMassParams {
        body: DynamicBody { attachments: &stiff, ..body(&mesh) },
        material: &material(),
    });
    assert!(matches!(refused, Err(TensorMassError::UnstableStep { .. })));
}

/// One node that can move along one axis: a mode of its own, which decays by (d + b omega^2)/2.
#[test]
fn rayleigh_damping_decays_a_mode_as_theory_says() {
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
    let mut fixed = held(&[0, 1, 2].map(NodeId));
    fixed.push(FixedNode { node: NodeId(3), axes: [true, true, false] });
    let undamped = DynamicBody { fixed: &fixed, time_step_s: 1e-5, ..body(&mesh) };
    let model = linear(undamped);
    let omega_squared = model.vertex_tensor_n_per_m(NodeId(3)).col(2).z / model.mass_kg(NodeId(3));
    let omega = omega_squared.sqrt();
    for damping in [
        Rayleigh { mass_per_s: 20.0, stiffness_s: 0.0 },
        Rayleigh { mass_per_s: 0.0, stiffness_s: 20.0 / omega_squared },
        Rayleigh { mass_per_s: 12.0, stiffness_s: 10.0 / omega_squared },
    ] {
        let rate = damping.mass_per_s + damping.stiffness_s * omega_squared;
        for kind in [Kind::Linear, Kind::Nonlinear, Kind::Extended] {
            let mut model = build(kind, DynamicBody { damping, ..undamped });
            let mut start = mesh.positions_m.clone();
            start[3].z += 1e-7;
            model.take_over(&start);
            // Ten periods of the damped oscillation; the largest swing of the last one.
            let period_s = 2.0 * std::f64::consts::PI / (omega_squared - 0.25 * rate * rate).sqrt();
            let n_steps = (10.0 * period_s / 1e-5).round() as usize;
            let mut swing_m = 0.0_f64;
            for step in 0..n_steps {
                model.step(1e-5);
                if step as f64 > 9.5 * period_s / 1e-5 {
                    swing_m = swing_m.max(model.state().positions_m[3].z - 0.02);
                }
            }
            let expected_m = 1e-7 * (-0.5 * rate * 10.0 * period_s).exp();
            assert!(
                (swing_m / expected_m - 1.0).abs() < 0.01,
                "{kind:?} {damping:?}: {swing_m:e} {expected_m:e}"
            );
        }
    }
    assert!(omega > 100.0);
}

#[test]
fn damping_of_the_stiffness_shortens_the_stable_step_as_derived() {
    let mesh = organ();
    let fixed = supports(&mesh);
    let stable_s = TensorMass::stable_step(&mesh, &material()).unwrap().step_s;
    let b = 0.5 * stable_s;
    let expected_s = (b * b + stable_s * stable_s).sqrt() - b;
    let damped =
        DynamicBody { fixed: &fixed, damping: Rayleigh { mass_per_s: 0.0, stiffness_s: b }, ..body(&mesh) };
    let build_at = |time_step_s: f64| {
        let body = DynamicBody { time_step_s, ..damped };
        TensorMass::build(&TensorMassParams { body, material: &material() })
    };
    assert!(build_at(1.0001 * expected_s).is_err());
    let mut model = build_at(0.9999 * expected_s).unwrap();
    let mut random = SeededRandom::new(3);
    let shaken: Vec<DVec3> =
        mesh.positions_m.iter().map(|p| *p + random_vector(&mut random) * 1e-5).collect();
    model.take_over(&shaken);
    model.step(expected_s);
    let start_j = model.report().kinetic_energy_j;
    (0..4000).for_each(|_| model.step(0.9999 * expected_s));
    assert!(model.report().kinetic_energy_j < 0.1 * start_j);
}

/// One model of each kind, of the same body.
struct FourModels {
    linear: TensorMass,
    nonlinear: NonlinearTensorMass,
    springs: MassSpring,
    extended: ExtendedMassSpring,
}

impl FourModels {
    fn of(body: DynamicBody<'_>) -> Self {
        Self {
            linear: linear(body),
            nonlinear: nonlinear(body, 1.3),
            springs: springs(body),
            extended: extended(body),
        }
    }

    fn each_mut(&mut self) -> [&mut dyn DeformableModel; 4] {
        [&mut self.linear, &mut self.nonlinear, &mut self.springs, &mut self.extended]
    }
}

/// Forces of a model that was cut and of one built from what remained, both with their stress at rest.
#[test]
fn cut_models_with_a_stress_at_rest_equal_ones_built_anew() {
    let mesh = shaken_block([6, 5, 4], DVec3::new(0.12, 0.10, 0.08), 0.15, 8);
    let fixed = held(&nodes_below(&mesh, 0, 0.015));
    let stress = equilibrating_stress(&mesh, &material(), &fixed, &[], GRAVITY_M_PER_S2 * 10.0).unwrap();
    let mut cut = FourModels::of(DynamicBody { fixed: &fixed, rest_stress_pa: &stress, ..body(&mesh) });
    let mut editable = EditableMesh::new(mesh.clone()).unwrap();
    let mut random = SeededRandom::new(9);
    let mut stays = vec![true; mesh.tetrahedra.len()];
    for _ in 0..30 {
        let tets = random_live_tets(&editable, &mut random, 12);
        tets.iter().for_each(|t| stays[t.index()] = false);
        let change = editable.apply(&MeshEdit::Remove { tets }).unwrap();
        for model in cut.each_mut() {
            let count = allocation_counter::measure(|| {
                model.topology_changed(editable.mesh(), &change).unwrap();
                model.step(STEP_S);
            });
            assert_eq!(count.count_total, 0);
        }
    }
    let change = editable.compact();
    for model in cut.each_mut() {
        model.topology_changed(editable.mesh(), &change).unwrap();
        model.step(STEP_S);
    }
    let rest = editable.mesh().clone();
    let new_fixed: Vec<NodeId> = fixed.iter().filter_map(|f| change.nodes.new_ids[f.node.index()]).collect();
    let new_fixed = held(&new_fixed);
    let new_stress: Vec<RestStress> =
        stress.iter().zip(&stays).filter(|(_, stays)| **stays).map(|(s, _)| *s).collect();
    let anew_body = DynamicBody { fixed: &new_fixed, rest_stress_pa: &new_stress, ..body(&rest) };
    let mut anew = FourModels::of(anew_body);
    let u: Vec<DVec3> = (0..rest.positions_m.len()).map(|_| random_vector(&mut random) * 1e-3).collect();
    assert_same_forces(&mut cut, &mut anew, &rest, &u);
    let mut unstressed = FourModels::of(DynamicBody { rest_stress_pa: &[], ..anew_body });
    assert_stress_adds_the_same(&mut anew, &mut unstressed, &rest, &u);
}

fn nonlinear_forces(model: &mut NonlinearTensorMass, u: &[DVec3]) -> Vec<DVec3> {
    let mut force_n = vec![DVec3::ZERO; u.len()];
    model.elastic_forces_into(u, &mut force_n);
    force_n
}

fn spring_forces(model: &mut MassSpring, x: &[DVec3]) -> Vec<DVec3> {
    let v = vec![DVec3::ZERO; x.len()];
    let mut force_n = v.clone();
    model.internal_forces_into(x, &v, &mut force_n);
    force_n
}

fn extended_forces(model: &mut ExtendedMassSpring, x: &[DVec3]) -> Vec<DVec3> {
    let v = vec![DVec3::ZERO; x.len()];
    let mut force_n = v.clone();
    model.internal_forces_into(x, &v, &mut force_n);
    force_n
}

fn shifted(mesh: &TetMesh, u: &[DVec3]) -> Vec<DVec3> {
    mesh.positions_m.iter().zip(u).map(|(p, u)| *p + *u).collect()
}

fn assert_same_forces(cut: &mut FourModels, anew: &mut FourModels, rest: &TetMesh, u: &[DVec3]) {
    let close = |name: &str, found: &[DVec3], expected: &[DVec3]| {
        let off = relative_difference(found, expected);
        assert!(off <= 1e-12, "{name}: {off:e}");
    };
    let rest_force = |model: &TensorMass| -> Vec<DVec3> {
        (0..u.len()).map(|n| model.rest_force_n(NodeId::from_index(n))).collect()
    };
    let x = shifted(rest, u);
    close("linear", &rest_force(&cut.linear), &rest_force(&anew.linear));
    close("non-linear", &nonlinear_forces(&mut cut.nonlinear, u), &nonlinear_forces(&mut anew.nonlinear, u));
    close("springs", &spring_forces(&mut cut.springs, &x), &spring_forces(&mut anew.springs, &x));
    close("extended", &extended_forces(&mut cut.extended, &x), &extended_forces(&mut anew.extended, &x));
}

/// The three ways of F S0 are one: what the stress adds to the forces is the same for all laws.
fn assert_stress_adds_the_same(
    stressed: &mut FourModels,
    unstressed: &mut FourModels,
    rest: &TetMesh,
    u: &[DVec3],
) {
    let difference =
        |a: &[DVec3], b: &[DVec3]| -> Vec<DVec3> { a.iter().zip(b).map(|(a, b)| *a - *b).collect() };
    let x = shifted(rest, u);
    // Elastic forces of the non-linear model have the opposite sign.
    let expected = difference(
        &nonlinear_forces(&mut unstressed.nonlinear, u),
        &nonlinear_forces(&mut stressed.nonlinear, u),
    );
    for added in [
        difference(&spring_forces(&mut stressed.springs, &x), &spring_forces(&mut unstressed.springs, &x)),
        difference(
            &extended_forces(&mut stressed.extended, &x),
            &extended_forces(&mut unstressed.extended, &x),
        ),
    ] {
        let off = relative_difference(&added, &expected);
        assert!(off < 1e-9, "{off:e}");
    }
}

/// A run continued from a duplicate, in the middle of everything, has the same bits; steps allocate nothing.
#[test]
fn duplicates_continue_with_the_same_bits() {
    let mesh = organ();
    let fixed = supports(&mesh);
    let attachments = [ligament(&mesh)];
    let stress = equilibrating_stress(&mesh, &material(), &fixed, &attachments, GRAVITY_M_PER_S2).unwrap();
    let highest = attachments[0].node;
    for kind in KINDS {
        let mut model = build(
            kind,
            DynamicBody {
                fixed: &fixed,
                attachments: &attachments,
                rest_stress_pa: &stress,
                gravity_m_per_s2: GRAVITY_M_PER_S2,
                damping: Rayleigh { mass_per_s: 5.0, stiffness_s: 2e-5 },
                ..body(&mesh)
            },
        );
        let pushed = ImposedDisplacement { node: highest, displacement_m: DVec3::new(0.0, 0.004, -0.008) };
        model.apply(&Constraints { displacements: vec![pushed], forces: Vec::new() });
        model.set_gravity(GRAVITY_M_PER_S2 * 0.5);
        (0..37).for_each(|_| model.step(STEP_S));
        let mut twin = model.duplicate();
        let run = |model: &mut dyn DeformableModel| {
            let count = allocation_counter::measure(|| (0..100).for_each(|_| model.step(1.5 * STEP_S)));
            assert_eq!(count.count_total, 0, "{kind:?}");
            let state = model.state();
            let bits = |v: &DVec3| v.to_array().map(f64::to_bits);
            let positions: Vec<[u64; 3]> = state.positions_m.iter().map(bits).collect();
            let velocities: Vec<[u64; 3]> = state.velocities_m_per_s.iter().map(bits).collect();
            let history: Vec<u64> = model.history().iter().map(|x| x.to_bits()).collect();
            (positions, velocities, history)
        };
        assert!(run(&mut *model) == run(&mut *twin), "{kind:?}");
    }
}
