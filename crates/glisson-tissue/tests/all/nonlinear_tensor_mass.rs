//! The non-linear tensor-mass model against the definition of its energy, reference solutions, the linear model,
//! and models built anew after removals.

use std::path::{Path, PathBuf};

use glisson_mesh::math::{DMat3, DVec3, SeededRandom};
use glisson_mesh::mesh::edit::{EditableMesh, MeshEdit};
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};
use glisson_tissue::material::LinearElastic;
use glisson_tissue::model::nonlinear_tensor_mass::{
    DirectBody, Fibre, FibreError, NonlinearElasticity, NonlinearPart, NonlinearTensorMass,
    NonlinearTensorMassError, NonlinearTensorMassParams, TetLaw,
};
use glisson_tissue::model::tensor_mass::{TensorMass, TensorMassError, TensorMassParams};
use glisson_tissue::model::{Constraints, DeformableModel, DynamicBody, ImposedDisplacement, Rayleigh};
use glisson_tissue::solve::add_gravity_forces;
use glisson_tissue::solve::case::{parse_vectors, read_case};
use proptest::prelude::*;

use crate::model_meshes::{block, held, nodes_below, random_live_tets, relative_difference, shaken_block};

fn material() -> LinearElastic {
    LinearElastic::from_young_poisson(5000.0, 0.45, 1060.0).unwrap()
}

fn normal(random: &mut SeededRandom) -> DVec3 {
    DVec3::new(random.normal(), random.normal(), random.normal())
}

/// A random fibre a tetrahedron, some softer than the rest.
fn fibres(mesh: &TetMesh, seed: u64) -> Vec<Fibre> {
    let mut random = SeededRandom::new(seed);
    let material = material();
    let fibre = |_| Fibre {
        lambda_along_pa: material.lambda_pa() * random.uniform_in(0.95, 1.5),
        mu_along_pa: material.mu_pa() * random.uniform_in(1.0, 4.0),
        direction: normal(&mut random).normalize(),
    };
    (0..mesh.tetrahedra.len()).map(fibre).collect()
}

/// A model with the largest step; `elasticity` tells fibres and penalty.
fn model(mesh: &TetMesh, fixed_nodes: &[NodeId], elasticity: NonlinearElasticity<'_>) -> NonlinearTensorMass {
    let stable = NonlinearTensorMass::stable_step(mesh, &elasticity).unwrap();
    NonlinearTensorMass::build(&NonlinearTensorMassParams {
        body: DynamicBody {
            fixed: &held(fixed_nodes),
            damping: Rayleigh::of_mass(0.0),
            time_step_s: stable.step_s,
            ..DynamicBody::new(mesh, elasticity.material.density_kg_per_m3())
        },
        elasticity,
    })
    .unwrap()
}

fn isotropic(material: &LinearElastic) -> NonlinearElasticity<'_> {
    NonlinearElasticity { material, fibres: &[], volume_penalty_pa: 0.0, largest_stretch: 1.0 }
}

fn forces(model: &mut NonlinearTensorMass, u_m: &[DVec3]) -> Vec<DVec3> {
    let mut force_n = vec![DVec3::ZERO; u_m.len()];
    model.elastic_forces_into(u_m, &mut force_n);
    force_n
}

/// Bodies of each kind of physics, with the definition to compare with.
fn each_kind(mesh: &TetMesh, check: impl Fn(&str, &mut NonlinearTensorMass, &DirectBody<'_>)) {
    let (material, fibres) = (material(), fibres(mesh, 4));
    for (name, fibres, volume_penalty_pa) in
        [("isotropic", &[][..], 0.0), ("fibres", &fibres, 0.0), ("penalty", &[], 2e4), ("both", &fibres, 2e4)]
    {
        let elasticity =
            NonlinearElasticity { material: &material, fibres, volume_penalty_pa, largest_stretch: 1.0 };
        let laws = elasticity.laws(mesh.tetrahedra.len()).unwrap();
        let direct = DirectBody { mesh, laws: &laws, gamma_pa: volume_penalty_pa };
        check(name, &mut model(mesh, &[], elasticity), &direct);
    }
}

/// A random displacement of every node, up to tetrahedra turned inside out, after a random motion of the whole.
fn displaced(mesh: &TetMesh, size_m: f64, seed: u64) -> Vec<DVec3> {
    let mut random = SeededRandom::new(seed);
    let axis = normal(&mut random).normalize();
    let rotation = DMat3::from_axis_angle(axis, random.uniform_in(0.0, 3.0));
    let shift_m = normal(&mut random) * 0.05;
    mesh.positions_m.iter().map(|&p| rotation * (p + normal(&mut random) * size_m) + shift_m - p).collect()
}

#[test]
fn forces_and_energy_are_those_of_the_definition() {
    let mesh = shaken_block([4, 3, 2], DVec3::new(0.1, 0.06, 0.05), 0.15, 1);
    each_kind(&mesh, |name, model, direct| {
        for seed in 0..6 {
            let u_m = displaced(&mesh, 0.002 * seed as f64 + 0.001, seed);
            let mut expected = vec![DVec3::ZERO; u_m.len()];
            direct.forces_into(&u_m, &mut expected);
            let off = relative_difference(&forces(model, &u_m), &expected);
            assert!(off <= 1e-10, "{name} {seed}: {off:e}");
            let (energy_j, expected_j) = (model.elastic_energy_at_j(&u_m), direct.energy_j(&u_m));
            // Terms of the fourth power of the rigid motion cancel in the polynomial, so digits are lost.
            assert!((energy_j - expected_j).abs() <= 1e-8 * expected_j, "{name}: {energy_j} {expected_j}");
        }
    });
}

#[test]
fn forces_are_the_derivative_of_the_energy() {
    let mesh = shaken_block([3, 2, 2], DVec3::new(0.1, 0.06, 0.05), 0.15, 2);
    each_kind(&mesh, |name, model, _| {
        let mut random = SeededRandom::new(9);
        let u_m: Vec<DVec3> = mesh.positions_m.iter().map(|_| normal(&mut random) * 0.004).collect();
        let force_n = forces(model, &u_m);
        for _ in 0..8 {
            let way: Vec<DVec3> = u_m.iter().map(|_| normal(&mut random)).collect();
            let energy_j = |h_m: f64| {
                let there: Vec<DVec3> = u_m.iter().zip(&way).map(|(u, w)| *u + *w * h_m).collect();
                model.elastic_energy_at_j(&there)
            };
            // The five-point formula is exact for the polynomial of order four; the penalty is none.
            let h_m = if name == "isotropic" || name == "fibres" { 1e-3 } else { 1e-5 };
            let by_energy = (8.0 * (energy_j(h_m) - energy_j(-h_m)) - energy_j(2.0 * h_m)
                + energy_j(-2.0 * h_m))
                / (12.0 * h_m);
            let by_force: f64 = force_n.iter().zip(&way).map(|(f, w)| f.dot(*w)).sum();
            let size: f64 = force_n.iter().zip(&way).map(|(f, w)| f.length() * w.length()).sum();
            let tolerance = if h_m == 1e-3 { 1e-11 } else { 1e-7 };
            assert!((by_energy - by_force).abs() <= tolerance * size, "{name}: {by_energy} {by_force}");
        }
    });
}

#[test]
fn a_moved_body_has_no_force_and_a_turned_one_turned_forces() {
    let mesh = shaken_block([3, 3, 2], DVec3::new(0.1, 0.08, 0.05), 0.15, 3);
    each_kind(&mesh, |name, model, _| {
        let mut random = SeededRandom::new(1);
        let bent: Vec<DVec3> = mesh.positions_m.iter().map(|&p| p + normal(&mut random) * 0.003).collect();
        let of = |model: &mut NonlinearTensorMass, place: &dyn Fn(usize) -> DVec3| {
            let u_m: Vec<DVec3> = mesh.positions_m.iter().enumerate().map(|(n, &p)| place(n) - p).collect();
            forces(model, &u_m)
        };
        let unturned = of(model, &|n| bent[n]);
        let largest_n = unturned.iter().map(|f| f.length()).fold(0.0, f64::max);
        for angle in [0.3, 1.5, 3.1] {
            let rotation = DMat3::from_axis_angle(normal(&mut random).normalize(), angle);
            let shift_m = normal(&mut random) * 0.1;
            let rigid = of(model, &|n| rotation * mesh.positions_m[n] + shift_m);
            let force_n = rigid.iter().map(|f| f.length()).fold(0.0, f64::max);
            assert!(force_n <= 1e-10 * largest_n, "{name}: {force_n:e} of {largest_n:e}");
            let turned = of(model, &|n| rotation * bent[n] + shift_m);
            let expected: Vec<DVec3> = unturned.iter().map(|f| rotation * *f).collect();
            let off = relative_difference(&turned, &expected);
            assert!(off <= 1e-10, "{name}: {off:e}");
        }
    });
}

#[test]
fn all_24_node_orders_give_the_same_force() {
    let p_m = [
        DVec3::new(0.001, 0.0, -0.002),
        DVec3::new(0.012, 0.001, 0.0),
        DVec3::new(0.002, 0.011, 0.001),
        DVec3::new(0.0, 0.002, 0.009),
    ];
    let mut random = SeededRandom::new(3);
    let u_m: [DVec3; 4] = std::array::from_fn(|_| normal(&mut random) * 0.004);
    let fibre = Fibre {
        lambda_along_pa: 2.0 * material().lambda_pa(),
        mu_along_pa: 3.0 * material().mu_pa(),
        direction: DVec3::new(1.0, 2.0, -0.5).normalize(),
    };
    let material = material();
    let elasticity = NonlinearElasticity {
        material: &material,
        fibres: &[fibre],
        volume_penalty_pa: 1e4,
        largest_stretch: 1.0,
    };
    let mut reference: Option<[DVec3; 4]> = None;
    let mut n_orders = 0;
    for code in 0..256_usize {
        let order = [code & 3, (code >> 2) & 3, (code >> 4) & 3, (code >> 6) & 3];
        if (0..4).any(|i| !order.contains(&i)) {
            continue;
        }
        // Numbering by `order`; the corners are listed in each orientation-preserving way.
        let positions_m: Vec<DVec3> = order.iter().map(|&i| p_m[i]).collect();
        let number = |i: usize| NodeId::from_index(order.iter().position(|&o| o == i).unwrap());
        let displacement_m: Vec<DVec3> = order.iter().map(|&i| u_m[i]).collect();
        for corners in [[0, 1, 2, 3], [1, 0, 3, 2], [2, 3, 0, 1], [0, 2, 3, 1], [3, 0, 2, 1], [1, 2, 0, 3]] {
            let mesh = TetMesh {
                positions_m: positions_m.clone(),
                tetrahedra: vec![corners.map(number)],
                ..TetMesh::default()
            };
            assert!(mesh.tet_volume_m3(TetId(0)) > 0.0);
            let found = forces(&mut model(&mesh, &[], elasticity), &displacement_m);
            let found: [DVec3; 4] = std::array::from_fn(|i| found[number(i).index()]);
            let expected = reference.get_or_insert(found);
            let off = relative_difference(&found, &expected[..]);
            assert!(off <= 1e-12, "{order:?} {corners:?}: {off:e}");
        }
        n_orders += 1;
    }
    assert_eq!(n_orders, 24);
}

fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/reference").join(name)
}

#[test]
fn reference_solutions_are_in_balance() {
    for name in ["beam", "cylinder", "patch"] {
        let case = read_case(&folder(name)).unwrap();
        let vectors = |file: &str| {
            let file = folder(name).join(file);
            parse_vectors(&file, &std::fs::read(&file).unwrap()).unwrap()
        };
        let u_m = vectors("u_np_stvk.csv");
        let mut balance = forces(&mut model(&case.mesh, &[], isotropic(&case.material)), &u_m);
        let mut weight_n = vec![DVec3::ZERO; u_m.len()];
        add_gravity_forces(&case.mesh, &case.material, case.gravity_m_per_s2, &mut weight_n);
        balance.iter_mut().zip(&weight_n).for_each(|(f, w)| *f -= *w);
        let off = relative_difference(&balance, &vectors("reactions_np_stvk.csv"));
        assert!(off <= 1e-6, "{name}: {off:e}");
    }
}

/// Every accumulated number: tensors and numbers of vertices, edges, triangles, each kind apart. The scalars of
/// tetrahedra are apart from the 280.
fn numbers(model: &NonlinearTensorMass, n_nodes: usize) -> [Vec<f64>; 3] {
    let [mut b, mut c, mut d] = [const { Vec::new() }; 3];
    for n in (0..n_nodes).map(NodeId::from_index) {
        let (tensor, numbers) = model.vertex_stiffness(n);
        b.extend(tensor.to_cols_array());
        c.extend(numbers.c.to_array());
        d.push(numbers.d);
    }
    for (_, tensor, numbers) in model.edge_stiffness() {
        b.extend(tensor.to_cols_array());
        c.extend(numbers.c.iter().flat_map(|c| c.to_array()));
        d.extend(numbers.d);
    }
    for (_, numbers) in model.triangle_stiffness() {
        c.extend(numbers.c.iter().flat_map(|c| c.to_array()));
        d.extend(numbers.d.as_flattened());
    }
    [b, c, d]
}

#[test]
fn one_removal_changes_280_numbers() {
    let mesh = shaken_block([3, 3, 3], DVec3::splat(0.06), 0.15, 5);
    let fibres = fibres(&mesh, 1);
    let material = material();
    let mut model = model(&mesh, &[], NonlinearElasticity { fibres: &fibres, ..isotropic(&material) });
    let mut editable = EditableMesh::new(mesh.clone()).unwrap();
    // One whose triangles all have another tetrahedron: nothing is left alone.
    let topology = editable.topology();
    let inner =
        topology.live_tets().find(|&t| topology.tet_neighbours(t).iter().all(|n| !n.is_none())).unwrap();
    let before = numbers(&model, mesh.positions_m.len());
    let change = editable.apply(&MeshEdit::Remove { tets: vec![inner] }).unwrap();
    model.topology_changed(editable.mesh(), &change).unwrap();
    let after = numbers(&model, mesh.positions_m.len());
    let changed = before.iter().flatten().zip(after.iter().flatten()).filter(|(a, b)| a != b).count();
    assert_eq!(changed, 280);
    assert_eq!(model.tet_scalars(inner), Default::default());
}

/// Largest difference of two models' numbers on the same nodes, each kind over its largest entry; numbers that only
/// the first has must be exactly zero.
fn model_difference(found: &NonlinearTensorMass, expected: &NonlinearTensorMass, n_nodes: usize) -> f64 {
    use std::collections::BTreeMap;
    let mut found_lists = [const { Vec::<f64>::new() }; 3];
    let mut expected_lists = found_lists.clone();
    let mut push = |kind: usize, a: &[f64], b: Option<&[f64]>| {
        if b.is_none() {
            assert!(a.iter().all(|x| *x == 0.0), "what has no tetrahedron is exactly zero");
        }
        found_lists[kind].extend(a);
        expected_lists[kind].extend(b.map_or(vec![0.0; a.len()], |b| b.to_vec()));
    };
    let flat = |c: &[DVec3]| c.iter().flat_map(|c| c.to_array()).collect::<Vec<f64>>();
    for n in (0..n_nodes).map(NodeId::from_index) {
        let ((b, x), (expected_b, y)) = (found.vertex_stiffness(n), expected.vertex_stiffness(n));
        push(0, &b.to_cols_array(), Some(&expected_b.to_cols_array()));
        push(1, &x.c.to_array(), Some(&y.c.to_array()));
        push(2, &[x.d], Some(&[y.d]));
    }
    let edges: BTreeMap<_, _> = expected.edge_stiffness().map(|(nodes, b, x)| (nodes, (b, x))).collect();
    for (nodes, b, x) in found.edge_stiffness() {
        let other = edges.get(&nodes);
        push(0, &b.to_cols_array(), other.map(|(b, _)| b.to_cols_array()).as_ref().map(|b| &b[..]));
        push(1, &flat(&x.c), other.map(|(_, y)| flat(&y.c)).as_deref());
        push(2, &x.d, other.map(|(_, y)| &y.d[..]));
    }
    let triangles: BTreeMap<_, _> = expected.triangle_stiffness().collect();
    for (nodes, x) in found.triangle_stiffness() {
        let other = triangles.get(&nodes);
        push(1, &flat(&x.c), other.map(|y| flat(&y.c)).as_deref());
        push(2, x.d.as_flattened(), other.map(|y| y.d.as_flattened()));
    }
    let largest = |values: &[f64]| values.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
    (0..3).fold(0.0, |off: f64, kind| {
        let (a, b) = (&found_lists[kind], &expected_lists[kind]);
        let differences: Vec<f64> = a.iter().zip(b).map(|(a, b)| a - b).collect();
        off.max(largest(&differences) / largest(b))
    })
}

/// Removes at most `n_batches` batches of tetrahedra, never the last ones, with a step after each.
fn cut_at_random(
    model: &mut NonlinearTensorMass,
    editable: &mut EditableMesh,
    random: &mut SeededRandom,
    n_batches: usize,
) {
    for _ in 0..n_batches {
        // All around a node go together at times: that node is left alone.
        let tets = if random.uniform() < 0.3 {
            let node = editable.topology().live_nodes().nth(5).unwrap();
            let mut tets = editable.topology().node_tets(node).to_vec();
            tets.sort_unstable();
            tets
        } else {
            random_live_tets(editable, random, 9)
        };
        if tets.len() == editable.topology().live_tets().count() {
            break;
        }
        let change = editable.apply(&MeshEdit::Remove { tets }).unwrap();
        model.topology_changed(editable.mesh(), &change).unwrap();
        model.step(0.002);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn removals_equal_a_model_of_the_remaining_mesh(seed in any::<u64>(), n_batches in 1usize..8) {
        let mesh = shaken_block([3, 3, 2], DVec3::new(0.09, 0.08, 0.05), 0.15, 7);
        let fixed = nodes_below(&mesh, 0, 0.012);
        let (fibres, material) = (fibres(&mesh, 2), material());
        let elasticity = NonlinearElasticity {
            material: &material, fibres: &fibres, volume_penalty_pa: 1e4, largest_stretch: 1.0,
        };
        let mut cut = model(&mesh, &fixed, elasticity);
        cut.set_nonlinear_part(NonlinearPart::AboveErrorBound { tolerance_n: 1e-6 });
        let mut editable = EditableMesh::new(mesh.clone()).unwrap();
        cut_at_random(&mut cut, &mut editable, &mut SeededRandom::new(seed), n_batches);
        let remaining: Vec<TetId> = editable.topology().live_tets().collect();
        let mesh_left = TetMesh {
            positions_m: mesh.positions_m.clone(),
            tetrahedra: remaining.iter().map(|&t| mesh.tetrahedra[t.index()]).collect(),
            ..TetMesh::default()
        };
        let fibres_left: Vec<Fibre> = remaining.iter().map(|t| fibres[t.index()]).collect();
        let mut fresh = model(&mesh_left, &fixed, NonlinearElasticity { fibres: &fibres_left, ..elasticity });
        let off = model_difference(&cut, &fresh, mesh.positions_m.len());
        prop_assert!(off <= 1e-12, "{off:e}");
        for n in (0..mesh.positions_m.len()).map(NodeId::from_index) {
            prop_assert!((cut.mass_kg(n) - fresh.mass_kg(n)).abs() <= 1e-15);
        }
        // Bounds follow too: the same nodes are non-linear.
        let u_m = displaced(&mesh, 1e-3, 3);
        fresh.set_nonlinear_part(NonlinearPart::AboveErrorBound { tolerance_n: 0.02 });
        cut.set_nonlinear_part(NonlinearPart::AboveErrorBound { tolerance_n: 0.02 });
        let off = relative_difference(&forces(&mut cut, &u_m), &forces(&mut fresh, &u_m));
        prop_assert!(off <= 1e-10, "{off:e}");
        prop_assert_eq!(cut.adaptive_report().n_nonlinear, fresh.adaptive_report().n_nonlinear);

        let change = editable.compact();
        cut.topology_changed(editable.mesh(), &change).unwrap();
        let fixed: Vec<NodeId> = fixed
            .iter()
            .filter_map(|n| if change.nodes.new_ids.is_empty() { Some(*n) } else { change.nodes.new_ids[n.index()] })
            .collect();
        let elasticity = NonlinearElasticity { fibres: &fibres_left, ..elasticity };
        let fresh = model(editable.mesh(), &fixed, elasticity);
        let off = model_difference(&cut, &fresh, editable.mesh().positions_m.len());
        prop_assert!(off <= 1e-12, "{off:e}");
        for _ in 0..5 {
            cut.step(0.002);
        }
        prop_assert!(cut.state().positions_m.iter().all(|p| p.is_finite()));
    }
}

#[test]
fn small_displacements_are_those_of_the_linear_model() {
    let mesh = shaken_block([4, 3, 2], DVec3::new(0.1, 0.06, 0.05), 0.15, 1);
    let fixed = nodes_below(&mesh, 0, 0.012);
    let material = material();
    let mut nonlinear = model(&mesh, &fixed, isotropic(&material));
    let mut linear = TensorMass::build(&TensorMassParams {
        body: DynamicBody {
            fixed: &held(&fixed),
            damping: Rayleigh::of_mass(0.0),
            time_step_s: nonlinear.time_step_s(),
            ..DynamicBody::new(&mesh, material.density_kg_per_m3())
        },
        material: &material,
    })
    .unwrap();
    assert_eq!(linear.stable_step_s(), nonlinear.stable_step_s());
    let mut random = SeededRandom::new(2);
    let start: Vec<DVec3> = mesh.positions_m.iter().map(|&p| p + normal(&mut random) * 1e-9).collect();
    let difference = |nonlinear: &mut NonlinearTensorMass, linear: &mut TensorMass| {
        nonlinear.take_over(&start);
        linear.take_over(&start);
        for _ in 0..50 {
            nonlinear.step(0.001);
            linear.step(0.001);
        }
        let u = |x: &[DVec3]| x.iter().zip(&mesh.positions_m).map(|(x, p)| *x - *p).collect::<Vec<_>>();
        relative_difference(&u(nonlinear.state().positions_m), &u(linear.state().positions_m))
    };
    let off = difference(&mut nonlinear, &mut linear);
    assert!(off > 0.0 && off <= 1e-5, "{off:e}");
    // With an infinite threshold it is the linear model, to the last bit.
    nonlinear.set_nonlinear_part(NonlinearPart::AboveDisplacement { threshold_m: f64::INFINITY });
    assert_eq!(difference(&mut nonlinear, &mut linear), 0.0);
    assert_eq!(nonlinear.adaptive_report().n_nonlinear, 0);
}

#[test]
fn adaptive_forces_are_as_wrong_as_reported_at_most() {
    let mesh = shaken_block([8, 3, 3], DVec3::new(0.3, 0.1, 0.1), 0.15, 6);
    let material = material();
    let mut body = model(&mesh, &[], isotropic(&material));
    // Bent at one end only.
    let mut random = SeededRandom::new(1);
    let u_m: Vec<DVec3> = mesh
        .positions_m
        .iter()
        .map(|p| {
            let s = p.x / 0.3;
            DVec3::new(0.0, 0.08 * s * s * s, 0.0) + normal(&mut random) * 2e-4 * s * s * s
        })
        .collect();
    let full = forces(&mut body, &u_m);
    assert_eq!(body.adaptive_report().nonlinear_share(), 1.0);
    // The full force takes an order of magnitude more operations than its linear part.
    let operations = body.operation_counts();
    let ratio = (operations.linear + operations.nonlinear) as f64 / operations.linear as f64;
    assert!(ratio > 10.0 && ratio < 15.0, "{operations:?}");
    let mut shares = Vec::new();
    for tolerance_n in [1e-5, 1e-3, 1e-2, 0.1] {
        body.set_nonlinear_part(NonlinearPart::AboveErrorBound { tolerance_n });
        let found = forces(&mut body, &u_m);
        let report = body.adaptive_report();
        let bound_n = report.force_error_bound_n.unwrap();
        assert!(bound_n <= tolerance_n);
        let errors: Vec<f64> = found.iter().zip(&full).map(|(a, b)| (*a - *b).length()).collect();
        let largest_n = errors.iter().copied().fold(0.0, f64::max);
        assert!(largest_n <= bound_n + 1e-12, "{largest_n:e} {bound_n:e}");
        assert!(errors.iter().sum::<f64>() <= report.summed_error_bound_n.unwrap() + 1e-12);
        for (n, error_n) in errors.iter().enumerate() {
            assert!(!body.is_nonlinear(NodeId::from_index(n)) || *error_n <= 1e-12);
        }
        shares.push(report.nonlinear_share());
    }
    assert!(shares.is_sorted_by(|a, b| a >= b) && shares[0] > shares[3], "{shares:?}");

    // The threshold of the report: everything displaced by more than it.
    body.set_nonlinear_part(NonlinearPart::AboveDisplacement { threshold_m: 0.01 });
    forces(&mut body, &u_m);
    let expected = u_m.iter().filter(|u| u.length() > 0.01).count();
    assert_eq!(body.adaptive_report().n_nonlinear, expected);
    assert_eq!(body.adaptive_report().force_error_bound_n, None);

    // A translation is no reason to be non-linear by error, and is one by displacement.
    let far: Vec<DVec3> = u_m.iter().map(|_| DVec3::splat(0.05)).collect();
    forces(&mut body, &far);
    assert_eq!(body.adaptive_report().nonlinear_share(), 1.0);
    body.set_nonlinear_part(NonlinearPart::AboveErrorBound { tolerance_n: 1e-9 });
    forces(&mut body, &far);
    assert_eq!(body.adaptive_report().n_nonlinear, 0);
}

#[test]
fn energy_stays_and_an_unstable_step_is_refused() {
    let mesh = shaken_block([5, 3, 3], DVec3::new(0.1, 0.06, 0.05), 0.15, 11);
    let fixed = nodes_below(&mesh, 0, 0.012);
    let (fibres, material) = (fibres(&mesh, 8), material());
    let elasticity = NonlinearElasticity {
        material: &material,
        fibres: &fibres,
        volume_penalty_pa: 5e3,
        largest_stretch: 1.3,
    };
    let mut body = model(&mesh, &fixed, elasticity);
    assert!(NonlinearElasticity { largest_stretch: 1.0, ..elasticity }.laws(3).is_err());
    let at_rest = NonlinearElasticity { largest_stretch: 1.0, ..elasticity };
    let h_s = body.time_step_s();
    assert!(h_s < NonlinearTensorMass::stable_step(&mesh, &at_rest).unwrap().step_s);
    // Bent by a third of its length.
    let start: Vec<DVec3> =
        mesh.positions_m.iter().map(|p| *p + DVec3::new(0.0, 3.0 * p.x * p.x, 0.0)).collect();
    body.take_over(&start);
    body.step(h_s);
    let energy_j = body.energy_j();
    assert!(energy_j > 0.0);
    for _ in 0..1500 {
        body.step(h_s);
        assert!((body.energy_j() - energy_j).abs() <= 0.02 * energy_j, "{} {energy_j}", body.energy_j());
    }

    let params = NonlinearTensorMassParams {
        body: DynamicBody {
            fixed: &held(&fixed),
            damping: Rayleigh::of_mass(0.0),
            time_step_s: 1.0001 * h_s,
            ..DynamicBody::new(&mesh, elasticity.material.density_kg_per_m3())
        },
        elasticity,
    };
    let refusal = NonlinearTensorMass::build(&params).unwrap_err();
    assert!(matches!(
        refusal,
        NonlinearTensorMassError::Explicit(TensorMassError::UnstableStep { allowed_s, .. }) if allowed_s == h_s
    ));
    let refused = |elasticity: NonlinearElasticity<'_>| {
        NonlinearTensorMass::build(&NonlinearTensorMassParams {
            body: DynamicBody { time_step_s: h_s, ..params.body },
            elasticity,
        })
        .unwrap_err()
    };
    let few = refused(NonlinearElasticity { fibres: &fibres[1..], ..elasticity });
    assert!(matches!(few, NonlinearTensorMassError::Fibre(FibreError::Count { .. })));
    let mut bad = fibres.clone();
    bad[17].direction *= 2.0;
    let long = refused(NonlinearElasticity { fibres: &bad, ..elasticity });
    assert!(
        matches!(long, NonlinearTensorMassError::Fibre(FibreError::Impossible { tet: TetId(17), .. })),
        "{long}"
    );
    let negative = refused(NonlinearElasticity { volume_penalty_pa: -1.0, ..elasticity });
    assert!(matches!(negative, NonlinearTensorMassError::Explicit(TensorMassError::Parameter { .. })));
}

/// A beam held at one end, and a node at the other end that a tool holds away from its place.
fn bent_beam() -> (TetMesh, Vec<NodeId>, ImposedDisplacement) {
    let mesh = shaken_block([5, 2, 2], DVec3::new(0.1, 0.04, 0.04), 0.1, 12);
    let fixed = nodes_below(&mesh, 0, 0.012);
    let far = (0..mesh.positions_m.len())
        .max_by(|&a, &b| mesh.positions_m[a].x.total_cmp(&mesh.positions_m[b].x))
        .unwrap();
    let held = ImposedDisplacement {
        node: NodeId::from_index(far),
        displacement_m: DVec3::new(-0.002, 0.012, 0.004),
    };
    (mesh, fixed, held)
}

/// The model of [`bent_beam`] with the tool in place, at rest otherwise.
fn bent_model(mesh: &TetMesh, fixed: &[NodeId], tool: ImposedDisplacement) -> NonlinearTensorMass {
    let material = material();
    let elasticity = NonlinearElasticity { largest_stretch: 1.5, ..isotropic(&material) };
    let stable = NonlinearTensorMass::stable_step(mesh, &elasticity).unwrap();
    let mut model = NonlinearTensorMass::build(&NonlinearTensorMassParams {
        body: DynamicBody {
            fixed: &held(fixed),
            damping: Rayleigh::of_mass(60.0),
            time_step_s: stable.step_s,
            ..DynamicBody::new(mesh, elasticity.material.density_kg_per_m3())
        },
        elasticity,
    })
    .unwrap();
    model.apply(&Constraints { displacements: vec![tool], forces: Vec::new() });
    model
}

#[test]
fn held_nodes_report_the_force_that_holds_them() {
    let (mesh, fixed, held) = bent_beam();
    let far = held.node.index();
    let mut body = bent_model(&mesh, &fixed, held);
    for _ in 0..250 {
        body.step(0.01);
    }
    let u_m: Vec<DVec3> =
        body.state().positions_m.iter().zip(&mesh.positions_m).map(|(x, p)| *x - *p).collect();
    assert!((u_m[far] - held.displacement_m).length() <= 1e-15);
    // At rest all other free nodes are in balance by the definition, and the held one by the reported force.
    let laws = vec![TetLaw::isotropic(&material()); mesh.tetrahedra.len()];
    let mut force_n = vec![DVec3::ZERO; u_m.len()];
    DirectBody { mesh: &mesh, laws: &laws, gamma_pa: 0.0 }.forces_into(&u_m, &mut force_n);
    let reaction_n = body.constraint_forces_n()[0];
    assert!(reaction_n.length() > 0.01);
    assert_eq!(body.report().n_quarantined_tets, 0);
    assert!(
        (force_n[far] - reaction_n).length() <= 1e-6 * reaction_n.length(),
        "{} {reaction_n}",
        force_n[far]
    );
    for n in (0..u_m.len()).filter(|n| *n != far && !fixed.contains(&NodeId::from_index(*n))) {
        assert!(force_n[n].length() <= 1e-6 * reaction_n.length(), "{n}: {}", force_n[n]);
    }
}

#[test]
fn snapshots_come_back_and_runs_repeat_to_the_last_bit() {
    let (mesh, fixed, held) = bent_beam();
    let bits =
        |body: &NonlinearTensorMass| -> Vec<u64> { body.history().iter().map(|x| x.to_bits()).collect() };
    let run = |body: &mut NonlinearTensorMass| {
        (0..7).for_each(|_| body.step(0.01));
        bits(body)
    };
    let mut a = bent_model(&mesh, &fixed, held);
    run(&mut a);
    let snapshot = a.snapshot();
    let first = run(&mut a);
    a.restore(&snapshot);
    assert_eq!(run(&mut a), first);
    let mut b = bent_model(&mesh, &fixed, held);
    run(&mut b);
    assert_eq!(run(&mut b), first);
}

#[test]
fn stretched_tetrahedra_are_torn_and_moved_nodes_refused() {
    let mesh = block([6, 2, 2], DVec3::new(0.12, 0.04, 0.04));
    let material = material();
    let mut body = model(&mesh, &[], isotropic(&material));
    let mut torn = Vec::with_capacity(mesh.tetrahedra.len());
    body.tetrahedra_torn_into(1.01, &mut torn);
    assert!(torn.is_empty());
    // Cells between x = 0.04 and 0.06 are drawn out by a half; the body is turned besides.
    let rotation = DMat3::from_rotation_z(1.0);
    let drawn: Vec<DVec3> = mesh
        .positions_m
        .iter()
        .map(|p| rotation * (*p + DVec3::X * 0.5 * (p.x - 0.04).clamp(0.0, 0.02)))
        .collect();
    body.take_over(&drawn);
    body.tetrahedra_torn_into(1.51, &mut torn);
    assert!(torn.is_empty());
    body.tetrahedra_torn_into(1.49, &mut torn);
    assert_eq!(torn.len(), 4 * 6);
    for tet in &torn {
        let x: f64 = mesh.corners_m(*tet).iter().map(|p| p.x).sum::<f64>() / 4.0;
        assert!(x > 0.04 && x < 0.06, "{x}");
    }
    // Removed, they are no longer listed, and the body is in two pieces at rest.
    let mut editable = EditableMesh::new(mesh.clone()).unwrap();
    let change = editable.apply(&MeshEdit::Remove { tets: torn.clone() }).unwrap();
    body.topology_changed(editable.mesh(), &change).unwrap();
    body.tetrahedra_torn_into(1.49, &mut torn);
    assert!(torn.is_empty());
    assert!(body.elastic_energy_j() <= 1e-14, "{}", body.elastic_energy_j());
}
