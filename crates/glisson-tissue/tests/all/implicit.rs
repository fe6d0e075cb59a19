//! Implicit Euler: exact motions, the static limit, momentum, inversion, removal, same bits.

use std::path::{Path, PathBuf};

use glisson_mesh::math::{DMat3, DVec3, SeededRandom, tetrahedron_volume_m3};
use glisson_mesh::mesh::edit::{EditableMesh, MeshEdit};
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};
use glisson_tissue::material::{LinearElastic, StableNeoHooke};
use glisson_tissue::model::implicit::{
    ImplicitEuler, ImplicitLaw, ImplicitParams, ImplicitReport, ImplicitStatus, VolumeResistance,
};
use glisson_tissue::model::{
    Constraints, DeformableModel, DynamicBody, FixedNode, ImposedDisplacement, LevelOfDetail, NodalForce,
    Rayleigh,
};
use glisson_tissue::solve::case::{StaticCase, parse_vectors, read_case};
use glisson_tissue::solve::{
    BoundaryConditions, NodeAveraging, StaticProblem, boundary_nodes, solve_static_node_averaged,
};

use crate::model_meshes::{block, nodes_below, relative_difference, shaken_block};

const VOLUMES: [VolumeResistance; 3] =
    [VolumeResistance::Element, VolumeResistance::NodeAveraged, VolumeResistance::NodeAveragedStrain];

fn soft(poisson_ratio: f64) -> LinearElastic {
    LinearElastic::from_young_poisson(5000.0, poisson_ratio, 1000.0).unwrap()
}

/// Without supports, loads and damping, at 10 ms, to a tight tolerance.
pub(crate) fn tight<'a>(body: DynamicBody<'a>, law: &'a ImplicitLaw) -> ImplicitParams<'a> {
    ImplicitParams { tolerance: 1e-10, ..ImplicitParams::new(body, law) }
}

pub(crate) fn body<'a>(mesh: &'a TetMesh, fixed: &'a [FixedNode]) -> DynamicBody<'a> {
    DynamicBody { fixed, time_step_s: 0.01, ..DynamicBody::new(mesh, 1000.0) }
}

pub(crate) fn clamped(nodes: &[NodeId]) -> Vec<FixedNode> {
    nodes.iter().map(|&node| FixedNode::all_axes(node)).collect()
}

pub(crate) fn bits(model: &dyn DeformableModel) -> Vec<u64> {
    let state = model.state();
    let vectors = state.positions_m.iter().chain(state.velocities_m_per_s);
    vectors.flat_map(|v| v.to_array()).chain(model.history()).map(f64::to_bits).collect()
}

fn assert_upright(mesh: &TetMesh, positions_m: &[DVec3]) {
    for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
        let volume_m3 = tetrahedron_volume_m3(nodes.map(|n| positions_m[n.index()]));
        assert!(volume_m3 > 0.0, "tetrahedron {t} has {volume_m3} m3");
    }
}

#[test]
fn an_unloaded_body_keeps_its_bits_and_a_free_one_falls_exactly() {
    let mesh = shaken_block([3, 3, 2], DVec3::new(0.1, 0.08, 0.06), 0.2, 1);
    let law = ImplicitLaw::neo_hooke(&soft(0.45));
    for volume in VOLUMES {
        let fixed = clamped(&[NodeId(0)]);
        let mut rests =
            ImplicitEuler::build(&ImplicitParams { volume, ..tight(body(&mesh, &fixed), &law) }).unwrap();
        for _ in 0..5 {
            rests.step(0.01);
        }
        assert_eq!(rests.state().positions_m, &mesh.positions_m[..]);
        assert_eq!(rests.step_report().status, ImplicitStatus::Converged);

        let g = DVec3::new(0.0, 1.0, -9.81);
        let mut falls = ImplicitEuler::build(&ImplicitParams {
            volume,
            ..tight(DynamicBody { gravity_m_per_s2: g, ..body(&mesh, &[]) }, &law)
        })
        .unwrap();
        let h = 0.01;
        for step in 1..=20 {
            falls.step(h);
            assert_eq!(falls.step_report().status, ImplicitStatus::Converged);
            // v = n h g, x = h^2 g n (n + 1)/2.
            let n = f64::from(step);
            let expected_m = g * (h * h * n * (n + 1.0) / 2.0);
            for u in falls.displacements_m() {
                assert!((*u - expected_m).length() <= 1e-8 * expected_m.length(), "{u} {expected_m}");
            }
        }
    }
}

/// A corner tetrahedron with one free node along z: omega^2 = 4 (lambda + 2 mu)/(rho a^2).
#[test]
fn a_single_node_decays_as_implicit_euler_must() {
    let a = 0.1;
    let mesh = TetMesh {
        positions_m: vec![DVec3::ZERO, DVec3::X * a, DVec3::Y * a, DVec3::Z * a],
        tetrahedra: vec![[0, 1, 2, 3].map(NodeId)],
        ..TetMesh::default()
    };
    let material = soft(0.3);
    let law = ImplicitLaw::neo_hooke(&material);
    let fixed = clamped(&[0, 1, 2].map(NodeId));
    let (alpha, beta, h) = (2.0, 0.003, 0.01);
    let mut model = ImplicitEuler::build(&tight(
        DynamicBody { damping: Rayleigh { mass_per_s: alpha, stiffness_s: beta }, ..body(&mesh, &fixed) },
        &law,
    ))
    .unwrap();
    let omega2 = 4.0 * (material.lambda_pa() + 2.0 * material.mu_pa()) / (1000.0 * a * a);
    let mut u = 1e-7;
    let mut v = 0.0;
    let mut start = mesh.positions_m.clone();
    start[3].z += u;
    model.take_over(&start);
    for _ in 0..30 {
        model.step(h);
        // (u' - u - h v)/h^2 + (alpha + beta w^2)(u' - u)/h + w^2 u' = 0
        let damping = alpha + beta * omega2;
        let next = (u / (h * h) + v / h + damping * u / h) / (1.0 / (h * h) + damping / h + omega2);
        v = (next - u) / h;
        u = next;
        let found = model.displacements_m()[3].z;
        assert!((found - u).abs() <= 2e-6 * 1e-7, "{found} {u}");
    }
}

fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/reference").join(name)
}

fn reference(name: &str, file: &str) -> Vec<DVec3> {
    let file = folder(name).join(file);
    parse_vectors(&file, &std::fs::read(&file).unwrap()).unwrap()
}

/// The case as a model: nodes prescribed at zero are fixed, the others held.
fn model_of(case: &StaticCase) -> (ImplicitEuler, Constraints) {
    let mut of_node: std::collections::BTreeMap<NodeId, DVec3> = std::collections::BTreeMap::new();
    for (node, axis, value) in case.conditions.iter() {
        of_node.entry(node).or_default()[axis] = value;
    }
    let fixed: Vec<NodeId> = of_node.iter().filter(|(_, u)| **u == DVec3::ZERO).map(|(n, _)| *n).collect();
    let displacements = of_node
        .iter()
        .filter(|(_, u)| **u != DVec3::ZERO)
        .map(|(&node, &displacement_m)| ImposedDisplacement { node, displacement_m })
        .collect();
    let model = ImplicitEuler::build(&tight(
        DynamicBody {
            density_kg_per_m3: case.material.density_kg_per_m3(),
            gravity_m_per_s2: case.gravity_m_per_s2,
            damping: Rayleigh { mass_per_s: 2.0, stiffness_s: 0.0 },
            time_step_s: 1.0,
            ..body(&case.mesh, &clamped(&fixed))
        },
        &ImplicitLaw::neo_hooke(&case.material),
    ))
    .unwrap();
    (model, Constraints { displacements, forces: Vec::new() })
}

/// Our own static Newton solution to a residual of 1e-9.
#[test]
fn damped_time_stepping_ends_in_the_static_solution() {
    for (name, n_steps) in [("cylinder", 10), ("beam", 16)] {
        let case = read_case(&folder(name)).unwrap();
        let (mut model, constraints) = model_of(&case);
        model.apply(&constraints);
        for _ in 0..n_steps {
            model.step(1.0);
            assert_eq!(
                model.step_report().status,
                ImplicitStatus::Converged,
                "{name}: {:?}",
                model.step_report()
            );
        }
        let u = relative_difference(model.displacements_m(), &reference(name, "u_np_nh.csv"));
        assert!(u < 1e-6, "{name}: displacement off by {u:e}");
        let mut supports_n = vec![DVec3::ZERO; case.mesh.positions_m.len()];
        for (node, axis, _) in case.conditions.iter() {
            supports_n[node.index()][axis] = model.support_forces_n()[node.index()][axis];
        }
        let r = relative_difference(&supports_n, &reference(name, "reactions_np_nh.csv"));
        assert!(r < 1e-6, "{name}: reactions off by {r:e}");
        if name == "cylinder" {
            let top_n: f64 = model.constraint_forces_n().iter().map(|f| f.x).sum();
            assert!((top_n - 0.136074).abs() < 1e-6, "{top_n}");
        }
    }
}

#[test]
fn a_free_body_keeps_its_momentum_and_loses_energy() {
    let mesh = shaken_block([4, 3, 2], DVec3::new(0.12, 0.08, 0.06), 0.2, 3);
    let law = ImplicitLaw::neo_hooke(&soft(0.45));
    let mut model = ImplicitEuler::build(&tight(body(&mesh, &[]), &law)).unwrap();
    // Turning, bending and flying.
    let velocities: Vec<DVec3> = mesh
        .positions_m
        .iter()
        .map(|&p| {
            DVec3::new(0.3, -0.1, 0.2)
                + DVec3::new(0.0, 1.0, 2.0).cross(p)
                + DVec3::Z * (0.2 * libm::sin(40.0 * p.x))
        })
        .collect();
    model.set_velocities(&velocities);
    let momentum = |model: &ImplicitEuler| -> DVec3 {
        let v = model.state().velocities_m_per_s;
        (0..v.len()).map(|n| v[n] * model.mass_kg(NodeId::from_index(n))).sum()
    };
    let (before, mut energy_j) = (momentum(&model), model.energy_j());
    for _ in 0..50 {
        model.step(0.01);
        assert_eq!(model.step_report().status, ImplicitStatus::Converged);
        let now_j = model.energy_j();
        assert!(now_j <= energy_j * (1.0 + 1e-9), "{now_j} after {energy_j}");
        energy_j = now_j;
    }
    let change = (momentum(&model) - before).length();
    assert!(change <= 1e-8 * before.length(), "{change} of {before}");
}

/// Whatever a hand did to it: steps that stop before they converge gain no energy either.
#[test]
fn a_body_that_was_torn_about_loses_energy_at_any_level_of_detail() {
    let mesh = shaken_block([4, 3, 2], DVec3::new(0.12, 0.08, 0.06), 0.2, 3);
    let fixed = clamped(&nodes_below(&mesh, 2, 1e-6));
    for law in
        [ImplicitLaw::neo_hooke(&soft(0.45)), ImplicitLaw::StableNeoHooke(StableNeoHooke::from(&soft(0.45)))]
    {
        for level in [LevelOfDetail::Full, LevelOfDetail::Least] {
            let mut model = ImplicitEuler::build(&ImplicitParams::new(body(&mesh, &fixed), &law)).unwrap();
            model.set_level_of_detail(level);
            let mut random = SeededRandom::new(5);
            let fast = |_: &DVec3| DVec3::new(random.normal(), random.normal(), random.normal()) * 200.0;
            let velocities: Vec<DVec3> = mesh.positions_m.iter().map(fast).collect();
            model.set_velocities(&velocities);
            let (mut energy_j, mut n_missed) = (model.energy_j(), 0);
            for step in 0..60 {
                model.step(0.01);
                n_missed += u32::from(model.report().missed_tolerance);
                let now_j = model.energy_j();
                assert!(now_j <= energy_j * (1.0 + 1e-6), "{level:?} {step}: {now_j} after {energy_j}");
                energy_j = now_j;
            }
            assert!(n_missed > 0 || level == LevelOfDetail::Full, "the test tests nothing");
        }
    }
}

/// Held nodes that move, a load, then a release.
fn palpation(model: &mut ImplicitEuler, touched: &[NodeId], steps: std::ops::Range<usize>) {
    for step in steps {
        let depth_m = 0.004 * libm::sin(0.2 * step as f64).max(0.0);
        let held = if step % 40 < 25 { touched } else { &[] };
        model.apply(&Constraints {
            displacements: held
                .iter()
                .map(|&node| ImposedDisplacement { node, displacement_m: DVec3::Z * -depth_m })
                .collect(),
            forces: vec![NodalForce { node: NodeId(7), force_n: DVec3::X * 0.01 }],
        });
        model.step(0.01);
        assert_eq!(
            model.step_report().status,
            ImplicitStatus::Converged,
            "{step}: {:?}",
            model.step_report()
        );
    }
}

#[test]
fn steps_have_the_same_bits_twice_and_after_a_restored_snapshot() {
    let mesh = shaken_block([5, 4, 3], DVec3::new(0.12, 0.08, 0.06), 0.15, 5);
    let law = ImplicitLaw::neo_hooke(&soft(0.49));
    let fixed = clamped(&nodes_below(&mesh, 2, 0.01));
    let touched: Vec<NodeId> = (0..mesh.positions_m.len())
        .filter(|&n| mesh.positions_m[n].z > 0.05 && mesh.positions_m[n].x > 0.07)
        .map(NodeId::from_index)
        .filter(|&n| n != NodeId(7))
        .collect();
    assert!(touched.len() > 2 && fixed.iter().all(|f| f.node != NodeId(7)));
    let build = || {
        ImplicitEuler::build(&ImplicitParams {
            tolerance: 1e-3,
            ..tight(
                DynamicBody {
                    damping: Rayleigh { mass_per_s: 0.0, stiffness_s: 0.001 },
                    ..body(&mesh, &fixed)
                },
                &law,
            )
        })
        .unwrap()
    };
    let (mut first, mut second) = (build(), build());
    palpation(&mut first, &touched, 0..60);
    palpation(&mut second, &touched, 0..60);
    assert_eq!(bits(&first), bits(&second));
    let snapshot = first.snapshot();
    palpation(&mut first, &touched, 60..100);
    let expected = bits(&first);
    let mut fresh = build();
    fresh.restore(&snapshot);
    palpation(&mut fresh, &touched, 60..100);
    assert_eq!(bits(&fresh), expected);
}

#[test]
fn every_step_of_a_moving_load_reaches_the_tolerance() {
    let mesh = shaken_block([6, 5, 4], DVec3::new(0.2, 0.15, 0.1), 0.15, 2);
    let fixed = clamped(&nodes_below(&mesh, 2, 0.01));
    for (poisson_ratio, volume) in [
        (0.45, VolumeResistance::Element),
        (0.49, VolumeResistance::Element),
        (0.49, VolumeResistance::NodeAveraged),
        (0.49, VolumeResistance::NodeAveragedStrain),
    ] {
        let law = ImplicitLaw::neo_hooke(&soft(poisson_ratio));
        let mut model = ImplicitEuler::build(&ImplicitParams {
            volume,
            tolerance: 1e-3,
            ..tight(body(&mesh, &fixed), &law)
        })
        .unwrap();
        let top: Vec<NodeId> = (0..mesh.positions_m.len())
            .filter(|&n| mesh.positions_m[n].z > 0.08)
            .map(NodeId::from_index)
            .collect();
        let mut iterations = 0;
        for step in 0..60 {
            let node = top[step / 4 % top.len()];
            model.apply(&Constraints {
                displacements: Vec::new(),
                forces: vec![NodalForce { node, force_n: DVec3::new(0.1, 0.0, -0.3) }],
            });
            model.step(0.01);
            let ImplicitReport { status, residual_share, cg_iterations, .. } = *model.step_report();
            assert!(
                status == ImplicitStatus::Converged && residual_share <= 1e-3,
                "{:?}",
                model.step_report()
            );
            iterations += cg_iterations;
        }
        assert!(iterations < 60 * 40, "{poisson_ratio} {volume:?}: {iterations} iterations in 60 steps");
        assert_upright(&mesh, model.state().positions_m);
    }
}

#[test]
fn a_push_that_would_turn_tetrahedra_inside_out_leaves_all_upright() {
    let mesh = block([4, 4, 4], DVec3::splat(0.1));
    let law = ImplicitLaw::neo_hooke(&soft(0.45));
    let fixed = clamped(&nodes_below(&mesh, 2, 0.01));
    let mut model =
        ImplicitEuler::build(&ImplicitParams { tolerance: 1e-3, ..tight(body(&mesh, &fixed), &law) })
            .unwrap();
    // The middle of the top goes through the fixed bottom in one step: impossible.
    let middle = NodeId::from_index(
        (0..mesh.positions_m.len())
            .find(|&n| mesh.positions_m[n].distance(DVec3::new(0.05, 0.05, 0.1)) < 1e-9)
            .unwrap(),
    );
    model.apply(&Constraints {
        displacements: vec![ImposedDisplacement { node: middle, displacement_m: DVec3::Z * -0.15 }],
        forces: Vec::new(),
    });
    model.step(0.01);
    assert_eq!(model.step_report().status, ImplicitStatus::HeldNodesStopped);
    assert!(model.step_report().held_share < 1.0);
    assert_upright(&mesh, model.state().positions_m);
    // Released, it comes back.
    model.apply(&Constraints::default());
    for _ in 0..100 {
        model.step(0.05);
        assert_upright(&mesh, model.state().positions_m);
    }
    let off_m = model.displacements_m().iter().map(|u| u.length()).fold(0.0, f64::max);
    assert!(off_m < 1e-4, "{off_m}");
}

#[test]
fn after_removals_it_is_the_model_of_the_remaining_mesh() {
    let mesh = shaken_block([4, 3, 3], DVec3::new(0.12, 0.08, 0.06), 0.15, 9);
    let law = ImplicitLaw::neo_hooke(&soft(0.45));
    let fixed = clamped(&nodes_below(&mesh, 0, 0.02));
    let mut editable = EditableMesh::new(mesh.clone()).unwrap();
    let g = DVec3::new(0.0, 0.0, -9.81);
    let mut cut =
        ImplicitEuler::build(&tight(DynamicBody { gravity_m_per_s2: g, ..body(&mesh, &fixed) }, &law))
            .unwrap();
    // Every tetrahedron between two planes goes: the far piece is cut loose.
    let between: Vec<TetId> = (0..mesh.tetrahedra.len())
        .map(TetId::from_index)
        .filter(|&t| mesh.corners_m(t).iter().any(|p| (0.055..0.07).contains(&p.x)))
        .collect();
    let change = editable.apply(&MeshEdit::Remove { tets: between }).unwrap();
    cut.topology_changed(editable.mesh(), &change).unwrap();
    let change = editable.compact();
    cut.topology_changed(editable.mesh(), &change).unwrap();
    let rest = editable.mesh().clone();
    let fixed_of_rest = clamped(&nodes_below(&rest, 0, 0.02));
    let mut built = ImplicitEuler::build(&tight(
        DynamicBody { gravity_m_per_s2: g, ..body(&rest, &fixed_of_rest) },
        &law,
    ))
    .unwrap();
    for _ in 0..10 {
        cut.step(0.01);
        built.step(0.01);
        assert_eq!(cut.step_report().status, ImplicitStatus::Converged);
        assert_eq!(bits(&cut), bits(&built));
    }
    // The loose piece falls with its full weight.
    let fallen_m = g * (0.01 * 0.01 * 55.0);
    let far = (0..rest.positions_m.len()).filter(|&n| rest.positions_m[n].x > 0.07);
    for n in far {
        assert!((cut.displacements_m()[n] - fallen_m).length() < 1e-6 * fallen_m.length());
    }
}

/// Affine displacement of the boundary: affine inside, with both volume terms.
#[test]
fn the_non_linear_patch_test_is_passed() {
    let gradient = DMat3::from_cols(
        DVec3::new(0.05, 0.0, 0.02),
        DVec3::new(0.1, -0.03, 0.0),
        DVec3::new(0.0, 0.04, 0.06),
    );
    let mesh = shaken_block([4, 4, 3], DVec3::new(0.1, 0.08, 0.06), 0.15, 4);
    let law = ImplicitLaw::neo_hooke(&soft(0.49));
    let boundary = boundary_nodes(&mesh);
    for volume in VOLUMES {
        let mut model =
            ImplicitEuler::build(&ImplicitParams { volume, ..tight(body(&mesh, &[]), &law) }).unwrap();
        let displacements = boundary
            .iter()
            .map(|&node| ImposedDisplacement {
                node,
                displacement_m: gradient * mesh.positions_m[node.index()],
            })
            .collect();
        model.apply(&Constraints { displacements, forces: Vec::new() });
        for _ in 0..20 {
            model.step(10.0);
        }
        for (u, &p) in model.displacements_m().iter().zip(&mesh.positions_m) {
            assert!((*u - gradient * p).length() <= 1e-10 * 0.01, "{volume:?}: {u} at {p}");
        }
    }
}

/// A small load: the linear solution with node-averaged pressure or strain.
#[test]
fn node_averaging_has_the_linear_limit() {
    let mesh = shaken_block([5, 3, 3], DVec3::new(0.1, 0.06, 0.06), 0.1, 6);
    let material = soft(0.499);
    let fixed = nodes_below(&mesh, 0, 0.008);
    let tip = NodeId::from_index(
        (0..mesh.positions_m.len())
            .max_by(|&a, &b| mesh.positions_m[a].x.total_cmp(&mesh.positions_m[b].x))
            .unwrap(),
    );
    let mut nodal_force_n = vec![DVec3::ZERO; mesh.positions_m.len()];
    nodal_force_n[tip.index()] = DVec3::new(0.0, 0.0, 1e-7);
    let law = ImplicitLaw::neo_hooke(&material);
    let conditions = BoundaryConditions::fixed(&fixed);
    let fixed = clamped(&fixed);
    for (volume, averaging) in [
        (VolumeResistance::NodeAveraged, NodeAveraging::PRESSURE),
        (VolumeResistance::NodeAveragedStrain, NodeAveraging::STRAIN),
    ] {
        let expected = solve_static_node_averaged(
            &StaticProblem {
                mesh: &mesh,
                material: &material,
                conditions: &conditions,
                nodal_force_n: &nodal_force_n,
            },
            averaging,
        )
        .unwrap();
        let mut model = ImplicitEuler::build(&ImplicitParams {
            volume,
            tolerance: 1e-8,
            ..ImplicitParams::new(DynamicBody { time_step_s: 5.0, ..body(&mesh, &fixed) }, &law)
        })
        .unwrap();
        model.apply(&Constraints {
            displacements: Vec::new(),
            forces: vec![NodalForce { node: tip, force_n: nodal_force_n[tip.index()] }],
        });
        for _ in 0..15 {
            model.step(5.0);
        }
        let off = relative_difference(model.displacements_m(), &expected.displacement_m);
        assert!(off < 1e-4, "{volume:?}: {off:e}");
    }
}
