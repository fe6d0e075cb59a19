//! The pre-computed model at work: forces, held nodes and points, and contacts that change.

use crate::model_meshes::block;
use glisson_mesh::math::{DMat3, DVec3, SeededRandom};
use glisson_mesh::mesh::{NodeId, TetMesh};
use glisson_tissue::material::LinearElastic;
use glisson_tissue::model::kernel::KernelPath;
use glisson_tissue::model::precomputed::{
    PointConstraint, Precision, Precomputed, PrecomputedParams, StoredNodes,
};
use glisson_tissue::model::{Constraints, DeformableModel, ImposedDisplacement, NodalForce};
use glisson_tissue::solve::{BoundaryConditions, StaticProblem, solve_static};

struct Body {
    mesh: TetMesh,
    material: LinearElastic,
    fixed: Vec<NodeId>,
}

impl Body {
    fn new() -> Self {
        let mesh = block([5, 4, 4], DVec3::new(0.10, 0.08, 0.07));
        let material = LinearElastic::from_young_poisson(5e3, 0.45, 1060.0).unwrap();
        let fixed = (0..mesh.positions_m.len())
            .filter(|&n| mesh.positions_m[n].z < 1e-9)
            .map(NodeId::from_index)
            .collect();
        Self { mesh, material, fixed }
    }

    fn model(&self, precision: Precision) -> Precomputed {
        Precomputed::build(&PrecomputedParams {
            mesh: &self.mesh,
            material: &self.material,
            fixed_nodes: &self.fixed,
            stored: StoredNodes::All,
            precision,
            progress: None,
        })
        .unwrap()
    }
}

fn vector(random: &mut SeededRandom, length: f64) -> DVec3 {
    DVec3::new(random.normal(), random.normal(), random.normal()) * length
}

/// A whole number below `n`.
fn below(random: &mut SeededRandom, n: usize) -> usize {
    ((random.normal().abs() * 1e6) as usize) % n
}

/// A point on a triangle of loadable nodes, or a node, held along some directions.
fn any_point(random: &mut SeededRandom, nodes: &[NodeId]) -> PointConstraint {
    let mut corner = || nodes[below(random, nodes.len())];
    let nodes = [corner(), corner(), corner()];
    let displacement_m = vector(random, 1e-3);
    let point = if below(random, 3) == 0 {
        PointConstraint::node(nodes[0], displacement_m)
    } else {
        PointConstraint::on_triangle(nodes, [0.2, 0.5, 0.3], displacement_m)
    };
    match below(random, 4) {
        0 => point.along_axes([true, false, true]),
        1 => point.along(vector(random, 1.0)),
        _ => point,
    }
}

fn displacement_m(model: &Precomputed, body: &Body, node: NodeId) -> DVec3 {
    model.state().positions_m[node.index()] - body.mesh.positions_m[node.index()]
}

fn bits(values: &[DVec3]) -> Vec<[u64; 3]> {
    values.iter().map(|v| v.to_array().map(f64::to_bits)).collect()
}

#[test]
fn forces_are_summed_as_by_the_tensors_one_by_one() {
    let body = Body::new();
    let mut random = SeededRandom::new(1);
    for (precision, tolerance) in [(Precision::F64, 1e-14), (Precision::F32, 1e-14)] {
        let mut model = body.model(precision);
        for n_forces in [1, 2, 3, 4, 5, 9] {
            let mut nodes: Vec<NodeId> = (0..n_forces)
                .map(|_| model.loadable_nodes()[below(&mut random, model.loadable_nodes().len())])
                .collect();
            nodes.sort_unstable();
            nodes.dedup();
            let force = |&node: &NodeId| NodalForce { node, force_n: vector(&mut random, 0.1) };
            let forces: Vec<NodalForce> = nodes.iter().map(force).collect();
            model.apply(&Constraints { forces: forces.clone(), displacements: vec![] });
            model.step(1e-3);
            let (mut worst_m, mut largest_m) = (0.0_f64, 0.0_f64);
            for &row in model.stored_nodes() {
                let of = |f: &NodalForce| model.compliance_m_per_n(row, f.node).unwrap() * f.force_n;
                let expected_m: DVec3 = forces.iter().map(of).sum();
                largest_m = largest_m.max(expected_m.length());
                let found_m = model.point_displacement_m([row; 3], [1.0, 0.0, 0.0]).unwrap();
                worst_m = worst_m.max(found_m.distance(expected_m));
                // The position is rounded once more.
                let shown_m = displacement_m(&model, &body, row);
                assert!(shown_m.distance(expected_m) < tolerance * largest_m + 1e-16, "{row}");
            }
            assert!(worst_m < tolerance * largest_m, "{worst_m} of {largest_m}");
        }
    }
}

#[test]
fn every_path_gives_the_same_bits() {
    let body = Body::new();
    for precision in [Precision::F64, Precision::F32] {
        let mut models: Vec<Precomputed> = Vec::new();
        for path in KernelPath::available() {
            let mut model = body.model(precision);
            model.set_path(path);
            model.set_gravity(DVec3::new(0.3, -0.2, 1.0));
            models.push(model);
        }
        assert!(models.len() > 1 || !cfg!(target_arch = "x86_64"));
        let mut random = SeededRandom::new(2);
        let loadable = models[0].loadable_nodes().to_vec();
        for n_points in [0, 1, 2, 5, 9, 14] {
            let points: Vec<PointConstraint> =
                (0..n_points).map(|_| any_point(&mut random, &loadable)).collect();
            let force = NodalForce { node: loadable[3], force_n: vector(&mut random, 0.1) };
            for model in &mut models {
                model.impose_points(&points, &[force]);
                model.step(1e-3);
            }
            let (first, others) = models.split_first().unwrap();
            for other in others {
                assert_eq!(bits(other.state().positions_m), bits(first.state().positions_m));
                assert_eq!(bits(other.constraint_forces_n()), bits(first.constraint_forces_n()));
                assert_eq!(other.contact_report(), first.contact_report());
            }
        }
    }
}

/// Gaussian elimination with complete pivoting: another way to the solution.
fn eliminate(mut a: Vec<Vec<f64>>, mut b: Vec<f64>) -> Vec<f64> {
    let n = b.len();
    let mut order: Vec<usize> = (0..n).collect();
    for k in 0..n {
        let at = |a: &Vec<Vec<f64>>, i: usize, j: usize| a[i][j].abs();
        let pairs = (k..n).flat_map(|i| (k..n).map(move |j| (i, j)));
        let (i, j) = pairs.max_by(|p, q| at(&a, p.0, p.1).total_cmp(&at(&a, q.0, q.1))).unwrap();
        a.swap(k, i);
        b.swap(k, i);
        order.swap(k, j);
        a.iter_mut().for_each(|row| row.swap(k, j));
        for i in k + 1..n {
            let factor = a[i][k] / a[k][k];
            for j in k..n {
                a[i][j] -= factor * a[k][j];
            }
            b[i] -= factor * b[k];
        }
    }
    for k in (0..n).rev() {
        let known: f64 = (k + 1..n).map(|j| a[k][j] * b[j]).sum();
        b[k] = (b[k] - known) / a[k][k];
    }
    let mut x = vec![0.0; n];
    order.iter().zip(b).for_each(|(&place, value)| x[place] = value);
    x
}

#[test]
fn reactions_are_those_of_another_solver() {
    let body = Body::new();
    let mut model = body.model(Precision::F64);
    let mut random = SeededRandom::new(3);
    let loadable = model.loadable_nodes().to_vec();
    for n in [1, 2, 5, 13, 20] {
        let nodes: Vec<NodeId> = loadable.iter().copied().step_by(loadable.len() / n).take(n).collect();
        let displacements: Vec<ImposedDisplacement> = nodes
            .iter()
            .map(|&node| ImposedDisplacement { node, displacement_m: vector(&mut random, 1e-3) })
            .collect();
        let targets = displacements.iter().flat_map(|d| d.displacement_m.to_array()).collect();
        let entry = |i: usize, j: usize| {
            model.compliance_m_per_n(nodes[i / 3], nodes[j / 3]).unwrap().col(j % 3)[i % 3]
        };
        let matrix = (0..3 * n).map(|i| (0..3 * n).map(|j| entry(i, j)).collect()).collect();
        let expected = eliminate(matrix, targets);
        model.apply(&Constraints { displacements, forces: vec![] });
        model.step(1e-3);
        let found: Vec<f64> = model.constraint_forces_n().iter().flat_map(|f| f.to_array()).collect();
        let largest = expected.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
        for (found, expected) in found.iter().zip(&expected) {
            assert!((found - expected).abs() < 1e-11 * largest, "{found} {expected}");
        }
    }
}

#[test]
fn ten_thousand_changes_of_the_contacts_leave_the_factor_as_if_made_anew() {
    let body = Body::new();
    for precision in [Precision::F64, Precision::F32] {
        let mut model = body.model(precision);
        let fresh = model.clone();
        let mut random = SeededRandom::new(4);
        let loadable = model.loadable_nodes().to_vec();
        let mut points: Vec<PointConstraint> = Vec::new();
        let mut n_kept = 0;
        for change in 0..5_000 {
            let n = points.len();
            match below(&mut random, 6) {
                _ if n < 3 => points.push(any_point(&mut random, &loadable)),
                0 | 1 if n < 14 => points.push(any_point(&mut random, &loadable)),
                2 if n < 14 => points.insert(below(&mut random, n), any_point(&mut random, &loadable)),
                3 => points.swap(n / 2, n - 1),
                4 => points.iter_mut().for_each(|p| p.displacement_m += vector(&mut random, 1e-4)),
                _ => {
                    points.remove(below(&mut random, n));
                }
            }
            model.impose_points(&points, &[]);
            let found = bits(model.update_reactions());
            n_kept += model.contact_report().n_kept;
            let mut anew = if change % 20 == 0 { Some(fresh.clone()) } else { None };
            if let Some(anew) = &mut anew {
                anew.impose_points(&points, &[]);
                assert_eq!(anew.contact_report().n_kept, 0);
                assert_eq!(found, bits(anew.update_reactions()), "change {change}");
            }
        }
        assert!(n_kept > 10_000, "rows that kept their factor: {n_kept}");
    }
}

#[test]
fn points_on_triangles_are_held_where_they_are_told() {
    let body = Body::new();
    for precision in [Precision::F64, Precision::F32] {
        let mut model = body.model(precision);
        let mut random = SeededRandom::new(5);
        let loadable = model.loadable_nodes().to_vec();
        // Triangles with no node in common: all can be met.
        let corners: Vec<[NodeId; 3]> = loadable.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect();
        let force = NodalForce { node: loadable[1], force_n: DVec3::new(0.02, 0.01, 0.03) };
        for n_points in [1, 3, 10, corners.len().min(30)] {
            let points: Vec<PointConstraint> = corners[..n_points]
                .iter()
                .map(|&nodes| {
                    let weights = [0.6, 0.3, 0.1];
                    PointConstraint::on_triangle(nodes, weights, vector(&mut random, 2e-3))
                })
                .collect();
            model.impose_points(&points, &[force]);
            model.step(1e-3);
            assert_eq!(model.contact_report().n_repeated, 0);
            for point in &points {
                let found_m = model.point_displacement_m(point.nodes, point.weights).unwrap();
                let miss_m = found_m.distance(point.displacement_m);
                assert!(miss_m < 1e-12 * 2e-3, "{precision:?}, {n_points} points: {miss_m:e}");
            }
            assert!(model.contact_report().largest_miss_m < 1e-12 * 2e-3);
        }
    }
}

#[test]
fn a_point_that_slides_bears_no_force_along_its_plane() {
    let body = Body::new();
    let mut model = body.model(Precision::F64);
    let loadable = model.loadable_nodes().to_vec();
    let normal = DVec3::new(0.3, -0.5, 2.0);
    let corners = [loadable[10], loadable[11], loadable[17]];
    let weights = [0.25, 0.25, 0.5];
    let slides = PointConstraint::on_triangle(corners, weights, DVec3::new(1e-3, 0.0, -2e-3)).along(normal);
    let mixed =
        PointConstraint::node(loadable[30], DVec3::new(0.0, 5e-4, 9.0)).along_axes([true, true, false]);
    model.impose_points(&[slides, mixed], &[]);
    model.step(1e-3);
    let forces_n = model.constraint_forces_n();
    assert!(forces_n[0].cross(normal).length() < 1e-14 * forces_n[0].length());
    assert!(forces_n[0].length() > 1e-3 && forces_n[1].z == 0.0 && forces_n[1].length() > 1e-3);
    let found_m = model.point_displacement_m(corners, weights).unwrap();
    assert!((found_m - slides.displacement_m).dot(normal).abs() < 1e-15);
    let found_m = displacement_m(&model, &body, loadable[30]);
    assert!(found_m.truncate().distance(mixed.displacement_m.truncate()) < 1e-15);
    // A longer direction says the same.
    let twice = slides.along(2.0 * normal);
    let before = forces_n.to_vec();
    model.impose_points(&[twice, mixed], &[]);
    model.step(1e-3);
    assert!(model.constraint_forces_n()[0].distance(before[0]) < 1e-13 * before[0].length());
}

#[test]
fn points_that_repeat_others_exert_nothing_and_are_told() {
    let body = Body::new();
    for precision in [Precision::F64, Precision::F32] {
        let mut model = body.model(precision);
        let loadable = model.loadable_nodes().to_vec();
        let push_m = DVec3::new(1e-3, -5e-4, 2e-3);
        let node = PointConstraint::node(loadable[40], push_m);
        model.impose_points(&[node], &[]);
        model.step(1e-3);
        let alone_n = model.constraint_forces_n()[0];

        // The same node twice, agreeing.
        model.impose_points(&[node, node], &[]);
        model.step(1e-3);
        let report = model.contact_report();
        assert_eq!((report.n_rows, report.n_repeated), (6, 3));
        assert!(model.constraint_forces_n()[0].distance(alone_n) < 1e-13 * alone_n.length());
        assert_eq!(model.constraint_forces_n()[1], DVec3::ZERO);
        assert!(report.largest_miss_m < 1e-15);

        // Contradicting: the first wins, and the miss is the contradiction.
        let other = PointConstraint { displacement_m: 2.0 * push_m, ..node };
        model.impose_points(&[node, other], &[]);
        model.step(1e-3);
        assert!(model.constraint_forces_n()[0].distance(alone_n) < 1e-13 * alone_n.length());
        assert_eq!(model.constraint_forces_n()[1], DVec3::ZERO);
        assert!((model.contact_report().largest_miss_m - push_m.abs().max_element()).abs() < 1e-15);

        // Four points of one triangle that follow one affine map: the fourth follows by itself.
        let corners = [loadable[40], loadable[41], loadable[47]];
        let at = |weights: [f64; 3]| {
            let displacement_m =
                push_m * weights[0] - DVec3::Z * weights[1] * 1e-3 + DVec3::X * weights[2] * 1e-3;
            PointConstraint::on_triangle(corners, weights, displacement_m)
        };
        let four = [[0.8, 0.1, 0.1], [0.1, 0.8, 0.1], [0.2, 0.2, 0.6], [0.4, 0.3, 0.3]].map(at);
        model.impose_points(&four, &[]);
        model.step(1e-3);
        let report = model.contact_report();
        assert_eq!((report.n_rows, report.n_repeated), (12, 3), "{precision:?}");
        let tolerance_m = if precision == Precision::F64 { 1e-14 } else { 1e-9 };
        assert!(report.largest_miss_m < tolerance_m, "{precision:?} {}", report.largest_miss_m);
        assert!(model.constraint_forces_n().iter().all(|f| f.is_finite() && f.length() < 10.0));
    }
}

#[test]
fn what_cannot_be_held_is_left_out_and_told() {
    let body = Body::new();
    let mut model = body.model(Precision::F64);
    let loadable = model.loadable_nodes().to_vec();
    let inner = model.stored_nodes()[loadable.len()];
    let (a, b) = (loadable[5], loadable[6]);
    let u_m = DVec3::new(0.0, 1e-3, 0.0);
    let points = [
        PointConstraint::node(a, DVec3::new(f64::NAN, 0.0, 0.0)),
        PointConstraint::node(inner, u_m),
        PointConstraint::node(body.fixed[0], u_m),
        PointConstraint::node(NodeId(999_999), u_m),
        PointConstraint::on_triangle([a, b, a], [f64::INFINITY, 0.0, 0.0], u_m),
        PointConstraint::node(a, u_m).along_axes([false; 3]),
        // A fixed corner does not move: the others do it all.
        PointConstraint::on_triangle([a, body.fixed[0], b], [0.25, 0.5, 0.25], u_m),
    ];
    model.impose_points(&points, &[NodalForce { node: inner, force_n: u_m }]);
    model.step(1e-3);
    assert_eq!(model.response_report().ignored_displacements, 6);
    assert_eq!(model.response_report().ignored_forces, 1);
    assert_eq!(model.report().n_ignored_constraints, 7);
    assert!(model.constraint_forces_n()[..6].iter().all(|f| *f == DVec3::ZERO));
    assert!(model.constraint_forces_n()[6].y > 1e-3);
    let found_m = 0.25 * (displacement_m(&model, &body, a) + displacement_m(&model, &body, b));
    assert!(found_m.distance(u_m) < 1e-15);
    // More points than there is room for.
    let many: Vec<PointConstraint> =
        (0..80).map(|i| PointConstraint::node(loadable[i % loadable.len()], u_m)).collect();
    model.impose_points(&many, &[]);
    model.step(1e-3);
    assert_eq!(model.response_report().ignored_displacements, 80 - Precomputed::MAX_IMPOSED);
    assert!(model.state().positions_m.iter().all(|p| p.is_finite()));
}

#[test]
fn held_points_and_reactions_are_those_of_the_static_solver() {
    let body = Body::new();
    let mut model = body.model(Precision::F64);
    let loadable = model.loadable_nodes().to_vec();
    let corners = [loadable[20], loadable[21], loadable[27]];
    let weights = [0.5, 0.2, 0.3];
    let points = [
        PointConstraint::on_triangle(corners, weights, DVec3::new(2e-3, 1e-3, -3e-3)),
        PointConstraint::node(loadable[50], DVec3::new(0.0, -1e-3, 1e-3)),
    ];
    let force = NodalForce { node: loadable[60], force_n: DVec3::new(0.01, 0.05, -0.02) };
    model.impose_points(&points, &[force]);
    model.step(1e-3);
    let mut nodal_force_n = vec![DVec3::ZERO; body.mesh.positions_m.len()];
    nodal_force_n[force.node.index()] += force.force_n;
    for (point, reaction_n) in points.iter().zip(model.constraint_forces_n()) {
        for (node, weight) in point.nodes.iter().zip(point.weights) {
            nodal_force_n[node.index()] += *reaction_n * weight;
        }
    }
    let solution = solve_static(&StaticProblem {
        mesh: &body.mesh,
        material: &body.material,
        conditions: &BoundaryConditions::fixed(&body.fixed),
        nodal_force_n: &nodal_force_n,
    })
    .unwrap();
    let largest_m = solution.displacement_m.iter().map(|u| u.length()).fold(0.0, f64::max);
    for &node in model.stored_nodes() {
        let off_m = displacement_m(&model, &body, node).distance(solution.displacement_m[node.index()]);
        assert!(off_m < 1e-12 * largest_m, "{off_m:e}");
    }
}

#[test]
fn reactions_without_a_step_are_those_of_the_step() {
    let body = Body::new();
    let mut model = body.model(Precision::F64);
    model.set_gravity(DVec3::new(1.0, 2.0, -3.0));
    let loadable = model.loadable_nodes().to_vec();
    let points: Vec<PointConstraint> =
        loadable.iter().step_by(7).map(|&n| PointConstraint::node(n, DVec3::new(1e-3, 0.0, 1e-3))).collect();
    let force = NodalForce { node: loadable[60], force_n: DVec3::new(0.01, 0.05, -0.02) };
    model.impose_points(&points, &[force]);
    let before = model.state().positions_m.to_vec();
    let forces_n = model.update_reactions().to_vec();
    assert_eq!(model.state().positions_m, before);
    model.step(1e-3);
    let largest_n = forces_n.iter().map(|f| f.length()).fold(0.0, f64::max);
    for (without, with) in forces_n.iter().zip(model.constraint_forces_n()) {
        assert!(without.distance(*with) < 1e-10 * largest_n, "{without} {with}");
    }
}

#[test]
fn a_copy_goes_on_with_the_same_bits() {
    let body = Body::new();
    let mut model = body.model(Precision::F64);
    let mut random = SeededRandom::new(9);
    let loadable = model.loadable_nodes().to_vec();
    let mut points: Vec<PointConstraint> = (0..6).map(|_| any_point(&mut random, &loadable)).collect();
    model.impose_points(&points, &[]);
    model.step(1e-3);
    let mut copy = model.duplicate();
    points.remove(2);
    let nodes: Vec<ImposedDisplacement> = loadable
        .iter()
        .step_by(9)
        .map(|&node| ImposedDisplacement { node, displacement_m: vector(&mut random, 1e-3) })
        .collect();
    let constraints = Constraints { displacements: nodes, forces: vec![] };
    for model in [&mut model as &mut dyn DeformableModel, &mut *copy] {
        model.step(1e-3);
        model.apply(&constraints);
        model.step(1e-3);
    }
    assert_eq!(bits(copy.state().positions_m), bits(model.state().positions_m));
    assert_eq!(bits(copy.constraint_forces_n()), bits(model.constraint_forces_n()));
}

#[test]
fn the_compliance_is_symmetric() {
    let body = Body::new();
    let model = body.model(Precision::F64);
    let (mut worst, mut largest) = (0.0_f64, 0.0_f64);
    let size = |m: DMat3| m.to_cols_array().into_iter().fold(0.0_f64, |s, x| s.max(x.abs()));
    for &a in model.loadable_nodes() {
        for &b in model.loadable_nodes() {
            let [there, back] = [(a, b), (b, a)].map(|(a, b)| model.compliance_m_per_n(a, b).unwrap());
            worst = worst.max(size(there - back.transpose()));
            largest = largest.max(size(there));
        }
    }
    assert!(worst < 1e-12 * largest, "{:e}", worst / largest);
}

#[test]
fn steps_with_changing_contacts_allocate_nothing_in_the_model_and_its_copies() {
    let body = Body::new();
    let mut random = SeededRandom::new(11);
    let model = body.model(Precision::F64);
    let loadable = model.loadable_nodes().to_vec();
    let points: Vec<PointConstraint> = (0..20).map(|_| any_point(&mut random, &loadable)).collect();
    let forces: Vec<NodalForce> =
        loadable.iter().map(|&node| NodalForce { node, force_n: vector(&mut random, 0.01) }).collect();
    for mut model in [model.clone(), model] {
        let count = allocation_counter::measure(|| {
            for n in [1, 20, 3, 7, 0, 12] {
                model.impose_points(&points[..n], &forces[..2 * n]);
                model.step(1e-3);
                model.impose_points(&points[n / 2..], &forces);
                model.update_reactions();
            }
        });
        assert_eq!(count.count_total, 0);
    }
}
