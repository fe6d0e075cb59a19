//! The non-linear static solver against our own finite-element solutions (total Lagrangian, P1; residual 1e-9) and
//! against exact ones.

use std::path::{Path, PathBuf};

use glisson_mesh::math::{DMat3, DVec3};
use glisson_mesh::mesh::{NodeId, TetMesh};
use glisson_tissue::material::{
    LinearElastic, Material, MooneyRivlin, NeoHookeLog, StVenantKirchhoff, StableNeoHooke,
};
use glisson_tissue::solve::case::{parse_vectors, read_case};
use glisson_tissue::solve::{
    BoundaryConditions, ElasticBody, MeshEdges, NonlinearError, NonlinearProblem, NonlinearSettings,
    NonlinearSolution, StaticProblem, StiffnessTensors, TangentKind, add_gravity_forces, boundary_nodes,
    solve_nonlinear, solve_static,
};

use crate::model_meshes::{block, nodes_below, relative_difference, shaken_block};

fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/reference").join(name)
}

fn vectors(name: &str, file: &str) -> Vec<DVec3> {
    let file = folder(name).join(file);
    parse_vectors(&file, &std::fs::read(&file).unwrap()).unwrap()
}

/// Solves a reference case and compares fields and reactions.
fn check<M: Material + for<'a> From<&'a LinearElastic>>(name: &str, suffix: &str) -> NonlinearSolution {
    let case = read_case(&folder(name)).unwrap();
    let mut nodal_force_n = vec![DVec3::ZERO; case.mesh.positions_m.len()];
    add_gravity_forces(&case.mesh, &case.material, case.gravity_m_per_s2, &mut nodal_force_n);
    let solution = solve_nonlinear(&NonlinearProblem {
        mesh: &case.mesh,
        laws: &[M::from(&case.material)],
        conditions: &case.conditions,
        nodal_force_n: &nodal_force_n,
        settings: NonlinearSettings::default(),
    })
    .unwrap();
    let u = relative_difference(&solution.displacement_m, &vectors(name, &format!("u_np_{suffix}.csv")));
    assert!(u < 1e-6, "{name} {suffix}: displacement off by {u:e}");
    let r = relative_difference(&solution.reaction_n, &vectors(name, &format!("reactions_np_{suffix}.csv")));
    assert!(r < 1e-6, "{name} {suffix}: reactions off by {r:e}");
    eprintln!(
        "{name} {suffix}: u {u:e}, reactions {r:e}, {} load steps, {} iterations, residual {:e} N",
        solution.n_load_steps, solution.n_iterations, solution.residual_n
    );
    solution
}

fn top_force_n(solution: &NonlinearSolution) -> f64 {
    let case = read_case(&folder("cylinder")).unwrap();
    let top = solution.reaction_n.iter().zip(&case.mesh.positions_m).filter(|(_, x)| x.z > 0.049);
    top.map(|(f, _)| f.x).sum()
}

#[test]
fn beam_of_st_venant_kirchhoff_agrees() {
    check::<StVenantKirchhoff>("beam", "stvk");
}

#[test]
fn beam_of_neo_hooke_agrees() {
    check::<NeoHookeLog>("beam", "nh");
}

#[test]
fn cylinder_of_st_venant_kirchhoff_agrees() {
    let top_n = top_force_n(&check::<StVenantKirchhoff>("cylinder", "stvk"));
    assert!((top_n - 0.139771).abs() < 1e-6, "{top_n}");
}

#[test]
fn cylinder_of_neo_hooke_agrees() {
    let top_n = top_force_n(&check::<NeoHookeLog>("cylinder", "nh"));
    assert!((top_n - 0.136074).abs() < 1e-6, "{top_n}");
}

#[test]
fn patches_agree() {
    check::<StVenantKirchhoff>("patch", "stvk");
    check::<NeoHookeLog>("patch", "nh");
}

fn liver() -> LinearElastic {
    LinearElastic::from_young_poisson(5000.0, 0.45, 1060.0).unwrap()
}

/// A boundary moved by a large affine map moves the inside by the same map, whatever the law: patch test of M1.
#[test]
fn a_large_affine_motion_of_the_boundary_moves_the_inside_along() {
    let mesh = shaken_block([3, 3, 3], DVec3::splat(0.06), 0.2, 5);
    let map = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 2.0)
        * DMat3::from_cols_array(&[1.3, 0.1, 0.0, 0.2, 0.85, 0.1, -0.1, 0.0, 1.1]);
    let mut conditions = BoundaryConditions::new();
    for node in boundary_nodes(&mesh) {
        let x = mesh.positions_m[node.index()];
        conditions.impose_node(node, map * x - x);
    }
    let expected: Vec<DVec3> = mesh.positions_m.iter().map(|&x| map * x - x).collect();
    let forces = vec![DVec3::ZERO; mesh.positions_m.len()];
    let laws: [&dyn Material; 3] = [
        &StableNeoHooke::from(&liver()),
        &NeoHookeLog::from(&liver()),
        &MooneyRivlin::from_linear(&liver(), 0.5).unwrap(),
    ];
    for (number, law) in laws.into_iter().enumerate() {
        let solution = solve_nonlinear(&NonlinearProblem {
            mesh: &mesh,
            laws: &[law],
            conditions: &conditions,
            nodal_force_n: &forces,
            settings: NonlinearSettings { first_load_step: 0.125, ..Default::default() },
        })
        .unwrap();
        let off = relative_difference(&solution.displacement_m, &expected);
        assert!(off < 1e-10, "law {number}: off by {off:e}");
    }
}

fn hanging_block(mesh: &TetMesh) -> (BoundaryConditions, Vec<DVec3>) {
    let conditions = BoundaryConditions::fixed(&nodes_below(mesh, 0, 1e-9));
    let mut forces = vec![DVec3::ZERO; mesh.positions_m.len()];
    add_gravity_forces(mesh, &liver(), DVec3::new(0.0, 0.0, -3.0), &mut forces);
    (conditions, forces)
}

/// With the linear law one Newton iteration gives what the linear solver gives, and forces balance.
#[test]
fn the_linear_law_gives_the_linear_solution() {
    let mesh = shaken_block([5, 2, 2], DVec3::new(0.1, 0.04, 0.04), 0.0, 3);
    let (conditions, forces) = hanging_block(&mesh);
    let settings = NonlinearSettings { first_load_step: 1.0, ..Default::default() };
    let material = liver();
    let problem = NonlinearProblem {
        mesh: &mesh,
        laws: &[material],
        conditions: &conditions,
        nodal_force_n: &forces,
        settings,
    };
    let found = solve_nonlinear(&problem).unwrap();
    let expected = solve_static(&StaticProblem {
        mesh: &mesh,
        material: &material,
        conditions: &conditions,
        nodal_force_n: &forces,
    })
    .unwrap();
    assert!(relative_difference(&found.displacement_m, &expected.displacement_m) < 1e-10);
    assert!(relative_difference(&found.reaction_n, &expected.reaction_n) < 1e-10);
    let total: DVec3 = found.reaction_n.iter().chain(&forces).sum();
    assert!(total.length() < 1e-9 * forces.iter().sum::<DVec3>().length());
    // Same bits twice.
    assert_eq!(found, solve_nonlinear(&problem).unwrap());
}

/// One law a tetrahedron, all equal, is one law.
#[test]
fn laws_of_each_tetrahedron_are_taken() {
    let mesh = block([4, 2, 2], DVec3::new(0.08, 0.04, 0.04));
    let (conditions, forces) = hanging_block(&mesh);
    let soft = NeoHookeLog::from(&liver());
    let stiff = NeoHookeLog::new(10.0 * soft.lambda_pa(), 10.0 * soft.mu_pa()).unwrap();
    let solve = |laws: &[NeoHookeLog]| {
        let settings = NonlinearSettings::default();
        solve_nonlinear(&NonlinearProblem {
            mesh: &mesh,
            laws,
            conditions: &conditions,
            nodal_force_n: &forces,
            settings,
        })
    };
    let n_tets = mesh.tetrahedra.len();
    let one = solve(&[soft]).unwrap();
    assert_eq!(one, solve(&vec![soft; n_tets]).unwrap());
    let mut mixed = vec![soft; n_tets];
    mixed[..n_tets / 2].fill(stiff);
    let tip = |s: &NonlinearSolution| s.displacement_m.iter().map(|u| -u.z).fold(0.0, f64::max);
    assert!(tip(&solve(&mixed).unwrap()) < 0.9 * tip(&one));
    assert_eq!(solve(&[]).unwrap_err(), NonlinearError::LawCount { found: 0, n_tets });
}

/// Forces are the energy's derivative, and the stiffness is that of the forces.
#[test]
fn forces_and_stiffness_are_derivatives_of_the_energy() {
    let mesh = shaken_block([2, 2, 2], DVec3::splat(0.04), 0.2, 9);
    let edges = MeshEdges::of_mesh(&mesh).unwrap();
    let laws = [StableNeoHooke::from(&liver())];
    let body = ElasticBody::new(&mesh, &edges, &laws).unwrap();
    let n = mesh.positions_m.len();
    let mut random = glisson_mesh::math::SeededRandom::new(4);
    let mut field = |size: f64| -> Vec<DVec3> {
        (0..n).map(|_| DVec3::new(random.normal(), random.normal(), random.normal()) * size).collect()
    };
    let (u, d) = (field(2e-3), field(1.0));
    let moved = |h: f64| -> Vec<DVec3> { (0..n).map(|i| u[i] + d[i] * h).collect() };
    let mut tensors =
        StiffnessTensors { vertex: vec![DMat3::ZERO; n], edge: vec![DMat3::ZERO; edges.nodes.len()] };
    body.stiffness_into(&u, TangentKind::Exact, &mut tensors);
    let [mut force, mut ahead, mut behind, mut change] = std::array::from_fn(|_| vec![DVec3::ZERO; n]);
    let h = 1e-8;
    body.force_into(&u, &mut force);
    body.force_into(&moved(h), &mut ahead);
    body.force_into(&moved(-h), &mut behind);
    tensors.force_into(&edges, &d, &mut change);
    let slope: f64 = force.iter().zip(&d).map(|(f, d)| f.dot(*d)).sum();
    let difference = (body.energy_j(&moved(h)) - body.energy_j(&moved(-h))) / (2.0 * h);
    assert!((difference - slope).abs() < 1e-5 * slope.abs(), "{difference} {slope}");
    let differences: Vec<DVec3> = (0..n).map(|i| (ahead[i] - behind[i]) / (2.0 * h)).collect();
    let off = relative_difference(&differences, &change);
    assert!(off < 1e-6, "{off:e}");
}

/// A block pressed flat has no equilibrium without inversion: the error says how far it came.
#[test]
fn a_load_without_equilibrium_is_refused_with_the_load_reached() {
    let mesh = block([2, 2, 2], DVec3::splat(0.04));
    let mut conditions = BoundaryConditions::fixed(&nodes_below(&mesh, 2, 1e-9));
    for n in 0..mesh.positions_m.len() {
        if mesh.positions_m[n].z > 0.04 - 1e-9 {
            conditions.impose_node(NodeId::from_index(n), DVec3::new(0.0, 0.0, -0.041));
        }
    }
    let forces = vec![DVec3::ZERO; mesh.positions_m.len()];
    let error = solve_nonlinear(&NonlinearProblem {
        mesh: &mesh,
        laws: &[NeoHookeLog::from(&liver())],
        conditions: &conditions,
        nodal_force_n: &forces,
        settings: NonlinearSettings { least_load_step: 1.0 / 64.0, ..Default::default() },
    })
    .unwrap_err();
    let NonlinearError::NotConverged { load_reached, .. } = error else { panic!("{error}") };
    assert!((0.3..0.98).contains(&load_reached), "{error}");
    assert!(error.to_string().contains("of the load"), "{error}");
}
