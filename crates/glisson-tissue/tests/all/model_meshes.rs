//! Meshes for the tests of solver and models.

use glisson_mesh::math::{DVec3, SeededRandom};
use glisson_mesh::mesh::edit::EditableMesh;
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};
use glisson_tissue::model::FixedNode;

/// The six tetrahedra of a cube cut along its diagonal (Kuhn): paths from corner 0 to corner 7 of the corner
/// numbers x + 2 y + 4 z; odd paths have two corners swapped, so that all are positive.
const KUHN: [[usize; 4]; 6] =
    [[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]];

/// A block of `cells` cubes of 6 tetrahedra each over `size_m`, one corner in the origin.
pub(crate) fn block(cells: [usize; 3], size_m: DVec3) -> TetMesh {
    let [nx, ny, nz] = cells;
    let node = |x: usize, y: usize, z: usize| x + (nx + 1) * (y + (ny + 1) * z);
    let mut mesh = TetMesh::default();
    for z in 0..=nz {
        for y in 0..=ny {
            for x in 0..=nx {
                let share = DVec3::new(x as f64 / nx as f64, y as f64 / ny as f64, z as f64 / nz as f64);
                mesh.positions_m.push(share * size_m);
            }
        }
    }
    for z in 0..nz {
        for y in 0..ny {
            for x in 0..nx {
                let corner = |c: usize| node(x + (c & 1), y + ((c >> 1) & 1), z + ((c >> 2) & 1));
                for tet in KUHN {
                    mesh.tetrahedra.push(tet.map(|c| NodeId::from_index(corner(c))));
                }
            }
        }
    }
    mesh
}

/// The block with its nodes moved at random by up to `share` of a cell, nodes and tetrahedra renumbered at
/// random and each tetrahedron's corners rotated: nothing regular is left.
pub(crate) fn shaken_block(cells: [usize; 3], size_m: DVec3, share: f64, seed: u64) -> TetMesh {
    let regular = block(cells, size_m);
    let mut random = SeededRandom::new(seed);
    let cell_m = size_m / DVec3::new(cells[0] as f64, cells[1] as f64, cells[2] as f64);
    let n = regular.positions_m.len();
    let new_of_old = shuffled(n, &mut random);
    let mut mesh =
        TetMesh { positions_m: vec![DVec3::ZERO; n], tetrahedra: Vec::new(), ..TetMesh::default() };
    for (old, &p) in regular.positions_m.iter().enumerate() {
        let shift = DVec3::from_array(std::array::from_fn(|_| random.uniform_in(-share, share)));
        mesh.positions_m[new_of_old[old]] = p + shift * cell_m;
    }
    for t in shuffled(regular.tetrahedra.len(), &mut random) {
        let [a, b, c, d] = regular.tetrahedra[t].map(|n| NodeId::from_index(new_of_old[n.index()]));
        // Even permutations keep the orientation.
        let turned = match random.next_u64() % 4 {
            0 => [a, b, c, d],
            1 => [b, a, d, c],
            2 => [c, d, a, b],
            _ => [a, c, d, b],
        };
        mesh.tetrahedra.push(turned);
    }
    mesh
}

/// A block bent into a rounded, ellipsoid-like body.
pub(crate) fn rounded_block(cells: [usize; 3], size_m: DVec3) -> TetMesh {
    let mut mesh = block(cells, DVec3::ONE);
    for p in &mut mesh.positions_m {
        let q = 2.0 * *p - 1.0;
        let s = q * q;
        let round = DVec3::new(
            q.x * (1.0 - s.y / 2.0 - s.z / 2.0 + s.y * s.z / 3.0).sqrt(),
            q.y * (1.0 - s.z / 2.0 - s.x / 2.0 + s.z * s.x / 3.0).sqrt(),
            q.z * (1.0 - s.x / 2.0 - s.y / 2.0 + s.x * s.y / 3.0).sqrt(),
        );
        *p = 0.5 * size_m * (0.6 * round + 0.4 * q);
    }
    mesh
}

fn shuffled(n: usize, random: &mut SeededRandom) -> Vec<usize> {
    let mut order: Vec<usize> = (0..n).collect();
    for i in (1..n).rev() {
        order.swap(i, (random.next_u64() % (i as u64 + 1)) as usize);
    }
    order
}

/// Nodes with a coordinate `axis` below `limit_m`.
pub(crate) fn nodes_below(mesh: &TetMesh, axis: usize, limit_m: f64) -> Vec<NodeId> {
    (0..mesh.positions_m.len())
        .filter(|&n| mesh.positions_m[n][axis] < limit_m)
        .map(NodeId::from_index)
        .collect()
}

/// Nodes that do not move at all.
pub(crate) fn held(nodes: &[NodeId]) -> Vec<FixedNode> {
    nodes.iter().map(|&node| FixedNode::all_axes(node)).collect()
}

/// Largest component of the difference over the largest component of `expected`.
pub(crate) fn relative_difference(found: &[DVec3], expected: &[DVec3]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let largest = expected.iter().map(|v| v.abs().max_element()).fold(0.0, f64::max);
    let off = found.iter().zip(expected).map(|(a, b)| (*a - *b).abs().max_element()).fold(0.0, f64::max);
    off / largest
}

#[test]
fn the_meshes_fill_their_volume() {
    let size_m = DVec3::new(0.1, 0.15, 0.07);
    let regular = block([4, 3, 2], size_m);
    assert!((regular.volume_m3() - size_m.element_product()).abs() < 1e-15);
    for mesh in [regular, shaken_block([4, 3, 2], size_m, 0.15, 1), rounded_block([4, 3, 2], size_m)] {
        for t in 0..mesh.tetrahedra.len() {
            assert!(mesh.tet_volume_m3(glisson_mesh::mesh::TetId::from_index(t)) > 0.0);
        }
    }
}

/// Up to `n` live tetrahedra at random, ascending.
pub(crate) fn random_live_tets(editable: &EditableMesh, random: &mut SeededRandom, n: usize) -> Vec<TetId> {
    let live: Vec<TetId> = editable.topology().live_tets().collect();
    let mut tets: Vec<TetId> =
        (0..n).map(|_| live[(random.next_u64() % live.len() as u64) as usize]).collect();
    tets.sort_unstable();
    tets.dedup();
    tets
}
