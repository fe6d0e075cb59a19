//! Node-averaged strain: patch test, and three bodies in which plain linear tetrahedra lock.

use glisson_mesh::math::{DMat3, DVec3};
use glisson_mesh::mesh::{NodeId, TetMesh};
use glisson_tissue::material::LinearElastic;
use glisson_tissue::solve::{
    BoundaryConditions, NodeAveraging, StaticProblem, StaticSolution, add_gravity_forces, boundary_nodes,
    node_pressures_pa, solve_static, solve_static_node_averaged,
};

use crate::model_meshes::{block, shaken_block};

fn both(problem: &StaticProblem<'_>) -> [StaticSolution; 2] {
    [solve_static(problem).unwrap(), solve_static_node_averaged(problem, NodeAveraging::STRAIN).unwrap()]
}

#[test]
fn an_affine_displacement_passes_the_patch_test() {
    let gradient = DMat3::from_cols(
        DVec3::new(0.05, 0.0, 0.02),
        DVec3::new(0.1, -0.03, 0.0),
        DVec3::new(0.0, 0.04, 0.06),
    );
    let mesh = shaken_block([5, 4, 3], DVec3::new(0.1, 0.06, 0.05), 0.2, 7);
    for (poisson_ratio, averaging) in
        [(0.3, NodeAveraging::STRAIN), (0.4999, NodeAveraging::STRAIN), (0.4999, NodeAveraging::PRESSURE)]
    {
        let material = LinearElastic::from_young_poisson(5000.0, poisson_ratio, 1000.0).unwrap();
        let mut conditions = BoundaryConditions::new();
        for node in boundary_nodes(&mesh) {
            conditions.impose_node(node, gradient * mesh.positions_m[node.index()]);
        }
        let nodal_force_n = vec![DVec3::ZERO; mesh.positions_m.len()];
        let problem = StaticProblem {
            mesh: &mesh,
            material: &material,
            conditions: &conditions,
            nodal_force_n: &nodal_force_n,
        };
        let solution = solve_static_node_averaged(&problem, averaging).unwrap();
        for (u, &p) in solution.displacement_m.iter().zip(&mesh.positions_m) {
            assert!((*u - gradient * p).length() <= 1e-11 * 0.01, "{u} at {p}");
        }
        let trace = gradient.col(0).x + gradient.col(1).y + gradient.col(2).z;
        let expected_pa = -material.lambda_pa() * trace;
        for p in node_pressures_pa(&mesh, &material, &solution.displacement_m).unwrap() {
            assert!((p - expected_pa).abs() <= 1e-8 * expected_pa.abs(), "{p} {expected_pa}");
        }
        // Reactions inside vanish: the stress of the patch is the same everywhere.
        let force: DVec3 = solution.reaction_n.iter().sum();
        assert!(force.length() <= 1e-9 * solution.reaction_n.iter().map(|f| f.length()).sum::<f64>());
    }
}

/// Cook's membrane of 48 x (44 to 16) mm, one element thick in plane strain: upward displacement [mm] of the
/// middle of the loaded edge, plain and averaged. E 70 MPa, shear load 6.25 N/mm2 on the right side.
fn cook_mm(cells: [usize; 2], poisson_ratio: f64) -> [f64; 2] {
    let [nx, ny] = cells;
    let thickness_m = 48e-3 / nx as f64;
    let mut mesh = block([nx, ny, 1], DVec3::ONE);
    for p in &mut mesh.positions_m {
        let (low, high) = (44.0 * p.x, 44.0 + 16.0 * p.x);
        *p = DVec3::new(48e-3 * p.x, 1e-3 * (low + (high - low) * p.y), thickness_m * p.z);
    }
    let material = LinearElastic::from_young_poisson(70e6, poisson_ratio, 1000.0).unwrap();
    let mut conditions = BoundaryConditions::new();
    for n in 0..mesh.positions_m.len() {
        let node = NodeId::from_index(n);
        conditions.impose(node, 2, 0.0);
        if mesh.positions_m[n].x == 0.0 {
            conditions.fix_node(node);
        }
    }
    // Triangles of the right side carry a third of their load at each corner.
    let mut nodal_force_n = vec![DVec3::ZERO; mesh.positions_m.len()];
    let mut loaded_m2 = 0.0;
    for nodes in &mesh.tetrahedra {
        let right: Vec<NodeId> =
            nodes.iter().copied().filter(|n| mesh.positions_m[n.index()].x > 47.9999e-3).collect();
        if let [a, b, c] = right[..] {
            let [a_m, b_m, c_m] = [a, b, c].map(|n| mesh.positions_m[n.index()]);
            let area_m2 = 0.5 * (b_m - a_m).cross(c_m - a_m).length();
            loaded_m2 += area_m2;
            for n in [a, b, c] {
                nodal_force_n[n.index()].y += 6.25e6 * area_m2 / 3.0;
            }
        }
    }
    assert!((loaded_m2 - 16e-3 * thickness_m).abs() < 1e-12);
    let problem = StaticProblem {
        mesh: &mesh,
        material: &material,
        conditions: &conditions,
        nodal_force_n: &nodal_force_n,
    };
    let middle: Vec<usize> = (0..mesh.positions_m.len())
        .filter(|&n| mesh.positions_m[n].distance(DVec3::new(48e-3, 52e-3, mesh.positions_m[n].z)) < 1e-6)
        .collect();
    assert_eq!(middle.len(), 2);
    both(&problem)
        .map(|s| 1e3 * middle.iter().map(|&n| s.displacement_m[n].y).sum::<f64>() / middle.len() as f64)
}

/// B5: 27.35 to 27.56 mm nearly incompressible, about 32 mm for nu = 1/3.
#[test]
fn cooks_membrane_does_not_lock() {
    let [compressible, averaged] = cook_mm([24, 24], 1.0 / 3.0);
    assert!((28.0..32.3).contains(&compressible) && averaged > compressible, "{compressible} {averaged}");
    let [plain, averaged] = cook_mm([48, 48], 0.4999);
    assert!(plain < 20.0, "{plain}: plain tetrahedra lock");
    assert!((26.0..28.0).contains(&averaged), "{averaged}");
}

/// An octant of a thick sphere, 10 to 20 mm: `n` triangles along an edge of the octant, `layers` radially.
fn sphere_octant(n: usize, layers: usize) -> TetMesh {
    let mut mesh = TetMesh::default();
    // Nodes of the octant's triangle: places (i, j) with i + j <= n.
    let place = |i: usize, j: usize| i * (2 * n + 3 - i) / 2 + j;
    let per_layer = (n + 1) * (n + 2) / 2;
    for layer in 0..=layers {
        let radius_m = 10e-3 * (1.0 + layer as f64 / layers as f64);
        for i in 0..=n {
            for j in 0..=n - i {
                let angle = |k: usize| even_out(k as f64 / n as f64);
                let direction = DVec3::new(angle(i), angle(j), angle(n - i - j)).normalize();
                mesh.positions_m.push(direction * radius_m);
            }
        }
    }
    for layer in 0..layers {
        for i in 0..n {
            for j in 0..n - i {
                let mut prism = |corners: [(usize, usize); 3]| {
                    // Three tetrahedra; the diagonals of the sides start at the lower node number.
                    let mut low = corners.map(|(a, b)| layer * per_layer + place(a, b));
                    low.sort_unstable();
                    let [a, b, c] = low;
                    let [d, e, f] = low.map(|x| x + per_layer);
                    for tet in [[a, b, c, f], [a, b, f, e], [a, e, f, d]] {
                        let mut nodes = tet.map(NodeId::from_index);
                        let p = nodes.map(|x| mesh.positions_m[x.index()]);
                        if glisson_mesh::math::tetrahedron_volume_m3(p) < 0.0 {
                            nodes.swap(0, 1);
                        }
                        mesh.tetrahedra.push(nodes);
                    }
                };
                prism([(i, j), (i + 1, j), (i, j + 1)]);
                if i + j + 1 < n {
                    prism([(i + 1, j), (i + 1, j + 1), (i, j + 1)]);
                }
            }
        }
    }
    mesh
}

/// Evens out the triangles on the sphere.
fn even_out(share: f64) -> f64 {
    libm::tan(share * std::f64::consts::FRAC_PI_4)
}

/// M11: u(a) = 0.8543 mm (Lame) for 1 kPa inside, E 10 kPa, nu 0.49; mean over the inner nodes.
#[test]
fn a_thick_sphere_swells_by_lames_solution() {
    let mesh = sphere_octant(10, 8);
    let material = LinearElastic::from_young_poisson(10e3, 0.49, 1000.0).unwrap();
    let mut conditions = BoundaryConditions::new();
    for n in 0..mesh.positions_m.len() {
        for axis in 0..3 {
            if mesh.positions_m[n][axis] < 1e-9 {
                conditions.impose(NodeId::from_index(n), axis, 0.0);
            }
        }
    }
    let is_inner = |n: NodeId| mesh.positions_m[n.index()].length() < 10e-3 + 1e-9;
    let mut nodal_force_n = vec![DVec3::ZERO; mesh.positions_m.len()];
    for nodes in &mesh.tetrahedra {
        let inner: Vec<NodeId> = nodes.iter().copied().filter(|&n| is_inner(n)).collect();
        if let [a, b, c] = inner[..] {
            let [a_m, b_m, c_m] = [a, b, c].map(|n| mesh.positions_m[n.index()]);
            let mut area_m2 = 0.5 * (b_m - a_m).cross(c_m - a_m);
            if area_m2.dot(a_m) < 0.0 {
                area_m2 = -area_m2;
            }
            for n in [a, b, c] {
                nodal_force_n[n.index()] += 1e3 * area_m2 / 3.0;
            }
        }
    }
    let problem = StaticProblem {
        mesh: &mesh,
        material: &material,
        conditions: &conditions,
        nodal_force_n: &nodal_force_n,
    };
    let inner: Vec<usize> =
        (0..mesh.positions_m.len()).filter(|&n| is_inner(NodeId::from_index(n))).collect();
    let [plain, averaged] = both(&problem).map(|s| {
        let outward = |&n: &usize| s.displacement_m[n].dot(mesh.positions_m[n].normalize());
        1e3 * inner.iter().map(outward).sum::<f64>() / inner.len() as f64
    });
    assert!((averaged / 0.8543 - 1.0).abs() < 0.02, "{averaged}");
    assert!((plain / 0.8543 - 1.0).abs() > 2.0 * (averaged / 0.8543 - 1.0).abs(), "{plain} {averaged}");
}

/// B1: cantilever of 20 x 20 x 200 mm, 5 x 5 x 30 nodes, under its weight: Timoshenko's beam sinks by 32.74 mm.
#[test]
fn the_cantilever_sinks_like_timoshenkos_beam() {
    let mesh = block([4, 4, 29], DVec3::new(0.02, 0.02, 0.2));
    let material = LinearElastic::from_young_poisson(2e6, 0.45, 1100.0).unwrap();
    let clamped: Vec<NodeId> = (0..mesh.positions_m.len())
        .filter(|&n| mesh.positions_m[n].z == 0.0)
        .map(NodeId::from_index)
        .collect();
    let conditions = BoundaryConditions::fixed(&clamped);
    let mut nodal_force_n = vec![DVec3::ZERO; mesh.positions_m.len()];
    add_gravity_forces(&mesh, &material, DVec3::new(0.0, -9.81, 0.0), &mut nodal_force_n);
    let problem = StaticProblem {
        mesh: &mesh,
        material: &material,
        conditions: &conditions,
        nodal_force_n: &nodal_force_n,
    };
    let tip: Vec<usize> = (0..mesh.positions_m.len()).filter(|&n| mesh.positions_m[n].z > 0.1999).collect();
    let [plain, averaged] = both(&problem)
        .map(|s| -1e3 * tip.iter().map(|&n| s.displacement_m[n].y).sum::<f64>() / tip.len() as f64);
    assert!((averaged / 32.74 - 1.0).abs() < 0.05, "{averaged}");
    assert!(plain < 0.95 * averaged, "{plain}");
}
