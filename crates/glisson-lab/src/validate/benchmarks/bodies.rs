//! Meshes and loads of the structural benchmarks: mapped boxes, a sphere's octant, surface tractions.

use glisson::math::{DVec3, tetrahedron_volume_m3};
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::{NodeId, TetMesh};
use glisson::solve::BoundaryConditions;

/// A unit box of `cells` cells of five tetrahedra whose nodes `place` moves.
pub(super) fn mapped_box(cells: [usize; 3], place: impl Fn(DVec3) -> DVec3) -> TetMesh {
    let mut mesh = box_of_five(cells, DVec3::ONE);
    for p in &mut mesh.positions_m {
        *p = place(*p);
    }
    mesh
}

/// An octant of a thick sphere: `n` triangles along an edge of the octant, `layers` radially.
pub(super) fn sphere_octant(radii_m: [f64; 2], n: usize, layers: usize) -> TetMesh {
    let mut mesh = TetMesh::default();
    // Nodes of the octant's triangle: places (i, j) with i + j <= n.
    let place = |i: usize, j: usize| i * (2 * n + 3 - i) / 2 + j;
    let per_layer = (n + 1) * (n + 2) / 2;
    // Evens out the triangles on the sphere.
    let share = |k: usize| (k as f64 / n as f64 * std::f64::consts::FRAC_PI_4).tan();
    for layer in 0..=layers {
        let radius_m = radii_m[0] + (radii_m[1] - radii_m[0]) * layer as f64 / layers as f64;
        for i in 0..=n {
            for j in 0..=n - i {
                let direction = DVec3::new(share(i), share(j), share(n - i - j)).normalize();
                mesh.positions_m.push(direction * radius_m);
            }
        }
    }
    for layer in 0..layers {
        let mut prism = |corners: [(usize, usize); 3]| {
            // Three tetrahedra; the diagonals of the sides start at the lower node number.
            let mut low = corners.map(|(a, b)| layer * per_layer + place(a, b));
            low.sort_unstable();
            let [a, b, c] = low;
            let [d, e, f] = low.map(|x| x + per_layer);
            for tet in [[a, b, c, f], [a, b, f, e], [a, e, f, d]] {
                let mut nodes = tet.map(NodeId::from_index);
                if tetrahedron_volume_m3(nodes.map(|x| mesh.positions_m[x.index()])) < 0.0 {
                    nodes.swap(0, 1);
                }
                mesh.tetrahedra.push(nodes);
            }
        };
        for i in 0..n {
            for j in 0..n - i {
                prism([(i, j), (i + 1, j), (i, j + 1)]);
                if i + j + 1 < n {
                    prism([(i + 1, j), (i + 1, j + 1), (i, j + 1)]);
                }
            }
        }
    }
    mesh
}

/// Nodes whose rest position satisfies `is_there`.
pub(super) fn nodes_where(mesh: &TetMesh, is_there: impl Fn(DVec3) -> bool) -> Vec<NodeId> {
    (0..mesh.positions_m.len()).filter(|&n| is_there(mesh.positions_m[n])).map(NodeId::from_index).collect()
}

/// Holds one component of `nodes` at rest.
pub(super) fn hold(conditions: &mut BoundaryConditions, nodes: &[NodeId], axis: usize) {
    for &node in nodes {
        conditions.impose(node, axis, 0.0);
    }
}

/// Forces of `traction_n` per outward area vector [m2] on the surface triangles whose corners satisfy `is_there`: a
/// third at each corner.
pub(super) fn surface_forces(
    mesh: &TetMesh,
    is_there: impl Fn(DVec3) -> bool,
    traction_n: impl Fn(DVec3) -> DVec3,
) -> Vec<DVec3> {
    let mut force_n = vec![DVec3::ZERO; mesh.positions_m.len()];
    for nodes in &mesh.tetrahedra {
        for opposite in 0..4 {
            let face = [1, 2, 3].map(|k| nodes[(opposite + k) % 4]);
            let p_m = face.map(|n| mesh.positions_m[n.index()]);
            if !p_m.iter().all(|p| is_there(*p)) {
                continue;
            }
            let mut area_m2 = 0.5 * (p_m[1] - p_m[0]).cross(p_m[2] - p_m[0]);
            if area_m2.dot(mesh.positions_m[nodes[opposite].index()] - p_m[0]) > 0.0 {
                area_m2 = -area_m2;
            }
            for n in face {
                force_n[n.index()] += traction_n(area_m2) / 3.0;
            }
        }
    }
    force_n
}

/// Mean of `value` over `nodes`.
pub(super) fn mean(nodes: &[NodeId], value: impl Fn(usize) -> f64) -> f64 {
    nodes.iter().map(|n| value(n.index())).sum::<f64>() / nodes.len() as f64
}
