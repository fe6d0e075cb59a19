//! Patch tests: an affine displacement on the boundary must come out affine inside, to rounding, on any mesh.

use glisson_mesh::math::{DMat3, DVec3};
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};
use glisson_tissue::material::LinearElastic;
use glisson_tissue::solve::{BoundaryConditions, SolveError, StaticProblem, boundary_nodes, solve_static};

use crate::model_meshes::{block, rounded_block, shaken_block};

const GRADIENT: DMat3 =
    DMat3::from_cols(DVec3::new(0.05, 0.0, 0.02), DVec3::new(0.1, -0.03, 0.0), DVec3::new(0.0, 0.04, 0.06));
const SHIFT_M: DVec3 = DVec3::new(0.003, -0.001, 0.002);

fn check(mesh: &TetMesh, poisson_ratio: f64) {
    let material = LinearElastic::from_young_poisson(5000.0, poisson_ratio, 1000.0).unwrap();
    let expected: Vec<DVec3> = mesh.positions_m.iter().map(|&p| GRADIENT * p + SHIFT_M).collect();
    let mut conditions = BoundaryConditions::new();
    let boundary = boundary_nodes(mesh);
    assert!(boundary.len() < mesh.positions_m.len(), "there are inner nodes");
    for &node in &boundary {
        conditions.impose_node(node, expected[node.index()]);
    }
    let nodal_force_n = vec![DVec3::ZERO; mesh.positions_m.len()];
    let solution = solve_static(&StaticProblem {
        mesh,
        material: &material,
        conditions: &conditions,
        nodal_force_n: &nodal_force_n,
    })
    .unwrap();
    let largest = expected.iter().map(|u| u.length()).fold(0.0, f64::max);
    for (found, expected) in solution.displacement_m.iter().zip(&expected) {
        assert!((*found - *expected).length() <= 1e-12 * largest, "{found} {expected}");
    }
    // The reactions balance each other: no force and no moment from nowhere.
    let largest_n = solution.reaction_n.iter().map(|f| f.length()).fold(0.0, f64::max);
    let force: DVec3 = solution.reaction_n.iter().sum();
    assert!(force.length() <= 1e-10 * largest_n, "{force}");
    let moment: DVec3 = solution.reaction_n.iter().zip(&mesh.positions_m).map(|(f, x)| x.cross(*f)).sum();
    assert!(moment.length() <= 1e-10 * largest_n, "{moment}");
}

#[test]
fn patch_of_a_shaken_and_renumbered_block() {
    let mesh = shaken_block([5, 4, 3], DVec3::new(0.1, 0.06, 0.05), 0.2, 7);
    check(&mesh, 0.45);
    check(&mesh, 0.0);
    check(&mesh, -0.5);
}

#[test]
fn patch_of_a_rounded_body_nearly_incompressible() {
    check(&rounded_block([6, 5, 4], DVec3::new(0.28, 0.16, 0.08)), 0.499);
}

fn refusal(mesh: &TetMesh, conditions: &BoundaryConditions) -> SolveError {
    let material = LinearElastic::from_young_poisson(5000.0, 0.3, 1000.0).unwrap();
    let nodal_force_n = vec![DVec3::ZERO; mesh.positions_m.len()];
    let problem = StaticProblem { mesh, material: &material, conditions, nodal_force_n: &nodal_force_n };
    solve_static(&problem).unwrap_err()
}

#[test]
fn what_has_no_solution_is_refused_with_the_reason() {
    let cube = block([2, 2, 2], DVec3::ONE);
    let fixed = BoundaryConditions::fixed(&[0, 1, 3].map(NodeId));
    let none = BoundaryConditions::new();

    assert!(matches!(refusal(&cube, &none), SolveError::Floating { rigid_modes: 6, .. }));

    // Two pieces, one of them held.
    let mut two = cube.clone();
    let n = NodeId::from_index(cube.positions_m.len());
    two.positions_m.extend(cube.positions_m.iter().map(|p| *p + 5.0 * DVec3::X));
    two.tetrahedra.extend(cube.tetrahedra.iter().map(|t| t.map(|m| NodeId(m.0 + n.0))));
    let found = refusal(&two, &fixed);
    assert!(matches!(found, SolveError::Floating { node, rigid_modes: 6, .. } if node == n), "{found}");

    // The second piece hangs on one shared vertex: a hinge.
    let mut hinge = two.clone();
    let last_of_first = NodeId(n.0 - 1);
    for tet in hinge.tetrahedra.iter_mut().flatten().filter(|m| **m == n) {
        *tet = last_of_first;
    }
    for (place, p) in (n.index()..).zip(&cube.positions_m) {
        hinge.positions_m[place] = *p + DVec3::ONE;
    }
    hinge.positions_m.swap_remove(n.index());
    let moved = NodeId::from_index(hinge.positions_m.len());
    for tet in hinge.tetrahedra.iter_mut().flatten().filter(|m| **m == moved) {
        *tet = n;
    }
    assert_eq!(refusal(&hinge, &fixed), SolveError::Singular);

    let mut loose = cube.clone();
    loose.positions_m.push(DVec3::ZERO);
    assert_eq!(refusal(&loose, &fixed), SolveError::LooseNodes { count: 1, first: vec![27] });

    let mut inverted = cube.clone();
    inverted.tetrahedra[5].swap(0, 1);
    assert!(matches!(refusal(&inverted, &fixed), SolveError::Volume { tet: TetId(5), .. }));

    let mut wild = cube.clone();
    wild.tetrahedra[3][2] = NodeId(99);
    assert!(matches!(
        refusal(&wild, &fixed),
        SolveError::NodeOutOfRange { tet: TetId(3), node: NodeId(99), n_nodes: 27 }
    ));

    let far = BoundaryConditions::fixed(&[NodeId(1000)]);
    assert!(matches!(refusal(&cube, &far), SolveError::ConditionOutOfRange { node: NodeId(1000), .. }));
    assert_eq!(refusal(&TetMesh::default(), &none), SolveError::EmptyMesh);
}
