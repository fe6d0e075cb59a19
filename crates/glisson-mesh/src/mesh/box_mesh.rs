//! Boxes of tetrahedra, for tests, benches and virtual rheology.
//!
//! The division of a cell into five tetrahedra alternates between neighbours, so that their faces agree: n nodes a
//! side give 5 (n-1)^3 tetrahedra and 3 n^2 (n-1) + 3 n (n-1)^2 edges, the numbers of the cubes of seed `000`
//! s. 2.3.4 (whose 5645 tetrahedra for n = 10 are a misprint of 3645).

use super::{NodeId, TetMesh};
use crate::math::{DVec3, SeededRandom};
use std::collections::BTreeMap;

/// Corners x + 2 y + 4 z of the tetrahedra of cells with an even sum of indices.
const EVEN: [[usize; 4]; 5] = [[1, 0, 3, 5], [2, 0, 6, 3], [4, 0, 5, 6], [7, 3, 6, 5], [0, 3, 5, 6]];

/// The mirror image for odd ones.
const ODD: [[usize; 4]; 5] = [[0, 1, 2, 4], [3, 1, 7, 2], [5, 1, 4, 7], [6, 2, 7, 4], [1, 2, 4, 7]];

/// A box of `cells` cells of five tetrahedra each over `size_m`, one corner in the origin. Nodes run along x, then
/// y, then z.
///
/// # Panics
/// When a number of cells is zero.
pub fn box_of_five(cells: [usize; 3], size_m: DVec3) -> TetMesh {
    assert!(cells.iter().all(|&n| n > 0), "at least one cell along each axis");
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
                for tet in if (x + y + z) % 2 == 0 { EVEN } else { ODD } {
                    let [a, b, c, d] = tet.map(|c| NodeId::from_index(corner(c)));
                    let volume =
                        crate::math::tetrahedron_volume_m3([a, b, c, d].map(|n| mesh.positions_m[n.index()]));
                    mesh.tetrahedra.push(if volume > 0.0 { [a, b, c, d] } else { [a, c, b, d] });
                }
            }
        }
    }
    mesh
}

/// Those cells of a box of `cells` cubes of `cell_m`, five tetrahedra each, that `keep` wants. Nodes are numbered as the
/// tetrahedra come to them.
///
/// # Panics
/// When a number of cells is zero.
pub fn cells_of_five(cells: [usize; 3], cell_m: f64, keep: impl Fn([usize; 3]) -> bool) -> TetMesh {
    let all = box_of_five(cells, DVec3::from_array(cells.map(|n| n as f64)) * cell_m);
    let (mut mesh, mut new) = (TetMesh::default(), BTreeMap::new());
    for tet in &all.tetrahedra {
        let middle = tet.iter().map(|n| all.positions_m[n.index()]).sum::<DVec3>() / (4.0 * cell_m);
        if keep(middle.to_array().map(|x| x as usize)) {
            mesh.tetrahedra.push(tet.map(|n| {
                *new.entry(n).or_insert_with(|| {
                    mesh.positions_m.push(all.positions_m[n.index()]);
                    NodeId::from_index(mesh.positions_m.len() - 1)
                })
            }));
        }
    }
    mesh
}

/// A cube of `n_nodes` nodes a side.
///
/// # Panics
/// Below two nodes a side.
pub fn cube_of_five(n_nodes: usize, side_m: f64) -> TetMesh {
    assert!(n_nodes >= 2, "at least two nodes a side");
    box_of_five([n_nodes - 1; 3], DVec3::splat(side_m))
}

/// An irregular cube: 150 nodes and 400 tetrahedra (seed `000` has one of 151 and 407 from commercial software),
/// finer towards x = 0, and nodes moved at random without leaving their faces.
pub fn irregular_cube(side_m: f64, seed: u64) -> TetMesh {
    let mut mesh = box_of_five([4, 4, 5], DVec3::ONE);
    let mut random = SeededRandom::new(seed);
    for p in &mut mesh.positions_m {
        let cell = DVec3::new(0.25, 0.25, 0.2);
        let moved: [f64; 3] = std::array::from_fn(|axis| {
            let on_face = p[axis] == 0.0 || p[axis] == 1.0;
            // Drawn for every node, so that the sequence does not depend on the faces.
            let shift = random.uniform_in(-0.15, 0.15) * cell[axis];
            if on_face { p[axis] } else { p[axis] + shift }
        });
        let [x, y, z] = moved;
        *p = DVec3::new(0.5 * x + 0.5 * x * x, y, z) * side_m;
    }
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::TetId;
    use crate::mesh::edit::EditableMesh;

    #[test]
    fn cubes_have_the_counts_of_the_seed_and_fill_their_volume() {
        for (n, nodes, springs, tets) in [(2, 8, 18, 5), (5, 125, 540, 320), (10, 1000, 5130, 3645)] {
            let mesh = cube_of_five(n, 0.05);
            assert!((mesh.volume_m3() - 1.25e-4).abs() < 1e-15);
            let counts = EditableMesh::new(mesh).unwrap().topology().live_counts();
            assert_eq!((counts.nodes, counts.edges, counts.tets), (nodes, springs, tets));
        }
        // Two cells of eight that share an edge alone.
        let hinge = cells_of_five([2; 3], 0.5, |[x, y, z]| z == 0 && x == y);
        assert_eq!((hinge.positions_m.len(), hinge.tetrahedra.len()), (14, 10));
        assert!((hinge.volume_m3() - 0.25).abs() < 1e-15);
        let mesh = irregular_cube(0.05, 1);
        assert_eq!((mesh.positions_m.len(), mesh.tetrahedra.len()), (150, 400));
        assert!((mesh.volume_m3() - 1.25e-4).abs() < 1e-15);
        for t in 0..400 {
            assert!(mesh.tet_volume_m3(TetId::from_index(t)) > 0.0);
        }
    }
}
